"""Compares renderers on the same meshes, poses and cameras, in CPU time, and prints one table.

    .venv/bin/pip install sapien==3.0.3 mujoco pybullet
    eval "$(scripts/vulkan.sh)"
    .venv/bin/python benchmarks/render.py --assets ../shared/assets [--json]

Workload: `akrobat bench render --export` (twelve instants of a planned trajectory, three cameras of
320 x 240; the furnished kitchen where its files are found, else the built-in one). Each renderer
runs in a process of its own and yields colour, depth and segmentation of every image, without
shadows, from all triangles. Times are CPU time, user and system, of all threads; loading, shader
compilation and the first image of each camera are left out. `agrees` is the share of pixels whose
depth is within 1 cm of soft's: it shows that the same was drawn. `soft auto` is soft with level of
detail; it agrees where depth is within 2 mm.

MuJoCo needs a software OpenGL (Debian: libosmesa6), PyBullet brings its own rasteriser.
"""

from __future__ import annotations

import argparse
import json
import os
import platform
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

PEERS = ["sapien minimal", "sapien default", "mujoco", "pybullet"]
AGREEMENT_M = 0.01

Mesh = tuple[NDArray[np.float32], NDArray[np.uint32]]
Shot = Callable[[int, int], NDArray[np.float32]]
"""Draws frame, camera; returns z-depth in metres."""


@dataclass
class Workload:
    """What `akrobat bench render --export` wrote."""

    folder: Path
    content: dict

    @classmethod
    def load(cls, folder: Path) -> Workload:
        """Reads poses and cameras."""
        return cls(folder, json.loads((folder / "frames.json").read_text()))

    @property
    def bodies(self) -> list[dict]:
        """Bodies, in the order of the poses."""
        return self.content["bodies"]

    @property
    def frames(self) -> list[dict]:
        """Poses and cameras of each instant."""
        return self.content["frames"]

    def file(self, body: dict) -> Path:
        """A body's OBJ file."""
        return self.folder / f"body_{body['segment_id']}.obj"

    def mesh(self, body: dict) -> Mesh:
        """A body's triangles."""
        positions, triangles = [], []
        for line in self.file(body).read_text().splitlines():
            kind, *values = line.split()
            (positions if kind == "v" else triangles).append(values)
        return np.array(positions, np.float32), np.array(triangles, np.uint32) - 1

    def depth(self, frame: int, camera: int) -> NDArray[np.float32]:
        """What soft sees."""
        return np.fromfile(self.folder / f"depth_{frame}_{camera}.f32", np.float32)


def rotation(pose: list[float]) -> NDArray[np.float64]:
    """Rotation matrix of `x y z qw qx qy qz`."""
    w, x, y, z = pose[3:]
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
        ]
    )


