"""Mutants: which changes count as arithmetic, what is listed as harmless, and what becomes of survivors."""

import subprocess
from dataclasses import asdict

import pytest

from benchmarks.studies import mutations
from benchmarks.studies.mutations import (
    KINDS,
    ROOMS,
    ROOT,
    Mutant,
    about_survivor,
    accepted,
    arithmetic_change,
    configure,
    copy_source,
    findings_of,
    rule_of,
    run_mutmut,
)
from benchmarks.study import Context, MissingError
from f4x_core.errors import F4xError

BEFORE = """

def x_area__mutmut_orig(a, b, progress):
    progress("area", 1)
    if a < 0:
        raise ValueError(
            f"{a + 1} is too small")
    return 0.5 * a * b[:, 1] + len("x")
"""


@pytest.mark.parametrize(
    ("old", "new", "counts"),
    [
        ("0.5 * a", "0.5 / a", True),
        ("0.5 * a", "1.5 * a", True),
        ("b[:, 1]", "b[:, 2]", True),
        ("a < 0", "a <= 0", True),
        ("if a < 0", "if (a < 0) or True", True),
        ("0.5 * a", "0.5 * None", False),
        ('len("x")', 'len("XXxXX")', False),
        ('f"{a + 1} is', 'f"{a - 1} is', False),
        ('progress("area", 1)', 'progress("area", 2)', False),
    ],
)
def test_arithmetic_is_numbers_and_operators_outside_of_messages(old, new, counts):
    after = BEFORE.replace("__mutmut_orig", "__mutmut_3").replace(old, new)
    found = arithmetic_change(BEFORE, after)
    assert (found is not None) == counts
    if counts:
        assert old in found[0] and new in found[1]


def test_listed_survivors_are_still_written_so_and_say_why():
    for row in accepted():
        lines = {line.strip() for line in (ROOT / "f4x_core" / row["file"]).read_text(encoding="utf-8").splitlines()}
        assert row["before"] in lines and row["before"] != row["after"]
        assert row["kind"] in KINDS and row["reason"]


@pytest.mark.parametrize(
    ("before", "after", "excused"),
    [
        ("for a, b in zip(x, f(y), strict=True):", "for a, b in zip(x, f(y), strict=False):", True),
        ("for a, b in zip(x, y, strict=False):", "for a, b in zip(x, y, strict=True):", False),
        ("model.load_state_dict(state, strict=True)", "model.load_state_dict(state, strict=False)", False),
        ("a = b.reshape(-1, 2).sum(-1)", "a = b.reshape(-2, 2).sum(-1)", True),
        ("a = b.reshape(-1, 2).reshape(f(c), d[0], -1)", "a = b.reshape(-1, 2).reshape(f(c), d[0], -2)", True),
        ("a = b.reshape(-1, 2).sum(-1)", "a = b.reshape(-1, 2).sum(-2)", False),
        ("a = b.reshape(-1, 2)", "a = b.reshape(-1, 3)", False),
        ("a = b.reshape(-1, 2)", "a = b.reshape(+1, 2)", False),
        ("a = b.reshape(c.shape[:-1])", "a = b.reshape(c.shape[:-2])", False),
        ("g = torch.Generator().manual_seed(0)", "g = torch.Generator().manual_seed(1)", True),
        ("cv2.setRNGSeed(0)  # fixed", "cv2.setRNGSeed(1)  # fixed", True),
        ("x = default_rng(0).uniform(0, 1)", "x = default_rng(1).uniform(0, 1)", True),
        ("x = default_rng(0).uniform(0, 1)", "x = default_rng(0).uniform(1, 1)", False),
        ("edges = levels(distance, seed=0)", "edges = levels(distance, seed=1)", True),
        ("edges = levels(distance, seed + step)", "edges = levels(distance, seed - step)", False),
        ("if a < 0:", "if a <= 0:", False),
    ],
)
def test_changes_that_matter_nowhere_need_no_row(before, after, excused):
    row = about_survivor("fit", Mutant("one", "fit/losses.py", before, after))
    assert bool(row["kind"]) == bool(row["reason"]) == excused
    assert row["kind"] == "equivalent" * excused


def test_no_row_says_what_a_rule_says():
    rows = [row for row in accepted() if rule_of(Mutant("one", row["file"], row["before"], row["after"]))]
    assert rows == []


def test_survivors_that_matter_fail_the_study():
    harmless = accepted()[0]
    known = Mutant("one", harmless["file"], harmless["before"], harmless["after"])
    wrong = Mutant("two", "fit/losses.py", "return a + b", "return a - b")

    def result(*survivors):
        return {"room": "fit", "all": 90, "drawn": 10, "survivors": [asdict(mutant) for mutant in survivors]}

    assert not findings_of([result()]).failed and not findings_of([result(known)]).failed
    found = findings_of([result(known, wrong)])
    assert "1 of 10 mutants survive" in found.failed[0] and found.words[0].startswith("8 of 10")
    assert [row["kind"] for row in found.tables[1].rows] == [harmless["kind"], ""]


def test_rooms_and_their_tests_are_written_into_a_copy(tmp_path):
    small = tmp_path / "checkout"
    for name in ("f4x_core/fit", "f4x_core/query", "tests/core"):
        (small / name).mkdir(parents=True)
    for name, text in {"fit": "from f4x_core.fit.losses import ssim", "other": "import f4x_core.fitting"}.items():
        (small / "tests" / "core" / f"test_{name}.py").write_text(text)
    (small / "pyproject.toml").write_text("[tool.mutmut]\ndebug = true\n")
    copy = copy_source(small, tmp_path)
    configure(copy, "fit")
    text = (copy / "pyproject.toml").read_text()
    assert '["f4x_core/fit/*"]' in text and '["tests/core/test_fit.py"]' in text and "debug = true" in text
    assert (small / "pyproject.toml").read_text() == "[tool.mutmut]\ndebug = true\n"
    for room in ("query", "nowhere"):
        with pytest.raises(F4xError, match=f"{room}: no folder"):
            configure(copy, room)


def test_mutants_that_were_not_tried_are_an_error(tmp_path, monkeypatch):
    said = subprocess.CompletedProcess([], 1, "FAILED tests/core/test_fit.py::test_one - boom\n", "")
    monkeypatch.setattr(mutations.subprocess, "run", lambda *_, **__: said)
    with pytest.raises(F4xError, match=r"fit: mutmut did not try 1 mutants: FAILED tests/core/test_fit.py::test_one"):
        run_mutmut(tmp_path, "fit", [Mutant("one", "fit/losses.py", "a", "b")])


def test_without_mutmut_the_study_is_skipped(tmp_path, monkeypatch):
    monkeypatch.setattr(mutations, "find_spec", lambda _: None)
    with pytest.raises(MissingError, match=r"dev\.py mutants"):
        mutations.measure_mutations(Context(tmp_path))
    assert all((ROOT / "f4x_core" / room).is_dir() for room in ROOMS)
