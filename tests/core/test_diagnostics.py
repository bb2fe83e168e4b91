"""The diagnostics page and its words, on a made-up fit."""

import html
import re
from dataclasses import replace
from html.parser import HTMLParser
from pathlib import Path

import numpy as np
import pytest
import toy
from random_scene import random_scene

from f4x_core.clip.notes import Remark
from f4x_core.errors import F4xError
from f4x_core.fit.needs import Need
from f4x_core.fit.pipeline import FitResult
from f4x_core.report.advice import findings, quality, scaffold_coverage, track_survival, verdict
from f4x_core.report.diagnostics import ScenePreviews, render_previews, worst_frames, write_diagnostics
from f4x_core.report.finding import MOVES, PATH, SCORE, Finding, by_cause
from f4x_core.scaffold import Scaffold
from f4x_core.scene import Scene, StaticSet
from f4x_core.scene.moments import Moment


def node_scaffold(times: np.ndarray) -> Scaffold:
    """Four nodes that ride on the toy's square."""
    offsets = np.array([[-0.07, -0.07], [0.07, -0.07], [-0.07, 0.07], [0.07, 0.07]])
    xyz = np.zeros((len(times), 4, 3), np.float32)
    xyz[..., 2] = toy.SQUARE
    for row, time in enumerate(times):
        xyz[row, :, :2] = toy.centre(time) + offsets
    quat = np.zeros((len(times), 4, 4), np.float32)
    quat[..., 0] = 1
    certain = np.ones((len(times), 4), bool)
    certain[0, 0] = False
    near = np.stack([np.roll(np.arange(4), -k) for k in range(3)], -1)
    radius = np.full(4, 0.06, np.float32)
    return Scaffold(times, xyz, quat, radius, certain, np.arange(4), near, np.ones((4, 3), bool), 0.05)


def made_up(moving: bool = True):
    """A clip, a fit of it and its metrics."""
    clip, priors = toy.clip_and_priors(moving=moving, hold_out=4)
    priors.provenance = {"depth": {"provider": "synthetic", "seconds": 1.5}}
    rng = np.random.default_rng(0)
    turns, sizes = np.tile(np.float32([1, 0, 0, 0]), (50, 1)), np.full((50, 3), 0.01, np.float32)
    static = StaticSet(
        rng.uniform([-1, -0.5, 1], [1, 0.5, 1.4], (50, 3)).astype(np.float32),
        turns,
        sizes,
        np.full(50, 0.9, np.float32),
        rng.uniform(-1, 1, (50, 1, 3)).astype(np.float32),
        ids=np.arange(50),
    )
    cameras = priors.cameras.at_times(clip.times)
    history = [{"step": s, "loss": 1 / s, "psnr": 20 + s / 100, "gaussians": 50.0} for s in (100, 200, 300)]
    scene = Scene(
        name=clip.name,
        static=static,
        scaffold=node_scaffold(priors.cameras.times) if moving else None,
        cameras=cameras,
        needs=(Need("motion nodes", "4", "residual <b>0.001</b>", "396 nodes").row(),),
        provenance={"source": clip.source, "config": {"name": "quick"}, "priors": priors.provenance},
    )
    result = FitResult(scene, priors, history, {"priors": 2.0, "start": 0.5, "photometric": 9.0})
    rows = [{"frame": i, "held_out": bool(clip.held_out[i]), "psnr": 30.0 - i, "ssim": 0.9} for i in range(len(clip))]
    metrics = {"frames": rows, "used_psnr": 31.0, "held_out_psnr": 29.5, "held_out_psnr_flow_blend": 28.0}
    return clip, result, metrics


def made_up_moment(clip) -> Moment:
    """A moment whose pictures are the clip's frame."""
    rgb, flat = clip.frames[0] / 255, np.ones(clip.frames.shape[1:3])
    return Moment(0, rgb, flat, np.zeros((*flat.shape, 2)), rgb, rgb)


class Checker(HTMLParser):
    """Collects addresses and checks that tags nest."""

    def __init__(self):
        super().__init__()
        self.open: list[str] = []
        self.addresses: list[str] = []

    def handle_starttag(self, tag, attrs):
        self.addresses += [value for name, value in attrs if name in ("src", "href", "xlink:href")]
        if tag not in ("meta", "img", "br"):
            self.open.append(tag)

    def handle_startendtag(self, tag, attrs):
        self.addresses += [value for name, value in attrs if name in ("src", "href", "xlink:href")]

    def handle_endtag(self, tag):
        assert self.open.pop() == tag


