"""The priors folder: what is written is read, what is wrong is named, what is finished is not done again."""

import json
import os
import subprocess
import sys
from pathlib import Path

import cv2
import numpy as np
import pytest
from toy import clip_and_priors

from f4x_core.clip import Clip
from f4x_core.errors import Cancelled, F4xError
from f4x_core.geometry.camera import CameraPath
from f4x_core.priors import STAGES, MotionConfig, Priors, PriorsConfig, build_priors, providers
from f4x_core.priors.config import FlowConfig
from f4x_core.priors.files import camera_kind
from f4x_core.priors.folder import ARRAYS

ROOT = Path(__file__).resolve().parents[2]
T, H, W, N = 6, 20, 32, 9
HELD_OUT = 3
MADE_BY_TOY = [stage for stage in STAGES if stage != "people"]
"""Beside another provider than the classical one nobody looks for people."""


def make_clip(**fields) -> Clip:
    frames = np.random.default_rng(0).integers(0, 255, (T, H, W, 3), np.uint8)
    return Clip("toy", frames, np.arange(T, dtype=float), 24.0, np.arange(T) == HELD_OUT, "toy", **fields)


def make_cameras(count: int, step: float = 0.1) -> CameraPath:
    intrinsics = np.tile(np.array([[40.0, 0, W / 2], [0, 40, H / 2], [0, 0, 1]]), (count, 1, 1))
    poses = np.tile(np.eye(4), (count, 1, 1))
    poses[:, 0, 3] = step * np.arange(count)
    return CameraPath(
        intrinsics=intrinsics, world_to_camera=poses, times=np.arange(count, dtype=float), width=W, height=H
    )


def fill(priors: Priors, names) -> None:
    rng = np.random.default_rng(1)
    frames = len(priors.frames)
    sizes = {"F": frames, "P": frames - 1, "H": H, "W": W, "N": N, "M": 2, "J": 33, "2": 2, "3": 3}
    for name in names:
        if name == "cameras":
            priors.cameras, priors.camera_kind = make_cameras(frames), "moving"
            continue
        axes, dtype = ARRAYS[name]
        values = rng.uniform(0.1, 1, [sizes[axis] for axis in axes])
        setattr(
            priors,
            name,
            (values * 15 if name == "tracks" else values).astype(dtype) if dtype != np.bool_ else values > 0.5,
        )


@pytest.fixture
def toy(monkeypatch):
    """A provider `toy` for all stages that counts its runs."""
    runs: list[str] = []
    for stage, names in STAGES.items():

        def provide(clip, priors, config, progress, stage=stage, names=names):
            runs.append(stage)
            fill(priors, [name for name in names if getattr(priors, name) is None])

        monkeypatch.setitem(providers.PROVIDERS, (stage, "toy"), provide)
    return runs


def full() -> Priors:
    priors = Priors.empty(make_clip())
    fill(priors, [name for names in STAGES.values() for name in names])
    return priors


def test_write_and_read_keep_everything(tmp_path):
    priors = full()
    priors.statistics = {"motion": {"threshold": 0.4}}
    priors.warn("look out")
    priors.warn("look out")
    priors.write(tmp_path)
    again = Priors.read(tmp_path)
    for name in ARRAYS:
        np.testing.assert_array_equal(getattr(again, name), getattr(priors, name), err_msg=name)
        assert getattr(again, name).dtype == ARRAYS[name][1]
    np.testing.assert_array_equal(again.cameras.world_to_camera, priors.cameras.world_to_camera)
    assert again.warnings == ["look out"]
    assert again.statistics == priors.statistics
    assert list(again.frames) == [0, 1, 2, 4, 5]
    assert not list(tmp_path.glob("*.part")) and not list(tmp_path.glob(".*"))


