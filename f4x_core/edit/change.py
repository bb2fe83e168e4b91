"""The protocol of operations: what an operation of an edit stack says of itself, with defaults for what it has nothing of.

Lengths are world units (1 = median depth of the clip), axes the world's (OpenCV: x right, y down, z forward), times clip
frames, colours sRGB in [0, 1]. A request may speak of sizes and of the camera (`unit`, `axes`); planning rewrites it into
world units and axes and its selection into ids, and only that is stored. An operation acts on the Gaussians as the
operations before it left them, *posed* at the time that is looked at, so it holds at every time.

An operation is a frozen dataclass in a file of `edit/operation`. The rooms that apply, bake, plan, describe, judge and read
operations ask it by the methods below and know none by name.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any, ClassVar, Literal

import numpy as np

from ..errors import F4xError
from .records import Record
from .selects import Ids, SelectKind, Where
from .state import Appearance, Motion, Placement

if TYPE_CHECKING:
    from ..scene import Scene
    from .apply import Looking
    from .english import Sentences
    from .plan_lines import Seen
    from .resolve import Settling
    from .splat_rows import SplatRows
    from .stack import Edit

Vector = tuple[float, float, float]
Span = tuple[float, float | None]
"""First and last clip frame, both included; None = to the end of the clip."""
Ease = Literal["linear", "smooth", "step"]
TimeMap = Callable[[float], float]
"""Clip frame shown -> clip frame read."""

MAX_NUMBER = 1e6
"""World units, degrees or clip frames; nothing in a clip is farther, and float32 stays exact enough."""
MAX_SCALE = 1e3
"""A size, speed or factor beyond it, or below its inverse, is a slip of the pen."""
SHOWN = 10.0
"""Opacity factor that stands for showing again: as opaque as fitted."""
DIRECTIONS: dict[Where, Vector] = {
    "near": (0.0, 0.0, 0.0), "left": (-1.0, 0.0, 0.0), "right": (1.0, 0.0, 0.0), "above": (0.0, -1.0, 0.0),
    "below": (0.0, 1.0, 0.0), "behind": (0.0, 0.0, 1.0), "front": (0.0, 0.0, -1.0),
}  # fmt: skip
"""Directions from one thing to another, along the camera's axes."""
KINDS: dict[str, type[Change]] = {}
"""Tag -> the class of operations that has it. A class joins when it is defined."""


@dataclass(frozen=True)
class Reply:
    """A language model's form of an operation: whole numbers, words and names of the scene."""

    op: tuple[str, ...]
    """Values of its field `op`; the first is usual."""
    doc: str
    """Description that the model reads."""
    make: Callable[[Any, SelectKind, Callable[[Any], SelectKind]], Any] | None = None
    """The operation from (the answer, its target, what makes a selection of another target); None: field by field."""
    fields: Mapping[str, Any] = field(default_factory=dict)
    """Name -> a range of whole numbers, words to choose from, `str` or "target"; None: from the fields of the operation."""
    name: str = ""
    """Name in the schema; none: that of the operation with "Reply"."""
    timed: bool = True
    """Has a first and a last frame."""


