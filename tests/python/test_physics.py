"""Planned trajectories in PhysX: one that works, and what must make it fail, and why."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import akrobat
import h5py
import numpy as np
import pytest
from akrobat import InputError
from akrobat.physics import PhysicsConfig, Replayer, World, poses, replay
from akrobat.physics.audit import EpisodeAudit
from akrobat.physics.replay import timeline
from akrobat.physics.shapes import Detail, convex_pieces

TASKS = Path(__file__).parents[2] / "configs" / "tasks"


@pytest.fixture(scope="module")
def task(shared_assets: Path, drawer_file: Path) -> Any:
    return akrobat.Task.of_trajectories(drawer_file, [shared_assets])


def replayed(task: Any, file: Path, episode: int = 0, **settings: Any) -> EpisodeAudit:
    replayer = Replayer(task, PhysicsConfig.of(settings))
    return replayer.replay(akrobat.Trajectories.read(file), episode)


@pytest.fixture(scope="module")
def planned(task: Any, drawer_file: Path) -> EpisodeAudit:
    return replayed(task, drawer_file)


def test_a_planned_trajectory_opens_the_drawer(planned: EpisodeAudit) -> None:
    found = planned.findings
    assert planned.success, planned.reason
    assert found["clean"], found
    assert found["opened_fraction_end"] > 0.98
    assert found["handle_distance_end_m"] < 0.05
    assert found["two_finger_contact_fraction"] == 1.0
    assert found["slip_max_m"] < 0.005
    assert found["penetration_max_m"] < 0.002
    assert found["tool_error_max_m"] < 0.02
    assert found["other_contacts_n"] == {}
    assert found["spikes"] == 0


def test_nothing_but_contact_moves_the_drawer(planned: EpisodeAudit) -> None:
    opened = planned.traces["opened"][:, 0]
    held = planned.traces["finger_force"].min(axis=1) > 0.0
    assert np.abs(opened[~held]).max() < 1e-3
    # The fingers press with the force that the robot's file gives them, on both sides.
    assert 15.0 < np.median(planned.traces["finger_force"][held]) < 30.0


@pytest.mark.parametrize(
    ("settings", "reason"),
    [
        ({"keep_gripper_open": True}, "no_grasp"),
        # Farther away: the fingers close in front of the handle. To the side they may still be
        # around it, since they open 8 cm.
        ({"object_offset_m": [-0.03, 0.0, 0.0]}, "no_grasp"),
        ({"grip_force_n": 0.5}, "slipped"),
        ({"time_stretch": 0.5}, "over_speed"),
    ],
    ids=["open gripper", "object 3 cm off", "weak gripper", "twice the speed"],
)
def test_what_cannot_work_fails_with_its_reason(
    task: Any, drawer_file: Path, settings: dict[str, Any], reason: str
) -> None:
    trajectories = akrobat.Trajectories.read(drawer_file)
    assert len(trajectories) > 1
    replayer = Replayer(task, PhysicsConfig.of(settings))
    for episode in range(len(trajectories)):
        audit = replayer.replay(trajectories, episode)
        assert not audit.success
        assert audit.reason == reason, audit.findings
        assert audit.findings["opened_fraction_max"] < 0.5


def test_a_robot_refuses_to_move_faster_than_it_can(
    task: Any, drawer_file: Path, planned: EpisodeAudit
) -> None:
    # The plan keeps to the limits, and comes near them; at twice the speed it is beyond them.
    told = max(planned.findings["command_speed_fraction_max"].values())
    assert 0.6 < told <= 1.0 + 1e-3
    assert planned.findings["stopped_at_s"] is None
    audit = replayed(task, drawer_file, time_stretch=0.5)
    twice = audit.findings["command_speed_fraction_max"]
    assert max(twice.values()) == pytest.approx(2.0 * told, rel=0.1)
    # It stops within its own limits, and stays where it stopped.
    times_s = audit.traces["times"][:, 0]
    standing = times_s > audit.findings["stopped_at_s"] + 0.5
    assert standing.sum() > 30
    assert np.ptp(audit.traces["robot"][standing][:, :10], axis=0).max() < 0.02
    assert audit.findings["opened_fraction_max"] < 0.01
    # A little slower is well within them.
    assert replayed(task, drawer_file, time_stretch=1.2).success


def test_speed_limits_alone_cut_the_motion_off(task: Any, drawer_file: Path) -> None:
    audit = replayed(task, drawer_file, time_stretch=0.5, protective_stop=False)
    assert audit.findings["tool_error_max_m"] > 0.05
    assert audit.findings["robot_speed_fraction_max"] < 1.2
    assert audit.findings["stopped_at_s"] is None


def test_an_episode_does_not_depend_on_those_before_it(
    task: Any, drawer_file: Path, planned: EpisodeAudit
) -> None:
    replayer = Replayer(task, PhysicsConfig.of())
    trajectories = akrobat.Trajectories.read(drawer_file)
    replayer.replay(trajectories, 1)
    again = replayer.replay(trajectories, 0)
    for name, trace in planned.traces.items():
        np.testing.assert_allclose(again.traces[name], trace, atol=1e-3, rtol=0.05, err_msg=name)


def test_implausible_joints_are_calibrated_and_recorded(task: Any) -> None:
    record = Replayer(task, PhysicsConfig.of()).record()
    slider = next(j for j in record["object_joints"] if j["name"] == "drawer_slider_0")
    assert slider["calibrated"]
    assert slider["urdf_friction"] == 1000.0
    assert 0.0 < slider["friction"] < 50.0
    assert slider["damping"] == slider["urdf_damping"]
    assert record["gains"]["panda_joint1"]["effort_limit"] == 87.0


def test_convex_pieces_say_how_wrong_they_are(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("AKROBAT_CACHE_DIR", str(tmp_path))
    corners = np.array([[x, y, z] for x in (0, 1) for y in (0, 1) for z in (0, 1)], np.float32)
    sides = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
    closed = [t for a, b, c, d in sides for t in ((a, b, c), (a, c, d))]
    box = convex_pieces(corners, np.array(closed, np.uint32), Detail.HULL)
    assert len(box.pieces) == 1
    assert box.missing_m < 1e-6
    assert box.protrusion_m < 1e-6
    # A tray: its hull fills what is open.
    tray = convex_pieces(corners, np.array(closed[:-2], np.uint32), Detail.HULL)
    assert tray.protrusion_m > 0.1
    files = sorted(tmp_path.rglob("*.npz"))
    assert len(files) == 2
    stamp = [file.stat().st_mtime_ns for file in files]
    assert convex_pieces(corners, np.array(closed, np.uint32), Detail.HULL).missing_m < 1e-6
    assert [file.stat().st_mtime_ns for file in files] == stamp


def test_poses_agree_with_their_formulas() -> None:
    rng = np.random.default_rng(0)
    for _ in range(20):
        a, b = rng.normal(size=(2, 7))
        a[3:] /= np.linalg.norm(a[3:])
        b[3:] /= np.linalg.norm(b[3:])
        point, axis = rng.normal(size=(2, 3))
        axis /= np.linalg.norm(axis)
        # Rodrigues' formula with the quaternion's own angle and axis.
        angle, about = 2.0 * np.arccos(a[3]), a[4:] / np.sin(np.arccos(a[3]))
        turned = (
            point * np.cos(angle)
            + np.cross(about, point) * np.sin(angle)
            + about * (about @ point) * (1.0 - np.cos(angle))
        )
        np.testing.assert_allclose(poses.transform(a, point), a[:3] + turned, atol=1e-12)
        both = poses.transform(poses.compose(a, b), point)
        np.testing.assert_allclose(both, poses.transform(a, poses.transform(b, point)), atol=1e-12)
        back = poses.transform(poses.inverse(a), poses.transform(a, point))
        np.testing.assert_allclose(back, point, atol=1e-12)
        x_turned = poses.rotate(poses.rotation_from_x_to(axis), [1.0, 0.0, 0.0])
        np.testing.assert_allclose(x_turned, axis, atol=1e-12)


def test_fingers_press_before_each_manipulation() -> None:
    # Grasp, manipulate, change the grasp, manipulate; one sample each 0.1 s.
    phase = np.repeat(np.array([1, 2, 3, 4, 3], np.uint8), 10)
    times_s = 0.1 * np.arange(50)
    robot = np.stack([times_s, np.where(phase == 4, 0.04, 0.01)], axis=1).astype(np.float32)
    trajectory: Any = SimpleNamespace(phase=phase, times_s=times_s, robot=robot)
    config = PhysicsConfig.of({"time_stretch": 2.0, "squeeze_s": 0.5, "settle_s": 0.25})
    path = timeline(trajectory, 1, config)
    assert path.times_s[-1] == pytest.approx(2.0 * 4.9 + 2 * 0.5 + 0.25, abs=1e-6)
    # The arm stands during the pauses, which lie after samples 19 and 39, and at the end.
    standing = np.abs(path.arm_speed[:, 0]) < 1e-9
    assert standing.sum() * config.timestep_s == pytest.approx(1.25, abs=0.05)
    assert path.pressing[standing & (path.times_s < 9.0)].all()
    assert not path.pressing[path.phase == 1].any()
    assert path.pressing[np.isin(path.phase, (2, 3))].all()
    # While the grasp changes, the fingers follow the plan.
    changing = (path.phase == 4) & ~standing
    assert not path.pressing[changing][5:-5].any()


def test_processes_do_not_change_the_result(shared_assets: Path, drawer_file: Path) -> None:
    audits = replay(drawer_file, assets=[shared_assets], workers=2)
    assert [audit.episode for audit in audits] == [0, 1]
    for audit in audits:
        (alone,) = replay(drawer_file, episodes=[audit.episode], assets=[shared_assets])
        assert alone.findings == audit.findings


def run(*arguments: object) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-m", "akrobat", *map(str, arguments)]
    return subprocess.run(command, capture_output=True, text=True, check=False)


def test_the_command_writes_audit_and_page_and_renders_what_was_simulated(
    drawer_file: Path, shared_assets: Path, tmp_path: Path
) -> None:
    folder = tmp_path / "data"
    page = tmp_path / "audit.html"
    tail = ("--assets", shared_assets, "--json")
    before = run("render", drawer_file, "-o", folder, "--states", "simulated", *tail)
    assert before.returncode == 2
    assert "akrobat replay" in before.stderr
    replay_run = run("replay", drawer_file, "--episodes", "0", "--page", page, *tail)
    assert replay_run.returncode == 0, replay_run.stderr
    report = json.loads(replay_run.stdout)
    assert (report["episodes"], report["succeeded"], report["clean"]) == (1, 1, 1)
    audit_path = drawer_file.with_suffix(".audit.h5")
    with h5py.File(audit_path) as audit:
        assert audit.attrs["format"] == "akrobat.audit"
        simulated = audit["traces/robot"][:]
        assert audit["success"][:].tolist() == [1]
        assert audit["offset"][:].tolist() == [0, len(simulated)]
        findings = json.loads(audit["findings"][0])
        assert findings["needed_fraction"] == 0.9
    text = page.read_text()
    assert text.count("<svg") == 7
    assert "NaN" not in text
    rendered = run(
        "render", drawer_file, "-o", folder, "--states", "simulated", "--phases", "manipulate",
        "--backend", "soft", *tail,
    )  # fmt: skip
    audit_path.unlink()
    # The second trajectory was not driven, so it is left out.
    assert rendered.returncode == 3, rendered.stderr
    report = json.loads(rendered.stdout)
    assert (report["episodes"], report["filtered"]) == (1, 1)
    shown = np.stack([frame["actions"] for frame in akrobat.open(folder)])
    # A frame's action is the state of the frame after it, on the path that was really driven.
    gaps = np.abs(simulated[:, None, :] - shown[None, :, : simulated.shape[1]]).max(axis=2)
    assert gaps.min(axis=0).max() < 0.02
    planned = akrobat.open(drawer_file)[0].robot
    assert np.abs(planned[:, None, :] - simulated[None]).max(axis=2).min(axis=0).max() > 1e-4


@pytest.mark.parametrize(
    ("content", "message"),
    [
        ("stifness = 1.0", "unknown field `stifness`"),
        ("pad_friction = -1.0", "pad_friction: expected a number from 0"),
        ("timestep_s = 1.0", "timestep_s: expected a number from"),
        ("timestep_s =", "gains.toml"),
    ],
)
def test_wrong_settings_are_refused(
    tmp_path: Path, drawer_file: Path, content: str, message: str
) -> None:
    gains = tmp_path / "gains.toml"
    gains.write_text(content)
    result = run("replay", drawer_file, "--gains", gains)
    assert result.returncode == 2
    assert message in result.stderr
    assert not drawer_file.with_suffix(".audit.h5").exists()


def test_objects_that_are_picked_up_are_refused(shared_assets: Path) -> None:
    task = akrobat.Task.load(TASKS / "summit_chair_room.toml", [shared_assets])
    with pytest.raises(InputError, match="its object is planar"):
        World(task, PhysicsConfig.of())


def test_wrong_arguments_are_refused(drawer_file: Path, shared_assets: Path) -> None:
    result = run("replay", drawer_file, "--episodes", "7", "--assets", shared_assets)
    assert result.returncode == 2
    assert "no episode 7; valid choices: 0 to 1" in result.stderr
    with pytest.raises(InputError, match="unknown field `speed`"):
        PhysicsConfig.of({"speed": 2.0})
