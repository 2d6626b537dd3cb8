"""The network, and how a chunk of targets is drawn with it."""

from __future__ import annotations

import itertools
import math

import torch
from torch import Tensor, nn

NOISE_LEVELS = 64


def signal_share(level: Tensor) -> Tensor:
    """How much of the signal is left at a noise level from 0 to `NOISE_LEVELS`: the cosine
    schedule of Nichol and Dhariwal 2021 (their equation 17)."""
    offset = 0.008
    angle = (level / NOISE_LEVELS + offset) / (1.0 + offset) * math.pi / 2.0
    return torch.cos(angle).pow(2).clamp(1e-4, 1.0)


class Denoiser(nn.Module):
    """Tells the clean chunk from a noisy one, its noise level and what the policy sees."""

    def __init__(self, chunk: int, seen: int, width: int = 256, blocks: int = 3) -> None:
        super().__init__()
        self.register_buffer("frequencies", torch.exp(torch.linspace(0.0, math.log(100.0), 16)))
        self.first = nn.Linear(chunk + seen + 32, width)
        self.blocks = nn.ModuleList(_Block(width, seen + 32) for _ in range(blocks))
        self.last = nn.Linear(width, chunk)

    def forward(self, noisy: Tensor, level: Tensor, seen: Tensor) -> Tensor:
        """`noisy [B, C]`, `level [B]`, `seen [B, S]` -> the clean chunk `[B, C]`."""
        phase = (level / NOISE_LEVELS)[:, None] * self.frequencies
        context = torch.cat([seen, phase.sin(), phase.cos()], dim=1)
        hidden = self.first(torch.cat([noisy, context], dim=1))
        for block in self.blocks:
            hidden = block(hidden, context)
        result: Tensor = self.last(hidden)
        return result


class _Block(nn.Module):
    def __init__(self, width: int, context: int) -> None:
        super().__init__()
        self.norm = nn.LayerNorm(width)
        self.up = nn.Linear(width + context, 2 * width)
        self.down = nn.Linear(2 * width, width)

    def forward(self, hidden: Tensor, context: Tensor) -> Tensor:
        inner = self.up(torch.cat([self.norm(hidden), context], dim=1))
        result: Tensor = hidden + self.down(nn.functional.silu(inner))
        return result


@torch.no_grad()
def draw(network: Denoiser, seen: Tensor, noise: Tensor, steps: int = 12) -> Tensor:
    """A chunk for each row of `seen`, from as many rows of noise, by DDIM without added noise (Song
    et al. 2021): the noise alone decides which of several ways is taken."""
    levels = torch.linspace(NOISE_LEVELS, 0, steps + 1)
    sample = noise
    for level, following in itertools.pairwise(levels):
        share, next_share = signal_share(level), signal_share(following)
        clean = network(sample, level.repeat(len(seen)), seen).clamp(-4.0, 4.0)
        rest = (sample - share.sqrt() * clean) / (1.0 - share).sqrt().clamp(min=1e-4)
        sample = next_share.sqrt() * clean + (1.0 - next_share).sqrt() * rest
    return clean
