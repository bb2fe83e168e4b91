"""Measured figures in README and docs: the sentence links to its study in the results, whose data hold every number of it.

`docs/report.md` tells the rule to writers; `docs/results.md` itself is generated from the same data and needs no check.
"""

import json
import math
import re
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

import pytest

ROOT = Path(__file__).resolve().parents[2]
RESULTS = ROOT / "benchmarks" / "results"
PAGES = [ROOT / "README.md", *(page for page in sorted((ROOT / "docs").glob("*.md")) if page.name != "results.md")]

UNITS: dict[str, dict[str, float]] = {
    "time": {"ms": 1e-3, "s": 1, "second": 1, "min": 60, "minute": 60, "h": 3600, "hour": 3600},
    "memory": {"byte": 1, "B": 1, "kB": 1e3, "MB": 1e6, "GB": 1e9, "KiB": 2**10, "MiB": 2**20, "GiB": 2**30},
    "share": {"%": 0.01},
    "level": {"dB": 1},
    "length": {"px": 1, "pixel": 1},
    "rate": {"fps": 1},
    "angle": {"°": 1, "degree": 1},
    "count": {"times": 1, "Gaussian": 1},
}
"""What is measured -> unit -> its size; plurals are the same unit."""
KINDS = {unit: (kind, factor) for kind, units in UNITS.items() for unit, factor in units.items()}
WORDS = ("one", "two", "three", "four", "five", "six", "seven", "eight", "nine", "ten", "eleven", "twelve")

UNIT = r"(?:" + "|".join(sorted(map(re.escape, KINDS), key=len, reverse=True)) + r")s?(?![\w/])"
NUMBER = re.compile(
    r"(?<![\w.])(?<![A-Za-z]-)(?:\d{1,3}(?:,\d{3})+|\d+)?(?:(?<!\.)\.\d+|(?<=\d))(?:e[-+]?\d+)?k?(?!\w|[.,]?\d)"
)
JOINT = re.compile(r"(?:\s*(?:to|and|or|/|,|–|-|->|\+)\s*[-+]?\**|\s+[-+]?)$")
NAMES = re.compile(
    r"\b(?:Blender|Python|bpy|SAM|SmolVLM|OpenUSD|Depth Anything|table) V?\d[\d.]*(?: LTS)?(?: and [\d.]+)?"
)
"""Numbers that are part of a name."""

MEASURED = re.compile(
    r"\b[Mm]easured\b|\btook\b|\btak(?:es?|ing)\b[^;]*\d ?(?:seconds?|minutes?|hours?)|\d (?:ms|s|fps|dB)\b|(?<![\w.])\.\d"
    r"|PSNR|SSIM|IoU\b|\bAP\b|[Aa]verage precision|[Mm]emory\b.*\d [kMG]i?B|\bdiffers? by\b|\b(?:off|errs?) by\b"
    r"|\btimes as \w+|\bhalf as \w+ as\b|(?:\btimes|%) (?:less|more|(?:fast|slow|larg|small|long|short|quick)er)\b"
    r"|\b(?:one|two|four|\d+) (?:\w+ )?(?:cores?|threads?)\b|\bcore hours\b"
)
"""Words of a measurement: a number beside them is a measured one."""

EXCEPTIONS = {
    ("datasets.md", "SSIM as scikit-image's defaults"): "how a score is defined",
    ("datasets.md", "windows without any such pixel count as 1"): "how a score is defined",
    ("language.md", "20 % bigger, 20 % smaller"): "what words mean",
    ("language.md", "30 % faster, 30 % slower"): "what words mean",
}
"""(page, words of a sentence) that MEASURED finds -> why its numbers are no measurements."""

CODE = re.compile(r"`[^`]*`")
LINK = re.compile(r"\[([^\]]*)\]\(([^)\s]*)\)")


