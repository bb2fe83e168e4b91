"""The priors folder: plain files that providers write and the fit reads.

F counts supervised frames only, H x W are picture pixels, N tracks, M people. Any file may be replaced by the user's own.

| file | shape, dtype | meaning |
|---|---|---|
| `priors.json` | | version, size, `frames` (F clip indices), fps, `camera_kind`, provenance, warnings, statistics |
| `cameras.json` | CameraPath of F frames | world unit = median depth 1 |
| `depth.npy`, `depth_confidence.npy` | (F,H,W) float32, float16 | z depth in world units, NaN = unknown; trust 0..1 |
| `flow_forward.npy`, `flow_backward.npy` | (F-1,H,W,2) float16 | pixels; supervised frame i -> i+1 and i+1 -> i |
| `flow_forward_mask.npy`, `flow_backward_mask.npy` | (F-1,H,W) bool | forward-backward consistent |
| `motion.npy`, `mask.npy` | (F,H,W) float16, bool | soft 0..1 "moves by itself"; the moving foreground |
| `tracks.npy`, `tracks_visible.npy` | (F,N,2) float32, (F,N) bool | pixels (pixel centres at +0.5), NaN = unknown |
| `tracks_motion.npy` | (N,) float32 | 0..1 how surely the track moves by itself |
| `people.npy`, `people_probability.npy` | (F,H,W) uint8, float16 | who of M people is seen, + 1 (0 = nobody), and how surely |
| `people_joints.npy` | (F,M,33,3) float32 | x, y in pixels and visibility 0..1 (`joints.NAMES`); NaN = not in the frame |
| `people_metres.npy` | (F,M,33,3) float32 | the same joints in metres from between the hips, z along the ray to there |
"""

from __future__ import annotations

import hashlib
import io
import json
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from ..errors import F4xError
from ..files import replace_file
from ..reading import DAMAGE, load_json, load_npy, reason
from ..versions import PRIORS
from .joints import JOINTS

if TYPE_CHECKING:
    from ..clip import Clip
    from ..geometry.camera import CameraPath

CAMERA_KINDS = ("moving", "pan", "static")
ARRAYS: dict[str, tuple[str, type]] = {
    "depth": ("FHW", np.float32),
    "depth_confidence": ("FHW", np.float16),
    "flow_forward": ("PHW2", np.float16),
    "flow_backward": ("PHW2", np.float16),
    "flow_forward_mask": ("PHW", np.bool_),
    "flow_backward_mask": ("PHW", np.bool_),
    "motion": ("FHW", np.float16),
    "mask": ("FHW", np.bool_),
    "tracks": ("FN2", np.float32),
    "tracks_visible": ("FN", np.bool_),
    "tracks_motion": ("N", np.float32),
    "people": ("FHW", np.uint8),
    "people_probability": ("FHW", np.float16),
    "people_joints": ("FMJ3", np.float32),
    "people_metres": ("FMJ3", np.float32),
}
"""Name -> axes and dtype. F frames, P = F - 1 pairs, H, W pixels, N tracks, M people, J joints; a digit is a fixed length."""
FIELDS = (*ARRAYS, "cameras")
REMEMBERED = ("camera_kind", "provenance", "warnings", "statistics")
"""Entries of `priors.json` that a later run goes on with."""
UNIT_INTERVAL = ("depth_confidence", "motion", "tracks_motion", "people_probability")
UNREADABLE = (OSError, *DAMAGE)
"""Raised on damaged `.npy` and `.npz` files, and by a system that does not give them."""
OUTSIDE_TOLERANCE = 0.5
"""Fraction of visible track samples that may lie outside before the tracks are taken for another picture size."""


@dataclass
class Scratch:
    """Data that stages share within one run; never written."""

    long_flows: dict[int, np.ndarray] | None = None
    """Flows over longer gaps (`flow.long_flows`)."""
    seen_depth: np.ndarray | None = None
    """(F,H,W) depth in any unit that is known from elsewhere, NaN = unknown."""
    of_providers: dict[str, Any] = field(default_factory=dict)
    """Results that a provider of several stages computes once, under a name of its own."""


