"""What always stands behind a mover is painted like its surroundings; all else stays as it is."""

from dataclasses import replace

import numpy as np
from labelled_scene import labelled_scene

from f4x_core.fit.covered import painted
from f4x_core.geometry import spherical_harmonics
from f4x_core.geometry.camera import CameraPath
from f4x_core.scene import DynamicSet

BLUE, RED = (0.2, 0.3, 0.8), (0.8, 0.2, 0.1)


def ghost(frames):
    """The labelled scene's first frames; its blue wall is red where the square stands in all of the first three."""
    scene = labelled_scene(features=False)
    path = scene.cameras
    x, y = scene.static.means[:, 0], scene.static.means[:, 1]
    behind = (x > -0.26) & (x < -0.14) & (abs(y) < 0.12)
    sh = scene.static.sh.copy()
    sh[behind] = spherical_harmonics.dc_from_rgb(np.float32(RED))
    cameras = CameraPath(
        path.intrinsics[:frames], path.world_to_camera[:frames], path.times[:frames], path.width, path.height
    )
    return replace(scene, static=replace(scene.static, sh=sh), cameras=cameras), behind


def test_what_no_frame_shows_gets_the_colours_around_it():
    scene, behind = ghost(3)
    assert behind.sum() >= 8
    found = painted(scene)
    rgb = spherical_harmonics.rgb_from_dc(found.sh[:, 0])
    np.testing.assert_allclose(rgb[behind], np.tile(BLUE, (behind.sum(), 1)), atol=0.02)
    rest = replace(found, sh=np.where(behind[:, None, None], scene.static.sh, found.sh))
    np.testing.assert_allclose(rest.sh, scene.static.sh, atol=1e-6)  # blue stays blue


def test_what_comes_to_light_in_one_frame_stays():
    scene, behind = ghost(6)
    np.testing.assert_array_equal(painted(scene).sh[behind], scene.static.sh[behind])


def test_without_movers_nothing_is_painted():
    scene, _ = ghost(3)
    still = replace(scene, dynamic=DynamicSet.empty(), scaffold=None)
    assert painted(still) is still.static
