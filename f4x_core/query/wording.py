"""What a question wants to know: a closed grammar of English questions that a scene can answer by computing.

Times are taken out first ("at second 2"), then the rest must be one of `FORMS` from its first word to its last: what is not
understood whole is refused, for half an understanding gives an answer to another question.
"""

from __future__ import annotations

import re
from dataclasses import dataclass, replace

from ..errors import F4xError
from ..language.grammar import Doubt, Reading, tokenise
from ..language.lexicon import FUNCTION_WORDS, SPELLING, misspelt
from ..language.times import Clip, Span, span

CAN = (
    "it can tell whether, where and when a thing is seen and how large, whether, when, which way, how far and how fast it moves,"
    " what moves first, when it is nearest, farthest, highest or fastest, "
    "how far two things are apart, what colour a thing has, how many"
    " there are and move, their order from left to right or in depth, what there is at a "
    "second or frame, and how long the clip is (more by a model: --endpoint or --model)"
)
"""What a refusal says."""


class Unanswerable(F4xError):  # noqa: N818  # nothing went wrong
    """A question that cannot be answered by computing."""


@dataclass(frozen=True)
class Asked:
    """A question that was understood."""

    kind: str
    """One of `FORMS`."""
    things: tuple[str, ...] = ()
    """What it is about; empty: whatever there is, or what moves."""
    span: tuple[float, float] | None = None
    """First and last clip frame that it is about; None = the clip."""
    side: str = ""
    """left, middle or right, where it asks whether a thing is there."""
    polar: bool = False
    """Whether it wants yes or no."""
    negated: bool = False
    """Whether yes means that it is not so: "Does it never move?"."""
    manner: str = ""
    """The verb, where it asks for more than motion: "Does it fly?"; the relation or the order, where it asks for one."""
    extreme: str = ""
    """min, max or mean, where it asks for one of many moments."""
    other: tuple[str, ...] = ()
    """The second of two things, also the last of `things`; empty with a kind that compares: the camera."""

    def yes(self, so: bool) -> str:
        """Yes or No where one is wanted, by whether what it asks about (without the negation) is so."""
        return "" if not self.polar else "Yes" if so != self.negated else "No"


_CLIP = r"(?:(?:the|this) (?:whole |entire )?)?(?:clip|video|film|movie|footage|sequence|recording|scene|shot)"
_PICTURE = rf"(?:{_CLIP}|(?:the |this )?(?:picture|image|view|frame)|it|here)"
_SEEN = rf"(?:there|here|present|visible|seen|shown|in view|on screen|in {_PICTURE})"
_WAY = r"(?: (?:around|about|at all|along|in total|altogether|there|now))*"
_PLAIN = r"(?:mov(?:e|es|ed|ing)|go(?:es|ing|ne)?|went|travel(?:s|led|ed|ling|ing)?|com(?:e|es|ing)|in motion)"
"""Motion of any kind."""
_MANNER = (
    r"(?:walk(?:s|ed|ing)?|run(?:s|ning)?|ran|swim(?:s|ming)?|swam|driv(?:e|es|ing|en)|drove|fl(?:y|ies|ying)|roll(?:s|ed|ing)?"
    r"|rid(?:e|es|ing)|slid(?:e|es|ing)|float(?:s|ed|ing)?)"
)
"""Motion of a kind that nobody can compute: whether a thing moves is told, not whether that is to fly."""
_MOVE = rf"(?:{_PLAIN}|{_MANNER})"
_ALWAYS = (
    rf"(?:always|constantly|permanently|throughout(?: {_CLIP})?|all the time|the (?:whole|entire) time|at all times"
    rf"|(?:in|for|during|over) (?:all|every) (?:the )?frames?|(?:in|for|during|over|through)"
    rf" (?:all of {_CLIP}|the (?:whole|entire) (?:clip|video|film|movie|sequence)))"
)
_ENTER = rf"(?:appear|show up|arrive|turn up|(?:enter|come into) (?:{_PICTURE}|view|sight))(?: in {_PICTURE})?"
_LEAVE = rf"(?:disappear|vanish|leave(?: {_PICTURE})?|exit(?: {_PICTURE})?|(?:leave|go out of) (?:view|sight))"
_CAN_SEE = r"(?:do|can|could) (?:you|i|we|one)"
_DO = r"(?:does|do|did|is|are|was|were|has|have|will)"
_START = r"(?:(?:start|begin|stop|finish|cease)(?:s|ing)? ?(?:to )?)?"
_WHO = r"(?P<who>.+?)"
_WHEN = r"(?:when|(?:(?:at|in|from|since|until) )?(?:what|which) (?:time|times|moment|second|seconds|frame|frames))"
_OTHER = r"(?P<other>.+?)"
_CAMERA = r"(?:(?:the |a )?(?:camera|viewer|lens)|me|us|you|here)"
_COLOUR = r"(?:light |dark )?(?:red|orange|yellow|green|blue|purple|pink|brown|black|white|gr[ae]y)"
_NEAR, _FAR = r"(?:the )?(?:nearest|closest)", r"(?:the )?(?:farthest|furthest|most distant)"
_US = r"(?: (?:to|from) (?:the camera|the viewer|us|me|you|here))?"

