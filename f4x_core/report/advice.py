"""Finds why a scene is poor and what a person can supply: rules over the priors, the scaffold and the scores."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from itertools import groupby, pairwise
from typing import Any

import numpy as np
from scipy.spatial import cKDTree

from ..clip.notes import Remark
from ..fit.config import FitConfig
from ..fit.needs import MUCH_MOTION, Shortage, lack_in_words, moving_fraction
from ..language.lexicon import plural
from ..priors import Priors
from ..priors.depth import GUESSED_MOVERS
from ..scaffold import Scaffold
from .finding import (
    CAMERAS,
    MOVES,
    MOVING_DEPTH,
    PATH,
    ROOM,
    SCORE,
    UNSEEN,
    Finding,
    Weight,
    by_weight,
    caused_by,
    good,
    note,
    problem,
)
from .geometry_findings import ClipGeometry, about_geometry, origins_of_moving_depth

# Share of frames whose camera meets what stands in them, and the median reprojection error in pixels above which cameras are
# wrong and not only rough.
MIN_REGISTERED, MISSED_PX = 0.8, 1.5
# Trial focal lengths whose reprojection error is within this fraction of the least fit the tracks equally well; where the longest
# is so many times the shortest, the pictures hardly tell it (10 % is also what `priors.sfm` asks of them to leave its default).
EQUAL_FOCAL_ERROR, WIDE_FOCAL_RANGE = 0.1, 1.5
# Brightest over darkest exposure within a shot (the same things in both) above which colours no longer agree.
MUCH_EXPOSURE = 1.25
# Where cameras and depth put tracked static points in another frame: median miss as a fraction of the picture's width, over
# at most so many pairs of frames.
CONTRADICTION, CONTRADICTION_PAIRS = 0.01, 24
# Fewer supervised frames than this leave most surfaces seen once or twice.
FEW_FRAMES = 12
# Share of tracks that should live this many frames, and the shortest foreground survival that a scaffold can rest on.
SURVIVAL_AGE, MIN_SURVIVAL = 10, 0.4
# Depth whose confidence (median over the region) is lower is a guess.
MIN_CONFIDENCE = 0.25
# Share of pixels without any depth above which depth counts as missing.
UNKNOWN_DEPTH = 0.3
# Moving pixels further than this many control radii from every node are not carried by the scaffold.
NODE_REACH = 3.0
MIN_COVERAGE = 0.8
# Scores (dB): a watchable picture, the gap to unseen frames, what camera refinement may win, moving against static region.
WATCHABLE_PSNR, HELD_OUT_GAP, REFINEMENT_GAP, REGION_GAP = 27.0, 3.0, 1.5, 2.0
# Of the mask of moving objects, the mean dynamic alpha (`mover_coverage`): below the first the object is missing, above the second
# it is there; missing in so many used frames in a row, and reproduced so many dB worse (`psnr_mask`), it is reported.
# The decibels tell a lost object from a mask that grew: where dog's doubles, coverage halves and the score falls by 1.4 dB.
LOST_COVERAGE, KEPT_COVERAGE, MIN_LOST_FRAMES, LOST_GAP = 0.5, 0.7, 3, 2.0
# A frame this many dB below the median stands out; so many are named.
FRAME_GAP, NAMED_FRAMES = 4.0, 8
# The profile that is worth leaving for a longer one, and the words for it at the end of an advice.
SHORT_PROFILE, LONGER = "quick", "; --profile wild takes more steps."
# Most moving pixels looked at per frame when coverage is measured.
COVERAGE_SAMPLES = 400


def track_survival(visible: np.ndarray) -> np.ndarray:
    """Return the fraction of tracks still followed `age` frames after they were first seen, (F,) for ages 0..F-1.

    A track is followed until it is last visible (gaps are re-linked); at each age only tracks count that began early enough
    to reach it. NaN where no track did. `visible`: (F,N) bool.
    """
    frames = len(visible)
    seen = visible[:, visible.any(0)]
    if not seen.shape[1]:
        return np.full(frames, np.nan)
    first = seen.argmax(0)
    life = frames - 1 - seen[::-1].argmax(0) - first  # age at the last sighting
    ages = np.arange(frames)
    eligible = (first[None] + ages[:, None] <= frames - 1).sum(1)
    alive = (life[None] >= ages[:, None]).sum(1)
    return np.where(eligible > 0, alive / np.maximum(eligible, 1), np.nan)


def scaffold_coverage(priors: Priors, scaffold: Scaffold) -> float:
    """Return the fraction of moving pixels whose lifted point lies within `NODE_REACH` control radii of a node; NaN without any."""
    assert priors.mask is not None and priors.depth is not None and priors.cameras is not None
    inside = total = 0
    for frame in range(len(priors.frames)):
        rows, columns = np.nonzero(priors.mask[frame] & np.isfinite(priors.depth[frame]))
        step = max(1, len(rows) // COVERAGE_SAMPLES)
        rows, columns = rows[::step], columns[::step]
        if not len(rows) or not len(scaffold):
            continue
        pixels = np.stack([columns, rows], -1) + 0.5
        points = priors.cameras[frame].unproject(pixels, priors.depth[frame, rows, columns].astype(np.float64))
        distance, nearest = cKDTree(scaffold.xyz[frame]).query(points)
        inside += int((distance <= NODE_REACH * scaffold.radius[nearest]).sum())
        total += len(rows)
    return inside / total if total else float("nan")


def contradiction(priors: Priors) -> float:
    """Return the median distance in pixels of static points from their tracks in a later frame, by the depth and cameras here.

    Depth, cameras and tracks that are right meet; NaN where one of them is missing.
    """
    if priors.cameras is None or priors.depth is None or priors.tracks is None or priors.tracks_visible is None:
        return float("nan")
    motion = priors.tracks_motion if priors.tracks_motion is not None else np.zeros(priors.tracks.shape[1])
    frames, gap = len(priors.frames), max(1, len(priors.frames) // 4)
    misses = [np.zeros(0)]
    for t in np.unique(np.linspace(0, max(frames - 1 - gap, 0), CONTRADICTION_PAIRS).astype(int)):
        if t + gap >= frames:
            break
        both = priors.tracks_visible[t] & priors.tracks_visible[t + gap] & (motion < 0.3)
        here, there = (priors.tracks[i, both].astype(np.float64) for i in (t, t + gap))
        column, row = np.clip(np.floor(here), 0, [priors.width - 1, priors.height - 1]).astype(int).T
        depth = priors.depth[t, row, column].astype(np.float64)
        known = np.isfinite(depth)
        points = priors.cameras[int(t)].unproject(here[known], depth[known])
        misses.append(np.linalg.norm(priors.cameras[int(t + gap)].project(points)[0] - there[known], axis=1))
    missed = np.concatenate(misses)
    return float(np.median(missed)) if len(missed) else float("nan")


def findings(
    priors: Priors,
    scaffold: Scaffold | None,
    metrics: Mapping[str, Any],
    picked: str = "",
    profile: str = SHORT_PROFILE,
) -> list[Finding]:
    """Return everything that was found, problems first, and among findings of equal weight those of the geometry (see `by_cause`).

    `metrics`: the result of `evaluation.evaluate.evaluate`. `picked`: that of the clip, for advice on `--frames`.
    `profile`: the settings it was fitted with; only the short one is advised to take more steps.
    """
    found = [
        *about_geometry(priors, ClipGeometry.of(priors, scaffold)),
        *caused_by(SCORE, _about_used_frames(metrics, profile)),
        *caused_by(UNSEEN, _about_unseen_frames(metrics, profile)),
        *caused_by(MOVES, [*_about_what_moves(metrics), *_about_lost_movers(metrics)]),
        *_about_single_frames(metrics),
        *about_cuts(priors, picked),
        *_about_exposure(priors),
        *_about_camera(priors),
        *_about_lens(priors),
        *_about_motion(priors, scaffold),
        *_about_depth(priors),
        *caused_by(CAMERAS, _about_contradiction(priors)),
    ]
    known = any(finding.what.startswith(MOVING_DEPTH) for finding in found)
    found += [Finding("note", warning) for warning in priors.warnings if not (known and warning == GUESSED_MOVERS)]
    return by_weight(found)


def about_reading(remarks: Iterable[Remark]) -> list[Finding]:
    """Return the remarks on frames and stamps that were left out, mended or guessed while the clip was read."""
    return [Finding("note", remark.what, remark.advice) for remark in remarks]


def about_room(shortages: Sequence[Shortage]) -> list[Finding]:
    """Return a finding about Gaussians and nodes that there was no room for."""
    if not shortages:
        return []
    short = [one for one in shortages if one.room.short]
    limits = list(dict.fromkeys(one.limited_by for one in shortages))
    settings = [limit for limit in limits if limit.endswith(".max_count")]
    granted = [limit for limit in limits if limit not in settings]
    kinds = " and ".join(one.kind for one in short)
    thinner = f" What is {kinds} is covered more thinly, so it is softer." if short else ""
    advice = [f"Raise --set {' and '.join(settings)}, or let more --minutes and --memory decide."] * bool(settings)
    advice += [f"Grant more than {' and '.join(granted)}."] * bool(granted)
    weight: Weight = "problem" if short else "note"
    return [Finding(weight, f"There was {lack_in_words(shortages)}.{thinner}", " ".join(advice), ROOM)]


def quality(metrics: Mapping[str, Any], found: Sequence[Finding] = ()) -> str:
    """Return the scene in a word: poor, usable with limits, or good; empty where it was not measured."""
    score = fair_score(metrics)
    if score is None:
        return ""
    if score < WATCHABLE_PSNR:
        return "poor"
    return "usable with limits" if any(finding.weight == "problem" for finding in found) else "good"


def verdict(metrics: Mapping[str, Any], found: Sequence[Finding], subject: str = "The scene") -> str:
    """Return the page's first sentence, about `subject`."""
    word, problems = quality(metrics, found), sum(finding.weight == "problem" for finding in found)
    if not word:
        return f"{subject} was not measured."
    unseen = _unseen_psnr(metrics)
    score = metrics["used_psnr"] if unseen is None else unseen
    frames = "the frames it was made from" if unseen is None else "frames it never saw"
    counted = {0: "nothing stands out", 1: "one thing holds it back"}.get(problems, f"{problems} things hold it back")
    return f"{subject} is {word}: {score:.1f} dB on {frames}; {counted}."


