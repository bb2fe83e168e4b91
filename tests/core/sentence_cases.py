"""What a sentence of `tests/data` came to: right, refused or wrong, by the slots that its row names."""

from __future__ import annotations

import json
import re
from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from typing import Any

from f4x_core.edit.language import parse
from f4x_core.edit.operation.duplicate import FAINT
from f4x_core.edit.operations import Duplicate, Opacity
from f4x_core.edit.request import Request
from f4x_core.edit.selects import Named
from f4x_core.errors import F4xError
from f4x_core.fit.vocabulary import EVERYDAY
from f4x_core.language.colour_names import COLOURS, SHADES, shaded
from f4x_core.language.lexicon import singular
from f4x_core.language.refusal import Doubt, Slip
from f4x_core.query.wording import read_question

OPENED = Path(__file__).parents[1] / "data" / "sentences_opened.json"
SEALED = OPENED.with_name("sentences_end.json")
FPS, FRAMES = 24.0, 72
AWAY = {
    "left": (0, -1),
    "right": (0, 1),
    "up": (1, -1),
    "down": (1, 1),
    "closer": (2, -1),
    "away": (2, 1),
    "behind": (2, 1),
}
PEOPLE = {"man", "person", "guy", "people", "child", "girl", "boy", "rider", "dancer"}


def rows(path: Path) -> list[dict[str, Any]]:
    """The rows of a file of sentences."""
    return json.loads(path.read_text(encoding="utf-8"))


def verdict(row: dict[str, Any]) -> str:
    """right, refused or wrong."""
    try:
        try:
            ok = _is_meant(row, row["text"])
        except Slip as slip:  # it is mended, and that is said
            meant = row.get("operations") or row.get("questions")  # those of some rows are not told
            ok = row["expect"] != "refuse" and (_is_meant(row, slip.instead) or not meant)
            return "right" if ok else "wrong"
    except Doubt:
        return "right" if row["expect"] == "confirm" else "refused"
    except F4xError as error:
        names = any(op["operation"] in ("undo", "redo") for op in row.get("operations", []))
        if row["expect"] in ("refuse", "confirm") or (names and "f4x" in str(error)):
            return "right"
        return "refused"
    if row["expect"] == "do" or row["category"] in (
        "x_absent",
        "x_q_absent",
    ):  # of a thing that is not there the scene tells
        return "right" if ok else "wrong"
    if row["category"] == "x_destructive":  # which of several is meant, the scene tells
        return "right" if ok and row["operations"][0]["target"] else "wrong"
    return "wrong"


def _is_meant(row: dict[str, Any], text: str) -> bool:
    """Whether what `text` comes to fits the slots of a row; raises F4xError."""
    labels = sorted({*EVERYDAY, *_things(row)})
    if row["kind"] == "ask":
        return _questions_fit(
            row.get("questions", []), read_question(text, FPS, FRAMES, row.get("selected", ""), labels)
        )
    request = Request(text, labels, fps=FPS, frames=FRAMES, selected="selected" in row)
    made = parse(request, earlier=(row.get("after") or [""])[-1], copies=_copies(row, request))
    return _operations_fit(row.get("operations", []), list(made), row)


def _copies(row: dict[str, Any], request: Request) -> dict[Any, Any]:
    """What the sentences before made copies of."""
    done = (one for sentence in row.get("after", ()) for one in parse(replace(request, sentence=sentence)))
    return {Named("copy"): one.select for one in done if isinstance(one, Duplicate)}


def _things(row: dict[str, Any]) -> set[str]:
    found: set[str] = set()
    for slot in (*row.get("operations", []), *row.get("questions", [])):
        for key in ("target", "other", "source", "of"):
            words = slot.get(key)
            for word in [words] if isinstance(words, str) else words or []:
                word = word.removeprefix("all but ")
                if word not in ("all", "background", "moving thing", "the copy", "camera"):
                    found.add(word)
    return found


def _labels(select: Any) -> set[str]:
    """Every label in a selection, in the singular."""
    if isinstance(select, dict):
        return {_one(w) for w in select.get("labels", ())} | _labels(list(select.values()))
    if isinstance(select, list):
        return set().union(*(_labels(part) for part in select)) if select else set()
    return set()


