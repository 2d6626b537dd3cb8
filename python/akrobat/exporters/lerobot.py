"""LeRobotDataset v3.0, written with pyarrow and PyAV; the `lerobot` package is not needed.

What policies take has LeRobot's names: `observation.state`, `action`, `observation.images.<camera>`
(h264) and `observation.images.<camera>_depth` (12-bit HEVC without loss; see
:mod:`akrobat.exporters.depth_codes`). Everything else has names of its own, so that LeRobot hands
no policy what it does not expect: `depth_valid.<camera>` (one bit a pixel, rows packed as
`numpy.packbits` does it), `point_cloud` `[points, 6]`, `camera.<camera>.intrinsics` `[9]`,
`camera.<camera>.world_from_camera` `[16]`, `eef_pose` `[7]`, `base_pose` `[7]`, `object_position`,
`phase` and `time`.
"""

from __future__ import annotations

import json
from dataclasses import dataclass
from fractions import Fraction
from pathlib import Path
from typing import Any

import av
import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
from numpy.typing import NDArray

from akrobat.exporters import Arrays
from akrobat.exporters.depth_codes import DepthCodes
from akrobat.exporters.lerobot_statistics import EpisodeStatistics, aggregate, of_images, of_rows

VERSION = "v3.0"
DATA_PATH = "data/chunk-{chunk_index:03d}/file-{file_index:03d}.parquet"
VIDEO_PATH = "videos/{video_key}/chunk-{chunk_index:03d}/file-{file_index:03d}.mp4"
EPISODES_PATH = "meta/episodes/chunk-{chunk_index:03d}/file-{file_index:03d}.parquet"

# Every second frame is a key frame, as LeRobot encodes: policies read frames at random.
KEY_FRAME_INTERVAL = 2
COLOR_CRF = 18


@dataclass(frozen=True)
class Limits:
    """When files and folders are full; LeRobot's own limits."""

    data_file_bytes: int = 100 << 20
    video_file_bytes: int = 200 << 20
    files_per_chunk: int = 1000


@dataclass
class Place:
    """A numbered file."""

    chunk: int = 0
    file: int = 0

    def following(self, files_per_chunk: int) -> Place:
        """The next file, in the next folder where this one is full."""
        if self.file + 1 == files_per_chunk:
            return Place(self.chunk + 1, 0)
        return Place(self.chunk, self.file + 1)


