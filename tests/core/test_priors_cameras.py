"""Cameras and depth from synthetic geometry: no pictures are rendered, tracks are projected points."""

from dataclasses import replace

import numpy as np
import pytest

from f4x_core.clip import Clip
from f4x_core.geometry import quaternion
from f4x_core.geometry.camera import CameraPath
from f4x_core.geometry.pose import align_similarity
from f4x_core.priors import CamerasConfig, Priors, PriorsConfig
from f4x_core.priors.bundle import Bundle, BundleConfig, Observations, adjust
from f4x_core.priors.camera_problem import static_shift
from f4x_core.priors.cameras import provide
from f4x_core.priors.point_tracks import PointTracks
from f4x_core.priors.refinement import complete
from f4x_core.priors.sfm import best_focal, choose_covering_points, refocused, solve_with_depth, solve_with_tracks
from f4x_core.progress import silent

WIDTH, HEIGHT, FOCAL = 320, 180, 260.0
PRINCIPAL = np.array([WIDTH / 2, HEIGHT / 2])


def fov(focal):
    return np.rad2deg(2 * np.arctan(WIDTH / 2 / focal))


def truth(frames=12, travel=0.5, turn=0.25, points=300, seed=0):
    """A bundle of cameras that move sideways and turn in front of a deep cloud of points."""
    rng = np.random.default_rng(seed)
    s = np.linspace(-0.5, 0.5, frames)[:, None]
    center = s * np.array([travel, 0.1 * travel, 0.4 * travel]) + 0.02 * travel * np.sin(7 * s)
    rotation = quaternion.to_matrix(quaternion.from_rotation_vector(s * np.array([0.3 * turn, turn, 0.1])))
    xyz = rng.uniform([-1.2, -0.7, 1.0], [1.2, 0.7, 3.0], (points, 3))
    return Bundle(FOCAL, PRINCIPAL, rotation, center, xyz)


def project(bundle, noise=0.0, seed=1):
    """Tracks (F, N, 2) and visibility (F, N) of all points."""
    local = np.einsum("fij,fnj->fni", bundle.rotation, bundle.points[None] - bundle.center[:, None])
    uv = bundle.focals[:, None, None] * local[..., :2] / local[..., 2:] + bundle.principal
    uv += noise * np.random.default_rng(seed).standard_normal(uv.shape)
    inside = (uv > 0).all(-1) & (uv[..., 0] < WIDTH) & (uv[..., 1] < HEIGHT) & (local[..., 2] > 0)
    return uv.astype(np.float32), inside


def observe(bundle, noise=0.0):
    tracks, visible = project(bundle, noise)
    frame, point = np.nonzero(visible)
    return Observations(frame, point, tracks[frame, point].astype(np.float64), np.ones(len(frame)))


def path_error(found, true):
    """Root mean square distance of aligned centres, as a share of the path."""
    s, R, t = align_similarity(found.center, true.center)
    ate = np.sqrt(((s * found.center @ R.T + t - true.center) ** 2).sum(1).mean())
    return ate / np.linalg.norm(np.diff(true.center, axis=0), axis=1).sum()


def clip_and_priors(tracks, visible, motion=None):
    frames = len(tracks)
    pictures = np.random.default_rng(5).integers(0, 256, (frames, HEIGHT, WIDTH, 3), np.uint8)
    clip = Clip("toy", pictures, np.arange(frames, dtype=np.float64), 24.0, np.zeros(frames, bool), "toy")
    priors = Priors.empty(clip)
    priors.tracks, priors.tracks_visible = tracks, visible
    priors.tracks_motion = np.zeros(tracks.shape[1], np.float32) if motion is None else motion
    return clip, priors