def fair_score(metrics: Mapping[str, Any]) -> float | None:
    """Return the PSNR (dB) by which a scene is judged: of held-out frames, else of used ones; None: not measured."""
    return _unseen_psnr(metrics, metrics.get("used_psnr"))


def _unseen_psnr(metrics: Mapping[str, Any], default: float | None = None) -> float | None:
    """Return the PSNR of held-out frames, dB, at their registered cameras; at interpolated ones where they were not registered."""
    return metrics.get("held_out_psnr_registered", metrics.get("held_out_psnr", default))


def _about_used_frames(metrics: Mapping[str, Any], profile: str) -> Iterator[Finding]:
    used = metrics.get("used_psnr")
    if used is None or used >= WATCHABLE_PSNR:
        return
    yield problem(
        f"Even the frames it was made from come out at {used:.1f} dB (below {WATCHABLE_PSNR:.0f}).",
        "Look at the worst frames below, and check masks and cameras" + (LONGER if profile == SHORT_PROFILE else "."),
    )


def _about_unseen_frames(metrics: Mapping[str, Any], profile: str) -> Iterator[Finding]:
    used, held_out = metrics.get("used_psnr"), _unseen_psnr(metrics)
    if used is not None and held_out is not None and used - held_out > HELD_OUT_GAP:
        yield problem(
            f"Frames it never saw are {used - held_out:.1f} dB worse than those it was made from.",
            "Cameras or motion do not carry over between frames: use more frames (a smaller --frames step), or give"
            " cameras with --prior cameras=FILE and depth with --prior depth=DIR.",
        )
    refined, interpolated = metrics.get("held_out_psnr_refined"), metrics.get("held_out_psnr")
    located = metrics.get("held_out_psnr_registered", refined)
    if located is not None and interpolated is not None and located - interpolated > REFINEMENT_GAP:
        yield note(
            f"Cameras interpolated between used frames lose {located - interpolated:.1f} dB on unseen ones: the scene is"
            " right, the camera shook between frames.",
            "Film more steadily, or give cameras with --prior cameras=FILE.",
        )
    elif held_out is not None and refined is not None and refined - held_out > REFINEMENT_GAP:
        yield note(
            f"Refining the camera on the colours of each unseen frame wins {refined - held_out:.1f} dB: cameras and depth"
            " do not agree.",
            "Give depth with --prior depth=DIR, or cameras with --prior cameras=FILE.",
        )
    blend = metrics.get("held_out_psnr_flow_blend_registered", metrics.get("held_out_psnr_flow_blend"))
    if held_out is not None and blend is not None:
        if held_out < blend:
            yield problem(
                f"Simply blending the two neighbouring frames shows unseen frames better ({blend:.1f} dB) than the"
                f" scene ({held_out:.1f} dB).",
                "See the points about camera, depth and motion" + (LONGER if profile == SHORT_PROFILE else "."),
            )
        else:
            yield good(f"Unseen frames are {held_out - blend:.1f} dB better than blending their neighbours.")


