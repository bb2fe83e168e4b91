"""Does a test notice when a formula is wrong? mutmut breaks one thing at a time, and tests that run it must fail.

`python3 scripts/dev.py mutants [ROOM …]` prints what survives; `f4x report --only mutations` records it. Drawn are mutants of
arithmetic alone: a number, an operator or a comparison of a function, none in an error's text. Constants of modules and what
C++ computes are not mutated.
"""

from __future__ import annotations

import ast
import difflib
import io
import json
import os
import random
import re
import shutil
import subprocess
import sys
import tempfile
import textwrap
import tokenize
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from functools import cache, partial
from importlib.util import find_spec
from pathlib import Path
from typing import Any, NamedTuple

from f4x_core.errors import F4xError

from ..study import Context, Findings, MissingError, Row, Table, read_json

ROOT = Path(__file__).resolve().parents[2]
"""Of a checkout, where the tests lie beside the package."""
COPIED = (
    *("f4x_core", "addon", "ground_truth", "benchmarks", "docs", "scripts", "tests", "tools"),
    *("pyproject.toml", "__init__.py", "README.md"),
)
ROOMS = ("fit", "gaussians", "scaffold", "priors", "query", "metrics", "windows")
"""Rooms in which a wrong formula makes a worse scene that nobody sees is wrong."""
DRAWN = 60
"""Mutants a room: at 5 % survivors the fraction is known to 3 % (one standard deviation)."""
MAX_SURVIVORS = 0.05
"""Fraction of the drawn mutants that may survive where it matters."""
ACCEPTED = Path(__file__).with_name("survivors.json")
"""Survivors that do not matter: file, change, kind, reason."""
KINDS = ("equivalent", "text", "speed")
WORDS = {"and", "or", "not", "in", "is", "True", "False"}
BRACKETS = {"(", ")"}
SURVIVED, UNTESTED = 0, 33
"""mutmut's exit codes of mutants that no test fails, and of those that no test runs; any other is a mutant that was noticed."""


@dataclass(frozen=True)
class Mutant:
    """One change of one function."""

    name: str
    """mutmut's."""
    file: str
    """Inside `f4x_core`."""
    before: str
    """The line that changes, without its indent."""
    after: str


class Rule(NamedTuple):
    """A kind of change that matters on no line. `<` for `<=` is none: whether the two can be equal each line decides."""

    before: str
    """Regular expression whose one group is what changes."""
    after: str
    """Regular expression of what the group becomes."""
    reason: str


RULES = (
    Rule(r"\bzip\(.*?\bstrict=(True)\)", "False", "checks lengths that are always equal"),
    Rule(
        r"\breshape\((?:[^()\[\]]|\([^()]*\)|\[[^\[\]]*\])*?(?<=[( ])(-1)(?=[,)])",
        "-2",
        "numpy takes any negative length for the one to find out, and torch none but -1",
    ),
    Rule(
        r"(?:\bseed=|[sS]eed\(|\bdefault_rng\()(\d+)(?=[,)])", r"\d+", "any fixed seed gives the same result every time"
    ),
)
"""Survivors of these kinds are equivalent, and `ACCEPTED` does not list them."""


def measure_mutations(context: Context) -> Findings:
    """Mutants of every room, drawn with the report's seed, and those that no test notices.

    Raises:
        MissingError: no checkout, or mutmut is not installed.
        F4xError: the tests do not pass on the unchanged source.
    """
    if not (ROOT / "tests" / "core").is_dir():
        raise MissingError("the tests come with the source code, not with the package.")
    if find_spec("mutmut") is None:
        raise MissingError("mutmut is not installed; `python3 scripts/dev.py mutants` brings it.")
    results = [context.step(room, partial(try_room, room, DRAWN, context.seed)) for room in ROOMS]
    return findings_of(results)


def findings_of(results: Sequence[Row]) -> Findings:
    """Return the tables of what `try_room` returned for some rooms."""
    survivors = [
        about_survivor(result["room"], Mutant(**mutant)) for result in results for mutant in result["survivors"]
    ]
    rows = []
    for result in results:
        own = [row for row in survivors if row["room"] == result["room"]]
        matter = sum(not row["kind"] for row in own)
        fraction = matter / result["drawn"] if result["drawn"] else 0.0
        noticed = result["drawn"] - len(own)
        counts = {"mutants of arithmetic": result["all"], "drawn": result["drawn"], "noticed": noticed}
        rows.append({"room": result["room"]} | counts | {"survive": len(own), "matter": matter, "share": fraction})
    drawn, found = sum(row["drawn"] for row in rows), sum(row["noticed"] for row in rows)
    words = [f"{found} of {drawn} mutants are noticed by a test of the everyday suite."]
    failed = [
        f"{row['room']}: {row['matter']} of {row['drawn']} mutants survive where it matters; write the tests that notice them"
        for row in rows
        if row["share"] > MAX_SURVIVORS
    ]
    note = "Drawn with a seed of all mutants of arithmetic in the room: a number, an operator or a comparison changed by mutmut."
    tables = [Table("rooms", rows, "Mutants by room", note=note)]
    if survivors:
        tables.append(Table("survivors", survivors, "Mutants that no test notices, and why that does not matter"))
    return Findings(tables, words=words, failed=failed)


