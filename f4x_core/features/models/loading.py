"""Opens checkpoints from a local folder or the local cache of Hugging Face; nothing is ever downloaded here."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import torch

from ...errors import F4xError
from . import Checkpoint

try:
    import transformers
    from safetensors import SafetensorError
except ImportError as error:
    raise F4xError(
        f"This needs the package transformers ({error}); install it with: pip install transformers."
    ) from error

MODELS_FOLDER = "F4X_MODELS"
"""Environment variable: a folder whose sub-folders are checkpoints by their `Checkpoint.name`."""


def locate(entry: Checkpoint, model: str | Path | None = None) -> str:
    """Folder or hub id to open: `model` if given, else `$F4X_MODELS/<name>` if it is there, else the published id."""
    if model is not None:
        return str(model)
    own = Path(os.environ.get(MODELS_FOLDER, "")) / entry.name
    return str(own) if MODELS_FOLDER in os.environ and own.is_dir() else entry.hub


def name_of(entry: Checkpoint, model: str | Path | None = None) -> str:
    """What provenance calls the weights: the hub id, or a folder's own name (never its path)."""
    place = locate(entry, model)
    return Path(place).name if Path(place).is_dir() else place


def load(model_class: type, entry: Checkpoint, model: str | Path | None = None) -> Any:
    """The model in evaluation mode, float32 on the CPU, without gradients.

    Errors: F4xError when the weights are not here, are of another architecture, damaged or incomplete.
    """
    place = locate(entry, model)
    with _quiet():
        try:
            config = transformers.AutoConfig.from_pretrained(place, local_files_only=True)
        except (OSError, ValueError, KeyError) as error:
            raise _missing(entry, place, error) from error
        if config.model_type != entry.architecture:
            raise F4xError(
                f"{place}: these weights are a '{config.model_type}' model, '{entry.name}' needs '{entry.architecture}'."
            )
        try:
            loaded, report = model_class.from_pretrained(  # type: ignore[attr-defined]
                place, local_files_only=True, output_loading_info=True, dtype=torch.float32
            )
        except OSError as error:
            raise _missing(entry, place, error) from error
        except (SafetensorError, RuntimeError, ValueError, KeyError) as error:
            raise F4xError(
                f"{place}: the weights of '{entry.name}' cannot be read ({_line(error)}); fetch them again."
            ) from error
    absent = sorted(report["missing_keys"])
    if absent:
        raise F4xError(
            f"{place}: {len(absent)} weights of '{entry.name}' are missing (the first is {absent[0]}); fetch them again."
        )
    return loaded.eval().requires_grad_(False)


def load_tokenizer(entry: Checkpoint, model: str | Path | None = None) -> Any:
    """The tokenizer stored beside the weights; F4xError when it is not here."""
    place = locate(entry, model)
    with _quiet():
        try:
            return transformers.AutoTokenizer.from_pretrained(place, local_files_only=True)
        except (OSError, ValueError, KeyError, TypeError) as error:
            raise F4xError(f"{place}: the tokenizer of '{entry.name}' cannot be read ({_line(error)}).") from error


@contextmanager
def memory_guard(what: str) -> Iterator[None]:
    """Turn running out of memory into one sentence: `what` is being computed at which size."""
    try:
        yield
    except (MemoryError, torch.OutOfMemoryError) as error:
        raise F4xError(f"{what} does not fit in memory; choose a smaller picture or grid.") from error
    except RuntimeError as error:
        if "alloc" not in str(error) and "memory" not in str(error) and "overflow" not in str(error):
            raise
        raise F4xError(f"{what} does not fit in memory; choose a smaller picture or grid.") from error


@contextmanager
def _quiet() -> Iterator[None]:
    """Without the library's bars and advice: this program reports by itself."""
    logging = transformers.utils.logging
    level = logging.get_verbosity()
    logging.set_verbosity_error()
    logging.disable_progress_bar()
    try:
        yield
    finally:
        logging.set_verbosity(level)


def _missing(entry: Checkpoint, place: str, error: Exception) -> F4xError:
    if Path(place).is_dir():
        return F4xError(f"{place}: no checkpoint of '{entry.name}' can be read there ({_line(error)}).")
    return F4xError(
        f"The model '{entry.name}' ({place}) is not downloaded ({entry.megabytes} MB): f4x models get {entry.name}"
    )


def _line(error: Exception) -> str:
    """First line of a message, without its full stop."""
    return (str(error).strip() or type(error).__name__).splitlines()[0].rstrip(".")
