"""What the windows of a folder are made with: `--resume` with anything else is refused before the clip is read."""

import json
from collections.abc import Mapping
from pathlib import Path

from ..errors import F4xError
from ..files import json_text, replace_file

PLAN = Path("windows", "plan.json")
"""File in the folder of a fit in windows: option -> its value as text."""
WINDOW = "--window"
AT_ONCE = "0 (all at once)"
"""Value of `WINDOW` of a fit without windows, which leaves no plan but checkpoints."""


def remember(folder: Path, options: Mapping[str, str]) -> None:
    """Write what the windows that are about to be fitted in `folder` are made with."""
    (folder / PLAN).parent.mkdir(parents=True, exist_ok=True)
    with replace_file(folder / PLAN) as file:
        file.write(json_text(dict(options), indent=1).encode())


def forget(folder: Path) -> None:
    """Remove what `remember` wrote: another kind of fit begins."""
    (folder / PLAN).unlink(missing_ok=True)


def require_same(folder: Path, options: Mapping[str, str]) -> None:
    """Raise F4xError that names the first of `options` with which the fit in `folder` was not made; nothing if none is there."""
    if (folder / PLAN).is_file():
        made = json.loads((folder / PLAN).read_text())
    else:
        made = {WINDOW: AT_ONCE} if (folder / "checkpoints").is_dir() else {}
    for name, value in options.items():
        before = made.get(name, value)
        if before != value:
            joint = "=" if name.startswith("--set ") else " "
            raise F4xError(
                f"{folder}: the fit in this folder cannot be continued: it was made with {name}{joint}{before}, not {value};"
                " give that again, or fit without --resume, or into another folder."
            )
