"""A cloud of points in a few numbers."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float32]

CELLS = 8
"""cells along each edge of the box that holds the training clouds"""


@dataclass(frozen=True)
class CloudFeatures:
    """Principal components of how many points lie in each cell of a grid.

    Counts are spread over the eight nearest cells (trilinear), so that features are continuous in
    the points' positions. Computed once for each training frame: nothing of it is learned by
    gradient.
    """

    low: Array
    """the box's lower corner, metres `[3]`"""
    high: Array
    """`[3]`"""
    mean: Array
    """`[CELLS^3]`"""
    components: Array
    """`[F, CELLS^3]`"""

    @staticmethod
    def fit(clouds: Array, count: int) -> CloudFeatures:
        """The features that tell most of these clouds apart `[M, N, 3]`; none without points."""
        empty = np.zeros(3, np.float32)
        if clouds.shape[1] == 0 or count == 0:
            return CloudFeatures(empty, empty, np.zeros(CELLS**3, np.float32), _none())
        low, high = clouds.min(axis=(0, 1)), clouds.max(axis=(0, 1))
        box = CloudFeatures(low, high, np.zeros(CELLS**3, np.float32), _none())
        occupancy = np.stack([box.occupancy(cloud) for cloud in clouds])
        mean = occupancy.mean(axis=0)
        _, scale, axes = np.linalg.svd(occupancy - mean, full_matrices=False)
        # Unit variance, so that the network's other inputs are not drowned.
        spread = np.maximum(scale[:count] / np.sqrt(len(clouds)), 1e-6)
        components = (axes[:count] / spread[:, None]).astype(np.float32)
        return CloudFeatures(low, high, mean.astype(np.float32), components)

    def __call__(self, cloud: Array) -> Array:
        """Features of one cloud `[N, 3]`."""
        if len(self.components) == 0:
            return np.zeros(0, np.float32)
        return np.clip(self.components @ (self.occupancy(cloud) - self.mean), -5.0, 5.0)

    def occupancy(self, cloud: Array) -> Array:
        """Share of the points near each cell `[CELLS^3]`."""
        size = np.maximum(self.high - self.low, 1e-3)
        place = np.clip((cloud - self.low) / size, 0.0, 1.0) * (CELLS - 1)
        first = np.minimum(place.astype(int), CELLS - 2)
        rest = place - first
        grid = np.zeros((CELLS, CELLS, CELLS))
        for corner in np.ndindex(2, 2, 2):
            weight = np.prod(np.where(corner, rest, 1.0 - rest), axis=1)
            x, y, z = (first + corner).T
            np.add.at(grid, (x, y, z), weight)
        return (grid.ravel() / max(len(cloud), 1)).astype(np.float32)


def _none() -> Array:
    return np.zeros((0, CELLS**3), np.float32)
