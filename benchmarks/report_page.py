"""The report as one HTML page: every figure with the command that measured it, and as Markdown."""

from __future__ import annotations

import html
import math
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

from matplotlib.axes import Axes
from matplotlib.ticker import LogLocator, NullFormatter

from f4x_core import page
from f4x_core.files import replace_file

from .study import SECTIONS, pareto_front, span_columns

COLOURS = (page.TEAL, page.ORANGE, page.VIOLET, "#c94f6d", "#4f8fd0", "#b59a2d", "#6aa84f", page.GREY)
MARKERS = "osD^vP*X"
FEW_ROWS, MANY_ROWS = 24, 100
"""Longer tables are folded up, and in Markdown, beyond the second, their data are linked alone."""
Record = Mapping[str, Any]
"""A study as `study.json` holds it."""


def write_page(file: Path, report: Mapping[str, Any]) -> None:
    """Write the page atomically.

    Args:
        file: the HTML file.
        report: as `runner.gather` returns it.
    """
    studies: Mapping[str, Record] = report["studies"]
    body = [
        f'<p class="dim">{html.escape(_machine_words(report["machine"]))}</p>',
        _overview(studies, report["source"]),
    ]
    for key, title in SECTIONS.items():
        parts = [_study(record) for record in studies.values() if record["section"] == key]
        body.append(page.section(title, "".join(parts)))
    with replace_file(file) as out:
        out.write(page.document("Speed against error, hard cases, needs", body))


def as_markdown(studies: Iterable[Record], level: int = 3, machines: bool = False) -> str:
    """Studies as Markdown: question, tables, what was found, the command; links reach a study by its name (`#NAME`).

    With `machines`, the processor and its kernels stand behind the command: for pages whose studies ran on several.
    """
    parts = []
    for record in studies:
        parts.append(f'<a id="{record["name"]}"></a>\n')  # titles change, names do not
        asked = [record["question"], f"`{record['command']}`" if record["command"] else ""]
        asked += [f"({record['machine']['processor']}, kernels: {record['machine']['kernels']})"] if machines else []
        parts.append(
            "\n\n".join(filter(None, [f"{'#' * level} {record['title']}", " ".join(filter(None, asked))])) + "\n"
        )
        parts += [_markdown_table(table, record["name"]) for table in record["tables"] if table["rows"]]
        notes = [*record["words"], *(f"**Failed**: {text}" for text in record["failed"])]
        notes += [f"Not measured: {text}" for text in record["skipped"]]
        if notes:
            parts.append("\n".join(f"* {text}" for text in notes) + "\n")
    return "\n".join(parts)


def format_value(value: Any) -> str:
    """Return a cell: four significant digits, a dash for nothing."""
    if value is None:
        return "–"
    if isinstance(value, bool):
        return "yes" if value else "no"
    if isinstance(value, float):
        return f"{value:.4g}" if abs(value) < 1e5 else f"{value:,.0f}"
    return f"{value:,}" if isinstance(value, int) else str(value)


def _machine_words(machine: Mapping[str, Any]) -> str:
    words = [f"{machine['processor']}, {machine['cores']} cores, {machine['system']}"]
    words += [f"{name} {machine[name]}" for name in ("python", "numpy", "torch", "feature4x", "kernels")]
    return " · ".join(words)


def _state(record: Record, source: str) -> str:
    """One word or two for the overview; `source` is the code of today."""
    if record["failed"]:
        return "failed"
    if not record["tables"]:
        return "not measured"
    return "measured" if record.get("source") == source else "measured by other code"


def _overview(studies: Mapping[str, Record], source: str) -> str:
    """Table of failed and missing studies."""
    rows = []
    for record in studies.values():
        state = _state(record, source)
        rows.append(
            [
                record["title"],
                state,
                f"{record['seconds']:.0f}\u00a0s",
                "; ".join([*record["failed"], *record["skipped"]]),
            ]
        )
    return page.section("Overview", page.table(["", "", "took", "left out or failed, and why"], rows))


