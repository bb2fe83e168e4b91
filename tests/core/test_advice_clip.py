"""What the diagnostics page says about cuts, exposure and priors that do not belong together."""

import dataclasses

import numpy as np
import pytest
from toy import clip_and_priors

from f4x_core.fit.needs import Shortage
from f4x_core.gaussians.spawn import Room
from f4x_core.priors import PriorsConfig, build_priors
from f4x_core.priors.depth import GUESSED_MOVERS
from f4x_core.report.advice import about_room, contradiction, findings


@pytest.fixture
def priors():
    """Those of the toy clip."""
    return clip_and_priors()[1]


def said(priors, picked="") -> str:
    return " ".join(finding.what + finding.advice for finding in findings(priors, None, {}, picked))


def test_true_priors_meet_and_wrong_ones_are_said(priors):
    assert contradiction(priors) < 0.1 and "contradict" not in said(priors)
    priors.cameras = priors.cameras.scaled_world(3.0)
    assert contradiction(priors) > 1 and "contradict each other" in said(priors)
    priors.statistics["cameras"] = {"assumed": "too few points stand still"}  # then that is what is wrong
    assert "contradict each other" not in said(priors)
    priors.depth = None
    assert not contradiction(priors) > 0 and "contradict" not in said(priors)


@pytest.mark.parametrize(
    ("cuts", "words"), [([], ""), ([5], "2 shots, cut at frame 5"), ([3, 6], "3 shots, cut at frame 3, 6")]
)
def test_cuts_are_named(cuts, words, priors):
    priors.statistics["changes"] = {"cuts": cuts, "exposure": 1.0}
    assert (words in said(priors)) and ("shots" in said(priors)) == bool(cuts)


def test_advice_on_cuts_counts_the_frames_of_the_source(priors):
    priors.statistics["changes"] = {"cuts": [2], "exposure": 1.0}
    assert "cut at frame 59 of its source" in said(priors, "55:69:2") and "--frames 59:69:2;" in said(priors, "55:69:2")
    assert "--frames 2:8:1;" in said(priors), "a clip whose source is not known"


def test_exposure_is_told_in_percent(priors):
    priors.statistics["changes"] = {"cuts": [], "exposure": 1.5}
    assert "exposure changes by 50%" in said(priors)


@pytest.mark.parametrize(
    ("errors", "words"),
    [
        ([0.52, 0.50, 0.51, 0.60], "from 0.5 to 1.2 picture widths"),
        ([0.90, 0.50, 0.70, 0.90], ""),
        ([0.30, 0.50, 0.70, 0.90], "the shortest, 0.5 picture widths, fits best; the lens may be wider"),
        ([0.90, 0.70, 0.50, 0.30], "the longest, 2.5 picture widths, fits best; the lens may be longer"),
    ],
    ids=["flat", "clear", "too wide", "too long"],
)
@pytest.mark.parametrize(("kind", "search"), [("moving", "focal_search"), ("pan", "pan_focal_search")])
def test_the_search_for_the_focal_length_is_judged(kind, search, errors, words, priors):
    priors.camera_kind = kind
    curve = {"focal_over_width": [0.5, 0.8, 1.2, 2.5], "error_px": errors}
    priors.statistics["cameras"] = {search: curve}
    assert words in said(priors) and ("focal length" in said(priors)) == bool(words)
    other = {"focal_search", "pan_focal_search"} - {search}
    priors.statistics["cameras"] = {other.pop(): curve}
    assert "focal length" not in said(priors), "the search of another kind of camera tells nothing of this one"


def test_building_priors_looks_for_cuts_and_counts_clip_frames(tmp_path):
    clip, _ = clip_and_priors(frames=8)
    clip = dataclasses.replace(clip, frames=clip.frames.copy(), held_out=clip.times == 1)
    clip.frames[5:] = 255 - clip.frames[5:, ::-1, ::-1]
    built = build_priors(clip, tmp_path / "priors", PriorsConfig())
    assert built.statistics["changes"]["cuts"] == [5]


def test_what_there_was_no_room_for_is_named_with_what_held_it_back():
    assert about_room(()) == []
    start = Shortage("static", Room(84_210, 100), 0, "spawn_static.max_count")
    growth = Shortage("dynamic", Room(900, 1000), 35, "--memory 2")
    both = Shortage("dynamic", Room(900, 400), 0, "spawn_dynamic.max_count")
    (first,), (second,), (joint,) = (about_room(some) for some in ((start,), (growth,), (start, both, growth)))
    assert first.weight == "problem" and first.advice.startswith("Raise --set spawn_static.max_count,")
    assert first.what == (
        "There was no room for all that is static: 84,210 Gaussians asked for at the start, 100 allowed"
        " then by spawn_static.max_count. What is static is covered more thinly, so it is softer."
    )
    assert second.weight == "note" and second.advice == "Grant more than --memory 2."
    assert (
        second.what == "There was no room for 35 more Gaussians at the last growth of what is dynamic, by --memory 2."
    )
    assert joint.weight == "problem" and "84,210" in joint.what and "; all that is dynamic: 900 Gaussians" in joint.what
    assert joint.what.endswith("What is static and dynamic is covered more thinly, so it is softer.")
    assert joint.advice == (
        "Raise --set spawn_static.max_count and spawn_dynamic.max_count, or let more --minutes and --memory decide."
        " Grant more than --memory 2."
    )


def test_a_guessed_depth_of_movers_is_said_once(priors):
    priors.warn(GUESSED_MOVERS)
    assert ("The depth of what moves" in said(priors)) != (GUESSED_MOVERS in said(priors))
    priors.depth_confidence = np.zeros_like(priors.depth_confidence)
    assert "The depth of what moves is a guess" in said(priors) and GUESSED_MOVERS not in said(priors)
