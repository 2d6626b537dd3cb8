"""Position drives of the robot, and a gripper that closes by force."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from akrobat.physics.world import World, rest_positions

Vector = NDArray[np.float64]

# For joints whose file states no effort limit, N or N m.
DEFAULT_EFFORT = 100.0

# Error at which a finger presses with its whole force, metres or radians: small against any handle.
GRIP_SATURATION = 0.004

# Fingers told to be less open than this fraction of their stroke close.
CLOSING = 0.95


@dataclass(frozen=True)
class Gains:
    """A drive: `effort = clamp(stiffness * (target - q) + damping * (target speed - speed))`."""

    stiffness: float
    damping: float
    effort_limit: float


class Controller:
    """Drives the robot's planned joints towards targets."""

    def __init__(self, world: World) -> None:
        robot = world.robot_description
        self.world = world
        self.arm_names: list[str] = [*robot["base_joints"], *robot["arm_joints"]]
        self.finger_names: list[str] = list(robot["gripper_joints"])
        self.gains = {joint["name"]: _gains(world, joint) for joint in _driven(world)}
        for name, gains in self.gains.items():
            world.robot.joint[name].set_drive_properties(
                gains.stiffness, gains.damping, force_limit=gains.effort_limit, mode="force"
            )
        for joint in _driven(world):
            if joint["velocity_limit"]:
                # Drives do not exceed the speed that the robot's file allows.
                world.robot.joint[joint["name"]].set_max_velocity(joint["velocity_limit"])
        stated = {joint["name"]: joint["velocity_limit"] for joint in robot["joints"]}
        self.speed_limits = np.array([stated[name] or np.inf for name in self.arm_names])
        """of base and arm, rad/s and m/s `[J]`"""
        rest = rest_positions(robot)
        for name in self.gains:
            world.robot.joint[name].set_drive_target(rest[name])
        self._arm = [world.robot.joint[name] for name in self.arm_names]
        self._fingers = [world.robot.joint[name] for name in self.finger_names]
        self._followers = _followers(world, self.finger_names)
        self._finger_columns = [world.robot.column[name] for name in self.finger_names]
        self._closed = np.asarray(robot["gripper_closed"], float)
        self._opening = np.asarray(robot["gripper_open"], float) - self._closed

    def drive_arm(self, target: Vector, speed: Vector) -> None:
        """Targets of base and arm (rad, m) and how fast they move."""
        for joint, position, velocity in zip(self._arm, target, speed, strict=True):
            joint.set_drive_target(position)
            joint.set_drive_velocity_target(velocity)

    def open_fingers(self, target: Vector) -> None:
        """Moves the fingers to a position."""
        self._drive_fingers(np.asarray(target, float))

    def hold(self) -> None:
        """Drives every joint to where it is: what a reset needs, before the first targets come."""
        positions = self.world.robot.articulation.get_qpos()
        for name in self.gains:
            joint = self.world.robot.joint[name]
            joint.set_drive_target(positions[self.world.robot.column[name]])
            joint.set_drive_velocity_target(0.0)

    def is_closing(self, target: Vector) -> bool:
        """Whether finger targets mean to close, rather than to stay open."""
        return float(np.mean((np.asarray(target) - self._closed) / self._opening)) < CLOSING

    def opening_m(self, fingers: Vector) -> float:
        """Free width between the fingers at these positions, metres."""
        fraction = float(np.mean((np.asarray(fingers) - self._closed) / self._opening))
        return fraction * float(self.world.robot_description["open_width_m"])

    def squeeze(self, target: Vector) -> None:
        """Presses the fingers together by force, but no further open than `target`.

        One motor moves all fingers of a gripper: each is driven to the same fraction of its
        stroke, a little beyond where they are on average, so that they press with the drive's
        whole force and do not give way sideways.
        """
        positions = self.world.robot.articulation.get_qpos()[self._finger_columns]
        fraction = float(np.mean((positions - self._closed) / self._opening))
        wanted = float(np.min((np.asarray(target) - self._closed) / self._opening))
        stroke = float(np.abs(self._opening).min())
        beyond = min(fraction, wanted) - GRIP_SATURATION / stroke
        self._drive_fingers(self._closed + beyond * self._opening)

    def _drive_fingers(self, target: Vector) -> None:
        for joint, position in zip(self._fingers, target, strict=True):
            joint.set_drive_target(position)
        for joint, finger, multiplier, offset in self._followers:
            joint.set_drive_target(multiplier * target[finger] + offset)


def _driven(world: World) -> list[dict[str, Any]]:
    return [j for j in world.robot_description["joints"] if j["name"] in world.robot.joint]


def _followers(world: World, fingers: list[str]) -> list[tuple[Any, int, float, float]]:
    """Joints that mimic a finger: the joint, the finger's number, factor and offset."""
    found = []
    for joint in _driven(world):
        followed, multiplier, offset = joint["mimic"] or (None, 1.0, 0.0)
        if followed in fingers:
            driven = world.robot.joint[joint["name"]]
            found.append((driven, fingers.index(followed), multiplier, offset))
    return found


def _gains(world: World, joint: dict[str, Any]) -> Gains:
    config = world.config
    effort = joint["effort_limit"] or DEFAULT_EFFORT
    finger = joint["name"] in world.robot_description["gripper_joints"]
    if finger and config.grip_force_n is not None:
        effort = config.grip_force_n
    stiffness = effort / (GRIP_SATURATION if finger else config.saturation_error)
    damping = stiffness * config.damping_time_s
    if finger:
        # So damped that the fingers reach their speed limit with their whole force, and hold no
        # bounce.
        damping = effort / (joint["velocity_limit"] or 0.2)
    stated = config.joint_gains.get(joint["name"], {})
    return Gains(
        stiffness=stated.get("stiffness", stiffness),
        damping=stated.get("damping", damping),
        # One motor: what a side load takes from one finger's force, the other has.
        effort_limit=stated.get("effort_limit", 2.0 * effort if finger else effort),
    )