def sapien_shot(workload: Workload, pack: str) -> Shot:
    """SAPIEN on the CPU, with one of its shader packs."""
    import sapien

    scene = sapien.Scene([sapien.render.RenderSystem("cpu")])
    scene.set_ambient_light([0.4, 0.4, 0.4])
    scene.add_directional_light([-0.3, -0.2, -0.9], [1.5, 1.5, 1.5], shadow=False)
    entities = []
    for body in workload.bodies:
        positions, triangles = workload.mesh(body)
        corners = positions[triangles]
        normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        smooth = np.zeros_like(positions)
        for corner in range(3):
            np.add.at(smooth, triangles[:, corner], normals)
        smooth /= np.maximum(np.linalg.norm(smooth, axis=1, keepdims=True), 1e-12)
        uvs = np.zeros((len(positions), 2), np.float32)
        material = sapien.render.RenderMaterial()
        material.base_color = body["color"]
        component = sapien.render.RenderBodyComponent()
        component.attach(
            sapien.render.RenderShapeTriangleMesh(positions, triangles, smooth, uvs, material)
        )
        entity = sapien.Entity()
        entity.add_component(component)
        scene.add_entity(entity)
        entities.append(entity)
    cameras = []
    shaders = Path(sapien.__file__).parent / "vulkan_shader" / pack
    for camera in workload.frames[0]["cameras"]:
        (fx, _, cx), (_, fy, cy), _ = camera["K"]
        component = sapien.render.RenderCameraComponent(
            camera["width"], camera["height"], str(shaders)
        )
        component.set_perspective_parameters(camera["near_m"], camera["far_m"], fx, fy, cx, cy, 0.0)
        entity = sapien.Entity()
        entity.add_component(component)
        scene.add_entity(entity)
        cameras.append(component)
    # SAPIEN's cameras look along +x with z up.
    turn = sapien.Pose([0, 0, 0], [0.5, 0.5, -0.5, 0.5])
    placed = -1

    def shot(frame: int, camera: int) -> NDArray[np.float32]:
        nonlocal placed
        state = workload.frames[frame]
        if placed != frame:
            for entity, pose in zip(entities, state["world_from_body"], strict=True):
                entity.set_pose(sapien.Pose(pose[:3], pose[3:]))
            for component, values in zip(cameras, state["cameras"], strict=True):
                pose = values["world_from_camera"]
                component.entity.set_pose(sapien.Pose(pose[:3], pose[3:]) * turn)
            scene.update_render()
            placed = frame
        component = cameras[camera]
        component.take_picture()
        component.get_picture("Color")
        if pack == "minimal":
            position = component.get_picture("PositionSegmentation")
            return -position[..., 2].ravel() / 1000.0
        component.get_picture("Segmentation")
        return -component.get_picture("Position")[..., 2].ravel()

    return shot


def mujoco_shot(workload: Workload) -> Shot:
    """MuJoCo with a software OpenGL; one pass for colour and depth, one for segmentation."""
    os.environ.setdefault("MUJOCO_GL", "osmesa")
    import mujoco

    first = workload.frames[0]["cameras"]
    assets, bodies = [], []
    for body in workload.bodies:
        name, color = body["segment_id"], " ".join(map(str, body["color"]))
        file = workload.file(body)
        assets.append(f'<mesh name="m{name}" file="{file}" inertia="shell"/>')
        bodies.append(
            f'<body name="b{name}" mocap="true"><geom type="mesh" mesh="m{name}" contype="0"'
            f' conaffinity="0" rgba="{color}"/></body>'
        )
    for number, camera in enumerate(first):
        fovy = np.degrees(2 * np.arctan(camera["height"] / 2 / camera["K"][1][1]))
        bodies.append(
            f'<body name="c{number}" mocap="true"><camera name="c{number}" fovy="{fovy}"/></body>'
        )
    near, far = first[0]["near_m"], first[0]["far_m"]
    model = mujoco.MjModel.from_xml_string(
        f'<mujoco><statistic extent="1"/><visual><map znear="{near}" zfar="{far}"/>'
        f'<quality shadowsize="0" offsamples="0"/></visual><asset>{"".join(assets)}</asset>'
        f'<worldbody><light directional="true" dir="-.3 -.2 -.9" castshadow="false"/>'
        f"{''.join(bodies)}</worldbody></mujoco>"
    )
    data = mujoco.MjData(model)
    width, height = first[0]["width"], first[0]["height"]
    context = mujoco.GLContext(width, height)
    context.make_current()
    drawing = mujoco.MjrContext(model, mujoco.mjtFontScale.mjFONTSCALE_100)
    mujoco.mjr_setBuffer(mujoco.mjtFramebuffer.mjFB_OFFSCREEN, drawing)
    scene = mujoco.MjvScene(model, maxgeom=10 * len(bodies))
    for flag in (mujoco.mjtRndFlag.mjRND_SHADOW, mujoco.mjtRndFlag.mjRND_REFLECTION):
        scene.flags[flag] = False
    option, view = mujoco.MjvOption(), mujoco.MjvCamera()
    view.type = mujoco.mjtCamera.mjCAMERA_FIXED
    viewport = mujoco.MjrRect(0, 0, width, height)
    rgb, depth = np.zeros((height, width, 3), np.uint8), np.zeros((height, width), np.float32)
    segments = np.zeros_like(rgb)
    # OpenGL's cameras look along -z with y up: half a turn about x.
    placed = -1

    def shot(frame: int, camera: int) -> NDArray[np.float32]:
        nonlocal placed
        state = workload.frames[frame]
        if placed != frame:
            poses = state["world_from_body"] + [
                values["world_from_camera"] for values in state["cameras"]
            ]
            for place, pose in enumerate(poses):
                w, x, y, z = pose[3:]
                is_camera = place >= len(state["world_from_body"])
                data.mocap_pos[place] = pose[:3]
                data.mocap_quat[place] = [-x, w, z, -y] if is_camera else [w, x, y, z]
            mujoco.mj_forward(model, data)
            placed = frame
        # Also keeps it alive.
        context.make_current()
        view.fixedcamid = camera
        mujoco.mjv_updateScene(model, data, option, None, view, mujoco.mjtCatBit.mjCAT_ALL, scene)
        mujoco.mjr_render(viewport, scene, drawing)
        mujoco.mjr_readPixels(rgb, depth, viewport, drawing)
        for flag in (mujoco.mjtRndFlag.mjRND_SEGMENT, mujoco.mjtRndFlag.mjRND_IDCOLOR):
            scene.flags[flag] = True
        mujoco.mjr_render(viewport, scene, drawing)
        mujoco.mjr_readPixels(segments, None, viewport, drawing)
        for flag in (mujoco.mjtRndFlag.mjRND_SEGMENT, mujoco.mjtRndFlag.mjRND_IDCOLOR):
            scene.flags[flag] = False
        linear = near / (1 - depth[::-1] * (1 - near / far))
        return np.where(depth[::-1] < 1, linear, 0).ravel()

    return shot


