"""A camera that turns without moving: its focal length, and a zoom."""

from __future__ import annotations

from dataclasses import replace

from .bundle import BundleConfig, adjust
from .camera_problem import Attempt, CameraProblem
from .sfm import DEFAULT_FOCAL, FOCALS, Solution, refocused, sampled, search_focal
from .zoom import MIN_COST_LEFT_BY_MOVING, Zoom, find_zoom, mean_cost, zoomed


def search_lens(job: CameraProblem, turning: Solution) -> tuple[Solution, dict[str, list[float]]]:
    """Return `search_focal` among lenses of films, or with the one that is known."""
    width, side = job.priors.width, max(job.priors.width, job.priors.height)
    candidates = [focal * side / width for focal in FOCALS] if job.lens.refine_focal else [job.focal / width]
    return search_focal(turning, width, candidates, DEFAULT_FOCAL * side / width)


def zoom_of(job: CameraProblem, turning: Solution) -> Zoom | None:
    """Return the zoom of a turning camera that explains most of the remaining error; None where another provider gave the lens."""
    sample, frames = sampled(turning)
    if job.first is not None or not len(sample.observations.frame):
        return None
    zoom = find_zoom(sample, frames, job.lens)
    return zoom if zoom.explains else None


def moving_explains_more(zoom: Zoom, moved: Solution) -> bool:
    """Return True if a moving camera leaves far less error than the zoom."""
    sample, _ = sampled(moved)
    unknowns = 6 * len(sample.bundle.center) + 3 * len(sample.bundle.points)
    return mean_cost(sample.bundle, sample.observations, unknowns) < MIN_COST_LEFT_BY_MOVING * zoom.cost


def panned(job: CameraProblem, start: Attempt, focal: float, zoom: Zoom | None = None) -> Attempt:
    """Return the turning camera `start` at the focal length `focal` in pixels, or with its zoom."""
    start = replace(start.without("mirror", "solver"), kind="pan")
    if zoom is None:
        start = start.warning(
            "The camera only turns (almost no parallax): the depth of the background cannot be measured, so it is a guess"
            " and views from other places will look flat."
        )
        return replace(start, solution=adjusted_pan(start.solution, focal))
    found = zoomed(start.solution, zoom, None if job.lens.refine_focal else job.focal)
    summary = zoom.summary(found.bundle, job.priors.width)
    start = start.without("pan_focal_search").warning(
        f"The lens zooms ({summary['factor']:.2f} times): a zoom looks like a step forward, so the camera is taken to stand"
        " and turn, and the depth of the background is a guess."
    )
    return replace(start.noting(zoom=summary), solution=found)


def adjusted_pan(turning: Solution, focal: float) -> Solution:
    """Return the rotations of all frames adjusted at the focal length found."""
    turning = refocused(turning, focal, translating=False)
    settings = BundleConfig(iterations=8, refine_focal=False, refine_centers=False)
    return replace(turning, bundle=adjust(turning.bundle, turning.observations, settings))
