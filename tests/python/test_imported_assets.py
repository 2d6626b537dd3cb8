"""Imported robots plan, and imported MJCF is where MuJoCo has it."""

from __future__ import annotations

import json
from importlib.metadata import distribution
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np
import pytest
import yourdfpy
from exports import run
from numpy.typing import NDArray

REPOSITORY = Path(__file__).parents[2]
PLATFORM = REPOSITORY / "configs" / "robots" / "mobile_platform.urdf"


def robots() -> Path:
    """The robots of `example-robot-data`."""
    package = distribution("example-robot-data")
    folder = "cmeel.prefix/share/example-robot-data/robots"
    return Path(str(package.locate_file(folder)))


def succeed(*arguments: object) -> dict[str, Any]:
    """Runs `akrobat`, which must succeed, and returns its report."""
    result = run(*arguments, "--json")
    assert result.returncode == 0, (result.returncode, result.stdout, result.stderr)
    return dict(json.loads(result.stdout))


#: Arm, carrier with its mounts, and where a fixed base stands before the drawers.
COMPOSITIONS: dict[str, tuple[str, list[str], str]] = {
    "panda on a Summit XL": (
        "panda_description/urdf/panda.urdf",
        [
            "--mount-on",
            "SUMMIT",
            "--mount-link",
            "base_footprint",
            "--mount-xyz=-0.127,0.012,0.465",
        ],
        "",
    ),
    # A box of the Ridgeback's size: no package that tests may depend on has its URDF.
    "two UR5 on a Ridgeback": (
        "ur_description/urdf/ur5_robot.urdf",
        [
            *("--mount-on", "box:0.96,0.793,0.311", "--base", "holonomic"),
            *("--mount-xyz", "0.25,0.2,0", "--mount-xyz", "0.25,-0.2,0"),
            *("--mount-prefix", "left_", "--mount-prefix", "right_"),
        ],
        "",
    ),
    "panda on a platform": (
        "panda_description/urdf/panda.urdf",
        ["--mount-on", str(PLATFORM), "--mount-xyz", "0.2,0,0.52", "--base", "holonomic"],
        "",
    ),
    "two UR5 on a platform": (
        "ur_description/urdf/ur5_robot.urdf",
        [
            *("--mount-on", str(PLATFORM), "--base", "holonomic"),
            *("--mount-xyz", "0.22,0.2,0.33", "--mount-xyz", "0.22,-0.2,0.33"),
            *("--mount-prefix", "left_", "--mount-prefix", "right_"),
        ],
        "",
    ),
    "UR5 on a box": (
        "ur_description/urdf/ur5_robot.urdf",
        ["--mount-on", "box:0.5,0.5,0.6"],
        "pose = [-2.7, -0.1, 0.0, 0.0, 0.0, 0.0, 1.0]\n",
    ),
}


def summit_alone(robot: Path, folder: Path) -> Path:
    """The base of the shared Summit XL with a Panda, without the Panda."""
    description = ElementTree.parse(robot / "summit_xl_franka.urdf")
    root = description.getroot()
    names = [link.attrib["name"] for link in root.findall("link")]
    arm = {n for n in names if n.startswith(("panda_", "ee_", "right_gripper")) or n == "base_link"}
    for part in list(root):
        child = part.find("child")
        if part.attrib["name"] in arm or (child is not None and child.attrib["link"] in arm):
            root.remove(part)
    description.write(folder / "summit.urdf")
    return folder / "summit.urdf"


@pytest.mark.parametrize("name", COMPOSITIONS)
def test_composed_robots_open_a_drawer(name: str, shared_assets: Path, tmp_path: Path) -> None:
    arm, carrier, pose = COMPOSITIONS[name]
    shared = shared_assets / "robots" / "summit_xl_franka"
    summit = str(summit_alone(shared, tmp_path))
    carrier = [summit if word == "SUMMIT" else word for word in carrier]
    report = succeed(
        *("import", "robot", robots() / arm, *carrier, "--assets", shared),
        *("-o", tmp_path / "robot"),
    )
    assert 50 <= report["sphere_count"] <= 120, report["sphere_count"]
    assert report["coverage"] > 0.9
    assert report["lost"] == []
    robot = tmp_path / "robot" / "robot.toml"
    drawers = tmp_path / "drawers"
    succeed("generate", "object", "drawer-unit", "--seed", 3, "--robot", robot, "-o", drawers)
    task = drawers / "task.toml"
    text = task.read_text().replace('robot.toml"\n', f'robot.toml"\n{pose}', 1)
    task.write_text(text)
    planned = succeed("plan", task, "-o", tmp_path / "t.h5", "--limit", 1, "--quiet")
    assert planned["counts"]["accepted"] == 1


