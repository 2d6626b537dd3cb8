"""The rasteriser, wgpu and SAPIEN draw the same in three furnished scenes, with two robots.

Depth, segmentation and normals are compared, and colours between backends of one light model. The
`sapien` backend's normals follow from its depth; here SAPIEN's own, of its `default` shaders, are
read beside.
"""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import akrobat
import cv2
import numpy as np
import pytest
from akrobat import sapien_backend
from akrobat.exporters import traj_data
from image_agreement import (
    DEPTH_TOLERANCE_MM,
    LEAST_AGREEMENT,
    LEAST_BODY_PIXELS,
    LEAST_INNER,
    LEAST_IOU,
    inner_pixels,
)
from numpy.typing import NDArray

ROBOTS = Path(__file__).parents[2] / "configs" / "robots"
CASES = [
    ("infinigen_kitchen_1", "summit_franka"),
    ("living_room", "summit_franka"),
    ("generated_kitchen", "tiago"),
]
WIDTH, HEIGHT = 480, 360
INTERVAL_S = 1 / 30
NORMAL_TOLERANCE_RAD = 0.02
LEAST_SSIM = 0.99

RIG = f"""
name = "side"
[[cameras]]
name = "side"
width = {WIDTH}
height = {HEIGHT}
fov_rad = 1.0
mount = {{ on = "look_at_handle", offset = [1.2, 0.0, 1.0] }}
"""
MOVED_RIG = RIG.replace("[1.2,", "[1.21,")

CHEST = """
[object]
name = "drawer_1001"
urdf = "objects/drawer_1001/drawer.urdf"
license = "BSD-3-Clause"
pose = {pose}
joint = "drawer_slider_0"
[object.handle]
link = "link_1"
parts = ["drawer_door_1"]
[goal]
positions = [0.275]
"""
KITCHEN = """
[scene]
name = "infinigen_kitchen_1"
file = "scenes/infinigen_kitchen_1/scene.glb"
floor = "kitchen_0/0.floor"
offset = [-5.5, -11.0]
"""
IN_KITCHEN = [-1.05, 2.049, -0.0206, 0.70710678, 0.0, 0.0, -0.70710678]
IN_LIVING_ROOM = [-2.6, -0.4, -0.0206, 1.0, 0.0, 0.0, 0.0]

Images = dict[str, NDArray[Any]]


def cli(*words: object) -> None:
    command = [sys.executable, "-m", "akrobat", "--quiet", *map(str, words)]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr


def task(scene: str, robot: str, assets: Path, folder: Path) -> Path:
    """A task of this robot in this scene."""
    robot_file = ROBOTS / f"{robot}.toml"
    if scene == "generated_kitchen":
        cli("generate", "scene", "-o", folder / "generated", "--robot", robot_file)
        (kitchen,) = (folder / "generated").glob("kitchen_*")
        return kitchen / "tasks" / f"drawer_unit_1_{robot}.toml"
    surroundings, pose = KITCHEN, IN_KITCHEN
    if scene == "living_room":
        models = assets / "scenes" / "drake_living_room" / "models"
        directives = models / "furnished_living_room.dmd.yaml"
        cli("import", "sdf", directives, "-o", folder / "room")
        room = (folder / "room" / "scene.urdf").as_posix()
        surroundings, pose = f'[scene]\nname = "living_room"\nfile = "{room}"\n', IN_LIVING_ROOM
    file = folder / "task.toml"
    head = f'name = "{scene}_{robot}"\nseed = 1\n[robot]\nfile = "{robot_file.as_posix()}"\n'
    file.write_text(head + CHEST.format(pose=pose) + surroundings)
    return file


def two_frames(task_file: Path, assets: Path, folder: Path) -> Path:
    """A planned trajectory's first and last waypoint, as a trajectory of its own."""
    planned, shortened = folder / "planned.h5", folder / "two.h5"
    akrobat.plan(task_file, planned, limit=1, assets=[assets], quiet=True)
    recorded = folder / "recorded"
    cli("export", planned, "--to", "automoma", "-o", recorded, "--allow-non-commercial")
    arrays = traj_data.load(recorded / "traj_data.pt")
    names = ("traj_robot", "traj_obj", "traj_success", "grasp_id", "grasp_pose", "goal_angle")
    kept = {name: np.asarray(arrays[name])[:1] for name in names}
    for name in ("traj_robot", "traj_obj"):
        kept[name] = kept[name][:, [0, -1]]
    traj_data.write(folder / "two.pt", kept, arrays["scene_id"], arrays["object_id"])
    words = ("--task", task_file, "-o", shortened, "--interval", INTERVAL_S, "--assets", assets)
    cli("import", "trajectories", folder / "two.pt", *words)
    return shortened


class OwnNormals(sapien_backend.SapienRenderer):
    """Keeps the normals that SAPIEN's `default` shaders give."""

    taken: list[NDArray[np.float32]]

    def __init__(self, *arguments: Any) -> None:
        super().__init__(*arguments)
        self.taken.clear()
        self._normal_cameras = [self._add_camera(camera, "default") for camera in arguments[1]]

    def _read(self, camera: Any, *images: Any) -> None:
        super()._read(camera, *images)
        (normals,) = self._normal_cameras
        normals.entity.set_pose(camera.entity.pose)
        self._scene.update_render()
        normals.take_picture()
        self.taken.append(normals.get_picture("Normal")[..., :3].copy())


