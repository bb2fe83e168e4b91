"""Speed against error of the fit: profile, steps, resolution, number of Gaussians."""

from __future__ import annotations

import statistics
import time
from dataclasses import replace
from functools import partial
from typing import Any

from f4x_core.evaluation.evaluate import baseline_scores
from f4x_core.evaluation.perceptual_distance import lpips_missing
from f4x_core.fit.config import PROFILES, FitConfig, profile

from ..study import Context, Figure, Findings, Row, Table
from .toy_fits import (
    NOTE,
    QUICK_SIZE,
    base_config,
    each_seed,
    fit_world,
    mean_row,
    measure,
    score_world,
    shorten,
    thin_out,
    toy_world,
)
from .toy_worlds import make_world

WORLD = "two movers"
"""World that is fitted: two rigid movers need a scaffold, and the camera moves."""
QUICK_FRACTION, MIN_STEPS = 1 / 50, 20
"""Of a profile's steps in a quick report."""
QUICK_COUNTS, FULL_COUNTS = (50, 100, 200, 400), (150, 300, 600, 1200, 2400, 4800)
QUICK_WIDTHS, FULL_WIDTHS = (48, 96, 192), (96, 160, 240, 336)
QUICK_FACTORS, FULL_FACTORS = (0.25, 0.5, 1.0, 2.0), (0.125, 0.25, 0.5, 1.0, 2.0, 4.0)
SEEDS, MANY_STEPS = 3, 5000
"""Fits of each setting in a full report; from so many steps on one says it."""
TIMED = ("fit (s)",)


def study_profiles(context: Context) -> Findings:
    """Every profile, and two ways of making held-out frames that know no 3D; small pictures, for some take 8,000 steps."""
    world = make_world(WORLD, *QUICK_SIZE)
    rows: list[Row] = []
    for name in PROFILES:
        config = replace(profile(name), threads=context.threads)
        config = shorten(config, max(round(QUICK_FRACTION * config.steps), MIN_STEPS)) if context.quick else config
        rows.append({"profile": name, "steps": config.steps} | _fits(context, name, world, config))
    rows += context.step("baselines", partial(_baselines, world))
    best = max(rows, key=lambda row: row.get("novel (dB)") or 0)
    quickest = min((row for row in rows if "steps" in row), key=lambda row: row["fit (s)"])
    still = max(row["held out (dB)"] for row in rows if "steps" not in row)
    words = [
        (f"Each with {QUICK_FRACTION:.0%} of its steps: " if context.quick else "")
        + f"{best['profile']} comes nearest to novel views ({best['novel (dB)']:.2f} dB after {best['steps']} steps);"
        f" {quickest['profile']} is the quickest fit and stays {best['novel (dB)'] - quickest['novel (dB)']:.2f} dB behind.",
        f"On held-out frames the profiles reach {_span(rows)} dB, the better baseline without 3D {still:.2f} dB.",
    ]
    note = NOTE + (f" Steps are {QUICK_FRACTION:.3g} of the profile's." if context.quick else "")
    low, high = "novel error low (rms)", "novel error high (rms)"
    figures = [Figure("Profiles", "profiles", "fit (s)", "novel error (rms)", "profile", low, high, front=True)]
    return Findings([Table("profiles", rows, f"World `{WORLD}`", TIMED, note)], figures, words, lpips_missing())


def study_steps(context: Context) -> Findings:
    """The same schedule in fewer and more steps."""
    world, rows = toy_world(context, WORLD), []
    for steps in context.choose(QUICK_COUNTS, FULL_COUNTS):
        rows.append({"steps": steps} | _fits(context, f"steps {steps}", world, shorten(base_config(context), steps)))
    words = [_doubling("steps", rows)]
    figures = [_figure("steps", "Steps", "steps"), _figure("steps", "Steps: time", "fit (s)")]
    return Findings([Table("steps", rows, f"World `{WORLD}`", TIMED, NOTE)], figures, words, lpips_missing())


