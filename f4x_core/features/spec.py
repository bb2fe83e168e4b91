"""Specification of a feature map: its width, grid and space. Plain data, JSON both ways, no torch."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass, field
from typing import Any

from ..errors import F4xError

RESIZES = ("bilinear", "area")


@dataclass(frozen=True)
class FeatureSpec:
    """Shape, resizing and meaning of the features of one head. F4xError where the values contradict each other."""

    name: str
    """Name of the head and of its folder: `visual`, `text`, `sam2`, …"""
    dim: int
    """C, the number of channels."""
    grid: tuple[int, int]
    """(h, w), the number of cells; together they cover the whole picture, whatever its aspect ratio."""
    resize: str = "bilinear"
    """Filter that resizes a picture or a latent to the grid: `bilinear` (anti-aliased when shrinking) or `area`."""
    normalised: bool = False
    """Every cell has unit length."""
    text_encoder: str | None = None
    """Name of the text encoder whose vectors live in the same space; None where words mean nothing here."""
    temperature: float | None = None
    """Label probabilities are softmax(cosine / temperature)."""
    has_global: bool = False
    """One more vector (C,) describes the clip as a whole."""
    provenance: dict[str, Any] = field(default_factory=dict)
    """Model, licence, input size (width, height): for people and for telling old maps from new ones."""

    def __post_init__(self):
        """Refuse values that no reader could use."""
        object.__setattr__(self, "grid", tuple(self.grid))
        if not self.name or not all(part.isalnum() for part in self.name.replace("-", "_").split("_")):
            raise F4xError(f"feature spec: '{self.name}' is no name; use letters, digits, - and _.")
        if self.dim < 1 or len(self.grid) != 2 or min(self.grid) < 1:
            raise F4xError(f"feature spec '{self.name}': {self.dim} channels on a grid {self.grid} are no feature map.")
        if self.resize not in RESIZES:
            raise F4xError(f"feature spec '{self.name}': resize is '{self.resize}'; use {' or '.join(RESIZES)}.")
        if self.temperature is not None and not self.temperature > 0:
            raise F4xError(f"feature spec '{self.name}': temperature {self.temperature} is not above 0.")

    def to_json(self) -> dict[str, Any]:
        """Return plain values for `json.dumps`."""
        return {**dataclasses.asdict(self), "grid": list(self.grid)}

    @classmethod
    def from_json(cls, data: Any) -> FeatureSpec:
        """Return the spec that `to_json` wrote; F4xError names what is unknown, missing or of the wrong kind."""
        known = {entry.name: entry for entry in dataclasses.fields(cls)}
        if not isinstance(data, dict):
            raise F4xError("feature spec: not a JSON object; write it again.")
        unknown = sorted(set(data) - set(known))
        if unknown:
            raise F4xError(f"feature spec: '{unknown[0]}' is unknown to this version; known: {', '.join(known)}.")
        missing = [name for name in ("name", "dim", "grid") if name not in data]
        if missing:
            raise F4xError(f"feature spec: '{missing[0]}' is missing; add it.")
        kinds: dict[str, type | tuple[type, ...]] = {
            "name": str,
            "dim": int,
            "grid": (list, tuple),
            "resize": str,
            "normalised": bool,
            "text_encoder": (str, type(None)),
            "temperature": (float, int, type(None)),
            "has_global": bool,
            "provenance": dict,
        }
        for name, value in data.items():
            if not isinstance(value, kinds[name]) or (isinstance(value, bool) and kinds[name] is not bool):
                raise F4xError(f"feature spec: {name} is {value!r}, which is of the wrong kind.")
        if not all(isinstance(size, int) for size in data["grid"]):
            raise F4xError(f"feature spec: grid is {data['grid']!r}; give whole numbers [h, w].")
        return cls(**data)
