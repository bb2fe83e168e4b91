"""Counts the lines that read English and the phrases in them, and what importing them costs: `python scripts/count_english.py`."""

from __future__ import annotations

import ast
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).parents[1]
ROOMS = {
    "edit": "clauses commands english language phrases refusals values which",
    "language": "*",
    "query": "cues people wording",
}
"""Room -> its files whose lines turn sentences into operations or questions."""
OPERATIONS = ROOT / "f4x_core" / "edit" / "operation"
"""Files of which `sentences` and what it calls, functions beside the class, read English."""
IMPORT = "import time; t = time.process_time(); import f4x_core.edit.plan; print(time.process_time() - t)"
PHRASES = """
import f4x_core.edit.plan, f4x_core.query.wording, gc
from f4x_core.language.grammar import _Table
tables = [one for one in gc.get_objects() if isinstance(one, _Table)]
print(len({id(phrase) for table in tables for row in table.rows.values() for phrase, _ in row}))
"""


def sentence_lines(file: Path) -> int:
    """Return the number of lines of the methods `sentences` and of the functions beside classes."""
    tree = ast.parse(file.read_text(encoding="utf-8"))
    functions = [node for node in tree.body if isinstance(node, ast.FunctionDef)]
    classes = [node for node in tree.body if isinstance(node, ast.ClassDef)]
    functions += [
        one for node in classes for one in node.body if isinstance(one, ast.FunctionDef) and one.name == "sentences"
    ]
    return sum((node.end_lineno or node.lineno) - node.lineno + 1 for node in functions)


def main() -> None:
    """Print a line for each room, their sum, the phrases and the seconds of processor of an import."""
    total = 0
    for room, names in ROOMS.items():
        files = [file for name in names.split() for file in (ROOT / "f4x_core" / room).glob(f"{name}.py")]
        lines = sum(len(file.read_text(encoding="utf-8").splitlines()) for file in files)
        total += lines
        print(f"{room}: {lines} lines in {len(files)} files")
    files = [*OPERATIONS.glob("*.py")]
    lines = sum(map(sentence_lines, files))
    total += lines
    print(f"edit/operation: {lines} lines of {len(files)} files")
    asked = [subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True, cwd=ROOT).stdout
             for code in (PHRASES, IMPORT)]  # fmt: skip
    print(
        f"all: {total} lines, {int(asked[0])} phrases, {float(asked[1]):.2f} s of processor to import what edits need"
    )


if __name__ == "__main__":
    main()
