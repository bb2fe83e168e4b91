"""The fit on a made-up clip with exact truth: it converges, resumes bit-equal and models only what moves."""

import dataclasses
from pathlib import Path

import numpy as np
import pytest
import torch
from toy import clip_and_priors

from f4x_core.errors import F4xError
from f4x_core.fit import pipeline, trainer
from f4x_core.fit.checkpoint import load_checkpoint, save_checkpoint
from f4x_core.fit.config import PROFILES, NodeConfig, profile, resolved
from f4x_core.fit.losses import depth_loss, masked_l1
from f4x_core.fit.settings import set_fields
from f4x_core.metrics.believed import believed_degrees, depth_evidence
from f4x_core.metrics.pictures import psnr, ssim_map

pytestmark = pytest.mark.usefixtures("one_thread")


def small(steps: int, geometry_steps: int = 15, **changes):
    quick = profile("quick")
    scaffold = dataclasses.replace(quick.scaffold, geometry_steps=geometry_steps, following_steps=geometry_steps)
    return dataclasses.replace(
        quick, steps=steps, measure_every=20, checkpoint_every=20, threads=1, scaffold=scaffold, **changes
    )


@pytest.fixture
def fit(monkeypatch):
    """Fit a toy clip whose priors are the truth."""

    def run(folder: Path, config, resume=False, progress=pipeline.silent, **toy):
        clip, priors = clip_and_priors(**toy)
        monkeypatch.setattr(pipeline, "build_priors", lambda *_: priors)
        return pipeline.fit_clip(clip, folder, config, progress, resume)

    return run


def test_moving_toy_gets_few_nodes_and_a_good_picture(fit, tmp_path):
    result = fit(tmp_path, small(160, geometry_steps=150), hold_out=4)
    assert result.history[-1]["psnr"] > 26
    scene = result.scene
    assert scene.scaffold is not None and len(scene.scaffold) <= 8, "one rigid mover needs few nodes"
    assert len(scene.dynamic) > 50
    assert len(scene.cameras) == 8
    assert (scene.provenance["source"], scene.provenance["frames"], scene.provenance["width"]) == ("toy", "", 64)
    believed = believed_degrees(depth_evidence(result.priors))
    assert scene.provenance["believed_degrees"] == round(min(believed.static, believed.moving), 1)
    ids = np.concatenate([scene.static.ids, scene.dynamic.ids])
    assert len(np.unique(ids)) == len(ids) and ids.max() < scene.next_id


def test_what_a_whole_clip_hides_is_made_up_after_its_fit(fit, tmp_path, monkeypatch):
    given = []

    def completed(scene):
        given.append(scene)
        return dataclasses.replace(scene, name="completed")

    monkeypatch.setattr(pipeline, "completed", completed)
    result = fit(tmp_path, small(20))
    assert result.scene.name == "completed" and len(given) == 1 and "believed_degrees" in result.scene.provenance
    np.testing.assert_array_equal(result.scene.static.means, given[0].static.means)


def test_small_pictures_are_followed_to_less_than_a_pixel():
    scaffold = profile("quick").scaffold
    assert scaffold.tolerance_at(480) == scaffold.tolerance_at(1920) == scaffold.tolerance
    assert scaffold.tolerance_at(96) == pytest.approx(0.48)


def test_static_clip_gets_no_scaffold(fit, tmp_path):
    scene = fit(tmp_path, small(20), moving=False).scene
    assert len(scene.dynamic) == 0 and scene.scaffold is None
    assert any(need["what"] == "motion" and need["chosen"].startswith("none") for need in scene.needs)


class Stop(KeyboardInterrupt):
    pass


@pytest.mark.parametrize("stop_at", [20, pytest.param(47, marks=pytest.mark.slow)])
def test_resume_is_bit_equal(fit, tmp_path, monkeypatch, stop_at):
    """Oracle 11, across densification, node control, new harmonics, a graph rebuild and the start of the skinning offsets."""
    monkeypatch.setattr(trainer, "GAIN_DB", -100.0)
    config = small(60, graph_every=15, dw_from=0.6, max_sh_degree=2, harmonics_at=(0.3, 0.65))
    density = dataclasses.replace(config.density_static, every=10, start=0.0, gradient=1e-6, max_count=1000)
    nodes = NodeConfig(add_at=(0.25, 0.5), drop_at=(0.55,), growth=1.0)
    config = dataclasses.replace(config, density_static=density, nodes=nodes)
    whole = fit(tmp_path / "whole", config).scene

    def interrupt(stage, done, total, message=""):
        if stage == "photometric" and done == stop_at:
            raise Stop

    with pytest.raises(KeyboardInterrupt):
        fit(tmp_path / "cut", config, progress=interrupt)
    resumed = fit(tmp_path / "cut", config, resume=True).scene
    assert resumed.next_id == whole.next_id > 0
    assert len(whole.scaffold) > 4, "nodes were added"
    assert whole.static.sh.shape[1] == whole.dynamic.sh.shape[1] == 9, "harmonics were added"
    for part in ("static", "dynamic"):
        for name, array in getattr(whole, part).arrays().items():
            assert np.array_equal(array, getattr(getattr(resumed, part), name)), (part, name)
    assert np.array_equal(whole.scaffold.xyz, resumed.scaffold.xyz)
    assert np.array_equal(whole.cameras.world_to_camera, resumed.cameras.world_to_camera)