def _about_what_moves(metrics: Mapping[str, Any]) -> Iterator[Finding]:
    """Yield a finding if moving regions are shown worse than static ones, in used or unseen frames, where the gap is larger."""
    pairs = [
        (where, *(metrics.get(f"{frames}_psnr_{region}{cameras}", np.nan) for region in ("moving", "static")))
        for frames, cameras, where in (("used", "", ""), ("held_out", "_registered", " in unseen frames"))
    ]
    worse = [
        (static - moving, where, moving, static) for where, moving, static in pairs if static - moving > REGION_GAP
    ]
    if not worse:
        return
    gap, where, moving, static = max(worse)
    yield problem(
        f"What moves is {gap:.1f} dB worse{where} than what stands still ({moving:.1f} against {static:.1f} dB).",
        "Give masks of what moves with --masks DIR and depth with --prior depth=DIR; fast motion needs a higher"
        " frame rate.",
    )


def fair_psnr(row: Mapping[str, Any]) -> float:
    """Return the PSNR of a frame of the metrics, with its registered camera where it was held out.

    The interpolated camera blames the scene for the hand that shook.
    """
    return float(row.get("psnr_registered", row["psnr"]))


def _about_single_frames(metrics: Mapping[str, Any]) -> Iterator[Finding]:
    """Yield the frames far below the others, and why a held-out frame at the clip's end is one of them."""
    rows = metrics.get("frames", [])
    if not rows:
        return
    median = float(np.median([fair_psnr(row) for row in rows]))
    low = {row["frame"]: row["held_out"] for row in rows if fair_psnr(row) < median - FRAME_GAP}
    ends = [frame for frame in (rows[0]["frame"], rows[-1]["frame"]) if low.get(frame)]  # held out there
    rest = [frame for frame in low if frame not in ends]
    for frame in ends:
        yield note(
            f"Frame {frame} was held out at the clip's end, so its camera is a guess beyond the last one that was used; it"
            " pulls the held-out mean down."
        )
    if rest:
        named = f"{plural('frame', len(rest))} {', '.join(map(str, rest[:NAMED_FRAMES]))}"
        named += " …" if len(rest) > NAMED_FRAMES else ""
        yield note(
            f"More than {FRAME_GAP:.0f} dB below the median of {median:.1f} dB: {named}.",
            "Look for blur, flashes or cuts there, and leave such frames out with --frames.",
        )


