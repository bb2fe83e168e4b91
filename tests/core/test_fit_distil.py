"""Distillation piece by piece against loops over cells, columns and steps, on a scene of a few Gaussians."""

import copy
import dataclasses
import math
from pathlib import Path

import numpy as np
import pytest
import torch
from random_scene import FRAMES, HEIGHT, WIDTH, random_scene

from f4x_core.errors import F4xError
from f4x_core.features.heads import Head
from f4x_core.features.maps import FeatureMaps
from f4x_core.features.pca import fit_pca
from f4x_core.features.spec import FeatureSpec
from f4x_core.fit import distil as module
from f4x_core.fit.distil import HeadTask, KeptHead, _Distillation, _Mix, common_grid, dissimilarity, distil, to_grid
from f4x_core.fit.distil_config import DistilConfig
from f4x_core.progress import silent
from f4x_core.raster import RasterConfig, rasterize
from f4x_core.scene import FieldHead

pytestmark = pytest.mark.usefixtures("one_thread")

CONFIG = DistilConfig(width=4, steps=7, threads=1, backend="torch", frames_per_step=2)
USED = [0, 1, 3, 4, 5]
"""Frame 2 of the scene is held out."""


def maps_of(name="x", dim=6, grid=(5, 4), frames=FRAMES, **spec):
    rng = np.random.default_rng(len(name))
    stored = rng.normal(0.3, 1.5, (frames, *grid, dim)).astype(np.float16)
    return FeatureMaps(Path(name), FeatureSpec(name, dim, grid, **spec), stored)


def stage_of(scene, *maps, **changes) -> _Distillation:
    return _Distillation(scene, maps or (maps_of(),), dataclasses.replace(CONFIG, **changes), silent)


@pytest.fixture(scope="module")
def scene():
    return random_scene(static=12, dynamic=8, degree=0)


@pytest.fixture(scope="module")
def learnt(scene):
    """The scene with a head `old`."""
    return distil(scene, [maps_of("old", 5, (5, 4))], CONFIG)


# ---- grids -------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("grids", "expected"),
    [
        ([(10, 16)], (10, 16)),
        ([(10, 16), (5, 4)], (10, 16)),
        ([(5, 16), (10, 4)], (10, 16)),
        ([(10, 16), (4, 16)], (20, 32)),
        ([(10, 16), (10, 6)], (20, 32)),
        ([(30, 16), (7, 16)], (HEIGHT, 32)),
        ([(10, 40), (10, 7)], (20, WIDTH)),
    ],
)
def test_the_common_grid_is_the_finest_or_twice_as_fine_where_cells_would_be_cut(scene, grids, expected):
    assert common_grid([FeatureSpec("x", 3, grid) for grid in grids], scene) == expected


def test_shrinking_by_area_is_the_mean_of_what_covers_the_cell():
    rng = torch.Generator().manual_seed(0)
    latent, alpha = torch.rand(7, 9, 3, generator=rng), torch.rand(7, 9, generator=rng)
    alpha[:4, :5] = 0
    found, covered = to_grid(latent, alpha, FeatureSpec("x", 3, (3, 2), "area"))
    for r, rows in enumerate((range(3), range(2, 5), range(4, 7))):
        for c, columns in enumerate((range(5), range(4, 9))):
            cells = [(i, j) for i in rows for j in columns]
            weights = [float(alpha[i, j]) for i, j in cells]
            assert float(covered[r, c]) == pytest.approx(sum(weights) / len(cells), abs=1e-6)
            for k in range(3):
                total = sum(w * float(latent[i, j, k]) for w, (i, j) in zip(weights, cells, strict=True))
                assert float(found[r, c, k]) == pytest.approx(total / max(sum(weights), 1e-6), abs=1e-5)
    same = to_grid(latent, alpha, FeatureSpec("x", 3, (7, 9), "area"))
    assert same[0] is latent and same[1] is alpha


