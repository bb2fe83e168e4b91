"""The commands of the language: a table of verbs, of what each takes, and of the operation that it makes."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

from ..language.amounts import (
    PLACES,
    Amount,
    Distance,
    Steps,
    Vector,
    amount,
    comparison,
    degree,
    displacement,
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
from ..language.colour_names import Colour
from ..language.colours import GRAY, colour, colourish, more_colour
from ..language.grammar import Mismatch, Refusal, Rule, constant, either, listed, lit, optional, silent, table
from ..language.lexicon import inflected
from ..language.times import TimeExpression, duration
from .operations import (
    Blur,
    Delete,
    Duplicate,
    Extract,
    Freeze,
    Glow,
    Grade,
    Loop,
    Match,
    Name,
    Opacity,
    Operation,
    Recolour,
    Retime,
    Reverse,
    Style,
    Swap,
    Transform,
)
from .phrases import (
    SentenceContext,
    When,
    Who,
    colors,
    everything_but,
    everything_else,
    everywhere,
    known_noun,
    known_thing,
    means_something,
    name,
    thing,
    two_of_them,
    whose,
)
from .selects import All, Current, Instance, Named, Not, Or, SelectKind, Text
from .styles import STYLES

Value = Callable[[SelectKind, When, SentenceContext], Operation]
"""What "red" or "twice as big" does to somebody at some time."""
Making = Callable[[float], Value]
"""A value from a factor."""

BLACK_AND_WHITE = (0.5, 0.5, 0.5)
"""As `hue`: no colour is left, light and dark stay."""
A_BIT = 0.5
"""Strength of "a bit red", and of a tint."""
MORE_COLOUR = 0.3
"""How far "redder" goes from gray to red."""
SHOWN = 10.0
"""Factor that makes anything opaque that is there at all."""
WARMER = 0.5
"""Warmth of "warmer"; a bit: half, much: twice as much."""
BLUR, GLOW = 0.02, 0.5
"""Radius of "blur" in world units and strength of "glow"; a bit: half, much: twice as much."""
COPY_DISTANCE = 1.2
"""Widths to the next copy: beside the thing, with a gap."""
BESIDE = (COPY_DISTANCE, 0.0, 0.0)
"""Where a copy goes when the sentence does not say, in sizes along the camera's axes."""
TILT = 30.0
"""Degrees, where the sentence names none."""


# Values: what follows "make the dog …" --------------------------------------------------------------------------------
THE_COPY = Named("\0")
"""What an operation before it makes, until that has a name."""
UPSIDE_DOWN = (0.0, 0.0, 180.0)
"""Degrees about the camera's axes."""
_RIGHT, _UP, _DOWN = (((None, way, None),) for way in ((1, 0, 0), (0, -1, 0), (0, 1, 0)))
"""One step in a direction, as `phrases.steps` has it."""


def _recoloured(rgb: Colour, mode: Any = "assign", strength: float = 1.0) -> Value:
    return lambda who, when, _: Recolour(who, rgb, mode, strength, **when.coming)


def _hued(rgb: Colour) -> Value:
    return _recoloured(rgb, "hue")


_GRAYED = _hued(BLACK_AND_WHITE)


def _assigned(rgb: Colour, strength: float = 1.0) -> Value:
    if rgb == GRAY:
        return _recoloured(BLACK_AND_WHITE, "hue", strength)
    return lambda who, when, _: Recolour(who, rgb, strength=strength, keep_luminance=True, **when.coming)


def _faintly(rgb: Colour) -> Value:
    return _assigned(rgb, A_BIT)


def _lit(by: float) -> Value:
    return _recoloured((by, by, by), "multiply")


def _added(times: float, more: tuple[Colour, int]) -> Value:
    rgb, sign = more
    red, green, blue = (round(times * sign * MORE_COLOUR * (c - 0.5), PLACES) for c in rgb)
    return _recoloured((red, green, blue), "add")


def _contrasted(by: float) -> Value:
    return lambda who, when, _: Grade(who, contrast=round(by, PLACES), **when.coming)


def _saturated(by: float) -> Value:
    return lambda who, when, _: Grade(who, saturation=round(by, PLACES), **when.coming)


def _warmed(how: Amount | None, warmer: bool) -> Value:
    kind, value = (None, 0.0) if how is None else (how.kind, how.value)
    if kind not in (None, "small", "large", "fraction"):
        raise Mismatch
    warmth = value if kind == "fraction" else {None: WARMER, "small": WARMER / 2, "large": 2 * WARMER}[kind]
    return lambda who, when, _: Grade(who, warmth=round(warmth if warmer else -warmth, PLACES), **when.coming)


def _made_warmer(how: Amount | None = None, *, warmer: bool) -> Value:
    return _warmed(how, warmer)


def _more_saturated(how: Amount | None = None, *, upward: bool) -> Value:
    return _saturated(factor(how, upward))


def _blurred(how: Amount | None = None) -> Value:
    if how is not None and how.kind not in ("small", "large"):
        raise Mismatch
    radius = BLUR * (1.0 if how is None else 0.5 if how.kind == "small" else 2.0)
    return lambda who, when, _: Blur(who, radius, **when.effect)


def _glowing(how: Amount | None = None, rgb: Colour | None = None) -> Value:
    if how is not None and how.kind not in ("small", "large"):
        raise Mismatch
    strength = GLOW * (1.0 if how is None else 0.5 if how.kind == "small" else 2.0)
    return lambda who, when, _: Glow(who, strength, rgb, **when.effect)


def _swapped(other: Who | None = None) -> Value:
    def value(who: SelectKind, when: When, context: SentenceContext) -> Operation:
        pair: tuple[SelectKind, ...] = (who,) if other is None else (who, other(context))
        if other is None and isinstance(who, Text):
            pair = tuple(replace(who, labels=(label,)) for label in who.labels)
        elif other is None and isinstance(who, Or):
            pair = who.of
        if len(pair) == 1 and isinstance(who, Text) and who.number == "both":
            of = replace(who, number="any")
            pair = (Instance(of, "left", context.present), Instance(of, "right", context.present))
        if len(pair) != 2:
            raise Refusal("Two things can change places; say which two, for example 'swap the dog and the cat'.")
        return Swap(*pair, **when.growth)

    return value


