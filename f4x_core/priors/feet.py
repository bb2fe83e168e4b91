"""Feet on the ground: which of them stand, the distance of the body that they give, and legs that end where their feet stand.

A foot seems to touch the ground in every frame, for the ground behind it is seen below it. Where it truly stands, the place on the
ground stays the same from frame to frame; under a foot that swings it runs.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
from scipy import ndimage

from .contact import MIN_CONTACT_FRAMES, MOVING_MARGIN, GroundEdge
from .joints import FEET, LEGS

if TYPE_CHECKING:
    from ..geometry.camera import Camera, CameraPath
    from .body_depth import Body

FOOT_WIDTH, FOOT_HEIGHT, STANDING = 0.06, 0.25, 0.08
"""Meters: half the width of a foot below its joint, how far below it its lowest pixel may lie, and how much higher than the lower
foot the other one may be and still stand; a joint as far below the lowest pixel is hidden by something nearer."""
FOOT_SEEN = 0.5
"""Visibility from which a foot may stand: hidden ones are guesses."""
STILL, STILL_FRAMES = 0.06, 2
"""Meters a frame, across the view, by which the ground seen below a standing foot goes at most, median over so many frames before
and after. Chosen with the three below on people-walk, -turn and -cross: standing feet slip by 3.3, 3.2 and 5.0 cm a frame in place
of 4.3, 3.3 and 4.6 (8.3 where swinging feet count, too), and are 2.0, 1.9 and 2.3 % off in place of 2.5, 2.7 and 1.5; the figures'
own feet slip by 2.3, 3.7 and 2.2."""
MAX_BEND, BEND_FRAMES, BEND_ALONE = 0.25, 1.5, 0.3
"""Largest correction of a foot along the view (meters), Gaussian (frames) over which it is smoothed, and weight of none."""
KNEE = 0.5
"""Part of a foot's correction that the knee takes."""


@dataclass(frozen=True)
class Foot:
    """A foot that seems to stand, in one frame; k of its heel and toes do."""

    side: int
    """Row of `LEGS`."""
    joints: list[int]
    """(k,)"""
    ground: np.ndarray
    """(k,) inverse depth of the ground at their lowest pixels."""
    pixels: np.ndarray
    """(k, 2)"""
    places: np.ndarray
    """(k, 3) of that ground in the world."""


def touching_feet(body: Body, own: np.ndarray, moving: np.ndarray, edge: GroundEdge, camera: Camera) -> list[Foot]:
    """Return the feet of the person `own (H, W)` bool that seem to stand on the ground `edge`, which does not move.

    moving: (H, W) bool, all that moves.
    """
    found = []
    standing = _lowest_pixels(body, own, moving)
    for side, leg in enumerate(LEGS):
        pixels = {joint: standing[joint] for joint in leg if joint in standing}
        if not pixels:
            continue
        edges = np.array(list(pixels.values())) + np.array([0.5, 1.0])
        ground = np.maximum(np.interp(edges[:, 0] - 0.5, edge.columns, edge.ground), 1e-9)
        ray = np.column_stack([camera.on_plane(edges), np.ones(len(edges))])
        places = (ray / ground[:, None]) @ camera.camera_to_world[:3, :3].T + camera.camera_to_world[:3, 3]
        found.append(Foot(side, list(pixels), ground, edges, places))
    return found


def _lowest_pixels(body: Body, own: np.ndarray, moving: np.ndarray) -> dict[int, tuple[int, int]]:
    """Return the joints of heels and toes that may stand, each with (column, row) of the person's lowest pixel below it."""
    unit = body.pixels_per_metre
    seen = [joint for joint in FEET if body.weight[joint] >= FOOT_SEEN]
    lowest = max((body.metres[joint, 1] for joint in seen), default=0.0)
    reach, found = max(round(FOOT_HEIGHT * unit), MOVING_MARGIN), {}
    for joint in seen:
        x, y = body.pixels[joint]
        near = slice(max(int(x - FOOT_WIDTH * unit), 0), max(int(x + FOOT_WIDTH * unit), 0) + 1)
        rows = np.flatnonzero(own[:, near].any(1))
        if len(rows) == 0 or body.metres[joint, 1] < lowest - STANDING:
            continue
        bottom = int(rows[-1])
        column = near.start + int(np.argmax(own[bottom, near]))
        below = moving[bottom + 1 : bottom + 1 + reach, column]  # what it stands on, a board or a horse, may move
        if (
            -max(STANDING * unit, 1) <= bottom - y <= reach
            and bottom < len(own) - 2
            and below[len(below) // 2 :].mean() < 0.5
        ):
            found[joint] = column, bottom
    return found


def standing_still(
    feet: Sequence[list[Foot]], cameras: CameraPath, frames: np.ndarray, size: np.ndarray
) -> list[list[Foot]]:
    """Return the `feet` of each of the frames (f,) without those below which the ground runs; all of them where hardly any is left.

    size: (f,) a metre at the body, as a fraction of its distance.
    """

    def speed(i: int, foot: Foot) -> float:
        """Return metres a frame across the view, 0 where the foot touches in no frame near."""
        camera, speeds = cameras[frames[i]], [0.0]
        metre = size[i] * camera.intrinsics[0, 0]  # pixels
        for k in np.flatnonzero((abs(frames - frames[i]) <= STILL_FRAMES) & (frames != frames[i])):
            apart = [
                np.linalg.norm(camera.project(other.places)[0][other.joints.index(joint)] - pixel)
                for other in feet[k]
                for joint, pixel in zip(foot.joints, foot.pixels, strict=True)
                if joint in other.joints
            ]
            speeds += [min(apart) / metre / abs(frames[k] - frames[i])] if apart else []
        return float(np.median(speeds[1:] or speeds))

    still = [[foot for foot in some if speed(i, foot) < STILL] for i, some in enumerate(feet)]
    return still if sum(map(bool, still)) >= MIN_CONTACT_FRAMES * len(feet) else list(feet)


def on_their_feet(
    bodies: Sequence[Body],
    feet: Sequence[list[Foot]],
    frames: np.ndarray,
    size: np.ndarray,
    hips: np.ndarray,
    skin: float,
) -> list[Body]:
    """Return the `bodies` in each of the frames (f,) with legs bent along the view until standing feet are where their ground is.

    size: as in `standing_still`; hips: (f,) inverse depth between them; skin: metres from a foot's joints to the ground seen below
    them, along the view.
    """
    off, known = np.zeros((2, len(LEGS), int(frames[-1] - frames[0]) + 1))
    for frame, body, some, inverse, per_metre in zip(frames - frames[0], bodies, feet, hips, size, strict=True):
        for foot in some:
            there = (inverse / foot.ground - 1) / per_metre + skin
            off[foot.side, frame] = np.clip(np.mean(there - body.metres[foot.joints, 2]), -MAX_BEND, MAX_BEND)
            known[foot.side, frame] = 1
    near = ndimage.gaussian_filter1d(known, BEND_FRAMES, axis=1)
    off = ndimage.gaussian_filter1d(off, BEND_FRAMES, axis=1) / (near + BEND_ALONE)

    def bent(body: Body, by: np.ndarray) -> Body:
        metres = body.metres.copy()
        for (knee, *foot), along in zip(LEGS, by, strict=True):
            metres[foot, 2] += along
            metres[knee, 2] += KNEE * along
        return replace(body, metres=metres)

    return [bent(body, off[:, frame]) for frame, body in zip(frames - frames[0], bodies, strict=True)]
