"""Other ways to say what the grammar of edits knows, as rewritings of a sentence that it does not understand as it stands.

A rewriting keeps the meaning, whatever the things, colours, times and amounts are. What it makes of a sentence is read by the
grammar as usual, so a wrong guess ends in a refusal.
"""

from __future__ import annotations

import re
from collections.abc import Collection, Iterator

from .asides import WISHING
from .colour_names import COLOURS

_X = r"(?P<x>(?:the |my |that |this |all |both )?[\w' -]+?)"
"""A thing."""
_REST = r"(?P<rest>.+)"
_OR = r"(?:{})".format
_COLOUR = "|".join(sorted(COLOURS))
_SAYS = _OR("must|should|can|may|not|never|is|are|has|have|needs?|wants?|gets?|becomes?|turns?|goes")
_BE = _OR("is|are|was|were|be|becomes?|turns?|goes|go|gets?|should be|stays?|to be")

_REWRITINGS: tuple[tuple[str, str], ...] = (
    # Asking and wishing
    (
        rf"^(?:make|have|set) it(?: so)?(?: that)? {_X} (?:is|are|be) (?:not|n't) {_REST}$|"
        rf"^(?:make|have|set) it(?: so)?(?: that)? {_X.replace('<x>', '<y>')} (?:isn'?t|aren'?t) {_REST.replace('rest', 'end')}$",
        r"\g<x>\g<y> should not be \g<rest>\g<end>",
    ),
    (
        rf"^(?:{WISHING}(?:if|whether|that|when)|(?:i|we) (?:really |do |just )?wish) {_X} (?:were|was|is|are|be) {_REST}$",
        r"\g<x> should be \g<rest>",
    ),
    (
        rf"^(?:let me see|i want to see|i'd like to see|imagine|picture|what if"
        rf"|what about|how about|suppose) {_X} {_BE} {_REST}$",
        r"make \g<x> \g<rest>",
    ),
    (
        rf"^(?:{WISHING})?(?:what|how) (?:would {_X} look|{_X.replace('<x>', '<y>')} (?:would look|looks?)) (?:like )?{_REST}$",
        r"make \g<x>\g<y> \g<rest>",
    ),
    (
        rf"^(?:change|edit|alter|adjust|modify|fix|make|do|set) {_X} so (?:that )?(?:it|he|she|they)(?:'s| is| are|'re| looks?|"
        rf" becomes?) {_REST}$",
        r"make \g<x> \g<rest>",
    ),
    (
        rf"^(?P<verb>turn|rotate|flip|spin|swivel|face) {_X},? (?:so |such )?(?:that )?(?:it|he|she|they)(?:'s| is| are)? "
        rf"(?:looks?|faces?|points?|looking|facing|pointing|turned) {_REST}$",
        r"turn \g<x> \g<rest>",
    ),
    (
        rf"^.*\bcolou?r (?:is|=|:) (?P<c>#[0-9a-f]{{6}}|(?:\w+ )?(?:{_COLOUR}))\b[ ,.;:-]+(?:please |so |and |can you |now )*"
        rf"(?:put|use|apply|slap|get) (?:that|it|this)(?: colou?r)? (?:on|for|to|onto) {_REST}$",
        r"make \g<rest> \g<c>",
    ),
    (rf"^(?:instead of|rather than|not) (?:being )?(?:{_COLOUR}),? {_REST}$", r"\g<rest>"),
    (
        rf"^{_X} (?:should not|shouldn't|must not|mustn't|needn't) be (?:{_COLOUR}),? but (?:rather |instead )?{_REST}$",
        r"make \g<x> \g<rest>",
    ),
    (
        rf"^(?:swap|replace|exchange|change|switch|trade|turn) {_X}'s (?:{_COLOUR}) (?:for|with|by|to|into) (?:a |an |the |"
        rf"some )?{_REST}$",
        r"make \g<x> \g<rest>",
    ),
    (
        rf"^(?:would|could|might) {_REST} (?:work|suit|look (?:good|nice)|go well|be (?:good|nice|okay)|do)(?: (?:for|"
        rf"on|with))? {_X}$",
        r"make \g<x> \g<rest>",
    ),
    # What is not wanted
    (
        rf"^(?:i|we) (?:(?:do not|don'?t) (?:really )?(?:like|want)|hate|dislike|am not fond of) how (?P<a>[a-z]+) {_X} "
        r"(?:is|are|looks?|seems?)(?P<rest>.*)$",
        r"\g<x> is too \g<a>\g<rest>",
    ),
    # What stays as it is
    (
        rf"^{_REST}(?:[,;]|,? but|,? and) (?:just )?(?:keep|leave) {_X}(?: there| alone| as it is| untouched| in place| "
        rf"visible)?$",
        r"leave \g<x> alone and \g<rest>",
    ),
    # Clipped
    (
        r"^(?P<noun>)(?P<x>(?:(?!\b(?:then|let|start|but|and (?:let|have|make|then))\b)[\w' -])+?),? (?:in|to) "
        r"(?P<rest>[\w ]+?)[.!]*$",
        r"make \g<x> \g<rest>",
    ),
    # Everything but one
    (rf"^(?:full |all )?colou?rs? only (?:on|for|in|at) {_X}$", r"only \g<x> keeps its color"),
    (
        rf"^(?:only |just )?{_X} in (?:full )?colou?r,? (?:and |with )?(?:everything else|(?:the )?(?:rest|world|others?)|all else)"
        r"(?: in| is| stays| goes| should be)? (?:black and white|gr[ae]y|monochrome|b&w|bw|greyscale|grayscale)$",
        r"only \g<x> keeps its color",
    ),
    (
        rf"^(?:the )?(?:only|one) thing (?:in colou?r|coloured|colored) (?:should be|is|stays) {_X}$",
        r"only \g<x> keeps its color",
    ),
    # Colours
    (
        rf"^give {_X} an? (?:fresh |new |nice |thick )?(?:coat|layer|lick|splash) of (?P<rest>[\w ]+?)(?: paint| colou?r)?$",
        r"paint \g<x> \g<rest>",
    ),
    (
        rf"^(?:change|set|make|adjust|grade|tweak|shift|correct|bring|get|alter|tune|modify|balance) (?:the colou?rs? "
        rf"of )?{_X}(?:'s colou?rs?)? to (?:match|fit|be like) "
        rf"(?:that of |those of )?{_REST}$",
        r"match \g<x> to \g<rest>",
    ),
    (
        rf"^(?:swap|replace|exchange|change|switch|trade|turn) (?:out )?(?:the |its |all the )?(?:{_COLOUR}) (?:colou?r "
        rf")?(?:of|on|in) {_X} (?:for|with|by|to|into) (?:a |an |the |some )?{_REST}$",
        r"make \g<x> \g<rest>",
    ),
    # Time
    (
        r"^(?:turn|change|make|transform) (?:the )?(?:day|daytime|daylight) (?:in)?to night$",
        "make everything look like night",
    ),
    (
        r"^(?P<verb>stop|freeze|pause|hold|halt) (?:time|the clock|the action|the motion|all motion"
        r"|all movement|(?:the )?playback)(?P<rest>.*)$",
        r"\g<verb> everything\g<rest>",
    ),
)
_ORDERS: tuple[tuple[str, str], ...] = (
    (
        rf"^(?:please )?(?:make sure|ensure|see to it|be sure|i want|i need|i wish|i'd like|take care) (?:that )?{_X} "
        rf"(?:is|are|looks?|becomes?|gets?) {_REST}$",
        r"make \g<x> \g<rest>",
    ),
    (
        r"^(?:do not|don't|dont|never) [a-z]+ (?P<x>(?:the |my |that |this )?[\w' ]+?)[,;.]? "
        r"(?:but |just |only |instead |rather )+(?P<a>[a-z]+ .+)$",
        r"leave \g<x> alone and \g<a>",
    ),
    (r"^(?:before|prior to) (?:you |we |i )?(?P<b>.+?), (?:please |first )?(?P<a>.+)$", r"\g<a>. \g<b>"),
    (r"^(?P<b>.+?),? but (?:only |just )?(?:after|once) (?:you |we )?(?:have |'ve )?(?P<a>.+)$", r"\g<a>. \g<b>"),
    (
        r"^(?:after|once) (?:you have|you've|we have|you|we|that,?) (?P<a>[a-z]+ .+?), (?P<b>[a-z]+ .+)$",
        r"\g<a>. \g<b>",
    ),
    (r"^(?P<b>.+?),? after (?:you |we )(?:have |'ve )?(?P<a>.+)$", r"\g<a>. \g<b>"),
    (r"^(?P<b>.+?),? but first,? (?P<a>.+)$", r"\g<a>. \g<b>"),
)
"""Sentences whose second part is done first."""
_ORDER_PATTERNS, _PATTERNS = (
    tuple((re.compile(pattern, re.IGNORECASE), instead) for pattern, instead in rewritings)
    for rewritings in (_ORDERS, _REWRITINGS)
)