def _stretched(by: float) -> Value:
    if by <= 0:
        raise Mismatch
    return _retimed(1 / by)


def _opacity(by: float) -> Value:
    def value(who: SelectKind, when: When, context: SentenceContext) -> Operation:
        if when.slowly:
            return _faded(by)(who, when, context)
        return Opacity(who, round(by, PLACES), **when.effect)

    return value


def _shown(again: bool = False) -> Value:
    def value(who: SelectKind, when: When, context: SentenceContext) -> Operation:
        if when.frames is not None and not again:
            raise Refusal(
                "'Show' with a time can be meant in two ways; say for example 'hide the dog until second 2', or 'show the dog again"
                " from second 2'."
            )
        return Opacity(who, SHOWN, **when.effect)

    return value


def _faded(by: float, inward: bool = False) -> Value:
    def value(who: SelectKind, when: When, context: SentenceContext) -> Operation:
        fading = when.fading(context, inward)
        if (when.slowly or inward) and "ease" not in fading:
            raise Refusal("It is not said from when to when it fades; add for example 'from second 1 to 2'.")
        return Opacity(who, round(by, PLACES), **fading, inward=inward)

    return value


def _deleted(who: SelectKind, when: When, _: SentenceContext) -> Operation:
    if who == All():
        raise Refusal("Nothing would be left; say what to remove, or 'hide everything' if that is meant.")
    return Delete(who, **when.effect)


def _extracted(who: SelectKind, when: When, _: SentenceContext) -> Operation:
    return Extract(who, **when.effect)


def _rest_grayed(who: SelectKind, when: When, context: SentenceContext) -> Operation:
    return _GRAYED(Not(who), when, context)


def _scaled(by: float) -> Value:
    return lambda who, when, _: Transform(who, scale=round(by, PLACES), pivot="base", **when.growth)


def _turned(rotate: Vector) -> Value:
    return lambda who, when, _: Transform(who, rotate=rotate, axes="camera", **when.growth)


def _rotated(angle: float = 90.0, sense: int = 1) -> Value:
    return _turned((0.0, sense * angle, 0.0))


def _tilted(angle: float = TILT, sense: int = 1) -> Value:
    return _turned((0.0, 0.0, sense * angle))


def _moved(way: Steps, far: Distance | None = None) -> Value:
    vector, unit = displacement(way, far, 1.0)
    return lambda who, when, _: Transform(who, translate=vector, unit=unit, axes="camera", **when.growth)


def _copied(
    way: Steps | None = None,
    far: Distance | None = None,
    times: float = 1.0,
    shift: TimeExpression | None = None,
    called: str = "",
    own: tuple[Steps, Who] | None = None,
    changed: Value | None = None,
) -> Value | tuple[tuple[Value], ...]:
    if own is not None:
        way = own[0]
    if times != int(times):
        raise Refusal(f"{times:g} copies cannot be made; say a whole number.")
    arguments: dict[str, Any] = {"count": int(times), "name": called}
    if way or far or shift is None:
        offset, unit = displacement(way or _RIGHT, far, COPY_DISTANCE)
        arguments |= {"offset": offset, "unit": unit, "axes": "camera"}

    def value(who: SelectKind, when: When, context: SentenceContext) -> Operation:
        if called:
            context.names.setdefault(called.lower(), called)
        if own is not None and own[1](context) != who:
            raise Refusal("A copy goes beside what it is a copy of; say for example 'copy the dog to the left'.")
        context.last = who
        later = 0.0 if shift is None else shift.resolve(context)
        return Duplicate(who, time_shift=later, **arguments, **when.none("A copy"))

    if changed is not None:
        return (value,), (lambda who, when, context: changed(THE_COPY, when, context),)
    return value


def _frozen(who: SelectKind, when: When, context: SentenceContext) -> Operation:
    return Freeze(who, **when.pause(context))


def _retimed(by: float) -> Value:
    return lambda who, when, _: Retime(who, round(by, PLACES), **when.pace)


def _noted(context: SentenceContext, who: SelectKind) -> SelectKind:
    context.last = who
    return who


def _reversed(who: SelectKind, when: When, _: SentenceContext) -> Operation:
    return Reverse(who, **when.effect)


def _looped(who: SelectKind, when: When, _: SentenceContext) -> Operation:
    if when.frames is None:
        raise Refusal("It is not said which part is repeated; add for example 'from second 1 to 2'.")
    return Loop(who, **when.effect)


def _styled(look: str, strength: float = 1.0) -> Value:
    return lambda who, when, _: Style(who, look, strength, **when.coming)


def _matched(source: Who) -> Value:
    def value(who: SelectKind, when: When, context: SentenceContext) -> Operation:
        found = source(context)
        context.last = who  # what is spoken about is the thing that changes
        return Match(who, found, **when.coming)

    return value


def _named(called: str) -> Value:
    if means_something(called):
        raise Refusal(f"'{called}' cannot be a name, because it means something else in a sentence; choose another.")

    def value(who: SelectKind, when: When, context: SentenceContext) -> Operation:
        return Name(who, context.names.setdefault(called.lower(), called), **when.none("A name"))

    return value


