"""Writers of export formats that need a Python library.

The compiled half of the package reads the dataset, expresses actions and states as asked for, and
calls a :class:`Writer`: for each episode `begin`, `frames` until all are through, `end`; at last
`finish`.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Protocol

from numpy.typing import NDArray

from akrobat.errors import InputError

Arrays = Mapping[str, NDArray[Any]]

INSTALL = "install what it needs with: pip install 'akrobat[export]'"


class Writer(Protocol):
    """Writes one format into a folder."""

    def begin(self, index: int, attributes: str, arrays: Arrays) -> None:
        """Starts episode `index`.

        :param attributes: JSON of what is known of it
        :param arrays: tables with a row for each frame: `action`, `state`, `time`, `eef_pose`,
            `<camera>/intrinsics`, `<camera>/world_from_camera`, ...
        """

    def frames(self, first: int, arrays: Arrays) -> None:
        """Takes frames from `first` on: `<camera>/rgb` `[n, H, W, 3]` u8, `<camera>/depth_mm`
        `[n, H, W]` u16 (0 is invalid), `point_cloud` `[n, N, 6]` f32.
        """

    def end(self) -> None:
        """Completes the episode."""

    def finish(self) -> None:
        """Completes the output."""


def open_writer(format: str, folder: Path, header: str) -> Writer:
    """The writer of a format into an empty folder.

    :param format: as `akrobat export --to` names it
    :param header: JSON of what all episodes share
    """
    described: dict[str, Any] = json.loads(header)
    try:
        if format in ("dp3", "diffusion-policy"):
            from akrobat.exporters.zarr_replay import ReplayBufferWriter

            return ReplayBufferWriter(Path(folder), described, images=format != "dp3")
        if format == "lerobot":
            from akrobat.exporters.lerobot import LeRobotWriter

            return LeRobotWriter(Path(folder), described)
        if format == "mcap":
            from akrobat.exporters.foxglove import FoxgloveWriter

            return FoxgloveWriter(Path(folder), described)
    except ImportError as error:
        raise InputError(f"the format {format} cannot be written ({error}); {INSTALL}") from error
    raise InputError(f"unknown format {format!r}")
