"""What a window takes over from the one before, against loops over pixels; what the earlier scene shows is made up."""

import dataclasses
import math
from types import SimpleNamespace

import numpy as np
import pytest
import torch
from random_scene import random_scaffold
from scipy.spatial.transform import Rotation
from toy import cameras, clip_and_priors

from f4x_core.errors import F4xError
from f4x_core.fit.config import profile
from f4x_core.fit.pipeline import ClipFit, FitResult, KnownGround, start_fit
from f4x_core.geometry.camera import CameraPath
from f4x_core.geometry.splats import Splats
from f4x_core.raster import RasterConfig, rasterize
from f4x_core.scene import EARLIER, Scene, StaticSet
from f4x_core.windows import previous_window
from f4x_core.windows.previous_window import EarlierBackground, PreviousWindow, WindowFit

pytestmark = pytest.mark.usefixtures("one_thread")

FRAMES, OFFSET = 5, 2
"""Frames of the earlier scene, and the one of them that is the later window's first: three are shared."""
WIDTH, HEIGHT = 24, 16


def matrix(vector=(0.0, 0, 0), shift=(0.0, 0, 0)) -> np.ndarray:
    """(4,4) turned by a rotation vector, then shifted."""
    found = np.eye(4)
    found[:3, :3], found[:3, 3] = Rotation.from_rotvec(vector).as_matrix(), shift
    return found


def path_of(views) -> CameraPath:
    intrinsics = np.array([[20.0, 0, 11], [0, 22, 9], [0, 0, 1]])
    return CameraPath(
        np.tile(intrinsics, (len(views), 1, 1)), np.stack(views), 2 * np.arange(float(len(views))) + 1, WIDTH, HEIGHT
    )


def some_static(count=7, **changes) -> StaticSet:
    rng = np.random.default_rng(count)
    arrays = {
        "ids": np.arange(count),
        "means": (rng.normal(size=(count, 3)) * [0.5, 0.4, 0.2] + [0, 0, 2]).astype(np.float32),
        "quats": rng.normal(size=(count, 4)).astype(np.float32),
        "scales": rng.uniform(0.1, 0.4, (count, 3)).astype(np.float32),
        "opacities": rng.uniform(0.3, 0.95, count).astype(np.float32),
        "sh": rng.normal(size=(count, 1, 3)).astype(np.float32),
    }
    return StaticSet(**arrays | changes)


@pytest.fixture
def window():
    """The earlier window: cameras that turn and travel."""
    views = [matrix((0.02 * t, -0.03 * t, 0.01), (0.1 * t, -0.2, 0.05 * t * t)) for t in range(FRAMES)]
    return PreviousWindow(Scene("before", some_static(), path_of(views)), OFFSET, 100)


def later(frames=(0, 1, 2, 3, 4), views=None):
    """(clip, priors) of the later window, random, cameras at their own places."""
    rng = np.random.default_rng(5)
    count = len(frames)
    clip, priors = clip_and_priors(3)
    shape = count, HEIGHT, WIDTH
    pictures = rng.integers(0, 256, (max(frames) + 1, HEIGHT, WIDTH, 3), np.uint8)
    clip = SimpleNamespace(frames=pictures, supervised=np.array(frames), width=WIDTH, height=HEIGHT)
    depth = rng.uniform(0.4, 2, shape).astype(np.float32)
    depth[rng.random(shape) < 0.1] = np.nan
    depth[rng.random(shape) < 0.1] = -1
    views = views or [matrix((0.01 * t, 0.02 * t, 0), (0.05 * t, 0, 0.01 * t)) for t in range(count)]
    return clip, dataclasses.replace(
        priors, width=WIDTH, height=HEIGHT, frames=np.array(frames), cameras=path_of(views), depth=depth,
        mask=rng.random(shape) < 0.2,
    )  # fmt: skip


@pytest.fixture
def shown(monkeypatch):
    """Makes up what the earlier scene shows: the same random maps for one camera every time; gives the list of looks."""
    looks = []

    def render(scene, camera, time, channels, backend):
        rng = np.random.default_rng(int(1e6 * abs(camera.world_to_camera[:3]).sum()))
        looks.append((scene, camera, time, channels, backend))
        alpha = rng.uniform(0.6, 1, (HEIGHT, WIDTH)).astype(np.float32)
        alpha[0, :3] = 0.8
        depth = np.where(rng.random(alpha.shape) < 0.1, np.nan, rng.uniform(1, 5, alpha.shape)).astype(np.float32)
        return {"depth": depth, "alpha": alpha, "rgb": rng.uniform(-0.2, 1.2, (HEIGHT, WIDTH, 3)).astype(np.float32)}

    monkeypatch.setattr(previous_window, "render", render)
    monkeypatch.setattr(previous_window, "seen_from", lambda scene, views: scene)
    return SimpleNamespace(looks=looks, at=lambda camera: render(None, camera, 0, (), ""))


