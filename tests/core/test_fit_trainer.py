"""Steps of the training loop on a few Gaussians beside frozen ones: Adam written out, what is drawn, when it is saved."""

import copy
import dataclasses

import numpy as np
import pytest
import torch
from carried_scene import FRAMES, HEIGHT, WIDTH, carried_scene, spawned_at
from toy import clip_and_priors

from f4x_core.errors import Cancelled
from f4x_core.fit import trainer
from f4x_core.fit.config import EndingConfig, LossConfig, NodeConfig, profile
from f4x_core.fit.frame_data import Window
from f4x_core.fit.loss_terms import total_loss
from f4x_core.fit.trainer import FitStart, Trainer
from f4x_core.gaussians import DensityConfig, SpawnConfig, spawn_static
from f4x_core.geometry.splats import Splats

pytestmark = pytest.mark.usefixtures("one_thread")

MOVING = np.array([[0.1, 0.1, 0.0], [0.9, 0.2, 0.1], [2.6, -0.2, 0.0], [1.5, 0.6, 0.0], [3.0, 0.4, 0.3]])


@pytest.fixture
def stage_of():
    """A trainer of three static, five dynamic and, `frozen`, two Gaussians that never change."""

    def make(frozen: bool = True, **changes) -> Trainer:
        model = carried_scene(MOVING, np.arange(5) % FRAMES)
        if frozen:
            behind = spawn_static(spawned_at(np.array([[0.5, 0, 1], [1.5, 0.2, 1]])), 1, SpawnConfig())
            own = behind.parameters
            model.frozen = Splats(own["means"], own["quats"], behind.scales, behind.opacities, behind.sh).map(
                torch.Tensor.detach
            )
        clip, priors = clip_and_priors(FRAMES)
        still = DensityConfig(every=0, max_scale=1e9)
        settings = {
            "steps": 8,
            "density_static": still,
            "density_dynamic": still,
            "nodes": NodeConfig(add_at=(), drop_at=()),
            "max_sh_degree": 0,
            "coarse": 0.0,
            "closeups": 0,
            "cameras_from": 0.0,
            "graph_every": 100,
            "dw_from": 0.0,
            "threads": 1,
            "backend": "torch",
        }
        return Trainer(model, clip, priors, dataclasses.replace(profile("quick"), **settings | changes), FitStart(900))

    return make


def parameters_of(stage: Trainer) -> dict[tuple[str, str], torch.Tensor]:
    found = {(kind, name): value for kind, own in stage.model.sets() for name, value in own.parameters.items()}
    shared = stage.model.rig.parameters | stage.model.nodes.parameters
    return found | {("shared", name): value for name, value in shared.items()}


def rates_of(stage: Trainer) -> dict[tuple[str, str], float]:
    groups = {kind: optimiser.adam.param_groups for kind, optimiser in stage.optimisers.items()}
    groups["shared"] = stage.shared.param_groups
    return {(kind, group["name"]): group["lr"] for kind, own in groups.items() for group in own}


