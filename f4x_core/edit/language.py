"""A plain English sentence to typed operations, by a grammar: no model, the same answer always (docs/language.md).

Every word has to be accounted for; one that is not makes the whole sentence a `Refusal`, because a wrong edit is worse than none.
"""

from __future__ import annotations

import re
import unicodedata
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import cache, lru_cache
from typing import Any

from ..errors import F4xError
from ..language.amounts import Amount, any_word, degree, number
from ..language.colour_names import COLOURS, SHADES
from ..language.colours import PURE_COLOURS, colour
from ..language.courtesies import WISHES
from ..language.grammar import (
    NAMES_TOO,
    VOCABULARY,
    Doubt,
    Final,
    Mismatch,
    Reading,
    Refusal,
    Rule,
    Slip,
    Token,
    either,
    here,
    keyword,
    literal,
    matches_of,
    silent,
    table,
    tokenise,
    unless,
    word_if,
    words_of_label,
)
from ..language.idle import EMPTY, UNKNOWN
from ..language.lexicon import (
    FUNCTION_WORDS,
    NO_THINGS,
    PICTURE,
    SYNONYMS,
    every_form,
    forms,
    inflected,
    is_slip,
    misspelt,
    singular,
    word_set,
    written,
)
from ..language.times import HALF_WAY, START, Span, TimeExpression, duration, span
from ..language.verbs import COMMAND_VERBS, IMPERATIVES, VERBS, any_form
from . import qualities
from .clauses import OF_ALL, Clause, Clauses, Search, arguments
from .commands import COMMANDS
from .description import in_words
from .graded import QUALITIES, SATURATION
from .making import BESIDE, COPY_DISTANCE, THE_COPY, by_degree, deleted, extracted, is_of_a_clip, is_of_a_picture
from .operations import (
    SHOWN,
    Delete,
    Duplicate,
    Extract,
    Freeze,
    Match,
    Opacity,
    Operation,
    Recolour,
    Retime,
    Style,
    Transform,
)
from .phrases import SentenceContext, When, familiar, known_noun, known_thing, several_placed, thing, together, whose
from .qualities import effect
from .request import Request
from .selects import All, And, Current, Instance, Named, Not, SelectKind, parts_of
from .slots import AGAIN, REMARK, TOPIC, Command
from .styles import STYLES
from .which import removes

MAX_CHARACTERS, MAX_WORDS = 1500, 120
"""Characters and words of a sentence that is read; a person says less at once."""
MAX_BARRED = 3
"""Commands that fit a sentence and cannot be carried out, before it is given up."""


_polite = keyword("please|could|can|maybe|perhaps|would") | WISHES
_POLITE_BEFORE = 8
"""Words within which a request begins: "okay, now could you"."""
_ASKED_FOR = frozenset(
    form for verb in (IMPERATIVES - FUNCTION_WORDS) | {"have", "let"} for form in (verb, *forms(verb))
)
"""With which the command begins behind words that only ask for it: "would you mind making"."""
_DROPPED = word_set("please kindly thanks thank")


def parse(
    request: Request, *, copies: Mapping[SelectKind, SelectKind] | None = None, earlier: str = ""
) -> tuple[Operation, ...]:
    """Return the operations that a sentence asks for, in order; selections are words, not yet resolved in a scene.

    `copies`: those of earlier sentences -> what was copied; `earlier`: the sentence before, of which "it", "the other one" and
    "the cat too" may speak. Raises `Refusal`.
    """
    if len(request.sentence) > MAX_CHARACTERS:
        raise Refusal(
            f"The sentence has {len(request.sentence)} characters, more than {MAX_CHARACTERS}; say fewer commands at once."
        )
    sentence = written(request.sentence)
    known = _known(tuple(request.labels), tuple(request.names))

    def settled(read: Read) -> tuple[Operation, ...]:
        context = SentenceContext(
            request.fps,
            request.frames,
            request.frame,
            request.selected,
            {name.lower(): name for name in request.names},
            overall=any(token.text == "overall" for token in read.reading.tokens),
            earlier=copies or {},
            labels=frozenset(request.labels),
        )
        return _settled(read, context, _recalled(before, context))

    before = _clauses_before(earlier, known)
    for barred in _BARRED:
        found = re.search(barred.pattern, sentence, re.IGNORECASE)
        if found and (not barred.after_removal or (before and _deletes(before[-1]))):
            raise Refusal(barred.reason.format(words=found[0].strip()))
    read = _read(sentence, known, settled)
    if not read.clauses and _first_asked(read.reading.tokens) in _INTERROGATIVES - IMPERATIVES:
        raise Refusal(_A_QUESTION)
    for rule, doubt in _DOUBTFUL:
        if _holds(rule, read.reading):
            raise Refusal(doubt)
    if request.labels or not read.clauses:
        _ask_about_slips(read, sentence, known, settled)
    if read.clauses:
        try:
            operations = read.operations or settled(read)
            if _removes_loosely(replace(read, operations=operations)):
                asked = _without_idle(replace(read, operations=operations))
                if (strange := _named_besides(read)) and not read.reading.word(read.idle[0] - 1) == "for":
                    raise Refusal(f"I do not know what '{strange}' is, so nothing is removed.")
                raise asked if _means(asked.instead, operations, known, settled) else Refusal(asked.reason)
            return operations
        except Doubt:
            raise
        except Refusal as refusal:
            raise Refusal(refusal.reason, nearest(sentence, request.labels)) from refusal
        except F4xError as error:
            raise Refusal(f"That is not possible: {error}", nearest(sentence, request.labels)) from error
    if not (_new_thing(read.reading) or _no_edit(read.reading) or _impossible(read.reading)):
        _ask_to_leave_out(sentence, known, settled)
    reason, answer = (_SHOWN_ONLY_THEN, False) if read.only_then else _not_understood(read)
    raise Refusal(reason, nearest(sentence, request.labels) if answer else ())


@dataclass(frozen=True)
class Read:
    """A sentence that was matched, or not."""

    reading: Reading
    """The words of the sentence, or of the other way to say it that was understood."""
    clauses: Clauses = ()
    """Each behind its separators; none: not understood."""
    operations: tuple[Operation, ...] = ()
    """What it asks for, where that was worked out to know whether it is understood."""
    idle: tuple[int, ...] = ()
    """Words that no phrase explains."""
    reason: str = ""
    """Why what it asks for cannot be, where it is not understood otherwise."""

    @property
    def only_then(self) -> bool:
        """Whether "only" stands before a time."""
        return _holds(_ONLY_WHEN, self.reading)


def _holds(rule: Rule, reading: Reading) -> bool:
    """Whether a phrase stands somewhere in a sentence."""
    return any(rule.at(reading, at) for at in range(len(reading.tokens)))


Settle = Callable[[Read], tuple[Operation, ...]]
Said = tuple[Command, dict[str, Any]]
"""A command with the slots that a sentence gave it."""


def _settled(read: Read, context: SentenceContext, before: Said | None) -> tuple[Operation, ...]:
    """The operations of a sentence; raises F4xError."""
    operations = _placed([_sparing(one, context.spared) for one in list(_operations(read.clauses, context, before))])
    operations = operations or context.complaints
    if not operations:
        raise Refusal("Nothing is said that could be done.")
    if any(map(removes, operations)) and _holds(several_placed, read.reading):
        raise Refusal(
            "Of several of a kind only one can be told by its place; say for example 'the farthest person', or 'the people'."
        )
    if read.only_then and any(
        isinstance(one, Extract) or (isinstance(one, Opacity) and one.factor > 1) for one in operations
    ):
        raise Refusal(_SHOWN_ONLY_THEN)  # seen only then, or nothing else seen then
    named = {part.name for one in operations for part in _selected(one) if isinstance(part, Named)}
    spare = context.spare - named
    return tuple(
        replace(one, name="") if isinstance(one, Duplicate) and one.name in spare else one for one in operations
    )


def _read(
    sentence: str, known: Mapping[tuple[str, ...], str], settled: Settle | None = None, guess: bool = False
) -> Read:
    """A sentence with its words and clauses; a reading counts where `settled` can carry it out.

    `guess`: words that nobody knows may be left out.
    """
    reading = _words_of(sentence, known)
    found, reason = _matched(reading, known, settled, guess)
    return found or Read(reading, reason=reason)


