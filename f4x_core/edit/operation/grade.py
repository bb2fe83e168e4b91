"""Contrast, saturation, warmth, hue and gamma."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np

from ...errors import F4xError
from ...geometry import spherical_harmonics
from ...language.degrees import DEGREES, Amount
from ...language.lexicon import PLACES
from .. import colours
from ..change import Ease, Span, check_range, check_span
from ..description import percent_words, whom
from ..selects import SelectKind
from ..state import Appearance
from ..values import Making, Value, graded, refused, strong
from ._color import ColorChange
from .recolour import GRAYED

if TYPE_CHECKING:
    from ..english import Sentences

MIN_GAMMA = 0.1
"""Minimum gamma, and the inverse of the maximum."""
WARMER = 0.5
"""Warmth of "warmer", the usual degree of it."""


@dataclass(frozen=True)
class Grade(ColorChange):
    """Contrast, saturation and warmth, in OKLab, and gamma; 1, 1, 0, 1 is as before."""

    TAG = "grade"
    select: SelectKind
    contrast: float = 1.0
    """Factor of the distance of each light from the mean light of the selection."""
    saturation: float = 1.0
    """Factor of the distance from gray."""
    warmth: float = 0.0
    """From -1, bluish, to 1, yellowish."""
    frames: Span | None = None
    ease: Ease | None = None
    gamma: float = 1.0
    """Each channel is raised to 1 / gamma after the rest: above 1 the midtones get brighter, black and white stay."""
    hue: float = field(default=0.0, metadata={"degrees": 180})
    """Degrees by which hues turn, from red towards yellow, green and blue."""

    def __post_init__(self) -> None:
        check_range("contrast", self.contrast, 10)
        check_range("saturation", self.saturation, 10)
        if not MIN_GAMMA <= self.gamma <= 1 / MIN_GAMMA:
            raise F4xError(f"gamma is {self.gamma:g}; give a number from {MIN_GAMMA:g} to {1 / MIN_GAMMA:g}.")
        if abs(self.hue) > 360:
            raise F4xError(f"hue is {self.hue:g}; give degrees from -360 to 360.")
        if not -1 <= self.warmth <= 1:
            raise F4xError(f"warmth is {self.warmth:g}; give a number from -1 to 1.")
        check_span(self.frames)

    FACTORS = ("contrast", "saturation")
    has_tones = of_picture = True  # type: ignore[assignment]  # whatever is graded

    def coloured(self, whom: Appearance, tones: Any) -> Appearance:
        """Apply contrast about the mean lightness `tones`, saturation, hue and warmth, then gamma."""
        plain = (self.contrast, self.saturation, self.warmth, self.hue) == (1, 1, 0, 0)
        if plain and self.gamma == 1:
            return whom
        rgb = colours.colours_of(whom.sh)
        goal = rgb if plain else colours.graded(rgb, self.contrast, self.saturation, self.warmth, tones, self.hue)
        if self.gamma != 1:
            goal = np.maximum(goal, 0) ** (1 / self.gamma)
        dc = spherical_harmonics.dc_from_rgb(goal).astype(np.float32)
        rest = whom.sh[:, 1:] * np.float32(self.contrast)
        return Appearance(whom.opacities, np.concatenate([dc[:, None], rest], axis=1))

    def described(self) -> str:
        who, parts = whom(self.select), []
        if self.contrast != 1:
            parts.append(f"set the contrast of {who} to {percent_words(self.contrast)}")
        if self.saturation != 1:
            parts.append(f"set the saturation of {who} to {percent_words(self.saturation)}")
        if self.gamma != 1:
            parts.append(f"set the gamma of {who} to {self.gamma:g}")
        if self.hue:
            parts.append(f"shift the hue of {who} by {self.hue:g} degrees")
        if self.warmth or not parts:
            parts.append(f"make {who} {percent_words(abs(self.warmth))} {'cooler' if self.warmth < 0 else 'warmer'}")
        return self.coming(" and ".join(parts))

    @classmethod
    def sentences(cls) -> Sentences:
        from .. import english as say

        qualities = (
            say.Quality(graded(grade("gamma"), gone=False), more="", less="", much="", little="", noun="gamma"),
            say.Quality(
                graded(grade("contrast")), "punchier|crisper", "flatter",
                much="contrasty|contrastful|punchy|contrasted", little="flat",
                noun="contrast", lack="flatness", too="harsh|hard|contrast", wished=True,
            ),
            say.Quality(
                _saturated, "richer|livelier", "duller|paler",
                much="saturated|vivid|colorful|vibrant|intense|rich|lively|colored",
                little="desaturated|muted|dull|washed out|pale|faded",
                noun="saturation|sat|color saturation|color intensity|vibrance|vividness|colorfulness|chroma|color|colors",
                lack="dullness|paleness", up="saturate", down="mute", excess="oversaturated|garish|gaudy",
                dearth="washed out|faded|lifeless|bland|dull|drab", too="strong", wished=True,
            ),
            say.Quality(
                warmed, "warmer|cozier|cosier", "cooler|colder|chillier", much="warm|cozy|cosy", little="cool|cold|chilly",
                noun="warmth|color temperature|temperature", lack="coldness|coolness", up="warm", down="cool",
                too="yellow|orange", too_little="blue|bluish", wished=True,
            ),
        )  # fmt: skip
        pop = say.keyword(
            "pop|pop more|pop out|stand out|stand out more|come alive|(more|really) vivid|(very) saturated|(very) colorful|vibrant"
        ) + say.unless(say.known_thing)
        lively = say.literal(
            "[some|a little|(a) bit|a touch|extra] (of|more) [life|punch|pop|oomph|vibrancy|zing|pizzazz|kick]|oomph|zing|life|pep|"
            "pizzazz|(a) (little) pop of color|more color|some color"
        )
        hue = say.command(
            "shift the hue of the dog by 40 degrees", grade("hue"), "hue by", say.WHOLE, verb="{set,become}|{rotate}|offset",
            hue="(the|its|a|all) [hue|hues] (shift|rotation|rotate|turn|offset|angle)",
            by="(by|of|=|+) <signed> (degrees|degree|deg|°|º)",
        )  # fmt: skip
        more = lambda: _saturated(None, True)  # noqa: E731
        return say.Sentences((hue,), qualities, (pop >> more,), (lively >> more,), {"desaturate": (grayed, False)})


def grade(quality: str) -> Making:
    """Return the function that makes a grade of a number for one of its fields."""

    def made(by: float) -> Value:
        number: dict[str, Any] = {quality: round(by, PLACES)}
        return lambda who, when, _: Grade(who, **number, **when.coming)

    return made


def warmed(how: Amount | None, warmer: bool) -> Value:
    """Return a grade that is warmer or cooler by a fraction of the most there can be; twice as warm is by the whole of it."""
    sign = 1 if warmer else -1
    if how is None or how.kind in DEGREES:
        warmth = sign * strong(WARMER, how)
    else:
        warmth = sign * (how.value if how.kind == "fraction" else how.value - 1)
    if abs(warmth) > 1 or (how is not None and how.kind == "times" and how.value < 1):
        return refused("Nothing gets warmer or cooler by more than 100 %; say for example '30 % warmer'.")
    return lambda who, when, _: Grade(who, warmth=round(warmth, PLACES), **when.coming)


_saturated = graded(grade("saturation"))


def grayed(how: Amount | None, upward: bool) -> Value:
    """Return less saturation; gray where no amount is given."""
    return GRAYED if how is None else _saturated(how, upward)