def test_a_step_moves_every_parameter_as_adam_does_along_the_gradient_of_the_loss(stage_of, monkeypatch):
    """Adam of Kingma and Ba in float64, at the rates of the step, with an epsilon that no gradient feels."""
    stage = stage_of()
    twin, looks, render = stage_of(), [], stage.render
    monkeypatch.setattr(stage, "render", lambda *look: looks.append(look) or render(*look))
    first, second = ({key: 0.0 for key in parameters_of(stage)} for _ in range(2))
    for step in range(1, 5):
        before = {key: value.detach().clone() for key, value in parameters_of(stage).items()}
        state = stage.generator.get_state()
        result = stage.train_step()
        frame, level, background = looks[-1]
        assert background.shape == (3,) and level is stage.levels[0]
        twin.step = stage.step - 1
        twin.generator.set_state(state)
        twin._act(trainer.Moment.START)
        twin._next_of(twin.order, range(len(twin.model.times))), torch.rand(3, generator=twin.generator)
        with torch.no_grad():
            for key, value in parameters_of(twin).items():
                value.copy_(before[key])
                value.grad = None
        loss = total_loss(twin.losses, twin.step, twin.render(frame, level, background))
        loss.backward()
        assert result == stage.loss == pytest.approx(float(loss.detach()), rel=1e-6)
        rates, after = rates_of(stage), parameters_of(stage)
        for key, value in parameters_of(twin).items():
            gradient = np.zeros(value.shape) if value.grad is None else value.grad.double().numpy()
            first[key] = 0.9 * first[key] + 0.1 * gradient
            second[key] = 0.999 * second[key] + 0.001 * gradient**2
            root = np.sqrt(second[key] / (1 - 0.999**step))
            moved = rates[key] * (first[key] / (1 - 0.9**step)) / np.where(root > 0, root, 1)
            if key[1].endswith("means"):  # places learn at the rate of depth 1, by the pixel
                moved *= dict(stage.model.sets())[key[0]].labels["reach"].numpy()[:, None]
            expected = before[key].double().numpy() - moved
            sure = root > 1e-9  # float32 knows smaller gradients by their rounding alone
            np.testing.assert_allclose(
                after[key].detach().numpy()[sure], expected[sure], atol=0.02 * rates[key] + 1e-7, err_msg=str(key)
            )
        assert all(value.grad is None for value in parameters_of(stage).values())
    assert stage.step == 4 and min(rates.values()) > 0


@pytest.mark.parametrize("backend", ["torch", "native"])
def test_a_closeup_shows_its_part_of_the_picture_and_moves_what_moves_alone(stage_of, backend, request):
    if backend == "native":
        request.getfixturevalue("native_library")
    stage = stage_of(backend=backend, closeups=2, track_every=1, cameras_from=0.0)
    window = Window(20, 10, 24, 16)
    stage.levels[0].moving_windows = dict.fromkeys(range(FRAMES), window)
    black = torch.zeros(3)
    whole, part = (stage.render(1, stage.levels[0], black, one) for one in (None, window))
    torch.testing.assert_close(
        part.output.channels[..., :4], window.of(whole.output.channels)[..., :4], atol=2e-5, rtol=0
    )
    assert part.partner is None
    before = {key: value.detach().clone() for key, value in parameters_of(stage).items()}
    stage.train_step()  # the rates
    before = {key: value.detach().clone() for key, value in parameters_of(stage).items()}
    stage._take_closeup(stage.levels[0])
    moved = {kind for (kind, name), value in parameters_of(stage).items() if not torch.equal(value, before[kind, name])}
    cameras = [key for key in before if key[1].startswith("camera")]
    assert "dynamic" in moved and "static" not in moved
    assert all(torch.equal(parameters_of(stage)[key], before[key]) for key in cameras)
    assert not torch.equal(parameters_of(stage)["shared", "node_xyz"], before["shared", "node_xyz"])
    assert all(value.grad is None for value in parameters_of(stage).values())


def test_each_frame_in_which_something_moves_has_a_closeup_before_one_has_a_second(stage_of):
    stage = stage_of(closeups=2)
    stage.levels[0].moving_windows = windows = dict.fromkeys((0, 2, 3), Window(0, 0, 9, 9))
    drawn = [stage._next_of(stage.closeup_order, windows) for _ in range(9)]
    assert [sorted(drawn[i : i + 3]) for i in (0, 3, 6)] == [[0, 2, 3]] * 3 and len({*drawn[:3]}) == 3
    stage.aside = frozenset({0, 2, 3})
    assert stage._next_of(stage.closeup_order, windows) is None
    stage._take_closeup(stage.levels[0])  # nothing to draw


