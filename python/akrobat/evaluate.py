"""Closed-loop trials of policies: what `akrobat eval` runs.

A policy is a function from an observation of `akrobat/OpenObject-v0` to an action. What makes it,
`module:attribute`, is called with the environment. A policy may have a method `reset(observation,
info)`, called at the start of each trial.
"""

from __future__ import annotations

import csv
import importlib
import json
import os
import sys
import tempfile
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import IO, Any

import numpy as np
from numpy.typing import NDArray

from akrobat import _core
from akrobat.errors import InputError, RunError

Observation = dict[str, NDArray[Any]]
Policy = Callable[[Observation], NDArray[Any]]

COLUMNS = (
    "trial",
    "task",
    "split",
    "trajectory",
    "goal",
    "success",
    "success_strict",
    "opened_fraction_max",
    "opened_fraction_end",
    "handle_distance_end_m",
    "steps",
    "return",
)


class ReplayPolicy:
    """Follows the planned trajectory whose start the trial has: what a perfect imitator would
    do."""

    def __init__(self, env: Any) -> None:
        self._env = env
        self._targets: NDArray[np.float64] = np.zeros((1, 1))
        self._step = 0

    def reset(self, observation: Observation, info: dict[str, Any]) -> None:
        """Loads the trial's trajectory."""
        from akrobat.env.open_object import RATE_HZ
        from akrobat.physics.replay import Clock

        if info["trajectory"] is None:
            raise InputError("policy replay: it needs the starts of trajectory files (split seen)")
        file, index = info["trajectory"]
        trajectory = _core.Trajectories.read(Path(file))[index]
        clock = Clock(trajectory, self._env.config)
        # Targets are those that lead to the next observation.
        wanted_s = np.arange(1, round(clock.real_s[-1] * RATE_HZ) + 1) / RATE_HZ
        path_s, times_s = clock.planned(wanted_s), trajectory.times_s
        columns = trajectory.robot.astype(float).T
        self._targets = np.stack([np.interp(path_s, times_s, c) for c in columns], axis=1)
        self._step = 0

    def __call__(self, observation: Observation) -> NDArray[np.float64]:
        """The next target; the last one from then on."""
        target: NDArray[np.float64] = self._targets[min(self._step, len(self._targets) - 1)]
        self._step += 1
        return target


