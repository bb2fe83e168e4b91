"""The page of a batch: images, scores and errors of every clip, with links to its files."""

from __future__ import annotations

import html
from collections.abc import Mapping, Sequence
from datetime import UTC, datetime
from urllib.parse import quote

from .. import page
from .graph import slug
from .manifest import PAGE
from .run import DONE, FAILED, KEPT, Board, RowState
from .storage import Store

SCORES = {
    "used_psnr": "PSNR (dB)",
    "used_psnr_moving": "of what moves",
    "held_out_psnr_registered": "held out",
    "held_out_psnr_flow_blend_registered": "flow blend",
    "held_out_psnr": "held out, interpolated camera",
    "gaussians": "Gaussians",
}
"""Score of the fit -> its column title; a column appears if any row has the score."""
PROFILE = "wild"
"""Profile of rows that name none, as for `f4x fit`."""
OTHER = ' class="other"'
"""HTML attribute of rows that lie in the store and are not in the manifest."""
STYLE = """<style>
body { max-width: 1400px; } .clip img { width: 160px; } .clip td { overflow-wrap: anywhere; }
.failed, .poor { color: var(--bad); } .done, .good { color: var(--fine); } .other { opacity: .45; }
</style>"""


def write_index(store: Store, board: Board, title: str) -> None:
    """Write the page into the store.

    Images are links that load when they scroll into view, so that a page of ten thousand clips opens fast.
    """
    rows = list(board.rows.values())
    failed = [each for each in rows if each.state == FAILED]
    done = sum(each.state == DONE for each in rows)
    verdict = f"{done} of {len(rows)} clips are done" + (f", {len(failed)} failed" if failed else "") + "."
    written = f'<p class="dim">Written {datetime.now(UTC):%Y-%m-%d %H:%M} UTC</p>'
    body = [f'{STYLE}<p class="verdict">{verdict}</p>{written}']
    body.append(page.section("Failures", "".join(map(_failure, failed))))
    body.append(page.section("Clips", _table([*rows, *board.others], store.local is not None)))
    body.append(page.section("Tasks", _times(board)))
    store.write(PAGE, page.document(title, body))


def _times(board: Board) -> str:
    cells = [
        [
            kind,
            f"{board.counts[kind][DONE] + board.counts[kind][KEPT]} of {board.counts[kind].total()}",
            f"{seconds / number:.1f}" if number else "–",
        ]
        for kind, (seconds, number) in board.times.items()
    ]
    return page.table(["task", "done", "seconds, mean"], cells, numbers=True)


def _failure(each: RowState) -> str:
    lines = []
    for stage, error in each.errors.items():
        what = html.escape(f"{each.row.name}, {stage}")
        if stage in each.logs:
            what = f'<a href="{_link(each, f"logs/{slug(stage)}.log")}">{what}</a>'
        lines.append(f"{what}: {html.escape(error)}")
    return f'<div class="finding problem">{"<br>".join(lines)}</div>'


def _table(rows: Sequence[RowState], local: bool) -> str:
    shown = {name: title for name, title in SCORES.items() if any(name in each.scores for each in rows)}
    numbers = "".join(f'<th class="number">{html.escape(title)}</th>' for title in (*shown.values(), "seconds"))
    head = f"<tr><th>input</th><th>render</th><th>clip</th><th>state</th>{numbers}<th>files</th></tr>"
    return f'<table class="clip">{head}{"".join(_row(each, shown, local) for each in rows)}</table>'


def _row(each: RowState, shown: dict[str, str], local: bool) -> str:
    scores = [_figure(each.scores[name]) if name in each.scores else "–" for name in shown]
    if each.quality:
        scores[0] += f'<br><span class="{each.quality.split()[0]}">{html.escape(each.quality)}</span>'
    numbers = "".join(f'<td class="number">{value}</td>' for value in (*scores, f"{sum(each.seconds.values()):.0f}"))
    files = each.files | ({"folder": ""} if local and each.logs else {})
    logs = {stage: f"logs/{slug(stage)}.log" for stage in each.logs}
    links = _links(each, files) + (f'<br><span class="dim">logs: {_links(each, logs)}</span>' if logs else "")
    about = [each.row.clip if each.tasks else "not in this list"]
    about += ["{} frames of {}×{}".format(*each.size)] if each.size else []
    about += [each.row.profile or PROFILE] if each.tasks else []
    notes = [f"{stage}: {note}" for stage, note in each.notes.items()]
    return (
        f"<tr{'' if each.tasks else OTHER}><td>{_thumbnail(each, each.input)}</td><td>{_thumbnail(each, each.preview_image)}</td>"
        f"<td>{html.escape(each.row.name)}{_dim(about)}</td>"
        f'<td><span class="{each.state}">{each.state}</span>{_dim(notes)}</td>{numbers}<td>{links}</td></tr>'
    )


def _figure(value: float) -> str:
    return f"{value:,}" if isinstance(value, int) else f"{value:.1f}"


def _dim(lines: Sequence[str]) -> str:
    return "".join(f'<br><span class="dim">{html.escape(line)}</span>' for line in lines)


def _thumbnail(each: RowState, file: str) -> str:
    if not file:
        return ""
    link = _link(each, file)
    return f'<a href="{link}"><img loading="lazy" alt="{html.escape(each.row.name)}" src="{link}"></a>'


def _links(each: RowState, files: Mapping[str, str]) -> str:
    return " · ".join(f'<a href="{_link(each, file)}">{html.escape(what)}</a>' for what, file in files.items())


def _link(each: RowState, file: str) -> str:
    return html.escape(quote(f"{each.row.name}/{file}"))
