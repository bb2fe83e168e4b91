"""What a fit costs, and fits within what was granted."""

import dataclasses
import os
import re
import time

import numpy as np
import pytest
import torch

from f4x_core import raster
from f4x_core.errors import F4xError
from f4x_core.fit import budget
from f4x_core.fit.budget import (
    ClipSize,
    Grant,
    MachineSpeed,
    cost,
    expected_gaussians,
    for_clip,
    machine_memory,
    max_gaussians,
    within,
)
from f4x_core.fit.config import for_frames, profile
from f4x_core.fit.tints import TintConfig
from f4x_core.gaussians import DensityConfig, SpawnConfig

SIZE, SPEED, SLOW = ClipSize(80, 480, 270), MachineSpeed(0.012, 2), MachineSpeed(0.02, 2)


@pytest.fixture(autouse=True)
def machine(monkeypatch):
    """A machine of 32 GB, whatever this one has."""
    monkeypatch.setattr(budget, "machine_memory", lambda: 32.0)


def test_larger_pictures_more_steps_and_more_frames_cost_more():
    usual = cost(SIZE, profile("quick"), SPEED)
    for size, config in (
        (ClipSize(160, 480, 270), profile("quick")),
        (ClipSize(80, 854, 480), profile("quick")),
        (SIZE, profile("wild")),
    ):
        more = cost(size, config, SPEED)
        assert more.minutes > usual.minutes
        assert more.memory >= usual.memory
    slower = cost(SIZE, profile("quick"), MachineSpeed(0.024, 2))
    assert slower.minutes == pytest.approx(2 * usual.minutes)
    assert (slower.memory, slower.file) == (usual.memory, usual.file)


def test_priors_of_large_clips_cost_what_those_of_small_ones_do():
    config = dataclasses.replace(profile("quick"), steps=1)
    large, small = cost(ClipSize(80, 1920, 1080), config, SPEED), cost(SIZE, config, SPEED)
    assert large.minutes < 8 * small.minutes  # sixteen times the pixels


@pytest.mark.parametrize("grant", [Grant(minutes=6.5), Grant(memory=1.9), Grant(6.5, 1.9)])
def test_what_is_granted_is_kept_and_used(grant):
    config, size = profile("quick"), ClipSize(80, 854, 480)
    fitting = within(grant, size, config, SPEED)
    found = cost(size, fitting, SPEED)
    assert found.minutes <= (grant.minutes or 1e9) * 1.001
    assert found.memory <= (grant.memory or 1e9) * 1.001
    used = max(found.minutes / (grant.minutes or 1e9), found.memory / (grant.memory or 1e9))
    assert used > 0.95
    ratio = max_gaussians(fitting) / max_gaussians(config)
    for name in ("spawn_static", "spawn_dynamic", "density_static", "density_dynamic"):
        assert getattr(fitting, name).max_count == pytest.approx(ratio * getattr(config, name).max_count, rel=1e-3)


def test_more_than_the_profile_takes_is_used_too():
    config = profile("quick")
    assert max_gaussians(within(Grant(minutes=60), SIZE, config, SPEED)) > 2 * max_gaussians(config)


def test_a_small_machine_takes_fewer_gaussians_or_refuses(monkeypatch):
    config, size = profile("wild"), ClipSize(80, 1920, 1080)
    monkeypatch.setattr(budget, "machine_memory", lambda: 4.6)
    fitting = within(Grant(), size, config, SPEED)
    assert max_gaussians(fitting) < max_gaussians(config)
    assert cost(size, fitting, SPEED).memory <= 2.301
    monkeypatch.setattr(budget, "machine_memory", lambda: 2.0)
    for grant in (Grant(), Grant(memory=500)):
        with pytest.raises(F4xError, match=r"on this machine, which has 2\.0 GB; grant more"):
            within(grant, size, config, SPEED)


def test_minutes_take_steps_of_long_clips_before_they_take_gaussians():
    quick, size = profile("quick"), dataclasses.replace(SIZE, frames=300)
    assert for_clip(None, size, quick, SPEED).steps == for_clip(1000, size, quick, SPEED).steps == 2400
    assert for_clip(0.1, size, quick, SPEED).steps == 800 and for_clip(0.1, SIZE, quick, SPEED) is quick
    whole = for_frames(quick, 300)
    least = cost(size, dataclasses.replace(whole, steps=800), SPEED).minutes
    some = for_clip(least + 0.5, size, quick, SPEED)
    assert 800 < some.steps < 2400 and least + 0.45 < cost(size, some, SPEED).minutes <= least + 0.5
    allowed = within(Grant(minutes=least + 0.5), size, some, SPEED)
    assert max_gaussians(allowed) >= 0.99 * expected_gaussians(size, whole)


