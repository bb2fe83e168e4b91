"""A small scene of known shapes for pictures in the documentation: a ball rolls past a crate before a brick wall.

It is made of numbers alone, no clip and no fit: 20,000 Gaussians in the camera's axes (x right, y down, z forward), with
labels for words.
"""

import numpy as np

from f4x_core.features.spec import FeatureSpec
from f4x_core.geometry import quaternion
from f4x_core.geometry.camera import CameraPath
from f4x_core.geometry.spherical_harmonics import dc_from_rgb
from f4x_core.scaffold import Scaffold
from f4x_core.scene import DynamicSet, Scene, StaticSet
from f4x_core.scene.field import FeatureField, FieldHead, Vocabulary

FRAMES, SIZE, FOCAL = 30, (640, 360), 470.0
FLOOR, WALL, STEP = 0.35, 1.8, 0.02
"""y of the floor, z of the wall, distance of neighbouring Gaussians."""
RADIUS, START, END = 0.15, (-0.12, FLOOR - 0.15, 1.0), 0.45
"""The ball, its first centre, its last x."""
CRATE, SIDE = (-0.45, FLOOR - 0.16, 1.25), 0.32
LABELS = ("ball", "crate", "wall", "floor", "sky", "grass")
WIDTH = 8
SLOTS = 4
"""Nodes that carry a Gaussian."""


def gaussians(means: np.ndarray, normals: np.ndarray, colours: np.ndarray, step: float) -> dict[str, np.ndarray]:
    """Return opaque flat Gaussians at `means (N,3)`, across `normals (N,3)`, as wide as `step`."""
    side = np.cross(normals, np.where(np.abs(normals[:, :1]) < 0.9, np.eye(3)[0], np.eye(3)[1]))
    side /= np.linalg.norm(side, axis=1, keepdims=True)
    axes = np.stack([side, np.cross(normals, side), normals], -1)
    light = 0.65 + 0.35 * np.clip(normals @ (np.array([-0.4, -0.8, -0.5]) / np.sqrt(1.05)), 0, 1)
    return {
        "means": means.astype(np.float32),
        "quats": quaternion.from_matrix(axes).astype(np.float32),
        "scales": np.tile(step * np.array([0.6, 0.6, 0.05], np.float32), (len(means), 1)),
        "opacities": np.full(len(means), 0.97, np.float32),
        "sh": dc_from_rgb(colours * light[:, None])[:, None].astype(np.float32),
    }


def sheet(corner, across, down, normal, step, paint) -> dict[str, np.ndarray]:
    """Return a rectangle from `corner` along two vectors; `paint(a, b)` gives the colour at these distances from the corner."""
    lengths = [np.linalg.norm(across), np.linalg.norm(down)]
    a, b = (axis.ravel() for axis in np.meshgrid(*(np.arange(step / 2, length, step) for length in lengths)))
    means = np.add(corner, np.outer(a / lengths[0], across) + np.outer(b / lengths[1], down))
    return gaussians(means, np.tile(np.float64(normal), (len(a), 1)), paint(a, b), step)


def bricks(a, b):
    """Return the color of a wall of bricks in several shades, with joints."""
    row = np.floor(b / 0.12)
    at = a + 0.14 * (row % 2)
    shade = 0.75 + 0.25 * np.sin(7.1 * row + 12.7 * np.floor(at / 0.28)) ** 2
    joint = (b % 0.12 < STEP) | (at % 0.28 < STEP)
    return np.where(joint[:, None], [0.75, 0.73, 0.7], shade[:, None] * [0.66, 0.36, 0.3])


def tiles(a, b):
    """Return the color of a floor of light and dark tiles."""
    light = (np.floor(a / 0.2) + np.floor(b / 0.2)) % 2
    return np.where(light[:, None] > 0, [0.78, 0.76, 0.7], [0.35, 0.45, 0.5])


def planks(a, b):
    """Return the color of the side of a wooden crate with a frame."""
    edge = (np.minimum(a, SIDE - a) < 0.04) | (np.minimum(b, SIDE - b) < 0.04)
    gap = b % 0.08 < 0.014
    return np.where(edge[:, None], [0.55, 0.38, 0.2], np.where(gap[:, None], [0.3, 0.2, 0.1], [0.8, 0.6, 0.35]))


def stripes(directions):
    """Return the color of a ball in two colours."""
    sector = np.floor(np.arctan2(directions[:, 1], directions[:, 0]) / (np.pi / 3)) % 2
    return np.where(sector[:, None] > 0, [0.95, 0.9, 0.8], [0.9, 0.5, 0.1])