def _study(record: Record) -> str:
    tables = {table["name"]: table for table in record["tables"]}
    drawings = [_drawing(figure, tables[figure["table"]]["rows"]) for figure in record["figures"]]
    parts = [f"<h3>{html.escape(record['title'])}</h3><p>{html.escape(record['question'])}</p>"]
    parts += [f'<div class="finding good">{html.escape(text)}</div>' for text in record["words"]]
    parts += [f'<div class="finding problem">{html.escape(text)}</div>' for text in record["failed"]]
    parts += [f'<div class="finding">not measured: {html.escape(text)}</div>' for text in record["skipped"]]
    parts.append(page.plots(drawings))
    parts += [_table(table) for table in record["tables"] if table["rows"]]
    other = f", measured on {record['machine']['processor']}" if "processor" in record.get("machine", {}) else ""
    parts.append(f'<p class="dim"><code>{html.escape(record["command"])}</code>{html.escape(other)}</p>')
    return "".join(parts)


def _columns(rows: Sequence[Mapping[str, Any]]) -> list[str]:
    return list(dict.fromkeys(column for row in rows for column in row))


def _table(table: Record) -> str:
    columns = _columns(table["rows"])
    cells = [[format_value(row.get(column)) for column in columns] for row in table["rows"]]
    words = "".join(f'<p class="dim">{html.escape(text)}</p>' for text in (table["note"],) if text)
    head = f"<summary>{html.escape(table['title'] or table['name'])} ({len(cells)} rows)</summary>"
    state = " open" if len(cells) <= FEW_ROWS else ""
    return f"<details{state}>{head}{page.table(columns, cells, numbers=True)}{words}</details>"


def _markdown_table(table: Record, study: str) -> str:
    parts = [f"{table['title']}\n"] if table["title"] else []
    count, data = len(table["rows"]), f"[{study}.json](../benchmarks/results/{study}.json)"
    rows = [_with_spans(row) for row in table["rows"]]
    columns = [column for column in _columns(rows) if any(row.get(column) not in (None, "") for row in rows)]
    lines = ["| " + " | ".join(columns) + " |", "|" + "---|" * len(columns)]
    lines += ["| " + " | ".join(format_value(row.get(column)) for column in columns) + " |" for row in rows]
    if count > MANY_ROWS:
        parts.append(f"{count} rows: {data}\n")
    elif count > FEW_ROWS:
        parts.append("\n".join([f"<details><summary>{count} rows</summary>\n", *lines, "\n</details>\n"]))
    else:
        parts.append("\n".join(lines) + "\n")
    return "\n".join([*parts, f"{table['note']}\n"] if table["note"] else parts)


def _with_spans(row: Mapping[str, Any]) -> dict[str, Any]:
    """Return the row with `X low (unit)` and `X high (unit)` in brackets behind `X (unit)`, where they differ."""
    shown = dict(row)
    for column in row:
        low, high = span_columns(column)
        if low in row and high in row:
            span = shown.pop(low), shown.pop(high)
            if None not in (row[column], *span) and span[0] != span[1]:
                shown[column] = f"{format_value(row[column])} ({format_value(span[0])} to {format_value(span[1])})"
    return shown


