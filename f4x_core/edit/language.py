"""A plain English sentence to typed operations, by a grammar: no model, the same answer always (docs/language.md).

Every word has to be accounted for; one that is not makes the whole sentence a `Refusal`, because a wrong edit is worse than none.
"""

from __future__ import annotations

import re
import unicodedata
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Any

from ..errors import F4xError
from ..language.colour_names import COLOURS, SHADES
from ..language.courtesies import WISHES
from ..language.grammar import (
    NAMES_TOO,
    VOCABULARY,
    Reading,
    Rule,
    Token,
    keyword,
    literal,
    matches_of,
    tokenise,
    words_of_label,
)
from ..language.idle import EMPTY, UNKNOWN, is_strange
from ..language.lexicon import (
    FUNCTION_WORDS,
    NO_THINGS,
    PEOPLE,
    SYNONYMS,
    forms,
    is_slip,
    misspelt,
    singular,
    without_shot,
    word_set,
    written,
)
from ..language.refusal import Doubt, Final, Refusal, Slip
from ..language.times import HALF_WAY, NOW, START, Span, TimeExpression
from ..language.verbs import COMMAND_VERBS, IMPERATIVES
from .change import Change
from .clauses import OF_ALL, Clause, Clauses, Search, arguments
from .commands import COMMANDS
from .description import in_words
from .english import ABOUT_OTHERS, AGAIN, LEVEL, REMARK, TOPIC, Command, Remedy, as_given
from .phrases import SentenceContext, When, several_placed, together
from .refusals import NO_EDIT, UNCLEAR, UNSURE, reason_of
from .request import Request
from .selects import All, And, Current, Instance, Named, Not, SelectKind, parts_of

MAX_CHARACTERS, MAX_WORDS = 1500, 120
"""Characters and words of a sentence that is read; a person says less at once."""
MAX_BARRED = 3
"""Commands that fit a sentence and cannot be carried out, before it is given up."""


_polite = keyword("please|could|can|maybe|perhaps|would|possible|mind|chance")
_POLITE_BEFORE = 8
"""Words within which a request begins: "okay, now could you"."""
_ASKED_FOR = frozenset(
    form for verb in (IMPERATIVES - FUNCTION_WORDS) | {"have", "let"} for form in (verb, *forms(verb))
)
"""With which the command begins behind words that only ask for it: "would you mind making"."""
_DROPPED = word_set("please kindly thanks thank")
_PICTURES = ("So", "Sk", "Mn", "Cn")
"""Unicode categories of emoji."""


def parse(
    request: Request, *, copies: Mapping[SelectKind, SelectKind] | None = None, earlier: str = ""
) -> tuple[Change, ...]:
    """Return the operations that a sentence asks for, in order; selections are words, not yet resolved in a scene.

    `copies`: those of earlier sentences -> what was copied; `earlier`: the sentence before, of which "it", "the other one" and
    "the cat too" may speak. Raises `Refusal`.
    """
    if len(request.sentence) > MAX_CHARACTERS:
        raise Refusal(
            f"The sentence has {len(request.sentence)} characters, more than {MAX_CHARACTERS}; say fewer commands at once."
        )
    sentence = without_shot(written(request.sentence), (*request.labels, *request.names))
    known = _known(tuple(request.labels), tuple(request.names))

    def settled(read: Read) -> tuple[Change, ...]:
        context = _context(request, read, copies or {})
        return _settled(read, context, _recalled(before, context))

    before: Clauses = ()
    with suppress(Refusal):  # a sentence that is not understood says nothing of this one
        before = _read(earlier, known).clauses if earlier else ()
    read = _read(sentence, known, settled)
    if not read.clauses and _first_asked(read.reading.tokens) in _INTERROGATIVES - IMPERATIVES:
        raise Refusal(_A_QUESTION)
    levelled = any(clause.command.make is LEVEL for clause in read.clauses)  # then "it" is no thing
    if not levelled and (reason := reason_of(UNSURE, read.reading)):
        raise Refusal(reason)
    if request.labels or not read.clauses:
        _ask_about_slips(read, sentence, known, settled)
    if read.clauses:
        _ask_before_removing(read)
        return read.operations
    other = _INSTEAD.fullmatch(sentence)
    if other and tokenise(other["done"])[0].text in IMPERATIVES:
        return parse(replace(request, sentence=other["done"]), copies=copies, earlier=other["not_done"])
    reason = _SHOWN_ONLY_THEN if read.only_then else read.reason or reason_of(NO_EDIT, read.reading)
    if not reason:
        _ask_to_leave_out(sentence, known, settled)
    reason = reason or _unknown_word(read.reading) or reason_of(UNCLEAR, read.reading) or _NO_COMMAND
    raise Refusal(reason, nearest(sentence, request.labels))