def in_order(sentence: str) -> Iterator[str]:
    """What the sentence means for sure where its own words would mislead: "before you delete the fence, make the horse gray"."""
    for pattern, instead in _ORDER_PATTERNS:
        if match := pattern.match(sentence.strip()):
            yield match.expand(instead)


_NEGATED = re.compile(r"n't\b|n’t\b|\bnot\b|\bnever\b", re.IGNORECASE)


def opened(sentence: str, verbs: Collection[str]) -> Iterator[str]:
    """The command behind words that only ask for it: "do me a favour and …", "is it at all possible to …", "why don't you …"."""
    if asked := re.match(rf"{WISHING}(?:if|that|whether|for) (?P<rest>.+)$", sentence, re.IGNORECASE):
        yield asked["rest"]
    for word in re.finditer(r"[A-Za-z]+", sentence):
        before, rest = sentence[: word.start()], sentence[word.start() :].rstrip("? ")
        opener = word[0].lower() in verbs and re.fullmatch(
            rf"{WISHING}(?:(?:and|to|of|if|we|so|kind|:)[ ,:]*)*", before, re.IGNORECASE
        )
        if opener and (not _NEGATED.search(before) or re.match(r"why\b|.*\bmind\b|would", before, re.IGNORECASE)):
            yield rest


