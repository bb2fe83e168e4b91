"""Words to vectors: from the vocabulary that the scene carries, else from a text encoder where one is installed."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import TYPE_CHECKING

import numpy as np

from ..errors import F4xError
from ..features.unknown import unknown_kind
from ..language.lexicon import misspelt, spellings
from ..scene import Scene
from ..scene.field import FieldHead

if TYPE_CHECKING:
    from ..features.text import TextEncoder

BACKGROUND = ("sky", "tree", "grass", "sand", "water", "road", "wall", "fence", "building", "floor")
"""What an asked word is weighed against when no other words are given: what surrounds things."""
Encode = Callable[[str, list[str]], np.ndarray]
"""(name of a text encoder, labels) -> (L,dim) unit vectors."""


@dataclass(frozen=True, eq=False)
class TextQuery:
    """Labels with their vectors in the space of one head; the first `targets` of them are looked for."""

    head: FieldHead
    """The head that decodes features of the labels' space."""
    labels: tuple[str, ...]
    """L labels: the targets, then what they are weighed against."""
    vectors: np.ndarray
    """(L,C) float32."""
    targets: int
    """Number of targets."""


def words_of(text: str) -> list[str]:
    """Return the labels of a list with commas, without doubles; F4xError where there is none."""
    words = list(dict.fromkeys(word for part in text.split(",") if (word := " ".join(part.split()))))
    if not words:
        raise F4xError("The query names no label; give at least one word, for example --text swan.")
    return words


def ask_for(
    scene: Scene,
    labels: Sequence[str],
    negatives: Sequence[str] | None = None,
    head: str | None = None,
    encode: Encode | None = None,
) -> TextQuery:
    """Return the query for `labels`, weighed against `negatives` (`BACKGROUND` when None), in the head `head`.

    By default the first head whose spec names a text encoder. Vectors come from the scene's vocabulary (see `spellings`);
    labels that it lacks from `encode`. Raises F4xError: a scene without field or without such a head, a label that nobody knows.
    """
    targets = words_of(",".join(labels))
    decoder = text_head(scene, head)
    encoder = decoder.spec.text_encoder
    assert encoder is not None
    given = negatives is not None
    against = words_of(",".join(negatives)) if negatives else []
    known: tuple[str, ...] = ()
    rows: dict[str, np.ndarray] = {}
    if encoder in scene.require_field().vocabularies:
        known, table = scene.require_field().vocabulary(encoder)
        rows = {word.lower(): row for word, row in zip(known, table, strict=True)}
    stored = {word.lower(): word for word in known}
    targets, against = (
        list(dict.fromkeys(next((stored[form] for form in spellings(word) if form in stored), word) for word in words))
        for words in (targets, against)
    )
    if not given:  # of the default ones, those at hand: no encoder is started for them alone
        against = [word for word in BACKGROUND if word in rows] if rows else list(BACKGROUND)
    against = [word for word in against if word.lower() not in {target.lower() for target in targets}]
    missing = [word for word in (*targets, *against) if word.lower() not in rows]
    if missing and encode is None:
        raise F4xError(unknown_label(scene, missing[0], list(known), encoder))
    if missing:
        assert encode is not None
        try:
            vectors = encode(encoder, missing)
        except F4xError as error:
            raise F4xError(f"{unknown_label(scene, missing[0], list(known), encoder)[:-1]} ({error})") from error
        rows |= {word.lower(): row for word, row in zip(missing, vectors, strict=True)}
    everything = (*targets, *against)
    return TextQuery(decoder, everything, np.stack([rows[word.lower()] for word in everything]), len(targets))


def text_head(scene: Scene, name: str | None = None) -> FieldHead:
    """Return the head `name`, or the first that understands words; F4xError where there is none."""
    heads = [scene.require_field().head(name)] if name else list(scene.require_field().heads)
    for head in heads:
        if head.spec.text_encoder is not None:
            return head
    raise F4xError(
        f"The scene '{scene.name}' finds no things by words{f' with its head {name}' if name else ' yet'};"
        " add features that do with `f4x distill SCENE --teacher text`."
    )


def no_teacher_knows(scene: Scene, label: str) -> bool:
    """Return True if no teacher of words of the scene knows `label`, or none is there."""
    heads = [] if scene.features is None else scene.features.heads
    return all(unknown_kind(encoder, label) for head in heads if (encoder := head.spec.text_encoder))


def encode_labels(encoder: str, labels: list[str]) -> np.ndarray:
    """Return unit vectors (L,dim) from the text encoder of that name; F4xError where it is not installed. An `Encode`."""
    return _encoder(encoder).encode(labels)


@lru_cache(maxsize=1)
def _encoder(name: str) -> TextEncoder:
    """Return the text encoder of that name, loaded once because loading takes seconds."""
    from ..features.text import load_text_encoder

    return load_text_encoder(name)


def unknown_label(scene: Scene, label: str, known: Sequence[str], encoder: str) -> str:
    """Return the sentence about a label that the vocabulary lacks."""
    meant = misspelt(label, known)
    hint = f"; near it is {meant}" if meant else ""
    return (
        f"The scene '{scene.name}' knows {len(known)} words and lacks '{label}'{hint}; add it with"
        f' `f4x distill SCENE --vocabulary "{label}"` where the text encoder {encoder} is installed.'
    )
