"""What becomes of a thing, as sentences say it: the phrases behind "make the dog …"."""

from __future__ import annotations

from ..language.amounts import (
    Amount,
    amount,
    comparison,
    degree,
    factor,
    fraction,
    fraction_of,
    multiple,
    number,
    percent,
)
from ..language.colour_names import COLOURS
from ..language.colours import colour, colourish, more_colour
from ..language.grammar import (
    NAMES_TOO,
    VOCABULARY,
    Mismatch,
    Rule,
    constant,
    either,
    generated,
    here,
    keyword,
    literal,
    optional,
    silent,
    table,
    unless,
)
from ..language.lexicon import FUNCTION_WORDS, singular, word_set
from . import making
from .phrases import known_thing
from .styles import STYLES

_BEFORE_SHADES = word_set("in to a an into nice lovely some with")
_small = degree >> (lambda how: making.A_BIT if how.kind == "small" else 1.0)


def _below_all(x: float) -> float:
    """A share of something; Mismatch for more than all of it."""
    if x > 1:
        raise Mismatch
    return x


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
_named_shade = Rule(
    lambda reading, at: (
        {at + 1: ()}
        if reading.word(at - 1) in _BEFORE_SHADES
        and reading.word(at).isalpha()
        and not {reading.word(at), singular(reading.word(at))}
        & (
            VOCABULARY
            | NAMES_TOO
            | FUNCTION_WORDS
            | COLOURS.keys()
            | {word for words in reading.known for word in words}
        )
        and colour.at(reading, at + 1)
        and not colour.at(reading, at)
        else {}
    )
)
"""A word that says which shade of a colour: "in a nice chestnut brown"."""
shade_of = shade_of + ~_named_shade
_shade_of = shade_of + ~(keyword("from") + silent(colour) + ~keyword("to|into"))
_fully = ~keyword("all|completely|fully|entirely|totally|wholly")
colored = ~keyword("(in) color|colored|tone") + unless(keyword("tint|filter"))
colored_noun = literal("color|paint|tint|tinge|touch|shade|hue|tone|glow|light|halo|shimmer|cast|wash|coat|aura|shine")
_flat = keyword("solid|flat|plain|pure|uniform|unshaded|uniformly|flatly")
colour_value = either(
    _article + _flat + ~_flat + colour + colored >> making.recoloured,
    keyword("a (little|tiny) bit|a [little|tad|touch]|slightly|somewhat|faintly|kind of")
    + ~keyword("more")
    + (colour | colourish)
    >> making.faintly,
    ~keyword("a|an|some") + colourish + colored >> making.faintly,
    _share + colour >> (lambda share, rgb: making.assigned(rgb, share)),
    _fully + ~keyword("a|an|some") + _shade_of + ~keyword("the color") + colour + colored >> making.assigned,
)
more_colour_value = (
    optional(
        degree >> (lambda how: 0.5 if how.kind == "small" else 2.0) | percent >> (lambda x: x / making.MORE_COLOUR), 1.0
    )
    + more_colour
    >> making.added
)
without_colour = ~literal("a|an|the") + optional(_share, 1.0) + keyword(
    "black and white|black white|b and w|b / w|monochrome|monochromatic|(a) grayscale|"
    "gray scale|colorless|desaturated|without (any|its|all) color|without colors"
) + ~literal("look|filter|effect|video|clip|film|movie|version|picture|image|grade|treatment|footage") >> (
    lambda share: making.hued(making.BLACK_AND_WHITE, share)
)
_BRIGHTNESS = ("brighter|lighter", "darker|dimmer|gloomier", "bright|light", "dark|dim")
_SIZE = ("bigger|larger|huger", "smaller|tinier", "big|large|huge|tall|high|wide", "small|tiny|little|short")
_SPEED = ("faster|quicker|swifter|speedier", "slower", "fast|quick|quickly|speedy", "slow|slowly")
brightness_value = (
    either(comparison(*_BRIGHTNESS), fraction_of("brightness|light|luminance") | fraction_of("as bright"))
    >> making.brightened
)
contrast_value = (
    comparison("punchier|crisper", "flatter", "contrasty|contrastful|punchy|contrasted", "flat") >> making.contrasted
)
saturation_value = (
    comparison(
        "more saturated|richer|livelier|more intense",
        "duller|less saturated|paler",
        "saturated|vivid|colorful|vibrant|intense|rich|lively|colored",
        "desaturated|muted|dull|washed out|pale|faded",
    )
    >> making.saturated
)
_warmer = table(
    {
        "warmer|more warm|cozier|cosier|less cool|less cold": True,
        "cooler|colder|chillier|more cool|more cold|less warm": False,
    }
)
warmth_value = either(
    optional(amount) + _warmer >> making.warmed, _warmer + amount >> (lambda warmer, how: making.warmed(how, warmer))
)
pop = keyword(
    "pop|pop more|pop out|stand out|stand out more|come alive|(more|really) vivid|(very) saturated|(very) colorful|vibrant"
) + unless(known_thing) >> (lambda: making.saturated(factor(None, True)))
sized = either(
    ~keyword("very|really|quite")
    + here(lambda reading, at: reading.words[at - 1 : at + 1] != ["a", "little"])  # how much, not how big
    + table(
        {
            "tiny|small|little|minute|miniature|teeny tiny|teeny weeny|teeny|itty bitty|tiny weeny": 0.5,
            "huge|giant|enormous|gigantic|big|large|massive": 2.0,
        }
    )
    >> making.scaled
)
softly = either(
    degree,
    table(
        {
            "softly|faintly|gently|weakly": Amount("small"),
            "heavily|strongly|intensely|brightly|very|really|badly|(even|some|a lot|much) more|stronger|harder": Amount(
                "large"
            ),
        }
    ),
)
_blurry = ~keyword("all") + keyword(
    "blurry|blurred|softer|soft focus|less sharp|blurrier|fuzzy|hazy|out of focus|unsharp|more blurry|more blurred"
)
blur_value = ~keyword("go") + either(optional(softly) + _blurry >> making.blurred, _blurry + softly >> making.blurred)
_glow_value = (
    optional(softly)
    + keyword("glowing|glowy|luminous|aglow|radiant|shining|shiny|shimmering|glow")
    + ~keyword("in")
    + optional(colour)
    >> making.glowing
)
size_value = either(comparison(*_SIZE), fraction_of("size|sizes|dimensions|scale|height|width|length")) >> making.scaled
slow_motion = keyword("(on|in|at|a|into|in a) [slow mo|slowmo|slo mo|slomo|slow motion|slow mode|bullet time]")
_paced = either(
    fraction_of("speed|pace|tempo|rate|velocity"),
    keyword("(a) speed of") + (multiple | percent | number),
    ~keyword("a") + multiple,
)
pace_value = (
    either(
        comparison(*_SPEED),
        ~keyword("with") + slow_motion >> (lambda: 0.5),
        ~keyword("at|to|with") + fraction_of("speed|pace|tempo|rate"),
    )
    >> making.retimed
)
pace = either(pace_value, keyword("at|in|to") + _paced >> making.retimed)
backward = keyword(
    "backward ([in|through] time)|back in time|in reverse|reversed|in the opposite direction|back to front|from the end to "
    "the start|in reverse order|(the) other way around|from back to front|from end to start"
) >> (lambda: making.reversed)
_see_through = keyword("transparent|see through|translucent|transparency|sheer")
_solid = literal("opaque|solid|visible")
_share_of = lambda how: 0.5 if how is None else {"small": 0.2, "large": 0.8}.get(how.kind, how.value)  # noqa: E731


