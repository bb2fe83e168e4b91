"""The rasteriser's speed against its error: backends, precisions, cut-offs, tiles, channels, sizes, counts, gradients.

Everything is measured on `speed.raster.make_wavy_scene`: sheets of splats as large as their spacing, about 40 of which
contribute to a pixel. Errors are those of the picture (colours in [0, 1]) and of every gradient (relative L2 norm).
"""

from __future__ import annotations

import math
import os
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from typing import Any

import torch

from f4x_core.language.lexicon import plural
from f4x_core.raster import RasterConfig, why_not
from f4x_core.raster.native import available

from ..speed.raster import (
    GRADIENTS,
    Answer,
    Draw,
    answer,
    compare_decoding,
    draw,
    draw_with,
    make_wavy_scene,
    measure_thread_ceiling,
    passes,
)
from ..study import Context, Figure, Findings, Row, Table, time_columns, time_rows
from .peers import Peer, find_peers

Scene = dict[str, Any]
PICTURE, STEP = "picture", "step"
"""Times of a forward pass without gradients, and of a forward and backward pass."""
TIMED = (*time_columns(PICTURE), *time_columns(STEP))
RMSE, P99_9, MAX = "picture rmse", "99.9 % of pixels within", "picture max error"
WORST = "worst gradient error"
MAX_ERROR, MAX_GRADIENT_ERROR = 1e-4, 1e-2
"""Largest error of float32 against float64 in 99.9 % of the pixels and in gradients: rounding gives 1e-6 and, with splats on the
verge of a cut-off, 1e-3 in an unlucky scene; a missing splat or term gives more than 1e-2."""
SIZES = {"count": 6000, "width": 192, "height": 108}, {"count": 50_000, "width": 480, "height": 270}
"""Scenes of a quick and of a full report, here and below, where the study is not about their size."""
REFERENCE_SIZES = (
    {"count": 300, "channels": 11, "width": 96, "height": 72},
    {"count": 3000, "channels": 11, "width": 137, "height": 101},
)
"""Scenes that the reference can draw, where every splat meets every pixel."""
CHANNELS = (3, 8, 32, 128, 512), (3, 8, 16, 32, 64, 128, 256, 512)
WIDTHS = (96, 192, 384), (96, 192, 384, 768, 1536)
COUNTS = (1000, 3000, 10_000, 30_000), (1000, 3000, 10_000, 30_000, 100_000, 300_000)
VERGE = (
    f"`{MAX}` is more than rounding where a splat on the verge of a cut-off is in for one and out for the other: up to 1/255 at"
    f" the alpha cut and 0.01 at the stop. `{P99_9}` and `{RMSE}` tell of all other pixels."
)
RGB_AND_LATENT = 3 + 32
NO_CUTS = {"alpha_min": 1e-7, "transmittance_min": 1e-12}
"""Far below float32 rounding of a colour."""
CUTS: dict[str, dict[str, float]] = {
    "3DGS (alpha 1/255, stop 1e-4)": {},
    "none": NO_CUTS,
    "stop 1e-6": {"transmittance_min": 1e-6},
    "stop 1e-3": {"transmittance_min": 1e-3},
    "stop 1e-2": {"transmittance_min": 1e-2},
    "stop 1e-1": {"transmittance_min": 1e-1},
    "alpha 1/1024": {"alpha_min": 1 / 1024},
    "alpha 1/64": {"alpha_min": 1 / 64},
    "alpha 1/32": {"alpha_min": 1 / 32},
    "alpha 1/16": {"alpha_min": 1 / 16},
}
TILES = (4, 8, 16, 32)
PAPER_SECONDS = {8: 4.818, 16: 4.898, 32: 4.872, 64: 4.967, 128: 5.815, 256: 10.167, 512: 16.313}
"""Feature4X, supplement, Table D: rendering time against the width of the latent, NVIDIA Jumping, on a GPU."""
STEPS = tuple(10.0**-power for power in range(2, 10))
"""Half widths of the differences that the reference's gradients are compared with, in the parameter's own unit."""


