"""Operations that show Gaussians at other moments: frozen, faster or slower, backwards, again and again."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from ...errors import F4xError
from ...language.lexicon import PLACES, word_set
from ...language.refusal import Refusal
from ..change import Change, ChangeWithShadow, Reply, Span, TimeMap, check_numbers, check_scale, check_span
from ..description import percent_words, span_words, whom_with
from ..selects import All, SelectKind
from ..values import Value, graded

if TYPE_CHECKING:
    from ...language.grammar import Rule
    from ...language.times import TimeExpression
    from ...scene import Scene
    from ..english import Sentences
    from ..phrases import SentenceContext, When

SOFT = 0.25
"""Fraction of a span that each of its soft ends takes, or less where it is slow."""


class Retiming(ChangeWithShadow):
    """Base: a time map, from the clip frame shown to the clip frame read."""

    UNCOVERS = True
    SEEN = "elsewhere"


@dataclass(frozen=True)
class Freeze(Retiming):
    """Stand still: from `at` on, or for a while, after which it goes on where it stood."""

    TAG = "freeze"
    select: SelectKind
    at: float
    """Clip frame."""
    until: float | None = None
    """Clip frame at which it goes on, late by the pause; None = never."""

    def __post_init__(self) -> None:
        """Validate."""
        check_numbers("at or until", [self.at, self.at if self.until is None else self.until])
        if self.until is not None and self.until < self.at:
            raise F4xError(
                f"It would go on at frame {self.until:g}, before it stops, at {self.at:g}; give a later frame or none."
            )

    CLIP = True

    @property
    def moments(self) -> tuple[float | None, ...]:
        """Frames at which it stops and goes on."""
        return self.at, self.until

    def time_map(self, clip: tuple[float, float]) -> TimeMap:
        """Return the map that holds the frame `at` until `until` and is late by as much after that."""
        at, end = self.at, math.inf if self.until is None else self.until
        return lambda time: time if time <= at else at if time <= end else time - (end - at)

    def described(self) -> str:
        """Return "freeze the dog at frame 30", or from one frame to another."""
        until = "" if self.until is None else f" to frame {self.until:g}"
        return f"freeze {whom_with(self)} {'from' if until else 'at'} frame {self.at:g}{until}"

    @classmethod
    def replies(cls) -> tuple[Reply, ...]:
        """Return the reply for a freeze, which begins at the present frame where it gives none."""
        doc = "Stand still from the first frame (-1: the present one) to the last (-1: for good)."

        def make(answer: Any, who: SelectKind, _: Any) -> Freeze:
            at = answer.present if answer.first_frame < 0 else answer.first_frame
            return cls(who, float(at), None if answer.last_frame < 0 else float(answer.last_frame))

        return (Reply(("freeze",), doc, make, {}, "Stop"),)

    @classmethod
    def sentences(cls) -> Sentences:
        """Return the command to freeze."""
        from .. import english as say

        clip = say.literal("time|the clock|the action|the playback|playback|the motion|all motion|all movement")
        freeze = say.command(
            "freeze the dog at frame 30", say.always(frozen), "verb", say.WHOLE, say.about + say.thing | clip >> say.the_clip,
            lead="{=bring/come/hang/stand/stay/sit/remain/float/hover}|as a [still|freeze frame]|(in) [his|"
                 "her|its|their|the|that|this] [pose|position|posture|stance|posing|gesture]",
            verb="{freeze}|to a [stop|halt|standstill]|still frame|freeze frame on|hold the frame|motionless|"
                 "standing still|not move|no movement|stop|stopped|(perfectly|completely|absolutely) [still|"
                 "motionless|frozen]",
        )  # fmt: skip
        lag = "(by|with|of|at) (a) (delay|lag|offset) (of|by|:|+|=) <duration>"
        delay = say.command(
            "delay the dog by half a second", delayed, "verb lag", say.NAMED, _playing(), verb="{=delay/offset/lag/slip}",
            lag=f"{lag} (in time|later|late|behind)",
        )  # fmt: skip
        late = say.command(
            "start the dog half a second later", delayed, "verb lag", say.NAMED, _playing(),
            verb="{=start/begin/come/run/enter/set off/play/move}",
            lag=f"{lag} [later|late|behind|after that]",
        )  # fmt: skip
        return say.Sentences((freeze, delay, late))


@dataclass(frozen=True)
class Retime(Retiming):
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
        check_scale("speed", self.speed)
        check_span(self.frames)

    CLIP = True
    FACTORS = ("speed",)

    def time_map(self, clip: tuple[float, float]) -> TimeMap:
        """Return the map that multiplies time within the span by the speed, or by the integral of an eased one."""
        (first, last), speed = clip, self.speed
        begin, end = self.frames or (first, None)
        stop = math.inf if end is None else end

        def eased(time: float) -> float:
            length = (last if end is None else end) - begin
            if time <= begin or length <= 0:
                return time if time <= begin else min(begin + speed * (time - begin), last)
            u = min((time - begin) / length, 1.0)
            after = max(time - begin - length, 0.0) * (1 if self.ease == "soft" else speed)
            return min(begin + length * (u + (speed - 1) * self._changed(u)) + after, last)

        def at_once(time: float) -> float:
            if time <= begin:
                return time
            return min(begin + speed * (min(time, stop) - begin) + max(time - stop, 0.0), last)

        return eased if self.ease else at_once

    def _changed(self, u: float) -> float:
        """Return the integral of the ease from 0 to `u`, a fraction of the span; of a soft ease it is 1 at the end."""
        if self.ease != "soft":
            return u * u / 2 if self.ease == "linear" else u**3 - u**4 / 2
        side = min(self.speed / 2, SOFT)  # so short that it never runs backwards between the ends
        rise, fall = ((min(x, side) ** 2 / 2 / side + max(x - side, 0)) for x in (u, max(u - 1 + side, 0)))
        return (rise - fall) / (1 - side)

    def followed_by(self, later: Change) -> tuple[Change, ...]:
        """Return the later of two speeds; that of "slow until second 1, then fast" begins where this one ends."""
        if isinstance(later, Retime) and later.select == self.select:
            if later.frames == self.frames:
                return (later,)
            if later.frames is None and self.frames is not None and self.frames[1] is not None:
                later = replace(later, frames=(self.frames[1], None))
        return super().followed_by(later)

    def remark(self, scene: Scene, rows: np.ndarray) -> str:
        """Say so where the clip ends before all of it is shown."""
        first, last = (float(time) for time in scene.cameras.times[[0, -1]])
        shown = self.time_map((first, last))(last)
        if shown >= last - 1:
            return ""
        remark = f"{self.described()}: the clip keeps its length, so what comes after frame {shown:.0f} is not shown."
        if self.select == All() and self.frames is None:
            remark += f" `f4x render --path slow:{1 / self.speed:.3g}` shows all of it, with a slower camera."
        return remark

    def described(self) -> str:
        """Play the dog at half speed."""
        speeds = {2.0: "twice as fast", 0.5: "at half speed"}
        pace = speeds.get(self.speed, f"at {percent_words(self.speed)} speed")
        eased = {"soft": " with soft ends"}.get(self.ease or "", ", gradually" if self.frames else " gradually")
        return f"play {whom_with(self)} {pace}" + span_words(self.frames) + (eased if self.ease else "")

    @classmethod
    def replies(cls) -> tuple[Reply, ...]:
        """Return the reply for a speed in percent, with soft ends where it is smooth."""

        def make(answer: Any, who: SelectKind, _: Any) -> Retime:
            return cls(who, answer.percent / 100, answer.span, None if answer.ease == "none" else "smooth")

        fields = {"percent": range(1, 10001), "ease": ("none", "smooth")}
        return (Reply(("speed",), "Faster or slower: 100 is as before.", make, fields, "Speed"),)

    @classmethod
    def sentences(cls) -> Sentences:
        """Return speed as a quality, and the commands for slow motion and speeds."""
        from .. import english as say

        quality = say.Quality(
            graded(retimed, gone=False), "faster|quicker|swifter|speedier", "slower", much="fast|quick|quickly|speedy",
            little="slow|slowly", noun="speed|pace|tempo|playback speed|playback rate|velocity", lack="slowness", up="quicken",
            down="slow", sets="pace", too="hectic|rapid", too_little="sluggish", wished=True,
        )  # fmt: skip
        slow_motion = say.keyword(
            "(on|in|at|a|into|in a) [slow mo|slowmo|slo mo|slomo|slow motion|slow mode|bullet time]"
        )
        speed = say.either(
            say.table(
                {
                    "(in|at) double time|(in) [fast forward|fast motion]|time lapse|timelapse": 2.0,
                    "(in|at|a) [super|ultra|extreme|very|really] [slow motion|slow mo|slowmo|slo mo]": 0.25,
                },
                reserve=False,
            )
            >> retimed,
            quality.value,
            ~say.keyword("with") + slow_motion >> (lambda: retimed(0.5)),
            ~say.keyword("at|to|with") + say.fraction_of("speed|pace|tempo|rate") >> retimed,
            say.keyword("at|in|to")
            + (say.fraction_of("speed|pace|tempo|rate|velocity") | ~say.keyword("a") + say.multiple)
            >> retimed,
        )
        times = say.command(
            "play the dog at 2x", retimed, "verb by", say.TIMED, _playing(),
            verb=say.phrase("{run}") + say.here(lambda reading, at: reading.word(at - 1) not in MERELY),
            by="(at|with|in|to) [<number> x|x <number>]|[at|to] <percent> ![transparent|visible|opacity|opaque|of]",
        )  # fmt: skip
        slow = say.command(
            "slow motion, please", say.as_given, "values", say.WHOLE, _playing(), verb="{run}",
            values=say.either(speed, _backward() >> (lambda: reversed)) >> (lambda value: ((value,),)),
        )  # fmt: skip
        return say.Sentences((times, slow), (quality,), alone=(speed,))


@dataclass(frozen=True)
class Reverse(Retiming):
    """Backwards: at frame t what was at first + last - t."""

    TAG = "reverse"
    select: SelectKind
    frames: Span | None = None
    """Only from … to; None = the whole clip."""

    def __post_init__(self) -> None:
        """Validate."""
        check_span(self.frames)

    CLIP = True

    def time_map(self, clip: tuple[float, float]) -> TimeMap:
        """Return the map that mirrors time within the span; one up to the clip's end goes on backwards beyond it."""
        begin, end = self.frames or clip
        end = clip[1] if end is None else end
        until = math.inf if end >= clip[1] else end
        since = -math.inf if begin <= clip[0] else begin
        return lambda time: begin + end - time if since <= time <= until else time

    def described(self) -> str:
        """Play the dog backwards."""
        return f"play {whom_with(self)} backwards" + span_words(self.frames)

    @classmethod
    def replies(cls) -> tuple[Reply, ...]:
        """Return the reply that is read as `Reverse` or `Loop`."""

        def make(answer: Any, who: SelectKind, _: Any) -> Retiming:
            if answer.op == "reverse":
                return Reverse(who, answer.span)
            if answer.span is None:
                raise F4xError("a loop needs first_frame and last_frame")
            return Loop(who, answer.span)

        return (Reply(("reverse", "loop"), "Backwards, or again and again.", make, {}, "ReverseOrLoop"),)

    @classmethod
    def sentences(cls) -> Sentences:
        """Return the command to play backwards."""
        from .. import english as say

        reverse = say.command(
            "play the dog in reverse", say.always(reversed), "verb", say.WHOLE, _playing(),
            verb=say.phrase("{reverse}|backward|in reverse|reversed|the other way around in time|[{run}] "
                            "<.back>", back=_backward()),
        )  # fmt: skip
        return say.Sentences((reverse,), alone=(~say.toward + _backward() >> (lambda: reversed),))


