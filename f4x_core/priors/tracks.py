"""Long point tracks from chained flows over several gaps (after MFT, Neoral et al. 2024), re-linked over occlusions."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import repeat
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from ..geometry.arrays import GOLDEN_RATIO
from ..parallel import in_threads
from ..progress import Progress, silent
from .config import PriorsConfig, TracksConfig
from .flow import grey, inside, length, long_flows, sample, scratch_array

if TYPE_CHECKING:
    from ..clip import Clip
    from .folder import Priors

RETURN_PIXELS, RETURN_FRACTION = 1.0, 0.05
"""A step of flow is accepted when going there and back ends within max(1 px, 5 % of the step) of the start."""
OBJECT_SIGMA = 1.5
"""Gaussian (pixels) that carries an object's flow over its silhouette, where the raw flow mixes with the background."""
MAX_SLIP = 12.0
"""Pixels by which a point slips off its object; where the mask ends farther away, it has a hole, and the point stays where flow
put it. Points pulled over a hole are lost: of hand-set points on a pillow in a person's hands, whose mask flickers, tracks alone
carry .09 to within a twentieth of the picture without a limit, .30 with 4 or 12 pixels, .28 with 16. With 8 and less the wall
takes points on the outline of moving objects by 3 pixels a frame along."""
LOST_ERROR = 1e3
"""Added to the accumulated error of a point for which every step failed, so that any valid path is preferred later."""
MIN_SAMPLES = 4
"""Tracks seen in fewer frames are dropped (MoSca keeps 2 to 4)."""
PLACE = 32
"""Side in pixels of the squares of the picture that all keep tracks."""
PLACED_FRACTION = 0.5
"""Fraction of the tracks that is kept for their place. All for their place: parkour's scene gains 1.4 dB, dog loses .3 dB on
movers, camel .7 dB."""
PATCH = 7
"""Half size in pixels of the patches compared when a lost track is linked to a later one."""
MIN_CORRELATION = 0.8
"""Normalised cross-correlation that two patches need to be linked."""
NEIGHBOURS, NEAREST = 8, 48
"""Tracks whose common motion predicts where a hidden point is, and the nearest ones among which they are found."""
MIN_GUIDES, STEP_TOLERANCE = 3, 0.25
"""Guides needed to follow a lost point; a guide moves like it when their last steps differ by less than 1 px or a quarter."""
LINK_RADIUS = 6.0
"""Distance in pixels between prediction and a later track, plus half a pixel per hidden frame."""
GAP_MARGIN = 3
"""Frames beside a gap in which a track is not trusted: an occluder drags points along, by 5 px (median) where bars were laid
over four clips, and is part of their patches."""
SEARCH_AFTER = (3, 6, 9, 12, 16, 20, 24, 32, 48)
"""Frames after its loss in which a point is searched for. Searching every frame finds few more points, takes four times as long
and errs more often."""
RETURN_RADIUS = 2.0
"""Searched for backwards, a point that is found must end up within so many pixels of where it was lost."""
GROUP_RADIUS, GROUP_PIXELS = 30.0, 2.0
"""Half of the neighbours within the first distance must have moved like a point that is found, to within the second (pixels)."""
FOLLOW_RADIUS, SAME_POINT_RADIUS = 3.0, 1.0
"""A point found again follows a track within this many pixels, at a constant offset; within `SAME_POINT_RADIUS` it takes the
track over."""


