"""Depth of moving objects: from their own motion where they are rigid and turn, else a plausible guess.

Moving pixels carry no depth signal against the static world. A rigid body that turns has a structure of its own
(`own_motion`), known up to one scale, which the ground that it touches gives over all frames. Every other object becomes one
upright plane per frame, placed by its contact with the ground and its change of size over time, with low confidence.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import combinations
from typing import TYPE_CHECKING, Any

import numpy as np
from scipy import ndimage
from scipy.interpolate import RBFInterpolator
from scipy.spatial import cKDTree

from ..parallel import in_threads
from .own_motion import MIN_POINTS, OwnMotion, TracksOnObject, solve

if TYPE_CHECKING:
    from .folder import Priors

GUESS_CONFIDENCE = 0.05
"""Largest confidence of the guessed depth of moving pixels, and of all depth in a clip without parallax."""
MOVING_MARGIN = 6
"""Pixels around moving regions whose flow is not trusted as static: flow bleeds over the outline of what moves."""
MOVING_CONFIDENCE = 0.2
"""Largest confidence of the guessed depth of moving pixels in a clip with parallax."""
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
NO_CONTACT, MIN_CONTACT_FRAMES = 0.05, 0.25
"""Weight of the surroundings' depth for a body without ground contact; fraction of frames with contact below which the body's
size gives its distance."""
CONTACT_QUANTILE = 0.7
"""Quantile over the frames of a body's contacts that gives its distance: above the middle, as it may hop, never sink in."""
TOUCH_QUANTILE = 0.98
"""Quantile of the ratios along the lower edge at which a region touches the ground: columns beyond are noise."""
GROUND_FRACTION, GROUND_NOISE = 0.2, 0.03
"""How far below a moving region the ground is fitted (fraction of the image height), and how uneven ground may be (relative
inverse depth)."""
TURN_LIMIT, TURNS, TURN_COST = 1.5, 31, 0.05
"""Largest turn of a region against the view (relative inverse depth over the picture's width), how many are tried, and the
fraction of touching columns that a turn of 1 must win."""
BEHIND_WEIGHT = 0.03
"""Weight of a ground contact behind the object's depth: an object in the air is seen in front of farther ground, never behind
nearer ground."""
MIN_CONTACT_PIXELS = 8
"""With fewer free pixels below a moving region than this, it takes the depth of its surroundings."""
TILT_FRAMES, TILT_RANGE = 3.0, (0.5, 2.0)
"""Frames over which the turn of a region is smoothed, and the bounds of what it may do to the inverse depth."""
SIZE_NOISE, CONTACT_NOISE = 0.02, 0.05
"""Relative errors of the frame-to-frame size change and of one contact depth, used to smooth an object's depth."""
MIN_OBJECT_PIXELS = 30
"""Moving regions with fewer pixels per frame than this follow the static depth around them."""


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
    """Its structure, where it has one."""


@dataclass(frozen=True)
class _Maps:
    """Depth, its confidence and the moving mask of every pixel, each (F, H, W)."""

    inverse: np.ndarray
    """Inverse depth; written where objects move."""
    confidence: np.ndarray
    """0..1; written where objects move."""
    static_confidence: np.ndarray
    """`confidence` before anything was written."""
    moving: np.ndarray
    """bool."""


def place_objects(
    inverse: np.ndarray, confidence: np.ndarray, moving: np.ndarray, priors: Priors
) -> list[dict[str, Any]]:
    """Write the inverse depth of moving pixels into `inverse (F, H, W)` and its confidence into `confidence`, both in place.

    Returns one row per object: `group`, its first and last clip frame `frames`, what its depth was `decided_by` ("its own
    motion", "ground contact", "size" or "surroundings"), and `emf_degrees`, the angle of the rays its points were seen from
    in its own axes (0 where unknown).
    """
    maps = _Maps(inverse, confidence, confidence.copy(), moving)
    confidence[moving] = np.minimum(confidence[moving], GUESS_CONFIDENCE)
    labels, _ = ndimage.label(moving)
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
    rows: list[dict[str, Any]] = []
    for mover in (body for number in range(1, len(found) + 1) for body in bodies(number)):
        place = _place_upright_plane if mover.motion is None else _place_rigid_body
        decided = place(mover, maps, priors)
        rows.append(
            {
                "group": len(rows),
                "frames": [int(priors.frames[mover.frames[0]]), int(priors.frames[mover.frames[-1]])],
                "decided_by": decided,
                "emf_degrees": round(mover.motion.degrees, 1) if mover.motion else 0.0,
            }
        )
    return rows


