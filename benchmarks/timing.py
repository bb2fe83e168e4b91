"""Fair timing of alternatives in one process."""

import statistics
import time
from collections.abc import Callable, Sequence


def time_in_turn(functions: Sequence[Callable[[], object]], repeats: int) -> list[list[float]]:
    """Wall seconds of each call of each function; one call of each per round, so that other load meets all alike."""
    seconds: list[list[float]] = [[] for _ in functions]
    for function in functions:
        function()  # the first call pays for page faults and thread starts
    for _ in range(repeats):
        for function, times in zip(functions, seconds, strict=True):
            start = time.perf_counter()
            function()
            times.append(time.perf_counter() - start)
    return seconds


def measure_in_turn(functions: Sequence[Callable[[], object]], repeats: int) -> list[float]:
    """Median wall seconds of each function, timed in turn."""
    return [statistics.median(times) for times in time_in_turn(functions, repeats)]
