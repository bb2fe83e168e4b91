"""Another color, or more and less of one."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from ...errors import F4xError
from ...language.colour_names import COLOURS
from ...language.degrees import DEGREES, Amount, factor
from ...language.lexicon import PLACES, plural
from ...language.refusal import Mismatch
from .. import colours
from ..change import Change, Ease, Reply, Span, Vector, check_range, check_span
from ..description import colour_words, number_words, percent_words, strength_words, times_words, whom
from ..selects import All, Not, SelectKind
from ..state import Appearance
from ..values import Graded, Value, graded, refused
from ._color import Dye

if TYPE_CHECKING:
    from ...language.grammar import Rule
    from ..english import Sentences
    from ..phrases import SentenceContext, When

BLACK_AND_WHITE = (0.5, 0.5, 0.5)
"""As `hue`: no colour is left, light and dark stay."""
A_BIT = 0.5
"""Strength of a tint."""
MORE_COLOUR = 0.3
"""Fraction of the way from gray to red that "redder" goes."""
MOST_LIGHT, LIGHT_PLACES = 64.0, 6
"""Largest factor of light, six stops up, and its decimals: three of them would be off at six stops down."""
_BASIC = ("red", "green", "blue", "yellow", "orange", "purple", "pink", "cyan", "brown", "white", "black")


@dataclass(frozen=True)
class Recolour(Dye):
    """Another colour."""

    TAG = "recolour"
    select: SelectKind
    rgb: Vector
    """sRGB in [0, 1]; for `add` -1 to 1, for `multiply` 0 to 10, for `light` 0 to 64."""
    mode: Literal["assign", "add", "multiply", "hue", "light"] = "assign"
    """`assign` the colour; `add` it; `multiply` the colours as displayed by it, or their linear `light`: 2 is one stop up; take its
    `hue` and saturation and leave light and dark."""
    strength: float = 1.0
    keep_luminance: bool = False
    """With `assign`: shading and texture stay, brightened or darkened so that their mean is the colour's."""
    frames: Span | None = None
    ease: Ease | None = None

    def __post_init__(self) -> None:
        low, high = {"add": (-1, 1), "multiply": (0, 10), "light": (0, MOST_LIGHT)}.get(self.mode, (0, 1))
        if not all(low <= value <= high for value in self.rgb):
            raise F4xError(f"rgb is {list(self.rgb)}; for {self.mode} give three numbers from {low} to {high}.")
        check_range("strength", self.strength)
        check_span(self.frames)

    @property
    def has_tones(self) -> bool:
        return self.keep_luminance

    def goal(self, rgb: np.ndarray, whom: Appearance, tones: Any) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        target = np.array(self.rgb)
        if self.mode in ("multiply", "light"):
            goal, growth = colours.exposed(rgb, target) if self.mode == "light" else (rgb * target, target[None])
            rest = whom.sh[:, 1:] * (1 + self.strength * (growth[:, None] - 1))
            return goal, rest.astype(np.float32), whom.opacities
        if self.mode == "add":
            return rgb + self.rgb, whom.sh[:, 1:], whom.opacities
        if self.mode == "hue":
            goal = colours.with_hue(rgb, target)
        elif self.keep_luminance:
            goal = colours.painted(rgb, target, tones)
        else:
            goal = np.broadcast_to(target, rgb.shape)
        return goal, self.faded(whom), whom.opacities

    @property
    def of_picture(self) -> bool:
        return self.mode in ("multiply", "light", "add") or (self.mode, self.rgb) == ("hue", BLACK_AND_WHITE)

    @property
    def aspect(self) -> tuple[Any, ...]:
        return (Recolour, self.mode, self.rgb if self.mode == "add" else None)

    @property
    def covers(self) -> bool:
        """A color of its own, in full."""
        return self.mode == "assign" and self.strength == 1

    @property
    def is_covered(self) -> bool:
        """A color of its own."""
        return self.mode == "assign"

    def followed_by(self, later: Change) -> tuple[Change, ...]:
        """Return both of "red until second 1, then blue", the later one from the end of this one on."""
        same = isinstance(later, Recolour) and (later.select, later.mode) == (self.select, self.mode)
        if same and later.span is None and self.frames is not None and self.frames[1] is not None:
            later = replace(later, frames=(self.frames[1], None))  # type: ignore[type-var]
        return super().followed_by(later)

    def described(self) -> str:
        who, rgb, strong = whom(self.select), self.rgb, strength_words(self.strength)
        if self.mode == "hue" and set(rgb) == {0.5}:
            sentence = f"make {who} {strong}black and white"
        elif self.mode == "hue":
            sentence = f"shift the hue of {who} {strong}to {colour_words(rgb)}"
        elif self.mode == "light" and len(set(rgb)) == 1 and rgb[0]:
            sentence = _exposure_words(who, rgb[0])
        elif self.mode == "light":
            sentence = f"multiply the light of {who} by {number_words(rgb)}"
        elif self.mode == "multiply" and len(set(rgb)) == 1:
            sentence = f"make {who} {times_words(rgb[0], 'bright', 'brighter', 'darker')}"
        elif self.mode == "multiply":
            sentence = f"multiply the color of {who} by {number_words(rgb)}"
        elif self.mode == "add":
            more = _more(rgb)
            sentence = f"make {who} {more}" if more else f"add {number_words(rgb)} to the color of {who}"
        else:
            sentence = f"make {who} {strong}{'' if self.keep_luminance else 'solid '}{colour_words(rgb)}"
        return self.coming(sentence)

    @classmethod
    def replies(cls) -> tuple[Reply, ...]:
        byte = range(256)

        def painted(answer: Any, who: SelectKind, _: Any) -> Recolour:
            rgb = (answer.red / 255, answer.green / 255, answer.blue / 255)
            mode: Literal["hue", "assign"] = "hue" if answer.mode == "hue" else "assign"
            return Recolour(who, rgb, mode, answer.strength / 100, answer.mode == "paint", answer.span)

        def brightness(answer: Any, who: SelectKind, _: Any) -> Recolour:
            return Recolour(who, (answer.percent / 100,) * 3, "multiply", frames=answer.span)

        def exposure(answer: Any, who: SelectKind, _: Any) -> Recolour:
            return Recolour(who, (2 ** (answer.tenths / 10),) * 3, "light", frames=answer.span)

        doc = "Another colour; `paint` keeps light and dark, `flat` does not, `hue` turns the hue alone."
        bytes_ = {"red": byte, "green": byte, "blue": byte}
        mixed = {**bytes_, "mode": ("paint", "flat", "hue"), "strength": range(101)}
        return (
            Reply(("paint",), doc, painted, mixed, "Paint"),
            Reply(
                ("brightness",),
                "Brighter or darker, as displayed: 100 is as before.",
                brightness,
                {"percent": range(1001)},
                "Brightness",
            ),
            Reply(
                ("exposure",), "Linear light, in tenths of a stop.", exposure, {"tenths": range(-60, 61)}, "Exposure"
            ),
        )

    @classmethod
    def sentences(cls) -> Sentences:
        from .. import english as say

        light = say.Quality(
            _brighter, "brighter|lighter", "darker|dimmer|gloomier", much="bright|light", little="dark|dim",
            noun="brightness|light|lights|lighting|illumination|luminance|lightness|luminosity|glare",
            lack="darkness", up="brighten", down="darken", excess="glaring", dearth="murky|gloomy|dim",
            too="shiny", too_little="black|shadowy", wished=True,
        )  # fmt: skip
        exposure = say.Quality(
            graded(exposed, lambda degree: (2.0**degree.share, 2.0**-degree.share)), light.more, light.less, much="exposed",
            little="", noun="exposure|gain", excess="overexposed|blown out", dearth="underexposed",
        )  # fmt: skip
        hue = say.command(
            "shift the hue of the car to red", hued, "rgb", say.NAMED, say.whose("hue|hues|tone"), verb="{set,become}",
            rgb=~say.keyword("to|toward|into") + say.colour,
        )  # fmt: skip
        tint = say.command(
            "tint the dog orange", lambda rgb, share=A_BIT: assigned(rgb, share), "verb rgb", verb="{tint}",
            rgb="<a_color> <shade_of> [<colour>|<colourish>] (<colored>)",
            share=~say.keyword("by|at") + (say.percent >> say.at_most),
        )  # fmt: skip
        rest = say.command(
            "only the dog keeps its color", say.always(rest_grayed), "only keeps", say.NAMED, verb="{keep,show}|let",
            only="[only|just|solely] !<.span>",
            keeps="[keeps|keep|retains|stays|stay|remains|remain|has|have] (its|their|his|her) [color|colors|colored|in color]|in "
            "(full|its) [color|colors]|colored",
        )  # fmt: skip
        lifted = say.command(
            "lift the dog by half a stop", lambda way, by: exposed(factor(by, way)), "way by",
            verb="![add|adds|adding|added] [{set,become,apply}]",
            way={
                "[raise|lift|push|bring|expose|pull|open|come|go] up|up|over|brighter|lighter|more|raise|lift|push|+|higher": True,
                "[drop|pull|bring|knock|take|come|go] [down|back]|down|under|darker|dimmer|less|drop|lower|back|-": False,
            },
            by="(by|a) <stops>",
        )  # fmt: skip
        stops = say.command(
            "exposure +0.5", exposed_by, "exposure by", say.WHOLE, verb="![add|adds|adding|added] [{set,become,apply}]",
            way={"raise|increase|lift|push|boost|up|+|plus": True, "lower|decrease|reduce|drop|cut|down|-|minus": False},
            exposure="(the|its|their) exposure (:|=|by|of|to|at)",
            by="(by|of|to|at) [<number>|<fraction>] ![%|percent|per cent|pct|x|times|stop|stops|ev|f|/]",
        )  # fmt: skip
        fade = say.command(
            "fade to black at the end", fading_to, "verb rgb", say.WHOLE,
            verb="{=fade/dissolve/dip/go/fade out/fade slowly}",
            rgb="[to|into|out to|down to] (a|solid|pure|full|total|complete) <colour>",
        )  # fmt: skip
        pulled = say.command(
            "pull the green of the dog by 10 %", lambda way, rgb, how=None: more_of(rgb)(how, way), "way rgb", say.WHOLE,
            way={say.any_form("more"): True, say.any_form("less"): False}, rgb="(the|its|all (the)) <colour> (channel|cast|tint)",
            how=say.amount, across="across (the board)|back|down|up|out",
        )  # fmt: skip
        return say.Sentences((hue, tint, rest, lifted, fade, pulled), (light, exposure), *_colors(), early=(stops,))


