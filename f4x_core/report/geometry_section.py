"""The page's first section: which way round the scene is, from how many sides it was seen, and how it looks from the side."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes

from .. import page
from ..fit.pipeline import FitResult
from ..geometry.spherical_harmonics import rgb_from_dc
from ..metrics.way_round import WayRound
from ..scene.moments import Moment
from ..scene.visualise import colour_depth, depth_range
from .geometry_findings import ClipGeometry, believed_sentence

# Groups of moving nodes in the table, the largest ones.
NAMED_GROUPS = 8
# Moving objects whose depth is plotted over time, those that are seen longest.
PLOTTED_MOVERS = 4
# Static Gaussians in the plot, and the opacity below which one is not part of a surface.
PROFILE_POINTS, MIN_OPACITY = 12000, 0.3
# What lies outside these quantiles of them, or further than so many median depths, does not widen the plot.
PROFILE_QUANTILES, MAX_EXTENT = (0.02, 0.98), 4.0
# The profile from the side shows what the middle one of so many strips of the picture sees; all at once would hide the ground.
STRIPS = 3


def geometry_section(result: FitResult, geometry: ClipGeometry, moments: Sequence[Moment]) -> str:
    """Return the tables, views aside and the profile as HTML."""
    movers = result.priors.statistics.get("depth", {}).get("movers", [])
    return (
        page.table(["", "", ""], _figures(geometry))
        + _clues(geometry.way_round)
        + _views(moments)
        + page.plots([profile_plot(result)])
        + _groups(geometry)
        + _movers(movers)
        + page.plots(map(_over_ground, sorted(movers, key=_frames_seen, reverse=True)[:PLOTTED_MOVERS]))
    )


def _figures(geometry: ClipGeometry) -> list[list[str]]:
    rows = [["way round", *_way_round(geometry.way_round)]]
    if geometry.static_degrees is not None:
        middle, outer = geometry.static_degrees
        rows.append(
            [
                "angle from which the background was seen",
                f"{middle:.1f}° median, {outer:.1f}° for one point in ten",
                "between the outermost viewing rays of a tracked point; what was seen from one side only has no measured depth",
            ]
        )
    if geometry.angular_factor is not None:
        rows.append(
            [
                "angular multi-view factor",
                f"{geometry.angular_factor:.1f}° per second",
                "speed of the camera around the scene's centre (DyCheck's angular EMF); shake counts, too",
            ]
        )
    if geometry.believed is not None:
        limits = f"{geometry.believed.static:.1f}° background"
        limits += f", {geometry.believed.moving:.1f}° moving objects" if geometry.believed.moving is not None else ""
        rows.append(["views that can be believed", limits, believed_sentence(geometry.believed)])
    return rows


def _way_round(way: WayRound | None) -> tuple[str, str]:
    if way is None:
        return (
            "not compared",
            "no mirrored solution was tried: the camera does not move or was given, or the priors are older",
        )
    least = way.chosen == "least error"
    chosen = (
        "the solution that fits better" if least else "the solution that fits less well, which the depth cues prefer"
    )
    return f"{way.verdict}, {way.odds}", f"{chosen}, against the one with near and far exchanged"


def _clues(way: WayRound | None) -> str:
    if way is None or not way.clues:
        return ""
    rows = [[clue.what, f"{clue.log_odds:+.1f}", clue.detail] for clue in way.clues]
    return page.table(["evidence for the way round", "log-odds for it", "measured"], rows, numbers=True)


def _groups(geometry: ClipGeometry) -> str:
    if not geometry.groups:
        return ""
    rows = [
        [f"{number}", f"{view.nodes}", f"{view.frames}", _number(view.degrees, 0), _number(view.degrees_per_second, 1)]
        for number, view in enumerate(geometry.groups[:NAMED_GROUPS], start=1)
    ]
    head = ["group of moving nodes", "nodes", "frames measured", "seen from (degrees)", "angular factor (degrees/s)"]
    return page.table(head, rows, numbers=True)


def _number(value: float | None, digits: int) -> str:
    """Return a table's cell; a dash for what is not known."""
    return "–" if value is None else f"{value:.{digits}f}"


def _movers(movers: Sequence[Mapping[str, Any]]) -> str:
    """Return an HTML table of the clue that decided the depth of each moving object."""
    if not movers:
        return ""
    rows = []
    for number, mover in enumerate(movers, start=1):
        first, last = (*mover.get("frames", ()), None, None)[:2]
        rows.append(
            [
                str(mover.get("group", number)),
                "" if first is None else f"{first} to {last}",
                str(mover.get("decided_by", "unknown")),
                _number(mover.get("emf_degrees"), 1),
            ]
        )
    return page.table(["moving object", "frames", "depth decided by", "turned by (degrees)"], rows, numbers=True)


