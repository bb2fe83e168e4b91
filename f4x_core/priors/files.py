"""The user's own priors: arrays of the clip, single files or folders of per-frame files, in place of a provider's.

Accepted for a prior: `.npy`, `.npz` (the array named like the prior, else the only one), or a folder with one `.npy`,
`.npz` or `.png` per frame in the order of the names, for all frames of the clip or for the supervised ones only. Masks and
depth of another size but the same shape of picture are resized; PNG masks are foreground where not black, 16-bit PNG depth
is read as integers with 0 = unknown, PNG people hold their numbers, 0 = nobody. Cameras are a `cameras.json` as
`CameraPath.write` makes it.
"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from ..clip.images import resize_nearest
from ..errors import F4xError
from ..reading import load_npy, open_npz, reason, require_picture
from .config import PriorsConfig
from .flow import consistent
from .folder import ARRAYS, FIELDS, UNREADABLE, Priors, sources_in

if TYPE_CHECKING:
    from ..clip import Clip
    from ..geometry.camera import CameraPath

RESIZABLE = ("mask", "motion", "depth", "depth_confidence", "people", "people_probability")
ASPECT_TOLERANCE = 0.01
"""Relative difference of width / height up to which a map of another size is taken for the same picture."""
STATIC_SHIFT, STATIC_DEGREES = 1e-4, 0.05
"""A given camera that moves (world units) and turns less than this stands still."""


def take(priors: Priors, clip: Clip, config: PriorsConfig, own: list[str], folder: Path) -> list[str]:
    """Put everything the user gave into `priors` (validated) and return the names that no provider may touch.

    `own` are files of `folder` that are loaded already; they win over `config.files`, those over the clip's arrays.
    What follows from given priors alone is derived: confidence of depth, visibility of tracks, flow masks, camera kind.
    """
    for name, path in config.files.items():
        if name not in FIELDS:
            raise F4xError(f"There is no prior '{name}' to take from {path}; known ones: {', '.join(FIELDS)}.")
    given: dict[str, tuple[Any, str]] = {}
    for name, value in (("mask", clip.masks), ("depth", clip.depth), ("cameras", clip.cameras)):
        if value is not None:
            given[name] = (value, clip.source if isinstance(clip.source, str) else str(clip.source))
    given |= {name: (_read(name, Path(path), clip), str(path)) for name, path in config.files.items()}
    for name in own:
        given.pop(name, None)
    for name, (value, source) in given.items():
        setattr(priors, name, _fit(name, value, source, priors, clip))
    if {"depth", "cameras"} <= set(given):
        _set_unit(priors)
    sources = sources_in(folder) | {name: f"{source} (given for {name})" for name, (_, source) in given.items()}
    _require_people(priors, {*own, *given}, sources)
    derived = _derive(priors, (*own, *given))
    for name, value in derived.items():
        setattr(priors, name, value)
    fixed = [*own, *given, *derived]
    priors.validate(fixed, sources)
    for name in (*given, *derived):
        entry = {"provider": "files", "settings": {"source": given[name][1] if name in given else "derived"}}
        priors.provenance[name] = entry | {"key": "given", "digest": priors.provenance.get(name, {}).get("digest")}
    return fixed


def _require_people(priors: Priors, fixed: set[str], sources: dict[str, str]) -> None:
    """Raise F4xError where the user's files on people leave open whose they are."""
    for name in ("people_probability", "people_joints", "people_metres"):
        if name in fixed and "people" not in fixed:
            raise F4xError(
                f"{sources[name]} needs people.npy beside it, which tells who is seen where; give both or neither."
            )
    for name, other in (("people_joints", "people_metres"), ("people_metres", "people_joints")):
        if name in fixed and other not in fixed:
            raise F4xError(f"{sources[name]} needs {other}.npy beside it; give both or neither.")
    if "people" in fixed and "people_joints" not in fixed and priors.people is not None:
        numbers = np.unique(priors.people)
        last, count = int(numbers.max(initial=0)), int((numbers > 0).sum())
        if last != count:
            raise F4xError(
                f"{sources['people']} shows {count} people but numbers them up to {last}; use 0 for nobody, then 1, 2, 3."
            )