def track_points(
    flows: dict[int, np.ndarray],
    queries: np.ndarray,
    config: TracksConfig | None = None,
    mask: np.ndarray | ObjectFlows | None = None,
) -> tuple[np.ndarray, np.ndarray]:
    """Follow points forward and backward in time through `flows` (`flow.long_flows`).

    queries: (Q,3) frame (index of the supervised frame), x, y in pixels. mask: (F,H,W) bool; when given all queries are
    taken to lie on the masked object: they read flow from inside the mask only and are pulled back onto it when they slip
    off its silhouette. Each frame is reached by the step (from 1, 2, 4 frames ago) with the least accumulated
    forward-backward error. Returns positions (F,Q,2) float32, a guess where lost, and visible (F,Q) bool.
    """
    config = config or TracksConfig()
    (frames, height, width), count = flows[1].shape[:3], len(queries)
    start, origin = np.round(queries[:, 0]).astype(int), queries[:, 1:].astype(np.float64)
    surface = ObjectFlows(flows, mask, config) if isinstance(mask, np.ndarray) else mask
    used = flows if surface is None else surface.flows
    on_object = origin if surface is None else surface.pull_each(origin, start)
    offset = origin - on_object  # silhouette points keep their distance from the object's inside
    position = np.full((frames, count, 2), np.nan)
    position[start, np.arange(count)] = on_object
    visible = np.zeros((frames, count), bool)
    visible[start, np.arange(count)] = True

    def follow(sign: int) -> None:
        """Follow all points from their first frames to the end (1) or the start (-1) of the clip."""
        drift = np.full((frames, count), np.inf)
        drift[start, np.arange(count)] = 0
        for t in range(frames)[::sign]:
            followed = np.nonzero(sign * start < sign * t)[0]
            best = np.full(len(followed), np.inf)
            for source in (t - sign * gap for gap in config.gaps if 0 <= t - sign * gap < frames):
                reached = np.nonzero(sign * start[followed] <= sign * source)[0]
                points = followed[reached]
                step = _step(used, source, t, position[source, points])
                seen = visible[source, points] & step.returns & inside(step.ends, height, width)
                total = drift[source, points] + step.error + np.where(seen, 0, LOST_ERROR)
                better = total < best[reached]
                best[reached[better]] = total[better]
                position[t, points[better]], visible[t, points[better]] = step.ends[better], seen[better]
            drift[t, followed] = best
            if surface is not None:
                position[t, followed] = surface.pull(position[t, followed], t)

    in_threads(follow, (1, -1))  # later frames and earlier ones: nothing is written by both
    return (position + offset).astype(np.float32), visible & inside(position + offset, height, width)


class _Step(NamedTuple):
    """Points followed from one frame to another."""

    ends: np.ndarray
    """(P,2) pixels in the other frame."""
    error: np.ndarray
    """(P,) pixels by which the flow back misses the start."""
    returns: np.ndarray
    """(P,) bool: that error is small."""


def _step(flows: dict[int, np.ndarray], source: int, target: int, points: np.ndarray) -> _Step:
    """Follow `points` (P,2) by the flow from frame `source` to `target`, and back."""
    shift = sample(flows[target - source][source], points)
    ends = points + shift
    error = length(shift + sample(flows[source - target][target], ends))
    return _Step(ends, error, error < np.maximum(RETURN_PIXELS, RETURN_FRACTION * length(shift)))


class ObjectFlows:
    """Flows of masked moving objects, free of the background's, and the way back onto the objects."""

    def __init__(self, flows: dict[int, np.ndarray], mask: np.ndarray, config: TracksConfig) -> None:
        """Smooth `flows`, as of `flow.long_flows`, inside `mask` (F,H,W) bool."""
        import cv2

        frames, height, width = mask.shape
        square = np.ones((3, 3), np.uint8)
        inner = [cv2.erode(np.asarray(one, np.uint8), square) for one in mask]  # the outermost pixel is mixed already
        margin = int(np.ceil(4 * OBJECT_SIGMA))
        self.flows = {sign * gap: scratch_array(flows[1].shape) for gap in config.gaps for sign in (1, -1)}

        def smooth_flows(t: int) -> None:
            one = inner[t]
            x, y, w, h = cv2.boundingRect(one)
            box = np.s_[max(y - margin, 0) : y + h + margin, max(x - margin, 0) : x + w + margin]
            weight = cv2.GaussianBlur(one[box].astype(np.float32), (0, 0), OBJECT_SIGMA)[..., None] if w else None
            for gap, smooth in self.flows.items():
                smooth[t] = flows[gap][t]
                if weight is not None and 0 <= t + gap < frames:
                    raw = flows[gap][t][box].astype(np.float32)
                    blurred = cv2.GaussianBlur(raw * one[box][..., None], (0, 0), OBJECT_SIGMA)
                    smooth[t][box] = np.where(weight > 1e-4, blurred / np.maximum(weight, 1e-4), raw)

        in_threads(smooth_flows, range(frames))
        self.nearest = np.empty((frames, height, width, 2), np.int16)  # column, row of the nearest inner pixel
        every = np.stack(np.meshgrid(np.arange(width), np.arange(height)), -1)

        def find_nearest(t: int) -> None:
            one, self.nearest[t] = inner[t], every
            if one.any():
                _, labels = cv2.distanceTransformWithLabels(
                    1 - one, cv2.DIST_L2, cv2.DIST_MASK_5, labelType=cv2.DIST_LABEL_PIXEL
                )
                table = np.zeros((labels.max() + 1, 2), np.int16)
                table[labels[one > 0]] = np.argwhere(one)[:, ::-1]
                self.nearest[t] = table[labels]

        in_threads(find_nearest, range(frames))

    def pull(self, points: np.ndarray, frame: int) -> np.ndarray:
        """Return the points (P,2) moved to the nearest pixel inside the object where they are off it by at most `MAX_SLIP`."""
        height, width = self.nearest.shape[1:3]
        pixel = np.clip(np.floor(points), 0, (width - 1, height - 1)).astype(int)
        target = self.nearest[frame, pixel[:, 1], pixel[:, 0]]
        slipped = (target != pixel).any(-1) & (length(target - pixel) <= MAX_SLIP)
        return np.where(slipped[:, None], target + 0.5, points)

    def pull_each(self, points: np.ndarray, frames: np.ndarray) -> np.ndarray:
        """Return the same for points (P,2) of different frames (P,)."""
        pulled = points.copy()
        for frame in np.unique(frames):
            pulled[frames == frame] = self.pull(points[frames == frame], frame)
        return pulled


