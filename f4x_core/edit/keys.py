"""Node poses that an artist changed (`rekey`): the scaffold's curves with them, and folding them into a scene.

A Gaussian rests on the poses that its nodes had at its reference time *before* anybody changed them, and moves from there to
wherever they are now. So new poses cannot simply replace old ones: a node held elsewhere over the whole clip would be found
elsewhere at the reference time too, and nothing would move.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace
from typing import Any

import numpy as np

from ..errors import F4xError
from ..geometry import quaternion
from ..scaffold import Scaffold
from ..scaffold.control import resample_in_time
from ..scaffold.deformation import align_signs
from ..scene import Scene
from .stack import Edit, EditStack, of, with_stack

LEAD = 100.0
"""Clip frames from the last rest pose to the clip: far enough that the curve's velocity at its first frame stays its own."""


def rekeyed(scene: Scene, edits: Iterable[Edit]) -> Scaffold | None:
    """Return the scaffold of `scene` with the poses of every enabled `rekey` in order; the scene's own where there is none.

    It has a knot at every clip frame then, so that nothing else moves at any of them. F4xError names the edit that speaks of
    nodes that are not there.
    """
    scaffold = scene.scaffold
    changes = [(n, edit) for n, edit in enumerate(edits, 1) if edit.enabled and edit.operation.REKEYS]
    if not changes:
        return scaffold
    if scaffold is None:
        number, edit = changes[0]
        raise F4xError(f"{scene.name}: {edit.titled(number)}: the scene has no scaffold; take the edit back.")
    place = {int(id): index for index, id in enumerate(scaffold.ids)}
    knots = [scaffold.times, scene.cameras.times, *(edit.operation.times for _, edit in changes)]  # type: ignore[attr-defined]
    times = np.unique(np.concatenate(knots))
    scaffold = resample_in_time(scaffold, times)
    xyz, quat = scaffold.xyz.copy(), scaffold.quat.copy()
    for number, edit in changes:
        operation: Any = edit.operation
        missing = [id for id in operation.nodes if id not in place]
        if missing:
            raise F4xError(
                f"{scene.name}: {edit.titled(number)}: the scaffold has no node {missing[0]}; take the edit back."
            )
        where = np.searchsorted(times, operation.times)[:, None], np.array([place[id] for id in operation.nodes])
        xyz[where], quat[where] = operation.arrays
    return replace(scaffold, xyz=xyz, quat=align_signs(quat))


def with_keys_folded(scene: Scene) -> Scene:
    """Return the scene without its `rekey` edits, their poses in its scaffold: `posed` is the same at every clip frame.

    Gaussians whose nodes were changed at their reference time keep the old poses to rest on: knots before the clip.
    """
    stack, old = of(scene), scene.scaffold
    moved = rekeyed(scene, stack.edits)
    left = EditStack(tuple(edit for edit in stack.edits if not edit.operation.REKEYS))
    if moved is None or old is None or moved is old:
        return scene if len(left) == len(stack) else with_stack(scene, left)
    dynamic = scene.dynamic
    reference = np.searchsorted(moved.times, old.times)[dynamic.reference]
    unlike = (moved.xyz[reference[:, None], dynamic.node] != old.xyz[dynamic.reference[:, None], dynamic.node]).any(-1)
    turned = _turned(moved.quat[reference[:, None], dynamic.node], old.quat[dynamic.reference[:, None], dynamic.node])
    resting = (unlike | turned).any(1)
    rests = np.unique(dynamic.reference[resting])
    times = moved.times[0] - LEAD - np.arange(len(rests), 0, -1)
    reference = reference + len(rests)
    reference[resting] = np.searchsorted(rests, dynamic.reference[resting])
    scaffold = replace(
        moved,
        times=np.concatenate([times, moved.times]),
        xyz=np.concatenate([old.xyz[rests], moved.xyz]),
        quat=align_signs(np.concatenate([old.quat[rests], moved.quat])),
        certain=np.concatenate([old.certain[rests], moved.certain]),
    )
    scene = replace(scene, scaffold=scaffold, dynamic=replace(dynamic, reference=reference.astype(np.int32)))
    return with_stack(scene, left)


def _turned(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Return (...) bool: True where quaternions (...,4) of any length are different rotations, beyond float32 rounding."""
    a, b = quaternion.normalize(a), quaternion.normalize(b)
    return np.minimum(np.abs(a - b).max(-1), np.abs(a + b).max(-1)) > 4 * np.finfo(np.float32).eps
