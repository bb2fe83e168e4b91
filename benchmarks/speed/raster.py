"""Times and checks the raster backends on a synthetic scene: `f4x bench raster`."""

from __future__ import annotations

import json
import math
import statistics
import subprocess
import sys
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from f4x_core.errors import F4xError
from f4x_core.geometry.camera import Camera
from f4x_core.geometry.splats import Splats
from f4x_core.progress import Progress, silent
from f4x_core.raster import CPU_BACKENDS, RasterConfig, RasterInput, RasterOutput, choose_backend, rasterize

from ..timing import measure_in_turn

if TYPE_CHECKING:
    import torch

# Scene of the error check: small, because the reference lets every splat meet every pixel.
CHECK_WIDTH, CHECK_HEIGHT, CHECK_GAUSSIANS, CHECK_CHANNELS = 137, 101, 600, 11
SHEETS = 6
# Least float operations of a contributing (pixel, Gaussian) pair, forward and backward: offset, quadratic form, exponential,
# transmittance, six moments; and per channel one blend, one dot product and one gradient.
FORWARD_OPERATIONS, FORWARD_CHANNEL_OPERATIONS = 22, 2
BACKWARD_OPERATIONS, BACKWARD_CHANNEL_OPERATIONS = 47, 4
# The comparison of a decoded latent with rendering what it stands for, and the case whose memory is measured.
LATENT, DECODED, LATENT_GAUSSIANS, STRIP = 32, 512, 50_000, 8
MEMORY_GAUSSIANS, MEMORY_CHANNELS = 200_000, 35
MEGABYTE = 2**20
CHECKOUT = Path(__file__).resolve().parents[2]
"""Folder in which a child process finds this module."""
PEAK_SECONDS = 0.05
GRADIENTS = ("means", "quats", "scales", "opacities", "colors", "viewmat")
Draw = Callable[..., "torch.Tensor"]
"""Takes a scene as `make_wavy_scene` gives it, by keywords, and gives its channels (H, W, C)."""


def make_wavy_scene(
    count: int, channels: int, width: int, height: int, seed: int = 0, dtype: torch.dtype | None = None
) -> dict[str, Any]:
    """Keyword arguments of `rasterize`: `SHEETS` wavy sheets of splats as large as their mean spacing, 1 to 3 deep.

    About 40 splats contribute to a pixel before it stops, whatever `count` is, as in a fitted scene.
    """
    import torch

    generator = torch.Generator().manual_seed(seed)

    def uniform(*shape: int) -> torch.Tensor:
        return torch.rand(*shape, generator=generator, dtype=torch.float64)

    def normal(*shape: int) -> torch.Tensor:
        return torch.randn(*shape, generator=generator, dtype=torch.float64)

    focal = 0.9 * width
    sheet = torch.arange(count) % SHEETS
    x, y = 2 * uniform(2, count) - 1
    base = 1 + 0.4 * sheet
    z = base + 0.1 * torch.sin(4 * x + sheet) * torch.cos(5 * y)
    half_width, half_height = (1.15 * size / 2 / focal for size in (width, height))
    spacing = base * math.sqrt(4 * half_width * half_height * SHEETS / max(count, 1))
    scene = {
        "means": torch.stack((x * half_width * z, y * half_height * z, z), 1),
        "quats": normal(count, 4),
        "scales": 0.55 * spacing[:, None] * torch.exp(0.4 * normal(count, 3)),
        "opacities": torch.sigmoid(1 + 1.5 * normal(count)),
        "colors": uniform(count, channels),
        "viewmat": torch.eye(4, dtype=torch.float64),
        "K": torch.tensor([[focal, 0, width / 2], [0, focal, height / 2], [0, 0, 1]], dtype=torch.float64),
    }
    tensors = {name: value.to(dtype or torch.float32) for name, value in scene.items()}
    return {**tensors, "width": width, "height": height}


@dataclass(frozen=True)
class Cases:
    """Images to measure: every number of Gaussians with every number of channels and threads."""

    counts: Sequence[int] = (10_000, 50_000)
    channels: Sequence[int] = (3, 35)
    threads: Sequence[int] = (1,)
    width: int = 480
    height: int = 270


