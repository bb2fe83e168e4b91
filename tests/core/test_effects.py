"""Sentences by what they do to the Gaussians of made-up scenes whose true objects are known."""

import effects
import pytest

OPEN, SEALED = effects.read(effects.EFFECTS), effects.read(effects.SEALED)


@pytest.mark.parametrize("scene", ["street", "crowd", "room"])
def test_sentences_do_what_is_said(scene):
    rows = [row for row in OPEN if row[0] == scene]
    assert {row[2]: why for row in rows if (why := effects.fault(row))} == {}
