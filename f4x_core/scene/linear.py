"""Appearance of a scene for renderers that add no footprint and blend in linear light, such as Blender 5.3's Cycles.

A fit widens every projected Gaussian by a footprint (`RasterConfig.blur`) and blends display colours. Programs that do neither get
scales with the footprint in them, or, where `fit.linear_light` has refitted the scene for them, scales, opacities and colours of
their own. Those are stored beside the fitted ones, in `Scene.extra`:

    static/linear_scale    (Ns,3)     dynamic/linear_scale    (Nd,3)
    static/linear_opacity  (Ns,)      dynamic/linear_opacity  (Nd,)
    static/linear_dc       (Ns,3)     dynamic/linear_dc       (Nd,3)   coefficient of degree 0; others stay
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from ..raster.contract import RasterConfig
from .model import PosedSplats, Scene, StaticSet
from .posing import Posable

NAMES = ("linear_scale", "linear_opacity", "linear_dc")
PARTS = ("static", "dynamic")
SAMPLED = 12
"""Number of moments of the clip at which distances to the camera are measured."""
NEAR = 0.01
"""Smallest distance, world units."""
SOLID = 1 - 1e-6
"""Largest opacity that has an optical depth; greater ones are taken for it."""


@dataclass(frozen=True)
class Look:
    """The part of N Gaussians, static ones first, that a refit changes."""

    scales: np.ndarray
    """(N,3) float32 standard deviations, world units."""
    opacities: np.ndarray
    """(N,) float32 in [0, 1]."""
    dc: np.ndarray
    """(N,3) float32 coefficients of degree 0; they make display colours, of which the renderer takes the linear light."""


def is_refitted(scene: Scene) -> bool:
    """Return True if the scene has an appearance that was fitted for such renderers."""
    wanted = {f"{part}/{name}" for part, held in _parts(scene) if len(held) for name in NAMES}
    return wanted <= scene.extra.keys()


def linear_look(scene: Scene) -> Look:
    """Return the unedited scene's appearance for linear light: the refitted one, else the fitted with footprint in its scales."""
    if is_refitted(scene):
        parts = [part for part, held in _parts(scene) if len(held)] or ["static"]
        return Look(*(np.concatenate([scene.extra[f"{part}/{name}"] for part in parts]) for name in NAMES))
    look = fitted_look(scene)
    return replace(look, scales=widened(look.scales, footprint(scene.base)))


def fitted_look(scene: Scene) -> Look:
    """Return scales, opacities and colors of the unedited scene as fitted, for the rasterizer's rule."""
    opacities, sh = scene.base.full_appearance
    return Look(np.concatenate([held.scales for _, held in _parts(scene)]), opacities, sh[:, 0])


def with_look(scene: Scene, look: Look | None) -> Scene:
    """Return the scene with `look` stored in it; None takes out what is stored."""
    extra = {name: array for name, array in scene.extra.items() if name.partition("/")[2] not in NAMES}
    if look is not None:
        for name, values in zip(NAMES, (look.scales, look.opacities, look.dc), strict=True):
            for part, rows in _rows(scene).items():
                extra[f"{part}/{name}"] = np.ascontiguousarray(values[rows], np.float32)
    return replace(scene, extra=extra)


def linear_scene(scene: Scene) -> Scene:
    """Return the unedited scene with its `linear_look` as its own arrays."""
    look = linear_look(scene)
    sets: Mapping[str, StaticSet] = dict(_parts(scene))
    new = {}
    for part, rows in _rows(scene).items():
        sh = sets[part].sh.copy()
        sh[:, 0] = look.dc[rows]
        new[part] = replace(sets[part], scales=look.scales[rows], opacities=look.opacities[rows], sh=sh)
    return replace(scene, **new)  # type: ignore[arg-type]


