"""Words for people and parts of their bodies, which the scene itself tells where a fit found people. Needs numpy alone.

A word means everybody ("people", "dancer"), one person ("second person") or parts of bodies ("second person's left hand"). Other
ways to say one person ("person 2", "the man on the left") are written so first, by `in_ordinals`.
"""

from __future__ import annotations

import re
from collections.abc import Iterable
from typing import Literal

import numpy as np

from ..errors import F4xError
from ..language.lexicon import ONES, PEOPLE, singular, spellings
from ..scene import Scene
from ..scene.people import PARTS, from_left, people_of
from .blend_weights import blend_weight_sums

ORDINALS = ("first", "second", "third", "fourth", "fifth", "sixth", "seventh", "eighth")
_COUNT = {
    form: n
    for n, (nth, word) in enumerate(zip(ORDINALS, [*ONES][1:], strict=False), 1)
    for form in (nth, f"{n}st", f"{n}nd", f"{n}rd", f"{n}th", f"{word}th")
}
_NTH = "|".join(ORDINALS)
_SOMEBODY = rf"(?!(?:faces?|hands?|snow\w+|[a-z]*(?:ottoman|caiman|talisman))\b)(?:{PEOPLE}|dancers?|(?:some|any|every)(?:body|one))"
_LIMB = r"(?:(?P<side>left|right) )?(?P<limb>arm|hand|leg|foot)"
_WORD = re.compile(
    rf"(?:(?P<nth>{_NTH}) )?(?P<whom>{_SOMEBODY})|"
    rf"(?:(?:(?:(?P<whose_nth>{_NTH}) )?(?P<whose>{_SOMEBODY})'s?|his|her|their) )?(?:{_LIMB}|(?P<single>head|face|torso))"
)
_PARTS = r"(?:(?:left |right )?(?:arms?|hands?|legs?|foot|feet)|heads?|faces?|torsos?)"
_NUMBER = rf"([1-8]|{'|'.join([*ONES][1:9])})"
_PLACE = rf"(?:{'|'.join(_COUNT)}|last|other|left(?:most)?|right(?:most)?|middle)"
_NO_AMOUNT = r"\b(?!\.?\d|%| ?(?:times|x\b|percent|sec|fr|met|c?m\b|deg|units?))"
_ASIDE = r"(?:who is |that is |standing )?(?:on|at|in) the (?:far )?(left|right|middle)\b(?! (?:side )?of\b)(?: side)?"
_REWRITTEN = {
    rf"\b(?:any|some)(?:one|body)(?= {_ASIDE})": "the person",
    rf"\b(?:the )?({_SOMEBODY}) (?:number |# ?){_NUMBER}\b": r"the \2th \1",
    rf"(?<!the )\b({_SOMEBODY}) ([1-8]){_NO_AMOUNT}": r"the \2th \1",
    rf"\b({_PARTS}) of (?:the )?({_SOMEBODY}) {_ASIDE}": r"\3 \2's \1",
    rf"\b({_PARTS}) of (?:the )?({_PLACE} {_SOMEBODY})\b": r"\2's \1",
    rf"\b({_PLACE})(?=(?:,|,? and|,? or) (?:the )?{_PLACE} ({_SOMEBODY})\b)": r"\1 \2",
}
"""Ways to say one person -> the same with its place before the noun."""
_OF_MANY = rf"(?<!there )(?<!many )(?<!first )(?<!last )\b(?:both|(?:all |the |these )*{_NUMBER}) (?:of the |the )?({_SOMEBODY})\b"
_LABEL = rf"\b(?:(?:{_NTH}) {_SOMEBODY}(?:'s? {_PARTS})?|{_SOMEBODY}'s? {_PARTS})\b"
_ASKED = {
    r"\b(?:any|some)(?:one|body)\b(?! else)": "a person",
    r"^(?:who|(?:which|what) person) is (?=(?:on|at|in) the )": "where is the person ",
    r"^who (?!is (?:the|that|this|he|she|it)\b)": "which person ",
}
"""Questions about people -> the same about persons."""
_SEX = re.compile(r"[a-z]*m[ae]n|[a-z]*wom[ae]n|boys?|girls?|guys?|lad(?:y|ies)")
_AGE = re.compile(r"child(?:ren)?|kids?|bab(?:y|ies)")
_PLAIN = re.compile(r"person|people|humans?|crowd|(?:some|any|every)(?:body|one)")


