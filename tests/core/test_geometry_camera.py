"""Cameras, their paths between the frames, and the standard trajectories."""

import json

import numpy as np
import pytest
import torch

from f4x_core.errors import F4xError
from f4x_core.geometry import camera as camera_room
from f4x_core.geometry import pose, quaternion, trajectory
from f4x_core.geometry.camera import Camera, CameraPath
from f4x_core.geometry.interpolation import interpolate, interpolate_rotation


@pytest.fixture
def random():
    return np.random.default_rng(11)


@pytest.fixture
def camera(random):
    q, center = quaternion.normalize(random.normal(size=4)), random.normal(size=3)
    return Camera([[50, 0.3, 21], [0, 48, 17], [0, 0, 1]], pose.to_matrix(*pose.invert(q, center)), 40, 30)


def screw_path(times):
    """A camera on a helix, turning about its axis: everything smooth and known at every time."""
    times = np.asarray(times, np.float64)
    q = quaternion.from_rotation_vector(np.stack([0 * times, 0.05 * times, 0 * times], -1))
    centers = np.stack([np.sin(0.05 * times), 0.01 * times, 1 - np.cos(0.05 * times)], -1)
    intrinsics = np.tile([[50.0, 0, 20], [0, 50, 15], [0, 0, 1]], (len(times), 1, 1))
    intrinsics[:, 0, 0] += times
    return CameraPath(intrinsics, pose.to_matrix(*pose.invert(q, centers)), times, 40, 30)


def read_handheld(shared):
    cameras = json.loads((shared / "assets" / "handheld_camera.json").read_text())
    intrinsics = np.tile(np.eye(3), (len(cameras), 1, 1))
    intrinsics[:, 0, 0] = intrinsics[:, 1, 1] = [c["focal_length"] for c in cameras]
    intrinsics[:, :2, 2] = [c["principal_point"] for c in cameras]
    q = quaternion.from_matrix(np.array([c["orientation"] for c in cameras]))
    t = -quaternion.rotate(q, np.array([c["position"] for c in cameras]))
    return CameraPath(intrinsics, pose.to_matrix(q, t), np.arange(len(cameras)), *cameras[0]["image_size"])


def degrees_between(a, b):
    relative = quaternion.from_matrix(a.world_to_camera[:3, :3] @ b.world_to_camera[:3, :3].T)
    return np.degrees(np.linalg.norm(quaternion.to_rotation_vector(relative)))


def test_project_inverts_unproject(camera, random):
    pixels, depth = random.uniform(0, 40, size=(5, 6, 2)), random.uniform(0.1, 9, size=(5, 6))
    points = camera.unproject(pixels, depth)
    again, again_depth = camera.project(points)
    np.testing.assert_allclose(again, pixels, atol=1e-11)
    np.testing.assert_allclose(again_depth, depth, atol=1e-12)
    tensors, _ = camera.project(torch.tensor(points))
    np.testing.assert_allclose(tensors.numpy(), again, atol=1e-11)
    np.testing.assert_allclose(camera.unproject(torch.tensor(pixels), torch.tensor(depth)).numpy(), points, atol=1e-11)


def test_many_points_are_projected_as_each_of_them(camera, random):
    points = random.normal(size=(2 * camera_room._BLOCK + 1, 3))  # in three parts
    pixels, depth = camera.project(points)
    back = camera.unproject(pixels, depth)
    for rows in (slice(0, 9), slice(-9, None)):
        few = camera.project(points[rows])
        np.testing.assert_array_equal(pixels[rows], few[0])
        np.testing.assert_array_equal(depth[rows], few[1])
        np.testing.assert_array_equal(back[rows], camera.unproject(*few))
    assert len(pixels) == len(depth) == len(back) == len(points)


def test_projection_is_the_pinhole_formula(camera):
    point = np.array([0.3, -0.2, 0.5])
    homogeneous = camera.intrinsics @ (camera.world_to_camera @ [*point, 1])[:3]
    pixel, depth = camera.project(point)
    np.testing.assert_allclose(pixel, homogeneous[:2] / homogeneous[2])
    np.testing.assert_allclose(depth, homogeneous[2])
    np.testing.assert_allclose(camera.world_to_camera @ camera.camera_to_world, np.eye(4), atol=1e-14)
    np.testing.assert_allclose(camera.world_to_camera @ [*camera.center, 1], [0, 0, 0, 1], atol=1e-14)


