"""Commands that belong to no single operation: qualities and more or less of them, complaints, remarks, and references back.

Between the phrases there may be words that add nothing; every other word has to belong to a phrase. The phrases of one operation
stand in its file, in `sentences`.
"""
# ruff: noqa: F401  # phrases name what they are made of

from __future__ import annotations

from typing import Any

from ..language.amounts import LEAST_PERCENTS, amount, degree, fraction_of, multiple, no_stop, number, percent
from ..language.colours import colour
from ..language.courtesies import ASIDE, CALLS, COMMENTS, WISHES
from ..language.degrees import Amount
from ..language.grammar import either, here, keyword, listed, literal, optional, silent, table, unless
from ..language.lexicon import PICTURE, every_form
from ..language.notation import Notation
from ..language.refusal import Mismatch
from ..language.times import span
from ..language.verbs import IMPERATIVES, any_form
from .change import SHOWN
from .english import (
    AGAIN,
    LEVEL,
    LIGHT_VERBS,
    NAMED,
    QUALITY_WORDS,
    REMARK,
    WHOLE,
    Command,
    Quality,
    Remedy,
    about,
    as_given,
    command,
    has_to_go,
    over,
    phrase,
    the_clip,
    toward,
    whom,
)
from .operation.grade import warmed
from .operation.recolour import more_of
from .operations import kinds
from .phrases import colors, thing, two_of_them_behind, untouched, whose
from .selects import All, Current
from .values import Graded, Value, refused

SENTENCES = [kind.sentences() for kind in kinds()]
"""The sentences of each operation."""
QUALITIES: tuple[Quality, ...] = tuple(quality for kind in SENTENCES for quality in kind.qualities)
"""Qualities that things have more or less of."""


_TOO: dict[str, tuple[Value | None, Value | None]] = {
    words: ways for kind in SENTENCES for words, ways in kind.too.items()
} | {
    words: (quality.helps(upward), quality.helps(not upward))
    for quality in QUALITIES
    for words, _, upward in quality.complaints()
}
"""Quality -> what is done where there is too much of it, and where there is not enough."""
_rather = ~literal(
    "far|way|much|a bit|a little|a little bit|rather|really|still|just|slightly|quite|somewhat|a tad|a touch"
)
_too = table({words: too for words, (too, _) in _TOO.items() if too}, reserve=False)
_less_of = colour >> (lambda rgb: Remedy(more_of(rgb), False))
_excess = table(
    {words: q.helps(upward) for q in QUALITIES for _, words, upward in q.complaints() if q.helps(upward)}, reserve=False
)
_not_enough = table({words: more for words, (_, more) in _TOO.items() if more}, reserve=False) + keyword("enough")
_say = Notation(globals())
too_much = _say("<_rather> too <_rather> [<_too>|<_less_of>]|(<_rather> too) <_excess>|not <_not_enough>")
"""Values against too much or too little of a quality."""
rather = _say(
    "[a (little) bit|a little|rather|kind of|somewhat|slightly|a tad|a touch|quite|terribly|awfully|horribly|dreadfully|painfully|"
    "blindingly|ridiculously|overly|excessively|annoyingly|unbearably] <_too>"
)
"""Values for complaints such as "it is a bit dark"."""
simply = optional(degree) + ~literal("more|really|very|rather|quite") + table(
    {words: (quality, upward) for quality in QUALITIES if quality.wished
     for words, upward in ((quality.much, True), (quality.little, False))},
    reserve=False,
) >> (lambda how, complaint: complaint[0].changed(how, complaint[1]))  # fmt: skip
"""A quality without "more" or "less": "the sand should be dark"."""

