"""The same task and seed give the same bytes, whatever the number of threads."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

REPOSITORY = Path(__file__).parents[2]
TASK = REPOSITORY / "configs" / "tasks" / "summit_drawer_empty.toml"
RIG = REPOSITORY / "tests" / "rigs" / "small.toml"


def akrobat(*arguments: object) -> None:
    command = [sys.executable, "-m", "akrobat", *map(str, arguments)]
    subprocess.run(command, check=True, capture_output=True)


def contents(folder: Path) -> dict[str, bytes]:
    files = (path for path in folder.rglob("*") if path.is_file())
    return {str(path.relative_to(folder)): path.read_bytes() for path in files}


def test_plans_are_the_same_on_any_number_of_threads(shared_assets: Path, tmp_path: Path) -> None:
    def plan(name: str, threads: int, seed: int) -> bytes:
        file = tmp_path / name
        options = ["--limit", 1, "--threads", threads, "--seed", seed, "--assets", shared_assets]
        akrobat("plan", TASK, "-o", file, *options)
        return file.read_bytes()

    one = plan("one.h5", threads=1, seed=1)
    assert one == plan("two.h5", threads=2, seed=1)
    assert one != plan("other.h5", threads=2, seed=2)


@pytest.mark.parametrize("container", ["hdf5", "mcap"])
def test_datasets_are_the_same_on_any_number_of_threads(
    drawer_file: Path, shared_assets: Path, tmp_path: Path, container: str
) -> None:

    def render(name: str, threads: int, episodes: str) -> dict[str, bytes]:
        folder = tmp_path / name
        options = ["--backend", "soft", "--phases", "manipulate", "--format", container]
        options += ["--threads", threads, "--episodes", episodes, "--rig", RIG]
        akrobat("render", drawer_file, "-o", folder, "--assets", shared_assets, *options)
        return contents(folder)

    one = render("one", threads=1, episodes="0")
    assert any(name.endswith(container) for name in one)
    assert one == render("two", threads=2, episodes="0")
    other = render("other", threads=2, episodes="1")
    assert one.keys() == other.keys()
    assert all(one[name] != other[name] for name in one if name.startswith("shards/"))
