"""Depth of people: limbs in front of and behind each other by their joints, at the distance at which their feet stand.

A person's joints are known in metres from between the hips and in pixels of the picture, so the picture's scale at the body
is known too: the distance as a number of metres, and how it changes. Feet on the ground tell the distance in the scene's
unit; who rides, hangs or is cut off at the feet has the distance of the moving region. Every pixel gets the depth of the limb
that it lies on.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import partial
from typing import TYPE_CHECKING

import numpy as np
from scipy import ndimage

from ..parallel import in_threads
from .contact import (
    MIN_CONTACT_FRAMES,
    NO_CONTACT,
    DepthMaps,
    GroundEdge,
    ground_edge,
    guessed_confidence,
    inverse_around,
    one_scale,
    without_upright,
)
from .feet import Foot, on_their_feet, standing_still, touching_feet
from .joints import ANKLES, FEET, HIPS, LIMBS, SHOULDERS, to_segments, turn_to_ray
from .moving_people import dilate_masks, shows_person

if TYPE_CHECKING:
    from .folder import Priors

SEEN = 0.3
"""Visibility from which a joint tells anything."""
SMOOTH_FRAMES = 1.5
"""Gaussian (frames) over which joints in metres are smoothed: they tremble more than people do."""
SIZE_FRAMES, SIZE_ROUNDS = 6.0, 10
"""Frames over which a body's size may bend, and rounds of its robust smoothing: what networks believe of it sways by 2 to 5 % with
every stride. 6 chosen on people-walk, -turn and -cross (sway .018, .025, .047 with a median and a Gaussian of 2, then .011, .023,
.017)."""
UNSTEADY = 0.1
"""Scatter (of the logarithm) of a body's size about the smoothed one from which it is none: people have .01 to .08, patterns that
are taken for people .12 to .18."""
HALF_WIDTH = {"head": 0.1, "torso": 0.12, "arm": 0.05, "hand": 0.045, "leg": 0.075, "foot": 0.045}
"""Meters from the bones of a part of the body to its skin. Measured from masks they bring no more (mean relief errors, people-walk,
-turn and -cross: .0460 in place of .0466), and rounding limbs loses (.0489): joints are too rough for it."""
NEARER = 0.75
"""Skin that is seen is nearer than the bones by this fraction of the half width, mean across a limb."""
SHARED, FALLOFF, BEHIND = 0.3, 4, 0.15
"""Limbs share a pixel by 1 / (distance in half widths + `SHARED`)^`FALLOFF`, and by the meters they are behind the nearest."""
MAX_RELIEF = 0.3
"""Largest difference of depth within a body, as a fraction of its distance: an arm's length at two meters."""
LEGS, TRUNK = np.arange(25, 33), np.arange(25)
"""Joints below the hips, and the others."""
MAX_LEAN = np.radians(25)
"""Largest median lean of a standing body along the view that counts as an error of the networks."""
BESIDE = 12
"""Pixels around a body that move with it: clothes and what is held have the depth of the nearest limb."""
FRAGMENT = 0.25
"""A piece of the moving mask that touches people is no object of its own below this fraction of their pixels."""
MIN_JOINTS, MIN_PIXELS = 8, 40
"""Joints and pixels that a frame needs to show a body's relief."""
STANDS = "feet"
"""Name of a distance that comes from feet on the ground."""


SEGMENTS = np.array([pair for pairs in LIMBS.values() for pair in pairs])
"""(s, 2) the joints at the ends of all segments of `LIMBS`."""
HALF_WIDTHS = np.array([HALF_WIDTH[name.split()[-1]] for name, pairs in LIMBS.items() for _ in pairs])
"""(s,) of each of them."""