def test_the_shared_robot_gets_as_many_spheres_as_are_fast(
    shared_assets: Path, tmp_path: Path
) -> None:
    urdf = shared_assets / "robots" / "summit_xl_franka" / "summit_xl_franka.urdf"
    report = succeed("import", "robot", urdf, "--assets", shared_assets, "-o", tmp_path / "robot")
    assert 50 <= report["sphere_count"] <= 120
    assert report["coverage"] > 0.9
    assert {fit["link"] for fit in report["fits"]} >= {"panda_link5", "panda_hand"}


def test_an_imported_object_comes_with_a_task(shared_assets: Path, tmp_path: Path) -> None:
    urdf = shared_assets / "objects" / "sektion_cabinet" / "urdf" / "sektion_cabinet.urdf"
    if not urdf.exists():
        urdf = next((shared_assets / "objects" / "sektion_cabinet").rglob("*.urdf"))
    output = tmp_path / "cabinet"
    report = succeed(
        *("import", "urdf", urdf, "--assets", shared_assets, "--picture", "-o", output)
    )
    assert report["tasks"] == [str(output / "task.toml")]
    assert (output / "object.png").read_bytes().startswith(b"\x89PNG")
    result = run("plan", output / "task.toml", "-o", tmp_path / "t.h5", "--limit", 1, "--quiet")
    assert result.returncode in (0, 3), result.stderr


#: Nested bodies, anchors beside their origins, a reference angle, a scaled mesh, every primitive.
MJCF = """<mujoco model="machine">
  <compiler angle="degree" autolimits="true"/>
  <asset><mesh name="wedge" file="wedge.obj" scale="0.5 1 2"/></asset>
  <default><geom contype="1"/><default class="rod"><geom type="capsule" size="0.03"/></default>
  </default>
  <worldbody>
    <body name="housing" pos="0.4 -0.2 0.7" euler="10 20 30">
      <geom type="box" size="0.2 0.3 0.1" pos="0 0 0.1" euler="0 0 15"/>
      <geom type="mesh" mesh="wedge" pos="0.3 0 0"/>
      <body name="door" pos="0.2 -0.3 0" quat="0.9 0.1 -0.3 0.2">
        <joint name="hinge" axis="1 2 3" pos="0.1 0.05 -0.02" range="-80 40" ref="-15"/>
        <geom type="cylinder" size="0.05 0.2" euler="40 0 0"/>
        <body name="handle" pos="0 0.1 0.2">
          <joint name="slide" type="slide" axis="0 1 1" range="-0.1 0.3"/>
          <geom class="rod" fromto="0 0 0 0.1 0.2 0.05"/>
          <geom type="sphere" size="0.06" pos="0 0 0.2"/>
          <body name="knob" pos="0.1 0 0"><joint name="turn" axis="0 0 1" range="-170 170"/>
            <geom type="ellipsoid" size="0.05 0.08 0.03"/></body>
        </body>
      </body>
    </body>
  </worldbody>
</mujoco>"""
WEDGE = "v 0 0 0\nv 0.2 0 0\nv 0 0.2 0\nv 0 0 0.2\nf 1 3 2\nf 1 2 4\nf 1 4 3\nf 2 3 4\n"


