"""Words for people and parts of their bodies, which the scene itself tells where a fit found people. Needs numpy alone.

A word means everybody ("people", "dancer"), one person ("second person") or parts of bodies ("second person's left hand"). Other
ways to say one person ("person 2", "the man on the left") are written so first, by `in_ordinals`.
"""

from __future__ import annotations

import re
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np

from ..errors import F4xError
from ..features.classes import is_of_a_kind
from ..language.lexicon import ONES, ORDINALS, PEOPLE, singular, spellings
from ..scene import Scene
from ..scene.people import PARTS, from_left, parts_called, people_of
from .blend_weights import blend_weight_sums

_NUMBERS = [*ONES][1 : len(ORDINALS) + 1]
_COUNT = {f"{n}{th}": n for n in range(1, len(ORDINALS) + 1) for th in ("st", "nd", "rd", "th")}
_COUNT |= {
    form: n for n, (nth, word) in enumerate(zip(ORDINALS, _NUMBERS, strict=True), 1) for form in (nth, f"{word}th")
}
_NTH, _NUMBER = "|".join(ORDINALS), rf"(1[0-2]|[1-9]|{'|'.join(_NUMBERS)})"
_SOMEBODY = (
    r"(?!(?:faces?|hands?|snow\w+|[a-z]*(?:ottoman|caiman|talisman))\b)"
    rf"(?:{PEOPLE}|dancers?|(?:some|any|every)(?:body|one))"
)
_LIMB = r"(?:(?P<side>left|right) )?(?P<limb>arm|hand|leg|foot)"
_WORD = re.compile(
    rf"(?:(?P<nth>{_NTH}) )?(?P<whom>{_SOMEBODY})|"
    rf"(?:(?:(?:(?P<whose_nth>{_NTH}) )?(?P<whose>{_SOMEBODY})'s?|his|her|their) )?(?:{_LIMB}|(?P<single>head|face|torso))"
)
_PARTS = r"(?:(?:left |right )?(?:arms?|hands?|legs?|foot|feet)|heads?|faces?|torsos?)"
_PLACE = rf"(?:{'|'.join(_COUNT)}|last|other|left(?:most)?|right(?:most)?|middle)"
_NO_AMOUNT = r"(?!\.?\d|%| ?(?:times|x\b|percent|sec(?:ond)?s?\b|frames?\b|c?m\b|met(?:er|re)|degrees?|units?\b))"
_ASIDE = r"(?:(?:who|that) is |standing )?(?:on|at|in) the (?:far )?(left|right|middle)\b(?! (?:side )?of\b)(?: side)?"
_REWRITTEN = (
    ("any", rf"\b(?:any|some)(?:one|body)(?= {_ASIDE})", "the person"),
    ("any", r"\b(?:any|some|every)(?:one|body)'s\b", "people's"),
    ("any", rf"\b(?:the )?({_SOMEBODY}) (?:number |# ?){_NUMBER}\b", r"the \2th \1"),
    ("any", rf"(?<!the )\b({_SOMEBODY}) {_NUMBER}\b{_NO_AMOUNT}", r"the \2th \1"),
    ("any", rf"\b({_PARTS}) of (?:the )?({_SOMEBODY}) {_ASIDE}", r"\3 \2's \1"),
    ("any", rf"\b({_PARTS}) of (?:the )?({_PLACE} {_SOMEBODY})\b", r"\2's \1"),
    ("any", rf"\b({_PLACE} {_SOMEBODY}'s) ({_PARTS}) and ({_PARTS})\b", r"\1 \2 and the \1 \3"),
    ("any", r"\b(every(?:one|body)) else(?= (?:but|except|than))", r"\1"),
    ("any", rf"\b({_PLACE})(?=(?:,|,? and|,? or) (?:the )?{_PLACE} ({_SOMEBODY})\b)", r"\1 \2"),
    ("question", r"\b(?:any|some)(?:one|body)\b(?! else)", "a person"),
    ("question", r"^(?:who|(?:which|what) person) is (?=(?:on|at|in) the )", "where is the person "),
    ("question", r"^who (?!is (?:the (?!\w+est\b)|(?:that|this|he|she|it)\b))", "which person "),
    ("question", r"\bevery(?:one|body)\b(?! else)", "the people"),
    ("question", rf"\b({_SOMEBODY}) {_ASIDE}(?= (?!at |in |now)\w)", r"\2 \1"),
    ("question", rf"^((?!is |are ).*)\b({_SOMEBODY}) {_ASIDE}", r"\1\3 \2"),
    ("word", rf"\b({_SOMEBODY}) {_ASIDE}", r"\2 \1"),
)
"""(kind of text, or any; a way to say one person; the same with a place before the noun)."""
_KEPT = r"\"[^\"]*\"|\b(?:call|name|label) (?:it|this|that|him|her|them|the selection)\b.*"
_OF_MANY = rf"(?<!there )(?<!many )(?<!first )(?<!last )\b(?:both|(?:all |the |these )*{_NUMBER}) (?:of the |the )?({_SOMEBODY})\b"
_LABEL = rf"\b(?:(?:{_NTH}) {_SOMEBODY}(?:'s? {_PARTS})?|{_SOMEBODY}'s? {_PARTS})\b"
_UNKNOWN = {
    r"person|people|humans?|(?:some|any|every)(?:body|one)": "",
    r"[a-z]*m[ae]n|[a-z]*wom[ae]n|boys?|girls?|guys?|lad(?:y|ies)": "men from women",
    r"child(?:ren)?|kids?|bab(?:y|ies)": "children from adults",
    r".*": "what people are or do",
}
"""Words for people -> what of it the scene cannot tell."""


