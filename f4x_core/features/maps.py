"""Feature maps on disk: a folder per teacher, memory-mapped float16, at full width or projected onto a basis.

| file | shape, dtype | meaning |
|---|---|---|
| `spec.json` | | `FeatureSpec` |
| `maps.npy` | (T,h,w,C) or (T,h,w,k) float16 | one row per clip frame, held-out ones too |
| `basis.npy`, `mean.npy` | (k,C), (C,) float32 | only where projected: feature = `maps @ basis + mean` |
| `global.npy` | (C,) float32 | where the spec says so: one vector for the whole clip |
| `stored.json` | | `lost` (fraction of the variance that the projection dropped), `settings` (what the maps were made from) |

A folder appears under its name only when it is complete; until then it is called `.NAME.unfinished`. Torch-free.
"""

from __future__ import annotations

import io
import json
import math
import os
import shutil
import tempfile
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np

from ..errors import F4xError
from ..files import link_target, lock_file, neighbour
from ..progress import Progress, silent
from ..reading import DAMAGE, load_json, load_npy
from .spec import FeatureSpec

SPEC, STORED, PLAN = "spec.json", "stored.json", "plan.json"
HALF = "<f2"
UNREADABLE = (OSError, *DAMAGE)
"""Exceptions of numpy and json on damaged files."""


@dataclass(frozen=True, eq=False)
class FeatureMaps:
    """The maps of one teacher for all T frames of a clip."""

    folder: Path
    """Folder of the files."""
    spec: FeatureSpec
    """Width, grid and space of the features."""
    stored: np.ndarray
    """(T,h,w,k) float16, memory-mapped; k = C where nothing is projected."""
    basis: np.ndarray | None = None
    """(k,C) float32, orthonormal rows."""
    mean: np.ndarray | None = None
    """(C,) float32."""
    glob: np.ndarray | None = None
    """(C,) float32, the clip's own vector."""
    lost: float = 0.0
    """Fraction of the variance that the projection dropped, 0..1."""

    def __len__(self) -> int:
        return len(self.stored)

    def at(self, t: int) -> np.ndarray:
        """Return the features (h,w,C) float32 of clip frame `t`."""
        if not 0 <= t < len(self):
            raise F4xError(f"{self.folder}: there is no frame {t}; the maps cover frames 0 to {len(self) - 1}.")
        return self.expand(self.row(t).astype(np.float32))

    def row(self, t: int) -> np.ndarray:
        """Return the stored (h,w,k) float16 of clip frame `t` as a copy, so that no page of the mapping stays in memory."""
        stored, shape = self.stored, self.stored.shape[1:]
        if not isinstance(stored, np.memmap) or stored.filename is None or not stored.flags.c_contiguous:
            return np.array(stored[t])
        start = stored.offset + t * stored.strides[0]
        return np.fromfile(stored.filename, stored.dtype, math.prod(shape), offset=start).reshape(shape)

    def expand(self, stored: np.ndarray) -> np.ndarray:
        """Return values of full width (...,C) float32 from stored ones (...,k)."""
        return stored if self.basis is None else stored @ self.basis + self.mean


@dataclass(frozen=True)
class MapsPlan:
    """Contents of a folder of maps, known before the first is made."""

    spec: FeatureSpec
    count: int
    """Frames of the clip."""
    rank: int | None = None
    """Directions of largest variance, over all pixels of all maps, that are kept; below C the files are smaller. None: all."""
    settings: dict[str, Any] | None = None
    """Everything else that decides the values, for `read_stored`."""

    def __post_init__(self) -> None:
        """Refuse a rank below 1."""
        if self.rank is not None and self.rank < 1:
            raise F4xError(f"rank {self.rank}: keep at least one direction of '{self.spec.name}'.")

    @property
    def projected_to(self) -> int | None:
        """The rank, where it is below C."""
        return None if self.rank is None or self.rank >= self.spec.dim else self.rank

    def to_json(self) -> dict[str, Any]:
        """Return the plan as plain values."""
        spec = self.spec.to_json()
        return {"spec": spec, "count": self.count, "rank": self.projected_to, "settings": self.settings}