# ---- depth -------------------------------------------------------------------------------------------------------------


def test_the_earlier_scene_tells_depth_where_it_is_opaque_and_as_long_as_it_lasts(window, shown):
    clip, _ = later((0, 2, 3, 4))
    found = window.depth(clip, "torch")
    assert found.shape == (4, HEIGHT, WIDTH) and np.isnan(found[2:]).all()
    assert [look[2:] for look in shown.looks] == [(t, ("depth", "alpha"), "torch") for t in (5.0, 9.0)]
    for row, frame in ((0, 2), (1, 4)):
        seen = shown.at(window.scene.cameras[frame])
        for y in range(HEIGHT):
            for x in range(WIDTH):
                expected = seen["depth"][y, x] if seen["alpha"][y, x] > np.float32(0.8) else math.nan
                assert found[row, y, x] == expected or (math.isnan(expected) and math.isnan(found[row, y, x]))


def ratios_of(window, shown, priors, rows, moving):
    """Depth that the earlier scene shows over the priors', at known pixels that are `moving` or not, of the shared frames."""
    found = []
    for row in rows:
        seen = shown.at(window.scene.cameras[int(priors.frames[row]) + OFFSET])
        for y in range(HEIGHT):
            for x in range(WIDTH):
                known = seen["alpha"][y, x] > np.float32(0.8) and priors.depth[row, y, x] > 0
                if known and not math.isnan(seen["depth"][y, x]) and priors.mask[row, y, x] == moving:
                    found.append(seen["depth"][y, x] / priors.depth[row, y, x])
    return found


TURN, SHIFT = np.array([0.2, -0.4, 0.1]), np.array([0.5, -1, 2])


def in_a_world_of_its_own(window, scale, frames, wobble=0.0):
    """Views of the later frames in a world that is turned, shifted and `scale` times smaller, each a little wrong."""
    world = matrix(TURN, SHIFT)
    views = []
    for number, frame in enumerate(frames):
        true = window.scene.cameras.world_to_camera[min(frame + OFFSET, FRAMES - 1)] @ world
        true = matrix((0, 0, wobble * (number - 1)), (wobble * (number == 1), 0, 0)) @ true
        views.append(true)
        views[-1][:3, 3] /= scale
    return views


@pytest.mark.parametrize("near", [True, False])
def test_priors_are_placed_by_the_median_depth_and_the_shared_cameras(window, shown, near):
    frames = (0, 1, 2, 5)
    _, priors = later(frames)
    scale = float(np.median(ratios_of(window, shown, priors, range(3), False)))
    priors = dataclasses.replace(priors, cameras=path_of(in_a_world_of_its_own(window, scale, frames)))
    around = 0.2 if near else 9.0  # what is around movers: in front of them, or far behind
    priors.mask[:] = False
    priors.mask[:, 4:9, 5:12] = True
    priors.depth[:, 1:12, 2:15] = np.where(priors.mask[:, 1:12, 2:15], priors.depth[:, 1:12, 2:15], around)
    scale = float(np.median(ratios_of(window, shown, priors, range(3), False)))
    views = in_a_world_of_its_own(window, scale, frames)
    priors = dataclasses.replace(priors, cameras=path_of(views))
    own = float(np.median(ratios_of(window, shown, priors, range(3), True)))
    room = scale * room_of(priors.depth, priors.mask)
    assert (room < own) == near
    placed = window.place(priors, "torch")
    factor = np.where(priors.mask, min(own, room), scale)
    np.testing.assert_allclose(placed.depth, priors.depth * factor, rtol=1e-5)
    true = window.scene.cameras.world_to_camera[[2, 3, 4, 4]]
    np.testing.assert_allclose(placed.cameras.world_to_camera, true, atol=1e-9)
    assert {look[2] for look in shown.looks if look[4]} == {5.0, 7.0, 9.0}