def _context(request: Request, read: Read, copies: Mapping[SelectKind, SelectKind]) -> SentenceContext:
    """Return what a sentence refers to: its clip, names, and the `copies` of earlier ones."""
    return SentenceContext(
        request.fps,
        request.frames,
        request.frame,
        request.selected,
        {name.lower(): name for name in request.names},
        overall="overall" in read.reading.words,
        earlier=copies,
        labels=frozenset(request.labels),
    )


_INSTEAD = re.compile(
    r"(?:do not|don't|never) (?P<not_done>[^,.;:]+)[,.;:]+ *(?:(?:but|just|instead|rather|only) )*"
    r"(?P<done>(?:(?!\b(?:or|nor|and|not|never|don't)\b).)+)",
    re.IGNORECASE,
)
"""A command that is not meant, and the one that is: "don't remove him, hide him"."""
_NO_COMMAND = "No command fits that; name a thing and what is to become of it, for example 'make the dog red'."


@dataclass(frozen=True)
class Read:
    """A sentence that was matched, or not."""

    reading: Reading
    """The words of the sentence, or of the other way to say it that was understood."""
    clauses: Clauses = ()
    """Each behind its separators; none: not understood."""
    operations: tuple[Change, ...] = ()
    """Operations that it asks for, where they were computed to see if it is understood."""
    idle: tuple[int, ...] = ()
    """Words that no phrase explains."""
    reason: str = ""
    """Why what it asks for cannot be, where it is not understood otherwise."""

    @property
    def only_then(self) -> bool:
        """Return True if "only" stands before a time."""
        return _holds(_ONLY_WHEN, self.reading)


def _holds(rule: Rule, reading: Reading) -> bool:
    """Return True if a phrase stands somewhere in a sentence."""
    return any(rule.at(reading, at) for at in range(len(reading.tokens)))


Settle = Callable[[Read], tuple[Change, ...]]


def _settled(read: Read, context: SentenceContext, before: Clause | None) -> tuple[Change, ...]:
    """Return the operations of a sentence; raises F4xError."""
    operations = _placed([_sparing(one, context.spared) for one in list(_operations(read.clauses, context, before))])
    operations = operations or context.complaints
    if not operations:
        raise Refusal("Nothing is said that could be done.")
    if any(one.removes for one in operations) and _holds(several_placed, read.reading):
        raise Refusal(
            "Of several of a kind only one can be told by its place; say for example 'the farthest person', or 'the people'."
        )
    if read.only_then and any(one.left is not None or one.brings_back for one in operations):
        raise Refusal(_SHOWN_ONLY_THEN)  # seen only then, or nothing else seen then
    named = {part.name for one in operations for part in _selected(one) if isinstance(part, Named)}
    spare = context.spare - named
    return tuple(one.altered(name="") if getattr(one, "name", "") in spare else one for one in operations)


def _read(
    sentence: str, known: Mapping[tuple[str, ...], str], settled: Settle | None = None, guess: bool = False
) -> Read:
    """Return the reading with the cheapest idle words that `settled` can carry out, or the reason why the first cannot be.

    `guess`: words that nobody knows may be left out.
    """
    reading, reason = _words_of(sentence, known), ""
    tried = reading
    for _ in range(MAX_BARRED + 1):
        found = Search(tried, {words[-1] for words in known}).sentence()
        if found is None or (found.cost > UNKNOWN / 2 and not guess):
            break
        read = Read(tried, found.clauses, idle=found.idle)
        try:
            return read if settled is None else replace(read, operations=settled(read))
        except Refusal as refusal:
            reason = reason or ("" if found.idle else refusal.reason)
            if isinstance(refusal, Final):
                break
        except F4xError:
            break
        barred = frozenset(id(clause.command) for clause in read.clauses)
        tried = replace(tried, barred=tried.barred | barred)  # another command may do
    return Read(reading, reason=reason)