def test_no_grant_changes_nothing():
    config = profile("wild")
    assert within(Grant(), SIZE, config, SPEED) is config


@pytest.mark.parametrize(
    ("grant", "short"),
    [(Grant(minutes=0.1), "--minutes"), (Grant(memory=0.3), "--memory"), (Grant(0.1, 0.3), "--minutes and --memory")],
)
def test_too_little_is_refused_with_what_is_needed(grant, short):
    with pytest.raises(F4xError, match=r"takes at least .* minutes and .* GB .*; grant more") as refused:
        within(grant, SIZE, profile("quick"), SPEED)
    assert f"grant more ({short})" in str(refused.value)
    minutes, memory = re.search(r"at least ([\d.]+) minutes and ([\d.]+) GB", str(refused.value)).groups()
    enough = Grant(grant.minutes and float(minutes), grant.memory and float(memory))
    assert within(enough, SIZE, profile("quick"), SPEED)  # what is said to be enough is


@pytest.mark.parametrize("size", [ClipSize(6, 64, 40), ClipSize(20, 160, 90), ClipSize(80, 480, 270, windows=5)])
@pytest.mark.parametrize("grant", [Grant(minutes=0.01), Grant(memory=0.1), Grant(0.01, 0.1)])
def test_what_is_said_to_be_enough_is_enough_for_small_clips_and_for_windows(size, grant):
    """A small clip asks for less than a tenth of the profile's Gaussians; minutes are those of all windows."""
    with pytest.raises(F4xError, match="grant more") as refused:
        within(grant, size, profile("wild"), SPEED)
    minutes, memory = map(float, re.search(r"at least ([\d.]+) minutes and ([\d.]+) GB", str(refused.value)).groups())
    enough = Grant(grant.minutes and minutes, grant.memory and memory)
    fitting = within(enough, size, profile("wild"), SPEED)
    found = cost(size, fitting, SPEED)
    assert found.minutes <= (enough.minutes or 1e9) and found.memory <= (enough.memory or 1e9)
    assert fitting.counts_from.startswith("--m")
    if size.windows > 1 and grant.minutes:
        with pytest.raises(F4xError, match="A fit of 5 windows of 80 frames"):
            within(Grant(minutes=0.7 * minutes), size, profile("wild"), SPEED)


def test_windows_cost_their_number_of_times_the_minutes_and_the_memory_of_one():
    config = dataclasses.replace(profile("quick"), tints=TintConfig(enabled=False))
    one, five = (cost(dataclasses.replace(SIZE, windows=windows), config, SPEED) for windows in (1, 5))
    assert (five.minutes, five.memory, five.file) == pytest.approx((5 * one.minutes, one.memory, 5 * one.file))


def test_what_the_numbers_come_from_is_kept(monkeypatch):
    config, size = profile("wild"), ClipSize(80, 1920, 1080)
    assert within(Grant(), SIZE, config, SPEED).counts_from == "settings"
    assert within(Grant(memory=5), size, config, SPEED).counts_from == "--memory 5"
    assert within(Grant(minutes=40, memory=30), size, config, SPEED).counts_from == "--minutes 40"
    monkeypatch.setattr(budget, "machine_memory", lambda: 4.6)
    assert within(Grant(), size, config, SPEED).counts_from == "half of this machine's 4.6 GB of memory"
    assert within(Grant(memory=500), size, config, SPEED).counts_from == "this machine's 4.6 GB of memory"


def test_more_threads_share_pixels_but_not_what_one_thread_does_alone():
    size, config = written_out()
    one, two, many = (cost(size, config, MachineSpeed(0.02, threads)).minutes for threads in (1, 2, 1000))
    shared = 0.4 * 5.9e-4 * 20 * 30_000 + 160 * 2.65e-5 * 120_000 * (0.2 / 4 + 0.8)
    assert two - many == pytest.approx(0.01 * shared / 60, rel=0.01) and one - two == pytest.approx(0.01 * shared / 60)
    few = max_gaussians(within(Grant(minutes=two), size, config, MachineSpeed(0.02, 2)))
    assert max_gaussians(within(Grant(minutes=two), size, config, MachineSpeed(0.02, 16))) > few


@pytest.mark.parametrize("grant", [Grant(minutes=30), Grant(memory=5)])
def test_what_was_set_by_hand_is_made_no_larger_by_a_grant(grant):
    config = profile("quick")
    config = dataclasses.replace(config, spawn_static=dataclasses.replace(config.spawn_static, max_count=100))
    fitting = within(grant, SIZE, config, SPEED)
    assert fitting.spawn_static.max_count == 100 and fitting.own_counts == ("spawn_static.max_count",)
    assert fitting.density_static.max_count > config.density_static.max_count
    size = ClipSize(80, 854, 480)
    less = Grant(minutes=0.9 * cost(size, config, SPEED).minutes)
    assert within(less, size, config, SPEED).own_counts == ()


