"""Datasets of whole-body mobile manipulation: plan trajectories, render them, read the results."""

from importlib.metadata import version

from akrobat.errors import AkrobatError, InputError, RunError

__version__ = version("akrobat")
__all__ = ["AkrobatError", "InputError", "RunError", "__version__"]