def test_adjustment_undoes_disturbed_cameras_points_and_focal():
    true = truth()
    observations = observe(true)
    rng = np.random.default_rng(2)
    wobble = quaternion.to_matrix(quaternion.from_rotation_vector(0.02 * rng.standard_normal((12, 3))))
    start = replace(
        true,
        focal=1.15 * FOCAL,
        rotation=wobble @ true.rotation,
        center=true.center + 0.03 * rng.standard_normal((12, 3)),
        points=true.points + 0.05 * rng.standard_normal(true.points.shape),
    )
    assert np.median(start.errors(observations)) > 5
    found = adjust(start, observations, BundleConfig(iterations=60))
    assert np.median(found.errors(observations)) < 0.02
    assert path_error(found, true) < 0.01
    assert abs(fov(found.focal) - fov(FOCAL)) < 1


@pytest.mark.parametrize(
    ("belief", "zooms", "expected"),
    [(0.0, False, 1.3), (50.0, False, 1.3), (50.0, True, 1.3), (50.0, False, 6.0), (50.0, False, 0.1)],
)
def test_normal_equations_are_the_derivative_of_the_cost(belief, zooms, expected):
    """The gradient that moves cameras, focal lengths and points against finite differences of the robust cost, with priors."""
    from f4x_core.priors import bundle as module

    true = truth(frames=4, points=20)
    if zooms:
        true = replace(true, zoom=np.array([0.9, 1.0, 1.2, 1.1]))
    observations = observe(true, noise=1.0)
    config = BundleConfig(expected_focal=expected * FOCAL, refine_zoom=zooms)
    problem = module._Problem.of(true, true.center[2], 2.0)
    equations = module._normal_equations(problem, module._grouped(observations, 20), config, belief)
    gradient, point_gradient = equations.gradient, equations.point_gradient

    def cost(cameras, focal, points):
        moved = problem.moved(cameras, focal, points, config)
        return (module._costs(moved, observations, config).sum() + module._prior_cost(moved, config, belief)) / 2

    zero, still = np.zeros((4, 7 if zooms else 6)), np.zeros((20, 3))
    h = 1e-6
    for row in (1, 7, 16, 23, *((6, 13, 20, 27) if zooms else ())):
        step = zero.copy()
        step.flat[row] = h
        slope = (cost(step, 0.0, still) - cost(-step, 0.0, still)) / (2 * h)
        assert slope == pytest.approx(gradient[row], rel=1e-4, abs=1e-3)
    assert (cost(zero, h, still) - cost(zero, -h, still)) / (2 * h) == pytest.approx(gradient[-1], rel=1e-4, abs=1e-3)
    for axis in range(3):
        step = still.copy()
        step[3, axis] = h
        slope = (cost(zero, 0.0, step) - cost(zero, 0.0, -step)) / (2 * h)
        assert slope == pytest.approx(point_gradient[3, axis], rel=1e-4, abs=1e-3)


def test_points_at_infinity_are_nothing_special():
    """Half the points a thousand times as far away as the others: cameras and near points come out as they are."""
    true = truth(points=200)
    far = np.arange(200) < 100
    true = replace(true, points=np.where(far[:, None], 1000 * true.points, true.points))
    observations = observe(true, noise=0.05)
    rng = np.random.default_rng(2)
    start = replace(true, center=true.center + 0.05 * rng.standard_normal((12, 3)), points=true.points * 1.2)
    found = adjust(start, observations, BundleConfig(iterations=60, refine_focal=False))
    assert path_error(found, true) < 0.01
    assert np.median(found.errors(observations)) < 0.08
    assert np.isfinite(found.points).all()


def test_own_structure_from_motion_recovers_fov_and_path():
    true = truth(travel=0.8)
    tracks, visible = project(true, noise=0.2)
    static = np.ones(tracks.shape[1], bool)
    start = solve_with_tracks(PointTracks(tracks, visible, static), 1.3 * FOCAL, PRINCIPAL)
    assert start is not None and start.registered.all()
    focused = refocused(start, best_focal(start, BundleConfig(expected_focal=0.9 * WIDTH))[0])
    focused = replace(focused, bundle=adjust(focused.bundle, *_finite(focused), BundleConfig(iterations=40)))
    assert abs(fov(focused.bundle.focal) - fov(FOCAL)) < 1
    solution = complete(focused, PointTracks(tracks, visible, static), np.arange(12.0))
    assert path_error(solution.bundle, true) < 0.01