def _about_lost_movers(metrics: Mapping[str, Any]) -> Iterator[Finding]:
    """Yield the runs of used frames whose moving mask the scene does not cover, though it does in others of the clip."""
    rows = [row for row in metrics.get("frames", []) if "mover_coverage" in row and not row["held_out"]]
    kept = [row for row in rows if row["mover_coverage"] >= LOST_COVERAGE]
    if not kept or float(np.median([row["mover_coverage"] for row in kept])) < KEPT_COVERAGE:
        return
    usual = float(np.median([row["psnr_mask"] for row in kept]))
    for lost, run in groupby(rows, key=lambda row: row["mover_coverage"] < LOST_COVERAGE):
        missing = list(run)
        psnr = float(np.mean([row["psnr_mask"] for row in missing]))
        if not lost or len(missing) < MIN_LOST_FRAMES or psnr > usual - LOST_GAP:
            continue
        first, last = missing[0]["frame"], missing[-1]["frame"]
        if missing[-1] is rows[-1]:
            when = f"From frame {first} on"
        else:
            when = f"Until frame {last}" if missing[0] is rows[0] else f"In frames {first} to {last}"
        covered = float(np.mean([row["mover_coverage"] for row in missing]))
        yield problem(
            f"{when} the moving object is missing: the scene covers {covered:.0%} of where the masks have it, at"
            f" {psnr:.1f} dB ({usual:.1f} dB in the other frames).",
            "Its tracks may have ended where something passes in front of it: check its masks and give better ones with"
            " --masks DIR, give tracks with --prior tracks=FILE, or fit only the other frames with --frames.",
        )


