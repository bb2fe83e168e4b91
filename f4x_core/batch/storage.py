"""Store of a batch: a folder, or whatever `fsspec` knows by URL (`s3://`, `gs://`, `memory://`).

A name is relative to the store, with `/` between its parts. A file exists completely or not at all: a folder renames it into place,
and an object store shows an object when its upload ends. If a URL leads to real folders (`sftp://`, `smb://`), a file can be seen
while it is written; records are written last and contain its size, so they still show which tasks are done.
"""

from __future__ import annotations

import contextlib
import errno
import glob
import hashlib
import os
import shutil
import uuid
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any

from ..errors import F4xError
from ..files import link_target, neighbour, replace_file, user_path

CHUNK = 1 << 20
"""Bytes that are hashed at a time."""
URL = "://"
"""Text that marks a place as a URL."""


class FolderStore:
    """A store in a folder, shared between machines or not. `local` is the folder; `url` opens the store on other machines too."""

    def __init__(self, path: Path):
        """Name the folder, which is created with its first file."""
        self.root = self.local = user_path(path).absolute()
        self.url = str(self.root)

    def read(self, name: str) -> bytes | None:
        """Return the content of a file, None if there is no such file."""
        try:
            return (self.root / name).read_bytes()
        except FileNotFoundError:
            return None

    def write(self, name: str, data: bytes) -> None:
        """Write a small file atomically."""
        with replace_file(self._place(name)) as file:
            file.write(data)

    def create(self, name: str, data: bytes) -> bool:
        """Write a small file unless it exists; returns whether it was written."""
        try:
            with open(self._place(name), "xb") as file:
                file.write(data)
        except FileExistsError:
            return False
        return True

    def remove(self, name: str) -> None:
        """Delete a file if it exists."""
        (self.root / name).unlink(missing_ok=True)

    def fetch(self, name: str, path: Path) -> None:
        """Make a file available at `path` for reading: a hard link if possible, as files are replaced and never changed."""
        path.parent.mkdir(parents=True, exist_ok=True)
        _link_or_copy(self.root / name, path)

    def publish(self, path: Path, name: str) -> None:
        """Store the file at `path` under `name`, atomically. The two may be the same file on the disk afterwards."""
        place = link_target(self._place(name))
        beside = neighbour(place, f"{uuid.uuid4().hex}.part")
        try:
            _link_or_copy(path, beside)
            os.replace(beside, place)
        finally:  # a rename of two names of one file leaves both
            beside.unlink(missing_ok=True)

    def sizes(self, prefix: str) -> dict[str, int]:
        """Name -> size in bytes of every file below the folder `prefix`."""
        found = {}
        for folder, _, names in os.walk(self.root / prefix):
            for name in names:
                path = Path(folder, name)
                with contextlib.suppress(FileNotFoundError):
                    found[path.relative_to(self.root).as_posix()] = path.stat().st_size
        return found

    def folders(self) -> list[str]:
        """Return the names of the folders at the top of the store, sorted."""
        return sorted(path.name for path in self.root.iterdir() if path.is_dir()) if self.root.is_dir() else []

    def _place(self, name: str) -> Path:
        place = self.root / name
        place.parent.mkdir(parents=True, exist_ok=True)
        return place


class RemoteStore:
    """A store behind a URL, with the methods of `FolderStore`; `local` is None."""

    def __init__(self, url: str):
        """Connect to the place. Raises F4xError if its library is not installed or it cannot be reached."""
        self.url, self.local = url.rstrip("/"), None
        self.system, self.root = _file_system(self.url)

    def read(self, name: str) -> bytes | None:
        """See `FolderStore.read`."""
        with _library_errors(self.url):
            try:
                return self.system.cat_file(self._path(name))
            except FileNotFoundError:
                return None

    def write(self, name: str, data: bytes) -> None:
        """See `FolderStore.write`."""
        with _library_errors(self.url):
            self.system.pipe_file(self._place(name), data)

    def create(self, name: str, data: bytes) -> bool:
        """See `FolderStore.create`."""
        with _library_errors(self.url):
            try:
                self.system.pipe_file(self._place(name), data, mode="create")
            except FileExistsError:
                return False
            return True

    def remove(self, name: str) -> None:
        """See `FolderStore.remove`."""
        with _library_errors(self.url), contextlib.suppress(FileNotFoundError):
            self.system.rm_file(self._path(name))

    def fetch(self, name: str, path: Path) -> None:
        """See `FolderStore.fetch`."""
        path.parent.mkdir(parents=True, exist_ok=True)
        with _library_errors(self.url):
            self.system.get_file(self._path(name), str(path))

    def publish(self, path: Path, name: str) -> None:
        """See `FolderStore.publish`."""
        with _library_errors(self.url):
            self.system.put_file(str(path), self._place(name))

    def sizes(self, prefix: str) -> dict[str, int]:
        """See `FolderStore.sizes`."""
        with _library_errors(self.url):
            self.system.invalidate_cache()
            found = self.system.find(self._path(prefix), detail=True)
        return {path[len(self.root) :].lstrip("/"): int(entry["size"] or 0) for path, entry in found.items()}

    def folders(self) -> list[str]:
        """See `FolderStore.folders`."""
        with _library_errors(self.url), contextlib.suppress(FileNotFoundError):
            self.system.invalidate_cache()
            found = self.system.ls(self.root, detail=True)
            return sorted(e["name"].rstrip("/").rpartition("/")[2] for e in found if e["type"] == "directory")
        return []

    def _path(self, name: str) -> str:
        return f"{self.root}/{name}".rstrip("/")

    def _place(self, name: str) -> str:
        path = self._path(name)
        self.system.makedirs(path.rpartition("/")[0], exist_ok=True)
        return path


