"""Wrong input, as users get it wrong: exit 2, a message that names the file, nothing written.

A small task of primitive shapes is right; each case breaks it in one place.
"""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import pytest
import trimesh

TASK = """
name = "cupboard"
[robot]
file = "robot.toml"
[object]
name = "cupboard"
urdf = "object.urdf"
pose = [1.5, 0.0, 0.5, 1.0, 0.0, 0.0, 0.0]
joint = "hinge"
[object.handle]
link = "door"
[scene]
file = "scene.glb"
[[scene.box]]
name = "table"
size = [0.5, 0.5, 0.4]
pose = [1.5, 0.0, 0.2, 1.0, 0.0, 0.0, 0.0]
[goal]
positions = [1.0]
[planner]
limit = 1
ik_seeds = 2
pairs_per_grasp = 1
"""

OBJECT = """<?xml version="1.0"?>
<robot name="cupboard">
  <link name="body">
    <visual><geometry><mesh filename="body.stl"/></geometry></visual>
    <collision><geometry><mesh filename="body.stl"/></geometry></collision>
  </link>
  <link name="door">
    <visual><origin xyz="0 0.2 0"/><geometry><box size="0.02 0.4 0.4"/></geometry></visual>
    <collision><origin xyz="0 0.2 0"/><geometry><box size="0.02 0.4 0.4"/></geometry></collision>
  </link>
  <joint name="hinge" type="revolute">
    <parent link="body"/><child link="door"/>
    <origin xyz="-0.25 -0.2 0"/><axis xyz="0 0 1"/>
    <limit lower="0" upper="1.5" effort="10" velocity="1"/>
  </joint>
</robot>
"""

ROBOT = """
name = "robot"
urdf = "robot.urdf"
[base]
kind = "holonomic"
joints = ["x", "y", "yaw"]
[arm]
joints = ["a1", "a2", "a3"]
retract = [0.0, 0.5, -0.5]
[gripper]
joints = ["f1", "f2"]
closed = [0.0, 0.0]
open = [0.04, 0.04]
open_width_m = 0.08
finger_links = ["finger1", "finger2"]
tool_link = "palm"
link_from_tool = [0.0, 0.0, 0.3, 1.0, 0.0, 0.0, 0.0]
"""

RIG = """
name = "one"
[[cameras]]
name = "fixed"
focal_mm = 50.0
mount = { on = "look_at_handle", offset = [1.0, 0.0, 1.0] }
"""


def robot_urdf() -> str:
    """A base, an arm of three joints and two fingers, all boxes in a chain."""
    joints = [
        ("x", "prismatic", "1 0 0", "world", "base_x", "-5", "5"),
        ("y", "prismatic", "0 1 0", "base_x", "base_y", "-5", "5"),
        ("yaw", "revolute", "0 0 1", "base_y", "base", "-3", "3"),
        ("a1", "revolute", "0 0 1", "base", "link1", "-3", "3"),
        ("a2", "revolute", "0 1 0", "link1", "link2", "-3", "3"),
        ("a3", "revolute", "0 1 0", "link2", "palm", "-3", "3"),
        ("f1", "prismatic", "0 1 0", "palm", "finger1", "0", "0.04"),
        ("f2", "prismatic", "0 -1 0", "palm", "finger2", "0", "0.04"),
    ]
    box = "<geometry><box size='0.05 0.05 0.05'/></geometry>"
    links = "".join(
        f"<link name='{child}'><visual>{box}</visual><collision>{box}</collision></link>"
        for *_, child, _, _ in joints
    )
    text = "".join(
        f"<joint name='{name}' type='{kind}'><parent link='{parent}'/><child link='{child}'/>"
        f"<origin xyz='0 0 0.3'/><axis xyz='{axis}'/>"
        f"<limit lower='{lower}' upper='{upper}' effort='10' velocity='1'/></joint>"
        for name, kind, axis, parent, child, lower, upper in joints
    )
    return f"<robot name='robot'><link name='world'/>{links}{text}</robot>"


@pytest.fixture
def inputs(tmp_path: Path) -> Path:
    """A folder with all files of the right task."""
    folder = tmp_path / "inputs"
    folder.mkdir()
    (folder / "task.toml").write_text(TASK)
    (folder / "object.urdf").write_text(OBJECT)
    (folder / "robot.toml").write_text(ROBOT)
    (folder / "robot.urdf").write_text(robot_urdf())
    (folder / "rig.toml").write_text(RIG)
    trimesh.creation.box([0.4, 0.4, 0.4]).export(folder / "body.stl")
    crate = trimesh.Scene()
    crate.add_geometry(trimesh.creation.box([0.3, 0.3, 0.3]), node_name="crate", geom_name="crate")
    crate.export(folder / "scene.glb")
    return folder


