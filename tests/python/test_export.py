"""Exports hold what the dataset holds, by each format's own reader or, where that is heavy, by the
library that it stands on (the heavy readers: `make test-readers`).

Every comparison has a negative control: a flipped channel order or a wrong unit fails it.
"""

from __future__ import annotations

import json
from pathlib import Path

import akrobat
import av
import h5py
import numpy as np
import pyarrow.parquet as pq
import pytest
import zarr
from akrobat.exporters import traj_data
from akrobat.exporters.depth_codes import DepthCodes
from akrobat.exporters.lerobot import LeRobotWriter, Limits
from exports import cameras_of, depth_mm, export, refused, run, tool_poses
from mcap.reader import make_reader
from mcap_protobuf.decoder import DecoderFactory
from PIL import Image
from rosbags.typesys import Stores, get_typestore
from ruamel.yaml import YAML

REPOSITORY = Path(__file__).parents[2]

RIG = REPOSITORY / "tests" / "rigs" / "small.toml"


@pytest.fixture(scope="session")
def summit(shared_assets, drawer_file, tmp_path_factory):
    """Two episodes of Summit-Franka, from approach to the end, seen by small cameras."""
    return render(drawer_file, tmp_path_factory.mktemp("summit"), shared_assets)


@pytest.fixture(scope="session")
def tiago(shared_assets, tmp_path_factory):
    """An episode of TIAGo, whose licence forbids commercial use."""
    folder = tmp_path_factory.mktemp("tiago")
    task = REPOSITORY / "configs" / "tasks" / "tiago_drawer_empty.toml"
    akrobat.plan(task, folder / "drawer.h5", limit=1, assets=[shared_assets], quiet=True)
    return render(folder / "drawer.h5", folder, shared_assets)


def render(trajectories: Path, folder: Path, assets: Path) -> akrobat.Dataset:
    return akrobat.render(
        trajectories,
        folder / "dataset",
        backend="soft",
        rig=RIG,
        manipulation_only=True,
        assets=[assets],
        quiet=True,
    )


@pytest.fixture(params=["summit", "tiago"])
def dataset(request):
    return request.getfixturevalue(request.param)


def matches(got, expected) -> bool:
    return np.array_equal(np.asarray(got), np.asarray(expected))


# Zarr: DP3 and Diffusion Policy


def episodes_of(file: Path) -> tuple[zarr.Group, list[slice]]:
    """As the replay buffers read: `data/<key>` cut at `meta/episode_ends`."""
    root = zarr.open(str(file), mode="r")
    ends = root["meta/episode_ends"][:]
    starts = [0, *ends[:-1]]
    return root, [slice(int(a), int(b)) for a, b in zip(starts, ends, strict=True)]


@pytest.mark.parametrize("points", [None, 1024])
def test_dp3_has_the_clouds_states_and_actions(dataset, tmp_path, points):
    options = ["--points", points] if points else []
    output = export(dataset.folder, "dp3", tmp_path / "dp3", *options)
    root, slices = episodes_of(output / "replay_buffer.zarr")
    assert set(root["data"].array_keys()) == {"state", "action", "point_cloud"}
    assert len(slices) == len(dataset.episodes)
    for rows, episode in zip(slices, dataset.episodes, strict=True):
        cloud = root["data/point_cloud"][rows]
        assert cloud.shape[1:] == (points or 4096, 6)
        assert matches(cloud, episode["point_cloud"][:, : cloud.shape[1]])
        assert not matches(cloud[..., [0, 1, 2, 5, 4, 3]], episode["point_cloud"])
        assert matches(root["data/state"][rows], episode["obs/joint_pos"])
        assert matches(root["data/action"][rows], episode["actions"])
    assert root.attrs["action_names"] == list(dataset.episodes[0].attributes["robot_joints"])


