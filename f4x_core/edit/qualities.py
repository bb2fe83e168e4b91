"""What becomes of a thing, as sentences say it: the phrases behind "make the dog …"."""

from __future__ import annotations

from ..language.amounts import amount, degree, fraction, fraction_of, multiple, number, percent, softly
from ..language.colours import colour, colourish, more_colour
from ..language.degrees import DEGREES, factor
from ..language.grammar import constant, either, generated, here, keyword, literal, optional, silent, table, unless
from ..language.lexicon import FUNCTION_WORDS
from ..language.refusal import Mismatch
from . import making
from .graded import BLUR, BRIGHTNESS, CONTRAST, GLOW, OPACITY, QUALITIES, SATURATION, SPEED, WARMTH
from .operations import SHOWN
from .phrases import known_thing
from .styles import STYLES

_small = degree >> (lambda how: min(1.0, DEGREES[how.kind].share))


def _below_all(x: float) -> float:
    """A share of something; Mismatch for more than all of it."""
    if x > 1:
        raise Mismatch
    return x


_partly = degree >> (lambda how: _below_all(DEGREES[how.kind].share))
_share = percent >> _below_all
_article = ~keyword("a|an|the|some")
shade_of = ~keyword(
    "(nice|lovely|bright|strong|warm|cool) [shade|tone|tint|hue] of|any [shade|tone] of|nice|lovely|beautiful|pretty|"
    "kind of|really|very|warm|cool|soft|rich|strong|plain"
) + ~literal(
    "vivid|fluorescent|shiny|glossy|matte|metallic|intense|gorgeous|fresh|proper|real|true|good old|super|bold|juicy|loud|"
    "screaming|striking|deep and rich|electric|luminous|total|totally|all|autumn|fire|fire engine|blood|cherry|ice|icy|baby|"
    "grass|lemon|canary|candy|coal|jet|snow|brick|emerald|ruby|ocean|cobalt|rose|bottle|mustard|strawberry|burnt|crimson|cute"
)
_shade_of = shade_of + ~(keyword("from") + silent(colour) + ~keyword("to|into"))
_fully = ~keyword("all|completely|fully|entirely|totally|wholly")
colored = ~keyword("(in) color|colored|tone") + unless(keyword("tint|filter"))
colored_noun = literal("color|paint|tint|tinge|touch|shade|hue|tone|glow|light|halo|shimmer|cast|wash|coat|aura|shine")
_flat = keyword("solid|flat|plain|pure|uniform|unshaded|uniformly|flatly")
colour_value = either(
    _article + _flat + ~_flat + colour + colored >> making.recoloured,
    (_partly | keyword("faintly|kind of") >> (lambda: making.A_BIT)) + (colour | colourish)
    >> (lambda share, rgb: making.assigned(rgb, share)),
    ~keyword("a|an|some") + colourish + colored >> making.faintly,
    _share + colour >> (lambda share, rgb: making.assigned(rgb, share)),
    _fully + ~keyword("a|an|some") + _shade_of + ~keyword("the color") + colour + colored >> making.assigned,
)
how_much_colour = either(
    degree >> (lambda how: DEGREES[how.kind].share),
    ~keyword("by") + (percent | fraction) >> (lambda x: x / making.MORE_COLOUR),
)
more_colour_value = either(
    more_colour + how_much_colour >> (lambda more, times: making.added(times, more)),
    optional(how_much_colour, 1.0) + more_colour >> making.added,
)
without_colour = ~literal("a|an|the") + optional(_share, 1.0) + keyword(
    "black and white|black white|b and w|b / w|monochrome|monochromatic|(a) grayscale|"
    "gray scale|colorless|desaturated|without (any|its|all) color|without colors"
) + ~literal("look|filter|effect|video|clip|film|movie|version|picture|image|grade|treatment|footage") >> (
    lambda share: making.hued(making.BLACK_AND_WHITE, share)
)
compared = either(*(quality.value for quality in QUALITIES if quality.bare is None))
"""Brighter, twice as big, half the contrast."""
pop = keyword(
    "pop|pop more|pop out|stand out|stand out more|come alive|(more|really) vivid|(very) saturated|(very) colorful|vibrant"
) + unless(known_thing) >> (lambda: making.saturated(factor(None, True)))
sized = either(
    ~keyword("very|really|quite")
    + here(
        lambda reading, at: (
            reading.words[at - 1 : at + 1] != ["a", "little"] and reading.word(at - 1) not in ("as", "so")
        )
    )
    + table(
        {
            "tiny|small|little|minute|miniature|teeny tiny|teeny weeny|teeny|itty bitty|tiny weeny": 0.5,
            "huge|giant|enormous|gigantic|big|large|massive": 2.0,
        }
    )
    >> making.scaled
)
_glowing, _how_strong = keyword(GLOW.much), softly | amount
_in_a_colour = ~keyword("in") + optional(colour)
_glow_value = either(
    optional(_how_strong) + _glowing + _in_a_colour >> making.glowing,
    _glowing + _how_strong + _in_a_colour >> making.glowing,
    GLOW.value,
)
slow_motion = keyword("(on|in|at|a|into|in a) [slow mo|slowmo|slo mo|slomo|slow motion|slow mode|bullet time]")
_paced = either(
    fraction_of("speed|pace|tempo|rate|velocity"),
    ~keyword("a") + multiple,
)
pace = either(
    SPEED.value,
    ~keyword("with") + slow_motion >> (lambda: making.retimed(0.5)),
    ~keyword("at|to|with") + fraction_of("speed|pace|tempo|rate") >> making.retimed,
    keyword("at|in|to") + _paced >> making.retimed,
)
backward = keyword(
    "backward ([in|through] time)|back in time|in reverse|reversed|in the opposite direction|back to front|from the end to "
    "the start|in reverse order|(the) other way around|from back to front|from end to start"
) >> (lambda: making.reversed)