def _drawing(figure: Record, rows: Sequence[Mapping[str, Any]]) -> str:
    """One plot as SVG, where a value of 0 on a logarithmic `y` stands below the plot; "" where no row has both values."""
    x, y = figure["x"], figure["y"]
    wanted = figure.get("where", {}).items()
    shown = [row for row in rows if all(row.get(column) == value for column, value in wanted)]
    shown = [
        row for row in shown if _drawable(row, y) and (_is_word(row, x) or _drawable(row, x, "x" in figure["log"]))
    ]
    shown = [row for row in shown if row[y] >= 0 or "y" not in figure["log"]]
    if not shown:
        return ""
    canvas, (axis,) = page.plot(figure["title"], x, y, height=3.2)
    if "x" in figure["log"]:
        axis.set_xscale("log")
    if "y" in figure["log"]:
        axis.set_yscale("log")
        if not any(row[y] for row in shown):
            axis.set_ylim(1e-16, 1)  # an empty logarithmic axis has no limits of its own
    names = list(dict.fromkeys(row.get(figure["series"], "") for row in shown))
    for number, name in enumerate(names):
        chosen = [row for row in shown if row.get(figure["series"], "") == name]
        exact = [row for row in chosen if row[y] == 0 and "y" in figure["log"]]
        chosen = [row for row in chosen if row not in exact]
        line = "" if figure["front"] else "-"
        across, up = [row[x] for row in chosen], [row[y] for row in chosen]
        look: dict[str, Any] = {
            "color": COLOURS[number % len(COLOURS)],
            "marker": MARKERS[(number + number // len(COLOURS)) % len(MARKERS)],  # no pair twice
            "markersize": 4,
        }
        bars = _error_bars(figure, chosen)
        axis.errorbar(across, up, **bars, linestyle=line, linewidth=1.2, elinewidth=0.8, label=str(name), **look)
        _stand_at_zero(axis, [row[x] for row in exact], look)
    if figure["front"]:
        points = [(row[x], row[y]) for row in shown if row[y] > 0 or "y" not in figure["log"]]
        front = [points[index] for index in pareto_front(points)] or [(math.nan, math.nan)]
        axis.step(*zip(*front, strict=True), where="post", color=page.GREY, linewidth=1, linestyle="--", label="front")
    for scale in figure["log"]:
        _show_decades(axis, scale)
    if len(names) > 1 or figure["front"]:
        page.legend(axis)
    return page.svg(canvas)


def _drawable(row: Mapping[str, Any], column: str, positive: bool = False) -> bool:
    value = row.get(column)
    return isinstance(value, (int, float)) and math.isfinite(value) and not (positive and value <= 0)


def _is_word(row: Mapping[str, Any], column: str) -> bool:
    return isinstance(row.get(column), str)


def _show_decades(axis: Axes, scale: str) -> None:
    """Label powers of ten alone on the axis "x" or "y"; where fewer than two are in view, round numbers between them too."""
    one = getattr(axis, f"{scale}axis")
    low, high = (math.log10(end) for end in getattr(axis, f"get_{scale}lim")())
    if math.floor(high) - math.ceil(low) >= 1:
        one.set_minor_formatter(NullFormatter())
        return
    one.set_minor_locator(LogLocator(subs=(1.5, 2, 3, 5, 7)))
    one.set_major_formatter("{x:g}")
    one.set_minor_formatter("{x:g}")
    axis.tick_params(which="minor", labelsize=8, colors=page.TEXT_COLOUR)


def _stand_at_zero(axis: Axes, across: Sequence[float], look: dict[str, Any]) -> None:
    """Points of value 0, which a logarithmic axis lacks: on its lower end, with a 0 beside them."""
    place = axis.get_xaxis_transform()
    axis.plot(across, [0] * len(across), linestyle="", transform=place, clip_on=False, zorder=3, **look)
    for x in across:
        axis.annotate(
            "0",
            (axis.convert_xunits(x), 0),
            (4, 3),
            xycoords=place,
            textcoords="offset points",
            fontsize=7,
            color=look["color"],
        )


def _error_bars(figure: Record, rows: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    low, high = figure["low"], figure["high"]
    if not low or any(row.get(low) is None or row.get(high) is None for row in rows):
        return {}
    along = "x" if low.startswith(figure["x"].partition(" (")[0]) else "y"
    middle = figure[along]
    return {f"{along}err": [[row[middle] - row[low] for row in rows], [row[high] - row[middle] for row in rows]]}