@dataclass(frozen=True)
class Number:
    """A number of a text, with what its unit says."""

    shown: str
    value: float
    half: float
    """Half of the last digit that is shown."""
    kind: str
    factor: float

    def held_by(self, other: "Number") -> bool:
        """Whether `other`, of a study's data, is this number at the precision shown."""
        if self.kind in ("time", "memory") and other.kind != self.kind:
            return False
        if self.kind and other.kind not in ("", self.kind):
            return False
        told = [other.value * other.factor / self.factor]
        if not self.kind:
            told = [other.value, other.value * (other.factor if other.kind == "share" else 1)]
        return any(abs(abs(value) - self.value) <= self.half * (1 + 1e-9) for value in told)


def kind_of(unit: str) -> tuple[str, float]:
    """What a unit measures, and its size; ("", 1) of none."""
    return KINDS.get(unit, KINDS.get(unit.removesuffix("s"), ("", 1.0)))


def unit_of(label: str) -> str:
    """The unit that a column, row or title ends with, in brackets or by itself: `time (ms)`, `minutes`."""
    found = re.search(rf"(?:\(|, |^)({UNIT})\)?$", label.strip())
    return found[1] if found else ""


def in_digits(text: str) -> str:
    """A text with "two minutes" as "2 minutes"."""
    words = rf"\b({'|'.join(WORDS)})(?= (?:(?:to|or) \w+ )?{UNIT})"
    text = re.sub(words, lambda match: str(WORDS.index(match[1].lower()) + 1), text, flags=re.I)
    return re.sub(r"\btwice as (?=long|large|fast|slow|\w+ as\b)", "2 times as ", text)


def numbers(text: str, unit: str = "") -> list[Number]:
    """The numbers of a text; one without a unit has that of the next in a list ("4 to 6 s"), else `unit`."""
    text = re.sub(r"(?<=\d)(?:\s*×\s*|x)(?=\d)", " x ", in_digits(text))
    found, after, start = [], unit, len(text)
    for match in reversed([*NUMBER.finditer(text)]):
        own = re.match(rf"[\s-]?({UNIT})", text[match.end() :])
        joined = JOINT.fullmatch(text[match.end() : start]) if start < len(text) else None
        after = own[1] if own else after if joined else unit
        start = match.start()
        shown = match[0]
        digits, _, exponent = shown.replace(",", "").removesuffix("k").partition("e")
        last = 10.0 ** -len(digits.partition(".")[2])
        if "." not in digits:  # 1,600 may be 1,587: two digits are shown at least
            last = 10.0 ** min(len(digits) - len(digits.rstrip("0")), max(len(digits) - 2, 0))
        scale = 10.0 ** int(exponent or 0) * (1000 if shown.endswith("k") else 1)
        found.append(Number(shown, float(digits) * scale, last * scale / 2, *kind_of(after)))
    return found[::-1]


@cache
def data_of(file: Path) -> tuple[Number, ...]:
    """Every number of a study: values of its tables with the unit of their column, row or table, and those of its words."""
    return tuple(numbers_of(json.loads(file.read_text(encoding="utf-8"))))


def numbers_of(record: dict[str, Any]) -> Iterator[Number]:
    """See `data_of`; `record` is the study as its file holds it."""
    words = [record["title"], record["question"], record["command"], *record["words"], *record["skipped"]]
    for table in record["tables"]:
        words += [table["title"], table["note"]]
        for row in table["rows"]:
            label = next((unit_of(cell) for cell in row.values() if isinstance(cell, str) and unit_of(cell)), "")
            for column, cell in row.items():
                unit = unit_of(column) or label or unit_of(table["title"]) or unit_of(record["title"])
                if isinstance(cell, str):
                    yield from numbers(cell, "" if unit_of(cell) else unit)
                elif isinstance(cell, (int, float)) and not isinstance(cell, bool) and math.isfinite(cell):
                    yield Number(str(cell), float(cell), 0.0, *kind_of(unit))
    for text in words:
        yield from numbers(text)


