"""Draws the pictures of docs/scenes.md: every class of objects, grasps, and imported scenes.

    .venv/bin/python docs/scene_pictures.py --scenes FOLDER

FOLDER holds folders that `akrobat import` has written.
"""

from __future__ import annotations

import argparse
import subprocess
import sys
import tempfile
from pathlib import Path

from PIL import Image, ImageDraw

IMAGES = Path(__file__).parent / "images"
CLASSES = [
    *("microwave", "oven", "dishwasher", "refrigerator", "wall-cabinet", "base-cabinet"),
    *("drawer-unit", "trash-can", "door", "chair", "box", "mug", "bowl"),
]
#: Objects whose grasps are shown.
HELD = ["microwave", "refrigerator", "drawer-unit", "mug"]
TILE = (320, 240)


def akrobat(*arguments: object) -> None:
    """Runs the command."""
    subprocess.run([sys.executable, "-m", "akrobat", "-q", *map(str, arguments)], check=True)


def labelled(picture: Image.Image, name: str) -> Image.Image:
    """A tile with its name in a corner."""
    tile = picture.convert("RGB").resize(TILE)
    ImageDraw.Draw(tile).text((8, 6), name, fill=(20, 20, 24))
    return tile


def sheet(tiles: list[Image.Image], columns: int, path: Path) -> None:
    """Tiles side by side."""
    rows = -(-len(tiles) // columns)
    whole = Image.new("RGB", (TILE[0] * columns, TILE[1] * rows), (255, 255, 255))
    for index, tile in enumerate(tiles):
        whole.paste(tile, (TILE[0] * (index % columns), TILE[1] * (index // columns)))
    whole.save(path, optimize=True)


def panels(path: Path) -> list[Image.Image]:
    """The pictures of `object.png`: closed, opened where it opens, with grasps."""
    whole = Image.open(path)
    starts = range(0, whole.width, TILE[0])
    return [whole.crop((x, 0, x + TILE[0], TILE[1])) for x in starts]


def draw_objects(folder: Path) -> None:
    """`object_classes.png` and `grasps.png`."""
    shown, held = [], []
    for name in CLASSES:
        output = folder / name
        akrobat("generate", "object", name, "--seed", 2, "--picture", "-o", output)
        pictures = panels(output / "object.png")
        # Opened where it opens.
        shown.append(labelled(pictures[-2], name))
        if name in HELD:
            held.append(labelled(pictures[-1], name))
    sheet(shown, 5, IMAGES / "object_classes.png")
    sheet(held, 2, IMAGES / "grasps.png")


def draw_scenes(folder: Path, scenes: Path) -> None:
    """`imported_scenes.png`: a variant of each imported scene, twice."""
    imported = sorted(path.parent for path in scenes.glob("*/scene.json"))
    output = folder / "variants"
    count = 2 * len(imported)
    akrobat("generate", "variants", *imported, "--count", count, "--pictures", "-o", output)
    whole = Image.open(output / "contact_sheet.png").convert("RGB")
    whole.save(IMAGES / "imported_scenes.png", optimize=True)


def main() -> None:
    """Draws all of them."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--scenes", type=Path, help="folder of imported scenes")
    arguments = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        draw_objects(Path(folder))
        if arguments.scenes:
            draw_scenes(Path(folder), arguments.scenes)


if __name__ == "__main__":
    main()
