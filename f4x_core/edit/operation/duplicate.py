"""Copies, elsewhere or at another time."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from ...errors import F4xError
from ...geometry.arrays import evenly_spaced
from ...language.degrees import Distance, Steps, Unit, displacement
from ...language.refusal import Refusal
from ...query.connected_objects import VISIBLE
from ..change import DIRECTIONS, Change, Reply, TimeMap, Vector, check_name, check_numbers
from ..description import beside_words, steps_in_words, way_words, whom, whom_with
from ..selects import Named, SelectKind, parts_of
from ..splat_rows import with_copies, with_name
from ..values import Given
from ._place import BESIDE, COPY_DISTANCE, RIGHT, Placing
from .opacity import Opacity
from .transform import Transform

if TYPE_CHECKING:
    from ...language.grammar import Rule
    from ...language.times import TimeExpression
    from ...scene import Scene
    from ..english import Command, Sentences
    from ..phrases import Place, SentenceContext, When
    from ..plan_lines import Seen
    from ..splat_rows import SplatRows

FAINT = 0.5
"""Opacity of faint copies."""
FAINTLY = {"(of) [fading|ghostly|ghost|faint|transparent|see through|semi transparent|half transparent]": True}
"""Words for copies that can be seen through."""
MOMENTS = 5
"""Frames, evenly over the clip, in which it is looked whether copies are in the picture."""
MAX_COPIES = 100
"""Copies one operation makes at most: memory grows with every one."""


@dataclass(frozen=True)
class Duplicate(Placing):
    """Copies of it, elsewhere or at another time. Their ids follow `first_id` in the order of the chosen ids."""

    TAG = "duplicate"
    select: SelectKind
    offset: Vector = (0.0, 0.0, 0.0)
    """Between one copy and the next, in `unit` along `axes`."""
    time_shift: float = 0.0
    """Clip frames that a copy lags behind; negative runs ahead. Each copy by as much again."""
    count: int = 1
    """Number of copies."""
    unit: Unit = "world"
    axes: Literal["world", "camera"] = "world"
    first_id: int = -1
    """First id of the copies; planning reserves it."""
    name: str = ""
    """The copies can be selected by this name afterwards."""
    beside: SelectKind | None = None

    def __post_init__(self) -> None:
        if not 1 <= self.count <= MAX_COPIES:
            raise F4xError(f"count is {self.count}; give 1 to {MAX_COPIES} copies.")
        if not -1 <= self.first_id < 1 << 62:
            raise F4xError(f"first_id is {self.first_id}; give a free id of the scene, or leave it out.")
        check_numbers("offset", self.offset)
        check_numbers("time_shift", [self.time_shift])
        if self.name:
            check_name(self.name)

    WAY = "offset"
    SEEN = "in copies"

    def rows_after(self, rows: SplatRows, chosen: np.ndarray) -> SplatRows:
        if chosen.any():
            self.require_world()
        return with_copies(rows, rows.by_id(chosen), self.count, self.first_id, self.name)

    def rows_without(self, rows: SplatRows) -> SplatRows:
        free = self.name and self.name not in rows.names
        return with_name(rows, self.name, np.zeros(0, int)) if free else rows

    def copy_time_maps(self, clip: tuple[float, float]) -> tuple[TimeMap, ...]:
        """Return the time map of each copy, delayed by one `time_shift` more than the one before, within the clip."""
        return tuple(self._copy_time_map(copy * self.time_shift, clip) for copy in range(1, self.count + 1))

    @staticmethod
    def _copy_time_map(shift: float, clip: tuple[float, float]) -> TimeMap:
        first, last = clip
        return (lambda time: min(max(time - shift, first), last)) if shift else (lambda time: time)

    def copy_motion(self, copy: np.ndarray) -> np.ndarray | None:
        return copy[:, None] * np.array(self.offset) if any(self.offset) else None

    def remark(self, scene: Scene, rows: np.ndarray) -> str:
        """Say so where copies lie outside the picture whenever the thing itself is in it."""
        if not any(self.offset):
            return ""
        copies = np.arange(self.count + 1)
        seen = np.zeros(len(copies), bool)
        for time in scene.cameras.times[evenly_spaced(len(scene.cameras), MOMENTS)]:
            posed, camera = scene.posed(float(time)), scene.cameras.at(float(time))
            shown = rows[posed.opacities[rows] >= VISIBLE]
            if len(shown):
                centers = np.median(posed.means[shown], 0) + copies[:, None] * np.array(self.offset)
                pixels, depth = camera.project(centers)
                seen |= (depth > 0) & ((pixels >= 0) & (pixels < (camera.width, camera.height))).all(1)
        outside = int((~seen[1:]).sum())
        if not seen[0] or not outside:
            return ""
        are = f"{outside} of {self.count} copies lie" if self.count > 1 else "the copy lies"
        return f"copy {whom_with(self)}: {are} outside the picture all the time; say a shorter way, such as 'half a width'."

    def untimed(self) -> Duplicate:
        return replace(self, time_shift=0.0)

    def followed_by(self, later: Change) -> tuple[Change, ...]:
        """Return a copy made at the place to which `later` would move it; Refusal where copies might be copied."""
        if isinstance(later, Transform) and self.offset == BESIDE:
            stays = replace(later, translate=(0.0, 0.0, 0.0), select=self.select, unit="world", axes="world")
            if later.select == Named(self.name) and stays == Transform(self.select) and any(later.translate):
                far = COPY_DISTANCE if max(map(abs, later.translate)) == 1 and later.unit == self.unit else 1.0
                x, y, z = (far * step for step in later.translate)
                if x or z:
                    return (replace(self, offset=(x, y, z), unit=later.unit),)
        if isinstance(later, Duplicate) and Named(self.name) in [*parts_of(later.select)][1:]:
            raise Refusal("It is not said whether the copies are to be copied, too; name the thing to copy.")
        return super().followed_by(later)

    def times_as_much(self, factor: float) -> Duplicate:
        return replace(self, offset=self.further(factor))

    def described(self) -> str:
        sentence = f"copy {whom_with(self)}" + (f" {self.count} times" if self.count > 1 else "")
        if self.beside is not None:
            sentence += f" {beside_words(self.offset)} {whom(self.beside)}"
        elif any(self.offset):
            sentence += f" {way_words(self.offset, self.unit, self.axes)}"
        if self.time_shift:
            sentence += f" {abs(self.time_shift):g} frames {'later' if self.time_shift > 0 else 'earlier'}"
        return sentence + (f", called {self.name}" if self.name else "")

    def as_seen(self, seen: Seen) -> str:
        way, later = steps_in_words(seen.in_widths(self.offset)), self.time_shift
        parts = [f"ends {way} of it"] if way else []
        if later:
            seconds = f"{abs(later) / seen.scene.fps:.1f} s"
            parts.append(f"plays {abs(later):g} frames ({seconds}) {'later' if later > 0 else 'earlier'}")
        copies = "the copy" if self.count == 1 else f"each of the {self.count} copies, seen from the one before,"
        named = f", called {self.name}" if self.name else ""
        return f"copy {whom_with(self)}{named}: {copies} {' and '.join(parts) or 'is in the same place'}"

    def in_axes(self, moved: Callable[[Vector], Vector], turned: Callable[[Vector], Vector]) -> Duplicate:
        return replace(self, offset=moved(self.offset)) if self.axes == "world" else self

    @classmethod
    def replies(cls) -> tuple[Reply, ...]:
        """Return the reply for copies, offset in percent of the target's width along the camera's axes."""

        def make(answer: Any, who: SelectKind, _: Any) -> Duplicate:
            offset = (answer.right / 100, -answer.up / 100, answer.away / 100)
            return cls(who, offset, float(answer.later_frames), answer.copies, "size", "camera")

        way, frames = range(-1000, 1001), range(-1_000_000, 1_000_001)
        fields = {"right": way, "up": way, "away": way, "later_frames": frames, "copies": range(1, MAX_COPIES + 1)}
        return (Reply(("duplicate",), "Copies beside it, or later in time.", make, fields, "Copy", timed=False),)

    @classmethod
    def sentences(cls) -> Sentences:
        from .. import english as say

        one = "another|one more|a second|an extra|a new|a further|an additional|one other|a"
        times = say.either(
            say.phrase("(like|about|say|maybe|some) <number> (x|times|of [them|it|him|her|these|those])|x <number>"),
            say.phrase(f"[{one}] ![shade|tone|color|look|kind|version of]") >> (lambda: 1.0),
            say.table({"once": 1.0, "twice": 2.0, "two times": 2.0, "thrice": 3.0}),
        )
        noun = say.literal(
            "[copy|copies|clone|clones|duplicate|duplicates|replica|replicas|double|twin|doubles|twins|duplication|instances|"
            "version|versions] (of)"
        )
        copy = say.command(
            "copy the dog to the left", copied, "copy", who="(of|for) <thing>", verb="{add}", times=times, faint=FAINTLY,
            copy=say.phrase(
                "!<.size> [{copy}|(more|extra|other|identical|additional|new|second|single) <noun>]|[more|another|extra|"
                "second] [one of|ones of]|one more of|[another|one more|a second] one|[one more|another] !<familiar> "
                "![one|time|step|turn|bit]",
                size=say.fraction_of("size|sizes|scale|speed|height|width|length|in size"), noun=noun,
            ),
            **say.BESIDE_IT,
        )  # fmt: skip
        more = say.command(
            "one dog more", copied, "times extra", say.NAMED, say.known_noun, verb="{add}|there is|there are|be there",
            times=say.number, extra="[more|extra|additional|again|further] (of the same (kind|sort)|like it|like that)",
            **say.BESIDE_IT,
        )  # fmt: skip
        another = say.command(
            "add another dog", copied, "times", say.NAMED, "(of) <known_thing>", verb="{add}|there is|there are|be there",
            times=say.phrase("<number> [more|other|extra|additional|further]")
            | (
                say.literal("another|one more|a second|an extra|an additional|a further")
                | say.literal("the same|same") + say.here(lambda reading, at: say.familiar.at(reading, at))
            )
            >> (lambda: 1.0),
            **say.BESIDE_IT,
        )  # fmt: skip
        return say.Sentences((copy, more, another, _trailing(times, noun)))


def _trailing(times: Rule, noun: Rule) -> Command:
    from .. import english as say

    names = say.table(
        {
            "ghost [trail|trails|image|images]|after [image|images]|ghosting|afterimage|afterimages|ghosts": True,
            "trail|trails|[motion|light] [trail|trails]|streaks|motion streaks|echoing|trailing|echo|echoes|trailing copies|onion "
            "skin|onion skinning|" + say.any_form("follow") + "|echo effect": False,
        },
        reserve=False,
    )
    lagging = say.literal("delayed|lagging|late|trailing|following|time shifted")
    return say.command(
        "let a copy follow the dog half a second behind", _trail, "trail", say.NAMED,
        "![[a|an|the|another|one] [ghost|echo|copy|clone|duplicate|twin|trail]] (of|behind|after|for|on|to) <thing>",
        faint=FAINTLY,
        trail=~say.literal("(a|an|some|the|that|which|who) (soft)")
        + (
            say.here(lambda reading, at: reading.word(at - 1) in say.BEFORE_VERBS)
            + say.literal("ghost")
            + say.constant(True)
            | lagging + say.here(lambda reading, at: noun.at(reading, at)) + say.constant(False)
            | names
        ),
        copies="(by|of|some|few|a few|several|with) [copies|clones|ghosts|echoes|duplicates|of it|of itself|of him|of her]",
        single=say.phrase(
            "(a|one|another|the|an identical|a second) [copy|clone|duplicate|second one|twin]|[a second|"
            "another|an identical|one more|an extra|the same] ![copy|ghost|clone|one] (<.familiar> ![that|"
            "which|who])"
        )
        >> (lambda: False)
        | say.phrase("(a|one|another|the|a second) ghost ![trail|trails|image|images|copies]") >> (lambda: True),
        times=say.phrase("(of|with|by|plus|and|+) !a <times>", times=times), verb=say.phrase("<light_verb>|{add}"),
        behind="behind it|behind him|behind her|after it|behind itself|behind|it|itself|him|her|the original|"
               "the first (one)|the real one",
        shift="<SHIFT>|(with a lag of|at|every|each|by|with|spaced) <duration> (apart|later|late|behind|"
              "offset|between each (one)|between (each of) them|delay|of delay|lag|offset (each)|each|between "
              "them|intervals|after it)",
    )  # fmt: skip


def copied(
    way: Steps | None = None,
    far: Distance | None = None,
    times: float = 1.0,
    shift: TimeExpression | None = None,
    own: Place | None = None,
    called: str = "",
    faint: bool = False,
) -> Given:
    """Return copies; Refusal for a number of them that is not whole.

    `way`, `far`, `own`: the direction, the distance and the thing beside which they stand; `times`: their number; `shift`: their
    delay; `called`: their name; `faint`: they can be seen through.
    """
    if times != int(times):
        raise Refusal(f"{times:g} copies cannot be made; say a whole number.")
    arguments: dict[str, Any] = {"count": int(times), "name": called}
    if way or far or own or shift is None:
        offset, unit = displacement(way or RIGHT, far, COPY_DISTANCE)
        arguments |= {"offset": offset, "unit": unit, "axes": "camera"}

    def value(who: SelectKind, when: When, context: SentenceContext) -> Change:
        if called:
            context.names.setdefault(called.lower(), called)
        later = 0.0 if shift is None else shift.resolve(context)
        placing = dict(arguments)
        if own is not None:
            other = own.other(context)
            placing["offset"] = tuple(COPY_DISTANCE * step for step in DIRECTIONS[own.where])
            if other != who:
                placing |= {"beside": other, "offset": DIRECTIONS[own.where]}
            elif not any(placing["offset"]):
                placing["offset"] = BESIDE
        context.last = who
        return Duplicate(who, time_shift=later, **placing, **when.none("A copy"))

    def faded(_: SelectKind, when: When, context: SentenceContext) -> Change:
        return Opacity(Named(called or context.next_copy), FAINT)

    return ((value,), (faded,)) if faint else value


def _trail(
    trail: bool,
    times: float | None = None,
    shift: TimeExpression | None = None,
    single: bool | None = None,
    faint: bool = False,
) -> Given:
    """Return copies behind it, or a single one; see-through where one of the words for them says so."""
    from ..english import TRAIL_COPIES, TRAIL_LAG

    times = times or (TRAIL_COPIES if single is None else 1.0)
    return copied(times=times, shift=shift or TRAIL_LAG, faint=bool(trail or single or faint))