def _one(text: str) -> str:
    *first, last = text.lower().split()
    return " ".join([*first, singular(last)])


def _who_fits(slot: dict[str, Any], select: dict[str, Any], row: dict[str, Any]) -> bool:
    target = slot.get("target")
    by = select["by"]
    if target is None:
        return True
    if isinstance(target, list):
        if by == "and" and select["of"][-1]["by"] == "not":  # "the house and the trees but not the car"
            select = {**select, "of": select["of"][:-1]}
        return {_one(word) for word in target} == _labels(select)
    if target == "all":
        return by in ("all", "current") if "near" not in slot else by == "beside" and select["of"]["by"] == "all"
    if target == "background":
        spares = select["of"] if by == "not" else {}  # "and leave the car sharp" may be said beside it
        return any(
            one.get("by") == "moving" for one in (spares, *(spares.get("of", ()) if spares.get("by") == "or" else ()))
        )
    if target == "moving thing":
        return "moving" in json.dumps(select)
    if by == "named":
        return target == "the copy" or target.lower() == select["name"].lower()
    if target == "the copy":
        return False
    if target.startswith("all but "):
        spared = row.get("selected") if by == "not" and select["of"]["by"] == "current" else None
        return by == "not" and (spared == target[8:] or _labels(select) == {_one(target[8:])})
    if by == "current":
        return row.get("selected") == target
    if "which" in slot:
        nearest = {"back": "farthest", "front": "nearest", "closest": "nearest", "biggest": "largest"}.get(
            slot["which"], slot["which"]
        )
        if by != "instance" or select["which"] not in (nearest, slot["which"]):
            return False
    if "part" in slot and by != "part":
        return False
    near_to = slot.get("near")
    if near_to and by != "beside":
        return False
    if near_to and _one(next(iter(near_to.values())) if isinstance(near_to, dict) else near_to) not in _labels(
        select["other"]
    ):
        return False
    found = _labels(select)
    wanted = _one(target)
    if slot.get("with_shadow") and not any("shadow" in label for label in found):
        return False
    if slot.get("colour_is") and slot["colour_is"] not in json.dumps(select) and found != {wanted}:
        return False
    if "of" in slot:
        return any(wanted.split()[-1] in label.split() for label in found)
    main = {label for label in found if "shadow" not in label or "shadow" in wanted}
    near = {"people", "person", "man", "guy"}
    if {"he", "she", "him", "her"} & set(row["text"].lower().split()):
        near |= {"woman", *PEOPLE}
    return any(wanted in label or label in wanted for label in main) or bool(main and main <= near and wanted in near)


def _span_fits(span: dict[str, Any] | None, op: dict[str, Any], which: str = "span") -> bool:
    last = FRAMES - 1
    if which == "at":
        frames: list[Any] = [op.get("at"), op.get("until")]
    else:
        frames = op.get("frames")
    if span is None:
        return frames is None
    if frames is None:
        part = span.get("part")
        return part == [0, 1]
    a, b = frames[0], last if frames[1] is None or op.get("ease") == "step" else frames[1]
    if "loose" in span and "part" in span:
        first, final = (x * FRAMES for x in span["part"])
        return (abs(a - first) <= 18 and abs(b - final) <= 18) and b - a > 2
    lo: Any
    hi: Any
    if "seconds" in span:
        pair = span["seconds"]
        lo, hi = (pair, None) if not isinstance(pair, list) else pair
        lo, hi = lo * FPS, None if hi is None else hi * FPS
    elif "frames" in span:
        pair = span["frames"]
        lo, hi = (pair, None) if not isinstance(pair, list) else pair
    elif "part" in span:
        pair = span["part"]
        lo, hi = (pair, None) if not isinstance(pair, list) else pair
        lo, hi = lo * FRAMES, None if hi is None else hi * FRAMES
    elif "last_seconds" in span:
        lo, hi = FRAMES - span["last_seconds"] * FPS, None
    elif "last_frames" in span:
        lo, hi = FRAMES - span["last_frames"], None
    elif "middle_seconds" in span:
        half = span["middle_seconds"] * FPS / 2
        lo, hi = FRAMES / 2 - half, FRAMES / 2 + half
    elif "seconds_before_end" in span:
        lo, hi = FRAMES - span["seconds_before_end"] * FPS, None
    else:
        lo, hi = (None if code is None else _timecode(code) for code in span["timecode"])
    if which == "at":
        return abs(a - lo) <= 1
    if "loose" in span:
        return abs(a - lo) <= 13 and abs(b - (last if hi is None else hi)) <= 13
    return abs(a - lo) <= 1 and abs(b - (last if hi is None else hi)) <= 1


