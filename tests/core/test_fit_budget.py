"""What a fit costs, and fits within what was granted."""

import dataclasses

import pytest

from f4x_core.errors import F4xError
from f4x_core.fit import budget
from f4x_core.fit.budget import ClipSize, Grant, cost, max_gaussians, raster_seconds, within
from f4x_core.fit.config import profile

SIZE, UNIT = ClipSize(80, 480, 270), 0.006


@pytest.fixture(autouse=True)
def machine(monkeypatch):
    """A machine of 32 GB, whatever this one has."""
    monkeypatch.setattr(budget, "machine_memory", lambda: 32.0)


def test_larger_pictures_more_steps_and_more_frames_cost_more():
    usual = cost(SIZE, profile("quick"), UNIT)
    for size, config in (
        (ClipSize(160, 480, 270), profile("quick")),
        (ClipSize(80, 854, 480), profile("quick")),
        (SIZE, profile("wild")),
    ):
        more = cost(size, config, UNIT)
        assert more.minutes > usual.minutes
        assert more.memory >= usual.memory
    slower = cost(SIZE, profile("quick"), 2 * UNIT)
    assert slower.minutes == pytest.approx(2 * usual.minutes)
    assert (slower.memory, slower.file) == (usual.memory, usual.file)


def test_priors_of_large_clips_cost_what_those_of_small_ones_do():
    config = dataclasses.replace(profile("quick"), steps=1)
    large, small = cost(ClipSize(80, 1920, 1080), config, UNIT), cost(SIZE, config, UNIT)
    assert large.minutes < 8 * small.minutes  # sixteen times the pixels


@pytest.mark.parametrize("grant", [Grant(minutes=4), Grant(memory=1.9), Grant(4, 1.9)])
def test_what_is_granted_is_kept_and_used(grant):
    config, size = profile("quick"), ClipSize(80, 854, 480)
    fitting = within(grant, size, config, UNIT)
    found = cost(size, fitting, UNIT)
    assert found.minutes <= (grant.minutes or 1e9) * 1.001
    assert found.memory <= (grant.memory or 1e9) * 1.001
    used = max(found.minutes / (grant.minutes or 1e9), found.memory / (grant.memory or 1e9))
    assert used > 0.95
    ratio = max_gaussians(fitting) / max_gaussians(config)
    for name in ("spawn_static", "spawn_dynamic", "density_static", "density_dynamic"):
        assert getattr(fitting, name).max_count == pytest.approx(ratio * getattr(config, name).max_count, rel=1e-3)


def test_more_than_the_profile_takes_is_used_too():
    config = profile("quick")
    assert max_gaussians(within(Grant(minutes=60), SIZE, config, UNIT)) > 2 * max_gaussians(config)


def test_a_small_machine_takes_fewer_gaussians_or_refuses(monkeypatch):
    config, size = profile("wild"), ClipSize(80, 1920, 1080)
    monkeypatch.setattr(budget, "machine_memory", lambda: 9.0)
    fitting = within(Grant(), size, config, UNIT)
    assert max_gaussians(fitting) < max_gaussians(config)
    assert cost(size, fitting, UNIT).memory <= 4.501
    monkeypatch.setattr(budget, "machine_memory", lambda: 2.0)
    with pytest.raises(F4xError, match="grant more"):
        within(Grant(), size, config, UNIT)


def test_no_grant_changes_nothing():
    config = profile("wild")
    assert within(Grant(), SIZE, config, UNIT) is config


@pytest.mark.parametrize("grant", [Grant(minutes=0.1), Grant(memory=0.3)])
def test_too_little_is_refused_with_what_is_needed(grant):
    with pytest.raises(F4xError, match=r"takes at least .* minutes and .* GB .*; grant more"):
        within(grant, SIZE, profile("quick"), UNIT)


def test_the_machine_is_timed():
    assert 0 < raster_seconds(1) < 60
