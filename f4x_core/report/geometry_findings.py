"""Findings about the geometry of a scene: camera motion, number of sides seen, believable angle aside."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from ..fit.needs import MUCH_MOTION, moving_fraction
from ..metrics.believed import Believed, believed_degrees, depth_evidence
from ..metrics.viewing_angles import GroupView, angular_factor, group_views, parallax_degrees, static_view_degrees
from ..metrics.way_round import WayRound
from ..priors import Priors
from ..priors.point_tracks import PointTracks
from ..scaffold import Scaffold
from .finding import MOVING_DEPTH, PATH, Finding, Weight, caused_by, good, note, problem

# Angle (degrees) between the outermost cameras at the median depth. Below the first nothing but the original view can be
# believed, below the second only views close to the path.
LITTLE_PARALLAX, MODEST_PARALLAX = 2.0, 8.0
# Below so many degrees off the path there is no other view to speak of; from so many on, a person can look around.
ONLY_THE_PATH, WIDE_VIEWS = 1.0, 10.0

# A camera rests where its static tracks move by less than the first (median over the frames, pixels at a width of 480: 0.03 in a
# clip from a tripod, 2 and more in the real clips, which are hand-held); it is bumped where they move by more than the second, in
# at most this fraction of the frames.
RESTS_PX, BUMP_PX, BUMPED_FRAMES = 0.5, 3.0, 0.2

SIDEWAYS = "Film with a clear step sideways, or give cameras with --prior cameras=FILE or depth with --prior depth=DIR."


@dataclass(frozen=True)
class ClipGeometry:
    """Everything the page says of the geometry; angles in degrees."""

    way_round: WayRound | None
    """None where no mirrored solution was compared."""
    parallax: float
    """Between the two outermost cameras at the median depth."""
    static_degrees: tuple[float, float] | None
    """Median and 90th percentile of the angle between the outermost viewing rays of a static point."""
    angular_factor: float | None
    """DyCheck's angular effective multi-view factor of the clip, degrees per second; None without cameras."""
    groups: tuple[GroupView, ...]
    """Groups of connected moving nodes, the largest first."""
    believed: Believed | None
    """None without cameras or depth."""

    @classmethod
    def of(cls, priors: Priors, scaffold: Scaffold | None) -> ClipGeometry:
        """Measure it."""
        angles, cameras = static_view_degrees(priors), priors.cameras
        evidence = depth_evidence(priors)
        here = scaffold is not None and cameras is not None and len(cameras) == len(scaffold.times)
        return cls(
            way_round=WayRound.of(priors),
            parallax=parallax_degrees(priors),
            static_degrees=(float(np.median(angles)), float(np.percentile(angles, 90))) if len(angles) else None,
            angular_factor=angular_factor(cameras, priors.fps) if cameras is not None else None,
            groups=tuple(group_views(scaffold, cameras, priors.fps)) if here else (),  # type: ignore[arg-type]
            believed=believed_degrees(evidence) if evidence is not None else None,
        )


def about_geometry(priors: Priors, geometry: ClipGeometry) -> list[Finding]:
    """Return the findings about the geometry, the mirror ambiguity first."""
    path = [
        *_about_way_round(geometry.way_round),
        *_about_path(priors, geometry),
        *_about_translation(priors),
        *_about_believed(priors, geometry),
    ]
    return [*caused_by(PATH, path), *_about_bump(priors), *caused_by(MOVING_DEPTH, _about_movers(priors))]


def _about_way_round(way: WayRound | None) -> Iterator[Finding]:
    if way is None:
        return
    if way.verdict == "sure":
        yield good(f"Near and far are the right way round: {way.odds} by the evidence under Geometry.")
        return
    if way.verdict == "likely":
        yield note(
            f"Near and far are probably the right way round ({way.odds}); look at the views aside under Geometry.",
            SIDEWAYS,
        )
        return
    yield problem(
        f"Near and far may be exchanged: the clip and its mirrored solution fit it about equally well ({way.odds} for the"
        f" one chosen, {way.chosen}).",
        SIDEWAYS,
    )


