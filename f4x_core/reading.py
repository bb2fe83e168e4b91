"""Bounded reading of files from elsewhere: a claim is compared with the bytes behind it before memory or time is spent on it.

Readers catch `DAMAGE` and turn it into one sentence. What is refused though it may be honest is called a limit of this program.
"""

from __future__ import annotations

import json
import math
import os
import struct
import tokenize
import zipfile
import zlib
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np

from .errors import F4xError

DAMAGE = (
    ArithmeticError,
    AttributeError,
    EOFError,
    LookupError,
    RuntimeError,
    SyntaxError,
    TypeError,
    ValueError,
    struct.error,
    tokenize.TokenError,
    zipfile.BadZipFile,
    zipfile.LargeZipFile,
    zlib.error,
)
"""Raised by Python's own libraries and numpy on damaged bytes, and by code that takes a field for another type.
RecursionError, NotImplementedError and UnicodeDecodeError are among them. MemoryError is not: claims are checked before memory is
taken, so it means that an honest file is too large for the machine."""
MAX_JSON_BYTES = 64 << 20
"""Files of operations and selections of millions of Gaussians take less."""
MAX_JSON_DEPTH = 100
"""Nested brackets. Ours have about 10; code that walks through a document by recursion can take some hundred."""
MAX_JSON_CONTAINERS = 1 << 21
"""Lists and objects: one takes 3 bytes in the file and 64 to 232 in memory."""
MAX_INFLATION = 64
"""A compressed file may hold so many times its own size. Splats and masks shrink 2 to 30 times; a bomb 1,000 times."""
FREE_BYTES = 16 << 20
"""So much any file may hold, however few bytes it has."""
FREE_PIXELS = 64 << 20
"""So many pixels any picture may have, twice those of 8K: plain ones shrink to next to nothing."""
FREE_ANIMATED_PIXELS, MAX_ANIMATED_PIXELS = 32 << 20, 4096
"""Pixels of all frames of an animation: any may have so many, one of 8K; a larger one so many for each of its bytes, as a
picture that hardly changes takes a kilobyte."""
PNG_SIGNATURE = b"\x89PNG\r\n\x1a\n"
PNG_SIZE_AT = 16
"""Byte of a PNG at which width and height stand, 32 bits each."""
PNG_CHUNKS_AT, PNG_CHUNK_FRAME = 8, 12
"""Byte at which chunks begin; bytes of one beside its content: length, name and checksum."""
MAX_QUOTED = 80
"""Letters of a value from a file that a message repeats: enough to find it there."""
OWN_LIMIT = "a limit of Feature4X"


def parse_json(data: bytes | str, constants: bool = True) -> Any:
    """Return the content of a JSON text in UTF-8, with or without a byte order mark.

    Raises ValueError for anything else, for brackets that are nested too deep or are too many, and without `constants` for NaN
    and Infinity, which JSON lacks but Python writes.
    """
    text = data if isinstance(data, str) else data.decode("utf-8-sig")
    if text.count("[") + text.count("{") > MAX_JSON_CONTAINERS:
        raise ValueError(f"more than {MAX_JSON_CONTAINERS:,} lists and objects, {OWN_LIMIT}")
    try:
        content = json.loads(text, parse_constant=None if constants else _refuse_constant)
    except RecursionError:
        raise ValueError(_TOO_DEEP) from None
    level = [content] if isinstance(content, list | dict) else []
    for _ in range(MAX_JSON_DEPTH):
        level = [
            entry
            for node in level
            for entry in (node.values() if isinstance(node, dict) else node)
            if isinstance(entry, list | dict)
        ]
        if not level:
            return content
    raise ValueError(_TOO_DEEP)


def _refuse_constant(text: str) -> None:
    raise ValueError(f"{text} is not JSON")


_TOO_DEEP = f"its brackets are nested deeper than {MAX_JSON_DEPTH}, {OWN_LIMIT}"


def load_json(path: Path, max_bytes: int = MAX_JSON_BYTES) -> Any:
    """Return the content of a JSON file. Raises OSError where the system refuses, ValueError as `parse_json`."""
    size = path.stat().st_size
    if size > max_bytes:
        raise ValueError(f"larger than {max_bytes >> 20} MiB, {OWN_LIMIT}")
    return parse_json(path.read_bytes())


def require_inflation(claimed: int, present: int) -> None:
    """Raise ValueError where `present` compressed bytes claim to hold `claimed` bytes, as those of a bomb do."""
    if claimed > max(FREE_BYTES, MAX_INFLATION * present):
        raise ValueError(
            f"its {present:,} bytes claim to hold {claimed:,}; more than {MAX_INFLATION} times as much is {OWN_LIMIT}"
        )


