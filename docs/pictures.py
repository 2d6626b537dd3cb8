"""Pictures of every modality and every sensor, for the documentation.

    .venv/bin/pip install matplotlib
    .venv/bin/python docs/pictures.py --assets ASSETS

Plans a trajectory (or takes one with --trajectories), renders a frame of it with each sensor and
writes docs/images/modalities.png and docs/images/sensors.png.
"""

from __future__ import annotations

import argparse
import tempfile
from pathlib import Path
from typing import Any

import akrobat
import matplotlib as mpl
import numpy as np
from numpy.typing import NDArray

mpl.use("Agg")
from matplotlib import colormaps
from matplotlib import pyplot as plt
from matplotlib.colors import hsv_to_rgb

REPOSITORY = Path(__file__).parents[1]
TASK = REPOSITORY / "configs" / "tasks" / "summit_drawer_kitchen.toml"
MODALITIES = [
    "rgb",
    "depth",
    "segmentation",
    "instance",
    "semantic",
    "normals",
    "xyz",
    "flow",
    "scene_flow",
]
SENSORS = ["ideal", "kinect", "redwood", "stereo", "color"]
CAMERA = "fixed"
# One camera: on a wrist, a Kinect is too close to see, and such episodes are left out.
RIG = f"""
name = "pictures"
[[cameras]]
name = "{CAMERA}"
focal_mm = 50.0
[cameras.mount]
on = "look_at_handle"
offset = [1.6, 0.8, 0.9]
"""

Picture = NDArray[Any]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--assets", type=Path, action="append", default=[])
    parser.add_argument("--trajectories", type=Path, help="instead of planning one")
    parser.add_argument("--output", type=Path, default=REPOSITORY / "docs" / "images")
    arguments = parser.parse_args()
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        source = arguments.trajectories
        if source is None:
            source = folder / "trajectories.h5"
            akrobat.plan(TASK, source, limit=1, assets=arguments.assets, quiet=True)
        images = {s: render(source, folder / s, s, arguments.assets) for s in SENSORS}
    draw_modalities(images["ideal"], arguments.output / "modalities.png")
    draw_sensors(images, arguments.output / "sensors.png")


def render(source: Path, folder: Path, sensor: str, assets: list[Path]) -> dict[str, Picture]:
    """One camera's images in the middle of the manipulation."""
    rig = folder.with_suffix(".toml")
    rig.write_text(RIG)
    dataset = akrobat.render(
        source,
        folder,
        backend="soft",
        rig=rig,
        sensor=sensor,
        modalities=MODALITIES,
        cloud={"points": 0},
        episodes=[0],
        manipulation_only=True,
        assets=assets,
        quiet=True,
    )
    frame = dataset[len(dataset) // 2]
    return {m: np.squeeze(frame[f"camera_obs/{CAMERA}_{m}"]) for m in MODALITIES}


def depth_colors(depth_mm: Picture, span: tuple[float, float]) -> Picture:
    scaled = (depth_mm - span[0]) / (span[1] - span[0])
    colors = colormaps["turbo"](np.clip(scaled, 0, 1))[..., :3]
    return np.where(depth_mm[..., None] > 0, colors, 0.0)


def id_colors(ids: Picture) -> Picture:
    palette = colormaps["tab20"](np.arange(65536) * 7 % 20)[:, :3]
    return np.where(ids[..., None] > 0, palette[ids], 0.0)


def flow_colors(flow: Picture) -> Picture:
    """Direction as hue, length as saturation."""
    length = np.linalg.norm(flow, axis=-1)
    hue = (np.arctan2(flow[..., 1], flow[..., 0]) / (2 * np.pi)) % 1.0
    saturation = np.clip(length / max(np.percentile(length, 99.5), 1e-9), 0, 1)
    return hsv_to_rgb(np.stack([hue, saturation, np.ones_like(hue)], axis=-1))


def fractions(values: Picture, seen: Picture) -> Picture:
    """Each channel from 0 to 1 over what is seen."""
    low, high = np.percentile(values[seen], [1, 99], axis=0)
    scaled = np.clip((values - low) / np.maximum(high - low, 1e-9), 0, 1)
    return np.where(seen[..., None], scaled, 0.0)


def draw_modalities(images: dict[str, Picture], file: Path) -> None:
    depth = images["depth"].astype(float)
    seen = depth > 0
    span = (depth[seen].min(), np.percentile(depth[seen], 98))
    pictures = {
        "rgb": images["rgb"],
        "depth": depth_colors(depth, span),
        "segmentation": id_colors(images["segmentation"]),
        "instance": id_colors(images["instance"]),
        "semantic": id_colors(images["semantic"]),
        "normals": np.where(seen[..., None], 0.5 + 0.5 * images["normals"], 0.0),
        "xyz": fractions(images["xyz"], seen),
        "flow": flow_colors(images["flow"]),
        "scene_flow": flow_colors(images["scene_flow"][..., [0, 2]]),
    }
    save(pictures, 3, file)


def draw_sensors(images: dict[str, dict[str, Picture]], file: Path) -> None:
    ideal = images["ideal"]["depth"].astype(float)
    span = (ideal[ideal > 0].min(), np.percentile(ideal[ideal > 0], 98))
    pictures = {}
    for sensor in SENSORS[:-1]:
        depth = images[sensor]["depth"].astype(float)
        pictures[f"{sensor}: depth"] = depth_colors(depth, span)
    for sensor in SENSORS[1:-1]:
        depth = images[sensor]["depth"].astype(float)
        error = np.clip(0.5 + (depth - ideal) / 40.0, 0, 1)
        colors = colormaps["coolwarm"](error)[..., :3]
        valid = ((depth > 0) & (ideal > 0))[..., None]
        pictures[f"{sensor}: error, -20 to 20 mm"] = np.where(valid, colors, 0.0)
    pictures["color: rgb"] = images["color"]["rgb"]
    save(pictures, 4, file)


def save(pictures: dict[str, Picture], columns: int, file: Path) -> None:
    rows = -(-len(pictures) // columns)
    figure, axes = plt.subplots(rows, columns, figsize=(3.2 * columns, 2.6 * rows), dpi=100)
    for axis in axes.flat:
        axis.axis("off")
    for axis, (name, picture) in zip(axes.flat, pictures.items(), strict=False):
        axis.imshow(picture, interpolation="nearest")
        axis.set_title(name, fontsize=9)
    figure.tight_layout(pad=0.4)
    file.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(file)
    print(file)


if __name__ == "__main__":
    main()
