"""Depth of moving objects: from their own motion where they are rigid and turn, else a plausible guess.

Moving pixels carry no depth signal against the static world. A rigid body that turns has a structure of its own
(`own_motion`), known up to one scale, which the ground that it touches gives over all frames. Every other object becomes one
upright plane per frame that bulges, placed by its contact with the ground and its change of size over time, with low confidence.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import combinations
from typing import TYPE_CHECKING, Any

import numpy as np
from scipy import ndimage
from scipy.interpolate import RBFInterpolator
from scipy.spatial import cKDTree

from ..parallel import in_threads
from .body_depth import STANDS, add_relief, place_people
from .contact import (
    CONTACT_NOISE,
    GROUND_NOISE,
    GUESS_CONFIDENCE,
    MIN_CONTACT_FRAMES,
    MIN_OBJECT_PIXELS,
    MOVING_CONFIDENCE,
    NO_CONTACT,
    DepthMaps,
    GroundEdge,
    ground_edge,
    growth,
    guessed_confidence,
    inverse_around,
    largest_piece,
    one_scale,
    smooth_object_depth,
    without_upright,
)
from .heading import Extents, turn_along_way
from .own_motion import MIN_POINTS, OwnMotion, TracksOnObject, solve

if TYPE_CHECKING:
    from .folder import Priors

BODY_CONFIDENCE = 0.9
"""Confidence of a rigid body's depth: its shape is measured, its distance depends on ground contact."""
MIN_INSIDE = 0.6
"""A track belongs to the region that holds this fraction of its visible samples."""
MAX_BODIES, MIN_FRAME_POINTS = 4, 6
"""Rigid bodies looked for in one region, and points that a frame needs to show a body's shape."""
MIN_AGREEMENT, MIN_KNOWN = 0.9, 0.2
"""A connected piece of the mask belongs to an object when at least the first fraction of its assigned tracks belong to it; when
less than the second fraction of its tracks are assigned yet, the piece is a new object."""
MIN_TOGETHER = 0.75
"""Tracks that lie in one piece of the mask in this fraction of the frames are one object: a pole in front may split its mask."""
NEIGHBOURS, MIN_APART = 6, 0.8
"""Tracks that follow no rigid body are a separate object when this fraction of their nearest tracks follows none either."""
SMOOTH_PX, MAX_KNOTS, GRID_PX = 2.0, 200, 4
"""Smoothing of inverse depth between a body's points (that of the linear kernel, pixels), how many of them are used per
frame, and the grid on which it is evaluated."""
TOUCH_QUANTILE = 0.98
"""Quantile of the ratios along the lower edge at which a region touches the ground: columns beyond are noise."""
TURN_LIMIT, TURNS, TURN_COST = 1.5, 31, 0.05
"""Largest turn of a region against the view (relative inverse depth over the picture's width), how many are tried, and the
fraction of touching columns that a turn of 1 must win."""
ROUND, FEET_LEVEL = 0.7, 0.6
"""Depth of a body without a structure of its own as a fraction of its width, as it would be if each piece of it were a ball, and
the part of that height that is as far as what it stands on: outlines are farther, the middle is nearer. Chosen on
people-cross, knight, crossing and demo."""


@dataclass(frozen=True)
class _MovingObject:
    """One object: a connected region of the mask in space and time, or the part of it that one rigid body covers."""

    frames: np.ndarray
    """(f,) rows of the priors in which it is seen."""
    masks: np.ndarray
    """(f, H, W) bool."""
    tracks: np.ndarray
    """(n,) indices of the tracks on it."""
    motion: OwnMotion | None = None
    """Structure of the region, where it has one."""


