"""Uses of splats in Cycles of Blender 5.3: the pictures of docs/cycles.md, one sheet for each use.

python tools/cycles_pictures.py SCENE.f4x -o OUT [--frame T] [--only NAME ...]

Each picture is rendered with few samples and Blender's denoiser. OUT/NAME.jpg …
"""

import argparse
import math
import sys
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

sys.path.extend(str(Path(__file__).resolve().parents[1] / name) for name in ("tools", "scripts"))
import cycles_stage
import door
import numpy as np

SAMPLES, DENOISED = 12, True
"""Of each picture: as many as a minute on two cores allows."""
WIDE, GAP, QUALITY = 384, 4, 80
"""Pixels across a picture of a sheet, between two, quality of its JPEG."""
APERTURE = 0.05
"""Width of the lens in the picture with depth of field, in distances of what is in focus."""
SUNSHINE = (0.55, -0.3, -0.8)
"""Direction of the sun that shades splats: from behind, so that shadows fall to the front."""
TITLE, BAND = 11, 16
"""Pixels of a title's letters, and of the band above a picture that it stands in."""


@dataclass
class Sheet:
    """Pictures of one use, side by side, each with a title."""

    scene: Path
    frame: int
    pictures: list[tuple[str, np.ndarray]] = field(default_factory=list)

    def stage(self) -> cycles_stage.Stage:
        """Return the scene in an empty file, at the sheet's frame."""
        return cycles_stage.Stage.of(self.scene, self.frame)

    def add(self, title: str, transparent: bool = False) -> None:
        """Render what is in the file now."""
        start = time.perf_counter()
        self.pictures.append((title, cycles_stage.render(SAMPLES, DENOISED, transparent)))
        print(f"{title}: {time.perf_counter() - start:.0f} s", flush=True)


def balls(sheet: Sheet) -> None:
    """Draw a metal and a glass ball among the splats."""
    stage = sheet.stage()
    sheet.add("the scene in Cycles")
    stage.ball("metal", -1, cycles_stage.metal())
    stage.ball("glass", 1, cycles_stage.glass())
    # The clip never saw what is behind the camera: without a world the metal would be black there.
    stage.world((0.3, 0.3, 0.3), 1.0)
    sheet.add("a metal and a glass ball in it")


def shadows(sheet: Sheet) -> None:
    """Draw shadows of a mesh on splats and of splats on a mesh."""
    stage = sheet.stage()
    stage.ball("ball", -1, cycles_stage.matte((0.8, 0.1, 0.05)))
    sun = stage.sun(SUNSHINE)
    sheet.add("no material: no shadow")
    for cloud in stage.clouds:
        cycles_stage.take_shadows(cloud, sun)
    sheet.add("material with Raycast")
    stage = sheet.stage()
    stage.sun((0.3, -0.25, -1.0))
    stage.slab()
    sheet.add("shadow of splats on a mesh")


def blurs(sheet: Sheet) -> None:
    """Draw depth of field and motion blur."""
    import bpy

    stage = sheet.stage()
    camera = stage.camera.data
    camera.dof.use_dof, camera.dof.focus_distance = True, stage.distance
    camera.dof.aperture_fstop = camera.lens * 1e-3 / (APERTURE * stage.distance)
    sheet.add("depth of field")
    stage = sheet.stage()
    sheet.add("no motion blur")
    bpy.context.scene.render.use_motion_blur, bpy.context.scene.render.motion_blur_shutter = True, 2.0
    sheet.add("motion blur, shutter 2")


def holdouts(sheet: Sheet) -> None:
    """Draw with alpha: dynamic splats as holdout, a ball as holdout, and the ball's shadow alone."""
    import bpy

    stage = sheet.stage()
    for cloud in stage.moving:
        cloud.is_holdout = True
    sheet.add("holdout of the splats that move", transparent=True)
    stage = sheet.stage()
    ball = stage.ball("ball", -1, cycles_stage.matte((0.8, 0.1, 0.05)))
    ball.is_holdout = True
    sheet.add("holdout of a mesh", transparent=True)
    ball.is_holdout = False
    stage.sun(SUNSHINE)
    for cloud in stage.clouds:
        cycles_stage.catch_shadows(cloud)
    bpy.context.scene.cycles.max_bounces = 0
    sheet.add("splats as shadow catcher", transparent=True)


