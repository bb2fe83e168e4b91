"""Viewing angles of a clip: of static points, of moving groups, and DyCheck's angular factor.

A depth error becomes visible from the side only; what was seen from one direction alone has no measured depth. numpy, no torch.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial.distance import pdist

from ..geometry import quaternion
from ..geometry.camera import CameraPath
from ..priors import Priors
from ..scaffold import Scaffold
from ..scaffold.groups import connected_groups, group_motion, shape_change

MAX_POINTS = 1000
"""Static tracks looked at; a quantile of their angles needs no more, and every pair of frames is compared for each."""
STATIC_MOTION = 0.3
"""Tracks whose motion score is lower count as static."""
MIN_NODES, MAX_SHAPE_CHANGE = 4, 0.5
"""Fewer nodes, or a larger median `groups.shape_change`, have no axes of their own. Fitted scaffolds: `car-shadow` and `train`
0.3, `dog` 0.85, groups of a few nodes beside them 0.65 to 1.5."""
MIN_SIGHTINGS = 2
"""A point seen in fewer frames has no angle between its rays."""


@dataclass(frozen=True)
class GroupView:
    """Viewing angles of one group of moving nodes, by its own turning and by the camera's path."""

    nodes: int
    """Nodes of the scaffold that belong to it."""
    frames: int
    """Supervised frames in which at least one of them was measured."""
    degrees: float | None
    """Largest angle between two viewing directions in the group's own axes; None for what changes its shape too much."""
    degrees_per_second: float | None
    """Mean angular speed of the camera around the group in its own axes: DyCheck's angular factor of this group."""


def parallax_degrees(priors: Priors) -> float:
    """Return the angle between the two outermost cameras, seen from a point at the median depth (1 world unit); 0 for none."""
    if priors.cameras is None or len(priors.cameras) < 2:
        return 0.0
    baseline = float(pdist(priors.cameras.centers).max())
    return float(np.degrees(2 * np.arctan(baseline / 2)))


def angular_factor(path: CameraPath, fps: float) -> float:
    """Return DyCheck's angular effective multi-view factor of a clip: degrees per second around the look-at point.

    `mean over steps of angle(a - o_t, a - o_t+1) / duration` with camera centres `o_t` and look-at point `a` (Gao et al. 2022,
    "Monocular Dynamic View Synthesis: A Reality Check", section 4.1). They triangulate `a` from the optical axes, which has no
    answer for parallel ones; here it is the mean of the points on the axes at the median depth (1 world unit).
    """
    look_at = (path.centers + path.world_to_camera[:, 2, :3]).mean(0)
    return angular_speed(look_at - path.centers, path.times, fps)


def angular_speed(directions: np.ndarray, times: np.ndarray, fps: float) -> float:
    """Return the mean angle (degrees per second) between neighbours in time of `directions (F,3)` at clip frames `times (F,)`."""
    if len(directions) < 2:
        return 0.0
    unit = directions / np.linalg.norm(directions, axis=1, keepdims=True)
    angle = np.degrees(np.arccos(np.clip((unit[1:] * unit[:-1]).sum(1), -1, 1)))
    return float(np.mean(angle / np.diff(times)) * fps)


def spanned_degrees(directions: np.ndarray, visible: np.ndarray) -> np.ndarray:
    """Return the largest angle (P,) in degrees between two of the `directions (F,P,3)` in which `visible (F,P)`; NaN below two."""
    unit = directions / np.linalg.norm(directions, axis=-1, keepdims=True)
    unit = np.where(visible[..., None], unit, np.nan)
    smallest = np.ones(directions.shape[1])
    for here in unit:
        smallest = np.fmin(smallest, np.fmin.reduce((unit * here).sum(-1), axis=0))
    degrees = np.degrees(np.arccos(np.maximum(smallest, -1)))
    return np.where(visible.sum(0) >= MIN_SIGHTINGS, degrees, np.nan)


def static_view_degrees(priors: Priors) -> np.ndarray:
    """Return the angle (P,) in degrees spanned over the clip by the viewing rays of each static track, by depth and cameras.

    A track stands at the median of the places where depth puts it. At most `MAX_POINTS` tracks, evenly chosen; empty where
    tracks, depth or cameras are missing.
    """
    if priors.cameras is None or priors.depth is None or priors.tracks is None or priors.tracks_visible is None:
        return np.zeros(0)
    motion = priors.tracks_motion if priors.tracks_motion is not None else np.zeros(priors.tracks.shape[1])
    chosen = np.flatnonzero((motion < STATIC_MOTION) & (priors.tracks_visible.sum(0) >= MIN_SIGHTINGS))
    chosen = chosen[:: max(1, -(-len(chosen) // MAX_POINTS))]
    tracks, visible = priors.tracks[:, chosen].astype(np.float64), priors.tracks_visible[:, chosen].copy()
    places = np.full((*visible.shape, 3), np.nan)
    for frame in range(len(priors.frames)):
        seen = np.flatnonzero(visible[frame])
        column, row = np.clip(np.floor(tracks[frame, seen]), 0, [priors.width - 1, priors.height - 1]).astype(int).T
        depth = priors.depth[frame, row, column].astype(np.float64)
        places[frame, seen] = priors.cameras[frame].unproject(tracks[frame, seen], depth)
    known = np.isfinite(places).all(-1).any(0)
    points = np.nanmedian(places[:, known], axis=0)
    degrees = spanned_degrees(points - priors.cameras.centers[:, None], visible[:, known])
    return degrees[np.isfinite(degrees)]


def group_views(scaffold: Scaffold, cameras: CameraPath, fps: float) -> list[GroupView]:
    """Return the viewing angles of each group of connected nodes, the largest group first.

    `cameras`: one per time of the scaffold. The viewing direction from the group's middle to the camera is turned into the
    group's own axes, those of its best rigid motion (`groups.group_motion`), so that a thing that turns before a standing
    camera is seen from many sides. What has no axes, because its shape changes or its nodes are few, has no angle; the rigid
    parts of a group are not told apart, for few nodes turn by their noise.
    """
    if not len(scaffold):
        return []
    group = connected_groups(scaffold.edges, len(scaffold))
    views = []
    for number in range(int(group.max()) + 1):
        members = np.flatnonzero(group == number)
        xyz, seen = scaffold.xyz[:, members], scaffold.certain[:, members].any(1)
        degrees = speed = None
        if len(members) >= MIN_NODES and seen.any() and np.median(shape_change(xyz)[seen]) <= MAX_SHAPE_CHANGE:
            turn, middle = group_motion(xyz)
            directions = quaternion.rotate(quaternion.conjugate(turn), cameras.centers - middle)[seen]
            span = spanned_degrees(directions[:, None], np.ones((len(directions), 1), bool))[0]
            degrees = float(np.nan_to_num(span))
            speed = angular_speed(directions, scaffold.times[seen], fps)
        views.append(GroupView(len(members), int(seen.sum()), degrees, speed))
    return views