def sentences(page: str) -> Iterator[tuple[str, str]]:
    """Sentences of Markdown and what speaks for them as well: of paragraphs, list items and comments of code nothing, of
    rows of tables the paragraph before and the table's head."""
    before, head, block, code = "", "", "", False
    for line in [*page.splitlines(), ""]:
        text = line.strip()
        fence = text.startswith("```")
        row, heading = (text.startswith(mark) and not code for mark in "|#")
        if fence or code or row or heading or not text or re.match(r"(?:[*-]|\d+\.)\s", text):
            for sentence in re.split(r"(?<=[.!?])(?:\*\*|\)|\")?\s+(?=[\"*(\[`]*[A-Z`])", block):
                yield sentence, ""
            before, block = block or before, ""
        if not row:
            head = ""
        if fence:
            code = not code
        elif code:
            yield text.partition("#")[2], ""
        elif heading:
            yield text, ""
            before = ""
        elif row:
            head = head or f"{before} {text}"
            yield text, head
        else:
            block += f" {text}" if text else ""


def plain(text: str) -> str:
    """A text in digits, without where its links go, marks, and numbers that belong to names."""
    return in_digits(NAMES.sub("", LINK.sub(r"\1", text).replace("*", "").replace("`", "")))


def studies_of(text: str) -> set[str]:
    """Names of the studies that a text links to."""
    targets = [target.partition("#") for _, target in LINK.findall(CODE.sub("", text))]
    return {anchor for file, _, anchor in targets if file.endswith("results.md") and anchor}


def faults(
    page: str, name: str = "", results: Path = RESULTS, exceptions: Iterable[tuple[str, str]] = tuple(EXCEPTIONS)
) -> list[str]:
    """What breaks the rule, a sentence each."""
    found = []
    for sentence, context in sentences(page):
        files = [results / f"{study}.json" for study in sorted(studies_of(sentence + context))]
        found += [f"there is no {file.name}: {sentence}" for file in files if not file.exists()]
        if files:
            known = [number for file in files if file.exists() for number in data_of(file)]
            wrong = [number.shown for number in numbers(plain(sentence)) if not any(map(number.held_by, known))]
            found += [f"{number} is not in {' or '.join(file.name for file in files)}: {sentence}" for number in wrong]
            continue
        words = plain(CODE.sub("", sentence))
        measured = numbers(words) and MEASURED.search(f"{plain(CODE.sub('', context))} {words}")
        if measured and not any(page_of == name and part in sentence for page_of, part in exceptions):
            found.append(f"measured, and no link to results.md#STUDY: {sentence}")
    return found


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_measured_figures_are_those_of_the_results(page):
    assert faults(page.read_text(encoding="utf-8"), page.name) == []


@pytest.mark.parametrize(("page", "words"), EXCEPTIONS)
def test_every_exception_is_still_needed(page, words):
    text = (ROOT / "docs" / page).read_text(encoding="utf-8")
    others = [exception for exception in EXCEPTIONS if exception != (page, words)]
    (fault,) = faults(text, page, exceptions=others)
    assert words in fault


def test_links_into_the_results_find_their_study():
    page = (ROOT / "docs" / "results.md").read_text(encoding="utf-8")
    names = set(re.findall(r'<a id="([\w-]+)">', page))
    assert names == {file.stem for file in RESULTS.glob("*.json")}
    assert {target[1:] for _, target in LINK.findall(page) if target.startswith("#")} <= names


PROBE = {
    "title": "Probe",
    "question": "",
    "command": "f4x probe --count 12",
    "words": ["It took 7.4 to 8.4 s at 109,122 Gaussians; 90 % of them move."],
    "skipped": [],
    "tables": [
        {
            "title": "",
            "note": "",
            "rows": [
                {"": "a word", "time (ms)": 254.1, "share": 0.812, "memory": "1.5 GB", "minutes": "4.1", "rows": 1587},
                {"": "a picture (s)", "time (ms)": None, "RGB": "**31.9**, .13 – .15", "rmse": 1.4e-07},
            ],
        }
    ],
}


