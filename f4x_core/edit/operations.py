"""What can be done to a scene: typed operations, pure data, validated on construction.

Lengths are world units (1 = median depth of the clip), axes the world's (OpenCV: x right, y down, z forward), times clip
frames, colours sRGB in [0, 1]. A request may speak of sizes and of the camera (`unit`, `axes`); planning rewrites it into
world units and axes and its selection into ids, and only that is stored. An operation acts on the Gaussians as the
operations before it left them, *posed* at the time that is looked at, so it holds at every time.
"""

from __future__ import annotations

import base64
import binascii
from collections.abc import Iterable
from dataclasses import dataclass, replace
from typing import ClassVar, Literal, Union

import numpy as np

from ..errors import F4xError
from .records import Record, near, read_record
from .selects import All, Ids, Moving, Named, SelectKind, Where
from .styles import STYLES

Vector = tuple[float, float, float]
Span = tuple[float, float | None]
"""First and last clip frame, both included; None = to the end of the clip."""
Ease = Literal["linear", "smooth", "step"]

MAX_NUMBER = 1e6
"""World units, degrees or clip frames; nothing in a clip is farther, and float32 stays exact enough."""
MAX_SCALE = 1e3
"""A size, speed or factor beyond it, or below its inverse, is a slip of the pen."""
MIN_GAMMA = 0.1
"""Minimum gamma, and the inverse of the maximum."""
MAX_COPIES = 100
"""Copies one operation makes at most: memory grows with every one."""
SHOWN = 10.0
"""`Opacity.factor` that makes anything opaque that is there at all."""
STANDING: dict[Where, Vector] = {
    "near": (0.0, 0.0, 0.0), "left": (-1.0, 0.0, 0.0), "right": (1.0, 0.0, 0.0), "above": (0.0, -1.0, 0.0),
    "below": (0.0, 1.0, 0.0), "behind": (0.0, 0.0, 1.0), "front": (0.0, 0.0, -1.0),
}  # fmt: skip
"""Directions from one thing to another, along the camera's axes."""


class Change(Record):
    """Base of the operations. Each has a `select`."""

    KEY = "op"
    select: SelectKind


NOTHING_ALONG = Ids()
"""`ChangeWithShadow.along` of an operation that leaves the shadow as it is."""


@dataclass(frozen=True, kw_only=True)
class ChangeWithShadow(Change):
    """Base of the operations that change where, when or whether a thing is seen, so that its shadow changes with it."""

    along: SelectKind | None = None
    """What goes along: the shadow and loose edges of the selection. None: planning finds them; `NOTHING_ALONG` leaves them."""


def _check_span(frames: Span | None) -> None:
    _check_numbers("frames", [frame for frame in frames or () if frame is not None])
    if frames is not None and frames[1] is not None and frames[0] > frames[1]:
        raise F4xError(f"frames {frames[0]:g} to {frames[1]:g} end before they start.")


def _check_numbers(name: str, values: Iterable[float]) -> None:
    for value in values:
        if not abs(value) <= MAX_NUMBER:
            raise F4xError(f"{name} holds {value:g}; give numbers up to {MAX_NUMBER:g}.")


def _check_range(name: str, value: float, maximum: float = 1.0) -> None:
    if not 0 <= value <= maximum:
        raise F4xError(f"{name} is {value:g}; give a number from 0 to {maximum:g}.")


def _check_scale(name: str, value: float) -> None:
    if not 1 / MAX_SCALE <= value <= MAX_SCALE:
        raise F4xError(f"{name} is {value:g}; give a number from {1 / MAX_SCALE:g} to {MAX_SCALE:g}.")


def _check_name(name: str) -> None:
    if not name.strip() or not all(c.isalnum() or c in " -_" for c in name):
        raise F4xError(f"name is {name!r}; use letters, digits, spaces, - and _.")


@dataclass(frozen=True)
class Recolour(Change):
    """Another colour."""

    TAG = "recolour"
    select: SelectKind
    rgb: Vector
    """sRGB in [0, 1]; for `add` -1 to 1, for `multiply` 0 to 10."""
    mode: Literal["assign", "add", "multiply", "hue"] = "assign"
    """`assign` the colour; `add` it; `multiply` by it; take its `hue` and saturation and leave light and dark."""
    strength: float = 1.0
    """0 leaves the old colour, 1 is the new one."""
    keep_luminance: bool = False
    """With `assign`: shading and texture stay, brightened or darkened so that their mean is the colour's."""
    frames: Span | None = None
    """In effect from … to; None = always."""
    ease: Ease | None = None
    """As of `Opacity`: None, or how it comes between the two, to stay."""

    def __post_init__(self) -> None:
        """Validate."""
        low, high = {"add": (-1, 1), "multiply": (0, 10)}.get(self.mode, (0, 1))
        if not all(low <= value <= high for value in self.rgb):
            raise F4xError(f"rgb is {list(self.rgb)}; for {self.mode} give three numbers from {low} to {high}.")
        _check_range("strength", self.strength)
        _check_span(self.frames)


