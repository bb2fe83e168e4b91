"""What a rigid world explains, on made-up cameras whose tracks and flow are known."""

import numpy as np
import pytest

from f4x_core.priors import rigid
from f4x_core.priors.bundle import Bundle, from_matrices
from f4x_core.priors.motion import STEP

from .test_priors_second_look import FOCAL, FRAMES, HEIGHT, WIDTH, path, seen_by

CENTRE = np.array([WIDTH / 2, HEIGHT / 2])


def bundle_of(cams) -> Bundle:
    return from_matrices(cams.world_to_camera, FOCAL, CENTRE)


def wall_and_walkers(count=400):
    """(F,n,2) pixels of a wall that stands still, on the left, and of points that each walk their own way, on the right."""
    rng = np.random.default_rng(0)
    world = np.tile(rng.uniform((-3, -2, 4), (3, 2, 8), (count, 3)), (FRAMES, 1, 1))
    walks = world[0, :, 0] > 0
    world[:, walks, 1] += 0.3 * np.sin(np.arange(FRAMES)[:, None] + rng.uniform(0, 6, walks.sum()))
    uv, _ = seen_by(path(), world)
    return uv, ((uv > 0) & (uv < (WIDTH, HEIGHT))).all(-1), walks


def test_the_fraction_of_the_picture_that_points_explain():
    uv, visible, walks = wall_and_walkers()
    cams = path()
    every = rigid.explained_fraction(bundle_of(cams), uv, visible)
    assert rigid.explained_fraction(bundle_of(cams), uv, visible & ~walks) == 1
    assert rigid.explained_fraction(bundle_of(cams), uv, visible & walks) < 0.05
    assert 0.3 < every < 0.7
    again = np.concatenate([uv, *8 * [uv[:, walks]]], 1), np.concatenate([visible, *8 * [visible[:, walks]]], 1)
    assert rigid.explained_fraction(bundle_of(cams), *again) == pytest.approx(
        every, abs=0.05
    )  # dense tracks count once
    assert rigid.track_error(bundle_of(cams), uv, visible & ~walks) < 0.01
    assert rigid.track_error(bundle_of(cams), uv, visible & walks) > 2
    shaken = uv + np.random.default_rng(2).normal(0, 0.3, uv.shape)
    assert rigid.track_error(bundle_of(cams), shaken, visible & ~walks) == pytest.approx(0.3 * np.sqrt(2), rel=0.1)
    brief = visible & (np.arange(FRAMES) < rigid.MIN_FRAMES - 1)[:, None]
    assert rigid.explained_fraction(bundle_of(cams), uv, brief) == 0
    assert rigid.track_error(bundle_of(cams), uv, brief) == np.inf


def test_a_camera_that_only_turns_explains_directions():
    cams, rng = path(), np.random.default_rng(1)
    far = np.tile(1e4 * rng.uniform((-1, -0.6, 2), (1, 0.6, 3), (300, 3)), (FRAMES, 1, 1))
    uv, _ = seen_by(cams, far)
    visible = ((uv > 0) & (uv < (WIDTH, HEIGHT))).all(-1)
    turning = cams.world_to_camera.copy()
    turning[:, :3, 3] = 0
    assert rigid.explained_fraction(from_matrices(turning, FOCAL, CENTRE), uv, visible) == 1
    near, _ = seen_by(cams, far / 5e3)
    assert rigid.explained_fraction(from_matrices(turning, FOCAL, CENTRE), near, visible) < 0.2


def slanting():
    """(H,W) depth of a world that slants."""
    return np.tile(2.0 + (np.arange(WIDTH) + 0.5) / WIDTH, (HEIGHT, 1))


def flows_of(gaps, shift, depth):
    """Signed gap -> (F,H,W,2): a world of `depth (H,W)` seen by the cameras, whose left half stands still; the right half is moved
    by `shift (2,)` pixels a frame besides."""
    cams, rows, columns = path(), np.arange(HEIGHT) + 0.5, np.arange(WIDTH) + 0.5
    pixels = np.stack(np.meshgrid(columns, rows), -1)
    moves = (columns > WIDTH / 2)[None, :, None] * np.asarray(shift, float)
    flows = {}
    for gap in (sign * gap for gap in gaps for sign in (1, -1)):
        flow = np.zeros((FRAMES, HEIGHT, WIDTH, 2), np.float32)
        for t in range(FRAMES):
            if 0 <= t + gap < FRAMES:
                flow[t] = cams[t + gap].project(cams[t].unproject(pixels, depth))[0] - pixels + gap * moves
        flows[gap] = flow
    return flows


