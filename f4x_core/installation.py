"""`python -m f4x_core.installation FOLDER`: an environment in which the core runs with all it can do.

Any Python of 3.11 or later makes it; only the standard library is needed. Reports as `processes` describes.
"""

import re
import subprocess
import sys
import tomllib
import venv
from pathlib import Path

from .errors import Cancelled, F4xError
from .processes import EXIT_INTERRUPTED, LineProgress, stop_with_parent
from .progress import Progress
from .troubles import EXPECTED, with_code

ROOT = Path(__file__).resolve().parents[1]
EXTRAS = ("cameras", "features", "endpoint")
"""Optional groups of pyproject.toml that a person at work in Blender wants."""
PINNED = ROOT / "scripts" / "requirements.txt"
"""Versions known to work together, on PINNED_PYTHON."""
PINNED_PYTHON = (3, 11)
WITHOUT_DEPENDENCIES = ROOT / "scripts" / "requirements-no-deps.txt"
MIN_PYTHON = (3, 11)
STEPS = 4
"""Environment, packages, models, trial."""


def interpreter_in(folder: Path) -> Path:
    """Return the Python of the environment in `folder`."""
    return folder / ("Scripts/python.exe" if sys.platform == "win32" else "bin/python")


def requirements() -> list[str]:
    """Return the requirements of the core for pip: the dependencies and EXTRAS of pyproject.toml."""
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    optional = project["optional-dependencies"]
    return [*project["dependencies"], *(entry for name in EXTRAS for entry in optional[name])]


def install(folder: Path, progress: Progress) -> Path:
    """Make the environment in `folder`, anew where there is one; returns its Python.

    Raises:
        F4xError: this Python is too old or makes no environments, `folder` holds something else, or pip failed.
    """
    if sys.version_info < MIN_PYTHON:
        found, minimum = (".".join(map(str, version[:2])) for version in (sys.version_info, MIN_PYTHON))
        raise F4xError(f"{sys.executable} is Python {found}; choose one of {minimum} or later.")
    progress("set up", 0, STEPS, "making the environment")
    if folder.is_dir() and any(folder.iterdir()) and not (folder / "pyvenv.cfg").is_file():
        raise F4xError(f"{folder} holds something else than an environment; name an empty folder, or a new one.")
    python = interpreter_in(folder)
    try:  # anew: the one that is there may belong to another Python, or be half made; pip keeps what it fetched
        venv.create(folder, with_pip=True, clear=True)
    except (OSError, subprocess.CalledProcessError) as error:
        raise F4xError(
            f"{sys.executable} cannot make an environment in {folder} ({error}); choose another Python, such as one"
            " from python.org."
        ) from error
    pinned = ["-c", str(PINNED)] if sys.version_info[:2] == PINNED_PYTHON else []
    _pip(python, [*pinned, *requirements()], lambda line: progress("set up", 1, STEPS, line))
    models = ["--no-deps", "-r", str(WITHOUT_DEPENDENCIES)]
    _pip(python, models, lambda line: progress("set up", 2, STEPS, line))
    progress("set up", 3, STEPS, "starting it once")
    _run([str(python), "-m", "f4x_core", "--version"], lambda line: None)
    progress("set up", STEPS, STEPS)
    return python


def _pip(python: Path, arguments: list[str], tell) -> None:
    _run([str(python), "-m", "pip", "install", "--progress-bar", "off", "--no-input", *arguments], tell)


def _run(command: list[str], tell) -> None:
    """Run `command` to its end, telling each line it says."""
    output = ""
    with subprocess.Popen(
        command, cwd=ROOT, stdin=subprocess.DEVNULL, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True
    ) as child:
        assert child.stdout is not None
        for line in child.stdout:
            output = line.strip() or output
            tell(_short(output))
    if child.returncode:
        raise F4xError(f"{' '.join(command[1:4])} failed: {output}")


def _short(line: str) -> str:
    """Return a line of pip without addresses and file paths."""
    return re.sub(r"\s*\(?(from|in) (http|file:|/|\w:\\).*", "", line)


def main(arguments: list[str]) -> int:
    """Install into the folder that is named, telling how far it is."""
    progress = LineProgress(sys.stdout)
    stop_with_parent()
    try:
        if len(arguments) != 1:
            raise F4xError("name one folder: python -m f4x_core.installation FOLDER")
        python = install(Path(arguments[0]).absolute(), progress)
    except EXPECTED as error:
        progress.tell(error=with_code(error))
        return 2
    except (KeyboardInterrupt, Cancelled):
        return EXIT_INTERRUPTED
    progress.tell(result={"python": str(python)}, text=f"{python} is set up.")
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