@pytest.mark.parametrize("moving", [True, False])
def test_page_is_whole_and_self_contained(tmp_path: Path, moving: bool):
    clip, result, metrics = made_up(moving)
    frames = worst_frames(metrics, 2)
    assert frames == [7, 6]
    page = tmp_path / "diagnostics.html"
    worst = {frame: clip.frames[frame] / 255 for frame in frames}
    found = write_diagnostics(page, clip, result, metrics, ScenePreviews(worst, [made_up_moment(clip)]))
    text, message = page.read_text(), verdict(metrics, found)
    assert message.startswith(f"The scene is {quality(metrics, found)}: ") and f">{message}<" in text
    assert found and all(html.escape(finding.what) in text for finding in found)
    checker = Checker()
    checker.feed(text)
    assert checker.open == []
    assert all(address.startswith(("data:image/", "#")) for address in checker.addresses)
    assert not re.search(r"url\((?!#)", text)
    assert page.stat().st_size < 5e6
    assert "residual &lt;b&gt;0.001" in text  # nothing from outside becomes markup
    titles = re.findall(r"<h2>(.*?)</h2>", text)
    assert ("Motion scaffold" in "".join(titles)) == moving
    assert {"Scores", "Tracks", "Camera", "Time", "Provenance"} <= set(titles)
    assert titles[1] == "Geometry"  # right behind the findings
    assert "from the right" in text and "from above" in text
    assert ("group of moving nodes" in text) == moving


def test_the_page_tells_how_the_clip_was_read(tmp_path: Path):
    clip, result, metrics = made_up(True)
    odd = replace(clip, remarks=(Remark("Two frames <repeat> the one before.", "Give the file of the camera."),))
    found = write_diagnostics(tmp_path / "page.html", odd, result, metrics, ScenePreviews({}))
    assert any(one.weight == "note" and one.what == odd.remarks[0].what for one in found)
    text = (tmp_path / "page.html").read_text()
    assert "Two frames &lt;repeat&gt; the one before." in text and "Give the file of the camera." in text


def test_page_survives_missing_priors(tmp_path: Path):
    clip, result, _ = made_up()
    for name in ("depth", "depth_confidence", "motion", "mask", "tracks", "tracks_visible", "tracks_motion"):
        setattr(result.priors, name, None)
    bare = replace(result, scene=replace(result.scene, scaffold=None), history=[])
    found = write_diagnostics(tmp_path / "page.html", clip, bare, {}, ScenePreviews({}))
    assert (quality({}, found), verdict({}, found)) == ("", "The scene was not measured.")
    assert "The scene was not measured." in (tmp_path / "page.html").read_text()


def test_pictures_are_the_worst_frames_and_moments_of_used_ones():
    scene = random_scene()
    rows = [{"frame": i, "psnr": 30.0 - i} for i in range(len(scene.cameras))]
    pictures = render_previews(scene, {"frames": rows})
    assert list(pictures.worst) == [5, 4, 3, 2]
    indices = [moment.index for moment in pictures.moments]
    assert len(set(indices)) == 3 and not set(indices) & set(scene.held_out)


def test_page_that_cannot_be_written_is_one_error(tmp_path: Path):
    clip, result, metrics = made_up()
    with pytest.raises(F4xError, match="nowhere"):
        write_diagnostics(tmp_path / "nowhere" / "page.html", clip, result, metrics, ScenePreviews({}))


def test_survival_counts_only_tracks_that_could_get_old():
    visible = np.zeros((5, 4), bool)
    visible[:, 0] = True  # lives for the whole clip
    visible[[0, 2], 1] = True  # followed over a gap, lost after age 2
    visible[3:, 2] = True  # born late: cannot say anything about ages above 1
    np.testing.assert_allclose(track_survival(visible), [1, 1, 1, 0.5, 0.5])
    assert np.isnan(track_survival(np.zeros((3, 2), bool))).all()


def test_coverage_sees_missing_nodes():
    _, result, _ = made_up()
    whole = scaffold_coverage(result.priors, result.scene.scaffold)
    assert whole == 1.0
    away = replace(
        result.scene.scaffold,
        xyz=result.scene.scaffold.xyz + np.float32([0.12, 0, 0]),
        radius=result.scene.scaffold.radius / 3,
    )
    assert 0.05 < scaffold_coverage(result.priors, away) < 0.7


def judged(change=None, moving=True, scaffold=True, **options):
    """Findings on the made-up fit whose metrics are changed."""
    _, result, metrics = made_up(moving)
    return findings(result.priors, result.scene.scaffold if scaffold else None, metrics | (change or {}), **options)


def said(found, weight):
    return " ".join(finding.what for finding in found if finding.weight == weight)


