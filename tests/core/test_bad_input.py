"""Bad input, a full disk, interrupts: one sentence, the right exit code, nothing half-written; through the command line."""

import dataclasses
import errno
import json
import os
import shutil
import signal
import subprocess
import sys
import zipfile
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from warped_clip import texture

from f4x_core import page
from f4x_core.app import fit_options, fitting
from f4x_core.app.fit_options import ClipOptions, FitOptions
from f4x_core.app.fitting import make_scene
from f4x_core.cli import main
from f4x_core.cli import main as cli_main
from f4x_core.cli.terminal import TerminalProgress
from f4x_core.clip import write_video
from f4x_core.errors import Cancelled, F4xError
from f4x_core.features.teachers import require_ready
from f4x_core.fit import config as fit_config
from f4x_core.fit import pipeline
from f4x_core.priors import Priors, sfm, structure
from f4x_core.scene import read_scene

ROOT = Path(__file__).resolve().parents[2]
HEIGHT, WIDTH = 40, 64
FULL_QUICK = fit_config.PROFILES["quick"]
"""The profile as it is, before `fast` shortens it."""


def short_quick():
    """The quick profile with so few steps that a fit takes two seconds."""
    config = FULL_QUICK()
    scaffold = dataclasses.replace(config.scaffold, geometry_steps=10, following_steps=10, max_nodes=8)
    return dataclasses.replace(config, steps=24, checkpoint_every=10, measure_every=8, scaffold=scaffold)


@pytest.fixture(autouse=True)
def fast(monkeypatch):
    monkeypatch.setitem(fit_config.PROFILES, "quick", short_quick)


@pytest.fixture
def bare_page(monkeypatch):
    """Diagnostics without charts, half of what so short a fit takes; tests of odd clips draw them."""
    monkeypatch.setattr(page, "svg", lambda figure: "<svg/>")


def filmed(frames: int = 6, slide: float = 0.0, post: float = 0.0, speed: float = 3.0) -> np.ndarray:
    """(frames,40,64,3) uint8: a wall that the camera slides along by `slide` px a frame, with a card that moves by
    `speed` px a frame (0: none) and a nearer post that passes by `post` px a frame (0: none)."""
    wall, wood, card = texture(60, 120, 0), texture(HEIGHT, 14, 1), texture(16, 16, 2)
    pictures = np.empty((frames, HEIGHT, WIDTH, 3), np.uint8)
    for t, picture in enumerate(pictures):
        left = 10 + round(slide * t)
        picture[:] = wall[5 : 5 + HEIGHT, left : left + WIDTH]
        if post:
            column = 44 - round(post * t)
            picture[:, column : column + 14] = wood
        if speed:
            column, row = 4 + round(speed * t), 14 + round(speed * t / 3)
            picture[row : row + 16, column : column + 16] = card
    return pictures


def write_frames(folder: Path, frames: np.ndarray) -> Path:
    folder.mkdir(parents=True)
    for index, frame in enumerate(frames):
        Image.fromarray(frame).save(folder / f"{index:03d}.png")
    return folder


def refuses(capsys, *arguments, code: int = 2) -> str:
    """Run a command that must fail with `code`; return its one sentence."""
    capsys.readouterr()
    assert main([*map(str, arguments), "--json"]) == code
    printed = capsys.readouterr()
    lines = printed.err.strip().splitlines()
    assert len(lines) == 1 and lines[0].startswith(f"f4x {arguments[0]}: "), printed.err
    sentence = lines[0].partition(": ")[2]
    assert json.loads(printed.out) == {"error": sentence}
    return sentence


def fit(capsys, clip: Path, out: Path, *options) -> dict:
    """Fit quickly with one thread; return the printed object."""
    capsys.readouterr()
    assert main(["fit", str(clip), "-o", str(out), *FAST, *map(str, options)]) == 0
    printed = capsys.readouterr()
    assert printed.err == ""
    return json.loads(printed.out)


FAST = ("--profile", "quick", "--threads", "1", "--json")


def unfinished(folder: Path) -> list[Path]:
    """Temporary neighbours that a broken write would leave."""
    return list(folder.rglob("*.part"))


def arrays_of(file: Path) -> dict[str, bytes]:
    """Every array of a scene file, byte for byte."""
    read_scene(file)
    with zipfile.ZipFile(file) as archive:
        return {name: archive.read(name) for name in archive.namelist() if name.endswith(".npy")}


