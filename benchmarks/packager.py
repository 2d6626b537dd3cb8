"""Writing and reading real rendered episodes, beside the peers' writers, in one run.

    .venv/bin/python benchmarks/packager.py --assets ../shared/assets [--json] [--dataset FOLDER]

Renders two episodes of a furnished kitchen (or takes `--dataset`), then writes the first frames of
one of them repeatedly with

- `repack`: this project's writer (build it: `cargo build --release --example repack`),
- h5py with the same filters, chunks and checksums,
- h5py as robomimic's converters write: a compressed array for each observation, default chunks,
- LeRobot's own writer where `--lerobot PYTHON` names an interpreter that has it (its video is
  lossy, and of colours alone: the size is not comparable).

Then frames are read back, at random and in order, by a map-style loader through h5py, and by
LeRobot's dataset in PyTorch's DataLoader.

CPU time is user + system of all threads while they write. "raw" is RGB u8
and depth u16 alone, as the target counts it; segmentation and cloud are written by all and are in
no ratio.
"""

from __future__ import annotations

import argparse
import json
import resource
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import akrobat
import h5py
import numpy as np

ROOT = Path(__file__).resolve().parent.parent
TASK = ROOT / "configs" / "tasks" / "summit_drawer_kitchen.toml"
REPACK = ROOT / "target" / "release" / "examples" / "repack"
Arrays = dict[str, np.ndarray]


def cpu_seconds() -> float:
    usage = resource.getrusage(resource.RUSAGE_SELF)
    return usage.ru_utime + usage.ru_stime


def render(assets: Path, folder: Path) -> Path:
    trajectories = folder / "drawer.h5"
    akrobat.plan(TASK, trajectories, limit=2, assets=[assets], quiet=True)
    akrobat.render(
        trajectories,
        folder / "dataset",
        backend="soft",
        manipulation_only=True,
        assets=[assets],
        quiet=True,
    )
    return folder / "dataset"


def images_of(dataset: Path, frames: int) -> Arrays:
    """What takes space in the first episode: images and cloud."""
    episode = akrobat.open(dataset).episodes[0]
    names = [
        n
        for n in episode
        if n.startswith("camera_obs/") and n.endswith(("_rgb", "_depth", "_segmentation"))
    ]
    return {name: episode[name][:frames] for name in [*names, "point_cloud"]}


def ours(
    source: Path, folder: Path, codec: str, frames: int, *, copies: int, per_shard: int
) -> dict[str, Any]:
    """What `copies` more episodes than one take."""

    def run(count: int) -> tuple[dict[str, Any], int]:
        output = folder / f"{codec}_{count}_{per_shard}"
        command = [REPACK, source, output, codec, count, frames, per_shard]
        done = subprocess.run(list(map(str, command)), check=True, capture_output=True, text=True)
        size = sum(path.stat().st_size for path in (output / "shards").iterdir())
        return json.loads(done.stdout), size

    (one, size_one), (many, size_many) = run(1), run(1 + copies)
    return {
        "cpu_s": (many["cpu_s"] - one["cpu_s"]) / copies,
        "wall_s": (many["seconds"] - one["seconds"]) / copies,
        "bytes": (size_many - size_one) // copies,
        "peak_mb": many["peak_mb"],
    }


def measured(write: Callable[[Path], None], path: Path, copies: int) -> dict[str, Any]:
    cpu, wall = cpu_seconds(), time.perf_counter()
    for copy in range(copies):
        write(path.with_name(f"{path.stem}_{copy}{path.suffix}"))
    return {
        "cpu_s": (cpu_seconds() - cpu) / copies,
        "wall_s": (time.perf_counter() - wall) / copies,
        "bytes": path.with_name(f"{path.stem}_0{path.suffix}").stat().st_size,
    }


def h5py_same_filters(arrays: Arrays, path: Path) -> None:
    with h5py.File(path, "w", libver=("v110", "v110")) as file:
        for name, array in arrays.items():
            file.create_dataset(
                name,
                array.shape,
                array.dtype,
                chunks=(1, *array.shape[1:]),
                compression="gzip",
                compression_opts=4,
                shuffle=True,
                fletcher32=True,
            )
            for index, frame in enumerate(array):
                file[name][index] = frame


