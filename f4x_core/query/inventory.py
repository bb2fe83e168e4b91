"""What there is in a scene, by the words that it knows."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ..errors import F4xError
from ..features.classes import kinds_of
from ..features.null import null_vector
from ..features.unknown import unknown_kind
from ..language.compounds import head_of, names_another
from ..language.lexicon import misspelt, spellings
from ..scene import Scene
from ..scene.people import people_of
from .calibration import evidence
from .cast import needs_no_teacher
from .labels import Encode, ask_for, text_head, unknown_label
from .not_deleted import not_deleted
from .people import each_person, labels_of_people
from .pixels import label_scores
from .prompts import SelectOptions, select_by_text
from .score import THRESHOLD, cosines
from .selection import Selection

PERSON = "person"
"""The word for the people that a fit found."""
LOOKED_AT = 4096
"""Number of Gaussians, evenly spread, that are classified by their best word."""
MIN_FRACTION = 0.01
"""Minimum fraction of them that a word must win to be searched in the whole scene."""
SAME = 0.5
"""Two words mean the same thing where their Gaussians overlap by more: of their union, of two movers of the smaller one."""
MISTAKES = 0.5
"""Words that may be there by chance alone, of all that are tried: with more, a word is doubtful."""
MAX_SUGGESTIONS = 4
"""Labels that are offered in place of one that is not there."""
NEAR = 2.25
"""Standard deviations above the mean cosine with the vocabulary from which a label is near a word in meaning. Of the labels so
offered for 38 words, with five of the everyday words there, 89 % were a kind of the same thing; for 50 others 83 %."""


def labels_of(scene: Scene) -> list[str]:
    """Return the words that the scene knows: those for its people, and those of its vocabulary."""
    return list(dict.fromkeys([*labels_of_people(scene), *vocabulary_of(scene)]))


def vocabulary_of(scene: Scene) -> list[str]:
    """Return the words of the scene's vocabulary; none where no teacher has taught it any."""
    if scene.features is None or not any(head.spec.text_encoder for head in scene.features.heads):
        return []
    known = scene.features.vocabularies.get(text_head(scene).spec.text_encoder or "")
    return [] if known is None else list(known.labels)


def find(scene: Scene, label: str, encode: Encode | None = None, *, outlined: bool = True) -> Selection:
    """Select by one label with `select_by_text`; the selection is empty where the scene does not show its object.

    Without a null vector scores say which word rather than whether one, so the label is weighed against the whole vocabulary.
    `outlined`: what moves is cut by its outlines, which do not decide what is there.
    """
    alone = needs_no_teacher(scene, label) or is_calibrated(scene)
    return select_word(scene, label, None if alone else vocabulary_of(scene), encode=encode, outlined=outlined)


def is_calibrated(scene: Scene) -> bool:
    """Return True if scores say if a word's thing is there, rather than which of several words it is."""
    return null_vector(text_head(scene).spec.text_encoder or "") is not None


def select_word(
    scene: Scene,
    label: str,
    negatives: Sequence[str] | None = None,
    threshold: float = THRESHOLD,
    *,
    encode: Encode | None = None,
    span: tuple[float, float] | None = None,
    outlined: bool = True,
) -> Selection:
    """Select by one label; a compound must also be of the kind that it names: a dog house is a house.

    Raises F4xError besides: a word that the vocabulary lacks and whose last part names something else ("hot dog").
    """
    options = SelectOptions(threshold, span, outlined=outlined)
    if needs_no_teacher(scene, label):
        return select_by_text(scene, [label], negatives, options, encode=encode)
    known = {word.lower() for word in labels_of(scene)}
    if names_another(label) and known.isdisjoint(spellings(label)):
        raise F4xError(unknown_label(scene, label, labels_of(scene), text_head(scene).spec.text_encoder or ""))
    selection = select_by_text(scene, [label], negatives, options, encode=encode)
    head = None if not known.isdisjoint(spellings(label)) else head_of(label, known)
    if head is None:
        return selection
    return selection.among(select_by_text(scene, [head], negatives, options, encode=encode).chosen)