@pytest.fixture(scope="module")
def fitted(tmp_path_factory) -> tuple[Path, Path]:
    """A clip with a moving card in front of a standing camera, and the folder of its finished, uninterrupted fit."""
    folder = tmp_path_factory.mktemp("fitted")
    clip = write_frames(folder / "clip", filmed())
    with pytest.MonkeyPatch.context() as patch:
        patch.setitem(fit_config.PROFILES, "quick", short_quick)
        assert main(["fit", str(clip), "-o", str(folder / "out"), *FAST]) == 0
    assert len(read_scene(folder / "out" / "scene.f4x").dynamic) > 0
    return clip, folder / "out"


# ------------------------------------------------------------------------------------------------------------- the clip


def empty_folder(path):
    path.mkdir()


def unequal_sizes(path):
    write_frames(path, filmed(5))
    Image.fromarray(filmed(1)[0, :30]).save(path / "003.png")


def unreadable_picture(path):
    write_frames(path, filmed(5))
    (path / "003.png").write_bytes((path / "002.png").read_bytes()[:200])


def cut_off_video(path):
    write_video(path, filmed(8), 24.0)
    path.write_bytes(path.read_bytes()[: path.stat().st_size // 2])


CLIPS = {
    "nowhere.mp4": (lambda path: None, "nowhere.mp4"),
    "empty": (empty_folder, "empty"),
    "one": (lambda path: write_frames(path, filmed(1)), "1 frame is too few"),
    "two": (lambda path: write_frames(path, filmed(2)), "2 frames are too few"),
    "unequal": (unequal_sizes, "003.png"),
    "picture": (unreadable_picture, "003.png"),
    "noise.mp4": (lambda path: path.write_bytes(bytes(range(256)) * 40), "noise.mp4"),
    "nothing.mp4": (lambda path: path.write_bytes(b""), "nothing.mp4"),
    "cut.mp4": (cut_off_video, "cut.mp4"),
    "tiny": (lambda path: write_frames(path, filmed(5)[:, :12, :12]), "12x12 are too small"),
}


@pytest.mark.parametrize("verb", ["fit", "priors"])
@pytest.mark.parametrize("name", CLIPS)
def test_a_clip_that_cannot_be_fitted_is_refused_before_any_work(tmp_path, capsys, name, verb):
    make, words = CLIPS[name]
    make(tmp_path / name)
    sentence = refuses(capsys, verb, tmp_path / name, "-o", tmp_path / "out")
    assert words in sentence and name in sentence and sentence.endswith("[F4X-CLIP]")
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (("--hold-out", 3), "2 frames are too few"),
        (("--hold-out", 0), "--hold-out 0"),
        (("--hold-out", 1), "--hold-out 1"),
        (("--hold-out", -2), "--hold-out -2"),
        (("--hold-out", 100), "holds out none of the 3 frames"),
        (("--frames", "0:2"), "2 frames are too few"),
        (("--frames", "2:9"), "reach beyond"),
        (("--width", 8), "8x4 are too small"),
        (("--seed", -1), "--seed -1"),
        (("--width", "1.5"), "--width '1.5': give a whole number; `f4x fit --help`"),
        (("--memory", "much"), "--memory 'much': give a number; `f4x fit --help`"),
        (("--threads", -1), "--threads -1"),
        (("--backend", "abacus"), "'abacus' (choose from 'auto', 'native', 'torch', 'reference')"),
        (("--backend", "gsplat"), "'gsplat' (choose from 'auto', 'native', 'torch', 'reference')"),
        (("--set", "backend=gsplat"), "backend must be one of auto, native, torch, reference; got 'gsplat'"),
        (("--set", "stepz=3"), "no setting 'stepz'; did you mean steps?"),
        (("--set", "steps=many"), "steps must be a whole number, 1 or more; got 'many'"),
        (("--set", "seed=-1"), "seed must be a whole number, 0 or more; got '-1'"),
        (("--set", "shifts=1,2"), "give one weight for each shift"),
        (("--set", "priors.depth.provider=guess"), "no provider 'guess' for depth"),
        (("-o", ""), "-o/--output: the path is empty"),
        (("--output=",), "-o/--output: the path is empty"),
        (("--no-such-option",), "unrecognized arguments: --no-such-option"),
        (("--prior", "smell=x"), "smell"),
        (("--prior", "depth"), "--prior depth"),
    ],
)
def test_options_that_make_no_sense_are_refused_before_any_work(tmp_path, capsys, options, words):
    clip = write_frames(tmp_path / "clip", filmed(3))
    assert words in refuses(capsys, "fit", clip, "-o", tmp_path / "out", *options)
    assert not (tmp_path / "out").exists()


def test_two_sentences_are_refused_where_one_would_be_lost(tmp_path, capsys):
    said = refuses(capsys, "edit", tmp_path / "scene.f4x", "--say", "make it red", "--say", "hide it")
    assert "--say is given twice" in said