def test_cameras_that_disagree_are_placed_by_their_mean(window, shown):
    frames = (0, 1, 2)
    _, priors = later(frames)
    priors.mask[:] = False
    scale = float(np.median(ratios_of(window, shown, priors, range(3), False)))
    priors = dataclasses.replace(priors, cameras=path_of(in_a_world_of_its_own(window, scale, frames, 0.02)))
    placed = window.place(priors, "torch").cameras.world_to_camera
    then = window.scene.cameras.world_to_camera[OFFSET:]
    steps = [a @ np.linalg.inv(b) for a, b in zip(placed, then, strict=True)]
    turns = [Rotation.from_matrix(step[:3, :3]).as_rotvec() for step in steps]
    places = [np.linalg.inv(a)[:3, 3] - np.linalg.inv(b)[:3, 3] for a, b in zip(placed, then, strict=True)]
    assert np.abs(turns).max() > 0.01 and np.abs(places).max() > 0.01
    in_world = [view[:3, :3].T @ turn for view, turn in zip(then, turns, strict=True)]
    np.testing.assert_allclose(np.mean(in_world, 0), 0, atol=1e-5)
    np.testing.assert_allclose(np.mean(places, 0), 0, atol=1e-9)


def test_priors_without_movers_and_without_a_shared_frame(window, shown):
    _, priors = later((0, 1, 2))
    still = dataclasses.replace(priors, mask=None)
    priors.mask[:] = False
    scale = float(np.median(ratios_of(window, shown, priors, range(3), False)))
    np.testing.assert_allclose(window.place(still, "torch").depth, priors.depth * np.float32(scale), rtol=1e-5)
    _, priors = later((3, 4, 5))
    with pytest.raises(F4xError, match="--overlap"):
        window.place(priors, "torch")


def test_where_no_background_is_known_depth_stays_as_it_is(window, shown, monkeypatch):
    clip, priors = later((0, 1, 5))
    priors.mask[:] = True
    priors.mask[:, :3, :10] = False  # fewer than 32 pixels
    priors.mask[:, 1, :] = True
    monkeypatch.setattr(PreviousWindow, "_registered", lambda self, camera, *_: camera)
    own = np.median(ratios_of(window, shown, priors, range(2), True))
    placed = window.place(priors, "torch")
    room = room_of(priors.depth, priors.mask)
    np.testing.assert_allclose(placed.depth, priors.depth * np.where(priors.mask, min(own, room), 1), rtol=1e-5)
    assert min(own, room) > 0.1
    np.testing.assert_array_equal(window.track(clip, priors, 1, "torch").depth, priors.depth)
    ground = [look for look in shown.looks if look[0] is not None and look[0].name == "ground"]
    assert {look[2] for look in ground} == {0.0} and all(look[0].static is window.scene.static for look in ground)


@pytest.mark.parametrize(("known", "expected"), [(32, 2.0), (31, 9.0)])
def test_fewer_pixels_tell_no_depth(known, expected):
    ratios = np.full((10, 5), np.nan)
    ratios.flat[:known] = 2
    assert previous_window._median(ratios, 9.0) == expected


def room_of(depth, moving):
    """Median over the frames of (nearest tenth of the known depth up to three steps around what moves) / (median of what moves)."""
    found = []
    for z, mask in zip(depth, moving, strict=True):
        around = []
        for y in range(z.shape[0]):
            for x in range(z.shape[1]):
                steps = np.abs(np.argwhere(mask) - [y, x]).sum(1)
                if len(steps) and 0 < steps.min() <= 3 and z[y, x] > 0:
                    around.append(z[y, x])
        inside = [value for value in z[mask] if value > 0]
        if around and inside:
            found.append(np.percentile(around, 10) / np.median(inside))
    return np.median(found) if found else math.inf


def test_room_is_up_to_the_nearest_tenth_of_what_stands_around():
    rng = np.random.default_rng(0)
    depth, moving = rng.uniform(1, 2, (4, 16, 20)), np.zeros((4, 16, 20), bool)
    moving[0, 3:8, 4:9], moving[1, 0:2, 10:], moving[2] = True, True, True
    depth[:2, 4:6, 7:12], depth[:2, :4, 11:13] = np.nan, 0  # unknown, inside and around
    expected = room_of(depth, moving)
    assert previous_window._room(depth, moving) == pytest.approx(expected)
    assert previous_window._room(depth[2:], moving[2:]) == math.inf


# ---- cameras -----------------------------------------------------------------------------------------------------------


def from_one_place(window, turn):
    """The earlier window, whose cameras turn by so many radians a frame, or stand still."""
    views = [matrix((0, turn * t, 0)) for t in range(FRAMES)]
    return dataclasses.replace(window, scene=dataclasses.replace(window.scene, cameras=path_of(views)))