def pybullet_shot(workload: Workload) -> Shot:
    """PyBullet's TinyRenderer."""
    import pybullet

    client = pybullet.connect(pybullet.DIRECT)
    bodies = []
    for body in workload.bodies:
        shape = pybullet.createVisualShape(
            pybullet.GEOM_MESH, fileName=str(workload.file(body)), rgbaColor=body["color"]
        )
        bodies.append(pybullet.createMultiBody(baseVisualShapeIndex=shape))
    placed = -1

    def shot(frame: int, camera: int) -> NDArray[np.float32]:
        nonlocal placed
        state = workload.frames[frame]
        if placed != frame:
            for body, pose in zip(bodies, state["world_from_body"], strict=True):
                pybullet.resetBasePositionAndOrientation(body, pose[:3], [*pose[4:], pose[3]])
            placed = frame
        values = state["cameras"][camera]
        pose, near, far = values["world_from_camera"], values["near_m"], values["far_m"]
        axes = rotation(pose)
        view = pybullet.computeViewMatrix(pose[:3], list(pose[:3] + axes[:, 2]), list(-axes[:, 1]))
        width, height = values["width"], values["height"]
        fov = np.degrees(2 * np.arctan(height / 2 / values["K"][1][1]))
        projection = pybullet.computeProjectionMatrixFOV(fov, width / height, near, far)
        _, _, _, depth, _ = pybullet.getCameraImage(
            width,
            height,
            view,
            projection,
            shadow=0,
            renderer=pybullet.ER_TINY_RENDERER,
            physicsClientId=client,
        )
        depth = np.asarray(depth).reshape(-1)
        return np.where(depth < 1, far * near / (far - (far - near) * depth), 0)

    return shot


def work(peer: str, folder: Path, repeats: int) -> dict:
    """Loads the workload into a renderer and measures it."""
    workload = Workload.load(folder)
    name, *pack = peer.split()
    if name == "sapien":
        shot = sapien_shot(workload, pack[0])
    else:
        shot = {"mujoco": mujoco_shot, "pybullet": pybullet_shot}[name](workload)
    images = [
        (frame, camera)
        for frame in range(len(workload.frames))
        for camera in range(len(workload.frames[frame]["cameras"]))
    ]
    agreeing = []
    for frame, camera in images:
        expected, found = workload.depth(frame, camera), shot(frame, camera)
        agreeing.append((np.abs(expected - found) < AGREEMENT_M)[expected > 0].mean())
    taken = []
    for _ in range(repeats):
        started = time.process_time()
        for frame, camera in images:
            shot(frame, camera)
        taken.append(1e3 * (time.process_time() - started) / len(images))
    return {"cpu_ms_per_image": float(np.median(taken)), "agrees": float(np.mean(agreeing))}


