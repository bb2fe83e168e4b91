"""Independent pieces of work side by side: numpy, SciPy and OpenCV let go of Python's lock while they compute.

Threads of our own over frames use the cores better than threads inside a library's call: those wait for each other many times
a frame, and BLAS spins while it waits (67 seconds of processor time for 36 of work in the depth of one clip).
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from contextvars import ContextVar
from typing import TypeVar

Item = TypeVar("Item")
Result = TypeVar("Result")


_threads: ContextVar[int] = ContextVar("threads", default=1)
"""Threads of `in_threads`; in a thread that it started, 1."""


def thread_count() -> int:
    """Return the threads that `in_threads` works with here."""
    return _threads.get()


def in_threads(
    function: Callable[[Item], Result], items: Iterable[Item], report: Callable[[int], None] | None = None
) -> list[Result]:
    """Return `[function(item) for item in items]` by as many threads as `side_by_side` was given; results do not depend on them.

    `report` gets in the calling thread how many pieces are done. What it or a piece raises ends the work: pieces that
    are not begun are dropped, then it is raised here.
    """
    pieces = list(items)
    results: list[Result] = []
    with ThreadPoolExecutor(_threads.get()) as pool:
        waiting = [pool.submit(function, piece) for piece in pieces]
        try:
            for done, future in enumerate(waiting):
                if report is not None:
                    report(done)
                results.append(future.result())
        except BaseException:
            pool.shutdown(wait=False, cancel_futures=True)
            raise
    if report is not None:
        report(len(pieces))
    return results


@contextmanager
def side_by_side(threads: int) -> Iterator[None]:
    """Give `in_threads` so many threads, as long as it lasts, and keep BLAS and OpenCV to the thread that calls them."""
    import cv2
    from threadpoolctl import threadpool_limits

    before = cv2.getNumThreads()
    cv2.setNumThreads(1)
    token = _threads.set(threads)
    try:
        with threadpool_limits(1, user_api="blas"):
            yield
    finally:
        _threads.reset(token)
        cv2.setNumThreads(before)
