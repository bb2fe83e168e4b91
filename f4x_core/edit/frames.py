"""Commands in any order of their words: verb, thing, quality, amount, direction and time wherever they stand.

The table of `commands` is asked first; what it does not understand is read here. Between the phrases there may be words that add
nothing; every other word has to belong to a phrase.
"""

from __future__ import annotations

from typing import Any

from ..language.amounts import Amount, amount, degree, distance, factor, fraction, multiple, number, percent, steps
from ..language.colours import colour, colourish
from ..language.grammar import Mismatch, Rule, constant, either, listed, optional, said, silent, table
from ..language.lexicon import every_form
from ..language.times import duration
from . import making, qualities
from .commands import (
    AGAIN,
    ANGLE,
    BESIDE_IT,
    DELETING,
    KEEPING,
    OUT,
    REMARK,
    ROTATING,
    SENSE,
    SHIFT,
    SPLIT,
    TILTING,
    TRAIL_COPIES,
    TRAIL_LAG,
    Command,
)
from .making import Value
from .phrases import everything_else, known_noun, known_thing, place, thing, two_of_them

FRAMES: list[Command] = []
"""In the order in which they are preferred."""


def _frame(
    example: str, make: Any, needed: str, *, who: Rule = thing, whole: bool = False, bare: bool = True, **slots: Any
) -> None:
    FRAMES.append(
        Command(example, "", make, slots, frozenset(needed.split()), who, gapped=False, whole=whole, bare=bare)
    )


ADDS_NOTHING = either(
    said(
        "hey|hi|hello|okay|alexa|siri|google|computer|assistant|buddy|mate|dude|mummy|mum|mom|dad|daddy|look|listen|um|uh|er|"
        "hmm|oh|"
        "well|so|now|then|next|also|too|as well|just|simply|actually|really|maybe|perhaps|probably|somehow|quickly|for now|"
        "right away|"
        "for me|for us|if possible|if you [can|could|would|like|will]|when you can|instead|again|there|here|over there|"
        "altogether|all|"
        "full on|exactly|properly|nicely|a nice|nice|lovely|or so|or something|or something like that|kind of|sort of|"
        "you know|after all|"
        "i think|i guess|i feel like|i believe|this time|from there|in one go|of course|though|yeah|yes|hmm|asap|my friend|sir|both"
    ),
    said(
        "[could|can|would|will] you|[could|can|may|shall] [we|i]|[i|we] [want|wanted|need|wish|prefer|fancy]|"
        "[i|we] would [like|love|prefer]|[i|we] would rather have|(i want|i would like|i need) you|you [should|could|can|may|must]|"
        "let us|let me|go ahead and|try to|help me (to)|make sure (that)|so that|in such a way that|how [do|can|would|"
        "could] [i|you|we]|"
        "how to|what if|what about|how about|is there [a|any] way to|is it possible to|would it be possible to|"
        "it would be [nice|great|cool]"
        " (if)|i am looking for|i am trying to|we are going to|i am going to|[my|the] [wish|idea|plan] is (that|to)|"
        "your task is to|time to|"
        "see|to see|have|to have|to get|want|would like"
    ),
    said(
        "[should|must|could|can|may|will|would|shall|has to|have to|needs to|need to|ought to|is to|are to|to|is supposed to|"
        "are supposed to|might] ([be|become|get|turn|go|look|appear|stay|end up|have])|"
        "[become|becomes|becoming|being|be|gets|ends up|end up|ending up|comes out|stays] (as)|for it to|for them to"
    ),
    said(
        every_form("make|let|have|get|do|keep")
        + "|start|begin|every frame|each frame|going|in the [scene|picture|video|clip]|for good|permanently"
    ),
    said(",|:|->|=>|=|-|!|(|)"),
)
"""Requests, wishes, interjections."""