@dataclass
class _Persons:
    """The people of a scene, while the ways in which a text names them are written in ordinals."""

    kind: Literal["word", "question", "sentence"]
    counted: list[int]
    """Numbers of the people, as ordinals count them."""
    in_row: list[int]
    """The same from left to right in the frame that the text is about."""
    named: set[int]
    """Those whom "the other person" excludes: selected, or named so far."""

    @property
    def total(self) -> str:
        """Return the number of people in a sentence's words."""
        count = len(self.counted)
        return f"There {'is 1 person' if count == 1 else f'are {count} people'} in the scene"

    def at_place(self, found: re.Match[str]) -> str:
        """Return "the second person's left hand" for a match of a place, a word for people and perhaps a part of the body.

        Raises F4xError where the place is that of nobody, or may be anybody's.
        """
        place, whom, part = found[1].lower().removesuffix("most"), found[2].lower(), found[3] or ""
        single = singular(whom) == whom
        if not single and place == "other" and self.named:
            return " and the ".join(self._ordinal(one, whom, part) for one in self._others())
        if not single or (place in ("left", "right", "middle") and self.kind == "sentence" and not part):
            return found[0]
        number = _COUNT.get(place, 0)
        meant = self._others() if place == "other" else self._ends().get(place, self.counted[number - 1 : number])
        if len(meant) != 1:
            lacking = "may be anybody; say for example 'the second person'" if meant else "is nobody"
            raise F4xError(f"{self.total}, so 'the {ORDINALS[number - 1] if number else place} {whom}' {lacking}.")
        self.named.add(meant[0])
        return self._ordinal(meant[0], whom, part)

    def in_number(self, found: re.Match[str]) -> str:
        """Return what texts of this kind say for a match of a count of people ("both dancers").

        Raises F4xError where it is another count than the scene's.
        """
        count, whom = (found[1] or "two").lower(), found[2].lower()
        if singular(whom) == whom:
            return found[0]
        if ONES.get(count, count) not in (len(self.counted), str(len(self.counted))):
            raise F4xError(f"{self.total}, not {count}.")
        pair = f"first {_one(whom)} and the second {_one(whom)}"
        return {"sentence": found[0], "word": whom, "question": pair if len(self.counted) == 2 else whom}[self.kind]

    def _ordinal(self, person: int, whom: str, part: str) -> str:
        return f"{ORDINALS[self.counted.index(person)]} {_one(whom)}{part}"

    def _others(self) -> list[int]:
        others = [person for person in self.counted if person not in self.named]
        return others if self.named or len(self.counted) > 1 else []

    def _ends(self) -> dict[str, list[int]]:
        """Return the people at each place of the row, and the last of those counted."""
        middle, odd = divmod(len(self.counted), 2)
        row = self.in_row
        return {"left": row[:1], "right": row[-1:], "middle": row[middle:][:odd], "last": self.counted[-1:]}


