"""Plans every real pair of robot and object in `configs/tasks` and prints one table.

    .venv/bin/python benchmarks/pairs.py --assets ../shared/assets [--limit 50] [PATTERN ...]

Columns: trajectories that the judge accepted, grasps and distinct starts among them (starts that
differ by more than 10 cm in base position or 0.2 rad in a joint), wall time of the whole command,
and what was rejected. Exit code 1 where a pair misses `--limit`, 3 grasps or 10 starts (with a
limit below 20, half as many starts).
"""

from __future__ import annotations

import argparse
import fnmatch
import json
import os
import platform
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import h5py
import numpy as np

ROOT = Path(__file__).resolve().parent.parent
LEAST_GRASPS = 3
LEAST_STARTS = 10


def distinct_starts(starts: np.ndarray) -> int:
    """Number of start configurations `[N, dof]` (base x, y, yaw first) that count as different."""
    kept: list[np.ndarray] = []
    for start in starts:
        same = (
            np.hypot(*(start[:2] - other[:2])) <= 0.1 and np.abs(start[2:] - other[2:]).max() <= 0.2
            for other in kept
        )
        if not any(same):
            kept.append(start)
    return len(kept)


def plan(task: Path, arguments: argparse.Namespace, folder: Path) -> dict:
    """Plans one task with the installed command and counts what it wrote."""
    output = folder / f"{task.stem}.h5"
    command = [str(Path(sys.executable).parent / "akrobat"), "--json", "plan", str(task)]
    command += ["-o", str(output), "--limit", str(arguments.limit)]
    for assets in arguments.assets:
        command += ["--assets", str(assets)]
    started = time.perf_counter()
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    row = {
        "task": task.stem,
        "seconds": time.perf_counter() - started,
        "exit_code": done.returncode,
    }
    report = json.loads(done.stdout) if done.stdout else {"error": done.stderr}
    row |= {"accepted": report.get("accepted", 0), "grasps": 0, "starts": 0}
    counts = report.get("counts", {})
    row["refused"] = {k: v for k, v in counts.items() if k.startswith(("rejected/", "failed/"))}
    row["error"] = report.get("error", "")
    if output.exists():
        with h5py.File(output) as file:
            row["grasps"] = len(np.unique(file["grasp/id"][:]))
            row["starts"] = distinct_starts(file["waypoints/robot"][:, 0, :])
    return row


def passes(row: dict, limit: int) -> bool:
    """True where a pair gives what is asked of each."""
    enough = row["accepted"] >= limit and row["grasps"] >= LEAST_GRASPS
    return enough and row["starts"] >= min(LEAST_STARTS, limit // 2)


def text(rows: list[dict], limit: int) -> str:
    """The table, for people."""
    lines = [
        f"{platform.machine()}, {os.cpu_count()} cores; at least {limit} wanted",
        f"{'task':36} {'accepted':>8} {'grasps':>6} {'starts':>6} {'seconds':>8}  refused",
    ]
    for row in rows:
        refused = ", ".join(f"{k.split('/')[1]} {v}" for k, v in row["refused"].items())
        mark = "" if passes(row, limit) else "  <- misses"
        lines.append(
            f"{row['task']:36} {row['accepted']:8} {row['grasps']:6} {row['starts']:6} "
            f"{row['seconds']:8.1f}  {refused or row['error']}{mark}"
        )
    return "\n".join(lines)


def main() -> int:
    """Runs the table."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawTextHelpFormatter
    )
    parser.add_argument("patterns", nargs="*", default=["*"], help="tasks to run, by name with *")
    parser.add_argument("--assets", type=Path, action="append", default=[], help="asset folder")
    parser.add_argument("--limit", type=int, default=50, help="trajectories per pair")
    parser.add_argument("--json", action="store_true", help="print JSON")
    arguments = parser.parse_args()
    tasks = sorted((ROOT / "configs" / "tasks").glob("*.toml"))
    tasks = [t for t in tasks if any(fnmatch.fnmatch(t.stem, p) for p in arguments.patterns)]
    rows = []
    with tempfile.TemporaryDirectory() as folder:
        for task in tasks:
            rows.append(plan(task, arguments, Path(folder)))
            print(".", end="", flush=True, file=sys.stderr)
    print(file=sys.stderr)
    print(json.dumps(rows, indent=1) if arguments.json else text(rows, arguments.limit))
    return 0 if all(passes(row, arguments.limit) for row in rows) else 1


if __name__ == "__main__":
    sys.exit(main())
