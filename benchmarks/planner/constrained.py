"""Trajectories that hold an anchor, ours and OMPL's, on the same AKR in one run.

    python benchmarks/planner/constrained.py TASK.toml --assets DIR [--limit 20] [--json]

`akrobat plan` plans the task. From each trajectory that it accepts, OMPL gets the start and the
goal configuration (base, arm, object's joint), and the URDF of the AKR, as
`planner/examples/akr_urdf.rs` writes it. OMPL's RRT-Connect plans in a projected state space
(Kingston, Moll and Kavraki, IJRR 2019) whose constraint is that the object's root stays where it
is; value and Jacobian are Pinocchio's. It is spared collisions, speeds and smoothness, which ours
has to respect.

The constraint is called from C++ through Python, so the table also says how much CPU time is left
without these calls, as if the constraint cost nothing. Needs `pin`, `ompl`, h5py and `akrobat`.
"""

from __future__ import annotations

import argparse
import json
import os
import platform
import resource
import subprocess
import sys
import tempfile
import time
import xml.etree.ElementTree as ET
from pathlib import Path

import h5py
import numpy as np
import pinocchio as pin
from ompl import base as ob
from ompl import geometric as og
from ompl import util as ou

ROOT = Path(__file__).resolve().parents[2]
MANIPULATE = 3
TOLERANCE = 1e-4


class Anchored(ob.Constraint):
    """The anchor link stays: six equations, the logarithm of its displacement."""

    def __init__(self, akr: dict):
        root = ET.fromstring(akr["urdf"])
        for link in root.findall("link"):
            for part in list(link):
                link.remove(part)
        for limit in root.iter("limit"):
            limit.attrib.setdefault("effort", "1e9")
            limit.attrib.setdefault("velocity", "1e9")
        whole = pin.buildModelFromXML(ET.tostring(root, encoding="unicode"))
        rest = pin.neutral(whole)
        for name, value in akr["rest"].items():
            rest[whole.joints[whole.getJointId(name)].idx_q] = value
        locked = [whole.getJointId(n) for n in list(whole.names)[1:] if n not in akr["variables"]]
        self.model = pin.buildReducedModel(whole, locked, rest)
        self.data = self.model.createData()
        self.columns = [self.model.joints[self.model.getJointId(n)].idx_q for n in akr["variables"]]
        self.frame = self.model.getFrameId(akr["anchor_link"])
        x, y, z, w, i, j, k = akr["world_from_anchor_link"]
        self.anchor = pin.SE3(pin.Quaternion(w, i, j, k).matrix(), np.array([x, y, z]))
        self.seconds = 0.0
        super().__init__(len(self.columns), 6, TOLERANCE)

    def displacement(self, x) -> pin.SE3:
        q = np.empty(self.model.nq)
        q[self.columns] = x
        pin.framesForwardKinematics(self.model, self.data, q)
        return self.anchor.actInv(self.data.oMf[self.frame])

    def function(self, x, out) -> None:
        begin = time.process_time()
        out[:] = pin.log6(self.displacement(x)).vector
        self.seconds += time.process_time() - begin

    def jacobian(self, x, out) -> None:
        begin = time.process_time()
        off = self.displacement(x)
        q = np.empty(self.model.nq)
        q[self.columns] = x
        frame = pin.computeFrameJacobian(
            self.model, self.data, q, self.frame, pin.ReferenceFrame.LOCAL
        )
        out[:, :] = (pin.Jlog6(off) @ frame)[:, self.columns]
        self.seconds += time.process_time() - begin


def plan_ours(binary: Path, task: Path, assets: Path, limit: int, output: Path) -> dict:
    """Our command, and the CPU time it took in all."""
    command = [str(binary), "--json", "--quiet", "plan", str(task)]
    command += ["-o", str(output), "--limit", str(limit), "--assets", str(assets)]
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    done = subprocess.run(command, check=True, stdout=subprocess.PIPE)
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    report = json.loads(done.stdout)
    cpu = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
    return {"accepted": report["accepted"], "cpu_s": cpu}


def akr_of(task: Path, assets: Path, link: str, tool: np.ndarray, width: float) -> dict:
    """The AKR of one grasp."""
    target = Path(os.environ.get("CARGO_TARGET_DIR", ROOT / "target"))
    binary = target / "release" / "examples" / "akr_urdf"
    numbers = " ".join(repr(float(v)) for v in tool)
    command = [str(binary), str(task), str(assets), link, numbers, repr(float(width))]
    return json.loads(subprocess.run(command, check=True, stdout=subprocess.PIPE).stdout)


def queries(file: Path):
    """Held link, tool in it, width, start and goal of every trajectory."""
    with h5py.File(file) as h:
        active = h.attrs["active_joint"]
        active = list(h.attrs["object_joints"]).index(active)
        offset = h["dense/offset"][:].astype(int)
        for index in range(len(offset) - 1):
            robot = h["waypoints/robot"][index].astype(float)
            moved = h["waypoints/object"][index].astype(float)
            # Base and arm: the fingers come last.
            ends = [np.append(robot[row, :-2], moved[row, active]) for row in (0, -1)]
            link = h["grasp/link"][index]
            link = link.decode() if isinstance(link, bytes) else link
            yield link, h["grasp/pose"][index], h["grasp/width"][index], *ends


