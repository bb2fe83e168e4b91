"""Scenes of overlapping windows of one shot become one scene over its whole length. Needs numpy; draws through `raster`.

The windows are in one world and one space of ids: each began with the background that the one before left, so the same id is the
same Gaussian or node (`previous_window`). The dynamic sets of two windows take turns amid the frames that the windows share. A
Gaussian of the background is there from the window that made it until the one that did away with it, or learnt it further as
another one; one that no earlier frame would show, because nobody had looked there, is there from the beginning.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from itertools import pairwise

import numpy as np

from ..errors import F4xError
from ..geometry import pose, quaternion
from ..geometry.camera import CameraPath
from ..geometry.interpolation import presence
from ..progress import Progress, silent
from ..scaffold import Scaffold
from ..scene.concatenation import ALWAYS, concatenated, within
from ..scene.model import EARLIER, DynamicSet, Scene, StaticSet
from .joined_people import JoinedPeople
from .joining import join_scaffolds

FADE = 1.0
"""Frames, in the middle of the shared ones, over which windows take turns. Two pictures of one thing that differ by a fraction
of a pixel blur: over all twelve a made-up clip loses 1.9 dB there, over four 0.7, over one 0.2. From the side the step from frame
to frame grows by a twentieth."""
COMPARED_PER_WINDOW = 12
"""Frames of a window in which it is looked whether they show what windows made. With 4, what comes to light between is left out
(camel: 2 dB in frame 30); 24 are no better."""
HIDDEN = 0.1
"""Maximum fraction of its light that comes through dynamic Gaussians, for a Gaussian that an earlier frame does not show."""


def spans_of(windows: Sequence[tuple[int, int]], times: np.ndarray) -> np.ndarray:
    """Return (P,4) when each of the windows (first frame, end) is there: ramps amid the shared frames, none at the clip's ends.

    `times (T,)`: those of the frames.
    """
    spans = np.array([ALWAYS] * len(windows))
    for number, ((_, end), (start, _)) in enumerate(pairwise(windows)):
        first, last = times[start], times[end - 1]
        middle = (first + last) / 2
        spans[number, 2:] = spans[number + 1, :2] = max(first, middle - FADE / 2), min(last, middle + FADE / 2)
    return spans


def join_scenes(
    scenes: Iterable[Scene],
    windows: Sequence[tuple[int, int]],
    backend: str = "auto",
    progress: Progress = silent,
    times: np.ndarray | None = None,
) -> Scene:
    """Return one scene of the scenes of `windows` (first frame, end) in order; each counts its frames and its time from 0.

    `times (T,)` are those of all frames, which are evenly spaced when None.

    `scenes` are taken one after the other, so that only one need be in memory. Edits, features and metrics are left behind:
    they belong to the whole, not to parts. A person seen in the shared frames of two windows has one number (`joined_people`).
    Raises F4xError where scenes and windows do not belong together.
    """
    times = np.arange(windows[-1][1], dtype=np.float64) if times is None else times
    spans = spans_of(windows, times)
    static, moving, path, held_out = _Background(), _Moving(windows, spans, times), _Path(windows, times), set[int]()
    people, since = JoinedPeople(), 0
    last: Scene | None = None
    for number, (scene, (start, end)) in enumerate(zip(scenes, windows, strict=True)):
        progress("join", number, len(windows))
        if len(scene.cameras) != end - start or (last is not None and scene.next_id < last.next_id):
            raise F4xError(
                f"{scene.name}: these scenes are not the windows {start}:{end} of one clip; fit the clip again."
            )
        static.add(scene, spans[number])
        moving.add(scene, number, start)
        path.add(scene.cameras, spans[number], start)
        held_out.update(frame + start for frame in scene.held_out)
        end_before = start if last is None else since + len(last.cameras)
        people.add(scene, last, [(times[t] - times[since], times[t] - times[start]) for t in range(start, end_before)])
        last, since = scene, start
    assert last is not None
    dynamic, scaffold = moving.finish()
    joined = replace(
        last,
        static=static.finish(),
        dynamic=dynamic,
        scaffold=scaffold,
        cameras=path.finish(),
        held_out=tuple(sorted(held_out)),
        metrics={},
        edits=(),
        features=None,
        extra={},
    )
    compared = [times[frame] for frame in _compared_frames(windows)]
    goes_on = np.isin(joined.static.ids, np.concatenate(static.earlier))
    return people.stored_in(_with_new_ground(joined, goes_on, compared, backend, progress))


@dataclass
class _Background:
    """The union of the background's Gaussians as windows come in."""

    parts: list[StaticSet] = field(default_factory=list)
    spans: list[np.ndarray] = field(default_factory=list)
    earlier: list[np.ndarray] = field(default_factory=list)
    """Ids of Gaussians that go on from others of the window before (`EARLIER`), window by window."""

    def add(self, scene: Scene, span: np.ndarray) -> None:
        """Add the whole background of a window."""
        static = scene.static
        for known, when in zip(self.parts, self.spans, strict=True):
            gone = ~np.isin(known.ids, static.ids) & (when[:, 3] == np.inf)
            when[gone, 2:] = span[:2]
        known_ids = np.concatenate([np.zeros(0, np.int64), *(part.ids for part in self.parts)])
        new = static.take(~np.isin(static.ids, known_ids))
        self.parts.append(new)
        self.earlier.append(scene.extra.get(EARLIER, np.zeros(0, np.int64)))
        self.spans.append(np.tile([*span[:2], np.inf, np.inf], (len(new), 1)))

    def finish(self) -> StaticSet:
        """Return the whole background, with the span in which each Gaussian is present."""
        return concatenated(self.parts, self.spans)


