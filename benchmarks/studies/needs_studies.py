"""Studies of a scene's needs: the choices, their cost, and results of the next smaller and the next larger choice."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import torch

from f4x_core.clip import Clip, read_clip
from f4x_core.clip.images import list_images
from f4x_core.evaluation.evaluate import evaluate
from f4x_core.features.spectrum import WIDTHS
from f4x_core.fit.config import FitConfig, ScaffoldConfig
from f4x_core.fit.distil import distil
from f4x_core.fit.distil_config import DistilConfig
from f4x_core.fit.needs import moving_fraction
from f4x_core.fit.pipeline import finish_fit, start_fit
from f4x_core.fit.start import moving_tracks
from f4x_core.metrics.pictures import psnr
from f4x_core.priors import Priors, build_priors
from f4x_core.scene import Scene, read_scene, write_scene

from ..study import Context, Figure, Findings, MissingError, Row, Table
from .toy_features import score_features, world_maps
from .toy_fits import (
    NOTE,
    base_config,
    each_seed,
    fit_world,
    mean_row,
    paired_changes,
    render_of,
    score_world,
    spread,
    thin_out,
    toy_world,
)
from .toy_worlds import KINDS, World

LADDER = ("static", "rigid", "two movers", "articulated", "deforming", "view-dependent", "feature-rich")
"""Worlds, from what needs least."""
SCAFFOLD, NODES, DEGREE, GAUSSIANS, WIDTH = CHOICES = ("scaffold", "nodes", "SH degree", "Gaussians", "latent width")
QUICK_CHOICES: Mapping[str, tuple[str, ...]] = {
    "static": (SCAFFOLD, DEGREE, GAUSSIANS),
    "rigid": (SCAFFOLD, NODES, WIDTH),
    "two movers": (NODES,),
    "articulated": (SCAFFOLD, NODES, GAUSSIANS),
    "deforming": (SCAFFOLD, NODES),
    "view-dependent": (DEGREE,),
    "feature-rich": (WIDTH,),
}
"""World -> settings that a quick report varies; a full one varies everything everywhere."""
KNEE = {"dB": 0.3, "%": 1.0}
"""A choice sits at the knee when the next smaller one loses at least so much and the next larger one gains less."""
AT_THE_KNEE, LARGER_PAYS, SMALLER_DOES, UNDECIDED = (
    "at the knee",
    "larger would pay",
    "smaller would do",
    "seeds disagree",
)
FLOORS = {NODES: ScaffoldConfig().min_nodes, WIDTH: WIDTHS[0]}
"""The least that a fit or a distillation chooses by itself."""
SMALLER, LARGER = "smaller loses", "larger gains"
"""Columns of what the neighbours of a choice do."""
PRETENDED = "box"
"""Label of the static thing that the larger choice of a still world carries by a scaffold."""
DIM, STEPS = 128, 600
"""Channels of the made-up teacher; steps of distilling, as many as `f4x distill` takes: fewer measure how fast it learns."""
CLIP_WIDTH, CLIP_FRAMES, CLIP_HOLD_OUT = 240, 48, 8
"""Of real clips; a shorter one is taken whole."""
SEEDS = 2
"""Fits of each setting of a toy world in a full report; of a real clip there is one."""
TIMED = ("fit (s)", "smaller, time ratio", "larger, time ratio", "distil (s)")


Choice = tuple[FitConfig, Callable[[], Priors | None]]
"""Settings of a fit, and priors in the place of its own (None: those)."""


@dataclass(frozen=True)
class Subject:
    """Subject of a fit, and how its errors are measured."""

    name: str
    fit: Callable[[FitConfig, Priors | None], tuple[Scene, Row]]
    """To a scene and its errors; with other priors than its own where some are given."""
    error: str
    """Column that judges all choices ..."""
    moving_error: str
    """... but those about motion."""
    still: Callable[[], Priors | None]
    """Priors that mark a static object as moving; None if there is no such object."""

    def judge(self, choice: str, row: Row) -> str:
        """Return the column that judges a choice."""
        return (
            self.moving_error if choice in (SCAFFOLD, NODES) and row.get(self.moving_error) is not None else self.error
        )


def study_ladder(context: Context) -> Findings:
    """Toy worlds that need more and more."""
    found, seeds = _Found(), context.choose(1, SEEDS)
    for name in LADDER:
        world = toy_world(context, name)
        subject = Subject(
            name, partial(_fit_world, world), "novel (dB)", "novel, moving (dB)", partial(_pretend_moving, world)
        )
        chosen = QUICK_CHOICES[name] if context.quick else CHOICES
        about = {"scene": name, "what": KINDS[name][0]}
        found.add(
            context, subject, about, base_config(context), [choice for choice in chosen if choice != WIDTH], seeds
        )
        if WIDTH in chosen:
            found.add_widths(context, world)
    return found.findings(NOTE)


def study_clips(context: Context) -> Findings:
    """Real clips: the same question, judged on held-out frames."""
    if context.clips is None:
        raise MissingError("--clips DIR names the folder of real clips, DIR/CLIP/images.")
    found = _Found()
    for place in sorted(folder.parent for folder in context.clips.glob("*/images")):
        subject = Subject(place.name, _fit_clip(context, place), "held out (dB)", "held out, moving (dB)", lambda: None)
        choices = [SCAFFOLD, NODES, DEGREE, GAUSSIANS]
        found.add(context, subject, {"scene": place.name}, base_config(context), choices, seeds=1)
    note = (
        f"{CLIP_WIDTH} pixels wide, the first {CLIP_FRAMES} frames, every {CLIP_HOLD_OUT}th held out; offline priors."
    )
    return found.findings(note)


class _Found:
    """Collects rows of the study."""

    def __init__(self) -> None:
        self.needs: list[Row] = []
        self.evidence: list[Row] = []
        self.knees: list[Row] = []
        self.options: dict[str, list[Row]] = {choice: [] for choice in CHOICES}

    def add(
        self, context: Context, subject: Subject, about: Row, base: FitConfig, choices: list[str], seeds: int
    ) -> None:
        """Fit what the program chooses, then its neighbours."""

        def run(option: str, choices: Sequence[Choice]) -> list[Row]:
            """One fit a seed, each with its own of `choices`."""

            def work(seed: int) -> Row:
                config, priors = choices[seed - context.seed]
                scene, row = subject.fit(replace(config, seed=seed), priors())
                if config is base and seed == context.seed:
                    write_scene(scene, context.folder / f"{subject.name}.f4x")
                return row | _facts(scene)

            return each_seed(context, f"{subject.name} {option}", work, seeds, steps=base.steps)

        fits = run("chosen", [(base, lambda: None)] * seeds)
        chosen = mean_row(fits, subject.error)
        self.evidence += [{"scene": subject.name} | row for row in chosen["needs"]]
        columns = [
            "moving (%)",
            "nodes at start",
            "nodes",
            "SH degree",
            "static",
            "dynamic",
            "stages",
            "fit (s)",
            "size (MB)",
        ]
        columns += [subject.error, subject.moving_error]
        self.needs.append(about | {column: chosen.get(column) for column in columns})
        for choice in choices:
            tried = {"chosen": (_value(choice, chosen), fits)}
            beside = [_neighbours(choice, fit, base, subject) for fit in fits]  # seeds may choose otherwise
            for option in [option for option in beside[0] if all(option in choices for choices in beside)]:
                others = run(f"{choice} {option}", [choices[option] for choices in beside])
                tried[option] = _value(choice, mean_row(others, subject.error)), others
            if len(tried) > 1:
                self._compare(subject.name, choice, subject.judge(choice, chosen), "dB", tried, "fit (s)")

    def add_widths(self, context: Context, world: World) -> None:
        """The latent that the spectrum asks for, and half and twice of it."""
        plain = read_scene(context.folder / f"{world.name}.f4x")
        maps = world_maps(world, context.folder / "maps" / world.name, DIM)

        def work(width: int | None) -> Row:
            config = DistilConfig(width, STEPS, seed=context.seed, threads=context.threads)
            start = time.perf_counter()
            scene = distil(plain, [maps], config)
            seconds = time.perf_counter() - start
            need = next(row for row in scene.needs if row["what"] == "latent")
            miou = score_features(world, scene, DIM)[0]
            return {"mIoU (%)": 100 * miou, "distil (s)": seconds, "width": scene.require_field().width, "needs": need}

        chosen = context.step(f"{world.name} width", partial(work, None), steps=STEPS)
        width = chosen["width"]
        self.evidence.append({"scene": world.name} | chosen["needs"])
        tried = {"chosen": (width, [chosen])}
        for option, other in (("smaller", width // 2), ("larger", 2 * width)):
            tried[option] = other, [context.step(f"{world.name} width {option}", partial(work, other), steps=STEPS)]
        self._compare(world.name, WIDTH, "mIoU (%)", "%", tried, "distil (s)")

    def _compare(
        self, scene: str, choice: str, judged: str, unit: str, tried: dict[str, tuple[Any, list[Row]]], cost: str
    ) -> None:
        """The three options as rows, and what the neighbours lose and gain, seed by seed."""
        means = {option: mean_row(rows, judged) for option, (_, rows) in tried.items()}
        kept = (judged, *spread(judged, [0.0]), "Gaussians", cost)
        for option in ("smaller", "chosen", "larger"):
            if option in tried:
                row = {column: means[option][column] for column in kept if means[option].get(column) is not None}
                self.options[choice].append({"scene": scene, "option": option, choice: tried[option][0]} | row)
        value, chosen = tried["chosen"]
        knee: Row = {"scene": scene, "choice": choice, "chosen": value, "judged by": judged}
        changes: dict[str, list[float]] = {}
        for option, column, sign in (("smaller", SMALLER, -1), ("larger", LARGER, 1)):
            knee[column] = None
            if option in tried:
                changes[option] = [sign * more for more in paired_changes(tried[option][1], chosen, judged)]
                knee |= {column: float(np.mean(changes[option]))} | spread(column, changes[option])
        for option in ("smaller", "larger"):
            knee[f"{option}, time ratio"] = means[option][cost] / means["chosen"][cost] if option in tried else None
        self.knees.append(knee | {"verdict": judge_knee(changes.get("smaller"), changes.get("larger"), KNEE[unit])})

    def findings(self, note: str) -> Findings:
        """Return the tables, a plot for each choice, and what they say."""
        verdicts = [row["verdict"] for row in self.knees]
        least = [row for row in self.knees if row["verdict"] == SMALLER_DOES and _is_minimum(row)]
        words = [
            f"{verdicts.count(AT_THE_KNEE)} of {len(verdicts)} choices sit at the knee; for {len(least)} less would do, but they"
            f" are the least that is ever taken; in {verdicts.count(UNDECIDED)} the seeds disagree; in"
            f" {verdicts.count(SMALLER_DOES) - len(least)} others less would do, in {verdicts.count(LARGER_PAYS)} more would pay."
        ]
        words += [_sentence(row) for row in self.knees if row["verdict"] != AT_THE_KNEE]
        bound = f"{KNEE['dB']} dB, or {KNEE['%']:g} % mIoU for the latent"
        note = (
            f"At the knee: the next smaller choice loses at least {bound}, the next larger one gains less; a verdict is given"
            f" where all seeds agree in it. Nodes are those at the"
            f" start, which the fit adds to and takes from; time ratios are of single fits, not taken in turn. {note}"
        )
        tables = [
            Table("needs", self.needs, "What was chosen, and its cost", TIMED, note),
            Table("knees", self.knees, "The next smaller and the next larger choice", TIMED, note),
        ]
        figures = []
        for choice, rows in self.options.items():
            if rows:
                name = f"choice-{choice.replace(' ', '-')}"
                tables.append(Table(name, rows, f"Choices: {choice}", TIMED))
                judged = next(column for column in rows[0] if column.endswith(("(dB)", "(%)")))
                if choice in (NODES, GAUSSIANS, WIDTH):
                    figures.append(
                        Figure(f"Choices: {choice}; chosen: middle point", name, choice, judged, "scene", log="x")
                    )
        tables.append(Table("evidence", self.evidence, "By which evidence"))
        return Findings(tables, figures, words)


def _facts(scene: Scene) -> Row:
    """Facts about a scene: counts and sizes."""
    nodes = next((row["chosen"] for row in scene.needs if row["what"] == "motion nodes at the start"), "0")
    moving = len(scene.dynamic) > 0
    return {
        "needs": list(scene.needs),
        "nodes at start": int(nodes),
        "nodes": 0 if scene.scaffold is None else len(scene.scaffold),
        "SH degree": round(scene.static.sh.shape[1] ** 0.5) - 1,
        "static": len(scene.static),
        "dynamic": len(scene.dynamic),
        "Gaussians": len(scene.static) + len(scene.dynamic),
        "stages": "scaffold, Gaussians of both sets" if moving else "static Gaussians",
        "size (MB)": sum(scene.info()["megabytes"].values()),
    }


def _value(choice: str, row: Row) -> Any:
    """Format the chosen value for the table."""
    if choice == SCAFFOLD:
        return "yes" if row["dynamic"] else "no"
    value = row["nodes at start" if choice == NODES else choice]
    return round(value) if choice == GAUSSIANS else value  # a mean over seeds


def _neighbours(choice: str, chosen: Row, base: FitConfig, subject: Subject) -> dict[str, Choice]:
    """smaller | larger -> settings and priors of the next choices; empty where the choice has no meaning."""
    same: Callable[[], Priors | None] = lambda: None  # noqa: E731
    nodes = chosen["nodes at start"]
    if choice == SCAFFOLD:
        if nodes:
            return {
                "smaller": (replace(base, min_moving_fraction=2.0), same)
            }  # no clip moves in more than all of its pixels
        return {"larger": (base, subject.still)} if subject.still() is not None else {}
    if choice == NODES:
        counts = {"smaller": nodes // 2, "larger": 2 * nodes} if nodes > 1 else {}
        return {
            option: (replace(base, scaffold=replace(base.scaffold, min_nodes=count, max_nodes=count)), same)
            for option, count in counts.items()
        }
    if choice == DEGREE:
        degrees = {"smaller": chosen["SH degree"] - 1, "larger": chosen["SH degree"] + 1}
        return {option: (replace(base, sh_degree=n), same) for option, n in degrees.items() if n >= 0}
    return {option: (thin_out(base, factor), same) for option, factor in (("smaller", 0.5), ("larger", 2.0))}


def judge_knee(loses: Sequence[float] | None, gains: Sequence[float] | None, knee: float) -> str:
    """Return the verdict, from what each seed's next smaller choice loses and next larger one gains; None where there is none."""
    count = len(loses or gains or ())

    def verdict(lost: float | None, gained: float | None) -> str:
        if gained is not None and gained >= knee:
            return LARGER_PAYS
        return SMALLER_DOES if lost is not None and lost < knee else AT_THE_KNEE

    nothing: Sequence[None] = [None] * count
    found = {verdict(*pair) for pair in zip(loses or nothing, gains or nothing, strict=True)}
    return found.pop() if len(found) == 1 else UNDECIDED


