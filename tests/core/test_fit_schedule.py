"""What the training loop does at which step: resolution, cameras, graph, nodes, harmonics, density control."""

import copy
import dataclasses
from collections.abc import Iterator

import numpy as np
import pytest
import torch
from toy import WIDTH, clip_and_priors

from f4x_core.fit import trainer
from f4x_core.fit.config import LossConfig, NodeConfig, RateConfig, profile
from f4x_core.fit.harmonics import GAIN_DB, Band
from f4x_core.fit.loss_terms import total_loss
from f4x_core.fit.pipeline import start_fit
from f4x_core.fit.trainer import FitStart, Trainer
from f4x_core.gaussians import DensityConfig

pytestmark = pytest.mark.usefixtures("one_thread")

FRAMES = 6
STILL = DensityConfig(every=0)
PLAIN = LossConfig(track=0, camera_smoothness=0)


# The only places that know how the loop is called inside.


def steps_of(stage: Trainer) -> Iterator[int]:
    """Train to the end, giving each step's number after it was done."""
    while stage.step < stage.config.steps:
        stage.train_step()
        yield stage.step - 1


def watch(monkeypatch, name: str, answer) -> None:
    """`answer(*arguments)` in place of the loop's own `add_nodes`, `drop_nodes` or `next_band`."""
    monkeypatch.setattr(trainer, name, answer)


def loss_of(stage: Trainer, frame: int):
    """(loss, the offsets of the projected means (N,2), visible (N,)) of a frame at the full size before black."""
    rendered = stage.render(frame, stage.levels[0])
    return total_loss(stage.losses, stage.step, rendered), rendered.offset, rendered.output.visible


@pytest.fixture(scope="module")
def start():
    clip, priors = clip_and_priors(FRAMES)
    config = dataclasses.replace(profile("quick"), steps=40, threads=1, backend="torch")
    return start_fit(clip, priors, config).model, clip, priors


@pytest.fixture
def stage_of(start):
    """A stage on a copy of the start with these settings; without density control unless one is given."""

    def make(steps: int, **changes) -> Trainer:
        model, clip, priors = start
        settings = {
            "density_static": STILL,
            "density_dynamic": STILL,
            "nodes": NodeConfig(add_at=(), drop_at=()),
            "losses": PLAIN,
            "closeups": 0,
            "max_sh_degree": 0,
            "threads": 1,
            "backend": "auto",
        }
        config = dataclasses.replace(profile("quick"), steps=steps, **settings | changes)
        return Trainer(copy.deepcopy(model), clip, priors, config, FitStart(10_000))

    return make


# ---- frames, resolution, background ------------------------------------------------------------------------------------


