"""Makes a skinned mesh of selected Gaussians."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ...errors import F4xError
from ...geometry.arrays import evenly_spaced
from ...progress import Progress, silent
from ..model import PosedSplats, Scene
from ..posing import plain_color
from .contour import contour
from .field import NARROWEST, Grid, opacity_field
from .simplify import decimated, largest_parts, normals_of, parts_of, smoothed
from .skin import Carriers, Skin, skin_of

RESOLUTIONS = (8, 256)
"""Fewest and most grid steps along the longest side: the latter take about 3 GB for a cube."""
FACES = (20, 1_000_000)
"""Fewest and most triangles that may be asked for."""
LOOKS, MOST = 30, 0.9
"""Clip times at most that are looked at for the widest one, and the fraction of all opacity that has to be there."""
MOMENTS, SAME = 7, 1e-4
"""Clip times at which an edited scene is compared with what its nodes do, and the world units up to which that is the same."""
APART = 0.5
"""Grid steps from the middle of a thin sheet to each of its sides."""
MIN_GAUSSIANS = 10
"""Gaussians that a thing needs: a surface around less says nothing about it."""


@dataclass(frozen=True)
class MeshConfig:
    """Resolution and cleaning of a mesh."""

    resolution: int = 96
    """Grid steps along the longest side of the thing."""
    faces: int = 20_000
    """Triangles at most."""
    level: float = 0.5
    """Opacity of the Gaussians at the surface, between 0 and 1."""
    rounds: int = 5
    """Rounds of smoothing; 0 = none."""
    min_part: float = 0.05
    """Parts with less than this fraction of the largest part's area are left out."""
    hollows: bool = False
    """Keep the walls of hollows inside, which nobody sees from outside."""

    def __post_init__(self) -> None:
        """Raise F4xError for settings out of range."""
        limits = {"resolution": RESOLUTIONS, "faces": FACES}
        for name, (low, high) in limits.items():
            value = getattr(self, name)
            if not low <= value <= high:
                raise F4xError(f"--{name} {value}: give a number from {low:,} to {high:,}.")
        if not 0 < self.level < 1:
            raise F4xError(f"--level {self.level:g}: give a number between 0 and 1.")


@dataclass(frozen=True, eq=False)
class SplatMesh:
    """A closed surface around Gaussians: V vertices, F triangles."""

    vertices: np.ndarray
    """(V,3) float32 in the world at the time of the skin."""
    faces: np.ndarray
    """(F,3) int32; seen from outside they turn to the left."""
    normals: np.ndarray
    """(V,3) float32 of length 1, outwards."""
    colors: np.ndarray
    """(V,3) float32 sRGB in [0, 1]: the mean colour of the Gaussians there."""
    skin: Skin | None
    """Skinning of the vertices; None where nothing moves."""
    parts: int
    """Connected parts."""

    @property
    def size(self) -> float:
        """The diagonal of its box, world units."""
        return float(np.linalg.norm(np.ptp(self.vertices, axis=0)))

    def write(self, path: Path) -> None:
        """Write its arrays into an .npz, for another process."""
        skin = {} if self.skin is None else {f"skin/{name}": value for name, value in vars(self.skin).items()}
        arrays = {name: value for name, value in vars(self).items() if name != "skin"}
        np.savez(path, **arrays, **skin)

    @classmethod
    def read(cls, path: Path) -> SplatMesh:
        """Read what `write` wrote."""
        with np.load(path) as file:
            arrays = dict(file)
        skin = {name.removeprefix("skin/"): arrays.pop(name) for name in list(arrays) if name.startswith("skin/")}
        made = Skin(**{**skin, "time": float(skin["time"])}) if skin else None
        return cls(**{**arrays, "parts": int(arrays["parts"])}, skin=made)


class NoNodeError(F4xError):
    """Edits move Gaussians as no node does; the sentence lacks its end, what to do about it."""


def mesh_of(
    scene: Scene,
    chosen: np.ndarray,
    time: float | None = None,
    config: MeshConfig | None = None,
    progress: Progress = silent,
) -> SplatMesh:
    """Return the mesh around the Gaussians `chosen (N,) bool` of `scene.posed`, as they are at clip time `time`.

    None is the time at which they are spread the widest. Raises F4xError for fewer than `MIN_GAUSSIANS` visible Gaussians, where
    nothing is opaque enough, and NoNodeError where edits move them as no node does.
    """
    config = config or MeshConfig()
    time = widest_time(scene, chosen) if time is None else time
    posed = scene.posed(time)
    rows = np.flatnonzero(chosen & (posed.opacities > 0))
    if len(rows) < MIN_GAUSSIANS:
        raise F4xError(
            f"{len(rows)} of the selected Gaussians are visible at clip time {time:g}, and a surface needs {MIN_GAUSSIANS};"
            " select more of the thing, or another time."
        )
    posed = posed.take(rows)
    progress("mesh", 0, 3, "opacity")
    vertices, faces, colors = _surface(posed, config, progress)
    carriers = _carriers(scene, rows, posed)
    skin = skin_of(vertices, faces, carriers, time) if carriers.strength.any() else None
    progress("mesh", 3, 3)
    return SplatMesh(
        vertices.astype(np.float32),
        faces.astype(np.int32),
        _vertex_normals(vertices, faces).astype(np.float32),
        np.clip(colors, 0, 1).astype(np.float32),
        skin,
        int(parts_of(len(vertices), faces).max()) + 1,
    )