def place_objects(
    inverse: np.ndarray, confidence: np.ndarray, moving: np.ndarray, priors: Priors
) -> list[dict[str, Any]]:
    """Write the inverse depth of moving pixels into `inverse (F, H, W)` and its confidence into `confidence`, both in place.

    Returns one row per object: `group`, its first and last clip frame `frames`, what its depth was `decided_by` ("feet", "its own
    motion", "ground contact", "size" or "surroundings"), `emf_degrees`, the angle of the rays its points were seen from
    in its own axes (0 where unknown), and `over_time`, lists over the frames in which it is `seen`: the `depth` of its point
    that is nearest to the ground (its median where none is seen), that of the `ground` seen below it (None where there is
    none), and if it `touches` it.
    """
    maps = DepthMaps(inverse, confidence, confidence.copy(), moving)
    confidence[moving] = np.minimum(confidence[moving], GUESS_CONFIDENCE)
    people = place_people(maps, priors)
    labels, _ = ndimage.label(moving & ~people.pixels)
    on_mover = _labels_of_tracks(labels, priors)

    def bodies(number: int) -> list[_MovingObject]:
        span = found[number - 1][0]
        masks = labels[span] == number
        seen = masks.any((1, 2))
        if masks.sum() < MIN_OBJECT_PIXELS * seen.sum():
            return []
        tracks = np.flatnonzero(_tracks_mostly_inside(on_mover == number, priors))
        whole = _MovingObject(span.start + np.flatnonzero(seen), masks[seen], tracks)
        return [body for one in _objects(whole, priors) for body in _rigid_bodies(one, priors)]

    found = ndimage.find_objects(labels)
    placed = list(zip(people.frames, people.masks, strict=True))
    rows = [_row(number, frames, STANDS, 0.0, priors) for number, frames in enumerate(people.frames)]
    for mover in (body for number in range(1, len(found) + 1) for body in bodies(number)):
        place = _place_upright_plane if mover.motion is None else _place_rigid_body
        decided = place(mover, maps, priors)
        rows.append(_row(len(rows), mover.frames, decided, mover.motion.degrees if mover.motion else 0.0, priors))
        placed.append((mover.frames, mover.masks))
    add_relief(inverse, moving & ~people.pixels & (confidence <= MOVING_CONFIDENCE), priors)
    for row, (frames, masks) in zip(rows, placed, strict=True):
        row["over_time"] = _over_time(frames, masks, maps, priors)
    return rows


def _over_time(frames: np.ndarray, masks: np.ndarray, maps: DepthMaps, priors: Priors) -> dict[str, list[Any]]:
    """Return `over_time` of `place_objects` for a placed object, `masks (f, H, W)` in the rows `frames (f,)` of the priors."""

    def compare(i: int) -> tuple[float, float | None, bool]:
        f, own, edge = frames[i], owns[i], edges[i]
        if edge is None:
            return 1 / float(np.median(maps.inverse[f][own])), None, False
        bottom = len(own) - 1 - np.argmax(own[::-1], axis=0)[edge.columns]
        lowest = maps.inverse[f][bottom, edge.columns]
        nearest = int(np.argmin(abs(np.log(np.maximum(edge.ground, 1e-9) / lowest))))
        depth, ground = 1 / float(lowest[nearest]), 1 / max(float(edge.ground[nearest]), 1e-9)
        return depth, ground, bool(abs(depth / ground - 1) < CONTACT_NOISE)

    owns = [largest_piece(mask) for mask in masks]
    edges = _ground_edges(frames, owns, maps, priors)
    depth, ground, touches = map(list, zip(*in_threads(compare, range(len(frames))), strict=True))
    return {"seen": priors.frames[frames].tolist(), "depth": depth, "ground": ground, "touches": touches}


def _ground_edges(
    frames: np.ndarray, masks: Sequence[np.ndarray] | np.ndarray, maps: DepthMaps, priors: Priors
) -> list[GroundEdge | None]:
    """Return the ground below a mover's masks (f, H, W) in the rows `frames (f,)` of the priors."""
    assert priors.cameras is not None

    def find(i: int) -> GroundEdge | None:
        f = frames[i]
        return ground_edge(maps.inverse[f], maps.static_confidence[f], maps.moving[f], masks[i])

    return without_upright(in_threads(find, range(len(frames))), priors.cameras.intrinsics[frames])