class Change(Record):
    """Base of the operations. Each has a `select`, and in most cases `frames` within which it is in effect."""

    KEY = "op"
    select: SelectKind

    ACTS: ClassVar[bool] = True
    """Alters Gaussians itself; a name does not."""
    PLACES: ClassVar[bool] = False
    """Alters where Gaussians are or how large."""
    LOOKS: ClassVar[bool] = False
    """Alters opacities or colours."""
    UNCOVERS: ClassVar[bool] = False
    """May bring to light what is behind."""
    NEEDS_WHOM: ClassVar[bool] = False
    """Is not done to everything, or to "it", where a sentence names nothing."""
    CLIP: ClassVar[bool] = False
    """May be meant for the whole clip where a sentence names nothing: "play it backwards"."""
    FACTORS: ClassVar[tuple[str, ...]] = ()
    """Fields that are factors: of two sentences that both make them larger, or smaller, the later one is right."""
    SEEN: ClassVar[Literal["in place", "elsewhere", "in the rest", "in copies", "nowhere"]] = "in place"
    """Part of the picture that changes: at the selection, there and at its new place, everywhere else, in its copies."""
    REKEYS: ClassVar[bool] = False
    """Has `nodes`, `times` and `arrays` with new poses of scaffold nodes, in place of effects on Gaussians."""
    ANSWERS: ClassVar[int] = 0
    """1: words select more afterwards, -1: less, 0: the same."""

    def __init_subclass__(cls) -> None:
        """Register the class by its tag."""
        if cls.TAG:
            KINDS[cls.TAG] = cls

    # When
    @property
    def span(self) -> Span | None:
        """Within which it is in effect, or comes; None: always."""
        return getattr(self, "frames", None)

    @property
    def moments(self) -> tuple[float | None, ...]:
        """Clip frames that it names."""
        return self.span or ()

    def fraction(self, time: float, last: float) -> float:
        """Return the completed fraction of the change at `time`, 0 to 1; `last`: the clip's last frame."""
        return progress(self.span, getattr(self, "ease", None), time, last)

    @property
    def lasts(self) -> bool:
        """Return True if arrays that are the same at all times can hold what it does."""
        return not self.LOOKS or self.span is None

    # Which rows
    def steps(self) -> tuple[Change, ...]:
        """Return the simpler operations that this one stands for, in order; most stand for themselves."""
        return (self,)

    def chosen(self, rows: SplatRows) -> np.ndarray:
        """Return the rows (N,) bool that this operation changes."""
        return rows.chosen(self.select)

    def rows_after(self, rows: SplatRows, chosen: np.ndarray) -> SplatRows:
        """Return the rows after this operation on `chosen (N,) bool`."""
        return rows

    def rows_without(self, rows: SplatRows) -> SplatRows:
        """Return the rows where this operation is switched off."""
        return rows

    def time_map(self, clip: tuple[float, float]) -> TimeMap | None:
        """Return the map from the clip frame shown to the clip frame read; None: the same. `clip`: its first and last frame."""
        return None

    def copy_time_maps(self, clip: tuple[float, float]) -> tuple[TimeMap, ...]:
        """Return the time map of each copy that this operation makes of its rows."""
        return ()

    # What becomes of them
    def placed(self, placed: Placement, fraction: float, pivot: Callable[[str], np.ndarray]) -> Placement:
        """Return the chosen Gaussians, moved `fraction` of the way; `pivot` finds the "centroid" or "base" of all of them."""
        motion = self.motion(fraction, pivot)
        return placed if motion is None else motion(placed)

    def motion(self, fraction: float, pivot: Callable[[str], np.ndarray]) -> Motion | None:
        """Return the similarity that moves the chosen Gaussians, `fraction` of the way; None where nothing moves them."""
        return None

    def untimed(self) -> Change:
        """Return this operation without delays: its copies are at the times of their originals."""
        return self

    def copy_motion(self, copy: np.ndarray) -> np.ndarray | None:
        """Return the shifts (n,3) from the original to copies of the numbers `copy (n,)`, 0 = the original; None: no shift."""
        return None

    @property
    def growth(self) -> float:
        """Factor by which it enlarges Gaussians at all times."""
        return 1.0

    def shown(self, state: Appearance, chosen: np.ndarray, fraction: float, scene: Looking) -> Appearance:
        """Return the appearance of n Gaussians, those `chosen (n,) bool` changed `fraction` of the way."""
        return state

    @property
    def has_tones(self) -> bool:
        """Return True if the colours of one Gaussian depend on those of others."""
        return False

    def tones(self, whom: Appearance, other: Appearance | None) -> Any:
        """Return statistics of the colors of all chosen Gaussians (`whom`), and of those whose colors they take (`other`)."""
        return None

    # What it comes to in an edit stack
    @property
    def removes(self) -> bool:
        """Return True if it makes something invisible."""
        return self.hides

    @property
    def hides(self) -> bool:
        """Return True if it makes something invisible that can be shown again."""
        return False

    @property
    def brings_back(self) -> bool:
        """Return True if it can make visible what was hidden."""
        return False

    @property
    def taken_back(self) -> tuple[int, ...]:
        """Ids of the earlier edits that it switches off."""
        return ()

    @property
    def left(self) -> SelectKind | None:
        """Selection of all that is left after "keep only" it; None for other operations."""
        return None

    @property
    def of_picture(self) -> bool:
        """Return True if it may be meant for everything where a sentence names nothing: "more contrast"."""
        return False

    @property
    def aspect(self) -> tuple[Any, ...]:
        """Key of the property that it sets; two operations of one sentence do not set the same."""
        return (type(self),)

    def followed_by(self, later: Change) -> tuple[Change, ...]:
        """Return this operation and the next one of the same sentence, as one or two operations."""
        if later == self:
            return (self,)
        if later.left is not None and self.removes and getattr(self.select, "of", None) == later.left:
            return (later,)
        timed = type(later) is type(self) and hasattr(self, "ease") and self.span is None and later.span is not None
        if timed and later == replace(self, frames=later.span, ease=later.ease):  # type: ignore[attr-defined,type-var,call-arg]
            return (later,)
        return self, later

    def planned(self, edits: Sequence[Edit]) -> tuple[Change, ...]:
        """Return the operations that it stands for in a scene with the edits `edits`."""
        return (self,)

    def settled(self, at: Settling) -> dict[str, Any]:
        """Return the fields, except selections, that planning derives from the scene."""
        return {}

    def times_as_much(self, factor: float) -> Change:
        """Return this operation with distances and sizes that are in widths of the thing times `factor`."""
        return self

    def remark(self, scene: Scene, rows: np.ndarray) -> str:
        """Return a sentence on an effect that a person may not expect; empty where there is none.

        `rows`: those of the scene's Gaussians that are selected.
        """
        return ""

    # How it is said
    def described(self) -> str:
        """Return one line in the words of the language: "make the dog red from frame 20 on"."""
        raise NotImplementedError

    def as_seen(self, seen: Seen) -> str:
        """Return `described` with shifts in widths and rotations as the camera sees them."""
        return self.described()

    def in_axes(self, moved: Callable[[Vector], Vector], turned: Callable[[Vector], Vector]) -> Change:
        """Return this operation with its shift and rotation mapped from the scene's axes to those of another world."""
        return self

    @classmethod
    def sentences(cls) -> Sentences:
        """Return the sentences that ask for this operation. Called when somebody types one, so it imports the language itself."""
        from .english import Sentences

        return Sentences()

    @classmethod
    def replies(cls) -> tuple[Reply, ...]:
        """Return the forms in which a language model asks for it, by default field by field."""
        return (Reply((cls.TAG,), (cls.__doc__ or "").splitlines()[0]),)


