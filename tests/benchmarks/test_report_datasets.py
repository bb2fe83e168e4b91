"""The field's data sets: test cameras are the true ones, masked figures ignore what is masked, studies run end to end."""

import math
from dataclasses import replace

import cv2
import numpy as np
import pytest
from data_sets import HIDDEN, UNIT, keypoints, toy, write_dycheck, write_nerfies, write_nvidia
from scipy.signal import convolve2d

from benchmarks.quality.image_metrics import masked_psnr, masked_ssim, psnr_bytes, score_confusion, ssim_bytes
from benchmarks.studies import datasets, protocols
from benchmarks.studies.novel import measured_width, read_keypoints, read_novel_cameras
from benchmarks.studies.protocols import (
    DYCHECK,
    NERFIES,
    NVIDIA,
    match_cameras,
    place_cameras,
    score_render,
    score_views,
)
from benchmarks.studies.supplement import FOLLOWED, LABELLED, VIEWS
from benchmarks.studies.toy_fits import shorten
from benchmarks.study import Context, MissingError
from f4x_core.clip import read_clip
from f4x_core.clip.images import as_bytes
from f4x_core.errors import F4xError
from f4x_core.scene.view import render

SCENES = {"nvidia/Balloon1": [12], "dycheck/paper-windmill": [6, 5], "nerfies/tail": [12]}
"""Scene -> views of each other camera."""


@pytest.fixture(scope="module")
def world():
    return toy()


@pytest.fixture(scope="module")
def data(world, tmp_path_factory):
    folder = tmp_path_factory.mktemp("data")
    for write in (write_nvidia, write_dycheck, write_nerfies):
        write(folder, world)
    return folder


# --- files -----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("scene", SCENES)
def test_the_true_scene_seen_by_the_test_cameras_gives_the_test_pictures(scene, data, world):
    clip = read_clip(data / scene)
    cameras = read_novel_cameras(clip)
    assert len(clip) == world.frames and [len(camera.path) for camera in cameras] == SCENES[scene]
    for path, frames in [(clip.cameras, clip.frames), *((camera.path, camera.frames) for camera in cameras)]:
        path = path.scaled_world(1 / UNIT)
        for index, time in enumerate(path.times):
            drawn = as_bytes(world.view(path[index], time).rgb)
            assert psnr_bytes(drawn, frames[index]) > 45
            assert psnr_bytes(drawn, frames[index - 1]) < 35  # neither another time nor another camera


def test_test_views_go_along_with_the_frames_and_size_of_the_clip(data, world):
    clip = read_clip(data / "dycheck/paper-windmill", "2:11:3", width=32)
    one, two = read_novel_cameras(clip)  # frames 2, 5, 8: camera 1 has the odd ones, camera 2 the even ones
    assert one.path.times.tolist() == [1] and two.path.times.tolist() == [0, 2]
    assert one.frames.shape == (1, 18, 32, 3) and one.path.width == 32
    assert one.seen.shape == (1, 18, 32) and (~one.seen).sum() == 18 * HIDDEN // 3


def test_each_data_set_tells_at_which_width_it_is_measured(data, world):
    assert measured_width(data / "nvidia/Balloon1") == world.width
    assert measured_width(data / "dycheck/paper-windmill") == world.width  # cameras of twice the size, factor 2
    assert measured_width(data / "nerfies/tail", 8) == world.width // 2


def test_undistorted_pictures_do_not_count_where_the_lens_saw_nothing(tmp_path):
    world = toy(64, 4)
    clip = read_clip(write_nerfies(tmp_path, world, radial=(0.4, 0.0, 0.0)))
    (camera,) = read_novel_cameras(clip)
    black = (camera.frames == 0).all(-1)
    assert not camera.seen[:, 0, 0].any() and camera.seen[:, 18, 32].all() and black.any()
    assert not (black & camera.seen).any()