def _matched(
    reading: Reading, known: Mapping[tuple[str, ...], str], settled: Settle | None, guess: bool
) -> tuple[Read | None, str]:
    """The reading with the cheapest idle words that can be carried out, and why others cannot."""
    reason = ""
    for _ in range(MAX_BARRED + 1):
        found = Search(reading, {words[-1] for words in known}).sentence()
        if found is None or (found.cost > UNKNOWN / 2 and not guess):
            break
        read = Read(reading, found.clauses, idle=found.idle)
        try:
            return read if settled is None else replace(read, operations=settled(read)), reason
        except Refusal as refusal:
            reason = reason or ("" if found.idle else refusal.reason)
            if isinstance(refusal, Final):
                break
        except F4xError:
            break
        tried = frozenset(id(clause.command) for clause in read.clauses)
        reading = replace(reading, barred=reading.barred | tried)  # another command may do
    return None, reason


def _words_of(sentence: str, known: Mapping[tuple[str, ...], str]) -> Reading:
    """The words of a sentence; Refusal where it is a question, too long or empty."""
    tokens = [
        token for token in _statements(tokenise(sentence)) if token.text not in _DROPPED and not _is_picture(token)
    ]
    if len(tokens) > MAX_WORDS:
        raise Refusal(f"The sentence has {len(tokens)} words, more than {MAX_WORDS}; say fewer commands at once.")
    if not any(token.is_word for token in tokens):
        raise Refusal("Nothing is said that could be done.")
    return Reading.of(sentence, tokens, known)


def _is_picture(token: Token) -> bool:
    """Whether a sign is an emoji or a bracket that means nothing here."""
    return len(token.text) == 1 and (
        token.text in "[]{}*~" or unicodedata.category(token.text) in ("So", "Sk", "Mn", "Cn")
    )


def _ask_about_slips(read: Read, sentence: str, known: Mapping[tuple[str, ...], str], settled: Settle) -> None:
    """Raise `Doubt` where a word is probably misspelt; `sentence`: what was typed, where `read` is another way to say it."""
    slip = _slip(read.reading, bool(read.clauses))
    if slip is None:
        return
    wrong, word = slip
    typed = read.reading.sentence[wrong.start : wrong.end]
    text = read.reading.sentence if read.clauses else sentence
    instead = re.sub(rf"\b{re.escape(typed)}\b", word, text, count=1)
    better = _read(instead, known, settled)
    whole = bool(better.clauses) and not better.idle
    if whole or _slip(better.reading, False):
        thing = any(word in words for words in known)
        sure = whole and not thing and is_slip(wrong.text, word) and not any(map(removes, better.operations))
        raise (Slip if sure else Doubt)(f"I do not understand '{typed}'; did you mean '{word}'?", instead)


def _deletes(clause: Clause) -> bool:
    """Whether a clause of the sentence before removed something."""
    return clause.command.make not in (REMARK, AGAIN) and clause.command.make(**arguments(clause.slots)) in (
        deleted,
        extracted,
    )


@dataclass(frozen=True)
class _Barred:
    """Words with which a sentence is refused before anything else of it is read."""

    pattern: str
    """The words, wherever they stand, in capitals or not."""
    reason: str
    """What is told; `{words}`: what was said."""
    after_removal: bool = False
    """Only where the sentence before removed something."""


_UNDO = "That may be an undoing: use `f4x undo SCENE`, or the button for it, or say what is to be removed."
_BARRED = (
    _Barred(  # what may speak of the sentence before: "scratch that"
        r"\A\s*(?:(?:oh|no|wait|nah|actually|ok|okay|please|and)\b[ ,.!]*)*(?:scratch|strike|scrap|drop|forget|cancel|kill|lose|"
        r"undo|axe|ditch|discard|never ?mind) (?:that|this)(?: one| again)?(?: please)?[ .!]*\s*\Z",
        _UNDO,
    ),
    _Barred(  # an end with which all is taken back: "make it red, forget it"
        r"[,.;!?–—-]\s*(?:oh |no |well |actually |and |but |just |on second thoughts?,? )*(?:(?:forget|scrap|ignore|cancel|undo|"
        r"scratch|strike) (?:it|that|this|all that|about (?:it|that))|never ?mind(?: that| it)?|rather not|better not|kidding|"
        r"joking|jk|not (?:that|it)(?: one)?|leave it)[ .!]*$",
        _UNDO,
    ),
    _Barred(
        r"\b(?:bring|put|get|give|have|want|need|take|add)\b.*\bback\b|\b(?:restore|undelete|unremove|come back)\b|"
        r"\b(?:show|see)\b.*\bagain\b",
        "What was removed comes back by undoing it: use `f4x undo SCENE`, or the button for it.",
        after_removal=True,
    ),
    _Barred(  # what a sentence says of something that is not to be done, in front of it
        r"\b(?:hate (?:to|it (?:if|when)|for|seeing|having)|(?:wrong|mistake|shame|pity|crime|sin|disaster|foolish|(?:bad|terrible|"
        r"awful|horrible|poor|stupid) idea) (?:to|if|that|for)|(?:refuse|decline|(?:i|we|not|would|strongly) object|hesitate) to|"
        r"refrain from|(?:avoid|against) \w+ing|(?:forbidden|prohibited|not allowed|afraid) to|doubt (?:that|if|whether)|i(?: a|"
        r"')m afraid .*\b(?:will|might|could|may|going to) (?!have to)|do you think (?:i|we|any\w+) wants? |(?:hardly|scarcely) "
        r"any(?:one|body)|(?:nobody|no one|none of us) (?!(?:\w+ )?(?:should|to see|would miss|needs))|nothing should|neither .* "
        r"nor |(?:would|could)(?:n't| not| never) want |not an option|no sense|keep (?:me|you|us|them) from|last thing (?:i|we|you|"
        r"any\w+) wants?|(?:heaven|god) forbid)",
        "'{words}' tells what is not wanted; say what is to be done.",
    ),
    _Barred(
        r"\b(?:cut|mask|key|lift|take|roto|pull)\b.*\b(?:so (?:that )?(?:i|we) can|to comp|for (?:the )?comp)\b",
        "'{words}' may mean to keep it or to drop it; say 'keep only the dog' or 'remove the dog'.",
    ),
    _Barred(
        r"\b(?:crop|trim) (?:down )?(?:the |this |my |whole |entire )*(?:scene|splats?|point cloud|everything)\b",
        "A scene is cropped by a box that you place: Add Crop Box in Blender; 'keep only the dog' keeps one thing.",
    ),
    _Barred(
        r"\b(?:scale|resize|convert|set|bring|make)\b.*\b(?:scene|everything|world)\b.*\b(?:met(?:er|re)s?|(?:real|true|life)"
        r"[- ](?:world )?(?:scale|size))\s*[.!]*\s*\Z",
        "A clip does not tell how long a meter is; Scale to Length in Blender scales the scene to a length that you know.",
    ),
    _Barred(
        r"\b(?:(?:put|place|set|stand|drop|bring) (?:the (?:whole )?scene|everything)|(?:align|level|snap) (?:it|the (?:whole )?"
        r"scene|everything)) (?:flat )?(?:on|onto|to|with) the (?:floor|ground)\b",
        "The scene's floor comes to lie on Blender's ground by Align to Floor; a sentence moves things within the scene.",
    ),
)
"""Sentences that take back, bring back, ask for a tool or say what is not to be done: the first that fits is the answer."""


_CUT = re.compile(r"\b(?:cut|mask|key|lift|crop|take|roto|comp|pull)", re.IGNORECASE)
"""Verbs that take out to keep or to drop, as it is for."""


