"""The frozen problem set with one and two threads: table, throughput and where the base stands.

    .venv/bin/python benchmarks/planner/frozen.py --assets ../shared/assets [--images DIR]

Runs `akrobat bench plan` once for each number of threads; prints what each problem gave, how long
the steps of one pair of start and goal take, and how much of the base and the arm moved. With
`--images`, two pictures are drawn: `planner_throughput.png` (different trajectories per second by
scene, as the paper's throughput figure, beside its two published rates) and `planner_bases.png`
(base poses at start and goal of every trajectory, as in the paper).

Rates are trajectories per second of CPU time, in the picture times the number of threads: the clock
tells what else ran, too. Needs matplotlib and h5py.
"""

from __future__ import annotations

import argparse
import json
import os
import platform
import subprocess
import sys
import tempfile
from pathlib import Path

import h5py
import numpy as np

# Episodes per second that the paper reports: cuRobo on a GPU, and its CPU baseline.
PAPER = {"paper, one GPU": 5000 / 3600, "paper, CPU": 60 / 3600}


def bench(arguments: argparse.Namespace, threads: int, keep: Path) -> dict:
    """One run of the whole set."""
    command = [str(arguments.command), "--quiet", "--json", "bench", "plan", "--keep", str(keep)]
    command += ["--threads", str(threads), "--limit", str(arguments.limit), "--seconds", "3600"]
    for assets in arguments.assets:
        command += ["--assets", str(assets)]
    done = subprocess.run(command, check=True, stdout=subprocess.PIPE)
    return json.loads(done.stdout)


def scenes(report: dict) -> dict[str, dict]:
    """Trajectories and CPU seconds of each feasible scene, in the order of the set."""
    found: dict[str, dict] = {}
    for row in report["problems"]:
        if row["feasible"]:
            own = found.setdefault(row["scene"], {"valid": 0, "cpu": 0.0, "base": [], "arm": []})
            own["valid"] += row["valid"]
            own["cpu"] += row["cpu_seconds"]
            own["base"].append(row["base_travel_m"])
            own["arm"].append(row["arm_rotation_rad"])
    return found


def tried(row: dict) -> int:
    return row["counts"].get("pairs/tried", 0)


def text(reports: list[dict]) -> str:
    """The tables, for people."""
    lines = [f"{platform.machine()}, {os.cpu_count()} cores"]
    head = f"{'problem':24}{'scene':18}{'valid':>6}{'accepted':>9}{'tried':>6}{'CPU s':>7}"
    for report in reports:
        lines += [f"\n{report['threads']} threads", f"{head}{'base m':>8}{'arm rad':>8}"]
        for row in report["problems"]:
            lines.append(
                f"{row['task']:24}{row['scene']:18}{row['valid']:6}{row['accepted']:9}"
                f"{tried(row):6}{row['cpu_seconds']:7.2f}"
                f"{row['base_travel_m']:8.2f}{row['arm_rotation_rad']:8.2f}"
            )
        for step, spread in report["step_ms"].items():
            cells = ", ".join(f"{name} {value:.2f}" for name, value in spread.items())
            lines.append(f"{step:20} {cells} ms")
        rate = report["valid"] / report["cpu_seconds"]
        lines.append(
            f"{report['valid']} valid of {report['accepted']} accepted, "
            f"{report['cpu_seconds']:.1f} s of CPU time ({report['seconds']:.1f} s of wall time): "
            f"{rate:.1f} valid per CPU second, peak {report['peak_memory_bytes'] / 1e6:.0f} MB"
        )
    return "\n".join(lines)


