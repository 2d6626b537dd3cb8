"""The compiled half of the package."""

from collections.abc import Sequence

class AkrobatError(Exception):
    """Any failure of an Akrobat function."""

class InputError(AkrobatError):
    """A file or an argument is wrong."""

class RunError(AkrobatError):
    """The machine failed: full disk, lost device."""

def run(argv: Sequence[str]) -> int:
    """Runs the command line `argv` (the program's name first) and returns its exit code."""
