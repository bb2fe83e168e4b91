"""How long each kind of test takes: the study `suites`, from the records that pytest leaves of whole suites (JUnit's XML)."""

from __future__ import annotations

from pathlib import Path
from typing import Any
from xml.etree import ElementTree

from f4x_core.errors import F4xError

from .machine import describe_machine
from .study import Row, read_json, write_json

SUITES = {
    "everyday": "python3 scripts/dev.py test",
    "slow": 'python3 scripts/dev.py test -m "slow and not real"',
    "real": 'python3 scripts/dev.py test -m "real and not blender"',
    "blender": "python3 scripts/dev.py blender",
}
"""Name of a record -> the command that leaves it."""


def take_over(records: Path, results: Path) -> None:
    """Bring `suites.json` in `results` up to date with the records in a folder; suites without one keep their rows.

    Raises:
        F4xError: a record is damaged, or tests failed in it.
    """
    found = {name: row_of(records / f"{name}.xml", name) for name in SUITES if (records / f"{name}.xml").is_file()}
    if not found:
        return
    file = results / "suites.json"
    study: dict[str, Any] = read_json(file) if file.is_file() else {"tables": [{"rows": []}]}
    rows = {row["suite"]: row for row in study["tables"][0]["rows"]} | found
    write_json(
        file,
        {
            "name": "suites",
            "section": "tests",
            "title": "The tests",
            "question": "How many tests there are of each kind, and how long they take.",
            "seed_tables": [],
            "only_full": True,
            "settings": {},
            "command": "",
            "seconds": 0.0,
            "machine": describe_machine(),
            "tables": [
                {
                    "name": "suites",
                    "rows": [rows[name] for name in SUITES if name in rows],
                    "title": "",
                    "timed": ["time (min)"],
                    "note": "What a machine lacks (a graphics card, a package, a browser) is skipped with the reason.",
                }
            ],
            "figures": [],
            "words": [],
            "skipped": [],
            "failed": [],
        },
    )


def row_of(file: Path, name: str) -> Row:
    """The row of one suite. Raises F4xError."""
    try:
        suite = next(ElementTree.parse(file).iter("testsuite")).attrib
        tests, skipped, failed = (
            int(suite["tests"]),
            int(suite["skipped"]),
            int(suite["failures"]) + int(suite["errors"]),
        )
        minutes, day = float(suite["time"]) / 60, suite["timestamp"][:10]
    except (ElementTree.ParseError, StopIteration, KeyError, ValueError) as error:
        raise F4xError(f"{file}: no record of pytest ({error}); run `{SUITES[name]}` again.") from error
    if failed:
        raise F4xError(f"{file}: {failed} tests failed; mend them, and run `{SUITES[name]}` again.")
    return {
        "suite": name,
        "command": SUITES[name],
        "passed": tests - skipped,
        "skipped": skipped,
        "time (min)": round(minutes, 1),
        "day": day,
    }
