"""Saved trajectories rendered again with other rigs, lightings, sensors and modalities."""

from __future__ import annotations

import json
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import akrobat
import cv2
import h5py
import numpy as np
import pytest
from numpy.typing import NDArray

JOB = """
name = "again"
trajectories = ["{trajectories}"]
output = "out"
assets = ["{assets}"]
filter = {{ episodes = "0" }}
[render]
backend = "soft"
manipulation_only = true
cloud = {{ points = 256 }}
[variants]
rigs = ["paper", "small.toml", "lens.toml"]
lightings = ["even", "studio"]
sensors = ["ideal", "kinect"]
"""

SMALL = """
name = "small"
[[cameras]]
name = "near"
width = 80
height = 60
fov_rad = 1.0
rate_hz = 10.0
jitter = { position_m = 0.02, rotation_rad = 0.02 }
mount = { on = "look_at_handle", offset = [1.2, 0.6, 0.6] }
"""

LENS = """
name = "lens"
[[cameras]]
name = "wide"
width = 160
height = 120
k = [[90, 0, 80], [0, 90, 60], [0, 0, 1]]
distortion = { model = "kannala_brandt", k1 = 0.02, k2 = -0.01 }
mount = { on = "look_at", relative_to = "handle", position = [1.3, -0.5, 0.7], target = [0, 0, 0] }
"""


def akrobat_cli(*arguments: Any) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-m", "akrobat", *map(str, arguments)]
    return subprocess.run(command, capture_output=True, text=True, check=False)


