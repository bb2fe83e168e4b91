"""The command line: what it prints, how it fails, what it leaves behind."""

import json
import math
import os
import re
import signal
import subprocess
import sys
from importlib.metadata import PackageNotFoundError
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from labelled_scene import labelled_scene
from PIL import Image
from toy import clip_and_priors

from f4x_core import __version__
from f4x_core.app import fitting as app_fitting
from f4x_core.app.fit_options import FitOptions, FitRequest
from f4x_core.app.granting import detail_in_words, granted
from f4x_core.cli import doctor, main, terminal
from f4x_core.cli import fitting as cli_fitting
from f4x_core.cli.terminal import TerminalProgress
from f4x_core.fit import pipeline
from f4x_core.fit.budget import ClipSize, MachineSpeed
from f4x_core.fit.config import profile
from f4x_core.scene import read_scene, write_scene

ROOT = Path(__file__).parents[2]


def write_frames(folder, frames):
    folder.mkdir(parents=True, exist_ok=True)
    for index, frame in enumerate(frames):
        Image.fromarray(frame).save(folder / f"{index:03d}.png")
    return folder


def fails(capsys, *arguments):
    """Run a command that must fail; return its one sentence."""
    assert main([*map(str, arguments)]) == 2
    *stages, sentence = capsys.readouterr().err.splitlines()
    assert stages in ([], ["reading clip"]) and sentence.startswith(f"f4x {arguments[0]}: ")
    return sentence


@pytest.fixture
def toy_fit(tmp_path, monkeypatch, capsys):
    """A small fitted toy clip: (clip folder, output folder)."""
    clip, priors = clip_and_priors(hold_out=4)
    priors.statistics["changes"] = {"cuts": [3], "exposure": 1.0}
    folder = write_frames(tmp_path / "clip", clip.frames)
    monkeypatch.setattr(pipeline, "build_priors", lambda *_: priors)
    full = cli_fitting.config_of

    def short(args):
        import dataclasses

        return dataclasses.replace(full(args), steps=30, threads=1)

    monkeypatch.setattr(cli_fitting, "config_of", short)
    measured = app_fitting.evaluate

    def evaluate(*given, **more):
        result = measured(*given, **more)
        result["frames"][0]["psnr_moving"] = math.nan  # a frame in which nothing moves
        return result

    monkeypatch.setattr(app_fitting, "evaluate", evaluate)
    out = tmp_path / "out"
    assert main(["fit", str(folder), "-o", str(out), "--profile", "quick", "--hold-out", "4", "--json"]) == 0
    return folder, out


