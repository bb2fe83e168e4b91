"""HTML pages that are one file: tables, pictures and plots inside, light and dark."""

from __future__ import annotations

import base64
import html
import io
import re
from collections.abc import Iterable, Sequence
from typing import Any

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_svg import FigureCanvasSVG
from matplotlib.figure import Figure
from PIL import Image

# Pictures are shrunk to this width (pixels) so that the page stays small enough to send by mail.
PICTURE_WIDTH, JPEG_QUALITY = 320, 82
# Written into plots in place of a colour and replaced by the page's text colour, which follows light and dark.
TEXT_COLOUR = "#010203"
# A legend of more entries covers what it explains; and how much a row of one below the plot takes.
ENTRIES_INSIDE, ENTRY_INCHES = 3, 0.2
# A cell that holds a number, with or without a unit, or nothing.
NUMBER = re.compile(r"[-+]?[\d.]|–?$")
# Legible on white and on black.
TEAL, ORANGE, VIOLET, GREY = "#1f9e8f", "#e07a3f", "#8d7fe0", "#8a8f98"

STYLE = """
:root { color-scheme: light dark; --line: #8886; --soft: #8882; --bad: #d9534f; --fine: #1f9e8f; }
body { font: 15px/1.5 system-ui, sans-serif; max-width: 1080px; margin: 2em auto; padding: 0 1em; }
body { background: #fff; color: #1c2026; }
@media (prefers-color-scheme: dark) { body { background: #14171c; color: #dfe3e8; } }
h1 { font-size: 1.5em; margin-bottom: 0; } h2 { font-size: 1.15em; margin: 2em 0 .5em; border-bottom: 1px solid var(--line); }
h3 { font-size: 1em; margin: 1.2em 0 .3em; }
.verdict { font-size: 1.15em; margin: .3em 0 1em; }
.finding { border-left: 4px solid var(--line); padding: .2em .8em; margin: .5em 0; background: var(--soft); }
.problem { border-color: var(--bad); } .good { border-color: var(--fine); }
.advice::before { content: "→ "; } .dim { opacity: .7; font-size: .9em; }
table { border-collapse: collapse; width: 100%; } td, th { text-align: left; padding: .25em .7em .25em 0; vertical-align: top; }
tr + tr { border-top: 1px solid var(--soft); } td.number, th.number { text-align: right; font-variant-numeric: tabular-nums; }
.row { display: flex; flex-wrap: wrap; gap: 8px; align-items: flex-start; }
.row figure { margin: 0; flex: 1 1 30%; max-width: 352px; }
.row.four figure { flex-basis: 23%; max-width: 262px; }
.plots > div { flex: 1 1 45%; min-width: 300px; max-width: 536px; } img, svg { width: 100%; height: auto; display: block; }
details { overflow-x: auto; } td.number { white-space: nowrap; }
figcaption { font-size: .8em; opacity: .75; } pre { overflow: auto; font-size: .8em; } summary { cursor: pointer; }
"""


def document(title: str, body: Sequence[str]) -> bytes:
    """Return the whole file: `title` (escaped here) and the HTML of its parts."""
    name = html.escape(title)
    lines = [
        '<!doctype html><html lang="en"><head><meta charset="utf-8">',
        f'<meta name="viewport" content="width=device-width, initial-scale=1"><title>{name} – Feature4X</title>',
        f"<style>{STYLE}</style></head><body><h1>{name}</h1>",
        *body,
        "</body></html>\n",
    ]
    return "\n".join(lines).encode(errors="backslashreplace")  # a file's name may be no UTF-8


def section(title: str, content: str) -> str:
    """Return a titled part of the page, or nothing where there is no content."""
    return f"<section><h2>{html.escape(title)}</h2>{content}</section>\n" if content else ""


def table(head: Sequence[str], rows: Iterable[Sequence[str]], numbers: bool = False) -> str:
    """Return a table of escaped cells; with `numbers`, columns that hold nothing but numbers are set right, the first never."""
    rows = list(rows)
    columns = list(zip(*rows, strict=True))[1:] if numbers else []
    right = {place for place, column in enumerate(columns, start=1) if all(map(NUMBER.match, column))}

    def cells(row: Sequence[str], tag: str) -> str:
        kinds = [' class="number"' if place in right else "" for place in range(len(row))]
        return "".join(f"<{tag}{kind}>{html.escape(cell)}</{tag}>" for kind, cell in zip(kinds, row, strict=True))

    lines = [f"<tr>{cells(head, 'th')}</tr>", *(f"<tr>{cells(row, 'td')}</tr>" for row in rows)]
    return f"<table>{''.join(lines)}</table>"


