"""Trajectories and episodes in Rerun: bodies that move, joints, cameras, images and clouds."""

from __future__ import annotations

import os
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from akrobat.dataset import Dataset, Episode
from akrobat.errors import InputError

INSTALL = "pip install 'akrobat[viewer]'"
TIMELINE = "time"
JPEG_QUALITY = 90
#: Distance from a camera at which its picture hangs in space, metres.
CAMERA_PLANE_M = 0.25
POINT_RADIUS_M = 0.004


def show(
    shown: Mapping[str, Any],
    *,
    dataset: Path | None,
    episode: int,
    every: int,
    save: Path | None,
) -> list[str]:
    """Shows bodies and joints, and images of a dataset's episode, in a window or into a file.

    :param shown: `title`; `times_s` `[T]`; `bodies` with `name`, `meshes` and `world_from_body`
        `[T or 1, 7]` (`x y z qw qx qy qz`); `tables` from a name to joint names and positions
        `[T, joints]`
    :param dataset: folder that has the episode; no images where absent
    :param every: one of so many images and clouds is shown
    :param save: file to write, in the place of a window
    :return: names of the cameras
    """
    try:
        import rerun as rr
    except ImportError as error:
        message = f"the viewer is not installed ({error}); install it with: {INSTALL}"
        raise InputError(message) from error
    stream = rr.RecordingStream("akrobat", recording_id=shown["title"])
    cameras: list[str] = []
    images = None
    if dataset is not None:
        images = Dataset(dataset).episodes[episode]
        cameras = [str(name) for name in images.attributes["cameras"]]
    partial = None
    if save is not None:
        # Next to the file, so that it can take its name when it is whole.
        partial = save.with_name(f".{save.name}.{os.getpid()}.partial")
        stream.save(partial, default_blueprint=_blueprint(shown, cameras))
    else:
        stream.spawn(default_blueprint=_blueprint(shown, cameras))
    try:
        _log(stream, shown, images, cameras, every)
        stream.flush()
        stream.disconnect()
        if partial is not None and save is not None:
            _publish(partial, save)
    finally:
        if partial is not None:
            partial.unlink(missing_ok=True)
    return cameras


def _log(
    stream: Any, shown: Mapping[str, Any], images: Episode | None, cameras: list[str], every: int
) -> None:
    import rerun as rr

    stream.log("world", rr.ViewCoordinates.RIGHT_HAND_Z_UP, static=True)
    for body in shown["bodies"]:
        _log_body(stream, body, shown["times_s"])
    for name, (columns, values) in shown["tables"].items():
        _log_table(stream, f"joints/{name}", columns, values, shown["times_s"])
    if images is not None:
        _log_episode(stream, images, cameras, every)


def _publish(partial: Path, file: Path) -> None:
    with partial.open("rb") as written:
        os.fsync(written.fileno())
    partial.replace(file)


def _blueprint(shown: Mapping[str, Any], cameras: Iterable[str]) -> Any:
    """One view in space, the joints below it, the cameras beside it."""
    import rerun.blueprint as rrb

    plots = [rrb.TimeSeriesView(origin=f"joints/{name}", name=name) for name in shown["tables"]]
    space = rrb.Vertical(
        rrb.Spatial3DView(origin="world", name=shown["title"]),
        rrb.Horizontal(*plots),
        row_shares=[3, 1],
    )
    pictures = [
        rrb.Tabs(
            *(
                rrb.Spatial2DView(origin=f"world/cameras/{name}/{kind}", name=f"{name} {kind}")
                for kind in ("color", "depth")
            )
        )
        for name in cameras
    ]
    if not pictures:
        return rrb.Blueprint(space)
    return rrb.Blueprint(rrb.Horizontal(space, rrb.Vertical(*pictures), column_shares=[3, 1]))


def _log_body(stream: Any, body: Mapping[str, Any], times_s: NDArray[np.float64]) -> None:
    import rerun as rr

    entity = _entity("world", *body["name"].split("/"))
    poses = body["world_from_body"]
    if len(poses) == 1:
        stream.log(entity, _transform(poses[0]), static=True)
    else:
        _send_poses(stream, entity, times_s, poses)
    for number, mesh in enumerate(body["meshes"]):
        surface = rr.Mesh3D(
            vertex_positions=mesh["positions"],
            vertex_normals=mesh["normals"] if len(mesh["normals"]) else None,
            triangle_indices=mesh["triangles"],
            albedo_factor=_srgb(mesh["color"]),
        )
        stream.log(f"{entity}/surface_{number}", surface, static=True)


def _log_table(
    stream: Any,
    entity: str,
    columns: list[str],
    values: NDArray[np.float64],
    times_s: NDArray[np.float64],
) -> None:
    import rerun as rr

    index = rr.TimeColumn(TIMELINE, duration=times_s)
    for name, column in zip(columns, values.T, strict=True):
        path = _entity(*entity.split("/"), name)
        stream.log(path, rr.SeriesLines(names=[name]), static=True)
        stream.send_columns(path, [index], rr.Scalars.columns(scalars=column))