def _ask_to_leave_out(sentence: str, known: Mapping[tuple[str, ...], str], settled: Settle) -> None:
    """Raise `Doubt` with what the sentence comes to without the words that nobody knows, where it comes to something."""
    read = _read(sentence, known, settled, guess=True)
    tokens = read.reading.tokens
    if not read.operations or _unsure(read) or 2 * len(read.idle) > sum(token.is_word for token in tokens):
        return
    if any(_is_a_verb(read.reading, at) for at in read.idle):
        return
    if any(map(removes, read.operations)) and _named_besides(read):
        return
    if "who" not in read.clauses[0].slots:
        return  # whom it is for may be what was left out
    doubt = _without_idle(read)
    if _means(doubt.instead, read.operations, known, settled):
        raise doubt


def _is_a_verb(reading: Reading, at: int) -> bool:
    """Whether a word that nobody knows says what to do with something: "knit the swan a scarf"."""
    if reading.word(at - 1) in _ASKED_FOR or any(
        reading.word(at) in words for words in (VOCABULARY, FUNCTION_WORDS, EMPTY)
    ):
        return False
    return reading.word(at + 1) in ("the", "my", "that", "it", "him", "her", "them")


def _means(
    sentence: str, operations: tuple[Operation, ...], known: Mapping[tuple[str, ...], str], settled: Settle
) -> bool:
    """Whether a sentence comes to the operations."""
    with suppress(F4xError):
        read = _read(sentence, known, settled)
        return bool(read.clauses) and (read.operations or settled(read)) == operations
    return False


def _without_idle(read: Read) -> Doubt:
    """What a sentence comes to without its idle words, to be asked."""
    tokens, typed = read.reading.tokens, read.reading.sentence
    joined: list[tuple[int, int]] = []
    for at in read.idle:
        if joined and not typed[joined[-1][1] : tokens[at].start].strip():
            joined[-1] = joined[-1][0], tokens[at].end
        else:
            joined.append((tokens[at].start, tokens[at].end))
    left_out = "', '".join(typed[start:end] for start, end in joined)
    plan = in_words(read.operations)
    return Doubt(f"I would do: {plan}. I do not know what '{left_out}' adds.", _cut(typed, joined))


def _cut(sentence: str, spans: list[tuple[int, int]]) -> str:
    """The sentence without the characters of `spans`, in order, and without the commas that then stand at its ends."""
    begins = [0, *(end for _, end in spans)]
    ends = [*(start for start, _ in spans), len(sentence)]
    kept = " ".join(" ".join(sentence[a:b] for a, b in zip(begins, ends, strict=True)).split())
    return re.sub(r"\s+([,.;!?])", r"\1", re.sub(r"^[\s,;.:!?-]+|[\s,;:-]+$", "", kept))


def _removes_loosely(read: Read) -> bool:
    """Whether something is no longer seen and a word is left unexplained that may say whether or what."""
    harmless = EMPTY | {"the"}
    words = [read.reading.word(at) for at in read.idle]
    what_for = words[:1] == ["for"] and not any(token.is_word for token in read.reading.tokens[read.idle[-1] + 1 :])
    if what_for and not _CUT.search(read.reading.sentence):
        return False
    return any(map(removes, read.operations)) and any(word not in harmless for word in words)


def _named_besides(read: Read) -> str:
    """The unknown thing with an article among the words left unexplained, which may be what is to be removed: "the graffiti"."""
    words = read.reading.words
    at = next((at for at in read.idle if words[at] in ("the", "my", "that", "those") and at + 1 in read.idle), None)
    return "" if at is None or words[at + 2] == "'s" else read.reading.text_of(at, at + 2)


def _unsure(read: Read) -> bool:
    """Whether a sentence can be meant in two ways."""
    return any(_holds(rule, read.reading) for rule, _ in _DOUBTFUL)


_SPOKEN_OF = word_set(
    "background foreground everything everyone everybody selection shadow reflection original surroundings"
)
"""Words for whom or what a command is for, which are labels of no scene."""


_INFLECTED = ("er", "ing", "ed")
"""Ends of words that nobody knows and are words all the same: "calmer" is no "calmed"."""


def _slip(reading: Reading, understood: bool) -> tuple[Token, str] | None:
    """The first word that nobody knows and the one that it may be a slip of: of a label, or of any word where none else helps."""
    parts = {word for words in reading.known for word in words}
    lexicon = _lexicon()
    for at, token in enumerate(reading.tokens):
        describes = understood and (reading.word(at + 1) == "'s" or reading.word(at + 1) in parts)
        describes = describes or token.text.endswith("est")  # a superlative is a word, and none of a thing
        if (
            token.is_word
            and not describes
            and all({token.text, singular(token.text)}.isdisjoint(words) for words in (lexicon, parts))
        ):
            meant = misspelt(token.text, parts | _SPOKEN_OF)
            meant = meant or (None if understood else misspelt(token.text, lexicon | parts))
            if meant and (is_slip(token.text, meant) or not token.text.endswith(_INFLECTED)):
                return token, meant
    return None


@cache
def _lexicon() -> frozenset[str]:
    """Every word that means something in whatever sentence."""
    return frozenset().union(VOCABULARY, NAMES_TOO, FUNCTION_WORDS, NO_THINGS, EMPTY, COLOURS, SHADES, _IMPOSSIBLE)


def _selected(operation: Operation) -> Iterator[SelectKind]:
    """Every selection in an operation."""
    for name in ("select", "source"):
        if hasattr(operation, name):
            yield from parts_of(getattr(operation, name))


_INTERROGATIVES = word_set("what where when who whose which why how is are was were am does do did has have")


_A_QUESTION = "That is a question; `f4x ask` answers those, here one says what to change."


def _first_asked(part: Sequence[Token]) -> str:
    """The first word that may ask something."""
    words = (
        token.text for token in part if token.is_word and token.text not in EMPTY | {"and", "so", "but", "then", "now"}
    )
    return next(words, "")


_SURELY_ASKED = word_set("is are does did")
"""First words of a question that no command has, so that it needs no question mark."""


def _asks(part: Sequence[Token]) -> bool:
    """Whether words ask something and are no polite command."""
    reading = Reading("", list(part))
    return _first_asked(part) in _INTERROGATIVES and not (
        WISHES.at(reading, 0) or any(_polite.at(reading, at) for at in range(min(len(part), _POLITE_BEFORE)))
    )


def _statements(tokens: list[Token]) -> list[Token]:
    """The tokens with "could you …?" ended by a full stop; Refusal when anything else is asked."""
    statements, start = [], 0
    for i, token in enumerate(tokens):
        if token.text == "?":
            if _asks(tokens[start:i]):
                raise Refusal(_A_QUESTION)
            token = Token(".", token.start, token.end)
        if token.text in (".", "!", ";"):
            start = i + 1
        statements.append(token)
    if _first_asked(tokens[start:]) in _SURELY_ASKED and _asks(tokens[start:]):
        raise Refusal(_A_QUESTION)
    return statements


@lru_cache(8)  # of the scenes that are spoken of
def _known(labels: tuple[str, ...], names: tuple[str, ...] = ()) -> Mapping[tuple[str, ...], str]:
    """Labels and names by their words, and by those of their singular."""
    known: dict[tuple[str, ...], str] = {}
    for label in (*labels, *names):
        if words := words_of_label(label):
            known.setdefault(words, label)
            known.setdefault((*words[:-1], singular(words[-1])), label)
    for word, meant in SYNONYMS.items():
        if (meant,) in known:
            known.setdefault((word,), known[(meant,)])
    return known


def _clauses_before(earlier: str, known: Mapping[tuple[str, ...], str]) -> Clauses:
    """The clauses of the sentence before; none where there is none or it is not understood."""
    try:
        return _read(earlier, known).clauses if earlier else ()
    except Refusal:
        return ()


def _recalled(clauses: Clauses, context: SentenceContext) -> Said | None:
    """The last command of the sentence before, whose things `context` takes over where nothing is selected."""
    then = replace(context, names=dict(context.names), copies={}, spare=set())
    try:
        list(_operations(clauses, then))
    except F4xError:
        return None
    if not context.selected:
        context.last, context.they = then.last, then.they
        if isinstance(context.last, Named) and context.last.name in then.copies:
            context.last = next(reversed([*context.earlier]), then.copies[context.last.name])
    done = [clause for clause in clauses if clause.command.make not in (REMARK, AGAIN)]
    return (done[-1].command, done[-1].slots) if done else None


