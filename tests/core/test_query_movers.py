"""Movers that cross are told apart by the times at which there is room between them."""

from dataclasses import replace

import numpy as np
import pytest

from f4x_core.query.movers import UNKNOWN, movers_of
from f4x_core.query.select_config import MoverConfig

TIMES, CONFIG = 13, MoverConfig()
BALL = np.random.default_rng(3).normal(size=(40, 3)) * 0.2
PHASES = np.linspace(-1, 1, TIMES)


def walker(side, points=BALL):
    """Places (n,T,3) of points that walk past the origin: from -side to side, at a little distance of it."""
    return points[:, None] + np.stack([3 * side * PHASES, 0.1 * side * np.ones(TIMES), np.zeros(TIMES)], 1)


def found(places, presence=None, weight=None, bonds=None, config=CONFIG):
    count = len(places)
    presence = np.ones((count, TIMES)) if presence is None else presence
    weight = np.ones(count) if weight is None else weight
    bonds = np.zeros((count, count)) if bonds is None else bonds
    return movers_of(places, presence, weight, bonds, config)


def test_two_that_cross_are_two_movers_although_they_touch():
    both = np.concatenate([walker(1), walker(-1)])
    middle = np.linalg.norm(both[:40, None, TIMES // 2] - both[None, 40:, TIMES // 2], axis=-1)
    assert middle.min() < 0.1
    mover = found(both)
    assert len(set(mover[:40])) == len(set(mover[40:])) == 1 and mover[0] != mover[-1]
    assert sorted(set(mover)) == [0, 1]


def test_three_movers():
    rising = BALL[:, None] + np.stack([np.zeros(TIMES), 4 + PHASES, np.zeros(TIMES)], 1)
    mover = found(np.concatenate([walker(1), walker(-1), rising]))
    groups = [set(mover[part : part + 40]) for part in (0, 40, 80)]
    assert all(len(group) == 1 for group in groups) and len(set.union(*groups)) == 3


def test_one_that_turns_and_stretches_is_one_mover():
    turn = np.exp(1j * np.pi * PHASES)
    stretched = BALL * [1, 4, 1]
    flat = (stretched[:, :1] + 1j * stretched[:, 1:2]) * turn
    places = np.stack([flat.real, flat.imag, np.repeat(stretched[:, 2:], TIMES, 1)], -1)
    assert set(found(places)) == {0}


def test_what_is_there_while_they_touch_goes_with_its_neighbours():
    places = np.concatenate([walker(1), walker(-1), walker(1, BALL[:1])])
    presence = np.ones((81, TIMES))
    presence[80] = np.arange(TIMES) == TIMES // 2
    bonds = np.zeros((81, 81))
    assert found(places, presence)[80] == UNKNOWN
    for neighbour in (3, 50):
        bonds[:] = 0
        bonds[80, neighbour] = bonds[neighbour, 80] = 1
        mover = found(places, presence, bonds=bonds)
        assert mover[80] == mover[neighbour]


def test_what_is_lost_and_found_elsewhere_is_no_second_mover():
    """Behind something it leaves its way: Gaussians before and after live at other times, and hardly meet."""
    places, presence = np.concatenate([walker(1), walker(-1)]), np.zeros((80, TIMES))
    presence[:40, :7] = presence[40:, 6:] = 1
    assert set(found(places, presence)) == {0}
    presence[40:, 3:] = 1
    assert len(set(found(places, presence))) == 2


def test_who_has_no_weight_or_hardly_any_is_no_mover():
    places, weight = np.concatenate([walker(1), walker(-1)]), np.ones(80)
    weight[40:] = 0
    assert set(found(places, weight=weight)[:40]) == {0} and set(found(places, weight=weight)[40:]) == {UNKNOWN}
    weight[40:] = 0.04
    assert 0 in found(places, weight=weight) and 1 not in found(places, weight=weight)
    assert 1 in found(places, weight=weight, config=replace(CONFIG, least=0.02))


@pytest.mark.parametrize("count", [0, 1, 3])
def test_few_superpoints_are_one_mover(count):
    assert (found(walker(1, BALL[:count])) == 0).all()
