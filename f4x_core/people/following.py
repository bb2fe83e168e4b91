"""Everyone through the clip: who is found in one picture is followed into the others, before and after.

A person's joints place the crop of the next picture, as on a live camera; where a person is lost, somebody found later who
looks alike and stands where they could have gone is the same person.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from ..parallel import in_threads
from .finding import COARSE, PRESENCE, TURNED, TURNS, Seed, is_usable, look_twice, same_body, steadiness
from .networks import Crop, Pose, confirm, find_pose

SURE_AGREEMENT, MIN_AGREEMENT = 0.6, 0.5
"""Intersection over union of a person's mask with the last one carried along by the flow: from the first on nothing else is
tried, below the second the person is lost."""
UPRIGHT = 0.5
"""Radians: somebody who never turned further from upright is looked for nearly so where they were lost."""
MAX_TURNED = 3
"""Directions to either side, of `TURNS` around, in which others may have turned from one picture to the next."""
MIN_PIXELS = 10
"""Somebody of whom less is in the picture, counted on every `COARSE`-th pixel, is lost."""
MAX_PEOPLE, MAX_FOLLOWED = 6, 8
"""People that are kept, and that are followed before it is known who is one; in a crowd the rest stays background."""
MIN_FRAMES = 16
"""Fewest pictures of a person, half of a short clip's at least: for a moment much looks like somebody."""
CHECKS = 12
"""Pictures of a person in which they are looked for again."""
PRESENCE_WEIGHT, USUAL_PRESENCE = 2.0, 0.9
"""Weight of the mean presence beside the detector's mean score, counted from its usual value."""
SURE_PERSON, PERSON = 0.6, 0.47
"""Evidence of the detector from which somebody is a person, and from which only with a steady pose."""
STEADY, STEADY_ACROBAT = 0.4, 0.55
"""Steadiness of a person's pose, and of somebody's who is not upright, of whom the detector knows little.
Chosen on four clips: a dancer on his hands has .62; a camel and a toy train, for the networks people who lie, .47 and .25."""
TRIAL, TRIAL_CHECKS, TRIAL_TOLERANCE = 12, 4, 0.1
"""Pictures after which it is decided, on so many of them, who is followed further, and evidence that may be missing then."""
SEARCH_EVERY = 4
"""Pictures between two in which a mover who was lost is looked for again."""
GAP = 30
"""Longest time, in pictures, that somebody may be hidden and still be known again."""
ALIKE = 0.88
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
        """Return a mask of picture `before` on every `COARSE`-th pixel, float32, carried to the neighbouring picture `frame`."""
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
    moves: bool = False
    """Found where something moves."""

    @property
    def frames(self) -> list[int]:
        """Return the pictures, ascending."""
        return sorted(self.poses)

    @property
    def weight(self) -> float:
        """Return the number of frames that show them, weighted by size."""
        return sum(np.sqrt(pose.crop.side) for pose in self.poses.values())


Seeds = Mapping[int, Sequence[Seed]]
"""Picture -> people found in it by themselves."""