def _words_of(sentence: str, known: Mapping[tuple[str, ...], str]) -> Reading:
    """Return the words of a sentence; Refusal where it is a question, too long or empty."""
    tokens = [
        token
        for token in _statements(tokenise(sentence))
        if token.text not in _DROPPED
        and not (len(token.text) == 1 and (token.text in "[]{}*~" or unicodedata.category(token.text) in _PICTURES))
    ]
    if len(tokens) > MAX_WORDS:
        raise Refusal(f"The sentence has {len(tokens)} words, more than {MAX_WORDS}; say fewer commands at once.")
    if not any(token.text.isalnum() for token in tokens):
        raise Refusal("Nothing is said that could be done.")
    return Reading(sentence, known, tokens)


def _ask_about_slips(read: Read, sentence: str, known: Mapping[tuple[str, ...], str], settled: Settle) -> None:
    """Raise `Doubt` where a word is probably misspelt, `Slip` where it is one of the language's own and nothing is removed."""
    slip = _slip(read.reading, bool(read.clauses))
    if slip is None:
        return
    wrong, word = slip
    typed = sentence[wrong.start : wrong.end]
    instead = sentence[: wrong.start] + word + sentence[wrong.end :]
    better = _read(instead, known, settled)
    whole = bool(better.clauses) and not better.idle
    if whole or _slip(better.reading, False):
        thing = any(word in words for words in known)
        sure = whole and not thing and is_slip(wrong.text, word) and not any(one.removes for one in better.operations)
        raise (Slip if sure else Doubt)(f"I do not understand '{typed}'; did you mean '{word}'?", instead)


def _ask_to_leave_out(sentence: str, known: Mapping[tuple[str, ...], str], settled: Settle) -> None:
    """Raise `Doubt` with what the sentence comes to without the words that nobody knows; nothing that removes is guessed."""
    read = _read(sentence, known, settled, guess=True)
    words = sum(token.is_word for token in read.reading.tokens)
    if not read.operations or reason_of(UNSURE, read.reading) or 2 * len(read.idle) > words:
        return
    if any(one.removes for one in read.operations) or any(_is_a_verb(read.reading, at) for at in read.idle):
        return
    if "who" not in read.clauses[0].slots:
        return  # whom it is for may be what was left out
    doubt = _without_idle(read)
    if _read(doubt.instead, known, settled).operations == read.operations:
        raise doubt


def _is_a_verb(reading: Reading, at: int) -> bool:
    """Return True if a word that nobody knows says what to do with something: "knit the swan a scarf"."""
    if reading.word(at - 1) in _ASKED_FOR or any(
        reading.word(at) in words for words in (VOCABULARY, FUNCTION_WORDS, EMPTY)
    ):
        return False
    return reading.word(at + 1) in ("the", "my", "that", "it", "him", "her", "them")


def _without_idle(read: Read) -> Doubt:
    """Return a question whether the sentence without its idle words is meant."""
    tokens, typed = read.reading.tokens, read.reading.sentence
    kept, begin = "", 0
    left_out: list[str] = []
    for at in read.idle:
        start, end = tokens[at].start, tokens[at].end
        between = typed[begin:start]
        if left_out and not between.strip():
            left_out[-1] += between + typed[start:end]
        else:
            left_out.append(typed[start:end])
        kept, begin = kept + between, end
    kept = " ".join((kept + typed[begin:]).split())
    instead = re.sub(r"\s+([,.;!?])", r"\1", re.sub(r"^[\s,;.:!?-]+|[\s,;:-]+$", "", kept))
    words = "', '".join(left_out)
    return Doubt(f"I would do: {in_words(read.operations)}. I do not know what '{words}' adds.", instead)