def run(*arguments: object) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-m", "akrobat", *map(str, arguments)]
    return subprocess.run(command, capture_output=True, text=True, check=False)


def assert_bad_input(
    result: subprocess.CompletedProcess[str], messages: tuple[str, ...], output: Path
) -> None:
    assert result.returncode == 2, result.stderr
    for message in messages:
        assert message in result.stderr
    assert "panicked" not in result.stderr
    assert result.stdout == ""
    assert not output.exists()
    assert not list(output.parent.glob(".akrobat-*"))
    assert not list(output.parent.glob("*.partial"))


@dataclass(frozen=True)
class Case:
    """One text replaced in one file, and what the message has to say."""

    name: str
    file: str
    old: str
    new: str
    messages: tuple[str, ...]


def swap(name: str, file: str, old: str, new: str, *messages: str) -> Case:
    return Case(name, file, old, new, messages)


TASK_CASES = [
    swap("missing mesh", "object.urdf", "body.stl", "none.stl", "none.stl", "object.urdf"),
    swap(
        "cyclic URDF",
        "object.urdf",
        "</robot>",
        '<joint name="back" type="fixed"><parent link="door"/><child link="body"/></joint></robot>',
        "object.urdf",
    ),
    swap(
        "disconnected URDF", "object.urdf", "</robot>", '<link name="lost"/></robot>', "object.urdf"
    ),
    swap("no such parent", "object.urdf", '<parent link="body"', '<parent link="b"', "object.urdf"),
    swap(
        "zero axis", "object.urdf", 'axis xyz="0 0 1"', 'axis xyz="0 0 0"', "object.urdf", "hinge"
    ),
    swap("NaN axis", "object.urdf", 'xyz="0 0 1"', 'xyz="0 nan 1"', "object.urdf", "<axis>"),
    swap("inverted limits", "object.urdf", 'upper="1.5"', 'upper="-1"', "object.urdf", "hinge"),
    swap("NaN limit", "object.urdf", 'upper="1.5"', 'upper="nan"', "object.urdf", "<limit>"),
    swap("joint used twice", "object.urdf", 'link name="door"', 'link name="body"', "object.urdf"),
    swap("negative box", "object.urdf", "0.02 0.4 0.4", "0.02 -0.4 0.4", "object.urdf"),
    swap("not XML", "object.urdf", "</robot>", "<robot", "object.urdf"),
    swap("not a URDF", "object.urdf", "robot", "sdf", "object.urdf"),
    swap("cyclic robot", "robot.urdf", "parent link='world'", "parent link='palm'", "robot.urdf"),
    swap("unknown joint", "task.toml", '"hinge"', '"lid"', "task.toml", "valid choices: hinge"),
    swap("unknown link", "task.toml", '"door"', '"lid"', "task.toml", "valid choices:", "door"),
    swap(
        "unknown body in remove",
        "task.toml",
        "[[scene.box]]",
        'remove = ["ghost"]\n[[scene.box]]',
        "task.toml",
        "scene.remove",
        "crate",
    ),
    swap(
        "unknown floor",
        "task.toml",
        "[[scene.box]]",
        'floor = "ghost"\n[[scene.box]]',
        "task.toml",
        "scene.floor",
        "crate",
    ),
    swap("absurd scale", "task.toml", "joint =", "scale = 1e9\njoint =", "task.toml", "scale"),
    swap("zero scale", "task.toml", "joint =", "scale = 0.0\njoint =", "task.toml", "scale"),
    swap(
        "no pose",
        "task.toml",
        "pose = [1.5, 0.0, 0.5, 1.0, 0.0, 0.0, 0.0]",
        "",
        "task.toml",
        "pose",
    ),
    swap(
        "both pose and replaces",
        "task.toml",
        "joint =",
        'replaces = { body = "crate", yaw = 0.0 }\njoint =',
        "task.toml",
        "replaces",
    ),
    swap("zero quaternion", "task.toml", "0.5, 1.0, 0", "0.5, 0.0, 0", "task.toml", "object.pose"),
    swap(
        "NaN in a pose", "task.toml", "[1.5, 0.0, 0.5", "[1.5, nan, 0.5", "task.toml", "object.pose"
    ),
    swap(
        "unknown key", "task.toml", "joint =", "joints =", "task.toml", "joints", "expected one of"
    ),
    swap(
        "goal outside limits", "task.toml", "[1.0]", "[2.0]", "task.toml", "goal.positions", "1.5"
    ),
    swap("no goal", "task.toml", "[1.0]", "[]", "task.toml", "goal.positions"),
    swap(
        "negative box size",
        "task.toml",
        "[0.5, 0.5, 0.4]",
        "[-1.0, 0.5, 0.4]",
        "task.toml",
        "table",
    ),
    swap("missing robot file", "task.toml", "robot.toml", "none.toml", "none.toml", "task.toml"),
    swap("missing object", "task.toml", "object.urdf", "none.urdf", "none.urdf", "task.toml"),
    swap("missing scene", "task.toml", "scene.glb", "none.glb", "none.glb", "task.toml"),
    swap("scene of unknown kind", "task.toml", "scene.glb", "rig.toml", "rig.toml", "glb"),
    swap("malformed TOML", "task.toml", "[robot]", "[robot", "task.toml", "TOML parse error"),
    swap(
        "unknown planner key", "task.toml", "ik_seeds", "seeds", "task.toml", "planner", "ik_seeds"
    ),
    swap("wrong type", "task.toml", "ik_seeds = 2", 'ik_seeds = "two"', "task.toml", "planner"),
    swap(
        "negative voxel size",
        "task.toml",
        "ik_seeds",
        "voxel_size_m = -0.02\nik_seeds",
        "task.toml",
        "voxel_size_m",
    ),
    swap("zero seeds", "task.toml", "ik_seeds = 2", "ik_seeds = 0", "task.toml", "ik_seeds"),
    swap("unknown robot key", "robot.toml", "kind =", "kinds =", "robot.toml", "kinds"),
    swap("unknown base kind", "robot.toml", "holonomic", "flying", "robot.toml", "holonomic"),
    swap("unknown arm joint", "robot.toml", '"a3"', '"a9"', "robot.toml", "a9", "valid choices:"),
    swap("unknown tool link", "robot.toml", '"palm"', '"hand"', "robot.toml", "hand", "palm"),
    swap(
        "retract of wrong length",
        "robot.toml",
        "[0.0, 0.5, -0.5]",
        "[0.0]",
        "robot.toml",
        "retract",
    ),
    swap("missing robot URDF", "robot.toml", "robot.urdf", "none.urdf", "none.urdf", "robot.toml"),
]