def _about_path(priors: Priors, geometry: ClipGeometry) -> Iterator[Finding]:
    """Yield findings about the camera's motion: it must suffice to measure depth."""
    unknown = priors.statistics.get("cameras", {}).get("assumed")
    if unknown:
        taken = {"static": "stand still", "pan": "turn only"}.get(str(priors.camera_kind), "be as found")
        yield problem(
            f"How the camera moved is not known, because {unknown}; it is taken to {taken}, and only the original view"
            " can be believed.",
            "Film with more of a still, textured background in view, mark what moves with --masks DIR, or give cameras with"
            " --prior cameras=FILE.",
        )
        return
    if priors.camera_kind == "static":
        yield _about_standing(priors, geometry)
        return
    zoom = priors.statistics.get("cameras", {}).get("zoom")
    if priors.camera_kind == "pan" and zoom is not None:
        yield problem(
            f"The lens zoomed during the clip ({zoom['factor']:.2f} times), and the camera only turned or stood still;"
            " without parallax depth cannot be measured and new views stay close to the path.",
            "Walk towards your subject or a step sideways instead of zooming, or give depth with --prior depth=DIR.",
        )
        return
    if priors.camera_kind == "pan":
        yield problem(
            "The camera only turned; without parallax depth cannot be measured and new views stay close to the path.",
            "Walk a step sideways instead of turning on the spot, or give depth with --prior depth=DIR.",
        )
        return
    angle, seen = geometry.parallax, ""
    if geometry.static_degrees is not None:
        seen = f"; a point of the background is seen from {geometry.static_degrees[0]:.1f}° (median)"
    if angle < LITTLE_PARALLAX:
        yield problem(
            f"The camera moved very little: {angle:.1f}° between its outermost places{seen}.",
            "Move the camera sideways by about a tenth of the distance to your subject, or give depth with"
            " --prior depth=DIR.",
        )
        return
    advice = "A wider path makes wider views possible." if angle < MODEST_PARALLAX else ""
    # A path that rests on the little that stands still may be that of something that moves.
    weight: Weight = "note" if advice or moving_fraction(priors) > MUCH_MOTION else "good"
    yield Finding(weight, f"The camera's path spans {angle:.0f}° of the scene{seen}.", advice)


def _about_standing(priors: Priors, geometry: ClipGeometry) -> Finding:
    """Return the finding about a static camera: the source of its guessed depth, and how far aside it holds."""
    guess = priors.statistics.get("depth", {}).get("guess")
    jitter = priors.statistics.get("cameras", {}).get("standing", {}).get("jitter_px")
    shift = f" (the picture shifts by {jitter:.1f} px)" if jitter is not None else ""
    sentence = f"The camera stood still{shift}, so nothing tells how far things are"
    if guess is None:
        sentence += "; only the original view can be believed."
    else:
        touched = "feet and the lowest points" if guess["people"] else "the lowest points"
        ground = f"where {touched} of what moves touch it ({guess['contacts']} sightings)"
        whence = ground if guess["known"] else "where it usually lies, because too little walks over it"
        sentence += f": their depth is a guess. The ground lies {whence}, and what stands on it is upright."
    if guess is not None and geometry.believed is not None:
        degrees = geometry.believed.static
        sentence += (
            f" Views hold within about {degrees:.{1 if degrees < 2 else 0}f}° aside; beyond, things shift as guessed."
        )
    return Finding(
        "problem", sentence, "Walk sideways by half a metre while filming, or give depth with --prior depth=DIR."
    )


def _about_bump(priors: Priors) -> Iterator[Finding]:
    """Yield a camera that rests but for a few frames."""
    steps, unit = _track_steps(priors), priors.width / 480
    if not len(steps) or np.isnan(steps).all() or np.nanmedian(steps) > RESTS_PX * unit:
        return
    bumped = np.flatnonzero(steps > BUMP_PX * unit)
    if not 0 < len(bumped) <= max(1, BUMPED_FRAMES * len(steps)):
        return
    first, last = int(priors.frames[bumped[0] + 1]), int(priors.frames[bumped[-1] + 1])
    when = f"at frame {first}" if first == last else f"between frames {first} and {last}"
    yield problem(
        f"The camera was bumped {when}: the picture jumps by up to {np.nanmax(steps):.0f} px there and rests otherwise.",
        "What is blurred there stays blurred: fit the frames before or after it alone with --frames.",
    )


