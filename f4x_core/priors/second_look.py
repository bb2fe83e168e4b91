"""A second look at moving objects, once the cameras are known: near things that a walking camera passes stand still.

Pairs of pictures cannot tell strong parallax from motion (`motion`). Long tracks can: one that a single point in space explains
in all its frames, seen from angles that differ by many times its error, stands still, whatever its flow looked like. Tracks
that move by themselves miss their best point by several pixels on every real clip tried. Where no track lasts, flow can: the part
that one inverse depth per pixel explains over all gaps is the camera's motion (`rigid`).
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from scipy import ndimage

from ..parallel import in_threads
from .config import PriorsConfig
from .flow import long_flows
from .motion import STATIC_TRACK, VOTE_SIGMA, densify, enlarge, without_specks
from .moving_people import moving_people, walking_people
from .points import TRACK_OUTLIER_PX, fit_points
from .rigid import FAR_WEIGHT, LENS, MIN_FRAMES, OWN_MOTION, fills_border, flow_beyond_cameras

if TYPE_CHECKING:
    from ..clip import Clip
    from ..progress import Progress
    from .folder import Priors

MOST, ROUNDS = 0.75, 8
"""Fraction of a track's sightings that tell its error, those that fit best, and the rounds in which the others come to count
less: a track slips in a few frames where something passes before it, points that move by themselves miss it in nearly all."""
MAX_ERROR = 0.1
"""Largest error of a static point as a fraction of what its track shifts by beyond the camera's turn."""
MAX_UNUSUAL, MIN_LIMIT, BACKGROUND = 3.0, 0.6, 1000
"""Largest error of a static point over the median of the background's, of which so many are asked, and the pixels that pass in any
case: a static point explains an even motion past a camera within a pixel (.7 to .8 in a room of cards). Chosen on the even ones of
28 furnished rooms: of the static tracks .56 pass, of those on movers .16 (.51 and .16 by the error of all sightings),
of the odd ones .67 and .02 (.60 and .11)."""
IN_LENS = 1.75
"""The same where a point would stand in the lens (`rigid.LENS`), of all sightings: there most of what a camera follows
is met by chance. By three quarters of them half of blackswan's swan stood still. Its tracks miss their points by 2.1 times the
background's error or more (13 times; 2.1 to 8 where the clip is dark and noisy), half of those on parkour's near walls by less
than 1.8."""
MIN_RELEASED, MIN_RELEASED_MASK = 0.05, 0.02
"""Smallest fraction of the moving tracks that must stand still before they count, and of the mask before it is changed."""
FAR_SIGMA = 16.0
"""Gaussian (pixels) by which tracks vote, with `FAR_WEIGHT`, where none is near."""
STANDING_VOTE = 2.0
"""Votes of a track that stands against one that moves: there are four times as many of these in a place, seeded at half the
distance."""
MIN_VOTE = 0.1 / (2 * np.pi * VOTE_SIGMA**2)
"""Fewest votes that join a pixel to moving objects: a tenth of one track at its own place."""
JOINED_MOTION = 0.75
"""Motion score of what joins the mask later: it rests for a while, or flow does not tell its outline."""


def release_static(clip: Clip, priors: Priors, config: PriorsConfig, progress: Progress) -> float:
    """Take static pixels out of `mask`, `motion`, `tracks_motion`, add walking people, and make the tracks on what is left anew.

    Returns the fraction of the mask that was taken out. A mask that was given stays.
    """
    mask, tracks, visible = priors.mask, priors.tracks, priors.tracks_visible
    if mask is None or tracks is None or visible is None or mask_is_given(priors):
        return 0.0
    assert priors.tracks_motion is not None and priors.motion is not None and priors.cameras is not None
    asked = np.flatnonzero((priors.tracks_motion > STATIC_TRACK) & (visible.sum(0) >= min(MIN_FRAMES, len(mask))))
    stands = _stands_still(priors, asked)
    if stands.sum() <= MIN_RELEASED * max(len(asked), 1):
        stands[:] = False
    flows = long_flows(clip, priors, config, progress)
    beyond = flow_beyond_cameras(priors.cameras, mask, flows, config.motion.gaps)
    left = mask & (np.stack(in_threads(lambda one: enlarge(one, *mask.shape[1:]), beyond)) > OWN_MOTION)
    if stands.any():
        left &= ~_released(mask, tracks[:, asked], visible[:, asked], stands)
    left &= np.stack(in_threads(without_specks, left))
    left |= moving_people(mask, priors) | walking_people(priors)
    released, added = mask & ~left, left & ~mask
    if max(released.sum(), added.sum()) <= MIN_RELEASED_MASK * mask.sum():
        return 0.0
    fraction = float(released.sum() / max(mask.sum(), 1))
    revise_mask(
        priors, left, np.where(released, 0, np.where(added, np.maximum(priors.motion, JOINED_MOTION), priors.motion))
    )
    if not left.any():
        priors.warn("Nothing in this clip moves by itself; if something should, give a mask.")
    densify(clip, priors, config, flows, progress, known=asked[stands])
    return fraction


