"""Label vectors that travel with a scene, so that it can be asked by word where no text encoder is installed."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import replace

import numpy as np

from ..errors import F4xError
from ..features.text import TextEncoder, load_text_encoder
from ..native.kernels import torch_threads
from ..parallel import side_by_side
from ..scene import Scene, Vocabulary

EVERYDAY = tuple(
    (  # noqa: SIM905 - a list would take a line for each
        "person man woman child face hand dog cat horse cow sheep camel elephant bear bird swan duck fish animal car "
        "truck bus train bicycle motorcycle boat airplane wheel tree bush leaf flower grass sand soil rock mountain water "
        "river sea sky cloud snow road pavement wall fence building house roof window door floor ceiling stairs table "
        "chair sofa bed lamp curtain shelf book screen telephone keyboard bottle cup bowl plate food fruit bread bag box "
        "clothes shirt trousers shoe hat ball toy tool sign light shadow"
    ).split()
)
"""Words for things in everyday clips; 80 words of 384 numbers take 60 kB."""


def with_vocabulary(
    scene: Scene,
    labels: Sequence[str],
    load: Callable[[str], TextEncoder] = load_text_encoder,
    encoders: Iterable[str] | None = None,
) -> Scene:
    """Return the scene with `labels` in the vocabulary of `encoders`, by default all that its heads name; words it had stay.

    Raises F4xError: no label, a scene without a head that understands words, an encoder that is not installed.
    """
    labels = list(dict.fromkeys(label.strip() for label in labels if label.strip()))
    if not labels:
        raise F4xError("The vocabulary has no label; give words, or a file with one label per line.")
    field = scene.require_field()
    named = sorted({head.spec.text_encoder for head in field.heads if head.spec.text_encoder})
    if not named:
        raise F4xError(
            f"{scene.name}: no head of the scene understands words (it has {', '.join(field.names)}); distil `text` first."
        )
    vocabularies = dict(field.vocabularies)
    for name in named if encoders is None else encoders:
        old = vocabularies.get(name, Vocabulary((), np.zeros((0, 0), np.float16)))
        new = [label for label in labels if label not in old.labels]
        if new:
            with side_by_side(1), torch_threads(1):  # sums of BLAS and torch depend on their numbers of threads
                vectors = load(name).encode(new).astype(np.float16)
            vectors = np.concatenate([old.vectors, vectors]) if old.labels else vectors
            vocabularies[name] = Vocabulary((*old.labels, *new), vectors)
    return replace(scene, features=replace(field, vocabularies=vocabularies))
