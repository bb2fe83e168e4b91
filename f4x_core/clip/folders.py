"""The files of a folder that are frames: no masks beside them, no files of other kinds, and no frame twice."""

from __future__ import annotations

import filecmp
import re
from collections import Counter
from collections.abc import Sequence
from functools import lru_cache
from pathlib import Path
from typing import NamedTuple

import numpy as np

from ..errors import F4xError
from ..geometry.arrays import evenly_spaced
from ..language.lexicon import plural
from .clock import Shown
from .images import SUFFIXES, is_deep, natural_key, open_undecoded, read_deep, read_picture, resize_color
from .notes import Note
from .pixels import WHITE, white_of
from .repeats import without_repeats

FILMS = {".mp4", ".mov", ".m4v", ".avi", ".mkv", ".webm", ".mts", ".m2ts", ".gif"}
"""Endings of films: they take no place between the pictures of a folder."""
RAW = {".dng", ".cr2", ".cr3", ".nef", ".arw", ".raf", ".orf", ".rw2", ".pef", ".srw", ".raw"}
"""Endings of what cameras write before they make pictures of it."""
UNREAD = {
    ".heic",
    ".heif",
    ".avif",
    ".jxl",
    ".jp2",
    ".j2k",
    ".exr",
    ".hdr",
    ".dpx",
    ".cin",
    ".tga",
    ".psd",
    ".ppm",
    ".pgm",
}
"""Endings of other pictures that are not read as frames."""
OTHERS = FILMS | RAW | UNREAD
MASK_WORDS = {"mask", "masks", "matte", "mattes", "alpha", "seg", "segmentation", "label", "labels", "annotation"}
MAP_WORDS = {"depth", "disparity", "disp", "normal", "normals", "flow", "thumb", "thumbnail", "confidence", "conf"}
"""Words in the names of pictures that belong to another one and are no masks."""
COLOUR_WORDS = {"rgb", "color", "colour", "image", "img", "frame", "picture", "pic", "photo"}
"""Words that tell nothing."""
MIN_NUMBERED = 3
"""Pictures whose names differ by numbers alone, from which they are a sequence."""
HEXADECIMAL = re.compile("[0-9a-fA-F]+")
LOOKS = 12
"""Pictures, evenly over the folder, that tell whether there are such of 16 bits; where these are dark, all are looked at."""
SHALLOW = {"1", "L", "LA", "P", "PA", "RGB", "RGBA", "CMYK", "YCbCr"}
"""Modes of PIL whose values convert to 8 bits without a scale."""
LOOK_WIDTH = 640
"""Pixels of the pictures in which repeats are looked for."""


class Frames(NamedTuple):
    """The pictures of a folder that are frames."""

    images: list[Path]
    masks: list[Path]
    """Beside them, one for each, or none."""
    places: np.ndarray
    """(T,) int64 places among all pictures, those that cannot be read included."""
    notes: tuple[Note, ...]


def frames_in(folder: Path) -> Frames:
    """Return the frames directly in `folder`, numbers in their names sorted by value; none if no folder."""
    if not folder.is_dir():
        return Frames([], [], np.zeros(0, np.int64), ())
    files = sorted(
        (file for file in folder.iterdir() if not file.name.startswith(".") and file.is_file()),
        key=lambda file: natural_key(file.name),
    )
    images = [file for file in files if file.suffix.lower() in SUFFIXES]
    images, strangers = _numbered(images)
    images, masks, notes = _without_companions(images)
    if strangers:
        count = len(strangers)
        are = "is no frame" if count == 1 else "are no frames"
        notes.append(
            _told(f"{count} {plural('picture', count)} like {strangers[0].name} {are} by the name, and left out.")
        )
    others = [file for file in files if file.suffix.lower() in OTHERS]
    stems = {file.stem for file in images}
    unread = [file for file in others if file.suffix.lower() not in FILMS and file.stem not in stems]
    order = sorted([*images, *unread], key=lambda file: natural_key(file.name))
    place = {file: index for index, file in enumerate(order)}
    places = np.array([place[file] for file in images], np.int64)
    if images and others:
        kinds = Counter(file.suffix for file in others)
        listed = ", ".join(f"{number} {kind}" for kind, number in kinds.items())
        gaps = " The pictures around them keep their times." if (np.diff(places) > 1).any() else ""
        files_are = "file is" if len(others) == 1 else "files are"
        notes.append(_told(f"{listed} {files_are} not read as frames.{gaps}"))
    return Frames(images, masks, places, tuple(notes))