_small = degree >> (lambda how: A_BIT if how.kind == "small" else 1.0)
_article = ~lit("a|an|the|some")
_shade_of = ~lit(
    "(nice|lovely|bright|strong) [shade|tone|tint|hue] of|nice|lovely|beautiful|pretty|kind of|really|very"
) + ~(lit("from") + silent(colour) + ~lit("to|into"))
_fully = ~lit("all|completely|fully|entirely|totally|wholly")
_colored = ~lit("(in) color|colored|tone|tint")
_flat = lit("solid|flat|plain|pure|uniform|unshaded|uniformly|flatly")
_colour_value = either(
    _article + _flat + ~_flat + colour + _colored >> _recoloured,
    lit("a (little|tiny) bit|a [little|tad|touch]|slightly|somewhat|faintly|kind of")
    + ~lit("more")
    + (colour | colourish)
    >> _faintly,
    ~lit("a|an|some") + colourish + _colored >> _faintly,
    _fully + ~lit("a|an|some") + _shade_of + ~lit("the color") + colour + _colored >> _assigned,
)
_more_colour_value = (
    optional(table({"a (little) bit|a little|slightly|somewhat": 0.5, "much|a lot|far|way": 2.0}), 1.0) + more_colour
    >> _added
)
_without_colour = lit(
    "black and white|black white|a black and white [picture|image|look]|b and w|b / w|monochrome|monochromatic|(a) grayscale|"
    "gray scale|colorless|desaturated|without (any|its|all) color|without colors"
) >> (lambda: _GRAYED)
_BRIGHTNESS = ("brighter|lighter", "darker|dimmer|gloomier", "bright|light", "dark|dim")
_SIZE = ("bigger|larger", "smaller|tinier", "big|large|huge|tall|high|wide", "small|tiny|little|short")
_SPEED = ("faster|quicker|swifter|speedier", "slower", "fast|quick|quickly|speedy", "slow|slowly")
_brightness_value = (
    either(comparison(*_BRIGHTNESS), fraction_of("brightness|light|luminance") | fraction_of("as bright")) >> _lit
)
_contrast_value = (
    comparison("punchier|crisper", "flatter", "contrasty|contrastful|punchy|contrasted", "flat") >> _contrasted
)
_saturation_value = (
    comparison(
        "more saturated|richer|livelier|stronger|bolder|more intense",
        "duller|less saturated|paler|weaker",
        "saturated|vivid|colorful|vibrant|intense|rich|lively|colored",
        "desaturated|muted|dull|washed out|pale|faded",
    )
    >> _saturated
)
_warmer = table(
    {"warmer|more warm|less cool|less cold": True, "cooler|colder|chillier|more cool|more cold|less warm": False}
)
_warmth_value = either(
    optional(amount) + _warmer >> _warmed, _warmer + amount >> (lambda warmer, how: _warmed(how, warmer))
)
_pop = lit(
    "pop|pop more|pop out|stand out|stand out more|come alive|(more|really) vivid|(very) saturated|(very) colorful|vibrant"
) >> (lambda: _saturated(factor(None, True)))
_sized = either(
    ~lit("very|really|quite")
    + table({"tiny|small|little|minute|miniature": 0.5, "huge|giant|enormous|gigantic|big|large|massive": 2.0})
    >> _scaled
)
_softly = either(
    degree,
    table(
        {
            "softly|faintly|gently|weakly": Amount("small"),
            "heavily|strongly|intensely|brightly|very|really|badly": Amount("large"),
        }
    ),
)
_blurry = ~lit("all") + lit(
    "blurry|blurred|softer|soft focus|less sharp|blurrier|fuzzy|hazy|out of focus|unsharp|more blurry|more blurred"
)
_blur_value = ~lit("go") + either(optional(_softly) + _blurry >> _blurred, _blurry + _softly >> _blurred)
_glow_value = (
    optional(_softly)
    + lit("glowing|glowy|luminous|aglow|radiant|shining|shiny|shimmering|glow")
    + ~lit("in")
    + optional(colour)
    >> _glowing
)
_size_value = either(comparison(*_SIZE), fraction_of("size|sizes|dimensions|scale|height|width|length")) >> _scaled
_slow_motion = lit("(in) (a) slow motion|go slow motion|(in) slow mo|(in) slowmo|in slomo") >> (lambda: 0.5)
_paced = either(
    fraction_of("speed|pace|tempo|rate|velocity"),
    lit("(a) speed of") + (multiple | percent | number),
    ~lit("a") + multiple,
)
_pace_value = (
    either(comparison(*_SPEED), ~lit("with") + _slow_motion, ~lit("at|to|with") + fraction_of("speed|pace|tempo|rate"))
    >> _retimed
)
_pace = either(_pace_value, lit("at|in|to") + _paced >> _retimed)
_backward = lit(
    "backward|in reverse|reversed|in the opposite direction|back to front|from the end to the start"
    "|in reverse order|(the) other way around|from back to front|from end to start"
) >> (lambda: _reversed)
_see_through = lit("transparent|see through|translucent|transparency|sheer")
_share_of = lambda how: 0.5 if how is None else {"small": 0.2, "large": 0.8}.get(how.kind, how.value)  # noqa: E731
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
    optional(amount) + lit("more") + _see_through >> (lambda how: 1 - _share_of(how)),
    optional(amount) + lit("less") + _see_through >> (lambda how: 1 + 2 * _share_of(how)),
    lit(
        "(completely|totally|fully) invisible|(completely|totally) hidden|unseen|not visible|vanish|vanished|disappear|disappeared"
    )
    >> (lambda: 0.0),
)
_opacity_value = ~lit("at|to|with") + _transparency >> _opacity
_upside_down = lit("upside down|on (its|his|her|their) head|head over heels")
_look_name = table(
    {f"{look}|{look}s": look for look in STYLES} | {"flames|flame": "fire", "the night|night time|nighttime": "night"},
    reserve=False,
)
_look_adjective = table(
    {
        "golden": "gold",
        "silvery": "silver",
        "coppery": "copper",
        "icy|frozen over": "ice",
        "fiery|flaming|burning": "fire",
        "molten": "lava",
        "nighttime|night time": "night",
        "autumnal|autumn like|in autumn colors|autumn colored": "autumn",
        "grassy": "grass",
        "chocolatey|chocolaty": "chocolate",
        "ghostly|ghostlike": "ghost",
        "marbled": "marble",
        "sepia|sepia toned": "sepia",
        "neon": "neon",
    },
    reserve=False,
)
_any_look = _look_name | _look_adjective
_effect = lit(
    "colors|palette|look|style|effect|filter|appearance|finish|feel|vibe|mood|tone|tones|light|coloring|treatment"
)
_strongly = optional(_small, 1.0)
_seem = ~lit("look|looking|looks|appear|seem|feel")
_a_look = either(
    _seem
    + _strongly
    + lit("like|as if it were|as if they were|as though it were|similar to")
    + ~lit("(it is|they are) made (out) (of)|made (out) of")
    + ~lit("a|an|pure|solid|real")
    + _look_name,
    constant(1.0)
    + lit("(made|built|carved|cast) (out) of|in the style of|into|in")
    + ~lit("a|an|pure|solid")
    + _look_name
    + ~_effect,
    constant(1.0) + lit("in|into|with") + ~lit("a|an|the|some") + _any_look + _effect,
    _seem + _strongly + _look_adjective,
) >> (lambda strength, look: _styled(look, strength))
_bare_look = table({"night|night time|nighttime": "night", "sunset|sundown|dusk": "sunset"}, reserve=False) >> _styled
_given_look = _article + _any_look + ~lit("like|colored") + _effect >> _styled
_source = ~lit("that of|those of|the colors of|the color of") + known_thing + ~lit("'s (color|colors)")
_same_as = (
    lit("the (exact) same (color|colors|coloring|look)|the same|(a|the) similar color") + lit("as|like|to") + _source
    >> _matched
)
_colour_of = _article + lit("color|colors|coloring|palette|look|appearance") + lit("of|from") + _source >> _matched
_same_colour = _same_as | _colour_of
_alike = _seem + lit("like|similar to|the same as") + _source >> _matched
_made = either(
    _colour_value,
    _without_colour,
    _more_colour_value,
    _brightness_value,
    _contrast_value,
    _saturation_value,
    _warmth_value,
    _pop,
    _sized,
    _blur_value,
    _glow_value,
    _size_value,
    _pace_value,
    _opacity_value,
    _upside_down >> (lambda: _turned(UPSIDE_DOWN)),
    _same_colour,
    _a_look,
    _alike,
    _bare_look,
)