@pytest.mark.parametrize("length", [8, 3, 10])
def test_bilinear_is_a_triangle_as_wide_as_the_wider_cells(length):
    rng = np.random.default_rng(0)
    latent, alpha = rng.random((5, 2, 2)), rng.uniform(0.1, 1, (5, 2))
    spec = FeatureSpec("x", 2, (length, 2), "bilinear")
    found, covered = to_grid(torch.from_numpy(latent), torch.from_numpy(alpha), spec)
    scale = 5 / length
    for row in range(length):
        middle, reach = (row + 0.5) * scale, max(scale, 1)
        weight = np.array([max(0, 1 - abs(i + 0.5 - middle) / reach) for i in range(5)])
        for column in range(2):
            share = weight / weight.sum() * alpha[:, column]
            assert float(covered[row, column]) == pytest.approx(share.sum())
            np.testing.assert_allclose(found[row, column], share @ latent[:, column] / share.sum(), rtol=1e-6)


def test_the_smallest_cover_is_divided_out():
    latent, alpha = torch.full((4, 4, 1), 3.0), torch.full((4, 4), 1e-3)
    found, _ = to_grid(latent, alpha, FeatureSpec("x", 1, (2, 2), "area"))
    np.testing.assert_allclose(found, 3, rtol=1e-5)


# ---- losses ------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("rows", "window"), [(5, 2), (119, 2), (120, 3)])
def test_dissimilarity_is_one_minus_the_mean_ssim_in_small_windows(rows, window):
    rng = np.random.default_rng(0)
    x, y = rng.random((2, rows, 6, 2))
    seen, span = rng.random((rows, 6)) < 0.7, 0.5
    found = float(dissimilarity(*(torch.from_numpy(a) for a in (x, y, seen)), span))
    c1, c2, like = (0.01 * span) ** 2, (0.03 * span) ** 2, []
    for k in range(2):
        for r in range(rows - window + 1):
            for c in range(6 - window + 1):
                part = slice(r, r + window), slice(c, c + window)
                a, b = ((image[..., k] * seen)[part] for image in (x, y))
                both = (2 * a.mean() * b.mean() + c1) * (2 * ((a * b).mean() - a.mean() * b.mean()) + c2)
                like.append(both / ((a.mean() ** 2 + b.mean() ** 2 + c1) * (a.var() + b.var() + c2)))
    assert found == pytest.approx(1 - np.mean(like), rel=1e-6)


def task_of(maps, frames=(0, 1), **changes) -> HeadTask:
    torch.manual_seed(0)
    return HeadTask(maps, frames, 4, dataclasses.replace(CONFIG, **changes))


@pytest.mark.parametrize(("most", "every"), [(100_000, 7), (300, 7), (200, 10), (20, 100)])
def test_a_head_starts_out_with_the_mean_and_spread_of_its_maps(monkeypatch, most, every):
    monkeypatch.setattr(module, "HEAD_SAMPLES", most)
    maps = maps_of(grid=(40, 25), frames=3)
    stored = maps.stored.astype(np.float64) * [0.1, 0.2, 0.3, 0.4, 0.5, 0.6]
    maps = dataclasses.replace(maps, stored=stored.astype(np.float16))
    task = task_of(maps, (0, 2))
    sample = np.concatenate([maps.stored[t].reshape(-1, 6)[::every] for t in (0, 2)]).astype(np.float64)
    np.testing.assert_allclose(task.mean, sample.mean(0), atol=1e-5)
    assert task.spread == pytest.approx(np.mean([sample[:, k].std() for k in range(6)]), rel=1e-4)
    assert task.size == pytest.approx(np.abs(sample).mean(), rel=1e-4)
    ends = np.percentile(sample, [1, 99])
    assert task.range == pytest.approx(ends[1] - ends[0], rel=1e-4)
    latent = torch.rand(5, 4)
    with torch.no_grad():
        expected = task.mean + task.spread * task.head(latent)
        torch.testing.assert_close(task.decode(latent), expected)
        torch.testing.assert_close(task.folded()(latent), expected, rtol=1e-4, atol=1e-5)


def test_maps_without_any_spread_do_no_harm():
    task = task_of(dataclasses.replace(maps_of(), stored=np.zeros((FRAMES, 5, 4, 6), np.float16)))
    assert task.spread == task.size == task.range == pytest.approx(1e-9, rel=1e-6)


