"""The feature field of a scene: a latent on every static Gaussian and every node, heads that decode it, label vectors.

numpy alone, so that Blender queries a scene without torch. Shape letters: Ns static Gaussians, M nodes, N all Gaussians,
D width of the latent, C channels of a head, L labels.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from itertools import pairwise
from typing import Any, Self

import numpy as np

from ..errors import F4xError
from ..features import missing
from ..features.pca import Pca
from ..features.spec import FeatureSpec

BITS = (4, 8)
"""Bits of one channel of a static Gaussian's latent in the file; with 4, two channels share a byte."""
TAIL = 0.1
"""Percent of the latents that may be clipped at either end of a channel's range, so that no outlier makes all steps coarse."""
ROWS = 1 << 15
"""Pixels that are decoded at once: 1408 channels of them take 180 MB."""


@dataclass(frozen=True, eq=False)
class FieldHead:
    """Decoder of one teacher: linear layers with ReLU between and a linear end."""

    spec: FeatureSpec
    """Description of the decoded features."""
    weights: tuple[np.ndarray, ...]
    """(in,out) float16, the first with D rows, the last with C columns."""
    biases: tuple[np.ndarray, ...]
    """(out,) float16."""
    pca: Pca | None = None
    """Colours of its pictures, the same for every frame."""
    glob: np.ndarray | None = None
    """(C,) float16: the clip's own vector, where the teacher gives one."""
    report: Mapping[str, Any] = field(default_factory=dict)
    """Decoding errors on used and held-out frames (JSON)."""

    def __post_init__(self) -> None:
        """Validate."""
        name = f"heads/{self.spec.name}"
        shapes = [weight.shape for weight in self.weights]
        if not shapes or any(len(shape) != 2 for shape in shapes):
            raise F4xError(f"{name} has no layers, or one that is no matrix")
        if any(before[1] != after[0] for before, after in pairwise(shapes)) or [b.shape for b in self.biases] != [
            shape[1:] for shape in shapes
        ]:
            raise F4xError(f"the layers of {name} do not follow one another")
        if shapes[-1][1] != self.spec.dim:
            raise F4xError(f"{name} ends in {shapes[-1][1]} channels, its spec says {self.spec.dim}")
        vectors = [*self.weights, *self.biases, *([] if self.glob is None else [self.glob])]
        if not all(v.dtype.kind == "f" and np.isfinite(v).all() for v in vectors):
            raise F4xError(f"{name} holds something else than finite floats")
        if self.glob is not None and self.glob.shape != (self.spec.dim,):
            raise F4xError(f"{name}/global has the shape {self.glob.shape}, expected {(self.spec.dim,)}")

    def __call__(self, latent: np.ndarray) -> np.ndarray:
        """Return the features (…,C) float32 of `latent (…,D)`."""
        rows = latent.reshape(-1, latent.shape[-1])
        out = np.empty((len(rows), self.weights[-1].shape[1]), np.float32)
        layers = [(w.astype(np.float32), b.astype(np.float32)) for w, b in zip(self.weights, self.biases, strict=True)]
        for start in range(0, len(rows), ROWS):
            x = rows[start : start + ROWS].astype(np.float32, copy=False)
            for weight, bias in layers[:-1]:
                x = np.maximum(x @ weight + bias, 0)
            out[start : start + ROWS] = x @ layers[-1][0] + layers[-1][1]
        return out.reshape(*latent.shape[:-1], out.shape[1])

    def to_rgb(self, latent: np.ndarray) -> np.ndarray:
        """Return (…,3) uint8 colours of the features of `latent (…,D)`.

        The last layer and the projection onto three directions are one linear map: the C channels are never made.
        """
        if self.pca is None:
            raise F4xError(f"The head '{self.spec.name}' has no colours; distil it again.")
        last = self.weights[-1].astype(np.float32) @ self.pca.basis.T  # (in,3)
        offset = self.pca.coordinates(self.biases[-1].astype(np.float32))
        spec = replace(self.spec, dim=3)
        short = replace(
            self, spec=spec, weights=(*self.weights[:-1], last), biases=(*self.biases[:-1], offset), glob=None
        )
        return self.pca.colours(short(latent))


