"""The compiled half of the package."""

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, final

import numpy as np
from numpy.typing import NDArray

class AkrobatError(Exception):
    """Any failure of an Akrobat function."""

class InputError(AkrobatError):
    """A file or an argument is wrong."""

class RunError(AkrobatError):
    """The machine failed: full disk, lost device."""

@final
class Trajectories:
    """Trajectories of one task: a sequence."""

    @staticmethod
    def read(path: Path) -> Trajectories:
        """Reads a trajectory file."""
    def write(self, path: Path) -> None:
        """Writes a trajectory file."""
    @property
    def header(self) -> dict[str, Any]:
        """What the trajectories share, as plain Python values."""
    @property
    def robot_joints(self) -> list[str]:
        """Names of the robot columns."""
    @property
    def object_joints(self) -> list[str]:
        """Names of the object columns."""
    def __len__(self) -> int: ...
    def __getitem__(self, index: int, /) -> Trajectory: ...
    def __iter__(self) -> Iterator[Trajectory]: ...

@final
class Trajectory:
    """One trajectory. Positions are in radians or metres."""

    @property
    def id(self) -> str:
        """Identity: a hash of scene, object, grasp, seed and configuration."""
    @property
    def seed(self) -> int:
        """The seed of its own random numbers."""
    @property
    def start(self) -> float:
        """Position of the driven object joint at the first waypoint."""
    @property
    def goal(self) -> float:
        """Position of the driven object joint that the last waypoint reaches."""
    @property
    def grasp_id(self) -> int:
        """Number of the grasp within the task."""
    @property
    def link_from_tool(self) -> NDArray[np.float64]:
        """Tool frame in the held link's frame, `x y z qw qx qy qz`."""
    @property
    def waypoints_robot(self) -> NDArray[np.float32]:
        """Robot waypoints of the manipulation `[T, columns]`."""
    @property
    def waypoints_object(self) -> NDArray[np.float32]:
        """Object waypoints of the manipulation `[T, columns]`."""
    @property
    def waypoint_interval_s(self) -> float:
        """Time between waypoints, seconds."""
    @property
    def times_s(self) -> NDArray[np.float64]:
        """Times of the dense path `[N]`, seconds."""
    @property
    def robot(self) -> NDArray[np.float32]:
        """Robot joint positions of the dense path `[N, columns]`."""
    @property
    def object(self) -> NDArray[np.float32]:
        """Object joint positions of the dense path `[N, columns]`."""
    @property
    def phase(self) -> NDArray[np.uint8]:
        """Phase of each dense sample `[N]`: 0 approach, 1 reach, 2 grasp, 3 manipulate, 4 regrasp,
        5 release."""
    @property
    def verdict(self) -> dict[str, Any] | None:
        """The judge's findings, or `None` where it was not judged."""
    def sample(self, time_s: float) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Robot and object positions at a time on the dense path, linear between samples."""

@final
class Task:
    """A task with everything it names loaded, repaired and checked."""

    @staticmethod
    def load(path: Path, assets: Sequence[Path]) -> Task:
        """Loads a task file."""
    @staticmethod
    def of_trajectories(path: Path, assets: Sequence[Path]) -> Task:
        """Loads the task that a trajectory file was planned for, from the same inputs."""
    @property
    def name(self) -> str:
        """The task's name."""
    @property
    def seed(self) -> int:
        """The task's seed."""
    @property
    def goals(self) -> list[float]:
        """Positions of the driven joint to reach, rad or m."""
    def robot(self) -> dict[str, Any]:
        """The robot: its tree, its planned joints and its gripper."""
    def object(self) -> dict[str, Any]:
        """The object: its tree, the driven joint and the handle."""
    def link_poses(
        self, robot: Mapping[str, float], object: Mapping[str, float]
    ) -> tuple[dict[str, NDArray[np.float64]], dict[str, NDArray[np.float64]]]:
        """World poses `x y z qw qx qy qz` of all links of the robot and of the object, by name, at
        joint positions (rad or m) by name; joints that are not named rest."""
    def scene(self) -> list[dict[str, Any]]:
        """The static surroundings: a list of bodies with their parts."""

@final
class Observer:
    """Renders single states of a task on the CPU."""

    def __init__(
        self,
        task: Task,
        rig: str,
        cloud: str,
        robot: Sequence[float],
        goal: float,
        link_from_handle: Sequence[float],
    ) -> None:
        """Mounts a rig (name, file or JSON) for a robot at `robot` while the driven joint moves to
        `goal`; `cloud` is the configuration of clouds, JSON."""
    def observe(self, robot: Sequence[float], object: Sequence[float]) -> dict[str, Any]:
        """What is seen: `cameras` by name and `cloud` `[N, 6]`."""
    def bodies(self) -> list[dict[str, Any]]:
        """What there is to draw: dictionaries like `akrobat.sapien_backend.Body`."""
    def lighting(self) -> dict[str, Any]:
        """The light: a dictionary like `akrobat.sapien_backend.Lighting`."""
    def place(self, robot: Sequence[float], object: Sequence[float]) -> dict[str, Any]:
        """Where everything is: `world_from_body` `[bodies, 7]` and `cameras` by name with their
        intrinsics and `world_from_camera` `[7]`."""

def physics_config(values: dict[str, Any]) -> dict[str, Any]:
    """The settings of a replay: the defaults with some values replaced."""

def plan(
    task: Path,
    output: Path | None,
    *,
    limit: int | None,
    seed: int | None,
    threads: int | None,
    backend: str,
    assets: Sequence[Path],
    quiet: bool,
) -> Trajectories:
    """Plans a task; see `akrobat.plan`."""

def render(
    trajectories: Path,
    output: Path,
    *,
    backend: str,
    rig: str,
    lighting: str,
    variation: str | None,
    variation_seed: int,
    appearance: Path | None,
    supersampling: int,
    detail: str,
    sensor: str,
    modalities: Sequence[str],
    cloud: str,
    seed: int,
    format: str,
    episodes: Sequence[int] | None,
    manipulation_only: bool,
    states: str,
    storage: str,
    resume: bool,
    threads: int | None,
    assets: Sequence[Path],
    quiet: bool,
) -> dict[str, Any]:
    """Renders a trajectory file; see `akrobat.render`."""

def project(rig: str, camera: str, points: NDArray[np.float64]) -> NDArray[np.float64]:
    """Pixel positions `[N, 2]` of camera-frame points `[N, 3]`."""

def unproject(rig: str, camera: str, pixels: NDArray[np.float64]) -> NDArray[np.float64]:
    """Rays `(x, y, 1)`, as `[N, 2]`, of pixel positions `[N, 2]`."""

def farthest_points(points: NDArray[np.float32], count: int) -> NDArray[np.uintp]:
    """Indices of farthest-point samples."""

def fuse(
    depth_m: NDArray[np.float32],
    intrinsics: NDArray[np.float64],
    world_from_camera: NDArray[np.float64],
    cloud: str,
) -> NDArray[np.float32]:
    """A cloud `[N, 3]` from the depth images of several cameras."""

def run(argv: Sequence[str]) -> int:
    """Runs the command line `argv` (the program's name first) and returns its exit code."""

def decode_color(file: bytes, width: int, height: int) -> bytes: ...