def about_cuts(priors: Priors, picked: str = "") -> list[Finding]:
    """Return the findings about hard cuts within the clip (`clip.changes`), in frames of its source: `picked` is the clip's."""
    cuts = priors.statistics.get("changes", {}).get("cuts", [])
    if not cuts:
        return []
    first, end, step = map(int, (picked or f"0:{priors.frames[-1] + 1}:1").split(":"))
    edges = [first, *(first + step * cut for cut in cuts), end]
    start, stop = max(pairwise(edges), key=lambda shot: shot[1] - shot[0])
    named = ", ".join(map(str, edges[1:-1][:NAMED_FRAMES])) + (" …" if len(cuts) > NAMED_FRAMES else "")
    return [
        Finding(
            "problem",
            f"The clip holds {len(cuts) + 1} shots, cut at frame {named} of its source; a scene can be made of one.",
            f"Give one shot, for example the longest: --frames {start}:{stop}:{step}; --window N makes a scene of each.",
        )
    ]


def _about_exposure(priors: Priors) -> Iterator[Finding]:
    exposure = priors.statistics.get("changes", {}).get("exposure", 1.0)
    if exposure <= MUCH_EXPOSURE:
        return
    yield problem(
        f"The exposure changes by {exposure - 1:.0%}; the scene has one brightness, a mean of all.",
        "Lock the exposure while filming, or leave the frames where it changes out with --frames.",
    )


def _about_camera(priors: Priors) -> Iterator[Finding]:
    if len(priors.frames) < FEW_FRAMES:
        yield problem(f"Only {len(priors.frames)} frames were used.", "Give a longer clip or a smaller step.")
    known = priors.statistics.get("cameras", {})
    registered, wanted = known.get("registered"), len(priors.frames)
    if registered is not None and registered < MIN_REGISTERED * wanted:
        yield problem(
            f"Only {registered} of {wanted} frames found their camera by themselves; the others follow their neighbours.",
            "Blurred or empty frames are the usual cause: leave them out with --frames, or give cameras with"
            " --prior cameras=FILE.",
            cause=CAMERAS,
        )
    error = known.get("reprojection_px", {}).get("median")
    if error is not None and error > MISSED_PX:
        yield problem(
            f"The cameras miss the points they see by {error:.1f} px (median).",
            "A rolling shutter, zoom or blur is the usual cause: give cameras with --prior cameras=FILE, and masks of what"
            " moves with --masks DIR.",
            cause=CAMERAS,
        )


def _about_lens(priors: Priors) -> Iterator[Finding]:
    """Yield the findings from the search for the focal length, where there was one (`statistics["cameras"]`)."""
    known = priors.statistics.get("cameras", {})
    search = known.get("pan_focal_search" if priors.camera_kind == "pan" else "focal_search", {})
    focals, errors = (np.array(search.get(name, []), np.float64) for name in ("focal_over_width", "error_px"))
    if len(focals) < 2 or not np.isfinite(errors).any():
        return
    equal = focals[errors <= (1 + EQUAL_FOCAL_ERROR) * np.nanmin(errors)]
    advice = "Where the lens is known, give cameras with --prior cameras=FILE."
    if equal.max() >= WIDE_FOCAL_RANGE * equal.min():
        yield note(
            f"The pictures hardly tell the focal length: from {equal.min():.2g} to {equal.max():.2g} picture widths fit the"
            f" tracks within {EQUAL_FOCAL_ERROR:.0%}; a wrong one stretches or flattens the depth.",
            advice,
        )
        return
    best = focals[np.nanargmin(errors)]
    end = {focals.min(): "shortest", focals.max(): "longest"}.get(best)
    if end is None:
        return
    yield problem(
        f"Of the focal lengths that were tried the {end}, {best:.2g} picture widths, fits best; the lens may be"
        f" {'wider' if end == 'shortest' else 'longer'} than any of them.",
        advice,
    )


