"""The one folder that an agent can reach: resolves names to paths inside it and refuses all others."""

from __future__ import annotations

import os
import re
from collections.abc import Iterator
from itertools import islice
from pathlib import Path

from ..errors import F4xError

SUFFIX = ".f4x"
MAX_SCENES = 100
"""Maximum number of scenes in a list."""
MAX_VISITED = 20_000
"""Maximum number of files and folders that are searched for scenes: the folder may be a whole home folder."""
MAX_NAME_CHARACTERS = 250
"""Maximum length of a relative path; file systems allow 255 bytes for each part."""
PLAIN = re.compile(r"(\w[\w .()+-]*/)*\w[\w .()+-]*", re.ASCII)
"""Names that may be written: no hidden file, drive, stream or device, and no option of another program."""
DEVICE = re.compile(r"(con|prn|aux|nul|com\d|lpt\d)", re.IGNORECASE)
"""Names that Windows reserves for devices, whatever their suffix."""


class SceneFolder:
    """Scenes and outputs below one folder. Symbolic links and `..` are resolved first and must lead to a place inside it."""

    def __init__(self, target: Path):
        """Serve a folder, or one scene file `target` with the folder that contains it. Raises F4xError if it does not exist."""
        try:
            place = target.resolve(strict=True)
        except (OSError, RuntimeError) as error:
            raise F4xError(f"{target}: there is no such file or folder; give a scene or a folder of scenes.") from error
        self.only = None if place.is_dir() else place
        self.root = place if self.only is None else place.parent

    def name(self, path: Path) -> str:
        """Return the name of a path inside the folder, as agents use it."""
        return path.relative_to(self.root).as_posix()

    def scenes(self) -> list[str]:
        """Return the names of the scenes, sorted, at most `MAX_SCENES`."""
        if self.only is not None:
            return [self.name(self.only)]
        return sorted(islice((self.name(path) for path in self._found()), MAX_SCENES))

    def scene(self, name: str) -> Path:
        """Return the path of scene `name`, or of the only scene if `name` is empty."""
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
        """Return the path of an existing file `name`."""
        path = self.inside(name)
        if not path.is_file():
            raise F4xError(f"There is no file {name!r} in the folder; give the name of one that is there.")
        return path

    def output(self, name: str) -> Path:
        """Return the path of a new file or folder `name`; F4xError if it exists, because nothing is overwritten."""
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
        """Return the path of `name` with every link resolved. Raises F4xError if it leads out of the folder."""
        try:
            path = (self.root / name).resolve()
        except (OSError, RuntimeError, ValueError) as error:  # a loop of links, a zero byte
            raise F4xError(f"{name!r} is no path; give one inside the folder.") from error
        if len(name) > MAX_NAME_CHARACTERS or Path(name).is_absolute() or not path.is_relative_to(self.root):
            raise F4xError(
                f"{name[:MAX_NAME_CHARACTERS]!r} leads out of the folder; give a relative path inside of it."
            )
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
            if visited > MAX_VISITED:
                return
