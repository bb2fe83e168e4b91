"""pycolmap in its child process gives one answer to one request, in however many threads it works."""

import json
import sqlite3
import subprocess
import sys
from contextlib import closing
from pathlib import Path

import cv2
import numpy as np
import pytest
from warped_clip import HEIGHT, WIDTH, shifted, texture

from f4x_core.priors import sfm

CHILD = Path(sfm.__file__).with_name("colmap_child.py")
FIND_MATCHES = """
import json, runpy, sys
from pathlib import Path
request = json.loads(Path(sys.argv[2]).read_text())
runpy.run_path(sys.argv[1])["find_matches"](request, Path(request["folder"]) / "database.db")
"""


def moving_camera(frames=10):
    """(frames,HEIGHT,WIDTH,3) uint8: a camera that slides along two textured walls, the nearer one with windows in it."""
    far, near = texture(HEIGHT, 3 * WIDTH, 0), texture(HEIGHT, 3 * WIDTH, 1)
    windows = np.zeros(near.shape, np.uint8)
    for column in range(0, windows.shape[1], 60):
        windows[:, column : column + 30] = 255
    clip = [shifted(far, 3 * t, 0) for t in range(frames)]
    for t, picture in enumerate(clip):
        front = shifted(windows, 9 * t, 0)[..., 0] > 127
        picture[front] = shifted(near, 9 * t, 0)[front]
    return np.stack(clip)


def test_images_are_numbered_in_the_order_of_the_clip(tmp_path):
    pytest.importorskip("pycolmap")
    (tmp_path / "images").mkdir()
    names = [f"{i:05d}.png" for i in range(8)]
    for i, (name, picture) in enumerate(zip(names, moving_camera(8), strict=True)):
        # The first pictures are the largest work, so that their threads finish last.
        cv2.imwrite(str(tmp_path / "images" / name), picture if i < 4 else np.full_like(picture, 90))
    request = {"folder": str(tmp_path), "names": names, "pairs": [], "max_features": 2000, "threads": 4, "seed": 0}
    (tmp_path / "request.json").write_text(json.dumps(request))
    command = [sys.executable, "-c", FIND_MATCHES, str(CHILD), str(tmp_path / "request.json")]
    subprocess.run(command, check=True, capture_output=True)
    with closing(sqlite3.connect(tmp_path / "database.db")) as database:
        assert [name for (name,) in database.execute("SELECT name FROM images ORDER BY image_id")] == names


@pytest.mark.slow
def test_cameras_do_not_depend_on_threads():
    pytest.importorskip("pycolmap")
    found = [
        sfm.solve_with_colmap(moving_camera(), None, sfm.ColmapSettings(float(WIDTH), True, 1000, threads, 0))
        for threads in (1, 2, 4, 4)
    ]
    assert found[0] is not None and found[0].registered.all()
    for other in found[1:]:
        assert other is not None
        np.testing.assert_array_equal(other.bundle.center, found[0].bundle.center)
        np.testing.assert_array_equal(other.bundle.rotation, found[0].bundle.rotation)
        np.testing.assert_array_equal(other.observations.uv, found[0].observations.uv)