def things_there(scene: Scene) -> dict[str, Selection]:
    """Return the vocabulary's words that select something with their selections, most first; the likeliest word for one thing.

    Words that few Gaussians answer to more than to any other are not asked; what moves is not cut by its outlines.
    """
    labels, there = vocabulary_of(scene), np.flatnonzero(not_deleted(scene))
    people = [] if people_of(scene) is None else each_person(scene, PERSON) or [PERSON]
    everybody = {label: select_by_text(scene, [label]) for label in people}
    everybody = {label: selection for label, selection in everybody.items() if selection.chosen.any()}
    if not labels or not len(there):
        return everybody
    query = ask_for(scene, labels, [])
    latents = scene.latents()[there[:: max(1, len(there) // LOOKED_AT)]]
    null = null_vector(query.head.spec.text_encoder or "")
    scores = label_scores(query, latents) if null is None else evidence(query.head(latents), query.vectors, null)
    counts = np.bincount(scores.argmax(1), minlength=len(labels))
    candidates = (query.labels[i] for i in np.flatnonzero(counts >= MIN_FRACTION * len(latents)))
    encoder = query.head.spec.text_encoder or ""
    asked = {label: find(scene, label, outlined=False) for label in candidates if unknown_kind(encoder, label) is None}
    found = {label: selection for label, selection in asked.items() if selection.chosen.any()}
    kept: dict[str, Selection] = everybody
    for label in sorted(
        found.keys() - everybody.keys(), key=lambda label: -float(found[label].scores[found[label].chosen].mean())
    ):
        if not any(mean_the_same(found[label].chosen, other.chosen, scene.moving) for other in kept.values()):
            kept[label] = found[label]
    return dict(sorted(kept.items(), key=lambda item: -int(item[1].chosen.sum())))


def mean_the_same(one: np.ndarray, other: np.ndarray, moving: np.ndarray) -> bool:
    """Return True if two words mean the same thing, by the Gaussians (N,) bool that they select and those that move.

    Of two that mostly move, one holds most of what moves of the other: a bus that is a car with some of the street is the car.
    """
    if all(2 * (each & moving).sum() > each.sum() for each in (one, other)):
        one, other = one & moving, other & moving
        return bool((one & other).sum() > SAME * min(one.sum(), other.sum()))
    return bool((one & other).sum() > SAME * (one | other).sum())


def is_doubtful(scene: Scene, selection: Selection) -> bool:
    """Return True if a word that nobody asked for may have found whom it did by chance, as one of so many that were tried.

    Its probability is that of its best Gaussian. For a word that somebody asks for, it says enough.
    """
    doubt = (1 - float(selection.scores.max(initial=0))) * len(labels_of(scene))
    return doubt > MISTAKES and is_calibrated(scene)


def words_there(scene: Scene) -> tuple[list[str], bool]:
    """Return (words to offer, True if they are sure): those of `things_there` that are not doubtful; where all are, all.

    Behind each stands the likeliest word for a kind of it that is accepted: a teacher that knows birds best still knows a swan.
    """
    found = things_there(scene)
    sure = {label: one for label, one in found.items() if not is_doubtful(scene, one)}
    words = [word for label, one in (sure or found).items() for word in (label, *_narrower(scene, label, one))]
    return list(dict.fromkeys(words)), bool(sure)


def _narrower(scene: Scene, label: str, selection: Selection) -> list[str]:
    """Return the word for a kind of `label` with most evidence in `selection`, if it selects the same; else none."""
    kinds = [word for word in vocabulary_of(scene) if word != label and label in kinds_of(word)]
    null = null_vector(text_head(scene).spec.text_encoder or "") if kinds else None
    if null is None or needs_no_teacher(scene, label):
        return []
    query = ask_for(scene, kinds, [])
    latents = scene.latents()[selection.chosen]
    seen = evidence(query.head(latents[:: max(1, len(latents) // LOOKED_AT)]), query.vectors, null).mean(0)
    word = query.labels[int(seen.argmax())]
    own = find(scene, word, outlined=False).chosen
    same = (own & selection.chosen).sum() > SAME * (own | selection.chosen).sum()
    return [word] if same else []


def instead(scene: Scene, words: Sequence[str], encode: Encode | None = None) -> tuple[list[str], str]:
    """Return (labels near `words` that select nothing, the part of a sentence that names them); none and "" where nothing is near.

    Up to `MAX_SUGGESTIONS`: those near the words, by `nearest_labels` of what the scene surely shows, else what it shows at all. A
    word that has no vector here is near those alone that are spelt like it, there or not.
    """
    there, sure = words_there(scene)
    try:
        near = nearest_labels(scene, words, there, encode)
    except F4xError:  # a word without a vector
        near = spelt_like(words, labels_of(scene))
    labels = (near or there)[:MAX_SUGGESTIONS]
    opening = "nearest labels:" if near else "the scene answers to" if sure else "the scene answers, but weakly, to"
    return labels, f"{opening} {', '.join(labels)}" if labels else ""


def nearest_labels(
    scene: Scene, words: Sequence[str], labels: Sequence[str], encode: Encode | None = None
) -> list[str]:
    """Return those of `labels` that are spelt like one of `words`, then those near one in meaning, the nearest first.

    Near is a cosine that stands out from the word's cosines with the whole vocabulary by `NEAR`, whatever the text encoder.
    """
    asked = ask_for(scene, words, [], encode=encode)
    others = [label for label in labels if label not in asked.labels]
    known = ask_for(scene, vocabulary_of(scene), [])
    cosine = cosines(known.vectors, asked.vectors)  # (labels, words)
    likeness = ((cosine - cosine.mean(0)) / np.maximum(cosine.std(0), 1e-6)).max(1)
    stands_out = dict(zip(known.labels, likeness, strict=True))
    by_meaning = sorted((one for one in others if stands_out.get(one, 0) >= NEAR), key=lambda one: -stands_out[one])
    return list(dict.fromkeys([*spelt_like(words, others), *by_meaning]))


def spelt_like(words: Sequence[str], labels: Sequence[str]) -> list[str]:
    """Return the labels that `words` probably misspell."""
    return list(dict.fromkeys(meant for word in words if (meant := misspelt(word, labels))))
