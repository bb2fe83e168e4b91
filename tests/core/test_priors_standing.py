"""A camera that stands is known from one that moves by the pictures, and the ground before it from what walks over it."""

from types import SimpleNamespace

import numpy as np
import pytest

from f4x_core.clip import Clip
from f4x_core.geometry.camera import CameraPath
from f4x_core.priors import CamerasConfig, Priors, PriorsConfig
from f4x_core.priors import cameras as cameras_module
from f4x_core.priors import standing_world as world_module
from f4x_core.priors.cameras import provide
from f4x_core.priors.standing import StillnessTest
from f4x_core.priors.standing_world import Contacts, GuessedWorld, Lens, find_contacts, find_horizon, guess_world
from f4x_core.priors.uprights import feet_in_columns, feet_of_uprights
from f4x_core.progress import silent

WIDTH, HEIGHT, FOCAL = 240, 136, 216.0
LENS = Lens(FOCAL, HEIGHT / 2, HEIGHT)


def texture(width, height, seed=0):
    """(height, width) uint8 blurred noise."""
    import cv2

    noise = np.random.default_rng(seed).normal(size=(height, width)).astype(np.float32)
    soft = cv2.GaussianBlur(noise, (0, 0), 2.0)
    return np.clip(128 + 110 * soft / (3 * soft.std()), 0, 255).astype(np.uint8)


def placed(image, x, y):
    """(H, W) float32: the part of a larger image that is seen when it is shifted by x, y pixels."""
    import cv2

    matrix = np.array([[1, 0, x - 40], [0, 1, y - 40]], np.float32)
    return cv2.warpAffine(image, matrix, (WIDTH, HEIGHT), flags=cv2.INTER_CUBIC).astype(np.float32)


