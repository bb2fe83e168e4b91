"""The report: studies run once, go on where they stopped, fail alone, and stand on a page that can be read and repeated."""

import csv
import json
import re
import sys
from pathlib import Path

import pytest

from benchmarks import catalogue, runner
from benchmarks.halves import RENDERED
from benchmarks.publication import PAGE, RESULTS, publish, results_page
from benchmarks.report_page import as_markdown, format_value, write_page
from benchmarks.runner import run_studies
from benchmarks.studies import clip_studies
from benchmarks.study import (
    SECTIONS,
    Context,
    Figure,
    Findings,
    MissingError,
    Study,
    Table,
    as_plain,
    pareto_front,
    time_rows,
)
from f4x_core.cli.main import main
from f4x_core.errors import Cancelled, F4xError

DOCS = Path(__file__).resolve().parents[2] / "docs"
CALLS: list[str] = []


def measure_well(context):
    rows = [
        {"form": f, "time (ms)": t, "error": e} for f, t, e in (("a", 1.0, 1e-3), ("b", 2.0, 1e-6), ("b", 3.0, 0.0))
    ]
    first = context.step("first", lambda: CALLS.append("first") or {"half": 0.5})
    context.step("second", lambda: CALLS.append("second"))
    figure = Figure("speed <against> error", "forms", "time (ms)", "error", series="form")
    return Findings([Table("forms", rows, timed=("time (ms)",))], [figure], [f"half is {first['half']}"])


def measure_badly(context):
    raise F4xError("the sky fell")


def measure_nothing(context):
    raise MissingError("no such clip")


@pytest.fixture
def studies(monkeypatch):
    CALLS.clear()
    here = "benchmarks.probe"
    monkeypatch.setitem(sys.modules, here, sys.modules[__name__])
    made = tuple(
        Study(name, "speed", f"Title of {name}", "Why?", f".probe:measure_{name}")
        for name in ("well", "badly", "nothing")
    )
    monkeypatch.setattr(runner, "STUDIES", made)
    monkeypatch.setattr(catalogue, "STUDIES", made)
    return made


def test_every_study_can_be_found_and_stands_in_a_section():
    names = [study.name for study in catalogue.STUDIES]
    assert len(set(names)) == len(names)
    for study in catalogue.STUDIES:
        assert study.section in SECTIONS and callable(study.function()) and study.question


def test_a_failing_study_costs_no_other_and_everything_is_told(studies, tmp_path):
    report = run_studies(studies, tmp_path, Context(tmp_path, quick=True))
    assert {name: (r["failed"], r["skipped"]) for name, r in report["studies"].items()} == {
        "well": ([], []),
        "badly": (["the sky fell"], []),
        "nothing": ([], ["no such clip"]),
    }
    assert json.loads((tmp_path / "report.json").read_text()) == json.loads(json.dumps(report))
    with (tmp_path / "well" / "forms.csv").open() as file:
        assert [row["form"] for row in csv.DictReader(file)] == ["a", "b", "b"]


def test_what_is_done_is_not_done_again_and_a_stopped_study_goes_on(studies, tmp_path, monkeypatch):
    def stop(*_):
        if CALLS == ["first"]:
            raise Cancelled

    with pytest.raises(Cancelled):
        run_studies(studies[:1], tmp_path, Context(tmp_path), stop)
    run_studies(studies[:1], tmp_path, Context(tmp_path))
    run_studies(studies[:1], tmp_path, Context(tmp_path))
    assert CALLS == ["first", "second"]
    run_studies(studies[:1], tmp_path, Context(tmp_path, seed=1))
    assert CALLS == ["first", "second"] * 2


def test_what_was_missing_is_tried_again_and_old_code_is_named(studies, tmp_path, monkeypatch):
    run_studies(studies, tmp_path, Context(tmp_path))
    monkeypatch.setattr(runner, "digest_source", lambda: "changed")
    monkeypatch.setattr(sys.modules[__name__], "measure_nothing", measure_well)
    report = run_studies(studies, tmp_path, Context(tmp_path))
    assert report["studies"]["nothing"]["tables"] and not report["studies"]["badly"]["tables"]
    write_page(tmp_path / "index.html", report)
    cells = re.findall(r"<td[^>]*>(measured[^<]*|failed)</td>", (tmp_path / "index.html").read_text())
    assert cells == ["measured by other code", "failed", "measured"]


def test_the_page_shows_the_command_and_escapes_words(studies, tmp_path):
    report = run_studies(studies, tmp_path, Context(tmp_path, quick=True))
    write_page(tmp_path / "index.html", report)
    text = (tmp_path / "index.html").read_text()
    assert "f4x report -o DIR --only well --quick" in text and "half is 0.5" in text and "the sky fell" in text
    assert "speed &lt;against&gt; error" in text and text.count("<svg") == 1
    markdown = as_markdown(report["studies"].values())
    assert "| b | 2 | 1e-06 |" in markdown and "**Failed**: the sky fell" in markdown


def test_the_verb_ends_with_one_where_something_failed(studies, tmp_path, capsys):
    assert main(["report", "-o", str(tmp_path), "--quick", "--only", "well"]) == 0
    assert main(["report", "-o", str(tmp_path), "--quick", "--only", "badly", "--json"]) == 1
    assert json.loads(capsys.readouterr().out.splitlines()[-1])["failed"] == ["badly: the sky fell"]
    assert main(["report", "-o", str(tmp_path), "--only", "weather"]) == 2
    assert "studies: well, badly, nothing" in capsys.readouterr().err


def test_the_verb_tells_why_a_chosen_study_measured_nothing(studies, tmp_path, capsys):
    assert main(["report", "-o", str(tmp_path), "--only", "nothing"]) == 0
    assert ": not measured: no such clip\n" in capsys.readouterr().out
    assert main(["report", "-o", str(tmp_path), "--only", "well"]) == 0
    assert "not measured" not in capsys.readouterr().out