def test_keypoints_come_in_pixels_of_the_clip_and_follow_the_true_tracks(data, world):
    clip = read_clip(data / "dycheck/paper-windmill")
    found, truth = read_keypoints(clip), keypoints(world)
    assert sorted(found) == sorted(truth)
    for frame, points in truth.items():
        np.testing.assert_allclose(found[frame], points, atol=1e-9)
    half = read_keypoints(read_clip(data / "dycheck/paper-windmill", "3:12", width=32))
    np.testing.assert_allclose(half[0][:, 0], truth[3][:, 0] / 3)
    assert read_keypoints(read_clip(data / "nvidia/Balloon1")) == {}


def test_broken_data_sets_are_told_in_one_sentence(tmp_path):
    world = toy(32, 4)
    folder = write_nvidia(tmp_path, world)
    stray = tmp_path / "nvidia/gt/Balloon1/v000_t009.png"
    stray.write_bytes((stray.parent / "v000_t000.png").read_bytes())
    with pytest.raises(F4xError, match="view or time that the 4 pictures lack"):
        read_novel_cameras(read_clip(folder))
    folder = write_dycheck(tmp_path, world)
    (folder / "keypoint/2x/train/0_00000.json").write_text("[1, 2]")
    with pytest.raises(F4xError, match="x, y, visible"):
        read_keypoints(read_clip(folder))
    (folder / "rgb/2x/1_00001.png").unlink()
    with pytest.raises(F4xError, match="lacks the frame 1_00001"):
        read_novel_cameras(read_clip(folder))


# --- figures ---------------------------------------------------------------------------------------------------------


def pair(seed, noise):
    rng = np.random.default_rng(seed)
    y, x = np.mgrid[:40, :56]
    wave = np.sin(x / 5.0 + seed) * np.cos(y / 7.0)
    base = 128 + 90 * wave[..., None] * np.array([1, 0.7, 0.4])
    first = np.clip(base + rng.normal(0, 5, base.shape), 0, 255).astype(np.uint8)
    return first, np.clip(base + rng.normal(0, noise, base.shape), 0, 255).astype(np.uint8)


@pytest.mark.parametrize(
    ("seed", "noise", "ssim"), [(0, 3, 0.9067890743597379), (1, 15, 0.6061531819005124), (2, 60, 0.12789731501548396)]
)
def test_figures_of_bytes_are_those_of_opencv_and_scikit_image(seed, noise, ssim):
    """Numbers of scikit-image 0.26 on the same pictures."""
    first, second = pair(seed, noise)
    assert ssim_bytes(first, second) == pytest.approx(ssim, abs=1e-12)
    assert psnr_bytes(first, second) == pytest.approx(cv2.PSNR(first, second), abs=1e-9)
    assert ssim_bytes(first, first) == 1 and psnr_bytes(first, first) == math.inf


def partial_ssim(first, second, mask):
    """DyCheck's masked SSIM written out as its definition has it: one convolution after the other."""
    offsets = np.arange(11) - 5
    kernel = np.exp(-0.5 * (offsets / 1.5) ** 2)
    kernel /= kernel.sum()

    def blur(values):
        weight = mask.astype(float)
        for shape in ((1, 11), (11, 1)):
            count = convolve2d(weight, np.ones(shape), "valid")
            summed = convolve2d(values * weight, kernel.reshape(shape), "valid")
            values = np.divide(summed * 11, count, out=np.zeros_like(summed), where=count > 0.5)
            weight = (count > 0.5).astype(float)
        return values

    found = []
    for x, y in zip(np.moveaxis(first, -1, 0), np.moveaxis(second, -1, 0), strict=True):
        mx, my = blur(x), blur(y)
        vx, vy = np.maximum(blur(x * x) - mx * mx, 0), np.maximum(blur(y * y) - my * my, 0)
        cov = blur(x * y) - mx * my
        cov = np.sign(cov) * np.minimum(np.sqrt(vx * vy), np.abs(cov))
        found.append((2 * mx * my + 1e-4) * (2 * cov + 9e-4) / ((mx**2 + my**2 + 1e-4) * (vx + vy + 9e-4)))
    return float(np.mean(found))


