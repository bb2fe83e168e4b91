"""Estimates the cost of a fit before it starts, and the number of Gaussians that granted time and memory have room for.

The model is linear: a step costs something by itself, something for every pixel and something for every Gaussian. Its constants
are in raster steps (`MachineSpeed`), one of which is timed on the machine at hand, so that they carry over. They were measured
on one clip at three sizes and two numbers of Gaussians with two threads; what more threads share was measured with 2, 4, 8 and
16 on a 16-core machine. Estimates are good to about a third.
"""

from __future__ import annotations

import math
import os
import time
from dataclasses import dataclass, replace

from ..errors import F4xError
from ..native.kernels import torch_threads
from .config import PROFILES, FitConfig, for_frames, profile

STEP, STEP_PER_PIXEL, STEP_PER_GAUSSIAN = 1.0, 2.65e-5, 1.58e-5
"""Cost of a training step, of one of its pixels and of one Gaussian, in raster steps of two threads. Threads share the pixels: a
step of 95,000 Gaussians took 70, 52, 42 and 34 ms with 2, 4, 8 and 16 of them, 30 of which one of them worked alone."""
CLOSEUP = 0.6
"""Cost of a close-up over that of a step: 14 and 23 ms on car-shadow, 20 and 56 on parkour."""
REST_PER_PIXEL = 3.8e-4
"""Cost of scaffold, first Gaussians and the measurements at the end, per pixel of all frames, most of it one thread's."""
TINT_PER_PIXEL, TINT_PER_GAUSSIAN = 8e-5, 1.3e-4
"""Cost of the colors of one frame, per pixel and per Gaussian; all of it is shared."""
TINT_FILE = 3
"""Bytes of one Gaussian's color in one frame."""
PRIORS, PRIORS_PER_PIXEL, PRIORS_SHARED = 150.0, 5.9e-4, 0.4
"""Cost of the priors, and of one of the pixels of all frames that they are made from; the fraction of these that threads share."""
MEASURED_THREADS = 2
"""Threads with which the costs were measured."""
COARSE_PIXELS = 0.25
"""Pixels of a step at half size, over those of a whole one."""
GIGABYTE, MEGABYTE = 1e9, 1e6
BASE_MEMORY, GAUSSIAN_MEMORY = 0.55e9, 1900
"""Bytes of the libraries, and of one Gaussian while it is trained."""
FRAME_MEMORY, HALF_FRAME_MEMORY, IMAGE_PIXEL_MEMORY = 3, 2, 250
"""Bytes of one pixel: of all frames; in addition while training, which has them in half size, too; of the one that is drawn and
compared."""
KEPT_PRIORS_MEMORY, PRIORS_MEMORY = 15, 82
"""Bytes of one pixel of the priors of all frames: while training, and while they are made."""
GAUSSIAN_FILE = 78
"""Bytes of one Gaussian in a scene file."""
MAX_VIEWS = 6.0
"""No clip asked for more Gaussians than one for each cell (`SpawnConfig.spacing`) of so many images; sweeps ask for 4 to 6, clips
that stay in place for 2 to 3."""
MEMORY_FRACTION = 0.5
"""Fraction of the machine's memory that a fit takes at most where no number is granted."""
MIN_FRACTION = 0.1
"""Smallest fraction of the Gaussians that a grant must have room for; with fewer the result would be smear."""
SETS = ("static", "dynamic")


@dataclass(frozen=True)
class ClipSize:
    """Properties of a clip that decide the cost of its fit."""

    frames: int
    """Frames of one window, where there are several."""
    width: int
    height: int
    windows: int = 1
    """Parts of that size that are fitted one after the other."""

    @property
    def pixels(self) -> int:
        """Pixels of one frame."""
        return self.width * self.height

    def shrunk(self, longer_side: int) -> ClipSize:
        """Return the size of the pictures that priors are made from."""
        factor = min(1.0, longer_side / max(self.width, self.height))
        return replace(self, width=round(factor * self.width), height=round(factor * self.height))

    def __str__(self) -> str:
        windows = f"{self.windows} windows of " if self.windows > 1 else ""
        return f"{windows}{self.frames} frames of {self.width}x{self.height}"


