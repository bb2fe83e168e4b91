"""Nodes come where Gaussians are carried badly, and go where they carry nothing.

The reference copies Gaussians onto new nodes; here those that are nearest to a new node at their reference time move over to
it instead, keeping their place in the world, and density control adds what is missing.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

import numpy as np
import torch
from torch import Tensor

from ..gaussians import DynamicGaussians, SetOptimiser
from ..scaffold.adam import Adam
from ..scaffold.control import densify_nodes, largest_weights, prune_nodes, rebase_local
from ..scaffold.graph import attach_nodes
from ..scaffold.radius import RadiusConfig, initial_radius
from ..scaffold.structure import NodePoses
from .config import NodeConfig
from .model import NodeSet, SceneModel

# Candidates per new node: neighbours among them are thinned to the scaffold's unit.
CANDIDATES_PER_NODE = 8


def add_nodes(
    model: SceneModel,
    optimiser: SetOptimiser,
    shared: Adam,
    gradient: Tensor,
    config: NodeConfig,
    next_node_id: int,
) -> int:
    """Turn badly carried Gaussians into nodes; returns the next unused node id.

    Args:
        optimiser: of the dynamic set. shared: of the nodes. gradient: (N,) mean screen-space gradient of dynamic Gaussians.
    """
    assert model.dynamic is not None
    assert model.nodes is not None
    nodes, dynamic = model.nodes, model.dynamic
    room = min(int(config.growth * len(nodes.scaffold)), config.max_nodes - len(nodes.scaffold))
    if room <= 0 or not bool((gradient > 0).any()):
        return next_node_id
    worst = gradient.topk(min(room * CANDIDATES_PER_NODE, len(gradient))).indices
    with torch.no_grad():
        posed = [model.dynamic_at(float(time))[0] for time in model.times]
        xyz = torch.stack([moved.means[worst] for moved in posed]).numpy()
        quat = torch.stack([moved.quats[worst] for moved in posed]).numpy()
    before = nodes.snapshot()
    radius = float(initial_radius(1, before.unit, RadiusConfig())[0])
    densified, taken = densify_nodes(before, xyz, quat, radius, next_node_id)
    if len(taken) > room:
        densified, taken = densify_nodes(before, xyz[:, taken[:room]], quat[:, taken[:room]], radius, next_node_id)
    added = len(densified) - len(before)
    if added == 0:
        return next_node_id
    fresh = NodeSet(densified, nodes.graph)
    _swap_nodes(model, shared, fresh, lambda moment, axis: _padded(moment, axis, added))
    _attach_to_new(dynamic, fresh, len(before))
    optimiser.forget("local_means")
    optimiser.forget("local_quats")
    return next_node_id + added


@torch.no_grad()
def _attach_to_new(dynamic: DynamicGaussians, nodes: NodeSet, known: int) -> None:
    """Let the Gaussians whose nearest node is not among the first `known` of `nodes` follow it, from where they are."""
    xyz = nodes.parameters["node_xyz"]
    x, _ = dynamic.at_reference(xyz, nodes.quat)
    reference, attach = dynamic.labels["reference"], dynamic.labels["attach"]
    nearest = torch.from_numpy(attach_nodes(x.numpy(), reference.numpy(), nodes.scaffold.xyz))
    moving = (nearest >= known).nonzero()[:, 0]
    place, turn = dynamic.parameters["local_means"], dynamic.parameters["local_quats"]
    local = place[moving], turn[moving], reference[moving], attach[moving], nearest[moving]
    place[moving], turn[moving] = rebase_local(*local, NodePoses(xyz.detach(), nodes.quat.detach()))
    dynamic.labels["attach"] = torch.where(nearest >= known, nearest, attach)


def drop_nodes(model: SceneModel, shared: Adam, config: NodeConfig) -> int:
    """Remove nodes that carry nothing noticeable; returns how many went."""
    assert model.dynamic is not None
    assert model.nodes is not None
    nodes, dynamic = model.nodes, model.dynamic
    with torch.no_grad():
        x, _ = dynamic.at_reference(nodes.parameters["node_xyz"], nodes.quat)
        weights, _ = model.skinning(x)
    attach = dynamic.labels["attach"].numpy()
    greatest = largest_weights(nodes.scaffold.neighbours[attach], weights.numpy(), len(nodes.scaffold))
    pruned, new_index = prune_nodes(nodes.snapshot(), greatest, attach, config.prune_weight)
    if len(pruned) == len(nodes.scaffold):
        return 0
    keep = torch.from_numpy(np.flatnonzero(new_index >= 0))
    _swap_nodes(model, shared, NodeSet(pruned, nodes.graph), lambda moment, axis: moment.index_select(axis, keep))
    dynamic.labels["attach"] = torch.from_numpy(new_index)[dynamic.labels["attach"]]
    return len(new_index) - len(pruned)


def _swap_nodes(model: SceneModel, shared: Adam, fresh: NodeSet, change_moment: Callable[..., Tensor]) -> None:
    """Put `fresh` in place of the model's nodes, keeping Adam's moments aligned along the node axis."""
    for group in shared.param_groups:
        name = group["name"]
        if name in fresh.parameters:
            axis = 0 if name == "radius_logit" else 1
            value = fresh.parameters[name].detach()
            change = partial(change_moment, axis=axis)
            fresh.parameters[name] = shared.replace(group, value, change)
    model.nodes = fresh


def _padded(moment: Tensor, axis: int, added: int) -> Tensor:
    shape = list(moment.shape)
    shape[axis] = added
    return torch.cat([moment, moment.new_zeros(shape)], axis)