def measure_peer(peer: str, folder: Path, repeats: int) -> dict:
    """A peer's numbers, or what went wrong."""
    command = [sys.executable, __file__, "--worker", peer, str(folder)]
    done = subprocess.run(
        [*command, "--repeats", str(repeats)],
        capture_output=True,
        text=True,
        check=False,
        timeout=900,
    )
    # Libraries print what they like, also at exit.
    lines = [line for line in done.stdout.splitlines() if line.startswith("{")]
    if done.returncode == 0 and lines:
        return json.loads(lines[-1])
    reason = (done.stderr.strip().splitlines() or ["no message"])[-1]
    return {"error": reason}


def akrobat(arguments: argparse.Namespace, *options: str) -> dict:
    """Runs `akrobat bench render`."""
    command = [arguments.akrobat, "--json", "bench", "render", *options]
    for assets in arguments.assets:
        command += ["--assets", str(assets)]
    return json.loads(subprocess.run(command, capture_output=True, text=True, check=True).stdout)


def text(rows: dict[str, dict], scene: str, triangles: int) -> str:
    """The table, for people."""
    lines = [
        f"{scene}, {triangles} triangles; {platform.machine()}, {os.cpu_count()} cores",
        f"{'renderer':16} {'CPU ms/image':>12} {'x soft':>7} {'agrees':>7}",
    ]
    soft = rows["soft"]["cpu_ms_per_image"]
    for name, row in rows.items():
        if "error" in row:
            lines.append(f"{name:16} not measured: {row['error']}")
            continue
        ms = row["cpu_ms_per_image"]
        agrees = f"{row['agrees']:7.1%}" if "agrees" in row else ""
        lines.append(f"{name:16} {ms:12.2f} {ms / soft:7.1f} {agrees}")
    return "\n".join(lines)


def main() -> int:
    """Measures everything."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawTextHelpFormatter
    )
    beside = Path(sys.executable).parent / "akrobat"
    parser.add_argument("--assets", type=Path, action="append", default=[], help="asset folder")
    parser.add_argument("--akrobat", default=str(beside), help="the command to measure")
    parser.add_argument("--peers", nargs="*", default=PEERS, help="peers to measure")
    parser.add_argument("--repeats", type=int, default=5, help="measurements; their median counts")
    parser.add_argument("--json", action="store_true", help="print JSON")
    parser.add_argument("--worker", nargs=2, metavar=("PEER", "DIR"), help=argparse.SUPPRESS)
    arguments = parser.parse_args()
    if arguments.worker:
        peer, folder = arguments.worker
        print(json.dumps(work(peer, Path(folder), arguments.repeats)))
        return 0
    measured = akrobat(arguments, "--repeats", str(arguments.repeats), "--wgpu")
    reduced = measured["scenes"][-1]["detail_auto"]
    rows = {
        "soft": measured["soft"],
        "soft auto": {**reduced, "agrees": reduced["depth_within_2_mm"]},
        "wgpu": measured["wgpu"],
    }
    with tempfile.TemporaryDirectory() as folder:
        akrobat(arguments, "--export", folder)
        for peer in arguments.peers:
            print(f"{peer} ...", file=sys.stderr)
            rows[peer] = measure_peer(peer, Path(folder), arguments.repeats)
    soft = rows["soft"]
    if arguments.json:
        print(json.dumps(rows, indent=1))
    else:
        print(text(rows, soft["scene"], soft["triangles"]))
    return 1 if any("error" in row for row in rows.values()) else 0


if __name__ == "__main__":
    sys.exit(main())