_joined = said("and|,|, and|but|plus|and also|as well as")
_led = Rule(lambda reading, at: {at: ()} if reading.word(at) in ("at", "in", "with") else {})
"""Qualities need no "and" between them where a preposition stands: "backwards at half speed"."""
_toward = ~said(
    "in|to|into|as|with|at|by|toward|of|being|it|them|more like|like|rather|old film|vintage|old|classic|nice|solid|some"
)
_noun_of_colour = either(
    ~said("a|an|some|the")
    + ~said("slight|faint|light|soft|subtle")
    + (colour | colourish)
    + said("tint|tinge|touch|shimmer|cast|wash")
    >> making.faintly,
    ~said("a|an|some|the") + colour + said("color|paint|shade|coat|hue|coat of paint|paint job|version|one|variant")
    >> making.assigned,
    said("the color") + colour >> making.assigned,
)
_instead_of = ~(
    said("instead of|rather than|and not|not") + ~said("in") + silent(colour | colourish | said("this|that"))
)
_looked = either(
    _toward + ~said("pure|solid|a|an|some|the") + qualities.any_look + ~qualities.effect >> making.styled,
    said("like|as") + ~said("a|an|some|the|pure|solid|made of|in") + qualities.any_look + ~qualities.effect
    >> making.styled,
    ~said("a|an|the") + qualities.any_look + qualities.effect >> making.styled,
)
_more_opacity = (
    either(
        ~said("like|about|roughly|only|just|say") + percent + said("[visible|opacity|opaque|alpha|visibility]"),
        said("see through|transparent|translucent")
        + ~said(",|like|about|say|so")
        + percent
        + said("visible|opacity|opaque"),
        said("opacity|alpha|visibility") + ~said("of|to|at|=|is|down to") + (percent | fraction),
        percent + said("transparency|see through|transparent|translucency") >> (lambda x: 1 - x),
        said("transparency|translucency") + ~said("of|to|at|=|is") + (percent | fraction) >> (lambda x: 1 - x),
    )
    >> making.opacity
)
_pace_of = either(
    ~said("at|with|in|to")
    + (
        fraction
        | table(
            {"three quarter": 0.75, "quarter": 0.25, "two third": 2 / 3, "one third": 1 / 3, "half": 0.5}, reserve=False
        )
    )
    + said("speed|the speed|pace|tempo|of [the|its] speed")
    >> making.retimed,
    ~said("at|with|in|to") + (percent | multiple | number + said("x")) + said("speed|pace|tempo") >> making.retimed,
    multiple + table({"slower": -1, "faster": 1}) >> (lambda x, way: making.retimed(x if way > 0 or x < 1 else 1 / x)),
    said("slow mo|slowmo|slo mo|slomo|slow motion|in slow mo") >> (lambda: making.retimed(0.5)),
    said("in fast forward|fast forward|fast motion|in fast motion|time lapse|timelapse")
    >> (lambda: making.retimed(2.0)),
)
_size_of = (
    either(
        ~said("at|to|in")
        + ~said("a")
        + (multiple | percent | number + said("x"))
        + ~said("of")
        + ~said("its|the|their|his|her|original|normal")
        + ~said("original|normal|current")
        + said("size|scale|as big|as large|as tall"),
        ~said("at|to|in")
        + said("a")
        + (fraction | percent)
        + said("of [its|the|their|his|her] (original|normal|current) [size|height]"),
        said("to the size of") + multiple,
    )
    >> making.scaled
)
_quality = either(
    _toward + qualities.made,
    _toward + qualities.without_colour,
    _noun_of_colour,
    _looked,
    qualities.given_look,
    _more_opacity,
    _pace_of,
    _size_of,
    qualities.pace,
    _toward + qualities.backward,
    _toward + qualities.opacity_value,
    ~said("a|the|more|really|very|rather|quite|nice and|pretty|in a|feel|look|looking|feeling")
    + qualities.simply
    + ~said("tone|mood|look|light"),
    _toward + qualities.bare_look,
)
_becoming = said(
    every_form(
        "make|turn|render|change|convert|transform|give|paint|color|recolor|dye|tint|set|put|get|let|play|run|use|apply|do|"
        "keep|switch|"
        "bring|show|adjust|display|look|feel|appear|become|have|go|seem"
    )
)
_about = ~said("of|for|on|to|in|with|around|about|onto|over|at|from")
_whom = ~said("but|and") + ~said("only|just|only for|just for|only with") + _about + thing
_frame(
    "the dog, in red",
    lambda quality: quality,
    "quality",
    who=_whom,
    verb=_becoming,
    more=said("still|even|even more|a step"),
    quality=listed(_quality + _instead_of, _joined | _led),
)
_frame(
    "brighter and more vivid",
    lambda quality: quality,
    "quality",
    whole=True,
    quality=listed(
        either(
            qualities.brightness_value,
            qualities.saturation_value,
            qualities.contrast_value,
            qualities.warmth_value,
            qualities.pop,
        ),
        _joined | _led,
    ),
)