def _about_motion(priors: Priors, scaffold: Scaffold | None) -> Iterator[Finding]:
    fraction = moving_fraction(priors)
    if fraction > MUCH_MOTION:
        known = priors.statistics.get("cameras", {}).get("static_tracks")
        held = "" if not known or priors.camera_kind == "static" else f", and the cameras rest on {known} points of it"
        yield problem(
            f"{fraction:.0%} of the picture counts as moving; the background is hardly seen{held}.",
            "If that is wrong, give masks of what really moves with --masks DIR; otherwise film from further away.",
        )
    elif scaffold is None and fraction >= FitConfig.min_moving_fraction:
        yield problem(
            f"{fraction:.2%} of the pixels count as moving, but too little of them can be followed, so the scene stands still.",
            "Mark what moves with --masks DIR, or give tracks with --prior tracks=FILE.",
            cause=MOVES,
        )
    elif scaffold is None:
        yield note(
            f"Nothing was taken to move ({fraction:.2%} of the pixels), so the scene stands still.",
            "If something does move, mark it with --masks DIR.",
        )
    if priors.tracks_visible is not None:
        yield from _about_tracks(priors, has_motion=scaffold is not None)
    if scaffold is not None and priors.depth is not None and priors.cameras is not None:
        covered = scaffold_coverage(priors, scaffold)
        if covered < MIN_COVERAGE:
            yield problem(
                f"Only {covered:.0%} of the moving pixels lie near a motion node.",
                "Parts that were never tracked cannot be carried; masks (--masks DIR) and more frames help tracks survive.",
                cause=MOVES,
            )


def _about_tracks(priors: Priors, has_motion: bool) -> Iterator[Finding]:
    assert priors.tracks_visible is not None
    age = min(SURVIVAL_AGE, len(priors.frames) - 1)
    groups = [("points", np.ones(priors.tracks_visible.shape[1], bool))]
    if has_motion and priors.tracks_motion is not None:
        groups.append(("moving points", priors.tracks_motion > 0.5))
    for name, chosen in groups:
        alive = track_survival(priors.tracks_visible[:, chosen])[age]
        if alive < MIN_SURVIVAL:
            yield problem(
                f"Only {alive:.0%} of the {name} can be followed for {age} frames.",
                "Fast motion, blur and plain surfaces lose tracks: film slower or at a higher frame rate, or give tracks"
                " with --prior tracks=FILE.",
                cause=MOVES if name == "moving points" else "",
            )
            return


def _about_depth(priors: Priors) -> Iterator[Finding]:
    if priors.depth is None or priors.depth_confidence is None:
        return
    unmeasured = PATH if priors.camera_kind in ("static", "pan") else "depth"  # from one place nothing is measured
    unknown = float(np.mean(~np.isfinite(priors.depth)))
    if unknown > UNKNOWN_DEPTH:
        yield problem(
            f"{unknown:.0%} of the pixels have no depth.", "Give depth with --prior depth=DIR.", cause=unmeasured
        )
    background = "The depth of the background"
    regions = {background: None if priors.mask is None else ~priors.mask, MOVING_DEPTH: priors.mask}
    if origins_of_moving_depth(priors):  # how it was found says more than a confidence
        del regions[MOVING_DEPTH]
    for name, region in regions.items():
        values = priors.depth_confidence if region is None else priors.depth_confidence[region]
        if values.size and float(np.median(values)) < MIN_CONFIDENCE:
            yield Finding(
                "problem" if name == background else "note",
                f"{name} is a guess (median confidence {float(np.median(values)):.2f}).",
                "Give depth with --prior depth=DIR, for example from a depth sensor or a depth network.",
                cause=MOVING_DEPTH if name == MOVING_DEPTH else unmeasured,
            )


def _about_contradiction(priors: Priors) -> Iterator[Finding]:
    if priors.statistics.get("cameras", {}).get("assumed"):
        return  # that is the problem, and it is reported already
    missed = contradiction(priors)
    if not missed > CONTRADICTION * priors.width:
        return
    yield problem(
        f"Depth, cameras and tracks contradict each other: static points land {missed:.1f} px (median) beside their tracks.",
        "One of them is wrong: leave out what was given with --prior, or give cameras and depth that belong together.",
    )