@pytest.mark.parametrize(
    ("earlier", "kind", "freedom", "rounds"),
    [
        ("static", "static", 0, 0),
        ("static", "pan", 3, 2),
        ("pan", "static", 3, 2),
        ("pan", "moving", 6, 2),
        ("pan", None, 6, 2),
        ("moving", "pan", 6, 2),  # which hardly moves: by itself it cannot tell, before a background with depth it can
    ],
)
def test_later_cameras_go_on_from_the_one_before_and_are_registered_twice(
    window, shown, monkeypatch, earlier, kind, freedom, rounds
):
    clip, priors = later((0, 2, 3, 5))
    if earlier != "moving":
        window = from_one_place(window, 0.03 * (earlier == "pan"))
    priors = dataclasses.replace(priors, camera_kind=kind)
    nudge, asked = matrix((0, 0, 0.01), (0.02, 0, 0)), []

    def registered(self, camera, image, still, free, backend):
        asked.append((image, still, free, backend))
        return dataclasses.replace(camera, world_to_camera=nudge @ camera.world_to_camera)

    monkeypatch.setattr(PreviousWindow, "_registered", registered)
    found = window.track(clip, priors, 1, "torch")
    own, views = priors.cameras.world_to_camera, list(window.scene.cameras.world_to_camera[[2, 4]])
    for row in (2, 3):
        views.append(np.linalg.matrix_power(nudge, rounds) @ own[row] @ np.linalg.inv(own[row - 1]) @ views[-1])
    np.testing.assert_allclose(found.cameras.world_to_camera, views, atol=1e-9)
    assert len(asked) == 2 * rounds and {ask[2:] for ask in asked} <= {(freedom, "torch")}
    still = []
    for row in range(4):
        near = np.argwhere(priors.mask[row])
        still.append([[np.abs(near - [y, x]).sum(1).min() > 1 for x in range(WIDTH)] for y in range(HEIGHT)])
    for number, ask in enumerate(asked):
        row = 2 + number // 2
        np.testing.assert_array_equal(ask[0], clip.frames[priors.frames[row]])
        np.testing.assert_array_equal(ask[1], still[row])
    for row in range(4):
        seen = shown.at(dataclasses.replace(priors.cameras[row], world_to_camera=views[row]))
        known = still[row] & (seen["alpha"] > np.float32(0.8)) & (priors.depth[row] > 0) & np.isfinite(seen["depth"])
        factor = np.median((seen["depth"] / priors.depth[row])[known])
        expected = np.where(priors.mask[row], 1, factor) * priors.depth[row]
        np.testing.assert_allclose(found.depth[row], expected, rtol=1e-5)


def test_where_nothing_moves_the_whole_picture_counts(window, shown, monkeypatch):
    clip, priors = later((0, 2, 3, 5))
    asked = []
    monkeypatch.setattr(
        PreviousWindow, "_registered", lambda self, camera, image, still, *_: asked.append(still) or camera
    )
    found = window.track(clip, dataclasses.replace(priors, mask=None), 1, "torch")
    assert all(still.all() for still in asked) and len(asked) == 4
    seen = shown.at(window.scene.cameras[OFFSET])
    known = (seen["alpha"] > np.float32(0.8)) & (priors.depth[0] > 0) & np.isfinite(seen["depth"])
    factor = np.median((seen["depth"] / priors.depth[0])[known])
    np.testing.assert_allclose(found.depth[0], factor * priors.depth[0], rtol=1e-5)


def registration(window, monkeypatch, shown, share, most=2000):
    """(camera before, points seen there, where flow finds them); flow is made up and trusted at a `share` of the pixels."""
    rng = np.random.default_rng(3)
    camera = window.scene.cameras[2]
    seen = shown.at(camera)
    trusted = rng.permutation(HEIGHT * WIDTH).reshape(HEIGHT, WIDTH) < share * HEIGHT * WIDTH
    still = np.ones((HEIGHT, WIDTH), bool)
    still[:, :4] = False
    seen["depth"], seen["alpha"] = rng.uniform(1, 3, (2, HEIGHT, WIDTH)).astype(np.float32)
    seen["alpha"] = np.where(trusted, 0.9, np.where(rng.random(still.shape) < 0.5, 0.8, 0.1)).astype(np.float32)
    trusted[:, :4] = False
    flow = (0.7 + 0.4 * rng.normal(size=(HEIGHT, WIDTH, 2))).astype(np.float32)
    flow[rng.random(still.shape) < 0.1] += 6  # wrong
    drawn = []

    def estimate(one, other):
        drawn.append((one, other))
        return flow if len(drawn) == 1 else -flow

    def agree(there, back):
        np.testing.assert_array_equal(back, -there)
        return np.ones(still.shape, bool)

    monkeypatch.setattr(previous_window, "dis", lambda *preset: {("medium", 0): estimate}[preset])
    monkeypatch.setattr(previous_window, "consistent", agree)
    monkeypatch.setattr(previous_window, "grey", lambda pictures: pictures)
    monkeypatch.setattr(PreviousWindow, "_ground", lambda *_: seen)
    monkeypatch.setattr(previous_window, "MATCHES", most)
    return camera, still, seen, trusted, flow, drawn


