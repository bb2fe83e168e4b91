"""Notes on frames and stamps that were left out, mended or guessed while a source was read, and their sentences."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Literal, NamedTuple

import numpy as np

from ..language.lexicon import plural

Kind = Literal["damaged", "repeated", "resized", "stamp", "unordered", "gap", "source"]

LEAVE_OUT = ("damaged", "repeated")
"""Kinds of notes of frames that are not in the clip."""
LONG_GAP = 8.0
"""Times the usual interval between two frames from which an interval is told."""
NAMED = 8
"""Frames that a sentence names at most."""


class Note(NamedTuple):
    """Note of something that was done at one frame, or to the whole source."""

    kind: Kind
    frame: int
    """Number of the frame among all of the source, with those that are left out; 0 for the whole source."""
    seconds: float = np.nan
    """Time stamp of the event in seconds; NaN = unknown."""
    text: str = ""
    """Text that the sentence of its kind needs; for `source` the sentence itself."""


@dataclass(frozen=True)
class Remark:
    """A sentence about how the clip was read, and what a person can do."""

    what: str
    advice: str = ""

    def __str__(self) -> str:
        """Return both as one text."""
        return f"{self.what} {self.advice}".strip()


def remarks(
    notes: Iterable[Note], numbers: np.ndarray, whole: tuple[bool, bool] = (False, False)
) -> tuple[Remark, ...]:
    """Return a remark for each kind of notes about the clip whose frames have these `numbers (T,)` in the source.

    `whole`: whether the clip begins and ends with the source, so that what was left out there is told. The remarks name clip
    frames: of what was left out, the first frame behind it. A gap where frames were left out is not told again.
    """
    chosen: dict[Kind, list[Note]] = {}
    sources: list[Note] = []
    for note in notes:
        frame = int(np.searchsorted(numbers, note.frame))
        kept = frame < len(numbers) and numbers[frame] == note.frame
        inside = (frame > 0 or whole[0]) and (frame < len(numbers) or whole[1])
        if note.kind == "source":
            sources.append(note)
        elif kept or (inside and note.kind in LEAVE_OUT):
            chosen.setdefault(note.kind, []).append(note._replace(frame=frame))
    left_out = {note.frame for note in chosen.get("damaged", ())}
    if "gap" in chosen:
        chosen["gap"] = [note for note in chosen["gap"] if note.frame not in left_out]
    of_kinds = (SENTENCES[kind](found) for kind, found in chosen.items() if found)
    return (*(Remark(note.text) for note in sources), *of_kinds)


def gaps(times: np.ndarray, fps: float) -> list[Note]:
    """Return the notes of the long intervals between the frames of a clip, shown at `times (T,)` clip frames."""
    steps = np.diff(times)
    if len(steps) < 2:
        return []
    usual = float(np.median(steps))
    return [
        Note("gap", int(index) + 1, float(steps[index]) / fps, f"{steps[index] / usual:.0f}")
        for index in np.flatnonzero(steps > LONG_GAP * usual)
    ]


def _damaged(notes: Sequence[Note]) -> Remark:
    count, stamps = len(notes), sorted(note.seconds for note in notes if np.isfinite(note.seconds))
    when = f" ({stamps[0]:.2f} to {stamps[-1]:.2f} s)" if stamps else ""
    are, they = ("is", "it is") if count == 1 else ("are", "they are")
    return Remark(
        f"{count} {plural('frame', count)} of the film{when} {are} damaged, or needed a damaged one: {they} left out, and the"
        " others keep their times.",
        "Copy the file again from where it was made.",
    )


def _repeated(notes: Sequence[Note]) -> Remark:
    count = len(notes)
    are, they = ("repeats", "it is") if count == 1 else ("repeat", "they are")
    return Remark(
        f"{count} {plural('frame', count)} of the source {are} the one before: {they} left out, and the others keep their"
        " times."
    )


def _resized(notes: Sequence[Note]) -> Remark:
    sizes = ", ".join(dict.fromkeys(note.text for note in notes))
    count, are = len(notes), "is" if len(notes) == 1 else "are"
    return Remark(f"{count} {plural('frame', count)} of another size ({sizes}) {are} scaled to that of the first.")


def _stamp(notes: Sequence[Note]) -> Remark:
    count = len(notes)
    return Remark(
        f"The time {plural('stamp', count)} of {plural('frame', count)} {_named(notes)} {'is' if count == 1 else 'are'} wrong,"
        " and taken from the frames around."
    )


def _unordered(notes: Sequence[Note]) -> Remark:
    return Remark("The time stamps of the film do not increase, so its frames are taken for evenly spaced.")


def _gap(notes: Sequence[Note]) -> Remark:
    longest = max(notes, key=lambda note: note.seconds)
    more = "" if len(notes) == 1 else f", the longest of {len(notes)} such gaps"
    return Remark(
        f"Between frames {longest.frame - 1} and {longest.frame} nothing is shown for {longest.seconds:.1f} s, {longest.text}"
        f" times the usual interval{more}.",
        "How things moved there is a guess: give one side of the gap alone, with --frames.",
    )


def _named(notes: Sequence[Note]) -> str:
    frames = [str(note.frame) for note in notes]
    return ", ".join(frames[:NAMED]) + (" …" if len(frames) > NAMED else "")


SENTENCES = {
    "damaged": _damaged,
    "repeated": _repeated,
    "resized": _resized,
    "stamp": _stamp,
    "unordered": _unordered,
    "gap": _gap,
}
"""Kind of note -> function that makes one remark of all notes of that kind."""
