"""Drives planned trajectories through physics."""

from __future__ import annotations

import multiprocessing
import os
from collections.abc import Iterator, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from akrobat import _core
from akrobat.errors import InputError
from akrobat.physics.audit import MANIPULATE, Command, EpisodeAudit, Recorder
from akrobat.physics.config import PhysicsConfig
from akrobat.physics.controller import Controller
from akrobat.physics.kinematics import tool_poses
from akrobat.physics.world import World, require_sapien

GRASP = 2

OVER_SPEED = 1.05
"""fraction of a joint's speed limit beyond which the arm's own controller stops it"""

Vector = NDArray[np.float64]


@dataclass(frozen=True)
class Timeline:
    """Targets at every time step."""

    times_s: Vector
    """`[S]`"""
    arm: Vector
    """base and arm positions `[S, J]`"""
    arm_speed: Vector
    """`[S, J]`"""
    fingers: Vector
    """`[S, F]`"""
    phase: NDArray[np.uint8]
    """`[S]`"""
    pressing: NDArray[np.bool_]
    """whether the fingers press rather than follow their positions `[S]`"""


class Clock:
    """Planned times of real ones: stretched, with a pause before each manipulation in which the
    fingers press, and one at the end."""

    def __init__(self, trajectory: _core.Trajectory, config: PhysicsConfig) -> None:
        phase, planned_s = trajectory.phase, trajectory.times_s
        begins = np.flatnonzero((phase[1:] == MANIPULATE) & (phase[:-1] != MANIPULATE))
        real, planned = [0.0], [0.0]
        for count, begin in enumerate(begins):
            before_s = float(planned_s[begin]) * config.time_stretch + count * config.squeeze_s
            real += [before_s, before_s + config.squeeze_s]
            planned += [float(planned_s[begin])] * 2
        moving_s = float(planned_s[-1]) * config.time_stretch
        end_s = moving_s + len(begins) * config.squeeze_s
        self.real_s = np.array([*real, end_s, end_s + config.settle_s])
        self.planned_s = np.array([*planned, planned_s[-1], planned_s[-1]])
        self.pauses = self.real_s[1:-2].reshape(-1, 2)
        """begin and end of each pause before a manipulation, real time `[P, 2]`"""

    def planned(self, real_s: Vector) -> Vector:
        """Times on the plan, seconds."""
        return np.interp(real_s, self.real_s, self.planned_s)


def timeline(trajectory: _core.Trajectory, fingers: int, config: PhysicsConfig) -> Timeline:
    """The trajectory as targets of every time step."""
    clock = Clock(trajectory, config)
    steps = round(clock.real_s[-1] / config.timestep_s)
    times_s = np.arange(1, steps + 1) * config.timestep_s
    path_s, planned_s, phase = clock.planned(times_s), trajectory.times_s, trajectory.phase
    robot = trajectory.robot.astype(float)
    rows = np.stack([np.interp(path_s, planned_s, column) for column in robot.T], axis=1)
    speed = np.gradient(rows, config.timestep_s, axis=0)
    at = np.minimum(np.searchsorted(planned_s, path_s - 1e-9), len(phase) - 1)
    pressing = np.isin(phase[at], (GRASP, MANIPULATE))
    for begin_s, end_s in clock.pauses:
        pressing |= (times_s > begin_s) & (times_s <= end_s)
    joints = rows.shape[1] - fingers
    return Timeline(
        times_s, rows[:, :joints], speed[:, :joints], rows[:, joints:], phase[at], pressing
    )


def stopped(path: Timeline, step: int) -> Timeline:
    """The timeline of a robot that stops for good at a time step."""
    values = {
        name: np.concatenate([rows[:step], np.broadcast_to(rows[step], rows[step:].shape)])
        for name, rows in (
            ("arm", path.arm),
            ("fingers", path.fingers),
            ("pressing", path.pressing),
            ("arm_speed", path.arm_speed),
        )
    }
    values["arm_speed"][step:] = 0.0
    return replace(path, **values)