def _ask_before_removing(read: Read) -> None:
    """Raise Refusal or `Doubt` where something is no longer seen and a word is left unexplained that may say whether or what."""
    words = read.reading.words
    idle = {words[at] for at in read.idle if words[at].isalnum()}
    if not any(one.removes for one in read.operations) or idle <= EMPTY | {"the"}:
        return
    # An unknown thing with an article may be what is to be removed: "the graffiti".
    at = next((at for at in read.idle if words[at] in ("the", "my", "that", "those") and at + 1 in read.idle), None)
    if at is not None and words[at + 2] != "'s":
        raise Refusal(f"I do not know what '{read.reading.text_of(at, at + 2)}' is, so nothing is removed.")
    raise _without_idle(read)


_SPOKEN_OF = word_set(
    "background foreground everything everyone everybody selection shadow reflection ripple original surroundings"
)
"""Words for whom or what a command is for, which are labels of no scene."""


_INFLECTED = ("er", "ing", "ed")
"""Ends of words that nobody knows and are words all the same: "calmer" is no "calmed"."""


def _slip(reading: Reading, understood: bool) -> tuple[Token, str] | None:
    """Return the first unknown word and the known one that it may be a slip of: of a label, or of any where none else helps."""
    parts = {word for words in reading.known for word in words}
    for at, token in enumerate(reading.tokens):
        describes = understood and (reading.word(at + 1) == "'s" or reading.word(at + 1) in parts)
        describes = describes or token.text.endswith("est")  # a superlative is a word, and none of a thing
        if (
            token.is_word
            and not describes
            and all({token.text, singular(token.text)}.isdisjoint(words) for words in (_LEXICON, parts, _SPOKEN_OF))
        ):
            meant = misspelt(token.text, parts | _SPOKEN_OF)
            meant = meant or (None if understood else misspelt(token.text, _LEXICON | parts))
            if meant and (is_slip(token.text, meant) or not token.text.endswith(_INFLECTED)):
                return token, meant
    return None


_LEXICON = frozenset().union(VOCABULARY, NAMES_TOO, FUNCTION_WORDS, NO_THINGS, EMPTY, COLOURS, SHADES)
"""Every word that means something in whatever sentence."""


def _selected(operation: Change) -> Iterator[SelectKind]:
    """Yield every selection in an operation."""
    for name in ("select", "source"):
        if hasattr(operation, name):
            yield from parts_of(getattr(operation, name))


_INTERROGATIVES = word_set("what where when who whose which why how is are was were am does do did has have")


_A_QUESTION = "That is a question; `f4x ask` answers those, here one says what to change."


def _first_asked(part: Sequence[Token]) -> str:
    """Return the first word that may begin a question."""
    words = (
        token.text for token in part if token.is_word and token.text not in EMPTY | {"and", "so", "but", "then", "now"}
    )
    return next(words, "")


_SURELY_ASKED = word_set("is are does did")
"""First words of a question that no command has, so that it needs no question mark."""


def _asks(part: Sequence[Token]) -> bool:
    """Return True if words ask something and are no polite command."""
    reading = Reading("", tokens=list(part))
    return _first_asked(part) in _INTERROGATIVES and not (
        WISHES.at(reading, 0) or any(_polite.at(reading, at) for at in range(min(len(part), _POLITE_BEFORE)))
    )


def _statements(tokens: list[Token]) -> list[Token]:
    """Return the tokens with "could you …?" ended by a full stop; Refusal where anything else is asked."""
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
    """Return labels and names by their words, and by those of their singular."""
    known: dict[tuple[str, ...], str] = {}
    for label in (*labels, *names):
        if words := words_of_label(label):
            known.setdefault(words, label)
            known.setdefault((*words[:-1], singular(words[-1])), label)
    for word, meant in SYNONYMS.items():
        if (meant,) in known:
            known.setdefault((word,), known[(meant,)])
    return known


def _recalled(clauses: Clauses, context: SentenceContext) -> Clause | None:
    """Return the last command of the sentence before; where nothing is selected, `context` takes over its things."""
    then = replace(context, names=dict(context.names), copies={}, spare=set())
    try:
        list(_operations(clauses, then))
    except F4xError:
        return None
    if not context.selected:
        context.last, context.they = then.last, then.they
        if isinstance(context.last, Named) and context.last.name in then.copies:
            context.last = next(reversed([*context.earlier]), then.copies[context.last.name])
    done = [clause for clause in _levelled(clauses) if clause.command.make not in ABOUT_OTHERS]
    return done[-1] if done else None