_MOMENTS = tuple(
    (
        f"{which}_moment",
        rf"{_WHEN} {_DO} {_WHO} (?:come |get |go |be )?{how}(?: away)?(?: together| (?:to|from|of) {_OTHER})?",
    )
    for which, how in (("nearest", _NEAR), ("farthest", _FAR))
)
_EXTREME = r"(?P<extreme>top|maximum|max|highest|greatest|peak|average|mean|lowest|minimum|least)"
_BETWEEN_TWO: tuple[tuple[str, str], ...] = (
    *_MOMENTS,
    (
        "nearest_moment",
        rf"{_WHEN} {_DO} {_WHO} (?:come|go|drive|walk|run|ride)? ?(?:past|pass|pass by|by)(?: {_CAMERA})?",
    ),
    ("highest_moment", rf"{_WHEN} {_DO} {_WHO} (?:at )?(?:its |his |her |the )?(?:highest(?: point)?|top)"),
    ("highest_moment", rf"which frame shows {_WHO} (?:at )?(?:its |his |her |the )?(?:highest(?: point)?|top)"),
    ("fastest_moment", rf"{_WHEN} {_DO} {_WHO} (?:{_MOVE} )?(?:the |at its )?(?:fastest|quickest)"),
    (
        "distance",
        rf"how (?:far|close|near) (?:away )?(?:is|are|was|were) {_WHO} (?:apart|(?:away )?(?:from|to) {_OTHER})",
    ),
    ("distance", rf"how far apart (?:is|are|was|were) {_WHO}"),
    ("distance", rf"(?:what is )?(?:the )?distance (?:between|from|of) {_WHO} (?:and|to|from) {_OTHER}"),
    ("distance", rf"how (?P<min>close|near) {_DO} {_WHO} (?:come|get) (?:to {_OTHER}|together)"),
    ("fast", rf"(?:what is )?(?:the )?{_EXTREME} speed (?:of|for) {_WHO}"),
    ("fast", rf"what is {_WHO}'s {_EXTREME} speed"),
    ("rise", rf"how high {_DO} {_WHO} (?:jump|rise|go|fly|leap|get|climb|hop|move)"),
    ("compare_size", rf"which (?:one )?is (?P<relation>bigger|larger|smaller),? {_WHO} or {_OTHER}"),
    ("polar compare_size", rf"(?:is|are) {_WHO} (?P<relation>bigger|larger|smaller) than {_OTHER}"),
    ("polar nearest", rf"(?:is|are|was|were) {_WHO} (?:closer|nearer)(?: to {_CAMERA})? than {_OTHER}"),
    ("nearest", rf"which (?:one )?is (?:closer|nearer)(?: to {_CAMERA})?,? {_WHO} or {_OTHER}"),
    ("nearest", rf"(?:what|who|which (?:thing|object|one)) is {_NEAR}(?: (?:thing|object|one))?(?: to {_OTHER})?"),
    (
        "farthest",
        rf"(?:what|who|which (?:thing|object|one)) is {_FAR}(?: (?:thing|object|one))?(?: away)?(?: from {_OTHER})?",
    ),
    ("biggest", r"(?:what|which (?:thing|object|one)) is the (?:biggest|largest)(?: (?:thing|object|one))?"),
    ("most_moving", rf"(?:who|what|which (?:thing|object|one)) {_MOVE} (?:the )?(?:most|farthest|furthest)"),
    ("colour", rf"(?:what|which) colou?rs? (?:is|are|does|do|has|have|was) {_WHO}(?: have)?"),
    (
        "colour",
        rf"{_WHO} (?:is|are|has|have) (?:what|which) colou?rs?|(?:what is )?(?:the )?colou?rs? of (?P<who2>.+?)",
    ),
    ("polar colour", rf"(?:is|are) {_WHO} (?P<relation>{_COLOUR}(?: or {_COLOUR})?)"),
    (
        "count_moving",
        rf"how many (?:separate |different |single )?(?:(?:things|objects|ones|"
        rf"people)(?: that)? )?(?:are |do )?{_MOVE}{_WAY}(?: in {_PICTURE})?",
    ),
    (
        "polar count_moving",
        rf"(?:is|are) (?:anything|something|anyone|anybody)(?: else)? {_MOVE} "
        rf"(?:apart from|besides|except(?: for)?|other than|but) {_WHO}",
    ),
    (
        "count",
        rf"how many {_WHO}(?: (?:are|is) (?:there|visible)| (?:can|do) (?:you|we|i|one) (?:see|find))"
        rf"(?: (?:on|in|at) the (?P<side>left|right)(?: half| side)?)?(?: {_SEEN})?",
    ),
    ("count", r"how many (?P<who>\S+) are (?:on|in|at) the (?P<side>left|right)(?: half| side)?"),
    (
        "order",
        r"(?:order|sort|list|name|rank|tell me|give me) (?:everything|(?:all )?(?:of )?(?:the )?(?:things|objects)|what is there)"
        r" (?P<relation>from left to right|by distance|from near to far|from front to back|by depth)",
    ),
    ("order", r"what (?:is there|do you see) (?P<relation>from left to right|from near to far|from front to back)"),
    (
        "polar relation",
        rf"(?:is|are|was|were) {_WHO} (?P<relation>in front of|behind|left "
        rf"of|right of|to the left of|to the right of|above|below) {_OTHER}",
    ),
    ("behind", rf"(?:what|who) is behind {_WHO}"),
    ("neighbours", rf"(?:what|who) is (?:next to|beside|near|close to|around) {_WHO}"),
    ("between", rf"(?:is there (?:anything|something)|what is(?: there)?) between {_WHO} and {_OTHER}"),
    ("still", r"what (?:is|are|stands?|stays?|keeps?)(?: standing| staying)? (?:still|at rest|stationary|static)"),
    ("does", rf"what (?:does|do|did) {_WHO} do"),
    ("polar stops", rf"{_DO} {_WHO} (?:ever )?(?:stop|pause|come to a stop|halt|stand still)(?: moving)?"),
    ("where at the end", rf"where {_DO} {_WHO} (?:end|go|finish)(?: up)|where (?P<who2>.+?) ends up"),
)
"""Questions that compare two things, the moments of one, or the colours of one."""