def test_a_head_of_a_cloud_covers_the_scene_as_the_whole_does(summit):
    """1,024 of 4,096 points: as far apart as farthest-point sampling can put them."""
    cloud = summit.episodes[0]["point_cloud"][0, :, :3]

    def spacing(points):
        gaps = np.linalg.norm(points[:, None] - points[None], axis=2)
        np.fill_diagonal(gaps, np.inf)
        return gaps.min(axis=1).min()

    strided = cloud[:: len(cloud) // 256][:256]
    assert spacing(cloud[:256]) > 1.5 * spacing(strided)


def test_diffusion_policy_has_the_images(dataset, tmp_path):
    output = export(dataset.folder, "diffusion-policy", tmp_path / "dp")
    root, slices = episodes_of(output / "replay_buffer.zarr")
    for rows, episode in zip(slices, dataset.episodes, strict=True):
        for camera in cameras_of(episode):
            rgb = root[f"data/{camera}"][rows]
            assert matches(rgb, episode[f"camera_obs/{camera}_rgb"])
            assert not matches(rgb[..., ::-1], episode[f"camera_obs/{camera}_rgb"])
            assert matches(root[f"data/{camera}_depth"][rows], depth_mm(episode, camera))
            for kind in ("intrinsics", "world_from_camera"):
                expected = episode[f"camera_obs/{camera}_{kind}"]
                assert matches(root[f"data/{camera}_{kind}"][rows], expected)
        assert matches(root["data/eef_pose"][rows], tool_poses(episode))
    assert root.attrs["conventions"]["color_order"].startswith("RGB")
    assert root.attrs["depth_unit"] == "mm"


# HDF5: ACT, robomimic, ManiSkill, AutoMoMa


def act_episode(file: Path):
    """As ACT's `EpisodicDataset` reads an episode, JPEG included (ALOHA's `compress`)."""
    with h5py.File(file) as root:
        assert root.attrs["sim"]
        images = {}
        for number, camera in enumerate(root["observations/images"]):
            stored = root[f"observations/images/{camera}"][()]
            if root.attrs["compress"]:
                lengths = root["compress_len"][number]
                stored = [decoded(row[:n]) for row, n in zip(stored, lengths, strict=True)]
            images[camera] = np.asarray(stored)
        return root["observations/qpos"][()], root["action"][()], images


def decoded(stream) -> np.ndarray:
    """What `cv2.imdecode` gives: blue, green, red."""
    import io

    return np.asarray(Image.open(io.BytesIO(stream.tobytes())))[..., ::-1]


def test_act_plain(dataset, tmp_path):
    output = export(dataset.folder, "act", tmp_path / "act")
    for index, episode in enumerate(dataset.episodes):
        qpos, action, images = act_episode(output / f"episode_{index}.hdf5")
        assert matches(qpos, episode["obs/joint_pos"])
        assert matches(action, episode["actions"])
        assert set(images) == set(cameras_of(episode))
        for camera, rgb in images.items():
            assert matches(rgb, episode[f"camera_obs/{camera}_rgb"])
            assert not matches(rgb[..., ::-1], episode[f"camera_obs/{camera}_rgb"])


def test_act_jpeg_gives_rgb_to_acts_own_decoder(summit, tmp_path):
    output = export(summit.folder, "act", tmp_path / "act", "--jpeg", "--episodes", 0)
    episode = summit.episodes[0]
    for camera, rgb in act_episode(output / "episode_0.hdf5")[2].items():
        expected = episode[f"camera_obs/{camera}_rgb"].astype(int)
        assert np.abs(rgb - expected).mean() < 3
        assert np.abs(rgb[..., ::-1] - expected).mean() > 2 * np.abs(rgb - expected).mean()


def test_robomimic_scales_and_says_how(dataset, tmp_path):
    output = export(dataset.folder, "robomimic", tmp_path / "rm", "--validation", 0.5)
    with h5py.File(output / "demos.hdf5") as file:
        data = file["data"]
        masks = {name: [k.decode() for k in file[f"mask/{name}"][()]] for name in file["mask"]}
        assert sorted(masks["train"] + masks["valid"]) == sorted(data)
        assert masks["success"] == list(data)
        assert json.loads(data.attrs["env_args"])["type"] == 2
        scale, offset = data.attrs["action_scale"], data.attrs["action_offset"]
        seen = np.concatenate([data[key]["actions"][()] for key in data])
        assert seen.min() == -1
        assert seen.max() == 1
        for key, episode in zip(data, dataset.episodes, strict=True):
            demo = data[key]
            assert demo.attrs["num_samples"] == episode.frames
            assert matches(demo["actions_unscaled"], episode["actions"])
            unscaled = demo["actions"][()] * scale + offset
            assert np.abs(unscaled - episode["actions"]).max() < 1e-6
            assert np.abs(demo["actions"][()] - episode["actions"]).max() > 0.1
            assert demo["dones"][()].tolist() == [0] * (episode.frames - 1) + [1]
            for camera in cameras_of(episode):
                expected = episode[f"camera_obs/{camera}_rgb"]
                assert matches(demo[f"obs/{camera}_image"], expected)
                metres = demo[f"obs/{camera}_depth"][..., 0]
                assert matches(np.rint(metres * 1000), depth_mm(episode, camera))


def test_maniskill_has_one_observation_more_than_actions(dataset, tmp_path):
    output = export(dataset.folder, "maniskill", tmp_path / "ms")
    described = json.loads((output / "trajectory.json").read_text())
    with h5py.File(output / "trajectory.h5") as file:
        for entry, episode in zip(described["episodes"], dataset.episodes, strict=True):
            group = file[f"traj_{entry['episode_id']}"]
            steps = entry["elapsed_steps"]
            assert steps == episode.frames - 1 == len(group["actions"])
            assert matches(group["actions"], episode["actions"][:-1])
            assert matches(group["obs/agent/qpos"], episode["obs/joint_pos"])
            assert matches(group["obs/agent/qpos"][1:], group["actions"])
            assert group["success"][-1]
            assert not group["success"][:-1].any()
            check_maniskill_states(group, episode)
            for camera in cameras_of(episode):
                check_maniskill_camera(group, episode, camera)


def check_maniskill_states(group, episode):
    for name in group["env_states/articulations"]:
        state = group[f"env_states/articulations/{name}"][()]
        native = f"states/articulation/{name}"
        joints = episode[f"{native}/joint_position"].shape[1]
        assert state.shape == (episode.frames, 13 + 2 * joints)
        assert matches(state[:, :7], episode[f"{native}/root_pose"])
        assert matches(state[:, 13 : 13 + joints], episode[f"{native}/joint_position"])
        assert matches(state[:, 13 + joints :], episode[f"{native}/joint_velocity"])


def check_maniskill_camera(group, episode, camera):
    data, param = group[f"obs/sensor_data/{camera}"], group[f"obs/sensor_param/{camera}"]
    assert matches(data["rgb"], episode[f"camera_obs/{camera}_rgb"])
    assert data["depth"].dtype == np.int16
    assert matches(data["depth"][..., 0], depth_mm(episode, camera))
    assert not matches(data["depth"][..., 0] * 0.001, depth_mm(episode, camera))
    pose = episode[f"camera_obs/{camera}_world_from_camera"]
    assert np.allclose(param["intrinsic_cv"], episode[f"camera_obs/{camera}_intrinsics"])
    assert np.allclose(param["extrinsic_cv"], np.linalg.inv(pose)[:, :3], atol=1e-5)
    flip = np.diag([1.0, -1.0, -1.0, 1.0])
    assert np.allclose(param["cam2world_gl"], pose @ flip, atol=1e-6)
    assert not np.allclose(param["cam2world_gl"], pose, atol=1e-3)


def test_automoma_has_the_recorders_layout(dataset, tmp_path):
    output = export(dataset.folder, "automoma", tmp_path / "am", "--base", "relative")
    with h5py.File(output / "recording.hdf5") as file:
        for key, episode in zip(file["data"], dataset.episodes, strict=True):
            demo = file["data"][key]
            joints = episode["obs/joint_pos"]
            assert matches(demo["obs/joint_pos"], joints)
            assert matches(demo["states/articulation/robot/joint_position"], joints)
            assert demo["initial_state/articulation/robot/joint_position"].shape[0] == 1
            object_id = demo.attrs["object_id"]
            opened = episode[f"states/articulation/{object_id}/joint_position"]
            assert matches(demo[f"states/articulation/{object_id}/joint_position"], opened)
            # The base moves by differences along the world's axes; all else is absolute.
            change = np.diff(joints[:, :3].astype(np.float64), axis=0)
            assert np.abs(demo["actions"][:-1, :3] - change).max() < 1e-6
            assert matches(demo["actions"][:, 3:], episode["actions"][:, 3:])
            for camera in cameras_of(episode):
                depth = demo[f"camera_obs/{camera}_depth"]
                assert depth.dtype == np.float32
                assert matches(np.rint(depth[..., 0] * 1000), depth_mm(episode, camera))
                expected = episode[f"camera_obs/{camera}_rgb"]
                assert matches(demo[f"camera_obs/{camera}_rgb"], expected)


# Actions and states


def test_eleven_columns_and_a_base_in_its_own_frame(summit, tmp_path):
    options = ["--gripper", "opening", "--base", "local", "--state", "eef-pose"]
    output = export(summit.folder, "dp3", tmp_path / "dp3", *options)
    root, slices = episodes_of(output / "replay_buffer.zarr")
    assert root["data/action"].shape[1] == 11
    for rows, episode in zip(slices, summit.episodes, strict=True):
        action = root["data/action"][rows].astype(np.float64)
        base = episode["obs/joint_pos"][:, :3].astype(np.float64)
        reached = [base[0]]
        for x, y, turn in action[:-1, :3]:
            px, py, heading = reached[-1]
            cos, sin = np.cos(heading), np.sin(heading)
            reached.append([px + cos * x - sin * y, py + sin * x + cos * y, heading + turn])
        error = np.asarray(reached) - base
        error[:, 2] = (error[:, 2] + np.pi) % (2 * np.pi) - np.pi
        assert np.abs(error).max() < 1e-5
        unrotated = base[0] + np.concatenate([[np.zeros(3)], np.cumsum(action[:-1, :3], axis=0)])
        moved = np.ptp(base[:, :2]) > 0.02
        assert not moved or np.abs(unrotated - base)[:, :2].max() > 1e-4
        fingers = episode["obs/gripper_pos"]
        assert np.allclose(action[:-1, 10], fingers.mean(axis=1)[1:], atol=1e-7)


def test_velocities_integrate_and_tool_motions_compose(summit, tmp_path):
    output = export(summit.folder, "dp3", tmp_path / "v", "--actions", "joint-velocity")
    root, slices = episodes_of(output / "replay_buffer.zarr")
    episode, rows = summit.episodes[0], slices[0]
    steps = np.diff(episode["time"])[:, None]
    reached = episode["obs/joint_pos"][:-1, :10] + steps * root["data/action"][rows][:-1, :10]
    assert np.abs(reached - episode["obs/joint_pos"][1:, :10]).max() < 1e-5

    options = ["--actions", "eef-delta", "--eef-frame", "world"]
    output = export(summit.folder, "dp3", tmp_path / "d", *options)
    root, slices = episodes_of(output / "replay_buffer.zarr")
    action = root["data/action"][slices[0]]
    shift = np.diff(episode["obs/eef_pos"], axis=0)
    assert np.abs(action[:-1, 3:6] - shift).max() < 1e-6
    turned = np.linalg.norm(action[:-1, 6:9], axis=1)
    quaternions = episode["obs/eef_quat"].astype(np.float64)
    cosine = np.abs((quaternions[1:] * quaternions[:-1]).sum(axis=1)).clip(0, 1)
    assert np.abs(turned - 2 * np.arccos(cosine)).max() < 2e-3


def test_quaternion_order_is_chosen_and_told(summit, tmp_path):
    found = {}
    for order in ("wxyz", "xyzw"):
        options = ["--actions", "eef-pose", "--eef-frame", "world", "--quat", order]
        output = export(summit.folder, "dp3", tmp_path / order, *options)
        root, slices = episodes_of(output / "replay_buffer.zarr")
        assert order in root.attrs["conventions"]["quat_order"]
        found[order] = root["data/action"][slices[0]]
    expected = tool_poses(summit.episodes[0])[1:]
    assert np.abs(found["wxyz"][:-1, 3:10] - expected).max() < 1e-5
    assert np.allclose(found["xyzw"][:, [9, 6, 7, 8]], found["wxyz"][:, 6:10])
    assert not np.allclose(found["xyzw"][:, 6:10], found["wxyz"][:, 6:10])


# MCAP and ROS 2


def test_mcap_ros2(dataset, tmp_path):
    output = export(dataset.folder, "mcap", tmp_path / "mcap")
    store = get_typestore(Stores.ROS2_JAZZY)
    episode = dataset.episodes[0]
    with open(output / "episode_0.mcap", "rb") as stream:
        reader = make_reader(stream, validate_crcs=True)
        found: dict[str, list] = {}
        for schema, channel, message in reader.iter_messages():
            value = store.deserialize_cdr(message.data, schema.name)
            found.setdefault(channel.topic, []).append(value)
    for camera in cameras_of(episode):
        images = found[f"/camera/{camera}/color/image/compressed"]
        assert len(images) == episode.frames
        rgb = np.asarray(Image.open(__import__("io").BytesIO(bytes(images[3].data))))
        assert matches(rgb, episode[f"camera_obs/{camera}_rgb"][3])
        depth = found[f"/camera/{camera}/depth/image_raw"][3].data.view(np.uint16)
        assert matches(depth, depth_mm(episode, camera)[3].ravel())
        k = found[f"/camera/{camera}/camera_info"][3].k.reshape(3, 3)
        expected = episode[f"camera_obs/{camera}_intrinsics"][3]
        assert np.allclose(k[:2, 2] + 0.5, expected[:2, 2])
        assert np.isclose(k[0, 0], expected[0, 0])
    states = np.array([state.position for state in found["/joint_states"]])
    assert matches(states[:, : states.shape[1] - 1], episode["obs/joint_pos"]) or matches(
        states[:, : episode["obs/joint_pos"].shape[1]], episode["obs/joint_pos"]
    )


def test_mcap_foxglove(dataset, tmp_path):
    output = export(dataset.folder, "mcap", tmp_path / "mcap", "--profile", "foxglove")
    episode = dataset.episodes[0]
    with open(output / "episode_0.mcap", "rb") as stream:
        reader = make_reader(stream, decoder_factories=[DecoderFactory()], validate_crcs=True)
        found: dict[str, list] = {}
        for _, channel, _, message in reader.iter_decoded_messages():
            found.setdefault(channel.topic, []).append(message)
        assert {record.name for record in reader.iter_metadata()} >= {"akrobat.conventions"}
    for camera in cameras_of(episode):
        color = found[f"/camera/{camera}/color"][2]
        rgb = np.frombuffer(color.data, np.uint8).reshape(color.height, color.width, 3)
        assert color.encoding == "rgb8"
        assert matches(rgb, episode[f"camera_obs/{camera}_rgb"][2])
        assert not matches(rgb[..., ::-1], episode[f"camera_obs/{camera}_rgb"][2])
        depth = np.frombuffer(found[f"/camera/{camera}/depth"][2].data, np.uint16)
        assert matches(depth, depth_mm(episode, camera)[2].ravel())
        transform = {t.child_frame_id: t for t in found["/tf"][2].transforms}
        q = transform[f"{camera}_optical_frame"].rotation
        pose = episode[f"camera_obs/{camera}_world_from_camera"][2]
        assert np.allclose(rotation_of(q.w, q.x, q.y, q.z), pose[:3, :3], atol=1e-6)
    cloud = found["/points"][2]
    points = np.frombuffer(cloud.data, np.uint8).reshape(-1, cloud.point_stride)
    expected = episode["point_cloud"][2]
    assert matches(points[:, :12].copy().view(np.float32), expected[:, :3])
    assert matches(points[:, 12:15], np.rint(expected[:, 3:]))
    joints = {joint.name: joint.position for joint in found["/joint_states"][2].joints}
    names = episode.attributes["robot_joints"]
    assert matches(np.float32([joints[n] for n in names]), episode["obs/joint_pos"][2])


def rotation_of(w, x, y, z):
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
        ]
    )


