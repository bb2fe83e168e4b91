"""Guess of the world before a camera that stands: a ground plane, and upright objects on it.

From one place no depth can be measured. What walks about shows the ground: on a plane the size of a thing in the picture is
proportional to the rows between its lowest point and the horizon (Hoiem et al., "Putting Objects in Perspective", 2006).
People count together, as the scale of the picture at their bodies is known in metres; every other moving object has a
constant of its own. Where nothing walks, the horizon lies where it usually does.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from scipy import ndimage

from ..geometry.camera import Camera, CameraPath
from ..parallel import in_threads
from .body_depth import bodies_of, smooth_scales
from .contact import GUESS_CONFIDENCE
from .feet import FOOT_SEEN
from .flow import pixel_grid
from .joints import FEET

if TYPE_CHECKING:
    from .folder import Priors

USUAL_HORIZON, HORIZON_SPREAD, KNOWN = 0.35, 0.2, 0.4
"""Row of the horizon where nothing tells it, and its standard deviation, in picture heights (phones look a little down); the
horizon is known when contacts leave less than the third of that deviation."""
SIZE_NOISE, EFFECTIVE_FRAMES, OUTRIGHT = 0.1, 5.0, 3.0
"""Relative error of one size, the frames over which such errors are alike, so that they count as one, and the error of what cannot
be."""
HORIZON_RANGE, HORIZON_STEP = 1.0, 0.005
"""Rows above the picture up to which the horizon is looked for, and the distance of those that are tried, in picture heights."""
HEIGHTS = (0.02, 50.0)
"""Heights of things, in heights of the camera above the ground, that can be measured."""
MIN_PIXELS, MIN_FRAMES, EDGE = 60, 6, 2
"""Pixels and frames that an object needs to tell anything, and rows and columns at the border: who reaches them is cut off."""
MIN_PERSON_OVERLAP = 0.5
"""A moving region that lies on people by this fraction is placed by their joints."""
FARTHEST, BEHIND, USUAL_BASE = 0.05, 0.7, 0.25
"""The background stands upright behind the ground. Its foot lies at the second fraction of the way from the horizon to the
row of the farthest contacts (their quantile is the first), and at the third of the way to the lower edge without any."""
LEAN, LEAN_SPAN = 0.5, 0.5
"""Things above the horizon are farther: their inverse depth falls by the first fraction over the second, a tangent."""
MIN_ERROR, PRECISION_OF_HALF = 0.15, 50.0
"""Least relative error of guessed depth of the ground, and 1 / variance of the relative error that is worth a confidence of
one half, as in depth that is measured."""


@dataclass(frozen=True)
class Contacts:
    """Sightings (n) of things of known relative size where they touch the ground."""

    row: np.ndarray
    """(n,) pixels from the top."""
    size: np.ndarray
    """(n,) height in pixels; of people pixels per metre."""
    group: np.ndarray
    """(n,) int: what has the same true size has the same number; 0 = people."""


@dataclass(frozen=True)
class Lens:
    """Lens of the camera and size of its pictures, pixels."""

    focal: float
    middle: float
    """Row of the principal point."""
    height: int


@dataclass(frozen=True)
class GuessedWorld:
    """A ground plane and an upright background behind it."""

    horizon: float
    """Row of the horizon, pixels."""
    horizon_error: float
    """Standard deviation of the horizon, pixels."""
    base: float
    """Row at which the background stands on the ground, pixels."""
    contacts: int
    """Sightings that it comes from."""
    people: bool
    """True where people are among them."""
    height: int
    """Height of the picture, pixels."""

    @property
    def known(self) -> bool:
        """True where contacts tell the horizon better than what is usual."""
        return self.horizon_error < KNOWN * HORIZON_SPREAD * self.height

    def down(self, camera: Camera) -> np.ndarray:
        """Return (3,) unit vector: down in the axes of the camera that defines the world."""
        focal, middle = camera.intrinsics[1, 1], camera.intrinsics[1, 2]
        down = np.array([0.0, 1.0, (middle - self.horizon) / focal])
        return down / np.linalg.norm(down)

    def inverse_depth(self, cameras: CameraPath, feet: np.ndarray | None = None) -> np.ndarray:
        """Return (F, H, W) float32 inverse depth; the unit is that of the camera's height above the ground.

        feet: (H,W) row of the foot of the upright object at each pixel of the first frame, 0 for none.
        """
        import cv2

        first, every = cameras[0], pixel_grid(cameras.height, cameras.width)
        down = first.world_to_camera[:3, :3].T @ self.down(first)
        foot = self._below(self.base, first)
        upright = np.zeros(every.shape[:2]) if feet is None else np.where(feet > 0, self._below(feet, first), 0)
        upright = upright.astype(np.float32)

        def draw(frame: int) -> np.ndarray:
            camera = cameras[frame]
            below = slope(camera, every, down)
            far = foot * (1 - LEAN * np.clip(-below / LEAN_SPAN, 0, 1))
            turn = camera.world_to_camera[:3, :3] @ first.world_to_camera[:3, :3].T
            shift = camera.intrinsics @ turn @ np.linalg.inv(first.intrinsics)
            near = cv2.warpPerspective(upright, shift, upright.shape[::-1], flags=cv2.INTER_NEAREST)
            # Things end at twice the camera's height at the latest: what is above them is the background.
            near = far + (near - far) * np.clip(1 + below / np.maximum(near, 1e-9), 0, 1)
            return np.maximum(np.where(below > foot, below, far), near).astype(np.float32)

        return np.stack(in_threads(draw, range(len(cameras))))

    def _below(self, row: float | np.ndarray, camera: Camera) -> Any:
        """Return the inverse depth of the ground at a `row` of the picture, 0 above the horizon."""
        tilt = self.down(camera)
        return np.maximum(tilt[1] * (row - camera.intrinsics[1, 2]) / camera.intrinsics[1, 1] + tilt[2], 0)

    def error(self) -> np.ndarray:
        """Return (H,) relative error of the depth of the ground in every row; infinite above its end."""
        below = np.arange(self.height) + 0.5 - self.horizon
        error = np.hypot(self.horizon_error / np.maximum(below, 1e-6), MIN_ERROR)
        return np.where(below + self.horizon > self.base, error, np.inf)

    def confidence(self) -> np.ndarray:
        """Return (H,) 0..1 of every row: that of a guess, and of the ground as its error says where contacts tell it."""
        known = 1 / (1 + PRECISION_OF_HALF * self.error() ** 2)
        return np.maximum(known, GUESS_CONFIDENCE) if self.known else np.full(self.height, GUESS_CONFIDENCE)

    def summary(self) -> dict[str, Any]:
        """Return plain values for the statistics of the priors; rows in picture heights."""
        rows = {"horizon": self.horizon, "horizon_error": self.horizon_error, "base": self.base}
        found = {name: round(value / self.height, 3) for name, value in rows.items()}
        return found | {"known": self.known, "contacts": self.contacts, "people": self.people}


def slope(camera: Camera, pixels: np.ndarray, down: np.ndarray) -> np.ndarray:
    """Return (...) the fall of the rays z = 1 through `pixels (..., 2)`: the inverse depth of the ground one unit below the camera.

    `down (3,)` in the world.
    """
    local = camera.on_plane(pixels)
    x, y, z = camera.world_to_camera[:3, :3] @ down
    return local[..., 0] * x + local[..., 1] * y + z


def guess_world(priors: Priors) -> GuessedWorld:
    """Guess the ground before a camera at rest from the objects that move over it."""
    contacts = find_contacts(priors)
    assert priors.cameras is not None
    intrinsics = priors.cameras.intrinsics[0]
    lens = Lens(float(intrinsics[1, 1]), float(intrinsics[1, 2]), priors.height)
    horizon, error = find_horizon(contacts, lens)
    end, part = float(priors.height), USUAL_BASE
    if len(contacts.row):
        end, part = max(float(np.quantile(contacts.row, FARTHEST)), horizon + 1), BEHIND
    base = max(horizon, 0.0) + part * max(end - max(horizon, 0.0), 1.0)
    return GuessedWorld(horizon, error, base, len(contacts.row), bool((contacts.group == 0).any()), priors.height)


def find_horizon(contacts: Contacts, lens: Lens) -> tuple[float, float]:
    """Return the row of the horizon and its standard deviation, in pixels.

    Mean and deviation over the rows that may be it: the logarithm of `true_size` is the same in a group, errors have long tails
    (who jumps, bends or is half hidden misses by much), and what is usual counts, too.
    """
    rows = lens.height * np.arange(-HORIZON_RANGE, 1, HORIZON_STEP)
    cost = ((rows / lens.height - USUAL_HORIZON) / HORIZON_SPREAD) ** 2 / 2
    for group in np.unique(contacts.group):
        own = contacts.group == group
        miss = np.log(true_size(contacts.row[own, None], contacts.size[own, None], group == 0, rows, lens))
        miss -= np.median(miss, axis=0)
        miss[contacts.row[own, None] <= rows + 1] = OUTRIGHT  # nothing touches the ground above the horizon
        cost += np.log1p((miss / SIZE_NOISE) ** 2).sum(0) / EFFECTIVE_FRAMES
    weight = np.exp(cost.min() - cost)
    weight /= weight.sum()
    horizon = float(weight @ rows)
    return horizon, float(np.sqrt(weight @ (rows - horizon) ** 2))


def true_size(row: np.ndarray, size: np.ndarray, scale: bool, horizon: np.ndarray, lens: Lens) -> np.ndarray:
    """Return the true sizes, in camera heights, of what touches the ground at `row` and is `size` pixels high, for each `horizon`.

    `scale`: `size` is a scale of the picture in place of a height, which is `row - horizon` but for a factor. Of an upright thing
    seen by a camera that looks down the ends lie at the angles `a` and `b` below the horizon: its height is `1 - tan a / tan b`.
    """
    tilt = np.arctan((lens.middle - horizon) / lens.focal)
    lower, upper = (tilt + np.arctan((end - lens.middle) / lens.focal) for end in (row, row - size))
    above = np.maximum(row - horizon, 1.0)
    if scale:
        return size / (above * np.cos(tilt))
    height = 1 - np.tan(upper) / np.tan(np.maximum(lower, above / lens.focal / 2))
    return np.clip(height, *HEIGHTS)


def find_contacts(priors: Priors) -> Contacts:
    """Return the feet of people, and lowest points of other moving objects, that are seen whole."""
    found = [_feet(priors), *_objects(priors)]
    kept = [found[0], *(one for one in found[1:] if len(one[0]) >= MIN_FRAMES)]
    groups = [np.full(len(row), number) for number, (row, _) in enumerate(kept)]
    rows, sizes = (np.concatenate([pair[i] for pair in kept]) for i in (0, 1))
    return Contacts(rows, sizes, np.concatenate(groups))


def _feet(priors: Priors) -> tuple[np.ndarray, np.ndarray]:
    """Return the rows `(n,)` of the lowest foot of people and pixels per metre at their bodies `(n,)`."""
    rows, sizes = [], []
    joints, metres = priors.people_joints, priors.people_metres
    if joints is None or metres is None:
        return np.zeros(0), np.zeros(0)
    for person in range(joints.shape[1]):
        bodies = bodies_of(joints[:, person], metres[:, person])
        scales = smooth_scales(np.array([*bodies]), np.array([body.pixels_per_metre for body in bodies.values()]))
        for body, scale in zip(bodies.values(), scales, strict=True):
            feet = [joint for joint in FEET if body.weight[joint] >= FOOT_SEEN]
            row = max((float(body.pixels[joint, 1]) for joint in feet), default=np.inf)
            if row < priors.height - EDGE and scale > 0:
                rows.append(row)
                sizes.append(scale)
    return np.array(rows), np.array(sizes)


def _objects(priors: Priors) -> list[tuple[np.ndarray, np.ndarray]]:
    """Return the lowest rows `(n,)` and heights `(n,)` of every moving object but people, in the frames in which it is seen whole.

    A piece of the mask that splits or joins another one goes on as a new object: its height is another one from there.
    """
    found: list[list[tuple[float, float]]] = []
    before, owner = np.zeros((priors.height, priors.width), int), [0]
    for frame, mask in enumerate(() if priors.mask is None else priors.mask):
        pieces, count = _large_pieces(mask)
        links = np.unique(np.stack([before[pieces > 0], pieces[pieces > 0]]), axis=1)
        links = links[:, links[0] > 0]
        alone = [
            np.bincount(side, minlength=size + 1) == 1
            for side, size in zip(links, (len(owner) - 1, count), strict=True)
        ]
        same = {int(new): owner[old] for old, new in links.T if alone[0][old] and alone[1][new]}
        owner = [0] * (count + 1)
        for number, box in enumerate(ndimage.find_objects(pieces), 1):
            if number not in same:
                found.append([])
            owner[number] = same.get(number, len(found) - 1)
            if _seen_whole(box, pieces[box] == number, frame, priors):
                found[owner[number]].append((float(box[0].stop), float(box[0].stop - box[0].start)))
        before = pieces
    return [(rows, sizes) for rows, sizes in (np.array(one).T for one in found if one)]


def _large_pieces(mask: np.ndarray) -> tuple[np.ndarray, int]:
    """Return connected pieces of a `mask (H,W)` with enough pixels, numbered from 1 (0 elsewhere), and their count."""
    pieces, _ = ndimage.label(mask)
    large = np.bincount(pieces.ravel()) >= MIN_PIXELS
    large[0] = False
    return (np.cumsum(large) * large)[pieces], int(large.sum())


def _seen_whole(box: tuple[slice, slice], piece: np.ndarray, frame: int, priors: Priors) -> bool:
    """Return True where a `piece` of the moving mask in the `box` of a frame is an object away from the border, and no person."""
    y, x = box
    inside = min(y.start, x.start) >= EDGE and y.stop <= priors.height - EDGE and x.stop <= priors.width - EDGE
    if not inside:
        return False
    return priors.people is None or bool((priors.people[frame][box][piece] > 0).mean() <= MIN_PERSON_OVERLAP)