def study_resolution(context: Context) -> Findings:
    """Fits at several picture sizes, all judged at the largest."""
    widths = context.choose(QUICK_WIDTHS, FULL_WIDTHS)
    frames, rows = toy_world(context, WORLD).frames, []
    judge = make_world(WORLD, widths[-1], frames)
    for width in widths:
        world = make_world(WORLD, width, frames)

        def work(seed: int, world: Any = world) -> Row:
            fitted = fit_world(world, replace(base_config(context), seed=seed))
            cameras = fitted.scene.cameras.resized(judge.width, judge.height)
            own = score_world(world, fitted.scene)
            scores = score_world(judge, replace(fitted.scene, cameras=cameras))
            return scores | {"novel at its own size (dB)": own["novel (dB)"], "fit (s)": sum(fitted.seconds.values())}

        seeds = _seeds(context, base_config(context))
        found = each_seed(context, f"width {width}", work, seeds, width=width, judged=judge.width)
        rows.append({"width (px)": width} | _with_error(mean_row(found)))
    words = [_doubling("width (px)", rows)]
    note = f"{NOTE} All are judged at {judge.width}x{judge.height}, where small pictures' scenes lack detail."
    figures = [_figure("resolution", "Resolution", "width (px)"), _figure("resolution", "Resolution: time", "fit (s)")]
    return Findings([Table("resolution", rows, f"World `{WORLD}`", TIMED, note)], figures, words, lpips_missing())


def study_budget(context: Context) -> Findings:
    """Fewer and more Gaussians, at the start and at the limit."""
    world, rows = toy_world(context, WORLD), []
    for factor in context.choose(QUICK_FACTORS, FULL_FACTORS):
        config = thin_out(base_config(context), factor)
        rows.append({"budget": factor} | _fits(context, f"budget {factor}", world, config))
    words = [_doubling("Gaussians", rows)]
    note = f"{NOTE} Budget 1: the `quick` profile's density of Gaussians at the start, and its limit."
    figures = [_figure("budget", "Gaussians", "Gaussians"), _figure("budget", "Gaussians: time", "fit (s)")]
    return Findings([Table("budget", rows, f"World `{WORLD}`", TIMED, note)], figures, words, lpips_missing())


def _fits(context: Context, name: str, world: Any, config: FitConfig) -> Row:
    def work(seed: int) -> Row:
        return measure(world, replace(config, seed=seed))

    rows = each_seed(context, name, work, _seeds(context, config), steps=config.steps, width=world.width)
    return _with_error(mean_row(rows))


def _seeds(context: Context, config: FitConfig) -> int:
    return 1 if context.quick or config.steps >= MANY_STEPS else SEEDS


def _with_error(row: Row) -> Row:
    """Return the row with the root mean square error of novel views (colours in 0..1), for logarithmic plots."""
    ends = {"novel error (rms)": "novel (dB)", "novel error low (rms)": "novel high (dB)"}
    ends |= {"novel error high (rms)": "novel low (dB)"}
    return row | {column: 10 ** (-row[source] / 20) for column, source in ends.items()}


def _figure(table: str, title: str, across: str) -> Figure:
    return Figure(title, table, across, "novel (dB)", low="novel low (dB)", high="novel high (dB)", log="x")


def _baselines(world: Any) -> list[Row]:
    """Held-out frames by the nearest used frame and by a blend along optical flow."""
    clip = world.clip
    held_out = set(clip.held_out.nonzero()[0].tolist())
    start = time.perf_counter()
    scores = [baseline_scores(clip, index, held_out) for index in sorted(held_out)]
    seconds = (time.perf_counter() - start) / 2
    names = {"psnr_nearest": "nearest used frame", "psnr_flow_blend": "blend along flow"}
    return [
        {"profile": f"no 3D: {label}", "held out (dB)": statistics.fmean(s[name] for s in scores), "fit (s)": seconds}
        for name, label in names.items()
    ]


def _span(rows: list[Row]) -> str:
    values = [row["held out (dB)"] for row in rows if "steps" in row]
    return f"{min(values):.2f} to {max(values):.2f}"


def _doubling(column: str, rows: list[Row]) -> str:
    """Sentence about the cost and gain of the last and the first step of a ladder."""
    sentences = []
    for before, after in ((rows[0], rows[1]), (rows[-2], rows[-1])):
        sentences.append(
            f"{column} {before[column]:,.4g} to {after[column]:,.4g}: {after['novel (dB)'] - before['novel (dB)']:+.2f} dB on"
            f" novel views, {after['novel, moving (dB)'] - before['novel, moving (dB)']:+.2f} dB on what moves there, for"
            f" {after['fit (s)'] / before['fit (s)']:.2f} times the time"
        )
    return "; ".join(sentences) + "."
