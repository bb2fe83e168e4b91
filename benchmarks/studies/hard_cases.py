"""The catalogue of hard cases: small documented files that say what is hard and check that the program stands it.

A file `NAME.py` of the catalogue has a docstring in a fixed layout - a title, then `Hard:`, `Why:` and `Must hold:`, each a
paragraph -, a constant `STAGE`, and a function `check() -> Iterable[Check]`. `SLOW = True` marks one of many seconds,
`LONG = True` one of minutes. Files of the folder import what they share from its packages, relatively.
"""

from __future__ import annotations

import re
import sys
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from hashlib import sha256
from importlib import import_module
from importlib.util import module_from_spec, spec_from_file_location
from pathlib import Path
from types import ModuleType
from typing import Literal

from f4x_core.errors import F4xError

Outcome = Literal["right", "told", "refused", "known limit", "wrong"]
"""Result of a case: the right answer; a wrong one, with the reason said; no answer but a sentence; a wrong one that the
catalogue expects; or a wrong answer without a word."""
OUTCOMES: tuple[Outcome, ...] = ("right", "told", "refused", "known limit", "wrong")
STAGES = ("raster", "deformation", "scaffold", "losses", "priors", "clip", "scene", "query", "fit")
LAYOUT = re.compile(
    r"\s*(?P<title>[^\n]+)\.\n\s*\nHard: (?P<hard>.+?)\n\s*\nWhy: (?P<why>.+?)\n\s*\nMust hold: (?P<must>.+?)\s*", re.S
)


@dataclass(frozen=True)
class Check:
    """One thing that was tried, and what came of it."""

    what: str
    """Statement that must hold."""
    outcome: Outcome
    by: str = ""
    """Backend or form that was tried."""
    error: float | None = None
    """Distance from the truth, relative unless `what` names a unit."""
    allowed: float | None = None
    """The most it may be."""
    message: str = ""
    """The program's own words."""


def within(what: str, error: float, allowed: float, by: str = "") -> Check:
    """An error that may be at most `allowed`; NaN is wrong."""
    error = float(error)
    return Check(what, "right" if error <= allowed else "wrong", by, error, allowed)


def that(what: str, holds: object, by: str = "") -> Check:
    """A plain yes or no."""
    return Check(what, "right" if holds else "wrong", by)


def reported(what: str, pattern: str, sentences: Iterable[str], by: str = "") -> Check:
    """One of the program's sentences names the cause: a match of the regular expression."""
    found = [text for text in sentences if re.search(pattern, text)]
    return Check(what, "told" if found else "wrong", by, message=found[0] if found else f"nothing about {pattern!r}")


def refused(what: str, pattern: str, work: Callable[[], object], by: str = "") -> Check:
    """`work` raises an F4xError whose sentence names the cause."""
    try:
        work()
    except F4xError as reason:
        named = re.search(pattern, str(reason)) is not None
        return Check(what, "refused" if named else "wrong", by, message=str(reason))
    return Check(what, "wrong", by, message="it was not refused")


def limited(what: str, as_expected: object, sentence: str, by: str = "") -> Check:
    """A known limit: the answer is not right, in just the way that `sentence` says."""
    return Check(what, "known limit" if as_expected else "wrong", by, message=sentence)


@dataclass(frozen=True)
class Case:
    """One file of the catalogue."""

    name: str
    stage: str
    title: str
    hard: str
    """Difficulty of the case."""
    why: str
    """Failure of programs that take no care."""
    must: str
    """Statement that must hold."""
    slow: bool
    long: bool
    """Minutes: a quick report leaves it out."""
    digest: str
    """Of the file: a changed case is tried again."""
    check: Callable[[], Iterable[Check]]

    def outcome(self, checks: Iterable[Check]) -> Outcome:
        """Return the worst of its checks."""
        return max((check.outcome for check in checks), key=OUTCOMES.index, default="wrong")


def run_case(case: Case) -> list[Check]:
    """Its checks; what it raises is a wrong answer with the exception's words."""
    try:
        return list(case.check())
    except Exception as error:  # whatever a broken case raises, the others are still of interest
        return [Check("runs to its end", "wrong", message=f"{type(error).__name__}: {error}")]


def load_cases(folder: Path) -> list[Case]:
    """Return every case of a catalogue folder, by stage, then name.

    Raises:
        F4xError: a file that is not laid out as a case.
    """
    package = _package(folder)
    names = sorted(file.stem for file in folder.glob("*.py") if file.stem != "__init__")
    cases = [_case(folder / f"{name}.py", import_module(f"{package}.{name}")) for name in names]
    return sorted(cases, key=lambda case: STAGES.index(case.stage))


def _package(folder: Path) -> str:
    """Name under which the folder can be imported; of its own, so that two catalogues do not meet."""
    name = "f4x_hard_cases_" + sha256(str(folder.resolve()).encode()).hexdigest()[:8]
    if name not in sys.modules:
        spec = spec_from_file_location(name, folder / "__init__.py", submodule_search_locations=[str(folder)])
        if spec is None or spec.loader is None or not (folder / "__init__.py").is_file():
            raise F4xError(f"{folder}: is no catalogue of hard cases (it has no __init__.py); give --cases DIR.")
        sys.modules[name] = module_from_spec(spec)
        spec.loader.exec_module(sys.modules[name])
    return name


def _case(file: Path, module: ModuleType) -> Case:
    laid_out = LAYOUT.fullmatch(module.__doc__ or "")
    stage = getattr(module, "STAGE", None)
    if laid_out is None or stage not in STAGES or not callable(getattr(module, "check", None)):
        raise F4xError(
            f"{file}: is not laid out as a hard case; it needs a docstring with a title, 'Hard:', 'Why:' and 'Must hold:',"
            f" a STAGE of {', '.join(STAGES)}, and a function check()."
        )
    words = {name: " ".join(text.split()) for name, text in laid_out.groupdict().items()}
    digest = sha256(file.read_bytes()).hexdigest()[:16]
    slow, long = (getattr(module, name, False) for name in ("SLOW", "LONG"))
    return Case(file.stem, stage, **words, slow=slow, long=long, digest=digest, check=module.check)
