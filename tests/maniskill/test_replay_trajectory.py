"""ManiSkill's own `replay_trajectory`, unmodified, replays what `akrobat export --to maniskill`
wrote: a Panda that opens a microwave oven, seen by two small cameras.

Run by `make test-maniskill`, in an environment of its own.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

import akrobat
import h5py
import numpy as np
import pytest

REPOSITORY = Path(__file__).resolve().parents[2]
TASKS = REPOSITORY / "configs" / "tasks"
CAMERAS = ("fixed", "wrist")

RIG = """
name = "small"
[[cameras]]
name = "fixed"
width = 96
height = 72
focal_mm = 24.0
[cameras.mount]
on = "look_at_handle"
offset = [1.3, 0.9, 0.7]
[[cameras]]
name = "wrist"
width = 96
height = 72
focal_mm = 15.0
[cameras.mount]
on = "link"
link = "tool"
link_from_camera = [0.09, 0, -0.1, 0.67082, -0.223607, -0.223607, 0.67082]
"""


def run(*arguments: object, **environment: str) -> str:
    command = [sys.executable, "-W", "ignore", "-m", *map(str, arguments)]
    done = subprocess.run(
        command, capture_output=True, text=True, check=False, env={**os.environ, **environment}
    )
    assert done.returncode == 0, done.stderr[-4000:]
    return done.stdout


@pytest.fixture(scope="module")
def assets() -> Path:
    folder = Path(os.environ.get("AKROBAT_SHARED_ASSETS", REPOSITORY.parent / "shared" / "assets"))
    assert folder.is_dir(), f"{folder} is absent"
    return folder


@pytest.fixture(scope="module")
def exported(assets: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("maniskill")
    (folder / "rig.toml").write_text(RIG)
    file = folder / "microwave.h5"
    akrobat.plan(TASKS / "panda_microwave_empty.toml", file, limit=2, assets=[assets], quiet=True)
    render = ("akrobat", "--quiet", "render", file, "-o", folder / "data")
    run(*render, "--rig", folder / "rig.toml", "--backend", "soft", "--assets", assets)
    run("akrobat", "--quiet", "export", folder / "data", "--to", "maniskill", "-o", folder / "out")
    return folder / "out" / "trajectory.h5"


def replayed(exported: Path, assets: Path, mode: str, *more: str) -> tuple[h5py.Group, str]:
    """The first episode as ManiSkill records it, and what it prints."""
    printed = run(
        "mani_skill.trajectory.replay_trajectory",
        *("--traj-path", exported, "--sim-backend", "physx_cpu", "--obs-mode", mode),
        *("--save-traj", "--count", 1, *more),
        AKROBAT_ASSET_PATH=f"{TASKS}:{assets}",
    )
    output = exported.with_name(f"trajectory.{mode}.pd_joint_pos.physx_cpu.h5")
    return h5py.File(output)["traj_0"], printed


def test_states_give_the_same_pictures(exported: Path, assets: Path) -> None:
    found, printed = replayed(exported, assets, "rgbd", "--use-env-states")
    assert "1/1=100.00% demos saved" in printed
    with h5py.File(exported) as file:
        source = file["traj_0"]
        frames = len(source["actions"]) + 1
        for camera in CAMERAS:
            data, parameters = (f"obs/sensor_{kind}/{camera}" for kind in ("data", "param"))
            planned = source[f"{data}/depth"][:].astype(int)
            drawn = found[f"{data}/depth"][:].astype(int)
            assert drawn.shape == planned.shape == (frames, 72, 96, 1)
            assert found[f"{data}/rgb"].shape == (frames, 72, 96, 3)
            assert agreeing(planned, drawn) > 0.93
            # Frames of another time agree less: only in what does not move.
            early, late = planned[: frames // 3], drawn[-(frames // 3) :]
            assert agreeing(early, late) < agreeing(planned, drawn) - 0.05
            np.testing.assert_allclose(
                found[f"{parameters}/intrinsic_cv"], source[f"{parameters}/intrinsic_cv"], atol=1e-3
            )
            # Between a state and its picture is a step of physics, in which the arm goes on.
            drawn_at, planned_at = (
                positions(file[f"{parameters}/extrinsic_cv"][:]) for file in (found, source)
            )
            steps = np.linalg.norm(np.diff(planned_at, axis=0), axis=1)
            step = np.maximum(np.append(steps, 0.0), np.append(0.0, steps))
            off = np.linalg.norm(drawn_at - planned_at, axis=1)
            assert (off <= 1.1 * step + 1e-3).all(), (off - step).max()
            assert (off < 1e-5).all() == (camera == "fixed")


def positions(camera_from_world: np.ndarray) -> np.ndarray:
    """Where cameras are, metres `[N, 3]`."""
    turn, shift = camera_from_world[:, :3, :3], camera_from_world[:, :3, 3]
    return -np.einsum("nji,nj->ni", turn, shift)


def agreeing(a: np.ndarray, b: np.ndarray) -> float:
    """Share of pixels that both see, and at depths within 1 cm."""
    seen = (a > 0) & (b > 0)
    return float((np.abs(a - b)[seen] < 10).mean())


def test_actions_open_the_door_in_physics(exported: Path, assets: Path) -> None:
    found, printed = replayed(exported, assets, "pointcloud")
    assert "1/1=100.00% demos saved" in printed
    assert found["success"][-1]
    xyzw = found["obs/pointcloud/xyzw"][-1]
    assert xyzw.shape == (2 * 72 * 96, 4)
    with h5py.File(exported) as file:
        door = file["traj_0/env_states/articulations/microwave_1001"][:, 13:18]
        opened = found["env_states/articulations/microwave_1001"][:, 13:18]
    goal = np.abs(door[-1]).max()
    assert np.abs(opened[0]).max() < 0.01
    assert np.abs(opened[-1]).max() > 0.8 * goal


def test_actions_of_an_arm_that_stays_open_nothing(
    exported: Path, assets: Path, tmp_path: Path
) -> None:
    still = tmp_path / "trajectory.h5"
    with h5py.File(exported) as source, h5py.File(still, "w") as copy:
        group = copy.create_group("traj_0")
        group["actions"] = np.repeat(source["traj_0/actions"][:1], 30, axis=0)
        source.copy("traj_0/env_states", group)
    description = json.loads(exported.with_suffix(".json").read_text())
    still.with_suffix(".json").write_text(json.dumps(description))
    printed = run(
        "mani_skill.trajectory.replay_trajectory",
        *("--traj-path", still, "--sim-backend", "physx_cpu", "--obs-mode", "none", "--count", 1),
        AKROBAT_ASSET_PATH=f"{TASKS}:{assets}",
    )
    assert "0/1=0.00% demos saved" in printed