class Replayer:
    """Replays trajectories of one task, one after another, in the same world."""

    def __init__(self, task: _core.Task, config: PhysicsConfig) -> None:
        self.config = config
        self.world = World(task, config)
        self.controller = Controller(self.world)

    def replay(self, trajectories: _core.Trajectories, episode: int) -> EpisodeAudit:
        """Runs one episode and audits it."""
        trajectory = trajectories[episode]
        world, controller, config = self.world, self.controller, self.config
        path = timeline(trajectory, len(controller.finger_names), config)
        told = np.abs(path.arm_speed) / controller.speed_limits
        over = np.flatnonzero(told.max(axis=1) > OVER_SPEED)
        stop = int(over[0]) if config.protective_stop and len(over) else None
        driven = path if stop is None else stopped(path, stop)
        names = [*controller.arm_names, *controller.finger_names]
        world.reset(
            dict(zip(names, trajectory.robot[0].tolist(), strict=True)),
            dict(zip(trajectories.object_joints, trajectory.object[0].tolist(), strict=True)),
        )
        recorder = Recorder(world, controller, world.object_description["active_joint"])
        targets = []
        for step, time_s in enumerate(path.times_s):
            controller.drive_arm(driven.arm[step], driven.arm_speed[step])
            if not driven.pressing[step]:
                controller.open_fingers(driven.fingers[step])
            elif not config.keep_gripper_open:
                controller.squeeze(driven.fingers[step])
            world.step()
            if (step + 1) % config.audit_interval_steps == 0:
                recorder.note(float(time_s), int(path.phase[step]), path.arm[step])
                targets.append(np.concatenate([path.arm[step], path.fingers[step]]))
        planned_tool = tool_poses(world.robot_description, names, np.asarray(targets))
        command = Command(told.max(axis=0), None if stop is None else float(path.times_s[stop]))
        return recorder.finish(episode, trajectory, planned_tool, command)

    def record(self) -> dict[str, Any]:
        """What the world is made of, for reports."""
        return {
            "gains": {name: asdict(gains) for name, gains in self.controller.gains.items()},
            "gravity": "the robot's links are compensated; everything else falls",
            "object_joints": [joint.record() for joint in self.world.passive],
            "collision_shapes": [asdict(errors) for errors in self.world.shape_errors],
        }


class ReplayRun:
    """Episodes of a trajectory file, replayed in this process or in several.

    Iterating yields an :class:`EpisodeAudit` as each episode ends, in any order; every episode
    starts from the same state, so the results do not depend on the number of processes.
    """

    def __init__(
        self,
        trajectories: Path,
        episodes: list[int],
        config: dict[str, Any],
        assets: list[Path],
        workers: int = 1,
    ) -> None:
        require_sapien()
        self._job = (trajectories, config, assets)
        self._episodes = episodes
        self._workers = min(workers, len(episodes))
        self._pool: ProcessPoolExecutor | None = None
        self.world: dict[str, Any] = {}
        """what the world is made of, once an episode has ended"""

    def __iter__(self) -> Iterator[EpisodeAudit]:
        runs = self._in_processes() if self._workers > 1 else self._here()
        for audit, world in runs:
            self.world = world
            yield audit

    def _here(self) -> Iterator[tuple[EpisodeAudit, dict[str, Any]]]:
        for episode in self._episodes:
            yield _replay_one(self._job, episode)

    def _in_processes(self) -> Iterator[tuple[EpisodeAudit, dict[str, Any]]]:
        # Spawned: a forked child would inherit threads that are not there.
        context = multiprocessing.get_context("spawn")
        with ProcessPoolExecutor(self._workers, mp_context=context) as self._pool:
            runs = [self._pool.submit(_replay_one, self._job, e) for e in self._episodes]
            try:
                for run in as_completed(runs):
                    yield run.result()
            finally:
                self._pool.shutdown(wait=True, cancel_futures=True)

    def stop(self) -> None:
        """Starts no more episodes."""
        if self._pool is not None:
            self._pool.shutdown(wait=False, cancel_futures=True)


_open: dict[str, tuple[Replayer, _core.Trajectories]] = {}
"""the world of this process; one at a time"""


def _replay_one(
    job: tuple[Path, dict[str, Any], list[Path]], episode: int
) -> tuple[EpisodeAudit, dict[str, Any]]:
    trajectories, config, assets = job
    key = repr(job)
    if key not in _open:
        _open.clear()
        task = _core.Task.of_trajectories(trajectories, assets)
        _open[key] = (
            Replayer(task, PhysicsConfig.of(config)),
            _core.Trajectories.read(trajectories),
        )
    replayer, planned = _open[key]
    return replayer.replay(planned, episode), replayer.record()


def replay(
    trajectories: str | os.PathLike[str],
    *,
    episodes: Sequence[int] | None = None,
    config: Mapping[str, Any] | None = None,
    assets: Sequence[str | os.PathLike[str]] = (),
    workers: int = 1,
) -> list[EpisodeAudit]:
    """Drives trajectories through physics and audits them; `akrobat replay` also writes what came
    of it.

    :param trajectories: trajectory file
    :param episodes: positions in the file; all where absent
    :param config: settings that differ from the defaults (`akrobat schema physics`)
    :param assets: folders where assets are looked up
    :param workers: number of processes; the result does not depend on it
    """
    file = Path(trajectories)
    count = len(_core.Trajectories.read(file))
    chosen = list(range(count)) if episodes is None else list(episodes)
    if wrong := [e for e in chosen if not 0 <= e < count]:
        raise InputError(f"{file}: no episode {wrong[0]}; valid choices: 0 to {count - 1}")
    run = ReplayRun(file, chosen, dict(config or {}), [Path(f) for f in assets], workers)
    return sorted(run, key=lambda audit: audit.episode)