def _operations(clauses: Clauses, context: SentenceContext, before: Said | None = None) -> Iterator[Operation]:
    """The operations of clauses; `before`: the command before them."""
    front: Span | None = None
    topics: list[SelectKind] = []
    for at, clause in enumerate(clauses := _shared(clauses)):
        command, piece = clause.command, clause.slots
        if command.make is REMARK and not {"who", "complaint"} & piece.keys():
            continue
        front = clause.front or (None if clause.hard else front)
        own = piece.get("when")
        if own and clause.front and clause.front.kind == "moment" and own.kind == "length":
            own = _about(clause.front.start, own)
        elif own and clause.front and clause.front.kind in ("moment", "from") and own.start == START and own.end:
            own = Span(clause.front.start, own.end)  # "at second 1 make it red until second 2"
        elif own and clause.front:
            raise Refusal("Two times are said for one command; leave one out.")
        who, assumed = _whom(command, piece, context, timed=front is not None)
        if "stated" in piece and not (own or front):
            raise Refusal("That says how it is, not what is to be done; say for example 'make the dog red'.")
        if command.make is REMARK:
            if assumed and not _of_a_clip(command, piece):
                raise Refusal("It is not said who is so; name a thing, or say 'it' for what is selected.")
            _remarked(who, piece, When.of(own or front, context), context)
            continue
        if command.make is AGAIN:
            if before is None:
                raise Refusal("Nothing was said before that could be done again; say what is to be done.")
            own_words = {name: value for name, value in piece.items() if name in OF_ALL}
            command, piece = before[0], {**before[1], **own_words}
            own = piece.get("when")
        before = command, piece
        topics = [*topics, who] if clause.gapped else [who]
        time = own or front or _time_behind(clauses, at)
        settled = When.of(time, context, slowly="slowly" in piece, soft=piece.get("slowly", False))
        for operation in _made(command, piece, who, settled, context, assumed):
            if operation.select == THE_COPY and context.last is not None:
                operation = replace(operation, select=context.last)  # type: ignore[arg-type]  # of a copy
            elif isinstance(operation, Duplicate):
                operation, topics[-1] = context.copied(operation)
            yield operation
        context.they = together(topics)


def _whom(
    command: Command, piece: Mapping[str, Any], context: SentenceContext, timed: bool = False
) -> tuple[SelectKind, bool]:
    """Whom a command is for, and whether that is only assumed."""
    use = command.use
    if "who" not in piece and context.last in context.spared:  # "black and white, but leave the rose alone"
        context.last = None
    unnamed = context.last is None and not context.selected and not context.overall
    of_clip = unnamed and _of_a_clip(command, piece)
    nobody = context.last is None and not context.selected and (timed or "when" in piece) and (use.timed or of_clip)
    if "who" not in piece and ((use.whole and not context.selected) or nobody or "besides" in piece):
        context.last = All()
    context.overall = context.overall or use.whole or use.timed or of_clip
    who: SelectKind | None = piece["who"](context) if "who" in piece else context.last
    assumed = who is None
    context.last = context.last or who
    if who is None:
        who = Current() if context.selected and use.bare else All()
    if "spares" in piece:
        last = context.last
        context.spared.append(piece["spares"](context))
        context.last = last
    if "besides" in piece:
        spared = Not(piece["besides"](context))
        context.last = who = spared if who == All() else And((who, spared))
    return who, assumed


def _time_behind(clauses: Clauses, at: int) -> Span | None:
    """The time at the end of a list without verbs, which holds for all of it: "the dog red and the cat blue from second 2"."""
    end = at
    while end + 1 < len(clauses) and clauses[end + 1].gapped:
        end += 1
    return clauses[end].slots.get("when") if "who" in clauses[end].slots else None


def _made(
    command: Command, piece: Mapping[str, Any], who: SelectKind, when: When, context: SentenceContext, assumed: bool
) -> list[Operation]:
    """The operations of one command; Refusal where it is not said for whom something strong is done."""
    made = command.make(**arguments(piece))
    values = made if isinstance(made, tuple) else ((made,),)
    operations = _compatible([value(who, when, context) for (value,) in values])
    if "degree" in piece:
        operations = [_by_degree(one, piece["degree"]) for one in operations]
    of_all = who == All() and not all(map(is_of_a_picture, operations))
    if assumed and (of_all or any(isinstance(one, Match | Delete | Extract) for one in operations)):
        raise Refusal("It is not said whom or what the command is for; name a thing, or say 'it' for what is selected.")
    return operations


def _by_degree(one: Operation, how: Amount | None) -> Operation:
    """As `by_degree`; Refusal where there are no degrees."""
    try:
        return by_degree(one, how)
    except Mismatch:
        raise Refusal("That is there or not, and comes by no degrees; leave out how much.") from None


def _shared(clauses: Clauses) -> Clauses:
    """The clauses: a verb alone is for whom the next names ("darken and blur the sky"), the first for the topic."""
    shared = list(clauses)
    for at, clause in enumerate(shared[1:] if shared and shared[0].command is TOPIC else (), 1):
        if "who" in clause.slots or (clause.hard and at > 1):
            break
        shared[at] = clause._replace(slots={**clause.slots, "who": shared[0].slots["who"]})
    for at in range(len(shared) - 1, 0, -1):
        verb, following = shared[at - 1], shared[at]
        # "double the saturation and halve the contrast of the sky"
        alike = verb.command is following.command and verb.command.use.whole
        alone = "who" not in verb.slots and (alike or ("verb" in verb.slots and not verb.command.use.whole))
        if alone and not following.hard and "who" in following.slots:
            shared[at - 1] = verb._replace(slots={**verb.slots, "who": following.slots["who"]})
    return tuple(shared)


def _of_a_clip(command: Command, piece: Mapping[str, Any]) -> bool:
    """Whether a command may be for everything where it is for "it" and nothing was named."""
    made = (
        piece.get("complaint")
        if command.make is REMARK
        else command.make is not AGAIN and command.make(**arguments(piece))
    )
    if not made:
        return False
    with suppress(F4xError):  # it is refused when the command is carried out
        return all(
            is_of_a_clip(value(All(), When(), SentenceContext(1.0, 1)))
            for (value,) in (made if isinstance(made, tuple) else ((made,),))
        )
    return False


_SPARING = frozenset({"remark", "untouched", "spared"})
"""Slots that say that somebody stays as it is."""


def _remarked(who: SelectKind, piece: Mapping[str, Any], when: When, context: SentenceContext) -> None:
    """Note whom a remark spares, or what would help against what it complains of."""
    context.last = context.last or who
    if _SPARING & piece.keys():
        context.spared.append(who)
    if piece.get("complaint"):
        context.last = who
        helps = piece["complaint"](who, when, context)
        for degree in filter(None, (piece.get("extent"), piece.get("fix"))):
            helps = _by_degree(helps, degree)
        if who == All() and isinstance(helps, Transform):
            raise Refusal("The clip itself has no size and no place to change; say which thing is meant.")
        context.complaints.append(helps)


def _sparing(operation: Operation, spared: Sequence[SelectKind]) -> Operation:
    """The operation without those that stay as they are, where it is for everything, all others or several of their kind."""
    select = getattr(operation, "select", None)
    left_out = [one for one in spared if one != select and not (isinstance(select, Not) and select.of == one)]
    if not left_out or select is None:
        return operation
    if isinstance(select, All):
        return replace(operation, select=Not(together(left_out)))  # type: ignore[call-arg,arg-type]  # it has one
    if isinstance(select, Not):
        return replace(operation, select=Not(together((select.of, *left_out))))  # type: ignore[call-arg,arg-type]
    some = [one for one in left_out if isinstance(one, Instance) and one.of == select]
    return replace(operation, select=And((select, Not(together(some))))) if some else operation  # type: ignore[call-arg,arg-type]


