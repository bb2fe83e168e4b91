"""People: crops and masks, who counts as moving, relief of bodies, and real clips where the networks are installed."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from f4x_core.clip import Clip
from f4x_core.errors import F4xError
from f4x_core.geometry.camera import CameraPath
from f4x_core.parallel import in_threads, side_by_side
from f4x_core.people import finding, following, networks, provider
from f4x_core.people.finding import Seed, same_body
from f4x_core.people.following import Person, Pictures
from f4x_core.people.networks import POSE_SIZE, Crop, Pose
from f4x_core.priors import Priors, PriorsConfig, build_priors, feet
from f4x_core.priors.body_depth import Body, add_relief, place_people, smooth_scales
from f4x_core.priors.contact import MOVING_CONFIDENCE, DepthMaps
from f4x_core.priors.flow import provide as provide_flow
from f4x_core.priors.joints import ANKLES, FEET, HIPS, JOINTS, LEGS, LIMBS, NAMES, SHOULDERS, turn_to_ray
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


@pytest.mark.parametrize("mirrored", [False, True])
def test_a_mirrored_crop_shows_the_same_person(monkeypatch, mirrored):
    """The network sees a right wrist at the crop's left; in the mirror it is the left one, at the right in the picture."""
    landmarks, metres = np.zeros((39, 5), np.float32), np.zeros((39, 3), np.float32)
    landmarks[NAMES.index("right wrist")] = 32, 128, 0, 5, 0
    metres[NAMES.index("right wrist")] = -0.6, 0.1, 0.3
    outputs = [landmarks, np.ones(1), np.zeros((POSE_SIZE, POSE_SIZE)), None, metres]
    monkeypatch.setattr(networks, "_run", lambda name, values: outputs)
    pose = networks.find_pose(np.zeros((60, 80, 3), np.uint8), Crop(np.array([40.0, 30.0]), 32, 0.0, mirrored))
    wrist, side = (NAMES.index("left wrist"), 1) if mirrored else (NAMES.index("right wrist"), -1)
    np.testing.assert_allclose(pose.joints[wrist], [40 + 12 * side, 30])
    np.testing.assert_allclose(pose.metres[wrist], [0.6 * side, 0.1, 0.3], atol=1e-6)
    assert pose.visibility[wrist] > 0.9


def test_networks_are_opened_once_for_all_threads(monkeypatch):
    class Network:
        def invoke(self): ...
        def set_tensor(self, index, values): ...
        def get_input_details(self):
            return [{"index": 0}]

        def get_output_details(self):
            return []

    opened = []
    monkeypatch.setattr(networks, "_open", lambda name: opened.append(name) or Network())
    networks.close_networks()
    with side_by_side(2):
        for _ in range(4):
            in_threads(lambda _: networks._run("people-pose", np.zeros((2, 2, 3))), range(8))
    assert 1 <= len(opened) <= 2
    networks.close_networks()
    networks._run("people-pose", np.zeros((2, 2, 3)))
    assert len(opened) <= 3 and opened[-1] == "people-pose"
    networks.close_networks()


def test_detections_that_overlap_are_one(monkeypatch):
    raw, logits = np.zeros((2254, 12), np.float32), np.full(2254, -9.0, np.float32)
    raw[:, 2:4], raw[:, 7] = 60, -40  # boxes of 60 pixels, and a point on the circle above
    logits[[0, 2, 1500]] = 2, 1, 3  # the first two lie in neighbouring cells
    monkeypatch.setattr(networks, "_run", lambda name, values: [raw, logits])
    found = networks.detect(np.zeros((224, 224, 3), np.uint8), 0.5)
    assert [round(one.score, 2) for one in found] == [0.95, 0.88]
    assert [one.crop.side for one in found] == pytest.approx([100, 100])


def again(center, side):
    """A network that finds in every crop near `center` the same body, whichever way the crop is turned."""
    whole = pose_at(center, side)
    return lambda picture, crop: replace(whole, presence=float(np.hypot(*(crop.center - whole.crop.center)) < side / 2))


def another_each_time(center, side):
    """A network that finds a body in every crop, each time another one."""
    number = iter(range(1, 1000))

    def find(picture, crop):
        spread = np.random.default_rng(next(number)).uniform(-side / 4, side / 4, (JOINTS, 2))
        return pose_at(center, side, joints=np.array(center) + spread)

    return find


@pytest.mark.parametrize(("network", "least", "most"), [(again, 0.99, 1), (another_each_time, 0, 0.3)])
def test_a_body_that_is_found_again_is_steady(monkeypatch, network, least, most):
    monkeypatch.setattr(finding, "find_pose", network((40, 30), 40))
    assert least <= finding.steadiness(np.zeros((60, 80, 3), np.uint8), pose_at((40, 30), 40)) <= most