def REMARK() -> Value:  # it stands for what is said and asks for nothing
    """Make nothing: "leave the dog alone"."""
    raise Mismatch


# Commands ------------------------------------------------------------------------------------------------------------


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


def _always(value: Value) -> Callable[[], Value]:
    return lambda: value


def _listed(values: tuple[tuple[Value], ...]) -> tuple[tuple[Value], ...]:
    return values


def _values(*rules: Rule) -> Rule:
    return listed(either(*rules), lit("and|,|, and|but|and also|as well as|plus|but also|and then"))


# Colours
_into = ~lit("to|into|in")
_coloured = _colour_value | _without_colour
_command(
    "make the dog red",
    "make|render|have|get",
    _listed,
    "values",
    values=_values(_made, lit("in") + _coloured, lit("gone") >> _always(_deleted)),
)
_command(
    "turn the dog into gold",
    "turn|change|convert|transform|switch|set|put|throw",
    _listed,
    "values",
    values=_values(
        _a_look,
        _into + either(_coloured, _alike, _a_look, _same_as),
        lit("to") + ~lit("a|an|pure|solid") + _look_name >> _styled,
        lit("from") + silent(colour) + lit("to|into") + _coloured,
        lit("out of focus") >> _blurred,
        either(_brightness_value, _saturation_value, _warmth_value, _size_value, _blur_value),
        lit("to|into") + _colour_of,  # of "change the color of the dog" nobody knows to what
        _more_colour_value,
        _opacity_value,
    ),
)
_command(
    "paint the car blue",
    "cover|paint|repaint|color|recolor|dye|spray|spray paint|colorize|stain|shade|dress|dip|coat|drench|bathe|wrap|redo|do",
    _listed,
    "values",
    values=_values(
        ~lit("all|over|all over")
        + ~lit("in|to|as|with|into")
        + (_coloured | _same_colour | _a_look | ~lit("in|with") + ~lit("pure|solid") + _look_name >> _styled),
        _more_colour_value,
        _alike,
        _a_look,
    ),
)
_tint = ~lit("a|an") + ~lit("slight|faint") + (colour | colourish)
_command("tint the sky orange", "tint|tinge|tone|wash", _faintly, "rgb", rgb=~lit("in|to|with") + _tint + _colored)
_command(
    "change the color of the car to black",
    "change|set|turn|make|switch|alter|adjust|swap|shift|replace",
    lambda colors: colors,
    "colors",
    who=whose("color|colors|coloring"),
    colors=_values(
        ~lit("to|into|in|for|with|from") + (_coloured | _same_as),
        lit("from") + silent(colour) + lit("to") + _coloured,
        lit("to|like") + (_source >> _matched | _colour_of),
    ),
)
_command(
    "shift the hue of the car to red",
    "shift|change|turn|set|rotate|move|make|adjust",
    _hued,
    "rgb",
    who=whose("hue|hues|tone"),
    rgb=~lit("to|toward|into") + colour,
)
_command(
    "desaturate the background",
    "desaturate|decolor|decolorize|gray out",
    lambda how=None: _GRAYED if how is None else _saturated(factor(how, False)),
    how=lit("by") + number >> (lambda x: Amount("times", x)) | amount,
)
for _verb, _value in (
    ("whiten|bleach", _assigned((1.0, 1.0, 1.0))), ("blacken", _assigned((0.0, 0.0, 0.0))),
    ("redden", _added(1.0, ((1.0, 0.0, 0.0), 1))), ("gild", _styled("gold")),
    ("mute|dull|wash out", _saturated(factor(None, False))),
):  # fmt: skip
    _command(f"{_verb.split('|')[0]} the dog", _verb, _always(_value))
