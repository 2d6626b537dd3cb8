"""The exceptions of this package. Ctrl-C raises `KeyboardInterrupt`, as everywhere in Python."""

from akrobat._core import AkrobatError, InputError, RunError

__all__ = ["AkrobatError", "InputError", "RunError"]