def test_fit_leaves_its_files_and_the_other_verbs_read_them(toy_fit, tmp_path, capsys):
    folder, out = toy_fit
    printed = json.loads(capsys.readouterr().out)
    assert printed["metrics"]["held_out_psnr"] > 15
    assert "2 shots, cut at frame 3 of" in printed["note"] and "--frames 3:8:1" in printed["note"]
    assert {"scene.f4x", "metrics.json", "diagnostics.html", "checkpoints"} <= {p.name for p in out.iterdir()}
    rows = json.loads((out / "metrics.json").read_text(), parse_constant=pytest.fail)["frames"]
    assert rows[0]["psnr_moving"] is None and rows[1]["psnr_moving"] > 10
    scene = read_scene(out / "scene.f4x")
    assert scene.held_out == (3, 7) and len(scene.cameras) == 8 and scene.needs

    assert main(["info", str(out / "scene.f4x"), "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["frames"] == 8
    assert main(["info", str(out / "scene.f4x")]) == 0
    result = capsys.readouterr()
    assert result.err == "" and 8 <= len(result.out.splitlines()) <= 12
    assert "64x40" in result.out and f"{folder}, frames 0:8:1" in result.out and __version__ in result.out

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
    some = tmp_path / "some"
    assert main(["render", str(out / "scene.f4x"), "-o", str(some), "--frames", "2:8:2", "--part", "2/2"]) == 0
    assert [path.name for path in sorted((some / "rgb").iterdir())] == ["00004.png", "00006.png"]
    capsys.readouterr()
    assert main(["render", str(out / "scene.f4x"), "-o", str(some), "--part", "1/20"]) == 0
    assert capsys.readouterr().out.endswith(": 0 frames; 8 frames in 20 parts leave nothing for --part 1/20\n")
    large = ["render", str(out / "scene.f4x"), "-o", str(tmp_path / "large"), "--frames", "0:1"]
    assert main([*large, "--channels", "rgb,motion", "--width", "200"]) == 0
    assert Image.open(tmp_path / "large" / "rgb" / "00000.png").size == (200, 124)
    again = np.asarray(
        Image.open(tmp_path / "large" / "rgb" / "00000.png").resize((64, 40), Image.Resampling.BOX), float
    )
    assert np.abs(again - np.asarray(Image.open(frames / "rgb" / "00000.png"), float)).mean() < 6  # the same view
    capsys.readouterr()
    assert main([*large, "--width", "8"]) == 2
    assert "--width 8: give a number of pixels from 16 to 16384" in capsys.readouterr().err
    for path in ("orbit", "frozen:2.5"):
        assert main(["render", str(out / "scene.f4x"), "-o", str(tmp_path / path[:4]), "--path", path, "--json"]) == 0
    assert main(["export", str(out / "scene.f4x"), "-o", str(tmp_path / "one.ply"), "--time", "2", "--json"]) == 0
    assert main(["export", str(out / "scene.f4x"), "-o", str(tmp_path / "all"), "--json"]) == 0
    assert sorted(path.name for path in (tmp_path / "all").iterdir())[0] == "clip_0000.ply"


def test_a_fit_tells_its_cost_and_keeps_what_it_was_granted(toy_fit, tmp_path, capsys, monkeypatch):
    folder, _ = toy_fit
    capsys.readouterr()
    fit = ["fit", str(folder), "-o", str(tmp_path / "granted"), "--profile", "quick"]
    assert main([*fit, "--minutes", "20", "--memory", "1.5"]) == 0
    result = capsys.readouterr().err
    assert re.search(
        r"cost \(about [\d.]+ minutes on an idle machine, [\d.]+ GB of memory and a scene of \d+ MB", result
    )
    assert "room for" not in result, "more than the clip can ask for"
    first = read_scene(tmp_path / "granted" / "scene.f4x").provenance["config"]["density_static"]["max_count"]
    monkeypatch.setattr(
        MachineSpeed, "measured", lambda threads: MachineSpeed(2e-3, 2)
    )  # now the same grant has room for more
    assert main([*fit, "--minutes", "20", "--memory", "1.5", "--resume"]) == 0
    again = read_scene(tmp_path / "granted" / "scene.f4x").provenance["config"]["density_static"]["max_count"]
    assert again == first != profile("quick").density_static.max_count
    for wrong in ("0", "-1", "nan"):
        assert main([*fit, "--minutes", wrong]) == 2
        assert "give a number above 0" in capsys.readouterr().err
    assert main([*fit, "--memory", "0.1"]) == 2
    assert "grant more (--memory), or give fewer --frames" in capsys.readouterr().err


def test_what_larger_images_show_and_cost_is_told(tmp_path, monkeypatch):
    rng = np.random.default_rng(0)
    folder = write_frames(tmp_path / "clip", rng.integers(0, 255, (2, 54, 960, 3), np.uint8))
    result = {}
    monkeypatch.setattr(MachineSpeed, "measured", lambda threads: MachineSpeed(0.02, 2))
    request = FitRequest(folder, tmp_path, FitOptions(profile("quick")))
    config = granted(request, ClipSize(2, 480, 27), lambda stage, *rest: result.setdefault(stage, rest[-1]))
    assert config is not None and not (tmp_path / "grant.json").exists()
    assert re.fullmatch(
        r"the clip is 960 pixels wide; 480, as now: soft all over \(1\d dB\), [\d.]+ minutes;"
        r" --width 854: soft all over \(\d+ dB\), [\d.]+ minutes",
        result["larger pictures"],
    )


@pytest.mark.parametrize(
    ("psnr", "words"),
    [
        (math.inf, "all of"),
        (35, r"hardly .*\(35 dB\)"),
        (34, "fine detail"),
        (29, "fine detail .* missing"),
        (20, "soft all over"),
    ],
)
def test_decibels_are_told_as_what_is_seen(psnr, words):
    assert re.match(words, detail_in_words(psnr))


def test_what_is_not_a_number_is_null_for_other_programs(monkeypatch, capsys):
    result = {"psnr": math.nan, "rows": [{"error": np.float32("inf"), "share": np.float64(0.5)}], "count": 3}
    monkeypatch.setattr(sys.modules[main.__module__], "find_verb", lambda _: lambda *_: dict(result))
    plain = {"psnr": None, "rows": [{"error": None, "share": 0.5}], "count": 3}
    assert main(["doctor", "--json"]) == 0
    assert json.loads(capsys.readouterr().out, parse_constant=pytest.fail) == plain
    assert main(["doctor", "--progress-json"]) == 0
    assert json.loads(capsys.readouterr().out.splitlines()[-1], parse_constant=pytest.fail)["result"] == plain


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
    for path in (tmp_path / "absent.json", "sideways", "frozen"):
        sentence = fails(capsys, "render", scene, "-o", tmp_path / "r", "--path", path)
        assert "original, orbit, stabilise" in sentence and "(0 to 7)" in sentence
    for time in ("nan", 99, -1):
        assert "frames, 0 to 7" in fails(capsys, "render", scene, "-o", tmp_path / "r", "--path", f"frozen:{time}")
        assert "frames, 0 to 7" in fails(capsys, "export", scene, "-o", tmp_path / "r.ply", f"--time={time}")
    for degrees in ("nan", 0, -5, 90, 400):
        assert "above 0 and below 90" in fails(capsys, "render", scene, "-o", tmp_path / "r", f"--degrees={degrees}")
    sentence = fails(capsys, "render", scene, "-o", tmp_path / "r", "--path", "orbit", "--frames", "40:50")
    assert "--path orbit has frames 0:8, frames 40:50 reach beyond" in sentence
    assert "choose from 'auto'" in fails(capsys, "render", scene, "-o", tmp_path / "r", "--backend", "gsplat")
    assert "FILE.ply" in fails(capsys, "export", scene, "-o", tmp_path / "r", "--time", 2)
    assert "FILE.ply" in fails(capsys, "export", scene, "-o", tmp_path / "r.ply")
    assert not (tmp_path / "r").exists() and not (tmp_path / "r.ply").exists()


def test_a_word_of_the_command_line_that_is_misspelt_is_asked_about(capsys):
    assert "there is no 'aks'; did you mean 'ask'? `f4x --help`" in fails(capsys, "aks", "a.f4x")
    assert "there is no 'quik'; did you mean 'quick'?" in fails(capsys, "fit", "a", "-o", "b", "--profile", "quik")
    assert "choose from 'fit', 'priors'" in fails(capsys, "xyzzy")


def test_the_folder_of_a_fit_is_its_scene(tmp_path, capsys):
    write_scene(labelled_scene(), tmp_path / "scene.f4x")
    assert main(["info", str(tmp_path)]) == 0
    result = capsys.readouterr().out
    assert main(["info", str(tmp_path / "scene.f4x")]) == 0 and capsys.readouterr().out == result
    assert "\nlooked for: square, wall" in result
    assert "there is no such file" in fails(capsys, "info", tmp_path / "nowhere")


def test_doctor_names_every_backend(capsys):
    assert main(["doctor", "--json"]) == 0
    report = json.loads(capsys.readouterr().out)
    assert set(report["backends"]) == {"native", "torch", "gsplat"}
    assert "ms for" in report["backends"]["torch"]


def test_doctor_says_what_can_be_done_and_what_is_missing_for_the_rest(capsys, monkeypatch):
    monkeypatch.setattr(doctor, "version", lambda name: "1.0")
    assert main(["doctor"]) == 0 and "a fit: ready\nwords, --features text,visual: ready" in capsys.readouterr().out

    def only_torch(name):
        if name != "torch":
            raise PackageNotFoundError
        return "2"

    monkeypatch.setattr(doctor, "version", only_torch)
    assert main(["doctor"]) == 0
    *_, fit, words, people = capsys.readouterr().out.splitlines()
    assert fit == "a fit: missing; pip install scipy opencv-python-headless av pycolmap"
    assert "missing; pip install --no-deps efficientnet-lite-pytorch " in words
    assert people == "people: missing; pip install --no-deps ai-edge-litert mediapipe==0.10.21"


def test_a_log_tells_when_a_stage_begins_and_of_a_long_one_now_and_then(capsys, monkeypatch):
    clock = iter(range(0, 1000, 4))  # seconds: every report takes four
    monkeypatch.setattr(terminal, "time", SimpleNamespace(monotonic=lambda: next(clock)))
    with TerminalProgress() as progress:
        for window in ("window 1 of 2", "window 2 of 2"):
            for done in range(3):
                progress("flow", done, 2, window)
        for done in range(101):
            progress("photometric", done, 100)
    first, again, stage, *tenths = capsys.readouterr().err.splitlines()
    assert (first, again, stage) == ("flow (window 1 of 2)", "flow (window 2 of 2)", "photometric")
    assert tenths[0] == "photometric: 10 of 100 after 0:00:40" and len(tenths) == 10


def test_bars_are_complete_in_the_end_and_fit_a_narrow_terminal(capsys, monkeypatch):
    monkeypatch.setenv("FORCE_COLOR", "1")  # rich draws as on a terminal
    monkeypatch.setenv("TERM", "xterm")
    monkeypatch.setenv("COLUMNS", "80")
    with TerminalProgress() as progress:
        progress("scaffold geometry", 2901, 3000, "a long message that no narrow terminal has room for, not at all")
    last = capsys.readouterr().err.replace("\r", "\n").splitlines()[-2:]
    plain = re.sub(r"\x1b\[[0-9;?]*[a-zA-Z]", "", "".join(last)).strip()
    assert "3000/3000" in plain and plain.endswith("…") and len(plain) <= 80


@pytest.mark.usefixtures("ctrl_c")
def test_ctrl_c_is_announced_and_before_the_first_report_answered_at_once(capsys):
    with pytest.raises(KeyboardInterrupt), TerminalProgress():
        signal.raise_signal(signal.SIGINT)
    assert capsys.readouterr().err == ""
    with pytest.raises(KeyboardInterrupt), TerminalProgress() as progress:
        progress("flow", 0, 2)
        signal.raise_signal(signal.SIGINT)
        progress("flow", 1, 2)
    assert "press Ctrl-C again" in capsys.readouterr().err


def test_an_ignored_ctrl_c_stays_ignored(capsys):
    before = signal.signal(signal.SIGINT, signal.SIG_IGN)
    try:
        with TerminalProgress() as progress:
            assert signal.getsignal(signal.SIGINT) is signal.SIG_IGN
            progress("flow", 0, 2)
            signal.raise_signal(signal.SIGINT)
            progress("flow", 1, 2)
        assert signal.getsignal(signal.SIGINT) is signal.SIG_IGN
    finally:
        signal.signal(signal.SIGINT, before)
    assert "Ctrl-C" not in capsys.readouterr().err


@pytest.mark.skipif(os.name == "nt", reason="no SIGINT for one process there")
def test_a_child_stops_with_its_parent_though_ctrl_c_was_ignored_at_its_start():
    """As under `nohup f4x batch`: what a process ignores, its children ignore from their start."""
    code = """
import signal, sys, time
from f4x_core.processes import stop_with_parent
assert signal.getsignal(signal.SIGINT) is signal.SIG_IGN
stop_with_parent()
try:
    print("working", flush=True)
    time.sleep(60)
except KeyboardInterrupt:
    print("saved", flush=True)
"""
    before = signal.signal(signal.SIGINT, signal.SIG_IGN)
    try:
        pipe = subprocess.PIPE
        child = subprocess.Popen(
            [sys.executable, "-c", code], stdin=pipe, stdout=pipe, text=True, start_new_session=True
        )
    finally:
        signal.signal(signal.SIGINT, before)
    assert child.stdout.readline() == "working\n"
    assert child.communicate(timeout=30)[0] == "saved\n"


def test_help_waits_for_no_heavy_package():
    script = (
        "import sys; from f4x_core.cli.parser import build_parser; build_parser();"
        " print(sorted({'torch', 'scipy', 'cv2', 'transformers'} & sys.modules.keys()))"
    )
    result = subprocess.run([sys.executable, "-c", script], cwd=ROOT, capture_output=True, text=True, check=True)
    assert result.stdout.strip() == "[]"


def test_threads_sleep_while_they_wait_unless_it_is_said_otherwise(monkeypatch):
    """Before torch is imported, which reads it then."""
    monkeypatch.delenv("OMP_WAIT_POLICY", raising=False)
    asked = (
        "import os, sys; from f4x_core.cli import main; main(['info', 'none.f4x']);"
        " print(os.environ['OMP_WAIT_POLICY'], 'torch' in sys.modules)"
    )

    def answer(**own):
        child = subprocess.run([sys.executable, "-c", asked], env=os.environ | own, capture_output=True, check=True)
        return child.stdout.decode().split()

    assert answer() == ["PASSIVE", "False"] and answer(OMP_WAIT_POLICY="ACTIVE") == ["ACTIVE", "False"]
