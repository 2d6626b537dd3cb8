"""Statistics as LeRobot keeps them: per episode, and over the whole dataset."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

QUANTILES = {"q01": 0.01, "q10": 0.1, "q50": 0.5, "q90": 0.9, "q99": 0.99}

# By feature, then by name: `min`, `max`, `mean`, `std`, `count`, `q01`, ...
EpisodeStatistics = dict[str, dict[str, Any]]


def of_rows(values: NDArray[Any]) -> dict[str, Any]:
    """Statistics of each column of `[T, columns]` (or of `[T]`)."""
    rows = np.asarray(values, np.float64).reshape(len(values), -1)
    found = {
        "min": rows.min(axis=0),
        "max": rows.max(axis=0),
        "mean": rows.mean(axis=0),
        "std": rows.std(axis=0),
    }
    for name, share in QUANTILES.items():
        found[name] = np.quantile(rows, share, axis=0)
    return {**{name: value.tolist() for name, value in found.items()}, "count": [len(rows)]}


def of_images(images: NDArray[Any], scale: float) -> dict[str, Any]:
    """Statistics of each channel of `[N, H, W, channels]`, values divided by `scale`, as
    `[channels, 1, 1]`. Every fourth row and column stands for all.
    """
    pixels = images[:, ::4, ::4].reshape(-1, images.shape[3])
    found = of_rows(pixels / scale)
    shaped = {k: [[[v]] for v in values] for k, values in found.items() if k != "count"}
    return {**shaped, "count": [len(images)]}


def aggregate(episodes: list[EpisodeStatistics]) -> EpisodeStatistics:
    """Statistics over all episodes; quantiles are means weighted by the episodes' lengths, as
    LeRobot combines them.
    """
    combined: EpisodeStatistics = {}
    for key in episodes[0] if episodes else ():
        parts = [episode[key] for episode in episodes]
        counts = np.array([part["count"][0] for part in parts], np.float64)

        def stack(name: str, parts: list[dict[str, Any]] = parts) -> NDArray[np.float64]:
            return np.array([part[name] for part in parts], np.float64)

        weights = counts / counts.sum()

        def weighted(values: NDArray[np.float64], weights: Any = weights) -> NDArray[np.float64]:
            return np.tensordot(weights, values, axes=1)

        mean = weighted(stack("mean"))
        variance = weighted(stack("std") ** 2 + (stack("mean") - mean) ** 2)
        found = {
            "min": stack("min").min(axis=0),
            "max": stack("max").max(axis=0),
            "mean": mean,
            "std": np.sqrt(variance),
            **{name: weighted(stack(name)) for name in QUANTILES},
        }
        combined[key] = {name: value.tolist() for name, value in found.items()}
        combined[key]["count"] = [int(counts.sum())]
    return combined
