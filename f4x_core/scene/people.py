"""The person and the part of the body that each Gaussian of a scene shows. Needs numpy alone.

A fit stores them in `Scene.extra`, where people were found in the clip:

    static/person       (Ns,)     dynamic/person       (Nd,)   uint8, index of the person + 1; 0 = nobody
    static/body_part    (Ns,)     dynamic/body_part    (Nd,)   uint8, index in `PARTS` + 1; 0 = none
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from ..geometry.arrays import evenly_spaced
from .model import Scene

PARTS = (
    "head",
    "torso",
    "left arm",
    "right arm",
    "left hand",
    "right hand",
    "left leg",
    "right leg",
    "left foot",
    "right foot",
)
"""Parts of the body, those of `priors.joints.LIMBS` in their order; left and right are the person's own."""
LIMB = PARTS.index("left arm") + 1
"""Value from which on a part of the body is one of a pair."""
NAMES = ("person", "body_part")
FRAMES_LOOKED_AT = 24
"""Frames, evenly over the clip, among which the first is looked for that shows all people."""
SHOWN = 0.5
"""Fraction of a person's opacity that lies within the picture from which a frame shows the person."""


@dataclass(frozen=True, eq=False)
class People:
    """The people of a scene, by Gaussian: N of them, static ones first."""

    person: np.ndarray
    """(N,) uint8: index of the person + 1; 0 = nobody."""
    part: np.ndarray
    """(N,) uint8: index in `PARTS` + 1; 0 = none, or nobody's."""

    def single_ones(self, rows: np.ndarray) -> np.ndarray | None:
        """Return (n,) int from 0: the person, or the limb, that each of the Gaussians `rows (n,)` belongs to; None unless all do.

        Where all rows belong to arms, hands, legs and feet, left and right of one person count as two.
        """
        person, part = self.person[rows].astype(int), self.part[rows].astype(int)
        if not len(rows) or not person.all():
            return None
        each = person * (len(PARTS) + 1) + part if (part >= LIMB).all() else person
        return np.unique(each, return_inverse=True)[1]


def people_of(scene: Scene) -> People | None:
    """Return the people of a scene with its edits, in the order of `posed`; None where it knows of none."""
    base = scene.base
    values = []
    for name in NAMES:
        parts = [
            base.extra.get(f"{part}/{name}", np.zeros(len(held), np.uint8))
            for part, held in (("static", base.static), ("dynamic", base.dynamic))
        ]
        if any(part.dtype != np.uint8 or part.ndim != 1 for part in parts):
            return None
        values.append(np.concatenate(parts)[scene.origin])
    return People(*values) if values[0].any() else None


def single_people(scene: Scene, rows: np.ndarray) -> np.ndarray | None:
    """Return (n,) int: `People.single_ones` of the Gaussians `rows (n,)`; None where the scene knows of no people."""
    people = people_of(scene)
    return None if people is None else people.single_ones(rows)


def from_left(scene: Scene, frame: int | None = None) -> tuple[np.ndarray, int]:
    """Return (People of the scene without its edits, (n,) int as in `People.person`, from left to right; the frame in which).

    By default that is the first frame that shows all of them, or where none does, most of them. Those who are outside of the
    picture stand beside it. Needs a scene that knows its people.
    """
    base = scene.base
    people = people_of(base)
    assert people is not None
    rows = np.flatnonzero(people.person)
    everybody, who = np.unique(people.person[rows], return_inverse=True)
    shown, best, order = -1, 0, np.arange(len(everybody))
    given = None if frame is None else [min(max(frame, 0), len(base.cameras) - 1)]
    for t in evenly_spaced(len(base.cameras), FRAMES_LOOKED_AT) if given is None else given:
        camera, posed = base.cameras[int(t)], base.posed(float(base.cameras.times[t]))
        pixels, depth = camera.project(posed.means[rows].astype(np.float64))
        opacity = posed.opacities[rows] * (depth > 0) + 1e-9
        inside = ((pixels >= 0) & (pixels < (camera.width, camera.height))).all(1)
        seen = np.bincount(who, opacity * inside) > SHOWN * np.bincount(who, posed.opacities[rows])
        if seen.sum() > shown:
            column = np.bincount(who, opacity * pixels[:, 0]) / np.bincount(who, opacity)
            shown, best, order = int(seen.sum()), int(t), np.argsort(column, kind="stable")
        if shown == len(everybody):
            break
    return everybody[order].astype(int), best


def parts_called(name: str) -> list[int]:
    """Return the values of `People.part` that a name means: that of "left hand", those of both hands for "hand"."""
    return [value for value, part in enumerate(PARTS, 1) if f" {part}".endswith(f" {name.strip()}")]


def with_people(scene: Scene, people: People) -> Scene:
    """Return the unedited scene with `people` stored in it."""
    count, extra = len(scene.static), dict(scene.extra)
    for name, values in zip(NAMES, (people.person, people.part), strict=True):
        extra |= {f"static/{name}": values[:count], f"dynamic/{name}": values[count:]}
    return replace(scene, extra=extra)


def with_people_by_id(scene: Scene, ids: np.ndarray, people: People) -> Scene:
    """Return the unedited scene with the `people` of the Gaussians `ids (n,)` stored in it; all others are nobody's."""
    order = np.argsort(ids)
    place = order[np.minimum(np.searchsorted(ids[order], scene.ids), len(ids) - 1)]
    known = ids[place] == scene.ids
    return with_people(scene, People(people.person[place] * known, people.part[place] * known))


def without_people(scene: Scene) -> Scene:
    """Return the scene without stored people, for callers that change its number of Gaussians."""
    return replace(
        scene, extra={name: value for name, value in scene.extra.items() if name.split("/")[-1] not in NAMES}
    )