@dataclass(frozen=True)
class Loop(Retiming):
    """Again and again what happens from … to, from then to the end of the clip."""

    TAG = "loop"
    select: SelectKind
    frames: Span
    """The part that is repeated."""

    def __post_init__(self) -> None:
        """Validate."""
        check_span(self.frames)

    def time_map(self, clip: tuple[float, float]) -> TimeMap:
        """Return the map that repeats the span; a round shows each of its frames once, the last one too."""
        begin, end = self.frames
        if end is None:
            return lambda time: time
        return lambda time: time if time <= end else min(begin + (time - begin) % (end - begin + 1), end)

    def described(self) -> str:
        """Loop the dog."""
        return f"loop {whom_with(self)}" + span_words(self.frames, "to the end")

    @classmethod
    def replies(cls) -> tuple[Reply, ...]:
        """Return nothing: the reply of `Reverse` is read as either."""
        return ()

    @classmethod
    def sentences(cls) -> Sentences:
        """Return the command to repeat."""
        from .. import english as say

        loop = say.command(
            "repeat the dog from second 1 to 2", say.always(looped), "again", say.WHOLE,
            say.phrase("<motion>|<about> <thing> ('s)", motion=say.whose(MOTIONS)), verb="{run,loop}",
            again="{loop}|on (a) loop|in a loop|on repeat|over and over (again)|again and again|endlessly|"
                  "forever|in an endless loop|as a loop|a loop|repeatedly|looping",
        )  # fmt: skip
        return say.Sentences((loop,))


