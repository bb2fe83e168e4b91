"""People: crops and masks, who counts as moving, relief of bodies, and real clips where the networks are installed."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from f4x_core.clip import Clip
from f4x_core.geometry.camera import CameraPath
from f4x_core.people import networks, provider
from f4x_core.people.finding import same_body
from f4x_core.people.networks import POSE_SIZE, Crop, Pose, box_overlap
from f4x_core.priors import Priors, PriorsConfig
from f4x_core.priors.body_depth import THICKNESS, add_relief, place_people
from f4x_core.priors.contact import MOVING_CONFIDENCE, DepthMaps
from f4x_core.priors.flow import provide as provide_flow
from f4x_core.priors.joints import FEET, JOINTS, LIMBS, NAMES
from f4x_core.priors.moving_people import with_people
from f4x_core.progress import silent

CLIPS = Path(__file__).resolve().parents[3] / "shared" / "clips"


def pose_at(center, side, angle=0.0, **changes):
    """A pose whose mask is the inner half of its crop and whose joints fill it."""
    logits = np.full((POSE_SIZE, POSE_SIZE), -9.0, np.float32)
    quarter = POSE_SIZE // 4
    logits[quarter:-quarter, quarter:-quarter] = 9
    crop = Crop(np.array(center, np.float64), side, angle)
    spread = np.random.default_rng(0).uniform(-side / 4, side / 4, (JOINTS, 2))
    made = Pose(1.0, crop.center + spread, np.ones(JOINTS), np.zeros((JOINTS, 3)), logits, crop, crop)
    return replace(made, **changes)


def clip_of(frames):
    return Clip("test", frames, np.arange(len(frames), dtype=float), 24.0, np.zeros(len(frames), bool), "test")


def priors_with(people, width=80, height=60, frames=3):
    """Priors of `frames` equal frames with the people `(index map (H, W), joints (33, 3), metres (33, 3))` given."""
    priors = Priors(width=width, height=height, frames=np.arange(frames))
    who = np.zeros((height, width), np.uint8)
    for index, (mask, _, _) in enumerate(people):
        who[mask] = index + 1
    priors.people = np.repeat(who[None], frames, 0)
    priors.people_probability = (priors.people > 0).astype(np.float16)
    shape = (1, len(people), JOINTS, 3)
    joints = np.array([person[1] for person in people], np.float32).reshape(shape)
    metres = np.array([person[2] for person in people], np.float32).reshape(shape)
    priors.people_joints, priors.people_metres = np.repeat(joints, frames, 0), np.repeat(metres, frames, 0)
    return priors


def rectangle(left, top, right, bottom, width=80, height=60):
    mask = np.zeros((height, width), bool)
    mask[top:bottom, left:right] = True
    return mask


def test_every_limb_names_joints():
    assert len(NAMES) == JOINTS == 33 == len(set(NAMES))
    assert {joint for pairs in LIMBS.values() for pair in pairs for joint in pair} <= set(range(JOINTS))


@pytest.mark.parametrize("angle", [0.0, 0.7, np.pi, -2.0])
def test_a_crop_is_upright_for_its_person(angle):
    head = np.array([50.0, 40.0]) + 20 * np.array([np.sin(angle), -np.cos(angle)])
    crop = Crop.around(np.array([50.0, 40.0]), head)
    to_picture = crop.to_picture(100)
    assert crop.side == pytest.approx(2 * 1.25 * 20)
    np.testing.assert_allclose(to_picture @ [50, 50, 1], crop.center, atol=1e-9)
    np.testing.assert_allclose(to_picture @ [50, 50 - 40, 1], head, atol=1e-9)  # .4 of the side above the center


@pytest.mark.parametrize("angle", [0.0, np.pi / 2, np.pi])
@pytest.mark.parametrize("step", [1, 2])
def test_a_mask_lies_where_its_crop_does(angle, step):
    mask = pose_at((41, 30), 40, angle).mask(60, 80, step) > 0.5
    y, x = step * (np.mgrid[: 60 // step, : 80 // step] + 0.5)
    inside = (abs(x - 41) < 10) & (abs(y - 30) < 10)
    assert (mask ^ inside).sum() <= 0.15 * inside.sum()


def test_a_crop_outside_the_picture_shows_nobody():
    assert not pose_at((500, 500), 40).mask(60, 80).any()


def test_two_poses_of_one_body_are_one_person():
    one = pose_at((40, 30), 40)
    assert same_body(one, pose_at((42, 30), 40), (60, 80))
    assert not same_body(one, pose_at((70, 30), 40), (60, 80))
    turned = pose_at((41, 30), 40, np.pi, joints=one.joints[::-1] + 25)
    assert same_body(one, turned, (60, 80))  # other joints, the same mask


def test_boxes_overlap_by_their_union():
    assert box_overlap(np.array([0, 0, 2, 2]), np.array([1, 0, 3, 2])) == pytest.approx(1 / 3)
    assert box_overlap(np.array([0, 0, 1, 1]), np.array([2, 2, 3, 3])) == 0


def test_without_the_package_nobody_is_found_and_one_sentence_says_why(monkeypatch):
    monkeypatch.setattr(networks, "RUNTIME", "no_such_runtime")
    frames = np.zeros((3, 60, 80, 3), np.uint8)
    priors = Priors.empty(clip_of(frames))
    provider.provide(clip_of(frames), priors, PriorsConfig(), silent)
    assert priors.people_joints.shape == (3, 0, JOINTS, 3) and not priors.people.any()
    assert len(priors.warnings) == 1 and "pip install --no-deps" in priors.warnings[0]
    priors.validate(["people", "people_probability", "people_joints", "people_metres"])


def test_a_moving_person_counts_whole_and_a_doubtful_border_does_not():
    person = rectangle(30, 10, 45, 50)
    priors = priors_with([(person, np.ones((JOINTS, 3)), np.zeros((JOINTS, 3)))])
    upper, wall, ball = rectangle(30, 10, 45, 40), rectangle(60, 0, 80, 60), rectangle(5, 20, 15, 30)
    mask = np.repeat((upper | wall | ball)[None], 3, 0)
    motion = np.where(wall, 0.7, np.where(mask[0], 0.9, 0.1))[None].repeat(3, 0)
    found = with_people(mask, motion, priors)
    assert found[:, person].all() and found[:, ball].all() and not found[:, wall].any()
    surer = with_people(mask, np.where(wall, 0.9, motion), priors)
    assert surer[:, wall].all()


def test_a_person_who_stands_changes_no_mask():
    priors = priors_with([(rectangle(30, 10, 45, 50), np.ones((JOINTS, 3)), np.zeros((JOINTS, 3)))])
    mask = np.repeat(rectangle(60, 0, 80, 60)[None], 3, 0)
    assert with_people(mask, mask * 0.8, priors) is mask


def body(center=(40.0, 30.0), pixels_per_metre=20.0):
    """Joints of somebody who faces the camera, in pixels and metres, whose left hand is half a meter nearer than the body."""
    rng = np.random.default_rng(1)
    metres = np.column_stack([rng.uniform(-0.4, 0.4, JOINTS), rng.uniform(-0.9, 0.9, JOINTS), np.zeros(JOINTS)])
    arm = [15, 17, 19, 21]
    metres[arm] = [0.6, -0.3, -0.5]
    joints = np.column_stack([np.array(center) + pixels_per_metre * metres[:, :2], np.ones(JOINTS)])
    return joints, metres


def test_a_hand_that_is_nearer_gets_the_depth_that_its_joints_say():
    joints, metres = body()
    person = rectangle(28, 10, 60, 52)
    priors = priors_with([(person, joints, metres)], frames=5)
    intrinsics = np.tile(np.array([[80.0, 0, 40], [0, 80, 30], [0, 0, 1]]), (5, 1, 1))
    priors.cameras = CameraPath(intrinsics, np.tile(np.eye(4), (5, 1, 1)), np.arange(5.0), 80, 60)
    inverse = np.full((5, 60, 80), 0.5)  # two units away, and 80 / 20 = 4 m: half a unit a meter
    assert add_relief(inverse, np.repeat(person[None], 5, 0), priors) == 1
    hand = tuple(np.floor(joints[15, :2]).astype(int)[::-1])
    assert 1 / inverse[2][hand] == pytest.approx(2 - 0.25, abs=0.02)
    assert 1 / inverse[2, 40, 38] == pytest.approx(2, abs=0.05)
    assert (inverse[:, ~person] == 0.5).all()


def test_a_measured_depth_keeps_its_shape():
    joints, metres = body()
    priors = priors_with([(rectangle(28, 10, 60, 52), joints, metres)])
    priors.cameras = CameraPath(np.tile(np.eye(3), (3, 1, 1)), np.tile(np.eye(4), (3, 1, 1)), np.arange(3.0), 80, 60)
    inverse = np.full((3, 60, 80), 0.5)
    assert add_relief(inverse, np.zeros((3, 60, 80), bool), priors) == 0
    assert (inverse == 0.5).all()


WALKER = 6.0
"""Meters to the person of `on_a_plain`, and units of the scene."""


def on_a_plain(frames=12, hop=(), unsteady=0.0):
    """Priors of somebody who walks across a plain 1.5 m below the camera, and their maps: depth is known but for the person.

    hop: frames in which they are .3 m above the ground; unsteady: scatter of the logarithm of the joints' size.
    """
    rng, focal, height, width = np.random.default_rng(2), 180.0, 180, 240
    intrinsics = np.tile(np.array([[focal, 0, 120], [0, focal, 60], [0, 0, 1]]), (frames, 1, 1))
    cameras = CameraPath(intrinsics, np.tile(np.eye(4), (frames, 1, 1)), np.arange(float(frames)), width, height)
    y, x = np.mgrid[:height, :width] + 0.5
    plain = np.broadcast_to(np.maximum((y - 60) / focal / 1.5, 0.02), (frames, height, width)).copy()
    metres = np.column_stack([rng.uniform(-0.2, 0.2, JOINTS), rng.uniform(-0.8, 0.6, JOINTS), np.zeros(JOINTS)])
    metres[list(FEET)] = [(-0.1, 0.9, -0.1), (0.1, 0.9, 0.1), (-0.1, 0.9, -0.2), (0.1, 0.9, 0.2)]
    masks, joints = np.zeros((frames, height, width), bool), np.zeros((frames, JOINTS, 3))
    for frame in range(frames):
        middle = np.array([0.05 * frame - 0.3, 0.6 - 0.3 * (frame in hop), WALKER])
        size = np.exp(unsteady * rng.standard_normal())
        joints[frame, :, :2] = (middle + metres)[:, :2] / WALKER * focal * size + [120, 60]
        joints[frame, :, 2] = 1
        feet = joints[frame, list(FEET)]
        left, right = feet[:, 0].min() - 3, feet[:, 0].max() + 3
        masks[frame] = (x > left) & (x < right) & (y > feet[:, 1].max() - 50) & (y < feet[:, 1].max())
    priors = priors_with([(masks[0], joints[0], metres)], width, height, frames)
    priors.cameras, priors.mask, priors.camera_kind = cameras, masks, "moving"
    priors.people[:] = masks
    priors.people_probability[:] = masks
    priors.people_joints[:, 0] = joints
    return priors, DepthMaps(plain, np.full(plain.shape, 0.5), np.full(plain.shape, 0.5), masks)


@pytest.mark.parametrize("hop", [(), (4, 5, 6)])
def test_who_stands_is_where_their_feet_are_and_who_hops_stays_at_that_distance(hop):
    priors, maps = on_a_plain(hop=hop)
    placed = place_people(maps, priors)
    assert len(placed.frames) == 1 and (placed.pixels == maps.moving).all()
    for frame, mask in enumerate(maps.moving):
        assert np.median(1 / maps.inverse[frame][mask]) == pytest.approx(WALKER - THICKNESS, rel=0.03)
    assert (maps.confidence[maps.moving] <= MOVING_CONFIDENCE).all()


def test_who_rides_has_the_distance_of_the_region():
    priors, maps = on_a_plain()
    horse = np.stack([np.roll(mask, 30, 0) & (np.arange(180) > 100)[:, None] for mask in maps.moving])
    maps.moving[:] |= horse
    before = maps.inverse.copy()
    assert not place_people(maps, priors).pixels.any()
    np.testing.assert_array_equal(maps.inverse, before)


def test_a_pattern_that_is_taken_for_a_person_keeps_its_distance():
    priors, maps = on_a_plain(unsteady=0.2)
    assert not place_people(maps, priors).pixels.any()


def found_in(name, count):
    """Priors with flow and people of the first `count` frames of a real clip."""
    if networks.missing():
        pytest.skip(networks.missing())
    from f4x_core.clip import read_clip
    from f4x_core.parallel import side_by_side

    clip = read_clip(CLIPS / name / "images")
    clip = clip_of(clip.frames[:count])
    priors, config = Priors.empty(clip), PriorsConfig()
    with side_by_side(2):
        provide_flow(clip, priors, config, silent)
        provider.provide(clip, priors, config, silent)
    return priors


@pytest.mark.real
@pytest.mark.skipif(not CLIPS.exists(), reason="the real clips are not here")
@pytest.mark.parametrize(("name", "least"), [("parkour", 0.85), ("dance-twirl", 0.78)])
def test_somebody_is_found_in_every_frame(name, least):
    import cv2

    priors = found_in(name, 16)
    masks = [cv2.imread(str(file), 0) > 0 for file in sorted((CLIPS / name / "masks").iterdir())[:16]]
    found = (priors.people == 1) & (priors.people_probability > 0.5)
    overlaps = [(a & b).sum() / (a | b).sum() for a, b in zip(found, masks, strict=True)]
    assert np.mean(overlaps) > least and min(overlaps) > least - 0.2
    assert np.isfinite(priors.people_joints[:, 0]).all()


@pytest.mark.real
@pytest.mark.skipif(not CLIPS.exists(), reason="the real clips are not here")
@pytest.mark.parametrize("name", ["blackswan", "car-shadow"])
def test_swans_and_cars_are_no_people(name):
    assert found_in(name, 16).people_joints.shape[1] == 0
