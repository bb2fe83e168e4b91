"""The oracle ladder mixes true and offline priors field by field, in one unit, and changes neither."""

import numpy as np
import pytest

from benchmarks.studies import oracle_ladder
from benchmarks.studies.oracle_ladder import RUNGS, mix_priors, mixtures, prior_errors
from f4x_core.geometry.camera import CameraPath
from f4x_core.priors import Priors

FRAMES, HEIGHT, WIDTH = 5, 12, 20
UNIT = 1.6
"""True units in one of the offline priors."""
LENS = 1.1
"""Offline focal length / true one."""
FARTHER = 1.5
"""Offline depth of what moves is so many times too large beside that of the rest."""


def path(scale: float = 1.0, lens: float = 1.0, shift: float = 0.0) -> CameraPath:
    """A camera that goes sideways and up."""
    intrinsics = np.array([[18.0 * lens, 0, WIDTH / 2], [0, 18.0 * lens, HEIGHT / 2], [0, 0, 1]])
    views = np.tile(np.eye(4), (FRAMES, 1, 1))
    times = np.arange(FRAMES, dtype=float)
    views[:, :3, 3] = scale * np.stack([0.1 * times, 0.03 * times**2 + shift * times, 0 * times], 1)
    return CameraPath(np.tile(intrinsics, (FRAMES, 1, 1)), views, times, WIDTH, HEIGHT)


def priors(offline: bool) -> Priors:
    """A wall at depth 2 before which the middle moves at depth 1; the offline ones are wrong in every field."""
    mask = np.zeros((FRAMES, HEIGHT, WIDTH), bool)
    mask[:, 4:8, 6:12] = True
    depth = np.where(mask, np.float32(1), np.float32(2))
    tracks = np.stack([np.full((FRAMES, 2), 2.5), np.full((FRAMES, 2), (8.5, 5.5))], 1).reshape(FRAMES, 2, 2)
    tracks = tracks.astype(np.float32)
    if offline:
        depth = np.where(mask, FARTHER * depth, depth) / np.float32(UNIT)
        mask = np.roll(mask, -6, axis=2)
        tracks = tracks[:, [1, 0, 1]] + np.float32(0.25)
    return Priors(
        width=WIDTH,
        height=HEIGHT,
        frames=np.arange(FRAMES),
        camera_kind="moving",
        cameras=path(1 / UNIT, LENS, shift=0.005) if offline else path(),
        depth=depth.astype(np.float32),
        depth_confidence=np.full(mask.shape, 0.5 if offline else 1.0, np.float16),
        motion=mask.astype(np.float16),
        mask=mask,
        tracks=tracks,
        tracks_visible=np.ones(tracks.shape[:2], bool),
        tracks_motion=np.array([1, 0, 1] if offline else [0, 1], np.float32),
        people=mask.astype(np.uint8),
    )


FIELDS = ("depth", "depth_confidence", "motion", "mask", "people", "tracks", "tracks_motion")
CHANGED = {
    "camera poses": (),
    "focal length": (),
    "depth of the background": ("depth_confidence",),
    "depth of moving objects": ("depth", "depth_confidence"),
    "tracks": ("tracks", "tracks_motion"),
    "masks": ("motion", "mask", "people", "tracks_motion"),
}


@pytest.mark.parametrize("rung", RUNGS)
def test_one_rung_changes_its_own_fields_only(rung):
    true = priors(False)
    mixed = mix_priors(true, priors(True), {rung})
    changed = {
        name
        for name in FIELDS
        if getattr(mixed, name).shape != getattr(true, name).shape
        or not np.allclose(getattr(mixed, name).astype(float), getattr(true, name).astype(float), rtol=1e-5)
    }
    assert changed == set(CHANGED[rung])
    same_poses = np.array_equal(mixed.cameras.world_to_camera, true.cameras.world_to_camera)
    assert same_poses == (rung != "camera poses")
    lens = mixed.cameras.intrinsics[0, 0, 0] / true.cameras.intrinsics[0, 0, 0]
    assert lens == pytest.approx(LENS if rung == "focal length" else 1)


def test_what_is_replaced_alone_comes_in_the_true_unit():
    true, offline = priors(False), priors(True)
    poses = mix_priors(true, offline, {"camera poses"}).cameras
    length = np.linalg.norm(poses.centers[-1] - poses.centers[0])
    assert length == pytest.approx(np.linalg.norm(true.cameras.centers[-1] - true.cameras.centers[0]), rel=0.02)
    depth = mix_priors(true, offline, {"depth of moving objects"}).depth
    np.testing.assert_allclose(depth[true.mask], FARTHER, rtol=1e-5)  # its own mean distance stays wrong
    np.testing.assert_array_equal(depth[~true.mask], 2)


def test_none_is_the_truth_and_all_are_the_offline_ones():
    true, offline = priors(False), priors(True)
    before = {name: getattr(true, name).copy() for name in FIELDS}
    nothing = mix_priors(true, offline, ())
    for name in FIELDS:
        np.testing.assert_array_equal(getattr(nothing, name), before[name])
    assert mix_priors(true, offline, RUNGS) is offline
    mix_priors(true, offline, RUNGS[:-1])
    for name in FIELDS:
        np.testing.assert_array_equal(getattr(true, name), before[name])


def test_tracks_move_where_the_mask_in_use_says_so():
    true, offline = priors(False), priors(True)
    np.testing.assert_array_equal(mix_priors(true, offline, {"masks"}).tracks_motion, [0, 0])  # the mask is elsewhere
    np.testing.assert_array_equal(mix_priors(true, offline, {"tracks"}).tracks_motion, [1, 0, 1])


def test_every_rung_is_climbed_alone_together_and_left_out():
    labels, replaced = zip(*mixtures(), strict=True)
    assert labels[0] == "none" and replaced[labels.index("all")] == set(RUNGS) and len(labels) == 2 * len(RUNGS) + 2
    assert replaced[labels.index("all but masks")] == set(RUNGS) - {"masks"}


def test_errors_of_the_offline_priors_are_measured():
    errors = prior_errors(priors(False), priors(True))
    assert errors["depth error static, unit by depth"] == pytest.approx(0, abs=1e-6)
    assert errors["depth error moving, unit by depth"] == pytest.approx(FARTHER - 1, rel=1e-5)
    assert errors["depth error static, unit by cameras"] < 0.03  # the shift of the path
    assert errors["focal length, offline / true"] == pytest.approx(LENS) and errors["masks, IoU"] == 0


def test_losses_are_against_all_priors_true():
    first = {"seen surfaces (dB)": 28.0, "moving (dB)": None, "static (dB)": 29.0}
    row = {"seen surfaces (dB)": 25.5, "moving (dB)": 20.0, "static (dB)": 29.5}
    assert oracle_ladder._losses(row, [first]) == {
        "lost (dB)": 2.5,
        "lost, moving (dB)": None,
        "lost, static (dB)": -0.5,
    }
    rows = [
        {"clip": "a", "offline": name, "lost (dB)": lost}
        for name, lost in (("none", 0.0), ("tracks", 0.4), ("masks", 1.25), ("all", 3.0))
    ]
    assert oracle_ladder._words(rows) == [
        "a: all priors offline cost 3.0 dB on seen surfaces 10 degrees off the path; alone, masks cost most, 1.2 dB."
    ]
