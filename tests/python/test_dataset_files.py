"""Independent readers judge the dataset files: h5py, h5dump, mcap, rosbags and rerun."""

import hashlib
import io
import json
import os
import shutil
import subprocess
import sys
from pathlib import Path

import h5py
import numpy as np
import pytest
import zstandard
from mcap.exceptions import McapError
from mcap.reader import make_reader
from rosbags.typesys import Stores, get_typestore
from rosbags.typesys.msg import get_types_from_msg

REPOSITORY = Path(__file__).resolve().parents[2]
FRAMES = 11
CAMERAS = {"fixed": (48, 64), "wrist": (24, 32)}


def write_sample(folder: Path, container: str) -> Path:
    """Writes the sample dataset with $AKROBAT_SAMPLE_DATASET, or with the example itself."""
    binary = os.environ.get("AKROBAT_SAMPLE_DATASET")
    cargo = [
        "cargo",
        "run",
        "--quiet",
        "--release",
        "-p",
        "akrobat-packager",
        "--example",
        "sample_dataset",
        "--",
    ]
    command = [binary] if binary else cargo
    subprocess.run([*command, str(folder), container], cwd=REPOSITORY, check=True)
    return folder


@pytest.fixture(scope="session")
def hdf5_dataset(tmp_path_factory):
    return write_sample(tmp_path_factory.mktemp("sample") / "hdf5", "hdf5")


@pytest.fixture(scope="session")
def mcap_dataset(tmp_path_factory):
    return write_sample(tmp_path_factory.mktemp("sample") / "mcap", "mcap")


def manifest(folder: Path) -> list[dict]:
    return [json.loads(line) for line in (folder / "manifest.jsonl").read_text().splitlines()]


def stored(folder: Path) -> list[dict]:
    return [entry["stored"] for entry in manifest(folder) if entry["status"] == "accepted"]


def demos(folder: Path):
    """All stored episodes as open h5py groups."""
    for entry in stored(folder):
        with h5py.File(folder / entry["shard"], "r") as file:
            yield file["data"][entry["key"]]


def arrays_below(group) -> dict[str, h5py.Dataset]:
    arrays = {}

    def visit(name, item):
        if isinstance(item, h5py.Dataset):
            arrays[name] = item

    group.visititems(visit)
    return arrays


def test_manifest_lists_every_episode_with_checksums(hdf5_dataset):
    assert [e["status"] for e in manifest(hdf5_dataset)].count("filtered") == 1
    assert len(stored(hdf5_dataset)) == 5
    for entry in stored(hdf5_dataset):
        content = (hdf5_dataset / entry["shard"]).read_bytes()
        assert hashlib.sha256(content).hexdigest() == entry["shard_sha256"]
    assert json.loads((hdf5_dataset / "dataset.json").read_text())["complete"] is True


def test_h5py_reads_every_array(hdf5_dataset):
    for demo in demos(hdf5_dataset):
        arrays = arrays_below(demo)
        assert demo.attrs["num_samples"] == FRAMES
        for name, array in arrays.items():
            values = array[()]
            if values.dtype.kind == "f":
                assert np.isfinite(values).all(), name
                filters = (array.shuffle, array.compression, array.fletcher32)
                assert filters == (True, "gzip", True), name
        for camera, (height, width) in CAMERAS.items():
            rgb = demo[f"camera_obs/{camera}_rgb"]
            assert rgb.shape == (FRAMES, height, width, 3)
            assert rgb.chunks == (1, height, width, 3)
            depth = demo[f"camera_obs/{camera}_depth"]
            assert depth.dtype == np.uint16
            assert depth.attrs["depth_scale"] == 0.001
            assert demo[f"obs/{camera}_rgb"] == rgb, "the image under obs/ is not the same object"


def test_h5py_refuses_a_damaged_chunk(hdf5_dataset, tmp_path):
    entry = stored(hdf5_dataset)[0]
    shard = tmp_path / "shard.hdf5"
    shutil.copy(hdf5_dataset / entry["shard"], shard)
    name = f"data/{entry['key']}/camera_obs/fixed_rgb"
    with h5py.File(shard, "r") as file:
        chunk = file[name].id.get_chunk_info(0)
    content = bytearray(shard.read_bytes())
    content[chunk.byte_offset + chunk.size - 1] ^= 1
    shard.write_bytes(content)
    with h5py.File(shard, "r") as file, pytest.raises(OSError, match="read"):
        file[name][0]


def test_depth_projects_onto_the_scene(hdf5_dataset):
    """Stored K, world_from_camera and depth put floor pixels on the floor; 1 cm off is seen."""
    for demo in demos(hdf5_dataset):
        for camera in CAMERAS:
            depth = demo[f"camera_obs/{camera}_depth"][3, :, :, 0] * 0.001
            floor = (demo[f"camera_obs/{camera}_segmentation"][3, :, :, 0] == 1) & (depth > 0)
            k = demo[f"camera_obs/{camera}_intrinsics"][3]
            world_from_camera = demo[f"camera_obs/{camera}_world_from_camera"][3]
            v, u = np.nonzero(floor)
            rays = np.stack(
                [(u + 0.5 - k[0, 2]) / k[0, 0], (v + 0.5 - k[1, 2]) / k[1, 1], np.ones(len(u))]
            )
            points = world_from_camera[:3, :3] @ (rays * depth[floor]) + world_from_camera[:3, 3:]
            assert len(u) > 100
            assert np.abs(points[2]).max() < 0.001
            assert np.abs(points[2] + 0.01).max() > 0.005, "the comparison cannot fail"