def image_figure(pixels: np.ndarray, caption: str) -> str:
    """Return a figure with a JPEG inside; `pixels` (H,W,3) uint8 or float in [0,1]."""
    image = Image.fromarray(as_bytes(pixels))
    if image.width > PICTURE_WIDTH:
        image = image.resize(
            (PICTURE_WIDTH, max(1, round(image.height * PICTURE_WIDTH / image.width))), Image.Resampling.BOX
        )
    buffer = io.BytesIO()
    image.save(buffer, "JPEG", quality=JPEG_QUALITY)
    data = base64.b64encode(buffer.getvalue()).decode()
    label = html.escape(caption)
    return f'<figure><img alt="{label}" src="data:image/jpeg;base64,{data}"><figcaption>{label}</figcaption></figure>'


def row(figures: Iterable[str], four: bool = False) -> str:
    """Return the figures side by side, three to a line of a wide window or `four`."""
    content = "".join(figures)
    return f'<div class="row{" four" if four else ""}">{content}</div>' if content else ""


def as_bytes(pixels: np.ndarray) -> np.ndarray:
    """Return the colours as uint8; floats are in [0,1]."""
    return pixels if pixels.dtype == np.uint8 else (np.clip(pixels, 0, 1) * 255 + 0.5).astype(np.uint8)


def plots(drawings: Iterable[str]) -> str:
    """Return the plots side by side, without the empty ones."""
    content = "".join(f"<div>{drawing}</div>" for drawing in drawings if drawing)
    return f'<div class="row plots">{content}</div>' if content else ""


def plot(title: str, across: str, up: str, columns: int = 1, height: float = 2.7) -> tuple[Figure, list[Axes]]:
    """Return a figure in the page's text colour; every axes object is labelled alike."""
    figure = Figure(figsize=(5.2, height), layout="constrained")
    axes = [figure.add_subplot(1, columns, column + 1) for column in range(columns)]
    for axis in axes:
        axis.set_xlabel(across)
        axis.set_ylabel(up)
        axis.set_title(title, fontsize=10, color=TEXT_COLOUR)
        axis.tick_params(which="both", colors=TEXT_COLOUR, labelsize=8)
        axis.patch.set_alpha(0)
        axis.grid(True, color=GREY, alpha=0.25, linewidth=0.6)
        for label in (axis.xaxis.label, axis.yaxis.label):
            label.set_color(TEXT_COLOUR)
            label.set_fontsize(9)
        for name, spine in axis.spines.items():
            spine.set_visible(name in ("left", "bottom"))
            spine.set_color(GREY)
    return figure, axes


def legend(axis: Axes) -> None:
    """Draw a legend in the page's text color; one of many entries stands below a plot that grows by it."""
    entries = len(axis.get_legend_handles_labels()[1])
    below: dict[str, Any] = {}
    if entries > ENTRIES_INSIDE:
        rows = -(-entries // 2)
        canvas = axis.get_figure(root=True)
        assert isinstance(canvas, Figure)
        canvas.set_figheight(canvas.get_figheight() + ENTRY_INCHES * rows)
        below = {"loc": "upper center", "bbox_to_anchor": (0.5, -0.18), "ncols": 2}
    axis.legend(fontsize=8, frameon=False, labelcolor=TEXT_COLOUR, **below)


def svg(figure: Figure) -> str:
    """Return the figure as inline SVG whose text follows the page's colour."""
    buffer = io.StringIO()
    figure.patch.set_alpha(0)
    with matplotlib.rc_context({"svg.fonttype": "none", "font.family": "sans-serif"}):
        # `Figure.savefig` would draw everything once more before this, only to place it.
        FigureCanvasSVG(figure).print_svg(buffer, metadata={"Date": None})
    text = buffer.getvalue()
    return text[text.index("<svg") :].replace(TEXT_COLOUR, "currentColor")
