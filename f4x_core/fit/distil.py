"""Distillation: foundation models' feature maps become latents on Gaussians and nodes, and heads that decode them.

A stage of its own after the photometric one: geometry, opacity, colour and cameras stand still, so pictures cannot
change. The static scene is measured once per frame (`features.footprint`); a step is then a sparse product, not a drawing.
What was measured and the maps lie on disk, so that memory does not grow with the clip.

Light is divided by alpha before heads decode it, here and wherever the field is read: a cell that is half covered has the
features of what covers it, and no head has to learn what "nothing" looks like. Cells with less than `COVERED` do not count.
"""

from __future__ import annotations

import math
import os
import tempfile
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import IO, Any

import numpy as np
import torch
from scipy import sparse
from torch import Tensor
from torch.autograd.function import once_differentiable
from torch.nn import functional

from ..errors import F4xError
from ..features.footprint import cell_weights
from ..features.heads import Head, head_widths
from ..features.maps import FeatureMaps
from ..features.memory import memory_guard
from ..features.pca import fit_pca
from ..features.spec import FeatureSpec
from ..features.spectrum import WIDTHS, measure_spectrum
from ..native.kernels import torch_threads
from ..parallel import in_threads, side_by_side
from ..progress import Progress, silent
from ..raster import RasterConfig
from ..scene import FeatureField, FieldHead, Scene
from ..scene.field import quantise
from .distil_config import DistilConfig
from .needs import Need

COVERED = 0.5
"""Fraction of a cell that Gaussians must cover for the cell to count."""
PIXELS_PER_CELL = 4
"""Size at which blend weights are summed, in pixels along a cell's shorter side: 16 samples per cell differ from the full picture's
by 0.2 to 0.3 % of a smooth latent (dog) and take half the time."""
PICTURE_SAMPLES = 20_000
"""Cells of all frames that the colours of feature pictures are fitted to."""
HEAD_SAMPLES = 100_000
"""Cells of all frames, at most, that mean and spread of the features are measured on: every seventh of short clips."""


@dataclass(frozen=True, eq=False)
class View:
    """Blend weights of one frame: cells of the common grid from columns (static Gaussians, then nodes or dynamic ones)."""

    frame: int
    """Clip frame."""
    mix: sparse.csr_matrix
    """(h*w, columns) float32; a row sums to 1, or to 0 where nothing is."""
    alpha: Tensor
    """(h,w) covered fraction of every cell."""


class _Views(Sequence[View]):
    """Views kept in a temporary file, because those of a long clip would fill the memory."""

    def __init__(self, file: IO[bytes]) -> None:
        """Keep none yet; `file` is for reading and writing."""
        self.file = file
        self.places: list[tuple[int, int, Any, Any]] = []

    def take(self, views: Iterable[View]) -> None:
        """Keep more, one after the other."""
        for view in views:
            place = self.file.seek(0, os.SEEK_END)
            whole, real = (view.mix.indptr, view.mix.indices), (view.mix.data, view.alpha.numpy())
            arrays = [array.astype(np.int32) for array in whole] + [array.astype(np.float32) for array in real]
            try:
                self.file.writelines(array.data for array in arrays)
            except OSError as error:
                raise F4xError(
                    f"{tempfile.gettempdir()}: {error.strerror}; what frames see needs room there, or name another folder"
                    " in TMPDIR."
                ) from error
            self.places.append((view.frame, place, view.mix.shape, tuple(view.alpha.shape)))

    def __len__(self) -> int:
        return len(self.places)

    def __getitem__(self, number: Any) -> Any:
        """Read one."""
        frame, place, shape, grid = self.places[number]
        self.file.seek(place)
        ends = self._read(np.int32, shape[0] + 1)
        columns, weights = self._read(np.int32, ends[-1]), self._read(np.float32, ends[-1])
        alpha = torch.from_numpy(self._read(np.float32, math.prod(grid)).reshape(grid))
        return View(frame, sparse.csr_matrix((weights, columns, ends), shape), alpha)

    def _read(self, kind: type[np.generic], count: int) -> np.ndarray:
        return np.frombuffer(self.file.read(count * kind().itemsize), kind).copy()


