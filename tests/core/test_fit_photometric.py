"""The training loop: each term of its loss with its inputs, weight and period, and which rate each parameter learns at."""

import copy
import dataclasses
import math
from dataclasses import dataclass

import numpy as np
import pytest
import torch
from toy import HEIGHT, WIDTH, clip_and_priors

from f4x_core.fit.config import GaussianRates, LossConfig, RateConfig, profile
from f4x_core.fit.frame_data import FrameData
from f4x_core.fit.loss_terms import total_loss
from f4x_core.fit.losses import depth_loss, depth_roughness, masked_l1
from f4x_core.fit.pipeline import start_fit
from f4x_core.fit.trainer import FitStart, Trainer
from f4x_core.geometry import quaternion
from f4x_core.native import open_library
from f4x_core.native.kernels import Kernels
from f4x_core.priors import Priors
from f4x_core.scaffold.losses import arap_losses, smoothness_losses

pytestmark = pytest.mark.usefixtures("one_thread")

STATIC = GaussianRates((1e-3, 1e-5), (2e-3, 2e-4), (3e-2, 3e-3), (0.1, 0.1), (4e-2, 4e-3))
DYNAMIC = GaussianRates((5e-3, 5e-5), (6e-3, 6e-3), (7e-2, 7e-3), (0.2, 0.02), (8e-2, 8e-2))
SILENT = LossConfig(**{f.name: 0.0 for f in dataclasses.fields(LossConfig)} | {"moving": 1.0})
"""The L1 of the picture alone."""
BACKGROUND = torch.tensor([0.2, 0.9, 0.5])
FRAME, PARTNER = 1, 3


# The only places that know how the loop is called inside.


def loss_of(stage: Trainer, frame: int = FRAME, level: int = 0, step: int = 0) -> torch.Tensor:
    """The total loss of a frame at a resolution, `level` 1 the half."""
    stage.step = step
    return total_loss(stage.losses, step, stage.render(frame, stage.levels[level], BACKGROUND))


def partner_of(stage: Trainer, frame: int) -> int | None:
    return stage.tracks.random_partner(frame, stage.generator)


def rates_at(stage: Trainer, share: float) -> dict[str, dict[str, float]]:
    stage.step = share * stage.config.steps  # between two steps, too
    stage._set_rates()
    groups = {kind: optimiser.adam.param_groups for kind, optimiser in stage.optimisers.items()}
    groups["shared"] = stage.shared.param_groups
    return {kind: {group["name"]: group["lr"] for group in own} for kind, own in groups.items()}


# ---- a stage whose every term is at work -------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def scene():
    """(model, clip, priors): nothing is right, frames are missing between, motion and depth are unsure."""
    clip, priors = clip_and_priors(8, hold_out=4)
    config = dataclasses.replace(profile("quick"), steps=40, threads=1, backend="torch")
    model = start_fit(clip, priors, config).model
    generator = torch.Generator().manual_seed(0)

    def noise(tensor, size):
        tensor.add_(size * torch.randn(tensor.shape, generator=generator))

    with torch.no_grad():
        noise(model.nodes.parameters["node_xyz"], 0.01)
        noise(model.nodes.parameters["node_quat"], 0.1)
        noise(model.dynamic.parameters["dw"], 0.05)
        noise(model.rig.parameters["camera_rotation"], 0.01)
        noise(model.rig.parameters["camera_position"], 0.01)
        model.static.parameters["sh0"].mul_(0.5)
        for gaussians, place in (
            (model.static, model.static.parameters["means"]),
            (model.dynamic, model.dynamic_at(1.0)[0][0]),
        ):
            gaussians.parameters["opacity_logits"][place[:, 0] < -0.08] = -7  # the left is almost empty
    rng = np.random.default_rng(0)
    shape = priors.mask.shape
    priors.motion = np.clip(np.where(priors.mask, 0.8, 0.3) + 0.3 * rng.normal(size=shape), 0, 1).astype(np.float16)
    priors.depth_confidence = rng.uniform(0, 1, shape).astype(np.float16)
    priors.depth = (priors.depth * rng.uniform(0.8, 1.3, shape)).astype(np.float32)
    priors.depth[rng.random(shape) < 0.1] = np.nan
    moving = np.flatnonzero(priors.tracks_motion > 0.5)
    priors.tracks = priors.tracks + rng.normal(size=priors.tracks.shape).astype(np.float32)
    priors.tracks[PARTNER, moving[::4]] += 90  # wrong by more than the cap
    priors.tracks_visible = priors.tracks_visible.copy()
    priors.tracks_visible[:, moving] = False
    priors.tracks_visible[np.ix_([FRAME, PARTNER], moving[2:])] = True  # so these are each other's only partners
    return model, clip, priors