def mismatch(camera, points, wanted, step, freedom):
    """Soft L1 of the pixels at 0.5, and the stiffness: a turn or shift of a pixel weighs as 0.3 pixels off at every point."""
    step = np.concatenate([step, np.zeros(6 - freedom)])
    moved = matrix(step[:3], step[3:]) @ camera.world_to_camera
    residuals = []
    for point, pixel in zip(points, wanted, strict=True):
        local = moved[:3, :3] @ point + moved[:3, 3]
        residuals += [20 * local[0] / local[2] + 11 - pixel[0], 22 * local[1] / local[2] + 9 - pixel[1]]
    residuals += list(0.3 * math.sqrt(2 * len(points)) * 20 * step[:freedom])
    return sum(2 * 0.25 * (math.sqrt(1 + (r / 0.5) ** 2) - 1) for r in residuals)


@pytest.mark.parametrize(("freedom", "most", "every"), [(3, 2000, 1), (6, 2000, 1), (6, 100, 3), (6, 209, 2)])
def test_a_camera_is_registered_to_the_least_mismatch_of_the_flow(window, monkeypatch, shown, freedom, most, every):
    camera, still, seen, trusted, flow, drawn = registration(window, monkeypatch, shown, 0.65, most)
    image = np.random.default_rng(0).integers(0, 256, (HEIGHT, WIDTH, 3), np.uint8)
    found = window._registered(camera, image, still, freedom, "torch")
    rows = np.argwhere(trusted & still)
    assert every == 1 + len(rows) // most
    points, wanted = [], []
    for y, x in rows[::every]:
        local = seen["depth"][y, x] * np.array([(x + 0.5 - 11) / 20, (y + 0.5 - 9) / 22, 1])
        points.append(camera.world_to_camera[:3, :3].T @ (local - camera.world_to_camera[:3, 3]))
        wanted.append(flow[y, x] + [x + 0.5, y + 0.5])
    change = found.world_to_camera @ np.linalg.inv(camera.world_to_camera)
    step = np.concatenate([Rotation.from_matrix(change[:3, :3]).as_rotvec(), change[:3, 3]])[:freedom]
    assert np.abs(step).max() > 0.005
    least = mismatch(camera, points, wanted, step, freedom)
    for axis in range(freedom):
        lower, upper = (
            mismatch(camera, points, wanted, step + sign * 1e-4 * np.eye(freedom)[axis], freedom) for sign in (-1, 1)
        )
        curve = (lower + upper - 2 * least) / 1e-8
        assert curve > 0 and abs((upper - lower) / 2e-4 / curve) < 2e-4, "no better step is near"
    (one, other), (third, fourth) = drawn
    np.testing.assert_array_equal(other, image)
    np.testing.assert_array_equal(one, np.floor(255 * np.clip(seen["rgb"], 0, 1)).astype(np.uint8))
    np.testing.assert_array_equal(third, other)
    np.testing.assert_array_equal(fourth, one)


@pytest.mark.parametrize(("share", "stays"), [(0.18, True), (0.28, False)])
def test_a_camera_stays_where_the_background_is_recognised_in_less_than_a_fifth_of_the_picture(
    window, monkeypatch, shown, share, stays
):
    camera, still, _, trusted, *_ = registration(window, monkeypatch, shown, share)
    assert (np.mean(trusted & still) < 0.2) == stays
    image = np.zeros((HEIGHT, WIDTH, 3), np.uint8)
    assert (window._registered(camera, image, still, 6, "torch") is camera) == stays


# ---- background --------------------------------------------------------------------------------------------------------


