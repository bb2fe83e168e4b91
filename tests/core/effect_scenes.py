"""Made-up scenes whose true objects are known by Gaussian: a street, two people whom the scene knows, and a room."""

from dataclasses import dataclass
from functools import cache

import numpy as np

from f4x_core.features.spec import FeatureSpec
from f4x_core.geometry import spherical_harmonics
from f4x_core.geometry.camera import CameraPath
from f4x_core.scaffold import Scaffold
from f4x_core.scene import DynamicSet, Scene, StaticSet
from f4x_core.scene.field import FeatureField, FieldHead, Vocabulary
from f4x_core.scene.people import PARTS, People, with_people

FRAMES, FPS, WIDTH, HEIGHT, FOCAL, FLOOR = 48, 24.0, 96, 64, 70.0, 0.4
RED, BLUE, GREEN, BROWN, GRAY = (0.6, 0.2, 0.15), (0.2, 0.3, 0.6), (0.2, 0.5, 0.25), (0.45, 0.3, 0.2), (0.5, 0.45, 0.4)


@dataclass(frozen=True)
class Thing:
    """A box of Gaussians."""

    name: str
    """A number behind the label tells one of several: "man1"."""
    centre: tuple[float, float]
    """x and z of its middle at the first frame."""
    size: tuple[float, float, float]
    """Width, height and depth."""
    colour: tuple[float, float, float]
    base: float = FLOOR
    """y of its lowest points."""
    motion: tuple[float, float] | None = None
    """World units along x and z that it moves in the clip."""
    step: float = 0.06
    """Between its Gaussians."""
    person: bool = False
    """The scene knows it as a person."""

    @property
    def label(self) -> str:
        """The word for it."""
        return "person" if self.person else self.name.rstrip("0123456789")


FLOOR_AND_WALL = (
    Thing("floor", (0, 1.9), (4.4, 0.0, 2.2), (0.4, 0.4, 0.35), step=0.1),
    Thing("wall", (0, 3.0), (4.4, 1.8, 0.0), (0.55, 0.5, 0.45), step=0.12),
)
SCENES = {
    "street": (
        *FLOOR_AND_WALL,
        Thing("ball", (0.1, 1.0), (0.12, 0.12, 0.12), (0.6, 0.4, 0.15), step=0.03),
        Thing("dog", (0.35, 1.15), (0.24, 0.14, 0.1), BROWN, motion=(-0.3, 0), step=0.04),
        Thing("man1", (-0.7, 1.3), (0.18, 0.7, 0.12), BLUE),
        Thing("car", (-0.2, 1.6), (0.5, 0.24, 0.24), RED, motion=(0.5, 0)),
        Thing("man2", (0.8, 2.0), (0.22, 0.8, 0.14), GREEN),
        Thing("tree", (-1.0, 2.3), (0.3, 1.0, 0.3), GREEN, step=0.1),
        Thing("lamp", (0.45, 2.4), (0.12, 0.8, 0.12), GRAY),
    ),
    "crowd": (
        *FLOOR_AND_WALL,
        Thing("p1", (-0.5, 1.2), (0.2, 0.7, 0.12), BLUE, motion=(0.3, 0), step=0.04, person=True),
        Thing("p2", (0.5, 2.0), (0.2, 0.7, 0.12), RED, motion=(0, 0.1), step=0.04, person=True),
        Thing("bench", (0.1, 1.55), (0.5, 0.2, 0.2), BROWN),
    ),
    "room": (
        *FLOOR_AND_WALL,
        Thing("sofa", (0, 2.2), (0.9, 0.4, 0.36), BLUE),
        Thing("lamp1", (-0.9, 2.0), (0.12, 0.9, 0.12), GRAY),
        Thing("lamp2", (0.9, 2.0), (0.12, 0.9, 0.12), GRAY),
        Thing("chair1", (-0.6, 1.2), (0.18, 0.36, 0.18), BROWN),
        Thing("chair2", (0.06, 1.2), (0.18, 0.36, 0.18), BROWN),
        Thing("chair3", (0.62, 1.2), (0.18, 0.36, 0.18), BROWN),
        Thing("table", (0.35, 1.62), (0.5, 0.24, 0.3), GRAY),
        Thing("cup1", (0.22, 1.57), (0.06, 0.08, 0.06), GREEN, base=FLOOR - 0.25, step=0.02),
        Thing("cup2", (0.48, 1.57), (0.06, 0.08, 0.06), RED, base=FLOOR - 0.25, step=0.02),
        Thing("cat", (-0.5, 1.0), (0.2, 0.12, 0.1), GRAY, motion=(0.6, 0), step=0.04),
        Thing("plant", (-0.9, 2.85), (0.3, 0.6, 0.24), GREEN),
    ),
}  # fmt: skip
WORDS = (
    *("floor", "wall", "ball", "dog", "man", "car", "tree", "lamp", "person", "bench", "sofa", "chair", "table", "cup"),
    *("cat", "plant", "elephant", "truck", "sky", "grass"),
)
ALSO = {"floor": ("ground",)}
"""Other words that mean the same thing."""


