"""What the physics is made of: time steps, controller gains, contact properties."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from akrobat import _core


@dataclass(frozen=True)
class PhysicsConfig:
    """Settings of a replay; defaults, units and meaning are those of `akrobat schema physics`."""

    timestep_s: float
    audit_interval_steps: int
    time_stretch: float
    squeeze_s: float
    settle_s: float
    saturation_error: float
    damping_time_s: float
    joint_gains: dict[str, dict[str, float]]
    grip_force_n: float | None
    pad_friction: float
    surface_friction: float
    handle_force_limit_n: float
    handle_force_floor_n: float
    protective_stop: bool
    keep_gripper_open: bool
    object_offset_m: tuple[float, float, float]

    @staticmethod
    def of(values: Mapping[str, Any] | None = None) -> PhysicsConfig:
        """The defaults with some values replaced; unknown names and wrong values are refused."""
        checked = _core.physics_config(dict(values or {}))
        return PhysicsConfig(**{**checked, "object_offset_m": tuple(checked["object_offset_m"])})
