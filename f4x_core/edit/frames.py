"""Commands in any order of their words: verb, thing, quality, amount, direction and time wherever they stand.

The table of `commands` is asked first; what it does not understand is read here. Between the phrases there may be words that add
nothing; every other word has to belong to a phrase.
"""

from __future__ import annotations

from typing import Any

from ..language.amounts import Amount, amount, degree, distance, factor, fraction, multiple, number, percent, steps
from ..language.colours import colour, colourish
from ..language.grammar import Mismatch, Rule, constant, either, listed, literal, optional, silent, table
from ..language.lexicon import every_form
from ..language.times import TimeExpression, duration
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
    always,
    as_given,
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
    literal(
        "hey|hi|hello|okay|alexa|siri|google|computer|assistant|buddy|mate|dude|mummy|mum|mom|dad|daddy|look|listen|"
        "um|uh|er|hmm|oh|well|so|now|then|next|also|too|as well|just|simply|actually|really|maybe|perhaps|probably|"
        "somehow|quickly|for now|right away|for me|for us|if possible|if you [can|could|would|like|will]|"
        "when you can|instead|again|there|here|over there|altogether|all|full on|exactly|properly|nicely|a nice|nice|"
        "lovely|or so|or something|or something like that|kind of|sort of|you know|after all|i think|i guess|"
        "i feel like|i believe|this time|from there|in one go|of course|though|yeah|yes|hmm|asap|my friend|sir|both"
    ),
    literal(
        "[could|can|would|will] you|[could|can|may|shall] [we|i]|[i|we] [want|wanted|need|wish|prefer|fancy]|"
        "[i|we] would [like|love|prefer]|[i|we] would rather have|(i want|i would like|i need) you|"
        "you [should|could|can|may|must]|let us|let me|go ahead and|try to|help me (to)|make sure (that)|so that|"
        "in such a way that|how [do|can|would|could] [i|you|we]|how to|what if|what about|how about|"
        "is there [a|any] way to|is it possible to|would it be possible to|it would be [nice|great|cool] (if)|"
        "i am looking for|i am trying to|we are going to|i am going to|[my|the] [wish|idea|plan] is (that|to)|"
        "your task is to|time to|see|to see|have|to have|to get|want|would like"
    ),
    literal(
        "[should|must|could|can|may|will|would|shall|has to|have to|needs to|need to|ought to|is to|are to|"
        "to|is supposed to|are supposed to|might] ([be|become|get|turn|go|look|appear|stay|end up|have])|"
        "[become|becomes|becoming|being|be|gets|ends up|end up|ending up|comes out|stays] (as)|for it to|for them to"
    ),
    literal(
        every_form("make|let|have|get|do|keep")
        + "|start|begin|every frame|each frame|going|in the [scene|picture|video|clip]|for good|permanently"
    ),
    literal(",|:|->|=>|=|-|!|(|)"),
)
"""Requests, wishes, interjections."""