@pytest.fixture
def probe(tmp_path) -> Path:
    (tmp_path / "probe.json").write_text(json.dumps(PROBE))
    return tmp_path


TRUE = (
    "0.25 s | 254 ms | 0.2541 s | 81 % | .81 | 0.8 | 1,500 MB | 4.1 minutes | four minutes | 246 s | 1,600 rows | "
    "7 to 8 s | 8,400 ms | 0.9 of them | 109k Gaussians | 32 s | 0.13 to 0.15 s | 1.4e-7 | `--count 12` | Blender 4.5"
)
FALSE = (
    "0.26 s | 0.250 s | 254 s | 82 % | .82 | 8.1 % | 1.5 MB | 4.1 s | five minutes | 1,700 rows | 1,500 rows | "
    "7 to 9 s | 8,400 s | 0.91 of them | 108k Gaussians | 0.13 to 0.16 s | 1.4e-6 | `--count 13` | 31.9 ms | 2.5 times"
)


@pytest.mark.parametrize("figure", TRUE.split(" | "))
def test_a_figure_is_found_at_its_precision_and_in_other_units(probe, figure):
    assert faults(f"All of it takes {figure} here ([measured](results.md#probe)).", results=probe) == []


@pytest.mark.parametrize("figure", FALSE.split(" | "))
def test_a_wrong_figure_would_be_seen(probe, figure):
    told = f"It takes [{figure}](results.md#probe)."
    assert len(faults(told, results=probe)) == 1
    assert len(faults(f"Nothing here.\n\n* One.\n* {told}\n", results=probe)) == 1
    rows = f"| a | b |\n|---|---|\n| it | {figure} |"
    assert len(faults(f"[Measured](results.md#probe):\n\n{rows}\n", results=probe)) == 1


@pytest.mark.parametrize(
    "page",
    [
        "A word takes 0.25 s.",
        "A word takes\ntwo minutes. Another one is quick ([measured](results.md#probe)).",
        "Measured on two cores: 109,122 Gaussians.",
        "PSNR is 31.9.",
        "It is 2.5 times as fast.",
        "It is three times faster.",
        "It is twice as long.",
        "The click reaches .81.",
        "It needs memory: 1.5 GB.",
        "What it took:\n\n| what | how long |\n|---|---|\n| a word | 0.25 |",
        "| what | PSNR |\n|---|---|\n| a word | 31.9 |",
        "```bash\nf4x probe  # takes 4 minutes\n```",
        "It took 0.25 s ([measured](results.md)).",
        "It took long ([measured](results.md#elsewhere)).",
    ],
)
def test_a_figure_without_its_study_would_be_seen(probe, page):
    assert len(faults(page, results=probe)) == 1


@pytest.mark.parametrize(
    "page",
    [
        "Every 5 seconds a checkpoint goes to DIR, 16 selections are kept, weights are 99 MB.",
        '```json\n{"width": 480}\n```',
        "It takes long. The limit is 200 edits.",
        "Measured: [results](results.md).",
    ],
)
def test_settings_and_limits_need_no_study(probe, page):
    assert faults(page, results=probe) == []


def test_changed_figures_and_lost_links_would_be_seen_in_the_pages_themselves():
    """A copy of every sentence with a figure, each number changed in turn, then without its link."""
    told = [s for page in PAGES for s, _ in sentences(page.read_text(encoding="utf-8")) if studies_of(s)]
    told = [s for s in told if numbers(plain(CODE.sub("", s)))]
    assert told
    for sentence in told:
        for number in numbers(plain(sentence)):
            assert faults(sentence.replace(number.shown, "987654"))
    unlinked = [s.replace("results.md#", "elsewhere.md#") for s in told if MEASURED.search(plain(CODE.sub("", s)))]
    assert unlinked and all(map(faults, unlinked))