def in_ordinals(
    scene: Scene,
    text: str,
    kind: Literal["word", "question", "sentence"] = "word",
    frame: int | None = None,
    selected: np.ndarray | None = None,
) -> tuple[str, list[str]]:
    """(`text` in which each way to say one person is "second person", the labels of people in it that the scene then knows).

    People are counted by `from_left`; left and right are those of the clip frame `frame`, by default the one in which they are
    counted. A sentence keeps "the left person", which it knows by itself. "The other person" is none of those named before, nor of
    those that have any of the Gaussians `selected (N,)` bool. Raises F4xError where the scene has fewer people, or another number of them, than the text says.
    """
    people = people_of(scene) if re.search(rf"{_SOMEBODY}|\bwho\b", text, re.IGNORECASE) else None
    if people is None:
        return text, []
    many, before = len(np.setdiff1d(people.person, 0)), set[int]()
    if selected is not None:
        before = {n for n, person in enumerate(from_left(scene)[0], 1) if (people.person[selected] == person).any()}
    there = f"There {'is 1 person' if many == 1 else f'are {many} people'} in the scene"
    ends = {
        "last": many,
        "left": 1,
        "leftmost": 1,
        "right": many,
        "rightmost": many,
        "middle": (many % 2) * (many + 1) // 2,
    }

    def placed(found: re.Match[str]) -> str:
        place, whom, part = found[1].lower(), found[2].lower(), found[3] or ""
        aside = place in ends and place != "last"
        if singular(whom) != whom or (aside and kind == "sentence" and not part):
            return found[0]
        others = [n for n in range(1, many + 1) if n not in before]
        if place == "other" and len(others) > 1:
            raise F4xError(f"{there}, so 'the other {whom}' may be anybody; say for example 'the second {whom}'.")
        number = sum(others) if place == "other" else ends.get(place) or _COUNT.get(place, 0)
        if not 0 < number <= many:
            raise F4xError(f"{there}, so nobody is 'the {place} {whom}'.")
        if aside and frame is not None:
            number = 1 + from_left(scene)[0].tolist().index(from_left(scene, frame)[0][number - 1])
        before.add(number)
        return f"{ORDINALS[number - 1]} {re.sub('.*(?:body|one)$', 'person', whom)}{part}"

    def so_many(found: re.Match[str]) -> str:
        count, whom = (found[1] or "two").lower(), found[2].lower()
        if singular(whom) == whom:
            return found[0]
        if ONES.get(count, count) not in (many, str(many)):
            raise F4xError(f"{there}, not {count}.")
        pair = f"first {singular(whom)} and the second {singular(whom)}"
        return found[0] if kind == "sentence" else pair if kind == "question" and many == 2 else whom

    rewritten = {**_REWRITTEN}
    if kind == "question":
        rewritten |= _ASKED
    if kind == "word" or not re.fullmatch(
        rf"(?:is|are) (?:there )?(?:the |an? )?{_SOMEBODY} {_ASIDE}\W*", text, re.IGNORECASE
    ):
        rewritten |= {rf"\b({_SOMEBODY}) {_ASIDE}": r"\2 \1"} if kind != "sentence" else {}
    for pattern, into in rewritten.items():
        text = re.sub(pattern, into, text, flags=re.IGNORECASE)
    text = re.sub(rf"\b({_PLACE}) ({_SOMEBODY})\b('s? {_PARTS}\b)?", placed, text, flags=re.IGNORECASE)
    text = re.sub(_OF_MANY, so_many, text, flags=re.IGNORECASE)
    return text, [label.lower() for label in re.findall(_LABEL, text, re.IGNORECASE)]