def join_resting(clip: Clip, priors: Priors, config: PriorsConfig, progress: Progress) -> float:
    """Add to `mask` and `motion` what rests for a while and moves later, by its tracks, and make the tracks on moving objects anew.

    Returns by what fraction the mask grew. A mask that was given stays.
    """
    mask, tracks, visible = priors.mask, priors.tracks, priors.tracks_visible
    if mask is None or tracks is None or visible is None or mask_is_given(priors):
        return 0.0
    assert priors.tracks_motion is not None and priors.motion is not None and priors.cameras is not None
    static = np.flatnonzero((priors.tracks_motion <= STATIC_TRACK) & (visible.sum(0) >= min(MIN_FRAMES, len(mask))))
    points = fit_points(priors.cameras, tracks[:, static], visible[:, static], ROUNDS)
    vote = np.where(priors.tracks_motion > STATIC_TRACK, 1.0, 0.0)
    vote[static[points.rms_of_nearest(MOST) < TRACK_OUTLIER_PX]] = -STANDING_VOTE
    voted = vote != 0
    votes = _votes(tracks[:, voted], visible[:, voted], vote[voted], mask.shape[1:])
    joined = np.stack(in_threads(lambda frame: _with_resting(mask[frame], votes[frame]), range(len(mask))))
    added = joined & ~mask
    if not added.any():
        return 0.0
    fraction = float(added.sum() / mask.sum())
    revise_mask(priors, joined, np.where(added, np.maximum(priors.motion, JOINED_MOTION), priors.motion))
    densify(clip, priors, config, long_flows(clip, priors, config, progress), progress)
    return fraction


def revise_mask(priors: Priors, mask: np.ndarray, motion: np.ndarray) -> None:
    """Put a `mask (F,H,W)` bool and its `motion (F,H,W)` in place of those in `priors`, and count anew how much moves."""
    priors.mask, priors.motion = mask, motion.astype(np.float16)
    priors.statistics.setdefault("motion", {}).update(share=float(mask.mean()), moving=bool(mask.any()))


def _with_resting(mask: np.ndarray, votes: np.ndarray) -> np.ndarray:
    """Return (H,W) bool: the `mask (H,W)` with pixels whose `votes (H,W)` are for motion, and holes without a vote against it."""
    joined = without_specks(mask | (votes > MIN_VOTE))
    holes, count = ndimage.label(ndimage.binary_fill_holes(joined) & ~joined)
    if not count:
        return joined
    against = np.bincount(holes.ravel(), np.minimum(votes, 0).ravel(), count + 1) < 0
    against[0] = True  # everything else
    return joined | ~against[holes]


def mask_in_doubt(priors: Priors) -> bool:
    """Return True if what is taken to move fills the pictures' border, and not because the user says so."""
    return priors.mask is not None and not mask_is_given(priors) and fills_border(priors.mask)


def mask_is_given(priors: Priors) -> bool:
    """Return True where the user gave the mask."""
    return priors.provenance.get("mask", {}).get("provider") in ("user", "files")


def _stands_still(priors: Priors, asked: np.ndarray) -> np.ndarray:
    """Return (n,) bool: which of the tracks `asked (n,)` are one point in space, as nearly as the background's are."""
    assert priors.cameras is not None and priors.tracks is not None and priors.tracks_visible is not None
    assert priors.tracks_motion is not None
    rest = np.flatnonzero((priors.tracks_motion <= STATIC_TRACK) & (priors.tracks_visible.sum(0) >= MIN_FRAMES))
    rest = rest[:: len(rest) // BACKGROUND + 1]
    points, background = (
        fit_points(priors.cameras, priors.tracks[:, some], priors.tracks_visible[:, some], ROUNDS)
        for some in (asked, rest)
    )
    usual = float(np.median(background.rms_of_nearest(MOST))) if len(rest) else TRACK_OUTLIER_PX
    shift = points.spread * float(priors.cameras.intrinsics[:, 0, 0].mean())
    in_lens = points.inverse_depth >= LENS
    error = np.where(in_lens, points.rms, points.rms_of_nearest(MOST))
    limit = np.clip(np.where(in_lens, IN_LENS, MAX_UNUSUAL) * usual, MIN_LIMIT, TRACK_OUTLIER_PX)
    return (error < limit) & (error < MAX_ERROR * shift)


def _released(mask: np.ndarray, tracks: np.ndarray, visible: np.ndarray, stands: np.ndarray) -> np.ndarray:
    """Return (F,H,W) bool: pixels of `mask (F,H,W)` around which most tracks (F,n,2) stand still (n,)."""
    return (_votes(tracks, visible, np.where(stands, 1.0, -1.0), mask.shape[1:]) > 0) & mask


def _votes(tracks: np.ndarray, visible: np.ndarray, vote: np.ndarray, size: tuple[int, ...]) -> np.ndarray:
    """Return (F,H,W) float32: what the tracks (F,n,2) around each pixel of pictures of `size (H, W)` vote, each its `vote (n,)`."""
    import cv2

    height, width = size

    def around(t: int) -> np.ndarray:
        column, row = np.clip(np.floor(tracks[t, visible[t]]), 0, (width - 1, height - 1)).astype(int).T
        votes = np.zeros((height, width), np.float32)
        np.add.at(votes, (row, column), vote[visible[t]])
        near, far = (cv2.GaussianBlur(votes, (0, 0), sigma) for sigma in (VOTE_SIGMA, FAR_SIGMA))
        return near + FAR_WEIGHT * far

    return np.stack(in_threads(around, range(len(tracks))))
