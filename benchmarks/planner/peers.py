"""Batch inverse kinematics, ours and others': the same targets, starts and tolerance, in one run.

    python benchmarks/planner/peers.py --assets DIR [--targets 300] [--json]

The robot is Summit-Franka: ten joints from the world to the tool (base x, y, yaw and seven of the
arm). Every target is reachable: it is the tool's pose at a random configuration. Each solver gets
the same ten random starts for each target, one after the other until one is solved, and is asked
for 1 mm and 0.01 rad. What counts is what Pinocchio's kinematics find within that tolerance and the
joint limits. Times are CPU time of one thread (TRAC-IK: of its two), loading aside.

- akrobat: `planner/examples/ik_bench.rs`, Levenberg-Marquardt to 1e-6
- Pinocchio + LM: Levenberg-Marquardt of ours in Python (30 lines) on Pinocchio's kinematics and
  Jacobians, clamped to the limits; of its CPU time, that in Pinocchio's functions is told apart
- TRAC-IK (`pytracik`): KDL's Newton and an SQP side by side, 5 ms for each start
- roboplan (`roboplan`): damped pseudoinverse on Pinocchio, compiled

A solver that is not installed is listed as absent. Needs `pin` for the check.
"""

from __future__ import annotations

import argparse
import json
import os
import platform
import subprocess
import sys
import tempfile
import time
import xml.etree.ElementTree as ET
from pathlib import Path

# Idle threads of a matrix library would count as CPU time.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np
import pinocchio as pin

ROOT = Path(__file__).resolve().parents[2]
ROBOT = ROOT / "configs" / "robots" / "summit_franka.toml"
URDF = "robots/summit_xl_franka/summit_xl_franka.urdf"
JOINTS = ["base_x", "base_y", "base_z", *(f"panda_joint{i}" for i in range(1, 8))]
BASE_LINK, TIP_LINK = "world", "panda_hand"
# The tool of the robot file, in the hand's frame.
HAND_FROM_TOOL = pin.SE3(np.eye(3), np.array([0.0, 0.0, 0.1034]))
TOLERANCE = (1e-3, 1e-2)
STARTS = 10
# Our side is so short that its CPU time is taken over many rounds.
ROUNDS = "200"
# The base of a start is this near to that of the target's configuration, metres.
BASE_REACH_M = 0.8
BASE_TURN_RAD = 1.5


class Problem:
    """Targets, starts and the check of solutions."""

    def __init__(self, urdf: Path, count: int, seed: int):
        self.xml = kinematic_urdf(urdf)
        self.model = pin.buildModelFromXML(self.xml)
        assert list(self.model.names)[1:] == JOINTS
        self.data = self.model.createData()
        self.frame = self.model.getFrameId(TIP_LINK)
        self.low, self.high = self.model.lowerPositionLimit, self.model.upperPositionLimit
        rng = np.random.default_rng(seed)
        low, high = self.low.copy(), self.high.copy()
        low[:3], high[:3] = (-1, -1, -np.pi), (1, 1, np.pi)
        truths = rng.uniform(low, high, (count, len(JOINTS)))
        self.hands = [self.hand(q) for q in truths]
        starts = rng.uniform(low, high, (count, STARTS, len(JOINTS)))
        spread = np.array([BASE_REACH_M, BASE_REACH_M, BASE_TURN_RAD])
        starts[:, :, :3] = truths[:, None, :3] + rng.uniform(-spread, spread, (count, STARTS, 3))
        self.starts = starts

    def hand(self, q: np.ndarray) -> pin.SE3:
        pin.framesForwardKinematics(self.model, self.data, q)
        return self.data.oMf[self.frame].copy()

    def is_solution(self, index: int, q) -> bool:
        """Within the tolerance and the limits, by Pinocchio."""
        if q is None:
            return False
        q = np.asarray(q, dtype=float)
        if ((q < self.low - 1e-6) | (q > self.high + 1e-6)).any():
            return False
        # The errors of the tool, which is what was asked for.
        off = (self.hands[index] * HAND_FROM_TOOL).actInv(self.hand(q) * HAND_FROM_TOOL)
        distance, angle = np.linalg.norm(off.translation), np.linalg.norm(pin.log3(off.rotation))
        return bool(distance <= TOLERANCE[0] * 1.001 and angle <= TOLERANCE[1] * 1.001)