def _timecode(code: str) -> float:
    """Clip frame of hours:minutes:seconds:frames."""
    hours, minutes, seconds, frames = map(int, code.split(":"))
    return (3600 * hours + 60 * minutes + seconds) * FPS + frames


def _amount_fits(wanted: Any, value: float) -> bool:
    if wanted in ("up", "down"):
        return value > 1 if wanted == "up" else value < 1
    return abs(value - wanted) < 0.02


_NAMES = {"brightness", "contrast", "saturation", "warmth"}


def _operation_fits(slot: dict[str, Any], made: dict[str, Any], row: dict[str, Any]) -> bool:
    kind, op = slot["operation"], made["op"]
    if op == "take_back":
        return kind == "undo"
    amount = slot.get("factor", slot.get("change"))
    select = made["select"]
    ok = False
    if kind in ("delete", "opacity") and slot.get("factor", 0) == 0 and "change" not in slot:
        ok = op == "delete" or (
            op == "opacity" and made["factor"] == 0 and made.get("inward", False) == slot.get("inward", False)
        )
        if op == "extract" and slot.get("target") == "background":
            return True
    elif kind == "opacity":  # "a bit see-through" and 40 % are both less of it
        ok = op == "opacity" and _amount_fits(amount, made["factor"])
    elif kind == "extract":
        ok = op == "extract"
        if (op == "delete" or (op == "opacity" and not made["factor"])) and select[
            "by"
        ] == "not":  # nothing else is seen
            ok, select = True, select["of"]
    elif kind == "recolour":
        spelled = slot["colour"].replace("grey", "gray")
        named = COLOURS.get(spelled.replace(" ", ""))
        if named is None and not spelled.startswith("#"):
            shade, base = spelled.split()
            named = shaded(shade, COLOURS[base]) if shade in SHADES else COLOURS[base]
        if op == "recolour":
            mode = made.get("mode", "assign")
            if mode == "add":  # redder, or less red
                sense = {"slight": 1, "less": -1}.get(slot.get("strength", ""), 0)
                ok = sum(a * (b - 0.5) for a, b in zip(made["rgb"], named or (), strict=True)) * sense > 0
            elif slot.get("strength") == "less":
                ok = False
            else:
                ok = named is None or max(abs(a - b) for a, b in zip(named, made["rgb"], strict=True)) < 0.2
            if slot.get("strength") == "slight":
                ok = ok and (mode == "add" or made.get("strength", 1) < 1)
    elif kind == "brightness":
        ok = op == "recolour" and made.get("mode") in ("multiply", "light") and _amount_fits(amount, made["rgb"][0])
    elif kind == "saturation":
        gray = op == "recolour" and made.get("mode") == "hue"
        ok = (gray and amount in (0, "down")) or (op == "grade" and _amount_fits(amount, made.get("saturation", 1)))
    elif kind == "contrast":
        ok = op == "grade" and _amount_fits(amount, made.get("contrast", 1))
    elif kind == "warmth":
        ok = op == "grade" and _amount_fits(amount, 1 + made.get("warmth", 0))
    elif kind in ("blur", "glow"):
        ok = op == kind
        if ok and "colour" in slot:
            ok = tuple(made["rgb"] or ()) == COLOURS[slot["colour"]]
    elif kind == "transform":
        ok = op == "transform" and _transform_fits(slot, made)
    elif kind in ("duplicate", "follow"):
        ok = op == "duplicate" and (made.get("count", 1) == slot["count"] if "count" in slot else True)
        lag = slot.get("lag")
        if lag is not None:
            ok = ok and abs(made.get("time_shift", 0) - (lag["frames"] if isinstance(lag, dict) else lag * FPS)) <= 1
        elif kind == "follow":
            ok = ok and made.get("time_shift", 0) > 0
        way = made.get("offset", [0, 0, 0])
        ok = ok and _place_fits(slot.get("direction"), way, made, behind_ok=made.get("time_shift", 0) > 0)
        if "by" in slot:
            ok = ok and abs(max(map(abs, made["offset"])) - slot["by"]["amount"]) < 0.01
    elif kind == "freeze":
        ok = op == "freeze"
        return ok and _who_fits(slot, select, row) and (("at" not in slot) or _span_fits(slot["at"], made, "at"))
    elif kind in ("retime", "stretch"):
        ok = op == "retime"
        if ok and "speed" in slot:
            ok = _amount_fits(slot["speed"], made["speed"])
        if ok and "to_seconds" in slot:
            a, b = slot.get("span", {"seconds": [0, FRAMES / FPS]})["seconds"]
            ok = _amount_fits((b - a) / slot["to_seconds"], made["speed"])
            if "span" in slot:  # all of it is shown, in its new length
                slot = {**slot, "span": {"seconds": [a, a + slot["to_seconds"]]}}
        if ok and kind == "stretch" and "factor" in slot:
            ok = _amount_fits(1 / slot["factor"], made["speed"])
        if ok and slot.get("ease") == "smooth":
            ok = made.get("ease") is not None
        if ok and "span" not in slot and made.get("frames") in (None, [0.0, None]):
            return ok and _who_fits(slot, select, row)
    elif kind == "style":
        ok = (op == "style" and made["look"] == slot["look"]) or (
            op == "recolour" and tuple(made["rgb"]) == COLOURS.get(slot["look"])
        )
    elif kind == "match":
        ok = op == "match" and _one(slot["source"]) in _labels(made["source"])
    elif kind == "swap":
        ok = op == "swap" and (
            any(_one(slot["other"]) in label for label in _labels(made["other"])) or slot.get("plural", False)
        )
    else:
        ok = op == kind
    if op == "swap" and slot.get("plural"):
        return ok
    if not ok or not _who_fits(slot, select, row):
        return False
    if slot.get("ease") == "any" and op == "opacity" and not made.get("ease"):
        return False
    if op == "duplicate":
        return True
    if "at" in slot:
        return made.get("frames") is not None and _span_fits(slot["at"], {"at": made["frames"][0]}, "at")
    if "span" not in slot:
        return made.get("frames") is None or ("ease" in slot and made["frames"] == [0.0, None])
    return _span_fits(slot.get("span"), made)


