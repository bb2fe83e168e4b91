"""Compare the effect of a sentence on the Gaussians of a made-up scene with the wanted one."""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from effect_scenes import FRAMES, effect_scene

from f4x_core.edit import plan
from f4x_core.edit.resolve import EditorState
from f4x_core.errors import F4xError
from f4x_core.geometry import spherical_harmonics
from f4x_core.language.colour_names import COLOURS
from f4x_core.language.refusal import Doubt
from f4x_core.query.selection import Selection, fingerprint
from f4x_core.scene.color import linear_from_srgb

DATA = Path(__file__).parents[1] / "data"
EFFECTS, SEALED = DATA / "effects.txt", DATA / "effects_sealed.txt"
LOOKED_AT = (0, 5, 11, 15, 18, 23, 26, 29, 36, 42, FRAMES - 1)
"""Clip frames that are compared."""
CHANGES = {
    "gone": {"gone", "alpha"}, "alpha": {"alpha"}, "shift": {"shift"}, "swap": {"shift"}, "size": {"size"},
    "bigger": {"size"}, "turn": {"turn"}, "blur": {"wide", "alpha"}, "glow": {"copies", "colour"}, "copies": {"copies"},
    "still": {"shift"}, "back": {"shift"}, "speed": {"shift"}, "late": {"shift"},
}  # fmt: skip
"""Effect -> the changes that it may show as; all others are changes of color."""
WAYS = {"left": (0, -1), "right": (0, 1), "up": (1, -1), "down": (1, 1), "near": (2, -1), "far": (2, 1)}
REMOVING = re.compile(
    r"remov|delet|hid|eras|gone|get rid|gets? rid|keep only|isolate|fade|vanish|disappear|take out|want to see|\boff\b",
    re.I,
)
"""Words of sentences, and of what is offered instead, with which something would be gone."""


@dataclass(frozen=True)
class Effect:
    """One thing that a sentence should do."""

    kind: str
    things: tuple[str, ...]
    """Names of things; "floor>car" is the floor behind the car, with < in front, [ to the left and ] to the right of it."""
    value: str
    start: float
    end: float
    """In effect from … to."""
    ramp: bool
    """It comes between the two and stays."""


def read(path):
    """(scene, selected thing or "", sentence, what should happen) of each row of a file."""
    rows = re.findall(r"^(\w+)(?:\[(\w+)\])?: (.+) => (.+)$", path.read_text(encoding="utf-8"), re.M)
    return [(scene, selected, sentence, expected) for scene, selected, sentence, expected in rows]


def effects_of(expected):
    """The effects of a row."""
    for clause in expected.split("; "):
        kind, *words = clause.split()
        start, end, ramp = 0.0, float(FRAMES), False
        if words[-1].startswith("@"):
            first, sign, last = re.fullmatch(r"@(\d+)([-~])(\d*)", words.pop()).groups()
            start, end, ramp = float(first), float(last or FRAMES), sign == "~"
        names = [word for word in words if word[0].isalpha() and re.split(r"[][<>]", word)[0] in _NAMES]
        yield Effect(kind, tuple(names), " ".join(w for w in words if w not in names), start, end, ramp)


_NAMES = {name for scene in ("street", "crowd", "room") for name in effect_scene(scene)[1]}


def propose(scene, selected, sentence):
    """The proposal for a sentence, or the error that it raises."""
    whole, things = effect_scene(scene)
    chosen = None
    if selected:
        scores = things[selected].astype(float)
        chosen = Selection(whole.ids, scores, np.zeros(len(scores), bool), label=selected, scene=fingerprint(whole))
    try:
        return plan.propose(whole, sentence, EditorState(chosen, 0.0))
    except F4xError as error:
        return error


def fault(row):
    """Return the difference between the effect of a row and the wanted one in words; "" where there is none."""
    scene, selected, sentence, expected = row
    found = propose(scene, selected, sentence)
    kind, *words = expected.split()
    if isinstance(found, F4xError):
        offered = [found.instead] if isinstance(found, Doubt) else list(getattr(found, "nearest", ()))
        if not REMOVING.search(sentence) and any(map(REMOVING.search, offered)):
            return f"offers {offered}"
        lacking = [word for word in words if word not in str(found)] if kind in ("asks", "refuses") else [kind]
        return f"{type(found).__name__}: {found}" if lacking else ""
    if kind in ("asks", "refuses"):
        return "does " + "; ".join(map(plan.describe, found.chosen.operations))
    return _differs(scene, plan.preview(effect_scene(scene)[0], found.chosen), [*effects_of(expected)])


