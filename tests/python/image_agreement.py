"""Where and how closely images of two backends must agree."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

# Tolerances, as `renderer/src/compare.rs` defines them.
DEPTH_TOLERANCE_MM = 2
LEAST_AGREEMENT = 0.99
LEAST_INNER = 0.85
LEAST_IOU = 0.97
LEAST_BODY_PIXELS = 500
FLATNESS_M = 0.01


def inner_pixels(depth_mm: NDArray[np.int32], segments: NDArray[np.uint16]) -> NDArray[np.bool_]:
    """Pixels away from silhouettes: one body around them, on a surface that is flat there."""
    inner = depth_mm > 0
    depth = np.maximum(depth_mm, 1) / 1000.0
    for axis in (1, 2):
        before, after = np.roll(segments, 1, axis), np.roll(segments, -1, axis)
        inner &= (before == segments) & (after == segments)
        bend = np.roll(1 / depth, 1, axis) - 2 / depth + np.roll(1 / depth, -1, axis)
        inner &= np.abs(bend) * depth**2 < FLATNESS_M
    inner[:, [0, -1], :] = False
    inner[:, :, [0, -1]] = False
    return inner