def looped(who: SelectKind, when: When, _: SentenceContext) -> Change:
    """Return a loop; Refusal without a time."""
    if when.frames is None:
        raise Refusal("It is not said which part is repeated; add for example 'from second 1 to 2'.")
    return Loop(who, **when.effect)


def reversed(who: SelectKind, when: When, _: SentenceContext) -> Change:
    """Return a reversal."""
    return Reverse(who, **when.effect)


MOTIONS = "motion|motions|movement|movements|action|animation|walk|run|jump|dance|ride|spin|turn|flight|swing|fall|kick|leap|hop"
MERELY = word_set("make makes making made get gets got be have has let put set keep")
"""Of the verbs of playing those that do not say that it is about speed."""


def _playing() -> Rule:
    """Return the rule of selections that are played."""
    from .. import english as say

    whole = say.literal(f"[the|this|that|all the|all] (whole|entire) [{MOTIONS}]") >> say.the_clip
    return say.phrase("<motion>|<about> <thing>|<whole>", motion=say.whose(MOTIONS), whole=whole)


def _backward() -> Rule:
    from .. import english as say

    return say.keyword(
        "backward ([in|through] time)|back in time|in reverse|reversed|in the opposite direction|back to front|from the end to "
        "the start|in reverse order|(the) other way around|from back to front|from end to start"
    )


def retimed(by: float) -> Value:
    """Return a retiming to `by` times the speed."""
    return lambda who, when, _: Retime(who, round(by, PLACES), **when.pace)


def delayed(lag: TimeExpression) -> Value:
    """Return a freeze that makes a thing late by a time, from the first frame on or from the time that is given."""

    def value(who: SelectKind, when: When, context: SentenceContext) -> Change:
        at = when.frames[0] if when.frames else 0.0
        return Freeze(who, at, at + lag.resolve(context))

    return value


def frozen(who: SelectKind, when: When, context: SentenceContext) -> Change:
    """Return a freeze."""
    return Freeze(who, **when.pause(context))