def _finite(solution):
    return (solution.observations.keep(np.isfinite(solution.bundle.points).all(1)[solution.observations.point]),)


def test_depth_prior_gives_fov_path_and_its_own_scale():
    true = truth(frames=24, travel=0.8)
    tracks, visible = project(true)
    local = np.einsum("fij,fnj->fni", true.rotation, true.points[None] - true.center[:, None])
    depth = np.full((24, HEIGHT, WIDTH), np.nan, np.float32)
    for f in range(24):
        x, y = tracks[f, visible[f]].astype(int).T
        depth[f, y, x] = local[f, visible[f], 2]
    solution, curve = solve_with_depth(PointTracks.all_static(tracks, visible), depth, None, WIDTH)
    assert abs(fov(solution.bundle.focal) - fov(FOCAL)) < 1
    assert len(curve["focal_over_width"]) == len(curve["error_px"]) > 50
    assert path_error(solution.bundle, true) < 0.02
    scale, _, _ = align_similarity(solution.bundle.center, true.center)
    assert scale == pytest.approx(1, abs=0.05)


def test_standing_camera_is_static_in_spite_of_movers():
    true = truth(frames=8, travel=0.0, turn=0.0)
    true = replace(true, rotation=np.tile(np.eye(3), (8, 1, 1)))
    tracks, visible = project(true, noise=0.1)
    motion = np.zeros(300, np.float32)
    motion[:60] = 1
    tracks[:, :60] += np.arange(8)[:, None, None] * 4
    clip, priors = clip_and_priors(tracks, visible, motion)
    assert static_shift(PointTracks(tracks, visible, motion < 0.5)) < 0.5
    provide(clip, priors, PriorsConfig(), silent)
    assert priors.camera_kind == "static"
    np.testing.assert_array_equal(priors.cameras.world_to_camera, np.tile(np.eye(4), (8, 1, 1)))


def test_turning_camera_is_a_pan_with_the_right_turn():
    true = truth(frames=12, travel=0.0, turn=0.6)
    tracks, visible = project(true, noise=0.1)
    clip, priors = clip_and_priors(tracks, visible)
    provide(clip, priors, PriorsConfig(), silent)
    assert priors.camera_kind == "pan"
    assert np.abs(priors.cameras.centers).max() < 1e-9
    assert any("only turns" in line for line in priors.warnings)
    turn = priors.cameras.world_to_camera[-1, :3, :3]
    expected = true.rotation[-1] @ true.rotation[0].T
    angle = np.rad2deg(np.linalg.norm(quaternion.to_rotation_vector(quaternion.from_matrix(turn @ expected.T))))
    assert angle < 2  # of 35 degrees: focal length and turn trade against each other


def zoom_of(frames, factor):
    """Zoom from 1 to `factor` over its geometric mean, starting and stopping softly."""
    along = np.clip(np.linspace(-0.3, 1.3, frames), 0, 1)
    zoom = factor**along
    return zoom / np.exp(np.log(zoom).mean())


@pytest.mark.parametrize("turn", [0.0, 0.3])
def test_a_lens_that_zooms_is_told_from_a_step(turn):
    true = replace(truth(frames=30, travel=0.0, turn=turn, points=400), zoom=zoom_of(30, 1.4))
    clip, priors = clip_and_priors(*project(true, noise=0.3))
    provide(clip, priors, PriorsConfig(), silent)
    focals = priors.cameras.intrinsics[:, 0, 0]
    assert priors.camera_kind == "pan" and not priors.cameras.centers.any()
    assert priors.statistics["cameras"]["zoom"]["factor"] == pytest.approx(1.4, rel=0.03)
    assert focals / focals[0] == pytest.approx(true.focals / true.focals[0], rel=0.02)
    assert "The lens zooms (1.4" in " ".join(priors.warnings)