def stage_with(scene, losses: LossConfig = SILENT, **changes) -> Trainer:
    """A stage on a copy of the scene."""
    model, clip, priors = scene
    settings = {"steps": 40, "threads": 1, "backend": "torch", "rates": RateConfig()} | changes
    config = dataclasses.replace(profile("quick"), losses=losses, **settings)
    return Trainer(copy.deepcopy(model), clip, priors, config, FitStart(10_000))


@dataclass
class Drawn:
    """What one frame looks like, float64."""

    rgb: np.ndarray
    depth: np.ndarray
    alpha: np.ndarray
    dynamic: np.ndarray
    """(H,W) how much of the pixel is of dynamic Gaussians."""
    there: np.ndarray
    """(H,W,3) composited places at the partner's time."""
    priors: Priors


def draw(stage: Trainer, data: FrameData, scene) -> Drawn:
    """FRAME as the stage draws it; `scene` is what the stage was made from."""
    model = stage.model
    now, later = model.dynamic_at(*(float(model.times[i]) for i in (FRAME, PARTNER)))
    posed = model.posed(now)
    own = torch.zeros(len(posed.means), 1)
    own[len(model.static) :] = 1
    there = torch.cat([model.static.parameters["means"], later[0]])
    camera = model.rig.camera(FRAME, data.width, data.height)
    with torch.no_grad():
        out = model.render(posed, camera, extra=torch.cat([own, there], 1), background=BACKGROUND, backend="torch")
    channels = out.channels.double().numpy()
    depth, alpha = out.depth.double().numpy(), out.alpha.double().numpy()
    return Drawn(channels[..., :3], depth, alpha, channels[..., 3], channels[..., 4:], scene[2])


# ---- the terms, written out --------------------------------------------------------------------------------------------


def double(*maps):
    return tuple(torch.as_tensor(each).double() for each in maps)


def picture_term(stage, data, drawn):
    """Mean over pixels, weighed 1 to `moving` by the motion score, of the L1 over channels."""
    image, frame, motion = double(drawn.rgb, data.rgb[FRAME], data.maps(FRAME).motion)
    return float(masked_l1(image, frame / 255, 1 + (stage.config.losses.moving - 1) * motion))


def depth_term(stage, data, drawn):
    """Mean, by confidence, of the difference of inverse depths where depth is known."""
    maps = data.maps(FRAME)
    return float(depth_loss(*double(drawn.depth, drawn.alpha, maps.depth, maps.confidence)))


def rough_term(stage, data, drawn):
    """Mean bend of the inverse depth where the picture is plain, depth is unsure and nothing moves."""
    maps = data.maps(FRAME)
    depth, alpha, frame, motion, sure = double(drawn.depth, drawn.alpha, data.rgb[FRAME], maps.motion, maps.confidence)
    return float(depth_roughness(depth, alpha, frame / 255, (1 - sure) * (1 - motion)))


def mask_term(stage, data, drawn):
    """Mean over all pixels of |alpha of what moves - mask|, trusted fully at scores 0 and 1 and not at all at 1/2."""
    total = 0.0
    for r in range(data.height):
        for c in range(data.width):
            score = float(data.maps(FRAME).motion[r, c])
            wanted = 1.0 if score > 0.5 else 0.0
            total += abs(2 * score - 1) * abs(drawn.dynamic[r, c] - wanted)
    return total / (data.height * data.width)


def bilinear(image, x, y):
    """`image (H,W,C)` at pixel x, y, where pixel centres are at halves; nothing outside."""
    value = np.zeros(image.shape[2])
    left, top = math.floor(x - 0.5), math.floor(y - 0.5)
    for row, col in ((top, left), (top, left + 1), (top + 1, left), (top + 1, left + 1)):
        if 0 <= row < image.shape[0] and 0 <= col < image.shape[1]:
            value += (1 - abs(x - 0.5 - col)) * (1 - abs(y - 0.5 - row)) * image[row, col]
    return value


