"""The matte of a selection, refined along its outline in the picture that is drawn. Needs numpy alone.

Whole Gaussians end softly: within a few pixels of a thing's outline their coverage says little. There each pixel is judged by its
coverage, by local models of the thing's colours and of those around it (Bai et al., Video SnapCut, SIGGRAPH 2009) and, of what
moves, by its difference from the background behind; a random walker with priors (Grady 2005) smooths that between edges.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from ..geometry.camera import Camera
from ..geometry.trajectory import Trajectory, View
from ..progress import Progress, silent
from ..scene import Scene
from ..scene.clouds import Cloud
from ..scene.color import srgb_from_linear
from ..scene.exposure import Take
from ..scene.stage import MATTE, DrawSettings, draw
from ..scene.view import render
from .k_means import k_means, nearest
from .objects import MOSTLY
from .pixels import SHOWN
from .random_walk import walk_with_prior
from .score import logistic
from .select_config import SELECT, MatteConfig
from .selection import Selection
from .standing_out import BEHIND, unlike
from .superpixels import OPPONENT

OBJECTS = f"{MATTE}object"
"""Pass of mattes that tells the selections of a scene apart."""
MOVES = "moving"
"""Layer of a cloud, (N,1): 1 for the Gaussians that move."""
ABSENT = 1e-6
"""Coverage below which nothing is covered."""
BLOCKS = 50
"""Reach of a window of colours, in blocks of pixels, at most about: a window of 480 columns, pixel by pixel."""
UNCERTAIN = 0.02
"""Least probability of a pixel by its coverage alone, and of its opposite: so log-odds stay finite."""


def matte_image(
    scene: Scene,
    selection: Selection,
    camera: Camera,
    time: float,
    backend: str = "auto",
    config: MatteConfig = SELECT.matte,
) -> np.ndarray:
    """Return the matte (H,W) float32 in [0, 1] of a selection at clip time `time`; 0 outside its span."""
    if not selection.holds_at(time):
        return np.zeros((camera.height, camera.width), np.float32)
    return mattes(scene, selection.chosen[:, None], View(camera, time), backend, config)[..., 0]


def mattes(
    scene: Scene, chosen: np.ndarray, view: View, backend: str = "auto", config: MatteConfig = SELECT.matte
) -> np.ndarray:
    """Return the mattes (H,W,K) float32 of the Gaussians `chosen (N,K)` bool: what they cover (sum of blend weights), refined."""
    drawn = render(scene, *view, ("rgb",), backend, values={"chosen": chosen.astype(np.float32)})
    return _refined(scene, chosen, drawn, view, backend, config)


def _refined(
    scene: Scene, chosen: np.ndarray, drawn: Mapping[str, np.ndarray], view: View, backend: str, config: MatteConfig
) -> np.ndarray:
    """Return `mattes` by the picture "rgb" and the coverage "chosen" (H,W,K) that are `drawn` of a view."""
    coverage = np.clip(drawn["chosen"], 0, 1)
    moves = (chosen & scene.moving[:, None]).sum(0) > MOSTLY * chosen.sum(0)
    behind = background_of(scene, view, backend) if moves.any() else None
    parts = [
        refine_matte(own, drawn["rgb"], behind if moves[k] else None, config)
        for k, own in enumerate(np.moveaxis(coverage, -1, 0))
    ]
    return np.stack(parts, -1)


def refine_passes(
    images: Mapping[str, np.ndarray], take: Take, settings: DrawSettings, selections: Collection[int]
) -> dict[str, np.ndarray]:
    """Return the mattes (H,W) of `images` anew: those of selections refined along their outlines, the others cover what is left.

    Args:
        images: passes of `exposure.shoot`, sharp; mattes are those of the pass `OBJECTS`.
        take: what they show; its clouds tell by the layer `MOVES` which Gaussians move.
        settings: those with which they were drawn.
        selections: uint32 ids of selections.
    """
    coverage = {name: image for name, image in images.items() if name.startswith(OBJECTS)}
    ids = {name: number for number in selections if (name := f"{OBJECTS}:{number:08x}") in coverage}
    if not ids:
        return {}
    moves = {name: _moves(take.clouds, number) for name, number in ids.items()}
    combined = images["combined"]
    alpha = combined[..., 3:]
    picture = srgb_from_linear(combined[..., :3] / np.where(alpha > 0, alpha, 1)) * alpha
    under = _without_movers(take, settings, [OBJECTS]) if any(moves.values()) else {}
    behind = np.dstack([under["rgb"], under["alpha"]]) if under else None
    wider, config = take.camera.width / picture.shape[1], SELECT.matte  # a region of the picture
    config = replace(config, reach=config.reach * wider, window=config.window * wider)
    fine = {name: refine_matte(coverage[name], picture, behind if moves[name] else None, config) for name in ids}
    return _shared_out(coverage, fine, under)


class MaskedView(NamedTuple):
    """A view of a scene in which something is selected."""

    matte: np.ndarray
    """(H,W) float32 in [0, 1], as `matte_image`; above `pixels.SHOWN` is the mask."""
    picture: np.ndarray
    """(H,W,3) float32 sRGB."""
    scores: np.ndarray
    """(H,W) float32 in [0, 1]: what all Gaussians cover, by their scores."""


def mask_video(
    scene: Scene, selection: Selection, trajectory: Trajectory, backend: str = "auto", progress: Progress = silent
) -> Iterator[MaskedView]:
    """Yield what is selected in every view; mattes and scores are 0 outside the selection's span."""
    selection = selection.for_ids(scene.ids)
    chosen = selection.chosen[:, None]
    values = {"chosen": chosen.astype(np.float32), "scores": selection.scores[:, None].astype(np.float32)}
    for done, (camera, time) in enumerate(trajectory):
        progress("mask", done, len(trajectory))
        view, nothing = View(camera, time), np.zeros((camera.height, camera.width), np.float32)
        if selection.holds_at(time):
            drawn = render(scene, *view, ("rgb",), backend, values=values)
            matte = _refined(scene, chosen, drawn, view, backend, SELECT.matte)[..., 0]
            yield MaskedView(matte, drawn["rgb"], np.clip(drawn["scores"][..., 0], 0, 1))
        else:
            yield MaskedView(nothing, render(scene, *view, ("rgb",), backend)["rgb"], nothing)
    progress("mask", len(trajectory), len(trajectory))