def seed_and_track(
    flows: dict[int, np.ndarray],
    spacing: float,
    config: TracksConfig,
    mask: np.ndarray | None = None,
    progress: Progress = silent,
) -> tuple[np.ndarray, np.ndarray]:
    """Return the tracks (F,N,2) float32, NaN where lost, and visible (F,N) of a grid of points that covers every frame.

    Seeds lie `spacing` pixels apart (inside `mask` only, when given) in frame 0; every `config.reseed_every` frames, and in
    the last one, the places that no visible track covers are seeded again and tracked both ways.
    """
    frames, height, width = flows[1].shape[:3]
    surface = None if mask is None else ObjectFlows(flows, mask, config)
    centres = np.stack(
        np.meshgrid(np.arange(spacing / 2, width, spacing), np.arange(spacing / 2, height, spacing)), -1
    ).reshape(-1, 2)
    columns, rows = int(np.ceil(width / spacing)), int(np.ceil(height / spacing))
    tracks, visible = np.empty((frames, 0, 2), np.float32), np.empty((frames, 0), bool)
    seeded = sorted({*range(0, frames, config.reseed_every), frames - 1})
    for done, frame in enumerate(seeded):
        progress("tracks", done, len(seeded))
        covered = np.zeros((rows, columns), bool)
        cell = np.floor(tracks[frame][visible[frame]] / spacing).astype(int)
        covered[np.clip(cell[:, 1], 0, rows - 1), np.clip(cell[:, 0], 0, columns - 1)] = True
        free = centres[~covered[(centres[:, 1] / spacing).astype(int), (centres[:, 0] / spacing).astype(int)]]
        if mask is not None:
            free = free[mask[frame, free[:, 1].astype(int), free[:, 0].astype(int)]]
        if len(free):
            queries = np.column_stack([np.full(len(free), frame), free])
            found = track_points(flows, queries, config, surface)
            tracks, visible = np.concatenate([tracks, found[0]], 1), np.concatenate([visible, found[1]], 1)
    progress("tracks", len(seeded), len(seeded))
    tracks[~visible] = np.nan
    return tracks, visible


def relink(
    tracks: np.ndarray, visible: np.ndarray, pictures: np.ndarray, longest_gap: int, progress: Progress = silent
) -> tuple[np.ndarray, np.ndarray, int]:
    """Join tracks that end inside the picture with ones that begin later, when place and look agree.

    tracks (F,N,2), visible (F,N), pictures (F,H,W) uint8. The hidden point is expected where the neighbours went that moved
    like it before it was lost; candidates near there must correlate (`MIN_CORRELATION`) and the best pair is joined first.
    Returns joined tracks, their visibility and the number of joins. Nothing is invented between the two ends.
    """
    ends, last = _TrackEnds(tracks, visible, pictures), len(pictures) - 2
    links = in_threads(
        lambda end: [*ends.links(end, longest_gap)], range(last), lambda done: progress("tracks", done, last, "join")
    )
    return _join_links(tracks, visible, [link for found in links for link in found])


