"""The fit without one of its parts at a time: what a reviewer would ask."""

from __future__ import annotations

import statistics
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import fields, replace
from functools import partial

import numpy as np
import torch
from scipy.ndimage import gaussian_filter
from scipy.stats import t as student_t

from f4x_core.features.heads import Head, head_widths
from f4x_core.features.maps import FeatureMaps
from f4x_core.fit.config import FitConfig
from f4x_core.fit.losses import rgb_loss
from f4x_core.fit.model import Moved, Present, SceneModel
from f4x_core.fit.pipeline import finish_fit, start_fit
from f4x_core.fit.trainer import Trainer
from f4x_core.gaussians import appearance
from f4x_core.geometry import dual_quaternion, quaternion
from f4x_core.geometry.arrays import Array
from f4x_core.geometry.camera import Camera
from f4x_core.priors import Priors
from f4x_core.query.score import cosines
from f4x_core.raster import rasterize
from f4x_core.scaffold.deformation import pairs_of, relative_motions
from f4x_core.scene import Scene
from f4x_core.scene.model import PosedSplats
from f4x_core.scene.view import render

from ..study import Context, Findings, Row, Table
from .toy_features import label_vectors, score_views, world_maps
from .toy_fits import (
    NOTE,
    base_config,
    each_seed,
    fit_world,
    mean_row,
    novel_views,
    paired_changes,
    score_world,
    spread,
    toy_world,
)
from .toy_worlds import World

Change = Callable[[FitConfig], FitConfig]

WORLDS = ("articulated", "rolling", "deforming")
SEEDS = 2
"""Fits of everything in a full report; in a quick one there is one."""
WHOLE, LINEAR = "nothing left out", "linear blend in place of dual quaternions"
HELD_BACK, REACHING = "features held back from geometry", "features reach geometry"
TRUE, NOISY = "true", "noisy"
TRACK_NOISE, TRACK_GAPS, DEPTH_NOISE, DEPTH_BLOBS = 0.6, 0.3, 0.03, 8.0
"""Noisy priors: pixels of jitter, share of the samples that are lost, share of the depth, pixels across its blobs."""
JOINT_FRACTION, LATENT, DIM, FEATURE_WEIGHT = 0.3, 16, 64, 1.0
"""Steps of fitting pictures and features together, as a share of the fit's; width of its latent; channels; their weight."""
JOINT_RATE = 5e-4
"""Adam's rate of the Gaussians meanwhile: small, they are trained."""
JUDGED = "novel, moving (dB)"
"""Column that judges the parts: most of them are about what moves."""
COLUMNS = (JUDGED, "novel, moving low (dB)", "novel, moving high (dB)", "novel (dB)", "held out (dB)", "track (px)")
CHANGE, NOT_SURE = "change (dB)", "not sure"
CHANGES = {CHANGE: JUDGED, "change, whole picture (dB)": "novel (dB)", "change (px)": "track (px)"}
TIMED = ("fit (s)",)


def without_arap(config: FitConfig) -> FitConfig:
    """Neither of the two stages keeps neighbours in their places."""
    losses = replace(config.losses, arap_coordinate=0.0, arap_length=0.0)
    return replace(config, losses=losses, scaffold=replace(config.scaffold, geometry_arap=0.0))


ABLATIONS: Mapping[str, Change] = {
    WHOLE: lambda config: config,
    "no ARAP": without_arap,
    "no skinning offsets": lambda config: replace(config, rates=replace(config.rates, dw=0.0)),
    LINEAR: lambda config: config,
    "rotations start as identity": lambda config: replace(
        config, scaffold=replace(config.scaffold, rotations="identity")
    ),
    "no fusion over time": lambda config: replace(config, spawn_dynamic=replace(config.spawn_dynamic, frames=1)),
    "no track loss": lambda config: replace(config, losses=replace(config.losses, track=0.0)),
    "third largest distance in place of the largest": lambda config: replace(
        config, scaffold=replace(config.scaffold, distance_rank=3)
    ),
    "kernel of the paper": lambda config: replace(config, scaffold=replace(config.scaffold, kernel="paper")),
}
"""Name -> settings of the fit without it."""
QUICK: Mapping[tuple[str, str], Sequence[str]] = {
    ("articulated", TRUE): tuple(ABLATIONS),
    ("articulated", NOISY): (WHOLE, "no ARAP", "no track loss"),
    ("rolling", TRUE): (WHOLE, LINEAR, "rotations start as identity"),
}
"""Ablations of a quick report."""


