"""What a task's scene looks like to other people's code: yourdfpy, trimesh and Open3D.

Nothing here knows Akrobat: files are read by yourdfpy and trimesh, links are posed by yourdfpy's
forward kinematics, and rays are cast by Open3D (Embree).
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import open3d as o3d
import tomli
import trimesh
import yourdfpy
from numpy.typing import NDArray

Matrix = NDArray[np.float64]

Z_UP_FROM_Y_UP: Matrix = np.array([[1.0, 0, 0, 0], [0, 0, -1.0, 0], [0, 1.0, 0, 0], [0, 0, 0, 1.0]])


def matrix_from_pose(pose: NDArray[Any]) -> Matrix:
    """4 x 4 matrix of a pose `x y z qw qx qy qz`."""
    x, y, z, *quaternion = np.asarray(pose, dtype=np.float64)
    matrix: Matrix = trimesh.transformations.quaternion_matrix(quaternion)
    matrix[:3, 3] = x, y, z
    return matrix


class Articulation:
    """A robot or an object: a URDF whose links move with its joints."""

    def __init__(self, urdf: Path) -> None:
        self._urdf = yourdfpy.URDF.load(str(urdf), mesh_dir=str(urdf.parent))

    def world_from_link(
        self, link: str, joints: Mapping[str, float], world_from_root: Matrix
    ) -> Matrix:
        self._urdf.update_cfg(dict(joints))
        return np.asarray(world_from_root @ self._urdf.get_transform(link))

    def meshes(
        self, joints: Mapping[str, float], world_from_root: Matrix
    ) -> Iterator[tuple[str, trimesh.Trimesh, Matrix]]:
        """Visual meshes with the links they belong to and their poses in the world."""
        self._urdf.update_cfg(dict(joints))
        scene = self._urdf.scene
        for node in scene.graph.nodes_geometry:
            root_from_mesh, geometry = scene.graph.get(node)
            link = self._link_of(node)
            yield link, scene.geometry[geometry], world_from_root @ root_from_mesh

    def _link_of(self, node: str) -> str:
        parents = self._urdf.scene.graph.transforms.parents
        while node not in self._urdf.link_map:
            node = parents[node]
        return node


class StaticScene:
    """What a task's `[scene]` section describes: a glTF file and boxes."""

    def __init__(self, section: Mapping[str, Any], assets: Path) -> None:
        self.bodies: list[tuple[str, trimesh.Trimesh, Matrix]] = []
        loaded = trimesh.load_scene(assets / section["file"])
        floors = []
        for node in loaded.graph.nodes_geometry:
            file_from_mesh, geometry = loaded.graph.get(node)
            mesh, world_from_mesh = loaded.geometry[geometry], Z_UP_FROM_Y_UP @ file_from_mesh
            self.bodies.append((node, mesh, world_from_mesh))
            if section["floor"] in (node, geometry):
                points = trimesh.transform_points(mesh.vertices, world_from_mesh)
                floors.append(points[:, 2].max())
        assert floors, f"no body is called {section['floor']}"
        shift = np.array([*section["offset"], -max(floors)])
        for _, _, world_from_mesh in self.bodies:
            world_from_mesh[:3, 3] += shift
        for box in section["box"]:
            mesh = trimesh.creation.box(box["size"])
            self.bodies.append((box["name"], mesh, matrix_from_pose(box["pose"])))


class ExactScene:
    """All geometry of the task of an episode, posed as the episode's file says."""

    def __init__(self, task_toml: str, robot_urdf: Path, assets: Path) -> None:
        task = tomli.loads(task_toml)
        self.robot = Articulation(robot_urdf)
        self.object = Articulation(assets / task["object"]["urdf"])
        self.scene = StaticScene(task["scene"], assets)

    def posed(
        self,
        robot_joints: Mapping[str, float],
        world_from_robot: Matrix,
        object_joints: Mapping[str, float],
        world_from_object: Matrix,
    ) -> PosedScene:
        return PosedScene(
            [
                *self.robot.meshes(robot_joints, world_from_robot),
                *self.object.meshes(object_joints, world_from_object),
                *self.scene.bodies,
            ]
        )