def _log_episode(stream: Any, episode: Episode, cameras: list[str], every: int) -> None:
    import rerun as rr

    times_s = episode["time"]
    tool = np.concatenate([episode["obs/eef_pos"], episode["obs/eef_quat"]], axis=1)
    _send_poses(stream, "world/tool", times_s, tool)
    stream.log("world/tool", rr.TransformAxes3D(0.1), static=True)
    for camera in cameras:
        _log_lens(stream, episode, camera)
    names = set(episode)
    for frame in range(0, episode.frames, every):
        stream.set_time(TIMELINE, duration=float(times_s[frame]))
        for camera in cameras:
            _log_images(stream, episode, names, camera, frame)
        if "point_cloud" in names:
            _log_cloud(stream, episode, frame)


def _log_lens(stream: Any, episode: Episode, camera: str) -> None:
    """The pinhole that the images' middle has: Rerun draws no lenses."""
    import rerun as rr

    prefix = f"camera_obs/{camera}"
    intrinsics = episode.frame(0, [f"{prefix}_intrinsics"])[f"{prefix}_intrinsics"]
    color = f"{prefix}_rgb"
    height, width = episode.frame(0, [color])[color].shape[:2]
    pinhole = rr.Pinhole(
        image_from_camera=intrinsics,
        resolution=[width, height],
        camera_xyz=rr.ViewCoordinates.RDF,
        image_plane_distance=CAMERA_PLANE_M,
    )
    for kind in ("color", "depth"):
        stream.log(f"world/cameras/{camera}/{kind}", pinhole, static=True)


def _log_images(stream: Any, episode: Episode, names: set[str], camera: str, frame: int) -> None:
    import rerun as rr

    color, depth, pose = (
        f"camera_obs/{camera}_{kind}" for kind in ("rgb", "depth", "world_from_camera")
    )
    images = episode.frame(frame, [name for name in (color, depth, pose) if name in names])
    entity = f"world/cameras/{camera}"
    stream.log(entity, _placed(images[pose]))
    if color in images:
        stream.log(f"{entity}/color", rr.Image(images[color]).compress(JPEG_QUALITY))
    if depth in images:
        values = images[depth].reshape(images[depth].shape[:2])
        units_a_metre = 1000.0 if values.dtype == np.uint16 else 1.0
        stream.log(f"{entity}/depth", rr.DepthImage(values, meter=units_a_metre))


def _log_cloud(stream: Any, episode: Episode, frame: int) -> None:
    import rerun as rr

    cloud = episode.frame(frame, ["point_cloud"])["point_cloud"]
    colors = cloud[:, 3:6].astype(np.uint8) if cloud.shape[1] >= 6 else None
    place = _cloud_place(episode, frame)
    points = rr.Points3D(cloud[:, :3], colors=colors, radii=POINT_RADIUS_M)
    stream.log("world/cloud", place, points)


def _cloud_place(episode: Episode, frame: int) -> Any:
    """Where the cloud's frame is in the world."""
    kind = str(episode.array_attributes("point_cloud")["frame"])
    if kind == "base":
        return _transform(episode.frame(frame, ["obs/base_pose"])["obs/base_pose"])
    if kind == "camera":
        name = f"camera_obs/{episode.attributes['cameras'][0]}_world_from_camera"
        return _placed(episode.frame(frame, [name])[name])
    return _placed(np.eye(4))


def _send_poses(
    stream: Any, entity: str, times_s: NDArray[np.float64], poses: NDArray[Any]
) -> None:
    import rerun as rr

    columns = rr.Transform3D.columns(
        translation=poses[:, :3], quaternion=np.roll(poses[:, 3:7], -1, axis=1)
    )
    stream.send_columns(entity, [rr.TimeColumn(TIMELINE, duration=times_s)], columns)


def _transform(pose: NDArray[Any]) -> Any:
    import rerun as rr

    return rr.Transform3D(
        translation=pose[:3], quaternion=rr.Quaternion(xyzw=np.roll(pose[3:7], -1))
    )


def _placed(world_from_body: NDArray[Any]) -> Any:
    """A homogeneous matrix."""
    import rerun as rr

    return rr.Transform3D(translation=world_from_body[:3, 3], mat3x3=world_from_body[:3, :3])


def _srgb(linear: Iterable[float]) -> list[int]:
    """Linear RGBA as 8-bit sRGB (IEC 61966-2-1) with linear alpha."""
    *color, alpha = linear
    curved = [c * 12.92 if c <= 0.0031308 else 1.055 * c ** (1 / 2.4) - 0.055 for c in color]
    return [round(255 * min(max(value, 0.0), 1.0)) for value in (*curved, alpha)]


def _entity(*parts: str) -> str:
    """An entity path whose parts may hold any characters."""
    import rerun as rr

    return rr.new_entity_path(list(parts))
