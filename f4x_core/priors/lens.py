"""Measures how much a lens bends straight lines. Cameras of a scene do not bend any, so that a bent clip is reported.

A pixel at x from the middle of the picture, in halves of its longer side, is where a straight lens would show it at
`x (1 + bend |x|^2)` (one term of Brown, "Close-Range Camera Calibration", 1971). Action cameras have about .2. A straight lens
makes up for that by its focal length: a filmed clip that was bent by .18 got a focal length of 5 picture widths in place of 1.5,
and a depth that agreed with that of the unbent one by a rank correlation of .66.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from ..geometry.arrays import evenly_spaced
from ..parallel import in_threads
from .bundle import Bundle, BundleConfig, Observations, adjust, triangulate
from .point_tracks import PointTracks
from .sfm import on_sphere, sightings, with_points_ahead

FRAMES, POINTS = 12, 300
"""Frames, evenly over the clip, and points that tell it."""
STEP, FARTHEST = 0.05, 0.4
"""Bends are tried in such steps as long as the error falls, up to the farthest: no rectilinear film is bent more."""
MIN_BEND, MIN_SAVED, SURE = 0.03, 0.25, 3.0
"""Smallest bend of a lens that is reported, fraction of the error that it must take away, and standard deviations of the
coefficient by which it must exceed the smallest. Chosen on six real clips of straight lenses, 240 pixels wide, whole and cut to 40
frames: bends save up to .13 of the error there. Deviations alone do not suffice: tracks on a moving shadow err together, which
made a bend of ten deviations on car-shadow. On six other clips bends save up to .05."""


@dataclass(frozen=True)
class Bend:
    """Distortion of a lens."""

    bend: float
    """See above; positive: barrel, as of wide lenses, negative: pincushion."""
    saved: float
    """Fraction of the error of a straight lens that it takes away."""
    deviation: float
    """Standard deviation of `bend` in the fit; large where focal length and parallax make up for a bend."""

    @property
    def certain(self) -> bool:
        """Return True if it is worth telling."""
        return abs(self.bend) - SURE * self.deviation >= MIN_BEND and self.saved >= MIN_SAVED

    def advice(self, width: int, height: int) -> str:
        """Return a sentence that says what to do with a film of this shape."""
        k1, k2 = self.ffmpeg(width, height)
        shape = "barrel" if self.bend > 0 else "pincushion"
        return (
            f"The lens bends straight lines ({shape}, {abs(self.bend):.0%} at the picture's edge), which no camera here does: depth"
            " and focal length are off. Take that out of the film and fit it again: "
            f"ffmpeg -i FILM -vf lenscorrection=k1={k1:.3f}:k2={k2:.3f}:i=bilinear STRAIGHT.mp4"
        )

    def ffmpeg(self, width: int, height: int) -> tuple[float, float]:
        """Return k1, k2 of FFmpeg's `lenscorrection`: its pixel at r (1 = half a diagonal) comes from `r (1 + k1 r^2 + k2 r^4)`."""
        half = float(np.hypot(width, height)) / max(width, height)
        bent = np.linspace(0.05, half, 50)
        straight = bent * (1 + self.bend * bent**2)
        inside = straight <= half
        r, source = straight[inside] / half, bent[inside] / half
        k1, k2 = np.linalg.lstsq(np.stack([r**3, r**5], 1), source - r, rcond=None)[0]
        return float(k1), float(k2)


def measure(bundle: Bundle, tracks: PointTracks, config: BundleConfig) -> Bend | None:
    """Return the bend that explains the static of `tracks` best, from the cameras found with a straight lens; None with too few."""
    frames = evenly_spaced(len(tracks), FRAMES)
    sighted = sightings(tracks.of_frames(frames), POINTS)
    if not len(sighted.tracks):
        return None
    cameras = replace(bundle.of_frames(frames), points=np.zeros((len(sighted.tracks), 3)))
    usual = replace(cameras, focal=config.expected_focal, zoom=None) if config.expected_focal else cameras
    errors: dict[int, float] = {}

    def error(step: int) -> float:
        if step not in errors:
            # The focal length that makes up for a bend is a bad start for another bend.
            starts = [cameras, usual] if config.refine_focal else [cameras]
            errors[step] = min(in_threads(lambda start: _error(start, sighted.seen, step * STEP, config), starts))
        return errors[step]

    way = min((-1, 1), key=error)
    best = 0
    while error(best + way) < error(best) and abs(best + way) * STEP < FARTHEST:
        best += way
    below, here, above = error(best - 1), error(best), error(best + 1)
    curve = below - 2 * here + above
    saved = 1 - here / max(error(0), 1e-12)
    if curve <= 0:
        return Bend(STEP * best, saved, float("inf"))
    # Sightings of a point err together, so that there are as many independent ones as points.
    deviation = STEP * float(np.sqrt(2 * here / (len(sighted.tracks) * curve)))
    offset = float(np.clip((below - above) / (2 * curve), -0.5, 0.5))
    return Bend(STEP * (best + offset), saved, deviation)


def straightened(uv: np.ndarray, principal: np.ndarray, bend: float) -> np.ndarray:
    """Return the pixels `uv (n,2)` as a straight lens shows them; `principal (2,)` is the middle of the picture."""
    offset = (uv - principal) / principal.max()
    return principal + principal.max() * offset * (1 + bend * (offset**2).sum(1, keepdims=True))


def _error(start: Bundle, seen: Observations, bend: float, config: BundleConfig) -> float:
    """Return the mean robust error of straightened tracks under adjusted cameras; log of squared pixels of the bent picture."""
    straight = replace(seen, uv=straightened(seen.uv, start.principal, bend))
    bundle = on_sphere(start, straight)
    if config.refine_centers:
        points, _ = triangulate(start, straight, len(start.points))
        points = np.where(np.isfinite(points), points, bundle.points)
        # A point behind a camera stays there and costs more than any bend: the lens with the fewest such points would win.
        bundle = with_points_ahead(replace(start, points=points), straight)
    bundle = adjust(bundle, straight, config)
    radius = (((seen.uv - start.principal) / start.principal.max()) ** 2).sum(1)
    missed = bundle.errors(straight) / np.maximum(1 + 2 * bend * radius, 0.1)
    return float(np.log1p(np.minimum(missed, 50.0) ** 2).mean())