def _operations(clauses: Clauses, context: SentenceContext, before: Clause | None = None) -> Iterator[Change]:
    """Yield the operations of clauses; `before`: the command before them."""
    front: Span | None = None
    then = NOW
    topics: list[SelectKind] = []
    for at, clause in enumerate(clauses := _shared(clauses, context.overall)):
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
        before_it = topics[-1] if topics and not clause.hard else None
        who, assumed = _whom(command, piece, context, timed=front is not None, before=before_it)
        if command.make is REMARK:
            if assumed and not _of_a_clip(command, piece):
                raise Refusal("It is not said who is so; name a thing, or say 'it' for what is selected.")
            _remarked(who, piece, When.of(own or front, context), context)
            continue
        if command.make is AGAIN:
            if before is None:
                raise Refusal("Nothing was said before that could be done again; say what is to be done.")
            own_words = {name: value for name, value in piece.items() if name in OF_ALL}
            command, piece = before.command, {**before.slots, **own_words}
            own = piece.get("when")
        before = clause._replace(command=command, slots=piece)
        topics = [*topics, who] if clause.gapped else [who]
        time = own or front or _time_behind(clauses, at)
        if time and time.kind == "later":
            time = Span(then.plus(time.start), None, "from")
        then = time.start if time else then
        settled = When.of(time, context, slowly="slowly" in piece, soft=piece.get("slowly", False))
        for operation in _made(command, piece, who, settled, context, assumed):
            if operation.SEEN == "in copies":
                operation, topics[-1] = context.copied(operation)
            yield operation
        context.they = together(topics)


def _whom(
    command: Command,
    piece: Mapping[str, Any],
    context: SentenceContext,
    timed: bool = False,
    before: SelectKind | None = None,
) -> tuple[SelectKind, bool]:
    """Return (the selection of a command, True where it is only assumed); `before`: that of the command it is joined to."""
    use = command.use
    if use.alone:
        return All(), False
    if "who" not in piece and context.last in context.spared:  # "black and white, but leave the rose alone"
        context.last = None
    unnamed = context.last is None and not context.selected and not context.overall
    of_clip = unnamed and _of_a_clip(command, piece)
    nobody = context.last is None and not context.selected and (timed or "when" in piece) and (use.timed or of_clip)
    of_all = use.whole and not context.selected and (unnamed or _of_a_clip(command, piece))
    if "who" not in piece and (of_all or nobody or "besides" in piece):
        context.last = All()
    context.overall = context.overall or of_all or use.timed or of_clip
    context.sparing = piece.get("spares")
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
        besides = piece["besides"](context)
        if who == before:  # "darker and gray, not the dog" spares it in both
            context.spared.append(besides)
        context.last = who = Not(besides) if who == All() else And((who, Not(besides)))
    return who, assumed


def _time_behind(clauses: Clauses, at: int) -> Span | None:
    """Return the time at the end of a list without verbs, which holds for all: "the dog red and the cat blue from second 2"."""
    end = at
    while end + 1 < len(clauses) and clauses[end + 1].gapped:
        end += 1
    return clauses[end].slots.get("when") if "who" in clauses[end].slots else None


def _made(
    command: Command, piece: Mapping[str, Any], who: SelectKind, when: When, context: SentenceContext, assumed: bool
) -> list[Change]:
    """Return the operations of one command; Refusal where a strong one names no thing."""
    made = command.make(**arguments(piece))
    values = made if isinstance(made, tuple) else ((made,),)
    operations = _compatible([value(who, when, context) for (value,) in values])
    of_all = who == All() and not all(one.of_picture for one in operations)
    if assumed and (of_all or any(one.NEEDS_WHOM for one in operations)):
        raise Refusal("It is not said whom or what the command is for; name a thing, or say 'it' for what is selected.")
    return operations


def _shared(clauses: Clauses, overall: bool) -> Clauses:
    """Return the clauses with the things that they share.

    A verb alone takes the thing of the next clause ("darken and blur the sky"), the first clauses that of the topic, and grades
    in a list that of the one before ("exposure +0.5 on the dog, contrast +10 %"), unless `overall`.
    """
    shared = _levelled(clauses)
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
    for at, clause in enumerate(shared[1:], 1):
        before = shared[at - 1]
        open_ = clause.command.use.whole and not (clause.hard or overall or {"who", "besides"} & clause.slots.keys())
        if open_ and "who" in before.slots and _of_a_clip(before.command, before.slots):
            shared[at] = clause._replace(slots={**clause.slots, "who": before.slots["who"]})
    return tuple(shared)