@dataclass(frozen=True, eq=False)
class Vocabulary:
    """Vectors of labels in the space of one text encoder."""

    labels: tuple[str, ...]
    """Words or phrases."""
    vectors: np.ndarray
    """(L,dim) float16, unit length."""

    def __post_init__(self) -> None:
        """Validate."""
        if self.vectors.ndim != 2 or len(self.vectors) != len(self.labels) or self.vectors.dtype.kind != "f":
            raise F4xError(f"a vocabulary has {len(self.labels)} labels and vectors of shape {self.vectors.shape}")
        if not np.isfinite(self.vectors).all():
            raise F4xError("a vocabulary holds NaN or infinity")


@dataclass(frozen=True, eq=False)
class FeatureField:
    """Latents in bytes (value = low + step * byte), and what decodes them."""

    static: np.ndarray
    """(Ns,D) uint8, below 2 ** bits."""
    nodes: np.ndarray
    """(M,D) uint8; M = 0 where nothing moves."""
    low: np.ndarray
    """(D,) float32."""
    step: np.ndarray
    """(D,) float32."""
    heads: tuple[FieldHead, ...] = ()
    """Heads, one for each teacher; names are unique."""
    vocabularies: Mapping[str, Vocabulary] = field(default_factory=dict)
    """By the name of the text encoder."""
    pca: Pca | None = None
    """Colours of the latent's own pictures."""
    bits: int = 8
    """Bits that a channel of `static` takes in the file, 4 or 8."""

    def __post_init__(self) -> None:
        """Validate."""
        width = self.static.shape[-1]
        for name, array, shape, dtype in (
            ("static/latent", self.static, (len(self.static), width), np.uint8),
            ("scaffold/latent", self.nodes, (len(self.nodes), width), np.uint8),
            ("latent/low", self.low, (width,), np.float32),
            ("latent/step", self.step, (width,), np.float32),
        ):
            if array.shape != shape or array.dtype != dtype:
                raise F4xError(
                    f"{name} is {array.dtype} {array.shape}, expected {np.dtype(dtype)} {shape}, one width for all"
                )
        if self.bits not in BITS or (self.bits == 4 and (width % 2 or (self.static > 15).any())):
            raise F4xError(f"static/latent does not fit into {self.bits} bits per channel")
        if not (np.isfinite(self.low).all() and np.isfinite(self.step).all()):
            raise F4xError("latent/low or latent/step holds NaN or infinity")
        if len({head.spec.name for head in self.heads}) != len(self.heads):
            raise F4xError("two heads of the feature field have the same name")
        for head in self.heads:
            if len(head.weights[0]) != width:
                raise F4xError(
                    f"heads/{head.spec.name} decodes {len(head.weights[0])} channels, the latent has {width}"
                )

    @property
    def width(self) -> int:
        """D, channels of the latent."""
        return self.static.shape[1]

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the heads."""
        return tuple(head.spec.name for head in self.heads)

    def head(self, name: str) -> FieldHead:
        """Return the head of a teacher; F4xError with the names there are when there is none."""
        for head in self.heads:
            if head.spec.name == name:
                return head
        missing.refuse(
            f"The scene has no head '{name}' (it has {', '.join(self.names) or 'none'})", f"--teacher {name}"
        )

    def spec(self, name: str) -> FeatureSpec:
        """Return the meaning of the features of a head."""
        return self.head(name).spec

    def decode(self, name: str, latent: np.ndarray) -> np.ndarray:
        """Return features (…,C) float32 of head `name` for `latent (…,D)`; a rendered latent is divided by alpha first."""
        return self.head(name)(latent)

    def vocabulary(self, encoder: str) -> tuple[tuple[str, ...], np.ndarray]:
        """Return (labels, (L,dim) float32 unit vectors) of a text encoder; F4xError when the scene has none."""
        if encoder not in self.vocabularies:
            missing.refuse(f"The scene has no vocabulary for the text encoder '{encoder}'", "--vocabulary WORDS")
        stored = self.vocabularies[encoder]
        return stored.labels, stored.vectors.astype(np.float32)

    def latents(self, node: np.ndarray, weight: np.ndarray) -> np.ndarray:
        """Return (N,D) float32 of all Gaussians, static first; a dynamic one blends its nodes', `node` and `weight` (Nd,K)."""
        static, nodes = (self.low + self.step * part for part in (self.static, self.nodes))
        blended = np.zeros((len(node), self.width), np.float32)
        for k in range(node.shape[1] if len(node) else 0):  # slot by slot: no (Nd,K,D) array
            blended += weight[:, k, None] * nodes[node[:, k]]
        return np.concatenate([static, blended], dtype=np.float32)

    def check(self, static: int, nodes: int) -> None:
        """Raise F4xError unless there is a latent for each of so many static Gaussians and nodes."""
        for name, array, rows in (("static/latent", self.static, static), ("scaffold/latent", self.nodes, nodes)):
            if len(array) != rows:
                raise F4xError(f"{name} has {len(array)} rows, expected one for each of {rows}")

    @property
    def nbytes(self) -> int:
        """Bytes of all arrays."""
        return sum(array.nbytes for array in self.to_arrays().values())

    def to_arrays(self) -> dict[str, np.ndarray]:
        """Return every array by its name in the scene file."""
        packed = self.static if self.bits == 8 else self.static[:, 0::2] << 4 | self.static[:, 1::2]
        arrays = {"static/latent": packed, "latent/low": self.low, "latent/step": self.step}
        if len(self.nodes):
            arrays["scaffold/latent"] = self.nodes
        if self.pca is not None:
            arrays["latent/pca"] = _pca_array(self.pca)
        for head in self.heads:
            group = f"heads/{head.spec.name}"
            for i, (weight, bias) in enumerate(zip(head.weights, head.biases, strict=True)):
                arrays |= {f"{group}/weight_{i}": weight, f"{group}/bias_{i}": bias}
            if head.pca is not None:
                arrays[f"{group}/pca"] = _pca_array(head.pca)
            if head.glob is not None:
                arrays[f"{group}/global"] = head.glob
        return arrays | {f"vocabulary/{name}": words.vectors for name, words in self.vocabularies.items()}

    def to_json(self) -> dict[str, Any]:
        """Return the entry `features` of scene.json."""
        heads = [
            {
                "spec": head.spec.to_json(),
                "layers": len(head.weights),
                "pca": _pca_json(head.pca),
                "report": dict(head.report),
            }
            for head in self.heads
        ]
        words = {name: list(vocabulary.labels) for name, vocabulary in self.vocabularies.items()}
        return {
            "width": self.width,
            "bits": self.bits,
            "pca": _pca_json(self.pca),
            "heads": heads,
            "vocabularies": words,
        }

    @classmethod
    def take_from(cls, arrays: dict[str, np.ndarray], header: Any) -> Self:
        """Return the field that `to_arrays` and `to_json` (`header`) gave; its arrays are taken out of `arrays`.

        F4xError, without the file's name, says what is missing or does not fit.
        """

        def taken(name: str) -> np.ndarray:
            if name not in arrays:
                raise F4xError(f"the array {name} is missing")
            return arrays.pop(name)

        if not isinstance(header, dict) or not isinstance(header.get("heads"), list):
            raise F4xError("'features' is not an object with a list of heads")
        static, low, step = (taken(name) for name in ("static/latent", "latent/low", "latent/step"))
        bits = header.get("bits")
        if type(bits) is not int or bits not in BITS or static.ndim != 2 or static.dtype != np.uint8:
            raise F4xError("static/latent is not rows of bytes with 4 or 8 'bits' per channel")
        if bits == 4:
            static = np.stack([static >> 4, static & 15], -1).reshape(len(static), -1)
        if low.ndim != 1 or header.get("width") != len(low):
            raise F4xError(f"'features' says a latent of {header.get('width')} channels, latent/low has {low.shape}")
        nodes = arrays.pop("scaffold/latent", np.zeros((0, len(low)), np.uint8))
        heads = []
        for entry in header["heads"]:
            if not isinstance(entry, dict) or type(entry.get("layers")) is not int or entry["layers"] < 1:
                raise F4xError("a head in 'features' does not say how many layers it has")
            spec = FeatureSpec.from_json(entry.get("spec"))
            group, report = f"heads/{spec.name}", entry.get("report", {})
            if not isinstance(report, dict):
                raise F4xError(f"the report of {group} is not an object")
            heads.append(
                FieldHead(
                    spec,
                    tuple(taken(f"{group}/weight_{i}") for i in range(entry["layers"])),
                    tuple(taken(f"{group}/bias_{i}") for i in range(entry["layers"])),
                    _pca(entry.get("pca"), arrays, f"{group}/pca", spec.dim),
                    arrays.pop(f"{group}/global", None),
                    report,
                )
            )
        words = header.get("vocabularies", {})
        if not isinstance(words, dict) or not all(
            isinstance(labels, list) and all(isinstance(label, str) for label in labels) for labels in words.values()
        ):
            raise F4xError("'vocabularies' is not a table of lists of labels")
        vocabularies = {name: Vocabulary(tuple(labels), taken(f"vocabulary/{name}")) for name, labels in words.items()}
        pca = _pca(header.get("pca"), arrays, "latent/pca", len(low))
        return cls(static, nodes, low, step, tuple(heads), vocabularies, pca, bits)


