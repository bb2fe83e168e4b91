"""The page of `f4x open`: what is in it, and in a headless browser its picture against the renderer's own."""

import dataclasses
import json
import re
import time

import numpy as np
import pytest
from browser import DRIVER, PATIENCE, PROGRAM, Browser
from random_scene import random_scene

from f4x_core.cli import main
from f4x_core.geometry.trajectory import aside
from f4x_core.scene import write_scene
from f4x_core.scene.formats import export
from f4x_core.scene.formats.web import PageOptions, write_page
from f4x_core.scene.view import render

ROUNDING = 40.0
"""dB, 1 % of the colours: what bytes of colour, opacity and scale (to 3 %) may move; 45 was tried and missed by 0.2."""
READY = "document.getElementById('clock').textContent"
needs_browser = pytest.mark.skipif(PROGRAM is None or DRIVER is None, reason="no Chromium with chromedriver here")


@pytest.fixture(scope="module")
def browser(tmp_path_factory):
    with Browser(tmp_path_factory.mktemp("profile")) as opened:
        yield opened


def picture(browser, page, **asked):
    """(H,W,3) in [0, 1]: what the browser shows of a page at a frame and angle."""
    browser.open(f"{page.as_uri()}#picture&" + "&".join(f"{name}={value}" for name, value in asked.items()))
    browser.wait_for("document.getElementById('message').textContent.startsWith('data:')")
    return browser.picture()


def db(shown, scene, frame, yaw=0.0, pitch=0.0):
    """PSNR of a picture of the browser against the renderer's own of its size."""
    camera, moment = aside(scene.cameras, float(scene.cameras.times[frame]), yaw, pitch)
    expected = render(scene, camera.resized(*shown.shape[1::-1]), moment, ("rgb",))["rgb"]
    return -10 * np.log10(np.mean((shown - np.clip(expected, 0, 1)) ** 2))


def press_play(browser, then):
    """Press the button, which then says what it does next."""
    browser.click("#play")
    assert browser.value("document.getElementById('play').textContent") == then


@needs_browser
@pytest.mark.parametrize(("frame", "yaw", "pitch"), [(0, 0, 0), (4, 0, 0), (3, 8, -5)])
def test_the_browser_shows_what_the_renderer_shows(browser, tmp_path, frame, yaw, pitch):
    scene = random_scene(static=200, dynamic=100, degree=0)
    write_page(scene, tmp_path / "a.html")
    assert (
        db(picture(browser, tmp_path / "a.html", frame=frame, yaw=yaw, pitch=pitch), scene, frame, yaw, pitch)
        > ROUNDING
    )


@needs_browser
def test_what_is_opaque_comes_and_goes_in_the_browser_too(browser, tmp_path):
    scene = random_scene(static=200, dynamic=100, degree=0)
    opaque = np.full(100, 0.9985, np.float32)  # which a byte rounds to 1
    span = np.tile(np.float32([-9, -8, 3, 5.05]), (100, 1))
    scene = dataclasses.replace(scene, dynamic=dataclasses.replace(scene.dynamic, opacities=opaque, span=span))
    write_page(scene, tmp_path / "a.html")
    assert db(picture(browser, tmp_path / "a.html", frame=5), scene, 5) > ROUNDING


@needs_browser
def test_a_word_colours_its_gaussians_alone(browser, tmp_path):
    scene = random_scene(static=200, dynamic=100, degree=0)
    words = {"it": np.arange(300) >= 200, "nothing": np.zeros(300, bool)}
    write_page(scene, tmp_path / "a.html", PageOptions(words=words))
    plain, marked, none = (picture(browser, tmp_path / "a.html", word=word) for word in ("", "it", "nothing"))
    np.testing.assert_array_equal(plain, none)
    assert np.abs(marked - plain).max() > 0.1


@needs_browser
def test_a_page_plays_at_once_and_pauses(browser, tmp_path):
    write_page(random_scene(), tmp_path / "a.html")
    browser.open((tmp_path / "a.html").as_uri())
    for moment in ("0.1 s", "0.2 s", "0.0 s"):  # six frames, then from the start
        browser.wait_for(f"{READY} === '{moment}'")
    press_play(browser, "Play")
    assert len({browser.value(READY) for _ in range(20)}) == 1


@needs_browser
def test_a_link_to_a_moment_stands_until_it_is_played(browser, tmp_path):
    write_page(random_scene(), tmp_path / "a.html")
    for frame, shown in ((0, "0.0 s"), (5, "0.2 s")):
        browser.open((tmp_path / "a.html").as_uri() + f"#frame={frame}")
        browser.wait_for(READY)
        assert {browser.value(READY) for _ in range(20)} == {shown}
        press_play(browser, "Pause")
        browser.wait_for(f"{READY} === '0.1 s'")


@needs_browser
def test_splats_without_time_show_no_player(browser, tmp_path):
    export(random_scene(), tmp_path / "a.ply", [0.0], "ply")
    main(["open", str(tmp_path / "a.ply"), "--write", str(tmp_path / "a.html")])
    browser.open((tmp_path / "a.html").as_uri())
    browser.wait_for(READY)
    assert not browser.value("document.querySelector('#play, #time, #clock').checkVisibility()")
    assert "up to 5°." in browser.wait_for("document.getElementById('message').textContent")


@needs_browser
def test_a_drag_turns_as_far_as_the_scene_is_believed(browser, tmp_path):
    scene = dataclasses.replace(random_scene(static=200, dynamic=100, degree=0), provenance={"believed_degrees": 6})
    write_page(scene, tmp_path / "a.html")
    browser.open((tmp_path / "a.html").as_uri() + "#frame=3")
    browser.wait_for(READY)
    before = browser.picture()
    browser.drag(-300, 0)
    deadline = time.monotonic() + PATIENCE
    while np.array_equal(shown := browser.picture(), before):
        assert time.monotonic() < deadline
    assert db(shown, scene, 3, 6) > ROUNDING


@needs_browser
def test_a_page_fits_a_phone(browser, tmp_path):
    words = {f"word {i}": np.zeros(50, bool) for i in range(12)}
    write_page(random_scene(), tmp_path / "a.html", PageOptions(words=words))
    browser.resize(390, 700)
    browser.open((tmp_path / "a.html").as_uri())
    browser.wait_for(READY)
    for side in ("Width", "Height"):
        assert browser.value(f"document.documentElement.scroll{side} <= inner{side}")
    assert browser.value("document.querySelector('canvas').clientHeight") > 200


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
