"""Nodes that come where Gaussians are carried badly and go where they carry nothing, on a row of four nodes."""

from dataclasses import dataclass

import numpy as np
import pytest
import torch
from carried_scene import FRAMES, carried_scene

from f4x_core.fit.config import NodeConfig
from f4x_core.fit.model import SceneModel
from f4x_core.fit.node_control import add_nodes, drop_nodes
from f4x_core.gaussians import SetOptimiser
from f4x_core.gaussians.parameters import localise
from f4x_core.scaffold.adam import Adam

pytestmark = pytest.mark.usefixtures("one_thread")

PARAMETERS = ("node_xyz", "node_quat", "radius_logit")
AXIS = {"node_xyz": 1, "node_quat": 1, "radius_logit": 0}


@dataclass
class Fit:
    """A model whose optimisers have made a step, so that they have moments to keep."""

    model: SceneModel
    optimiser: SetOptimiser
    shared: Adam

    @classmethod
    def of(cls, moving: np.ndarray, reference: np.ndarray, nodes: int = 4) -> "Fit":
        model = carried_scene(moving, reference, nodes)
        optimiser = SetOptimiser(model.dynamic, dict.fromkeys(model.dynamic.parameters, 1e-4))
        groups = [{"params": [model.nodes.parameters[name]], "lr": 1e-4, "name": name} for name in PARAMETERS]
        shared = Adam(groups)
        loss = sum((value * torch.arange(value.numel()).view_as(value).sin()).sum() for value in cls.all(model))
        loss.backward()
        optimiser.step(), shared.step()
        return cls(model, optimiser, shared)

    @staticmethod
    def all(model: SceneModel) -> list[torch.Tensor]:
        return [*model.dynamic.parameters.values(), *model.nodes.parameters.values()]

    def add(self, gradient: np.ndarray, next_id: int = 50, **changes) -> int:
        config = NodeConfig(**{"growth": 0.5, "max_nodes": 500} | changes)
        return add_nodes(self.model, self.optimiser, self.shared, torch.from_numpy(gradient).float(), config, next_id)

    def curves(self, gaussian: int) -> np.ndarray:
        """(F,3) where a Gaussian is in each frame."""
        with torch.no_grad():
            return np.stack([self.model.dynamic_at(float(t))[0][0][gaussian].numpy() for t in range(FRAMES)])

    def references(self) -> tuple[np.ndarray, np.ndarray]:
        """World places (N,3) and orientations (N,4) of all Gaussians in their own frames."""
        nodes = self.model.nodes
        placed = self.model.dynamic.at_reference(nodes.parameters["node_xyz"], nodes.quat)
        return placed[0].detach().numpy(), placed[1].detach().numpy()

    def moments(self) -> dict[tuple[str, str], torch.Tensor]:
        states = {name: self.shared.state[self.model.nodes.parameters[name]] for name in PARAMETERS}
        return {(n, kind): state[kind].clone() for n, state in states.items() for kind in ("exp_avg", "exp_avg_sq")}


def clusters(*where: tuple[float, float, int]) -> np.ndarray:
    """(N,3) Gaussians around (x, y), so many of each, far closer to each other than nodes may be."""
    rng = np.random.default_rng(0)
    return np.concatenate([[x, y, 0.0] + 0.02 * rng.normal(size=(count, 3)) for x, y, count in where])


def test_the_worst_carried_become_nodes_on_their_own_curves():
    fit = Fit.of(clusters((0, 0, 20), (0.5, 3, 5), (2.5, 4, 5), (1.5, -3, 5)), np.arange(35) % FRAMES)
    gradient = np.full(35, 0.1)
    gradient[[22, 28, 31]] = 5, 9, 7
    curves = [fit.curves(i) for i in (28, 31)]
    before, moments = fit.references(), fit.moments()
    assert fit.add(gradient) == 52, "half as many as there are"
    nodes = fit.model.nodes
    assert nodes.scaffold.ids.tolist() == [20, 21, 22, 23, 50, 51]
    for node, curve in zip((4, 5), curves, strict=True):
        np.testing.assert_allclose(nodes.parameters["node_xyz"][:, node].detach(), curve, atol=1e-5)
    np.testing.assert_allclose(nodes.radius[4:].detach(), 1.0, rtol=1e-4)
    after = fit.references()
    np.testing.assert_allclose(after[0], before[0], atol=1e-5)
    np.testing.assert_allclose(abs((after[1] * before[1]).sum(1)), 1, atol=1e-5)
    attach, reference = (fit.model.dynamic.labels[name].numpy() for name in ("attach", "reference"))
    xyz = nodes.parameters["node_xyz"].detach().numpy()
    for i in range(35):
        nearest = int(np.linalg.norm(xyz[reference[i]] - after[0][i], axis=1).argmin())
        assert attach[i] == nearest
    assert set(attach[25:30]) == {4} and set(attach[30:]) == {5} and set(attach[:20]) == {0}
    for (name, kind), moment in moments.items():
        found = fit.moments()[name, kind]
        old, new = found.split([4, 2], AXIS[name])
        assert torch.equal(old, moment) and not new.any() and moment.any()
    for group in fit.shared.param_groups:
        assert group["params"] == [nodes.parameters[group["name"]]]


