"""Answers that compare: moments of a thing, distances between two, colours, counts, order in the picture and in depth."""

from __future__ import annotations

import re
from collections import defaultdict
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from ..errors import F4xError
from ..geometry import spherical_harmonics
from ..language.colour_names import everyday_name
from ..language.lexicon import plural
from ..scene import Scene
from ..scene.people import single_people
from .connected_objects import VISIBLE, split_objects, width_along
from .ground import up_of
from .selection import Selection
from .wording import Asked

MAX_TIMES = 48
"""Clip times, evenly over what is asked about, at which places are measured."""
MOVES = 0.03
"""World units a second (1 = median depth) from which a thing moves."""
MIN_RISE = 0.01
"""World units by which a thing must rise for the moments of it to be more than jitter of the fit."""
JUMPS = 0.15
"""Part of its height by which a thing that jumps is higher than before and afterwards: a horse over a fence .4, a car .03."""
MIN_COLOUR_FRACTION = 0.2
"""Fraction of a thing's surface from which a colour of it is told, and of its Gaussians from which a word for it is."""
LUMA = np.array([0.2126, 0.7152, 0.0722])
"""Weights of red, green and blue in brightness (Rec. ITU-R BT.709)."""
TURNS = np.pi / 4
"""Radians by which a way has to change for a turn: less is a bend, or jitter."""
BETWEEN = 0.35
"""Something is between two things where it is nearer to the line than this part of its length, and not at its ends."""
SAME = 0.5
"""A thing of which so many Gaussians are another's is the other by another word."""
NEIGHBOURS = 3
"""As many neighbours are told."""


@dataclass(frozen=True, eq=False)
class Measured:
    """One thing at K clip times."""

    name: str
    """As it is told, with its article."""
    rows: np.ndarray
    """(n,) rows of `scene.posed`."""
    centres: np.ndarray
    """(K,3) world."""
    pixels: np.ndarray
    """(K,2) in the clip's camera."""
    depth: np.ndarray
    """(K,) world units before the camera."""
    width: float
    """World units across the picture, at the first time."""
    moves: bool
    """True if the scaffold or an edit moves most of it."""
    height: float = 0.0
    """World units up the picture, at the first time."""


def measure(
    scene: Scene, found: Mapping[str, Selection], times: np.ndarray, named: Sequence[str] = ()
) -> list[Measured]:
    """Measure the things `found` that have Gaussians at clip `times (K,)`; those in `named` take no article."""
    posed = [scene.posed(float(time)) for time in times]
    cameras = [scene.cameras.at(float(time)) for time in times]
    measured = []
    for label, selection in found.items():
        rows = np.flatnonzero(selection.chosen)
        if not len(rows):
            continue
        centres = np.stack([np.average(one.means[rows], 0, one.opacities[rows] + 1e-6) for one in posed]).astype(float)
        seen = [camera.project(centre[None]) for camera, centre in zip(cameras, centres, strict=True)]
        width, height = (width_along(posed[0], rows, cameras[0].camera_to_world[:3, axis]) for axis in (0, 1))
        name = label if label in named else f"the {label}"
        pixels, depth = np.stack([pixel[0] for pixel, _ in seen]), np.array([far[0] for _, far in seen])
        measured.append(
            Measured(name, rows, centres, pixels, depth, width, bool(scene.moving[rows].mean() > 0.5), height)
        )
    return measured


def single_ones(scene: Scene, kind: Measured, times: np.ndarray) -> list[Measured]:
    """Return the separate things that `kind` consists of, from left to right; none where it is one."""
    posed, camera = scene.posed(float(times[0])), scene.cameras.at(float(times[0]))
    owner, stray = split_objects(posed, kind.rows, single_people(scene, kind.rows))
    parts = [kind.rows[(owner == n) & ~stray] for n in range(int(owner.max()) + 1)]
    if len(parts) < 2:
        return []
    middles = [camera.project(np.median(posed.means[rows], 0)[None].astype(float))[0][0, 0] for rows in parts]
    chosen = {
        f"{kind.name} {place} from the left": np.isin(np.arange(len(scene.ids)), parts[n])
        for place, n in enumerate(np.argsort(middles), 1)
    }
    found = {name: Selection(scene.ids, rows.astype(float), rows) for name, rows in chosen.items()}
    return measure(scene, found, times, tuple(found))


