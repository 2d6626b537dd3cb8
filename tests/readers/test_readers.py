"""The formats' own readers give back what the dataset holds; policies train on it.

Needs the packages of `requirements.txt` and, in `$AKROBAT_EXPORTS`, what `make_exports.py` makes.
Run by `make test-readers`.
"""

import json
import os
import subprocess
import sys
from pathlib import Path

import h5py
import numpy as np
import pytest
import torch
import zarr
from forge.formats.zarr.reader import ZarrReader
from lerobot.datasets.lerobot_dataset import LeRobotDataset

EXPORTS = Path(os.environ["AKROBAT_EXPORTS"])
EVERY = 40


@pytest.fixture(scope="module", params=["summit", "tiago"])
def robot(request):
    return request.param


@pytest.fixture(scope="module")
def lerobot(robot):
    root = EXPORTS / f"{robot}_lerobot"
    return LeRobotDataset(f"local/{robot}", root=root, video_backend="pyav")


@pytest.fixture(scope="module")
def native(robot):
    """All stored episodes as open h5py groups."""
    folder = EXPORTS / f"{robot}_dataset"
    lines = map(json.loads, (folder / "manifest.jsonl").read_text().splitlines())
    stored = [line["stored"] for line in lines if line.get("stored")]
    files = {entry["shard"]: h5py.File(folder / entry["shard"]) for entry in stored}
    yield [files[entry["shard"]]["data"][entry["key"]] for entry in stored]
    for file in files.values():
        file.close()


def cameras(demo):
    return [
        name.decode() if isinstance(name, bytes) else str(name) for name in demo.attrs["cameras"]
    ]


def test_lerobot_gives_the_tables(lerobot, native):
    rows = lerobot.hf_dataset.with_format("numpy")
    actions, states = np.stack(rows["action"][:]), np.stack(rows["observation.state"][:])
    assert np.array_equal(actions, np.concatenate([demo["actions"][()] for demo in native]))
    assert np.array_equal(states, np.concatenate([demo["obs/joint_pos"][()] for demo in native]))
    assert not np.array_equal(actions, states)
    assert lerobot.num_episodes == len(native)
    assert lerobot.fps == 30
    for key, values in (("action", actions), ("observation.state", states)):
        found = lerobot.meta.stats[key]
        assert np.allclose(found["mean"], values.mean(axis=0), atol=1e-4)
        assert np.allclose(found["std"], values.std(axis=0), atol=1e-4)
        assert np.allclose(found["min"], values.min(axis=0), atol=1e-6)


def test_lerobot_gives_images_depth_and_clouds(lerobot, native):
    first = 0
    for demo in native:
        for frame in range(0, demo.attrs["num_samples"], EVERY):
            item = lerobot[first + frame]
            assert np.array_equal(item["point_cloud"].numpy(), demo["point_cloud"][frame])
            assert item["task"] == "Open the drawer."
            for camera in cameras(demo):
                check_camera(item, demo, camera, frame)
        first += int(demo.attrs["num_samples"])


def check_camera(item, demo, camera, frame):
    expected = demo[f"camera_obs/{camera}_rgb"][frame].astype(int)
    rgb = item[f"observation.images.{camera}"].permute(1, 2, 0).numpy() * 255
    assert np.abs(rgb - expected).mean() < 4
    # Grey scenes look alike with exchanged channels; where there is colour, the order shows.
    spread = np.abs(expected[..., 0] - expected[..., 2]).mean()
    if spread > 8:
        assert np.abs(rgb[..., ::-1] - expected).mean() > np.abs(rgb - expected).mean()
    millimetres = demo[f"camera_obs/{camera}_depth"][frame, :, :, 0].astype(float)
    bits = item[f"depth_valid.{camera}"].numpy().astype(np.uint8)
    valid = np.unpackbits(bits, axis=1, count=millimetres.shape[1]).astype(bool)
    assert np.array_equal(valid, (millimetres > 0) & (millimetres <= 10_000))
    depth = item[f"observation.images.{camera}_depth"][0].numpy()
    # Half a code, and half a millimetre because LeRobot rounds to them.
    bound = (millimetres / 1000 + 3.5) * 1.65e-4 * 1000 + 0.51
    assert (np.abs(depth - millimetres) <= bound)[valid].all()
    assert (np.abs(depth / 1000 - millimetres) > bound)[valid].all(), "a wrong unit passes"
    k = item[f"camera.{camera}.intrinsics"].numpy().reshape(3, 3)
    assert np.allclose(k, demo[f"camera_obs/{camera}_intrinsics"][frame])


#: All but `anomalies`, which ends with a TypeError where a feature of several axes is constant.
DOCTORS_CHECKS = [
    *("metadata", "temporal", "actions", "videos", "statistics", "episodes"),
    *("consistency", "training", "portability", "per_episode"),
]


