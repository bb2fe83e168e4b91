"""Shared code of the scripts that run without a window: importing the repository, arguments, a JSON result, exit codes.

A door runs as `python scripts/NAME.py ARGS` (bpy wheel) or
`blender -b --factory-startup --python-exit-code 1 -P scripts/NAME.py -- ARGS`.
"""

import importlib.util
import sys
import tempfile
from collections.abc import Callable
from pathlib import Path
from types import ModuleType
from typing import Any

ROOT = Path(__file__).resolve().parents[1]
PACKAGE = "feature4x"
SAMPLES = 128
"""Cycles samples per pixel at most in a .blend that a script writes, for a person who chooses that engine."""
WHOLE = b"\xb1\xea\x92\x8f"
"""Last bytes of a compressed .blend: those of the table of its parts (zstd's seekable format), which is written last."""


def load_extension() -> ModuleType:
    """Import the repository root as the package `feature4x`, the way Blender imports the installed extension."""
    if PACKAGE not in sys.modules:
        spec = importlib.util.spec_from_file_location(
            PACKAGE, ROOT / "__init__.py", submodule_search_locations=[str(ROOT)]
        )
        assert spec is not None and spec.loader is not None
        module = importlib.util.module_from_spec(spec)
        sys.modules[PACKAGE] = module
        spec.loader.exec_module(module)
    return sys.modules[PACKAGE]


def arguments() -> list[str]:
    """Return the arguments meant for the script: what follows `--` in Blender, all of them in plain Python.

    Raises:
        F4xError: Blender without `--`.
    """
    if "--" in sys.argv:
        return sys.argv[sys.argv.index("--") + 1 :]
    if Path(sys.argv[0]).suffix != ".py":  # then it is Blender's own path, and all that follows is Blender's
        from feature4x.f4x_core.errors import F4xError

        raise F4xError("write -- before the arguments of the script: blender -b -P SCRIPT.py -- SCENE.f4x OUT.blend")
    return sys.argv[1:]


def scene(text: str) -> Path:
    """Return the path of the scene that a person gave; the folder of a fit means the scene in it."""
    inside = Path(text) / "scene.f4x"
    return inside if inside.is_file() else Path(text)


def run(main: Callable[[list[str]], dict[str, Any] | None]) -> None:
    """Run `main(arguments)` and leave with 0, 2 (one clear sentence) or 1 (traceback).

    What `main` returns, or `{"error": sentence}`, is the last line on standard output, as JSON.
    """
    load_extension()
    from feature4x.f4x_core.files import json_text
    from feature4x.f4x_core.printing import print_error, print_text
    from feature4x.f4x_core.troubles import EXPECTED, with_code

    code = 0
    try:
        result = main(arguments())
    except EXPECTED as error:
        sentence = with_code(error)
        print_error(f"error: {sentence}")
        result, code = {"error": sentence}, 2
    except SystemExit as exit_request:  # argparse: --help or a usage error
        result, code = None, exit_request.code if isinstance(exit_request.code, int) else 1
    except Exception:
        sys.excepthook(*sys.exc_info())
        result, code = None, 1
    if result is not None:
        try:
            print_text(json_text(result))
        except OSError as error:
            print_error(f"error: {with_code(error)}")
            code = 2
    end(code)


def end(code: int = 0) -> None:
    """End the process at once, as a Blender without a window has to."""
    load_extension()
    from feature4x.addon.common.process_exit import end_process

    end_process(code)


def end_at_errors() -> None:
    """Let an exception that nobody catches end the process, too, which hangs otherwise."""
    load_extension()
    from feature4x.addon.common import process_exit

    process_exit.end_at_errors()


def start_blender() -> None:
    """Start with an empty Blender scene and the registered classes of the extension."""
    import bpy

    bpy.ops.wm.read_factory_settings(use_empty=True)
    load_extension().register()


def import_scene(scene: Path) -> Any:
    """Import a scene file into the Blender scene that is open, as a window's import shows it; returns the root empty."""
    import bpy
    from feature4x.addon.common.render_settings import ENGINE
    from feature4x.addon.io.import_scene import import_scene
    from feature4x.addon.render import viewport

    root = import_scene(scene)
    target = bpy.context.scene
    target.render.engine = ENGINE
    target.cycles.samples = SAMPLES
    viewport.show(root, target.camera)
    return root


def import_empty(scene: Path) -> Any:
    """Import a scene file into an empty Blender; returns the root empty."""
    start_blender()
    return import_scene(scene)


def open_blend(path: Path) -> None:
    """Open a .blend without running its scripts. Raises F4xError if the file is not a .blend."""
    import bpy
    from feature4x.f4x_core.errors import F4xError

    try:
        bpy.ops.wm.open_mainfile(filepath=str(path.resolve()), use_scripts=False)
    except RuntimeError as error:
        reason = " ".join(str(error).split()).removeprefix("Error: ")
        raise F4xError(f"{path} cannot be opened ({reason}); give a .blend that this Blender can read.") from error


def save_blend(out: Path, size: int) -> None:
    """Save the current file as `out`. Raises F4xError if the folder cannot take a file of about `size` bytes."""
    import bpy
    from feature4x.f4x_core.errors import F4xError

    place = out.resolve()
    if place.suffix.lower() != ".blend":
        raise F4xError(f"{out} is no name of a Blender file; end it in .blend.")
    try:
        place.parent.mkdir(parents=True, exist_ok=True)
        # as Blender itself does from 5.0 on: colors over time shrink to two fifths, and open as fast
        bpy.ops.wm.save_as_mainfile(filepath=str(place), compress=True)
        with place.open("rb") as file:
            file.seek(max(place.stat().st_size - len(WHOLE), 0))
            ending = file.read()
        if ending != WHOLE:  # Blender does not notice when a disk is full
            place.unlink()
            raise OSError("it came out incomplete")
    except (OSError, RuntimeError) as error:
        refused = refusal(place.parent, size)
        reason = refused.strerror if refused else " ".join(str(error).split())
        raise F4xError(f"{out} cannot be written ({reason}); make room there or choose another place.") from (
            refused or error
        )


def refusal(folder: Path, size: int) -> OSError | None:
    """Return the error of writing `size` bytes into `folder`, else None: Blender reports a full disk as a missing file."""
    try:
        with tempfile.TemporaryFile(dir=folder) as file:
            file.write(bytes(size))
            file.flush()
    except OSError as error:
        return error
    return None


def frame_range(text: str | None, first: int, last: int) -> range:
    """Return the frames `A:B:S` (end left out) from `first` to `last`; all without `text`. F4xError for none, or outside."""
    from feature4x.f4x_core.errors import F4xError

    if text is None:
        return range(first, last + 1)
    try:
        if text.count(":") > 2:
            raise ValueError(text)
        begin, end, step = (f"{text}:::" if ":" in text else f"{text}:{int(text) + 1}:::").split(":")[:3]
        frames = range(int(begin or first), int(end or last + 1), int(step or 1))
    except (TypeError, ValueError) as error:
        raise F4xError(f"--frames {text}: write A:B:S, A:B or one frame.") from error
    if not frames or min(frames) < first or max(frames) > last:
        raise F4xError(f"--frames {text}: give frames from {first} to {last}.")
    return frames
