"""Long clips in windows: how they are cut, and that windows of a made-up clip go on from each other."""

import dataclasses
import html
import json
import re
import shutil
import tempfile
from itertools import pairwise
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
import torch
from PIL import Image
from scipy import sparse
from scipy.ndimage import binary_dilation, uniform_filter1d
from toy import clip_and_priors

from f4x_core.app.fit_options import FitOptions, FitRequest
from f4x_core.app.fitting import LongClip, copy_longest, fit_shots, survey_long
from f4x_core.cli.fitting import result_in_windows
from f4x_core.clip import read_clip, write_images
from f4x_core.clip.stream import ClipStream, Survey, survey
from f4x_core.errors import F4xError
from f4x_core.evaluation.evaluate import Figures, evaluate
from f4x_core.features.maps import FeatureMaps
from f4x_core.features.spec import FeatureSpec
from f4x_core.fit import budget, pipeline
from f4x_core.fit.budget import ClipSize
from f4x_core.fit.config import FitConfig, profile
from f4x_core.fit.distil import View, _Views, distil
from f4x_core.fit.distil_config import DistilConfig
from f4x_core.geometry import pose, quaternion
from f4x_core.priors.sizes import moving_masks
from f4x_core.report.finding import Finding
from f4x_core.scene import DynamicSet, Scene, StaticSet, read_scene
from f4x_core.scene.view import render
from f4x_core.windows import shots as windows
from f4x_core.windows import window
from f4x_core.windows.closing import FittedWindow, close_shot, closing_lines
from f4x_core.windows.plan import OVERLAP, plan_shots, plan_windows, usual_length, usual_overlap
from f4x_core.windows.previous_window import PreviousWindow
from f4x_core.windows.window import masks_of

pytestmark = pytest.mark.usefixtures("one_thread")