def _differs(scene, edited, effects):
    """The first change that is too much, wrong or missing."""
    base, things = effect_scene(scene)
    if effects[0].kind == "whole":
        a, b = (one.posed(0.0).means.astype(float) for one in (base, edited))
        same = np.allclose(b - b.mean(0), float(effects[0].value) * (a - a.mean(0)), atol=1e-3)
        return "" if same else "not scaled as one"
    groups = _groups(base, things, effects)
    for time in LOOKED_AT:
        before, after = base.posed(float(time)), edited.posed(float(time))
        for name, rows, asked in groups:
            live = [one for one in asked if one.start <= time <= one.end or (one.ramp and time > one.end)]
            if any(one.ramp and one.start <= time < one.end for one in live) or any(
                time == one.end or time == one.start > 0 for one in asked
            ):
                continue
            seen = Seen(base, edited, before, after, rows)
            allowed = set().union(*(CHANGES.get(one.kind, {"colour"}) for one in live))
            if extra := {kind for kind in seen.changes if kind not in allowed}:
                return f"{name} at {time}: {sorted(extra)}"
            for one in live:
                if why := seen.lacks(one, things):
                    return f"{name} at {time}: {one.kind} {one.value}: {why}"
    return ""


def _groups(base, things, effects):
    """(name, rows, effects) of each thing, and of each clearly told part of a surface."""
    groups = []
    for name, rows in things.items():
        whole = [one for one in effects if name in one.things]
        split = [(word, one) for one in effects for word in one.things if re.fullmatch(rf"{name}[][<>]\w+", word)]
        if not split:
            groups.append((name, rows, whole))
        for word, one in split:
            inside, outside = _sides(base, things, rows, word)
            groups += [(word, inside, [one]), (f"not {word}", outside, [])]
    return groups


def _sides(base, things, rows, word):
    """Rows that lie surely so, and surely not: (N,) bool each."""
    sign, other = re.search(r"([][<>])(\w+)", word).groups()
    means = base.posed(0.0).means
    pixels, depth = base.cameras.at(0.0).project(means)
    keys = [depth] if sign in "<>" else [means[:, 0], pixels[:, 0]]
    whose = things[other]
    low = np.logical_and.reduce([key < key[whose].min() - 0.06 for key in keys])
    high = np.logical_and.reduce([key > key[whose].max() + 0.06 for key in keys])
    return (rows & low, rows & high) if sign in "<[" else (rows & high, rows & low)