def test_an_output_that_is_a_file_is_refused_and_kept(tmp_path, capsys):
    clip = write_frames(tmp_path / "clip", filmed(3))
    (tmp_path / "out").write_text("mine")
    for verb in (("fit", clip), ("priors", clip), ("demo",), ("render", "x.f4x"), ("export", "x.f4x")):
        sentence = refuses(capsys, *verb, "-o", tmp_path / "out")
        assert f"{tmp_path / 'out'} is a file; give a folder" in sentence
    assert (tmp_path / "out").read_text() == "mine"


@pytest.mark.parametrize(
    ("frames", "least_psnr"),
    [
        (np.repeat(filmed(1, speed=0), 5, 0), 12),
        (np.zeros((5, HEIGHT, WIDTH, 3), np.uint8), 40),
        pytest.param(np.full((5, HEIGHT, WIDTH, 3), 200, np.uint8), 20, marks=pytest.mark.slow),
        (np.arange(5, dtype=np.uint8)[:, None, None, None] % 2 * np.full((5, HEIGHT, WIDTH, 3), 255, np.uint8), 0),
    ],
    ids=["nothing moves", "black", "flat", "flashing"],
)
def test_clips_without_motion_or_texture_become_a_static_scene(tmp_path, capsys, frames, least_psnr):
    clip, out = write_frames(tmp_path / "clip", frames), tmp_path / "out"
    printed = fit(capsys, clip, out)
    assert printed["metrics"]["used_psnr"] > least_psnr
    assert any(row["what"] == "motion" and row["chosen"].startswith("none") for row in printed["needs"])
    scene = read_scene(out / "scene.f4x")
    assert len(scene.dynamic) == 0 and scene.scaffold is None and len(scene.static) > 0
    assert np.isfinite(scene.static.means).all() and np.isfinite(scene.cameras.world_to_camera).all()
    priors = Priors.read(out / "priors")
    assert priors.camera_kind == "static" and priors.warnings
    assert "static" in (out / "diagnostics.html").read_text()
    assert main(["render", str(out / "scene.f4x"), "-o", str(tmp_path / "r"), "--channels", "rgb,depth,motion"]) == 0


@pytest.mark.parametrize(
    ("frames", "options"),
    [
        (filmed(3), ()),
        (filmed(4), ("--hold-out", 4)),
        pytest.param(filmed(3, slide=2, speed=0), (), marks=pytest.mark.slow),
        (filmed(4, slide=2, post=4, speed=0)[:, :39, :63], ("--hold-out", 4)),
        (filmed(3)[:, :16, :16], ()),
    ],
    ids=["three", "four, one held out", "sliding", "odd size", "smallest"],
)
def test_clips_shorter_than_every_gap_of_the_flow_are_fitted(tmp_path, capsys, frames, options):
    printed = fit(capsys, write_frames(tmp_path / "clip", frames), tmp_path / "out", *options)
    assert printed["metrics"]["used_psnr"] > 8
    assert len(read_scene(tmp_path / "out" / "scene.f4x").cameras) == len(frames)


def test_a_camera_solver_that_fails_or_is_absent_is_done_without(tmp_path, capsys, monkeypatch):
    clip = write_frames(tmp_path / "clip", filmed(10, slide=1, post=2))
    asked = []

    def absent(command, **_):
        asked.append(command)
        return subprocess.CompletedProcess(command, 1, "", "No module named 'pycolmap'")

    monkeypatch.setattr(structure, "MAX_ERROR_PX", 0.0)  # as if all frames at once led nowhere
    monkeypatch.setattr(sfm.subprocess, "run", absent)
    assert main(["priors", str(clip), "-o", str(tmp_path / "out"), "--json"]) == 0
    result = json.loads(capsys.readouterr().out)
    assert asked and result["camera_kind"] in ("moving", "pan")
    assert (
        Image.open(tmp_path / "out" / "input.jpg").size == (result["width"], result["height"])
        and result["frames"] == 10
    )

    def refused(command, **_):
        raise PermissionError(13, "Permission denied")

    monkeypatch.setattr(sfm.subprocess, "run", refused)
    assert "camera solver" in refuses(capsys, "priors", clip, "-o", tmp_path / "other")
    assert not unfinished(tmp_path)


# ----------------------------------------------------------------------------------------------------- the user's priors


def truncated_npy(path):
    np.save(path, np.ones((6, HEIGHT, WIDTH), np.float32))
    path.write_bytes(path.read_bytes()[:1000])