# More and less of a quality
_QUALITIES = {
    "size|scale|dimensions": making.scaled,
    "speed|pace|tempo|playback speed|playback rate|velocity": making.retimed,
    "brightness|light|luminance|exposure|lightness|luminosity": making.brightened,
    "contrast": making.contrasted,
    "saturation|color saturation|color intensity|vibrance|vividness|colorfulness|chroma": making.saturated,
    "opacity|visibility|alpha": making.opacity,
    "transparency": lambda by: making.opacity(max(2 - by, 0.0)),
    "warmth|color temperature|temperature": lambda by: making.warmed(Amount("fraction", abs(by - 1)), by > 1),
    "blur|blurriness|softness": lambda by: making.blurred(Amount("large" if by > 1.5 else "small")) if by > 1 else None,
}
_way = table(
    {
        every_form(
            "increase|raise|boost|turn up|bump up|crank up|pump up|dial up|bring up|push up|strengthen|enhance|intensify|push|"
            "bump|lift|"
            "add|pull up|amplify|double"
        )
        + "|up|upward|more|higher|stronger|extra|plus|+|additional|some more|a bit of|increased|some": True,
        every_form(
            "reduce|decrease|lower|turn down|cut|cut down|lessen|tone down|bring down|dial down|weaken|diminish|drop|"
            "take down|cut back|"
            "pull down|take back|pull back"
        )
        + "|down|downward|less|lower|weaker|minus|-|reduced": False,
    },
    reserve=False,
)
_too = ~said("far|way|much|a bit|a little|rather|really|still|just") + table(
    {"too [high|much|strong|big|large|great|heavy|intense]": False, "too [low|little|weak|small|faint]": True,
     "not [high|much|strong|big|large] enough|not enough": True}, reserve=False
)  # fmt: skip
_to_value = (
    said("to|at|=|:|be|of|is")
    + ~said("about|around|exactly|only")
    + either(percent, multiple, number)
    + ~said("of [its|the|their] (original|current|normal|present) (value|size|speed|brightness|level)")
)


def _changed(
    quality: Any, way: bool | None = None, how: Amount | None = None, to: float | None = None, too: bool | None = None
) -> Value:
    if to is not None:
        if (way is not None and how is not None) or to > making.SHOWN:
            raise Mismatch
        return quality(to)
    upward = way if way is not None else too
    if upward is None:
        raise Mismatch
    value = quality(factor(how, upward))
    if value is None:
        raise Mismatch
    return value


_set = said(
    every_form(
        "set|change|make|turn|put|bring|adjust|take|get|give|have|need|show|apply|use|keep|correct|modify|tweak|fix"
    )
)
_frame(
    "the brightness of the dog, up by 20 %",
    _changed,
    "quality",
    who=_whom,
    whole=True,
    verb=_set,
    quality=~said("the|its|their|his|her|a|'s|some|of")
    + table(_QUALITIES, reserve=False)
    + ~said("level|value|slider|amount|setting"),
    way=_way,
    how=amount | said("by") + number >> (lambda x: Amount("times", x)),
    to=_to_value,
    too=~said("is|are|has|have|looks") + _too,
)
_UPWARD = {
    "brighten|lighten|brighten up|lighten up|illuminate|light up": (making.brightened, True),
    "darken|dim|darken down|dim down": (making.brightened, False),
    "enlarge|grow|magnify|scale up|blow up|upscale|upsize|expand|inflate": (making.scaled, True),
    "shrink|scale down|shrink down|downscale|downsize|minimize": (making.scaled, False),
    "speed up|accelerate|quicken": (making.retimed, True),
    "slow down|slow|decelerate": (making.retimed, False),
    "saturate": (making.saturated, True),
    "desaturate": (making.saturated, False),
    "scale|resize": (making.scaled, None),
}