FORMS: tuple[tuple[str, str], ...] = (
    (
        "frames",
        rf"how many (?:frames|pictures|images)(?: (?:are there|{_DO} {_PICTURE}"
        rf"(?: have| has| contain| last)?))?(?: in {_PICTURE})?",
    ),
    ("long", rf"how (?:long|many seconds) (?:is|are|does|do) (?:{_CLIP}|it)(?: last| run| take| go on| have)?"),
    (
        "long",
        rf"how many seconds(?: are (?:there )?in {_CLIP})?|(?:what is )?(?:the )?(?:length|duration)"
        rf"(?: of {_CLIP})?",
    ),
    ("rate", r"(?:what is )?(?:the )?(?:frame ?rate|fps)(?: of .+)?|how many frames (?:per|a) second(?: .+)?"),
    (
        "order",
        rf"(?:in )?(?:which|what) order(?: (?:do|does|did) .+? (?:{_START}){_MOVE})?|"
        rf"(?:what is )?the order of .+",
    ),
    (
        "order",
        rf"(?:what|which(?: (?:one|thing|object))?) (?:is the (?:first|last) (?:one |thing )?to "
        rf"(?:{_START})?{_MOVE}|{_START}{_MOVE} (?:first|last))",
    ),
    *_BETWEEN_TWO,
    (
        "motion",
        rf"(?:what|which (?:things?|objects?|ones?|parts?)|who) ?(?:is|are)? {_MOVE}{_WAY}|what motion is there",
    ),
    ("polar motion", rf"(?:is|are) (?:there )?(?P<who>anything|something)(?: that)?(?: is)? {_MOVE}{_WAY}"),
    ("lasting", rf"(?:for )?how (?:long|many frames|many seconds) {_DO} {_WHO} (?:{_START}{_MOVE}){_WAY}"),
    (
        "seeing",
        rf"(?:for )?how (?:long|many frames|many seconds) (?:is|are|can) (?:"
        rf"(?:i|we|you|one) see )?{_WHO} {_SEEN}",
    ),
    ("fast", rf"how (?:fast|quick|quickly|slow|slowly) {_DO} {_WHO}(?: {_MOVE}{_WAY})?"),
    (
        "fast",
        rf"(?:what is |at what |with what |at which )?(?:the )?(?:speed|velocity) "
        rf"(?:of {_WHO}|{_DO} (?P<who2>.+?) {_MOVE}{_WAY})",
    ),
    ("far", rf"(?:how far|how much|(?:what|which) distance) {_DO} {_WHO} (?:{_MOVE}|cover(?:s|ed)?){_WAY}"),
    ("where", rf"how (?:far|near|close)(?: away)? (?:is|are) {_WHO}(?: away)?{_US}"),
    (
        "size",
        rf"how (?:big|large|small|long|tall|wide|high) (?:is|are|does|do) {_WHO}(?: (?:appear|look|seem))?(?: in {_PICTURE})?",
    ),
    ("size", rf"how much of {_PICTURE} (?:is|are|does|do) {_WHO}(?: (?:cover|fill|take up))?"),
    ("motion", rf"{_WHEN} {_DO} {_WHO} {_START}{_MOVE}{_WAY}"),
    ("motion", rf"{_WHEN} {_DO} {_WHO} (?:start|begin|stop|stand still|rest)(?:s|ing)?"),
    (
        "way",
        rf"(?:in )?(?:which|what) (?:way|direction) {_DO} {_WHO} {_MOVE}{_WAY}(?: in)?"
        rf"|where {_DO} (?P<who2>.+?) {_MOVE}{_WAY}(?: to)?",
    ),
    ("enter", rf"{_WHEN} {_DO} {_WHO} (?:first )?{_ENTER}"),
    ("leave", rf"{_WHEN} {_DO} {_WHO} {_LEAVE}"),
    ("polar enter", rf"{_DO} {_WHO} (?:ever )?{_ENTER}"),
    ("polar leave", rf"{_DO} {_WHO} (?:ever )?{_LEAVE}"),
    ("seen", rf"{_WHEN} (?:can|do|did|could) (?:i|we|you|one) (?:first )?see {_WHO}(?: {_SEEN})?"),
    ("seen", rf"{_WHEN} (?:is|are|was|were|do|does|did|can) {_WHO}(?: (?:first )?{_SEEN})*"),
    ("polar still", rf"{_DO} {_WHO} (?:stand(?:s|ing)? still|still|stationary|at rest|resting|stay(?:s|ing)? still)"),
    ("polar motion", rf"{_DO} {_WHO} (?:ever )?(?:{_PLAIN}|(?P<manner>{_MANNER})){_WAY}"),
    (
        "polar always",
        rf"(?:is|are|was|were) (?:there )?{_WHO} (?:{_ALWAYS} {_SEEN}|(?:{_SEEN} )?{_ALWAYS})"
        rf"|(?:is|are|was|were) there always (?P<who2>.+?)|{_CAN_SEE} (?:always see (?P<who3>.+?)|see (?P<who4>.+?) {_ALWAYS})",
    ),
    (
        "where",
        rf"where (?:is|are|was|were|do|does|can) (?:(?:i|we|you|one) (?:see|find) )?{_WHO}(?: "
        rf"(?:be|located|placed|seen|now|visible|in {_PICTURE}))*",
    ),
    ("where", rf"(?:in|on) (?:which|what) (?:part|side|half|place)(?: of {_PICTURE})? (?:is|are) {_WHO}"),
    ("where", rf"(?:is|are) {_WHO} (?:near|nearby|close|far|far away){_US}"),
    (
        "polar side",
        rf"(?:is|are) (?:there )?{_WHO} (?:on|at|to|in) the (?P<side>left|right|middle|center|centre)"
        rf"(?:[ -]hand)?(?: side)?(?: of {_PICTURE})?",
    ),
    ("polar seen", rf"(?:is|are|was|were) there (?:also )?{_WHO}(?: {_SEEN})?"),
    (
        "polar seen",
        rf"{_CAN_SEE} (?:also )?(?:see|find|spot|recogni[sz]e|detect) {_WHO}"
        rf"(?: {_SEEN})?",
    ),
    ("polar seen", rf"(?:does|do) {_PICTURE} (?:have|show|contain|include) {_WHO}"),
    (
        "polar seen",
        rf"(?:is|are|was|were) {_WHO} {_SEEN}|(?:can|could) (?P<who2>.+?) be (?:seen|found|spotted)|any (?P<who3>.+?)",
    ),
    (
        "things",
        rf"what (?:happens|is happening|goes on|is going on|is there|are there|is it|is this|does it show|does {_CLIP} show)"
        rf"(?: to see)?(?: (?:here|there|in {_PICTURE}))*",
    ),
    ("things", rf"what (?:is|are|can be)(?: to be)? (?:seen|shown|visible|in {_PICTURE})(?: in {_PICTURE})?"),
    (
        "things",
        rf"what (?:(?:things|objects) )?(?:can|do|could) (?:i|we|you|one) see(?: (?:here|there|in {_PICTURE}))*",
    ),
    (
        "things",
        rf"(?:what|which) (?:things|objects) (?:are (?:there|seen|visible)|do you see)"
        rf"(?: in {_PICTURE})*|(?:describe|summari[sz]e)(?: {_PICTURE})?|what {_CLIP} shows|what changes",
    ),
)
"""(kind, pattern), the first that fits; a kind that begins with `polar` is answered by yes or no."""

