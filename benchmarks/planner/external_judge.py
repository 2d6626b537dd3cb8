"""Judges a trajectory file with Pinocchio, coal and trimesh, sharing no code with the project.

    python benchmarks/planner/external_judge.py drawer.h5 --assets DIR [--json]

From the file it takes the samples, the grasps and the text of the task; robot, object and scene are
read from their own files. A trajectory is refused for the first of:

- `anchor`: while it is held, the tool leaves its place on the handle by over 1 mm or 0.01 rad
- `position_limit`, `velocity_limit`: a robot joint beyond the URDF's limits
- `object_motion`: the object moves unheld, or misses start or goal by 1 % of the travel
- `collision`: meshes enter one another by over 5 mm: the robot the object, the scene or itself
  (convex hulls of the robot's collision meshes against the triangles of everything else)

Needs `pin` (which brings coal), trimesh, h5py and, before Python 3.11, tomli. Robots with a gripper
from a URDF of its own are not supported. Exit code 1 where a trajectory is refused.
"""

from __future__ import annotations

import argparse
import json
import sys
import xml.etree.ElementTree as ET
from dataclasses import asdict, dataclass
from fnmatch import fnmatchcase
from pathlib import Path

import coal
import h5py
import numpy as np
import pinocchio as pin
import trimesh

try:
    import tomllib
except ModuleNotFoundError:  # Python 3.10
    import tomli as tomllib

ANCHOR_M = 1e-3
ANCHOR_RAD = 0.01
LIMIT_TOLERANCE = 1e-4
RATE_TOLERANCE = 0.01
TRAVEL_TOLERANCE = 0.01
PENETRATION_M = 5e-3
WALL_M = 0.1
# Contacts of one pair whose depths are looked at.
MOST_CONTACTS = 256
# Phases in which the tool holds the handle.
HELD = {"manipulate"}


@dataclass
class Candidate:
    """A path to be judged: rows of robot and object joints, as the file orders them."""

    id: str
    robot: np.ndarray
    object: np.ndarray
    times: np.ndarray
    phases: list[str]
    # The tool in the held link, `x y z qw qx qy qz`.
    grasp: np.ndarray
    # The driven joint's position before and after.
    start: float
    goal: float


@dataclass
class Finding:
    """What was found on one trajectory: the worst of every check."""

    id: str
    refused: str | None = None
    detail: str = ""
    anchor_m: float = 0.0
    anchor_rad: float = 0.0
    velocity_fraction: float = 0.0
    configurations: int = 0

    def refuse(self, reason: str, detail: str) -> None:
        """Keeps the first reason."""
        if self.refused is None:
            self.refused, self.detail = reason, detail


class Search:
    """Finds files beside the one that names them, else in the asset folders."""

    def __init__(self, folders: list[Path]):
        self.folders = folders

    def find(self, name: str, beside: Path) -> Path:
        """The file `name`, which a file in the folder `beside` names."""
        tried = [folder / name for folder in [beside, *self.folders]]
        for path in tried:
            if path.is_file():
                return path.resolve()
        raise SystemExit(f"{name} not found; tried: {', '.join(map(str, tried))}")

    def mesh(self, uri: str, urdf: Path) -> Path:
        """A mesh of a URDF; `package://` paths are looked up above it, without the package."""
        if uri.startswith("package://"):
            _, rest = uri.removeprefix("package://").split("/", 1)
            for folder in urdf.parents:
                if (folder / rest).is_file():
                    return folder / rest
            return self.find(uri.removeprefix("package://"), urdf.parent)
        return self.find(uri.removeprefix("file://"), urdf.parent)


def pose(values) -> pin.SE3:
    """`x y z qw qx qy qz` as a transform."""
    x, y, z, w, i, j, k = map(float, values)
    return pin.SE3(pin.Quaternion(w, i, j, k).normalized().matrix(), np.array([x, y, z]))


def numbers(text: str | None, default: str = "0 0 0") -> np.ndarray:
    return np.array([float(v) for v in (text or default).split()])


def triangles(mesh: trimesh.Trimesh) -> coal.BVHModelOBBRSS:
    """All triangles of a mesh, as they are."""
    model = coal.BVHModelOBBRSS()
    model.beginModel(len(mesh.faces), len(mesh.vertices))
    model.addVertices(np.asarray(mesh.vertices, dtype=float))
    model.addTriangles(np.asarray(mesh.faces, dtype=np.int64))
    model.endModel()
    return model


