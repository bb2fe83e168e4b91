"""Inverse depth of the background by a plane sweep between known cameras and semi-global matching.

Chained flow is precise on surfaces but smooth across silhouettes: there the far side is drawn to the near one. The sweep is
coarser in depth, and sharp where depth jumps, so it tells which surface a pixel belongs to.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from ..geometry.camera import CameraPath
from ..native.library import open_library
from ..native.sweep import F4X_BEST_PLANES, PLANES
from ..parallel import in_threads
from .flow import length, pixel_grid

PLANES_SWEPT = 48
"""Inverse depths that are tried, evenly spaced from 0 to the nearest."""
NEAREST = 99.5
"""Percentile of the measured inverse depth that the nearest plane lies beyond by a factor of `BEYOND`."""
BEYOND = 1.15
LEAST = 0.25
"""Least place among the planes: the first one is infinitely far away."""
VIEWS = 2
"""Frames before and frames after that a frame is compared with."""
PARALLAX = 0.1
"""Most parallax of a usual depth between two compared frames, picture widths: farther ones look too different."""
STEP_PX = 2.0
"""Most pixels by which the picture shifts from one plane to the next, in the farthest compared frame: one sample. Beside a near
fence before far houses it was 4 to 9, and there the sweep found nothing."""
GAPS = (1, 2, 4, 8, 16)
"""Distances in frames of those that are compared."""
DARKEST = 55
"""Grey level of black in compared pictures, so that 0, which lies outside or is hidden, is like none of them."""
ALIKE = 16
"""Difference of grey levels that says no more than one that is larger."""
WINDOW = 3
"""Samples along the side of the window over which differences are summed."""
STEP, JUMP = 4, 48
"""Penalties of a neighbour on the next plane and on any other, grey levels over the window; a jump costs `JUMP` where
both look the same and less where grey levels differ, by e for each `GREY_STEP`, down to `CHEAPEST`."""
GREY_STEP, CHEAPEST = 10.0, 6
AGREE = 0.04
"""Relative difference of inverse depths, beyond one plane, up to which another frame confirms a pixel's."""
CONFIRMING_GAPS = (1, 2, 4)
CONFIRMED = 2
"""Frames that have to confirm a pixel; fewer where fewer see it, but one."""


@dataclass(frozen=True)
class Samples:
    """Inverse depth of the background of a frame as flow and tracks measure it, on every `stride`-th pixel."""

    inverse: np.ndarray
    """(h, w)."""
    precision: np.ndarray
    """(h, w): 1 / variance, 0 = unknown."""
    held: np.ndarray
    """(h, w) 0..1: how well the picture holds them (`flow.texture_along`)."""

    @property
    def usual(self) -> float:
        """1 / median depth, 1 without any that is known."""
        known = np.maximum(self.inverse[self.precision > 0], 1e-6)
        return 1 / max(float(np.median(1 / known)), 1e-6) if len(known) else 1.0

    @property
    def nearest(self) -> float:
        """Largest inverse depth that is known to better than 10 %, but for the last half percent."""
        sure = self.inverse[self.precision * self.inverse**2 > 100]
        return max(float(np.percentile(sure, NEAREST)), self.usual) if len(sure) else 3 * self.usual


@dataclass(frozen=True)
class Swept:
    """Inverse depth of a frame by the sweep, on every `stride`-th pixel."""

    inverse: np.ndarray
    """(h, w) float32."""
    spacing: float
    """Distance of two planes."""
    gain: np.ndarray
    """(h, w) pixels by which one shifts per inverse depth, in the farther one of the farthest frames on both sides."""
    better: np.ndarray
    """(h, w) grey levels by which it explains the pictures better than the samples."""
    known: np.ndarray
    """(h, w) bool: other frames say the same."""