def as_fraction(x: float) -> float:
    """A fraction, or percents that are said without their sign; Mismatch for neither."""
    if x > 100:
        raise Mismatch
    return x if x <= 1 else x / 100


_share_of_all = percent | fraction | number >> as_fraction
_as_opaque = either(
    table(
        {
            "[barely|hardly|scarcely|just about|only just|faintly] [visible|seen|there|to be seen]|(very) faint|"
            "[almost|nearly|next to|all but|close to] [invisible|transparent|gone|vanished]": 0.2,
            "(completely|totally|fully) invisible|(completely|totally) hidden|unseen|not visible|vanish|vanished|disappear|"
            "disappeared": 0.0,
            "(completely|fully|totally) opaque|(completely|fully) visible (again)|opaque (again)|(completely|fully) solid again|"
            "reappear": SHOWN,
        }
    ),
    table({"semi|partly|partially": 0.5, "mostly|almost|nearly": 0.2, "completely|fully|totally|entirely": 0.0})
    + keyword(OPACITY.little),
    ~literal("like|about|roughly|only|just|say")
    + _article
    + (percent | fraction)
    + keyword("opaque|visible|" + OPACITY.noun),
    literal("see through|transparent|translucent")
    + ~literal(",|like|about|say|so")
    + percent
    + keyword("visible|opacity|opaque"),
    ~keyword("an|a") + keyword(OPACITY.noun) + ~literal("of|to|at|=|is|down to") + _share_of_all,
    (percent | fraction) + keyword(OPACITY.lack) >> (lambda x: 1 - x),
    ~keyword("a") + keyword(OPACITY.lack) + ~literal("of|to|at|=|is") + _share_of_all >> (lambda x: 1 - x),
)
opacity_value = ~keyword("at|to|with") + (_as_opaque >> making.opacity | OPACITY.value)
upside_down = keyword("upside down|head over heels") | literal(
    "[on|onto] (to) (the|its|his|her|their) [head|roof|back]|belly up"
)
on_its_side = literal("[on|onto] (to) (the|its|his|her|their) side")
look_name = table(
    {f"{look}|{look}s": look for look in STYLES}
    | {"flames|flame": "fire", "the night|night time|nighttime|moonlight": "night"},
    reserve=False,
)
_MAX_DESCRIBING = 2
_look_adjective = table(
    {
        "golden": "gold",
        "silvery": "silver",
        "coppery": "copper",
        "icy|frozen over": "ice",
        "fiery|flaming|burning|on fire|ablaze|in flames": "fire",
        "molten": "lava",
        "chrome|chromed|silver plated": "silver",
        "gilded|gold plated": "gold",
        "nighttime|night time": "night",
        "autumnal|autumn like|in autumn colors|autumn colored": "autumn",
        "grassy": "grass",
        "chocolatey|chocolaty": "chocolate",
        "ghostly|ghostlike": "ghost",
        "marbled": "marble",
        "sepia|sepia toned|(old) [brown|brownish|yellowed] [photograph|photo|picture]": "sepia",
        "neon": "neon",
    },
    reserve=False,
)
any_look = look_name | _look_adjective
effect = keyword(
    "colors|palette|look|style|effect|filter|appearance|finish|feel|vibe|vibes|mood|tone|tones|light|coloring|treatment|"
    "feeling|grade"
) | literal("statue|sculpture|figurine|atmosphere|version|theme|aesthetic|paint|coat")
scene_look = table(
    {look: look for look in making.PICTURE_LOOKS}
    | {
        "night time|nighttime": "night",
        "day for night": "night",
        "golden hour|magic hour": "sunset",
        "sepia toned|sepia tone": "sepia",
        "dusk|sundown": "sunset",
    },
    reserve=False,
)
"""Looks of a whole picture."""
described = ~silent(
    generated(
        lambda reading, at: (
            (end, None)
            for end in range(at + 1, at + _MAX_DESCRIBING + 1)
            if all(reading.word(i).isalpha() and reading.word(i) not in FUNCTION_WORDS for i in range(at, end))
        )
    )
)
"""Adjectives before the name of a look, which says it all: "old photo sepia"."""
liveliness = literal(
    "[some|a little|(a) bit|a touch|extra] (of|more) [life|punch|pop|oomph|vibrancy|zing|pizzazz|kick]|oomph|zing|life|pep|"
    "pizzazz|(a) (little) pop of color|more color|some color"
) >> (lambda: making.saturated(factor(None, True)))
_strongly = optional(_small | _share, 1.0)
_seem = ~keyword("look|looking|looks|looked|appear|seem|feel")
_new_thing = literal("a|an|some")
a_look = either(
    _seem
    + _strongly
    + keyword(
        "like ([it|he|she] [is|was|were]|they [are|were]|at)|as [if|though] [it|they] [were|is|was|are]|similar to"
    )
    + ~keyword(
        "[it is|they are|it was|it were|they were] ([made|carved|built|cast|cut|formed]) (out) ([of|from|in])|[made|carved|"
        "cast|cut] (out) [of|from]|(shot|filmed|taken|recorded|set) [at|in|during] (the)"
    )
    + ~keyword("a|an|pure|solid|real")
    + (look_name | _look_adjective),
    constant(1.0)
    + keyword("[(made|built|carved|cast) (out) of|in the style of|into|in] (a|an|pure|solid)")
    + look_name
    + ~effect,
    constant(1.0) + keyword("[in|into|with] (a|an|the|some)") + any_look + effect,
    _seem + _strongly + _look_adjective,
) >> (lambda strength, look: making.styled(look, strength))
bare_look = ~literal(
    "(take|taking|takes) place at|(happen|happens|happening|set|shot|filmed|recorded) [at|during|in]|at|during|in the "
    "(middle of the)|by"
) + (table({"night|night time|nighttime": "night", "sunset|sundown|dusk": "sunset"}, reserve=False) >> making.styled)
given_look = literal("[the|a] [texture|look|appearance|finish|surface|feel|sheen] of (a|an|pure|solid|real)") + (
    any_look >> making.styled
) | (_article + (any_look | literal("frozen") >> (lambda: "ice")) + ~keyword("like|colored") + effect >> making.styled)
source = (
    unless(_new_thing)
    + ~keyword("that of|those of|the colors of|the color of")
    + known_thing
    + ~keyword("'s (color|colors)")
)
colour_of = (
    _article + keyword("[color scheme|color palette|color|colors|coloring|palette|look|appearance] [of|from]") + source
    >> making.matched
)
_possessed = known_thing + keyword("['s|'] [color|colors|coloring|look|appearance]") >> making.matched
same_colour = colour_of | _possessed
alike = _seem + keyword("like|similar to|the same as") + source >> making.matched
made = either(
    colour_value,
    without_colour,
    more_colour_value,
    compared,
    pop,
    sized,
    ~keyword("go|all") + BLUR.value,
    _glow_value,
    opacity_value,
    upside_down >> (lambda: making.turned(making.UPSIDE_DOWN)),
    on_its_side >> (lambda: making.tilted(90.0)),
    same_colour,
    a_look,
    alike,
    bare_look,
)

