"""The scenes of rendered clips as data: objects, their places and motions, and camera paths.

Metres, z up. The camera starts at y = -`distance` and looks along +y at the focus, a point above the origin; extra cameras
turn about the focus. Times run over 0..1 of the clip.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from ..errors import F4xError

GRID_PATHS = {"short": 0.05, "middle": 0.15, "long": 0.4}
"""Camera path of the grid's clips, in distances to the focus."""
GRID_MOTIONS = {"slow": (0.3, 30.0), "middle": (1.2, 110.0), "fast": (2.8, 300.0)}
"""Way (metres) and turn (degrees) of the grid's moving object during the clip."""
ALL = "all"
"""Stands for every scene."""


@dataclass(frozen=True)
class CameraMove:
    """Motion of the camera, with a hand's seeded tremble."""

    kind: str = "sweep"
    """`sweep` (sideways, in a slight arc), `walk` (forward), `orbit` (around the focus), `pan` (turns on the spot, with a
    step), `recorded` (a real hand's), or of the procedural room: `hand`."""
    path: float = 0.15
    """Length in distances to the focus."""
    turn: float = 0.0
    """Degrees that a `pan` turns through."""
    distance: float = 5.0
    """Distance from the focus at the start, metres."""
    height: float = 1.6
    """Above the ground, metres."""
    tremble: float = 0.006
    """Standard deviation of the hand, metres; a third of it, in radians, turns the camera."""
    start: int = 0
    """Camera of the recording that the clip begins with."""


@dataclass(frozen=True)
class Swing:
    """A body hangs by a point above it and swings across the view, as far to the left as to the right."""

    length: float
    """Distance from the point to the body's centre, metres."""
    degrees: float
    """Largest angle to either side."""
    times: float
    """There and back during the clip."""
    lowest: float
    """Height of the body's lowest point above the ground where it hangs straight down, metres."""


@dataclass(frozen=True)
class Way:
    """Motion of a body: along a smooth curve over the ground, turning, rolling, hopping, falling or swinging."""

    stops: tuple[tuple[float, float, float], ...]
    """(time 0..1, x, y): the curve passes through them."""
    turn: float = 0.0
    """Degrees about the vertical during the clip."""
    rolls: bool = False
    """Turns as a ball of its height rolls along the curve."""
    hops: tuple[int, float] = (0, 0.0)
    """Number and height of hops, metres."""
    drop: float = 0.0
    """Height (metres) from which it falls at first; it bounces, tumbles and comes to rest on a side."""
    swing: Swing | None = None
    """True if it hangs above the curve and swings."""


@dataclass(frozen=True)
class Body:
    """A textured solid; it stands still without a way."""

    shape: str
    """`box`, `ball`, `cylinder`, `cone` or `head` (Blender's monkey)."""
    size: tuple[float, float, float]
    """Extents, metres."""
    texture: int
    """Seed of its pattern."""
    place: tuple[float, float] = (0.0, 0.0)
    """x, y where it stands; a way has its own."""
    turned: float = 0.0
    """Degrees about the vertical, at the start."""
    way: Way | None = None


@dataclass(frozen=True)
class Figure:
    """A person: a rigged model that goes its way while an action of its own is played over and over."""

    model: str
    """`cesium_man` or `knight`: the name of its file in the folder of assets."""
    action: str
    """Name of the action in the file."""
    way: Way
    height: float = 1.75
    """Height of the model at rest, metres."""
    heading: float = 0.0
    """Degrees about the vertical at the start: 0 looks towards -y, where the camera is, 90 to the right."""
    pace: float = 1.0
    """Speed of the action."""


