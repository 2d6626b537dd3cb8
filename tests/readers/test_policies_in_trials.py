"""Checkpoints that LeRobot wrote, and a policy with the interface of DP3, in closed loop: both are
trained for 20 steps on the exports of Summit-Franka's drawer, and then tried by `akrobat eval`.
"""

from __future__ import annotations

import csv
import json
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import torch
import zarr
from test_readers import EXPORTS, act_policy, diffusion_policy

REPOSITORY = Path(__file__).resolve().parents[2]
RIG = REPOSITORY / "tests" / "rigs" / "small.toml"
TASK = REPOSITORY / "configs" / "tasks" / "summit_drawer_empty.toml"
SEEN = ("observation.state", "observation.images.ego_wrist")
STEPS = 20

# A small network with DP3's interface, as a user's own module defines it.
MODULE = """
import os

import torch


class PointPolicy(torch.nn.Module):
    n_obs_steps = 2
    n_action_steps = 4

    def __init__(self, columns):
        super().__init__()
        self.columns = columns
        self.points = torch.nn.Sequential(
            torch.nn.Linear(6, 32), torch.nn.ReLU(), torch.nn.Linear(32, 32)
        )
        seen = self.n_obs_steps * (32 + columns)
        self.head = torch.nn.Linear(seen, self.n_action_steps * columns)

    def forward(self, point_cloud, agent_pos):
        features = self.points(point_cloud).amax(dim=2)
        seen = torch.cat([features, agent_pos], dim=2).flatten(1)
        away = self.head(seen).reshape(len(seen), self.n_action_steps, self.columns)
        return agent_pos[:, -1:] + away

    @torch.no_grad()
    def predict_action(self, observation):
        steps, _, channels = observation["point_cloud"].shape[1:]
        assert (steps, channels) == (2, 6)
        return {"action": self(**observation)}


def make(env):
    weights = torch.load(os.environ["POINT_POLICY"], weights_only=True)
    policy = PointPolicy(weights["head.bias"].shape[0] // PointPolicy.n_action_steps)
    policy.load_state_dict(weights)
    return policy
"""


@pytest.fixture(scope="module")
def assets() -> Path:
    folder = Path(os.environ.get("AKROBAT_SHARED_ASSETS", REPOSITORY.parent / "shared" / "assets"))
    assert folder.is_dir(), f"{folder} is absent"
    return folder


def tried(policy: str, assets: Path, folder: Path, *more: object) -> subprocess.CompletedProcess:
    command = [sys.executable, "-W", "ignore", "-m", "akrobat", "eval", TASK, "--policy", policy]
    command += ["--trajectories", EXPORTS / "summit.h5", "--trials", 1, "-o", folder / "trials"]
    command += ["--rig", RIG, "--assets", assets, "--json", *more]
    environment = {**os.environ, "POINT_POLICY": str(folder / "weights.pt")}
    return subprocess.run(
        list(map(str, command)),
        capture_output=True,
        text=True,
        check=False,
        cwd=folder,
        env=environment,
    )


def only_row(folder: Path) -> dict[str, str]:
    with open(folder / "trials" / "trials.csv", newline="") as table:
        (row,) = csv.DictReader(table)
    return row


def checkpoint(make, folder: Path, seen: tuple[str, ...] = SEEN) -> Path:
    """Trains for 20 steps and saves what LeRobot's own training saves."""
    from lerobot.configs.types import FeatureType
    from lerobot.datasets.factory import resolve_delta_timestamps
    from lerobot.datasets.lerobot_dataset import LeRobotDataset
    from lerobot.policies.factory import make_pre_post_processors
    from lerobot.utils.feature_utils import dataset_to_policy_features

    torch.manual_seed(0)
    where = {"repo_id": "local/summit", "root": EXPORTS / "summit_lerobot"}
    meta = LeRobotDataset(**where, video_backend="pyav").meta
    features = dataset_to_policy_features(meta.features)
    outputs = {k: f for k, f in features.items() if f.type is FeatureType.ACTION}
    config, policy = make(({key: features[key] for key in seen}, outputs), meta.stats)
    times = resolve_delta_timestamps(config, meta)
    times = {k: t for k, t in times.items() if k in (*seen, "action")}
    dataset = LeRobotDataset(**where, delta_timestamps=times, video_backend="pyav")
    loader = torch.utils.data.DataLoader(
        dataset, batch_size=4, shuffle=True, generator=torch.Generator().manual_seed(0)
    )
    before, after = make_pre_post_processors(config, dataset_stats=meta.stats)
    optimizer = torch.optim.AdamW(policy.parameters(), lr=1e-3)
    policy.train()
    for _, batch in zip(range(STEPS), loader, strict=False):
        loss, _ = policy.forward(before(batch))
        optimizer.zero_grad()
        loss.backward()
        optimizer.step()
    saved = folder / "pretrained_model"
    for part in (policy, before, after):
        part.save_pretrained(saved)
    return saved


