"""The same clip, settings and seed give the same file: on a busy machine, with any number of threads, and after being killed."""

import hashlib
import os
import signal
import subprocess
import sys
import time
from contextlib import contextmanager
from pathlib import Path

import cv2
import numpy as np
import pytest
from test_bad_input import filmed, write_frames

ROOT = Path(__file__).resolve().parents[2]
PROCESSES, FITS, KILLS = 60, 20, 30
BUSY = 4
"""Processes that do nothing but keep the cores busy."""
FIT = [
    sys.executable,
    "-m",
    "f4x_core",
    "fit",
    "--profile",
    "quick",
    "--set",
    "steps=60",
    "--set",
    "checkpoint_every=10",
]
GRADIENTS = """
import hashlib, numpy as np
from f4x_core.geometry.camera import Camera
from f4x_core.geometry.splats import Splats
from f4x_core.raster.contract import RasterConfig, RasterInput
from f4x_core.raster.native import library
random = np.random.default_rng(0)
means = random.uniform([-1, -1, 1], [1, 1, 3], (3000, 3))
splats = Splats(means, random.normal(size=(3000, 4)), random.uniform(0.005, 0.05, (3000, 3)), random.uniform(0.01, 1, 3000))
camera = Camera(np.array([[100.0, 0, 60], [0, 100, 40], [0, 0, 1]]), np.eye(4), 120, 80)
loaded, reason = library.open_library()
drawn = library.forward(loaded, RasterInput(splats, random.random((3000, 3)), camera, config=RasterConfig(threads=2)), True)
sent = random.normal(size=(80, 120, 3)).astype(np.float32)
gradients = library.backward(loaded, drawn, sent, drawn.output.depth, drawn.output.alpha)
hashed = hashlib.sha256(drawn.output.channels.tobytes())
for name in sorted(gradients):
    hashed.update(gradients[name].tobytes())
print(hashed.hexdigest())
"""

pytestmark = [pytest.mark.slow, pytest.mark.usefixtures("native_library")]


@contextmanager
def busy_machine():
    """Keep the cores busy with other processes."""
    others = [subprocess.Popen([sys.executable, "-c", "while True: pass"]) for _ in range(BUSY)]
    try:
        yield
    finally:
        for other in others:
            other.kill()
            other.wait()


@pytest.fixture(scope="module")
def clip(tmp_path_factory) -> Path:
    """Twelve pictures of 192x120: a camera slides along a wall, a card moves, a post passes by."""
    small = filmed(12, slide=1.5, post=2.5, speed=2.0)
    large = np.stack([cv2.resize(picture, (192, 120), interpolation=cv2.INTER_CUBIC) for picture in small])
    return write_frames(tmp_path_factory.mktemp("same") / "clip", large)


def fitted(clip: Path, out: Path, *options: str) -> str:
    """Fit in a process of its own; return the hash of the scene file."""
    command = [*FIT, str(clip), "-o", str(out), *options]
    subprocess.run(command, cwd=ROOT, check=True, capture_output=True)
    return hashlib.sha256((out / "scene.f4x").read_bytes()).hexdigest()


@pytest.fixture(scope="module")
def expected(clip, tmp_path_factory) -> str:
    """Hash of the scene file of an undisturbed fit."""
    return fitted(clip, tmp_path_factory.mktemp("whole"))


def test_new_processes_compute_the_same_gradients_on_a_busy_machine():
    with busy_machine():
        command = [sys.executable, "-c", GRADIENTS]
        printed = {subprocess.check_output(command, cwd=ROOT, text=True) for _ in range(PROCESSES)}
    assert len(printed) == 1


def test_fits_on_a_busy_machine_write_the_same_file(clip, expected, tmp_path):
    with busy_machine():
        assert {fitted(clip, tmp_path / str(number)) for number in range(FITS)} == {expected}


@pytest.mark.parametrize("threads", [1, 2, 4])
def test_any_number_of_threads_writes_the_same_file(clip, expected, tmp_path, threads):
    assert fitted(clip, tmp_path / "out", "--threads", str(threads)) == expected


@pytest.mark.skipif(os.name == "nt", reason="signals of POSIX")
def test_fits_that_are_killed_at_any_moment_resume_to_the_same_file(clip, expected, tmp_path):
    start = time.monotonic()
    fitted(clip, tmp_path / "timed")
    seconds = time.monotonic() - start
    seed = time.time_ns() % 2**32
    random, left, fits = np.random.default_rng(seed), KILLS, 0
    while left > 0:
        out, fits = tmp_path / str(fits), fits + 1
        for number in range(min(left, 3)):
            command = [*FIT, str(clip), "-o", str(out), *(["--resume"] if number else [])]
            child = subprocess.Popen(command, cwd=ROOT, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE)
            try:
                child.wait(random.uniform(0.1, 0.6) * seconds)
            except subprocess.TimeoutExpired:
                child.send_signal(signal.SIGINT if number == 1 else signal.SIGKILL)
                left -= 1
            _, errors = child.communicate()
            assert child.returncode in (0, 130, -signal.SIGKILL), (seed, errors.decode())
        assert fitted(clip, out, "--resume") == expected, (seed, fits)