class Evaluation:
    """Trials of one job; iterating runs them and yields a row for each."""

    def __init__(self, job: dict[str, Any]) -> None:
        from akrobat.physics.world import require_sapien

        require_sapien()
        self._job = job
        self._output = Path(job["output"])
        eyes = policy_eyes(job["policy"], job["rig"], job["cloud_points"])
        _prepare(self._output)
        from akrobat.env import OpenObjectEnv

        self._env = OpenObjectEnv(
            job["tasks"],
            trajectories=job["trajectories"],
            split=job["split"],
            assets=job["assets"],
            **eyes,
            render_mode="rgb_array" if job["videos"] else None,
        )
        self._policy = make_policy(job["policy"], self._env)
        self._rows: list[dict[str, Any]] = []
        self._videos = {True: 0, False: 0}

    def __iter__(self) -> Iterator[dict[str, Any]]:
        file = self._output / "trials.csv"
        with open(file, "w", newline="", encoding="utf-8") as table:
            writer = csv.DictWriter(table, COLUMNS)
            writer.writeheader()
            for trial in range(self._job["trials"]):
                row = self._trial(trial)
                self._rows.append(row)
                writer.writerow(row)
                table.flush()
                yield row

    def finish(self) -> dict[str, Any]:
        """Writes the summary and its plot."""
        summary = summarize(self._rows)
        summary["policy"] = self._job["policy"]
        if _is_folder(self._job["policy"]):
            from akrobat.policy.folder import describe

            summary["trajectories"] = describe(Path(self._job["policy"]))["trajectories"]
        summary["seed"] = self._job["seed"]
        _write_whole(self._output / "summary.json", json.dumps(summary, indent=2) + "\n")
        _write_whole(self._output / "summary.svg", plot(summary))
        return summary

    def _trial(self, trial: int) -> dict[str, Any]:
        env, job = self._env, self._job
        place = trial % len(env.places)
        round_number = trial // len(env.places)
        options: dict[str, Any] = {"place": place}
        seen = job["split"] == "seen" or (job["split"] == "both" and round_number % 2 == 0)
        if seen:
            # Trajectories take turns, so that every one is tried before any is tried twice.
            turn = round_number // (2 if job["split"] == "both" else 1)
            options["trajectory"] = turn % len(env.places[place].trajectories[0][1])
        env.split = "seen" if seen else "unseen"
        observation, info = env.reset(seed=job["seed"] * 1_000_003 + trial, options=options)
        if hasattr(self._policy, "reset"):
            self._policy.reset(observation, info)
        frames = [env.render()] if job["videos"] else []
        total, steps, done = 0.0, 0, False
        while not done:
            observation, reward, terminated, truncated, info = env.step(self._policy(observation))
            total, steps, done = total + reward, steps + 1, terminated or truncated
            if job["videos"] and steps % 2 == 0:
                frames.append(env.render())
        self._film(trial, info["success"], frames)
        source = info["trajectory"]
        return {
            "trial": trial,
            "task": info["task"],
            "split": "seen" if seen else "unseen",
            "trajectory": "" if source is None else f"{Path(source[0]).name}:{source[1]}",
            "goal": info["goal"],
            "success": int(info["success"]),
            "success_strict": int(info["success_strict"]),
            "opened_fraction_max": round(info["opened_fraction_max"], 4),
            "opened_fraction_end": round(info["opened_fraction"], 4),
            "handle_distance_end_m": round(info["handle_distance_m"], 4),
            "steps": steps,
            "return": round(total, 4),
        }

    def _film(self, trial: int, success: bool, frames: list[Any]) -> None:
        if not frames or self._videos[success] >= self._job["videos"]:
            return
        self._videos[success] += 1
        name = f"{'success' if success else 'failure'}_{trial:03d}.mp4"
        write_video(self._output / name, frames, 15)


def policy_eyes(policy: str, rig: str | None, cloud_points: int) -> dict[str, Any]:
    """Cameras and cloud of the environment: those that were asked for, else those that a trained
    policy's data had."""
    if rig is None and _is_folder(policy):
        from akrobat.policy.folder import describe

        description = describe(Path(policy))
        cloud = {name: value for name, value in description["cloud"].items() if name != "points"}
        points = description["cloud"].get("points", 0)
        if points:
            rig = json.dumps(description["rig"])
            return {"rig": rig, "cloud_points": points, "cloud": cloud}
    return {"rig": rig, "cloud_points": cloud_points}


def _is_folder(policy: str) -> bool:
    return (Path(policy) / "policy.json").is_file()


def make_policy(name: str, env: Any) -> Policy:
    """A policy by its name on the command line."""
    if _is_folder(name):
        try:
            from akrobat.policy.rollout import LearnedPolicy
        except ImportError as error:
            raise RunError(
                f"{name}: learned policies need {error.name}: pip install 'akrobat[policy]'"
            ) from error
        return LearnedPolicy(Path(name), env)
    if name == "replay":
        return ReplayPolicy(env)
    if name == "random":
        return lambda _: env.action_space.sample()
    if name == "hold":
        return lambda _: np.array(env.targets)
    policy: Policy = _of_module(name, env)
    if not callable(policy):
        raise InputError(f"policy {name}: what it made is no function: {policy!r}")
    return policy


def _of_module(name: str, env: Any) -> Any:
    """`lerobot:FOLDER`, `dp3:module:attribute` or `module:attribute`."""
    kind, separator, rest = name.partition(":")
    if kind == "lerobot" and separator:
        from akrobat.policy.lerobot import LeRobotPolicy

        return LeRobotPolicy(Path(rest), env)
    if kind == "dp3" and separator:
        from akrobat.policy.dp3 import Dp3Policy

        return Dp3Policy(_made(rest, env), env)
    return _made(name, env)