def about_survivor(room: str, mutant: Mutant) -> Row:
    """Return the row of a mutant that survived; `kind` and `reason` are empty where it matters."""
    known = {(row["file"], row["before"], row["after"]): row for row in accepted()}
    row = known.get((mutant.file, mutant.before, mutant.after), {"kind": "", "reason": ""})
    rule = rule_of(mutant)
    reason = (row["kind"], row["reason"]) if rule is None else ("equivalent", rule.reason)
    change = {"before": mutant.before, "after": mutant.after}
    return {"room": room, "file": mutant.file} | change | dict(zip(("kind", "reason"), reason, strict=True))


def rule_of(mutant: Mutant) -> Rule | None:
    """Return the first rule whose kind of change is all that the mutant changes."""
    line = mutant.before
    for rule in RULES:
        for match in re.finditer(rule.before, line):
            start, end = match.span(1)
            if re.fullmatch(re.escape(line[:start]) + rule.after + re.escape(line[end:]), mutant.after):
                return rule
    return None


def accepted() -> list[dict[str, str]]:
    """Survivors that do not matter, as their file lists them."""
    return json.loads(ACCEPTED.read_text(encoding="utf-8"))


def try_room(room: str, count: int, seed: int, root: Path = ROOT) -> dict[str, Any]:
    """Draw mutants of a room and run the tests that reach them, in a copy of `root`.

    Args:
        room: package inside `f4x_core`.
        count: mutants at most.
        seed: of the draw.
        root: a checkout.

    Returns:
        `room`; `all`, how many mutants of arithmetic there are; `drawn`; and `survivors`, fields of `Mutant`.

    Raises:
        F4xError: no test imports the room, or its tests do not pass on the unchanged source.
    """
    with tempfile.TemporaryDirectory() as place:
        copy = copy_source(root, Path(place))
        configure(copy, room)
        found = arithmetic_mutants(copy, room)
        drawn = list(found)
        random.Random(seed).shuffle(drawn)  # unlike `sample`, more of them begin with the same ones
        drawn = drawn[:count]
        codes = run_mutmut(copy, room, drawn)
    survivors = [asdict(mutant) for mutant in drawn if codes[mutant.name] in (SURVIVED, UNTESTED)]
    return {"room": room, "all": len(found), "drawn": len(drawn), "survivors": survivors}


def copy_source(root: Path, place: Path) -> Path:
    """Return a copy of the checkout below `place`, where mutmut may write."""
    copy = place / "source"
    copy.mkdir()
    for name in COPIED:
        if (root / name).is_dir():
            shutil.copytree(root / name, copy / name, ignore=shutil.ignore_patterns("__pycache__"))
        elif (root / name).is_file():
            shutil.copy(root / name, copy / name)
    return copy


def configure(copy: Path, room: str) -> None:
    """Add to the `[tool.mutmut]` of the copy which room is mutated, and the test files that import it.

    Which of their tests reach which function mutmut finds out itself.
    """
    imports = re.compile(rf"^\s*(?:from|import) f4x_core\.{room}\b|^from f4x_core import .*\b{room}\b", re.MULTILINE)
    files = sorted((copy / "tests" / "core").glob("test_*.py"))
    tests = [str(file.relative_to(copy)) for file in files if imports.search(file.read_text(encoding="utf-8"))]
    if not (copy / "f4x_core" / room).is_dir() or not tests:
        raise F4xError(f"{room}: no folder of f4x_core that a file of tests/core imports; try {', '.join(ROOMS)}.")
    settings = {"only_mutate": [f"f4x_core/{room}/*"], "pytest_add_cli_args_test_selection": tests}
    lines = [f"{name} = {json.dumps(value)}" for name, value in settings.items()]
    file, head = copy / "pyproject.toml", "[tool.mutmut]\n"
    file.write_text(file.read_text(encoding="utf-8").replace(head, head + "\n".join(lines) + "\n"), encoding="utf-8")