def test_background_is_wrong_where_no_mixture_of_its_neighbourhood_is_like_the_mean_of_the_pictures(window, shown):
    clip, priors = later((1, 3, 4))
    camera = priors.cameras[1]
    seen = shown.at(camera)
    clip.frames[3] = (127 + 0.8 * (clip.frames[3] - 127.0)).astype(np.uint8)
    clip.frames[3, 4:12, 5:15] = 250
    wrong, there, squared = window._compare(
        window.scene.static, clip.frames[priors.frames[1]], priors.cameras, 1, "torch"
    )
    difference = np.clip(seen["rgb"], 0, 1) - clip.frames[3] / 255
    np.testing.assert_allclose(squared, (difference**2).mean(-1), atol=1e-6)
    assert shown.looks[-1][2:] == (0.0, ("rgb", "alpha"), "torch")
    image = np.pad(clip.frames[3] / 255, ((2, 2), (2, 2), (0, 0)), "symmetric")
    drawn = np.pad(seen["rgb"], ((2, 2), (2, 2), (0, 0)), "symmetric")
    for y in range(HEIGHT):
        for x in range(WIDTH):
            off = 0.0
            for k in range(3):
                mean = image[y : y + 5, x : x + 5, k].mean()
                own = drawn[y : y + 5, x : x + 5, k]
                off += max(own.min() - mean, mean - own.max(), 0) / 3
            assert there[y, x] == (seen["alpha"][y, x] > np.float32(0.8))
            assert wrong[y, x] == (there[y, x] and off > 0.08)


@pytest.mark.parametrize(
    ("level", "channels", "wrong"),
    [
        (148, slice(None), True),  # 0.0804 brighter than grey
        (147, slice(None), False),
        (107, slice(None), True),
        (108, slice(None), False),
        (189, 1, True),  # a third of 0.241
        (188, 1, False),
        (66, 1, True),
        (67, 1, False),
    ],
)
def test_eight_hundredths_over_all_channels_are_wrong(window, monkeypatch, level, channels, wrong):
    clip, priors = later((0, 1, 2))
    grey = np.full((HEIGHT, WIDTH, 3), 0.5, np.float32)
    if channels == 1:
        grey[..., 0], grey[..., 2] = 51 / 255, 204 / 255
    clip.frames[1] = np.round(255 * grey)
    clip.frames[1][..., channels] = level
    seen = {"rgb": grey, "alpha": np.ones((HEIGHT, WIDTH), np.float32)}
    monkeypatch.setattr(previous_window, "render", lambda *_: seen)
    found, there, _ = window._compare(window.scene.static, clip.frames[priors.frames[1]], priors.cameras, 1, "torch")
    assert there.all() and (found == wrong).all()


def compared(monkeypatch, window, priors, wrongs, theres, squared=None):
    """Makes up what is wrong and there: of all the background, then of what stays; gives what was looked at.

    `squared`: row -> (H,W) errors; none where left out.
    """
    asked = []

    def compare(self, world, clip, own, row, backend):
        asked.append((world, row))
        whole = world is window.scene.static
        return wrongs[whole][row], theres[row], np.zeros((HEIGHT, WIDTH)) if squared is None else squared[row]

    monkeypatch.setattr(PreviousWindow, "_compare", compare)
    return asked


@pytest.mark.parametrize("masked", [True, False])
def test_what_is_wrong_in_less_than_half_of_its_light_stays_and_what_no_frame_sees_too(window, monkeypatch, masked):
    rng = np.random.default_rng(0)
    static = some_static(12)
    static.means[0] = [0, 0, -5]  # behind every camera
    static.means[1] = [40, 0, 2]
    static.means[2:4] = [[-0.8, -0.4, 1.5], [0.9, 0.3, 1.5]]  # one where something moves, one that is hardly seen
    static.scales[2:4], static.opacities[2:4] = 0.01, [0.9, 0.05]
    window = dataclasses.replace(window, scene=dataclasses.replace(window.scene, static=static))
    clip, priors = later((0, 1, 2, 4))
    priors.mask[:], priors.mask[:, :8, :9] = False, True  # a part of what is wrong
    priors = priors if masked else dataclasses.replace(priors, mask=None)
    rows = np.array([0, 3])
    columns = np.arange(WIDTH) < 12  # what is wrong: the left
    wrongs = [
        {row: rng.random((HEIGHT, WIDTH)) < 0.3 for row in (0, 3)},
        dict.fromkeys((0, 3), np.tile(columns, (HEIGHT, 1))),
    ]
    theres = {row: rng.random((HEIGHT, WIDTH)) < 0.8 for row in (0, 3)}
    asked = compared(monkeypatch, window, priors, wrongs, theres)
    found = window.background(clip, priors, rows, 1, "torch")
    light = np.zeros((12, 3))
    for row in rows:
        out = rasterize(
            static,
            np.eye(12, dtype=np.float32),
            priors.cameras[int(row)],
            backend="torch",
            config=RasterConfig(threads=1),
        )
        near = np.argwhere(priors.mask[row]) if masked else np.full((1, 2), -99)
        for y in range(HEIGHT):
            for x in range(WIDTH):
                judged = np.abs(near - [y, x]).sum(1).min() > 1
                light += np.outer(out.channels[y, x], [1, judged, judged and wrongs[1][row][y, x]])
    assert np.abs(light[3:, 2] - 0.5 * light[3:, 1]).min() > 1e-3 and 0 < light[3, 0] < 1
    stays = np.flatnonzero(light[:, 2] <= 0.5 * light[:, 1])
    assert (2 in stays) == masked and 4 < len(stays) < 11
    assert found.world.ids.tolist() == stays.tolist() and found.drawn.ids.tolist() == stays[2:].tolist()
    assert [row for _, row in asked] == [0, 3, 0, 3] and asked[2][0] is asked[3][0] is found.drawn
    assert set(found.explained) == {0, 3}
    for row in rows:
        np.testing.assert_array_equal(found.explained[int(row)], theres[row] & ~wrongs[0][row])
    own = some_static(3)
    whole = found.with_own(own)
    np.testing.assert_array_equal(whole.ids, np.concatenate([stays, own.ids]))
    np.testing.assert_array_equal(whole.means, np.concatenate([static.means[stays], own.means]))
    assert found.learns.shape == (len(stays) - 2,) and not found.learns.any()
    learns = np.arange(len(stays) - 2) > 0
    further = dataclasses.replace(found, learns=learns)
    whole = further.with_own(own)  # in which is what learnt further
    np.testing.assert_array_equal(whole.ids, np.concatenate([stays[:3], own.ids]))
    known = further.known(55)
    np.testing.assert_array_equal(known.frozen.means, found.drawn.means[:1])
    np.testing.assert_array_equal(known.learning.sh, found.drawn.sh[1:])
    assert known.next_id == 55 and known.explained is found.explained


