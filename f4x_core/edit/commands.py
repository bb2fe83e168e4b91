"""The commands of the language: a table of verbs, of what each takes, and of the operation that it makes."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from typing import Any

from .colour_names import Colour
from .grammar import NOTHING, Rule, either, listed, lit, optional, silent, table, value
from .looks import LOOKS
from .operations import (
    Delete,
    Duplicate,
    Extract,
    Freeze,
    Loop,
    Match,
    Name,
    Opacity,
    Operation,
    Recolour,
    Retime,
    Reverse,
    Style,
    Transform,
)
from .phrases import (
    GRAY,
    PLACES,
    Amount,
    Context,
    Distance,
    Refusal,
    When,
    Who,
    amount,
    colour,
    colourish,
    comparison,
    degree,
    displacement,
    distance,
    duration,
    everything_but,
    everything_else,
    factor,
    fraction,
    known_thing,
    multiple,
    name,
    number,
    percent,
    share_of,
    signed,
    span,
    steps,
    thing,
    whose,
)
from .phrases import more_colour as _more_colour
from .selects import SelectKind
from .words import inflected

Build = Callable[..., Operation]
Value = Callable[[SelectKind, When, Context], Operation]
"""What "red" or "twice as big" does to somebody at some time."""

BLACK_AND_WHITE = (0.5, 0.5, 0.5)
"""As `hue`: no colour is left, light and dark stay."""
A_BIT = 0.5
"""Strength of "a bit red", and of a tint."""
MORE_COLOUR = 0.3
"""How far "redder" goes from gray to red."""
SHOWN = 10.0
"""Factor that makes anything opaque that is there at all."""
COPY_DISTANCE = 1.2
"""Widths to the next copy: beside the thing, with a gap."""
TILT = 30.0
"""Degrees, when none are said."""


# Values: what follows "make the dog …" --------------------------------------------------------------------------------


def _assigned(rgb: Colour, strength: float = 1.0) -> Value:
    if rgb == GRAY:
        return _recoloured(BLACK_AND_WHITE, "hue", strength)
    return lambda who, when, _: Recolour(who, rgb, strength=strength, keep_luminance=True, **when.effect)


def _recoloured(rgb: Colour, mode: Any = "assign", strength: float = 1.0) -> Value:
    return lambda who, when, _: Recolour(who, rgb, mode, strength, **when.effect)


def _lit(by: float) -> Value:
    return _recoloured((by, by, by), "multiply")


def _added(times: float, more: tuple[Colour, int]) -> Value:
    rgb, sign = more
    red, green, blue = (round(times * sign * MORE_COLOUR * (c - 0.5), PLACES) for c in rgb)
    return _recoloured((red, green, blue), "add")


def _opacity(by: float) -> Value:
    return lambda who, when, _: Opacity(who, round(by, PLACES), **when.effect)


def _scaled(by: float) -> Value:
    return lambda who, when, _: Transform(who, scale=round(by, PLACES), pivot="base", **when.growth)


def _retimed(by: float) -> Value:
    return lambda who, when, _: Retime(who, round(by, PLACES), **when.effect)


def _turned(rotate: tuple[float, float, float]) -> Value:
    return lambda who, when, _: Transform(who, rotate=rotate, axes="camera", **when.growth)


def _styled(look: str, strength: float = 1.0) -> Value:
    return lambda who, when, _: Style(who, look, strength, **when.effect)


def _matched(source: Who) -> Value:
    def build(who: SelectKind, when: When, context: Context) -> Operation:
        found = source(context)
        context.last = who  # what is spoken about is the thing that changes
        return Match(who, found, **when.effect)

    return build


def _reversed(*_: Any) -> Value:
    return lambda who, when, _: Reverse(who, **when.effect)


_small = degree >> (lambda how: A_BIT if how.kind == "small" else 1.0)
_article = ~lit("a|an|the|some")
_shade_of = ~lit("shade of|nice|lovely|beautiful|pretty|kind of")
_fully = ~lit("all|completely|fully|entirely|totally|wholly")
_colored = ~lit("(in) color|colored|tone|tint")
_flat = lit("solid|flat|plain|pure|uniform|unshaded|uniformly|flatly")
_colour_value = either(
    _article + _flat + ~_flat + colour + _colored >> _recoloured,
    lit("a (little|tiny) bit|a [little|tad|touch]|slightly|somewhat|faintly|kind of") + (colour | colourish)
    >> (lambda rgb: _assigned(rgb, A_BIT)),
    _article + colourish + _colored >> (lambda rgb: _assigned(rgb, A_BIT)),
    _fully + _article + _shade_of + ~lit("the color") + colour + _colored >> _assigned,
)
_more_colour_value = (
    optional(table({"a (little) bit|a little|slightly|somewhat": 0.5, "much|a lot|far|way": 2.0}), 1.0) + _more_colour
    >> _added
)
_without_colour = lit(
    "black and white|b and w|b / w|monochrome|monochromatic|(a) grayscale|gray scale|colorless|desaturated|without (any) color|"
    "without colors"
) >> (lambda: _recoloured(BLACK_AND_WHITE, "hue"))
_LIGHT = ("brighter|lighter", "darker|dimmer", "bright|light", "dark|dim")
_SIZE = ("bigger|larger", "smaller|tinier", "big|large|huge", "small|tiny|little")
_SPEED = ("faster|quicker|swifter|speedier", "slower", "fast|quick|quickly|speedy", "slow|slowly")
_light_value = either(comparison(*_LIGHT), share_of("brightness|light|luminance") | share_of("as bright")) >> _lit
_size_value = either(comparison(*_SIZE), share_of("size|sizes|dimensions|scale")) >> _scaled
_slow_motion = lit("(in) (a) slow motion|(in) slow mo|(in) slowmo|in slomo") >> (lambda: 0.5)
_paced = either(
    share_of("speed|pace|tempo|rate|velocity"),
    lit("(a) speed of") + (multiple | percent | number),
    ~lit("a") + multiple,
)
_pace_value = (
    either(comparison(*_SPEED), ~lit("with") + _slow_motion, ~lit("at|to|with") + share_of("speed|pace|tempo|rate"))
    >> _retimed
)
_pace = either(_pace_value, lit("at|in|to") + _paced >> _retimed)
_backward = (
    lit("backward|in reverse|reversed|in reverse order|(the) other way around|from back to front|from end to start")
    >> _reversed
)
_see_through = lit("transparent|see through|translucent|transparency|sheer")
_transparency = either(
    percent + _see_through >> (lambda x: 1 - x),
    table(
        {
            "half|semi|partly|partially|somewhat": 0.5,
            "a (little) bit|a little|slightly": 0.8,
            "very|mostly|almost|nearly": 0.2,
            "completely|fully|totally|entirely|100 %": 0.0,
        }
    )
    + _see_through,
    fraction + _see_through >> (lambda x: 1 - x),
    _see_through >> (lambda: 0.5),
    _article + percent + lit("opaque|visible|opacity"),
    fraction + lit("opaque|visible|opacity"),
    lit("(an|a) opacity (of)") + (percent | number),
    lit("(a) transparency (of)") + (percent | number) >> (lambda x: 1 - x),
    lit("(completely|fully|totally) opaque|(completely|fully) visible (again)|opaque (again)|reappear")
    >> (lambda: SHOWN),
    lit("(completely|totally) invisible|(completely|totally) hidden|vanish|vanished|disappear|disappeared")
    >> (lambda: 0.0),
)
_opacity_value = ~lit("at|to|with") + _transparency >> _opacity
_upside_down = lit("upside down|on (its|his|her|their) head|head over heels") >> (lambda: (0.0, 0.0, 180.0))
_ADJECTIVES = {
    **{
        "gold": "golden",
        "silver": "silvery",
        "copper": "coppery",
        "ice": "icy|frozen over",
        "fire": "fiery|flaming|burning",
    },
    **{"lava": "molten", "night": "nighttime|night time", "autumn": "autumnal|autumn like", "grass": "grassy"},
    **{"chocolate": "chocolatey|chocolaty", "ghost": "ghostly|ghostlike", "sepia": "sepia|sepia toned", "neon": "neon"},
    **{"marble": "marbled"},
}
_look_name = table(
    {name: name for name in LOOKS}
    | {name + "s": name for name in LOOKS}
    | {"flames": "fire", "the night|night time": "night"},
    reserve=False,
)
_look_adjective = table({words: name for name, words in _ADJECTIVES.items()}, reserve=False)
_any_look = _look_name | _look_adjective
_effect = lit("look|style|effect|filter|appearance|finish|feel|vibe|mood|tone|tones|light|coloring|treatment")
_strongly = optional(_small, 1.0)
_seem = ~lit("look|looking|looks|appear|seem|feel")
_a_look = either(
    _seem
    + _strongly
    + lit("like|as if it were|as if they were|as though it were|similar to")
    + ~lit("(it is|they are) made (out) (of)|made (out) of")
    + ~lit("a|an|pure|solid|real")
    + _look_name,
    value(1.0)
    + lit("(made|built|carved|cast) (out) of|in the style of|into|in")
    + ~lit("a|an|pure|solid")
    + _look_name
    + ~_effect,
    value(1.0) + lit("in|into|with") + ~lit("a|an|the|some") + _any_look + _effect,
    _seem + _strongly + _look_adjective,
) >> (lambda strength, look: _styled(look, strength))
_given_look = _article + _any_look + ~lit("like|colored") + _effect >> _styled
_source = ~lit("that of|those of|the colors of|the color of") + known_thing + ~lit("'s (color|colors)")
_same_colour = (
    either(
        lit("the (exact) same (color|colors|coloring|look)|the same|(a|the) similar color")
        + lit("as|like|to")
        + _source,
        _article + lit("color|colors|coloring|palette|look|appearance") + lit("of|from") + _source,
    )
    >> _matched
)
_alike = _seem + lit("like|similar to|the same as") + _source >> _matched
_made = either(
    _colour_value,
    _without_colour,
    _more_colour_value,
    _light_value,
    _size_value,
    _pace_value,
    _opacity_value,
    _upside_down >> _turned,
    _same_colour,
    _a_look,
    _alike,
)


# Commands ------------------------------------------------------------------------------------------------------------

Build = Callable[..., Iterator[Operation]]
"""(who, when, context, **slots) to operations."""


@dataclass(frozen=True)
class Command:
    """A verb, what it takes besides somebody and a time, and what it does."""

    example: str
    """A sentence that uses it; shown to those whose sentence is not understood."""
    verbs: str
    """Alternatives with `|`; their first words are inflected. Empty: said without a verb."""
    build: Build
    """Called once for each who of the clause, with the slots that were filled."""
    slots: Mapping[str, Rule]
    """By argument name of `build`; in any order."""
    needed: frozenset[str] = frozenset()
    """Slots without which it means nothing."""
    who: Rule = thing
    """The phrase for whom it is about."""
    itself: str = ""
    """Verbs of which the thing is the subject: "the dog should stop"."""
    bare: bool = True
    """After another command "it" may be left out: "move the dog left and turn around"."""


COMMANDS: list[Command] = []
"""In the order in which they are preferred."""


def _command(
    example: str,
    verbs: str,
    build: Build,
    *,
    needed: str = "",
    who: Rule = thing,
    itself: str = "",
    bare: bool = True,
    **slots: Rule,
) -> None:
    COMMANDS.append(Command(example, verbs, build, slots, frozenset(needed.split()), who, itself, bare))


def _each(who: SelectKind, when: When, context: Context, values: tuple[tuple[Value], ...]) -> Iterator[Operation]:
    for (made,) in values:
        yield made(who, when, context)


def _fixed(made: Value) -> Build:
    def build(who: SelectKind, when: When, context: Context, **_: Any) -> Iterator[Operation]:
        yield made(who, when, context)

    return build


_and = lit("and|,|, and|but|and also")


def _values(rule: Rule) -> Rule:
    return listed(rule, _and)


def _remove(who: SelectKind, when: When, context: Context) -> Operation:
    return Delete(who, **when.effect)


_delete, _extract = _fixed(_remove), _fixed(lambda who, when, _: Extract(who, **when.effect))
_gone = lit("gone|disappear|go away") >> (lambda: _remove)

# Colours
_command("make the dog red", "make|render", _each, needed="values", values=_values(_made | _gone))
_coloured = _colour_value | _without_colour
_into = ~lit("to|into|in")
_command(
    "turn the dog into gold",
    "turn|change|convert|transform|switch|set",
    _each,
    needed="values",
    values=_values(
        either(_a_look, _into + either(_coloured, _alike, _a_look, _same_colour), _more_colour_value, _opacity_value)
    ),
)
_painted = either(~lit("in|to|as|with|into") + (_coloured | _same_colour), _more_colour_value, _alike, _a_look)
_command(
    "paint the car blue",
    "paint|repaint|color|recolor|dye|spray|colorize|stain|shade",
    _each,
    needed="values",
    values=_values(_painted),
)
_command(
    "tint the sky orange",
    "tint|tinge",
    _each,
    needed="values",
    values=_values(
        ~lit("in|to|with") + ~lit("a|an") + (colour | colourish) + _colored >> (lambda rgb: _assigned(rgb, A_BIT))
    ),
)
_command(
    "change the color of the car to black",
    "change|set|turn|make|switch|alter|adjust",
    _each,
    needed="values",
    who=whose("color|colors|coloring"),
    values=_values(_into + (_coloured | _same_colour) | lit("to|like") + _source >> _matched),
)
_command(
    "shift the hue of the car to red",
    "shift|change|turn|set|rotate|move|make|adjust",
    lambda who, when, context, rgb: _fixed(_recoloured(rgb, "hue"))(who, when, context),
    needed="rgb",
    who=whose("hue|hues|tone"),
    rgb=~lit("to|toward|into") + colour,
)
_gray = _fixed(_recoloured(BLACK_AND_WHITE, "hue"))
_command("desaturate the background", "desaturate|decolor|decolorize|gray out", _gray)
_command(
    "remove the color of the house",
    "remove|take|take out|take away|drain|strip|strip away|delete|drop|lose|get rid of|erase|suck",
    _gray,
    who=whose("color|colors|saturation|coloring"),
    out=lit("out|away"),
)
_command(
    "take the color out of the house",
    "take|drain|suck|strip",
    _gray,
    who=~lit("the|all|all the") + lit("color|colors|saturation") + lit("out of|away from|off of|off") + thing,
)


# More and less: light, size, pace
def _amount_of(quality: str) -> Rule:
    """How much a verb does: "by 20 %", "to half its size", "a bit", "by 2"."""
    to = share_of(quality) | lit("to") + either(multiple, percent) | lit("in half|by a half") >> (lambda: 0.5)
    return either(
        ~lit("to") + to >> (lambda x: Amount("to", x)), amount, lit("by") + number >> (lambda x: Amount("times", x))
    )


def _more_or_less(
    example: str,
    verbs: str,
    made: Callable[[float], Value],
    quality: str,
    upward: bool,
    *,
    particle: str = "",
    who: Rule = thing,
    itself: str = "",
) -> None:
    def build(
        who: SelectKind, when: When, context: Context, how: Amount | None = None, particle: bool = True
    ) -> Iterator[Operation]:
        yield made(factor(how, upward))(who, when, context)

    slots = {"how": _amount_of(quality)} | ({"particle": lit(particle)} if particle else {})
    _command(example, verbs, build, needed="particle" if particle else "", who=who, itself=itself, **slots)


_QUALITIES: tuple[tuple[str, Callable[[float], Value]], ...] = (
    ("size|scale|dimensions", _scaled),
    ("speed|pace|tempo", _retimed),
    ("brightness|light|luminance", _lit),
    ("opacity", _opacity),
)
_KINDS = dict(zip(("size", "speed", "brightness", "opacity"), _QUALITIES, strict=True))
for _kind, (_words, _make) in _KINDS.items():
    _more_or_less(
        f"increase the {_kind} of the dog by 20 %",
        "increase|raise|boost|turn up|bump up|up",
        _make,
        _words,
        True,
        who=whose(_words),
    )
    _more_or_less(
        f"reduce the {_kind} of the dog by 20 %",
        "reduce|decrease|lower|turn down|cut|cut down|lessen",
        _make,
        _words,
        False,
        who=whose(_words),
    )
    for _verb, _times in (("double", 2.0), ("halve", 0.5), ("triple|treble", 3.0), ("quadruple", 4.0)):
        _command(f"double the {_kind} of the dog", _verb, _fixed(_make(_times)), who=whose(_words))
        _command(
            f"double the {_kind} of the dog",
            _verb,
            _fixed(_make(_times)),
            needed="quality",
            quality=lit("in") + lit(_words),
        )

    def _set_to(
        who: SelectKind, when: When, context: Context, to: float, made: Callable[[float], Value] = _make
    ) -> Iterator[Operation]:
        yield made(to)(who, when, context)

    _command(
        f"set the {_kind} of the dog to 50 %",
        "set|change|make|turn|put|bring|adjust",
        _set_to,
        needed="to",
        who=whose(_words),
        to=~lit("to|at|equal to") + either(percent, multiple, share_of(_words), number),
    )


def _set_transparency(who: SelectKind, when: When, context: Context, to: float) -> Iterator[Operation]:
    yield _opacity(1 - to)(who, when, context)


_command(
    "set the transparency of the wall to 30 %",
    "set|change|make|turn|put|bring|adjust",
    _set_transparency,
    needed="to",
    who=whose("transparency"),
    to=~lit("to|at") + either(percent, fraction, number),
)
_more_or_less(
    "speed up the dog",
    "speed up|accelerate|quicken|hasten|hurry up",
    _retimed,
    "speed|pace",
    True,
    itself="speed up|accelerate|hurry up",
)
_more_or_less("speed the dog up", "speed|hurry", _retimed, "speed|pace", True, particle="up")
_more_or_less("slow down the dog", "slow down|slow|decelerate", _retimed, "speed|pace", False, itself="slow down|slow")
_more_or_less("slow the dog down", "slow", _retimed, "speed|pace", False, particle="down")
_more_or_less(
    "brighten the dog",
    "brighten|lighten|brighten up|lighten up|illuminate",
    _lit,
    "brightness",
    True,
    itself="brighten",
)
_more_or_less("brighten the dog", "brighten|lighten|light", _lit, "brightness", True, particle="up")
_more_or_less("darken the sky", "darken|dim|dim down", _lit, "brightness", False, itself="darken")
_more_or_less(
    "enlarge the dog",
    "grow|enlarge|expand|magnify|scale up|size up|blow up|inflate|upscale",
    _scaled,
    "size",
    True,
    itself="grow|expand|swell",
)
_more_or_less("scale the dog up", "scale|blow|size", _scaled, "size", True, particle="up")
_more_or_less(
    "shrink the dog",
    "shrink|scale down|size down|minify|downscale|contract",
    _scaled,
    "size",
    False,
    itself="shrink|contract",
)
_more_or_less("scale the dog down", "scale|size|shrink", _scaled, "size", False, particle="down")


def _scale(who: SelectKind, when: When, context: Context, by: float) -> Iterator[Operation]:
    yield _scaled(by)(who, when, context)


_command(
    "scale the dog by 2",
    "scale|resize|rescale",
    _scale,
    needed="by",
    by=~lit("by|to") + ~lit("a factor of|factor") + either(share_of("size"), percent, multiple, number),
)


# Opacity
_command("hide the car", "hide|conceal", _fixed(_opacity(0.0)), itself="disappear|vanish|hide|become invisible")
_command(
    "show the dog again",
    "show|reveal|unhide|reshow",
    _fixed(_opacity(SHOWN)),
    again=lit("again|once more"),
    itself="reappear",
)


def _fade(who: SelectKind, when: When, context: Context, out: bool = False, to: float = 0.5) -> Iterator[Operation]:
    yield _opacity(0.0 if out else to)(who, when, context)


_faded = lit("to") + either(percent, fraction, number) + ~lit("opacity") | lit("by") + percent >> (lambda x: 1 - x)
_command("fade the background", "fade", _fade, itself="fade", to=_faded)
_command(
    "fade out the dog",
    "fade",
    _fade,
    needed="out",
    itself="fade",
    out=lit("out|away|out completely|to nothing|to invisible"),
)

# Taking out, and leaving alone
_DELETING = "remove|delete|erase|get rid of|eliminate|drop|lose|discard|scrap|trash|do away with"
_SPLIT = "take|cut|throw|wipe|rub|edit|crop"
_removing = lit("|".join(inflected(_DELETING, 1)))
_command("remove everything except the dog", _DELETING, _extract, who=everything_but)
_command("take out everything except the dog", _SPLIT, _extract, who=everything_but, needed="out", out=lit("out|away"))
_command("remove the car", _DELETING, _delete, itself="go away|be gone", bare=False)
_command("take the car out", _SPLIT, _delete, needed="out", bare=False, out=lit("out|away|out of there"))
_only = lit("only|just|nothing but|solely|nothing except|nothing else but|nothing other than")
_command(
    "keep only the dog", "keep|show|show me|leave|retain|have|display", _extract, needed="only", bare=False, only=_only
)
_command("only the dog", "", _extract, needed="only", bare=False, only=_only)
_command("isolate the dog", "isolate|extract|single out|separate out", _extract, bare=False)
_command(
    "keep the dog and remove everything else",
    "keep|leave|retain",
    _extract,
    needed="rest",
    bare=False,
    rest=~lit(",") + ~lit("and|but") + _removing + silent(everything_else),
)
_without = lit("(the|this) [scene|picture|video|clip|image] (but) without|without|no more|minus")
_command("without the dog", "", _delete, needed="without", bare=False, without=_without)
_command(
    "show the scene without the dog",
    "show|show me|render|give me|make",
    _delete,
    needed="without",
    bare=False,
    without=_without,
)


# Moving and turning
def _move(who: SelectKind, when: When, context: Context, way: Any, far: Distance | None = None) -> Iterator[Operation]:
    told = displacement(way, far, 1.0)
    yield Transform(who, translate=told.pop("vector"), **told, **when.growth)


_MOVING = "move|shift|push|put|slide|bring|pull|drag|place|shove|carry|send|scoot|nudge|translate|position|drive|displace|set|get"
_command(
    "move the dog to the left",
    _MOVING,
    _move,
    needed="way",
    itself="move|go|slide|shift|jump|fly|float|drift|come|walk|run|step",
    way=steps,
    far=distance,
)


def _straight(example: str, verbs: str, way: tuple[int, int, int], particle: str, itself: str) -> None:
    def build(
        who: SelectKind, when: When, context: Context, far: Distance | None = None, particle: bool = True
    ) -> Iterator[Operation]:
        return _move(who, when, context, ((None, way, None),), far)

    _command(example, verbs, build, itself=itself, far=distance, particle=lit(particle))


_straight("raise the box", "raise|lift|elevate|hoist", (0, -1, 0), "up|higher", "rise|go up|levitate")
_straight("lower the lamp", "lower|sink", (0, 1, 0), "down", "sink|go down|descend")
_UPSIDE_DOWN = (0.0, 0.0, 180.0)
_sense = table(
    {
        "(to|toward) (the|its|his|her) left|leftward|counterclockwise|counter clockwise|anticlockwise|anti clockwise": -1,
        "(to|toward) (the|its|his|her) right|rightward|clockwise": 1,
    }
)
_angle = either(
    ~lit("by|through|for") + signed + lit("degrees|degree|deg|°|º"),
    ~lit("by") + signed,
    ~lit("by|through|for")
    + ~lit("a|one")
    + table(
        {
            "half (a) turn|halfway (around)|half way (around)|half (a) circle|half (a) rotation": 180.0,
            "quarter (of a) turn|quarter (of a) circle|quarter rotation": 90.0,
            "full turn|full circle|full rotation|complete turn|whole turn": 360.0,
        }
    ),
)
_axis = lit(
    "[around|about|on] [its|his|her|their|the] (own) (vertical) axis|[around|about] the vertical|horizontally|in place|on the spot"
)


def _rotate(
    who: SelectKind,
    when: When,
    context: Context,
    angle: float = 90.0,
    sense: int = 1,
    axis: bool = True,
    around: bool = True,
) -> Iterator[Operation]:
    yield _turned((0.0, sense * angle, 0.0))(who, when, context)


def _rotate_around(
    who: SelectKind, when: When, context: Context, around: bool, angle: float = 180.0, **more: Any
) -> Iterator[Operation]:
    return _rotate(who, when, context, angle, **more)


_around = lit("around|round|the other way|to face the other way|back to front")
_ROTATING = "rotate|spin|revolve|pivot|swivel|twirl"
_turns = {"angle": _angle, "sense": _sense, "axis": _axis}
_command(
    "turn the dog upside down",
    "turn|flip|rotate|put|stand|set|hang|place",
    _fixed(_turned(_UPSIDE_DOWN)),
    needed="over",
    itself="turn|flip|stand",
    over=_upside_down,
)
_command(
    "turn the dog around",
    f"{_ROTATING}|turn",
    _rotate_around,
    needed="around",
    itself=f"{_ROTATING}|turn|look|face",
    around=_around,
    **_turns,
)
_command("turn the dog to the left", "turn", _rotate, needed="sense", itself="turn", **_turns)
_command("turn the dog by 45 degrees", "turn", _rotate, needed="angle", itself="turn", **_turns)
_command("rotate the dog by 90 degrees", _ROTATING, _rotate, itself=_ROTATING, **_turns)


def _tilt(who: SelectKind, when: When, context: Context, angle: float = TILT, sense: int = 1) -> Iterator[Operation]:
    yield _turned((0.0, 0.0, sense * angle))(who, when, context)


for _need in ("sense", "angle"):
    _command(
        "tilt the lamp to the left",
        "tilt|roll|lean|tip|bank",
        _tilt,
        needed=_need,
        itself="tilt|roll|lean|tip|bank",
        angle=_angle,
        sense=_sense,
    )


# Copies
def _copy(
    who: SelectKind,
    when: When,
    context: Context,
    way: Any = None,
    far: Distance | None = None,
    times: float = 1.0,
    shift: float | None = None,
    once_more: bool = True,
) -> Iterator[Operation]:
    if times != int(times):
        raise Refusal(f"{times:g} copies cannot be made; say a whole number.")
    told: dict[str, Any] = when.none("A copy")
    if way is None and shift is None or far is not None and way is None:
        way = ((None, (1, 0, 0), None),)
    if way is not None:
        told = displacement(way, far, COPY_DISTANCE)
        told["offset"] = told.pop("vector")
    if shift is not None:
        told["time_shift"] = shift.resolve(context)
    yield Duplicate(who, count=int(times), **told)


_behind = ~lit("but|that is|which is|by") + ~lit("delayed|lagging|trailing|starting|running|runs") + ~lit("by")
_shift = either(
    _behind
    + duration
    + lit(
        "later|behind|late|after|after it|after (the) original|behind it|behind the original|afterward|delayed|in the future"
    ),
    lit("(but) delayed by|(but) with a delay of|(but) lagging (behind) by|(but) trailing (behind) by") + duration,
    lit("with a") + duration + lit("delay"),
    _behind
    + duration
    + lit("earlier|ahead|before|early|before it|in advance|ahead of it|ahead of (the) original|sooner")
    >> (lambda d: d.plus(d, -2.0)),
)
_how_often = table({"once": 1.0, "twice": 2.0, "thrice": 3.0}) | number + lit("times|x")
_beside = {"way": steps, "far": distance, "shift": _shift}
_command("copy the dog", "copy|duplicate|clone|replicate|double up", _copy, itself="", times=_how_often, **_beside)
_copies = either(
    lit("a|another|one|one more|a second|an extra|a new") + lit("copy|clone|duplicate|replica") >> (lambda: 1.0),
    number + ~lit("more|extra|other|additional") + lit("copies|clones|duplicates|replicas"),
) + lit("of")
_others = either(
    lit("another|a second|one more|an extra|an additional|one other|a further") >> (lambda: 1.0),
    number + lit("more|other|extra|additional|further") + ~lit("of"),
)
_command(
    "put a copy of the car to the left",
    "make|create|add|put|place|give me|insert|produce|generate|set|have",
    _copy,
    needed="times",
    bare=False,
    times=_copies,
    **_beside,
)
_command(
    "add another dog",
    "add|make|create|put|place|give me|insert|show|have",
    _copy,
    needed="times",
    bare=False,
    times=_others,
    **_beside,
)
_command("a second dog", "", _copy, needed="times", bare=False, times=_copies | _others, **_beside)


# Time
def _freeze(who: SelectKind, when: When, context: Context, still: bool = True) -> Iterator[Operation]:
    yield Freeze(who, **when.pause(context))


_still = lit("still|in place|in its tracks|in (mid) motion|moving|from moving|motionless|frozen|standing still|there")
_command(
    "stop the dog at frame 30",
    "stop|freeze|pause|hold|halt|immobilize",
    _freeze,
    itself="stop|freeze|pause|halt|stand still|stay still|hold still|keep still|stop moving|be still|stay in place|not move|stand",
    still=_still,
)
_command("keep the dog still", "keep|leave", _freeze, needed="still", still=_still)
_playing = _values(either(~lit("in|at") + _pace, _backward, lit("in") + _coloured, _a_look))
_MOTIONS = "move|run|go|walk|play|fly|swim|drive|fall|dance|swing|act|be|spin|travel|happen"
_command(
    "play the dog at half speed",
    "play|run|show|put|set|render|play back|replay|move|drive|do",
    _each,
    needed="values",
    itself=_MOTIONS,
    values=_playing,
)


def _reverse(who: SelectKind, when: When, context: Context, in_time: bool = True) -> Iterator[Operation]:
    yield Reverse(who, **when.effect)


_command(
    "reverse the car",
    "reverse|rewind|time reverse",
    _reverse,
    itself="reverse|rewind",
    in_time=lit("in time|the motion of|the movement of"),
)


def _loop(who: SelectKind, when: When, context: Context, again: bool = True) -> Iterator[Operation]:
    if when.frames is None:
        raise Refusal("It is not said which part is repeated; add for example 'from second 1 to 2'.")
    yield Loop(who, **when.effect)


_command(
    "loop the dog from second 1 to 2",
    "loop|repeat|cycle|replay",
    _loop,
    who=~lit("of|for|with") + thing,
    itself="loop|repeat|cycle",
    again=lit("again and again|over and over (again)|endlessly|repeatedly|in a loop|on repeat"),
)
_command(
    "play the dog in a loop from second 1 to 2",
    "play|run|show|put",
    _loop,
    needed="again",
    again=lit("again and again|over and over (again)|endlessly|repeatedly|in a loop|on loop|on repeat"),
)

# Looks, colours of others, names
_given = either(
    _given_look,
    _same_colour,
    _opacity_value,
    ~lit("a|an") + colour + lit("color|look|coloring|paint job|coat of paint|paint") >> _assigned,
    ~lit("a|an") + ~lit("slight|faint") + (colour | colourish) + lit("tint|tinge|touch")
    >> (lambda rgb: _assigned(rgb, A_BIT)),
    ~lit("a|an") + colour + lit("hue") >> (lambda rgb: _recoloured(rgb, "hue")),
    lit("the color") + _colour_value,
)
_command("give the dog a golden look", "give", _each, needed="values", who=~lit("to") + thing, values=_values(_given))
_command(
    "apply the sepia look to the dog",
    "apply|add|put|use",
    _each,
    needed="values",
    who=lit("to|on|onto|over|for") + thing,
    values=_values(_given),
)


def _match(who: SelectKind, when: When, context: Context, source: Value) -> Iterator[Operation]:
    yield source(who, when, context)


_matching = (
    lit("to|with|and")
    + ~lit("the (color|colors|coloring|look) of|that of|those of")
    + known_thing
    + ~(lit("'s|'") + ~lit("color|colors|coloring"))
    >> _matched
)
for _who in (whose("color|colors|coloring|look"), thing):
    _command(
        "match the dog to the cat",
        "match|color match|adapt|adjust",
        _match,
        needed="source",
        who=_who,
        source=_matching,
    )


def _call(who: SelectKind, when: When, context: Context, called: str) -> Iterator[Operation]:
    known = context.names.setdefault(called.lower(), called)
    yield Name(who, known, **when.none("A name"))


_command("call the dog rex", "call|name|label|tag|dub|nickname", _call, needed="called", called=~lit("as|to") + name)
