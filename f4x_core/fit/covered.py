"""Makes up the background that moving objects hide in all frames, from what is seen around it.

No frame shows it. The static Gaussians there get only what shines through the edges of the thing before them, and a fit paints them
with its colours; where there are none at all the scene has a hole. Seen from the side, or without the thing, both are its ghost.
Inverse depth and colours go on into the hidden part of a picture as harmonic functions (Perez et al., "Poisson Image Editing",
2003): a plane goes on as that plane, without detail.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy import sparse
from scipy.sparse.linalg import splu

from ..gaussians import SpawnConfig, Spawned
from ..gaussians.spawn import DepthImage, coarse_to_fine, cover
from ..geometry import quaternion
from ..geometry.arrays import evenly_spaced
from ..geometry.camera import Camera
from ..geometry.spherical_harmonics import dc_from_rgb
from ..geometry.trajectory import View
from ..raster.blend_weights import blend_weight_sums
from ..scene import MADE_UP, Scene, StaticSet
from ..scene.concatenation import followed_by
from ..scene.people import people_of, with_people_by_id, without_people
from ..scene.view import render
from .needs import Need

VIEWS, COLUMNS = 32, 240
"""Views, evenly over the clip, that are looked at, and their width in pixels."""
COVERED, CLEAR = 0.2, 0.7
"""Largest blend weight of a static Gaussian over all views, as a fraction of the largest without moving objects: below the first it
is covered, above the second it lends its colours to covered ones. With .35 pictures along the path lose two to three times as much
(train .2 dB), and the scene without the movers looks the same."""
SEEN = 0.1
"""Least blend weight, in pixels of a view, of a Gaussian of which that view tells."""
OPAQUE = 0.9
"""Alpha from which dynamic Gaussians hide a pixel, and from which static ones leave no hole; fraction of clear Gaussians in a pixel
that is known."""
MIN_HOLE = 4
"""Pixels; less of a view is no hole."""
NEARER = 0.9
"""Surfaces nearer than this many times the nearest mover stand before the movers, and do not go on behind them."""
FIRST = 5
"""Percentile of the movers' depths that is the nearest: single Gaussians stray."""
MADE = SpawnConfig(spacing=2.0, scale=0.7, opacity=0.95)
"""Cells in pixels of a view, so large that a layer is opaque: there is no detail that smaller ones could show."""
BEHIND = 1.02
"""Factor by which made-up surfaces lie behind those that go on into them, which hides their rims. At the same depth more of them
is in sight and left out: in two of four toys the hole is .25 dB farther from the truth."""
THIN = 0.05
"""Opacity with which new ones are looked for in the views: opaque ones would hide each other, and come to light where one is taken
out."""
SHINES = 0.1
"""Fraction of its own light that may reach any view; what shows more is not hidden, and not made up. With .2 pictures along
camel's path lose .01 dB more, and no hole gains .1."""


def completed(scene: Scene) -> Scene:
    """Return a fitted scene with the background that movers hide in all frames made up: new colours and new Gaussians.

    A row of the scene's needs counts them. Not for a window of a longer clip: the next one would take them for what was seen.
    """
    if not len(scene.dynamic) or not len(scene.static):
        return scene
    if people := people_of(scene):  # what is made up is nobody's
        return with_people_by_id(completed(without_people(scene)), scene.ids, people)
    making = _Making.of(scene)
    for which in coarse_to_fine(len(making.views)):
        making.look(making.views[which])
    return making.finish()


