"""Inputs that several tests share."""

from __future__ import annotations

import os
from pathlib import Path

import akrobat
import pytest

REPOSITORY = Path(__file__).parents[2]


@pytest.fixture(scope="session")
def shared_assets() -> Path:
    """The folder of shared real inputs; tests that need it are skipped where it is absent."""
    beside = REPOSITORY.parent / "shared" / "assets"
    folder = Path(os.environ.get("AKROBAT_SHARED_ASSETS", beside))
    if not folder.is_dir():
        assert "AKROBAT_REQUIRE_SHARED" not in os.environ, f"{folder} is required but absent"
        pytest.skip(f"shared inputs absent at {folder}")
    return folder


@pytest.fixture(scope="session")
def drawer_file(shared_assets: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two planned trajectories of a real robot that opens a real drawer."""
    file = tmp_path_factory.mktemp("plan") / "drawer.h5"
    task = REPOSITORY / "configs" / "tasks" / "summit_drawer_empty.toml"
    akrobat.plan(task, file, limit=2, assets=[shared_assets], quiet=True)
    return file


@pytest.fixture(scope="session")
def drawer_dataset(
    shared_assets: Path, drawer_file: Path, tmp_path_factory: pytest.TempPathFactory
) -> akrobat.Dataset:
    """The manipulation of the first of them, rendered on the CPU."""
    folder = tmp_path_factory.mktemp("render") / "dataset"
    return akrobat.render(
        drawer_file,
        folder,
        backend="soft",
        episodes=[0],
        manipulation_only=True,
        assets=[shared_assets],
        quiet=True,
    )
