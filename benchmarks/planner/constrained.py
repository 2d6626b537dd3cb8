"""Trajectories that hold an anchor: ours and others' on the same AKR, starts and goals, one judge.

    python benchmarks/planner/constrained.py --assets DIR [TASK.toml ...] [--queries 8] [--json]

For each task, queries are drawn without any planner (`akr_queries.py`): Newton's method on
Pinocchio's kinematics of the AKR's URDF (`planner/examples/akr_urdf.rs`), from random
configurations near the object, gives a start and, near it, a goal at which the joint is open; the
external judge finds nothing in contact at either. Only the grasps are those of `akrobat plan`.
Queries at whose ends our spheres, thicker than the robot, touch something are left out and
counted. A query may well have no solution.

- akrobat: `planner/examples/constrained_bench.rs`: one optimisation, dense samples, its own check
- OMPL: RRT-Connect in a projected state space (Kingston, Moll and Kavraki, IJRR 2019) with a limit
  of CPU time for each query, then OMPL's own simplification. The constraint is that the object's
  root stays where it is, value and Jacobian by Pinocchio; what is free of collisions, coal decides
  (pairs, shapes and tolerances of the external judge). Both are called from C++ through Python, so
  the table also says how much CPU time is left without these calls
- TrajOpt (Tesseract): the same constraint, as many waypoints as ours; it is spared collisions

All give dense samples, which get times that respect the joints' speeds and are judged by
`external_judge.py`: anchor within 1 mm and 0.01 rad, limits, collisions, at every sample and in the
middle of every two. Needs `pin`, `trimesh`, h5py, and `ompl` and `tesseract-robotics` for the
peers; a peer that is not installed is left out, and said to be.
"""

from __future__ import annotations

import argparse
import importlib
import json
import os
import platform
import subprocess
import sys
import tempfile
from collections import Counter
from itertools import compress
from pathlib import Path

# Idle threads of a matrix library would count as CPU time.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import external_judge
import h5py
import numpy as np
from akr_queries import Akr, Grasped, draw_queries

ROOT = Path(__file__).resolve().parents[2]
TASKS = ["summit_drawer_empty", "summit_sektion_door_right_empty", "summit_cabinet_kitchen"]
# Our side is so short that its CPU time is taken over many rounds.
ROUNDS = "20"
OURS = "akrobat"
TOUCHES = "start or goal touches something"
PEERS = {"OMPL": "peer_ompl", "TrajOpt": "peer_trajopt"}


def build_examples(*names: str) -> None:
    """All of the workspace, or Cargo chooses other features and compiles everything again."""
    command = ["cargo", "build", "--release", "--quiet", "--workspace"]
    for name in names:
        command += ["--example", name]
    subprocess.run(command, check=True, cwd=ROOT)


def example(name: str) -> Path:
    target = Path(os.environ.get("CARGO_TARGET_DIR", ROOT / "target"))
    return target / "release" / "examples" / name


def plan_ours(task: Path, assets: Path, queries: list[dict], folder: Path) -> list[dict]:
    """All queries of a task, in a process of its own."""
    file = folder / "queries.json"
    content = {"task": str(task), "assets": [str(assets)], "queries": queries}
    file.write_text(json.dumps(content))
    command = [str(example("constrained_bench")), str(file), ROUNDS]
    done = subprocess.run(command, check=True, stdout=subprocess.PIPE)
    return json.loads(done.stdout)["answers"]


def grasps_of(file: Path) -> list[dict]:
    """The different grasps of a trajectory file."""
    found: dict[str, dict] = {}
    with h5py.File(file) as h:
        for link, tool, width, robot in zip(
            h["grasp/link"],
            h["grasp/pose"],
            h["grasp/width"],
            h["waypoints/robot"],
            strict=True,
        ):
            grasp = {
                "link": link.decode() if isinstance(link, bytes) else link,
                "link_from_tool": [float(v) for v in tool],
                "width_m": float(width),
                "fingers": [float(v) for v in robot[0, -2:]],
            }
            found.setdefault(json.dumps(grasp), grasp)
    return list(found.values())


def akr_of(task: Path, assets: Path, grasp: dict) -> Akr:
    numbers = " ".join(map(repr, grasp["link_from_tool"]))
    command = [str(example("akr_urdf")), str(task), str(assets), grasp["link"], numbers]
    done = subprocess.run([*command, repr(grasp["width_m"])], check=True, stdout=subprocess.PIPE)
    return Akr(json.loads(done.stdout))


def run(given: argparse.Namespace, task: Path, folder: Path, peers: dict) -> list[dict]:
    """Rows of one task, for each planner."""
    output = folder / f"{task.stem}.h5"
    command = [str(given.command), "--quiet", "--json", "plan", str(task), "-o", str(output)]
    command += ["--limit", "12", "--assets", str(given.assets)]
    subprocess.run(command, check=True, stdout=subprocess.DEVNULL)
    file = external_judge.File(output, [given.assets])
    holds = [
        Grasped(file, akr_of(task, given.assets, grasp), grasp)
        for grasp in grasps_of(output)[: given.grasps]
    ]
    drawn = draw_queries(holds, 2 * given.queries, np.random.default_rng(given.seed))
    ours = plan_ours(task, given.assets, [query for _, query in drawn], folder)
    fits = [answer["reason"] != TOUCHES for answer in ours]
    left_out = fits.count(False)
    print(f"{task.stem}: of {len(drawn)} queries {left_out} are left out", file=sys.stderr)
    drawn = list(compress(drawn, fits))[: given.queries]
    answers = {OURS: list(compress(ours, fits))[: given.queries]}
    for name, peer in peers.items():
        answers[name] = [peer.plan(hold, query, given.seconds) for hold, query in drawn]
    return [row(task.stem, name, drawn, own) for name, own in answers.items()]