def _placed(operations: list[Operation]) -> list[Operation]:
    """The operations; a copy that is put somewhere at once is made there: "copy the dog and put the copy on the left"."""
    placed: list[Operation] = []
    for one in operations:
        made = placed[-1] if placed else None
        if isinstance(made, Duplicate) and isinstance(one, Transform) and made.offset == BESIDE:
            stays = replace(one, translate=(0.0, 0.0, 0.0), select=made.select, unit="world", axes="world")
            if one.select == Named(made.name) and stays == Transform(made.select) and any(one.translate):
                far = COPY_DISTANCE if max(map(abs, one.translate)) == 1 and one.unit == made.unit else 1.0
                x, y, z = (far * step for step in one.translate)
                if x or z:
                    placed[-1] = replace(made, offset=(x, y, z), unit=one.unit)
                    continue
        if (
            isinstance(made, Duplicate)
            and isinstance(one, Duplicate)
            and Named(made.name) in [*parts_of(one.select)][1:]
        ):
            raise Refusal("It is not said whether the copies are to be copied, too; name the thing to copy.")
        if isinstance(made, Freeze) and isinstance(one, Retime) and one.speed == 1 and one.select == made.select:
            placed[-1] = replace(made, until=one.frames[0] if one.frames else None)
            continue
        if (
            isinstance(made, Duplicate)
            and isinstance(one, Transform)
            and one.select == Named(made.name)
            and made.offset != BESIDE
            and any(a * b < 0 for a, b in zip(made.offset, one.translate, strict=True))
        ):
            raise Refusal(
                "Two ways are said for one copy; say for example 'copy the dog to the left, and the dog to the right'."
            )
        if _says_no_more(made, one):
            continue
        if (
            isinstance(made, Delete)
            and isinstance(one, Delete | Opacity)
            and one.select == Not(made.select)
            and removes(one)
        ):
            raise Refusal("Nothing would be left; say for example 'keep only the dog' if the rest is to go.")
        if one != made and _is_overridden(made, one):
            placed.pop()
        opposite = (
            isinstance(made, Transform)
            and isinstance(one, Transform)
            and any(one.translate)
            and one == replace(made, translate=one.translate)
            and all(a == -b for a, b in zip(made.translate, one.translate, strict=True))
        )
        if opposite:
            raise Refusal("Two of the directions are on one line; say one of them.")
        if (
            isinstance(made, Recolour | Retime)
            and type(one) is type(made)
            and (made.select, getattr(made, "mode", "")) == (one.select, getattr(one, "mode", ""))
            and one.frames is None
            and made.frames is not None
            and made.frames[1] is not None
        ):
            one = replace(one, frames=(made.frames[1], None))  # "red until second 1, then blue"
        if one != made:
            placed.append(one)
    return placed


def _says_no_more(made: Any, one: Operation) -> bool:
    """Whether an operation does nothing that the one before it did not: "keep only the dog and delete the rest"."""
    if isinstance(made, Opacity) and isinstance(one, Opacity) and made.frames and made.frames[1] and not one.frames:
        return made.select == one.select and one.factor == SHOWN  # "hide it for a second, then it is back"
    if isinstance(made, Delete) and removes(one):  # "I don't like the bush, make it go away"
        return made.select == getattr(one, "select", None) and made.frames == getattr(one, "frames", None)
    if isinstance(made, Recolour) and isinstance(one, Recolour) and made.frames and made.frames[1] is None:
        return one == replace(made, frames=None, ease=one.ease)  # "red from second 2 on, and keep it red"
    return (
        isinstance(made, Extract)
        and isinstance(one, Delete | Opacity)
        and one.select == Not(made.select)
        and removes(one)
    )


def _is_overridden(made: Any, one: Any) -> bool:
    """Whether the next operation says all that this one does, or undoes it: "hide the dog, and let it show up after a second"."""
    if isinstance(made, Delete | Opacity) and isinstance(one, Extract):
        return removes(made) and made.select == Not(one.select)
    if isinstance(made, Style | Recolour) and isinstance(one, Recolour) and one.mode == "assign" and one.strength == 1:
        return getattr(made, "mode", "assign") == "assign" and (made.select, made.frames) == (one.select, one.frames)
    if isinstance(made, Retime) and isinstance(one, Retime):  # "speed it up so that it only takes a second"
        return (made.select, made.frames) == (one.select, one.frames)
    timed = type(made) is type(one) and hasattr(made, "ease") and made.frames is None and one.frames is not None
    if isinstance(one, Opacity) and one.inward:  # "start with the boat invisible and let it fade in"
        made = replace(made, inward=True) if isinstance(made, Opacity) else made
    return timed and one == replace(made, frames=one.frames, ease=one.ease)


def _about(moment: TimeExpression, length: Span) -> Span:
    """The span of a length from a moment on, or about the middle of the clip."""
    far = TimeExpression() if length.end is None else length.end.plus(length.start, -1.0)
    start = moment.plus(far, -0.5) if moment == HALF_WAY else moment
    return Span(start, start.plus(far))


def _same_way(one: Operation, other: Operation) -> bool:
    """Whether two changes differ in how far they go alone: "let it pop, way more saturated", "in slow motion, at 40 %"."""
    a, b = one.to_json(), other.to_json()
    if a["op"] != b["op"] or a.keys() != b.keys() or a["select"] != b["select"]:
        return False
    pairs = [(a[key], b[key]) for key in ("contrast", "saturation", "speed", "scale") if key in a]
    return bool(pairs) and all((x > 1) == (y > 1) for x, y in pairs)


def _added(one: Operation) -> tuple[float, float, float] | None:
    """The color that is added: "less green, more yellow" are two."""
    return one.rgb if isinstance(one, Recolour) and one.mode == "add" else None


def _compatible(operations: list[Operation]) -> list[Operation]:
    """The operations; Refusal when two of them set the same thing."""
    if all(_same_way(one, operations[-1]) for one in operations):
        operations = operations[-1:]
    names = ("mode", "rotate")
    kinds = {(type(one), *(getattr(one, name, None) for name in names), _added(one)) for one in operations}
    unseen = len(operations) > 1 and any(isinstance(one, Opacity) and one.factor == 0 for one in operations)
    if unseen or len(kinds) < len(operations):
        raise Final("Two things are said that exclude one another, as 'red and blue' do; say one of them.")
    return operations