@pytest.mark.parametrize(("coarse", "halves"), [(0.3, 3), (0.0, 0), (0.25, 3)])
def test_the_first_steps_are_at_half_the_resolution(stage_of, monkeypatch, coarse, halves):
    stage, widths = stage_of(10, coarse=coarse), []
    rasterize = trainer.rasterize

    def watched(splats, colors, camera, **more):
        widths.append(camera.width)
        return rasterize(splats, colors, camera, **more)

    monkeypatch.setattr(trainer, "rasterize", watched)
    assert list(steps_of(stage)) == list(range(10))
    assert widths == [WIDTH // 2] * halves + [WIDTH] * (10 - halves)


def test_every_frame_is_seen_once_before_one_is_seen_again_in_random_order(stage_of, monkeypatch):
    stage, seen = stage_of(3 * FRAMES), []
    render = stage.render
    monkeypatch.setattr(stage, "render", lambda frame, *more: seen.append(frame) or render(frame, *more))
    list(steps_of(stage))
    rounds = [seen[i : i + FRAMES] for i in range(0, len(seen), FRAMES)]
    assert all(sorted(one) == list(range(FRAMES)) for one in rounds)
    assert len({tuple(one) for one in rounds}) == 3


@pytest.mark.parametrize("random", [True, False])
def test_a_background_of_any_colour_when_asked_for(stage_of, monkeypatch, random):
    stage, colours = stage_of(5, random_background=random), []
    render = stage.render
    monkeypatch.setattr(
        stage,
        "render",
        lambda frame, data, background: colours.append(background) or render(frame, data, background),
    )
    list(steps_of(stage))
    if random:
        drawn = torch.stack(colours)
        assert drawn.shape == (5, 3) and drawn.unique().numel() == 15 and drawn.min() >= 0 and drawn.max() <= 1
    else:
        assert colours == [None] * 5


# ---- cameras and nodes -------------------------------------------------------------------------------------------------


def test_cameras_are_refined_from_their_step_on(stage_of):
    rates = RateConfig(camera_rotation=(1e-3, 1e-3), camera_position=(2e-3, 2e-3))
    stage = stage_of(10, cameras_from=0.4, rates=rates)
    own = stage.model.rig.parameters
    for step in steps_of(stage):
        moved = {name: float(value.detach().abs().max()) for name, value in own.items()}
        if step < 4:
            assert set(moved.values()) == {0.0}, step
        elif step == 4:
            for name, rate in (("camera_rotation", 1e-3), ("camera_position", 2e-3)):
                assert 0 < moved[name] < 1.5 * rate
    assert moved["camera_rotation"] > 1e-3 and moved["camera_position"] > 2e-3


def test_the_graph_is_built_anew_from_the_moved_nodes_until_offsets_are_learnt(stage_of):
    rates = RateConfig(node_xyz=(5e-3, 5e-3))
    stage = stage_of(20, graph_every=4, dw_from=0.6, rates=rates)
    model, rebuilt = stage.model, []
    before, stood = model.nodes, None
    for step in steps_of(stage):
        if model.nodes is not before:
            np.testing.assert_array_equal(model.nodes.scaffold.xyz, stood)
            assert model.nodes.parameters is before.parameters, "what is optimised goes on"
            rebuilt.append(step)
            before = model.nodes
        stood = model.nodes.parameters["node_xyz"].detach().numpy().copy()
        assert model.dynamic.use_dw == (step >= 12)
        assert bool(model.dynamic.parameters["dw"].detach().any()) == (step >= 12)
    assert rebuilt == [4, 8]


def test_nodes_are_added_and_dropped_at_their_steps_by_the_mean_gradient(stage_of, monkeypatch):
    called = []

    def add(model, optimiser, shared, gradient, config, next_node_id):
        control = stage.controls["dynamic"]
        mean = [float(s) / max(float(n), 1) for s, n in zip(control.gradient_sum, control.seen, strict=True)]
        np.testing.assert_allclose(gradient, mean, rtol=1e-5)
        assert max(mean) > 0 and float(control.seen.max()) > 1
        assert optimiser.gaussians is model.dynamic and shared is stage.shared
        called.append(("add", stage.step, next_node_id))
        return next_node_id + 3

    watch(monkeypatch, "add_nodes", add)
    watch(monkeypatch, "drop_nodes", lambda *_: called.append(("drop", stage.step)))
    stage = stage_of(20, nodes=NodeConfig(add_at=(0.26, 0.7), drop_at=(0.5, 0.7)))
    first = int(stage.model.nodes.scaffold.ids.max()) + 1
    list(steps_of(stage))
    assert called == [("add", 5, first), ("drop", 10), ("add", 14, first + 3), ("drop", 14)]


# ---- harmonics ---------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("changes", "gain", "asked", "degree"),
    [
        ({"max_sh_degree": 3}, GAIN_DB, [4, 10, 15], 3),
        ({"max_sh_degree": 3}, GAIN_DB - 1e-6, [4], 0),
        ({"max_sh_degree": 2}, 1.0, [4, 10], 2),
        ({"max_sh_degree": 0}, 1.0, [], 0),
        ({"max_sh_degree": 0, "sh_degree": 2}, -1.0, [4, 10], 2),
        ({"max_sh_degree": 3, "sh_degree": 1}, 1.0, [4], 1),
        ({"max_sh_degree": 3, "harmonics_at": (0.2,)}, 1.0, [4], 1),
    ],
)
def test_harmonics_are_considered_at_their_steps(stage_of, monkeypatch, changes, gain, asked, degree):
    steps = []

    def band(model, pictures, *_):
        assert pictures is stage.levels[0].rgb
        steps.append(stage.step)
        number = torch.arange(1.0, len(stage.model) + 1)[:, None, None]
        coefficients = 2 * len(steps) + 1
        return Band(gain, 0 * number.expand(-1, 1, 3), number.expand(-1, coefficients, 3) * 1e-3)

    watch(monkeypatch, "next_band", band)
    stage = stage_of(20, **{"harmonics_at": (0.2, 0.5, 0.75)} | changes)
    list(steps_of(stage))
    assert steps == asked and stage.band_gains == [gain] * len(asked)
    static, dynamic = stage.model.static, stage.model.dynamic
    assert static.sh.shape[1] == dynamic.sh.shape[1] == (degree + 1) ** 2
    if degree:
        first, second = (each.parameters["shN"].detach()[:, 0, 0] for each in (static, dynamic))
        rows = torch.arange(1.0, len(stage.model) + 1) * 1e-3
        torch.testing.assert_close(torch.cat([first, second]), rows, atol=0.03, rtol=0)
        follows = float(second[0] - first[0])  # rows of the dynamic set follow those of the static one
        assert follows == pytest.approx(1e-3 * len(static), abs=0.06)


