"""Runs the native library under AddressSanitizer, UndefinedBehaviorSanitizer and ThreadSanitizer: `python scripts/sanitize.py`.

Linux with GCC. Each build is exercised in a process of its own; ThreadSanitizer's without torch, whose own threads would
drown real reports. Exits with 1 when a sanitizer reports anything.
"""

import argparse
import os
import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT))

from f4x_core.geometry.camera import Camera  # noqa: E402
from f4x_core.geometry.splats import Splats  # noqa: E402
from f4x_core.native import library as native  # noqa: E402
from f4x_core.native.build import compile_command, find_compiler  # noqa: E402
from f4x_core.raster.contract import RasterConfig, RasterInput  # noqa: E402

# Name -> compiler flags and the runtime that has to be in the process before Python starts.
SANITIZERS = {
    "address": (["-fsanitize=address"], "libasan.so"),
    "undefined": (["-fsanitize=undefined", "-fno-sanitize-recover=undefined"], "libubsan.so"),
    "thread": (["-fsanitize=thread"], "libtsan.so"),
}
OPTIONS = {
    "ASAN_OPTIONS": "detect_leaks=0",
    "TSAN_OPTIONS": "exitcode=66",
    "UBSAN_OPTIONS": "print_stacktrace=1",
    "OPENBLAS_NUM_THREADS": "1",  # numpy's own threads, which look like races
}


