"""Reading datasets: episodes as NumPy arrays, frames as samples for training."""

from __future__ import annotations

import contextlib
import json
import os
from bisect import bisect_right
from collections.abc import Iterator, Mapping
from itertools import accumulate
from pathlib import Path
from typing import Any

import h5py
import numpy as np
from numpy.typing import NDArray

from akrobat import _core
from akrobat.errors import InputError


class Dataset:
    """A dataset folder, as a map from sample number to the arrays of one frame.

    Works as a map-style dataset of `torch.utils.data.DataLoader`: it holds no open file when it is
    sent to a worker. Samples are numbered through all episodes in order; each is a dictionary of
    arrays named as in the files (`camera_obs/fixed_rgb`, `obs/joint_pos`, `actions`, ...).
    """

    def __init__(self, folder: str | os.PathLike[str], arrays: list[str] | None = None) -> None:
        """Opens a dataset folder with HDF5 shards.

        :param folder: as `akrobat render` writes it
        :param arrays: names of the arrays in each sample; all that have a row for each frame where
            absent
        """
        self.folder = Path(folder)
        self._arrays = arrays
        description = _read(self.folder / "dataset.json")
        if description["config"]["container"] != "hdf5":
            raise InputError(f"{self.folder}: holds MCAP logs; only HDF5 shards are read here")
        self.config: dict[str, Any] = description["config"]
        lines = (self.folder / "manifest.jsonl").read_text().splitlines()
        entries = [json.loads(line) for line in lines]
        self.episodes = [
            Episode(self.folder, entry["id"], entry["stored"])
            for entry in entries
            if entry.get("stored")
        ]
        self._ends = list(accumulate(episode.frames for episode in self.episodes))

    def __len__(self) -> int:
        """Number of frames of all episodes."""
        return self._ends[-1] if self._ends else 0

    def __getitem__(self, index: int) -> dict[str, NDArray[Any]]:
        if index < 0:
            index += len(self)
        if not 0 <= index < len(self):
            raise IndexError("sample index out of range")
        number = bisect_right(self._ends, index)
        first = self._ends[number - 1] if number else 0
        return self.episodes[number].frame(index - first, self._arrays)

    def __repr__(self) -> str:
        return f"<dataset of {len(self.episodes)} episodes, {len(self)} frames: {self.folder}>"


class Episode(Mapping[str, NDArray[Any]]):
    """One episode: a map from array name to the whole array, read when asked for."""

    def __init__(self, folder: Path, identity: str, stored: dict[str, Any]) -> None:
        self.id = identity
        self.info = stored
        self.frames: int = stored["frames"]
        self._file = folder / stored["shard"]
        self._key: str = stored["key"]
        self._group: h5py.Group | None = None

    @property
    def attributes(self) -> dict[str, Any]:
        """The episode's attributes as the file has them."""
        return dict(self._open().attrs)

    def array_attributes(self, name: str) -> dict[str, Any]:
        """What the file says of one array: its unit, frame, names of columns, where it does."""
        item = self._dataset(name)
        return dict(item.attrs) if isinstance(item, h5py.Dataset) else {}

    def __getitem__(self, name: str) -> NDArray[Any]:
        return np.asarray(self._dataset(name)[()])

    def __iter__(self) -> Iterator[str]:
        yield from _numeric_arrays(self._open())

    def __len__(self) -> int:
        return sum(1 for _ in self)

    def frame(self, index: int, arrays: list[str] | None = None) -> dict[str, NDArray[Any]]:
        """One row of each array; of all that have a row for each frame where none are named."""
        names = arrays if arrays is not None else self._per_frame_names()
        return {name: np.asarray(self._dataset(name)[index]) for name in names}

    def _per_frame_names(self) -> list[str]:
        names = [name for name in self if self._dataset(name).shape[:1] == (self.frames,)]
        # Images and clouds are linked under `obs/` once more, for readers that look there.
        linked = {f"obs/{name.removeprefix('camera_obs/')}" for name in names if _is_linked(name)}
        return [name for name in names if name not in linked]

    def _dataset(self, name: str) -> h5py.Dataset | _ColorFiles:
        group = self._open()
        if name.endswith("_rgb") and name + "_encoded" in group:
            return _ColorFiles(group, name)
        item = group.get(name)
        if not isinstance(item, h5py.Dataset):
            choices = ", ".join(self)
            raise InputError(f"{self._file}: no array {name!r}; valid choices: {choices}")
        return item

    def _open(self) -> h5py.Group:
        if self._group is None:
            _register_codecs()
            self._group = h5py.File(self._file, "r")["data"][self._key]
        return self._group

    def __getstate__(self) -> dict[str, Any]:
        # Open files do not survive the way to another process.
        return {**self.__dict__, "_group": None}


class _ColorFiles:
    """Colours that are stored as PNG or JPEG files, read as the array that they are."""

    dtype = np.dtype(np.uint8)

    def __init__(self, group: h5py.Group, name: str) -> None:
        self._files = group[name + "_encoded"]
        # The offsets are not linked under `obs/`.
        self._offsets = group[f"camera_obs/{name.rsplit('/', 1)[-1]}_offsets"][()]
        size = (int(self._files.attrs["height"]), int(self._files.attrs["width"]))
        self.shape = (len(self._offsets) - 1, *size, 3)

    def __getitem__(self, index: int | tuple[()]) -> NDArray[np.uint8]:
        if index == ():
            return np.stack([self[frame] for frame in range(self.shape[0])])
        first, end = self._offsets[index], self._offsets[index + 1]
        height, width = self.shape[1:3]
        pixels = _core.decode_color(self._files[first:end].tobytes(), width, height)
        return np.frombuffer(pixels, np.uint8).reshape(height, width, 3)


def _register_codecs() -> None:
    """Makes LZ4, Zstandard and Blosc readable where their filters are installed."""
    with contextlib.suppress(ImportError):
        import hdf5plugin  # noqa: F401


def _is_linked(name: str) -> bool:
    return name.startswith("camera_obs/") or name == "point_cloud"


def _numeric_arrays(group: h5py.Group, prefix: str = "") -> Iterator[str]:
    """Paths of all numeric arrays; hard links under each of their names."""
    for name, item in group.items():
        if isinstance(item, h5py.Group):
            yield from _numeric_arrays(item, f"{prefix}{name}/")
        elif isinstance(item, h5py.Dataset) and item.dtype.kind in "fiub":
            yield prefix + name.removesuffix("_encoded")


def _read(path: Path) -> dict[str, Any]:
    try:
        return dict(json.loads(path.read_text()))
    except (OSError, ValueError) as error:
        raise InputError(f"{path}: cannot read: {error}") from error