def times_of(scene: Scene, asked: Asked) -> np.ndarray:
    """Return the clip times (K,) that a question is about."""
    first, last = asked.span or (float(scene.cameras.times[0]), float(scene.cameras.times[-1]))
    return np.unique(np.linspace(first, last, int(min(MAX_TIMES, 1 + round(last - first)))))


class Comparison:
    """The things of a question, measured, and the sentences about them."""

    def __init__(self, scene: Scene, asked: Asked, things: list[Measured], times: np.ndarray):
        """Compare `things`: those that were asked about, else all there are."""
        self.scene, self.asked, self.things, self.times = scene, asked, things, times

    def sentence(self, everything: Callable[[], list[Measured]]) -> str:
        """Return the answer; `everything` returns the other things of the scene."""
        kind = self.asked.kind
        if kind == "what_is":
            return self._words(everything())
        if kind.endswith("_moment"):
            return self._moment(kind.removesuffix("_moment"))
        if kind in ("behind", "in_front", "neighbours", "between", "left_of", "right_of", "above", "below"):
            return self._around(kind, everything())
        if kind in ("nearest", "farthest") and self.asked.other and self.asked.among:
            return self._nearest_of_many(kind)
        if kind in ("nearest", "farthest") and self.asked.other and not self.asked.polar and len(self.things) == 1:
            return self._around(kind, everything())
        return {
            "distance": self._distance, "rise": self._rise, "compare_size": self._sizes, "colour": self._colour,
            "count": self._count, "count_moving": self._moving, "order": self._order, "relation": self._relation,
            "nearest": self._depths, "farthest": self._depths, "biggest": self._biggest, "still": self._still,
            "most_moving": self._most_moving, "stops": self._stops, "fast": self._speed, "path": self._path,
            "when_turns": self._turns, "approach": self._approach, "compare_speed": self._faster, "brightest": self._brightest,
        }[kind]()  # fmt: skip

    def _at(self, k: int) -> str:
        return f"at frame {self.times[k]:.0f} ({self.times[k] / self.scene.fps:.1f} s)"

    def _apart(self) -> tuple[np.ndarray, str]:
        """Return the distance (K,) in world units of the two things, or of one from the camera, and the subject of the sentence."""
        if len(self.things) > 1:
            one, two = self.things[:2]
            return np.linalg.norm(one.centres - two.centres, axis=1), f"{one.name} and {two.name} are"
        (one,) = self.things
        centres = np.stack([self.scene.cameras.at(float(t)).center for t in self.times])
        return np.linalg.norm(one.centres - centres, axis=1), f"{one.name} is"

    def _moment(self, which: str) -> str:
        if which in ("fastest", "slowest"):
            speed = self._speeds()
            k = int(speed.argmax() if which == "fastest" else speed.argmin())
            return f"{self.things[0].name} is {which} {self._at(k)}: {speed[k]:.2f} times the median depth a second."
        if which == "highest":
            k = int(self.things[0].pixels[:, 1].argmin())
            return f"{self.things[0].name} is highest in the picture {self._at(k)}."
        apart, what = self._apart()
        k = int(apart.argmin() if which == "nearest" else apart.argmax())
        whom = "each other" if len(self.things) > 1 else "the camera"
        preposition = "to" if which == "nearest" else "from"
        return f"{what} {which} {preposition} {whom} {self._at(k)}: {apart[k]:.2f} times the median depth."

    def _speeds(self, number: int = 0) -> np.ndarray:
        """Return the speed (K,) of a thing in world units a second; F4xError for a single moment."""
        if len(self.times) < 2:
            raise F4xError("Speed needs more than one moment; ask about a span of time.")
        return np.linalg.norm(np.gradient(self.things[number].centres, self.times, axis=0), axis=1) * self.scene.fps

    def _speed(self) -> str:
        speed = self._speeds()
        value = {"max": speed.max(), "min": speed.min()}.get(self.asked.extreme, speed.mean())
        word = {"max": "at most", "min": "at least"}.get(self.asked.extreme, "on average")
        return f"{self.things[0].name} moves at {value:.2f} times the median depth a second {word}."

    def _distance(self) -> str:
        apart, what = self._apart()
        k = int({"min": apart.argmin(), "max": apart.argmax()}.get(self.asked.extreme, 0))
        mean = f", {apart.mean():.2f} on average" if self.asked.extreme == "mean" else ""
        span = "" if len(apart) == 1 else f"; over that time {apart.min():.2f} to {apart.max():.2f}{mean}"
        far = "apart" if len(self.things) > 1 else "from the camera"
        return f"{what} {apart[k]:.2f} times the median depth {far} {self._at(k)}{span}."

    def _approach(self) -> str:
        apart, what = self._apart()
        away = self.asked.manner.startswith(("away", "apart", "farther", "leav"))
        nearer = bool(apart[-1] < apart[0])
        far = "apart" if len(self.things) > 1 else "from the camera"
        sentence = (
            f"{what} {apart[0]:.2f} times the median depth {far} {self._at(0)} and {apart[-1]:.2f} {self._at(-1)}."
        )
        return _polar(self.asked.yes(nearer != away), sentence)

    def _path(self) -> str:
        """Return the sentence about the thing's places in the picture: first, in between and last."""
        one, camera = self.things[0], self.scene.cameras.at(float(self.times[0]))
        places = [
            f"{x / camera.width:.0%} from the left, {y / camera.height:.0%} from the top {self._at(k)}"
            for k in dict.fromkeys((0, len(self.times) // 2, len(self.times) - 1))
            for x, y in (one.pixels[k],)
        ]
        return f"{one.name} goes: {'; then '.join(places)}."

    def _turns(self) -> str:
        """Return the sentence about the moment at which the thing's direction changes most."""
        one = self.things[0]
        if len(self.times) < 3 or not self._is_moving(one):
            return f"{one.name} does not move, so it does not turn."
        steps = np.diff(one.centres[:, [0, 2]], axis=0)
        angles = np.unwrap(np.arctan2(steps[:, 1], steps[:, 0]))
        turn = np.abs(np.gradient(angles))
        k = int(turn.argmax())
        if np.ptp(angles) < TURNS:
            return f"{one.name} goes straight on."
        return f"{one.name} turns most {self._at(k)}; this is the way that it moves, not the way that it looks."

    def _faster(self) -> str:
        mean = sorted(
            ((float(self._speeds(n).mean()), one) for n, one in enumerate(self.things)), key=lambda pair: -pair[0]
        )
        if self.asked.manner in ("slower", "slowest"):
            mean.reverse()
        yes = self.asked.yes(mean[0][1] is self.things[0])
        word = "faster" if self.asked.manner in ("faster", "quicker", "fastest", "quickest") else "slower"
        speeds = ", ".join(f"{one.name} {speed:.2f}" for speed, one in mean[:NEIGHBOURS])
        return _polar(yes, f"{mean[0][1].name} is {word}; in times the median depth a second: {speeds}.")

    def _brightest(self) -> str:
        posed = self.scene.posed(float(self.times[0]))
        light = {
            one.name: float(np.average(spherical_harmonics.rgb_from_dc(posed.sh[one.rows, 0].astype(float)) @ LUMA,
                                       weights=posed.opacities[one.rows] + 1e-6))
            for one in self.things
        }  # fmt: skip
        name = (min if self.asked.manner == "darkest" else max)(light, key=lambda each: light[each])
        return f"{name} is the {self.asked.manner or 'brightest'} thing, {light[name]:.0%} of white."

    def _rise(self) -> str:
        """Return the sentence about the height and the moment of a rise; a jump comes down again."""
        one = self.things[0]
        height = one.centres @ up_of(self.scene.cameras)
        before, after = np.minimum.accumulate(height), np.minimum.accumulate(height[::-1])[::-1]
        jump = self.asked.manner == "jump"
        up = height - (np.maximum(before, after) if jump else height.min())
        k = int(up.argmax())
        jumps = bool(up[k] >= JUMPS * one.height)
        if jump and not jumps:
            low = f"{one.name} does not jump: it never rises by {JUMPS:.0%} of its height and comes down again."
            return _polar(self.asked.yes(False), low)
        sentence = f"{one.name} {'jumps' if jump else 'rises'} by {up[k]:.2f} times the median depth"
        if up[k] < MIN_RISE:
            return f"{sentence}, which is too little to tell when."
        low_at = np.flatnonzero(up < up[k] / 2)
        first, last = low_at[low_at < k].max(initial=-1) + 1, low_at[low_at > k].min(initial=len(up)) - 1
        aloft = f"from frame {self.times[first]:.0f} to {self.times[last]:.0f}"
        return _polar(
            self.asked.yes(True) if jump else "",
            f"{sentence}; it is highest {self._at(k)}, and above half of that {aloft}.",
        )

    def _two(self) -> tuple[Measured, Measured]:
        if len(self.things) < 2:
            raise F4xError("Two things are compared, and only one is named; name the other.")
        return self.things[0], self.things[1]

    def _sizes(self) -> str:
        one, two = self._two()
        axis, word = ("height", "tall") if self.asked.manner in ("taller", "lower") else ("width", "wide")
        smaller, larger = sorted((two, one), key=lambda thing: float(getattr(thing, axis)))
        yes = self.asked.yes((larger is one) == (self.asked.manner not in ("smaller", "lower")))
        times = getattr(larger, axis) / max(getattr(smaller, axis), 1e-9)
        return _polar(yes, f"{larger.name} is {times:.1f} times as {word} as {smaller.name}.")

    def _depths(self) -> str:
        far = self.asked.kind == "farthest"
        first, *others = sorted(self.things, key=lambda thing: -thing.depth[0] if far else thing.depth[0])
        yes = self.asked.yes(first is self.things[0])
        than = f", {others[0].name} at {others[0].depth[0]:.2f}" if others else ""
        return _polar(
            yes,
            f"{first.name} is {'farther' if far else 'nearer'}, at {first.depth[0]:.2f} times the median depth{than}.",
        )

    def _relation(self) -> str:
        one, two = self._two()
        where = re.sub(r"^(?:to |on |at )?(?:the )?(left|right).*", r"\1 of", self.asked.manner)
        if where in ("in relation", "relative", "compared", "with respect"):
            side = "left" if one.pixels[0, 0] < two.pixels[0, 0] else "right"
            depth = "in front of" if one.depth[0] < two.depth[0] else "behind"
            return f"{one.name} is {side} of {two.name} and {depth} it {self._at(0)}."
        if where in ("near", "next to", "beside", "close to"):
            apart = float(np.linalg.norm(one.centres[0] - two.centres[0]))
            sentence = f"{one.name} and {two.name} are {apart:.2f} times the median depth apart {self._at(0)}."
            return _polar(self.asked.yes(apart < one.width + two.width), sentence)
        where = {"over": "above", "under": "below", "in front": "in front of"}.get(where, where)
        if where in ("in front of", "behind"):
            so = bool(one.depth[0] < two.depth[0]) == (where == "in front of")
            place = "nearer" if one.depth[0] < two.depth[0] else "farther"
            return _polar(self.asked.yes(so), f"{one.name} is {place} than {two.name} {self._at(0)}.")
        axis = int(where in ("above", "below"))
        before = bool(one.pixels[0, axis] < two.pixels[0, axis])
        names = (("left of", "right of"), ("above", "below"))[axis]
        so = before == (where.endswith("left of") or where == "above")
        return _polar(self.asked.yes(so), f"{one.name} is {names[0] if before else names[1]} {two.name} {self._at(0)}.")

    def _nearest_of_many(self, kind: str) -> str:
        """Return the sentence about the one of a kind that is nearest to, or farthest from, the last thing."""
        *many, to = self.things
        apart = {one.name: float(np.linalg.norm(one.centres[0] - to.centres[0])) for one in many}
        name = (min if kind == "nearest" else max)(apart, key=lambda each: apart[each])
        word = "nearest to" if kind == "nearest" else "farthest from"
        return f"{name} is {word} {to.name} {self._at(0)}: {apart[name]:.2f} times the median depth."

    def _around(self, kind: str, everything: list[Measured]) -> str:
        mine, one = {thing.name for thing in self.things}, self.things[0]
        others = [thing for thing in everything if thing.name not in mine]
        if kind != "between":  # another word for it is not beside it
            others = [thing for thing in others if np.isin(thing.rows, one.rows).mean() < SAME]
        if kind in ("behind", "in_front"):
            others = [thing for thing in others if (thing.depth[0] > one.depth[0]) == (kind == "behind")]
        if kind in ("left_of", "right_of"):
            others = [t for t in others if (t.pixels[0, 0] < one.pixels[0, 0]) == (kind == "left_of")]
        if kind in ("above", "below"):
            others = [t for t in others if (t.pixels[0, 1] < one.pixels[0, 1]) == (kind == "above")]
        if kind == "between":
            camera = self.scene.cameras.at(float(self.times[0])).center
            way = (self.things[1].centres[0] if len(self.things) > 1 else camera) - one.centres[0]
            length = max(float(np.linalg.norm(way)), 1e-9)
            along = [float((thing.centres[0] - one.centres[0]) @ way) / length**2 for thing in others]
            aside = [
                float(np.linalg.norm(t.centres[0] - one.centres[0] - a * way))
                for t, a in zip(others, along, strict=True)
            ]
            others = [t for t, a, d in zip(others, along, aside, strict=True) if 0 < a < 1 and d < BETWEEN * length]
        others.sort(
            key=lambda thing: float(np.linalg.norm(thing.centres[0] - one.centres[0])), reverse=kind == "farthest"
        )
        names = [thing.name for thing in others[: 1 if kind in ("nearest", "farthest") else NEIGHBOURS]]
        what = {"between": "between them:", "neighbours": "near", "in_front": "in front of", "left_of": "left of",
                "right_of": "right of"}.get(kind, kind)  # fmt: skip
        whom = (
            ""
            if kind == "between"
            else f" {'to' if kind == 'nearest' else 'from' if kind == 'farthest' else ''} {one.name}:"
        )
        return " ".join(f"{what}{whom} {', '.join(names) or 'nothing that the scene has a word for'}.".split())

    def _words(self, everything: list[Measured]) -> str:
        """Return the sentence about the scene's words for most of a thing."""
        one = self.things[0]
        fractions = {each.name: float(np.isin(one.rows, each.rows).mean()) for each in everything}
        ranked = sorted(fractions.items(), key=lambda item: -item[1])
        words = [f"{name} ({part:.0%})" for name, part in ranked if part >= MIN_COLOUR_FRACTION]
        return f"{one.name} is {' and '.join(words) or 'nothing that the scene has a word for'}."

    def _colour(self) -> str:
        sentences = []
        for thing in self.things:
            sh = self.scene.posed(float(self.times[0]))
            rgb = spherical_harmonics.rgb_from_dc(sh.sh[thing.rows, 0].astype(float))
            weight = sh.opacities[thing.rows] * np.prod(np.sort(sh.scales[thing.rows], 1)[:, 1:], 1)
            area: dict[str, float] = defaultdict(float)
            for (red, green, blue), part in zip(rgb, weight / max(weight.sum(), 1e-12), strict=True):
                area[everyday_name((red, green, blue))] += float(part)
            ranked = sorted(area.items(), key=lambda item: -item[1])
            colours = [f"{name} ({part:.0%})" for name, part in ranked if part >= MIN_COLOUR_FRACTION] or [
                f"{ranked[0][0]} ({ranked[0][1]:.0%})"
            ]
            asked = self.asked.manner.replace("grey", "gray").split(" or ")
            yes = self.asked.yes(ranked[0][0] in asked[0].split()) if len(asked) == 1 else ""
            sentences.append(_polar(yes, f"{thing.name} is {' and '.join(colours)}."))
        return " ".join(sentences)

    def _count(self) -> str:
        """Return how many of each kind there are in the clip; where a time is asked about, at its start."""
        sentences = []
        posed, camera = self.scene.posed(float(self.times[0])), self.scene.cameras.at(float(self.times[0]))
        for thing in self.things:
            rows = thing.rows[posed.opacities[thing.rows] >= VISIBLE] if self.asked.span else thing.rows
            known = single_people(self.scene, rows)
            owner, _ = split_objects(posed, rows, known)
            touching = "; those that touch count as one" if known is None else ""
            middles = [
                camera.project(np.median(posed.means[rows[owner == n]], 0)[None].astype(float))[0][0, 0]
                for n in np.unique(owner)
            ]
            if self.asked.side:
                middles = [x for x in middles if (x < camera.width / 2) == (self.asked.side == "left")]
            when = f" {self._at(0)}" if self.asked.span or self.asked.side else ""
            there = f"{thing.name.removeprefix('the ')}: {len(middles)} separate in the scene{when}{touching}."
            sentences.append(_polar(self.asked.yes(len(middles) >= self.asked.at_least), there))
            if self.asked.manner:
                sentences.append(f"Whether they are {self.asked.manner} I cannot tell.")
        return " ".join(sentences)

    def _moving(self) -> str:
        moving = [thing for thing in self.things if self._is_moving(thing)]
        names = ", ".join(thing.name for thing in moving)
        return _polar(
            self.asked.yes(bool(moving)),
            f"{len(moving)} separate {plural('thing', len(moving))} "
            f"{'moves' if len(moving) == 1 else 'move'}{f': {names}' if names else ''}.",
        )

    def _is_moving(self, thing: Measured) -> bool:
        if len(self.times) < 2:
            return thing.moves
        speed = np.linalg.norm(np.diff(thing.centres, axis=0), axis=1) / np.diff(self.times) * self.scene.fps
        return thing.moves and bool(speed.max() > MOVES)

    def _still(self) -> str:
        names = [thing.name for thing in self.things if not self._is_moving(thing)]
        return f"standing still: {', '.join(names) or 'nothing that the scene has a word for'}."

    def _stops(self) -> str:
        moving = self._speeds() >= MOVES
        still = np.flatnonzero(~moving)
        still = still[still >= moving.argmax()]  # before it moves it has not stopped
        if not len(still):
            return _polar(self.asked.yes(False), f"{self.things[0].name} moves all the time.")
        return _polar(self.asked.yes(True), f"{self.things[0].name} stands still {self._at(int(still[0]))}.")

    def _starts(self) -> str:
        """Return the sentence about the order in which things start to move."""
        if len(self.times) < 2:
            raise F4xError("Who starts first needs more than one moment; ask about a span of time.")
        first = [
            (int(np.argmax(self._speeds(n) > MOVES)), one.name)
            for n, one in enumerate(self.things)
            if self._is_moving(one)
        ]
        order = ", then ".join(f"{name} ({self._at(k)[3:]})" for k, name in sorted(first))
        return f"in the order in which they start to move: {order}." if order else "none of them moves."

    def _order(self) -> str:
        if not self.asked.manner:
            return self._starts()
        by, turned = self.asked.manner, self.asked.manner.endswith(("left", "to near", "to front", "to big"))
        name, key = ("from near to far", lambda thing: thing.depth[0])
        if by.endswith(("left", "right")):
            name, key = "from left to right", lambda thing: thing.pixels[0, 0]
        elif by.endswith(("size", "big")):
            name, key = "from big to small", lambda thing: -thing.width
        ranked = sorted(self.things, key=key, reverse=turned)
        names = ", ".join(thing.name for thing in ranked)
        return f"{by if turned else name} {self._at(0)}: {names}."

    def _biggest(self) -> str:
        small = self.asked.manner == "smallest"
        one = (min if small else max)(self.things, key=lambda thing: thing.width)
        return f"the {'smallest' if small else 'biggest'} thing is {one.name}, {one.width:.2f} times the median depth wide."

    def _most_moving(self) -> str:
        ways = {
            t.name: float(np.linalg.norm(np.diff(t.centres, axis=0), axis=1).sum())
            for t in self.things
            if self._is_moving(t)
        }
        if not ways:
            return "nothing moves."
        name = max(ways, key=lambda each: ways[each])
        return f"{name} moves the most: {ways[name]:.2f} times the median depth."


def _polar(yes: str, sentence: str) -> str:
    return f"{yes}: {sentence}" if yes else sentence
