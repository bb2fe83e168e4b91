"""Scenes with planted floaters: surfaces and foliage of several kinds, and specks, clumps, haze and far bits in the air."""

import numpy as np

from f4x_core.geometry.camera import CameraPath
from f4x_core.scene import Scene, StaticSet

KINDS = ("room", "street", "statue", "meadow", "shelf", "cave")
HELD_OUT = ("meadow", "shelf", "cave")
"""Kinds on which nothing was tuned."""


def _sheet(random, origin, along, up, count, grain=1.0):
    """Surfels of a parallelogram: (means, scales) that overlap as those of a fit do."""
    a, b = random.random((2, count))
    means = np.asarray(origin) + a[:, None] * np.asarray(along) + b[:, None] * np.asarray(up)
    spacing = np.sqrt(np.linalg.norm(np.cross(along, up)) / count)
    normal = np.cross(along, up) / np.linalg.norm(np.cross(along, up))
    means = means + 0.2 * spacing * random.normal(size=(count, 1)) * normal
    return means, grain * spacing * random.lognormal(-0.3, 0.4, (count, 1)) * [1, 1, 0.2]


def _ball(random, centre, radius, count, solid=False):
    """Surfels of a sphere, or with `solid` a cloud of leaves."""
    way = random.normal(size=(count, 3))
    way /= np.linalg.norm(way, axis=1, keepdims=True)
    reach = radius * (random.random((count, 1)) ** (1 / 3) if solid else 1.0)
    spacing = (4 * radius**3 / count) ** (1 / 3) if solid else np.sqrt(12 * radius**2 / count)
    return np.asarray(centre) + way * reach, 0.8 * spacing * random.lognormal(-0.3, 0.4, (count, 3))


def _parts(kind, random):
    """Parts of the scene; it is about 2 units wide, seen along z from the origin, y down."""
    floor = _sheet(random, (-2, 1, 0), (4, 0, 0), (0, 0, 6), 3000)
    back = _sheet(random, (-2, -1, 6), (4, 0, 0), (0, 2, 0), 1500)
    if kind == "room":
        table = _sheet(random, (-0.7, 0.3, 2), (1, 0, 0), (0, 0, 0.8), 1200)
        return [floor, back, table, _ball(random, (0.5, 0.5, 3), 0.4, 1500)]
    if kind == "street":
        far = _sheet(random, (-30, -15, 40), (60, 0, 0), (0, 20, 0), 600)
        wall = _sheet(random, (-2, -1, 1), (0, 0, 20), (0, 2, 0), 2500)
        return [floor, far, wall, _ball(random, (1, -0.2, 4), 0.5, 1500, solid=True)]
    if kind == "statue":
        return [_ball(random, (0, 0, 3), 0.7, 4000), _ball(random, (0, -0.9, 3), 0.3, 2000), floor]
    if kind == "meadow":
        tufts = [
            _ball(random, (random.uniform(-2, 2), 0.9, random.uniform(1, 6)), 0.1, 60, solid=True) for _ in range(40)
        ]
        sky = _ball(random, (0, 0, 0), 50, 800)
        return [floor, sky, *tufts]
    if kind == "shelf":
        boards = [_sheet(random, (-1, y, 2), (2, 0, 0), (0, 0, 0.5), 700) for y in (-0.8, -0.2, 0.4)]
        books = [_ball(random, (x, 0.2, 2.2), 0.12, 300) for x in np.linspace(-0.8, 0.8, 6)]
        return [*boards, *books, _sheet(random, (-1, -1, 2.5), (2, 0, 0), (0, 2, 0), 500, grain=1.3)]
    rock = _ball(random, (0, 0, 3), 3, 3000)
    crumbs = _ball(random, (0, 0.8, 3), 0.5, 4000, solid=True)
    return [rock, crumbs, _ball(random, (0.6, 0, 4), 0.3, 500)]


def planted(kind, seed, fraction=0.03, frames=1):
    """(scene, floaters (N,) bool, kind of floater (N,) int: 0 none, 1 speck, 2 clump, 3 haze, 4 far)."""
    random = np.random.default_rng([seed, KINDS.index(kind)])
    parts = _parts(kind, random)
    means, scales = (np.concatenate([part[i] for part in parts]) for i in range(2))
    opacities = random.uniform(0.35, 1, len(means))
    count = int(fraction * len(means))
    number = {1: count // 2, 2: count // 6, 3: count // 6, 4: count // 6}
    typical = np.median(scales.max(1))
    size = {
        1: lambda n: typical * random.lognormal(-0.3, 0.7, (n, 3)),
        2: lambda n: typical * random.lognormal(-0.3, 0.5, (n, 3)),
        3: lambda n: random.uniform(0.15, 0.5, (n, 1)) * random.uniform(0.6, 1, (n, 3)),
        4: lambda n: typical * random.lognormal(0.5, 0.7, (n, 3)),
    }
    added, label = [(means, scales, opacities)], [np.zeros(len(means), int)]
    for what, n in number.items():
        places = random.uniform((-1.6, -0.8, 0.6), (1.6, 0.8, 5), (n, 3))
        if what == 2:  # two or three together
            places = np.repeat(places[: -(-n // 2)], 2, axis=0)[:n] + 0.5 * typical * random.normal(size=(n, 3))
        if what == 4:
            places = random.normal(size=(n, 3)) * 25 + (0, 0, 3)
        opacity = random.uniform(0.02, 0.12, n) if what == 3 else random.uniform(0.15, 1, n)
        added.append((places, size[what](n), opacity))
        label.append(np.full(n, what))
    means, scales, opacities = (np.concatenate(values) for values in zip(*added, strict=True))
    label, order = np.concatenate(label), random.permutation(len(means))
    quats = random.normal(size=(len(means), 4))
    quats[: len(parts[0][0])] = (1, 0, 0, 0)
    static = StaticSet(
        ids=np.arange(len(means)),
        means=means[order].astype(np.float32),
        quats=quats[order].astype(np.float32),
        scales=scales[order].astype(np.float32),
        opacities=opacities[order].astype(np.float32),
        sh=random.normal(0, 0.3, (len(means), 1, 3)).astype(np.float32),
    )
    pinhole = np.array([[60.0, 0, 32], [0, 60, 20], [0, 0, 1]])
    matrices = np.tile(np.eye(4), (frames, 1, 1))
    matrices[:, 0, 3] = np.linspace(-0.2, 0.2, frames)
    cameras = CameraPath(np.tile(pinhole, (frames, 1, 1)), matrices, np.arange(float(frames)), 64, 40)
    return Scene(name=kind, static=static, cameras=cameras), label[order] > 0, label[order]