@pytest.fixture
def trusted(monkeypatch):
    """Flow whose way back is not asked: the same depth is meant in every frame here. Trust is tested elsewhere."""
    monkeypatch.setattr(rigid, "consistent_at", lambda points, *more: np.ones(len(points), bool))


def test_flow_of_what_stands_still_is_the_cameras(trusted):
    mask = np.ones((FRAMES, HEIGHT, WIDTH), bool)
    mask[:, :40] = False
    score = rigid.flow_beyond_cameras(path(), mask, flows_of((1, 2, 4), (0.0, 2.0), slanting()), (1, 2, 4))
    assert score.shape == (FRAMES, HEIGHT // STEP, WIDTH // STEP)
    assert (score[:, : 40 // STEP - 1] == 1).all()  # nothing was asked there
    below = score[:, 40 // STEP + 1 :]
    assert below[..., : WIDTH // 2 // STEP].max() < 0.05 and below[..., WIDTH // 2 // STEP + 1 :].min() > 0.5


@pytest.mark.parametrize(
    ("depth", "at_border", "moves"),
    [(1.2, False, False), (9.0, False, True), (9.0, True, False), (0.15, False, True)],
    ids=["in front", "behind what it hides", "the background itself", "in the lens"],
)
def test_a_depth_at_which_nothing_stands_is_no_excuse(trusted, depth, at_border, moves):
    place = np.s_[:, :, :60] if at_border else np.s_[:, 40:80, 50:100]
    mask = np.zeros((FRAMES, HEIGHT, WIDTH), bool)
    mask[place] = True
    world = np.where(mask[0], depth, slanting())
    score = rigid.flow_beyond_cameras(path(), mask, flows_of((1, 2, 4), (0.0, 0.0), world), (1, 2, 4))
    inside = score[5, 12:18, 2:13] if at_border else score[5, 12:18, 15:23]
    assert (inside == 1).all() if moves else inside.max() < 0.05


def test_a_wall_between_posts_is_not_behind_all_that_is_around_it(trusted):
    mask = np.zeros((FRAMES, HEIGHT, WIDTH), bool)
    mask[:, 40:80, 80:120] = True
    world = np.full((HEIGHT, WIDTH), 3.0)
    world[:, 55:80] = world[:, 120:145] = 1.2
    score = rigid.flow_beyond_cameras(path(), mask, flows_of((1, 2, 4), (0.0, 0.0), world), (1, 2, 4))
    assert score[5, 12:18, 22:28].max() < 0.05


def test_a_wall_along_which_the_camera_walks_is_in_the_lens_and_stands_still(trusted):
    """A strip of it alone, before what is far, would be something that moves along."""
    mask = np.zeros((FRAMES, HEIGHT, WIDTH), bool)
    mask[:, :, 20:50] = True
    wall = 1 / np.linspace(5.6, 5.2, WIDTH)  # depth of columns
    along = rigid.flow_beyond_cameras(path(), mask, flows_of((1,), (0.0, 0.0), np.tile(wall, (HEIGHT, 1))), (1,))
    assert along[5, 12:18, 7:9].max() < 0.05
    alone = np.where((np.arange(WIDTH) > 20) & (np.arange(WIDTH) < 50), 1 / 5.6, 1 / 0.4)
    moving = rigid.flow_beyond_cameras(path(), mask, flows_of((1,), (0.0, 0.0), np.tile(alone, (HEIGHT, 1))), (1,))
    assert (moving[5, 12:18, 7:11] == 1).all()


def test_what_would_be_behind_the_camera_is_no_point_and_what_is_close_before_it_is():
    """The camera goes ahead: flow towards the middle is no depth's."""
    cams = path()
    here = np.array([[30.0, 60.0], [130.0, 60.0], [30.0, 60.0]])
    others = np.array([9, 10, 12])
    at = np.array([2.0, 2.0, 0.05])
    lands = np.stack([cams[int(t)].project(cams[8].unproject(here, at))[0] for t in others])
    lands[:, 1] = 2 * np.array([100.0, 60.0]) - lands[:, 1]
    fit = rigid._fit_depth(cams, rigid._Matches(8, others, here, lands, np.ones((3, 3))), 1.0)
    assert fit.left[:, 0].max() < 1e-6 and fit.left[:, 1].min() > 1
    assert fit.rho[[0, 2]] == pytest.approx([0.5, 20.0], rel=1e-3)
