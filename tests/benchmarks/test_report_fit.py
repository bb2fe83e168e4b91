"""Studies of the fit at sizes of seconds: the worlds are what they say, the pieces measure what they name."""

import dataclasses
from types import SimpleNamespace

import numpy as np
import pytest
import torch
from scipy.ndimage import binary_erosion, map_coordinates

from benchmarks.catalogue import STUDIES
from benchmarks.runner import run_studies
from benchmarks.studies import ablations, fit_studies, latent_studies, needs_studies, toy_fits, toy_worlds
from benchmarks.studies.supplement import DIMENSIONS, OURS
from benchmarks.studies.toy_features import label_vectors, score_views, world_maps
from benchmarks.study import Context
from f4x_core.evaluation.truth import into_scene
from f4x_core.fit.config import profile
from f4x_core.geometry import dual_quaternion, pose, quaternion

SIZE = 48, 10


@pytest.fixture(autouse=True)
def tiny(monkeypatch):
    """Small worlds, few steps, few choices; one thread."""
    before = torch.get_num_threads()
    torch.set_num_threads(1)
    monkeypatch.setattr(toy_fits, "QUICK_SIZE", SIZE)
    monkeypatch.setattr(toy_fits, "QUICK_STEPS", 6)
    monkeypatch.setattr(latent_studies, "QUICK_STEPS", 3)
    monkeypatch.setattr(latent_studies, "WIDTHS", (8, 32, 512))
    monkeypatch.setattr(needs_studies, "STEPS", 3)
    monkeypatch.setattr(needs_studies, "LADDER", ("static", "rigid"))
    choices = {"static": ("SH degree",), "rigid": ("nodes", "latent width")}
    monkeypatch.setattr(needs_studies, "QUICK_CHOICES", choices)
    monkeypatch.setattr(fit_studies, "QUICK_FRACTION", 0)
    monkeypatch.setattr(fit_studies, "MIN_STEPS", 3)
    monkeypatch.setattr(fit_studies, "QUICK_COUNTS", (3, 6))
    monkeypatch.setattr(fit_studies, "QUICK_WIDTHS", (48, 96))
    monkeypatch.setattr(fit_studies, "QUICK_FACTORS", (0.5, 1.0))
    monkeypatch.setattr(ablations, "QUICK", {("articulated", "true"): (ablations.WHOLE, "no ARAP", ablations.LINEAR)})
    yield
    torch.set_num_threads(before)


@pytest.fixture(scope="module")
def arm():
    """A world that bends."""
    return toy_worlds.make_world("articulated", *SIZE)


def report(folder, *names):
    """Run studies by name, quickly."""
    studies = [study for study in STUDIES if study.name in names]
    assert len(studies) == len(names)
    return run_studies(studies, folder, Context(folder, quick=True))["studies"]


def tables(record):
    return {table["name"]: table["rows"] for table in record["tables"]}


def untimed(record):
    """Everything in the tables that must be the same in every run."""
    return [
        [{column: value for column, value in row.items() if column not in table["timed"]} for row in table["rows"]]
        for table in record["tables"]
    ]


@pytest.mark.parametrize("name", toy_worlds.KINDS)
def test_tracks_lie_on_what_the_pictures_show(name):
    world = toy_worlds.make_world(name, *SIZE)
    pixels, visible, moving = world.tracks
    priors = world.priors
    assert visible.sum(0).min() >= 4 and moving.any() == world.moving.any()
    for time, view in enumerate(world.views):
        column, row = np.floor(pixels[time, visible[time]]).astype(int).T
        shown = view.moving[row, column] > 0.5
        assert (shown == moving[visible[time]]).mean() > 0.97
    assert np.nanmedian(priors.depth) == pytest.approx(1.1, abs=0.1), "the world's unit is its median depth"
    held_out = np.setdiff1d(np.arange(world.frames), priors.frames)
    assert len(held_out) and not np.isin(priors.frames, held_out).any()