def write_maps(
    folder: Path | str,
    plan: MapsPlan,
    frames: Iterable[np.ndarray] | Callable[[int], Iterable[np.ndarray]],
    glob: np.ndarray | Callable[[], np.ndarray] | None = None,
    progress: Progress = silent,
) -> FeatureMaps:
    """Write maps (h,w,C), taken from `frames` one by one, as the folder of one teacher.

    `glob` may be a function, called after the last frame. The folder takes its name when everything is written; an error
    or a cancelled `progress` leaves whatever was there before. Where `frames` is a function of the first frame wanted, what
    was written stays beside it, and the next call with the same plan goes on from there. F4xError: wrong shapes or counts,
    values that are not finite in float16, a full disk, a folder that holds something else or that another call is writing.
    """
    spec, rank = plan.spec, plan.projected_to
    folder = link_target(folder)
    unfinished = neighbour(folder, "unfinished") if callable(frames) else None
    with _sole_writer(folder), replace_folder(folder, SPEC, unfinished) as part:
        _follow(part, plan.to_json())
        written = part / ("full.npy" if rank else "maps.npy")
        _write_frames(folder, written, plan, frames, progress)
        lost = 0.0 if rank is None else _project(written, rank, plan, progress)
        if spec.has_global:
            vector = np.asarray(glob() if callable(glob) else glob, np.float32)
            if vector.shape != (spec.dim,) or not np.isfinite(vector).all():
                raise F4xError(f"{folder}: the global vector of '{spec.name}' must be {spec.dim} finite numbers.")
            np.save(part / "global.npy", vector, allow_pickle=False)
        _write_json(part / SPEC, spec.to_json())
        _write_json(part / STORED, {"lost": lost, "settings": plan.settings or {}})
        (part / PLAN).unlink()
    return read_maps(folder)


def _write_frames(
    folder: Path,
    written: Path,
    plan: MapsPlan,
    frames: Iterable[np.ndarray] | Callable[[int], Iterable[np.ndarray]],
    progress: Progress,
) -> None:
    """Write the maps (h,w,C) of `frames` into the array file `written`, behind those that it has already.

    `folder` is what the maps become part of, for errors.
    """
    spec, count = plan.spec, plan.count
    stage, shape = f"features {spec.name}", (count, *spec.grid, spec.dim)
    done = _rows_in(written, shape)
    progress(stage, done, count)
    with _array_file(written, shape, done) as file:
        for frame in frames(done) if callable(frames) else frames:
            if done == count:
                raise F4xError(f"{folder}: more than the {count} maps that the clip has frames.")
            file.write(_checked(frame, spec, done).tobytes())
            done += 1
            progress(stage, done, count)
    if done != count:
        raise F4xError(f"{folder}: {done} maps for {count} frames; give one per frame of the clip.")


def _project(written: Path, rank: int, plan: MapsPlan, progress: Progress) -> float:
    """Replace the maps in the file `written` by their coordinates along the first `rank` principal directions.

    Writes maps, basis and mean beside it; returns the fraction of the variance that is lost.
    """
    full, moments, count, part = _load(written, mapped=True), _Moments(plan.spec.dim), plan.count, written.parent
    for frame in full:
        moments.add(frame)
    basis, mean, lost = moments.project(rank)
    with _array_file(part / "maps.npy", (count, *plan.spec.grid, rank)) as file:
        for t in range(count):
            file.write(((full[t].astype(np.float32) - mean) @ basis.T).astype(HALF).tobytes())
            progress(f"features {plan.spec.name}, rank {rank}", t + 1, count)
    np.save(part / "basis.npy", basis, allow_pickle=False)
    np.save(part / "mean.npy", mean, allow_pickle=False)
    del full  # Windows keeps mapped files from being removed
    written.unlink()
    return lost