def test_what_is_frozen_is_drawn_stays_where_it_is_and_has_no_part_in_density_control(stage_of, monkeypatch):
    stage = stage_of()
    assert len(stage.model) == 8
    drawn, rasterize = [], trainer.rasterize

    def watched(splats, colors, camera, **more):
        out = rasterize(splats, colors, camera, **more)
        drawn.append((splats.means.detach().clone(), colors[:, 3:].detach(), out.visible))
        return out

    monkeypatch.setattr(trainer, "rasterize", watched)
    monkeypatch.setattr(type(stage.tracks), "random_partner", lambda self, frame, generator: (frame + 1) % FRAMES)
    stage.train_step()
    means, extra, visible = drawn[0]
    assert means.shape == (10, 3) and extra.shape == (10, 4)
    assert extra[:, 0].tolist() == [0.0] * 3 + [1.0] * 5 + [0.0] * 2
    np.testing.assert_array_equal(extra[:3, 1:], means[:3])
    np.testing.assert_array_equal(extra[8:, 1:], means[8:])
    assert np.abs(extra[3:8, 1:] - means[3:8]).max() > 0.05, "what moves is elsewhere at the partner's time"
    for name, rows in (("static", slice(0, 3)), ("dynamic", slice(3, 8))):
        assert stage.controls[name].seen.tolist() == visible[rows].float().tolist()
    assert len(stage_of(frozen=False).render(1, stage.levels[0]).offset) == 8
    picture = stage.picture(1)
    stage.model.frozen = None
    assert picture.shape == (HEIGHT, WIDTH, 3) and (picture - stage.picture(1)).abs().max() > 0.01


def test_pictures_are_clamped_to_what_can_be_shown(stage_of):
    stage = stage_of()
    with torch.no_grad():
        stage.model.static.parameters["sh0"].fill_(9)
        stage.model.static.parameters["log_scales"].fill_(0)
    assert stage.picture(0).max() == 1 and stage.picture(0).min() >= 0


@pytest.mark.parametrize(("period", "saved"), [(3, [3, 6, 8]), (4, [4, 8]), (0, [8])])
def test_checkpoints_are_written_every_so_often_and_at_the_end(stage_of, monkeypatch, tmp_path, period, saved):
    stage, written, result = stage_of(checkpoint_every=period, measure_every=4), [], []
    monkeypatch.setattr(
        trainer, "save_checkpoint", lambda path, state: written.append((path, state["step"], state["config_hash"]))
    )
    stage.run(tmp_path / "c", "hash", lambda *words: result.append(words))
    assert written == [(tmp_path / "c", step, "hash") for step in saved]
    assert [words[:3] for words in result] == [("photometric", step, 8) for step in range(1, 9)]
    assert [point["step"] for point in stage.history] == [4, 8]
    assert result[2][3] == "" and result[7][3].startswith(f"{stage.history[1]['psnr']:.1f} dB, 8 ")
    assert result[4][3].startswith(f"{stage.history[0]['psnr']:.1f} dB")


@pytest.mark.parametrize("inside", [True, False])
def test_an_interrupt_between_steps_is_saved_and_one_inside_a_step_is_not(stage_of, monkeypatch, tmp_path, inside):
    stage, written = stage_of(checkpoint_every=100), []
    monkeypatch.setattr(trainer, "save_checkpoint", lambda path, state: written.append(state["step"]))
    real = stage._set_rates

    def interrupt(*words):
        if stage.step == 5:
            raise Cancelled
        return None if words else real()

    if inside:
        stage.actions = [
            dataclasses.replace(action, run=interrupt) if action.name == "learning rates" else action
            for action in stage.actions
        ]
        interrupt_outside = trainer.silent
    else:
        interrupt_outside = interrupt
    with pytest.raises(Cancelled):
        stage.run(tmp_path / "c", "", interrupt_outside)
    assert written == ([] if inside else [5])


