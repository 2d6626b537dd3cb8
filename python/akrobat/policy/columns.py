"""States and actions of exported datasets, told from and to the environment.

`akrobat export` writes base and arm joints and then either every finger joint or one column for all
of them, the mean of their positions; actions are the positions to be reached.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from akrobat.errors import InputError


class JointColumns:
    """Translates between a policy's columns and the joints of an environment's robot."""

    def __init__(self, env: Any) -> None:
        self._env = env
        self._fingers = len(env.place.controller.finger_names)
        self._joints = len(env.joint_names)

    def check(self, name: str, columns: int) -> None:
        """Refuses a number of columns that no export of this robot has.

        :raise InputError: the message starts with `name`
        """
        choices = sorted({self._joints, self._joints - self._fingers + 1})
        if columns not in choices:
            expected = " or ".join(map(str, choices))
            raise InputError(f"{name}: {columns} columns; the task's robot has {expected}")

    def state(self, columns: int) -> NDArray[np.float32]:
        """Where the robot is, in so many columns."""
        row = self._env.row()
        if columns != self._joints:
            row = np.append(row[: -self._fingers], row[-self._fingers :].mean())
        return row.astype(np.float32)

    def action(self, values: NDArray[Any]) -> NDArray[np.float64]:
        """Targets of all joints; one value for all fingers goes to each of them."""
        row = np.asarray(values, float).ravel()
        self.check("action", len(row))
        if len(row) == self._joints:
            return row
        body = self._joints - self._fingers
        return np.concatenate([row[:body], np.repeat(row[body:], self._fingers)])