def read_maps(folder: Path | str) -> FeatureMaps:
    """Open a teacher's folder, validated, with the maps still on disk; F4xError says what is missing or damaged."""
    folder = Path(folder)
    if not (folder / SPEC).is_file():
        raise F4xError(f"{folder} holds no feature maps (no {SPEC}); make them with `f4x features`.")
    spec = FeatureSpec.from_json(_read_json(folder / SPEC))
    stored = _load(folder / "maps.npy", mapped=True)
    basis = _load(folder / "basis.npy") if (folder / "basis.npy").exists() else None
    mean = _load(folder / "mean.npy") if basis is not None else None
    glob = _load(folder / "global.npy") if spec.has_global else None
    width = spec.dim if basis is None else len(basis)
    expected: list[tuple[str, np.ndarray | None, tuple[int, ...]]] = [
        ("maps.npy", stored, (len(stored) if stored.ndim else 0, *spec.grid, width)),
        ("basis.npy", basis, (width, spec.dim)),
        ("mean.npy", mean, (spec.dim,)),
        ("global.npy", glob, (spec.dim,)),
    ]
    for name, array, shape in expected:
        if array is not None and (array.shape != shape or array.dtype.kind != "f"):
            raise F4xError(
                f"{folder / name} is {array.dtype} of shape {array.shape}, the spec wants floats of shape {shape};"
                " make the maps again."
            )
    return FeatureMaps(folder, spec, stored, basis, mean, glob, float(read_stored(folder).get("lost", 0.0)))


def read_stored(folder: Path) -> dict[str, Any]:
    """Return `stored.json` of a folder, empty where a foreign tool wrote none."""
    path = folder / STORED
    return _read_json(path) if path.is_file() else {}


@contextmanager
def _sole_writer(folder: Path) -> Iterator[None]:
    """Keep other calls out of the maps `folder`: both would write into one unfinished neighbour."""
    folder.parent.mkdir(parents=True, exist_ok=True)
    busy = f"{folder}: another program is writing these feature maps; wait until it is done, or choose another folder"
    with lock_file(neighbour(folder, "lock"), busy):
        yield


@contextmanager
def replace_folder(folder: Path, mark: str, unfinished: Path | None = None) -> Iterator[Path]:
    """Yield a temporary neighbour that becomes `folder` when the block ends well, in place of what was there.

    Only a folder that holds the file `mark`, or nothing, is replaced; anything else is an F4xError, as is a failing disk.
    A symbolic link stays, and the folder that it leads to is replaced. The neighbour is called `unfinished`, if given, and then
    stays when the block ends otherwise, but for a failing disk.
    """
    folder = link_target(folder)
    if folder.exists() and not (folder / mark).is_file() and (not folder.is_dir() or any(folder.iterdir())):
        raise F4xError(f"{folder} exists and holds something else; choose another folder.")
    part, leave = unfinished, unfinished is not None
    try:
        folder.parent.mkdir(parents=True, exist_ok=True)
        if part is None:
            part = Path(tempfile.mkdtemp(dir=folder.parent, prefix=neighbour(folder, "").name, suffix=".part"))
        part.mkdir(exist_ok=True)
        yield part
        part.chmod(0o755)  # mkdtemp gives 0700
        old = part.with_suffix(".old")
        if folder.exists():
            os.replace(folder, old)
        os.replace(part, folder)
        shutil.rmtree(old, ignore_errors=True)
    except OSError as error:
        leave = False
        reason = error.strerror or str(error)
        raise F4xError(f"{folder}: cannot be written ({reason}); check the folder and the free space.") from error
    finally:
        if part is not None and not leave:
            shutil.rmtree(part, ignore_errors=True)


