"""Tracks and depth to 3-D curves over all supervised frames. Needs scipy."""

from dataclasses import dataclass

import numpy as np

from ..errors import F4xError
from ..geometry.camera import CameraPath
from ..parallel import in_threads


@dataclass(frozen=True)
class LiftingConfig:
    """Settings that tell reliable samples of tracks from outliers. Lengths are in world units (median scene depth = 1)."""

    search_px: int = 2
    """A track at an invalid depth pixel takes the nearest valid one at most this far away (square window)."""
    outlier_neighbours: int = 16
    """Per frame, the mean distance to so many neighbours decides whether a point is an outlier."""
    outlier_ratio: float = 5.0
    """A point is an outlier when that mean exceeds the mean of all points by so many standard deviations."""
    shaking: float = 0.15
    """A sample farther than this from the straight line between its neighbours in time is dropped."""
    drop_shaking_curves: bool = False
    """True removes the whole curve of a shaking sample, not only the sample."""
    min_samples: int = 2
    """Curves with fewer believed samples are removed (in clips of fewer frames: with fewer than the frames)."""
    min_fraction: float = 0.1
    """Curves believed in a smaller fraction of the frames are removed."""
    carriers: int = 8
    """Number of nearest seen curves that carry a curve through frames in which it was not seen."""


@dataclass(frozen=True, eq=False)
class LiftedTracks:
    """Curves in the world, defined at every frame."""

    xyz: np.ndarray
    """(F, N, 3) float32 world units; where a curve was not seen, it moves as the seen curves near it (`complete_curves`)."""
    certain: np.ndarray
    """(F, N) bool, True where the position was measured."""
    index: np.ndarray
    """(N,) int64 index of each curve among the tracks that were lifted."""

    def __len__(self) -> int:
        return len(self.index)

    def subset(self, which: np.ndarray) -> "LiftedTracks":
        """Return the curves `which` (indices or bool)."""
        return LiftedTracks(self.xyz[:, which], self.certain[:, which], self.index[which])


def lift_tracks(
    tracks: np.ndarray,
    visible: np.ndarray,
    depth: np.ndarray,
    cameras: CameraPath,
    times: np.ndarray,
    config: LiftingConfig | None = None,
) -> LiftedTracks:
    """Lift 2-D tracks to world curves and keep the believable ones.

    `tracks (F, N, 2)` pixels (NaN = unknown), `visible (F, N)` bool, `depth (F, H, W)` z in world units, which is
    known where it is finite and positive, `times (F,)` clip frames to ask `cameras` for.
    Raises F4xError when the frame counts differ.
    """
    config = config or LiftingConfig()
    counts = {"tracks": len(tracks), "visible": len(visible), "depth": len(depth), "times": len(times)}
    if len(set(counts.values())) != 1:
        listing = ", ".join(f"{name} {count}" for name, count in counts.items())
        raise F4xError(f"tracks and depth should cover the same frames, got {listing}; build the priors again")
    valid = np.isfinite(depth) & (depth > 0)
    frames, number = tracks.shape[:2]
    xyz = np.zeros((frames, number, 3), np.float64)
    certain = np.zeros((frames, number), bool)

    def lift(f: int) -> None:
        z = nearest_valid_depth(tracks[f], depth[f], valid[f], config.search_px)
        seen = visible[f] & np.isfinite(z)
        xyz[f, seen] = cameras.at(times[f]).unproject(tracks[f, seen].astype(np.float64), z[seen])
        seen[seen] = ~_outliers(xyz[f, seen], config)
        certain[f] = seen

    in_threads(lift, range(frames))
    shaking = _shaking(fill_gaps(xyz, certain, times), times, config.shaking) & certain
    certain &= ~(shaking.any(axis=0) if config.drop_shaking_curves else shaking)
    min_certain = max(min(config.min_samples, frames), int(np.ceil(config.min_fraction * frames)))
    kept = np.flatnonzero(certain.sum(axis=0) >= min_certain)
    certain = certain[:, kept]
    xyz = complete_curves(xyz[:, kept], certain, times, config.carriers)
    return LiftedTracks(xyz.astype(np.float32), certain, kept)


def nearest_valid_depth(pixels: np.ndarray, depth: np.ndarray, valid: np.ndarray, search: int) -> np.ndarray:
    """Return z `(N,)` float64 of the valid pixel centre nearest to each of `pixels (N, 2)`, NaN where there is none.

    Looks at most `search` pixels aside, never blends depths (a mean across an edge lies on no surface).
    """
    height, width = depth.shape
    steps = np.arange(-search, search + 1)
    known = np.isfinite(pixels).all(axis=1)
    places = np.where(known[:, None], pixels, np.zeros_like(pixels))
    corner = np.floor(places).astype(np.int64)  # (N, 2) col, row
    known &= (corner >= 0).all(axis=1) & (corner < [width, height]).all(axis=1)
    columns = corner[:, 0, None, None] + steps[None, None, :]  # (N, 1, S)
    rows = corner[:, 1, None, None] + steps[None, :, None]  # (N, S, 1)
    # Beyond the rim stands the rim again: it is seen nearer where it is.
    c, r = np.clip(columns, 0, width - 1), np.clip(rows, 0, height - 1)
    x, y = places.T
    squared = (columns + 0.5 - x[:, None, None]) ** 2 + (rows + 0.5 - y[:, None, None]) ** 2  # (N, S, S)
    squared = np.where(valid[r, c], squared, np.inf).reshape(len(pixels), -1)
    best = squared.argmin(axis=1)[:, None]
    found = np.isfinite(np.take_along_axis(squared, best, 1)[:, 0]) & known
    z = np.take_along_axis(depth[r, c].reshape(len(pixels), -1), best, 1)[:, 0]
    return np.where(found, z, np.nan).astype(np.float64)