@pytest.mark.parametrize(("setting", "allowed"), [("spawn_static", 100), ("density_static", 80)])
def test_a_tight_cap_is_named_by_scene_and_result_after_a_resumed_fit_too(fit, tmp_path, setting, allowed):
    growing = ["density_static.every=10", "density_static.gradient=0", "density_static.max_growth=2"]
    config = set_fields(small(60), [f"{setting}.max_count=100", *growing])

    def interrupt(stage, done, total, message=""):
        if stage == "photometric" and done == 55:  # after the last growth
            raise Stop

    with pytest.raises(KeyboardInterrupt):
        fit(tmp_path, config, progress=interrupt)
    result = fit(tmp_path, config, resume=True)
    (short,) = result.shortages
    assert (short.kind, short.limited_by, short.room.allowed) == ("static", f"{setting}.max_count", allowed)
    assert short.room.asked > 150 and (short.lacking > 0) == (setting == "density_static")
    (row,) = (need for need in result.scene.needs if need["what"] == "Gaussians")
    assert str(short) in row["chosen"] and f"asked for {short.room.asked} static and" in row["evidence"]


def test_a_fit_with_room_for_all_names_no_cap(fit, tmp_path):
    assert fit(tmp_path, small(20)).shortages == ()


def test_checkpoint_of_other_settings_is_refused(fit, tmp_path, monkeypatch):
    fit(tmp_path, small(20))
    with pytest.raises(F4xError, match="other settings"):
        fit(tmp_path, small(20, seed=1), resume=True)
    clip, _ = clip_and_priors(7)
    monkeypatch.setattr(pipeline, "build_priors", None)
    with pytest.raises(F4xError, match="another clip"):  # before the priors are made
        pipeline.fit_clip(clip, tmp_path, small(20), resume=True)


def test_damaged_checkpoint_is_one_sentence(tmp_path):
    path = tmp_path / "c.pt"
    save_checkpoint(path, {"config_hash": "a", "x": torch.arange(100)})
    assert torch.equal(load_checkpoint(path, "a")["x"], torch.arange(100))
    path.write_bytes(path.read_bytes()[:-300])
    with pytest.raises(F4xError, match="damaged"):
        load_checkpoint(path, "a")
    assert load_checkpoint(tmp_path / "none.pt", "a") is None


@pytest.mark.parametrize("frames", [1, 2])
def test_too_few_frames(fit, tmp_path, frames):
    with pytest.raises(F4xError, match="too few"):
        fit(tmp_path, small(10), frames=frames)


def test_profiles_resolve_to_json_and_unknown_ones_are_refused():
    import json

    for name in PROFILES:
        assert json.loads(json.dumps(resolved(profile(name))))["name"] == name
    with pytest.raises(F4xError, match="no profile 'fast'"):
        profile("fast")


def test_losses_are_zero_on_empty_masks():
    picture = torch.rand(6, 7, 3, requires_grad=True)
    loss = masked_l1(picture, torch.rand(6, 7, 3), torch.zeros(6, 7))
    loss = loss + depth_loss(picture[..., 0], picture[..., 1], torch.full((6, 7), torch.nan), torch.ones(6, 7))
    loss.backward()
    assert loss.item() == 0 and torch.isfinite(picture.grad).all()
    assert np.isnan(psnr(torch.rand(6, 7, 3), torch.rand(6, 7, 3), torch.zeros(6, 7)))


def test_ssim_against_its_definition():
    """One interior pixel, windows weighted by hand in float64."""
    rng = np.random.default_rng(0)
    x, y = rng.uniform(size=(2, 15, 15, 1))
    offsets = np.arange(11) - 5
    kernel = np.exp(-(offsets**2) / (2 * 1.5**2))
    window = np.outer(kernel, kernel) / kernel.sum() ** 2
    a, b = x[2:13, 2:13, 0], y[2:13, 2:13, 0]
    mean_a, mean_b = (window * a).sum(), (window * b).sum()
    var_a, var_b = (window * (a - mean_a) ** 2).sum(), (window * (b - mean_b) ** 2).sum()
    both = (window * (a - mean_a) * (b - mean_b)).sum()
    c1, c2 = 0.01**2, 0.03**2
    expected = (2 * mean_a * mean_b + c1) * (2 * both + c2) / ((mean_a**2 + mean_b**2 + c1) * (var_a + var_b + c2))
    assert ssim_map(torch.from_numpy(x), torch.from_numpy(y))[0, 7, 7].item() == pytest.approx(expected, rel=1e-9)
    assert ssim_map(torch.from_numpy(x), torch.from_numpy(x)).mean().item() == pytest.approx(1)


def test_ssim_gradient():
    x = torch.rand(13, 12, 1, dtype=torch.float64, requires_grad=True)
    y = torch.rand(13, 12, 1, dtype=torch.float64)
    assert torch.autograd.gradcheck(lambda a: ssim_map(a, y).mean(), (x,))
