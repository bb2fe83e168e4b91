"""A made-up scene of up to three people before a wall, and a car at the right, with what a fit stores about people."""

import numpy as np
from labelled_scene import FOCAL, FRAMES, HEIGHT, LABELS, VECTORS, WIDTH, sheet

from f4x_core.features.spec import FeatureSpec
from f4x_core.geometry.camera import CameraPath
from f4x_core.scaffold import Scaffold
from f4x_core.scene import DynamicSet, Scene, StaticSet
from f4x_core.scene.field import FeatureField, FieldHead, Vocabulary, quantise
from f4x_core.scene.people import PARTS, People, with_people

COLUMNS, DEPTH = (-0.3, 0.1, 0.45), 0.9
"""Places of the people at the first frame: the first walks to the right, the second jumps, the third stands still."""
PLACES = (
    *((0, -0.13), (0, -0.04), (0.05, -0.06), (-0.05, -0.06), (0.08, -0.02), (-0.08, -0.02)),
    *((0.025, 0.06), (-0.025, 0.06), (0.025, 0.13), (-0.025, 0.13)),
)
"""Offset of each of `PARTS` from the middle of the body; people face the camera, so their left is at the right."""


def people_scene(count, features=True, order=(0, 1, 2), since=0, first_id=0, pace=0.04):
    """The scene with `count` people, person `order[i] + 1` in the i-th column; `features=False` leaves the words out.

    `since`, `first_id`: the frame of a longer clip with which it begins, and the id of its first moving Gaussian; `pace`: world
    units a frame that the first person walks.
    """
    wall = sheet(np.linspace(-1, 1, 40), np.linspace(-0.7, 0.7, 28), 1.2, 0.03, (0.2, 0.3, 0.8))
    car = sheet(np.linspace(0.2, 0.5, 8), np.linspace(0.2, 0.3, 5), 0.8, 0.02, (0.1, 0.7, 0.2))
    static = {name: np.concatenate([wall[name], car[name]]) for name in wall}
    nobody = np.zeros(len(static["means"]), int)
    lens = np.array([[FOCAL, 0, WIDTH / 2], [0, FOCAL, HEIGHT / 2], [0, 0, 1]])
    times = np.arange(FRAMES, dtype=float)
    cameras = CameraPath(np.tile(lens, (FRAMES, 1, 1)), np.tile(np.eye(4), (FRAMES, 1, 1)), times, WIDTH, HEIGHT)
    scene = {
        "name": "people", "static": StaticSet(ids=np.arange(len(nobody)), **static), "dynamic": DynamicSet.empty(),
        "scaffold": None, "cameras": cameras, "fps": 24.0,
    }  # fmt: skip
    if features:
        latents = np.repeat(VECTORS[[1, 2]], [len(wall["means"]), len(car["means"])], axis=0)
        eye, zero = np.eye(8, dtype=np.float16), np.zeros(8, np.float16)
        head = FieldHead(FeatureSpec("text", 8, (10, 16), text_encoder="words", temperature=0.1), (eye,), (zero,))
        words = Vocabulary(("thing", "wall", "car", LABELS[3]), VECTORS.astype(np.float16))
        scene["features"] = FeatureField(*quantise(latents, np.tile(VECTORS[3], (count, 1))), (head,), {"words": words})
    if not count:
        return Scene(**scene)
    time = since + times
    way = np.zeros((FRAMES, 3, 3))
    way[:, 0, 0], way[:, 1, 1] = pace * time, -0.1 * np.sin(np.pi * time / (FRAMES - 1))
    scene["scaffold"] = Scaffold(
        times=times, xyz=(np.array([[x, 0, DEPTH] for x in COLUMNS]) + way)[:, :count].astype(np.float32),
        quat=np.tile(np.float32([1, 0, 0, 0]), (FRAMES, count, 1)), radius=np.full(count, 0.1, np.float32),
        certain=np.ones((FRAMES, count), bool), ids=np.arange(count), neighbours=np.arange(count)[:, None],
        edge_mask=np.ones((count, 1), bool), unit=0.1,
    )  # fmt: skip
    grid = (np.linspace(-0.015, 0.015, 3), np.linspace(-0.03, 0.03, 4))
    places = scene["scaffold"].xyz[0, :, None] + np.array([(x, y, 0) for x, y in PLACES])
    limbs = [sheet(grid[0] + x, grid[1] + y, z, 0.008, (0.8, 0.2, 0.1)) for body in places for x, y, z in body]
    body = {name: np.concatenate([limb[name] for limb in limbs]) for name in limbs[0]}
    part = np.repeat(np.tile(np.arange(1, len(PARTS) + 1), count), 12)
    column = np.repeat(np.arange(count), 12 * len(PARTS))
    scene["dynamic"] = DynamicSet(
        ids=(first_id or len(nobody)) + np.arange(len(part)), reference=np.zeros(len(part), np.int32),
        node=column[:, None].astype(np.int32), weight=np.ones((len(part), 1), np.float32),
        strength=np.ones(len(part), np.float32), **body,
    )  # fmt: skip
    person = np.array(order)[column] + 1
    return with_people(
        Scene(**scene), People(*(np.concatenate([nobody, of]).astype(np.uint8) for of in (person, part)))
    )