@pytest.fixture(scope="module")
def job(drawer_file: Path, shared_assets: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("job")
    (folder / "small.toml").write_text(SMALL)
    (folder / "lens.toml").write_text(LENS)
    file = folder / "job.toml"
    file.write_text(JOB.format(trajectories=drawer_file, assets=shared_assets))
    return file


@pytest.fixture(scope="module")
def rendered(job: Path) -> dict[str, Path]:
    """Datasets by variant."""
    done = akrobat_cli("--json", "run", job)
    assert done.returncode == 0, done.stderr
    report = json.loads(done.stdout)
    outputs = {"-".join([o["rig"], o["lighting"], o["sensor"]]): o for o in report["outputs"]}
    assert len(outputs) == 3 * 2 * 2
    return {name: Path(output["output"]) for name, output in outputs.items()}


def demo(dataset: Path) -> h5py.Group:
    (line,) = (dataset / "manifest.jsonl").read_text().splitlines()
    stored = json.loads(line)["stored"]
    return h5py.File(dataset / stored["shard"])["data"][stored["key"]]


def source_rows(trajectories: Path, times_s: NDArray[np.float64]) -> NDArray[np.float32]:
    """Robot joint positions at times on the dense path, straight from the file."""
    trajectory = akrobat.open(trajectories)[0]
    path_times = np.asarray(trajectory.times_s, np.float64)
    rows = np.asarray(trajectory.robot, np.float64)
    after = np.minimum(np.searchsorted(path_times, times_s), len(path_times) - 1)
    before = np.maximum(after - 1, 0)
    span = path_times[after] - path_times[before]
    fraction = np.where(
        span > 0, np.clip((times_s - path_times[before]) / np.where(span > 0, span, 1), 0, 1), 1.0
    )
    return (rows[before] + (rows[after] - rows[before]) * fraction[:, None]).astype(np.float32)


def test_motion_is_that_of_the_source_to_the_bit(
    rendered: dict[str, Path], drawer_file: Path
) -> None:
    some = demo(next(iter(rendered.values())))
    expected = source_rows(drawer_file, some["time"][()])
    names = ["obs/joint_pos", "actions", "states/articulation/drawer_1001/joint_position", "time"]
    for name, dataset in rendered.items():
        episode = demo(dataset)
        np.testing.assert_array_equal(episode["obs/joint_pos"][()], expected, err_msg=name)
        np.testing.assert_array_equal(episode["actions"][:-1], expected[1:], err_msg=name)
        for array in names:
            assert episode[array][()].tobytes() == some[array][()].tobytes(), (name, array)
    # Control: half a frame later the rows differ.
    assert not np.array_equal(expected, source_rows(drawer_file, some["time"][()] + 1 / 60))


def test_images_differ_where_they_should(rendered: dict[str, Path]) -> None:
    plain = demo(rendered["paper-even-ideal"])["camera_obs"]
    lit = demo(rendered["paper-studio-ideal"])["camera_obs"]
    noisy = demo(rendered["paper-even-kinect"])["camera_obs"]
    np.testing.assert_array_equal(plain["fixed_depth"][()], lit["fixed_depth"][()])
    assert not np.array_equal(plain["fixed_rgb"][()], lit["fixed_rgb"][()])
    np.testing.assert_array_equal(plain["fixed_rgb"][()], noisy["fixed_rgb"][()])
    assert not np.array_equal(plain["fixed_depth"][()], noisy["fixed_depth"][()])


def test_a_slow_camera_repeats_its_image_and_says_when_it_was_taken(
    rendered: dict[str, Path],
) -> None:
    episode = demo(rendered["small-even-ideal"])
    taken, times = episode["camera_obs/near_time"][()], episode["time"][()]
    frames = np.arange(len(times))
    np.testing.assert_array_equal(taken, times[frames // 3 * 3])
    images = episode["camera_obs/near_rgb"]
    for frame in frames:
        np.testing.assert_array_equal(images[frame], images[frame // 3 * 3])
    assert not np.array_equal(images[0], images[len(frames) // 3 * 3 - 3])


def test_the_error_of_a_mounting_is_recorded(rendered: dict[str, Path]) -> None:
    drawn = json.loads(demo(rendered["small-even-ideal"]).attrs["provenance"])["drawn"]
    x, y, z, w, *_ = drawn["mount_from_camera"]["near"]
    assert 0.0 < np.linalg.norm([x, y, z]) < 0.1
    assert 0.9 < w < 1.0


def test_a_job_that_ran_already_changes_nothing(job: Path, rendered: dict[str, Path]) -> None:
    files = [p for folder in rendered.values() for p in folder.rglob("*") if p.is_file()]
    before = {file: file.read_bytes() for file in files}
    done = akrobat_cli("--json", "run", job)
    assert done.returncode == 0, done.stderr
    assert all(o["report"]["resumed"] == 1 for o in json.loads(done.stdout)["outputs"])
    assert {file: file.read_bytes() for file in files} == before


def test_a_dry_run_tells_frames_bytes_and_time_and_writes_nothing(
    job: Path, rendered: dict[str, Path], tmp_path: Path
) -> None:
    done = akrobat_cli("--json", "run", job, "--dry-run", "-o", tmp_path / "none")
    assert done.returncode == 0, done.stderr
    assert not (tmp_path / "none").exists()
    for output in json.loads(done.stdout)["outputs"]:
        name = "-".join([output["rig"], output["lighting"], output["sensor"]])
        shards = list((rendered[name] / "shards").iterdir())
        size = sum(shard.stat().st_size for shard in shards)
        assert output["frames"] == demo(rendered[name])["time"].shape[0]
        assert 0.5 < output["expected_bytes"] / size < 2.0, (name, output, size)
        assert output["expected_seconds"] > 0


@pytest.fixture(scope="module")
def all_modalities(
    drawer_file: Path, shared_assets: Path, tmp_path_factory: pytest.TempPathFactory
) -> Iterator[h5py.Group]:
    folder = tmp_path_factory.mktemp("modalities")
    (folder / "lens.toml").write_text(LENS)
    names = "rgb depth segmentation instance semantic normals xyz flow scene_flow"
    akrobat.render(
        drawer_file,
        folder / "dataset",
        backend="soft",
        rig=folder / "lens.toml",
        modalities=names.split(),
        cloud={"points": 512, "normals": True, "color": False, "frame": "base"},
        episodes=[0],
        manipulation_only=True,
        assets=[shared_assets],
        quiet=True,
    )
    episode = demo(folder / "dataset")
    yield episode
    episode.file.close()


def test_positions_reproject_to_their_own_pixels(all_modalities: h5py.Group) -> None:
    camera = all_modalities["camera_obs"]
    k, lens = camera["wide_intrinsics"][0], camera["wide_intrinsics"].attrs["distortion"]
    assert camera["wide_intrinsics"].attrs["distortion_model"] == "kannala_brandt"
    xyz, depth = camera["wide_xyz"][5], camera["wide_depth"][5, :, :, 0]
    camera_from_world = np.linalg.inv(camera["wide_world_from_camera"][5])
    rows, columns = np.nonzero(depth)
    rotation, _ = cv2.Rodrigues(camera_from_world[:3, :3])
    points = xyz[rows, columns].astype(np.float64)
    own = np.stack([columns + 0.5, rows + 0.5], axis=1)

    def error_px(position: NDArray[np.float64]) -> float:
        pixels, _ = cv2.fisheye.projectPoints(points[:, None], rotation, position, k, lens)
        return float(np.abs(pixels[:, 0] - own).max())

    assert len(points) > 5000
    assert error_px(camera_from_world[:3, 3]) < 0.5
    # Control: a camera 2 cm off is noticed.
    assert error_px(camera_from_world[:3, 3] + [0.02, 0, 0]) > 0.5
    assert not xyz[depth == 0].any()


def test_ids_are_those_of_the_tables(all_modalities: h5py.Group) -> None:
    camera, labels = all_modalities["camera_obs"], all_modalities["segment_labels"]
    table = {
        int(i): (int(c), int(n))
        for i, c, n in zip(labels["id"], labels["class_id"], labels["instance_id"], strict=True)
    }
    table[0] = (0, 0)
    segments = camera["wide_segmentation"][3, :, :, 0]
    expected = np.array([table[int(s)] for s in segments.ravel()])
    np.testing.assert_array_equal(camera["wide_semantic"][3].ravel(), expected[:, 0])
    np.testing.assert_array_equal(camera["wide_instance"][3].ravel(), expected[:, 1])
    instances = [n.decode() for n in all_modalities["instance_labels/name"]]
    assert instances[:2] == ["robot", "object"]
    assert len(set(expected[:, 1])) > 1


def test_normals_are_unit_and_face_the_camera(all_modalities: h5py.Group) -> None:
    camera = all_modalities["camera_obs"]
    normals, xyz = camera["wide_normals"][2], camera["wide_xyz"][2]
    seen = camera["wide_depth"][2, :, :, 0] > 0
    np.testing.assert_allclose(np.linalg.norm(normals[seen], axis=1), 1.0, atol=1e-4)
    toward = camera["wide_world_from_camera"][2][:3, 3] - xyz[seen]
    assert (np.einsum("ij,ij->i", normals[seen], toward) > -1e-3).mean() > 0.99


def test_scene_flow_leads_to_the_next_frame(all_modalities: h5py.Group) -> None:
    """What moves is found in the next image where the flow says."""
    camera = all_modalities["camera_obs"]
    middle = camera["wide_xyz"].shape[0] // 2
    moved = camera["wide_xyz"][middle] + camera["wide_scene_flow"][middle]
    flow = camera["wide_flow"][middle]
    later = camera["wide_xyz"][middle + 1]
    rows, columns = np.nonzero(np.linalg.norm(camera["wide_scene_flow"][middle], axis=2) > 1e-4)
    assert len(rows) > 200
    at = np.rint(np.stack([columns, rows], 1) + flow[rows, columns]).astype(int)
    inside = ((at >= 0) & (at < [160, 120])).all(axis=1)
    rows, columns, at = rows[inside], columns[inside], at[inside]
    error = np.linalg.norm(later[at[:, 1], at[:, 0]] - moved[rows, columns], axis=1)
    without = np.linalg.norm(later[rows, columns] - moved[rows, columns], axis=1)
    assert np.median(error) < 0.01
    assert np.median(error) < np.median(without) + 1e-6


def test_clouds_have_the_columns_and_the_frame_asked_for(all_modalities: h5py.Group) -> None:
    cloud, normals = all_modalities["point_cloud"], all_modalities["point_cloud_normals"]
    assert cloud.shape[1:] == (512, 3)
    assert cloud.attrs["frame"] == normals.attrs["frame"] == "base"
    x, y, z, *quaternion = all_modalities["obs/base_pose"][4].astype(np.float64)
    w, i, j, k = quaternion
    rotation, _ = cv2.Rodrigues(2 * np.arccos(w) * np.array([i, j, k]) / np.linalg.norm([i, j, k]))
    world = cloud[4] @ rotation.T + [x, y, z]
    xyz = all_modalities["camera_obs/wide_xyz"][4].reshape(-1, 3)
    nearest = [np.linalg.norm(xyz - p, axis=1).min() for p in world[::64]]
    assert max(nearest) < 1e-3


@pytest.fixture(scope="module")
def depth_pairs(
    drawer_file: Path, shared_assets: Path, tmp_path_factory: pytest.TempPathFactory
) -> dict[str, NDArray[np.float64]]:
    """The same frames' depth in metres, by sensor."""
    folder = tmp_path_factory.mktemp("sensors")
    depths = {}
    for sensor in ["ideal", "redwood", "stereo"]:
        akrobat.render(
            drawer_file,
            folder / sensor,
            backend="soft",
            sensor=sensor,
            cloud={"points": 0},
            episodes=[0],
            manipulation_only=True,
            assets=[shared_assets],
            quiet=True,
        )
        array = demo(folder / sensor)["camera_obs/fixed_depth"]
        depths[sensor] = array[:8, :, :, 0] * array.attrs["depth_scale"]
    return depths


def test_stereo_depth_is_near_the_ideal_where_it_is_valid(
    depth_pairs: dict[str, NDArray[np.float64]],
) -> None:
    ideal, measured = depth_pairs["ideal"], depth_pairs["stereo"]
    both = (ideal > 0) & (measured > 0)
    assert both.mean() > 0.4
    focal_px = 320 * 50.0 / 20.955
    error_px = focal_px * 0.05 * np.abs(1 / measured[both] - 1 / ideal[both])
    assert np.median(error_px) < 0.5
    assert not np.array_equal(ideal, measured)


MOUNT = 'on = "look_at_handle", offset = [1.2, 0.6, 0.6]'
SHEARED = [[1, 0.2, 0, 0], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]]
BAD_RIGS = {
    "zero focal length": ("fov_rad = 1.0", "focal_mm = 0.0", "focal_mm"),
    "missing link": (
        MOUNT,
        'on = "look_at_tool", link = "elbwo", position = [0, 0, 0]',
        "tool, base, mount",
    ),
    "near beyond far": ("height = 60", "height = 60\nnear_m = 30.0", "near_m < far_m"),
    "sheared pose": (MOUNT, f'on = "world", world_from_camera = {SHEARED}', "orthonormal"),
    "skewed K": ("fov_rad = 1.0", "k = [[300, 2, 40], [0, 300, 30], [0, 0, 1]]", "k must be"),
    "inside the wall": (
        MOUNT,
        'on = "world", world_from_camera = [-4.05, 2, 1, 1, 0, 0, 0]',
        "camera_inside",
    ),
}


@pytest.mark.parametrize("name", BAD_RIGS)
def test_bad_rigs_are_refused_with_the_valid_choices(
    name: str, drawer_file: Path, shared_assets: Path, tmp_path: Path
) -> None:
    old, new, expected = BAD_RIGS[name]
    assert old in SMALL
    rig = tmp_path / "rig.toml"
    rig.write_text(SMALL.replace(old, new))
    out = tmp_path / "dataset"
    arguments = ["render", drawer_file, "-o", out, "--rig", rig, "--assets", shared_assets]
    done = akrobat_cli(*arguments, "--backend", "soft", "--episodes", "0")
    assert done.returncode == 2, done.stderr
    assert expected in done.stderr
    assert not out.exists()


def test_inspect_tells_where_cameras_are_and_what_they_see(
    drawer_file: Path, shared_assets: Path
) -> None:
    done = akrobat_cli(
        "--json",
        "inspect",
        "--rig",
        "paper",
        drawer_file,
        "--assets",
        shared_assets,
        "--backend",
        "soft",
    )
    assert done.returncode == 0, done.stderr
    cameras = {c["name"]: c for c in json.loads(done.stdout)["rig"]["cameras"]}
    assert list(cameras) == ["ego_topdown", "ego_wrist", "fixed"]
    fixed = cameras["fixed"]["view"]
    assert fixed["handle_visible"] > 0.9
    assert fixed["world_from_camera_first"] == fixed["world_from_camera_last"]
    shares = [share for _, share in fixed["sees"]]
    assert shares == sorted(shares, reverse=True)
    assert 0.9 < sum(shares) <= 1.0
    alone = akrobat_cli("inspect", "--rig", "azure_kinect")
    assert alone.returncode == 0
    assert "brown_conrady" in alone.stdout