def _more(verb: Any, how: Amount | None = None, to: float | None = None, fully: bool = False) -> Value:
    make, upward = verb
    if fully:
        if make is not making.saturated or upward:
            raise Mismatch
        return making.GRAYED
    if to is not None:
        return make(to)
    if make is making.saturated and not upward and how is None:
        return making.GRAYED
    if upward is None:
        raise Mismatch
    return make(factor(how, upward))


_frame(
    "the dog should be brightened a bit",
    _more,
    "verb",
    who=_whom,
    verb=either(
        *(table({every_form(verbs): made}) for verbs, made in _UPWARD.items()),
        *(
            silent(table({every_form(head): None})) + constant(made)
            for head, made in (("speed", (making.retimed, True)), ("slow", (making.retimed, False)))
        ),
    ),
    how=amount | said("by") + number >> (lambda x: Amount("times", x)) | degree,
    to=said("to|down to|up to|at")
    + either(fraction, percent, multiple)
    + ~said(
        "of [its|the|their|his|her] (original|normal|present|current) [size|speed|brightness|pace]|[size|speed|the size|"
        "the speed|its size|opacity]"
    ),
    particle=said("up|down"),
    fully=said("completely|fully|entirely|totally|all the way|to gray") >> (lambda: True),
)


_frame(
    "the dog is too dark",
    REMARK,
    "complaint",
    bare=False,
    complaint=said("is|are|looks|look|seems|seem|feels|appears|appear|was|it is|has|have") + qualities.too_much,
)

_frame(
    "it's too dark",
    REMARK,
    "complaint",
    complaint=said("its|it is|that is|this is|thats|everything is|it looks|it seems") + qualities.too_much,
)

# Taking out
_frame(
    "the dog has to be removed",
    lambda verb: making.deleted,
    "verb",
    who=_whom,
    bare=False,
    verb=table(
        {
            every_form(f"{DELETING}|clean out|take out|cut out|edit out|wipe out|rub out|throw out|throw away|take away|"
                       f"cut away|clean up|"
            "paint out|key out|clone out|crop out|pull out|kick out|chuck out|x out|leave out|rotoscope out")
            + "|gone|out of [the|this] [scene|picture|video|clip|image|shot|frame|view|movie|film]|no longer there|"
              "not there (any more)": None
        },
        reserve=False,
    )
    >> (lambda: True),
    out=OUT | said("from [the|this] [scene|picture|video|clip|image|shot|frame|view|movie|film]|completely|entirely|fully|"
                   "for good"),
)  # fmt: skip
_frame(
    "take the dog, the left one, out",
    lambda verb, out: making.deleted,
    "verb out",
    bare=False,
    verb=said(every_form(SPLIT)) >> (lambda: True),
    out=OUT >> (lambda: True),
)
_hiding = every_form(
    "hide|conceal|mask|mask out|make invisible|vanish|disappear|stop showing|not show|blank out|switch off|turn off"
)
_frame(
    "the dog has to be hidden",
    lambda verb, fully=None: making.opacity(0.0),
    "verb",
    who=_whom,
    verb=table(
        {f"{_hiding}|invisible|hidden|out of sight|do not show|not visible|not shown|not to be seen": True},
        reserve=False,
    ),
    fully=said("from [view|sight]|completely|entirely|fully|totally|for good|permanently"),
)
_frame(
    "nothing but the dog",
    lambda only, verb=None, rest=None: making.extracted,
    "only",
    who=_whom,
    bare=False,
    verb=said(f"{every_form(KEEPING)}|cut out|want|isolate|solo|be left|stay|remain|remains|left|lift|lift out|visible|there|"
              f"in it"),
    only=~said("on") + said("only|just|nothing but|solely|nothing except|alone|on [its|his|her|their] own|by itself|"
                            "all by itself|isolated|"
                          "isolate|isolating|solo|soloed|nothing else|and nothing else|no one else|and nobody else|exclusively")
    >> (lambda: True),
    rest=~_joined
    + silent(table({every_form(f"{DELETING}|hide|take out|cut out|throw out"): None}, reserve=False))
    + silent(everything_else)
    | silent(everything_else)
    + ~said("should|must|has to|can|is to")
    + said("go|be gone|gone|away|disappear|vanish|out|removed|be removed|be deleted|deleted|hidden|be hidden|goes"),
)  # fmt: skip

