"""Move, turn and resize."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from ...geometry import quaternion
from ...language.degrees import DEGREES, Amount, Distance, Steps, Unit, displacement
from ...language.lexicon import PLACES, word_set
from ...language.refusal import Mismatch, Refusal
from ..change import DIRECTIONS, Change, Ease, Reply, Span, Vector, check_numbers, check_scale, check_span
from ..description import (
    SCENE_AXES,
    beside_words,
    number_words,
    rounded_words,
    span_words,
    times_words,
    way_words,
    whom,
    whom_with,
)
from ..selects import Named, SelectKind
from ..state import Motion
from ..values import Value, graded
from ._place import DOWN, LEFT, RIGHT, UP, Placing, vector

if TYPE_CHECKING:
    from ...language.grammar import Reading
    from ..english import Command, Sentences
    from ..phrases import Place, SentenceContext, When
    from ..plan_lines import Seen
    from ..resolve import Settling
    from ..splat_rows import SplatRows

TILT = 30.0
"""Degrees, where a sentence names none."""
UPSIDE_DOWN = (0.0, 0.0, 180.0)
"""Degrees about the camera's axes."""
BACK, FORTH = (((None, way, None),) for way in ((0, 0, 1), (0, 0, -1)))
TOO_FAR: dict[str, tuple[Steps, Steps]] = {
    "[far|much] left|far to the left|left": (RIGHT, LEFT),
    "[far|much] right|far to the right|right": (LEFT, RIGHT),
    "high|high up|far up": (DOWN, UP),
    "low|far down": (UP, DOWN),
    "close|near|close to the camera": (BACK, FORTH),
    "far away|far back|far off|distant": (FORTH, BACK),
}
"""Place -> the ways to move where a thing is too far there, and where it is not far enough."""
MERELY = word_set("make render let put set keep have play be get do show pass moved put")
"""Verbs of playing behind which a way is a way."""
DRIVEN = word_set("drive drives driving run runs running walk walks walking ride swim fly dance dances dancing play")
_BEFORE_WAY = 4
"""Words within which a verb stands before its way: "drive the red car backward"."""


