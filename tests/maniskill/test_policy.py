"""The first policy, trained a little and tried once; here because PyTorch is."""

from __future__ import annotations

import csv
import json
import os
import subprocess
import sys
from pathlib import Path

import akrobat
import numpy as np
import pytest
from akrobat import InputError
from akrobat.policy.data import demonstrations

REPOSITORY = Path(__file__).resolve().parents[2]
TASK = REPOSITORY / "configs" / "tasks" / "panda_microwave_policy.toml"
RIG = REPOSITORY / "configs" / "rigs" / "one_camera.toml"


def run(*arguments: object) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-W", "ignore", "-m", *map(str, arguments)]
    return subprocess.run(command, capture_output=True, text=True, check=False)


@pytest.fixture(scope="module")
def assets() -> Path:
    folder = Path(os.environ.get("AKROBAT_SHARED_ASSETS", REPOSITORY.parent / "shared" / "assets"))
    assert folder.is_dir(), f"{folder} is absent"
    return folder


@pytest.fixture(scope="module")
def trajectories(assets: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    file = tmp_path_factory.mktemp("plan") / "microwave.h5"
    akrobat.plan(TASK, file, limit=3, assets=[assets], quiet=True)
    return file


@pytest.fixture(scope="module")
def dataset(assets: Path, trajectories: Path) -> Path:
    folder = trajectories.with_name("data")
    akrobat.render(
        trajectories,
        folder,
        backend="soft",
        rig=RIG,
        modalities=["depth"],
        cloud={"points": 64, "color": False, "radius_m": 0.5},
        assets=[assets],
        quiet=True,
    )
    return folder


def test_demonstrations_are_what_the_dataset_holds(dataset: Path) -> None:
    episodes, source = demonstrations([dataset], 2)
    first = akrobat.open(dataset).episodes[0]
    assert len(episodes) == 2
    assert source.joints[0] == "panda_joint1"
    np.testing.assert_allclose(episodes[0].state[:, :7], first["obs/joint_pos"][:, :7], atol=1e-6)
    # The gripper is open at the start and closed at the end.
    assert episodes[0].state[0, -1] == pytest.approx(1.0)
    assert episodes[0].state[-1, -1] < 0.2
    assert episodes[0].cloud.shape[1:] == (64, 3)
    with pytest.raises(InputError, match="expected 1 to 3, got 4"):
        demonstrations([dataset], 4)


def test_training_lowers_the_loss_and_the_policy_moves_the_arm(
    dataset: Path, trajectories: Path, assets: Path, tmp_path: Path
) -> None:
    losses = {}
    for steps in (20, 400):
        made = run(
            *("akrobat.policy", "train", dataset, "--trajectories", 3, "--steps", steps),
            *("--threads", 1, "-o", tmp_path / str(steps), "--json"),
        )
        assert made.returncode == 0, made.stderr
        losses[steps] = json.loads(made.stdout)["loss"]
    assert losses[400] < 0.5 * losses[20]
    out = tmp_path / "trials"
    common = ("--trials", 1, "-o", out, "--assets", assets, "--json")
    tried = run(
        *("akrobat", "eval", TASK, "--policy", tmp_path / "400"),
        *("--trajectories", trajectories, *common),
    )
    assert tried.returncode == 0, tried.stderr
    summary = json.loads((out / "summary.json").read_text())
    assert (summary["trials"], summary["trajectories"]) == (1, 3)
    with open(out / "trials.csv", newline="") as table:
        (row,) = csv.DictReader(table)
    # A policy that learned nothing leaves the hand where it started, 0.33 m from the handle.
    assert float(row["handle_distance_end_m"]) < 0.3
    again = run("akrobat.policy", "train", dataset, "--trajectories", 3, "-o", tmp_path / "400")
    assert again.returncode == 2
    assert "exists already" in again.stderr