class PosedScene:
    """All geometry at one instant."""

    def __init__(self, meshes: list[tuple[str, trimesh.Trimesh, Matrix]]) -> None:
        self._scene = o3d.t.geometry.RaycastingScene(nthreads=1)
        bodies: list[str] = []
        for body, mesh, world_from_mesh in meshes:
            vertices = trimesh.transform_points(mesh.vertices, world_from_mesh)
            self._scene.add_triangles(
                o3d.core.Tensor(vertices.astype(np.float32)),
                o3d.core.Tensor(mesh.faces.astype(np.uint32)),
            )
            bodies.append(body)
        names, numbers = np.unique(bodies, return_inverse=True)
        assert len(names) > 1
        # One more for rays that meet nothing.
        self._segment_of_mesh = np.append(numbers + 1, 0)

    def image(
        self,
        k: Matrix,
        world_from_camera: Matrix,
        size: tuple[int, int],
        near_m: float,
        far_m: float,
    ) -> tuple[Matrix, NDArray[np.int64]]:
        """z-depth in metres (0 where nothing is met) and body numbers at the centres of pixels."""
        height, width = size
        v, u = np.mgrid[:height, :width] + 0.5
        rays = np.stack([(u - k[0, 2]) / k[0, 0], (v - k[1, 2]) / k[1, 1], np.ones_like(u)], -1)
        directions = rays @ world_from_camera[:3, :3].T
        origins = world_from_camera[:3, 3] + near_m * directions
        cast = np.concatenate([origins, directions], -1).astype(np.float32)
        hits = self._scene.cast_rays(o3d.core.Tensor(cast), nthreads=1)
        # Directions have z = 1 in the camera's frame, so distances along them are z-depths.
        depth_m = hits["t_hit"].numpy().astype(np.float64) + near_m
        seen = depth_m <= far_m
        geometry = hits["geometry_ids"].numpy().astype(np.int64)
        count = len(self._segment_of_mesh) - 1
        segments = self._segment_of_mesh[np.where(seen, np.minimum(geometry, count), count)]
        return np.where(seen, depth_m, 0.0), segments

    def distances_m(self, points: NDArray[Any]) -> NDArray[np.float32]:
        """Distances of points `[N, 3]` of the world to the nearest surface."""
        tensor = o3d.core.Tensor(np.ascontiguousarray(points, dtype=np.float32))
        distances: NDArray[np.float32] = self._scene.compute_distance(tensor, nthreads=1).numpy()
        return distances


def inner_pixels(depth_m: Matrix, segments: NDArray[np.int64]) -> NDArray[np.bool_]:
    """Pixels away from silhouettes.

    One body covers the 3 x 3 neighbourhood, and on each of the four lines through its centre the
    surface is within a centimetre of a plane, on which inverse depth is affine.
    """
    seen = depth_m > 0
    padded = np.pad(segments, 1, mode="edge")
    inner = np.ones(depth_m.shape, dtype=bool)
    height, width = depth_m.shape
    for dv, du in [(0, 1), (1, 0), (1, 1), (1, -1)]:
        # The neighbours on both sides; pixels at the border have only one of them on some lines.
        first, second = (
            (slice(1 + s * dv, 1 + s * dv + height), slice(1 + s * du, 1 + s * du + width))
            for s in (-1, 1)
        )
        inner &= (padded[first] == segments) & (padded[second] == segments)
        depth = np.pad(depth_m, 1, mode="edge")
        a, b = depth[first], depth[second]
        both = seen & (a > 0) & (b > 0)
        with np.errstate(divide="ignore", invalid="ignore"):
            bend = np.abs(depth_m**2 * (1 / a + 1 / b - 2 / depth_m))
        smooth = np.where(both, bend <= 0.01, ~seen & (a == 0) & (b == 0))
        rows, columns = np.mgrid[:height, :width]
        has_both = (
            (rows - dv >= 0)
            & (rows + dv < height)
            & (columns - abs(du) >= 0)
            & (columns + abs(du) < width)
        )
        inner &= smooth | ~has_both
    return inner
