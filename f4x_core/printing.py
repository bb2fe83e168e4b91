"""Text for terminals and pipes: what a name or a file brings along cannot steer a terminal, and a full or closed one is no crash.

All that the command line prints goes through `escaped` and `write`.
"""

import contextlib
import os
import re
import sys
from typing import TextIO

OUTPUT = "standard output"
_UNSAFE = re.compile(
    "["
    "\x00-\x08\x0b-\x1f\x7f-\x9f"  # control characters but tab and line feed
    "\u061c\u200b\u200e\u200f\u2028-\u202e\u2060-\u206f\ufeff\ufff9-\ufffb"  # direction, line breaks, nothing to see
    "\ud800-\udfff"  # bytes of a name that are no UTF-8
    "\U000e0000-\U000e007f"  # tags
    "]"
)


def escaped(text: str) -> str:
    r"""Return `text` with all that steers a terminal, reorders a line or cannot be printed written out, such as `\x1b`.

    Lines and tabs stay; see `one_line`.
    """
    return _UNSAFE.sub(_written_out, text)


def one_line(text: str) -> str:
    r"""Return `escaped` text with its line feeds written as `\n`, too, to stand within a line, such as a name."""
    return escaped(text).replace("\n", r"\n")


def _written_out(match: re.Match[str]) -> str:
    code = ord(match[0])
    if 0xDC80 <= code <= 0xDCFF:  # how Python reads a byte that is no UTF-8
        code -= 0xDC00
    return f"\\x{code:02x}" if code < 0x100 else f"\\u{code:04x}" if code < 0x10000 else f"\\U{code:08x}"


def write(file: TextIO | None, text: str) -> None:
    """Write a line at once; characters that the file's encoding lacks are written out. None, a closed stream, takes everything.

    Raises OSError, which names the file, when it is full or nobody reads any more (BrokenPipeError); then it takes no more.
    """
    if file is None:
        return
    encoding = getattr(file, "encoding", None) or "utf-8"
    try:
        file.write(text.encode(encoding, "backslashreplace").decode(encoding) + "\n")
        file.flush()
    except OSError as error:
        discard(file)
        raise type(error)(error.errno, error.strerror, OUTPUT) from error


def print_text(text: str) -> None:
    """Print on standard output. Raises OSError as `write` does."""
    write(sys.stdout, escaped(text))


def print_error(text: str) -> None:
    """Print one line on standard error; where that is full there is nobody to tell."""
    with contextlib.suppress(OSError):
        write(sys.stderr, one_line(text))


def open_streams() -> None:
    """Open what the caller closed of the standard streams on the null device: a file that got their number would take what
    libraries print."""
    for descriptor in range(3):
        try:
            os.fstat(descriptor)
        except OSError:
            os.open(os.devnull, os.O_RDWR)  # takes the lowest free number: this one
    for name, mode in (("stdin", "r"), ("stdout", "w"), ("stderr", "w")):
        if getattr(sys, name) is None:  # what Python makes of a stream that is closed
            setattr(sys, name, open(os.devnull, mode))  # noqa: SIM115 - to the end of the process


def discard(file: TextIO | None) -> None:
    """Let what `file` still holds, and what comes, go nowhere, so that the interpreter's end does not fail at it again."""
    if file is None:
        return
    with contextlib.suppress(OSError, ValueError):
        null = os.open(os.devnull, os.O_WRONLY)
        os.dup2(null, file.fileno())
        os.close(null)
