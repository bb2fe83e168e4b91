"""A 4D scene in memory: static and dynamic Gaussians, the scaffold that carries them, cameras and provenance.

Everything is numpy: Blender's own Python reads and poses a scene without torch. Base arrays are never changed in place;
`dataclasses.replace` makes a new scene, and construction validates it. Shape letters: Ns, Nd static and dynamic
Gaussians, S = (degree+1)^2 SH coefficients, K neighbours, M nodes, F supervised frames, T clip frames.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any, Self

import numpy as np

from ..errors import F4xError
from ..features import missing
from ..geometry import quaternion, spherical_harmonics
from ..geometry.camera import Camera, CameraPath
from ..geometry.interpolation import presence
from ..geometry.splats import Splats
from ..scaffold import Scaffold
from ..scaffold.deformation import Pairs, move_gaussians, pairs_of, relative_motions
from .field import FeatureField
from .placing import offset_of
from .tints import Tints, tinted, tints_in

GAUSSIAN_ARRAYS = {
    "ids": ("<i8", ("N",)),
    "means": ("<f4", ("N", 3)),
    "quats": ("<f4", ("N", 4)),
    "scales": ("<f4", ("N", 3)),
    "opacities": ("<f4", ("N",)),
    "sh": ("<f4", ("N", "S", 3)),
}
DYNAMIC_ARRAYS = GAUSSIAN_ARRAYS | {
    "reference": ("<i4", ("N",)),
    "node": ("<i4", ("N", "K")),
    "weight": ("<f4", ("N", "K")),
    "strength": ("<f4", ("N",)),
}
SCAFFOLD_ARRAYS = {
    "times": ("<f8", ("F",)),
    "xyz": ("<f4", ("F", "M", 3)),
    "quat": ("<f4", ("F", "M", 4)),
    "radius": ("<f4", ("M",)),
    "certain": ("|b1", ("F", "M")),
    "ids": ("<i8", ("M",)),
    "neighbours": ("<i8", ("M", "K")),
    "edge_mask": ("|b1", ("M", "K")),
}
CAMERA_ARRAYS = {
    "intrinsics": ("<f8", ("T", 3, 3)),
    "world_to_camera": ("<f8", ("T", 4, 4)),
    "times": ("<f8", ("T",)),
}
"""Array name -> dtype in the file and axes; a letter is one length throughout its group."""
KEYS = {"means": "xyz", "quats": "rotation", "scales": "scale", "opacities": "opacity"}
"""Field -> name of the array in the file, where it differs."""
MADE_UP = "static/made_up"
"""Member of `Scene.extra`, (Ns,) bool: no frame of the clip shows a static Gaussian, its colours are those around it."""
EARLIER = "window/earlier"
"""Member of `Scene.extra` of a window of a long clip, (n,) int64: ids of static Gaussians that go on from others of the window
before."""
SPAN = "span"
"""The one array that a set may lack: then all its Gaussians are always present."""

WEIGHT_SUM_TOLERANCE = 1e-3
"""Tolerance of the sum of one Gaussian's skinning weights: float32 rounding of 16 weights, with a wide margin."""


def empty_arrays(layout: Mapping[str, tuple[str, tuple]], **lengths: int) -> dict[str, np.ndarray]:
    """Return arrays of `layout` with the given axis lengths (N = 0 by default), for empty sets."""
    return {
        name: np.zeros([axis if isinstance(axis, int) else lengths.get(axis, 0) for axis in axes], dtype)
        for name, (dtype, axes) in layout.items()
    }