_UNDOING = keyword(
    "[go|step|jump|roll] [back|backward] (by) ([the last|one|two|three|a|some|a few|1|2|3|4|5]) [steps|step|state|states|edit|"
    "edits|version|versions] (in (the|my) history)|go [one|two|three|a] [step|steps] back|[put|take|bring] [it|that|this|them] "
    "back [how|to how|the way|as|like|where|to where] [it|they] [was|were] (before)|how it was before|[go|take me|take us|get] "
    "back to [how|the way|what] [it|this|that|they|everything|things] [was|were] (before)|back to the (original|normal) state|did "
    "not like that|take that back|step back|restore the original|reset everything|[ctrl|control|cmd|command] (+|-) z|[take|roll|"
    "turn|bring] (that|this|the|my) (last|previous) [edit|change|step|command] back|[scratch|strike|axe|belay] [that|this|it]|"
    "[scrap|scratch|forget|cancel|drop|lose|discard|take back|strike|remove|delete|reverse|roll back|undo] [my|the|that|this|your] "
    "(very) [last|previous] (two|three|four|few|couple of|2|3|4|5) [change|edit|step|command|one|changes|edits|steps|commands|"
    "things]|[scrap|forget|cancel|revoke] (that|this|the last)|reset (it|that|this|everything|all)|put everything back|[start over|"
    "start again|back to square one]|[forget|revoke|nevermind|never mind] (about) [that|the last|this] ([change|edit|step|one])"
)
_ELSEWHERE = {
    **dict.fromkeys(("undo", "deleted", "removed", "revert"), "undo"),
    **dict.fromkeys(("redo", "undid", "undone"), "redo"),
}
"""Word -> verb of `f4x` that does it."""
_NO_OPERATION = """
sound music audio song voice bark meow talk sing hello volume mute: a scene has no sound.
text title caption captions subtitle subtitles watermark: nothing can be written into a scene.
relight relighting relit sun sunlight sunshine spotlight backlight: the light is as it was filmed; it can be made brighter,
    darker, warmer or cooler.
mirror mirrored horizontally vertically flop: nothing is mirrored; 'turn the dog around' lets it face the other way.
taller longer wider thinner shorter fatter slimmer stretched squash squashed narrower thicker: a thing grows as a whole; say for
    example 'make the dog bigger'.
shiny shinier shininess glossy glossier gloss matte: how a surface shines is not changed; a glow is light around it.
sharpen sharper crisper denoise deblur unblur upscale resolution artifacts quality: a scene does not become sharper; `f4x fit`
    with a finer profile may.
rain snow fog rainbow lightning confetti sparks hail storm: nothing new can be made; a copy of what is there can.
wave dance smile blink wink laugh eat sleep fight kiss hug breathe limp pirouette somersault backflip cartwheel handstand
    headstand moonwalk frontflip curtsy bow clap nod juggle sneeze yawn cry: a thing moves as it was filmed; its motion can be
    slowed, reversed, frozen or moved along with it.
morph crossfade: one thing cannot turn into another; 'swap the dog and the cat' changes their places.
ring phone email remind tell schedule buy: nothing but the scene is changed here.
export save render download: `f4x export`, `f4x render` and `f4x open` write files.
better nicer pretty prettier beautiful cinematic moody epic awesome interesting stylish professional different fancy: it is not
    said what is to change, a color, brightness, contrast, size, place or speed?
"""
"""Words of wishes that no operation fulfils, and what is said about them."""
_IMPOSSIBLE = {
    word: reason
    for words, reason in (row.split(": ", 1) for row in _NO_OPERATION.replace("\n    ", " ").strip().splitlines())
    for word in words.split()
}
_the_clip = literal(f"[the|this|my] (whole|entire) [{PICTURE}]")
_cut_in_time = (
    either(
        literal("(only|just) [keep|keeping|show|leave|use] (only|just)")
        + here(lambda reading, at: not {"only", "just"}.isdisjoint(reading.words[:at])),
        literal(
            every_form(
                "cut|remove|delete|trim|drop|chop|lose|throw away|snip|crop|clip|shave|discard|erase|get rid of|shorten"
            )
        ),
    )
    + ~literal("off|out|away|down")
    + ~literal("just|only|everything")
    + ~_the_clip
    + ~literal("to|in|at|by|after|from")
    + ~literal("the|a")
    + silent(span | duration | literal("half"))
    + ~literal("off|out|away|again")
    + ~(literal("of|from|off") + _the_clip)
    + here(lambda reading, at: not reading.word(at).isalpha())
)
"""What would make the clip shorter: "remove the second half of the clip", "trim the last two seconds off"."""
_either = either(keyword("either"), silent(familiar) + keyword("or (the|a|an)") + silent(familiar))
_last = here(lambda reading, at: at >= len(reading.tokens) or not reading.tokens[at].is_word)
_SHOWN_ONLY_THEN = "'Only' with a time can be meant in two ways; say for example 'hide the dog until second 2'."
_ONLY_WHEN = keyword(
    "only [after|from|until|before|between|during|for|since|while]|"
    "only [in|at|on|over|within] (the) [first|last|second|frame|frames|seconds|beginning|end|middle]"
)
_LENGTH = silent(number | keyword("half a")) + literal(
    "m|cm|mm|ft|meter|meters|centimeter|centimeters|inch|inches|foot|feet|yard|yards"
)
_named_like_a_thing = word_if(lambda reading, at: reading.word(at) in COLOURS.keys() - PURE_COLOURS)
_plain = literal("|".join(f"{one.much}|{one.little}" for one in QUALITIES))
_than_another = (
    literal("as") + _plain + literal("as")
    | (literal("[more|less]") + _plain | literal("|".join(f"{one.more}|{one.less}" for one in QUALITIES)))
    + literal("than")
    | literal("the (exact) same [" + "|".join(one.noun for one in QUALITIES if one is not SATURATION) + "] as")
) + (~literal("the|a|an|my|that|this") + silent(known_noun) | literal("the|a|an|my") + any_word)
_the_same = literal("the (exact) same [size|speed|brightness|height|width|length]") + unless(literal("as|again"))
_ALONE = PURE_COLOURS - {"black", "white"}
"""Colors of which the plural is all that has them: "the reds"."""
_LAMPS = "lamp|light|lights|lantern|candle|headlights|sign|screen|tv"
_CHANGING = IMPERATIVES - word_set("add put want need have get give show see like")
"""Verbs that do something to what there is: "two of them" behind these are some of it."""
_DOUBTFUL = (
    (
        _than_another,
        "Things are not measured against one another; say how much it is to be, for example 'twice as big' or '20 % brighter'.",
    ),
    (
        literal("[around|about|on|along|in] (the|its) [x|y|pitch] (axis)"),
        "Which way an axis points is another matter in every program; say 'to the left' or 'to the right', which is about the "
        "vertical, or 'tilt'.",
    ),
    (
        literal(any_form("tilt")) + ~silent(known_thing) + ~silent(degree) + literal("forward|backward|back"),
        "Which way is forward for a thing is not known, so it tilts to the left or to the right; say for example 'tilt the dog to"
        " the left'.",
    ),
    (
        word_if(lambda reading, at: reading.word(at)[-1:] == "s" and reading.word(at)[:-1] in _ALONE),
        "The colors of one kind are not changed alone; say for example 'make the dog less red'.",
    ),
    (
        here(lambda reading, at: reading.word(at - 1) not in ("to", "until", "through", "before"))
        + literal("the (very) [last|final|end] frame")
        + ~literal("of the clip|still")
        + ~silent(span)
        + here(
            lambda reading, at: (
                at > 0 and not {"hold", "freeze", "pause", "linger", "stay"}.isdisjoint(reading.words[:at])
            )
        )
        + _last,
        "Nothing comes behind the last frame, as a clip keeps its length; 'freeze everything from second 2' holds an earlier frame "
        "to the end.",
    ),
    (
        literal(
            "[the|a] [next|previous|following] [shot|scene|clip|take|cut|image|slide]|cross [dissolve|fade]|crossfade|wipe to"
        ),
        "A scene is one shot, so there is no other to go to; 'fade everything out at the end' ends it.",
    ),
    (_the_same, "It is not said what it was or whose it is; say how much it is to be, for example 'twice as big'."),
    (
        _LENGTH,
        "A clip does not tell how long a metre or a foot is; say lengths in widths of the thing, for example 'two widths "
        "to the left' or 'half its width up'.",
    ),
    (
        keyword("[put|take|bring|get|turn] [that|this|it|them|him|her] back (again|please)") + _last,
        "That may be an undoing: use `f4x undo SCENE`, or say 'move it back'.",
    ),
    (
        keyword("[add|insert|create|draw|put] (a|an|some)")
        + literal("ice|fire|lava|night|sunset|autumn|grass|ocean|chocolate|marble|ghost")
        + unless(effect)
        | keyword("[add|insert|create|draw] (a|an|some)")
        + _named_like_a_thing
        + unless(effect | qualities.colored_noun),
        "Nothing new can be made; say for example 'make the dog look like ice', or 'a sunset look for everything'.",
    ),
    (
        keyword("[and|then|and then] (move|go|moves|goes|bring) (it|him|her|them) back (again)") + _last,
        "'Back' may mean away from the camera or to where it was; say for example 'then move it to the right'.",
    ),
    (
        either(
            literal("[put|place|stick|hang|add] [a|an|some]") + ~silent(colour) + silent(familiar) + literal("on|onto"),
            literal("[add|adds|adding|insert|create|spawn|place] [a|an|some|another]")
            + literal("bigger|larger|smaller|taller|brighter|darker|lighter|big|large|small|tiny|huge|little")
            + silent(familiar),
            literal("[grow|plant|build|raise up] [a|an|some]") + silent(familiar),
        ),
        "Nothing new can be made; say for example 'copy the hat and put the copy above the dog'.",
    ),
    (
        keyword("hide|hides|hiding")
        + unless(keyword("everything|anything|all|whatever|what"))
        + silent(known_thing)
        + literal("behind|under|underneath|beneath|inside|below"),
        "'Hide' may mean to place or to make invisible; say 'put the dog behind the bush' or 'make the dog invisible'.",
    ),
    (
        literal("drop|drops|dropping|clear|cut|cutting|scratch|strike|dump|break|smash|burn|shoot|tear|rip")
        + silent(
            (familiar | ~keyword("a|the|that|this|my") + familiar)
            + here(lambda reading, at: singular(reading.word(at - 1)) not in ("shadow", "reflection"))
        )
        + unless(literal("'s|out|away|off|from|loose|free|apart|down|entirely|completely|altogether")),
        "That may mean to remove or to do something else; say 'remove the ball' if it should be gone, or 'move the ball down'.",
    ),
    (
        literal("[jump|jumps|leap|leaps|hop|hops|fly|flies] [higher|farther|further]"),
        "A thing moves as it was filmed; say for example 'move the dog up' or 'play the dog twice as fast'.",
    ),
    (
        literal("[take|takes|taking] off|[fly|flies|flying] [off|away]")
        + unless(~literal("the|its|his|her|that|all") + thing),
        "That may mean to rise, to go away or to be gone; say 'raise the bird', 'move the bird away' or 'remove the bird'.",
    ),
    (
        keyword("[clear|empty|clean|strip] (out|up) (the|my|this|that)")
        + literal(
            "room|bedroom|street|road|table|desk|floor|stage|yard|garden|beach|field|house|scene|place|set|shelf|track"
        ),
        "That may mean to remove the place itself or all that is in it; say 'remove' with what has to go.",
    ),
    (
        keyword(
            f"([turn|switch]) (the|all the|that|this) [{_LAMPS}] off|[turn|switch] off (the|all the|that|this) [{_LAMPS}]|"
            f"[kill|cut] (the|that|this|all the) [{_LAMPS}]"
        ),
        "That may mean dark or gone; say 'make the lamp darker' or 'hide the lamp'.",
    ),
    (
        keyword("[mute|silence|unmute]")
        + silent(
            ~keyword("all")
            + unless(literal("(the|its|all|all the) [color|colors|tone|tones|saturation]"))
            + known_thing
        ),
        "A scene has no sound; say for example 'desaturate the car' if its colors are meant.",
    ),
    (
        literal(every_form("spin|rotate|revolve|twirl|whirl"))
        + ~literal("around|round")
        + ~silent(known_thing)
        + literal("(to|in|into) the [other|opposite|reverse] [way|direction] (around|round)"),
        "That may mean to play it backward or to turn it around; say 'play the dog in reverse' or 'turn the dog around'.",
    ),
    (
        literal("used to [be|have|look|stand|move]"),
        "That says how it was; say what is to be done, for example 'make the dog red'.",
    ),
    (
        keyword("put") + (silent(known_thing) | keyword("[it|him|her|them|that|this]")) + keyword("away") + _last
        | keyword("put away") + silent(known_thing),
        "'Put away' may mean to move or to remove; say 'move it back' or 'remove it'.",
    ),
    (_either, "'Or' leaves open which of the two is meant; name one of them, or say 'and' for both."),
    (
        keyword("some [of|other]|a few (of)")
        | here(lambda reading, at: reading.word(at - 1) not in ("without", "no", "not")) + keyword("any of")
        | here(lambda reading, at: reading.word(at - 1) in _CHANGING)
        + silent(number)
        + literal("of [the|these|those|my|them]")
        + here(lambda reading, at: reading.word(at - 1) == "them" or known_noun.at(reading, at))
        | keyword("couple of") + ~literal("the|my|these|those") + silent(known_noun),
        "Which of them is not said; say for example 'the left one' or 'all of them'.",
    ),
)
"""Phrases that can be meant in two ways, or that nobody can measure, and what is asked instead of doing anything."""
_strange_word = word_if(
    lambda reading, at: (
        reading.word(at).isalpha()
        and not {reading.word(at), singular(reading.word(at))} & (VOCABULARY | FUNCTION_WORDS | COLOURS.keys())
    )
)
_a_new = either(
    keyword("[add|insert|create|draw|write] (a|an|some)"),
    keyword("[put|place|stick|hang|give it|give me] [a|an|some]"),
)
_replacing = (
    keyword("replace|substitute|swap out|exchange|trade") + silent(thing) + keyword("[with|by|for] (a|an|some|the)")
)
_NEW_THING = either(
    (_a_new | _replacing) + (_strange_word + ~_strange_word | silent(familiar)),
    keyword("swap") + silent(thing) + literal("for a|for an|for some") + silent(familiar),
)
_shade = keyword("[darker|lighter|brighter|deeper]") + silent(colour)
"""A color by what it is darker than, which may mean either."""
_UNKNOWN_WAYS = (
    (keyword("not|never"), "Say what is to be done, not what is not: '{words}' is not understood here."),
    (
        keyword("[half|part|parts|most|some|a third|a quarter] of"),
        "Things are changed as a whole, so '{words}' means nobody.",
    ),
    (
        _shade,
        "'{words}' is no color; give its name, for example 'dark red'.",
    ),
    (
        keyword(
            "cartoon|cartoons|oil painting|painting|sketch|pencil|pencil sketch|anime|watercolor|pixel|pixels|pixelate|comic|"
            "manga|vintage|retro|vhs|noir|impressionist|drawing|hologram|plastic|wood|wooden|stone|clay|lego|cyberpunk|vaporwave"
        ),
        f"There is no look '{{words}}'; there are {', '.join(STYLES)}, and black and white.",
    ),
    (
        keyword("[i|we] [want|need]|[i|we] would like|make [it|that|them]|give me|there should be")
        + silent(number)
        + familiar,
        "How many there are is not known to the sentence, so '{words}' leaves open how many copies to make; say for "
        "example 'copy the dog twice'.",
    ),
    (
        keyword("the [first|second|third|fourth|fifth|last|next|other]") + familiar,
        "Things are not counted, so nobody is '{words}'; say for example 'the left one' or 'the biggest one'.",
    ),
    (
        keyword("behind|beside|near|under|underneath|above|below|next to|in front of|between|on top of"),
        "It is not said what is '{words}' what; say for example 'the bush behind the dog', or 'the nearest one'.",
    ),
)
"""Phrases that no command has, and the reason given for each; the words before which reading ended are no fault of their own."""


