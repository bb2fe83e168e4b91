"""Options that the fit in a folder was made with: `--resume` with others is refused by the name of the option."""

from collections.abc import Mapping
from pathlib import Path

from ..errors import F4xError
from ..files import json_text, replace_file
from ..reading import load_json, undamaged

PLAN = Path("windows", "plan.json")
"""File in the folder of a fit in windows: option -> its value as text."""
OPTIONS = Path("options.json")
"""Options of a fit at once. There a checkpoint decides, which knows the frames themselves: 0: and 0:60 may be the same."""
WINDOW = "--window"
AT_ONCE = "0 (all at once)"
"""Value of `WINDOW` of a fit without windows, which leaves no plan but checkpoints."""


def remember(folder: Path, options: Mapping[str, str]) -> None:
    """Write what the fit in `folder` is made with: windows before they begin, a fit at once when it has left a checkpoint."""
    file = folder / (OPTIONS if options[WINDOW] == AT_ONCE else PLAN)
    file.parent.mkdir(parents=True, exist_ok=True)
    with replace_file(file) as written:
        written.write(json_text(dict(options), indent=1).encode())


def window_of(folder: Path) -> int | None:
    """Return the frames of a window of the fit in `folder`, 0 for one at once; None where there is nothing to continue."""
    length = _made_with(folder).get(WINDOW)
    if length is None:
        return None
    return 0 if length == AT_ONCE else int(length)


def forget(folder: Path) -> None:
    """Remove what `remember` wrote: another fit begins."""
    for name in (PLAN, OPTIONS):
        (folder / name).unlink(missing_ok=True)


def require_same(folder: Path, options: Mapping[str, str]) -> None:
    """Raise F4xError that names the first of `options` with which the windows in `folder` were not made.

    Nothing if none is there; of a fit at once only that it is one, see `require_same_at_once`.
    """
    _require(folder, _made_with(folder), options)


def require_same_at_once(folder: Path, options: Mapping[str, str]) -> None:
    """Refuse other options for a fit at once whose checkpoint was refused; do nothing where no option tells why."""
    if (folder / OPTIONS).is_file():
        _require(folder, _read_options(folder / OPTIONS), options)


def _made_with(folder: Path) -> dict[str, str]:
    """Return the options of the windows in `folder`; of a fit at once only that it is one; nothing where none is there."""
    if (folder / PLAN).is_file():
        return _read_options(folder / PLAN)
    return {WINDOW: AT_ONCE} if (folder / "checkpoints").is_dir() else {}


def _read_options(path: Path) -> dict[str, str]:
    with undamaged(path, "delete it and fit again without --resume"):
        return dict(load_json(path))


def _require(folder: Path, made: Mapping[str, str], options: Mapping[str, str]) -> None:
    for name, value in options.items():
        before = made.get(name, value)
        if before != value:
            joint = "=" if name.startswith("--set ") else " "
            raise F4xError(
                f"{folder}: the fit in this folder cannot be continued: it was made with {name}{joint}{before}, not {value};"
                " give that again, or fit without --resume, or into another folder."
            )
