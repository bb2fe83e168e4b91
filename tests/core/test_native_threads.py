"""The threads that help the compiled kernels: kept between calls, shared by callers, made anew in a forked process."""

import os
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest
from random_scene import gaussians

from f4x_core.geometry.camera import Camera
from f4x_core.geometry.splats import Splats
from f4x_core.raster import RasterConfig, rasterize

pytestmark = pytest.mark.usefixtures("native_library")


def draw(threads: int) -> bytes:
    """The picture of one scene, by so many threads."""
    arrays = gaussians(np.random.default_rng(0), 3000, 0)
    colors = arrays.pop("sh")[:, 0]
    camera = Camera(np.array([[150.0, 0, 80], [0, 150, 60], [0, 0, 1]]), np.eye(4), 160, 120)
    return rasterize(Splats(**arrays), colors, camera, config=RasterConfig(threads=threads)).channels.tobytes()


def test_callers_at_once_share_the_threads():
    expected = draw(1)
    with ThreadPoolExecutor(6) as pool:
        assert set(pool.map(draw, [2, 3, 5, 1, 4, 2] * 20)) == {expected}


def test_threads_stay_between_calls():
    tasks = "/proc/self/task"
    if not os.path.isdir(tasks):
        pytest.skip("threads are counted on Linux alone")
    draw(4)
    before = set(os.listdir(tasks))
    for _ in range(5):
        draw(4)
    assert set(os.listdir(tasks)) == before


@pytest.mark.skipif(not hasattr(os, "fork"), reason="processes do not fork here")
@pytest.mark.filterwarnings("ignore:.*fork.*:DeprecationWarning")
def test_a_forked_process_has_threads_of_its_own():
    expected = draw(3)
    child = os.fork()
    if not child:
        os._exit(0 if draw(3) == expected else 1)
    assert os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]) == 0
