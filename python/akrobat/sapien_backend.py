"""Renders frames with SAPIEN: the high-fidelity backend of `akrobat render`.

The compiled half of the package calls :func:`require_sapien` once, makes one
:class:`SapienRenderer` per scene and calls :meth:`SapienRenderer.render` once per batch of frames.
Geometry follows the image model that all backends share (every triangle is opaque and seen from
both sides, one sample per pixel centre), so depth and segmentation agree with theirs; they are
those of the `minimal` shaders, whichever make the colours. Shading is SAPIEN's own: the same as
theirs for Lambert reflection, constant ambient light and no shadows.
"""

from __future__ import annotations

import math
import os
from pathlib import Path
from typing import Any, TypedDict

import numpy as np
from numpy.typing import NDArray

Images = tuple[NDArray[np.uint8], NDArray[np.float32], NDArray[np.uint16]]

# Of the path tracer. Its denoisers need a graphics card, and images should not depend on one.
RAY_TRACING_SAMPLES = 32
RAY_TRACING_DEPTH = 8

# SAPIEN's camera looks along +x with z up; ours along +z with y down. `[qw qx qy qz]`.
CAMERA_FROM_SAPIEN_CAMERA = (0.5, 0.5, -0.5, 0.5)


class Mesh(TypedDict):
    """Triangles of one material, metres, in the frame of their body."""

    positions: NDArray[np.float32]
    """`[V, 3]`"""
    triangles: NDArray[np.uint32]
    """`[T, 3]`"""
    normals: NDArray[np.float32] | None
    """`[V, 3]`, unit length"""
    uvs: NDArray[np.float32] | None
    """`[V, 2]`, v = 0 at the texture's top row"""
    base_color: tuple[float, float, float, float]
    """linear RGBA factor"""
    metallic_roughness: tuple[float, float] | None
    """`None` for matt surfaces"""
    texture: NDArray[np.uint8] | None
    """sRGB `[H, W, 4]`"""


class Body(TypedDict):
    """A rigid body."""

    name: str
    segment_id: int
    meshes: list[Mesh]


class Camera(TypedDict):
    """A camera whose pose comes with each frame."""

    width: int
    height: int
    K: tuple[tuple[float, float, float], ...]
    near_m: float
    far_m: float


class Light(TypedDict, total=False):
    """A light in the world frame."""

    kind: str
    """`directional`, `point` or `spot`"""
    rgb: tuple[float, float, float]
    """linear; what a white matt surface facing it reflects (at 1 m)"""
    shadow: bool
    direction: tuple[float, float, float]
    """to a directional light"""
    position: tuple[float, float, float]
    target: tuple[float, float, float]
    """what a spot is aimed at"""
    inner_deg: float
    outer_deg: float
    """angles from a spot's axis"""


class Lighting(TypedDict):
    """Lights, ambient light from above and below (linear RGB), background (sRGB)."""

    lights: list[Light]
    sky_rgb: tuple[float, float, float]
    ground_rgb: tuple[float, float, float]
    background_rgb: tuple[int, int, int]


def require_sapien() -> None:
    """Raises an error that says what to install where SAPIEN is missing."""
    try:
        import sapien  # noqa: F401
    except ImportError as error:
        raise RuntimeError(
            f"SAPIEN cannot be imported ({error}); install it with: pip install 'akrobat[sapien]'"
        ) from error


