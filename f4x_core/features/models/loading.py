"""Opens checkpoints from a local folder or the local cache of Hugging Face; nothing is ever downloaded here."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import torch

from ...errors import F4xError
from ..weights import require_path
from . import CHECKPOINTS, Checkpoint

try:
    import transformers
    from safetensors import SafetensorError
except ImportError as error:
    raise F4xError(
        f"This needs the package transformers ({error}); install it with: pip install transformers."
    ) from error


@dataclass(frozen=True)
class Located:
    """Location of a model's weights."""

    entry: Checkpoint
    """The published weights."""
    place: str
    """Folder, or hub id in the local cache."""

    @property
    def name(self) -> str:
        """Name in provenance: the hub id, or a folder's own name (never its path)."""
        folder = Path(self.place)
        if folder.parent.name == "snapshots":  # the cache: models--OWNER--NAME/snapshots/REVISION
            return "/".join(folder.parents[1].name.split("--")[1:])
        return folder.name if folder.is_dir() else self.place

    def provenance(self, size: list[int]) -> dict[str, Any]:
        """Return the provenance that the spec of their maps records; `size`: (width, height) of a picture as the model takes it."""
        return {"model": self.name, "licence": self.entry.licence, "input": size}


def find(default: str, model: str | Path | None = None) -> Located:
    """Return the weights for the architecture of the checkpoint `default`.

    `model` is a folder, a hub id in the local cache, or a name of `CHECKPOINTS`; None is `default`. Errors: F4xError when the
    named one is not on this machine or is of another architecture.
    """
    name = default if model is None else str(model)
    entry = CHECKPOINTS.get(name, CHECKPOINTS[default])
    if entry.architecture != CHECKPOINTS[default].architecture:
        raise _another_architecture(name, entry.architecture, CHECKPOINTS[default])
    return Located(entry, str(require_path(name)) if name in CHECKPOINTS else name)


def load(model_class: type, weights: Located) -> Any:
    """Return the model in evaluation mode, float32 on the CPU, without gradients.

    Errors: F4xError when the weights are not here, are of another architecture, damaged or incomplete.
    """
    entry, place = weights.entry, weights.place
    with _quiet():
        try:
            config = transformers.AutoConfig.from_pretrained(place, local_files_only=True)
        except (OSError, ValueError, KeyError) as error:
            raise _missing(entry, place, error) from error
        if config.model_type != entry.architecture:
            raise _another_architecture(place, config.model_type, entry)
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


def load_tokenizer(weights: Located) -> Any:
    """Return the tokenizer stored beside the weights; F4xError when it is not here."""
    entry, place = weights.entry, weights.place
    with _quiet():
        try:
            return transformers.AutoTokenizer.from_pretrained(place, local_files_only=True)
        except (OSError, ValueError, KeyError, TypeError) as error:
            raise F4xError(f"{place}: the tokenizer of '{entry.name}' cannot be read ({_line(error)}).") from error


@contextmanager
def _quiet() -> Iterator[None]:
    """Silence the library's bars and advice: this program reports by itself."""
    logging = transformers.utils.logging
    level = logging.get_verbosity()
    logging.set_verbosity_error()
    logging.disable_progress_bar()
    try:
        yield
    finally:
        logging.set_verbosity(level)


def _another_architecture(place: str, found: str, entry: Checkpoint) -> F4xError:
    return F4xError(f"{place}: these weights are a '{found}' model, '{entry.name}' needs '{entry.architecture}'.")


def _missing(entry: Checkpoint, place: str, error: Exception) -> F4xError:
    if Path(place).is_dir():
        return F4xError(f"{place}: no checkpoint of '{entry.name}' can be read there ({_line(error)}).")
    return F4xError(f"{place} is neither a folder nor in the local cache of models; give a folder, or '{entry.name}'.")


def _line(error: Exception) -> str:
    """Return the first line of a message, without its full stop."""
    return (str(error).strip() or type(error).__name__).splitlines()[0].rstrip(".")