@pytest.mark.parametrize(("times", "learns"), [(1.2, False), (1.3, True)])
def test_a_background_that_shows_later_frames_worse_by_a_decibel_learns_further(window, monkeypatch, times, learns):
    clip, priors = later((0, 1, 2, 3, 4))  # three are shared
    rows = np.arange(5)
    nothing, there = np.zeros((HEIGHT, WIDTH), bool), np.ones((HEIGHT, WIDTH), bool)
    there[0] = False
    squared = {row: np.full((HEIGHT, WIDTH), 0.002) for row in rows}
    squared[3], squared[4] = times * squared[3], times * squared[4]  # 1.259 times is a decibel
    squared[1][0] = 1e3  # where nothing is
    squared[1][2], priors.mask[:], priors.mask[1, 2] = 1e3, False, True  # where something moves
    compared(monkeypatch, window, priors, [dict.fromkeys(rows, nothing)] * 2, dict.fromkeys(rows, there), squared)
    found = window.background(clip, priors, rows, 1, "torch")
    assert len(found.drawn) == len(found.learns) and (found.learns == learns).all()
    priors.mask[:] = True  # all of it is hidden
    priors.mask[:, 5, 5] = False
    assert not window.background(clip, priors, rows, 1, "torch").learns.any()


@pytest.mark.parametrize(
    ("errors", "shared", "worse"),
    [
        ([1, 1, 9], [True, True, True], False),  # nothing later
        ([1, 9, 9], [False, False, False], False),
        ([1, np.nan, 9], [True, False, False], True),
        ([1, 9, np.nan], [True, True, False], False),
        ([1, 1, 50, 1, 1.2, 1.2], [True, True, True, False, False, False], False),
        ([0, 1], [True, False], True),
        ([1e-4, 9.9e-4], [True, False], False),  # above 30 dB
        ([1e-4, 1.1e-3], [True, False], True),
    ],
)
def test_frames_are_shown_worse_by_medians_of_those_that_tell(errors, shared, worse):
    assert previous_window._worse(np.array(errors, float), np.array(shared)) == worse


# ---- nodes -------------------------------------------------------------------------------------------------------------


def test_nodes_go_on_from_those_before_at_the_same_times(window, monkeypatch):
    scaffold = random_scaffold(np.random.default_rng(0))
    assert window.continued(scaffold).ids.tolist() == [100, 101, 102, 103, 104]
    given = []
    monkeypatch.setattr(previous_window, "continue_nodes", lambda *arguments: given.append(arguments))
    before = dataclasses.replace(scaffold, unit=0.3)
    window = dataclasses.replace(window, scene=SimpleNamespace(scaffold=before, cameras=cameras(6)))
    window.continued(scaffold)
    ((after, shifted, tolerance, first),) = given
    assert after is scaffold and first == 100 and tolerance == pytest.approx(0.4 * 0.3)
    np.testing.assert_array_equal(shifted.times, scaffold.times - OFFSET)


