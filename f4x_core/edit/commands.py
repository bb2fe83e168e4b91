"""The commands of the language: verb, thing, quality, amount, direction and time, wherever they stand, and what is then done.

Between the phrases there may be words that add nothing; every other word has to belong to a phrase. A verb is added in
`language.verbs`, a command by a row here.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from ..language.amounts import (
    BEFORE_VERBS,
    LEAST_PERCENTS,
    amount,
    degree,
    distance,
    fraction,
    fraction_of,
    multiple,
    number,
    percent,
    softly,
    steps,
    stops,
)
from ..language.colours import colour, colourish
from ..language.courtesies import ASIDE, CALLS, COMMENTS, WISHES
from ..language.degrees import DEGREES, Amount, factor
from ..language.grammar import Rule, constant, either, here, keyword, listed, literal, optional, silent, table, unless
from ..language.lexicon import PICTURE, every_form, word_set
from ..language.refusal import Mismatch
from ..language.times import TimeExpression, duration, span
from ..language.verbs import COMMAND_VERBS, IMPERATIVES, any_form, asked_form
from . import making, qualities
from .graded import OPACITY, QUALITIES, SATURATION, SIZE, SPEED, Quality
from .making import Value
from .operations import SHOWN
from .phrases import (
    colors,
    everything_but,
    familiar,
    known_noun,
    known_thing,
    name,
    place,
    there_already,
    thing,
    two_of_them,
    two_of_them_behind,
    untouched,
    whose,
)
from .selects import All, Current
from .slots import (
    AGAIN,
    ANGLE,
    BESIDE_IT,
    NAMED,
    OUT,
    QUALITY_WORDS,
    REMARK,
    SENSE,
    SHIFT,
    TIMED,
    TRAIL_COPIES,
    TRAIL_LAG,
    USUAL,
    WHOLE,
    Command,
    Given,
    Use,
    always,
    as_given,
)

COMMANDS: list[Command] = []
"""In the order in which they are preferred."""


def _the_clip() -> Any:
    """Who is meant by a clip, its time or what happens then: everything."""
    return lambda context: making.noted(context, All())


def _alone(value: Value) -> Given:
    """A value where others could stand beside it."""
    return ((value,),)


_WANTED = (
    "needs|wants|requires|deserves|is in need of|calls for|is crying out for|[should|must|could|can|may|will|would|shall|has "
    "got to|have got to|has to|have to|needs to|need to|ought to|is to|are to|wants to|want to|is supposed to|are supposed to|"
    "might|is meant to|are meant to|was meant to|had better|should have|ought to have|had best|do need to]"
)
_RUNNING = frozenset(any_form("run").split("|")) - word_set(
    "make render let put set keep have play be get do show pass moved put"
)
_over = here(lambda reading, at: not reading.word(at).isalpha())
_goes_on = unless(literal("and|but")) + here(lambda reading, at: reading.word(at).isalpha())
ADDS_NOTHING = either(
    CALLS,
    WISHES,
    COMMENTS,
    silent(ASIDE),
    literal(f"{_WANTED} (to) ([be|become|get|turn|look|appear|stay|end up|have|been|gone|become])"),
    literal(f"[{_WANTED}] (to) go") + unless(_over),  # what has to go is to be gone
    literal(
        "[become|becomes|becoming|being|be|were|gets|ends up|end up|ending up|comes out|stays] (as)|for it to|for them to|"
        "be [possible|feasible|doable]|could [do with|use] being"
    ),
    literal(
        every_form("make|let|have|get|do|keep|animate")
        + "|start (with)|begin (with)|every frame|each frame|going|real quick|super quick|"
        "for good|permanently|(in) [mid air|midair|mid flight|mid jump|mid stride|mid motion]|across the board"
    ),
    literal(f"[in|within|inside] (the|this|my|our) (whole|entire) [{PICTURE}]|in here") + unless(number),
    literal(",|:|->|=>|=|-|!|(|)"),
    literal("to") + here(lambda reading, at: reading.word(at) in IMPERATIVES),
    literal("instead") + unless(literal("of")),
    literal("afterward|after that|from then on|thereafter") + here(lambda reading, at: at == len(reading.tokens)),
    literal("(up|down) [on|around|about|to|with] [it|him|her|them]") + _over,
    literal(
        "(,) (with) (the|its) pivot (point) (is|at|on|=|:) (the|its|his|her|their) [base|bottom|feet|ground|floor]|(around|about) "
        "(the|its) (own) [up|vertical] (axis)"
    ),
    literal("too") + unless(_goes_on),
    literal("both") + unless(silent(two_of_them_behind)),
    literal("[about|around] (the) [up|vertical] (axis)"),
    literal(every_form("give|do|perform"))
    + here(
        lambda reading, at: any(
            a in ("a", "an") and {b, c} & COMMAND_VERBS
            for a, b, c in zip(reading.words[at:], reading.words[at + 1 :], reading.words[at + 2 :], strict=False)
        )
    ),
)
"""Courtesies, and verbs that say no more than that something is done."""

_joined = literal("and|,|, and|but|plus|and also|as well as|+")
_led = here(lambda reading, at: reading.word(at) in ("at", "in", "with"))
"""Qualities need no "and" between them where a preposition stands: "backwards at half speed"."""
_toward = ~literal(
    "[up|down] to|something like|something in|a kind of|more of|(look|looks) like (an|some) old [movie|film|photo|photograph|"
    "picture|postcard] (,) (in)|in|to|into|as|with|at|by|toward|of|being|it|them|more like|like|rather|old film|vintage|old|"
    "classic|nice|some|for|but|but in|be of|from"
)
_a = ~literal("(with|in|of|to|into) (a|an|some|the|that|this)")
_slight = literal("slight|faint|light|soft|subtle|little|tiny|gentle|hint of|touch of|bit of|dash of|little bit of")
_hue = qualities.shade_of + (colour | colourish)
_noun_of_colour = either(
    _a + _slight + _hue + ~literal("tint|tinge|touch|cast|wash|hue|note|tone") >> making.faintly,
    _a + _hue + literal("tint|tinge|touch|cast|wash|hint|note|filter|overlay|glaze|veil") >> making.faintly,
    _a
    + ~literal("nice|fresh|new|good|coat of|layer of|lick of|splash of|shade of|tone of")
    + qualities.shade_of
    + colour
    + literal(
        "color|paint|shade|coat|hue|coat of paint|paint job|version|one|variant|lacquer|dye|tone|tones|colors|finish|makeover|"
        "varnish|dye job|respray|lick of paint|look|appearance"
    )
    >> making.assigned,
    literal("(with|in|to|of|as) (the|a) color (:|=|of|to)") + colour >> making.assigned,
)
_article = ~literal("a|an|some|the|pure|solid|that|this|made of|made out of|in|being|real")
_looked = either(
    _toward + ~literal("pure|solid") + qualities.any_look + ~qualities.effect >> making.styled,
    literal("like|as|of") + _article + qualities.any_look + ~qualities.effect >> making.styled,
    ~literal("in|with") + _article + qualities.described + qualities.any_look + qualities.effect >> making.styled,
)


_rate = (
    ~literal(",|(|-")
    + ~literal("at|with|in|to|of|down to|like|say|about|around|roughly|maybe")
    + (fraction | percent)
    + ~literal("(of) (the|its|their|his|her) (original|normal|usual|real|full)")
    + ~literal("speed|pace|tempo|rate|)")
)
"""How fast slow motion is."""
_pace_of = either(
    qualities.slow_motion + _rate >> making.retimed,
    literal("in") + multiple + literal("(of) the time|its time|as much time") >> making.stretched,
    literal("(in|at) double time") >> (lambda: making.retimed(2.0)),
    literal("(in|at|a) [super|ultra|extreme|very|really] [slow motion|slow mo|slowmo|slo mo]")
    >> (lambda: making.retimed(0.25)),
    literal("(in) [fast forward|fast motion]|time lapse|timelapse") >> (lambda: making.retimed(2.0)),
)
_quality = either(
    qualities.given_look,
    _toward
    + qualities.made
    + ~literal(
        "tone|tones|mood|look|light|feel|grade|grading|color|colors|feeling|picture|image|clip|video|scene|shot|footage"
    ),
    _noun_of_colour,
    _looked,
    _pace_of,
    ~literal("at|to")
    + (percent | multiple)
    + literal("of what it [is|was] (now|before)|of [it|itself]|as it [is|was] (now)")
    >> making.scaled,
    qualities.pace,
    _toward + qualities.backward,
    qualities.liveliness,
    ~literal("(in|into|to|with) (the|a|an|some|that|this)")
    + qualities.described
    + qualities.scene_look
    + ~qualities.effect
    >> making.styled,
    ~literal("a|the|nice and|pretty|in a|feel|look|looking|feeling")
    + qualities.simply
    + ~literal("tone|tones|mood|look|light|color|colors|filter|grade|overlay|cast|wash"),
)
_LIGHT = any_form("become", "apply", "leave")
"""Verbs that only carry what a noun or a value says: "stick a glow on it", "trim the contrast to 80 %"."""
_has_to_go = literal("go|goes|gone") + _over
_becoming = either(
    unless(literal("tones|shades|looks|seems|feels") | _has_to_go) + literal(any_form("match") + "|" + _LIGHT),
    literal("push") + here(lambda reading, at: {"back", "backward"}.isdisjoint(reading.words)),
)
_about = ~literal("of|for|on|to|in|with|around|round|about|onto|over|at|from|upon|into|through|across|all over")
_SEEN_ALONE = word_set("visible seen shown left remain remaining remains there")
_not_seen_alone = here(lambda reading, at: _SEEN_ALONE.isdisjoint(reading.words))
"""Of "only the dog should be visible" the rest is not to be seen."""
_whom = (
    unless(literal("over the [clip|video|film|scene|shot]|across the board"))
    + ~(_not_seen_alone + literal("(but) [only|just|only for|just for|only with]"))
    + _about
    + thing
    + ~literal("only|alone")
)


def _command(example: str, make: Any, needed: str, use: Use = USUAL) -> Callable[..., None]:
    """Add a command with the slots that what is returned is called with, and the phrase `who` for whom it is."""

    def add(who: Rule = _whom, **slots: Rule) -> None:
        COMMANDS.append(Command(example, make, slots, frozenset(needed.split()), who, use))

    return add


# What stays as it is
_command("but leave the dog as it is", REMARK, "spared", NAMED)(
    verb=literal(every_form("leave|keep|let|stay|remain")), spared=untouched
)
_command("do not touch the dog", REMARK, "spared", NAMED)(
    spared=literal("do not [touch|change|affect|alter]|without [touching|changing]|[ignore|skip]|never [touch|change]")
)
# Colours and looks
_command("match the dog to the cat", making.matched, "verb source")(
    who=whose("color|colors|coloring|look") | thing,
    verb=literal(any_form("match")),
    source=literal("[to|with|and|from] (the [color|colors|coloring|look] of|that of|those of)")
    + known_thing
    + ~(literal("['s|'] (color|colors|coloring)")),
)
_command("shift the hue of the car to red", making.hued, "rgb", NAMED)(
    who=whose("hue|hues|tone"), verb=literal(any_form("set", "become")), rgb=~keyword("to|toward|into") + colour
)
_complaining: dict[str, Rule] = {
    "who": either(
        literal("it|this|that|its")
        >> (lambda: lambda context: context.last or (Current() if context.selected else All())),
        ~literal("the|all the") + colors,
        literal("(the) [white balance|color temperature|exposure|overall look|overall color|grade|lighting]")
        >> _the_clip,
        thing,
    ),
}
"""Who is complained of, and what is to be done about it."""
_command("make the dog red", as_given, "values")(
    who=either(
        _whom,
        _about
        + whose("color|colors|coloring|look|appearance|material|texture|finish|paint|paintwork|paint job|shade|tint"),
    ),
    verb=_becoming,
    values=listed(_quality, _joined | _led),
)
_command("tint the dog orange", making.faintly, "verb rgb")(
    verb=literal(any_form("tint")),
    rgb=_a + ~_slight + qualities.shade_of + (colour | colourish) + qualities.colored,
)


_in_color = literal("in (full|its) [color|colors]|colored")
_only = literal("only|just|solely") + unless(silent(span))
_command("only the dog keeps its color", always(making.rest_grayed), "only keeps", NAMED)(
    verb=literal(any_form("keep", "show") + "|let"),
    only=_only,
    keeps=literal(
        "[keeps|keep|retains|stays|stay|remains|remain|has|have] (its|their|his|her) [color|colors|colored|in color]"
    )
    | _in_color,
)

_MERELY = word_set("make makes making made get gets got be have has let put set keep")
"""Of the verbs of playing those that do not say that it is about speed."""
# More and less of a quality
_nouns = table(
    {quality.noun: (quality, True) for quality in QUALITIES}
    | {quality.lack: (quality, False) for quality in QUALITIES},
    reserve=False,
)
"""A quality, and whether the noun is of it or of what it lacks."""
_BROUGHT = word_set("bring give get put want have bringing giving getting putting")
_color_brought_back = here(
    lambda reading, at: (
        "back" in reading.words[at : at + 2] and {"color", "colors"} & {*reading.words} and _BROUGHT & {*reading.words}
    )
)
"""That is no less of it: "bring back the color"."""
_way = unless(_color_brought_back) + table(
    {
        any_form("more")
        + "|add|adds|adding|give|lend|up|upward|more|higher|stronger|extra|plus|+|additional|some more|a bit of|increased|some|"
        "greater|" + "|".join(quality.more for quality in QUALITIES if quality.more): True,
        any_form("less")
        + "|back|down|downward|less|lower|weaker|minus|-|reduced|fewer|reduction|decrease|"
        + "|".join(quality.less for quality in QUALITIES if quality.less): False,
    },
    reserve=False,
)
_times_as_much = table(
    {
        every_form("double|double up"): 2.0,
        every_form("halve|cut in half|slash in half") + "|half": 0.5,
        every_form("triple|treble"): 3.0,
        every_form("quadruple"): 4.0,
    },
    reserve=False,
)
_to_value = (
    unless(here(lambda reading, at: any(end > at for i in range(max(at - 5, 0), at) for end in span.at(reading, i))))
    + literal("[to|at|=|:|be|of|is] (about|around|exactly|only)")
    + either(percent, multiple, number)
    + ~literal("of [its|the|their] (original|current|normal|present) (value|size|speed|brightness|level)")
)
"""What a quality comes to."""


def _changed(
    quality: tuple[Quality, bool],
    way: bool | None = None,
    how: Amount | None = None,
    to: float | None = None,
    times: float | None = None,
    particle: bool | None = None,
    level: float | None = None,
) -> Value:
    changed, of_it = quality[0].changed, quality[1]
    if level is not None:  # "contrast 80 %" is what it comes to, "contrast up 20 %" how much more it gets
        if (how, to, times) != (None, None, None):
            raise Mismatch
        if level > 1 and (way, particle) != (None, None):  # 150 % more is rarely meant
            raise Mismatch
        to, how = (level, None) if way is None and particle is None else (None, Amount("fraction", level))
        way = particle if way is None else way
    if particle is not None and particle is not way:
        raise Mismatch
    if times is None and how is not None and how.kind == "times" and way is to is None:
        times = how.value  # "twice the size"
    if times is not None:
        if (way, to) != (None, None):
            raise Mismatch
        return changed(Amount("as", times), of_it)
    if to is not None:
        to = to / 100 if to > SHOWN else to
        if quality[0] is not OPACITY and way and to < 1:
            raise Mismatch
        if (way is not None and how is not None) or to > SHOWN:
            raise Mismatch
        return changed(Amount("as", to if of_it else 1 - to), True)
    if way is None:
        raise Mismatch
    return changed(how, way is of_it)


def _percents(x: float) -> float:
    """A number of a slider from 0 to 100, or a factor below 5; Mismatch for others."""
    if x > 100:
        raise Mismatch
    return x if x < LEAST_PERCENTS else x / 100


def _by_number(x: float) -> Amount:
    return Amount("times", x) if x < LEAST_PERCENTS else Amount("fraction", _percents(x))


_set = unless(literal("add|adds|adding|added")) + literal(any_form("set", "become", "apply"))
_command("lift the dog by half a stop", lambda way, by: making.brightened(factor(by, way)), "way by")(
    verb=_set,
    way=table(
        {
            "[raise|lift|push|bring|expose|pull|open|come|go] up|up|over|brighter|lighter|more|raise|lift|push|+|higher": True,
            "[drop|pull|bring|knock|take|come|go] [down|back]|down|under|darker|dimmer|less|drop|lower|back|-": False,
        },
        reserve=False,
    ),
    by=~literal("by|a") + stops,
)
_by_how_much: dict[str, Rule] = {
    "verb": _set,
    "way": _way,
    "level": percent
    | here(lambda reading, at: reading.word(at - 1) != "to") + number + unless(literal("x|times|stop|stops"))
    >> _percents,
    "how": amount | literal("by") + number >> _by_number | literal("way") >> (lambda: Amount("large")),
    "to": _to_value,
    "particle": table({"up": True, "down": False}, reserve=False),
    "times": _times_as_much,
}
"""How much more or less of a quality there is to be, or to what it comes."""
_command("increase the contrast of the dog", _changed, "quality", WHOLE)(
    who=_whom | literal("its|their|his|her") >> (lambda: lambda context: context.it("'its'")),
    quality=~literal("(punch|oomph|bite|kick|pop|boost) (the|a|'s|some|of|in|to|with [the|its|his|her|their])")
    + ~literal("(the) (overall|whole|entire|general)")
    + _nouns
    + ~literal("level|value|slider|amount|setting"),
    **_by_how_much,
)


def _grayed(how: Amount | None, upward: bool) -> Value:
    """As less saturated, where that without an amount means gray."""
    return making.GRAYED if how is None else SATURATION.changed(how, upward)


_SIDES: dict[str, tuple[making.Graded, bool | None]] = {
    **{quality.up: (quality.changed, True) for quality in QUALITIES if quality.up},
    **{quality.down: (quality.changed, False) for quality in QUALITIES if quality.down},
    "desaturate": (_grayed, False),
    "pace": (SPEED.changed, None),
    "scale": (SIZE.changed, None),
}
"""Sense of a verb -> what it makes more or less."""
_until = (
    literal("until [it|he|she|they] [is|are]")
    + multiple
    + literal("as [big|tall|large|high|long|wide|small|fast|bright]")
)


def _more(verb: tuple[making.Graded, bool | None], how: Amount | None = None, to: float | None = None) -> Value:
    changed, upward = verb
    if upward is None and to is None:
        if how is None or how.kind not in ("times", "fraction"):
            raise Mismatch
        to = how.value
    if to is not None:
        if changed is making.warmed:
            raise Mismatch
        if upward is not None and (to > 1) is not upward and to != 1:
            return making.refused(f"To {to:.0%} is {'less' if upward else 'more'}, not {'more' if upward else 'less'}.")
        return changed(Amount("as", to), True)
    return changed(how, bool(upward))


_command("darken the sky", _more, "verb")(
    verb=either(*(table({any_form(sense): made}, reserve=False) for sense, made in _SIDES.items())),
    how=amount | literal("by") + number >> (lambda x: Amount("times", x)),
    to=either(
        ~literal("to|down to|up to|at|by|until")
        + fraction_of("size|sizes|dimensions|scale|height|width|length|speed|pace|tempo|brightness"),
        literal("to|down to|up to|at|until") + either(fraction, percent, multiple, literal("x") + number),
        literal("in half|by half|by a half") >> (lambda: 0.5),
        _until,
    )
    + ~literal(
        "of [its|the|their|his|her] (original|normal|present|current) [size|speed|brightness|pace]|"
        "of what it [is|was] (now|before)|[size|speed|the size|the speed|its size|opacity]"
    ),
    particle=literal(
        "(right|way) [up|down]|in size|in tempo|more|even more|further|([keeping|with]) ([from|about|around|at|on]) [its|"
        "the|their|his|her] [base|bottom|feet|foot|ground] ([planted|fixed|on the ground|in place|where it is|where they are])"
    ),
)

_command("the dog is too dark", REMARK, "complaint")(
    **_complaining,
    complaint=literal("is|are|'s|looks|look|seems|seem|feels|reads") + qualities.rather
    | ~literal(
        "is|are|'s|looks|look|seems|seem|feels|reads|comes across as|appears|appear|was|it is|has|have|(is|are) ["
        + every_form(
            "happen|walk|run|move|go|play|drive|stand|sit|ride|swim|fly|dance|hang|lie|jump|turn|spin|hover|float"
        )
        + "]"
    )
    + either(
        qualities.too_much,
        silent(~literal("a bit|a little|much|way|far|so|very|rather|quite|really|too") + literal(QUALITY_WORDS))
        >> (lambda: None),
    ),
)

# Taking out
_command("remove everything except the dog", always(making.extracted), "verb", NAMED)(
    who=everything_but, verb=literal(asked_form("delete") + "|strip|wipe|scrub") + ~OUT
)
_command("without the dog", always(making.deleted), "without", NAMED)(
    without=keyword(
        "(the|this) (same) [scene|picture|video|clip|image|shot] ([would be|is|looks|would look] (so|much|a lot|way) [better|"
        "nicer|best|good|cleaner]) (but) without|without|minus|no more|[i|we] no longer [want|need] (to see)|there should be "
        "no|there must be no|let there be no|[i|we] can do without|[i|we] (really) do not [want|need|like] (to [see|have])"
    )
    | literal("no") + unless(literal(",|.|the|that|this|it|wait|not|need"))
    | literal(
        "[is|are] not (really) [needed|wanted|necessary|required] (here|there|any more)|[is|are] [unwanted|unnecessary|"
        "superfluous]|[does|do] not belong [here|there|in there|in the picture|in the shot|in the scene]|should not be in "
        "[here|there|the picture|the shot|the scene|the frame|the video|the clip|this shot]"
    )
    | literal("should not be there|is not to be there|there [should|must|shall|may] not be|is no longer there"),
)
_command("take the car out", always(making.deleted), "verb out", NAMED)(verb=literal(asked_form("take")), out=OUT)
_command("delete the car", always(making.deleted), "verb", NAMED)(
    verb=literal(
        asked_form("delete")
        + "|(can|could|may|should) [it|he|she|they] [go|leave|come out]|out with|gone|out of [the|this] [scene|picture|video|clip|"
        "image|shot|frame|view|movie|film]|[no longer|not] (be) there (any more)|[can|could|may|should|must|has to|have to|needs "
        "to|need to] [go|leave|get out|come out|come off|be out] (away|out|the [scene|picture|video|clip|image|shot|frame|view])|"
        "bye bye|goodbye|no more|no longer [want|need] (to see)|[i|we] would (rather|prefer) not (to) [have|see]|[i|we] do not "
        "[want|need] (to [see|have])|[i|we] do not like to [see|have]|[i|we] can not stand|[i|we] hate|[i|we] am [tired|sick] of"
    ),
    out=OUT
    | literal(
        f"completely|entirely|fully|for good|(in) there|in it|any more|anymore|any longer|in [the|this|my|our] [{PICTURE}]"
    ),
)
_command("hide the car from second 1 on", always(making.opacity(0.0)), "verb", NAMED)(
    who=_whom | _about + whose("visibility|display"),
    verb=literal(
        any_form("hide")
        + "|away|go away|goes away|off|invisible|hidden|out of sight|do not show|not (to) (be) [visible|shown|seen]|"
        "[nobody|no one|none] (should|must|can|may|shall) [see|sees|notice|notices]"
    ),
)
_LEAVING = frozenset(every_form("leave|let").split("|"))
_command("keep only the dog", always(making.extracted), "only", NAMED)(
    verb=literal(
        any_form("keep", "isolate")
        + "|standing|want|(be) [left|visible|seen|shown|there|remaining]|stay|remain|remains|lift|lift out|in it"
    ),
    only=~literal("on")
    + literal(
        any_form("isolate")
        + "|[i|we] (only|just) [want|need] (to see) only|[i|we] [only|just] [want|need|would like] (to see)|"
        "only|just|solely|on [its|his|her|their] own|by itself|all by itself|"
        "soloed|in isolation|isolated|nothing else|and nothing else|no one else|and nobody else|exclusively"
    )
    | literal("alone") + here(lambda reading, at: _LEAVING.isdisjoint(reading.words)),
)

# Showing again
_again = literal("again|once more|back|back again|back in")
_command("show the dog again", making.shown, "verb", NAMED)(
    verb=literal(any_form("show")), again=_again >> (lambda: True)
)
_command("bring the dog back", always(making.opacity(SHOWN)), "verb back")(
    verb=literal(every_form("bring|come|be")), back=_again
)
# Turning
_axis = literal(
    "[around|about|on|along|in] (its|his|her|their|the) (own) ([vertical|z|yaw|up]) axis|[around|about|on|along|in] (the) "
    "[vertical|z|yaw]|in [place|z|yaw]|on the spot"
)
_sense = SENSE | table(
    {
        "[to|and] face [left|the left]|facing left|so (that) [it|he|she] [faces|looks] left": -1,
        "[to|and] face [right|the right]|facing right|so (that) [it|he|she] [faces|looks] right": 1,
    },
    reserve=False,
)
_TURNING = table(
    {
        any_form("rotate", "turn") + "|rotation|a [turn|rotation|spin|twist]": making.rotated,
        any_form("tilt") + "|(a) (slight|little|small|gentle|tiny) [tilt|lean]": making.tilted,
    },
    reserve=False,
)


def _turned(
    verb: Any, angle: float | None = None, sense: int | None = None, around: bool = False, how: Amount | None = None
) -> Value:
    if verb is making.tilted and (around or (angle, sense, how) == (None, None, None)):
        raise Mismatch
    if angle is None:
        angle = 180.0 if around else 90.0 if verb is making.rotated else making.TILT
        if how is not None:
            angle = DEGREES[how.kind].angle
    return verb(angle, sense or 1)


_command("rotate the dog", always(making.spun), "verb")(verb=literal(any_form("rotate")))
_command("turn the dog by 20 degrees", _turned, "verb angle")(
    verb=_TURNING,
    angle=ANGLE,
    sense=_sense,
    around=(literal("around|(as) seen [from [above|the top]|in plan]|in plan (view)|from above") | _axis)
    >> (lambda: True),
)
_command("turn the dog around", _turned, "verb around")(
    verb=_TURNING | constant(making.rotated) + literal(any_form("face")),
    around=~literal("to face|facing|and face|to look|looking")
    + literal(
        "[around|round] (so (that) [it|he|she] [faces|looks|points] the [other|opposite] [way|direction|side])|(to|in|"
        "into) the [other|opposite] [way|direction|side]|the other way around|so (that) [it|he|she] [faces|looks|points] "
        "the other way|backward|about|away|away from us|away from the camera|[its|his|her|their] back (to|toward|on) (us|"
        "me|the camera|the viewer)"
    )
    >> (lambda: True),
)
_command("turn the dog to the left", _turned, "verb sense")(
    verb=_TURNING | constant(making.rotated) + literal(any_form("face")),
    sense=_sense,
    how=degree,
)
# Places
_STATED_AT = word_set("sits stands hangs lies lives rests is stays")
"""Verbs that say where something is: "it sits on top of the plate" is no wish."""
_moving = literal(
    "|".join(form for form in any_form("move").split("|") if form not in _STATED_AT)
    + "|(a) (little|small|slight|gentle|tiny|bit of a) [push|nudge|shove|shift|move|tug|pull|slide|bump|lift|hop]"
)
_ground = literal(
    "([to|from] [the|its] [left|right] (hand) (side)) of where [it|he|she] [is|was|stands] (now)|from [the|its] [left|"
    "right] (hand) (side)|above (the) ground|in [z|depth]|along z|(all the way) (down) [to|onto|until|toward] (it "
    "[touches|reaches|hits]) [the|its] [ground|floor|bottom]|[in|into] the [water|ground|grass|sand|snow]|[off|from|"
    "out of|above] [the|its] [ground|floor|water|place|spot]|[into|in] the [air|sky]|a step|[from|off] where [it|he|"
    "she] is (now)|from its [place|spot|position]|along the [ground|floor]|on the [ground|floor]|away from its place"
)
_far = ~literal("by|for|about|some") + distance + unless(literal(","))
_for_it = ~literal("for|of|with|on")
_BEFORE_WAY = 4
"""Words within which a verb stands before its way: "drive the red car backward"."""
_DRIVEN = word_set("drive drives driving run runs running walk walks walking ride swim fly dance dances dancing play")
_not_run_backward = here(
    lambda reading, at: (
        reading.word(at - 1)
        not in {"backward": _RUNNING, "back": ("come", "comes"), "away": ("go", "goes", "going")}.get(
            reading.word(at), ()
        )
        and not (reading.word(at) == "backward" and _DRIVEN & {*reading.words[max(at - _BEFORE_WAY, 0) : at]})
    )
)
"""What drives or is driven backward is played in reverse, not moved, and what comes back is shown."""
_command("move the dog to the left", making.moved, "way")(
    who=_for_it + thing,
    verb=_moving,
    way=_not_run_backward + steps,
    far=_far,
    more=literal("more|further|farther|still|even|over|out"),
    ground=_ground,
)
_command("put the dog behind the bush", making.placed, "place")(
    who=_for_it + there_already,
    verb=unless(literal(every_form("drop"))) + (_moving | literal(every_form("pop"))),
    place=~literal(
        "sitting|standing|lying|hanging|placed|resting|located|seated|floating|hovering|positioned|so (that) [it|he|she] "
        "[is|stands|sits|lies|hangs]"
    )
    + ~literal("over|right|back|directly|straight|to|somewhere|down|up|just|a bit|a little|slightly")
    + place,
)
_command(
    "raise the dog by half its height",
    lambda lift, far=None: making.moved(making.UP if lift else making.DOWN, far),
    "lift",
)(
    lift=table(
        {
            asked_form("raise") + "|rises|floats|(a) (little|small|slight|gentle|tiny) lift": True,
            any_form("lower"): False,
        },
        reserve=False,
    ),
    far=_far,
    ground=_ground,
)
# Copies
_times = either(
    ~literal("like|about|say|maybe|some") + number + ~literal("x|times|of [them|it|him|her|these|those]"),
    literal("another|one more|a second|an extra|a new|a further|an additional|one other|a")
    + unless(literal("shade|tone|color|look|kind|version of"))
    >> (lambda: 1.0),
    literal("x") + number,
    table({"once": 1.0, "twice": 2.0, "two times": 2.0, "thrice": 3.0}),
)
_copy_noun = literal(
    "[copy|copies|clone|clones|duplicate|duplicates|replica|replicas|double|twin|doubles|twins|duplication|instances|"
    "version|versions] (of)"
)
_command("copy the dog to the left", making.copied, "copy")(
    who=~literal("of|for") + thing,
    copy=either(
        unless(silent(fraction_of("size|sizes|scale|speed|height|width|length|in size")))
        + (
            literal(any_form("copy"))
            | ~literal("more|extra|other|identical|additional|new|second|single|ghostly") + _copy_noun
        ),
        literal("[more|another|extra|second] [one of|ones of]|one more of|[another|one more|a second] one")
        | literal("one more|another") + unless(silent(familiar)) + unless(literal("one|time|step|turn|bit")),
    ),
    verb=literal(any_form("add")),
    times=_times,
    **BESIDE_IT,
)
_command("one dog more", making.copied, "times extra", NAMED)(
    who=known_noun,
    verb=literal(any_form("add") + "|there is|there are|be there"),
    times=number,
    extra=literal("[more|extra|additional|again|further] (of the same (kind|sort)|like it|like that)"),
    **BESIDE_IT,
)
_command("add another dog", making.copied, "times", NAMED)(
    who=~literal("of") + known_thing,
    verb=literal(any_form("add") + "|there is|there are|be there"),
    times=either(
        number + literal("more|other|extra|additional|further"),
        literal("another|one more|a second|an extra|an additional|a further") >> (lambda: 1.0),
        literal("the same|same") + unless(unless(silent(familiar))) >> (lambda: 1.0),
    ),
    **BESIDE_IT,
)


def _trail(times: float | None = None, shift: TimeExpression = TRAIL_LAG, single: bool = False) -> Any:
    return making.copied(times=times or (1.0 if single else TRAIL_COPIES), shift=shift)


_command("let a copy follow the dog half a second behind", _trail, "trail", NAMED)(
    who=unless(literal("[a|an|the|another|one] [ghost|echo|copy|clone|duplicate|twin|trail]"))
    + ~literal("of|behind|after|for|on|to")
    + thing,
    trail=~literal("(a|an|some|the|that|which|who) (fading|ghostly|faint|transparent|soft|see through)")
    + (
        here(lambda reading, at: reading.word(at - 1) in BEFORE_VERBS) + literal("ghost")
        | literal("delayed|lagging|late|trailing|following|time shifted")
        + here(lambda reading, at: _copy_noun.at(reading, at))
        | literal(
            "trail|trails|[motion|ghost|light] [trail|trails]|[ghost|after] [image|images]|streaks|motion streaks|ghosting|"
            "echoing|trailing|echo|echoes|afterimage|afterimages|ghosts|trailing copies|onion skin|onion skinning|"
            + any_form("follow")
            + "|echo effect"
        )
    ),
    copies=literal(
        "(by|of|some|few|a few|several|ghost|ghostly|faint|with) [copies|clones|ghosts|echoes|duplicates|of it|of "
        "itself|of him|of her|ghostly copies]"
    ),
    single=either(
        literal("(a|one|another|the|an identical|a second) [copy|clone|ghost|duplicate|second one|twin]"),
        literal("a second|another|an identical|one more|an extra|the same")
        + unless(literal("copy|ghost|clone|one"))
        + ~(silent(familiar) + unless(literal("that|which|who"))),
    )
    >> (lambda: True),
    times=~literal("of|with|by|plus|and|+") + unless(literal("a")) + _times,
    verb=literal(_LIGHT + "|" + any_form("add")),
    behind=literal(
        "behind it|behind him|behind her|after it|behind itself|behind|it|itself|him|her|the original|the first (one)|the real one"
    ),
    shift=SHIFT
    | ~literal("with a lag of|at|every|each|by|with|spaced")
    + duration
    + ~literal(
        "apart|later|late|behind|offset|between each (one)|between (each of) them|delay|of delay|lag|offset (each)|each|between "
        "them|intervals|after it"
    ),
)

# Time
_motion = whose(
    "motion|motions|movement|movements|action|animation|walk|run|jump|dance|ride|spin|turn|flight|swing|fall|kick|leap|hop"
)
_command("freeze the dog at frame 30", always(making.frozen), "verb", WHOLE)(
    who=_about + thing
    | literal("time|the clock|the action|the playback|playback|the motion|all motion|all movement") >> _the_clip,
    lead=literal(
        every_form("bring|come|hang|stand|stay|sit|remain|float|hover")
        + "|as a [still|freeze frame]|(in) [his|her|its|their|the|that|this] [pose|position|posture|stance|posing|gesture]"
    ),
    verb=literal(
        any_form("freeze")
        + "|to a [stop|halt|standstill]|still frame|freeze frame on|hold the frame|motionless|standing still|not move|no "
        "movement|stop|stopped|(perfectly|completely|absolutely) [still|motionless|frozen]"
    ),
)
_RESUMED = every_form("go|come|carry|walk|move|run|drive|ride|swim|fly|roll|jump|dance|jog|play|skate|sail")
_playing = _motion | _about + thing
_command("play the dog in reverse", always(making.reversed), "verb", WHOLE)(
    who=_playing,
    verb=either(
        literal(any_form("reverse") + "|backward|in reverse|reversed|the other way around in time"),
        literal(any_form("run")) + silent(qualities.backward),
    ),
)
_command("repeat the dog from second 1 to 2", always(making.looped), "again", WHOLE)(
    who=_motion | _about + thing + ~literal("'s"),
    verb=literal(any_form("run", "loop")),
    again=literal(
        any_form("loop")
        + "|on (a) loop|in a loop|on repeat|over and over (again)|again and again|endlessly|forever|in an endless loop|"
        "as a loop|a loop|repeatedly|looping"
    ),
)
_x_times = number + literal("x") | literal("x") + number
_command("make the dog 2x", making.scaled, "verb by")(
    verb=literal(every_form("make|get|want|need|blow")), by=~literal("to|up to") + _x_times
)
_command("play the dog at 2x", making.retimed, "verb by", TIMED)(
    who=_playing,
    verb=literal(any_form("run")) + here(lambda reading, at: reading.word(at - 1) not in _MERELY),
    by=~literal("at|with|in|to") + _x_times
    | literal("at|to") + percent + unless(literal("transparent|visible|opacity|opaque|of")),
)
_command("slow motion, please", as_given, "values", WHOLE)(
    who=_playing,
    verb=literal(any_form("run")),
    values=either(_pace_of, qualities.pace, qualities.backward) >> _alone,
)


# Colours of others, names
_ENDING = word_set("and then but so please now from")
"""Words behind a name that are no part of it."""
_command("call the dog rex", making.named, "verb called", NAMED)(
    verb=literal(every_form("call|name|label|tag|dub|nickname|rename|relabel")),
    called=~literal("as|to")
    + here(lambda reading, at: reading.word(at - 1) not in ("the", "my", "that", "this"))
    + unless(here(lambda reading, at: reading.word(at) in IMPERATIVES))
    + name
    + here(lambda reading, at: not reading.word(at).isalpha() or reading.word(at) in _ENDING),
)

# Focus, light
_bit_of = ~literal("some|a|an|a bit of|a little|a touch of|the") + optional(
    table(
        {
            "(very) [slight|soft|light|gentle|little|subtle|small|faint|tiny|mild]|touch of|hint of|bit of": Amount(
                "small"
            ),
            "(very) [strong|heavy|thick|bright|intense|big|huge|hard|massive]|lot of": Amount("large"),
        },
        reserve=False,
    )
)
_doing = unless(_has_to_go) + literal(_LIGHT)


def _haloed(light: tuple[Amount | None, Any], rgb: Any = None) -> Value:
    how, own = light
    if own is not None and rgb is not None:
        raise Mismatch
    return making.glowing(how, own or rgb)


_radius = ~literal(",|with|by|(") + ~literal("a") + literal("radius (of|=|:)") + number + ~literal(")") >> (
    lambda x: Amount("to", x)
)
_command("put a slight blur on the dog", lambda how=None, radius=None: making.blurred(radius or how), "how")(
    verb=_doing,
    radius=_radius,
    how=_bit_of
    + literal("(gaussian|lens|soft|depth|background|motion) [blur|blurring|defocus|bokeh|haze] (effect|filter|on|to)"),
)
_command("blur the background", making.blurred, "verb")(
    who=_whom | whose("edge|edges|outline|border|borders"),
    verb=literal(
        any_form("blur")
        + "|anonymous|illegible|unreadable|out of focus|unsharp|blurry|in soft focus|soft focus|fuzzy|less sharp"
    ),
    how=~literal(",") + softly
    | ~literal("by") + number + literal("unit|units") >> (lambda x: Amount("to", x))
    | _radius,
)
_command("add a soft blue glow around the dog", _haloed, "light")(
    verb=_doing,
    light=~literal("with")
    + _bit_of
    + qualities.shade_of
    + optional(colour)
    + literal(
        "(neon|light|outline) [glow|shimmer|halo|shine|aura|gleam|sheen|bloom|radiance|emission|luminescence|phosphorescence|"
        "fluorescence|incandescence|glimmer|sparkle|nimbus|corona|afterglow|emissive] (of light) (effect)"
    )
    >> (lambda how, rgb: (how, rgb)),
    rgb=~literal("in|in a|with") + colour + ~literal("light|color"),
)
_command("make the dog glow", making.glowing, "verb")(
    verb=literal(any_form("glow") + "|aglow|luminous|radiant") + ~literal("on|effect|in the dark"),
    how=softly | ~literal("by|at") + percent >> (lambda x: Amount("fraction", x)),
    rgb=_a + ~_slight + qualities.shade_of + colour + ~literal("light|color|tone|shade|hue"),
)

# Two things
_spots = literal("place|position|spot|location|places|positions|spots|locations")
_command("swap the dog and the cat", making.swapped, "verb", NAMED)(
    who=~literal("(the) [places|positions|spots|locations|place|position] [of|between]|between|of")
    + (two_of_them | thing)
    + ~(literal("'s") + _spots),
    verb=literal(any_form("swap") + "|swap of"),
    other=literal("with|for|and") + there_already + ~(literal("'s") + ~_spots),
    places=literal(
        "(the|their) [places|positions|spots|locations|place|position] (of|with)|with each other|with one another|around|over"
    ),
)


# Opacity that comes and goes


_fading = ~literal("(a|some) (slow|gentle|soft|quick|smooth|nice|long|short|gradual)")
_command("fade out the dog", making.faded, "verb", TIMED)(
    verb=_fading + literal(any_form("vanish")),
    inward=unless(silent(span))  # "faded out in the last second"
    + table(
        {
            "in|up|into view|in from nothing|in from black": True,
            "out|away|from view|to nothing|to zero|into nothing|completely": False,
        },
        reserve=False,
    ),
    by=literal("to") + (percent | fraction),
)
_command("fade in the dog from second 1 to 2", always(making.appearing), "verb", TIMED)(
    verb=_fading + literal(any_form("appear")),
)

_command("fade to black at the end", making.fading_to, "verb rgb", WHOLE)(
    verb=literal(every_form("fade|dissolve|dip|go|fade out|fade slowly")),
    rgb=literal("[to|into|out to|down to] (a|solid|pure|full|total|complete)") + colour,
)

# What refers to what was said before


_command("the cat too", AGAIN, "again", NAMED)(
    verb=literal("do|it|that|this|make it|apply it|apply that|go on|continue|and|be"),
    again=literal(
        "(and) so [too|should|must|shall|does|do|is|are|can] (too)|as well as|along with|together with|again (but) "
        "[with|for|to|on]|ditto (for|with|on)|[do|apply|repeat] [that|this|it] (again) (but) [with|for|to|"
        "on]|too|as well|also|the same|same|likewise|the same thing|same thing|the same way|same again"
    )
    | literal("then|and then") + here(lambda reading, at: not {*reading.words[: at - 1]}.isdisjoint(IMPERATIVES)),
)
_command("and nothing else", REMARK, "nothing", WHOLE)(
    nothing=literal(
        "[keep|keeping|retain|without changing|do not change|leave] [its|the|their] (original|current|own) [color|colors|size|"
        "shape|position|place|speed|look|brightness]|nothing else ([changes|moves|should change])|nothing more|that is [all|it]|"
        "only that|[keep|leave] the rest|the [rest|others] ([can|may|should|must]) [stay|stays|remain|remains|is|are] (there|fine|"
        "as [it|they] [is|are])|(its|the|their) [position|place|size|color|colors|speed|look] [stays|remains] [untouched|unchanged|"
        f"the same|as it is]|(then) let [it|him|her|them] ([go|keep]) [continue|resume|{_RESUMED}] (on|again|as before)"
    )
)
