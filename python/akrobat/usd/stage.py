"""A USD stage as URDF."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np
from numpy.typing import NDArray
from pxr import Usd, UsdGeom, UsdPhysics, UsdShade

from akrobat.usd.shapes import triangles_of, write_obj

Matrix = NDArray[np.float64]

#: Effort (N, N m) and speed (m/s, rad/s) of joints, for which the physics schema has no limits.
EFFORT, SPEED = "100", "2"


@dataclass
class PlacedJoint:
    """A joint that becomes one of the URDF."""

    prim: Any
    kind: str
    #: Paths of bodies; empty where the joint hangs from the world.
    parent: str
    child: str
    #: In the frame of the parent body, or of the stage; metres.
    parent_from_joint: Matrix


class Converter:
    """Turns one stage into one URDF."""

    def __init__(self, stage: Any, folder: Path) -> None:
        self.folder = folder
        self.metres = float(UsdGeom.GetStageMetersPerUnit(stage))
        self.repairs: list[str] = []
        self.lost: list[str] = []
        self.robot = ElementTree.Element("robot", name="scene")
        self.names: dict[str, str] = {}
        #: Links of bodies and components by their prim's path.
        self.links: dict[str, ElementTree.Element] = {}
        #: Pose of a link in its body's frame: a URDF's link stands where its joint is.
        self.body_from_link: dict[str, Matrix] = {}
        prims = Usd.PrimRange(stage.GetPseudoRoot(), Usd.TraverseInstanceProxies())
        self.prims = list(prims)
        self.default = stage.GetDefaultPrim()
        self.bodies = {str(p.GetPath()): p for p in self.prims if p.HasAPI(UsdPhysics.RigidBodyAPI)}
        self.world_from_stage = np.eye(4)
        if UsdGeom.GetStageUpAxis(stage) == UsdGeom.Tokens.y:
            self.world_from_stage[:3, :3] = [[1, 0, 0], [0, 0, -1], [0, 1, 0]]
            self.repairs.append("y was up: turned so that z is")
        if self.metres != 1.0:
            self.repairs.append(f"lengths were units of {self.metres:g} m: they are metres")

    def convert(self) -> tuple[str, list[str], list[str]]:
        (self.folder / "meshes").mkdir(parents=True, exist_ok=True)
        ElementTree.SubElement(self.robot, "link", name="world")
        joints = self._placed_joints()
        held = {joint.child for joint in joints}
        for path, prim in self.bodies.items():
            name = self._name(path)
            self.links[path] = ElementTree.SubElement(self.robot, "link", name=name)
            if path not in held:
                self._joint(f"{path}_place", "fixed", "world", name, self._world_from_body(prim))
        for joint in joints:
            self._write(joint)
        for prim in self.prims:
            if prim.IsA(UsdGeom.Gprim):
                self._shape(prim)
            elif prim.IsA(UsdGeom.PointInstancer):
                self.lost.append(f"{prim.GetPath()}: point instancers are not read")
        ElementTree.indent(self.robot)
        path = self.folder / "scene.urdf"
        ElementTree.ElementTree(self.robot).write(path)
        return str(path), self.repairs, self.lost

    def _name(self, path: str) -> str:
        """A unique name: the prim's own where it is free, else with what is above it."""
        if path not in self.names:
            parts = path.strip("/").split("/")
            taken = {*self.names.values(), "world"}
            choices = ["_".join(parts[-n:]) for n in range(1, len(parts) + 1)]
            self.names[path] = next((c for c in choices if c not in taken), path)
        return self.names[path]

    def _world_from_body(self, prim: Any) -> Matrix:
        """A body's pose in metres, without its scale."""
        pose = _rigid(_stage_from(prim))
        pose[:3, 3] *= self.metres
        return self.world_from_stage @ pose

    def _placed_joints(self) -> list[PlacedJoint]:
        kinds = {
            UsdPhysics.RevoluteJoint: "revolute",
            UsdPhysics.PrismaticJoint: "prismatic",
            UsdPhysics.FixedJoint: "fixed",
        }
        placed: dict[str, PlacedJoint] = {}
        for prim in self.prims:
            if not prim.IsA(UsdPhysics.Joint):
                continue
            kind = next((name for schema, name in kinds.items() if prim.IsA(schema)), None)
            joint = UsdPhysics.Joint(prim)
            targets = [rel.GetTargets() for rel in (joint.GetBody0Rel(), joint.GetBody1Rel())]
            parent, child = (str(found[0]) if found else "" for found in targets)
            frames = [
                self._joint_frame(parent, joint.GetLocalPos0Attr(), joint.GetLocalRot0Attr()),
                self._joint_frame(child, joint.GetLocalPos1Attr(), joint.GetLocalRot1Attr()),
            ]
            if child not in self.bodies and parent in self.bodies:
                parent, child, frames = child, parent, frames[::-1]
                self.repairs.append(f"joint {prim.GetPath()}: its bodies are exchanged")
            parent = parent if parent in self.bodies else ""
            reason = None
            if kind is None:
                reason = f"{prim.GetTypeName()} is none of revolute, prismatic and fixed"
            elif child not in self.bodies:
                reason = "it holds no rigid body"
            elif child in placed or self._is_below(parent, child, placed):
                reason = "it closes a loop"
            if reason is None and kind is not None:
                placed[child] = PlacedJoint(prim, kind, parent, child, frames[0])
                self.body_from_link[child] = frames[1]
            else:
                self.lost.append(f"joint {prim.GetPath()}: {reason}")
        return list(placed.values())

    def _is_below(self, body: str, top: str, placed: dict[str, PlacedJoint]) -> bool:
        while body and body != top:
            body = placed[body].parent if body in placed else ""
        return body == top and bool(top)

    def _joint_frame(self, body: str, place: Any, turn: Any) -> Matrix:
        """The joint's pose in a body's frame in metres: the schema states it in the scaled one."""
        pose = _pose(place.Get(), turn.Get())
        if body in self.bodies:
            pose[:3, 3] *= np.linalg.norm(_stage_from(self.bodies[body])[:3, :3], axis=0)
        pose[:3, 3] *= self.metres
        return pose

    def _write(self, joint: PlacedJoint) -> None:
        if joint.parent:
            link_from_body = np.linalg.inv(self.body_from_link.get(joint.parent, np.eye(4)))
            parent, pose = self._name(joint.parent), link_from_body @ joint.parent_from_joint
        else:
            parent, pose = "world", self.world_from_stage @ joint.parent_from_joint
        path = str(joint.prim.GetPath())
        element = self._joint(path, joint.kind, parent, self._name(joint.child), pose)
        if joint.kind != "fixed":
            self._motion(element, joint)

    def _motion(self, element: ElementTree.Element, joint: PlacedJoint) -> None:
        turns = joint.kind == "revolute"
        schema = UsdPhysics.RevoluteJoint if turns else UsdPhysics.PrismaticJoint
        moving = schema(joint.prim)
        axis = {"X": "1 0 0", "Y": "0 1 0", "Z": "0 0 1"}[str(moving.GetAxisAttr().Get())]
        ElementTree.SubElement(element, "axis", xyz=axis)
        unit = np.pi / 180.0 if turns else self.metres
        ends = [moving.GetLowerLimitAttr().Get(), moving.GetUpperLimitAttr().Get()]
        if all(end is not None and np.isfinite(end) for end in ends):
            low, high = (repr(float(end) * unit) for end in ends)
            ElementTree.SubElement(
                element, "limit", lower=low, upper=high, effort=EFFORT, velocity=SPEED
            )
        elif turns:
            element.set("type", "continuous")
        else:
            self.lost.append(f"joint {joint.prim.GetPath()}: it slides without end, and is fixed")
            element.set("type", "fixed")

    def _joint(
        self, path: str, kind: str, parent: str, child: str, pose: Matrix
    ) -> ElementTree.Element:
        name = self._name(path)
        element = ElementTree.SubElement(self.robot, "joint", name=name, type=kind)
        ElementTree.SubElement(element, "parent", link=parent)
        ElementTree.SubElement(element, "child", link=child)
        words = [" ".join(repr(float(v)) for v in row) for row in (pose[:3, 3], _rpy(pose))]
        ElementTree.SubElement(element, "origin", xyz=words[0], rpy=words[1])
        return element

    def _shape(self, prim: Any) -> None:
        path = str(prim.GetPath())
        imageable = UsdGeom.Imageable(prim)
        if imageable.ComputeVisibility() == UsdGeom.Tokens.invisible:
            self.repairs.append(f"{path}: not visible, left out")
            return
        mesh = triangles_of(prim)
        if mesh is None or not len(mesh[1]):
            what = f"shapes of type {prim.GetTypeName()} are not read" if mesh is None else "empty"
            self.lost.append(f"{path}: {what}")
            return
        owner = self._owner(prim)
        stage_from_prim = _stage_from(prim)
        stage_points = mesh[0] @ stage_from_prim[:3, :3].T + stage_from_prim[:3, 3]
        world_points = self.metres * stage_points @ self.world_from_stage[:3, :3].T
        link_from_world = np.linalg.inv(self._world_from_link(owner))
        points = world_points @ link_from_world[:3, :3].T + link_from_world[:3, 3]
        # A mirror turns the triangles inside out.
        mirrored = np.linalg.det(stage_from_prim[:3, :3]) < 0
        name = self._name(path)
        file = f"meshes/{name}.obj"
        write_obj(self.folder / file, points, mesh[1][:, ::-1] if mirrored else mesh[1])
        purpose = imageable.ComputePurpose()
        tags = ["collision"] if purpose == UsdGeom.Tokens.guide else ["visual", "collision"]
        for tag in tags:
            element = ElementTree.SubElement(self._link(owner), tag, name=prim.GetName())
            geometry = ElementTree.SubElement(element, "geometry")
            ElementTree.SubElement(geometry, "mesh", filename=file)
            if tag == "visual":
                material = ElementTree.SubElement(element, "material", name=f"{name}_color")
                rgba = " ".join(f"{value:.4f}" for value in [*_srgb(_color(prim)), 1.0])
                ElementTree.SubElement(material, "color", rgba=rgba)

    def _owner(self, prim: Any) -> Any:
        """What a shape belongs to: the body above it, else the component, else the group of nothing
        but shapes that exporters of meshes make of an object, else itself."""
        above = prim
        while above and str(above.GetPath()) not in self.bodies:
            above = above.GetParent()
        if above:
            return above
        above = prim
        while above and Usd.ModelAPI(above).GetKind() != "component":
            above = above.GetParent()
        if above:
            return above
        group = prim.GetParent()
        is_group = group.IsA(UsdGeom.Xform) and group != self.default
        return group if is_group and _holds_shapes_alone(group) else prim

    def _world_from_link(self, owner: Any) -> Matrix:
        path = str(owner.GetPath())
        return self._world_from_body(owner) @ self.body_from_link.get(path, np.eye(4))

    def _link(self, owner: Any) -> ElementTree.Element:
        path = str(owner.GetPath())
        if path not in self.links:
            name = self._name(path)
            self.links[path] = ElementTree.SubElement(self.robot, "link", name=name)
            self._joint(f"{path}_place", "fixed", "world", name, self._world_from_body(owner))
        return self.links[path]


