"""An edited scene at any time: edits are evaluated when asked, the base arrays stay untouched.

`state(k, t)`, the Gaussians after k edits at time t, is computed from `state(k-1, …)`: an edit alters rows, reads some of them at
another moment (retiming) or appends copies of them. So edits compose in any order, without special cases. Rows never
disappear. Placement and appearance are computed separately, for appearance mostly does not depend on time.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import fields, replace
from functools import cached_property
from pathlib import Path
from typing import Any, NamedTuple, TypeVar, get_args

import numpy as np

from ..errors import F4xError
from ..geometry import quaternion, spherical_harmonics
from ..scaffold import Scaffold
from ..scaffold.deformation import motions_to, node_poses_at
from ..scene import PosedSplats, Scene, read_scene
from ..scene.foreign import open_any
from ..scene.model import faded
from ..scene.tints import gain_of, tinted
from . import colours
from .keys import rekeyed
from .operations import (
    Blur,
    Delete,
    Duplicate,
    Extract,
    Glow,
    Grade,
    Match,
    Opacity,
    Operation,
    Recolour,
    Style,
    Transform,
    rotation_of,
)
from .retiming import AppearanceChange, effect, holds, progress, time_map_of
from .splat_rows import SplatRows, Step, steps_of
from .stack import Edit, EditStack, of, with_stack
from .styles import STYLES

MAX_MOMENTS = 512
"""Maximum number of clip times at which one frame may pose the base: every time-shifted copy needs its own, and stacked edits
multiply them."""
KEPT_MOMENTS = 8
"""Posed base scenes in the cache: the frame that a freeze holds is read at every frame."""
MAX_COORDINATE = 1e12
"""Maximum distance and size in world units, so that repeated scaling stays within float32."""
BASE_PERCENTILE = 98
"""The base of an object is this percentile of its heights, so that stray Gaussians below it do not count."""
FADED_DEPTH = 16.0
"""Optical depth, the sum of -log(1 - alpha) along a pixel, of objects in fits of real clips: at this depth a fade is linear."""
MAX_ALPHA = 0.99
"""Maximum opacity that `thinned` reads: an opacity of 1 would never fade."""
APPEARANCE_OPERATIONS = get_args(AppearanceChange)
"""The operation classes of `AppearanceChange`."""


class Placement(NamedTuple):
    """Geometry of n Gaussians: where they are and how large."""

    means: np.ndarray
    """(n,3) float32 world."""
    quats: np.ndarray
    """(n,4) float32 wxyz, unit."""
    scales: np.ndarray
    """(n,3) float32."""
    presence: np.ndarray
    """(n,) float32 presence at the time that is shown, 0 to 1."""
    tint: np.ndarray
    """(n,3) float32 tint at the time that is shown; (n,0) where colors stay."""


class Appearance(NamedTuple):
    """Appearance of n Gaussians."""

    opacities: np.ndarray
    """(n,) float32 in [0, 1]."""
    sh: np.ndarray
    """(n,S,3) float32."""


class Motion(NamedTuple):
    """A similarity: x' = pivot + scale R (x - pivot) + translate."""

    rotation: np.ndarray
    """(4,) wxyz."""
    scale: float
    pivot: np.ndarray
    """(3,) world."""
    translate: np.ndarray
    """(3,) world."""

    @property
    def shift(self) -> np.ndarray:
        """(3,) image of the origin: x' = scale R x + shift."""
        return self.pivot + self.translate - self.scale * quaternion.rotate(self.rotation, self.pivot)

    def after(self, other: Motion) -> Motion:
        """The composition: `other` first, then this motion."""
        shift = self.scale * quaternion.rotate(self.rotation, other.shift) + self.shift
        rotation = quaternion.multiply(self.rotation, other.rotation)
        return Motion(rotation, self.scale * other.scale, np.zeros(3), shift)

    def __call__(self, placed: Placement) -> Placement:
        """The Gaussians moved; what does not change keeps its bits."""
        turns, resizes = self.rotation[1:].any(), self.scale != 1
        if not (turns or resizes or self.translate.any()):
            return placed
        means, quats, scales, presence, tint = placed.means.astype(np.float64), *placed[1:]
        if turns or resizes:
            means = self.pivot + self.scale * quaternion.rotate(self.rotation, means - self.pivot)
        if turns:
            quats = quaternion.normalize(quaternion.multiply(self.rotation, quats)).astype(np.float32)
        if resizes:
            scales = np.minimum(scales * self.scale, MAX_COORDINATE).astype(np.float32)
        means = np.clip(means + self.translate, -MAX_COORDINATE, MAX_COORDINATE).astype(np.float32)
        return Placement(means, quats, scales, presence, tint)


