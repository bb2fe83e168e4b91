"""Appearance for renderers without a footprint in linear light: rays, what is stored, the refit, exports."""

import dataclasses

import numpy as np
import pytest
import torch
from labelled_scene import labelled_scene

from f4x_core.cli import main
from f4x_core.edit.apply import edited
from f4x_core.edit.bake import bake
from f4x_core.edit.operations import Duplicate, Recolour
from f4x_core.edit.selects import Moving
from f4x_core.edit.stack import EditStack, with_stack
from f4x_core.errors import F4xError
from f4x_core.fit import linear_light
from f4x_core.fit.linear_config import LinearConfig
from f4x_core.geometry.camera import Camera
from f4x_core.geometry.splats import Splats
from f4x_core.raster import RasterConfig, rasterize
from f4x_core.raster.rays import CYCLES_FILTER, RayConfig, filter_weights, filtered_rays, project, rasterize_rays
from f4x_core.scene import read_scene, write_scene
from f4x_core.scene.foreign import open_any
from f4x_core.scene.formats import export
from f4x_core.scene.linear import (
    NAMES,
    Fitted,
    Look,
    fitted_look,
    footprint,
    is_refitted,
    linear_look,
    linear_scene,
    narrowed,
    widened,
    with_look,
)
from f4x_core.scene.tints import tinted, with_tints

CAMERA = Camera(np.array([[60.0, 0, 30], [0, 60, 20], [0, 0, 1]]), np.eye(4), 60, 40)


def cloud(count=80, seed=0, thin=1.0, near=1.0):
    """Gaussians in front of `CAMERA`, tensors, and their colours."""
    rng = np.random.default_rng(seed)
    z = rng.uniform(near, 3 * near, count)
    means = np.stack([rng.uniform(-0.5, 0.5, count) * z, rng.uniform(-0.3, 0.3, count) * z, z], 1)
    scales = np.exp(rng.uniform(np.log(0.01), np.log(0.2), (count, 3))) * near
    scales[:, 1:] *= thin
    arrays = means, rng.normal(size=(count, 4)), scales, rng.uniform(0.05, 1, count)
    splats = Splats(*(torch.from_numpy(array.astype(np.float32)) for array in arrays))
    return splats, torch.from_numpy(rng.uniform(0, 1, (count, 3)).astype(np.float32))


def reference_rays(splats, colors, camera, config):
    """Composite along rays in float64, plainly: (H,W,4). Slow: every Gaussian meets every ray. Differentiable by autograd."""
    seen = project(splats.map(torch.Tensor.double), camera, config)
    k, colors = torch.as_tensor(camera.intrinsics), torch.cat((colors.double(), torch.ones(len(colors), 1)), 1)
    origin = -torch.einsum("nij,nj->ni", seen.whiten, seen.means)
    rows = []
    for y in range(camera.height):
        x = (torch.arange(camera.width, dtype=torch.float64) + 0.5 - k[0, 2]) / k[0, 0]
        rays = torch.stack((x, torch.full_like(x, float((y + 0.5 - k[1, 2]) / k[1, 1])), torch.ones_like(x)), 1)
        along = torch.einsum("nij,wj->wni", seen.whiten, rays)
        square = (along**2).sum(-1)
        depth = -torch.einsum("wni,ni->wn", along, origin) / square
        off = torch.linalg.cross(origin.expand_as(along), along)
        alpha = (seen.opacities * torch.exp(-0.5 * (off**2).sum(-1) / square)).clamp_max(0.9999)
        away = torch.linalg.cross(seen.means.expand(len(x), -1, -1), rays[:, None].expand(-1, len(colors), -1)).norm(
            dim=-1
        )
        inside = away <= seen.radii * rays.norm(dim=1)[:, None]
        alpha = torch.where(inside & (depth > config.near) & (seen.means[:, 2] > config.near), alpha, 0.0)
        alpha = torch.where(alpha >= config.alpha_min, alpha, 0.0)
        order = depth.argsort(dim=1, stable=True)
        alpha = alpha.gather(1, order)
        left = torch.cumprod(1 - alpha, 1)
        left = torch.cat((torch.ones_like(x)[:, None], left[:, :-1]), 1)
        rows.append(torch.einsum("wn,wnc->wc", alpha * left, colors[order]))
    return torch.stack(rows)