def _row(number: int, frames: np.ndarray, decided_by: str, degrees: float, priors: Priors) -> dict[str, Any]:
    """Return facts about one moving object, as `place_objects` describes them; `frames (f,)` are rows of the priors."""
    first, last = (int(priors.frames[frame]) for frame in frames[[0, -1]])
    return {"group": number, "frames": [first, last], "decided_by": decided_by, "emf_degrees": round(degrees, 1)}


def _labels_of_tracks(labels: np.ndarray, priors: Priors) -> np.ndarray:
    """Return (F, N) label under every visible track sample, 0 elsewhere."""
    if priors.tracks is None or priors.tracks_visible is None:
        return np.zeros((len(labels), 0), int)
    found = np.zeros(priors.tracks_visible.shape, int)
    for frame, seen in enumerate(priors.tracks_visible):
        column, row = np.floor(priors.tracks[frame, seen]).astype(int).T
        found[frame, seen] = labels[frame, np.clip(row, 0, priors.height - 1), np.clip(column, 0, priors.width - 1)]
    return found


def _tracks_mostly_inside(inside: np.ndarray, priors: Priors) -> np.ndarray:
    """Return (N,) bool: tracks whose visible samples mostly lie `inside (F, N)`."""
    if priors.tracks_visible is None:
        return np.zeros(0, bool)
    hits = inside.sum(0)
    return (hits > 2) & (hits > MIN_INSIDE * priors.tracks_visible.sum(0))


def _objects(region: _MovingObject, priors: Priors) -> list[_MovingObject]:
    """Split a region into objects that only touch in it: parts that are separate in most frames in which both are visible."""
    if len(region.tracks) < 2 * MIN_POINTS:
        return [region]
    pieces = np.stack([ndimage.label(mask)[0] for mask in region.masks])
    labels = np.zeros((len(priors.frames), *pieces.shape[1:]), pieces.dtype)
    labels[region.frames] = pieces
    piece = _labels_of_tracks(labels, priors)[np.ix_(region.frames, region.tracks)]  # (f, n), 0 = not seen
    owner = np.zeros(len(region.tracks), int)
    for row in piece:
        crowded = np.flatnonzero(np.bincount(row[row > 0], minlength=1) >= MIN_POINTS)
        for number in crowded if len(crowded) > 1 else ():  # a frame with a single piece separates nothing
            here = row == number
            votes = np.bincount(owner[here])[1:]
            if votes.sum() < MIN_KNOWN * here.sum():
                owner[here] = owner.max() + 1
            elif votes.max() >= MIN_AGREEMENT * votes.sum():
                owner[here & (owner == 0)] = votes.argmax() + 1
    groups = [np.flatnonzero(owner == number) for number in np.unique(owner[owner > 0])]
    groups = [group for group in groups if len(group) >= MIN_POINTS]
    while together := [pair for pair in combinations(groups, 2) if _in_one_component(*(piece[:, one] for one in pair))]:
        one, other = together[0]  # parts of one object
        groups = [group for group in groups if group is not one and group is not other] + [np.concatenate([one, other])]
    if len(groups) < 2:
        return [region]
    parts = [replace(region, tracks=region.tracks[group]) for group in groups]
    return _split(region, parts, priors)


def _in_one_component(one: np.ndarray, other: np.ndarray) -> bool:
    """Return True if tracks `(f, n)`, `(f, m)` mostly lie in one piece of the mask (`MIN_TOGETHER`)."""
    shared = []
    for a, b in zip(one, other, strict=True):
        if (a > 0).any() and (b > 0).any():
            shared.append(np.bincount(a[a > 0]).argmax() == np.bincount(b[b > 0]).argmax())
    return not shared or float(np.mean(shared)) >= MIN_TOGETHER


