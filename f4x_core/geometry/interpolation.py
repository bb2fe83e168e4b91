"""Smooth curves through values and rotations at non-uniform times; numpy or torch values, numpy times.

Local cubic Hermite curves with non-uniform Catmull-Rom velocities: they pass through every knot with continuous
velocity, and one noisy knot disturbs only its two intervals on either side. Outside the knots the motion goes on with
the end velocity and comes to rest, so that one frame past the end is right and a hundred frames past it stay near.
"""

import math
from collections.abc import Callable

import numpy as np

from . import quaternion
from .arrays import Array

COAST_STEPS = 8.0
"""Outside the knots the end velocity decays by 1/e every so many mean knot intervals."""


def interpolate(times: np.ndarray, values: Array, time: float) -> Array:
    """Return the value `(...)` at `time` of the curve through `values (T, ...)` at increasing `times (T,)`."""
    if len(times) == 1:
        return values[0]
    overshoot, end = _overshoot(times, time)
    if overshoot:
        return values[end] + overshoot * _velocity(times, values, end, _difference)
    i, h, u = _interval(times, time)
    start_velocity = _velocity(times, values, i, _difference)
    end_velocity = _velocity(times, values, i + 1, _difference)
    blend = u * u * (3 - 2 * u)
    return (
        values[i]
        + blend * (values[i + 1] - values[i])
        + h * u * (1 - u) * ((1 - u) * start_velocity - u * end_velocity)
    )


def interpolate_rotation(times: np.ndarray, q: Array, time: float) -> Array:
    """Return the unit quaternion `(..., 4)` at `time` of the curve through unit `q (T, ..., 4)`.

    The cubic Hermite quaternion curve of Kim, Kim and Shin 1995 (cumulative Bezier basis). Signs of `q` do not matter.
    """
    if len(times) == 1:
        return q[0]
    overshoot, end = _overshoot(times, time)
    if overshoot:
        return _turned(q[end], overshoot * _velocity(times, q, end, _relative_rotation))
    i, h, u = _interval(times, time)
    first = _velocity(times, q, i, _relative_rotation) * (h / 3)
    last = _velocity(times, q, i + 1, _relative_rotation) * (h / 3)
    middle = _relative_rotation(_turned(q[i], first), _turned(q[i + 1], -last))
    curve = _turned(q[i], first * (1 - (1 - u) ** 3))
    curve = _turned(curve, middle * (u * u * (3 - 2 * u)))
    return _turned(curve, last * u**3)


def presence(span: np.ndarray, time: float) -> np.ndarray:
    """Return (N,) float32, 0 to 1: how much of each of N things is there at `time`.

    `span (N,4)` are times that do not decrease: one comes from the first to the second, is there until the third and gone at
    the fourth; ramps are linear, those without length are steps, and infinities are for what never comes or goes.
    """
    start, there, until, end = np.asarray(span, np.float64).T
    with np.errstate(invalid="ignore", divide="ignore"):
        coming = np.where(there > start, np.clip((time - start) / (there - start), 0, 1), time >= start)
        going = np.where(end > until, np.clip((end - time) / (end - until), 0, 1), time < end)
    return np.minimum(coming, going).astype(np.float32)


def _interval(times: np.ndarray, time: float) -> tuple[int, float, float]:
    """Return the interval that contains `time`, its length, and the fraction of it that has passed."""
    i = int(np.clip(np.searchsorted(times, time, side="right") - 1, 0, len(times) - 2))
    h = float(times[i + 1] - times[i])
    return i, h, float(time - times[i]) / h


def _overshoot(times: np.ndarray, time: float) -> tuple[float, int]:
    """Return (damped signed time outside the knots, index of the end knot); 0 inside."""
    end = 0 if time < times[0] else len(times) - 1
    outside = float(time - times[end])
    if times[0] <= time <= times[-1]:
        return 0.0, end
    reach = COAST_STEPS * float(times[-1] - times[0]) / (len(times) - 1)
    return math.copysign(-reach * math.expm1(-abs(outside) / reach), outside), end


def _velocity(times: np.ndarray, knots: Array, i: int, difference: Callable[[Array, Array], Array]) -> Array:
    """Return the velocity at knot `i`: the secants of both sides, the shorter interval weighing more; one at an end."""
    if i == 0 or i == len(times) - 1:
        k = min(i, len(times) - 2)
        return difference(knots[k], knots[k + 1]) / float(times[k + 1] - times[k])
    left, right = float(times[i] - times[i - 1]), float(times[i + 1] - times[i])
    before, after = difference(knots[i - 1], knots[i]) / left, difference(knots[i], knots[i + 1]) / right
    return (right * before + left * after) / (left + right)


def _difference(a: Array, b: Array) -> Array:
    return b - a


def _relative_rotation(a: Array, b: Array) -> Array:
    """Return the rotation vector `(..., 3)` that turns `a` into `b`, in the frame of `a` (and of `b`)."""
    return quaternion.to_rotation_vector(quaternion.multiply(quaternion.conjugate(a), b))


def _turned(q: Array, vector: Array) -> Array:
    return quaternion.multiply(q, quaternion.from_rotation_vector(vector))