CLOUDS = {"plain": {}, "needles": {"thin": 0.01}, "near": {"near": 0.03}, "many": {"count": 400, "seed": 1}}


@pytest.mark.parametrize("case", CLOUDS)
def test_compiled_rays_are_the_reference_with_its_gradients(case):
    splats, colors = cloud(**CLOUDS[case])
    sent = torch.from_numpy(np.random.default_rng(2).normal(size=(40, 60, 4)).astype(np.float32))
    found = []
    for draw in (rasterize_rays, reference_rays):
        leaves = [a.clone().requires_grad_() for a in (splats.quats, splats.scales, splats.opacities, colors)]
        image = draw(Splats(splats.means, *leaves[:3]), leaves[3], CAMERA, RayConfig(alpha_min=1 / 64))
        (image * sent).sum().backward()
        found.append([image.detach(), *(leaf.grad for leaf in leaves)])
    for ours, plain in zip(*found, strict=True):
        assert (ours - plain).norm() < 2e-4 * plain.norm()


def test_reference_rays_have_the_derivatives_that_differences_give():
    splats, colors = cloud(6)

    def drawn(scales, opacities):
        return reference_rays(Splats(splats.means, splats.quats, scales, opacities), colors, CAMERA, RayConfig())

    tensors = (splats.scales.double().requires_grad_(), splats.opacities.double().mul(0.9).requires_grad_())
    direction = torch.from_numpy(np.random.default_rng(3).normal(size=(40, 60, 4)))
    (drawn(*tensors) * direction).sum().backward()
    for index, leaf in enumerate(tensors):
        step = torch.zeros_like(leaf).flatten()
        step[4] = 1e-6
        both = [
            [each.detach() + (sign * step.view_as(each) if each is leaf else 0) for each in tensors] for sign in (1, -1)
        ]
        up, down = ((drawn(*each) * direction).sum() for each in both)
        assert float((up - down) / 2e-6) == pytest.approx(float(leaf.grad.flatten()[4]), rel=2e-3, abs=1e-3), index


def test_rays_have_the_same_bits_for_every_number_of_threads():
    splats, colors = cloud(**CLOUDS["many"])
    images = [rasterize_rays(splats, colors, CAMERA, RayConfig(threads=count)) for count in (1, 2, 5)]
    assert all(torch.equal(image, images[0]) for image in images[1:])


def test_two_crossing_gaussians_are_sorted_by_ray_and_not_by_center():
    """The long one's center lies behind the other's, but on the left it passes before it."""
    means = torch.tensor([[0.0, 0, 1.0], [0.0, 0, 1.02]])
    turn = np.pi / 8  # about y: the left end comes nearer
    quats = torch.tensor([[1.0, 0, 0, 0], [np.cos(turn), 0, np.sin(turn), 0]], dtype=torch.float32)
    scales = torch.tensor([[0.3, 0.3, 0.002], [0.3, 0.3, 0.002]])
    splats = Splats(means, quats, scales, torch.tensor([0.95, 0.95]))
    image = rasterize_rays(splats, torch.eye(3)[:2], CAMERA)
    left, right = image[20, 22], image[20, 38]
    ends = (left[1] > left[0], right[0] > right[1]) if left[1] > left[0] else (left[0] > left[1], right[1] > right[0])
    assert all(ends)  # another one is in front on either side


def test_filter_is_cycles_own():
    for oversample in (2, 3, 8):
        weights = filter_weights(oversample)
        place = (torch.arange(len(weights)) + 0.5) / oversample - 1.5
        assert float((weights * place**2).sum()) == pytest.approx(CYCLES_FILTER, abs=1e-3)
    splats, colors = cloud(40)
    wide = dataclasses.replace(splats, scales=splats.scales + 0.05)  # nothing is small within a pixel
    once, often = (filtered_rays(wide, colors, CAMERA, count) for count in (1, 3))
    assert float((once - often).abs().mean()) < 2e-3


