"""The environment `AkrobatReplay-v1` for ManiSkill: its tools replay what `akrobat export --to
maniskill` wrote.

    export AKROBAT_ASSET_PATH=ASSETS:TASKS      # where the tasks' files are looked up
    python -m mani_skill.trajectory.replay_trajectory --traj-path OUT/trajectory.h5 \\
        --sim-backend physx_cpu --obs-mode rgbd --use-env-states --save-traj

Physics, success and actions are those of `akrobat/OpenObject-v0`, which runs inside; ManiSkill's
scene holds what there is to draw. The JSON file carries the tasks and the rig, whose cameras are
the environment's `sensor_configs`. Needs `pip install 'akrobat[maniskill]'`, and to draw a Vulkan
driver (`scripts/vulkan.sh`).
"""

from __future__ import annotations

import json
import tempfile
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
import torch
from mani_skill.envs.sapien_env import BaseEnv
from mani_skill.sensors.camera import CameraConfig
from mani_skill.utils.registration import register_env
from mani_skill.utils.structs.types import SimConfig
from numpy.typing import NDArray

from akrobat.env.open_object import HORIZON_STEPS, RATE_HZ, OpenObjectEnv, StrPath
from akrobat.env.starts import Start
from akrobat.errors import InputError
from akrobat.sapien_backend import add_body, add_lighting, camera_pose, sapien_pose

CONTROL_MODE = "pd_joint_pos"

Vector = NDArray[np.float64]


class _Controller:
    """What ManiSkill asks of a controller; the targets are in the environment inside."""

    def reset(self) -> None:
        """Nothing outlasts an episode."""

    def get_state(self) -> dict[str, Any]:
        """There is no state."""
        return {}


class ReplayAgent:
    """The robot as ManiSkill's tools see it: its action space and what it feels."""

    control_mode = CONTROL_MODE

    def __init__(self, simulation: OpenObjectEnv) -> None:
        self._simulation = simulation
        # Cameras belong to the rig, on whichever link they are.
        self._sensor_configs: list[CameraConfig] = []
        self.controller = _Controller()
        self.robot_link_names = list(simulation.place.world.robot.link)

    @property
    def single_action_space(self) -> gymnasium.Space[Any]:
        """Targets of base, arm and fingers, rad and m."""
        return self._simulation.action_space

    @property
    def action_space(self) -> gymnasium.Space[Any]:
        """The same: there is one environment."""
        return self._simulation.action_space

    def set_action(self, action: Any) -> None:
        """Drives to the targets of the first, and only, environment."""
        self._simulation.advance(np.asarray(action, float).reshape(-1))

    def before_simulation_step(self) -> None:
        """The environment inside has stepped already."""

    def reset(self, init_qpos: Any = None) -> None:
        """Starts are set by the environment."""

    def get_proprioception(self) -> dict[str, torch.Tensor]:
        """Positions and speeds of the joints that actions drive."""
        simulation = self._simulation
        body = simulation.place.world.robot
        columns = [body.column[name] for name in simulation.joint_names]
        speed = body.articulation.get_qvel()[columns]
        return {"qpos": _batch(simulation.row()), "qvel": _batch(speed)}

    def get_controller_state(self) -> dict[str, Any]:
        """There is none."""
        return {}


