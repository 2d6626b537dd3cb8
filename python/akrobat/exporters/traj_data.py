"""AutoMoMa's `traj_data.pt`: tensors in PyTorch's zip format, written and read without PyTorch.

Keys: `start_robot [N, C]`, `start_obj [N, 1]`, `goal_robot`, `goal_obj`, `traj_robot [N, T, C]`,
`traj_obj [N, T, 1]`, `traj_success [N]`, `grasp_id [N]`, `grasp_pose [N, 7]`, `goal_angle [N]`, and
the texts `scene_id` and `object_id`. Robot columns are base x, y, yaw, arm, fingers.

A `.pt` file holds a pickle, and a pickle can run anything when it is loaded. The reader here knows
tensors, ordered dictionaries and plain values, and refuses everything else.
"""

from __future__ import annotations

import io
import os
import pickle
import struct
import zipfile
from collections import OrderedDict
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from akrobat.errors import InputError

STORAGES: dict[str, type[np.generic]] = {
    "FloatStorage": np.float32,
    "DoubleStorage": np.float64,
    "HalfStorage": np.float16,
    "LongStorage": np.int64,
    "IntStorage": np.int32,
    "ShortStorage": np.int16,
    "ByteStorage": np.uint8,
    "BoolStorage": np.bool_,
}

# Zip entries have no dates of their own: the earliest that the format knows.
EPOCH = (1980, 1, 1, 0, 0, 0)


def write(file: Path, arrays: Mapping[str, NDArray[Any]], scene_id: str, object_id: str) -> None:
    """Writes trajectories; `start_*` and `goal_*` are the first and last rows of `traj_*`."""
    robot, opened = arrays["traj_robot"], arrays["traj_obj"]
    payload: dict[str, NDArray[Any] | str] = {
        "start_robot": robot[:, 0],
        "start_obj": opened[:, 0],
        "goal_robot": robot[:, -1],
        "goal_obj": opened[:, -1],
        **arrays,
        "scene_id": scene_id,
        "object_id": object_id,
    }
    save(file, payload)


def save(file: Path, payload: Mapping[str, NDArray[Any] | str]) -> None:
    """Writes a dictionary of tensors and texts as `torch.save` lays it out."""
    tensors = [np.ascontiguousarray(v) for v in payload.values() if not isinstance(v, str)]
    with zipfile.ZipFile(file, "w", zipfile.ZIP_STORED) as archive:

        def add(name: str, content: bytes) -> None:
            archive.writestr(zipfile.ZipInfo(f"archive/{name}", EPOCH), content)

        add("data.pkl", _pickle(payload))
        add("byteorder", b"little")
        for number, tensor in enumerate(tensors):
            add(f"data/{number}", tensor.astype(tensor.dtype.newbyteorder("<")).tobytes())
        add("version", b"3\n")


def _pickle(payload: Mapping[str, NDArray[Any] | str]) -> bytes:
    """Protocol 2, with the opcodes of the `pickletools` documentation."""
    out = io.BytesIO()
    out.write(b"\x80\x02}(")
    number = 0
    for key, value in payload.items():
        _write_text(out, key)
        if isinstance(value, str):
            _write_text(out, value)
            continue
        out.write(b"ctorch._utils\n_rebuild_tensor_v2\n")
        out.write(b"((")
        _write_text(out, "storage")
        out.write(f"ctorch\n{_storage_of(value.dtype)}\n".encode())
        _write_text(out, str(number))
        _write_text(out, "cpu")
        _write_int(out, value.size)
        # The tuple names the storage; then offset, shape, strides, no gradient, no hooks.
        out.write(b"tQ")
        _write_int(out, 0)
        _write_ints(out, value.shape)
        strides = [int(np.prod(value.shape[axis + 1 :])) for axis in range(value.ndim)]
        _write_ints(out, strides)
        out.write(b"\x89ccollections\nOrderedDict\n)RtR")
        number += 1
    out.write(b"u.")
    return out.getvalue()


def _storage_of(dtype: np.dtype[Any]) -> str:
    for name, kind in STORAGES.items():
        if dtype == kind:
            return name
    raise ValueError(f"no tensor of type {dtype}")


def _write_text(out: io.BytesIO, text: str) -> None:
    data = text.encode()
    out.write(b"X" + struct.pack("<I", len(data)) + data)


def _write_int(out: io.BytesIO, value: int) -> None:
    data = int(value).to_bytes(8, "little", signed=True)
    out.write(b"\x8a\x08" + data)


def _write_ints(out: io.BytesIO, values: Any) -> None:
    out.write(b"(")
    for value in values:
        _write_int(out, value)
    out.write(b"t")


def load(file: str | os.PathLike[str]) -> dict[str, Any]:
    """Reads a dictionary of tensors (as arrays) and plain values; runs nothing that the file says.

    :raises InputError: where the file is not of the format, claims more than it holds, or asks for
        anything but tensors
    """
    file = Path(file)
    try:
        limit = file.stat().st_size
        with zipfile.ZipFile(file) as archive:
            reader = _Reader(archive, limit)
            payload = reader.load()
    except InputError as error:
        raise InputError(f"{file}: {error}") from error
    except (
        OSError,
        ValueError,
        KeyError,
        TypeError,
        IndexError,
        AttributeError,
        EOFError,
        OverflowError,
        MemoryError,
        struct.error,
        zipfile.BadZipFile,
        NotImplementedError,
        pickle.UnpicklingError,
    ) as error:
        raise InputError(f"{file}: not a whole PyTorch file: {error}") from error
    if not isinstance(payload, dict):
        raise InputError(f"{file}: expected a dictionary, got {type(payload).__name__}")
    return payload


