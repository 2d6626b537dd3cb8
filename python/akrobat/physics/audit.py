"""What an episode did: traces, findings, and success or the reason of failure."""

from __future__ import annotations

from collections import defaultdict
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from akrobat.physics import poses

if TYPE_CHECKING:
    from akrobat import _core
    from akrobat.physics.controller import Controller
    from akrobat.physics.world import World

MANIPULATE = 3

# Success: the fraction of the way to the goal, by the kind of joint, and at the end the gripper at
# the handle.
OPENED_FRACTION = {"revolute": 0.8, "continuous": 0.8, "prismatic": 0.9}
HANDLE_DISTANCE_M = 0.1
STRICT_HANDLE_DISTANCE_M = 0.05
HORIZON_S = 10.0
"""300 steps at 30 Hz"""

DEEP_M = 0.005
"""penetration that counts as deep"""
SLIPPED_M = 0.03
"""displacement of the handle in the hand that counts as lost"""
TOUCH_N = 1.0
"""force from which a contact of anything but fingers and handle is reported"""
BLOCKING_N = 50.0
"""force on anything else from which that stands in the way"""
SPIKE_FACTOR = 3.0
"""times a joint's speed limit that counts as a spike"""
OBJECT_SPIKE_SPEED = 10.0
"""speed of an object's joint (rad/s, m/s) that no opening by hand has"""

REASONS = (
    "unstable",
    "over_speed",
    "handle_lost",
    "too_slow",
    "no_grasp",
    "slipped",
    "blocked",
    "off_track",
    "not_opened",
)
"""why episodes fail, in the order in which they are looked for"""


@dataclass
class EpisodeAudit:
    """The findings about one episode."""

    episode: int
    id: str
    success: bool
    reason: str
    """empty on success, else one of :data:`REASONS`"""
    findings: dict[str, Any]
    """numbers by name; units stand in the names"""
    traces: dict[str, NDArray[np.float32]]
    """`[N, columns]` each, with `times` `[N, 1]`"""
    columns: dict[str, list[str]]
    """names of the columns of the traces"""
    phase: NDArray[np.uint8] = field(default_factory=lambda: np.zeros(0, np.uint8))
    """`[N]`"""


@dataclass(frozen=True)
class Command:
    """What the robot was told, and whether it obeyed."""

    speed_fraction: NDArray[np.float64]
    """greatest speed of the targets as a fraction of each joint's limit `[J]`"""
    stopped_at_s: float | None
    """when the robot refused to go on"""