def refine_matte(
    coverage: np.ndarray, picture: np.ndarray, background: np.ndarray | None = None, config: MatteConfig = SELECT.matte
) -> np.ndarray:
    """Return `coverage (H,W)`, anew within `config.reach` of its outline, by the sRGB `picture (H,W,3)` that shows the thing.

    `background (H,W,4)`: sRGB and alpha of what is behind; None: not known. Where the thing looks like it, as the ground
    between its legs does, coverage is in doubt within the outline, too.
    """
    width = coverage.shape[1]
    reach, window = (max(1, round(size * width)) for size in (config.reach, config.window))
    inside = coverage > SHOWN
    count = _sums(np.stack([inside, np.ones_like(inside)], -1), reach)
    band = (count[..., 0] > 0) & (count[..., 0] < count[..., 1])
    if not band.any():
        return coverage
    part = tuple(slice(max(0, int(at.min()) - window), int(at.max()) + window + 1) for at in np.nonzero(band | inside))
    band, inside, near = band[part], inside[part], coverage[part].astype(float)
    colour = np.clip(picture[part], 0, 1).astype(float) @ OPPONENT.T
    odds = np.clip(near, UNCERTAIN, 1 - UNCERTAIN)
    odds = np.log(odds / (1 - odds))
    if background is not None:
        known = background[part][..., 3] > BEHIND
        apart = unlike(picture[part], background[part][..., :3])
        alike = inside & known & (apart < config.alike_behind)
        band |= alike
        by_background = np.clip((apart - config.differs) / config.unsure, -config.against, config.favour)
        odds = np.where(alike, np.minimum(odds, config.doubt), odds) + np.where(known, by_background, 0)
    odds[band] += _colour_odds(colour, band, inside, window, config)
    refined = coverage.copy()
    refined[part] = walk_with_prior(_bonds(colour, band, config), logistic(odds), np.where(band, np.nan, near), 1.0)
    return refined


def background_of(scene: Scene, view: View, backend: str = "auto") -> np.ndarray:
    """Return (H,W,4) sRGB and alpha of the scene without its moving Gaussians."""
    cloud = replace(Cloud.of_scene(scene, view.time), layers={MOVES: scene.moving[:, None]})
    still = _without_movers(Take([cloud], [], view.camera), DrawSettings(backend=backend))
    return np.dstack([still["rgb"], still["alpha"]])


