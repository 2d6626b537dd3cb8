"""SAPIEN draws the same geometry as the backend on the CPU."""

from __future__ import annotations

from pathlib import Path

import akrobat
import numpy as np
import pytest
from numpy.typing import NDArray

FRAMES = slice(None, None, 40)


def agreement(depth_a: NDArray[np.uint16], depth_b: NDArray[np.uint16]) -> float:
    """Fraction of the pixels away from depth edges whose depths agree within 2 mm."""
    a, b = depth_a.astype(np.int32), depth_b.astype(np.int32)
    smooth = np.ones(a.shape, bool)
    for axis in (1, 2):
        step = np.abs(np.diff(a, axis=axis)) > 20
        for shift in (0, 1):
            pad = [(0, 0)] * a.ndim
            pad[axis] = (shift, 1 - shift)
            smooth &= ~np.pad(step, pad)
    assert smooth.mean() > 0.7
    return float((np.abs(a - b)[smooth] <= 2).mean())


@pytest.fixture(scope="module")
def sapien_episode(
    shared_assets: Path, drawer_file: Path, tmp_path_factory: pytest.TempPathFactory
) -> akrobat.Episode:
    folder = tmp_path_factory.mktemp("sapien") / "dataset"
    dataset = akrobat.render(
        drawer_file,
        folder,
        backend="sapien",
        episodes=[0],
        manipulation_only=True,
        assets=[shared_assets],
        quiet=True,
    )
    return dataset.episodes[0]


@pytest.mark.parametrize("camera", ["ego_topdown", "ego_wrist", "fixed"])
def test_depth_and_segments_agree(
    sapien_episode: akrobat.Episode, drawer_dataset: akrobat.Dataset, camera: str
) -> None:
    soft = drawer_dataset.episodes[0]

    def images(episode: akrobat.Episode, kind: str) -> NDArray[np.uint16]:
        return episode[f"camera_obs/{camera}_{kind}"][FRAMES].reshape(-1, 240, 320)

    ours, theirs = images(soft, "depth"), images(sapien_episode, "depth")
    assert agreement(ours, theirs) > 0.99
    # The comparison itself must be able to fail: one centimetre is seen.
    assert agreement(ours, theirs + np.uint16(10)) < 0.5
    our_ids, their_ids = images(soft, "segmentation"), images(sapien_episode, "segmentation")
    for segment in np.unique(our_ids):
        mine, other = our_ids == segment, their_ids == segment
        if segment and mine.sum() >= 500 * len(our_ids):
            assert (mine & other).sum() / (mine | other).sum() > 0.97