def footprint(scene: Posable) -> np.ndarray:
    """Return (N,) float32, in the order of `posed`, the std in world units of the footprint where the clip saw each Gaussian.

    The footprint is `sqrt(blur)` pixels of the fitted pictures; `z / f` of those cameras in whose picture a Gaussian was, the
    median, turns it into world units. 0 where it is not known how the Gaussians were fitted.
    """
    if not isinstance(scene, Scene) or scene.fitted_focal(float(scene.cameras.times[0])) is None:
        return np.zeros(len(scene.posed(float(scene.cameras.times[0])).means), np.float32)
    base = scene.base
    times = base.cameras.times[np.linspace(0, len(base.cameras) - 1, min(SAMPLED, len(base.cameras))).astype(int)]
    seen = np.full((len(times), len(base.ids)), np.nan, np.float32)
    anywhere = np.zeros(seen.shape, np.float32)
    for row, time in enumerate(times):
        camera, means = base.cameras.at(float(time)), base.untinted(float(time)).means.astype(np.float64)
        pixels, z = camera.project(means)
        inside = (z > NEAR) & ((pixels >= 0) & (pixels <= (camera.width, camera.height))).all(1)
        anywhere[row] = np.maximum(np.abs(z), NEAR) / camera.focal
        seen[row] = np.where(inside, anywhere[row], np.nan)
    never = np.isnan(seen).all(0)
    seen[:, never] = anywhere[:, never]
    width: np.ndarray = np.sqrt(RasterConfig.blur) * np.nanmedian(seen, axis=0)
    return width[scene.origin].astype(np.float32)


def with_footprint(posed: PosedSplats, footprint: np.ndarray) -> PosedSplats:
    """Return all Gaussians of a moment with `footprint (N,)` in their scales, for programs that add none."""
    return replace(posed, scales=widened(posed.scales, footprint)) if footprint.any() else posed


def widened(scales: np.ndarray, footprint: np.ndarray) -> np.ndarray:
    """Return scales (N,3) with a footprint (N,) in them, `sqrt(s^2 + w^2)`; opacities stay, as in the rasterizer's rule."""
    wide: np.ndarray = np.hypot(scales, footprint[:, None])
    return wide.astype(np.float32)


def footprint_in(wide: np.ndarray, fitted: np.ndarray) -> np.ndarray:
    """Return (N,) the footprint that made `wide (N,3)` of `fitted (N,3)` scales."""
    return narrowed(wide[:, :1], fitted[:, 0])[:, 0]


def narrowed(scales: np.ndarray, footprint: np.ndarray) -> np.ndarray:
    """Undo `widened`: scales below the footprint's rounding become 0."""
    narrow: np.ndarray = np.sqrt(
        np.maximum(scales.astype(np.float64) ** 2 - footprint[:, None].astype(np.float64) ** 2, 0)
    )
    return narrow.astype(np.float32)


@dataclass(frozen=True)
class Fitted:
    """The step from the linear appearance of N Gaussians to the fitted one, also after the linear one was changed.

    A viewer stores it beside the linear appearance, fades or recolours that, and gets the fitted one faded or recoloured alike.
    """

    scale: np.ndarray
    """(N,3) factor of scales."""
    dc: np.ndarray
    """(N,3) to be added to coefficients of degree 0."""
    depth: np.ndarray
    """(N,) factor of the optical depth `-ln(1 - opacity)`, which is what a Gaussian that is present in part has a part of."""

    @classmethod
    def of(cls, fitted: Look, linear: Look) -> Fitted:
        """Return the step from `linear` to `fitted`, the same Gaussians as a rasterizer with footprint draws them."""
        scale = _ratio(fitted.scales.astype(np.float64), linear.scales.astype(np.float64))
        return cls(scale, fitted.dc - linear.dc, _ratio(_depth(fitted.opacities), _depth(linear.opacities)))

    def from_linear(self, linear: Look) -> Look:
        """Return the fitted appearance that belongs to `linear`."""
        opacities = -np.expm1(-_depth(linear.opacities) * self.depth)
        return Look(linear.scales * self.scale, opacities.astype(np.float32), linear.dc + self.dc)


def _depth(opacities: np.ndarray) -> np.ndarray:
    """Return the optical depth in float64."""
    depth: np.ndarray = -np.log1p(-np.minimum(opacities.astype(np.float64), SOLID))
    return depth


def _ratio(above: np.ndarray, below: np.ndarray) -> np.ndarray:
    """Return `above / below` in float32, 1 where `below` is 0."""
    return np.divide(above, below, out=np.ones_like(above), where=below > 0).astype(np.float32)


def _parts(scene: Scene) -> tuple[tuple[str, StaticSet], ...]:
    return ("static", scene.static), ("dynamic", scene.dynamic)


def _rows(scene: Scene) -> dict[str, slice]:
    """Return the rows of each set that is not empty, in the order of `posed`."""
    count = len(scene.static)
    rows = {"static": slice(0, count), "dynamic": slice(count, count + len(scene.dynamic))}
    return {part: rows[part] for part, held in _parts(scene) if len(held)}
