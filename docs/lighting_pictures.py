"""Makes docs/images/lighting.png: one frame in the light of several presets.

akrobat plan configs/tasks/summit_microwave_kitchen.toml -o microwave.h5 --limit 2 --assets ASSETS
python docs/lighting_pictures.py microwave.h5 --assets ASSETS --presets even flat sun evening
"""

from __future__ import annotations

import argparse
import tempfile
from pathlib import Path

import akrobat
import numpy as np
from PIL import Image, ImageDraw

PRESETS = ["even", "flat", "sun", "ceiling", "studio", "evening"]
COLUMNS = 2


def picture(arguments: argparse.Namespace, preset: str) -> Image.Image:
    """The middle frame of the first trajectory, from the fixed camera."""
    with tempfile.TemporaryDirectory() as folder:
        dataset = akrobat.render(
            arguments.trajectories,
            Path(folder) / "dataset",
            backend="soft",
            lighting=preset,
            episodes=[0],
            manipulation_only=True,
            assets=arguments.assets,
            quiet=True,
        )
        frames = np.asarray(dataset.episodes[0]["camera_obs/fixed_rgb"])
    image = Image.fromarray(frames[len(frames) // 2])
    ImageDraw.Draw(image).text((6, 4), preset, fill="white", stroke_width=2, stroke_fill="black")
    return image


def main() -> None:
    """Renders and puts the pictures side by side."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawTextHelpFormatter
    )
    parser.add_argument("trajectories", type=Path, help="trajectory file")
    parser.add_argument("--assets", type=Path, action="append", default=[], help="asset folder")
    parser.add_argument("--presets", nargs="+", default=PRESETS, help="lightings to show")
    images = Path(__file__).parent / "images"
    parser.add_argument("--output", type=Path, default=images / "lighting.png")
    arguments = parser.parse_args()
    pictures = [picture(arguments, preset) for preset in arguments.presets]
    width, height = pictures[0].size
    rows = -(-len(pictures) // COLUMNS)
    sheet = Image.new("RGB", (COLUMNS * width, rows * height))
    for place, image in enumerate(pictures):
        sheet.paste(image, (place % COLUMNS * width, place // COLUMNS * height))
    sheet.save(arguments.output)


if __name__ == "__main__":
    main()
