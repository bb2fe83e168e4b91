"""A camera that turns by three widths of its picture, with and without room for all that it sees."""

import cv2
import numpy as np
import pytest

pytest.importorskip("torch")
from f4x_core.clip import read_clip
from f4x_core.evaluation.evaluate import evaluate
from f4x_core.fit.config import profile
from f4x_core.fit.pipeline import fit_clip
from f4x_core.fit.settings import set_fields

WIDTH, HEIGHT, FOCAL, FRAMES = 160, 96, 140.0, 36


def panorama(textured):
    """(600, 2400, 3) float32 grey levels all around: noise of several sizes, or soft patches with a few edges."""
    rng = np.random.default_rng(0)
    picture = np.full((600, 2400, 3), 128, np.float32)
    for size, strength in ((6, 30), (20, 35), (75, 45)):
        noise = rng.normal(size=(600 // size, 2400 // size, 3)).astype(np.float32)
        fine = size < 50
        picture += (strength if textured else 3 if fine else 25) * cv2.resize(noise, (2400, 600))
    if not textured:
        for _ in range(40):
            x, y = rng.integers(0, 2300), rng.integers(150, 420)
            picture[y : y + 60, x : x + 80] += rng.uniform(-90, 90, 3)
    return picture


def write_pan(folder, textured):
    """Pictures of a camera that turns about its own place, and nods a little."""
    rng, around = np.random.default_rng(1), panorama(textured)
    y, x = np.mgrid[:HEIGHT, :WIDTH] + 0.5
    sweep = 3 * 2 * np.arctan(WIDTH / 2 / FOCAL)
    for i in range(FRAMES):
        nod, turn = 0.02 * np.sin(i / 5), sweep * (i / (FRAMES - 1) - 0.5)
        rays = np.stack([(x - WIDTH / 2) / FOCAL, (y - HEIGHT / 2) / FOCAL, np.ones_like(x)], -1)
        rays = rays @ np.array([[1, 0, 0], [0, np.cos(nod), -np.sin(nod)], [0, np.sin(nod), np.cos(nod)]]).T
        column = (np.arctan2(rays[..., 0], rays[..., 2]) + turn + np.pi) * 2400 / (2 * np.pi)
        row = 300 + rays[..., 1] / np.hypot(rays[..., 0], rays[..., 2]) * 2400 / (2 * np.pi)
        picture = cv2.remap(around, column.astype(np.float32), row.astype(np.float32), cv2.INTER_LINEAR)
        picture += rng.normal(0, 1, picture.shape)
        cv2.imwrite(str(folder / f"{i:03d}.png"), np.clip(picture, 0, 255).astype(np.uint8))


@pytest.mark.slow
@pytest.mark.parametrize("textured", [True, False])
@pytest.mark.parametrize("room", [200_000, 2500])
def test_both_ends_of_a_wide_pan_are_as_good_as_its_middle(tmp_path, textured, room):
    """First come, first served, the cap of 2,500 would be used up by the first third of the sweep."""
    images = tmp_path / "images"
    images.mkdir()
    write_pan(images, textured)
    clip = read_clip(images)
    config = set_fields(profile("quick"), ["steps=240", f"density_static.max_count={room}"])
    scene = fit_clip(clip, tmp_path, config).scene
    quality = np.array([row["psnr"] for row in evaluate(scene, clip)["frames"]])
    third = FRAMES // 3
    ends, middle = np.r_[quality[:third], quality[-third:]].mean(), quality[third:-third].mean()
    assert ends > middle - 1, np.round(quality, 1).tolist()
    assert len(scene.static) <= room
