"""Every hard case of the catalogue, and how the catalogue is read and told."""

from pathlib import Path

import pytest

from benchmarks.studies import stability
from benchmarks.studies.hard_cases import Case, Check, limited, load_cases, refused, reported, run_case, that, within
from benchmarks.study import Context, MissingError
from f4x_core.errors import F4xError

CASES = load_cases(stability.CATALOGUE)


@pytest.mark.parametrize(
    "case", [pytest.param(case, id=case.name, marks=pytest.mark.slow if case.slow else ()) for case in CASES]
)
def test_hard_case(case: Case):
    checks = list(case.check())
    assert checks
    assert [check for check in checks if check.outcome == "wrong"] == []


def test_the_catalogue_is_whole():
    assert len(CASES) >= 60
    assert len({case.title for case in CASES}) == len(CASES)


def write_case(folder: Path, body: str, doc: str = "Title.\n\nHard: a.\n\nWhy: b.\n\nMust hold: c\nand d.\n") -> Path:
    folder.mkdir(exist_ok=True)
    (folder / "__init__.py").touch()
    (folder / "one.py").write_text(f'"""{doc}"""\n{body}')
    return folder


CHECK = "from benchmarks.studies.hard_cases import that\nSTAGE = 'scene'\ndef check():\n"


def test_a_file_becomes_a_case(tmp_path):
    (case,) = load_cases(write_case(tmp_path / "cases", CHECK + "    yield that('x', True)"))
    assert (case.name, case.stage, case.title, case.slow) == ("one", "scene", "Title", False)
    assert (case.hard, case.why, case.must) == ("a.", "b.", "c and d.")
    assert run_case(case) == [Check("x", "right")]


@pytest.mark.parametrize(
    ("body", "doc"),
    [
        (CHECK + "    yield", "Title.\n\nWhy: b.\n\nMust hold: c.\n"),
        ("STAGE = 'kitchen'\ndef check(): yield", "Title.\n\nHard: a.\n\nWhy: b.\n\nMust hold: c.\n"),
        ("STAGE = 'scene'", "Title.\n\nHard: a.\n\nWhy: b.\n\nMust hold: c.\n"),
    ],
    ids=["docstring", "stage", "no check"],
)
def test_a_file_that_is_no_case_is_named(tmp_path, body, doc):
    with pytest.raises(F4xError, match=r"one\.py: is not laid out as a hard case"):
        load_cases(write_case(tmp_path / "cases", body, doc))


def test_a_folder_that_is_no_catalogue_is_named(tmp_path):
    with pytest.raises(F4xError, match="no catalogue of hard cases"):
        load_cases(tmp_path)


def test_checks_judge():
    assert within("x", 1e-6, 1e-5).outcome == "right"
    assert within("x", 2e-5, 1e-5).outcome == within("x", float("nan"), 1).outcome == "wrong"
    assert that("x", 0).outcome == "wrong" and limited("x", True, "as known").outcome == "known limit"
    assert reported("x", "c[au]t", ["a dog", "a cut"]) == Check("x", "told", message="a cut")
    assert reported("x", "cat", ["a dog"]).outcome == "wrong"

    def fail():
        raise F4xError("the file is empty")

    assert refused("x", "empty", fail) == Check("x", "refused", message="the file is empty")
    assert refused("x", "full", fail).outcome == refused("x", "empty", lambda: None).outcome == "wrong"


def test_the_study_tells_what_went_wrong_and_is_the_same_twice(tmp_path):
    body = CHECK + "    yield that('x', True)\n    yield that('the sky is green', False, 'native')"
    cases = write_case(tmp_path / "cases", body)
    (cases / "two.py").write_text(cases.joinpath("one.py").read_text().replace("yield that('x', True)", "1 / 0"))
    found = [stability.measure_cases(Context(tmp_path / name, cases=cases)) for name in ("a", "b")]
    assert found[0] == found[1]
    assert found[0].failed == ["Title: native the sky is green", "Title: ZeroDivisionError: division by zero"]
    assert found[0].words[0].startswith("2 hard cases in 3 checks: 2 wrong")
    assert [row["outcome"] for row in found[0].tables[1].rows] == ["right", "wrong", "wrong"]


def test_without_a_catalogue_the_study_is_skipped(tmp_path, monkeypatch):
    monkeypatch.setattr(stability, "CATALOGUE", tmp_path / "none")
    with pytest.raises(MissingError, match="--cases DIR"):
        stability.measure_cases(Context(tmp_path))


def test_precision_is_worst_without_care_for_signs(tmp_path, monkeypatch):
    monkeypatch.setattr(stability, "SCALES", (1.0, 1e3))
    found = stability.measure_precision(Context(tmp_path))
    errors = {row["rule"]: [] for row in found.tables[1].rows}
    for row in found.tables[1].rows:
        errors[row["rule"]].append(row["error (degrees)"])
    assert max(errors["ours"]) < 1e-3 < 90 < max(errors["w >= 0"])
    assert all(0 < row["error"] < 1e-4 for row in found.tables[0].rows)