def test_who_keeps_its_node_keeps_it_even_where_another_old_one_has_come_closer():
    fit = Fit.of(clusters((0, 0, 10), (1.5, 3, 10)), np.zeros(20, np.int64))
    nodes, labels = fit.model.nodes, fit.model.dynamic.labels
    placed = [tensor.detach() for tensor in fit.model.dynamic.at_reference(nodes.parameters["node_xyz"], nodes.quat)]
    labels["attach"][3] = 1
    local, turn = localise(*placed, labels["attach"], labels["reference"], nodes.parameters["node_xyz"], nodes.quat)
    with torch.no_grad():
        fit.model.dynamic.parameters["local_means"].copy_(local)
        fit.model.dynamic.parameters["local_quats"].copy_(turn)
    assert fit.add(np.where(np.arange(20) == 15, 1.0, 0.1), growth=0.25) == 51
    assert fit.model.dynamic.labels["attach"][:10].tolist() == [0, 0, 0, 1, 0, 0, 0, 0, 0, 0]


def test_where_places_were_set_from_outside_their_moments_are_forgotten_and_no_others():
    fit = Fit.of(clusters((0, 0, 10), (1.5, 3, 10)), np.zeros(20, np.int64))
    fit.add(np.where(np.arange(20) == 15, 1.0, 0.1))
    for name, value in fit.model.dynamic.parameters.items():
        state = fit.optimiser.adam.state[value]
        assert bool(state["exp_avg"].any() and state["exp_avg_sq"].any()) == (
            name not in ("local_means", "local_quats")
        )


@pytest.mark.parametrize(
    ("changes", "added"),
    [
        ({}, 2),
        ({"growth": 0.25}, 1),
        ({"growth": 0.24}, 0),
        ({"max_nodes": 5}, 1),
        ({"max_nodes": 4}, 0),
        ({"growth": 1.0}, 3),
    ],
)
def test_as_many_as_there_is_room_for(changes, added):
    fit = Fit.of(clusters((0.5, 3, 5), (2.5, 4, 5), (1.5, -3, 5)), np.zeros(15, np.int64))
    assert fit.add(np.linspace(1, 2, 15), **changes) == 50 + added
    assert len(fit.model.nodes.scaffold) == len(fit.model.nodes.radius) == 4 + added


def test_without_a_gradient_nothing_is_added():
    fit = Fit.of(clusters((0.5, 3, 5)), np.zeros(5, np.int64))
    before = fit.model.nodes
    assert fit.add(np.zeros(5)) == 50 and fit.model.nodes is before


@pytest.mark.parametrize(("first", "added"), [(15, 2), (16, 1)])
def test_eight_candidates_are_looked_at_for_each_node(first, added):
    """Two nodes may come, so 16; those of one place give one node between them."""
    fit = Fit.of(clusters((0.5, 3, first), (2.5, 4, 9)), np.zeros(first + 9, np.int64))
    gradient = np.where(np.arange(first + 9) < first, 2.0, 1.0)
    assert fit.add(gradient) == 50 + added


# ---- useless nodes -----------------------------------------------------------------------------------------------------


def strongest(fit: Fit, node: int) -> float:
    """The largest normalised weight of a node over all Gaussians: exp(-d^2 / 2 r^2), in their own frames."""
    nodes, found = fit.model.nodes, 0.0
    xyz, radius = nodes.parameters["node_xyz"].detach().double().numpy(), nodes.radius.detach().double().numpy()
    labels = fit.model.dynamic.labels
    for place, attach, frame in zip(fit.references()[0], labels["attach"], labels["reference"], strict=True):
        row, valid = nodes.scaffold.neighbours[attach], nodes.scaffold.edge_mask[attach]
        squared = ((xyz[frame, row] - place) ** 2).sum(1)
        raw = valid * (np.exp(-squared / (2 * radius[row] ** 2)) + 1e-6)
        found = max(found, float((raw / raw.sum())[row == node].max(initial=0)))
    return found


@pytest.mark.parametrize("above", [True, False])
def test_a_node_that_carries_less_than_the_threshold_goes_unless_one_is_attached(above):
    """Gaussians are around nodes 0, 2 and 3; node 1 only helps."""
    fit = Fit.of(clusters((0.05, 0.1, 6), (2.1, 0, 6), (3, 0, 6)), np.zeros(18, np.int64))
    weight = strongest(fit, 1)
    assert 0.1 < weight < 0.5
    before, moments, places = fit.model.nodes, fit.moments(), fit.references()[0]
    threshold = weight * (1.001 if above else 0.999)
    gone = drop_nodes(fit.model, fit.shared, NodeConfig(prune_weight=threshold))
    assert gone == above
    if not above:
        assert fit.model.nodes is before
        return
    nodes = fit.model.nodes
    assert nodes.scaffold.ids.tolist() == [20, 22, 23]
    kept = torch.tensor([0, 2, 3])
    torch.testing.assert_close(nodes.parameters["node_xyz"], before.parameters["node_xyz"][:, kept])
    torch.testing.assert_close(nodes.quat, before.quat[:, kept])
    torch.testing.assert_close(nodes.radius, before.radius[kept])
    for (name, kind), moment in moments.items():
        assert torch.equal(fit.moments()[name, kind], moment.index_select(AXIS[name], kept))
    assert fit.model.dynamic.labels["attach"].tolist() == [0] * 6 + [1] * 6 + [2] * 6
    np.testing.assert_allclose(fit.references()[0], places, atol=1e-5)
    fit.model.dynamic_at(1.0)


def test_a_node_that_a_gaussian_hangs_on_stays_however_little_it_carries():
    fit = Fit.of(clusters((0, 0, 6), (1, 0, 6), (2, 0, 6), (3, 0, 6)), np.zeros(24, np.int64))
    assert drop_nodes(fit.model, fit.shared, NodeConfig(prune_weight=2.0)) == 0