class SapienRenderer:
    """A scene loaded into SAPIEN.

    On machines without an NVIDIA card it draws with a software Vulkan driver; set
    `AKROBAT_SAPIEN_DEVICE` to any device string of SAPIEN's (`cpu`, `cuda:0`) to choose.
    """

    def __init__(
        self,
        bodies: list[Body],
        cameras: list[Camera],
        lighting: Lighting,
        shaders: str = "minimal",
    ) -> None:
        """
        :param shaders: the pack that makes the colours: `minimal`, `default` or `rt`
        """
        import sapien

        self._sapien = sapien
        try:
            self._system = sapien.render.RenderSystem(_device())
        except RuntimeError as error:
            raise RuntimeError(
                f"SAPIEN finds no usable Vulkan driver ({error}); on a machine without a graphics "
                'card, get a software driver with: eval "$(scripts/vulkan.sh)"'
            ) from error
        self._scene = sapien.Scene([self._system])
        self._background = np.asarray(lighting["background_rgb"], np.uint8)
        add_lighting(self._scene, lighting)
        self._bodies = [add_body(self._scene, body) for body in bodies]
        self._cameras = [self._add_camera(camera) for camera in cameras]
        self._color_cameras = self._cameras
        if shaders == "rt":
            sapien.render.set_ray_tracing_samples_per_pixel(RAY_TRACING_SAMPLES)
            sapien.render.set_ray_tracing_path_depth(RAY_TRACING_DEPTH)
            sapien.render.set_ray_tracing_denoiser("none")
        if shaders != "minimal":
            self._color_cameras = [self._add_camera(camera, shaders) for camera in cameras]
        self._planes = [(camera["near_m"], camera["far_m"]) for camera in cameras]
        self._segment_of_entity = self._segment_table(bodies)

    def render(
        self, world_from_body: NDArray[np.float64], world_from_camera: NDArray[np.float64]
    ) -> list[Images]:
        """Draws a batch of frames.

        :param world_from_body: `[F, bodies, 7]`, each `x y z qw qx qy qz`
        :param world_from_camera: `[F, cameras, 7]`, cameras looking along +z with y down
        :return: per camera sRGB colours `[F, H, W, 3]`, z-depth in metres `[F, H, W]` and segment
            ids `[F, H, W]`; depth and segment are 0 where nothing is seen
        """
        frames = len(world_from_body)
        images = [_empty_images(frames, camera) for camera in self._cameras]
        for frame in range(frames):
            for entity, pose in zip(self._bodies, world_from_body[frame], strict=True):
                entity.set_pose(sapien_pose(pose))
            for group in (self._cameras, self._color_cameras):
                for camera, pose in zip(group, world_from_camera[frame], strict=True):
                    camera.entity.set_pose(camera_pose(pose))
            self._scene.update_render()
            for index, camera in enumerate(self._cameras):
                camera.take_picture()
                rgb, depth, segment = images[index]
                self._read(camera, self._planes[index], depth[frame], segment[frame])
                color_camera = self._color_cameras[index]
                if color_camera is not camera:
                    color_camera.take_picture()
                rgb[frame] = self._color(color_camera, segment[frame] != 0)
        return images

    def _add_camera(self, camera: Camera, shaders: str = "minimal") -> Any:
        folder = Path(self._sapien.__file__).parent / "vulkan_shader" / shaders
        component = self._sapien.render.RenderCameraComponent(
            camera["width"], camera["height"], str(folder)
        )
        (fx, skew, cx), (_, fy, cy), _ = camera["K"]
        component.set_perspective_parameters(
            camera["near_m"], camera["far_m"], fx, fy, cx, cy, skew
        )
        entity = self._sapien.Entity()
        entity.add_component(component)
        self._scene.add_entity(entity)
        return component

    def _segment_table(self, bodies: list[Body]) -> NDArray[np.uint16]:
        """Segment id by SAPIEN's entity id."""
        entity_ids = [entity.per_scene_id for entity in self._bodies]
        table = np.zeros(max(entity_ids, default=0) + 1, np.uint16)
        table[entity_ids] = [body["segment_id"] for body in bodies]
        return table

    def _read(
        self,
        camera: Any,
        planes: tuple[float, float],
        depth_m: NDArray[np.float32],
        segment: NDArray[np.uint16],
    ) -> None:
        entity_id = camera.get_picture("PositionSegmentation")[..., 3]
        segment[:] = self._segment_of_entity[entity_id]
        # The depth buffer rather than the position image, which counts whole millimetres.
        z_depth = _z_depth(camera.get_picture("GbufferDepth"), *planes)
        depth_m[:] = np.where(segment != 0, z_depth, 0.0)

    def _color(self, camera: Any, seen: NDArray[np.bool_]) -> NDArray[np.uint8]:
        # SAPIEN encodes with a power of 2.2.
        linear = np.clip(camera.get_picture("Color")[..., :3], 0.0, 1.0) ** 2.2
        color = np.where(linear <= 0.0031308, 12.92 * linear, 1.055 * linear ** (1 / 2.4) - 0.055)
        rgb: NDArray[np.float64] = np.where(
            seen[..., None], np.rint(color * 255.0), self._background
        )
        return rgb.astype(np.uint8)


def sapien_pose(pose: NDArray[np.float64]) -> Any:
    """A pose `x y z qw qx qy qz` as SAPIEN's."""
    import sapien

    values = np.asarray(pose, np.float32)
    return sapien.Pose(values[:3], values[3:])


def camera_pose(world_from_camera: NDArray[np.float64]) -> Any:
    """Where SAPIEN's camera is, for a camera that looks along +z with y down."""
    import sapien

    turn = sapien.Pose([0.0, 0.0, 0.0], list(CAMERA_FROM_SAPIEN_CAMERA))
    return sapien_pose(world_from_camera) * turn


def add_lighting(scene: Any, lighting: Lighting) -> None:
    """Adds lights and ambient light to a SAPIEN scene."""
    # SAPIEN's ambient light has no direction: a horizontal surface's share of sky and ground.
    sky, ground = np.asarray(lighting["sky_rgb"]), np.asarray(lighting["ground_rgb"])
    scene.set_ambient_light(list(0.5 * (sky + ground)))
    for light in lighting["lights"]:
        _add_light(scene, light)