def follow_everyone(
    clip: Pictures,
    seeds: Seeds,
    search: Callable[[int], Sequence[Seed]] = lambda frame: (),
    report: Callable[[int, int], None] = lambda done, of: None,
) -> list[Person]:
    """Return the people of a clip from those found in some pictures, largest first.

    `search`: finds movers in a picture. It is asked again where a mover was lost.
    """
    people = _followed(clip, seeds, [], report)
    movers = [person for person in people if person.moves]
    if any(is_person(person, clip.rgb) for person in movers):
        lost = [f for f in range(0, len(clip.rgb), SEARCH_EVERY) if all(f not in person.poses for person in movers)]
        found = [[seed for seed in seen if seed.moves] for seen in in_threads(search, lost)]
        people = _followed(clip, dict(zip(lost, found, strict=True)), people, report)
    shortest = min(MIN_FRAMES, (len(clip.rgb) + 1) // 2)
    people = [person for person in _joined(people, clip.rgb) if len(person.poses) >= shortest]
    people = [person for person in people if is_person(person, clip.rgb)]
    return sorted(people, key=lambda person: -person.weight)[:MAX_PEOPLE]


def _followed(
    clip: Pictures, seeds: Seeds, known: Sequence[Person], report: Callable[[int, int], None]
) -> list[Person]:
    """Return the `known` people, and at most `MAX_FOLLOWED` others from the seeds: movers first."""
    pictures, people = clip.rgb, list(known)
    most = len(people) + MAX_FOLLOWED
    order = sorted(
        ((seed, frame) for frame, found in seeds.items() for seed in found),
        key=lambda entry: (not entry[0].moves, -entry[0].score * np.sqrt(entry[0].pose.crop.side), entry[1]),
    )
    while order and len(people) < most:
        report(len(people), most)
        order = [(seed, frame) for seed, frame in order if not _known(people, frame, seed.pose, pictures)]
        # Who is in one picture is somebody else: they are followed side by side.
        start = order[0][1] if order else 0
        together = [seed for seed, frame in order if frame == start]
        found = in_threads(lambda seed: follow(clip, seeds, start, seed, people), together)  # noqa: B023
        for person in found:
            person = _until_known(person, start, people, pictures)
            people += [person] if person.poses else []
    return people


def is_person(person: Person, pictures: np.ndarray, checks: int = CHECKS, tolerance: float = 0.0) -> bool:
    """Return True for a person: the detector sees them too, or their pose is steady.

    `checks`: most pictures that are looked at. `tolerance`: evidence that may be missing.
    """
    frames = person.frames[:: -(-len(person.poses) // checks)]
    scores = in_threads(lambda f: confirm(pictures[f], person.poses[f].next_crop), frames)
    presence = float(np.mean([pose.presence for pose in person.poses.values()]))
    evidence = float(np.mean(scores)) + PRESENCE_WEIGHT * (presence - USUAL_PRESENCE) + tolerance
    turned = float(np.median([pose.crop.turn for pose in person.poses.values()])) > TURNED
    if evidence >= SURE_PERSON or (evidence < PERSON and not turned):
        return evidence >= SURE_PERSON
    steady = float(np.mean(in_threads(lambda f: steadiness(pictures[f], person.poses[f]), frames)))
    return steady + tolerance > (STEADY if evidence >= PERSON else STEADY_ACROBAT)


def _until_known(person: Person, start: int, people: Sequence[Person], pictures: np.ndarray) -> Person:
    """Return the pictures of a person, from `start` both ways, before they become one of the `people`."""
    taken = [frame for frame in person.frames if _known(people, frame, person.poses[frame], pictures)]
    first = max((frame for frame in taken if frame <= start), default=-1)
    last = min((frame for frame in taken if frame >= start), default=len(pictures))
    return replace(person, poses={frame: pose for frame, pose in person.poses.items() if first < frame < last})


def _known(people: Sequence[Person], frame: int, pose: Pose, pictures: np.ndarray) -> bool:
    """Return True where a pose is of one of the people."""
    shape = pictures.shape[1], pictures.shape[2]
    return any(frame in person.poses and same_body(person.poses[frame], pose, shape) for person in people)


def follow(clip: Pictures, seeds: Seeds, start: int, seed: Seed, others: Sequence[Person]) -> Person:
    """Follow somebody found in picture `start` both ways, until they are lost or become one of the `others`."""
    poses = {start: seed.pose}
    for step in (1, -1):
        last, frame = seed.pose, start + step
        while 0 <= frame < len(clip.rgb):
            upright = all(one.crop.turn < UPRIGHT for one in poses.values())
            here = _place(clip, frame, last, frame - step, 1 if upright else MAX_TURNED)
            found = here.best([other.pose for other in seeds.get(frame, [])])
            if found is None or _known(others, frame, found, clip.rgb):
                break
            last = poses[frame] = found
            frame += step
            if len(poses) == TRIAL and not is_person(Person(poses), clip.rgb, TRIAL_CHECKS, TRIAL_TOLERANCE):
                return Person(poses, seed.moves)
    return Person(poses, seed.moves)


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
        """Return the person there: where the joints lead, else as `seen` by the detector or whichever way is up; None if lost."""
        found = find_pose(self.picture, self.crop) if is_usable(self.crop, self.picture) else None
        if found is not None and self.agreement(found) >= SURE_AGREEMENT:
            return found
        if np.count_nonzero(self.expected) < MIN_PIXELS:
            return None
        angles = [self.crop.angle + 2 * np.pi * turn / TURNS for turn in range(-self.turns, self.turns + 1)]
        looked = [find_pose(self.picture, Crop.of_region(self.expected, COARSE, angle)) for angle in angles]
        first = max(looked, key=self.agreement)
        again = look_twice(self.picture, first.crop) if self.agreement(first) > 0 else None
        candidates = [pose for pose in (found, *seen, first, again) if pose is not None]
        best = max(candidates, key=lambda one: one.presence * self.agreement(one), default=None)
        return best if best is not None and self.agreement(best) >= MIN_AGREEMENT else None

    def agreement(self, pose: Pose) -> float:
        """Return the intersection over union of a person's mask and of where they are expected; 0 where nobody is present."""
        if pose.presence < PRESENCE or not is_usable(pose.next_crop, self.picture):
            return 0.0
        shown = pose.mask(self.picture.shape[0], self.picture.shape[1], COARSE) > 0.5
        return float((shown & self.expected).sum() / max((shown | self.expected).sum(), 1))


def _place(clip: Pictures, frame: int, last: Pose, before: int, turns: int) -> _Place:
    """Return the place in picture `frame` of somebody who was `last` seen in picture `before`."""
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
            parts[i] = Person(parts[i].poses | parts[j].poses, parts[i].moves or parts[j].moves)
            colors[i] = _colors(parts[i], pictures)
            del parts[j], colors[j]
            joined = True
    return parts


def _likeness(one: Person, other: Person, color: np.ndarray, other_color: np.ndarray) -> float:
    """Return the likeness of `other` to `one`, of whom they may be the return; 0 where they cannot be."""
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
    """Return (512,) square root of the histogram of a person's colors, over up to eight pictures."""
    frames = person.frames
    histogram = np.zeros(BINS**3)
    for frame in frames[:: max(len(frames) // 8, 1)]:
        picture = pictures[frame]
        shown = person.poses[frame].mask(*picture.shape[:2]) > 0.5
        levels = picture[shown].astype(int) * BINS // 256
        histogram += np.bincount(levels @ [BINS * BINS, BINS, 1], minlength=BINS**3)
    return np.sqrt(histogram / max(histogram.sum(), 1))
