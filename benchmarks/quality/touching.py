"""Things that touch, cross and hide each other, with true labels: does one click select the thing that was meant?

A scene of the study has one Gaussian for every point of a toy world's surfaces and its true motion, so that what is measured is
the selection and not the fit. Scenes with even seeds are for choosing
constants, those with odd seeds judge them.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np

from f4x_core.geometry import quaternion, spherical_harmonics
from f4x_core.progress import Progress, silent
from f4x_core.query.pixels import coverage_image
from f4x_core.query.prompts import select_by_points
from f4x_core.query.score import overlap
from f4x_core.scaffold import Scaffold
from f4x_core.scene import DynamicSet, Scene, StaticSet
from f4x_core.scene.view import render

from ..studies.toy_worlds import Body, Motion, Rectangle, World, box, sheet, texture
from .selecting import MIN_DEPTH, depths, innermost

SCENES = ("slide", "cross", "ride", "bump", "table")
"""Two that slide along each other; three that cross and hide each other; one that rides on another; one that drives into another
and pushes it along; five that stand on a table and touch."""
SIZE, FRAMES = (160, 90), 12
"""Pixels and frames of the clips."""
CLICKED, JUDGED = (0, 6), (0, 4, 8, 11)
"""Frames that are clicked, one after the other, and those in which the selections are judged."""
MIN_PIXELS = 40
"""A thing with fewer visible pixels is not judged in a frame."""
ROUND = 0.4
"""Standard deviation of a Gaussian in distances of its surface's points: closed, and not much wider than the surface."""


CALM = 0.35
"""Strength of the toy worlds' textures here: things have a colour of their own, as most have."""


@dataclass(frozen=True, eq=False)
class Plain(Body):
    """A body with a colour of its own and a faint texture."""

    def colour(self, rest: np.ndarray, directions: np.ndarray) -> np.ndarray:
        """Return colours (n,3) of surface points given at rest (n,3); the directions of view play no role."""
        hue = np.random.default_rng(self.look).uniform(0.15, 0.85, 3)
        return np.clip(hue + CALM * (texture(rest, self.look) - 0.5), 0.02, 0.98)

    @classmethod
    def of(cls, body: Body) -> Plain:
        """Return the body with such a look."""
        return cls(body.label, body.xyz, body.triangles, body.look, body.motion)


def drive(xyz: np.ndarray, phase: float, *, shift: np.ndarray, turn: np.ndarray, pivot: np.ndarray, wait: float):
    """Return a rigid motion (n,3) from the phase `wait` on: turned about `pivot` by up to `turn`, carried by up to `shift`."""
    gone = max(0.0, phase - wait) / max(1 - wait, 1e-9)
    return quaternion.rotate(quaternion.from_rotation_vector(gone * turn), xyz - pivot) + pivot + gone * shift


