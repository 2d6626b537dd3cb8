"""The object's joints: nobody drives them, but they resist."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from akrobat.physics import poses

if TYPE_CHECKING:
    from akrobat.physics.world import World

# How fast doors and drawers are moved by hand, at which friction and damping are felt.
REFERENCE_SPEED = {"prismatic": 0.25, "revolute": 0.5, "continuous": 0.5}

# Dry friction below this speed (rad/s, m/s) grows in proportion to it, which keeps the solver
# stable.
STICTION_SPEED = 1e-4

# A joint is still that moves less than this (rad, m) within the trial's time.
STILL = 1e-3
TRIAL_S = 0.5


@dataclass
class PassiveJoint:
    """How a joint resists, in SI units of its kind."""

    name: str
    friction: float
    """dry: N or N m"""
    damping: float
    """viscous: N s/m or N m s/rad"""
    lever_m: float
    """from the joint's axis to the handle, or to the link's own shapes; 1 for sliding joints"""
    urdf_friction: float
    urdf_damping: float
    calibrated: bool
    """true where the file's values would need more than a hand's force, and others were found"""

    def record(self) -> dict[str, Any]:
        """For reports."""
        return asdict(self)


def passive_joints(world: World) -> list[PassiveJoint]:
    """Reads how the object's joints resist, and calibrates what cannot be meant."""
    config = world.config
    joints = []
    for description in world.object_description["joints"]:
        if description["name"] not in world.object.joint:
            continue
        lever_m = _lever_m(world, description)
        speed = REFERENCE_SPEED[description["kind"]]
        needed_n = (description["friction"] + description["damping"] * speed) / lever_m
        joint = PassiveJoint(
            name=description["name"],
            friction=description["friction"],
            damping=description["damping"],
            lever_m=lever_m,
            urdf_friction=description["friction"],
            urdf_damping=description["damping"],
            calibrated=needed_n > config.handle_force_limit_n,
        )
        if joint.calibrated:
            if joint.damping * speed / lever_m > config.handle_force_limit_n:
                joint.damping = 0.0
            joint.friction = config.handle_force_floor_n * lever_m
        joints.append(joint)
        _apply(world, joint)
    _hold_still(world, joints)
    return joints


def _apply(world: World, joint: PassiveJoint) -> None:
    """Dry friction as a drive towards rest that saturates at the friction's force."""
    world.object.joint[joint.name].set_drive_properties(
        0.0, joint.friction / STICTION_SPEED, force_limit=joint.friction, mode="force"
    )


def _hold_still(world: World, joints: list[PassiveJoint]) -> None:
    """Raises the friction of joints that do not keep their start under gravity, by as little as it
    takes."""
    start = world.object.articulation.get_qpos()
    steps = round(TRIAL_S / world.config.timestep_s)
    for _ in range(40):
        world.object.articulation.set_qpos(start)
        world.object.articulation.set_qvel(np.zeros_like(start))
        world.passive = joints
        for _ in range(steps):
            world.step()
        moved = np.abs(world.object.articulation.get_qpos() - start)
        loose = [joint for joint in joints if moved[world.object.column[joint.name]] > STILL]
        if not loose:
            break
        for joint in loose:
            joint.friction = max(joint.friction * 1.25, 0.1 * joint.lever_m)
            joint.calibrated = True
            _apply(world, joint)
    world.object.articulation.set_qpos(start)
    world.object.articulation.set_qvel(np.zeros_like(start))


def _lever_m(world: World, joint: dict[str, Any]) -> float:
    """Distance from a hinge's axis to where a hand would move it."""
    if joint["kind"] == "prismatic":
        return 1.0
    description = world.object_description
    link = next(li for li in description["links"] if li["name"] == joint["child"])
    parts = link["visuals"] or link["collisions"]
    corners = [poses.transform(part["link_from_part"], part["positions"]) for part in parts]
    if not corners:
        return 1.0
    axis = np.asarray(joint["axis"], float)
    points = np.concatenate(corners)
    across = points - np.outer(points @ axis, axis)
    return max(float(np.linalg.norm(across, axis=1).max()), 0.01)