def test_the_task_itself_is_right(inputs: Path, tmp_path: Path) -> None:
    """Each case below has its one mistake to blame."""
    result = run("plan", inputs / "task.toml", "-o", tmp_path / "out.h5")
    assert result.returncode in (0, 3), result.stderr


@pytest.mark.parametrize("case", TASK_CASES, ids=lambda case: case.name)
def test_wrong_tasks(inputs: Path, tmp_path: Path, case: Case) -> None:
    file = inputs / case.file
    text = file.read_text()
    assert case.old in text
    file.write_text(text.replace(case.old, case.new))
    output = tmp_path / "out.h5"
    assert_bad_input(run("plan", inputs / "task.toml", "-o", output), case.messages, output)


@pytest.mark.parametrize("file", ["scene.glb", "body.stl"])
@pytest.mark.parametrize("damage", ["truncated", "empty", "garbage"])
def test_damaged_meshes(inputs: Path, tmp_path: Path, file: str, damage: str) -> None:
    content = (inputs / file).read_bytes()
    damaged = {"truncated": content[: len(content) // 2], "empty": b"", "garbage": b"\xff" * 99}
    (inputs / file).write_bytes(damaged[damage])
    output = tmp_path / "out.h5"
    assert_bad_input(run("plan", inputs / "task.toml", "-o", output), (file,), output)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (["--threads", "0"], "--threads"),
        (["--limit", "0"], "limit"),
        (["--limit", "-1"], "'-1'"),
        (["--limit", "many"], "--limit"),
        (["--seed", "x"], "--seed"),
        (["--assets", "/nonexistent"], "/nonexistent"),
        (["--frobnicate"], "--frobnicate"),
    ],
    ids=str,
)
def test_wrong_options_of_plan(
    inputs: Path, tmp_path: Path, options: list[str], message: str
) -> None:
    output = tmp_path / "out.h5"
    result = run("plan", inputs / "task.toml", "-o", output, *options)
    assert_bad_input(result, (message,), output)


