"""What questions are made of: cues (question words, verbs, qualities), and which of them together ask for what."""

from __future__ import annotations

from collections.abc import Iterator, Mapping

from ..language.grammar import Rule, either, table
from ..language.lexicon import forms

WORDS: set[str] = set()
"""Every word of the cues: none of them is the name of a thing."""


def cue(*specs: str | Mapping[str, str]) -> Rule:
    """A rule of phrases: those of a mapping have values, the others none."""
    entries = {spec: None for spec in specs if isinstance(spec, str)}
    for spec in specs:
        entries |= {} if isinstance(spec, str) else spec  # type: ignore[assignment]
    return table(entries, words_of=WORDS)


def _inflected(verbs: str) -> Iterator[tuple[str, str]]:
    """(each form of the verbs in "go out|move", its verb): go, goes, going, gone out."""
    for verb in verbs.split("|"):
        head, _, rest = verb.partition(" ")
        third = (
            head[:-1] + "ies"
            if head.endswith("y") and head[-2] not in "aeiou"
            else head + ("es" if head.endswith(("s", "sh", "ch", "x", "go")) else "s")
        )
        for form in dict.fromkeys((head, third, *forms(head))):
            yield f"{form} {rest}".strip(), verb


def _verbs(verbs: str) -> str:
    return "|".join(form for form, _ in _inflected(verbs))


_CLIPS = "clip|video|film|movie|footage|sequence|recording|scene|shot"
_PICTURES = f"{_CLIPS}|picture|image|view|frame|room|world|screen|shot|sight|reconstruction"
_NOUN = "thing|things|object|objects|one|ones|item|items|element|elements|stuff"
_THESE = f"[which|what] (single|kind of|kinds of|sort of|sorts of|other) [{_NOUN}]"
_WHAT = (
    f"what|who|which|what all|{_THESE}|which of [the|these|those|all the|them|all] (different) ({_NOUN}|two)|which of the two"
    f"|which of them|the [{_NOUN}] [which|that]|what else"
)
_YOU = "you|i|we|one|anybody|anyone|somebody|someone|the viewer"
_MOMENTS = "time|times|moment|moments|second|seconds|frame|frames|point|points|instant|stage"
_IN = "in|of|on|within|inside|during|over|throughout|through|for|from|across|into"
US = "the camera|camera|us|me|you|the viewer|viewer|the lens|the observer|here"
_SEE = "see|find|spot|recognize|recognise|detect|notice|make out|count|observe"
_PLAIN = _verbs("move|go|travel|come|head") + "|went|came|in motion|on the move|move around|moves around|movement"
_MANNERS = dict(
    _inflected(
        "walk|run|swim|drive|fly|roll|ride|slide|float|jump|race|gallop|dance|jog|hop|crawl|sail|glide|spin|march|leap"
    )
) | {"ran": "run", "swam": "swim", "drove": "drive", "driven": "drive", "flew": "fly", "rode": "ride"}
_BEGIN = "start|starts|starting|started|begin|begins|beginning|began|set off|sets off|get going|gets going"
_END = _verbs("stop|halt|pause|finish|cease") + (
    "|[come|comes|came] to (a) [stop|halt|standstill|rest]|stand still|stands still|rest|rests|come to a full stop|end|ends"
    "|stay still|stays still|remain still|remains still|[standing|staying] still"
)
_STANDING = (
    "|".join(map(_verbs, ("stand", "stay", "remain", "keep", "lie", "sit")))
    + "|located|placed|found|situated|positioned"
)
_STILL = (
    f"still|at rest|stationary|static|motionless|unmoving|immobile|resting|[{_STANDING}] [still|stationary|static|motionless|put]"
    f"|[{_STANDING}] at rest|where it is|in place|not in motion|without moving"
)
_EVER = "always|constantly|permanently|continuously|(for|during) the [whole|entire] [time|way]|(for|during) all the time|at all times|throughout"
_ITS = "its|his|her|their|the|at its|at his|at her|at their|at the"
_DIRECTIONS = "way|direction|side|directions"
_COLOUR = "red|orange|yellow|green|blue|purple|violet|pink|brown|black|white|gray|grey|beige|golden"
_COLOURS = {
    f"{shade} {name}".strip(): f"{shade} {name}".strip()
    for name in _COLOUR.split("|")
    for shade in ("", "light", "dark", "bright")
}
COLOURS = frozenset(_COLOUR.split("|"))
_two_colours = table(_COLOURS, words_of=WORDS)
_BIG = "bigger|larger|taller|wider|longer|broader|higher|thicker|greater"
_SMALL = "smaller|shorter|tinier|narrower|littler"
_FAST, _SLOW = "faster|quicker|speedier|more quickly|more rapidly", "slower|more slowly"
_NEAR_MOST = "nearest|closest|nearest of all|most near"
_FAR_MOST = (
    "farthest|furthest|most distant|farthest away|furthest away|the most distant|remotest|farthest apart|furthest apart"
)
_NEAR = "near|nearby|close|next|beside|around|by|alongside|adjacent"
_SIDES = {
    f"[to|on|at|in] (the) {side} (hand) (side|half|part|third) (of the [picture|image|frame|view|screen])": side
    for side in ("left", "right")
} | {"in the [middle|center|centre] (of the [picture|image|frame|view|screen])|central|centered": "middle"}
_PLACES = {
    "(further|farther) in front of|before|in front": "in front of",
    "(further|farther) behind|behind|in back of": "behind",
    "above|over|higher than|on top of": "above",
    "below|under|beneath|underneath|lower than": "below",
    "(further|farther) (to|on|at) (the) left (hand) (side) of|left from": "left of",
    "(further|farther) (to|on|at) (the) right (hand) (side) of|right from": "right of",
    "next to|beside|near|near to|close to|alongside|around|by|adjacent to|nearby": "near",
}
_COMPARED = (
    "[in|with] relation to|relative to|compared [to|with]|with respect to|in comparison [to|with]|with regard to"
)

