"""The actions of a fit with their steps, and the fall of learning rates."""

from __future__ import annotations

import math
from collections.abc import Callable, Collection
from dataclasses import dataclass
from enum import Enum

from .config import FitConfig, Rate


class Moment(Enum):
    """Moments of a step at which actions take place."""

    START = "before the frame is drawn"
    OPTIMISED = "after the optimisers' step"
    DONE = "when the step is counted"


@dataclass(frozen=True)
class Action:
    """Something that is done at some steps."""

    name: str
    moment: Moment
    steps: Collection[int]
    """Steps at which it is done: 0 to n-1; for `Moment.DONE` the number of steps done, 1 to n."""
    run: Callable[[], None]


def steps_at(fractions: tuple[float, ...], total: int) -> frozenset[int]:
    """Return the steps nearest to these fractions of all steps."""
    return frozenset(round(fraction * total) for fraction in fractions)


def first_step_from(fraction: float, total: int) -> int:
    """Return the first step that is at least this fraction of all steps."""
    return next((step for step in range(total) if step / total >= fraction), total)


def every(period: int, total: int) -> frozenset[int]:
    """Return every `period`-th of `total` steps done, and the last one."""
    return frozenset({*range(period, total + 1, period), total}) if period else frozenset({total})


def rate_at(rate: Rate | float, fraction: float, config: FitConfig) -> float:
    """Return `rate` at this fraction of all steps; a pair decays log-linearly, without the reference's jump."""
    if not isinstance(rate, tuple):
        return rate
    start = config.rate_decay_start
    decayed = min(max((fraction - start) / (1 - start), 0.0), 1.0)
    return math.exp((1 - decayed) * math.log(rate[0]) + decayed * math.log(rate[1]))
