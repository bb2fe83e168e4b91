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
_PICTURE = rf"(?:{_CLIP}|(?:the |this )?(?:picture|image|view|frame)|it|here|sight)"
_SEEN = (
    rf"(?:there|here|present|visible|seen|shown|found|spotted|in view|on screen|on view|in (?:the"
    rf" )?sight|(?:with)?in {_PICTURE}"
    rf"|to be seen)"
)
_WAY = rf"(?: (?:around|about|at all|along|in total|altogether|overall|there|now|ever|in {_PICTURE}))*"
_STANDS = (
    r"(?:stand(?:s|ing)?|stay(?:s|ing)?|remain(?:s|ing)?|keep(?:s|ing)?|lie[s]?|lying|sit(?:s|ting)?"
    r"|located|placed|to be found)"
)
_PLAIN = (
    r"(?:mov(?:e|es|ed|ing)|go(?:es|ing)?|went|travel(?:s|led|ed|ling|ing)?|com(?:e|es|ing)|in"
    r" motion|head(?:s|ing)?)"
)
"""Motion of any kind."""
_MANNER = (
    r"(?:walk(?:s|ed|ing)?|run(?:s|ning)?|ran|swim(?:s|ming)?|swam|driv(?:e|es|ing|en)|drove|fl(?:y"
    r"|ies|ying)|roll(?:s|ed|ing)?"
    r"|rid(?:e|es|ing)|slid(?:e|es|ing)|float(?:s|ed|ing)?|jump(?:s|ed|ing)?|race[sd]?|gallop(?:s"
    r"|ing)?|danc(?:e|es|ing)|jog(?:s|ging)?)"
)
"""Motion of a kind that nobody can compute: whether a thing moves is told, not whether that is to fly."""
_MOVE = rf"(?:{_PLAIN}|{_MANNER})"
_ALWAYS = (
    rf"(?:always|constantly|permanently|throughout(?: {_CLIP})?|all the time|the (?:whole|entire) time|at all times"
    rf"|(?:in|for|during|over) (?:all|every|each) (?:the )?frames?|(?:in|for|during|over|through)"
    rf" (?:all of {_CLIP}|the (?:whole|entire) (?:clip|video|film|movie|sequence)))"
)
_ENTER = (
    rf"(?:appear|show up|arrive|turn up|(?:first )?(?:enter|come into|come in|get into) ?(?:{_PICTURE}"
    rf"|view|sight)?)(?: in {_PICTURE})?"
)
_LEAVE = (
    rf"(?:disappear|vanish|(?:leave|exit|go out of|move out of|get out of|drop out of)(?: (?:{_PICTURE}|view|sight))?"
    rf"|go away|go out)(?: from {_PICTURE})?"
)
_YOU = r"(?:you|i|we|one|anybody|anyone|somebody|someone)"
_CAN_SEE = rf"(?:do|can|could) {_YOU}"
_DO = r"(?:does|do|did|is|are|was|were|has|have)"
_IS = r"(?:is|are|was|were)"
_START = r"(?:(?:start|begin|stop|finish|cease|end|continue)(?:s|ing)? ?(?:to )?)?"
_WHO = r"(?P<who>.+?)"
_MOMENT = r"(?:time|times|moment|moments|second|seconds|frame|frames|point|point in time|instant|picture)"
_WHEN = (
    rf"(?:when(?: exactly)?|(?:(?:at|in|from|since|until|on|by) )?(?:what|which) {_MOMENT}|from when"
    rf"(?: to when)?|until when|since when)"
)
_OTHER = r"(?P<other>.+?)"
_CAMERA = r"(?:(?:the |a )?(?:camera|viewer|lens|observer)|me|us|you|here)"
_COLOUR = r"(?:light |dark |bright )?(?:red|orange|yellow|green|blue|purple|pink|brown|black|white|gr[ae]y|beige)"
_NEAR, _FAR = r"(?:the )?(?:nearest|closest)", r"(?:the )?(?:farthest|furthest|most distant)"
_US = rf"(?: (?:to|from) {_CAMERA})?"
_HIGHEST = (
    r"(?:at |in |reach(?:es)? |be )?(?:its |his |her |their |the )?(?:highest(?: point| position)?"
    r"|top|peak|maximum height)"
)
_THING = r"(?:thing|object|one|item|person|animal)s?"
_WHAT = rf"(?:what|who|which(?: {_THING}| of (?:the|these|those)(?: {_THING}| two)?)?)"
_IN = rf"(?: (?:(?:in|of|on) {_PICTURE}|here|there))*"
_EXTREME = r"(?P<extreme>top|maximum|max|highest|greatest|peak|average|mean|lowest|minimum|least)"
_SIDE = r"(?:left|right)"
_PLACES = (
    rf"(?:in front of|behind|above|below|under|over|(?:(?:to|on|at) (?:the )?)?{_SIDE}(?:[ -]hand)?"
    rf"(?: side)? of|next to|beside|near|close to)"
)
_FASTER = r"(?:faster|quicker|slower)"
_TURN = (
    rf"(?:turn(?:s|ing)?(?: around| round| back| (?:to the )?{_SIDE})?|change(?:s)? (?:its |his |her"
    rf" |the |their )?(?:direction|course|way))"
)
_CLOSER = (
    rf"(?:(?:(?:{_PLAIN}|get(?:s|ting)?|{_MANNER}) )?(?P<relation>closer|nearer|towards?|away from"
    rf"|farther from)(?: (?:to|towards?))?"
    rf"|{_PLAIN} (?P<relation2>apart|away))"
)