def exposed_by(by: float, way: bool = True) -> Value:
    """Return the value for `by` stops more light, less with `way` False; Mismatch where the number means percent."""
    from ...language.amounts import LEAST_PERCENTS  # with the grammar

    if abs(by) >= LEAST_PERCENTS:
        raise Mismatch
    if not by:
        return refused("That changes nothing; say for example 'exposure +0.5'.")
    return exposed(2.0 ** (by if way else -by))


def _exposure_words(who: str, by: float) -> str:
    """Return "raise the exposure of the dog by 0.5 stops"; in percent where that is round and the stops are not."""
    stops = round(math.log2(by), 2)
    if by == round(by, 2) and stops % 1:
        return f"set the exposure of {who} to {percent_words(by)}"
    return f"{'lower' if stops < 0 else 'raise'} the exposure of {who} by {abs(stops):g} {plural('stop', abs(stops))}"


def _more(rgb: Vector) -> str:
    """Return "30 % more red" for an added color; empty where it is no basic one."""
    for word, sign in (("more", 1), ("less", -1)):
        for name in _BASIC:
            pure = [sign * (c - 0.5) for c in COLOURS[name]]
            share = round(max(map(abs, rgb)) / max(map(abs, pure)), PLACES)
            if rgb == tuple(round(share * c, PLACES) for c in pure):
                return f"{percent_words(share)} {word} {name}"
    return ""


