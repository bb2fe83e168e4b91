"""The check of how far aside a view can be believed: what is displaced by wrong depth, where the right one is known."""

from dataclasses import replace

import numpy as np
import pytest

from benchmarks.quality.displacement import DepthAgainstTruth, displacement, true_believed_degrees
from f4x_core.geometry.camera import Camera
from f4x_core.metrics.believed import MAX_DEGREES, TOLERANCE, DepthEvidence, believed_degrees

WIDTH, HEIGHT, FOCAL = 96, 60, 90.0


def frame_of(error: float, moving_error: float = 0.0, unit: float = 1.0) -> DepthAgainstTruth:
    """A wall at depth 3 whose depth is wrong by `error` either way, pixel by pixel, and a mover in its middle."""
    camera = Camera(np.array([[FOCAL, 0, WIDTH / 2], [0, FOCAL, HEIGHT / 2], [0, 0, 1]]), np.eye(4), WIDTH, HEIGHT)
    sign = np.where(np.indices((HEIGHT, WIDTH)).sum(0) % 2, 1.0, -1.0)
    moving = np.zeros((HEIGHT, WIDTH), bool)
    moving[20:40, 40:60] = True
    wrong = np.where(moving, 1 + moving_error, 1 + error * sign)
    return DepthAgainstTruth(camera, np.full((HEIGHT, WIDTH), 3.0), 3.0 * unit * wrong, moving)


def test_displacement_is_focal_length_times_tangent_times_error():
    frame = frame_of(0.02)
    expected = FOCAL / WIDTH * np.tan(np.radians(5)) * 0.02
    assert displacement(frame, ~frame.moving, 5.0) == pytest.approx(expected, rel=0.1)
    assert displacement(frame, frame.moving, 5.0) == pytest.approx(0, abs=1e-3 * expected)
    assert np.isnan(displacement(frame, np.zeros_like(frame.moving), 5.0))


def test_the_unit_of_the_scene_does_not_count():
    here, there = frame_of(0.0), frame_of(0.0, unit=7.0)
    assert displacement(there, ~there.moving, 10.0) == pytest.approx(displacement(here, ~here.moving, 10.0), abs=1e-9)


@pytest.mark.parametrize("error", [0.03, 0.05, 0.1])
def test_the_formula_believes_what_the_truth_allows(error):
    frames = [frame_of(error, 1.5 * error)] * 2
    true = true_believed_degrees(frames)
    evidence = DepthEvidence(FOCAL / WIDTH, error, None, 0.0, 0.0, 1.5 * error)
    believed = believed_degrees(evidence)
    assert believed.static == pytest.approx(true.static, rel=0.15, abs=0.5)
    assert believed.moving == pytest.approx(true.moving, rel=0.2, abs=0.5)


def test_perfect_depth_and_missing_movers():
    frame = frame_of(0.0)
    still = replace(frame, moving=np.zeros_like(frame.moving))
    assert true_believed_degrees([still]).static == MAX_DEGREES and true_believed_degrees([still]).moving is None
    unknown = replace(frame_of(0.1), depth=np.where(frame.moving, np.nan, frame_of(0.1).depth))
    assert true_believed_degrees([unknown]).moving == 0.5  # a mover that is not there is nowhere to be believed
    assert true_believed_degrees([frame_of(0.1)], 100 * TOLERANCE).static == MAX_DEGREES