@pytest.mark.parametrize(
    ("name", "value", "words"),
    [
        ("depth", np.full((5, H, W), np.nan, np.float32), "no positive depth"),
        ("depth", np.zeros((5, H, W), np.float32), "no positive depth"),
        ("depth", np.ones((5, H, W + 1), np.float32), "shape"),
        ("depth", np.ones((5, H, W), np.float64), "float32"),
        ("depth", np.stack([np.ones((H, W), np.float32)] * 4 + [np.full((H, W), np.nan, np.float32)]), "frame 5"),
        ("mask", np.zeros((T, H, W), bool), "5 supervised"),
        ("flow_forward", np.full((4, H, W, 2), np.nan, np.float16), "NaN"),
        ("motion", np.full((5, H, W), 1.5, np.float16), "0..1"),
        ("tracks_motion", np.zeros(N + 1, np.float32), "shape"),
        ("tracks", np.full((5, N, 2), 1e4, np.float32), "outside"),
        ("tracks", np.full((5, N, 2), np.nan, np.float32), "NaN"),
        ("camera_kind", "drone", "camera_kind"),
        ("cameras", make_cameras(T), "6 cameras"),
    ],
)
def test_validation_names_the_problem(name, value, words):
    priors = full()
    setattr(priors, name, value)
    with pytest.raises(F4xError, match=words):
        priors.validate()


def test_a_few_tracks_outside_turn_invisible():
    priors = full()
    priors.tracks_visible[:] = True
    priors.tracks[2, 0] = -5
    priors.validate()
    assert not priors.tracks_visible[2, 0]
    assert priors.tracks_visible.sum() == priors.tracks_visible.size - 1


def test_damaged_files_are_named(tmp_path):
    with pytest.raises(F4xError, match="not a priors folder"):
        Priors.read(tmp_path)
    full().write(tmp_path)
    (tmp_path / "depth.npy").write_bytes(b"\x93NUMPY broken")
    with pytest.raises(F4xError, match=r"depth\.npy"):
        Priors.read(tmp_path)
    (tmp_path / "priors.json").write_text("{")
    with pytest.raises(F4xError, match=r"priors\.json"):
        Priors.read(tmp_path)


def test_pickled_arrays_are_refused(tmp_path):
    full().write(tmp_path)
    np.save(tmp_path / "depth.npy", np.array([{"a": 1}], dtype=object), allow_pickle=True)
    with pytest.raises(F4xError, match=r"depth\.npy"):
        Priors.read(tmp_path)


def test_finished_stages_are_not_run_again(tmp_path, toy):
    clip, config = make_clip(), PriorsConfig.of("toy")
    first = build_priors(clip, tmp_path, config)
    assert toy == MADE_BY_TOY
    second = build_priors(clip, tmp_path, config)
    assert toy == MADE_BY_TOY
    np.testing.assert_array_equal(first.depth, second.depth)
    assert second.camera_kind == "moving"
    entry = second.provenance["depth"]
    assert entry["provider"] == "toy" and entry["settings"]["provider"] == "toy" and entry["seconds"] >= 0


def test_what_a_later_stage_revises_is_finished_too(tmp_path, toy, monkeypatch):
    def provide(clip, priors, config, progress):
        toy.append("cameras")
        fill(priors, ["cameras"])
        priors.tracks, priors.tracks_motion = priors.tracks + 1, priors.tracks_motion / 2

    monkeypatch.setitem(providers.PROVIDERS, ("cameras", "toy"), provide)
    clip, config = make_clip(), PriorsConfig.of("toy")
    first = build_priors(clip, tmp_path, config)
    second = build_priors(clip, tmp_path, config)
    assert toy == MADE_BY_TOY
    np.testing.assert_array_equal(first.tracks, second.tracks)
    np.testing.assert_array_equal(first.tracks_motion, second.tracks_motion)


def test_a_changed_setting_runs_its_stage_and_only_what_sees_a_difference(tmp_path, toy):
    clip = make_clip()
    build_priors(clip, tmp_path, PriorsConfig.of("toy"))
    del toy[:]
    build_priors(clip, tmp_path, PriorsConfig.of("toy", motion=MotionConfig(provider="toy", threshold=0.7)))
    assert toy == ["motion"]  # it made the same arrays, so nothing after it changed