def quantise(
    static: np.ndarray, nodes: np.ndarray, bits: int = 8
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Return (static, nodes) as uint8 with the (low, step) float32 per channel that gives them back to half a step.

    `static (Ns,D)`, `nodes (M,D)` float; `bits` 4 or 8. `TAIL` of the values are clipped at either end.
    """
    levels = 2**bits - 1
    both = np.concatenate([static, nodes])
    ends = np.percentile(both, [TAIL, 100 - TAIL], axis=0) if len(both) else np.zeros((2, static.shape[1]))
    low = ends[0].astype(np.float32)
    step = np.maximum((ends[1] - ends[0]) / levels, np.finfo(np.float32).tiny).astype(np.float32)
    stored = [np.clip(np.round((part - low) / step), 0, levels).astype(np.uint8) for part in (static, nodes)]
    return stored[0], stored[1], low, step


def _pca_array(pca: Pca) -> np.ndarray:
    """Return (4,C): the mean, then the basis."""
    return np.concatenate([pca.mean[None], pca.basis]).astype(np.float32)


def _pca_json(pca: Pca | None) -> dict[str, list[float]] | None:
    return None if pca is None else {"low": [float(v) for v in pca.low], "high": [float(v) for v in pca.high]}


def _pca(header: Any, arrays: dict[str, np.ndarray], name: str, channels: int) -> Pca | None:
    """Return the Pca that `_pca_json` and `_pca_array` gave, its array taken out of `arrays`."""
    if header is None:
        return None
    array = arrays.pop(name, None)
    if array is None or array.shape != (4, channels) or array.dtype.kind != "f" or not np.isfinite(array).all():
        raise F4xError(f"the array {name} is missing or not (4, {channels}) finite floats")
    ends = [header.get(end) if isinstance(header, dict) else None for end in ("low", "high")]
    if not all(isinstance(end, list) and len(end) == 3 and all(_is_number(v) for v in end) for end in ends):
        raise F4xError(f"the colour range of {name} is not three numbers 'low' and three 'high'")
    return Pca(array[0], array[1:], np.array(ends[0]), np.array(ends[1]))


def _is_number(value: Any) -> bool:
    return type(value) in (int, float) and math.isfinite(value)
