"""An edited scene at any time: edits are evaluated when asked, the base arrays stay untouched.

`state(k, t)`, the Gaussians after k edits at time t, is computed from `state(k-1, …)`: an edit alters rows, reads some of them at
another moment (retiming) or appends copies of them. So edits compose in any order, without special cases. Rows never
disappear. Placement and appearance are computed separately, for appearance mostly does not depend on time.
"""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import fields, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from ..errors import F4xError
from ..scaffold import Scaffold
from ..scaffold.deformation import motions_to, node_poses_at
from ..scene import PosedSplats, Scene, read_scene
from ..scene.foreign import open_any
from ..scene.model import faded
from ..scene.tints import gain_of, tinted
from .change import Change
from .keys import rekeyed
from .splat_rows import SplatRows, Step, steps_of
from .stack import Edit, EditStack, of, with_stack
from .state import Appearance, Placement, State, pivot_of, put

MAX_MOMENTS = 512
"""Maximum number of clip times at which one frame may pose the base: every time-shifted copy needs its own, and stacked edits
multiply them."""
KEPT_MOMENTS = 8
"""Posed base scenes in the cache: the frame that a freeze holds is read at every frame."""

Wanted = np.ndarray | slice
"""Rows by index (n,), or `EVERY`."""
EVERY = slice(None)