@dataclass(frozen=True)
class Way:
    """One way to draw a scene."""

    backend: str
    """Name of the backend, or of a peer (another program)."""
    precision: str = "float32"
    config: RasterConfig = field(default_factory=RasterConfig)
    peer: Peer | None = None
    """None = ours."""

    @property
    def name(self) -> str:
        """Name in tables."""
        return f"{self.backend}, {self.precision}"

    def scene(self, scene: Scene) -> Scene:
        """Convert `scene` for this way."""
        kind = getattr(torch, self.precision)
        cast = {key: value.detach().to(kind) for key, value in scene.items() if torch.is_tensor(value)}
        return scene | ({key: value.numpy() for key, value in cast.items()} if self.backend == "plain" else cast)

    def draw(self, cast: Scene) -> Draw:
        """Drawing of a scene that was `cast` by `scene`; not for `plain`."""
        return self.peer.prepare(cast, self.config) if self.peer else draw_with(self.backend, self.config)

    def answer(self, scene: Scene) -> Answer:
        """Return the picture and, where the backend has them, the gradients."""
        if self.backend != "plain":
            cast = self.scene(scene)
            return answer(cast, self.draw(cast))
        image = draw(**self.scene(scene), backend="plain", config=self.config).channels
        return Answer(torch.from_numpy(image).double(), {})


def find_ways(threads: int) -> tuple[list[Way], list[str]]:
    """Return the backends and peers that draw on this machine, the reference first, and a sentence for each that is missing."""
    config = RasterConfig(threads=threads)
    ways = [Way("reference", "float64", config)]
    ways += [Way("torch", precision, config) for precision in ("float64", "float32", "float16")]
    ways.append(Way("plain", "float64", config))
    reason = why_not("native")
    if reason is None:
        ways.append(Way("native", "float32", config))
    peers, absent = find_peers()
    for peer in peers:
        rule = replace(config, alpha_max=peer.alpha_max)
        ways += [Way(f"{peer.name} (peer)", precision, rule, peer) for precision in ("float64", "float32")]
    return ways, absent + ([] if reason is None else [f"native raster: {reason}"])


def fast_ways(threads: int) -> list[Way]:
    """Return the ways meant for real work: the compiled library where it is present, and torch."""
    config = RasterConfig(threads=threads)
    return [Way(name, "float32", config) for name in (["native"] if available() else []) + ["torch"]]


def truth_of(scene: Scene, threads: int, **config: float) -> Answer:
    """The float64 answer of the `torch` backend, which differs from the reference by float64 rounding (`raster-backends`)."""
    return Way("torch", "float64", RasterConfig(threads=threads, **config)).answer(scene)  # type: ignore[arg-type]


def reference_answers(ways: Sequence[Way], scene: Scene) -> list[Answer]:
    """Return the answer that each way is compared with: the reference's answer, a peer's with the peer's own clamp of alpha."""
    rules = {way.config.alpha_max: way.config for way in ways}
    answers = {clamp: Way("reference", "float64", rule).answer(scene) for clamp, rule in rules.items()}
    return [answers[way.config.alpha_max] for way in ways]


def errors_of(found: Answer, truth: Answer) -> Row:
    """Columns of errors; None where there are no gradients, and what overflowed by name."""
    error = found.minus(truth)
    every = {RMSE: error["image_rmse"], P99_9: error["image_most"], MAX: error["image_max"]}
    every |= {f"{name} gradient error": error["gradients"].get(name) for name in GRADIENTS}
    known = {name: value for name, value in every.items() if value is not None and math.isfinite(value)}
    gradients = [value for name, value in known.items() if name.endswith("gradient error")]
    lost = [name.removesuffix(" error") for name, value in every.items() if value is not None and name not in known]
    row: Row = {name: known.get(name) for name in every} | {"overflows": ", ".join(lost)}
    return row | {WORST: max(gradients) if gradients and not lost else None}


def time_ways(ways: Sequence[Way], scene: Scene, repeats: int) -> list[Row]:
    """Columns of times of each way, timed in turn; None where there is no backward pass."""
    images: list[Callable[[], object]] = []
    steps: dict[int, Callable[[], object]] = {}
    for number, way in enumerate(ways):
        cast = way.scene(scene)
        if way.backend == "plain":
            images.append(partial(draw, **cast, backend="plain", config=way.config))
        else:
            image, steps[number] = passes(cast, way.draw(cast))
            images.append(image)
    drawn = time_rows([way.name for way in ways], images, repeats, column=PICTURE)
    trained = time_rows([ways[number].name for number in steps], list(steps.values()), repeats, column=STEP)
    trained_of = dict(zip(steps, trained, strict=True))
    none = dict.fromkeys(time_columns(STEP))
    rows = [row | trained_of.get(number, none) for number, row in enumerate(drawn)]
    return [{key: value for key, value in row.items() if key != "name"} for row in rows]


