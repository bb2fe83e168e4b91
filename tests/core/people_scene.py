"""A made-up scene of up to three people before a wall, a car on the right, with what a fit stores about people."""

import numpy as np
from labelled_scene import FOCAL, FRAMES, HEIGHT, VECTORS, WIDTH, field, sheet

from f4x_core.geometry.camera import CameraPath
from f4x_core.scaffold import Scaffold
from f4x_core.scene import DynamicSet, Scene, StaticSet
from f4x_core.scene.field import Vocabulary
from f4x_core.scene.people import PARTS, People, with_people

COLUMNS, DEPTH, COLOUR = (-0.3, 0.1, 0.45), 0.9, (0.8, 0.2, 0.1)
"""Where the people stand at the first frame: the first walks to the right, the second jumps, the third stands still."""
PLACES = {
    "head": (0, -0.13), "torso": (0, -0.04), "left arm": (0.05, -0.06), "right arm": (-0.05, -0.06), "left hand": (0.08, -0.02),
    "right hand": (-0.08, -0.02), "left leg": (0.025, 0.06), "right leg": (-0.025, 0.06), "left foot": (0.025, 0.13),
    "right foot": (-0.025, 0.13),
}  # fmt: skip
"""Part -> where it is beside the middle of the body; people face the camera, so their left is on its right."""


def steps(count):
    """(F,count,3) ways of the people's nodes from the first frame on."""
    way, time = np.zeros((FRAMES, count, 3)), np.arange(FRAMES)
    way[:, :1, 0] = 0.04 * time[:, None]
    way[:, 1:2, 1] = -0.1 * np.sin(np.pi * time / (FRAMES - 1))[:, None]
    return way


def people_scene(count, features=True, order=(0, 1, 2)):
    """The scene with `count` people, person `order[i] + 1` in the i-th column; `features=False` leaves the words out."""
    wall = sheet(np.linspace(-1, 1, 40), np.linspace(-0.7, 0.7, 28), 1.2, 0.03, (0.2, 0.3, 0.8))
    car = sheet(np.linspace(0.2, 0.5, 8), np.linspace(0.2, 0.3, 5), 0.8, 0.02, (0.1, 0.7, 0.2))
    static = {name: np.concatenate([wall[name], car[name]]) for name in wall}
    bodies = [
        sheet(x + dx + np.linspace(-0.015, 0.015, 3), dy + np.linspace(-0.03, 0.03, 4), DEPTH, 0.008, COLOUR)
        for x in COLUMNS[:count]
        for dx, dy in PLACES.values()
    ]
    of = len(bodies[0]["means"]) if bodies else 0
    part = np.repeat(np.tile(np.arange(1, len(PARTS) + 1), count), of)
    column = np.repeat(np.arange(count), of * len(PARTS))
    person = np.array(order)[column] + 1
    wall_size = len(wall["means"])
    many = len(static["means"])
    base = {
        "name": "people", "static": StaticSet(ids=np.arange(many), **static), "cameras": _cameras(), "fps": 24.0,
    }  # fmt: skip
    if count:
        xyz = np.array([[x, 0, DEPTH] for x in COLUMNS[:count]])[None] + steps(count)
        scaffold = Scaffold(
            times=np.arange(FRAMES, dtype=float), xyz=xyz.astype(np.float32),
            quat=np.tile(np.float32([1, 0, 0, 0]), (FRAMES, count, 1)), radius=np.full(count, 0.1, np.float32),
            certain=np.ones((FRAMES, count), bool), ids=np.arange(count), neighbours=np.arange(count)[:, None],
            edge_mask=np.ones((count, 1), bool), unit=0.1,
        )  # fmt: skip
        body = {name: np.concatenate([one[name] for one in bodies]) for name in bodies[0]}
        base["dynamic"] = DynamicSet(
            ids=many + np.arange(len(part)), reference=np.zeros(len(part), np.int32), node=column[:, None].astype(np.int32),
            weight=np.ones((len(part), 1), np.float32), strength=np.ones(len(part), np.float32), **body,
        )  # fmt: skip
        base["scaffold"] = scaffold
    else:
        base["dynamic"] = DynamicSet.empty()
        base["scaffold"] = None
    if features:
        field_of = field(many, count)
        latents = np.concatenate([np.tile(VECTORS[1], (wall_size, 1)), np.tile(VECTORS[2], (many - wall_size, 1))])
        base["features"] = _field(latents, count)
        del field_of
    scene = Scene(**base)
    if not count:
        return scene
    nobody = np.zeros(many, int)
    return with_people(
        scene,
        People(np.concatenate([nobody, person]).astype(np.uint8), np.concatenate([nobody, part]).astype(np.uint8)),
    )


def _field(latents, nodes):
    from f4x_core.features.spec import FeatureSpec
    from f4x_core.scene.field import FeatureField, FieldHead, quantise

    parts = quantise(latents.astype(np.float32), np.tile(VECTORS[0], (nodes, 1)))
    eye, zero = np.eye(8, dtype=np.float16), np.zeros(8, np.float16)
    text = FeatureSpec("text", 8, (10, 16), text_encoder="words", temperature=0.1)
    words = Vocabulary(("thing", "wall", "car", "grass"), VECTORS.astype(np.float16))
    return FeatureField(*parts, (FieldHead(text, (eye,), (zero,)),), {"words": words})


def _cameras():
    lens = np.array([[FOCAL, 0, WIDTH / 2], [0, FOCAL, HEIGHT / 2], [0, 0, 1]])
    times = np.arange(FRAMES, dtype=float)
    return CameraPath(np.tile(lens, (FRAMES, 1, 1)), np.tile(np.eye(4), (FRAMES, 1, 1)), times, WIDTH, HEIGHT)
