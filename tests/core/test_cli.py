"""The command line: what it prints, how it fails, what it leaves behind."""

import json

import numpy as np
import pytest
from PIL import Image
from toy import clip_and_priors

from f4x_core.cli import fitting as cli_fitting
from f4x_core.cli import main
from f4x_core.fit import pipeline
from f4x_core.scene import read_scene


def write_frames(folder, frames):
    folder.mkdir(parents=True, exist_ok=True)
    for index, frame in enumerate(frames):
        Image.fromarray(frame).save(folder / f"{index:03d}.png")
    return folder


def fails(capsys, *arguments):
    """Run a command that must fail; return its one sentence."""
    assert main([*map(str, arguments)]) == 2
    lines = capsys.readouterr().err.strip().splitlines()
    assert len(lines) == 1 and lines[0].startswith(f"f4x {arguments[0]}: ")
    return lines[0]


@pytest.fixture
def toy_fit(tmp_path, monkeypatch, capsys):
    """A small fitted toy clip: (clip folder, output folder)."""
    clip, priors = clip_and_priors(hold_out=4)
    folder = write_frames(tmp_path / "clip", clip.frames)
    monkeypatch.setattr(pipeline, "build_priors", lambda *_: priors)
    full = cli_fitting.config_of

    def short(args):
        import dataclasses

        return dataclasses.replace(full(args), steps=30, threads=1)

    monkeypatch.setattr(cli_fitting, "config_of", short)
    out = tmp_path / "out"
    assert main(["fit", str(folder), "-o", str(out), "--profile", "quick", "--hold-out", "4", "--json"]) == 0
    return folder, out


def test_fit_leaves_its_files_and_the_other_verbs_read_them(toy_fit, tmp_path, capsys):
    folder, out = toy_fit
    printed = json.loads(capsys.readouterr().out)
    assert printed["metrics"]["held_out_psnr"] > 15
    assert {"scene.f4x", "metrics.json", "diagnostics.html", "checkpoints"} <= {p.name for p in out.iterdir()}
    scene = read_scene(out / "scene.f4x")
    assert scene.held_out == (3, 7) and len(scene.cameras) == 8 and scene.needs

    assert main(["info", str(out / "scene.f4x"), "--json"]) == 0
    json.loads(capsys.readouterr().out)

    assert main(["eval", str(out / "scene.f4x"), "--clip", str(folder), "--json", "--refine-camera"]) == 0
    measured = json.loads(capsys.readouterr().out)
    assert measured["held_out_psnr"] == pytest.approx(printed["metrics"]["held_out_psnr"], abs=0.05)
    assert measured["held_out_psnr_refined"] >= measured["held_out_psnr"] - 1e-6

    frames = tmp_path / "frames"
    channels = "rgb,depth,alpha,motion"
    assert main(["render", str(out / "scene.f4x"), "-o", str(frames), "--channels", channels, "--json"]) == 0
    for channel in channels.split(","):
        assert len(list((frames / channel).glob("*.png"))) == 8, channel
    assert Image.open(frames / "rgb" / "00000.png").size == (64, 40)
    for path in ("orbit", "frozen:2.5"):
        assert main(["render", str(out / "scene.f4x"), "-o", str(tmp_path / path[:4]), "--path", path, "--json"]) == 0
    assert main(["export", str(out / "scene.f4x"), "-o", str(tmp_path / "one.ply"), "--time", "2", "--json"]) == 0


def test_eval_of_another_clip_is_refused(toy_fit, tmp_path, capsys):
    _, out = toy_fit
    capsys.readouterr()
    other = write_frames(tmp_path / "other", np.zeros((3, 40, 64, 3), np.uint8))
    assert "3 frames" in fails(capsys, "eval", out / "scene.f4x", "--clip", other)


def test_bad_input_is_one_sentence_and_leaves_nothing(tmp_path, capsys):
    out = tmp_path / "out"
    (tmp_path / "empty").mkdir()
    assert "empty" in fails(capsys, "fit", tmp_path / "empty", "-o", out)
    fails(capsys, "fit", tmp_path / "absent.mp4", "-o", out)
    one = write_frames(tmp_path / "one", np.zeros((1, 40, 64, 3), np.uint8))
    assert "too few" in fails(capsys, "fit", one, "-o", out)
    two = write_frames(tmp_path / "two", np.zeros((2, 40, 64, 3), np.uint8))
    assert "too few" in fails(capsys, "fit", two, "-o", out)
    broken = write_frames(tmp_path / "broken", np.zeros((4, 40, 64, 3), np.uint8))
    (broken / "002.png").write_bytes(b"not a picture")
    assert "002.png" in fails(capsys, "fit", broken, "-o", out)
    assert "--prior depth" in fails(capsys, "fit", one, "-o", out, "--prior", "depth")
    assert not out.exists()
    fails(capsys, "info", tmp_path / "absent.f4x")
    damaged = tmp_path / "damaged.f4x"
    damaged.write_bytes(b"PK\x03\x04 but no more")
    assert "damaged.f4x" in fails(capsys, "info", damaged)


def test_json_errors_are_one_object(tmp_path, capsys):
    assert main(["info", str(tmp_path / "absent.f4x"), "--json"]) == 2
    assert "absent.f4x" in json.loads(capsys.readouterr().out)["error"]


def test_render_refuses_unknown_channels_and_paths(toy_fit, tmp_path, capsys):
    _, out = toy_fit
    capsys.readouterr()
    scene = out / "scene.f4x"
    assert "smell" in fails(capsys, "render", scene, "-o", tmp_path / "r", "--channels", "smell")
    assert "frozen:T" in fails(capsys, "render", scene, "-o", tmp_path / "r", "--path", "frozen:now")
    fails(capsys, "render", scene, "-o", tmp_path / "r", "--path", tmp_path / "absent.json")
    assert not (tmp_path / "r").exists()


def test_doctor_names_every_backend(capsys):
    assert main(["doctor", "--json"]) == 0
    report = json.loads(capsys.readouterr().out)
    assert set(report["backends"]) == {"native", "torch"}
    assert "ms for" in report["backends"]["torch"]
