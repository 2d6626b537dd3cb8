"""The gymnasium environment and the evaluation of policies."""

from __future__ import annotations

import csv
import json
import subprocess
import sys
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
import pytest
from akrobat import InputError
from akrobat.env import OpenObjectEnv
from gymnasium.utils.env_checker import check_env

REPOSITORY = Path(__file__).parents[2]
TASK = REPOSITORY / "configs" / "tasks" / "summit_drawer_empty.toml"


@pytest.fixture(scope="module")
def env(shared_assets: Path, drawer_file: Path) -> Any:
    return gymnasium.make(
        "akrobat.env:akrobat/OpenObject-v0",
        tasks=[TASK],
        trajectories=[drawer_file],
        split="both",
        rig="paper",
        cloud_points=256,
        assets=[shared_assets],
    )


def test_gymnasium_finds_nothing_wrong(env: Any) -> None:
    check_env(env.unwrapped, skip_render_check=True)


def test_spaces_are_those_of_the_paper(env: Any) -> None:
    assert env.action_space.shape == (12,)
    spaces = env.observation_space.spaces
    assert spaces["state"].shape == (11,)
    assert spaces["cloud"].shape == (256, 6)
    images = {name for name in spaces if name.endswith("_rgb")}
    assert len(images) == 3
    assert all(spaces[name].shape == (240, 320, 3) for name in images)


def test_seeds_decide_the_start(env: Any) -> None:
    unseen: OpenObjectEnv = env.unwrapped
    unseen.split = "unseen"
    starts = [unseen.reset(seed=seed)[0]["state"] for seed in (1, 1, 2)]
    unseen.split = "both"
    np.testing.assert_array_equal(starts[0], starts[1])
    assert np.abs(starts[0] - starts[2]).max() > 0.01


def test_relative_actions_move_as_much_as_they_say(shared_assets: Path) -> None:
    env = OpenObjectEnv([TASK], action_mode="relative", assets=[shared_assets])
    before, _ = env.reset(seed=0)
    action = np.zeros(12, np.float32)
    action[3] = 0.02
    for _ in range(10):
        after, *_ = env.step(action)
    assert after["state"][3] - before["state"][3] == pytest.approx(0.2, abs=0.03)
    assert np.abs(np.delete(after["state"] - before["state"], 3)).max() < 0.02


def test_episodes_run_in_processes(shared_assets: Path) -> None:
    envs = gymnasium.make_vec(
        "akrobat.env:akrobat/OpenObject-v0",
        num_envs=2,
        vectorization_mode="async",
        vector_kwargs={"context": "spawn"},
        tasks=[str(TASK)],
        assets=[str(shared_assets)],
    )
    try:
        first, _ = envs.reset(seed=[3, 4])
        again, _ = envs.reset(seed=[4, 3])
        np.testing.assert_array_equal(first["state"], again["state"][::-1])
    finally:
        envs.close()


def evaluate(*arguments: object) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-m", "akrobat", "eval", TASK, *arguments, "--json"]
    return subprocess.run(list(map(str, command)), capture_output=True, text=True, check=False)


def test_replay_scores_what_its_audit_says_and_chance_nothing(
    shared_assets: Path, drawer_file: Path, tmp_path: Path
) -> None:
    common = ("--trajectories", drawer_file, "--assets", shared_assets)
    out = tmp_path / "replay"
    result = evaluate("--policy", "replay", "--trials", 2, "-o", out, "--videos", 1, *common)
    assert result.returncode == 0, result.stderr
    assert json.loads(result.stdout)["success_rate"] == 1.0
    with open(out / "trials.csv", newline="") as table:
        rows = list(csv.DictReader(table))
    assert [row["trajectory"] for row in rows] == [f"{drawer_file.name}:{i}" for i in (0, 1)]
    assert all(float(row["opened_fraction_max"]) > 0.9 for row in rows)
    assert all(float(row["handle_distance_end_m"]) < 0.1 for row in rows)
    assert (out / "summary.svg").read_text().startswith("<svg")
    assert (out / "success_000.mp4").stat().st_size > 1000
    chance = tmp_path / "random"
    result = evaluate("--policy", "random", "--trials", 1, "-o", chance, "--videos", 1, *common)
    assert json.loads(result.stdout)["success_rate"] == 0.0
    assert [path.name for path in chance.glob("*.mp4")] == ["failure_000.mp4"]


def test_own_policies_are_called(
    shared_assets: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "still.py").write_text(
        "def make(env):\n    assert env.action_space.shape == (12,)\n"
        "    return lambda observation: env.targets\n"
    )
    monkeypatch.chdir(tmp_path)
    out, assets = tmp_path / "out", ("--assets", shared_assets)
    result = evaluate("--policy", "still:make", "--trials", 1, "-o", out, *assets)
    assert result.returncode == 0, result.stderr
    with open(out / "trials.csv", newline="") as table:
        (row,) = csv.DictReader(table)
    assert (row["success"], row["steps"], row["split"]) == ("0", "300", "unseen")


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("--policy", "juggle"), 'policy: unknown "juggle"; valid choices: replay, random'),
        (("--policy", "no_such_module:make"), "No module named 'no_such_module'"),
        (("--policy", "random", "--split", "seen"), "seen starts need --trajectories"),
        (("--policy", "random", "--cloud-points", "9"), "a cloud needs cameras: --rig"),
    ],
)
def test_wrong_arguments_are_refused(
    shared_assets: Path, tmp_path: Path, arguments: tuple[str, ...], message: str
) -> None:
    result = evaluate(*arguments, "-o", tmp_path / "out", "--assets", shared_assets)
    assert result.returncode == 2
    assert message in result.stderr


def test_wrong_constructor_arguments_are_refused() -> None:
    for wrong, message in (
        ({"split": "some"}, "valid choices: seen, unseen, both"),
        ({"action_mode": "torque"}, "valid choices: absolute, relative"),
        ({"split": "seen"}, "needs trajectory files"),
        ({"cloud_points": 5}, "give a rig"),
    ):
        with pytest.raises(InputError, match=message):
            OpenObjectEnv([TASK], **wrong)  # type: ignore[arg-type]
