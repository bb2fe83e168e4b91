"""The viewport of a real Blender: outline and clicks are where the picture is, and a saved .blend shows it again."""

import sys
import time
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

pytestmark = [pytest.mark.real, pytest.mark.blender]
sys.path.insert(0, str(Path(__file__).resolve().parents[2] / "tools"))
from step_pictures import SIZE, blender  # noqa: E402 - the tools are no package

ORANGE, NEAR = (241, 88, 0), 60
"""Color of an outline, and how far a channel of an antialiased one may be from it."""
WIDTH = 60
"""Half the side of a square that holds the ball, pixels."""
SETTLE = 1.5
"""Seconds in which the modifier has followed what the viewport does."""


@pytest.fixture(scope="module")
def guide(blender_root, tmp_path_factory):
    """A Blender whose viewport shows the scene of a rolling ball through the clip's camera."""
    with blender(blender_root, tmp_path_factory.mktemp("picking"), SIZE) as found:
        found.take("maximise")
        found.take("drop")
        found.hand("key", "Return")
        found.expect("import", lambda state: bool(state.get("total")))
        found.take("look")
        found.take("choose_tab")
        yield found


def chosen_at(guide, which: int) -> list[str]:
    """Names of the objects that a click on a target selects: 0 = the ball, 1 = the wall where the ball is stored."""
    place = guide.take("targets")["places"][which]
    guide.hand("mousemove", *map(round, place))
    guide.hand("click", 1)
    time.sleep(SETTLE)
    return guide.state()["chosen"]


def orange_at(guide, name: str) -> list[int]:
    """Pixels of an outline around the ball and around the place where it is stored."""
    guide.screenshot(name)
    picture = np.asarray(Image.open(guide.out / f"{name}.png").convert("RGB")).astype(int)
    outline = np.abs(picture - ORANGE).max(-1) < NEAR
    (x, y), (stored, _) = np.round(guide.state()["places"]).astype(int)
    return [int(outline[y - WIDTH : y + WIDTH, at - WIDTH // 2 : at + WIDTH].sum()) for at in (x, stored - WIDTH // 2)]


def test_a_still_picture_is_picked_and_outlined_where_it_is(guide):
    time.sleep(SETTLE)
    assert not guide.state()["carried"]
    assert "room dynamic" not in chosen_at(guide, 1)
    assert chosen_at(guide, 0) == ["room dynamic"]
    around, elsewhere = orange_at(guide, "outline")
    assert around > 100 and elsewhere < around / 10, (around, elsewhere)


def test_playback_is_posed_by_the_core_and_clicks_still_find_what_is_seen(guide):
    guide.take("play")
    guide.expect("carried", lambda state: state["carried"] and not state["outlined"])
    guide.expect("away", lambda state: state["frame"] >= 10)
    assert "room dynamic" not in chosen_at(guide, 1)
    guide.expect("carried again", lambda state: state["carried"])
    assert chosen_at(guide, 0) == ["room dynamic"]
    guide.expect("carried once more", lambda state: state["carried"] and not state["outlined"])
    guide.take("play")
    guide.expect("stopped", lambda state: not state["carried"] and state["outlined"])


def test_a_saved_blend_opens_as_it_was_seen(guide):
    """Grey balls have no color; the ball has."""
    place = guide.take("targets")["places"][0]

    def picture(name: str) -> np.ndarray:
        guide.screenshot(name)
        x, y = np.round(place).astype(int)
        taken = np.asarray(Image.open(guide.out / f"{name}.png").convert("RGB")).astype(int)
        return taken[y - WIDTH : y + WIDTH, x - WIDTH : x + WIDTH]

    before = picture("saved")
    guide.take("reopen")
    time.sleep(SETTLE)
    after = picture("opened")
    assert np.abs(after - before).mean() < 2
    guide.take("solid")
    time.sleep(SETTLE)
    assert np.abs(picture("solid") - before).mean() > 10