def row(task: str, planner: str, drawn: list[tuple], answers: list[dict]) -> dict:
    """What became of the queries of one task."""
    good, lengths, refused = [], [], Counter()
    for (hold, query), answer in zip(drawn, answers, strict=True):
        if answer["path"] is None:
            refused[answer["reason"]] += 1
            good.append(False)
            continue
        path = np.array(answer["path"])
        finding = hold.finding(f"{planner} {task}", path, query)
        good.append(finding.refused is None)
        if finding.refused:
            refused[f"judge: {finding.refused}"] += 1
        else:
            lengths.append(float(np.linalg.norm(np.diff(path[:, :-1], axis=0), axis=1).sum()))
    return {
        "task": task,
        "planner": planner,
        "queries": len(answers),
        "solved": sum(a["path"] is not None for a in answers),
        "judged_good": sum(good),
        "good": good,
        "cpu_s": [a["cpu_s"] for a in answers],
        "uncalled_s": [a["cpu_s"] - a.get("called_s", 0.0) for a in answers],
        "lengths": lengths,
        "reasons": dict(refused),
    }


def joined(rows: list[dict], planner: str) -> dict:
    """All tasks together."""
    own = [r for r in rows if r["planner"] == planner]
    out = {"task": "all", "planner": planner}
    for key in ("queries", "solved", "judged_good"):
        out[key] = sum(r[key] for r in own)
    for key in ("good", "cpu_s", "uncalled_s", "lengths"):
        out[key] = [value for r in own for value in r[key]]
    out["reasons"] = dict(sum((Counter(r["reasons"]) for r in own), Counter()))
    return out


def text(rows: list[dict], seconds: float) -> str:
    """The table, for people."""
    lines = [
        f"{platform.machine()}, {os.cpu_count()} cores; CPU time; peers have {seconds:g} s a query",
        f"{'task':34}{'planner':9}{'solved':>9}{'judged good':>12}{'median s':>10}{'p95 s':>9}"
        f"{'good per CPU s':>15}{'calls free':>11}{'length':>7}",
    ]
    for r in rows:
        spent, free = sum(r["cpu_s"]), sum(r["uncalled_s"])
        length = np.median(r["lengths"]) if r["lengths"] else float("nan")
        lines.append(
            f"{r['task']:34}{r['planner']:9}{r['solved']:5}/{r['queries']:3}{r['judged_good']:12}"
            f"{np.median(r['cpu_s']):10.4f}{np.quantile(r['cpu_s'], 0.95):9.4f}"
            f"{r['judged_good'] / spent:15.2f}{r['judged_good'] / free:11.2f}{length:7.2f}"
        )
    everything = {r["planner"]: r for r in rows if r["task"] == "all"}
    for name, r in everything.items():
        reasons = ", ".join(f"{count} {reason}" for reason, count in r["reasons"].items())
        lines.append(f"{name}, not good: {reasons or 'none'}")
    ours = everything.pop(OURS)

    def rate(r: dict, key: str) -> float:
        return r["judged_good"] / sum(r[key])

    for name, r in everything.items():
        both = sum(a and b for a, b in zip(ours["good"], r["good"], strict=True))
        own, other = ours["judged_good"] - both, r["judged_good"] - both
        times, free = (rate(ours, "cpu_s") / rate(r, key) for key in ("cpu_s", "uncalled_s"))
        lines.append(
            f"good by both {both}, by {OURS} alone {own}, by {name} alone {other}; good per CPU "
            f"second: {times:.0f} times {name}'s, {free:.0f} times if its calls cost nothing"
        )
    return "\n".join(lines)


def main() -> int:
    """Runs the comparison."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawTextHelpFormatter
    )
    parser.add_argument("task", type=Path, nargs="*", help=f"task files; {', '.join(TASKS)}")
    parser.add_argument("--assets", type=Path, required=True, help="asset folder")
    parser.add_argument("--queries", type=int, default=8, help="queries of each task")
    parser.add_argument("--grasps", type=int, default=4, help="grasps of each task, at most")
    parser.add_argument("--seconds", type=float, default=20.0, help="CPU time of peers for a query")
    parser.add_argument("--seed", type=int, default=0, help="seed of the queries and of peers")
    parser.add_argument("--json", action="store_true", help="print JSON")
    parser.add_argument(
        "--command", type=Path, default=ROOT / "target" / "release" / "akrobat", help="akrobat"
    )
    given = parser.parse_args()
    build_examples("akr_urdf", "constrained_bench")
    peers = {}
    for name, module in PEERS.items():
        try:
            peers[name] = importlib.import_module(module)
        except ImportError as error:
            print(f"{name} is left out: {error}", file=sys.stderr)
            continue
        peers[name].prepare(given.seed)
    tasks = given.task or [ROOT / "configs" / "tasks" / f"{name}.toml" for name in TASKS]
    rows = []
    with tempfile.TemporaryDirectory() as folder:
        for task in tasks:
            rows += run(given, task.resolve(), Path(folder), peers)
    rows += [joined(rows, name) for name in [OURS, *peers]]
    print(json.dumps(rows, indent=1) if given.json else text(rows, given.seconds))
    return 0


if __name__ == "__main__":
    sys.exit(main())
