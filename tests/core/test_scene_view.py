"""Rendered channels against closed forms and the plain reference raster; false colours."""

from dataclasses import replace

import numpy as np
import pytest
from random_scene import HEIGHT, WIDTH, random_scene

from f4x_core.errors import Cancelled, F4xError
from f4x_core.geometry import trajectory
from f4x_core.geometry.camera import CameraPath
from f4x_core.raster import RasterConfig
from f4x_core.scaffold import Scaffold
from f4x_core.scene import DynamicSet, Scene, StaticSet
from f4x_core.scene.view import fitted_config, over_background, render, render_trajectory, screen_motion
from f4x_core.scene.visualise import colour_depth, colour_motion, depth_range

pytest.importorskip("torch", reason="the reference raster needs torch")


def moving_ball(shift=0.05, depth=2.0):
    """One large opaque Gaussian that slides right by `shift` world units per frame, in front of a wall at depth 4."""
    count = 400
    grid = np.stack(np.meshgrid(np.linspace(-4, 4, 20), np.linspace(-3, 3, 20)), -1).reshape(-1, 2)
    wall = {
        "ids": np.arange(count),
        "means": np.concatenate([grid, np.full((count, 1), 4.0)], 1).astype(np.float32),
        "quats": np.tile(np.float32([1, 0, 0, 0]), (count, 1)),
        "scales": np.tile(np.float32([0.5, 0.5, 1e-3]), (count, 1)),
        "opacities": np.full(count, 0.99, np.float32),
        "sh": np.zeros((count, 1, 3), np.float32),
    }
    ball = DynamicSet(
        ids=np.array([count]),
        means=np.float32([[0, 0, depth]]),
        quats=np.float32([[1, 0, 0, 0]]),
        scales=np.float32([[0.3, 0.3, 1e-3]]),
        opacities=np.float32([0.99]),
        sh=np.ones((1, 1, 3), np.float32),
        reference=np.int32([0]),
        node=np.int32([[0]]),
        weight=np.float32([[1]]),
        strength=np.float32([1]),
    )
    times = np.arange(4.0)
    xyz = np.zeros((4, 1, 3), np.float32)
    xyz[:, 0, 0], xyz[:, 0, 2] = shift * times, depth
    scaffold = Scaffold(
        times=times,
        xyz=xyz,
        quat=np.tile(np.float32([1, 0, 0, 0]), (4, 1, 1)),
        radius=np.float32([1]),
        certain=np.ones((4, 1), bool),
        ids=np.array([0]),
        neighbours=np.array([[0]]),
        edge_mask=np.array([[True]]),
        unit=1.0,
    )
    cameras = CameraPath(
        np.tile([[60.0, 0, WIDTH / 2], [0, 60, HEIGHT / 2], [0, 0, 1]], (4, 1, 1)),
        np.tile(np.eye(4), (4, 1, 1)),
        times,
        WIDTH,
        HEIGHT,
    )
    return Scene("ball", StaticSet(**wall), cameras, ball, scaffold)


