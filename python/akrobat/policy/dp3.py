"""Policies with the interface of 3D Diffusion Policy (Ze et al. 2024) in closed loop.

Such a policy sees the last `n_obs_steps` observations, `point_cloud` `[B, n_obs_steps, N, 3 or 6]`
(metres in the world, and colours 0 to 255) and `agent_pos` `[B, n_obs_steps, S]`, and answers
`{"action": [B, n_action_steps, A]}`: the targets that are driven to before it is asked again. They
are the arrays `point_cloud`, `state` and `action` of what `akrobat export --to dp3` writes.
"""

from __future__ import annotations

from collections import deque
from typing import Any

import numpy as np
from numpy.typing import NDArray

from akrobat.errors import InputError
from akrobat.policy.columns import JointColumns


class Dp3Policy:
    """Keeps the last observations for a policy, and what is left of its last chunk of actions.

    :param policy: has `n_obs_steps`, `n_action_steps`, and `predict_action(observation)` or is
        itself callable; a PyTorch module is given tensors on its own device, anything else arrays.
        `agent_pos_columns` says how many columns its states have, else all joints; a method
        `reset()` is called at the start of each trial
    """

    def __init__(self, policy: Any, env: Any) -> None:
        for name in ("n_obs_steps", "n_action_steps"):
            steps = getattr(policy, name, None)
            if not isinstance(steps, int) or steps < 1:
                raise InputError(f"policy dp3: {name}: expected a whole number from 1, got {steps}")
        if "cloud" not in env.observation_space.spaces:
            raise InputError("policy dp3: it sees a cloud: give --rig and --cloud-points")
        self._policy = policy
        self._predict = getattr(policy, "predict_action", policy)
        if not callable(self._predict):
            raise InputError(f"policy dp3: it has no predict_action: {policy!r}")
        self._columns = JointColumns(env)
        self._states = getattr(policy, "agent_pos_columns", len(env.joint_names))
        self._columns.check("policy dp3: agent_pos", self._states)
        self._seen: deque[dict[str, NDArray[np.float32]]] = deque(maxlen=policy.n_obs_steps)
        self._queue: list[NDArray[np.float64]] = []

    def reset(self, observation: dict[str, NDArray[Any]], info: dict[str, Any]) -> None:
        """Forgets the last trial."""
        self._seen.clear()
        self._queue = []
        if hasattr(self._policy, "reset"):
            self._policy.reset()

    def __call__(self, observation: dict[str, NDArray[Any]]) -> NDArray[np.float64]:
        """The next targets of all joints."""
        now = {
            "point_cloud": observation["cloud"].astype(np.float32),
            "agent_pos": self._columns.state(self._states),
        }
        # The first observation stands for those before it.
        missing = 1 if self._seen else self._policy.n_obs_steps
        self._seen.extend([now] * missing)
        if not self._queue:
            self._queue = self._drawn()
        return self._queue.pop(0)

    def _drawn(self) -> list[NDArray[np.float64]]:
        stacked = {
            name: np.stack([seen[name] for seen in self._seen])[None] for name in self._seen[0]
        }
        answer = self._predict(_as_its_own(self._policy, stacked))
        actions = answer["action"]
        actions = actions.detach().cpu().numpy() if hasattr(actions, "detach") else actions
        actions = np.asarray(actions, float)
        expected = (1, self._policy.n_action_steps)
        if actions.ndim != 3 or actions.shape[:2] != expected:
            raise InputError(
                f"policy dp3: action: expected shape {expected} and the joints, got {actions.shape}"
            )
        return [self._columns.action(row) for row in actions[0]]


def _as_its_own(policy: Any, arrays: dict[str, NDArray[np.float32]]) -> dict[str, Any]:
    """Tensors for a PyTorch module, on the device of its weights; else the arrays."""
    if not hasattr(policy, "parameters"):
        return dict(arrays)
    import torch

    device = next((weight.device for weight in policy.parameters()), torch.device("cpu"))
    return {name: torch.from_numpy(values).to(device) for name, values in arrays.items()}