def why_unreadable(folder: Path) -> str:
    """Return advice for a folder with images or films and no readable frame; empty where it has neither."""
    files = folder.iterdir() if folder.is_dir() else ()
    kinds = {file.suffix.lower() for file in files if not file.name.startswith(".")} & OTHERS
    listed = ", ".join(sorted(kinds))
    if not kinds:
        return ""
    if kinds <= FILMS:
        return f"{folder} holds films ({listed}) and no pictures; give one of the files"
    return f"{folder} holds only {listed} files, which are not read as frames; convert them to JPEG or PNG"


def _told(sentence: str) -> Note:
    return Note("source", 0, text=sentence)


def _without_companions(files: list[Path]) -> tuple[list[Path], list[Path], list[Note]]:
    """Return the frames among picture `files`, the masks of all of them or none, and what is left out.

    A companion has a word like `mask` in its name and belongs to a picture whose name has none, or it has the name of another
    picture and a second ending.
    """
    names = {file.name for file in files}
    roles = {file: _role(file, names) for file in files}
    keys = {key for key, words in roles.values() if not words}
    beside = [file for file in files if roles[file][1] and roles[file][0] in keys]
    frames = [file for file in files if file not in set(beside)]
    frames, twice = _one_kind(frames)
    masks = {roles[file][0]: file for file in beside if roles[file][1] <= MASK_WORDS}
    own = [masks[key] for file in frames if (key := roles[file][0]) in masks]
    complete = bool(frames) and len(own) == len(frames)
    notes = []
    if beside:
        count = len(beside)
        use = "; --masks layout uses them as masks" if complete else ""
        notes.append(
            _told(f"{count} {plural('picture', count)} like {beside[0].name} belong to others and are no frames{use}.")
        )
    if twice:
        kinds, count = ", ".join(sorted({file.suffix for file in twice})), len(twice)
        kept = f"the name of another with the ending {frames[0].suffix}"
        notes.append(_told(f"{count} {plural('picture', count)} ({kinds}) have {kept}, and are left out."))
    return frames, own if complete else [], notes


def _numbered(files: list[Path]) -> tuple[list[Path], list[Path]]:
    """Return the picture `files` without those that are none of a numbered sequence beside them, and these.

    Such are variants of one of the sequence, whose name goes on with a word or whose copy they are, and pictures without a
    number. Files stay where no pattern of names is that of at least half of them.
    """
    patterns = {file: re.sub(r"\d+", "#", file.stem.lower()) for file in files}
    counts = Counter(patterns.values())
    main = max(counts, key=lambda each: (counts[each], -len(each)), default="")
    if "#" not in main or counts[main] < MIN_NUMBERED or 2 * counts[main] < len(files):
        return files, []
    sequence = {file.stem: file for file in files if patterns[file] == main}
    known = MASK_WORDS | MAP_WORDS

    def stranger(file: Path) -> bool:
        pattern = patterns[file]
        if pattern == main or set(re.findall("[a-z]+", pattern)) & known or HEXADECIMAL.fullmatch(file.stem):
            return False
        if not re.search(r"\d", file.stem):
            return not main.startswith(pattern)
        begins = (file.stem[:length] for length in range(len(file.stem), 0, -1))
        original = next((sequence[begin] for begin in begins if begin in sequence), None)
        if original is None:
            return False
        rest = file.stem.removeprefix(original.stem)
        return bool(re.match(r"[^\d.].*[^\W\d_]", rest)) or filecmp.cmp(file, original, shallow=False)

    others = [file for file in files if stranger(file)]
    return [file for file in files if file not in set(others)], others


