"""Every link of every robot and every shared object is where Pinocchio has it."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest
from akrobat import _core
from akrobat.assets import installed_asset_folders

try:
    import tomllib
except ModuleNotFoundError:  # Python 3.10
    import tomli as tomllib

REPOSITORY = Path(__file__).parents[2]
sys.path.insert(0, str(REPOSITORY / "benchmarks" / "planner"))

import external_judge  # noqa: E402

# Metres and radians: what URDF texts of both sides lose is 1e-9 and less.
TOLERANCE = 1e-8
CONFIGURATIONS = 20
ROBOTS = {
    "summit_franka": REPOSITORY / "configs" / "robots" / "summit_franka.toml",
    "tiago": REPOSITORY / "configs" / "robots" / "tiago.toml",
    "panda": REPOSITORY / "configs" / "robots" / "panda.toml",
    "ur5": REPOSITORY / "configs" / "robots" / "ur5.toml",
    "pillar": REPOSITORY / "assets" / "src" / "robot" / "pillar.toml",
}
OBJECTS = [
    "cabinet_1001/cabinet.urdf",
    "dishwasher_1001/dishwasher.urdf",
    "drawer_1001/drawer.urdf",
    "microwave_1001/microwave.urdf",
    "oven_1001/oven.urdf",
    "refrigerator_1001/refrigerator.urdf",
    "sektion_cabinet/urdf/sektion_cabinet.urdf",
]


@dataclass
class Part:
    """A URDF that a robot is made of, and where its root is."""

    model: pin.Model
    # Link of another part that the root hangs from, and how.
    parent: str | None
    parent_from_root: pin.SE3


def pose(values) -> pin.SE3:
    return external_judge.pose(values)


def gap(a: pin.SE3, b: pin.SE3) -> float:
    return float(np.abs(pin.log6(a.actInv(b)).vector).max())


def task_with(robot: Path, assets: list[Path], folder: Path) -> _core.Task:
    """The drawer's task with another robot."""
    source = REPOSITORY / "configs" / "tasks" / "summit_drawer_empty.toml"
    file = folder / f"{robot.stem}.toml"
    text = source.read_text()
    assert "../robots/summit_franka.toml" in text
    file.write_text(text.replace("../robots/summit_franka.toml", str(robot)))
    return _core.Task.load(file, assets)


def parts_of(robot: Path, assets: list[Path]) -> list[Part]:
    """The URDFs of a robot file, read by Pinocchio."""
    search = external_judge.Search(assets)
    file = tomllib.loads(robot.read_text())

    def model(name: str) -> pin.Model:
        return external_judge.kinematics(search.find(name, robot.parent))

    platform = file["base"].get("platform")
    parts = []
    if platform:
        parts.append(Part(model(platform["urdf"]), None, pin.SE3.Identity()))
        above, place = platform["link"], pose(platform["link_from_robot"])
        parts.append(Part(model(file["urdf"]), above, place))
    else:
        parts.append(Part(model(file["urdf"]), None, pin.SE3.Identity()))
    attach = file["gripper"].get("attach")
    if attach:
        place = pose(attach["link_from_gripper"])
        parts.append(Part(model(attach["urdf"]), attach["link"], place))
    return parts


def planar(robot: dict, positions: dict[str, float]) -> pin.SE3:
    """The base that stands on no URDF: x, y, and a turn about z."""
    x, y, yaw = (positions[name] for name in robot["base_joints"])
    return pin.SE3(pin.rpy.rpyToMatrix(0.0, 0.0, yaw), np.array([x, y, 0.0]))


def random_positions(tree: dict, rng: np.random.Generator) -> dict[str, float]:
    joints = {joint["name"]: joint for joint in tree["joints"]}
    limits = {name: np.clip(joints[name]["limits"], -3.0, 3.0) for name in tree["dof_joints"]}
    return {name: float(rng.uniform(*limit)) for name, limit in limits.items()}


def configuration(model: pin.Model, tree: dict, positions: dict[str, float]) -> np.ndarray:
    """Pinocchio's configuration; joints that mimic others follow their formula."""
    mimics = {joint["name"]: joint["mimic"] for joint in tree["joints"]}
    q = pin.neutral(model)
    for index, name in list(enumerate(model.names))[1:]:
        value = positions.get(name)
        if value is None:
            followed, multiplier, offset = mimics[name]
            value = multiplier * positions[followed] + offset
        joint = model.joints[index]
        if joint.nq == 2:  # Joints without limits are points of a circle.
            q[joint.idx_q : joint.idx_q + 2] = np.cos(value), np.sin(value)
        else:
            q[joint.idx_q] = value
    return q


def link_poses(model: pin.Model, q: np.ndarray) -> Iterator[tuple[str, pin.SE3]]:
    data = model.createData()
    pin.framesForwardKinematics(model, data, q)
    for index, frame in enumerate(model.frames):
        if frame.type == pin.FrameType.BODY:
            yield frame.name, data.oMf[index]