made = either(
    *(quality.value for quality in QUALITIES if quality.bare is None),
    *(rule for kind in SENTENCES for rule in kind.made),
)
"""Phrases that may follow "make the dog"."""
_WANTED = (
    "needs|wants|requires|deserves|is in need of|calls for|is crying out for|[should|must|could|can|may|will|would|shall|has "
    "got to|have got to|has to|have to|needs to|need to|ought to|is to|are to|wants to|want to|is supposed to|are supposed to|"
    "might|is meant to|are meant to|was meant to|had better|should have|ought to have|had best|do need to]"
)
_goes_on = unless(literal("and|but")) + here(lambda reading, at: reading.word(at).isalpha())
ADDS_NOTHING = either(
    CALLS,
    WISHES,
    COMMENTS,
    silent(ASIDE),
    literal(f"{_WANTED} (to) ([be|become|get|turn|look|appear|stay|end up|have|been|gone|become])"),
    literal(f"[{_WANTED}] (to) go") + unless(over),  # what has to go is to be gone
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
    literal("(with) (the|its|his|her) [shadow|shadows|reflection|reflections] [included|inclusive|and all]"),
    literal("afterward|after that|from then on|thereafter") + here(lambda reading, at: at == len(reading.tokens)),
    literal("(up|down) [on|around|about|to|with] [it|him|her|them]") + over,
    literal(
        "(,) (with) (the|its) pivot (point) (is|at|on|=|:) (the|its|his|her|their) [base|bottom|feet|ground|floor]|(around|about) "
        "(the|its) (own) [up|vertical] (axis)"
    ),
    literal("too") + unless(_goes_on),
    literal("both") + unless(silent(two_of_them_behind)),
    literal("clean plate"),
)
"""Courtesies, and verbs that say no more than that something is done."""

