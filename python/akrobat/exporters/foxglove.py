"""MCAP logs in Foxglove's protobuf schemas: `episode_<i>.mcap`.

Topics: `/camera/<name>/color` (RawImage, `rgb8`), `/camera/<name>/depth` (RawImage, `16UC1` in
millimetres), `/camera/<name>/calibration` (CameraCalibration), `/points` (PointCloud with colours),
`/tf` (FrameTransforms), `/joint_states` (JointStates). Stamps count from the trajectory's start.
"""

from __future__ import annotations

import json
import os
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
from foxglove_schemas_protobuf.CameraCalibration_pb2 import CameraCalibration
from foxglove_schemas_protobuf.FrameTransforms_pb2 import FrameTransforms
from foxglove_schemas_protobuf.JointStates_pb2 import JointStates
from foxglove_schemas_protobuf.PackedElementField_pb2 import PackedElementField
from foxglove_schemas_protobuf.PointCloud_pb2 import PointCloud
from foxglove_schemas_protobuf.RawImage_pb2 import RawImage
from google.protobuf.timestamp_pb2 import Timestamp
from mcap_protobuf.writer import Writer as McapWriter
from numpy.typing import NDArray

from akrobat.exporters import Arrays

WORLD = "world"

POINT = np.dtype(
    [
        ("x", "<f4"),
        ("y", "<f4"),
        ("z", "<f4"),
        ("red", "u1"),
        ("green", "u1"),
        ("blue", "u1"),
        ("alpha", "u1"),
    ]
)


class FoxgloveWriter:
    """Writes a folder of logs."""

    def __init__(self, folder: Path, header: dict[str, Any]) -> None:
        self._folder = folder
        self._header = header
        self._cameras: list[str] = [camera["name"] for camera in header["cameras"]]

    def begin(self, index: int, attributes: str, arrays: Arrays) -> None:
        """Opens the log of an episode."""
        self._arrays = arrays
        self._final = self._folder / f"episode_{index}.mcap"
        self._partial = self._final.with_suffix(".mcap.partial")
        self._stream: BinaryIO = self._partial.open("wb")
        self._writer = McapWriter(self._stream)
        known = {key: str(value) for key, value in json.loads(attributes).items()}
        log = self._writer._writer  # The protobuf writer has no call for metadata.
        log.add_metadata("akrobat.episode", known)
        log.add_metadata("akrobat.conventions", self._header["conventions"])

    def frames(self, first: int, arrays: Arrays) -> None:
        """Logs frames."""
        count = max(len(values) for values in arrays.values())
        for offset in range(count):
            frame = first + offset
            self._log_motion(frame)
            for camera in self._cameras:
                self._log_images(camera, frame, offset, arrays)
            if "point_cloud" in arrays:
                self._log(
                    "/points", frame, _cloud(self._stamp(frame), arrays["point_cloud"][offset])
                )

    def end(self) -> None:
        """Completes the log."""
        self._writer.finish()
        self._stream.flush()
        os.fsync(self._stream.fileno())
        self._stream.close()
        self._partial.rename(self._final)

    def finish(self) -> None:
        """Every log is complete already."""

    def _nanoseconds(self, frame: int) -> int:
        return round(float(self._arrays["time"][frame]) * 1e9)

    def _stamp(self, frame: int) -> Timestamp:
        seconds, nanos = divmod(self._nanoseconds(frame), 10**9)
        return Timestamp(seconds=seconds, nanos=nanos)

    def _log(self, topic: str, frame: int, message: Any) -> None:
        time = self._nanoseconds(frame)
        self._writer.write_message(topic, message, time, time, frame)

    def _log_motion(self, frame: int) -> None:
        stamp = self._stamp(frame)
        transforms = FrameTransforms()
        bodies = {"base": "base_pose", "tool": "eef_pose", "object": "object_pose"}
        for name, key in bodies.items():
            _add_transform(transforms, stamp, name, self._arrays[key][frame])
        for camera in self._cameras:
            matrix = self._arrays[f"{camera}/world_from_camera"][frame]
            pose = np.concatenate([matrix[:3, 3], _wxyz_of(matrix[:3, :3])])
            _add_transform(transforms, stamp, _optical(camera), pose)
        self._log("/tf", frame, transforms)
        states = JointStates(timestamp=stamp)
        for group in ("robot", "object"):
            positions = self._arrays[f"{group}_position"][frame]
            for name, position in zip(self._arrays[f"{group}_joints"], positions, strict=True):
                states.joints.add(name=str(name), position=float(position))
        self._log("/joint_states", frame, states)

    def _log_images(self, camera: str, frame: int, offset: int, arrays: Arrays) -> None:
        stamp, frame_id = self._stamp(frame), _optical(camera)
        rgb, depth = arrays[f"{camera}/rgb"][offset], arrays[f"{camera}/depth_mm"][offset]
        height, width = depth.shape

        def image(encoding: str, values: NDArray[Any], pixel_bytes: int) -> RawImage:
            return RawImage(
                timestamp=stamp,
                frame_id=frame_id,
                width=width,
                height=height,
                encoding=encoding,
                step=pixel_bytes * width,
                data=values.tobytes(),
            )

        self._log(f"/camera/{camera}/color", frame, image("rgb8", rgb, 3))
        self._log(f"/camera/{camera}/depth", frame, image("16UC1", depth.astype("<u2"), 2))
        k = self._arrays[f"{camera}/intrinsics"][frame].copy()
        # Foxglove follows ROS: pixel centres lie at integers, ours at integer + 0.5.
        k[:2, 2] -= 0.5
        calibration = CameraCalibration(
            timestamp=stamp,
            frame_id=frame_id,
            width=width,
            height=height,
            K=k.ravel().tolist(),
            R=np.eye(3).ravel().tolist(),
            P=np.hstack([k, np.zeros((3, 1))]).ravel().tolist(),
        )
        self._log(f"/camera/{camera}/calibration", frame, calibration)