@dataclass(frozen=True)
class Opacity(ChangeWithShadow):
    """More or less transparent."""

    TAG = "opacity"
    select: SelectKind
    factor: float
    """Opacity is multiplied by it and held in [0, 1]; 0 hides."""
    frames: Span | None = None
    """In effect from … to; None = always."""
    ease: Ease | None = None
    """None: in full, from the first frame to the last alone. Else it comes between the two, as in `Transform`, and stays."""
    inward: bool = False
    """With `ease`: it is there from the start and goes between the two."""

    def __post_init__(self) -> None:
        """Validate."""
        _check_range("factor", self.factor, 10)
        _check_span(self.frames)
        if self.inward and self.ease is None:
            raise F4xError("inward needs an ease; give one, or leave inward out.")


@dataclass(frozen=True)
class Delete(ChangeWithShadow):
    """Take it out."""

    TAG = "delete"
    select: SelectKind
    frames: Span | None = None
    """Gone from … to; None = always."""

    def __post_init__(self) -> None:
        """Validate."""
        _check_span(self.frames)


@dataclass(frozen=True)
class Extract(Change):
    """Leave nothing else."""

    TAG = "extract"
    select: SelectKind
    frames: Span | None = None
    """Alone from … to; None = always."""

    def __post_init__(self) -> None:
        """Validate."""
        _check_span(self.frames)


@dataclass(frozen=True)
class Transform(ChangeWithShadow):
    """Move, turn and resize the posed Gaussians: x' = pivot + scale R (x - pivot) + translate."""

    TAG = "transform"
    select: SelectKind
    translate: Vector = (0.0, 0.0, 0.0)
    """In `unit` along `axes`."""
    rotate: Vector = (0.0, 0.0, 0.0)
    """Axis (along `axes`) times angle in degrees; right-handed about the axis."""
    scale: float = 1.0
    """Factor of distances from the pivot and of the Gaussians' sizes."""
    pivot: Literal["centroid", "base"] | Vector = "centroid"
    """`centroid` of the selection at each frame, the `base`: its lowest middle, or a point of the world."""
    unit: Literal["world", "size"] = "world"
    """`size`: in widths of the selection. Planning rewrites it into world units."""
    axes: Literal["world", "camera"] = "world"
    """`camera`: right, down, forward of the clip's camera at the first frame concerned. Planning rewrites it."""
    frames: Span | None = None
    """None: always in full. Else from nothing at the first to all at the last, and held after it."""
    ease: Ease = "smooth"
    """How it grows between the two; `step` jumps at the first."""
    beside: SelectKind | None = None
    """It goes beside this thing: `translate` is the way that it then stands from it, or nothing for the nearer side. Planning
    rewrites it."""
    each: tuple[SelectKind, ...] = ()
    """The separate things of the selection, each with a pivot of its own; none: one pivot for all. Planning finds them."""

    def __post_init__(self) -> None:
        """Validate."""
        _check_scale("scale", self.scale)
        _check_numbers("translate", self.translate)
        _check_numbers("rotate", self.rotate)
        _check_numbers("pivot", [] if isinstance(self.pivot, str) else self.pivot)
        _check_span(self.frames)


@dataclass(frozen=True)
class Duplicate(ChangeWithShadow):
    """Copies of it, elsewhere or at another time. Their ids follow `first_id` in the order of the chosen ids."""

    TAG = "duplicate"
    select: SelectKind
    offset: Vector = (0.0, 0.0, 0.0)
    """Between one copy and the next, in `unit` along `axes`."""
    time_shift: float = 0.0
    """Clip frames that a copy lags behind; negative runs ahead. Each copy by as much again."""
    count: int = 1
    """Number of copies."""
    unit: Literal["world", "size"] = "world"
    """As in `Transform`."""
    axes: Literal["world", "camera"] = "world"
    """As in `Transform`."""
    first_id: int = -1
    """First id of the copies; planning reserves it."""
    name: str = ""
    """The copies can be selected by this name afterwards."""
    beside: SelectKind | None = None
    """It goes beside this thing: `offset` is the way that it then stands from it, or nothing for the nearer side. Planning
    rewrites it."""

    def __post_init__(self) -> None:
        """Validate."""
        if not 1 <= self.count <= MAX_COPIES:
            raise F4xError(f"count is {self.count}; give 1 to {MAX_COPIES} copies.")
        if not -1 <= self.first_id < 1 << 62:
            raise F4xError(f"first_id is {self.first_id}; give a free id of the scene, or leave it out.")
        _check_numbers("offset", self.offset)
        _check_numbers("time_shift", [self.time_shift])
        if self.name:
            _check_name(self.name)


