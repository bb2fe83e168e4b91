"""The last resort behind the grammar of questions: what it asks back, and how often that is right."""

from collections import Counter

import numpy as np
import pytest
import sentence_cases
import sentence_phrasings

from f4x_core.errors import F4xError
from f4x_core.features import phrasings
from f4x_core.features.text import TEXT_ENCODERS
from f4x_core.fit.vocabulary import EVERYDAY
from f4x_core.language.grammar import Doubt
from f4x_core.query import meaning
from f4x_core.query.wording import Unanswerable, read_question

LABELS = ("dog", "bike", "car")


@pytest.fixture(scope="module")
def known():
    return sentence_phrasings.questions()


@pytest.fixture(scope="module")
def words(known):
    return sentence_phrasings.Words([(kind, phrasing) for _, kind, _, phrasing in known])


@pytest.fixture(scope="module")
def by_words(words) -> np.ndarray:
    return sentence_phrasings.without_itself(words.kernel, words.wanted)


@pytest.fixture(scope="module")
def counted(known, words):
    """From scores: what is asked back of the opened questions: (whether it has an answer, right, wrong or nothing)."""
    opened = {row["text"] for row in sentence_cases.rows(sentence_cases.OPENED)}
    done: dict[tuple[int, str], str] = {}

    def count(scores: np.ndarray, ahead: float) -> Counter:
        found = Counter()
        for at, ((row, _, text, _), score) in enumerate(zip(known, scores, strict=True)):
            if row["text"] in opened:
                key = at, phrasings.leading(score, words.names, ahead)
                if key not in done:
                    done[key] = asked(row, text, key[1])
                found[row["expect"] == "do", done[key]] += 1
        return found

    return count


def asked(row, text: str, kind: str) -> str:
    """right, wrong or nothing: what the first question of a kind that is understood asks."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(meaning, "likeliest", lambda *_: kind)
        return _asked(row, text)


def _asked(row, text: str) -> str:
    labels = {*EVERYDAY, *sentence_cases._things(row)}
    for question in meaning.meant(text, labels):
        try:
            understood = read_question(question, 24.0, 72, row.get("selected", ""), labels)
        except F4xError:
            continue
        fits = row["expect"] == "do" and sentence_cases._questions_fit(row["questions"], understood)
        return "right" if fits else "wrong"
    return "nothing"


def test_without_the_grammar_and_the_question_itself_it_is_mostly_right(by_words, counted):
    found = counted(by_words, phrasings.AHEAD)
    assert found[True, "right"] > 7 * found[True, "wrong"]
    assert found[True, "right"] > 0.5 * sum(n for (do, _), n in found.items() if do)


@pytest.mark.skipif(not TEXT_ENCODERS["minilm"].here, reason="the package of all-MiniLM-L6-v2 is not installed")
def test_with_vectors_it_asks_more_rightly_and_no_more_wrongly(known, words, by_words, counted):
    vectors = sentence_phrasings.vectors([text for _, _, text, _ in known])
    kernel = sentence_phrasings.kernel(vectors)
    by_both = (by_words + sentence_phrasings.without_itself(kernel, words.wanted)) / 2
    alone, both = counted(by_words, phrasings.AHEAD), counted(by_both, phrasings.AHEAD_BY_BOTH)
    assert both[True, "right"] > alone[True, "right"] and both[True, "wrong"] <= alone[True, "wrong"]
    fitted = vectors.T @ np.linalg.solve(kernel, words.wanted)
    assert (
        np.abs(phrasings.Meanings.of(meaning.PHRASINGS).vectors - fitted).max() < 2e-3
    )  # the file is that of these questions


def refusal(question: str, selected: str = "") -> F4xError:
    with pytest.raises(F4xError) as caught:
        read_question(question, 24.0, 72, selected, LABELS)
    return caught.value


@pytest.mark.parametrize(
    ("question", "instead"),
    [
        ("say when roughly the dog bounds up to his peak", "when is the dog highest"),
        ("which of car and bike hogs more room", "which is bigger, the car or the bike"),
    ],
)
def test_what_the_grammar_refuses_is_asked_back_in_its_own_words(question, instead):
    doubt = refusal(question)
    assert isinstance(doubt, Doubt) and doubt.instead == instead and f"Do you mean '{instead}?'" in str(doubt)
    assert read_question(instead, 24.0, 72, "", LABELS)


@pytest.mark.parametrize(
    "question",
    [
        "what does the dog weigh in kilos",
        "what did the dog eat",
        "does it bounce up-ish to its peak",
        "why ever would the car go so fast-ish",
        "how fast-ish does it not go",
        "wibble the wobble",
    ],
)
def test_what_nobody_can_compute_and_negations_are_refused(question):
    assert isinstance(refusal(question), Unanswerable)


def test_of_two_question_words_none_is_left_out():
    assert not [*meaning.meant("so where-ish and when-ish is the dog", LABELS)]
    doubt = refusal("which of car and bike hogs more room, and where is the dog")
    assert doubt.instead == "which is bigger, the car or the bike, and where is the dog"
