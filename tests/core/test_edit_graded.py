"""Every quality, direction and amount in one sentence: it comes to that much of that, or is refused; never to anything else."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import pytest

from f4x_core.edit.language import parse
from f4x_core.edit.operation.blur import USUAL as BLUR
from f4x_core.edit.operation.glow import USUAL as GLOW
from f4x_core.edit.operations import Blur, Glow, Grade, Opacity, Operation, Recolour, Retime, Transform
from f4x_core.edit.request import Request
from f4x_core.errors import F4xError

LABELS = ("dog", "cat", "car", "tree")


@dataclass(frozen=True)
class Phrase:
    """An amount in words, and what it comes to."""

    words: str
    more: float | str
    """Factor of so much more, or a degree."""
    less: float | str
    """And of so much less; none is left of 0."""


DEGREES = (Phrase("a bit", "small", "small"), Phrase("slightly", "small", "small"), Phrase("much", "large", "large"))
USUAL = Phrase("", "usual", "usual")
SHARES = (
    Phrase("20 %", 1.2, 0.8),
    Phrase("half", 1.5, 0.5),
    Phrase("a third", 4 / 3, 2 / 3),
    Phrase("150 %", 2.5, -0.5),
)
MULTIPLES = (Phrase("twice", 2.0, 0.5), Phrase("three times", 3.0, 1 / 3))
BEHIND = (
    *(Phrase(f"by {one.words}", one.more, one.less) for one in SHARES),
    Phrase("by a factor of 2", 2.0, 0.5),
    Phrase("by a lot", "large", "large"),
    Phrase("a bit", "small", "small"),
    USUAL,
)


@dataclass(frozen=True)
class Words:
    """Words of a quality, separated by `/`."""

    more: str
    less: str
    much: str
    little: str = ""
    increase: str = ""
    decrease: str = ""
    noun: str = ""
    lack: str = ""


QUALITIES = {
    "brightness": Words(
        "brighter/lighter/less dark", "darker/dimmer/less bright", "bright", "dark", "brighten", "darken", "brightness"
    ),
    "contrast": Words("punchier/more contrasty", "flatter/less contrasty", "contrasty", "flat", noun="contrast"),
    "saturation": Words(
        "more saturated/more colorful/richer/less pale", "less saturated/less vivid/duller/paler", "colorful", "pale",
        "saturate", noun="saturation",
    ),
    "warmth": Words("warmer/less cool", "cooler/colder/less warm", "warm", "cool", "warm up", "cool down", "warmth"),
    "size": Words("bigger/larger/less small", "smaller/less big", "big", "small", "enlarge", "shrink", "size"),
    "speed": Words("faster/quicker/less slow", "slower/less fast", "fast", "slow", "speed up", "slow down", "speed"),
    "opacity": Words(
        "more opaque/more solid/less transparent/less see-through", "more transparent/less opaque/more translucent",
        "opaque", "transparent", noun="opacity", lack="transparency",
    ),
    "blur": Words("blurrier/more blurry/less sharp", "less blurry/sharper", "blurry", noun="blur"),
    "glow": Words("more glowing/more radiant", "less glowing", "radiant", noun="glow"),
}  # fmt: skip
"""Of a stretch of time."""
ALONE = ("blur", "glow")
"""What nothing has by itself, so that there is no less of it."""


def measured(operation: Operation, quality: str) -> float | None:
    """The factor by which an operation changes a quality; None where it changes anything else."""
    if isinstance(operation, Recolour):
        return operation.rgb[0] if quality == "brightness" and operation.mode == "multiply" else None
    if isinstance(operation, Grade):
        graded = {"contrast": operation.contrast, "saturation": operation.saturation, "warmth": 1 + operation.warmth}
        return graded.pop(quality) if quality in graded and graded | {quality: 1} else None
    if isinstance(operation, Opacity):
        return operation.factor if quality == "opacity" else None
    expected = {
        "size": (Transform, "scale", 1.0),
        "speed": (Retime, "speed", 1.0),
        "blur": (Blur, "radius", 1 / BLUR),
        "glow": (Glow, "strength", 1 / GLOW),
    }
    kind, field, unit = expected.get(quality, (type(None), "", 1.0))
    if not isinstance(operation, kind):
        return None
    return 1 / getattr(operation, field) if unit < 0 else getattr(operation, field) * unit


def means(quality: str, upward: bool, amount: float | str) -> bool:
    """Whether there is such a change at all; of others a sentence is refused."""
    if quality in ALONE and not upward:
        return False
    if isinstance(amount, str):
        return True
    if quality == "warmth":
        return abs(amount - 1) <= 1
    if quality == "blur":
        return amount in (2, 3)
    if quality == "glow":
        return amount <= 2
    return amount > 0


def fits(quality: str, upward: bool, amount: float | str, by: float) -> bool:
    """Whether a factor is what an amount means."""
    if (by > 1) is not upward and quality not in ALONE:
        return False
    away = by if upward else 2 - by if quality == "warmth" else 1 / max(by, 1e-9)
    if amount == "small":
        return 0.4 < away < 1.3
    if amount == "large":
        return away >= 1.9
    if amount == "usual":
        return 0.9 < away < 2.1
    assert isinstance(amount, float)
    if quality == "glow" and amount not in (2.0, 3.0):
        return abs(by * GLOW - (amount - 1)) < 0.01  # "30 % glowing" is that strong
    return abs(by - amount) < 0.01


def sentences(quality: str, words: Words) -> Iterator[tuple[str, bool, float | str]]:
    """(sentence, whether more of it, how much)."""

    def much(phrase: Phrase, upward: bool) -> float | str:
        if quality == "warmth" and isinstance(
            phrase.more, float
        ):  # it has no zero: so much cooler is so much less warm
            return phrase.more if upward else 2 - phrase.more
        return phrase.more if upward else phrase.less

    for upward, comparatives in ((True, words.more), (False, words.less)):
        for at, word in enumerate(comparatives.split("/")):
            some = slice(at % 3, None, 3 if at else 1)  # all with the first word; with each other one a third of them
            for phrase in (*DEGREES, USUAL, *SHARES, *MULTIPLES)[some]:
                yield f"make the dog {phrase.words} {word}", upward, much(phrase, upward)
            for phrase in BEHIND[some]:
                shape = ("make the dog {} {}", "the dog {} {}", "the dog should be {} {}")[at % 3]
                yield shape.format(word, phrase.words), upward, much(phrase, upward)
        for verb in filter(None, (words.increase if upward else words.decrease).split("/")):
            for phrase in BEHIND:
                yield f"{verb} the dog {phrase.words}", upward, much(phrase, upward)
            for percents, factor in (("50 %", 0.5), ("150 %", 1.5)) if quality != "warmth" else ():
                yield f"{verb} the dog to {percents}", upward, factor if (factor > 1) is upward else 0.0
        for verb, noun in zip(("increase", "reduce")[:: 1 if upward else -1], (words.noun, words.lack), strict=True):
            for phrase in BEHIND if noun else ():
                yield f"{verb} the {noun} of the dog {phrase.words}", upward, much(phrase, upward)
    for times, factor in (("twice", 2.0), ("three times", 3.0), ("half", 0.5)):
        yield f"make the dog {times} as {words.much}", factor > 1, factor
        if words.little:
            yield (
                f"make the dog {times} as {words.little}",
                factor < 1,
                2 - factor if quality == "warmth" else 1 / factor,
            )


def failing(quality: str, sentences: Iterator[tuple[str, bool, float | str]]) -> tuple[list[str], list[str]]:
    """Sentences that come to something else, and those that are refused and mean something."""
    wrong, unread = [], []
    for sentence, upward, amount in sentences:
        try:
            made = parse(Request(sentence, LABELS, fps=24.0, frames=96))
        except F4xError as refusal:
            assert len(str(refusal)) > 20
            if means(quality, upward, amount):
                unread.append(f"{sentence}: {refusal}")
            continue
        by = measured(made[0], quality) if len(made) == 1 else None
        if by is None or not means(quality, upward, amount) or not fits(quality, upward, amount, by):
            wrong.append(f"{sentence}: {made}")
    return wrong, unread


@pytest.mark.parametrize("quality", QUALITIES)
def test_so_much_more_or_less_of_a_quality(quality):
    wrong, unread = failing(quality, sentences(quality, QUALITIES[quality]))
    assert not wrong, "\n".join(wrong)
    assert not unread, "\n".join(unread)


@pytest.mark.parametrize("quality", [quality for quality in QUALITIES if QUALITIES[quality].little])
def test_things_are_not_measured_against_one_another(quality):
    words = QUALITIES[quality]
    more = words.more.partition("/")[0]
    for compared in (f"as {words.much} as", f"twice as {words.much} as", f"{more} than", f"more {words.little} than"):
        with pytest.raises(F4xError, match="not measured against one another"):
            parse(Request(f"make the dog {compared} the cat", LABELS, fps=24.0, frames=96))