def test_pixel_centres_are_at_one_half_and_survive_resizing(camera):
    grid = camera.pixel_grid()
    assert grid.shape == (30, 40, 2)
    np.testing.assert_array_equal(grid[0, 0], [0.5, 0.5])
    np.testing.assert_array_equal(grid[29, 39], [39.5, 29.5])
    half = camera.resized(20, 15)
    point = camera.unproject(np.array([13.0, 8.0]), np.array(2.0))
    np.testing.assert_allclose(half.project(point)[0], [6.5, 4.0])
    centre_of_four = grid[:2, :2].mean((0, 1))  # four full pixels become one half-size pixel
    np.testing.assert_allclose(centre_of_four / 2, half.pixel_grid()[0, 0])


def test_projection_gradients(camera):
    points = torch.tensor(camera.unproject(np.array([[3.0, 4], [20, 20]]), np.array([1.0, 2])), requires_grad=True)
    assert torch.autograd.gradcheck(camera.project, points)
    behind = torch.tensor(camera.center[None], requires_grad=True)
    pixels, _ = camera.project(behind)
    (gradient,) = torch.autograd.grad(pixels.sum(), behind)
    assert torch.isfinite(pixels).all() and torch.isfinite(gradient).all()


def test_curves_reproduce_constant_motion_exactly_with_uneven_knots(random):
    times = np.cumsum(random.uniform(0.3, 2, size=9))
    velocity = random.normal(size=(4, 3))
    values = times[:, None, None] * velocity
    spin = random.normal(size=(4, 3)) * 0.2
    q = quaternion.from_rotation_vector(times[:, None, None] * spin)
    for time in np.linspace(times[0], times[-1], 23):
        np.testing.assert_allclose(interpolate(times, values, time), time * velocity, atol=1e-12)
        turned = interpolate_rotation(times, q * random.choice([-1, 1], size=(9, 4, 1)), time)
        expected = quaternion.from_rotation_vector(time * spin)
        np.testing.assert_allclose(np.abs((turned * expected).sum(-1)), 1, atol=1e-12)


def test_curves_have_continuous_velocity_and_the_same_numbers_in_torch(random):
    times = np.array([0.0, 1, 3, 4, 6])
    values, q = (
        random.normal(size=(5, 2, 3)),
        quaternion.normalize(random.normal(3 * quaternion.IDENTITY, size=(5, 2, 4))),
    )
    step = 1e-5
    for curve, knots in ((interpolate, values), (interpolate_rotation, q)):
        for time in (1.0, 3.0, 4.0, 6.0):  # the last: into the coasting
            before = curve(times, knots, time) - curve(times, knots, time - step)
            after = curve(times, knots, time + step) - curve(times, knots, time)
            np.testing.assert_allclose(after / step, before / step, atol=2e-4)
        for time in (-2.0, 0.5, 3.0, 5.2, 9.0):
            in_torch = curve(times, torch.tensor(knots), time)
            np.testing.assert_allclose(in_torch.numpy(), curve(times, knots, time), atol=1e-13)


def test_outside_the_knots_motion_starts_at_full_speed_and_comes_to_rest():
    times, values = np.arange(5.0), np.arange(5.0)[:, None]
    assert interpolate(times, values, 5.0)[0] == pytest.approx(5, abs=0.07)
    assert interpolate(times, values, -1.0)[0] == pytest.approx(-1, abs=0.07)
    assert interpolate(times, values, 1e4)[0] == pytest.approx(4 + 8)


def test_path_interpolation_follows_a_smooth_camera():
    truth = screw_path(np.arange(30))
    known = truth.at_times(np.delete(truth.times, np.arange(3, 30, 8)))
    for time in truth.times[2:-2]:
        guess, camera = known.at(time), truth.at(time)
        assert np.linalg.norm(guess.center - camera.center) < 2e-3 * 0.05
        assert degrees_between(guess, camera) < 1e-5
        np.testing.assert_allclose(guess.intrinsics, camera.intrinsics)
    np.testing.assert_array_equal(known.at(0.0).world_to_camera, truth[0].world_to_camera)


