"""More or less transparent: hidden, shown again, faded in and out."""

from __future__ import annotations

from dataclasses import dataclass, replace
from operator import attrgetter
from typing import TYPE_CHECKING, Any

import numpy as np

from ...errors import F4xError
from ...language.lexicon import PLACES
from ...language.refusal import Refusal
from ..change import SHOWN, Change, ChangeWithShadow, Ease, Reply, Span, check_range, check_span
from ..description import percent_words, span_words, whom_with
from ..selects import SelectKind
from ..state import Appearance
from ..values import Value, graded

if TYPE_CHECKING:
    from ..apply import Looking
    from ..english import Sentences
    from ..phrases import SentenceContext, When

FADED_DEPTH = 16.0
"""Optical depth, the sum of -log(1 - alpha) along a pixel, of objects in fits of real clips: at this depth a fade is linear."""
MAX_ALPHA = 0.99
"""Maximum opacity that `thinned` reads: an opacity of 1 would never fade."""


@dataclass(frozen=True)
class Opacity(ChangeWithShadow):
    """More or less transparent."""

    TAG = "opacity"
    select: SelectKind
    factor: float
    """Opacity is multiplied by it and held in [0, 1]; 0 hides, `SHOWN` shows again what is hidden or thinner than fitted."""
    frames: Span | None = None
    """In effect from … to; None = always."""
    ease: Ease | None = None
    """None: in full, from the first frame to the last alone. Else it comes between the two, as in `Transform`, and stays."""
    inward: bool = False
    """With `ease`: it is there from the start and goes between the two."""

    def __post_init__(self) -> None:
        check_range("factor", self.factor, 10)
        check_span(self.frames)
        if self.inward and self.ease is None:
            raise F4xError("inward needs an ease; give one, or leave inward out.")

    LOOKS = UNCOVERS = True

    def fraction(self, time: float, last: float) -> float:
        fraction = super().fraction(time, last)
        return 1 - fraction if self.inward else fraction

    def shown(self, state: Appearance, chosen: np.ndarray, fraction: float, scene: Looking) -> Appearance:
        """Fade linearly in alpha; `SHOWN` brings back the fitted opacity where less is left."""
        old = state.opacities
        if self.factor == SHOWN:
            fitted = np.where(scene.gone, old, np.maximum(old, scene.opacities))
            return state.with_opacities(chosen, old + np.float32(fraction) * (fitted - old))
        if self.factor < 1 and 0 < fraction < 1:  # on the way from all to the factor
            gone = np.float32(1 - self.factor)
            new = old * (1 - gone) + gone * thinned(old, 1 - fraction)
        else:
            new = np.clip(old * np.float32(1 + fraction * (self.factor - 1)), 0, 1)
        if self.factor > 1:  # nothing times a factor is nothing: what was hidden comes back as it was
            new = np.where((old == 0) & ~scene.gone, np.float32(fraction) * scene.opacities, new)
        return state.with_opacities(chosen, new)

    @property
    def hides(self) -> bool:
        return not self.factor

    @property
    def brings_back(self) -> bool:
        return self.factor > 1

    def followed_by(self, later: Change) -> tuple[Change, ...]:
        """Return the first of "hide it for a second, then it is back"; of "start invisible and fade in" the fade."""
        if isinstance(later, Opacity) and later.select == self.select:
            if later == Opacity(self.select, SHOWN) and self.frames and self.frames[1]:
                return (self,)
            if later.frames and not self.frames:
                return (later,)
        return super().followed_by(later)

    def described(self) -> str:
        who, factor = whom_with(self), self.factor
        if factor == SHOWN:
            sentence = f"show {who} again"
        elif factor > 1:
            sentence = f"increase the opacity of {who} by {percent_words(factor - 1)}"
        elif self.ease:
            away = f"fade {'in' if self.inward else 'out'} {who}"
            eased = "" if self.ease == "linear" else f" ({self.ease})"
            faded = f"fade {who} to {percent_words(factor)}" if factor else away
            return faded + span_words(self.frames, "to the end") + eased
        else:
            sentence = f"give {who} {percent_words(factor)} opacity" if factor else f"hide {who}"
        return sentence + span_words(self.frames)

    @classmethod
    def replies(cls) -> tuple[Reply, ...]:

        def make(answer: Any, who: SelectKind, _: Any) -> Opacity:
            return cls(who, answer.percent / 100, answer.span)

        doc = "Transparent: 0 hides, 100 is as before."
        return (Reply(("opacity",), doc, make, {"percent": range(101)}, "OpacityChange"),)

    @classmethod
    def sentences(cls) -> Sentences:
        from .. import english as say

        quality = say.Quality(
            graded(opacity, attrgetter("opacity")), more="", less="", much="opaque|solid|visible",
            little="transparent|see through|translucent|sheer", noun="opacity|visibility|alpha", lack="transparency|translucency",
            too_little="faint", bare=False,
        )  # fmt: skip
        noun = say.keyword(quality.noun)
        made = say.either(
            say.table(_OPAQUE),
            say.table({"semi|partly|partially": 0.5, "mostly|almost|nearly": 0.2, "completely|fully|totally|entirely": 0.0})
            + say.keyword(quality.little),
            say.phrase("(like|about|roughly|only|just|say) (a|an|the|some) [<percent>|<fraction>] [opaque|"
                       "visible|<noun>]", noun=noun),
        ) >> opacity  # fmt: skip
        made = say.phrase("(at|to|with) [<made>|<value>]", made=made, value=quality.value)
        slow = "((a|some) (slow|gentle|soft|quick|smooth|nice|long|short|gradual))"
        again = say.literal("again|once more|back|back again|back in")
        hide = say.command(
            "hide the car from second 1 on", say.always(opacity(0.0)), "verb", say.NAMED,
            say.whom | say.about + say.whose("visibility|display"),
            verb="{hide}|away|go away|goes away|off|invisible|hidden|out of sight|do not show|not (to) (be) [visible|shown|seen]|"
            "[nobody|no one|none] (should|must|can|may|shall) [see|sees|notice|notices]",
        )  # fmt: skip
        show = say.command(
            "show the dog again", shown, "verb", say.NAMED, say.about + say.thing, verb="{show}", again=again >> (lambda: True)
        )  # fmt: skip
        back = say.command(
            "bring the dog back", say.always(opacity(SHOWN)), "verb back", verb="{=bring/come/be}", back=again
        )
        sides = {
            "in|up|into view|in from nothing|in from black": True,
            "out|away|from view|to nothing|to zero|into nothing|completely": False,
        }
        fade_out = say.command(
            "fade out the dog", faded, "verb", say.TIMED, verb=f"{slow} [{{vanish}}]",
            inward=say.unless(say.silent(say.span)) + say.table(sides, reserve=False),  # "faded out in the last second"
            by="to [<percent>|<fraction>]",
        )  # fmt: skip
        fade_in = say.command(
            "fade in the dog from second 1 to 2", say.always(appearing), "verb", say.TIMED, verb=f"{slow} [{{appear}}]"
        )
        return say.Sentences((hide, show, back, fade_out, fade_in), (quality,), (made,))