@pytest.mark.parametrize("frames", [3, 12, 60, 61, 100, 108, 109, 1000])
def test_windows_cover_a_clip_evenly(frames):
    plan = plan_windows(5, 5 + frames, 60)
    assert plan[0][0] == 5 and plan[-1][1] == 5 + frames
    lengths = {end - start for start, end in plan}
    assert max(lengths) <= 60 and max(lengths) - min(lengths) <= 1
    assert all(end - start == OVERLAP for (_, end), (start, _) in pairwise(plan))
    assert len(plan) == max(1, -(-(frames - OVERLAP) // (60 - OVERLAP)))


def test_windows_share_twelve_frames_or_as_many_as_short_ones_can_spare():
    assert [usual_overlap(length) for length in (60, 25, 24, 5)] == [12, 12, 11, 2]
    assert all(plan_windows(0, 100, length, usual_overlap(length)) for length in range(5, 80))
    with pytest.raises(F4xError, match="more than twice that"):
        plan_windows(0, 100, 4, usual_overlap(4))


@pytest.mark.parametrize(("length", "overlap"), [(24, 12), (60, 1), (60, 30), (-5, 12)])
def test_windows_without_frames_of_their_own_are_refused(length, overlap):
    with pytest.raises(F4xError, match="cannot share"):
        plan_windows(0, 100, length, overlap)


def test_cuts_come_before_windows():
    shots = plan_shots(200, (50, 51), 60, 12)
    assert [(shot.start, shot.end, len(shot.windows)) for shot in shots] == [(0, 50, 1), (51, 200, 3)]


def test_survey_reads_once_and_finds_the_cut(tmp_path):
    clip, _ = clip_and_priors(12)
    other = np.roll(255 - clip.frames[:6, :, ::-1], 11, 1)[..., ::-1]
    write_images(tmp_path / "images", [*clip.frames, *other])
    known = survey(tmp_path, "2:18:2")
    assert (known.first, known.step, known.count, known.cuts) == (2, 2, 8, (5,))
    assert known.part(3, 7) == "8:15:2"


def test_a_reel_is_the_clip_read_picture_by_picture(tmp_path):
    clip, _ = clip_and_priors(9)
    write_images(tmp_path / "images", clip.frames)
    wanted = read_clip(tmp_path, "2:9:3", 33)  # odd: rounded to 32
    reel = ClipStream(tmp_path, "2:9:3", wanted.width, wanted.height, len(wanted))
    for _ in range(2):
        assert np.array_equal(np.stack(list(reel.frames)), wanted.frames)
    for wrong in ({"count": 2}, {"count": 4}, {"height": 40}):
        with pytest.raises(F4xError, match=r"the clip has (at least )?\d frames of 32x20, wanted are"):
            list(dataclasses.replace(reel, **wrong))


def test_only_long_clips_are_cut_into_windows(tmp_path):
    clip, _ = clip_and_priors(9)
    write_images(tmp_path / "images", clip.frames)

    def windows(**options):
        request = FitRequest(tmp_path, tmp_path / "out", FitOptions(**options))
        return survey_long(request, request.window_size())

    assert windows() is None
    assert windows(window=0, overlap=90) is None
    shots = windows(window=5, overlap=2).shots
    assert shots[0].windows == ((0, 4), (2, 7), (5, 9))
    with pytest.raises(F4xError, match="--prior"):
        given = FitConfig(priors=dataclasses.replace(FitConfig().priors, files={"depth": "x"}))
        windows(window=5, overlap=2, config=given)


@pytest.mark.parametrize(
    ("frames", "gigabytes", "length"),
    [
        (360, 20, 0),
        (361, 20, 360),
        (300, 20, 0),
        (300, 3.5, 240),
        (240, 3.5, 0),
        (1000, 1.5, 60),
        (300, 0.1, 60),
        (50, 0.1, 0),
    ],
)
def test_windows_are_as_long_as_memory_allows(frames, gigabytes, length, monkeypatch):
    monkeypatch.setattr(budget, "machine_memory", lambda: 64.0)
    assert usual_length(ClipSize(frames, 480, 270), profile("quick"), gigabytes) == length


SHIFT, TURN = np.array([0.3, -0.2, 0.1]), np.pi / 7


def part(clip, priors, start, end, scale=1.0, turned=False):
    """Frames and true priors of a window, the priors in a world of their own when asked for."""
    rows = slice(start, end)
    clip = dataclasses.replace(
        clip, frames=clip.frames[rows], times=np.arange(end - start, dtype=float), held_out=clip.held_out[rows],
        picked=f"{start}:{end}:1",
    )  # fmt: skip
    path = priors.cameras
    cameras = dataclasses.replace(
        path, intrinsics=path.intrinsics[rows], world_to_camera=path.world_to_camera[rows], times=clip.times
    ).scaled_world(scale)
    if turned:
        world = np.eye(4)
        world[:2, :2] = [[np.cos(TURN), -np.sin(TURN)], [np.sin(TURN), np.cos(TURN)]]
        world[:3, 3] = SHIFT
        cameras = dataclasses.replace(cameras, world_to_camera=cameras.world_to_camera @ world)
    cut = {
        name: getattr(priors, name)[rows] for name in ("depth_confidence", "mask", "motion", "tracks", "tracks_visible")
    }
    pairs = {name: getattr(priors, name)[start : end - 1] for name in vars(priors) if name.startswith("flow_")}
    depth = priors.depth[rows] * np.float32(scale)
    frames = np.arange(end - start)
    return clip, dataclasses.replace(priors, cameras=cameras, depth=depth, frames=frames, **cut, **pairs)


@pytest.fixture(scope="module")
def shot(tmp_path_factory):
    """A toy clip of 16 frames fitted in three windows, the later ones' priors in worlds of their own."""
    patch = pytest.MonkeyPatch()
    folder = tmp_path_factory.mktemp("long")
    clip, priors = clip_and_priors(16)
    worlds = {0: (1.0, False), 5: (1.3, True), 10: (0.8, False)}
    config = dataclasses.replace(profile("quick"), steps=80, measure_every=80, checkpoint_every=80, threads=1)

    def read(start, end):
        return part(clip, priors, start, end)[0]

    def build(window, *_):
        start, end, _ = map(int, window.picked.split(":"))
        return part(clip, priors, start, end, *worlds[start])[1]

    patch.setattr(pipeline, "build_priors", build)
    patch.setattr(pipeline, "completed", None)  # no window is: a later one may see what it hides
    plan = windows.Shot(((0, 8), (5, 13), (10, 16)))
    results = windows.fit_long([plan], windows.LongFit(read, config, fit=window.fit_here), folder)
    yield SimpleNamespace(
        folder=folder, clip=clip, read=read, config=config, plan=plan, priors=priors, result=results[0]
    )
    patch.undo()


def test_windows_leave_what_moves_in_their_frames_for_the_colors_of_the_whole(shot, tmp_path):
    for number, (start, end) in enumerate(shot.plan.windows):
        kept, known = masks_of(shot.folder / "windows" / f"{number:03d}"), part(shot.clip, shot.priors, start, end)[1]
        masks = moving_masks(known, known.width, known.height)
        assert kept is not None and kept.keys() == masks.keys()
        assert all(np.array_equal(kept[frame], mask) for frame, mask in masks.items())
    assert masks_of(tmp_path) is None


def test_windows_join_into_one_scene(shot):
    scene, figures = read_scene(shot.folder / "scene.f4x"), shot.result.metrics
    assert len(scene.cameras) == 16 and scene.provenance["frames"] == "0:16:1"
    parts = [read_scene(shot.folder / "windows" / f"{number:03d}" / "scene.f4x") for number in range(3)]
    assert scene.provenance["believed_degrees"] == min(part.provenance["believed_degrees"] for part in parts)
    assert figures["used_psnr"] > 22
    assert figures["seam_psnr"] > figures["rest_psnr"] - 0.5, "seams are as good as the rest"
    frames = json.loads((shot.folder / "metrics.json").read_text())["frames"]
    assert [row["frame"] for row in frames] == list(range(16))
    assert not (shot.folder / "windows" / "001" / "priors").exists()


def test_every_window_and_the_whole_have_a_page(shot):
    whole = (shot.folder / "diagnostics.html").read_text()
    for number, (start, end) in enumerate(shot.plan.windows):
        place = f"windows/{number:03d}/diagnostics.html"
        assert f'<a href="{place}">{start} to {end - 1}</a>' in whole
        assert "Worst frames" in (shot.folder / place).read_text()
    first, second = (read_scene(shot.folder / "windows" / name / "scene.f4x") for name in ("000", "001"))
    own = np.setdiff1d(second.static.ids, first.static.ids)
    assert f'<td class="number">{len(own)}</td>' in whole and second.metrics["used_psnr"] > 22
    assert "shared by two windows" in whole


def test_the_joined_scene_closes_like_a_single_one(shot):
    """With the worst window's verdict, why each window is as it is, what it needed, its frames, its angle and its page."""
    parts = [read_scene(shot.folder / "windows" / f"{number:03d}" / "scene.f4x") for number in range(3)]
    whole, answer = (shot.folder / "diagnostics.html").read_text(), shot.result.metrics
    worst = min(range(3), key=lambda number: parts[number].metrics["used_psnr"])
    first, end = shot.plan.windows[worst]
    word = answer["quality"]
    assert word and {row["quality"] for row in answer["windows"]} == {word}  # so that the score alone decides
    assert answer["verdict"].startswith(f"The worst of 3 windows, frames {first} to {end - 1}, is {word}: ")
    assert f"{parts[worst].metrics['used_psnr']:.1f} dB" in answer["verdict"] and answer["verdict"] in whole
    lines = closing_lines(shot.folder, shot.result.needs, answer)
    assert lines[0].startswith("what the clip needed: windows 3; hidden background ")
    assert lines[-1] == f"{answer['verdict']} Why, and what you can supply: {shot.folder / 'diagnostics.html'}"
    kept = json.loads((shot.folder / "metrics.json").read_text())
    assert [row["frames"] for row in kept["windows"]] == ["0 to 7", "5 to 12", "10 to 15"]
    for part, row, line in zip(parts, kept["windows"], lines[1:-1], strict=True):
        assert row["needs"] == list(part.needs) and row["believed_degrees"] == part.provenance["believed_degrees"]
        assert line.startswith(f"The window of frames {row['frames']} is {word}: ")
        assert line.endswith(str(shot.folder / row["page"])) and (shot.folder / row["page"]).is_file()
        page = (shot.folder / row["page"]).read_text()
        assert row["findings"]
        for sentence in (html.escape(finding["what"]) for finding in row["findings"]):
            assert sentence in page and sentence in whole
        for need in part.needs:
            assert f"{need['what']} {need['chosen']}" in line and html.escape(need["chosen"]) in whole
        assert f"{row['believed_degrees']:.1f}°" in whole
    assert whole.count("<details open>") == 1 and "--prior needs --window 0" in whole
    assert "Views can be believed" in whole.partition("<h2>Geometry</h2>")[2]


def test_a_shot_of_one_window_is_told_as_one_scene(shot, tmp_path):
    (tmp_path / "windows").mkdir()
    shutil.copytree(shot.folder / "windows" / "000", tmp_path / "windows" / "000")
    scene = read_scene(tmp_path / "windows" / "000" / "scene.f4x")
    assert close_shot(tmp_path, scene, [(0, 8)], {"frames": []})["verdict"].startswith("The scene is ")


def test_the_worst_window_is_the_one_with_the_worst_word_then_score():
    def part(psnr, *weights):
        found = tuple(Finding(weight, "") for weight in weights)
        return FittedWindow("", "", {"used_psnr": psnr}, found, (), None, (0, 0, 0, 0))

    parts = [part(29.0, "note"), part(31.0, "problem"), part(30.0, "problem", "good"), part(28.0)]
    assert sorted(parts, key=lambda part: part.rank) == [parts[2], parts[1], parts[3], parts[0]]
    assert part(20.0).rank < parts[2].rank


def test_later_worlds_are_the_first_one(shot):
    """The camera slides 0.02 a frame in the first window's unit and goes on so, whatever the unit of later priors."""
    centers = read_scene(shot.folder / "scene.f4x").cameras.centers
    assert np.allclose(np.diff(centers[:, 0]), 0.02, atol=0.008)
    assert np.allclose(centers[:, 1:], 0, atol=0.02)


def test_later_windows_keep_the_background_and_add_little(shot):
    first, second = (read_scene(shot.folder / "windows" / name / "scene.f4x") for name in ("000", "001"))
    kept = np.isin(first.static.ids, second.static.ids)
    assert kept.mean() > 0.6
    rows = np.searchsorted(second.static.ids, first.static.ids[kept])
    assert np.array_equal(second.static.means[rows], first.static.means[kept]), "what is taken over is never changed"
    assert second.dynamic.ids.min() > first.dynamic.ids.max()


def test_the_mover_goes_on(shot):
    scene = read_scene(shot.folder / "scene.f4x")

    def place(time):
        posed = scene.posed(time)
        weight = posed.opacities * posed.dynamic
        return weight @ posed.means / weight.sum()

    path = np.stack([place(t) for t in range(16)])
    assert np.allclose(np.diff(path[:, 0]), 0.03, atol=0.02), "0.03 a frame, without a jump where windows meet"
    assert np.abs(path[:, 2] - 0.9).max() < 0.1


def test_what_no_window_shows_is_made_up_in_the_whole_alone(shot, monkeypatch):
    given = []
    monkeypatch.setattr(windows, "completed", lambda scene: given.append(scene) or scene)
    whole = windows.fit_shot(shot.plan, windows.LongFit(shot.read, shot.config, True, None), shot.folder)
    assert [each.static for each in given] == [whole.static]
    assert [need["what"] for need in whole.needs] == ["windows", "colors over time"]


def test_finished_windows_are_kept(shot):
    before = [path.read_bytes() for path in sorted(shot.folder.glob("windows/*/scene.f4x"))]
    windows.fit_shot(
        shot.plan, windows.LongFit(shot.read, shot.config, True, None), shot.folder
    )  # nothing is fitted again
    assert before == [path.read_bytes() for path in sorted(shot.folder.glob("windows/*/scene.f4x"))]
    with pytest.raises(F4xError, match="other settings"):
        other = windows.LongFit(shot.read, dataclasses.replace(shot.config, seed=1), resume=True)
        windows.fit_shot(shot.plan, other, shot.folder)


def test_a_folder_of_several_shots_leads_to_them(shot, tmp_path, monkeypatch, capsys):
    scene = read_scene(shot.folder / "scene.f4x")

    def fit_shot(plan, how, folder, progress):
        progress("photometric", 0, 1, "window 1 of 2")
        folder.mkdir()
        return dataclasses.replace(scene, provenance={"frames": known.part(plan.start, plan.end)})

    monkeypatch.setattr(windows, "fit_shot", fit_shot)
    monkeypatch.setattr(windows, "evaluate_shot", lambda _, plan, *more: {"frames": [], "used_psnr": 20.0 + plan.start})

    def close(folder, *_):
        (folder / "diagnostics.html").touch()
        return {"quality": "poor", "verdict": f"{folder.name} is poor.", "windows": []}

    monkeypatch.setattr(windows, "close_shot", close)
    write_images(tmp_path / "clip" / "images", np.zeros((27, 16, 24, 3), np.uint8))
    request = FitRequest(tmp_path / "clip", tmp_path)
    known = Survey(10, 2, 9, (3,))
    long_clip = LongClip(known, plan_shots(9, (3,), 60))
    fitted = fit_shots(request, long_clip, shot.config, lambda *answer: print(*answer))
    copy_longest(fitted)
    result = result_in_windows(fitted)
    assert capsys.readouterr().out.splitlines()[1] == "photometric 0 1 shot 2 of 2, window 1 of 2"
    assert "frames 10:15:2 of the source" in (tmp_path / "diagnostics.html").read_text()
    links = re.findall('href="(.*?)"', (tmp_path / "diagnostics.html").read_text())
    assert links == ["shot_1/diagnostics.html", "shot_2/diagnostics.html"]
    assert all((tmp_path / link).is_file() for link in links)
    assert json.loads((tmp_path / "metrics.json").read_text())["used_psnr"] == 23
    assert result["note"].startswith("2 shots;") and result["note"].endswith("the longest, --frames 16:27:2")
    assert result["text"].endswith(result["note"]) and result["quality"] == "poor"
    assert "shot_1 is poor. Why" in result["text"] and "shot_2 is poor." in (tmp_path / "diagnostics.html").read_text()
    assert (result["frames"], *Image.open(tmp_path / "input.jpg").size) == (6, 24, 16)


def test_windows_that_share_no_used_frame_are_refused():
    _, priors = clip_and_priors(8)
    scene = Scene("toy", StaticSet.empty(), priors.cameras)
    with pytest.raises(F4xError, match="overlap"):
        PreviousWindow(scene, 8, 0).place(priors)


def test_what_moves_is_not_placed_behind_the_ground_around_it(shot):
    """The earlier window may have guessed that it is far away; then it would be hidden in the later one."""
    _, priors = clip_and_priors(8)
    far = read_scene(shot.folder / "windows" / "000" / "scene.f4x")
    far = dataclasses.replace(
        far, dynamic=DynamicSet.empty(), scaffold=None
    )  # the wall is seen where the square should be
    assert priors.depth is not None and priors.mask is not None
    for depth, mask in zip(priors.depth, priors.mask, strict=True):
        depth[binary_dilation(mask, iterations=3) & ~mask] = (
            1.0  # ground around it, the square is at 0.9, the wall at 1.2
        )
    placed = PreviousWindow(far, 0, 0).place(priors, "torch")
    square, ground = placed.depth[priors.mask], placed.depth[priors.depth == 1.0]
    assert 0.98 * ground.min() < square.max() <= 1.01 * ground.min()


def test_background_that_turned_wrong_leaves(shot):
    """A ghost in front of the wall, seen by no later picture, leaves; what is right stays."""
    clip, priors = clip_and_priors(8, moving=False)
    scene = read_scene(shot.folder / "windows" / "000" / "scene.f4x")
    ghost = scene.static.take(np.arange(1))
    ghost = dataclasses.replace(
        ghost,
        ids=ghost.ids + 10_000,
        means=np.float32([[0.05, 0.0, 0.6]]),
        scales=np.full((1, 3), 0.06, np.float32),
        opacities=np.ones(1, np.float32),
        sh=np.full_like(ghost.sh, 3.0),
    )
    arrays = {
        name: np.concatenate([getattr(scene.static, name), getattr(ghost, name)])
        for name in vars(ghost)
        if name != "span"
    }
    haunted = dataclasses.replace(scene, static=StaticSet(**arrays))
    found = PreviousWindow(haunted, 0, 0).background(clip, priors, np.arange(0, 8, 2), 2, "torch")
    assert 10_000 + scene.static.ids[0] not in found.world.ids
    assert len(found.world) > 0.6 * len(scene.static)
    assert np.mean([shown.mean() for shown in found.explained.values()]) > 0.5


def test_a_shaken_picture_is_no_reason_for_new_background(shot):
    clip, priors = part(shot.clip, clip_and_priors(16)[1], 5, 13)
    scene = read_scene(shot.folder / "windows" / "000" / "scene.f4x")
    rows = np.arange(0, 3)  # the later ones see ground that the scene has not

    def unexplained(pictures):
        found = PreviousWindow(scene, 5, 0).background(dataclasses.replace(clip, frames=pictures), priors, rows, 2)
        return 1 - np.concatenate([shown[~priors.mask[row]] for row, shown in found.explained.items()]).mean()

    shaken = uniform_filter1d(clip.frames, 11, 2)
    assert np.abs(shaken[rows].astype(float) - clip.frames[rows]).mean() > 10
    assert unexplained(shaken) < unexplained(clip.frames) + 0.05
    changed = clip.frames.copy()
    changed[:, 20:32, 40:56] = 255 - changed[:, 20:32, 40:56] // 4
    assert unexplained(changed) > unexplained(clip.frames) + 0.04, "something new is one"


@pytest.mark.slow
def test_to_and_fro_needs_no_more_background(tmp_path, monkeypatch):
    """Windows that see again what the first one saw, from cameras that drift, add next to nothing."""
    clip, priors = clip_and_priors(8)
    order = np.abs(np.arange(28) % 14 - 7)  # 7 6 … 0 1 … 7 6 …
    path = priors.cameras
    drift = 0.006 * np.arange(8)

    def read(start, end):
        rows = order[start:end]
        count = len(rows)
        frames = np.arange(count)
        return dataclasses.replace(
            clip, frames=clip.frames[rows], times=frames.astype(float), held_out=np.zeros(count, bool),
            picked=f"{start}:{end}:1",
        )  # fmt: skip

    def build(window, *_):
        start, end, _ = map(int, window.picked.split(":"))
        rows = order[start:end]
        views = path.world_to_camera[rows].copy()
        for frame in range(len(rows) if start else 0):
            turn = quaternion.from_rotation_vector(np.array([0.0, drift[frame], 0.0]))
            views[frame] = pose.to_matrix(turn, np.zeros(3)) @ views[frame]
        answer = ("depth", "depth_confidence", "mask", "motion", "tracks", "tracks_visible")
        flows = {name: getattr(priors, name)[: len(rows) - 1] for name in vars(priors) if name.startswith("flow_")}
        cameras = dataclasses.replace(path, intrinsics=path.intrinsics[rows], world_to_camera=views, times=window.times)
        cut = {name: getattr(priors, name)[rows] for name in answer}
        return dataclasses.replace(priors, cameras=cameras, frames=np.arange(len(rows)), **cut, **flows)

    monkeypatch.setattr(pipeline, "build_priors", build)
    config = dataclasses.replace(profile("quick"), steps=120, measure_every=120, checkpoint_every=120, threads=1)
    plan = windows.Shot(tuple((start, start + 8) for start in range(0, 21, 5)))
    windows.fit_long([plan], windows.LongFit(read, config, fit=window.fit_here), tmp_path)
    parts = [read_scene(tmp_path / "windows" / f"{number:03d}" / "scene.f4x") for number in range(5)]
    own = [part.provenance["window"]["own"] for part in parts]
    assert own[0] > 300 and sum(own[1:]) < 0.05 * own[0], own
    assert min(part.metrics["used_psnr"] for part in parts) > parts[0].metrics["used_psnr"] - 1


def test_drifting_cameras_are_registered_to_the_background(shot):
    """Cameras that turn away a little more with every frame are brought back to where the background is seen."""
    clip, priors = part(shot.clip, clip_and_priors(16)[1], 5, 13)
    scene = read_scene(shot.folder / "windows" / "000" / "scene.f4x")
    earlier = PreviousWindow(scene, 5, 0)
    drifted = priors.cameras.world_to_camera.copy()
    for frame in range(3, 8):  # the first three are shared
        turn = quaternion.from_rotation_vector(np.array([0.0, 0.008 * (frame - 2), 0.0]))
        drifted[frame] = pose.to_matrix(turn, np.zeros(3)) @ drifted[frame]
    lost = dataclasses.replace(priors, cameras=dataclasses.replace(priors.cameras, world_to_camera=drifted))
    found = earlier.track(clip, lost, 2, "torch")

    def off(path):
        """Pixels by which points of the wall are seen in a wrong place, by frame."""
        points = np.stack(np.meshgrid([-0.2, 0.0, 0.2], [-0.1, 0.1], [1.5]), -1)
        seen, wanted = (np.stack([p[i].project(points)[0] for i in range(8)]) for p in (path, priors.cameras))
        return np.linalg.norm(seen - wanted, axis=-1).max((1, 2, 3))

    assert off(lost.cameras)[-1] > 2
    assert off(found.cameras).max() < 0.7
    still = ~priors.mask
    assert np.allclose(found.depth[still], priors.depth[still], rtol=0.1)
    assert np.array_equal(found.depth[priors.mask], priors.depth[priors.mask])
    standing = dataclasses.replace(lost, camera_kind="static")
    one_place = dataclasses.replace(
        scene.cameras, world_to_camera=np.repeat(scene.cameras.world_to_camera[-1:], len(scene.cameras), 0)
    )
    earlier = dataclasses.replace(earlier, scene=dataclasses.replace(scene, cameras=one_place))
    kept = earlier.track(clip, standing, 2, "torch").cameras.world_to_camera
    step = drifted[-1] @ np.linalg.inv(drifted[-2])
    assert np.allclose(kept[-1] @ np.linalg.inv(kept[-2]), step), "a camera that cannot move is not moved"


def test_features_of_the_joined_scene_answer_one_question_over_its_whole_length(shot):
    """What was learnt of the mover finds it in the first window, where windows meet, and in the last one, and nothing else."""
    scene = read_scene(shot.folder / "scene.f4x")
    _, priors = clip_and_priors(16)
    share = priors.mask.reshape(16, 10, 4, 16, 4).mean((2, 4))[..., None]  # (T,10,16,1)
    mover, wall = np.float32([1, 0, 0.5, 0.2]), np.float32([0, 1, 0.5, -0.2])
    spec = FeatureSpec("thing", 4, (10, 16), "area")
    maps = FeatureMaps(Path("thing"), spec, (share * mover + (1 - share) * wall).astype(np.float16))
    scene = distil(scene, [maps], DistilConfig(width=8, steps=120, threads=1))
    features = scene.features.heads[0](scene.latents())
    found = (features @ (mover - wall) > 0).astype(np.float32)[:, None]
    for frame in (0, 6, 11, 15):
        shown = render(scene, scene.cameras[frame], frame, ("alpha",), values={"found": found})["found"][..., 0] > 0.5
        truth = priors.mask[frame]
        assert (shown & truth).sum() > 0.75 * (shown | truth).sum(), f"frame {frame}"


def test_what_frames_see_comes_back_from_the_disk():
    rng = np.random.default_rng(0)
    mixes = [sparse.random(6, 50, 0.2, "csr", np.float32, rng) for _ in range(3)]
    alphas = torch.from_numpy(rng.random((3, 2, 3)).astype(np.float32))
    with tempfile.TemporaryFile() as file:
        views = _Views(file)
        for part in ([0], [1, 2]):
            views.take(View(10 + i, mixes[i], alphas[i]) for i in part)
        for i in (2, 0, 1):
            view = views[i]
            assert view.frame == 10 + i and torch.equal(view.alpha, alphas[i])
            assert (view.mix != mixes[i]).nnz == 0 and view.mix.shape == (6, 50)
        assert [view.frame for view in views] == [10, 11, 12]


def test_measuring_a_window_needs_no_background_out_of_view(shot):
    """Figures are the same without it, held-out frames' with their registered cameras too."""
    scene = dataclasses.replace(read_scene(shot.folder / "windows" / "000" / "scene.f4x"), held_out=(3,))
    clip = dataclasses.replace(shot.read(0, 8), held_out=np.arange(8) == 3)
    beyond = scene.static.arrays() | {
        "ids": scene.static.ids + 10_000,
        "means": scene.static.means + np.float32([9, 0, 0]),
    }
    arrays = {name: np.concatenate([array, beyond[name]]) for name, array in scene.static.arrays().items()}
    more = dataclasses.replace(scene, static=StaticSet(**arrays))
    near = window.near_path(more)
    assert np.isin(near.static.ids, scene.static.ids).all() and len(near.static) > 0.9 * len(scene.static)
    figures = [evaluate(each, clip, Figures(baselines=True)) for each in (more, near)]
    assert figures[0] == figures[1] and figures[0]["held_out_registered"] == 1