def test_interpolation_error_on_a_real_hand(shared, capsys):
    """Every 8th real camera left out. The hand's tremor between frames bounds what any interpolation can do."""
    truth = read_handheld(shared)
    left_out = np.arange(len(truth)) % 8 == 7
    known = truth.at_times(truth.times[~left_out])
    hidden = np.flatnonzero(left_out)
    step = np.median(np.linalg.norm(np.diff(truth.centers, axis=0), axis=1))
    turn = np.median([degrees_between(truth[i], truth[i + 1]) for i in range(len(truth) - 1)])
    shift = np.median(np.linalg.norm(known.at_times(hidden).centers - truth.centers[hidden], axis=1)) / step
    angles = np.array([degrees_between(known.at(i), truth[i]) for i in hidden])
    nearest = np.array([degrees_between(truth[i - 1], truth[i]) for i in hidden])
    with capsys.disabled():
        print(f"\nhand-held camera, every 8th interpolated: centre {shift:.1%} of a step; rotation median", end=" ")
        print(
            f"{np.median(angles):.3f}, 90% {np.quantile(angles, 0.9):.3f} deg ({np.median(angles) / turn:.0%} of one)"
        )
    assert shift < 0.1
    assert np.median(angles) < 0.5 * np.median(nearest)


def test_single_camera_path_is_constant():
    path = screw_path([4.0])
    np.testing.assert_allclose(path.at(9.0).world_to_camera, path[0].world_to_camera, atol=1e-15)


def test_path_resizes_scales_and_round_trips_as_json(tmp_path):
    path = screw_path(np.arange(5))
    point = np.array([0.1, 0.2, 3.0])
    np.testing.assert_allclose(path.resized(80, 90)[2].project(point)[0], path[2].project(point)[0] * [2, 3])
    np.testing.assert_allclose(path.scaled_world(3)[2].project(3 * point)[0], path[2].project(point)[0])
    path.write(tmp_path / "cameras.json")
    again = CameraPath.read(tmp_path / "cameras.json")
    for name in ("intrinsics", "world_to_camera", "times", "width", "height"):
        np.testing.assert_array_equal(getattr(again, name), getattr(path, name))
    assert CameraPath.from_json(path.to_json()).to_json() == path.to_json()


@pytest.mark.parametrize(
    "content, message",
    [
        ("{", "cannot be read as JSON"),
        ("[]", "not a camera path"),
        ('{"format": "f4x-cameras", "version": 9}', "version 9"),
        ('{"format": "f4x-cameras", "version": 1}', "lacks the entry"),
        ('{"format": "f4x-cameras", "version": 1, "times": "soon"}', "lacks|numbers"),
        (json.dumps(screw_path([0.0, 1]).to_json() | {"times": [1, 1]}), "strictly increase"),
        (json.dumps(screw_path([0.0, 1]).to_json() | {"times": [1, "x"]}), "numbers"),
        (json.dumps(screw_path([0.0, 1]).to_json() | {"times": [1, 2, 3]}), "shape"),
        (json.dumps(screw_path([0.0, 1]).to_json() | {"width": 0}), "1x1"),
    ],
)
def test_broken_camera_files_are_named(content, message, tmp_path):
    file = tmp_path / "cameras.json"
    file.write_text(content)
    with pytest.raises(F4xError, match=message) as error:
        trajectory.read_path(file)
    assert "cameras.json" in str(error.value)


def test_missing_camera_file_is_named(tmp_path):
    with pytest.raises(F4xError, match=r"nowhere\.json"):
        CameraPath.read(tmp_path / "nowhere.json")


def test_trajectories_play_or_freeze_time(tmp_path):
    path = screw_path(np.arange(6))
    assert [view.time for view in trajectory.original(path)] == list(range(6))
    still = trajectory.frozen(path, 2.5)
    assert {view.time for view in still} == {2.5}
    np.testing.assert_array_equal(still[4].camera.world_to_camera, path[4].world_to_camera)
    path.write(tmp_path / "path.json")
    assert [view.time for view in trajectory.read_path(tmp_path / "path.json")] == list(range(6))