_command(
    "remove the color of the house",
    "remove|take|take out|take away|drain|strip|strip away|delete|drop|lose|get rid of|erase|suck",
    _always(_GRAYED),
    who=whose("color|colors|saturation|coloring"),
    out=lit("out|away"),
)
_command(
    "take the color out of the house",
    "take|drain|suck|strip",
    _always(_GRAYED),
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
        _command(f"double the {kind} of the dog", verb, _always(made(times)), who=its)
        _command(f"double the {kind} of the dog", verb, _always(made(times)), "its", its=lit("in") + lit(words))
    to = ~lit("to|at|equal to") + either(percent, multiple, fraction_of(words), number)
    _command(f"set the {kind} of the dog to 50 %", _SETTING, made, "by", who=its, by=to)


_SETTING = "set|change|make|turn|put|bring|adjust|reduce|lower|raise|increase"
_quality("size", "size|scale|dimensions", _scaled)
_quality("speed", "speed|pace|tempo", _retimed)
_quality("brightness", "brightness|light|luminance", _lit)
_quality("opacity", "opacity|visibility", _opacity)
_command(
    "set the transparency of the wall to 30 %",
    _SETTING,
    lambda by: _opacity(1 - by),
    "by",
    who=whose("transparency"),
    by=~lit("to|at") + either(percent, fraction, number),
)
for _example, _verbs, _making, _noun, _upward, _particle, _itself in (
    (
        "speed up the dog",
        "speed up|accelerate|quicken|hasten|hurry up",
        _retimed,
        "speed|pace",
        True,
        "",
        "speed up|accelerate",
    ),
    ("speed the dog up", "speed|hurry|quicken", _retimed, "speed|pace", True, "up", ""),
    ("slow down the dog", "slow down|slow|decelerate", _retimed, "speed|pace", False, "", "slow down|slow"),
    ("slow the dog down", "slow", _retimed, "speed|pace", False, "down", ""),
    (
        "brighten the dog",
        "brighten|lighten|brighten up|lighten up|illuminate|light up",
        _lit,
        "brightness",
        True,
        "",
        "brighten",
    ),
    ("brighten the dog", "brighten|lighten|light", _lit, "brightness", True, "up", ""),
    ("darken the sky", "darken|dim|dim down|black out", _lit, "brightness", False, "", "darken"),
    (
        "enlarge the dog",
        "grow|enlarge|expand|magnify|scale up|size up|blow up|upscale|upsize|increase|inflate",
        _scaled,
        "size",
        True,
        "",
        "grow|expand",
    ),
    ("scale the dog up", "scale|blow|size", _scaled, "size", True, "up", ""),
    (
        "shrink the dog",
        "shrink|shrink down|scale down|size down|downscale|downsize|contract|reduce|minimize",
        _scaled,
        "size",
        False,
        "",
        "shrink|contract",
    ),
    ("scale the dog down", "scale|size|shrink", _scaled, "size", False, "down", ""),
):
    _more_or_less(_example, _verbs, _making, _noun, _upward, _particle, itself=_itself)
_scale = (
    ~lit("by|to|up to|down to|up by|down by")
    + ~lit("a factor of|factor")
    + either(fraction_of("size"), percent, multiple, number)
)
_command("scale the dog by 2", "scale|resize|rescale", _scaled, "by", by=_scale)
for _verb, _times in (("double", 2.0), ("halve", 0.5), ("triple|treble", 3.0), ("quadruple", 4.0)):
    _command(f"{_verb.split('|')[0]} the dog in size", _verb, _always(_scaled(_times)), "its", its=lit("in size"))

_as_long = either(
    multiple + lit("as long") >> _stretched,
    multiple + lit("longer") >> _stretched,
    ~lit("to|by") + ~lit("a factor of") + fraction_of("length|duration|time") >> _stretched,
    lit("by") + ~lit("a factor of") + (multiple | number) >> _stretched,
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
    ("contrast", "contrast", _contrasted),
    (
        "saturation",
        "saturation|color saturation|vividness|vibrance|vibrancy|color intensity|intensity of the colors",
        _saturated,
    ),
    ("warmth", "warmth|color temperature|temperature", lambda by: _warmed(Amount("fraction", abs(by - 1)), by > 1)),
    ("brightness", "brightness|light|luminance|exposure", _lit),
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
        _listed,
        "values",
        who=~lit("to") + thing,
        itself="need|have|get|show",
        values=_values(_how_much),
    )
    _command(
        f"add more {_kind} to the dog",
        "add|put|use|apply|have|give",
        _listed,
        "values",
        who=lit("to|on|in|into|for") + thing,
        whole=True,
        values=_values(_how_much),
    )
    _command(
        f"add {_kind}",
        "add|boost",
        _always(_made_by(factor(None, True))),
        "it",
        who=lit("to|on|in|into") + thing,
        whole=True,
        it=lit("some|a bit of|a little|a touch of|a bit") + lit(_words) | lit(_words),
    )
    _command(
        f"more {_kind}", "", _listed, "values", who=lit("for|on|in") + thing, whole=True, values=_values(_how_much)
    )
_all_colors = either(whose("colors|color"), ~lit("the") + colors)
for _example, _verbs, _upward in (
    ("tone down the colors", "tone down|turn down|mute|soften|dull", False),
    ("turn up the colors", "turn up|crank up|boost|intensify|enhance|strengthen|deepen|punch up", True),
):
    _command(_example, _verbs, partial(_more_saturated, upward=_upward), who=_all_colors, how=amount)
_command(
    "saturate the colors",
    "saturate|enrich",
    partial(_more_saturated, upward=True),
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
        partial(_made_warmer, warmer=_warmer_too),
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
    values=_values(_warmth_value, _saturation_value, _contrast_value, _brightness_value, _pop),
)
_command(
    "blur the background",
    "blur|blur out|defocus|unfocus|soften|smudge",
    _blurred,
    who=thing,
    how=_softly,
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
    "add a blur to the background", "add|apply|put|give", _blurred, "how", who=lit("to|on|over") + thing, how=_blur_noun
)
_command("give the background a blur", "give", _blurred, "how", who=thing, how=_blur_noun)
_command(
    "make the dog glow",
    "",
    _glowing,
    itself="glow|shine|light up|shimmer|sparkle|radiate|gleam",
    how=_softly,
    rgb=~lit("in|in a|a") + colour,
)
_glow_noun = either(
    ~lit("some|a|an")
    + optional(table({"slight|soft|faint|gentle|subtle": Amount("small"), "strong|bright|intense": Amount("large")}))
    + optional(colour)
    + lit("glow|halo|shine|aura|gleam|sheen")
    >> (lambda how, rgb: (how, rgb))
)
_command("give the dog a glow", "give", lambda glow: _glowing(*glow), "glow", who=thing, glow=_glow_noun)
_command(
    "add a glow to the dog",
    "add|apply|put",
    lambda glow: _glowing(*glow),
    "glow",
    who=lit("to|on|around|onto") + thing,
    glow=_glow_noun,
)

# Places of two
_places = lit(
    "(the|their) [places|positions|spots|locations|place|position] (with "
    "each other|with one another)|with each other|with one another|around"
)
_command(
    "swap the dog and the cat",
    "swap|exchange|switch|trade|interchange|swap over|switch around",
    _swapped,
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
    _always(_opacity(0.0)),
    itself="disappear|vanish|hide|become invisible",
)
_again = lit("again|once more|back")
_command(
    "show the dog again",
    "unhide|reshow|bring back|restore",
    _always(_opacity(SHOWN)),
    again=_again,
    itself="reappear",
)
_command("show the dog again", "show|reveal", _shown, again=_again >> (lambda: True))
_command("bring the dog back", "bring", _always(_opacity(SHOWN)), "back", back=lit("back|back again|back in"))
_to_fraction = lit("to") + either(percent, fraction, number) + ~lit("opacity") | lit("by") + percent >> (
    lambda x: 1 - x
)
_outward = lit("out|away|off|to zero|to 0|into nothing|from view|out completely|to nothing|to invisible")
_command("fade the background", "fade|dissolve", lambda by=0.5: _faded(by), itself="fade", by=_to_fraction)
_command("fade out the dog", "fade|dissolve", lambda: _faded(0.0), "out", itself="fade", out=_outward)

_command(
    "fade in the dog from second 1 to 2",
    "fade|dissolve",
    lambda: _faded(0.0, inward=True),
    "inward",
    itself="fade",
    inward=lit("in|into view"),
)

# Taking out, and leaving alone
_DELETING = (
    "remove|delete|erase|get rid of|eliminate|drop|lose|discard|scrap|trash|do away with|dump|ditch"
    "|clear|banish|scratch|kill|cut|purge|rid us of"
)
_SPLIT = "take|cut|throw|wipe|rub|edit|crop|get|kick|strip|clean|clear|chuck|leave|mask|erase|delete|remove|chop|pull"
_out = lit(
    "out|away|off|out of [there|here|sight]|from sight|from view|[out of|from] [the|this] (whole"
    "|entire) [scene|picture|video|clip|image|shot|frame|view]|out of [the|this] [scene|picture"
    "|video|clip|image|shot|frame]"
)
_delete, _extract = _always(_deleted), _always(_extracted)
_command("remove everything except the dog", _DELETING, _extract, who=everything_but)
_command("take out everything except the dog", _SPLIT, _extract, "out", who=everything_but, out=_out)
_command(
    "remove the car", _DELETING, _delete, itself="go away|be gone|go|not be there|not be visible|get lost", bare=False
)
_command("take the car out", _SPLIT, _delete, "out", bare=False, out=_out)
_KEEPING = "keep|show|show me|leave|retain|have|display|see|preserve|let me see"
_only = lit("only|just|nothing but|solely|nothing except|nothing else but|nothing other than")
_only_keep = _only | lit(
    "[i|we] [only|just] want (to see)|[i|we] want to see [only|just]|[only|just] [keep|show|leave|retain]"
)
_command("keep only the dog", _KEEPING, _extract, "only", bare=False, only=_only)
_in_colour = lit("in (full) [color|colors]|colored")
_command(
    "show only the dog in color",
    _KEEPING,
    _always(_rest_grayed),
    "only colored",
    bare=False,
    only=_only,
    colored=_in_colour,
)
_command("only the dog", "", _extract, "only", bare=False, only=_only_keep)
_command(
    "crop everything but the dog", "crop|crop out|clear|wipe|strip|strip away|cut|hide", _extract, who=everything_but
)
_command("isolate the dog", "isolate|extract|single out|separate out|separate|cut free", _extract, bare=False)
_and_remove = ~lit(",") + ~lit("and|but") + lit("|".join(inflected(_DELETING, 1))) + silent(everything_else)
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
    _listed,
    "values",
    itself="run|go|walk|fly|swim|drive|dance|play|move|ride|roll|jump|gallop|race|be",
    values=_values(_backward),
)
_command(
    "move the dog to the left",
    "move|shift|push|put|slide|bring|pull|drag|place|shove|carry|send|scoot|nudge|translate|position|drive|displace|set|get|drop|"
    "throw|have|relocate|fly|float|slip|scooch|budge|transport|take|let|haul|tow|swing|draw|tug|boost|bump",
    _moved,
    "way",
    itself="move|go|slide|shift|jump|float|drift|come|fly|glide|wander|roll|hop|step|travel|drive|walk|hover|swim|be",
    way=steps,
    far=distance,
)
_command(
    "raise the box",
    "raise|lift|elevate|hoist",
    lambda far=None: _moved(_UP, far),
    itself="rise|go up|levitate|hover|float|ascend|take off|fly",
    far=distance,
    particle=lit("up|higher|in the air|in mid air|above the ground|off the ground|into the air|from the ground|upward"),
)
_command(
    "lower the lamp",
    "lower|sink",
    lambda far=None: _moved(_DOWN, far),
    itself="sink|go down|descend|come down",
    far=distance,
    particle=lit("down|lower"),
)
_ROTATING, _TILTING = (
    "rotate|spin|revolve|pivot|swivel|twirl",
    "tilt|roll|lean|tip|bank|slant|incline|tip over|lean over",
)
_sense = table(
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
_angle = either(_by + signed + lit("degrees|degree|deg|°|º"), ~lit("by") + signed, _by + ~lit("a|one") + _turn)
_axis = lit(
    "[around|about|on] [its|his|her|their|the] (own) (vertical) axis|[around|about] the vertical|in place|on the spot"
)
_turns: dict[str, Any] = {"angle": _angle, "sense": _sense, "axis": _axis}
_command(
    "turn the dog upside down",
    "turn|flip|rotate|put|stand|set|hang|place",
    _always(_turned(UPSIDE_DOWN)),
    "over",
    itself="turn|flip|stand",
    over=_upside_down,
)
_command(
    "turn the dog around",
    f"{_ROTATING}|turn",
    lambda angle=180.0, sense=1: _rotated(angle, sense),
    "around",
    itself=f"{_ROTATING}|turn|look|face",
    around=lit(
        "around|round|the other way (around)|to face the other way|back to front|about|so that [it|he"
        "|she] [faces|looks] the other way|"
        "[in|to] the [other|opposite] direction|completely around"
    ),
    **_turns,
)
_command("turn the dog to the left", "turn", _rotated, "sense", itself="turn", **_turns)
_command("turn the dog by 45 degrees", "turn", _rotated, "angle", itself="turn", **_turns)
_command("rotate the dog by 90 degrees", _ROTATING, _rotated, itself=_ROTATING, **_turns)
_command("tilt the lamp to the left", _TILTING, _tilted, "sense", itself=_TILTING, angle=_angle, sense=_sense)
_command("tilt the lamp by 20 degrees", _TILTING, _tilted, "angle", itself=_TILTING, angle=_angle, sense=_sense)

_command(
    "tilt the lamp a little",
    _TILTING,
    lambda how, sense=1: _tilted(TILT / 3 if how.kind == "small" else 2 * TILT, sense),
    "how",
    itself=_TILTING,
    how=degree,
    sense=_sense,
)

_command(
    "rotate the dog a little to the left",
    f"{_ROTATING}|turn",
    lambda how, sense=1: _rotated(15.0 if how.kind == "small" else 120.0, sense),
    "how",
    itself=f"{_ROTATING}|turn",
    how=degree,
    sense=_sense,
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
_shift = either(
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
_ways_beside = {
    "behind": (0, 0, 1), "in front of": (0, 0, -1), "next to|beside|alongside|to the right of|right of": (1, 0, 0),
    "to the left of|left of": (-1, 0, 0), "above|over|on top of": (0, -1, 0), "below|under|beneath": (0, 1, 0),
}  # fmt: skip
_own = table(_ways_beside) + thing >> (lambda way, who: (((None, way, None),), who))
_another_size = (
    ~lit(",")
    + ~lit("but|and|only|that is|at")
    + either(_size_value, _sized, _brightness_value, _opacity_value, ~lit("in") + _colour_value)
)
_beside: dict[str, Any] = {
    "changed": _another_size,
    "own": _own,
    "way": ~lit(",") + steps,
    "far": ~lit(",") + _apart | distance,
    "row": _in_a_row,
    "shift": _shift,
    "called": _called_so,
}
_copies = either(
    lit("a|another|one|one more|a second|an extra|a new") + lit("copy|clone|duplicate|replica") >> (lambda: 1.0),
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
    "copy the dog", "copy|duplicate|clone|replicate|make copies of|make a copy of", _copied, times=_how_often, **_beside
)
_command("put a copy of the car to the left", _ADDING, _copied, "times", bare=False, times=_copies, **_beside)
_command(
    "make a smaller copy of the dog to the right",
    _ADDING,
    _copied,
    "changed",
    bare=False,
    gapped=False,
    **(
        _beside
        | {
            "changed": lit("a|another")
            + either(_size_value, _sized, _colour_value, _brightness_value)
            + lit("copy|clone|duplicate")
            + lit("of")
        }
    ),
)
TRAIL_COPIES, TRAIL_LAG = 3.0, 0.2
"""Copies of a trail, and seconds from one to the next."""
_followers = either(
    lit("a|another|one") + lit("copy|clone|duplicate|second one") >> (lambda: 1.0),
    lit("another one|a second one") >> (lambda: 1.0),
    number + ~lit("ghost|ghostly|faint") + lit("copies|clones|duplicates|ghosts"),
    ~lit("some|a few") + lit("copies|clones|ghosts") >> (lambda: TRAIL_COPIES),
)


def _trailing(times: float, shift: TimeExpression | None = None) -> Value | tuple[tuple[Value], ...]:
    return _copied(times=times, shift=TimeExpression(seconds=TRAIL_LAG) if shift is None else shift)


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
    shift=_shift | ~lit("by|with") + duration,
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
    shift=_shift | ~lit("by|with") + duration,
)
_command("add another dog", _ADDING, _copied, "times", bare=False, times=_others, **_beside)
_command("another copy of the dog", "", _copied, "times", bare=False, times=_copies | _others, **_beside)

# Time
_motion = either(whose("motion|motions|movement|movements|action|animation"), thing)
_still = lit(
    "still|in place|in [the|its|his|her|their] tracks|in mid [air|flight|jump|step|stride|motion"
    "|run]|mid air|in the air|dead|in (mid) motion|moving|from moving|motionless|frozen|standing"
    " still|there"
)
_STANDING = "stand still|stay still|hold still|keep still|stop moving|be still|stay in place|not move|stand"
_command(
    "stop the dog at frame 30",
    "stop|freeze|pause|hold|halt|immobilize|stop moving",
    _always(_frozen),
    timed=True,
    itself=f"stop|freeze|pause|halt|{_STANDING}",
    still=_still,
)
_command("keep the dog still", "keep|leave", _always(_frozen), "still", still=_still)
_command(
    "play the dog at half speed",
    "play|run|show|put|set|render|play back|replay|move|drive|do",
    _listed,
    "values",
    who=_motion,
    timed=True,
    itself="move|run|go|walk|play|fly|swim|drive|fall|dance|swing|act|be|spin|travel|happen|jump|ride|roll"
    "|turn|gallop|race|jog|trot|flow|hop|fall|leap|skate|pass|drift",
    values=_values(number + lit("x") >> _retimed, ~lit("in|at") + _pace, _backward, lit("in") + _coloured, _a_look),
)
_in_time = lit("in time")
_command(
    "reverse the car",
    "reverse|rewind|play back to front|run in reverse",
    _always(_reversed),
    itself="reverse|rewind",
    who=_motion,
    timed=True,
    in_time=_in_time,
)
_on_and_on = lit("again and again|over and over (again)|endlessly|repeatedly|in a loop|on loop|on repeat")
_loop = _always(_looped)
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
    + either(_warmth_value, _brightness_value, _saturation_value, _contrast_value)
    + lit("tone|tones|look|feel|color|colors|light|appearance|mood|tint|touch|cast|atmosphere"),
    known_thing + lit("'s|'") + lit("color|colors|coloring|look|appearance") >> _matched,
    _given_look,
    _same_colour,
    _opacity_value,
    lit("a coat of") + colour + lit("paint") >> _assigned,
    ~lit("a|an") + colour + lit("color|look|coloring|paint job|coat of paint|paint") >> _assigned,
    _tint + lit("tint|tinge|touch") >> _faintly,
    ~lit("a|an") + colour + lit("hue") >> _hued,
    lit("the color") + _colour_value,
)
_onto = lit("to|on|onto|over|for") + thing
_command("give the dog a golden look", "give", _listed, "values", who=~lit("to") + thing, values=_given)
_command("apply the sepia look to the dog", "apply|add|put|use", _listed, "values", who=_onto, values=_given)
_with = lit("to|with|and") + ~lit("the [color|colors|coloring|look] of|that of|those of") + known_thing
_matching = _with + ~(lit("'s|'") + ~lit("color|colors|coloring"))
for _who in (whose("color|colors|coloring|look"), thing):
    _command(
        "match the dog to the cat", "match|color match|adapt|adjust", _matched, "source", who=_who, source=_matching
    )
_command("make the hat match the shirt", "", _matched, "source", itself="match", source=known_thing)
_called = ~lit("as|to") + name
_command("call the dog rex", "call|name|label|tag|dub|nickname", _named, "called", gapped=False, called=_called)

# What is said in passing, and commands without a verb
_command(
    "make the dog red", "do the same|do that too", _always(_deleted), who=lit("to|with|for|on") + thing, bare=False
)
COMMANDS[-1] = SAME = replace(COMMANDS[-1], gapped=False)
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
_complained_of = either(
    lit("it|this|that")
    >> (lambda: lambda context: _noted(context, context.last or (Current() if context.selected else All()))),
    thing,
)
_command(
    "brighten the dog",
    "",
    REMARK,
    "remark",
    bare=False,
    gapped=False,
    who=_complained_of,
    remark=lit("is|are|looks|look|seems|seem|was|were")
    + ~lit("a bit|a little|much|way|far")
    + ~lit("too|so|very|rather|quite|really")
    + lit(_quality_words),
)
_wanted = lit("i want|i would like|we want|we would like|i would love|we need|i need")
_command(
    "I want a white dog",
    "",
    lambda want, rgb, rest=None: _assigned(rgb),
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
    lambda other: _swapped(other),
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
_command("tone down the sky", "tone down", lambda how=None: _lit(factor(how, False)), how=amount)
_command("tone the sky down", "tone", lambda how=None: _lit(factor(how, False)), "down", how=amount, down=lit("down"))
_day = lit("(the) day|daytime|daylight") >> (lambda: lambda context: _noted(context, All()))
_command(
    "turn day into night",
    "turn|change|make|transform",
    _listed,
    "values",
    bare=False,
    gapped=False,
    who=_day,
    values=_values(lit("into|to") + _bare_look),
)
_keeps = lit("keeps|keep|retains|stays|stay|remains") + lit("(its|their|his|her) [color|colors]|colored|in color")
_command(
    "only the dog keeps its color",
    "",
    _always(_rest_grayed),
    "only keeps",
    bare=False,
    gapped=False,
    only=_only,
    keeps=_keeps,
    rest=~lit(",|and")
    + silent(everything_else)
    + lit("goes|go|turns|becomes|is|should be|should go|gets|turn|become")
    + silent(_without_colour | colour),
)
_changed = either(_size_value, _pace_value, _brightness_value, _saturation_value, _warmth_value, _contrast_value)
_command(
    "the dog twice as fast",
    "",
    _listed,
    "values",
    bare=False,
    gapped=False,
    values=_values(
        _changed, lit("in") + (_coloured | _any_look >> _styled), ~lit("in") + _slow_motion >> _retimed, _backward
    ),
)
_command(
    "a bigger dog",
    "",
    _listed,
    "values",
    bare=False,
    gapped=False,
    who=known_noun,
    values=~lit("a|an|some|the") + either(_changed, _sized) >> (lambda value: ((value,),)),
)
_command("no dog", "", _delete, "no", bare=False, gapped=False, no=lit("no"))
for _kind, _words, _made_by in (
    ("contrast", "contrast", _contrasted),
    ("saturation", "saturation", _saturated),
    ("brightness", "brightness", _lit),
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
    _copied,
    "behind shift",
    bare=False,
    gapped=False,
    who=lit("a second|another|a copy of the|a clone of the|one more|a duplicate of the") + known_noun,
    behind=_behind,
    shift=_shift | ~lit("by|with") + duration,
)


def _trailed(count: float = TRAIL_COPIES) -> Value | tuple[tuple[Value], ...]:
    return _copied(times=count, shift=TimeExpression(seconds=TRAIL_LAG))


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
def _lasting(to: TimeExpression) -> Value:
    def value(who: SelectKind, when: When, context: SentenceContext) -> Operation:
        if when.frames is None or when.frames[1] is None or to.resolve(context) <= 0:
            raise Refusal("It is not said which part is to last so long; add for example 'from second 1 to 2'.")
        speed = (when.frames[1] - when.frames[0]) / to.resolve(context)
        return Retime(who, round(speed, PLACES), **when.pace)

    return value


_command(
    "stretch the first second to two seconds",
    "stretch|stretch out|extend|slow down|compress|squeeze",
    _lasting,
    "to",
    whole=True,
    to=lit("to|into|over") + duration,
)
