"""What a teacher does not know is refused before it selects, and what is another label's by its evidence. Needs numpy alone."""

from __future__ import annotations

from collections.abc import Collection

import numpy as np

from ..errors import F4xError
from ..features.classes import kinds_of
from ..features.null import null_vector
from ..features.unknown import unknown_kind
from ..language.compounds import names_another
from ..language.lexicon import spellings
from ..scene import Scene
from ..scene.people import people_of
from .calibration import evidence
from .cast import SURFACES, needs_no_teacher, untaught_words, with_untaught
from .inventory import PERSON, find, instead, labels_of, words_there
from .labels import Encode, ask_for, text_head
from .people import each_person, names_people
from .score import cosines
from .selection import Selection
from .smoothing import group_of

ALIKE = 0.6
"""Cosine of two words from which either may mean what the other means: a puppy is a dog (0.8), a rider no horse."""
CLEARLY = 0.05
"""Evidence that a label must have beyond that of the asked word, in what the word selects, to be what it rather is: of a bed
the label sofa has 0.03 more."""


def known_words(scene: Scene, unknown: Collection[str] | None = None) -> list[str]:
    """Return the words that are looked for in a scene: those that its teacher knows, those for its people and for each of them,
    and, where there are any, for `cast.SURFACES`; `unknown`: `unknown_kinds` of the scene, where they are known."""
    unknown = unknown_kinds(scene) if unknown is None else unknown
    words = with_untaught(scene, [*labels_of(scene), *each_person(scene, PERSON)], SURFACES)
    return [label for label in dict.fromkeys(words) if label not in unknown]


def words_found(scene: Scene) -> list[str]:
    """Return the words that surely select something in a scene: of its vocabulary, for its people, and for surfaces."""
    try:
        there, sure = words_there(scene)
    except F4xError:  # labels that nobody can ask for: a file may hold any text
        there, sure = [], False
    return [*(there if sure else []), *(word for word in untaught_words(scene, SURFACES) if _is_there(scene, word))]


def _is_there(scene: Scene, surface: str) -> bool:
    """Return True if a scene shows one of `cast.SURFACES`."""
    try:
        return bool(find(scene, surface).chosen.any())
    except F4xError:
        return False


def unknown_kinds(scene: Scene) -> dict[str, str]:
    """Return word of the scene -> its kind of thing, for words that are refused because the teacher knows none of that kind."""
    kinds = {label: _unknown_kind(scene, label) for label in labels_of(scene)}
    return {label: kind for label, kind in kinds.items() if kind is not None}


def _unknown_kind(scene: Scene, label: str) -> str | None:
    """Return the kind of thing that `label` names, of which the scene's teacher of words knows none; None where it does."""
    return None if needs_no_teacher(scene, label) else unknown_kind(text_head(scene).spec.text_encoder or "", label)


def refuse_unknown(scene: Scene, label: str, encode: Encode | None = None) -> None:
    """Raise F4xError where the scene's teacher knows nothing of the kind of thing that `label` names."""
    kind = _unknown_kind(scene, label)
    if kind is None:
        return
    _, hint = instead(scene, [label], encode)
    raise F4xError(
        f"In the scene '{scene.name}' '{label}' is not looked for, because the teacher of its words knows no {kind}; click on the"
        f" thing or draw a box around it, or add another teacher with `f4x distill SCENE --teacher NAME`{hint and f'; {hint}'}."
    )


def lacks_people(scene: Scene, label: str) -> bool:
    """Return True if `label` names people, of whom neither the fit of a scene nor its teacher of words knows any."""
    if people_of(scene) is not None or not names_people(scene, label):
        return False
    return not labels_of(scene) or unknown_kind(text_head(scene).spec.text_encoder or "", label) is not None


def refuse_evidence_of_another(scene: Scene, label: str, found: Selection, encode: Encode | None = None) -> None:
    """Raise F4xError where what `label` has `found` answers clearly more to a label that means something else."""
    if needs_no_teacher(scene, label):
        return
    head = text_head(scene)
    encoder = head.spec.text_encoder or ""
    null = null_vector(encoder)
    if null is None or not found.chosen.any() or encoder not in scene.require_field().vocabularies:
        return
    labels, vectors = scene.require_field().vocabulary(encoder)
    asked = ask_for(scene, [label], [], encode=encode).vectors[:1]
    patches = group_of(scene)
    everyone = np.maximum(np.bincount(patches.index, minlength=len(patches.weight)), 1)
    mass = patches.weight * np.bincount(patches.index, found.chosen, len(patches.weight)) / everyone
    seen = mass @ evidence(patches.features(head), np.concatenate([asked, vectors]), null) / mass.sum()
    words = {*spellings(label)}
    kinds = np.array([not words.isdisjoint(spellings(one.split()[-1])) and not names_another(one) for one in labels])
    own = max(seen[0], seen[1:][kinds].max(initial=-np.inf))  # a black swan is a swan
    broader = np.array([one in kinds_of(label) for one in labels])  # any swan is a bird, which the teacher knows better
    known = np.array([unknown_kind(encoder, one) is None for one in labels])
    others = np.where((cosines(vectors, asked)[:, 0] < ALIKE) & ~kinds & ~broader & known, seen[1:], -np.inf)
    best = int(others.argmax())
    if others[best] > own + CLEARLY:
        raise F4xError(
            f"In the scene '{scene.name}' what '{label}' finds answers more to '{labels[best]}' ({others[best]:.2f} against"
            f" {own:.2f}), so nothing is selected; is {labels[best]} meant? Then ask for that; else click on the thing or draw a"
            " box around it."
        )