@dataclass(frozen=True)
class Grant:
    """Time and memory that a person allows a fit to take."""

    minutes: float | None = None
    """Minutes of wall time; None = as many as the profile takes."""
    memory: float | None = None
    """Gigabytes of main memory; None = `MEMORY_FRACTION` of the machine's."""


@dataclass(frozen=True)
class Cost:
    """Time, memory and disk space that a fit takes."""

    minutes: float
    """Minutes of wall time on a machine with nothing else to do."""
    memory: float
    """Gigabytes of main memory at its peak."""
    file: float
    """Megabytes of the scene file."""

    def __str__(self) -> str:
        room = f"{_up(self.memory)} GB of memory and a scene of {math.ceil(self.file)} MB at most"
        return f"about {_up(self.minutes)} minutes on an idle machine, {room}"


@dataclass(frozen=True)
class Work:
    """Raster steps of two threads."""

    alone: float
    """Work of one thread while the others wait: more threads do not shorten it."""
    shared: float
    """Work of all threads."""

    def __add__(self, other: Work) -> Work:
        """Return the sum of both."""
        return Work(self.alone + other.alone, self.shared + other.shared)


@dataclass(frozen=True)
class MachineSpeed:
    """Speed of this machine."""

    raster_seconds: float
    """Processor time of drawing 20,000 Gaussians in 320 x 180 pixels with gradients: the unit of all costs."""
    threads: int
    """Threads of a fit."""

    @classmethod
    def measured(cls, threads: int) -> MachineSpeed:
        """Time raster steps; the best of five counts.

        Processor time, so that other work on the machine changes nothing: it is what an idle one takes.
        """
        with torch_threads(1):  # as in a fit, where the compiled library has the threads
            return cls(min(_raster_step(threads) for _ in range(5)), threads)

    def seconds(self, work: Work) -> float:
        """Wall time on an idle machine."""
        return self.raster_seconds * (work.alone / MEASURED_THREADS + work.shared / self.threads)


def _raster_step(threads: int) -> float:
    """Processor seconds of one raster step."""
    import torch

    from ..geometry.camera import Camera
    from ..geometry.splats import Splats
    from ..raster import RasterConfig, rasterize

    count, generator = 20_000, torch.Generator().manual_seed(0)
    means = torch.rand(count, 3, generator=generator) * torch.tensor([3.2, 1.8, 1.0]) + torch.tensor([-1.6, -0.9, 1.5])
    quats = torch.nn.functional.normalize(torch.randn(count, 4, generator=generator), dim=1)
    scales, opacities = torch.full((count, 3), 0.012), torch.full((count,), 0.6)
    colors = torch.rand(count, 3, generator=generator)
    splats = Splats(means.requires_grad_(True), quats, scales, opacities, colors[:, None])
    camera = Camera(torch.tensor([[200.0, 0, 160], [0, 200, 90], [0, 0, 1]]), torch.eye(4), 320, 180)
    start = time.process_time()
    rasterize(splats, colors, camera, config=RasterConfig(threads=threads)).channels.sum().backward()
    return time.process_time() - start


def max_gaussians(config: FitConfig) -> int:
    """Return the Gaussians that a fit has room for."""
    return config.density_static.max_count + config.density_dynamic.max_count


def asked_gaussians(size: ClipSize, config: FitConfig) -> float:
    """Return the Gaussians that such a clip can ask for at most."""
    return config.density_static.max_growth * MAX_VIEWS * size.pixels / config.spawn_static.spacing**2


def expected_gaussians(size: ClipSize, config: FitConfig) -> float:
    """Return the Gaussians that a fit may end with: what there is room for, or what a clip can ask for."""
    return min(max_gaussians(config), asked_gaussians(size, config))