BACK, FORTH = (((None, way, None),) for way in ((0, 0, 1), (0, 0, -1)))
_PLACES = {
    "[far|much] left|far to the left|left": (making.RIGHT, making.LEFT),
    "[far|much] right|far to the right|right": (making.LEFT, making.RIGHT),
    "high|high up|far up": (making.DOWN, making.UP),
    "low|far down": (making.UP, making.DOWN),
    "close|near|close to the camera": (BACK, FORTH),
    "far away|far back|far off|distant": (FORTH, BACK),
}
"""Where something is -> the ways that it goes where that is too much of it, and where it is not enough."""
_TOO = {words: tuple(map(making.moved, ways)) for words, ways in _PLACES.items()} | {
    words: (quality.helps(upward), quality.helps(not upward))
    for quality in QUALITIES
    for words, _, upward in quality.complaints()
}
"""Quality -> what is done where there is too much of it, and where there is not enough."""
_degree = ~literal(
    "far|way|much|a bit|a little|a little bit|rather|really|still|just|slightly|quite|somewhat|a tad|a touch"
)
_too = table({words: too for words, (too, _) in _TOO.items() if too}, reserve=False)
too_much = either(
    _degree + keyword("too") + _degree + _too,
    _degree + keyword("too") + _degree + colour >> (lambda rgb: making.added(1.0, (rgb, -1))),
    ~(_degree + keyword("too"))
    + table(
        {words: q.helps(upward) for q in QUALITIES for _, words, upward in q.complaints() if q.helps(upward)},
        reserve=False,
    ),
    keyword("not")
    + table({words: more for words, (_, more) in _TOO.items() if more}, reserve=False)
    + keyword("enough"),
)
"""What is done about too much or too little of a quality: a value."""
rather = (
    literal(
        "a (little) bit|a little|rather|kind of|somewhat|slightly|a tad|a touch|quite|terribly|awfully|horribly|"
        "dreadfully|painfully|"
        "blindingly|ridiculously|overly|excessively|annoyingly|unbearably"
    )
    + _too
)
"""What is done about "it is a bit dark"."""
simply = optional(degree) + ~literal("more|really|very|rather|quite") + table(
    {words: (quality, upward) for quality in (BRIGHTNESS, CONTRAST, SATURATION, WARMTH, SPEED)
     for words, upward in ((quality.much, True), (quality.little, False))}
    | {"well lit": (BRIGHTNESS, True), "black as night|pitch dark": (BRIGHTNESS, False),
       "icy cold": (WARMTH, False), "slow moving": (SPEED, False), "rapid": (SPEED, True)},
    reserve=False,
) >> (lambda how, complaint: complaint[0].changed(how, complaint[1]))  # fmt: skip
"""A quality without "more" or "less": "the sand should be dark"."""