@dataclass
class Priors:
    """All priors of one clip in memory; a field is None until its provider has run. Shapes: see the module text."""

    width: int
    height: int
    frames: np.ndarray  # (F,) int64 clip indices, ascending, held-out ones left out
    fps: float = 24.0
    camera_kind: str | None = None
    cameras: CameraPath | None = None
    depth: np.ndarray | None = None
    depth_confidence: np.ndarray | None = None
    flow_forward: np.ndarray | None = None
    flow_backward: np.ndarray | None = None
    flow_forward_mask: np.ndarray | None = None
    flow_backward_mask: np.ndarray | None = None
    motion: np.ndarray | None = None
    mask: np.ndarray | None = None
    tracks: np.ndarray | None = None
    tracks_visible: np.ndarray | None = None
    tracks_motion: np.ndarray | None = None
    people: np.ndarray | None = None
    people_probability: np.ndarray | None = None
    people_joints: np.ndarray | None = None
    people_metres: np.ndarray | None = None
    provenance: dict[str, dict[str, Any]] = field(default_factory=dict)
    warnings: list[str] = field(default_factory=list)
    statistics: dict[str, Any] = field(default_factory=dict)
    scratch: Scratch = field(default_factory=Scratch, repr=False, compare=False)

    @classmethod
    def empty(cls, clip: Clip) -> Priors:
        """Return a folder without priors, with the size and supervised frames of `clip`."""
        _, height, width, _ = clip.frames.shape
        return cls(width=width, height=height, frames=np.asarray(clip.supervised, np.int64), fps=float(clip.fps))

    def warn(self, message: str) -> None:
        """Keep one sentence for the diagnostics page (once)."""
        if message not in self.warnings:
            self.warnings.append(message)

    def store_depth(self, depth: np.ndarray, confidence: np.ndarray, median: float) -> float:
        """Store `depth (F, H, W)`, in units of the cameras, and its confidence; returns the world unit, measured in the old one.

        The world unit becomes the `median` depth, and the cameras are scaled along. Given cameras keep their unit, and the depth
        stays in it.
        """
        assert self.cameras is not None
        given = self.provenance.get("cameras", {}).get("provider") in ("user", "files")
        unit = 1.0 if given else median
        if not given:
            self.cameras = self.cameras.scaled_world(1 / unit)
        self.depth = (depth / unit).astype(np.float32)
        self.depth_confidence = np.clip(confidence, 0, 1).astype(np.float16)
        return unit

    def expected_shape(self, name: str) -> tuple[int | None, ...]:
        """Return the shape that array `name` must have; None where the number of tracks is free."""
        count = None if self.tracks is None else self.tracks.shape[1]
        sizes: dict[str, int | None] = {
            "F": len(self.frames),
            "P": max(len(self.frames) - 1, 0),
            "H": self.height,
            "W": self.width,
        }
        people = None if self.people_joints is None else self.people_joints.shape[1]
        sizes |= {"N": count, "M": people, "J": JOINTS}
        return tuple(int(axis) if axis.isdigit() else sizes[axis] for axis in ARRAYS[name][0])

    def validate(self, fields: Iterable[str] = FIELDS, sources: Mapping[str, str] | None = None) -> None:
        """Check the present ones of `fields`; F4xError names the first problem. Tracks outside turn invisible.

        `sources`: what the sentence calls the origin of a field, by name; its bare file name when left out.
        """
        source = {name: file_of(Path(), name).name for name in FIELDS} | dict(sources or {})
        for name in fields:
            if getattr(self, name) is None:
                continue
            if name == "cameras":
                self._validate_cameras(source["cameras"])
                continue
            self._validate_array(name, source[name])
        if "depth" in fields and self.depth is not None:
            self._validate_depth(source["depth"])
        if "tracks" in fields and self.tracks is not None and self.tracks_visible is not None:
            self._validate_tracks(source["tracks"], source["tracks_visible"])
        if self.people is not None and self.people_joints is not None and {"people", "people_joints"} & set(fields):
            self._validate_people(source["people"], source["people_joints"])
        if self.camera_kind is not None and self.camera_kind not in CAMERA_KINDS:
            raise F4xError(f"priors.json: camera_kind is '{self.camera_kind}'; use one of {', '.join(CAMERA_KINDS)}.")

    def _validate_array(self, name: str, source: str) -> None:
        array, expected, dtype = getattr(self, name), self.expected_shape(name), ARRAYS[name][1]
        if array.ndim != len(expected) or any(e not in (None, n) for e, n in zip(expected, array.shape, strict=True)):
            wanted = "(" + ", ".join("any" if e is None else str(e) for e in expected) + ")"
            raise F4xError(
                f"{source} has shape {array.shape}, this clip needs {wanted} for its {len(self.frames)}"
                " supervised frames; make it again at this size."
            )
        if array.dtype != dtype:
            raise F4xError(f"{source} has dtype {array.dtype}; save it as {np.dtype(dtype).name}.")
        if name.startswith("flow") and array.dtype != np.bool_ and not np.isfinite(array).all():
            raise F4xError(f"{source} contains NaN or infinite flow; use 0 and clear {name}_mask.npy there.")
        if name in UNIT_INTERVAL and not ((array >= 0) & (array <= 1)).all():
            raise F4xError(f"{source} leaves the range 0..1 (or is NaN); rescale it.")

    def _validate_depth(self, source: str) -> None:
        assert self.depth is not None
        valid = np.isfinite(self.depth) & (self.depth > 0)
        if not valid.any():
            raise F4xError(f"{source} holds no positive depth at all; write z depth, NaN = unknown.")
        empty = self.frames[~valid.any(axis=(1, 2))]
        if len(empty):
            raise F4xError(f"{source} has no positive depth in clip frame {empty[0]}; fill it or leave the frame out.")
        if (self.depth[np.isfinite(self.depth)] <= 0).any():
            raise F4xError(f"{source} holds zero or negative depth; write NaN where depth is unknown.")

    def _validate_tracks(self, source: str, visible_source: str) -> None:
        assert self.tracks is not None and self.tracks_visible is not None
        known = np.isfinite(self.tracks).all(-1)  # (F, N)
        if (self.tracks_visible & ~known).any():
            raise F4xError(f"{visible_source} is true where {source} is NaN; clear it there.")
        inside = (self.tracks >= 0).all(-1) & (self.tracks[..., 0] <= self.width) & (self.tracks[..., 1] <= self.height)
        visible, outside = self.tracks_visible.sum(), (self.tracks_visible & ~inside).sum()
        if outside > OUTSIDE_TOLERANCE * visible:
            raise F4xError(
                f"{source}: {outside} of {visible} visible samples lie outside {self.width}x{self.height};"
                " give (x, y) in pixels of this clip's size."
            )
        if outside:
            self.tracks_visible = self.tracks_visible & inside

    def _validate_people(self, source: str, joints_source: str) -> None:
        assert self.people is not None and self.people_joints is not None
        last, count = int(self.people.max(initial=0)), self.people_joints.shape[1]
        if last > count:
            raise F4xError(f"{source} shows person {last}, {joints_source} has {count} people; number both alike.")
        visibility = self.people_joints[..., 2]
        known = np.isfinite(visibility)
        if not ((visibility[known] >= 0) & (visibility[known] <= 1)).all():
            raise F4xError(
                f"{joints_source}: the visibility of joints (their third number) leaves the range 0..1; rescale it."
            )

    def _validate_cameras(self, source: str) -> None:
        path = self.cameras
        assert path is not None
        if len(path) != len(self.frames):
            raise F4xError(f"{source} has {len(path)} cameras, this clip has {len(self.frames)} supervised frames.")
        if (path.width, path.height) != (self.width, self.height):
            raise F4xError(
                f"{source} is for {path.width}x{path.height} pictures, this clip is {self.width}x{self.height};"
                " rescale the intrinsics."
            )
        if not (np.isfinite(path.intrinsics).all() and np.isfinite(path.world_to_camera).all()):
            raise F4xError(f"{source} contains NaN; every supervised frame needs a finite camera.")

    @classmethod
    def read(cls, folder: str | Path) -> Priors:
        """Read and validate whatever `folder` holds; F4xError when it is not a priors folder or a file is damaged."""
        folder = Path(folder)
        head = read_head(folder)
        try:
            priors = cls(
                width=int(head["width"]),
                height=int(head["height"]),
                frames=np.asarray(head["frames"], np.int64),
                fps=float(head["fps"]),
                camera_kind=head["camera_kind"],
                provenance=head["provenance"],
                warnings=head["warnings"],
                statistics=head["statistics"],
            )
            if priors.frames.ndim != 1:
                raise ValueError("'frames' is no list of numbers")
        except (KeyError, TypeError, ValueError, OverflowError) as error:
            raise F4xError(f"{folder / 'priors.json'} is damaged ({error!r}); build the priors again.") from error
        for name in FIELDS:
            if file_of(folder, name).exists():
                setattr(priors, name, read_field(folder, name))
        priors.validate(sources=sources_in(folder))
        return priors

    def write(self, folder: str | Path, fields: Iterable[str] = FIELDS) -> None:
        """Write `priors.json` and the present ones of `fields`, each file atomically.

        `priors.json` goes first and carries the digests of the files before and after: a write that is cut short leaves
        files that are either the old or the new ones, and known as ours either way (`build` must not take them for the
        user's).
        """
        folder = Path(folder)
        folder.mkdir(parents=True, exist_ok=True)
        content = {name: _encode(getattr(self, name)) for name in fields if getattr(self, name) is not None}
        for name, data in content.items():
            entry = self.provenance.setdefault(name, {})
            entry["previous"], entry["digest"] = entry.get("digest"), _digest_bytes(data)
        head = {
            "version": PRIORS,
            "width": self.width,
            "height": self.height,
            "frames": [int(frame) for frame in self.frames],
            "fps": self.fps,
            "camera_kind": self.camera_kind,
            "provenance": self.provenance,
            "warnings": self.warnings,
            "statistics": self.statistics,
        }
        for path, data in [(folder / "priors.json", _encode(head))] + [
            (file_of(folder, name), data) for name, data in content.items()
        ]:
            if path.is_symlink():  # a person's file elsewhere, which stays as it is
                path.unlink()
            with replace_file(path) as file:
                file.write(data)