def benchmark(
    cases: Cases, backends: Sequence[str] | None = None, repeats: int = 5, progress: Progress = silent
) -> dict[str, Any]:
    """Measure every backend that runs here, all of them in turn `repeats` times, so that a ratio compares like with like.

    Returns:
        `timings`: list of backend, gaussians, channels, threads, forward_ms (no gradients), train_ms (forward and
        backward), medians of wall times, and for `native` pairs_per_pixel and peak_fraction (of the multiply-add peak of as
        many threads). `ratios`: named quotients of train_ms. `errors`: per backend image_max, image_rmse and relative L2
        `gradients` against the float64 reference. `skipped`: backend -> reason.
    """
    skipped: dict[str, str] = {}
    names = []
    for name in backends or [name for name in CPU_BACKENDS if name != "reference"]:
        if name not in CPU_BACKENDS:
            skipped[name] = "these are the processor's times"
            continue
        try:
            names.append(choose_backend(name))
        except F4xError as error:
            skipped[name] = str(error)
    errors = {name: _measure_error(name) for name in names}
    sizes = [(n, c) for n in cases.counts for c in cases.channels]
    timings = []
    for done, (n, c) in enumerate(sizes):
        progress("bench raster", done, len(sizes), f"{n:,} Gaussians, {c} channels")
        scene = make_wavy_scene(n, c, cases.width, cases.height)
        variants = [(name, t) for name in names for t in cases.threads]
        seconds, peak = _measure_times(scene, variants, repeats)
        for (name, t), (forward, train) in zip(variants, seconds, strict=True):
            row = {"backend": name, "gaussians": n, "channels": c, "threads": t}
            row |= {"forward_ms": 1e3 * forward, "train_ms": 1e3 * train}
            if name == "native":
                row |= _measure_work(scene, t * peak * train)
            timings.append(row)
    return {
        "width": cases.width,
        "height": cases.height,
        "timings": timings,
        "ratios": _ratios(timings),
        "errors": errors,
        "skipped": skipped,
    }


def compare_decoding(
    gaussians: int = LATENT_GAUSSIANS, width: int = 480, height: int = 270, repeats: int = 5, backend: str = "auto"
) -> dict[str, float]:
    """Measure the savings by a latent: `DECODED` channels rendered against `LATENT` channels rendered and decoded per pixel.

    Both forward and backward on one thread, the decoder is one linear layer.

    Returns:
        rendered_ms, decoded_ms and their ratio.
    """
    import torch

    decoder = torch.nn.Linear(LATENT, DECODED)
    scenes = {c: make_wavy_scene(gaussians, c, width, height) for c in (LATENT, DECODED)}

    def train(channels: int) -> None:
        scene = {**scenes[channels], "backend": backend, "config": RasterConfig(threads=1)}
        leaves = [scene[name].requires_grad_() for name in GRADIENTS]
        image = draw(**scene).channels
        if channels == DECODED:
            torch.autograd.grad(image.sum(), leaves)
            return
        # Strip by strip, as the picture of all channels is never needed at once.
        latent = image.detach().requires_grad_()
        for strip in latent.split(STRIP):
            decoder(strip).sum().backward()
        torch.autograd.grad(image, leaves, latent.grad)

    rendered, decoded = measure_in_turn([partial(train, DECODED), partial(train, LATENT)], repeats)
    return {"rendered_ms": 1e3 * rendered, "decoded_ms": 1e3 * decoded, "ratio": rendered / decoded}


def measure_memory(
    gaussians: int = MEMORY_GAUSSIANS, channels: int = MEMORY_CHANNELS, width: int = 480, height: int = 270
) -> float | None:
    """Peak memory (MB) of making a scene and two training steps above that of the imports, in a process of its own.

    None where the operating system does not tell (Windows).
    """
    if sys.platform == "win32":
        return None
    call = f"report_memory({gaussians}, {channels}, {width}, {height})"
    command = [sys.executable, "-c", f"from {__name__} import report_memory; {call}"]
    done = subprocess.run(command, cwd=CHECKOUT, capture_output=True, text=True, check=True)
    return json.loads(done.stdout)