def fill_gaps(xyz: np.ndarray, certain: np.ndarray, times: np.ndarray) -> np.ndarray:
    """Return `xyz (F, N, 3)` with uncertain samples on the line in time between the certain ones around them.

    Before the first and after the last certain sample its position is held; curves without any keep theirs.
    """
    count = len(times)
    frames = np.arange(count)[:, None]
    before = np.maximum.accumulate(np.where(certain, frames, -1), axis=0)  # (F, N) last certain frame so far
    after = np.minimum.accumulate(np.where(certain, frames, count)[::-1], axis=0)[::-1]  # (F, N) next one
    start = np.clip(np.where(before < 0, after, before), 0, count - 1)
    end = np.clip(np.where(after == count, before, after), 0, count - 1)
    gap = times[end] - times[start]
    fraction = np.where(gap > 0, (times[:, None] - times[start]) / np.where(gap > 0, gap, 1.0), 0.0)[..., None]
    first, last = (np.take_along_axis(xyz, which[..., None], axis=0) for which in (start, end))
    filled = (first + fraction * (last - first)).astype(xyz.dtype)
    return np.where((certain | ~certain.any(axis=0))[..., None], xyz, filled)


def complete_curves(xyz: np.ndarray, certain: np.ndarray, times: np.ndarray, carriers: int) -> np.ndarray:
    """Return `xyz (F, N, 3)` with unseen samples carried along by the `carriers` nearest curves seen at that time.

    From its last certain sample on, a curve takes the mean step (weights 1 / distance^2) of the curves nearest to it that are
    certain before and after the step; likewise backwards from its next one. Inside a gap the two are blended linearly in time,
    so both ends meet their samples. Steps that no curve was seen to make are zero; curves without any sample keep theirs.
    """
    ahead, steps_ahead = _carried(xyz, certain, carriers)
    behind, steps_behind = (part[::-1] for part in _carried(xyz[::-1], certain[::-1], carriers))
    # A side without any certain sample is infinitely far away and has no say.
    fraction = np.where(np.isinf(steps_behind), 0.0, np.where(np.isinf(steps_ahead), 1.0, np.nan))
    inside = np.isnan(fraction)
    frame = np.nonzero(inside)[0]
    start, end = frame - steps_ahead[inside].astype(int), frame + steps_behind[inside].astype(int)
    fraction[inside] = (times[frame] - times[start]) / np.maximum(times[end] - times[start], np.finfo(np.float64).tiny)
    fraction = fraction[..., None]
    filled = ahead * (1 - fraction) + behind * fraction
    return np.where((certain | ~certain.any(axis=0))[..., None], xyz, filled)


def _carried(xyz: np.ndarray, certain: np.ndarray, carriers: int) -> tuple[np.ndarray, np.ndarray]:
    """Return curves `(F, N, 3)` carried on from their last certain sample, and how many steps ago `(F, N)` that was.

    Infinitely many steps mark frames before the first certain sample, where positions mean nothing.
    """
    from scipy.spatial import cKDTree

    carried = xyz.astype(np.float64, copy=True)
    steps = np.where(certain, 0.0, np.inf)
    for f in range(1, len(xyz)):
        lost = np.flatnonzero(~certain[f] & np.isfinite(steps[f - 1]))
        steps[f, lost] = steps[f - 1, lost] + 1
        seen = np.flatnonzero(certain[f] & certain[f - 1])
        carried[f, lost] = carried[f - 1, lost]
        if len(lost) == 0 or len(seen) == 0:
            continue
        distance, near = cKDTree(xyz[f - 1, seen]).query(carried[f - 1, lost], min(carriers, len(seen)))
        distance, near = distance.reshape(len(lost), -1), near.reshape(len(lost), -1)
        weight = 1 / np.maximum(distance**2, np.finfo(np.float32).eps)
        step = (xyz[f, seen] - xyz[f - 1, seen])[near]  # (lost, K, 3)
        carried[f, lost] += (weight[..., None] * step).sum(1) / weight.sum(1, keepdims=True)
    return carried, steps


def _outliers(points: np.ndarray, config: LiftingConfig) -> np.ndarray:
    """Return outliers (n,) bool as in Open3D: mean neighbour distance above mean + ratio * std of all such means."""
    from scipy.spatial import cKDTree

    if len(points) <= config.outlier_neighbours:
        return np.zeros(len(points), bool)
    distances = cKDTree(points).query(points, config.outlier_neighbours + 1)[0][:, 1:].mean(axis=1)
    return distances > distances.mean() + config.outlier_ratio * distances.std() + np.finfo(np.float32).eps


def _shaking(xyz: np.ndarray, times: np.ndarray, threshold: float) -> np.ndarray:
    """Return (F, N) bool: too far from the line between both neighbours in time; at the ends from the only one."""
    shaking = np.zeros(xyz.shape[:2], bool)
    if len(times) < 2:
        return shaking
    u = ((times[1:-1] - times[:-2]) / (times[2:] - times[:-2]))[:, None, None]
    expected = xyz[:-2] + u * (xyz[2:] - xyz[:-2])
    shaking[1:-1] = np.linalg.norm(xyz[1:-1] - expected, axis=-1) >= threshold
    shaking[0] = np.linalg.norm(xyz[0] - xyz[1], axis=1) >= threshold
    shaking[-1] = np.linalg.norm(xyz[-1] - xyz[-2], axis=1) >= threshold
    return shaking
