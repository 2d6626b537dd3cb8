"""How far one grasp opens an object, and how far two do.

    .venv/bin/python benchmarks/regrasp.py --assets ../shared/assets [TASK ...]

Every goal of a ladder is planned with `[goal] regrasps = 1`: the planner changes the grasp only
where no single grasp gives an accepted trajectory. Columns: the widest opening with one grasp, and
the widest with a change of grasp, in degrees; all of them judged. The ladder ends after two goals
in a row that neither reaches. Exit code 1 where a change of grasp gains nothing.
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

ROOT = Path(__file__).resolve().parent.parent
TASKS = ["panda_cabinet_empty", "panda_refrigerator_empty"]


def changes(task: str, goal_rad: float, arguments: argparse.Namespace, folder: Path) -> int | None:
    """Plans one goal: the changes of grasp that it took, none where nothing was accepted."""
    source = ROOT / "configs" / "tasks" / f"{task}.toml"
    goal = f"positions = [{goal_rad}]\nregrasps = 1"
    text = re.sub(r"positions = \[.*?\]", goal, source.read_text(), flags=re.DOTALL)
    text = text.replace('"../robots/', f'"{ROOT}/configs/robots/')
    text += f"\n[grasps]\ncount = {arguments.grasps}\n"
    changed, output = folder / f"{task}.toml", folder / f"{task}.h5"
    changed.write_text(text)
    output.unlink(missing_ok=True)
    command = [str(arguments.command), "--json", "plan", str(changed), "-o", str(output)]
    command += ["--limit", "1"]
    for assets in arguments.assets:
        command += ["--assets", str(assets)]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    if done.returncode not in (0, 3):
        raise SystemExit(f"{task}: {done.stderr}")
    if not json.loads(done.stdout)["accepted"]:
        return None
    with h5py.File(output) as file:
        return int(file["regrasp/offset"][1]) if "regrasp" in file else 0


def widest(task: str, arguments: argparse.Namespace) -> dict[int, float]:
    """Widest opening (rad) by number of changes of grasp."""
    best = {0: 0.0, 1: 0.0}
    goal, missed = arguments.first, 0
    with tempfile.TemporaryDirectory() as folder:
        while missed < 2 and goal <= arguments.last:
            count = changes(task, round(goal, 3), arguments, Path(folder))
            missed = missed + 1 if count is None else 0
            if count is not None:
                best[count] = goal
            print(f"{task} {math.degrees(goal):.0f} degrees: {count}", file=sys.stderr)
            goal += arguments.step
    return best


def main() -> int:
    """Prints the table."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawTextHelpFormatter
    )
    parser.add_argument("tasks", nargs="*", default=TASKS, help="names in configs/tasks")
    parser.add_argument("--assets", type=Path, action="append", default=[], help="asset folder")
    parser.add_argument("--grasps", type=int, default=8, help="grasps per task")
    parser.add_argument("--first", type=float, default=1.2, help="first goal, rad")
    parser.add_argument("--last", type=float, default=2.2, help="last goal, rad")
    parser.add_argument("--step", type=float, default=0.1, help="between goals, rad")
    parser.add_argument(
        "--command", type=Path, default=Path(sys.executable).parent / "akrobat", help="akrobat"
    )
    arguments = parser.parse_args()
    print(f"{'task':28} {'one grasp':>10} {'two grasps':>11}   (degrees)")
    gained = True
    for task in arguments.tasks:
        best = widest(task, arguments)
        gained &= best[1] > best[0]
        one, two = (math.degrees(best[count]) for count in (0, 1))
        print(f"{task:28} {one:10.0f} {two:11.0f}", flush=True)
    return 0 if gained else 1


if __name__ == "__main__":
    sys.exit(main())