class _Mix(torch.autograd.Function):
    """`view.mix @ latents`."""

    @staticmethod
    def forward(ctx: Any, latents: Tensor, view: View) -> Tensor:
        """Return (cells,D) of `latents (columns,D)`."""
        ctx.view = view
        return torch.from_numpy(view.mix @ latents.detach().numpy())

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, gradient: Tensor) -> Any:
        """Return the gradient of the latents."""
        return torch.from_numpy(ctx.view.mix.T @ gradient.numpy()), None


class HeadTask:
    """One head and the maps that it learns."""

    def __init__(self, maps: FeatureMaps, frames: Sequence[int], width: int, config: DistilConfig):
        """Measure mean and spread of the maps over `frames`, so that the head starts out right in size."""
        self.maps, self.spec = maps, maps.spec
        every = max(7, len(frames) * math.prod(self.spec.grid) // HEAD_SAMPLES)
        # Copies of single cells: a view would keep whole maps in memory.
        sample = np.concatenate([maps.at(t).reshape(-1, self.spec.dim)[::every].copy() for t in frames])
        self.mean = torch.from_numpy(sample.mean(0))
        self.spread = float(max(sample.std(0).mean(), 1e-9))
        self.size = float(max(np.abs(sample).mean(), 1e-9))
        """Mean of |features|: errors are reported relative to it."""
        self.range = float(max(np.subtract(*np.percentile(sample, [99, 1])), 1e-9))
        self.head = Head(head_widths(width, self.spec.dim))
        self.config = config
        self.weight = (config.head_weights or {}).get(self.spec.name, 1.0)

    def decode(self, latent: Tensor) -> Tensor:
        """Return the features (…,C)."""
        return self.mean + self.spread * self.head(latent)

    def loss(self, latent: Tensor, alpha: Tensor, frame: int) -> Tensor:
        """Return the relative L1 + SSIM + cosine terms of a view's latent (H,W,D), over cells that are covered."""
        z, covered = to_grid(latent, alpha, self.spec)
        seen = covered > COVERED  # (h,w)
        wanted = torch.from_numpy(self.maps.at(frame))
        found = self.decode(z)
        count = seen.sum().clamp_min(1)
        loss = ((found - wanted).abs().mean(-1) * seen).sum() / count / self.size
        if self.config.ssim and self.spec.dim <= self.config.ssim_channels:
            loss = loss + self.config.ssim * dissimilarity(found, wanted, seen, self.range)
        if self.config.cosine:
            unlike = 1 - functional.cosine_similarity(found, wanted, dim=-1)
            loss = loss + self.config.cosine * (unlike * seen).sum() / count
        return self.weight * loss

    def folded(self) -> Head:
        """Return the head with mean and spread inside its last layer."""
        head = Head.from_arrays(self.head.to_arrays())
        last = head.layers[-1]
        with torch.no_grad():
            last.weight.mul_(self.spread)
            last.bias.mul_(self.spread).add_(self.mean)
        return head


class KeptHead:
    """A head that the scene already has, whose output must stay."""

    def __init__(self, stored: FieldHead):
        """Freeze the head."""
        layers = range(len(stored.weights))
        arrays = {f"weight_{i}": stored.weights[i] for i in layers} | {f"bias_{i}": stored.biases[i] for i in layers}
        self.stored, self.head = stored, Head.from_arrays(arrays).requires_grad_(False)

    def loss(self, latent: Tensor, before: Tensor, alpha: Tensor) -> Tensor:
        """Return the relative L1 between what is decoded from the latent (H,W,D) now and before."""
        seen = (alpha > COVERED)[..., None]
        with torch.no_grad():
            wanted = self.head(before) * seen
        return (self.head(latent) * seen - wanted).abs().sum() / wanted.abs().sum().clamp_min(1e-9)


def distil(
    scene: Scene, maps: Sequence[FeatureMaps], config: DistilConfig | None = None, progress: Progress = silent
) -> Scene:
    """Return the scene with a head for each of `maps` (and the heads it already had), trained on its used frames.

    Gaussians, scaffold and cameras are the same objects (with `feature_grad_to_skinning`: but for the skinning weights).
    Each head's `report` tells relative error mean|found - wanted| / mean|wanted| and cosine on used and held-out frames, as
    decoded from the stored bytes, and what storing in bytes changed (`stored_change`). Heads that were there before tell
    their `drift`, the relative change of what they decode. A head whose teacher is among `maps` is learnt anew.

    Raises:
        F4xError: no maps, two of one name, maps of another number of frames, an odd width, or one that differs from the
            width of a field whose heads are kept.
    """
    config = config or DistilConfig()
    threads = config.threads or torch.get_num_threads()
    sizes = ", ".join("{} x {} x {}".format(*each.spec.grid, each.spec.dim) for each in maps)
    # Torch's and BLAS' sums depend on their numbers of threads: each computation has one, and views are looked at side by side.
    with memory_guard(f"Distilling maps of {sizes}"), torch_threads(1), side_by_side(threads):
        return _Distillation(scene, maps, config, progress).run()


class _Distillation:
    """All that one call of `distil` knows."""

    def __init__(self, scene: Scene, maps: Sequence[FeatureMaps], config: DistilConfig, progress: Progress):
        self.scene, self.maps, self.config, self.progress = scene, maps, config, progress
        _check(scene, maps, config)
        self.used = [t for t in range(len(scene.cameras)) if t not in set(scene.held_out)]
        torch.manual_seed(config.seed)
        self.rng = np.random.default_rng(config.seed)
        names = {each.spec.name for each in maps}
        old = scene.features
        self.kept = [KeptHead(head) for head in old.heads if head.spec.name not in names] if old is not None else []
        if self.kept and old is not None and config.width not in (None, old.width):
            raise F4xError(
                f"--width {config.width}: the scene's heads {', '.join(h.stored.spec.name for h in self.kept)} read"
                f" {old.width} channels; leave --width out, or distil all of them again."
            )
        self.spectrum = measure_spectrum(maps, self.used, config.seed)
        self.width = old.width if self.kept and old is not None else config.width or self.spectrum.width()
        self.grid = common_grid([*(m.spec for m in maps), *(h.stored.spec for h in self.kept)], scene)
        self.tasks = [HeadTask(each, self.used, self.width, config) for each in maps]
        self.frozen = bool(self.kept) and math.isinf(config.keep)
        self.nodes = 0 if scene.scaffold is None else len(scene.scaffold.ids)

    @property
    def skinning(self) -> sparse.csr_matrix:
        """(Nd,M) weights of the nodes."""
        node, weight = self.scene.dynamic.node, self.scene.dynamic.weight
        rows = np.repeat(np.arange(len(node)), node.shape[1])
        return sparse.csr_matrix((weight.ravel(), (rows, node.ravel())), (len(node), self.nodes), dtype=np.float32)

    def run(self) -> Scene:
        """Look, start, train, store, report."""
        with tempfile.TemporaryFile() as file:
            return self._run(_Views(file))

    def _run(self, views: _Views) -> Scene:
        views.take(self.look(t) for t in self.steps("weights", self.used))
        latents, weight = self.train(views, self.first_latents(views))
        old, bits = self.scene.features, self.config.bits
        if self.frozen and old is not None:  # not rounded a second time
            static, nodes, low, step, bits = old.static, old.nodes, old.low, old.step, old.bits
        else:
            count = len(self.scene.static)
            static, nodes, low, step = quantise(latents[:count], latents[count:], bits)
        stored = low + step * np.concatenate([static, nodes]).astype(np.float32)
        again = list(self.scene.held_out)
        if weight is not None:  # everything has moved a little
            self.scene = replace(self.scene, dynamic=replace(self.scene.dynamic, weight=weight))
            again, views = [*self.used, *again], _Views(views.file)
        views.take(self.look(t) for t in self.steps("weights for the report", again))
        heads, pca = self.report(views, latents, stored)
        words = {} if old is None else old.vocabularies
        field = FeatureField(static, nodes, low, step, heads, words, pca, bits)
        needs = [row for row in self.scene.needs if row.get("what") != "latent"]
        return replace(self.scene, features=field, needs=(*needs, self.need().row()))

    def steps(self, stage: str, items: Sequence[Any]) -> Iterator[Any]:
        """`items` one by one, reported to `progress`."""
        for done, item in enumerate(items):
            self.progress(stage, done, len(items))
            yield item
        self.progress(stage, len(items), len(items))

    def look(self, frame: int) -> View:
        """Sum the blend weights of one clip frame by cells."""
        scene, (rows, columns) = self.scene, self.grid
        camera = scene.cameras[frame]
        scale = min(1.0, PIXELS_PER_CELL * max(rows / camera.height, columns / camera.width))
        camera = camera.resized(round(scale * camera.width), round(scale * camera.height))
        # The footprint's blur shrinks with the picture, so that the weights are those of the full one, sampled.
        config = RasterConfig(blur=RasterConfig.blur * scale**2)
        config = replace(config, threads=self.config.threads) if self.config.threads else config
        posed = scene.posed(float(scene.cameras.times[frame]))
        weights = cell_weights(posed, camera, self.grid, config=config, backend=self.config.backend)
        area = np.asarray(weights.sum(1))[:, 0]
        alpha = np.clip(area * rows * columns / (camera.width * camera.height), 0, 1).reshape(self.grid)
        mix = sparse.diags(1 / np.maximum(area, 1e-6)) @ weights
        if not self.config.feature_grad_to_skinning:
            count = len(scene.static)
            mix = sparse.hstack([mix[:, :count], mix[:, count:] @ self.skinning])
        return View(frame, sparse.csr_matrix(mix, dtype=np.float32), torch.from_numpy(alpha.astype(np.float32)))

    def first_latents(self, views: Sequence[View]) -> np.ndarray:
        """Return (Ns+M,D) where training starts: the scene's own latents, or each column's mean of the principal components that
        its cells show, spread 1."""
        old = self.scene.features
        if self.kept and old is not None:
            return old.low + old.step * np.concatenate([old.static, old.nodes]).astype(np.float32)
        total, weight = 0.0, 0.0
        for view in views:
            seen = (view.alpha > COVERED).float().reshape(-1, 1).numpy()
            total = total + view.mix.T @ (self.components(view.frame) * seen)
            weight = weight + view.mix.T @ seen
        latents = total / np.maximum(weight, 1e-6)
        if self.config.feature_grad_to_skinning:
            parts = np.split(np.concatenate([latents * weight, weight], 1), [len(self.scene.static)])
            moved = self.skinning.T @ parts[1]
            latents = np.concatenate([latents[: len(parts[0])], moved[:, :-1] / np.maximum(moved[:, -1:], 1e-6)])
        spread = latents.std() if latents.size else 1.0
        return (latents / max(spread, 1e-6)).astype(np.float32)

    def components(self, frame: int) -> np.ndarray:
        """Return (cells,D) principal components of all teachers' maps of a frame, on the common grid."""
        found = []
        for each in self.maps:
            map_ = torch.from_numpy(each.at(frame)).permute(2, 0, 1)[None]  # (1,C,h,w)
            map_ = functional.interpolate(map_, self.grid, mode="bilinear", align_corners=False)
            found.append(map_[0].flatten(1).T.numpy())
        return self.spectrum.coordinates(found, self.width)

    def train(self, views: Sequence[View], start: np.ndarray) -> tuple[np.ndarray, np.ndarray | None]:
        """Return the latents (Ns+M,D) after training and, where they may move, skinning weights (Nd,K)."""
        config = self.config
        before = torch.from_numpy(start.astype(np.float32))
        latents = before.clone().requires_grad_(not self.frozen)
        skin = _Skinning(self.scene) if config.feature_grad_to_skinning else None
        groups: list[dict[str, Any]] = [
            {"params": [p for task in self.tasks for p in task.head.parameters()], "lr": config.head_rate}
        ]
        if latents.requires_grad:
            groups.append({"params": [latents], "lr": config.latent_rate})
        if skin is not None:
            groups.append({"params": [skin.logits], "lr": config.latent_rate})
        optimiser = torch.optim.Adam(groups)
        schedule = torch.optim.lr_scheduler.CosineAnnealingLR(optimiser, config.steps)
        parameters = [parameter for group in groups for parameter in group["params"]]

        def gradients(view: View) -> tuple[Tensor, ...]:
            """Return the gradients of a view's loss to all parameters."""
            seen = self.seen(latents if skin is None else skin.columns(latents), view)
            loss = torch.stack([task.loss(seen, view.alpha, view.frame) for task in self.tasks]).sum()
            if self.kept and latents.requires_grad:
                with torch.no_grad():
                    was = self.seen(before if skin is None else skin.columns(before), view)
                loss = loss + config.keep * sum(kept.loss(seen, was, view.alpha) for kept in self.kept)
            return torch.autograd.grad(loss, parameters)

        order: list[int] = []
        for done in range(config.steps):
            self.progress("distil", done, config.steps)
            looked_at = []
            for _ in range(min(config.frames_per_step, len(views))):
                order = order or list(self.rng.permutation(len(views)))
                looked_at.append(views[order.pop()])
            for parameter, *parts in zip(parameters, *in_threads(gradients, looked_at), strict=True):
                parameter.grad = torch.stack(parts).sum(0)
            optimiser.step()
            schedule.step()
        self.progress("distil", config.steps, config.steps)
        return latents.detach().numpy(), None if skin is None else skin.weights().detach().numpy()

    def seen(self, columns: Tensor, view: View) -> Tensor:
        """Return (h,w,D) latent that a view sees."""
        mixed: Tensor = _Mix.apply(columns, view)
        return mixed.reshape(*self.grid, -1)

    def need(self) -> Need:
        """Return the row of the needs table."""
        chosen = f"{self.width} channels, {len(self.kept) + len(self.tasks)} heads"
        evidence = self.spectrum.evidence() if self.config.width is None and not self.kept else "given"
        if self.kept:
            evidence = f"the width of the heads that are kept; {self.spectrum.evidence()}"
        saved = f"{WIDTHS[-1] - self.width} of {WIDTHS[-1]} channels per Gaussian and node"
        return Need("latent", chosen, evidence, saved)

    def report(
        self, views: Sequence[View], latents: np.ndarray, stored: np.ndarray
    ) -> tuple[tuple[FieldHead, ...], Any]:
        """Return the heads to store with their colours and scores, kept ones first, and the PCA of the latent.

        `latents (Ns+M,D)` as trained, `stored` the same after its way through bytes.
        """
        heads = [kept.stored for kept in self.kept] + [_stored(task) for task in self.tasks]
        plain = [kept.head for kept in self.kept] + [task.folded() for task in self.tasks]
        figures = {head.spec.name: _Figures() for head in heads}
        before = self.first_latents(views) if self.kept else latents
        per_frame = max(1, PICTURE_SAMPLES // len(views))
        samples = []
        for view in self.steps("report", views):
            z, exact, was = (
                self.seen(self.columns(part), view) for part in (torch.from_numpy(a) for a in (stored, latents, before))
            )
            cells = z[view.alpha > COVERED].numpy()
            samples.append(cells[self.rng.permutation(len(cells))[:per_frame]])
            group = "held_out" if view.frame in self.scene.held_out else "used"
            for head, network in zip(heads, plain, strict=True):
                at, alpha = to_grid(z, view.alpha, head.spec)
                known = (alpha > COVERED).numpy()
                found = head(at.numpy())[known]
                errors = figures[head.spec.name]
                if any(kept.stored is head for kept in self.kept):
                    errors.add("drift", found, head(to_grid(was, view.alpha, head.spec)[0].numpy())[known])
                    continue
                task = next(task for task in self.tasks if task.spec.name == head.spec.name)
                errors.add(group, found, task.maps.at(view.frame)[known])
                with torch.no_grad():
                    unrounded = network(to_grid(exact, view.alpha, head.spec)[0]).numpy()[known]
                errors.add("stored_change", found, unrounded)
        latent = np.concatenate(samples) if samples else np.zeros((0, self.width), np.float32)
        done = tuple(
            replace(head, pca=fit_pca(head(latent)), report={**head.report, **figures[head.spec.name].rows()})
            for head in heads
        )
        return done, fit_pca(latent)

    def columns(self, latents: Tensor) -> Tensor:
        """Return the rows that `View.mix` blends: latents (Ns+M,D), or with those of dynamic Gaussians in place of the nodes'."""
        if not self.config.feature_grad_to_skinning:
            return latents
        static, nodes = latents.split([len(self.scene.static), self.nodes])
        return torch.cat([static, torch.from_numpy(self.skinning @ nodes.numpy())])


class _Skinning:
    """Skinning weights of the dynamic Gaussians that follow the features: softmax over the slots that are used."""

    def __init__(self, scene: Scene):
        weight = torch.from_numpy(np.ascontiguousarray(scene.dynamic.weight))
        self.used = weight > 0
        self.logits = torch.where(self.used, weight.clamp_min(1e-9).log(), weight).requires_grad_()
        self.node = torch.from_numpy(scene.dynamic.node.astype(np.int64))
        self.static = len(scene.static)

    def weights(self) -> Tensor:
        """Return (Nd,K), 0 where they were 0."""
        return torch.softmax(self.logits.masked_fill(~self.used, -math.inf), 1).nan_to_num(0.0)

    def columns(self, latents: Tensor) -> Tensor:
        """Return (Ns+Nd,D) latents of all Gaussians from those of static ones and nodes."""
        nodes = latents[self.static :]
        return torch.cat([latents[: self.static], (self.weights()[..., None] * nodes[self.node]).sum(1)])


class _Figures:
    """Sums of errors per group of frames."""

    def __init__(self) -> None:
        self.sums: dict[str, np.ndarray] = {}

    def add(self, group: str, found: np.ndarray, wanted: np.ndarray) -> None:
        """Compare features (n,C)."""
        lengths = np.linalg.norm(found, axis=1) * np.linalg.norm(wanted, axis=1)
        cosine = (found * wanted).sum(1) / np.maximum(lengths, 1e-12)
        sums = np.array([np.abs(found - wanted).sum(), np.abs(wanted).sum(), cosine.sum(), len(found)], np.float64)
        self.sums[group] = self.sums.get(group, 0) + sums

    def rows(self) -> dict[str, Any]:
        """Per group: relative error and, against a teacher, mean cosine; groups without a cell are left out."""
        rows: dict[str, Any] = {}
        for group, (error, size, cosine, count) in self.sums.items():
            if count:
                error = round(float(error / max(size, 1e-12)), 5)
                against = {"relative_error": error, "cosine": round(float(cosine / count), 5)}
                rows[group] = against if group in ("used", "held_out") else error
        return rows


def common_grid(specs: Sequence[FeatureSpec], scene: Scene) -> tuple[int, int]:
    """(h,w) on which blend weights are summed, at most the picture's: the finest of the teachers' grids where its cells fill the
    others' exactly, else twice as fine, because a cell cut in two belongs to both sides."""
    rows, columns = (max(spec.grid[axis] for spec in specs) for axis in (0, 1))
    finer = 1 if all(rows % spec.grid[0] == 0 == columns % spec.grid[1] for spec in specs) else 2
    return min(finer * rows, scene.cameras.height), min(finer * columns, scene.cameras.width)


def to_grid(latent: Tensor, alpha: Tensor, spec: FeatureSpec) -> tuple[Tensor, Tensor]:
    """Return the latent (h,w,D) and alpha (h,w) on the grid of `spec`, from any other; empty cells are no part of the mean.

    Shrinking is anti-aliased: means over area, or a triangle as wide as the new cells for `bilinear`.
    """
    if tuple(alpha.shape) == spec.grid:
        return latent, alpha
    stack = torch.cat([latent * alpha[..., None], alpha[..., None]], -1).permute(2, 0, 1)[None]  # (1,D+1,H,W)
    if spec.resize == "area":
        found = functional.adaptive_avg_pool2d(stack, spec.grid)
    else:
        found = functional.interpolate(stack, spec.grid, mode="bilinear", align_corners=False, antialias=True)
    found = found[0].permute(1, 2, 0)
    return found[..., :-1] / found[..., -1:].clamp_min(1e-6), found[..., -1]


def dissimilarity(found: Tensor, wanted: Tensor, seen: Tensor, span: float) -> Tensor:
    """1 - mean SSIM of features (h,w,C) that span `span`, with cells out of `seen` (h,w) black; window max(h // 40, 2)."""
    x, y = ((features * seen[..., None]).permute(2, 0, 1) for features in (found, wanted))  # (C,h,w)
    window = max(len(seen) // 40, 2)
    mean = [functional.avg_pool2d(each, window, 1) for each in (x, y, x * x, y * y, x * y)]
    c1, c2 = (0.01 * span) ** 2, (0.03 * span) ** 2
    product = mean[0] * mean[1]
    squares = mean[0] ** 2 + mean[1] ** 2
    like = (2 * product + c1) * (2 * (mean[4] - product) + c2)
    return 1 - (like / ((squares + c1) * (mean[2] + mean[3] - squares + c2))).mean()


def _stored(task: HeadTask) -> FieldHead:
    """Return the trained head in the scene file's form."""
    arrays = {name: array.astype(np.float16) for name, array in task.folded().to_arrays().items()}
    layers = range(len(arrays) // 2)
    glob = None if task.maps.glob is None else np.asarray(task.maps.glob, np.float16)
    weights, biases = (tuple(arrays[f"{kind}_{i}"] for i in layers) for kind in ("weight", "bias"))
    return FieldHead(task.spec, weights, biases, glob=glob)


def _check(scene: Scene, maps: Sequence[FeatureMaps], config: DistilConfig) -> None:
    """Raise F4xError for what cannot be distilled."""
    if not maps:
        raise F4xError("There is nothing to distil: name at least one teacher.")
    names = [each.spec.name for each in maps]
    if len(set(names)) < len(names):
        raise F4xError(f"Two of the teachers are called the same ({', '.join(names)}); distil one of them.")
    for each in maps:
        if len(each) != len(scene.cameras):
            raise F4xError(
                f"{each.folder}: maps of {len(each)} frames, the scene has {len(scene.cameras)}; extract them again from"
                " the clip that the scene was fitted to, with the same --frames."
            )
    if config.width is not None and (config.width < 2 or config.width % 2):
        raise F4xError(f"--width {config.width}: a latent has an even number of channels, 2 at least.")
    if config.steps < 1:
        raise F4xError(f"--steps {config.steps}: give at least 1.")