def _read(name: str, path: Path, clip: Clip) -> Any:
    """Return the array or camera path in a file or folder."""
    if not path.exists():
        raise F4xError(f"{path} (given for {name}) does not exist; correct the path.")
    if name == "cameras":
        from ..geometry.camera import CameraPath

        return CameraPath.read(path / "cameras.json" if path.is_dir() else path)
    if not path.is_dir():
        return _read_array(name, path)
    files = sorted(file for file in path.iterdir() if file.suffix.lower() in (".npy", ".npz", ".png"))
    if not files:
        raise F4xError(f"{path} (given for {name}) holds no .npy, .npz or .png files; put one per frame there.")
    arrays = [_read_array(name, file) for file in files]
    for file, array in zip(files, arrays, strict=True):
        if array.shape != arrays[0].shape:
            raise F4xError(f"{file} has shape {array.shape}, {files[0].name} has {arrays[0].shape}; make them equal.")
    return np.stack(arrays)


def _read_array(name: str, path: Path) -> np.ndarray:
    """Read one array from `.npy`, `.npz` or `.png`."""
    suffix = path.suffix.lower()
    if suffix == ".png":
        import cv2

        try:
            require_picture(path)
        except ValueError as error:
            raise F4xError(f"{path} is not a readable PNG ({error}); write it again.") from error
        data = np.fromfile(path, np.uint8)  # not by its name: OpenCV ends the process where that is no UTF-8
        picture = cv2.imdecode(data, cv2.IMREAD_UNCHANGED) if len(data) else None
        if picture is None:
            raise F4xError(f"{path} is not a readable PNG; write it again.")
        if name == "mask":
            colour = picture[..., :3].max(-1) if picture.ndim == 3 else picture  # alpha tells nothing about the mask
            return colour > 0
        if picture.ndim == 3 or name not in RESIZABLE:
            raise F4xError(f"{path} cannot hold {name}; give .npy, or for depth a grey PNG of 16 bits.")
        if name == "depth":
            return np.where(picture > 0, picture.astype(np.float32), np.nan)
        if name == "people":
            return picture
        return picture.astype(np.float32) / (65535 if picture.dtype == np.uint16 else 255)
    try:
        if suffix != ".npz":
            return load_npy(path)
        with open_npz(path) as arrays:
            if name not in arrays and len(arrays) != 1:
                raise F4xError(f"{path} holds {', '.join(arrays)}; name the array '{name}'.")
            return arrays[name if name in arrays else next(iter(arrays))]
    except UNREADABLE as error:
        raise F4xError(
            f"{path} (given for {name}) is not a readable NumPy file ({reason(error)}); write it again."
        ) from error


def _fit(name: str, value: Any, source: str, priors: Priors, clip: Clip) -> Any:
    """Select the supervised frames, resize maps, and bring an array to the dtype of the folder."""
    supervised, total = np.asarray(clip.supervised), len(clip.frames)
    if name == "cameras":
        return _fit_cameras(value, source, priors, supervised, total)
    axes, dtype = ARRAYS[name]
    if value.ndim != len(axes):
        raise F4xError(f"{source}: {name} has shape {value.shape}; its axes must be {' '.join(axes)}.")
    if value.dtype.kind not in "biuf":
        raise F4xError(f"{source}: {name} has dtype {value.dtype}; save it as {np.dtype(dtype).name}.")
    if name == "people" and not np.isin(value, np.arange(256)).all():
        raise F4xError(
            f"{source}: people holds other numbers than whole ones from 0 (nobody) to 255; give who is seen where."
        )
    if axes[0] == "F" and len(value) == total:
        value = value[supervised]
    if name in RESIZABLE and value.shape[1:] != (priors.height, priors.width):
        value = _resize(name, value, source, priors)
    if dtype == np.bool_ and value.dtype != np.bool_:
        value = value > (0.5 if np.issubdtype(value.dtype, np.floating) else 0)
    if name == "depth":
        with np.errstate(invalid="ignore"):
            value = np.where(np.isfinite(value) & (value > 0), value, np.nan)
    return np.ascontiguousarray(value.astype(dtype))