def report_memory(gaussians: int, channels: int, width: int, height: int) -> None:
    """Child of `measure_memory`: print the growth of the peak."""
    import torch

    def train(scene: dict[str, Any]) -> None:
        leaves = [scene[name].requires_grad_() for name in GRADIENTS]
        torch.autograd.grad(draw(**scene, config=RasterConfig(threads=1)).channels.sum(), leaves)

    train(make_wavy_scene(10, channels, 16, 16))  # loads the library and torch's autograd
    before = _peak_memory()
    scene = make_wavy_scene(gaussians, channels, width, height)
    for _ in range(2):
        train(scene)
    print(json.dumps(_peak_memory() - before))


def _peak_memory() -> float:
    """Most memory (MB) that this process has held."""
    status = Path("/proc/self/status")
    if status.is_file():  # on Linux getrusage also counts what the parent held before this program was started
        line = next(line for line in status.read_text().splitlines() if line.startswith("VmHWM"))
        return int(line.split()[1]) / 1024
    import resource

    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / MEGABYTE  # macOS counts bytes


def measure_thread_ceiling(threads: int = 2, seconds: float = 0.3) -> float | None:
    """Return the speed-up of `threads` independent loops of multiply-adds over one: the most that threads can gain here.

    2 on two cores, little above 1 on two hardware threads of one core. None without the native library.
    """
    from f4x_core.native import measure_peak, open_library

    library, _ = open_library()
    if library is None:
        return None
    single = measure_peak(library, seconds)
    with ThreadPoolExecutor(threads) as pool:
        return sum(pool.map(lambda _: measure_peak(library, seconds), range(threads))) / single


def _ratios(timings: list[dict[str, Any]]) -> dict[str, float]:
    """torch / native, most / fewest channels and one / more threads, wherever both were measured."""
    times = {(r["gaussians"], r["channels"], r["threads"], r["backend"]): r["train_ms"] for r in timings}
    min_channels, single = min(key[1] for key in times), min(key[2] for key in times)
    ratios = {}
    for (n, c, t, name), train in times.items():
        case = f"{n} Gaussians, {c} channels, {t} threads"
        if name == "native" and (n, c, t, "torch") in times:
            ratios[f"torch / native, {case}"] = times[n, c, t, "torch"] / train
        if c > min_channels:
            ratios[f"{c} / {min_channels} channels, {name}, {n} Gaussians, {t} threads"] = (
                train / times[n, min_channels, t, name]
            )
        if t > single:
            ratios[f"{single} / {t} threads, {name}, {n} Gaussians, {c} channels"] = times[n, c, single, name] / train
    return ratios


def _measure_times(
    scene: dict[str, Any], variants: list[tuple[str, int]], repeats: int
) -> tuple[list[tuple[float, float]], float]:
    """Median seconds of a forward pass without gradients and of a forward and backward pass, per (backend, threads).

    Also the median multiply-add peak of one thread (operations per second; 0 without the native library), taken in the same
    rounds: on a shared machine a processor's speed is not the same a minute later.
    """
    from f4x_core.native import measure_peak, open_library

    library, _ = open_library()
    peaks: list[float] = []

    def peak() -> None:
        peaks.append(measure_peak(library, PEAK_SECONDS) if library else 0.0)

    work = [f for name, t in variants for f in passes(scene, draw_with(name, RasterConfig(threads=t)))]
    medians = measure_in_turn([*work, peak], repeats)
    return list(zip(medians[:-1:2], medians[1:-1:2], strict=True)), statistics.median(peaks)


VIEW = ("means", "quats", "scales", "opacities", "colors", "K", "viewmat", "width", "height")
"""Names of what is drawn, and from where."""


def view_of(scene: Mapping[str, Any]) -> tuple[Splats, Any, Camera]:
    """Return the first three arguments of `rasterize` for a scene of named arrays, as `make_wavy_scene` returns it."""
    splats = Splats(scene["means"], scene["quats"], scene["scales"], scene["opacities"])
    return splats, scene["colors"], Camera(scene["K"], scene["viewmat"], scene["width"], scene["height"])


def draw(**given: Any) -> RasterOutput:
    """`rasterize` of the named arrays of `view_of`; what else is given are its options."""
    options = {name: value for name, value in given.items() if name not in VIEW}
    return rasterize(*view_of(given), **options)


