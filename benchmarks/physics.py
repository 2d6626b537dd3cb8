"""How many planned trajectories work in physics, and how fast physics runs.

    python benchmarks/physics.py --assets ../shared/assets --limit 20 summit_drawer_empty

plans each task of `configs/tasks`, drives the trajectories through PhysX and prints one row per
task: successes, clean successes, reasons of failure, and the CPU time of an episode with the part
of it that the audit takes. Times are CPU seconds (user + system) of this process, which other work
on the machine disturbs less than wall time.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
import time
import warnings
from collections import Counter
from pathlib import Path
from typing import Any

import akrobat
from akrobat.physics import PhysicsConfig, Replayer
from akrobat.physics.audit import EpisodeAudit, Recorder

TASKS = Path(__file__).parents[1] / "configs" / "tasks"
DEFAULT = (
    "summit_drawer_empty",
    "summit_cabinet_empty",
    "summit_sektion_door_left_empty",
    "summit_sektion_drawer_top_empty",
    "summit_microwave_empty",
    "summit_oven_empty",
    "summit_refrigerator_empty",
)

COLUMNS = (
    "task",
    "succeed",
    "clean",
    "failed",
    "CPU s/episode",
    "of which audit",
    "steps/CPU s",
    "episodes/CPU h",
)


class TimedRecorder(Recorder):
    """Adds up what the audit takes."""

    cpu_s = 0.0

    def note(self, *arguments: Any) -> None:
        """As the original."""
        started = time.process_time()
        super().note(*arguments)
        TimedRecorder.cpu_s += time.process_time() - started

    def finish(self, *arguments: Any) -> EpisodeAudit:
        """As the original."""
        started = time.process_time()
        audit = super().finish(*arguments)
        TimedRecorder.cpu_s += time.process_time() - started
        return audit


def main() -> None:
    """Prints the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("tasks", nargs="*", default=DEFAULT)
    parser.add_argument("--assets", type=Path, action="append", default=[])
    parser.add_argument("--limit", type=int, default=20)
    parser.add_argument("--planned", type=Path, help="folder of TASK.h5 files to use, or to fill")
    arguments = parser.parse_args()
    warnings.simplefilter("ignore")
    sys.modules["akrobat.physics.replay"].Recorder = TimedRecorder  # type: ignore[attr-defined]
    with tempfile.TemporaryDirectory() as temporary:
        folder = arguments.planned or Path(temporary)
        print(f"| {' | '.join(COLUMNS)} |")
        print("|" + "---|" * len(COLUMNS))
        for name in arguments.tasks:
            print(row(name, folder, arguments.assets, arguments.limit), flush=True)


def row(name: str, folder: Path, assets: list[Path], limit: int) -> str:
    """Plans one task, replays it and tells what came of it."""
    file = folder / f"{name}.h5"
    if not file.exists():
        akrobat.plan(TASKS / f"{name}.toml", file, limit=limit, assets=assets, quiet=True)
    trajectories = akrobat.Trajectories.read(file)
    config = PhysicsConfig.of()
    replayer = Replayer(akrobat.Task.of_trajectories(file, assets), config)
    started, TimedRecorder.cpu_s = time.process_time(), 0.0
    audits: list[EpisodeAudit] = [
        replayer.replay(trajectories, episode) for episode in range(len(trajectories))
    ]
    cpu_s = time.process_time() - started
    steps = sum(audit.findings["duration_s"] for audit in audits) / config.timestep_s
    succeeded = sum(audit.success for audit in audits)
    clean = sum(audit.findings["clean"] for audit in audits)
    reasons = Counter(audit.reason for audit in audits if not audit.success)
    failed = ", ".join(f"{count} {reason}" for reason, count in reasons.items()) or "none"
    count = len(audits)
    return (
        f"| {name} | {succeeded} of {count} | {clean} | {failed} | {cpu_s / count:.2f} "
        f"| {TimedRecorder.cpu_s / count:.2f} | {steps / cpu_s:.0f} | {3600 * count / cpu_s:.0f} |"
    )


if __name__ == "__main__":
    main()