_VALUE = Command("make the dog brighter", as_given, frozenset({"values"}), {})


def _levelled(clauses: Clauses) -> list[Clause]:
    """Return the clauses with each complaint and its amount ("too bright, take it down 20 %") made one."""
    done: list[Clause] = []
    for clause in clauses:
        slots = clause.slots
        if clause.command.make is LEVEL:
            complained = done.pop().slots
            remedy = complained["complaint"]
            if not isinstance(remedy, Remedy) or remedy.upward is not slots["up"]:
                raise Refusal("It is not said what is to become more or less; say for example '20 % darker'.")
            own = {
                name: value for name, value in {**slots, **complained}.items() if name in OF_ALL and value is not None
            }
            values = {"values": remedy.changed(slots["how"], remedy.upward)}
            clause = clause._replace(command=_VALUE, slots={**own, **values})
        done.append(clause)
    return done


def _of_a_clip(command: Command, piece: Mapping[str, Any]) -> bool:
    """Return True if a command may be for everything where it is for "it" and nothing was named."""
    made = (
        piece.get("complaint")
        if command.make is REMARK
        else command.make is not AGAIN and command.make(**arguments(piece))
    )
    if not made:
        return False
    with suppress(F4xError):  # it is refused when the command is carried out
        return all(
            (one := value(All(), When(), SentenceContext(1.0, 1))).CLIP or one.of_picture
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
        if who == All() and helps.PLACES and not helps.LOOKS:
            raise Refusal("The clip itself has no size and no place to change; say which thing is meant.")
        context.complaints.append(helps)


def _sparing(operation: Change, spared: Sequence[SelectKind]) -> Change:
    """Return the operation without the things that are to stay as they are."""
    if not operation.ACTS:
        return operation
    select = operation.select
    left_out = [one for one in spared if one not in (select, Not(select)) and Not(one) != select]
    if isinstance(select, Instance):  # "the back one, leave the front one alone"
        left_out = [one for one in left_out if not (isinstance(one, Instance) and one.of == select.of)]
    if isinstance(select, And):
        left_out = [one for one in left_out if Not(one) not in select.of]
    if not left_out:
        return operation
    if operation.left is not None:
        return operation.altered(select=together((select, *left_out)))
    if isinstance(select, All):
        return operation.altered(select=Not(together(left_out)))
    if isinstance(select, Not):
        return operation.altered(select=Not(together((select.of, *left_out))))
    return operation.altered(select=And((select, Not(together(left_out)))))


def _placed(operations: Sequence[Change]) -> list[Change]:
    """Return the operations, each joined with the one before it by `followed_by`."""
    placed: list[Change] = []
    for one in operations:
        placed[-1:] = placed[-1].followed_by(one) if placed else (one,)
    return placed


def _about(moment: TimeExpression, length: Span) -> Span:
    """Return the span of a length that begins at a moment, or lies about the middle of the clip."""
    far = TimeExpression() if length.end is None else length.end.plus(length.start, -1.0)
    start = moment.plus(far, -0.5) if moment == HALF_WAY else moment
    return Span(start, start.plus(far))


def _same_way(one: Change, other: Change) -> bool:
    """Return True if two changes differ in how far they go alone: "let it pop, way more saturated", "in slow motion, at 40 %"."""
    a, b = one.to_json(), other.to_json()
    if a["op"] != b["op"] or a.keys() != b.keys() or a.get("select") != b.get("select"):
        return False
    pairs = [(a[key], b[key]) for key in one.FACTORS if key in a]
    return bool(pairs) and all((x > 1) == (y > 1) for x, y in pairs)


def _compatible(operations: list[Change]) -> list[Change]:
    """Return the operations; Refusal where two of them set the same thing."""
    if all(_same_way(one, operations[-1]) for one in operations):
        operations = operations[-1:]
    unseen = len(operations) > 1 and any(one.removes for one in operations)
    if unseen or len({one.aspect for one in operations}) < len(operations):
        raise Final("Two things are said that exclude one another, as 'red and blue' do; say one of them.")
    return operations


_SHOWN_ONLY_THEN = "'Only' with a time can be meant in two ways; say for example 'hide the dog until second 2'."
_ONLY_WHEN = keyword(
    "only [after|from|until|before|between|during|for|since|while]|"
    "only [in|at|on|over|within] (the) [first|last|second|frame|frames|seconds|beginning|end|middle]"
)


def _unknown_word(reading: Reading) -> str:
    """Return the sentence about the first word that is in no lexicon; empty where all are."""
    things = {word for words in reading.known for word in words}
    for at, token in enumerate(reading.tokens):
        if token.is_word and is_strange(token.text, things | NO_THINGS | COMMAND_VERBS | _SPOKEN_OF):
            somebody = re.fullmatch(PEOPLE, token.text)
            close = None if somebody else misspelt(token.text, VOCABULARY | COLOURS.keys() | things)
            hint = f"; did you mean '{close}'?" if close else "."
            return f"I do not understand '{reading.text_of(at, at + 1)}'{hint}"
    return ""


_NEGATIONS = word_set("no not never without nothing none nobody")
MOST_FRAMES = 10**6
"""Frames of a clip in which every time of a command lies."""
MOST_EXAMPLES = 3
"""Commands that a refusal offers."""


def nearest(sentence: str, there: Sequence[str] = ()) -> tuple[str, ...]:
    """Return commands that resemble a refused sentence, about the things that it names, else those that are `there`.

    None of them removes, or does what the sentence asks for; a sentence with a negation gets none, as they would be what is not
    to be done.
    """
    known = _known(tuple(there))
    text, asked = without_shot(written(sentence), there), operations_of(sentence, there)
    reading = Reading(text, known, tokenise(text)[:MAX_WORDS])
    if not _NEGATIONS.isdisjoint(reading.words):
        return ()
    named = [
        label
        for label in there
        if any(_holds(literal(form), reading) for form in dict.fromkeys((label, singular(label))))
    ]
    examples = [
        about_there(f"'{command.example}'", "", named or there)[1:-1]
        for command in COMMANDS
        if (needed := command.needed - {"who"})
        and command.make not in ABOUT_OTHERS
        and matches_of(command.slots, needed, reading)
        and (not there or len({*_EXAMPLE_THING.findall(command.example)}) <= len(named or there))
    ]
    done = {example: operations_of(example, there) for example in examples}
    fitting = [
        example for example, does in done.items() if does and does != asked and not any(one.removes for one in does)
    ]
    return tuple(fitting[:MOST_EXAMPLES])


def operations_of(sentence: str, labels: Sequence[str]) -> tuple[Change, ...]:
    """Return the operations of a sentence as it stands, in a clip of any length whose scene knows `labels`.

    Empty where it cannot be carried out or has two meanings.
    """
    clip = SentenceContext(1.0, MOST_FRAMES, selected=True, labels=frozenset(labels))
    with suppress(F4xError):
        read = _read(sentence, _known(tuple(labels)), lambda read: _settled(read, clip, None))
        return () if read.idle or reason_of(UNSURE, read.reading) else read.operations
    return ()


_EXAMPLE = re.compile(r"(?<!\w)'[^']*'")
_EXAMPLE_THING = re.compile(r"\bthe (dogs?|cat|car|ball|bush|lamp|bird|hat|tree|person|people|boat|house|sky)\b")
"""Things of the examples in refusals; others stand in their place where it is known what the scene holds."""


def about_there(reason: str, sentence: str, there: Sequence[str]) -> str:
    """Return a refusal whose examples name things that are `there`, except those that the sentence names itself."""

    def about(example: re.Match[str]) -> str:
        nouns = [noun for noun in dict.fromkeys(_EXAMPLE_THING.findall(example[0])) if noun not in sentence.lower()]
        if len(nouns) > len(there):
            return example[0]
        instead = dict(zip(nouns, there, strict=False))
        return _EXAMPLE_THING.sub(lambda found: f"the {instead.get(found[1], found[1])}", example[0])

    return _EXAMPLE.sub(about, reason)
