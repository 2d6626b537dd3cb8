"""What the first policy is made of, as far as it needs no PyTorch; the rest is tested by `make
test-maniskill`."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from akrobat import InputError
from akrobat.policy.curve import plot, points, wilson
from akrobat.policy.features import CloudFeatures


def test_cloud_features_are_continuous_and_tell_clouds_apart() -> None:
    rng = np.random.default_rng(0)
    door = rng.uniform(size=(200, 3)).astype(np.float32)
    angles = np.linspace(0.0, 1.0, 40, dtype=np.float32)
    clouds = np.stack([door * [1.0, 1.0, 1.0 - angle] + [0, 0, angle] for angle in angles])
    features = CloudFeatures.fit(clouds.astype(np.float32), 4)
    values = np.stack([features(cloud) for cloud in clouds.astype(np.float32)])
    assert values.shape == (40, 4)
    np.testing.assert_allclose(values.std(axis=0), 1.0, atol=0.2)
    # The cloud whose features are nearest is one of the next angles.
    away = np.linalg.norm(values[:, None] - values[None], axis=2) + np.diag(np.full(40, np.inf))
    assert np.abs(away.argmin(axis=1) - np.arange(40)).max() <= 2
    moved = clouds[20].astype(np.float32) + np.float32(1e-4)
    assert np.abs(features(moved) - values[20]).max() < 0.05
    assert features.occupancy(moved).sum() == pytest.approx(1.0, abs=1e-5)


def test_without_points_there_are_no_features() -> None:
    features = CloudFeatures.fit(np.zeros((5, 0, 3), np.float32), 8)
    assert features(np.zeros((0, 3), np.float32)).shape == (0,)


def test_intervals_are_wilsons() -> None:
    # Newcombe 1998, table I: 81 of 263, and 0 of 20.
    np.testing.assert_allclose(wilson(81, 263), (0.2553, 0.3662), atol=1e-4)
    np.testing.assert_allclose(wilson(0, 20), (0.0, 0.1611), atol=1e-4)


def trials(folder: Path, count: int, successes: int) -> Path:
    folder.mkdir()
    (folder / "summary.json").write_text(json.dumps({"policy": "p", "trajectories": count}))
    rows = ["trial,split,success"]
    rows += [f"{i},{'seen' if i % 2 else 'unseen'},{int(i < successes)}" for i in range(10)]
    (folder / "trials.csv").write_text("\n".join(rows) + "\n")
    return folder


def test_the_curve_has_a_point_for_each_count_and_split(tmp_path: Path) -> None:
    folders = [trials(tmp_path / "b", 100, 8), trials(tmp_path / "a", 50, 4)]
    found = points(folders)
    assert [(p["split"], p["trajectories"], p["succeeded"]) for p in found] == [
        ("seen", 50, 2),
        ("seen", 100, 4),
        ("unseen", 50, 2),
        ("unseen", 100, 4),
    ]
    drawn = plot(found)
    assert drawn.count("<circle") == 4
    assert "NaN" not in drawn
    with pytest.raises(InputError, match="no finished trials"):
        points([tmp_path / "absent"])


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("eval", "task.toml", "--policy", "POLICY", "-o", "out"), "expected the format"),
        (("eval", "task.toml", "--policy", "absent", "-o", "out"), "the folder of a trained"),
    ],
)
def test_what_is_no_policy_is_refused(
    tmp_path: Path, arguments: tuple[str, ...], message: str, drawer_task: Path, shared_assets: Path
) -> None:
    (tmp_path / "POLICY").mkdir()
    (tmp_path / "POLICY" / "policy.json").write_text('{"format": "other"}')
    replaced = {"task.toml": drawer_task, "POLICY": tmp_path / "POLICY", "out": tmp_path / "out"}
    command = [str(replaced.get(argument, argument)) for argument in arguments]
    done = subprocess.run(
        [sys.executable, "-m", "akrobat", *command, "--assets", str(shared_assets)],
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 2, done.stderr
    assert message in done.stderr


@pytest.fixture
def drawer_task() -> Path:
    return Path(__file__).parents[2] / "configs" / "tasks" / "summit_drawer_empty.toml"