# Places
_moving = said(
    every_form(
        "move|shift|push|put|slide|bring|pull|drag|place|shove|carry|send|scoot|nudge|translate|position|drive|displace|set|"
        "get|drop|throw|"
        "relocate|fly|float|slip|budge|transport|take|swing|draw|tug|bump|go|jump|drift|come|glide|wander|roll|hop|step|"
        "travel|walk|hover|"
        "swim|run|stand|sit|hang|lift|raise|lower|rise|sink|appear|land|turn up|offset|reposition|ride|dance|skate|be|live|"
        "start|stay"
    )
)
_frame(
    "the dog, a bit to the left",
    making.moved,
    "way",
    who=thing | said("for|of") + thing,
    verb=_moving,
    way=steps,
    far=~said("by|for|about|some") + distance,
    more=said("more|further|farther|still|even"),
)  # fmt: skip
_frame(
    "the dog, behind the bush",
    lambda at: making.placed(*at),
    "at",
    who=thing | said("for|of") + thing,
    verb=_moving,
    at=~said("over|right|directly|straight|to|somewhere") + place >> (lambda where, other: (where, other)),
)
_frame(
    "the dog, raised by half its height",
    lambda lift, far=None: making.moved(making.UP if lift else making.DOWN, far),
    "lift",
    lift=table({
        every_form("raise|lift|elevate|hoist|rise|levitate|lift up|raise up|pick up"): True,
        every_form("lower|sink|descend|let down|bring down|drop down"): False,
    }, reserve=False),
    far=~said("by|for|about|some") + distance,
)  # fmt: skip
_full_turn = table(
    {
        "(a) half turn|(a) half a turn|180|u turn": 180.0,
        "(a) quarter turn|(a) quarter of a turn|(a) quarter rotation": 90.0,
        "(a|one) (full|complete|whole) [turn|circle|rotation|360|spin|revolution]|360|a 360|full 360|all the way around|"
        "once around": 360.0,
        "two [turns|rotations|spins|full turns]|twice": 720.0,
    },
    reserve=False,
)
_TURNING = table(
    {
        f"{every_form(ROTATING)}|{every_form('turn|flip')}|rotation|turned": making.rotated,
        every_form(TILTING): making.tilted,
    },
    reserve=False,
)


def _turned(
    verb: Any, angle: float | None = None, sense: int | None = None, around: bool = False, how: Amount | None = None
) -> Value:
    if angle is None and sense is None and not around and how is None and verb is making.tilted:
        raise Mismatch
    if angle is None:
        angle = 180.0 if around else 90.0 if verb is making.rotated else making.TILT
        if how is not None:
            angle = 15.0 if how.kind == "small" else 120.0
    return verb(angle, sense or 1)


_frame(
    "the dog, turned by 20 degrees",
    _turned,
    "verb angle",
    who=_whom,
    verb=_TURNING,
    angle=ANGLE | _full_turn,
    sense=SENSE
    | table(
        {"[to|and] face [left|the left]|facing left": -1, "[to|and] face [right|the right]|facing right": 1},
        reserve=False,
    ),
    around=said("around|on the spot|in place|over|around its axis") >> (lambda: True),
)
_frame(
    "the dog, turned around",
    _turned,
    "verb around",
    who=_whom,
    verb=_TURNING | constant(making.rotated) + said(every_form("face|look|point|head")),
    around=said("around|the other way|the other way around|so (that) [it|he|she] [faces|looks|points] the other way|backward|about|"
                 "in the [other|opposite] direction|to the other side|away|away from us") >> (lambda: True),
)  # fmt: skip
_frame("the dog, turned to the left", _turned, "verb sense", who=_whom, verb=_TURNING, sense=SENSE, how=degree)
_frame(
    "a quarter turn to the right for the dog",
    lambda angle, sense=None, verb=None, around=None: making.rotated(angle, sense or 1),
    "angle",
    who=_whom,
    verb=said(every_form("make|do|give|turn|perform|take")),
    angle=~said("a|one|by") + _full_turn,
    sense=SENSE,
    around=said("around|on the spot|in place|around its axis"),
)