def _rigid_bodies(region: _MovingObject, priors: Priors) -> list[_MovingObject]:
    """Return the rigid bodies of a region, the one with most tracks first; the region itself where none is found."""
    found: list[_MovingObject] = []
    left = region.tracks
    while len(found) < MAX_BODIES and len(left) >= MIN_POINTS:
        motion = solve(_tracks_on(replace(region, tracks=left), priors))
        if motion is None:
            break
        found.append(replace(region, tracks=left[motion.inliers], motion=_inliers_only(motion)))
        left = left[~motion.inliers]
    if found and _is_separate_object(left, np.concatenate([body.tracks for body in found]), region.frames, priors):
        found.append(replace(region, tracks=left))
    return _split(region, found, priors) if len(found) > 1 else found or [region]


def _is_separate_object(some: np.ndarray, others: np.ndarray, frames: np.ndarray, priors: Priors) -> bool:
    """Return True if tracks `some` have each other as neighbours more than `others`: a separate object, no limbs of one."""
    assert priors.tracks is not None and priors.tracks_visible is not None
    if len(some) < MIN_POINTS:
        return False
    alike = []
    for frame in frames:
        near, far = (kind[priors.tracks_visible[frame, kind]] for kind in (some, others))
        if len(near) <= NEIGHBOURS or len(far) == 0:
            continue
        tree = cKDTree(priors.tracks[frame, np.concatenate([near, far])])
        found = tree.query(priors.tracks[frame, near], NEIGHBOURS + 1)[1][:, 1:]
        alike.append((found < len(near)).mean())
    return bool(alike and np.mean(alike) >= MIN_APART)


def _inliers_only(motion: OwnMotion) -> OwnMotion:
    """Return the motion restricted to the tracks that follow the body."""
    return replace(motion, z=motion.z[:, motion.inliers], inliers=motion.inliers[motion.inliers])


def _tracks_on(mover: _MovingObject, priors: Priors) -> TracksOnObject:
    """Return the tracks of a moving object with the cameras of its frames."""
    assert priors.tracks is not None and priors.tracks_visible is not None and priors.cameras is not None
    tracks = priors.tracks[np.ix_(mover.frames, mover.tracks)].astype(np.float64)
    visible = priors.tracks_visible[np.ix_(mover.frames, mover.tracks)].copy()
    outline = np.zeros(visible.shape)

    def measure(i: int) -> None:
        column, row = np.floor(tracks[i, visible[i]]).astype(int).T
        distance = _from_outline(mover.masks[i])
        outline[i, visible[i]] = distance[np.clip(row, 0, priors.height - 1), np.clip(column, 0, priors.width - 1)]

    in_threads(measure, range(len(tracks)))
    visible &= outline > 0
    intrinsics, poses = priors.cameras.intrinsics[mover.frames], priors.cameras.world_to_camera[mover.frames]
    return TracksOnObject(tracks, visible, outline, intrinsics[:, 0, 0], intrinsics[:, :2, 2].mean(0), poses)


def _split(region: _MovingObject, bodies: list[_MovingObject], priors: Priors) -> list[_MovingObject]:
    """Assign every pixel of the region to the body with the nearest track; in frames without tracks, to the first body."""
    assert priors.tracks is not None and priors.tracks_visible is not None
    owner = np.concatenate([np.full(len(body.tracks), which) for which, body in enumerate(bodies)])
    tracks = np.concatenate([body.tracks for body in bodies])
    places, visible = priors.tracks, priors.tracks_visible
    parts = np.zeros((len(bodies), *region.masks.shape), bool)

    def assign(i: int) -> None:
        frame, (y, x) = region.frames[i], np.nonzero(region.masks[i])
        seen = visible[frame, tracks]
        nearest = np.zeros(len(y), int)
        if seen.any():
            pixels = np.column_stack([x + 0.5, y + 0.5])
            nearest = owner[seen][cKDTree(places[frame, tracks[seen]]).query(pixels)[1]]
        parts[nearest, i, y, x] = True

    in_threads(assign, range(len(region.frames)))
    found = []
    for body, masks in zip(bodies, parts, strict=True):
        there = masks.any((1, 2))
        motion = body.motion and replace(body.motion, z=body.motion.z[there])
        found.append(replace(body, frames=region.frames[there], masks=masks[there], motion=motion))
    return [body for body in found if len(body.frames)]