def _not_understood(read: Read) -> tuple[str, bool]:
    """The sentence about the words that nobody knows, or at which every way to read ended; whether examples help."""
    reading = Reading.of(read.reading.sentence, read.reading.tokens, read.reading.known, thorough=True)
    Search(reading, {words[-1] for words in reading.known}).sentence()
    if reason := _no_edit(reading) or _new_thing(reading):
        return reason, False
    lacking = _lacking(reading)
    if unknown := _impossible(reading) or (not lacking and read.reason) or _unknown_word(reading):
        return unknown, True
    for rule, reason in _UNKNOWN_WAYS:
        for at in range(len(reading.tokens)):
            if ends := rule.at(reading, at):
                negated = rule is _UNKNOWN_WAYS[0][0]
                return reason.format(words=reading.text_of(at, max(ends))), not negated
    end = len(reading.tokens)
    if lacking:
        return f"The command is not complete: {lacking}.", True
    if reading.farthest >= end:
        return "No command fits that; name a thing and what is to become of it, for example 'make the dog red'.", True
    return f"I do not understand '{reading.text_of(reading.farthest, reading.farthest + 1)}' here.", True


_CAMERA = table(
    {
        "stabilize|stabilise|stabilization|deshake|steady|steadier|steadied|steadicam|gimbal|(less|too|so|not (so)) [shaky|shaking|"
        "jittery|bumpy|jerky]|[shake|wobble|jitter] (the) (camera|cam) less|(camera|hand) [shake|wobble|jitter]|smoother "
        "[camera|cam|shot|footage]": "The camera's way is kept as it was filmed; `f4x render SCENE -o DIR --path stabilise` writes "
        "pictures as by a calm hand, and so does a camera of *Add Camera* in Blender.",
        "with (the|my|a) [camera|cam]|(the|my) [camera|cam] ([to|should|must|has to]) [follow|follows|track|tracks|"
        "chase|stay on|stays on]|"
        "centered|recenter|recentre|reframe|in [frame|shot] all the time|[pan|tracking] [with|shot]": "No camera follows a thing "
        "by itself: in Blender a camera can be made to track it, and `f4x render SCENE -o DIR --path FILE` goes along any path of "
        "cameras.",
        "zoom|zooms|zooming|dolly|[push|punch] in|close up|[closer|wider|tighter] [shot|crop|framing|view]|wide angle|crop|fov|"
        "focal length|lens": "No camera is edited: in Blender, and with `f4x render SCENE -o DIR --path FILE`, a camera of your "
        "own may stand nearer or have another lens; 'make the dog bigger' changes the thing itself.",
        "pan|orbit|[move|turn|swing|tilt|rotate|raise|lower|fly|lift|bring|put|place|set|point|aim|take] (the|my) "
        "[camera|cam]|from [another|a different|the "
        "other|a new] [side|angle|view|viewpoint|perspective]|[top|side|aerial|back] view|camera [angle|move|path|movement]": "No "
        "camera is edited: `f4x render SCENE -o DIR --path orbit --degrees 10` looks from around, `--path FILE` from anywhere, and "
        "so do cameras in Blender.",
    },
    reserve=False,
)
"""Wishes about the camera -> what can be done: steadier, following, nearer, elsewhere."""