class Recorder:
    """Takes notes while an episode runs."""

    def __init__(self, world: World, controller: Controller, active_joint: str) -> None:
        self._world = world
        self._controller = controller
        self._active = active_joint
        description = world.object_description
        self._handle_link = description["handle_link"]
        self._fingers: list[str] = world.robot_description["finger_links"]
        self._robot_links = set(world.robot.link)
        self._rows: dict[str, list[Any]] = defaultdict(list)
        self._touched: dict[tuple[str, str], float] = defaultdict(float)
        self._robot_columns = [
            world.robot.column[name] for name in controller.arm_names + controller.finger_names
        ]
        self._object_columns = [world.object.column[name] for name in description["dof_joints"]]

    def note(self, time_s: float, phase: int, arm_target: NDArray[np.float64]) -> None:
        """Takes down one instant."""
        world, rows = self._world, self._rows
        robot = world.robot.articulation.get_qpos()[self._robot_columns]
        rows["times"].append([time_s])
        rows["phase"].append(phase)
        rows["robot"].append(robot)
        rows["object"].append(world.object.articulation.get_qpos()[self._object_columns])
        rows["robot_speed"].append(world.robot.articulation.get_qvel()[self._robot_columns])
        rows["object_speed"].append(world.object.articulation.get_qvel()[self._object_columns])
        rows["tracking_error"].append(robot[: len(arm_target)] - arm_target)
        tool, link = world.tool_pose(), world.handle_link_pose()
        rows["tool"].append(tool)
        rows["tool_in_handle"].append(poses.compose(poses.inverse(link), tool))
        rows["handle_distance"].append([world.handle_distance_m()])
        self._note_contacts()

    def _note_contacts(self) -> None:
        finger_force = dict.fromkeys(self._fingers, 0.0)
        finger_depth = other_depth = other_force = 0.0
        for contact in self._world.system.get_contacts():
            first, second = (body.entity.name for body in contact.bodies)
            if first not in self._robot_links:
                first, second = second, first
            if first not in self._robot_links:
                continue
            points = contact.points
            depth = max((-point.separation for point in points), default=0.0)
            impulse = np.sum([point.impulse for point in points], axis=0)
            force = float(np.linalg.norm(impulse)) / self._world.config.timestep_s
            if first in finger_force and second == self._handle_link:
                finger_force[first] += force
                finger_depth = max(finger_depth, depth)
            else:
                other_depth = max(other_depth, depth)
                other_force = max(other_force, force)
                pair = (first, second)
                self._touched[pair] = max(self._touched[pair], force)
        self._rows["finger_force"].append(list(finger_force.values()))
        self._rows["penetration"].append([finger_depth, other_depth])
        self._rows["other_force"].append([other_force])

    def finish(
        self, episode: int, trajectory: _core.Trajectory, planned_tool: Any, command: Command
    ) -> EpisodeAudit:
        """Draws the conclusions.

        :param planned_tool: `world_from_tool` of the targets at each instant `[N, 7]`
        :param command: what the robot was told
        """
        traces = {
            name: np.asarray(rows, np.float32)
            for name, rows in self._rows.items()
            if name != "phase"
        }
        phase = np.asarray(self._rows["phase"], np.uint8)
        description = self._world.object_description
        joint = next(j for j in description["joints"] if j["name"] == self._active)
        column = description["dof_joints"].index(self._active)
        position = traces["object"][:, column]
        start, goal = trajectory.start, trajectory.goal
        traces["opened"] = ((position - start) / (goal - start))[:, None]
        traces["slip"] = _slip(traces["tool_in_handle"], phase)
        traces["tool_error"] = _pose_error(traces["tool"], planned_tool)
        findings = self._findings(traces, phase, OPENED_FRACTION[joint["kind"]], column)
        findings |= {
            "stopped_at_s": command.stopped_at_s,
            "command_speed_fraction_max": dict(
                zip(self._controller.arm_names, command.speed_fraction.tolist(), strict=True)
            ),
        }
        reason = _reason(findings)
        findings["clean"] = reason == "" and _is_clean(findings)
        columns = {
            "robot": self._controller.arm_names + self._controller.finger_names,
            "object": list(description["dof_joints"]),
            "tracking_error": self._controller.arm_names,
            "finger_force": self._fingers,
            "penetration": ["fingers_and_handle", "anything_else"],
            "slip": ["translation_m", "rotation_rad"],
            "tool_error": ["translation_m", "rotation_rad"],
        }
        return EpisodeAudit(
            episode, trajectory.id, reason == "", reason, findings, traces, columns, phase
        )

    def _findings(
        self,
        traces: dict[str, NDArray[np.float32]],
        phase: NDArray[np.uint8],
        needed: float,
        column: int,
    ) -> dict[str, Any]:
        times = traces["times"][:, 0]
        opened = traces["opened"][:, 0]
        moving = phase == MANIPULATE
        holding = (traces["finger_force"] > 0.0)[moving]
        reached = np.flatnonzero(opened >= needed)
        arm = self._controller.arm_names
        speed_fraction = (
            np.abs(traces["robot_speed"][:, : len(arm)]) / self._controller.speed_limits
        )
        interval_s = float(np.median(np.diff(times))) if len(times) > 1 else 0.0
        deep = traces["penetration"].max(axis=1) > DEEP_M
        tracking = np.abs(traces["tracking_error"])
        touched = {
            f"{robot_link} / {other}": round(force, 2)
            for (robot_link, other), force in sorted(self._touched.items())
            if force >= TOUCH_N
        }
        grasped = holding[: max(int(0.1 / max(interval_s, 1e-9)), 1)]
        return {
            "finite": bool(all(np.isfinite(trace).all() for trace in traces.values())),
            "needed_fraction": needed,
            "opened_fraction_max": float(opened.max()),
            "opened_fraction_end": float(opened[-1]),
            "reached_at_s": float(times[reached[0]]) if len(reached) else None,
            "duration_s": float(times[-1]),
            "handle_distance_end_m": float(traces["handle_distance"][-1, 0]),
            "grasped": bool(grasped.all(axis=1).any()) if len(grasped) else False,
            "contact_fraction": float(holding.any(axis=1).mean()) if moving.any() else 0.0,
            "two_finger_contact_fraction": (
                float(holding.all(axis=1).mean()) if moving.any() else 0.0
            ),
            "finger_force_max_n": float(traces["finger_force"].max()),
            "slip_max_m": float(traces["slip"][:, 0].max()),
            "slip_max_rad": float(traces["slip"][:, 1].max()),
            "penetration_max_m": float(traces["penetration"].max()),
            "finger_penetration_max_m": float(traces["penetration"][:, 0].max()),
            "other_penetration_max_m": float(traces["penetration"][:, 1].max()),
            "penetration_above_5mm_s": float(deep.sum() * interval_s),
            "tracking_error_max": dict(zip(arm, tracking.max(axis=0).tolist(), strict=True)),
            "tool_error_max_m": float(traces["tool_error"][:, 0].max()),
            "tool_error_max_rad": float(traces["tool_error"][:, 1].max()),
            "other_contacts_n": touched,
            "other_force_max_n": float(traces["other_force"].max()),
            "robot_speed_fraction_max": float(speed_fraction.max()),
            "object_speed_max": float(np.abs(traces["object_speed"][:, column]).max()),
            "spikes": int((speed_fraction > SPIKE_FACTOR).any(axis=1).sum())
            + int((np.abs(traces["object_speed"]) > OBJECT_SPIKE_SPEED).any(axis=1).sum()),
        }