def filmed(frames=20, shake=0.0, near=0.0, slide=0.0, covered=0.0, seed=1):
    """(F, H, W) uint8: a background that shifts by `shake` pixels (rms) and slides by `slide` over the clip, with a lower half that
    slides by `near` more and a mover over the fraction `covered` of the width; sensor noise."""
    random = np.random.default_rng(seed)
    back, ground, mover = (texture(WIDTH + 80, HEIGHT + 80, number) for number in (2, 3, 4))
    shifts, pictures = shake / np.sqrt(2) * random.normal(size=(frames, 2)), []
    for time, shift in zip(np.linspace(-0.5, 0.5, frames), shifts, strict=True):
        picture = placed(back, shift[0] + slide * time, shift[1])
        picture[HEIGHT // 2 :] = placed(ground, shift[0] + (slide + near) * time, shift[1])[HEIGHT // 2 :]
        left = int((0.5 + time) * WIDTH * (1 - covered))
        picture[20:120, left : left + int(covered * WIDTH)] = mover[20:120, : int(covered * WIDTH)]
        pictures.append(np.clip(picture + random.normal(size=picture.shape) * 2, 0, 255).astype(np.uint8))
    return np.stack(pictures), shifts


@pytest.mark.parametrize(
    ("film", "stands"),
    [
        ({}, True),
        ({"shake": 0.7}, True),
        ({"covered": 0.35}, True),
        ({"slide": 8.0}, False),
        ({"near": 4.0}, False),
        ({"shake": 0.3, "near": 4.0, "slide": -2.0}, False),
        ({"shake": 6.0}, False),
    ],
    ids=["tripod", "jitter", "large mover", "slides", "parallax", "slow dolly", "hand"],
)
def test_a_camera_stands_when_far_frames_show_the_same_places(film, stands):
    pictures, _ = filmed(**film)
    measured = StillnessTest(pictures.__getitem__, len(pictures), FOCAL).measure()
    assert measured.stands == stands, measured
    assert measured.summary()["stands"] == stands


@pytest.mark.parametrize("shape", [(20, HEIGHT, WIDTH), (3, 9, 16), (1, 40, 60)], ids=["black", "tiny", "one frame"])
def test_pictures_that_show_nothing_tell_nothing(shape):
    test = StillnessTest(np.zeros(shape, np.uint8).__getitem__, shape[0], FOCAL)
    assert not test.measure().stands and test.measure().summary()["jitter_px"] is None
    np.testing.assert_array_equal(test.turns(), np.tile(np.eye(3), (shape[0], 1, 1)))


def test_jitter_becomes_turns_and_noise_does_not():
    pictures, shifts = filmed(shake=0.7)
    turns = StillnessTest(pictures.__getitem__, len(pictures), FOCAL).turns()
    found = FOCAL * turns[:, :2, 2] / turns[:, 2:, 2]
    np.testing.assert_allclose(found - found.mean(0), shifts - shifts.mean(0), atol=0.15)
    np.testing.assert_array_equal(turns[0], np.eye(3))
    calm, _ = filmed()
    np.testing.assert_array_equal(StillnessTest(calm.__getitem__, 20, FOCAL).turns(), np.tile(np.eye(3), (20, 1, 1)))


def clip_and_priors(pictures):
    frames = len(pictures)
    color = np.repeat(pictures[..., None], 3, -1)
    clip = Clip("toy", color, np.arange(frames, dtype=np.float64), 24.0, np.zeros(frames, bool), "toy")
    priors = Priors.empty(clip)
    grid = np.stack(np.meshgrid(np.arange(8.0, WIDTH, 16), np.arange(8.0, HEIGHT, 16)), -1).reshape(-1, 2)
    drift = np.linspace(0, 1.9, frames)[:, None, None]  # as chained flow drifts over a long clip
    priors.tracks = (grid + drift).astype(np.float32)
    priors.tracks_visible = np.ones(priors.tracks.shape[:2], bool)
    priors.tracks_motion = np.zeros(len(grid), np.float32)
    return clip, priors


def test_nothing_is_solved_for_a_standing_camera_whose_tracks_drift(monkeypatch):
    clip, priors = clip_and_priors(filmed(shake=0.5, covered=0.3)[0])
    priors.mask = np.zeros(clip.frames.shape[:3], bool)
    priors.mask[:, :, :40] = priors.mask[:, :, -40:] = (
        True  # what moves fills the border: cameras of all tracks would be tried
    )
    for name in ("_solve", "_or_of_all_tracks"):
        monkeypatch.setattr(cameras_module, name, lambda *all: pytest.fail("a standing camera is not solved"))
    steps = []
    provide(clip, priors, PriorsConfig(), lambda *step: steps.append(step))
    assert priors.camera_kind == "static" and not priors.cameras.centers.any()
    assert priors.statistics["cameras"]["standing"]["stands"] and priors.statistics["cameras"]["standing"]["turned"]
    assert len({step[1:] for step in steps}) > len(clip.frames)  # progress moves with every frame


def test_a_kind_that_is_given_is_kept(monkeypatch):
    clip, priors = clip_and_priors(filmed()[0])
    monkeypatch.setattr(cameras_module, "StillnessTest", lambda *all: pytest.fail("the pictures are not asked"))
    config = PriorsConfig(cameras=CamerasConfig(kind="static"))
    provide(clip, priors, config, silent)
    assert priors.camera_kind == "static"


def walked(horizon, heights=(0.9, 0.4), noise=0.0, people=False, seed=3):
    """Contacts of upright things of `heights` (in camera heights) that walk over a plane seen with the `horizon` at that row."""
    random, tilt = np.random.default_rng(seed), np.arctan((LENS.middle - horizon) / FOCAL)
    rows, sizes, groups = [], [], []
    for number, height in enumerate(heights, 1):
        row = np.linspace(max(horizon + 25, 50), HEIGHT - 8, 25)
        lower = tilt + np.arctan((row - LENS.middle) / FOCAL)
        upper = np.arctan((1 - height) * np.tan(lower)) - tilt
        size = row - LENS.middle - FOCAL * np.tan(upper)
        rows.append(row)
        sizes.append((row - horizon if people else size) * np.exp(noise * random.normal(size=len(row))))
        groups.append(np.full(len(row), 0 if people else number))
    return Contacts(*map(np.concatenate, (rows, sizes, groups)))


@pytest.mark.parametrize("horizon", [-20.0, 30.0, 60.0])
@pytest.mark.parametrize("people", [False, True])
def test_the_horizon_is_where_what_walks_would_vanish(horizon, people):
    contacts = walked(horizon, noise=0.03, people=people)
    found, error = find_horizon(contacts, LENS)
    assert abs(found - horizon) < 2.5 * error < 0.25 * HEIGHT
    wrong = np.arange(len(contacts.row)) % 4 == 0  # one sighting in four is of somebody who jumps
    jumping = Contacts(contacts.row - 20 * wrong, contacts.size, contacts.group)
    assert abs(find_horizon(jumping, LENS)[0] - horizon) < 0.15 * HEIGHT


def test_without_anything_that_walks_the_horizon_is_the_usual_one_and_unsure():
    nothing = Contacts(np.zeros(0), np.zeros(0), np.zeros(0, int))
    found, error = find_horizon(nothing, LENS)
    assert found == pytest.approx(world_module.USUAL_HORIZON * HEIGHT, abs=0.02 * HEIGHT)
    assert error > 0.15 * HEIGHT
    stays = Contacts(np.full(40, 100.0), np.full(40, 30.0), np.ones(40, int))  # who stays in place tells nothing either
    assert find_horizon(stays, LENS)[1] == pytest.approx(error, rel=0.1)


def standing_priors(frames=3, turn=0.0):
    """Priors of a standing camera, turned by `turn` degrees in its last frame, before nothing that moves."""
    angle, matrices = np.radians(turn), np.tile(np.eye(4), (frames, 1, 1))
    matrices[-1, 1:3, 1:3] = [[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]]
    intrinsics = np.tile(np.array([[FOCAL, 0, WIDTH / 2], [0, FOCAL, HEIGHT / 2], [0, 0, 1.0]]), (frames, 1, 1))
    priors = Priors(WIDTH, HEIGHT, np.arange(frames), camera_kind="static")
    priors.cameras = CameraPath(intrinsics, matrices, np.arange(float(frames)), WIDTH, HEIGHT)
    priors.mask = np.zeros((frames, HEIGHT, WIDTH), bool)
    return priors


def test_the_world_is_a_ground_with_an_upright_background():
    priors = standing_priors(turn=0.5)
    world = GuessedWorld(40.0, 3.0, 60.0, 50, False, HEIGHT)
    inverse = world.inverse_depth(priors.cameras)
    rows = np.arange(HEIGHT) + 0.5
    below, column = rows > 60, inverse[0, :, 7]
    np.testing.assert_allclose(column[below] / column[-1], (rows[below] - 40) / (rows[-1] - 40), rtol=1e-5)
    assert column[59] == pytest.approx(column[-1] * (60 - 40) / (rows[-1] - 40), rel=1e-5)  # at its foot
    assert np.ptp(column[40:60]) < 1e-6  # upright
    assert (np.diff(column[:40]) >= 0).all() and column[0] < column[50]  # what is above the horizon is farther
    shift = FOCAL * np.tan(np.radians(0.5))
    moved = np.interp(rows - shift, rows, inverse[2, :, 7])
    np.testing.assert_allclose(moved[70:120], column[70:120], rtol=0.02)


def test_confidence_is_that_of_a_guess_unless_contacts_tell_the_ground():
    guess = GuessedWorld(40.0, 0.2 * HEIGHT, 60.0, 0, False, HEIGHT).confidence()
    assert (guess == world_module.GUESS_CONFIDENCE).all()
    known = GuessedWorld(40.0, 3.0, 60.0, 50, False, HEIGHT).confidence()
    assert (known[:60] == world_module.GUESS_CONFIDENCE).all() and (np.diff(known[60:]) >= 0).all()
    assert 0.2 < known[-1] < 0.5


def test_what_stands_on_the_ground_is_as_far_as_its_foot():
    priors = standing_priors()
    world = GuessedWorld(40.0, 3.0, 50.0, 50, False, HEIGHT)
    feet = np.zeros((HEIGHT, WIDTH))
    feet[20:100, 100:140] = 100.0
    inverse, plain = world.inverse_depth(priors.cameras, feet)[0], world.inverse_depth(priors.cameras)[0]
    np.testing.assert_allclose(inverse[45:99, 120], plain[99, 120], rtol=0.02)
    np.testing.assert_array_equal(inverse[:, 50], plain[:, 50])
    assert plain[30, 120] < inverse[30, 120] < inverse[50, 120]  # above the horizon it leans back to the background


def test_uprights_are_what_has_another_color_than_the_ground():
    random = np.random.default_rng(0)
    picture = np.tile(np.array([90, 95, 100]), (HEIGHT, WIDTH, 1)) + random.integers(-4, 5, (HEIGHT, WIDTH, 1))
    picture[:50] = (200, 190, 160)
    picture[30:90, 60:90] = (200, 40, 40)  # a red box stands on the ground
    picture[110:113] = (230, 230, 230)  # a thin marking lies on it
    clip, priors = SimpleNamespace(frames=np.tile(picture.astype(np.uint8), (3, 1, 1, 1))), standing_priors()
    feet = feet_of_uprights(clip, priors, end=50.0)
    assert abs(feet[70, 75] - 90) < 4 and abs(feet[20, 150] - 50) < 4
    assert not feet[100, 75] and not feet[120, 20]
    noise = SimpleNamespace(frames=random.integers(0, 256, clip.frames.shape, np.uint8))
    assert feet_of_uprights(noise, priors, end=50.0).shape == (HEIGHT, WIDTH)


def test_feet_are_the_lowest_rows_of_runs():
    upright = np.zeros((10, 40), bool)
    upright[2:6, 10:20] = upright[8, 10:20] = True
    feet = feet_in_columns(upright)
    np.testing.assert_allclose(feet[2:6, 10:20], 5.5)
    np.testing.assert_allclose(feet[8, 10:20], 8.5)
    assert not feet[~upright].any()


def test_movers_at_the_border_and_people_tell_no_height_and_who_joins_another_begins_anew():
    priors = standing_priors(frames=16)
    for frame in range(16):
        priors.mask[frame, 30:70, 20:40] = True
        left = 100 - 6 * frame  # walks into the other one, after nine frames
        priors.mask[frame, 40:90, left : left + 14] = True
        priors.mask[frame, 100:, 200:220] = True  # is cut off below
    contacts = find_contacts(priors)
    assert (np.bincount(contacts.group)[1:] >= world_module.MIN_FRAMES).all() and contacts.group.max() == 3
    assert contacts.row.max() <= 90 and set(contacts.size) <= {40.0, 50.0, 60.0}
    world = guess_world(priors)
    assert world.contacts == len(contacts.row) and world.horizon < world.base < HEIGHT