@pytest.mark.parametrize("make", [act_policy, diffusion_policy])
def test_lerobots_checkpoints_drive_the_robot(make, assets: Path, tmp_path: Path) -> None:
    saved = checkpoint(make, tmp_path)
    done = tried(f"lerobot:{saved}", assets, tmp_path)
    assert done.returncode == 0, done.stderr
    summary = json.loads((tmp_path / "trials" / "summary.json").read_text())
    assert summary["trials"] == 1
    row = only_row(tmp_path)
    assert row["split"] == "seen"
    assert 0 < int(row["steps"]) <= 300
    # Other cameras, or none, are refused with what there is.
    blind = subprocess.run(
        [
            *(sys.executable, "-W", "ignore", "-m", "akrobat", "eval", str(TASK)),
            *("--policy", f"lerobot:{saved}", "-o", str(tmp_path / "blind")),
            *("--trials", "1", "--assets", str(assets)),
        ],
        capture_output=True,
        text=True,
        check=False,
    )
    assert blind.returncode == 2
    assert "the policy sees observation.images.ego_wrist; the trials have" in blind.stderr


def test_actions_are_those_of_the_checkpoint(assets: Path, tmp_path: Path) -> None:
    """An ACT that sees the state of a demonstration answers alike in LeRobot and in the trial."""
    from akrobat.env import OpenObjectEnv
    from akrobat.policy.lerobot import LeRobotPolicy
    from lerobot.policies.act.modeling_act import ACTPolicy
    from lerobot.policies.factory import make_pre_post_processors

    saved = checkpoint(act_policy, tmp_path)
    env = OpenObjectEnv([TASK], trajectories=[EXPORTS / "summit.h5"], rig=RIG, assets=[assets])
    observation, info = env.reset(seed=0)
    ours = LeRobotPolicy(tmp_path, env)
    ours.reset(observation, info)
    action = ours(observation)
    theirs = ACTPolicy.from_pretrained(saved).eval()
    theirs.reset()
    before, after = make_pre_post_processors(theirs.config, pretrained_path=str(saved))
    image = np.moveaxis(observation["ego_wrist_rgb"], 2, 0) / np.float32(255.0)
    state = torch.from_numpy(env.row().astype(np.float32))[None]
    batch = {SEEN[0]: state, SEEN[1]: torch.from_numpy(image)[None]}
    with torch.inference_mode():
        expected = after(theirs.select_action(before(batch)))[0].numpy()
    np.testing.assert_allclose(action, expected, atol=1e-4)
    assert np.abs(expected).max() > 0.1
    # The black image of a camera that is covered gives another answer.
    observation["ego_wrist_rgb"] = np.zeros_like(observation["ego_wrist_rgb"])
    ours.reset(observation, info)
    assert np.abs(ours(observation) - action).max() > 1e-4


def test_a_policy_like_dp3_is_asked_with_clouds(assets: Path, tmp_path: Path) -> None:
    namespace: dict[str, object] = {}
    exec(MODULE, namespace)
    (tmp_path / "points.py").write_text(MODULE)
    data = zarr.open(EXPORTS / "summit_dp3" / "replay_buffer.zarr", mode="r")["data"]
    state, action = (torch.from_numpy(data[name][:]) for name in ("state", "action"))
    cloud = torch.from_numpy(data["point_cloud"][:].astype(np.float32))
    torch.manual_seed(0)
    policy = namespace["PointPolicy"](state.shape[1])
    optimizer = torch.optim.Adam(policy.parameters(), 1e-2)
    losses = []
    for _ in range(STEPS):
        at = torch.randint(1, len(state) - 4, (16,))
        back = torch.stack([at - 1, at], dim=1)
        wanted = torch.stack([action[at + ahead] for ahead in range(4)], dim=1)
        found = policy(cloud[back], state[back])
        loss = torch.nn.functional.mse_loss(found, wanted)
        optimizer.zero_grad()
        loss.backward()
        optimizer.step()
        losses.append(loss.item())
    assert np.mean(losses[-5:]) < np.mean(losses[:5])
    torch.save(policy.state_dict(), tmp_path / "weights.pt")
    points = str(cloud.shape[1])
    done = tried("dp3:points:make", assets, tmp_path, "--cloud-points", points)
    assert done.returncode == 0, done.stderr
    assert 0 < int(only_row(tmp_path)["steps"]) <= 300
