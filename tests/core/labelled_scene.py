"""A scene whose meaning is known: a red square that moves to the right in front of a blue wall, both with features."""

from functools import lru_cache

import numpy as np

from f4x_core.features.spec import FeatureSpec
from f4x_core.geometry import spherical_harmonics
from f4x_core.geometry.camera import CameraPath
from f4x_core.scaffold import Scaffold
from f4x_core.scene import DynamicSet, Scene, StaticSet
from f4x_core.scene.field import FeatureField, FieldHead, Vocabulary, quantise
from f4x_core.scene.view import render

FRAMES, WIDTH, HEIGHT, FOCAL = 6, 64, 40, 60.0
WALL, SQUARE, HALF, STEP = 1.2, 0.9, 0.12, 0.05
LABELS = ("square", "wall", "sky", "grass")
VECTORS = np.eye(4, 8, dtype=np.float32)


def sheet(x, y, depth, size, colour):
    """Opaque flat Gaussians on a grid at one depth."""
    points = np.stack([*np.meshgrid(x, y), np.full((len(y), len(x)), depth)], -1).reshape(-1, 3).astype(np.float32)
    count = len(points)
    return {
        "means": points,
        "quats": np.tile(np.float32([1, 0, 0, 0]), (count, 1)),
        "scales": np.tile(np.float32([size, size, 0.002]), (count, 1)),
        "opacities": np.full(count, 0.95, np.float32),
        "sh": np.tile(spherical_harmonics.dc_from_rgb(np.float32(colour)), (count, 1, 1)),
    }


def field(static, nodes):
    """Latents of width 8: the wall's static Gaussians say "wall", the nodes say "square"; the heads are identities."""
    wall, square = np.tile(VECTORS[1], (static, 1)), np.tile(VECTORS[0], (nodes, 1))
    parts = quantise(wall, square)
    eye, zero = np.eye(8, dtype=np.float16), np.zeros(8, np.float16)
    text = FeatureSpec("text", 8, (10, 16), text_encoder="words", temperature=0.1)
    heads = (FieldHead(text, (eye,), (zero,)), FieldHead(FeatureSpec("visual", 8, (20, 32)), (eye,), (zero,)))
    return FeatureField(*parts, heads, {"words": Vocabulary(LABELS, VECTORS.astype(np.float16))})


def labelled_scene(features=True, **fields):
    """The scene; `features=False` leaves the field out."""
    wall = sheet(np.linspace(-1, 1, 40), np.linspace(-0.7, 0.7, 28), WALL, 0.03, (0.2, 0.3, 0.8))
    side = np.linspace(-HALF, HALF, 9)
    square = sheet(side - 0.2, side, SQUARE, 0.018, (0.8, 0.2, 0.1))
    static, dynamic = len(wall["means"]), len(square["means"])
    corners = np.array([(x - 0.2, y, SQUARE) for x in (-HALF, HALF) for y in (-HALF, HALF)])
    times = np.arange(FRAMES, dtype=float)
    path = corners[None] + times[:, None, None] * np.array([STEP, 0, 0])
    scaffold = Scaffold(
        times=times,
        xyz=path.astype(np.float32),
        quat=np.tile(np.float32([1, 0, 0, 0]), (FRAMES, 4, 1)),
        radius=np.full(4, 0.1, np.float32),
        certain=np.ones((FRAMES, 4), bool),
        ids=np.arange(4),
        neighbours=(np.arange(4)[:, None] + np.arange(3)) % 4,
        edge_mask=np.ones((4, 3), bool),
        unit=0.1,
    )
    intrinsics = np.array([[FOCAL, 0, WIDTH / 2], [0, FOCAL, HEIGHT / 2], [0, 0, 1]])
    cameras = CameraPath(np.tile(intrinsics, (FRAMES, 1, 1)), np.tile(np.eye(4), (FRAMES, 1, 1)), times, WIDTH, HEIGHT)
    return Scene(
        **{
            "name": "labelled",
            "static": StaticSet(ids=np.arange(static), **wall),
            "dynamic": DynamicSet(
                ids=np.arange(static, static + dynamic),
                reference=np.zeros(dynamic, np.int32),
                node=np.tile(np.int32([0, 1, 2]), (dynamic, 1)),
                weight=np.full((dynamic, 3), 1 / 3, np.float32),
                strength=np.ones(dynamic, np.float32),
                **square,
            ),
            "scaffold": scaffold,
            "cameras": cameras,
            "fps": 24.0,
            "features": field(static, 4) if features else None,
        }
        | fields
    )


@lru_cache
def square_mask(time):
    """(H,W) bool: pixels that get most of their light from the square."""
    scene = labelled_scene(features=False)
    square = np.arange(len(scene.static) + len(scene.dynamic)) >= len(scene.static)
    return render(scene, scene.cameras[int(time)], time, (), values={"s": square[:, None]})["s"][..., 0] > 0.5
