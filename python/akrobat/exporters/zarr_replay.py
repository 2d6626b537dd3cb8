"""Replay buffers of Diffusion Policy and DP3: a zarr (format 2) folder of concatenated episodes.

`data/<name>` holds the rows of all episodes one after another, `meta/episode_ends` where each ends.
DP3 gets `state`, `action` and `point_cloud` `[N, points, 6]`; Diffusion Policy `state`, `action`,
`eef_pose`, and for each camera `<camera>` (RGB u8), `<camera>_depth` (u16 millimetres),
`<camera>_intrinsics` and `<camera>_world_from_camera`.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import zarr
from numpy.typing import NDArray

from akrobat.errors import InputError
from akrobat.exporters import INSTALL, Arrays

# Rows of small tables in a chunk; images have one row, so that a frame is read alone.
TABLE_ROWS = 100

FILE = "replay_buffer.zarr"


class ReplayBufferWriter:
    """Writes `replay_buffer.zarr`."""

    def __init__(self, folder: Path, header: dict[str, Any], *, images: bool) -> None:
        if int(zarr.__version__.split(".")[0]) != 2:
            raise InputError(
                f"the readers of replay buffers need zarr 2, here is {zarr.__version__}; {INSTALL}"
            )
        self._images = images
        self._root = zarr.open_group(str(folder / FILE), mode="w")
        self._data = self._root.create_group("data")
        self._meta = self._root.create_group("meta")
        self._compressor = zarr.Blosc(cname="zstd", clevel=3, shuffle=zarr.Blosc.SHUFFLE)
        self._ends: list[int] = []
        self._episodes: list[dict[str, Any]] = []
        self._rows = 0
        self._root.attrs.update(
            {
                "written_by": "akrobat export",
                "conventions": header["conventions"],
                "action_names": header["action_names"],
                "state_names": header["state_names"],
                "frame_rate_hz": header["frame_rate_hz"],
                "depth_unit": "mm",
            }
        )

    def begin(self, index: int, attributes: str, arrays: Arrays) -> None:
        """Appends the tables of an episode."""
        known = json.loads(attributes)
        self._append("state", arrays["state"], TABLE_ROWS)
        self._append("action", arrays["action"], TABLE_ROWS)
        if self._images:
            self._append("eef_pose", arrays["eef_pose"], TABLE_ROWS)
            self._append("timestamp", arrays["time"], TABLE_ROWS)
            for name in arrays:
                if "/" in name:
                    self._append(name.replace("/", "_"), arrays[name], TABLE_ROWS)
        self._rows += known["frames"]
        self._ends.append(self._rows)
        self._episodes.append(known)

    def frames(self, first: int, arrays: Arrays) -> None:
        """Appends images and clouds."""
        for name, values in arrays.items():
            camera, _, kind = name.partition("/")
            if name == "point_cloud":
                self._append(name, values, TABLE_ROWS)
            elif self._images and kind == "rgb":
                self._append(camera, values, 1)
            elif self._images and kind == "depth_mm":
                self._append(f"{camera}_depth", values, 1)

    def end(self) -> None:
        """Checks that every array has as many rows as the episodes so far."""
        for name, array in self._data.arrays():
            if len(array) != self._rows:
                raise ValueError(f"{name} has {len(array)} rows, expected {self._rows}")

    def finish(self) -> None:
        """Writes the ends of the episodes."""
        ends = np.asarray(self._ends, np.int64)
        self._meta.create_dataset("episode_ends", data=ends, compressor=self._compressor)
        self._meta.attrs["episodes"] = self._episodes

    def _append(self, name: str, values: NDArray[Any], chunk_rows: int) -> None:
        if name not in self._data:
            self._data.create_dataset(
                name,
                shape=(0, *values.shape[1:]),
                chunks=(chunk_rows, *values.shape[1:]),
                dtype=values.dtype,
                compressor=self._compressor,
            )
        self._data[name].append(values)