def as_fraction(x: float) -> float:
    """A fraction, or percents that are said without their sign; Mismatch for neither."""
    if x > 100:
        raise Mismatch
    return x if x <= 1 else x / 100


_transparency = either(
    percent + _see_through >> (lambda x: 1 - x),
    table(
        {
            "half|semi|partly|partially|somewhat": 0.5,
            "a (little) bit|a little|slightly": 0.8,
            "very|mostly|almost|nearly": 0.2,
            "completely|fully|totally|entirely|100 %": 0.0,
        }
    )
    + _see_through,
    fraction + _see_through >> (lambda x: 1 - x),
    _see_through >> (lambda: 0.5),
    keyword("[barely|hardly|scarcely|just about|only just|faintly] [visible|seen|there|to be seen]") >> (lambda: 0.2),
    _article + percent + keyword("opaque|visible|opacity"),
    fraction + keyword("opaque|visible|opacity"),
    keyword("(an|a) opacity (of)") + (percent | number >> as_fraction),
    keyword("(a) transparency (of)") + (percent | number >> as_fraction) >> (lambda x: 1 - x),
    keyword(
        "(completely|fully|totally) opaque|(completely|fully) visible (again)|opaque (again)|(completely|fully) solid again|"
        "reappear"
    )
    >> (lambda: making.SHOWN),
    (multiple | percent) + keyword("as") + _solid + ~keyword("as (it is|before|now)"),
    optional(amount) + (keyword("more") + _see_through | keyword("less") + _solid) >> (lambda how: 1 - _share_of(how)),
    optional(amount) + (keyword("less") + _see_through | keyword("more") + _solid)
    >> (lambda how: 1 + 2 * _share_of(how)),
    keyword("(very) faint|[almost|nearly|next to|all but|close to] [invisible|transparent|gone|vanished]")
    >> (lambda: 0.2),
    keyword(
        "(completely|totally|fully) invisible|(completely|totally) hidden|unseen|not visible|vanish|vanished|disappear|disappeared"
    )
    >> (lambda: 0.0),
)
opacity_value = ~keyword("at|to|with") + _transparency >> making.opacity
upside_down = keyword("upside down|head over heels") | literal(
    "[on|onto] (to) (the|its|his|her|their) [head|roof|back]|belly up"
)
on_its_side = literal("[on|onto] (to) (the|its|his|her|their) side")
look_name = table(
    {f"{look}|{look}s": look for look in STYLES}
    | {"flames|flame": "fire", "the night|night time|nighttime|moonlight": "night"},
    reserve=False,
)
_of_matter = table(
    {look: look for look in ("gold", "silver", "copper", "ice", "fire", "lava", "marble", "chocolate")}, reserve=False
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
transformed = (
    literal("into|to")
    + ~literal("a|an|pure|solid|real|some")
    + ~literal("molten|liquid|solid|pure|shiny|glittering|glowing|polished|burning")
    + _of_matter
    + ~literal("statue|block|sculpture|figure|figurine|bar")
    >> making.styled
)
"""What a thing turns to: matter, not a colour that is named like it."""
liveliness = (
    literal(
        "[a little|(a) bit|a touch|extra] (of|more) [life|punch|pop|oomph|vibrancy|zing|pizzazz|kick]|oomph|zing|life|pep|pizzazz"
    )
    | literal(
        "some (more) [life|punch|pop|oomph|vibrancy|zing|pizzazz|kick]|(a) (little) pop of color|more color|some color"
    )
) >> (lambda: making.saturated(factor(None, True)))
hint = (
    ~literal(",")
    + ~literal("but|only|just")
    + literal(
        "(just|only) a [hint|touch|bit|little|tad|shade|trace] (of it)|[slightly|subtly|faintly|softly|gently] (so)"
    )
)
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
    + keyword("(made|built|carved|cast) (out) of|in the style of|into|in")
    + ~keyword("a|an|pure|solid")
    + look_name
    + ~effect,
    constant(1.0) + keyword("in|into|with") + ~keyword("a|an|the|some") + any_look + effect,
    _seem + _strongly + _look_adjective,
) >> (lambda strength, look: making.styled(look, strength))
bare_look = ~literal(
    "(take|taking|takes) place at|(happen|happens|happening|set|shot|filmed|recorded) [at|during|in]|at|during|in the "
    "(middle of the)|by"
) + (table({"night|night time|nighttime": "night", "sunset|sundown|dusk": "sunset"}, reserve=False) >> making.styled)
given_look = literal("the|a") + literal("texture|look|appearance|finish|surface|feel|sheen") + literal("of") + ~literal(
    "a|an|pure|solid|real"
) + (any_look >> making.styled) | (
    _article + (any_look | literal("frozen") >> (lambda: "ice")) + ~keyword("like|colored") + effect >> making.styled
)
source = (
    unless(_new_thing)
    + ~keyword("that of|those of|the colors of|the color of")
    + known_thing
    + ~keyword("'s (color|colors)")
)
same_as = (
    keyword("the (exact) same")
    + (silent(colour) | ~keyword("color|colors|coloring|look|tone|tones|shade|hue|tint"))
    + keyword("as|like|to")
    + source
    | keyword("(a|the) similar color") + keyword("as|like|to") + source
) >> making.matched
colour_of = (
    _article
    + keyword("color scheme|color palette|color|colors|coloring|palette|look|appearance")
    + keyword("of|from")
    + source
    >> making.matched
)
_possessed = known_thing + keyword("'s|'") + keyword("color|colors|coloring|look|appearance") >> making.matched
same_colour = same_as | colour_of | _possessed
alike = _seem + keyword("like|similar to|the same as") + source >> making.matched
made = either(
    colour_value,
    without_colour,
    more_colour_value,
    brightness_value,
    contrast_value,
    saturation_value,
    warmth_value,
    pop,
    sized,
    blur_value,
    _glow_value,
    size_value,
    pace_value,
    opacity_value,
    upside_down >> (lambda: making.turned(making.UPSIDE_DOWN)),
    on_its_side >> (lambda: making.tilted(90.0)),
    same_colour,
    a_look,
    alike,
    bare_look,
)