def turned_mover(upside):
    """A network that sees somebody in the middle of the picture, in crops that are turned by about `upside` only."""

    def find(picture, crop):
        away = Crop(crop.center, crop.side, crop.angle - upside).turn
        return pose_at((40, 30), 40, upside, presence=float(away < 0.5))

    return find


@pytest.mark.parametrize(
    ("upside", "detected", "found", "looks"),
    [
        (0.0, 0.9, True, 2),  # upright: no other direction is tried
        (0.0, 0.1, False, 2),  # the detector would know somebody upright
        (np.pi, 0.1, True, 12 + 1 + 3),  # on their hands, of whom it knows nothing, and whose pose is steady
    ],
)
def test_a_mover_is_looked_at_whichever_way_is_up(monkeypatch, upside, detected, found, looks):
    seen = []
    network = turned_mover(upside)
    monkeypatch.setattr(finding, "find_pose", lambda picture, crop: seen.append(crop) or network(picture, crop))
    monkeypatch.setattr(finding, "confirm", lambda picture, crop: detected)
    region = np.zeros((15, 20), bool)
    region[5:10, 7:13] = True
    seed = finding.find_mover(np.zeros((60, 80, 3), np.uint8), region, 4)
    assert (seed is not None) == found and len(seen) == looks
    assert seed is None or (seed.moves and finding.fills(seed.pose, region, 4))


def film(count, height=60, width=80):
    """Pictures of a still film."""
    flow = np.zeros((count - 1, height, width, 2), np.float32)
    return Pictures(np.zeros((count, height, width, 3), np.uint8), flow, flow)


def followed_through(monkeypatch, count, detected=0.9, **people):
    """Let the networks find the same body in all pictures; returns what `follow_everyone` needs first."""
    monkeypatch.setattr(following, "find_pose", again((40, 30), 40))
    monkeypatch.setattr(following, "confirm", lambda picture, crop: detected)
    monkeypatch.setattr(following, "steadiness", lambda picture, pose: 0.0)
    return film(count)


@pytest.mark.parametrize(("detected", "frames"), [(0.9, 40), (0.1, following.TRIAL)])
def test_who_is_no_person_is_not_followed_to_the_end(monkeypatch, detected, frames):
    clip = followed_through(monkeypatch, 40, detected)
    person = following.follow(clip, {}, 10, Seed(pose_at((40, 30), 40), 0.9), [])
    assert len(person.poses) == frames
    assert len(following.follow_everyone(clip, {10: [Seed(pose_at((40, 30), 40), 0.9)]})) == (frames == 40)


@pytest.mark.parametrize(("moves", "searched"), [(True, [20, 24, 28, 32, 36]), (False, [])])
def test_a_mover_is_searched_where_they_were_lost(monkeypatch, moves, searched):
    asked = []
    clip = followed_through(monkeypatch, 40)
    here, gone = again((40, 30), 40), again((999, 999), 40)
    pictures = {clip.rgb[frame].ctypes.data: frame for frame in range(40)}
    find = lambda picture, crop: (here if pictures[picture.ctypes.data] < 18 else gone)(picture, crop)  # noqa: E731
    monkeypatch.setattr(following, "find_pose", find)
    search = lambda frame: asked.append(frame) or []  # noqa: E731
    people = following.follow_everyone(clip, {4: [Seed(pose_at((40, 30), 40), 0.9, moves)]}, search)
    assert asked == searched and [len(person.poses) for person in people] == [18]


@pytest.mark.parametrize(
    ("color", "place", "gap", "people"),
    [
        ((200, 40, 40), 44, 12, [16]),
        ((40, 200, 40), 44, 12, [8, 8]),
        ((200, 40, 40), 240, 12, [8, 8]),
        ((200, 40, 40), 44, 40, [8, 8]),
    ],
    ids=["found again", "in other colors", "too far", "too late"],
)
def test_somebody_hidden_for_a_while_is_the_same_person(color, place, gap, people):
    pictures = np.zeros((60, 60, 300, 3), np.uint8)
    pictures[:, :, :150] = 200, 40, 40
    pictures[8:, :, :150] = color
    pictures[8:, :, 150:] = color
    before = Person({frame: pose_at((40, 30), 40) for frame in range(8)})
    after = Person({frame: pose_at((place, 30), 40) for frame in range(8 + gap, 16 + gap)})
    joined = following._joined([after, before], pictures)
    assert sorted(len(person.poses) for person in joined) == people


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