FORMS: tuple[tuple[str, str], ...] = (
    # The clip
    (
        "frames",
        rf"how many (?:frames|pictures|images)(?: (?:are there|{_DO} {_PICTURE}(?: have| has| contain| last)?))?{_IN}",
    ),
    ("long", rf"how (?:long|many seconds) {_DO} (?:{_CLIP}|it)(?: last| run| take| go on| have)?"),
    (
        "long",
        rf"how many seconds(?: are (?:there )?in {_CLIP})?|(?:what is )?(?:the )?(?:length|duration)(?: of {_CLIP})?",
    ),
    ("rate", r"(?:what is )?(?:the )?(?:frame ?rate|fps)(?: of .+)?|how many frames (?:per|a) second(?: .+)?"),
    # Order
    (
        "order",
        rf"(?:in )?(?:which|what) order(?: (?:do|does|did) .+? (?:{_START}){_MOVE})?|(?:what is )?the order of things",
    ),
    (
        "order",
        rf"{_WHAT} (?:{_IS} the (?:first|last) (?:one |thing )?to (?:{_START})?{_MOVE}|{_START}{_MOVE} (?:first|last))",
    ),
    (
        "order",
        r"(?:(?:can you )?(?:order|sort|list|name|rank|arrange|tell me|give me)|what is the order of"
        r"|what is) (?:everything|(?:all )?(?:of )?(?:the )?"
        r"(?:things|objects|items)|what is there|the order) ?(?:in order )?(?P<relation>from (?:left"
        r" to right|right to left|near to far|far to near"
        r"|front to back|back to front)|by (?:distance|depth|how (?:far|near|close) they are|size))(?:"
        r" (?:to|from) (?:the camera|us))?",
    ),
    ("order", r"what (?:is there|do you see) (?P<relation>from left to right|from near to far|from front to back)"),
    # Moments
    *(
        (
            f"{which}_moment",
            rf"{_WHEN} {_DO} {_WHO} (?:come |get |go |be |at )?{how}(?: point)?(?: away)?(?: together|(?:"
            rf" to each other)|(?: (?:to|from|of) {_OTHER}))?",
        )
        for which, how in (("nearest", _NEAR), ("farthest", rf"(?:{_FAR}|{_FAR} apart)"))
    ),
    ("nearest_moment", rf"{_WHEN} {_DO} {_WHO} (?:{_MOVE} )?(?:past|pass|pass by|by)(?: {_OTHER})?"),
    ("highest_moment", rf"(?:which (?:frame|moment) shows|{_WHEN} {_DO}) {_WHO} (?:{_MOVE} )?{_HIGHEST}"),
    (
        "fastest_moment",
        rf"{_WHEN} {_DO} {_WHO} (?:(?:{_MOVE}|reach|have|be|at) )?(?:the |at )?(?:its |his |her |their"
        rf" )?(?:fastest|quickest|(?:top|highest|maximum) speed)",
    ),
    ("slowest_moment", rf"{_WHEN} {_DO} {_WHO} (?:{_MOVE} )?(?:the |at (?:its|his|her) )?(?:slowest|lowest speed)"),
    ("nearest_moment", rf"{_WHEN} {_DO} {_WHO} (?:meet|reach|touch) {_OTHER}"),
    ("when_turns", rf"{_WHEN} {_DO} {_WHO} (?:start(?:s|ing)? (?:to )?)?{_TURN}"),
    # Two things
    *(
        (kind, rf"{_IS} (?:there )?(?:anything|something|anyone|anybody) (?:{_STANDS} )?(?:to the )?{place} {_WHO}")
        for kind, place in (
            ("in_front", "in front of"),
            ("behind", "behind"),
            ("left_of", "left of"),
            ("right_of", "right of"),
            ("neighbours", "(?:next to|beside|near)"),
        )
    ),
    ("relation", rf"where {_IS} {_WHO} (?P<relation>in relation|relative|compared|with respect) to {_OTHER}"),
    ("where", rf"{_IS} {_WHO} (?:on |to |at )?(?:the )?{_SIDE} or (?:on |to |at )?(?:the )?{_SIDE}(?: side)?{_IN}"),
    (
        "nearest_moment",
        rf"{_WHEN} {_DO} {_WHO} meet|{_WHEN} is the distance between (?P<who2>.+?) and {_OTHER} (?:the"
        rf" )?(?:smallest|shortest)",
    ),
    ("farthest_moment", rf"{_WHEN} is the distance between {_WHO} and {_OTHER} (?:the )?(?:largest|biggest|greatest)"),
    (
        "distance",
        rf"(?:what is )?(?:the )?(?P<min>shortest|smallest|minimum|minimal|closest) distance (?:between"
        rf"|from|of) {_WHO} (?:and|to|from) {_OTHER}",
    ),
    ("distance", rf"(?:what is )?(?:the )?distance from {_CAMERA} to {_WHO}"),
    ("compare_size", rf"how much (?P<relation>bigger|larger|smaller) {_IS} {_WHO} than {_OTHER}"),
    ("compare_speed", rf"how much (?P<relation>{_FASTER}) {_DO} {_WHO} than {_OTHER}"),
    ("polar relation", rf"{_IS} {_WHO} (?:{_STANDS} )?(?:further |farther )?(?P<relation>{_PLACES}) {_OTHER}"),
    (
        "relation",
        rf"{_IS} {_WHO} (?:{_STANDS} )?(?P<relation>{_PLACES})(?: (?P<other2>.+?))? or (?:{_PLACES}) {_OTHER}",
    ),
    (
        "relation",
        rf"{_WHAT} {_IS} (?:further |farther |more )?(?:to |on )?(?:the )?(?P<relation>{_SIDE}|in front"
        rf"|behind),? {_WHO} or {_OTHER}",
    ),
    (
        "distance",
        rf"how (?:far|close|near) (?:away )?{_IS} {_WHO} (?:to each other|apart|(?:away )?(?:from|to) {_OTHER})",
    ),
    ("distance", rf"how (?:far|close) (?:apart {_IS} {_WHO}|is it from (?P<who2>.+?) to {_OTHER})"),
    (
        "distance",
        rf"(?:what is )?(?:the |how (?:big|large) is the )?(?:distance|gap|space) (?:between|from|of)"
        rf" {_WHO} (?:and|to|from) {_OTHER}",
    ),
    ("distance", rf"how (?P<min>close|near) {_DO} {_WHO} (?:come|get)(?: to {_OTHER}| together)?"),
    ("polar leave", rf"{_DO} {_WHO} (?:ever )?{_LEAVE}"),
    (
        "polar count_moving",
        rf"(?:{_IS}|does|do) (?:anything|something|anyone|anybody)(?: else)? {_MOVE} (?:apart from|besides"
        rf"|except(?: for)?|other than|but) {_WHO}",
    ),
    ("polar approach", rf"{_DO} {_WHO} {_CLOSER}(?: together| (?:each other|one another)| {_OTHER})?"),
    ("polar approach", rf"{_DO} {_WHO} (?P<relation>approach(?:es|ing)?|leav(?:e|ing)) {_OTHER}"),
    ("compare_speed", rf"{_WHAT} (?:{_IS}|{_MOVE}) (?P<relation>{_FASTER}),? {_WHO} or {_OTHER}"),
    ("polar compare_speed", rf"{_DO} {_WHO} (?:{_MOVE} )?(?P<relation>{_FASTER}) than {_OTHER}"),
    (
        "compare_size",
        rf"{_WHAT} {_IS} (?:the )?(?P<relation>bigger|larger|smaller|taller|wider)(?: one)?,? {_WHO} or {_OTHER}",
    ),
    ("compare_size", rf"{_IS} {_WHO} or {_OTHER} (?:the )?(?P<relation>bigger|larger|smaller|taller|wider)"),
    ("polar compare_size", rf"{_IS} {_WHO} (?P<relation>bigger|larger|smaller|taller|wider) than {_OTHER}"),
    ("polar nearest", rf"{_IS} {_WHO} (?:closer|nearer)(?: to {_CAMERA})? than {_OTHER}"),
    ("polar farthest", rf"{_IS} {_WHO} (?:farther|further)(?: away)?(?: from {_CAMERA})? than {_OTHER}"),
    ("nearest", rf"{_WHAT} {_IS} (?:closer|nearer)(?: to {_CAMERA})?,? {_WHO} or {_OTHER}"),
    ("farthest", rf"{_WHAT} {_IS} (?:farther|further)(?: away)?(?: from {_CAMERA})?,? {_WHO} or {_OTHER}"),
    ("most_moving", rf"{_WHAT} {_MOVE} (?:more|farther|further),? {_WHO} or {_OTHER}"),
    # The one that is most
    ("nearest", rf"{_WHAT} {_IS} {_NEAR}(?: {_THING})?(?: to {_OTHER})?{_IN}"),
    ("nearest", rf"which {_WHO} {_IS} {_NEAR}(?: {_THING})?(?: to {_CAMERA})?"),
    ("farthest", rf"{_WHAT} {_IS} {_FAR}(?: {_THING})?(?: away)?(?: from {_OTHER})?{_IN}"),
    ("biggest", rf"{_WHAT} (?:{_IS}|look[s]?) (?:the )?(?P<relation>biggest|largest|smallest)(?: {_THING})?{_IN}"),
    ("brightest", rf"{_WHAT} {_IS} (?:the )?(?P<relation>brightest|lightest|darkest)(?: {_THING})?{_IN}"),
    ("most_moving", rf"{_WHAT} {_MOVE} (?:the )?(?:most|farthest|furthest)"),
    (
        "compare_speed",
        rf"{_WHAT} (?:{_IS}|{_MOVE}) (?:the )?(?P<relation>fastest|quickest|slowest)(?: {_THING})?(?:"
        rf" {_MOVE} {_THING})?{_IN}",
    ),
    ("nearest", rf"{_WHAT} {_IS} (?:{_STANDS} )?(?:in|at) (?:the )?(?:very )?front"),
    ("farthest", rf"{_WHAT} {_IS} (?:{_STANDS} )?(?:in|at) the (?:very )?(?:back|rear|background)"),
    # Beside a thing
    ("behind", rf"{_WHAT} {_IS} (?:{_STANDS} )?behind {_WHO}"),
    ("in_front", rf"{_WHAT} {_IS} (?:{_STANDS} )?in front of {_WHO}"),
    *(
        (
            f"{side}_of",
            rf"{_WHAT} (?:{_IS} (?:{_STANDS} )?|{_STANDS} )(?:(?:to|on|at) (?:the )?)?{side}(?:[ -]hand)?"
            rf"(?: side)? of {_WHO}",
        )
        for side in ("left", "right")
    ),
    (
        "neighbours",
        rf"{_WHAT} (?:{_IS} (?:{_STANDS} )?|{_STANDS} )(?:next to|beside|near|close to|around|by|alongside) {_WHO}",
    ),
    (
        "between",
        rf"(?:is there (?:anything|something|anyone|anybody)|{_WHAT} {_IS}(?: there)?(?: {_STANDS})?)"
        rf" (?:in )?between {_WHO} and {_OTHER}",
    ),
    # Colour and number
    (
        "colour",
        rf"(?:what|which) colou?rs? {_DO} {_WHO}(?: have)?|(?:what|which) (?:is )?(?:the )?colou?r(?:s)?"
        rf" (?:of|has|have) (?P<who3>.+?)",
    ),
    (
        "colour",
        rf"{_WHO} (?:is|are|has|have) (?:what|which) colou?rs?|(?:(?:what|which) (?:is|are) )?(?:the )?"
        rf"(?:main )?colou?rs? of (?P<who2>.+?)",
    ),
    ("colour", rf"what is {_WHO}'s colou?r"),
    ("colour", rf"{_IS} {_WHO} (?P<relation>{_COLOUR},? or {_COLOUR})"),
    ("polar colour", rf"{_IS} {_WHO} (?P<relation>{_COLOUR})"),
    (
        "count_moving",
        rf"how many (?:separate |different |single )?(?:{_THING}|people)?(?: ?that)? ?(?:are |do |is )?{_MOVE}{_WAY}"
        rf"(?: in {_PICTURE})?",
    ),
    (
        "count",
        rf"how many (?:of )?(?:the )?(?:different )?{_WHO}(?: (?:are|is)(?: there)?(?: {_STANDS})?| (?:can"
        rf"|do|could) {_YOU} (?:see|find|spot|count)|"
        rf" (?:can|could) be| does {_PICTURE} (?:have|show|contain))?"
        rf"(?: {_SEEN})*(?: (?:on|in|at) the (?P<side>left|right)(?: half| side)?)?(?: {_SEEN}| of {_PICTURE})*",
    ),
    (
        "count",
        rf"(?:what is )?(?:the )?(?:count|number) (?:of )?{_WHO}(?: {_SEEN})*|count (?:all )?(?P<who2>.+?)"
        rf"(?: {_SEEN})*",
    ),
    # What there is
    (
        "still",
        rf"{_WHAT} (?:(?:is|are|does|do) (?:not|never) {_MOVE}|(?:{_IS} )?(?:{_STANDS} )?(?:still|at rest"
        rf"|stationary|static|motionless)|{_IS} {_STANDS})",
    ),
    ("motion", rf"{_WHAT} ?{_IS}? {_MOVE}{_WAY}|what motion is there|(?:which|what) parts? (?:is |are )?{_MOVE}"),
    (
        "polar motion",
        rf"(?:{_IS}|does|do) (?:there )?(?P<who>anything|something|anybody|anyone|somebody|someone)(?:"
        rf" that)?(?: is)? {_PLAIN}{_WAY}",
    ),
    ("does", rf"what (?:does|do|did) {_WHO} do|what {_IS} (?P<who2>.+?) doing|what happens (?:to|with) (?P<who3>.+?)"),
    # Sizes, ways and moments of one thing
    ("fast", rf"how (?:fast|quick) {_DO} {_WHO}(?: {_MOVE})? (?:at|on) (?:the )?(?P<extreme>most|average|least)"),
    ("when_turns", rf"{_DO} {_WHO} (?:ever )?{_TURN}"),
    (
        "fast",
        rf"(?:what is )?(?:the )?{_EXTREME} speed (?:of|for) {_WHO}|what is (?P<who2>.+?)'s (?P<extreme2>top"
        rf"|maximum|average|mean|lowest) speed",
    ),
    (
        "fast",
        rf"how (?:fast|quick|quickly|slow|slowly) {_DO} {_WHO} at (?:its |his |her )?(?P<extreme>top|maximum"
        rf"|most|fastest)",
    ),
    ("rise", rf"how high (?:up )?{_DO} {_WHO} (?:jump|rise|go|fly|leap|get|climb|hop|move|come)(?: up)?"),
    (
        "polar stops",
        rf"{_DO} {_WHO} (?:ever )?(?:stop|pause|come to a (?:stop|halt|standstill)|halt|{_STANDS} still)"
        rf"(?: moving)?(?: (?:at (?:any|some) (?:time|point|moment)|once|in between))?",
    ),
    ("where at the end", rf"where {_DO} {_WHO} (?:end|go|finish|stop|arrive)(?: up)?|where (?P<who2>.+?) ends up"),
    ("where at the start", rf"where {_DO} {_WHO} (?:start|begin|come from)(?: out| off)?"),
    ("lasting", rf"(?:for )?how (?:long|many frames|many seconds) {_DO} {_WHO} (?:{_START}{_MOVE}){_WAY}"),
    (
        "seeing",
        rf"(?:for )?how (?:long|many frames|many seconds) (?:(?:can|could|do) {_YOU} see {_WHO}|(?:is"
        rf"|are|can) (?P<who2>.+?)(?: be)? {_SEEN})",
    ),
    ("fast", rf"how (?:fast|quick|quickly|slow|slowly) {_DO} {_WHO}(?: {_MOVE}{_WAY})?"),
    (
        "fast",
        rf"(?:what is |(?:at |with )?(?:what|which) )?(?:the )?(?:speed|velocity) (?:of {_WHO}|{_DO} "
        rf"(?P<who2>.+?)(?: {_MOVE}{_WAY}| have)?)",
    ),
    ("fast", rf"what is {_WHO}'s (?:speed|velocity)"),
    (
        "far",
        rf"(?:how far|how much|how much ground|(?:what|which|how much) distance) {_DO} {_WHO} (?:{_MOVE}"
        rf"|cover(?:s|ed)?){_WAY}",
    ),
    (
        "far",
        rf"(?:what is )?(?:the )?(?:length of the (?:path|way|route)|distance travell?ed) (?:of|by) {_WHO}"
        rf"|how long is the (?:path|way|route) of (?P<who2>.+?)",
    ),
    (
        "path",
        rf"(?:along |on |which|what|describe|tell me)? ?(?:what |which )?(?:the )?(?:path|route|trajectory"
        rf"|course|track|way) (?:{_DO} {_WHO} (?:take|follow|{_MOVE} along)|of (?P<who2>.+?))",
    ),
    ("path", rf"what is {_WHO}'s (?:path|route|trajectory|course)|how {_DO} (?P<who2>.+?) {_MOVE}{_WAY}"),
    ("distance", rf"how (?:far|near|close)(?: away)? {_IS} {_WHO}(?: away)?{_US}"),
    ("size", rf"how (?:big|large|small|long|tall|wide|high) {_DO} {_WHO}(?: (?:appear|look|seem))?{_IN}"),
    (
        "size",
        rf"(?:what is )?(?:the )?(?:size|height|width) of {_WHO}|(?:what is )?(?P<who2>.+?)'s (?:size"
        rf"|height|width)|what size {_DO} (?P<who3>.+?)(?: have)?",
    ),
    (
        "size",
        rf"how much of {_PICTURE} {_DO} {_WHO}(?: (?:cover|fill|take up|occupy))?|how much (?:space|room)"
        rf" {_DO} (?P<who2>.+?) (?:cover|fill|take up|take|occupy){_IN}",
    ),
    ("motion", rf"{_WHEN} {_DO} {_WHO} {_START}{_MOVE}{_WAY}"),
    (
        "motion",
        rf"{_WHEN} {_DO} {_WHO} (?:start|begin|stop|{_STANDS} still|rest|come to (?:a |rest)(?:stop|halt"
        rf"|standstill)?|halt|pause)(?:s|ing)?",
    ),
    (
        "way",
        rf"(?:(?:in|to|into) )?(?:which|what) (?:way|direction|side) {_DO} {_WHO} {_MOVE}{_WAY}(?: in| to)?"
        rf"|where {_DO} (?P<who2>.+?) {_MOVE}{_WAY}(?: to)?|{_DO} (?P<who3>.+?) {_MOVE} (?:to the )?{_SIDE}"
        rf" or (?:to the )?{_SIDE}"
        rf"|(?:what is )?(?:the )?direction of (?P<who4>.+?)",
    ),
    ("enter", rf"{_WHEN} {_DO} {_WHO} (?:first )?{_ENTER}"),
    ("leave", rf"{_WHEN} {_DO} {_WHO} (?:finally )?{_LEAVE}"),
    ("polar enter", rf"{_DO} {_WHO} (?:ever )?{_ENTER}"),
    ("seen", rf"{_WHEN} (?:can|do|did|could) {_YOU} (?:first |last )?see {_WHO}(?: {_SEEN})?"),
    ("seen", rf"{_WHEN} (?:is|are|was|were|do|does|did|can) {_WHO}(?: (?:be )?(?:first |last )?{_SEEN})+"),
    ("polar still", rf"{_DO} {_WHO} (?:(?:{_STANDS} )?(?:still|stationary|at rest|static|motionless)|resting)"),
    ("polar motion", rf"{_DO} {_WHO} (?:ever )?(?:{_PLAIN}|(?P<manner>{_MANNER})){_WAY}"),
    (
        "polar always",
        rf"{_IS} (?:there )?{_WHO} (?:{_ALWAYS} {_SEEN}|(?:{_SEEN} )?{_ALWAYS})"
        rf"|{_IS} there always (?P<who2>.+?)|{_CAN_SEE} (?:always see (?P<who3>.+?)|see (?P<who4>.+?) {_ALWAYS})"
        rf"|does (?P<who5>.+?) stay {_SEEN}(?: {_ALWAYS})?",
    ),
    (
        "where",
        rf"where(?:abouts)? (?:is|are|was|were|do|does|can|could|exactly is) (?:{_YOU} (?:see|find|spot) )?{_WHO}"
        rf"(?: (?:be|{_STANDS}|seen|found|now|visible|in {_PICTURE}))*",
    ),
    (
        "where",
        rf"(?:(?:in|on|at) )?(?:which|what) (?:part|side|half|place|position|corner|area|third)(?: of"
        rf" {_PICTURE})? {_DO} {_WHO}(?: (?:on|in|at|have|located|{_STANDS}))?",
    ),
    (
        "where",
        rf"(?:what is )?(?:the )?(?:position|location|place|whereabouts) of {_WHO}|(?:what is )?(?P<who2>.+?)'s"
        rf" (?:position|location|place)|where (?P<who3>.+?) is",
    ),
    ("where", rf"{_IS} {_WHO} (?:near|nearby|close|far|far away){_US}"),
    (
        "polar side",
        rf"{_IS} (?:there )?{_WHO} (?:on|at|to|in) the (?P<side>left|right|middle|center|centre)"
        rf"(?:[ -]hand)?(?: side| half)?(?: of {_PICTURE})?",
    ),
    ("polar seen", rf"(?:is|are|was|were|will) there (?:also |ever )?{_WHO}(?: {_SEEN})?"),
    ("polar seen", rf"{_CAN_SEE} (?:also |ever )?(?:see|find|spot|recogni[sz]e|detect|notice) {_WHO}(?: {_SEEN})?"),
    ("polar seen", rf"(?:does|do) {_PICTURE} (?:have|show|contain|include) {_WHO}"),
    (
        "polar seen",
        rf"{_IS} {_WHO} (?:still |also |ever )?{_SEEN}|(?:can|could) (?P<who2>.+?) be {_SEEN}|any (?P<who3>.+?)"
        rf"(?: {_SEEN})?",
    ),
    (
        "things",
        rf"what (?:happens|is happening|goes on|is going on|is there|are there|is it|is this|does it show"
        rf"|does {_CLIP} show|is shown|do we have)"
        rf"(?: to see)?{_IN}",
    ),
    ("things", rf"what (?:is|are|can be)(?: to be)? (?:seen|shown|visible|in {_PICTURE}){_IN}"),
    ("things", rf"what (?:(?:{_THING}|things) )?(?:can|do|could) {_YOU} (?:see|find|spot|recogni[sz]e){_IN}"),
    (
        "things",
        rf"(?:what|which) (?:kinds? of )?(?:things|objects|items) (?:are|can be)(?: there| seen| visible)?{_IN}"
        rf"|(?:what|which) (?:things|objects) do you see{_IN}",
    ),
    (
        "things",
        rf"(?:list|name|enumerate|tell me|show me|give me a list of|what are) (?:everything|(?:all )?"
        rf"(?:of )?(?:the )?(?:things|objects|contents|items))"
        rf"(?: (?:that )?(?:{_YOU} (?:can )?see|is|are|there is|there are))*{_IN}(?: {_SEEN})?",
    ),
    (
        "things",
        rf"(?:describe|summari[sz]e|sum up|explain)(?: {_PICTURE}| what (?:happens|is going on|you see))?{_IN}"
        rf"|what {_CLIP} (?:shows|is about)|what (?:changes|is {_CLIP} about|has changed)",
    ),
)
"""(kind, pattern), the first that fits; a kind that begins with `polar` is answered by yes or no."""