def kinematic_urdf(path: Path) -> str:
    """The chain from the world to the hand alone, without shapes and inertias."""
    root = ET.parse(path).getroot()
    above = {j.find("child").get("link"): j for j in root.findall("joint")}
    links, joints, link = {BASE_LINK}, [], TIP_LINK
    while link != BASE_LINK:
        links.add(link)
        joints.append(above[link])
        link = above[link].find("parent").get("link")
    for element in list(root):
        if element.tag == "link" and element.get("name") in links:
            for part in list(element):
                element.remove(part)
        elif element not in joints:
            root.remove(element)
    return ET.tostring(root, encoding="unicode")


def akrobat(problem: Problem, assets: Path, folder: Path) -> dict:
    """Ours, in its own process."""
    build = ["cargo", "build", "--release", "--quiet", "--workspace"]
    subprocess.run([*build, "--example", "ik_bench"], check=True, cwd=ROOT)

    def listed(hand: pin.SE3) -> list[float]:
        tool = hand * HAND_FROM_TOOL
        x, y, z, w = pin.Quaternion(tool.rotation).coeffs()
        return [*map(float, tool.translation), float(w), float(x), float(y), float(z)]

    content = {
        "robot": str(ROBOT),
        "assets": [str(assets)],
        "tolerance": TOLERANCE,
        "targets": [listed(hand) for hand in problem.hands],
        "starts": problem.starts.tolist(),
    }
    file = folder / "targets.json"
    file.write_text(json.dumps(content))
    target = Path(os.environ.get("CARGO_TARGET_DIR", ROOT / "target"))
    binary = target / "release" / "examples" / "ik_bench"
    done = subprocess.run([str(binary), str(file), ROUNDS], check=True, stdout=subprocess.PIPE)
    return json.loads(done.stdout)


class TracIk:
    """Two threads: CPU time counts both."""

    def __init__(self, problem: Problem):
        import pytracik

        self.ik = pytracik.ik
        self.solver = pytracik.TRAC_IK(
            BASE_LINK, TIP_LINK, problem.xml, 5e-3, TOLERANCE[0], pytracik.SolveType.Speed
        )
        pytracik.set_joint_limits(self.solver, list(problem.low), list(problem.high))

    def solve(self, hand: pin.SE3, start: np.ndarray):
        x, y, z, w = pin.Quaternion(hand.rotation).coeffs()
        found = self.ik(self.solver, start, *map(float, hand.translation), x, y, z, w)
        return found[1:] if found[0] >= 0 else None


class Roboplan:
    """One restart: the starts are given."""

    def __init__(self, problem: Problem):
        from roboplan import core, simple_ik

        self.core = core
        description = core.loadUrdfSceneDescriptionFromXml(problem.xml, [])
        self.scene = core.Scene("summit", description)
        options = simple_ik.SimpleIkOptions()
        options.max_linear_error_norm, options.max_angular_error_norm = TOLERANCE
        options.check_collisions = False
        options.max_restarts = 0
        options.max_time = 1.0
        options.step_size = 1.0
        options.damping = 1e-3
        self.solver = simple_ik.SimpleIk(self.scene, options)
        self.names = list(self.scene.getJointNames())
        self.goal = core.CartesianConfiguration()
        self.goal.base_frame, self.goal.tip_frame = BASE_LINK, TIP_LINK

    def solve(self, hand: pin.SE3, start: np.ndarray):
        values = np.zeros(len(self.names))
        values[[self.names.index(j) for j in JOINTS]] = start
        begin = self.core.JointConfiguration(self.names, values)
        end = self.core.JointConfiguration(self.names, values)
        self.goal.tform = np.asfortranarray(hand.homogeneous)
        if not self.solver.solveIk(self.goal, begin, end):
            return None
        return np.asarray(end.positions)[[self.names.index(j) for j in JOINTS]]


