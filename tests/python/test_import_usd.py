"""USD stages: a scene of ours comes back as it was written, a foreign one in metres with z up."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh
import yourdfpy
from exports import refused, run
from numpy.typing import NDArray
from pxr import Gf, Sdf, Usd, UsdGeom, UsdPhysics, UsdShade
from scipy.spatial import cKDTree

#: Where the door's hinge is, metres, z up.
HINGE = np.array([0.5, 0.3, 0.8])


def imported(*arguments: object, exit_code: int = 0) -> dict[str, Any]:
    result = run("import", "usd", *arguments, "--json")
    assert result.returncode == exit_code, (result.returncode, result.stdout, result.stderr)
    return dict(json.loads(result.stdout))


def triangles(meshes: list[tuple[NDArray[np.float64], trimesh.Trimesh]]) -> NDArray[np.float64]:
    """Centroid (m) and area vector (square decimetres) of all triangles in the world `[N, 6]`."""
    rows = []
    for pose, mesh in meshes:
        corners = mesh.triangles @ pose[:3, :3].T + pose[:3, 3]
        area = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]) / 2.0
        rows.append(np.hstack([corners.mean(axis=1), 100.0 * area]))
    return np.concatenate(rows)


def apart(a: NDArray[np.float64], b: NDArray[np.float64]) -> float:
    """Largest distance of a row of one from the nearest of the other."""
    return max(cKDTree(b).query(a)[0].max(), cKDTree(a).query(b)[0].max())


def of_urdf(path: Path) -> NDArray[np.float64]:
    robot = yourdfpy.URDF.load(str(path))
    scene = robot.scene
    meshes = []
    for node in scene.graph.nodes_geometry:
        pose, geometry = scene.graph[node]
        meshes.append((np.array(pose), scene.geometry[geometry]))
    return triangles(meshes)


def test_a_generated_scene_comes_back(tmp_path: Path) -> None:
    result = run("generate", "scene", "--count", 1, "--seed", 4, "-o", tmp_path / "scenes", "-q")
    assert result.returncode == 0, result.stderr
    (source,) = (tmp_path / "scenes").glob("*/scene.usda")
    report = imported(source, "-o", tmp_path / "back")
    assert report["lost"] == report["repairs"] == []
    names = {body["name"] for body in report["manifest"]["bodies"]}
    stage = Usd.Stage.Open(str(source))
    components = [p for p in stage.Traverse() if Usd.ModelAPI(p).GetKind() == "component"]
    assert {prim.GetName() for prim in components} - names <= {"floor"}
    expected = []
    for prim in stage.Traverse():
        if prim.IsA(UsdGeom.Mesh):
            mesh = UsdGeom.Mesh(prim)
            faces = np.array(mesh.GetFaceVertexIndicesAttr().Get()).reshape(-1, 3)
            points = np.array(mesh.GetPointsAttr().Get(), float)
            place = UsdGeom.Xformable(prim).ComputeLocalToWorldTransform(0)
            shape = trimesh.Trimesh(points, faces, process=False)
            expected.append((np.array(place).T, shape))
    found, wanted = of_urdf(Path(report["urdf"])), triangles(expected)
    assert found.shape == wanted.shape
    assert apart(found, wanted) < 1e-3
    # A triangle that was lost, stood elsewhere or was turned inside out would show.
    largest = np.linalg.norm(found[:, 3:], axis=1).argmax()
    shifted, inside_out = found.copy(), found.copy()
    shifted[largest, 0] += 0.01
    inside_out[largest, 3:] *= -1.0
    others = (np.delete(found, largest, axis=0), shifted, inside_out)
    assert min(apart(other, wanted) for other in others) > 5e-3


def kitchen(path: Path) -> None:
    """A cabinet in centimetres with y up: a scaled body, and a door on a hinge."""
    stage = Usd.Stage.CreateNew(str(path))
    UsdGeom.SetStageMetersPerUnit(stage, 0.01)
    UsdGeom.SetStageUpAxis(stage, UsdGeom.Tokens.y)

    def stage_from_world(metres: NDArray[np.float64]) -> Gf.Vec3d:
        x, y, z = 100.0 * metres
        return Gf.Vec3d(x, z, -y)

    def body(name: str, place: NDArray[np.float64]) -> Any:
        prim = UsdGeom.Xform.Define(stage, f"/kitchen/{name}").GetPrim()
        UsdGeom.Xformable(prim).AddTranslateOp().Set(stage_from_world(place))
        UsdPhysics.RigidBodyAPI.Apply(prim)
        return prim

    cabinet = body("cabinet", np.array([0.7, 0.0, 0.8]))
    UsdGeom.Xformable(cabinet).AddScaleOp().Set(Gf.Vec3f(2.0))
    box = UsdGeom.Cube.Define(stage, "/kitchen/cabinet/box")
    box.CreateSizeAttr(20.0)
    door = body("door", HINGE - np.array([0.0, 0.3, 0.0]))
    panel = UsdGeom.Cube.Define(stage, "/kitchen/door/panel")
    panel.CreateSizeAttr(1.0)
    panel.AddScaleOp().Set(Gf.Vec3f(2.0, 40.0, 60.0))
    knob = UsdGeom.Sphere.Define(stage, "/kitchen/door/knob")
    knob.CreateRadiusAttr(2.0)
    knob.AddTranslateOp().Set(Gf.Vec3d(-3.0, 0.0, 25.0))
    material = UsdShade.Material.Define(stage, "/kitchen/red")
    shader = UsdShade.Shader.Define(stage, "/kitchen/red/surface")
    shader.CreateIdAttr("UsdPreviewSurface")
    color = shader.CreateInput("diffuseColor", Sdf.ValueTypeNames.Color3f)
    color.Set(Gf.Vec3f(1.0, 0.0, 0.0))
    material.CreateSurfaceOutput().ConnectToSource(shader.ConnectableAPI(), "surface")
    UsdShade.MaterialBindingAPI.Apply(knob.GetPrim()).Bind(material)
    hinge = UsdPhysics.RevoluteJoint.Define(stage, "/kitchen/hinge")
    hinge.CreateBody0Rel().SetTargets([cabinet.GetPath()])
    hinge.CreateBody1Rel().SetTargets([door.GetPath()])
    hinge.CreateAxisAttr("Y")
    hinge.CreateLowerLimitAttr(0.0)
    hinge.CreateUpperLimitAttr(90.0)
    # In the cabinet's frame, which is scaled by two, and in the door's.
    hinge.CreateLocalPos0Attr(Gf.Vec3f(-10.0, 0.0, -15.0))
    hinge.CreateLocalPos1Attr(Gf.Vec3f(0.0, 0.0, -30.0))
    UsdGeom.BasisCurves.Define(stage, "/kitchen/cable")
    stage.GetRootLayer().Save()


def test_units_axes_scales_and_joints(tmp_path: Path) -> None:
    kitchen(tmp_path / "kitchen.usda")
    options = ("--as", "scene", "-o", tmp_path / "kitchen")
    report = imported(tmp_path / "kitchen.usda", *options, exit_code=3)
    assert [lost.split(":")[0] for lost in report["lost"]] == ["/kitchen/cable"]
    assert any("y was up" in repair for repair in report["repairs"])
    assert any("0.01 m" in repair for repair in report["repairs"])
    (placed,) = report["manifest"]["objects"]
    urdf = next((tmp_path / "kitchen").rglob(f"{placed['name']}*.urdf"))
    robot = yourdfpy.URDF.load(str(urdf))
    (hinge,) = robot.actuated_joints
    assert hinge.type == "revolute"
    assert hinge.limit.upper == pytest.approx(np.pi / 2)
    closed = robot.get_transform("door")
    closed_size = np.ptp(robot.scene.bounds, axis=0)
    robot.update_cfg([np.pi / 2])
    opened = robot.get_transform("door")
    # Turning about the vertical leaves the link's frame, which is at the hinge, in place.
    np.testing.assert_allclose(opened[:3, 3], closed[:3, 3], atol=1e-6)
    np.testing.assert_allclose((opened[:3, :3] @ closed[:3, :3].T)[2], [0, 0, 1], atol=1e-6)
    turned = np.arctan2(*(opened[:3, :3] @ closed[:3, :3].T)[[1, 0], 0])
    assert turned == pytest.approx(np.pi / 2)
    # The box is twice 0.2 m wide, the panel 0.6 m; opened, it stands square to the front.
    np.testing.assert_allclose(closed_size[1:], [0.6, 0.4], atol=1e-3)
    assert closed_size[0] < 0.5
    assert np.ptp(robot.scene.bounds, axis=0)[0] > 0.6
    (red,) = {path.read_text() for path in urdf.parent.rglob("*knob.mtl")}
    assert "Kd 1 0 0\n" in red


def test_an_oven_of_infinigen_is_replaced(tmp_path: Path) -> None:
    """Names and groups as Blender exports them: objects with a mesh below, in one group for all."""
    stage = Usd.Stage.CreateNew(str(tmp_path / "scene.usdc"))
    UsdGeom.SetStageMetersPerUnit(stage, 1.0)
    UsdGeom.SetStageUpAxis(stage, UsdGeom.Tokens.z)
    stage.SetDefaultPrim(UsdGeom.Xform.Define(stage, "/root").GetPrim())
    boxes = {
        "kitchen_0_0_floor": ([4.0, 4.0, 0.1], [0.0, 0.0, 0.25]),
        "OvenFactory_12_spawn_asset_3": ([0.6, 0.6, 0.8], [-1.6, 0.0, 0.7]),
    }
    for name, (size, place) in boxes.items():
        group = UsdGeom.Xform.Define(stage, f"/root/{name}")
        group.AddTranslateOp().Set(Gf.Vec3d(*place))
        box = UsdGeom.Cube.Define(stage, f"/root/{name}/Mesh_001")
        box.CreateSizeAttr(1.0)
        box.AddScaleOp().Set(Gf.Vec3f(*size))
    stage.GetRootLayer().Save()
    result = run("generate", "object", "oven", "--seed", 1, "-o", tmp_path / "objects" / "oven")
    assert result.returncode == 0, result.stderr
    command = ("import", "infinigen", tmp_path / "scene.usdc", "--objects", tmp_path / "objects")
    result = run(*command, "-o", tmp_path / "home", "--json")
    assert result.returncode == 0, result.stderr
    report = json.loads(result.stdout)
    (oven,) = report["manifest"]["objects"]
    assert oven["replaces"] == "OvenFactory_12_spawn_asset_3"
    (body,) = report["manifest"]["bodies"]
    assert body["class"] == "floor"
    assert any("by -0.3000 m along z" in repair for repair in report["repairs"])
    assert len(report["tasks"]) == 1


def test_what_cannot_be_read_is_refused(tmp_path: Path) -> None:
    assert "no such file" in refused("import", "usd", tmp_path / "none.usda", "-o", tmp_path / "o")
    broken = tmp_path / "broken.usda"
    broken.write_text("#usda 1.0\ndef Xform {")
    message = refused("import", "usd", broken, "-o", tmp_path / "o")
    assert "cannot be read as USD" in message


def test_without_usd_core_the_install_line_is_said(tmp_path: Path) -> None:
    stage = tmp_path / "empty.usda"
    stage.write_text("#usda 1.0\n")
    program = (
        "import sys; sys.modules['pxr'] = None; from akrobat.__main__ import main; "
        f"sys.argv = ['akrobat', 'import', 'usd', {str(stage)!r}, '-o', {str(tmp_path / 'o')!r}]; "
        "sys.exit(main())"
    )
    result = subprocess.run(
        [sys.executable, "-c", program], capture_output=True, text=True, check=False
    )
    assert result.returncode == 2, result.stderr
    assert "pip install 'akrobat[usd]'" in result.stderr