def test_another_picture_runs_everything(tmp_path, toy):
    clip = make_clip()
    build_priors(clip, tmp_path, PriorsConfig.of("toy"))
    del toy[:]
    clip.frames[0, 0, 0] ^= 255
    build_priors(clip, tmp_path, PriorsConfig.of("toy"))
    assert toy == MADE_BY_TOY
    del toy[:]
    clip.frames[HELD_OUT] = 0  # nobody may look at it
    build_priors(clip, tmp_path, PriorsConfig.of("toy"))
    assert toy == []


def test_a_file_put_by_the_user_stays_and_later_stages_follow(tmp_path, toy):
    clip, config = make_clip(), PriorsConfig.of("toy")
    build_priors(clip, tmp_path, config)
    del toy[:]
    mine = np.zeros((5, H, W), bool)
    mine[:, 3:9, 4:12] = True
    np.save(tmp_path / "mask.npy", mine)
    priors = build_priors(clip, tmp_path, config)
    np.testing.assert_array_equal(priors.mask, mine)
    assert priors.provenance["mask"]["provider"] == "user"
    assert {"cameras", "depth"} <= set(toy)
    del toy[:]
    np.testing.assert_array_equal(build_priors(clip, tmp_path, config).mask, mine)
    assert toy == []
    np.testing.assert_array_equal(Priors.read(tmp_path).mask, mine)


def test_a_wrong_file_of_the_user_is_named(tmp_path, toy):
    np.save(tmp_path / "depth.npy", np.ones((2, H, W), np.float32))
    with pytest.raises(F4xError, match=r"depth\.npy"):
        build_priors(make_clip(), tmp_path, PriorsConfig.of("toy"))
    assert toy == []


def test_cancel_keeps_finished_stages(tmp_path, toy):
    def stop(stage, done, total, message=""):
        if message == "cameras":
            raise Cancelled

    with pytest.raises(Cancelled):
        build_priors(make_clip(), tmp_path, PriorsConfig.of("toy"), stop)
    assert toy == ["flow", "tracks", "motion"]
    build_priors(make_clip(), tmp_path, PriorsConfig.of("toy"))
    assert toy == MADE_BY_TOY


@pytest.mark.parametrize("written", [0, 1])
def test_a_write_cut_short_is_not_taken_for_the_users_file(tmp_path, toy, monkeypatch, written):
    from f4x_core.priors import folder

    clip, config = make_clip(), PriorsConfig.of("toy")
    build_priors(clip, tmp_path, config)
    real, count = folder.replace_file, []

    def cut(path):
        if path.name.startswith("flow"):
            count.append(path)
            if len(count) > written:
                raise KeyboardInterrupt
        return real(path)

    clip.frames[:] ^= 255

    def other(clip, priors, config, progress):
        fill(priors, STAGES["flow"])
        priors.flow_forward = priors.flow_forward + np.float16(1)

    monkeypatch.setitem(providers.PROVIDERS, ("flow", "toy"), other)
    monkeypatch.setattr(folder, "replace_file", cut)
    with pytest.raises(KeyboardInterrupt):
        build_priors(clip, tmp_path, config)
    monkeypatch.setattr(folder, "replace_file", real)
    priors = build_priors(clip, tmp_path, config)
    assert priors.provenance["flow_forward"]["provider"] == "toy"
    assert priors.flow_forward.max() > 1


def test_a_provider_that_forgets_a_field_is_told(tmp_path, toy, monkeypatch):
    monkeypatch.setitem(providers.PROVIDERS, ("depth", "toy"), lambda *_: None)
    with pytest.raises(F4xError, match="did not make depth"):
        build_priors(make_clip(), tmp_path, PriorsConfig.of("toy"))