class Seen:
    """Differences of the Gaussians `rows` of a thing at one time."""

    def __init__(self, base, edited, before, after, rows):
        self.base, self.edited, self.rows = base, edited, rows
        index = np.flatnonzero(rows)
        self.a, self.b = before.means[index].astype(float), after.means[index].astype(float)
        self.rgb = [0.5 + spherical_harmonics.C0 * one.sh[index, 0] for one in (before, after)]
        opacity = [one.opacities[index].astype(float) for one in (before, after)]
        self.alpha = opacity[1].sum() / opacity[0].sum()
        spread = [np.sqrt(((p - p.mean(0)) ** 2).sum(1).mean()) for p in (self.a, self.b)]
        self.scale = spread[1] / spread[0]
        self.widths = (after.scales[index] / before.scales[index]).mean()
        dot = np.abs((before.quats[index] * after.quats[index]).sum(1)).clip(0, 1)
        self.angle = float(np.degrees(2 * np.arccos(np.median(dot))))
        self.size = np.ptp(self.a, axis=0)
        middle, foot = np.median(self.b, 0) - np.median(self.a, 0), self._foot(self.b) - self._foot(self.a)
        self.step = foot if abs(self.scale - 1) > 0.01 else middle
        origin = getattr(edited, "origin", np.arange(len(base.ids)))[len(base.ids) :]
        self.copies = np.isin(origin, index).sum() / max(len(index), 1)

    @staticmethod
    def _foot(points):
        foot = np.median(points, 0)
        foot[1] = np.percentile(points[:, 1], 98)
        return foot

    @property
    def changes(self):
        """Kinds of what changed."""
        found = {"alpha": abs(self.alpha - 1) > 0.02, "gone": self.alpha < 0.02, "size": abs(self.scale - 1) > 0.01}
        found["shift"] = np.abs(self.step).max() > 0.02 + 0.1 * (self.angle > 1) * self.size.max()
        found["turn"], found["wide"] = self.angle > 1, abs(self.widths / self.scale - 1) > 0.02
        found["colour"], found["copies"] = np.abs(self.rgb[1] - self.rgb[0]).max() > 0.004, self.copies > 0
        return {kind for kind, is_so in found.items() if is_so}

    def lacks(self, one, things):
        """Return what differs from the wanted effect, as numbers; nothing where nothing does."""
        number = float(one.value) if re.fullmatch(r"[\d.]+", one.value) else 0.0
        before, after = (rgb.mean(0) for rgb in self.rgb)
        light, spread = after.mean() / before.mean(), [np.ptp(rgb, 1).mean() for rgb in self.rgb]
        warmth = (after[0] - after[2]) - (before[0] - before[2])
        right = {
            "gone": lambda: self.alpha < 0.02,
            "alpha": lambda: _is(self.alpha, number, 0.05),
            "size": lambda: _is(self.scale, number, 0.02),
            "bigger": lambda: self.scale > 1.05,
            "turn": lambda: abs(self.angle - number) < 1,
            "shift": lambda: self._goes(one.value),
            "swap": lambda: self._swaps(one.things, things),
            "colour": lambda: self._is_near(COLOURS[one.value], 0.75),
            "tint": lambda: self._is_tinted(COLOURS[one.value]),
            "part": self._head_alone,
            "light": lambda: _is(light, number, 0.06),
            "radiance": lambda: _is(np.divide(*(linear_from_srgb(rgb).mean() for rgb in self.rgb[::-1])), number, 0.06),
            "lighter": lambda: light > 1.05,
            "darker": lambda: light < 0.95,
            "gray": lambda: spread[1] < 0.02,
            "sat": lambda: _is(spread[1] / max(spread[0], 1e-9), number, 0.08),
            "warm": lambda: warmth > 0.01,
            "cool": lambda: warmth < -0.01,
            "contrast": lambda: self.rgb[1].mean(1).std() > 1.05 * self.rgb[0].mean(1).std(),
            "gamma": lambda: np.abs(self.rgb[1] - self.rgb[0] ** (1 / number)).max() < 0.02,
            "hue": lambda: spread[1] > 0.5 * spread[0] and after.argmax() != before.argmax(),
            "blur": lambda: self.widths > 1.02,
            "glow": lambda: self.copies > 0,
            "copies": lambda: _is(self.copies, number, 1e-6),
            "still": lambda: self._shows(lambda time: None),
            "back": lambda: self._shows(lambda time: FRAMES - 1 - time),
            "speed": lambda: self._shows(lambda time: min(number * time, FRAMES - 1)),
            "late": lambda: self._shows(lambda time: max(time - number, 0)),
        }[one.kind]()
        told = f"size {self.scale:.3f} alpha {self.alpha:.3f} light {light:.3f} turn {self.angle:.1f} step {self.step} rgb {after}"
        return "" if right else told

    def _is_near(self, goal, share):
        """Return True where the mean color has come nearer to another, to this share of the way or less."""
        before, after = (np.linalg.norm(rgb.mean(0) - goal) for rgb in self.rgb)
        return after < share * before

    def _is_tinted(self, goal):
        """Return True where the mean color has gone a little toward another."""
        step, way = self.rgb[1].mean(0) - self.rgb[0].mean(0), np.array(goal) - 0.5
        alike = step @ way / max(np.linalg.norm(step) * np.linalg.norm(way), 1e-9)
        return alike > 0.6 and 0.01 < np.abs(step).max() < 0.2

    def _head_alone(self):
        """Return True where the head of a person, and nothing else of it, has another color."""
        head = self.base.extra["dynamic/body_part"][self.rows[len(self.base.static) :]] == 1
        return np.array_equal(np.abs(self.rgb[1] - self.rgb[0]).max(1) > 0.004, head)

    def _goes(self, value):
        """Return True where all of it went one way: "left", "left/1" for so many widths of it."""
        way, _, widths = value.partition("/")
        axis, sign = WAYS[way]
        far, goal = sign * self.step[axis], float(widths or 0) * self.size[0]
        as_one = np.abs(self.b - self.a - self.step).max() < 1e-3
        straight = (
            way == "right" or np.abs(np.delete(self.step, axis)).max() < 0.2 * far
        )  # beside another is right, too
        return far > 0.02 and as_one and straight and (not goal or _is(far, goal, 0.2))

    def _swaps(self, pair, things):
        """Return True where it stands at the place of the other of a pair."""
        other = next(things[name] for name in pair if not np.array_equal(things[name], self.rows))
        means = self.base.posed(0.0).means.astype(float)
        return np.abs(self.step - self._foot(means[other]) + self._foot(means[self.rows])).max() < 0.1

    def _shows(self, moment):
        """Return True where it stands at two times as it was filmed at `moment` of them; None: as at the other."""
        times = (15.0, 36.0)
        places = [self.edited.posed(time).means[: len(self.rows)][self.rows] for time in times]
        goals = [places[0] if moment(t) is None else self.base.posed(float(moment(t))).means[self.rows] for t in times]
        return all(np.abs(place - goal).max() < 1e-2 for place, goal in zip(places, goals, strict=True))


def _is(value, goal, tolerance):
    return abs(value / goal - 1) < tolerance