def throughput(reports: list[dict], path: Path) -> None:
    """Rates by scene, and what moves."""
    from matplotlib import pyplot as plt

    figure, (left, right) = plt.subplots(1, 2, figsize=(11, 4.2), layout="constrained")
    names = list(scenes(reports[0]))
    width = 0.8 / len(reports)
    for number, report in enumerate(reports):
        own = scenes(report)
        rates = [own[name]["valid"] / own[name]["cpu"] * report["threads"] for name in names]
        at = np.arange(len(names)) + (number - (len(reports) - 1) / 2) * width
        count = report["threads"]
        left.bar(at, rates, width, label=f"{count} thread{'s' if count > 1 else ''}")
    for (name, rate), style in zip(PAPER.items(), ("--", ":"), strict=True):
        left.axhline(rate, color="black", linestyle=style, linewidth=1, label=name)
    left.set_yscale("log")
    left.set_ylabel("different judged trajectories per second")
    left.set_xticks(range(len(names)), names, rotation=25, ha="right")
    left.set_ylim(1e-2, 1e3)
    left.legend(fontsize=8, ncols=2, loc="upper center")
    left.set_title("Throughput by scene (CPU time x threads), everything counted", fontsize=10)
    own = scenes(reports[-1])
    for offset, (key, label) in enumerate((("base", "base travel (m)"), ("arm", "arm (rad)"))):
        at = np.arange(len(names)) + (offset - 0.5) * 0.4
        right.bar(at, [np.mean(own[name][key]) for name in names], 0.4, label=label)
    right.set_xticks(range(len(names)), names, rotation=25, ha="right")
    right.legend(fontsize=8)
    right.set_title("What moves during the manipulation (medians)", fontsize=10)
    figure.savefig(path, dpi=110)


def base_poses(file: Path) -> tuple[np.ndarray, np.ndarray]:
    """x, y, yaw of the base at start and goal of each trajectory, world frame (m, rad)."""
    with h5py.File(file) as h:
        robot = h["waypoints/robot"][:]
        return robot[:, 0, :3], robot[:, -1, :3]


def bases(folder: Path, report: dict, path: Path) -> None:
    """Start and goal positions of the base, one panel for each problem."""
    from matplotlib import pyplot as plt

    rows = [row for row in report["problems"] if (folder / f"{row['task']}.h5").exists()]
    columns = 5
    lines = -(-len(rows) // columns)
    size = (2.6 * columns, 2.8 * lines)
    figure, axes = plt.subplots(lines, columns, figsize=size, layout="constrained", squeeze=False)
    for axis in axes.flat[len(rows) :]:
        axis.set_visible(False)
    for axis, row in zip(axes.flat, rows, strict=False):
        start, goal = base_poses(folder / f"{row['task']}.h5")
        for ends in zip(start, goal, strict=True):
            axis.plot(*zip(*[end[:2] for end in ends], strict=True), color="0.85", linewidth=0.5)
        for place, color, name in ((start, "tab:blue", "start"), (goal, "tab:red", "goal")):
            axis.quiver(
                *place[:, :2].T,
                *(np.cos(place[:, 2]), np.sin(place[:, 2])),
                color=color,
                label=name,
                scale=22,
                width=0.006,
            )
        axis.set_title(f"{row['task']} ({len(start)})", fontsize=8)
        axis.set_aspect("equal", adjustable="datalim")
        axis.tick_params(labelsize=6)
    axes.flat[0].legend(fontsize=7)
    figure.suptitle(
        "Where the base stands and looks at start and goal (world frame, m)", fontsize=10
    )
    figure.savefig(path, dpi=110)


def main() -> int:
    """Runs the set, prints the tables, draws the pictures."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawTextHelpFormatter
    )
    parser.add_argument("--assets", type=Path, action="append", default=[], help="asset folder")
    parser.add_argument("--limit", type=int, default=120, help="trajectories for each problem")
    parser.add_argument("--threads", type=int, nargs="+", default=[1, 2], help="one run for each")
    parser.add_argument("--images", type=Path, help="folder for the pictures")
    parser.add_argument("--json", action="store_true", help="print JSON")
    parser.add_argument(
        "--command", type=Path, default=Path(sys.executable).parent / "akrobat", help="akrobat"
    )
    arguments = parser.parse_args()
    with tempfile.TemporaryDirectory() as name:
        reports = [bench(arguments, threads, Path(name)) for threads in arguments.threads]
        print(json.dumps(reports, indent=1) if arguments.json else text(reports))
        if arguments.images:
            arguments.images.mkdir(parents=True, exist_ok=True)
            throughput(reports, arguments.images / "planner_throughput.png")
            bases(Path(name), reports[-1], arguments.images / "planner_bases.png")
    return 0


if __name__ == "__main__":
    sys.exit(main())
