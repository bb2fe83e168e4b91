"""One page for a whole batch: a picture, scores and failures of every clip, with links to its files."""

from __future__ import annotations

import html
from collections.abc import Sequence
from urllib.parse import quote

from .. import page
from .graph import slug
from .manifest import PAGE
from .run import DONE, FAILED, KEPT, Board, RowState
from .storage import Store

SCORES = {"used_psnr": "PSNR (dB)", "held_out_psnr": "held out (dB)", "gaussians": "Gaussians"}
"""Figures of the fit that are shown, where a row has them."""
STYLE = """<style>
.clip img { width: 160px; } td:first-child { width: 168px; } .failed { color: var(--bad); } .done { color: var(--fine); }
</style>"""


def write_index(store: Store, board: Board, title: str) -> None:
    """Write the page into the store.

    Pictures are linked and loaded when they come into view: the page of ten thousand clips opens too.
    """
    rows = list(board.rows.values())
    failed = [each for each in rows if each.state == FAILED]
    done = sum(each.state == DONE for each in rows)
    verdict = f"{done} of {len(rows)} clips are done" + (f", {len(failed)} failed" if failed else "") + "."
    body = [f'{STYLE}<p class="verdict">{verdict}</p>', _times(board)]
    body.append(page.section("Failures", "".join(map(_failure, failed))))
    body.append(page.section("Clips", _table(rows)))
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
    lines = [
        f'<a href="{_link(each, f"logs/{slug(stage)}.log")}">{html.escape(each.row.name)}, {html.escape(stage)}</a>:'
        f" {html.escape(error)}"
        for stage, error in each.errors.items()
    ]
    return f'<div class="finding problem">{"<br>".join(lines)}</div>'


def _table(rows: Sequence[RowState]) -> str:
    shown = {name: title for name, title in SCORES.items() if any(name in each.scores for each in rows)}
    head = "".join(
        f"<th>{html.escape(title)}</th>" for title in ("", "clip", "state", *shown.values(), "seconds", "files")
    )
    return f'<table class="clip"><tr>{head}</tr>{"".join(_row(each, shown) for each in rows)}</table>'


def _row(each: RowState, shown: dict[str, str]) -> str:
    picture = ""
    if each.pictures:
        link = _link(each, each.pictures[len(each.pictures) // 2])
        picture = f'<a href="{link}"><img loading="lazy" alt="{html.escape(each.row.name)}" src="{link}"></a>'
    scores = [f"{each.scores[name]:,.5g}" if name in each.scores else "–" for name in shown]
    numbers = "".join(f'<td class="number">{value}</td>' for value in (*scores, f"{sum(each.seconds.values()):.0f}"))
    fitted = each.states.get("fit") in (DONE, KEPT)
    files = {"diagnostics": "diagnostics.html", "scene": _scene_of(each), "folder": ""} if fitted else {"folder": ""}
    links = " ".join(f'<a href="{_link(each, file)}">{name}</a>' for name, file in files.items())
    name, clip = html.escape(each.row.name), html.escape(each.row.clip)
    about = f'{name}<br><span class="dim">{clip}</span>'
    return f'<tr><td>{picture}</td><td>{about}</td><td class="{each.state}">{each.state}</td>{numbers}<td>{links}</td></tr>'


def _scene_of(each: RowState) -> str:
    """The last scene file of a row that is there."""
    for stage, file in (("edit", "edited.f4x"), ("distill", "distilled.f4x")):
        if each.states.get(stage) in (DONE, KEPT):
            return file
    return "scene.f4x"


def _link(each: RowState, file: str) -> str:
    return html.escape(quote(f"{each.row.name}/{file}"))
