"""The viewport's picture on the graphics card against the engine's own: differences per pixel, processor time per redraw.

blender -b --factory-startup --python-exit-code 1 -P tools/check_gpu.py -- [--count N] [--seconds-only]

Blender 5.2 or newer, which draws without a window; with `--gpu-backend vulkan` on that. Stages are random: Gaussians of every
degree of harmonics, turned by motion, sheared, of several clouds; surfaces and a holdout between them; a view without
perspective. The last line is JSON.
"""

import argparse
import sys
from dataclasses import replace
from pathlib import Path

import bpy
import numpy as np

sys.path.extend(str(Path(__file__).resolve().parents[1] / name) for name in ("tools", "scripts"))
import door

WIDTH, HEIGHT, BACK = 640, 360, 2000.0
REDRAWS = 9
"""Redraws of each kind that are timed; the median counts."""
TRIANGLES = np.array([[[-2, -1, 4], [2, -1, 4.5], [0, 1.5, 3.5]], [[0, 0, 2], [0.5, 0, 2], [0, 0.5, 6]]])
SHEARED = np.array([[0.9, 0.13, 0, 0.3], [0, 1.3, 0.26, 0], [0, 0, 0.8, 0], [0, 0, 0, 1.0]])


def main(words: list[str]) -> dict:
    """Compare and measure."""
    parser = argparse.ArgumentParser(prog="check_gpu.py", description=__doc__.splitlines()[0])
    parser.add_argument("--count", type=int, default=4000, help="Gaussians of the largest cloud")
    parser.add_argument("--seconds-only", action="store_true", help="measure, but compare nothing")
    options = parser.parse_args(words)
    import gpu
    from feature4x.addon.render import viewport_gpu
    from feature4x.f4x_core.errors import F4xError

    if bpy.app.background:
        if not hasattr(gpu, "init"):
            raise F4xError(f"Blender {bpy.app.version_string} draws in a window only; take 5.2 or newer")
        gpu.init()
    clouds = make_clouds(options.count)
    found = {"renderer": gpu.platform.renderer_get(), "backend": gpu.platform.backend_type_get()}
    if not options.seconds_only:
        found["pictures"] = {name: compare(*case) for name, case in cases(clouds).items()}
    found["milliseconds"] = {kind: measure(clouds, kind) for kind in ("still", "turning", "playing")}
    found["refused"] = refused(viewport_gpu)
    return found


def make_clouds(count: int) -> list:
    """Return random clouds of degree 0 to 4, of `count` Gaussians and fewer."""
    from feature4x.f4x_core.scene.stage import Cloud

    rng = np.random.default_rng(1)

    def cloud(n: int, terms: int, **more) -> Cloud:
        parts = {
            "means": rng.normal(size=(n, 3)) * [1.5, 1, 0.8] + [0, 0, 4],
            "quats": rng.normal(size=(n, 4)),
            "scales": np.exp(rng.normal(-3.5, 0.8, (n, 3))),
            "opacities": rng.uniform(0, 1, n),
            "sh": rng.normal(size=(n, terms, 3)) * 0.35 / terms**0.5,
        }
        return Cloud(**{name: values.astype(np.float32) for name, values in parts.items()}, **more)

    turn = rng.normal(size=(count // 2, 4))
    turn = (turn / np.linalg.norm(turn, axis=1, keepdims=True)).astype(np.float32)
    return [
        cloud(count, 16, fitted_focal=500.0),
        cloud(count // 2, 4, turn=turn, to_world=SHEARED),
        cloud(count // 3, 1),
        cloud(count // 4, 9),
        cloud(count // 4, 25),
    ]


def make_eye(place: tuple[float, float, float], back: float = 0.0):
    """Return a view from `place`, with perspective unless `back` is how far the pinhole stands behind."""
    from feature4x.addon.common.axes import Eye
    from feature4x.f4x_core.geometry.camera import Camera

    world_to_camera = np.eye(4)
    world_to_camera[:3, 3] = -np.array(place) + [0, 0, back]
    focal = 0.8 * WIDTH * max(back / 4, 1)
    matrix = np.array([[focal, 0, 0.48 * WIDTH], [0, focal, 0.53 * HEIGHT], [0, 0, 1]])
    return Eye(Camera(matrix, world_to_camera, WIDTH, HEIGHT), 0.05 + back, 9.0 + back, back)


def cases(clouds: list) -> dict[str, tuple]:
    """Return name -> (clouds, surfaces, view)."""
    from feature4x.f4x_core.scene.stage import Surface

    colors = np.array([[0.8, 0.2, 0.1], [0.1, 0.9, 0.3]])
    surfaces = [
        Surface(TRIANGLES, colors),
        Surface(TRIANGLES[:1] + np.array([1.5, 0.5, -0.6]), np.ones((1, 3)), holdout=True),
    ]
    view = make_eye((-0.1, -0.2, -0.3))
    return {
        "splats": (clouds, [], view),
        "surfaces": (clouds, surfaces, view),
        "inside": (clouds, surfaces, make_eye((0.2, 0.1, 3.5))),
        "without_perspective": (clouds, surfaces, make_eye((0, 0, 0), BACK)),
        "surfaces_alone": ([], surfaces, view),
        "nothing": ([], [], view),
    }


def compare(clouds: list, surfaces: list, seen) -> dict[str, float]:
    """Return the differences of the two pictures, in steps of 8 bits, by the largest channel of each pixel."""
    from feature4x.addon.render import viewport_gpu
    from feature4x.f4x_core.scene import stage

    background = np.array([0.2, 0.3, 0.5])
    settings = stage.DrawSettings(seen.near, seen.far, background, surface_samples=1)  # edges are hard in viewports
    engine = stage.draw(stage.as_seen(clouds, seen.back), surfaces, seen.camera, settings)["rgb"]
    picture = viewport_gpu.GpuPicture()
    picture.load(clouds, surfaces, background)
    picture.draw(seen)
    apart = 255 * np.abs(picture.read()[..., :3] - engine).max(-1)
    return {"within_2": float((apart <= 2).mean()), "median": float(np.median(apart)), "largest": float(apart.max())}


def measure(clouds: list, kind: str) -> dict[str, float]:
    """Measure the milliseconds of the processor per redraw: of a still view, one that turns, and one whose second cloud moves."""
    from feature4x.addon.render import viewport_gpu

    picture = viewport_gpu.GpuPicture()
    picture.load(clouds, [], np.zeros(3))
    taken = []
    for redraw in range(REDRAWS):
        if kind == "playing":
            moving = clouds[1]
            moving = replace(moving, means=moving.means + np.float32(0.01), quats=moving.quats.copy())
            clouds = [clouds[0], moving, *clouds[2:]]
        picture.load(clouds, [], np.zeros(3))
        picture.draw(make_eye((0.01 * redraw * (kind == "turning"), 0, 0)), moving=kind != "still")
        taken.append(picture.milliseconds["load"] + picture.milliseconds["prepare"])
    return {"Gaussians": len(picture.splats), "median": float(np.median(taken[1:])), "least": float(min(taken))}


def refused(viewport_gpu) -> bool:
    """Return True if a shader that does not compile leaves the viewport to the processor."""
    viewport_gpu.forget()
    source = viewport_gpu.glsl.LINEAR_FRAGMENT
    viewport_gpu.glsl.LINEAR_FRAGMENT = "void main() { color = nothing_of_the_kind; }"
    try:
        return viewport_gpu.picture() is None and viewport_gpu.picture() is None
    finally:
        viewport_gpu.glsl.LINEAR_FRAGMENT = source
        viewport_gpu.forget()


if __name__ == "__main__":
    door.run(main)