def test_lerobot_doctor_finds_nothing_wrong(robot):
    doctor = Path(sys.executable).parent / "lerobot-doctor"
    command = [doctor, "check", EXPORTS / f"{robot}_lerobot", "--checks"]
    command.append(",".join(DOCTORS_CHECKS))
    result = subprocess.run(command, check=False, capture_output=True, text=True)
    print(result.stdout)
    assert result.returncode == 0, result.stdout + result.stderr
    assert "FAIL" not in result.stdout


def act_policy(features, stats):
    from lerobot.policies.act.configuration_act import ACTConfig
    from lerobot.policies.act.modeling_act import ACTPolicy

    inputs, outputs = features
    config = ACTConfig(
        input_features=inputs,
        output_features=outputs,
        chunk_size=6,
        n_action_steps=6,
        dim_model=64,
        n_heads=4,
        dim_feedforward=128,
        n_encoder_layers=1,
        n_vae_encoder_layers=1,
        pretrained_backbone_weights=None,
        device="cpu",
    )
    return config, ACTPolicy(config)


def diffusion_policy(features, stats):
    from lerobot.policies.diffusion.configuration_diffusion import DiffusionConfig
    from lerobot.policies.diffusion.modeling_diffusion import DiffusionPolicy

    inputs, outputs = features
    config = DiffusionConfig(
        input_features=inputs,
        output_features=outputs,
        down_dims=(64, 128),
        crop_shape=None,
        pretrained_backbone_weights=None,
        device="cpu",
    )
    return config, DiffusionPolicy(config)


@pytest.mark.parametrize("make", [act_policy, diffusion_policy])
def test_a_policy_learns(robot, make):
    """The mean loss of the last five of 20 steps is below that of the first five."""
    from lerobot.configs.types import FeatureType
    from lerobot.datasets.factory import resolve_delta_timestamps
    from lerobot.policies.factory import make_pre_post_processors
    from lerobot.utils.feature_utils import dataset_to_policy_features

    torch.manual_seed(0)
    root = EXPORTS / f"{robot}_lerobot"
    meta = LeRobotDataset(f"local/{robot}", root=root, video_backend="pyav").meta
    wanted = ("observation.state", "observation.images.ego_wrist")
    features = dataset_to_policy_features(meta.features)
    outputs = {k: f for k, f in features.items() if f.type is FeatureType.ACTION}
    assert list(outputs) == ["action"]
    inputs = {key: features[key] for key in wanted}
    config, policy = make((inputs, outputs), meta.stats)
    times = resolve_delta_timestamps(config, meta)
    times = {k: t for k, t in times.items() if k in (*wanted, "action")}
    dataset = LeRobotDataset(
        f"local/{robot}", root=root, delta_timestamps=times, video_backend="pyav"
    )
    loader = torch.utils.data.DataLoader(
        dataset, batch_size=8, shuffle=True, generator=torch.Generator().manual_seed(0)
    )
    preprocess, _ = make_pre_post_processors(config, dataset_stats=meta.stats)
    optimizer = torch.optim.AdamW(policy.parameters(), lr=1e-3)
    policy.train()
    losses = []
    for batch in loader:
        loss, _ = policy.forward(preprocess(batch))
        optimizer.zero_grad()
        loss.backward()
        optimizer.step()
        losses.append(loss.item())
        if len(losses) == 20:
            break
    print(f"{robot} {make.__name__}: loss {losses[0]:.3f} -> {losses[-1]:.3f}")
    assert np.mean(losses[-5:]) < np.mean(losses[:5])


def test_robomimics_sequence_dataset(robot, native):
    from robomimic.utils import obs_utils
    from robomimic.utils.dataset import SequenceDataset

    camera = cameras(native[0])[0]
    modalities = {"low_dim": ["state"], "rgb": [f"{camera}_image"]}
    obs_utils.initialize_obs_modality_mapping_from_dict(modalities)
    file = EXPORTS / f"{robot}_robomimic" / "demos.hdf5"
    with h5py.File(file) as opened:
        scale = opened["data"].attrs["action_scale"]
        offset = opened["data"].attrs["action_offset"]
        masks = {name: len(opened["mask"][name]) for name in opened["mask"]}
    assert masks["train"] + masks["valid"] == masks["success"] == len(native)
    dataset = SequenceDataset(
        str(file),
        obs_keys=("state", f"{camera}_image"),
        dataset_keys=("actions", "rewards", "dones"),
        load_next_obs=False,
        hdf5_use_swmr=False,
    )
    lengths = [int(demo.attrs["num_samples"]) for demo in native]
    assert len(dataset) == sum(lengths)
    for number in range(0, len(dataset), EVERY):
        # robomimic sorts demonstrations by their number.
        episode, frame = place_of(number, lengths)
        item, demo = dataset[number], native[episode]
        assert np.array_equal(item["obs"]["state"][0], demo["obs/joint_pos"][frame])
        image = item["obs"][f"{camera}_image"][0]
        assert np.array_equal(image, demo[f"camera_obs/{camera}_rgb"][frame])
        action = item["actions"][0] * scale + offset
        assert np.abs(action - demo["actions"][frame]).max() < 1e-6
        assert np.abs(item["actions"][0]).max() <= 1