def is_lift(way: Vector, axes: np.ndarray) -> bool:
    """Return True if a way goes up or down more than aside, so that a shadow stays; `axes (3,3)` the camera's, as columns."""
    right, down, forward = np.abs(axes.T @ np.array(way))
    return bool(down > max(right, forward))


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
    unit: Unit = "world"
    axes: Literal["world", "camera"] = "world"
    frames: Span | None = None
    """None: always in full. Else from nothing at the first to all at the last, and held after it."""
    ease: Ease = "smooth"
    """Its growth between the two; `step` jumps at the first."""
    beside: SelectKind | None = None
    each: tuple[SelectKind, ...] = ()
    """The separate things of the selection, each with a pivot of its own; none: one pivot for all. Planning finds them."""

    def __post_init__(self) -> None:
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
        return self.frames is None or self.scale == 1

    def steps(self) -> tuple[Change, ...]:
        return tuple(replace(self, select=one, each=()) for one in self.each) or (self,)

    def rows_after(self, rows: SplatRows, chosen: np.ndarray) -> SplatRows:
        """Return the rows, the chosen ones as moving where the transform is gradual or its pivot moves."""
        if not chosen.any():
            return rows
        self.require_world()
        shifts = self.scale == 1 and not any(self.rotate)
        still = self.frames is None and (not isinstance(self.pivot, str) or not rows.moves[chosen].any() or shifts)
        return rows if still else replace(rows, moves=rows.moves | chosen)

    def motion(self, fraction: float, pivot: Callable[[str], np.ndarray]) -> Motion:
        """Return `fraction` of the shift, the rotation and the growth."""
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
        return (Transform, self.rotate)

    def followed_by(self, later: Change) -> tuple[Change, ...]:
        if isinstance(later, Transform) and any(later.translate):
            back = (-self.translate[0], -self.translate[1], -self.translate[2])
            if later == replace(self, translate=back):
                raise Refusal("Two of the directions are on one line; say one of them.")
        return super().followed_by(later)

    def settled(self, at: Settling) -> dict[str, Any]:
        """Return the rotation in world axes, too, and the separate things of a selection that turns or grows."""
        fields = super().settled(at)
        if self.beside is None:
            turn = at.axes if self.axes == "camera" else np.eye(3)
            fields["rotate"] = vector(turn @ np.array(self.rotate))
        if "along" in fields and is_lift(fields["translate"], at.axes):
            fields["along"] = at.attached(lifted=True)
        if any(self.rotate) or self.scale != 1:
            fields["each"] = at.each()
            if fields["each"] and "along" in fields:  # each has a pivot of its own, so its shadow turns about the same
                fields |= {"along": None, "each": tuple(at.with_attached(one) for one in fields["each"])}
        return fields

    def times_as_much(self, factor: float) -> Transform:
        """Return the transform with shifts in widths and sizes `factor` times as large; angles stay."""
        return replace(self, translate=self.further(factor), scale=self.scale**factor)

    def described(self) -> str:
        who, parts = whom_with(self), []
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
        x, y, z = (float(np.round(angle, 1)) for angle in seen.axes.T @ np.array(self.rotate))
        way = seen.in_widths(self.translate)
        return replace(self, translate=way, rotate=(x, y, z), unit="size", axes="camera").described()

    def in_axes(self, moved: Callable[[Vector], Vector], turned: Callable[[Vector], Vector]) -> Transform:
        if self.axes != "world":
            return self
        return replace(self, translate=moved(self.translate), rotate=turned(self.rotate))

    @classmethod
    def replies(cls) -> tuple[Reply, ...]:
        """Return the reply for shifts in percent of the target's width along the camera's axes; a first frame alone is a jump."""

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

    @classmethod
    def sentences(cls) -> Sentences:
        from .. import english as say

        quality = say.Quality(
            graded(scaled, gone=False), "bigger|larger|huger", "smaller|tinier", much="big|large|huge|tall|high|wide",
            little="small|tiny|little|short", noun="size|scale|dimensions", up="enlarge", down="shrink", sets="scale", too="long",
        )  # fmt: skip
        times = say.command(
            "make the dog 2x",
            scaled,
            "verb by",
            verb="{=make/get/want/need/blow}",
            by="(to|up to) [<number> x|x <number>]",
        )
        bare = say.command(
            "the dog +25 %", scaled, "by",
            by=say.phrase("+ <percent>") >> (lambda x: 1 + x)
            | say.phrase("- <percent>") >> (lambda x: 1 - x)
            | say.phrase("<number> x|x <number>") >> _no_count,
        )  # fmt: skip
        not_little = say.here(
            lambda reading, at: (
                reading.words[at - 1 : at + 1] != ["a", "little"] and reading.word(at - 1) not in ("as", "so")
            )
        )
        sizes = {
            "tiny|small|little|minute|miniature|teeny tiny|teeny weeny|teeny|itty bitty|tiny weeny": 0.5,
            "huge|giant|enormous|gigantic|big|large|massive": 2.0,
        }
        over = say.keyword("upside down|head over heels") | say.literal(
            "[on|onto] (to) (the|its|his|her|their) [head|roof|back]|belly up"
        )
        made = (
            ~say.keyword("very|really|quite") + not_little + say.table(sizes) >> scaled,
            over >> (lambda: turned(UPSIDE_DOWN)),
            say.literal("[on|onto] (to) (the|its|his|her|their) side") >> (lambda: tilted(90.0)),
        )
        alone = say.phrase(
            "(at|to) [<percent>|<multiple>] [of what it [is|was] (now|before)|of [it|itself]|as it [is|was] (now)]"
        )
        too = {words: (moved(back), moved(away)) for words, (back, away) in TOO_FAR.items()}
        return say.Sentences((*_turning(), *_moving(), times, bare), (quality,), made, (alone >> scaled,), {}, too)


