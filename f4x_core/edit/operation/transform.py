"""Move, turn and resize."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from ...geometry import quaternion
from ...language.refusal import Refusal
from ..change import Change, Ease, Reply, Span, Vector, check_numbers, check_scale, check_span
from ..description import (
    SCENE_AXES,
    beside_words,
    number_words,
    rounded_words,
    span_words,
    times_words,
    way_words,
    whom,
)
from ..selects import SelectKind
from ..state import Motion
from ._place import Placing, vector

if TYPE_CHECKING:
    from ..plan_lines import Seen
    from ..resolve import Settling
    from ..splat_rows import SplatRows


@dataclass(frozen=True)
class Transform(Placing):
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
    axes: Literal["world", "camera"] = "world"
    frames: Span | None = None
    """None: always in full. Else from nothing at the first to all at the last, and held after it."""
    ease: Ease = "smooth"
    """How it grows between the two; `step` jumps at the first."""
    beside: SelectKind | None = None
    each: tuple[SelectKind, ...] = ()
    """The separate things of the selection, each with a pivot of its own; none: one pivot for all. Planning finds them."""

    def __post_init__(self) -> None:
        """Validate."""
        check_scale("scale", self.scale)
        check_numbers("translate", self.translate)
        check_numbers("rotate", self.rotate)
        check_numbers("pivot", [] if isinstance(self.pivot, str) else self.pivot)
        check_span(self.frames)

    PLACES = UNCOVERS = True
    WAY = "translate"
    SEEN = "elsewhere"
    FACTORS = ("scale",)

    @property
    def lasts(self) -> bool:
        """Nodes have no sizes that change over time."""
        return self.frames is None or self.scale == 1

    def steps(self) -> tuple[Change, ...]:
        """One for each thing."""
        return tuple(replace(self, select=one, each=()) for one in self.each) or (self,)

    def rows_after(self, rows: SplatRows, chosen: np.ndarray) -> SplatRows:
        """They move where it takes its time or its pivot moves."""
        if not chosen.any():
            return rows
        self.require_world()
        shifts = self.scale == 1 and not any(self.rotate)
        still = self.frames is None and (not isinstance(self.pivot, str) or not rows.moves[chosen].any() or shifts)
        return rows if still else replace(rows, moves=rows.moves | chosen)

    def motion(self, fraction: float, pivot: Callable[[str], np.ndarray]) -> Motion:
        """A part of the way, the turn and the growth."""
        return Motion(
            quaternion.from_rotation_vector(fraction * np.deg2rad(np.asarray(self.rotate, float))),
            self.scale**fraction,
            pivot(self.pivot) if isinstance(self.pivot, str) else np.array(self.pivot),
            fraction * np.array(self.translate),
        )

    @property
    def growth(self) -> float:
        """Its scale, unless that takes its time, so that opacities stay the same at all times."""
        return self.scale if self.frames is None else 1.0

    @property
    def aspect(self) -> tuple[Any, ...]:
        """Turns about two axes are two."""
        return (Transform, self.rotate)

    def followed_by(self, later: Change) -> tuple[Change, ...]:
        """Refusal where the later one moves it back."""
        if isinstance(later, Transform) and any(later.translate):
            back = (-self.translate[0], -self.translate[1], -self.translate[2])
            if later == replace(self, translate=back):
                raise Refusal("Two of the directions are on one line; say one of them.")
        return super().followed_by(later)

    def settled(self, at: Settling) -> dict[str, Any]:
        """The turn in world axes, too, and each thing of several that turn or grow."""
        fields = super().settled(at)
        if self.beside is None:
            turn = at.axes if self.axes == "camera" else np.eye(3)
            fields["rotate"] = vector(turn @ np.array(self.rotate))
        if any(self.rotate) or self.scale != 1:
            fields["each"] = at.each()
        return fields

    def times_as_much(self, factor: float) -> Transform:
        """Distances in widths, and sizes; angles stay."""
        return replace(self, translate=self.further(factor), scale=self.scale**factor)

    def described(self) -> str:
        """Move, rotate and scale."""
        who, parts = whom(self.select), []
        if self.beside is not None:
            parts.append(f"put {who} {beside_words(self.translate)} {whom(self.beside)}")
        elif any(self.translate):
            parts.append(f"move {who} {way_words(self.translate, self.unit, self.axes)}")
        if any(self.rotate):
            parts.append(self._turn(who))
        if self.scale != 1:
            size = times_words(self.scale, "big", "bigger", "smaller") if 0.5 <= self.scale <= 2 else ""
            about = (
                {"base": "", "centroid": " about its middle"}.get(self.pivot) if isinstance(self.pivot, str) else None
            )
            about = f" about ({number_words(self.pivot)})" if about is None else about  # type: ignore[arg-type]
            parts.append((f"make {who} {size}" if size else f"scale {who} by {self.scale:g}") + about)
        parts = parts or [f"leave {who} where it is"]
        if self.frames and self.ease == "step":
            return " and ".join(parts) + f" at frame {self.frames[0]:g}"
        eased = " evenly" if self.frames and self.ease == "linear" else ""
        return " and ".join(parts) + span_words(self.frames, "to the end") + eased

    def _turn(self, who: str) -> str:
        x, y, z = self.rotate
        side = "left" if y < 0 or z < 0 else "right"
        if self.axes == "camera" and (x, y, z) == (0, 0, 180):
            return f"turn {who} upside down"
        if self.axes == "camera" and y and not x and not z:
            return f"rotate {who} by {abs(y):g} degrees to the {side}"
        if self.axes == "camera" and z and not x and not y:
            return f"tilt {who} by {abs(z):g} degrees to the {side}"
        whose = SCENE_AXES if self.axes == "world" else "the camera's axes"
        return f"rotate {who} by ({rounded_words(self.rotate)}) degrees about {whose}"

    def as_seen(self, seen: Seen) -> str:
        """Along the camera's axes."""
        x, y, z = (float(np.round(angle, 1)) for angle in seen.axes.T @ np.array(self.rotate))
        way = seen.in_widths(self.translate)
        return replace(self, translate=way, rotate=(x, y, z), unit="size", axes="camera").described()

    def in_axes(self, moved: Callable[[Vector], Vector], turned: Callable[[Vector], Vector]) -> Transform:
        """Way and turn."""
        if self.axes != "world":
            return self
        return replace(self, translate=moved(self.translate), rotate=turned(self.rotate))

    @classmethod
    def replies(cls) -> tuple[Reply, ...]:
        """In percent of the target's width along the camera's axes; with a first frame alone it is a jump."""

        def make(answer: Any, who: SelectKind, _: Any) -> Transform:
            jump = answer.first_frame >= 0 and answer.last_frame < 0
            return cls(
                who,
                (answer.right / 100, -answer.up / 100, answer.away / 100),
                (0.0, float(answer.turn_right_degrees), float(answer.roll_right_degrees)),
                answer.size / 100,
                "base" if answer.size != 100 else "centroid",
                "size",
                "camera",
                (float(answer.first_frame),) * 2 if jump else answer.span,
                "step" if jump else "smooth",
            )

        doc = "Move, turn and resize, in one go or over the span; 0, 0, 0, 0, 0, 100 is as before."
        degrees, way = range(-360, 361), range(-1000, 1001)
        turns = {"turn_right_degrees": degrees, "roll_right_degrees": degrees, "size": range(1, 10001)}
        fields = {"right": way, "up": way, "away": way, **turns}
        return (Reply(("transform",), doc, make, fields, "TransformChange"),)