def check_arrays(arrays: Mapping[str, np.ndarray], layout: Mapping[str, tuple[str, tuple]], group: str) -> None:
    """Raise F4xError unless every array has its kind of dtype, its shape, one length per letter and finite values."""
    lengths: dict[str, int] = {}
    for name, (dtype, axes) in layout.items():
        value = arrays[name]
        label = f"{group}/{KEYS.get(name, name)}"
        if not isinstance(value, np.ndarray) or value.dtype.kind != np.dtype(dtype).kind:
            raise F4xError(f"{label} must be an array of {np.dtype(dtype).name}, not {getattr(value, 'dtype', value)}")
        expected = tuple(lengths.get(axis, -1) if isinstance(axis, str) else axis for axis in axes)
        if value.ndim != len(axes) or any(e not in (-1, n) for e, n in zip(expected, value.shape, strict=True)):
            known = tuple(lengths.get(axis, axis) for axis in axes)
            raise F4xError(f"{label} has the shape {value.shape}, expected {known}")
        lengths.update({axis: n for axis, n in zip(axes, value.shape, strict=True) if isinstance(axis, str)})
        if value.dtype.kind == "f" and not np.isfinite(value).all():
            raise F4xError(f"{label} holds NaN or infinity")


@dataclass(frozen=True, eq=False)
class StaticSet(Splats):
    """Gaussians that stay where they are: numpy, float32, with harmonics; scales >= 0, no zero quaternion."""

    ids: np.ndarray = field(kw_only=True)
    """(N,) int64, unique in the scene (static and dynamic together), never reused."""
    span: np.ndarray | None = field(default=None, kw_only=True)
    """(N,4) float32 clip times that do not decrease: it comes from the first to the second, is there until the third and gone
    at the fourth (`presence`); infinities for one that never comes or goes. None: all are always there."""

    def __post_init__(self) -> None:
        """Validate."""
        layout = DYNAMIC_ARRAYS if isinstance(self, DynamicSet) else GAUSSIAN_ARRAYS
        group = "dynamic" if isinstance(self, DynamicSet) else "static"
        check_arrays(vars(self), layout, group)
        try:
            spherical_harmonics.degree_of(self.sh.shape[1])
        except ValueError as error:
            raise F4xError(f"{group}/sh: {error}") from error
        if (self.scales < 0).any():
            raise F4xError(f"{group}/scale has negative values; store the activated scale, not its logarithm")
        if ((self.opacities < 0) | (self.opacities > 1)).any():
            raise F4xError(f"{group}/opacity leaves [0, 1]; store the activated opacity, not its logit")
        if not (self.quats != 0).any(axis=1).all():
            raise F4xError(f"{group}/rotation holds a zero quaternion")
        if self.span is not None and (
            self.span.shape != (len(self), 4)
            or self.span.dtype.kind != "f"
            or not (self.span[:, 1:] >= self.span[:, :-1]).all()
        ):
            raise F4xError(
                f"{group}/{SPAN} must hold four times that do not decrease for each of {len(self)} Gaussians"
            )

    def __len__(self) -> int:
        return len(self.ids)

    @classmethod
    def empty(cls, degree: int = 0, neighbours: int = 1) -> Self:
        """Return a set without Gaussians; `neighbours` is K of a dynamic one."""
        layout = DYNAMIC_ARRAYS if cls is DynamicSet else GAUSSIAN_ARRAYS
        return cls(**empty_arrays(layout, S=(degree + 1) ** 2, K=neighbours))

    def presence(self, time: float) -> np.ndarray:
        """Return (N,) float32 presence of each Gaussian at clip time `time`, 0 to 1."""
        if self.span is None:
            return np.ones(len(self), np.float32)
        return presence(self.span, time)