def test_unknown_provider_and_prior_are_named(tmp_path):
    with pytest.raises(F4xError, match=r"no provider 'raft' for flow.*classical"):
        build_priors(make_clip(), tmp_path, PriorsConfig(flow=FlowConfig(provider="raft")))
    with pytest.raises(F4xError, match="no prior 'deepth'"):
        build_priors(make_clip(), tmp_path, PriorsConfig(files={"deepth": "x.npy"}))


def test_all_frames_held_out_is_refused(tmp_path):
    clip = make_clip()
    clip.held_out[:] = True
    with pytest.raises(F4xError, match="held out"):
        build_priors(clip, tmp_path)


def test_nothing_is_known_of_what_nobody_saw(tmp_path, toy):
    hidden = np.zeros((T, H, W), bool)
    hidden[:, :, W // 2 :] = True
    plain, half = (
        build_priors(make_clip(hidden=each), tmp_path / name, PriorsConfig.of("toy"))
        for each, name in ((None, "plain"), (hidden, "half"))
    )
    assert np.isnan(half.depth[:, :, W // 2 :]).all() and not half.mask[:, :, W // 2 :].any()
    assert not half.depth_confidence[:, :, W // 2 :].any() and not half.motion[:, :, W // 2 :].any()
    np.testing.assert_array_equal(half.depth[:, :, : W // 2], plain.depth[:, :, : W // 2])
    column = plain.tracks[..., 0]
    np.testing.assert_array_equal(half.tracks_visible, plain.tracks_visible & ~(column >= W // 2))


def test_arrays_of_the_clip_are_used_for_the_supervised_frames(tmp_path, toy):
    depth = np.random.default_rng(3).uniform(1, 4, (T, H, W)).astype(np.float32)
    depth[0, 0, 0] = -1
    masks = depth > 2
    clip = make_clip(depth=depth, masks=masks, cameras=make_cameras(T))
    priors = build_priors(clip, tmp_path, PriorsConfig.of("toy"))
    kept = [0, 1, 2, 4, 5]
    np.testing.assert_array_equal(priors.mask, masks[kept])
    scale = np.nanmedian(np.where(depth[kept] > 0, depth[kept], np.nan))
    np.testing.assert_allclose(priors.depth[1:], depth[kept][1:] / scale, rtol=1e-6)
    np.testing.assert_allclose(priors.cameras.world_to_camera[1:, 0, 3], np.array(kept[1:]) * 0.1 / scale)
    assert np.isnan(priors.depth[0, 0, 0]) and priors.depth_confidence[0, 0, 0] == 0
    assert priors.camera_kind == "moving"
    assert toy == ["flow", "tracks", "motion"]


def test_folders_of_pictures_and_arrays_are_read_and_fitted(tmp_path, toy):
    masks, depths = tmp_path / "masks", tmp_path / "depths"
    masks.mkdir()
    depths.mkdir()
    truth = np.zeros((T, 2 * H, 2 * W), bool)
    truth[:, 10:30, 8 : 2 * T + 20] = True
    for t in range(T):
        cv2.imwrite(str(masks / f"{t:03d}.png"), truth[t].astype(np.uint8) * 255)
        np.savez(depths / f"{t:03d}.npz", depth=np.full((H, W), t + 1.0))
    config = PriorsConfig.of("toy", files={"mask": str(masks), "depth": str(depths)})
    priors = build_priors(make_clip(), tmp_path / "priors", config)
    np.testing.assert_array_equal(priors.mask, truth[[0, 1, 2, 4, 5], 1::2, 1::2])
    np.testing.assert_array_equal(priors.depth[:, 0, 0], np.float32([1, 2, 3, 5, 6]))
    assert priors.provenance["mask"]["settings"]["source"] == str(masks)
    del toy[:]
    build_priors(make_clip(), tmp_path / "priors", config)
    assert toy == []


@pytest.mark.parametrize(
    ("name", "value", "words"),
    [
        ("mask", np.zeros((5, H, H), bool), "for this picture"),
        ("depth", np.zeros((H, W)), "axes"),
        ("depth", np.full((5, H, W), np.nan), "no positive depth"),
        ("mask", np.zeros((4, H, W), bool), "shape"),
    ],
)
def test_wrong_files_are_named(tmp_path, toy, name, value, words):
    np.save(tmp_path / "mine.npy", value)
    config = PriorsConfig.of("toy", files={name: str(tmp_path / "mine.npy")})
    with pytest.raises(F4xError, match=words):
        build_priors(make_clip(), tmp_path / "priors", config)


def test_missing_files_are_named(tmp_path, toy):
    (tmp_path / "empty").mkdir()
    for path, words in (("nowhere", "does not exist"), ("empty", "no .npy")):
        config = PriorsConfig.of("toy", files={"mask": str(tmp_path / path)})
        with pytest.raises(F4xError, match=words):
            build_priors(make_clip(), tmp_path / "priors", config)


def test_given_flow_gets_its_masks(tmp_path, toy):
    forward = np.zeros((4, H, W, 2), np.float32)
    forward[..., 0] = 2
    np.save(tmp_path / "f.npy", forward)
    np.save(tmp_path / "b.npy", -forward)
    config = PriorsConfig.of(
        "toy", files={"flow_forward": str(tmp_path / "f.npy"), "flow_backward": str(tmp_path / "b.npy")}
    )
    priors = build_priors(make_clip(), tmp_path / "priors", config)
    assert "flow" not in toy
    assert priors.flow_forward_mask[:, :, :-3].all() and not priors.flow_forward_mask[:, :, -1].any()


def test_camera_kinds():
    still = make_cameras(4, step=0.0)
    assert camera_kind(still) == "static"
    assert camera_kind(make_cameras(4)) == "moving"
    angle = np.radians(np.arange(4.0))
    poses = np.tile(np.eye(4), (4, 1, 1))
    poses[:, 0, 0] = poses[:, 2, 2] = np.cos(angle)
    poses[:, 0, 2], poses[:, 2, 0] = np.sin(angle), -np.sin(angle)
    turned = CameraPath(intrinsics=still.intrinsics, world_to_camera=poses, times=still.times, width=W, height=H)
    assert camera_kind(turned) == "pan"


def test_head_is_plain_json(tmp_path):
    full().write(tmp_path)
    head = json.loads((tmp_path / "priors.json").read_text())
    assert head["version"] == 1 and head["width"] == W and head["frames"] == [0, 1, 2, 4, 5]


def test_a_linked_file_is_never_written_through_its_link(tmp_path):
    _, priors = clip_and_priors(6)
    elsewhere = tmp_path / "mine.npy"
    np.save(elsewhere, priors.depth + 1)
    before = elsewhere.read_bytes()
    folder = tmp_path / "priors"
    folder.mkdir()
    (folder / "depth.npy").symlink_to(elsewhere)
    priors.write(folder)
    assert elsewhere.read_bytes() == before and not (folder / "depth.npy").is_symlink()
    np.testing.assert_array_equal(np.load(folder / "depth.npy"), priors.depth)


def test_a_model_is_a_provider_without_the_command_line_and_its_absence_one_sentence(tmp_path):
    code = """
import sys
sys.modules["torch"] = None
from f4x_core.priors import PriorsConfig
from f4x_core.priors.config import DepthConfig
from f4x_core.priors.providers import find
for name in ("depth-anything", "depth-anything-3"):
    try:
        find("depth", name)(None, None, PriorsConfig(depth=DepthConfig(provider=name)), None)
    except Exception as error:
        print(type(error).__name__, error)
"""
    environment = {
        **os.environ,
        "HOME": str(tmp_path),
        "HF_HOME": str(tmp_path),
        "F4X_MODELS": str(tmp_path),
        "PYTHONPATH": str(ROOT),
    }
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, env=environment, check=True)
    lines = done.stdout.splitlines()
    assert len(lines) == 2 and all(line.startswith("F4xError ") for line in lines), done.stdout
    assert "f4x models get depth-anything" in lines[0] and "depth-anything-3" in lines[1]