_AT = ~cue("at|in|on|from|since|until|to|by|during|for|between|over|around") + ~cue("exactly|about|around|roughly")
_INSIDE = cue(f"[{_IN}] (the|this|my|our|that|the whole|the entire|this whole|all of the)") + cue(_PICTURES)
_LOOKING = (
    ~cue("do|does|did|can|could|would")
    + cue(_YOU)
    + ~cue("can|could")
    + ~cue("ever|also|first|last|still|really|actually")
    + cue(_SEE)
)
_ON_SIDE = ~cue("on|to|at|in") + cue("(the) [left|right]") + ~cue("side|half|hand side")
_IN_VIEW = "in view|on screen|on the screen|on view|in sight|on camera|in shot"
_SHOWS = cue(f"(the|this) [{_PICTURES}] [show|have|contain|include|shows|has|contains|includes]")
_A_PICTURE = ~cue("the|this") + ~cue(_PICTURES)
_KNOW = cue(f"{_SEE}|edit|have|know|change|select|ask about|work with|know of")
_LIKE_THIS = ~cue("first|last|still|also|ever|actually|clearly")
_ONES = cue("[which|what] (kinds of|sorts of|kind of)|which") + cue(_NOUN)

CUES: dict[str, Rule] = {
    "what": cue(_WHAT),
    "when": either(
        cue(
            f"when (exactly)|from when (to when)|until when|since when|how [early|soon|late]|[which|what] [{_MOMENTS}] [show|shows]"
            f"|(at|in|on) the [{_MOMENTS}] [when|at which|in which|where|that]|what is the [{_MOMENTS}]"
        ),
        _AT + cue("[which|what] (exact)") + cue(_MOMENTS) + ~cue("in time|of the clip"),
    ),
    "where": either(
        cue(
            "where (exactly|precisely)|whereabouts|where about|where abouts|(the) [position|location|place|whereabouts]"
        ),
        _AT
        + cue("[which|what] (exact)")
        + cue("part|side|half|place|position|corner|area|third|spot|location|region")
        + ~cue(f"of the [{_PICTURES}]"),
    ),
    "fast": cue(
        "how [fast|quick|quickly|slow|slowly|rapid|rapidly|speedy]|(at|with) [what|which] (kind of|sort of) [speed|velocity|pace]"
        "|(the) [speed|velocity|pace]|how much speed"
    ),
    "extreme": cue(
        {
            f"({_ITS}) (very) [top|maximum|max|highest|greatest|peak|maximal|fastest]|at most|at the most|at maximum": "max",
            f"({_ITS}) [average|mean]|on average|averaged|typically": "mean",
            f"({_ITS}) [lowest|minimum|least|min|slowest|minimal]|at least|at minimum": "min",
        }
    ),
    "far": cue(
        "how far|how much (ground|distance|way)|[what|which] [distance|length]|(the) (total) distance [traveled|travelled|covered]"
        "|(the) [length|distance] of the [path|way|route|track|journey]|how long (is) (the) [path|way|route|journey]|how long a way"
        "|[what|which] [way|distance] in total|how many [meters|metres|units|steps]"
    ),
    "gap": cue(
        "how [far|close|near] (away|apart|off|together)|(the) (current) [distance|gap|space|spacing]|apart"
        "|how much [space|room|distance|gap]|how [big|large|wide|small] (is) (the) [gap|distance|space]"
        "|[what|which] distance|at [what|which] distance|how many units"
    ),
    "least": cue("(the) [shortest|smallest|minimum|minimal|closest|least|nearest]|at the [closest|nearest] (point)"),
    "close": cue("how [close|near]"),
    "get": cue(f"come|comes|get|gets|getting|coming|approach|{_PLAIN}"),
    "together": cue(
        "together|apart|to each other|from each other|to one another|from one another|of each other|each other|away"
    ),
    "big": cue(
        "how [big|large|small|long|tall|wide|high|broad|huge|tiny|thick]|[what|which] size|(the) [size|height|width|dimensions|extent]"
        f"|how much (of the|of this|of) [{_PICTURES}|space|room]|what [part|share|fraction|percentage] of the [{_PICTURES}]"
        "|how many pixels"
    ),
    "covers": cue(_verbs("cover|fill|occupy|take up|take") + "|appear|appears|look|looks|seem|seems|measure|measures"),
    "high": cue("how high (up)|(to) [what|which|how much] height|how far up|how much height"),
    "rise": cue(
        _verbs("jump|rise|leap|climb|hop|ascend|lift|bounce|gain|reach|go|fly|get|move|come")
        + "|rose|up|upward|off the ground"
    ),
    "go-up": cue(
        _verbs("rise|climb|ascend|leap")
        + f"|[{_verbs('go|move|get|come|fly|jump')}] [up|upward]|rose|gain in height|gain height"
    ),
    "by-how-much": cue("(by) how [much|far]"),
    "which-color": cue(
        "[what|which] (main) [color|colors|colour|colours] (is|has|have|of)|(the) (main) [color|colors|colour|colours]|how colored"
    ),
    "color": either(
        _two_colours + cue("or|, or") + _two_colours >> (lambda a, b: f"{a} or {b}"),
        _two_colours,
    ),
    "how-many": cue(
        "how many (separate|different|single|distinct|individual|of the|of these|of them|of all the|of) (the)|(the) (total) [number|count] of"
        "|count (all) (of) (the)|what number of"
    ),
    "frames": cue("how many [frames|pictures|images] (in total)|the number of frames|what is the number of frames"),
    "rate": cue(
        "(the) [frame rate|framerate|fps]|how many [frames|pictures|images] [per|a|each|every] second|frames per second"
    ),
    "how-long": cue("(for) how [long|many seconds|many frames|much time]|how long in [seconds|frames]|for what time"),
    "duration": cue("how many seconds|(the) [length|duration|running time|run time|runtime] (of)|(for) how long"),
    "clip": cue(
        f"(the|this|my|our) (whole|entire) [{_CLIPS}]|it|this|of (the|this) [{_CLIPS}]|of it|in (the|this) [{_CLIPS}]|there"
    ),
    "lasts": cue("last|lasts|run|runs|take|takes|go on|goes on|have|has|contain|contains|consist of|long|go"),
    "order": cue("(in) [which|what] [order|sequence|succession]|(in) the order|order|one after the other"),
    "order-by": cue(
        {
            **{
                f"{spec}": spec
                for spec in (
                    "from left to right",
                    "from right to left",
                    "from near to far",
                    "from far to near",
                    "from front to back",
                    "from back to front",
                    "by size",
                    "by distance",
                    "by depth",
                )
            },
            "left to right": "from left to right",
            "right to left": "from right to left",
            "front to back": "from front to back",
            "near to far": "from near to far",
            "by how [far|near|close] they are": "by distance",
            "from (the) [nearest|closest] to (the) [farthest|furthest]": "from near to far",
            "by their distance": "by distance",
            "from (the) [big|biggest|largest] to (the) [small|smallest]": "by size",
            "by their size": "by size",
            "back to front": "from back to front",
        }
    ),
    "sort": cue(
        "order|sort|list|name|rank|arrange|give|enumerate|what is the order of|the order of|put in order|in order"
    ),
    "everything": cue(
        f"everything|(all) (of) (the|these|those) [{_NOUN}|contents] (you know|that you know|you see|you can see|that are there|there are)|them all"
        "|what is there|what you see|them"
    ),
    "first": cue(
        "first|last|(is|are) the first (one|thing|object) to|(is|are) the last (one|thing|object) to|earliest|before all others"
    ),
    "start": cue(f"[{_BEGIN}|continue|continues] (to)"),
    "move": cue(_PLAIN + "|" + "|".join(_MANNERS) + "|ever moving|moving about|moving around|move about"),
    "plainly": cue(_PLAIN),
    "manner": cue(_MANNERS),
    "stop": cue(_END),
    "rest": cue(_STILL),
    "stands": cue(_STANDING),
    "set-off": cue(_BEGIN),
    "turn": cue(
        f"[{_verbs('turn')}] (around|round|back|left|right|to the left|to the right|the corner)|[{_verbs('change')}] (its|his|her|the|their)"
        f" [direction|course|way|directions|heading]|make a turn|makes a turn|take a turn|take a turn"
    ),
    "nearest": cue(
        {
            f"(the|at its|its|at his|at her|at the|come|comes|get|gets) (very) [{_NEAR_MOST}] (point|position|thing|object|one|together)": ""
        }
    ),
    "farthest": cue(
        {f"(the|at its|its|at his|at her|at the|get|gets) (very) [{_FAR_MOST}] (point|position|thing|object|one)": ""}
    ),
    "front": cue("[in|at] (the) (very) [front|foreground]|in the foreground"),
    "back": cue("farthest back|furthest back|at the back|[in|at] the (very) [back|rear|background]"),
    "nearer": cue("closer|nearer|more near"),
    "farther": cue("farther (away)|further (away)|more distant"),
    "passes": cue(
        "|".join(
            map(
                _verbs,
                (
                    "pass",
                    "meet",
                    "reach",
                    "touch",
                    "pass by",
                    "come past",
                    "come by",
                    "go past",
                    "go by",
                    "cross",
                    "drive past",
                    "drive by",
                    "walk past",
                    "walk by",
                    "run past",
                    "run by",
                    "ride past",
                    "hit",
                ),
            )
        )
        + "|met|past|by"
    ),
    "highest": ~cue("at|in|reach|reaches|be")
    + ~cue("its|his|her|their|the")
    + cue("(very) [highest|top|peak|maximum height|uppermost|topmost]")
    + ~cue("(up) [point|position|place|spot|of all]|up"),
    "fastest": cue(
        f"({_ITS}|at|reach|reaches|have|has) (its|his|her|their|the) [fastest|quickest|top speed|highest speed|maximum speed|peak speed|speediest]"
    ),
    "slowest": cue(f"({_ITS}) [slowest|lowest speed|least speed|minimum speed]"),
    "most": cue(
        "(the) [most|farthest|furthest]|(has|have) (the) most [motion|movement] (in it)|the largest [motion|movement|way]"
    ),
    "more": cue("more|farther|further|the most"),
    "most-motion": cue(
        "(has|have|shows|makes|with) (the) [most|greatest|largest|biggest] [motion|movement] (in it|in them|of all)"
    ),
    "biggest": cue(
        {
            f"(the) (very) [biggest|largest|tallest|widest|longest|broadest|greatest] ({_NOUN})": "biggest",
            f"(the) (very) [smallest|tiniest|shortest|littlest|narrowest] ({_NOUN})": "smallest",
            f"(the) [bigger|larger|taller] one ({_NOUN})": "biggest",
            "the smaller one": "smallest",
        }
    ),
    "brightest": cue(
        {
            f"(the) (very) [brightest|lightest] ({_NOUN})": "brightest",
            f"(the) (very) [darkest|dimmest] ({_NOUN})": "darkest",
        }
    ),
    "speediest": cue(
        {
            f"(the) [fastest|quickest|speediest] (moving) ({_NOUN})|the [faster|quicker] (one)": "fastest",
            f"(the) [slowest] (moving) ({_NOUN})|the slower (one)": "slowest",
        }
    ),
    "bigger": cue(
        {f"(much|the|a lot) [{_BIG}] (one|in size)": "bigger", f"(much|the|a lot) [{_SMALL}] (one|in size)": "smaller"}
    ),
    "as-big": cue({"as [big|large|tall|wide|long|high]|the same size": "bigger", "as small": "smaller"}),
    "faster": cue({f"(much|the|a lot) [{_FAST}] (one)": "faster", f"(much|the|a lot) [{_SLOW}] (one)": "slower"}),
    "by-factor": cue(
        "how much|how many times|by how much|by what factor|by which factor|how many times as|what factor|to what degree|how much more"
    ),
    "closing": cue(
        {
            "(any) [closer|nearer]|toward|approach|approaches|approaching|closer together|nearer together": "closer",
            "away from|[farther|further] [from|away|apart]|apart": "away",
        }
    ),
    "place": cue(_PLACES),
    "farther-aside": cue(
        {f"(further|farther|more|most) (to|on|at) (the) {side}": f"{side} of" for side in ("left", "right")}
    ),
    "compared": cue(_COMPARED),
    "between": cue("between|in between"),
    "around": cue(
        "(close|right|directly) [next to|beside|near|close to|around|by|alongside|adjacent to|near to|surrounding|surrounds]|the neighbors of"
    ),
    "side": cue(_SIDES),
    "sides": _ON_SIDE + cue("or") + _ON_SIDE,
    "way": cue(
        f"(in|to|into|from|toward|towards) [which|what] (general) [{_DIRECTIONS}]|(the) [direction|heading] (of)|where to|whither"
        f"|[left|right] or [left|right]|(to) the [left|right] or (to) the [left|right]|what is the direction (of)"
    ),
    "whereto": cue("where"),
    "sideways": cue(
        {
            "(to|toward|towards) (the) left (side)|leftward|leftwards": "left",
            "(to|toward|towards) (the) right (side)|rightward|rightwards": "right",
        }
    ),
    "along": cue("in|to|along|into|towards|toward|from"),
    "path": cue("(along|on|which|what|describe|by) (which|what) (the) [path|route|trajectory|course|track]"),
    "how": cue("how"),
    "takes": cue("take|takes|taken|follow|follows|followed|along|" + "|".join((_PLAIN, *_MANNERS))),
    "seen": either(
        _LIKE_THIS
        + cue(
            f"visible|seen|shown|present|spotted|recognizable|(to) be [seen|found]|to be seen|{_IN_VIEW}|out there|available|exist|exists|there|here"
        ),
        _LOOKING,
        cue("do|does|can|is") + _SHOWS,
        _SHOWS,
        _LIKE_THIS + _INSIDE,
        cue(f"[{_STANDING}] [visible|seen|{_IN_VIEW}]|found|any sign of"),
    ),
    "visible": either(
        _LIKE_THIS + cue(f"visible|seen|shown|present|{_IN_VIEW}|to be seen|around|there|here|showing|shows"),
        _LOOKING,
        _INSIDE,
    ),
    "always": cue(
        f"{_EVER}|throughout (the|this) [{_CLIPS}]|(in|during|on) (all|every|each|all the) [frames|frame]|in every (single) frame|from start to finish"
        f"|(for|during|through|over|in) the [whole|entire] [{_CLIPS}]|(for|during|through|over|in) all of the [{_CLIPS}]|from (the) [beginning|start] to (the) end"
    ),
    "enter": either(
        cue(_verbs("appear|arrive|show up|turn up|pop up|emerge") + "|first appear"),
        ~cue("first")
        + cue(_verbs("enter|come into|come in|get into|move into|walk into|drive into|step into"))
        + _A_PICTURE,
    ),
    "leave": either(
        cue(_verbs("leave|exit|go out of|move out of|get out of|drop out of|drive out of|walk out of|run out of"))
        + _A_PICTURE,
        cue(_verbs("disappear|vanish|go away|go out") + "|gone|out of [sight|view|the picture|the frame]"),
    ),
    "not": cue("not|never|no longer|not ever|not an|not any"),
    "no": cue("no|not|not an|not a|not any|never"),
    "any": cue("anything|something|anyone|anybody|somebody|someone|(any|some) [thing|things|object|objects]"),
    "but": cue(
        "apart from|besides|except|except for|other than|but|but not|excluding|not counting|without|aside from|beyond"
    ),
    "do": cue("do|does|doing|did|up to|behave|behaves|act|acts"),
    "happens-to": cue(
        "what [happens|is happening|happened|goes on|is going on|is up] [to|with]|what becomes of|describe|what about"
    ),
    "happens": cue(
        "what [happens|is happening|goes on|is going on|happened|takes place|is taking place|occurs] (here|there|to see)"
        "|[describe|summarize|summarise|sum up|explain|outline] (what [happens|is going on|is happening|you see])"
        f"|what [changes|has changed|is changing|is different]|what (is) (the|this) [{_CLIPS}] [about|shows|show|showing]"
        f"|what is it (about)|what is this|what does (it|the {_CLIPS.split('|')[0]}|this) show|a [summary|description] (of)|a short [summary|description]|any action|the action"
    ),
    "contents": either(
        cue(
            "what is there (to [see|edit])|what are there|what do we have|what you (can) [see|know|have]|what there is (to see)|what is|a list"
            "|what (all) (is|are|can be) (to be) [seen|shown|visible|present|in view|on screen|available|known|in it]|the [contents|inventory]"
        ),
        cue("what|which")
        + ~cue("all")
        + ~cue(_NOUN)
        + ~cue("do|can|could")
        + cue(_YOU)
        + ~cue("can|could|all")
        + _KNOW,
        _ONES + ~cue("are|is|can be|do") + ~cue("there|seen|visible|known|shown|present|found|exist|available"),
    ),
    "list": cue("list|name|enumerate|mention|inventory|what are|[tell|show|give] me (a) (list) (of)|a list of"),
    "ends-up": cue("end up|ends up|end|ends|go|goes|finish|finishes|arrive|arrives|land|lands|finally|in the end"),
    "comes-from": cue("come from|comes from|start out|start off|starts off|starts out|begin|begins|start|starts"),
    "clip-length": cue(f"is (the|this) [{_CLIPS}]|does (the|this) [{_CLIPS}] [last|run|take|go on]"),
    "bigger-or": cue(f"(the) [{_BIG}] or (the) [{_SMALL}]|[{_SMALL}] or [{_BIG}]"),
    "faster-or": cue("faster or slower|slower or faster"),
    "nearer-or": cue("[closer|nearer] or [farther|further] (away)|[farther|further] (away) or [closer|nearer]"),
    "near-or-far": cue("near|nearby|close|close by|far|far away|far off|in the distance"),
    "keep-on": cue("keep|keeps|keeping (on)"),
    "crosses": cue(_verbs("cover")),
    "what-it": cue("what|what all"),
    "on": cue("on|in|at"),
    "can": cue("can|could"),
    "any-of": cue("any|any of"),
    "any-parts": cue(
        "[which|what] [part|parts]|what motion (is there)|any motion|any movement|what movement|the movements"
    ),
    "path-length": cue(
        "(the) (total) [distance|way] [traveled|travelled|covered|gone]|(the) [length|distance] of the [path|way|route|track|journey]"
        "|how long (is) (the) [path|way|route|journey]"
    ),
    "way-of": cue("(the) [direction|heading] (of)"),
    "sideways-or": cue("(to) (the) [left|right] or (to) (the) [left|right]|(to) (the) right or (the) left"),
}