def test_a_doubtful_region_beside_a_person_is_no_mover():
    """A wall that the person touches goes; in frames in which nobody is found, what is as sure as people are stays of it."""
    person = rectangle(30, 10, 45, 50)
    priors = priors_with([(person, np.ones((JOINTS, 3)), np.zeros((JOINTS, 3)))])
    halo, hidden, ball = rectangle(45, 10, 60, 50), rectangle(46, 20, 56, 40), rectangle(5, 20, 15, 30)
    mask = np.repeat((person | halo | ball)[None], 3, 0)
    motion = np.where(halo, 0.7, np.where(mask[0], 0.9, 0.1))[None].repeat(3, 0)
    priors.people[2], motion[2, hidden] = 0, 0.9
    found = with_people(mask, motion, priors)
    assert found[:2, person].all() and found[:, ball].all() and not found[:2, 12:48, 50:60].any()
    assert found[2, hidden].all() and not found[2, halo & ~hidden].any()
    assert with_people(mask, np.where(halo, 0.9, motion), priors)[:, halo].all()


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
    metres[list(HIPS)] = 0
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
    depth = 1 / inverse[2]
    assert depth[person].max() - depth[hand] == pytest.approx(0.25, abs=0.02)
    assert np.median(inverse[2][person]) == pytest.approx(
        0.5, rel=1e-6
    )  # where the region is, whichever way its legs lean
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


def on_a_plain(frames=12, hop=(), unsteady=0.0, lean=0.0):
    """Priors of somebody who walks across a plain 1.5 m below the camera, and their maps: depth is known but for the person.

    hop: frames in which they are .3 m above the ground; unsteady: scatter of the logarithm of the joints' size; lean: radians
    by which their metres lean toward the camera, as networks say.
    """
    rng, focal, height, width = np.random.default_rng(2), 180.0, 180, 240
    intrinsics = np.tile(np.array([[focal, 0, 120], [0, focal, 60], [0, 0, 1]]), (frames, 1, 1))
    cameras = CameraPath(intrinsics, np.tile(np.eye(4), (frames, 1, 1)), np.arange(float(frames)), width, height)
    y, x = np.mgrid[:height, :width] + 0.5
    plain = np.broadcast_to(np.maximum((y - 60) / focal / 1.5, 0.02), (frames, height, width)).copy()
    metres = np.column_stack([rng.uniform(-0.2, 0.2, JOINTS), rng.uniform(-0.8, 0.6, JOINTS), np.zeros(JOINTS)])
    for pair, down in ((SHOULDERS, -0.5), (HIPS, 0.0), (ANKLES, 0.8)):
        metres[list(pair)] = [(-0.1, down, 0), (0.1, down, 0)]
    metres[list(FEET)] = [(-0.1, 0.9, -0.1), (0.1, 0.9, 0.1), (-0.1, 0.9, -0.2), (0.1, 0.9, 0.2)]
    turn = np.array([[1, 0, 0], [0, np.cos(lean), -np.sin(lean)], [0, np.sin(lean), np.cos(lean)]])
    masks, joints = np.zeros((frames, height, width), bool), np.zeros((frames, JOINTS, 3))
    for frame in range(frames):
        middle = np.array([0.05 * frame - 0.3, 0.6 - 0.3 * (frame in hop), WALKER])
        size = np.exp(unsteady * rng.standard_normal())
        joints[frame, :, :2] = (middle + metres)[:, :2] / WALKER * focal * size + [120, 60]
        joints[frame, :, 2] = 1
        feet = joints[frame, list(FEET)]
        left, right = feet[:, 0].min() - 3, feet[:, 0].max() + 3
        masks[frame] = (x > left) & (x < right) & (y > feet[:, 1].max() - 50) & (y < feet[:, 1].max())
    priors = priors_with([(masks[0], joints[0], metres @ turn.T)], width, height, frames)
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
        assert np.median(1 / maps.inverse[frame][mask]) == pytest.approx(
            WALKER - 0.07, rel=0.03
        )  # skin is before bones
    assert (maps.confidence[maps.moving] <= MOVING_CONFIDENCE).all()


def foot(side, place, camera):
    """A foot of which the toes touch the ground at `place (3,)`."""
    pixels, depth = camera.project(np.array([place]))
    return feet.Foot(side, [LEGS[side][-1]], 1 / depth, pixels, np.array([place]))


