"""What the demo does around the fit: rendering once, child processes, words."""

import json
from pathlib import Path

import pytest

from f4x_core.cli import demo
from f4x_core.errors import Cancelled, F4xError
from f4x_core.progress import silent


@pytest.fixture
def scripts(tmp_path: Path, monkeypatch) -> Path:
    """A scripts folder of our own."""
    folder = tmp_path / "scripts"
    folder.mkdir()
    monkeypatch.setattr(demo, "SCRIPTS", folder)
    return folder


RENDER = """
import pathlib, sys
images = pathlib.Path(sys.argv[1]) / "images"
images.mkdir()
(images / "00000.png").touch()
with open(pathlib.Path(__file__).parent / "calls", "a") as calls:
    calls.write(" ".join(sys.argv[2:]) + "\\n")
"""


def test_clip_is_rendered_once_and_again_when_settings_change(tmp_path: Path, scripts: Path):
    (scripts / "synthetic_clip.py").write_text(RENDER)
    folder = tmp_path / "clip"
    for seed in (0, 0, 1):
        demo.render_clip(folder, demo.DemoClip(frames=2, seed=seed), silent)
    calls = (scripts / "calls").read_text().splitlines()
    assert [call.split("--seed ")[1].split()[0] for call in calls] == ["0", "1"]
    assert all("--frames 2 --size 288x162" in call and call.endswith("--extra-cameras 10") for call in calls)


def test_an_unfinished_render_is_not_used_and_other_files_stay(tmp_path: Path, scripts: Path):
    (scripts / "synthetic_clip.py").write_text("raise SystemExit('no light')")
    folder = tmp_path / "clip"
    (folder / "images").mkdir(parents=True)
    (folder / "images" / "00007.png").touch()
    (folder / "notes.txt").write_text("mine")
    with pytest.raises(F4xError, match=r"synthetic_clip.py failed: no light"):
        demo.render_clip(folder, demo.DemoClip(), silent)
    assert not (folder / demo.SETTINGS).exists() and not (folder / "images").exists()
    assert (folder / "notes.txt").read_text() == "mine"
    (scripts / "synthetic_clip.py").write_text(RENDER)
    demo.render_clip(folder, demo.DemoClip(), silent)
    assert json.loads((folder / demo.SETTINGS).read_text())["frames"] == 30


def test_cancelling_ends_the_child(tmp_path: Path, scripts: Path):
    (scripts / "slow.py").write_text(f"import time; time.sleep(20); open({str(tmp_path / 'done')!r}, 'w')")

    def cancel():
        raise Cancelled

    with pytest.raises(Cancelled):
        demo.run_script("slow.py", look=cancel)
    assert not (tmp_path / "done").exists()


def test_a_place_without_scripts_is_one_sentence(tmp_path: Path, scripts: Path):
    with pytest.raises(F4xError, match="checkout of the repository"):
        demo.render_clip(tmp_path / "clip", demo.DemoClip(), silent)


def test_scores_are_told_in_words():
    scores = {
        "ate_fraction": 0.0123,
        "rotation_error": 0.4,
        "unseen_psnr": 23.456,
        "unseen_ssim": 0.8,
        "views": [{}] * 18,
    }
    scores |= {"unseen_psnr_covered": 25.0, "unseen_covered_fraction": 0.917, "unseen_psnr_covered_refined": 26.5}
    text = "\n".join(demo.score_lines(scores))
    assert "1.23% of its length" in text and "23.46 dB, SSIM 0.800 over 18 pictures" in text
    assert "did see (92% of the pixels): 25.00 dB, 26.50 dB" in text
    assert "cannot be compared" in demo.score_lines({"ate_fraction": 1.0, "rotation_error": 9.0})[-1]
