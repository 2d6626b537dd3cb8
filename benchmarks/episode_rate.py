"""What a whole episode costs: 120 frames of three cameras, clouds and packaging.

    .venv/bin/python benchmarks/episode_rate.py --assets ../shared/assets [--json]

Plans a few trajectories of Summit-Franka, which opens a microwave oven in the furnished
`infinigen_kitchen_1`, and renders them with the defaults: the paper's three cameras of 320 x 240
(colour, depth, segmentation), a cloud of 4,096 points a frame, gzip shards. One episode is rendered
on one thread, then several; what the others take more is what a frame costs once everything is
loaded. Processor time counts, user and system, and the most memory that a process had.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import tempfile
from dataclasses import asdict, dataclass
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
TASK = ROOT / "configs" / "tasks" / "summit_microwave_kitchen.toml"
FRAMES = 120


@dataclass
class Run:
    """One `akrobat render`."""

    episodes: int
    frames: int
    cpu_s: float
    bytes: int
    peak_mb: float


def akrobat(*words: object) -> tuple[str, os.resource_usage]:
    """Runs the command: what it printed and used. This process stays small, for it counts too."""
    command = [sys.executable, "-m", "akrobat", "--json", "-q", *map(str, words)]
    process = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)
    assert process.stdout is not None
    printed = process.stdout.read()
    _, status, used = os.wait4(process.pid, 0)
    # Exit code 3: some episode was left out, which the report says.
    if os.waitstatus_to_exitcode(status) not in (0, 3):
        sys.exit(f"{command} failed")
    return printed, used


def render(planned: Path, chosen: str, assets: Path, dataset: Path) -> Run:
    """Renders the chosen episodes on one thread."""
    words = ("--backend", "soft", "--episodes", chosen, "--threads", 1, "--assets", assets)
    printed, used = akrobat("render", planned, "-o", dataset, *words)
    report = json.loads(printed)
    size = sum(path.stat().st_size for path in dataset.rglob("*") if path.is_file())
    cpu_s, peak_mb = used.ru_utime + used.ru_stime, used.ru_maxrss / 1024
    return Run(report["episodes"], report["frames"], cpu_s, size, peak_mb)


def main() -> int:
    """Runs the benchmark."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--assets", type=Path, default=ROOT.parent / "shared" / "assets")
    parser.add_argument("--episodes", type=int, default=6, help="trajectories that are planned")
    parser.add_argument("--json", action="store_true")
    arguments = parser.parse_args()
    with tempfile.TemporaryDirectory() as temporary:
        folder = Path(temporary)
        planned = folder / "planned.h5"
        words = ("--limit", arguments.episodes, "--assets", arguments.assets)
        akrobat("plan", TASK, "-o", planned, *words)
        one = render(planned, "0", arguments.assets, folder / "one")
        all_of_them = f"0-{arguments.episodes - 1}"
        many = render(planned, all_of_them, arguments.assets, folder / "many")
    more = many.frames - one.frames
    frame_s = (many.cpu_s - one.cpu_s) / more
    report = {
        "runs": [asdict(run) for run in (one, many)],
        "cpu_ms_per_frame": 1e3 * frame_s,
        "bytes_per_frame": (many.bytes - one.bytes) / more,
        "episodes_per_hour_and_core": 3600 / (FRAMES * frame_s),
        "peak_mb": many.peak_mb,
    }
    if arguments.json:
        print(json.dumps(report, indent=1))
        return 0
    print(
        f"{report['cpu_ms_per_frame']:.1f} CPU-ms and {report['bytes_per_frame'] / 1e3:.0f} kB a"
        f" frame; {report['episodes_per_hour_and_core']:.0f} episodes of {FRAMES} frames an hour"
        f" and core; {report['peak_mb']:.0f} MB at most"
    )
    return 0


if __name__ == "__main__":
    sys.exit(main())