def hull(mesh: trimesh.Trimesh):
    """The convex hull of a mesh."""
    model = triangles(mesh)
    model.buildConvexHull(False, "Qt")
    return model.convex


def load_mesh(path: Path, scale: np.ndarray) -> trimesh.Trimesh:
    mesh = trimesh.load(path, force="mesh", process=False)
    return trimesh.Trimesh(mesh.vertices * scale, mesh.faces, process=False)


def link_shapes(urdf: Path, search: Search, convex: bool):
    """Link name, part name, pose in the link and geometry of everything that collides."""
    for link in ET.parse(urdf).getroot().findall("link"):
        parts = link.findall("collision") or link.findall("visual")
        for number, part in enumerate(parts):
            origin = part.find("origin")
            origin = {} if origin is None else origin.attrib
            place = pin.SE3(
                pin.rpy.rpyToMatrix(numbers(origin.get("rpy"))), numbers(origin.get("xyz"))
            )
            shape = part.find("geometry")[0]
            name = part.get("name") or f"{link.get('name')}_{number}"
            if shape.tag == "mesh":
                path = search.mesh(shape.get("filename"), urdf)
                mesh = load_mesh(path, numbers(shape.get("scale"), "1 1 1"))
                name = path.stem
                geometry = hull(mesh) if convex else triangles(mesh)
            elif shape.tag == "box":
                geometry = coal.Box(*numbers(shape.get("size")))
            elif shape.tag == "cylinder":
                geometry = coal.Cylinder(float(shape.get("radius")), float(shape.get("length")))
            else:
                geometry = coal.Sphere(float(shape.get("radius")))
            yield link.get("name"), name, place, geometry


def kinematics(urdf: Path) -> pin.Model:
    """Kinematics of a URDF without what strict readers refuse: inertias, incomplete limits."""
    root = ET.parse(urdf).getroot()
    for link in root.findall("link"):
        for tag in ("inertial", "visual", "collision"):
            for element in link.findall(tag):
                link.remove(element)
    for limit in root.iter("limit"):
        limit.attrib.setdefault("effort", "1e9")
        limit.attrib.setdefault("velocity", "1e9")
    return pin.buildModelFromXML(ET.tostring(root, encoding="unicode"))


def scene_bodies(section: dict, search: Search, folder: Path):
    """Name, pose and geometry of what rests. The floor is left out: the base stands on it."""
    if "file" in section:
        path = search.find(section["file"], folder)
        if path.suffix not in (".glb", ".gltf"):
            raise SystemExit(f"{path}: only glTF scenes are known")
        scene = trimesh.load(path, force="scene", process=False)
        up = trimesh.transformations.rotation_matrix(np.pi / 2, [1, 0, 0])
        bodies = []
        for node in scene.graph.nodes_geometry:
            transform, name = scene.graph[node]
            mesh = scene.geometry[name].copy()
            mesh.apply_transform(up @ transform)
            bodies.append((node, mesh))
        dx, dy = section.get("offset", (0, 0))
        floors = [m for n, m in bodies if fnmatchcase(n, section.get("floor", ""))]
        drop = max((m.bounds[1, 2] for m in floors), default=0.0)
        for name, mesh in bodies:
            removed = any(fnmatchcase(name, pattern) for pattern in section.get("remove", []))
            if not removed and "floor" not in name.lower():
                mesh.apply_translation([dx, dy, -drop])
                yield name, pin.SE3.Identity(), triangles(mesh)
    for box in section.get("box", []):
        yield box["name"], pose(box["pose"]), coal.Box(*map(float, box["size"]))
    if "room" in section:
        x, y, z = section["room"]
        for side in (-1, 1):
            at = pin.SE3(np.eye(3), np.array([side * (x + WALL_M) / 2, 0, z / 2]))
            yield f"wall_x_{side}", at, coal.Box(WALL_M, y, z)
            at = pin.SE3(np.eye(3), np.array([0, side * (y + WALL_M) / 2, z / 2]))
            yield f"wall_y_{side}", at, coal.Box(x, WALL_M, z)


