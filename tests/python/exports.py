"""Exporting with the command line, and what a native episode holds."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path
from typing import Any

import akrobat
import numpy as np
from numpy.typing import NDArray


def run(*arguments: object) -> subprocess.CompletedProcess[str]:
    """Runs `akrobat` with these arguments."""
    command = [sys.executable, "-m", "akrobat", *map(str, arguments)]
    return subprocess.run(command, check=False, capture_output=True, text=True)


def export(dataset: Path, format: str, output: Path, *options: object) -> Path:
    """Exports a dataset, whatever its licences, and returns the folder."""
    allowed = ("--quiet", "--allow-non-commercial")
    result = run("export", dataset, "--to", format, "-o", output, *allowed, *options)
    assert result.returncode == 0, result.stderr
    assert result.stderr == ""
    return output


def refused(*arguments: object) -> str:
    """Runs `akrobat`, which must refuse the input, and returns what it says."""
    result = run(*arguments, "--json")
    assert result.returncode == 2, (result.returncode, result.stdout, result.stderr)
    return str(json.loads(result.stdout)["error"])


def cameras_of(episode: akrobat.Episode) -> list[str]:
    """Names of the cameras."""
    return [str(name) for name in episode.attributes["cameras"]]


def depth_mm(episode: akrobat.Episode, camera: str) -> NDArray[Any]:
    """`[T, H, W]`, 0 where invalid."""
    depth = episode[f"camera_obs/{camera}_depth"][..., 0]
    assert depth.dtype == np.uint16
    return depth


def tool_poses(episode: akrobat.Episode) -> NDArray[Any]:
    """`[T, 7]`, `x y z qw qx qy qz` in the world."""
    return np.concatenate([episode["obs/eef_pos"], episode["obs/eef_quat"]], axis=1)