# Copies
_times = either(
    number + ~said("x|times"),
    said("another|one more|a second|an extra|a new|a further|an additional|one other|a") >> (lambda: 1.0),
    said("x") + number,
    table({"once": 1.0, "twice": 2.0, "two times": 2.0, "thrice": 3.0}),
)
_copy_noun = said(
    "copy|copies|clone|clones|duplicate|duplicates|replica|replicas|double|twin|doubles|twins|duplication|instances|version|"
    "versions"
) + ~said("of")
_frame(
    "three copies of the dog, to the left",
    lambda copy, times=1.0, **where: making.copied(times=times, **where),
    "copy",
    who=~said("of|for") + thing,
    copy=either(
        silent(table({every_form("copy|duplicate|clone|replicate|multiply|double up"): None}, reserve=False))
        + constant(True),
        silent(optional(said("more|extra|other|identical|additional|new"))) + _copy_noun >> (lambda *_: True),
        silent(optional(said("more|extra|other|identical|additional|new"))) + said("one of|ones of")
        >> (lambda *_: True),
    ),
    verb=said(
        every_form(
            "make|create|add|put|place|give|insert|produce|generate|set|have|get|want|show|need|stand|be|appear|duplicate"
        )
    ),
    times=_times,
    **{name: rule for name, rule in BESIDE_IT.items() if name not in ("changed",)},
)
_frame(
    "three more dogs behind it",
    lambda times, **where: making.copied(times=times, **where),
    "times",
    bare=False,
    who=known_thing,
    verb=said(every_form("make|create|add|put|place|give me|insert|produce|generate|set|have|get|want|show|need|be|there is|"
                         "there are|appear")),
    times=either(number + said("more|other|extra|additional|further"),
                 said("another|one more|a second|an extra|an additional|a further") >> (lambda: 1.0)),
    **{name: rule for name, rule in BESIDE_IT.items() if name not in ("changed",)},
)  # fmt: skip


def _trail(trail: bool, times: float | None = None, shift: Any = None) -> Any:
    count = TRAIL_COPIES if times is None else times
    return making.copied(times=count, shift=TRAIL_LAG if shift is None else shift)


_frame(
    "two ghost copies that follow the dog",
    _trail,
    "trail",
    bare=False,
    who=~said("of|behind|after|for") + thing,
    trail=said(
        "trail|trails|motion trail|ghost trail|echo|echoes|afterimage|afterimages|ghosts|trailing copies|onion skin|onion skinning|"
        + every_form(
            "follow|trail|chase|lag|lag behind|trail behind|run behind|run after|walk behind|come behind|follow behind"
        )
    )
    >> (lambda: True),
    others=~said("ghost|ghostly|faint|identical|more|other") + silent(known_noun),
    copies=~said("a|some|few|a few|several|ghost|ghostly|faint")
    + said("copies|clones|ghosts|duplicates|of it|of itself|of him|of her|copy|clone|ghost|ghostly copies"),
    times=_times,
    verb=said(every_form("leave|have|make|add|put|give|create|draw|show|let|get|drag")),
    behind=said(
        "behind it|behind him|behind her|after it|behind itself|behind|it|him|her|the original|the first one|the real one"
    ),
    shift=SHIFT
    | ~said("with a lag of|at|every|each|by|with|spaced")
    + duration
    + ~said("apart|later|behind|delay|of delay|lag|each|between them|intervals|after it"),
)

