"""The most that this machine could do: multiply-adds and copies, which every kernel's share is taken of."""

from __future__ import annotations

import statistics

import numpy as np

from f4x_core.native import measure_peak, open_library

from ..study import Context, Findings, MissingError, Table
from ..timing import time_in_turn

COPY_BYTES = 256 << 20
"""Far beyond any cache."""
LONG_S = 0.5
"""Of each round of multiply-adds."""


def measure_peaks(context: Context) -> Findings:
    """Rounds of independent multiply-adds and of plain copies on one thread, in turn."""
    library, reason = open_library()
    if library is None:
        raise MissingError(f"the compiled library is not there ({reason}); `f4x doctor` says what it needs.")
    source, target = np.ones((2, COPY_BYTES // 8))
    rates = [measure_peak(library, LONG_S) / 1e9 for _ in range(context.repeats)]
    (seconds,) = time_in_turn([lambda: np.copyto(target, source)], context.repeats)
    copies = [2 * COPY_BYTES / s / 1e9 for s in seconds]
    rows = []
    for name, values in (("multiply-adds (GF/s)", rates), ("copy, read and write (GB/s)", copies)):
        rows.append({"peak": name, "median": statistics.median(values), "low": min(values), "high": max(values)})
    return Findings([Table("peaks", rows, "One thread", timed=("median", "low", "high"))])
