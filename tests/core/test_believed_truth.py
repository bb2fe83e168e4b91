"""Angles up to which a view can be believed, against the displacement that wrong depth brings where the right one is known."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import pytest

from f4x_core.geometry import trajectory
from f4x_core.geometry.camera import Camera, CameraPath
from f4x_core.metrics.believed import MAX_DEGREES, TOLERANCE, Believed, DepthEvidence, believed_degrees

STEP_DEGREES = 0.5
"""Step in which the angle is found."""
WIDTH, HEIGHT, FOCAL = 96, 60, 90.0


@dataclass(frozen=True)
class DepthAgainstTruth:
    """One frame: how deep things are and how deep they should be, in the true world's unit."""

    camera: Camera
    """The true one."""
    true: np.ndarray
    """(H,W) z depth, NaN for the background at infinity."""
    depth: np.ndarray
    """(H,W) that of the scene, in any unit; NaN where it has none."""
    moving: np.ndarray
    """(H,W) bool, by the truth."""


def displacement(frame: DepthAgainstTruth, region: np.ndarray, degrees: float) -> float:
    """Median distance (picture widths) by which wrong depth displaces a `region (H,W)` seen from `degrees` to the right.

    The unit of the scene is that of its median static depth, so that only the shape counts; the camera swings about the median
    true depth. What the scene does not show at all is displaced without limit. NaN where nothing of the region is in that view.
    """
    known = np.isfinite(frame.true)
    both = known & np.isfinite(frame.depth)
    reference = both & ~frame.moving if (both & ~frame.moving).any() else both
    depth = frame.depth * (np.median(frame.true[reference]) / np.median(frame.depth[reference]))
    pixels, chosen = frame.camera.pixel_grid(), known & region
    path = CameraPath(
        frame.camera.intrinsics[None],
        frame.camera.world_to_camera[None],
        np.zeros(1),
        frame.camera.width,
        frame.camera.height,
    )
    aside = trajectory.aside(path, 0.0, right=degrees, depth=float(np.median(frame.true[known]))).camera
    there, ahead = aside.project(frame.camera.unproject(pixels[chosen], frame.true[chosen]))
    lands, before = aside.project(frame.camera.unproject(pixels[chosen], depth[chosen]))
    inside = (ahead > 0) & (there >= 0).all(-1) & (there < [aside.width, aside.height]).all(-1)
    if not inside.any():
        return float("nan")
    missed = np.where(np.isfinite(before) & (before > 0), np.linalg.norm(lands - there, axis=-1), np.inf)[inside]
    return float(np.median(missed)) / aside.width


def true_believed_degrees(frames: Sequence[DepthAgainstTruth], tolerance: float = TOLERANCE) -> Believed:
    """Angles from which on the mean over frames of `displacement` is more than `tolerance`; at most `MAX_DEGREES`."""

    def limit(regions: list[np.ndarray]) -> float:
        for degrees in np.arange(STEP_DEGREES, MAX_DEGREES, STEP_DEGREES):
            missed = [displacement(frame, region, degrees) for frame, region in zip(frames, regions, strict=True)]
            if not np.isnan(missed).all() and np.nanmean(missed) > tolerance:
                return float(degrees)
        return MAX_DEGREES

    static = limit([~frame.moving for frame in frames])
    has_movers = any((frame.moving & np.isfinite(frame.true)).any() for frame in frames)
    return Believed(static, limit([frame.moving for frame in frames]) if has_movers else None)


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
