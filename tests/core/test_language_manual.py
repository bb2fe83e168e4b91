"""Every sentence of the manual is understood, and every way to say who or when goes with a command."""

import re
from pathlib import Path

import pytest

from f4x_core.edit.language import parse
from f4x_core.edit.request import Request
from f4x_core.edit.selects import Ids, Text

MANUAL = (Path(__file__).parents[2] / "docs" / "language.md").read_text(encoding="utf-8")
LABELS = ("dog", "cat", "car", "tree", "wall", "ground", "ball", "lamp", "man", "person", "second person")
EARLIER = {"it": "make the dog red", "them": "make the dog red", "the copy": "copy the dog", "the cat too": "make the dog red",
           "the other dog": "make the left dog red", "everything else": "make the dog red"}  # fmt: skip
"""Sentence before, for what speaks of it."""
BY_THE_SCENE = ("person 2", "the left person's head")
"""Written as "second person" before the grammar reads them."""


def said(section):
    """The sentences of the first column of a section's table."""
    rows = re.findall(r"^\| (`.*?) \|", MANUAL.split(f"## {section}\n")[1].split("\n## ")[0], re.M)
    return [sentence for row in rows for sentence in re.findall(r"`([^`]+)`", row)]


def understood(sentence, earlier="", selected=False):
    request = Request(sentence, LABELS, fps=12.0, frames=72, frame=3, selected=selected)
    copies = {Ids((1,), words="the copy"): Text(("dog",))} if earlier.startswith("copy") else {}
    return parse(request, earlier=earlier, copies=copies)


@pytest.mark.parametrize("what", said("What"))
def test_what_can_be_said(what):
    if what in ("leave the dog alone", "do not touch the dog"):
        assert understood(f"make everything red, but {what}") == understood("make everything except the dog red")
    else:
        assert understood(what, EARLIER.get(what, "make the dog red" if " it " in what else ""))


@pytest.mark.parametrize("who", [who for who in said("Who") if who not in BY_THE_SCENE])
def test_who_can_be_meant(who):
    assert understood(f"make {who} red", EARLIER.get(who, ""), selected=who == "the selection")


@pytest.mark.parametrize("when", said("When"))
def test_when_it_can_be(when):
    assert understood(f"make the dog red {'at ' if when[0] == '0' else ''}{when}") != understood("make the dog red")
