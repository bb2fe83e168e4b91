"""Independent work in threads."""

import threading

import numpy as np
import pytest

from f4x_core.errors import Cancelled
from f4x_core.parallel import in_threads, side_by_side


@pytest.mark.parametrize("threads", [1, 2, 5])
def test_results_come_in_the_order_of_the_items(threads):
    with side_by_side(threads):
        assert in_threads(lambda item: item**2, range(20)) == [item**2 for item in range(20)]
        assert in_threads(lambda item: item, []) == []


def test_pieces_run_side_by_side():
    both = threading.Barrier(2)  # a piece alone would wait for ever
    with side_by_side(2):
        assert in_threads(lambda item: both.wait(10) >= 0, range(2)) == [True, True]


def test_pieces_of_a_piece_run_one_by_one():
    def piece(item):
        return set(in_threads(lambda inner: threading.get_ident(), range(5)))

    with side_by_side(3):
        assert [len(threads) for threads in in_threads(piece, range(3))] == [1, 1, 1]


def test_progress_is_told_in_the_calling_thread():
    message = []
    with side_by_side(2):
        in_threads(lambda item: item, range(3), lambda done: message.append((done, threading.get_ident())))
    assert message == [(done, threading.get_ident()) for done in range(4)]


def test_an_error_drops_the_pieces_that_are_not_begun():
    begun = []

    def fail(item):
        begun.append(item)
        raise ValueError(f"piece {item}")

    with side_by_side(2), pytest.raises(ValueError, match="piece 0"):
        in_threads(fail, range(1000))
    assert len(begun) < 1000


def test_a_cancel_ends_the_work():
    def cancel(done):
        if done == 2:
            raise Cancelled

    begun, gate = [], threading.Event()

    def piece(item):
        begun.append(item)
        gate.wait(0.01)

    with side_by_side(2), pytest.raises(Cancelled):
        in_threads(piece, range(1000), cancel)
    assert len(begun) < 1000


def test_libraries_get_their_threads_back():
    cv2 = pytest.importorskip("cv2")
    from threadpoolctl import threadpool_info

    def blas():
        return [pool["num_threads"] for pool in threadpool_info() if pool["user_api"] == "blas"]

    np.ones((2, 2)) @ np.ones((2, 2))
    before = cv2.getNumThreads(), blas()
    with side_by_side(2):
        assert cv2.getNumThreads() == 1
        assert set(blas()) == {1}
    assert (cv2.getNumThreads(), blas()) == before