def _turning() -> tuple[Command, ...]:
    from .. import english as say

    axis = say.literal(
        "[around|about|on|along|in] (its|his|her|their|the) (own) ([vertical|z|yaw|up]) axis|[around|about|on|along|in] (the) "
        "[vertical|z|yaw]|in [place|z|yaw]|on the spot"
    )
    faced = {
        "[to|and] face [left|the left]|facing left|so (that) [it|he|she] [faces|looks] left": -1,
        "[to|and] face [right|the right]|facing right|so (that) [it|he|she] [faces|looks] right": 1,
    }
    kinds = {
        say.any_form("rotate", "turn") + "|rotation|a [turn|rotation|spin|twist]": rotated,
        say.any_form("tilt") + "|(a) (slight|little|small|gentle|tiny) [tilt|lean]": tilted,
    }
    sense, verb = say.SENSE | say.table(faced, reserve=False), say.table(kinds, reserve=False)
    facing = verb | say.constant(rotated) + say.phrase("{face}")
    plan = say.literal("around|(as) seen [from [above|the top]|in plan]|in plan (view)|from above")
    around = say.phrase(
        "(to face|facing|and face|to look|looking) [[around|round] (so (that) [it|he|she] [faces|looks|"
        "points] the [other|opposite] [way|direction|side])|(to|in|into) the [other|opposite] [way|direction|"
        "side]|the other way around|so (that) [it|he|she] [faces|looks|points] the other way|backward|about|"
        "away|away from us|away from the camera|[its|his|her|their] back (to|toward|on) (us|me|the camera|the "
        "viewer)]"
    )
    return (
        say.command("rotate the dog", say.always(spun), "verb", verb="{rotate}"),
        say.command(
            "turn the dog by 20 degrees", _turned, "verb angle", verb=verb, angle=say.ANGLE, sense=sense,
            around=(plan | axis) >> (lambda: True),
        ),
        say.command("turn the dog around", _turned, "verb around", verb=facing, around=around >> (lambda: True)),
        say.command("turn the dog to the left", _turned, "verb sense", verb=facing, sense=sense, how=say.degree),
    )  # fmt: skip


def _moving() -> tuple[Command, ...]:
    from .. import english as say

    stated = say.word_set("sits stands hangs lies lives rests is stays")  # "it sits on top of the plate" is no wish
    moving = say.literal(
        "|".join(form for form in say.any_form("move").split("|") if form not in stated)
        + "|(a) (little|small|slight|gentle|tiny|bit of a) [push|nudge|shove|shift|move|tug|pull|slide|bump|lift|hop]"
    )
    ground = say.literal(
        "([to|from] [the|its] [left|right] (hand) (side)) of where [it|he|she] [is|was|stands] (now)|from [the|its] [left|"
        "right] (hand) (side)|above (the) ground|in [z|depth]|along z|(all the way) (down) [to|onto|until|toward] (it "
        "[touches|reaches|hits]) [the|its] [ground|floor|bottom]|[in|into] the [water|ground|grass|sand|snow]|[off|from|"
        "out of|above] [the|its] [ground|floor|water|place|spot]|[into|in] the [air|sky]|a step|[from|off] where [it|he|"
        "she] is (now)|from its [place|spot|position]|along the [ground|floor]|on the [ground|floor]|away from its place"
    )
    far = say.phrase("(by|for|about|some) <distance> !,")
    running = frozenset(say.any_form("run").split("|")) - MERELY
    goers = {"backward": running, "back": ("come", "comes"), "away": ("go", "goes", "going")}

    def is_moved(reading: Reading, at: int) -> bool:
        """Return True if it is no motion of its own: what is driven backward is played in reverse, and what comes back is shown."""
        driven = DRIVEN & {*reading.words[max(at - _BEFORE_WAY, 0) : at]}
        own = reading.word(at - 1) in goers.get(reading.word(at), ())
        return not own and not (reading.word(at) == "backward" and driven)

    raised = {
        say.asked_form("raise") + "|rises|floats|(a) (little|small|slight|gentle|tiny) lift": True,
        say.any_form("lower"): False,
    }
    return (
        say.command(
            "move the dog to the left", moved, "way", who="(for|of|with|on) <thing>", verb=moving,
            way=say.here(is_moved) + say.steps, far=far, more="more|further|farther|still|even|over|out", ground=ground,
        ),
        say.command(
            "the dog leaves the picture to the right", lambda way: moved(way, Distance(1.0, "pictures")), "verb way",
            verb=f"[{{=exit}}] ((the) [{say.PICTURE}])|[{{=leave}}] (the) [{say.PICTURE}]", way=say.steps,
        ),
        say.command(
            "put the dog behind the bush", placed, "place", who="(for|of|with|on) <there_already>",
            verb=say.phrase("![{=drop}] [<moving>|{=pop}]", moving=moving),
            place="(sitting|standing|lying|hanging|placed|resting|located|seated|floating|hovering|positioned|"
                  "so (that) [it|he|she] [is|stands|sits|lies|hangs]) (over|right|back|directly|straight|to|"
                  "somewhere|down|up|just|a bit|a little|slightly) <place>",
        ),
        say.command(
            "raise the dog by half its height", lambda lift, far=None: moved(UP if lift else DOWN, far), "lift", lift=raised,
            far=far, ground=ground,
        ),
    )  # fmt: skip


