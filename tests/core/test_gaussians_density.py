"""Density control against its rules, written out in numpy: who is halved, what the halves are, who goes."""

from dataclasses import replace

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
    every=1, start=0, stop=1, gradient=1.0, growth=10.0, max_growth=100.0, max_scale=1.0, prune_opacity=0.0, min_count=1
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
    return control.densify_and_prune(next_id)


def places(made: GaussianSet) -> list[float]:
    """x of each Gaussian, which `gaussians` set to its number."""
    return made.parameters["means"][:, 0].tolist()


def halved(made: GaussianSet, first_id: int = 1000) -> list[int]:
    """Numbers of the parents of the Gaussians with ids from `first_id` on: two children lie close to each."""
    children = made.parameters["means"].detach()[made.labels["ids"] >= first_id, 0]
    first, second = children.round().int().split(len(children) // 2)
    assert torch.equal(first, second)
    return first.tolist()


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
        assert halved(made) == [i for i in range(count) if mean[i] >= gradient]


def test_those_with_the_largest_gradients_are_taken_and_no_more_than_the_round_allows():
    made = gaussians(10)
    control = control_of(made, replace(ALWAYS, growth=0.3))
    seen_once(control, [2, 9, 2, 2, 8, 2, 7, 2, 2, 2])
    assert act(control) == 1006
    assert halved(made) == [1, 4, 6]
    assert made.labels["ids"].tolist() == [0, 2, 3, 5, 7, 8, 9, *range(1000, 1006)]


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


def test_who_reaches_the_threshold_is_halved():
    """Numbers that float32 holds exactly."""
    made = gaussians(3)
    control = control_of(made, replace(ALWAYS, gradient=2.0))
    gradient = torch.tensor([[0.0, 0.4], [0.2, 0.0], [0.1999, 0.0]])
    control.record(gradient, torch.ones(3, dtype=torch.bool), WIDTH, HEIGHT)
    assert act(control) == 1004
    assert made.labels["ids"].tolist() == [2, 1000, 1001, 1002, 1003] and halved(made) == [0, 1]


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
        seen_once(control, [0.0] * (len(made) - 1) + [5.0])
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


# ---- halves ------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("kind", ["static", "dynamic"])
@pytest.mark.parametrize("longest", [0, 1, 2])
def test_children_lie_to_either_side_along_the_longest_axis(kind, longest):
    """A Gaussian turned by 30 degrees about z, its orientation of length 2, with opacity .8."""
    half, sizes = np.pi / 12, np.full(3, 0.02)
    sizes[longest], sizes[(longest + 1) % 3] = 0.9, 0.3
    rotation = np.array([[np.cos(2 * half), -np.sin(2 * half), 0], [np.sin(2 * half), np.cos(2 * half), 0], [0, 0, 1]])
    made = gaussians(2, reach=10.0)
    place, turn = ("means", "quats") if kind == "static" else ("local_means", "local_quats")
    quats = 2 * torch.tensor([[np.cos(half), 0, 0, np.sin(half)]] * 2, dtype=torch.float32)
    placement = {place: torch.tensor([[5.0, 6, 7], [0, 0, 0]]).requires_grad_(), turn: quats.requires_grad_()}
    rest = {name: tensor for name, tensor in made.parameters.items() if name not in ("means", "quats")}
    with torch.no_grad():
        rest["log_scales"].copy_(torch.from_numpy(sizes).log().expand(2, 3))
        rest["opacity_logits"].fill_(float(np.log(4)))
    if kind == "static":
        made = StaticGaussians(placement | rest, made.labels)
    else:
        made = DynamicGaussians(
            placement | rest, made.labels | {"attach": torch.tensor([3, 4]), "reference": torch.tensor([1, 6])}
        )
    control, parent = control_of(made), {name: tensor.detach()[0].clone() for name, tensor in made.parameters.items()}
    seen_once(control, [5.0, 0.0])
    assert act(control) == 1002 and made.labels["ids"].tolist() == [1, 1000, 1001]
    children = {name: tensor.detach()[1:] for name, tensor in made.parameters.items()}
    aside = 0.9 * rotation[:, longest]
    np.testing.assert_allclose(children[place] - parent[place], [aside, -aside], rtol=1e-4, atol=1e-6)
    shrunk = sizes * np.where(np.arange(3) == longest, 0.55, 0.893)
    np.testing.assert_allclose(children["log_scales"].exp(), [shrunk, shrunk], rtol=1e-5)
    np.testing.assert_allclose(children["opacity_logits"].sigmoid(), 0.6 * 0.8, rtol=1e-5)
    for name in set(children) - {place, "log_scales", "opacity_logits"}:
        torch.testing.assert_close(children[name], parent[name].expand_as(children[name]), rtol=0, atol=0)
    assert {"reach": 10.0, "attach": 3, "reference": 1}.items() >= {
        name: label[1:].unique().item() for name, label in made.labels.items() if name not in ("ids", "earlier")
    }.items()


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
