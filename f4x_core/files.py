"""Atomic writing of files: a name always holds either the old content or the complete new one. Conversion to plain JSON data."""

import errno
import glob
import json
import math
import os
import tempfile
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any, BinaryIO

from .errors import F4xError

LOCK = ".f4x-lock"
"""Name of the file that keeps a second fit out of a folder."""
LOOK = 0.05
"""Seconds between two attempts at a lock that another process holds."""
_HELD = {errno.EAGAIN, errno.EACCES, errno.EDEADLK, errno.ENOENT, errno.ESTALE}
"""Errors that say that another process holds a lock, or has just removed its file; any other: the file system has no locks."""
UNFINISHED = ".part"
"""End of the name of a file that is being written."""
RANDOM_LETTERS = 8
"""Letters that `tempfile` makes up for such a name."""
MAX_NAME_BYTES = 200
"""Bytes of a file's name in the name of a neighbour; the rest of the 255 that file systems allow is for what is added."""


@contextmanager
def replace_file(path: Path | str) -> Iterator[BinaryIO]:
    """Yield a seekable binary file that becomes `path` when the block ends without an error.

    The bytes go to a temporary neighbour (same folder, so the rename is atomic), are flushed to the disk and renamed;
    any exception inside removes the neighbour and leaves what was at `path` untouched. A failing disk raises F4xError.
    """
    with replace_path(path) as temporary, open(temporary, "w+b") as file:
        yield file
        file.flush()
        os.fsync(file.fileno())


@contextmanager
def replace_path(path: Path | str, suffix: str = UNFINISHED) -> Iterator[Path]:
    """Yield the path of a new file that becomes `path` when the block ends, for libraries that open files themselves.

    As `replace_file`; they see a name that ends in `suffix`. A symbolic link stays, and the file that it leads to is replaced.
    What is no ordinary file is never replaced: a rename onto /dev/null would take that device from the whole machine.
    Raises F4xError.
    """
    path, temporary = Path(path), None
    if path.exists() and not path.is_file():
        raise F4xError(
            f"{path}: {'a folder' if path.is_dir() else 'no ordinary file'}; give the name of a file to write"
        )
    file = link_target(path)
    try:
        try:
            temporary = _new_neighbour(file, suffix)
            yield temporary
            os.chmod(temporary, _mode_of(file))
            os.replace(temporary, file)
            temporary = None
            _flush_folder(file.parent)
        finally:
            if temporary is not None:
                os.unlink(temporary)
    except OSError as error:
        reason = error.strerror or str(error)
        raise F4xError(
            f"{path}: cannot be written ({reason}); check the folder, its rights and the free space"
        ) from error


def link_target(path: Path | str) -> Path:
    """Return the place that `path` leads to through symbolic links; `path` itself if it is none. F4xError for a loop of links."""
    path = Path(path)
    if not path.is_symlink():
        return path
    target = Path(os.path.realpath(path))
    if target.is_symlink():
        raise F4xError(f"{path}: a link that leads back to itself; remove it, or give another name")
    return target


def same_file(one: Path, other: Path) -> bool:
    """Return True where two paths lead to one existing file, by links or by other names of its folder."""
    return one.exists() and other.exists() and one.samefile(other)


def in_place(path: Path, output: Path | None) -> tuple[Path, Path | None]:
    """Return the file to change and the other file to write; where both are one, it is changed under the name of `output`."""
    return (output, None) if output is not None and same_file(output, path) else (path, output)


def user_path(path: Path | str) -> Path:
    """Return `path` with a leading `~` or `~user` replaced by that home folder, unless a file has that name or no user."""
    path = Path(path)
    if os.path.exists(path):
        return path
    try:
        return path.expanduser()
    except RuntimeError:  # no such user, or no home: an ordinary name
        return path


def neighbour(path: Path, end: str) -> Path:
    """Return the hidden file `.NAME.end` beside `path`, its name cut to what file systems allow."""
    name = path.name.encode("utf-8", "surrogateescape")[:MAX_NAME_BYTES].decode("utf-8", "ignore")
    return path.with_name(f".{name}.{end}")


@contextmanager
def lock_file(path: Path, busy: str, patience: float = 0.0) -> Iterator[None]:
    """Keep other processes and threads out of what `path`, an empty file that is there meanwhile, stands for.

    The system lets go of the lock when this process ends, however it ends: a file that a killed process leaves behind keeps nobody
    out, and the next holder removes it. Where the file system knows no locks there is none.
    Raises F4xError with the sentence `busy` if another one holds the lock for longer than `patience` seconds.
    """
    deadline = time.monotonic() + patience
    while (descriptor := _locked(path)) is None:
        if time.monotonic() > deadline:
            raise F4xError(busy)
        time.sleep(LOOK)
    try:
        yield
    finally:
        if os.name == "nt":  # an open file cannot be removed there
            os.close(descriptor)
        with suppress(OSError):
            os.unlink(path)
        if os.name != "nt":
            os.close(descriptor)