@pytest.mark.parametrize(("swings", "kept"), [(0.2, [0]), (0.02, [0, 1])])
def test_a_foot_below_which_the_ground_runs_does_not_stand(swings, kept):
    """One foot stands, by a pixel's noise, the other one goes by so many meters a frame."""
    cameras, frames = on_a_plain()[0].cameras, np.arange(8)
    noise = np.random.default_rng(0).uniform(-1, 1, 8) * WALKER / 180
    both = [[foot(0, (noise[f], 1.5, 6), cameras[f]), foot(1, (swings * f, 1.5, 6), cameras[f])] for f in frames]
    still = feet.standing_still(both, cameras, frames, np.full(8, 1 / WALKER))
    assert all([one.side for one in some] == kept for some in still)
    swinging = [some[1:] for some in both]
    assert feet.standing_still(swinging, cameras, frames, np.full(8, 1 / WALKER)) == swinging


def test_legs_end_where_their_feet_stand():
    cameras, frames = on_a_plain()[0].cameras, np.arange(8)
    flat = Body(np.zeros((JOINTS, 2)), np.zeros((JOINTS, 3)), np.ones(JOINTS))  # all joints as far as the hips
    standing = [[foot(0, (0, 1.5, WALKER + 0.2), cameras[f])] for f in frames]
    bent = feet.on_their_feet([flat] * 8, standing, frames, np.full(8, 1 / WALKER), np.full(8, 1 / WALKER), 0.0)
    (knee, *left), right = LEGS
    for body in bent:
        assert (body.metres[left, 2] > 0.1).all() and (body.metres[left, 2] < 0.2).all()
        assert body.metres[knee, 2] == pytest.approx(body.metres[left[0], 2] / 2)
        assert not body.metres[list(right), 2].any()


def test_who_leans_along_the_view_by_the_networks_stands_upright():
    upright, leaning = (on_a_plain(lean=lean) for lean in (0.0, 0.3))
    for priors, maps in (upright, leaning):
        assert len(place_people(maps, priors).frames) == 1
    mask = upright[1].moving
    np.testing.assert_allclose(leaning[1].inverse[mask], upright[1].inverse[mask], rtol=0.01)


@pytest.mark.parametrize("hips", [(40.0, 30.0), (70.0, 50.0)])
def test_metres_along_the_ray_to_a_person_turn_into_the_axes_of_the_camera(hips):
    joints = np.zeros((1, JOINTS, 3))
    joints[:, list(HIPS), :2] = hips
    intrinsics = np.array([[80.0, 0, 40], [0, 80, 30], [0, 0, 1]])
    turn = turn_to_ray(joints, intrinsics)[0]
    ray = np.array([(hips[0] - 40) / 80, (hips[1] - 30) / 80, 1])
    np.testing.assert_allclose(turn @ [0, 0, 1], ray / np.linalg.norm(ray), atol=1e-12)
    np.testing.assert_allclose(turn @ turn.T, np.eye(3), atol=1e-12)


def test_a_size_that_sways_with_every_stride_is_smoothed_and_one_that_grows_is_not():
    frames = np.arange(48)
    grows = 0.01 * frames
    sways = 0.05 * np.sin(2 * np.pi * frames / 12) + 0.5 * (frames == 20)  # and a pose that is seen along the view
    smooth = smooth_scales(frames, np.exp(grows + sways))
    assert np.std(np.log(smooth) - grows) < 0.015
    assert len(smooth_scales(frames[:0], grows[:0])) == 0


def test_fragments_that_touch_people_are_no_objects_of_their_own():
    priors, maps = on_a_plain()
    rest = np.zeros_like(maps.moving)
    rest[3, 20:24, 100:140] = True  # far from them
    halo = np.zeros_like(rest)
    for frame, mask in enumerate(maps.moving):
        column = np.nonzero(mask.any(0))[0][-1] + 1
        halo[frame, 70:75, column : column + 30] = True
    maps.moving[:] |= rest | halo
    placed = place_people(maps, priors)
    assert placed.pixels[halo].all() and not placed.pixels[rest].any()
    assert np.median(1 / maps.inverse[halo]) == pytest.approx(WALKER, rel=0.05)


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


def people_files(folder, **arrays):
    for name, array in arrays.items():
        np.save(folder / f"{name}.npy", array)


WHO = np.zeros((3, 60, 80), np.uint8)
WHO[:, 10:40, 10:30], WHO[:, 10:40, 50:70] = 1, 2
SOMEBODY = np.full((3, 1, JOINTS, 3), 0.5, np.float32)