def test_novel_views_are_views_of_the_same_world(arm):
    """A still point of the wall has the same colour from both paths (its texture does not shine)."""
    camera, time, view = arm.novel_views[1]
    own = arm.views[int(time)]
    xyz = arm.at(time)[arm.label_of == arm.labels.index("wall")]
    found = []
    for cam, seen in ((arm.cameras[int(time)], own), (camera, view)):
        uv, z = cam.project(xyz)
        column, row = np.floor(uv).astype(int).T
        inside = (column >= 0) & (column < arm.width) & (row >= 0) & (row < arm.height)
        safe = row.clip(0, arm.height - 1), column.clip(0, arm.width - 1)
        inside &= np.abs(seen.depth[safe] - z) < 0.01
        found.append((inside, seen.rgb[safe]))
    both = found[0][0] & found[1][0]
    assert both.sum() > 500
    one, other = found[0][1][both], found[1][1][both]
    unrelated = np.abs(one - np.roll(other, len(other) // 3, axis=0)).mean()
    assert np.abs(one - other).mean() < 0.5 * unrelated


def warped(world, frame, other):
    """Picture (H,W,3) of `frame` made of that of `other` along the true depth and cameras, and where it shows the wall (H,W)."""
    here, there = world.views[frame], world.views[other]
    camera, second = world.cameras[frame], world.cameras[other]
    wall = world.labels.index("wall")
    x = camera.unproject(camera.pixel_grid(), np.nan_to_num(here.depth, nan=1.0))
    uv, z = second.project(x)
    place = [uv[..., 1] - 0.5, uv[..., 0] - 0.5]
    picture = np.stack([map_coordinates(channel, place, order=3) for channel in there.rgb.transpose(2, 0, 1)], -1)
    depth = map_coordinates(np.nan_to_num(there.depth), place, order=1)
    return picture, (here.mix[..., wall] > 0.99) & (np.abs(depth - z) < 0.01 * z)


@pytest.mark.parametrize("frames", [(0, 9), (0, 4), (5, 9)])
def test_true_cameras_explain_what_stands_to_a_tenth_of_a_pixel(frames):
    """Else a fit that has the true cameras is led away from them, and judged by that."""
    world = toy_worlds.make_world("static", 96, 10)
    picture, wall = warped(world, *frames)
    target = world.views[frames[0]].rgb
    gradient = np.stack(np.gradient(target.mean(-1)), -1)
    inner = binary_erosion(wall, iterations=2)
    assert inner.sum() > 1000
    error = (target - picture).mean(-1)[inner]
    shift = np.linalg.lstsq(gradient[inner], error, rcond=None)[0]  # rows and columns, to first order
    assert np.abs(shift).max() < 0.1
    assert np.abs((target - picture)[inner]).mean() < 0.01


def test_barycentric_weights_make_the_point():
    rng = np.random.default_rng(0)
    triangles = rng.normal(size=(20, 3, 3))
    weights = rng.dirichlet(np.ones(3), 20)
    points = np.einsum("nk,nkc->nc", weights, triangles)
    assert np.allclose(toy_worlds.barycentric(points, triangles), weights)


def test_truth_scores_without_error(arm):
    """Labels that are true score 1, and no label at all scores 0."""
    truth = {time: view.label for _, time, view in arm.novel_views}
    count = len(arm.labels)
    assert score_views(count, arm.novel_views, lambda _, time: truth[time]) == (1.0, 1.0)
    assert score_views(count, arm.novel_views, lambda _, time: np.full((3, 4), -1)) == (0.0, 0.0)


def test_novel_views_follow_a_fit_that_turned_moved_and_scaled_its_world(arm):
    turn = quaternion.to_matrix(quaternion.from_rotation_vector(np.array([0.1, -0.2, 0.05])))
    change = 1.3, turn, np.array([0.2, 0.1, -0.3])
    path = arm.cameras
    moved = np.stack([into_scene(path[i], change).world_to_camera for i in range(len(path))])
    fitted = SimpleNamespace(cameras=dataclasses.replace(path, world_to_camera=moved))
    for (camera, time, view), (true, moment, truth) in zip(
        toy_fits.novel_views(arm, fitted), arm.novel_views, strict=True
    ):
        assert time == moment and view is truth
        assert np.allclose(camera.world_to_camera, into_scene(true, change).world_to_camera, atol=1e-6)
        assert not np.allclose(camera.world_to_camera, true.world_to_camera, atol=1e-2)


def test_made_up_features_say_their_labels(arm, tmp_path):
    maps = world_maps(arm, tmp_path / "maps", 32)
    cells = arm.views[0].label[1::3, 1::3]
    pure = arm.views[0].mix.reshape(maps.spec.grid[0], 3, maps.spec.grid[1], 3, -1).mean((1, 3)).max(-1) > 0.99
    best = (maps.at(0) @ label_vectors(arm, 32).T).argmax(-1)
    assert (best == cells)[pure & (cells >= 0)].mean() > 0.95


def test_shortened_schedules_change_as_often():
    long = profile("quick")
    short = toy_fits.shorten(long, long.steps // 4)
    assert short.steps / short.density_static.every == pytest.approx(long.steps / long.density_static.every)
    assert short.steps / short.graph_every == pytest.approx(long.steps / long.graph_every)
    double = toy_fits.thin_out(long, 2.0)
    assert (long.spawn_static.spacing / double.spawn_static.spacing) ** 2 == pytest.approx(2.0)
    assert double.density_dynamic.max_count == 2 * long.density_dynamic.max_count


def test_linear_blend_is_rigid_for_one_motion_and_shrinks_between_two():
    q = quaternion.from_rotation_vector(np.array([0, 0, 2.0]))
    x, own = np.array([[0.3, 0.1, 0.0]]), np.array([[1.0, 0, 0, 0]])
    turn, shift = np.tile(q, (1, 2, 1)), np.tile([0.1, 0.2, 0.3], (1, 2, 1))
    weights = np.array([[0.4, 0.6]])
    moved, turned = ablations.linear_blend(turn, shift, weights, x, own)
    assert np.allclose(moved, pose.transform(q, shift[0, 0], x)) and np.allclose(turned, q)
    turn[0, 1] = quaternion.multiply(quaternion.from_rotation_vector(np.array([0, 0, 2.5])), q)
    moved, _ = ablations.linear_blend(turn, 0 * shift, np.array([[0.5, 0.5]]), x, own)
    blended = dual_quaternion.normalize(dual_quaternion.from_pose(turn, 0 * shift).mean(1))
    exact = pose.transform(*dual_quaternion.to_pose(blended), x)
    assert np.linalg.norm(exact) == pytest.approx(np.linalg.norm(x))
    assert np.linalg.norm(moved) == pytest.approx(np.linalg.norm(x) * np.cos(1.25), rel=1e-6), "the known collapse"


def test_linear_model_and_linear_scene_are_one(arm):
    """What is trained is what is scored: both pose the Gaussians alike."""
    config = toy_fits.base_config(Context(folder=None, quick=True))
    fitted = toy_fits.fit_world(arm, config, model=ablations.LinearModel)
    scene = ablations.LinearScene.of(fitted.scene)
    score = toy_fits.score_world(arm, scene)
    assert fitted.scene.provenance["config"]["steps"] == 6
    from f4x_core.fit.pipeline import start_fit
    from f4x_core.fit.trainer import FitStart, Trainer

    stage = start_fit(arm.clip, arm.priors, config)
    old = stage.model
    linear = ablations.LinearModel(old.static, old.dynamic, old.nodes, old.rig, old.kernel)
    stage = Trainer(linear, arm.clip, stage.priors, config, FitStart(stage.next_id))
    stage.run()
    with torch.no_grad():
        means = stage.model.dynamic_at(3.0)[0].means
    moved = scene.posed(3.0).means[len(scene.static) :]
    assert np.abs(moved - means.numpy()).max() < 1e-5
    assert not np.allclose(moved, fitted.scene.posed(3.0).means[len(scene.static) :], atol=1e-6)
    assert score["track (px)"] is not None


@pytest.mark.parametrize("attached", [False, True])
def test_features_reach_geometry_only_when_asked(arm, tmp_path, attached, monkeypatch):
    """With pictures out of the loss, held-back features leave every opacity as it was."""
    from f4x_core.fit.pipeline import start_fit

    stage = start_fit(arm.clip, arm.priors, toy_fits.base_config(Context(folder=None, quick=True)))
    before = stage.model.static.parameters["opacity_logits"].detach().clone()
    monkeypatch.setattr(ablations, "rgb_loss", lambda image, *_: 0 * image.sum())
    ablations.train_jointly(stage, world_maps(arm, tmp_path / "maps", ablations.DIM), attached, 2)
    same = torch.equal(before, stage.model.static.parameters["opacity_logits"].detach())
    assert same is not attached


def test_ablations_change_the_settings():
    base = profile("quick")
    changed = {name: change(base) for name, change in ablations.ABLATIONS.items()}
    untouched = [name for name, config in changed.items() if config == base]
    assert untouched == [ablations.WHOLE, ablations.LINEAR]
    without = changed["no ARAP"]
    assert without.scaffold.geometry(0).coordinate == without.losses.arap_length == 0
    assert changed["third largest distance in place of the largest"].scaffold.graph.kth == 3


def test_pretended_motion_makes_a_scaffold_of_a_still_box():
    world = toy_worlds.make_world("static", *SIZE)
    priors = needs_studies._pretend_moving(world)
    assert not world.priors.mask.any() and priors.mask.mean() > 0.01
    assert 0 < priors.tracks_motion.mean() < 0.5
    assert needs_studies._pretend_moving(toy_worlds.make_world("rigid", *SIZE)) is None


@pytest.mark.parametrize(
    ("loses", "gains", "verdict"),
    [
        ([1.0, 0.9], [0.1, 0.2], "at the knee"),
        ([0.1], [0.1], "smaller would do"),
        ([1.0], [0.5], "larger would pay"),
        (None, [0.1, -0.4], "at the knee"),
        ([2.0], None, "at the knee"),
        ([0.4, 0.2], [0.1, 0.1], "seeds disagree"),
        (None, [0.1, 0.4], "seeds disagree"),
    ],
)
def test_verdicts(loses, gains, verdict):
    assert needs_studies.judge_knee(loses, gains, 0.3) == verdict


def test_each_seed_is_compared_with_the_neighbours_of_its_own_choice(tmp_path, monkeypatch):
    """Seed 0 chooses 8 nodes and colours without harmonics, seed 1 16 and degree 1; more nodes bring 1 dB a doubling."""
    own = {0: (8, 0), 1: (16, 1)}

    def fit(config, priors):
        nodes, degree = own[config.seed]
        if config.scaffold.max_nodes != profile("quick").scaffold.max_nodes:
            nodes = config.scaffold.min_nodes
        degree = degree if config.sh_degree is None else config.sh_degree
        row = {"dB": np.log2(nodes) + 2 * degree, "moving dB": np.log2(nodes), "fit (s)": 1.0, "moving (%)": 5.0}
        return (nodes, degree), row

    def facts(scene):
        named = {"needs": [], "nodes at start": scene[0], "nodes": scene[0], "SH degree": scene[1], "dynamic": 9}
        return named | {"static": 1, "Gaussians": 10, "stages": "", "size (MB)": 1.0}

    monkeypatch.setattr(needs_studies, "_facts", facts)
    monkeypatch.setattr(needs_studies, "write_scene", lambda *_: None)
    found = needs_studies._Found()
    subject = needs_studies.Subject("made up", fit, "dB", "moving dB", lambda: None)
    base = profile("quick")
    context = Context(tmp_path)
    found.add(context, subject, {"scene": "made up"}, base, [needs_studies.NODES, needs_studies.DEGREE], seeds=2)
    nodes, degree = found.knees
    assert nodes["chosen"] == 12 and (nodes["smaller loses low"], nodes["larger gains high"]) == (1.0, 1.0)
    assert nodes["verdict"] == needs_studies.LARGER_PAYS
    assert degree["smaller loses"] is None, "seed 0 has no smaller degree"
    assert degree["larger gains"] == 2.0


def test_changes_below_what_seeds_do_are_not_sure():
    """The bound of a mean of two, from 16 groups that scatter by 1, is near the normal one; chance passes it 1 time in 20."""
    rng = np.random.default_rng(0)
    found = [ablations.doubt_of(rng.normal(size=(16, 2)) + 5 * np.arange(16)[:, None]) for _ in range(200)]
    assert np.mean(found) == pytest.approx(2.12 / 2**0.5, rel=0.05)  # t of 16 degrees of freedom
    assert np.mean(np.abs(rng.normal(size=200) / 2**0.5) > found) == pytest.approx(0.05, abs=0.04)
    assert ablations.doubt_of([[1.0], [2.0]]) is None


def test_changes_are_those_of_pairs():
    rows, others = ([{"x": value} for value in values] for values in ((1.0, 5.0, 9.0), (0.5, 2.0)))
    assert toy_fits.paired_changes(rows, others, "x") == [0.5, 3.0]
    assert toy_fits.spread("error (dB)", [2.0, 1.0]) == {"error low (dB)": 1.0, "error high (dB)": 2.0}


@pytest.mark.slow
def test_needs_tell_both_neighbours_and_are_the_same_again(tmp_path):
    record = report(tmp_path / "a", "needs-ladder")["needs-ladder"]
    found = tables(record)
    assert [row["scene"] for row in found["needs"]] == ["static", "rigid"]
    assert found["needs"][0]["dynamic"] == 0 < found["needs"][1]["dynamic"]
    knees = {(row["scene"], row["choice"]): row for row in found["knees"]}
    assert set(knees) == {("static", "SH degree"), ("rigid", "nodes"), ("rigid", "latent width")}
    nodes = [row["nodes"] for row in found["choice-nodes"]]
    assert nodes == [nodes[1] // 2, nodes[1], 2 * nodes[1]]
    assert "of 3 choices sit at the knee" in record["words"][0]
    again = report(tmp_path / "b", "needs-ladder")["needs-ladder"]
    assert untimed(record) == untimed(again) and record["words"] == again["words"]


@pytest.mark.slow
def test_fit_studies_rows(tmp_path, monkeypatch):
    monkeypatch.setattr(fit_studies, "lpips_missing", lambda: ["LPIPS: no weights"])
    found = report(tmp_path, "fit-profile", "fit-iterations", "fit-resolution", "fit-budget")
    profiles = tables(found["fit-profile"])["profiles"]
    assert [row["profile"] for row in profiles[:2]] == ["wild", "quick"]
    assert {row["profile"] for row in profiles if "steps" not in row} == {
        "no 3D: nearest used frame",
        "no 3D: blend along flow",
    }
    for row in profiles[:5]:
        assert row["novel error (rms)"] == pytest.approx(10 ** (-row["novel (dB)"] / 20))
        assert row["novel low (dB)"] <= row["novel (dB)"] <= row["novel high (dB)"]
    budget = tables(found["fit-budget"])["budget"]
    assert budget[0]["Gaussians"] < budget[1]["Gaussians"]
    assert found["fit-iterations"]["skipped"] == ["LPIPS: no weights"]
    assert f"{tables(found['fit-resolution'])['resolution'][0]['width (px)']}" in found["fit-resolution"]["words"][0]


@pytest.mark.slow
def test_widths_stand_beside_the_papers(tmp_path):
    record = report(tmp_path, "latent-width")["latent-width"]
    rows = tables(record)["widths"]
    ours = [row for row in rows if row["source"] == OURS]
    assert [row["width"] for row in ours] == [8, 32, 512]
    assert all(row["PSNR change (dB)"] == 0 for row in ours), "the geometry stands still"
    theirs = [row for row in rows if row["source"] != OURS]
    assert len(theirs) == len(DIMENSIONS) == 7
    assert theirs[-1]["training time / that of 32"] == pytest.approx(5.23, abs=0.01), "the ratio that the paper states"
    assert "5.23" in " ".join(record["words"])


@pytest.mark.slow
def test_ablations_are_told_against_the_whole(tmp_path):
    record = report(tmp_path, "ablations")["ablations"]
    rows = tables(record)["ablations"]
    assert [row["without"] for row in rows] == [ablations.WHOLE, "no ARAP", ablations.LINEAR]
    assert rows[0]["change (dB)"] == 0 and rows[0]["seeds"] == rows[1]["seeds"] == 1
    assert rows[1]["change (dB)"] == pytest.approx(rows[1][ablations.JUDGED] - rows[0][ablations.JUDGED])
    assert len(record["words"]) == 1 + 2 + 1
    held, reaching = tables(record)["features"]
    assert held["novel (dB)"] != reaching["novel (dB)"]


def test_inference_without_its_teacher_is_skipped(tmp_path, monkeypatch):
    from f4x_core.errors import F4xError

    def absent(_):
        raise F4xError("no weights")

    monkeypatch.setattr(latent_studies, "require_ready", absent)
    record = report(tmp_path, "inference")["inference"]
    assert record["skipped"] == ["no weights"] and not record["tables"]


def test_clips_are_skipped_without_their_folder(tmp_path):
    context = dataclasses.replace(Context(tmp_path), clips=None)
    with pytest.raises(needs_studies.MissingError, match="--clips"):
        needs_studies.study_clips(context)