def test_a_known_focal_length_is_that_of_the_first_frame_of_a_zoom():
    true = replace(truth(frames=30, travel=0.0, points=400), zoom=zoom_of(30, 1.4))
    clip, priors = clip_and_priors(*project(true, noise=0.3))
    config = replace(PriorsConfig(), cameras=CamerasConfig(focal=true.focals[0] / WIDTH))
    provide(clip, priors, config, silent)
    assert priors.cameras.intrinsics[:, 0, 0] == pytest.approx(true.focals, rel=0.02)


@pytest.mark.parametrize("step", [(0.0, 0.0, 0.7), (0.4, 0.1, 0.3)], ids=["forward", "sideways"])
def test_a_step_is_no_zoom(step):
    true = truth(frames=30, turn=0.1, points=400)
    true = replace(true, center=np.linspace(-0.5, 0.5, 30)[:, None] * np.array(step))
    clip, priors = clip_and_priors(*project(true, noise=0.3))
    provide(clip, priors, PriorsConfig(), silent)
    assert priors.camera_kind == "moving" and "zoom" not in priors.statistics["cameras"]
    assert np.ptp(priors.cameras.intrinsics[:, 0, 0]) == 0


def test_moving_camera_from_tracks_alone():
    true = truth(travel=0.8)
    tracks, visible = project(true, noise=0.1)
    clip, priors = clip_and_priors(tracks, visible)
    provide(clip, priors, PriorsConfig(cameras=CamerasConfig(solver="tracks")), silent)
    statistics = priors.statistics["cameras"]
    assert priors.camera_kind == "moving" and statistics["solver"] == "tracks"
    assert abs(statistics["fov_degrees"] - fov(FOCAL)) < 1
    found = Bundle(1, PRINCIPAL, priors.cameras.world_to_camera[:, :3, :3], priors.cameras.centers, np.zeros((0, 3)))
    assert path_error(found, true) < 0.01


@pytest.mark.parametrize("frames", [1, 2])
def test_very_short_clips_get_finite_cameras(frames):
    tracks, visible = project(truth(frames=12))
    clip, priors = clip_and_priors(tracks[:frames], visible[:frames])
    provide(clip, priors, PriorsConfig(), silent)
    assert len(priors.cameras) == frames
    assert np.isfinite(priors.cameras.world_to_camera).all()


def test_no_tracks_at_all_gives_a_standing_camera_and_says_so():
    clip, priors = clip_and_priors(np.zeros((5, 0, 2), np.float32), np.zeros((5, 0), bool))
    provide(clip, priors, PriorsConfig(), silent)
    assert priors.camera_kind == "static"
    assert any("too few points stand still" in line for line in priors.warnings)
    assert priors.statistics["cameras"]["assumed"] == "too few points stand still"


def test_tracks_in_a_plain_sky_hold_no_camera():
    tracks, visible = project(truth(), noise=0.3)
    clip, priors = clip_and_priors(tracks, visible)
    sky = np.full_like(clip.frames, 200) + np.arange(HEIGHT, dtype=np.uint8)[:, None, None] // 4
    sky[:, -9:] = clip.frames[:, -9:]  # a strip of ground holds less than a tenth of them
    for pictures, kind in ((clip.frames, "moving"), (sky, "static")):
        provide(replace(clip, frames=pictures), priors, PriorsConfig(), silent)
        assert priors.camera_kind == kind
    assert priors.statistics["cameras"]["assumed"] == "what stands still has almost no texture to follow"


