"""Brighter, with a halo."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from ...errors import F4xError
from ...language.degrees import Amount
from ...language.refusal import Mismatch
from ..change import MAX_NUMBER, MAX_SCALE, Change, Span, Vector, check_range, check_span
from ..description import colour_words, percent_words, span_words, whom
from ..selects import Named, SelectKind
from ..values import Value, only_more, refused, strong
from .blur import Blur
from .duplicate import Duplicate
from .opacity import Opacity
from .recolour import Recolour

if TYPE_CHECKING:
    from ..english import Sentences

USUAL = 0.5
"""Strength of "glow", the usual degree of it."""
HALO = "halo of what glows"
"""Name by which the steps of a glow select its halo."""
HALO_LIGHT = 1.5
"""Gain of the colors of a thing that glows."""


@dataclass(frozen=True)
class Glow(Change):
    """Brighter, with a halo: blurred, faint copies in the same places, whose ids follow `first_id`."""

    TAG = "glow"
    select: SelectKind
    strength: float = USUAL
    """0 is none, 1 a halo as dense as the thing."""
    rgb: Vector | None = None
    """Colour of the halo, sRGB in [0, 1]; None = that of the thing."""
    radius: float = 0.04
    """Standard deviation of the halo in world units."""
    frames: Span | None = None
    """In effect from … to; None = always."""
    first_id: int = -1
    """First id of the halo; planning reserves it."""

    def __post_init__(self) -> None:
        check_range("strength", self.strength)
        check_range("radius", self.radius, MAX_SCALE)
        check_span(self.frames)
        if self.rgb is not None and not all(0 <= value <= 1 for value in self.rgb):
            raise F4xError(f"rgb is {list(self.rgb)}; give three numbers from 0 to 1.")

    lasts = False  # type: ignore[assignment]  # it is blurred

    def steps(self) -> tuple[Change, ...]:
        """Return the steps of a glow: brighter, then faint blurred copies, hidden before and after the span."""
        light, halo = 1 + self.strength * (HALO_LIGHT - 1), Named(HALO)
        steps: list[Change] = [
            Recolour(self.select, (light, light, light), "multiply", frames=self.frames),
            Duplicate(self.select, first_id=self.first_id, name=HALO),
            Blur(halo, self.radius, None),
            Opacity(halo, self.strength),
        ]
        if self.rgb is not None:
            steps.append(Recolour(halo, self.rgb))
        if self.frames is not None:
            first, last = self.frames
            steps.append(Opacity(halo, 0.0, (-MAX_NUMBER, np.nextafter(first, -MAX_NUMBER))))
            if last is not None:
                steps.append(Opacity(halo, 0.0, (np.nextafter(last, MAX_NUMBER), None)))
        return tuple(steps)

    def described(self) -> str:
        colour = f" {colour_words(self.rgb)}" if self.rgb else ""
        return f"make {whom(self.select)} glow{colour} by {percent_words(self.strength)}" + span_words(self.frames)

    @classmethod
    def sentences(cls) -> Sentences:
        """Return "glowing" as a quality, and the command that puts a glow on a thing."""
        from .. import english as say

        quality = say.Quality(
            only_more(glowing), "glowier", "", much="glowing|glowy|luminous|aglow|radiant|shining|shimmering|glow", little="",
            noun="glow|halo",
        )  # fmt: skip
        shining = say.keyword(quality.much)
        put = say.command(
            "add a soft blue glow around the dog", _haloed, "light", verb="!<has_to_go> <light_verb>",
            light=say.phrase(
                "(with) <a_bit> <shade_of> <colour?> (neon|light|outline) [glow|shimmer|halo|shine|aura|gleam|sheen|bloom|"
                "radiance|emission|luminescence|phosphorescence|fluorescence|incandescence|glimmer|sparkle|nimbus|corona|"
                "afterglow|emissive] (of light) (effect)"
            ) >> (lambda how, rgb: (how, rgb)),
            rgb="(in|in a|with) <colour> (light|color)",
        )  # fmt: skip
        glow = say.command(
            "make the dog glow", glowing, "verb", verb="[{glow}|aglow|luminous|radiant] (on|effect|in the dark)",
            how=say.softly | say.phrase("(by|at) <percent>") >> (lambda x: Amount("fraction", x)),
            rgb="<a_color> <shade_of> <colour> (light|color|tone|shade|hue)",
        )  # fmt: skip
        made = say.phrase("<how?> <shining> (in) <colour?>", how=say.softly | say.amount, shining=shining) >> glowing
        return say.Sentences((put, glow), (quality,), made=(made,))


def glowing(how: Amount | None = None, rgb: Vector | None = None) -> Value:
    """Return a glow in the thing's own colors or in `rgb`, by a degree or a fraction; Mismatch for other amounts."""
    strength = how.value if how is not None and how.kind == "fraction" else strong(USUAL, how)
    if strength > 1:
        return refused("A glow of 100 % is the strongest; say for example 'make the dog glow by 80 %'.")
    return lambda who, when, _: Glow(who, strength, rgb, **when.effect)


def _haloed(light: tuple[Amount | None, Vector | None], rgb: Vector | None = None) -> Value:
    how, own = light
    if own is not None and rgb is not None:
        raise Mismatch
    return glowing(how, own or rgb)