def in_ordinals(
    scene: Scene,
    text: str,
    kind: Literal["word", "question", "sentence"] = "word",
    frame: int | None = None,
    selected: np.ndarray | None = None,
    names: Iterable[str] = (),
) -> tuple[str, list[str]]:
    """Return (`text` with each way to name one person as "second person", labels of people in it that the scene then knows).

    People are counted by `from_left`; left and right are those of clip frame `frame`, by default the one in which they are
    counted. A sentence keeps "the left person", which it knows by itself. "The other person" is none of those named before, nor
    of those with Gaussians `selected (N,)` bool. What is quoted, one of the `names` that somebody gave, or about to be given as one
    ("call it person 2") stays as it is. Raises F4xError where the text says more, or another number of people.
    """
    people = people_of(scene)
    single = rf"\b(?:who|s?he|both|any\w+|some\w+|every\w+|{_NUMBER}|\d+|{_PLACE}|.*'s)\b"
    if people is None or not re.search(single, text, re.IGNORECASE):
        return text, []
    counted = from_left(scene)[0].tolist()[: len(ORDINALS)]
    in_row = counted if frame is None else [one for one in from_left(scene, frame)[0].tolist() if one in counted]
    named = set() if selected is None else {*people.person[selected].tolist()}
    persons = _Persons(kind, counted, in_row, named)
    rules: list[tuple[str, Any]] = [(pattern, into) for where, pattern, into in _REWRITTEN if where in ("any", kind)]
    if kind == "question" and selected is None:
        rules.append((r"^((?:(?!\b(?:the|an?)\b|,).)*)\b(?:she|he)\b", r"\1the person"))
    place = rf"\b({_PLACE}) ({_SOMEBODY})\b('s? {_PARTS}\b)?"
    rules += [(place, persons.at_place), (_OF_MANY, persons.in_number)]
    kept = "|".join([_KEPT, *(rf"\b{re.escape(name)}\b" for name in names)])
    pieces = re.split(f"({kept})", text, flags=re.IGNORECASE)
    for pattern, into in rules:
        pieces[::2] = [re.sub(pattern, into, piece, flags=re.IGNORECASE) for piece in pieces[::2]]
    text = "".join(pieces)
    return text, [spellings(label)[-1] for label in re.findall(_LABEL, text, re.IGNORECASE)]


def is_of_people(scene: Scene, label: str) -> bool:
    """Return True if `label` names people, or a part of the body, and the scene knows which Gaussians are people's."""
    return people_of(scene) is not None and _meaning(scene, label) is not None


def names_people(scene: Scene, label: str) -> bool:
    """Return True if `label` is a word for people, not for parts of their bodies, whoever the scene knows."""
    found = _meaning(scene, label)
    return found is not None and found["whom"] is not None


