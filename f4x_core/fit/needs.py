"""Model only what the clip needs: what was chosen, by which evidence, and what it saved."""

from dataclasses import asdict, dataclass

import numpy as np

from ..clip import Clip
from ..geometry import spherical_harmonics
from ..geometry.camera import CameraPath
from ..priors import Priors

# A higher SH degree must explain the colours of left-out frames this much better (dB) to be worth its coefficients. Low,
# because the evidence is one-sided: a wall that does not shine shows 2.3 dB where pictures are small and textures fine (3.8
# where it shines), dog 0.45 and camel 1.05; a higher bar would take from real clips before it told the toy walls apart.
SH_GAIN_DB = 0.25
# Tracks and samples per track that make the colour evidence trustworthy.
SH_TRACKS, SH_SAMPLES = 1500, 12
# Ridge that keeps the fit of view-dependent colour sane where all view directions are alike.
SH_RIDGE = 1e-2


@dataclass(frozen=True)
class Need:
    """One row of the needs table."""

    what: str
    """The thing that could have been modelled."""
    chosen: str
    """How much of it is modelled."""
    evidence: str
    """The measurement that decided."""
    saved: str
    """What a scene that models everything would have spent in addition."""

    def row(self) -> dict[str, str]:
        """The row as plain values, for the scene file."""
        return asdict(self)


def moving_share(priors: Priors) -> float:
    """Share of all pixels that the mask calls moving."""
    return float(np.mean(priors.mask)) if priors.mask is not None else 0.0


def sh_degree(clip: Clip, priors: Priors, most: int) -> tuple[int, Need]:
    """The lowest SH degree whose successor does not predict left-out colours of static tracks better by `SH_GAIN_DB`.

    For each static track, colours of every other visible frame are fitted by spherical harmonics of the view direction
    (ridge least squares) and the frames between are predicted; degree 0 is the mean colour.
    """
    colours, directions, tracks = _track_colours(clip, priors)
    full = f"degree {most}: {(most + 1) ** 2 - 1} more coefficients per Gaussian and colour"
    if tracks < 16 or most == 0:
        return 0, Need(
            "view-dependent colour", "degree 0", f"only {tracks} static tracks are long enough to tell", full
        )
    errors = [_prediction_error(colours, directions, degree) for degree in range(most + 1)]
    gains = [10 * np.log10(errors[0] / max(error, 1e-12)) for error in errors]
    chosen = 0
    while chosen < most and gains[chosen + 1] - gains[chosen] > SH_GAIN_DB:
        chosen += 1
    evidence = ", ".join(f"degree {d}: {gain:+.2f} dB" for d, gain in enumerate(gains) if d)
    evidence += f" on left-out colours of {tracks} static tracks"
    saved = f"{(most + 1) ** 2 - (chosen + 1) ** 2} of {(most + 1) ** 2} coefficients per Gaussian and colour"
    return chosen, Need("view-dependent colour", f"degree {chosen}", evidence, saved)


def _track_colours(clip: Clip, priors: Priors) -> tuple[np.ndarray, np.ndarray, int]:
    """Colours (n,SH_SAMPLES,3) in [0,1] and unit view directions (n,SH_SAMPLES,3) along n static tracks."""
    empty = np.zeros((0, SH_SAMPLES, 3))
    if priors.tracks is None or priors.tracks_visible is None or priors.depth is None or priors.cameras is None:
        return empty, empty, 0
    motion = priors.tracks_motion if priors.tracks_motion is not None else np.zeros(priors.tracks.shape[1])
    long_enough = (priors.tracks_visible.sum(0) >= SH_SAMPLES) & (motion < 0.3)
    chosen = np.flatnonzero(long_enough)[:: max(1, int(long_enough.sum()) // SH_TRACKS)]
    if len(chosen) == 0:
        return empty, empty, 0
    colours, directions = np.zeros((2, len(chosen), SH_SAMPLES, 3))
    for n, track in enumerate(chosen):
        seen = np.flatnonzero(priors.tracks_visible[:, track])
        frames = seen[np.linspace(0, len(seen) - 1, SH_SAMPLES).round().astype(int)]
        point = _track_point(priors, priors.cameras, track, frames)
        for k, frame in enumerate(frames):
            column, row = np.floor(priors.tracks[frame, track]).astype(int)
            row, column = min(max(row, 0), priors.height - 1), min(max(column, 0), priors.width - 1)
            colours[n, k] = clip.frames[priors.frames[frame], row, column] / 255
            directions[n, k] = point - priors.cameras[int(frame)].center
    directions /= np.maximum(np.linalg.norm(directions, axis=-1, keepdims=True), 1e-9)
    known = np.isfinite(directions).all((1, 2))
    return colours[known], directions[known], int(known.sum())


def _track_point(priors: Priors, cameras: CameraPath, track: int, frames: np.ndarray) -> np.ndarray:
    """Median world position (3,) of a track over `frames`, by its depth there; NaN where depth is unknown."""
    points = []
    for frame in frames:
        pixel = priors.tracks[frame, track]  # type: ignore[index]
        column, row = np.clip(np.floor(pixel).astype(int), 0, [priors.width - 1, priors.height - 1])
        points.append(cameras[int(frame)].unproject(pixel.astype(np.float64), priors.depth[frame, row, column]))  # type: ignore[index]
    return np.nanmedian(np.array(points), axis=0)


def _prediction_error(colours: np.ndarray, directions: np.ndarray, degree: int) -> float:
    """Mean squared error of odd samples predicted from even ones by SH of `degree`."""
    basis = spherical_harmonics.basis(directions, degree)  # (n,samples,S)
    basis = np.concatenate([basis[..., :1], basis[..., 1:] - basis[:, ::2, 1:].mean(1, keepdims=True)], -1)
    train, test = basis[:, ::2], basis[:, 1::2]
    ridge = np.diag([1e-9] + [SH_RIDGE] * (basis.shape[-1] - 1))
    normal = train.transpose(0, 2, 1) @ train + ridge
    coefficients = np.linalg.solve(normal, train.transpose(0, 2, 1) @ colours[:, ::2])
    return float(np.mean((test @ coefficients - colours[:, 1::2]) ** 2))