_joined = literal("and|,|, and|but|plus|and also|as well as")
_led = Rule(lambda reading, at: {at: ()} if reading.word(at) in ("at", "in", "with") else {})
"""Qualities need no "and" between them where a preposition stands: "backwards at half speed"."""
_toward = ~literal(
    "in|to|into|as|with|at|by|toward|of|being|it|them|more like|like|rather|old film|vintage|old|classic|nice|solid|"
    "some"
)
_noun_of_colour = either(
    ~literal("a|an|some|the")
    + ~literal("slight|faint|light|soft|subtle")
    + (colour | colourish)
    + literal("tint|tinge|touch|shimmer|cast|wash")
    >> making.faintly,
    ~literal("a|an|some|the")
    + colour
    + literal("color|paint|shade|coat|hue|coat of paint|paint job|version|one|variant")
    >> making.assigned,
    literal("the color") + colour >> making.assigned,
)
_instead_of = ~(
    literal("instead of|rather than|and not|not") + ~literal("in") + silent(colour | colourish | literal("this|that"))
)
_looked = either(
    _toward + ~literal("pure|solid|a|an|some|the") + qualities.any_look + ~qualities.effect >> making.styled,
    literal("like|as") + ~literal("a|an|some|the|pure|solid|made of|in") + qualities.any_look + ~qualities.effect
    >> making.styled,
    ~literal("a|an|the") + qualities.any_look + qualities.effect >> making.styled,
)
_more_opacity = (
    either(
        ~literal("like|about|roughly|only|just|say") + percent + literal("[visible|opacity|opaque|alpha|visibility]"),
        literal("see through|transparent|translucent")
        + ~literal(",|like|about|say|so")
        + percent
        + literal("visible|opacity|opaque"),
        literal("opacity|alpha|visibility") + ~literal("of|to|at|=|is|down to") + (percent | fraction),
        percent + literal("transparency|see through|transparent|translucency") >> (lambda x: 1 - x),
        literal("transparency|translucency") + ~literal("of|to|at|=|is") + (percent | fraction) >> (lambda x: 1 - x),
    )
    >> making.opacity
)
_pace_of = either(
    ~literal("at|with|in|to")
    + (
        fraction
        | table(
            {"three quarter": 0.75, "quarter": 0.25, "two third": 2 / 3, "one third": 1 / 3, "half": 0.5}, reserve=False
        )
    )
    + literal("speed|the speed|pace|tempo|of [the|its] speed")
    >> making.retimed,
    ~literal("at|with|in|to") + (percent | multiple | number + literal("x")) + literal("speed|pace|tempo")
    >> making.retimed,
    multiple + table({"slower": -1, "faster": 1}) >> (lambda x, way: making.retimed(x if way > 0 or x < 1 else 1 / x)),
    literal("slow mo|slowmo|slo mo|slomo|slow motion|in slow mo") >> (lambda: making.retimed(0.5)),
    literal("in fast forward|fast forward|fast motion|in fast motion|time lapse|timelapse")
    >> (lambda: making.retimed(2.0)),
)
_size_of = (
    either(
        ~literal("at|to|in")
        + ~literal("a")
        + (multiple | percent | number + literal("x"))
        + ~literal("of")
        + ~literal("its|the|their|his|her|original|normal")
        + ~literal("original|normal|current")
        + literal("size|scale|as big|as large|as tall"),
        ~literal("at|to|in")
        + literal("a")
        + (fraction | percent)
        + literal("of [its|the|their|his|her] (original|normal|current) [size|height]"),
        literal("to the size of") + multiple,
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
    ~literal("a|the|more|really|very|rather|quite|nice and|pretty|in a|feel|look|looking|feeling")
    + qualities.simply
    + ~literal("tone|mood|look|light"),
    _toward + qualities.bare_look,
)
_becoming = literal(
    every_form(
        "make|turn|render|change|convert|transform|give|paint|color|recolor|dye|tint|set|put|get|let|play|run|use|"
        "apply|do|keep|switch|bring|show|adjust|display|look|feel|appear|become|have|go|seem"
    )
)
_about = ~literal("of|for|on|to|in|with|around|about|onto|over|at|from")
_whom = ~literal("but|and") + ~literal("only|just|only for|just for|only with") + _about + thing
_frame(
    "the dog, in red",
    as_given,
    "values",
    who=_whom,
    verb=_becoming,
    more=literal("still|even|even more|a step"),
    values=listed(_quality + _instead_of, _joined | _led),
)
_frame(
    "brighter and more vivid",
    as_given,
    "values",
    whole=True,
    values=listed(
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
            "increase|raise|boost|turn up|bump up|crank up|pump up|dial up|bring up|push up|strengthen|enhance|"
            "intensify|push|bump|lift|add|pull up|amplify|double"
        )
        + "|up|upward|more|higher|stronger|extra|plus|+|additional|some more|a bit of|increased|some": True,
        every_form(
            "reduce|decrease|lower|turn down|cut|cut down|lessen|tone down|bring down|dial down|weaken|diminish|drop|"
            "take down|cut back|pull down|take back|pull back"
        )
        + "|down|downward|less|lower|weaker|minus|-|reduced": False,
    },
    reserve=False,
)
_too = ~literal("far|way|much|a bit|a little|rather|really|still|just") + table(
    {
        "too [high|much|strong|big|large|great|heavy|intense]": False,
        "too [low|little|weak|small|faint]": True,
        "not [high|much|strong|big|large] enough|not enough": True,
    },
    reserve=False,
)
_to_value = (
    literal("to|at|=|:|be|of|is")
    + ~literal("about|around|exactly|only")
    + either(percent, multiple, number)
    + ~literal("of [its|the|their] (original|current|normal|present) (value|size|speed|brightness|level)")
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


_set = literal(
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
    quality=~literal("the|its|their|his|her|a|'s|some|of")
    + table(_QUALITIES, reserve=False)
    + ~literal("level|value|slider|amount|setting"),
    way=_way,
    how=amount | literal("by") + number >> (lambda x: Amount("times", x)),
    to=_to_value,
    too=~literal("is|are|has|have|looks") + _too,
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
    how=amount | literal("by") + number >> (lambda x: Amount("times", x)) | degree,
    to=literal("to|down to|up to|at")
    + either(fraction, percent, multiple)
    + ~literal(
        "of [its|the|their|his|her] (original|normal|present|current) [size|speed|brightness|pace]|"
        "[size|speed|the size|the speed|its size|opacity]"
    ),
    particle=literal("up|down"),
    fully=literal("completely|fully|entirely|totally|all the way|to gray") >> (lambda: True),
)
_frame(
    "the dog is too dark",
    REMARK,
    "complaint",
    bare=False,
    complaint=literal("is|are|looks|look|seems|seem|feels|appears|appear|was|it is|has|have") + qualities.too_much,
)
_frame(
    "it's too dark",
    REMARK,
    "complaint",
    complaint=literal("its|it is|that is|this is|thats|everything is|it looks|it seems") + qualities.too_much,
)

# Taking out
_frame(
    "the dog has to be removed",
    always(making.deleted),
    "verb",
    who=_whom,
    bare=False,
    verb=literal(
        every_form(
            f"{DELETING}|clean out|take out|cut out|edit out|wipe out|rub out|throw out|throw away|take away|"
            "cut away|clean up|paint out|key out|clone out|crop out|pull out|kick out|chuck out|x out|leave out|rotoscope out"
        )
        + "|gone|out of [the|this] [scene|picture|video|clip|image|shot|frame|view|movie|film]|no longer there|"
        "not there (any more)"
    ),
    out=OUT
    | literal(
        "from [the|this] [scene|picture|video|clip|image|shot|frame|view|movie|film]|completely|entirely|fully|for good"
    ),
)
_frame(
    "take the dog, the left one, out",
    always(making.deleted),
    "verb out",
    bare=False,
    verb=literal(every_form(SPLIT)),
    out=OUT,
)
_hiding = every_form(
    "hide|conceal|mask|mask out|make invisible|vanish|disappear|stop showing|not show|blank out|switch off|turn off"
)
_frame(
    "the dog has to be hidden",
    always(making.opacity(0.0)),
    "verb",
    who=_whom,
    verb=literal(f"{_hiding}|invisible|hidden|out of sight|do not show|not visible|not shown|not to be seen"),
    fully=literal("from [view|sight]|completely|entirely|fully|totally|for good|permanently"),
)
_frame(
    "nothing but the dog",
    always(making.extracted),
    "only",
    who=_whom,
    bare=False,
    verb=literal(
        f"{every_form(KEEPING)}|cut out|want|isolate|solo|be left|stay|remain|remains|left|lift|lift out|visible|there|in it"
    ),
    only=~literal("on")
    + literal(
        "only|just|nothing but|solely|nothing except|alone|on [its|his|her|their] own|by itself|all by itself|"
        "isolated|isolate|isolating|solo|soloed|nothing else|and nothing else|no one else|and nobody else|exclusively"
    ),
    rest=~_joined + literal(every_form(f"{DELETING}|hide|take out|cut out|throw out")) + silent(everything_else)
    | silent(everything_else)
    + ~literal("should|must|has to|can|is to")
    + literal("go|be gone|gone|away|disappear|vanish|out|removed|be removed|be deleted|deleted|hidden|be hidden|goes"),
)

# Places
_moving = literal(
    every_form(
        "move|shift|push|put|slide|bring|pull|drag|place|shove|carry|send|scoot|nudge|translate|position|drive|"
        "displace|set|get|drop|throw|relocate|fly|float|slip|budge|transport|take|swing|draw|tug|bump|go|jump|drift|"
        "come|glide|wander|roll|hop|step|travel|walk|hover|swim|run|stand|sit|hang|lift|raise|lower|rise|sink|appear|"
        "land|turn up|offset|reposition|ride|dance|skate|be|live|start|stay"
    )
)
_frame(
    "the dog, a bit to the left",
    making.moved,
    "way",
    who=thing | literal("for|of") + thing,
    verb=_moving,
    way=steps,
    far=~literal("by|for|about|some") + distance,
    more=literal("more|further|farther|still|even"),
)
_frame(
    "the dog, behind the bush",
    making.placed,
    "place",
    who=thing | literal("for|of") + thing,
    verb=_moving,
    place=~literal("over|right|directly|straight|to|somewhere") + place,
)
_frame(
    "the dog, raised by half its height",
    lambda lift, far=None: making.moved(making.UP if lift else making.DOWN, far),
    "lift",
    lift=table(
        {
            every_form("raise|lift|elevate|hoist|rise|levitate|lift up|raise up|pick up"): True,
            every_form("lower|sink|descend|let down|bring down|drop down"): False,
        },
        reserve=False,
    ),
    far=~literal("by|for|about|some") + distance,
)
_full_turn = table(
    {
        "(a) half turn|(a) half a turn|180|u turn": 180.0,
        "(a) quarter turn|(a) quarter of a turn|(a) quarter rotation": 90.0,
        "(a|one) (full|complete|whole) [turn|circle|rotation|360|spin|revolution]|360|a 360|full 360|"
        "all the way around|once around": 360.0,
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
    around=literal("around|on the spot|in place|over|around its axis") >> (lambda: True),
)
_frame(
    "the dog, turned around",
    _turned,
    "verb around",
    who=_whom,
    verb=_TURNING | constant(making.rotated) + literal(every_form("face|look|point|head")),
    around=literal(
        "around|the other way|the other way around|so (that) [it|he|she] [faces|looks|points] the other way|backward|"
        "about|in the [other|opposite] direction|to the other side|away|away from us"
    )
    >> (lambda: True),
)
_frame("the dog, turned to the left", _turned, "verb sense", who=_whom, verb=_TURNING, sense=SENSE, how=degree)
_frame(
    "a quarter turn to the right for the dog",
    making.rotated,
    "angle",
    who=_whom,
    verb=literal(every_form("make|do|give|turn|perform|take")),
    angle=~literal("a|one|by") + _full_turn,
    sense=SENSE,
    around=literal("around|on the spot|in place|around its axis"),
)

# Copies
_times = either(
    number + ~literal("x|times"),
    literal("another|one more|a second|an extra|a new|a further|an additional|one other|a") >> (lambda: 1.0),
    literal("x") + number,
    table({"once": 1.0, "twice": 2.0, "two times": 2.0, "thrice": 3.0}),
)
_copy_noun = literal(
    "copy|copies|clone|clones|duplicate|duplicates|replica|replicas|double|twin|doubles|twins|duplication|instances|"
    "version|versions"
) + ~literal("of")
_copy_place = {name: rule for name, rule in BESIDE_IT.items() if name != "changed"}
_frame(
    "three copies of the dog, to the left",
    making.copied,
    "copy",
    who=~literal("of|for") + thing,
    copy=either(
        literal(every_form("copy|duplicate|clone|replicate|multiply|double up")),
        ~literal("more|extra|other|identical|additional|new") + (_copy_noun | literal("one of|ones of")),
    ),
    verb=literal(
        every_form(
            "make|create|add|put|place|give|insert|produce|generate|set|have|get|want|show|need|stand|be|appear|"
            "duplicate"
        )
    ),
    times=_times,
    **_copy_place,
)
_frame(
    "three more dogs behind it",
    making.copied,
    "times",
    bare=False,
    who=known_thing,
    verb=literal(
        every_form(
            "make|create|add|put|place|give me|insert|produce|generate|set|have|get|want|show|need|be|there is|"
            "there are|appear"
        )
    ),
    times=either(
        number + literal("more|other|extra|additional|further"),
        literal("another|one more|a second|an extra|an additional|a further") >> (lambda: 1.0),
    ),
    **_copy_place,
)


def _trail(times: float = TRAIL_COPIES, shift: TimeExpression = TRAIL_LAG) -> Any:
    return making.copied(times=times, shift=shift)


_frame(
    "two ghost copies that follow the dog",
    _trail,
    "trail",
    bare=False,
    who=~literal("of|behind|after|for") + thing,
    trail=literal(
        "trail|trails|motion trail|ghost trail|echo|echoes|afterimage|afterimages|ghosts|trailing copies|onion skin|"
        "onion skinning|"
        + every_form(
            "follow|trail|chase|lag|lag behind|trail behind|run behind|run after|walk behind|come behind|follow behind"
        )
    ),
    others=~literal("ghost|ghostly|faint|identical|more|other") + silent(known_noun),
    copies=~literal("a|some|few|a few|several|ghost|ghostly|faint")
    + literal("copies|clones|ghosts|duplicates|of it|of itself|of him|of her|copy|clone|ghost|ghostly copies"),
    times=_times,
    verb=literal(every_form("leave|have|make|add|put|give|create|draw|show|let|get|drag")),
    behind=literal(
        "behind it|behind him|behind her|after it|behind itself|behind|it|him|her|the original|the first one|"
        "the real one"
    ),
    shift=SHIFT
    | ~literal("with a lag of|at|every|each|by|with|spaced")
    + duration
    + ~literal("apart|later|behind|delay|of delay|lag|each|between them|intervals|after it"),
)

# Time
_frame(
    "the dog should be frozen at frame 30",
    always(making.frozen),
    "verb",
    who=_about + thing,
    whole=True,
    verb=literal(
        every_form(
            "freeze|pause|halt|immobilize|stop moving|stand still|stay still|hold still|freeze frame|hold frame|"
            "keep still|stay put|hold in place|stay in place|stop dead|come to a stop|come to a halt|"
            "stop in its tracks"
        )
        + "|still frame|freeze frame on|hold the frame|motionless|standing still|not move|no movement|stop|stopped"
    ),
    motion=literal(
        "motion|the motion of|the movement of|in place|in its tracks|in mid air|dead|moving|from moving|in the air|"
        "there"
    ),
)
_frame(
    "the dog, played in reverse",
    always(making.reversed),
    "verb",
    who=_about + thing,
    whole=True,
    verb=either(
        literal(
            every_form(
                "reverse|rewind|play backward|run backward|go backward|move backward|walk backward|invert in time"
            )
            + "|backward|in reverse|reversed|the other way around in time"
        ),
        literal(every_form("play|run|go|move|walk|drive|dance|jump|ride|show|swim|fly|do|happen|roll"))
        + silent(qualities.backward),
    ),
    back=literal("in time|in reverse|backward|back to front"),
    motion=literal(
        "motion of|the motion of|the movement of|the action of|the time of|movement|motion|the motion|the movement"
    ),
    playing=literal(every_form("play|run|go|move|walk|drive|dance|jump|ride|show|swim|fly|do|make")),
)
_frame(
    "the dog, over and over from second 1 to 2",
    always(making.looped),
    "again",
    who=_about + thing,
    whole=True,
    verb=literal(every_form("play|run|go|move|put|make|show|let|set|have|do|walk|dance|keep|render")),
    again=literal(
        every_form("loop|repeat|cycle")
        + "|on loop|in a loop|on repeat|over and over (again)|again and again|endlessly|forever|in an endless loop|"
        "as a loop|a loop|repeatedly|looping"
    ),
    motion=literal("motion of|the motion of|the movement of|the part|part|of|the bit"),
)
_frame(
    "the movement of the dog should take three seconds",
    making.lasting,
    "verb to",
    who=~literal("the") + _whom + ~literal("'s") + ~literal("motion|movement|action"),
    whole=True,
    verb=literal(
        every_form(
            "take|last|stretch|stretch out|extend|expand|slow down|compress|squeeze|speed up|shorten|retime|lengthen|be"
        )
    ),
    to=~literal("to|into|over|for|out to|down to|up to|exactly") + duration + ~literal("long|in total|instead"),
    motion=literal("the motion of|the movement of|the duration of|the length of|the action of|the time of"),
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
_doing = literal(every_form("add|apply|put|give|use|have|get|throw|make|want|need|set|create|lay|show"))
_frame(
    "a slight blur on the dog",
    making.blurred,
    "how",
    who=_whom,
    verb=_doing,
    how=_bit_of
    + literal("(gaussian|lens|soft|depth|background) [blur|blurring|defocus|bokeh|haze]")
    + ~literal("effect|filter|on|to"),
)
_frame(
    "the dog should be blurred",
    making.blurred,
    "verb",
    who=_whom,
    verb=literal(
        every_form("blur|blur out|defocus|unfocus|soften|smudge|throw out of focus|put out of focus")
        + "|out of focus|unsharp|blurry|in soft focus|soft focus|fuzzy|less sharp"
    ),
    how=qualities.softly,
    out=literal("out"),
)
_frame(
    "a soft blue glow around the dog",
    as_given,
    "values",
    who=_whom,
    verb=_doing,
    values=_bit_of
    + optional(colour)
    + literal("(neon|light) [glow|halo|shine|aura|gleam|sheen|outline glow|bloom|radiance] (of light)")
    + ~literal("effect")
    >> making.glowing,
)
_frame(
    "the dog should glow",
    making.glowing,
    "verb",
    who=_whom,
    verb=literal(every_form("glow|shine|light up|shimmer|sparkle|radiate|gleam") + "|aglow|luminous|radiant"),
    how=qualities.softly,
    rgb=~literal("in|in a|a|with|with a") + colour + ~literal("light|color"),
)

# Two things
_frame(
    "the dog and the cat, with their places swapped",
    making.swapped,
    "verb",
    bare=False,
    who=~literal("(the) [places|positions|spots|locations|place|position] [of|between]|between|of")
    + (two_of_them | thing),
    verb=literal(
        every_form(
            "swap|exchange|switch|trade|interchange|swap places|change places|trade places|switch places|"
            "swap positions|swap around"
        )
        + "|swap of"
    ),
    other=literal("with|for|and") + thing,
    places=literal(
        "(the|their) [places|positions|spots|locations|place|position] (of|with)|with each other|with one another|"
        "around|over"
    ),
)
_frame(
    "the dog should have the colors of the cat",
    making.matched,
    "verb source",
    verb=literal(
        every_form(
            "match|adapt|color match|take on|take over|pick up|borrow|copy|take|inherit|have|adopt|get|look|make|be|"
            "be colored|share|give|wear|steal"
        )
    ),
    source=either(
        literal("to|with|from|like|as|of|by")
        + ~literal("the|its|a")
        + literal("(same) [colors|color|look|coloring|palette|tone|hue]")
        + literal("from|of|as")
        + known_thing,
        ~literal("to|with|from")
        + ~literal("the|its|a|exactly|exactly the")
        + literal("(same|exact same) [colors|color|look|coloring|palette|tone|hue] [from|of|as|like]")
        + known_thing,
        ~literal("to|with|from|into")
        + ~literal("the")
        + known_thing
        + literal("'s|'")
        + literal("color|colors|look|coloring|palette"),
        literal("like|to the same color as|the same color as|to match|matching") + known_thing,
    ),
)

# Opacity that comes and goes
_frame(
    "the dog fades out at the end",
    lambda by=0.0, inward=False: making.faded(by, inward),
    "verb",
    who=_whom,
    verb=literal(
        every_form(
            "fade out|fade away|dissolve|fade|vanish slowly|disappear slowly|slowly vanish|slowly disappear|melt away"
        )
        + "|fade out on|a fade out"
    ),
    inward=table(
        {
            "in|into view|in from nothing|in from black": True,
            "out|away|from view|to nothing|to zero|into nothing|completely": False,
        },
        reserve=False,
    ),
    by=literal("to") + (percent | fraction),
)

# What refers to what was said before
_frame(
    "the cat too",
    AGAIN,
    "again",
    bare=False,
    who=_whom,
    verb=literal("do|it|that|this|make it|apply it|apply that|go on|continue|and"),
    again=literal("too|as well|also|the same|same|likewise|the same thing|same thing|the same way|same again"),
)
_untouched = literal(
    "alone|as it is|as they are|as is|as it was|untouched|unchanged|the way it is|the way they are|where it is|"
    "where they are|in peace|normal|original|like it is|like it was|in place|the same|out of it|as before|how it is|"
    "in its [original|normal] [colors|color|state]"
)
_frame(
    "but leave the dog as it is",
    REMARK,
    "spared",
    bare=False,
    verb=literal(every_form("leave|keep|let|stay|remain")),
    spared=_untouched,
)
_frame(
    "do not touch the dog",
    REMARK,
    "spared",
    bare=False,
    who=_whom,
    spared=literal(
        "do not [touch|change|affect|alter|modify|edit|include|do it to|do this to|do that to]|"
        "without [touching|changing|affecting]|not|no changes to|nothing [to|on|with]|never [touch|change]|"
        "do nothing to"
    ),
    though=literal("though|however|of course|at all"),
)
_frame(
    "and nothing else",
    REMARK,
    "nothing",
    nothing=literal(
        "nothing else|nobody else|no one else|nothing more|that is all|that is it|only that|nothing other than that|"
        "keep the rest|keep everything else|leave the rest|leave everything else|the rest stays (as it is)|"
        "then (back to) normal|then back|i mean it|not more|not less|that is enough"
    ),
    whole=True,
)