def machine_memory() -> float:
    """Return the gigabytes of main memory of this machine; infinite where it does not tell."""
    if not hasattr(os, "sysconf"):  # Windows
        return float("inf")
    return os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES") / GIGABYTE


def cost(size: ClipSize, config: FitConfig, speed: MachineSpeed) -> Cost:
    """Return the most that the fit of a clip takes."""
    count = expected_gaussians(size, config)
    seconds = speed.seconds(_fixed(size, config)) + count * speed.seconds(_per_gaussian(size, config))
    return Cost(
        size.windows * seconds / 60,
        _memory(size, config, count) / GIGABYTE,
        size.windows * GAUSSIAN_FILE * count / MEGABYTE + _tint_file(size, config, count) / MEGABYTE,
    )


def for_clip(minutes: float | None, size: ClipSize, config: FitConfig, speed: MachineSpeed) -> FitConfig:
    """Return the configuration for so many frames (`for_frames`), with those of its steps that `minutes` have time for.

    The profile's own steps are always taken: what has no time for these is thinned (`within`).
    """
    whole = for_frames(config, size.frames)
    if minutes is None or whole.steps == config.steps:
        return whole
    least, most = (cost(size, replace(whole, steps=one.steps), speed).minutes for one in (config, whole))
    part = min(max((minutes - least) / (most - least), 0.0), 1.0)
    return replace(whole, steps=config.steps + int(part * (whole.steps - config.steps)))


def has_room(size: ClipSize, config: FitConfig, memory: float | None) -> bool:
    """Return True if `memory` (GB; None: the default of a grant) holds a fit with all Gaussians that the clip may ask for."""
    return _memory_limit(memory, size, config).room >= expected_gaussians(size, config)


def within(grant: Grant, size: ClipSize, config: FitConfig, speed: MachineSpeed) -> FitConfig:
    """Return the configuration with as many Gaussians as the grant has room for, or the profile's own where nothing is granted.

    Raises:
        F4xError: a grant that has no room for what a tenth of the profile's Gaussians, or all that such a clip can ask for,
            needs; the sentence has what is needed.
    """
    limits = [_minutes_limit(grant.minutes, size, config, speed)] if grant.minutes is not None else []
    limits.append(_memory_limit(grant.memory, size, config))
    tightest = min(limits, key=lambda limit: limit.room)
    if grant == Grant() and tightest.room >= expected_gaussians(size, config):
        return config
    least = _scaled(config, MIN_FRACTION, size.frames)
    short = [limit.option for limit in limits if limit.room < expected_gaussians(size, least)]
    if short:
        needed, there = cost(size, least, speed), machine_memory()
        has = f", which has {there:.1f} GB" if there < float("inf") else ""
        raise F4xError(
            f"A fit of {size} pixels with the profile {config.name} takes at least {_up(needed.minutes)} minutes and"
            f" {_up(needed.memory)} GB on this machine{has}; grant more ({' and '.join(short)}), or give fewer --frames, a"
            " smaller --width or another --profile."
        )
    return replace(_scaled(config, tightest.room / max_gaussians(config), size.frames), counts_from=tightest.words)


@dataclass(frozen=True)
class _Limit:
    """Number of Gaussians that one grant has room for."""

    option: str
    """Option of the command line."""
    words: str
    """The option with its value."""
    room: float


def _minutes_limit(minutes: float, size: ClipSize, config: FitConfig, speed: MachineSpeed) -> _Limit:
    """Room in so many minutes for all windows."""
    left = 60 * minutes / size.windows - speed.seconds(_fixed(size, config))
    return _Limit("--minutes", f"--minutes {minutes:g}", left / speed.seconds(_per_gaussian(size, config)))