def measure_ways(ways: Sequence[Way], scene: Scene, truths: Sequence[Answer], repeats: int, **about: Any) -> list[Row]:
    """One row for each way: `about`, backend, precision, times, errors against its one of `truths`."""
    times = time_ways(ways, scene, repeats)
    return [
        about | {"backend": way.backend, "precision": way.precision} | row | errors_of(way.answer(scene), truth)
        for way, row, truth in zip(ways, times, truths, strict=True)
    ]


def measure_backends(context: Context) -> Findings:
    """Measure all backends beside the float64 reference, and what threads gain."""
    size = context.choose(*REFERENCE_SIZES)
    ways, skipped = find_ways(context.threads)

    def work() -> list[Row]:
        scene = make_wavy_scene(**size, seed=context.seed)
        rows = measure_ways(ways, scene, reference_answers(ways, scene), context.repeats)
        return [{"name": way.name} | row for way, row in zip(ways, rows, strict=True)]

    rows = context.step("backends", work, size=size, ways=[way.name for way in ways])
    ours = [row for row, way in zip(rows, ways, strict=True) if way.peer is None]
    peers = [row for row, way in zip(rows, ways, strict=True) if way.peer]
    threads = context.step("threads", partial(_thread_rows, context), cores=os.cpu_count())
    note = f"{_RULE} {_PEERS}" if peers else _RULE
    ceiling = context.step("ceiling", lambda: [{"threads": 2, "at most": measure_thread_ceiling()}])
    tables = [
        Table("backends", rows, f"Every way to draw: {_about(context, **size)}", TIMED, note),
        Table("threads", threads, "Threads", (*TIMED, "gain"), "`same bits`: picture and gradients as on one thread"),
        Table("ceiling", ceiling, "What two threads can gain on this machine", ("at most",), _CEILING),
    ]
    figures = [
        Figure("A picture", "backends", f"{PICTURE} (ms)", RMSE, "name", *time_columns(PICTURE)[1:]),
        Figure("A training step", "backends", f"{STEP} (ms)", WORST, "name", *time_columns(STEP)[1:]),
    ]
    words = _backend_words(ours) + _peer_words(ours, peers)
    return Findings(tables, figures, words, skipped, _untrue(ours) + _unequal(threads))


_RULE = (
    "Errors are differences from the first row. float16 rounds the scene too. `plain` is numpy alone and draws pictures only: "
    "it has no gradients. " + VERGE
)
_PEERS = (
    "Peers differ in one constant, the clamp of alpha, and are compared with the reference under their own. gsplat's torch"
    " reference draws with its projection and its `accumulate`. It is given for free the list of (pixel, splat) pairs that"
    " contribute, which a CUDA kernel makes otherwise, and two functions of nerfacc in torch."
)
_CEILING = (
    "Independent loops of multiply-adds on two threads, over one: 2 on two cores, little above 1 on one core's halves."
)


def _thread_rows(context: Context) -> list[Row]:
    scene = make_wavy_scene(**context.choose(*SIZES), channels=RGB_AND_LATENT, seed=context.seed)
    numbers = [n for n in (1, 2, 4, 8) if n <= (os.cpu_count() or 1)]
    ways = [way for n in numbers for way in fast_ways(n)]
    alone = {way.backend: way.answer(scene) for way in fast_ways(1)}
    rows = []
    times = time_ways(ways, scene, context.repeats)
    single = {way.backend: row[f"{STEP} (ms)"] for way, row in zip(ways, times, strict=True) if way.config.threads == 1}
    for way, row in zip(ways, times, strict=True):
        error = errors_of(way.answer(scene), alone[way.backend])
        same = error[MAX] == 0 and error[WORST] == 0
        about = {"backend": way.backend, "threads": way.config.threads}
        rows.append(about | row | {"gain": single[way.backend] / row[f"{STEP} (ms)"], "same bits": same})
    return rows