def test_masked_figures_are_dychecks_and_ignore_what_is_masked():
    first, second = (picture / 255.0 for picture in pair(3, 20))
    mask = np.random.default_rng(0).random(first.shape[:2]) > 0.3
    mask[:, :20] = False
    assert masked_ssim(first, second, mask) == pytest.approx(partial_ssim(first, second, mask), abs=1e-12)
    before = masked_psnr(first, second, mask), masked_ssim(first, second, mask)
    assert before[0] == pytest.approx(-10 * math.log10(((first - second)[mask] ** 2).mean()))
    other = np.where(mask[..., None], first, 0.5)
    assert (masked_psnr(other, second, mask), masked_ssim(other, second, mask)) == before
    seen = np.where(mask[..., None], 0.5, first)
    assert masked_psnr(seen, second, mask) < before[0] and masked_ssim(seen, second, mask) < before[1]
    assert math.isnan(masked_psnr(first, second, np.zeros_like(mask)))


def test_a_view_is_scored_over_its_co_visible_pixels_alone(data):
    (camera, _) = read_novel_cameras(read_clip(data / "dycheck/paper-windmill"))
    wrong = camera.frames[0].copy()
    wrong[:, :HIDDEN] = 0
    assert score_render(wrong, camera, 0, masked=True)["mPSNR (dB)"] == math.inf
    assert score_render(wrong, camera, 0, masked=False)["PSNR (dB)"] < 30


def test_confusion_counts_labels_that_are_true_or_found():
    confusion = np.array([[3, 1, 0], [0, 4, 0], [0, 0, 0]])
    assert score_confusion(confusion) == pytest.approx(((3 / 4 + 4 / 5) / 2, 7 / 8))


# --- the supplement's own numbers ------------------------------------------------------------------------------------


def test_published_rows_agree_with_the_sums_and_means_that_are_printed_beside_them():
    for row in VIEWS:
        assert row["static (MB)"] + row["dynamic (MB)"] == pytest.approx(row["size (MB)"], abs=0.006)
    for method in {row["method"] for row in VIEWS}:
        *rows, mean = (row for row in VIEWS if row["method"] == method)
        assert len(rows) == 7 and mean["scene"] == "mean"
        for column in ("PSNR (dB)", "SSIM", "LPIPS", "accuracy", "mIoU", "static (MB)", "dynamic (MB)"):
            if mean[column] is not None:
                assert np.mean([row[column] for row in rows]) == pytest.approx(mean[column], abs=0.001)
    for way in ("pictures", "features"):
        *rows, mean = (row for row in LABELLED if row["from"] == way)
        for column, near in (("mIoU", 0.001), ("accuracy", 0.001), ("time (s)", 0.006)):
            assert np.mean([row[column] for row in rows]) == pytest.approx(mean[column], abs=near)
    experiments = {"NVIDIA": [(0.656, 0.246, 0.467), (0.761, 0.728, 0.727)]}
    experiments["Nerfies"] = [(0.484, 0.536, 0.538), (0.560, 0.662, 0.561)]
    for row in FOLLOWED:
        three = experiments[row["data"]][("pictures", "features").index(row["from"])]
        assert row["mIoU"] == pytest.approx(np.mean(three), abs=0.0006)


# --- studies ---------------------------------------------------------------------------------------------------------


def test_without_data_each_study_is_skipped_with_one_sentence(tmp_path):
    for study in (datasets.study_nvidia, datasets.study_dycheck, datasets.study_nerfies):
        for place in (None, tmp_path):
            with pytest.raises(MissingError, match=r"docs/datasets\.md"):
                study(Context(tmp_path, data=place))


@pytest.fixture
def short(monkeypatch):
    """Fits of a few steps with the data sets' cameras."""
    whole = protocols.fit_config
    for module in (protocols, datasets):
        monkeypatch.setattr(module, "fit_config", lambda context, name: shorten(whole(context, name), 12))
    monkeypatch.setattr(protocols, "QUICK_WIDTH", 96)
    brief = {"first": replace(NVIDIA.first, steps=3, hold=1), "others": replace(NVIDIA.first, steps=2, hold=1)}
    for name, protocol in (("NVIDIA", NVIDIA), ("DYCHECK", DYCHECK), ("NERFIES", NERFIES)):
        monkeypatch.setattr(datasets, name, replace(protocol, known_cameras=True, **brief))