@contextmanager
def sole_writer(folder: Path) -> Iterator[None]:
    """Make `folder` and keep other fits out of it; it goes again if nothing is written into it. F4xError if one is there."""
    new = [each for each in (folder, *folder.parents) if not each.exists()]
    try:
        link_target(folder).mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise F4xError(f"{folder}: cannot be created ({error.strerror}); choose another output folder.") from error
    busy = f"{folder}: another fit is writing into this folder; wait until it is done, or choose another folder."
    try:
        with lock_file(folder / LOCK, busy):
            yield
    finally:
        with suppress(OSError):  # not empty
            for each in new:
                each.rmdir()


def _locked(path: Path) -> int | None:
    """Return a descriptor that holds the lock of `path`; None if another one does."""
    try:
        descriptor = _opened_lock(path)
    except OSError as error:
        if os.name == "nt" and isinstance(error, PermissionError):  # its last holder is removing it
            return None
        raise F4xError(
            f"{path.parent}: cannot be written ({error.strerror}); check the folder and its rights"
        ) from error
    try:
        if os.name == "nt":
            import msvcrt

            msvcrt.locking(descriptor, msvcrt.LK_NBLCK, 1)  # type: ignore[attr-defined]
        else:
            import fcntl

            fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
            if os.stat(path).st_ino != os.fstat(descriptor).st_ino:  # its last holder removed it in between
                raise FileNotFoundError(errno.ENOENT, "removed")
    except OSError as error:
        if error.errno not in _HELD:
            return descriptor
        os.close(descriptor)
        return None
    return descriptor


def _opened_lock(path: Path) -> int:
    """Open the lock file, which is made where there is none; one that another user's killed process left is only read."""
    try:
        return os.open(path, os.O_RDWR | os.O_CREAT, 0o644)
    except PermissionError:
        if not path.exists():
            raise
        return os.open(path, os.O_RDONLY)


def _new_neighbour(path: Path, suffix: str) -> Path:
    """Create an empty hidden file beside `path` whose name ends in `suffix`."""
    descriptor, name = tempfile.mkstemp(dir=path.parent, prefix=neighbour(path, "").name, suffix=suffix)
    os.close(descriptor)
    return Path(name)


def _mode_of(path: Path) -> int:
    """Return the permission bits that the finished file should have: those it had, or the usual ones (mkstemp gives 0600)."""
    try:
        return path.stat().st_mode & 0o777
    except FileNotFoundError:
        return 0o644


def remove_unfinished(path: Path) -> None:
    """Remove what killed writers of `path` left of its new content; whoever calls this is the only writer."""
    beginning = neighbour(path, "").name
    if beginning != f".{path.name}.":  # cut off: another name may begin so, too
        return
    for left in path.parent.glob(f"{glob.escape(beginning)}{'?' * RANDOM_LETTERS}{UNFINISHED}"):
        with suppress(OSError):
            left.unlink()


def _flush_folder(folder: Path) -> None:
    """Make the rename itself durable; Windows can neither open folders nor needs it."""
    if os.name == "nt":
        return
    descriptor = os.open(folder, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)


def json_text(data: Any, indent: int | None = None) -> str:
    """Return `data` as standard JSON text, see `json_data`; NaN and infinity become null."""
    return json.dumps(json_data(data), indent=indent, allow_nan=False)


def json_data(
    data: Any,
    non_finite: Callable[[float], Any] = lambda value: None,
    unknown: Callable[[Any], Any] = lambda value: value,
) -> Any:
    """Return nested data as plain JSON types: dicts with string keys, lists, strings, numbers, booleans and None.

    Arrays and numbers of numpy become lists and numbers of Python.

    Args:
        data: mappings, lists, tuples, arrays and single values, nested in any way.
        non_finite: what replaces NaN and infinity, which JSON lacks; None by default.
        unknown: what replaces a value of any other type; by default it stays, and `json.dumps` refuses it.
    """
    if isinstance(data, Mapping):
        return {str(name): json_data(entry, non_finite, unknown) for name, entry in data.items()}
    if isinstance(data, list | tuple):
        return [json_data(entry, non_finite, unknown) for entry in data]
    if hasattr(data, "tolist"):
        return json_data(data.tolist(), non_finite, unknown)
    if isinstance(data, float):
        return data if math.isfinite(data) else non_finite(data)
    return data if data is None or isinstance(data, str | int) else unknown(data)
