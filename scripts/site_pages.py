"""Pages of the documentation site that come from the code: the codes of errors, every sentence, and an API page for each room.

Writes docs/troubleshooting.md, and what is not kept into the folder that mkdocs reads: python scripts/site_pages.py FOLDER
"""

import ast
import re
import shutil
import sys
from pathlib import Path

from f4x_core.troubles import TROUBLES, code_of_module

ROOT = Path(__file__).resolve().parents[1]
DOCS = ROOT / "docs"
TROUBLESHOOTING = DOCS / "troubleshooting.md"
ERRORS = ("F4xError", "Refusal", "Absent", "ChatError", "Unanswerable", "MissingError")
"""Exceptions whose sentence a user reads."""
HEAD = """# Troubleshooting

Every error ends with a code in brackets: `… give more frames. [F4X-CLIP]`. The sentence says which file is meant and what to do in
this case; the line here says what all errors of the family have in common. `f4x doctor F4X-CLIP` prints it without this page.

If that does not help, open an issue with what `f4x doctor --report` prints (with `--scene my_scene/scene.f4x` where a scene is
concerned): versions, backends and numbers, without paths and names.

A scene that came out poor is no error: open its `diagnostics.html`, and see [which clips work](which_clips.md).

| code | what is wrong | what helps |
|---|---|---|
"""


def troubleshooting() -> str:
    """Return the page of all codes."""
    return HEAD + "".join(f"| `{each.code}` | {each.cause} | {linked(each.cure)} |\n" for each in TROUBLES)


def linked(text: str) -> str:
    """Return the text with the names of documents as links to them."""
    return re.sub(r"docs/((\w+)\.md)", r"[\2](\1)", text)


def sentences_of(tree: ast.AST) -> list[str]:
    """Return the sentences of the errors that are raised below `tree`, an ellipsis for what is filled in."""
    raised = (node.exc for node in ast.walk(tree) if isinstance(node, ast.Raise))
    calls = [call for call in raised if isinstance(call, ast.Call) and isinstance(call.func, ast.Name) and call.args]
    found = [text_of(call.args[0]) for call in calls if call.func.id in ERRORS]  # type: ignore[attr-defined]
    return [sentence for sentence in found if re.search(r"\w{3}", sentence)]


def text_of(node: ast.expr) -> str:
    """Return the text of a string, formatted string or sum of them; an ellipsis for everything else."""
    if isinstance(node, ast.Constant):
        return str(node.value)
    if isinstance(node, ast.JoinedStr):
        return "".join(text_of(part) for part in node.values)
    if isinstance(node, ast.BinOp) and isinstance(node.op, ast.Add):
        return text_of(node.left) + text_of(node.right)
    return "…"


def every_sentence() -> str:
    """Return a page with each sentence under its code, to be found by the words of a message."""
    by_code: dict[str, set[str]] = {}
    for folder in ("f4x_core", "addon", "ground_truth"):
        for file in (ROOT / folder).rglob("*.py"):
            code = code_of_module(module_of(file))
            by_code.setdefault(code, set()).update(sentences_of(ast.parse(file.read_text(encoding="utf-8"))))
    parts = ["# Every message\n\nGenerated from the code; … stands for a name, number or reason.\n"]
    for each in TROUBLES:
        lines = "".join(f"* `{sentence.replace('`', chr(39))}`\n" for sentence in sorted(by_code.get(each.code, ())))
        parts.append(f"## {each.code}\n\n{each.cause} {linked(each.cure)}\n\n{lines}")
    return "\n".join(parts)


def module_of(file: Path) -> str:
    """Return the dotted name of a file of the repository."""
    return ".".join(file.relative_to(ROOT).with_suffix("").parts).removesuffix(".__init__")


def api_pages() -> dict[str, str]:
    """Return page -> text, for the public API and every room of the core; mkdocstrings fills them from the docstrings."""
    modules = sorted(module_of(file) for file in (ROOT / "f4x_core").rglob("*.py") if file.name != "__main__.py")
    pages: dict[str, list[str]] = {}
    for module in modules:
        room = module.split(".")[1] if "." in module else "f4x_core"
        pages.setdefault(room, []).append(f"## {module}\n\n::: {module}\n    options:\n      heading_level: 3\n")
    texts = {f"api/{room}.md": f"# {room}\n\n" + "\n".join(parts) for room, parts in pages.items()}
    links = "\n".join(f"* [{room}]({room}.md)" for room in pages)
    texts["api/index.md"] = (
        f"# API\n\nFrom the docstrings; [programs](../python.md) need the names of `f4x_core` alone.\n\n{links}\n"
    )
    return texts


def main() -> int:
    """Write the kept page, and a folder with all pages for mkdocs."""
    TROUBLESHOOTING.write_text(troubleshooting(), encoding="utf-8")
    folder = Path(sys.argv[1])
    shutil.rmtree(folder, ignore_errors=True)
    shutil.copytree(DOCS, folder)
    for name, text in {"messages.md": every_sentence(), **api_pages()}.items():
        (folder / name).parent.mkdir(exist_ok=True)
        (folder / name).write_text(text, encoding="utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main())