def _place_upright_plane(mover: _MovingObject, maps: DepthMaps, priors: Priors) -> str:
    """Write an object without structure of its own as an upright plane per frame, with a bulge; returns what decided its depth."""
    owns = [largest_piece(mask) for mask in mover.masks]
    edges = _ground_edges(mover.frames, owns, maps, priors)
    assert priors.cameras is not None

    size = np.array(in_threads(lambda i: growth(priors, mover.frames[i], mover.masks[i]), range(len(mover.frames) - 1)))
    cameras, extents = priors.cameras.at_times(priors.cameras.times[mover.frames]), Extents.of(mover.masks)
    contacts = [
        _contact(maps.inverse[f], maps.moving[f], own, edge)
        for f, own, edge in zip(mover.frames, owns, edges, strict=True)
    ]
    middle, trust = np.array(contacts).T
    stands = trust > NO_CONTACT
    solved, certain = smooth_object_depth(middle, trust * (stands | ~stands.any()), size)
    turns = turn_along_way(extents, solved, cameras)
    for f, mask, value, turn, sure in zip(mover.frames, mover.masks, solved, turns, certain, strict=True):
        y, x = np.nonzero(mask)
        turned = 1 + turn * (x - x.mean())
        maps.inverse[f][y, x] = value * turned / (1 - _bulge(mask) / float(priors.cameras.intrinsics[f, 0, 0]))
        maps.confidence[f][y, x] = guessed_confidence(priors, sure)
    return "ground contact" if stands.mean() >= MIN_CONTACT_FRAMES else "size" if stands.any() else "surroundings"


def _bulge(mask: np.ndarray) -> np.ndarray:
    """Return pixels by which the pixels of `mask (H, W)`, rows ascending, are nearer than the ground below the body.

    A body is taken to be as deep as it is wide.
    """
    inside = _from_outline(mask)[mask]
    widest = inside.max()
    return ROUND * (np.sqrt(inside * (2 * widest - inside)) - FEET_LEVEL * widest)


def _from_outline(mask: np.ndarray) -> np.ndarray:
    """Return (H, W) float32 pixels from the pixels of `mask (H, W)` to its outline; the border of the picture is one, too."""
    import cv2

    found = cv2.distanceTransform(np.pad(mask, 1).astype(np.uint8), cv2.DIST_L2, cv2.DIST_MASK_PRECISE)[1:-1, 1:-1]
    # OpenCV's roots differ in the last bit from call to call; their squares are whole numbers.
    distance: np.ndarray = np.sqrt(np.rint(found.astype(np.float64) ** 2)).astype(np.float32)
    return distance


def _place_rigid_body(mover: _MovingObject, maps: DepthMaps, priors: Priors) -> str:
    """Write a rigid body at one scale for all frames; returns what decided its depth."""
    shapes = _relative_inverse(mover, priors)
    ratio, trust = np.zeros((2, len(shapes)))
    edges = _ground_edges(mover.frames, mover.masks, maps, priors)
    for i, (f, mask, shape) in enumerate(zip(mover.frames, mover.masks, shapes, strict=True)):
        edge = edges[i]
        if edge is None:
            around = inverse_around(maps.inverse[f], maps.moving[f], mask)
            ratio[i], trust[i] = around / np.median(shape), NO_CONTACT
            continue
        lowest = np.zeros(mask.shape[1])
        lowest[np.nonzero(mask)[1]] = shape  # rows ascend, so the last one written is the lowest
        ratio[i], trust[i] = float(np.quantile(edge.ground / lowest[edge.columns], TOUCH_QUANTILE)), edge.trust
    scale = one_scale(np.maximum(ratio, 1e-9), trust)
    for f, mask, shape in zip(mover.frames, mover.masks, shapes, strict=True):
        maps.inverse[f][mask] = scale * shape
        maps.confidence[f][mask] = BODY_CONFIDENCE if priors.camera_kind == "moving" else GUESS_CONFIDENCE
    return "its own motion"