def _backend_words(rows: Sequence[Row]) -> list[str]:
    reference, others = rows[0], [row for row in rows[1:] if row[f"{STEP} (ms)"] is not None]
    return [
        f"{row['name']}: a training step takes {row[f'{STEP} (ms)']:.3g} ms, {_over(reference, row):.0f} times less than the"
        f" float64 reference; {_error_sentence(row)}."
        for row in others
    ]


def _peer_words(ours: Sequence[Row], peers: Sequence[Row]) -> list[str]:
    words = []
    for row in peers:
        alike = [
            mine for mine in ours[1:] if mine["precision"] == row["precision"] and mine[f"{STEP} (ms)"] is not None
        ]
        ratios = " and ".join(f"{_over(row, mine):.1f} times as long as {mine['backend']}" for mine in alike)
        words.append(
            f"{row['name']}: a training step takes {row[f'{STEP} (ms)']:.3g} ms, {ratios} in the same precision, its list of"
            f" pairs not counted; {_error_sentence(row)}."
        )
    return words


def _error_sentence(row: Row) -> str:
    """Sentence about the errors of a row's picture and gradients."""
    image = "its picture overflows" if row[RMSE] is None else f"its picture is off by {row[RMSE]:.1e} (rms)"
    worst = f"overflows: {row['overflows']}" if row[WORST] is None else f"its worst gradient by {row[WORST]:.1e}"
    return f"{image}, {worst}"


def _over(slow: Row, fast: Row) -> float:
    return slow[f"{STEP} (ms)"] / fast[f"{STEP} (ms)"]


def _untrue(rows: Sequence[Row]) -> list[str]:
    """Sentences about float32 and float64 rows whose error is more than rounding."""
    return [
        f"{row['backend']}, {row['precision']}: more than rounding; {_error_sentence(row)}."
        for row in rows
        if row["precision"] in ("float32", "float64")
        and (row["overflows"] or row[P99_9] > MAX_ERROR or (row[WORST] or 0) > MAX_GRADIENT_ERROR)
    ]


def _unequal(rows: Sequence[Row]) -> list[str]:
    return [f"{row['backend']}: {row['threads']} threads change bits." for row in rows if not row["same bits"]]


def measure_cut_offs(context: Context) -> Findings:
    """Measure the error and the time of precision, the alpha cut and the stop."""
    size = context.choose(*SIZES) | {"channels": RGB_AND_LATENT}

    def work() -> list[Row]:
        scene = make_wavy_scene(**size, seed=context.seed)
        rule, whole = truth_of(scene, context.threads), truth_of(scene, context.threads, **NO_CUTS)
        fastest = fast_ways(context.threads)[0]
        ways = [replace(fastest, config=replace(fastest.config, **change)) for change in CUTS.values()]  # type: ignore[arg-type]
        ways += [Way("torch", precision, fastest.config) for precision in ("float64", "float32", "float16", "bfloat16")]
        names = [*CUTS, *(way.name for way in ways[len(CUTS) :])]
        rows = []
        for name, way, times in zip(names, ways, time_ways(ways, scene, context.repeats), strict=True):
            found = way.answer(scene)
            kind = name.split()[0] if name in CUTS else "torch, precisions"
            about = {"setting": name, "kind": kind, "backend": way.backend, "precision": way.precision}
            rows.append(about | times | errors_of(found, rule) | {WHOLE: found.minus(whole)["image_rmse"]})
        return rows

    rows = context.step("cut-offs", work, cuts=CUTS, size=size)
    note = (
        f"`{RMSE}`, `{P99_9}`, `{MAX}` and gradients: against float64 with the cut-offs of 3DGS. `{WHOLE}`: against float64"
        " without cut-offs, which is what the cut-offs themselves leave out."
    )
    bars = time_columns(STEP)[1:]
    figures = [
        Figure("Against 3DGS's cut-offs in float64", "cut-offs", f"{STEP} (ms)", RMSE, "kind", *bars),
        Figure("Against no cut-offs at all in float64", "cut-offs", f"{STEP} (ms)", WHOLE, "kind", *bars),
    ]
    return Findings([Table("cut-offs", rows, _about(context, **size), TIMED, note)], figures, _cut_words(rows))


WHOLE = "picture rmse to no cut-offs"