def still() -> tuple[dict[str, np.ndarray], np.ndarray]:
    """Return the static Gaussians, and the number of each one's label."""
    x, y, z = np.subtract(CRATE, SIDE / 2)
    sides = (
        ((x, y, z), (SIDE, 0, 0), (0, SIDE, 0), (0, 0, -1)),
        ((x + SIDE, y, z), (0, 0, SIDE), (0, SIDE, 0), (1, 0, 0)),
        ((x, y, z), (0, 0, SIDE), (0, SIDE, 0), (-1, 0, 0)),
        ((x, y, z), (SIDE, 0, 0), (0, 0, SIDE), (0, -1, 0)),
    )
    parts = [(1, sheet(corner, across, down, normal, 0.015, planks)) for corner, across, down, normal in sides] + [
        (2, sheet((-1.5, -0.85, WALL), (3, 0, 0), (0, FLOOR + 0.85, 0), (0, 0, -1), STEP, bricks)),
        (3, sheet((-1.5, FLOOR, 0.7), (3, 0, 0), (0, 0, WALL - 0.7), (0, -1, 0), STEP, tiles)),
    ]
    label = np.concatenate([np.full(len(part["means"]), number) for number, part in parts])
    return {name: np.concatenate([part[name] for _, part in parts]) for name in parts[0][1]}, label


def ball(count: int = 1500) -> dict[str, np.ndarray]:
    """Return the ball at frame 0, evenly covered."""
    height = 1 - (2 * np.arange(count) + 1) / count
    turn = np.pi * (1 + 5**0.5) * np.arange(count)
    around = np.sqrt(1 - height**2)
    directions = np.stack([around * np.cos(turn), around * np.sin(turn), height], -1)
    return gaussians(START + RADIUS * directions, directions, stripes(directions), RADIUS * (4 * np.pi / count) ** 0.5)


def scaffold() -> Scaffold:
    """Return eight nodes in the ball, which rolls to the right."""
    offsets = 0.5 * RADIUS * np.array([(x, y, z) for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)])
    way = np.linspace(0, END - START[0], FRAMES)
    turns = quaternion.from_rotation_vector(np.outer(way / RADIUS, [0, 0, 1.0]))
    xyz = np.add(START, np.outer(way, [1.0, 0, 0]))[:, None] + quaternion.rotate(turns[:, None], offsets)
    near = np.argsort(np.linalg.norm(offsets[:, None] - offsets, axis=-1), axis=1, kind="stable")[:, :SLOTS]
    return Scaffold(
        times=np.arange(FRAMES, dtype=float),
        xyz=xyz.astype(np.float32),
        quat=np.repeat(turns[:, None], len(offsets), 1).astype(np.float32),
        radius=np.full(len(offsets), RADIUS, np.float32),
        certain=np.ones((FRAMES, len(offsets)), bool),
        ids=np.arange(len(offsets)),
        neighbours=near,
        edge_mask=np.ones(near.shape, bool),
        unit=RADIUS,
    )


def step_scene() -> Scene:
    """Return the scene: 30 frames, the camera goes a little to the right."""
    (standing, label), rolling, carrier = still(), ball(), scaffold()
    static, dynamic = len(standing["means"]), len(rolling["means"])
    distance = np.linalg.norm(rolling["means"][:, None] - carrier.xyz[0], axis=-1)
    node = np.argsort(distance, axis=1)[:, :SLOTS]
    weight = np.exp(-((np.take_along_axis(distance, node, 1) / RADIUS) ** 2))
    poses = np.tile(np.eye(4), (FRAMES, 1, 1))
    poses[:, 0, 3] = -np.linspace(-0.06, 0.06, FRAMES)
    lens = np.array([[FOCAL, 0, SIZE[0] / 2], [0, FOCAL, SIZE[1] / 2], [0, 0, 1]])
    vectors = np.eye(len(LABELS), WIDTH, dtype=np.float32)
    vectors[0, 3] = vectors[1, 2] = 0.3  # a thing is somewhat like its surroundings, or as like any word as like them
    vectors /= np.linalg.norm(vectors, axis=1, keepdims=True)
    text = FeatureSpec("text", WIDTH, (10, 16), text_encoder="words", temperature=0.1)
    same = (np.eye(WIDTH, dtype=np.float16),), (np.zeros(WIDTH, np.float16),)
    heads = FieldHead(text, *same), FieldHead(FeatureSpec("visual", WIDTH, (20, 32)), *same)
    # not `quantise`d: eight nodes are fewer than what it takes for outliers of a channel
    latents = (255 * vectors[label]).astype(np.uint8), np.tile(255 * vectors[0], (len(carrier.ids), 1)).astype(np.uint8)
    span = np.zeros(WIDTH, np.float32), np.full(WIDTH, 1 / 255, np.float32)
    return Scene(
        name="room",
        static=StaticSet(ids=np.arange(static), **standing),
        dynamic=DynamicSet(
            ids=np.arange(static, static + dynamic),
            reference=np.zeros(dynamic, np.int32),
            node=node.astype(np.int32),
            weight=(weight / weight.sum(1, keepdims=True)).astype(np.float32),
            strength=np.ones(dynamic, np.float32),
            **rolling,
        ),
        scaffold=carrier,
        cameras=CameraPath(np.tile(lens, (FRAMES, 1, 1)), poses, np.arange(FRAMES, dtype=float), *SIZE),
        fps=24.0,
        features=FeatureField(*latents, *span, heads, {"words": Vocabulary(LABELS, vectors.astype(np.float16))}),
    )