@dataclass
class _Moving:
    """Dynamic Gaussians and scaffolds of the windows, one window after the other."""

    windows: Sequence[tuple[int, int]]
    spans: np.ndarray
    times: np.ndarray
    parts: list[DynamicSet] = field(default_factory=list)
    scaffolds: list[Scaffold] = field(default_factory=list)
    numbers: list[int] = field(default_factory=list)
    last: Scene | None = None
    """The window before, its dynamic set alone, until it is known which nodes go on."""

    def add(self, scene: Scene, number: int, start: int) -> None:
        """Add the moving Gaussians and the scaffold of a window, if it has any."""
        self._rest(scene)
        if scene.scaffold is not None:
            self.scaffolds.append(replace(scene.scaffold, times=scene.scaffold.times + self.times[start]))
            self.numbers.append(number)
            own = scene.dynamic.span
            moved = replace(scene.dynamic, span=None if own is None else own + np.float32(self.times[start]))
            self.last = replace(scene, static=StaticSet.empty(), dynamic=moved, extra={})

    def _rest(self, following: Scene | None) -> None:
        """Take over the set of the last window with nodes, now that the one after it is known."""
        if self.last is None or self.last.scaffold is None:
            return
        number, own = self.numbers[-1], self.scaffolds[-1]  # times are the clip's
        after = np.zeros(0, np.int64) if following is None or following.scaffold is None else following.scaffold.ids
        before = self.scaffolds[-2].ids if len(self.scaffolds) > 1 else np.zeros(0, np.int64)
        shared = np.isin(own.ids, [*before, *after])
        begin = self.times[self.windows[number - 1][1]] if number else -np.inf
        end = self.times[self.windows[number + 1][0]] if number + 1 < len(self.windows) else np.inf
        alone = np.flatnonzero((own.times >= begin) & (own.times < end))
        self.parts.append(_rested(self.last, alone, shared))
        self.last = None

    def finish(self) -> tuple[DynamicSet, Scaffold | None]:
        """Return the joined set and scaffold."""
        self._rest(None)
        if not self.parts:
            return DynamicSet.empty(), None
        spans = self.spans[self.numbers]
        scaffold, rows = join_scaffolds(self.scaffolds, spans)
        slots = max(part.node.shape[1] for part in self.parts)
        parts = [
            replace(
                part,
                reference=np.searchsorted(scaffold.times, own.times[part.reference]).astype(np.int32),
                node=np.pad(row[part.node], ((0, 0), (0, slots - part.node.shape[1])), mode="edge").astype(np.int32),
                weight=np.pad(part.weight, ((0, 0), (0, slots - part.node.shape[1]))),
            )
            for part, own, row in zip(self.parts, self.scaffolds, rows, strict=True)
        ]
        return concatenated(parts, [within(part, span) for part, span in zip(parts, spans, strict=True)]), scaffold