@dataclass(frozen=True)
class RenderedScene:
    """Settings of a rendered clip."""

    name: str
    setting: str = "field"
    """`field` (ground to the horizon under a sky), `yard` (the same with a wall behind), `room` (walls, pictures and boxes),
    or the room with a figure: `procedural`, `knight`, `fox`."""
    camera: CameraMove = CameraMove()
    bodies: tuple[Body, ...] = ()
    """Moving bodies, and objects near them."""
    frames: int = 24
    size: tuple[int, int] = (240, 136)
    """Width and height of the pictures, pixels."""
    focus_height: float = 0.7
    """Height of the focus, metres."""
    aside: tuple[str, ...] = ("left", "right", "up")
    """Places of the extra cameras."""
    props: int = 9
    """Seeded boxes and posts that stand around."""
    look: int = 0
    """Seed of ground, wall and props."""
    contrast: float = 1.0
    """Contrast of all patterns but the figures' own."""
    figures: tuple[Figure, ...] = ()
    """People, of a `field` or a `yard`."""

    @property
    def models(self) -> tuple[str, ...]:
        """Names of the models that the scene shows, which must be downloaded."""
        rooms = (self.setting,) if self.setting in ("knight", "fox") else ()
        return tuple(dict.fromkeys(rooms + tuple(figure.model for figure in self.figures)))


def _box(place: tuple[float, float], size: tuple[float, float, float], texture: int, turned: float = 0.0) -> Body:
    return Body("box", size, texture, place, turned)


def _grid() -> tuple[RenderedScene, ...]:
    """Return scenes of each of 3 camera paths with each of 3 object motions; everything else is the same."""
    return tuple(
        RenderedScene(
            f"grid-{path}-{motion}",
            "yard",
            CameraMove("sweep", length),
            (
                Body(
                    "head", (1.1, 0.9, 1.0), 11, way=Way(((0, -way / 2, -0.2), (0.5, 0, 0.1), (1, way / 2, -0.2)), turn)
                ),
                _box((-1.6, 1.0), (0.7, 0.6, 1.1), 12, 20),
                Body("cylinder", (0.6, 0.6, 0.8), 13, (1.5, 0.7)),
            ),
        )
        for path, length in GRID_PATHS.items()
        for motion, (way, turn) in GRID_MOTIONS.items()
    )


_FALLING = (
    Body(
        "ball", (0.7, 0.7, 0.7), 21, way=Way(((0, -1.7, 0.5), (0.4, -0.9, 0.2), (1, 0.1, -0.2)), drop=1.2, rolls=True)
    ),
    Body("box", (0.6, 0.6, 0.6), 22, way=Way(((0, 0.9, 0.9), (0.5, 0.6, 0.8), (1, 0.5, 0.8)), drop=1.4)),
    Body("cylinder", (0.5, 0.5, 0.8), 23, way=Way(((0, 1.9, -0.3), (0.6, 1.5, -0.4), (1, 1.4, -0.4)), drop=1.2)),
    Body("ball", (0.5, 0.5, 0.5), 24, way=Way(((0, 2.3, -0.9), (1, -1.6, -1.0)), rolls=True)),
    _box((-1.9, 1.5), (0.9, 0.7, 0.8), 25, 15),
)
_CROSSING = (
    Body("head", (1.0, 0.8, 0.9), 31, way=Way(((0, -1.7, 0.5), (1, 1.7, 0.6)), turn=50)),
    Body("cylinder", (0.7, 0.7, 1.2), 32, way=Way(((0, 1.5, -0.6), (1, -1.5, -0.5)), turn=-120)),
    _box((-2.2, 1.6), (0.8, 0.8, 1.3), 33, 30),
    _box((2.3, 1.2), (0.6, 0.9, 0.7), 34, -20),
)
_RETURN = (
    Body(
        "head",
        (1.0, 0.8, 0.9),
        41,
        way=Way(((0, -0.4, 0.0), (0.45, 4.6, 0.4), (0.55, 4.6, 0.4), (1, 0.3, -0.2)), turn=90),
    ),
    _box((1.3, 1.1), (0.7, 0.7, 0.9), 42, 25),
    Body("cylinder", (0.5, 0.5, 1.3), 43, (-1.6, 0.9)),
)
_HORIZON = (
    Body(
        "box", (0.9, 0.6, 0.6), 51, way=Way(((0, -1.5, 0.6), (0.5, 0.1, -0.3), (1, 1.4, 0.3)), turn=70, hops=(3, 0.25))
    ),
    Body("cylinder", (0.4, 0.4, 1.0), 52, (-1.4, 2.4)),
)
_WALK = (
    Body("ball", (0.7, 0.7, 0.7), 61, way=Way(((0, -1.2, -0.8), (1, 1.0, 1.6)), rolls=True)),
    _box((-1.5, 2.6), (0.8, 0.8, 1.4), 62, 10),
    _box((1.7, 4.0), (1.0, 0.7, 1.1), 63, -25),
    Body("cylinder", (0.5, 0.5, 1.8), 64, (-2.2, 6.0)),
)
_ORBIT = (
    Body("head", (1.2, 1.0, 1.1), 71, way=Way(((0, -0.5, 0), (0.5, 0, 0.2), (1, 0.5, 0)), turn=60, hops=(2, 0.2))),
    _box((-1.5, 0.9), (0.7, 0.7, 1.0), 72, 40),
    Body("cylinder", (0.6, 0.6, 0.7), 73, (1.4, 0.8)),
    Body("cone", (0.9, 0.9, 1.3), 74, (0.2, 1.9)),
)
_PAN = (
    Body("box", (0.6, 0.6, 0.9), 81, way=Way(((0, -1.8, 0.6), (1, 1.9, 1.0)), turn=-80)),
    _box((-2.9, 1.6), (0.9, 0.7, 1.1), 82, 15),
    Body("cylinder", (0.6, 0.6, 1.5), 83, (2.7, 1.9)),
    Body("cone", (0.8, 0.8, 1.2), 84, (0.6, 2.8)),
)