def copies(sheet: Sheet) -> None:
    """Draw a collection instance, an array by geometry nodes, a second scene of another start."""
    stage = sheet.stage()
    stage.instance(stage.model(1))
    sheet.add("collection instance, smaller")
    stage = sheet.stage()
    stage.array(3, 0.45 * stage.size)
    sheet.add("array of what moves")
    stage = sheet.stage()
    stage.second(sheet.scene, stage.model(1), later=12)
    sheet.add("second import, 12 frames later")


def world(sheet: Sheet) -> None:
    """Draw the light of the world on meshes beside splats."""
    stage = sheet.stage()
    stage.ball("white", -1, cycles_stage.matte((0.8, 0.8, 0.8)))
    stage.ball("metal", 1, cycles_stage.metal())
    sheet.add("black world")
    stage.world((0.25, 0.5, 1.0), 1.0)
    sheet.add("blue world")
    for cloud in stage.clouds:
        cloud.visible_shadow = cloud.visible_diffuse = False
    sheet.add("splats that block no light")


SHEETS: tuple[Callable[[Sheet], None], ...] = (balls, shadows, blurs, holdouts, copies, world)


def save(sheet: Sheet, path: Path) -> None:
    """Write a sheet; transparent pictures lie over a checkerboard."""
    from PIL import Image, ImageDraw, ImageFont

    tall = round(WIDE * sheet.pictures[0][1].shape[0] / sheet.pictures[0][1].shape[1])
    rows = math.ceil(len(sheet.pictures) / 2) if len(sheet.pictures) != 3 else 1
    columns = math.ceil(len(sheet.pictures) / rows)
    width = WIDE if columns < 3 else 2 * WIDE // 3
    tall = tall * width // WIDE
    whole = Image.new("RGB", (columns * (width + GAP) - GAP, rows * (tall + BAND + GAP) - GAP), "white")
    draw = ImageDraw.Draw(whole)
    for number, (title, picture) in enumerate(sheet.pictures):
        left, top = number % columns * (width + GAP), number // columns * (tall + BAND + GAP)
        shown = Image.fromarray(cycles_stage.over_checkers(picture)).resize((width, tall), Image.Resampling.LANCZOS)
        whole.paste(shown, (left, top + BAND))
        draw.text((left + 1, top), title, "black", ImageFont.load_default(TITLE))
    whole.save(path, quality=QUALITY, optimize=True)


def main(arguments: list[str]) -> dict[str, Any]:
    """Render the sheets that are wanted."""
    names = [sheet.__name__ for sheet in SHEETS]
    parser = argparse.ArgumentParser(prog="cycles_pictures.py", description=__doc__.splitlines()[0])
    parser.add_argument("scene", type=Path, help="name.f4x, refitted by `f4x refit`")
    parser.add_argument("-o", "--output", type=Path, required=True, metavar="DIR", help="folder of the sheets")
    parser.add_argument("--frame", type=int, default=15, help="of the clip (default: 15)")
    parser.add_argument("--only", nargs="+", choices=names, default=names, help="these sheets (default: all)")
    options = parser.parse_args(arguments)
    cycles_stage.check_splats()
    options.output.mkdir(parents=True, exist_ok=True)
    seconds = {}
    for make in SHEETS:
        if make.__name__ in options.only:
            start = time.perf_counter()
            sheet = Sheet(options.scene, options.frame)
            make(sheet)
            save(sheet, options.output / f"cycles_{make.__name__}.jpg")
            seconds[make.__name__] = round(time.perf_counter() - start, 1)
    return {"output": str(options.output), "seconds": seconds}


if __name__ == "__main__":
    door.run(main)