class PinocchioLm:
    """The same method as ours, on another library's kinematics; NumPy solves the small systems."""

    ITERATIONS = 60

    def __init__(self, problem: Problem):
        self.problem = problem
        self.library_seconds = 0.0

    def error(self, q: np.ndarray, target: pin.SE3) -> tuple[np.ndarray, np.ndarray]:
        """Error of the tool seen from itself, and its Jacobian."""
        begin = time.process_time()
        model, data, frame = self.problem.model, self.problem.data, self.problem.frame
        pin.framesForwardKinematics(model, data, q)
        off = target.actInv(data.oMf[frame])
        hand = pin.computeFrameJacobian(model, data, q, frame, pin.ReferenceFrame.LOCAL)
        error, jacobian = pin.log6(off).vector, pin.Jlog6(off) @ hand
        self.library_seconds += time.process_time() - begin
        return error, jacobian

    def solve(self, hand: pin.SE3, start: np.ndarray):
        q, damping = start.copy(), 1e-3
        error, jacobian = self.error(q, hand)
        for _ in range(self.ITERATIONS):
            # The hand's error, small enough that the tool, 0.1 m from it, is within the tolerance.
            if np.linalg.norm(error[:3]) < 5e-4 and np.linalg.norm(error[3:]) < 2e-3:
                return q
            normal = jacobian.T @ jacobian + damping * np.eye(len(q))
            step = np.linalg.solve(normal, jacobian.T @ error)
            trial = np.clip(q - step, self.problem.low, self.problem.high)
            trial_error, trial_jacobian = self.error(trial, hand)
            if trial_error @ trial_error < error @ error:
                q, error, jacobian = trial, trial_error, trial_jacobian
                damping = max(damping * 0.3, 1e-9)
            else:
                damping *= 4.0
        return None


PEERS = {"Pinocchio + LM": PinocchioLm, "TRAC-IK": TracIk, "roboplan": Roboplan}


def measure(name: str, peer, problem: Problem) -> dict:
    """Runs a peer on every target."""
    solved, attempts, seconds = 0, 0, 0.0
    for index, hand in enumerate(problem.hands):
        for start in problem.starts[index]:
            begin = time.process_time()
            q = peer.solve(hand, start)
            seconds += time.process_time() - begin
            attempts += 1
            if problem.is_solution(index, q):
                solved += 1
                break
    own = {"library_seconds": peer.library_seconds} if hasattr(peer, "library_seconds") else {}
    return own | {
        "name": name,
        "targets": len(problem.hands),
        "solved": solved,
        "attempts": attempts,
        "seconds": seconds,
    }


def run(assets: Path, count: int, seed: int) -> list[dict]:
    """One row for each solver."""
    problem = Problem(assets / URDF, count, seed)
    rows = []
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        own = akrobat(problem, assets, folder)
        solutions = own.pop("solutions")
        own["solved"] = sum(problem.is_solution(i, q) for i, q in enumerate(solutions))
        rows.append(own)
        for label, peer in PEERS.items():
            try:
                solver = peer(problem)
            except ImportError as error:
                rows.append({"name": label, "absent": str(error)})
                continue
            rows.append(measure(label, solver, problem))
    for row in rows:
        if "absent" not in row:
            row["solves_per_s"] = row["solved"] / row["seconds"]
        if "library_seconds" in row:
            row["solves_per_library_s"] = row["solved"] / row["library_seconds"]
    best = max((r["solves_per_s"] for r in rows[1:] if "solves_per_s" in r), default=None)
    rows[0]["times_best_peer"] = rows[0]["solves_per_s"] / best if best else None
    return rows


def text(rows: list[dict]) -> str:
    """The table, for people."""
    lines = [
        f"{platform.machine()}, {os.cpu_count()} cores; CPU time of one",
        f"{'solver':14} {'solved':>11} {'attempts':>8} {'CPU s':>8} {'solves/s':>9} {'ours is':>8}",
    ]
    for row in rows:
        if "absent" in row:
            lines.append(f"{row['name']:14} not installed ({row['absent']})")
            continue
        ratio = rows[0]["solves_per_s"] / max(row["solves_per_s"], 1e-9)
        lines.append(
            f"{row['name']:14} {row['solved']:5}/{row['targets']:5} {row['attempts']:8} "
            f"{row['seconds']:8.3f} {row['solves_per_s']:9.0f} {ratio:7.1f}x"
        )
        if "solves_per_library_s" in row:
            alone = row["solves_per_library_s"]
            ratio = rows[0]["solves_per_s"] / alone
            lines.append(f"  in the library alone {alone:.0f} solves/s: ours is {ratio:.1f}x")
    return "\n".join(lines)


def main() -> int:
    """Runs the table."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawTextHelpFormatter
    )
    parser.add_argument("--assets", type=Path, required=True, help="asset folder with the robot")
    parser.add_argument("--targets", type=int, default=300, help="number of targets")
    parser.add_argument("--seed", type=int, default=0, help="seed of targets and starts")
    parser.add_argument("--json", action="store_true", help="print JSON")
    arguments = parser.parse_args()
    rows = run(arguments.assets, arguments.targets, arguments.seed)
    print(json.dumps(rows, indent=1) if arguments.json else text(rows))
    return 0


if __name__ == "__main__":
    sys.exit(main())