@dataclass(frozen=True)
class Freeze(ChangeWithShadow):
    """Stand still: from `at` on, or for a while, after which it goes on where it stood."""

    TAG = "freeze"
    select: SelectKind
    at: float
    """Clip frame."""
    until: float | None = None
    """Clip frame at which it goes on, late by the pause; None = never."""

    def __post_init__(self) -> None:
        """Validate."""
        _check_numbers("at or until", [self.at, self.at if self.until is None else self.until])
        if self.until is not None and self.until < self.at:
            raise F4xError(
                f"It would go on at frame {self.until:g}, before it stops, at {self.at:g}; give a later frame or none."
            )


@dataclass(frozen=True)
class Retime(ChangeWithShadow):
    """Faster or slower."""

    TAG = "retime"
    select: SelectKind
    speed: float
    """2 is twice as fast; at the end of the clip's motion it stands still."""
    frames: Span | None = None
    """Only from … to; afterwards at the old speed from where it then is. None = the whole clip."""
    ease: Literal["linear", "smooth", "soft"] | None = None
    """None: at once. Else the speed changes from the old one at the first frame to the new one at the last, and stays; soft: it
    comes and goes at both ends of the span, of which as much is shown as at once."""

    def __post_init__(self) -> None:
        """Validate."""
        _check_scale("speed", self.speed)
        _check_span(self.frames)


@dataclass(frozen=True)
class Reverse(ChangeWithShadow):
    """Backwards: at frame t what was at first + last - t."""

    TAG = "reverse"
    select: SelectKind
    frames: Span | None = None
    """Only from … to; None = the whole clip."""

    def __post_init__(self) -> None:
        """Validate."""
        _check_span(self.frames)


@dataclass(frozen=True)
class Loop(ChangeWithShadow):
    """Again and again what happens from … to, from then to the end of the clip."""

    TAG = "loop"
    select: SelectKind
    frames: Span
    """The part that is repeated."""

    def __post_init__(self) -> None:
        """Validate."""
        _check_span(self.frames)


@dataclass(frozen=True)
class Style(Change):
    """A look from a table: light and dark become a ramp of colours."""

    TAG = "style"
    select: SelectKind
    look: str
    """Name of an entry of `styles.STYLES`."""
    strength: float = 1.0
    """0 leaves the old colour, 1 is the new one."""
    frames: Span | None = None
    """In effect from … to; None = always."""
    ease: Ease | None = None
    """As of `Opacity`: None, or how it comes between the two, to stay."""

    def __post_init__(self) -> None:
        """Validate."""
        if self.look not in STYLES:
            raise F4xError(f"there is no look {self.look!r}{near(self.look, STYLES)}; known: {', '.join(STYLES)}.")
        _check_range("strength", self.strength)
        _check_span(self.frames)


@dataclass(frozen=True)
class Match(Change):
    """The colours of something else in the scene: mean and spread are carried over."""

    TAG = "match"
    select: SelectKind
    source: SelectKind
    """Whose colours."""
    strength: float = 1.0
    """0 leaves the old colour, 1 is the new one."""
    frames: Span | None = None
    """In effect from … to; None = always."""
    ease: Ease | None = None
    """As of `Opacity`: None, or how it comes between the two, to stay."""

    def __post_init__(self) -> None:
        """Validate."""
        _check_range("strength", self.strength)
        _check_span(self.frames)