def _no_edit(reading: Reading) -> str:
    """The sentence about a wish that another command of `f4x` fulfils; nothing where there is none."""
    for at in range(len(reading.tokens)):
        if camera := _CAMERA.at(reading, at):
            return next(iter(camera.values()))[0]
    if _holds(_UNDOING, reading):
        return "That is no edit; use `f4x undo SCENE`, or the button for it."
    if _holds(_cut_in_time, reading):
        return (
            "A clip keeps its length, so no time is cut out of it; `f4x render --frames` writes a part of it, and 'hide the dog"
            " until second 2' hides what is seen then."
        )
    verb = next((_ELSEWHERE[token.text] for token in reading.tokens if token.text in _ELSEWHERE), "")
    return verb and f"That is no edit; use `f4x {verb} SCENE`, or the button for it."


def _impossible(reading: Reading) -> str:
    """The sentence about a wish that no operation fulfils; nothing where there is none."""
    known = {words[-1] for words in reading.known}
    word = next((token.text for token in reading.tokens if token.text in _IMPOSSIBLE.keys() - known), "")
    return word and f"There is no edit for '{word}': {_IMPOSSIBLE[word]}"


def _new_thing(reading: Reading) -> str:
    """The sentence about a thing that would have to be made; nothing where there is none."""
    ends = {at: max(found) for at in range(len(reading.tokens)) if (found := _NEW_THING.at(reading, at))}
    words = next((reading.text_of(at, end) for at, end in ends.items()), "")
    return (
        words and f"Nothing new can be made, as '{words}' would; a copy of what is there can, as in 'add another dog'."
    )


def _unknown_word(reading: Reading) -> str:
    """The sentence about the first word that is in no lexicon; nothing when there is none."""
    farthest = reading.farthest + (reading.word(reading.farthest) == "'s")  # of "dog's tail" the tail is unknown
    parts = {word for words in reading.known for word in words}
    vocabulary = VOCABULARY | FUNCTION_WORDS | NO_THINGS | EMPTY | COMMAND_VERBS | COLOURS.keys() | SHADES.keys()
    for at, token in enumerate(reading.tokens[: farthest + 1]):
        if token.is_word and not {token.text, singular(token.text)} & (vocabulary | parts):
            word = reading.text_of(at, at + 1)
            close = misspelt(token.text, VOCABULARY | COLOURS.keys() | parts)
            return f"I do not understand '{word}'" + (f"; did you mean '{close}'?" if close else ".")
    return ""


_UNSAID = {
    "who": "whom or what it is for",
    "values": "what becomes of it",
    "rgb": "which color",
    "colors": "to which color",
    "by": "how much",
    "place": "where",
    "way": "which way",
    "sense": "which way",
    "angle": "by how many degrees",
    "source": "what it is to look like",
    "called": "which name it gets",
}
"""What is missing where a slot of a command was not filled."""


_SAID_HALF = (
    ("change the color of the car to black", "change, set, make, turn, alter, swap", "colors", whose("color|colors")),
    ("paint the car blue", VERBS["become"], "values", thing),
    ("scale the dog by 2", VERBS["scale"], "by", thing),
    ("turn the dog to the left", VERBS["turn"], "sense", thing),
    ("move the dog to the left", VERBS["move"], "way", thing),
    ("put the dog behind the bush", VERBS["move"], "place", thing),
    ("match the dog to the cat", "match", "source", thing),
    ("call the dog rex", "call, name, label, tag", "called", thing),
)
"""(Example, verbs, slot that is needed, whom it is for) of commands that are read in any order."""
_beginnings = [
    (example, slot, verb, verb + who)
    for example, verbs, slot, who in _SAID_HALF
    for verb in [keyword("|".join(inflected(verbs.replace(", ", "|"), 1)))]
]
"""Examples with the slot that is needed and the rules of their verb, and of the verb and whom it is for."""


def _lacking(reading: Reading) -> str:
    """Return what the last command of a sentence lacks, as part of a message; nothing where it lacks nothing that has a name."""
    end = len(reading.tokens)
    for at in range(end):
        for example, slot, verb, verb_and_who in _beginnings:
            whole = end in verb_and_who.at(reading, at)
            if whole or end in verb.at(reading, at):
                unsaid = _UNSAID[slot if whole else "who"]
                return f"after '{reading.text_of(at, end)}' it is not said {unsaid}, as in '{example}'"
    return ""


MOST_FRAMES = 10**6
"""Frames of a clip in which every time of a command lies."""
MOST_EXAMPLES = 3
"""Commands that a refusal offers."""


def nearest(sentence: str, there: Sequence[str] = ()) -> tuple[str, ...]:
    """Commands of which the sentence says all but for whom, about what it names or else what is `there`; none removes unasked."""
    known = _known(tuple(there))
    text = written(sentence)
    reading = Reading.of(text, tokenise(text)[:MAX_WORDS], known)
    named = [
        label
        for label in there
        if any(_holds(literal(form), reading) for form in dict.fromkeys((label, singular(label))))
    ]
    examples = [
        about_there(f"'{command.example}'", "", named or there)[1:-1]
        for command in COMMANDS
        if (needed := command.needed - {"who"})
        and command.make not in (REMARK, AGAIN)
        and matches_of(command.slots, needed, reading)
    ]
    done = {example: _done_by(example, there) for example in examples}
    fitting = [example for example, does in done.items() if does and (named or not any(map(removes, does)))]
    return tuple(fitting[:MOST_EXAMPLES])


def is_command(sentence: str, labels: Sequence[str]) -> bool:
    """Return True for a sentence that can be carried out as it stands, in a clip of any length whose scene knows `labels`."""
    return bool(_done_by(sentence, labels))


def _done_by(sentence: str, labels: Sequence[str]) -> tuple[Operation, ...]:
    """What such a sentence does; nothing where it cannot be carried out or can be meant in two ways."""
    clip = SentenceContext(1.0, MOST_FRAMES, selected=True, labels=frozenset(labels))
    with suppress(F4xError):
        read = _read(sentence, _known(tuple(labels)), lambda read: _settled(read, clip, None))
        return () if read.idle or _unsure(read) else read.operations
    return ()


_EXAMPLE = re.compile(r"(?<!\w)'[^']*'")
_EXAMPLE_THING = re.compile(r"\bthe (dogs?|cat|car|ball|bush|lamp|bird|hat|tree|person|people|boat|house|sky)\b")
"""Things of the examples in refusals; others stand in their place where it is known what the scene holds."""


def about_there(reason: str, sentence: str, there: Sequence[str]) -> str:
    """A refusal whose examples speak of things that are `there`, except of those that the sentence names itself."""

    def about(example: re.Match[str]) -> str:
        nouns = [noun for noun in dict.fromkeys(_EXAMPLE_THING.findall(example[0])) if noun not in sentence.lower()]
        if len(nouns) > len(there):
            return example[0]
        instead = dict(zip(nouns, there, strict=False))
        return _EXAMPLE_THING.sub(lambda found: f"the {instead.get(found[1], found[1])}", example[0])

    return _EXAMPLE.sub(about, reason)