def touching_world(kind: str, seed: int) -> World:
    """Return the world of a kind (of `SCENES`); the seed decides places, sizes, motions and colours."""
    random = np.random.default_rng([seed, SCENES.index(kind)])
    looks = iter(random.permutation(900) + 50)
    back = sheet("wall", Rectangle((-1.3, -0.8, 1.3), (2.6, 0, 0), (0, 1.25, 0)), int(next(looks)), spacing=0.02)
    ground = sheet("floor", Rectangle((-1.2, 0.3, 0.5), (2.4, 0, 0), (0, 0, 0.8)), int(next(looks)), spacing=0.02)
    near = random.uniform(-0.03, 0.03, 3)
    size = random.uniform(0.15, 0.24, (5, 3))

    def thing(name: str, at: tuple[float, float, float], number: int, motion: Motion | None = None) -> Body:
        return box(name, np.add(at, near), size[number], int(next(looks)), motion)

    def way(at: tuple[float, float, float], shift: tuple[float, float, float], turn: float = 0.0, wait: float = 0.0):
        spin = turn * random.uniform(-1, 1, 3)
        return partial(drive, shift=np.array(shift), turn=spin, pivot=np.add(at, near), wait=wait)

    bodies: list[Body] = []
    if kind == "slide":
        beside = (size[0, 0] + size[1, 0]) / 2
        one, two = (-beside / 2, 0.05, 0.8), (beside / 2, 0.05, 0.8)
        bodies = [thing("one", one, 0, way(one, (0.02, -0.14, 0))), thing("two", two, 1, way(two, (0.02, 0.12, 0)))]
    elif kind == "cross":
        places = [(-0.3, 0.0, 0.62), (0.32, 0.08, 0.85), (0.0, -0.05, 1.08)]
        shifts = [(0.5, 0, 0.02), (-0.6, 0.02, 0), (0.1, 0.12, 0)]
        bodies = [
            thing(name, at, i, way(at, shift, 0.4))
            for i, (name, at, shift) in enumerate(zip(("one", "two", "three"), places, shifts, strict=True))
        ]
    elif kind == "ride":
        above = (size[0, 1] + size[1, 1]) / 2
        low, high, shift = (-0.2, 0.15, 0.8), (-0.2, 0.15 - above, 0.8), (0.35, 0.02, 0.03)
        bodies = [
            thing("horse", low, 0, way(low, shift)),
            thing("rider", high, 1, way(high, shift, 0.15 * (seed // 2 % 2))),
        ]
    elif kind == "bump":
        gap = 0.2
        beside = (size[0, 0] + size[1, 0]) / 2
        one, two = (-beside - gap, 0.1, 0.8), (0.0, 0.1, 0.8)
        bodies = [
            thing("one", one, 0, way(one, (2 * gap, 0, 0))),
            thing("two", two, 1, way(two, (gap, 0, 0), wait=0.5)),
        ]
    else:
        top = 0.12
        table = box("table", np.add((0, top + 0.03, 0.85), near), (0.9, 0.06, 0.4), int(next(looks)))
        left, things = -0.42, []
        for i, name in enumerate(("cup", "book", "jar", "tin", "loaf")):
            at = (left + size[i, 0] / 2, top - size[i, 1] / 2, 0.85 + random.uniform(-0.05, 0.05))
            left += size[i, 0] + (0.03 if i == 2 else 0)
            things.append(thing(name, at, i))
        bodies = [table, *things]
    return World(f"{kind} {seed}", tuple(map(Plain.of, (back, ground, *bodies))), SIZE[0], SIZE[1], FRAMES)


def true_scene(world: World) -> tuple[Scene, np.ndarray]:
    """Return the scene that has a Gaussian at every point of the world's surfaces, and the label (N,) int of each."""
    order = sorted(range(len(world.bodies)), key=lambda i: world.bodies[i].motion is not None)
    bodies = [world.bodies[i] for i in order]
    still, movers = ([body for body in bodies if (body.motion is not None) == moves] for moves in (False, True))
    labels = np.concatenate([np.full(len(body.xyz), world.labels.index(body.label)) for body in bodies])
    count = sum(len(body.xyz) for body in still)
    static = StaticSet(ids=np.arange(count), **_splats(still))
    if not movers:
        scene = Scene(
            name=world.name, static=static, dynamic=DynamicSet.empty(), scaffold=None, cameras=world.cameras, fps=24.0
        )
        return scene, labels
    owner = np.repeat(np.arange(len(movers), dtype=np.int32), [len(body.xyz) for body in movers])
    dynamic = DynamicSet(
        ids=np.arange(count, count + len(owner)),
        reference=np.zeros(len(owner), np.int32),
        node=owner[:, None],
        weight=np.ones((len(owner), 1), np.float32),
        strength=np.ones(len(owner), np.float32),
        **_splats(movers),
    )
    return Scene(
        name=world.name, static=static, dynamic=dynamic, scaffold=_nodes(world, movers), cameras=world.cameras, fps=24.0
    ), labels


def _splats(bodies: list[Body]) -> dict[str, np.ndarray]:
    """Return round opaque Gaussians at the bodies' points, as wide as these lie apart, with the true colours."""
    xyz = np.concatenate([body.at(0.0) for body in bodies]).astype(np.float32)
    colour = np.concatenate([body.colour(body.xyz, np.zeros_like(body.xyz)) for body in bodies])
    apart = np.concatenate(
        [np.full(len(body.xyz), ROUND * np.sqrt(_area(body) / len(body.xyz))) for body in bodies]
    ).astype(np.float32)
    return {
        "means": xyz,
        "quats": np.tile(np.array([1, 0, 0, 0], np.float32), (len(xyz), 1)),
        "scales": np.repeat(apart[:, None], 3, 1),
        "opacities": np.full(len(xyz), 0.95, np.float32),
        "sh": spherical_harmonics.dc_from_rgb(colour.astype(np.float32))[:, None],
    }


def _area(body: Body) -> float:
    """Return the area of the body's triangles at rest."""
    one, two = body.triangles[:, 1] - body.triangles[:, 0], body.triangles[:, 2] - body.triangles[:, 0]
    return float(np.linalg.norm(np.cross(one, two), axis=1).sum() / 2)


def _nodes(world: World, movers: list[Body]) -> Scaffold:
    """Return one node for each mover, at its middle, moved as it is."""
    times = world.cameras.times
    axes = np.concatenate([np.zeros((1, 3)), np.eye(3)])  # a frame of points, whose motion tells the rotation
    middles = [body.xyz.mean(0) for body in movers]
    moved = np.array(
        [
            [
                body.motion(middle + axes, time / max(times[-1], 1))
                for body, middle in zip(movers, middles, strict=True)
                if body.motion
            ]
            for time in times
        ]
    )  # (T,M,4,3)
    turns = (moved[:, :, 1:] - moved[:, :, :1]).swapaxes(-1, -2)  # columns: where the axes went
    return Scaffold(
        times=times,
        xyz=moved[:, :, 0].astype(np.float32),
        quat=quaternion.from_matrix(turns).astype(np.float32),
        radius=np.full(len(movers), 0.1, np.float32),
        certain=np.ones((len(times), len(movers)), bool),
        ids=np.arange(len(movers)),
        neighbours=np.arange(len(movers))[:, None],
        edge_mask=np.ones((len(movers), 1), bool),
        unit=0.1,
    )


def things_of(world: World) -> list[str]:
    """Return the labels that are clicked."""
    return [label for label in world.labels if label not in ("wall", "floor", "table")]


def drawn_things(world: World, scene: Scene, labels: np.ndarray) -> dict[int, dict[str, np.ndarray]]:
    """Return frame -> thing -> (H,W) bool: where the Gaussians with its label, (N,) int, show most of a pixel."""
    one = np.eye(len(world.labels), dtype=np.float32)[labels]
    result = {}
    for frame in {*CLICKED, *JUDGED}:
        weights = render(scene, scene.cameras[frame], float(frame), (), values={"label": one})["label"]
        result[frame] = {name: weights[..., world.labels.index(name)] > 0.5 for name in things_of(world)}
    return result


def clicks(scene: Scene, truth: dict[int, dict[str, np.ndarray]]) -> Iterator[tuple[str, int, float]]:
    """Yield (thing, clicked frame, mean IoU over `JUDGED`) of one click at the innermost pixel of every thing."""
    for frame in CLICKED:
        for label, mask in truth[frame].items():
            if depths(mask).max() < MIN_DEPTH:
                continue
            found = select_by_points(scene, [innermost(mask)], frame)
            overlaps = []
            for time in JUDGED:
                if truth[time][label].sum() >= MIN_PIXELS:
                    drawn = coverage_image(scene, found, scene.cameras[time], float(time)) > 0.5
                    overlaps.append(overlap(drawn, truth[time][label]))
            yield label, frame, float(np.mean(overlaps))


def score_clicks(seeds: int, progress: Progress = silent) -> list[dict[str, Any]]:
    """Return a row for each kind of scene: `scene`, number of `clicks`, mean `IoU` and `worst IoU`, over so many odd seeds."""
    rows = []
    for number, kind in enumerate(SCENES):
        found = []
        for seed in range(1, 2 * seeds, 2):
            progress("touching", number * seeds + seed // 2, seeds * len(SCENES), kind)
            world = touching_world(kind, seed)
            scene, labels = true_scene(world)
            found += [value for *_, value in clicks(scene, drawn_things(world, scene, labels))]
        rows.append({"scene": kind, "clicks": len(found), "IoU": float(np.mean(found)), "worst IoU": min(found)})
    return rows
