"""Recordings of other tools become trajectories that render to what was recorded."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import akrobat
import h5py
import numpy as np
import pytest
from exports import export, refused, run

REPOSITORY = Path(__file__).parents[2]
TASK = REPOSITORY / "configs" / "tasks" / "summit_drawer_empty.toml"
#: Where each format keeps its recording.
FILES = {"automoma": "recording.hdf5", "maniskill": "trajectory.h5"}


@pytest.fixture(scope="module")
def recordings(
    drawer_dataset: akrobat.Dataset, tmp_path_factory: pytest.TempPathFactory
) -> dict[str, Path]:
    """A real episode in each format."""
    folder = tmp_path_factory.mktemp("recordings")
    return {
        format: export(drawer_dataset.folder, format, folder / format) / file
        for format, file in FILES.items()
    }


def imported(recording: Path, output: Path, assets: Path, *options: object) -> dict[str, object]:
    result = run(
        *("import", "trajectories", recording, "--task", TASK, "-o", output, "--assets", assets),
        *("--json", *options),
    )
    assert result.returncode == 0, result.stderr
    return dict(json.loads(result.stdout))


@pytest.mark.parametrize("format", FILES)
def test_frames_are_kept_and_the_grasp_is_found(
    recordings: dict[str, Path],
    drawer_dataset: akrobat.Dataset,
    shared_assets: Path,
    tmp_path: Path,
    format: str,
) -> None:
    report = imported(recordings[format], tmp_path / "a.h5", shared_assets)
    assert (report["tool"], report["trajectories"], report["skipped"]) == (format, 1, [])
    episode = drawer_dataset.episodes[0]
    with h5py.File(tmp_path / "a.h5") as file:
        assert np.array_equal(file["dense/robot"][()], episode["obs/joint_pos"])
        assert file["goal"][0] == pytest.approx(episode.attributes["goal_angle"], abs=1e-3)
        # The tool held the handle as it was planned to.
        pose, expected = file["grasp/pose"][0], episode.attributes["grasp_pose"]
    assert np.allclose(pose[:3], expected[:3], atol=2e-3)
    assert abs(pose[3:] @ expected[3:]) > 0.9999


def test_what_is_imported_renders_to_what_was_recorded(
    recordings: dict[str, Path],
    drawer_dataset: akrobat.Dataset,
    shared_assets: Path,
    tmp_path: Path,
) -> None:
    imported(recordings["automoma"], tmp_path / "a.h5", shared_assets)
    again = akrobat.render(
        tmp_path / "a.h5",
        tmp_path / "dataset",
        backend="soft",
        assets=[shared_assets],
        quiet=True,
    )
    before, after = drawer_dataset.episodes[0], again.episodes[0]
    assert np.array_equal(after["obs/joint_pos"], before["obs/joint_pos"])
    camera = str(before.attributes["cameras"][-1])
    images = [episode[f"camera_obs/{camera}_rgb"].astype(int) for episode in (before, after)]
    assert np.abs(images[0] - images[1]).mean() < 0.5
    assert np.abs(images[0] - images[1][::-1]).mean() > 0.5, "the wrong order passes"


def test_waypoints_of_traj_data(drawer_file: Path, shared_assets: Path, tmp_path: Path) -> None:
    tensors = export(drawer_file, "automoma", tmp_path / "traj") / "traj_data.pt"
    report = imported(tensors, tmp_path / "a.h5", shared_assets)
    assert (report["tool"], report["trajectories"]) == ("automoma", 2)
    with h5py.File(tmp_path / "a.h5") as file, h5py.File(drawer_file) as planned:
        assert np.array_equal(file["waypoints/robot"][()], planned["waypoints/robot"][()])
        assert np.array_equal(file["waypoints/object"][()], planned["waypoints/object"][()])


def test_the_judge_refuses_a_recording_that_lets_go(
    recordings: dict[str, Path], shared_assets: Path, tmp_path: Path
) -> None:
    changed = changed_copy(recordings["automoma"], tmp_path)
    with h5py.File(changed, "r+") as file:
        states = file["data/demo_0/states/articulation"]
        robot = next(states[n] for n in states if states[n]["joint_position"].shape[1] > 6)
        position = robot["joint_position"][()]
        # The base rolls away while the drawer opens.
        position[:, 0] += np.linspace(0, 0.1, len(position))
        robot["joint_position"][...] = position
    for recording, accepted in [(recordings["automoma"], 1), (changed, 0)]:
        report = imported(recording, tmp_path / f"{accepted}.h5", shared_assets, "--judge")
        assert (report["trajectories"], report["accepted"]) == (1, accepted)


def test_failures_and_stillness_are_left_out(
    recordings: dict[str, Path], shared_assets: Path, tmp_path: Path
) -> None:
    changed = changed_copy(recordings["automoma"], tmp_path)
    with h5py.File(changed, "r+") as file:
        file.copy("data/demo_0", "data/demo_1")
        file.copy("data/demo_0", "data/demo_2")
        file["data/demo_1"].attrs["success"] = False
        states = file["data/demo_2/states/articulation"]
        for name in states:
            positions = states[name]["joint_position"]
            if positions.shape[1] < 6:
                positions[...] = np.zeros(positions.shape, np.float32)
    command = ["import", "trajectories", changed, "--task", TASK, "--assets", shared_assets]
    result = run(*command, "-o", tmp_path / "a.h5", "--json")
    assert result.returncode == 3, result.stderr
    report = json.loads(result.stdout)
    assert report["trajectories"] == 1
    assert report["skipped"] == [
        "demo_1: the recorder did not call it a success",
        "demo_2: the driven joint never moves",
    ]
    result = run(*command, "-o", tmp_path / "b.h5", "--keep-failures", "--json")
    assert json.loads(result.stdout)["trajectories"] == 2


def test_the_sign_of_the_object_is_a_choice(
    recordings: dict[str, Path], shared_assets: Path, tmp_path: Path
) -> None:
    imported(recordings["automoma"], tmp_path / "a.h5", shared_assets)
    imported(recordings["automoma"], tmp_path / "b.h5", shared_assets, "--object-sign", "-1")
    with h5py.File(tmp_path / "a.h5") as plus, h5py.File(tmp_path / "b.h5") as minus:
        assert np.array_equal(plus["dense/object"][()], -minus["dense/object"][()])
        assert np.abs(plus["dense/object"][()]).max() > 0


@pytest.mark.parametrize("format", FILES)
def test_wrong_recordings_are_refused(
    recordings: dict[str, Path], shared_assets: Path, tmp_path: Path, format: str
) -> None:
    command = ["import", "trajectories", "--task", TASK, "--assets", shared_assets]
    output = tmp_path / "a.h5"
    whole = recordings[format].read_bytes()
    broken = tmp_path / "broken.h5"
    for content in (b"", whole[: len(whole) // 2], b"not HDF5" * 100):
        broken.write_bytes(content)
        assert str(broken) in refused(*command, broken, "-o", output)
    narrow = changed_copy(recordings[format], tmp_path)
    with h5py.File(narrow, "r+") as file:
        drop_a_robot_column(file)
    assert "robot columns" in refused(*command, narrow, "-o", output)
    for options in (["--interval", "0"], ["--object-sign", "2"]):
        assert options[0] in refused(*command, recordings[format], "-o", output, *options)
    assert not output.exists()


def changed_copy(recording: Path, folder: Path) -> Path:
    """A copy to be changed."""
    return Path(shutil.copy(recording, folder / "changed.h5"))


def drop_a_robot_column(file: h5py.File) -> None:
    """Takes three of the robot's joints away: no robot of the task has so few."""
    if "data" in file:
        states, name = file["data/demo_0/states/articulation"], "joint_position"
        places = [(states[n], name) for n in states]
    else:
        states = file["traj_0/env_states/articulations"]
        places = [(states, n) for n in states]
    group, name = max(places, key=lambda place: place[0][place[1]].shape[1])
    values = group[name][()]
    del group[name]
    group[name] = values[:, :-6] if "data" not in file else values[:, :-3]