def study_ablations(context: Context) -> Findings:
    """Each part left out, on worlds whose truth is known, with true and with noisy priors."""
    rows: list[Row] = []
    doubts: list[float] = []
    plan = QUICK if context.quick else {(w, p): tuple(ABLATIONS) for w in WORLDS for p in (TRUE, NOISY)}
    for (name, kind), ablations in plan.items():
        world = toy_world(context, name)
        fits = {
            ablation: each_seed(
                context,
                f"{name} {kind} {ablation}",
                partial(_fit, context, world, kind, ablation),
                context.choose(1, SEEDS),
            )
            for ablation in ablations
        }
        whole = fits[WHOLE]
        doubt = doubt_of(
            [paired_changes(found, whole, JUDGED) for ablation, found in fits.items() if ablation != WHOLE]
        )
        doubts += [doubt] if doubt is not None else []
        for ablation, found in fits.items():
            about = {"world": name, "priors": kind, "without": ablation}
            rows.append(about | _against(found, whole, doubt if ablation != WHOLE else None))
    joint = _joint_rows(context)
    note = (
        f"{NOTE} Noisy priors: {TRACK_NOISE} px of jitter, {TRACK_GAPS:.0%} of the track samples lost, depth off by"
        f" {DEPTH_NOISE:.0%} in blobs. `change` is the mean over pairs of fits with the same seed, with and"
        " without the part; in dB more is better, in px (how far followed points end from where they are)"
        " less. The"
        " paper's kernel is exp(-d2 / 2r) in the place of exp(-d2 / 2r2)."
    )
    note = (
        f"After the fit, pictures and made-up features ({DIM} channels through a latent of {LATENT}) together for"
        f" {JOINT_FRACTION:.0%} more steps; features move opacity, size and place of Gaussians, or only their latents."
    )
    tables = [
        Table("ablations", rows, "One part left out", TIMED, note),
        Table("features", joint, "Features and geometry", TIMED, note),
    ]
    return Findings(tables, words=[*_words(rows, doubts), _joint_words(joint)])


def linear_blend(turn: Array, shift: Array, weights: Array, x: Array, q: Array) -> tuple[Array, Array]:
    """Linear blend skinning: the mean of where each neighbour carries a Gaussian, and of its turns as four-vectors.

    `turn (N,K,4)`, `shift (N,K,3)`, `weights (N,K)` sum to 1, placements `x (N,3)`, `q (N,4)`; numpy or torch.
    """
    places = quaternion.rotate(turn, x[:, None]) + shift  # (N,K,3)
    dots = (turn * turn[:, :1]).sum(-1)
    signed = weights * (1 - 2 * (dots < 0))
    mean = quaternion.normalize((signed[..., None] * turn).sum(1))
    return (weights[..., None] * places).sum(1), quaternion.multiply(mean, q)


class LinearModel(SceneModel):
    """A scene under optimisation whose Gaussians are carried by linear blends; torch alone."""

    def dynamic_at(self, *times: float, present: Present | None = None) -> list[Moved]:
        """Pose the dynamic Gaussians, with the interface of the dual-quaternion model."""
        assert self.dynamic is not None and self.nodes is not None
        present = present or self.all_dynamic
        rows = slice(None) if present.rows is None else present.rows
        xyz, quat = self.nodes.parameters["node_xyz"], self.nodes.quat
        x, q = self.dynamic.at_reference(xyz, quat)
        weights, _ = self.skinning(x)
        deformer = self.attachment.deformer
        index = torch.from_numpy(deformer.pairs.index).long()
        posed = []
        for moment in times:
            turn, shift = dual_quaternion.to_pose(deformer.relative_motions(xyz, quat, moment))
            means, quats = linear_blend(turn[index], shift[index], weights, x, q)
            posed.append(Moved(means[rows], quats[rows], moment, present))
        return posed


class LinearScene(Scene):
    """A scene that is played as `LinearModel` learnt it."""

    @classmethod
    def of(cls, scene: Scene) -> LinearScene:
        """The same arrays."""
        return cls(**{field.name: getattr(scene, field.name) for field in fields(scene)})

    def posed(self, time: float) -> PosedSplats:
        """Pose the scene like `Scene.posed`, by linear blend skinning."""
        posed, dynamic, scaffold = super().posed(time), self.dynamic, self.scaffold
        assert scaffold is not None
        pairs = pairs_of(dynamic.node, dynamic.reference)
        table = relative_motions(scaffold.times, scaffold.xyz, scaffold.quat, pairs, time)
        turn, shift = (part[pairs.index] for part in dual_quaternion.to_pose(table))
        moved = linear_blend(turn, shift, dynamic.weight, dynamic.means, dynamic.quats)
        means, quats = (
            np.concatenate([still[: len(self.static)], part]).astype(np.float32)
            for still, part in zip((posed.means, posed.quats), moved, strict=True)
        )
        return replace(posed, means=means, quats=quats)