class Judge:
    """Robot, object and scene of one task."""

    def __init__(self, task: dict, folder: Path, search: Search):
        robot_file = search.find(task["robot"]["file"], folder)
        self.robot = tomllib.loads(robot_file.read_text())
        if "attach" in self.robot["gripper"]:
            raise SystemExit(f"{robot_file}: grippers of their own are not supported")
        robot_urdf = search.find(self.robot["urdf"], robot_file.parent)
        object_urdf = search.find(task["object"]["urdf"], folder)
        self.task = task
        self.handle = task["object"]["handle"]["link"]
        self.scale = task["object"].get("scale", 1.0)
        if self.scale != 1.0:
            raise SystemExit("scaled objects are not supported")
        self.robot_model, self.object_model = kinematics(robot_urdf), kinematics(object_urdf)
        self.robot_data = self.robot_model.createData()
        self.object_data = self.object_model.createData()
        self.world_from_object = pose(task["object"]["pose"])
        self.geometry = pin.GeometryModel()
        self.bodies: list[tuple[str, int, pin.SE3, str]] = []
        for link, part, place, shape in link_shapes(robot_urdf, search, convex=True):
            self.add(self.robot_model, ("robot", link, part), place, shape)
        for link, part, place, shape in link_shapes(object_urdf, search, convex=False):
            self.add(self.object_model, ("object", link, part), place, shape)
        for name, place, shape in scene_bodies(task.get("scene", {}), search, folder):
            self.bodies.append(("scene", 0, place, name))
            self.geometry.addGeometryObject(pin.GeometryObject(f"scene/{name}", 0, place, shape))
        self.geometry_data: pin.GeometryData | None = None

    def add(self, model: pin.Model, names: tuple[str, str, str], place: pin.SE3, shape) -> None:
        """Adds a part: its owner, link and own name."""
        owner, link, part = names
        frame = model.getFrameId(link)
        name = f"{owner}/{link}/{part}/{len(self.bodies)}"
        self.bodies.append((owner, frame, place, link))
        self.geometry.addGeometryObject(pin.GeometryObject(name, 0, place, shape))

    def choose_pairs(self, exceptions: list[dict], rest: np.ndarray, object_rest: np.ndarray):
        """The robot against everything but what the grasp's fingers may touch, neighbours, the
        pairs of the robot file and what touches at rest."""
        ignored = {frozenset(pair) for pair in self.robot.get("self_collision_ignore", [])}
        may_touch = {(e["robot_link"], e["object_link"], e["object_part"]) for e in exceptions}
        robots = [i for i, b in enumerate(self.bodies) if b[0] == "robot"]
        for i in robots:
            link = self.bodies[i][3]
            for j, (owner, _, _, other) in enumerate(self.bodies):
                if owner == "robot":
                    neighbours = self.moving_joints_between(link, other) <= 1
                    fingers = {link, other} <= set(self.robot["gripper"]["finger_links"])
                    skip = i >= j or neighbours or fingers or frozenset((link, other)) in ignored
                elif owner == "object":
                    part = self.geometry.geometryObjects[j].name.split("/")[2]
                    skip = (link, other, part) in may_touch
                else:
                    skip = False
                if not skip:
                    self.geometry.addCollisionPair(pin.CollisionPair(i, j))
        self.prepare()
        self.place(rest, object_rest)
        touching = [
            pair
            for index, pair in enumerate(list(self.geometry.collisionPairs))
            if self.bodies[pair.second][0] == "robot" and self.is_deep(index)
        ]
        for pair in touching:
            self.geometry.removeCollisionPair(pair)
        self.prepare()

    def prepare(self) -> None:
        self.geometry_data = self.geometry.createData()
        for request in self.geometry_data.collisionRequests:
            request.enable_contact = True
            request.num_max_contacts = MOST_CONTACTS

    def is_deep(self, index: int) -> bool:
        """True where a pair overlaps by more than is let pass, triangle by triangle."""
        if not pin.computeCollision(self.geometry, self.geometry_data, index):
            return False
        contacts = self.geometry_data.collisionResults[index].getContacts()
        return max(abs(c.penetration_depth) for c in contacts) > PENETRATION_M

    def moving_joints_between(self, a: str, b: str) -> int:
        """Number of joints that move one link relative to another."""
        model = self.robot_model

        def chain(link: str) -> set[int]:
            joint = model.frames[model.getFrameId(link)].parentJoint
            above = set()
            while joint > 0:
                above.add(joint)
                joint = model.parents[joint]
            return above

        return len(chain(a) ^ chain(b))

    def place(self, robot_q: np.ndarray, object_q: np.ndarray) -> None:
        pin.framesForwardKinematics(self.robot_model, self.robot_data, robot_q)
        pin.framesForwardKinematics(self.object_model, self.object_data, object_q)
        placements = self.geometry_data.oMg
        for index, (owner, frame, place, _) in enumerate(self.bodies):
            if owner == "robot":
                placements[index] = self.robot_data.oMf[frame] * place
            elif owner == "object":
                placements[index] = self.world_from_object * self.object_data.oMf[frame] * place
            else:
                placements[index] = place

    def collision(self) -> str | None:
        """The first pair that collides as everything is placed now."""
        if not pin.computeCollisions(self.geometry, self.geometry_data, True):
            return None
        for index, pair in enumerate(self.geometry.collisionPairs):
            if self.is_deep(index):
                names = [self.geometry.geometryObjects[i].name for i in (pair.first, pair.second)]
                return " in ".join(
                    name.rsplit("/", 1)[0] if "/" in name else name for name in names
                )
        return None


