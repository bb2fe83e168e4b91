"""Floaters that were planted in scenes of kinds that nothing was tuned on."""

import numpy as np
import pytest
from floater_scenes import HELD_OUT, planted
from labelled_scene import labelled_scene

from f4x_core.edit.plan import propose
from f4x_core.edit.resolve import EditorState
from f4x_core.query.floaters import floater_scores, is_floaters
from f4x_core.query.prompts import select_by_text


@pytest.mark.parametrize("kind", HELD_OUT)
@pytest.mark.parametrize("frames", [1, 6])
def test_planted_floaters_are_found_and_surfaces_stay(kind, frames):
    right = found = there = 0
    for seed in (200, 201):
        scene, floaters, _ = planted(kind, seed, frames=frames)
        chosen = floater_scores(scene) >= 0.5
        right, found, there = right + (chosen & floaters).sum(), found + chosen.sum(), there + floaters.sum()
    assert right / found > 0.8 and right / there > 0.8, (right / found, right / there)


def test_a_scene_without_floaters_loses_little_whatever_its_unit():
    scene, floaters, _ = planted("shelf", 202)
    clean = scene.static.take(~floaters)
    scores = [floater_scores(_scene_of(clean, scene, unit)) for unit in (1.0, 1000.0)]
    assert (scores[0] >= 0.5).mean() < 0.01
    np.testing.assert_allclose(scores[0], scores[1], atol=1e-3)


def _scene_of(static, like, unit):
    from dataclasses import replace

    static = replace(
        static, means=(unit * static.means).astype(np.float32), scales=(unit * static.scales).astype(np.float32)
    )
    return replace(like, static=static)


@pytest.mark.parametrize("sentence", ["remove the floaters", "delete all floaters"])
def test_a_sentence_means_them_without_any_vocabulary(sentence):
    scene, floaters, _ = planted("room", 203)
    operation = propose(scene, sentence, EditorState(None, 0.0)).candidates[0].operations[0]
    chosen = np.isin(scene.ids, operation.select.array)
    assert operation.TAG == "delete" and (chosen & floaters).sum() > 0.8 * floaters.sum()


def test_which_words_mean_floaters_and_what_is_selected():
    assert all(map(is_floaters, ("floaters", "the floater", "all stray splats"))) and not is_floaters(
        "the floating ball"
    )
    found = select_by_text(labelled_scene(features=False), ["floaters"])
    assert not found.chosen.any()