NOTHING_ALONG = Ids()
"""`ChangeWithShadow.along` of an operation that leaves the shadow as it is."""


@dataclass(frozen=True, kw_only=True)
class ChangeWithShadow(Change):
    """Base of the operations that change where, when or whether a thing is seen, so that its shadow changes with it."""

    along: SelectKind | None = None
    """The shadow and loose edges of the selection, which change with it. None: planning finds them; `NOTHING_ALONG` leaves them."""

    def settled(self, at: Settling) -> dict[str, Any]:
        """Find the shadow and loose edges, where the sentence says nothing of them."""
        return {"along": at.attached()} if self.along is None and at.takes_shadow else {}


def holds(frames: Span | None, time: float) -> bool:
    """Return True if `time` lies within `frames`, both ends included."""
    return frames is None or frames[0] <= time <= (math.inf if frames[1] is None else frames[1])


def progress(frames: Span | None, ease: Ease | None, time: float, last: float) -> float:
    """Return the completed fraction of a change at `time`, 0 to 1; a span without an end reaches to `last`, the clip's last frame.

    Without an ease it is in full within the span, and not beside it.
    """
    if frames is None:
        return 1.0
    if ease is None:
        return float(holds(frames, time))
    first, end = frames[0], max(last if frames[1] is None else frames[1], frames[0])
    if ease == "step" or first == end:
        return float(time >= first)
    fraction = min(max((time - first) / (end - first), 0.0), 1.0)
    return fraction * fraction * (3 - 2 * fraction) if ease == "smooth" else fraction


def check_span(frames: Span | None) -> None:
    """Raise F4xError for a span that ends before it starts or lies too far."""
    check_numbers("frames", [frame for frame in frames or () if frame is not None])
    if frames is not None and frames[1] is not None and frames[0] > frames[1]:
        raise F4xError(f"frames {frames[0]:g} to {frames[1]:g} end before they start.")


def check_numbers(name: str, values: Iterable[float]) -> None:
    """Raise F4xError for a number that is too large."""
    for value in values:
        if not abs(value) <= MAX_NUMBER:
            raise F4xError(f"{name} holds {value:g}; give numbers up to {MAX_NUMBER:g}.")


def check_range(name: str, value: float, maximum: float = 1.0) -> None:
    """Raise F4xError for a number below 0 or above `maximum`."""
    if not 0 <= value <= maximum:
        raise F4xError(f"{name} is {value:g}; give a number from 0 to {maximum:g}.")


def check_scale(name: str, value: float) -> None:
    """Raise F4xError for a factor that is too large or too small."""
    if not 1 / MAX_SCALE <= value <= MAX_SCALE:
        raise F4xError(f"{name} is {value:g}; give a number from {1 / MAX_SCALE:g} to {MAX_SCALE:g}.")


def check_name(name: str) -> None:
    """Raise F4xError for a name with signs."""
    if not name.strip() or not all(c.isalnum() or c in " -_" for c in name):
        raise F4xError(f"name is {name!r}; use letters, digits, spaces, - and _.")
