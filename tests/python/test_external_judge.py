"""The project's judge and one on Pinocchio and coal agree on what is good and what is spoilt."""

from __future__ import annotations

import json
import shutil
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import h5py
import numpy as np
import pytest

REPOSITORY = Path(__file__).parents[2]
sys.path.insert(0, str(REPOSITORY / "benchmarks" / "planner"))

import external_judge  # noqa: E402

# Every n-th sample is looked at for collisions.
STRIDE = 5
MANIPULATE = 3


def ours(file: Path, assets: Path) -> list[dict]:
    """What the project's judge says now."""
    command = [sys.executable, "-m", "akrobat", "--json", "validate", str(file)]
    done = subprocess.run(
        [*command, "--judge", "--assets", str(assets)], capture_output=True, text=True, check=False
    )
    assert done.returncode in (0, 3), done.stderr
    return [entry["verdict"] for entry in json.loads(done.stdout)["verdicts"]]


def spoilt(drawer_file: Path, change: Callable[[h5py.File, slice], None]) -> Path:
    """A copy of the file beside it, with its second trajectory changed."""
    copy = drawer_file.with_name("spoilt.h5")
    shutil.copy(drawer_file, copy)
    with h5py.File(copy, "r+") as file:
        first, last = map(int, file["dense/offset"][1:3])
        change(file, slice(first, last))
    return copy


def column(file: h5py.File, name: str) -> int:
    names = [n.decode() if isinstance(n, bytes) else n for n in file.attrs["robot_joints"]]
    return names.index(name)


def write(file: h5py.File, rows: slice, robot: np.ndarray) -> None:
    """Writes the second trajectory's dense path, and its waypoints to match."""
    file["dense/robot"][rows] = robot
    start = int(file["waypoints/dense_start"][1])
    substeps = int(file["waypoints/dense_substeps"][1])
    count = file["waypoints/robot"].shape[1]
    file["waypoints/robot"][1] = robot[start : start + count * substeps : substeps]


def drift(file: h5py.File, rows: slice) -> None:
    """The base slides away from the handle, 4 mm in all, slowly."""
    robot = file["dense/robot"][rows]
    held = file["dense/phase"][rows] == MANIPULATE
    robot[held, column(file, "base_y")] += np.linspace(0, 4e-3, held.sum(), dtype=np.float32)
    write(file, rows, robot)


def beyond_limit(file: h5py.File, rows: slice) -> None:
    """A finger opens a millimetre more than it can, on the way to the handle."""
    robot = file["dense/robot"][rows]
    robot[file["dense/phase"][rows] == 0, column(file, "panda_finger_joint1")] = 0.041
    file["dense/robot"][rows] = robot


def into_itself(file: h5py.File, rows: slice) -> None:
    """The arm rests with the hand folded into its own foot, and nothing else is wrong with that."""
    robot = file["dense/robot"][rows]
    approach = np.flatnonzero(file["dense/phase"][rows] == 0)
    folded = [0.0, -1.7, 0.0, -3.0, 0.0, 0.3, 0.0]
    first = column(file, "panda_joint1")
    robot[approach, first : first + 7] = folded
    file["dense/robot"][rows] = robot
    # Slowly enough for the jump back.
    times = file["dense/times"][rows]
    times[approach[-1] + 1 :] += 60.0
    file["dense/times"][rows] = times


def swapped(file: h5py.File, rows: slice) -> None:
    """Two joints' columns are exchanged."""
    robot = file["dense/robot"][rows]
    pair = [column(file, "panda_joint1"), column(file, "panda_joint3")]
    robot[:, pair] = robot[:, pair[::-1]]
    write(file, rows, robot)


def test_both_judges_accept_what_was_planned(drawer_file: Path, shared_assets: Path) -> None:
    findings = external_judge.File(drawer_file, [shared_assets]).findings(STRIDE)
    verdicts = ours(drawer_file, shared_assets)
    assert len(findings) == len(verdicts) == 2
    for finding, verdict in zip(findings, verdicts, strict=True):
        assert finding.refused is None, finding.detail
        assert verdict["rejection"] is None, verdict["detail"]
        assert finding.configurations > 20
        # The same quantities, by two kinematics.
        assert abs(finding.anchor_m - verdict["anchor_translation_m"]) < 1e-5
        assert abs(finding.velocity_fraction - verdict["velocity_fraction"]) < 0.05


@pytest.mark.parametrize(
    ("change", "theirs", "own"),
    [
        (drift, "anchor", {"anchor_translation"}),
        (beyond_limit, "position_limit", {"position_limit"}),
        (into_itself, "collision", {"sphere_collision", "mesh_penetration"}),
        (swapped, "anchor", {"anchor_translation", "anchor_rotation"}),
    ],
)
def test_both_judges_refuse_what_was_spoilt(
    drawer_file: Path,
    shared_assets: Path,
    change: Callable[[h5py.File, slice], None],
    theirs: str,
    own: set[str],
) -> None:
    file = spoilt(drawer_file, change)
    intact, bad = external_judge.File(file, [shared_assets]).findings(STRIDE)
    assert intact.refused is None, intact.detail
    assert bad.refused == theirs, bad.detail
    verdicts = ours(file, shared_assets)
    assert verdicts[0]["rejection"] is None, verdicts[0]["detail"]
    assert verdicts[1]["rejection"] in own, verdicts[1]["detail"]
