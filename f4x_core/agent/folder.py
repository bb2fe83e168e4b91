"""The one folder that an agent sees: names in, paths inside of it out, or one sentence."""

from __future__ import annotations

import os
import re
from collections.abc import Iterator
from itertools import islice
from pathlib import Path

from ..errors import F4xError

SUFFIX = ".f4x"
MOST_SCENES = 100
"""Scenes that are listed."""
MOST_VISITED = 20_000
"""Files and folders that are looked at for them: somebody may serve a home folder."""
LONGEST_NAME = 250
"""Characters of a relative path; file systems take 255 bytes a part."""
PLAIN = re.compile(r"(\w[\w .()+-]*/)*\w[\w .()+-]*", re.ASCII)
"""What files are written as: nothing hidden, no drive, stream, device or option of another program."""
DEVICE = re.compile(r"(con|prn|aux|nul|com\d|lpt\d)", re.IGNORECASE)
"""Names that Windows takes for devices, whatever their suffix."""


class Folder:
    """Scenes and outputs below one folder. Symbolic links and `..` are followed first and have to end inside."""

    def __init__(self, target: Path):
        """Serve a folder, or the one scene file `target` and the folder that it lies in. F4xError: it is not there."""
        try:
            place = target.resolve(strict=True)
        except (OSError, RuntimeError) as error:
            raise F4xError(f"{target}: there is no such file or folder; give a scene or a folder of scenes.") from error
        self.only = None if place.is_dir() else place
        self.root = place if self.only is None else place.parent

    def name(self, path: Path) -> str:
        """How agents call a path inside."""
        return path.relative_to(self.root).as_posix()

    def scenes(self) -> list[str]:
        """Names of the scenes, at most `MOST_SCENES`."""
        if self.only is not None:
            return [self.name(self.only)]
        return sorted(islice((self.name(path) for path in self._found()), MOST_SCENES))

    def scene(self, name: str) -> Path:
        """The scene file `name`; without a name the only one there is."""
        if not name:
            known = self.scenes()
            if len(known) != 1:
                raise F4xError(f"The folder holds {len(known)} scenes; name one of {', '.join(known[:10]) or 'none'}.")
            name = known[0]
        path = self.inside(name)
        if path.suffix.lower() != SUFFIX or not path.is_file() or self.only not in (None, path):
            raise F4xError(f"There is no scene {name!r} here; `info` lists what there is.")
        return path

    def file(self, name: str) -> Path:
        """A file to be read."""
        path = self.inside(name)
        if not path.is_file():
            raise F4xError(f"There is no file {name!r} in the folder; give the name of one that is there.")
        return path

    def output(self, name: str) -> Path:
        """A file or folder to be made; what is there already is never written over."""
        if not PLAIN.fullmatch(name) or any(DEVICE.fullmatch(part.split(".")[0].strip()) for part in name.split("/")):
            raise F4xError(
                f"{name!r} is no plain name; use letters, digits, spaces and . _ - + ( ), with / for folders."
            )
        path = self.inside(name)
        if path.suffix.lower() == SUFFIX:
            raise F4xError(f"{name!r} would be a scene; scenes are changed by edits alone.")
        if path.exists():
            raise F4xError(f"{name!r} is there already; choose another name.")
        return path

    def inside(self, name: str) -> Path:
        """The path that `name` means, every link in it followed. F4xError: it leads out of the folder."""
        try:
            path = (self.root / name).resolve()
        except (OSError, RuntimeError, ValueError) as error:  # a loop of links, a zero byte
            raise F4xError(f"{name!r} is no path; give one inside the folder.") from error
        if len(name) > LONGEST_NAME or Path(name).is_absolute() or not path.is_relative_to(self.root):
            raise F4xError(f"{name[:LONGEST_NAME]!r} leads out of the folder; give a relative path inside of it.")
        return path

    def _found(self) -> Iterator[Path]:
        visited = 0
        for place, folders, files in os.walk(self.root):
            folders[:] = sorted(folder for folder in folders if not folder.startswith("."))
            for file in sorted(files):
                path = Path(place, file)
                if path.suffix.lower() == SUFFIX and path.resolve().is_relative_to(self.root):
                    yield path
            visited += len(folders) + len(files)
            if visited > MOST_VISITED:
                return