def _holds_shapes_alone(group: Any) -> bool:
    return all(child.IsA(UsdGeom.Gprim) for child in group.GetChildren() if _is_drawn(child))


def _is_drawn(prim: Any) -> bool:
    return bool(prim.IsA(UsdGeom.Xformable)) and not prim.IsA(UsdGeom.Camera)


def _stage_from(prim: Any) -> Matrix:
    """The prim's frame in the stage's, in its units; USD's vectors are rows."""
    placed = UsdGeom.Xformable(prim).ComputeLocalToWorldTransform(Usd.TimeCode.Default())
    return np.array(placed, dtype=float).T


def _rigid(matrix: Matrix) -> Matrix:
    """The rotation next to a matrix that scales, and its translation."""
    left, _, right = np.linalg.svd(matrix[:3, :3])
    pose = np.eye(4)
    pose[:3, :3] = left @ np.diag([1.0, 1.0, np.sign(np.linalg.det(left @ right))]) @ right
    pose[:3, 3] = matrix[:3, 3]
    return pose


def _pose(place: Any, turn: Any) -> Matrix:
    """A matrix of a place and a quaternion of USD's types."""
    pose = np.eye(4)
    if turn is not None:
        w, v = turn.GetReal(), np.array(turn.GetImaginary(), dtype=float)
        norm = np.sqrt(w * w + v @ v) or 1.0
        w, (x, y, z) = w / norm, v / norm
        cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
        pose[:3, :3] += 2.0 * (w * cross + cross @ cross)
    if place is not None:
        pose[:3, 3] = [float(value) for value in place]
    return pose