SCENES = {
    scene.name: scene
    for scene in (
        *(
            RenderedScene(
                name, name, CameraMove(kind, distance=4.6), focus_height=0.75, aside=("left", "right"), props=0
            )
            for name, kind in (("procedural", "hand"), ("knight", "recorded"), ("fox", "recorded"))
        ),
        RenderedScene("falling", "yard", CameraMove("sweep", 0.15), _FALLING, 36, look=2),
        *_grid(),
        RenderedScene("pan-step", "field", CameraMove("pan", 0.06, turn=50), _PAN, 30, props=14, look=8),
        RenderedScene("walk", "field", CameraMove("walk", 0.3, distance=6.0), _WALK, props=14, look=6),
        RenderedScene("orbit", "yard", CameraMove("orbit", 0.6, height=2.6), _ORBIT, aside=("up", "down"), look=7),
        RenderedScene("crossing", "field", CameraMove("sweep", 0.12), _CROSSING, look=3),
        RenderedScene("return", "field", CameraMove("sweep", 0.15), _RETURN, 30, look=4),
        RenderedScene("horizon", "field", CameraMove("sweep", 0.1), _HORIZON, props=5, look=5),
    )
}
"""By name. `benchmarks.halves.RENDERED` says which of them constants are chosen on."""


def _people(
    name: str, camera: CameraMove, figures: tuple[Figure, ...], bodies: tuple[Body, ...] = (), **rest: Any
) -> RenderedScene:
    """Return a clip of people, at the size of real ones; before stronger patterns the networks take the wall for somebody."""
    return RenderedScene(
        name, "yard", camera, bodies, figures=figures, size=(480, 270), focus_height=0.9, contrast=0.25, **rest
    )