_EXTREMES = {
    "top": "max",
    "max": "max",
    "hig": "max",
    "gre": "max",
    "pea": "max",
    "ave": "mean",
    "mea": "mean",
} | dict.fromkeys(("low", "min", "lea"), "min")
SUBJECTS = (
    (r"\bpaint|\btexture|\bmade of\b|\bmaterial", "what material a thing has"),
    (r"\bcamera|\blens|\bfocal|\biso\b|\baperture|\bshutter|\bexposure|\bzoom", "what the camera did or was set to"),
    (r"\bwhy\b|\breason|\bhow come\b", "why something happens"),
    (r"^(?:and )?who\b|\bwhose\b|\bname\b", "who somebody is"),
    (r"\bhow many\b|\bnumber of\b|\bcount\b", "how many of a kind there are"),
    (r"\bdoing\b|^what (?:does|do|did|is|are) \S", "what somebody does beyond moving"),
)
"""(pattern, what it asks for that nobody can compute), the first that fits."""
_EVERYBODY = r"(?:it|they|them|he|she|this|that|(?:some|any|every)(?:thing|one|body)|things?|objects?|one)"
"""Words for whatever there is."""
_BINDING = (
    r"\b(?:of|to|from|with|without|than|that|which|who|whose|when|while|because|before|after|behind|beside|between|under|over"
    r"|near|on|in|at|by|into|onto|not|no|never|nothing|nobody|none|neither|nor|but|except|besides|only|is|are|was|were|does|do|did|has|have|be|being|been|or|if|as|like|for|you|i|we|what|how"
    r"|camera)\b"
)
"""Words that no name of a thing holds: where one is left over, the question says more than was understood."""
_IT = r"\b(?:it|they|them)\b"
"""Words for what was named just before."""
_ASKING = r"(?:when|where|how|what|which|is|are|do|does|did|in what|in which|at what|at which)"
_POLITE = r"(?:and|so|please|hey|hi|hello|tell me|(?:can|could|would) you (?:please )?(?:tell me|say)|do you know),? "
_NEGATION = r"\b(?:no|not|never)\b"
_NOT_SO = rf"^(?:(?P<there>{_DO} there) (?:no|not (?:an?|any))|(?P<whom>{_DO} .+?) (?:not|never))\b"
"""Yes-or-no questions that ask whether something is not so."""
_SIDES = {"center": "middle", "centre": "middle"}