def thinned(opacities: np.ndarray, left: float) -> np.ndarray:
    """Return opacities (n,) with which a stack of splats shows the fraction `left` in [0, 1] of its alpha.

    `1 - (1 - o)^k` scales the optical depth D of a pixel by k; its alpha 1 - exp(-k D) is to be `left` (1 - exp(-D)). Scaling
    the opacities themselves would leave a stack of many nearly opaque half-way.
    """
    depth = -np.log1p(-left * -np.expm1(-FADED_DEPTH)) / FADED_DEPTH
    return (1 - (1 - np.minimum(opacities, MAX_ALPHA)) ** depth).astype(np.float32)


_OPAQUE = {
    "[barely|hardly|scarcely|just about|only just|faintly] [visible|seen|there|to be seen]|(very) faint|[almost|nearly|next to|"
    "all but|close to] [invisible|transparent|gone|vanished]": 0.2,
    "(completely|totally|fully) invisible|(completely|totally) hidden|unseen|not visible|vanish|vanished|"
    "disappear|disappeared": 0.0,
    "(completely|fully|totally) opaque|(completely|fully) visible (again)|opaque (again)|(completely|fully) solid again|"
    "reappear": SHOWN,
}
"""Words for how opaque something is."""


def opacity(by: float) -> Value:
    """Return an opacity `by` times as large, gradually where the sentence says so."""

    def value(who: SelectKind, when: When, context: SentenceContext) -> Change:
        if when.slowly:
            return faded(by)(who, when, context)
        return Opacity(who, round(by, PLACES), **when.effect)

    return value


def shown(again: bool = False) -> Value:
    """Return the opacity that shows a thing, again; Refusal for a time that may be the only one."""

    def value(who: SelectKind, when: When, context: SentenceContext) -> Change:
        if when.frames is not None and not again:
            raise Refusal(
                "'Show' with a time can be meant in two ways; say for example 'hide the dog until second 2', or 'show the dog again"
                " from second 2'."
            )
        return Opacity(who, SHOWN, **when.effect)

    return value


def faded(by: float = 0.0, inward: bool = False, gone: bool = False) -> Value:
    """Return a gradual change to `by` times the opacity, or from it with `inward`; `gone`: to the end of the clip."""

    def value(who: SelectKind, when: When, context: SentenceContext) -> Change:
        when = replace(when, slowly=when.slowly or gone)
        fading = when.fading(context, inward)
        if when.slowly and when.frames is None:
            fading = {"frames": (0.0, None), "ease": "linear"}
        if (when.slowly or inward) and "ease" not in fading:
            raise Refusal("It is not said from when to when it fades; add for example 'from second 1 to 2'.")
        return Opacity(who, round(by, PLACES), **fading, inward=inward)

    return value


def appearing(who: SelectKind, when: When, context: SentenceContext) -> Change:
    """Return a fade in; at a moment, the thing is hidden until then."""
    if (
        when.kind == "moment"
        and when.frames is not None
        and when.frames[0] > 0
        and when.edge is None
        and not when.slowly
    ):
        return Opacity(who, 0.0, frames=(0.0, when.frames[0]))
    return faded(0.0, inward=True)(who, when, context)
