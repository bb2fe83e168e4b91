"""Render a clip with known truth: images, depth, flow, masks, world positions and cameras.

python scripts/synthetic_clip.py OUT --scene procedural --frames 24 --size 240x136 --samples 16
blender -b --factory-startup --python-exit-code 1 -P scripts/synthetic_clip.py -- OUT --scene fox --extra-cameras
"""

import argparse
import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parent))  # `blender -P` does not add the script's own folder
import door


def parse(arguments: list[str]) -> argparse.Namespace:
    """Read the command line."""
    parser = argparse.ArgumentParser(prog="synthetic_clip.py", description=__doc__.splitlines()[0])
    parser.add_argument("out", type=Path, help="folder to write; made when absent")
    parser.add_argument("--scene", choices=("procedural", "knight", "fox"), default="procedural")
    parser.add_argument("--frames", type=int, default=24)
    parser.add_argument("--size", default="240x136", help="WIDTHxHEIGHT in pixels")
    parser.add_argument("--samples", type=int, default=16, help="Cycles samples per pixel")
    parser.add_argument("--seed", type=int, default=0, help="camera jitter, textures and furniture")
    parser.add_argument("--assets", type=Path, default=door.ROOT.parent / "shared" / "assets")
    parser.add_argument("--extra-cameras", action="store_true", help="also 10 degrees left and right, every 4th frame")
    return parser.parse_args(arguments)


def main(arguments: list[str]) -> None:
    """Render one clip."""
    options = parse(arguments)
    from feature4x.addon import synthetic
    from feature4x.f4x_core.errors import F4xError

    width, _, height = options.size.partition("x")
    if not (width.isdigit() and height.isdigit()):
        raise F4xError(f"--size {options.size} is not WIDTHxHEIGHT; give for example --size 240x136.")
    settings = synthetic.ClipSettings(
        scene=options.scene,
        frames=options.frames,
        width=int(width),
        height=int(height),
        samples=options.samples,
        seed=options.seed,
        assets=options.assets,
        extra_cameras=options.extra_cameras,
    )
    synthetic.write_clip(options.out, settings)


door.run(main)
