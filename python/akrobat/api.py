"""The jobs of the command line as functions."""

from __future__ import annotations

import json
import os
import tempfile
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Literal

from akrobat import _core
from akrobat.dataset import Dataset
from akrobat.errors import InputError

StrPath = str | os.PathLike[str]


def plan(
    task: StrPath,
    output: StrPath | None = None,
    *,
    limit: int | None = None,
    seed: int | None = None,
    threads: int | None = None,
    backend: Literal["auto", "cpu", "wgpu"] = "auto",
    assets: Sequence[StrPath] = (),
    quiet: bool = False,
) -> _core.Trajectories:
    """Plans trajectories for a task and returns those that the independent judge accepts.

    :param task: task file (TOML; its schema: `akrobat schema task`)
    :param output: trajectory file to write; only kept in memory where absent
    :param limit: stop once this many are accepted; the task's own limit where absent
    :param seed: seed of everything random; the task's own where absent
    :param threads: number of threads; the result does not depend on it
    :param backend: where inverse kinematics and optimisation run: `wgpu` is the graphics processor
        or a software Vulkan driver, `auto` a graphics processor where there is one, else the CPU
    :param assets: folders where assets are looked up, before those of `$AKROBAT_ASSET_PATH`
    :param quiet: no progress bars, no warnings
    """
    return _core.plan(
        Path(task),
        None if output is None else Path(output),
        limit=limit,
        seed=seed,
        threads=threads,
        backend=backend,
        assets=[Path(folder) for folder in assets],
        quiet=quiet,
    )


def render(
    trajectories: StrPath | _core.Trajectories,
    output: StrPath,
    *,
    backend: Literal["auto", "soft", "wgpu", "sapien", "sapien-default", "sapien-rt"] = "auto",
    rig: StrPath = "paper",
    lighting: StrPath = "even",
    variation: StrPath | None = None,
    variation_seed: int = 0,
    appearance: StrPath | None = None,
    supersampling: Literal[1, 3, 5] = 1,
    detail: Literal["full", "auto"] = "full",
    sensor: StrPath = "ideal",
    modalities: Sequence[str] = ("rgb", "depth", "segmentation"),
    cloud: Mapping[str, Any] | None = None,
    seed: int = 0,
    format: Literal["hdf5", "mcap"] = "hdf5",
    episodes: Sequence[int] | None = None,
    manipulation_only: bool = False,
    states: Literal["planned", "simulated"] = "planned",
    episodes_per_shard: int | None = None,
    storage: Mapping[str, Any] | None = None,
    resume: bool = False,
    threads: int | None = None,
    assets: Sequence[StrPath] = (),
    quiet: bool = False,
) -> Dataset:
    """Replays trajectories, renders what cameras see, writes a dataset and opens it.

    :param trajectories: trajectory file, or what :func:`plan` returned
    :param output: dataset folder: empty or new, unless `resume` is set
    :param backend: which renderer draws
    :param rig: cameras: the name of a preset or a rig file (`akrobat schema rig`)
    :param lighting: light: the name of a preset or a lighting file (`akrobat schema lighting`)
    :param variation: what is drawn at random for each episode: the name of a preset (`mild`,
        `wild`) or a file (`akrobat schema variation`)
    :param variation_seed: seed of what is drawn
    :param appearance: JSON file of what an earlier run drew (`renderer.appearance` of an episode's
        provenance)
    :param supersampling: colour is the mean of this many samples along either edge of a pixel
    :param detail: whether all triangles are drawn, or as many as hold every surface within a
        millimetre
    :param sensor: what becomes of ideal images: the name of a preset or a sensor file (`akrobat
        schema sensor`)
    :param modalities: images in HDF5 shards
    :param cloud: settings of the fused clouds that differ from the defaults, such as
        `{"points": 1024, "frame": "base"}` (`cloud` in `akrobat schema job`)
    :param seed: seed of sensors and mounting errors
    :param format: which files hold the episodes
    :param episodes: positions in the trajectory file; all where absent
    :param manipulation_only: leave out approach and grasp
    :param states: the plan, or what the robot did in physics (from the audit of `akrobat replay`)
    :param episodes_per_shard: episodes in one HDF5 shard; an interruption loses at most that many
    :param storage: how the dataset is stored, as the options of `akrobat render` are named:
        `{"codec": "zstd", "color": "png", "depth": "metres"}`, ...
    :param resume: continue what an interrupted run with the same arguments left
    :param threads: number of threads; the result does not depend on it
    :param assets: folders where assets are looked up, before those of `$AKROBAT_ASSET_PATH`
    :param quiet: no progress bars, no warnings
    """
    if isinstance(trajectories, _core.Trajectories):
        with tempfile.TemporaryDirectory() as folder:
            file = Path(folder) / "trajectories.h5"
            trajectories.write(file)
            return render(
                file,
                output,
                backend=backend,
                rig=rig,
                lighting=lighting,
                variation=variation,
                variation_seed=variation_seed,
                appearance=appearance,
                supersampling=supersampling,
                detail=detail,
                sensor=sensor,
                modalities=modalities,
                cloud=cloud,
                seed=seed,
                format=format,
                episodes=episodes,
                manipulation_only=manipulation_only,
                states=states,
                episodes_per_shard=episodes_per_shard,
                storage=storage,
                resume=resume,
                threads=threads,
                assets=assets,
                quiet=quiet,
            )
    settings = dict(storage or {})
    if episodes_per_shard is not None:
        settings["episodes_per_shard"] = episodes_per_shard
    _core.render(
        Path(trajectories),
        Path(output),
        backend=backend,
        rig=str(rig),
        lighting=str(lighting),
        variation=None if variation is None else str(variation),
        variation_seed=variation_seed,
        appearance=None if appearance is None else Path(appearance),
        supersampling=supersampling,
        detail=detail,
        sensor=str(sensor),
        modalities=list(modalities),
        cloud=json.dumps(dict(cloud or {})),
        seed=seed,
        format=format,
        episodes=None if episodes is None else list(episodes),
        manipulation_only=manipulation_only,
        states=states,
        storage=json.dumps(settings),
        resume=resume,
        threads=threads,
        assets=[Path(folder) for folder in assets],
        quiet=quiet,
    )
    return Dataset(output)


def open(path: StrPath) -> _core.Trajectories | Dataset:
    """Opens a trajectory file or a dataset folder."""
    path = Path(path)
    if path.is_dir():
        return Dataset(path)
    if not path.exists():
        raise InputError(f"{path}: there is no such file or folder")
    return _core.Trajectories.read(path)
