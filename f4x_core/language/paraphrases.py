"""Other ways to say what the grammar of edits knows, as rewritings of a sentence that it does not understand as it stands.

A rewriting keeps the meaning, whatever the things, colours, times and amounts are. What it makes of a sentence is read by the
grammar as usual, so a wrong guess ends in a refusal.
"""

from __future__ import annotations

import re
from collections.abc import Collection, Iterator
from functools import cache

from .asides import WISHING
from .colour_names import COLOURS

_THING = r"(?:the |my |that |this |all |both )?[\w' -]+?"
_PARTS = {"X": rf"(?P<x>{_THING})", "Y": rf"(?P<y>{_THING})", "REST": "(?P<rest>.+)", "END": "(?P<end>.+)"}
_PARTS |= {"WISHING": WISHING, "COLOUR": "|".join(sorted(COLOURS))}
_PARTS["BE"] = "(?:is|are|was|were|be|becomes?|turns?|goes|go|gets?|should be|stays?|to be)"
"""What stands in braces in a pattern."""
_REWRITINGS = r"""
^(?:(?:make|have|set) it(?: so)?|(?:i|we) (?:want|need|wish|would like))(?: that)? {X} (?:is|are|be) (?:not|n't)
    {REST}$|^(?:make|have|set)
    it(?: so)?(?: that)? {Y}
    (?:isn'?t|aren'?t) {END}$ => \g<x>\g<y> should not be \g<rest>\g<end>
^(?:{WISHING}(?:if|whether|that|when)|(?:i|we)(?: would|'d| had)? (?:really |do |just )?(?:wish|hoped?|rather|prefer)) {X}
    (?:were|was|is|are|be|would be|had been) {REST}$ => \g<x> should be \g<rest>
^(?:the )?same (?:(?:scene|shot|clip|video|thing|picture)(?: as before| again)?|as before|again),? (?:but|only|just)(?: with)?
    {X} (?:is|are|being)
    {REST}$ => make \g<x> \g<rest>
^(?:the )?same (?:(?:scene|shot|clip|video|thing|picture)(?: as before| again)?|as before|again),? (?:but|only|just)(?: with)?
    {END}$ => make \g<end>
^(?:let me see|i want to see|i'd like to see|imagine|picture|what if|what about|how about|suppose) {X} {BE} {REST}$ => make
    \g<x> \g<rest>
^(?:{WISHING})?(?:what|how) (?:would {X} look|{Y} (?:would look|looks?)) (?:like )?{REST}$ => make \g<x>\g<y> \g<rest>
^(?P<verb>turn|rotate|flip|spin|swivel|face) {X},? (?:so |such )?(?:that )?(?:it|he|she|they)(?:'s| is| are)?
    (?:looks?|faces?|points?|looking|facing|pointing|turned) {REST}$ => turn \g<x> \g<rest>
^.*\bcolou?r (?:is|=|:) (?P<c>#[0-9a-f]{6}|(?:\w+ )?(?:{COLOUR}))\b[ ,.;:-]+(?:please |so |and |can you |now
    )*(?:put|use|apply|slap|get) (?:that|it|this)(?: colou?r)? (?:on|for|to|onto) {REST}$ => make \g<rest> \g<c>
^(?:instead of|rather than|not) (?:being )?(?:{COLOUR}),? {REST}$ => \g<rest>
^(?:i|we) (?:(?:do not|don'?t) (?:really )?(?:like|want)|hate|dislike|am not fond of) how (?P<a>[a-z]+) {X}
    (?:is|are|looks?|seems?)(?P<rest>.*)$ => \g<x> is too \g<a>\g<rest>
^(?P<noun>)(?P<x>(?:(?!\b(?:then|let|start|but|and (?:let|have|make|then))\b)[\w' -])+?),? (?:in|to) (?P<rest>[\w ]+?)[.!]*$
    => make \g<x> \g<rest>
^(?:only |just )?{X} in (?:full )?colou?r,? (?:and |with )?(?:everything else|(?:the )?(?:rest|world|others?)|all else)(?: in|
    is| stays| goes| should be)? (?:black and white|gr[ae]y|monochrome|b&w|bw|greyscale|grayscale)$ => only \g<x> keeps its color
^(?:change|set|make|adjust|grade|tweak|shift|correct|bring|get|alter|tune|modify|balance) (?:the colou?rs? of )?{X}(?:'s
    colou?rs?)? to (?:match|fit|be like) (?:that of |those of )?{REST}$ => match \g<x> to \g<rest>
^(?:swap|replace|exchange|change|switch|trade|turn) (?:out )?(?:the |its |all the )?(?:{COLOUR}) (?:colou?r )?(?:of|on|in) {X}
    (?:for|with|by|to|into) (?:a |an |the |some )?{REST}$ => make \g<x> \g<rest>
^(?:please )?(?:stop|keep|prevent|hinder) {X} from (?:moving|going anywhere|driving|walking|running)(?P<rest>.*)$ =>
    freeze \g<x>\g<rest>
^{X} (?:is|are|was|were) (?!to\b)[^,;.]+?,? (?:and|so) (?:(?:it|they|he|she) )?(?P<modal>should|must|ought to|has to|have
    to|needs? to|can|could|may) {REST}$ => \g<x> \g<modal> \g<rest>
^(?:please )?keep (?P<x>what (?:moves|stands still)|(?:the )?(?:selection|moving (?:things?|objects?))|what is selected)$ =>
    keep only \g<x>
^(?:turn|change|make|transform) (?:the )?(?:day|daytime|daylight) (?:in)?to night$ => make everything look like night
"""
_ORDERS = r"""
^(?:please )?(?:make sure|ensure|see to it|be sure|i want|i need|i wish|i'd like|take care) (?:that )?{X}
    (?:is|are|looks?|becomes?|gets?) {REST}$ => make \g<x> \g<rest>
^(?:before|prior to) (?:you |we |i )?(?P<b>.+?), (?:please |first )?(?P<a>.+)$ => \g<a>. \g<b>
^(?P<b>.+?),? but (?:only |just )?(?:after|once) (?:you |we )?(?:have |'ve )?(?P<a>.+)$ => \g<a>. \g<b>
^(?P<a>.+?),? before (?P<b>[a-z]+ing (?:the|it|my|that|all|every)[a-z]* .+)$ => \g<a>. \g<b>
^before (?P<b>[a-z]+ing (?:the|it|my|that|all|every)[a-z]* .+?),?
    (?P<a>(?:make|turn|paint|move|put|blur|remove|delete|hide|play|slow|speed|copy|let|set) .+)$
    => \g<a>. \g<b>
^(?:after|besides|as well as|in addition to|apart from|along with|together with|on top of) (?P<a>[a-z]+ing
    (?:the|it|my|that|all|every)[a-z]* .+?),? (?P<b>(?:also
    )?(?:make|turn|paint|move|put|blur|remove|delete|hide|play|slow|speed|copy|let|set) .+)$
    => \g<a>. \g<b>
"""
"""Sentences whose second part is done first."""


@cache  # compiled when first needed: a sentence that is understood as it stands needs none of the rewritings
def _patterns(rows: str) -> tuple[tuple[re.Pattern[str], str], ...]:
    """(pattern, what is said instead) of each row."""
    for name, part in _PARTS.items():
        rows = rows.replace(f"{{{name}}}", part)
    pairs = (row.split(" => ") for row in rows.replace("\n    ", " ").strip().splitlines())
    return tuple((re.compile(pattern, re.IGNORECASE), instead) for pattern, instead in pairs)


def in_order(sentence: str) -> Iterator[str]:
    """What the sentence means for sure where its own words would mislead: "before you delete the fence, make the horse gray"."""
    for pattern, instead in _patterns(_ORDERS):
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
        if re.search(r"\b(?:the|a|my) $", before) and not word[0].endswith("ing"):
            continue  # "show me the jump at half speed"
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
    for pattern, instead in _patterns(_REWRITINGS):
        match = pattern.match(plain)
        if match and "noun" in match.groupdict() and plain.split()[0].lower() in verbs:
            continue
        other = " ".join(match.expand(instead).split()) if match else plain
        if other not in tried and other.lower() != plain.lower():
            tried.add(other)
            yield other
