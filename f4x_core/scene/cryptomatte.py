"""Cryptomatte 1.2 (Friedman and Jones, Psyop): mattes of named things in few channels, as Blender and Nuke read them.

Each pixel holds pairs (id, coverage), the largest first, two pairs in each picture of four channels. An id is the hash of a
name; the file's header tells which.
"""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping

import numpy as np

DEPTH = 6
"""Pairs of a pixel, Blender's own."""
_WORD = 0xFFFFFFFF


def murmur3(data: bytes) -> int:
    """Return MurmurHash3_x86_32 with seed 0 (Appleby 2011)."""
    value, whole = 0, len(data) & ~3
    words = [*np.frombuffer(data[:whole], "<u4").tolist(), int.from_bytes(data[whole:], "little")]
    for number, word in enumerate(words):
        word = word * 0xCC9E2D51 & _WORD
        word = (word << 15 | word >> 17) * 0x1B873593 & _WORD
        value ^= word
        if number < len(words) - 1:
            value = ((value << 13 | value >> 19) * 5 + 0xE6546B64) & _WORD
    value ^= len(data)
    value = (value ^ value >> 16) * 0x85EBCA6B & _WORD
    value = (value ^ value >> 13) * 0xC2B2AE35 & _WORD
    return value ^ value >> 16


def identify(name: str) -> int:
    """Return the 32-bit id of a name, never one whose float is not a number or denormal."""
    value = murmur3(name.encode())
    return value ^ (1 << 23) if value >> 23 & 255 in (0, 255) else value


def ranked(ids: np.ndarray, coverage: np.ndarray, depth: int = DEPTH) -> list[np.ndarray]:
    """Return the pictures (H,W,4) float32 of a layer: id, coverage, id, coverage, ordered by coverage.

    Args:
        ids: (K,) uint32.
        coverage: (H,W,K) in [0, 1].
        depth: pairs of a pixel, even.
    """
    kept = min(depth, len(ids))
    order = np.argsort(-coverage, axis=-1, kind="stable")[..., :kept]
    best = np.take_along_axis(coverage, order, -1).astype(np.float32)
    pairs = np.zeros((*coverage.shape[:2], 2 * (depth + depth % 2)), np.float32)
    pairs[..., 0 : 2 * kept : 2] = np.where(best > 0, ids.astype(np.uint32).view(np.float32)[order], 0)
    pairs[..., 1 : 2 * kept : 2] = best
    return np.split(pairs, pairs.shape[-1] // 4, axis=-1)


def metadata(layer: str, names: Iterable[str]) -> Mapping[str, str]:
    """Return the header attributes of a layer such as `ViewLayer.CryptoObject`, with the manifest of `names`."""
    key = f"cryptomatte/{murmur3(layer.encode()):08x}"[: len("cryptomatte/") + 7]
    manifest = {name: f"{identify(name):08x}" for name in names}
    return {
        f"{key}/name": layer,
        f"{key}/hash": "MurmurHash3_32",
        f"{key}/conversion": "uint32_to_float32",
        f"{key}/manifest": json.dumps(manifest, ensure_ascii=False, separators=(",", ":")),
    }
