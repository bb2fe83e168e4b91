"""Words for shadows, reflections and ripples, and whom they select."""

from dataclasses import replace

import numpy as np
import pytest
from labelled_scene import labelled_scene
from test_query_objects import scene_with_ripples
from two_shadows import two_with_shadows

from f4x_core.edit.naming import by_words
from f4x_core.edit.plan import propose
from f4x_core.language.cast_words import caster, is_cast
from f4x_core.query import attached, cast
from f4x_core.query.attached import attached_to
from f4x_core.query.cast import cast_of, moving_things
from f4x_core.query.knowledge import refuse_unknown
from f4x_core.query.objects import Graph, graph_of
from f4x_core.query.prompts import select_by_text
from f4x_core.query.questions import answer


@pytest.mark.parametrize(
    ("label", "whose"),
    [("shadow", None), ("its shadow", None), ("Shadows", None), ("the big dog's shadow", "big dog"), ("boys' reflections", "boys"),
     ("ripples", None)],
)  # fmt: skip
def test_words_for_what_is_cast(label, whose):
    assert is_cast(label) and caster(label) == whose


@pytest.mark.parametrize("label", ["dog", "eye shadow", "shadow box", "reflector", ""])
def test_other_words(label):
    assert not is_cast(label)


def test_a_shadow_needs_no_teacher_and_is_no_thing_that_moves():
    scene, square = scene_with_ripples()
    refuse_unknown(scene, "shadow")
    shadow = select_by_text(scene, ["shadow"]).chosen
    np.testing.assert_array_equal(by_words(scene, ["ripples"])["ripples"].chosen, shadow)
    assert shadow[scene.moving & ~square].mean() > 0.7 and not shadow[square].any() and not shadow[~scene.moving].any()
    np.testing.assert_array_equal(moving_things(scene), scene.moving & ~shadow)
    removed = propose(scene, "remove the shadow").chosen.operations[0]
    np.testing.assert_array_equal(removed.select.array, np.sort(scene.ids[shadow]))


def test_questions_speak_of_shadows_without_a_teacher():
    scene, _ = scene_with_ripples()
    shadow = select_by_text(scene, ["shadow"])
    (sighting,) = answer(scene, "how big is the shadow").evidence["sightings"]
    assert sighting["chosen"] == shadow.chosen.sum() > 0
    assert answer(scene, "does the shadow move?").text.startswith("Yes: the shadow moves")


def test_a_thing_with_its_shadow(monkeypatch):
    scene = labelled_scene()
    moving, static = graph_of(scene)
    graph = Graph(replace(moving, cast=np.arange(len(moving.weight)) == 0, unlike=np.zeros(len(moving.rows))), static)
    monkeypatch.setattr(cast, "graph_of", lambda scene, config: graph)
    shadow, wall = (select_by_text(scene, [label]).chosen for label in ("shadow", "wall"))
    assert shadow.any() and not shadow[~scene.moving].any() and wall.any()
    np.testing.assert_array_equal(select_by_text(scene, ["wall", "shadow"]).chosen, wall | shadow)


def test_a_shadow_holds_nothing_of_the_thing_above_it(monkeypatch):
    """Superpoints of the square's lower rim count as cast: sills, as dark as the road."""
    scene, square, shadow, *_ = two_with_shadows()
    moving, static = graph_of(scene)
    lowest = moving.means(square.astype(float), np.ones(len(square))) > 0.5
    y = moving.means(scene.posed(0.0).means[:, 1].astype(float), np.ones(len(square)))
    sills = lowest & (y > np.quantile(y[lowest], 0.8))
    graph = Graph(replace(moving, cast=moving.cast | sills), static)
    for module in (cast, attached):
        monkeypatch.setattr(module, "graph_of", lambda *_: graph)
    rows = graph.moving.spread(sills.astype(float), len(square)) > 0
    assert (rows & square).sum() == 9
    for found in (cast_of(scene) > 0, cast_of(scene, square) > 0, attached_to(scene, square & ~rows).shadow):
        assert found[shadow].mean() > 0.6 and not found[square].any()
    assert attached_to(scene, square & ~rows).edges[rows & square].all()
    assert (cast_of(scene, shadow) > 0)[shadow].any()  # a shadow's own shadow is that shadow
