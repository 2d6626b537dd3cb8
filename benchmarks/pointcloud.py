"""Clouds of 4,096 points from three depth images, against fpsample and Open3D, in one run.

    .venv/bin/pip install fpsample 'open3d<0.20'
    .venv/bin/python benchmarks/pointcloud.py --assets ASSETS

A trajectory is planned and rendered; at some of its frames, the three cameras' depth images
(230,400 pixels) become a cloud. Times are CPU milliseconds (user and system, all threads) of the
fastest of several runs. The coverage radius is the distance of the point farthest from the cloud,
over all pixels, relative to that of exact farthest-point sampling.
"""

from __future__ import annotations

import argparse
import json
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import akrobat
import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

POINTS = 4096
REPEATS = 5
TASK = Path(__file__).parents[1] / "configs" / "tasks" / "summit_drawer_kitchen.toml"


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawTextHelpFormatter
    )
    parser.add_argument("--assets", type=Path, action="append", default=[])
    parser.add_argument("--trajectories", type=Path, help="instead of planning one")
    parser.add_argument("--frames", type=int, default=3)
    parser.add_argument("--json", action="store_true")
    arguments = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        frames = depth_frames(Path(folder), arguments)
    results = [measure(*frame) for frame in frames]
    names = results[0].keys()
    summary = {
        name: {key: float(np.mean([r[name][key] for r in results])) for key in results[0][name]}
        for name in names
    }
    report = {"points": POINTS, "pixels": int(frames[0][0].size), "methods": summary}
    if arguments.json:
        json.dump(report, sys.stdout, indent=2)
        return
    print(f"{report['pixels']} pixels -> {POINTS} points, mean of {len(frames)} frames")
    for name, result in summary.items():
        print(f"{name:34} {result['cpu_ms']:9.1f} CPU-ms   coverage {result['coverage']:.3f}")


def depth_frames(folder: Path, arguments: argparse.Namespace) -> list[tuple[NDArray[Any], ...]]:
    """Depth `[3, H, W]`, K and poses at some frames of an episode."""
    source = arguments.trajectories
    if source is None:
        source = folder / "trajectories.h5"
        akrobat.plan(TASK, source, limit=1, assets=arguments.assets, quiet=True)
    dataset = akrobat.render(
        source,
        folder / "dataset",
        backend="soft",
        cloud={"points": 0},
        episodes=[0],
        assets=arguments.assets,
        quiet=True,
    )
    episode = dataset.episodes[0]
    cameras = ["ego_topdown", "ego_wrist", "fixed"]

    def stacked(name: str, frame: int) -> NDArray[Any]:
        return np.stack([episode[f"camera_obs/{camera}_{name}"][frame] for camera in cameras])

    count = len(episode["time"])
    places = [round((i + 1) * count / (arguments.frames + 1)) for i in range(arguments.frames)]
    return [
        (
            stacked("depth", f)[..., 0].astype(np.float32) * 1e-3,
            stacked("intrinsics", f),
            stacked("world_from_camera", f),
        )
        for f in places
    ]


def measure(
    depth_m: NDArray[np.float32], k: NDArray[np.float64], poses: NDArray[np.float64]
) -> dict[str, dict[str, float]]:
    """CPU time and coverage of each method on one frame."""
    points = world_points(depth_m, k, poses)
    exact = akrobat.farthest_points(points, POINTS)
    radius = coverage_radius(points, points[exact])
    methods: dict[str, Callable[[], NDArray[Any]]] = {
        "akrobat, from depth images": lambda: akrobat.fuse(depth_m, k, poses, {"points": POINTS}),
        "akrobat, sampling alone": lambda: points[akrobat.farthest_points(points, POINTS)],
        "akrobat, voxels": lambda: akrobat.fuse(
            depth_m, k, poses, {"points": POINTS, "sampling": "voxel"}
        ),
    }
    try:
        import fpsample

        methods["fpsample, bucket h=7"] = lambda: points[
            fpsample.bucket_fps_kdline_sampling(points, POINTS, h=7)
        ]
    except ImportError:
        print("fpsample is not installed: pip install fpsample", file=sys.stderr)
    try:
        import open3d

        cloud = open3d.geometry.PointCloud(open3d.utility.Vector3dVector(points.astype(np.float64)))
        methods["Open3D, farthest_point_down_sample"] = lambda: np.asarray(
            cloud.farthest_point_down_sample(POINTS).points
        )
    except ImportError:
        print("Open3D is not installed: pip install open3d", file=sys.stderr)
    results = {}
    for name, method in methods.items():
        slow = name.startswith("Open3D")
        seconds, chosen = fastest(method, 1 if slow else REPEATS)
        results[name] = {
            "cpu_ms": 1e3 * seconds,
            "coverage": coverage_radius(points, chosen) / radius,
        }
    return results


def fastest(method: Callable[[], NDArray[Any]], repeats: int) -> tuple[float, NDArray[Any]]:
    best, result = np.inf, None
    for _ in range(repeats):
        started = time.process_time()
        result = method()
        best = min(best, time.process_time() - started)
    assert result is not None
    return float(best), result


def world_points(
    depth_m: NDArray[np.float32], k: NDArray[np.float64], poses: NDArray[np.float64]
) -> NDArray[np.float32]:
    """All valid pixels as points of the world `[N, 3]`."""
    clouds = []
    for depth, matrix, pose in zip(depth_m, k, poses, strict=True):
        rows, columns = np.nonzero(depth)
        pixels = np.stack([columns + 0.5, rows + 0.5, np.ones(len(rows))])
        in_camera = np.linalg.inv(matrix) @ pixels * depth[rows, columns]
        clouds.append((pose[:3, :3] @ in_camera + pose[:3, 3:]).T)
    return np.concatenate(clouds).astype(np.float32)


def coverage_radius(points: NDArray[np.float32], chosen: NDArray[Any]) -> float:
    distance, _ = cKDTree(chosen).query(points)
    return float(distance.max())


if __name__ == "__main__":
    main()
