"""Generated objects in the programs that others load them with."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np
import pytest
from exports import run

CLASSES = [
    *("microwave", "oven", "dishwasher", "refrigerator", "wall-cabinet", "base-cabinet"),
    *("drawer-unit", "trash-can", "door", "chair", "box", "mug", "bowl"),
]
RIGID = {"chair", "box", "mug", "bowl"}
SEED = 2
TIMESTEP_S = 1 / 240
#: N m of hinges and N of drawers: what a finger can do.
SMALL = {"revolute": 2.0, "prismatic": 12.0}


@dataclass
class Generated:
    """A generated object's folder, description and manifest."""

    folder: Path
    urdf: Path
    manifest: dict[str, Any]

    def joints(self) -> list[ElementTree.Element]:
        """The joints that move."""
        joints = ElementTree.parse(self.urdf).getroot().findall("joint")
        return [joint for joint in joints if joint.get("type") != "fixed"]


@pytest.fixture(scope="module")
def objects(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Generated]:
    """One of each class."""
    base = tmp_path_factory.mktemp("objects")
    made = {}
    for name in CLASSES:
        folder = base / name
        result = run("generate", "object", name, "--seed", SEED, "-o", folder)
        assert result.returncode == 0, result.stderr
        manifest = json.loads((folder / "object.json").read_text())
        made[name] = Generated(folder, folder / manifest["urdf"], manifest)
    return made


def quiet(script: str, objects: dict[str, Generated]) -> dict[str, Any]:
    """What a script prints as JSON; what it or a library complains of is a failure."""
    files = {name: str(made.urdf) for name, made in objects.items()}
    result = subprocess.run(
        [sys.executable, "-W", "ignore:Failed to find system libvulkan", "-c", script],
        input=json.dumps(files),
        capture_output=True,
        text=True,
        check=False,
        env=dict(os.environ),
    )
    assert result.returncode == 0, result.stderr
    said = (result.stderr + result.stdout).lower()
    assert "warn" not in said, said
    assert "error" not in said, said
    return dict(json.loads(result.stdout.splitlines()[-1]))


def check_joints(found: dict[str, int], objects: dict[str, Generated]) -> None:
    assert found == {name: len(made.joints()) for name, made in objects.items()}
    assert all((count == 0) == (name in RIGID) for name, count in found.items())


def test_mujoco_loads_them_without_a_warning(objects: dict[str, Generated]) -> None:
    script = """
import json, sys
import mujoco

files = json.load(sys.stdin)
models = {name: mujoco.MjModel.from_xml_path(file) for name, file in files.items()}
print(json.dumps({name: model.njnt for name, model in models.items()}))
"""
    check_joints(quiet(script, objects), objects)


def test_a_shape_of_the_same_name_is_a_warning(
    objects: dict[str, Generated], tmp_path: Path
) -> None:
    text = objects["drawer-unit"].urdf.read_text().replace("front_2", "front")
    changed = tmp_path / "changed.urdf"
    changed.write_text(text)
    script = "import json, sys, mujoco\nmujoco.MjModel.from_xml_path(json.load(sys.stdin)['a'])"
    wrong = Generated(tmp_path, changed, {})
    with pytest.raises(AssertionError, match="duplicate name"):
        quiet(script, {"a": wrong})


def test_pinocchio_loads_them_without_a_warning(objects: dict[str, Generated]) -> None:
    pytest.importorskip("pinocchio")
    script = """
import json, sys
from pathlib import Path
import pinocchio

found = {}
for name, file in json.load(sys.stdin).items():
    model = pinocchio.buildModelFromUrdf(file)
    for kind in (pinocchio.GeometryType.COLLISION, pinocchio.GeometryType.VISUAL):
        folders = [str(Path(file).parent)]
        shapes = pinocchio.buildGeomFromUrdf(model, file, kind, package_dirs=folders)
        assert shapes.ngeoms > 0
    found[name] = model.nq
print(json.dumps(found))
"""
    check_joints(quiet(script, objects), objects)