@dataclass(frozen=True)
class Body:
    """The joints of one person in one frame."""

    pixels: np.ndarray
    """(33, 2)."""
    metres: np.ndarray
    """(33, 3) from between the hips."""
    weight: np.ndarray
    """(33,) visibility, 0 where it tells nothing."""

    @property
    def pixels_per_metre(self) -> float:
        """Scale of the picture at the body: least squares between the joints in pixels and in metres."""
        weight = self.weight[:, None] / self.weight.sum()
        here = self.pixels - (weight * self.pixels).sum(0)
        there = self.metres[:, :2] - (weight * self.metres[:, :2]).sum(0)
        return float((weight * here * there).sum() / max((weight * there**2).sum(), 1e-9))

    def leaning(self, below: float, above: float) -> Body:
        """Return the body with its legs and the rest turned away from the camera by so many radians, about between the hips."""
        metres = np.empty_like(self.metres)
        for joints, angle in ((LEGS, below), (TRUNK, above)):
            sine, cosine = np.sin(angle), np.cos(angle)
            turn = np.array([[1, 0, 0], [0, cosine, sine], [0, -sine, cosine]])
            metres[joints] = self.metres[joints] @ turn.T
        return replace(self, metres=metres)

    def relief(self, y: np.ndarray, x: np.ndarray) -> np.ndarray:
        """Return (n,) metres along the view, from between the hips, to the skin of the limbs at pixels `y, x (n,)`."""
        known = (self.weight[SEGMENTS] > 0).all(1)
        (start, end), half = SEGMENTS[known].T, HALF_WIDTHS[known]
        apart, part = to_segments(np.stack([x + 0.5, y + 0.5], 1), self.pixels[start], self.pixels[end])
        skin = self.metres[start, 2] * (1 - part) + self.metres[end, 2] * part - NEARER * half  # (n, segments)
        weight = 1 / (apart / self.pixels_per_metre / half + SHARED) ** FALLOFF
        weight *= np.exp(-(skin - skin.min(1, keepdims=True)) / BEHIND)
        return (weight * skin).sum(1) / weight.sum(1)


@dataclass(frozen=True)
class _Seen:
    """A person in one frame."""

    frame: int
    """Row of the priors."""
    body: Body
    edge: GroundEdge | None
    """The ground below; None where none is seen."""


@dataclass(frozen=True)
class PlacedPeople:
    """People whose distance is known from their feet."""

    pixels: np.ndarray
    """(F, H, W) bool: theirs, moving ones close beside them, and fragments of the mask that touch them."""
    frames: list[np.ndarray]
    """Rows of the priors in which each of them is seen."""
    masks: list[np.ndarray]
    """(f, H, W) bool, the pixels of each of them there."""


def place_people(maps: DepthMaps, priors: Priors) -> PlacedPeople:
    """Write the depth of moving people who stand on the ground into `maps`, in place."""
    placed = PlacedPeople(np.zeros_like(maps.moving), [], [])
    if priors.people is None or priors.people_joints is None or priors.people_metres is None or priors.cameras is None:
        return placed
    for person in range(priors.people_joints.shape[1]):
        shown = shows_person(priors, person + 1) & maps.moving
        bodies = _bodies_in_camera(priors, person)
        frames = np.flatnonzero((shown.sum((1, 2)) >= MIN_PIXELS) & np.isin(np.arange(len(shown)), list(bodies)))
        if len(frames) == 0:
            continue
        measured = np.array([bodies[frame].pixels_per_metre for frame in frames])
        smooth = smooth_scales(frames, measured)
        if np.std(np.log(measured / smooth)) > UNSTEADY:
            continue
        size = smooth / priors.cameras.intrinsics[frames, 0, 0]
        edges = in_threads(partial(_ground_below, maps, shown), frames.tolist())
        edges = without_upright(edges, priors.cameras.intrinsics[frames])
        bodies = _upright(bodies, dict(zip(frames.tolist(), edges, strict=True)), priors.cameras.intrinsics)
        seen = [_Seen(int(frame), bodies[frame], edge) for frame, edge in zip(frames, edges, strict=True)]
        feet = _standing_feet(maps, shown, seen, priors, size)
        contact, trust = _contacts(maps, shown, seen, feet, size)
        if (trust > NO_CONTACT).mean() < MIN_CONTACT_FRAMES:
            continue
        # One factor: things that hide feet pass for nearer ground (parkour), which smoothing over time would follow.
        hips = size * one_scale(contact / size, trust)
        certain = np.clip(trust, 0.25, 1.0)
        standing = on_their_feet([one.body for one in seen], feet, frames, size, hips, NEARER * HALF_WIDTH["foot"])
        for frame, body, inverse, per_metre, sure in zip(frames, standing, hips, size, certain, strict=True):
            own = _with_clothes(shown[frame], maps.moving[frame] & (priors.people[frame] == 0))
            y, x = np.nonzero(own)
            maps.inverse[frame][y, x] = inverse / (1 + _limited(body.relief(y, x) * per_metre))
            maps.confidence[frame][y, x] = guessed_confidence(priors, sure)
            placed.pixels[frame] |= own
        placed.frames.append(frames)
        placed.masks.append(shown[frames])
    if placed.frames:
        _take_fragments(maps, placed)
    return placed


