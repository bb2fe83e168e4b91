"""Density control against its rules, written out in numpy: who is densified, how clones and splits come to be, who goes."""

from dataclasses import dataclass, replace

import numpy as np
import pytest
import torch

from f4x_core.gaussians import (
    DensityConfig,
    DensityControl,
    DynamicGaussians,
    GaussianSet,
    SetOptimiser,
    SpawnConfig,
    Spawned,
    StaticGaussians,
    spawn_static,
)
from f4x_core.native.kernels import TORCH, Kernels

WIDTH, HEIGHT = 20, 10  # a gradient of g loss per pixel is one of (10 g_x, 5 g_y) in NDC
ALWAYS = DensityConfig(
    every=1,
    start=0,
    stop=1,
    gradient=1.0,
    growth=10.0,
    max_growth=100.0,
    split_scale=0.1,
    max_scale=1.0,
    prune_opacity=0.0,
    min_count=1,
)
"""A round after every step for whoever reaches the gradient 1; nobody is capped or faint."""


def gaussians(count: int, scale=0.05, reach=1.0) -> StaticGaussians:
    """Gaussians in a row at x = 0, 1, ... of standard deviation `scale`, seen from `reach` away, ids 0, 1, ..."""
    xyz = np.zeros((count, 3), np.float32)
    xyz[:, 0] = np.arange(count)
    spawned = Spawned(xyz, np.full((count, 3), 0.5, np.float32), np.ones(count, np.float32), np.ones(count, np.float32))
    made = spawn_static(spawned, 1, SpawnConfig())
    made.labels["reach"] = torch.full((count,), reach)
    with torch.no_grad():
        made.parameters["log_scales"].copy_(torch.as_tensor(scale).expand(count, 3).log())
    return made


def control_of(
    made: GaussianSet, config: DensityConfig = ALWAYS, kernels: Kernels = TORCH, steps: int = 100
) -> DensityControl:
    return DensityControl(SetOptimiser(made, dict.fromkeys(made.parameters, 0.01), kernels), config, steps)


def seen_once(control: DensityControl, ndc: list[float] | np.ndarray) -> None:
    """One step that sees every Gaussian with a gradient of this norm in NDC."""
    gradient = torch.zeros(len(ndc), 2)
    gradient[:, 0] = torch.as_tensor(ndc, dtype=torch.float32) / (0.5 * WIDTH)
    control.record(gradient, torch.ones(len(ndc), dtype=torch.bool), WIDTH, HEIGHT)


def act(control: DensityControl, step: int = 1, next_id: int = 1000) -> int:
    if step not in control.steps:
        return next_id
    return control.densify_and_prune(next_id, torch.Generator().manual_seed(0))


def places(made: GaussianSet) -> list[float]:
    """x of each Gaussian, which `gaussians` set to its number."""
    return made.parameters["means"][:, 0].tolist()


