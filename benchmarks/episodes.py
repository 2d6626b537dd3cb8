"""Ten thousand small episodes through `akrobat render` and `akrobat validate`: is memory flat?

    .venv/bin/python benchmarks/episodes.py --assets ../shared/assets [--episodes 10000] [--json]

Plans a few trajectories of a real robot that opens a real drawer (or takes `--trajectories`), and
makes many short ones of them: three of their waypoints, with the base up to 2 cm to either side,
which nobody judges. One process renders them all, another validates them. The resident memory of
both is taken from /proc twice a second, together with the number of episodes that are written. The
plot goes to `--plot`.

The extrapolation multiplies what one episode took: bytes and processor seconds.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

import akrobat
import numpy as np
from akrobat.exporters import traj_data

ROOT = Path(__file__).resolve().parent.parent
TASK = ROOT / "configs" / "tasks" / "summit_drawer_empty.toml"
PLOT = ROOT / "docs" / "images" / "memory.png"
#: Waypoints of an episode, their spacing and how far a base is moved.
WAYPOINTS = 3
INTERVAL_S = 1 / 30
SHIFT_M = 0.02
SAMPLE_EVERY_S = 0.5
#: Share of a run after which memory must have stopped growing.
WARM = 0.2

RIG = """
name = "small"

[[cameras]]
name = "fixed"
width = 64
height = 48
focal_mm = 50.0
mount = { on = "look_at_handle", offset = [1.6, 0.8, 0.9] }
"""

#: What `traj_data.pt` has for each trajectory.
PER_TRAJECTORY = ("traj_robot", "traj_obj", "traj_success", "grasp_id", "grasp_pose", "goal_angle")

Samples = dict[str, list[float]]


def command(*words: Any) -> list[str]:
    return [sys.executable, "-m", "akrobat", *map(str, words)]


def run(words: list[str]) -> None:
    subprocess.run(words, check=True, capture_output=True)


def many(planned: Path, episodes: int, assets: Path, folder: Path) -> Path:
    """A trajectory file of so many short motions."""
    exported, file = folder / "traj_data", folder / "many.h5"
    words = ("--to", "automoma", "-o", exported, "--allow-non-commercial")
    run(command("export", planned, *words))
    arrays = traj_data.load(exported / "traj_data.pt")
    count = len(arrays["traj_robot"])
    chosen = np.arange(episodes) % count
    points = np.linspace(0, arrays["traj_robot"].shape[1] - 1, WAYPOINTS).round().astype(int)
    repeated = {name: np.asarray(arrays[name])[chosen] for name in PER_TRAJECTORY}
    for name in ("traj_robot", "traj_obj"):
        repeated[name] = repeated[name][:, points]
    shift = np.random.default_rng(0).uniform(-SHIFT_M, SHIFT_M, (episodes, 1, 2))
    repeated["traj_robot"][:, :, :2] += shift.astype(np.float32)
    traj_data.write(folder / "many.pt", repeated, arrays["scene_id"], arrays["object_id"])
    words = ("--task", TASK, "-o", file, "--interval", INTERVAL_S, "--assets", assets)
    run(command("import", "trajectories", folder / "many.pt", *words))
    return file


def resident_mb(process: int) -> float | None:
    """Resident memory; `None` once the process has ended."""
    try:
        lines = Path(f"/proc/{process}/status").read_text().splitlines()
    except OSError:
        return None
    kilobytes = [int(line.split()[1]) for line in lines if line.startswith("VmRSS")]
    return kilobytes[0] / 1024 if kilobytes else None


def watched(words: list[str], manifest: Path) -> tuple[dict[str, Any], Samples]:
    """Runs a command; its report and times, and its memory over time."""
    samples: Samples = {"seconds": [], "resident_mb": [], "episodes": []}
    before, started = os.times(), time.perf_counter()
    process = subprocess.Popen(words, stdout=subprocess.PIPE, text=True)
    lines = Lines(manifest)
    while process.poll() is None:
        memory = resident_mb(process.pid)
        if memory is not None:
            samples["seconds"].append(time.perf_counter() - started)
            samples["resident_mb"].append(memory)
            samples["episodes"].append(lines.count())
        time.sleep(SAMPLE_EVERY_S)
    after = os.times()
    assert process.stdout is not None
    report = json.loads(process.stdout.read())
    if process.returncode != 0:
        sys.exit(f"{words}: exit code {process.returncode}: {report}")
    cpu = after.children_user + after.children_system
    cpu -= before.children_user + before.children_system
    report["cpu_s"], report["wall_s"] = cpu, time.perf_counter() - started
    return report, samples


class Lines:
    """Counts the lines of a file that grows."""

    def __init__(self, file: Path) -> None:
        self._file, self._place, self._count = file, 0, 0

    def count(self) -> int:
        if self._file.exists():
            with self._file.open("rb") as file:
                file.seek(self._place)
                new = file.read()
            self._place += len(new)
            self._count += new.count(b"\n")
        return self._count


def growth(samples: Samples) -> dict[str, float]:
    """Memory at its most, and its median and slope once the start is over."""
    seconds, memory = (np.array(samples[key]) for key in ("seconds", "resident_mb"))
    warm = seconds >= WARM * seconds[-1]
    slope = np.polyfit(seconds[warm], memory[warm], 1)[0]
    fifth = max(1, warm.sum() // 5)
    return {
        "peak_mb": float(memory.max()),
        "early_mb": float(np.median(memory[warm][:fifth])),
        "late_mb": float(np.median(memory[warm][-fifth:])),
        "growth_mb_per_hour": float(slope * 3600),
    }


def plot(runs: dict[str, Samples], file: Path) -> None:
    import matplotlib as mpl

    mpl.use("agg")
    from matplotlib import pyplot

    figure, axes = pyplot.subplots(1, len(runs), figsize=(9, 3), sharey=True)
    for axis, (name, samples) in zip(axes, runs.items(), strict=True):
        axis.plot(samples["seconds"], samples["resident_mb"], color="tab:blue")
        axis.set_ylim(bottom=0)
        axis.set_xlabel("seconds")
        axis.set_title(f"akrobat {name}")
        if name == "render":
            episodes = axis.twinx()
            episodes.plot(samples["seconds"], samples["episodes"], color="tab:grey", ls=":")
            episodes.set_ylabel("episodes written (dotted)")
    axes[0].set_ylabel("resident memory, MB")
    figure.tight_layout()
    file.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(file, dpi=110, metadata={"Software": None})


def main() -> int:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--assets", type=Path, default=ROOT.parent / "shared" / "assets")
    parser.add_argument("--trajectories", type=Path, help="a file that was planned already")
    parser.add_argument("--episodes", type=int, default=10_000)
    parser.add_argument("--plot", type=Path, default=PLOT)
    parser.add_argument("--samples", type=Path, help="where all samples go, as JSON")
    parser.add_argument("--json", action="store_true")
    arguments = parser.parse_args()
    with tempfile.TemporaryDirectory() as temporary:
        folder = Path(temporary)
        planned = arguments.trajectories
        if planned is None:
            planned = folder / "planned.h5"
            akrobat.plan(TASK, planned, limit=20, assets=[arguments.assets], quiet=True)
        file = many(planned, arguments.episodes, arguments.assets, folder)
        (folder / "rig.toml").write_text(RIG)
        dataset = folder / "dataset"
        words = ("--backend", "soft", "--rig", folder / "rig.toml", "--cloud-points", 128)
        words = (*words, "--assets", arguments.assets, "-o", dataset)
        manifest = dataset / "manifest.jsonl"
        rendered, rendering = watched(command("--json", "-q", "render", file, *words), manifest)
        validated, validating = watched(command("--json", "-q", "validate", dataset), manifest)
        files = [path for path in dataset.rglob("*") if path.is_file()]
        size = sum(path.stat().st_size for path in files)
    runs = {"render": rendering, "validate": validating}
    plot(runs, arguments.plot)
    if arguments.samples:
        arguments.samples.write_text(json.dumps(runs))
    report = {
        "episodes": rendered["episodes"],
        "frames": rendered["frames"],
        "bytes": size,
        "files": len(files),
        "render": growth(rendering) | {key: rendered[key] for key in ("cpu_s", "wall_s")},
        "validate": growth(validating) | {key: validated[key] for key in ("cpu_s", "wall_s")},
    }
    if arguments.json:
        print(json.dumps(report, indent=1))
        return 0
    print(f"{report['episodes']} episodes, {report['frames']} frames, {size / 1e6:.1f} MB")
    for name in runs:
        row = report[name]
        print(
            f"{name:9} {row['wall_s']:6.0f} s, {row['cpu_s']:6.0f} s CPU; memory"
            f" {row['early_mb']:.0f} MB early, {row['late_mb']:.0f} MB late,"
            f" {row['peak_mb']:.0f} MB at most; {row['growth_mb_per_hour']:+.1f} MB/h"
        )
    return 0


if __name__ == "__main__":
    sys.exit(main())
