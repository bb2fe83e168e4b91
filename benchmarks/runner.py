"""Runs studies, keeps what each found, goes on where an earlier run stopped."""

from __future__ import annotations

import csv
import io
import time
from collections.abc import Sequence
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

from f4x_core.errors import F4xError
from f4x_core.files import replace_file
from f4x_core.progress import Progress, silent

from .catalogue import STUDIES
from .machine import describe_machine, digest_source
from .study import Context, Findings, MissingError, Row, Study, read_json, write_json

STUDY_FILE = "study.json"
REPORT_FILE = "report.json"


def run_studies(
    studies: Sequence[Study], folder: Path, context: Context, progress: Progress = silent
) -> dict[str, Any]:
    """Measure what is not measured yet; returns the whole report, earlier studies in the folder included.

    Args:
        studies: what to run; one that is done with the same settings is not run again.
        folder: gets `STUDY/study.json`, `STUDY/TABLE.csv` and `report.json`.
        context: settings of all studies; `folder` and `progress` are set here.

    Raises:
        Cancelled: goes through, with all finished steps kept.
    """
    settings = {"quick": context.quick, "seed": context.seed, "threads": context.threads}
    for done, study in enumerate(studies):
        progress("report", done, len(studies), study.title)
        place = folder / study.name
        if _is_done(place, settings):
            continue
        if study.only_full and context.quick:
            findings, seconds, taken = Findings(skipped=["too long for a quick report"]), 0.0, []
        else:
            place.mkdir(parents=True, exist_ok=True)
            start = time.perf_counter()
            own = replace(context, folder=place, progress=progress, taken=[])
            findings = _measure(study, own)
            seconds, taken = time.perf_counter() - start, own.taken
        _keep(study, findings, seconds, taken, settings, place)
    progress("report", len(studies), len(studies), "")
    return gather(folder)


def gather(folder: Path) -> dict[str, Any]:
    """Return all studies that a folder holds, in the order of the catalogue; also written as `report.json`."""
    found = {study.name: folder / study.name / STUDY_FILE for study in STUDIES}
    studies = {name: read_json(file) for name, file in found.items() if file.is_file()}
    report = {"machine": describe_machine(), "source": digest_source(), "studies": studies}
    write_json(folder / REPORT_FILE, report)
    return report


def as_csv(rows: Sequence[dict[str, Any]]) -> str:
    """Rows as comma-separated values under the union of their columns, in order of appearance."""
    columns = list(dict.fromkeys(column for row in rows for column in row))
    text = io.StringIO()
    writer = csv.DictWriter(text, columns, lineterminator="\n")
    writer.writeheader()
    writer.writerows(rows)
    return text.getvalue()


def _is_done(place: Path, settings: dict[str, Any]) -> bool:
    """Return True if it was measured, and nothing failed: what was missing then may be here now."""
    file = place / STUDY_FILE
    if not file.is_file():
        return False
    record = read_json(file)
    return record.get("settings") == settings and bool(record["tables"]) and not record["failed"]


def _measure(study: Study, context: Context) -> Findings:
    try:
        return study.function()(context)
    except MissingError as reason:
        return Findings(skipped=[str(reason)])
    except F4xError as error:  # one study that fails doesn't cost the others
        return Findings(failed=[str(error)])


def _keep(
    study: Study, findings: Findings, seconds: float, taken: Sequence[Row], settings: dict[str, Any], place: Path
) -> None:
    names = [table.name for table in findings.tables]
    unknown = [figure.table for figure in findings.figures if figure.table not in names]
    if unknown or len(set(names)) < len(names):
        raise F4xError(f"{study.name}: its figures or tables do not fit together ({unknown or names}); mend the study.")
    place.mkdir(parents=True, exist_ok=True)
    for table in findings.tables:
        with replace_file(place / f"{table.name}.csv") as out:
            out.write(as_csv(table.rows).encode())
    about = {name: value for name, value in asdict(study).items() if name != "measure"}
    again = f"f4x report -o DIR --only {study.name}" + (" --quick" if settings["quick"] else "")
    again += f" --threads {settings['threads']}" if settings["threads"] != 1 else ""
    machine = describe_machine()
    for what in ("processor", "kernels"):  # all that had a part in it
        machine[what] = " and ".join(
            sorted({str(about[what]) for about in (machine, *(row["machine"] for row in taken))})
        )
    record = about | {
        "settings": settings,
        "command": again,
        "seconds": round(seconds + sum(row["seconds"] for row in taken), 1),
        "machine": machine,
        "source": " and ".join(sorted({digest_source(), *(row["source"] for row in taken)})),
    }
    write_json(place / STUDY_FILE, record | asdict(findings))
