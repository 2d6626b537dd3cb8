"""Training: demonstrations -> a policy folder."""

from __future__ import annotations

import json
import os
import tempfile
from collections.abc import Callable
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from akrobat.errors import InputError
from akrobat.policy.data import Demonstration, Source
from akrobat.policy.features import CloudFeatures
from akrobat.policy.network import NOISE_LEVELS, Denoiser, signal_share

Array = NDArray[np.float32]


@dataclass(frozen=True)
class TrainingConfig:
    """How a policy is trained and run."""

    steps: int = 3000
    """gradient steps"""
    batch: int = 256
    """samples of a step"""
    learning_rate: float = 1e-3
    """at the start; falls to zero along a cosine"""
    chunk: int = 16
    """targets in a chunk"""
    stride: int = 2
    """frames between the targets of a chunk"""
    executed: int = 6
    """targets of a chunk that are driven to before the next is drawn"""
    cloud_features: int = 16
    """numbers that stand for a cloud"""
    cloud_interval: int = 5
    """frames between clouds whose features are computed; between them the last one's stand"""
    state_noise: float = 0.01
    """standard deviation of the error that is added to states (rad, m): targets stay, so that the
    policy learns to come back"""
    start_noise: float = 0.15
    """greatest error of that kind at an episode's start; it falls to zero within a second"""
    seed: int = 0
    """of weights, errors and noise"""


@dataclass(frozen=True)
class Samples:
    """All training samples; rows of episodes one after another."""

    state: Tensor
    """`[M, S]`"""
    cloud: Tensor
    """`[M, F]`"""
    targets: Tensor
    """`[M, chunk, S]`"""
    elapsed_s: Tensor
    """time since the episode's start `[M]`"""


@dataclass(frozen=True)
class Scaling:
    """Offsets and scales that bring inputs and outputs near unit size."""

    state_mean: Array
    state_scale: Array
    chunk_mean: Array
    """of targets less the state they start from `[chunk, S]`"""
    chunk_scale: Array
    """`[S]`"""


def samples(
    episodes: list[Demonstration], source: Source, features: CloudFeatures, config: TrainingConfig
) -> Samples:
    """Every frame of every episode as a sample."""
    states, clouds, targets, times = [], [], [], []
    ahead = config.stride * np.arange(1, config.chunk + 1) - 1
    for episode in episodes:
        frames = len(episode.state)
        at = np.minimum(np.arange(frames)[:, None] + ahead, frames - 1)
        kept = np.arange(0, frames, config.cloud_interval)
        rows = np.stack([features(episode.cloud[frame]) for frame in kept])
        states.append(episode.state)
        clouds.append(rows[np.arange(frames) // config.cloud_interval])
        targets.append(episode.target[at])
        times.append(np.arange(frames, dtype=np.float32) / source.rate_hz)
    return Samples(*(torch.from_numpy(np.concatenate(a)) for a in (states, clouds, targets, times)))


def fit_features(episodes: list[Demonstration], config: TrainingConfig) -> CloudFeatures:
    """Cloud features from some 2,000 frames spread over the episodes."""
    stride = max(sum(len(e.state) for e in episodes) // 2000, 1)
    return CloudFeatures.fit(
        np.concatenate([e.cloud[::stride] for e in episodes]), config.cloud_features
    )


def fit_scaling(data: Samples) -> Scaling:
    """Means and standard deviations."""
    away = data.targets - data.state[:, None]
    return Scaling(
        data.state.mean(0).numpy(),
        data.state.std(0).clamp(min=1e-3).numpy(),
        away.mean(0).numpy(),
        (away - away.mean(0)).std((0, 1)).clamp(min=1e-3).numpy(),
    )


def train(
    episodes: list[Demonstration],
    source: Source,
    config: TrainingConfig,
    report: Callable[[int, float], None] = lambda step, loss: None,
) -> tuple[Denoiser, CloudFeatures, Scaling]:
    """Trains on these episodes; `report` is told the step and the mean loss now and then."""
    torch.manual_seed(config.seed)
    generator = torch.Generator().manual_seed(config.seed)
    features = fit_features(episodes, config)
    data = samples(episodes, source, features, config)
    scaling = fit_scaling(data)
    chunk_mean, chunk_scale = map(torch.from_numpy, (scaling.chunk_mean, scaling.chunk_scale))
    state_mean, state_scale = map(torch.from_numpy, (scaling.state_mean, scaling.state_scale))
    size = config.chunk * data.state.shape[1]
    network = Denoiser(size, data.state.shape[1] + data.cloud.shape[1])
    averaged = torch.optim.swa_utils.AveragedModel(
        network, multi_avg_fn=torch.optim.swa_utils.get_ema_multi_avg_fn(0.995)
    )
    optimizer = torch.optim.AdamW(network.parameters(), config.learning_rate, weight_decay=1e-4)
    schedule = torch.optim.lr_scheduler.CosineAnnealingLR(optimizer, config.steps)
    losses = []
    for step in range(1, config.steps + 1):
        rows = torch.randint(len(data.state), (config.batch,), generator=generator)
        state = data.state[rows] + _state_error(data, rows, config, generator)
        chunk = (data.targets[rows] - state[:, None] - chunk_mean) / chunk_scale
        seen = torch.cat([(state - state_mean) / state_scale, data.cloud[rows]], dim=1)
        clean = chunk.flatten(1)
        level = NOISE_LEVELS * torch.rand(len(rows), generator=generator)
        share = signal_share(level)[:, None]
        noise = torch.randn(clean.shape, generator=generator)
        noisy = share.sqrt() * clean + (1.0 - share).sqrt() * noise
        loss = torch.nn.functional.mse_loss(network(noisy, level, seen), clean)
        optimizer.zero_grad()
        loss.backward()  # type: ignore[no-untyped-call]
        optimizer.step()
        schedule.step()
        averaged.update_parameters(network)
        losses.append(loss.item())
        if step % 100 == 0 or step == config.steps:
            report(step, float(np.mean(losses[-100:])))
    trained: Denoiser = averaged.module
    return trained.eval(), features, scaling


def _state_error(
    data: Samples, rows: Tensor, config: TrainingConfig, generator: torch.Generator
) -> Tensor:
    """Errors of the joints' positions, none of the gripper's opening."""
    shape = (len(rows), data.state.shape[1])
    small = config.state_noise * torch.randn(shape, generator=generator)
    early = (1.0 - data.elapsed_s[rows]).clamp(min=0.0)[:, None]
    large = config.start_noise * early * (2.0 * torch.rand(shape, generator=generator) - 1.0)
    error = small + large
    error[:, -1] = 0.0
    return error


def save(
    folder: Path,
    network: Denoiser,
    features: CloudFeatures,
    scaling: Scaling,
    description: dict[str, Any],
) -> None:
    """Writes a policy folder, which appears when it is whole."""
    if folder.exists():
        raise InputError(f"{folder}: exists already; choose another with -o, or remove it")
    folder.parent.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory(dir=folder.parent, prefix=".policy-") as temporary:
        made = Path(temporary) / "policy"
        made.mkdir()
        torch.save(network.state_dict(), made / "network.pt")
        np.savez(made / "features.npz", **asdict(features))
        np.savez(made / "scaling.npz", **asdict(scaling))
        (made / "policy.json").write_text(json.dumps(description, indent=2) + "\n")
        os.replace(made, folder)