def file_of(folder: Path, name: str) -> Path:
    """Return the path of the file of prior `name`."""
    return folder / (f"{name}.json" if name == "cameras" else f"{name}.npy")


def sources_in(folder: Path) -> dict[str, str]:
    """Return the whole path of every prior's file, for `Priors.validate`."""
    return {name: str(file_of(folder, name)) for name in FIELDS}


def read_head(folder: Path) -> dict[str, Any]:
    """Return `priors.json` as a dict; F4xError when it is missing, damaged or too new."""
    path = folder / "priors.json"
    try:
        head = load_json(path)
    except FileNotFoundError as error:
        raise F4xError(f"{folder} is not a priors folder (no priors.json); build the priors first.") from error
    except (OSError, ValueError) as error:
        raise F4xError(f"{path} is not readable JSON ({error}); build the priors again.") from error
    if not isinstance(head, dict) or head.get("version") != PRIORS:
        raise F4xError(f"{path} is not of version {PRIORS}; build the priors again with this program.")
    missing = [name for name in REMEMBERED if name not in head]
    if missing:
        raise F4xError(f"{path} is damaged (it lacks '{missing[0]}'); delete it and build the priors again.")
    return head


def read_field(folder: Path, name: str) -> Any:
    """Read one prior from its file, unvalidated."""
    path = file_of(folder, name)
    if name == "cameras":
        from ..geometry.camera import CameraPath

        return CameraPath.read(path)
    try:
        return load_npy(path)
    except UNREADABLE as error:
        raise F4xError(f"{path} is not a readable .npy array ({reason(error)}); replace or delete it.") from error


def digest(path: Path) -> str:
    """Return the hex digest of a file's bytes, which differs where a user replaced a provider's file."""
    return _digest_bytes(path.read_bytes())


def _digest_bytes(data: bytes) -> str:
    return hashlib.blake2b(data, digest_size=16).hexdigest()


def _encode(value: Any) -> bytes:
    """Return the bytes of a file: `.npy` of an array, JSON of a camera path or of plain values."""
    if isinstance(value, np.ndarray):
        buffer = io.BytesIO()
        np.save(buffer, value, allow_pickle=False)
        return buffer.getvalue()
    plain = value.to_json() if hasattr(value, "to_json") else value
    return json.dumps(plain, indent=1, allow_nan=False).encode()
