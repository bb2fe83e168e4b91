"""Measured figures in README and docs are filled in from the results: doing so again changes nothing."""

import json
import re
from pathlib import Path

import pytest

from benchmarks.publication import DOCUMENTS, FIGURE, PAGE, RESULTS, fill_figures
from f4x_core.errors import F4xError

LINK = re.compile(r"\]\([^\s)]*results\.md#([\w-]+)")
PROBE = {
    "tables": [
        {
            "name": "times",
            "rows": [{"": "a word", "time (s)": 0.25412}, {"": "a picture", "time (s)": 12, "memory": "1 to 2"}],
        }
    ]
}


@pytest.mark.parametrize("page", DOCUMENTS, ids=lambda page: page.name)
def test_figures_are_those_of_the_results(page):
    text = page.read_text(encoding="utf-8")
    assert fill_figures(text, RESULTS) == text, "run `python3 scripts/dev.py results`"


def test_documents_show_figures_and_their_links_find_a_study():
    message = "\n".join(page.read_text(encoding="utf-8") for page in DOCUMENTS)
    assert sum(1 for _ in FIGURE.finditer(message)) >= 9
    names = set(re.findall(r'<a id="([\w-]+)">', PAGE.read_text(encoding="utf-8")))
    assert names == {file.stem for file in RESULTS.glob("*.json")}
    assert set(LINK.findall(message)) <= names | {"STUDY", "NAME"}


@pytest.fixture
def probe(tmp_path) -> Path:
    (tmp_path / "probe.json").write_text(json.dumps(PROBE))
    return tmp_path


def link(value: str, address: str, study: str = "probe") -> str:
    return f'It takes [{value}](docs/results.md#{study} "{address}") s, see [there](results.md#probe).'


@pytest.mark.parametrize(
    ("address", "value"),
    [
        ("times | a word | time (s)", "0.2541"),
        ("times | a picture | time (s)", "12"),
        ("times | a picture | memory", "1 to 2"),
    ],
)
def test_a_figure_becomes_its_cell_and_nothing_else_changes(probe, address, value):
    assert fill_figures(link("99", address), probe) == link(value, address)


@pytest.mark.parametrize(
    ("address", "study"),
    [
        ("times | a word | time (s)", "elsewhere"),
        ("times | a | time (s)", "probe"),
        ("times | nobody | time (s)", "probe"),
        ("times | a word | memory", "probe"),
        ("others | a word | time (s)", "probe"),
        ("times | a word", "probe"),
    ],
)
def test_a_figure_without_its_cell_is_one_sentence(probe, address, study):
    with pytest.raises(F4xError, match=f"results.md#{study}"):
        fill_figures(link("1", address, study), probe)