@pytest.mark.parametrize("moving", [True, False])
def test_a_windows_scene_has_the_background_that_stayed_and_nodes_only_where_something_moves(
    window, monkeypatch, moving
):
    kept, own = some_static(4), some_static(2, ids=np.array([8, 9]))
    scaffold = random_scaffold(np.random.default_rng(0)) if moving else None
    result = FitResult(Scene("after", own, window.scene.cameras, scaffold=scaffold), None, [], {})
    monkeypatch.setattr(ClipFit, "finish", lambda self, trainer: result)
    fit = WindowFit(None, None, None, previous=window)
    fit.background = EarlierBackground(kept, kept, {}, np.zeros(4, bool))
    labels = {"ids": torch.tensor([8, 9]), "earlier": torch.tensor([False, True])}
    model = SimpleNamespace(static=SimpleNamespace(labels=labels))
    found = fit.finish(SimpleNamespace(model=model)).scene
    assert found.static.ids.tolist() == [0, 1, 2, 3, 8, 9]
    assert found.extra[EARLIER].tolist() == [9]
    assert (found.scaffold.ids.tolist() == [100, 101, 102, 103, 104]) if moving else found.scaffold is None


# ---- the fit -----------------------------------------------------------------------------------------------------------


def test_a_known_background_is_drawn_as_it_is_and_learns_as_new_gaussians_where_it_is_to():
    clip, priors = clip_and_priors(4)
    config = dataclasses.replace(profile("quick"), steps=2, threads=1, backend="torch")
    known = some_static(9, sh=np.full((9, 1, 3), 0.3, np.float32))
    every = Splats(known.means, known.quats, known.scales, known.opacities, known.sh).map(torch.from_numpy)
    frozen, learning = (every.map(lambda array, rows=rows: array[rows]) for rows in (slice(3), slice(3, 9)))
    explained = {row: np.ones((clip.height, clip.width), bool) for row in range(len(priors.frames))}
    bare, trainer = (
        start_fit(clip, priors, config, ground=KnownGround(frozen, part, explained, 1000))
        for part in (learning.map(lambda array: array[:0]), learning)
    )
    spawned, static = len(bare.model.static), trainer.model.static
    ids = static.labels["ids"].tolist()
    assert ids == list(range(1000, 1000 + spawned + 6)) and trainer.next_id > max(ids)
    posed = trainer.model.posed(None if trainer.model.dynamic is None else trainer.model.dynamic_at(1.0)[0])
    for rows, part in ((slice(spawned, spawned + 6), learning), (slice(-3, None), frozen)):
        for name, wanted in part.arrays().items():
            torch.testing.assert_close(getattr(posed, name)[rows].detach(), wanted, atol=2e-4, rtol=1e-4)
    centre = torch.from_numpy(priors.cameras.centers.mean(0)).float()
    assert static.labels["earlier"].tolist() == [False] * spawned + [True] * 6
    torch.testing.assert_close(static.labels["reach"][spawned:], (learning.means - centre).norm(dim=1))
    trainer.train_step()
    assert (trainer.model.static.parameters["means"][spawned:] != learning.means).any()
    assert trainer.model.frozen is frozen


def test_a_window_of_pictures_larger_than_its_priors_is_placed_alike_and_compared_at_full_size(window, monkeypatch):
    clip, priors = later()
    large_scene = dataclasses.replace(window.scene, cameras=window.scene.cameras.resized(2 * WIDTH, 2 * HEIGHT))
    large = dataclasses.replace(window, scene=large_scene)
    frames = clip.frames.repeat(2, 1).repeat(2, 2)
    large_clip = SimpleNamespace(frames=frames, supervised=clip.supervised, width=2 * WIDTH, height=2 * HEIGHT)
    placed = window.place(priors, "torch")
    same = large.place(priors, "torch")
    # A scene that was fitted to larger pictures has smaller footprints: its depth differs a little at edges.
    np.testing.assert_allclose(same.cameras.world_to_camera, placed.cameras.world_to_camera, atol=0.01)
    np.testing.assert_allclose(same.depth, placed.depth, rtol=0.02)
    pictures = []
    monkeypatch.setattr(PreviousWindow, "_registered", lambda _, camera, image, *__: pictures.append(image) or camera)
    tracked = large.track(large_clip, same, 1, "torch")
    assert tracked.cameras.width == WIDTH and len(pictures) == 4
    np.testing.assert_array_equal(pictures[::2], clip.frames[3:])
    found = large.background(large_clip, tracked, np.array([0, 3]), 1, "torch")
    assert {shown.shape for shown in found.explained.values()} == {(2 * HEIGHT, 2 * WIDTH)}
