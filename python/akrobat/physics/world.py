"""A task in PhysX: robot and object as articulations, the scene as static bodies."""

from __future__ import annotations

import warnings
from dataclasses import dataclass, field
from types import ModuleType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from akrobat import _core
from akrobat.errors import InputError, RunError
from akrobat.physics import poses
from akrobat.physics.config import PhysicsConfig
from akrobat.physics.passive import PassiveJoint, passive_joints
from akrobat.physics.shapes import Detail, convex_pieces, sample_surface

Vector = NDArray[np.float64]

# Collision groups of SAPIEN: a shape's first word says what it is, its second what it meets. Two
# shapes collide where one meets the other, unless their third words share a bit (shapes of one
# articulation: judged geometrically, and a convex piece of a door may overlap its frame).
SCENE, FLOOR, ROBOT, OBJECT = 1, 2, 4, 8
ROBOT_ITSELF, OBJECT_ITSELF = 1, 2

# What lies below this is floor, which the links of the base do not touch: its wheels roll on it.
FLOOR_TOP_M = 0.03

# Links without mass properties: as heavy as wood that fills their collision shapes.
DENSITY_KG_M3 = 500.0
EMPTY_LINK_MASS_KG = 0.1
EMPTY_LINK_INERTIA_KG_M2 = 1e-3

# Joints with limits do not wrap at a turn. SAPIEN 3.0.3 takes `continuous` for fixed; a hinge
# without limits is the same.
JOINT_TYPES = {
    "fixed": "fixed",
    "revolute": "revolute_unwrapped",
    "continuous": "revolute",
    "prismatic": "prismatic",
}

HANDLE_SAMPLES = 500


def require_sapien() -> ModuleType:
    """SAPIEN, whose complaint about a missing Vulkan library does not matter to physics."""
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            import coacd  # noqa: F401
            import sapien
            import scipy  # noqa: F401
    except ImportError as error:
        raise RunError(
            f"physics needs {error.name}: pip install 'akrobat[physics]', then the same command"
        ) from error
    return sapien


@dataclass
class ShapeErrors:
    """How well convex pieces stand for the meshes of one link."""

    link: str
    pieces: int = 0
    missing_m: float = 0.0
    protrusion_m: float = 0.0

    def add(self, pieces: int, missing_m: float, protrusion_m: float) -> None:
        """Takes another part of the link into account."""
        self.pieces += pieces
        self.missing_m = max(self.missing_m, missing_m)
        self.protrusion_m = max(self.protrusion_m, protrusion_m)


@dataclass
class Body:
    """An articulation with its joints by name."""

    description: dict[str, Any]
    articulation: Any
    joint: dict[str, Any]
    column: dict[str, int]
    """position of a joint in the articulation's own vector"""
    link: dict[str, Any] = field(default_factory=dict)


