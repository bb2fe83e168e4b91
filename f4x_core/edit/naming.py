"""Whom words mean in a scene with its edits: a name that an edit gave, or a label of the feature field."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from ..errors import F4xError
from ..language.lexicon import spellings
from ..query.cast import needs_no_teacher
from ..query.inventory import is_calibrated, labels_of, select_word
from ..query.knowledge import refuse_evidence_of_another, refuse_unknown
from ..query.labels import BACKGROUND, Encode
from ..query.people import remarks_on
from ..query.score import THRESHOLD
from ..query.selection import Selection
from ..scene import Scene
from .resolve import named


def by_words(
    scene: Scene,
    words: Sequence[str],
    negatives: Sequence[str] | None = None,
    threshold: float = THRESHOLD,
    *,
    encode: Encode | None = None,
    span: tuple[float, float] | None = None,
) -> dict[str, Selection]:
    """Return the selection of each word, in the order of `words`; names that edits gave come before labels.

    Raises F4xError for a word that nobody knows, and for one that is asked for and excluded at once.
    """
    given = by_names(scene, words, threshold, span)
    labels = [word for word in words if word not in given]
    check_negatives(words, negatives)
    found = given | by_labels(scene, labels, negatives, threshold, encode=encode, span=span)
    return {word: found[word] for word in words}


def check_negatives(words: Sequence[str], negatives: Sequence[str] | None) -> None:
    """Raise F4xError where a word of `negatives` is also asked for."""
    asked = {form for word in words for form in spellings(word)}
    for word in negatives or ():
        if asked.intersection(spellings(word)):
            raise F4xError(f"'{word}' is asked for and excluded at once; leave it out of one of them.")


def by_names(
    scene: Scene, words: Sequence[str], threshold: float = THRESHOLD, span: tuple[float, float] | None = None
) -> dict[str, Selection]:
    """Map those of `words` that are names given by edits to their selections."""
    names = {name.lower(): each for name, each in named(scene).items()}
    meant = {word: names[form] for word in words for form in spellings(word) if form in names}
    return {word: replace(each, threshold=threshold, span=span) for word, each in meant.items()}


def by_labels(
    scene: Scene,
    labels: Sequence[str],
    negatives: Sequence[str] | None = None,
    threshold: float = THRESHOLD,
    *,
    encode: Encode | None = None,
    span: tuple[float, float] | None = None,
) -> dict[str, Selection]:
    """Label -> whom it means by the feature field; several labels are weighed against each other where scores are relative."""
    for label in labels:
        refuse_unknown(scene, label, encode)
    if negatives is None and len(labels) > 1:  # one of them is nothing that another is weighed against
        forms = {form for label in labels for form in spellings(label)}
        negatives = [label for label in labels_of(scene) if label.lower() in {*BACKGROUND} - forms]
    taught = [label for label in labels if not needs_no_teacher(scene, label)]
    rivals = len(taught) > 1 and not is_calibrated(scene)
    found = {}
    for label in labels:
        against = [*(negatives or ()), *(other for other in taught if other != label)] if rivals else negatives
        selection = select_word(scene, label, against, threshold, encode=encode, span=span)
        found[label] = replace(selection, remarks=tuple(remarks_on(scene, [label])))
        refuse_evidence_of_another(scene, label, found[label], encode)
    return found


def together(found: Mapping[str, Selection]) -> Selection:
    """Return the union of the selections, at their common threshold."""
    first, *others = found.values()
    for other in others:
        first = replace(first, scores=np.maximum(first.scores, other.scores), wins=first.wins | other.wins)
    remarks = dict.fromkeys(remark for each in found.values() for remark in each.remarks)
    return replace(first, label=", ".join(each.label for each in found.values()), remarks=tuple(remarks))
