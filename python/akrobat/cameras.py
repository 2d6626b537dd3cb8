"""Projections of the cameras of rigs, and clouds, as functions on arrays."""

from __future__ import annotations

import json
import os
from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from akrobat import _core

StrPath = str | os.PathLike[str]


def project(rig: StrPath, camera: str, points: ArrayLike) -> NDArray[np.float64]:
    """Pixel positions of points.

    :param rig: a rig preset's name or a rig file
    :param camera: name of one of its cameras
    :param points: `[N, 3]`, metres, in the camera's frame (x right, y down, z forward)
    :return: `[N, 2]`, pixels; the centre of the top-left pixel is (0.5, 0.5); NaN for what lies
        behind the camera
    """
    return _core.project(str(rig), camera, np.ascontiguousarray(points, np.float64))


def unproject(rig: StrPath, camera: str, pixels: ArrayLike) -> NDArray[np.float64]:
    """Rays that pixel positions see: the inverse of :func:`project`.

    :param rig: a rig preset's name or a rig file
    :param camera: name of one of its cameras
    :param pixels: `[N, 2]`
    :return: `[N, 2]`, the x and y of points at z = 1; NaN outside the lens' field
    """
    return _core.unproject(str(rig), camera, np.ascontiguousarray(pixels, np.float64))


def farthest_points(points: ArrayLike, count: int) -> NDArray[np.uintp]:
    """Indices of `count` exact farthest-point samples of `points` `[N, 3]`.

    There are fewer where points coincide.
    """
    return _core.farthest_points(np.ascontiguousarray(points, np.float32), count)


def fuse(
    depth_m: ArrayLike,
    intrinsics: ArrayLike,
    world_from_camera: ArrayLike,
    cloud: Mapping[str, Any] | None = None,
) -> NDArray[np.float32]:
    """A cloud of a fixed number of points from the depth images of several cameras.

    :param depth_m: z-depth `[C, H, W]`, metres; 0 is invalid
    :param intrinsics: K `[C, 3, 3]`, pixels
    :param world_from_camera: poses `[C, 4, 4]`
    :param cloud: settings that differ from the defaults, such as `{"points": 1024}` (`cloud` in
        `akrobat schema job`)
    :return: positions `[N, 3]`, metres
    """
    return _core.fuse(
        np.ascontiguousarray(depth_m, np.float32),
        np.ascontiguousarray(intrinsics, np.float64),
        np.ascontiguousarray(world_from_camera, np.float64),
        json.dumps(dict(cloud or {})),
    )