def _role(file: Path, names: set[str]) -> tuple[tuple[str | int, ...], frozenset[str]]:
    """Return the picture that a file belongs to, as the words and numbers of its name, and the words that make it a companion."""
    stem = file.stem
    words = re.findall(r"[a-z]+|\d+", stem.lower())
    marks = {word for word in words if word in MASK_WORDS | MAP_WORDS}
    if stem in names:  # 0001.jpg.png
        marks.add("mask")
        words = re.findall(r"[a-z]+|\d+", Path(stem).stem.lower())
    key = tuple(int(word) if word.isdigit() else word for word in words if word not in marks | COLOUR_WORDS)
    return key, frozenset(marks)


def _one_kind(files: list[Path]) -> tuple[list[Path], list[Path]]:
    """Return `files` with one for each stem, of the ending that most of those in doubt have first; and the others."""
    by_stem: dict[str, list[Path]] = {}
    for file in files:
        by_stem.setdefault(file.stem, []).append(file)
    if len(by_stem) == len(files):
        return files, []
    common = Counter(file.suffix for file in files)

    def rank(file: Path) -> tuple[int, bool]:
        return common[file.suffix], file.suffix.lower() in (".jpg", ".jpeg")

    kept = {max(same, key=rank) for same in by_stem.values()}
    return [file for file in files if file in kept], [file for file in files if file not in kept]


class Review(NamedTuple):
    """Facts that only the pixels of the pictures tell."""

    kept: np.ndarray
    """(K,) int64 rows of those that do not repeat the one before."""
    white: int
    """The value of white in 16 bits."""
    notes: tuple[Note, ...]


def review(files: Sequence[Path], repeats: bool = True) -> Review:
    """Look at some pictures of a folder for the value of white, and at all for repeats; remembers the last folders."""
    return _review(tuple(files), max((file.stat().st_mtime_ns for file in files), default=0), repeats)


@lru_cache(maxsize=8)
def _review(files: tuple[Path, ...], changed: int, repeats: bool) -> Review:
    white, notes = _white(files)
    if not repeats:
        return Review(np.arange(len(files)), white, tuple(notes))
    small = (_small(row, file, white) for row, file in enumerate(files))
    kept = [shown.number for shown in without_repeats(small, notes)]
    return Review(np.array(kept, np.int64), white, tuple(notes))


def _white(files: tuple[Path, ...]) -> tuple[int, list[Note]]:
    """Return the value of white in 16-bit pictures, and what has to be said of it."""
    largest, kinds = 0, set()
    looks = evenly_spaced(len(files), LOOKS)
    for step, index in enumerate([*looks, *np.setdiff1d(np.arange(len(files)), looks)]):
        if step >= len(looks) and (not largest or white_of(largest) == WHITE):  # the others are of no matter
            break
        deep = read_deep(files[index])
        if deep is None:
            continue
        values = deep.values
        kinds.add(values.dtype.kind)
        if values.dtype == np.uint16:
            largest = max(largest, int(values[..., :3].max() if values.ndim == 3 else values.max()))
    white = white_of(largest) if largest else WHITE
    notes = []
    if white != WHITE:
        bits = white.bit_length()
        notes.append(
            _told(f"The pictures of 16 bits hold no value above {white}, so they are read as those of {bits} bits.")
        )
    if "f" in kinds:
        notes.append(_told("The floating-point pictures are taken for sRGB from 0 to 1, not for linear light."))
    return white, notes


def _small(row: int, file: Path, white: int) -> Shown:
    """Return a picture to compare with others, of one pixel where it cannot be read."""
    from PIL import Image

    try:
        with open_undecoded(file) as image:
            image.draft("RGB", (LOOK_WIDTH, LOOK_WIDTH))  # a JPEG is decoded no larger than wanted
            shallow = image.mode in SHALLOW and not is_deep(image)
            pixels = np.asarray(image.convert("RGB")) if shallow else read_picture(file, white).pixels
    except (F4xError, OSError, ValueError, SyntaxError, Image.DecompressionBombError):
        pixels = np.zeros((1, 1, 3), np.uint8)
    height, width = pixels.shape[:2]
    size = min(LOOK_WIDTH, width), max(1, height * min(LOOK_WIDTH, width) // width)
    return Shown(resize_color(pixels, *size), np.nan, 0.0, row)
