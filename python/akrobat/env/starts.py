"""Where episodes start."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from akrobat import _core
from akrobat.physics import poses
from akrobat.physics.controller import Controller
from akrobat.physics.world import World, rest_positions

Vector = NDArray[np.float64]

# How far from the handle, and how far to the side of its way out, the base may stand.
DISTANCE_M = (0.75, 1.25)
BEARING_RAD = 0.7
YAW_RAD = 0.4
ARM_RAD = 0.15
ATTEMPTS = 200


@dataclass(frozen=True)
class Start:
    """A start of an episode."""

    robot: Vector
    """base, arm and fingers"""
    goal: float
    """position of the driven joint, rad or m"""
    source: tuple[str, int] | None
    """trajectory file and position in it, where the start is that of a planned trajectory"""


def planned(file: Path, trajectories: _core.Trajectories, index: int) -> Start:
    """The start and goal of a planned trajectory."""
    trajectory = trajectories[index]
    return Start(trajectory.robot[0].astype(float), trajectory.goal, (str(file), index))


def drawn(
    world: World, controller: Controller, goals: list[float], rng: np.random.Generator
) -> Start:
    """A free configuration in front of the handle, its base turned to it, and one of the task's
    goals."""
    robot = world.robot_description
    goal = float(rng.choice(goals))
    rest = rest_positions(robot)
    handle, outward = _handle(world, goal)
    names = [*controller.arm_names, *controller.finger_names]
    arm_limits = {joint["name"]: joint["limits"] for joint in robot["joints"]}
    for _ in range(ATTEMPTS):
        row = dict(rest)
        if robot["base_joints"]:
            bearing = np.arctan2(outward[1], outward[0]) + rng.uniform(-BEARING_RAD, BEARING_RAD)
            distance_m = rng.uniform(*DISTANCE_M)
            x, y, yaw = robot["base_joints"]
            row[x] = handle[0] + distance_m * np.cos(bearing)
            row[y] = handle[1] + distance_m * np.sin(bearing)
            facing = bearing + np.pi + rng.uniform(-YAW_RAD, YAW_RAD)
            row[yaw] = np.arctan2(np.sin(facing), np.cos(facing))
        for name in robot["arm_joints"]:
            low, high = arm_limits[name]
            row[name] = np.clip(rest[name] + rng.uniform(-ARM_RAD, ARM_RAD), low, high)
        for name, position in zip(robot["gripper_joints"], robot["gripper_open"], strict=True):
            row[name] = position
        if _is_free(world, controller, row):
            return Start(np.array([row[name] for name in names]), goal, None)
    raise _core.RunError(
        f"no free start was found in {ATTEMPTS} attempts; is the handle walled in?"
    )


def _handle(world: World, goal: float) -> tuple[Vector, Vector]:
    """The middle of the handle, and which way it moves first: horizontal, unit length."""
    world.reset({}, object_start(world))
    before = poses.transform(world.handle_link_pose(), world.handle_points.mean(axis=0))
    start = object_start(world)
    active = world.object_description["active_joint"]
    start[active] += 0.1 * (goal - start[active])
    world.reset({}, start)
    after = poses.transform(world.handle_link_pose(), world.handle_points.mean(axis=0))
    way = (after - before)[:2]
    length = float(np.linalg.norm(way))
    return before, way / length if length > 1e-6 else np.array([1.0, 0.0])


def object_start(world: World) -> dict[str, float]:
    """Positions of the object's joints at the start."""
    description = world.object_description
    return dict(zip(description["dof_joints"], description["start"], strict=True))


def _is_free(world: World, controller: Controller, row: dict[str, float]) -> bool:
    world.reset(
        {name: row[name] for name in row if name in world.robot.column}, object_start(world)
    )
    controller.hold()
    world.step()
    robot = set(world.robot.link)
    touching = (
        robot.intersection(body.entity.name for body in contact.bodies)
        for contact in world.system.get_contacts()
        if min((point.separation for point in contact.points), default=1.0) <= 0.0
    )
    return not any(touching)