class _TrackEnds:
    """First and last sightings of tracks, and the patches around them."""

    def __init__(self, tracks: np.ndarray, visible: np.ndarray, pictures: np.ndarray) -> None:
        """Cut out the patches; tracks (F,N,2), visible (F,N), pictures (F,H,W) uint8."""
        self.tracks, self.visible, (frames, *self.size) = tracks, visible, pictures.shape
        self.first, self.last = visible.argmax(0), frames - 1 - visible[::-1].argmax(0)
        self.seen = visible.any(0)
        # Right beside an occluder patches contain it, some frames away they do not: look at both.
        self.away = MIN_SAMPLES - 1
        self.settled = np.minimum(self.first + self.away, frames - 1)
        self.begins = [_patches(pictures, tracks, frame) for frame in (self.first, self.settled)]
        self.ends = [_patches(pictures, tracks, f) for f in (self.last, np.maximum(self.last - self.away, 0))]

    def links(self, end: int, longest_gap: int) -> Iterator[tuple[float, int, int]]:
        """Yield (correlation, track, other) for tracks lost after frame `end` and later ones that they may be."""
        from scipy.spatial import cKDTree

        before = max(end - self.away, 0)
        lost = np.nonzero(self.seen & (self.last == end) & self.visible[before])[0]
        here = self.tracks[end, lost]
        height, width = self.size
        lost = lost[((here > PATCH) & (here < (width - PATCH, height - PATCH))).all(-1)]
        later = np.nonzero(self.seen & (self.first > end) & (self.first <= end + longest_gap))[0]
        later = later[self.visible[self.settled[later], later]]
        if not (len(lost) and len(later)):
            return
        company = _Company(self.tracks, self.visible, lost, before, end)
        for begin in np.unique(self.first[later]):
            candidates = later[self.first[later] == begin]
            tree, radius = cKDTree(self.tracks[begin, candidates]), LINK_RADIUS + 0.5 * (begin - end)
            for track, near in zip(lost, tree.query_ball_point(company.expected(begin), radius), strict=True):
                others = candidates[near]
                yield from (
                    (look, track, other) for look, other in zip(self._alike(track, others), others, strict=True)
                )

    def _alike(self, track: int, others: np.ndarray) -> np.ndarray:
        """Return the correlations (n,) of the end of a track with the beginnings of `others` (n,) int."""
        return np.maximum(*(begins[others] @ ends[track] for begins, ends in zip(self.begins, self.ends, strict=True)))


def _join_links(
    tracks: np.ndarray, visible: np.ndarray, links: list[tuple[float, int, int]]
) -> tuple[np.ndarray, np.ndarray, int]:
    """Join (F,N,2) tracks by (correlation, track, other), the best first; a track goes on once and is gone on with once.

    Returns them, their visibility and the number of joins.
    """
    tracks, visible = tracks.copy(), visible.copy()
    ended, begun, owner, joins = set(), set(), np.arange(tracks.shape[1]), 0
    for look, track, other in sorted(links, key=lambda link: -link[0]):
        if look < MIN_CORRELATION or track in ended or other in begun:
            continue
        ended.add(track)
        begun.add(other)
        into = owner[track]
        part = visible[:, other]
        tracks[part, into], visible[part, into] = tracks[part, other], True
        tracks[:, other], visible[:, other] = np.nan, False
        owner[owner == other] = into
        joins += 1
    return tracks, visible, joins