def require_picture(path: Path) -> None:
    """Raise ValueError for a PNG with chunks that reach beyond its end, or with more pixels than its bytes can hold.

    Libraries that decode pictures take memory for both claims first. Other formats pass; see `require_pixels`. Raises OSError.
    """
    with path.open("rb") as file:  # chunk by chunk: pictures of many megabytes are looked at several times
        head = file.read(PNG_SIZE_AT + 8)
        if not head.startswith(PNG_SIGNATURE):
            return
        size = os.fstat(file.fileno()).st_size
        width, height = struct.unpack(">II", head[PNG_SIZE_AT:].ljust(8, b"\0"))
        require_pixels(width, height, size)
        at = PNG_CHUNKS_AT
        while at + 4 <= size:
            file.seek(at)
            at += PNG_CHUNK_FRAME + struct.unpack(">I", file.read(4))[0]
    if at > size:
        raise ValueError("a part of it reaches beyond its end")


def require_pixels(width: int, height: int, present: int) -> None:
    """Raise ValueError where `present` bytes claim to be a picture of so many pixels as only those of a bomb do."""
    if width * height > max(FREE_PIXELS, MAX_INFLATION * present // 3):
        raise ValueError(
            f"its {present:,} bytes claim {width}x{height} pixels; above {FREE_PIXELS >> 20} million, more than {MAX_INFLATION}"
            f" times its size is {OWN_LIMIT}"
        )


def require_animation(width: int, height: int, frames: int, present: int) -> None:
    """Raise ValueError where `present` bytes claim to be an animation of so many pixels as only those of a bomb do."""
    if width * height * frames > max(FREE_ANIMATED_PIXELS, MAX_ANIMATED_PIXELS * present):
        raise ValueError(
            f"its {present:,} bytes claim {frames:,} frames of {width}x{height} pixels; above {FREE_ANIMATED_PIXELS >> 20}"
            f" million in all, more than {MAX_ANIMATED_PIXELS:,} for each byte is {OWN_LIMIT}"
        )


def load_npy(path: Path, mapped: bool = False) -> np.ndarray:
    """Return the array of a `.npy` file, read into memory or `mapped`. Raises OSError, or one of `DAMAGE`."""
    with path.open("rb") as file:
        _require_npy(file, os.fstat(file.fileno()).st_size)
    return np.load(path, mmap_mode="r" if mapped else None, allow_pickle=False)


@contextmanager
def open_npz(path: Path) -> Iterator[Mapping[str, np.ndarray]]:
    """Yield the arrays of a `.npz` by name, each read when it is asked for. Raises OSError, or one of `DAMAGE`."""
    with zipfile.ZipFile(path) as archive:
        members = archive.infolist()
        require_inflation(sum(member.file_size for member in members), path.stat().st_size)
        for member in members:
            with archive.open(member) as file:
                _require_npy(file, member.file_size)
    with np.load(path, allow_pickle=False) as arrays:
        yield arrays


def read_npy_header(file: Any) -> tuple[tuple[int, ...], bool, np.dtype]:
    """Return shape, whether Fortran order, and dtype of a .npy; `file` stands behind its header then. Raises one of `DAMAGE`."""
    version = np.lib.format.read_magic(file)
    read = {(1, 0): np.lib.format.read_array_header_1_0, (2, 0): np.lib.format.read_array_header_2_0}.get(version)
    if read is None:
        raise ValueError(f"a .npy of version {version[0]}.{version[1]}, of which 1.0 and 2.0 are read")
    try:
        return read(file)
    except MemoryError:  # Python's parser, of a header that is nested too deep
        raise ValueError("its header cannot be parsed") from None


def _require_npy(file: Any, size: int) -> None:
    """Raise ValueError unless the header at the start of a .npy `file` of `size` bytes describes what follows it."""
    shape, _, dtype = read_npy_header(file)
    if dtype.hasobject:
        raise ValueError("it holds Python objects, which are never read")
    claimed, held = math.prod(shape) * dtype.itemsize, size - file.tell()
    if claimed > held:
        raise ValueError(f"its header says {shape} {dtype}, {claimed:,} bytes; there are {held:,}")


@contextmanager
def undamaged(path: Path, advice: str) -> Iterator[None]:
    """Turn `DAMAGE` and OSError inside the block into one sentence that names `path` and gives `advice`.

    F4xError passes; it gets the path in front unless it is there.
    """
    try:
        yield
    except F4xError as error:
        if str(error).startswith(str(path)):
            raise
        raise F4xError(f"{path}: {error}") from error
    except OSError as error:
        raise F4xError(f"{path}: cannot be read ({error.strerror or error}); {advice}") from error
    except DAMAGE as error:
        raise F4xError(f"{path}: damaged ({reason(error)}); {advice}") from error


def reason(error: BaseException) -> str:
    """Return the text of an error of a library in one line, or its kind where it has none."""
    text = " ".join(str(error).split())[:200]
    return "".join(letter if letter.isprintable() else "?" for letter in text) or type(error).__name__


def quoted(value: object) -> str:
    """Return a value that a file holds as it stands in a message: one line of printable letters, cut after `MAX_QUOTED`."""
    text = str(value)
    text = text if len(text) <= MAX_QUOTED else text[: MAX_QUOTED - 1] + "…"
    return "".join(letter if letter.isprintable() else "?" for letter in text)


def bytes_left(file: BinaryIO) -> int:
    """Count the bytes of an open file behind the current position, which stays."""
    here = file.tell()
    end = file.seek(0, os.SEEK_END)
    file.seek(here)
    return max(end - here, 0)