def test_joint_trajectories_for_ros2(dataset, tmp_path):
    output = export(dataset.folder, "joint-trajectory", tmp_path / "jt")
    store = get_typestore(Stores.ROS2_JAZZY)
    episode = dataset.episodes[0]
    names = list(episode.attributes["robot_joints"])
    text = YAML(typ="safe").load(output / "episode_0.yaml")
    assert list(text) == ["base", "arm", "gripper"]
    assert [name for group in text.values() for name in group["joint_names"]] == names
    points = [text[group]["points"] for group in text]
    positions = np.hstack([[p["positions"] for p in group] for group in points])
    assert matches(positions.astype(np.float32), episode["obs/joint_pos"])
    with open(output / "episode_0.mcap", "rb") as stream:
        for schema, channel, message in make_reader(stream, validate_crcs=True).iter_messages():
            value = store.deserialize_cdr(message.data, schema.name)
            again = store.serialize_cdr(value, schema.name)
            assert bytes(again) == message.data, "not the canonical serialisation"
            group = channel.topic.split("/")[1]
            assert value.joint_names == text[group]["joint_names"]
            last = value.points[-1].time_from_start
            seconds = last.sec + last.nanosec * 1e-9
            assert seconds == pytest.approx(episode["time"][-1], abs=1e-8)