def test_a_restored_fit_goes_on_bit_for_bit(stage_of):
    """After a graph was rebuilt, offsets were learnt, Gaussians came and means were begun."""
    growing = DensityConfig(
        every=2, start=0, stop=1, gradient=0, growth=0.5, min_count=1, prune_opacity=0, max_scale=1e9
    )
    settings = {
        "graph_every": 1, "dw_from": 0.3, "density_static": growing, "density_dynamic": growing, "measure_every": 2,
        "average_from": 0.2, "losses": LossConfig(track=0),
    }  # fmt: skip
    whole, cut = stage_of(**settings), stage_of(**settings)
    for _ in range(5):
        whole.train_step(), cut.train_step()
    again = stage_of(**settings)
    again.restore(copy.deepcopy(cut.state("x")))
    assert (again.step, again.next_id, again.history) == (5, cut.next_id, cut.history) and cut.next_id > 900
    for stage in (whole, again):
        while stage.step < stage.config.steps:
            stage.train_step()
    for key, value in parameters_of(whole).items():
        assert torch.equal(value, parameters_of(again)[key]), key
    assert whole.history == again.history and whole.next_id == again.next_id


def test_new_nodes_and_gaussians_are_counted_on(stage_of):
    stage = stage_of()
    assert stage.next_node_id == 24 and stage.next_id == 900 and np.isnan(stage.loss)
    assert stage_of(losses=LossConfig(mask=0)).fraction == 0


@pytest.fixture
def early(stage_of, monkeypatch):
    """A trainer of twenty steps that keeps frame 1 aside and measures it three times; `psnr` is what it then has."""

    def make(psnr: list[float], **changes) -> Trainer:
        monkeypatch.setattr(trainer, "frames_aside", lambda frames, ending: frozenset({1}))
        stage = stage_of(steps=20, ending=EndingConfig(min_gain=0.1, at=(0.3, 0.4, 0.5), goes_on_at=0.8), **changes)
        scores = iter(psnr)
        monkeypatch.setattr(stage, "_mean_psnr", lambda frames: next(scores) if list(frames) == [1] else 20.0)
        return stage

    return make


def drawn_by(stage: Trainer, monkeypatch) -> list[tuple[int, int]]:
    """Steps and frames of a whole fit."""
    looks, render = [], stage.render
    monkeypatch.setattr(stage, "render", lambda frame, *rest: looks.append((stage.step, frame)) or render(frame, *rest))
    stage.run()
    return looks


@pytest.mark.parametrize(
    ("psnr", "steps"),
    [
        ([20.0, 20.05], [*range(8), *range(16, 20)]),
        ([20.0, 20.2, 20.1], [*range(10), *range(16, 20)]),
        ([20.0, 20.2, 20.31], [*range(20)]),
    ],
)
def test_a_fit_skips_steps_once_the_frames_kept_aside_gain_no_more(early, monkeypatch, psnr, steps):
    stage = early(psnr)
    looks = drawn_by(stage, monkeypatch)
    assert [step for step, _ in looks] == steps and stage.skipped == 20 - len(steps)
    assert stage.aside_psnr == psnr
    until = 10 if stage.skipped == 0 else 16
    assert all(frame != 1 for step, frame in looks if step < until)
    assert any(frame == 1 for step, frame in looks if step >= until)


def test_a_fit_that_ends_early_is_resumed_bit_for_bit(early, monkeypatch):
    whole, cut = early([20.0, 20.05]), early([20.0, 20.05])
    monkeypatch.setattr(whole, "_mean_psnr", lambda frames: 20.0)
    monkeypatch.setattr(cut, "_mean_psnr", lambda frames: 20.0)
    whole.run()
    for _ in range(9):
        cut.train_step()
    again = early([])
    again.restore(copy.deepcopy(cut.state("")))
    assert (again.step, again.skipped, again.aside_psnr) == (17, 8, [20.0, 20.0])
    monkeypatch.setattr(again, "_mean_psnr", lambda frames: 20.0)
    again.run()
    for key, value in parameters_of(whole).items():
        assert torch.equal(value, parameters_of(again)[key]), key


@pytest.mark.parametrize(("frames", "aside"), [(31, set()), (32, {6, 12, 19, 25}), (100, {20, 40, 59, 79})])
def test_frames_are_kept_aside_of_long_clips_alone(frames, aside):
    assert trainer.frames_aside(frames, EndingConfig(min_gain=0.1)) == aside
    assert trainer.frames_aside(frames, EndingConfig()) == frozenset()
