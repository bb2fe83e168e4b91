"""What a sentence did to the Gaussians of a made-up scene, held against what it should do."""

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
from f4x_core.language.grammar import Doubt, Refusal
from f4x_core.query.selection import Selection, fingerprint

DATA = Path(__file__).parents[1] / "data"
EFFECTS, SEALED = DATA / "effects.txt", DATA / "effects_sealed.txt"
LOOKED_AT = (0, 5, 11, 15, 18, 23, 26, 29, 36, 42, FRAMES - 1)
"""Clip frames that are compared."""
CHANGES = {
    "gone": {"gone", "alpha"}, "alpha": {"alpha"}, "shift": {"shift"}, "swap": {"shift"}, "size": {"size"},
    "bigger": {"size"}, "turn": {"turn"}, "blur": {"wide", "alpha"}, "glow": {"copies", "colour"}, "copies": {"copies"},
    "still": {"shift"}, "back": {"shift"}, "speed": {"shift"},
}  # fmt: skip
"""Effect -> the changes that it may show as; all others are changes of color."""
WAYS = {"left": (0, -1), "right": (0, 1), "up": (1, -1), "down": (1, 1), "near": (2, -1), "far": (2, 1)}
REMOVING = re.compile(
    r"remov|delet|hid|eras|gone|get rid|gets? rid|keep only|isolate|fade|vanish|disappear|take out|want to see|\boff\b", re.I
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
    """How the effect of a row differs from what it should be; nothing where it does not."""
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
                if why := seen.lacks(one, float(time), things):
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
    """How the Gaussians `rows` of a thing differ at one time."""

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

    def lacks(self, one, time, things):
        """What is not as it should be."""
        kind, value = one.kind, one.value
        before, after = (rgb.mean(0) for rgb in self.rgb)
        light = after.mean() / before.mean()
        spread = [np.ptp(rgb, 1).mean() for rgb in self.rgb]
        number = float(value) if re.fullmatch(r"[\d.]+", value) else 0.0
        warmth = (after[0] - after[2]) - (before[0] - before[2])
        if kind in ("colour", "tint"):
            goal = np.array(COLOURS[value])
            near = np.linalg.norm(after - goal) / np.linalg.norm(before - goal)
            cosine = (after - before) @ (goal - 0.5) / max(np.linalg.norm(after - before) * np.linalg.norm(goal - 0.5), 1e-9)
            return "" if (near < 0.75 if kind == "colour" else cosine > 0.6 and 0.01 < np.abs(after - before).max() < 0.2) else f"{near:.2f} {after}"
        if kind == "part":
            head = np.flatnonzero(self.base.extra["dynamic/body_part"][self.rows[len(self.base.static) :]] == 1)
            changed = np.abs(self.rgb[1] - self.rgb[0]).max(1) > 0.004
            return "" if set(np.flatnonzero(changed)) == set(head) else "another part"
        if kind == "shift":
            name, _, widths = value.partition("/")
            axis, sign = WAYS[name]
            far = sign * self.step[axis]
            other = np.abs(np.delete(self.step, axis)).max()
            goal = float(widths or 0) * self.size[0]
            rest = np.abs(self.b - self.a - self.step).max()
            return "" if far > 0.02 and other < max(0.2 * far, far if value == "right" else 0) and rest < 1e-3 and (not goal or abs(far / goal - 1) < 0.2) else f"{self.step}"
        if kind == "swap":
            other = next(name for name in one.things if not np.array_equal(things[name], self.rows))
            goal = self._foot(self.base.posed(0.0).means[things[other]].astype(float)) - self._foot(self.base.posed(0.0).means[self.rows].astype(float))
            return "" if np.abs(self.step - goal).max() < 0.1 else f"{self.step} for {goal}"
        if kind in ("still", "back", "speed"):
            last = FRAMES - 1
            place = [self.edited.posed(float(t)).means[: len(self.rows)][self.rows] for t in (15, 36)]
            then = {"back": (last - 15, last - 36), "speed": (number * 15, number * 36)}.get(kind)
            if then is None:
                return "" if np.abs(place[0] - place[1]).max() < 1e-3 else "moves"
            goal = [self.base.posed(float(t)).means[self.rows] for t in then]
            return "" if all(np.abs(a - b).max() < 1e-2 for a, b in zip(place, goal, strict=True)) else "another time"
        checks = {
            "gone": self.alpha < 0.02,
            "alpha": abs(self.alpha / max(number, 1e-9) - 1) < 0.05,
            "size": abs(self.scale / max(number, 1e-9) - 1) < 0.02,
            "bigger": self.scale > 1.05,
            "turn": abs(self.angle - number) < 1,
            "light": abs(light / max(number, 1e-9) - 1) < 0.06,
            "lighter": light > 1.05,
            "darker": light < 0.95,
            "gray": spread[1] < 0.02,
            "sat": abs(spread[1] / max(spread[0], 1e-9) / max(number, 1e-9) - 1) < 0.08,
            "warm": warmth > 0.01,
            "cool": warmth < -0.01,
            "contrast": self.rgb[1].mean(1).std() > 1.05 * self.rgb[0].mean(1).std(),
            "gamma": np.abs(self.rgb[1] - self.rgb[0] ** (1 / max(number, 1e-9))).max() < 0.02,
            "hue": spread[1] > 0.5 * spread[0] and after.argmax() != before.argmax(),
            "blur": self.widths > 1.02,
            "glow": self.copies > 0,
            "copies": abs(self.copies - number) < 1e-6,
        }
        return "" if checks[kind] else f"scale {self.scale:.3f} alpha {self.alpha:.3f} light {light:.3f} angle {self.angle:.1f} rgb {after}"
