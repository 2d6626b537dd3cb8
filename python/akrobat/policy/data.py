"""Datasets as arrays to train on."""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from akrobat.dataset import Dataset, Episode
from akrobat.errors import InputError

Array = NDArray[np.float32]

GRIPPER_OPEN = 1.0
"""the last number of a state: the gripper's opening as a fraction of its stroke"""


@dataclass(frozen=True)
class Demonstration:
    """An episode as a policy sees it, one row for each frame."""

    state: Array
    """base and arm positions (rad, m), and the gripper's opening as a fraction `[T, S]`"""
    target: Array
    """targets that lead to the next frame, in the same columns `[T, S]`"""
    cloud: Array
    """points, metres `[T, N, 3]`; `N` is 0 where the dataset has none"""


@dataclass(frozen=True)
class Source:
    """What a policy must know of the data it was trained on."""

    joints: list[str]
    rate_hz: float
    rig: dict[str, Any] | None
    cloud: dict[str, Any]


def demonstrations(
    folders: Sequence[str | os.PathLike[str]], count: int
) -> tuple[list[Demonstration], Source]:
    """The first `count` episodes of these datasets, in their order.

    :raise InputError: where there are fewer, or the datasets differ in joints or rate
    """
    datasets = [Dataset(folder) for folder in folders]
    episodes = [episode for dataset in datasets for episode in dataset.episodes]
    if not 1 <= count <= len(episodes):
        raise InputError(f"--trajectories: expected 1 to {len(episodes)}, got {count}")
    sources = [_source(dataset) for dataset in datasets if dataset.episodes]
    if any(source != sources[0] for source in sources):
        raise InputError("the datasets differ in robot, rate, cameras or clouds")
    widths = [float(_fingers(episode).max()) for episode in episodes[:count]]
    return [_demonstration(e, max(widths)) for e in episodes[:count]], sources[0]


def _source(dataset: Dataset) -> Source:
    attributes = dataset.episodes[0].attributes
    cloud = dataset.config["provenance"].get("cloud") or {"points": 0}
    if cloud.get("frame", "world") != "world":
        raise InputError(
            f'{dataset.folder}: clouds in the frame "{cloud["frame"]}"; expected world'
        )
    joints = [str(name) for name in attributes["robot_joints"]]
    return Source(
        joints, float(attributes["frame_rate_hz"]), dataset.config.get("rig"), dict(cloud)
    )


def _fingers(episode: Episode) -> Array:
    count = int(episode.attributes["finger_joints"])
    if count == 0:
        raise InputError(f"episode {episode.id}: its robot has no fingers")
    return episode["obs/joint_pos"][:, -count:].astype(np.float32)


def _demonstration(episode: Episode, widest: float) -> Demonstration:
    fingers = int(episode.attributes["finger_joints"])

    def with_fraction(rows: NDArray[Any]) -> Array:
        opening = rows[:, -fingers:].mean(axis=1, keepdims=True) / widest
        return np.concatenate([rows[:, :-fingers], opening], axis=1).astype(np.float32)

    state = with_fraction(episode["obs/joint_pos"])
    cloud = (
        episode["point_cloud"][..., :3].astype(np.float32)
        if "point_cloud" in set(episode)
        else np.zeros((len(state), 0, 3), np.float32)
    )
    return Demonstration(state, with_fraction(episode["actions"]), cloud)
