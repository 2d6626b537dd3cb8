"""Checkpoints of LeRobot in closed loop: ACT, Diffusion Policy and others that see the robot's
state and colour images.

A checkpoint is the folder `pretrained_model` that LeRobot's training writes: policy and processors.
It was trained on what `akrobat export --to lerobot` writes with its default, absolute actions.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from akrobat.errors import InputError, RunError
from akrobat.policy.columns import JointColumns

STATE = "observation.state"
IMAGES = "observation.images."


class LeRobotPolicy:
    """Asks a LeRobot policy for the next action; it keeps its own queue of chunks."""

    def __init__(self, folder: Path, env: Any) -> None:
        folder = _checkpoint(folder)
        try:
            import torch
            from lerobot.configs.policies import PreTrainedConfig
            from lerobot.policies.factory import get_policy_class, make_pre_post_processors
        except ImportError as error:
            raise RunError(f"{folder}: needs LeRobot: pip install lerobot ({error})") from error
        self._torch = torch
        config = PreTrainedConfig.from_pretrained(folder, local_files_only=True)
        config.device = "cuda" if torch.cuda.is_available() else "cpu"
        self._columns = JointColumns(env)
        self._shapes = {name: tuple(f.shape) for name, f in config.input_features.items()}
        self._check(folder, env, config.output_features["action"].shape[0])
        self._policy = get_policy_class(config.type).from_pretrained(
            folder, config=config, local_files_only=True
        )
        self._policy.eval()
        self._before, self._after = make_pre_post_processors(
            config,
            pretrained_path=str(folder),
            preprocessor_overrides={"device_processor": {"device": config.device}},
        )
        self._env = env

    def reset(self, observation: dict[str, NDArray[Any]], info: dict[str, Any]) -> None:
        """Forgets the last trial; what the policy draws at random follows from the trial's seed."""
        self._torch.manual_seed(int(self._env.np_random.integers(2**31)))
        self._policy.reset()

    def __call__(self, observation: dict[str, NDArray[Any]]) -> NDArray[np.float64]:
        """The next targets of all joints."""
        torch = self._torch
        batch: dict[str, Any] = {}
        for name, shape in self._shapes.items():
            if name == STATE:
                batch[name] = torch.from_numpy(self._columns.state(shape[0]))[None]
            else:
                image = observation[f"{name.removeprefix(IMAGES)}_rgb"]
                scaled = torch.from_numpy(image.copy()).permute(2, 0, 1).float() / 255.0
                batch[name] = scaled[None]
        with torch.inference_mode():
            action = self._after(self._policy.select_action(self._before(batch)))
        return self._columns.action(action[0].cpu().numpy())

    def _check(self, folder: Path, env: Any, actions: int) -> None:
        """Refuses what the environment cannot show, or the robot cannot do."""
        spaces = env.observation_space.spaces
        seen = {name.removesuffix("_rgb") for name in spaces if name.endswith("_rgb")}
        self._columns.check(f"{folder}: action", actions)
        for name, shape in self._shapes.items():
            if name == STATE:
                self._columns.check(f"{folder}: {STATE}", shape[0])
                continue
            camera = name.removeprefix(IMAGES)
            if camera not in seen or not name.startswith(IMAGES):
                have = ", ".join([STATE, *sorted(IMAGES + camera for camera in seen)])
                raise InputError(
                    f"{folder}: the policy sees {name}; the trials have {have} (see --rig)"
                )
            height, width, _ = spaces[f"{camera}_rgb"].shape
            if shape != (3, height, width):
                raise InputError(
                    f"{folder}: {name} has {shape[2]} x {shape[1]} pixels; "
                    f"the rig's camera has {width} x {height}"
                )


def _checkpoint(folder: Path) -> Path:
    """The folder that holds the policy itself: this one, or `pretrained_model` in it."""
    for candidate in (folder, folder / "pretrained_model"):
        if (candidate / "config.json").is_file():
            return candidate
    raise InputError(f"{folder}: no checkpoint of LeRobot: it has no config.json")