# LeRobot, by pyarrow and PyAV


def test_lerobot_by_pyarrow_and_pyav(dataset, tmp_path):
    output = export(dataset.folder, "lerobot", tmp_path / "lr")
    info = json.loads((output / "meta" / "info.json").read_text())
    assert info["codebase_version"] == "v3.0"
    assert info["total_episodes"] == len(dataset.episodes)
    rows = pq.read_table(output / "data" / "chunk-000" / "file-000.parquet")
    entries = pq.read_table(output / "meta" / "episodes").to_pylist()
    for entry, episode in zip(entries, dataset.episodes, strict=True):
        part = rows.slice(entry["dataset_from_index"], entry["length"])
        for key, expected in (("action", "actions"), ("observation.state", "obs/joint_pos")):
            assert matches(np.stack(part[key].to_numpy()), episode[expected])
        cloud = np.array(part["point_cloud"].to_pylist()[0], np.float32)
        assert matches(cloud, episode["point_cloud"][0])
        for camera in cameras_of(episode):
            check_lerobot_camera(output, entry, part, episode, camera)


def check_lerobot_camera(output, entry, part, episode, camera):
    codes = DepthCodes()
    rgb = video(output, entry, f"observation.images.{camera}", "rgb24").astype(int)
    expected = episode[f"camera_obs/{camera}_rgb"].astype(int)
    assert rgb.shape == expected.shape
    assert np.abs(rgb - expected).mean() < 4
    assert np.abs(rgb[1:] - expected[:-1]).mean() > 0, "a shift by one frame is not noticed"
    depth = video(output, entry, f"observation.images.{camera}_depth", "gray12le")
    native = depth_mm(episode, camera)
    packed = np.array(part[f"depth_valid.{camera}"].to_pylist(), np.uint8)
    valid = np.unpackbits(packed, axis=2, count=native.shape[2]).astype(bool)
    assert matches(valid, (native > 0) & (native <= 10_000))
    error = np.abs(codes.decode(depth) - native / 1000)[valid]
    assert (error <= codes.error_m(native[valid] / 1000) + 1e-9).all()
    assert np.abs(codes.decode(depth) - native)[valid].max() > 1, "a wrong unit is not noticed"
    k = np.stack(part[f"camera.{camera}.intrinsics"].to_numpy()).reshape(-1, 3, 3)
    assert matches(k, episode[f"camera_obs/{camera}_intrinsics"])
    pose = np.stack(part[f"camera.{camera}.world_from_camera"].to_numpy()).reshape(-1, 4, 4)
    assert matches(pose, episode[f"camera_obs/{camera}_world_from_camera"])


