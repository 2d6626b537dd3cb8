"""Collision shapes: meshes as convex pieces, kept by content hash, with their error measured."""

from __future__ import annotations

import hashlib
import os
import sys
import tempfile
from dataclasses import dataclass
from enum import Enum
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

Points = NDArray[np.float32]
Triangles = NDArray[np.uint32]

# Part of the cache's key: raised when the same mesh would give other pieces.
ALGORITHM = "akrobat-convex-1"


class Detail(Enum):
    """How closely pieces follow a mesh."""

    HULL = "hull"
    """the hull of each component: the robot's own links, whose files are made of convex shapes"""
    COARSE = "coarse"
    """frames, doors, drawers"""
    FINE = "fine"
    """what fingers close on"""


# CoACD's concavity threshold and largest number of pieces.
CONCAVITY = {Detail.COARSE: 0.06, Detail.FINE: 0.02}
MAX_PIECES = {Detail.COARSE: 16, Detail.FINE: 32}

# More components than this become one hull.
MAX_COMPONENTS = 64

# A component is convex where no vertex lies further than this outside any face's plane.
CONVEX_TOLERANCE_M = 5e-4
SURFACE_SAMPLES = 4000


@dataclass(frozen=True)
class ConvexPieces:
    """Convex pieces that stand for a mesh, in the mesh's frame."""

    pieces: list[Points]
    """vertices of each piece `[V, 3]`, metres"""
    missing_m: float
    """95th percentile of the distance from the mesh's surface to the pieces: what is left out"""
    protrusion_m: float
    """95th percentile of the distance from the pieces' outer surface to the mesh's: what is
    added"""


def convex_pieces(positions: Points, triangles: Triangles, detail: Detail) -> ConvexPieces:
    """Decomposes a mesh, or remembers how it was decomposed before.

    :param positions: vertices `[V, 3]`, metres
    :param triangles: vertex indices `[T, 3]`
    :param detail: how closely the pieces follow it
    """
    digest = hashlib.sha256(f"{ALGORITHM} {detail.value}".encode())
    digest.update(np.ascontiguousarray(positions, "<f4").tobytes())
    digest.update(np.ascontiguousarray(triangles, "<u4").tobytes())
    file = cache_folder() / f"{digest.hexdigest()}.npz"
    cached = _read(file)
    if cached is None:
        cached = _decompose(positions, triangles, detail)
        _write(file, cached)
    return cached


def cache_folder() -> Path:
    """Where decompositions are kept: `$AKROBAT_CACHE_DIR`, else the user's cache folder."""
    if folder := os.environ.get("AKROBAT_CACHE_DIR"):
        return Path(folder) / "collision"
    if folder := os.environ.get("XDG_CACHE_HOME"):
        return Path(folder) / "akrobat" / "collision"
    if sys.platform == "darwin":
        return Path.home() / "Library" / "Caches" / "akrobat" / "collision"
    if folder := os.environ.get("LOCALAPPDATA"):
        return Path(folder) / "akrobat" / "collision"
    return Path.home() / ".cache" / "akrobat" / "collision"


def _read(file: Path) -> ConvexPieces | None:
    try:
        with np.load(file) as stored:
            ends = np.cumsum(stored["counts"])[:-1]
            pieces = np.split(stored["vertices"], ends)
            missing_m, protrusion_m = stored["errors"]
    except (OSError, KeyError, ValueError, EOFError):
        return None
    return ConvexPieces(pieces, float(missing_m), float(protrusion_m))


def _write(file: Path, pieces: ConvexPieces) -> None:
    """Best effort: without a cache, the next run decomposes again."""
    try:
        file.parent.mkdir(parents=True, exist_ok=True)
        with tempfile.NamedTemporaryFile(dir=file.parent, suffix=".npz", delete=False) as temporary:
            np.savez(
                temporary,
                vertices=np.concatenate(pieces.pieces),
                counts=np.array([len(piece) for piece in pieces.pieces]),
                errors=np.array([pieces.missing_m, pieces.protrusion_m]),
            )
        os.replace(temporary.name, file)
    except OSError:
        return