_ASKING_WORDS = {*FUNCTION_WORDS, *SPELLING} | {
    word for _, pattern in FORMS for word in re.findall(r"[a-z]{3,}", re.sub(r"\\.", " ", pattern))
}


def _mended(text: str) -> str:
    """`text` with what is probably misspelt as it is probably meant."""
    return re.sub(
        r"[a-z]{3,}", lambda m: m[0] if m[0] in _ASKING_WORDS else misspelt(m[0], _ASKING_WORDS) or m[0], text
    )


def read_question(question: str, fps: float, frames: int) -> tuple[Asked, ...]:
    """Parse `question`, one or several joined by "and", about a clip of `frames` frames.

    Raises F4xError: a time beyond the clip; `Unanswerable`: what no form fits.
    """
    text = " ".join(question.lower().replace("’", "'").split())
    text = re.sub(r"\b(what|where|when|who|how|there|it|that)'s\b", r"\1 is", text)
    text = re.sub(r",? (?:and )?if so,? (where|when)\b", r"? \1 is it", text)
    parts = re.split(rf"[?!.;]+ (?:and )?|,? and (?={_ASKING} )", re.sub(r"[?!.,;:\s]+$", "", text))
    understood: list[Asked] = []
    for part in parts:
        bare = re.sub(rf"^(?:{_POLITE})+", "", part)
        try:
            asked = _understood(bare, fps, frames)
        except Unanswerable:
            instead = _mended(bare)
            if instead == bare or not _fits(instead, fps, frames):
                raise
            raise Doubt(f"I do not understand '{bare}'; did you mean '{instead}'?", instead) from None
        if understood and not asked.things and re.search(_IT, part):
            asked = replace(asked, things=understood[-1].things)
        understood.append(asked)
    return tuple(understood)