@dataclass(frozen=True)
class Grade(Change):
    """Contrast, saturation and warmth, in OKLab, and gamma; 1, 1, 0, 1 is as before."""

    TAG = "grade"
    select: SelectKind
    contrast: float = 1.0
    """Factor of the distance of each light from the mean light of the selection."""
    saturation: float = 1.0
    """Factor of the distance from gray."""
    warmth: float = 0.0
    """From -1, bluish, to 1, yellowish."""
    frames: Span | None = None
    """In effect from … to; None = always."""
    ease: Ease | None = None
    """As of `Opacity`: None, or how it comes between the two, to stay."""
    gamma: float = 1.0
    """Each channel is raised to 1 / gamma after the rest: above 1 the midtones get brighter, black and white stay."""

    def __post_init__(self) -> None:
        """Validate."""
        _check_range("contrast", self.contrast, 10)
        _check_range("saturation", self.saturation, 10)
        if not MIN_GAMMA <= self.gamma <= 1 / MIN_GAMMA:
            raise F4xError(f"gamma is {self.gamma:g}; give a number from {MIN_GAMMA:g} to {1 / MIN_GAMMA:g}.")
        if not -1 <= self.warmth <= 1:
            raise F4xError(f"warmth is {self.warmth:g}; give a number from -1 to 1.")
        _check_span(self.frames)


@dataclass(frozen=True)
class Blur(Change):
    """Out of focus: every Gaussian gets wider and as much fainter."""

    TAG = "blur"
    select: SelectKind
    radius: float = 0.02
    """Standard deviation of the blur in world units."""
    frames: Span | None = None
    """In effect from … to; None = always."""

    def __post_init__(self) -> None:
        """Validate."""
        _check_range("radius", self.radius, MAX_SCALE)
        _check_span(self.frames)


@dataclass(frozen=True)
class Glow(Change):
    """Brighter, with a halo: blurred, faint copies in the same places, whose ids follow `first_id`."""

    TAG = "glow"
    select: SelectKind
    strength: float = 0.5
    """0 is none, 1 a halo as dense as the thing."""
    rgb: Vector | None = None
    """Colour of the halo, sRGB in [0, 1]; None = that of the thing."""
    radius: float = 0.04
    """Standard deviation of the halo in world units."""
    frames: Span | None = None
    """In effect from … to; None = always."""
    first_id: int = -1
    """First id of the halo; planning reserves it."""

    def __post_init__(self) -> None:
        """Validate."""
        _check_range("strength", self.strength)
        _check_range("radius", self.radius, MAX_SCALE)
        _check_span(self.frames)
        if self.rgb is not None and not all(0 <= value <= 1 for value in self.rgb):
            raise F4xError(f"rgb is {list(self.rgb)}; give three numbers from 0 to 1.")


@dataclass(frozen=True)
class Swap(Change):
    """Two things change places: each goes where the base of the other is at the frame that is looked at, with its own motion."""

    TAG = "swap"
    select: SelectKind
    other: SelectKind
    """With whom."""
    shift: Vector | None = None
    """World units that `select` goes, and `other` the other way; None = planning measures it."""
    frames: Span | None = None
    """As in `Transform`."""
    ease: Ease = "smooth"
    """As in `Transform`."""

    def __post_init__(self) -> None:
        """Validate."""
        _check_numbers("shift", self.shift or ())
        _check_span(self.frames)


@dataclass(frozen=True)
class Name(Change):
    """A name for a selection, to be used by later operations. Changes nothing that is seen."""

    TAG = "name"
    select: SelectKind
    name: str
    """Letters, digits, spaces, - and _; a later `name` of the same name replaces it."""

    def __post_init__(self) -> None:
        """Validate."""
        _check_name(self.name)