_EXTREMES = {
    **dict.fromkeys(("top", "max", "hig", "gre", "pea", "mos", "fas"), "max"),
    **dict.fromkeys(("ave", "mea"), "mean"),
    **dict.fromkeys(("low", "min", "lea"), "min"),
}
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
    r"\b(?:of|to|from|with|without|than|that|which|who|whose|when|while|because|before|after|behind"
    r"|beside|between|under|over"
    r"|near|on|in|at|by|into|onto|not|no|never|nothing|nobody|none|neither|nor|but|except|besides"
    r"|only|is|are|was|were|does|do|did|has|have|be|being|been|or|if|as|like|for|you|i|we|what|how"
    r"|camera)\b"
)
"""Words that no name of a thing holds: where one is left over, the question says more than was understood."""
_NO_NAME = (
    r"(?:.*ly|start|starts|begins?|stops?|turns?|pass(?:es)?|reach|touch|leaves?|enters?|approach"
    r"|look(?:s|ing)?|doing|move[sd]?|moving|get|gets|come|comes"
    r"|goes?|going|the|a|an|there|here|seen|visible|present|still|most|more|less|least|faster|slower"
    r"|bigger|smaller|first|last|next|together"
    r"|away|apart|around|again|fastest|slowest|highest|lowest|biggest|smallest|largest|compared|"
    r"(?:mov|walk|runn|danc|talk|eat|rain|film|driv)(?:ed|ing))"
)
"""Words that are no part of a name: a verb or an adverb that is left over."""
_NOUNS = r"fly|family|butterfly|lily|jelly|belly|dolly|ugly|lonely|elderly|early"
_DONE = (
    r"(?!bed$|red$|seed$|sled$|shed$|weed$|reed$|speed$).{2,}ed|(?!building|swing|string|ring|king"
    r"|wing|thing|ceiling|painting|clothing|railing|awning|spring).{3,}ing"
)
"""A word that no name ends with: "parked", "looking"."""
_IT = r"\b(?:it|they|them)\b"
"""Words for what was named just before."""
_ASKING = r"(?:when|where|how|what|which|who|is|are|do|does|did|can|in what|in which|at what|at which)"
_POLITE = (
    r"(?:(?:and|so|please|hey|hi|hello|okay|ok|well|now|tell me|say|show me|let me know|i wonder"
    r"|i want to know|i would like to know|also|then|but"
    r"|(?:can|could|would|will) you (?:please )?(?:tell me|say|show me|find out|work out)|do you know|any idea|and),? )"
)
_TAIL = (
    r"(?: (?:please|exactly|approximately|roughly|actually|in total|altogether|at all|by the way"
    r"|then|right now|anywhere|somewhere|in the (?:whole|entire) (?:clip|video|scene)))+$"
)
"""Words at the end that change nothing."""
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
    text = re.sub(r"\b(what|where|when|who|how|there|it|that|which)'s\b", r"\1 is", text)
    text = re.sub(r"\b(what|where|who|how)'re\b", r"\1 are", text)
    text = re.sub(r"^(what|who|which) was\b", r"\1 is", text)
    text = re.sub(r",? (?:and )?if so,? (where|when)\b", r"? \1 is it", text)
    parts = re.split(rf"[?!.;]+ (?:and )?|,? and (?={_ASKING} )", re.sub(r"[?!.,;:\s]+$", "", text))
    understood: list[Asked] = []
    for part in parts:
        bare = re.sub(_TAIL, "", re.sub(rf"^(?:{_POLITE})+", "", part))
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
        asked = found and _asked(kind, found.groupdict(), span, frames, negated)
        if asked:
            return asked
    subject = next((what for pattern, what in SUBJECTS if re.search(pattern, whole)), "that")
    strange = [word for word in re.findall(r"[^\W\d_]+", whole) if word not in _ASKING_WORDS]
    negation = re.search(_NEGATION, whole)
    adverb = next((word for word in whole.split() if re.fullmatch(".*ly", word) and not re.fullmatch(_NOUNS, word)), "")
    last = strange[-1] if strange and re.search(rf"(?<!\ba )(?<!\ban )(?<!\bthe )\b{strange[-1]}$", whole) else ""
    if negation and subject == "that":
        subject = f"what '{negation[0]}' asks for here"
    elif subject == "that" and (adverb or last):
        raise Unanswerable(f"I do not know what '{adverb or last}' means here; {CAN}.")
    raise Unanswerable(f"Computing from the scene cannot tell {subject}; {CAN}.")