@dataclass
class _Making:
    """The background while it is made up, view after view."""

    scene: Scene
    """The scene with everything made up so far."""
    views: Sequence[View]
    """Small ones, evenly over the clip."""
    first: int
    """Static Gaussians that were there before."""
    clear: np.ndarray
    """(S,) bool: some view shows it, or it is in none."""
    covered: np.ndarray
    """(first,) bool: no view shows it."""
    painted: np.ndarray
    """(first,) bool: of new colours."""
    light: np.ndarray
    """(S - first,) that of each new Gaussian if it were opaque and alone, in pixels of a view."""
    rng: np.random.Generator

    @classmethod
    def of(cls, scene: Scene) -> _Making:
        """Nothing is made up yet."""
        cameras = scene.cameras
        frames = evenly_spaced(len(cameras), VIEWS)
        views = [View(cameras[int(frame)].of_width(COLUMNS), float(cameras.times[frame])) for frame in frames]
        shown, seen = _shown(scene, views)
        covered, clear = seen & (shown < COVERED), ~seen | (shown > CLEAR)
        rng = np.random.default_rng(0)
        return cls(scene, views, len(shown), clear, covered, np.zeros_like(covered), np.zeros(0), rng)

    def look(self, view: View) -> None:
        """Make up what a view should show if nothing moved."""
        camera, time = view
        moving = render(replace(self.scene, static=StaticSet.empty()), camera, time, ("depth", "alpha"))
        hidden = moving["alpha"] > OPAQUE
        if not hidden.any():
            return
        away = camera.project(self.scene.static.means)[1]
        lends = self.clear & (away > NEARER * np.percentile(moving["depth"][hidden], FIRST))
        values = {"lends": lends[:, None].astype(np.float32)}
        drawn = render(self.scene.background, camera, time, ("rgb", "depth", "alpha"), values=values)
        hole = hidden & (drawn["alpha"] < OPAQUE)
        hole &= hole.sum() >= MIN_HOLE
        rows, (row, column) = self._covered_in(camera, hidden)
        if not hole.any() and not len(rows):
            return
        known = (drawn["alpha"] > OPAQUE) & (drawn["lends"][..., 0] > OPAQUE * drawn["alpha"])
        if not known.any():
            return
        rgb = drawn["rgb"] / np.maximum(drawn["alpha"], OPAQUE)[..., None]
        inside = harmonic(np.concatenate([rgb, 1 / drawn["depth"][..., None]], -1), known)
        rgb, depth = inside[..., :3].clip(0, 1), BEHIND / inside[..., 3]
        self._paint(rows, rgb[row, column])
        depth = np.maximum(depth, BEHIND * np.nan_to_num(moving["depth"]))
        image = (255 * rgb).round().astype(np.uint8)
        self._add(cover(DepthImage(image, depth, hole, camera), np.zeros((0, 3)), MADE, self.rng), camera)

    def finish(self) -> Scene:
        """Return the scene, without what proved to be in sight."""
        scene, made = self.scene, self._hidden()
        if not made.any() and not self.painted.any():
            return replace(scene, static=scene.static.take(slice(self.first)))
        need = Need(
            "hidden background",
            f"Gaussians made up: {made.sum():,}, painted like what is around them: {self.painted.sum():,}",
            f"what moves hides it in all of {len(self.views)} views: a guess, without detail",
            "-",
        )
        static = scene.static.take(np.append(np.ones(self.first, bool), made))
        extra = {MADE_UP: np.append(self.painted, np.ones(made.sum(), bool))}
        return replace(scene, static=static, needs=(*scene.needs, need.row()), extra={**scene.extra, **extra})

    def _hidden(self) -> np.ndarray:
        """Return (n,) bool: new Gaussians that are in sight in no view, with one another or alone."""
        static = self.scene.static
        if len(static) == self.first:
            return np.zeros(0, bool)
        opacities = np.append(static.opacities[: self.first], np.full(len(self.light), THIN, np.float32))
        thin = replace(self.scene, static=replace(static, opacities=opacities))
        most = np.max([_light(thin, view)[self.first : len(static)] for view in self.views], 0)
        return most <= SHINES * THIN * self.light

    def _covered_in(self, camera: Camera, hidden: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return (n,) rows of covered Gaussians, not yet painted, whose centres `hidden (H,W)` pixels cover, (2,n) those pixels."""
        rows = np.flatnonzero(self.covered & ~self.painted)
        pixels, z = camera.project(self.scene.static.means[rows])
        inside = (z > 0) & ((pixels >= 0) & (pixels < [camera.width, camera.height])).all(1)
        rows, place = rows[inside], np.floor(pixels[inside]).astype(int).T[::-1]
        covered = hidden[place[0], place[1]]
        return rows[covered], place[:, covered]

    def _paint(self, rows: np.ndarray, rgb: np.ndarray) -> None:
        """Give static Gaussians colours (n,3) that are the same from all sides."""
        static = self.scene.static
        sh = static.sh.copy()
        sh[rows] = 0
        sh[rows, 0] = dc_from_rgb(rgb)
        self.scene = replace(self.scene, static=replace(static, sh=sh))
        self.painted[rows] = True

    def _add(self, new: Spawned, camera: Camera) -> None:
        """Add opaque Gaussians, seen by `camera`, after all others."""
        count, scene = len(new), self.scene
        sh = np.zeros((count, *scene.static.sh.shape[1:]), np.float32)
        sh[:, 0] = dc_from_rgb(new.rgb)
        made = StaticSet(
            new.means,
            np.tile(quaternion.IDENTITY.astype(np.float32), (count, 1)),
            np.tile(new.radius[:, None], (1, 3)),
            np.full(count, MADE.opacity, np.float32),
            sh,
            ids=scene.next_id + np.arange(count),
        )
        self.scene = replace(scene, static=followed_by(scene.static, made))
        self.clear = np.append(self.clear, np.zeros(count, bool))
        size = camera.focal * new.radius / new.depth
        self.light = np.append(self.light, 2 * np.pi * size**2)


def harmonic(values: np.ndarray, known: np.ndarray) -> np.ndarray:
    """`values (H,W,C)` where `known (H,W)` bool; every other pixel is the mean of those above, below and beside it. float64."""
    if known.all():
        return values.astype(np.float64)
    index = np.arange(known.size).reshape(known.shape)
    pairs = np.concatenate([[index[:, :-1].ravel(), index[:, 1:].ravel()], [index[:-1].ravel(), index[1:].ravel()]], 1)
    beside = sparse.csr_matrix((np.ones(pairs.shape[1]), pairs), (known.size, known.size))
    given, open_ = np.flatnonzero(known), np.flatnonzero(~known)
    rows = (beside + beside.T)[open_]
    laplacian = sparse.diags(rows @ np.ones(known.size)) - rows[:, open_]
    flat = values.reshape(known.size, -1).astype(np.float64)
    flat[open_] = splu(laplacian.tocsc()).solve(rows[:, given] @ flat[given])
    return flat.reshape(values.shape)


def _light(scene: Scene, view: View) -> np.ndarray:
    """Return (N,) the blend weight of each Gaussian in a view, in pixels, static ones first."""
    layer = np.ones((view.camera.height, view.camera.width, 1), np.float32)
    return blend_weight_sums(scene.posed(view.time), view.camera, layer)[:, 0]


def _shown(scene: Scene, views: Sequence[View]) -> tuple[np.ndarray, np.ndarray]:
    """Return (S,) the fraction `COVERED` is about, of each static Gaussian, and (S,) bool: the Gaussians that are in some view."""
    count, background = len(scene.static), scene.background
    alone, reaches = np.zeros(count), np.zeros(count)
    for view in views:
        alone = np.maximum(alone, _light(background, view))
        reaches = np.maximum(reaches, _light(scene, view)[:count])
    seen = alone > SEEN
    return np.where(seen, reaches / np.maximum(alone, SEEN), 0), seen