def video(output: Path, entry: dict, key: str, pixels: str) -> np.ndarray:
    place = (entry[f"videos/{key}/{n}_index"] for n in ("chunk", "file"))
    file = output / "videos" / key / "chunk-{:03d}/file-{:03d}.mp4".format(*place)
    first = round(entry[f"videos/{key}/from_timestamp"] * 30)
    with av.open(str(file)) as container:
        frames = [frame.to_ndarray(format=pixels) for frame in container.decode(video=0)]
    return np.stack(frames)[first : first + entry["length"]]


def test_lerobot_fills_files_and_folders(tmp_path):
    """Tiny limits: every episode in a file of its own, two files in a folder."""
    cameras = [{"name": "eye", "width": 32, "height": 24}]
    header = {
        "frame_rate_hz": 30.0,
        "cameras": cameras,
        "robots": {"pillar": 3},
        "action_names": ["a"] * 2,
        "state_names": ["s"] * 2,
        "conventions": {},
    }
    limits = Limits(data_file_bytes=1, video_file_bytes=1, files_per_chunk=2)
    writer = LeRobotWriter(tmp_path, header, limits)
    attributes = {"instruction": "Open.", "frames": 64, "id": "", "success": True, "seed": 0}
    attributes |= {"grasp_id": 0, "goal": 1.0, "robot_id": "", "object_id": "", "scene_id": ""}
    rng = np.random.default_rng(0)
    for index in range(3):
        tables = {name: rng.random((64, 2), np.float32) for name in ("action", "state")}
        tables |= {name: np.zeros((64, 7), np.float32) for name in ("eef_pose", "base_pose")}
        tables |= {
            "object_position": np.zeros((64, 1), np.float32),
            "phase": np.zeros(64, np.uint8),
        }
        tables |= {"time": np.arange(64) / 30, "eye/intrinsics": np.zeros((64, 3, 3))}
        tables |= {"eye/world_from_camera": np.zeros((64, 4, 4))}
        writer.begin(index, json.dumps(attributes), tables)
        images = rng.integers(0, 255, (64, 24, 32, 3), np.uint8)
        depth = rng.integers(0, 9000, (64, 24, 32), np.uint16)
        writer.frames(0, {"eye/rgb": images, "eye/depth_mm": depth})
        writer.end()
    writer.finish()
    for folder in ("data", "videos/observation.images.eye", "videos/observation.images.eye_depth"):
        files = sorted(
            str(f.relative_to(tmp_path / folder).with_suffix(""))
            for f in (tmp_path / folder).rglob("file-*")
        )
        assert files == ["chunk-000/file-000", "chunk-000/file-001", "chunk-001/file-000"]
    entries = pq.read_table(tmp_path / "meta" / "episodes").to_pylist()
    assert [e["data/chunk_index"] for e in entries] == [0, 0, 1]
    assert [e["dataset_from_index"] for e in entries] == [0, 64, 128]