@dataclass
class _Path:
    """Cameras of the windows, one window after the other; over shared frames they blend into each other."""

    windows: Sequence[tuple[int, int]]
    times: np.ndarray
    size: tuple[int, int] = (0, 0)

    def __post_init__(self) -> None:
        frames = self.windows[-1][1] - self.windows[0][0]
        self.intrinsics, self.turn = np.zeros((frames, 3, 3)), np.zeros((frames, 4))
        self.centre, self.total = np.zeros((frames, 3)), np.zeros(frames)

    def add(self, cameras: CameraPath, span: np.ndarray, start: int) -> None:
        """Add the cameras of a window."""
        self.size = cameras.width, cameras.height
        rows = slice(start - self.windows[0][0], start - self.windows[0][0] + len(cameras))
        when = self.times[start : start + len(cameras)]
        weight = np.maximum([presence(span[None], time)[0] for time in when], 1e-6)
        turn, centre = pose.invert(*pose.from_matrix(cameras.world_to_camera))
        turn = turn * np.where((self.turn[rows] * turn).sum(-1, keepdims=True) < 0, -1, 1)
        self.intrinsics[rows] += weight[:, None, None] * cameras.intrinsics
        self.turn[rows] += weight[:, None] * turn
        self.centre[rows] += weight[:, None] * centre
        self.total[rows] += weight

    def finish(self) -> CameraPath:
        """Return the weighted mean of all windows' cameras, for every frame."""
        inverse = pose.invert(quaternion.normalize(self.turn), self.centre / self.total[:, None])
        times = self.times[self.windows[0][0] : self.windows[-1][1]]
        return CameraPath(self.intrinsics / self.total[:, None, None], pose.to_matrix(*inverse), times, *self.size)


def _rested(scene: Scene, alone: np.ndarray, shared: np.ndarray) -> DynamicSet:
    """Return the dynamic set of a window, where it follows `shared (M,)` nodes resting at frames (rows) that are its `alone`.

    At the other frames those nodes are also another window's. What follows none of them rests where it was fitted: to rest
    elsewhere is not quite the same where nodes part, least of all at a window's first and last frames, which are fitted worst.
    """
    dynamic, scaffold = scene.dynamic, scene.scaffold
    assert scaffold is not None
    if len(alone) == 0:
        return dynamic
    near = alone[np.abs(scaffold.times[:, None] - scaffold.times[alone]).argmin(1)]  # (F,)
    reference = near[dynamic.reference]
    means, quats = dynamic.means.copy(), dynamic.quats.copy()
    reference = np.where(shared[dynamic.node].any(1), reference, dynamic.reference)
    changed = reference != dynamic.reference
    for row in np.unique(reference[changed]):
        posed, here = scene.posed(float(scaffold.times[row])), changed & (reference == row)
        means[here], quats[here] = posed.means[posed.dynamic][here], posed.quats[posed.dynamic][here]
    return replace(dynamic, means=means, quats=quats, reference=reference.astype(np.int32))


def _with_new_ground(
    scene: Scene, goes_on: np.ndarray, compared: Sequence[float], backend: str, progress: Progress
) -> Scene:
    """Return the scene with background that no earlier frame shows present from the beginning; `compared`: times to try.

    Gaussians that continue others, `goes_on (S,)` bool, begin as they are: the others are there before. Background that a later
    window removed, and that moving objects hide as long as it is there, was wrong all the time: it is left out.
    """
    if scene.static.span is None:
        return scene
    span = scene.static.span.copy()
    since, until = span[:, 0].copy(), span[:, 3].copy()
    early, gone = (since > -np.inf) & ~goes_on, until < np.inf
    span[early, :2] = -np.inf
    open_ground = replace(scene, static=replace(scene.static, span=span))
    alone_there = open_ground.background
    too_early, in_sight, judged = (np.zeros(len(span), bool) for _ in range(3))
    for done, time in enumerate(compared):
        progress("join", done, len(compared), "what earlier frames would show")
        before, alive = early & (since > time) & ~too_early, gone & (since <= time) & (until > time) & ~in_sight
        if before.any() or alive.any():
            weight, alone = (_weights(one, time, backend)[: len(span)] for one in (open_ground, alone_there))
            shows = weight > HIDDEN * alone  # of any weight: thousands of little ones add up
            too_early |= before & shows
            in_sight |= alive & shows
            judged |= alive & (alone > 0)
    kept = scene.static.span.copy()
    kept[early & ~too_early, :2] = -np.inf
    stays = ~judged | in_sight
    static = scene.static.take(stays)
    return replace(scene, static=replace(static, span=None if (kept[stays] == ALWAYS).all() else kept[stays]))


def _compared_frames(windows: Sequence[tuple[int, int]]) -> Iterator[int]:
    """Yield frames in which the background of later windows is compared."""
    for start, end in windows[:-1]:
        yield from np.unique(np.linspace(start, end - 1, COMPARED_PER_WINDOW).round().astype(int)).tolist()


def _weights(scene: Scene, time: float, backend: str) -> np.ndarray:
    """Return (N,) blend weights of every Gaussian, summed over the clip's picture at `time`."""
    from ..raster.blend_weights import blend_weight_sums

    camera = scene.cameras.at(time)
    whole = np.ones((camera.height, camera.width, 1), np.float32)
    return blend_weight_sums(scene.posed(time), camera, whole, backend=backend)[:, 0]