def test_the_documents_name_every_study():
    names = re.findall(r"`([\w-]+)`", (DOCS / "report.md").read_text(encoding="utf-8"))
    assert {study.name for study in catalogue.STUDIES} <= {*names}


def test_the_front_keeps_what_nothing_beats():
    assert pareto_front([(3, 1), (1, 3), (2, 2), (2, 4), (4, 1)]) == [1, 2, 0]


def test_times_come_with_their_quartiles():
    (row,) = time_rows(["nothing"], [lambda: None], 4)
    assert 0 <= row["time low (ms)"] <= row["time (ms)"] <= row["time high (ms)"] < 1000


def test_plain_data_survives_json():
    assert as_plain({"a": (1, float("inf")), 2: None}) == {"a": [1, "inf"], "2": None}
    assert [format_value(v) for v in (None, True, 0.000123456, 1234567, 123456.7)] == [
        "–",
        "yes",
        "0.0001235",
        "1,234,567",
        "123,457",
    ]


def test_real_clips_are_asked_for_in_one_sentence(tmp_path):
    with pytest.raises(MissingError, match="--clips DIR"):
        clip_studies.fit_clips(Context(tmp_path))


def test_the_page_of_results_is_what_its_data_say():
    page = PAGE.read_text(encoding="utf-8")
    assert page == results_page(RESULTS), "run `python3 scripts/dev.py results`"


def test_a_report_is_taken_over_into_the_results(studies, tmp_path):
    run_studies(studies, tmp_path / "report", Context(tmp_path, quick=True))
    publish(tmp_path / "results.md", tmp_path / "results", tmp_path / "report")
    assert [file.name for file in (tmp_path / "results").iterdir()] == ["well.json"]  # the others measured nothing
    assert "| b | 2 | 1e-06 |" in (tmp_path / "results.md").read_text()


def test_the_page_of_results_names_the_machine_of_each_study_where_there_were_several(studies, tmp_path):
    run_studies(studies, tmp_path / "report", Context(tmp_path, quick=True))
    publish(tmp_path / "results.md", tmp_path / "results", tmp_path / "report")
    file = tmp_path / "results" / "well.json"
    record = json.loads(file.read_text())
    here = record["machine"]["processor"]
    assert f"({here}, kernels" not in (tmp_path / "results.md").read_text()
    record |= {"name": "elsewhere", "machine": record["machine"] | {"processor": "Abacus", "kernels": "beads"}}
    file.with_stem("elsewhere").write_text(json.dumps(record))
    page = results_page(tmp_path / "results")
    assert (
        "(Abacus, kernels: beads)" in page and f"({here}, kernels: " in page and f"{here} (" in page.partition("##")[0]
    )


def test_clips_are_told_by_a_readers_names_and_goals():
    measured = {"frames": 50, "follow_iou_49": 0.9, "follow_iou_30": 0.8, "psnr_change": 0.0}
    row = clip_studies._named(measured, clip_studies.ASKED_FIGURES)
    assert (
        row["mask: IoU at the end"] == 0.9
        and row["mask: IoU after 30"] == 0.8
        and row["word: IoU of the selection"] is None
    )
    rows = [
        {"clip": name, "mask: IoU": iou, "mask: leakage": leakage}
        for name, iou, leakage in (("a", 0.8, 0.01), ("b", 0.7, 0.01), ("c", 0.9, 0.02))
    ]
    said = clip_studies._reached(rows, "mask")
    assert said.startswith("By a mask 1 of 3") and "b (IoU 0.70" in said and "c (IoU 0.90, leakage 0.020)" in said


def test_what_blender_measures_is_told_and_what_it_leaves_out(tmp_path, monkeypatch):
    measured = {
        "blender": "4.5.15 LTS",
        "import": {"seconds": 0.5, "gaussians": 200000},
        "query": {"left_out": "no words"},
    }
    monkeypatch.setattr(clip_studies, "_run", lambda _: measured)
    monkeypatch.setattr("importlib.util.find_spec", lambda _: True)
    found = clip_studies.measure_blender(Context(tmp_path))
    assert found.tables[0].title == "Blender 4.5.15 LTS as a Python module" and found.skipped == ["query: no words"]
    assert found.tables[0].rows[0] == {"what": "import", "figure": "seconds", "value": 0.5}


def test_a_rendered_clip_whose_model_is_not_here_costs_no_other(tmp_path, monkeypatch):
    def run(command):
        if "fox" in command:
            raise F4xError("synthetic_clip.py ended with 2: error: fox.glb is missing.")

    monkeypatch.setattr(clip_studies, "_run", run)
    monkeypatch.setattr(clip_studies, "_fit_rendered", lambda *_: {"time (s)": 1.0})
    found = clip_studies.fit_rendered(Context(tmp_path))
    rows = found.tables[0].rows
    assert [row["scene"] for row in rows] == [name for name in RENDERED.every if name != "fox" for _ in range(2)]
    assert {row["half"] for row in rows} == {"choosing", "judging"}
    (said,) = found.skipped
    assert said.startswith("fox: ") and "fox.glb is missing" in said


def test_a_step_that_does_not_say_who_measured_it_is_measured_again(tmp_path):
    context = Context(tmp_path, quick=True)
    assert context.step("one", lambda: 1) == 1 and context.step("one", lambda: 2) == 1
    (told_by,) = context.taken
    assert set(told_by) == {"source", "machine", "seconds"}
    file = tmp_path / "steps" / "one.json"
    record = json.loads(file.read_text())
    file.write_text(json.dumps({"settings": record["settings"], "result": 1}))
    assert context.step("one", lambda: 2) == 2
