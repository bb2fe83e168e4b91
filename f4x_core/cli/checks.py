"""Checks of arguments that several verbs share; wrong ones are refused before any work."""

from __future__ import annotations

import argparse
from pathlib import Path

from ..errors import F4xError
from ..files import user_path

SLOWER = 6
"""Times that the torch backend takes longer than the compiled kernels, on one thread (docs/results.md)."""


def path_argument(text: str) -> Path:
    """Return the path that a person gave. An empty one, which is what an unset shell variable gives, is not the current folder.

    One that begins with - becomes absolute: verbs of other processes, which get it, would take it for an option.
    """
    if not text:
        raise argparse.ArgumentTypeError("the path is empty; write one, or . for the current folder")
    return Path(text).absolute() if text.startswith(("-", "./-")) else user_path(text)


def scene_argument(text: str) -> Path:
    """Return the scene that a person gave; the folder of a fit means the scene in it."""
    path = path_argument(text)
    inside = path / "scene.f4x"
    return inside if inside.is_file() else path


def output_folder(args: argparse.Namespace) -> Path:
    """Return the folder that a verb with `-o` writes into; for one that writes a file, where it lies."""
    if args.verb in ("distill", "edit", "bake", "mesh"):
        return (args.output or args.scene).parent
    output: Path = args.output
    if args.verb != "export":
        return output
    from ..scene.formats import choose_format

    _, is_file = choose_format(output, args.format, one_moment=args.time is not None)
    return output.parent if is_file else output


def listed_teachers(text: str, flag: str) -> list[str]:
    """Return the teachers that `flag` lists with commas, each once; F4xError for an unknown one or an empty list."""
    from ..features.teachers import TEACHERS, find_teacher

    names = list(dict.fromkeys(name.strip() for name in text.split(",") if name.strip()))
    if not names:
        raise F4xError(f"{flag} is empty; choose from {', '.join(TEACHERS)}.")
    for name in names:
        find_teacher(name)
    return names


def require_given(args: argparse.Namespace, **names: str) -> None:
    """Raise F4xError for arguments that were left out and are needed this time; `names`: attribute -> its name for people."""
    missing = [name for attribute, name in names.items() if getattr(args, attribute) is None]
    if missing:
        raise F4xError(
            f"the following arguments are required: {', '.join(missing)}; `f4x {args.verb} --help` shows what is possible."
        )


def require_folder(folder: Path) -> None:
    """Raise F4xError when a file is in the way of an output folder."""
    for place in (folder, *folder.parents):
        if place.is_dir():
            return
        if place.exists():
            raise F4xError(f"-o {folder}: {place} is a file; give a folder, which is made where it does not exist.")


def why_slow() -> str | None:
    """Return the line about drawing without compiled kernels; None where they are there."""
    from ..raster import why_not

    if why_not("native") is None:
        return None
    return (
        f"The compiled kernels are not there; drawing is about {SLOWER} times slower;"
        " `python -m f4x_core.native.build` compiles them."
    )