# Time
_frame(
    "the dog should be frozen at frame 30",
    lambda verb, motion=None: making.frozen,
    "verb",
    who=_about + thing,
    whole=True,
    verb=table(
        {every_form("freeze|pause|halt|immobilize|stop moving|stand still|stay still|hold still|freeze frame|hold frame|"
                    "keep still|stay put|"
                    "hold in place|stay in place|stop dead|come to a stop|come to a halt|stop in its tracks")
         + "|still frame|freeze frame on|hold the frame|motionless|standing still|not move|no movement|stop|"
           "stopped": True}, reserve=False),
    motion=said("motion|the motion of|the movement of|in place|in its tracks|in mid air|dead|moving|from moving|in the air|there"),
)  # fmt: skip
_frame(
    "the dog, played in reverse",
    lambda verb, back=None, motion=None: making.reversed,
    "verb",
    who=_about + thing,
    whole=True,
    verb=either(
        table({every_form("reverse|rewind|play backward|run backward|go backward|move backward|walk backward|invert in time")
               + "|backward|in reverse|reversed|the other way around in time": True}, reserve=False),
        silent(said(every_form("play|run|go|move|walk|drive|dance|jump|ride|show|swim|fly|do|happen|"
                               "roll"))) + qualities.backward >> (lambda *_: True),
    ),
    back=said("in time|in reverse|backward|back to front"),
    motion=said("motion of|the motion of|the movement of|the action of|the time of|movement|motion|the motion|the movement"),
    playing=said(every_form("play|run|go|move|walk|drive|dance|jump|ride|show|swim|fly|do|make")),
)  # fmt: skip
_frame(
    "the dog, over and over from second 1 to 2",
    lambda again: making.looped,
    "again",
    who=_about + thing,
    whole=True,
    verb=said(every_form("play|run|go|move|put|make|show|let|set|have|do|walk|dance|keep|render")),
    again=said(
        every_form("loop|repeat|cycle") + "|on loop|in a loop|on repeat|over and over (again)|again and again|endlessly|"
                                          "forever|in an endless loop|"
        "as a loop|a loop|repeatedly|looping"
    ) >> (lambda: True),
    motion=said("motion of|the motion of|the movement of|the part|part|of|the bit"),
)  # fmt: skip
_take = said("take|takes|taking|last|lasts|lasting|should take|to")


_frame(
    "the movement of the dog should take three seconds",
    lambda verb, to: making.lasting(to),
    "verb to",
    who=~said("the") + _whom + ~said("'s") + ~said("motion|movement|action"),
    whole=True,
    verb=said(
        every_form(
            "take|last|stretch|stretch out|extend|expand|slow down|compress|squeeze|speed up|shorten|retime|lengthen|be"
        )
    )
    >> (lambda: True),
    to=~said("to|into|over|for|out to|down to|up to|exactly") + duration + ~said("long|in total|instead"),
    motion=said("the motion of|the movement of|the duration of|the length of|the action of|the time of"),
)

# Focus, light
_bit_of = ~said("some|a|an|a bit of|a little|a touch of|the") + optional(
    table(
        {"(very) [slight|soft|light|gentle|little|subtle|small|faint|tiny|mild]|touch of|hint of|bit of": Amount("small"),
         "(very) [strong|heavy|thick|bright|intense|big|huge|hard|massive]|lot of": Amount("large")}, reserve=False
    )
)  # fmt: skip
_doing = said(every_form("add|apply|put|give|use|have|get|throw|make|want|need|set|create|lay|show"))
_frame(
    "a slight blur on the dog",
    lambda blur=None: making.blurred(blur),
    "blur",
    who=_whom,
    verb=_doing,
    blur=_bit_of
    + said("(gaussian|lens|soft|depth|background) [blur|blurring|defocus|bokeh|haze]")
    + ~said("effect|filter|on|to"),
)
_frame(
    "the dog should be blurred",
    lambda verb, how=None: making.blurred(how),
    "verb",
    who=_whom,
    verb=table({every_form("blur|blur out|defocus|unfocus|soften|smudge|throw out of focus|put out of focus")
                + "|out of focus|unsharp|blurry|in soft focus|soft focus|fuzzy|less sharp": True}, reserve=False),
    how=qualities.softly,
    out=said("out"),
)  # fmt: skip
_frame(
    "a soft blue glow around the dog",
    lambda glow: making.glowing(*glow),
    "glow",
    who=_whom,
    verb=_doing,
    glow=_bit_of
    + optional(colour)
    + said("(neon|light) [glow|halo|shine|aura|gleam|sheen|outline glow|bloom|radiance] (of light)")
    + ~said("effect")
    >> (lambda how, rgb: (how, rgb)),
)
_frame(
    "the dog should glow",
    lambda verb, how=None, rgb=None: making.glowing(how, rgb),
    "verb",
    who=_whom,
    verb=table(
        {every_form("glow|shine|light up|shimmer|sparkle|radiate|gleam") + "|aglow|luminous|radiant": True},
        reserve=False,
    ),
    how=qualities.softly,
    rgb=~said("in|in a|a|with|with a") + colour + ~said("light|color"),
)