def configuration(model: pin.Model, names: list[str], row: np.ndarray, rest: np.ndarray):
    q = rest.copy()
    for name, value in zip(names, row, strict=True):
        q[model.joints[model.getJointId(name)].idx_q] = value
    return q


class File:
    """A trajectory file and the judge of its task."""

    def __init__(self, path: Path, assets: list[Path]):
        with h5py.File(path) as file:
            a = file.attrs
            self.task = tomllib.loads(a["task_toml"])
            self.phases = json.loads(a["phase_names"])
            self.robot_joints = [_text(n) for n in a["robot_joints"]]
            self.object_joints = [_text(n) for n in a["object_joints"]]
            self.active = self.object_joints.index(_text(a["active_joint"]))
            self.exceptions = json.loads(a["contact_exceptions"])
            self.offset = file["dense/offset"][:].astype(int)
            self.robot = file["dense/robot"][:].astype(float)
            self.object = file["dense/object"][:].astype(float)
            self.phase = file["dense/phase"][:]
            self.times = file["dense/times"][:]
            self.grasp = file["grasp/pose"][:]
            self.goal = file["goal"][:]
            self.start = file["start"][:]
            self.ids = [_text(i) for i in file["id"][:]]
            folder = (path.parent / _text(a["task_dir"])).resolve()
        self.judge = Judge(self.task, folder, Search(assets))
        self._prepare()

    def _prepare(self) -> None:
        judge = self.judge
        self.robot_rest = pin.neutral(judge.robot_model)
        self.object_rest = pin.neutral(judge.object_model)
        arm, gripper = judge.robot["arm"], judge.robot["gripper"]
        rest = dict(zip(arm["joints"], arm["retract"], strict=True))
        rest |= dict(zip(gripper["joints"], gripper["open"], strict=True))
        names, values = list(rest), np.array(list(rest.values()), dtype=float)
        resting = configuration(judge.robot_model, names, values, self.robot_rest)
        judge.choose_pairs(self.exceptions, resting, self.object_rest)

    def __len__(self) -> int:
        return len(self.ids)

    def findings(self, stride: int = 1) -> list[Finding]:
        """One finding for each trajectory; every `stride`-th sample is checked for collisions."""
        return [self.finding(index, stride) for index in range(len(self))]

    def finding(self, index: int, stride: int) -> Finding:
        rows = slice(self.offset[index], self.offset[index + 1])
        candidate = Candidate(
            id=self.ids[index],
            robot=self.robot[rows],
            object=self.object[rows],
            times=self.times[rows],
            phases=[self.phases[p] for p in self.phase[rows]],
            grasp=self.grasp[index],
            start=self.start[index],
            goal=self.goal[index],
        )
        return self.examine(candidate, stride)

    def examine(self, path: Candidate, stride: int = 1) -> Finding:
        """Judges a path of this task, from wherever it is."""
        out = Finding(id=path.id)
        if not (np.isfinite(path.robot).all() and np.isfinite(path.object).all()):
            out.refuse("malformed", "a value is not finite")
            return out
        self.check_anchor(path, out)
        self.check_limits(path.robot, path.times, out)
        self.check_object(path, out)
        if out.refused is None:
            self.check_collisions(path, stride, out)
        return out

    def check_anchor(self, path: Candidate, out: Finding) -> None:
        judge = self.judge
        tool = judge.robot_model.getFrameId(judge.robot["gripper"]["tool_link"])
        handle = judge.object_model.getFrameId(judge.handle)
        link_from_tool = pose(judge.robot["gripper"]["link_from_tool"])
        handle_from_tool = pose(path.grasp)
        for sample, phase in enumerate(path.phases):
            if phase not in HELD:
                continue
            self.place(path.robot[sample], path.object[sample])
            actual = judge.robot_data.oMf[tool] * link_from_tool
            wanted = judge.world_from_object * judge.object_data.oMf[handle] * handle_from_tool
            off = wanted.actInv(actual)
            distance = float(np.linalg.norm(off.translation))
            angle = float(np.linalg.norm(pin.log3(off.rotation)))
            out.anchor_m, out.anchor_rad = max(out.anchor_m, distance), max(out.anchor_rad, angle)
            if distance > ANCHOR_M or angle > ANCHOR_RAD:
                out.refuse("anchor", f"sample {sample}: {distance * 1e3:.2f} mm, {angle:.4f} rad")

    def place(self, robot_row, object_row) -> None:
        judge = self.judge
        judge.place(
            configuration(judge.robot_model, self.robot_joints, robot_row, self.robot_rest),
            configuration(judge.object_model, self.object_joints, object_row, self.object_rest),
        )

    def check_limits(self, robot, times, out: Finding) -> None:
        model = self.judge.robot_model
        for column, name in enumerate(self.robot_joints):
            joint = model.joints[model.getJointId(name)]
            low = model.lowerPositionLimit[joint.idx_q] - LIMIT_TOLERANCE
            high = model.upperPositionLimit[joint.idx_q] + LIMIT_TOLERANCE
            values = robot[:, column]
            outside = np.flatnonzero((values < low) | (values > high))
            if outside.size:
                first = outside[0]
                out.refuse("position_limit", f"{name} is {values[first]:.4f} at sample {first}")
            speed = np.abs(np.diff(values) / np.diff(times)) / model.velocityLimit[joint.idx_v]
            out.velocity_fraction = max(out.velocity_fraction, float(speed.max(initial=0.0)))
            if speed.max(initial=0.0) > 1 + RATE_TOLERANCE:
                at = int(speed.argmax())
                out.refuse("velocity_limit", f"{name}: {speed[at]:.2f} of its limit at sample {at}")

    def check_object(self, path: Candidate, out: Finding) -> None:
        held = np.array([phase in HELD for phase in path.phases])
        active = path.object[:, self.active]
        travel = abs(path.goal - path.start)
        ends = abs(active[0] - path.start), abs(active[held][-1] - path.goal)
        if max(ends) > TRAVEL_TOLERANCE * travel:
            out.refuse("object_motion", f"misses start or goal by {max(ends):.4f}")
        others = np.delete(path.object, self.active, axis=1)
        first = int(np.flatnonzero(held)[0])
        before = np.ptp(active[:first]) if first else 0.0
        aside = np.ptp(others, axis=0).max() if others.size else 0.0
        if max(aside, before) > LIMIT_TOLERANCE:
            out.refuse("object_motion", "moves what is not held")

    def check_collisions(self, path: Candidate, stride: int, out: Finding) -> None:
        for sample in range(0, len(path.robot), stride):
            self.place(path.robot[sample], path.object[sample])
            out.configurations += 1
            pair = self.judge.collision()
            if pair is not None:
                out.refuse("collision", f"{pair} at sample {sample} ({path.phases[sample]})")
                return


def _text(value) -> str:
    return value.decode() if isinstance(value, bytes) else str(value)


def main() -> int:
    """Judges a file."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawTextHelpFormatter
    )
    parser.add_argument("file", type=Path, help="trajectory file")
    parser.add_argument("--assets", type=Path, action="append", default=[], help="asset folder")
    parser.add_argument("--stride", type=int, default=1, help="samples from one collision check on")
    parser.add_argument("--json", action="store_true", help="print JSON")
    arguments = parser.parse_args()
    findings = File(arguments.file, arguments.assets).findings(arguments.stride)
    refused = [f for f in findings if f.refused]
    if arguments.json:
        print(json.dumps([asdict(f) for f in findings], indent=1))
    else:
        for f in findings:
            print(
                f"{f.id}  {f.refused or 'accepted':14} anchor {f.anchor_m * 1e3:.4f} mm "
                f"{f.anchor_rad:.6f} rad, speed {f.velocity_fraction:.2f}  {f.detail}"
            )
        print(f"{len(findings) - len(refused)} of {len(findings)} accepted")
    return 1 if refused else 0


if __name__ == "__main__":
    sys.exit(main())