@pytest.mark.parametrize(
    ("options", "messages"),
    [
        (["--rig", "no_such_rig"], ("no_such_rig", "paper")),
        (["--rig", "none/rig.toml"], ("none/rig.toml",)),
        (["--lighting", "moonshine"], ("moonshine", "even", "studio")),
        (["--lighting", "none/light.toml"], ("none/light.toml",)),
        (["--variation", "tame"], ("tame", "mild", "wild")),
        (["--appearance", "none/look.json"], ("none/look.json",)),
        (["--supersampling", "2"], ("2", "1, 3, 5")),
        (["--backend", "crayons"], ("crayons", "soft", "wgpu", "sapien")),
        (["--format", "zip"], ("zip", "hdf5", "mcap")),
        (["--phases", "nap"], ("nap", "all", "manipulate")),
        (["--episodes", "99"], ("drawer.h5", "99", "0 to 1")),
        (["--episodes", "1-0"], ("1-0",)),
        (["--threads", "0"], ("--threads",)),
    ],
    ids=str,
)
def test_wrong_options_of_render(
    drawer_file: Path,
    shared_assets: Path,
    tmp_path: Path,
    options: list[str],
    messages: tuple[str, ...],
) -> None:
    output = tmp_path / "dataset"
    command = ["render", drawer_file, "-o", output, "--assets", shared_assets, *options]
    assert_bad_input(run(*command), messages, output)


RIG_CASES = [
    swap("unknown rig key", "rig.toml", "focal_mm", "focal", "rig.toml", "focal"),
    swap("negative focal length", "rig.toml", "50.0", "-50.0", "rig.toml", "focal_mm"),
    swap("huge image", "rig.toml", "focal_mm", "width = 99999\nfocal_mm", "rig.toml", "width"),
    swap("unknown mount", "rig.toml", "look_at_handle", "look_at_me", "rig.toml", "look_at_handle"),
    swap("name with a space", "rig.toml", '"fixed"', '"my cam"', "rig.toml", "my cam"),
    swap("no camera", "rig.toml", "[[cameras]]", "[[lamps]]", "rig.toml", "cameras"),
    swap(
        "unknown mount link",
        "rig.toml",
        'on = "look_at_handle", offset = [1.0, 0.0, 1.0]',
        'on = "link", link = "antenna", link_from_camera = [0, 0, 0, 1, 0, 0, 0]',
        "antenna",
        "panda_hand",
    ),
]


@pytest.mark.parametrize("case", RIG_CASES, ids=lambda case: case.name)
def test_wrong_rigs(
    inputs: Path, drawer_file: Path, shared_assets: Path, tmp_path: Path, case: Case
) -> None:
    rig = inputs / case.file
    assert case.old in RIG
    rig.write_text(RIG.replace(case.old, case.new))
    output = tmp_path / "dataset"
    command = ["render", drawer_file, "-o", output, "--assets", shared_assets, "--rig", rig]
    assert_bad_input(run(*command), case.messages, output)


@pytest.mark.parametrize("verb", ["render", "inspect", "validate"])
@pytest.mark.parametrize(
    "damage",
    [
        lambda content: content[: len(content) // 2],
        lambda content: content[:100],
        lambda content: b"",
        lambda content: b"not HDF5 at all" * 100,
        None,
    ],
    ids=["truncated", "header only", "empty", "not HDF5", "absent"],
)
def test_damaged_trajectory_files(
    drawer_file: Path, tmp_path: Path, verb: str, damage: Callable[[bytes], bytes] | None
) -> None:
    file = tmp_path / "damaged.h5"
    if damage:
        file.write_bytes(damage(drawer_file.read_bytes()))
    output = tmp_path / "output"
    options = ["-o", output] if verb == "render" else []
    assert_bad_input(run(verb, file, *options), ("damaged.h5",), output)


def test_assets_that_changed_since_planning(
    drawer_file: Path, shared_assets: Path, tmp_path: Path
) -> None:
    """Replaying on other files than were planned with would show what was never judged."""
    changed = tmp_path / "assets"
    drawer = Path("objects/drawer_1001/drawer.urdf")
    (changed / drawer).parent.mkdir(parents=True)
    (changed / drawer).parent.joinpath("assets").symlink_to(
        (shared_assets / drawer).parent / "assets"
    )
    (changed / drawer).write_text((shared_assets / drawer).read_text() + "<!-- changed -->")
    output = tmp_path / "dataset"
    command = ["render", drawer_file, "-o", output, "--assets", changed, "--assets", shared_assets]
    assert_bad_input(run(*command), ("drawer.h5", "object.urdf"), output)


@pytest.mark.parametrize("verb", ["plan", "render"])
def test_an_output_in_the_way(
    inputs: Path, drawer_file: Path, shared_assets: Path, tmp_path: Path, verb: str
) -> None:
    """A folder is no place for a file, and nobody's files are mixed with a dataset's."""
    output = tmp_path / "taken"
    output.mkdir()
    (output / "mine.txt").write_text("mine")
    source = inputs / "task.toml" if verb == "plan" else drawer_file
    result = run(verb, source, "-o", output, "--assets", shared_assets)
    assert result.returncode == 2, result.stderr
    assert f"{output}: cannot write" in result.stderr
    assert [path.name for path in output.iterdir()] == ["mine.txt"]