def _fits(text: str, fps: float, frames: int) -> bool:
    try:
        return bool(_understood(text, fps, frames))
    except F4xError:
        return False


def _understood(text: str, fps: float, frames: int) -> Asked:
    rest, span = _without_times(text, fps, frames)
    rest = re.sub(rf"^({_DO}|can|could)n't\b", r"\1", rest)  # "Isn't it moving?" wants the same yes as "Is it moving?"
    rest = re.sub(r"n't\b", " not", rest)
    whole = rest
    rest = re.sub(_NOT_SO, lambda m: m["there"] or m["whom"], rest)
    negated = rest != whole
    for kind, pattern in FORMS:
        found = re.fullmatch(pattern, rest)
        if found is None:
            continue
        groups = found.groupdict()
        things = _names(next((text for name, text in groups.items() if text and name.startswith("who")), ""))
        beside = groups.get("other") or ""
        other = () if re.fullmatch(_CAMERA, beside) else _names(beside)
        things = None if things is None or other is None else (*things, *other)
        polar, bare = kind.startswith("polar "), kind.removeprefix("polar ")
        if things is None or (negated and not polar) or (bare in ("frames", "long", "rate") and span is not None):
            continue
        side = groups.get("side") or ""
        still = bare == "still"
        asked_kind = "motion" if still and polar else bare.removesuffix(" at the end")
        span = (frames - 1.0, frames - 1.0) if bare.endswith(" at the end") else span
        manner = groups.get("manner") or groups.get("relation") or ""
        extreme = "min" if groups.get("min") else _EXTREMES.get((groups.get("extreme") or "")[:3], "")
        side, negated = _SIDES.get(side, side), negated != (still and polar)
        return Asked(asked_kind, things, span, side, polar, negated, manner, extreme, other or ())
    subject = next((what for pattern, what in SUBJECTS if re.search(pattern, whole)), "that")
    negation = re.search(_NEGATION, whole)
    if negation and subject == "that":
        subject = f"what '{negation[0]}' asks for here"
    raise Unanswerable(f"Computing from the scene cannot tell {subject}; {CAN}.")