def test_yourdfpy_finds_nothing_wrong_with_them(objects: dict[str, Generated]) -> None:
    script = """
import json, sys
import yourdfpy

found = {}
for name, file in json.load(sys.stdin).items():
    description = yourdfpy.URDF.load(file, load_collision_meshes=True)
    assert description.validate(), description.errors
    found[name] = description.num_actuated_joints
print(json.dumps(found))
"""
    check_joints(quiet(script, objects), objects)


#: Loads objects with SAPIEN's own loader, and pushes at the joints that open them.
SAPIEN = """
import json, sys
from xml.etree import ElementTree
import numpy as np
import sapien

def moves(file, joint, force, seconds):
    scene = sapien.Scene([sapien.physx.PhysxCpuSystem(), sapien.render.RenderSystem("cpu")])
    scene.set_timestep(TIMESTEP)
    loader = scene.create_urdf_loader()
    loader.fix_root_link = True
    articulation = loader.load(file)
    names = [j.name for j in articulation.active_joints]
    described = {j.get("name"): j for j in ElementTree.parse(file).getroot().findall("joint")}
    for active in articulation.active_joints:
        # URDF's friction is a force, PhysX' own a share of the load. A saturating drive is a force.
        friction = float(described[active.name].find("dynamics").get("friction"))
        active.set_friction(0.0)
        active.set_drive_properties(0.0, friction / 0.01, force_limit=friction, mode="force")
        active.set_drive_velocity_target(0.0)
    index, farthest = names.index(joint), 0.0
    forces = np.zeros(len(names), np.float32)
    forces[index] = force
    for _ in range(int(seconds / TIMESTEP)):
        articulation.set_qf(forces)
        scene.step()
        farthest = max(farthest, float(np.abs(articulation.qpos).max()))
    return farthest, float(articulation.qpos[index])
"""


def test_sapien_loads_them_without_a_warning(objects: dict[str, Generated]) -> None:
    pytest.importorskip("sapien")
    script = """
import json, sys
import sapien

found = {}
for name, file in json.load(sys.stdin).items():
    scene = sapien.Scene([sapien.physx.PhysxCpuSystem(), sapien.render.RenderSystem("cpu")])
    articulations, actors = scene.create_urdf_loader().load_multiple(file)
    assert len(articulations) + len(actors) == 1
    found[name] = sum(articulation.dof for articulation in articulations)
print(json.dumps(found))
"""
    check_joints(quiet(script, objects), objects)


def test_they_open_under_a_small_force_and_stay_closed_without(
    objects: dict[str, Generated],
) -> None:
    pytest.importorskip("sapien")
    openable = {name: made for name, made in objects.items() if name not in RIGID}
    asked = {
        name: [made.manifest["articulation"]["joint"], SMALL[made.manifest["articulation"]["kind"]]]
        for name, made in openable.items()
    }
    settings = f"TIMESTEP, ASKED = {TIMESTEP_S!r}, {asked!r}\n"
    script = """
found = {}
for name, file in json.load(sys.stdin).items():
    joint, force = ASKED[name]
    found[name] = [moves(file, joint, 0.0, 1.0)[0], moves(file, joint, force, 3.0)[1]]
print(json.dumps(found))
"""
    for name, (closed, opened) in quiet(settings + SAPIEN + script, openable).items():
        goals = openable[name].manifest["articulation"]["goals"]
        assert closed < 0.01, f"{name} does not stay closed: {closed}"
        assert opened > min(goals), f"{name} opens to {opened} only, of {goals}"


def test_limits_and_axes_are_what_the_manifest_says(objects: dict[str, Generated]) -> None:
    for name, made in objects.items():
        articulation = made.manifest["articulation"]
        assert (articulation is None) == (name in RIGID)
        if articulation is None:
            continue
        joint = next(j for j in made.joints() if j.get("name") == articulation["joint"])
        limit, axis = joint.find("limit"), joint.find("axis")
        assert limit is not None
        assert axis is not None
        limits = [float(limit.get(side, "nan")) for side in ("lower", "upper")]
        assert limits == pytest.approx(articulation["limits"])
        direction = np.array([float(v) for v in axis.get("xyz", "").split()])
        assert np.linalg.norm(direction) == pytest.approx(1.0)