def _is_minimum(row: Row) -> bool:
    return bool(row["chosen"] == FLOORS.get(row["choice"]))


def _sentence(row: Row) -> str:
    """Sentence about a choice that may not be at the knee."""
    lost, gained, verdict = row[SMALLER], row[LARGER], row["verdict"]
    loses = gains = ""
    if lost is not None and verdict != LARGER_PAYS:
        loses = f"loses {lost:.2f}" if lost >= 0 else f"is better by {-lost:.2f}"
        loses = f"the next smaller choice {loses}"
    if gained is not None and verdict != SMALLER_DOES:
        gains = f"the next larger one {'gains' if gained >= 0 else 'loses'} {abs(gained):.2f}"
    least = f"; fewer than {row['chosen']} are never taken" if _is_minimum(row) else ""
    cost = ", ".join(filter(None, [loses, gains]))
    return f"{row['scene']}, {row['choice']} {row['chosen']}: {verdict}; {cost} ({row['judged by']}){least}."


def _fit_world(world: World, config: FitConfig, priors: Priors | None) -> tuple[Scene, Row]:
    fitted = fit_world(world, config, priors)
    cost = {"fit (s)": sum(fitted.seconds.values()), "moving (%)": 100 * moving_fraction(world.priors)}
    return fitted.scene, score_world(world, fitted.scene) | cost


