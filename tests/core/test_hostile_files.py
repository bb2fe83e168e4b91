"""Damaged and lying files cost what their size allows and end in a scene or in one sentence, whatever reads them."""

import pytest
from hostile import BYTES, KINDS, SECONDS, Outcome, try_all, try_one

SHORT, LONG = 6, 75
"""Damaged copies of each kind of file: every day, and in the long form."""


def complaint(outcome: Outcome) -> str:
    """One line of what is wrong with an outcome; empty where nothing is."""
    where = f"{outcome.name} {outcome.number}: "
    if outcome.trouble:
        return where + outcome.trouble
    if outcome.seconds > SECONDS or outcome.memory > BYTES:
        return f"{where}{outcome.seconds:.1f} s, {outcome.memory >> 20} MiB"
    return ""


@pytest.mark.parametrize("name", KINDS)
def test_the_valid_file_is_read(tmp_path, name):
    outcome = try_one(name, 0, KINDS[name].make(tmp_path))
    assert not outcome.trouble and not outcome.refused, outcome


@pytest.mark.parametrize("count", [SHORT, pytest.param(LONG, marks=pytest.mark.slow)])
def test_damaged_files_are_read_or_refused_in_one_sentence(tmp_path, count):
    outcomes = try_all(tmp_path, [(name, number) for name in KINDS for number in range(count)])
    worst = max(outcomes, key=lambda outcome: outcome.memory)
    slowest = max(outcomes, key=lambda outcome: outcome.seconds)
    print(f"{len(outcomes)} files, {sum(bool(outcome.refused) for outcome in outcomes)} refused")
    print(f"at most {worst.memory >> 20} MiB ({worst.name}), {slowest.seconds:.1f} s ({slowest.name})")
    assert [text for text in map(complaint, outcomes) if text] == []