class World:
    """Robot, object and scene of a task in one PhysX scene."""

    def __init__(self, task: _core.Task, config: PhysicsConfig) -> None:
        self.sapien = require_sapien()
        self.config = config
        self.robot_description = task.robot()
        self.object_description = task.object()
        if self.object_description["kind"] != "articulated":
            kind = self.object_description["kind"]
            raise InputError(
                f"task {task.name}: its object is {kind}; physics drives articulated objects only"
            )
        self.shape_errors: list[ShapeErrors] = []
        self._pad = self._material(2.0 * config.pad_friction - config.surface_friction)
        self._surface = self._material(config.surface_friction)
        self.scene = self.sapien.Scene([_cpu_system(self.sapien.physx)])
        self.scene.set_timestep(config.timestep_s)
        self.system = self.scene.physx_system
        self._add_scene(task.scene())
        self.robot = self._add_robot()
        self.object = self._add_object()
        self.handle_points = _handle_points(self.object_description)
        self.passive: list[PassiveJoint] = passive_joints(self)

    # -- state -----------------------------------------------------------------------------------

    def reset(self, robot_row: dict[str, float], object_row: dict[str, float]) -> None:
        """Puts robot and object somewhere, at rest. Joints that mimic others follow them."""
        for body, row in ((self.robot, robot_row), (self.object, object_row)):
            positions = body.articulation.get_qpos()
            for name, value in row.items():
                positions[body.column[name]] = value
            for joint in body.description["joints"]:
                if joint["mimic"] and joint["mimic"][0] in row and joint["name"] not in row:
                    followed, multiplier, offset = joint["mimic"]
                    positions[body.column[joint["name"]]] = multiplier * row[followed] + offset
            body.articulation.set_qpos(positions)
            body.articulation.set_qvel(np.zeros_like(positions))

    def step(self) -> None:
        """One time step."""
        self._resist()
        self.scene.step()

    def _resist(self) -> None:
        """Viscous friction of the object's joints; dry friction is a drive that saturates."""
        velocity = self.object.articulation.get_qvel()
        force = np.zeros_like(velocity)
        for joint in self.passive:
            column = self.object.column[joint.name]
            force[column] = -joint.damping * velocity[column]
        self.object.articulation.set_qf(force)

    def tool_pose(self) -> Vector:
        """`world_from_tool`"""
        link = self.robot.link[self.robot_description["tool_link"]]
        return poses.compose(as_array(link.entity_pose), self.robot_description["link_from_tool"])

    def handle_link_pose(self) -> Vector:
        """`world_from_handle_link`"""
        return as_array(self.object.link[self.object_description["handle_link"]].entity_pose)

    def handle_distance_m(self) -> float:
        """From the tool frame's origin to the nearest point of the handle's surface."""
        tool_in_link = poses.transform(poses.inverse(self.handle_link_pose()), self.tool_pose()[:3])
        return float(np.linalg.norm(self.handle_points - tool_in_link, axis=1).min())

    # -- construction ----------------------------------------------------------------------------

    def _material(self, friction: float) -> Any:
        return self.sapien.physx.PhysxMaterial(friction, friction, 0.0)

    def _add_scene(self, bodies: list[dict[str, Any]]) -> None:
        physx = self.sapien.physx
        for body in bodies:
            component = physx.PhysxRigidStaticComponent()
            top = max((_top(body, part) for part in body["collisions"]), default=0.0)
            kind = FLOOR if top <= FLOOR_TOP_M else SCENE
            for part in body["collisions"]:
                shape = self._static_shape(part)
                shape.set_collision_groups([kind, 0, 0, 0])
                component.attach(shape)
            entity = self.sapien.Entity()
            entity.name = body["name"]
            entity.add_component(component)
            entity.set_pose(self._pose(body["world_from_body"]))
            self.scene.add_entity(entity)

    def _static_shape(self, part: dict[str, Any]) -> Any:
        physx = self.sapien.physx
        if part["kind"] == "box":
            shape = physx.PhysxCollisionShapeBox(_float32(part["size"]) / 2, self._surface)
        else:
            shape = physx.PhysxCollisionShapeTriangleMesh(
                part["positions"], part["triangles"], np.ones(3, np.float32), self._surface
            )
        shape.set_local_pose(self._pose(part["link_from_part"]))
        return shape

    def _add_robot(self) -> Body:
        description = self.robot_description
        fingers = set(description["finger_links"])
        base = _links_of_base(description)

        def attach(link: dict[str, Any], component: Any, errors: ShapeErrors) -> None:
            material = self._pad if link["name"] in fingers else self._surface
            meets = SCENE | OBJECT | (0 if link["name"] in base else FLOOR)
            groups = [ROBOT, meets, ROBOT_ITSELF, 0]
            detail = Detail.FINE if link["name"] in fingers else Detail.HULL
            for part in link["collisions"]:
                self._attach(component, part, material, groups, errors, detail=detail)

        body = self._articulation(description, attach)
        for link in body.articulation.links:
            # The arm's controller compensates gravity, as those of real arms do.
            link.set_disable_gravity(True)
        body.articulation.set_solver_position_iterations(16)
        positions = body.articulation.get_qpos()
        for name, value in rest_positions(description).items():
            positions[body.column[name]] = value
        body.articulation.set_qpos(positions)
        return body

    def _add_object(self) -> Body:
        description = self.object_description
        still = _rigid_with_root(description)

        def attach(link: dict[str, Any], component: Any, errors: ShapeErrors) -> None:
            # What does not move may well stand against walls.
            groups = [OBJECT, 0 if link["name"] in still else SCENE | FLOOR, OBJECT_ITSELF, 0]
            held = link["name"] == description["handle_link"]
            detail = Detail.FINE if held else Detail.COARSE
            for part in link["collisions"] or link["visuals"]:
                self._attach(component, part, self._surface, groups, errors, detail=detail)

        body = self._articulation(description, attach)
        body.articulation.set_solver_position_iterations(16)
        positions = body.articulation.get_qpos()
        for name, value in zip(description["dof_joints"], description["start"], strict=True):
            positions[body.column[name]] = value
        body.articulation.set_qpos(positions)
        body.articulation.set_root_pose(self.object_root_pose())
        return body

    def object_root_pose(self) -> Any:
        """Where the object stands, with the offset that a trial may ask for."""
        pose = np.array(self.object_description["world_from_root"], float)
        pose[:3] += self.config.object_offset_m
        return self._pose(pose)

    def _attach(
        self,
        component: Any,
        part: dict[str, Any],
        material: Any,
        groups: list[int],
        errors: ShapeErrors,
        *,
        detail: Detail,
    ) -> None:
        physx = self.sapien.physx
        for shape in self._dynamic_shapes(physx, part, material, errors, detail):
            shape.set_collision_groups(groups)
            shape.set_density(DENSITY_KG_M3)
            shape.set_contact_offset(0.005)
            component.attach(shape)

    def _dynamic_shapes(
        self, physx: Any, part: dict[str, Any], material: Any, errors: ShapeErrors, detail: Detail
    ) -> list[Any]:
        pose = self._pose(part["link_from_part"])
        if part["kind"] == "box":
            shapes = [physx.PhysxCollisionShapeBox(_float32(part["size"]) / 2, material)]
        elif part["kind"] == "sphere":
            shapes = [physx.PhysxCollisionShapeSphere(part["size"][0], material)]
        else:
            convex = convex_pieces(part["positions"], part["triangles"], detail)
            errors.add(len(convex.pieces), convex.missing_m, convex.protrusion_m)
            shapes = [
                physx.PhysxCollisionShapeConvexMesh(piece, np.ones(3, np.float32), material)
                for piece in convex.pieces
            ]
        for shape in shapes:
            shape.set_local_pose(pose)
        return shapes

    def _articulation(self, description: dict[str, Any], attach: Any) -> Body:
        physx = self.sapien.physx
        incoming = {joint["child"]: joint for joint in description["joints"]}
        links = {link["name"]: link for link in description["links"]}
        order = [description["root"], *(joint["child"] for joint in description["joints"])]
        components: dict[str, Any] = {}
        entities = []
        for name in order:
            joint = incoming.get(name)
            component = physx.PhysxArticulationLinkComponent(
                components[joint["parent"]] if joint else None
            )
            errors = ShapeErrors(name)
            attach(links[name], component, errors)
            if errors.pieces:
                self.shape_errors.append(errors)
            _set_mass(self.sapien, component, links[name]["inertial"])
            component.name = name
            self._set_joint(component.joint, joint)
            entity = self.sapien.Entity()
            entity.name = name
            entity.add_component(component)
            components[name] = component
            entities.append(entity)
        entities[0].set_pose(self._pose(description["world_from_root"]))
        for entity in entities:
            self.scene.add_entity(entity)
        articulation = components[description["root"]].articulation
        active = articulation.get_active_joints()
        return Body(
            description,
            articulation,
            {joint.name: joint for joint in active},
            {joint.name: column for column, joint in enumerate(active)},
            components,
        )

    def _set_joint(self, joint: Any, description: dict[str, Any] | None) -> None:
        if description is None:
            joint.type = "fixed"
            return
        joint.name = description["name"]
        kind = description["kind"]
        joint.type = JOINT_TYPES[kind]
        # PhysX joints turn about, or slide along, x.
        joint_from_physx = np.concatenate(
            [np.zeros(3), poses.rotation_from_x_to(description["axis"])]
        )
        joint.pose_in_parent = self._pose(
            poses.compose(description["parent_from_joint"], joint_from_physx)
        )
        joint.pose_in_child = self._pose(joint_from_physx)
        if kind != "fixed":
            joint.limit = _float32(description["limits"]).reshape(1, 2)
        joint.set_friction(0.0)

    def _pose(self, pose: Any) -> Any:
        values = _float32(pose)
        return self.sapien.Pose(values[:3], values[3:])