def _asked(
    kind: str, groups: dict[str, str | None], span: tuple[float, float] | None, frames: int, negated: bool
) -> Asked | None:
    """The question of a form whose parts are `groups`; None where a part is no list of names."""
    named = [_names(text) for name, text in groups.items() if text and name.startswith("who")]
    beside = groups.get("other") or ""
    other = () if re.fullmatch(_CAMERA, beside) else _names(beside)
    polar, bare = kind.startswith("polar "), kind.removeprefix("polar ")
    if any(one is None for one in named) or other is None or (negated and not polar):
        return None
    if bare in ("frames", "long", "rate") and span is not None:
        return None
    if groups.get("other2") and groups["other2"] != beside:
        return None
    still = bare == "still"
    bare, _, end = bare.partition(" at the ")
    if end:
        span = (frames - 1.0, frames - 1.0) if end == "end" else (0.0, 0.0)
    things = tuple(name for one in named if one for name in one)
    if groups.get("manner") and re.fullmatch("any.*|some.*", groups.get("who") or ""):
        return None  # "is anybody dancing" asks for more than whether anybody moves
    extreme = groups.get("extreme") or groups.get("extreme2") or ""
    side = groups.get("side") or ""
    return Asked(
        "motion" if still and polar else bare,
        (*things, *other),
        span,
        _SIDES.get(side, side),
        polar,
        negated != (still and polar),
        groups.get("manner") or groups.get("relation") or groups.get("relation2") or "",
        "min" if groups.get("min") else _EXTREMES.get(extreme[:3], ""),
        other,
    )