_PLACES = {"behind": "behind", "in front of": "closer", "left of": "left", "right of": "right", "above": "up", "on": "up",
           "below": "down", "under": "down", "next to": "any", "near": "any", "closer to": "any", "to": "any", "beside": "any",
           "towards": "any"}  # fmt: skip


def _place_fits(wanted: str | None, vector: list[float], made: dict[str, Any], behind_ok: bool = False) -> bool:
    """As `_way_fits`, for "behind bush" too, where the operation names the bush; of itself it is a way."""
    for words in sorted(_PLACES, key=len, reverse=True):
        if wanted and wanted.startswith(words + " "):
            other = _one(wanted.removeprefix(words + " "))
            itself = "beside" not in made and other in _labels(made["select"]) | {"it"}
            if not itself and other not in _labels(made.get("beside")):
                return False
            return _PLACES[words] == "any" or _way_fits(_PLACES[words], vector, behind_ok)
    return "beside" not in made and _way_fits(wanted, vector, behind_ok)


def _way_fits(wanted: str | None, vector: list[float], behind_ok: bool = False) -> bool:
    if wanted in (None, "any"):
        return wanted is None or any(vector)
    if wanted == "behind" and behind_ok:
        return True
    if wanted not in AWAY:
        return False
    axis, sign = AWAY[wanted]
    axis = {0: 0, 1: 1, 2: 2}[axis]
    return vector[axis] * sign > 0