BACK, FORTH = (((None, way, None),) for way in ((0, 0, 1), (0, 0, -1)))
_MORE, _LESS = factor(None, True), factor(None, False)
_TOO = {
    "bright|light|shiny|glaring|overexposed": (making.brightened(_LESS), making.brightened(_MORE)),
    "dark|dim|black|gloomy|underexposed|shadowy": (making.brightened(_MORE), making.brightened(_LESS)),
    "big|large|tall|huge|wide|long": (making.scaled(_LESS), making.scaled(_MORE)),
    "small|tiny|little|short": (making.scaled(_MORE), making.scaled(_LESS)),
    "fast|quick|quickly|hectic|rapid": (making.retimed(_LESS), making.retimed(_MORE)),
    "slow|slowly|sluggish": (making.retimed(_MORE), making.retimed(_LESS)),
    "colorful|saturated|vivid|garish|gaudy|strong|intense": (making.saturated(_LESS), making.saturated(_MORE)),
    "pale|dull|washed out|muted|faded|desaturated": (making.saturated(_MORE), making.saturated(_LESS)),
    "flat": (making.contrasted(_MORE), making.contrasted(_LESS)),
    "contrasty|harsh|hard": (making.contrasted(_LESS), making.contrasted(_MORE)),
    "warm|yellow|orange": (making.warmed(None, False), making.warmed(None, True)),
    "cold|cool|blue|bluish": (making.warmed(None, True), making.warmed(None, False)),
    "transparent|see through|faint": (making.opacity(2.0), making.opacity(0.5)),
    "sharp|crisp": (making.blurred(), making.blurred()),
    "much contrast|contrast": (making.contrasted(_LESS), making.contrasted(_MORE)),
    "little contrast": (making.contrasted(_MORE), making.contrasted(_LESS)),
    "much color|much saturation": (making.saturated(_LESS), making.saturated(_MORE)),
    "little color|little saturation": (making.saturated(_MORE), making.saturated(_LESS)),
    "much light|much brightness": (making.brightened(_LESS), making.brightened(_MORE)),
    "[far|much] left|far to the left|left": (making.moved(making.RIGHT), making.moved(making.LEFT)),
    "[far|much] right|far to the right|right": (making.moved(making.LEFT), making.moved(making.RIGHT)),
    "high|high up|far up": (making.moved(making.DOWN), making.moved(making.UP)),
    "low|far down": (making.moved(making.UP), making.moved(making.DOWN)),
    "close|near|close to the camera": (making.moved(BACK), making.moved(FORTH)),
    "far away|far back|far off|distant": (making.moved(FORTH), making.moved(BACK)),
    "little light|little brightness": (making.brightened(_MORE), making.brightened(_LESS)),
}
"""Quality -> what is done where there is too much of it, and where there is not enough."""
_degree = ~literal(
    "far|way|much|a bit|a little|a little bit|rather|really|still|just|slightly|quite|somewhat|a tad|a touch"
)
_too = table({words: too for words, (too, _) in _TOO.items()}, reserve=False)
too_much = either(
    _degree + keyword("too") + _degree + _too,
    _degree + keyword("too") + _degree + colour >> (lambda rgb: making.added(1.0, (rgb, -1))),
    table(
        {
            "underexposed|murky|gloomy|dim": making.brightened(_MORE),
            "overexposed|blown out|glaring": making.brightened(_LESS),
            "washed out|faded|lifeless|bland|dull|drab": making.saturated(_MORE),
            "oversaturated|garish|gaudy": making.saturated(_LESS),
        },
        reserve=False,
    ),
    keyword("not") + table({words: more for words, (_, more) in _TOO.items()}, reserve=False) + keyword("enough"),
)
"""What is done about too much or too little of a quality: a value."""
rather = literal("a (little) bit|a little|rather|kind of|somewhat|slightly|a tad|a touch|quite") + _too
"""What is done about "it is a bit dark"."""
_WISHES = word_set("should to could must may can let make would")
cast = (
    here(lambda reading, at: reading.word(at - 1) not in _WISHES)
    + literal("has|have")
    + ~literal("got")
    + ~literal("a|an|some|this|that|such a|too much of a")
    + ~literal("slight|strong|ugly|nasty|weird|strange|heavy|faint|bad|terrible")
    + (colour | colourish)
    + literal("cast|tint|tinge|color cast|hue")
) >> (lambda rgb: making.added(1.0, (rgb, -1)))
"""What is done about "it has a yellow cast"."""
simply = table(
    {
        "bright|light|well lit": making.brightened(_MORE),
        "dark|dim|black as night|pitch dark": making.brightened(_LESS),
        "colorful|vivid|saturated|vibrant": making.saturated(_MORE),
        "pale|dull|muted|faded": making.saturated(_LESS),
        "warm|cozy|cosy": making.warmed(None, True),
        "cold|cool|icy cold|chilly": making.warmed(None, False),
        "slow|slowly|slow moving": making.retimed(_LESS),
        "fast|quick|quickly|rapid": making.retimed(_MORE),
    },
    reserve=False,
)
"""A quality without "more" or "less": "the sand should be dark"."""