def each_person(scene: Scene, label: str) -> list[str]:
    """Return the labels of the single people, or of their parts, that a word for all means; none for other words, or one person."""
    found, people = _meaning(scene, label), people_of(scene)
    if found is None or people is None or found["nth"] or found["whose_nth"] or len(from_left(scene)[0]) < 2:
        return []
    whom, part = found["whom"] or found["whose"] or "person", found["single"] or found["limb"]
    own = f"'s {found['side'] + ' ' if found['side'] else ''}{part}" if part else ""
    return [f"{nth} {_one(whom)}{own}" for nth in ORDINALS[: len(from_left(scene)[0])]]


def rows_of_people(scene: Scene, label: str) -> np.ndarray:
    """Return the Gaussians (N,) bool of all people, or of the person or the parts of bodies that `label` names."""
    people, found = people_of(scene), _meaning(scene, label)
    assert people is not None and found is not None
    rows = people.person > 0
    if nth := found["nth"] or found["whose_nth"]:
        rows = people.person == from_left(scene)[0][ORDINALS.index(nth)]
    if found["whom"]:
        return rows
    ending = "head" if found["single"] == "face" else found["single"] or found["limb"]
    return rows & np.isin(people.part, parts_called(f"{found['side'] or ''} {ending}"))


def people_beside(scene: Scene, labels: Iterable[str], chosen: np.ndarray) -> np.ndarray:
    """Return the Gaussians (N,) bool of people who are none of what words find: the rider of a "horse", nobody of a "hat".

    Nobody where most of what is found, `chosen (N,)` bool, would be lost.
    """
    people = people_of(scene)
    if people is None or not all(map(is_of_a_kind, labels)):
        return np.zeros(len(chosen), bool)
    rows = people.person > 0
    return rows & bool(2 * (chosen & rows).sum() <= chosen.sum())


def labels_of_people(scene: Scene) -> list[str]:
    """Return words for the people of a scene and for the parts of their bodies that it knows; none without people."""
    people = people_of(scene)
    if people is None:
        return []
    there = [PARTS[value - 1] for value in np.unique(people.part) if 0 < value <= len(PARTS)]
    words = [word for part in there for word in (part.split()[-1], part)]
    return list(dict.fromkeys(["person", *words, *(["face"] if "head" in words else [])]))


def remarks_on(scene: Scene, labels: Iterable[str]) -> list[str]:
    """Return sentences, each once, about what the scene cannot tell of people named in `labels`, and how it counts them."""
    remarks: list[str] = []
    for label in labels:
        if (found := _meaning(scene, label)) and people_of(scene):
            word = found["whom"] or found["whose"] or "person"
            unknown = next(text for pattern, text in _UNKNOWN.items() if re.fullmatch(pattern, word))
            remarks += [f"'{word}' is taken for a person; the scene cannot tell {unknown}."] if unknown else []
            counted = found["nth"] or found["whose_nth"]
            remarks += [f"People are counted from left to right at frame {from_left(scene)[1]}."] if counted else []
    return list(dict.fromkeys(remarks))


def person_at(scene: Scene, pixels: np.ndarray, frame: int, part: bool = False) -> np.ndarray | None:
    """Return the Gaussians (N,) bool of the person with most blend weights in `pixels (H,W)` bool of a frame; None for nobody's.

    With `part` those of the part of the body alone, where it is known.
    """
    people = people_of(scene)
    if people is None:
        return None
    light = blend_weight_sums(scene, float(scene.cameras.times[frame]), frame, pixels[..., None].astype(np.float32))
    group = people.person.astype(int) * 2**8 + people.part * part
    best = int(np.bincount(group, light[:, 0]).argmax())
    return (group == best if best % 2**8 else people.person == best // 2**8) if best else None


def _one(whom: str) -> str:
    """Return the word for one of the people that a word names."""
    return "person" if whom.endswith(("body", "one")) else singular(whom)


def _meaning(scene: Scene, label: str) -> re.Match[str] | None:
    """Return the match of a word for people or for a part of the body; None for all other words."""
    words = spellings(in_ordinals(scene, label)[0])
    return next(filter(None, map(_WORD.fullmatch, words)), None)
