"""Words for people and parts of their bodies, which the scene itself tells where a fit found people. Needs numpy alone."""

from __future__ import annotations

import re

import numpy as np

from ..language.lexicon import PEOPLE, spellings
from ..scene import Scene
from ..scene.people import PARTS, people_of
from .blend_weights import blend_weight_sums

_SOMEBODY = rf"(?!(?:faces?|hands?|snow\w+|[a-z]*(?:ottoman|caiman|talisman))$)(?:{PEOPLE}|dancers?|(?:some|any|every)(?:body|one))"
_LIMB = r"(?:(?P<side>left|right) )?(?P<limb>arm|hand|leg|foot)"
_PART = re.compile(rf"(?:(?:(?:{_SOMEBODY})'s?|his|her|their) )?(?:{_LIMB}|(?P<single>head|face|torso))")
_SEX = re.compile(r"[a-z]*m[ae]n|[a-z]*wom[ae]n|boys?|girls?|guys?|lad(?:y|ies)")
_AGE = re.compile(r"child(?:ren)?|kids?|bab(?:y|ies)")


def is_of_people(scene: Scene, label: str) -> bool:
    """True if `label` names people, or a part of the body, and the scene knows which Gaussians are people's."""
    return _meaning(label) is not None and people_of(scene) is not None


def rows_of_people(scene: Scene, label: str) -> np.ndarray:
    """(N,) bool: the Gaussians of all people, or of the part of the body that `label` names."""
    people, parts = people_of(scene), _meaning(label)
    assert people is not None and parts is not None
    return (people.person > 0) & (np.isin(people.part, parts) if parts else True)


def labels_of_people(scene: Scene) -> list[str]:
    """Words for the people of a scene and for the parts of their bodies that it knows; none without people."""
    people = people_of(scene)
    if people is None:
        return []
    there = [PARTS[value - 1] for value in np.unique(people.part) if 0 < value <= len(PARTS)]
    return list(dict.fromkeys(["person", *(word for part in there for word in (part.split()[-1], part))]))


def remark_on(scene: Scene, label: str) -> str:
    """The sentence about what a word for people says that the scene cannot tell; nothing where there is none."""
    if not is_of_people(scene, label):
        return ""
    word = spellings(label)[-1]
    unknown = "men from women" if _SEX.fullmatch(word) else "children from adults" if _AGE.fullmatch(word) else ""
    return unknown and f"'{label}' is taken for a person; the scene cannot tell {unknown}."


def person_at(scene: Scene, pixels: np.ndarray, frame: int) -> np.ndarray | None:
    """(N,) bool: the Gaussians of the person at `pixels (H,W)` bool of a clip frame, by their light; None for no one's."""
    people = people_of(scene)
    if people is None:
        return None
    light = blend_weight_sums(scene, float(scene.cameras.times[frame]), frame, pixels[..., None].astype(np.float32))
    person = int(np.bincount(people.person, light[:, 0]).argmax())
    return people.person == person if person else None


def _meaning(label: str) -> list[int] | None:
    """Values of the parts of the body that a word means, none of them for whole people; None for all other words."""
    for form in spellings(label):
        if re.fullmatch(_SOMEBODY, form):
            return []
        if found := _PART.fullmatch(form):
            ending = {"face": "head"}.get(found["single"] or "", found["single"]) or found["limb"]
            wanted = f"{found['side']} {ending}" if found["side"] else ending
            return [value for value, part in enumerate(PARTS, 1) if part == wanted or part.endswith(f" {wanted}")]
    return None
