"""Everyone through the clip: who is found in one picture is followed into the others, before and after.

A person's joints place the crop of the next picture, as on a live camera; where a person is lost, somebody found later who
looks alike and stands where they could have gone is the same person.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from ..parallel import in_threads
from .animals import animal_likelihood
from .finding import COARSE, CONFIRMED, PRESENCE, TURNS, Seed, is_usable, look_twice, same_body
from .networks import CROP_FACTOR, Crop, Pose, confirm, find_pose

SURE_AGREEMENT, MIN_AGREEMENT = 0.7, 0.5
"""Intersection over union of a person's mask with the last one carried along by the flow: from the first on nothing else is
tried, below the second the person is lost."""
UPRIGHT = 0.5
"""Radians: somebody who never turned further from upright is looked for nearly so where they were lost."""
MAX_TURNED = 2
"""Directions to either side, of `TURNS` around, in which others may have turned from one picture to the next."""
MIN_PIXELS = 10
"""Somebody of whom less is in the picture, counted on every `COARSE`-th pixel, is lost."""
MAX_PEOPLE, MAX_FOLLOWED = 6, 8
"""People that are kept, and that are followed before it is known who is one; in a crowd the rest stays background."""
MIN_FRAMES = 16
"""Fewest pictures of a person, half of a short clip's at least: for a moment much looks like somebody."""
CHECKS, OPINIONS = 16, 5
"""Pictures of a person in which the detector looks for them again, and that the classifier of animals sees."""
PRESENCE_WEIGHT, USUAL_PRESENCE = 2.0, 0.9
"""Weight of the mean presence beside the detector's mean score, counted from its usual value."""
SURE_PERSON, PERSON, ANIMAL = 0.6, 0.47, 0.5
"""Evidence from which somebody is a person, and from which only if the classifier's likelihood of animals is below the last.
Chosen on seven clips: a toy train has .40, a dog .47, a swan .46; people have .49 and more, those who fill the picture 1."""
ACROBAT_PRESENCE = 0.94
"""Mean presence that makes up for the detector, which knows hardly anybody upside down, where it has seen them twice."""
GAP = 30
"""Longest time, in pictures, that somebody may be hidden and still be known again."""
ALIKE = 0.55
"""Correlation of colors from which somebody found again may be the same person."""
BINS = 8
"""Bins of a color's histogram along each axis."""


