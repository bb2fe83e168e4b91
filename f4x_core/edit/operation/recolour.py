"""Another color, or more and less of one."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from ...errors import F4xError
from ...language.colour_names import COLOURS
from ...language.lexicon import PLACES
from .. import colours
from ..change import Change, Ease, Reply, Span, Vector, check_range, check_span
from ..description import colour_words, number_words, percent_words, strength_words, times_words, whom
from ..selects import SelectKind
from ..state import Appearance
from ._color import Dye

if TYPE_CHECKING:
    pass

BLACK_AND_WHITE = (0.5, 0.5, 0.5)
"""As `hue`: no colour is left, light and dark stay."""
A_BIT = 0.5
"""Strength of a tint."""
MORE_COLOUR = 0.3
"""How far "redder" goes from gray to red."""
_BASIC = ("red", "green", "blue", "yellow", "orange", "purple", "pink", "cyan", "brown", "white", "black")


@dataclass(frozen=True)
class Recolour(Dye):
    """Another colour."""

    TAG = "recolour"
    select: SelectKind
    rgb: Vector
    """sRGB in [0, 1]; for `add` -1 to 1, for `multiply` 0 to 10."""
    mode: Literal["assign", "add", "multiply", "hue"] = "assign"
    """`assign` the colour; `add` it; `multiply` by it; take its `hue` and saturation and leave light and dark."""
    strength: float = 1.0
    keep_luminance: bool = False
    """With `assign`: shading and texture stay, brightened or darkened so that their mean is the colour's."""
    frames: Span | None = None
    ease: Ease | None = None

    def __post_init__(self) -> None:
        """Validate."""
        low, high = {"add": (-1, 1), "multiply": (0, 10)}.get(self.mode, (0, 1))
        if not all(low <= value <= high for value in self.rgb):
            raise F4xError(f"rgb is {list(self.rgb)}; for {self.mode} give three numbers from {low} to {high}.")
        check_range("strength", self.strength)
        check_span(self.frames)

    @property
    def has_tones(self) -> bool:
        """Where the mean light is kept."""
        return self.keep_luminance

    def goal(self, rgb: np.ndarray, whom: Appearance, tones: Any) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """By mode."""
        target = np.array(self.rgb)
        if self.mode == "multiply":
            rest = (whom.sh[:, 1:] * (1 + self.strength * (target - 1))).astype(np.float32)
            return rgb * self.rgb, rest, whom.opacities
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
        """Brighter, more blue, black and white."""
        return self.mode in ("multiply", "add") or (self.mode, self.rgb) == ("hue", BLACK_AND_WHITE)

    @property
    def aspect(self) -> tuple[Any, ...]:
        """Less green and more yellow are two."""
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
        """Of "red until second 1, then blue" the later one begins where this one ends."""
        if isinstance(later, Recolour) and (later.select, later.mode) == (self.select, self.mode):
            if later.frames is None and self.frames is not None and self.frames[1] is not None:
                later = replace(later, frames=(self.frames[1], None))
        return super().followed_by(later)

    def described(self) -> str:
        """By mode."""
        who, rgb, strong = whom(self.select), self.rgb, strength_words(self.strength)
        if self.mode == "hue" and set(rgb) == {0.5}:
            sentence = f"make {who} {strong}black and white"
        elif self.mode == "hue":
            sentence = f"shift the hue of {who} {strong}to {colour_words(rgb)}"
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
        """A color, or how bright."""
        byte = range(256)

        def painted(answer: Any, who: SelectKind, _: Any) -> Recolour:
            rgb = (answer.red / 255, answer.green / 255, answer.blue / 255)
            mode: Literal["hue", "assign"] = "hue" if answer.mode == "hue" else "assign"
            return Recolour(who, rgb, mode, answer.strength / 100, answer.mode == "paint", answer.span)

        def brightened(answer: Any, who: SelectKind, _: Any) -> Recolour:
            return Recolour(who, (answer.percent / 100,) * 3, "multiply", frames=answer.span)

        doc = "Another colour; `paint` keeps light and dark, `flat` does not, `hue` turns the hue alone."
        bytes_ = {"red": byte, "green": byte, "blue": byte}
        mixed = {**bytes_, "mode": ("paint", "flat", "hue"), "strength": range(101)}
        return (
            Reply(("paint",), doc, painted, mixed, "Paint"),
            Reply(
                ("brightness",),
                "Brighter or darker: 100 is as before.",
                brightened,
                {"percent": range(1001)},
                "Brightness",
            ),
        )


def _more(rgb: Vector) -> str:
    """ "30 % more red" for what it adds; nothing when it is no basic colour."""
    for word, sign in (("more", 1), ("less", -1)):
        for name in _BASIC:
            pure = [sign * (c - 0.5) for c in COLOURS[name]]
            share = round(max(map(abs, rgb)) / max(map(abs, pure)), PLACES)
            if rgb == tuple(round(share * c, PLACES) for c in pure):
                return f"{percent_words(share)} {word} {name}"
    return ""
