"""Times of whole test suites come from pytest's own records."""

import subprocess
import sys

import pytest

from benchmarks.study import read_json
from benchmarks.suites import take_over
from f4x_core.errors import F4xError

RECORD = (
    '<testsuites><testsuite name="pytest" errors="0" failures="{failed}" skipped="2" tests="12" time="90.0" '
    'timestamp="2026-11-25T18:00:00"/></testsuites>'
)


def rows(folder):
    return {row["suite"]: row for row in read_json(folder / "suites.json")["tables"][0]["rows"]}


def test_a_suite_keeps_its_row_until_it_is_run_again(tmp_path):
    (tmp_path / "slow.xml").write_text(RECORD.format(failed=0))
    take_over(tmp_path, tmp_path)
    (tmp_path / "slow.xml").rename(tmp_path / "everyday.xml")
    take_over(tmp_path, tmp_path)
    assert list(rows(tmp_path)) == ["everyday", "slow"]
    assert rows(tmp_path)["slow"] == {
        "suite": "slow",
        "command": 'python3 scripts/dev.py test -m "slow and not real"',
        "passed": 10,
        "skipped": 2,
        "time (min)": 1.5,
        "day": "2026-11-25",
    }


def test_pytest_writes_what_is_read(tmp_path):
    (tmp_path / "test_it.py").write_text("import pytest\ndef test_a(): pass\n@pytest.mark.skip\ndef test_b(): pass\n")
    command = [sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider", "--junitxml=real.xml", "test_it.py"]
    subprocess.run(command, cwd=tmp_path, check=True, capture_output=True)
    take_over(tmp_path, tmp_path)
    assert (rows(tmp_path)["real"]["passed"], rows(tmp_path)["real"]["skipped"]) == (1, 1)


@pytest.mark.parametrize("record", [RECORD.format(failed=1), "<testsuites/>", "no xml"])
def test_a_record_with_failures_or_of_something_else_is_refused(tmp_path, record):
    (tmp_path / "blender.xml").write_text(record)
    with pytest.raises(F4xError, match=r"dev\.py blender"):
        take_over(tmp_path, tmp_path)
    assert not (tmp_path / "suites.json").exists()