def robomimic_style(arrays: Arrays, path: Path) -> None:
    with h5py.File(path, "w") as file:
        for name, array in arrays.items():
            file.create_dataset(f"data/demo_0/obs/{name}", data=array, compression="gzip")


LEROBOT = """
import json, resource, sys, time
import numpy as np
from pathlib import Path
from lerobot.datasets.lerobot_dataset import LeRobotDataset
arrays = dict(np.load(sys.argv[1]))
output = Path(sys.argv[2])
names = [name for name in arrays if name.endswith("_rgb")]
features = {
    "observation.images." + name.split("/")[1]: {
        "dtype": "video", "shape": arrays[name].shape[1:], "names": ["height", "width", "channels"]
    } for name in names
}
dataset = LeRobotDataset.create("bench/bench", 30, features, root=output, use_videos=True)
before, wall = resource.getrusage(resource.RUSAGE_SELF), time.perf_counter()
for index in range(len(arrays[names[0]])):
    frame = {"observation.images." + n.split("/")[1]: arrays[n][index] for n in names}
    dataset.add_frame(frame | {"task": "open"})
dataset.save_episode()
after = resource.getrusage(resource.RUSAGE_SELF)
cpu = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
wall = time.perf_counter() - wall
dataset.finalize()
size = sum(p.stat().st_size for p in output.rglob("*") if p.is_file())
report = {"cpu_s": cpu, "wall_s": wall, "bytes": size}

import torch

def frames_a_second(indices):
    loader = torch.utils.data.DataLoader(dataset, batch_size=16, sampler=indices)
    before = resource.getrusage(resource.RUSAGE_SELF)
    for batch in loader:
        pass
    after = resource.getrusage(resource.RUSAGE_SELF)
    return len(indices) / (after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime)

torch.set_num_threads(1)
dataset = LeRobotDataset("bench/bench", root=output)
order = [int(i) for i in np.random.default_rng(0).integers(0, len(dataset), 64)]
frames_a_second(order[:8])
report["random_fps"] = frames_a_second(order)
report["sequential_fps"] = frames_a_second(list(range(len(dataset))))
print(json.dumps(report))
"""


def lerobot(python: str, arrays: Arrays, folder: Path) -> dict[str, Any]:
    np.savez(folder / "arrays.npz", **arrays)
    command = [python, "-c", LEROBOT, str(folder / "arrays.npz"), str(folder / "lerobot")]
    done = subprocess.run(command, check=True, capture_output=True, text=True)
    return json.loads(done.stdout.splitlines()[-1])


class Layout:
    """A map-style dataset, as PyTorch takes it, over the frames of one episode in an HDF5 file."""

    def __init__(self, file: h5py.File, group: str, endings: tuple[str, ...]) -> None:
        self._arrays = {n: file[group][n] for n in file[group] if n.endswith(endings)}

    def __len__(self) -> int:
        return len(next(iter(self._arrays.values())))

    def __getitem__(self, index: int) -> Arrays:
        return {name: array[index] for name, array in self._arrays.items()}


def frames_a_second(dataset: Layout, indices: list[int]) -> float:
    """Frames a CPU second, in batches of 16 that are stacked as a loader does."""
    before = cpu_seconds()
    for first in range(0, len(indices), 16):
        batch = [dataset[index] for index in indices[first : first + 16]]
        for name in batch[0]:
            np.stack([sample[name] for sample in batch])
    return len(indices) / (cpu_seconds() - before)


def reading(shard: Path, key: str, frames: int, peers: dict[str, Path]) -> dict[str, Any]:
    """Frames a CPU second, one at a time at random and all in order: colours of all cameras, and
    colours and depth."""
    order = [int(i) for i in np.random.default_rng(0).integers(0, frames, 64)]
    places = {"akrobat": (shard, f"data/{key}/camera_obs")}
    places |= {name: (path, "data/demo_0/obs/camera_obs") for name, path in peers.items()}
    result = {}
    for name, (path, group) in places.items():
        for what, endings in [("RGB", ("_rgb",)), ("RGB and depth", ("_rgb", "_depth"))]:
            with h5py.File(path) as file:
                dataset = Layout(file, group, endings)
                result[f"{name}, {what}"] = {
                    "random_fps": frames_a_second(dataset, order),
                    "sequential_fps": frames_a_second(dataset, list(range(frames))),
                }
    return result