@dataclass(frozen=True)
class Pictures:
    """A clip with the flow between its pictures."""

    rgb: np.ndarray
    """(F, H, W, 3) uint8."""
    forward: np.ndarray
    """(F - 1, H, W, 2) pixels, picture i -> i + 1."""
    backward: np.ndarray
    """(F - 1, H, W, 2) pixels, picture i + 1 -> i."""

    def carried(self, mask: np.ndarray, before: int, frame: int) -> np.ndarray:
        """A mask of picture `before` on every `COARSE`-th pixel, float32, carried to the neighbouring picture `frame`."""
        import cv2

        back = self.backward[before] if frame > before else self.forward[frame]
        height, width = mask.shape
        back = back[COARSE // 2 :: COARSE, COARSE // 2 :: COARSE][:height, :width].astype(np.float32) / COARSE
        x, y = np.arange(width, dtype=np.float32), np.arange(height, dtype=np.float32)[:, None]
        return cv2.remap(mask, x + back[..., 0], y + back[..., 1], cv2.INTER_LINEAR)


@dataclass(frozen=True)
class Person:
    """One person in every picture that shows them."""

    poses: dict[int, Pose]
    """Picture -> pose."""

    @property
    def frames(self) -> list[int]:
        """Pictures, ascending."""
        return sorted(self.poses)

    @property
    def weight(self) -> float:
        """Frames that show them, weighted by size."""
        return sum(np.sqrt(pose.crop.side) for pose in self.poses.values())


Seeds = Mapping[int, Sequence[Seed]]
"""Picture -> people found in it by themselves."""


def follow_everyone(
    clip: Pictures, seeds: Seeds, report: Callable[[int, int], None] = lambda done, of: None
) -> list[Person]:
    """The people of a clip from those found in some pictures, largest first."""
    pictures = clip.rgb
    order = sorted(
        ((seed, frame) for frame, found in seeds.items() for seed in found),
        key=lambda entry: (not entry[0].moves, -entry[0].score * np.sqrt(entry[0].pose.crop.side), entry[1]),
    )
    people: list[Person] = []
    while order and len(people) < MAX_FOLLOWED:
        report(len(people), MAX_FOLLOWED)
        order = [(seed, frame) for seed, frame in order if not _known(people, frame, seed.pose, pictures)]
        # Who is in one picture is somebody else: they are followed side by side.
        together = [seed for seed, frame in order if frame == order[0][1]]
        start = order[0][1] if order else 0
        found = in_threads(lambda seed: follow(clip, seeds, start, seed.pose, people), together)  # noqa: B023
        for person in found:
            people.append(_until_known(person, start, people, pictures))
    shortest = min(MIN_FRAMES, (len(pictures) + 1) // 2)
    people = [person for person in _joined(people, pictures) if len(person.poses) >= shortest]
    people = [person for person in people if is_person(person, pictures)]
    return sorted(people, key=lambda person: -person.weight)[:MAX_PEOPLE]


def is_person(person: Person, pictures: np.ndarray) -> bool:
    """Return True for a person: the detector sees them too, or the pose is sure and it is no animal."""
    frames = person.frames[:: max(len(person.poses) // CHECKS, 1)]
    scores = np.array(in_threads(lambda f: confirm(pictures[f], person.poses[f].next_crop), frames))
    presence = float(np.mean([pose.presence for pose in person.poses.values()]))
    evidence = float(scores.mean()) + PRESENCE_WEIGHT * (presence - USUAL_PRESENCE)
    if evidence >= SURE_PERSON:
        return True
    acrobat = presence >= ACROBAT_PRESENCE and (scores >= CONFIRMED).sum() >= 2
    return (evidence >= PERSON or acrobat) and not _is_animal(person, frames, pictures)


def _is_animal(person: Person, frames: Sequence[int], pictures: np.ndarray) -> bool:
    """Return True where the classifier takes somebody for an animal, or where there is no classifier."""
    some = frames[:: max(len(frames) // OPINIONS, 1)]
    masks = {frame: person.poses[frame].mask(*pictures.shape[1:3]) > 0.5 for frame in some}
    asked = [animal_likelihood(pictures[frame], mask) for frame, mask in masks.items() if mask.any()]
    known = [likelihood for likelihood in asked if likelihood is not None]
    return not known or float(np.mean(known)) > ANIMAL


def _until_known(person: Person, start: int, people: Sequence[Person], pictures: np.ndarray) -> Person:
    """The pictures of a person, from `start` both ways, before they become one of the `people`."""
    taken = [frame for frame in person.frames if _known(people, frame, person.poses[frame], pictures)]
    first = max((frame for frame in taken if frame <= start), default=-1)
    last = min((frame for frame in taken if frame >= start), default=len(pictures))
    return Person({frame: pose for frame, pose in person.poses.items() if first < frame < last})


def _known(people: Sequence[Person], frame: int, pose: Pose, pictures: np.ndarray) -> bool:
    """Return True where a pose is of one of the people."""
    shape = pictures.shape[1], pictures.shape[2]
    return any(frame in person.poses and same_body(person.poses[frame], pose, shape) for person in people)


def follow(clip: Pictures, seeds: Seeds, start: int, pose: Pose, others: Sequence[Person]) -> Person:
    """Follow somebody found in picture `start` both ways, until they are lost or become one of the `others`."""
    poses = {start: pose}
    for step in (1, -1):
        last, frame = pose, start + step
        while 0 <= frame < len(clip.rgb):
            upright = all(abs(_turn(one.crop)) < UPRIGHT for one in poses.values())
            here = _place(clip, frame, last, frame - step, 1 if upright else MAX_TURNED)
            found = here.best([seed.pose for seed in seeds.get(frame, [])])
            if found is None or _known(others, frame, found, clip.rgb):
                break
            last = poses[frame] = found
            frame += step
    return Person(poses)


def _turn(crop: Crop) -> float:
    """Radians from upright, -pi..pi."""
    return (crop.angle + np.pi) % (2 * np.pi) - np.pi


@dataclass(frozen=True)
class _Place:
    """The place where somebody is expected in a picture."""

    picture: np.ndarray
    """(H, W, 3) uint8."""
    expected: np.ndarray
    """bool, on every `COARSE`-th pixel: the last mask, carried along by the flow."""
    crop: Crop
    """By the last joints."""
    turns: int
    """Directions of "up" to either side of the crop's that are tried."""

    def best(self, seen: Sequence[Pose]) -> Pose | None:
        """The person there: where the joints lead, else as `seen` by the detector or whichever way is up; None if lost."""
        found = find_pose(self.picture, self.crop) if is_usable(self.crop, self.picture) else None
        if found is not None and self.agreement(found) >= SURE_AGREEMENT:
            return found
        y, x = np.nonzero(self.expected)
        if len(y) < MIN_PIXELS:
            return None
        low, high = COARSE * np.array([x.min(), y.min()]), COARSE * np.array([x.max() + 1, y.max() + 1])
        side = CROP_FACTOR * float(np.max(high - low))
        angles = [self.crop.angle + 2 * np.pi * turn / TURNS for turn in range(-self.turns, self.turns + 1)]
        looked = [find_pose(self.picture, Crop((low + high) / 2, side, angle)) for angle in angles]
        first = max(looked, key=self.agreement)
        again = look_twice(self.picture, first.crop) if self.agreement(first) > 0 else None
        candidates = [pose for pose in (found, *seen, first, again) if pose is not None]
        best = max(candidates, key=lambda one: one.presence * self.agreement(one), default=None)
        return best if best is not None and self.agreement(best) >= MIN_AGREEMENT else None

    def agreement(self, pose: Pose) -> float:
        """Intersection over union of a person's mask and of where they are expected; 0 where nobody is present."""
        if pose.presence < PRESENCE or not is_usable(pose.next_crop, self.picture):
            return 0.0
        shown = pose.mask(self.picture.shape[0], self.picture.shape[1], COARSE) > 0.5
        return float((shown & self.expected).sum() / max((shown | self.expected).sum(), 1))


def _place(clip: Pictures, frame: int, last: Pose, before: int, turns: int) -> _Place:
    """The place in picture `frame` of somebody who was `last` seen in picture `before`."""
    expected = clip.carried(last.mask(clip.rgb.shape[1], clip.rgb.shape[2], COARSE), before, frame) > 0.5
    return _Place(clip.rgb[frame], expected, last.next_crop, turns)


def _joined(people: list[Person], pictures: np.ndarray) -> list[Person]:
    """Join people who were lost and found again."""
    parts = sorted(people, key=lambda person: (person.frames[0], -person.weight))
    colors = [_colors(person, pictures) for person in parts]
    joined = True
    while joined:
        joined = False
        best = (0.0, 0, 0)
        for i, one in enumerate(parts):
            for j, other in enumerate(parts):
                likeness = _likeness(one, other, colors[i], colors[j]) if i != j else 0.0
                best = max(best, (likeness, i, j))
        if best[0] > 0:
            _, i, j = best
            parts[i] = Person(parts[i].poses | parts[j].poses)
            colors[i] = _colors(parts[i], pictures)
            del parts[j], colors[j]
            joined = True
    return parts


def _likeness(one: Person, other: Person, color: np.ndarray, other_color: np.ndarray) -> float:
    """Likeness of `other` to `one`, of whom they may be the return; 0 where they cannot be."""
    last, first = one.frames[-1], other.frames[0]
    if not 0 < first - last <= GAP:
        return 0.0
    before, after = one.poses[last], other.poses[first]
    way = float(np.linalg.norm(before.next_crop.center - after.crop.center)) / max(before.crop.side, after.crop.side)
    if way > 0.35 + 0.08 * (first - last) or not 0.5 < before.crop.side / after.crop.side < 2:
        return 0.0
    alike = float(np.corrcoef(color, other_color)[0, 1])
    return alike if alike > ALIKE else 0.0


def _colors(person: Person, pictures: np.ndarray) -> np.ndarray:
    """(512,) square root of the histogram of a person's colors, over up to eight pictures."""
    frames = person.frames
    histogram = np.zeros(BINS**3)
    for frame in frames[:: max(len(frames) // 8, 1)]:
        picture = pictures[frame]
        shown = person.poses[frame].mask(*picture.shape[:2]) > 0.5
        levels = picture[shown].astype(int) * BINS // 256
        histogram += np.bincount(levels @ [BINS * BINS, BINS, 1], minlength=BINS**3)
    return np.sqrt(histogram / max(histogram.sum(), 1))