class LeRobotWriter:
    """Writes a dataset folder."""

    def __init__(self, folder: Path, header: dict[str, Any], limits: Limits | None = None) -> None:
        self._folder = folder
        self._header = header
        self._limits = limits or Limits()
        self._fps = round(header["frame_rate_hz"])
        if abs(self._fps - header["frame_rate_hz"]) > 1e-9:
            raise ValueError(f"LeRobot wants whole frames a second, not {header['frame_rate_hz']}")
        self._codes = DepthCodes()
        self._features: dict[str, dict[str, Any]] = {}
        self._videos: dict[str, VideoFiles] = {}
        self._rows = RowFiles(folder, self._limits)
        self._tasks: list[str] = []
        self._episodes: list[dict[str, Any]] = []
        self._statistics: list[EpisodeStatistics] = []
        self._cameras = header["cameras"]
        self._frames = 0
        self._make_videos()

    def _make_videos(self) -> None:
        for camera in self._cameras:
            size = (camera["width"], camera["height"])
            key = f"observation.images.{camera['name']}"
            for name, codes in ((key, None), (f"{key}_depth", self._codes)):
                self._videos[name] = VideoFiles(
                    self._folder, name, self._fps, size=size, limits=self._limits, codes=codes
                )
        for key, video in self._videos.items():
            self._features[key] = video.feature()

    def begin(self, index: int, attributes: str, arrays: Arrays) -> None:
        """Starts an episode."""
        known = json.loads(attributes)
        count = known["frames"]
        self._known = known
        if known["instruction"] not in self._tasks:
            self._tasks.append(known["instruction"])
        frame = np.arange(count, dtype=np.int64)
        self._columns: dict[str, NDArray[Any]] = {
            "observation.state": arrays["state"],
            "action": arrays["action"],
            "eef_pose": arrays["eef_pose"],
            "base_pose": arrays["base_pose"],
            "object_position": arrays["object_position"],
            "phase": arrays["phase"].astype(np.int64),
            "time": arrays["time"].astype(np.float32),
        }
        for camera in self._cameras:
            name = camera["name"]
            for kind in ("intrinsics", "world_from_camera"):
                values = arrays[f"{name}/{kind}"].reshape(count, -1)
                self._columns[f"camera.{name}.{kind}"] = values
        self._numbers = {
            "timestamp": (frame / self._fps).astype(np.float32),
            "frame_index": frame,
            "episode_index": np.full(count, index, np.int64),
            "index": frame + self._frames,
            "task_index": np.full(count, self._tasks.index(known["instruction"]), np.int64),
        }
        self._shots: dict[str, list[NDArray[Any]]] = {}
        self._sampled: dict[str, list[NDArray[Any]]] = {key: [] for key in self._videos}
        for video in self._videos.values():
            video.begin_episode()

    def frames(self, first: int, arrays: Arrays) -> None:
        """Encodes frames."""
        for camera in self._cameras:
            name = camera["name"]
            key = f"observation.images.{name}"
            rgb, depth = arrays[f"{name}/rgb"], arrays[f"{name}/depth_mm"]
            for image, millimetres in zip(rgb, depth, strict=True):
                self._videos[key].encode(image)
                self._videos[f"{key}_depth"].encode(self._codes.encode(millimetres))
            # One frame of each batch stands for it in the statistics.
            self._sampled[key].append(rgb[0])
            self._sampled[f"{key}_depth"].append(depth[0][..., None])
            valid = np.packbits(self._codes.is_valid(depth), axis=2)
            self._shots.setdefault(f"depth_valid.{name}", []).append(valid)
        if "point_cloud" in arrays:
            self._shots.setdefault("point_cloud", []).append(arrays["point_cloud"])

    def end(self) -> None:
        """Writes the episode's rows."""
        for key, batches in self._shots.items():
            self._columns[key] = np.concatenate(batches)
        for key, values in self._columns.items():
            self._features.setdefault(key, self._feature(key, values))
        for key, values in self._numbers.items():
            self._features.setdefault(key, _number_feature(values))
        table = _table({**self._columns, **self._numbers})
        place = self._rows.append(table)
        count = self._known["frames"]
        statistics = self._episode_statistics()
        entry: dict[str, Any] = {
            "episode_index": len(self._episodes),
            "tasks": [self._known["instruction"]],
            "length": count,
            "data/chunk_index": place.chunk,
            "data/file_index": place.file,
            "dataset_from_index": self._frames,
            "dataset_to_index": self._frames + count,
        }
        for key, video in self._videos.items():
            at, start, end = video.end_episode()
            entry[f"videos/{key}/chunk_index"] = at.chunk
            entry[f"videos/{key}/file_index"] = at.file
            entry[f"videos/{key}/from_timestamp"] = start
            entry[f"videos/{key}/to_timestamp"] = end
        for key, values in statistics.items():
            for name, value in values.items():
                entry[f"stats/{key}/{name}"] = value
        entry["meta/episodes/chunk_index"] = 0
        entry["meta/episodes/file_index"] = 0
        known = self._known
        for name in ("id", "success", "grasp_id", "goal", "robot_id", "object_id", "scene_id"):
            entry[f"akrobat/{name}"] = known[name]
        # Seeds have 64 bits without a sign, which LeRobot's tables have no type for.
        entry["akrobat/seed"] = str(known["seed"])
        self._episodes.append(entry)
        self._statistics.append(statistics)
        self._frames += count

    def finish(self) -> None:
        """Writes the metadata."""
        for video in self._videos.values():
            video.close()
        self._rows.close()
        meta = self._folder / "meta"
        (meta / "episodes" / "chunk-000").mkdir(parents=True)
        episodes = pa.Table.from_pylist(self._episodes)
        path = self._folder / EPISODES_PATH.format(chunk_index=0, file_index=0)
        pq.write_table(episodes, path, compression="snappy")
        _write_tasks(meta / "tasks.parquet", self._tasks)
        _write_json(meta / "stats.json", aggregate(self._statistics))
        _write_json(meta / "info.json", self._info())
        # LeRobot warns about keys of info.json that it does not know.
        _write_json(meta / "conventions.json", self._header["conventions"])

    def _info(self) -> dict[str, Any]:
        header = self._header
        return {
            "codebase_version": VERSION,
            "robot_type": "+".join(sorted(header["robots"])),
            "total_episodes": len(self._episodes),
            "total_frames": self._frames,
            "total_tasks": len(self._tasks),
            "chunks_size": self._limits.files_per_chunk,
            "data_files_size_in_mb": max(1, self._limits.data_file_bytes >> 20),
            "video_files_size_in_mb": max(1, self._limits.video_file_bytes >> 20),
            "fps": self._fps,
            "splits": {"train": f"0:{len(self._episodes)}"},
            "data_path": DATA_PATH,
            "video_path": VIDEO_PATH,
            "features": self._features,
        }

    def _feature(self, key: str, values: NDArray[Any]) -> dict[str, Any]:
        names = {
            "action": self._header["action_names"],
            "observation.state": self._header["state_names"],
            "eef_pose": ["x", "y", "z", "qw", "qx", "qy", "qz"],
            "base_pose": ["x", "y", "z", "qw", "qx", "qy", "qz"],
            "point_cloud": ["point", "xyzrgb"],
        }
        if values.ndim == 1:
            return _number_feature(values)
        shape = list(values.shape[1:])
        return {"dtype": str(values.dtype), "shape": shape, "names": names.get(key)}

    def _episode_statistics(self) -> EpisodeStatistics:
        statistics: EpisodeStatistics = {}
        for key, values in {**self._columns, **self._numbers}.items():
            if values.ndim <= 2:
                statistics[key] = of_rows(values)
        for key, images in self._sampled.items():
            scale = 1.0 if key.endswith("_depth") else 255.0
            statistics[key] = of_images(np.stack(images), scale)
        return statistics