def test_a_fine_scene_has_no_problem_in_its_scores():
    _, result, metrics = made_up()
    found = findings(result.priors, result.scene.scaffold, metrics)
    assert "1.5 dB better than blending" in said(found, "good")
    assert said(found, "problem").startswith("Only 6 frames")  # and nothing else
    assert sum(finding.weight == "problem" for finding in found) == 1
    assert "usable with limits: 29.5 dB on frames it never saw; one thing" in verdict(metrics, found)


def rows_of_a_mover(coverage, psnr):
    return [
        {"frame": 2 * i, "held_out": False, "psnr": 28.0, "mover_coverage": c, "psnr_mask": p}
        for i, (c, p) in enumerate(zip(coverage, psnr, strict=True))
    ]


@pytest.mark.parametrize(
    ("lost", "when"),
    [
        (range(6, 12), "From frame 12 on the moving object is missing: the scene covers 10%"),
        (range(4), "Until frame 6 the moving object"),
        (range(4, 7), "In frames 8 to 12 the moving object"),
    ],
)
def test_a_mover_that_gets_lost_is_named(lost, when):
    coverage, psnr = np.full(12, 0.9), np.full(12, 26.0)
    coverage[list(lost)], psnr[list(lost)] = 0.1, 18.0
    found = judged({"frames": rows_of_a_mover(coverage, psnr)})
    assert found[0].weight == "problem" and found[0].what.startswith(when)
    assert "18.0 dB (26.0 dB in the other frames)" in found[0].what and "--masks DIR" in found[0].advice


@pytest.mark.parametrize(
    ("coverage", "psnr"),
    [
        ([0.9] * 5 + [0.3] * 2 + [0.9] * 5, [26.0] * 5 + [18.0] * 2 + [26.0] * 5),  # two frames of blur
        ([0.9] * 6 + [0.3] * 6, [26.0] * 12),  # the mask is too large, the picture is right
        ([0.4] * 12, [20.0] * 12),  # never well covered: nothing to compare with
    ],
)
def test_a_mover_that_is_not_lost_is_not_named(coverage, psnr):
    found = judged({"frames": rows_of_a_mover(coverage, psnr)})
    assert "is missing" not in " ".join(finding.what for finding in found)


def test_registered_cameras_lead_the_scores():
    _, result, metrics = made_up()
    metrics |= {"held_out_psnr": 25.0, "held_out_psnr_registered": 30.0, "held_out_psnr_flow_blend_registered": 30.5}
    found = findings(result.priors, result.scene.scaffold, metrics)
    assert "usable with limits: 30.0 dB on frames it never saw" in verdict(metrics, found)
    assert "(30.5 dB) than the scene (30.0 dB)" in said(found, "problem") and "dB worse than" not in said(
        found, "problem"
    )
    assert "interpolated between used frames lose 5.0 dB" in said(found, "note")


@pytest.mark.parametrize(
    ("change", "words", "advice"),
    [
        ({"used_psnr": 24.0, "held_out_psnr": 23.0}, "24.0 dB (below 27)", "--profile wild"),
        ({"held_out_psnr": 26.0}, "5.0 dB worse", "--prior cameras=FILE"),
        ({"held_out_psnr_flow_blend": 30.5}, "blending the two neighbouring frames", "--profile wild"),
        ({"used_psnr_moving": 25.0, "used_psnr_static": 31.0}, "6.0 dB worse than what stands still", "--masks"),
        (
            {"held_out_psnr_moving_registered": 22.0, "held_out_psnr_static_registered": 29.0},
            "7.0 dB worse in unseen frames than",
            "--masks",
        ),
    ],
)
def test_scores_are_explained(change, words, advice):
    found = judged(change)
    chosen = [finding for finding in found if words in finding.what]
    assert len(chosen) == 1 and chosen[0].weight == "problem" and advice in chosen[0].advice


def test_findings_of_one_cause_are_one_with_the_advice_of_what_weighs_most():
    note, like = Finding("note", "Near.", "Walk.", cause=PATH), Finding("note", "Wide.", "Walk far.", cause=PATH)
    first, again, second = (
        Finding("problem", what, advice, cause=MOVES)
        for what, advice in (("Blurred.", "Give masks."), ("Blurred.", "Give masks."), ("Lost.", "Give tracks."))
    )
    other, alike = Finding("note", "Frame 3."), Finding("note", "Frame 7.")
    assert by_cause([note, like, first, other, again, second, alike]) == [
        Finding("problem", "Blurred. Lost.", "Give masks. Give tracks.", MOVES),
        Finding("note", "Near. Wide.", "Walk.", PATH),
        other,
        alike,
    ]


