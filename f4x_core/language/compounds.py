"""Names of several words: which of them says what kind of thing is meant, and what the others ask for."""

from __future__ import annotations

import re
from collections.abc import Collection

from .lexicon import spellings, word_set

_IDIOMS = ("hot dog", "sea horse", "sea lion", "guinea pig", "teddy bear", "toilet seat", "shoe tree", "clothes horse")
_MADE_UP = ("toy", "stuffed", "plush", "teddy", "rocking", "gummy", "cartoon", "imaginary")
"""What has one of these before it is no such thing: a toy dog is a toy."""
ADJECTIVE = (
    r"red|orange|yellow|green|blue|purple|violet|pink|brown|black|white|gr[ae]y|gold(?:en)?|silver|dark|light|bright|pale|"
    r"colou?rful|big|large|small|little|tiny|huge|tall|short|long|thin|thick|fat|young|old|new|beautiful|pretty|nice|cute"
)
"""Words before the name of a thing that say how it looks: the search leaves them out, and the answer says so."""

_DESCRIBING = re.compile(r".{2,}(?:ing|ed|y|en|ish|ful|ous|ic|al|ive|less)")
_PLAIN_ADJECTIVES = word_set(
    "old young plain bare dry wet fat thin round open closed broken clean soft hard hot cheap real wild rough odd strange huge"
)


def is_adjective(word: str) -> bool:
    """Return True if a word before a noun says what it is like, as far as its form tells."""
    return word in _PLAIN_ADJECTIVES or bool(_DESCRIBING.fullmatch(word))


JOINTS = ("of", "in", "with", "wearing", "who", "that", "which")
"""Words behind which a thing is told by something else."""


def names_another(label: str) -> bool:
    """Return True if a name's last word does not say what kind of thing it is: "hot dog", "toy car"."""
    first, *more = label.lower().split()
    return bool(more) and (first in _MADE_UP or not {*spellings(label)}.isdisjoint(_IDIOMS))


def head_of(label: str, known: Collection[str]) -> str | None:
    """Return the kind of thing that a compound is: "house" of "dog house", "roof" of "roof of the house", "man" of "man in red".

    None for a label in `known` (lower case) and for a thing with mere adjectives ("parked car"): its last word is the thing itself.
    """
    words = label.lower().split()
    if len(words) < 2 or label.lower() in known:
        return None
    joint = next(
        (
            i
            for i, word in enumerate(words[1:], 1)
            if word in JOINTS or (word.endswith("ing") and words[i - 1] in known)
        ),
        0,
    )
    if joint:
        return " ".join(words[:joint])
    owner = next((i for i in range(len(words) - 1, 0, -1) if words[i - 1].endswith(("'s", "s'"))), 0)
    if owner:
        return " ".join(words[owner:])
    heads = (i for i in range(1, len(words)) if " ".join(words[i:]) in known)
    start = next(heads, len(words) - 1)
    return " ".join(words[start:]) if any({*spellings(word)} & {*known} for word in words[:start]) else None
