"""Sentences that select: "select what moves", "add the dog to the selection", "select nothing". They are no edits."""

from __future__ import annotations

import re
from dataclasses import dataclass
from typing import Literal

import numpy as np

from ..language.refusal import Refusal
from ..query.labels import Encode
from ..query.people import remarks_on
from ..scene import Scene
from .apply import edited
from .operations import Name
from .plan import read_sentence, words_in
from .resolve import EditorState, Resolver, chosen

Mode = Literal["SET", "ADD", "SUBTRACT"]
"""Combination of the result with what is selected already."""
_VERB = "(?:select|pick|choose|mark|highlight)"
_WAYS: tuple[tuple[re.Pattern[str], Mode], ...] = tuple(
    (re.compile(rf"(?:please |now |just )*{words}[\s.!]*", re.IGNORECASE), mode)  # type: ignore[misc]
    for words, mode in (
        (rf"(?:also|additionally) {_VERB} (?P<who>.+?)", "ADD"),
        (rf"{_VERB} also (?P<who>.+?)|{_VERB} (?P<too>.+?) (?:too|as well)", "ADD"),
        (r"add (?P<who>.+?) to the selection", "ADD"),
        (r"(?:deselect|unselect|de-select) (?P<who>.+?)", "SUBTRACT"),
        (r"(?:remove|take|leave) (?P<who>.+?) (?:from|out of) the selection", "SUBTRACT"),
        (rf"{_VERB} (?:only )?(?P<who>.+?)(?: only)?", "SET"),
    )
)
"""Sentences that select, with the words for what, and how it is combined with the selection."""
_NOTHING = re.compile(
    rf"(?:{_VERB} (?:nothing|none|nobody)|(?:deselect|unselect)(?: all| everything)?|"
    r"(?:clear|empty|drop) (?:the )?selection)[\s.!]*",
    re.IGNORECASE,
)
_CALLED = "thatselection"
"""A name that no scene has, for the sentence "call WHO thatselection", by which the grammar reads words for things."""


@dataclass(frozen=True, eq=False)
class SelectingSentence:
    """The selection of a sentence."""

    chosen: np.ndarray
    """(N,) bool over `scene.posed`, with the edits of the scene."""
    mode: Mode
    """Its combination with what is selected."""
    words: str
    """The thing in the words of the sentence."""
    remarks: tuple[str, ...] = ()
    """Sentences about what these words say that the scene cannot tell."""


def read_selecting(
    scene: Scene, sentence: str, context: EditorState | None = None, *, encode: Encode | None = None
) -> SelectingSentence | None:
    """Return the selection that `sentence` asks for in `scene` with its edits; None where it does not merely select.

    Raises F4xError: it selects a thing that is not there, or that the scene does not know.
    """
    scene, context = edited(scene), context or EditorState()
    if _NOTHING.fullmatch(sentence.strip()):
        return SelectingSentence(np.zeros(len(scene.ids), bool), "SET", "nothing")
    for pattern, mode in _WAYS:
        found = pattern.fullmatch(sentence.strip())
        if found is None:
            continue
        words = next(filter(None, found.groups()))
        try:
            operations, _, _ = read_sentence(scene, f"call {words} {_CALLED}", context)
        except Refusal:
            return None
        if len(operations) != 1 or not isinstance(operations[0], Name) or operations[0].name != _CALLED:
            return None  # "select the dog and make it red" is an edit
        (resolved,) = Resolver(context, encode).resolve_sentence(scene, operations, False)
        assert isinstance(resolved, Name)
        remarks = tuple(remarks_on(scene, words_in(operations)))
        return SelectingSentence(chosen(scene, resolved.select), mode, words, remarks)
    return None
