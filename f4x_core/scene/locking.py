"""Locks a scene file for one writer at a time, so that no change is lost when several programs work on it."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from ..files import link_target, lock_file, neighbour, remove_unfinished

PATIENCE = 60.0
"""Seconds to wait for another writer, or run, by default: longer than an edit takes, a language model's answer included."""

_held = threading.local()  # `files`: the scene files whose locks this thread holds


@contextmanager
def updating(path: Path | str, patience: float = PATIENCE) -> Iterator[None]:
    """Keep other writers out of the scene file at `path`; who changes a scene holds this from reading to writing.

    `write_scene` and `write_edits` take the same lock; within the block, in the same thread, they go on at once. Readers need no
    lock: a file is always a whole scene. All links to a file share its lock. The lock is an empty hidden file beside the scene that
    is gone afterwards; where a process was killed, the next writer takes the lock over (see `lock_file`) and removes what that one
    had begun to write.
    Raises F4xError if another writer holds the lock for longer than `patience` seconds.
    """
    file = link_target(path).absolute()
    held: set[Path] = _held.__dict__.setdefault("files", set())
    if (
        file in held or not file.parent.is_dir()
    ):  # without a folder there is nothing to keep: reading and writing say so
        yield
        return
    busy = f"{path}: another program is changing this scene, and nothing was written; try again when it is done"
    with lock_file(neighbour(file, "lock"), busy, patience):
        remove_unfinished(file)
        held.add(file)
        try:
            yield
        finally:
            held.discard(file)


@contextmanager
def only_run(verb: str, path: Path) -> Iterator[None]:
    """Keep two runs of `f4x VERB` from changing the scene file at `path`, each without what the other adds.

    A run takes minutes, so this is no lock of the scene: others edit it meanwhile, and the run keeps their edits.
    Raises F4xError if another run holds it for longer than `PATIENCE` seconds.
    """
    busy = f"{path}: another `f4x {verb}` is working on this scene; try again when it is done."
    with lock_file(neighbour(link_target(path), f"{verb}-lock"), busy, PATIENCE):
        yield
