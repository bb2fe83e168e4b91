"""The commands of the language: a table of verbs, of what each takes, and of the operation that it makes."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

from ..language.amounts import Distance, distance, fraction, fraction_of, multiple, number, percent, signed, steps
from ..language.colours import colour, colourish
from ..language.grammar import Mismatch, Rule, either, keyword, listed, silent, table
from ..language.lexicon import PICTURE
from ..language.times import TimeExpression, duration
from . import making, qualities
from .making import Value
from .phrases import (
    beside_itself,
    everything_but,
    everything_else,
    known_noun,
    known_thing,
    name,
    place,
    thing,
    whose,
)
from .selects import All


def REMARK() -> Value:  # it stands for what is said and asks for nothing
    """Make nothing: "leave the dog alone"."""
    raise Mismatch


# Commands ------------------------------------------------------------------------------------------------------------


def AGAIN() -> Value:  # likewise for the command before
    """Make what was said before: "do the same with the cat"."""
    raise Mismatch


@dataclass(frozen=True)
class Use:
    """How a command may be said beside its full form."""

    gapped: bool = True
    """Its verb may be left out: "make the dog red and the cat blue"."""
    bare: bool = True
    """After another command "it" may be left out: "move the dog left and turn around"."""
    whole: bool = False
    """Without a thing it is for everything: "increase the contrast"."""
    timed: bool = False
    """With a time and without a thing it is for everything: "play the last second in slow motion"."""


USUAL = Use()
FULL = Use(gapped=False, bare=False)
NAMED = Use(bare=False)
TIMED = Use(timed=True)
WHOLE = Use(whole=True)


@dataclass(frozen=True)
class Command:
    """A verb, what it takes besides somebody and a time, and what it does."""

    example: str
    """A sentence that uses it; shown to those whose sentence is not understood."""
    verbs: str
    """Alternatives with `|`; their first words are inflected. Empty: said without a verb, or only by `itself`."""
    make: Callable[..., Value | tuple[tuple[Value], ...]]
    """From the values of the slots to what is done."""
    slots: Mapping[str, Rule]
    """By argument name of `make`, in any order; those without a value are words that add nothing to the verb."""
    needed: frozenset[str] = frozenset()
    """Slots without which it means nothing."""
    who: Rule = thing
    """The phrase for whom it is about."""
    itself: str = ""
    """Verbs of which the thing is the subject: "the dog should stop"."""
    use: Use = USUAL


COMMANDS: list[Command] = []
"""In the order in which they are preferred."""


def _command(
    example: str,
    verbs: str,
    make: Callable[..., Any],
    needed: str = "",
    *,
    who: Rule = thing,
    itself: str = "",
    use: Use = USUAL,
    **slots: Any,
) -> None:
    COMMANDS.append(Command(example, verbs, make, slots, frozenset(needed.split()), who, itself, use))


Given = Value | tuple[tuple[Value], ...]
"""A value, or several as `listed` gives them."""


def always(value: Value) -> Callable[[], Value]:
    """Make the same value, whatever is said besides."""
    return lambda: value


def as_given(values: Given) -> Given:
    """Make the values themselves of a slot `values`."""
    return values


def _values(*rules: Rule) -> Rule:
    return listed(either(*rules), keyword("and|,|, and|but|and also|as well as|plus|but also|and then"))


# Colours
_coloured = qualities.colour_value | qualities.without_colour
_command(
    "make the dog red",
    "make|render|have|get",
    as_given,
    "values",
    values=_values(qualities.made, keyword("in") + _coloured, keyword("gone") >> always(making.deleted)),
)
_tint = ~keyword("a|an") + ~keyword("slight|faint") + (colour | colourish)
_command(
    "shift the hue of the car to red",
    "shift|change|turn|set|rotate|move|make|adjust",
    making.hued,
    "rgb",
    who=whose("hue|hues|tone"),
    rgb=~keyword("to|toward|into") + colour,
)


as_long = either(
    multiple + keyword("as long") >> making.stretched,
    multiple + keyword("longer") >> making.stretched,
    ~keyword("to|by") + ~keyword("a factor of") + fraction_of("length|duration|time") >> making.stretched,
    keyword("by") + ~keyword("a factor of") + (multiple | number) >> making.stretched,
)
_command("make the dog take twice as long", "", lambda by: by, "by", itself="take|last", by=as_long)

# Opacity
_again = keyword("again|once more|back")
_command("show the dog again", "show|reveal", making.shown, again=_again >> (lambda: True))
_command(
    "bring the dog back", "bring", always(making.opacity(making.SHOWN)), "back", back=keyword("back|back again|back in")
)
_to_fraction = keyword("to") + either(percent, fraction, number) + ~keyword("opacity") | keyword("by") + percent >> (
    lambda x: 1 - x
)
_command("fade the background", "fade", lambda by=0.5: making.faded(by), itself="fade", by=_to_fraction)


# Taking out, and leaving alone
DELETING = (
    "remove|delete|erase|get rid of|eliminate|drop|lose|discard|scrap|trash|do away with|dump|ditch"
    "|clear|banish|scratch|kill|cut|purge|rid us of"
)
SPLIT = "take|cut|throw|wipe|rub|edit|crop|get|kick|strip|clean|clear|chuck|leave|mask|erase|delete|remove|chop|pull"
OUT = keyword(
    f"out|away|off|[off|out of|away from] [the|this|my|our] (whole|entire) [{PICTURE}]|out of [there|here|sight]|from "
    f"[sight|view]|from [the|this|my|our] (whole|entire) [{PICTURE}]"
)
_delete, _extract = always(making.deleted), always(making.extracted)
_command("remove everything except the dog", DELETING, _extract, who=everything_but, use=NAMED)
_command("remove the car", DELETING, _delete, itself="go away|be gone|not be there|not be visible|get lost", use=NAMED)
_command("take the car out", SPLIT, _delete, "out", use=NAMED, out=OUT)
KEEPING = "keep|show|show me|leave|retain|have|display|see|preserve|let me see"
ONLY = keyword("only|just|nothing but|solely|nothing except|nothing else but|nothing other than")
_in_colour = keyword("in (full) [color|colors]|colored")
_command(
    "show only the dog in color",
    KEEPING,
    always(making.rest_grayed),
    "only colored",
    use=NAMED,
    only=ONLY,
    colored=_in_colour,
)
_unwanted = keyword(
    "[i|we] do not [want|need] (to see)|[i|we] do not want to have|[i|we] no longer [want|need] (to see)|there should be "
    "no|there [should|must|shall|may] not be|there must be no|let there be no|[i|we] can do without|no"
)
_command(
    "I do not want to see the dog",
    "",
    _delete,
    "unwanted",
    use=FULL,
    unwanted=_unwanted,
    there=keyword("in [the|this] [scene|picture|video|clip|image|shot]|any more|anymore|there|any longer"),
)
_without = keyword("(the|this) [scene|picture|video|clip|image] (but) without|without|no more|minus")
_command("without the dog", "", _delete, "without", use=NAMED, without=_without)

# Moving and turning
_ROTATING = "rotate|spin|revolve|pivot|swivel|twirl"
SENSE = table(
    {
        "(over) (to|toward|on|into) (the|its|his|her|their) left (side|hand side)|leftward|counterclockwise"
        "|counter clockwise|anticlockwise|anti clockwise": -1,
        "(over) (to|toward|on|into) (the|its|his|her|their) right (side|hand side)|rightward|clockwise": 1,
    }
)
FULL_TURN = table(
    {
        "(a) half (a) [turn|rotation|spin|circle|revolution]|u turn|a 180": 180.0,
        "(a) quarter (of a) [turn|rotation|spin|circle]|(a) right angle": 90.0,
        "(a) three quarter turn|three quarters of a turn": 270.0,
        "(a|one) [full|complete|whole] [turn|circle|rotation|360|spin|revolution]|a [turn|spin|rotation]|(a) 360|full "
        "360": 360.0,
        "two (full) [turns|rotations|spins]": 720.0,
        "three (full) [turns|rotations|spins]": 1080.0,
    },
    reserve=False,
)
_so_often = table(
    {
        "180|[halfway|half way] (around)": 180.0,
        "360|all the way around|once (around|completely)|around once|one [full|complete|whole] time": 360.0,
        "twice|two times": 720.0,
        "three times": 1080.0,
        "quarter": 90.0,
    },
    reserve=False,
)
_by = ~keyword("by|through|for")
ANGLE = either(
    _by + signed + keyword("degrees|degree|deg|°|º"),
    ~keyword("by") + signed,
    _by + ~keyword("a|one") + (FULL_TURN | _so_often),
)
_axis = keyword(
    "[around|about|on] [its|his|her|their|the] (own) (vertical) axis|[around|about] the vertical|in place|on the spot"
)
_command(
    "rotate the dog by 90 degrees", _ROTATING, making.rotated, itself=_ROTATING, angle=ANGLE, sense=SENSE, axis=_axis
)

# Copies
_lagging = (
    ~keyword(",")
    + ~keyword("but|that is|which is|that|which|by")
    + ~keyword("delayed|lagging|trailing|starting|running|runs|run|comes|come|plays|play|moves|move|starts|start")
    + ~keyword("by")
)
_following = keyword(
    "that [follows|trails|chases|lags|runs|walks|moves] (behind|after) (it|"
    "him|her)|[following|trailing|lagging] (behind|after) (it|him|her)|"
    "[follow|trail] (behind|after) (it|him|her|the original)|to [follow|trail] (behind|after) (it|him|her|the original)"
)
TRAIL_COPIES, TRAIL_LAG = 3.0, TimeExpression(seconds=0.2)
"""Copies of a trail, and the time from one to the next."""
SHIFT = either(
    ~keyword(",") + ~keyword("each (one)") + keyword("[a bit|a little|slightly] [late|later|behind|delayed]")
    >> (lambda: TRAIL_LAG),
    ~keyword(",")
    + _following
    + ~keyword("by|with|at|on the same path")
    + ~keyword("a delay of|a distance of")
    + duration
    + ~keyword("later|behind|after (it)|behind it|of delay|delay|afterward|on its path|along (its|the same) path"),
    _lagging
    + duration
    + keyword(
        "later|behind|late|after|[after|behind] [it|him|her|itself|the original|the first (one)|the other (one)]|afterward|"
        "delayed|in the future|too late|late|offset (each)"
    ),
    keyword("(but) delayed by|(but) with a [lag|delay|gap] of|(but) lagging (behind) by|(but) trailing (behind) by")
    + duration,
    keyword("with (a)")
    + duration
    + keyword("delay|lag|between [them|each|the copies|each of them]|in between|apart|of delay|of lag"),
    _lagging + duration + keyword("earlier|ahead|before|early|before it|in advance|ahead of [it|the original]|sooner")
    >> (lambda length: length.plus(length, -2.0)),
)
_in_a_row = keyword(
    "in a row|in a line|side by side|next to each other|one after another|one after the other|beside each other"
)
_called_so = ~keyword(",") + keyword("called|named|by the name of") + name
_apart = distance + keyword("apart") | ~keyword("by") + number + keyword("apart") >> Distance
_another_size = (
    ~keyword(",")
    + ~keyword("but|and|only|that is|at")
    + either(
        qualities.size_value,
        qualities.sized,
        qualities.brightness_value,
        qualities.opacity_value,
        ~keyword("in") + qualities.colour_value,
    )
)
BESIDE_IT: dict[str, Any] = {
    "changed": _another_size,
    "own": place | beside_itself,
    "way": ~keyword(",") + steps,
    "far": ~keyword(",") + _apart | distance,
    "row": _in_a_row,
    "shift": SHIFT,
    "called": _called_so,
}


# Time
_motion = either(whose("motion|motions|movement|movements|action|animation|walk|run|jump|dance|ride"), thing)
STILL = keyword(
    "still|in place|mid [air|flight|jump|step|stride|motion|run]|in [the|its|his|her|their] tracks|in mid [air|flight|jump|"
    "step|stride|motion|run]|mid air|in the air|dead|in (mid) motion|moving|from moving|motionless|frozen|standing still|"
    "there"
)
_STANDING = "stand still|stay still|hold still|keep still|stop moving|be still|stay in place|not move|stand"
_command(
    "stop the dog at frame 30",
    "stop|freeze|pause|hold|halt|immobilize|stop moving",
    always(making.frozen),
    use=TIMED,
    itself=f"stop|freeze|pause|halt|{_STANDING}",
    still=STILL,
)
_command(
    "play the dog at half speed",
    "play|run|show|put|set|render|play back|replay|move|drive|do",
    as_given,
    "values",
    who=_motion,
    use=TIMED,
    itself="move|run|go|walk|play|fly|swim|drive|fall|dance|swing|act|be|spin|travel|happen|jump|ride|roll"
    "|turn|gallop|race|jog|trot|flow|hop|fall|leap|skate|pass|drift",
    values=_values(
        number + keyword("x") >> making.retimed,
        keyword("at") + percent >> making.retimed,
        ~keyword("in|at") + qualities.pace,
        qualities.backward,
        keyword("in") + _coloured,
        qualities.a_look,
    ),
)
# Looks, colours of others, names
_given = _values(
    ~keyword("a|an|some")
    + either(qualities.warmth_value, qualities.brightness_value, qualities.saturation_value, qualities.contrast_value)
    + keyword("tone|tones|look|feel|color|colors|light|appearance|mood|tint|touch|cast|atmosphere"),
    qualities.given_look,
    qualities.same_colour,
    qualities.opacity_value,
    keyword("a coat of") + colour + keyword("paint") >> making.assigned,
    ~keyword("a|an") + colour + keyword("color|look|coloring|paint job|coat of paint|paint") >> making.assigned,
    _tint + keyword("tint|tinge|touch") >> making.faintly,
    ~keyword("a|an") + colour + keyword("hue") >> making.hued,
    keyword("the color") + qualities.colour_value,
)
_command("give the dog a golden look", "give", as_given, "values", who=~keyword("to") + thing, values=_given)
_with = keyword("to|with|and") + ~keyword("the [color|colors|coloring|look] of|that of|those of") + known_thing
_matching = _with + ~(keyword("'s|'") + ~keyword("color|colors|coloring"))
for _who in (whose("color|colors|coloring|look"), thing):
    _command(
        "match the dog to the cat",
        "match|color match|adapt|adjust",
        making.matched,
        "source",
        who=_who,
        source=_matching,
    )
_called = ~keyword("as|to") + name
_command(
    "call the dog rex",
    "call|name|label|tag|dub|nickname",
    making.named,
    "called",
    use=Use(gapped=False),
    called=_called,
)

# What is said in passing, and commands without a verb
TOPIC = Command("the dog: make it red", "", REMARK, {})
_remark = keyword("alone|as it is|as they are|as is|untouched|unchanged|as it was|the way it is|out of it|in peace")
_command(
    "make the dog red",
    "leave|keep",
    REMARK,
    "remark",
    use=FULL,
    who=either(thing, keyword("it") >> (lambda: lambda context: context.last or All())),
    remark=_remark,
)
QUALITY_WORDS = (
    "washed out|faded|lifeless|bland|ugly|weird|odd|bright|light|dark|dim|big|large|small|fast|slow|quick|pale|dull|"
    "colorful|saturated|warm|cold|cool|blurry|tiny|flat|gray|boring|huge"
)
_keeps = keyword("keeps|keep|retains|stays|stay|remains") + keyword(
    "(its|their|his|her) [color|colors]|colored|in color"
)
_command(
    "only the dog keeps its color",
    "",
    always(making.rest_grayed),
    "only keeps",
    use=FULL,
    only=ONLY,
    keeps=_keeps,
    rest=~keyword(",|and")
    + silent(everything_else)
    + keyword("goes|go|turns|becomes|is|should be|should go|gets|turn|become")
    + silent(qualities.without_colour | colour),
)
_changed = either(
    qualities.size_value,
    qualities.pace_value,
    qualities.brightness_value,
    qualities.saturation_value,
    qualities.warmth_value,
    qualities.contrast_value,
)
_command(
    "a bigger dog",
    "",
    as_given,
    "values",
    use=FULL,
    who=known_noun,
    values=~keyword("a|an|some|the") + either(_changed, qualities.sized) >> (lambda value: ((value,),)),
)

# Trails