@pytest.mark.parametrize("weight", [1.0, 2.5])
@pytest.mark.parametrize("covered", [0, 1, 12])
@pytest.mark.parametrize(("ssim", "cosine"), [(0.0, 0.0), (0.4, 0.0), (0.0, 0.7), (0.4, 0.7)])
def test_a_heads_loss_is_relative_l1_and_dissimilarity_and_angle_over_covered_cells(weight, covered, ssim, cosine):
    named = {} if weight == 1 else {"head_weights": {"x": weight, "y": 9.0}}
    task = task_of(maps_of(), ssim=ssim, cosine=cosine, ssim_channels=6, **named)
    rng = np.random.default_rng(1)
    alpha = np.full(20, 0.5)
    alpha[rng.permutation(20)[:covered]] = 0.51
    alpha = torch.from_numpy(alpha.reshape(5, 4).astype(np.float32))
    latent = torch.from_numpy(rng.normal(size=(5, 4, 4)).astype(np.float32))
    with torch.no_grad():
        loss, found = float(task.loss(latent, alpha, 1)), task.decode(latent).double()
    wanted, seen = torch.from_numpy(task.maps.at(1)).double(), alpha > 0.5
    error = angle = 0.0
    for r, c in np.argwhere(seen.numpy()):
        a, b = found[r, c].numpy(), wanted[r, c].numpy()
        error += np.abs(a - b).mean() / covered
        angle += (1 - a @ b / np.linalg.norm(a) / np.linalg.norm(b)) / covered
    expected = error / task.size + cosine * angle
    if ssim:
        expected += ssim * float(dissimilarity(found, wanted, seen, task.range))
    assert loss == pytest.approx(weight * expected, rel=1e-4)


def test_heads_of_many_channels_have_no_ssim_term():
    latent, alpha = torch.rand(5, 4, 4), torch.ones(5, 4)
    with torch.no_grad():
        few, many, none = (
            float(task_of(maps_of(), ssim=ssim, ssim_channels=most).loss(latent, alpha, 0))
            for ssim, most in ((0.4, 6), (0.4, 5), (0.0, 6))
        )
    assert many == none < few


def test_a_kept_head_loses_by_what_it_decodes_otherwise():
    head = Head([4, 3])
    spec = FeatureSpec("x", 3, (2, 3))
    arrays = head.to_arrays()
    kept = KeptHead(FieldHead(spec, (arrays["weight_0"],), (arrays["bias_0"],)))
    now, before = torch.rand(2, 2, 3, 4).unbind(0)
    alpha = torch.tensor([[0.4, 0.5, 0.51], [0.9, 1.0, 0.0]])
    error = size = 0.0
    for r, c in ((0, 2), (1, 0), (1, 1)):
        a, b = (head(latent[r, c]).detach().double().numpy() for latent in (now, before))
        error, size = error + np.abs(a - b).sum(), size + np.abs(b).sum()
    assert float(kept.loss(now, before, alpha)) == pytest.approx(error / size, rel=1e-5)
    small = KeptHead(FieldHead(spec, (1e-3 * arrays["weight_0"],), (1e-3 * arrays["bias_0"],)))
    assert float(small.loss(now, before, alpha)) == pytest.approx(error / size, rel=1e-5), "of whatever size"
    assert float(kept.loss(now, before, 0 * alpha)) == 0
    assert not any(parameter.requires_grad for parameter in kept.head.parameters())


# ---- what frames see ---------------------------------------------------------------------------------------------------