def scaled(by: float) -> Value:
    """Return a multiple of the size about the base."""
    return lambda who, when, _: Transform(who, scale=round(by, PLACES), pivot="base", **when.growth)


def turned(rotate: Vector) -> Value:
    """Return a rotation in degrees about the camera's axes; a full one "the whole time" takes the whole clip."""

    def value(who: SelectKind, when: When, _: SentenceContext) -> Change:
        if when.kind == "always" and max(map(abs, rotate)) >= 360:
            when = replace(when, frames=(0.0, None))
        return Transform(who, rotate=rotate, axes="camera", **when.growth)

    return value


def rotated(angle: float = 90.0, sense: int = 1) -> Value:
    """Return a rotation by degrees about the vertical."""
    return turned((0.0, sense * angle, 0.0))


def spun(who: SelectKind, when: When, context: SentenceContext) -> Change:
    """Return a rotation by a right angle; all around where the sentence says how long it lasts."""
    lasts = when.kind == "always" or (when.kind in ("range", "length", "in") and when.frames is not None)
    return rotated(360.0 if lasts else 90.0)(who, when, context)


def tilted(angle: float = TILT, sense: int = 1) -> Value:
    """Return a rotation by degrees to the side."""
    return turned((0.0, 0.0, sense * angle))


def moved(way: Steps, far: Distance | None = None) -> Value:
    """Return a shift by steps, of which those without a distance go `far`."""
    vector, unit = displacement(way, far, 1.0)
    return lambda who, when, _: Transform(who, translate=vector, unit=unit, axes="camera", **when.growth)


def placed(place: Place) -> Value:
    """Return a shift beside another thing."""

    def value(who: SelectKind, when: When, context: SentenceContext) -> Change:
        beside = place.other(context)
        if beside == who and isinstance(who, Named) and who.name in context.copies:
            beside = context.copies[who.name]  # "copy the dog and put the copy behind it"
        if beside == who:
            raise Refusal("A thing cannot go beside itself; say beside whom.")
        context.last = who
        return Transform(
            who, translate=DIRECTIONS[place.where], unit="size", axes="camera", beside=beside, **when.growth
        )

    return value


def _turned(
    verb: Any, angle: float | None = None, sense: int | None = None, around: bool = False, how: Amount | None = None
) -> Value:
    if verb is tilted and (around or (angle, sense, how) == (None, None, None)):
        raise Mismatch
    if angle is None:
        angle = 180.0 if around else 90.0 if verb is rotated else TILT
        if how is not None:
            angle = DEGREES[how.kind].angle
    return verb(angle, sense or 1)  # type: ignore[no-any-return]


def _no_count(x: float) -> float:
    """Return a factor such as 1.5, which is no number of copies; Mismatch for a whole one."""
    if x == int(x):
        raise Mismatch
    return x