class EditedScene(Scene):
    """A scene with its enabled edits applied. Renderers and queries use it like any other scene.

    `posed`, `ids`, `colors` and `latents` include copies; `static`, `dynamic` and `scaffold` are the base's, `curves` are the
    scaffold's as `rekey` leaves them. `PosedSplats.dynamic` says what moves by the scaffold or by an edit.
    """

    @property
    def ids(self) -> np.ndarray:
        """(N,) int64 ids in the order of `posed`: the base's, then copies edit by edit."""
        return self.rows.ids

    @property
    def moving(self) -> np.ndarray:
        """(N,) bool in the order of `posed`: whether the scaffold or an edit moves a Gaussian."""
        return self.rows.moves

    @cached_property
    def base(self) -> Scene:
        """The scene before its edits."""
        return base_of(self)

    @cached_property
    def untimed(self) -> Scene:
        """The scene without what its edits do to moments: nothing is faster, later or backwards, so all of the clip is shown."""
        edits = tuple(map(_untimed, of(self).edits))
        return self if edits == of(self).edits else edited(with_stack(self.base, EditStack(edits)))

    @property
    def origin(self) -> np.ndarray:
        """(N,) int64: the row of `base.posed` that each row of `posed` is, or is a copy of."""
        return self.rows.origin

    @property
    def gone(self) -> np.ndarray:
        """(N,) bool in the order of `posed`: deleted at all times."""
        return self.rows.gone

    @property
    def rows(self) -> SplatRows:
        """The Gaussians after the last edit."""
        return self._program[1]

    def posed(self, time: float) -> PosedSplats:
        """Return all Gaussians at clip time `time` (frames, float allowed), copies last; N and order are the same at all times."""
        return self.part(time, EVERY)

    def part(self, time: float, rows: Wanted) -> PosedSplats:
        """Return the Gaussians `rows` of `posed(time)`, without computing where the others are."""
        self._moments.clear()
        means, quats, scales, presence, tint = self._placement(len(self.steps), time, rows)
        opacities, sh = self.appearance(time, rows)
        opacities = faded(opacities, presence) if self.fades else opacities
        if self.tints is not None:
            sh = tinted(sh, self._passed(tint, sh, rows))
        return PosedSplats(means, quats, scales, opacities, sh, ids=self.rows.ids[rows], dynamic=self.rows.moves[rows])

    def appearance(self, time: float, rows: Wanted = EVERY) -> Appearance:
        """Return the appearance of the Gaussians `rows` at `time`, as if all were present."""
        return self._appearance(len(self.steps), time, rows)

    def tint(self, time: float) -> np.ndarray:
        """Return the shift (N,3) float32 of the colors at `time`; (N,0) in a scene whose colors stay."""
        self._moments.clear()
        tint = self._placement(len(self.steps), time, EVERY).tint
        return tint if self.tints is None else self._passed(tint, self.appearance(time).sh, EVERY)

    def _passed(self, tint: np.ndarray, sh: np.ndarray, rows: Wanted) -> np.ndarray:
        """Return `tint (n,3)` of the Gaussians `rows`, scaled as edits scaled their harmonics to `sh (n,S,3)`."""
        return tint * gain_of(self._constant["sh"][self.rows.origin[rows]], sh)

    def latents(self) -> np.ndarray:
        """Return the latents (N,D) float32 of the feature field in the order of `posed`; a copy has those of its original."""
        return super().latents()[self.rows.origin]

    def info(self) -> dict[str, Any]:
        """Return the summary of the base scene, with counts after the edits under `edited`."""
        there = len(super().ids)
        counts = {
            "gaussians": int((~self.gone).sum()),
            "copies": len(self.ids) - there,
            "gone": int(self.gone.sum()),
        }
        return {**super().info(), "edited": counts}

    @property
    def steps(self) -> tuple[Step, ...]:
        """The edits that have an effect, in order."""
        return self._program[0]

    @cached_property
    def curves(self) -> Scaffold | None:
        """The scaffold with the poses of `rekey`; Gaussians move with it from their rest on the base scaffold."""
        return rekeyed(self, of(self).edits)

    def _motions(self, time: float) -> np.ndarray:
        base, moved = self.scaffold, self.curves
        if base is None or moved is None or moved is base:
            return super()._motions(time)
        return motions_to(node_poses_at(moved.times, moved.xyz, moved.quat, time), base.xyz, base.quat, self._pairs)

    @cached_property
    def _program(self) -> tuple[tuple[Step, ...], SplatRows]:
        return steps_of(self, of(self).edits)

    @cached_property
    def _last(self) -> float:
        return float(self.cameras.times[-1])

    @cached_property
    def _static_depth(self) -> int:
        """Number of edits, from the first on, after which appearance does not depend on time."""
        timed = (step.edit.operation.LOOKS and step.edit.operation.span is not None for step in self.steps)
        return next((depth for depth, is_timed in enumerate(timed) if is_timed), len(self.steps))

    @cached_property
    def _static_appearance(self) -> Appearance:
        return self._compute_appearance(self._static_depth, 0.0, EVERY)

    @cached_property
    def _moments(self) -> set[float]:
        """Clip times at which the base was posed for the present frame."""
        return set()

    @cached_property
    def _posed_base(self) -> dict[float, Placement]:
        return {}

    @cached_property
    def _known(self) -> dict[tuple[int, float], Any]:
        """Cache of pivots and tones by edit and time."""
        return {}

    def _base(self, time: float) -> Placement:
        """Return the placement of all Gaussians before any edit at `time`."""
        self._moments.add(time)
        if len(self._moments) > MAX_MOMENTS:
            raise F4xError(
                f"{self.name}: its edits show more than {MAX_MOMENTS} moments in one picture; take some back or"
                " `f4x bake` the scene."
            )
        kept = self._posed_base
        if time not in kept:
            while len(kept) >= KEPT_MOMENTS:
                kept.pop(next(iter(kept)), None)
            posed, presence = self.untinted(time), self.presence(time)
            tint = np.zeros((len(posed), 0), np.float32) if self.tints is None else self.tints.at(time)
            kept[time] = Placement(posed.means, posed.quats, posed.scales, presence, tint)
        return kept[time]

    def _placement(self, depth: int, time: float, rows: Wanted) -> Placement:
        """Return the placement of `rows` after the first `depth` edits at `time`."""
        start = self._last_reader(depth)
        if start:
            state, copy = self._read(self._placement, start, time, rows)
            shift = self.steps[start - 1].edit.operation.copy_motion(copy)
            if shift is not None:
                state = state._replace(means=(state.means + shift).astype(np.float32))
        else:
            state = Placement(*(part[rows] for part in self._base(time)))
        for below in range(start, depth):
            if self.steps[below].edit.operation.PLACES:
                state = self._apply_placement(below, time, rows, state)
        return state

    def _appearance(self, depth: int, time: float, rows: Wanted) -> Appearance:
        """Return the appearance of `rows` after the first `depth` edits at `time`."""
        if depth == self._static_depth:
            return Appearance(*(part[rows] for part in self._static_appearance))
        return self._compute_appearance(depth, time, rows)

    def _compute_appearance(self, depth: int, time: float, rows: Wanted) -> Appearance:
        start = max(self._last_reader(depth), self._static_depth if depth > self._static_depth else 0)
        if depth > start == self._static_depth:
            state = self._appearance(start, time, rows)
        elif start:
            state, _ = self._read(self._appearance, start, time, rows, still=start <= self._static_depth)
        else:
            posed = self._constant
            state = Appearance(posed["opacities"][rows], posed["sh"][rows])
        for below in range(start, depth):
            if self.steps[below].edit.operation.LOOKS:
                state = self._apply_appearance(below, time, rows, state)
        return state

    def _last_reader(self, depth: int) -> int:
        """Number (from 1) of the last of the first `depth` edits that reads other rows or times; 0 for none."""
        return next((k for k in range(depth, 0, -1) if self.steps[k - 1].reads), 0)

    def _read(
        self, fetch: Callable[[int, float, Wanted], State], depth: int, time: float, rows: Wanted, still: bool = False
    ) -> tuple[State, np.ndarray]:
        """Return (the state that edit number `depth` reads for `rows`, in their order; the number of each row's copy, 0: none).

        `still`: the state is the same at all times.
        """
        step = self.steps[depth - 1]
        own = np.arange(len(self.after(depth).ids))[rows]
        when, below, copy = step.read(time, own)
        if still:
            when[:] = time
        times, group = np.unique(when, return_inverse=True)
        if len(times) < 2:
            return fetch(depth - 1, float(times[0]) if len(times) else time, below), copy
        members = [np.flatnonzero(group == number) for number in range(len(times))]
        parts = [fetch(depth - 1, float(t), below[member]) for t, member in zip(times, members, strict=True)]
        place = np.argsort(np.concatenate(members))
        return type(parts[0])(*(np.concatenate(arrays)[place] for arrays in zip(*parts, strict=True))), copy

    def after(self, depth: int) -> SplatRows:
        """Return the rows after the first `depth` steps."""
        return self.steps[depth].before if depth < len(self.steps) else self.rows

    def _apply_placement(self, below: int, time: float, rows: Wanted, state: Placement) -> Placement:
        step = self.steps[below]
        chosen, fraction = step.chosen[rows], step.edit.operation.fraction(time, self._last)
        if fraction == 0 or not chosen.any():
            return state

        def pivot(kind: str) -> np.ndarray:
            return self.pivot(below, kind, time, state if isinstance(rows, slice) else None)

        before = Placement(*(part[chosen] for part in state))
        return put(state, chosen, step.edit.operation.placed(before, fraction, pivot))

    def pivot(self, below: int, kind: str, time: float, state: Placement | None = None) -> np.ndarray:
        """Return the "centroid" or "base" (3,) of the thing that edit number `below` (0 = first) changes, at `time`.

        `state`: the placement of all rows before that edit, if it is known.
        """
        step = self.steps[below]
        whom = step.thing & ~step.before.gone
        about = np.flatnonzero(whom if whom.any() else step.thing)
        if state is not None:
            return pivot_of(kind, state.means[about])
        return self._remember(below, time, lambda: pivot_of(kind, self._placement(below, time, about).means))

    def _apply_appearance(self, below: int, time: float, rows: Wanted, state: Appearance) -> Appearance:
        step = self.steps[below]
        chosen, fraction = step.chosen[rows], step.edit.operation.fraction(time, self._last)
        if not fraction or not chosen.any():
            return state
        return step.edit.operation.shown(state, chosen, fraction, Looking(self, below, time, rows, state))

    def _growth(self, below: int) -> np.ndarray:
        """Return the factors (n,) float32 by which lasting transforms before edit number `below` (0 = first) enlarged each row.

        Those that take their time are left out, so that opacities stay the same at all times.
        """

        def work() -> np.ndarray:
            growth = np.ones(len(self.after(0).ids), np.float32)
            for depth, step in enumerate(self.steps[:below], 1):
                if step.copied is not None:
                    growth = growth[step.read(0.0, np.arange(len(self.after(depth).ids)))[1]]
                elif step.edit.operation.growth != 1:
                    growth = np.where(step.chosen, np.float32(step.edit.operation.growth) * growth, growth)
            return growth

        return self._remember(below, 0.0, work)  # type: ignore[no-any-return]

    def _remember(self, below: int, time: float, work: Callable[[], Any]) -> Any:
        known = self._known
        if (below, time) not in known:
            value = work()
            if len(known) > MAX_MOMENTS:
                known.clear()
            known[below, time] = value
        return known[below, time]


