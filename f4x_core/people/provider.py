"""Provider `networks` of the priors' people: everyone in every frame, by the networks that `mediapipe` carries.

Where the package or its runtime is absent, nobody is found and one sentence says how to get it.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from ..parallel import in_threads
from ..priors.joints import JOINTS
from ..progress import Progress
from .finding import Seed, fills, find_everyone, find_mover, same_body
from .following import Person, Pictures, follow_everyone
from .networks import close_networks, missing

if TYPE_CHECKING:
    from ..clip import Clip
    from ..priors import Priors, PriorsConfig

FLOW_STEP = 8
"""Distance in pixels of the flow's samples that tell moving regions."""
MIN_MOVED, NOISE = 1.5, 3.0
"""Pixels between two frames, and medians of the picture, by which something moves otherwise than the picture."""
MOVING_REGIONS, MIN_REGION_FRACTION = 2, 0.004
"""Moving regions of a frame that are looked at, the largest first, and the smallest fraction of the picture they cover."""


def provide(clip: Clip, priors: Priors, config: PriorsConfig, progress: Progress) -> None:
    """Fill `people`, `people_probability`, `people_joints` and `people_metres`.

    Where the user says who is seen, joints are those of the people found there.
    """
    if priors.people_joints is not None:  # the user's, with the user's people
        write_people([], priors)
        return
    if sentence := missing():
        priors.warn(sentence)
        write_people([], priors)
        return
    settings = config.people
    rgb = np.ascontiguousarray(clip.frames[clip.supervised])
    frames = range(0, len(rgb), settings.every)
    detect = lambda frame: find_everyone(rgb[frame], parts=frame % settings.parts_every == 0)  # noqa: E731
    found = in_threads(detect, frames, lambda done: progress("people", done, 2 * len(frames)))
    seeds = dict(zip(frames, found, strict=True))
    look = lambda frame: _with_movers(seeds.get(frame, []), rgb[frame], _moving_regions(priors, frame))  # noqa: E731
    some = range(0, len(rgb), settings.moving_every)
    seeds |= dict(zip(some, in_threads(look, some), strict=True))
    assert priors.flow_forward is not None and priors.flow_backward is not None
    pictures = Pictures(rgb, priors.flow_forward, priors.flow_backward)
    report = lambda done, of: progress("people", len(frames) * (of + done) // of, 2 * len(frames))  # noqa: E731
    write_people(follow_everyone(pictures, seeds, look, report), priors)
    close_networks()
    progress("people", 2 * len(frames), 2 * len(frames))


def provide_nobody(clip: Clip, priors: Priors, config: PriorsConfig, progress: Progress) -> None:
    """Fill the same with nobody (provider `none`)."""
    write_people([], priors)


PROVIDERS = {("people", "networks"): provide, ("people", "none"): provide_nobody}
"""The providers of this room by stage and name, for `priors.providers.find`."""


def write_people(people: list[Person], priors: Priors) -> None:
    """Write the masks of all people as one map of who is most probable, and their joints.

    A map that is there already stays, and its numbers count.
    """
    frames, height, width = len(priors.frames), priors.height, priors.width
    given = priors.people
    if given is not None:
        people = _numbered_as(given, people)
    who = np.zeros((frames, height, width), np.uint8)
    probability = np.zeros((frames, height, width), np.float16)
    joints = np.full((frames, len(people), JOINTS, 3), np.nan, np.float32)
    metres = np.full((frames, len(people), JOINTS, 3), np.nan, np.float32)

    def draw(frame: int) -> None:
        for index, person in enumerate(people):
            pose = person.poses.get(frame)
            if pose is None:
                continue
            joints[frame, index] = np.column_stack([pose.joints, pose.visibility])
            metres[frame, index] = pose.metres
            shown = pose.mask(height, width).astype(np.float16)
            better = shown > np.maximum(probability[frame], np.float16(0.02))
            who[frame][better], probability[frame][better] = index + 1, shown[better]

    in_threads(draw, range(frames))
    if given is not None:
        who, probability = given, (given > 0).astype(np.float16)
    priors.people, priors.people_probability = who, probability
    priors.people_joints, priors.people_metres = joints, metres
    priors.statistics["people"] = {"count": len(people), "frames": [len(person.poses) for person in people]}


def _numbered_as(given: np.ndarray, people: list[Person]) -> list[Person]:
    """Return for each number in `given (F, H, W)` the one of `people` who shows most of it; without poses where none does."""
    count = int(given.max(initial=0))
    pixels = np.zeros((len(people), count + 1))
    for row, person in zip(pixels, people, strict=True):
        for frame, pose in person.poses.items():
            shown = pose.mask(*given.shape[1:]) > 0.5
            row += np.bincount(given[frame][shown], minlength=count + 1)
    theirs = pixels[:, 1:] > pixels.sum(1, keepdims=True) / 2
    best = np.where(theirs, pixels[:, 1:], 0)
    return [people[int(best[:, n].argmax())] if best[:, n].any() else Person({}) for n in range(count)]


def _with_movers(seeds: list[Seed], picture: np.ndarray, regions: list[np.ndarray]) -> list[Seed]:
    """Return the people of a picture, and whoever else fills a moving region of it."""
    shape = picture.shape[0], picture.shape[1]
    for region in regions:
        those = [seed for seed in seeds if fills(seed.pose, region, FLOW_STEP)]
        if not those and (mover := find_mover(picture, region, FLOW_STEP)):
            those = [seed for seed in seeds if same_body(seed.pose, mover.pose, shape)]
            seeds = seeds if those else [*seeds, mover]
        seeds = [replace(seed, moves=True) if seed in those else seed for seed in seeds]
    return seeds


def _moving_regions(priors: Priors, frame: int) -> list[np.ndarray]:
    """Return masks (H // FLOW_STEP, W // FLOW_STEP) bool of regions that move unlike the whole picture, the largest first."""
    import cv2

    if priors.flow_forward is None or frame >= len(priors.flow_forward):
        return []
    some = np.s_[FLOW_STEP // 2 :: FLOW_STEP, FLOW_STEP // 2 :: FLOW_STEP]
    flow = priors.flow_forward[frame][some].astype(np.float32)
    y, x = np.mgrid[: flow.shape[0], : flow.shape[1]].astype(np.float32) * FLOW_STEP
    here = np.stack([x, y], -1).reshape(-1, 2)
    there = here + flow.reshape(-1, 2)
    cv2.setRNGSeed(0)  # the same clip must show the same people
    try:
        homography, _ = cv2.findHomography(here, there, cv2.USAC_MAGSAC, MIN_MOVED)
    except cv2.error:  # too few samples
        homography = None
    if homography is None:
        return []
    left = np.linalg.norm(there - cv2.perspectiveTransform(here[:, None], homography)[:, 0], axis=1).reshape(x.shape)
    moving = (left > max(MIN_MOVED, NOISE * float(np.median(left)))).astype(np.uint8)
    moving = cv2.morphologyEx(moving, cv2.MORPH_CLOSE, np.ones((3, 3), np.uint8))
    _, labels, boxes, _ = cv2.connectedComponentsWithStats(moving)
    areas = boxes[:, cv2.CC_STAT_AREA]
    largest = sorted(range(1, len(areas)), key=lambda label: -areas[label])[:MOVING_REGIONS]
    return [labels == label for label in largest if areas[label] > MIN_REGION_FRACTION * moving.size]