@pytest.mark.slow
def test_test_cameras_are_placed_by_the_fit_and_matching_takes_out_a_shift(tmp_path, data, short):
    """The fitted scene's own picture is the target: a camera put aside comes back to where it was drawn from."""
    context = Context(tmp_path, quick=True, data=data, threads=1)
    clip = read_clip(data / "nvidia/Balloon1")
    scene, _ = protocols.fit_scene(context, clip, protocols.fit_config(context, "quick"), known_cameras=True)
    (novel,) = read_novel_cameras(clip)
    placed = place_cameras(scene, clip, novel)[:3]
    for camera in placed:  # it took a frame of the clip, so it is where the fit put that frame
        np.testing.assert_array_equal(camera.world_to_camera, scene.cameras[0].world_to_camera)
    nudged = novel.path.world_to_camera + np.eye(4)[:, 3:] * [0, 0, 0, 1e-9]
    other = replace(novel, path=replace(novel.path, world_to_camera=nudged))
    apart = np.linalg.norm(place_cameras(scene, clip, other)[0].center - placed[0].center)
    assert 0 < apart < 0.02  # of a median depth: laid over the fitted cameras, as those that took no frame
    drawn = [
        as_bytes(render(scene, c, float(t), ("rgb",))["rgb"]) for c, t in zip(placed, novel.path.times, strict=False)
    ]
    own = replace(novel, path=novel.path.at_times(novel.path.times[:3]), frames=np.stack(drawn))
    shift = np.eye(4)
    shift[0, 3] = 0.01
    aside = [replace(camera, world_to_camera=shift @ camera.world_to_camera) for camera in placed]
    off = score_views(scene, own, aside, masked=False)["PSNR (dB)"]
    steps = replace(DYCHECK.first, steps=80, rate=1e-3, last_rate=1e-5)
    matched = match_cameras(scene, own, aside, replace(DYCHECK, first=steps, others=replace(steps, steps=3, rate=1e-5)))
    assert score_views(scene, own, matched, masked=False)["PSNR (dB)"] > off + 10
    assert np.linalg.norm(matched[-1].center - placed[-1].center) < 0.006  # a turn stands in for a part of the shift


@pytest.mark.parametrize(
    "name", ["dycheck", *(pytest.param(name, marks=pytest.mark.slow) for name in ("nvidia", "nerfies"))]
)
def test_each_study_runs_end_to_end_and_again_from_its_steps(name, tmp_path, data, short):
    study = getattr(datasets, f"study_{name}")
    context = Context(tmp_path, quick=True, data=data, threads=1)
    found = study(context)
    (table,) = found.tables
    assert not found.failed and table.name == "views" and table.rows[0]["source"] == "here"
    assert all(isinstance(row.get(column, 0.0), (int, float)) for row in table.rows for column in table.timed)
    assert study(context) == found
    if name == "nvidia":
        assert any(row["source"] == "Feature4X" for row in table.rows) and "published" in found.words[0]
    if name == "dycheck":
        assert table.rows[0]["PCK@5%"] > 0.5 and table.rows[0]["views"] == 11 and "mPSNR (dB)" in table.rows[0]


@pytest.mark.slow
def test_a_scene_that_cannot_be_read_costs_no_other(tmp_path, world, short):
    write_dycheck(tmp_path, world, "apple")
    (write_dycheck(tmp_path, world, "block") / "camera/0_00000.json").write_text("{}")
    context = Context(tmp_path / "out", data=tmp_path, threads=1, quick=True)
    folders = sorted((tmp_path / "dycheck").iterdir())
    rows, failed = datasets._measure(context, datasets.DYCHECK, folders)
    assert [row["scene"] for row in rows] == ["apple"] and "block" in failed[0]


def test_a_data_set_of_which_no_scene_can_be_read_says_nothing_and_fails(tmp_path):
    (write_dycheck(tmp_path, toy(32, 4), "block") / "camera/0_00000.json").write_text("{}")
    found = datasets.study_dycheck(Context(tmp_path / "out", data=tmp_path, threads=1, quick=True))
    assert found.words == [] and found.tables[0].rows == [] and "block" in found.failed[0]
