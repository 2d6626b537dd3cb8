"""Light and randomised appearance, from the files that episodes end in."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import akrobat
import h5py
import numpy as np
import pytest

CAMERA = "camera_obs/fixed_rgb"


@pytest.fixture(scope="module")
def render(
    shared_assets: Path, drawer_file: Path, tmp_path_factory: pytest.TempPathFactory
) -> Callable[..., Path]:
    """Renders the manipulation of one episode; returns its shard."""

    def run(**options: Any) -> Path:
        folder = tmp_path_factory.mktemp("look") / "dataset"
        akrobat.render(
            drawer_file,
            folder,
            backend="soft",
            episodes=[0],
            manipulation_only=True,
            assets=[shared_assets],
            quiet=True,
            **options,
        )
        (shard,) = folder.rglob("*.hdf5")
        return shard

    return run


def colors(shard: Path) -> np.ndarray:
    """Colours of the fixed camera in every tenth frame."""
    with h5py.File(shard) as file:
        return file[f"data/demo_0/{CAMERA}"][::10]


def provenance(shard: Path) -> dict[str, Any]:
    """How the episode came to be."""
    with h5py.File(shard) as file:
        return json.loads(file["data/demo_0"].attrs["provenance"])


def test_what_was_drawn_renders_to_the_same_bytes(
    render: Callable[..., Path], tmp_path: Path
) -> None:
    drawn = render(variation="wild", variation_seed=3)
    appearance = provenance(drawn)["renderer"]["appearance"]
    assert appearance["surfaces"]
    assert appearance["clutter"]
    record = tmp_path / "look.json"
    record.write_text(json.dumps(appearance))
    assert render(appearance=record).read_bytes() == drawn.read_bytes()
    assert render(variation="wild", variation_seed=3).read_bytes() == drawn.read_bytes()
    other = render(variation="wild", variation_seed=4)
    assert (colors(other) != colors(drawn)).any(axis=-1).mean() > 0.5


def test_light_is_recorded_and_changes_nothing_but_colours(
    render: Callable[..., Path], drawer_dataset: akrobat.Dataset
) -> None:
    evening = render(lighting="evening")
    lighting = provenance(evening)["renderer"]["lighting"]
    assert lighting["name"] == "evening"
    assert lighting["lights"][0]["frame"] == "world"
    plain = drawer_dataset.episodes[0]
    assert colors(evening).mean() < 0.75 * plain[CAMERA][::10].mean()
    with h5py.File(evening) as file:
        demo = file["data/demo_0"]
        for name in ("actions", "camera_obs/fixed_depth", "camera_obs/fixed_segmentation"):
            np.testing.assert_array_equal(demo[name][:], plain[name][:])