def spoil(priors: Priors, seed: int) -> Priors:
    """Return the priors with jitter, gaps and wrong depth, as real ones have."""
    assert priors.tracks is not None and priors.tracks_visible is not None and priors.depth is not None
    rng = np.random.default_rng(seed)
    blobs = gaussian_filter(rng.normal(size=priors.depth.shape), (0, DEPTH_BLOBS, DEPTH_BLOBS))
    jitter = rng.normal(scale=TRACK_NOISE, size=priors.tracks.shape)
    return replace(
        priors,
        depth=(priors.depth * (1 + DEPTH_NOISE * blobs / blobs.std())).astype(np.float32),
        tracks=(priors.tracks + jitter).astype(np.float32),
        tracks_visible=priors.tracks_visible & (rng.random(priors.tracks_visible.shape) > TRACK_GAPS),
    )


def _fit(context: Context, world: World, kind: str, ablation: str, seed: int) -> Row:
    config = replace(ABLATIONS[ablation](base_config(context)), seed=seed)
    priors = spoil(world.priors, seed) if kind == NOISY else None
    linear = ablation == LINEAR
    fitted = fit_world(world, config, priors, LinearModel if linear else None)
    scene = LinearScene.of(fitted.scene) if linear else fitted.scene
    return score_world(world, scene) | {"fit (s)": sum(fitted.seconds.values())}


def _against(found: Sequence[Row], whole: Sequence[Row], doubt: float | None) -> Row:
    """Changes of the fits without a part against the whole ones, and means over seeds."""
    row = mean_row(found, JUDGED)
    changes: Row = {}
    for name, column in CHANGES.items():
        pairs = paired_changes(found, whole, column)
        changes |= {name: statistics.fmean(pairs)} | (spread(name, pairs) if column == JUDGED else {})
    sense = ""
    if doubt is not None:
        change = changes[CHANGE]
        sense = NOT_SURE if abs(change) <= doubt else "better" if change > 0 else "worse"
    kept = {column: row[column] for column in (*COLUMNS, "nodes", "seeds", "fit (s)")}
    return changes | {"doubt (dB)": doubt, "verdict": sense} | kept


def doubt_of(pairs: Sequence[Sequence[float]]) -> float | None:
    """Half of the 95 % interval of one mean, where each sequence holds repeated measurements of another one's differences.

    All are taken to scatter alike about means of their own (Student's t with the pooled variance); None where nothing was
    measured twice.
    """
    repeated = [group for group in pairs if len(group) > 1]
    freedom = sum(len(group) - 1 for group in repeated)
    if not freedom:
        return None
    scatter = sum(statistics.variance(group) * (len(group) - 1) for group in repeated) / freedom
    return float(student_t.ppf(0.975, freedom) * (scatter / min(len(group) for group in repeated)) ** 0.5)


def _words(rows: Sequence[Row], doubts: Sequence[float]) -> list[str]:
    """One sentence per ablation, the most harmful first, after a note on random variation."""
    sentences = []
    for name in ABLATIONS:
        changes, worst = [], 0.0
        for row in rows:
            if row["without"] != name or name == WHOLE:
                continue
            change, detail = row[CHANGE], f"whole picture {row['change, whole picture (dB)']:+.2f}"
            detail = f"{row['verdict']}; {detail}" if row["verdict"] else detail
            changes.append(
                f"{change:+.2f} dB on {row['world']}, {row['priors']} priors ({detail}, tracks {row['change (px)']:+.2f} px)"
            )
            worst = min(worst, change)
        if changes:
            sentences.append((worst, f"{name[0].upper()}{name[1:]}: {'; '.join(changes)}."))
    heading = "Moving pixels of novel views. One fit each: chance is not told apart from change."
    if doubts:
        heading = (
            f"Moving pixels of novel views. `{NOT_SURE}` is said of changes below `doubt`, {min(doubts):.2f} to"
            f" {max(doubts):.2f} dB by world and priors; chance alone exceeds it once in twenty."
        )
    return [heading, *(sentence for _, sentence in sorted(sentences))]