@dataclass(frozen=True, eq=False, kw_only=True)
class DynamicSet(StaticSet):
    """Gaussians moved by the scaffold, stored in their pose at their own reference time."""

    reference: np.ndarray
    """(N,) int32 index into the scaffold's times."""
    node: np.ndarray
    """(N,K) int32 node indices the Gaussian follows; slot 0 is its attach node, whose sign the blend goes by."""
    weight: np.ndarray
    """(N,K) float32 >= 0, sum 1; 0 switches a slot off."""
    strength: np.ndarray
    """(N,) float32 in [0, 1]: 1 follows the nodes, 0 stays put (blend with the identity)."""

    def __post_init__(self) -> None:
        """Validate."""
        super().__post_init__()
        if ((self.strength < 0) | (self.strength > 1)).any():
            raise F4xError("dynamic/strength leaves [0, 1]")
        if (self.weight < 0).any():
            raise F4xError("dynamic/weight has negative values")
        # A Gaussian that follows nothing (strength 0) has no weights to normalise.
        follows = self.strength > WEIGHT_SUM_TOLERANCE
        if (np.abs(self.weight.sum(axis=1, dtype=np.float64) - 1)[follows] > WEIGHT_SUM_TOLERANCE).any():
            raise F4xError("dynamic/weight does not sum to 1 for every Gaussian")


