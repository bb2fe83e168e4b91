"""The training loop: which rate each parameter learns at."""

import dataclasses

import pytest
from toy import clip_and_priors

from f4x_core.fit.config import GaussianRates, RateConfig, profile
from f4x_core.fit.pipeline import start_fit

pytestmark = pytest.mark.usefixtures("one_thread")

STATIC = GaussianRates((1e-3, 1e-5), (2e-3, 2e-4), (3e-2, 3e-3), (0.1, 0.1), (4e-2, 4e-3))
DYNAMIC = GaussianRates((5e-3, 5e-5), (6e-3, 6e-3), (7e-2, 7e-3), (0.2, 0.02), (8e-2, 8e-2))


def rates_at(stage, share):
    stage.step = round(share * stage.config.steps)
    stage._set_rates()
    return {
        kind: {group["name"]: group["lr"] for group in optimiser.adam.param_groups}
        for kind, optimiser in stage.optimisers.items()
    }


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
