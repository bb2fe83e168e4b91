"""The page of `f4x open`: what is in it, and in a headless browser its picture against the renderer's own."""

import base64
import dataclasses
import io
import json
import re
import shutil
import subprocess

import numpy as np
import pytest
from PIL import Image
from random_scene import random_scene

from f4x_core.cli import main
from f4x_core.geometry.trajectory import aside
from f4x_core.scene import write_scene
from f4x_core.scene.formats import export
from f4x_core.scene.formats.web import PageOptions, write_page
from f4x_core.scene.view import render

BROWSER = next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), None)
SOFTWARE = ("--headless", "--no-sandbox", "--use-gl=angle", "--use-angle=swiftshader", "--enable-unsafe-swiftshader")
WAIT_MS = 60_000
"""Of the page's own clock, which runs ahead where nothing is to do."""
TRIES = 6
"""On a busy machine that clock can run out before the page's worker has sorted; then there is no picture at all."""
ROUNDING = 40.0
"""dB, 1 % of the colours: what bytes of colour, opacity and scale (to 3 %) may move; 45 was tried and missed by 0.2."""


def picture(page, profile, **asked):
    """(H,W,3) in [0, 1]: what the browser shows of a page at a frame and angle."""
    address = f"{page.as_uri()}#picture&" + "&".join(f"{name}={value}" for name, value in asked.items())
    command = [
        BROWSER,
        *SOFTWARE,
        f"--user-data-dir={profile}",
        f"--virtual-time-budget={WAIT_MS}",
        "--dump-dom",
        address,
    ]
    found = None
    for _ in range(TRIES):
        shown = subprocess.run(command, capture_output=True, text=True, timeout=120).stdout
        if found := re.search(r"data:image/png;base64,([A-Za-z0-9+/=]+)", shown):
            break
    assert found, re.search(r'id="message">(.*?)<', shown)
    return np.asarray(Image.open(io.BytesIO(base64.b64decode(found[1]))).convert("RGB")) / 255


@pytest.mark.slow
@pytest.mark.skipif(BROWSER is None, reason="no Chromium here")
@pytest.mark.parametrize(("frame", "yaw", "pitch"), [(0, 0, 0), (4, 0, 0), (3, 8, -5)])
def test_the_browser_shows_what_the_renderer_shows(tmp_path, frame, yaw, pitch):
    scene = random_scene(static=200, dynamic=100, degree=0)
    write_page(scene, tmp_path / "a.html")
    camera, time = aside(scene.cameras, float(scene.cameras.times[frame]), yaw, pitch)
    expected = np.clip(render(scene, camera, time, ("rgb",))["rgb"], 0, 1)
    shown = picture(tmp_path / "a.html", tmp_path / "profile", frame=frame, yaw=yaw, pitch=pitch)
    assert -10 * np.log10(np.mean((shown - expected) ** 2)) > ROUNDING


@pytest.mark.slow
@pytest.mark.skipif(BROWSER is None, reason="no Chromium here")
def test_a_word_colours_its_gaussians_alone(tmp_path):
    scene = random_scene(static=200, dynamic=100, degree=0)
    write_page(
        scene, tmp_path / "a.html", PageOptions(words={"it": np.arange(300) >= 200, "nothing": np.zeros(300, bool)})
    )
    plain, marked, none = (picture(tmp_path / "a.html", tmp_path / "p", word=word) for word in ("", "it", "nothing"))
    np.testing.assert_array_equal(plain, none)
    assert np.abs(marked - plain).max() > 0.1


@pytest.mark.parametrize(("told", "options", "expected"), [(3.4, (), 3.4), (None, (), 5), (3.4, ("--degrees", "9"), 9)])
def test_a_page_lets_look_as_far_as_the_scene_can_be_believed(tmp_path, told, options, expected):
    scene = dataclasses.replace(random_scene(), provenance={"believed_degrees": told})
    write_scene(scene, tmp_path / "a.f4x")
    assert main(["open", str(tmp_path / "a.f4x"), "--write", str(tmp_path / "a.html"), *options]) == 0
    data = re.search(r"const DATA = (\{.*\});", (tmp_path / "a.html").read_text(encoding="utf-8"))
    assert data is not None and json.loads(data[1])["degrees"] == expected


def test_a_page_is_one_file_and_its_names_stay_text(tmp_path, capsys):
    scene = random_scene(name="</script><b>")
    write_scene(scene, tmp_path / "a.f4x")
    assert main(["open", str(tmp_path / "a.f4x"), "--write", str(tmp_path / "a.html")]) == 0
    page = (tmp_path / "a.html").read_text(encoding="utf-8")
    assert "&lt;/script&gt;&lt;b&gt;" in page and page.count("</script>") == 1
    assert "src=" not in page and "href=" not in page
    assert str(tmp_path / "a.html") in capsys.readouterr().out


def test_splats_from_elsewhere_open_too(tmp_path):
    export(random_scene(), tmp_path / "a.ply", [0.0], "ply")
    assert main(["open", str(tmp_path / "a.ply"), "--write", str(tmp_path / "a.html")]) == 0
    assert main(["open", str(tmp_path / "a.ply"), "--write", str(tmp_path / "a.html"), "--degrees", "90"]) != 0