def _cpu_system(physx: Any) -> Any:
    """A PhysX system without persistent contact manifolds: on slender pieces such as a knob's stem,
    those at times took an edge for the face that is pressed, and shot the hand away."""
    before, ours = physx.get_scene_config(), physx.PhysxSceneConfig()
    ours.enable_pcm = False
    ours.enable_enhanced_determinism = True
    physx.set_scene_config(ours)
    try:
        return physx.PhysxCpuSystem()
    finally:
        physx.set_scene_config(before)


def rest_positions(robot: dict[str, Any]) -> dict[str, float]:
    """Positions at rest of all the robot's movable joints, those that follow others included."""
    rest: dict[str, float] = dict(zip(robot["dof_joints"], robot["rest"], strict=True))
    for joint in robot["joints"]:
        if joint["mimic"]:
            followed, multiplier, offset = joint["mimic"]
            rest[joint["name"]] = multiplier * rest[followed] + offset
    return rest


def as_array(pose: Any) -> Vector:
    """A pose of SAPIEN as `[x y z qw qx qy qz]`."""
    return np.concatenate([pose.p, pose.q]).astype(float)


def _float32(values: Any) -> NDArray[np.float32]:
    return np.asarray(values, np.float32)


def _top(body: dict[str, Any], part: dict[str, Any]) -> float:
    world_from_part = poses.compose(body["world_from_body"], part["link_from_part"])
    return float(poses.transform(world_from_part, part["positions"])[:, 2].max(initial=-np.inf))


