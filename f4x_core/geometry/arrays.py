"""One code path for two array libraries: ask the input which one it belongs to. torch is never imported from here."""

import sys
from types import ModuleType
from typing import Any

import numpy as np

GOLDEN_RATIO = (5**0.5 - 1) / 2
"""The multiples of it, without their whole parts, lie evenly between 0 and 1 however many they are, neighbours far apart."""
Array = Any
"""A numpy array or a torch tensor; the functions of this room return the kind that came in."""


def namespace(*arrays: Array) -> ModuleType:
    """Return the module (`torch` or `numpy`) whose functions act on these arrays; torch when any is a tensor."""
    torch = sys.modules.get("torch")  # a tensor can only come in where torch is already loaded
    if torch is not None and any(isinstance(array, torch.Tensor) for array in arrays):
        return torch
    return np


def like(constant: np.ndarray, reference: Array) -> Array:
    """Return a numpy constant as the kind, dtype (when floating) and device of `reference`."""
    xp = namespace(reference)
    if xp is np:
        return constant
    if isinstance(constant, np.ndarray) and not constant.flags.writeable:
        constant = constant.copy()  # torch would warn of memory that it must not write to
    dtype = reference.dtype if reference.dtype.is_floating_point else xp.float64
    return xp.as_tensor(constant, dtype=dtype, device=reference.device)


def are_indices(times: np.ndarray) -> bool:
    """Return True if `times (T,)` are 0, 1, 2, ...: those of frames that are evenly spaced, all of them."""
    return bool((times == np.arange(len(times))).all())


def evenly_spaced(length: int, count: int, ends: bool = True) -> np.ndarray:
    """Return at most `count` distinct indices (K,) int64, ascending and spread evenly over 0..length-1, both ends included.

    All indices when `count` is at least `length`; only index 0 when `count` is 1. Without `ends` the first and the last are
    left out where the length allows it.
    """
    if length < 1:
        return np.zeros(0, np.int64)
    positions = np.linspace(0, length - 1, min(count, length) if ends else count + 2).round().astype(np.int64)
    return np.unique(positions if ends else positions[1:-1])


def rank_correlation(a: np.ndarray, b: np.ndarray) -> float:
    """Return Spearman's correlation, -1..1, of `a (N,)` and `b (N,)`; NaN where either has a NaN or one value alone.

    That of scipy.stats, which takes half a second to import.
    """

    def ranks(values: np.ndarray) -> np.ndarray:
        _, place, count = np.unique(values, return_inverse=True, return_counts=True)
        return (np.cumsum(count) - (count - 1) / 2)[place]  # equal values share their mean rank

    if np.isnan(a).any() or np.isnan(b).any():
        return float("nan")
    with np.errstate(invalid="ignore", divide="ignore"):
        return float(np.corrcoef(ranks(a), ranks(b))[0, 1])


def cross(a: Array, b: Array) -> Array:
    """Return the cross product over the last axis, `(..., 3)` with broadcasting (the two libraries disagree on theirs)."""
    ax, ay, az = a[..., 0], a[..., 1], a[..., 2]
    bx, by, bz = b[..., 0], b[..., 1], b[..., 2]
    return namespace(a, b).stack([ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx], axis=-1)


def safe_norm(x: Array, eps: float = 1e-12) -> tuple[Array, Array]:
    """Return `(norm (..., 1), valid (..., 1) bool)`; where the norm is at most `eps` it is given as 1.

    The denominator is made safe before the square root and before any division, so gradients stay finite at zero.
    """
    xp = namespace(x)
    squared = (x * x).sum(axis=-1, keepdims=True)
    valid = squared > eps * eps
    return xp.sqrt(xp.where(valid, squared, xp.ones_like(squared))), valid