def draw_with(backend: str, config: RasterConfig | None = None) -> Draw:
    """Return the drawing of `rasterize` by a backend."""
    return lambda **scene: draw(**scene, backend=backend, config=config).channels


def passes(scene: dict[str, Any], draw: Draw) -> tuple[Callable[[], object], Callable[[], object]]:
    """Return the functions to time for `scene`: a forward pass without gradients, and a forward and backward pass."""
    import torch

    leaves = [scene[name].requires_grad_() for name in GRADIENTS]
    height, width, channels = scene["height"], scene["width"], scene["colors"].shape[1]
    sent = torch.ones(height, width, channels, dtype=scene["colors"].dtype)  # as a loss would hand it back

    def preview() -> None:
        with torch.no_grad():
            draw(**scene)

    def train() -> None:
        image = draw(**scene)
        torch.autograd.grad(image, leaves, sent.to(image.dtype))

    return preview, train


def count_pairs(scene: dict[str, Any]) -> int:
    """Count the (pixel, Gaussian) pairs that contribute to the picture of a `scene`. The native library must be there."""
    from f4x_core.raster.native import library as native

    library, reason = native.open_library()
    assert library is not None, reason
    arrays = {name: scene[name].detach().numpy() for name in (*GRADIENTS, "K")}
    inputs = RasterInput(*view_of(scene | arrays), config=RasterConfig(threads=1))
    render = native.forward(library, inputs, keep=True)
    return native.count_pairs(library, render)


def _measure_work(scene: dict[str, Any], possible: float) -> dict[str, float]:
    """Contributing pairs per pixel, and the share of the `possible` multiply-adds that they amount to."""
    pairs, channels = count_pairs(scene), scene["colors"].shape[1]
    operations = FORWARD_OPERATIONS + BACKWARD_OPERATIONS
    operations += (FORWARD_CHANNEL_OPERATIONS + BACKWARD_CHANNEL_OPERATIONS) * channels
    return {
        "pairs_per_pixel": pairs / (scene["width"] * scene["height"]),
        "peak_fraction": pairs * operations / possible,
    }


@dataclass(frozen=True)
class Answer:
    """Render and gradients of one backend, in float64."""

    image: torch.Tensor
    """(H, W, C)"""
    gradients: dict[str, torch.Tensor]
    """Those named in `GRADIENTS`, of a sum over the picture with random weights."""

    def minus(self, truth: Answer) -> dict[str, Any]:
        """`image_max`, `image_rmse` and the relative L2 `gradients` of the difference from `truth`.

        `image_most`: 99.9 % of the pixels are within it. What lies between it and `image_max` are pixels in which a splat
        on the verge of a cut-off is in for one and out for the other.
        """
        difference = self.image - truth.image
        return {
            "image_max": float(difference.abs().max()),
            "image_most": float(difference.abs().amax(-1).flatten().quantile(0.999)),
            "image_rmse": float(difference.square().mean().sqrt()),
            "gradients": {
                name: float((gradient - truth.gradients[name]).norm() / truth.gradients[name].norm())
                for name, gradient in self.gradients.items()
            },
        }


def answer(scene: dict[str, Any], draw: Draw) -> Answer:
    """Picture and gradients of a `scene` as `draw` computes them in the scene's own precision."""
    import torch

    size = scene["height"], scene["width"], scene["colors"].shape[1]
    weights = torch.rand(*size, generator=torch.Generator().manual_seed(1))
    leaves = {key: scene[key].detach().requires_grad_() for key in GRADIENTS}
    image = draw(**{**scene, **leaves}).double()
    gradients = torch.autograd.grad((image * weights).sum(), list(leaves.values()))
    return Answer(image.detach(), {name: g.double() for name, g in zip(GRADIENTS, gradients, strict=True)})


def _measure_error(backend: str) -> dict[str, Any]:
    scene = make_wavy_scene(CHECK_GAUSSIANS, CHECK_CHANNELS, CHECK_WIDTH, CHECK_HEIGHT)
    return answer(scene, draw_with(backend)).minus(answer(scene, draw_with("reference")))