def track_term(stage, data, drawn):
    """Mean over tracks of the pixels, at most 20, between a track and where what is drawn on it goes."""
    model, full = stage.model, stage.levels[0]
    priors = drawn.priors
    view = model.rig.view(PARTNER).detach().double().numpy()
    lens = model.rig.intrinsics(PARTNER, full.width, full.height).detach().double().numpy()
    distances = []
    for i in range(priors.tracks.shape[1]):
        if priors.tracks_motion[i] <= 0.5 or not (
            priors.tracks_visible[FRAME, i] and priors.tracks_visible[PARTNER, i]
        ):
            continue
        x, y = priors.tracks[FRAME, i].astype(float) * [data.width / full.width, data.height / full.height]
        alpha = bilinear(drawn.alpha[..., None], x, y)[0]
        place = bilinear(drawn.there, x, y) / max(alpha, 0.1)
        local = view[:3, :3] @ place + view[:3, 3]
        z = max(local[2], 0.01)
        pixel = np.array([lens[0, 0] * local[0] / z + lens[0, 2], lens[1, 1] * local[1] / z + lens[1, 2]])
        distances.append(min(float(np.linalg.norm(pixel - priors.tracks[PARTNER, i])), 20.0))
    assert len(distances) > 30 and max(distances) == 20
    return float(np.mean(distances))


MOTION = (
    "arap_coordinate",
    "arap_length",
    "velocity",
    "acceleration",
    "rotation_velocity",
    "rotation_acceleration",
    "dw",
)


def motion_terms(stage):
    """Name -> the loss of the nodes' poses within the longest shift of FRAME, and of the offsets."""
    config, model = stage.config, stage.model
    chosen = [t for t in range(len(model.times)) if abs(t - FRAME) <= max(config.shifts)]
    xyz, quat = (model.nodes.parameters[name].detach().double()[chosen] for name in ("node_xyz", "node_quat"))
    quat, times = quaternion.normalize(quat), torch.as_tensor(model.times)[chosen]
    edges = dataclasses.replace(model.nodes.edges, weight=model.nodes.edges.weight.double())
    rigid = arap_losses(xyz, quat, edges, config.shifts, config.shift_weights)
    offsets = model.dynamic.parameters["dw"].detach().double().abs().mean()
    return dict(zip(MOTION, map(float, (*rigid, *smoothness_losses(xyz, quat, times), offsets)), strict=True))


def camera_term(stage):
    """Mean squared second difference of the corrections, times the full picture's width."""
    turn, place = (
        stage.model.rig.parameters[n].detach().double().numpy() for n in ("camera_rotation", "camera_position")
    )
    jerks = [sum(((p[t + 1] - 2 * p[t] + p[t - 1]) ** 2).sum() for p in (turn, place)) for t in range(1, len(turn) - 1)]
    return WIDTH * float(np.mean(jerks))


def with_term(scene, name: str, weight: float, level: int = 0, **changes):
    """(what the term adds to the loss of the picture's L1, the stage)."""
    stage, without = (
        stage_with(scene, dataclasses.replace(SILENT, **{name: weight}), **changes),
        stage_with(scene, **changes),
    )
    for each in (stage, without):
        each.model.dynamic.use_dw = True
    with torch.no_grad():
        added = float(loss_of(stage, level=level).double() - loss_of(without, level=level).double())
    return added, stage


@pytest.mark.parametrize("level", [0, 1])
@pytest.mark.parametrize("moving", [1.0, 3.0])
def test_the_picture_is_compared_where_it_moves_above_all(scene, level, moving):
    stage = stage_with(scene, dataclasses.replace(SILENT, moving=moving))
    data = stage.levels[level]
    expected = picture_term(stage, data, draw(stage, data, scene))
    assert float(loss_of(stage, level=level).detach()) == pytest.approx(expected, rel=1e-5)


@pytest.mark.parametrize("level", [0, 1])
@pytest.mark.parametrize(("name", "term"), [("depth", depth_term), ("mask", mask_term), ("track", track_term)])
def test_a_term_of_what_is_drawn_is_its_formula_times_its_weight(scene, name, term, level):
    added, stage = with_term(scene, name, 30.0, level)
    data = stage.levels[level]
    assert added == pytest.approx(30 * term(stage, data, draw(stage, data, scene)), rel=2e-4)


@pytest.mark.parametrize("level", [0, 1])
@pytest.mark.parametrize("every", [1, 3])
def test_roughness_is_its_formula_times_its_weight_and_its_period(scene, every, level):
    added, stage = with_term(scene, "roughness", 30.0, level, rough_every=every)
    data = stage.levels[level]
    assert added == pytest.approx(30 * every * rough_term(stage, data, draw(stage, data, scene)), rel=2e-4)


@pytest.mark.parametrize("every", [1, 3])
@pytest.mark.parametrize("shifts", [((1, 3, 8), (0.6, 0.2, 0.2)), ((1, 2), (0.7, 0.3))])
@pytest.mark.parametrize("name", MOTION)
def test_a_term_of_motion_is_its_formula_times_its_weight_and_its_period(scene, name, shifts, every):
    changes = {"motion_every": every, "shifts": shifts[0], "shift_weights": shifts[1]}
    added, stage = with_term(scene, name, 50.0, **changes)
    assert added == pytest.approx(50 * every * motion_terms(stage)[name], rel=2e-4)