def _take_fragments(maps: DepthMaps, placed: PlacedPeople) -> None:
    """Give small pieces of the moving mask that touch people the depth of the nearest pixel of theirs: halos, shadows, hems."""
    labels, _ = ndimage.label(maps.moving & ~placed.pixels)
    near = np.unique(labels[ndimage.binary_dilation(placed.pixels)])
    small = np.bincount(labels.ravel()) < FRAGMENT * placed.pixels.sum()
    fragments = near[(near > 0) & small[near]]
    taken = np.isin(labels, fragments) & placed.pixels.any((1, 2))[:, None, None]
    for frame in np.flatnonzero(taken.any((1, 2))):
        nearest = ndimage.distance_transform_edt(~placed.pixels[frame], return_distances=False, return_indices=True)
        own = taken[frame]
        for values in (maps.inverse[frame], maps.confidence[frame]):
            values[own] = values[tuple(nearest[:, own])]
    placed.pixels[:] |= taken


def _ground_below(maps: DepthMaps, shown: np.ndarray, frame: int) -> GroundEdge | None:
    """Return the ground behind the lower edge of the person `shown (F, H, W)` in a frame."""
    return ground_edge(maps.inverse[frame], maps.static_confidence[frame], maps.moving[frame], shown[frame])


def _upright(bodies: dict[int, Body], edges: dict[int, GroundEdge | None], intrinsics: np.ndarray) -> dict[int, Body]:
    """Turn legs and trunks of the bodies along the view so that in the median they rise vertically from the standing foot.

    Somebody who walks or turns is above the standing foot in the mean: within 3 degrees in four rendered clips, where networks
    put the hips 4, 15, 18 and 23 degrees nearer, as most pictures look down on people. `edges`: the ground below the body, by
    frame.
    """
    legs, trunk = [], []
    for frame, edge in edges.items():
        if edge is not None:
            up, metres = edge.normal(intrinsics[frame]), bodies[frame].metres
            hips, ankle = metres[list(HIPS)].mean(0), metres[_lower_ankle(metres)]
            legs.append(_lean(hips - ankle, up))
            trunk.append(_lean(metres[list(SHOULDERS)].mean(0) - hips, up))
    below, above = (float(np.median(leans)) if leans else 0.0 for leans in (legs, trunk))
    if max(abs(below), abs(above)) > MAX_LEAN:
        return bodies
    return {frame: body.leaning(-below, -above) for frame, body in bodies.items()}


def _lower_ankle(metres: np.ndarray) -> int:
    """Return the ankle of the foot that stands, from the joints `(33, 3)` of a body."""
    left, right = (metres[list(foot), 1].max() for foot in (FEET[::2], FEET[1::2]))
    return ANKLES[int(right > left)]


def _lean(rise: np.ndarray, up: np.ndarray) -> float:
    """Return the angle along the view by which `rise (3,)` leans away from the camera, against `up (3,)`; camera axes."""
    return float(np.arctan2(rise[2], -rise[1]) - np.arctan2(up[2], -up[1]))


def _standing_feet(
    maps: DepthMaps, shown: np.ndarray, seen: list[_Seen], priors: Priors, size: np.ndarray
) -> list[list[Foot]]:
    """Return the feet of the person `shown (F, H, W)` that stand in each of the frames in which they are `seen`.

    size: (f,) a metre at the body, as a fraction of its distance.
    """
    cameras = priors.cameras
    assert cameras is not None

    def touching(one: _Seen) -> list[Foot]:
        own, moving, edge = shown[one.frame], maps.moving[one.frame], one.edge
        return [] if edge is None else touching_feet(one.body, own, moving, edge, cameras[one.frame])

    return standing_still(in_threads(touching, seen), cameras, np.array([one.frame for one in seen]), size)


