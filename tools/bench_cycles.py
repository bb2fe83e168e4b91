"""Cycles of Blender 5.3 beside the engine's own picture of a scene, at one moment of the clip's camera.

python tools/bench_cycles.py SCENE.f4x [--frame N] [--samples 256] [--part 0.5] [--engine CYCLES] [--denoise] [--save DIR]

Prints one JSON object: PSNR in dB between display colors of the two pictures, and seconds. `--part` draws the middle part of the
picture alone, whose sides are so large: a large picture takes many minutes.
"""

import argparse
import sys
import time
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "scripts"))
import door

door.load_extension()

import bpy  # noqa: E402
import numpy as np  # noqa: E402
import OpenEXR  # noqa: E402
from feature4x.f4x_core.scene import read_scene  # noqa: E402
from feature4x.f4x_core.scene.color import srgb_from_linear  # noqa: E402
from feature4x.f4x_core.scene.linear import is_refitted  # noqa: E402
from feature4x.f4x_core.scene.view import render  # noqa: E402


def draw(samples: int, part: float, engine: str, denoise: bool) -> tuple[np.ndarray, float]:
    """Return (H,W,4) linear colors and alpha of the middle part of the current scene's picture, and the seconds it took."""
    scene, settings = bpy.context.scene, bpy.context.scene.render
    settings.engine, settings.film_transparent = engine, True
    if engine == "CYCLES":
        scene.cycles.samples, scene.cycles.use_adaptive_sampling, scene.cycles.use_denoising = samples, False, denoise
    else:
        scene.eevee.taa_render_samples = samples
    settings.use_border = settings.use_crop_to_border = part < 1
    left, low = (round(side * (1 - part) / 2) / side for side in (settings.resolution_x, settings.resolution_y))
    settings.border_min_x, settings.border_max_x = left, 1 - left  # whole pixels, or the parts lie half a pixel apart
    settings.border_min_y, settings.border_max_y = low, 1 - low
    scene.view_settings.view_transform = "Raw"
    settings.image_settings.file_format, settings.image_settings.color_depth = "OPEN_EXR", "32"
    settings.image_settings.color_mode = "RGBA"
    settings.filepath = bpy.app.tempdir + "picture.exr"
    begun = time.monotonic()
    bpy.ops.render.render(write_still=True)
    seconds = time.monotonic() - begun
    with OpenEXR.File(settings.filepath) as file:
        return np.array(file.channels()["RGBA"].pixels), seconds


def middle(picture: np.ndarray, shape: tuple[int, int]) -> np.ndarray:
    """Return the middle part of a picture, of `shape` rows and columns."""
    top, left = ((whole - part) // 2 for whole, part in zip(picture.shape, shape, strict=False))
    return picture[top : top + shape[0], left : left + shape[1]]


def decibels(one: np.ndarray, other: np.ndarray) -> float:
    """Return the PSNR of two pictures of display colors."""
    return float(-10 * np.log10(np.mean((one - other) ** 2)))


def main(arguments: list[str]) -> dict[str, Any]:
    """Import, draw, compare."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("scene", type=Path)
    parser.add_argument("--frame", type=int)
    parser.add_argument("--samples", type=int, default=256)
    parser.add_argument("--part", type=float, default=1.0)
    parser.add_argument("--engine", default="CYCLES")
    parser.add_argument("--denoise", action="store_true", help="with Blender's denoiser, which is on in a new file")
    parser.add_argument("--save", type=Path)
    args = parser.parse_args(arguments)
    scene = read_scene(args.scene)
    frame = len(scene.cameras) // 2 if args.frame is None else args.frame
    door.start_blender()
    door.import_scene(str(args.scene))
    bpy.context.scene.frame_set(frame)
    drawn, seconds = draw(args.samples, args.part, args.engine, args.denoise)
    own = render(scene, scene.cameras[frame], float(scene.cameras.times[frame]))["rgb"]
    shown = srgb_from_linear(drawn[..., :3]).clip(0, 1)
    own = middle(own, shown.shape[:2]).clip(0, 1)
    if args.save is not None:
        args.save.mkdir(parents=True, exist_ok=True)
        np.savez_compressed(args.save / f"{args.scene.stem}.npz", blender=shown, own=own)
    return {
        "scene": scene.name,
        "frame": frame,
        "Gaussians": len(scene.ids),
        "refitted": is_refitted(scene),
        "pixels": list(shown.shape[1::-1]),
        "engine": args.engine,
        "samples": args.samples,
        "denoised": args.denoise,
        "dB": decibels(shown, own),
        "seconds": seconds,
    }


if __name__ == "__main__":
    door.run(main)