def _frames_seen(mover: Mapping[str, Any]) -> int:
    return len(mover.get("over_time", {}).get("seen", ()))


def _over_ground(mover: Mapping[str, Any]) -> str:
    """Plot (SVG) a mover's depth over the frames and the ground below it, with dots where it touches the ground."""
    if not _frames_seen(mover):
        return ""
    path = mover["over_time"]
    title = f"moving object {mover['group']}: its depth, and that of the ground below it"
    figure, (axis,) = page.plot(title, "clip frame", "median depths")
    ground = [np.nan if depth is None else depth for depth in path["ground"]]
    axis.plot(path["seen"], ground, color=page.TEAL, label="ground below it")
    axis.plot(path["seen"], path["depth"], color=page.ORANGE, label="its depth, next to the ground if seen")
    touches = np.array(path["touches"], bool)
    if touches.any():
        places = np.array(path["seen"])[touches], np.array(path["depth"])[touches]
        axis.scatter(*places, s=14, color=page.ORANGE, label="touches the ground", zorder=3)
    page.legend(axis)
    return page.svg(figure)


def _views(moments: Sequence[Moment]) -> str:
    """Return a row per moment: the camera's own view, depth, from the right, from above."""
    near, far = depth_range(moment.depth for moment in moments)
    return "".join(
        page.row(
            [
                page.image_figure(moment.rgb, f"frame {moment.index}, the camera's view"),
                page.image_figure(colour_depth(moment.depth, near, far), "depth: near is red"),
                page.image_figure(moment.right, f"{moment.right_degrees:.0f}° from the right"),
                page.image_figure(moment.above, f"{moment.above_degrees:.0f}° from above"),
            ],
            four=True,
        )
        for moment in moments
    )


def profile_plot(result: FitResult) -> str:
    """Plot (SVG) the camera path and the static Gaussians from above and from the side, in the axes of the middle camera."""
    cameras = result.scene.cameras
    middle = cameras[len(cameras) // 2]
    turn, shift = middle.world_to_camera[:3, :3], middle.world_to_camera[:3, 3]
    path = cameras.centers @ turn.T + shift
    solid = np.flatnonzero(result.scene.static.opacities >= MIN_OPACITY)
    solid = solid[:: max(1, len(solid) // PROFILE_POINTS)]
    points = result.scene.static.means[solid] @ turn.T + shift
    colours = np.clip(rgb_from_dc(result.scene.static.sh[solid, 0]), 0, 1)
    half = cameras.width / (2 * STRIPS * middle.intrinsics[0, 0])
    strip = np.abs(points[:, 0]) < half * points[:, 2]
    figure, axes = page.plot("", "", "", columns=2, height=2.9)
    titles = ("from above", "from the side, middle third")
    for axis, (across, up), title, chosen in zip(axes, ((0, 2), (2, 1)), titles, (slice(None), strip), strict=True):
        _draw_profile(axis, points[chosen][:, [across, up]], colours[chosen], path[:, [across, up]])
        every = max(1, len(path) // 5)
        forward = cameras.world_to_camera[::every, 2, :3] @ turn.T
        reach = np.diff(axis.get_xlim())[0] / 2
        axis.quiver(
            *path[::every, [across, up]].T,
            *forward[:, [across, up]].T,
            color=page.ORANGE,
            angles="xy",
            scale_units="xy",
            scale=4 / reach,
            width=0.004,
        )
        axis.set_title(title, fontsize=10, color=page.TEXT_COLOUR)
        if up == 1:
            axis.invert_yaxis()  # y points down
    return page.svg(figure)


def _draw_profile(axis: Axes, points: np.ndarray, colours: np.ndarray, path: np.ndarray) -> None:
    """Scatter `points (n,2)` and the camera `path (T,2)` in a square that shows most of both."""
    around = np.concatenate([points, path])
    low, high = np.quantile(around, PROFILE_QUANTILES, axis=0)
    low, high = (np.clip(bound, -MAX_EXTENT, MAX_EXTENT) for bound in (low, high))
    low, high = np.minimum(low, path.min(0)), np.maximum(high, path.max(0))
    reach, centre = 0.55 * float((high - low).max()) + 1e-6, (low + high) / 2
    axis.scatter(points[:, 0], points[:, 1], s=1.2, c=colours, linewidths=0, rasterized=True)
    axis.plot(*path.T, color=page.TEAL, linewidth=1.6)
    axis.set_xlim(centre[0] - reach, centre[0] + reach)
    axis.set_ylim(centre[1] - reach, centre[1] + reach)
    axis.set_aspect("equal", adjustable="box")
