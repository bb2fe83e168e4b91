"""Summary of the windows of a shot: in the terminal, in `metrics.json` and on the page of the joined scene."""

from __future__ import annotations

import html
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any

from .. import page
from ..files import replace_file
from ..language.lexicon import plural
from ..metrics.believed import Believed
from ..report.advice import fair_score, quality, verdict
from ..report.finding import Finding
from ..report.geometry_findings import believed_sentence
from ..scene import Scene, read_scene
from .window import SCENE

PAGE = "diagnostics.html"
READING = "What these sentences point at is on the window's own page. What is given with --prior needs --window 0."
ORDER = ("poor", "usable with limits", "good", "")
"""Words of `quality`, the worst first; the last is of windows that were not measured."""


@dataclass(frozen=True)
class FittedWindow:
    """Results of one window for the page and the terminal."""

    frames: str
    """First and last frame, counted from the first of the shot, in words."""
    place: str
    """Folder of the window, relative to that of the shot."""
    metrics: Mapping[str, Any]
    """Metrics of `evaluation.evaluate` for the window as it was fitted."""
    findings: tuple[Finding, ...]
    """Findings about the window's quality."""
    needs: tuple[Mapping[str, str], ...]
    """Needs of the window, as scenes have them."""
    believed: float | None
    """Degrees off the path within which its views can be believed; None where nothing tells."""
    counts: tuple[int, int, int, int]
    """Background taken over, background of its own, moving Gaussians, nodes."""

    @classmethod
    def read(cls, folder: Path, number: int, first: int, end: int) -> FittedWindow:
        """Read window `number` of the shot in `folder`, which has the shot's frames `first` to before `end`."""
        place = f"windows/{number:03d}"
        scene = read_scene(folder / place / SCENE)
        known = scene.provenance["window"]
        own, nodes = known.get("own", 0), 0 if scene.scaffold is None else len(scene.scaffold)
        return cls(
            f"{first} to {end - 1}",
            place,
            scene.metrics,
            tuple(Finding(**entry) for entry in known.get("findings", ())),
            scene.needs,
            scene.provenance.get("believed_degrees"),
            (len(scene.static) - own, own, len(scene.dynamic), nodes),
        )

    @property
    def quality(self) -> str:
        """The window in a word, as of a scene."""
        return quality(self.metrics, self.findings)

    @property
    def rank(self) -> tuple[int, float]:
        """Sort key of windows, the worst first."""
        return ORDER.index(self.quality), fair_score(self.metrics) or 0.0

    def row(self) -> dict[str, Any]:
        """Return the row of `metrics.json`."""
        row = {"frames": self.frames, "quality": self.quality, "page": f"{self.place}/{PAGE}"}
        row["verdict"] = verdict(self.metrics, self.findings, f"The window of frames {self.frames}")
        findings = [asdict(finding) for finding in self.findings]
        return {**row, "believed_degrees": self.believed, "needs": list(self.needs), "findings": findings}


def close_shot(
    folder: Path, scene: Scene, windows: Sequence[tuple[int, int]], metrics: dict[str, Any]
) -> dict[str, Any]:
    """Write the page of a joined scene and return what `metrics.json` has of its windows: `quality`, `verdict`, `windows`.

    Quality and verdict are those of the worst window. `windows`: (first frame, end) of each, counted from the first of the shot;
    `metrics`: those of the joined scene.
    """
    parts = [FittedWindow.read(folder, number, *window) for number, window in enumerate(windows)]
    worst = min(parts, key=lambda part: part.rank)
    subject = f"The worst of {len(parts)} windows, frames {worst.frames}," if len(parts) > 1 else "The scene"
    summary = verdict(worst.metrics, worst.findings, subject)
    shared = [(start, end) for (_, end), (start, _) in pairwise(windows)]
    with replace_file(folder / PAGE) as file:
        file.write(page.document(scene.name, _sections(scene, parts, worst, summary, metrics, shared)))
    return {"quality": worst.quality, "verdict": summary, "windows": [part.row() for part in parts]}


def closing_lines(folder: Path, needs: Sequence[Mapping[str, str]], closing: Mapping[str, Any]) -> list[str]:
    """Return the last lines of the terminal, from what `close_shot` returned and the joined scene's `needs`."""
    lines = [f"what the clip needed: {needs_in_words(needs)}"]
    for row in closing["windows"]:
        lines.append(f"{row['verdict']} It needed {needs_in_words(row['needs'])}: {folder / row['page']}")
    return [*lines, f"{closing['verdict']} Why, and what you can supply: {folder / PAGE}"]


def needs_in_words(needs: Sequence[Mapping[str, str]]) -> str:
    """Return the choices for all needs of a scene, in a line."""
    return "; ".join(f"{row['what']} {row['chosen']}" for row in needs)


def _sections(
    scene: Scene,
    parts: Sequence[FittedWindow],
    worst: FittedWindow,
    summary: str,
    metrics: Mapping[str, Any],
    shared: Sequence[tuple[int, int]],
) -> list[str]:
    """Return the body of the page, verdict `summary` first; `shared` (first frame, end) are frames of two windows."""
    from ..report.diagnostics import finding_boxes, frame_scores, needs_table  # draws: only where a page is made

    counted = (
        f"{len(scene.cameras)} frames in {len(parts)} {plural('window', len(parts))} · {len(scene.static):,} static and"
    )
    believed = scene.provenance.get("believed_degrees")
    angles = "" if believed is None else f"<p>{html.escape(believed_sentence(Believed(believed, None)))}</p>"
    why = "".join(
        f"<details{' open' if part is worst else ''}><summary>frames {part.frames}: {part.quality or 'not measured'}</summary>"
        f"{finding_boxes(part.findings)}</details>"
        for part in parts
    )
    rows = [
        [part.frames, f"{part.metrics.get('used_psnr', float('nan')):.2f}", *(f"{count:,}" for count in part.counts)]
        for part in parts
    ]
    head = ["frames", "PSNR (dB)", "background taken over", "background of its own", "moving Gaussians", "nodes"]
    links = " · ".join(f'<a href="{part.place}/{PAGE}">{part.frames}</a>' for part in parts)
    return [
        f'<p class="verdict">{html.escape(summary)}</p>',
        f'<p class="dim">{counted} {len(scene.dynamic):,} moving Gaussians</p>',
        page.section(
            "Why the scene is as it is, and what you can supply", f'{why}<p class="dim">{html.escape(READING)}</p>'
        ),
        page.section("Each window's own page", f"<p>{links}</p>"),
        page.section("Geometry", angles + _angles(parts)),
        page.section("Scores of the whole", page.plots([frame_scores(metrics, shared)])),
        page.section("Windows, each as fitted", page.table(head, rows, numbers=True)),
        page.section("What the clip needed", needs_table(scene.needs) + _needs(parts)),
    ]


def _angles(parts: Sequence[FittedWindow]) -> str:
    """Return the angle of every window."""
    rows = [[part.frames, "unknown" if part.believed is None else f"{part.believed:.1f}°"] for part in parts]
    return page.table(["frames", "views that can be believed, off the camera's path"], rows)


def _needs(parts: Sequence[FittedWindow]) -> str:
    """Return a table (HTML) of the choices for every window, with a column for each need."""
    chosen = [{row["what"]: row["chosen"] for row in part.needs} for part in parts]
    things = list(dict.fromkeys(what for each in chosen for what in each))
    rows = [[part.frames, *(each.get(what, "–") for what in things)] for part, each in zip(parts, chosen, strict=True)]
    return page.table(["frames", *things], rows)