def by_pinocchio(robot: dict, parts: list[Part], positions: dict[str, float]):
    """World poses of all links of a robot of several parts."""
    own = {name for part in parts for name in part.model.names}
    mobile = robot["base_joints"] and robot["base_joints"][0] not in own
    begin = pose(robot["world_from_root"])
    found: dict[str, pin.SE3] = {}
    for part in parts:
        if part.parent is not None:
            root = found[part.parent] * part.parent_from_root
        else:
            root = begin * planar(robot, positions) if mobile else begin
        q = configuration(part.model, robot, positions)
        found |= {name: root * place for name, place in link_poses(part.model, q)}
    return found


@pytest.fixture(scope="module")
def assets(shared_assets: Path) -> list[Path]:
    return [shared_assets, *installed_asset_folders()]


@pytest.mark.parametrize("name", ROBOTS)
def test_links_of_robots_are_where_pinocchio_has_them(
    name: str, assets: list[Path], tmp_path: Path
) -> None:
    task = task_with(ROBOTS[name], assets, tmp_path)
    robot, parts = task.robot(), parts_of(ROBOTS[name], assets)
    rng = np.random.default_rng(0)
    compared, largest = set(), 0.0
    for _ in range(CONFIGURATIONS):
        positions = random_positions(robot, rng)
        ours, _ = task.link_poses(positions, {})
        theirs = by_pinocchio(robot, parts, positions)
        gaps = {link: gap(theirs[link], pose(ours[link])) for link in ours if link in theirs}
        compared |= set(gaps)
        largest = max(largest, *gaps.values())
    assert largest < TOLERANCE, (largest, gaps)
    # What has a shape or moves was compared; the virtual base alone has no URDF.
    missing = {link["name"] for link in robot["links"]} - compared
    shapeless = {e["name"] for e in robot["links"] if not e["collisions"] and not e["visuals"]}
    assert missing <= shapeless, missing - shapeless
    assert len(compared) > len(robot["dof_joints"]) - 3


@pytest.mark.parametrize("name", ["summit_franka", "ur5"])
def test_a_joint_that_is_off_shows(name: str, assets: list[Path], tmp_path: Path) -> None:
    """Negative control: a hundredth of a milliradian in one joint is more than is let pass."""
    task = task_with(ROBOTS[name], assets, tmp_path)
    robot, parts = task.robot(), parts_of(ROBOTS[name], assets)
    positions = random_positions(robot, np.random.default_rng(1))
    theirs = by_pinocchio(robot, parts, positions)
    for joint in robot["arm_joints"]:
        ours, _ = task.link_poses(positions | {joint: positions[joint] + 1e-5}, {})
        gaps = [gap(theirs[link], pose(ours[link])) for link in ours if link in theirs]
        assert max(gaps) > 100 * TOLERANCE, joint


@pytest.mark.parametrize("file", OBJECTS)
def test_links_of_objects_are_where_pinocchio_has_them(
    file: str, shared_assets: Path, tmp_path: Path
) -> None:
    model = external_judge.kinematics(shared_assets / "objects" / file)
    task = object_task(file, shared_assets, tmp_path)
    tree = task.object()
    rng = np.random.default_rng(0)
    for _ in range(CONFIGURATIONS):
        positions = random_positions(tree, rng)
        _, ours = task.link_poses({}, positions)
        q = configuration(model, tree, positions)
        root = pose(tree["world_from_root"])
        theirs = {name: root * place for name, place in link_poses(model, q)}
        assert set(ours) == set(theirs)
        worst = max(gap(theirs[link], pose(ours[link])) for link in ours)
        assert worst < TOLERANCE, worst


def object_task(file: str, assets: Path, folder: Path) -> _core.Task:
    """A task that moves the first joint of an object."""
    model = external_judge.kinematics(assets / "objects" / file)
    joint = next(name for name in list(model.names)[1:])
    child = model.joints[model.getJointId(joint)]
    frames = [f for f in model.frames if f.parentJoint == child.id and f.type == pin.FrameType.BODY]
    low, high = model.lowerPositionLimit[child.idx_q], model.upperPositionLimit[child.idx_q]
    goal = high if abs(high) > abs(low) else low
    task = folder / "task.toml"
    task.write_text(
        f"""
name = "object"
[robot]
file = "{ROBOTS["summit_franka"]}"
[object]
name = "object"
urdf = "objects/{file}"
license = "CC0-1.0"
pose = [-1.0, 0.5, 0.25, 0.8, 0.0, 0.0, 0.6]
joint = "{joint}"
[object.handle]
link = "{frames[0].name}"
[scene]
room = [8.0, 8.0, 3.0]
[goal]
positions = [{goal}]
"""
    )
    return _core.Task.load(task, [assets])


def test_unknown_and_following_joints_are_refused(assets: list[Path], tmp_path: Path) -> None:
    task = task_with(ROBOTS["summit_franka"], assets, tmp_path)
    with pytest.raises(Exception, match="panda_joint1"):
        task.link_poses({"panda_joint99": 0.0}, {})
