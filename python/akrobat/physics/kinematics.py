"""Forward kinematics of what was commanded, to compare it with what happened."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from akrobat.physics import poses

Vector = NDArray[np.float64]


def tool_poses(robot: dict[str, Any], names: Sequence[str], rows: Vector) -> Vector:
    """`world_from_tool` `[N, 7]` for rows of joint positions `[N, len(names)]` (rad, m)."""
    column = {name: index for index, name in enumerate(names)}
    rest = dict(zip(robot["dof_joints"], robot["rest"], strict=True))
    incoming = {joint["child"]: joint for joint in robot["joints"]}
    chain = []
    link = robot["tool_link"]
    while link in incoming:
        chain.append(incoming[link])
        link = incoming[link]["parent"]
    found = np.empty((len(rows), 7))
    for number, row in enumerate(rows):
        pose = np.asarray(robot["world_from_root"], float)
        for joint in reversed(chain):
            pose = poses.compose(pose, joint["parent_from_joint"])
            name, multiplier, offset = joint["mimic"] or (joint["name"], 1.0, 0.0)
            if joint["kind"] != "fixed":
                value = row[column[name]] if name in column else rest[name]
                pose = poses.compose(pose, _motion(joint, multiplier * value + offset))
        found[number] = poses.compose(pose, robot["link_from_tool"])
    return found


def _motion(joint: dict[str, Any], position: float) -> Vector:
    axis = np.asarray(joint["axis"], float)
    if joint["kind"] == "prismatic":
        return np.array([*(axis * position), 1.0, 0.0, 0.0, 0.0])
    half = 0.5 * position
    return np.array([0.0, 0.0, 0.0, np.cos(half), *(np.sin(half) * axis)])