def _names(text: str) -> tuple[str, ...] | None:
    """The things that a phrase lists; none for whatever there is; None where it is no list of names."""
    names: list[str] = []
    for part in re.split(r",| and | or ", text):
        name = re.sub(r"^(?:the|an?|any|some|this|that|these|those|my|your) ", "", " ".join(part.split()))
        name = re.sub(rf"(?: {_SEEN})+$", "", name)
        if not name or re.fullmatch(_EVERYBODY, name):
            continue
        if re.fullmatch("clip|video|film|movie|footage|scene|shot|picture|image|frame", name):
            return None
        words = name.split()
        verbs = any(re.fullmatch(_NO_NAME, word) and not re.fullmatch(_NOUNS, word) for word in words)
        if (
            verbs
            or re.fullmatch(_DONE, words[-1])
            or re.search(_BINDING, name)
            or not re.fullmatch(r"[^\W\d_]+(?:[ '-][^\W\d_]+){0,3}", name)
        ):
            return None
        names.append(name)
    return tuple(dict.fromkeys(names))


def _without_times(text: str, fps: float, frames: int) -> tuple[str, tuple[float, float] | None]:
    """`text` without the time that it names, and that time in clip frames; F4xError where the clip has none such."""
    tokens = tokenise(text)
    reading = Reading.of(text, tokens, {})
    for at in range(len(tokens)):
        ways = {
            end: one
            for end, (one,) in span.at(reading, at).items()
            if one.kind not in ("always", "length") and reading.word(end - 1) != "here"
        }
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
                f"There is no {unit} {value:g}: the clip lasts {clip.frames / clip.fps:.2f} seconds, frames 0"
                f" to {last}."
            )
    first, final = min(first, last), min(final, last)
    return min(first, final), max(first, final)