def test_orbit_circles_upright_around_the_scene_centre():
    path = screw_path(np.arange(9))
    views = trajectory.orbit(path, degrees=10, depth=2, count=12)
    middle = path[4]
    target = middle.center + 2 * middle.world_to_camera[2, :3]
    for view in views:
        np.testing.assert_allclose(view.camera.project(target)[0], path[4].intrinsics[:2, 2], atol=1e-9)
        assert np.linalg.norm(view.camera.center - middle.center) == pytest.approx(2 * np.tan(np.radians(10)))
        rotation = view.camera.world_to_camera[:3, :3]
        np.testing.assert_allclose(rotation @ rotation.T, np.eye(3), atol=1e-14)
        assert rotation[1] @ middle.world_to_camera[1, :3] > 0.9
    np.testing.assert_allclose(np.mean([view.camera.center for view in views], axis=0), middle.center, atol=1e-12)
    assert views[0].time == 0 and views[-1].time == 8
    assert {view.time for view in trajectory.orbit(path, time=3.0)} == {3.0}
    around = trajectory.orbit(path, around=0.0, degrees=1e-9)[0].camera
    np.testing.assert_allclose(around.world_to_camera, path[0].world_to_camera, atol=1e-9)


def test_a_view_aside_keeps_its_distance_from_the_scene_centre():
    path = screw_path(np.arange(9))
    own, target = path.at(2.5), path.at(2.5).center + 2 * path.at(2.5).world_to_camera[2, :3]
    for right, up in ((18, 0), (-18, 0), (0, 20), (10, 20)):
        camera, time = trajectory.aside(path, 2.5, right=right, up=up, depth=2.0)
        assert time == 2.5
        np.testing.assert_allclose(camera.project(target)[0], own.intrinsics[:2, 2], atol=1e-9)
        assert np.linalg.norm(camera.center - target) == pytest.approx(2)
        x, y, _ = own.world_to_camera[:3, :3] @ (camera.center - own.center)  # in the camera's own axes: right, down
        np.testing.assert_array_equal(np.sign(np.round([x, -y], 9)), np.sign([right, up]))
        cosine = camera.world_to_camera[2, :3] @ own.world_to_camera[2, :3]
        assert cosine == pytest.approx(np.cos(np.radians(right)) * np.cos(np.radians(up)))
    np.testing.assert_allclose(trajectory.aside(path, 3.0).camera.world_to_camera, path[3].world_to_camera, atol=1e-9)


def test_wrong_shapes_are_refused():
    with pytest.raises(F4xError, match="intrinsics"):
        Camera(np.eye(4), np.eye(4), 4, 4)
    with pytest.raises(F4xError, match="finite"):
        Camera(np.eye(3), np.full((4, 4), np.nan), 4, 4)
    with pytest.raises(F4xError, match="at least one"):
        CameraPath(np.zeros((0, 3, 3)), np.zeros((0, 4, 4)), [], 4, 4)


def _shaky():
    """A path that walks to the right and trembles."""
    rng = np.random.default_rng(3)
    poses = np.tile(np.eye(4), (40, 1, 1))
    poses[:, 0, 3] = -0.05 * np.arange(40)
    poses[:, 1, 3] = rng.normal(size=40) * 0.02
    intrinsics = np.tile(np.array([[60.0, 0, 32], [0, 60, 20], [0, 0, 1]]), (40, 1, 1))
    return CameraPath(intrinsics, poses, np.arange(40), 64, 40)


def test_a_stabilised_camera_walks_on_and_trembles_less():
    path = _shaky()
    calm = np.array([view.camera.center for view in trajectory.stabilised(path)])
    np.testing.assert_allclose(calm[:, 0], path.centers[:, 0], atol=1e-9)  # an even walk stays one, to its ends
    inner = slice(8, 32)
    assert np.diff(calm[inner, 1]).std() < 0.2 * np.diff(path.centers[inner, 1]).std()
    assert [view.time for view in trajectory.stabilised(path)] == list(range(40))


def test_bullet_time_stops_swings_and_goes_on():
    path = _shaky()
    views = trajectory.bullet_time(path, 12, degrees=10, count=20)
    assert [view.time for view in views] == [*range(13), *[12.0] * 20, *range(13, 40)]
    looks = np.array([view.camera.world_to_camera[2, :3] for view in views[13:33]])
    angles = np.degrees(np.arctan2(looks[:, 0], looks[:, 2]))
    assert 9 < np.abs(angles).max() <= 10.001 and angles.max() > 5 and angles.min() < -5


def test_slow_motion_has_more_views_of_the_same_path():
    path = _shaky()
    views = trajectory.slow_motion(path, 4)
    assert len(views) == 39 * 4 + 1
    np.testing.assert_allclose([view.time for view in views], np.arange(157) / 4)
    np.testing.assert_allclose(views[8].camera.center, path.centers[2], atol=1e-12)