def widest_time(scene: Scene, chosen: np.ndarray) -> float:
    """Return the clip time at which the chosen Gaussians fill the largest volume, where neighbours belong together.

    Times at which fewer than `MOST` of them are there do not count.
    """
    times = scene.cameras.times
    times = times[evenly_spaced(len(times), LOOKS)]
    there, volume = np.zeros(len(times)), np.zeros(len(times))
    for index, time in enumerate(times):
        posed = scene.posed(time)
        weight = posed.opacities[chosen].astype(np.float64)
        there[index] = weight.sum()
        if len(weight) and there[index]:
            volume[index] = np.linalg.det(np.cov(posed.means[chosen].T.astype(np.float64), aweights=weight, ddof=0))
    volume[there < MOST * there.max()] = -1
    return float(times[volume.argmax()])


def _carriers(scene: Scene, rows: np.ndarray, posed: PosedSplats) -> Carriers:
    """Return the nodes and weights of the Gaussians `rows` of `scene.posed`. NoNodeError where an edit moves them otherwise."""
    dynamic = scene.dynamic
    own = scene.origin[rows] - len(scene.static)
    follows = own >= 0
    node = np.zeros((len(rows), dynamic.node.shape[1]), np.int32)
    weight, strength = np.zeros(node.shape, np.float32), np.zeros(len(rows), np.float32)
    if follows.any():
        kept = own[follows]
        node[follows], weight[follows], strength[follows] = (
            dynamic.node[kept],
            dynamic.weight[kept],
            dynamic.strength[kept],
        )
    if scene.base is not scene and (led := _led_astray(scene, rows, follows)):
        raise NoNodeError(f"edits move {led:,} of the selected Gaussians as no node does")
    return Carriers(posed.means, posed.opacities, node, weight, strength)


def _led_astray(scene: Scene, rows: np.ndarray, follows: np.ndarray) -> int:
    """Count the Gaussians `rows` of an edited scene that are not where their nodes carry them, or not where they began."""
    times = scene.cameras.times
    away, first = np.zeros(len(rows), bool), scene.posed(times[0]).means[rows]
    for time in times[evenly_spaced(len(times), MOMENTS)]:
        expected = np.where(follows[:, None], Scene.posed(scene, time).means[scene.origin[rows]], first)
        away |= np.abs(scene.posed(time).means[rows] - expected).max(1) > SAME
    return int(away.sum())


def _surface(posed: PosedSplats, config: MeshConfig, progress: Progress) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return vertices (V,3) in the world, triangles (F,3), and the mean color (V,3) of the Gaussians there."""
    grid = Grid.around(posed, config.resolution)
    widened = np.maximum(NARROWEST * grid.step - posed.scales.min(1), 0)
    field, sums = opacity_field(
        posed, grid, np.concatenate([plain_color(posed), posed.means, widened[:, None]], axis=1)
    )
    progress("mesh", 1, 3, "surface")
    vertices, faces = contour(field, config.level)
    vertices, faces = largest_parts(vertices, faces, config.min_part, config.hollows)
    if not len(faces):
        raise F4xError(
            f"the selected Gaussians are nowhere more opaque than {config.level:g}; select more of them, or give a lower --level."
        )
    vertices = smoothed(vertices, faces, config.rounds)
    progress("mesh", 2, 3, f"{len(faces):,} triangles")
    vertices, faces = decimated(vertices, faces, config.faces)
    vertices = grid.origin + grid.step * vertices
    means = _means(grid, sums, vertices)
    # A thin sheet was widened for the grid: back towards its middle, but for what its two sides need to stay apart.
    normals = _vertex_normals(vertices, faces)
    outside = ((vertices - means[:, 3:6]) * normals).sum(1) - APART * grid.step
    vertices = vertices - np.clip(outside, 0, 2 * means[:, 6])[:, None] * normals
    return vertices, faces, _means(grid, sums, vertices)[:, :3]


def _means(grid: Grid, sums: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Return (P,C) means of what `opacity_field` summed, at `points (P,3)`."""
    *totals, depth = grid.sample(sums, points).T
    return np.stack(totals, axis=1) / np.maximum(depth, np.finfo(np.float32).tiny)[:, None]


def _vertex_normals(vertices: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """Return (V,3) of length 1, the mean of the triangles around by area."""
    normals = np.zeros_like(vertices)
    of_faces = normals_of(vertices, faces)
    for corner in range(3):
        np.add.at(normals, faces[:, corner], of_faces)
    return normals / np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), np.finfo(np.float32).tiny)
