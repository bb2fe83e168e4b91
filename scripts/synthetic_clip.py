"""Render clips with known truth: images, depth, flow, masks, world positions and cameras.

python scripts/synthetic_clip.py OUT --scene all --extra-cameras
python scripts/synthetic_clip.py OUT --scene procedural --frames 24 --size 240x136 --samples 12
blender -b --factory-startup --python-exit-code 1 -P scripts/synthetic_clip.py -- OUT --scene fox,walk --extra-cameras

One scene by name is written to OUT unless it is `all`; several are written to OUT/NAME, those that are there already are
skipped. The last line of output is JSON: what was rendered, and the seconds it took.
"""

import argparse
import shutil
import sys
import time
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).resolve().parent))  # `blender -P` does not add the script's own folder
import door

RENDERED = ("images", "truth", "images_*", "truth_*", "joints.npy", "truth.json")
"""Files and folders in the folder of a clip."""
DEGREES = "5,10,20"
"""Angles of `--extra-cameras` without a value."""


def parse(arguments: list[str]) -> argparse.Namespace:
    """Read the command line."""
    parser = argparse.ArgumentParser(prog="synthetic_clip.py", description=__doc__.splitlines()[0])
    parser.add_argument("out", type=Path, help="folder to write; made when absent")
    parser.add_argument(
        "--scene", default="procedural", metavar="NAME[,NAME]|all", help="which scenes (default: procedural)"
    )
    parser.add_argument("--frames", type=int, default=0, help="clip frames (default: as the scene wants)")
    parser.add_argument("--size", metavar="WIDTHxHEIGHT", help="pixels (default: as the scene wants)")
    parser.add_argument("--samples", type=int, default=12, help="Cycles samples per pixel")
    parser.add_argument(
        "--lens", type=float, default=32.0, help="focal length in mm, before 36 mm of sensor (default: 32)"
    )
    parser.add_argument("--seed", type=int, default=0, help="camera jitter, textures and furniture")
    parser.add_argument("--assets", type=Path, default=door.ROOT.parent / "shared" / "assets")
    parser.add_argument(
        "--extra-cameras",
        nargs="?",
        const=DEGREES,
        default="",
        metavar="DEGREES",
        help=f"also some moments from so many degrees off the path, in each scene's directions ({DEGREES})",
    )
    return parser.parse_args(arguments)


def main(arguments: list[str]) -> dict[str, Any]:
    """Render the clips."""
    options = parse(arguments)
    from feature4x.f4x_core.clip.rendered_scenes import ALL, scenes_named
    from feature4x.f4x_core.errors import F4xError
    from feature4x.ground_truth import clip

    width, _, height = (options.size or "0x0").partition("x")
    if not (width.isdigit() and height.isdigit()):
        raise F4xError(f"--size {options.size} is not WIDTHxHEIGHT; give for example --size 240x136.")
    try:
        degrees = tuple(float(part) for part in options.extra_cameras.split(",") if part)
    except ValueError as error:
        raise F4xError(f"--extra-cameras {options.extra_cameras}: give degrees, for example {DEGREES}.") from error
    names = options.scene.split(",")
    several = ALL in names or len(names) > 1
    rendered = {}
    for scene in scenes_named(names):
        settings = clip.ClipSettings(
            scene=scene,
            frames=options.frames,
            width=int(width) if options.size else scene.size[0],
            height=int(height) if options.size else scene.size[1],
            samples=options.samples,
            seed=options.seed,
            lens=options.lens,
            assets=options.assets,
            extra_degrees=degrees,
        )
        folder = options.out / scene.name if several else options.out
        if several and (folder / "truth.json").is_file():
            continue
        start = time.perf_counter()
        clear(folder)
        clip.write_clip(folder, settings)
        rendered[scene.name] = round(time.perf_counter() - start, 1)
    return {"output": str(options.out), "seconds": rendered}


def clear(folder: Path) -> None:
    """Remove the files of an earlier or interrupted render, and nothing else."""
    for pattern in RENDERED:
        for path in folder.glob(pattern):
            if path.is_dir():
                shutil.rmtree(path)
            else:
                path.unlink()


door.run(main)
