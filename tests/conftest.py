"""Shared fixtures, and the end of a run: at once where Blender was imported, which would hang."""

import gc
import os
import signal
import sys
from pathlib import Path

import pytest

# Side by side each process has one core: threads of torch that wait for a core spin, which doubled the time of whole files.
os.environ.setdefault("OMP_NUM_THREADS", "1" if "PYTEST_XDIST_WORKER" in os.environ else "2")
# BLAS spins while its threads wait for each other: on a busy machine a bundle adjustment of 4 seconds of processor time took
# minutes, which looked like a test that hangs. Numpy reads this when it is imported.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
SHARED = Path(__file__).resolve().parents[2] / "shared"


@pytest.fixture(scope="session")
def shared() -> Path:
    """The folder with real clips and assets; tests that need it are skipped where it is absent."""
    if not SHARED.is_dir():
        pytest.skip("../shared with the real clips and assets is absent")
    return SHARED


@pytest.fixture
def one_thread():
    """Tiny tensors: more threads only wait for each other."""
    import torch

    before = torch.get_num_threads()
    torch.set_num_threads(1)
    yield
    torch.set_num_threads(before)


@pytest.fixture
def ctrl_c():
    """Ctrl-C as in a terminal, here and in processes started from here: a job in the background begins with it ignored."""
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    yield
    signal.signal(signal.SIGINT, before)


@pytest.fixture(scope="session")
def native_library():
    """The compiled library; tests that need it are skipped on a machine that cannot compile."""
    from f4x_core.native import open_library
    from f4x_core.native.build import build, find_compiler
    from f4x_core.native.library import library_path

    if not library_path().is_file() and find_compiler() is None:
        pytest.skip("no C++ compiler and no ziglang here")
    build()
    library, reason = open_library()
    assert library is not None, reason
    return library


@pytest.hookimpl(wrapper=True)
def pytest_collection():
    """What is imported here stays to the end: the garbage collector need not look at its million objects again and again."""
    gc.disable()
    collected = yield
    gc.freeze()
    gc.enable()
    return collected


def pytest_sessionfinish(session, exitstatus):
    session.config._f4x_exit = int(exitstatus)


@pytest.hookimpl(trylast=True)
def pytest_unconfigure(config):
    if "bpy" in sys.modules:
        from addon.common.process_exit import end_process

        end_process(getattr(config, "_f4x_exit", 0))