@pytest.mark.slow
def test_solution_is_the_same_twice():
    tracks, visible = project(truth(frames=8, points=150), noise=0.2)
    paths = []
    for _ in range(2):
        clip, priors = clip_and_priors(tracks, visible)
        provide(clip, priors, PriorsConfig(cameras=CamerasConfig(solver="tracks")), silent)
        paths.append(priors.cameras)
    assert isinstance(paths[0], CameraPath)
    np.testing.assert_array_equal(paths[0].world_to_camera, paths[1].world_to_camera)


def test_chosen_points_hold_every_frame():
    visible = np.zeros((40, 500), bool)
    visible[:20, :200] = True  # long tracks of the first half; then a fast pan, whose tracks last five frames
    for i in range(200, 500):
        first = 20 + (i - 200) % 20
        visible[first : first + 5, i] = True
    chosen = choose_covering_points(visible, 100)
    assert len(chosen) == 100
    assert (np.diff(chosen) > 0).all()
    seen = visible[:, chosen].sum(1)
    assert seen.min() >= 10
    # the q longest of every frame: whatever a frame sees of more than was chosen is no longer than that
    length = visible.sum(0)
    for frame in range(40):
        there = np.flatnonzero(visible[frame])
        own = np.intersect1d(there, chosen)
        rest = np.setdiff1d(there, chosen)
        q = seen.min()
        assert np.sort(length[own])[::-1][q - 1] >= length[rest].max(initial=0)


def test_of_points_that_last_equally_long_those_chosen_are_all_over_the_picture():
    """Tracks come row by row: the first of those that are seen in all frames were the picture's top."""
    rows, columns = 40, 60
    chosen = choose_covering_points(np.ones((24, rows * columns), bool), 200)
    row, column = np.divmod(chosen, columns)
    for place, count in ((row, rows), (column, columns)):
        share = np.bincount(place * 5 // count, minlength=5) / 200
        assert share.min() > 0.16 and share.max() < 0.24


def test_all_points_are_chosen_where_there_is_room_and_unseen_ones_never():
    visible = np.zeros((3, 6), bool)
    visible[:, [0, 2, 5]] = True
    np.testing.assert_array_equal(choose_covering_points(visible, 10), [0, 2, 5])
    assert len(choose_covering_points(np.zeros((3, 0), bool), 10)) == 0


def test_a_fast_pan_in_mid_clip_keeps_its_cameras():
    """Long tracks before, short ones in the pan: chosen by length alone, none would hold its cameras."""
    true = truth(frames=40, travel=0.4, turn=0.3, points=4000)
    fast = np.clip((np.arange(40) - 20) / 20, 0, 1)
    turned = quaternion.to_matrix(quaternion.from_rotation_vector(fast[:, None] * np.array([0, 2.2, 0])))
    rng = np.random.default_rng(3)
    angle = rng.uniform(-0.6, np.where(np.arange(4000) < 3000, 0.6, 2.9))  # most lie where the camera stays long
    distance = rng.uniform(1.5, 5, 4000)
    points = np.stack([distance * np.sin(angle), rng.uniform(-1, 1, 4000), distance * np.cos(angle)], 1)
    true = replace(true, rotation=np.transpose(turned, (0, 2, 1)) @ true.rotation, points=points)
    tracks, visible = project(true, noise=0.2)
    clip, priors = clip_and_priors(tracks, visible)
    known = CamerasConfig(focal=FOCAL / WIDTH)  # two searches for it would take half of the time
    provide(clip, priors, PriorsConfig(cameras=known), silent)
    step = priors.cameras.world_to_camera[1:, :3, :3] @ np.transpose(
        priors.cameras.world_to_camera[:-1, :3, :3], (0, 2, 1)
    )
    expected = true.rotation[1:] @ np.transpose(true.rotation[:-1], (0, 2, 1))
    error = np.rad2deg(np.arccos(np.clip((np.einsum("fij,fij->f", step, expected) - 1) / 2, -1, 1)))
    assert error.max() < 0.5