def main() -> int:
    """Build, exercise and report every sanitizer; or, as a child, exercise one build."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--exercise", type=Path, metavar="LIBRARY", help="only call the kernels of this library")
    parser.add_argument("--torch", action="store_true", help="with --exercise: also those that torch calls")
    args = parser.parse_args()
    if args.exercise:
        native.library_path.cache_clear()
        native.library_path = lambda target=None: args.exercise  # type: ignore[assignment]
        exercise()
        if args.torch:
            exercise_with_torch()
        return 0
    failed = []
    with tempfile.TemporaryDirectory() as folder:
        for name in SANITIZERS:
            ok = check(name, Path(folder) / f"{name}.so")
            print(f"{name}: {'clean' if ok else 'FAILED'}", flush=True)
            failed += [] if ok else [name]
    return 1 if failed else 0


def check(name: str, output: Path) -> bool:
    """Return True if the kernels run clean under one sanitizer; its report goes to standard error."""
    flags, runtime = SANITIZERS[name]
    compiler = find_compiler()
    if compiler is None:
        sys.exit("sanitize: no C++ compiler is on the path; install g++.")
    command = [*compile_command(compiler, output), *flags, "-g", "-O1"]
    command = [part for part in command if not part.startswith("-static")]  # a sanitizer's runtime is shared
    subprocess.run(command, check=True)
    found = subprocess.run([*compiler, f"-print-file-name={runtime}"], capture_output=True, text=True, check=True)
    environment = {**os.environ, **OPTIONS, "LD_PRELOAD": found.stdout.strip()}
    child = [sys.executable, __file__, "--exercise", str(output), *([] if name == "thread" else ["--torch"])]
    return subprocess.run(child, env=environment, check=False).returncode == 0


def exercise() -> None:
    """Call every kernel forward and backward, with one and several threads, on ordinary and on hard input."""
    from f4x_core.raster.native import library as raster
    from f4x_core.scaffold.deformation.native import library as deformation

    loaded, reason = raster.open_library()
    assert loaded is not None, reason
    for seed, (count, channels, width, height) in enumerate(
        [(0, 1, 1, 1), (1, 3, 17, 1), (700, 5, 83, 61), (3000, 35, 64, 48)]
    ):
        rng = np.random.default_rng(seed)
        for threads in (1, 4):
            render = raster.forward(loaded, _view(rng, count, channels, (width, height), threads), keep=True)
            raster.backward(
                loaded, render, np.ones_like(render.output.channels), np.ones_like(render.output.depth), None
            )
            raster.count_pairs(loaded, render)
    rng = np.random.default_rng(9)
    for count in (0, 1, 5000):
        frames, nodes, slots, times = 6, 20, 5, 2
        node, then = (rng.integers(0, limit, 60) for limit in (nodes, frames * nodes))
        arrays = {
            "node_xyz": rng.normal(size=(frames, nodes, 3)),
            "node_quat": rng.normal(size=(frames, nodes, 4)),
            "radius": rng.uniform(0.1, 1, nodes),
            "node": node,
            "then": then,
            "now_xyz": rng.normal(size=(times, nodes, 3)),
            "now_quat": np.tile([1.0, 0, 0, 0], (times, nodes, 1)),
            "xyz": rng.normal(size=(count, 3)),
            "quat": rng.normal(size=(count, 4)),
            "index": rng.integers(0, 60, (count, slots)),
            "mask": rng.uniform(size=(count, slots)) > 0.2,
            "dw": rng.normal(size=(count, slots)),
        }
        tables = deformation.relate(arrays)
        posed = arrays | {"nodes": tables[0], "motions": tables[1:]}
        for threads in (1, 4):
            means, quats = deformation.forward(posed, "sigma", threads)
            got = deformation.backward(posed, "sigma", threads, np.ones_like(means), np.ones_like(quats))
            deformation.relate_backward(arrays, got["tables"])
    _exercise_order(rng)
    _look_up(rng)
    _adjust()


def _exercise_order(rng: np.random.Generator) -> None:
    """Order Gaussians by depth, some of them not finite; so many that several threads take part."""
    from f4x_core.scene.depth_order import OrderSettings, depth_order

    rows = np.array([[0, 0, 1, 0], [0, 0.1, 1, 0.2]], np.float32)
    for count in (0, 1, 200_000):
        means = rng.normal(size=(count, 3)).astype(np.float32)
        means[::11] = np.nan
        opacities, out = np.ones(count, np.float32), np.zeros(count, np.float32)
        for threads in (1, 4):
            for coarse in (False, True):
                settings = OrderSettings(0.1, 2.0, 0.01, coarse, threads)
                depth_order(means, opacities, np.array([0, count // 3, count]), rows, settings, out)


def _look_up(rng: np.random.Generator) -> None:
    """Sample maps as thin as one pixel, also far outside and at what is no number, and draw smooth maps through samples."""
    from f4x_core.priors.depth import fill_inverse_depth
    from f4x_core.priors.flow import sample

    for height, width in ((1, 1), (1, 5), (4, 1), (2, 2), (33, 47)):
        points = rng.uniform(-3, 60, (70, 2))
        points[::9] = np.nan, np.inf
        for dtype in (np.float16, np.float32):
            sample(rng.normal(size=(height, width, 2)).astype(dtype), points)
        values, guide = rng.uniform(0.1, 1, (height, width)), rng.uniform(0, 255, (height, width)).astype(np.float32)
        fill_inverse_depth(values, values, guide, 9)


def _adjust() -> None:
    """Call the sums of bundle adjustment: few and many sightings, points behind their cameras, lenses that zoom."""
    from f4x_core.priors.bundle import Bundle, BundleConfig, Observations, adjust, resect

    rng = np.random.default_rng(3)
    for frames, points in ((1, 1), (3, 12), (9, 200)):
        frame, point = np.nonzero(rng.random((frames, points)) > 0.2)
        seen = Observations(frame, point, rng.uniform(0, 100, (len(frame), 2)), np.ones(len(frame)))
        rotation, center = np.tile(np.eye(3), (frames, 1, 1)), 0.1 * rng.normal(size=(frames, 3))
        bundle = Bundle(100.0, np.array([50.0, 50.0]), rotation, center, rng.normal([0, 0, 2], 1, (points, 3)))
        for zooms in (False, True):
            adjust(bundle, seen, BundleConfig(iterations=3, refine_zoom=zooms))
        resect(bundle, seen, np.arange(frames), 3)


def exercise_with_torch() -> None:
    """Call the colours, the picture loss and the losses of the scaffold, forward and backward."""
    import torch

    from f4x_core.fit.frame_native import FrameMaps
    from f4x_core.fit.losses import FrameFactors, frame_losses, rgb_loss
    from f4x_core.gaussians import appearance
    from f4x_core.gaussians.appearance_native import Drawing, DrawnSet, NativeDrawing
    from f4x_core.native.density import F4X_RECORD_PULLS, PULLS
    from f4x_core.native.kernels import Kernels
    from f4x_core.scaffold.adam import Adam
    from f4x_core.scaffold.losses import ArapEdges, MotionTerms, motion_loss
    from f4x_core.scaffold.motion_native import MotionWeights

    for frames in (2, 7, 8, 9, 40):
        edges = ArapEdges.build(np.arange(12).reshape(4, 3) % 4, np.ones((4, 3), bool))
        xyz, quat = (torch.randn(frames, 4, axes, requires_grad=True) for axes in (3, 4))
        weights, times = MotionWeights(1, 1, 1, 1, 1, 1), torch.arange(frames)
        terms = MotionTerms(edges, {1: 0.3, 5: 0.3, 8: 0.4}, weights, Kernels(True))
        motion_loss(xyz, quat, times, terms).backward()
    for threads in (1, 4):
        for coefficients in (1, 4, 9, 16):
            for count in (1, 9, 3000):
                shapes = (coefficients, 3), (3,), (4,)
                sh, means, quats = (torch.randn(count, *shape, requires_grad=True) for shape in shapes)
                appearance(sh, means, quats, torch.zeros(3), Kernels(True, threads)).sum().backward()
        for height, width in ((1, 1), (5, 7), (61, 83)):
            image = torch.rand(height, width, 4, requires_grad=True)
            target, weight = torch.rand(height, width, 3), torch.rand(height, width)
            rgb_loss(image[..., :3], target, weight, 0.3, Kernels(True, threads)).backward()
            depth, alpha = (torch.rand(height, width, requires_grad=True) for _ in range(2))
            scores = torch.rand(2, height, width).half()
            maps = FrameMaps((255 * target).byte(), torch.rand(height, width), *scores)
            frame_losses((image, depth, alpha), maps, FrameFactors(0.3, 3, 1, 1, 1), threads).backward()
        for shape in ((1,), (9, 3), (3000, 1, 3), (700, 15, 3)):
            value = torch.randn(shape, requires_grad=True)
            adam = Adam([{"params": [value], "lr": 0.1, "name": "means"}], Kernels(True, threads))
            rows = {"means": torch.rand(len(value))} if len(shape) == 2 else None
            value.square().sum().backward()
            adam.step(rows, rows)
        for count in (1, 9, 3000):
            drawing = Drawing((0.0, 0.0, 0.0), 7, 1.0, torch.rand(count), 0.5, 1e-4, None, threads)
            widths = (3,), (4,), (3,), (), (1, 3), (3, 3), (2,), (3,)
            own = DrawnSet(*(torch.randn(count, *width, requires_grad=True) for width in widths))
            sum(part.sum() for part in NativeDrawing.apply(drawing, *own)).backward()
            sums = torch.zeros(count), torch.zeros(count)
            arrays = {"gradient": torch.randn(count, 2), "visible": torch.rand(count) < 0.5}
            F4X_RECORD_PULLS(
                PULLS(count=count, threads=threads, across=1.0, down=1.0, gradient_sum=sums[0], seen=sums[1], **arrays)
            )


def _view(rng: np.random.Generator, count: int, channels: int, size: tuple[int, int], threads: int) -> RasterInput:
    """Return random Gaussians, some of them broken: behind the camera, of no size, huge, not a number."""
    width, height = size
    splats = Splats(
        means=rng.normal([0, 0, 2], 1, (count, 3)),
        quats=rng.normal(size=(count, 4)),
        scales=np.exp(rng.normal(-3, 2, (count, 3))),
        opacities=rng.uniform(0, 1, count),
    )
    if count > 100:
        for name, value in (("means", np.nan), ("scales", 0.0), ("scales", 1e4), ("quats", 0.0), ("opacities", np.inf)):
            getattr(splats, name)[rng.integers(0, count, 10)] = value
    camera = Camera([[width, 0, width / 2], [0, width, width / 3], [0, 0, 1.0]], np.eye(4), width, height)
    colors = rng.normal(size=(count, channels))
    return RasterInput(splats, colors, camera, config=RasterConfig(threads=threads))


if __name__ == "__main__":
    sys.exit(main())
