"""Reading USD stages, for `akrobat import usd`. Needs `usd-core`."""

from __future__ import annotations

from pathlib import Path

from akrobat.errors import InputError

__all__ = ["to_urdf"]


def to_urdf(source: str, folder: str) -> tuple[str, list[str], list[str]]:
    """Writes a stage as `scene.urdf` with `meshes/` into `folder`.

    Lengths are metres and z is up, whatever the stage says. Rigid bodies of the physics schema and
    their joints become links and joints; everything else is fixed to the root link `world`, a link
    for each component or shape. Returns the URDF's path, what was repaired, and what could not be
    taken over.
    """
    try:
        from pxr import Tf, Usd
    except ImportError as error:
        raise InputError(
            "reading USD needs usd-core, which is not installed; install it with "
            "`pip install 'akrobat[usd]'`"
        ) from error
    from akrobat.usd.stage import Converter

    try:
        stage = Usd.Stage.Open(source)
    except Tf.ErrorException as error:
        raise InputError(f"{source}: cannot be read as USD: {error}") from error
    return Converter(stage, Path(folder)).convert()
