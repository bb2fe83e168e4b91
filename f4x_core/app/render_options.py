"""The pictures of a scene that are drawn."""

from collections.abc import Iterable
from dataclasses import dataclass

MASK = "mask:"
"""Prefix of the channel `mask:LABEL`: the fraction of each pixel's blend weight that comes from the Gaussians of a label."""


@dataclass(frozen=True)
class RenderOptions:
    """The pictures that are drawn; `f4x render --help` has the same options."""

    path: str = "original"
    """`original`, `orbit`, `stabilise`, `slow:FACTOR`, `bullet:T`, `frozen:T` or a camera path file."""
    channels: tuple[str, ...] = ("rgb",)
    """`rgb`, `depth`, `alpha`, `motion`, `unseen`, `latent`, a head, `mask:LABEL`; with `exr` also `exposing.PASSES`."""
    degrees: float = 5.0
    """Size of the orbit and of the swing of bullet time, above 0 and below 90."""
    width: int | None = None
    """Width of the pictures in pixels; None: as the clip was fitted."""
    frames: str | None = None
    """First frame, end and step of the path as `A:B:S`; None: all of it."""
    part: str | None = None
    """`I/N`: only the I-th of N parts of these frames."""
    video: bool = False
    """Also write a video of every channel."""
    exr: bool = False
    """True for a multi-layer EXR a frame in place of PNG."""
    motion_blur: float = 0.0
    """Frames for which the shutter is open."""
    aperture: float = 0.0
    """Radius of the lens in world units; 0: everything is sharp."""
    focus: float = 1.0
    """Depth that is sharp."""
    samples: int = 16
    """Pictures that make a blurred one."""
    backend: str = "auto"
    """The raster backend, see `raster.rasterize`."""


def mask_labels(channels: Iterable[str]) -> dict[str, str]:
    """Return the channels `mask:LABEL` with their labels."""
    return {name: name.removeprefix(MASK) for name in channels if name.startswith(MASK)}