class VideoFiles:
    """The video files of one feature: episodes one after another, a new file where one is full."""

    def __init__(
        self,
        folder: Path,
        key: str,
        fps: int,
        *,
        size: tuple[int, int],
        limits: Limits,
        codes: DepthCodes | None,
    ) -> None:
        self._folder, self._key, self._fps, self._size = folder, key, fps, size
        self._limits, self._codes = limits, codes
        self._place = Place()
        self._container: Any = None
        self._frames = 0
        self._bytes = 0

    @property
    def _pixel_format(self) -> str:
        if self._codes is not None:
            return self._codes.pixel_format
        # Halved colours need an even number of pixels.
        return "yuv420p" if self._size[0] % 2 == self._size[1] % 2 == 0 else "yuv444p"

    def feature(self) -> dict[str, Any]:
        """The feature's entry in `info.json`."""
        width, height = self._size
        channels = 1 if self._codes else 3
        info: dict[str, Any] = {
            "video.height": height,
            "video.width": width,
            "video.codec": "hevc" if self._codes else "h264",
            "video.pix_fmt": self._pixel_format,
            "video.fps": self._fps,
            "video.channels": channels,
            "has_audio": False,
            "is_depth_map": self._codes is not None,
        }
        if self._codes is not None:
            info.update(self._codes.video_info())
        return {
            "dtype": "video",
            "shape": [height, width, channels],
            "names": ["height", "width", "channels"],
            "info": info,
        }

    def begin_episode(self) -> None:
        """Opens the next file where this one is full."""
        if self._container is not None and self._bytes >= self._limits.video_file_bytes:
            self.close()
            self._place = self._place.following(self._limits.files_per_chunk)
        if self._container is None:
            self._open()
        self._start = self._frames

    def _open(self) -> None:
        path = self._folder / VIDEO_PATH.format(
            video_key=self._key, chunk_index=self._place.chunk, file_index=self._place.file
        )
        path.parent.mkdir(parents=True, exist_ok=True)
        self._container = av.open(str(path), "w", options={"fflags": "+bitexact"})
        codec, options = "libx264", {"crf": str(COLOR_CRF), "preset": "veryfast"}
        if self._codes is not None:
            codec, options = "libx265", self._codes.codec_options()
        options["g"] = str(KEY_FRAME_INTERVAL)
        stream = self._container.add_stream(codec, rate=self._fps, options=options)
        stream.width, stream.height = self._size
        stream.pix_fmt = self._pixel_format
        stream.codec_context.flags |= av.codec.context.Flags.bitexact
        # One thread for each video: the bytes do not depend on the number of cores.
        stream.codec_context.thread_count = 1
        stream.codec_context.time_base = Fraction(1, self._fps)
        self._stream = stream
        self._frames, self._bytes = 0, 0

    def encode(self, image: NDArray[Any]) -> None:
        """Encodes a frame: colours `[H, W, 3]`, or depth codes `[H, W]`."""
        if self._codes is None:
            frame = av.VideoFrame.from_ndarray(np.ascontiguousarray(image), format="rgb24")
            frame = frame.reformat(format=self._pixel_format)
        else:
            frame = self._codes.video_frame(image)
        frame.pts = self._frames
        frame.time_base = Fraction(1, self._fps)
        if self._frames == self._start:
            frame.pict_type = av.video.frame.PictureType.I
        self._mux(frame)
        self._frames += 1

    def _mux(self, frame: Any) -> None:
        for packet in self._stream.encode(frame):
            self._bytes += packet.size
            self._container.mux(packet)

    def end_episode(self) -> tuple[Place, float, float]:
        """File, first and last time of the episode in it, seconds."""
        return self._place, self._start / self._fps, self._frames / self._fps

    def close(self) -> None:
        """Completes the file."""
        if self._container is not None:
            self._mux(None)
            self._container.close()
            self._container = None