def test_footprint_is_what_the_rasterizer_adds():
    """Drawn without a footprint, widened scales give the picture that fitted ones give with it."""
    scene = labelled_scene()
    width = footprint(scene)
    np.testing.assert_allclose(width, np.sqrt(0.3) * scene.posed(0).means[:, 2] / 60, rtol=1e-4)
    posed, camera = scene.posed(0), scene.cameras.at(0)
    colors = scene.colors(posed, camera).astype(np.float32)
    fitted = rasterize(posed, colors, camera).channels
    wide = dataclasses.replace(posed, scales=widened(posed.scales, width))
    plain = rasterize(wide, colors, camera, config=RasterConfig(blur=0.0)).channels
    assert -10 * np.log10(((fitted - plain) ** 2).mean()) > 45
    np.testing.assert_allclose(narrowed(widened(posed.scales, width), width), posed.scales, rtol=2e-3)


def refitted(scene, seed=0):
    """The scene with an appearance for linear light that differs from the fitted one everywhere."""
    rng, look = np.random.default_rng(seed), fitted_look(scene)
    changed = (rng.uniform(0.5, 2, a.shape).astype(np.float32) * a for a in (look.scales, look.opacities, look.dc))
    scales, opacities, dc = changed
    return with_look(scene, Look(scales, opacities.clip(0, 0.99), dc))


def test_a_look_is_stored_beside_the_arrays_and_comes_back(tmp_path):
    scene = refitted(labelled_scene())
    write_scene(scene, tmp_path / "s.f4x")
    again = read_scene(tmp_path / "s.f4x")
    assert is_refitted(again) and not is_refitted(with_look(again, None)) and not is_refitted(labelled_scene())
    for one, other in (
        (fitted_look, fitted_look),
        (linear_look, linear_look),
        (linear_look, lambda s: fitted_look(linear_scene(s))),
    ):
        for a, b in zip(dataclasses.astuple(one(scene)), dataclasses.astuple(other(again)), strict=True):
            np.testing.assert_array_equal(a, b)
    np.testing.assert_array_equal(fitted_look(again).scales, fitted_look(labelled_scene()).scales)


def test_the_fitted_look_follows_from_the_linear_one_faded_and_recolored():
    scene = refitted(labelled_scene())
    fitted, linear = fitted_look(scene), linear_look(scene)
    step = Fitted.of(fitted, linear)
    back = step.from_linear(linear)
    np.testing.assert_allclose(back.scales, fitted.scales, rtol=1e-6)
    np.testing.assert_allclose(back.dc, fitted.dc, atol=1e-6)
    np.testing.assert_allclose(back.opacities, fitted.opacities, atol=2e-6)
    half = dataclasses.replace(linear, opacities=1 - np.sqrt(1 - linear.opacities), dc=linear.dc + 0.1)
    np.testing.assert_allclose(step.from_linear(half).opacities, 1 - np.sqrt(1 - fitted.opacities), atol=2e-5)
    np.testing.assert_allclose(step.from_linear(half).dc, fitted.dc + 0.1, atol=1e-6)
    hidden = dataclasses.replace(linear, opacities=np.zeros_like(linear.opacities))
    assert not step.from_linear(hidden).opacities.any()


def test_baking_bakes_the_linear_look_too():
    scene = refitted(labelled_scene())
    edits = (Recolour(Moving(), (0.0, 1.0, 0.0)), Duplicate(Moving(), (0.3, 0.0, 0.0), first_id=scene.next_id))
    stack = EditStack()
    for operation in edits:
        stack = stack.append(operation)
    baked = bake(with_stack(scene, stack))
    assert is_refitted(baked) and len(baked.ids) == len(scene.ids) + len(scene.dynamic)
    wanted = edited(with_stack(linear_scene(scene), stack)).posed(2.0)
    found = linear_scene(baked).posed(2.0)
    rows = (
        np.searchsorted(found.ids, wanted.ids)
        if (np.diff(found.ids) > 0).all()
        else [list(found.ids).index(i) for i in wanted.ids]
    )
    for name in ("scales", "opacities", "means"):
        np.testing.assert_allclose(getattr(found, name)[rows], getattr(wanted, name), atol=1e-4)
    np.testing.assert_allclose(found.sh[rows, 0], wanted.sh[:, 0], atol=1e-4)