PRIORS = {
    "all_nan": ("depth", lambda path: np.save(path, np.full((6, HEIGHT, WIDTH), np.nan, np.float32)), "no positive"),
    "all_zero": ("depth", lambda path: np.save(path, np.zeros((6, HEIGHT, WIDTH), np.float32)), "no positive"),
    "one_frame_nan": (
        "depth",
        lambda path: np.save(path, np.where(np.arange(6)[:, None, None] == 4, np.nan, np.ones((6, HEIGHT, WIDTH)))),
        "clip frame 4",
    ),
    "too_few": ("depth", lambda path: np.save(path, np.ones((4, HEIGHT, WIDTH), np.float32)), "(4, 40, 64)"),
    "aspect": ("depth", lambda path: np.save(path, np.ones((6, 30, 30), np.float32)), "30x30"),
    "flat": ("depth", lambda path: np.save(path, np.ones(6, np.float32)), "(6,)"),
    "words": ("depth", lambda path: np.save(path, np.full((6, HEIGHT, WIDTH), "near")), "dtype <U4"),
    "cut": ("depth", truncated_npy, "readable"),
    "noise": ("depth", lambda path: path.write_bytes(b"\x93NUMPY\x01\x00v\x00{'descr': [["), "readable"),
    "zip": ("depth", lambda path: path.write_bytes(b"PK\x03\x04 but no more"), "readable"),
    "absent": ("depth", lambda path: None, "does not exist"),
    "mask_aspect": ("mask", lambda path: np.save(path, np.ones((6, 30, 30), bool)), "30x30"),
    "outside": ("tracks", lambda path: np.save(path, np.full((6, 20, 2), 900, np.float32)), "lie outside 64x40"),
    "no_pixels": ("tracks", lambda path: np.save(path, np.zeros((6, 20, 3), np.float32)), "(6, 20, 3)"),
    "camera": ("cameras", lambda path: path.write_text("{}"), "camera path"),
}


@pytest.mark.parametrize("name", PRIORS)
def test_a_wrong_prior_is_named_before_any_work(tmp_path, capsys, fitted, name):
    prior, make, words = PRIORS[name]
    file = tmp_path / f"my_{name}.npy"
    make(file)
    sentence = refuses(capsys, "fit", fitted[0], "-o", tmp_path / "out", "--prior", f"{prior}={file}")
    assert words in sentence and file.name in sentence
    assert not (tmp_path / "out").exists()


def test_a_wrong_file_in_the_priors_folder_is_named_in_full(tmp_path, capsys, fitted):
    file = tmp_path / "out" / "priors" / "depth.npy"
    file.parent.mkdir(parents=True)
    np.save(file, np.full((6, HEIGHT, WIDTH), np.nan, np.float32))
    assert f"{file} holds no positive depth" in refuses(capsys, "fit", fitted[0], "-o", tmp_path / "out")


@pytest.mark.usefixtures("bare_page")
def test_holes_in_given_depth_and_some_tracks_outside_do_no_harm(tmp_path, capsys, fitted):
    depth = np.full((6, HEIGHT, WIDTH), 2, np.float32)
    depth[:, :20], depth[:, 20:25], depth[2, 25:30], depth[3, 25:30] = np.nan, 0, -1, np.inf
    np.save(tmp_path / "depth.npy", depth)
    rng = np.random.default_rng(0)
    tracks = np.repeat(rng.uniform((0, 0), (WIDTH, HEIGHT), (1, 60, 2)), 6, 0).astype(np.float32)
    tracks[:, :10], tracks[2, 10:20] = 900, np.nan
    np.save(tmp_path / "tracks.npy", tracks)
    given = [f"--prior={name}={tmp_path / name}.npy" for name in ("depth", "tracks")]
    fit(capsys, fitted[0], tmp_path / "out", *given)
    assert np.isfinite(read_scene(tmp_path / "out" / "scene.f4x").static.means).all()
    priors = Priors.read(tmp_path / "out" / "priors")
    assert np.isnan(priors.depth[:, :25]).all() and not priors.tracks_visible[:, :10].any()


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda masks: masks[:, :, :30], "30x40"),
        (lambda masks: masks[:4], "one per frame of the clip (6) or of the chosen frames (6)"),
        (lambda masks: masks[:0], "no masks"),
    ],
)
def test_masks_that_do_not_belong_to_the_clip_are_refused(tmp_path, capsys, fitted, change, words):
    folder = write_frames(tmp_path / "masks", change(np.full((6, HEIGHT, WIDTH), 255, np.uint8)))
    sentence = refuses(capsys, "fit", fitted[0], "-o", tmp_path / "out", "--masks", folder)
    assert words in sentence and str(folder) in sentence
    assert not (tmp_path / "out").exists()


def test_an_unreadable_mask_is_named(tmp_path, capsys, fitted):
    folder = write_frames(tmp_path / "masks", np.full((6, HEIGHT, WIDTH), 255, np.uint8))
    (folder / "004.png").write_bytes(b"not a picture")
    assert "004.png" in refuses(capsys, "fit", fitted[0], "-o", tmp_path / "out", "--masks", folder)