def test_offsets_cost_nothing_before_they_are_learnt(scene):
    stage, silent = stage_with(scene, dataclasses.replace(SILENT, dw=50.0)), stage_with(scene)
    assert not stage.model.dynamic.use_dw
    assert float(loss_of(stage).detach()) == float(loss_of(silent).detach())


def test_camera_corrections_cost_their_unevenness_in_pixels(scene):
    added, stage = with_term(scene, "camera_smoothness", 2.0)
    assert added == pytest.approx(2 * camera_term(stage), rel=1e-4)
    halved, _ = with_term(scene, "camera_smoothness", 2.0, level=1)
    assert halved == pytest.approx(added, rel=1e-4), "not less at half the size"


def test_terms_add_up(scene):
    weights = {f.name: 0.3 for f in dataclasses.fields(LossConfig)} | {"moving": 1.0}
    whole = stage_with(scene, LossConfig(**weights))
    parts = {name: dataclasses.replace(SILENT, **{name: 0.3}) for name in weights if name != "moving"}
    with torch.no_grad():
        plain = float(loss_of(stage_with(scene)))
        total = sum(float(loss_of(stage_with(scene, losses))) - plain for losses in parts.values())
        assert float(loss_of(whole)) == pytest.approx(plain + total, rel=1e-4)


@pytest.mark.parametrize(
    ("name", "period"), [("track", "track_every"), ("velocity", "motion_every"), ("roughness", "rough_every")]
)
def test_what_is_costly_is_asked_for_every_so_many_steps(scene, name, period):
    stage, silent = stage_with(scene, dataclasses.replace(SILENT, **{name: 5.0}), **{period: 3}), stage_with(scene)
    plain = float(loss_of(silent).detach())
    charged = [float(loss_of(stage, step=step).detach()) > plain + 1e-3 for step in range(7)]
    assert charged == [step % 3 == 0 for step in range(7)]


def test_a_track_behind_the_camera_is_as_wrong_as_can_be(scene):
    """Mirrored through the camera it would meet its track by half."""
    stage, silent = stage_with(scene, dataclasses.replace(SILENT, track=1.0)), stage_with(scene)
    for each in (stage, silent):
        with torch.no_grad():
            each.model.rig.parameters["camera_position"][PARTNER, 2] = -3
    assert float((loss_of(stage) - loss_of(silent)).detach()) == pytest.approx(20, abs=0.7)


def test_tracks_pull_what_moves_and_a_track_beyond_the_cap_pulls_nothing(scene):
    def pull(beyond: bool):
        model, clip, priors = scene
        priors = copy.copy(priors)
        priors.tracks = priors.tracks.copy()
        priors.tracks[PARTNER] += 500 * beyond
        stage, silent = (stage_with((model, clip, priors), dataclasses.replace(SILENT, track=w)) for w in (1.0, 0.0))
        gradients = []
        for each in (stage, silent):
            loss_of(each).backward()
            gradients.append(each.model.nodes.parameters["node_xyz"].grad[PARTNER])
        assert gradients[1] is None or not gradients[1].any(), "a picture says nothing of another time"
        return float(gradients[0].norm())

    assert pull(False) > 1 and pull(True) == 0


# ---- partners ----------------------------------------------------------------------------------------------------------


def seen_together(scene, shared: dict[int, int], score: float = 1.0):
    """A stage in which frame 1 sees `shared[f]` of its moving tracks in frame f too."""
    model, clip, priors = scene
    priors = copy.copy(priors)
    priors.tracks_visible = np.zeros_like(priors.tracks_visible)
    priors.tracks_visible[1, :40] = True
    for frame, count in shared.items():
        priors.tracks_visible[frame, :count] = True
    priors.tracks_motion = np.full(priors.tracks_visible.shape[1], score, np.float32)
    return stage_with((model, clip, priors))


def test_a_partner_sees_eight_moving_tracks_of_the_frame(scene):
    stage = seen_together(scene, {0: 7, 3: 8, 4: 7})
    assert {partner_of(stage, 1) for _ in range(10)} == {3}
    stage = seen_together(scene, {0: 8, 2: 20, 3: 7, 5: 9})
    drawn = [partner_of(stage, 1) for _ in range(90)]
    assert set(drawn) == {0, 2, 5} and min(drawn.count(f) for f in (0, 2, 5)) > 15
    assert partner_of(seen_together(scene, {0: 7, 2: 7}), 1) is None
    assert partner_of(seen_together(scene, {0: 20}, score=0.5), 1) is None, "as likely still as moving"
    assert partner_of(seen_together(scene, {0: 20}, score=0.51), 1) == 0