def continue_lost(
    tracks: np.ndarray, visible: np.ndarray, pictures: np.ndarray, longest_gap: int, progress: Progress = silent
) -> tuple[np.ndarray, np.ndarray, int]:
    """Continue tracks that end inside the picture where their points are seen again, within `longest_gap` frames.

    tracks (F,N,2), visible (F,N), pictures (F,H,W) uint8. Other than `relink` it needs no track that begins there. A hidden
    point is expected where the neighbours went that moved like it. It is seen again where its patch is found near there, and
    from there back where it was, and where the neighbours have shifted as it has. From then on it goes with the nearest
    track; one that is the same point and began later is taken over. Samples beside the occluder are dropped. Returns tracks,
    their visibility and the number of tracks continued.
    """
    from scipy.spatial import cKDTree

    frames, height, width = pictures.shape
    first, last, known = visible.argmax(0), frames - 1 - visible[::-1].argmax(0), visible.any(0)
    joined, seen = tracks.copy(), visible.copy()
    holder, joins = np.arange(tracks.shape[1]), 0  # the column that holds what was a track

    def search(end: int) -> list[tuple[int, int, np.ndarray, int]]:
        """Return the points lost after frame `end` that are seen again: (frame, point, place (2,), the track nearest to it)."""
        lost = np.nonzero(known & (last == end) & visible[end - GAP_MARGIN])[0]
        here = tracks[end, lost]
        lost, again = lost[((here > PATCH) & (here < (width - PATCH, height - PATCH))).all(-1)], []
        company, rows = _Company(tracks, visible, lost, end - GAP_MARGIN, end), np.arange(len(lost))
        for t in [end + gap for gap in SEARCH_AFTER if gap <= longest_gap and end + gap < frames]:
            settled = np.nonzero(visible[t - GAP_MARGIN : t + 1].all(0) & visible[min(t + GAP_MARGIN, frames - 1)])[0]
            if len(rows) == 0 or len(settled) == 0:
                continue
            places = _seen_again(company, rows, pictures, t)
            found = np.isfinite(places[:, 0])
            distance, nearest = cKDTree(tracks[t, settled]).query(np.where(found[:, None], places, -width))
            found &= distance <= FOLLOW_RADIUS
            again += list(zip(repeat(t), lost[rows[found]], places[found], settled[nearest[found]], strict=False))
            rows = rows[~found]
        return again

    ends = range(frames - 2, GAP_MARGIN - 1, -1)  # the latest first: what a track goes on with is then complete
    pieces = in_threads(search, ends, lambda done: progress("tracks", done, len(ends), "continue"))
    for end, again in zip(ends, pieces, strict=True):
        before = slice(end - GAP_MARGIN + 1, end + 1)
        for t, point, place, other in again:
            same, source = length(place - tracks[t, other]) <= SAME_POINT_RADIUS, holder[other]
            joined[before, point], seen[before, point] = np.nan, False
            joined[t:, point] = joined[t:, source] + (0 if same else place - tracks[t, other])
            seen[t:, point] = seen[t:, source]
            if same and source == other and first[other] > end:
                joined[:, other], seen[:, other], holder[other] = np.nan, False, point
            joins += 1
    return joined, seen & np.isfinite(joined[..., 0]), joins


def _seen_again(company: _Company, rows: np.ndarray, pictures: np.ndarray, t: int) -> np.ndarray:
    """Return (L,2) where the lost points `rows (L,)` of a company are seen in frame `t`, NaN where they are not."""
    from scipy.spatial import cKDTree

    tracks, lost, end = company.tracks, company.lost[rows], company.end
    before = end - GAP_MARGIN
    guides = np.nonzero(company.visible[before] & company.visible[end] & company.visible[t])[0]
    expected = company.expected(t, rows)
    radius = int(LINK_RADIUS + 0.5 * (t - end))
    start = tracks[before, lost]
    places = _find_patches(pictures[before], pictures[t], start, expected, radius)
    returned = _find_patches(pictures[t], pictures[before], places, start, radius)
    good = np.nonzero(length(returned - start) <= RETURN_RADIUS)[0]
    confirmed = np.full((len(lost), 2), np.nan)
    points = np.concatenate([lost[good], guides])
    if len(points) <= MIN_GUIDES:
        return confirmed
    shift = np.concatenate([places[good], tracks[t, guides]]) - tracks[before, points]
    distance, near = cKDTree(tracks[before, points]).query(
        tracks[before, lost[good]], k=min(NEIGHBOURS + 1, len(points)), distance_upper_bound=GROUP_RADIUS
    )
    distance[near == np.arange(len(good))[:, None]] = np.inf  # its own neighbour
    near_shift = shift[np.minimum(near, len(points) - 1)]
    alike = (length(near_shift - shift[: len(good), None]) <= GROUP_PIXELS) & np.isfinite(distance)
    count = np.isfinite(distance).sum(1)
    kept = good[(count >= MIN_GUIDES) & (2 * alike.sum(1) >= count)]
    confirmed[kept] = places[kept]
    return confirmed


