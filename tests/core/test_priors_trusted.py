"""Cameras of frames in which most of what is taken to stand moves, grown from those that know the ground."""

from dataclasses import replace

import numpy as np
import pytest
from test_priors_cameras import project, truth

from f4x_core.geometry import quaternion
from f4x_core.priors.bundle import BundleConfig, Observations
from f4x_core.priors.sfm import Solution, TrackSightings
from f4x_core.priors.trusted import MIN_SIGHTINGS, frame_errors, grow_trusted

FRAMES, LATE, GROUND, THING = 30, 20, 120, 90
ALL = np.arange(GROUND + THING)
LENS = BundleConfig(refine_focal=False)


def sightings_of(tracks, visible):
    frame, point = np.nonzero(visible)
    return Observations(frame, point, tracks[frame, point].astype(float), np.ones(len(frame)))


@pytest.fixture(scope="module")
def held():
    """The true cameras, those that a thing draws with it from frame `LATE` on, and what both the ground and the thing show."""
    true = truth(FRAMES, points=GROUND)
    amount = np.maximum(np.arange(FRAMES) - LATE + 1, 0)[:, None] * [0.002, 0.006, 0.0]
    turn = quaternion.to_matrix(quaternion.from_rotation_vector(amount))
    drawn = replace(true, rotation=turn @ true.rotation)
    thing = replace(drawn, points=truth(FRAMES, points=THING, seed=4).points * [0.6, 0.6, 0.5])
    (ground, seen), (held, held_seen) = (project(bundle, 0.2, seed) for seed, bundle in enumerate((true, thing)))
    held_seen[:LATE] = False
    return true, drawn, sightings_of(np.concatenate([ground, held], 1), np.concatenate([seen, held_seen], 1))


def away(found, true):
    """Degrees between the found and the true camera of each frame, beyond what all have in common."""
    relative = found.rotation @ true.rotation.transpose(0, 2, 1)
    relative = relative @ relative[0].T
    return np.rad2deg(np.linalg.norm(quaternion.to_rotation_vector(quaternion.from_matrix(relative)), axis=1))


def test_cameras_grow_from_frames_that_know_the_ground(held):
    true, drawn, seen = held
    start = Solution(drawn, seen, np.ones(FRAMES, bool))
    plain, robust = (frame_errors(drawn, seen, GROUND + THING, rounds) for rounds in (0, 8))
    assert plain[:LATE].max() > 3 and robust[: LATE - 1].max() < 1, "wrong frames move points only where they count"
    assert robust[LATE + 5 :].min() > 1.5, "or nothing has to grow"
    assert away(drawn, true).max() > 3
    found = grow_trusted(start, *2 * [TrackSightings(seen, ALL)], LENS)
    assert found.grown and found.solution.registered.all()
    assert away(found.solution.bundle, true).max() < 0.5
    assert found.solution.error < 1


def test_cameras_that_meet_every_frame_stay_as_they_are(held):
    true, _, seen = held
    ground = seen.keep(seen.point < GROUND)
    start = Solution(true, ground, np.ones(FRAMES, bool))
    found = grow_trusted(start, *2 * [TrackSightings(ground, ALL[:GROUND])], LENS)
    assert not found.grown and found.solution.registered.all()
    assert found.solution.bundle is true and found.solution.observations is ground


def test_a_frame_that_sees_too_little_goes_on_as_before(held):
    _, drawn, seen = held
    last = seen.frame == FRAMES - 1
    few = np.cumsum(last) < MIN_SIGHTINGS
    seen = seen.keep(~last | few)
    found = grow_trusted(Solution(drawn, seen, np.ones(FRAMES, bool)), *2 * [TrackSightings(seen, ALL)], LENS).solution
    assert found.registered.tolist() == [True] * (FRAMES - 1) + [False]
    step = [one.rotation[-1] @ one.rotation[-2].T for one in (drawn, found.bundle)]
    np.testing.assert_allclose(step[0], step[1], atol=1e-3)


def test_frames_without_sightings_have_no_error(held):
    true, _, seen = held
    error = frame_errors(true, seen.keep(seen.frame != 3), GROUND + THING)
    assert np.isnan(error[3]) and np.isfinite(np.delete(error, 3)).all()
