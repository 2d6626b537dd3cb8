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
FORMATS = ("lerobot", "robomimic", "dp3", "diffusion-policy", "maniskill")

RIG = """
name = "small"
[[cameras]]
name = "ego_wrist"
width = 160
height = 120
focal_mm = 15.0
[cameras.mount]
on = "link"
link = "tool"
link_from_camera = [0.09, 0, -0.1, 0.67082, -0.223607, -0.223607, 0.67082]
[[cameras]]
name = "fixed"
width = 160
height = 120
focal_mm = 30.0
[cameras.mount]
on = "look_at_handle"
offset = [1.6, 0.8, 0.9]
"""


def make(folder: Path, assets: Path) -> None:
    """Plans, renders and exports; what is there already is kept."""
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "rig.toml").write_text(RIG)
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
                rig=folder / "rig.toml",
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