def _follow(part: Path, plan: dict[str, Any]) -> None:
    """Empty the folder `part` unless the run that began it had the same plan, and write the plan there."""
    wanted = json.loads(json.dumps(plan))
    try:
        if _read_json(part / PLAN) == wanted:
            return
    except F4xError:
        pass  # there is none, or half of one
    for file in part.iterdir():
        file.unlink()
    _write_json(part / PLAN, wanted)


class _Moments:
    """Sums over all cells of all frames, in float64: enough for the principal directions without a second look."""

    def __init__(self, dim: int):
        self.count, self.sum, self.square = 0, np.zeros(dim), np.zeros((dim, dim))

    def add(self, frame: np.ndarray) -> None:
        """Take in one map (h,w,C)."""
        cells = frame.reshape(-1, frame.shape[-1]).astype(np.float32)
        self.count += len(cells)
        self.sum += cells.sum(0, dtype=np.float64)
        self.square += cells.T @ cells

    def project(self, rank: int) -> tuple[np.ndarray, np.ndarray, float]:
        """Return (basis (k,C), mean (C,), fraction of the variance that is lost)."""
        mean = self.sum / self.count
        values, vectors = np.linalg.eigh(self.square / self.count - np.outer(mean, mean))  # ascending
        values = np.maximum(values, 0)
        total = values.sum()
        lost = float(values[:-rank].sum() / total) if total > 0 else 0.0
        return vectors[:, ::-1][:, :rank].T.astype(np.float32), mean.astype(np.float32), lost


def _checked(frame: np.ndarray, spec: FeatureSpec, t: int) -> np.ndarray:
    if frame.shape != (*spec.grid, spec.dim):
        raise F4xError(f"'{spec.name}': the map of frame {t} is {frame.shape}, expected {(*spec.grid, spec.dim)}.")
    with np.errstate(over="ignore"):
        half = np.asarray(frame, HALF)
    if not np.isfinite(half).all():
        raise F4xError(f"'{spec.name}': the map of frame {t} has values that are NaN, infinite or beyond 65504.")
    return half


@contextmanager
def _array_file(path: Path, shape: tuple[int, ...], rows: int = 0) -> Iterator[BinaryIO]:
    """Open a float16 `.npy` file to append behind the `rows` that it has.

    Writing to a mapping would kill the process when the disk is full.
    """
    header = _header(shape)
    with path.open("r+b" if rows else "wb") as file:
        if not rows:
            file.write(header)
        file.truncate(len(header) + rows * _row_bytes(shape))
        file.seek(0, os.SEEK_END)
        yield file


def _rows_in(path: Path, shape: tuple[int, ...]) -> int:
    """Return the number of whole rows that a run has left in the file, which may end in half of one."""
    size = path.stat().st_size if path.is_file() else 0
    return max(0, (size - len(_header(shape))) // _row_bytes(shape))


def _header(shape: tuple[int, ...]) -> bytes:
    buffer = io.BytesIO()
    np.lib.format.write_array_header_1_0(buffer, {"descr": HALF, "fortran_order": False, "shape": shape})
    return buffer.getvalue()


def _row_bytes(shape: tuple[int, ...]) -> int:
    return math.prod(shape[1:]) * np.dtype(HALF).itemsize


def _load(path: Path, mapped: bool = False) -> np.ndarray:
    try:
        return load_npy(path, mapped)
    except FileNotFoundError as error:
        raise F4xError(f"{path} is missing; make the feature maps again.") from error
    except UNREADABLE as error:
        raise F4xError(f"{path} is not a readable .npy array ({error}); make the feature maps again.") from error


def _read_json(path: Path) -> Any:
    try:
        return load_json(path)
    except (ValueError, OSError) as error:
        raise F4xError(f"{path} is not readable JSON ({error}); make the feature maps again.") from error


def _write_json(path: Path, value: Any) -> None:
    path.write_text(json.dumps(value, indent=1), encoding="utf-8")