def _labels_of_tracks(labels: np.ndarray, priors: Priors) -> np.ndarray:
    """(F, N) label under every visible track sample, 0 elsewhere."""
    if priors.tracks is None or priors.tracks_visible is None:
        return np.zeros((len(labels), 0), int)
    found = np.zeros(priors.tracks_visible.shape, int)
    for frame, seen in enumerate(priors.tracks_visible):
        column, row = np.floor(priors.tracks[frame, seen]).astype(int).T
        found[frame, seen] = labels[frame, np.clip(row, 0, priors.height - 1), np.clip(column, 0, priors.width - 1)]
    return found


def _tracks_mostly_inside(inside: np.ndarray, priors: Priors) -> np.ndarray:
    """(N,) bool: tracks whose visible samples mostly lie `inside (F, N)`."""
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
    if len(groups) < 2 or any(_in_one_component(piece[:, a], piece[:, b]) for a, b in combinations(groups, 2)):
        return [region]
    parts = [replace(region, tracks=region.tracks[group]) for group in groups]
    return _split(region, parts, priors)


def _in_one_component(one: np.ndarray, other: np.ndarray) -> bool:
    """Whether tracks `(f, n)`, `(f, m)` mostly lie in one piece of the mask (`MIN_TOGETHER`)."""
    shared = []
    for a, b in zip(one, other, strict=True):
        if (a > 0).any() and (b > 0).any():
            shared.append(np.bincount(a[a > 0]).argmax() == np.bincount(b[b > 0]).argmax())
    return not shared or float(np.mean(shared)) >= MIN_TOGETHER


def _rigid_bodies(region: _MovingObject, priors: Priors) -> list[_MovingObject]:
    """The rigid bodies of a region, the one with most tracks first; the region itself where none is found."""
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
    """Whether tracks `some` mostly have each other as neighbours rather than `others`: a separate object, not limbs of one."""
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
    """The motion restricted to the tracks that follow the body."""
    return replace(motion, z=motion.z[:, motion.inliers], inliers=motion.inliers[motion.inliers])


def _tracks_on(mover: _MovingObject, priors: Priors) -> TracksOnObject:
    """The tracks of a moving object with the cameras of its frames."""
    import cv2

    assert priors.tracks is not None and priors.tracks_visible is not None and priors.cameras is not None
    tracks = priors.tracks[np.ix_(mover.frames, mover.tracks)].astype(np.float64)
    visible = priors.tracks_visible[np.ix_(mover.frames, mover.tracks)].copy()
    outline = np.zeros(visible.shape)

    def measure(i: int) -> None:
        column, row = np.floor(tracks[i, visible[i]]).astype(int).T
        distance = cv2.distanceTransform(np.pad(mover.masks[i], 1).astype(np.uint8), cv2.DIST_L2, cv2.DIST_MASK_PRECISE)
        outline[i, visible[i]] = distance[
            1 + np.clip(row, 0, priors.height - 1), 1 + np.clip(column, 0, priors.width - 1)
        ]

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


def _place_upright_plane(mover: _MovingObject, maps: _Maps, priors: Priors) -> str:
    """Write an object without a structure of its own as one upright plane per frame; returns what decided its depth."""

    def contact(i: int) -> tuple[float, float, float]:
        f = mover.frames[i]
        return _contact(maps.inverse[f], maps.static_confidence[f], maps.moving[f], mover.masks[i])

    contacts = np.array(in_threads(contact, range(len(mover.frames))))
    size = np.array(
        in_threads(lambda i: _growth(priors, mover.frames[i], mover.masks[i]), range(len(mover.frames) - 1))
    )
    middle, tilt, trust = contacts.T
    solved, certain = smooth_object_depth(middle, trust, size)
    norm = ndimage.gaussian_filter1d(trust + 1e-3, TILT_FRAMES)
    tilt = ndimage.gaussian_filter1d(tilt * (trust + 1e-3), TILT_FRAMES) / norm
    for f, mask, value, slope, sure in zip(mover.frames, mover.masks, solved, tilt, certain, strict=True):
        y, x = np.nonzero(mask)
        maps.inverse[f][y, x] = value * np.clip(1 + slope * (x - x.mean()), *TILT_RANGE)
        maps.confidence[f][y, x] = MOVING_CONFIDENCE * sure if priors.camera_kind == "moving" else GUESS_CONFIDENCE
    stands = (trust > NO_CONTACT).mean()
    return "surroundings" if stands == 0 else "ground contact" if stands >= MIN_CONTACT_FRAMES else "size"


