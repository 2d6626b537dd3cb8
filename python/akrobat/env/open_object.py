"""The environment `akrobat/OpenObject-v0`: a robot opens doors and drawers in physics."""

from __future__ import annotations

import json
import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar, Literal

import gymnasium
import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

from akrobat import _core
from akrobat.env.starts import Start, drawn, object_start, planned
from akrobat.errors import InputError
from akrobat.physics.audit import HANDLE_DISTANCE_M, OPENED_FRACTION, STRICT_HANDLE_DISTANCE_M
from akrobat.physics.config import PhysicsConfig
from akrobat.physics.controller import Controller
from akrobat.physics.world import World, rest_positions

StrPath = str | os.PathLike[str]
Observation = dict[str, NDArray[Any]]

RATE_HZ = 30
HORIZON_STEPS = 300
HOLD_STEPS = 10
"""steps for which the object must stay open with the gripper at the handle before an episode ends
early"""

SPLITS = ("seen", "unseen", "both")
ACTION_MODES = ("absolute", "relative")


@dataclass
class Place:
    """A task with its world."""

    task: _core.Task
    world: World
    controller: Controller
    trajectories: list[tuple[Path, _core.Trajectories]]


class OpenObjectEnv(gymnasium.Env[Observation, NDArray[np.float32]]):
    """Opens the driven joint of a task's object within 300 steps of 1/30 s.

    **Observation**: `state`, the base's x, y, yaw, the arm's joints and the opening between the
    fingers (11 numbers for a base and a 7-joint arm, SI units); with a rig, `NAME_rgb` and
    `NAME_depth_m` of each camera, and `cloud` `[N, 6]`.

    **Action**: targets of base, arm and fingers (12 numbers): positions, or with
    `action_mode="relative"` differences from the last targets. Fingers whose target is below 95%
    of their stroke close, and press with the gripper's force on what is between them.

    **Success**: the joint has reached 80% (doors) or 90% (drawers) of its goal and the gripper is
    within 0.1 m of the handle. The episode ends early where this has held for ten steps.
    """

    metadata: ClassVar[dict[str, Any]] = {"render_modes": ["rgb_array"], "render_fps": RATE_HZ}

    def __init__(
        self,
        tasks: Sequence[StrPath] | StrPath,
        *,
        trajectories: Sequence[StrPath] = (),
        split: Literal["seen", "unseen", "both"] | None = None,
        action_mode: Literal["absolute", "relative"] = "absolute",
        rig: StrPath | None = None,
        cloud_points: int = 0,
        cloud: Mapping[str, Any] | None = None,
        assets: Sequence[StrPath] = (),
        physics: Mapping[str, Any] | None = None,
        render_mode: str | None = None,
    ) -> None:
        """Loads the tasks.

        :param tasks: task files; episodes draw one of them
        :param trajectories: trajectory files of these tasks, whose starts and goals are the seen
            ones
        :param split: starts of the trajectory files, starts drawn anew, or in turns; `seen` where
            there are files
        :param action_mode: what actions mean
        :param rig: cameras of the observation, a preset or a rig file; none where absent
        :param cloud_points: points of the observed cloud, which needs a rig
        :param cloud: other settings of the cloud that differ from the defaults, such as
            `{"radius_m": 0.5}` (`cloud` in `akrobat schema job`)
        :param assets: folders where assets are looked up
        :param physics: settings that differ from the defaults (`akrobat schema physics`)
        :param render_mode: `rgb_array` for :meth:`render`
        """
        listed = [tasks] if isinstance(tasks, (str, os.PathLike)) else tasks
        files = [Path(task) for task in listed]
        folders = [Path(folder) for folder in assets]
        split = split or ("seen" if trajectories else "unseen")
        _check(files, split, action_mode, list(trajectories), rig=rig, cloud_points=cloud_points)
        self.split, self.action_mode, self.render_mode = split, action_mode, render_mode
        self._rig, self._cloud_points, self._cloud = rig, cloud_points, dict(cloud or {})
        self.config = PhysicsConfig.of(physics)
        self._substeps = max(round(1.0 / (RATE_HZ * self.config.timestep_s)), 1)
        loaded = [_core.Task.load(file, folders) for file in files]
        planned_files = [(Path(f), _core.Trajectories.read(Path(f))) for f in trajectories]
        self.places = [self._place(task, planned_files) for task in loaded]
        _check_same_robot(self.places)
        if split != "unseen" and not all(place.trajectories for place in self.places):
            names = [place.task.name for place in self.places if not place.trajectories]
            raise InputError(f"no trajectory file was given for {', '.join(names)}")
        self.place = self.places[0]
        self._observers: dict[int, _core.Observer] = {}
        self._spectator: _core.Observer | None = None
        self._episode = 0
        self._low, self._high, self._stride = self._limits()
        self.action_space = self._action_space()
        self._start = Start(np.zeros(len(self._low)), self.place.task.goals[0], None)
        self._targets = np.zeros(len(self._low))
        self._step = self._held = 0
        self._opened_max = 0.0
        self._reset_world(self._rest())
        self.observation_space = self._observation_space()

    # -- the interface of gymnasium ----------------------------------------------------------------

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Observation, dict[str, Any]]:
        """Starts an episode. `options` may hold `place` (position of the task) and `trajectory`
        (position in its first trajectory file, whose start and goal are taken)."""
        super().reset(seed=seed)
        options = options or {}
        if seed is not None:
            self._episode = 0
        number = options.get("place")
        if number is None:
            number = int(self.np_random.integers(len(self.places)))
        self.place = self.places[number]
        self.begin(self._draw(options.get("trajectory")))
        return self._observe(), self._info()

    def step(
        self, action: NDArray[np.float32]
    ) -> tuple[Observation, float, bool, bool, dict[str, Any]]:
        """Drives towards the targets for 1/30 s."""
        wanted = np.asarray(action, float)
        if wanted.shape != self._targets.shape:
            expected = self._targets.shape
            raise InputError(f"action: expected shape {expected}, got {wanted.shape}")
        if not np.isfinite(wanted).all():
            raise InputError("action: expected numbers, got NaN or infinity")
        if self.action_mode == "relative":
            wanted = self._targets + np.clip(wanted, -self._stride, self._stride)
        before = self.opened_fraction()
        self.advance(wanted)
        opened = self.opened_fraction()
        terminated = self._held >= HOLD_STEPS
        truncated = self._step >= HORIZON_STEPS
        reward = float(opened - before) + float(terminated)
        return self._observe(), reward, terminated, truncated, self._info()

    def render(self) -> NDArray[np.uint8] | None:  # type: ignore[override]
        """What the camera `fixed` of the rig `paper` sees."""
        if self.render_mode != "rgb_array":
            return None
        if self._step == 0 or self._spectator is None:
            self._spectator = self.observer("paper", {"points": 0})
        cameras = self._spectator.observe(self.row().tolist(), self.object_row().tolist())
        picture: NDArray[np.uint8] = cameras["cameras"]["fixed"]["rgb"]
        return picture

    # -- what policies, evaluation and other environments ask -------------------------------------

    def begin(self, start: Start) -> None:
        """Starts an episode of the current place here."""
        self._reset_world(start)
        self._episode += 1

    def advance(self, wanted: NDArray[np.float64]) -> None:
        """Drives towards absolute targets for 1/30 s, and notes how far the object opened within
        the horizon."""
        self._drive(np.clip(wanted, self._low, self._high))
        self._step += 1
        if self._step <= HORIZON_STEPS:
            self._opened_max = max(self._opened_max, self.opened_fraction())
        self._held = self._held + 1 if self.is_success() else 0

    def row(self) -> NDArray[np.float64]:
        """Positions of the joints that actions drive."""
        body = self.place.world.robot
        columns = [body.column[name] for name in self.joint_names]
        positions: NDArray[np.float64] = body.articulation.get_qpos()[columns].astype(float)
        return positions

    def object_row(self) -> NDArray[np.float64]:
        """Positions of the object's joints."""
        world = self.place.world
        columns = [world.object.column[n] for n in world.object_description["dof_joints"]]
        positions: NDArray[np.float64] = world.object.articulation.get_qpos()[columns].astype(float)
        return positions

    def observer(self, rig: str, cloud: Mapping[str, Any]) -> _core.Observer:
        """Cameras mounted for the episode that has begun."""
        middle = [*self.place.world.handle_points.mean(axis=0), 1.0, 0.0, 0.0, 0.0]
        row, goal = self.row().tolist(), self._start.goal
        return _core.Observer(self.place.task, rig, json.dumps(dict(cloud)), row, goal, middle)

    @property
    def joint_names(self) -> list[str]:
        """Names of the action's columns."""
        return [*self.place.controller.arm_names, *self.place.controller.finger_names]

    @property
    def targets(self) -> NDArray[np.float64]:
        """The last targets of all joints."""
        return self._targets.copy()

    def opened_fraction(self) -> float:
        """How far the driven joint is on its way to the goal."""
        world = self.place.world
        active = world.object_description["active_joint"]
        start = object_start(world)[active]
        position = float(world.object.articulation.get_qpos()[world.object.column[active]])
        return (position - start) / (self._start.goal - start)

    def is_success(self) -> bool:
        """Whether the joint has reached its fraction of the goal and the gripper is at the
        handle."""
        world = self.place.world
        reached = self._opened_max >= self._needed_fraction()
        return reached and world.handle_distance_m() <= HANDLE_DISTANCE_M

    # -- inside ------------------------------------------------------------------------------------

    def _place(self, task: _core.Task, files: list[tuple[Path, _core.Trajectories]]) -> Place:
        world = World(task, self.config)
        own = [(file, found) for file, found in files if found.header["task_name"] == task.name]
        return Place(task, world, Controller(world), own)

    def _needed_fraction(self) -> float:
        description = self.place.world.object_description
        active = description["active_joint"]
        kind = next(joint["kind"] for joint in description["joints"] if joint["name"] == active)
        return OPENED_FRACTION[kind]

    def _draw(self, trajectory: int | None) -> Start:
        place = self.place
        seen = self.split == "seen" or (self.split == "both" and self._episode % 2 == 0)
        if trajectory is not None or seen:
            if not place.trajectories:
                raise InputError(f"no trajectory file was given for {place.task.name}")
            number = int(self.np_random.integers(len(place.trajectories)))
            file, found = place.trajectories[0 if trajectory is not None else number]
            if trajectory is None:
                trajectory = int(self.np_random.integers(len(found)))
            if not 0 <= trajectory < len(found):
                raise InputError(f"{file}: no episode {trajectory}; there are {len(found)}")
            return planned(file, found, trajectory)
        return drawn(place.world, place.controller, place.task.goals, self.np_random)

    def _rest(self) -> Start:
        robot = self.place.world.robot_description
        rest = rest_positions(robot)
        return Start(np.array([rest[n] for n in self.joint_names]), self.place.task.goals[0], None)

    def _reset_world(self, start: Start) -> None:
        world, controller = self.place.world, self.place.controller
        robot = dict(zip(self.joint_names, start.robot.tolist(), strict=True))
        world.reset(robot, object_start(world))
        controller.hold()
        self._start, self._targets = start, start.robot.copy()
        self._step = self._held = 0
        self._opened_max = 0.0

    def _drive(self, wanted: NDArray[np.float64]) -> None:
        world, controller = self.place.world, self.place.controller
        arm = len(controller.arm_names)
        before, after = self._targets, wanted
        speed = (after - before)[:arm] * RATE_HZ
        closing = controller.is_closing(after[arm:])
        for substep in range(1, self._substeps + 1):
            share = substep / self._substeps
            controller.drive_arm((before + share * (after - before))[:arm], speed)
            if closing:
                controller.squeeze(after[arm:])
            else:
                controller.open_fingers(after[arm:])
            world.step()
        self._targets = after

    def _limits(self) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
        joints = {j["name"]: j for j in self.place.world.robot_description["joints"]}
        chosen = [joints[name] for name in self.joint_names]
        limits = np.array([joint["limits"] for joint in chosen], float)
        limits = np.clip(limits, -4.0 * np.pi, 4.0 * np.pi)
        speed = np.array([joint["velocity_limit"] or 1.0 for joint in chosen], float)
        return limits[:, 0], limits[:, 1], speed / RATE_HZ

    def _action_space(self) -> spaces.Box:
        if self.action_mode == "relative":
            return spaces.Box(-self._stride.astype(np.float32), self._stride.astype(np.float32))
        return spaces.Box(self._low.astype(np.float32), self._high.astype(np.float32))

    def _observation_space(self) -> spaces.Dict:
        entries: dict[str, spaces.Space[Any]] = {}
        for name, values in self._observe().items():
            low, high = (0, 255) if values.dtype == np.uint8 else (-np.inf, np.inf)
            entries[name] = spaces.Box(low, high, values.shape, values.dtype.type)
        return spaces.Dict(entries)

    def _observe(self) -> Observation:
        row = self.row()
        arm = len(self.place.controller.arm_names)
        opening = self.place.controller.opening_m(row[arm:])
        observation: Observation = {"state": np.append(row[:arm], opening).astype(np.float32)}
        if self._rig is not None:
            seen = self._see()
            for name, camera in seen["cameras"].items():
                observation[f"{name}_rgb"] = camera["rgb"]
                observation[f"{name}_depth_m"] = camera["depth_m"]
            if self._cloud_points:
                observation["cloud"] = seen["cloud"]
        return observation

    def _see(self) -> dict[str, Any]:
        """What the cameras see now; they are mounted anew at the start of each episode."""
        if self._step == 0 or id(self.place) not in self._observers:
            cloud = {**self._cloud, "points": self._cloud_points}
            self._observers = {id(self.place): self.observer(str(self._rig), cloud)}
        observer = self._observers[id(self.place)]
        return observer.observe(self.row().tolist(), self.object_row().tolist())

    def _info(self) -> dict[str, Any]:
        distance_m = self.place.world.handle_distance_m()
        success = self.is_success()
        return {
            "success": success,
            "success_strict": success and distance_m <= STRICT_HANDLE_DISTANCE_M,
            "opened_fraction": self.opened_fraction(),
            "opened_fraction_max": self._opened_max,
            "handle_distance_m": distance_m,
            "task": self.place.task.name,
            "goal": self._start.goal,
            "trajectory": self._start.source,
        }


def _check(
    files: list[Path],
    split: str,
    action_mode: str,
    trajectories: list[StrPath],
    *,
    rig: StrPath | None,
    cloud_points: int,
) -> None:
    if not files:
        raise InputError("tasks: expected at least one task file")
    for name, value, choices in (
        ("split", split, SPLITS),
        ("action_mode", action_mode, ACTION_MODES),
    ):
        if value not in choices:
            raise InputError(f'{name}: unknown "{value}"; valid choices: {", ".join(choices)}')
    if split != "unseen" and not trajectories:
        raise InputError(f'split "{split}" needs trajectory files')
    if cloud_points and rig is None:
        raise InputError("cloud_points: a cloud needs cameras: give a rig")


def _check_same_robot(places: list[Place]) -> None:
    robots = {place.world.robot_description["name"] for place in places}
    if len(robots) > 1:
        raise InputError(f"the tasks' robots differ: {', '.join(sorted(robots))}")
