"""Words for shadows, reflections and ripples, and whom they select."""

from dataclasses import replace

import numpy as np
import pytest
from labelled_scene import labelled_scene
from test_query_objects import scene_with_ripples

from f4x_core.edit.naming import by_words
from f4x_core.edit.plan import propose
from f4x_core.language.cast_words import caster, is_cast
from f4x_core.query import cast
from f4x_core.query.cast import moving_things
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
    graph = Graph(replace(moving, cast=np.arange(len(moving.weight)) == 0), static)
    monkeypatch.setattr(cast, "graph_of", lambda scene, config: graph)
    shadow, wall = (select_by_text(scene, [label]).chosen for label in ("shadow", "wall"))
    assert shadow.any() and not shadow[~scene.moving].any() and wall.any()
    np.testing.assert_array_equal(select_by_text(scene, ["wall", "shadow"]).chosen, wall | shadow)