def _cut_words(rows: Sequence[Row]) -> list[str]:
    rule = rows[0]
    _, low, high = time_columns(STEP)
    cheaper = [row for row in rows[: len(CUTS)] if row[high] < rule[low]]  # beyond what times scatter
    words = [
        f"The cut-offs of 3DGS leave out {rule[WHOLE]:.1e} of a colour (rms) and make a training step"
        f" {rows[1][f'{STEP} (ms)'] / rule[f'{STEP} (ms)']:.2f} times as fast as without any."
    ]
    words += [
        f"{row['setting']} saves time beyond the quartiles ({1 - row[f'{STEP} (ms)'] / rule[f'{STEP} (ms)']:.0%});"
        f" {_error_sentence(row)}."
        for row in cheaper
    ]
    return words


def measure_tiles(context: Context) -> Findings:
    """Tile sizes, which must not change the result."""
    size = context.choose(*SIZES) | {"channels": RGB_AND_LATENT}

    def work() -> list[Row]:
        scene = make_wavy_scene(**size, seed=context.seed)
        truth = truth_of(scene, context.threads)
        torch_ways = [Way("torch", config=RasterConfig(tile=tile, threads=context.threads)) for tile in TILES]
        native = [way for way in fast_ways(context.threads) if way.backend == "native"]
        ways = torch_ways + native
        rows = measure_ways(ways, scene, [truth] * len(ways), context.repeats)
        tiles = [*TILES, *(NATIVE_TILE for _ in native)]
        return [{"tile (pixels)": tile} | row for tile, row in zip(tiles, rows, strict=True)]

    rows = context.step("tiles", work, tiles=TILES, size=size)
    best = min((row for row in rows if row["backend"] == "torch"), key=lambda row: row[f"{STEP} (ms)"])
    words = [
        f"torch is fastest with tiles of {best['tile (pixels)']} x {best['tile (pixels)']} pixels"
        f" ({best[f'{STEP} (ms)']:.3g} ms a step; its default is {RasterConfig().tile}); with any tile size the"
        f" picture is within {max(row[RMSE] for row in rows):.1e} (rms) of float64."
    ]
    figures = [
        Figure("A training step", "tiles", "tile (pixels)", f"{STEP} (ms)", "backend", *time_columns(STEP)[1:]),
        Figure("Its error", "tiles", "tile (pixels)", RMSE, "backend"),
    ]
    note = (
        f"The tiles of the compiled library are fixed at {NATIVE_TILE} x {NATIVE_TILE}. Errors against float64. {VERGE}"
    )
    return Findings([Table("tiles", rows, _about(context, **size), TIMED, note)], figures, words, failed=_untrue(rows))


NATIVE_TILE = 16
"""Side in raster.cpp."""


def measure_channels(context: Context) -> Findings:
    """Channel widths, beside Table D, and a latent that is decoded instead."""
    size = context.choose(*SIZES)
    numbers = context.choose(*CHANNELS)
    cases = [size | {"channels": c} for c in numbers]
    rows = _sweep(context, cases, ("channels",))
    relative: list[Row] = [
        {"source": "Feature4X, Table D", "channels": c, RELATIVE: seconds / PAPER_SECONDS[8]}
        for c, seconds in PAPER_SECONDS.items()
    ]
    for backend in dict.fromkeys(row["backend"] for row in rows):
        mine = {row["channels"]: row[f"{PICTURE} (ms)"] for row in rows if row["backend"] == backend}
        relative += [
            {"source": f"ours, {backend}", "channels": c, RELATIVE: time / mine[8]}
            for c, time in mine.items()
            if c >= 8
        ]
    decoding = context.step(
        "decoding", partial(_decoding_rows, context.repeats, rows[0]["backend"], tuple(size.values())), size=size
    )
    tables = [
        Table("channels", rows, _about(context, **size), TIMED, f"Errors against float64. {VERGE}"),
        Table("beside-table-d", relative, "Pictures, relative to 8 channels", (RELATIVE,), _TABLE_D),
        Table(
            "decoding", decoding, "512 channels, or 32 and a linear layer", tuple(decoding[0]), "A step, one thread."
        ),
    ]
    figures = [
        Figure("A training step", "channels", "channels", f"{STEP} (ms)", "backend", *time_columns(STEP)[1:]),
        Figure("Picture and width", "beside-table-d", "channels", RELATIVE, "source"),
        Figure("Error of the picture", "channels", "channels", RMSE, "backend"),
    ]
    first = [row for row in rows if row["backend"] == rows[0]["backend"]]
    words = [
        f"{first[-1]['channels']} channels take {_over(first[-1], first[0]):.1f} times as long as {first[0]['channels']}"
        f" ({first[0]['backend']}); rendering 512 takes {decoding[0]['ratio']:.1f} times as long as rendering 32 and decoding them."
    ]
    return Findings(tables, figures, words, failed=_untrue(rows))


