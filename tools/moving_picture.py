"""The README's moving picture and the tutorial's stills, from `f4x demo` and three renders of it.

python tools/moving_picture.py CLIP EDITED ORBIT BLENDER: folders of numbered pictures, one for each panel; fills docs/images.
"""

import sys
from pathlib import Path

from PIL import Image

IMAGES = Path(__file__).resolve().parents[1] / "docs" / "images"
MILLISECONDS = 83
"""A picture's time, as near to the clip's 24 a second as its every second frame allows."""
GAP, COLOURS, STILL = 4, 96, 15
"""Pixels between panels; colours of the GIF; frame of the stills."""


def side_by_side(panels: list[Image.Image]) -> Image.Image:
    """Return panels of one size in a row, with white between them."""
    width, height = panels[0].size
    row = Image.new("RGB", (len(panels) * (width + GAP) - GAP, height), "white")
    for index, panel in enumerate(panels):
        row.paste(panel, (index * (width + GAP), 0))
    return row


def main() -> None:
    """Write moving.gif and the two stills of the tutorial."""
    folders = [sorted(Path(name).glob("*.png")) for name in sys.argv[1:5]]
    frames = [[Image.open(file).convert("RGB") for file in files] for files in zip(*folders, strict=True)]
    clip, gold, _, blender = frames[STILL]
    side_by_side([clip, gold]).save(IMAGES / "tutorial_edit.jpg", quality=88)
    blender.resize((2 * blender.width, 2 * blender.height), Image.Resampling.LANCZOS).save(
        IMAGES / "tutorial_render.jpg", quality=85
    )
    shown = frames[::2]
    rows = [side_by_side([clip, orbit, gold, blender]) for clip, gold, orbit, blender in shown]
    rows = [row.quantize(COLOURS, dither=Image.Dither.FLOYDSTEINBERG) for row in rows]
    rows[0].save(IMAGES / "moving.gif", save_all=True, append_images=rows[1:], duration=MILLISECONDS, loop=0)


if __name__ == "__main__":
    main()