def _transform_fits(slot: dict[str, Any], made: dict[str, Any]) -> bool:
    if "scale" in slot and not _amount_fits(slot["scale"], made.get("scale", 1)):
        return False
    if "translate" in slot:
        move = made.get("translate", [0, 0, 0])
        if not _place_fits(slot["translate"].get("direction"), move, made):
            return False
        if "amount" in slot["translate"] and abs(max(map(abs, move)) - slot["translate"]["amount"]) > 0.01:
            return False
    if "rotate" in slot:
        turn = made.get("rotate", [0, 0, 0])
        degrees, sense = slot["rotate"].get("degrees", "any"), slot["rotate"].get("sense", "any")
        if not any(turn) or (isinstance(degrees, (int, float)) and abs(max(map(abs, turn)) - degrees) > 1):
            return False
        if sense == "left" and turn[1] >= 0 and turn[2] >= 0:
            return False
        if sense == "right" and turn[1] <= 0 and turn[2] <= 0:
            return False
    return "pivot" not in slot or made.get("pivot") == slot["pivot"]


def _apart(slot: dict[str, Any]) -> list[dict[str, Any]]:
    """A transform with two parts as two."""
    parts = [key for key in ("scale", "translate", "rotate") if key in slot]
    if len(parts) < 2:
        return [slot]
    return [{key: value for key, value in slot.items() if key not in parts or key == part} for part in parts]


def _operations_fit(wanted: list[dict[str, Any]], made: list[Any], row: dict[str, Any]) -> bool:
    if re.search(r"\bghost|after-?image", row["text"], re.IGNORECASE):  # its copies may be seen through
        copies = Named("copy")
        made = [one for one in made if not (isinstance(one, Opacity) and one.select == copies and one.factor == FAINT)]
    records = [one.to_json() for one in made]
    merged = [slot for slot in wanted if not (slot["operation"] == "recolour" and slot.get("target") is None)]
    if len(merged) < len(records):  # a size and a place may be one transform or two
        merged = [one for slot in merged for one in _apart(slot)]
    if len(merged) != len(records):
        return False
    for one, later in pairwise(records):  # blue until it is red is blue, then red
        if (
            one["op"] == later["op"]
            and one["select"] == later["select"]
            and not one.get("frames")
            and later.get("frames")
        ):
            one["frames"] = [0, later["frames"][0]] if any("span" in slot for slot in merged[:-1]) else None
    left = list(records)
    for slot in merged:
        fitting = next((one for one in left if _operation_fits(slot, one, row)), None)
        if fitting is None:
            return False
        left.remove(fitting)
    return True


KINDS = {
    "when_moves": {"motion"}, "moving": {"motion"}, "happens": {"happens", "things", "motion", "does"}, "list": {"things"},
    "duration": {"long", "frames"}, "when_visible": {"seen", "always", "seeing", "enter", "leave"}, "direction": {"way"},
    "travelled": {"far"}, "speed": {"fast"}, "present": {"seen"}, "when_stops": {"motion", "stops"},
    "moves": {"motion", "stops"}, "where": {"where", "side"}, "still": {"still", "motion"},
}  # fmt: skip


def _questions_fit(wanted: list[dict[str, Any]], asked: Any) -> bool:
    if len(wanted) != len(asked):
        return False
    for slot, one in zip(wanted, asked, strict=True):
        kinds = KINDS.get(slot["question"], {slot["question"]})
        if slot["question"] == "duration" and slot.get("target"):  # of a thing, not of the clip
            kinds = {"seeing", "lasting"}
        if one.kind not in kinds or (slot["question"] == "still" and one.kind == "motion" and not one.negated):
            return False
        things = {_one(thing) for thing in one.things}
        for key in ("target", "other"):
            words = slot.get(key)
            for word in [words] if isinstance(words, str) else words or []:
                if word == "camera" or word in PEOPLE:
                    continue
                if not any(_one(word).split()[-1] in thing.split() for thing in things):
                    return False
        if "extreme" in slot and one.extreme != slot["extreme"]:
            return False
        if not slot.get("target") and "time" not in slot and one.span is not None:
            return False
        if "time" in slot:
            if one.span is None:
                return False
            frames = {"frames": [one.span[0], one.span[1]], "at": one.span[0]}
            pair = next(iter(slot["time"].values()))
            if not _span_fits(slot["time"], frames, "span" if isinstance(pair, list) else "at"):
                return False
    return True
