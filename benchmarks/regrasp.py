"""How far one grasp opens an object, and how far it gets where the grasp may change on the way.

    .venv/bin/python benchmarks/regrasp.py --assets ../shared/assets [TASK ...]

Each task is planned once with a ladder of goals and `[goal] regrasps = 1`: the planner changes the
grasp only for goals that no trajectory with a single grasp reaches. Then the goals beyond are tried
again with single grasps alone and all the effort that planning takes by default: 20 grasps, 1000
seeds for each. Columns: the widest goal with one grasp, with one grasp and that effort, and with
two grasps, in degrees, each with the number of trajectories that the judge accepted. Exit code 1
where a change of grasp gains nothing.
"""

from __future__ import annotations

import argparse
import json
import math
import re
import subprocess
import sys
import tempfile
from pathlib import Path

import h5py
import numpy as np

ROOT = Path(__file__).resolve().parent.parent
# Goals, rad: those of the Sektion door end at its limit.
LADDERS_RAD = {
    "panda_cabinet_empty": [0.8, 1.0, 1.2, 1.4, 1.6, 1.8, 2.0],
    "panda_sektion_door_right_empty": [0.7, 0.8, 0.9, 1.0, 1.1, 1.2, 1.3, 1.4, 1.5, 1.55],
}
QUICK = {"grasps": 6, "ik_seeds": 200, "ik_clusters": 10, "pairs_per_grasp": 8}
THOROUGH = {"grasps": 20, "ik_seeds": 1000, "ik_clusters": 30, "pairs_per_grasp": 60}


def accepted(
    task: str, goals: list[float], regrasps: int, effort: dict, arguments: argparse.Namespace
) -> dict[float, list[int]]:
    """Accepted trajectories by goal (rad): how many with one grasp, how many with two."""
    settings = dict(effort)
    source = ROOT / "configs" / "tasks" / f"{task}.toml"
    replaced = f"positions = {goals}\nregrasps = {regrasps}"
    text = re.sub(r"positions = \[.*?\]", replaced, source.read_text(), flags=re.DOTALL)
    text = text.replace('"../robots/', f'"{ROOT}/configs/robots/')
    text += f"\n[grasps]\ncount = {settings.pop('grasps')}\n\n[planner]\n"
    text += "".join(f"{name} = {value}\n" for name, value in settings.items())
    with tempfile.TemporaryDirectory() as name:
        changed, output = Path(name) / f"{task}.toml", Path(name) / f"{task}.h5"
        changed.write_text(text)
        command = [str(arguments.command), "--quiet", "--json", "plan", str(changed)]
        command += ["-o", str(output), "--limit", str(arguments.limit)]
        for assets in arguments.assets:
            command += ["--assets", str(assets)]
        done = subprocess.run(command, capture_output=True, text=True, check=False)
        # 3: planned, but nothing was accepted.
        if done.returncode not in (0, 3):
            raise SystemExit(f"{task}: {done.stderr}{done.stdout}")
        if json.loads(done.stdout)["accepted"] == 0:
            return {}
        return by_goal(output)


def by_goal(output: Path) -> dict[float, list[int]]:
    """Trajectories of a file by goal (rad): how many with one grasp, how many with two."""
    counts: dict[float, list[int]] = {}
    with h5py.File(output) as file:
        goals = file["goal"][:]
        changes = np.diff(file["regrasp/offset"][:]) if "regrasp" in file else np.zeros(len(goals))
        for reached, count in zip(goals, changes, strict=True):
            counts.setdefault(float(reached), [0, 0])[int(count)] += 1
    return counts


def widest(counts: dict[float, list[int]], changes: int) -> tuple[float, int]:
    """The widest goal (rad) that is reached with this many changes, and by how many."""
    reached = [(goal, own[changes]) for goal, own in counts.items() if own[changes]]
    return max(reached, default=(0.0, 0))


def measure(task: str, arguments: argparse.Namespace) -> dict:
    """Widest goals of a task, each with the number of its trajectories."""
    ladder = LADDERS_RAD.get(task, LADDERS_RAD["panda_cabinet_empty"])
    counts = accepted(task, ladder, 1, QUICK, arguments)
    one, two = widest(counts, 0), widest(counts, 1)
    beyond = [goal for goal in ladder if goal > one[0]]
    thorough = accepted(task, beyond, 0, THOROUGH, arguments) if beyond else {}
    return {"task": task, "one": one, "one_thorough": max(one, widest(thorough, 0)), "two": two}


def main() -> int:
    """Prints the table."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawTextHelpFormatter
    )
    parser.add_argument("tasks", nargs="*", default=list(LADDERS_RAD), help="in configs/tasks")
    parser.add_argument("--assets", type=Path, action="append", default=[], help="asset folder")
    parser.add_argument("--limit", type=int, default=150, help="trajectories per task")
    parser.add_argument("--json", action="store_true", help="print JSON, angles in rad")
    parser.add_argument(
        "--command", type=Path, default=Path(sys.executable).parent / "akrobat", help="akrobat"
    )
    arguments = parser.parse_args()
    columns = ["one grasp", "with more effort", "two grasps"]
    if not arguments.json:
        print(f"{'task':30}" + "".join(f"{c:>18}" for c in columns) + "   degrees (trajectories)")
    rows = []
    for task in arguments.tasks:
        row = measure(task, arguments)
        rows.append(row)
        cells = [f"{math.degrees(q):.0f} ({n})" for q, n in list(row.values())[1:]]
        if not arguments.json:
            print(f"{task:30}" + "".join(f"{cell:>18}" for cell in cells), flush=True)
    if arguments.json:
        print(json.dumps(rows, indent=1))
    return 0 if all(row["two"][0] > row["one_thorough"][0] for row in rows) else 1


if __name__ == "__main__":
    sys.exit(main())
