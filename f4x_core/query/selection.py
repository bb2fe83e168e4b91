"""Which Gaussians are meant: stable ids with scores, thresholds that can be moved later, and JSON both ways."""

from __future__ import annotations

import hashlib
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from ..errors import F4xError
from ..scene import Scene
from .score import THRESHOLD

FORMAT = "f4x-selection"
SELECTED = "the selection"
"""What a selection without a name is called in questions and answers."""
MIN_THRESHOLD = 1e-6
"""Minimum threshold of a combination: 0 would choose everything."""
DECIMALS = 4
"""Of the scores in JSON; rounding never moves a Gaussian across the threshold."""


@dataclass(frozen=True, eq=False)
class Selection:
    """A score for each Gaussian of a scene. Chosen: the score reaches the threshold, or the Gaussian `wins`."""

    ids: np.ndarray
    """(N,) int64, as in `Scene.posed`."""
    scores: np.ndarray
    """(N,) float in [0, 1]."""
    wins: np.ndarray
    """(N,) bool: chosen at any threshold, because the target is its best label."""
    threshold: float = THRESHOLD
    """In [0, 1]."""
    span: tuple[float, float] | None = None
    """First and last clip frame at which the selection holds; None = always."""
    label: str = ""
    """What was asked for, for people."""
    scene: str = ""
    """`fingerprint` of the scene that was asked; empty = not known."""
    remarks: tuple[str, ...] = ()
    """Sentences about what its words say that the scene cannot tell."""

    def __post_init__(self) -> None:
        """Validate."""
        if not 0 <= self.threshold <= 1:
            raise F4xError(f"A threshold of {self.threshold:g} is no fraction; give a number from 0 to 1.")
        if self.span is not None and not self.span[0] <= self.span[1]:
            raise F4xError(f"The span {self.span[0]:g} to {self.span[1]:g} ends before it starts.")
        if not len(self.ids) == len(self.scores) == len(self.wins):
            raise F4xError("A selection needs one score for each id.")

    @property
    def chosen(self) -> np.ndarray:
        """Return (N,) bool: the Gaussians in the selection."""
        return (self.scores >= self.threshold) | self.wins

    @property
    def chosen_ids(self) -> np.ndarray:
        """Return the ids (n,) int64 of the chosen Gaussians."""
        return self.ids[self.chosen]

    def at_threshold(self, threshold: float, keep_wins: bool = True) -> Selection:
        """Return the same scores, chosen by another threshold; `keep_wins=False` lets the threshold decide alone."""
        return replace(self, threshold=threshold, wins=self.wins & keep_wins)

    def within(self, first: float, last: float) -> Selection:
        """Return the selection, holding from clip frame `first` to `last` alone."""
        return replace(self, span=(first, last))

    def holds_at(self, time: float) -> bool:
        """Return True if the selection means anything at clip time `time`."""
        return self.span is None or self.span[0] <= time <= self.span[1]

    def among(self, rows: np.ndarray) -> Selection:
        """Return the selection without scores and wins outside `rows (N,) bool`."""
        return replace(self, scores=np.where(rows, self.scores, 0), wins=self.wins & rows)

    def require_scene(self, scene: Scene) -> None:
        """Raise F4xError unless the selection was made of `scene`, with whatever edits; copies that were undone may lack."""
        own = fingerprint(scene)
        if self.scene and self.scene != own:
            raise F4xError(
                f"The selection was made of the scene {self.scene}, this is {own}; make it anew with `f4x query`."
            )
        lost = 0 if self.scene else int((~np.isin(self.ids, scene.ids)).sum())
        if lost:
            raise F4xError(
                f"{lost} of the selection's {len(self.ids)} Gaussians are not in {scene.name}, so it was made of another"
                " scene; make it anew with `f4x query`."
            )

    def for_ids(self, ids: np.ndarray) -> Selection:
        """Return the selection with its rows in the order of `ids`: of another scene file, whose new Gaussians have score 0."""
        order = np.argsort(self.ids)
        place = np.minimum(np.searchsorted(self.ids[order], ids), max(len(self.ids) - 1, 0))
        row = order[place] if len(self.ids) else place
        known = self.ids[row] == ids if len(self.ids) else np.zeros(len(ids), bool)
        return replace(
            self,
            ids=np.asarray(ids, np.int64),
            scores=np.where(known, self.scores[row], 0) if len(self.ids) else np.zeros(len(ids)),
            wins=known & self.wins[row] if len(self.ids) else known,
        )

    def __and__(self, other: Selection) -> Selection:
        """Return the Gaussians chosen by both; scores are the smaller ones."""
        other = other.for_ids(self.ids)
        return self._combined(other, self.chosen & other.chosen, np.minimum(self.scores, other._scaled(self)), "and")

    def __or__(self, other: Selection) -> Selection:
        """Return the Gaussians chosen by either; scores are the larger ones. It holds over both spans and between them."""
        other = other.for_ids(self.ids)
        return self._combined(other, self.chosen | other.chosen, np.maximum(self.scores, other._scaled(self)), "or")

    def __invert__(self) -> Selection:
        """Return everything that is not chosen."""
        threshold = max(1 - self.threshold, MIN_THRESHOLD)
        scores = _agree(1 - self.scores, ~self.chosen, threshold)
        return replace(
            self, scores=scores, wins=np.zeros_like(self.wins), threshold=threshold, label=f"not {self.label}"
        )

    def _scaled(self, other: Selection) -> np.ndarray:
        """Return the scores with this threshold moved onto that of `other`."""
        return np.interp(self.scores, [0, self.threshold, 1], [0, other.threshold, 1])

    def _combined(self, other: Selection, chosen: np.ndarray, scores: np.ndarray, word: str) -> Selection:
        spans = [self.span, other.span]
        if word == "and":
            known = [span for span in spans if span is not None]
            span = (max(s[0] for s in known), min(s[1] for s in known)) if known else None
            if span is not None and span[0] > span[1]:
                raise F4xError(f"The spans of '{self.label}' and '{other.label}' do not overlap.")
        else:
            first, last = spans
            span = None if first is None or last is None else (min(first[0], last[0]), max(first[1], last[1]))
        label = f"({self.label} {word} {other.label})"
        threshold = max(self.threshold, MIN_THRESHOLD)
        scores, wins = _agree(scores, chosen, threshold), np.zeros_like(self.wins)
        return replace(self, scores=scores, wins=wins, threshold=threshold, span=span, label=label)

    def to_json(self) -> dict[str, Any]:
        """Return plain values for `json.dumps`; Gaussians with score 0 are left out."""
        scale = 10**DECIMALS
        rounded = np.where(self.scores >= self.threshold, np.ceil(self.scores * scale), np.floor(self.scores * scale))
        kept = (rounded > 0) | self.wins
        return {
            "format": FORMAT,
            "label": self.label,
            "scene": self.scene,
            "threshold": self.threshold,
            "span": None if self.span is None else list(self.span),
            "count": int(self.chosen.sum()),
            "ids": self.ids[kept].tolist(),
            "scores": (np.minimum(rounded[kept], scale) / scale).tolist(),
            "wins": self.ids[self.wins].tolist(),
        }

    @classmethod
    def from_json(cls, data: Any) -> Selection:
        """Return the selection that `to_json` wrote, without the rows of score 0, which `for_ids` brings back. F4xError."""
        if not isinstance(data, dict) or data.get("format") != FORMAT:
            raise F4xError("This is no selection; write one with `f4x query SCENE … -o DIR`.")
        try:
            ids = np.array(data["ids"], np.int64)
            span = None if data["span"] is None else (float(data["span"][0]), float(data["span"][1]))
            return cls(
                ids,
                np.array(data["scores"], float),
                np.isin(ids, np.array(data["wins"], np.int64)),
                float(data["threshold"]),
                span,
                str(data["label"]),
                str(data.get("scene", "")),
            )
        except (KeyError, TypeError, ValueError, IndexError, OverflowError) as error:
            raise F4xError(f"This selection is damaged ({type(error).__name__}: {error}); write it anew.") from error


def fingerprint(scene: Scene) -> str:
    """Name and 12 hexadecimal digits that tell a fitted scene from others, whatever its edits and features: `dog 3f09…`."""
    digest = hashlib.sha256()
    for part in (scene.base.static, scene.base.dynamic):
        digest.update(np.ascontiguousarray(part.ids, np.int64).tobytes())
        digest.update(np.ascontiguousarray(part.means, np.float32).tobytes())
    return f"{scene.name} {digest.hexdigest()[:12]}"


def _agree(scores: np.ndarray, chosen: np.ndarray, threshold: float) -> np.ndarray:
    """Return `scores` on that side of `threshold` where `chosen` puts them, against rounding and wins."""
    below = np.nextafter(threshold, 0)
    return np.where(chosen, np.maximum(scores, threshold), np.minimum(scores, below))