def _as_drawn(means: np.ndarray, quats: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the centres and unit rotations in float32."""
    return means.astype(np.float32, copy=False), quaternion.normalize(quats).astype(np.float32, copy=False)


def faded(opacity: np.ndarray, presence: np.ndarray) -> np.ndarray:
    """Return the opacity (N,) of Gaussians that are present in part (`presence (N,)` in [0, 1]): `1 - (1 - opacity)^presence`.

    Optical depth fades, not alpha: a cross-fade of two equal surfaces, their presences summing to 1, stays as opaque as either
    (a fade of alpha would be translucent half-way).
    """
    partly = (presence > 0) & (presence < 1)
    shown = np.where(presence > 0, opacity, np.float32(0))
    shown[partly] = 1 - (1 - opacity[partly]) ** presence[partly]
    return shown


@dataclass(frozen=True, eq=False)
class PosedSplats(Splats):
    """All Gaussians of a scene at one time, static ones first: numpy, float32, unit quaternions.

    The harmonics of the set with the smaller degree are padded with zeros.
    """

    ids: np.ndarray = field(kw_only=True)
    """(N,) int64"""
    dynamic: np.ndarray = field(kw_only=True)
    """(N,) bool"""


@dataclass(frozen=True, eq=False)
class Scene:
    """Clip as an editable 4D scene. Times are clip frame indices (float allowed)."""

    name: str
    """Short name, used for exported files."""
    static: StaticSet
    """Gaussians of the background."""
    cameras: CameraPath
    """Cameras of the clip frames, held-out ones interpolated; width and height are the clip's."""
    dynamic: DynamicSet = field(default_factory=DynamicSet.empty)
    """Gaussians that move; empty for a clip in which nothing moves."""
    scaffold: Scaffold | None = None
    """The motion of the dynamic set; None when nothing moves."""
    fps: float = 30.0
    """Clip frames per second."""
    held_out: tuple[int, ...] = ()
    """Clip frames that the fit did not see."""
    provenance: Mapping[str, Any] = field(default_factory=dict)
    """Program versions and settings that made the scene (JSON)."""
    needs: tuple[Mapping[str, Any], ...] = ()
    """Needs that the fit found: rows such as {"what": "nodes", "chosen": 120, "evidence": "..."} (JSON)."""
    metrics: Mapping[str, Any] = field(default_factory=dict)
    """Measured quality (JSON)."""
    edits: tuple[Mapping[str, Any], ...] = ()
    """The edit stack: ordered typed operations beside the untouched base arrays (JSON; the edit room types them)."""
    next_id: int = 0
    """The first Gaussian id never used; raised to one past the largest id on construction."""
    features: FeatureField | None = None
    """Features distilled from foundation models; None before distillation."""
    extra: Mapping[str, np.ndarray] = field(default_factory=dict)
    """More arrays of the file by member name; those under static/ and dynamic/ have one row per Gaussian. Kept as they
    are."""
    extra_fields: Mapping[str, Any] = field(default_factory=dict)
    """More top-level fields of scene.json. Kept as they are."""

    def __post_init__(self) -> None:
        """Validate what concerns more than one part."""
        # np.unique, which hashes, takes fifty times as long; every changed copy of a scene comes here
        ids = np.sort(np.concatenate([self.static.ids, self.dynamic.ids]))
        if twice := np.count_nonzero(ids[1:] == ids[:-1]):
            raise F4xError(f"{twice} Gaussian ids occur twice; ids are unique in the whole scene")
        if len(ids) and ids[0] < 0:
            raise F4xError("a Gaussian id is negative")
        object.__setattr__(self, "next_id", max(self.next_id, int(ids[-1]) + 1 if len(ids) else 0))
        if self.next_id >= 1 << 63:
            raise F4xError(f"next_id is {self.next_id}; ids are 64-bit numbers")
        if not (np.isfinite(self.fps) and self.fps > 0):
            raise F4xError(f"fps is {self.fps}, expected a positive number")
        if any(not 0 <= frame < len(self.cameras) for frame in self.held_out):
            raise F4xError(f"held_out names a frame outside 0..{len(self.cameras) - 1}")
        if self.scaffold is not None:
            self._check_scaffold(self.scaffold)
        elif len(self.dynamic):
            raise F4xError("there are dynamic Gaussians but no scaffold to carry them")
        if self.features is not None:
            self.features.check(len(self.static), 0 if self.scaffold is None else len(self.scaffold.ids))
        for part, rows in (("static/", len(self.static)), ("dynamic/", len(self.dynamic))):
            for name, value in self.extra.items():
                if name.startswith(part) and (value.ndim == 0 or len(value) != rows):
                    raise F4xError(f"{name} has the shape {value.shape}, expected one row for each of {rows} Gaussians")
        object.__setattr__(self, "_tints", tints_in(self.extra, (len(self.static), len(self.dynamic))))

    def _check_scaffold(self, scaffold: Scaffold) -> None:
        """Raise F4xError unless the scaffold fits the file's layout and every index into it exists."""
        check_arrays({name: getattr(scaffold, name) for name in SCAFFOLD_ARRAYS}, SCAFFOLD_ARRAYS, "scaffold")
        frames, nodes = scaffold.xyz.shape[:2]
        if not (scaffold.quat != 0).any(axis=-1).all():
            raise F4xError("scaffold/quat holds a zero quaternion")
        for label, index, end in (
            ("dynamic/reference", self.dynamic.reference, frames),
            ("dynamic/node", self.dynamic.node, nodes),
        ):
            if index.size and not (index.min() >= 0 and index.max() < end):
                raise F4xError(f"{label} points outside 0..{end - 1}")

    @property
    def sh_degree(self) -> int:
        """The larger SH degree of the two sets."""
        return spherical_harmonics.degree_of(self._constant["sh"].shape[1])

    @property
    def ids(self) -> np.ndarray:
        """(N,) int64 ids in the order of `posed`."""
        return self._constant["ids"]

    @property
    def base(self) -> Scene:
        """The scene before edits: itself."""
        return self

    @property
    def offset(self) -> np.ndarray:
        """(3,) float64 to be added to positions for those of the file that the scene was imported from; 0 for all others."""
        return offset_of(self.provenance)

    @property
    def fitted_frames(self) -> str | None:
        """The frames of its clip that it was fitted to, as `A:B:S`; None where the file does not name them."""
        frames = self.provenance.get("frames")
        return frames if isinstance(frames, str) and frames else None

    @property
    def untimed(self) -> Scene:
        """Scene with only the edits that move nothing in time; without edits the scene itself."""
        return self

    @property
    def origin(self) -> np.ndarray:
        """(N,) int64: the row of `base.posed` that each row of `posed` is, or is a copy of."""
        return np.arange(len(self.ids))

    @property
    def gone(self) -> np.ndarray:
        """(N,) bool in the order of `posed`: deleted by edits at all times."""
        return np.zeros(len(self.ids), bool)

    @property
    def background(self) -> Scene:
        """Scene of the static Gaussians alone, without features."""
        extra = {name: array for name, array in self.extra.items() if not name.startswith("dynamic/")}
        return replace(self, dynamic=DynamicSet.empty(), scaffold=None, features=None, extra=extra)

    @property
    def moving(self) -> np.ndarray:
        """(N,) bool in the order of `posed`: True for dynamic Gaussians."""
        return self._constant["dynamic"]

    @property
    def full_appearance(self) -> tuple[np.ndarray, np.ndarray]:
        """Opacities (N,) and harmonics (N,S,3) in the order of `posed`, always present and without tints."""
        return self._constant["opacities"], self._constant["sh"]

    @property
    def tints(self) -> Tints | None:
        """The changes of color over time, in the order of `base.posed`; None where colors stay."""
        known: Tints | None = self.__dict__["_tints"]
        return known

    @property
    def fades(self) -> bool:
        """True if some Gaussians are present for a part of the clip only."""
        return self.static.span is not None or self.dynamic.span is not None

    def presence(self, time: float) -> np.ndarray:
        """Return (N,) float32 in the order of `base.posed`: presence of each Gaussian at `time`, 0 to 1."""
        return np.concatenate([self.static.presence(time), self.dynamic.presence(time)])

    def posed(self, time: float) -> PosedSplats:
        """Return all Gaussians at clip time `time` (frame index, float allowed).

        Dynamic ones follow the dual-quaternion blend of their nodes' motion from their own reference time to `time`:
        x' = R x + t, R_g' = R R_g; scales stay, opacity is `faded` where there is a span, colors have their `tints`. An absent
        Gaussian has opacity 0.
        """
        untinted = self.untinted(time)
        if self.tints is None:
            return untinted
        return replace(untinted, sh=tinted(untinted.sh, self.tints.at(time)))

    def untinted(self, time: float) -> PosedSplats:
        """Return all Gaussians at `time`, with their mean colors over the clip."""
        means, quats = self._static_poses
        if len(self.dynamic):
            moved = _as_drawn(*self._carried(time))
            means, quats = (np.concatenate(parts) for parts in zip((means, quats), moved, strict=True))
        there = {"opacities": faded(self._constant["opacities"], self.presence(time))} if self.fades else {}
        return PosedSplats(means=means, quats=quats, **self._constant | there)

    @cached_property
    def _static_poses(self) -> tuple[np.ndarray, np.ndarray]:
        """Centres and unit rotations of the static set; to normalise them anew for each time took half of `posed`."""
        return _as_drawn(self.static.means, self.static.quats)

    def _carried(self, time: float) -> tuple[np.ndarray, np.ndarray]:
        """Return the centres and rotations of the dynamic set at `time`, also of Gaussians that are absent then."""
        dynamic, index, table = self.dynamic, self._pairs.index, self._motions(time)
        weight, strength, means, quats = dynamic.weight, dynamic.strength, dynamic.means, dynamic.quats
        return move_gaussians(table, index, weight, strength, means, quats)

    def fitted_focal(self, time: float) -> float | None:
        """Return the focal length in pixels of the fitted images at clip time `time` (`RasterConfig.as_fitted`).

        None for a scene that was imported from a splat file: how that was fitted is not known.
        """
        return None if self.is_foreign else self.cameras.at(time).focal

    @property
    def is_foreign(self) -> bool:
        """True for splats of another program, which no clip shows."""
        return "import" in self.provenance

    def latents(self) -> np.ndarray:
        """Return (N,D) float32 latents of the feature field, in the order of `posed`; F4xError where there is no field."""
        return self._latents

    def require_field(self, heads: Sequence[str] = ()) -> FeatureField:
        """Return the feature field; F4xError where there is none, or one of `heads` is missing in it."""
        if self.features is None:
            missing.refuse(
                f"The scene '{self.name}' knows no words and looks yet, so nothing in it can be found by its name",
                "--teacher text,visual --clip CLIP",
            )
        for name in heads:
            self.features.head(name)
        return self.features

    def colors(self, posed: PosedSplats, camera: Camera) -> np.ndarray:
        """Return the colours (N,3) float32 >= 0 of `posed` seen from `camera`; appearance turns with the surface."""
        return spherical_harmonics.seen_from(camera.center, posed.means, posed.sh, posed.quats)

    def info(self) -> dict[str, Any]:
        """Return a summary of the scene as JSON: counts, megabytes by part, provenance, needs."""
        scaffold = [] if self.scaffold is None else [getattr(self.scaffold, name) for name in SCAFFOLD_ARRAYS]
        parts = {
            "static": self.static.arrays().values(),
            "dynamic": self.dynamic.arrays().values(),
            "scaffold": scaffold,
            "cameras": [getattr(self.cameras, name) for name in CAMERA_ARRAYS],
            "features": [] if self.features is None else self.features.to_arrays().values(),
            "extra": self.extra.values(),
        }
        return {
            "name": self.name,
            "frames": len(self.cameras),
            "fps": self.fps,
            "size": [self.cameras.width, self.cameras.height],
            "held_out": len(self.held_out),
            "static": len(self.static),
            "dynamic": len(self.dynamic),
            "nodes": 0 if self.scaffold is None else len(self.scaffold.ids),
            "sh_degree": self.sh_degree,
            "color_moments": 0 if self.tints is None else len(self.tints.times),
            "megabytes": {part: sum(array.nbytes for array in arrays) / 1e6 for part, arrays in parts.items()},
            "edits": len(self.edits),
            "heads": {} if self.features is None else {h.spec.name: dict(h.report) for h in self.features.heads},
            "latent": 0 if self.features is None else self.features.width,
            "extra": sorted(self.extra),
            "needs": list(self.needs),
            "metrics": dict(self.metrics),
            "provenance": dict(self.provenance),
        }

    @cached_property
    def _constant(self) -> dict[str, np.ndarray]:
        """The fields of `PosedSplats` that do not change with time, static ones first."""
        static, dynamic = self.static, self.dynamic
        if not len(dynamic):  # nothing is copied: a million splats with harmonics are 200 MB
            names = ("scales", "opacities", "sh", "ids")
            return {name: getattr(static, name) for name in names} | {"dynamic": np.zeros(len(static), bool)}
        size = max(part.sh.shape[1] for part in (static, dynamic) if len(part) or part is static)
        sh = [
            np.pad(part.sh, ((0, 0), (0, size - part.sh.shape[1]), (0, 0))) for part in (static, dynamic) if len(part)
        ]
        return {
            "scales": np.concatenate([static.scales, dynamic.scales]),
            "opacities": np.concatenate([static.opacities, dynamic.opacities]),
            "sh": np.concatenate([*sh, np.zeros((0, size, 3), np.float32)]),
            "ids": np.concatenate([static.ids, dynamic.ids]),
            "dynamic": np.arange(len(static) + len(dynamic)) >= len(static),
        }

    def _motions(self, time: float) -> np.ndarray:
        """Return the table (P,8) of `relative_motions` that moves the dynamic Gaussians at `time`."""
        scaffold = self.scaffold
        assert scaffold is not None  # checked on construction
        return relative_motions(scaffold.times, scaffold.xyz, scaffold.quat, self._pairs, time)

    @cached_property
    def _latents(self) -> np.ndarray:
        return self.require_field().latents(self.dynamic.node, self.dynamic.weight)

    @cached_property
    def _pairs(self) -> Pairs:
        """The used (node, reference) pairs; many Gaussians share one, so a frame computes P motions and not Nd * K."""
        return pairs_of(self.dynamic.node, self.dynamic.reference)