def test_actions_lead_to_the_next_observation(hdf5_dataset):
    for demo in demos(hdf5_dataset):
        positions = demo["obs/joint_pos"][()]
        assert np.array_equal(demo["actions"][:-1], positions[1:])
        assert np.array_equal(demo["actions"][-1], positions[-1])
        assert not np.array_equal(demo["actions"][:-1], positions[:-1])
        assert np.array_equal(demo["obs/actions"][1:], demo["actions"][:-1])
        assert np.allclose(np.linalg.norm(demo["obs/eef_quat"][()], axis=1), 1, atol=1e-6)


def test_h5dump_reads_every_byte(hdf5_dataset):
    h5dump = shutil.which("h5dump")
    assert h5dump, "h5dump is missing: install hdf5-tools"
    for shard in sorted((hdf5_dataset / "shards").iterdir()):
        result = subprocess.run([h5dump, str(shard)], check=False, capture_output=True, text=True)
        assert (result.returncode, result.stderr) == (0, "")
        assert "point_cloud" in result.stdout


def test_mcap_checksums_hold(mcap_dataset):
    for entry in stored(mcap_dataset):
        with open(mcap_dataset / entry["shard"], "rb") as stream:
            reader = make_reader(stream, validate_crcs=True)
            assert reader.get_header().profile == "ros2"
            topics = [channel.topic for _, channel, _ in reader.iter_messages()]
            names = {attachment.name for attachment in reader.iter_attachments()}
            metadata = {record.name: record.metadata for record in reader.iter_metadata()}
        assert topics.count("/points") == FRAMES
        assert topics.count("/tf_static") == 1
        assert names == {"robot.urdf", "rig.toml", "task.toml"}
        assert metadata["akrobat.episode"]["frames"] == str(FRAMES)


def test_mcap_reader_refuses_a_damaged_chunk(mcap_dataset):
    content = bytearray((mcap_dataset / stored(mcap_dataset)[0]["shard"]).read_bytes())
    summary = make_reader(io.BytesIO(bytes(content))).get_summary()
    chunk = summary.chunk_indexes[0]
    content[chunk.chunk_start_offset + chunk.chunk_length // 2] ^= 0xFF
    with pytest.raises((McapError, ValueError, zstandard.ZstdError)):
        list(make_reader(io.BytesIO(bytes(content)), validate_crcs=True).iter_messages())


def test_definitions_are_those_of_ros(mcap_dataset):
    """Every definition in the log, parsed by rosbags, is what rosbags knows for ROS 2 Jazzy."""
    store = get_typestore(Stores.ROS2_JAZZY)
    with open(mcap_dataset / stored(mcap_dataset)[0]["shard"], "rb") as stream:
        schemas = make_reader(stream).get_summary().schemas.values()
    assert len({schema.name for schema in schemas}) == 6
    for schema in schemas:
        assert schema.encoding == "ros2msg"
        for name, fields in get_types_from_msg(schema.data.decode(), schema.name).items():
            assert fields == store.fielddefs[name], name


def test_rosbags_deserialises_every_message(mcap_dataset):
    store = get_typestore(Stores.ROS2_JAZZY)
    with open(mcap_dataset / stored(mcap_dataset)[0]["shard"], "rb") as stream:
        reader = make_reader(stream, validate_crcs=True)
        messages = [
            (
                channel.topic,
                message.log_time,
                store.deserialize_cdr(message.data, schema.name),
                schema,
                message,
            )
            for schema, channel, message in reader.iter_messages()
        ]
    for _, _, value, schema, message in messages:
        assert bytes(store.serialize_cdr(value, schema.name)) == message.data, (
            "not the canonical serialisation"
        )
    by_topic = {topic: (time, value) for topic, time, value, *_ in messages}
    time, depth = by_topic["/camera/fixed/depth/image_raw"]
    assert depth.encoding == "16UC1"
    assert (depth.height, depth.width) == CAMERAS["fixed"]
    assert depth.header.stamp.sec * 10**9 + depth.header.stamp.nanosec == time
    assert depth.data.view(np.uint16).max() > 1000
    _, cloud = by_topic["/points"]
    points = cloud.data.view(np.float32).reshape(-1, 4)
    assert [field.name for field in cloud.fields] == ["x", "y", "z", "rgb"]
    assert points.shape == (256, 4)
    assert (points[:, 2] > -0.001).all()
    _, image = by_topic["/camera/wrist/color/image/compressed"]
    assert image.format == "png"
    assert bytes(image.data[:4]) == b"\x89PNG"
    _, info = by_topic["/camera/fixed/camera_info"]
    assert info.k[2] == 31.5
    assert info.k[5] == 23.5
    _, joints = by_topic["/joint_states"]
    assert joints.name[-1] == "roll"
    assert len(joints.position) == len(joints.name) == 7
    _, transforms = by_topic["/tf"]
    tool = next(t for t in transforms.transforms if t.child_frame_id == "tool")
    q = tool.transform.rotation
    assert abs(np.linalg.norm([q.x, q.y, q.z, q.w]) - 1) < 1e-9


def test_rerun_accepts_the_logs(mcap_dataset):
    """`rerun mcap check` exits with 0 on problems, so its words count."""
    rerun = shutil.which(
        "rerun", path=f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}"
    )
    assert rerun, "rerun is missing: install rerun-sdk"
    for entry in stored(mcap_dataset):
        command = [rerun, "mcap", "check", "--full", str(mcap_dataset / entry["shard"])]
        result = subprocess.run(command, check=False, capture_output=True, text=True, timeout=300)
        output = (result.stdout + result.stderr).lower()
        assert result.returncode == 0, output
        assert output.strip()
        assert not any(
            word in output for word in ["error", "invalid", "failed", "panic", "corrupt"]
        ), output