def _rpy(pose: Matrix) -> tuple[float, float, float]:
    """URDF's angles: about the fixed x, then y, then z axis, rad."""
    turn = pose[:3, :3]
    pitch = float(np.arctan2(-turn[2, 0], np.hypot(turn[0, 0], turn[1, 0])))
    if abs(np.cos(pitch)) > 1e-9:
        return (
            float(np.arctan2(turn[2, 1], turn[2, 2])),
            pitch,
            float(np.arctan2(turn[1, 0], turn[0, 0])),
        )
    return 0.0, pitch, float(np.arctan2(-turn[0, 1], turn[1, 1]))


def _color(prim: Any) -> list[float]:
    """Linear RGB of the bound preview surface, else of the display colour, else a light grey."""
    material, _ = UsdShade.MaterialBindingAPI(prim).ComputeBoundMaterial()
    if material:
        surface, _, _ = material.ComputeSurfaceSource()
        diffuse = surface.GetInput("diffuseColor") if surface else None
        if diffuse and diffuse.Get() is not None:
            return [float(value) for value in diffuse.Get()]
    shown = UsdGeom.Gprim(prim).GetDisplayColorPrimvar().Get()
    return [float(value) for value in shown[0]] if shown else [0.5, 0.5, 0.5]


def _srgb(linear: list[float]) -> list[float]:
    """URDF's colours are encoded for screens (IEC 61966-2-1)."""
    return [
        12.92 * c if c <= 0.0031308 else 1.055 * c ** (1 / 2.4) - 0.055
        for c in (min(max(value, 0.0), 1.0) for value in linear)
    ]