def _pretend_moving(world: World) -> Priors | None:
    """Return the true priors, but a thing that stands still is called moving; None where it is not there or something moves."""
    if world.moving.any() or PRETENDED not in world.labels:
        return None
    label, used = world.labels.index(PRETENDED), world.clip.supervised
    mask = np.stack([world.views[i].label == label for i in used])
    priors = replace(world.priors, mask=mask, motion=mask.astype(np.float16))
    inside = np.isin(np.arange(len(world.tracks[2])), moving_tracks(priors))
    return replace(priors, tracks_motion=inside.astype(np.float32))


def _fit_clip(context: Context, place: Path) -> Callable[[FitConfig, Priors | None], tuple[Scene, Row]]:
    """Return the function that fits a real clip; its priors are built once, for all choices."""
    frames = min(len(list_images(place / "images")), CLIP_FRAMES)
    clip = read_clip(place, f"0:{frames}", CLIP_WIDTH, CLIP_HOLD_OUT)

    def fit(config: FitConfig, priors: Priors | None) -> tuple[Scene, Row]:
        torch.set_num_threads(config.threads or 1)
        priors = build_priors(clip, context.folder / "priors" / place.name, config.priors, context.progress)
        start = time.perf_counter()
        trainer = start_fit(clip, priors, config, context.progress)
        trainer.run(progress=context.progress)
        seconds = time.perf_counter() - start
        scene = finish_fit(trainer).scene
        scores = evaluate(scene, clip)
        moving = [
            psnr(
                render_of(scene, scene.cameras[i], float(i)), torch.from_numpy(clip.frames[i] / np.float32(255)), region
            )
            for i, region in _moving_regions(clip, priors).items()
        ]
        return scene, {
            "held out (dB)": scores["held_out_psnr"],
            "held out, moving (dB)": float(np.mean(moving)) if moving else None,
            "used (dB)": scores["used_psnr"],
            "moving (%)": 100 * moving_fraction(priors),
            "fit (s)": seconds,
        }

    return fit


def _moving_regions(clip: Clip, priors: Priors) -> dict[int, torch.Tensor]:
    """Held-out frame -> (H,W) 1 where the mask of a used frame beside it is: the same region for every choice."""
    assert priors.mask is not None
    regions = {}
    for frame in clip.held_out.nonzero()[0].tolist():
        beside = np.argsort(np.abs(priors.frames - frame), kind="stable")[:2]
        region = priors.mask[beside].any(0)
        if region.any():
            regions[frame] = torch.from_numpy(region.astype(np.float32))
    return regions