def _reason(findings: dict[str, Any]) -> str:
    """Why it failed; empty where it did not."""
    reached = findings["reached_at_s"]
    opened = reached is not None
    in_time = opened and reached <= HORIZON_S
    at_handle = findings["handle_distance_end_m"] <= HANDLE_DISTANCE_M
    looked_for = {
        "unstable": not findings["finite"] or (not opened and findings["spikes"] > 0),
        "over_speed": not opened and findings["stopped_at_s"] is not None,
        "handle_lost": in_time and not at_handle,
        "too_slow": opened and not in_time,
        "no_grasp": not opened and not findings["grasped"],
        "slipped": not opened and findings["slip_max_m"] > SLIPPED_M,
        "blocked": not opened and findings["other_force_max_n"] > BLOCKING_N,
        "off_track": not opened and findings["tool_error_max_m"] > SLIPPED_M,
        "not_opened": not opened,
    }
    return next((reason for reason, found in looked_for.items() if found), "")


def _is_clean(findings: dict[str, Any]) -> bool:
    """Whether nothing but the fingers touched anything, and they held throughout."""
    return (
        findings["other_force_max_n"] < TOUCH_N
        and findings["penetration_max_m"] <= DEEP_M
        and findings["slip_max_m"] <= SLIPPED_M
        and findings["contact_fraction"] == 1.0
        and findings["spikes"] == 0
    )


def _slip(tool_in_handle: NDArray[np.float32], phase: NDArray[np.uint8]) -> NDArray[np.float32]:
    """How far the tool has moved in the handle's frame since each manipulation began `[N, 2]`."""
    slip = np.zeros((len(phase), 2), np.float32)
    moving = np.flatnonzero(phase == MANIPULATE)
    for run in np.split(moving, np.flatnonzero(np.diff(moving) > 1) + 1):
        slip[run] = _pose_error(tool_in_handle[run], tool_in_handle[run[:1]])
    return slip


def _pose_error(poses_a: Any, poses_b: Any) -> NDArray[np.float32]:
    """Distance (m) and angle (rad) between poses `[N, 2]`."""
    a, b = np.asarray(poses_a, float), np.asarray(poses_b, float)
    distance = np.linalg.norm(a[:, :3] - b[:, :3], axis=1)
    dot = np.clip(np.abs(np.sum(a[:, 3:] * b[:, 3:], axis=1)), 0.0, 1.0)
    return np.stack([distance, 2.0 * np.arccos(dot)], axis=1).astype(np.float32)