@pytest.mark.parametrize("time", [0.0, 1.5, 3.0])
def test_motion_and_depth_of_a_sliding_ball(time):
    scene = moving_ball()
    out = render(scene, scene.cameras[0], time, backend="torch")
    col = int(WIDTH / 2 + 60 * 0.05 * time / 2)
    share = 0.99 * np.exp(-0.5 * ((col + 0.5 - WIDTH / 2 - 1.5 * time) ** 2 + 0.25) / (9.0**2 + 0.3))
    # 60 px * 0.05 / 2 per frame, coasting to rest past the end; what the ball leaves over goes to the wall
    speed = 1.5 if time < 3 else 60 / 2 * (scene.posed(4.0).means[-1, 0] - 0.15)
    assert 1.3 < speed <= 1.5
    np.testing.assert_allclose(
        out["motion"][HEIGHT // 2, col] * out["alpha"][HEIGHT // 2, col], [speed * share, 0], atol=1e-4
    )
    wall_share = out["alpha"][HEIGHT // 2, col] - share
    expected = (2 * share + 4 * wall_share) / out["alpha"][HEIGHT // 2, col]
    np.testing.assert_allclose(out["depth"][HEIGHT // 2, col], expected, rtol=1e-4)
    assert np.abs(out["motion"][2, 2]).max() < 1e-6 and out["depth"][2, 2] == pytest.approx(4, rel=1e-3)


def test_channels_equal_the_reference_raster():
    scene = random_scene(degree=2)
    camera = scene.cameras[1].resized(32, 20)
    fast = render(scene, camera, 1.3, backend="torch")
    plain = render(scene, camera, 1.3, backend="reference")
    assert fast.keys() == plain.keys() == {"rgb", "depth", "alpha", "motion"}
    assert fast["rgb"].shape == (20, 32, 3) and fast["motion"].shape == (20, 32, 2)
    for name in fast:
        assert fast[name].dtype == np.float32
        np.testing.assert_allclose(fast[name], plain[name], atol=2e-4, err_msg=name)


def test_each_channel_alone_equals_all_together():
    scene = random_scene()
    camera = scene.cameras[1]
    everything = render(scene, camera, 2.0, backend="torch")
    for name, picture in everything.items():
        alone = render(scene, camera, 2.0, channels=(name,), backend="torch")
        assert alone.keys() == {name}
        np.testing.assert_allclose(alone[name], picture, atol=1e-6)


def test_values_are_composited_like_colours():
    scene = random_scene()
    camera = scene.cameras[0]
    red = scene.colors(scene.posed(1.0), camera)[:, :1]
    out = render(scene, camera, 1.0, ("rgb", "motion"), "torch", values={"selection": red})
    np.testing.assert_allclose(out["selection"][..., 0], out["rgb"][..., 0], atol=1e-6)


def test_nothing_to_see_is_background_and_unknown_depth():
    scene = Scene("empty", StaticSet.empty(), random_scene().cameras)
    out = render(scene, scene.cameras[0], 0.0, backend="reference")
    np.testing.assert_array_equal(
        over_background(out, (1, 0.5, 0)), np.broadcast_to(np.float32([1, 0.5, 0]), (HEIGHT, WIDTH, 3))
    )
    assert np.isnan(out["depth"]).all() and not out["alpha"].any() and not out["motion"].any()


def test_motion_behind_the_camera_is_zero():
    scene = moving_ball(depth=-1.0)
    assert not screen_motion(scene, scene.cameras[0], 0.0).any()


def test_unknown_channel():
    with pytest.raises(F4xError, match="unknown channel normals"):
        render(random_scene(), random_scene().cameras[0], 0.0, ("normals",))


def test_trajectory_follows_cameras_and_times():
    scene = random_scene()
    cameras = scene.cameras.resized(16, 10)
    views = [trajectory.View(cameras.at(1.0), float(time)) for time in cameras.times]
    pictures = list(render_trajectory(scene, views, ("rgb",), "torch"))
    assert len(pictures) == 6
    np.testing.assert_array_equal(pictures[4]["rgb"], render(scene, views[4].camera, 4.0, ("rgb",), "torch")["rgb"])


def test_trajectory_can_be_cancelled():
    def stop(stage, done, total, message=""):
        if done == 2:
            raise Cancelled

    views = trajectory.original(random_scene().cameras.resized(8, 6))
    pictures = render_trajectory(random_scene(), views, ("alpha",), "torch", progress=stop)
    assert len([next(pictures), next(pictures)]) == 2
    with pytest.raises(Cancelled):
        next(pictures)


def test_depth_colours():
    depth = np.array([[1.0, 2.0, np.nan, 100.0, 0.5]])
    colours = colour_depth(depth, 1.0, 2.0)
    assert colours.dtype == np.uint8 and colours.shape == (1, 5, 3)
    near, far, unknown, beyond, before = colours[0].tolist()
    assert near[0] > 2 * near[2] and far[2] > 1.2 * far[0] and unknown == [0, 0, 0]
    assert beyond == far and before == near
    assert depth_range([depth, np.full((2, 2), np.nan)], outliers=0) == (0.5, 100.0)
    assert depth_range([np.full((2, 2), np.nan)]) == (1.0, 2.0)


def test_motion_colours():
    motion = np.array([[[5.0, 0], [0, 0], [-5, 0], [0, 5], [np.nan, 0], [50, 0]]])
    right, rest, left, down, unknown, long = colour_motion(motion, 5.0)[0].tolist()
    assert right == [255, 0, 0] and rest == [255, 255, 255] and unknown == [0, 0, 0] and long == [191, 0, 0]
    assert left[2] == 255 and left[0] == 0 and down[0] == 255 and down[1] > 200 and down[2] == 0


@pytest.mark.parametrize("zoom", [0.5, 2.0])
def test_an_image_of_another_size_shows_what_was_fitted(zoom):
    """Gaussians smaller than a pixel neither swell in a small image nor come apart in a large one."""
    scene = moving_ball()
    static = replace(scene.static, scales=0.02 * scene.static.scales)
    scene = replace(scene, static=static, dynamic=DynamicSet.empty(), scaffold=None)
    camera = scene.cameras[0]
    own = render(scene, camera, 0.0, ("alpha",))["alpha"]
    size = round(zoom * camera.width), round(zoom * camera.height)
    other = render(scene, camera.resized(*size), 0.0, ("alpha",))["alpha"]
    assert other.mean() == pytest.approx(own.mean(), rel=0.1)
    assert fitted_config(scene, camera, 0.0) == RasterConfig()
    imported = replace(scene, provenance={"import": {"file": "a.ply"}})
    fixed = render(imported, camera.resized(*size), 0.0, ("alpha",))["alpha"]
    assert abs(fixed.mean() / own.mean() - 1) > 0.3
    assert fitted_config(imported, camera.resized(*size), 0.0) == RasterConfig(), "how it was fitted is not known"
