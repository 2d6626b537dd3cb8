"""The page on loading: its blocks run. The one with PyTorch runs in `tests/readers`."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import akrobat
import numpy as np
import pytest

PAGE = Path(__file__).parents[2] / "docs" / "loading.md"


def blocks() -> dict[str, str]:
    """Code by the heading above it."""
    parts = re.split(r"^## (.+)$", PAGE.read_text(), flags=re.MULTILINE)[1:]
    found = {}
    for heading, text in zip(parts[::2], parts[1::2], strict=True):
        (found[heading],) = re.findall(r"```python\n(.*?)```", text, flags=re.DOTALL)
    return found


@pytest.fixture
def beside(
    drawer_dataset: akrobat.Dataset, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> akrobat.Episode:
    """The episode that the page finds in `dataset`."""
    (tmp_path / "dataset").symlink_to(drawer_dataset.folder)
    monkeypatch.chdir(tmp_path)
    return drawer_dataset.episodes[0]


def test_the_page_loads_with_h5py(beside: akrobat.Episode) -> None:
    names: dict[str, Any] = {}
    exec(blocks()["With h5py"], names)
    assert np.array_equal(names["actions"], beside["actions"])
    assert names["joints"] == [str(name) for name in beside.attributes["robot_joints"]]
    camera = names["camera"]
    assert np.array_equal(names["color"], beside[f"camera_obs/{camera}_rgb"][0])
    millimetres = beside[f"camera_obs/{camera}_depth"][0, :, :, 0]
    assert np.allclose(names["depth_m"] * 1000, millimetres, atol=1e-3)
    assert 0.1 < np.median(names["depth_m"]) < 10
    assert np.array_equal(names["cloud"], beside["point_cloud"][0])
    assert names["world_from_camera"].shape == (4, 4)


def test_the_page_loads_with_akrobat(beside: akrobat.Episode) -> None:
    names: dict[str, Any] = {}
    exec(blocks()["With akrobat"], names)
    assert set(names["sample"]) == {"camera_obs/fixed_rgb", "obs/joint_pos", "actions"}
    assert np.array_equal(names["sample"]["actions"], beside["actions"][0])
    assert np.array_equal(names["cloud"], beside["point_cloud"])
    assert names["unit"] == "mm"
