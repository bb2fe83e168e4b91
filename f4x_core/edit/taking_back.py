"""What takes away or lessens a change that an edit made: "remove the glow from the horse". The edit is taken back.

Asked only of sentences that are not understood otherwise, so that none of them is answered with what makes the change.
"""

from __future__ import annotations

import re

from ..language.colours import colour
from ..language.grammar import Final, Reading, Refusal, Rule, either, here, table, tokenise
from ..language.lexicon import every_form, singular, word_set
from ..language.verbs import any_form
from . import operations as ops
from .description import describe
from .graded import BRIGHTNESS, SIZE, SPEED
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
            f"{BRIGHTNESS.much}|{BRIGHTNESS.little}|color|colors|coloring|contrast|saturation|warmth|brightness|darkness|grayness|"
            + any_form("brighten", "darken", "saturate", "desaturate", "warm", "cool"): _COLOURED,
            f"speed|pace|tempo|{SPEED.much}": (ops.Retime, ops.Freeze),
            "opacity|visibility": (ops.Opacity, ops.Delete),
            f"{SIZE.much}|{SIZE.little}|size|scale|place|position|spot|direction|rotation|tilting|shifting|"
            + every_form("move|shift|rotate|spin|turn|tilt|raise|lower|scale")
            + "|"
            + any_form("enlarge", "shrink"): (ops.Transform, ops.Swap),
        },
        reserve=False,
    ),
    (colour | any_look) >> (lambda _: _COLOURED),
)
"""Words that say of what a thing has a natural state; they also name changes that are made."""
_LESSENING, _ENDING = "less", "gone"
_RESTORING = either(
    table({"less|too much|so much": _LESSENING}, reserve=False),
    table(
        {
            every_form("undo|revert|reset|cancel|restore|take back|stop|quit|cease")
            + "|[like|as|how] [it|he|she|they] [was|were] (before)|as before|[its|his|her|their] [old|first|previous]|no longer|"
            "any more|anymore|any longer|back to|back in|back|normal|original|usual|natural|former": _ENDING
        },
        reserve=False,
    ),
    table({"go|goes": _ENDING}, reserve=False) + here(lambda reading, at: not reading.word(at).isalpha()),
)
_REMOVING = either(
    _RESTORING,
    table(
        {
            every_form("reduce|lower|decrease|lessen|weaken|dull|soften|tame|tone down|turn down"): _LESSENING,
            any_form("delete")
            + "|off|away|without|no|disappear|vanish|gone|ugly|awful|terrible|horrible|annoying|distracting|wrong": _ENDING,
        },
        reserve=False,
    ),
    table({"too|so|down": _LESSENING}, reserve=False),
)
"""Words that take away, with what they say."""
_PREFIXED = re.compile(r"(?:un|de|dis|non)(?P<rest>[a-z]{3,})")
_ANYTHING = word_set("everything selection Gaussian")
"""Words for whom an edit is that may hold any thing."""
_ENDS = word_set("and then but that which who , . ; : !")
"""Words at which what is taken away is over."""


class TakenBack(Final):
    """A sentence that takes a change away or lessens it, which is for the edit that made it."""

    def __init__(self, change: str, kinds: Kinds, things: set[str], lessened: bool = False):
        """`change`: as it was said; `kinds`: operations that make it; `things`: labels in the sentence."""
        super().__init__(
            f"That takes a change back ('{change}'): `f4x undo SCENE` takes back the last edits, the list of changes in Blender"
            " any of them."
        )
        self.change, self.kinds, self.things, self.lessened = change, kinds, things, lessened

    def operation(self, stack: EditStack) -> ops.TakeBack:
        """What takes back the edit of a scene that made the change; Refusal where there is none, or more than one."""
        found = [edit for edit in stack.edits if edit.enabled and isinstance(edit.operation, self.kinds)]
        meant = {edit.id: describe(edit.operation) for edit in found}
        if self.things:
            about = self.things | _ANYTHING
            meant = {id: words for id, words in meant.items() if about & {*map(singular, words.split())}}
        named = "', '".join(meant.values())
        if not meant:
            whom = f" for '{', '.join(sorted(self.things))}'" if self.things else ""
            raise Refusal(f"No edit of this scene made '{self.change}'{whom}; `f4x history SCENE` lists them.")
        if len(meant) > 1:
            raise Refusal(f"More than one edit may be meant: '{named}'; `f4x undo SCENE` takes back the last ones.")
        if self.lessened:
            raise Refusal(f"'{named}' is there as it was said; take it back, and say how much it is to be.")
        ((id, words),) = meant.items()
        return ops.TakeBack(id, words)


def taken_back(reading: Reading) -> TakenBack | None:
    """The change that a sentence takes away or lessens; None where it does not."""
    labels = {words[-1] for words in reading.known}
    things = {singular(word) for word in reading.words} & labels
    for at, token in enumerate(reading.tokens):
        for changes, markers in ((_CHANGES, _REMOVING), (_QUALITIES, _RESTORING)):
            for end, (kinds,) in changes.at(reading, at).items():
                if found := _marks(reading, at, end, markers):
                    return TakenBack(reading.text_of(at, end), kinds, things, lessened=_LESSENING in found)
        if round := turned_round(token.text):
            return TakenBack(*round, things)
    return None


def turned_round(word: str) -> tuple[str, Kinds] | None:
    """The change that a word takes back ("unfreeze"), so that it is no slip of it; None where it takes none."""
    if not (found := _PREFIXED.fullmatch(word)):
        return None
    change = found["rest"]
    ways = _TURNED.at(Reading.of(change, tokenise(change), {}), 0)
    return (change, ways[1][0]) if 1 in ways else None


_TURNED = either(_CHANGES, _QUALITIES)


def _marks(reading: Reading, at: int, end: int, markers: Rule) -> set[str]:
    """What the words that take away say that stand in the same clause as the words [at, end)."""
    first = next((i + 1 for i in range(at - 1, -1, -1) if reading.word(i) in _ENDS), 0)
    last = next((i for i in range(end, len(reading.tokens)) if reading.word(i) in _ENDS), len(reading.tokens))
    return {
        said
        for i in (*range(first, at), *range(end, last))
        for stop, (said,) in markers.at(reading, i).items()
        if stop <= last and (stop <= at or i >= end)
    }