def _decoding_rows(repeats: int, backend: str, size: tuple[int, int, int]) -> list[Row]:
    found = compare_decoding(*size, repeats, backend)
    ways = {"512 rendered (ms)": "rendered_ms", "32 rendered and decoded (ms)": "decoded_ms", "ratio": "ratio"}
    return [{column: found[name] for column, name in ways.items()}]


RELATIVE = "time over that of 8 channels"
_TABLE_D = "Theirs: rendering time of the whole clip on a GPU, NVIDIA Jumping. Ours: one picture, this machine, a made-up scene."


def measure_sizes(context: Context) -> Findings:
    """Picture sizes at an equal number of Gaussians."""
    count, widths = context.choose(*SIZES)["count"], context.choose(*WIDTHS)
    cases = [{"count": count, "width": w, "height": w * 9 // 16, "channels": RGB_AND_LATENT} for w in widths]
    rows = _sweep(context, cases, ("width", "height"))
    for row in rows:
        row["megapixels"] = row["width"] * row["height"] / 1e6
    return _curve(rows, "megapixels", _about(context, count=count, channels=RGB_AND_LATENT))


def measure_counts(context: Context) -> Findings:
    """Numbers of Gaussians at an equal picture size."""
    width, height = (context.choose(*SIZES)[side] for side in ("width", "height"))
    counts = context.choose(*COUNTS)
    cases = [{"count": n, "width": width, "height": height, "channels": RGB_AND_LATENT} for n in counts]
    rows = _sweep(context, cases, ("count",))
    for row in rows:
        row["Gaussians"] = row.pop("count")
    return _curve(rows, "Gaussians", _about(context, channels=RGB_AND_LATENT, width=width, height=height))


def _sweep(context: Context, cases: Sequence[dict[str, Any]], varied: Sequence[str]) -> list[Row]:
    """Rows of the fast ways for scenes of other `count`, `channels`, `width`, `height`; columns `varied` say which."""
    rows: list[Row] = []
    for case in cases:

        def work(case: dict[str, Any] = case) -> list[Row]:
            scene = make_wavy_scene(**case, seed=context.seed)
            about = {name: case[name] for name in varied}
            ways, truth = fast_ways(context.threads), truth_of(scene, context.threads)
            return measure_ways(ways, scene, [truth] * len(ways), context.repeats, **about)

        rows += context.step("-".join(str(case[name]) for name in varied), work, case=case)
    return rows


def _curve(rows: list[Row], across: str, size: str) -> Findings:
    words = []
    for backend in dict.fromkeys(row["backend"] for row in rows):
        mine = [row for row in rows if row["backend"] == backend]
        words.append(
            f"{backend}: {mine[-1][across] / mine[0][across]:.0f} times the {across} take {_over(mine[-1], mine[0]):.1f} times as"
            f" long; the picture stays within {max(row[RMSE] for row in mine):.1e} (rms), gradients within"
            f" {max(row[WORST] for row in mine):.1e}."
        )
    figures = [
        Figure("A training step", "curve", across, f"{STEP} (ms)", "backend", *time_columns(STEP)[1:]),
        Figure("A picture", "curve", across, f"{PICTURE} (ms)", "backend", *time_columns(PICTURE)[1:]),
        Figure("Error of the picture", "curve", across, P99_9, "backend"),
        Figure("Worst gradient", "curve", across, WORST, "backend"),
    ]
    return Findings(
        [Table("curve", rows, size, TIMED, f"Errors against float64. {VERGE}")], figures, words, failed=_untrue(rows)
    )


def _about(context: Context, count: int = 0, channels: int = 0, width: int = 0, height: int = 0) -> str:
    """Return the setting in words; what is 0 varies."""
    parts = [f"{count:,} Gaussians" if count else "", f"{channels} channels" if channels else ""]
    parts += [f"{width} x {height} pixels" if width else "", f"{context.threads} {plural('thread', context.threads)}"]
    return ", ".join(filter(None, parts))


def measure_gradients(context: Context) -> Findings:
    """Compare every gradient, Gaussian by Gaussian, with the reference; and the reference with differences."""
    size = context.choose(*REFERENCE_SIZES)
    ways, skipped = find_ways(context.threads)
    ways = [way for way in ways[1:] if way.backend != "plain" and way.precision != "float16"]  # which overflows

    def work() -> list[Row]:
        scene = make_wavy_scene(**size, seed=context.seed)
        truths = zip(ways, reference_answers(ways, scene), strict=True)
        return [row for way, truth in truths for row in _gradient_rows(way, way.answer(scene), truth)]

    rows = context.step("gradients", work, ways=[way.name for way in ways], size=size)
    differences = context.step("differences", partial(_difference_rows, context.seed), steps=STEPS)
    best = {
        name: min((row for row in differences if row["parameter"] == name), key=lambda row: row["relative error"])
        for name in GRADIENTS
    }
    last = max(best.values(), key=lambda row: row["relative error"])
    words = [
        "The reference's own gradients agree with central differences in float64 to"
        f" {last['relative error']:.0e} or better (worst: {last['parameter']}, step {last['step']:.0e})."
    ]
    for way in ways:
        mine = [row for row in rows if row["name"] == way.name]
        worst = max(mine, key=lambda row: row["relative L2 error"])
        words.append(
            f"{way.name}: gradients are within {worst['relative L2 error']:.1e} (worst: {worst['parameter']});"
            f" the median Gaussian's is off by {max(row['median Gaussian'] or 0 for row in mine):.1e} at most."
        )
    note = f"{_GAUSSIANS} {_PEERS}" if any(way.peer for way in ways) else _GAUSSIANS
    tables = [
        Table("gradients", rows, _about(context, **size), note=note),
        Table("differences", differences, "The reference against central differences", note=_DIFFERENCES),
    ]
    figures = [
        Figure("Gradients against float64", "gradients", "parameter", "relative L2 error", "name", log="y"),
        Figure("Reference against differences", "differences", "step", "relative error", "parameter"),
    ]
    return Findings(tables, figures, words, skipped)


_GAUSSIANS = (
    "`median` and `99 %`: of the Gaussians' own relative errors, among Gaussians whose gradient is at least a thousandth of the"
    " largest."
)
_DIFFERENCES = (
    "Derivative of a weighted sum of the picture along a random direction in each parameter, without cut-offs (they make jumps)."
    " Large steps miss the curvature, small ones drown in rounding: the valley between is the agreement."
)


def _gradient_rows(way: Way, found: Answer, truth: Answer) -> list[Row]:
    relative = found.minus(truth)["gradients"]
    rows = []
    for name, true in truth.gradients.items():
        row: Row = {"name": way.name, "parameter": name, "relative L2 error": relative[name]}
        middle = high = None
        if name != "viewmat":
            off, size = (a.reshape(len(true), -1).norm(dim=1) for a in (found.gradients[name] - true, true))
            matters = size > 1e-3 * size.max()
            middle, high = torch.quantile(off[matters] / size[matters], torch.tensor([0.5, 0.99]).double()).tolist()
        rows.append(row | {"median Gaussian": middle, "99 % of Gaussians": high})
    return rows


def _difference_rows(seed: int) -> list[Row]:
    scene = make_wavy_scene(40, 3, 24, 18, seed, torch.float64)
    config = RasterConfig(**NO_CUTS)  # type: ignore[arg-type]
    truth = answer(scene, draw_with("reference", config))
    weights = torch.rand(18, 24, 3, generator=torch.Generator().manual_seed(1))

    def total(name: str, values: torch.Tensor) -> float:
        image = draw(**(scene | {name: values}), backend="reference", config=config).channels
        return float((image * weights).sum())

    rows = []
    generator = torch.Generator().manual_seed(seed + 2)
    for name in GRADIENTS:
        along = torch.randn(scene[name].shape, generator=generator, dtype=torch.float64)
        if name == "viewmat":
            along[3] = 0  # (0, 0, 0, 1) is read by nobody
        along /= along.norm()
        slope = float((truth.gradients[name] * along).sum())
        with torch.no_grad():
            for step in STEPS:
                rise = total(name, scene[name] + step * along) - total(name, scene[name] - step * along)
                rows.append({"parameter": name, "step": step, "relative error": abs(rise / (2 * step) / slope - 1)})
    return rows