def mix_written_out(scene, frame, grid, size):
    """(cells, N) shares of the Gaussians in a cell's light, (cells,) light, from a picture of `size` (rows, columns)."""
    posed = scene.posed(float(scene.cameras.times[frame]))
    camera = scene.cameras[frame].resized(size[1], size[0])
    config = RasterConfig(blur=RasterConfig.blur * (size[0] / HEIGHT) ** 2, threads=1)
    out = rasterize(posed, np.eye(len(posed), dtype=np.float32), camera, backend="torch", config=config)
    light = np.zeros((*grid, len(posed)))
    for y in range(size[0]):
        for x in range(size[1]):
            light[(2 * y + 1) * grid[0] // (2 * size[0]), (2 * x + 1) * grid[1] // (2 * size[1])] += out.channels[y, x]
    light = light.reshape(-1, len(posed))
    return light / np.maximum(light.sum(1, keepdims=True), 1e-9), light.sum(1)


def nodes_of(scene, shares):
    """Shares of static Gaussians and nodes, from those of all Gaussians."""
    static, dynamic = len(scene.static), scene.dynamic
    found = np.zeros((len(shares), static + len(scene.scaffold.ids)))
    found[:, :static] = shares[:, :static]
    for i in range(len(dynamic)):
        for node, weight in zip(dynamic.node[i], dynamic.weight[i], strict=True):
            found[:, static + node] += shares[:, static + i] * weight
    return found


@pytest.mark.parametrize(
    ("grid", "size"), [((5, 4), (20, 32)), ((4, 8), (20, 32)), ((8, 4), (32, 51)), ((16, 4), (HEIGHT, WIDTH))]
)
def test_a_view_blends_nodes_and_static_gaussians_as_a_picture_of_four_pixels_a_cell_does(grid, size):
    scene = random_scene(static=90, dynamic=8, degree=0)
    small = 0.3 if grid[0] > 8 else 1  # what is wider than eight cells is heard in wrong ones
    parts = {kind: getattr(scene, kind) for kind in ("static", "dynamic")}
    scene = dataclasses.replace(
        scene, **{kind: dataclasses.replace(part, scales=small * part.scales) for kind, part in parts.items()}
    )
    shares, light = mix_written_out(scene, 3, grid, size)
    alpha, seen = light / (size[0] * size[1] / grid[0] / grid[1]), light > 0.3
    for flag in (False, True):
        view = stage_of(scene, maps_of(grid=grid), feature_grad_to_skinning=flag).look(3)
        expected = shares if flag else nodes_of(scene, shares)
        assert view.frame == 3 and view.mix.shape == expected.shape and view.mix.dtype == np.float32
        np.testing.assert_allclose(view.mix.toarray()[seen], expected[seen], atol=0.06)
        np.testing.assert_allclose(view.alpha.numpy().ravel(), np.minimum(alpha, 1), atol=0.01)
        assert (np.abs(view.mix.sum(1)[seen] - 1) < 1e-3).all()


def test_a_cell_with_more_than_its_share_of_the_pixels_is_not_more_than_opaque():
    """51 columns over 4 cells: one of them has 13, the others 12 or 13."""
    scene = random_scene(static=90, dynamic=8, degree=0)
    wall = dataclasses.replace(scene.static, scales=20 * scene.static.scales, opacities=0 * scene.static.opacities + 1)
    view = stage_of(dataclasses.replace(scene, static=wall), maps_of(grid=(8, 4))).look(3)
    assert view.alpha.max() == 1 and view.alpha.mean() > 0.95


def test_the_gradient_of_a_blend_is_its_transpose(scene):
    view = stage_of(scene).look(0)
    latents = torch.rand(view.mix.shape[1], 2, dtype=torch.float64, requires_grad=True)
    expected = view.mix.toarray().astype(np.float64) @ latents.detach().numpy()
    np.testing.assert_allclose(_Mix.apply(latents, view).detach(), expected, rtol=1e-6)
    assert torch.autograd.gradcheck(lambda each: _Mix.apply(each, view), (latents,))


# ---- where training starts ---------------------------------------------------------------------------------------------


def components(stage, frame):
    """(cells,D) coordinates of the maps along the principal components, maps enlarged by bilinear interpolation."""
    found = []
    for each in stage.maps:
        (rows, columns), (h, w) = stage.grid, each.spec.grid
        large = np.zeros((rows, columns, each.spec.dim))
        for r in range(rows):
            for c in range(columns):
                y, x = ((i + 0.5) * n / m - 0.5 for i, n, m in ((r, h, rows), (c, w, columns)))
                y, x = max(y, 0), max(x, 0)
                for i, j in ((0, 0), (0, 1), (1, 0), (1, 1)):
                    weight = abs(1 - i - y % 1) * abs(1 - j - x % 1)
                    large[r, c] += weight * each.at(frame)[min(int(y) + i, h - 1), min(int(x) + j, w - 1)]
        found.append(large.reshape(-1, each.spec.dim).astype(np.float32))
    return stage.spectrum.coordinates(found, stage.width)


@pytest.mark.parametrize("flag", [False, True])
def test_latents_start_at_the_mean_of_the_components_that_their_cells_show(scene, flag):
    stage = stage_of(scene, maps_of(), maps_of("yy", 3, (10, 8)), feature_grad_to_skinning=flag)
    views = [stage.look(t) for t in (0, 4)]
    columns = views[0].mix.shape[1]
    total, weight = np.zeros((columns, 4)), np.zeros(columns)
    for view in views:
        wanted, mix = components(stage, view.frame), view.mix.toarray().astype(np.float64)
        for cell, alpha in enumerate(view.alpha.ravel()):
            if alpha > 0.5:
                total += mix[cell][:, None] * wanted[cell]
                weight += mix[cell]
    if flag:
        total, weight = (nodes_of(scene, each.T.reshape(-1, columns)).T for each in (total, weight))
        weight = weight[:, 0]
    assert ((weight > 0) & (weight < 0.5)).any()
    expected = total / np.maximum(weight, 1e-6)[:, None]
    found = stage.first_latents(views)
    np.testing.assert_allclose(found, expected / expected.std(), rtol=1e-3, atol=1e-4)
    assert found.dtype == np.float32 and found.shape == (12 + 5, 4)


def test_latents_of_kept_heads_start_where_they_are(learnt):
    stage = stage_of(learnt, maps_of("new"), width=None)
    field = learnt.features
    expected = field.low + field.step * np.concatenate([field.static, field.nodes])
    np.testing.assert_allclose(stage.first_latents([]), expected, rtol=1e-6)
    assert stage.width == 4 and [kept.stored.spec.name for kept in stage.kept] == ["old"] and not stage.frozen
    assert stage_of(learnt, maps_of("new"), keep=math.inf).frozen
    assert not stage_of(learnt, maps_of("old"), keep=math.inf).frozen, "nothing is kept"


# ---- training ----------------------------------------------------------------------------------------------------------


def trained_written_out(stage, views, start):
    """Latents after plain Adam on dense matrices, with rates that fall along a cosine; the stage's heads are copied."""
    config, steps, tasks = stage.config, stage.config.steps, copy.deepcopy(stage.tasks)
    rng = np.random.default_rng(config.seed)
    before = torch.from_numpy(start)
    latents = before.clone().requires_grad_()
    heads = torch.optim.Adam([p for task in tasks for p in task.head.parameters()], lr=config.head_rate)
    own = torch.optim.Adam([latents], lr=config.latent_rate)
    waiting = []
    for step in range(steps):
        for optimiser, rate in ((heads, config.head_rate), (own, config.latent_rate)):
            optimiser.param_groups[0]["lr"] = rate * (1 + math.cos(math.pi * step / steps)) / 2
            optimiser.zero_grad()
        loss = torch.zeros(())
        for _ in range(min(config.frames_per_step, len(views))):
            if not waiting:
                waiting = list(rng.permutation(len(views)))
            view = views[waiting.pop()]
            mix = torch.from_numpy(view.mix.toarray())
            seen, was = ((mix @ each).reshape(*stage.grid, -1) for each in (latents, before))
            for task in tasks:
                loss = loss + task.loss(seen, view.alpha, view.frame)
            for kept in stage.kept:
                loss = loss + config.keep * kept.loss(seen, was, view.alpha)
        loss.backward()
        heads.step(), own.step()
    return latents.detach().numpy(), tasks


@pytest.mark.parametrize("kept", [False, True])
@pytest.mark.parametrize("frames", [2, 3, 9])
def test_training_is_adam_on_every_frame_in_turn_with_rates_that_fall_to_nothing(scene, learnt, kept, frames):
    base, maps = (learnt, maps_of("new")) if kept else (scene, maps_of())
    stage = stage_of(base, maps, maps_of("second", 3), width=None if kept else 4, frames_per_step=frames, keep=0.5)
    views = [stage.look(t) for t in USED]
    start = stage.first_latents(views)
    expected, tasks = trained_written_out(stage, views, start)
    found, weight = stage.train(views, start)
    assert weight is None and np.abs(found - start).max() > 0.05
    np.testing.assert_allclose(found, expected, atol=1e-3)
    for mine, own in zip(tasks, stage.tasks, strict=True):
        for a, b in zip(mine.head.parameters(), own.head.parameters(), strict=True):
            torch.testing.assert_close(a, b, atol=1e-4, rtol=1e-3)


def test_a_latent_that_may_not_move_does_not(learnt):
    stage = stage_of(learnt, maps_of("new"), keep=math.inf)
    start = stage.first_latents([])
    found, _ = stage.train([stage.look(0)], start)
    np.testing.assert_array_equal(found, start)


def test_skinning_weights_start_as_they_are_and_unused_slots_stay_unused(scene):
    weight = scene.dynamic.weight.copy()
    weight[0], weight[1], weight[2] = [0.25, 0, 0.75], [0, 1, 0], 0
    strength = np.where(np.arange(8) == 2, 0, 1).astype(np.float32)
    cut = dataclasses.replace(scene, dynamic=dataclasses.replace(scene.dynamic, weight=weight, strength=strength))
    skin = module._Skinning(cut)
    np.testing.assert_allclose(skin.weights().detach(), weight, atol=1e-6)
    latents = torch.rand(17, 3)
    columns = skin.columns(latents).detach()
    torch.testing.assert_close(columns[:12], latents[:12])
    for i, (nodes, own) in enumerate(zip(cut.dynamic.node, weight, strict=True)):
        expected = sum(float(w) * latents[12 + n] for n, w in zip(nodes, own, strict=True))
        torch.testing.assert_close(columns[12 + i], torch.as_tensor(expected).expand(3), atol=1e-5, rtol=1e-5)
    with torch.no_grad():
        skin.logits.add_(torch.linspace(-1, 1, skin.logits.numel()).view_as(skin.logits))
    moved = skin.weights().detach()
    assert ((moved == 0) == (torch.from_numpy(weight) == 0)).all()
    np.testing.assert_allclose(moved[3:].sum(1), 1, rtol=1e-5)


# ---- the report --------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("flag", [False, True])
def test_the_report_compares_what_stored_latents_decode_to_with_teachers_and_kept_heads(learnt, monkeypatch, flag):
    monkeypatch.setattr(module, "PICTURE_SAMPLES", 13)
    maps = maps_of("new", grid=(10, 8))
    stage = stage_of(learnt, maps, width=None, feature_grad_to_skinning=flag)
    views = [stage.look(t) for t in range(FRAMES)]
    rng = np.random.default_rng(0)
    latents = rng.normal(size=(17, 4)).astype(np.float32)
    stored = latents + 0.1 * rng.normal(size=latents.shape).astype(np.float32)
    field = learnt.features
    before = field.low + field.step * np.concatenate([field.static, field.nodes])
    heads, pca = stage.report(views, latents, stored)
    assert [head.spec.name for head in heads] == ["old", "new"]
    old, new = heads
    sums = {}
    for view in views:
        mix = view.mix.toarray().astype(np.float64)
        if flag:
            mix = nodes_of(learnt, mix)
        z, exact, was = ((mix @ each).astype(np.float32).reshape(*stage.grid, 4) for each in (stored, latents, before))
        seen = view.alpha.numpy() > 0.5
        wanted, group = maps.at(view.frame)[seen], "held_out" if view.frame == 2 else "used"
        small = [to_grid(torch.from_numpy(each), view.alpha, old.spec) for each in (z, was)]
        known = small[0][1].numpy() > 0.5
        for name, found, true in (
            (group, new(z)[seen], wanted),
            ("stored_change", new(z)[seen], new(exact)[seen]),
            ("drift", *(old(each.numpy())[known] for each, _ in small)),
        ):
            for a, b in zip(found.astype(float), true.astype(float), strict=True):
                own = sums.setdefault(name, [0.0, 0.0, 0.0, 0])
                own[0] += np.abs(a - b).sum()
                own[1] += np.abs(b).sum()
                own[2] += a @ b / np.linalg.norm(a) / np.linalg.norm(b)
                own[3] += 1
    for name in ("used", "held_out"):
        error, size, cosine, count = sums[name]
        assert new.report[name]["relative_error"] == pytest.approx(error / size, rel=1e-3)
        assert new.report[name]["cosine"] == pytest.approx(cosine / count, rel=1e-3, abs=1e-4)
    assert new.report["stored_change"] == pytest.approx(sums["stored_change"][0] / sums["stored_change"][1], rel=5e-3)
    assert old.report["drift"] == pytest.approx(sums["drift"][0] / sums["drift"][1], rel=1e-3)
    assert set(new.report) == {"used", "held_out", "stored_change"}
    assert pca.basis.shape == (3, 4) and np.abs(pca.basis).max() > 0


def test_pictures_are_coloured_by_so_many_covered_cells_of_every_frame(scene, monkeypatch):
    stage = stage_of(scene, maps_of(grid=(10, 8)))
    views = [stage.look(t) for t in range(3)]
    latents = np.random.default_rng(0).normal(size=(17, 4)).astype(np.float32)
    covered = [(each.mix @ latents)[(each.alpha > 0.5).numpy().ravel()] for each in views]
    given = []
    monkeypatch.setattr(module, "fit_pca", lambda samples: given.append(samples) or fit_pca(samples))
    assert min(map(len, covered)) > 5
    for most, rows in ((1_000_000, [len(each) for each in covered]), (15, [5] * 3), (2, [1] * 3)):
        monkeypatch.setattr(module, "PICTURE_SAMPLES", most)
        given.clear()
        stage.report(views, latents, latents)
        ends = np.cumsum([0, *rows])
        assert len(given[-1]) == ends[-1]
        for start, end, cells in zip(ends, ends[1:], covered, strict=False):
            for row in given[-1][start:end]:
                assert np.abs(cells - row).sum(1).min() < 1e-4
        if most > 100:
            np.testing.assert_allclose(np.sort(given[-1], 0), np.sort(np.concatenate(covered), 0), atol=1e-5)


def test_figures_of_nothing_are_left_out_and_features_of_nothing_have_no_direction():
    figures = module._Figures()
    figures.add("used", np.zeros((0, 3)), np.zeros((0, 3)))
    assert figures.rows() == {}
    figures.add("used", np.zeros((2, 3)), np.eye(3)[:2])
    figures.add("drift", np.eye(3), np.zeros((3, 3)))
    assert figures.rows() == {"used": {"relative_error": 1.0, "cosine": 0.0}, "drift": 3e12}
    figures.add("used", np.eye(3)[:2] * 1e-3, np.eye(3)[:2] * 1e-3)
    assert figures.rows()["used"]["cosine"] == 0.5


def test_the_stored_field_gives_the_latents_back_and_the_table_says_what_was_saved(scene):
    glob = np.arange(6, dtype=np.float32)
    maps = dataclasses.replace(maps_of(has_global=True), glob=glob)
    after = distil(scene, [maps], dataclasses.replace(CONFIG, bits=8, steps=3))
    field = after.features
    np.testing.assert_array_equal(field.heads[0].glob, glob)
    assert field.heads[0].report["stored_change"] < 0.05
    assert field.bits == 8 and field.static.shape == (12, 4) and field.nodes.shape == (5, 4)
    row = next(row for row in after.needs if row["what"] == "latent")
    assert (row["chosen"], row["evidence"]) == ("4 channels, 1 heads", "given")
    assert row["saved"] == "60 of 64 channels per Gaussian and node"
    again = distil(after, [maps_of("new")], dataclasses.replace(CONFIG, width=4, steps=1))
    rows = [row for row in again.needs if row["what"] == "latent"]
    assert len(rows) == 1 and rows[0]["chosen"] == "4 channels, 2 heads"
    assert rows[0]["evidence"].startswith("the width of the heads that are kept; variance")
    asked = stage_of(scene, width=None).need()
    assert asked.evidence.startswith("variance") and asked.chosen == "8 channels, 1 heads"
    anew = distil(after, [maps_of()], dataclasses.replace(CONFIG, width=6, steps=1))
    assert anew.features.width == 6 and anew.features.names == ("x",), "learnt anew, in any width"


@pytest.mark.parametrize(("changes", "told"), [({"width": 0}, "width"), ({"width": 2}, ""), ({"steps": 0}, "steps")])
def test_the_least_width_is_two_and_the_least_number_of_steps_one(scene, changes, told):
    if told:
        with pytest.raises(F4xError, match=f"--{told} 0"):
            distil(scene, [maps_of()], dataclasses.replace(CONFIG, **changes))
    else:
        after = distil(scene, [maps_of()], dataclasses.replace(CONFIG, steps=1, **changes))
        assert after.features.width == 2 and len(after.features.heads) == 1