@pytest.mark.usefixtures("bare_page")
@pytest.mark.parametrize("share", [pytest.param(0, marks=pytest.mark.slow), 0.3, 1])
def test_masks_of_another_resolution_are_used_whatever_they_cover(tmp_path, capsys, fitted, share):
    masks = np.zeros((6, 2 * HEIGHT, 2 * WIDTH), np.uint8)
    masks[:, :, : round(share * 2 * WIDTH)] = 255
    folder = write_frames(tmp_path / "masks", masks)
    fit(capsys, fitted[0], tmp_path / "out", "--masks", folder)
    assert Priors.read(tmp_path / "out" / "priors").mask.mean() == pytest.approx(share, abs=0.02)
    scene = read_scene(tmp_path / "out" / "scene.f4x")
    assert np.isfinite(scene.posed(2.5).means).all()
    assert (len(scene.dynamic) > 0) == (share > 0)


# ------------------------------------------------------------------------------------------------------- the scene file


def flipped(data: bytes) -> bytes:
    middle = len(data) // 2
    return data[:middle] + bytes([data[middle] ^ 16]) + data[middle + 1 :]


def repacked(file: Path, change=lambda header: None, compression=zipfile.ZIP_STORED, bomb: int = 0) -> None:
    """Write the scene's members again, with a changed header, compressed, or with zeros that unfold to `bomb` bytes."""
    with zipfile.ZipFile(file) as archive:
        members = {name: archive.read(name) for name in archive.namelist()}
    header = json.loads(members["scene.json"])
    change(header)
    members["scene.json"] = json.dumps(header).encode()
    with zipfile.ZipFile(file, "w", compression) as archive:
        for name, data in members.items():
            archive.writestr(name, data)
        if bomb:
            archive.writestr("static/latent.npy", bytes(bomb))