Store = FolderStore | RemoteStore
"""Place for the files of a batch."""


def open_store(place: str) -> Store:
    """Open the store at a folder or URL. Raises F4xError if that is not possible."""
    return RemoteStore(place) if URL in place else FolderStore(Path(place))


def read_bytes(place: str) -> bytes:
    """Return the content of a small file, local or behind a URL."""
    try:
        if URL in place:
            system, path = _file_system(place)
            with _library_errors(place):
                return system.cat_file(path)
        return Path(place).read_bytes()
    except OSError as error:
        raise F4xError(f"{place}: cannot be read ({error.strerror or error}); check the path.") from error


def expand(pattern: str) -> list[str]:
    """Return the paths that match a glob pattern, sorted; a path that exists stands for itself."""
    if URL in pattern:
        system, path = _file_system(pattern)
        with _library_errors(pattern):
            return [system.unstrip_protocol(found) for found in sorted(system.glob(path))]
    if Path(pattern).exists():  # a name may hold brackets
        return [pattern]
    return sorted(glob.glob(os.path.expanduser(pattern)))


def join(folder: str, path: str) -> str:
    """Return `path` relative to `folder`; absolute paths and URLs stay as they are."""
    if not folder or URL in path or os.path.isabs(os.path.expanduser(path)):
        return path
    return f"{folder}/{path}" if URL in folder else os.path.join(folder, path)


def fetch_tree(place: str, folder: Path) -> Path:
    """Copy a file or folder behind a URL into `folder`, under its own name."""
    system, path = _file_system(place)
    target = folder / path.rstrip("/").rpartition("/")[2]
    with _library_errors(place):
        folder.mkdir(parents=True, exist_ok=True)
        system.get(path.rstrip("/"), str(target), recursive=system.isdir(path))
    return target


class Digests:
    """Content hashes of paths. A local file is read again only if its size or modification time has changed."""

    def __init__(self, known: dict[str, list[str]] | None = None):
        """Start from `known`, the result of `to_json` in an earlier run."""
        self.known = known or {}

    def to_json(self) -> dict[str, list[str]]:
        """Return a dictionary from path to [fingerprint of sizes and modification times, content hash]."""
        return self.known

    def digest(self, place: str) -> str:
        """Hash of a file's bytes, or of the names and bytes in a folder; for a URL, of the object's metadata in its store.

        Empty if nothing is there: the caller reports that with more context.
        """
        if URL in place:
            return _remote_digest(place)
        root = user_path(place)
        files = sorted(file for file in root.rglob("*") if file.is_file()) if root.is_dir() else [root]
        try:
            stats = [(file.relative_to(root).as_posix(), file.stat()) for file in files]
            fingerprint = _hash(f"{name} {stat.st_size} {stat.st_mtime_ns}".encode() for name, stat in stats)
            if self.known.get(place, [""])[0] != fingerprint:
                self.known[place] = [fingerprint, _hash(part for file in files for part in _content(file, root))]
        except OSError:
            return ""
        return self.known[place][1]


def _hash(parts: Iterable[bytes]) -> str:
    state = hashlib.sha256()
    for part in parts:
        state.update(part)
    return state.hexdigest()


def _content(file: Path, root: Path) -> Iterator[bytes]:
    yield f"{file.relative_to(root).as_posix()} {file.stat().st_size}\n".encode()
    with open(file, "rb") as stream:
        while block := stream.read(CHUNK):
            yield block


def _remote_digest(place: str) -> str:
    system, path = _file_system(place)
    with _library_errors(place):
        found = sorted(system.find(path, detail=True).items())
    identifying = ("size", "ETag", "etag", "md5Hash", "mtime", "created")
    lines = (
        f"{name[len(path) :]} {[(key, str(entry[key])) for key in identifying if key in entry]}\n"
        for name, entry in found
    )
    return _hash(line.encode() for line in lines) if found else ""


def _link_or_copy(source: Path, target: Path) -> None:
    try:
        os.link(source, target)
    except FileExistsError:
        raise
    except OSError as error:  # another disk, or a file system without links
        if error.errno in (errno.ENOENT, errno.ENOSPC, errno.EDQUOT):
            raise
        shutil.copyfile(source, target)


def _file_system(url: str) -> tuple[Any, str]:
    """Return the fsspec file system of a URL, and the path in it."""
    try:
        from fsspec.core import url_to_fs
    except ImportError as error:
        raise F4xError(f"{url}: URLs need the package fsspec; pip install fsspec, or the extra [cluster].") from error
    try:
        return url_to_fs(url)
    except (ImportError, ValueError) as error:
        raise F4xError(f"{url}: {error}") from error


@contextlib.contextmanager
def _library_errors(place: str) -> Iterator[None]:
    """Turn errors of a store's library into F4xError; FileNotFoundError and FileExistsError pass, as callers expect them."""
    try:
        yield
    except (FileNotFoundError, FileExistsError, F4xError):
        raise
    except Exception as error:  # every library has its own
        raise F4xError(f"{place}: {type(error).__name__}: {error}; check the address and your rights there.") from error
