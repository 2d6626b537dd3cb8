"""Datasets of whole-body mobile manipulation: plan trajectories, render them, read the results."""

from importlib.metadata import version

from akrobat._core import Task, Trajectories, Trajectory
from akrobat.api import open, plan, render
from akrobat.cameras import farthest_points, fuse, project, unproject
from akrobat.dataset import Dataset, Episode
from akrobat.errors import AkrobatError, InputError, RunError

__version__ = version("akrobat")
__all__ = [
    "AkrobatError",
    "Dataset",
    "Episode",
    "InputError",
    "RunError",
    "Task",
    "Trajectories",
    "Trajectory",
    "__version__",
    "farthest_points",
    "fuse",
    "open",
    "plan",
    "project",
    "render",
    "unproject",
]