def _place_rigid_body(mover: _MovingObject, maps: _Maps, priors: Priors) -> str:
    """Write a rigid body at one scale for all frames; returns what decided its depth."""
    shapes = _relative_inverse(mover, priors)
    ratio, trust = np.zeros((2, len(shapes)))
    for i, (f, mask, shape) in enumerate(zip(mover.frames, mover.masks, shapes, strict=True)):
        edge = _ground_edge(maps.inverse[f], maps.static_confidence[f], maps.moving[f], mask)
        if edge is None:
            rim = ndimage.binary_dilation(mask, iterations=2 * MOVING_MARGIN) & ~maps.moving[f]
            around = maps.inverse[f][rim] if rim.any() else maps.inverse[f]
            ratio[i], trust[i] = np.median(around) / np.median(shape), NO_CONTACT
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
    """Inverse depth of the body's pixels per frame (rows of the mask ascending), from its points seen there, in its unit."""
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
    """Values `(n,)` known at `points (n, 2)` at the pixels `y, x (p,)`, never beyond the known ones."""
    every = -(-len(points) // MAX_KNOTS)
    smooth = RBFInterpolator(points[::every], values[::every], kernel="linear", smoothing=SMOOTH_PX)
    rows, columns = (np.arange(one.min(), one.max() + GRID_PX, GRID_PX) for one in (y, x))
    grid = np.stack(np.meshgrid(columns + 0.5, rows + 0.5), -1)
    coarse = smooth(grid.reshape(-1, 2)).reshape(grid.shape[:2])
    at = np.stack([(y - y.min()) / GRID_PX, (x - x.min()) / GRID_PX])
    return np.clip(ndimage.map_coordinates(coarse, at, order=1, mode="nearest"), *np.percentile(values, (2, 98)))


def one_scale(ratio: np.ndarray, trust: np.ndarray) -> float:
    """The factor of a body's inverse depth, from what every frame's ground asks for `(f,)`, with `trust (f,)` 0..1.

    The weighted quantile `CONTACT_QUANTILE` of what frames ask for: ground behind a body that is in the air asks for less.
    """
    order = np.argsort(ratio)
    weight = np.cumsum((trust + 1e-3)[order])
    return float(ratio[order][np.searchsorted(weight, CONTACT_QUANTILE * weight[-1])])


def smooth_object_depth(contact: np.ndarray, trust: np.ndarray, growth: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Inverse depth `(f,)` of one object over time, and its certainty 0..1.

    `contact (f,)` inverse depths where it touches the ground with `trust (f,)` 0..1, `growth (f - 1,)` logarithm of its
    change of picture size to the next frame (NaN = unknown). Size is inverse depth times a constant, so
    `argmin sum trust (x - log contact)^2 / c^2 + sum (x' - x - growth)^2 / s^2`, x = log inverse depth; Cauchy weights
    on the contacts, and little weight where the ground is seen behind the object (`BEHIND_WEIGHT`).
    """
    count, measured = len(contact), np.log(contact)
    known = np.isfinite(growth)
    step = np.where(known, growth, 0.0)
    link = np.where(known, 1 / SIZE_NOISE**2, 1 / (5 * SIZE_NOISE) ** 2)
    laplacian = np.zeros((count, count))
    right = np.zeros(count)
    for i in range(count - 1):
        laplacian[i : i + 2, i : i + 2] += link[i] * np.array([[1, -1], [-1, 1]])
        right[i : i + 2] += link[i] * step[i] * np.array([-1, 1])
    solution = np.full(count, np.average(measured, weights=trust + 1e-6))
    for _ in range(5):
        weight = (trust + 1e-3) / CONTACT_NOISE**2 / (1 + ((measured - solution) / (2 * CONTACT_NOISE)) ** 2)
        weight *= np.where(measured < solution, BEHIND_WEIGHT, 1.0)
        solution = np.linalg.solve(laplacian + np.diag(weight), right + weight * measured)
    return np.exp(solution), np.clip(trust, 0.25, 1.0)


@dataclass(frozen=True)
class _GroundEdge:
    """The ground behind the lower edge of a region, n of its columns."""

    columns: np.ndarray
    """(n,) int."""
    run: np.ndarray
    """(n,) columns from the region's mean one."""
    ground: np.ndarray
    """(n,) inverse depth of the ground at the region's lowest pixel."""
    trust: float
    """0..1."""


def _ground_edge(
    inverse: np.ndarray, confidence: np.ndarray, moving: np.ndarray, own: np.ndarray
) -> _GroundEdge | None:
    """The ground that a region is seen in front of, carried up to its lower edge; None where too little of it is seen.

    The ground is a plane, so its inverse depth is linear in the picture; it is fitted below the region, where flow is free.
    """
    height = len(own)
    columns = np.flatnonzero(own.any(0))
    bottom = height - 1 - np.argmax(own[::-1], axis=0)[columns]
    rows = np.arange(height)[:, None]
    lowest = int(bottom.max()) + MOVING_MARGIN + round(GROUND_FRACTION * height)
    ground = (rows > bottom + MOVING_MARGIN) & (rows <= lowest) & ~moving[:, columns]
    y, which = np.nonzero(ground)
    if len(y) < MIN_CONTACT_PIXELS:
        return None
    run = columns - np.nonzero(own)[1].mean()  # (n,)
    values = inverse[y, columns[which]].astype(np.float64)
    offset = np.stack([np.ones(len(y)), run[which], y - bottom.max() - 1.0], 1)
    given = confidence[y, columns[which]].astype(np.float64) ** 2 + 1e-3
    weight = given
    for _ in range(6):
        normal = (offset * weight[:, None]).T @ offset + np.diag(
            [0.0, 1.0, 1.0]
        ) * given.sum()  # ridge: one pixel's worth
        plane = np.linalg.solve(normal, offset.T @ (weight * values))
        weight = given / (1 + ((values - offset @ plane) / (GROUND_NOISE * abs(plane[0]) + 1e-9)) ** 2)
    edge = plane[0] + plane[1] * run + plane[2] * (bottom - bottom.max())
    hidden = float((bottom >= height - 2).mean())  # it leaves the picture below: the true contact is nearer
    trust = float(np.clip(1 - 2 * hidden, 0.1, 1.0) * np.sqrt(given.mean()).clip(0.1, 1))
    return _GroundEdge(columns, run, edge, trust)


def _contact(
    inverse: np.ndarray, confidence: np.ndarray, moving: np.ndarray, own: np.ndarray
) -> tuple[float, float, float]:
    """Where a region stands: inverse depth at its mean column, relative change per column, and trust 0..1.

    Nothing is behind the ground that it is seen in front of, so the region, an upright plane of inverse depth
    `a (1 + b (column - mean))`, lies above the ground's values on its lower edge and touches them at its feet; of all turns
    `b` the one that touches most columns is taken (feet and wheels do, bellies and tails do not).
    """
    found = _ground_edge(inverse, confidence, moving, own)
    if found is None:
        rim = ndimage.binary_dilation(own, iterations=2 * MOVING_MARGIN) & ~moving
        return float(np.median(inverse[rim] if rim.any() else inverse)), 0.0, NO_CONTACT
    width, edge, run = own.shape[1], found.ground, found.run
    usual = max(float(edge.max()), 1e-6)
    best, a, b = -np.inf, usual, 0.0
    for turn in np.linspace(-TURN_LIMIT, TURN_LIMIT, TURNS) / width:  # relative change per column
        touching = float(np.quantile(edge / (1 + turn * run), TOUCH_QUANTILE))
        gap = 1 - edge / (touching * (1 + turn * run))
        score = float(np.exp(-((gap / GROUND_NOISE) ** 2)).mean()) - TURN_COST * (turn * width) ** 2
        if score > best:
            best, a, b = score, touching, turn
    return max(a, 0.3 * usual), b, found.trust


def _growth(priors: Priors, frame: int, own: np.ndarray) -> float:
    """Logarithm of a region's change of size to the next frame, from a robust similarity of its flow; NaN if unknown."""
    if priors.flow_forward is None or priors.flow_forward_mask is None:
        return float("nan")
    y, x = np.nonzero(own & priors.flow_forward_mask[frame])
    if len(x) < MIN_OBJECT_PIXELS:
        return float("nan")
    here = np.stack([x + 0.5, y + 0.5], 1)
    there = here + priors.flow_forward[frame][y, x].astype(np.float64)
    weight = np.ones(len(x))
    for _ in range(4):
        p = here - np.average(here, axis=0, weights=weight)
        q = there - np.average(there, axis=0, weights=weight)
        a, b = p[:, 0] + 1j * p[:, 1], q[:, 0] + 1j * q[:, 1]
        factor = (weight * b * a.conj()).sum() / (weight * abs(a) ** 2).sum()  # scale and turn as one complex number
        weight = 1 / (1 + abs(b - factor * a) ** 2)
    return float(np.clip(np.log(abs(factor)), -0.2, 0.2))