# traj_data.pt


def test_traj_data_round_trips(drawer_file, tmp_path):
    output = export(drawer_file, "automoma", tmp_path / "traj")
    found = traj_data.load(output / "traj_data.pt")
    native = akrobat.open(drawer_file)
    robot = np.stack([t.waypoints_robot for t in native])
    assert matches(found["traj_robot"], robot)
    assert matches(found["start_robot"], robot[:, 0])
    assert matches(found["goal_obj"], found["traj_obj"][:, -1])
    assert found["traj_success"].tolist() == [True] * len(native)
    assert found["object_id"] == "drawer_1001"


def test_a_pickle_that_runs_something_is_refused(tmp_path):
    import pickle
    import zipfile

    class Bomb:
        def __reduce__(self):
            return (Path.touch, (tmp_path / "ran",))

    with zipfile.ZipFile(tmp_path / "bomb.pt", "w") as archive:
        archive.writestr("archive/data.pkl", pickle.dumps({"traj_robot": Bomb()}, protocol=2))
    with pytest.raises(akrobat.InputError, match="only tensors"):
        traj_data.load(tmp_path / "bomb.pt")
    assert not (tmp_path / "ran").exists()


def test_tensors_that_claim_too_much_are_refused(tmp_path):
    file = tmp_path / "t.pt"
    traj_data.save(file, {"traj_robot": np.zeros((2, 3), np.float32)})
    assert traj_data.load(file)["traj_robot"].shape == (2, 3)
    content = file.read_bytes()
    shape = b"\x8a\x08" + (3).to_bytes(8, "little")
    huge = content.replace(shape, b"\x8a\x08" + (2**40).to_bytes(8, "little"))
    assert huge != content
    (tmp_path / "huge.pt").write_bytes(huge)
    with pytest.raises(akrobat.InputError):
        traj_data.load(tmp_path / "huge.pt")
    for size in range(0, len(content), 97):
        (tmp_path / "cut.pt").write_bytes(content[:size])
        with pytest.raises(akrobat.InputError):
            traj_data.load(tmp_path / "cut.pt")