# Two things
_frame(
    "the dog and the cat, with their places swapped",
    lambda verb, other=None: making.swapped(other),
    "verb",
    bare=False,
    who=~said("(the) [places|positions|spots|locations|place|position] [of|between]|between|of") + (two_of_them | thing),
    verb=table({every_form("swap|exchange|switch|trade|interchange|swap places|change places|trade places|switch places|"
                           "swap positions|swap around")
                + "|swap of": True}, reserve=False),
    other=said("with|for|and") + thing,
    places=said("(the|their) [places|positions|spots|locations|place|position] (of|with)|with each other|with one another|"
                "around|over"),
)  # fmt: skip
_of_source = (
    ~said("the|its|a")
    + ~said("[colors|color|look|coloring|palette|tone|tones|hue|hues] (from|of|as)|that of|those of|same color as")
    + known_thing
    + ~(said("'s|'") + ~said("color|colors|look|coloring"))
)
_frame(
    "the dog should have the colors of the cat",
    lambda verb, source: making.matched(source),
    "verb source",
    verb=said(every_form(
        "match|adapt|color match|take on|take over|pick up|borrow|copy|take|inherit|have|adopt|get|look|make|be|be colored|"
        "share|give|wear|steal"
    )) >> (lambda: True),
    source=either(
        said("to|with|from|like|as|of|by") + ~said("the|its|a") + said("(same) [colors|color|look|coloring|palette|tone|"
                                                                       "hue]") + said("from|of|as") + known_thing,
        ~said("to|with|from") + ~said("the|its|a|exactly|exactly the") + said("(same|exact same) [colors|color|look|coloring|"
                                                                              "palette|tone|hue] [from|of|as|like]") + known_thing,
        ~said("to|with|from|into") + ~said("the") + silent(constant(0)) + known_thing + said("'s|'") + said("color|colors|"
            "look|coloring|palette"),
        said("like|to the same color as|the same color as|to match|matching") + known_thing,
    ),
)  # fmt: skip

# Opacity that comes and goes
_frame(
    "the dog fades out at the end",
    lambda verb, inward=False, by=None: making.faded(0.0 if by is None else by, inward),
    "verb",
    who=_whom,
    verb=either(
        table(
            {
                every_form(
                    "fade out|fade away|dissolve|fade|vanish slowly|disappear slowly|slowly vanish|slowly disappear|melt away"
                )
                + "|fade out on|a fade out": True
            },
            reserve=False,
        )
    ),
    inward=table(
        {
            "in|into view|in from nothing|in from black": True,
            "out|away|from view|to nothing|to zero|into nothing|completely": False,
        },
        reserve=False,
    ),
    by=said("to") + (percent | fraction),
)

# What refers to what was said before
_frame(
    "the cat too",
    AGAIN,
    "again",
    bare=False,
    who=_whom,
    verb=said("do|it|that|this|make it|apply it|apply that|go on|continue|and"),
    again=said("too|as well|also|the same|same|likewise|the same thing|same thing|the same way|same again")
    >> (lambda: True),
)
_untouched = said(
    "alone|as it is|as they are|as is|as it was|untouched|unchanged|the way it is|the way they are|where it is|where they are|"
    "in peace|"
    "normal|original|like it is|like it was|in place|the same|out of it|as before|how it is|in its [original|normal] [colors|"
    "color|state]"
)
_frame(
    "but leave the dog as it is",
    REMARK,
    "spared",
    bare=False,
    verb=said(every_form("leave|keep|let|stay|remain")),
    spared=_untouched >> (lambda: True),
)
_frame(
    "do not touch the dog",
    REMARK,
    "spared",
    bare=False,
    who=_whom,
    spared=said("do not [touch|change|affect|alter|modify|edit|include|do it to|do this to|do that to]|without [touching|"
                "changing|affecting]|not|"
               "no changes to|nothing [to|on|with]|never [touch|change]|do nothing to") >> (lambda: True),
    though=said("though|however|of course|at all"),
)  # fmt: skip
_frame("and nothing else", REMARK, "nothing", nothing=said("nothing else|nobody else|no one else|nothing more|that is all|"
                                                           "that is it|only that|"
       "nothing other than that|keep the rest|keep everything else|leave the rest|leave everything else|the rest stays (as it is)|"
       "then (back to) normal|then back|i mean it|not more|not less|that is enough") >> (lambda: True), whole=True)  # fmt: skip