@register_env("AkrobatReplay-v1", max_episode_steps=HORIZON_STEPS)
class AkrobatReplayEnv(BaseEnv):  # type: ignore[misc]
    """A robot opens doors and drawers; see `akrobat/OpenObject-v0`."""

    SUPPORTED_REWARD_MODES = ("sparse", "none")

    def __init__(
        self,
        *args: Any,
        tasks: Sequence[str],
        rig: str | Mapping[str, Any] = "paper",
        assets: Sequence[StrPath] = (),
        control_mode: str | None = None,
        control_freq: float = RATE_HZ,
        render_backend: str | None = None,
        **kwargs: Any,
    ) -> None:
        """Loads the tasks.

        :param tasks: task files, or their texts
        :param rig: cameras: a preset, a rig file or a rig as the JSON file has it
        :param assets: folders where assets are looked up, before those of `$AKROBAT_ASSET_PATH`
        :param control_mode: `pd_joint_pos`, the only one
        :param control_freq: actions per second: 30, the only one
        :param render_backend: ManiSkill's; the processor where there is no NVIDIA card
        """
        if control_mode not in (None, CONTROL_MODE):
            raise InputError(
                f'control_mode: unknown "{control_mode}"; valid choices: {CONTROL_MODE} '
                "(`akrobat export` with its default actions)"
            )
        if round(control_freq) != RATE_HZ:
            raise InputError(f"control_freq: expected {RATE_HZ}, got {control_freq}")
        if render_backend is None:
            render_backend = "gpu" if Path("/dev/nvidia0").exists() else "cpu"
        self._rig = json.dumps(dict(rig)) if isinstance(rig, Mapping) else str(rig)
        with tempfile.TemporaryDirectory() as folder:
            files = [_task_file(task, Path(folder), number) for number, task in enumerate(tasks)]
            self.simulation = OpenObjectEnv(files, assets=assets)
        self._task = 0
        self._still_cameras: dict[str, Vector] = {}
        self._observer = self._mounted()
        self._bodies: list[Any] = []
        super().__init__(*args, control_mode=CONTROL_MODE, render_backend=render_backend, **kwargs)

    @property
    def _default_sim_config(self) -> SimConfig:
        return SimConfig(sim_freq=RATE_HZ, control_freq=RATE_HZ)

    # -- the scene that is drawn -------------------------------------------------------------------

    def _load_agent(self, options: dict[str, Any], *_: Any, **__: Any) -> None:
        self.agent = ReplayAgent(self.simulation)

    def _load_scene(self, options: dict[str, Any]) -> None:
        if self.scene.can_render():
            scene = self.scene.sub_scenes[0]
            self._bodies = [add_body(scene, body) for body in self._observer.bodies()]

    def _load_lighting(self, options: dict[str, Any]) -> None:
        add_lighting(self.scene.sub_scenes[0], self._observer.lighting())

    @property
    def _default_sensor_configs(self) -> list[CameraConfig]:
        return [
            CameraConfig(
                uid=name,
                pose=camera_pose(camera["world_from_camera"]),
                width=camera["width"],
                height=camera["height"],
                intrinsic=np.asarray(camera["K"], np.float32),
                near=camera["near_m"],
                far=camera["far_m"],
            )
            for name, camera in self._placed()["cameras"].items()
        ]

    @property
    def _default_human_render_camera_configs(self) -> list[CameraConfig]:
        (config, *_) = self._default_sensor_configs
        config.uid, config.shader_pack, config.shader_config = "render_camera", "minimal", None
        config.__post_init__()
        return [config]

    def _mounted(self) -> Any:
        return self.simulation.observer(self._rig, {"points": 0})

    def _placed(self) -> dict[str, Any]:
        simulation = self.simulation
        placed = self._observer.place(simulation.row().tolist(), simulation.object_row().tolist())
        for name, pose in self._still_cameras.items():
            placed["cameras"][name]["world_from_camera"] = pose
        return placed

    def _show(self) -> None:
        """Moves what is drawn, and the cameras, to where they are now."""
        placed = self._placed()
        for entity, pose in zip(self._bodies, placed["world_from_body"], strict=True):
            entity.set_pose(sapien_pose(pose))
        poses = {name: c["world_from_camera"] for name, c in placed["cameras"].items()}
        first, *_ = poses
        for name, sensor in self._sensors.items():
            sensor.camera.set_local_pose(camera_pose(poses[name]))
        for sensor in self._human_render_cameras.values():
            sensor.camera.set_local_pose(camera_pose(poses[first]))

    # -- episodes ----------------------------------------------------------------------------------

    def reset(
        self, seed: Any = None, options: dict[str, Any] | None = None
    ) -> tuple[Any, dict[str, Any]]:
        """Starts an episode. `options` may hold `task` (a position), `robot` and `object` (joint
        positions), `goal` and `cameras` (world poses of those that stand still), as exported files
        say; else a start is drawn by the seed."""
        options = dict(options or {})
        task = int(options.get("task", 0))
        if not 0 <= task < len(self.simulation.places):
            last = len(self.simulation.places) - 1
            raise InputError(f"options: no task {task}; valid choices: 0 to {last}")
        if task != self._task:
            self._task, options["reconfigure"] = task, True
        self.simulation.place = self.simulation.places[task]
        if "robot" in options:
            goal = float(options.get("goal", self.simulation.place.task.goals[0]))
            self.simulation.begin(Start(np.asarray(options["robot"], float), goal, None))
        else:
            number = np.ravel(seed)[0] if seed is not None else None
            drawn = {"place": task}
            self.simulation.reset(seed=None if number is None else int(number), options=drawn)
        if "object" in options:
            self._put(self.simulation.row(), np.asarray(options["object"], float))
        self._observer = self._mounted()
        cameras = options.get("cameras", {})
        self._still_cameras = {name: np.asarray(pose, float) for name, pose in cameras.items()}
        found: tuple[Any, dict[str, Any]] = super().reset(seed=seed, options=options)
        return found

    def _step_action(self, action: Any) -> Any:
        if action is not None:
            self.agent.set_action(action)
        return action

    def get_obs(self, info: Any = None, unflattened: bool = False) -> Any:
        """As ManiSkill's own."""
        if self.scene.can_render():
            self._show()
        return super().get_obs(info, unflattened)

    def render_rgb_array(self, camera_name: str | None = None) -> Any:
        """As ManiSkill's own."""
        self._show()
        return super().render_rgb_array(camera_name)

    def _get_obs_extra(self, info: dict[str, Any]) -> dict[str, torch.Tensor]:
        simulation = self.simulation
        return {
            "tcp_pose": _batch(simulation.place.world.tool_pose()),
            "object_qpos": _batch(simulation.object_row()),
        }

    def evaluate(self) -> dict[str, torch.Tensor]:
        """Success as everywhere in Akrobat."""
        return {"success": torch.tensor([self.simulation.is_success()])}

    # -- states ------------------------------------------------------------------------------------

    def get_state_dict(self) -> dict[str, Any]:
        """Both articulations as exported files have them: root pose and velocity, positions,
        speeds."""
        articulations = {}
        for name, body, joints in self._articulations():
            columns = [body.column[joint] for joint in joints]
            root = body.articulation.root.entity_pose
            articulations[name] = np.concatenate(
                [
                    root.p,
                    root.q,
                    np.zeros(6),
                    body.articulation.get_qpos()[columns],
                    body.articulation.get_qvel()[columns],
                ]
            )
        # No actors: everything that moves is one of these.
        return {"articulations": {name: _batch(state) for name, state in articulations.items()}}

    def set_state_dict(self, state: dict[str, Any], env_idx: Any = None) -> None:
        """Puts both articulations where a state says."""
        rows = []
        for name, _, joints in self._articulations():
            if name not in state["articulations"]:
                have = ", ".join(state["articulations"])
                raise InputError(f"state: no articulation {name}; there are {have}")
            values = np.ravel(np.asarray(state["articulations"][name], float))
            expected = 13 + 2 * len(joints)
            if len(values) != expected:
                raise InputError(f"state of {name}: expected {expected} numbers, got {len(values)}")
            rows.append(values[13 : 13 + len(joints)])
        self._put(*rows)

    def _put(self, robot: Vector, thing: Vector) -> None:
        simulation = self.simulation
        (_, _, robot_joints), (_, _, object_joints) = self._articulations()
        simulation.place.world.reset(
            dict(zip(robot_joints, robot.tolist(), strict=True)),
            dict(zip(object_joints, thing.tolist(), strict=True)),
        )

    def _articulations(self) -> list[tuple[str, Any, list[str]]]:
        world = self.simulation.place.world
        robot, thing = world.robot_description, world.object_description
        return [
            (robot["name"], world.robot, self.simulation.joint_names),
            (thing["name"], world.object, thing["dof_joints"]),
        ]


def _task_file(task: str, folder: Path, number: int) -> Path:
    """A task's file; a text becomes one."""
    if "\n" not in task:
        return Path(task)
    file = folder / f"task_{number}.toml"
    file.write_text(task, encoding="utf-8")
    return file


def _batch(values: Any) -> torch.Tensor:
    return torch.as_tensor(np.asarray(values, np.float32))[None]