def _joint_rows(context: Context) -> list[Row]:
    """Train features with pictures in both ways, and return a row of each."""
    world = toy_world(context, WORLDS[0])
    maps = world_maps(world, context.folder / "maps", DIM)
    rows = []
    for name in (HELD_BACK, REACHING):
        work = partial(_fit_jointly, context, world, maps, name == REACHING)
        found = each_seed(context, name, work, context.choose(1, SEEDS))
        rows.append({"world": world.name, "what": name} | mean_row(found, JUDGED))
    return rows


def _fit_jointly(context: Context, world: World, maps: FeatureMaps, attached: bool, seed: int) -> Row:
    config = base_config(context, seed=seed)
    clock = time.perf_counter()
    trainer = start_fit(world.clip, world.priors, config)
    trainer.run()
    latents, head = train_jointly(trainer, maps, attached, round(JOINT_FRACTION * config.steps))
    seconds = time.perf_counter() - clock
    scene = finish_fit(trainer).scene
    vectors = label_vectors(world, DIM)

    def find(camera, moment):
        drawn = render(scene, camera, moment, ("alpha",), values={"latent": latents})
        with torch.no_grad():
            found = head(torch.from_numpy(drawn["latent"])).numpy()
        return np.where(drawn["alpha"] > 0.5, cosines(found, vectors).argmax(-1), -1)

    miou, accuracy = score_views(len(world.labels), novel_views(world, scene), find)
    scores = score_world(world, scene)
    kept = {column: scores[column] for column in ("novel (dB)", JUDGED, "held out (dB)", "track (px)")}
    return kept | {"mIoU": miou, "accuracy": accuracy, "fit (s)": seconds}


def train_jointly(trainer: Trainer, maps: FeatureMaps, attached: bool, steps: int) -> tuple[np.ndarray, Head]:
    """Go on with a trained model, each Gaussian with a latent of its own; (N,LATENT) latents and their head.

    Pictures are fitted as before, features by L1; their gradient reaches the Gaussians where `attached`. Cameras, nodes and
    the number of Gaussians stay.
    """
    model, config, data = trainer.model, trainer.config, trainer.levels[0]
    generator = torch.Generator().manual_seed(config.seed)
    torch.manual_seed(config.seed)
    head = Head(head_widths(LATENT, maps.spec.dim))
    latents = torch.randn(len(model), LATENT, generator=generator).mul_(0.1).requires_grad_()
    assert model.dynamic is not None
    trained = [*model.static.parameters.values(), *model.dynamic.parameters.values()]
    rates = [{"params": trained, "lr": JOINT_RATE}, {"params": [latents], "lr": 0.02}]
    optimiser = torch.optim.Adam([*rates, {"params": head.parameters(), "lr": 3e-3}])
    shape = maps.spec.grid
    for _ in range(steps):
        frame = int(torch.randint(len(model.times), (1,), generator=generator))
        moment = float(model.times[frame])
        splats = model.posed(model.dynamic_at(moment)[0])
        lens, view = model.rig.intrinsics(frame, data.width, data.height).detach(), model.rig.view(frame).detach()
        camera = Camera(lens, view, data.width, data.height)
        rgb = appearance(splats.sh, splats.means, splats.quats, camera.center, model.kernels)
        colors = torch.cat([rgb, latents], 1)
        cut = None if attached else 3
        out = rasterize(splats, colors, camera, config=trainer.raster, detached_from=cut)
        target = data.rgb[frame].float() / 255
        loss = rgb_loss(out.channels[..., :3], target, torch.ones_like(out.alpha), config.losses.ssim, model.kernels)
        cells = torch.nn.functional.adaptive_avg_pool2d(out.channels[..., 3:].permute(2, 0, 1), shape).permute(1, 2, 0)
        wanted = torch.from_numpy(maps.at(round(moment)))
        loss = loss + FEATURE_WEIGHT * (head(cells) - wanted).abs().mean() / wanted.abs().mean()
        optimiser.zero_grad()
        loss.backward()
        optimiser.step()
    return latents.detach().numpy(), head


def _joint_words(rows: Sequence[Row]) -> str:
    held, reaching = rows
    change, moving = (reaching[column] - held[column] for column in ("novel (dB)", JUDGED))
    return (
        f"{REACHING.capitalize()}: {change:+.2f} dB on novel views, {moving:+.2f} dB on what moves, mIoU"
        f" {reaching['mIoU'] - held['mIoU']:+.3f}, against features that are held back; means over seeds: {held['seeds']}."
    )
