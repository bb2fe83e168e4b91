"""What queries keep of a scene goes with the scene: a program that opens one after the other needs no more memory than for one."""

import gc
from weakref import ref

import pytest
from labelled_scene import labelled_scene

from f4x_core.query.calibration import prepare
from f4x_core.query.kept import Kept
from f4x_core.query.objects import graph_of
from f4x_core.query.smoothing import group_of
from f4x_core.query.unseen import unseen_gaussians


class Part:
    """Something that results are made of."""


def test_a_result_is_made_once_for_the_same_objects():
    kept, made, first, other = Kept(), [], Part(), Part()

    def result(*others):
        return kept.get(first, *others, make=lambda: made.append(others) or len(made))

    assert [result(other), result(other), result(None), result(None), result(Part()), result(other)] == [
        1,
        1,
        2,
        2,
        3,
        4,
    ]
    assert kept.get(Part(), other, make=lambda: 9) == 9 and result(other) == 4


def test_another_object_in_the_place_of_one_that_is_gone_is_another():
    kept, first = Kept(), Part()
    other = Part()
    assert kept.get(first, other, make=lambda: 1) == 1
    del other
    gc.collect()
    assert kept.get(first, None, make=lambda: 2) == 2


@pytest.mark.parametrize("features", [True, False])
def test_a_scene_that_was_asked_is_let_go(features):
    scene = labelled_scene(features=features)
    prepare(scene)
    unseen_gaussians(scene)
    graph = graph_of(scene)
    assert graph_of(scene) is graph and (not features or group_of(scene) is group_of(scene))
    parts = [ref(part) for part in (scene, scene.static, scene.dynamic, scene.features) if part is not None]
    del scene, graph
    gc.collect()
    assert [part() for part in parts] == [None] * len(parts)