_joined = literal("and|,|, and|but|plus|and also|as well as|+")
_quality = either(
    *(rule for kind in SENTENCES for rule in kind.given),
    _say(
        "<toward> <made> (tone|tones|mood|look|light|feel|grade|grading|color|colors|feeling|picture|image|clip|video|scene|shot|"
        "footage)"
    ),
    *(rule for kind in SENTENCES for rule in kind.alone),
    _say(
        "(a|the|nice and|pretty|in a|feel|look|looking|feeling) <simply> (tone|tones|mood|look|light|color|colors|filter|grade|"
        "overlay|cast|wash)"
    ),
)
_becoming = either(
    unless(literal("tones|shades|looks|seems|feels") | has_to_go) + literal(any_form("match") + "|" + LIGHT_VERBS),
    literal("push") + here(lambda reading, at: {"back", "backward"}.isdisjoint(reading.words)),
)
_nouns = table(
    {quality.noun: (quality, True) for quality in QUALITIES}
    | {quality.lack: (quality, False) for quality in QUALITIES},
    reserve=False,
)
"""A quality, and whether the noun is of it or of what it lacks."""
_quality_noun = _say(
    "(punch|oomph|bite|kick|pop|boost) (the|a|'s|some|of|in|to|with [the|its|his|her|their]) "
    "((the) (overall|whole|entire|general)) <_nouns> (level|value|slider|amount|setting)"
)
_way = table(
    {
        any_form("more")
        + "|add|adds|adding|give|lend|up|upward|more|higher|stronger|extra|plus|+|additional|some more|a bit of|increased|some|"
        "greater": True,
        any_form("less") + "|back|down|downward|less|lower|weaker|minus|-|reduced|fewer|reduction|decrease": False,
    }
    | {words: words for quality in QUALITIES for words in (quality.more, quality.less) if words},
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
_in_a_time = here(lambda reading, at: any(end > at for i in range(max(at - 5, 0), at) for end in span.at(reading, i)))
_to_value = _say(
    "!<_in_a_time> [to|at|=|:|be|of|is] (about|around|exactly|only) [<percent>|<multiple>|<number>] (of [its|the|their] "
    "(original|current|normal|present) (value|size|speed|brightness|level))"
)
"""Values of qualities."""


def _changed(
    quality: tuple[Quality, bool],
    way: bool | str | None = None,
    how: Amount | None = None,
    to: float | None = None,
    level: float | None = None,
) -> Value:
    changed, of_it = quality[0].changed, quality[1]
    if isinstance(way, str):  # "warmer" is no more of the light
        if way not in (quality[0].more, quality[0].less):
            raise Mismatch
        way, of_it = way == quality[0].more, True
    if level is not None:  # "contrast 80 %" is what it comes to, "contrast up 20 %" how much more it gets
        if (how, to) != (None, None):
            raise Mismatch
        if level > 1 and way is not None:  # 150 % more is rarely meant
            raise Mismatch
        to, how = (level, None) if way is None else (None, Amount("fraction", level))
    if how is not None and how.kind == "times" and way is to is None:  # "twice the size"
        return changed(Amount("as", how.value), of_it)
    if to is not None:
        to = to / 100 if to > SHOWN else to
        if not quality[0].at_most_all and way and to < 1:
            raise Mismatch
        if (way is not None and how is not None) or to > SHOWN:
            raise Mismatch
        return changed(Amount("as", to if of_it else 1 - to), True)
    if way is None:
        raise Mismatch
    return changed(how, way is of_it)


def _percents(x: float) -> float:
    """Return `x` percent, or the factor `x` where it is below 5; Mismatch for more than 100."""
    if x > 100:
        raise Mismatch
    return x if x < LEAST_PERCENTS else x / 100


def _by_number(x: float) -> Amount:
    return Amount("times", x) if x < LEAST_PERCENTS else Amount("fraction", _percents(x))


_by_how_much: dict[str, Any] = {
    "verb": "![add|adds|adding|added] [{set,become,apply}]",
    "way": _way,
    "level": percent
    | here(lambda reading, at: reading.word(at - 1) != "to") + phrase("<number> ![x|times|stop|stops]") >> _percents,
    "how": amount
    | phrase("by <number>") >> _by_number
    | literal("way") >> (lambda: Amount("large"))
    | _times_as_much >> (lambda x: Amount("times", x)),
    "to": _to_value,
}
"""Amounts more or less of a quality, or values that it reaches."""
_SIDES: dict[str, tuple[Graded, bool | None]] = {
    sense: (quality.changed, upward)
    for quality in QUALITIES
    for sense, upward in ((quality.up, True), (quality.down, False), (quality.sets, None))
    if sense
} | {sense: side for kind in SENTENCES for sense, side in kind.verbs.items()}
"""Sense of a verb -> what it makes more or less."""


def _more(verb: tuple[Graded, bool | None], how: Amount | None = None, to: float | None = None) -> Value:
    changed, upward = verb
    if upward is None and to is None:
        if how is None or how.kind not in ("times", "fraction"):
            raise Mismatch
        to = how.value
    if to is not None:
        if changed is warmed:
            raise Mismatch
        if upward is not None and (to > 1) is not upward and to != 1:
            return refused(f"To {to:.0%} is {'less' if upward else 'more'}, not {'more' if upward else 'less'}.")
        return changed(Amount("as", to), True)
    return changed(how, bool(upward))


_complained = either(
    literal("it|this|that|its") >> (lambda: lambda context: context.last or (Current() if context.selected else All())),
    ~literal("the|all the") + colors,
    literal("(the) [white balance|color temperature|exposure|overall look|overall color|grade|lighting]") >> the_clip,
    thing,
)
"""The target of a complaint."""
COMMANDS: list[Command] = [
    command(
        "take it down by 20 %", LEVEL, "up how", NAMED, "it|that|this|them",
        verb="{=take/bring/knock/pull/push/dial/turn/tone/ease/drop/lift/raise/lower/crank/tame/move/go}",
        up={"up|more|higher|raise|lift": True, "down|back|less|lower|drop|tame|off": False}, how=amount,
    ),
    command(
        "but leave the dog as it is", REMARK, "spared", NAMED, verb="{=leave/keep/let/stay/remain}", spared=untouched
    ),
    command(
        "do not touch the dog", REMARK, "spared", NAMED,
        spared="do not [touch|change|affect|alter]|without [touching|changing]|[ignore|skip]|never [touch|change]",
    ),
    *(one for kind in SENTENCES for one in kind.early),
    command(
        "make the dog red", as_given, "values", verb=_becoming, values=listed(_quality, _joined), who=whom | about
        + whose("color|colors|coloring|look|appearance|material|texture|finish|paint|paintwork|paint job|shade|tint|light"),
        light="(the|its|their|a) [key|fill|rim|back|side|top|main|ambient|overall] [light|lights|lighting]",
    ),
    command(
        "increase the contrast of the dog", _changed, "quality", WHOLE,
        whom | literal("its|their|his|her") >> (lambda: lambda context: context.it("'its'")),
        quality=_quality_noun, **_by_how_much,
    ),
    command(
        "darken the sky", _more, "verb",
        verb=either(*(table({any_form(sense): made}, reserve=False) for sense, made in _SIDES.items())),
        how=amount | phrase("by <number>") >> (lambda x: Amount("times", x)),
        to=phrase(
            "[(to|down to|up to|at|by|until) <size>|[to|down to|up to|at|until] [<fraction>|<percent>|"
            "<multiple>|x <number>]|<half>|until [it|he|she|they] [is|are] <multiple> as [big|tall|large|high|"
            "long|wide|small|fast|bright]] (of [its|the|their|his|her] (original|normal|present|current) "
            "[size|speed|brightness|pace]|of what it [is|was] (now|before)|[size|speed|the size|the speed|its "
            "size|opacity])", half=table({"in half|by half|by a half": 0.5}, reserve=False) + no_stop,
            size=fraction_of("size|sizes|dimensions|scale|height|width|length|speed|pace|tempo|brightness"),
        ),
        particle="(right|way) [up|down]|in size|in tempo|more|even more|further|([keeping|with]) ([from|about|"
                 "around|at|on]) [its|the|their|his|her] [base|bottom|feet|foot|ground] ([planted|fixed|on "
                 "the ground|in place|where it is|where they are])",
    ),
    command(
        "the dog is too dark", REMARK, "complaint", who=~literal("on|in|for") + _complained,
        complaint=phrase(
            "[is|are|'s|looks|look|seems|seem|feels|reads] <rather>|(is|are|'s|looks|look|seems|seem|feels|"
            "reads|comes across as|appears|appear|was|it is|has|have|(is|are) "
            "[{=happen/walk/run/move/go/play/drive/stand/sit/ride/swim/fly/dance/hang/lie/jump/turn/spin/hover"
            "/float}]) [<too_much>|<ugly>]", rather=rather, too_much=too_much,
            ugly=phrase(f"(a bit|a little|much|way|far|so|very|rather|quite|really|too) [{QUALITY_WORDS}]") >> (lambda: None),
        ),
    ),
    *(one for kind in SENTENCES for one in kind.commands),
    command(
        "the cat too", AGAIN, "again", NAMED, verb="do|it|that|this|make it|apply it|apply that|go on|continue|and|be",
        again=literal(
            "(and) so [too|should|must|shall|does|do|is|are|can] (too)|as well as|along with|together with|again (but) "
            "[with|for|to|on]|ditto (for|with|on)|[do|apply|repeat] [that|this|it] (again) (but) [with|for|to|"
            "on]|too|as well|also|the same|same|likewise|the same thing|same thing|the same way|same again"
        )
        | literal("then|and then") + here(lambda reading, at: not {*reading.words[: at - 1]}.isdisjoint(IMPERATIVES)),
    ),
    command(
        "and nothing else", REMARK, "nothing", WHOLE,
        nothing="nothing else ([changes|moves|should change])|nothing more|that is [all|it]|only that|(then) let "
        "[it|him|her|them] ([go|keep]) [continue|resume|{=go/come/carry/walk/move/run/drive/ride/swim/fly/roll/jump/dance/jog/play"
        "/skate/sail}] (on|again|as before)",
    ),
]  # fmt: skip
"""In the order in which they are preferred."""