def read_motions(
    file: str | os.PathLike[str],
) -> tuple[NDArray[np.float32], NDArray[np.float32], NDArray[np.bool_], NDArray[np.int64]]:
    """Robot and object waypoints `[N, T, columns]`, success `[N]` and number of the grasp `[N]`.

    :raises InputError: where the file is not of the format
    """
    payload = load(file)

    def table(key: str, axes: int) -> NDArray[Any]:
        value = payload.get(key)
        if not isinstance(value, np.ndarray) or value.ndim != axes:
            raise InputError(f"{file}: {key}: expected a tensor of {axes} axes")
        return value

    robot = np.ascontiguousarray(table("traj_robot", 3), np.float32)
    opened = np.ascontiguousarray(table("traj_obj", 3), np.float32)
    success = np.ascontiguousarray(table("traj_success", 1), np.bool_)
    if robot.shape[:2] != opened.shape[:2] or len(success) != len(robot):
        shapes = f"{robot.shape}, {opened.shape}, {success.shape}"
        raise InputError(f"{file}: traj_robot, traj_obj and traj_success disagree: {shapes}")
    if robot.shape[1] < 2 or robot.shape[2] == 0 or opened.shape[2] == 0:
        raise InputError(f"{file}: traj_robot: expected [N, T, columns], got {robot.shape}")
    if not (np.isfinite(robot).all() and np.isfinite(opened).all()):
        raise InputError(f"{file}: traj_robot and traj_obj: expected numbers, got NaN or infinity")
    grasps = np.zeros(len(robot), np.int64)
    if "grasp_id" in payload:
        grasps = np.ascontiguousarray(table("grasp_id", 1), np.int64)
    if len(grasps) != len(robot):
        raise InputError(f"{file}: grasp_id: expected {len(robot)} values, got {len(grasps)}")
    return robot, opened, success, grasps


class _Reader:
    def __init__(self, archive: zipfile.ZipFile, limit: int) -> None:
        self._archive = archive
        entries = archive.infolist()
        # Tensors are stored as they are; a compressed entry could claim any size.
        if any(entry.compress_type != zipfile.ZIP_STORED for entry in entries):
            raise InputError("compressed entries, which PyTorch does not write")
        if sum(entry.file_size for entry in entries) > limit:
            raise InputError("its entries claim more bytes than the file has")
        pickles = [e.filename for e in entries if e.filename.endswith("/data.pkl")]
        if len(pickles) != 1:
            raise InputError(f"expected one data.pkl, got {len(pickles)}")
        self._prefix = pickles[0].removesuffix("data.pkl")
        names = {entry.filename for entry in entries}
        if self._prefix + "byteorder" in names:
            order = archive.read(self._prefix + "byteorder")
            if order != b"little":
                raise InputError(f"byte order {order!r}; only little-endian files are read")

    def load(self) -> Any:
        content = self._archive.read(self._prefix + "data.pkl")
        return _Unpickler(io.BytesIO(content), self._storage).load()

    def _storage(self, identity: Any) -> NDArray[Any]:
        kind, storage, key, _, count = identity
        if kind != "storage" or not isinstance(storage, _Storage) or not str(key).isalnum():
            raise InputError("a storage that is none")
        data = self._archive.read(f"{self._prefix}data/{key}")
        values = np.frombuffer(data, np.dtype(STORAGES[storage.name]).newbyteorder("<"))
        if len(values) != count:
            raise InputError(f"storage {key}: expected {count} values, got {len(values)}")
        return values


class _Storage:
    """Stands for a class such as `torch.FloatStorage`."""

    def __init__(self, name: str) -> None:
        self.name = name


class _Unpickler(pickle.Unpickler):
    def __init__(self, stream: io.BytesIO, storage: Any) -> None:
        super().__init__(stream)
        self._storage = storage

    def find_class(self, module: str, name: str) -> Any:
        if (module, name) == ("collections", "OrderedDict"):
            return OrderedDict
        if (module, name) == ("torch._utils", "_rebuild_tensor_v2"):
            return _rebuild
        if module == "torch" and name in STORAGES:
            return _Storage(name)
        raise InputError(f"asks for {module}.{name}; only tensors and plain values are read")

    def persistent_load(self, pid: Any) -> Any:
        return self._storage(pid)


def _rebuild(storage: NDArray[Any], offset: int, shape: Any, strides: Any, *_: Any) -> NDArray[Any]:
    """An array from a storage, with every element checked to lie inside."""
    shape, strides = tuple(shape), tuple(strides)
    if len(shape) != len(strides) or min((offset, *shape, *strides)) < 0:
        raise InputError(f"a tensor of shape {shape} and strides {strides}")
    if 0 in shape:
        return np.empty(shape, storage.dtype)
    last = offset + sum((n - 1) * s for n, s in zip(shape, strides, strict=True))
    # Strides of 0 would repeat a few values without end.
    if last >= len(storage) or int(np.prod(shape, dtype=object)) > len(storage):
        raise InputError(f"a tensor of shape {shape} in a storage of {len(storage)} values")
    steps = [s * storage.itemsize for s in strides]
    return np.lib.stride_tricks.as_strided(storage[offset:], shape, steps).copy()