def half_extent(model: Any, data: Any, geom: int) -> NDArray[np.float64]:
    """Half of the box around a primitive along the world's axes."""
    import mujoco

    size, turn = model.geom_size[geom], data.geom_xmat[geom].reshape(3, 3)
    along = np.abs(turn[:, 2])
    kind = model.geom_type[geom]
    if kind == mujoco.mjtGeom.mjGEOM_BOX:
        return np.abs(turn) @ size
    if kind == mujoco.mjtGeom.mjGEOM_SPHERE:
        return np.full(3, size[0])
    if kind == mujoco.mjtGeom.mjGEOM_CAPSULE:
        return along * size[1] + size[0]
    if kind == mujoco.mjtGeom.mjGEOM_CYLINDER:
        return along * size[1] + size[0] * np.sqrt(np.maximum(0.0, 1.0 - along**2))
    assert kind == mujoco.mjtGeom.mjGEOM_ELLIPSOID
    return np.sqrt(((turn * size) ** 2).sum(axis=1))


def bounds_by_mujoco(model: Any, data: Any, body: int) -> NDArray[np.float64]:
    import mujoco

    corners = []
    for geom in np.flatnonzero(model.geom_bodyid == body):
        at = data.geom_xpos[geom]
        if model.geom_type[geom] == mujoco.mjtGeom.mjGEOM_MESH:
            mesh = model.geom_dataid[geom]
            start, count = model.mesh_vertadr[mesh], model.mesh_vertnum[mesh]
            vertices = model.mesh_vert[start : start + count]
            corners.append(vertices @ data.geom_xmat[geom].reshape(3, 3).T + at)
        else:
            half = half_extent(model, data, geom)
            corners.append(np.array([at - half, at + half]))
    points = np.concatenate(corners)
    return np.array([points.min(axis=0), points.max(axis=0)])


def test_mjcf_is_where_mujoco_has_it_and_as_large(tmp_path: Path) -> None:
    mujoco = pytest.importorskip("mujoco")
    (tmp_path / "wedge.obj").write_text(WEDGE)
    path = tmp_path / "machine.xml"
    path.write_text(MJCF)
    report = succeed("import", "mjcf", path, "--as", "object", "-o", tmp_path / "machine")
    assert report["lost"] == []
    model = mujoco.MjModel.from_xml_path(str(path))
    data = mujoco.MjData(model)
    written = yourdfpy.URDF.load(str(report["urdf"]), build_collision_scene_graph=False)
    chance = np.random.default_rng(4)
    for _ in range(20):
        positions = {
            model.joint(index).name: chance.uniform(*model.jnt_range[index])
            for index in range(model.njnt)
        }
        for joint, position in positions.items():
            data.joint(joint).qpos[0] = position
        mujoco.mj_forward(model, data)
        written.update_cfg(positions)
        for body in ["housing", "door", "handle", "knob"]:
            found = written.get_transform(body)
            assert np.allclose(found[:3, 3], data.body(body).xpos, atol=1e-6), body
            assert np.allclose(found[:3, :3].ravel(), data.body(body).xmat, atol=1e-6), body
            points = np.concatenate([p for p in points_of(written, body)])
            bounds = np.array([points.min(axis=0), points.max(axis=0)])
            expected = bounds_by_mujoco(model, data, model.body(body).id)
            assert np.allclose(bounds, expected, atol=2e-3), (body, bounds, expected)
    # Other positions are other places: what is compared depends on them.
    written.update_cfg({"hinge": 0.3})
    data.joint("hinge").qpos[0] = 0.0
    mujoco.mj_forward(model, data)
    assert not np.allclose(written.get_transform("door")[:3, 3], data.body("door").xpos, atol=1e-3)


def points_of(description: yourdfpy.URDF, link: str) -> list[NDArray[np.float64]]:
    """Vertices of what is seen of a link, in the world."""
    scene = description.scene
    found = []
    for node in scene.graph.nodes_geometry:
        # Shapes hang below the frame of their link.
        if link not in ancestors(scene, node):
            continue
        transform, geometry = scene.graph[node]
        vertices = np.asarray(scene.geometry[geometry].vertices)
        found.append(vertices @ transform[:3, :3].T + transform[:3, 3])
    return found


def ancestors(scene: Any, node: str) -> set[str]:
    """The nearest link above a shape."""
    parents = scene.graph.transforms.parents
    while node in parents:
        node = parents[node]
        if node in {"housing", "door", "handle", "knob", "world"}:
            return {node}
    return set()