@dataclass(frozen=True)
class Rekey(Change):
    """New poses of scaffold nodes, set by an artist. Make it with `Rekey.of`.

    It changes the scene's own motion, wherever it stands in the stack: what was retimed shows it at its moments, copies too.
    Between two of its `times`, and at the other knots of the scaffold, everything stays as it was.
    """

    TAG = "rekey"
    nodes: tuple[int, ...]
    """n ids of nodes, each once."""
    times: tuple[float, ...]
    """F clip frames, increasing."""
    poses: str
    """Base64 of (F,n,7) little-endian float32: x, y, z, then the rotation wxyz."""
    select: ClassVar[SelectKind] = Moving()  # type: ignore[misc]  # whoever follows the nodes

    def __post_init__(self) -> None:
        """Validate."""
        if not self.nodes or not self.times:
            raise F4xError("it names no node or no time; give at least one of each.")
        if len(set(self.nodes)) < len(self.nodes):
            raise F4xError("a node is named twice; give each once.")
        _check_numbers("times", self.times)
        if any(a >= b for a, b in zip(self.times, self.times[1:], strict=False)):
            raise F4xError("times do not increase; give clip frames in order, each once.")
        try:
            size = len(base64.b64decode(self.poses, validate=True))
        except (binascii.Error, ValueError) as error:
            raise F4xError("poses is no base64; write the motion back anew.") from error
        if size != 28 * len(self.times) * len(self.nodes):
            raise F4xError(f"poses holds {size} bytes, not 28 for each node and time; write the motion back anew.")
        xyz, quat = self.arrays
        if not (np.isfinite(quat).all() and quat.any(-1).all()):
            raise F4xError("poses holds a rotation that is zero or not finite; write the motion back anew.")
        _check_numbers("poses", xyz.ravel())

    @classmethod
    def of(cls, nodes: np.ndarray, times: np.ndarray, xyz: np.ndarray, quat: np.ndarray) -> Rekey:
        """Poses `xyz (F,n,3)`, `quat (F,n,4)` of the nodes with ids `nodes (n,)` at clip frames `times (F,)`."""
        packed = np.concatenate([xyz, quat], axis=-1).astype("<f4")
        names = tuple(np.asarray(nodes).tolist()), tuple(np.asarray(times, float).tolist())
        return cls(*names, base64.b64encode(packed.tobytes()).decode())

    @property
    def arrays(self) -> tuple[np.ndarray, np.ndarray]:
        """(xyz (F,n,3), quat (F,n,4)) float32."""
        poses = np.frombuffer(base64.b64decode(self.poses), "<f4").reshape(len(self.times), len(self.nodes), 7)
        return poses[..., :3], poses[..., 3:]


@dataclass(frozen=True)
class TakeBack(Change):
    """An earlier edit of the stack switched off; undoing this one switches it on again."""

    TAG = "take_back"
    edit: int
    """Id of the edit."""
    words: str = ""
    """What it did, for people."""
    select: ClassVar[SelectKind] = All()  # type: ignore[misc]  # whoever that edit was for


Operation = Union[  # noqa: UP007  # read at run time
    Recolour,
    Opacity,
    Delete,
    Extract,
    Transform,
    Duplicate,
    Freeze,
    Retime,
    Reverse,
    Loop,
    Style,
    Match,
    Grade,
    Blur,
    Glow,
    Swap,
    Name,
    Rekey,
    TakeBack,
]
"""Any operation."""


HALO = "halo of what glows"
"""Name by which the steps of a glow select its halo."""
HALO_LIGHT = 1.5
"""What glows is so much brighter."""


def steps_of_operation(operation: Operation) -> tuple[Operation, ...]:
    """The simpler operations that an operation of a stack stands for, in order; most stand for themselves."""
    if isinstance(operation, Transform) and operation.each:
        return tuple(replace(operation, select=one, each=()) for one in operation.each)
    if isinstance(operation, Swap):
        if operation.shift is None:
            raise F4xError("it is not measured yet how far they go; plan the edit, which settles that.")
        x, y, z = operation.shift
        common = {"frames": operation.frames, "ease": operation.ease}
        there = Transform(operation.select, (x, y, z), **common)  # type: ignore[arg-type]  # the fields of a transform
        return there, Transform(operation.other, (-x, -y, -z), **common)  # type: ignore[arg-type]
    if isinstance(operation, Glow):
        select, strength, frames = operation.select, operation.strength, operation.frames
        light = 1 + strength * (HALO_LIGHT - 1)
        halo = Named(HALO)
        steps: list[Operation] = [
            Recolour(select, (light, light, light), "multiply", frames=frames),
            Duplicate(select, first_id=operation.first_id, name=HALO),
            Blur(halo, operation.radius, None),
            Opacity(halo, strength),
        ]
        if operation.rgb is not None:
            steps.append(Recolour(halo, operation.rgb))
        if frames is not None:  # the halo is hidden before and after it
            first, last = frames
            steps.append(Opacity(halo, 0.0, (-MAX_NUMBER, np.nextafter(first, -MAX_NUMBER))))
            if last is not None:
                steps.append(Opacity(halo, 0.0, (np.nextafter(last, MAX_NUMBER), None)))
        return tuple(steps)
    return (operation,)


def read_operation(data: object, where: str = "operation") -> Operation:
    """The operation that a JSON object describes; F4xError begins with `where`."""
    return read_record(Operation, data, where)


def rotation_of(rotate: Vector) -> np.ndarray:
    """(3,) float64 rotation vector in radians of an axis times degrees."""
    return np.deg2rad(np.asarray(rotate, float))