def _gaussians(thing, seed):
    """(means, colours) of a box, on a grid."""
    counts = [1 + int(np.ceil(size / thing.step - 1e-9)) for size in thing.size]
    axes = [np.linspace(-size / 2, size / 2, count) for size, count in zip(thing.size, counts, strict=True)]
    points = np.stack(np.meshgrid(*axes, indexing="ij"), -1).reshape(-1, 3)
    points += (thing.centre[0], thing.base - thing.size[1] / 2, thing.centre[1])
    noise = np.random.default_rng(seed).uniform(-0.12, 0.12, (len(points), 1))
    return points.astype(np.float32), np.clip(np.array(thing.colour) * (1 + noise), 0, 1)


def _arrays(things):
    """Arrays of a set of Gaussians, and the index of the thing that each belongs to."""
    made = [_gaussians(thing, seed) for seed, thing in enumerate(things)]
    owner = np.repeat(np.arange(len(things)), [len(points) for points, _ in made])
    steps = np.array([thing.step for thing in things], np.float32)[owner]
    count = len(owner)
    arrays = {
        "means": np.concatenate([points for points, _ in made]) if made else np.zeros((0, 3), np.float32),
        "quats": np.tile(np.float32([1, 0, 0, 0]), (count, 1)),
        "scales": np.repeat(0.5 * steps[:, None], 3, 1).astype(np.float32),
        "opacities": np.full(count, 0.9, np.float32),
        "sh": spherical_harmonics.dc_from_rgb(np.concatenate([c for _, c in made]))[:, None].astype(np.float32),
    }
    return arrays, owner


def _field(still, moving):
    """The field in which each thing says its label."""
    vocabulary = (*WORDS, *(word for words in ALSO.values() for word in words))
    rows = np.eye(len(WORDS), 32, dtype=np.float32)
    rows[WORDS.index("sky")] = 1 / np.sqrt(32)  # what is none of the words asked for is rather sky
    vectors = rows[[WORDS.index(next((w for w, also in ALSO.items() if word in also), word)) for word in vocabulary]]
    eye, zero = np.eye(32, dtype=np.float16), np.zeros(32, np.float16)
    head = FieldHead(FeatureSpec("text", 32, (10, 16), text_encoder="words", temperature=0.1), (eye,), (zero,))
    static, nodes = (
        (255 * rows[[WORDS.index(label) for label in labels]]).astype(np.uint8) for labels in (still, moving)
    )
    low, step = np.zeros(32, np.float32), np.full(32, 1 / 255, np.float32)
    words = Vocabulary(vocabulary, vectors.astype(np.float16))
    return FeatureField(static, nodes, low, step, (head,), {"words": words})


@cache
def effect_scene(name):
    """(The scene, name of each thing -> its Gaussians (N,) bool)."""
    still = [thing for thing in SCENES[name] if thing.motion is None]
    moving = [thing for thing in SCENES[name] if thing.motion is not None]
    (static, static_owner), (dynamic, owner) = _arrays(still), _arrays(moving)
    times, count = np.arange(FRAMES, dtype=float), len(moving)
    starts = np.array([(t.centre[0], t.base - t.size[1] / 2, t.centre[1]) for t in moving])
    ways = np.array([(t.motion[0], 0, t.motion[1]) for t in moving])
    scaffold = Scaffold(
        times=times, xyz=(starts + times[:, None, None] / (FRAMES - 1) * ways).astype(np.float32),
        quat=np.tile(np.float32([1, 0, 0, 0]), (FRAMES, count, 1)), radius=np.full(count, 0.1, np.float32),
        certain=np.ones((FRAMES, count), bool), ids=np.arange(count), neighbours=np.arange(count)[:, None],
        edge_mask=np.ones((count, 1), bool), unit=0.1,
    )  # fmt: skip
    lens = np.array([[FOCAL, 0, WIDTH / 2], [0, FOCAL, HEIGHT / 2], [0, 0, 1]])
    first = len(static_owner)
    scene = Scene(
        name=name, fps=FPS, scaffold=scaffold,
        cameras=CameraPath(np.tile(lens, (FRAMES, 1, 1)), np.tile(np.eye(4), (FRAMES, 1, 1)), times, WIDTH, HEIGHT),
        static=StaticSet(ids=np.arange(first), **static),
        dynamic=DynamicSet(
            ids=first + np.arange(len(owner)), reference=np.zeros(len(owner), np.int32),
            node=owner[:, None].astype(np.int32), weight=np.ones((len(owner), 1), np.float32),
            strength=np.ones(len(owner), np.float32), **dynamic,
        ),
        features=_field([still[i].label for i in static_owner], [thing.label for thing in moving]),
    )  # fmt: skip
    everything = np.concatenate([static_owner, len(still) + owner])
    things = {thing.name: everything == number for number, thing in enumerate([*still, *moving])}
    people = [thing.name for thing in moving if thing.person]
    if people:
        person, part = (np.zeros(len(everything), np.uint8) for _ in range(2))
        heights = np.concatenate([static["means"], dynamic["means"]])[:, 1]
        for number, one in enumerate(people, 1):
            person[things[one]] = number
            top = heights[things[one]].min()
            share = (heights[things[one]] - top) / (FLOOR - top)
            part[things[one]] = 1 + np.searchsorted((0.2, 0.6), share) * 1  # head, torso, an arm below
        part[part == 3] = 1 + PARTS.index("left leg")
        scene = with_people(scene, People(person, part))
    return scene, things
