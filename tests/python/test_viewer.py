"""`akrobat view --save`: Rerun finds in the file what trajectory and dataset have."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from collections import defaultdict
from pathlib import Path
from typing import Any

import akrobat
import numpy as np
import pytest
from rerun.chunk import RrdReader

TASKS = Path(__file__).parents[2] / "configs" / "tasks"
EVERY = 40


def view(*words: Any, **environment: str) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-m", "akrobat", "--json", "view", *map(str, words)]
    return subprocess.run(
        command, capture_output=True, text=True, check=False, env={**os.environ, **environment}
    )


class Recording:
    """The columns of a `.rrd` file by entity and component."""

    def __init__(self, file: Path) -> None:
        self.columns: dict[str, dict[str, list[Any]]] = defaultdict(lambda: defaultdict(list))
        for chunk in RrdReader(file).stream().to_chunks():
            batch = chunk.to_record_batch()
            for name in batch.schema.names:
                if ":" in name:
                    self.columns[chunk.entity_path][name] += batch.column(name).to_pylist()

    def array(self, entity: str, component: str) -> np.ndarray:
        """One value for each instant."""
        return np.array([row[0] for row in self.columns[entity][component]])

    def below(self, entity: str) -> set[str]:
        """Names of what stands directly below an entity."""
        prefix = f"{entity}/"
        found = (path[len(prefix) :] for path in self.columns if path.startswith(prefix))
        return {path.split("/")[0] for path in found}


def test_a_trajectory_is_shown(drawer_file: Path, shared_assets: Path, tmp_path: Path) -> None:
    file = tmp_path / "drawer.rrd"
    done = view(drawer_file, "--episode", 1, "--save", file, "--assets", shared_assets)
    assert done.returncode == 0, done.stderr
    assert "RerunWarning" not in done.stderr
    report = json.loads(done.stdout)
    assert list(tmp_path.iterdir()) == [file]
    recording = Recording(file)
    planned = akrobat.Trajectories.read(drawer_file)
    assert recording.below("/joints/robot") == set(planned.robot_joints)
    assert recording.below("/joints/object") == set(planned.object_joints)
    trajectory = planned[1]
    opened = recording.array(f"/joints/object/{planned.header['active_joint']}", "Scalars:scalars")
    assert len(opened) == report["frames"]
    assert opened[0] == pytest.approx(trajectory.start, abs=1e-4)
    assert opened[-1] == pytest.approx(trajectory.goal, abs=1e-4)
    # Every link with a surface is there; the drawer's front goes as far as the joint, others rest.
    assert len(recording.below("/world/robot")) > 10
    ways = []
    for link in recording.below("/world/object"):
        at = recording.array(f"/world/object/{link}", "Transform3D:translation")
        ways.append(np.linalg.norm(at[-1] - at[0]))
        surface = recording.columns[f"/world/object/{link}/surface_0"]
        assert len(surface["Mesh3D:vertex_positions"][0]) >= 3
    ways.sort()
    assert ways[-1] == pytest.approx(abs(trajectory.goal - trajectory.start), abs=1e-3)
    assert ways[0] == pytest.approx(0, abs=1e-6)


def test_an_episode_is_shown(
    drawer_dataset: akrobat.Dataset, shared_assets: Path, tmp_path: Path
) -> None:
    file, episode = tmp_path / "episode.rrd", drawer_dataset.episodes[0]
    # The task names its robot's file from where the task stands.
    words = ("--save", file, "--every", EVERY, "--assets", shared_assets, "--assets", TASKS)
    done = view(drawer_dataset.folder, *words)
    assert done.returncode == 0, done.stderr
    assert "RerunWarning" not in done.stderr
    recording = Recording(file)
    cameras = set(map(str, episode.attributes["cameras"]))
    assert set(json.loads(done.stdout)["cameras"]) == cameras
    assert recording.below("/world/cameras") == cameras
    shown = range(0, episode.frames, EVERY)
    for camera in cameras:
        entity = f"/world/cameras/{camera}"
        assert len(recording.columns[f"{entity}/color"]["EncodedImage:blob"]) == len(shown)
        depth = recording.columns[f"{entity}/depth"]["DepthImage:buffer"]
        for frame, buffer in zip(shown, depth, strict=True):
            expected = episode.frame(frame, [f"camera_obs/{camera}_depth"])
            (expected,) = expected.values()
            found = np.array(buffer[0], dtype=np.uint8).tobytes()
            assert np.array_equal(np.frombuffer(found, expected.dtype), expected.ravel())
    joints = list(map(str, episode.attributes["robot_joints"]))
    for name, column in zip(joints, episode["obs/joint_pos"].T, strict=True):
        assert np.allclose(recording.array(f"/joints/robot/{name}", "Scalars:scalars"), column)
    clouds = recording.columns["/world/cloud"]["Points3D:positions"]
    assert np.allclose(clouds[-1], episode["point_cloud"][shown[-1], :, :3])
    # The robot is placed by the task's files, the tool is what the file says: both agree.
    tool = recording.array("/world/tool", "Transform3D:translation")
    assert np.allclose(tool, episode["obs/eef_pos"], atol=1e-6)
    links = recording.below("/world/robot")
    placed = (recording.array(f"/world/robot/{n}", "Transform3D:translation") for n in links)
    swings = [np.ptp(np.linalg.norm(link - tool, axis=1)) for link in placed]
    assert min(swings) < 1e-3, "no link keeps its distance from the tool"
    assert max(swings) > 0.01


def test_without_the_robots_files_images_are_shown(
    drawer_dataset: akrobat.Dataset, tmp_path: Path
) -> None:
    file = tmp_path / "episode.rrd"
    done = view(drawer_dataset.folder, "--save", file, "--every", EVERY, AKROBAT_ASSET_PATH="")
    assert done.returncode == 0, done.stderr
    assert "--assets" in done.stderr
    recording = Recording(file)
    assert not recording.below("/world/robot")
    assert recording.below("/world/cameras")


def test_without_rerun_the_message_says_what_to_install(
    drawer_dataset: akrobat.Dataset, tmp_path: Path
) -> None:
    (tmp_path / "rerun.py").write_text("raise ImportError('no rerun here')\n")
    paths = os.pathsep.join(filter(None, [str(tmp_path), os.environ.get("PYTHONPATH")]))
    done = view(drawer_dataset.folder, "--save", tmp_path / "x.rrd", PYTHONPATH=paths)
    assert done.returncode == 2
    assert "pip install 'akrobat[viewer]'" in done.stderr
    assert not (tmp_path / "x.rrd").exists()


def test_wrong_requests_are_bad_input(drawer_dataset: akrobat.Dataset, tmp_path: Path) -> None:
    file = tmp_path / "x.rrd"
    for words, told in (
        (("--episode", 7, "--save", file), "valid choices"),
        (("--every", 0, "--save", file), "--every"),
        (("--save", tmp_path / "none" / "x.rrd"), "cannot write"),
    ):
        done = view(drawer_dataset.folder, *words)
        assert done.returncode == 2, done.stderr
        assert told in done.stderr
    assert not file.exists()
