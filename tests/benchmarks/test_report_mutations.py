"""Formulas broken on purpose: every one is still written as it is broken, and one of each kind of outcome is seen."""

import dataclasses
from functools import partial
from pathlib import Path

import pytest

from benchmarks.studies import mutations
from benchmarks.studies.mutations import MUTATIONS, ROOT, failing_tests, try_mutation
from benchmarks.study import Context
from f4x_core.errors import F4xError

FORMULA = "dual = 0.5 * quaternion.multiply(pure, q)\n"


@pytest.mark.parametrize("mutation", MUTATIONS, ids=lambda m: f"{m.formula}: {m.wrong}")
def test_the_formula_is_there_once_and_its_tests_exist(mutation):
    assert (ROOT / "f4x_core" / mutation.file).read_text(encoding="utf-8").count(mutation.old) == 1
    assert mutation.new != mutation.old
    assert all((ROOT / "tests" / "core" / name).is_file() for name in mutation.tests)


def small_checkout(folder: Path, test: str) -> Path:
    (folder / "f4x_core" / "geometry").mkdir(parents=True)
    (folder / "tests" / "core").mkdir(parents=True)
    (folder / "benchmarks").mkdir()
    (folder / "f4x_core" / "geometry" / "dual_quaternion.py").write_text(FORMULA)
    (folder / "tests" / "core" / "test_one.py").write_text(test)
    for name in ("pyproject.toml", "__init__.py"):
        (folder / name).write_text("")
    return folder


def test_what_a_test_notices_and_what_none_does(tmp_path):
    half = dataclasses.replace(MUTATIONS[1], tests=("test_one.py",))
    source = "from pathlib import Path\n\ndef test_half():\n    assert {}\n"
    noticed = source.format('"0.5" in Path("f4x_core/geometry/dual_quaternion.py").read_text()')
    caught = try_mutation(half, small_checkout(tmp_path / "noticed", noticed))
    assert caught == {"caught by": "test_one.py::test_half"}
    assert try_mutation(half, small_checkout(tmp_path / "missed", source.format("True")))["caught by"] is None
    with pytest.raises(F4xError, match="did not run"):
        try_mutation(half, small_checkout(tmp_path / "broken", "import nothing_of_that_name\n"))
    with pytest.raises(F4xError, match="up to date"):
        try_mutation(dataclasses.replace(half, old="not there"), tmp_path / "noticed")


def test_a_test_that_fails_on_the_unbroken_copy_is_reported_and_catches_nothing(tmp_path, monkeypatch):
    source = "def test_wrong_anyway():\n    assert False\n\ndef test_half():\n    assert {}\n"
    here = '"0.5" in open("f4x_core/geometry/dual_quaternion.py").read()'
    half = dataclasses.replace(MUTATIONS[1], tests=("test_one.py",))
    noticed, missed = (small_checkout(tmp_path / name, source.format(text)) for name, text in (("a", here), ("b", "1")))
    for root in (noticed, missed):
        assert failing_tests(half.tests, root) == ["test_one.py::test_wrong_anyway"]
        assert try_mutation(half, root)["caught by"] == "test_one.py::test_wrong_anyway"  # taken alone it seems caught
    with pytest.raises(F4xError, match="did not run"):
        failing_tests(half.tests, small_checkout(tmp_path / "c", "import nothing_of_that_name\n"))
    monkeypatch.setattr(mutations, "MUTATIONS", (half,))
    for root, caught in ((noticed, "test_one.py::test_half"), (missed, None)):
        for name in ("failing_tests", "try_mutation"):
            monkeypatch.setattr(mutations, name, partial(globals()[name], root=root))
        found = mutations.measure_mutations(Context(root / "report"))
        assert found.tables[0].rows[0]["caught by"] == caught
        assert "test_wrong_anyway fails before" in found.failed[0] and len(found.failed) == (1 if caught else 2)


def test_where_no_test_is_left_none_catches(tmp_path):
    half = dataclasses.replace(MUTATIONS[1], tests=("test_one.py",))
    root = small_checkout(tmp_path / "one", "def test_wrong_anyway():\n    assert False\n")
    assert try_mutation(half, root, failing=failing_tests(half.tests, root)) == {"caught by": None}
