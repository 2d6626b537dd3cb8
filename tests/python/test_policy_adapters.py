"""Policies with the interface of DP3 in the environment; LeRobot's are tested by `make
test-readers`, where LeRobot is."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from akrobat import InputError
from akrobat.env import OpenObjectEnv
from akrobat.evaluate import make_policy
from akrobat.policy.columns import JointColumns
from akrobat.policy.dp3 import Dp3Policy

REPOSITORY = Path(__file__).parents[2]
TASK = REPOSITORY / "configs" / "tasks" / "summit_drawer_empty.toml"
RIG = REPOSITORY / "configs" / "rigs" / "one_camera.toml"


@pytest.fixture(scope="module")
def env(shared_assets: Path) -> OpenObjectEnv:
    return OpenObjectEnv([TASK], rig=RIG, cloud_points=64, assets=[shared_assets])


class Turning:
    """Turns the first arm joint a little further with each action; keeps what it saw."""

    n_obs_steps = 2
    n_action_steps = 3

    def __init__(self, columns: int) -> None:
        self.agent_pos_columns = columns
        self.seen: list[dict[str, Any]] = []
        self.resets = 0

    def reset(self) -> None:
        self.resets += 1

    def predict_action(self, observation: dict[str, Any]) -> dict[str, Any]:
        self.seen.append(observation)
        actions = np.repeat(observation["agent_pos"][:, -1:], self.n_action_steps, axis=1)
        actions[0, :, 3] += 0.02 * np.arange(1, 4)
        return {"action": actions}


@pytest.mark.parametrize("columns", [12, 11])
def test_a_policy_sees_a_history_and_answers_with_chunks(env: OpenObjectEnv, columns: int) -> None:
    inner = Turning(columns)
    policy = Dp3Policy(inner, env)
    observation, info = env.reset(seed=0)
    policy.reset(observation, info)
    states, clouds = [], []
    for _ in range(7):
        states.append(observation["state"][:10])
        clouds.append(observation["cloud"])
        action = policy(observation)
        assert action.shape == (12,)
        # One column for the gripper goes to both fingers.
        assert action[10] == pytest.approx(action[11], abs=1e-3)
        observation, *_ = env.step(action)
    # Asked at the first, fourth and seventh step.
    assert (len(inner.seen), inner.resets) == (3, 1)
    for asked, step in zip(inner.seen, (0, 3, 6), strict=True):
        assert asked["agent_pos"].shape == (1, 2, columns)
        assert asked["point_cloud"].shape == (1, 2, 64, 6)
        for back in (0, 1):
            np.testing.assert_array_equal(
                asked["agent_pos"][0, 1 - back, :10], states[max(step - back, 0)]
            )
            np.testing.assert_array_equal(
                asked["point_cloud"][0, 1 - back], clouds[max(step - back, 0)]
            )
    moved = observation["state"][3] - states[0][3]
    assert 0.05 < moved < 0.16


def test_columns_of_exports_are_the_robots_joints(env: OpenObjectEnv) -> None:
    env.reset(seed=1)
    columns = JointColumns(env)
    np.testing.assert_allclose(columns.state(12), env.row(), atol=1e-6)
    assert columns.state(11)[-1] == pytest.approx(env.row()[10:].mean(), abs=1e-6)
    np.testing.assert_array_equal(columns.action(np.arange(11))[9:], [9, 10, 10])
    with pytest.raises(InputError, match="action: 5 columns; the task's robot has 11 or 12"):
        columns.action(np.zeros(5))


def test_what_is_no_such_policy_is_refused(env: OpenObjectEnv, tmp_path: Path) -> None:
    good = {"n_obs_steps": 1, "n_action_steps": 1}
    for wrong, message in (
        ({"n_obs_steps": 2}, "n_action_steps: expected a whole number"),
        ({**good, "agent_pos_columns": 3, "predict_action": print}, "agent_pos: 3 columns"),
        (good, "no predict_action"),
    ):
        with pytest.raises(InputError, match=message):
            Dp3Policy(SimpleNamespace(**wrong), env)
    answers = SimpleNamespace(**good, predict_action=lambda _: {"action": np.zeros((1, 2, 12))})
    policy = Dp3Policy(answers, env)
    observation, info = env.reset(seed=0)
    policy.reset(observation, info)
    with pytest.raises(InputError, match=r"expected shape \(1, 1\)"):
        policy(observation)
    with pytest.raises(InputError, match="it has no config"):
        make_policy(f"lerobot:{tmp_path}", env)
    with pytest.raises(InputError, match="valid choices: replay, random"):
        make_policy("dp3:nothing", env)
