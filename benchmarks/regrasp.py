"""How far one grasp opens an object, and how far it gets where the grasp may change on the way.

    .venv/bin/python benchmarks/regrasp.py --assets ../shared/assets [TASK ...]

Each task is planned once with a ladder of goals and `[goal] regrasps = 1`: the planner changes the
grasp only for goals that no trajectory with a single grasp reaches. Columns: the widest goal with
one grasp and with two, in degrees, each with the number of trajectories that the judge accepted.
Exit code 1 where a change of grasp gains nothing.
"""

from __future__ import annotations

import argparse
import math
import re
import subprocess
import sys
import tempfile
from pathlib import Path

import h5py
import numpy as np

ROOT = Path(__file__).resolve().parent.parent
TASKS = ["panda_cabinet_empty"]
LADDER_RAD = [0.8, 1.0, 1.2, 1.4, 1.6, 1.8, 2.0]


def accepted(task: str, arguments: argparse.Namespace, folder: Path) -> dict[float, list[int]]:
    """Accepted trajectories by goal (rad): how many with one grasp, how many with two."""
    source = ROOT / "configs" / "tasks" / f"{task}.toml"
    goal = f"positions = {LADDER_RAD}\nregrasps = 1"
    text = re.sub(r"positions = \[.*?\]", goal, source.read_text(), flags=re.DOTALL)
    text = text.replace('"../robots/', f'"{ROOT}/configs/robots/')
    text += f"\n[grasps]\ncount = {arguments.grasps}\n"
    text += "\n[planner]\nik_seeds = 200\nik_clusters = 10\npairs_per_grasp = 8\n"
    changed, output = folder / f"{task}.toml", folder / f"{task}.h5"
    changed.write_text(text)
    command = [str(arguments.command), "--quiet", "plan", str(changed), "-o", str(output)]
    command += ["--limit", str(arguments.limit)]
    for assets in arguments.assets:
        command += ["--assets", str(assets)]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    if not output.exists():
        raise SystemExit(f"{task}: {done.stderr}{done.stdout}")
    counts: dict[float, list[int]] = {}
    with h5py.File(output) as file:
        goals = file["goal"][:]
        changes = np.diff(file["regrasp/offset"][:]) if "regrasp" in file else np.zeros(len(goals))
        for reached, count in zip(goals, changes, strict=True):
            counts.setdefault(float(reached), [0, 0])[int(count)] += 1
    return counts


def main() -> int:
    """Prints the table."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawTextHelpFormatter
    )
    parser.add_argument("tasks", nargs="*", default=TASKS, help="names in configs/tasks")
    parser.add_argument("--assets", type=Path, action="append", default=[], help="asset folder")
    parser.add_argument("--grasps", type=int, default=6, help="grasps per task and end of the way")
    parser.add_argument("--limit", type=int, default=150, help="trajectories per task")
    parser.add_argument(
        "--command", type=Path, default=Path(sys.executable).parent / "akrobat", help="akrobat"
    )
    arguments = parser.parse_args()
    print(f"{'task':28} {'one grasp':>16} {'two grasps':>16}   degrees (trajectories)")
    gained = True
    for task in arguments.tasks:
        with tempfile.TemporaryDirectory() as folder:
            counts = accepted(task, arguments, Path(folder))
        best = [max((q for q, n in counts.items() if n[k]), default=0.0) for k in (0, 1)]
        gained &= best[1] > best[0]
        cells = [f"{math.degrees(q):.0f} ({counts.get(q, [0, 0])[k]})" for k, q in enumerate(best)]
        print(f"{task:28} {cells[0]:>16} {cells[1]:>16}", flush=True)
    return 0 if gained else 1


if __name__ == "__main__":
    sys.exit(main())
