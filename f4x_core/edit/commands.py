"""The commands of the language: a table of verbs, of what each takes, and of the operation that it makes."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial
from typing import Any

from ..language.amounts import (
    Amount,
    Distance,
    amount,
    degree,
    distance,
    factor,
    fraction,
    fraction_of,
    multiple,
    number,
    percent,
    signed,
    steps,
)
from ..language.colours import colour, colourish
from ..language.grammar import Mismatch, Rule, either, listed, lit, literal, optional, silent, table
from ..language.lexicon import inflected
from ..language.times import TimeExpression, duration
from . import making, qualities
from .making import Making, Value
from .phrases import (
    colors,
    everything_but,
    everything_else,
    everywhere,
    known_noun,
    known_thing,
    name,
    place,
    thing,
    two_of_them,
    whose,
)
from .selects import All, Current


def REMARK() -> Value:  # it stands for what is said and asks for nothing
    """Make nothing: "leave the dog alone"."""
    raise Mismatch


# Commands ------------------------------------------------------------------------------------------------------------


def AGAIN() -> Value:  # likewise for the command before
    """Make what was said before: "do the same with the cat"."""
    raise Mismatch


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
    gapped: bool = True
    """Its verb may be left out: "make the dog red and the cat blue"."""
    whole: bool = False
    """Without a thing it is for everything: "increase the contrast"."""
    bare: bool = True
    """After another command "it" may be left out: "move the dog left and turn around"."""
    timed: bool = False
    """With a time and without a thing it is for everything: "play the last second in slow motion"."""


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
    gapped: bool = True,
    bare: bool = True,
    whole: bool = False,
    timed: bool = False,
    **slots: Any,
) -> None:
    COMMANDS.append(
        Command(example, verbs, make, slots, frozenset(needed.split()), who, itself, gapped, whole, bare, timed)
    )


Given = Value | tuple[tuple[Value], ...]
"""A value, or several as `listed` gives them."""


def always(value: Value) -> Callable[[], Value]:
    """Make the same value, whatever is said besides."""
    return lambda: value


def as_given(values: Given) -> Given:
    """Make the values themselves of a slot `values`."""
    return values


def _values(*rules: Rule) -> Rule:
    return listed(either(*rules), lit("and|,|, and|but|and also|as well as|plus|but also|and then"))


# Colours
_into = ~lit("to|into|in")
_coloured = qualities.colour_value | qualities.without_colour
_command(
    "make the dog red",
    "make|render|have|get",
    as_given,
    "values",
    values=_values(qualities.made, lit("in") + _coloured, lit("gone") >> always(making.deleted)),
)
_command(
    "turn the dog into gold",
    "turn|change|convert|transform|switch|set|put|throw",
    as_given,
    "values",
    values=_values(
        qualities.a_look,
        _into + either(_coloured, qualities.alike, qualities.a_look, qualities.same_as),
        lit("to") + ~lit("a|an|pure|solid") + qualities.look_name >> making.styled,
        lit("from") + silent(colour) + lit("to|into") + _coloured,
        lit("out of focus") >> making.blurred,
        either(
            qualities.brightness_value,
            qualities.saturation_value,
            qualities.warmth_value,
            qualities.size_value,
            qualities.blur_value,
        ),
        lit("to|into") + qualities.colour_of,  # of "change the color of the dog" nobody knows to what
        qualities.more_colour_value,
        qualities.opacity_value,
    ),
)
_command(
    "paint the car blue",
    "cover|paint|repaint|color|recolor|dye|spray|spray paint|colorize|stain|shade|dress|dip|coat|drench|bathe|wrap|redo|do",
    as_given,
    "values",
    values=_values(
        ~lit("all|over|all over")
        + ~lit("in|to|as|with|into")
        + (
            _coloured
            | qualities.same_colour
            | qualities.a_look
            | ~lit("in|with") + ~lit("pure|solid") + qualities.look_name >> making.styled
        ),
        qualities.more_colour_value,
        qualities.alike,
        qualities.a_look,
    ),
)
_tint = ~lit("a|an") + ~lit("slight|faint") + (colour | colourish)
_command(
    "tint the sky orange",
    "tint|tinge|tone|wash",
    making.faintly,
    "rgb",
    rgb=~lit("in|to|with") + _tint + qualities.colored,
)
_command(
    "change the color of the car to black",
    "change|set|turn|make|switch|alter|adjust|swap|shift|replace",
    lambda colors: colors,
    "colors",
    who=whose("color|colors|coloring"),
    colors=_values(
        ~lit("to|into|in|for|with|from") + (_coloured | qualities.same_as),
        lit("from") + silent(colour) + lit("to") + _coloured,
        lit("to|like") + (qualities.source >> making.matched | qualities.colour_of),
    ),
)
_command(
    "shift the hue of the car to red",
    "shift|change|turn|set|rotate|move|make|adjust",
    making.hued,
    "rgb",
    who=whose("hue|hues|tone"),
    rgb=~lit("to|toward|into") + colour,
)
_command(
    "desaturate the background",
    "desaturate|decolor|decolorize|gray out",
    lambda how=None: making.GRAYED if how is None else making.saturated(factor(how, False)),
    how=lit("by") + number >> (lambda x: Amount("times", x)) | amount,
)
for _verb, _value in (
    ("whiten|bleach", making.assigned((1.0, 1.0, 1.0))), ("blacken", making.assigned((0.0, 0.0, 0.0))),
    ("redden", making.added(1.0, ((1.0, 0.0, 0.0), 1))), ("gild", making.styled("gold")),
    ("mute|dull|wash out", making.saturated(factor(None, False))),
):  # fmt: skip
    _command(f"{_verb.split('|')[0]} the dog", _verb, always(_value))
_command(
    "remove the color of the house",
    "remove|take|take out|take away|drain|strip|strip away|delete|drop|lose|get rid of|erase|suck",
    always(making.GRAYED),
    who=whose("color|colors|saturation|coloring"),
    out=lit("out|away"),
)
_command(
    "take the color out of the house",
    "take|drain|suck|strip",
    always(making.GRAYED),
    who=~lit("the|all|all the") + lit("color|colors|saturation") + lit("out of|away from|off of|off") + thing,
)


# More and less: size, pace, light, opacity
_until = lit("until [it|he|she|they] [is|are]") + multiple + lit("as [big|tall|large|high|long|wide|small|fast|bright]")


def _more_or_less(
    example: str,
    verbs: str,
    made: Making,
    quality: str,
    upward: bool,
    particle: str = "",
    who: Rule = thing,
    itself: str = "",
) -> None:
    to = fraction_of(quality) | lit("to") + either(multiple, percent) | lit("in half|by a half") >> (lambda: 0.5)
    how = either(
        ~lit("to|down to|up to") + to >> (lambda x: Amount("to", x)),
        _until >> (lambda x: Amount("to", x)),
        amount,
        lit("by") + number >> (lambda x: Amount("times", x)),
    )
    slots: dict[str, Any] = {"how": how, "particle": lit(particle)} if particle else {"how": how}
    needed = "particle" if particle else ""
    timed = "speed" in quality
    _command(
        example, verbs, lambda how=None: made(factor(how, upward)), needed, who=who, itself=itself, timed=timed, **slots
    )


def _quality(kind: str, words: str, made: Making, whole: bool = False) -> None:
    """Commands about "the size of the dog" and its like; `whole`: "the contrast" alone is that of everything."""
    its = whose(words)
    if whole:
        its = either(its, ~lit("the|all the|overall|the overall") + lit(words) + everywhere)
    _more_or_less(
        f"increase the {kind} of the dog",
        "increase|raise|boost|turn up|bump up|up|crank up|pump up|dial up|bring up|push up|strengthen|enhance|intensify|push|bump",
        made,
        words,
        True,
        who=its,
    )
    _more_or_less(
        f"reduce the {kind} of the dog",
        "reduce|decrease|lower|turn down|cut|cut down|lessen|tone down|bring down|dial down|weaken|diminish"
        "|drop|take down|cut back",
        made,
        words,
        False,
        who=its,
    )
    for verb, times in (("double", 2.0), ("halve", 0.5), ("triple|treble", 3.0), ("quadruple", 4.0)):
        _command(f"double the {kind} of the dog", verb, always(made(times)), who=its)
        _command(f"double the {kind} of the dog", verb, always(made(times)), "its", its=lit("in") + lit(words))
    to = ~lit("to|at|equal to") + either(percent, multiple, fraction_of(words), number)
    _command(f"set the {kind} of the dog to 50 %", _SETTING, made, "by", who=its, by=to)


_SETTING = "set|change|make|turn|put|bring|adjust|reduce|lower|raise|increase"
_quality("size", "size|scale|dimensions", making.scaled)
_quality("speed", "speed|pace|tempo", making.retimed)
_quality("brightness", "brightness|light|luminance", making.brightened)
_quality("opacity", "opacity|visibility", making.opacity)
_command(
    "set the transparency of the wall to 30 %",
    _SETTING,
    lambda by: making.opacity(1 - by),
    "by",
    who=whose("transparency"),
    by=~lit("to|at") + either(percent, fraction, number),
)
for _example, _verbs, _making, _noun, _upward, _particle, _itself in (
    (
        "speed up the dog",
        "speed up|accelerate|quicken|hasten|hurry up",
        making.retimed,
        "speed|pace",
        True,
        "",
        "speed up|accelerate",
    ),
    ("speed the dog up", "speed|hurry|quicken", making.retimed, "speed|pace", True, "up", ""),
    ("slow down the dog", "slow down|slow|decelerate", making.retimed, "speed|pace", False, "", "slow down|slow"),
    ("slow the dog down", "slow", making.retimed, "speed|pace", False, "down", ""),
    (
        "brighten the dog",
        "brighten|lighten|brighten up|lighten up|illuminate|light up",
        making.brightened,
        "brightness",
        True,
        "",
        "brighten",
    ),
    ("brighten the dog", "brighten|lighten|light", making.brightened, "brightness", True, "up", ""),
    ("darken the sky", "darken|dim|dim down|black out", making.brightened, "brightness", False, "", "darken"),
    (
        "enlarge the dog",
        "grow|enlarge|expand|magnify|scale up|size up|blow up|upscale|upsize|increase|inflate",
        making.scaled,
        "size",
        True,
        "",
        "grow|expand",
    ),
    ("scale the dog up", "scale|blow|size", making.scaled, "size", True, "up", ""),
    (
        "shrink the dog",
        "shrink|shrink down|scale down|size down|downscale|downsize|contract|reduce|minimize",
        making.scaled,
        "size",
        False,
        "",
        "shrink|contract",
    ),
    ("scale the dog down", "scale|size|shrink", making.scaled, "size", False, "down", ""),
):
    _more_or_less(_example, _verbs, _making, _noun, _upward, _particle, itself=_itself)
_scale = (
    ~lit("by|to|up to|down to|up by|down by")
    + ~lit("a factor of|factor")
    + either(fraction_of("size"), percent, multiple, number)
)
_command("scale the dog by 2", "scale|resize|rescale", making.scaled, "by", by=_scale)
for _verb, _times in (("double", 2.0), ("halve", 0.5), ("triple|treble", 3.0), ("quadruple", 4.0)):
    _command(f"{_verb.split('|')[0]} the dog in size", _verb, always(making.scaled(_times)), "its", its=lit("in size"))

_as_long = either(
    multiple + lit("as long") >> making.stretched,
    multiple + lit("longer") >> making.stretched,
    ~lit("to|by") + ~lit("a factor of") + fraction_of("length|duration|time") >> making.stretched,
    lit("by") + ~lit("a factor of") + (multiple | number) >> making.stretched,
)
_command(
    "stretch the motion of the dog by 2",
    "stretch|stretch out|extend",
    lambda by: by,
    "by",
    who=either(whose("time|motion|movement|duration"), thing),
    by=_as_long,
)
_command("make the dog take twice as long", "", lambda by: by, "by", itself="take|last", by=_as_long)

# Grading, focus, light
for _kind, _words, _made_by in (
    ("contrast", "contrast", making.contrasted),
    (
        "saturation",
        "saturation|color saturation|vividness|vibrance|vibrancy|color intensity|intensity of the colors",
        making.saturated,
    ),
    (
        "warmth",
        "warmth|color temperature|temperature",
        lambda by: making.warmed(Amount("fraction", abs(by - 1)), by > 1),
    ),
    ("brightness", "brightness|light|luminance|exposure", making.brightened),
):
    if _kind not in ("brightness",):
        _quality(_kind, _words, _made_by, whole=True)
    _more = optional(amount) + table({"more|higher|stronger|extra": True, "less|lower|weaker": False}) + lit(_words)
    _how_much = either(
        _more >> (lambda how, upward, made=_made_by: made(factor(how, upward))),
        table({"no": 0.0}) + lit(_words) >> _made_by,
    )
    _command(
        f"give the dog more {_kind}",
        "give",
        as_given,
        "values",
        who=~lit("to") + thing,
        itself="need|have|get|show",
        values=_values(_how_much),
    )
    _command(
        f"add more {_kind} to the dog",
        "add|put|use|apply|have|give",
        as_given,
        "values",
        who=lit("to|on|in|into|for") + thing,
        whole=True,
        values=_values(_how_much),
    )
    _command(
        f"add {_kind}",
        "add|boost",
        always(_made_by(factor(None, True))),
        "it",
        who=lit("to|on|in|into") + thing,
        whole=True,
        it=lit("some|a bit of|a little|a touch of|a bit") + lit(_words) | lit(_words),
    )
    _command(
        f"more {_kind}", "", as_given, "values", who=lit("for|on|in") + thing, whole=True, values=_values(_how_much)
    )
_all_colors = either(whose("colors|color"), ~lit("the") + colors)
for _example, _verbs, _upward in (
    ("tone down the colors", "tone down|turn down|mute|soften|dull", False),
    ("turn up the colors", "turn up|crank up|boost|intensify|enhance|strengthen|deepen|punch up", True),
):
    _command(_example, _verbs, partial(making.more_saturated, upward=_upward), who=_all_colors, how=amount)
_command(
    "saturate the colors",
    "saturate|enrich",
    partial(making.more_saturated, upward=True),
    who=~lit("all") + either(whose("colors|color"), colors, thing),
    how=amount,
)
for _example, _verbs, _warmer_too, _particle in (
    ("warm up the picture", "warm|warm up", True, "up"),
    ("cool down the picture", "cool|cool down|cool off", False, "down|off"),
):
    _command(
        _example,
        _verbs,
        partial(making.made_warmer, warmer=_warmer_too),
        who=either(_all_colors, thing),
        how=amount,
        particle=lit(_particle),
    )
_command(
    "make the colors warmer",
    "make|turn|render",
    lambda values: values,
    "values",
    who=_all_colors,
    values=_values(
        qualities.warmth_value,
        qualities.saturation_value,
        qualities.contrast_value,
        qualities.brightness_value,
        qualities.pop,
    ),
)
_command(
    "blur the background",
    "blur|blur out|defocus|unfocus|soften|smudge",
    making.blurred,
    who=thing,
    how=qualities.softly,
    out=lit("out"),
)
_blur_noun = (
    ~lit("some|a|an|a bit of")
    + optional(
        table({"slight|soft|light|gentle|little|subtle": Amount("small"), "strong|heavy|thick": Amount("large")})
    )
    + lit("blur|blurring")
)
_command(
    "add a blur to the background",
    "add|apply|put|give",
    making.blurred,
    "how",
    who=lit("to|on|over") + thing,
    how=_blur_noun,
)
_command("give the background a blur", "give", making.blurred, "how", who=thing, how=_blur_noun)
_command(
    "make the dog glow",
    "",
    making.glowing,
    itself="glow|shine|light up|shimmer|sparkle|radiate|gleam",
    how=qualities.softly,
    rgb=~lit("in|in a|a") + colour,
)
_glow_noun = (
    ~lit("some|a|an")
    + optional(table({"slight|soft|faint|gentle|subtle": Amount("small"), "strong|bright|intense": Amount("large")}))
    + optional(colour)
    + lit("glow|halo|shine|aura|gleam|sheen")
    >> making.glowing
)
_command("give the dog a glow", "give", as_given, "values", who=thing, values=_glow_noun)
_command(
    "add a glow to the dog",
    "add|apply|put",
    as_given,
    "values",
    who=lit("to|on|around|onto") + thing,
    values=_glow_noun,
)

# Places of two
_places = lit(
    "(the|their) [places|positions|spots|locations|place|position] (with "
    "each other|with one another)|with each other|with one another|around"
)
_command(
    "swap the dog and the cat",
    "swap|exchange|switch|trade|interchange|swap over|switch around",
    making.swapped,
    who=~lit("(the) [places|positions|spots|locations] of") + (two_of_them | thing),
    itself="swap places|change places|trade places|switch places|swap|"
    "exchange places|swap positions|switch positions|change positions",
    other=lit("with|for") + thing,
    places=_places,
)

# Opacity
_command(
    "hide the car",
    "hide|conceal|mask|mask out",
    always(making.opacity(0.0)),
    itself="disappear|vanish|hide|become invisible",
)
_again = lit("again|once more|back")
_command(
    "show the dog again",
    "unhide|reshow|bring back|restore",
    always(making.opacity(making.SHOWN)),
    again=_again,
    itself="reappear",
)
_command("show the dog again", "show|reveal", making.shown, again=_again >> (lambda: True))
_command(
    "bring the dog back", "bring", always(making.opacity(making.SHOWN)), "back", back=lit("back|back again|back in")
)
_to_fraction = lit("to") + either(percent, fraction, number) + ~lit("opacity") | lit("by") + percent >> (
    lambda x: 1 - x
)
_outward = lit("out|away|off|to zero|to 0|into nothing|from view|out completely|to nothing|to invisible")
_command("fade the background", "fade", lambda by=0.5: making.faded(by), itself="fade", by=_to_fraction)
_command("dissolve the dog", "dissolve", lambda: making.faded(0.0), itself="dissolve")
_command("fade out the dog", "fade|dissolve", lambda: making.faded(0.0), "out", itself="fade", out=_outward)

_command(
    "fade in the dog from second 1 to 2",
    "fade|dissolve",
    lambda: making.faded(0.0, inward=True),
    "inward",
    itself="fade",
    inward=lit("in|into view"),
)

# Taking out, and leaving alone
DELETING = (
    "remove|delete|erase|get rid of|eliminate|drop|lose|discard|scrap|trash|do away with|dump|ditch"
    "|clear|banish|scratch|kill|cut|purge|rid us of"
)
SPLIT = "take|cut|throw|wipe|rub|edit|crop|get|kick|strip|clean|clear|chuck|leave|mask|erase|delete|remove|chop|pull"
OUT = lit(
    "out|away|off|out of [there|here|sight]|from sight|from view|[out of|from] [the|this] (whole"
    "|entire) [scene|picture|video|clip|image|shot|frame|view]|out of [the|this] [scene|picture"
    "|video|clip|image|shot|frame]"
)
_delete, _extract = always(making.deleted), always(making.extracted)
_command("remove everything except the dog", DELETING, _extract, who=everything_but)
_command("take out everything except the dog", SPLIT, _extract, "out", who=everything_but, out=OUT)
_command(
    "remove the car", DELETING, _delete, itself="go away|be gone|go|not be there|not be visible|get lost", bare=False
)
_command("take the car out", SPLIT, _delete, "out", bare=False, out=OUT)
KEEPING = "keep|show|show me|leave|retain|have|display|see|preserve|let me see"
ONLY = lit("only|just|nothing but|solely|nothing except|nothing else but|nothing other than")
_only_keep = ONLY | lit(
    "[i|we] [only|just] want (to see)|[i|we] want to see [only|just]|[only|just] [keep|show|leave|retain]"
)
_command("keep only the dog", KEEPING, _extract, "only", bare=False, only=ONLY)
_in_colour = lit("in (full) [color|colors]|colored")
_command(
    "show only the dog in color",
    KEEPING,
    always(making.rest_grayed),
    "only colored",
    bare=False,
    only=ONLY,
    colored=_in_colour,
)
_command("only the dog", "", _extract, "only", bare=False, only=_only_keep)
_command(
    "crop everything but the dog", "crop|crop out|clear|wipe|strip|strip away|cut|hide", _extract, who=everything_but
)
_command("isolate the dog", "isolate|extract|single out|separate out|separate|cut free", _extract, bare=False)
_and_remove = ~lit(",") + ~lit("and|but") + lit("|".join(inflected(DELETING, 1))) + silent(everything_else)
_command("keep the dog and remove everything else", "keep|leave|retain", _extract, "rest", bare=False, rest=_and_remove)
_unwanted = lit(
    "[i|we] do not [want|need] (to see)|[i|we] do not want to have|[i|we] no longer [want|need]"
    " (to see)|there should be no|let there be no|"
    "[i|we] can do without|no"
)
_command(
    "I do not want to see the dog",
    "",
    _delete,
    "unwanted",
    bare=False,
    gapped=False,
    unwanted=_unwanted,
    there=lit("in [the|this] [scene|picture|video|clip|image|shot]|any more|anymore|there|any longer"),
)
_command(
    "strip away the background", "strip away|clear away|clear out|take down|rub off|edit away", _delete, bare=False
)
_without = lit("(the|this) [scene|picture|video|clip|image] (but) without|without|no more|minus")
_command("without the dog", "", _delete, "without", bare=False, without=_without)
_command("show the scene without the dog", "show|show me|render|make", _delete, "without", bare=False, without=_without)

# Moving and turning
_command(
    "make the dog run backwards",
    "",
    as_given,
    "values",
    itself="run|go|walk|fly|swim|drive|dance|play|move|ride|roll|jump|gallop|race|be",
    values=_values(qualities.backward),
)
_command(
    "move the dog to the left",
    "move|shift|push|put|slide|bring|pull|drag|place|shove|carry|send|scoot|nudge|translate|position|drive|displace|set|get|drop|"
    "throw|have|relocate|fly|float|slip|scooch|budge|transport|take|let|haul|tow|swing|draw|tug|boost|bump",
    making.moved,
    "way",
    itself="move|go|slide|shift|jump|float|drift|come|fly|glide|wander|roll|hop|step|travel|drive|walk|hover|swim|be",
    way=steps,
    far=distance,
)
_PLACING = (
    "put|place|move|set|bring|stand|position|shift|drag|lay|hang|let|send|drop|slide|have|get|take|relocate|pull|push|"
    "carry|fly|"
    "make"
)
_command(
    "put the dog behind the bush",
    _PLACING,
    making.placed,
    "place",
    itself="stand|go|be|walk|sit|move|run|come|drive|swim|fly|jump|lie|float|appear|hang|ride|dance",
    place=~lit("over|right|directly|straight|to|somewhere") + place,
)
_command(
    "raise the box",
    "raise|lift|elevate|hoist",
    lambda far=None: making.moved(making.UP, far),
    itself="rise|go up|levitate|hover|float|ascend|take off|fly",
    far=distance,
    particle=lit("up|higher|in the air|in mid air|above the ground|off the ground|into the air|from the ground|upward"),
)
_command(
    "lower the lamp",
    "lower|sink",
    lambda far=None: making.moved(making.DOWN, far),
    itself="sink|go down|descend|come down",
    far=distance,
    particle=lit("down|lower"),
)
ROTATING, TILTING = (
    "rotate|spin|revolve|pivot|swivel|twirl",
    "tilt|roll|lean|tip|bank|slant|incline|tip over|lean over",
)
SENSE = table(
    {
        "(over) (to|toward) (the|its|his|her|their) left (side|hand side)|leftward|counterclockwise"
        "|counter clockwise|anticlockwise|anti clockwise": -1,
        "(over) (to|toward) (the|its|his|her|their) right (side|hand side)|rightward|clockwise": 1,
    }
)
_turn = table(
    {
        "half (a) turn|halfway (around)|half way (around)|half (a) circle|half (a) rotation": 180.0,
        "once|once around|all the way around|around once|full spin|complete (rotation|circle|revolution)": 360.0,
        "twice|two full turns": 720.0,
        "quarter (of a) turn|quarter|quarter (of a) circle|quarter rotation": 90.0,
        "full turn|full circle|full rotation|complete turn|whole turn": 360.0,
    }
)
_by = ~lit("by|through|for")
ANGLE = either(_by + signed + lit("degrees|degree|deg|°|º"), ~lit("by") + signed, _by + ~lit("a|one") + _turn)
_axis = lit(
    "[around|about|on] [its|his|her|their|the] (own) (vertical) axis|[around|about] the vertical|in place|on the spot"
)
TURNS: dict[str, Any] = {"angle": ANGLE, "sense": SENSE, "axis": _axis}
_command(
    "turn the dog upside down",
    "turn|flip|rotate|put|stand|set|hang|place",
    always(making.turned(making.UPSIDE_DOWN)),
    "over",
    itself="turn|flip|stand",
    over=qualities.upside_down,
)
_command(
    "turn the dog around",
    f"{ROTATING}|turn",
    lambda angle=180.0, sense=1: making.rotated(angle, sense),
    "around",
    itself=f"{ROTATING}|turn|look|face",
    around=lit(
        "around|round|the other way (around)|to face the other way|back to front|about|so that [it|he"
        "|she] [faces|looks] the other way|"
        "[in|to] the [other|opposite] direction|completely around"
    ),
    **TURNS,
)
_command(
    "make the dog face left",
    "",
    making.rotated,
    "sense",
    itself="face|look|point|head",
    sense=either(SENSE, table({"left": -1, "right": 1})),
)
_command("turn the dog to the left", "turn", making.rotated, "sense", itself="turn", **TURNS)
_command("turn the dog by 45 degrees", "turn", making.rotated, "angle", itself="turn", **TURNS)
_command("rotate the dog by 90 degrees", ROTATING, making.rotated, itself=ROTATING, **TURNS)
_command("tilt the lamp to the left", TILTING, making.tilted, "sense", itself=TILTING, angle=ANGLE, sense=SENSE)
_command("tilt the lamp by 20 degrees", TILTING, making.tilted, "angle", itself=TILTING, angle=ANGLE, sense=SENSE)

_command(
    "tilt the lamp a little",
    TILTING,
    lambda how, sense=1: making.tilted(making.TILT / 3 if how.kind == "small" else 2 * making.TILT, sense),
    "how",
    itself=TILTING,
    how=degree,
    sense=SENSE,
)

_command(
    "rotate the dog a little to the left",
    f"{ROTATING}|turn",
    lambda how, sense=1: making.rotated(15.0 if how.kind == "small" else 120.0, sense),
    "how",
    itself=f"{ROTATING}|turn",
    how=degree,
    sense=SENSE,
)

# Copies
_lagging = (
    ~lit(",") + ~lit("but|that is|which is|by") + ~lit("delayed|lagging|trailing|starting|running|runs") + ~lit("by")
)
_following = lit(
    "that [follows|trails|chases|lags|runs|walks|moves] (behind|after) (it|"
    "him|her)|[following|trailing|lagging] (behind|after) (it|him|her)|"
    "[follow|trail] (behind|after) (it|him|her|the original)|to [follow|trail] (behind|after) (it|him|her|the original)"
)
SHIFT = either(
    ~lit(",")
    + _following
    + ~lit("by|with|at|on the same path")
    + ~lit("a delay of|a distance of")
    + duration
    + ~lit("later|behind|after (it)|behind it|of delay|delay|afterward|on its path|along (its|the same) path"),
    _lagging
    + duration
    + lit("later|behind|late|after|after [it|the original]|behind [it|the original]|afterward|delayed|in the future"),
    lit("(but) delayed by|(but) with a [lag|delay|gap] of|(but) lagging (behind) by|(but) trailing (behind) by")
    + duration,
    lit("with a") + duration + lit("delay|lag"),
    _lagging + duration + lit("earlier|ahead|before|early|before it|in advance|ahead of [it|the original]|sooner")
    >> (lambda length: length.plus(length, -2.0)),
)
_in_a_row = lit(
    "in a row|in a line|side by side|next to each other|one after another|one after the other|beside each other"
)
_called_so = ~lit(",") + lit("called|named|by the name of") + name
_apart = distance + lit("apart") | ~lit("by") + number + lit("apart") >> Distance
_another_size = (
    ~lit(",")
    + ~lit("but|and|only|that is|at")
    + either(
        qualities.size_value,
        qualities.sized,
        qualities.brightness_value,
        qualities.opacity_value,
        ~lit("in") + qualities.colour_value,
    )
)
BESIDE_IT: dict[str, Any] = {
    "changed": _another_size,
    "own": place,
    "way": ~lit(",") + steps,
    "far": ~lit(",") + _apart | distance,
    "row": _in_a_row,
    "shift": SHIFT,
    "called": _called_so,
}
_copies = either(
    lit("a|another|one|one more|a second|an extra|a new")
    + (lit("copy|clone|duplicate|replica") | literal("twin|double|lookalike"))
    >> (lambda: 1.0),
    number + ~lit("more|extra|other|additional|identical") + lit("copies|clones|duplicates|replicas"),
) + lit("of")
_others = either(
    lit("another|a second|one more|an extra|an additional|one other|a further") >> (lambda: 1.0),
    number + lit("more|other|extra|additional|further") + ~lit("of"),
)
_ADDING = (
    "make|create|add|put|place|give me|insert|produce|generate|set|have|get me|i want|i would like"
    "|we need|show|get|we want|i need"
)
_how_often = table({"once": 1.0, "twice": 2.0, "thrice": 3.0}) | number + lit("times|x")
_command(
    "copy the dog",
    "copy|duplicate|clone|replicate|make copies of|make a copy of",
    making.copied,
    times=_how_often,
    **BESIDE_IT,
)
_command("put a copy of the car to the left", _ADDING, making.copied, "times", bare=False, times=_copies, **BESIDE_IT)
_command(
    "make a smaller copy of the dog to the right",
    _ADDING,
    making.copied,
    "changed",
    bare=False,
    gapped=False,
    **(
        BESIDE_IT
        | {
            "changed": lit("a|another")
            + either(qualities.size_value, qualities.sized, qualities.colour_value, qualities.brightness_value)
            + lit("copy|clone|duplicate")
            + lit("of")
        }
    ),
)
TRAIL_COPIES, TRAIL_LAG = 3.0, TimeExpression(seconds=0.2)
"""Copies of a trail, and the time from one to the next."""
_followers = either(
    lit("a|another|one") + lit("copy|clone|duplicate|second one") >> (lambda: 1.0),
    lit("another one|a second one") >> (lambda: 1.0),
    number + ~lit("ghost|ghostly|faint") + lit("copies|clones|duplicates|ghosts"),
    ~lit("some|a few") + lit("copies|clones|ghosts") >> (lambda: TRAIL_COPIES),
)


def _trailing(times: float, shift: TimeExpression | None = None) -> Value | tuple[tuple[Value], ...]:
    return making.copied(times=times, shift=TRAIL_LAG if shift is None else shift)


_command(
    "let a copy follow the dog half a second behind",
    "let|have|make|add|put",
    _trailing,
    "times follow",
    bare=False,
    gapped=False,
    times=_followers,
    follow=lit(
        "follow|trail|chase|[run|drive|come|walk|go] [behind|after]|that [follow|follows|trail] (behind)"
        "|following|trailing (behind)|behind"
    ),
    shift=SHIFT | ~lit("by|with") + duration,
    path=lit("along (its|the same) path|on (its|the same) path"),
)
_command(
    "let a copy follow the dog half a second behind",
    "",
    lambda shift=None: _trailing(1.0, shift),
    "follow",
    bare=False,
    gapped=False,
    who=lit("a [copy|clone|duplicate] of|a second|another") + thing,
    follow=~lit("should|must|will|shall")
    + lit("follow|follows|trail|trails|chase|chases|[run|runs|drive|drives|come|comes|walk|walks] [behind|after]")
    + ~lit("it|him|her|the original|the first one|behind it"),
    shift=SHIFT | ~lit("by|with") + duration,
)
_command("add another dog", _ADDING, making.copied, "times", bare=False, times=_others, **BESIDE_IT)
_command("another copy of the dog", "", making.copied, "times", bare=False, times=_copies | _others, **BESIDE_IT)

# Time
_motion = either(whose("motion|motions|movement|movements|action|animation"), thing)
STILL = lit(
    "still|in place|in [the|its|his|her|their] tracks|in mid [air|flight|jump|step|stride|motion"
    "|run]|mid air|in the air|dead|in (mid) motion|moving|from moving|motionless|frozen|standing"
    " still|there"
)
_STANDING = "stand still|stay still|hold still|keep still|stop moving|be still|stay in place|not move|stand"
_command(
    "stop the dog at frame 30",
    "stop|freeze|pause|hold|halt|immobilize|stop moving",
    always(making.frozen),
    timed=True,
    itself=f"stop|freeze|pause|halt|{_STANDING}",
    still=STILL,
)
_command("keep the dog still", "keep|leave", always(making.frozen), "still", still=STILL)
_command(
    "play the dog at half speed",
    "play|run|show|put|set|render|play back|replay|move|drive|do",
    as_given,
    "values",
    who=_motion,
    timed=True,
    itself="move|run|go|walk|play|fly|swim|drive|fall|dance|swing|act|be|spin|travel|happen|jump|ride|roll"
    "|turn|gallop|race|jog|trot|flow|hop|fall|leap|skate|pass|drift",
    values=_values(
        number + lit("x") >> making.retimed,
        ~lit("in|at") + qualities.pace,
        qualities.backward,
        lit("in") + _coloured,
        qualities.a_look,
    ),
)
_in_time = lit("in time")
_command(
    "reverse the car",
    "reverse|rewind|play back to front|run in reverse",
    always(making.reversed),
    itself="reverse|rewind",
    who=_motion,
    timed=True,
    in_time=_in_time,
)
_on_and_on = lit("again and again|over and over (again)|endlessly|repeatedly|in a loop|on loop|on repeat")
_loop = always(making.looped)
_part_of = ~lit("of|for|with") + _motion
_command(
    "loop the dog from second 1 to 2",
    "loop|repeat|cycle|replay",
    _loop,
    timed=True,
    who=_part_of,
    itself="loop|repeat",
    again=_on_and_on,
)
_command("play the dog in a loop from second 1 to 2", "play|run|show|put", _loop, "again", again=_on_and_on)

# Looks, colours of others, names
_given = _values(
    ~lit("a|an|some")
    + either(qualities.warmth_value, qualities.brightness_value, qualities.saturation_value, qualities.contrast_value)
    + lit("tone|tones|look|feel|color|colors|light|appearance|mood|tint|touch|cast|atmosphere"),
    known_thing + lit("'s|'") + lit("color|colors|coloring|look|appearance") >> making.matched,
    qualities.given_look,
    qualities.same_colour,
    qualities.opacity_value,
    lit("a coat of") + colour + lit("paint") >> making.assigned,
    ~lit("a|an") + colour + lit("color|look|coloring|paint job|coat of paint|paint") >> making.assigned,
    _tint + lit("tint|tinge|touch") >> making.faintly,
    ~lit("a|an") + colour + lit("hue") >> making.hued,
    lit("the color") + qualities.colour_value,
)
_onto = lit("to|on|onto|over|for") + thing
_command("give the dog a golden look", "give", as_given, "values", who=~lit("to") + thing, values=_given)
_command("apply the sepia look to the dog", "apply|add|put|use", as_given, "values", who=_onto, values=_given)
_with = lit("to|with|and") + ~lit("the [color|colors|coloring|look] of|that of|those of") + known_thing
_matching = _with + ~(lit("'s|'") + ~lit("color|colors|coloring"))
for _who in (whose("color|colors|coloring|look"), thing):
    _command(
        "match the dog to the cat",
        "match|color match|adapt|adjust",
        making.matched,
        "source",
        who=_who,
        source=_matching,
    )
_command("make the hat match the shirt", "", making.matched, "source", itself="match", source=known_thing)
_called = ~lit("as|to") + name
_command("call the dog rex", "call|name|label|tag|dub|nickname", making.named, "called", gapped=False, called=_called)

# What is said in passing, and commands without a verb
_command(
    "make the dog red",
    "do the same|do that too",
    AGAIN,
    who=lit("to|with|for|on") + thing,
    bare=False,
    gapped=False,
)
TOPIC = Command("the dog: make it red", "", REMARK, {})
_remark = lit("alone|as it is|as they are|as is|untouched|unchanged|as it was|the way it is|out of it|in peace")
_command(
    "make the dog red",
    "leave|keep",
    REMARK,
    "remark",
    bare=False,
    gapped=False,
    who=either(thing, lit("it") >> (lambda: lambda context: context.last or All())),
    remark=_remark,
)
_command(
    "make the dog red",
    "",
    REMARK,
    "untouched",
    bare=False,
    gapped=False,
    untouched=lit("do not [touch|change|affect|alter]|without [touching|changing]|but not"),
)
_quality_words = (
    "bright|light|dark|dim|big|large|small|fast|slow|quick|pale|dull|"
    "colorful|saturated|warm|cold|cool|blurry|tiny|flat|gray|boring|huge"
)
_command(
    "brighten the dog",
    "",
    REMARK,
    "complaint",
    bare=False,
    gapped=False,
    who=either(
        lit("it|this|that") >> (lambda: lambda context: context.last or (Current() if context.selected else All())),
        thing,
    ),
    complaint=lit("is|are|looks|look|seems|seem|was|were")
    + either(
        qualities.too_much,
        silent(~lit("a bit|a little|much|way|far") + ~lit("too|so|very|rather|quite|really") + lit(_quality_words))
        >> (lambda: None),
    ),
)
_wanted = lit("i want|i would like|we want|we would like|i would love|we need|i need")
_command(
    "I want a white dog",
    "",
    lambda want, rgb, rest=None: making.assigned(rgb),
    "want rgb",
    bare=False,
    gapped=False,
    who=known_noun,
    want=_wanted >> (lambda: True),
    rgb=~lit("a|an|the|to have a") + colour,
    rest=lit("instead (of)") + ~(~lit("a|an|the|that") + silent(colour) + lit("one|ones")),
)
_there = lit("is|are|stands|was")
_command(
    "put the dog where the cat is and the cat where the dog is",
    "put|move|place",
    lambda other: making.swapped(other),
    "other",
    gapped=False,
    other=lit("where")
    + thing
    + _there
    + lit("and|, and")
    + ~lit("put|move|place")
    + silent(thing)
    + lit("where")
    + silent(thing)
    + _there,
)
_command("tone down the sky", "tone down", lambda how=None: making.brightened(factor(how, False)), how=amount)
_command(
    "tone the sky down",
    "tone",
    lambda how=None: making.brightened(factor(how, False)),
    "down",
    how=amount,
    down=lit("down"),
)
_day = lit("(the) day|daytime|daylight") >> (lambda: lambda context: making.noted(context, All()))
_command(
    "turn day into night",
    "turn|change|make|transform",
    as_given,
    "values",
    bare=False,
    gapped=False,
    who=_day,
    values=_values(lit("into|to") + qualities.bare_look),
)
_keeps = lit("keeps|keep|retains|stays|stay|remains") + lit("(its|their|his|her) [color|colors]|colored|in color")
_command(
    "only the dog keeps its color",
    "",
    always(making.rest_grayed),
    "only keeps",
    bare=False,
    gapped=False,
    only=ONLY,
    keeps=_keeps,
    rest=~lit(",|and")
    + silent(everything_else)
    + lit("goes|go|turns|becomes|is|should be|should go|gets|turn|become")
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
    "the dog twice as fast",
    "",
    as_given,
    "values",
    bare=False,
    gapped=False,
    values=_values(
        _changed,
        lit("in") + (_coloured | qualities.any_look >> making.styled),
        ~lit("in") + qualities.slow_motion >> making.retimed,
        qualities.backward,
    ),
)
_command(
    "a bigger dog",
    "",
    as_given,
    "values",
    bare=False,
    gapped=False,
    who=known_noun,
    values=~lit("a|an|some|the") + either(_changed, qualities.sized) >> (lambda value: ((value,),)),
)
_command("no dog", "", _delete, "no", bare=False, gapped=False, no=lit("no"))
for _kind, _words, _made_by in (
    ("contrast", "contrast", making.contrasted),
    ("saturation", "saturation", making.saturated),
    ("brightness", "brightness", making.brightened),
):
    _command(
        f"turn the {_kind} up",
        "turn|bring|push|crank|pull|dial|take|put|bump|pump|tone",
        lambda quality, upward, how=None, made=_made_by: made(factor(how, upward)),
        "quality upward",
        whole=True,
        who=lit("on|of|for|in") + thing,
        quality=~lit("the") + lit(_words) >> (lambda: True),
        upward=table({"up|way up": True, "down": False}),
        how=either(amount, lit("by") + number >> (lambda x: Amount("times", x))),
    )

# Trails
_behind = lit("follow|trail|chase|[drive|run|walk|go|come|move] [behind|after]") + ~lit(
    "it|him|her|the first (one)|the original (one)|the other (one)"
)
_command(
    "let a second dog follow it one second later",
    "let|have|make",
    making.copied,
    "behind shift",
    bare=False,
    gapped=False,
    who=lit("a second|another|a copy of the|a clone of the|one more|a duplicate of the") + known_noun,
    behind=_behind,
    shift=SHIFT | ~lit("by|with") + duration,
)


def _trailed(count: float = TRAIL_COPIES) -> Value | tuple[tuple[Value], ...]:
    return making.copied(times=count, shift=TRAIL_LAG)


_a_trail = (
    ~lit("a|an")
    + ~lit("ghost|ghostly|faint|motion")
    + lit("trail|echo|afterimage|echo effect|trailing copies|ghosts")
    + optional(lit("of") + number + ~lit("ghost|ghostly|faint|fading") + lit("copies|clones|ghosts"), TRAIL_COPIES)
)
_command("give the dog a trail", "give", _trailed, "count", bare=False, itself="leave|have|get|draw", count=_a_trail)
_command(
    "leave a trail behind the dog",
    "leave|add|put|make|draw|create|show",
    _trailed,
    "count",
    bare=False,
    who=lit("behind|after|to|of") + thing,
    count=_a_trail,
)


# A part of the clip, made longer
_command(
    "stretch the first second to two seconds",
    "stretch|stretch out|extend|slow down|compress|squeeze",
    making.lasting,
    "to",
    whole=True,
    to=lit("to|into|over") + duration,
)