def main() -> int:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--assets", type=Path, default=ROOT.parent / "shared" / "assets")
    parser.add_argument("--dataset", type=Path, help="an HDF5 dataset that exists already")
    parser.add_argument(
        "--frames", type=int, default=30, help="frames of the episode that is written"
    )
    parser.add_argument("--copies", type=int, default=4)
    parser.add_argument("--large", type=int, default=100, help="episodes of the large shard")
    parser.add_argument("--lerobot", help="a Python interpreter that has lerobot")
    parser.add_argument("--json", action="store_true")
    arguments = parser.parse_args()
    with tempfile.TemporaryDirectory() as temporary:
        folder = Path(temporary)
        source = arguments.dataset or render(arguments.assets, folder)
        arrays = images_of(source, arguments.frames)
        raw = sum(a.nbytes for n, a in arrays.items() if n.endswith(("_rgb", "_depth")))
        rows = {
            f"akrobat {codec}": ours(
                source, folder, codec, arguments.frames, copies=arguments.copies, per_shard=50
            )
            for codec in ("gzip", "lz4", "zstd", "blosc")
        }
        rows["h5py, same filters"] = measured(
            lambda path: h5py_same_filters(arrays, path), folder / "same.h5", arguments.copies
        )
        rows["h5py, as robomimic"] = measured(
            lambda path: robomimic_style(arrays, path), folder / "robomimic.h5", arguments.copies
        )
        if arguments.lerobot:
            rows["LeRobot (lossy video of RGB)"] = lerobot(arguments.lerobot, arrays, folder)
        large = ours(source, folder, "gzip", 8, copies=arguments.large, per_shard=10**6)
        rgb_depth = {n: a for n, a in arrays.items() if n.endswith(("_rgb", "_depth"))}
        h5py_same_filters(rgb_depth, folder / "ratio.h5")
        shard = min((source / "shards").glob("*.hdf5"))
        peers = {"as robomimic": folder / "robomimic_0.h5"}
        report = {
            "frames": arguments.frames,
            "raw_mb": raw / 1e6,
            "ratio_gzip": raw / (folder / "ratio.h5").stat().st_size,
            "writing": rows,
            "peak_mb_of_one_large_shard": large["peak_mb"],
            "large_shard_episodes": arguments.large + 1,
            "reading": reading(shard, "demo_0", arguments.frames, peers),
        }
        for name in [name for name in rows if "random_fps" in rows[name]]:
            speeds = {key: rows[name].pop(key) for key in ("random_fps", "sequential_fps")}
            report["reading"]["LeRobot, RGB"] = speeds
    if arguments.json:
        print(json.dumps(report, indent=1))
        return 0
    print(
        f"{arguments.frames} frames, {report['raw_mb']:.1f} MB of RGB and depth, "
        f"{report['ratio_gzip']:.2f} times smaller with gzip"
    )
    reference = rows["h5py, same filters"]
    for name, row in rows.items():
        faster = [reference[key] / row[key] for key in ("cpu_s", "wall_s")]
        print(
            f"{name:30} {row['bytes'] / 1e6:8.2f} MB {row['cpu_s']:6.2f} s CPU"
            f" {row['wall_s']:6.2f} s; {faster[0]:5.2f} x CPU, {faster[1]:5.2f} x wall"
        )
    episodes = report["large_shard_episodes"]
    print(f"peak memory of one shard of {episodes} episodes: {large['peak_mb']:.0f} MB")
    for name, speeds in report["reading"].items():
        fps = f"{speeds['random_fps']:6.0f} random, {speeds['sequential_fps']:6.0f} sequential"
        print(f"reading {name:28} {fps} frames/s of CPU")
    return 0


if __name__ == "__main__":
    sys.exit(main())