def plan_ompl(constraint: Anchored, start, goal, seconds: float) -> dict:
    """One query; the box of the base is that of start and goal and half a metre around."""
    model, columns = constraint.model, constraint.columns
    ambient = ob.RealVectorStateSpace(len(columns))
    bounds = ob.RealVectorBounds(len(columns))
    for i, column in enumerate(columns):
        low, high = model.lowerPositionLimit[column], model.upperPositionLimit[column]
        if i < 3:
            low = max(low, min(start[i], goal[i]) - 0.5)
            high = min(high, max(start[i], goal[i]) + 0.5)
        bounds.setLow(i, float(low) - 1e-6)
        bounds.setHigh(i, float(high) + 1e-6)
    ambient.setBounds(bounds)
    space = ob.ProjectedStateSpace(ambient, constraint)
    information = ob.ConstrainedSpaceInformation(space)
    setup = og.SimpleSetup(information)
    setup.setStateValidityChecker(information.satisfiesBounds)
    ends = []
    for values in (start, goal):
        state = space.allocState()
        state.copy([float(v) for v in values])
        ends.append(state)
    setup.setStartAndGoalStates(ends[0], ends[1])
    setup.setPlanner(og.RRTConnect(information))
    begin, inside = time.process_time(), constraint.seconds
    # A budget of CPU time: that of a clock would depend on what else runs.
    solved = setup.solve(
        ob.PlannerTerminationCondition(lambda: time.process_time() - begin > seconds)
    )
    exact = bool(solved) and setup.haveExactSolutionPath()
    cpu, inside = time.process_time() - begin, constraint.seconds - inside
    if exact:
        path = setup.getSolutionPath()
        path.interpolate()
        states = (path.getState(i) for i in range(path.getStateCount()))
        exact = all(constraint.isSatisfied(state) for state in states)
    return {"solved": exact, "cpu_s": cpu, "constraint_s": inside}


def run(binary: Path, task: Path, assets: Path, limit: int, seconds: float) -> dict:
    """Both on one task."""
    build = ["cargo", "build", "--release", "--quiet", "-p", "akrobat-planner"]
    subprocess.run([*build, "--example", "akr_urdf"], check=True, cwd=ROOT)
    ou.RNG.setSeed(1)
    ou.setLogLevel(ou.LogLevel.LOG_ERROR)
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "plan.h5"
        ours = plan_ours(binary, task, assets, limit, file)
        rows, cache = [], {}
        for link, tool, width, start, goal in queries(file):
            key = (link, tuple(tool), float(width))
            if key not in cache:
                cache[key] = Anchored(akr_of(task, assets, link, tool, width))
            off = max(
                np.abs(pin.log6(cache[key].displacement(x)).vector).max() for x in (start, goal)
            )
            assert off < TOLERANCE, f"start or goal is off the constraint by {off}"
            rows.append(plan_ompl(cache[key], start, goal, seconds))
    solved = sum(row["solved"] for row in rows)
    cpu = sum(row["cpu_s"] for row in rows)
    inside = sum(row["constraint_s"] for row in rows)
    return {
        "task": task.stem,
        "akrobat": ours | {"per_cpu_s": ours["accepted"] / ours["cpu_s"]},
        "ompl": {
            "queries": len(rows),
            "solved": solved,
            "cpu_s": cpu,
            "constraint_s": inside,
            "per_cpu_s": solved / cpu,
            "per_cpu_s_without_constraint": solved / max(cpu - inside, 1e-9),
        },
    }


def text(report: dict) -> str:
    """The table, for people."""
    ours, theirs = report["akrobat"], report["ompl"]
    free = theirs["per_cpu_s_without_constraint"]
    return "\n".join(
        [
            f"{platform.machine()}, {os.cpu_count()} cores; {report['task']}; CPU time",
            f"akrobat, whole command: {ours['accepted']} accepted in {ours['cpu_s']:.1f} s, "
            f"{ours['per_cpu_s']:.2f}/s (fields, grasps, starts, goals, approaches, judging)",
            f"OMPL projected RRT-Connect: {theirs['solved']} of {theirs['queries']} in "
            f"{theirs['cpu_s']:.1f} s, {theirs['per_cpu_s']:.2f}/s; {free:.2f}/s if the "
            f"constraint cost nothing; starts and goals given, no collisions",
            f"ratio: {ours['per_cpu_s'] / max(theirs['per_cpu_s'], 1e-9):.1f} "
            f"({ours['per_cpu_s'] / free:.1f} if the constraint cost nothing)",
        ]
    )


def main() -> int:
    """Runs the comparison."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawTextHelpFormatter
    )
    parser.add_argument("task", type=Path, help="task file")
    parser.add_argument("--assets", type=Path, required=True, help="asset folder")
    parser.add_argument("--limit", type=int, default=20, help="trajectories")
    parser.add_argument(
        "--seconds", type=float, default=10.0, help="OMPL's CPU time for each query"
    )
    parser.add_argument("--json", action="store_true", help="print JSON")
    parser.add_argument(
        "--command", type=Path, default=Path(sys.executable).parent / "akrobat", help="akrobat"
    )
    given = parser.parse_args()
    report = run(given.command, given.task, given.assets, given.limit, given.seconds)
    print(json.dumps(report, indent=1) if given.json else text(report))
    return 0


if __name__ == "__main__":
    sys.exit(main())
