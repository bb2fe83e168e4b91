"""Words that the packaged teacher of words does not know. Needs no torch."""

from __future__ import annotations

import re

from ..language.compounds import JOINTS, names_another
from ..language.lexicon import PEOPLE

_SURFACES = (
    r"streets?|roads?|pavement|sidewalk|tarmac|asphalt|concrete|gravel|ground|floor|soil|dirt|earth|mud|sand|beach|desert|lawn"
    r"|grass|meadow|fields?|snow|ice|water|river|lake|pond|sea|ocean|carpet|marble|tiles?|ceiling"
)
_PLANTS = r"trees?|bush(?:es)?|hedges?|shrubs?|foliage|lea(?:f|ves)|ivy|reeds?|forest|woods|plants?"
_SKY = r"sky|clouds?|sun|moon|stars|horizon"
_DRAWN = (
    r"(?:cartoon|drawn|painted|animated|low-poly|clip-?art|comic)(?: .+)?"
    r"|(?:drawing|painting|sketch|cartoon|picture|photo|image)s?(?: of .+)?"
    r"|(?:logo|icon|emoji|graffiti|mural|doodle|letter|text|writing|word|number|symbol|subtitle)s?"
)
UNKNOWN = {"minilm": {"people": PEOPLE, "surfaces": _SURFACES, "plants": _PLANTS, "sky": _SKY, "drawn things": _DRAWN}}
"""Text encoder -> kind -> names of what the teacher that speaks through it knows nothing of (docs/features.md)."""
_BESIDE = re.compile(rf" (?:{'|'.join((*JOINTS, 'on', 'at', 'by', 'near', 'under', 'behind', 'beside', 'from'))}) ")
"""Before one of these a name says what it means, behind it where that is: a dog on the grass is a dog."""


def unknown_kind(encoder: str, name: str) -> str | None:
    """Return the kind of things that `name` is one of and the teacher behind the text `encoder` does not know; else None.

    Of several words the last says what kind of thing it is: "dirt road", but "toy soldier" (`names_another`).
    """
    name = re.sub(r"^(?:the|a|an) ", "", " ".join(name.lower().split()))
    thing = _BESIDE.split(name, maxsplit=1)[0]
    names = {name} if names_another(thing) else {name, thing.split()[-1]} if thing else set()
    kinds = UNKNOWN.get(encoder, {}).items()
    return next((kind for kind, pattern in kinds if any(re.fullmatch(pattern, each) for each in names)), None)