def _colors() -> tuple[tuple[Rule, ...], tuple[Rule, ...]]:
    """Return the rules of colors behind "make the dog", and of those that stand alone."""
    from .. import english as say

    degree = say.degree >> (lambda how: DEGREES[how.kind].share)
    much = say.either(degree, ~say.keyword("by") + (say.percent | say.fraction) >> (lambda x: x / MORE_COLOUR))
    gray = say.keyword(
        "black and white|black white|b and w|b / w|monochrome|monochromatic|(a) grayscale|gray scale|colorless|desaturated|"
        "without (any|its|all) color|without colors"
    ) + ~say.literal("look|filter|effect|video|clip|film|movie|version|picture|image|grade|treatment|footage")
    flat = say.keyword("solid|flat|plain|pure|uniform|unshaded|uniformly|flatly")
    shade = say.shade_of + ~(say.keyword("from") + say.silent(say.colour) + ~say.keyword("to|into"))
    partly = say.degree >> (lambda how: say.at_most(DEGREES[how.kind].share)) | say.keyword("faintly|kind of") >> (
        lambda: A_BIT
    )
    share = say.percent >> say.at_most
    fully = ~say.keyword("all|completely|fully|entirely|totally|wholly")
    made = say.either(
        say.phrase("(a|an|the|some) <flat> (<flat>) <colour> (<colored>)", flat=flat) >> recoloured,
        (partly + (say.colour | say.colourish) | share + say.colour) >> (lambda part, rgb: assigned(rgb, part)),
        say.phrase("(a|an|some) <colourish> (<colored>)") >> faintly,
        fully + say.phrase("(a|an|some) <shade> (the color) <colour> (<colored>)", shade=shade) >> assigned,
        say.phrase("(a|an|the) <share> <gray>", share=say.optional(share, 1.0), gray=gray)
        >> (lambda part: hued(BLACK_AND_WHITE, part)),
        say.more_colour + much >> (lambda more, times: added(times, more)),
        say.optional(much, 1.0) + say.more_colour >> added,
    )
    hue = say.shade_of + (say.colour | say.colourish)
    alone = say.either(
        say.phrase("<a_> <hue> [tint|tinge|touch|cast|wash|hint|note|filter|overlay|glaze|veil]", hue=hue) >> faintly,
        say.phrase(
            "<a_> (nice|fresh|new|good|coat of|layer of|lick of|splash of|shade of|tone of) <shade_of> <colour> [color|paint|shade|"
            "coat|hue|coat of paint|paint job|version|one|variant|lacquer|dye|tone|tones|colors|finish|makeover|varnish|dye job|"
            "respray|lick of paint|look|appearance]|(with|in|to|of|as) (the|a) color (:|=|of|to) <colour>"
        )
        >> assigned,
        say.phrase("<a_> (black|dark|pure|full|complete) silhouette") >> (lambda: recoloured(COLOURS["black"])),
    )
    return (made,), (alone,)