def sweep(
    cameras: CameraPath,
    pictures: np.ndarray,
    hidden: np.ndarray | None,
    samples: Sequence[Samples],
    stride: int,
    report: Callable[[int], None] | None = None,
) -> list[Swept]:
    """Sweep all frames of `pictures (F, H, W)` uint8, in which `hidden (F, H, W)` is not seen, as far as `samples` reach.

    Moving pixels are compared as all others are: masks are too wide, and one of two sides of the path mostly sees behind a mover.
    """
    prepared = (DARKEST + pictures * ((255 - DARKEST) / 255)).astype(np.uint8)
    if hidden is not None:
        prepared[hidden] = 0
    frames, (height, width) = len(pictures), samples[0].inverse.shape
    inverse, gain, better = np.empty((3, frames, height, width), np.float32)
    spacing = [BEYOND * one.nearest / (PLANES_SWEPT - 1) for one in samples]

    def search(frame: int) -> None:
        sides = compared_frames(cameras, frame, samples[frame].usual, spacing[frame])
        planes = spacing[frame] * np.arange(PLANES_SWEPT)
        costs = plane_costs(cameras, prepared, frame, sides, planes, stride)
        place = best_planes(costs, prepared[frame, stride // 2 :: stride, stride // 2 :: stride])
        inverse[frame] = np.maximum(place, LEAST) * spacing[frame]
        missed = [_cost_at(costs, at) for at in (samples[frame].inverse / spacing[frame], place)]
        shifts = [_shift(cameras, frame, side[-1], (height, width), stride) for side in sides]
        gain[frame] = np.max(shifts, axis=0) if shifts else 0
        better[frame] = (missed[0] - missed[1]) / (WINDOW**2 * VIEWS)

    def finish(frame: int) -> Swept:
        known = confirmed(cameras, inverse, spacing, frame, stride)
        return Swept(inverse[frame], spacing[frame], gain[frame], better[frame], known)

    in_threads(search, range(frames), report)
    return in_threads(finish, range(frames))


def _cost_at(costs: np.ndarray, place: np.ndarray) -> np.ndarray:
    """Return (h, w) `costs (h, w, planes)` at the plane nearest to `place (h, w)`."""
    at = np.clip(np.round(place), 0, costs.shape[2] - 1).astype(np.intp)
    return np.take_along_axis(costs, at[..., None], 2)[..., 0].astype(np.float32)


def compared_frames(cameras: CameraPath, frame: int, usual: float, spacing: float) -> list[list[int]]:
    """Return up to `VIEWS` frames before, and as many after, with the most parallax that is still small enough.

    The inverse depth `usual` shifts by at most `PARALLAX`, and two planes `spacing` apart differ by at most `STEP_PX`.
    """
    focal = cameras.intrinsics[frame, 0, 0] / cameras.width
    most = min(PARALLAX, STEP_PX / cameras.width * usual / spacing)
    sides = []
    for sign in (-1, 1):
        others = [frame + sign * gap for gap in GAPS if 0 <= frame + sign * gap < len(cameras)]
        parallax = focal * usual * np.linalg.norm(cameras.centers[others] - cameras.centers[frame], axis=1)
        near = [other for other, shift in zip(others, parallax, strict=True) if shift <= most] or others[:1]
        sides.append(near[-VIEWS:])
    return [side for side in sides if side]


def plane_costs(
    cameras: CameraPath, pictures: np.ndarray, frame: int, sides: list[list[int]], planes: np.ndarray, stride: int
) -> np.ndarray:
    """Return (h, w, planes) int16: how little a frame looks like others, grey levels summed over a window and `VIEWS` frames.

    What one side of the path cannot see the other mostly can: of the frames before and those after, the better ones count.
    """
    import cv2

    own = np.ascontiguousarray(pictures[frame, stride // 2 :: stride, stride // 2 :: stride])
    height, width = own.shape
    ways = [[_homographies(cameras, frame, other, stride) for other in side] for side in sides]
    costs = np.zeros((len(planes), height, width), np.int16)
    how = cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
    for index, plane in enumerate(planes):
        for side, maps in zip(sides, ways, strict=True):
            total = np.zeros_like(own)
            for other, (far, near) in zip(side, maps, strict=True):
                seen = cv2.warpPerspective(pictures[other], far + plane * near, (width, height), flags=how)
                total = cv2.add(total, cv2.min(cv2.absdiff(seen, own), ALIKE))
            summed = cv2.boxFilter(total, cv2.CV_16S, (WINDOW, WINDOW), normalize=False) * np.int16(VIEWS // len(side))
            costs[index] = summed if side is sides[0] else np.minimum(costs[index], summed)
    return np.ascontiguousarray(costs.transpose(1, 2, 0))


def _homographies(cameras: CameraPath, frame: int, other: int, stride: int) -> tuple[np.ndarray, np.ndarray]:
    """Return (3, 3) `A` and `B`: `A + rho B` takes samples (columns and rows from 0) of the plane of inverse depth `rho` to pixels
    (from 0) of another frame."""
    here, there = cameras[frame], cameras[other]
    relative = there.world_to_camera @ here.camera_to_world
    offset = stride // 2 + 0.5
    pixels = np.array([[stride, 0, offset], [0, stride, offset], [0, 0, 1.0]])
    onto = np.array([[1, 0, -0.5], [0, 1, -0.5], [0, 0, 1.0]]) @ there.intrinsics
    rays = np.linalg.inv(here.intrinsics) @ pixels
    far = onto @ relative[:3, :3] @ rays
    near = np.outer(onto @ relative[:3, 3], rays[2])
    return far, near


def _shift(cameras: CameraPath, frame: int, other: int, size: tuple[int, int], stride: int) -> np.ndarray:
    """Return (h, w) pixels per inverse depth by which samples of a frame begin to shift in another one."""
    far, near = _homographies(cameras, frame, other, stride)
    at = _places(*size)
    ahead, step = at @ far.T, at @ near.T
    depth = np.maximum(ahead[..., 2:], 1e-6)
    return length((step[..., :2] - ahead[..., :2] / depth * step[..., 2:]) / depth)


def _places(height: int, width: int) -> np.ndarray:
    """Return (h, w, 3): column and row of every sample, from 0, and 1."""
    at = np.ones((height, width, 3))
    at[..., :2] = pixel_grid(height, width) - 0.5
    return at


def best_planes(costs: np.ndarray, guide: np.ndarray) -> np.ndarray:
    """Return (h, w) float32: index of the plane, with a fraction, of least cost `costs (h, w, planes)` int16 along four paths.

    `guide (h, w)` are grey levels: where they differ, depth may jump.
    """
    scale = WINDOW**2 * VIEWS
    levels = guide.astype(np.float32)

    def jumps(axis: int) -> np.ndarray:
        steps = abs(np.diff(levels, axis=axis, prepend=np.take(levels, [0], axis)))
        return (scale * np.maximum(JUMP * np.exp(-steps / GREY_STEP), CHEAPEST)).astype(np.int16)

    find = _plain_best_planes if open_library()[0] is None else _best_planes
    return find(costs, scale * STEP, jumps(1), jumps(0))


def _best_planes(costs: np.ndarray, step: int, right: np.ndarray, below: np.ndarray) -> np.ndarray:
    height, width, planes = costs.shape
    place = np.empty((height, width), np.float32)
    sizes = {"width": width, "height": height, "planes": planes}
    F4X_BEST_PLANES(PLANES(**sizes, step=step, costs=costs, right=right, below=below, place=place))
    return place


def _plain_best_planes(costs: np.ndarray, step: int, right: np.ndarray, below: np.ndarray) -> np.ndarray:
    """Return the same by numpy."""
    sums = np.zeros(costs.shape, np.int32)
    for axis, jump in ((1, right), (0, below)):
        lines, penalty, into = (np.moveaxis(each, axis, 0) for each in (costs, jump, sums))
        for way in (1, -1):
            order = range(len(lines))[::way]
            before = None
            for place in order:
                cost = lines[place].astype(np.int32)
                if before is not None:
                    low = before.min(1, keepdims=True)
                    far = low + penalty[max(place, place - way)][:, None]
                    best = np.minimum(before, far)
                    best[:, 1:] = np.minimum(best[:, 1:], before[:, :-1] + step)
                    best[:, :-1] = np.minimum(best[:, :-1], before[:, 1:] + step)
                    cost = cost + best - low
                into[place] += cost
                before = cost
    best = sums.argmin(2)
    middle = np.clip(best, 1, costs.shape[2] - 2)[..., None]
    low, own, high = (np.take_along_axis(sums, middle + side, 2)[..., 0].astype(np.float32) for side in (-1, 0, 1))
    bend = low - 2 * own + high
    inner = (middle[..., 0] == best) & (bend > 0)
    return (best + np.where(inner, np.float32(0.5) * (low - high) / np.where(inner, bend, 1), 0)).astype(np.float32)


def confirmed(
    cameras: CameraPath, inverse: np.ndarray, spacing: Sequence[float], frame: int, stride: int
) -> np.ndarray:
    """Return (h, w) bool: which inverse depths of a frame other frames have, too."""
    import cv2

    own = inverse[frame]
    height, width = own.shape
    agreeing, seeing = np.zeros((2, height, width), np.int32)
    at = _places(height, width)
    for other in (frame + sign * gap for gap in CONFIRMING_GAPS for sign in (-1, 1)):
        if not 0 <= other < len(inverse):
            continue
        far, near = _homographies(cameras, frame, other, stride)
        ahead = at @ far.T + own[..., None] * (at @ near.T)  # (h, w, 3), the last is the depth there over that here
        target = ((ahead[..., :2] / np.maximum(ahead[..., 2:], 1e-6) - stride // 2) / stride).astype(np.float32)
        there = cv2.remap(inverse[other], target[..., 0], target[..., 1], cv2.INTER_NEAREST, borderValue=-1)
        wanted, seen = own / np.maximum(ahead[..., 2], 1e-6), there > 0
        seeing += seen
        agreeing += seen & (abs(there - wanted) < AGREE * wanted + spacing[other])
    return agreeing >= np.clip(seeing, 1, CONFIRMED)
