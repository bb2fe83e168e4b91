"""A look from a table, such as a material or a mood."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from ...errors import F4xError
from .. import colours
from ..change import Ease, Reply, Span, check_range, check_span
from ..description import strength_words, whom
from ..records import near
from ..selects import SelectKind
from ..state import Appearance
from ..styles import STYLES
from ..values import Value
from ._color import Dye

if TYPE_CHECKING:
    from ..english import Sentences

PICTURE_LOOKS = ("night", "sunset", "sepia", "autumn", "neon")
"""Looks of a whole picture."""


@dataclass(frozen=True)
class Style(Dye):
    """A look from a table: light and dark become a ramp of colours."""

    TAG = "style"
    select: SelectKind
    look: str
    """Name of an entry of `styles.STYLES`."""
    strength: float = 1.0
    frames: Span | None = None
    ease: Ease | None = None

    def __post_init__(self) -> None:
        if self.look not in STYLES:
            raise F4xError(f"there is no look {self.look!r}{near(self.look, STYLES)}; known: {', '.join(STYLES)}.")
        check_range("strength", self.strength)
        check_span(self.frames)

    has_tones = is_covered = True  # type: ignore[assignment]  # for every look

    def tones(self, whom: Appearance, other: Appearance | None) -> Any:
        """Return the centre and range of the lightness of the visible Gaussians."""
        rgb, visible = colours.colours_of(whom.sh), whom.opacities > 0
        return colours.lights_of(rgb[visible] if visible.any() else rgb)

    def goal(self, rgb: np.ndarray, whom: Appearance, tones: Any) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        look = STYLES[self.look]
        opacities = whom.opacities * np.float32(1 + self.strength * (look.opacity - 1))
        return colours.styled(rgb, look, *tones), self.faded(whom), opacities

    @property
    def of_picture(self) -> bool:
        return self.look in PICTURE_LOOKS

    def described(self) -> str:
        return self.coming(f"make {whom(self.select)} look {strength_words(self.strength)}like {self.look}")

    @classmethod
    def replies(cls) -> tuple[Reply, ...]:

        def make(answer: Any, who: SelectKind, _: Any) -> Style:
            return cls(who, answer.look, answer.strength / 100, answer.span)

        fields = {"look": tuple(STYLES), "strength": range(101)}
        return (Reply(("style",), "A look from the table.", make, fields, "Look"),)

    @classmethod
    def sentences(cls) -> Sentences:
        from .. import english as say

        name = say.table(
            {f"{look}|{look}s": look for look in STYLES}
            | {"flames|flame": "fire", "the night|night time|nighttime|moonlight": "night"},
            reserve=False,
        )
        adjective = say.table(ADJECTIVES, reserve=False)
        rules = {"name": name, "adjective": adjective, "look": name | adjective}
        rules["strongly"] = say.optional(say.at_most_all, 1.0)
        made = "([it is|they are|it was|it were|they were] ([made|carved|built|cast|cut|formed]) (out) ([of|from|in])|"
        made += "[made|carved|cast] (out) [of|from]|(shot|filmed|taken|recorded|set) [at|in|during] (the))"
        like = "[like ([it|he|she] [is|was|were]|they [are|were]|at)|as [if|though] [it|they] [were|is|was|are]|similar to]"
        a_look = say.either(
            say.phrase(f"({say.SEEM}) <strongly> {like} {made} (a|an|pure|solid|real) <look>", **rules),
            say.constant(1.0)
            + say.phrase(
                "[(made|built|carved|cast) (out) of|in the style of|into|in] (a|an|pure|solid) <name> (<.effect>)",
                **rules,
            ),
            say.constant(1.0) + say.phrase("[in|into|with] (a|an|the|some) <look> <effect>", **rules),
            say.phrase(f"({say.SEEM}) <strongly> <adjective>", **rules),
        ) >> (lambda strength, look: styled(look, strength))
        in_scene = say.table(PICTURES | {look: look for look in PICTURE_LOOKS}, reserve=False)
        given = say.either(
            say.phrase("(a|an|the|some) <look> (like|colored) <effect>", **rules),
        )  # fmt: skip
        alone = say.either(
            say.toward + say.phrase("(pure|solid) <look> (<effect>)", **rules),
            say.phrase(f"(in|with) ({say.REAL}) <look> <effect>", **rules),
            say.phrase("((in|into|to|with) (the|a|an|some|that|this)) <look> (<effect>)", **rules | {"look": in_scene}),
        )  # fmt: skip
        return say.Sentences(made=(a_look,), alone=(alone >> styled,), given=(given >> styled,))


ADJECTIVES = {
    "golden": "gold", "silvery": "silver", "coppery": "copper", "icy|frozen over": "ice", "molten": "lava", "neon": "neon",
    "fiery|flaming|burning|on fire|ablaze|in flames": "fire", "chrome|chromed|silver plated": "silver",
    "gilded|gold plated": "gold", "nighttime|night time": "night", "grassy": "grass", "chocolatey|chocolaty": "chocolate",
    "autumnal|autumn like|in autumn colors|autumn colored": "autumn", "ghostly|ghostlike": "ghost", "marbled": "marble",
    "sepia|sepia toned|(old) [brown|brownish|yellowed] [photograph|photo|picture]": "sepia",
}  # fmt: skip
"""Words for looks -> the look."""
PICTURES = {
    "night time|nighttime|day for night": "night", "golden hour|magic hour|dusk|sundown": "sunset",
    "sepia toned|sepia tone": "sepia",
}  # fmt: skip
"""Words for looks of a whole picture."""


def styled(look: str, strength: float = 1.0) -> Value:
    """Return a look such as a material or a light."""
    return lambda who, when, _: Style(who, look, strength, **when.coming)
