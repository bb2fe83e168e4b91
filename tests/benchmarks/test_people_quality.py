"""Scores of found people: perfect for the truth itself, and each figure falls with its own fault alone."""

import json

import numpy as np
import pytest

from benchmarks.quality.people import CROSSINGS, NEAR, score_people
from f4x_core.clip import Clip
from f4x_core.errors import F4xError
from f4x_core.geometry.camera import CameraPath
from f4x_core.priors import Priors, PriorsConfig
from f4x_core.priors.joints import HIPS, JOINTS, NAMES, turn_to_ray
from f4x_core.priors.synthetic import TruePeople, Truth, provide_people
from f4x_core.progress import silent

FRAMES, HEIGHT, WIDTH, TALL = 3, 90, 120, 1.8


def a_body(x: float, z: float) -> np.ndarray:
    """Joints (33, 3) of somebody seen from the side, the left arm and leg in front of the right ones; y points down."""
    up = {"nose": 1.6, "shoulder": 1.4, "elbow": 1.15, "wrist": 0.9, "hip": 0.9, "knee": 0.5, "ankle": 0.1}
    body = np.zeros((JOINTS, 3))
    for i, name in enumerate(NAMES):
        height = next(
            (high for part, high in up.items() if part in name), 0.05 if "heel" in name or "toes" in name else 1.0
        )
        body[i] = x + 0.01 * (i % 5), 1 - height, z - 0.15 * ("left" in name) + 0.15 * ("right" in name)
    return body


@pytest.fixture
def truth() -> Truth:
    matrices = np.tile(np.eye(4), (FRAMES, 1, 1))
    lens = np.tile(np.array([[100.0, 0, 60], [0, 100, 45], [0, 0, 1]]), (FRAMES, 1, 1))
    cameras = CameraPath(lens, matrices, np.arange(float(FRAMES)), WIDTH, HEIGHT)
    joints = np.array([[a_body(-1 + 0.1 * t, 4), a_body(0.8, 5)] for t in range(FRAMES)])
    who = np.zeros((FRAMES, HEIGHT, WIDTH), np.uint8)
    for t in range(FRAMES):
        for person in range(2):
            uv, _ = cameras[t].project(joints[t, person])
            left, top = np.maximum(uv.min(0).astype(int) - 2, 0)
            right, bottom = uv.max(0).astype(int) + 3
            who[t, top:bottom, left:right] = person + 1
    who[:, 57:, 66:] = 0  # the second one stands behind something
    flow = np.zeros((FRAMES, HEIGHT, WIDTH, 2), np.float32)
    depth = np.full((FRAMES, HEIGHT, WIDTH), 4, np.float32)
    return Truth(cameras, depth, flow, flow, who > 0, TruePeople(who, joints, np.array([TALL, TALL])))


@pytest.fixture
def found(truth) -> Priors:
    clip = Clip(
        "toy",
        np.zeros((FRAMES, HEIGHT, WIDTH, 3), np.uint8),
        np.arange(float(FRAMES)),
        24.0,
        np.zeros(FRAMES, bool),
        "toy",
    )
    priors = Priors.empty(clip)
    priors.scratch.of_providers["truth"] = truth
    provide_people(clip, priors, PriorsConfig(), silent)
    return priors


def test_true_people_become_priors(truth, found):
    assert found.people_joints.shape == found.people_metres.shape == (FRAMES, 2, JOINTS, 3)
    np.testing.assert_array_equal(found.people, truth.people.who)
    assert (found.people_joints[:, 0, :, 2] == 1).all()
    hidden = found.people_joints[0, 1, :, 2] == 0
    assert hidden[NAMES.index("left ankle")] and not hidden[NAMES.index("nose")]
    np.testing.assert_allclose(found.people_metres[:, :, list(HIPS)].mean(2), 0, atol=1e-6)
    lower = found.people_metres[0, 0, NAMES.index("left ankle")] - found.people_metres[0, 0, NAMES.index("left hip")]
    along_camera = turn_to_ray(found.people_joints[0, :1], truth.cameras[0].intrinsics)[0] @ lower
    np.testing.assert_allclose(along_camera[1], 0.8, atol=1e-6)
    assert lower[1] != pytest.approx(0.8, abs=1e-4)  # from where they are seen, upright people lean


def test_somebody_who_is_not_seen_has_no_joints(truth):
    who = np.where(truth.people.who == 2, 0, truth.people.who)
    pixels = TruePeople(who, truth.people.joints, truth.people.heights).pixels(0, truth.cameras[0])
    assert np.isfinite(pixels[0]).all() and np.isnan(pixels[1]).all()


def test_the_truth_scores_full_marks(truth, found):
    for score in score_people(found, truth):
        assert (score.frames, score.found, score.iou, score.joints, score.limb_joints, score.ordered) == (
            FRAMES,
            *[1] * 5,
        )
        assert score.crossings > 0 and score.joint_error < 1e-5
        assert 0.3 < score.height < 0.6


def test_each_fault_lowers_its_own_figure(truth, found):
    found.people_metres[..., 2] *= -1  # limbs behind in place of in front
    found.people_joints[:, 0, :, 0] += 2 * NEAR * 100 * TALL / 4  # pixels
    found.people[0, found.people[0] == 2] = 0
    first, second = score_people(found, truth)
    assert (first.iou, first.joints, first.ordered) == (1, 0, 0)
    assert (second.joints, second.found, second.iou) == (1, pytest.approx(2 / 3), pytest.approx(2 / 3))


def test_nobody_found_is_zero(truth, found):
    found.people[:], found.people_joints, found.people_metres = 0, *np.zeros((2, FRAMES, 0, JOINTS, 3))
    for score in score_people(found, truth):
        assert (score.found, score.iou, score.crossings) == (0, 0, 0) and np.isnan(score.joints)


def test_limbs_that_meet_in_a_joint_do_not_cross():
    assert all(not set(first) & set(second) for first, second in CROSSINGS)
    assert ((13, 15), (12, 24)) in CROSSINGS and ((11, 13), (11, 23)) not in CROSSINGS


@pytest.mark.parametrize("joints", [None, np.zeros((FRAMES, 2, JOINTS, 3)), np.full((FRAMES, 1, JOINTS, 3), np.nan)])
def test_joints_that_do_not_fit_are_one_sentence(tmp_path, joints):
    if joints is not None:
        np.save(tmp_path / "joints.npy", joints)
    with pytest.raises(F4xError, match=r"joints\.npy"):
        TruePeople.read(tmp_path, [{"index": 2, "height": 1.8}], np.zeros((FRAMES, 4, 4), np.uint16))


def test_a_damaged_list_of_people_is_one_sentence(tmp_path):
    np.save(tmp_path / "joints.npy", np.zeros((FRAMES, 1, JOINTS, 3)))
    with pytest.raises(F4xError, match=r"truth\.json: damaged"):
        TruePeople.read(tmp_path, json.loads('[{"index": 2}]'), np.zeros((FRAMES, 4, 4), np.uint16))