def _moves(clouds: Collection[Cloud], number: int) -> bool:
    """Return True if most of the Gaussians with the id `number` move."""
    chosen = [np.equal(cloud.mattes.get("object", 0), number) for cloud in clouds]
    moving = [rows & (np.ravel(cloud.layers.get(MOVES, 0)) > 0) for cloud, rows in zip(clouds, chosen, strict=True)]
    return sum(map(np.sum, moving)) > MOSTLY * sum(map(np.sum, chosen))


def _without_movers(take: Take, settings: DrawSettings, passes: Collection[str] = ()) -> dict[str, np.ndarray]:
    """Return `stage.draw` of what was taken without its moving Gaussians."""
    still = [
        replace(cloud, opacities=cloud.opacities * (np.ravel(cloud.layers.get(MOVES, 0)) == 0)) for cloud in take.clouds
    ]
    return draw(still, take.surfaces, take.camera, settings, passes=passes)


def _shared_out(
    mattes: Mapping[str, np.ndarray], fine: Mapping[str, np.ndarray], under: Mapping[str, np.ndarray]
) -> dict[str, np.ndarray]:
    """Return mattes (H,W) that together cover what `mattes` do: `fine`, no more than that, and the others the rest.

    What none of them covers goes to what is behind: `under`, passes without what moves.
    """
    covered, wanted = (np.sum([*each.values()], 0) for each in (mattes, fine))
    cut = np.minimum(1, covered / np.maximum(wanted, ABSENT))
    others = {
        name: image + ABSENT * (under.get(name, image.mean()) + ABSENT)
        for name, image in mattes.items()
        if name not in fine
    }
    rest = (covered - wanted * cut) / np.sum([*others.values()], 0) if others else 0
    return {name: each * cut for name, each in fine.items()} | {name: each * rest for name, each in others.items()}


def _colour_odds(
    colour: np.ndarray, band: np.ndarray, inside: np.ndarray, window: int, config: MatteConfig
) -> np.ndarray:
    """Return log-odds (n,) that a pixel of `colour (h,w,3)` in the `band (h,w)` is the thing's, by others `inside (h,w)` near it.

    Each side's colours are a histogram over the main colours of the picture in a window; a pixel that is like several of them
    has their mean.
    """
    rows = colour.reshape(-1, 3).astype(np.float32)
    centres = k_means(rows, config.colours, config.sample)
    step = max(1, round(window / BLOCKS))
    height, width = (-(-size // step) for size in band.shape)
    y, x = (place // step for place in np.indices(band.shape))
    cell = ((inside * height + y) * width + x) * len(centres) + nearest(rows, centres).reshape(band.shape)
    counts = np.bincount(cell[~band], minlength=2 * height * width * len(centres)).reshape(2, height, width, -1)
    reach = round(window / step)
    near = [_sums(side, reach)[y[band], x[band]].astype(float) for side in counts]  # (n,colours) around and inside
    like = np.exp(-((colour[band][:, None] - centres) ** 2).sum(-1) / (2 * config.alike**2))
    total = np.stack([around.sum(1) for around in near])
    part = np.stack([(like * around).sum(1) for around in near]) / np.maximum(total, 1) + config.unknown
    enough = (total >= config.enough * (2 * window + 1) ** 2).all(0)
    return np.where(enough, np.log(part[1] / part[0]), 0)


def _bonds(colour: np.ndarray, band: np.ndarray, config: MatteConfig) -> tuple[np.ndarray, np.ndarray]:
    """Return bonds (h-1,w) down and (h,w-1) across, weaker the more colours (h,w,3) differ for the `band (h,w)`."""
    squares = [(np.diff(colour, axis=axis) ** 2).sum(-1) for axis in (0, 1)]
    usual = np.concatenate([squares[0][band[1:]], squares[1][band[:, 1:]]]).mean() + np.finfo(float).tiny
    down, across = (config.bond * np.exp(-each / (2 * usual)) for each in squares)
    return down, across


def _sums(values: np.ndarray, reach: int) -> np.ndarray:
    """Return sums of `values (h,w,C)` over windows of `reach` pixels to each side; nothing is beyond the picture."""
    for axis in (0, 1):
        size = values.shape[axis]
        sums = np.insert(np.cumsum(values, axis, dtype=np.float32), 0, 0, axis)
        last, first = np.minimum(np.arange(size) + reach + 1, size), np.maximum(np.arange(size) - reach, 0)
        values = sums.take(last, axis) - sums.take(first, axis)
    return values