def _relative_inverse(mover: _MovingObject, priors: Priors) -> list[np.ndarray]:
    """Return the inverse depth of the body's pixels per frame (rows of the mask ascending), from its points seen there."""
    assert priors.tracks is not None and priors.tracks_visible is not None and mover.motion is not None
    seen = priors.tracks_visible[np.ix_(mover.frames, mover.tracks)] & np.isfinite(mover.motion.z)
    known = seen.sum(1) >= MIN_FRAME_POINTS
    level = np.array([np.median(1 / z[s]) if s.any() else np.nan for z, s in zip(mover.motion.z, seen, strict=True)])
    rows = np.arange(len(level))
    level = np.exp(np.interp(rows, rows[known], np.log(level[known])))
    found = []
    for i, (frame, mask) in enumerate(zip(mover.frames, mover.masks, strict=True)):
        y, x = np.nonzero(mask)
        if not known[i]:
            found.append(np.full(len(y), level[i]))
            continue
        points = priors.tracks[frame, mover.tracks[seen[i]]].astype(np.float64)
        found.append(_smooth(points, 1 / mover.motion.z[i, seen[i]], y, x))
    return found


def _smooth(points: np.ndarray, values: np.ndarray, y: np.ndarray, x: np.ndarray) -> np.ndarray:
    """Return the values `(n,)` known at `points (n, 2)` at the pixels `y, x (p,)`, never beyond the known ones."""
    every = -(-len(points) // MAX_KNOTS)
    smooth = RBFInterpolator(points[::every], values[::every], kernel="linear", smoothing=SMOOTH_PX)
    rows, columns = (np.arange(one.min(), one.max() + GRID_PX, GRID_PX) for one in (y, x))
    grid = np.stack(np.meshgrid(columns + 0.5, rows + 0.5), -1)
    coarse = smooth(grid.reshape(-1, 2)).reshape(grid.shape[:2])
    at = np.stack([(y - y.min()) / GRID_PX, (x - x.min()) / GRID_PX])
    return np.clip(ndimage.map_coordinates(coarse, at, order=1, mode="nearest"), *np.percentile(values, (2, 98)))


def _contact(inverse: np.ndarray, moving: np.ndarray, own: np.ndarray, found: GroundEdge | None) -> tuple[float, float]:
    """Return a region's inverse depth at its mean column, and trust in it, 0..1.

    Nothing is behind the ground that it is seen in front of, so the region, an upright plane of inverse depth
    `a (1 + b (column - mean))`, lies above the ground's values on its lower edge and touches them at its feet; of all turns
    `b` the one that touches most columns is taken (feet and wheels do, bellies and tails do not).
    """
    if found is None:
        return inverse_around(inverse, moving, own), NO_CONTACT
    width, edge, run = own.shape[1], found.ground, found.run
    usual = max(float(edge.max()), 1e-6)
    best, a = -np.inf, usual
    for turn in np.linspace(-TURN_LIMIT, TURN_LIMIT, TURNS) / width:  # relative change per column
        touching = float(np.quantile(edge / (1 + turn * run), TOUCH_QUANTILE))
        gap = 1 - edge / (touching * (1 + turn * run))
        score = float(np.exp(-((gap / GROUND_NOISE) ** 2)).mean()) - TURN_COST * (turn * width) ** 2
        if score > best:
            best, a = score, touching
    return max(a, 0.3 * usual), found.trust
