"""Sets of Gaussians as one: their arrays one after the other, each with when it is there. Needs numpy alone."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import fields
from typing import TypeVar

import numpy as np

from .model import StaticSet

Gaussians = TypeVar("Gaussians", bound=StaticSet)

ALWAYS = (-np.inf, -np.inf, np.inf, np.inf)
"""The span of what never comes or goes."""


def concatenated(parts: Sequence[Gaussians], spans: Sequence[np.ndarray]) -> Gaussians:
    """Return one set of all parts, with their spans; smaller degrees of harmonics are padded with zeros."""
    size = max(part.sh.shape[1] for part in parts)
    whole = {
        entry.name: [getattr(part, entry.name) for part in parts] for entry in fields(parts[0]) if entry.name != "span"
    }
    whole["sh"] = [np.pad(sh, ((0, 0), (0, size - sh.shape[1]), (0, 0))) for sh in whole["sh"]]
    span = np.concatenate(spans).astype(np.float32)
    arrays = {name: np.concatenate(values) for name, values in whole.items()}
    return type(parts[0])(**arrays, span=None if (span == ALWAYS).all() else span)


def followed_by(static: StaticSet, more: StaticSet) -> StaticSet:
    """Return both sets as one; what has no span is always there."""
    return concatenated([static, more], [within(part, np.array(ALWAYS)) for part in (static, more)])


def within(part: StaticSet, span: np.ndarray) -> np.ndarray:
    """Return (N,4) spans within a window: Gaussians come with the later of their own and its `span (4,)`, go with the earlier."""
    if part.span is None:
        return np.tile(span, (len(part), 1))
    both = np.concatenate([np.maximum(part.span[:, :2], span[:2]), np.minimum(part.span[:, 2:], span[2:])], 1)
    return np.maximum.accumulate(both, axis=1)  # what goes before it comes is never there