def recoloured(rgb: Vector, mode: Any = "assign", strength: float = 1.0) -> Value:
    """Return a change to a color by `mode`."""
    return lambda who, when, _: Recolour(who, rgb, mode, strength, **when.coming)


def hued(rgb: Vector, strength: float = 1.0) -> Value:
    """Return a change to the hue of a color; lightness stays."""
    return recoloured(rgb, "hue", strength)


def assigned(rgb: Vector, strength: float = 1.0) -> Value:
    """Return a change to a color that keeps the thing's light and shade; gray takes its color away."""
    if rgb == COLOURS["gray"]:
        return recoloured(BLACK_AND_WHITE, "hue", strength)
    return lambda who, when, _: Recolour(who, rgb, strength=strength, keep_luminance=True, **when.coming)


def faintly(rgb: Vector) -> Value:
    """Return a slight change to a color."""
    return assigned(rgb, A_BIT)


def brightened(by: float) -> Value:
    """Return a multiple of the brightness."""
    return recoloured((round(by, PLACES),) * 3, "multiply")


def exposed(by: float) -> Value:
    """Return a multiple of the linear light."""
    return recoloured((round(by, LIGHT_PLACES),) * 3, "light")


def _brighter(how: Amount | None, upward: bool) -> Value:
    """Return more or less brightness as displayed; in linear light where it is counted in stops."""
    return graded(exposed if how is not None and how.kind == "stops" else brightened)(how, upward)


def added(times: float, more: tuple[Vector, int]) -> Value:
    """Return a shift toward or away from a color, `times` as large as usual."""
    rgb, sign = more
    red, green, blue = (round(times * sign * MORE_COLOUR * (c - 0.5), PLACES) for c in rgb)
    return recoloured((red, green, blue), "add")


def more_of(rgb: Vector) -> Graded:
    """Return more or less of a color, by the part of it that is said, else as much as is usual."""

    def changed(how: Amount | None, upward: bool) -> Value:
        if how is not None and how.kind != "fraction" and how.kind not in DEGREES:
            raise Mismatch
        times = (
            DEGREES[how.kind if how else "usual"].share
            if how is None or how.kind in DEGREES
            else how.value / MORE_COLOUR
        )
        return added(times, (rgb, 1 if upward else -1))

    return changed


def fading_to(rgb: Vector) -> Value:
    """Return a gradual change to a color; of everything, without a time, over the last second."""

    def value(who: SelectKind, when: When, context: SentenceContext) -> Change:
        fields = when.fading(context, inward=False)
        if "ease" not in fields:
            start = context.frames - 1 - context.edge if who == All() else 0.0
            fields = {"frames": (start, None), **fields, "ease": "linear"}
        if not any(rgb):
            return Recolour(who, rgb, "multiply", **fields)
        return Recolour(who, rgb, **fields)

    return value


def rest_grayed(who: SelectKind, when: When, context: SentenceContext) -> Change:
    """Return a change that takes the color of all else away."""
    return GRAYED(Not(who), when, context)


GRAYED = hued(BLACK_AND_WHITE)