def test_without_a_partner_there_is_no_track_loss(scene):
    stage, silent = stage_with(scene, dataclasses.replace(SILENT, track=5.0)), stage_with(scene)
    assert partner_of(stage, 0) is None
    assert float(loss_of(stage, 0).detach()) == float(loss_of(silent, 0).detach())


# ---- quality -----------------------------------------------------------------------------------------------------------


def test_the_quality_curve_is_the_psnr_of_frames_from_first_to_last(scene):
    stage = stage_with(scene)
    stage.step, stage.loss = 7, 0.25
    stage.measure()
    scores = []
    for frame in (0, 2, 3, 5):
        model = stage.model
        camera = model.rig.camera(frame, WIDTH, HEIGHT)
        with torch.no_grad():
            posed = model.posed(model.dynamic_at(float(model.times[frame]))[0])
            picture = model.render(posed, camera, backend="torch").channels.clamp(0, 1).double().numpy()
        scores.append(-10 * np.log10(((picture - stage.levels[0].rgb[frame].numpy() / 255) ** 2).mean()))
    (point,) = stage.history
    assert point["psnr"] == pytest.approx(np.mean(scores), abs=1e-4)
    assert (point["step"], point["loss"], point["gaussians"]) == (7, 0.25, len(stage.model))


# ---- rates -------------------------------------------------------------------------------------------------------------


def test_each_set_learns_at_its_own_rates_which_fall_to_their_last_value():
    rates = RateConfig(static=STATIC, dynamic=DYNAMIC, dw=9e-3)
    config = dataclasses.replace(profile("quick"), steps=40, threads=1, backend="torch", rates=rates)
    stage = start_fit(*clip_and_priors(5, moving=True), config)
    first, last = rates_at(stage, config.rate_decay_start), rates_at(stage, 1.0)
    half = rates_at(stage, (1 + config.rate_decay_start) / 2)
    assert first["static"] == pytest.approx(
        {"means": 1e-3, "quats": 2e-3, "log_scales": 3e-2, "opacity_logits": 0.1, "sh0": 4e-2, "shN": 5e-4}
    )
    assert last["static"]["log_scales"] == pytest.approx(3e-3)
    assert half["static"]["log_scales"] == pytest.approx((3e-2 * 3e-3) ** 0.5)
    assert first["dynamic"]["local_means"] == pytest.approx(5e-3)
    assert last["dynamic"]["local_means"] == pytest.approx(5e-5)
    assert last["dynamic"]["sh0"] == pytest.approx(8e-2)
    assert last["dynamic"]["dw"] == pytest.approx(9e-3)


RATES = RateConfig(
    node_xyz=(1e-3, 1e-5),
    node_quat=(4e-3, 4e-4),
    radius=7e-3,
    camera_rotation=(2e-4, 2e-6),
    camera_position=(9e-5, 9e-6),
)


@pytest.mark.parametrize("share", [0.0, 0.1, 0.19, 0.2, 0.29, 0.3, 0.6, 0.95, 1.0])
def test_nodes_and_cameras_learn_at_rates_that_fall_and_cameras_begin_late(scene, share):
    stage = stage_with(scene, rates=RATES, rate_decay_start=0.2, cameras_from=0.3)
    gone = 0.0 if share < 0.2 else (share - 0.2) / 0.8
    cameras = 0.0 if share < 0.3 else 1.0
    assert rates_at(stage, share)["shared"] == pytest.approx(
        {
            "node_xyz": 1e-3 * 0.01**gone,
            "node_quat": 4e-3 * 0.1**gone,
            "radius_logit": 7e-3,
            "camera_rotation": cameras * 2e-4 * 0.01**gone,
            "camera_position": cameras * 9e-5 * 0.1**gone,
        }
    )


@pytest.mark.parametrize("native", [False, True])
def test_where_static_gaussians_stand_at_another_time_is_not_learnt_from_tracks(scene, native):
    """They stand where they stand now; only how much they cover may change."""
    stage = stage_with(scene)
    model = stage.model
    model.kernels = Kernels(native and open_library()[0] is not None)
    now, later = model.dynamic_at(*(float(model.times[i]) for i in (FRAME, PARTNER)))
    colors = model.drawn(now, model.rig.camera(FRAME, 32, 24), later.means).colors
    static, means = len(model.static), model.static.parameters["means"]
    np.testing.assert_array_equal(colors[:static, 4:].detach(), means.detach())
    colors[:, 3:].sum().backward()
    assert means.grad is None or not means.grad.any()