# Licences, cards, wrong and hostile input


def test_non_commercial_assets_need_a_flag(tiago, tmp_path):
    output = tmp_path / "out"
    message = refused("export", tiago.folder, "--to", "dp3", "-o", output)
    assert "CC-BY-NC-ND-3.0" in message
    assert "--allow-non-commercial" in message
    assert not output.exists()
    export(tiago.folder, "dp3", output)
    assert "**Not for commercial use**" in (output / "README.md").read_text()


def test_the_card_tells_contents_and_licences(summit, tmp_path):
    output = export(summit.folder, "lerobot", tmp_path / "lr")
    text = (output / "README.md").read_text()
    front = YAML(typ="safe").load(text.split("---")[1])
    assert front["task_categories"] == ["robotics"]
    assert "LeRobot" in front["tags"]
    assert front["size_categories"] == ["n<1K"]
    for word in ("BSD-3-Clause", "drawer_1001", "base_x", "wxyz", "Provenance"):
        assert word in text, word
    picture = np.asarray(Image.open(output / "card" / "episode_0.png"))
    assert picture.shape == (120 + 64, 3 * 160, 3)
    assert picture.std() > 10
    result = run("card", summit.folder)
    assert result.returncode == 0, result.stderr
    assert (summit.folder / "README.md").is_file()
    assert run("validate", summit.folder).returncode == 0


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (["--cameras", "nose"], ["nose", "ego_wrist, fixed"]),
        (["--points", 100_000], ["points", "4096"]),
        (["--robot", "r2d2"], ["summit_franka"]),
        (["--episodes", "7"], ["0 to 1", "7"]),
        (["--validation", "2"], ["--validation"]),
    ],
)
def test_wrong_settings_name_the_valid_ones(summit, tmp_path, options, words):
    output = tmp_path / "out"
    message = refused("export", summit.folder, "--to", "dp3", "-o", output, *options)
    for word in words:
        assert word in message
    assert not any(tmp_path.iterdir())


