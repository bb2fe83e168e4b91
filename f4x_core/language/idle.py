"""Words of a sentence that no phrase explains: which may be left so, and what each costs; the reading with the least is meant."""

from __future__ import annotations

from collections.abc import Collection

from .colour_names import COLOURS, SHADES
from .grammar import VOCABULARY, Reading, Rule, Token
from .lexicon import FRACTIONS, FUNCTION_WORDS, ONES, TENS, singular, word_set

FILLED, HARMLESS, UNKNOWN = 1, 10, 1000
"""Cost of a word that is known to add nothing, of one that binds others, and of one that nobody knows."""
BINDING = word_set(
    "a an the this that these those my your our his her its their of in on at for with to as so such kind sort and is are "
    "was were be being been am would could can shall may might must should i you we me us he she him they them who which "
    "there here very really quite rather just please well now ever even already yet exactly maybe perhaps about around "
    "along own do does using via did have has had want need get let it from"
)
"""Words that may be left unexplained where nothing else fits."""
PREPOSITIONS = word_set("of in on at for from to with as who which using via along about around")
"""Those that tell something of what is named behind them."""
EMPTY = word_set(
    # how much somebody means it
    "ish super ultra mega hyper insanely crazy ridiculously extremely incredibly awfully terribly damn damned darn bloody af "
    "asf duper freaking frickin fucking pretty truly wicked mad hella totally absolutely utterly really very quite rather "
    "literally basically actually honestly seriously legit lowkey highkey deadass properly proper actual sheer ever "
    # how it is done: well
    "simply nicely neatly cleanly carefully kindly gladly uniformly evenly independently separately exactly precisely "
    "correctly accurately visibly noticeably clearly obviously generally typically usually somehow already altogether "
    # what joins sentences
    "however furthermore moreover meanwhile simultaneously additionally besides hence therefore accordingly "
    # calls and slang
    "idk uhh umm ummm ngl tbh imo imho fr frfr rn asap lol lmao rofl omg haha hehe yo yoo bro bruh fam dude mate pal buddy "
    "darling honey sweetie dear sir madam alexa siri uh um umm uhm er erm hm hmm mm ah oh ooh wow whoa yay ugh okay "
    "alright like just please pls thanks cheers nah huh eh innit though maybe perhaps possibly probably anyway anyways btw"
)
"""Words that add nothing where no phrase of the grammar takes them: in whatever sense, they change no edit and no question."""
_ALONE = EMPTY | word_set("that this the being been to do would will overall wee lil")
"""Words that may stand alone without a meaning of their own."""
_MEANT = (VOCABULARY, FUNCTION_WORDS, COLOURS, SHADES, ONES, TENS, FRACTIONS)
"""Words that mean something here: negations, limits, amounts, times, directions, colours."""
_STATING = word_set("is are was were does did has")
"""Words with which it is said or asked how something is."""
_ARTICLES = word_set("a an some")
_JOINING = word_set("and but then")
_MAX_BEFORE_NOUN = 3


def _cost(tokens: list[Token], at: int, known: Collection[str], verbs: Collection[str]) -> int | None:
    """Return the cost of leaving a word unexplained; None where it may not be."""
    token = tokens[at]
    forms = {token.text, singular(token.text)}
    if not token.is_word:
        return HARMLESS if token.text in (",", "-", '"', "(", ")") else None
    if forms & set(known):
        return None
    if token.text in _ARTICLES:  # "a party hat" is not the hat
        following = {
            form for other in tokens[at + 1 : at + 1 + _MAX_BEFORE_NOUN] for form in (other.text, singular(other.text))
        }
        return None if following & set(known) else HARMLESS
    if token.text == "the" and at + 1 < len(tokens) and tokens[at + 1].text in verbs:  # "the spin" is a thing
        return None
    if token.text == "the" and _is_described(tokens[at + 1 : at + 3], known):
        return None
    if token.text in _STATING:
        return None
    if token.text in PREPOSITIONS:  # what they tell would be lost: "put it on black"; not so "turn of 90 degrees"
        return HARMLESS if _is_value(tokens[at + 1 : at + 2]) else UNKNOWN
    if token.text == "and":  # between what is understood it joins two wishes
        return UNKNOWN
    if token.text in _ALONE or token.text in BINDING:
        return HARMLESS
    begins = at == 0 or not tokens[at - 1].is_word or tokens[at - 1].text in _JOINING  # "wall red" is about a wall
    if at + 1 < len(tokens) and tokens[at + 1].text in _CARRIED and is_strange(token.text, known) and not begins:
        return HARMLESS
    meant = token.text in verbs or any(form in words for words in _MEANT for form in forms)
    return None if meant else UNKNOWN


def _is_described(tokens: list[Token], known: Collection[str]) -> bool:
    """Return True if a word and a thing stand there: "blue" and "little" of "the blue car", "the little dog" say which."""
    things = [bool({token.text, singular(token.text)} & set(known)) for token in tokens]
    return things == [False, True] and tokens[0].is_word


def _is_value(tokens: list[Token]) -> bool:
    """Return True if a number, a colour or a way stands there, which tells by itself what it is."""
    return any(token.text[0].isdecimal() or token.text in _VALUES for token in tokens)


_VALUES = {*ONES, *TENS, *COLOURS, "left", "right"}
_CARRIED = COLOURS.keys() | word_set(
    "copy copies clone clones duplicate glow halo aura blur tint shade tone trail trails echo fade contrast saturation brightness "
    "exposure speed size color colors light finish paint coat effect motion movement turn spin rotation nudge push tilt version"
)
"""What is said of these tells how they are: "emissive" of "a blue emissive glow"."""


def is_strange(word: str, known: Collection[str]) -> bool:
    """Return True if nothing in the grammar knows a word."""
    forms = {word, singular(word)}
    return word.isalpha() and forms.isdisjoint(known) and all(forms.isdisjoint(words) for words in (*_MEANT, EMPTY))


def idle_gaps(
    reading: Reading, adds_nothing: Rule, known: Collection[str], verbs: Collection[str]
) -> list[dict[int, int]]:
    """Return for each word a dictionary from the end of the unexplained words that begin there to their cost."""
    gaps: list[dict[int, int]] = []
    for at in range(len(reading.tokens)):
        ends = {end: FILLED * (end - at) for end in adds_nothing.at(reading, at) if end > at}
        cost = _cost(reading.tokens, at, known, verbs)
        gaps.append(ends if cost is None else {at + 1: cost} | ends)
    return gaps
