"""Camera models against OpenCV's, and back again."""

from __future__ import annotations

from pathlib import Path

import akrobat
import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

BROWN_CONRADY = dict(
    k1=-0.31, k2=0.12, k3=-0.02, k4=0.01, k5=-0.004, k6=0.001, p1=0.0021, p2=-0.0013
)
KANNALA_BRANDT = dict(k1=-0.021, k2=0.0043, k3=-0.0021, k4=0.0003)
K = np.array([[301.5, 0.0, 158.3], [0.0, 299.2, 121.9], [0.0, 0.0, 1.0]])


def rig_file(folder: Path, model: str, coefficients: dict[str, float]) -> Path:
    """One camera with K and this lens."""
    lens = "".join(f"{name} = {value}\n" for name, value in coefficients.items())
    file = folder / f"{model}.toml"
    file.write_text(
        f"""
name = "lens"
[[cameras]]
name = "eye"
k = {K.tolist()}
mount = {{ on = "look_at", position = [1, 0, 1], target = [0, 0, 0] }}
[cameras.distortion]
model = "{model}"
{lens}"""
    )
    return file


def points() -> NDArray[np.float64]:
    """Points before the camera, up to 35 degrees off its axis."""
    random = np.random.default_rng(3)
    directions = random.uniform(-0.7, 0.7, (500, 2))
    depths = random.uniform(0.2, 9.0, (500, 1))
    return np.concatenate([directions * depths, depths], axis=1)


def by_opencv(model: str, c: dict[str, float], points: NDArray[np.float64]) -> NDArray[np.float64]:
    zero = np.zeros(3)
    if model == "kannala_brandt":
        coefficients = np.array([c[f"k{i}"] for i in range(1, 5)])
        pixels, _ = cv2.fisheye.projectPoints(points[:, None], zero, zero, K, coefficients)
    else:
        order = ["k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6"]
        coefficients = np.array([c.get(name, 0.0) for name in order])
        pixels, _ = cv2.projectPoints(points, zero, zero, K, coefficients)
    return pixels.reshape(-1, 2)


@pytest.mark.parametrize(
    ("model", "coefficients"),
    [("brown_conrady", BROWN_CONRADY), ("kannala_brandt", KANNALA_BRANDT)],
)
def test_lenses_project_as_opencv_does(
    tmp_path: Path, model: str, coefficients: dict[str, float]
) -> None:
    rig = rig_file(tmp_path, model, coefficients)
    found = akrobat.project(rig, "eye", points())
    assert np.abs(found - by_opencv(model, coefficients, points())).max() < 1e-6
    # Control: one coefficient changed by a thousandth is seen.
    changed = {**coefficients, "k1": coefficients["k1"] + 1e-3}
    assert np.abs(found - by_opencv(model, changed, points())).max() > 1e-3


@pytest.mark.parametrize(
    ("model", "coefficients"),
    [("brown_conrady", BROWN_CONRADY), ("kannala_brandt", KANNALA_BRANDT)],
)
def test_lenses_round_trip(tmp_path: Path, model: str, coefficients: dict[str, float]) -> None:
    rig = rig_file(tmp_path, model, coefficients)
    pixels = akrobat.project(rig, "eye", points())
    rays = akrobat.unproject(rig, "eye", pixels)
    assert np.abs(rays - points()[:, :2] / points()[:, 2:]).max() < 1e-9
    again = akrobat.project(rig, "eye", np.column_stack([rays, np.ones(len(rays))]))
    assert np.abs(again - pixels).max() < 1e-9


def test_pinholes_project_as_opencv_does() -> None:
    focal_px = 320 * 50.0 / 20.955
    k = np.array([[focal_px, 0, 160], [0, focal_px, 120], [0, 0, 1]])
    expected, _ = cv2.projectPoints(points(), np.zeros(3), np.zeros(3), k, np.zeros(5))
    found = akrobat.project("paper", "fixed", points())
    assert np.abs(found - expected.reshape(-1, 2)).max() < 1e-6


def test_what_lies_behind_is_not_seen() -> None:
    assert np.isnan(akrobat.project("paper", "fixed", [[0.0, 0.0, -1.0]])).all()


def test_unknown_cameras_list_the_choices() -> None:
    with pytest.raises(akrobat.InputError, match="ego_wrist"):
        akrobat.project("paper", "wrist", points())


def test_farthest_points_are_those_of_the_definition() -> None:
    cloud = np.random.default_rng(5).random((700, 3), np.float32)
    chosen = akrobat.farthest_points(cloud, 64)
    distance = np.linalg.norm(cloud - cloud[chosen[0]], axis=1)
    for index in chosen[1:]:
        assert distance[index] == pytest.approx(distance.max(), rel=1e-6)
        distance = np.minimum(distance, np.linalg.norm(cloud - cloud[index], axis=1))