def test_colors_over_time_are_in_both_pictures():
    """Tints that are the same at all times are a color: the pictures agree as far as those of a scene with that color."""
    scene = labelled_scene()
    tints = with_tints(scene, np.array([0.0, 5.0]), np.full((len(scene.ids), 2, 3), 51, np.int8))
    parts = {
        name: dataclasses.replace(part, sh=tinted(part.sh, np.full((len(part), 3), 0.2, np.float32)))
        for name, part in (("static", scene.static), ("dynamic", scene.dynamic))
    }
    found, expected = (linear_light.agreement(each, 2) for each in (tints, dataclasses.replace(scene, **parts)))
    assert found == pytest.approx(expected, abs=1e-3)


QUICK = LinearConfig(steps=12, save_every=5, part=0.7)


def test_a_refit_nears_the_scenes_own_pictures_and_changes_nothing_else():
    scene = labelled_scene()
    again = linear_light.refit(scene, LinearConfig(steps=40))
    before, after = (np.mean(linear_light.agreement(each)) for each in (scene, again))
    assert after > before + 1.5
    assert (
        again.static is scene.static
        and again.dynamic is scene.dynamic
        and set(again.extra) - set(scene.extra)
        == {f"{part}/{name}" for part in ("static", "dynamic") for name in NAMES}
    )


def test_a_refit_goes_on_to_the_same_bits_on_any_number_of_threads(tmp_path):
    scene, path = labelled_scene(), tmp_path / "kept"
    whole = linear_light.refit(scene, QUICK)

    class StopError(Exception):
        """The person who stops it."""

    def stop(stage, done, total, message=""):
        if done == 8:
            raise StopError

    with pytest.raises(StopError):
        linear_light.refit(scene, QUICK, path, progress=stop)
    assert path.is_file()
    other = dataclasses.replace(QUICK, threads=3)
    again = linear_light.refit(scene, other, path, resume=True)
    assert not path.exists()
    for name, array in whole.extra.items():
        np.testing.assert_array_equal(array, again.extra[name], err_msg=name)
    with pytest.raises(StopError):
        linear_light.refit(scene, QUICK, path, progress=stop)
    with pytest.raises(F4xError, match="other settings"):
        linear_light.refit(scene, dataclasses.replace(QUICK, seed=1), path, resume=True)


def test_the_verb_refits_in_place_and_keeps_edits(tmp_path, capsys):
    path = tmp_path / "s.f4x"
    write_scene(labelled_scene(), path)
    assert main(["edit", str(path), "--say", "make what moves red"]) == 0
    assert main(["refit", str(path), "--steps", "3"]) == 0
    assert "refitted for linear light" in capsys.readouterr().out
    scene = read_scene(path)
    assert is_refitted(scene) and len(scene.edits) == 1 and not list(tmp_path.glob("*refit*"))
    assert main(["refit", str(path), "--steps", "0"]) == 2
    assert "give a number above 0" in capsys.readouterr().err


def test_splats_from_elsewhere_are_refused(tmp_path):
    imported = dataclasses.replace(labelled_scene(), provenance={"import": {}})
    assert not footprint(imported).any()
    with pytest.raises(F4xError, match="imported as splats"):
        linear_light.refit(imported)


def test_gltf_has_the_footprint_and_gives_the_fitted_scales_back(tmp_path):
    scene = labelled_scene()
    export(scene, tmp_path / "s.glb", [0.0], "gltf")
    back = open_any(tmp_path / "s.glb").posed(0.0)
    posed = scene.posed(0.0)
    np.testing.assert_allclose(np.sort(back.scales.ravel()), np.sort(posed.scales.ravel()), rtol=5e-3, atol=1e-6)


def test_usd_has_the_footprint_in_its_scales(tmp_path):
    scene = labelled_scene()
    export(scene, tmp_path / "s.usda", [0.0], "usd")
    text = (tmp_path / "s.usda").read_text()
    line = next(line for line in text.splitlines() if "float3[] scales" in line)
    written = np.array(
        [
            float(word)
            for word in line.split("[", 2)[2].strip("]").replace("(", " ").replace(")", " ").replace(",", " ").split()
        ]
    )
    width = np.sqrt(0.3) * 0.9 / 60
    assert written.min() == pytest.approx(np.hypot(0.002, width), rel=0.01)