def written_out(frames: int = 20, **changes):
    """A clip of 400 x 300 pixels and a profile with plain numbers, whose priors are made at 200 x 150."""
    config = profile("quick")
    settings = {
        "tints": TintConfig(enabled=False),
        "steps": 100,
        "closeups": 1,
        "coarse": 0.2,
        "priors": dataclasses.replace(config.priors, longer_side=200),
        "spawn_static": SpawnConfig(spacing=2.0, max_count=5_000),
        "spawn_dynamic": SpawnConfig(max_count=700),
        "density_static": DensityConfig(max_count=300_000, max_growth=1.5),
        "density_dynamic": DensityConfig(max_count=40_000),
    }
    return ClipSize(frames, 400, 300), dataclasses.replace(config, **settings | changes)


FIXED = 150 + 5.9e-4 * 20 * 30_000 + 3.8e-4 * 20 * 120_000 + 160 * (1 + 2.65e-5 * 120_000 * (0.2 / 4 + 0.8))
"""Raster steps of that fit without its Gaussians: priors, their pixels, all pixels, and steps, a fifth of them at half size,
with close-ups that cost .6 of them."""
TRAINING = 0.55e9 + 5 * 20 * 120_000 + 15 * 20 * 30_000 + 250 * 120_000
"""Bytes without its Gaussians: libraries, frames whole and of half size, priors, one picture."""


def test_a_cost_is_the_sum_of_what_steps_pixels_and_gaussians_cost():
    size, config = written_out()
    count = 1.5 * 6 * 120_000 / 2**2  # what the clip can ask for, not what there is room for
    found = cost(size, config, SLOW)
    assert found.minutes == pytest.approx(0.01 * (FIXED + 160 * 1.58e-5 * count) / 60)
    assert found.memory == pytest.approx((TRAINING + 1900 * count) / 1e9)
    assert found.file == pytest.approx(78 * count / 1e6)
    roomless = dataclasses.replace(config, density_static=DensityConfig(max_count=100_000, max_growth=1.5))
    assert cost(size, roomless, SLOW).file == pytest.approx(78 * 140_000 / 1e6)
    assert max_gaussians(roomless) == 140_000


def test_colors_over_time_cost_their_pixels_gaussians_and_bytes_of_every_frame():
    size, plain = written_out()
    count = 1.5 * 6 * 120_000 / 2**2
    tinted = dataclasses.replace(plain, tints=TintConfig(megabytes=10.0))
    one, other = (cost(size, config, SLOW) for config in (plain, tinted))
    work = 20 * (8e-5 * 120_000 + 1.3e-4 * count)
    assert other.minutes - one.minutes == pytest.approx(0.02 * work / SLOW.threads / 60)
    assert other.file - one.file == pytest.approx(10.0), "as much as is allowed"
    little = dataclasses.replace(plain, tints=TintConfig(megabytes=100.0))
    assert cost(size, little, SLOW).file - one.file == pytest.approx(3 * 20 * count / 1e6)


def test_large_pictures_cost_their_frames_and_priors_of_the_usual_size():
    """300 frames of 1280x720 once took 20 bytes for each of their pixels: maps of the pictures' size."""
    config, size = profile("quick"), ClipSize(300, 1280, 720)
    small, pixels = 300 * 480 * 270, 300 * 1280 * 720
    assert cost(size, config, SPEED).memory == pytest.approx((0.55e9 + 3 * pixels + 82 * small) / 1e9)


def test_many_frames_take_most_memory_while_priors_are_made():
    size, config = written_out(frames=2000)
    config = dataclasses.replace(config, priors=dataclasses.replace(config.priors, longer_side=400))
    assert cost(size, config, SLOW).memory == pytest.approx((0.55e9 + 85 * 2000 * 120_000) / 1e9)
    with pytest.raises(F4xError, match="grant more"):  # enough to train it
        within(Grant(memory=20), size, config, MachineSpeed(2e-6, 2))
    assert within(Grant(memory=20.96), size, config, MachineSpeed(2e-6, 2)).counts_from == "--memory 20.96"


def test_priors_are_made_from_pictures_no_larger_than_the_clip():
    assert ClipSize(3, 400, 310).shrunk(200) == ClipSize(3, 200, 155)
    assert ClipSize(3, 300, 401).shrunk(100) == ClipSize(3, 75, 100)
    assert ClipSize(3, 400, 300).shrunk(401) == ClipSize(3, 400, 300)