class Looking:
    """The scene as an operation sees it while it changes the appearance of Gaussians; each value is computed on demand."""

    def __init__(self, scene: EditedScene, below: int, time: float, rows: Wanted, state: Appearance):
        """Look at the Gaussians `rows` at `time` from edit number `below` (0 = first), before which they have `state`."""
        self.scene, self.below, self.time, self.rows, self.state = scene, below, time, rows, state
        self.step = scene.steps[below]

    @property
    def tones(self) -> Any:
        """Of all chosen Gaussians; cached where only some are looked at."""
        scene, below = self.scene, self.below
        if not self.step.edit.operation.has_tones:
            return None
        if isinstance(self.rows, slice):
            return self._tones(lambda index: Appearance(*(part[index] for part in self.state)))
        moment = self.time if below >= scene._static_depth else 0.0
        return scene._remember(
            below, moment, lambda: self._tones(lambda index: scene._appearance(below, self.time, index))
        )

    def _tones(self, fetch: Callable[[np.ndarray], Appearance]) -> Any:
        other = None if self.step.source is None else fetch(np.flatnonzero(self.step.source))
        return self.step.edit.operation.tones(fetch(np.flatnonzero(self.step.chosen)), other)

    @property
    def sizes(self) -> np.ndarray:
        """(n,3) scales of the base times the growth of earlier edits."""
        growth = self.scene._growth(self.below)[self.rows, None]
        return self.scene._constant["scales"][self.step.before.origin[self.rows]] * growth

    @property
    def opacities(self) -> np.ndarray:
        """(n,) opacities of the base's Gaussians that they come from."""
        return self.scene._constant["opacities"][self.step.before.origin[self.rows]]

    @property
    def gone(self) -> np.ndarray:
        """(n,) bool: deleted before the edit."""
        return self.step.before.gone[self.rows]