PEOPLE = {
    scene.name: scene
    for scene in (
        _people(
            "people-walk",
            CameraMove("recorded", 0.2, distance=5.5, height=1.5, start=24),
            (Figure("cesium_man", "Anim_0", Way(((0, -0.9, 0.1), (1, 0.8, -0.2))), heading=80, pace=1.7),),
            (_box((-1.9, 1.2), (0.7, 0.6, 1.0), 201, 20), _box((1.9, 0.9), (0.5, 0.8, 0.6), 202, -15)),
            frames=36,
            look=21,
        ),
        _people(
            "people-cross",
            CameraMove("recorded", 0.15, distance=11.0, height=1.6, start=60),
            (
                Figure("cesium_man", "Anim_0", Way(((0, -1.3, 0.4), (1, 1.3, 0.5))), heading=90, pace=1.8),
                Figure("knight", "Walking_A", Way(((0, 1.2, -0.5), (1, -1.2, -0.4))), 1.6, heading=-90, pace=1.9),
            ),
            (_box((-2.6, -2.0), (0.8, 0.8, 0.7), 211, 30), Body("cylinder", (0.6, 0.6, 1.3), 212, (2.8, 1.0))),
            frames=48,
            look=22,
        ),
        _people(
            "people-turn",
            CameraMove("recorded", 0.2, distance=3.7, height=1.4, start=100),
            (Figure("cesium_man", "Anim_0", Way(((0, -0.2, 0.0), (1, 0.2, 0.1)), turn=160), heading=-60),),
            (Body("cone", (0.9, 0.9, 1.3), 221, (1.8, 1.6)),),
            frames=30,
            look=23,
        ),
        _people(
            "people-jump",
            CameraMove("recorded", 0.2, distance=5.5, height=1.5, start=0),
            (Figure("knight", "Jump_Full_Short", Way(((0, -0.4, 0.0), (1, 0.4, -0.1))), 1.7, heading=50),),
            (_box((-1.7, 1.0), (0.8, 0.7, 1.1), 231, 25),),
            frames=32,
            look=24,
        ),
        _people(
            "people-hidden",
            CameraMove("recorded", 0.2, distance=3.7, height=1.5, start=48),
            (Figure("cesium_man", "Anim_0", Way(((0, -0.8, 0.3), (1, 0.7, -0.1))), heading=65, pace=1.6),),
            (_box((0.15, -0.75), (0.9, 0.3, 0.8), 241, 8), Body("cylinder", (0.5, 0.5, 1.2), 242, (-1.8, 1.4))),
            frames=36,
            look=25,
        ),
        _people(
            "people-far",
            CameraMove("recorded", 0.1, distance=22.0, height=1.7, start=168),
            (
                Figure("cesium_man", "Anim_0", Way(((0, -1.4, -0.3), (1, 0.6, 0.2))), heading=100, pace=1.7),
                Figure("knight", "Cheer", Way(((0, 1.6, 0.4),)), heading=-20),
            ),
            (_box((-3.0, -6.0), (1.0, 0.8, 0.9), 251, 35), _box((3.4, -9.0), (0.7, 0.7, 1.0), 252, 10)),
            frames=36,
            look=26,
        ),
    )
}
"""By name: people at 1/8 to 3/4 of the picture's height. `benchmarks.halves.PEOPLE` parts them."""

EXAMPLES = {
    scene.name: scene
    for scene in (
        RenderedScene(
            "driving",
            "yard",
            CameraMove("sweep", 0.3),
            (
                Body(
                    "box",
                    (1.2, 0.7, 0.7),
                    101,
                    turned=12,
                    way=Way(((0, -1.5, -0.7), (0.5, 0.1, -0.2), (1, 1.3, 0.6)), turn=28),
                ),
                _box((-1.9, 1.6), (0.9, 0.7, 1.1), 102, 25),
                Body("cone", (0.9, 0.9, 1.3), 103, (1.8, 1.5)),
            ),
            look=11,
        ),
        RenderedScene(
            "meeting",
            "yard",
            CameraMove("sweep", 0.3),
            (
                Body("head", (1.0, 0.8, 0.9), 111, way=Way(((0, -1.6, 0.6), (1, 1.5, 0.7)), turn=60)),
                Body("cylinder", (0.6, 0.6, 1.0), 112, way=Way(((0, 1.3, -0.5), (1, -1.3, -0.4)), turn=-100)),
                _box((-2.1, 1.7), (0.8, 0.8, 1.2), 113, 30),
            ),
            look=12,
        ),
        RenderedScene(
            "swinging",
            "room",
            CameraMove("sweep", 0.3, distance=4.6, height=1.45),
            (Body("cylinder", (0.5, 0.5, 2.2), 121, way=Way(((0, 0.1, 0.0),), swing=Swing(1.15, 18, 1.25, 0.35))),),
            focus_height=0.85,
            aside=("left", "right"),
            props=0,
        ),
    )
}
"""By name: what `python3 scripts/dev.py examples` gives away. Nothing is chosen on them or judged by them."""


def scenes_named(names: Sequence[str]) -> list[RenderedScene]:
    """Return the scenes that `names` names, each once; `ALL` stands for every one of `SCENES`. F4xError for an unknown name."""
    known = SCENES | PEOPLE | EXAMPLES
    wanted = dict.fromkeys(SCENES if ALL in names else names)
    for name in wanted:
        if name not in known:
            raise F4xError(f"--scene {name}: no such scene; there are {ALL}, {', '.join(known)}.")
    return [known[name] for name in wanted]