def place_of(number, lengths):
    for episode, length in enumerate(lengths):
        if number < length:
            return episode, number
        number -= length
    raise IndexError(number)


def test_the_page_on_loading_with_pytorch(robot, native, monkeypatch, tmp_path):
    """The block of `docs/loading.md` that `make test` has no PyTorch for."""
    (tmp_path / "dataset").symlink_to(EXPORTS / f"{robot}_dataset")
    monkeypatch.chdir(tmp_path)
    page = (Path(__file__).parents[2] / "docs" / "loading.md").read_text()
    code = page.split("```python\n")[2].split("```")[0].replace("num_workers=2", "num_workers=0")
    names = {}
    exec(code, names)
    frames, batch = names["frames"], names["batch"]
    assert len(frames) == sum(demo.attrs["num_samples"] for demo in native)
    assert batch["image"].shape[:2] == (8, 3)
    sample = frames[len(native[0]["actions"]) + 3]
    assert np.array_equal(sample["action"], native[1]["actions"][3])
    color = sample["image"].permute(1, 2, 0).numpy() * 255
    assert np.abs(color - native[1]["camera_obs/fixed_rgb"][3]).max() < 0.01


def test_torch_loads_traj_data(robot):
    payload = torch.load(EXPORTS / f"{robot}_traj_data" / "traj_data.pt", weights_only=True)
    with h5py.File(EXPORTS / f"{robot}.h5") as file:
        waypoints = file["waypoints/robot"][()]
    assert payload["traj_robot"].shape == waypoints.shape
    assert np.array_equal(payload["traj_robot"].numpy(), waypoints)
    assert payload["traj_success"].dtype == torch.bool
    assert payload["object_id"] == "drawer_1001"
    assert torch.equal(payload["start_robot"], payload["traj_robot"][:, 0])


@pytest.mark.skipif("AKROBAT_DP3" not in os.environ, reason="AKROBAT_DP3 names no checkout of DP3")
def test_dp3s_own_replay_buffer(robot, native):
    """The class itself, from a checkout of the public 3D-Diffusion-Policy, which no index has."""
    sys.path.insert(0, str(Path(os.environ["AKROBAT_DP3"]) / "3D-Diffusion-Policy"))
    from diffusion_policy_3d.common.replay_buffer import ReplayBuffer

    path = EXPORTS / f"{robot}_dp3" / "replay_buffer.zarr"
    buffer = ReplayBuffer.copy_from_path(str(path), keys=["state", "action", "point_cloud"])
    assert buffer.n_episodes == len(native)
    assert np.array_equal(buffer["action"], np.concatenate([d["actions"][()] for d in native]))
    clouds = np.concatenate([demo["point_cloud"][()] for demo in native])
    assert np.array_equal(buffer["point_cloud"], clouds)


@pytest.mark.parametrize("format", ["dp3", "diffusion-policy"])
def test_replay_buffers_in_memory(robot, native, format):
    """As both `ReplayBuffer.copy_from_path` load a zarr: every array whole, cut at the ends."""
    root = zarr.open(str(EXPORTS / f"{robot}_{format}" / "replay_buffer.zarr"), "r")
    ends = root["meta"]["episode_ends"][:]
    data = {key: array[:] for key, array in root["data"].arrays()}
    assert ends[-1] == len(data["action"]) == len(data["state"])
    # What the constructor of DP3's class asks for, and what it prints of each array.
    assert set(data) == set(root["data"].keys())
    assert all(len(array) == ends[-1] for array in data.values())
    assert all(f"{array.min():.2f}~{array.max():.2f}" for array in data.values())
    assert all(array.ndim for _, array in root["meta"].arrays())
    key, expected = ("point_cloud", "point_cloud")
    if format == "diffusion-policy":
        camera = cameras(native[0])[0]
        key, expected = camera, f"camera_obs/{camera}_rgb"
    start = 0
    for end, demo in zip(ends, native, strict=True):
        assert np.array_equal(data["action"][start:end], demo["actions"][()])
        assert np.array_equal(data[key][start:end], demo[expected][()])
        start = end


@pytest.mark.parametrize("format", ["dp3", "diffusion-policy"])
def test_forge_reads_replay_buffers(robot, native, format):
    """Forge, a converter between robotics formats, finds the same episodes in both zarrs."""
    path = EXPORTS / f"{robot}_{format}" / "replay_buffer.zarr"
    assert ZarrReader.can_read(path)
    for episode, demo in zip(ZarrReader().read_episodes(path), native, strict=True):
        frames = list(episode.frames())
        assert np.array_equal([frame.action for frame in frames], demo["actions"][()])
        assert np.array_equal([frame.state for frame in frames], demo["obs/joint_pos"][()])
        # By their names, Forge takes the cameras' poses for images too.
        for camera in cameras(demo) if format == "diffusion-policy" else []:
            image = frames[-1].images[camera].load()
            assert np.array_equal(image, demo[f"camera_obs/{camera}_rgb"][-1])