def test_that_pictures_are_poor_is_no_second_problem_where_one_says_why():
    poor, why = Finding("problem", "24 dB.", "Look.", cause=SCORE), Finding("problem", "It shook.")
    assert by_cause([poor]) == [poor] and "one thing" in verdict({"used_psnr": 24.0}, by_cause([poor]))
    assert by_cause([poor, why]) == [why, replace(poor, weight="note")]
    assert "; one thing holds it back" in verdict({"used_psnr": 24.0}, by_cause([poor, why]))


def test_a_fit_whose_mover_is_poor_has_one_problem_for_it(tmp_path: Path):
    """The score, the mover's own score and the frames where it is missing have one cause; a box for each stands in the page."""
    clip, result, metrics = made_up()
    rows = rows_of_a_mover([0.9] * 6 + [0.1] * 6, [26.0] * 6 + [18.0] * 6)
    rows = [row | {"frame": number % len(clip)} for number, row in enumerate(rows)]
    metrics |= {"used_psnr": 24.0, "used_psnr_moving": 18.0, "used_psnr_static": 27.0, "frames": rows}
    found = write_diagnostics(tmp_path / "page.html", clip, result, metrics, ScenePreviews({}))
    (moves,) = (one for one in found if one.cause == MOVES)
    assert "9.0 dB worse" in moves.what and "is missing" in moves.what
    text = (tmp_path / "page.html").read_text()
    first, _, rest = text.partition("<h3>Also worth knowing</h3>")
    problems = sum(one.weight == "problem" for one in found)
    assert problems == first.count('<div class="finding') == first.count('<div class="finding problem">')
    assert rest.count('<div class="finding') == len(found) - problems > 0 and 'class="finding problem"' not in rest
    assert len({one.cause for one in found if one.cause}) == sum(bool(one.cause) for one in found)


def test_a_long_fit_is_not_advised_to_be_long():
    change = {"used_psnr": 24.0, "held_out_psnr": 23.0, "held_out_psnr_flow_blend": 30.5}
    for profile, advised in (("quick", 2), ("wild", 0), ("nvidia", 0)):
        found = judged(change, profile=profile)
        assert sum("--profile wild" in finding.advice for finding in found) == advised


def test_the_page_knows_the_profile_of_its_fit(tmp_path: Path):
    clip, result, metrics = made_up()
    for profile in ("quick", "wild"):
        result.scene.provenance["config"]["name"] = profile
        write_diagnostics(tmp_path / "page.html", clip, result, metrics | {"used_psnr": 24.0}, ScenePreviews({}))
        assert ("--profile wild takes more steps" in (tmp_path / "page.html").read_text()) == (profile == "quick")


def test_priors_are_explained():
    _, result, metrics = made_up()
    priors = result.priors
    priors.camera_kind = "static"
    priors.depth_confidence = np.full_like(priors.depth_confidence, 0.1)
    priors.depth[:, :20] = np.nan
    priors.tracks_visible[3:] = False
    priors.warn("the focal length was guessed")
    found = findings(priors, result.scene.scaffold, metrics)
    problems = said(found, "problem")
    for words in ("The camera stood still", "50% of the pixels have no depth", "depth of the background is a guess"):
        assert words in problems
    assert "can be followed for 5 frames" in problems
    assert "the focal length was guessed" in said(found, "note")
    assert [finding.weight for finding in found] == sorted(
        (f.weight for f in found), key=["problem", "note", "good"].index
    )


def test_frames_that_stand_out_are_named():
    rows = [{"frame": i, "held_out": i == 7, "psnr": 30.0 - 10 * (i in (3, 7))} for i in range(8)]
    notes = said(judged({"frames": rows}), "note")
    assert "Frame 7 was held out at the clip's end" in notes
    assert "More than 4 dB below the median of 30.0 dB: frame 3." in notes


def test_a_held_out_frame_is_judged_by_its_registered_camera():
    rows = [{"frame": i, "held_out": False, "psnr": 30.0} for i in range(8)]
    rows[4] |= {"held_out": True, "psnr": 18.0, "psnr_registered": 29.0}
    rows[5] |= {"psnr": 26.5}
    assert "More than 4 dB below" not in said(judged({"frames": rows}), "note")
    assert worst_frames({"frames": rows}, 1) == [5]


def test_cameras_are_explained():
    _, result, metrics = made_up()
    result.priors.statistics["cameras"] = {"registered": 1, "reprojection_px": {"median": 2.5}}
    problems = said(findings(result.priors, result.scene.scaffold, metrics), "problem")
    assert "Only 1 of 6 frames found their camera" in problems and "by 2.5 px" in problems


def test_movers_that_are_not_there_or_not_followed_are_named():
    assert "Nothing was taken to move" in said(judged(moving=False), "note")
    assert "too little of them can be followed" in said(judged(scaffold=False), "problem")
