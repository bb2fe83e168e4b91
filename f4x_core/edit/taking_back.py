"""What takes away or lessens a change that an edit made: "remove the glow from the horse". No operation does that; the edit goes.

Asked only of sentences that are not understood otherwise, so that none of them is answered with a proposal that adds the change.
"""

from __future__ import annotations

import re

from ..language.colours import colour
from ..language.grammar import Final, Reading, Rule, either, here, literal, table, tokenise
from ..language.lexicon import every_form, singular, word_set
from ..language.verbs import any_form
from . import operations as ops
from .description import describe
from .qualities import any_look
from .stack import EditStack

Kinds = tuple[type, ...]
"""Operations that make a change."""
_COLOURED: Kinds = (ops.Recolour, ops.Style, ops.Match, ops.Grade)
_CHANGES = table(
    {
        any_form("glow") + "|halo|aura|glowy|shiny|luminous|radiant": (ops.Glow,),
        any_form("blur") + "|blurred|blurry|blurriness|fuzzy|hazy|softness|out of focus": (ops.Blur,),
        any_form("tint") + "|tinge|dye|dyed|paint|painted|paint job|recolored|desaturation": _COLOURED,
        "look|style|filter|effect|black and white|grayscale": (*_COLOURED, ops.Glow, ops.Blur),
        every_form("freeze|pause|hold still|stand still") + "|freeze frame": (ops.Freeze,),
        any_form("slow", "quicken")
        + "|slowness|slow motion|slow mo|slowmo|fast forward|fast motion|time lapse|retime": (ops.Retime,),
        any_form("loop"): (ops.Loop,),
        any_form("reverse") + "|backward|in reverse": (ops.Reverse,),
        every_form("copy|clone|duplicate|echo") + "|copies|clones|trail|trails|ghost|ghosts|echoes|afterimages": (
            ops.Duplicate,
        ),
        every_form("fade|fade out|fade in|hide")
        + "|transparency|transparent|see through|translucent|hidden|invisible": (ops.Opacity, ops.Delete),
        every_form("delete|remove|erase"): (ops.Delete, ops.Extract, ops.Opacity),
        every_form("swap|switch places"): (ops.Swap,),
    },
    reserve=False,
)
"""Words for changes -> the operations that make them."""
_QUALITIES = either(
    table(
        {
            "color|colors|coloring|contrast|saturation|warmth|brightness|darkness|grayness|"
            + any_form("brighten", "darken", "saturate", "desaturate", "warm", "cool"): _COLOURED,
            "speed|pace|tempo": (ops.Retime, ops.Freeze),
            "opacity|visibility": (ops.Opacity, ops.Delete),
            "size|scale|place|position|spot|direction|rotation|tilting|shifting|"
            + every_form("move|shift|rotate|spin|turn|tilt|raise|lower|scale")
            + "|"
            + any_form("enlarge", "shrink"): (ops.Transform, ops.Swap),
        },
        reserve=False,
    ),
    (colour | any_look) >> (lambda _: _COLOURED),
)
"""Words that say of what a thing has a natural state; they also name changes that are made."""
_RESTORING = either(
    literal(
        every_form("undo|revert|reset|cancel|restore|take back|stop|quit|cease")
        + "|less|too much|so much|no longer|any more|anymore|any longer|back to|back in|back|normal|original|usual|natural|former"
    ),
    literal("go|goes") + here(lambda reading, at: not reading.word(at).isalpha()),
)
_REMOVING = either(
    _RESTORING,
    literal(any_form("delete") + "|" + every_form("reduce|lower|decrease|lessen|weaken|dull|soften|tame")),
    literal("off|away|down|without|no|disappear|vanish|gone|ugly|awful|terrible|horrible|annoying|distracting|wrong"),
    literal("too|so") + here(lambda reading, at: reading.word(at).isalpha()),
)
"""Words that take away."""
_PREFIXED = re.compile(r"(?:un|de|dis|non)(?P<rest>[a-z]{3,})")
_ANYTHING = word_set("everything selection Gaussian")
"""Words for whom an edit is that may hold any thing."""
_ENDS = word_set("and then but that which who , . ; : !")
"""Words at which what is taken away is over."""


class TakenBack(Final):
    """A sentence that takes a change away, which only taking back its edit does."""

    def __init__(self, change: str, kinds: Kinds, things: set[str]):
        """`change`: as it was said; `kinds`: operations that make it; `things`: labels in the sentence."""
        super().__init__(
            f"That takes a change back ('{change}'): `f4x undo SCENE` takes back the last edits, the list of changes in Blender"
            " any of them."
        )
        self.change, self.kinds, self.things = change, kinds, things

    def reason_in(self, stack: EditStack) -> str:
        """The sentence about the edits of a scene that made the change."""
        made = [
            (number, describe(edit.operation))
            for number, edit in enumerate(stack.edits, 1)
            if edit.enabled and isinstance(edit.operation, self.kinds)
        ]
        spoken_of = [
            (n, words)
            for n, words in made
            if not self.things or (self.things | _ANYTHING) & {*map(singular, words.split())}
        ]
        if not spoken_of:
            whom = f" for '{', '.join(sorted(self.things))}'" if self.things else ""
            return f"No edit of this scene made '{self.change}'{whom}; nothing can be taken back (`f4x history SCENE` lists them)."
        number, words = spoken_of[-1]
        steps = len(stack) - number + 1
        if steps == 1:
            return f"Take back the last edit, '{words}': `f4x undo SCENE`, or the button for it."
        return (
            f"Take back edit {number}, '{words}': remove it from the list of changes in Blender; `f4x undo SCENE --count {steps}`"
            " takes it back with what came after it."
        )


def taken_back(reading: Reading) -> TakenBack | None:
    """The change that a sentence takes away or lessens; None where it does not."""
    labels = {words[-1] for words in reading.known}
    things = {singular(word) for word in reading.words} & labels
    for at, token in enumerate(reading.tokens):
        for changes, markers in ((_CHANGES, _REMOVING), (_QUALITIES, _RESTORING)):
            for end, (kinds,) in changes.at(reading, at).items():
                if _is_marked(reading, at, end, markers):
                    return TakenBack(reading.text_of(at, end), kinds, things)
        if round := turned_round(token.text):
            return TakenBack(*round, things)
    return None


def turned_round(word: str) -> tuple[str, Kinds] | None:
    """The change that a word takes back ("unfreeze"), so that it is no slip of it; None where it takes none."""
    found = _PREFIXED.fullmatch(word)
    change = found["rest"] if found else ""
    ways = either(_CHANGES, _QUALITIES).at(Reading.of(change, tokenise(change), {}), 0)
    return (change, ways[1][0]) if 1 in ways else None


def _is_marked(reading: Reading, at: int, end: int, markers: Rule) -> bool:
    """Whether a word that takes away stands in the same clause as the words [at, end)."""
    first = next((i + 1 for i in range(at - 1, -1, -1) if reading.word(i) in _ENDS), 0)
    last = next((i for i in range(end, len(reading.tokens)) if reading.word(i) in _ENDS), len(reading.tokens))
    return any(
        stop <= at or i >= end
        for i in (*range(first, at), *range(end, last))
        for stop in markers.at(reading, i)
        if stop <= last
    )