_MOST_BETWEEN = 5
"""Words between a verb and its particle."""
_MOST_FRAGMENTED = 8
"""Words of what is said in fragments: "blue. the bus. now."."""


def closed_up(sentence: str, verbs: Collection[tuple[str, ...]]) -> Iterator[str]:
    """The sentence with the particle of one of the `verbs` right behind it: "spice them up" is "spice up them"."""
    words = sentence.split()
    for at, verb in enumerate(words):
        for end in range(at + 2, min(at + 2 + _MOST_BETWEEN, len(words))):
            particle = words[end].rstrip(".,;!?")
            if (verb.lower(), particle.lower()) in verbs:
                sign = words[end][len(particle) :]
                yield " ".join(
                    [*words[: at + 1], particle, *words[at + 1 : end - 1], words[end - 1] + sign, *words[end + 1 :]]
                )


def paraphrases(sentence: str, verbs: Collection[str] = ()) -> Iterator[str]:
    """Other ways to say `sentence`, likeliest first; what begins with one of the `verbs` of commands is no noun."""
    plain = " ".join(sentence.replace("’", "'").split()).rstrip(" .!?")
    plain = re.sub(r"^(?:please|pls|kindly|hey|hi|ok|okay|so|well),? ", "", plain, flags=re.IGNORECASE)
    plain = re.sub(r",? (?:please|pls|thanks|thank you|thx|cheers)$", "", plain, flags=re.IGNORECASE)
    tried = {sentence, plain}
    if plain != sentence:
        yield plain
    if len(plain.split()) < _MOST_FRAGMENTED and "." in plain:
        yield re.sub(r"\.(?= )", ",", plain)
    for pattern, instead in _PATTERNS:
        match = pattern.match(plain)
        if match and "noun" in match.groupdict() and plain.split()[0].lower() in verbs:
            continue
        other = " ".join(match.expand(instead).split()) if match else plain
        if other not in tried and other.lower() != plain.lower():
            tried.add(other)
            yield other
