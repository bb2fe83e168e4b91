"""Within how many degrees of the camera's path a view can be believed, from what is known when a scene is fitted. No torch.

A camera that moves aside by the angle `a` about the scene's centre (depth 1) and keeps looking at it shows a surface whose
depth is wrong by the fraction `e` displaced by `f tan(a) e` (small `e`, `f` the focal length). A view is believed while that
stays below `TOLERANCE`. What is left is to know `e`: from the confidence of the depth, from the angle between the viewing
rays of static points, and from how surely near and far are not exchanged.

Constants were chosen on the rendered clips `knight` and `procedural` with offline priors.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..priors import Priors
from .viewing_angles import static_view_degrees
from .way_round import WayRound

TOLERANCE = 3 / 480
"""Displacement that still counts as the right place, in picture widths: three pixels of the usual 480."""
MAX_DEGREES = 30.0
"""Further aside most of what is seen was hidden from the clip, however good its depth."""
DEPTH_FLOOR = 0.02
"""Relative error of the best depth here: surfaces of Gaussians are no thinner."""
GUESS_ERROR = 0.6
"""Relative error of depth that is a guess from the picture alone; no evidence can make it worse than that."""
CONFIDENCE_SCALE = 50.0
"""`confidence = p / (p + 50)` with `p = 1 / error^2` is what the classical provider of depth writes."""
TRACK_NOISE_PX = 0.4
"""Error of a track's pixel where the cameras' statistics do not say it; 480 pixels wide."""
MIRROR_ERROR = 1.0
"""Relative error of depth where near and far are exchanged."""
DECIDED_ERROR = {"feet": 0.08, "ground contact": 0.12, "size": 0.2, "surroundings": 0.3}
"""Relative error of a moving object's depth by what decided it. Its own motion is judged by its viewing angle instead.

Ground contact: between the upper quartiles on the rendered clips `knight` (0.08) and `procedural` (0.14). Of the other two no
rendered clip has shown yet.
"""
SAMPLED = 4
"""Every so many pixels of rows and columns tell the median confidence."""


@dataclass(frozen=True)
class DepthEvidence:
    """Evidence about the depth of a clip, for `believed_degrees`; angles in degrees, errors as fractions of the depth."""

    focal: float
    """Focal length in picture widths."""
    depth_error: float
    """Relative error of static depth, by its confidence."""
    view_degrees: float | None
    """Median angle between the outermost viewing rays of a static point; None where depth does not come from them."""
    ray_noise: float
    """Error of a viewing ray, in picture widths."""
    mirror_probability: float
    """0..1: that near and far are exchanged."""
    moving_error: float | None
    """Relative error of the depth of moving objects; None where nothing moves."""


@dataclass(frozen=True)
class Believed:
    """Degrees off the camera's path within which views can be believed, 0 to `MAX_DEGREES`."""

    static: float
    """The background."""
    moving: float | None
    """Moving objects; None where nothing moves."""


def believed_degrees(evidence: DepthEvidence) -> Believed:
    """Return the angles at which what is expected to be displaced by wrong depth is displaced by `TOLERANCE`.

    Independent errors add in squares: depth by its confidence, the relief by `ray noise / (focal x angle between rays)`, and
    an exchange of near and far by its probability. Moving objects stand in that world, so that their own error is added.
    """
    relief = 0.0
    if evidence.view_degrees is not None:
        angle = np.radians(max(evidence.view_degrees, 1e-6))
        relief = min(evidence.ray_noise / (evidence.focal * angle), GUESS_ERROR)
    world = np.hypot(relief, evidence.mirror_probability * MIRROR_ERROR)
    static = _angle(float(np.hypot(world, evidence.depth_error)), evidence.focal)
    if evidence.moving_error is None:
        return Believed(static, None)
    return Believed(static, min(static, _angle(float(np.hypot(world, evidence.moving_error)), evidence.focal)))


def depth_evidence(priors: Priors) -> DepthEvidence | None:
    """Gather the evidence from priors; None without cameras or depth."""
    if priors.cameras is None or priors.depth is None:
        return None
    statistics = priors.statistics.get("cameras", {})
    noise_px = statistics.get("reprojection_px", {}).get("median") or TRACK_NOISE_PX * priors.width / 480
    focal = float(np.median(priors.cameras.intrinsics[:, 0, 0])) / priors.cameras.width
    angles = static_view_degrees(priors) if _depth_from_rays(priors) else np.zeros(0)
    way = WayRound.of(priors)
    return DepthEvidence(
        focal=focal,
        depth_error=_error_of(_confidence(priors, moving=False)),
        view_degrees=float(np.median(angles)) if len(angles) else None,
        ray_noise=noise_px / priors.width,
        mirror_probability=way.probability_wrong if way is not None else 0.0,
        moving_error=_moving_error(priors, focal, noise_px / priors.width),
    )


def _angle(error: float, focal: float) -> float:
    """Return the degrees at which a relative depth error displaces by the tolerance."""
    return min(float(np.degrees(np.arctan(TOLERANCE / (focal * max(error, DEPTH_FLOOR))))), MAX_DEGREES)


def _depth_from_rays(priors: Priors) -> bool:
    """Return True if depth was measured between the cameras of the clip, and not guessed, predicted or given."""
    return priors.camera_kind == "moving" and priors.provenance.get("depth", {}).get("provider") == "classical"


def _confidence(priors: Priors, moving: bool) -> np.ndarray:
    """Return the confidence (n,) of known depth of moving objects or of the background; 1 where a provider gave none."""
    assert priors.depth is not None
    pick = slice(None), slice(None, None, SAMPLED), slice(None, None, SAMPLED)
    known = np.isfinite(priors.depth[pick])
    if priors.mask is not None:
        known &= priors.mask[pick] == moving
    elif moving:
        known[:] = False
    given = np.ones(known.shape) if priors.depth_confidence is None else priors.depth_confidence[pick]
    return given[known].astype(np.float64)


def _error_of(confidence: np.ndarray) -> float:
    """Return the relative depth error of the median confidence."""
    if not len(confidence):
        return GUESS_ERROR
    middle = float(np.median(confidence))
    return min(float(np.sqrt((1 - middle) / max(CONFIDENCE_SCALE * middle, 1e-12))), GUESS_ERROR)


def _moving_error(priors: Priors, focal: float, ray_noise: float) -> float | None:
    """Return the median over the moving objects whose depth's origin is known, else by the confidence of moving pixels.

    The classical provider's confidence there is how much of the ground contact was seen and no precision; priors written
    before origins were kept count as ground contact.
    """
    errors = []
    for mover in priors.statistics.get("depth", {}).get("movers", []):
        decided, degrees = mover.get("decided_by"), mover.get("emf_degrees")
        if decided == "its own motion" and degrees:
            errors.append(min(ray_noise / (focal * np.radians(degrees)), GUESS_ERROR))
        elif decided in DECIDED_ERROR:
            errors.append(DECIDED_ERROR[decided])
    if errors:
        return float(np.median(errors))
    confidence = _confidence(priors, moving=True)
    if len(confidence) and _depth_from_rays(priors):
        return DECIDED_ERROR["ground contact"]
    return _error_of(confidence) if len(confidence) else None
