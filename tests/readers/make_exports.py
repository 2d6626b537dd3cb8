"""Makes real episodes of two robots and exports them: what `test_readers.py` reads.

    python tests/readers/make_exports.py FOLDER [--assets DIR]

Twelve episodes of Summit-Franka and eight of TIAGo open a drawer, seen by two small cameras.
"""

from __future__ import annotations

import argparse
import subprocess
import sys
from pathlib import Path

import akrobat

REPOSITORY = Path(__file__).resolve().parents[2]
EPISODES = {"summit": 12, "tiago": 8}
RIG = REPOSITORY / "tests" / "rigs" / "small.toml"
FORMATS = ("lerobot", "robomimic", "dp3", "diffusion-policy", "maniskill")


def make(folder: Path, assets: Path) -> None:
    """Plans, renders and exports; what is there already is kept."""
    folder.mkdir(parents=True, exist_ok=True)
    for robot, episodes in EPISODES.items():
        trajectories, dataset = folder / f"{robot}.h5", folder / f"{robot}_dataset"
        task = REPOSITORY / "configs" / "tasks" / f"{robot}_drawer_empty.toml"
        if not trajectories.exists():
            akrobat.plan(task, trajectories, limit=episodes, assets=[assets])
        if not dataset.exists():
            akrobat.render(
                trajectories,
                dataset,
                backend="soft",
                rig=RIG,
                manipulation_only=True,
                assets=[assets],
            )
        for format in FORMATS:
            export(dataset, format, folder / f"{robot}_{format}")
        export(trajectories, "automoma", folder / f"{robot}_traj_data")


def export(source: Path, format: str, output: Path) -> None:
    """Exports with the command line, unless the output is there."""
    if not output.exists():
        command = [sys.executable, "-m", "akrobat", "export", str(source), "--to", format]
        command += ["-o", str(output), "--allow-non-commercial", "--quiet"]
        subprocess.run(command, check=True)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("folder", type=Path)
    parser.add_argument("--assets", type=Path, default=REPOSITORY.parent / "shared" / "assets")
    arguments = parser.parse_args()
    make(arguments.folder, arguments.assets)
