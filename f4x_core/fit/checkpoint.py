"""Checkpoints that really resume: tensors and plain values in one file, written whole or not at all."""

from pathlib import Path
from typing import Any

import torch

from ..errors import F4xError
from ..files import replace_file

DAMAGED = "the checkpoint is damaged; delete it and fit again without --resume."


class OtherSettingsError(F4xError):
    """A checkpoint that was made with other settings or of another clip."""


def save_checkpoint(path: Path, state: dict[str, Any]) -> None:
    """Write `state` (nested dicts and lists of tensors, numbers and strings) whole or not at all."""
    path.parent.mkdir(parents=True, exist_ok=True)
    with replace_file(path) as file:
        try:
            torch.save(state, file)
        except RuntimeError as error:  # closing the archive fails too, and hides that the disk is full
            if isinstance(error.__context__, OSError):
                raise error.__context__ from None
            raise


def load_checkpoint(path: Path, config_hash: str) -> dict[str, Any] | None:
    """Read a checkpoint whose hash begins with `config_hash`; None when there is none.

    Raises:
        F4xError: the file is damaged; `OtherSettingsError`: it was made with other settings or of another clip.
    """
    if not path.is_file():
        return None
    try:
        state = torch.load(path, weights_only=True)
    except Exception as error:
        raise F4xError(f"{path}: {DAMAGED}") from error
    if not isinstance(state, dict) or not isinstance(state.get("config_hash", ""), str):
        raise F4xError(f"{path}: {DAMAGED}")
    if not state.get("config_hash", "").startswith(config_hash):
        raise OtherSettingsError(
            f"{path}: this checkpoint was made with other settings or another clip; fit without --resume, or into another folder."
        )
    return state