def _made(name: str, env: Any) -> Any:
    """What `module:attribute` makes, called with the environment."""
    module_name, separator, attribute = name.partition(":")
    if not separator or not attribute:
        raise InputError(
            f'policy: unknown "{name}"; valid choices: replay, random, hold, module:attribute, '
            "lerobot:FOLDER, dp3:module:attribute, or the folder of a trained policy"
        )
    sys.path.insert(0, os.getcwd())
    try:
        maker = getattr(importlib.import_module(module_name), attribute)
    except (ImportError, AttributeError) as error:
        raise InputError(f"policy {name}: {error}") from error
    finally:
        sys.path.remove(os.getcwd())
    return maker(env)


def summarize(rows: list[dict[str, Any]]) -> dict[str, Any]:
    """Success over all trials and by task and split."""
    groups: dict[str, dict[str, Any]] = {}
    for row in rows:
        group = groups.setdefault(f"{row['task']} ({row['split']})", {"trials": 0, "succeeded": 0})
        group["trials"] += 1
        group["succeeded"] += row["success"]
    succeeded = sum(row["success"] for row in rows)
    return {
        "trials": len(rows),
        "succeeded": succeeded,
        "success_rate": succeeded / len(rows) if rows else 0.0,
        "success_rate_strict": float(np.mean([row["success_strict"] for row in rows] or [0.0])),
        "opened_fraction_mean": float(np.mean([row["opened_fraction_max"] for row in rows] or [0])),
        "groups": groups,
    }


def plot(summary: dict[str, Any]) -> str:
    """Bars of success by task and split, as SVG."""
    from html import escape

    lines, groups = [], summary["groups"]
    height = 40 + 26 * len(groups)
    for number, (name, group) in enumerate(groups.items()):
        rate = group["succeeded"] / group["trials"]
        y = 34 + 26 * number
        lines += [
            f'<text x="8" y="{y + 13}">{escape(name)}</text>',
            f'<rect x="300" y="{y}" width="300" height="18" fill="#e6e8ec"/>',
            f'<rect x="300" y="{y}" width="{300 * rate:.1f}" height="18" fill="#4269d0"/>',
            f'<text x="608" y="{y + 13}">{group["succeeded"]} of {group["trials"]}</text>',
        ]
    title = f"{summary['policy']}: {summary['succeeded']} of {summary['trials']} trials succeed"
    return (
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 700 {height}" '
        f'font-family="system-ui, sans-serif" font-size="12">\n'
        f'<rect width="700" height="{height}" fill="white"/>\n'
        f'<text x="8" y="20" font-weight="600">{escape(title)}</text>\n'
        + "\n".join(lines)
        + "\n</svg>\n"
    )


def write_video(path: Path, frames: list[NDArray[np.uint8]], rate_hz: int) -> None:
    """An H.264 video; needs `pip install 'akrobat[video]'`."""
    try:
        import av
    except ImportError as error:
        raise RunError("videos need PyAV: pip install 'akrobat[video]'") from error
    temporary = path.with_name(path.name + ".partial")
    with av.open(str(temporary), "w", format="mp4") as container:
        stream = container.add_stream("libx264", rate=rate_hz)
        stream.height, stream.width = frames[0].shape[:2]
        stream.pix_fmt = "yuv420p"
        for frame in frames:
            container.mux(stream.encode(av.VideoFrame.from_ndarray(frame, format="rgb24")))
        container.mux(stream.encode())
    os.replace(temporary, path)


def _prepare(folder: Path) -> None:
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InputError(f"{folder}: cannot write: {error.strerror}") from error
    if any(folder.iterdir()):
        raise InputError(f"{folder}: the folder is not empty; choose another with -o, or remove it")


def _write_whole(path: Path, text: str) -> None:
    file: IO[str]
    with tempfile.NamedTemporaryFile(
        "w", dir=path.parent, suffix=".partial", delete=False, encoding="utf-8"
    ) as file:
        file.write(text)
        file.flush()
        os.fsync(file.fileno())
    os.chmod(file.name, 0o644)
    os.replace(file.name, path)
