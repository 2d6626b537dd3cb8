"""The Python API on a real robot and a real drawer."""

from __future__ import annotations

import pickle
from pathlib import Path

import akrobat
import numpy as np
import pytest


def test_trajectories_are_judged_and_on_the_grid(drawer_file: Path) -> None:
    trajectories = akrobat.open(drawer_file)
    assert isinstance(trajectories, akrobat.Trajectories)
    assert len(trajectories) == 2
    for trajectory in trajectories:
        assert trajectory.verdict is not None
        assert trajectory.verdict["rejection"] is None
        assert trajectory.waypoints_robot.shape == (30, len(trajectories.robot_joints))
        assert trajectory.waypoints_object.shape == (30, len(trajectories.object_joints))
        assert np.all(np.diff(trajectory.times_s) > 0)
        assert len(trajectory.robot) == len(trajectory.times_s) == len(trajectory.phase)
        driven = trajectories.object_joints.index(trajectories.header["active_joint"])
        travel = trajectory.waypoints_object[:, driven]
        assert travel[0] == pytest.approx(trajectory.start, abs=1e-3)
        assert travel[-1] == pytest.approx(trajectory.goal, abs=1e-2)
        robot, _ = trajectory.sample(0.0)
        np.testing.assert_array_equal(robot, trajectory.robot[0].astype(np.float64))


def test_sequences_index_from_both_ends(drawer_file: Path) -> None:
    trajectories = akrobat.Trajectories.read(drawer_file)
    assert trajectories[-1].id == trajectories[1].id != trajectories[0].id
    with pytest.raises(IndexError):
        trajectories[2]


def test_the_same_seed_gives_the_same_bytes_on_any_number_of_threads(
    drawer_file: Path, shared_assets: Path, tmp_path: Path
) -> None:
    header = akrobat.Trajectories.read(drawer_file).header
    # The task's folder is stored relative to the file's, so the file has to lie beside the first.
    again = drawer_file.with_name("again.h5")
    task = Path(header["task_dir"]) / f"{header['task_name']}.toml"
    akrobat.plan(task, again, limit=2, threads=1, assets=[shared_assets], quiet=True)
    assert again.read_bytes() == drawer_file.read_bytes()
    other = drawer_file.with_name("other.h5")
    akrobat.plan(task, other, limit=2, seed=99, assets=[shared_assets], quiet=True)
    assert other.read_bytes() != drawer_file.read_bytes()


def test_datasets_map_samples_to_arrays(drawer_dataset: akrobat.Dataset) -> None:
    assert len(drawer_dataset) == drawer_dataset.episodes[0].frames >= 120
    sample = drawer_dataset[-1]
    assert sample["camera_obs/fixed_rgb"].shape == (240, 320, 3)
    assert sample["camera_obs/fixed_rgb"].std() > 10
    assert sample["point_cloud"].shape == (4096, 6)
    copy = pickle.loads(pickle.dumps(drawer_dataset))
    np.testing.assert_array_equal(copy[0]["actions"], drawer_dataset[0]["actions"])
    with pytest.raises(IndexError):
        drawer_dataset[len(drawer_dataset)]
    with pytest.raises(akrobat.InputError, match=r"valid choices: .*actions"):
        drawer_dataset.episodes[0]["no_such_array"]


def test_errors_name_the_file_and_the_choices(tmp_path: Path, drawer_file: Path) -> None:
    with pytest.raises(akrobat.InputError, match=r"missing\.toml"):
        akrobat.plan(tmp_path / "missing.toml")
    with pytest.raises(akrobat.InputError, match=r"valid choices: auto, cpu, wgpu"):
        akrobat.plan(tmp_path / "missing.toml", backend="abacus")  # type: ignore[arg-type]
    with pytest.raises(akrobat.InputError, match=r"valid choices: .*soft"):
        akrobat.render(drawer_file, tmp_path / "out", backend="crayons")  # type: ignore[arg-type]
    with pytest.raises(akrobat.InputError, match="paper"):
        akrobat.render(drawer_file, tmp_path / "out", rig="no_such_rig")
    with pytest.raises(akrobat.InputError, match="no such file"):
        akrobat.open(tmp_path / "nothing")
    broken = tmp_path / "broken.h5"
    broken.write_bytes(drawer_file.read_bytes()[:5000])
    with pytest.raises(akrobat.InputError, match=r"broken\.h5"):
        akrobat.open(broken)
    assert not (tmp_path / "out").exists()


def test_plans_on_the_device_and_on_the_cpu_are_alike(shared_assets: Path) -> None:
    task = Path(__file__).parents[2] / "configs" / "tasks" / "summit_drawer_empty.toml"
    cpu, wgpu = (
        akrobat.plan(task, limit=2, backend=backend, assets=[shared_assets], quiet=True)
        for backend in ("cpu", "wgpu")
    )
    assert len(cpu) == len(wgpu) == 2
    for one, other in zip(cpu, wgpu, strict=True):
        assert one.id == other.id
        assert one.verdict is not None
        assert other.verdict is not None
        assert np.abs(one.waypoints_robot - other.waypoints_robot).max() < 0.05