def _memory_limit(granted: float | None, size: ClipSize, config: FitConfig) -> _Limit:
    """Room in so many gigabytes, or in `MEMORY_FRACTION` of the machine's; none where the priors alone need more."""
    there = machine_memory()
    memory = MEMORY_FRACTION * there if granted is None else min(granted, there)
    room = (GIGABYTE * memory - BASE_MEMORY - _training_memory(size, config)) / GAUSSIAN_MEMORY
    if GIGABYTE * memory < _memory(size, config, 0):
        room = -math.inf
    if granted is None:
        words = f"half of this machine's {there:.1f} GB of memory"
    else:
        words = f"--memory {granted:g}" if granted <= there else f"this machine's {there:.1f} GB of memory"
    option = "--memory" if granted is not None else "--memory, without which half of the machine's is the limit"
    return _Limit(option, words, room)


def _up(number: float) -> str:
    """Return a number to one decimal, rounded up: what is said to be enough is."""
    return f"{math.ceil(10 * number) / 10:.1f}"


def _fixed(size: ClipSize, config: FitConfig) -> Work:
    """Return the cost of everything but the Gaussians."""
    small = size.shrunk(config.priors.longer_side)
    per_pixel = PRIORS_PER_PIXEL * small.frames * small.pixels
    priors = Work(PRIORS + (1 - PRIORS_SHARED) * per_pixel, PRIORS_SHARED * per_pixel)
    pixels = size.pixels * (1 - config.coarse * (1 - COARSE_PIXELS))
    steps = Work(_steps(config) * STEP, _steps(config) * STEP_PER_PIXEL * pixels)
    tints = Work(0, _tint_frames(size, config) * TINT_PER_PIXEL * size.pixels)
    return priors + steps + tints + Work(REST_PER_PIXEL * size.frames * size.pixels, 0)


def _per_gaussian(size: ClipSize, config: FitConfig) -> Work:
    """Return the cost of one Gaussian."""
    return Work(_steps(config) * STEP_PER_GAUSSIAN, _tint_frames(size, config) * TINT_PER_GAUSSIAN)


def _steps(config: FitConfig) -> float:
    """Return the steps that cost as much as all steps with their close-ups."""
    return config.steps * (1 + CLOSEUP * config.closeups)


def _tint_frames(size: ClipSize, config: FitConfig) -> int:
    """Return the frames whose colors are found, if there is room for all."""
    return size.frames if config.tints.enabled else 0


def _tint_file(size: ClipSize, config: FitConfig, count: float) -> float:
    """Return the bytes of the colors over time of a whole scene in its file."""
    frames = size.windows * _tint_frames(size, config)
    return min(TINT_FILE * count * size.windows * frames, config.tints.bytes_for(frames))


def _memory(size: ClipSize, config: FitConfig, count: float) -> float:
    """Return the bytes at the peak, with so many Gaussians."""
    small = size.shrunk(config.priors.longer_side)
    training = _training_memory(size, config) + GAUSSIAN_MEMORY * count
    priors = FRAME_MEMORY * size.frames * size.pixels + PRIORS_MEMORY * small.frames * small.pixels
    return BASE_MEMORY + max(training, priors)


def _training_memory(size: ClipSize, config: FitConfig) -> float:
    """Return the bytes of the clip's images and priors, and of one image's rendering, while training."""
    small = size.shrunk(config.priors.longer_side)
    images = ((FRAME_MEMORY + HALF_FRAME_MEMORY) * size.frames + IMAGE_PIXEL_MEMORY) * size.pixels
    return images + KEPT_PRIORS_MEMORY * small.frames * small.pixels


def _scaled(config: FitConfig, factor: float, frames: int) -> FitConfig:
    """Return the configuration with room for `factor` times as many Gaussians; what was set by hand never becomes more."""
    usual = for_frames(profile(config.name), frames) if config.name in PROFILES else config
    changes, kept = {}, []
    for name in [f"{kind}_{which}" for kind in ("spawn", "density") for which in SETS]:
        own = getattr(config, name)
        if factor >= 1 and own.max_count != getattr(usual, name).max_count:
            kept.append(f"{name}.max_count")
        else:
            changes[name] = replace(own, max_count=max(1, int(factor * own.max_count)))
    return replace(config, **changes, own_counts=tuple(kept))
