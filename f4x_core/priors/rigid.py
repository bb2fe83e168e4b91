"""Tells the flow that the cameras explain from that of movers, by one rigid world behind all frames.

Near things that stand still leave the homography of a far wall behind as movers do, and two pictures cannot tell the two apart
(`motion`). A moving object rarely fills the border of the picture, so a mask that does is in doubt: then the cameras of
all tracks are compared with those of what the mask leaves (`cameras`). Once the cameras are known, one inverse depth per pixel
that explains its flow to all other frames tells that it stands still (`second_look`).
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy import ndimage

from ..geometry.camera import CameraPath
from ..parallel import in_threads
from .bundle import Bundle, Observations, rays, triangulate
from .flow import consistent_at, length, pixel_grid
from .motion import DOUBT, PARALLAX_PIXELS, REFERENCE_WIDTH, STEP, border_of, both_ways, score_of_residuals
from .points import TRACK_OUTLIER_PX

MIN_FRAMES = 8
"""Frames in which a track must be seen: over few, whatever moves evenly is explained by some point."""
MAX_MOVING_BORDER = 0.15
"""Largest fraction of the pictures' border that a mask covers without doubt: movers cover 0 to 11 % of it in the twelve real clips;
floors and posts that were taken to move covered 18 to 47 % in rooms."""
CELL = 16
"""Side in pixels of the squares that count alike: tracks are denser on what was taken to move."""
NEAREST, ROUNDS = 100.0, 6
"""Largest inverse depth (1 at the median depth) of a point, and rounds of the robust fit of it."""
LENS = 5.0
"""Inverse depth from which a thing seems to stand in the lens: still nearer to the camera some depth explains whatever runs along
the camera's own way (blackswan's swan: 6 to 8), yet outdoors a wall that the camera walks along is as near (parkour's: 9 to 44)."""
MAX_BEHIND = 1.0
"""Most pixels of parallax (at a width of `REFERENCE_WIDTH`) by which a static pixel may seem behind those around it."""
JUMP, GOES_ON, BESIDE = 8.0, 0.8, 2
"""Pixels of parallax up to which what lies so many samples beside a thing in the lens continues it, and the fraction of its
outline, of what is known there, that has to. Chosen on blackswan, a dark copy of it, parkour and breakdance: the swan has .3 to .6,
the larger near walls and floors .9 to 1."""
OWN_MOTION = 0.35
"""Score of flow beyond the cameras' from which a pixel moves by itself. Chosen on camel, dog, car-shadow, blackswan, parkour and
breakdance and seven rooms of cards: at most 1.5 % of what truly moves is lost (camel); from .4 on 4 %."""
AROUND, FAR_WEIGHT, MIN_KNOWN = 24, 0.01, 1e-6
"""Pixels around the mask whose depth is asked, the weight of those from afar beside them, and the least weight that counts."""
REACH = 2.0
"""Standard deviations of their inverse depth over which what is around reaches. Chosen on camel, blackswan, a turning disc and
furnished rooms 0 to 8: with 0 the wall between a post and the disc was taken to move; without an end a tenth of the camel went."""
MIN_UNIT = 0.4
"""Width of the picture in `REFERENCE_WIDTH` below which lengths no longer shrink with it: flow is no nearer in pixels there."""
MIN_AHEAD = 1e-3
"""Depth in another frame, over that in its own, below which a point counts as so near: nothing is divided by 0."""


def fills_border(mask: np.ndarray) -> bool:
    """Return True if `mask (F,H,W)` bool covers more of the border of the pictures than moving objects do."""
    return bool(mask[:, border_of(*mask.shape[1:])].mean() > MAX_MOVING_BORDER)


def explained_fraction(bundle: Bundle, tracks: np.ndarray, visible: np.ndarray) -> float:
    """Return the fraction of the picture whose tracks are one point in space each, or one direction where all cameras are at one
    place.

    `tracks (F,N,2)` pixels, `visible (F,N)`. Every square of `CELL` pixels with tracks counts alike in every frame.
    """
    seen, error = _as_points(bundle, tracks, visible)
    if not len(error):
        return 0.0
    explained = error < TRACK_OUTLIER_PX
    column, row = np.floor(seen.uv / CELL).astype(int).T
    _, cell = np.unique(np.stack([seen.frame, row, column]), axis=1, return_inverse=True)
    return float((np.bincount(cell, explained[seen.point]) / np.bincount(cell)).mean())


def track_error(bundle: Bundle, tracks: np.ndarray, visible: np.ndarray) -> float:
    """Return the median over the tracks of their distance in pixels (rms) from one point in space each; inf without tracks.

    Shapes as in `explained_fraction`.
    """
    error = _as_points(bundle, tracks, visible)[1]
    return float(np.median(error)) if len(error) else np.inf


def _as_points(bundle: Bundle, tracks: np.ndarray, visible: np.ndarray) -> tuple[Observations, np.ndarray]:
    """Return the sightings of the n tracks that are seen long enough, and the distance of each from one point in space, (n,) pixels
    (rms)."""
    kept = np.flatnonzero(visible.sum(0) >= min(MIN_FRAMES, len(tracks)))
    frame, point = np.nonzero(visible[:, kept])
    uv = tracks[:, kept][frame, point].astype(np.float64)
    seen = Observations(frame, point, uv, np.ones(len(frame)))
    if np.ptp(bundle.center, axis=0).any():
        points, _ = triangulate(bundle, seen, len(kept))
    else:
        points = np.zeros((len(kept), 3))
        np.add.at(points, point, rays(bundle, seen))
        points += bundle.center[0]
    squares = replace(bundle, points=points).errors(seen) ** 2
    return seen, np.sqrt(np.bincount(point, squares, len(kept)) / np.bincount(point, minlength=len(kept)))


def flow_beyond_cameras(
    cameras: CameraPath, mask: np.ndarray, flows: dict[int, np.ndarray], gaps: tuple[int, ...]
) -> np.ndarray:
    """Return (F,h,w) float32 in 0..1 on every `STEP`-th pixel: how surely the flow there is not the cameras' own; 1 away from
    the mask.

    `mask (F,H,W)` bool; `flows`: signed gap -> (F,H,W,2) pixels, of which `gaps` count, both ways. One inverse depth per pixel
    has to explain its flow over all gaps (as in plane + parallax, Irani & Anandan 1996, with the cameras known).

    Along the way of the camera every even motion is that of some depth. So it has to be one at which a thing can stand: not
    behind all that is around it, for what a camera follows looks far away, but is in front; and in the lens only where the rest
    of the world goes on into it (`_in_the_lens`). A mask that fills the border may hold the background itself, which is behind
    what is around it.
    """
    frames, height, width = mask.shape
    grid = pixel_grid(height, width)[STEP // 2 :: STEP, STEP // 2 :: STEP]
    near, around = (
        ndimage.maximum_filter(mask, (1, reach, reach))[:, STEP // 2 :: STEP, STEP // 2 :: STEP]
        for reach in (2 * STEP + 1, 2 * AROUND + 1)  # what lies between samples is interpolated
    )
    unit, doubted = max(max(height, width) / REFERENCE_WIDTH, MIN_UNIT), fills_border(mask)
    found = np.ones(near.shape, np.float32)  # of flow that is not the cameras'
    rho, sway = np.zeros((2, *near.shape), np.float32)

    def score(t: int) -> None:
        here = grid[around[t]]
        there = [gap for gap in both_ways(gaps, frames) if 0 <= t + gap < frames]
        if not (len(here) and there):
            return
        flow = np.stack([flows[gap][t, STEP // 2 :: STEP, STEP // 2 :: STEP][around[t]] for gap in there])
        back = [consistent_at(here, one, flows[-gap][t + gap]) for one, gap in zip(flow, there, strict=True)]
        trust = np.where(back, 1.0, DOUBT)
        others = np.array([t + gap for gap in there])
        fit = _fit_depth(cameras, _Matches(t, others, here, here + flow.astype(np.float64), trust), unit)
        by_itself = score_of_residuals(fit.left[None], trust[None], unit)[0]
        apart = _apart_from_the_rest(fit, around[t], near[t], by_itself) / unit
        found[t][around[t]] = np.where(not doubted and apart > MAX_BEHIND, 1, by_itself)
        rho[t][around[t]], sway[t][around[t]] = fit.rho, fit.sway / unit

    in_threads(score, range(frames))
    still = around & (found < OWN_MOTION)
    found[_in_the_lens(near & still, still, rho, sway)] = 1
    found[~near] = 1
    return found


def _in_the_lens(asked: np.ndarray, still: np.ndarray, rho: np.ndarray, sway: np.ndarray) -> np.ndarray:
    """Return the pixels (F,h,w) bool of `asked` that are too near to stand there and end on all sides.

    `rho`: inverse depth; `sway`: pixels that 1 of it shifts by at most. Whatever moves evenly with a camera seems to be some still
    thing close before it, alone in the air. A wall that a camera walks along is as near, and the ground before it goes on.

    `still (F,h,w)` bool: flow is the cameras'.
    """
    label, count = ndimage.label(asked & (rho >= LENS), np.ones((3, 3, 3)))
    known, goes_on = np.zeros((2, count + 1))
    for axis in (1, 2):
        for before, behind in ((np.s_[:-BESIDE], np.s_[BESIDE:]), (np.s_[BESIDE:], np.s_[:-BESIDE])):
            here, there = ((*[np.s_[:]] * axis, part) for part in (before, behind))
            edge = (label[here] > 0) & (label[there] != label[here]) & still[there]
            jump = (np.abs(rho[here] - rho[there]) * sway[here])[edge]
            known += np.bincount(label[here][edge], minlength=count + 1)
            goes_on += np.bincount(label[here][edge], jump < JUMP, minlength=count + 1)
    alone = goes_on < GOES_ON * np.maximum(known, 1)
    alone[0] = False
    return alone[label]


@dataclass(frozen=True)
class _DepthFit:
    """The inverse depth of P pixels that explains best where they lie in K other frames."""

    rho: np.ndarray
    """(P,) inverse depth."""
    left: np.ndarray
    """(K,P) pixels that it leaves unexplained."""
    sway: np.ndarray
    """(P,) most pixels by which they would lie elsewhere for 1 more of inverse depth."""


def _apart_from_the_rest(fit: _DepthFit, asked: np.ndarray, near: np.ndarray, by_itself: np.ndarray) -> np.ndarray:
    """Return (P,) pixels of parallax by which the pixels `asked (h,w)` lie behind all that stands still around those that are
    `near (h,w)` the mask, less than 0 before it; `by_itself (P,)` is the score of their flow. What is around lies infinitely
    far away where nothing is known of it.

    What is around reaches from its mean `REACH` standard deviations to either side: a wall between two posts is not behind it.
    """
    stands, rho = np.zeros(asked.shape), np.zeros(asked.shape)
    stands[asked] = ~near[asked] * (1 - by_itself)
    rho[asked] = fit.rho

    def around(values: np.ndarray) -> np.ndarray:
        wide = ((1.0, AROUND / STEP / 2), (FAR_WEIGHT, 4 * AROUND / STEP))
        return sum(share * ndimage.gaussian_filter(values, sigma) for share, sigma in wide)[asked]

    weight = around(stands)
    known, weight = weight > MIN_KNOWN, np.maximum(weight, MIN_KNOWN)
    mean = around(stands * rho) / weight
    reach = REACH * np.sqrt(np.maximum(around(stands * rho**2) / weight - mean**2, 0))
    apart = np.where(known, mean, 0) - fit.rho
    return np.sign(apart) * np.maximum(np.abs(apart) - np.where(known, reach, 0), 0) * fit.sway


@dataclass(frozen=True)
class _Matches:
    """Pixels of one frame and where flow takes them in others."""

    t: int
    """Index of the frame."""
    others: np.ndarray
    """(K,) indices of the other frames."""
    here: np.ndarray
    """(P,2) pixels of frame t."""
    there: np.ndarray
    """(K,P,2) the same in the others."""
    trust: np.ndarray
    """(K,P) weights."""


def _fit_depth(cameras: CameraPath, matches: _Matches, unit: float) -> _DepthFit:
    """Return the inverse depth of pixels that explains best where they lie in other frames; `unit` pixels count as 1.

    A pixel at inverse depth rho lands at a + rho b in homogeneous pixels: times its third component that is linear in rho.
    """
    t, others, here, there, trust = matches.t, matches.others, matches.here, matches.there, matches.trust
    relative = cameras.world_to_camera[others] @ np.linalg.inv(cameras.world_to_camera[t])
    lens = cameras.intrinsics[others]
    rays_here = np.column_stack([here, np.ones(len(here))]) @ np.linalg.inv(cameras.intrinsics[t]).T
    a = np.einsum("kij,pj->kpi", lens @ relative[:, :3, :3], rays_here)
    b = np.einsum("kij,kj->ki", lens, relative[:, :3, 3])[:, None]
    fixed, along = a[..., 2:] * there - a[..., :2], b[..., 2:] * there - b[..., :2]  # fixed + rho along = 0
    rho, weight = np.ones(len(here)), trust
    ahead, left = np.maximum(a[..., 2] + rho * b[..., 2], MIN_AHEAD), np.zeros(trust.shape)
    for _ in range(ROUNDS):
        scaled = weight / ahead**2
        rho = -(scaled * (fixed * along).sum(-1)).sum(0) / np.maximum((scaled * (along**2).sum(-1)).sum(0), 1e-12)
        rho = np.clip(rho, 0.0, NEAREST)
        ahead = np.maximum(a[..., 2] + rho * b[..., 2], MIN_AHEAD)
        left = length(fixed + rho[:, None] * along) / ahead
        weight = trust / (1 + (left / (PARALLAX_PIXELS * unit)) ** 2)
    return _DepthFit(rho, left, (length(along) / ahead).max(0))