def _fit_cameras(path: CameraPath, source: str, priors: Priors, supervised: np.ndarray, total: int) -> CameraPath:
    """Return the cameras of the supervised frames at the clip's size."""
    from ..geometry.camera import CameraPath

    if len(path) == total:
        path = CameraPath(
            path.intrinsics[supervised],
            path.world_to_camera[supervised],
            path.times[supervised],
            path.width,
            path.height,
        )
    if abs(path.width * priors.height / (path.height * priors.width) - 1) > ASPECT_TOLERANCE:
        raise F4xError(
            f"{source}: the cameras are for {path.width}x{path.height}, the clip is {priors.width}x{priors.height};"
            " give cameras of this picture."
        )
    return path.resized(priors.width, priors.height)


def _resize(name: str, value: np.ndarray, source: str, priors: Priors) -> np.ndarray:
    """Resize maps (F,h,w) to the clip's size by the nearest pixel; F4xError where the aspect differs."""
    height, width = value.shape[1:]
    if height == 0 or width == 0 or abs(width * priors.height / (height * priors.width) - 1) > ASPECT_TOLERANCE:
        raise F4xError(
            f"{source}: {name} is {width}x{height}, the clip {priors.width}x{priors.height}; give it for this picture."
        )
    return resize_nearest(value, priors.width, priors.height)


def _set_unit(priors: Priors) -> None:
    """Bring given cameras and depth, which share a unit, to the world unit: median depth 1."""
    assert priors.cameras is not None and priors.depth is not None
    if np.isfinite(priors.depth).any():
        scale = 1 / float(np.nanmedian(priors.depth))
        priors.cameras, priors.depth = priors.cameras.scaled_world(scale), priors.depth * np.float32(scale)


def _derive(priors: Priors, fixed: tuple[str, ...]) -> dict[str, Any]:
    """Derive the priors that follow from the given ones alone, so that no provider has to run for them."""
    derived: dict[str, Any] = {}
    if "depth" in fixed and "depth_confidence" not in fixed:
        derived["depth_confidence"] = np.isfinite(priors.depth).astype(np.float16)  # type: ignore[arg-type]
    if "tracks" in fixed and "tracks_visible" not in fixed:
        derived["tracks_visible"] = np.isfinite(priors.tracks).all(-1)  # type: ignore[arg-type]
    if {"flow_forward", "flow_backward"} <= set(fixed):
        forward, backward = priors.flow_forward, priors.flow_backward
        assert forward is not None and backward is not None
        for name, there, back in (("forward", forward, backward), ("backward", backward, forward)):
            if f"flow_{name}_mask" not in fixed:
                pairs = zip(there.astype(np.float32), back.astype(np.float32), strict=True)
                derived[f"flow_{name}_mask"] = np.array([consistent(*pair) for pair in pairs]).reshape(there.shape[:-1])
    if "cameras" in fixed and priors.cameras is not None:
        priors.camera_kind = camera_kind(priors.cameras)
    return derived


def camera_kind(path: CameraPath) -> str:
    """Return `static`, `pan` (turns about its centre) or `moving`, from poses in world units."""
    world_to_camera = path.world_to_camera
    rotation = world_to_camera[:, :3, :3]
    centers = -np.einsum("tji,tj->ti", rotation, world_to_camera[:, :3, 3])
    if np.ptp(centers, axis=0).max(initial=0) > STATIC_SHIFT:
        return "moving"
    cosine = (np.einsum("tij,ij->t", rotation, rotation[0]) - 1) / 2
    return "pan" if np.degrees(np.arccos(np.clip(cosine, -1, 1))).max() > STATIC_DEGREES else "static"