def _add_light(scene: Any, light: Light) -> None:
    # SAPIEN divides diffuse reflection by pi (radiometric units), the shared model does not.
    color = [math.pi * component for component in light["rgb"]]
    shadow = light["shadow"]
    if light["kind"] == "directional":
        direction = [-component for component in light["direction"]]
        scene.add_directional_light(direction, color, shadow=shadow)
    elif light["kind"] == "point":
        scene.add_point_light(light["position"], color, shadow=shadow)
    else:
        position = np.asarray(light["position"])
        # SAPIEN's angles are those of the whole cone.
        scene.add_spot_light(
            position,
            np.asarray(light["target"]) - position,
            math.radians(2.0 * light["inner_deg"]),
            math.radians(2.0 * light["outer_deg"]),
            color,
            shadow=shadow,
        )


def add_body(scene: Any, body: Body) -> Any:
    """Adds a body to a SAPIEN scene, and returns its entity."""
    import sapien

    component = sapien.render.RenderBodyComponent()
    for mesh in body["meshes"]:
        component.attach(_shape(mesh))
    entity = sapien.Entity()
    entity.set_name(body["name"])
    entity.add_component(component)
    scene.add_entity(entity)
    return entity


def _shape(mesh: Mesh) -> Any:
    import sapien

    positions, triangles, normals, uvs = _two_sided(mesh)
    material = sapien.render.RenderMaterial()
    material.base_color = [*mesh["base_color"][:3], 1.0]
    if mesh["metallic_roughness"] is None:
        material.metallic, material.roughness, material.specular = 0.0, 1.0, 0.0
    else:
        material.metallic, material.roughness = mesh["metallic_roughness"]
        # 4% at normal incidence.
        material.specular = 0.5
    if mesh["texture"] is not None and mesh["uvs"] is not None:
        # The "minimal" shaders take the texture instead of the factor, not times it.
        texture = _linear_texture(mesh["texture"], mesh["base_color"])
        material.base_color_texture = sapien.render.RenderTexture2D(texture, "R32G32B32A32Sfloat")
    return sapien.render.RenderShapeTriangleMesh(positions, triangles, normals, uvs, material)


def _device() -> str:
    has_nvidia_card = Path("/dev/nvidia0").exists()
    return os.environ.get("AKROBAT_SAPIEN_DEVICE", "cuda" if has_nvidia_card else "cpu")


def _empty_images(frames: int, camera: Any) -> Images:
    shape = (frames, camera.height, camera.width)
    return (
        np.empty((*shape, 3), np.uint8),
        np.empty(shape, np.float32),
        np.empty(shape, np.uint16),
    )


def _z_depth(buffer: NDArray[np.float32], near_m: float, far_m: float) -> NDArray[np.float64]:
    """Inverts the perspective depth of Vulkan: 0 on the near plane, 1 on the far plane."""
    return near_m * far_m / (far_m - buffer.astype(np.float64) * (far_m - near_m))


def _linear_texture(
    texture: NDArray[np.uint8], factor: tuple[float, float, float, float]
) -> NDArray[np.float32]:
    """Decodes sRGB (IEC 61966-2-1) and applies the factor; opaque."""
    encoded = np.arange(256) / 255.0
    decoded = np.where(
        encoded <= 0.04045, encoded / 12.92, ((encoded + 0.055) / 1.055) ** 2.4
    ).astype(np.float32)
    linear = np.ones(texture.shape, np.float32)
    linear[..., :3] = decoded[texture[..., :3]] * np.asarray(factor[:3], np.float32)
    return linear


def _two_sided(
    mesh: Mesh,
) -> tuple[NDArray[np.float32], NDArray[np.uint32], NDArray[np.float32], NDArray[np.float32]]:
    """Positions, triangles, normals and texture coordinates, with a back to every triangle (SAPIEN
    culls what faces away)."""
    positions, triangles = mesh["positions"], mesh["triangles"]
    normals, uvs = mesh["normals"], mesh["uvs"]
    if uvs is None:
        uvs = np.zeros((len(positions), 2), np.float32)
    if normals is None:
        corners = positions[triangles]
        positions, uvs = corners.reshape(-1, 3), uvs[triangles].reshape(-1, 2)
        normals = np.repeat(_face_normals(corners), 3, axis=0)
        triangles = np.arange(len(positions), dtype=np.uint32).reshape(-1, 3)
    backs = triangles[:, ::-1] + np.uint32(len(positions))
    return (
        np.concatenate([positions, positions]),
        np.concatenate([triangles, backs]),
        np.concatenate([normals, -normals]),
        np.concatenate([uvs, uvs]),
    )


def _face_normals(corners: NDArray[np.float32]) -> NDArray[np.float32]:
    """Unit normals of triangles `[T, 3, 3]`; up where a triangle has no area."""
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    lengths = np.linalg.norm(normals, axis=1, keepdims=True)
    up = np.array([0.0, 0.0, 1.0], np.float32)
    has_area = lengths > 0.0
    return np.where(has_area, normals / np.where(has_area, lengths, 1.0), up).astype(np.float32)