def is_of_people(scene: Scene, label: str) -> bool:
    """True if `label` names people, or a part of the body, and the scene knows which Gaussians are people's."""
    return people_of(scene) is not None and _meaning(scene, label) is not None


def each_person(scene: Scene, label: str) -> list[str]:
    """The labels of the single people, or of their parts, that a word for all of them means; none for another word, or for one."""
    found, people = _meaning(scene, label), people_of(scene)
    if found is None or people is None or found["nth"] or found["whose_nth"] or len(from_left(scene)[0]) < 2:
        return []
    whom, part = found["whom"] or found["whose"] or "person", found["single"] or found["limb"]
    own = f"'s {found['side'] + ' ' if found['side'] else ''}{part}" if part else ""
    whom = "person" if _PLAIN.fullmatch(whom) else singular(whom)
    return [f"{nth} {whom}{own}" for nth in ORDINALS[: len(from_left(scene)[0])]]


def rows_of_people(scene: Scene, label: str) -> np.ndarray:
    """(N,) bool: the Gaussians of all people, or of the person or the parts of bodies that `label` names."""
    people, found = people_of(scene), _meaning(scene, label)
    assert people is not None and found is not None
    rows = people.person > 0
    if nth := found["nth"] or found["whose_nth"]:
        rows = people.person == from_left(scene)[0][ORDINALS.index(nth)]
    if found["whom"]:
        return rows
    ending = {"face": "head"}.get(found["single"] or "", found["single"]) or found["limb"]
    wanted = f"{found['side']} {ending}" if found["side"] else ending
    parts = [value for value, part in enumerate(PARTS, 1) if part == wanted or part.endswith(f" {wanted}")]
    return rows & np.isin(people.part, parts)


def labels_of_people(scene: Scene) -> list[str]:
    """Words for the people of a scene and for the parts of their bodies that it knows; none without people."""
    people = people_of(scene)
    if people is None:
        return []
    there = [PARTS[value - 1] for value in np.unique(people.part) if 0 < value <= len(PARTS)]
    words = [word for part in there for word in (part.split()[-1], part)]
    return list(dict.fromkeys(["person", *words, *(["face"] if "head" in words else [])]))


def remarks_on(scene: Scene, labels: Iterable[str]) -> list[str]:
    """The sentences, each once, about what words for people say that the scene cannot tell, and about how people are counted."""
    remarks: list[str] = []
    for label in labels:
        if not is_of_people(scene, label):
            continue
        found = _meaning(scene, label)
        assert found is not None
        word = found["whom"] or found["whose"] or "person"
        unknown = "men from women" if _SEX.fullmatch(word) else "children from adults" if _AGE.fullmatch(word) else ""
        if not _PLAIN.fullmatch(word):
            unknown = unknown or "what people are or do"
            remarks.append(f"'{word}' is taken for a person; the scene cannot tell {unknown}.")
        if found["nth"] or found["whose_nth"]:
            remarks.append(f"People are counted from left to right at frame {from_left(scene)[1]}.")
    return list(dict.fromkeys(remarks))


def person_at(scene: Scene, pixels: np.ndarray, frame: int) -> np.ndarray | None:
    """(N,) bool: the Gaussians of the person at `pixels (H,W)` bool of a clip frame, by their light; None for no one's."""
    people = people_of(scene)
    if people is None:
        return None
    light = blend_weight_sums(scene, float(scene.cameras.times[frame]), frame, pixels[..., None].astype(np.float32))
    person = int(np.bincount(people.person, light[:, 0]).argmax())
    return people.person == person if person else None


def _meaning(scene: Scene, label: str) -> re.Match[str] | None:
    """The match of a word for people or for a part of the body; None for all other words."""
    words = spellings(in_ordinals(scene, label)[0])
    return next(filter(None, map(_WORD.fullmatch, words)), None)
