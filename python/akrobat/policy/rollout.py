"""A trained policy in closed loop."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import torch
from numpy.typing import NDArray

from akrobat.errors import InputError
from akrobat.policy.features import CloudFeatures
from akrobat.policy.folder import describe
from akrobat.policy.network import Denoiser, draw
from akrobat.policy.training import Scaling, TrainingConfig

if TYPE_CHECKING:
    from akrobat.env import OpenObjectEnv

# A gripper told to be open by this much, as a fraction, is told to open all the way: where it
# closes is decided by the force, not by noise of the drawn targets.
OPEN_FROM = 0.8


class LearnedPolicy:
    """Draws a chunk of targets, drives to some of them, and draws again."""

    def __init__(self, folder: Path, env: OpenObjectEnv) -> None:
        description = describe(folder)
        if description["joints"] != env.joint_names:
            raise InputError(
                f"{folder}: trained for the joints {', '.join(description['joints'])}; "
                f"the task's robot has {', '.join(env.joint_names)}"
            )
        self._env = env
        self._config = TrainingConfig(**description["config"])
        self._rate_hz: float = description["rate_hz"]
        with np.load(folder / "features.npz") as arrays:
            self._features = CloudFeatures(**arrays)
        with np.load(folder / "scaling.npz") as arrays:
            self._scaling = Scaling(**arrays)
        states = len(self._scaling.state_mean)
        self._network = Denoiser(
            self._config.chunk * states, states + len(self._features.components)
        )
        weights = torch.load(folder / "network.pt", weights_only=True)
        self._network.load_state_dict(weights)
        self._network.eval()
        self._generator = torch.Generator()
        self._noise = torch.zeros((1, self._config.chunk * states))
        self._queue: list[NDArray[np.float64]] = []
        robot = env.place.world.robot_description
        self._closed = np.asarray(robot["gripper_closed"], float)
        self._opening = np.asarray(robot["gripper_open"], float) - self._closed

    def reset(self, observation: dict[str, NDArray[Any]], info: dict[str, Any]) -> None:
        """Starts a trial. All its chunks are drawn from the same noise, which follows from the
        trial's seed: drawn from new noise, they would take another of the demonstrated ways each
        time."""
        self._generator.manual_seed(int(self._env.np_random.integers(2**31)))
        size = self._config.chunk * len(self._scaling.state_mean)
        self._noise = torch.randn((1, size), generator=self._generator)
        self._queue = []

    def __call__(self, observation: dict[str, NDArray[Any]]) -> NDArray[np.float64]:
        """The next targets of all joints."""
        if not self._queue:
            self._queue = self._drawn(observation)
        return self._queue.pop(0)

    def _drawn(self, observation: dict[str, NDArray[Any]]) -> list[NDArray[np.float64]]:
        from akrobat.env.open_object import RATE_HZ

        config, scaling = self._config, self._scaling
        state = observation["state"].astype(np.float32).copy()
        state[-1] /= self._env.place.world.robot_description["open_width_m"]
        cloud = observation.get("cloud")
        seen = [(state - scaling.state_mean) / scaling.state_scale]
        if len(self._features.components):
            if cloud is None:
                raise InputError("the policy sees a cloud: give the rig and --cloud-points")
            seen.append(self._features(cloud[:, :3].astype(np.float32)))
        row = torch.from_numpy(np.concatenate(seen))[None]
        drawn = draw(self._network, row, self._noise).numpy().reshape(config.chunk, -1)
        targets = state + scaling.chunk_mean + drawn * scaling.chunk_scale
        # From the trained rate to the environment's, starting where the last targets ended.
        before = self._env.targets
        knots = np.concatenate([[self._with_fraction(before)], targets[: config.executed]])
        every = config.stride * RATE_HZ / self._rate_hz
        count = round(config.executed * every)
        at = np.arange(1, count + 1) / every
        rows = np.stack([np.interp(at, np.arange(len(knots)), c) for c in knots.T], axis=1)
        return [self._with_fingers(row) for row in rows]

    def _with_fraction(self, targets: NDArray[np.float64]) -> NDArray[np.float64]:
        fingers = len(self._closed)
        fraction = float(np.mean((targets[-fingers:] - self._closed) / self._opening))
        return np.append(targets[:-fingers], fraction)

    def _with_fingers(self, row: NDArray[np.float64]) -> NDArray[np.float64]:
        fraction = 1.0 if row[-1] > OPEN_FROM else float(np.clip(row[-1], 0.0, 1.0))
        return np.concatenate([row[:-1], self._closed + fraction * self._opening])