@pytest.fixture(params=CASES, ids="-".join)
def render(
    request: pytest.FixtureRequest, shared_assets: Path, tmp_path: Path
) -> Callable[..., Images]:
    trajectory = two_frames(task(*request.param, shared_assets, tmp_path), shared_assets, tmp_path)

    def run(backend: str, rig_text: str = RIG) -> Images:
        rig = tmp_path / "rig.toml"
        rig.write_text(rig_text)
        dataset = akrobat.render(
            trajectory,
            tmp_path / f"{backend}_{len(list(tmp_path.iterdir()))}",
            backend=backend,
            rig=rig,
            modalities=["rgb", "depth", "segmentation", "normals"],
            cloud={"points": 0},
            assets=[shared_assets],
            quiet=True,
        )
        episode = dataset.episodes[0]
        names = ("rgb", "depth", "segmentation", "normals", "world_from_camera")
        images = {name: episode[f"camera_obs/side_{name}"][:] for name in names}
        images["depth"] = images["depth"][..., 0].astype(np.int32)
        images["segmentation"] = images["segmentation"][..., 0]
        return images

    return run


def inner_of_both(reference: Images, other: Images) -> NDArray[np.bool_]:
    """Pixels away from the silhouettes of either."""
    inner, others = (inner_pixels(i["depth"], i["segmentation"]) for i in (reference, other))
    return inner & others


def least_overlap(reference: Images, other: Images) -> float:
    """Of the segments that are large in either, the least intersection over union in a frame."""
    overlaps = [1.0]
    for frame, theirs in zip(reference["segmentation"], other["segmentation"], strict=True):
        for segment in np.union1d(frame, theirs):
            a, b = frame == segment, theirs == segment
            if segment and max(a.sum(), b.sum()) >= LEAST_BODY_PIXELS:
                overlaps.append(float((a & b).sum() / (a | b).sum()))
    return min(overlaps)


def shape_violation(reference: Images, other: Images) -> str | None:
    """How depth or segmentation differ by more than the tolerances; `None` where they do not."""
    inner = inner_of_both(reference, other)
    if inner.mean() < LEAST_INNER:
        return f"only {inner.mean():.1%} of the pixels are compared"
    near = np.abs(reference["depth"] - other["depth"])[inner] <= DEPTH_TOLERANCE_MM
    if near.mean() < LEAST_AGREEMENT:
        return f"depth agrees on {near.mean():.1%}"
    overlap = least_overlap(reference, other)
    return None if overlap > LEAST_IOU else f"a segment overlaps by {overlap:.3f}"


def normal_agreement(reference: Images, other: Images) -> float:
    """Share of the inner pixels of both whose normals agree."""
    inner = inner_of_both(reference, other)
    cosine = np.einsum("...i,...i->...", reference["normals"], other["normals"])[inner]
    return float((cosine >= np.cos(NORMAL_TOLERANCE_RAD)).mean())


def ssim(reference: Images, other: Images) -> float:
    """Mean structural similarity of luminance (Wang et al. 2004, Gaussian window, sigma 1.5)."""
    a, b = (
        np.stack([cv2.cvtColor(rgb, cv2.COLOR_RGB2GRAY) for rgb in images["rgb"]]).astype(float)
        for images in (reference, other)
    )

    def blur(stack: NDArray[np.float64]) -> NDArray[np.float64]:
        return np.stack([cv2.GaussianBlur(image, (11, 11), 1.5) for image in stack])

    mean_a, mean_b = blur(a), blur(b)
    variance_a, variance_b = blur(a * a) - mean_a**2, blur(b * b) - mean_b**2
    covariance = blur(a * b) - mean_a * mean_b
    c1, c2 = (0.01 * 255) ** 2, (0.03 * 255) ** 2
    similar = (2 * mean_a * mean_b + c1) * (2 * covariance + c2)
    return float((similar / ((mean_a**2 + mean_b**2 + c1) * (variance_a + variance_b + c2))).mean())


def test_backends_agree(render: Callable[..., Images], monkeypatch: pytest.MonkeyPatch) -> None:
    ours, theirs = render("soft"), render("wgpu")
    OwnNormals.taken = []
    monkeypatch.setattr(sapien_backend, "SapienRenderer", OwnNormals)
    sapien = render("sapien")
    assert len(ours["depth"]) == len(OwnNormals.taken)
    # SAPIEN's camera space has y up and looks along -z.
    in_camera = np.stack(OwnNormals.taken) * [1, -1, -1]
    turn = ours["world_from_camera"][:, :3, :3]
    sapien["normals"] = np.einsum("fij,fhwj->fhwi", turn, in_camera)

    for other in (theirs, sapien):
        assert shape_violation(ours, other) is None
        assert normal_agreement(ours, other) >= LEAST_AGREEMENT
    assert ssim(ours, theirs) > LEAST_SSIM

    # Controls: a camera a centimetre off, a robot at the other waypoint, normals turned about.
    moved = render("soft", MOVED_RIG)
    assert shape_violation(ours, moved) is not None
    assert ssim(ours, moved) < LEAST_SSIM
    later = {name: array[::-1] for name, array in ours.items()}
    assert shape_violation(ours, later) is not None
    assert normal_agreement(ours, {**sapien, "normals": -sapien["normals"]}) < 0.01


@pytest.mark.parametrize("render", CASES[2:], indirect=True, ids="-".join)
def test_sapiens_shaders_change_colours_alone(render: Callable[..., Images]) -> None:
    small = RIG.replace(str(WIDTH), "80").replace(str(HEIGHT), "60")
    minimal = render("sapien", small)
    likeness = {}
    for backend in ("sapien-default", "sapien-rt"):
        images = render(backend, small)
        assert np.array_equal(images["depth"], minimal["depth"])
        assert np.array_equal(images["segmentation"], minimal["segmentation"])
        likeness[backend] = ssim(minimal, images)
    # The first shades as the minimal ones do; the second traces light from surface to surface.
    assert likeness["sapien-default"] > LEAST_SSIM
    assert 0.5 < likeness["sapien-rt"] < LEAST_SSIM
