"""Scene files kept in the .blend: on a machine without the file, such as a node of a farm, a copy is made when it is needed.

A packed file is the data of an image datablock that is never shown, the one kind that Blender packs any bytes for.
"""

from __future__ import annotations

import tempfile
from pathlib import Path

import bpy

from ...f4x_core.errors import F4xError
from ...f4x_core.files import replace_file

PACKED = "f4x_packed"
"""Property of a root: the datablock with its packed scene file."""

_copies: dict[int, Path] = {}  # session_uid of a datablock -> the file that was made of it
_folders: list[tempfile.TemporaryDirectory] = []  # of those files; gone when Blender ends


def pack(root: bpy.types.Object, path: Path) -> None:
    """Keep the scene file `path` of `root` in the .blend, in place of one that was packed before."""
    try:
        data = path.read_bytes()
    except OSError as error:
        raise F4xError(f"{path} cannot be read ({error.strerror}); put the scene file back first.") from error
    old, image = root.get(PACKED), bpy.data.images.new(path.name, 1, 1)
    image.pack(data=data, data_len=len(data))
    root[PACKED] = image
    if old is not None and old.users == 0:
        bpy.data.images.remove(old)


def unpacked(root: bpy.types.Object) -> Path | None:
    """Return a file with what was packed for `root`; None if nothing was."""
    image = root.get(PACKED)
    if image is None or image.packed_file is None:
        return None
    path = _copies.get(image.session_uid)
    if path is None or not path.exists():
        _folders.append(tempfile.TemporaryDirectory(prefix="f4x-", ignore_cleanup_errors=True))
        path = _copies[image.session_uid] = Path(_folders[-1].name) / Path(bpy.path.abspath(root["f4x_path"])).name
        with replace_file(path) as file:
            file.write(image.packed_file.data)
    return path


def forget() -> None:
    """Remove the files that were made for the last .blend, now that another one is open."""
    _copies.clear()
    while _folders:
        _folders.pop().cleanup()
