"""Depth as 12-bit codes, which LeRobot's depth videos hold.

LeRobot maps depth d (metres) to `4095 * (ln(d + s) - ln(near + s)) / (ln(far + s) - ln(near + s))`,
rounded. The codes are coded without loss, so the error is half a code: `(d + s) * 1.65e-4` metres
with the defaults, 0.7 mm at 1 m. Code 0 means 10 mm, not invalid: validity is stored beside the
video.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import av
import numpy as np
from numpy.typing import NDArray

LARGEST_CODE = 4095


@dataclass(frozen=True)
class DepthCodes:
    """The mapping, with LeRobot's defaults."""

    near_m: float = 0.01
    far_m: float = 10.0
    shift_m: float = 3.5
    pixel_format: str = "gray12le"

    def is_valid(self, millimetres: NDArray[np.uint16]) -> NDArray[np.bool_]:
        """Whether depth is there and a code can hold it."""
        return (millimetres >= self.near_m * 1000) & (millimetres <= self.far_m * 1000)

    def _log_range(self) -> tuple[float, float]:
        return math.log(self.near_m + self.shift_m), math.log(self.far_m + self.shift_m)

    def encode(self, millimetres: NDArray[np.uint16]) -> NDArray[np.uint16]:
        """Codes of depths; 0 where invalid."""
        low, high = self._log_range()
        metres = millimetres.astype(np.float64) / 1000
        codes = np.rint((np.log(metres + self.shift_m) - low) / (high - low) * LARGEST_CODE)
        codes = codes.clip(0, LARGEST_CODE).astype(np.uint16)
        return np.where(self.is_valid(millimetres), codes, 0).astype(np.uint16)

    def decode(self, codes: NDArray[np.uint16]) -> NDArray[np.float64]:
        """Depths in metres of codes."""
        low, high = self._log_range()
        return np.exp(low + codes.astype(np.float64) * (high - low) / LARGEST_CODE) - self.shift_m

    def error_m(self, depth_m: NDArray[Any] | float) -> Any:
        """Largest error at a depth, metres."""
        low, high = self._log_range()
        return (np.asarray(depth_m) + self.shift_m) * math.expm1((high - low) / LARGEST_CODE / 2)

    def video_frame(self, codes: NDArray[np.uint16]) -> Any:
        """A frame of the codec's pixel format."""
        height, width = codes.shape
        frame = av.VideoFrame(width, height, self.pixel_format)
        plane = frame.planes[0]
        padded = np.zeros((height, plane.line_size // 2), "<u2")
        padded[:, :width] = codes
        plane.update(padded.tobytes())
        return frame

    def codec_options(self) -> dict[str, str]:
        """Options of libx265: without loss, on one thread, silent."""
        parameters = "lossless=1:log-level=error:pools=none:frame-threads=1"
        return {"preset": "ultrafast", "x265-params": parameters}

    def video_info(self) -> dict[str, Any]:
        """What LeRobot reads to decode."""
        return {
            "depth_unit": "mm",
            "video.depth_min": self.near_m,
            "video.depth_max": self.far_m,
            "video.shift": self.shift_m,
            "video.use_log": True,
        }
