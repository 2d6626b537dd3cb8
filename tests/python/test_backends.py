"""All backends draw the same frames: SAPIEN and wgpu against the rasteriser on the CPU."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import akrobat
import numpy as np
import pytest
from image_agreement import (
    DEPTH_TOLERANCE_MM,
    LEAST_AGREEMENT,
    LEAST_BODY_PIXELS,
    LEAST_INNER,
    LEAST_IOU,
    inner_pixels,
)
from numpy.typing import NDArray

FRAMES = slice(None, None, 40)
CAMERAS = ["ego_topdown", "ego_wrist", "fixed"]

Images = tuple[NDArray[np.int32], NDArray[np.uint16]]


def images(episode: akrobat.Episode, camera: str) -> Images:
    """Depth in millimetres and segment ids `[frames, height, width]`."""
    depth = episode[f"camera_obs/{camera}_depth"][FRAMES, ..., 0]
    segments = episode[f"camera_obs/{camera}_segmentation"][FRAMES, ..., 0]
    return depth.astype(np.int32), segments


def violation(reference: Images, other: Images) -> str | None:
    """What differs by more than the tolerances; `None` where nothing does."""
    (depth, segments), (other_depth, other_segments) = reference, other
    inner = inner_pixels(depth, segments)
    if inner.mean() < LEAST_INNER:
        return f"only {inner.mean():.1%} of the pixels are compared"
    agreement = (np.abs(depth - other_depth)[inner] <= DEPTH_TOLERANCE_MM).mean()
    if agreement < LEAST_AGREEMENT:
        return f"depth agrees on {agreement:.1%}"
    for frame, other_frame in zip(segments, other_segments, strict=True):
        for segment in np.unique(frame[frame > 0]):
            mine, theirs = frame == segment, other_frame == segment
            overlap = (mine & theirs).sum() / (mine | theirs).sum()
            if mine.sum() >= LEAST_BODY_PIXELS and overlap <= LEAST_IOU:
                return f"segment {segment} overlaps by {overlap:.3f}"
    return None


@pytest.fixture(scope="module")
def render(
    shared_assets: Path, drawer_file: Path, tmp_path_factory: pytest.TempPathFactory
) -> Callable[..., akrobat.Episode]:
    """Renders the same episode as `drawer_dataset` with other options."""

    def run(**options: str) -> akrobat.Episode:
        dataset = akrobat.render(
            drawer_file,
            tmp_path_factory.mktemp("render") / "dataset",
            episodes=[0],
            manipulation_only=True,
            assets=[shared_assets],
            quiet=True,
            **options,  # type: ignore[arg-type]
        )
        return dataset.episodes[0]

    return run


@pytest.mark.parametrize("backend", ["sapien", "wgpu"])
def test_every_backend_draws_the_same(
    render: Callable[..., akrobat.Episode], drawer_dataset: akrobat.Dataset, backend: str
) -> None:
    theirs = render(backend=backend)
    for camera in CAMERAS:
        difference = violation(images(drawer_dataset.episodes[0], camera), images(theirs, camera))
        assert difference is None, f"{camera}: {difference}"


def test_a_camera_that_moved_by_a_centimetre_is_seen(
    render: Callable[..., akrobat.Episode], drawer_dataset: akrobat.Dataset, tmp_path: Path
) -> None:
    ours = drawer_dataset.episodes[0]
    for shift_m, same in [(0.0, True), (0.01, False)]:
        rig = tmp_path / f"rig_{same}.toml"
        rig.write_text(world_rig(ours["camera_obs/fixed_world_from_camera"][0], shift_m))
        difference = violation(images(ours, "fixed"), images(render(rig=str(rig)), "fixed"))
        assert (difference is None) is same, difference


def world_rig(world_from_camera: NDArray[np.float64], shift_m: float) -> str:
    """A rig with the fixed camera at this pose, moved along its own view."""
    matrix = np.array(world_from_camera)
    matrix[:3, 3] += matrix[:3, 2] * shift_m
    w = np.sqrt(max(0.0, 1 + np.trace(matrix[:3, :3]))) / 2
    x = (matrix[2, 1] - matrix[1, 2]) / (4 * w)
    y = (matrix[0, 2] - matrix[2, 0]) / (4 * w)
    z = (matrix[1, 0] - matrix[0, 1]) / (4 * w)
    pose = [float(v) for v in (*matrix[:3, 3], w, x, y, z)]
    return f"""name = "moved"
[[cameras]]
name = "fixed"
focal_mm = 50.0
[cameras.mount]
on = "world"
world_from_camera = {pose}
"""