def _untimed(edit: Edit) -> Edit:
    """Return the edit without its effect on time: a retiming is switched off, a copy loses its delay."""
    if edit.operation.time_map((0.0, 1.0)) is not None:
        return replace(edit, enabled=False)
    untimed = edit.operation.untimed()
    return edit if untimed is edit.operation else replace(edit, operation=untimed)


def edited(scene: Scene) -> Scene:
    """Return the scene as its enabled edits leave it, itself where it has none. F4xError names a wrong edit."""
    if isinstance(scene, EditedScene) or not scene.edits:
        return scene
    whole = EditedScene(**{entry.name: getattr(scene, entry.name) for entry in fields(scene)})
    _ = whole.rows, whole.curves  # a wrong edit is reported here and not at the first rendered frame
    return whole


def base_of(scene: Scene) -> Scene:
    """Return the scene with the same stack and no edit applied: the argument of `edited`."""
    if not isinstance(scene, EditedScene):
        return scene
    return Scene(**{entry.name: getattr(scene, entry.name) for entry in fields(scene)})


def open_scene(path: Path | str, edits: bool = True) -> Scene:
    """Read a scene file, by default with its edits; F4xError names what is wrong and how to open the scene without edits."""
    scene = read_scene(path)
    if not edits:
        return replace(scene, edits=())
    try:
        return edited(scene)
    except F4xError as error:
        raise F4xError(f"{path}: {str(error).rstrip('.')}; --without-edits opens it without.") from error


def open_with(path: Path, edits: str) -> Scene:
    """Open a scene or splat file with the stack of the JSON text `edits` in place of its own. F4xError that names the file."""
    stack = EditStack.from_json(json.loads(edits), str(path))
    opened = open_any(path, sequence=False)
    assert isinstance(opened, Scene)  # only a sequence is none
    return edited(with_stack(opened, stack))


def next_id(scene: Scene) -> int:
    """Return the first Gaussian id that no copy of any edit has, disabled ones included: `first_id` of the next `duplicate`."""
    everything = tuple(replace(edit, enabled=True) for edit in of(scene).edits)
    ids = steps_of(scene, everything)[1].ids
    return max(scene.next_id, int(ids.max(initial=-1)) + 1)


def with_operations(scene: Scene, *operations: Change, sentence: str = "") -> Scene:
    """Return the edited scene with operations appended to its stack; ids for copies are reserved where they are missing."""
    scene = base_of(scene)
    for operation in operations:
        if getattr(operation, "first_id", 0) < 0:
            operation = operation.altered(first_id=next_id(scene))
        scene = with_stack(scene, of(scene).append(operation, sentence))
    return edited(scene)


def stack_of(scene: Scene, *operations: Change, sentence: str = "") -> EditStack:
    """Return the stack of `with_operations`, checked."""
    return of(with_operations(scene, *operations, sentence=sentence))