# ---- who is densified ------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("kernels", [TORCH, Kernels(native=True, threads=2)])
def test_the_gradient_is_the_mean_norm_in_ndc_over_the_times_a_gaussian_was_seen(kernels, native_library):
    """Who is seen four times at 0.6 of the threshold stays; who is seen once at 1.2 times does not."""
    rng = np.random.default_rng(0)
    steps, count = 5, 6
    pixels, visible = rng.normal(size=(steps, count, 2)), rng.random((steps, count)) < 0.6
    visible[:, 0], visible[1:, 1], visible[:, 2] = True, False, False
    pixels[~visible] = 0
    total, times = np.zeros(count), np.zeros(count)
    for step in range(steps):
        for i in range(count):
            gx, gy = pixels[step, i]
            total[i] += ((gx * WIDTH / 2) ** 2 + (gy * HEIGHT / 2) ** 2) ** 0.5
            times[i] += visible[step, i]
    mean = [total[i] / times[i] if times[i] else 0.0 for i in range(count)]
    middle = float(np.sort(mean)[count // 2])
    for gradient in (0.999 * middle, 1.001 * middle):
        made = gaussians(count)
        control = control_of(made, replace(ALWAYS, gradient=gradient), kernels)
        for step in range(steps):
            control.record(torch.from_numpy(pixels[step]).float(), torch.from_numpy(visible[step]), WIDTH, HEIGHT)
        act(control)
        assert places(made)[count:] == [i for i in range(count) if mean[i] >= gradient]


def test_those_with_the_largest_gradients_are_taken_and_no_more_than_the_round_allows():
    made = gaussians(10)
    control = control_of(made, replace(ALWAYS, growth=0.3))
    seen_once(control, [2, 9, 2, 2, 8, 2, 7, 2, 2, 2])
    assert act(control) == 1003
    assert places(made) == [*range(10), 1, 4, 6]
    assert made.labels["ids"].tolist() == [*range(10), 1000, 1001, 1002]


@pytest.mark.parametrize(
    ("max_count", "max_growth", "added", "lacking"),
    [(12, 1.5, 2, 2), (12, 1.2, 2, 2), (13, 1.2, 2, 0), (40, 1.5, 4, 0)],
)
def test_what_growth_lacks_is_what_its_largest_number_kept_out(max_count, max_growth, added, lacking):
    """Ten Gaussians, of which a round may add four; growth beyond what the clip asked for lacks nothing."""
    made = gaussians(10)
    config = replace(ALWAYS, growth=0.4, gradient=1e-3, max_count=max_count, max_growth=max_growth)
    control = control_of(made, config)
    seen_once(control, np.ones(10))
    act(control)
    assert len(made) == 10 + added and control.lacking == lacking


def test_who_reaches_the_threshold_is_densified_and_who_is_as_large_as_the_limit_is_cloned():
    """Numbers that float32 holds exactly."""
    made = gaussians(3, scale=1.0)
    control = control_of(made, replace(ALWAYS, gradient=2.0, split_scale=0.5))
    made.labels["reach"] = torch.tensor([2.0, 1.875, 2.0])
    gradient = torch.tensor([[0.0, 0.4], [0.2, 0.0], [0.1999, 0.0]])
    control.record(gradient, torch.ones(3, dtype=torch.bool), WIDTH, HEIGHT)
    assert act(control) == 1003
    assert made.labels["ids"].tolist() == [0, 2, 1000, 1001, 1002], "the first is cloned, the second split"


@pytest.mark.parametrize(
    ("changes", "most"), [({"max_count": 12}, 12), ({"max_growth": 1.4}, 14), ({"growth": 0.05}, 10), ({}, 20)]
)
def test_a_set_grows_to_its_limit_and_no_further(changes, most):
    made = gaussians(10)
    control = control_of(made, replace(ALWAYS, **changes))
    seen_once(control, [5.0] * 10)
    act(control)
    assert len(made) == most
    if most < 20:
        seen_once(control, [5.0] * most)
        act(control, next_id=2000)
        assert len(made) == most


def test_rounds_come_at_their_period_between_start_and_stop_and_begin_from_nothing():
    made = gaussians(3)
    control = control_of(made, replace(ALWAYS, every=3, start=0.2, stop=0.6, growth=0.4, max_growth=3.0), steps=30)
    grown = []
    for step in range(30):
        seen_once(control, [5.0] + [0.0] * (len(made) - 1))
        before = len(made)
        act(control, step, 1000 + step)
        if len(made) > before:
            grown.append(step)
            assert len(control.seen) == len(control.gradient_sum) == len(made)
            assert control.seen.sum() == control.gradient_sum.sum() == 0
    assert grown == [6, 9, 12, 15], "18 = 0.6 x 30 is outside"


def test_a_period_of_zero_switches_it_off():
    made = gaussians(3)
    control = control_of(made, replace(ALWAYS, every=0))
    seen_once(control, [5.0] * 3)
    assert act(control) == 1000 and len(made) == 3


# ---- clones and splits -----------------------------------------------------------------------------------------------


def test_what_is_large_for_its_reach_is_split_what_is_small_is_cloned():
    made = gaussians(4)
    with torch.no_grad():
        made.parameters["log_scales"].copy_(
            torch.tensor([[0.01, 0.09, 0.01], [0.01, 0.11, 0.01], [0.11] * 3, [0.3] * 3]).log()
        )
    made.labels["reach"] = torch.tensor([1.0, 1.0, 2.0, 2.0])
    control = control_of(made)
    seen_once(control, [5.0] * 4)
    assert act(control) == 1006
    ids = made.labels["ids"].tolist()
    assert ids == [0, 2, *range(1000, 1006)], "0 and 2 stay and are cloned, 1 and 3 are replaced by two each"
    where = dict(zip(ids, range(len(ids)), strict=True))
    for clone, parent in ((1000, 0), (1001, 2)):
        for name, tensor in made.parameters.items():
            assert torch.equal(tensor[where[clone]], tensor[where[parent]]), name
    shrunk = made.scales.detach()[[where[i] for i in (1002, 1003, 1004, 1005)]].double().numpy()
    wanted = np.array([[0.01, 0.11, 0.01], [0.3] * 3, [0.01, 0.11, 0.01], [0.3] * 3]) / 1.6
    np.testing.assert_allclose(shrunk, wanted, rtol=1e-5)


@dataclass
class Split:
    """What became of many equal Gaussians at the origin that were split."""

    parent: dict[str, torch.Tensor]
    children: GaussianSet


def split(kind: str) -> Split:
    """1000 long Gaussians, their x axis turned by 30 degrees about z; orientations of length 2."""
    count, half = 1000, np.pi / 12
    made = gaussians(count, reach=10.0)
    quat = 2 * torch.tensor([np.cos(half), 0, 0, np.sin(half)], dtype=torch.float32).repeat(count, 1)
    with torch.no_grad():
        made.parameters["log_scales"].copy_(torch.tensor([0.9, 0.3, 0.02]).log().expand(count, 3))
    place, turn = ("means", "quats") if kind == "static" else ("local_means", "local_quats")
    placement = {place: torch.zeros(count, 3).requires_grad_(), turn: quat.requires_grad_()}
    rest = {name: tensor for name, tensor in made.parameters.items() if name not in ("means", "quats")}
    if kind == "static":
        made = StaticGaussians(placement | rest, made.labels)
    else:
        labels = made.labels | {"attach": torch.arange(count), "reference": torch.arange(count) % 7}
        made = DynamicGaussians(placement | rest, labels)
    parent = {name: tensor.detach()[0].clone() for name, tensor in made.parameters.items()}
    control = control_of(made, replace(ALWAYS, split_scale=0.05, max_count=3000))
    seen_once(control, [5.0] * count)
    act(control)
    return Split(parent, made)


@pytest.mark.parametrize("kind", ["static", "dynamic"])
def test_a_split_draws_two_from_the_gaussian_itself_and_makes_each_1_6_times_smaller(kind):
    """Their places have the covariance R diag(s^2) R^T of the one that they replace."""
    found = split(kind)
    place, turn = ("means", "quats") if kind == "static" else ("local_means", "local_quats")
    made = found.children
    assert len(made) == 2000 and made.labels["ids"].tolist() == list(range(1000, 3000))
    np.testing.assert_allclose(made.scales.detach().numpy(), np.tile([0.9, 0.3, 0.02], (2000, 1)) / 1.6, rtol=1e-5)
    angle = np.pi / 6
    rotation = np.array([[np.cos(angle), -np.sin(angle), 0], [np.sin(angle), np.cos(angle), 0], [0, 0, 1]])
    sampled = made.parameters[place].detach().double().numpy()
    np.testing.assert_allclose(sampled.mean(0), 0, atol=0.06)
    covariance = np.cov((sampled @ rotation).T)  # in the Gaussian's own frame
    np.testing.assert_allclose(np.sqrt(np.diag(covariance)), [0.9, 0.3, 0.02], rtol=0.06)
    correlation = covariance / np.sqrt(np.outer(np.diag(covariance), np.diag(covariance)))
    np.testing.assert_allclose(correlation, np.eye(3), atol=0.08)
    for name in set(made.parameters) - {place, "log_scales"}:
        torch.testing.assert_close(made.parameters[name].detach(), found.parent[name].expand_as(made.parameters[name]))
    assert made.parameters[turn].norm(dim=1).allclose(torch.tensor(2.0))
    if kind == "dynamic":
        assert made.labels["attach"].tolist() == 2 * list(range(1000))
        assert made.labels["reference"].tolist() == 2 * [i % 7 for i in range(1000)]
    assert (made.labels["reach"] == 10).all()


def test_a_split_stays_around_its_place():
    made = gaussians(4, scale=1e-3, reach=1e-3)
    control = control_of(made, replace(ALWAYS, max_count=100))
    seen_once(control, [5.0] * 4)
    act(control)
    np.testing.assert_allclose(places(made), [0, 1, 2, 3, 0, 1, 2, 3], atol=6e-3)


def test_the_two_of_a_split_are_drawn_apart():
    first, second = split("static").children.parameters["means"].detach().split(1000)
    assert (first - second).norm(dim=1).min() > 0
    assert np.corrcoef(first[:, 0].numpy(), second[:, 0].numpy())[0, 1] == pytest.approx(0, abs=0.1)


# ---- who goes, and who is capped ---------------------------------------------------------------------------------------


def faint(opacities: list[float]) -> StaticGaussians:
    made = gaussians(len(opacities))
    with torch.no_grad():
        made.parameters["opacity_logits"].copy_(torch.tensor(opacities).logit())
    return made


def test_the_faint_go_at_a_round_and_not_between():
    made = faint([0.5, 0.019, 0.021, 0.9, 0.001])
    control = control_of(made, replace(ALWAYS, every=2, prune_opacity=0.02))
    act(control, step=1)
    assert len(made) == 5
    act(control, step=2)
    assert places(made) == [0, 2, 3]


def test_of_too_few_the_least_faint_stay():
    made = faint([0.001, 0.004, 0.002, 0.9, 0.003])
    act(control_of(made, replace(ALWAYS, prune_opacity=0.02, min_count=3)))
    assert places(made) == [1, 3, 4]
    few = faint([0.001, 0.002])
    act(control_of(few, replace(ALWAYS, prune_opacity=0.02, min_count=3)))
    assert places(few) == [0, 1]


@pytest.mark.parametrize("kernels", [TORCH, Kernels(native=True, threads=2)])
def test_sizes_are_capped_by_every_step_to_a_fraction_of_the_reach(kernels, native_library):
    made = gaussians(3)
    scale = np.array([[0.05, 0.2, 0.1], [0.4, 0.5, 0.6], [9.0, 0.01, 0.3]])
    with torch.no_grad():
        made.parameters["log_scales"].copy_(torch.from_numpy(scale).log())
    made.labels["reach"] = torch.tensor([1.0, 5.0, 3.0])
    optimiser = control_of(made, replace(ALWAYS, every=50, max_scale=0.1), kernels).optimiser
    made.parameters["log_scales"].grad = torch.zeros(3, 3)
    optimiser.step()
    np.testing.assert_allclose(made.scales.detach(), np.minimum(scale, [[0.1], [0.5], [0.3]]), rtol=1e-5)
