"""Triangles of USD's shapes."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

Points = NDArray[np.float64]
Triangles = NDArray[np.int64]

#: Sides of tessellated cylinders, cones and spheres, and rings of half a circle.
SIDES = 24
RINGS = 12


def triangles_of(prim: Any) -> tuple[Points, Triangles] | None:
    """Points `[N, 3]` in the prim's own frame and units, and triangles `[M, 3]`, counter-clockwise
    seen from outside; none of shapes that are not read (curves, patches, point clouds)."""
    from pxr import UsdGeom

    if prim.IsA(UsdGeom.Mesh):
        return _mesh(UsdGeom.Mesh(prim))
    if prim.IsA(UsdGeom.Cube):
        half = float(UsdGeom.Cube(prim).GetSizeAttr().Get()) / 2.0
        corner = half * np.sqrt(2.0)
        return _turned([(-half, corner), (half, corner)], sides=4, first=np.pi / 4)
    if prim.IsA(UsdGeom.Sphere):
        radius = float(UsdGeom.Sphere(prim).GetRadiusAttr().Get())
        return _turned(_arc(0.0, radius, -np.pi / 2, np.pi / 2, RINGS))
    for schema in (UsdGeom.Cylinder, UsdGeom.Cone, UsdGeom.Capsule):
        if prim.IsA(schema):
            shape = schema(prim)
            radius, half = float(shape.GetRadiusAttr().Get()), shape.GetHeightAttr().Get() / 2.0
            profile = [(-half, radius), (half, 0.0 if schema is UsdGeom.Cone else radius)]
            if schema is UsdGeom.Capsule:
                profile = _arc(-half, radius, -np.pi / 2, 0.0, RINGS // 2)
                profile += _arc(half, radius, 0.0, np.pi / 2, RINGS // 2)
            return _turned(profile, axis=str(shape.GetAxisAttr().Get()))
    return None


def _mesh(mesh: Any) -> tuple[Points, Triangles]:
    from pxr import UsdGeom

    points = np.array(mesh.GetPointsAttr().Get() or [], dtype=float).reshape(-1, 3)
    corners = np.array(mesh.GetFaceVertexIndicesAttr().Get() or [], dtype=np.int64)
    counts = np.array(mesh.GetFaceVertexCountsAttr().Get() or [], dtype=np.int64)
    starts = np.concatenate([[0], np.cumsum(counts)[:-1]]) if len(counts) else counts
    fans = [
        np.stack(
            [
                corners[starts[counts > place + 1]],
                corners[starts[counts > place + 1] + place],
                corners[starts[counts > place + 1] + place + 1],
            ],
            axis=1,
        )
        for place in range(1, int(counts.max(initial=2)) - 1)
    ]
    triangles = np.concatenate(fans) if fans else np.zeros((0, 3), np.int64)
    if mesh.GetOrientationAttr().Get() == UsdGeom.Tokens.leftHanded:
        triangles = triangles[:, ::-1]
    return points, triangles


def _arc(height: float, radius: float, first: float, last: float, rings: int) -> list[Any]:
    angles = np.linspace(first, last, rings + 1)
    return [(height + radius * np.sin(a), radius * np.cos(a)) for a in angles]


def _turned(
    profile: list[Any], sides: int = SIDES, first: float = 0.0, axis: str = "Z"
) -> tuple[Points, Triangles]:
    """A profile of (height, radius) turned about an axis, closed at both ends."""
    angles = first + 2.0 * np.pi * np.arange(sides) / sides
    circle = np.stack([np.cos(angles), np.sin(angles)], axis=1)
    rings = [np.column_stack([r * circle, np.full(sides, z)]) for z, r in profile]
    points = np.concatenate([*rings, [[0, 0, profile[0][0]], [0, 0, profile[-1][0]]]])
    side = np.arange(sides)
    following = (side + 1) % sides
    triangles = []
    for ring in range(len(profile) - 1):
        a, b = ring * sides + side, ring * sides + following
        triangles += [np.stack([a, b, b + sides], 1), np.stack([a, b + sides, a + sides], 1)]
    last, bottom, top = (len(profile) - 1) * sides, len(points) - 2, len(points) - 1
    triangles.append(np.stack([np.full(sides, bottom), following, side], 1))
    triangles.append(np.stack([np.full(sides, top), last + side, last + following], 1))
    whole = np.concatenate(triangles)
    corners = points[whole]
    sizes = np.linalg.norm(
        np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1
    )
    # Poles and tips are rings without extent.
    whole = whole[sizes > 1e-12]
    order = {"X": [2, 0, 1], "Y": [1, 2, 0], "Z": [0, 1, 2]}[axis]
    return points[:, order], whole


def write_obj(path: Path, points: Points, triangles: Triangles) -> None:
    """A mesh as OBJ."""
    lines = [f"v {x:.9g} {y:.9g} {z:.9g}" for x, y, z in points]
    lines += [f"f {a + 1} {b + 1} {c + 1}" for a, b, c in triangles]
    path.write_text("\n".join(lines) + "\n")