# ---- density control ---------------------------------------------------------------------------------------------------


def test_density_control_is_given_the_gradient_of_the_projected_means_set_by_set(stage_of):
    stage, twin = (stage_of(4, coarse=0.0, random_background=False) for _ in range(2))
    frame = torch.randperm(FRAMES, generator=torch.Generator().manual_seed(twin.config.seed)).tolist()[-1]
    loss, offset, visible = loss_of(twin, frame)
    loss.backward()
    gradient = offset.grad.double().numpy()
    next(steps_of(stage))
    norms = [((gx * 64 / 2) ** 2 + (gy * 40 / 2) ** 2) ** 0.5 for gx, gy in gradient]
    still = len(stage.model.static)
    for name, rows in (("static", slice(0, still)), ("dynamic", slice(still, None))):
        control = stage.controls[name]
        np.testing.assert_allclose(control.gradient_sum, norms[rows], rtol=1e-4, atol=1e-9)
        np.testing.assert_array_equal(control.seen, visible[rows].double())
    # the offsets' gradient is that of the loss: one Gaussian's, by differences
    strongest, step = int(np.argmax(norms)), 1e-2
    shifted = []
    for sign in (1, -1):
        with pytest.MonkeyPatch.context() as patch:
            rasterize = trainer.rasterize

            def moved(*arguments, mean2d_offset, sign=sign, render=rasterize, **more):
                mean2d_offset = mean2d_offset.detach().clone()
                mean2d_offset[strongest, 0] += sign * step
                return render(*arguments, mean2d_offset=mean2d_offset, **more)

            patch.setattr(trainer, "rasterize", moved)
            shifted.append(float(loss_of(twin, frame)[0].detach().double()))
    slope = (shifted[0] - shifted[1]) / (2 * step)
    assert slope == pytest.approx(gradient[strongest, 0], rel=0.2)


def test_each_set_grows_by_its_own_settings_and_ids_are_never_used_twice(stage_of):
    def growing(every: int, **changes) -> DensityConfig:
        settings = {"start": 0.2, "stop": 0.7, "gradient": 1e-9, "growth": 0.01, "prune_opacity": 0.0} | changes
        return DensityConfig(every=every, **settings)

    stage = stage_of(20, density_static=growing(4), density_dynamic=growing(3, growth=0.02))
    grown = {"static": [], "dynamic": []}
    sizes = {"static": len(stage.model.static), "dynamic": len(stage.model.dynamic)}
    ids = set(torch.cat([s.labels["ids"] for s in (stage.model.static, stage.model.dynamic)]).tolist())
    for step in steps_of(stage):
        for name, gaussians in (("static", stage.model.static), ("dynamic", stage.model.dynamic)):
            if len(gaussians) > sizes[name]:
                grown[name].append(step)
                fresh = set(gaussians.labels["ids"].tolist()) - ids
                assert fresh and min(fresh) >= 10_000
                ids |= fresh
            sizes[name] = len(gaussians)
    assert grown == {"static": [4, 8, 12], "dynamic": [6, 9, 12]}
    own = torch.cat([s.labels["ids"] for s in (stage.model.static, stage.model.dynamic)])
    assert len(own.unique()) == len(own) and stage.next_id > int(own.max())