DAMAGE = {
    "empty": (lambda file: file.write_bytes(b""), "not a whole scene"),
    "truncated": (lambda file: file.write_bytes(file.read_bytes()[: file.stat().st_size // 2]), "not a whole scene"),
    "flipped": (lambda file: file.write_bytes(flipped(file.read_bytes())), "damaged"),
    "bomb": (lambda file: repacked(file, compression=zipfile.ZIP_DEFLATED, bomb=50 << 20), "compressed"),
    "newer": (lambda file: repacked(file, lambda header: header.update(version=99)), "newer version"),
    "absent": (lambda file: file.unlink(), "no such file"),
}


@pytest.mark.parametrize("name", DAMAGE)
def test_a_damaged_scene_is_refused_by_every_verb_that_reads_it(tmp_path, capsys, fitted, name):
    clip, out = fitted
    file = tmp_path / f"{name}.f4x"
    shutil.copy(out / "scene.f4x", file)
    damage, words = DAMAGE[name]
    damage(file)
    made = tmp_path / "made"
    for verb in (
        ("info", file),
        ("render", file, "-o", made),
        ("export", file, "-o", made),
        ("eval", file, "--clip", clip),
    ):
        sentence = refuses(capsys, *verb)
        assert words in sentence and file.name in sentence
    assert not made.exists()


@pytest.mark.parametrize("suffix", ["ply", "splat", "spz"])
def test_splats_where_a_scene_is_needed_are_told_what_reads_them(tmp_path, capsys, fitted, suffix):
    """And that does."""
    splats = tmp_path / f"a.{suffix}"
    run("export", fitted[1] / "scene.f4x", "-o", splats, "--time", 0)
    for command in (("info", splats), ("render", splats, "-o", tmp_path / "r")):
        sentence = refuses(capsys, *command)
        assert sentence.startswith(f"{splats}: splats, not a Feature4X scene") and sentence.endswith("[F4X-SCENE]")
        assert "`f4x open` shows them, `f4x export` converts them" in sentence
    run("open", splats, "--write", tmp_path / "page.html")
    run("export", splats, "-o", tmp_path / "b.ply", "--time", 0)
    assert (tmp_path / "page.html").is_file() and (tmp_path / "b.ply").is_file()


def run(*arguments):
    assert main([*map(str, arguments), "--json"]) == 0


def test_eval_with_the_wrong_clip_or_joints_is_refused(tmp_path, capsys, fitted):
    clip, out = fitted
    shorter = write_frames(tmp_path / "shorter", filmed(5))
    higher = write_frames(tmp_path / "higher", filmed(6)[:, :30])
    assert "shorter has frames 0:5, frames 0:6" in refuses(capsys, "eval", out / "scene.f4x", "--clip", shorter)
    assert "higher: the clip has 6 frames of 64x30" in refuses(capsys, "eval", out / "scene.f4x", "--clip", higher)
    (tmp_path / "joints.json").write_text("{not json")
    words = refuses(capsys, "eval", out / "scene.f4x", "--clip", clip, "--joints", tmp_path / "joints.json")
    assert "joints.json" in words


@pytest.mark.parametrize("verb", ["render", "export"])
def test_writing_where_nothing_can_be_written_is_one_sentence(tmp_path, capsys, fitted, verb):
    scene = fitted[1] / "scene.f4x"
    (tmp_path / "file").write_text("mine")
    target = tmp_path / "file" / "below"
    assert str(tmp_path / "file") in refuses(capsys, verb, scene, "-o", target)
    assert (tmp_path / "file").read_text() == "mine"
    if os.name != "nt" and os.geteuid():  # root may write anywhere
        (tmp_path / "locked").mkdir(mode=0o500)
        sentence = refuses(capsys, verb, scene, "-o", tmp_path / "locked" / "below")
        assert "locked" in sentence and "choose another" in sentence


# ------------------------------------------------------------------------------------------------------------ full disk


@contextmanager
def disk_of(limit: int) -> Iterator[None]:
    """A disk on which no file may grow beyond `limit` bytes: the system refuses what is more, as a full one does."""
    import resource

    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (limit, before[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)


@pytest.mark.usefixtures("bare_page")
@pytest.mark.skipif(os.name == "nt", reason="no such limits there")
@pytest.mark.parametrize(
    ("limit", "words"),
    [
        (2_000, "flow_forward.npy"),
        pytest.param(56_000, "temporary flow", marks=pytest.mark.slow),
        (100_000, "photometric.pt"),
    ],
)
def test_a_full_disk_stops_the_fit_with_one_sentence_and_can_be_resumed(tmp_path, capsys, fitted, limit, words):
    clip, whole = fitted
    out = tmp_path / "out"
    with disk_of(limit):
        sentence = refuses(capsys, "fit", clip, "-o", out, *FAST[:-1])
    assert "File too large" in sentence and words in sentence and sentence.endswith("[F4X-DISK]")
    assert not unfinished(tmp_path)
    fit(capsys, clip, out, "--resume")
    assert arrays_of(out / "scene.f4x") == arrays_of(whole / "scene.f4x")


@pytest.mark.skipif(os.name == "nt", reason="no such limits there")
@pytest.mark.parametrize(("limit", "channels"), [(1_500, "rgb"), (9_000, "rgb,depth")])
def test_a_full_disk_while_rendering_leaves_whole_frames_and_counts_them(tmp_path, capsys, fitted, limit, channels):
    out = tmp_path / "out"
    with disk_of(limit):
        sentence = refuses(capsys, "render", fitted[1] / "scene.f4x", "-o", out, "--channels", channels)
    assert str(out) in sentence and "0 of 6 frames were written completely" in sentence
    assert not [path for path in out.rglob("*") if path.is_file()]


def test_a_disk_that_fills_up_while_rendering_leaves_the_frames_before(tmp_path, capsys, monkeypatch, fitted):
    save = np.save

    def full_at_the_third(file, array):
        if len(list(tmp_path.rglob("*.npy"))) == 2:
            raise OSError(errno.ENOSPC, "No space left on device")
        save(file, array)

    monkeypatch.setattr(np, "save", full_at_the_third)
    sentence = refuses(capsys, "render", fitted[1] / "scene.f4x", "-o", tmp_path / "r", "--channels", "rgb,depth")
    assert "No space left" in sentence and "2 of 6 frames were written completely" in sentence
    names = sorted(path.name for path in (tmp_path / "r").rglob("*") if path.is_file())
    assert names == ["00000.npy", "00000.png", "00000.png", "00001.npy", "00001.png", "00001.png"]


# ------------------------------------------------------------------------------------------------------------ interrupts

STAGES = ("flow", "long flows", "tracks", "motion", "cameras", "depth", "scaffold", "scaffold geometry", "spawn")


def press_at(monkeypatch, wanted: str, share: float = 0.5) -> None:
    """Ctrl-C, as a signal, when a stage reports that it is about half done."""
    pressed = []

    class Pressed(TerminalProgress):
        def __call__(self, stage, done, total, message=""):
            if stage == wanted and done >= share * (total - 1) and not pressed:
                pressed.append(stage)
                signal.raise_signal(signal.SIGINT)
            super().__call__(stage, done, total, message)

    monkeypatch.setattr(sys.modules[cli_main.__module__], "TerminalProgress", Pressed)


@pytest.mark.usefixtures("ctrl_c", "bare_page")
def test_ctrl_c_in_each_stage_then_resume_gives_the_uninterrupted_scene(tmp_path, capsys, monkeypatch, fitted):
    clip, whole = fitted
    out = tmp_path / "out"
    for stage in (*STAGES, "photometric", "evaluate"):
        with monkeypatch.context() as patch:
            press_at(patch, stage)
            sentence = refuses(capsys, "fit", clip, "-o", out, *FAST[:-1], "--resume", code=130)
        assert sentence == "Stopped; the same command with --resume continues.", stage
        assert not unfinished(tmp_path) and not (out / "scene.f4x").exists(), stage
        assert (out / "checkpoints" / "photometric.pt").exists() == (stage in ("photometric", "evaluate"))
    fit(capsys, clip, out, "--resume")
    assert arrays_of(out / "scene.f4x") == arrays_of(whole / "scene.f4x")
    assert signal.getsignal(signal.SIGINT) is signal.default_int_handler


@pytest.mark.usefixtures("ctrl_c", "bare_page")
def test_ctrl_c_before_anything_is_saved_promises_nothing(tmp_path, capsys, monkeypatch, fitted):
    press_at(monkeypatch, "reading clip")
    assert refuses(capsys, "fit", fitted[0], "-o", tmp_path / "out", *FAST[:-1], code=130) == "Stopped."
    assert not (tmp_path / "out").exists()


@pytest.mark.usefixtures("bare_page")
def test_one_call_from_python_leaves_what_the_command_leaves(tmp_path, fitted):
    """Stopped in the middle by its own progress function, and continued."""
    clip, whole = fitted
    options, out = FitOptions(replace(short_quick(), threads=1)), tmp_path / "out"
    stages = []

    def stop(stage, done, total, message=""):
        stages.append(stage)
        if stage == "photometric" and done > 10:
            raise Cancelled

    with pytest.raises(Cancelled):
        make_scene(clip, out, options, stop)
    assert "cost" in stages and not (out / "scene.f4x").exists()
    with pytest.raises(F4xError, match="--hold-out 0, not 3"):
        make_scene(clip, out, replace(options, resume=True, clip=ClipOptions(hold_out=3)))
    made = make_scene(str(clip), str(out), replace(options, resume=True))
    assert arrays_of(made.path) == arrays_of(whole / "scene.f4x")
    wanted = {"scene.f4x", "metrics.json", "diagnostics.html"}
    assert {file.name for file in out.iterdir()} >= wanted and made.main.page.is_file()
    assert made.quality and made.verdict and made.cuts is None
    unknown = replace(options.config, priors=options.config.priors.with_provider("x"))
    with pytest.raises(F4xError, match="There is no provider 'x'"):
        make_scene(clip, tmp_path / "other", replace(options, config=unknown))
    assert not (tmp_path / "other").exists()


@pytest.mark.slow
@pytest.mark.usefixtures("bare_page")
def test_one_call_from_python_fits_long_clips_in_windows_and_adds_features(tmp_path, fitted):
    try:
        require_ready("visual")
    except F4xError as error:
        pytest.skip(str(error))
    more = {"window": 5, "overlap": 2, "linear_light": True, "features": ("visual",)}
    made = make_scene(fitted[0], tmp_path, FitOptions(replace(short_quick(), threads=1), **more))
    assert made.main.windows == 2 and made.cuts == () and made.linear_light[0].after > 0
    scene = read_scene(tmp_path / "scene.f4x")
    assert len(scene.cameras) == len(made.main) and set(scene.features.names) == set(made.features[0].heads) == {
        "visual"
    }


@pytest.mark.usefixtures("ctrl_c", "bare_page")
def test_a_stopped_fit_in_windows_resumes_with_the_same_options_only(tmp_path, capsys, monkeypatch, fitted):
    """Each other one is named before the clip is surveyed; so is a fit at once, and windows where one was stopped."""
    clip, out, part = fitted[0], tmp_path / "out", ("--window", 5, "--overlap", 2)
    asked = ("fit", clip, "-o", out, *FAST[:-1])
    monkeypatch.setattr(fitting, "fit_long", interrupted)
    assert refuses(capsys, *asked, *part, code=130) == "Stopped."  # no window has saved anything yet
    monkeypatch.setattr(fitting, "survey", None)
    monkeypatch.setattr(fit_options, "read_clip", None)
    for changed, result in {
        ("--window", 6, "--overlap", 2): "--window 5, not 6",
        ("--window", 7, "--overlap", 3): "--window 5, not 7",
        ("--window", 5, "--overlap", 2, "--frames", "0:5"): "--frames 0::1, not 0:5:1",
        (*part, "--width", 32): "--width 64, not 32",
        (*part, "--hold-out", 3): "--hold-out 0, not 3",
        (*part, "--profile", "wild"): "--profile quick, not wild",
        (*part, "--set", "steps=9"): "--set steps=24, not 9",
    }.items():
        sentence = refuses(capsys, *asked, *changed, "--resume")
        assert f"it was made with {result}; give" in sentence and sentence.endswith("[F4X-RESUME]")
    assert [path.name for path in out.rglob("*") if path.is_file()] == ["plan.json"]
    shutil.rmtree(out)
    (out / "checkpoints").mkdir(parents=True)
    assert "--window 0 (all at once), not 5" in refuses(capsys, *asked, *part, "--resume")


@pytest.mark.usefixtures("bare_page")
def test_a_fit_at_once_is_not_continued_with_other_options_and_names_the_first(tmp_path, capsys, monkeypatch, fitted):
    clip, out = fitted[0], tmp_path / "out"
    shutil.copytree(fitted[1], out)
    asked = ("fit", clip, "-o", out, *FAST[:-1])
    with monkeypatch.context() as patch:
        patch.setattr(pipeline, "build_priors", None)
        for changed, result in {
            ("--frames", "0:5"): "--frames 0::1, not 0:5:1",
            ("--width", 32): "--width 64, not 32",
            ("--hold-out", 3): "--hold-out 0, not 3",
            ("--profile", "wild"): "--profile quick, not wild",
            ("--set", "steps=9"): "--set steps=24, not 9",
        }.items():
            sentence = refuses(capsys, *asked, *changed, "--resume")
            assert f"it was made with {result}; give" in sentence and sentence.endswith("[F4X-RESUME]")
        (out / "options.json").unlink()  # of an older version
        assert "with other settings or another clip" in refuses(capsys, *asked, "--hold-out", 3, "--resume")
    fit(capsys, clip, out, "--frames", "0:6", "--set", "checkpoint_every=7", "--resume")  # which is the same


def interrupted(*_):
    raise KeyboardInterrupt


@pytest.mark.usefixtures("bare_page")
def test_a_new_fit_at_once_where_windows_were_can_be_resumed(tmp_path, capsys, monkeypatch, fitted):
    clip, out = fitted[0], tmp_path / "out"
    asked = ("fit", clip, "-o", out, *FAST[:-1])
    with monkeypatch.context() as patch:
        patch.setattr(fitting, "fit_long", interrupted)
        refuses(capsys, *asked, "--window", 5, "--overlap", 2, code=130)
        patch.setattr(fitting, "fit_at_once", interrupted)
        refuses(capsys, *asked, code=130)
    fit(capsys, clip, out, "--resume")


@pytest.mark.usefixtures("ctrl_c", "bare_page")
@pytest.mark.parametrize("stage", [pytest.param("motion", marks=pytest.mark.slow), "photometric"])
def test_ctrl_c_then_the_same_command_again_starts_over(tmp_path, capsys, monkeypatch, fitted, stage):
    clip, whole = fitted
    with monkeypatch.context() as patch:
        press_at(patch, stage)
        refuses(capsys, "fit", clip, "-o", tmp_path / "out", *FAST[:-1], code=130)
    fit(capsys, clip, tmp_path / "out")
    assert arrays_of(tmp_path / "out" / "scene.f4x") == arrays_of(whole / "scene.f4x")


@pytest.mark.usefixtures("ctrl_c", "bare_page")
def test_a_second_ctrl_c_is_answered_at_once(tmp_path, capsys, monkeypatch, fitted):
    """Even in the middle of a step: then the last checkpoint is what remains."""
    clip, whole = fitted
    from f4x_core.fit.trainer import Trainer

    step = Trainer.train_step

    def impatient(stage):
        if stage.step == 17:
            stage.model.static.parameters["means"].data += 1  # half a step
            signal.raise_signal(signal.SIGINT)
            signal.raise_signal(signal.SIGINT)
        return step(stage)

    with monkeypatch.context() as patch:
        patch.setattr(Trainer, "train_step", impatient)
        refuses(capsys, "fit", clip, "-o", tmp_path / "out", *FAST[:-1], code=130)
    fit(capsys, clip, tmp_path / "out", "--resume")
    assert arrays_of(tmp_path / "out" / "scene.f4x") == arrays_of(whole / "scene.f4x")


@pytest.mark.usefixtures("ctrl_c", "bare_page")
def test_ctrl_c_while_rendering_leaves_whole_pictures(tmp_path, capsys, monkeypatch, fitted):
    press_at(monkeypatch, "render")
    assert refuses(capsys, "render", fitted[1] / "scene.f4x", "-o", tmp_path / "r", code=130) == "Stopped."
    pictures = sorted((tmp_path / "r").rglob("*"))
    assert len(pictures) == 4 and not unfinished(tmp_path)  # the folder and three pictures
    for file in pictures[1:]:
        Image.open(file).load()