def _find_patches(
    picture: np.ndarray, other: np.ndarray, points: np.ndarray, near: np.ndarray, radius: int
) -> np.ndarray:
    """Return the places (L,2) in `other` of the patches of `picture` (H,W) around `points (L,2)`; NaN where none is found.

    They lie within `radius` pixels of `near (L,2)` and correlate by `MIN_CORRELATION`.
    """
    import cv2

    height, width = picture.shape
    found = np.full((len(points), 2), np.nan)
    usable = np.isfinite(points).all(-1) & (near > 0).all(-1) & (near < (width, height)).all(-1)
    side, reach = (2 * PATCH + 1,) * 2, (2 * (PATCH + radius) + 1,) * 2
    for row in np.nonzero(usable)[0]:
        patch = cv2.getRectSubPix(picture, side, (points[row] - 0.5).tolist())
        window = cv2.getRectSubPix(other, reach, (near[row] - 0.5).tolist())
        score = cv2.matchTemplate(window, patch, cv2.TM_CCOEFF_NORMED)
        _, best, _, (column, line) = cv2.minMaxLoc(score)
        if best < MIN_CORRELATION or not (0 < column < 2 * radius and 0 < line < 2 * radius):
            continue
        cross = score[line, column - 1 : column + 2], score[line - 1 : line + 2, column]
        top = [(after - ahead) / max(2 * (2 * middle - ahead - after), 1e-6) for ahead, middle, after in cross]
        found[row] = near[row] + (column - radius, line - radius) + np.clip(top, -0.5, 0.5)
    return found


class _Company:
    """Tracks that moved with points before these were lost, and where the points should be as long as some of them are seen."""

    def __init__(self, tracks: np.ndarray, visible: np.ndarray, lost: np.ndarray, before: int, end: int) -> None:
        """Find the neighbours that moved like the points `lost (L,)` from frame `before` to `end`, where they were seen last.

        tracks (F,N,2), visible (F,N).
        """
        from scipy.spatial import cKDTree

        self.tracks, self.visible, self.lost, self.end = tracks, visible, lost, end
        own = tracks[end, lost] - tracks[before, lost]  # (L,2)
        self.speed = own / max(end - before, 1)
        others = np.setdiff1d(np.nonzero(visible[before] & visible[end])[0], lost)
        asked = range(1, min(NEAREST, len(others)) + 1)
        near = (
            others[cKDTree(tracks[end, others]).query(tracks[end, lost], k=asked)[1]] if len(asked) else lost[:, None]
        )
        unlike = length(tracks[end, near] - tracks[before, near] - own[:, None])
        order = np.argsort(unlike, axis=1, kind="stable")
        self.near = np.take_along_axis(near, order, 1)  # (L,n), the likest first
        like = unlike <= np.maximum(1.0, STEP_TOLERANCE * length(own))[:, None]
        self.like = np.take_along_axis(like & (near != lost[:, None]), order, 1)

    def expected(self, begin: int, rows: np.ndarray | slice = slice(None)) -> np.ndarray:
        """Return the expected places (L,2) of the lost points, or of `rows` of them, in frame `begin`.

        A point moves like the tracks near it that moved like it so far; with fewer than `MIN_GUIDES` of those it keeps its speed.
        """
        near = self.near[rows]
        guides = self.like[rows] & self.visible[begin, near]
        first = np.argsort(~guides, axis=1, kind="stable")[:, :NEIGHBOURS]
        near, count = np.take_along_axis(near, first, 1), np.minimum(guides.sum(1), NEIGHBOURS)
        enough = count >= MIN_GUIDES
        here = self.tracks[self.end, self.lost[rows]]
        shift = self.speed[rows] * (begin - self.end)
        going = near[enough]
        shift[enough] = _median_of_first(self.tracks[begin, going] - self.tracks[self.end, going], count[enough])
        return here + shift


