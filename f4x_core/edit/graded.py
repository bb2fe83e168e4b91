"""The qualities that there is more or less of: one row for each, with all its words and what they do.

A row says of what and which way, `language.amounts` how much, `making` what comes of both: so each word, direction and amount go
together wherever one of the phrases below stands.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from operator import attrgetter

from ..language.amounts import amount, comparison, fraction_of, softly
from ..language.degrees import Amount
from ..language.grammar import Rule, either, keyword, optional
from ..language.refusal import Mismatch
from . import making
from .making import Graded, Value


@dataclass(frozen=True)
class Quality:
    """Something that there is more or less of. Words are alternatives with `|`."""

    changed: Graded
    """What is done for so much more or less of it."""
    more: str
    """"brighter"."""
    less: str
    """"darker"."""
    much: str
    """"bright", which also stands behind "more", "less", "as", "too" and "not"."""
    little: str
    """"dark", likewise."""
    noun: str
    """"brightness"."""
    lack: str = ""
    """"darkness"."""
    up: str = ""
    """Sense of `language.verbs` of making more of it."""
    down: str = ""
    """And less."""
    excess: str = ""
    """What it is where there is too much of it: "overexposed"."""
    dearth: str = ""
    """And too little: "murky"."""
    too: str = ""
    """More words behind "too": "shiny"."""
    too_little: str = ""
    """And for too little: "shadowy"."""
    bare: bool | None = None
    """`much`, or else `little`, says by itself that it gets so: "a bit blurry", "30 % transparent"."""

    @property
    def value(self) -> Rule:
        """What is done: "brighter by a third", "twice as bright", "half the brightness"."""
        compared = comparison(self.changed, self.more, self.less, self.much, self.little)
        rules = [compared, fraction_of(self.noun) >> self.times]
        if self.bare is not None:
            word, how = keyword(self.much if self.bare else self.little), softly | amount
            rules += [rule >> self._becomes for rule in (optional(how) + word, word + how)]
        return either(*rules)

    def _becomes(self, how: Amount | None) -> Value:
        return self.changed(how, bool(self.bare))

    def times(self, by: float) -> Value:
        """What is done for so many times as much of it."""
        if by == 1:
            raise Mismatch  # "in full color" asks for no more or less of it
        return self.changed(Amount("as", by), True)

    def complaints(self) -> Iterator[tuple[str, str, bool]]:
        """Words behind "too", those that complain by themselves, and whether more of it helps."""
        nouns = self.noun.split("|")
        yield "|".join((self.much, self.too, *(f"much {noun}" for noun in nouns))), self.excess, False
        yield "|".join((self.little, self.too_little, *(f"little {noun}" for noun in nouns))), self.dearth, True

    def helps(self, upward: bool) -> Value | None:
        """What is done for more or less of it; None where that cannot be."""
        try:
            return self.changed(None, upward)
        except Mismatch:
            return None


BRIGHTNESS = Quality(
    making.graded(making.brightened),
    more="brighter|lighter",
    less="darker|dimmer|gloomier",
    much="bright|light",
    little="dark|dim",
    noun="brightness|light|lights|lighting|illumination|luminance|exposure|lightness|luminosity|glare|gain",
    lack="darkness",
    up="brighten",
    down="darken",
    excess="overexposed|blown out|glaring",
    dearth="underexposed|murky|gloomy|dim",
    too="shiny",
    too_little="black|shadowy",
)
GAMMA = Quality(making.graded(making.gamma, gone=False), more="", less="", much="", little="", noun="gamma")
CONTRAST = Quality(
    making.graded(making.contrasted),
    more="punchier|crisper",
    less="flatter",
    much="contrasty|contrastful|punchy|contrasted",
    little="flat",
    noun="contrast",
    lack="flatness",
    too="harsh|hard|contrast",
)
SATURATION = Quality(
    making.graded(making.saturated),
    more="richer|livelier",
    less="duller|paler",
    much="saturated|vivid|colorful|vibrant|intense|rich|lively|colored",
    little="desaturated|muted|dull|washed out|pale|faded",
    noun="saturation|sat|color saturation|color intensity|vibrance|vividness|colorfulness|chroma|color|colors",
    lack="dullness|paleness",
    up="saturate",
    down="mute",
    excess="oversaturated|garish|gaudy",
    dearth="washed out|faded|lifeless|bland|dull|drab",
    too="strong",
)
WARMTH = Quality(
    making.warmed,
    more="warmer|cozier|cosier",
    less="cooler|colder|chillier",
    much="warm|cozy|cosy",
    little="cool|cold|chilly",
    noun="warmth|color temperature|temperature",
    lack="coldness|coolness",
    up="warm",
    down="cool",
    too="yellow|orange",
    too_little="blue|bluish",
)
SIZE = Quality(
    making.graded(making.scaled, gone=False),
    more="bigger|larger|huger",
    less="smaller|tinier",
    much="big|large|huge|tall|high|wide",
    little="small|tiny|little|short",
    noun="size|scale|dimensions",
    up="enlarge",
    down="shrink",
    too="long",
)
SPEED = Quality(
    making.graded(making.retimed, gone=False),
    more="faster|quicker|swifter|speedier",
    less="slower",
    much="fast|quick|quickly|speedy",
    little="slow|slowly",
    noun="speed|pace|tempo|playback speed|playback rate|velocity",
    lack="slowness",
    up="quicken",
    down="slow",
    too="hectic|rapid",
    too_little="sluggish",
)
OPACITY = Quality(
    making.graded(making.opacity, attrgetter("opacity")),
    more="",
    less="",
    much="opaque|solid|visible",
    little="transparent|see through|translucent|sheer",
    noun="opacity|visibility|alpha",
    lack="transparency|translucency",
    too_little="faint",
    bare=False,
)
BLUR = Quality(
    making.only_more(making.blurred),
    more="blurrier|softer|fuzzier|hazier",
    less="sharper",
    much="blurry|blurred|soft focus|fuzzy|hazy|out of focus|unsharp",
    little="sharp|in focus",
    noun="blur|blurriness|softness",
    lack="sharpness",
    too_little="crisp",
    bare=True,
)
GLOW = Quality(
    making.only_more(making.glowing),
    more="glowier",
    less="",
    much="glowing|glowy|luminous|aglow|radiant|shining|shimmering|glow",
    little="",
    noun="glow|halo",
)
QUALITIES = (BRIGHTNESS, GAMMA, CONTRAST, SATURATION, WARMTH, BLUR, GLOW, SIZE, SPEED, OPACITY)
"""What things are more or less of."""
