"""Out of focus."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from ...language.degrees import Amount
from ..change import MAX_SCALE, Change, Span, check_range, check_span
from ..description import span_words, whom
from ..selects import SelectKind
from ..state import Appearance, Placement
from ..values import Value, only_more, refused, strong

if TYPE_CHECKING:
    from ..apply import Looking
    from ..english import Sentences
    from ..plan_lines import Seen

USUAL = 0.02
"""Radius of "blur" in world units, the usual degree of it."""


@dataclass(frozen=True)
class Blur(Change):
    """Out of focus: every Gaussian gets wider and as much fainter."""

    TAG = "blur"
    select: SelectKind
    radius: float = USUAL
    """Standard deviation of the blur in world units."""
    frames: Span | None = None
    """In effect from … to; None = always."""

    def __post_init__(self) -> None:
        check_range("radius", self.radius, MAX_SCALE)
        check_span(self.frames)

    PLACES = LOOKS = True
    lasts = False  # type: ignore[assignment]  # nodes and folded arrays would not carry the sizes alike

    def placed(self, placed: Placement, fraction: float, pivot: Callable[[str], np.ndarray]) -> Placement:
        return placed._replace(scales=np.sqrt(placed.scales**2 + np.float32(self.radius**2)))

    def shown(self, state: Appearance, chosen: np.ndarray, fraction: float, scene: Looking) -> Appearance:
        return state.with_opacities(chosen, state.opacities * thinning(scene.sizes, self.radius))

    def described(self) -> str:
        return f"blur {whom(self.select)} by {self.radius:g} units" + span_words(self.frames)

    def as_seen(self, seen: Seen) -> str:
        depths = seen.camera.project(seen.means)[1]
        depth = np.median(depths[depths > 0]) if (depths > 0).any() else np.inf
        return f"{self.described()} ({self.radius * seen.camera.focal / depth:.1f} pixels where it is)"

    @classmethod
    def sentences(cls) -> Sentences:
        """Return "blurry" as a quality, and the command that puts a blur on a thing."""
        from .. import english as say

        quality = say.Quality(
            only_more(blurred), "blurrier|softer|fuzzier|hazier", "sharper",
            much="blurry|blurred|soft focus|fuzzy|hazy|out of focus|unsharp", little="sharp|in focus",
            noun="blur|blurriness|softness", lack="sharpness", too_little="crisp", bare=True,
        )  # fmt: skip
        put = say.command(
            "put a slight blur on the dog", blurred, "how", verb="!<has_to_go> <light_verb>",
            how="<a_bit> (gaussian|lens|soft|depth|background|motion) [blur|blurring|defocus|bokeh|haze] (effect|filter|on|to)",
        )  # fmt: skip
        blur = say.command(
            "blur the background", blurred, "verb", who=say.whom | say.whose("edge|edges|outline|border|borders"),
            verb="{blur}|anonymous|illegible|unreadable|out of focus|unsharp|blurry|in soft focus|soft focus|fuzzy|less sharp",
            how=say.phrase("(,) <softly>") | say.phrase("(by) <number> [unit|units]") >> _to,
        )  # fmt: skip
        return say.Sentences((put, blur), (quality,), made=(~say.keyword("go|all") + quality.value,))


def thinning(sizes: np.ndarray, radius: float) -> np.ndarray:
    """Return the factors (n,) float32 of opacity for Gaussians of `sizes (n,3)` that a blur widens by `radius`.

    The light that each stops stays the same, seen along its thinnest axis.
    """
    broad = np.sort(sizes.astype(np.float64), axis=1)[:, 1:]
    return (np.prod(broad, 1) / np.prod(np.hypot(broad, radius), 1)).astype(np.float32)


def blurred(how: Amount | None = None) -> Value:
    """Return a blur: the usual one, a degree of it, or one `to` a radius in world units; Mismatch for other amounts."""
    if how is not None and how.kind == "fraction":
        return refused("A blur has no percents; say 'a bit', 'much', or how wide it is, as in 'by 0.03 units'.")
    radius = how.value if how is not None and how.kind == "to" else strong(USUAL, how)
    return lambda who, when, _: Blur(who, radius, **when.effect)


def _to(radius: float) -> Amount:
    return Amount("to", radius)
