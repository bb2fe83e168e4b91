"""The blue sky of scenes whose sky is known, and of scenes without one."""

from dataclasses import replace

import numpy as np
import pytest
from floater_scenes import planted

from f4x_core.errors import F4xError
from f4x_core.geometry.spherical_harmonics import dc_from_rgb
from f4x_core.query.knowledge import refuse_unknown
from f4x_core.query.prompts import select_by_text
from f4x_core.query.sky import is_of_sky, points_on_sky, sky_scores

BLUE, GREY, SAND = (0.35, 0.55, 0.85), (0.7, 0.7, 0.72), (0.7, 0.6, 0.45)


def _street(sky, floor=SAND, rest=GREY):
    """Return a street of opaque Gaussians and (N,) bool, its far backdrop: colors of both, and of the rest."""
    scene = planted("street", 31, fraction=0)[0]
    means = scene.static.means
    far, low = means[:, 2] > 30, means[:, 1] > 0.95
    colors = np.where(far[:, None], sky, np.where(low[:, None], floor, rest))
    static = replace(
        scene.static, sh=dc_from_rgb(colors).astype(np.float32)[:, None], opacities=np.full(len(far), 0.95, np.float32)
    )
    return replace(scene, static=static), far


def test_the_sky_is_what_is_blue_above_the_horizon():
    scene, far = _street(BLUE)
    scores = sky_scores(scene)
    assert scores[~far].mean() < 0.02
    height, width = scene.cameras.height, scene.cameras.width
    pixels, depth = scene.cameras[0].project(scene.static.means)
    shown = far & (depth > 0) & ((pixels > 2) & (pixels < (width - 2, height / 2 - 3))).all(1)
    shown &= (
        np.hypot(*(pixels - pixels[(scene.static.means[:, 2] > 3) & (scene.static.means[:, 2] < 5)].mean(0)).T) > 15
    )
    assert scores[shown].mean() > 0.8
    np.testing.assert_array_equal(select_by_text(scene, ["the sky"]).chosen, scores > 0)  # without any features
    refuse_unknown(scene, "sky")


@pytest.mark.parametrize(
    "colors",
    [{"sky": GREY}, {"sky": GREY, "floor": BLUE}, {"sky": (0.2, 0.3, 0.5)}],
    ids=["grey", "blue floor", "night"],
)
def test_a_scene_without_a_blue_sky_says_what_to_do_instead(colors):
    with pytest.raises(F4xError, match=r"no blue sky was found.*click on it"):
        select_by_text(_street(**colors)[0], ["sky"])


def test_points_lie_all_along_the_sky():
    """Clouds cut the sky into parts, and what a click on one means may leave the others out."""
    scene, _ = _street(BLUE)
    places = [point.at[0] / scene.cameras.width for point in points_on_sky(scene) if point.frame == 0]
    assert np.bincount(np.int64(4 * np.array(places)), minlength=4).tolist() == [1, 1, 1, 1]


def test_points_lie_on_the_sky():
    scene, far = _street(BLUE)
    pixels = scene.cameras[0].project(scene.static.means[~far])[0]
    for point in points_on_sky(scene):
        assert point.at[1] < scene.cameras.height / 2
        assert np.hypot(*(pixels - point.at).T).min() > 1


@pytest.mark.parametrize(
    ("label", "sky"), [("sky", True), ("The blue sky", True), ("skyscraper", False), ("grey sky", False)]
)
def test_words_for_the_sky(label, sky):
    assert is_of_sky(planted("room", 31)[0], label) == sky