class RowFiles:
    """The parquet files of all rows: a new file where one is full."""

    def __init__(self, folder: Path, limits: Limits) -> None:
        self._folder, self._limits = folder, limits
        self._place = Place()
        self._writer: pq.ParquetWriter | None = None
        self._file: pa.NativeFile | None = None

    def append(self, table: pa.Table) -> Place:
        """Writes an episode; its rows are never split."""
        if self._file is not None and self._file.tell() >= self._limits.data_file_bytes:
            self.close()
            self._place = self._place.following(self._limits.files_per_chunk)
        if self._writer is None:
            path = self._folder / DATA_PATH.format(
                chunk_index=self._place.chunk, file_index=self._place.file
            )
            path.parent.mkdir(parents=True, exist_ok=True)
            self._file = pa.OSFile(str(path), "wb")
            self._writer = pq.ParquetWriter(self._file, table.schema, compression="snappy")
        self._writer.write_table(table)
        return self._place

    def close(self) -> None:
        """Completes the file."""
        if self._writer is not None and self._file is not None:
            self._writer.close()
            self._file.close()
            self._writer = self._file = None


def _number_feature(values: NDArray[Any]) -> dict[str, Any]:
    return {"dtype": str(values.dtype), "shape": [1], "names": None}


def _table(columns: dict[str, NDArray[Any]]) -> pa.Table:
    """Rows as LeRobot keeps them: numbers, lists, and lists of lists."""
    arrays = {}
    for key, values in columns.items():
        flat = pa.array(np.ascontiguousarray(values).reshape(-1))
        if values.ndim == 2:
            flat = pa.FixedSizeListArray.from_arrays(flat, values.shape[1])
            if values.shape[1] == 1:
                flat = flat.flatten()
        elif values.ndim == 3:
            inner = _lists(flat, values.shape[2])
            flat = _lists(inner, values.shape[1])
        arrays[key] = flat
    return pa.table(arrays)


def _lists(values: pa.Array, length: int) -> pa.ListArray:
    offsets = np.arange(0, len(values) + 1, length, dtype=np.int32)
    return pa.ListArray.from_arrays(offsets, values)


def _write_tasks(path: Path, tasks: list[str]) -> None:
    """The tasks as a pandas table with the text as its index, written without pandas."""

    def column(name: str, kind: str, numpy: str) -> dict[str, Any]:
        return {
            "name": name,
            "field_name": name,
            "pandas_type": kind,
            "numpy_type": numpy,
            "metadata": None,
        }

    described = {
        "index_columns": ["task"],
        "column_indexes": [],
        "columns": [column("task_index", "int64", "int64"), column("task", "unicode", "object")],
        "creator": {"library": "pyarrow", "version": pa.__version__},
        "pandas_version": "2.0.0",
    }
    numbers = pa.array(range(len(tasks)), pa.int64())
    table = pa.table({"task_index": numbers, "task": pa.array(tasks, pa.string())})
    table = table.replace_schema_metadata({"pandas": json.dumps(described)})
    pq.write_table(table, path)


def _write_json(path: Path, value: Any) -> None:
    path.write_text(json.dumps(value, indent=4, ensure_ascii=False) + "\n", encoding="utf-8")