def _decompose(positions: Points, triangles: Triangles, detail: Detail) -> ConvexPieces:
    pieces: list[Points] = []
    components = _components(positions, triangles)
    if len(components) > MAX_COMPONENTS:
        components = [(positions, triangles)]
    for vertices, faces in components:
        if detail is Detail.HULL or _is_convex(vertices, faces):
            pieces.append(vertices)
        else:
            pieces.extend(_coacd(vertices, faces, detail))
    pieces = [piece for piece in map(_hull_vertices, pieces) if piece is not None]
    missing_m, protrusion_m = _errors(pieces, positions, triangles)
    return ConvexPieces(pieces, missing_m, protrusion_m)


def _coacd(vertices: Points, faces: Triangles, detail: Detail) -> list[Points]:
    import coacd

    coacd.set_log_level("error")
    found: list[Any] = coacd.run_coacd(
        coacd.Mesh(vertices, faces),
        threshold=CONCAVITY[detail],
        max_convex_hull=MAX_PIECES[detail],
        resolution=500,
        mcts_iterations=20,
        mcts_nodes=10,
        mcts_max_depth=2,
        preprocess_resolution=30,
        seed=0,
    )
    return [np.asarray(piece, np.float32) for piece, _ in found]


def _components(positions: Points, triangles: Triangles) -> list[tuple[Points, Triangles]]:
    """The pieces of a mesh that hang together, with vertices at the same place made one."""
    vertices, inverse = np.unique(np.round(positions, 6), axis=0, return_inverse=True)
    faces = inverse.reshape(-1)[triangles]
    distinct = (faces[:, 0] != faces[:, 1]) & (faces[:, 1] != faces[:, 2])
    faces = faces[distinct & (faces[:, 2] != faces[:, 0])]
    label = np.arange(len(vertices))
    while True:
        least = label[faces].min(axis=1)
        before = label.copy()
        np.minimum.at(label, faces.reshape(-1), np.repeat(least, 3))
        label = label[label]
        if np.array_equal(label, before):
            break
    face_label = label[faces[:, 0]]
    components = []
    for component in np.unique(face_label):
        chosen = faces[face_label == component]
        used, local = np.unique(chosen, return_inverse=True)
        components.append(
            (vertices[used].astype(np.float32), local.reshape(-1, 3).astype(np.uint32))
        )
    return components


def _is_convex(vertices: Points, faces: Triangles) -> bool:
    corners = vertices[faces].astype(np.float64)
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    lengths = np.linalg.norm(normals, axis=1)
    flat = lengths > 1e-12
    normals = normals[flat] / lengths[flat, None]
    offsets = np.einsum("ij,ij->i", normals, corners[flat, 0])
    for first in range(0, len(normals), 256):
        chunk = slice(first, first + 256)
        height = vertices @ normals[chunk].T - offsets[chunk]
        # Files disagree on which side is out: one side of each face must be empty.
        if np.minimum(height.max(axis=0), -height.min(axis=0)).max(initial=0) > CONVEX_TOLERANCE_M:
            return False
    return True


def _hull_vertices(points: Points) -> Points | None:
    """Corners of the convex hull; thickened where flat, `None` where it is a mere line."""
    from scipy.spatial import ConvexHull, QhullError

    points = np.asarray(points, np.float64)
    extent = np.ptp(points, axis=0) if len(points) else np.zeros(3)
    if np.sort(extent)[1] < 1e-5:
        return None
    try:
        return points[ConvexHull(points).vertices].astype(np.float32)
    except QhullError:
        centred = points - points.mean(axis=0)
        normal = np.linalg.svd(centred, full_matrices=False)[2][-1]
        points = np.concatenate([points - 5e-4 * normal, points + 5e-4 * normal])
        try:
            return points[ConvexHull(points).vertices].astype(np.float32)
        except QhullError:
            return None