FILLERS = _INSIDE | cue(
    "is|are|was|were|be|been|being|does|do|did|has|have|had|having|,|-|:|'s|please|exactly|approximately|roughly|actually"
    "|in total|altogether|overall|at all|ever|also|then|now|just|about|anywhere|somewhere|by the way|right now|hey|hi|hello|ok|well|so|and"
    "|here|there|currently|maybe|perhaps|really|kindly|if|whether|that|quick question|know|you know|i mean|for me|over time|any",
    "[can|could|would|will] you (please|kindly) (tell|show|say|find|give) (me|us|out)|[tell|show|give] (me|us)|say|let me know|i wonder"
    "|i am wondering|i (just) [want|need] to know|i would [like|love] to know|do you know|any idea|do you have any idea|i am curious|question"
    "|do you happen to know|find out|work out|i ask myself|what i want to know is|do you think|would you say|according to you|check|see|let us see|describe|explain|in seconds|in frames",
    f"(the|this) [{_CLIPS}]|in here|in there|in it|of them|of all|at any time|at some point|at any [point|moment]",
)
"""What adds nothing."""

ROWS = """
frames: frames clip? lasts?
rate: rate clip?
long: how-long clip lasts? | how-long clip-length | duration clip? lasts?
order: sort everything? order-by us? | contents order-by us? | order-by everything | sort? order-by thing us? | order thing order-by stands?
order: order thing? everything? start? move? | order thing? everything? set-off | who first start? move | who first set-off
nearest_moment: when nearest thing together? | when nearest thing other | when least gap pair | when least gap thing
nearest_moment: when thing passes-by | when passes thing
farthest_moment: when farthest thing together? | when farthest thing other together? | when biggest gap pair | when biggest gap thing
highest_moment: when highest thing move?
fastest_moment: when fastest thing move? lasts? | when speediest thing move?
slowest_moment: when slowest thing move?
when_turns: when turn thing start? | thing turn
@place: any place-of stands? | who place-of stands?
neighbours: who around-of stands? | who thing around | any around-of stands?
between: who pair stands? | any pair stands?
relation: where thing compared-to stands? | thing place-or stands? | who farther-aside thing | who place thing
where: thing sides stands?
polar relation: thing place-of stands? not?
polar near: thing around-of stands? not?
distance extreme=min: close thing get other | close thing get together | least gap pair | least gap thing other | close thing get
distance: gap thing other | gap pair | gap thing together | gap thing
compare_size: by-factor bigger thing other | by-factor as-big thing other | who bigger thing | thing bigger
compare_size manner=bigger: big thing compared-to | thing bigger-or other
compare_speed manner=faster: fast thing compared-to move? | thing faster-or other move?
polar compare_size: thing bigger other not? | thing as-big other not?
compare_speed: by-factor faster thing other move? | who move? faster thing
polar compare_speed: thing faster other move? not?
polar nearest: thing nearer than us? not?
polar farthest: thing farther than us? not?
nearest: who nearer thing us? | thing nearer-or other us? | who nearest thing? other? | nearest thing? other | who front stands?
farthest: who farther thing us? | who farthest thing? other? | farthest thing? other | who back stands?
most_moving: who move more thing? | who move most thing? | who most-motion thing?
biggest: who biggest thing? but? | biggest but? | who covers biggest
brightest: who brightest thing? but? | brightest but?
compare_speed: who move? speediest thing? | who speediest thing? but?
colour: which-color thing
polar colour: thing color not?
count_moving: how-many any? move but? | how-many thing move start?
polar count_moving: any move but
count: how-many thing seen? side? stands?
still: who not move start? always? | who rest always? stands? | who stands always? | how-many thing rest stands? | how-many thing not move
polar leave: thing leave not?
polar enter: thing enter not?
approach: by-factor closing-to thing get?
polar approach: thing closing-to move? get? not?
rise: high thing rise | by-how-much thing go-up
polar stops: thing stop move? not?
polar stops says=no: thing always move not? | thing keep-on move
motion: who move start? | any-parts move
does: what-it do thing | happens-to thing
fast: fast thing move? extreme? | fast extreme thing
path: path thing takes? | how thing move
where at=end: where thing stop | where thing ends-up
where at=start: where thing set-off | where thing comes-from
way: way thing move along? | whereto thing move along? | way-of thing | thing move sideways-or
polar way: thing move sideways not?
lasting: how-long thing move start?
seeing: how-long thing visible
size: big thing covers?
far: far thing move | far thing crosses | path-length thing
motion: when thing move start? | when thing stop move? | when thing set-off move? | when thing rest
enter: when thing enter
leave: when thing leave
seen: when thing visible
polar still: thing rest not?
polar motion: thing plainly start? not? | thing manner start? not? | any plainly
polar always: thing seen? always not? | thing always
always: who visible always stands?
where: where thing stands? seen? on? | thing near-or-far us?
polar side: thing seen? side stands? not?
polar seen: thing seen not? can? | no thing seen | any-of thing
things: contents seen? | happens clip? | list everything
"""