NO_MOTION = Motion(quaternion.IDENTITY, 1.0, np.zeros(3), np.zeros(3))

State = TypeVar("State", Placement, Appearance)
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
        """All Gaussians at clip time `time` (frame index, float allowed), copies last; N and order are the same always."""
        return self.part(time, EVERY)

    def part(self, time: float, rows: Wanted) -> PosedSplats:
        """Only the Gaussians `rows` of `posed(time)`, without computing the placement of the others."""
        self._moments.clear()
        means, quats, scales, presence, tint = self._placement(len(self.steps), time, rows)
        opacities, sh = self.appearance(time, rows)
        opacities = faded(opacities, presence) if self.fades else opacities
        if self.tints is not None:
            sh = tinted(sh, self._passed(tint, sh, rows))
        return PosedSplats(means, quats, scales, opacities, sh, ids=self.rows.ids[rows], dynamic=self.rows.moves[rows])

    def appearance(self, time: float, rows: Wanted = EVERY) -> Appearance:
        """Appearance of the Gaussians `rows` at `time`, whatever their placement and presence."""
        return self._appearance(len(self.steps), time, rows)

    def tint(self, time: float) -> np.ndarray:
        """(N,3) float32 what is added to the colors at `time`, (N,0) in a scene whose colors stay."""
        self._moments.clear()
        tint = self._placement(len(self.steps), time, EVERY).tint
        return tint if self.tints is None else self._passed(tint, self.appearance(time).sh, EVERY)

    def _passed(self, tint: np.ndarray, sh: np.ndarray, rows: Wanted) -> np.ndarray:
        """(n,3) the `tint (n,3)` of Gaussians `rows` after edits that made harmonics `sh (n,S,3)` of the base's."""
        return tint * gain_of(self._constant["sh"][self.rows.origin[rows]], sh)

    def latents(self) -> np.ndarray:
        """(N,D) float32 latents of the feature field, in the order of `posed`; a copy has those of its original."""
        return super().latents()[self.rows.origin]

    def info(self) -> dict[str, Any]:
        """The summary of the base, with counts after the edits under `edited`."""
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
        timed = (
            isinstance(s.edit.operation, APPEARANCE_OPERATIONS) and s.edit.operation.frames is not None
            for s in self.steps
        )
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
        """Placement of all Gaussians before any edit at `time`."""
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
            posed, presence = self._untinted(time), self.presence(time)
            tint = np.zeros((len(posed), 0), np.float32) if self.tints is None else self.tints.at(time)
            kept[time] = Placement(posed.means, posed.quats, posed.scales, presence, tint)
        return kept[time]

    def _placement(self, depth: int, time: float, rows: Wanted) -> Placement:
        """Placement of `rows` after `depth` edits at `time`."""
        start = self._last_reader(depth)
        if start:
            state, copy = self._read(self._placement, start, time, rows)
            operation = self.steps[start - 1].edit.operation
            if isinstance(operation, Duplicate) and any(operation.offset):
                shift = copy[:, None] * np.array(operation.offset)
                state = state._replace(means=(state.means + shift).astype(np.float32))
        else:
            state = Placement(*(part[rows] for part in self._base(time)))
        for below in range(start, depth):
            operation = self.steps[below].edit.operation
            if isinstance(operation, Transform):
                state = self._apply_transform(below, time, rows, state)
            elif isinstance(operation, Blur) and holds(operation.frames, time):
                wider = np.sqrt(state.scales**2 + np.float32(operation.radius**2))
                state = state._replace(scales=np.where(self.steps[below].chosen[rows][:, None], wider, state.scales))
        return state

    def _appearance(self, depth: int, time: float, rows: Wanted) -> Appearance:
        """Appearance of `rows` after `depth` edits at `time`."""
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
            if isinstance(self.steps[below].edit.operation, APPEARANCE_OPERATIONS):
                state = self._apply_appearance(below, time, rows, state)
        return state

    def _last_reader(self, depth: int) -> int:
        """Number (from 1) of the last of the first `depth` edits that reads other rows or times; 0 for none."""
        return next((k for k in range(depth, 0, -1) if self.steps[k - 1].reads), 0)

    def _read(
        self, fetch: Callable[[int, float, Wanted], State], depth: int, time: float, rows: Wanted, still: bool = False
    ) -> tuple[State, np.ndarray]:
        """(State that edit number `depth` reads for `rows`, in their order; the number of each row's copy).

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
        """The Gaussians after the first `depth` steps."""
        return self.steps[depth].before if depth < len(self.steps) else self.rows

    def _apply_transform(self, below: int, time: float, rows: Wanted, state: Placement) -> Placement:
        step = self.steps[below]
        moved = step.chosen[rows]
        operation = step.edit.operation
        assert isinstance(operation, Transform)
        fraction = progress(operation.frames, operation.ease, time, self._last)
        if fraction == 0 or not moved.any():
            return state
        motion = motion_of(operation, fraction, self.pivot(below, time, state if isinstance(rows, slice) else None))
        return _put(state, moved, motion(Placement(*(part[moved] for part in state))))

    def pivot(self, below: int, time: float, state: Placement | None = None) -> np.ndarray:
        """(3,) the pivot of edit number `below` (0 = first), a transform, at `time`; `state`: all rows before it, if known."""
        step = self.steps[below]
        operation = step.edit.operation
        assert isinstance(operation, Transform)
        kind = operation.pivot
        if isinstance(kind, tuple):
            return np.array(kind)
        whom = step.thing & ~step.before.gone
        about = np.flatnonzero(whom if whom.any() else step.thing)
        if state is not None:
            return pivot_of(kind, state.means[about])
        return self._remember(below, time, lambda: pivot_of(kind, self._placement(below, time, about).means))

    def _apply_appearance(self, below: int, time: float, rows: Wanted, state: Appearance) -> Appearance:
        step = self.steps[below]
        operation, dyed = step.edit.operation, step.chosen[rows]
        assert isinstance(operation, APPEARANCE_OPERATIONS)
        fraction = effect(operation, time, self._last)
        if not fraction or not dyed.any():
            return state
        if isinstance(operation, Delete | Extract):
            return state._replace(opacities=np.where(dyed, np.float32(0), state.opacities))
        if isinstance(operation, Blur):
            sizes = self._constant["scales"][step.before.origin[rows]] * self._growth(below)[rows, None]
            fainter = state.opacities * thinning(sizes, operation.radius)
            return state._replace(opacities=np.where(dyed, fainter, state.opacities))
        if isinstance(operation, Opacity):
            factor = np.float32(1 + fraction * (operation.factor - 1))
            if operation.factor < 1 and 0 < fraction < 1:  # on the way from all to the factor
                gone = np.float32(1 - operation.factor)
                fainter = state.opacities * (1 - gone) + gone * thinned(state.opacities, 1 - fraction)
            else:
                fainter = np.clip(state.opacities * factor, 0, 1)
            if operation.factor > 1:  # nothing times a factor is nothing: what was hidden comes back as it was
                hidden = (state.opacities == 0) & ~step.before.gone[rows]
                there = self._constant["opacities"][step.before.origin[rows]]
                fainter = np.where(hidden, np.float32(fraction) * there, fainter)
            return state._replace(opacities=np.where(dyed, fainter, state.opacities))

        known = None
        if has_tones(operation):
            moment = time if below >= self._static_depth else 0.0
            known = (
                self._tones(step, lambda index: Appearance(*(part[index] for part in state)))
                if isinstance(rows, slice)
                else self._remember(
                    below, moment, lambda: self._tones(step, lambda i: self._appearance(below, time, i))
                )
            )
        before = Appearance(*(part[dyed] for part in state))
        after = dyed_by(operation, before, known)
        if fraction < 1:  # colours are linear in the harmonics
            after = Appearance(*(a + np.float32(fraction) * (b - a) for a, b in zip(before, after, strict=True)))
        return _put(state, dyed, after)

    def _growth(self, below: int) -> np.ndarray:
        """(n,) float32 how many times as large the transforms that last, before edit number `below` (0 = first), made each row.

        Those that take their time are left out, so that opacities stay the same at all times.
        """

        def work() -> np.ndarray:
            growth = np.ones(len(self.after(0).ids), np.float32)
            for depth, step in enumerate(self.steps[:below], 1):
                operation = step.edit.operation
                if step.copied is not None:
                    growth = growth[step.read(0.0, np.arange(len(self.after(depth).ids)))[1]]
                elif isinstance(operation, Transform) and operation.frames is None:
                    growth = np.where(step.chosen, np.float32(operation.scale) * growth, growth)
            return growth

        return self._remember(below, 0.0, work)  # type: ignore[no-any-return]

    def _tones(self, step: Step, fetch: Callable[[np.ndarray], Appearance]) -> Any:
        other = None if step.source is None else fetch(np.flatnonzero(step.source))
        return tones_of(step.edit.operation, fetch(np.flatnonzero(step.chosen)), other)

    def _remember(self, below: int, time: float, work: Callable[[], Any]) -> Any:
        known = self._known
        if (below, time) not in known:
            value = work()
            if len(known) > MAX_MOMENTS:
                known.clear()
            known[below, time] = value
        return known[below, time]


def _untimed(edit: Edit) -> Edit:
    """The edit, switched off where it retimes; a copy without its delay."""
    operation = edit.operation
    if isinstance(operation, Duplicate):
        return replace(edit, operation=replace(operation, time_shift=0.0))
    return replace(edit, enabled=edit.enabled and time_map_of(operation, (0.0, 1.0)) is None)


def edited(scene: Scene) -> Scene:
    """The scene as its enabled edits leave it; a scene without edits is returned as it is. F4xError names a wrong edit."""
    if isinstance(scene, EditedScene) or not scene.edits:
        return scene
    whole = EditedScene(**{entry.name: getattr(scene, entry.name) for entry in fields(scene)})
    _ = whole.rows, whole.curves  # a wrong edit is reported here and not at the first rendered frame
    return whole


def base_of(scene: Scene) -> Scene:
    """The scene with the same stack and no edit applied: the argument of `edited`."""
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


def open_with(path: Path, stack: EditStack) -> Scene:
    """Open a scene or splat file with `stack` in place of its own edits. Raises F4xError that names the file."""
    opened = open_any(path, sequence=False)
    assert isinstance(opened, Scene)  # only a sequence is none
    return edited(with_stack(opened, stack))


def next_id(scene: Scene) -> int:
    """The first Gaussian id that no copy of any edit has, disabled ones included: `first_id` of the next `duplicate`."""
    everything = tuple(replace(edit, enabled=True) for edit in of(scene).edits)
    ids = steps_of(scene, everything)[1].ids
    return max(scene.next_id, int(ids.max(initial=-1)) + 1)


def with_operations(scene: Scene, *operations: Operation, sentence: str = "") -> Scene:
    """The edited scene with operations appended to its stack, ids for copies reserved where they are missing."""
    scene = base_of(scene)
    for operation in operations:
        if isinstance(operation, Duplicate | Glow) and operation.first_id < 0:
            operation = replace(operation, first_id=next_id(scene))
        scene = with_stack(scene, of(scene).append(operation, sentence))
    return edited(scene)


def stack_of(scene: Scene, *operations: Operation, sentence: str = "") -> EditStack:
    """The stack of `with_operations`, checked."""
    return of(with_operations(scene, *operations, sentence=sentence))


def motion_of(operation: Transform, fraction: float, pivot: np.ndarray) -> Motion:
    """The similarity of a transform that is `fraction` in [0, 1] complete, about `pivot (3,)`."""
    return Motion(
        quaternion.from_rotation_vector(fraction * rotation_of(operation.rotate)),
        operation.scale**fraction,
        pivot,
        fraction * np.array(operation.translate),
    )


def pivot_of(kind: str, means: np.ndarray) -> np.ndarray:
    """(3,) float64 the `centroid` (median) of `means (n,3)`, or its `base`: the lowest middle (y points down)."""
    pivot = np.median(means, axis=0).astype(np.float64)
    if kind == "base":
        pivot[1] = np.percentile(means[:, 1], BASE_PERCENTILE)
    return pivot


def thinned(opacities: np.ndarray, left: float) -> np.ndarray:
    """Opacities (n,) of which a picture shows the fraction `left` in [0, 1] of its alpha, where splats stand behind one another.

    `1 - (1 - o)^k` scales the optical depth D of a pixel by k; its alpha 1 - exp(-k D) is to be `left` (1 - exp(-D)). Scaling
    the opacities themselves would leave a stack of many nearly opaque half-way.
    """
    depth = -np.log1p(-left * -np.expm1(-FADED_DEPTH)) / FADED_DEPTH
    return (1 - (1 - np.minimum(opacities, MAX_ALPHA)) ** depth).astype(np.float32)


def thinning(sizes: np.ndarray, radius: float) -> np.ndarray:
    """(n,) float32 factors of opacity of Gaussians of `sizes (n,3)` that a blur by `radius` widens: the light they stop stays the
    same, seen along their thinnest axis."""
    broad = np.sort(sizes.astype(np.float64), axis=1)[:, 1:]
    return (np.prod(broad, 1) / np.prod(np.hypot(broad, radius), 1)).astype(np.float32)


def has_tones(operation: Operation) -> bool:
    """Whether the colours of one Gaussian depend on those of the others it is chosen with."""
    return isinstance(operation, Style | Match | Grade) or (
        isinstance(operation, Recolour) and operation.keep_luminance
    )


def tones_of(operation: Operation, whom: Appearance, other: Appearance | None) -> Any:
    """Colour statistics that an operation needs of all Gaussians it colours, and of those (`other`) that it takes colours from."""
    rgb = colours.colours_of(whom.sh)
    if other is not None:
        theirs = colours.colours_of(other.sh)
        return colours.moments_of(rgb, whom.opacities), colours.moments_of(theirs, other.opacities)
    if isinstance(operation, Style):
        visible = whom.opacities > 0
        return colours.lights_of(rgb[visible] if visible.any() else rgb)
    return colours.mean_of(colours.lab_from_rgb(rgb)[:, 0], whom.opacities)


def dyed_by(operation: Operation, whom: Appearance, tones: Any) -> Appearance:
    """The Gaussians with the colours that the operation gives them; `tones` of `tones_of`."""
    assert isinstance(operation, Recolour | Style | Match | Grade)
    rgb = colours.colours_of(whom.sh)
    if isinstance(operation, Grade):
        plain = (operation.contrast, operation.saturation, operation.warmth) == (1, 1, 0)
        if plain and operation.gamma == 1:
            return whom
        goal = rgb if plain else colours.graded(rgb, operation.contrast, operation.saturation, operation.warmth, tones)
        if operation.gamma != 1:
            goal = np.maximum(goal, 0) ** (1 / operation.gamma)
        dc = spherical_harmonics.dc_from_rgb(goal).astype(np.float32)
        return Appearance(
            whom.opacities, np.concatenate([dc[:, None], whom.sh[:, 1:] * np.float32(operation.contrast)], axis=1)
        )
    strength = operation.strength
    if strength == 0:
        return whom
    opacities, rest = whom.opacities, whom.sh[:, 1:]
    # What depends on the direction is a change of colour about the DC's: a new colour is only seen without it.
    faded = rest * np.float32(1 - strength)
    if isinstance(operation, Style):
        look = STYLES[operation.look]
        goal, rest = colours.styled(rgb, look, *tones), faded
        opacities = opacities * np.float32(1 + strength * (look.opacity - 1))
    elif isinstance(operation, Match):
        goal = colours.matched(rgb, *tones)
    elif operation.mode == "multiply":
        goal = rgb * operation.rgb
        rest = (rest * (1 + strength * (np.array(operation.rgb) - 1))).astype(np.float32)
    elif operation.mode == "add":
        goal = rgb + operation.rgb
    else:
        target, rest = np.array(operation.rgb), faded
        if operation.mode == "hue":
            goal = colours.with_hue(rgb, target)
        elif operation.keep_luminance:
            goal = colours.painted(rgb, target, tones)
        else:
            goal = np.broadcast_to(target, rgb.shape)
    dc = spherical_harmonics.dc_from_rgb(rgb + strength * (goal - rgb)).astype(np.float32)
    return Appearance(opacities, np.concatenate([dc[:, None], rest], axis=1))


def _put(state: State, where: np.ndarray, values: State) -> State:
    """`state` with the rows `where (n,) bool` replaced by `values`."""
    if where.all():
        return values
    parts = []
    for old, new in zip(state, values, strict=True):
        parts.append(old.copy())
        parts[-1][where] = new
    return type(state)(*parts)