def test_outputs_that_stand_already_are_left_alone(summit, tmp_path):
    (tmp_path / "mine").write_text("precious")
    message = refused("export", summit.folder, "--to", "act", "-o", tmp_path)
    assert "not empty" in message
    link = tmp_path / "link"
    (tmp_path / "elsewhere").mkdir()
    link.symlink_to(tmp_path / "elsewhere")
    assert "symbolic link" in refused("export", summit.folder, "--to", "act", "-o", link)
    assert not any((tmp_path / "elsewhere").iterdir())
    assert (tmp_path / "mine").read_text() == "precious"


ELSEWHERE = {
    "../secret.hdf5": "not a file in shards/",
    "/etc/passwd": "not a file in shards/",
    "shards/link.hdf5": "got a link to",
}


@pytest.mark.parametrize("shard", ELSEWHERE)
def test_datasets_that_name_files_elsewhere_are_refused(summit, tmp_path, shard):
    folder = copy_of(summit.folder, tmp_path / "dataset")
    (folder / "shards" / "link.hdf5").symlink_to(tmp_path / "secret.hdf5")
    (tmp_path / "secret.hdf5").write_bytes(b"")
    change_manifest(folder, shard=shard)
    message = refused("export", folder, "--to", "act", "-o", tmp_path / "out")
    assert ELSEWHERE[shard] in message
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize(("key", "frames"), [("../x", None), ("demo_0/obs", None), (None, 2**31)])
def test_manifests_that_lie_are_refused(summit, tmp_path, key, frames):
    folder = copy_of(summit.folder, tmp_path / "dataset")
    change_manifest(folder, **({"key": key} if key else {"frames": frames}))
    refused("export", folder, "--to", "act", "-o", tmp_path / "out")
    assert not (tmp_path / "out").exists()


def copy_of(source: Path, target: Path) -> Path:
    import shutil

    return Path(shutil.copytree(source, target))


def change_manifest(folder: Path, **changes: object) -> None:
    file = folder / "manifest.jsonl"
    lines = [json.loads(line) for line in file.read_text().splitlines()]
    for line in lines:
        line["stored"] |= changes
    file.write_text("".join(json.dumps(line) + "\n" for line in lines))


def test_the_same_export_twice_has_the_same_bytes(summit, tmp_path):
    for format in ("robomimic", "maniskill", "act", "dp3", "lerobot", "mcap"):
        first, second = (export(summit.folder, format, tmp_path / f"{format}{n}") for n in "12")
        files = sorted(f.relative_to(first) for f in first.rglob("*") if f.is_file())
        assert files == sorted(f.relative_to(second) for f in second.rglob("*") if f.is_file())
        for file in files:
            assert (first / file).read_bytes() == (second / file).read_bytes(), file