def _links_of_base(robot: dict[str, Any]) -> set[str]:
    """Links that neither arm nor fingers move: a mobile base, its wheels and what it carries."""
    if not robot["base_joints"]:
        return set()
    moving = {*robot["arm_joints"], *robot["gripper_joints"]}
    carried = {robot["root"]}
    for joint in robot["joints"]:
        if joint["parent"] in carried and joint["name"] not in moving:
            carried.add(joint["child"])
    return carried


def _rigid_with_root(tree: dict[str, Any]) -> set[str]:
    """Links that no joint moves."""
    rigid = {tree["root"]}
    for joint in tree["joints"]:
        if joint["kind"] == "fixed" and joint["parent"] in rigid:
            rigid.add(joint["child"])
    return rigid


def _set_mass(sapien: ModuleType, component: Any, inertial: dict[str, Any] | None) -> None:
    if inertial is not None and inertial["mass_kg"] > 0.0:
        ixx, ixy, ixz, iyy, iyz, izz = inertial["inertia_kg_m2"]
        matrix = np.array([[ixx, ixy, ixz], [ixy, iyy, iyz], [ixz, iyz, izz]])
        moments, axes = np.linalg.eigh(matrix)
        if np.linalg.det(axes) < 0.0:
            axes[:, 0] *= -1.0
        frame = np.eye(4, dtype=np.float32)
        frame[:3, :3] = axes
        principal = as_array(sapien.Pose(frame))
        link_from_principal = poses.compose(inertial["link_from_inertia"], principal)
        component.mass = inertial["mass_kg"]
        component.cmass_local_pose = sapien.Pose(
            _float32(link_from_principal[:3]), _float32(link_from_principal[3:])
        )
        component.inertia = _float32(np.maximum(moments, 1e-7))
    elif not component.collision_shapes:
        component.mass = EMPTY_LINK_MASS_KG
        component.cmass_local_pose = sapien.Pose()
        component.inertia = np.full(3, EMPTY_LINK_INERTIA_KG_M2, np.float32)


def _handle_points(description: dict[str, Any]) -> Vector:
    """Points on the handle's surface in the held link's frame `[N, 3]`."""
    link = next(li for li in description["links"] if li["name"] == description["handle_link"])
    parts = [part for part in link["visuals"] if part["handle"]]
    parts = parts or [part for part in link["collisions"] if part["handle"]]
    rng = np.random.default_rng(0)
    points = np.concatenate(
        [
            poses.transform(
                part["link_from_part"],
                sample_surface(part["positions"], part["triangles"], 40 * HANDLE_SAMPLES, rng),
            )
            for part in parts
        ]
    )
    if (region := description["handle_region"]) is not None:
        inside = np.all((points >= region[:3]) & (points <= region[3:]), axis=1)
        points = points[inside]
    return points[:: max(len(points) // HANDLE_SAMPLES, 1)]
