"""The documentation, which comes with the extension: its Markdown pages as HTML in the browser, without a network."""

from __future__ import annotations

import html
import re
from pathlib import Path

import bpy

from ...f4x_core.errors import F4xError
from ..common.wording import Reporting

PAGES = Path(__file__).resolve().parents[2] / "docs"
"""Folder of the Markdown pages."""
FIRST = "blender"
"""The page that opens."""
_STYLE = (
    "body{font:16px/1.55 system-ui,sans-serif;max-width:52em;margin:2em auto;padding:0 1em;background:#1d1d1d;color:#ddd}"
    "a{color:#6fb3ff}code{background:#2d2d2d;padding:.1em .3em;border-radius:3px}pre{background:#2d2d2d;padding:.8em;overflow:auto}"
    "table{border-collapse:collapse}td,th{border:1px solid #444;padding:.3em .6em;text-align:left;vertical-align:top}"
)
_INLINE = (
    (r"!\[[^]]*\]\([^)]*\)", ""),  # pictures are not shipped
    (r"\*\*(.+?)\*\*", r"<b>\1</b>"),
    (r"(?<!\w)\*(\S.*?)\*", r"<i>\1</i>"),
)
_LINK = re.compile(r"\[([^]]*)\]\(([^)]*)\)")
_TITLE = re.compile(r"(\]\([^) ]*) \"[^\"]*\"\)")
"""The title of a link, which may hold what parts the cells of a table."""


def page_html(text: str, names: frozenset[str]) -> str:
    """Return a Markdown page of the documentation as HTML; links lead to the pages `names`, and others become plain words."""
    parts: list[str] = []
    for block in re.split(r"(```.*?```)", text, flags=re.DOTALL):
        if block.startswith("```"):
            parts.append(f"<pre>{html.escape(block.strip('`').partition(chr(10))[2])}</pre>")
        else:
            plain = _TITLE.sub(r"\1)", block)
            parts += [_block(lines, names) for lines in re.split(r"\n\s*\n", plain) if lines.strip()]
    return f"<!doctype html><meta charset=utf-8><title>Feature4X</title><style>{_STYLE}</style>" + "\n".join(parts)


def _block(text: str, names: frozenset[str]) -> str:
    """Return a heading, table, list or paragraph."""
    lines = text.strip("\n").splitlines()
    heading = re.match(r"(#+) (.*)", lines[0])
    if heading:
        level, title = len(heading[1]), heading[2]
        rest = _block("\n".join(lines[1:]), names) if lines[1:] else ""
        anchor = re.sub(r"[^\w -]", "", title.lower()).replace(" ", "-")
        return f'<h{level} id="{anchor}">{_words(title, names)}</h{level}>{rest}'
    if lines[0].startswith("|"):
        rows = [
            line.strip().strip("|").split(" | ")
            for line in lines
            if not re.fullmatch(r"[|\s:-]+", line) or line is lines[0]
        ]
        cells = ("".join(f"<td>{_words(cell.strip(), names)}</td>" for cell in row) for row in rows)
        return "<table>" + "".join(f"<tr>{row}</tr>" for row in cells) + "</table>"
    items = re.split(r"^(?:\* |\d+\. )", "\n".join(lines), flags=re.MULTILINE)
    before = f"<p>{_words(items[0], names)}</p>" if items[0].strip() else ""
    listed = "".join(f"<li>{_words(item, names)}</li>" for item in items[1:])
    return before + (f"<ul>{listed}</ul>" if listed else "")


def _words(text: str, names: frozenset[str]) -> str:
    """Return a line of Markdown as HTML: code, links, bold and italic words; links to pages not in `names` become words."""

    def link(found: re.Match[str]) -> str:
        page, _, anchor = found[2].partition("#")
        if page.startswith("http"):
            return f'<a href="{found[2]}">{found[1]}</a>'
        if page and page.removesuffix(".md") not in names:
            return found[1]
        return f'<a href="{page.removesuffix(".md") + ".html" if page else ""}{"#" + anchor if anchor else ""}">{found[1]}</a>'

    codes: list[str] = []

    def set_aside(found: re.Match[str]) -> str:
        codes.append(f"<code>{html.escape(found[1])}</code>")
        return f"\0{len(codes) - 1}\0"

    text = html.escape(re.sub(r"`([^`]*)`", set_aside, text), quote=False)
    for pattern, words in _INLINE:
        text = re.sub(pattern, words, text)
    return re.sub(r"\0(\d+)\0", lambda found: codes[int(found[1])], _LINK.sub(link, text))


def write_pages(folder: Path) -> Path:
    """Write all pages as HTML into `folder`; returns the first one. Raises F4xError where the extension came without them."""
    sources = sorted(PAGES.glob("*.md"))
    if not (PAGES / f"{FIRST}.md").exists():
        raise F4xError(f"{PAGES} has no {FIRST}.md; install the extension again.")
    names = frozenset(source.stem for source in sources)
    folder.mkdir(parents=True, exist_ok=True)
    for source in sources:
        (folder / f"{source.stem}.html").write_text(
            page_html(source.read_text(encoding="utf-8"), names), encoding="utf-8"
        )
    return folder / f"{FIRST}.html"


class F4X_OT_documentation(Reporting, bpy.types.Operator):  # noqa: N801 - Blender wants this form
    """Open the documentation of Feature4X in the browser. It came with the extension and needs no network."""

    bl_idname, bl_label = "f4x.documentation", "Documentation"

    def execute(self, context):
        """Write the pages and open the one about Blender."""
        page = write_pages(Path(bpy.app.tempdir) / "feature4x_documentation")
        bpy.ops.wm.url_open(url=page.as_uri())
        return {"FINISHED"}


CLASSES = (F4X_OT_documentation,)