def _track_steps(priors: Priors) -> np.ndarray:
    """Return the median shift of static tracks between supervised frames, `(F - 1,)` pixels, NaN where none is seen in both."""
    tracks, seen = PointTracks.of(priors).uv, PointTracks.of(priors).seen
    steps = np.full(max(len(tracks) - 1, 0), np.nan)
    for row in range(len(steps)):
        both = seen[row] & seen[row + 1]
        if both.any():
            steps[row] = np.median(np.linalg.norm(tracks[row + 1, both] - tracks[row, both], axis=-1))
    return steps


def _about_translation(priors: Priors) -> Iterator[Finding]:
    """Yield a step so small that its size rests on a prior."""
    translation = priors.statistics.get("cameras", {}).get("translation", {})
    if translation.get("verdict") != "small" or priors.camera_kind != "moving":
        return
    size = translation.get("size_px")
    by = f" by only {size:.1f} px" if size is not None else " hardly"
    yield note(
        f"The camera's shift moves the picture{by} beyond what its turning does, so depth is rough.",
        "Walk a step sideways instead of turning on the spot.",
    )


def _about_believed(priors: Priors, geometry: ClipGeometry) -> Iterator[Finding]:
    """Yield a finding about the angle from the path up to which views can be believed."""
    believed = geometry.believed
    if believed is None:
        return
    weight: Weight = "good" if min(believed.static, believed.moving or believed.static) >= WIDE_VIEWS else "note"
    yield Finding(weight, believed_sentence(believed))


def believed_sentence(believed: Believed) -> str:
    """Return `believed` in words, for the findings and whoever checks them against true views."""
    static, moving = believed.static, believed.moving
    if static < ONLY_THE_PATH:
        return "Views can be believed along the camera's own path only, not from the side."
    sentence = f"Views can be believed within about {static:.0f}° of the camera's path"
    if moving is None or moving > static - 0.5:
        return sentence + "."
    limit = f"within about {moving:.0f}° of it" if moving >= ONLY_THE_PATH else "on the path alone"
    return f"{sentence}, moving objects {limit}."


MEASURED = "its own motion"
GUESSED_FROM = {
    "feet": "where feet stand on the ground",
    "ground contact": "where it touches the ground",
    "size": "how its size changes",
    "surroundings": "its surroundings, as no contact with the ground is seen and it turns little",
}
"""Source of a moving object's depth (`priors.movers.place_objects`) other than `MEASURED` -> the same in a sentence."""


def _about_movers(priors: Priors) -> Iterator[Finding]:
    """Yield a finding that names what decided the depth of the moving objects."""
    decided = origins_of_moving_depth(priors)
    if not decided:
        return
    several = sum(decided.values()) > 1
    guesses = [
        GUESSED_FROM.get(origin, origin) + (f" ({count})" if several else "")
        for origin, count in decided.most_common()
        if origin != MEASURED
    ]
    ways = [f"a guess from {', '.join(guesses)}"] * bool(guesses)
    ways += [f"measured by {MEASURED}" + (f" ({decided[MEASURED]})" if several else "")] * (MEASURED in decided)
    unseen = "surroundings" in decided
    advice = "Keep feet or wheels in the picture, or give depth with --prior depth=DIR." if unseen else ""
    yield note(f"{MOVING_DEPTH} is {', and '.join(ways)}.", advice)


def origins_of_moving_depth(priors: Priors) -> Counter[str]:
    """Count moving objects by the source of their depth (`priors.movers.place_objects`); empty where none is recorded."""
    movers = priors.statistics.get("depth", {}).get("movers", [])
    return Counter(str(mover["decided_by"]) for mover in movers if "decided_by" in mover)