def _errors(pieces: list[Points], positions: Points, triangles: Triangles) -> tuple[float, float]:
    from scipy.spatial import ConvexHull, cKDTree

    if not pieces:
        return float("inf"), 0.0
    rng = np.random.default_rng(0)
    surface, source = _sample_with_source(positions, triangles, 5 * SURFACE_SAMPLES, rng)
    hulls = [ConvexHull(piece.astype(np.float64)) for piece in pieces]
    outside = _distance_outside(hulls, surface[:SURFACE_SAMPLES])
    missing_m = float(np.quantile(outside, 0.95))
    per_piece = max(SURFACE_SAMPLES // len(hulls), 50)
    nearest = cKDTree(surface)
    corners = positions.astype(np.float64)[triangles]
    added = []
    for number, hull in enumerate(hulls):
        samples = sample_surface(hull.points, hull.simplices, per_piece, rng)
        others = hulls[:number] + hulls[number + 1 :]
        # What another piece covers, or a cut between two pieces, is not seen from outside.
        if others:
            samples = samples[_distance_outside(others, samples) > 1e-4]
        if len(samples):
            candidates = source[nearest.query(samples, k=8)[1]]
            distances = _distance_to_triangles(samples[:, None, :], corners[candidates])
            added.append(distances.min(axis=1))
    protrusion_m = float(np.quantile(np.concatenate(added), 0.95)) if added else 0.0
    return missing_m, protrusion_m


def _distance_to_triangles(
    points: NDArray[np.float64], corners: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Distances of points `[..., 3]` to triangles `[..., 3, 3]`: to the inside where the foot of
    the perpendicular lies there, else to the nearest edge."""
    a, b, c = corners[..., 0, :], corners[..., 1, :], corners[..., 2, :]
    normal = np.cross(b - a, c - a)
    length = np.linalg.norm(normal, axis=-1, keepdims=True)
    unit = normal / np.maximum(length, 1e-18)
    height = np.sum((points - a) * unit, axis=-1)
    inside = length[..., 0] > 1e-12
    distance = np.full(np.broadcast_shapes(points.shape, a.shape)[:-1], np.inf)
    for start, end in ((a, b), (b, c), (c, a)):
        edge, offset = end - start, points - start
        inside = inside & (np.sum(np.cross(edge, offset) * unit, axis=-1) >= 0.0)
        share = np.sum(offset * edge, axis=-1) / np.maximum(np.sum(edge * edge, axis=-1), 1e-18)
        foot = offset - np.clip(share, 0.0, 1.0)[..., None] * edge
        distance = np.minimum(distance, np.linalg.norm(foot, axis=-1))
    return np.where(inside, np.minimum(np.abs(height), distance), distance)


def _distance_outside(hulls: list[Any], points: NDArray[np.float64]) -> NDArray[np.float64]:
    """Height over the faces of the nearest hull, 0 inside: a lower bound of the distance."""
    least = np.full(len(points), np.inf)
    for hull in hulls:
        height = points @ hull.equations[:, :3].T + hull.equations[:, 3]
        np.minimum(least, height.max(axis=1), out=least)
    return np.maximum(least, 0.0)


def sample_surface(
    positions: NDArray[Any], triangles: NDArray[Any], count: int, rng: np.random.Generator
) -> NDArray[np.float64]:
    """Points drawn evenly from a surface `[count, 3]`."""
    return _sample_with_source(positions, triangles, count, rng)[0]


def _sample_with_source(
    positions: NDArray[Any], triangles: NDArray[Any], count: int, rng: np.random.Generator
) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """Points drawn evenly from a surface `[count, 3]`, and the triangles they lie on `[count]`."""
    corners = np.asarray(positions, np.float64)[np.asarray(triangles, np.int64)]
    a, b, c = corners[:, 0], corners[:, 1], corners[:, 2]
    areas = np.linalg.norm(np.cross(b - a, c - a), axis=1)
    total = areas.sum()
    weights = areas / total if total > 0 else np.full(len(areas), 1.0 / len(areas))
    chosen = rng.choice(len(areas), size=count, p=weights)
    u, v = rng.random((2, count, 1))
    root = np.sqrt(u)
    points = (1.0 - root) * a[chosen] + root * (1.0 - v) * b[chosen] + root * v * c[chosen]
    return points, chosen