def test_room_is_what_the_grant_leaves_beside_everything_else():
    """Each of minutes and gigabytes for 170,000 Gaussians: half of what the profile has room for, set by set."""
    size, config = written_out()
    minutes, memory = 0.01 * (FIXED + 160 * 1.58e-5 * 170_000) / 60, (TRAINING + 1900 * 170_000) / 1e9
    for grant in (Grant(minutes=minutes), Grant(memory=memory), Grant(2 * minutes, memory), Grant(minutes, 2 * memory)):
        fitting = within(grant, size, config, SLOW)
        rooms = [getattr(fitting, name).max_count for name in ("density_static", "density_dynamic")]
        assert rooms == pytest.approx([150_000, 20_000], abs=1)
        rooms = [getattr(fitting, name).max_count for name in ("spawn_static", "spawn_dynamic")]
        assert rooms == pytest.approx([2_500, 350], abs=1)
    tiny = dataclasses.replace(config, spawn_dynamic=SpawnConfig(max_count=1))
    assert within(Grant(memory=memory), size, tiny, SLOW).spawn_dynamic.max_count == 1, "room for one at least"


@pytest.mark.parametrize(("room", "refused"), [(33_900, True), (34_100, False)])
def test_a_grant_with_room_for_less_than_a_tenth_is_refused(room, refused):
    size, config = written_out()
    grant = Grant(memory=(TRAINING + 1900 * room) / 1e9)
    if refused:
        with pytest.raises(F4xError, match="grant more"):
            within(grant, size, config, SLOW)
    else:
        assert max_gaussians(within(grant, size, config, SLOW)) == pytest.approx(room, abs=2)


@pytest.mark.parametrize(("room", "thinner"), [(269_000, True), (271_000, False)])
def test_half_of_the_machine_is_taken_and_a_profile_that_fits_into_it_stays(monkeypatch, room, thinner):
    """The clip asks for 270,000 Gaussians, the profile has room for 340,000."""
    size, config = written_out()
    monkeypatch.setattr(budget, "machine_memory", lambda: 2 * (TRAINING + 1900 * room) / 1e9)
    fitting = within(Grant(), size, config, SLOW)
    assert (max_gaussians(fitting) == pytest.approx(room, abs=2)) == thinner
    assert (fitting is config) != thinner


def test_the_machine_is_asked_for_its_memory(monkeypatch):
    pages = {"SC_PAGE_SIZE": 4096, "SC_PHYS_PAGES": 2_000_000}
    monkeypatch.setattr(os, "sysconf", pages.__getitem__, raising=False)
    assert machine_memory() == pytest.approx(8.192)
    monkeypatch.delattr(os, "sysconf")
    assert machine_memory() == float("inf")


def test_the_machine_is_timed():
    assert 0 < MachineSpeed.measured(1).raster_seconds < 60


def test_the_best_of_five_raster_steps_counts_and_its_threads_share_it(monkeypatch):
    times, torch_threads = [5.0, 4.0, 7.0, 3.0, 2.0, 0.1], []

    def step(threads):
        assert threads == 4
        torch_threads.append(torch.get_num_threads())
        return times[len(torch_threads) - 1]

    before = torch.get_num_threads()
    torch.set_num_threads(2)
    try:
        monkeypatch.setattr(budget, "_raster_step", step)
        assert MachineSpeed.measured(4) == MachineSpeed(2.0, 4)
        assert torch_threads == [1] * 5 and torch.get_num_threads() == 2
    finally:
        torch.set_num_threads(before)


def test_a_raster_step_draws_what_the_costs_were_measured_in(monkeypatch):
    """20,000 Gaussians all over 320 x 180 pixels: other ones would be another unit."""
    drawn, real, clock = [], raster.rasterize, iter([3.0, 5.5])
    monkeypatch.setattr(time, "process_time", lambda: next(clock))
    monkeypatch.setattr(raster, "rasterize", lambda *scene, **how: drawn.append((scene, how)) or real(*scene, **how))
    assert budget._raster_step(1) == 2.5
    (((splats, colors, camera), how),) = drawn
    assert how["config"].threads == 1 and (camera.width, camera.height) == (320, 180)
    np.testing.assert_array_equal(camera.intrinsics, [[200, 0, 160], [0, 200, 90], [0, 0, 1]])
    np.testing.assert_array_equal(camera.world_to_camera, np.eye(4))
    means = splats.means.detach().numpy()
    assert means.shape == (20_000, 3) and splats.means.grad.any()
    np.testing.assert_allclose(means.min(0), [-1.6, -0.9, 1.5], atol=2e-3)
    np.testing.assert_allclose(means.max(0), [1.6, 0.9, 2.5], atol=2e-3)
    assert (splats.scales == 0.012).all() and (splats.opacities == 0.6).all()
    np.testing.assert_allclose(splats.quats.norm(dim=1), 1, rtol=1e-5)
    assert splats.scales.shape == (20_000, 3) and splats.opacities.shape == (20_000,)
    assert colors.shape == (20_000, 3) and colors.min() >= 0 and colors.max() <= 1