def _names(text: str) -> tuple[str, ...] | None:
    """The things that a phrase lists; none for whatever there is; None where it is no list of names."""
    names: list[str] = []
    for part in re.split(r",| and | or ", text):
        name = re.sub(r"^(?:the|an?|any|some|this|that|these|those|my|your) ", "", " ".join(part.split()))
        name = re.sub(rf"(?: {_SEEN})+$", "", name)
        if not name or re.fullmatch(_EVERYBODY, name):
            continue
        if re.search(_BINDING, name) or not re.fullmatch(r"[^\W\d_]+(?:[ '-][^\W\d_]+){0,3}", name):
            return None
        names.append(name)
    return tuple(dict.fromkeys(names))


def _without_times(text: str, fps: float, frames: int) -> tuple[str, tuple[float, float] | None]:
    """`text` without the time that it names, and that time in clip frames; F4xError where the clip has none such."""
    tokens = tokenise(text)
    reading = Reading.of(text, tokens, {})
    for at in range(len(tokens)):
        ways = {end: one for end, (one,) in span.at(reading, at).items() if one.kind not in ("always", "length")}
        if ways:
            end = max(ways)
            before, after = text[: tokens[at].start], text[tokens[end - 1].end :]
            return " ".join(f"{before} {after}".replace(",", " ").split()), _frames(ways[end], Clip(fps, frames))
    return text, None


def _frames(said: Span, clip: Clip) -> tuple[float, float]:
    """First and last clip frame of a span, of a moment twice the same."""
    last = clip.frames - 1
    first = said.start.resolve(clip)
    final = first if said.kind == "moment" else last if said.end is None else said.end.resolve(clip)
    for frame, moment in ((first, said.start), (final, said.end or said.start)):
        if not 0 <= frame <= clip.frames or (frame > last and not (moment.seconds or moment.clip)):
            unit, value = ("second", frame / clip.fps) if moment.seconds else ("frame", frame)
            raise F4xError(
                f"There is no {unit} {value:g}: the clip lasts {clip.frames / clip.fps:.2f} seconds, frames 0 to {last}."
            )
    first, final = min(first, last), min(final, last)
    return min(first, final), max(first, final)