def arithmetic_mutants(copy: Path, room: str) -> list[Mutant]:
    """Return all mutants of a room that change arithmetic, in the order of files and functions; mutmut keeps them in the copy."""
    steps = "makedirs('mutants'); copy_src_dir(); copy_also_copy_files(); create_mutants(cpu_count())"
    script = f"from os import cpu_count; from mutmut.__main__ import *; {steps}"  # what `mutmut run` begins with
    done = subprocess.run([sys.executable, "-c", script], cwd=copy, capture_output=True, text=True, check=False)
    if done.returncode:
        raise F4xError(f"{room}: mutmut made no mutants: {done.stderr[-300:]}")
    mutants = []
    for index in sorted((copy / "mutants" / "f4x_core" / room).rglob("*.spans")):
        file = index.with_suffix("")
        path = str(file.relative_to(copy / "mutants" / "f4x_core"))
        module = f"f4x_core.{path}".removesuffix(".py").replace(os.sep, ".").removesuffix(".__init__")
        lines = file.read_text(encoding="utf-8").splitlines()
        spans = read_json(index)["spans"].items()
        functions = {name: "\n".join(lines[start - 1 : end]) for name, (start, end) in spans}
        for name, text in functions.items():
            function, _, number = name.partition("__mutmut_")
            change = arithmetic_change(functions[f"{function}__mutmut_orig"], text) if number != "orig" else None
            if change is not None:
                mutants.append(Mutant(f"{module}.{name}", path, *change))
    return mutants


def arithmetic_change(before: str, after: str) -> tuple[str, str] | None:
    """Return the line of a function that differs, without indents; None where more differs than numbers and operators.

    Args:
        before: source of the function as mutmut copies it.
        after: of one mutant.
    """
    sources = (textwrap.dedent(text.strip("\n")) for text in (before, after))
    old, new = (re.sub(r"__mutmut_\w+", "", source, count=1).splitlines() for source in sources)
    changed = [index for index, (one, other) in enumerate(zip(old, new, strict=False)) if one != other]
    if len(old) != len(new) or len(changed) != 1 or changed[0] in lines_of_errors("\n".join(old)):
        return None
    one, other = old[changed[0]].strip(), new[changed[0]].strip()
    first, second = tokens(one), tokens(other)
    steps = difflib.SequenceMatcher(None, first, second, autojunk=False).get_opcodes()
    differ = [token for kind, a, b, c, d in steps if kind != "equal" for token in (*first[a:b], *second[c:d])]
    return (one, other) if differ and all(map(is_arithmetic, differ)) else None


def tokens(line: str) -> list[str]:
    """Python's tokens of a line, which may be a part of a statement."""
    found = []
    try:
        for token in tokenize.generate_tokens(io.StringIO(line).readline):
            found.append(token.string)
    except (tokenize.TokenError, IndentationError):  # a bracket that closes on another line
        pass
    return [token for token in found if token.strip()]


def is_arithmetic(token: str) -> bool:
    """Return True if a token is a number, an operator, a truth value or a bracket around one."""
    return token in WORDS | BRACKETS or re.fullmatch(r"[\d.][\w.+-]*|[-+*/%@&|^~<>=!]+", token) is not None


@cache
def lines_of_errors(function: str) -> set[int]:
    """Line numbers, from 0, of the `raise` statements and reports of progress in a function's source."""
    found: set[int] = set()
    for node in ast.walk(ast.parse(function)):
        reports = isinstance(node, ast.Call) and isinstance(node.func, ast.Name) and node.func.id == "progress"
        if isinstance(node, ast.Raise | ast.Call) and (reports or isinstance(node, ast.Raise)):
            found.update(range(node.lineno - 1, node.end_lineno or node.lineno))
    return found


def run_mutmut(copy: Path, room: str, mutants: Sequence[Mutant]) -> dict[str, int]:
    """mutmut's exit code of each mutant, by its name."""
    command = [sys.executable, "-m", "mutmut", "run", *(mutant.name for mutant in mutants)]
    # As many mutants at once as there are cores; what tests start themselves is to run the mutant too.
    environment = os.environ | {"OMP_NUM_THREADS": "1", "PYTHONPATH": str(copy / "mutants")}
    done = subprocess.run(command, cwd=copy, env=environment, capture_output=True, text=True, check=False)
    codes: dict[str, int] = {}
    for file in (copy / "mutants" / "f4x_core" / room).rglob("*.meta"):
        codes |= read_json(file)["exit_code_by_key"]
    missing = [mutant.name for mutant in mutants if codes.get(mutant.name) is None]
    if missing:
        errors = re.findall(r"^(?:FAILED|ERROR|\w*Error:) .*", done.stdout + done.stderr, re.MULTILINE)
        raise F4xError(f"{room}: mutmut did not try {len(missing)} mutants: {' '.join(errors[-3:])}")
    return codes


def main(rooms: Sequence[str]) -> int:
    """Try some rooms (none named: all) and print what survives; 1 where too much does."""
    try:
        findings = findings_of([try_room(room, DRAWN, 0) for room in rooms or ROOMS])
    except F4xError as error:
        sys.exit(str(error))
    for row in findings.tables[-1].rows if len(findings.tables) > 1 else ():
        print(
            f"{row['file']}\n  - {row['before']}\n  + {row['after']}\n    {row['kind'] or 'MATTERS'}: {row['reason']}"
        )
    print("\n".join([*findings.words, *findings.failed]))
    return int(bool(findings.failed))


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