def _median_of_first(values: np.ndarray, count: np.ndarray) -> np.ndarray:
    """Return (L,2) medians of the first `count (L,)` of `values (L,n,2)`; `np.nanmedian` takes ten times as long over so few."""
    ordered = np.sort(np.where(np.arange(values.shape[1])[:, None] < count[:, None, None], values, np.inf), axis=1)
    rows = np.arange(len(values))
    return (ordered[rows, (count - 1) // 2] + ordered[rows, count // 2]) / 2


def _patches(pictures: np.ndarray, tracks: np.ndarray, frames: np.ndarray) -> np.ndarray:
    """Return (N,P) float32 patches around tracks (F,N,2) at one frame each (N,), normalised so that products correlate them."""
    window = np.stack(np.meshgrid(np.arange(-PATCH, PATCH + 1), np.arange(-PATCH, PATCH + 1)), -1).reshape(-1, 2)
    patches = np.zeros((len(frames), len(window)), np.float32)
    for frame in np.unique(frames):
        chosen = np.nonzero((frames == frame) & np.isfinite(tracks[frame, :, 0]))[0]
        values = sample(pictures[frame].astype(np.float32), tracks[frame, chosen, None] + window)  # (n,P)
        values -= values.mean(1, keepdims=True)
        patches[chosen] = values / (np.sqrt((values**2).sum(1, keepdims=True)) + PATCH)  # flat ones resemble nothing
    return patches


def best_rank(group: np.ndarray, item: np.ndarray, count: int) -> np.ndarray:
    """Return (count,) int: the least rank that an item has among those of one of its groups, by number; `count` without any.

    `group (S,)` not negative, `item (S,)`: which items are in which groups.
    """
    by_group = np.lexsort((item, group))
    first = np.flatnonzero(np.diff(group[by_group], prepend=-1))
    rank = np.arange(len(group)) - np.repeat(first, np.diff(first, append=len(group)))
    best = np.full(count, count)
    np.minimum.at(best, item[by_group], rank)
    return best


def longest_first(visible: np.ndarray) -> np.ndarray:
    """Return indices (N,) of the points `visible (F,N)` by the number of frames that see them, equals from all over the picture.

    Tracks come row by row, and where the camera moves little most are seen in all frames: the first of these are the picture's
    top, a far wall or the sky, which looks the same to a camera that only turns.
    """
    return np.lexsort((np.arange(visible.shape[1]) * GOLDEN_RATIO % 1, -visible.sum(0)))


def thinned(tracks: np.ndarray, visible: np.ndarray, count: int) -> tuple[np.ndarray, np.ndarray]:
    """Return at most `count` tracks, none with fewer samples than `MIN_SAMPLES` (or F, in shorter clips).

    A `PLACED_FRACTION` of them are the q longest in every square of `PLACE` pixels of every frame, q as large as fits; the rest
    are the longest of all. The longest alone would leave turning or fast objects without tracks, and squares alone would
    spend tracks on noise.
    """
    samples = visible.sum(0)
    keep = np.nonzero(samples >= min(MIN_SAMPLES, len(visible)))[0]
    if len(keep) > count:
        order = keep[longest_first(visible[:, keep])]
        frame, track = np.nonzero(visible[:, order])
        square = np.floor(tracks[:, order][frame, track] / PLACE).astype(np.int64)
        best = best_rank(frame * 2**20 + square[:, 1] * 2**10 + square[:, 0], track, len(order))
        chosen = np.argsort(best, kind="stable")[: round(PLACED_FRACTION * count)]
        others = np.setdiff1d(np.arange(len(order)), chosen)[: count - len(chosen)]
        keep = np.sort(order[np.concatenate([chosen, others])])
    return tracks[:, keep], visible[:, keep]


def provide(clip: Clip, priors: Priors, config: PriorsConfig, progress: Progress) -> None:
    """Fill `tracks` and `tracks_visible` with uniform coverage (provider `classical`); `motion` densifies moving objects."""
    flows = long_flows(clip, priors, config, progress)
    tracks, visible = seed_and_track(flows, config.tracks.spacing, config.tracks, progress=progress)
    joins = 0
    if config.tracks.relink_gap > 0:
        pictures, gap = grey(clip.frames[clip.supervised]), config.tracks.relink_gap
        tracks, visible, joins = relink(tracks, visible, pictures, gap, progress)
    priors.tracks, priors.tracks_visible = thinned(tracks, visible, config.tracks.count)
    priors.statistics["tracks"] = {
        "uniform": int(priors.tracks.shape[1]),
        "joins": joins,
        "mean_length": float(priors.tracks_visible.sum(0).mean()) if priors.tracks.shape[1] else 0.0,
    }