@pytest.mark.parametrize(
    ("arrays", "sentence"),
    [
        ({"people": WHO[:2]}, r"people\.npy has shape \(2, 60, 80\), this clip needs \(3, 60, 80\)"),
        ({"people": WHO[:, ::2]}, r"people\.npy has shape \(3, 30, 80\)"),
        ({"people": WHO.astype(np.int32)}, r"people\.npy has dtype int32; save it as uint8"),
        (
            {"people": 100 * WHO},
            r"people\.npy shows 2 people but numbers them up to 200; use 0 for nobody, then 1, 2, 3",
        ),
        ({"people_joints": SOMEBODY}, r"people_joints\.npy needs people\.npy beside it"),
        ({"people": WHO, "people_metres": SOMEBODY}, r"people_metres\.npy needs people_joints\.npy beside it"),
        (
            {"people": WHO, "people_joints": SOMEBODY, "people_metres": SOMEBODY},
            r"people\.npy shows person 2, \S*people_joints\.npy has 1 people; number both alike",
        ),
        (
            {"people": WHO // 2, "people_joints": 9 * SOMEBODY, "people_metres": SOMEBODY},
            r"people_joints\.npy: the visibility of joints .* leaves the range 0\.\.1",
        ),
    ],
)
def test_a_wrong_file_of_people_is_named(tmp_path, arrays, sentence):
    people_files(tmp_path, **arrays)
    before = sorted(tmp_path.iterdir())
    with pytest.raises(F4xError, match=sentence):
        build_priors(clip_of(np.zeros((3, 60, 80, 3), np.uint8)), tmp_path, PriorsConfig.of("synthetic"))
    assert sorted(tmp_path.iterdir()) == before


@pytest.mark.parametrize("wrong", [0.5 * WHO, WHO - 1.0, 300 * WHO.astype(int)], ids=["half", "negative", "large"])
def test_people_are_whole_numbers(tmp_path, wrong):
    np.save(tmp_path / "mine.npy", wrong)
    config = replace(PriorsConfig.of("synthetic"), files={"people": str(tmp_path / "mine.npy")})
    with pytest.raises(F4xError, match=r"mine\.npy.*whole ones from 0 \(nobody\) to 255"):
        build_priors(clip_of(np.zeros((3, 60, 80, 3), np.uint8)), tmp_path / "priors", config)


def test_numbers_that_are_given_stay_and_joints_go_with_them():
    priors = Priors(width=80, height=60, frames=np.arange(3), people=WHO.copy())
    right = Person({frame: pose_at((60, 25), 30) for frame in range(3)})
    nobody_there = Person({frame: pose_at((40, 55), 8) for frame in range(3)})
    provider.write_people([nobody_there, right], priors)
    np.testing.assert_array_equal(priors.people, WHO)
    assert priors.people_probability[0, 20, 20] == 1 and priors.people_probability[0, 0, 0] == 0
    assert np.isnan(priors.people_joints[:, 0]).all()
    np.testing.assert_allclose(priors.people_joints[1, 1, :, :2], right.poses[1].joints, rtol=1e-6)
    priors.validate(["people", "people_probability", "people_joints", "people_metres"])


def found_in(name, count):
    """Priors with flow and people of the first `count` frames of a real clip."""
    if networks.missing():
        pytest.skip(networks.missing())
    from f4x_core.clip import read_clip

    clip = read_clip(CLIPS / name / "images")
    clip = clip_of(clip.frames[:count])
    priors, config = Priors.empty(clip), PriorsConfig()
    with side_by_side(2):
        provide_flow(clip, priors, config, silent)
        provider.provide(clip, priors, config, silent)
    return priors


@pytest.mark.real
@pytest.mark.skipif(not CLIPS.exists(), reason="the real clips are not here")
@pytest.mark.parametrize(("name", "least"), [("parkour", 0.85), ("dance-twirl", 0.78), ("breakdance", 0.75)])
def test_somebody_is_found_in_every_frame(name, least):
    import cv2

    priors = found_in(name, 12)
    masks = np.array([cv2.imread(str(file), 0) > 0 for file in sorted((CLIPS / name / "masks").iterdir())[:12]])
    who = np.bincount(priors.people[masks])[1:].argmax()
    found = (priors.people == who + 1) & (priors.people_probability > 0.5)
    overlaps = (found & masks).sum((1, 2)) / (found | masks).sum((1, 2))
    assert overlaps.mean() > least and overlaps.min() > least - 0.2
    assert np.isfinite(priors.people_joints[:, who]).all()


@pytest.mark.real
@pytest.mark.skipif(not CLIPS.exists(), reason="the real clips are not here")
@pytest.mark.parametrize("name", ["blackswan", "camel", "train", "car-shadow"])
def test_animals_and_vehicles_are_no_people(name):
    assert found_in(name, 16).people_joints.shape[1] == 0