def _contacts(
    maps: DepthMaps, shown: np.ndarray, seen: list[_Seen], feet: list[list[Foot]], size: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Return the inverse depth of the hips `(f,)` in each of the frames, from the feet that stand, and its trust `(f,)` 0..1.

    Frames without a foot on the ground have the inverse depth of what is around, with little trust. As in `_standing_feet`.
    """
    contact, trust = np.empty((2, len(seen)))
    for i, (one, some) in enumerate(zip(seen, feet, strict=True)):
        if one.edge is None or not some:
            contact[i] = inverse_around(maps.inverse[one.frame], maps.moving[one.frame], shown[one.frame])
            trust[i] = NO_CONTACT
            continue
        along = one.body.metres[[joint for foot in some for joint in foot.joints], 2]
        contact[i] = np.mean(np.concatenate([foot.ground for foot in some]) * (1 + along * size[i]))
        trust[i] = one.edge.trust
    return contact, trust


def _with_clothes(shown: np.ndarray, free: np.ndarray) -> np.ndarray:
    """Return (H, W) bool: the person `shown` and what is `free` close beside them: clothes and what they hold."""
    return shown | (free & dilate_masks(shown[None], BESIDE)[0])


def _limited(relief: np.ndarray) -> np.ndarray:
    """Return the differences of depth as fractions of the body's distance, at most `MAX_RELIEF`."""
    return np.clip(relief, -MAX_RELIEF, MAX_RELIEF)


def add_relief(inverse: np.ndarray, guessed: np.ndarray, priors: Priors) -> int:
    """Write the relief of people into `inverse (F, H, W)`, in place, where they are on a plane: `guessed (F, H, W)` bool.

    What is there gives each body's distance in each frame: the median of its inverse depth. Returns how many people have a
    relief.
    """
    if priors.people is None or priors.people_joints is None or priors.people_metres is None or priors.cameras is None:
        return 0
    found = 0
    for person in range(priors.people_joints.shape[1]):
        shown = shows_person(priors, person + 1) & guessed
        bodies = _bodies_in_camera(priors, person)
        frames = [frame for frame in bodies if shown[frame].sum() >= MIN_PIXELS]
        scales = smooth_scales(np.array(frames), np.array([bodies[frame].pixels_per_metre for frame in frames]))
        for frame, scale in zip(frames, scales, strict=True):
            beside = guessed[frame] & (priors.people[frame] == 0)
            per_metre = scale / float(priors.cameras.intrinsics[frame, 0, 0])
            _write(inverse[frame], shown[frame], beside, bodies[frame], per_metre)
        found += bool(frames)
    return found


def _write(inverse: np.ndarray, shown: np.ndarray, beside: np.ndarray, body: Body, per_metre: float) -> None:
    """Write a body's relief into one frame's `inverse (H, W)`: where it is `shown`, and on what is close `beside` it.

    per_metre: a metre at the body, as a fraction of its distance.
    """
    y, x = np.nonzero(_with_clothes(shown, beside))
    distance = 1 / float(np.median(inverse[shown]))
    middle = float(np.median(body.relief(*np.nonzero(shown))))
    inverse[y, x] = 1 / (distance * (1 + _limited((body.relief(y, x) - middle) * per_metre)))


def _bodies_in_camera(priors: Priors, person: int) -> dict[int, Body]:
    """Return a dictionary from frame to the body of `person` (0 = first), with metres in the camera's axes.

    Whoever stands in the lower half of the picture is looked down on, and would lean backwards along the ray to them.
    """
    assert priors.people_joints is not None and priors.people_metres is not None and priors.cameras is not None
    joints, metres = priors.people_joints[:, person], priors.people_metres[:, person]
    turns = turn_to_ray(joints, priors.cameras.intrinsics)
    return bodies_of(joints, np.einsum("fij,fkj->fki", turns, metres))


def bodies_of(joints: np.ndarray, metres: np.ndarray) -> dict[int, Body]:
    """Return a dictionary from frame to body, from joints `(F, 33, 3)` and metres `(F, 33, 3)`.

    Frames that show too few joints, or joints in pixels that contradict those in metres, are left out.
    """
    seen = np.isfinite(joints).all((1, 2))
    weight = np.where(seen[:, None], np.nan_to_num(joints[..., 2]), 0)
    norm = ndimage.gaussian_filter1d(seen.astype(np.float64), SMOOTH_FRAMES)
    smooth = ndimage.gaussian_filter1d(np.nan_to_num(metres).astype(np.float64), SMOOTH_FRAMES, axis=0)
    smooth /= np.maximum(norm, 1e-6)[:, None, None]
    sure = np.where(weight >= SEEN, weight, 0)
    frames = np.flatnonzero(seen & ((sure > 0).sum(1) >= MIN_JOINTS))
    bodies = {int(f): Body(joints[f, :, :2].astype(np.float64), smooth[f], sure[f]) for f in frames}
    return {frame: body for frame, body in bodies.items() if body.pixels_per_metre > 0}


def smooth_scales(frames: np.ndarray, scales: np.ndarray) -> np.ndarray:
    """Return (f,) a smoothing spline through the logarithms of `scales (f,)`: of a pose that is seen along the view, it is a guess.

    `argmin sum w (x - log scale)^2 + SIZE_FRAMES^4 sum (second difference of x)^2`, w Cauchy weights. frames: (f,) rising.
    """
    if len(frames) == 0:
        return np.zeros(0)
    measured = np.log(scales)
    count, row = int(frames[-1] - frames[0]) + 1, frames - frames[0]
    bend = np.diff(np.eye(count), 2, axis=0)
    stiff = SIZE_FRAMES**4 * bend.T @ bend + 1e-9 * np.eye(count)
    weight = np.ones(len(frames))
    for _ in range(SIZE_ROUNDS):
        system, right = stiff.copy(), np.zeros(count)
        system[row, row] += weight
        right[row] = weight * measured
        off = measured - np.linalg.solve(system, right)[row]
        weight = 1 / (1 + (off / (2 * 1.48 * np.median(abs(off)) + 1e-6)) ** 2)
    return np.exp(measured - off)