def _optical(camera: str) -> str:
    return f"{camera}_optical_frame"


def _add_transform(
    transforms: FrameTransforms, stamp: Timestamp, child: str, pose: NDArray[Any]
) -> None:
    """Adds a pose `x y z qw qx qy qz` in the world."""
    x, y, z, qw, qx, qy, qz = (float(value) for value in pose)
    transform = transforms.transforms.add(
        timestamp=stamp, parent_frame_id=WORLD, child_frame_id=child
    )
    transform.translation.x, transform.translation.y, transform.translation.z = x, y, z
    rotation = transform.rotation
    rotation.x, rotation.y, rotation.z, rotation.w = qx, qy, qz, qw


def _wxyz_of(rotation: NDArray[Any]) -> NDArray[np.float64]:
    """Quaternion of a rotation matrix: the eigenvector of the largest eigenvalue of Bar-Itzhack's K
    (Journal of Guidance 23(6), 2000).
    """
    r = np.asarray(rotation, np.float64)
    k = np.array(
        [
            [r[0, 0] - r[1, 1] - r[2, 2], 0, 0, 0],
            [r[0, 1] + r[1, 0], r[1, 1] - r[0, 0] - r[2, 2], 0, 0],
            [r[0, 2] + r[2, 0], r[1, 2] + r[2, 1], r[2, 2] - r[0, 0] - r[1, 1], 0],
            [r[2, 1] - r[1, 2], r[0, 2] - r[2, 0], r[1, 0] - r[0, 1], np.trace(r)],
        ]
    )
    _, vectors = np.linalg.eigh(k / 3, UPLO="L")
    x, y, z, w = vectors[:, -1]
    return np.array([w, x, y, z]) * (-1.0 if w < 0 else 1.0)


def _cloud(stamp: Timestamp, cloud: NDArray[np.float32]) -> PointCloud:
    points = np.empty(len(cloud), POINT)
    for axis, name in enumerate("xyz"):
        points[name] = cloud[:, axis]
    for channel, name in enumerate(("red", "green", "blue")):
        points[name] = np.clip(np.rint(cloud[:, 3 + channel]), 0, 255)
    points["alpha"] = 255
    message = PointCloud(
        timestamp=stamp, frame_id=WORLD, point_stride=POINT.itemsize, data=points.tobytes()
    )
    message.pose.orientation.w = 1.0
    for name, (kind, offset, *_) in (POINT.fields or {}).items():
        number = PackedElementField.FLOAT32 if kind.itemsize == 4 else PackedElementField.UINT8
        message.fields.add(name=name, offset=offset, type=number)
    return message
