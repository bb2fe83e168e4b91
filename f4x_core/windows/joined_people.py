"""The people of overlapping windows, each of which counts its people anew, in numbers that go on. Draws through `raster`."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from ..scene.model import Scene
from ..scene.people import People, people_of, with_people_by_id
from ..scene.view import render

FRAMES, COLUMNS = 5, 240
"""Shared frames, evenly spread, in which people are compared, and the width in pixels of their masks."""
SAME = 0.3
"""Intersection over union of masks in the shared frames from which two people are one. Windows tell the same person's outline with
.7 and more; two who stand apart have none in common."""
LIGHT = 0.5
"""Fraction of a pixel's light that shows a person from which the pixel is the person's."""


@dataclass
class JoinedPeople:
    """Person and part of the body by Gaussian, window after window."""

    count: int = 0
    """People so far."""
    numbers: np.ndarray = field(default_factory=lambda: np.zeros(1, int))
    """(people of the window before + 1,) their joined numbers by their own ones; 0 stays 0."""
    parts: list[np.ndarray] = field(default_factory=list)
    """(N, 3) int64 of each window: id, joined number of the person, part of the body."""

    def add(self, scene: Scene, before: Scene | None, shared: Sequence[tuple[float, float]]) -> None:
        """Add the people of a window; `shared`: times of frames that it shares with the one `before`, (there, here)."""
        people, numbers = people_of(scene), np.zeros(1, int)
        if people is not None:
            numbers = np.zeros(int(people.person.max()) + 1, int)
            size = len(numbers), len(self.numbers)
            overlap = np.zeros(size)
            if before is not None and len(self.numbers) > 1:
                overlap = _overlap(scene, before, shared, size)
            for own, earlier in zip(*np.unravel_index(np.argsort(-overlap, axis=None), overlap.shape), strict=True):
                free = not numbers[own] and self.numbers[earlier] not in numbers[1:]
                if own and earlier and free and overlap[own, earlier] >= SAME:
                    numbers[own] = self.numbers[earlier]
            new = np.flatnonzero((numbers == 0) & np.isin(np.arange(len(numbers)), people.person))
            new = new[new > 0]
            numbers[new] = self.count + 1 + np.arange(len(new))
            self.count += len(new)
            self.parts.append(np.stack([scene.ids, numbers[people.person], people.part], 1))
        self.numbers = numbers

    def stored_in(self, scene: Scene) -> Scene:
        """Return the joined scene with its people: each Gaussian shows the person of the first window that has it."""
        if not self.count:
            return scene
        table = np.concatenate(self.parts)
        ids, first = np.unique(table[:, 0], return_index=True)
        person, part = table[first, 1:].T.astype(np.uint8)
        return with_people_by_id(scene, ids, People(person, part))


def _overlap(scene: Scene, before: Scene, shared: Sequence[tuple[float, float]], size: tuple[int, int]) -> np.ndarray:
    """Return (people here + 1, people before + 1) intersection over union of the masks of each two people in the shared frames."""
    both, own, earlier = np.zeros(size), np.zeros(size[0]), np.zeros(size[1])
    for row in np.unique(np.linspace(0, len(shared) - 1, FRAMES).round().astype(int)):
        there, here = shared[row]
        one, two = (
            _masks(each, scene, t, here, n) for each, t, n in ((scene, here, size[0]), (before, there, size[1]))
        )
        both += one.T @ two
        own += one.sum(0)
        earlier += two.sum(0)
    return both / np.maximum(own[:, None] + earlier - both, 1)


def _masks(scene: Scene, seen_by: Scene, time: float, camera_time: float, count: int) -> np.ndarray:
    """Return (pixels, count) float: the people of `scene` at `time`, by their numbers, through a camera of `seen_by`."""
    people = people_of(scene)
    assert people is not None
    camera = seen_by.cameras.at(camera_time)
    camera = camera.of_width(min(COLUMNS, camera.width))
    who = np.eye(count, dtype=np.float32)[people.person]
    return (render(scene, camera, time, (), values={"who": who})["who"] > LIGHT).reshape(-1, count).astype(float)
