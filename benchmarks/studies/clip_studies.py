"""Whole clips through the ordinary verbs: fitted, asked, edited; rendered ones against their truth; and inside Blender."""

from __future__ import annotations

import json
import subprocess
import sys
from collections.abc import Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any

from f4x_core.errors import F4xError
from f4x_core.processes import run_verb

from ..halves import REAL, RENDERED, in_order
from ..study import Context, Findings, MissingError, Row, Table

WORDS = {"blackswan": "swan", "car-shadow": "car", "camel": "camel", "dog": "dog"}
"""Clip -> word for the thing that its masks show; for another clip it is the clip's name."""
PROFILES = ("quick", "wild")
ASKED = "wild"
"""Profile whose scenes are asked and edited."""
HOLD_OUT = 8
TEACHERS = "text,visual"
FITTED = "clips-fit"
"""Study that leaves the scenes which the others read."""
ROOT = Path(__file__).resolve().parents[2]
"""Of a checkout."""
QUICK_RENDER = ("--extra-cameras", "10", "--frames", "12", "--samples", "4")
FULL_RENDER = ("--extra-cameras",)
PEOPLE_RENDER = ("--extra-cameras", "10", "--samples", "6")
"""Of rendered people, whose pictures are larger."""
RENDERED_CLIPS = "rendered-clips"
"""Study whose folder holds the rendered clips."""
PROVIDERS = {"true": "synthetic", "offline": "classical"}
SCORES = {
    "used (dB)": "used_psnr",
    "used, moving (dB)": "used_psnr_moving",
    "used, static (dB)": "used_psnr_static",
    "held out, camera registered (dB)": "held_out_psnr_registered",
    "flow blend, camera registered (dB)": "held_out_psnr_flow_blend_registered",
    "held out (dB)": "held_out_psnr",
    "held out, camera refined (dB)": "held_out_psnr_refined",
    "nearest frame (dB)": "held_out_psnr_nearest",
    "flow blend (dB)": "held_out_psnr_flow_blend",
    "PCK@0.2": "pck",
    "Gaussians": "gaussians",
}
"""Column -> what `f4x fit` and `f4x eval` call it."""


ASKED_FIGURES = {
    "word: AP, latent drawn and decoded": "text_ap",
    "word: AP, probabilities drawn": "text_gaussians_ap",
    "word: IoU of the selection": "text_iou",
    "word: IoU by Feature4X's rule": "text_rule_iou",
    "mask: IoU after 5 frames": "follow_iou_5",
    "mask: IoU after 10": "follow_iou_10",
    "mask: IoU after 30": "follow_iou_30",
    "mask: IoU at the end": "follow_iou_{last}",
    "file size, of that without features": "size_ratio",
    "change of PSNR (dB)": "psnr_change",
    "a mask through the clip, by features (s)": "mask_feature_seconds",
    "by pictures of it (s)": "mask_picture_seconds",
    "by pictures, of by features": "mask_time_ratio",
}
"""Column -> what `f4x bench features` calls it; `{last}`: the clip's last frame."""
EDIT_FIGURES = {
    "Gaussians": "gaussians",
    "sentence to edited file (s)": "sentence_s",
    "flicker of what stands still, after / before": "still_flicker",
} | {
    f"{label}: {what}": f"{prompt}_{figure}"
    for prompt, label in (("mask", "mask"), ("point", "click"), ("text", "word"))
    for figure, what in (("iou", "IoU"), ("iou_worst", "IoU, worst frame"), ("leakage", "leakage"))
}
"""Column -> what `f4x bench edit` calls it."""
RENDERED_FIGURES = {
    "used (dB)": "used_psnr",
    "used, moving (dB)": "used_psnr_moving",
    "unseen views (dB)": "unseen_psnr",
    "seen surfaces at 5 degrees (dB)": "unseen_psnr_covered_at_5",
    "seen surfaces at 10 degrees (dB)": "unseen_psnr_covered_at_10",
    "moving (dB)": "unseen_psnr_covered_moving_at_10",
    "static (dB)": "unseen_psnr_covered_static_at_10",
    "seen surfaces at 20 degrees (dB)": "unseen_psnr_covered_at_20",
    "fraction of seen surfaces": "unseen_covered_fraction",
    "depth error, static": "depth_error_static",
    "depth error, moving": "depth_error_moving",
    "cameras, share of the path": "ate_fraction",
    "cameras (degrees)": "rotation_error",
    "focal length, fitted / true": "focal_ratio",
    "Gaussians": "Gaussians",
    "time (s)": "time (s)",
}
"""Column -> what `f4x eval --truth` calls it."""
GOAL_IOU, GOAL_LEAKAGE = 0.8, 0.02
"""Of dyeing what a mask or a click on the first frame selects."""


def fit_clips(context: Context) -> Findings:
    """Every real clip with both profiles, scored on used and held-out frames beside two baselines."""
    rows: list[Row] = []
    for clip in _clips(context):
        for profile in PROFILES:
            measured = context.step(f"{clip.name}-{profile}", partial(_fit, clip, profile, context))
            rows.append({"clip": clip.name, "half": REAL.half_of(clip.name), "profile": profile} | measured)
    note = f"Every {HOLD_OUT}th frame is held out; `f4x fit CLIP --profile PROFILE --hold-out {HOLD_OUT}`, then `f4x eval`."
    return Findings([Table("clips", rows, "Real clips", timed=("time (s)",), note=note)])


def ask_clips(context: Context) -> Findings:
    """Words and first-frame masks on the fitted clips that have masks."""
    rows, skipped = [], []
    for clip in _clips(context):
        scene = _fitted(context, clip)
        if not (clip / "masks").is_dir():
            skipped.append(f"{clip.name}: it has no masks")
            continue
        word = WORDS.get(clip.name, clip.name)
        measured = context.step(clip.name, partial(_ask, clip, scene, word, context))
        rows.append({"clip": clip.name, "word": word, "frames": measured["frames"]} | _named(measured, ASKED_FIGURES))
    note = (
        f"`{ASKED}` scenes, teachers {TEACHERS}, all frames seen by the clip's own cameras, against its true masks. AP: average"
        " precision; the mask is the true one of the first frame, followed by features."
    )
    return Findings([Table("questions", rows, "Words and masks", _timed(rows), note)], skipped=skipped)


def edit_clips(context: Context) -> Findings:
    """Edits by mask, click and word on the same scenes, against the true masks."""
    rows, skipped = [], []
    for clip in _clips(context):
        scene = context.folder.parent / "clips-features" / f"{clip.name}.f4x"
        if not scene.is_file():
            skipped.append(f"{clip.name}: it has no features; run clips-features first")
            continue
        word = WORDS.get(clip.name, clip.name)
        verb = ["bench", "edit", "--scene", str(scene), "--masks", str(clip / "masks"), "--label", word]
        try:
            measured = context.step(clip.name, partial(_measure, verb, context))
            rows.append({"clip": clip.name} | _named(measured, EDIT_FIGURES))
        except F4xError as error:  # a word that nothing answers to
            skipped.append(f"{clip.name}: {error}")
    note = (
        "What a prompt on the first frame selects is dyed. IoU: pixels that change by half of what they can, against the true"
        " masks of ten frames; leakage: share of all change beyond the mask and a rim of 1 % of the width."
    )
    table = Table("edits", rows, "Edits", _timed(rows), note)
    return Findings([table], words=[_reached(rows, prompt) for prompt in ("mask", "click")], skipped=skipped)


def fit_rendered(context: Context) -> Findings:
    """Rendered clips, with true and with offline priors, against what only the renderer knows."""
    clips, skipped = render_clips(context, RENDERED.every)
    rows: list[Row] = []
    for name, clip in clips.items():
        for priors, provider in PROVIDERS.items():
            scores = context.step(f"{name} {priors}", partial(_fit_rendered, clip, provider, context))
            about = {"scene": name, "half": RENDERED.half_of(name), "priors": priors}
            rows.append(about | _named(scores, RENDERED_FIGURES))
    note = (
        "Cameras never used, 5, 10 and 20 degrees off the path; `seen surfaces`: pixels whose surface a frame saw. Constants"
        " are chosen on the choosing half only."
    )
    table = Table("rendered", rows, "Rendered clips, profile quick", timed=("time (s)",), note=note)
    return Findings([table], skipped=skipped)


def render_clips(context: Context, names: Sequence[str], how: Sequence[str] = ()) -> tuple[dict[str, Path], list[str]]:
    """Name -> folder of rendered clips with their truth, and why the others could not be rendered.

    `how`: arguments of the renderer in place of those of the report's size.

    They lie where `rendered-clips` keeps them, for all studies of a report: what one rendered, another takes.
    """
    folder = context.folder.parent / RENDERED_CLIPS / context.choose("quick", "full")
    script = _script("scripts/synthetic_clip.py")
    clips, skipped = {}, []
    for name in names:
        command = [
            str(script),
            str(folder / name),
            "--scene",
            name,
            *(how or context.choose(QUICK_RENDER, FULL_RENDER)),
        ]
        try:
            if not (folder / name / "truth.json").is_file():  # written last
                _run(command)
        except F4xError as error:  # its model is not on this machine
            skipped.append(f"{name}: {error}")
            continue
        clips[name] = folder / name
    return clips, skipped


def measure_blender(context: Context) -> Findings:
    """`tools/bench_blender.py` under this Python's bpy."""
    from importlib.util import find_spec

    if find_spec("bpy") is None:
        raise MissingError("this Python has no bpy; `pip install bpy==4.5.15` brings it to Python 3.11.")
    measured = context.step("bench", partial(_run, [str(_script("tools/bench_blender.py")), "--json"]))
    parts = {
        part: row for part, row in measured.items() if isinstance(row, dict)
    }  # beside them stands Blender's version
    rows = [{"what": part, "figure": n, "value": v} for part, row in parts.items() for n, v in _figures(row).items()]
    skipped = [f"{part}: {row['left_out']}" for part, row in parts.items() if "left_out" in row]
    table = Table("blender", rows, f"Blender {measured['blender']} as a Python module", timed=("value",))
    return Findings([table], skipped=skipped)


def _clips(context: Context) -> list[Path]:
    if context.clips is None:
        raise MissingError("--clips DIR names the folder of real clips, DIR/CLIP/images beside DIR/CLIP/masks.")
    found = sorted(folder.parent for folder in context.clips.glob("*/images"))
    if not found:
        raise MissingError(f"{context.clips} holds no clip (CLIP/images).")
    by_name = {clip.name: clip.resolve() for clip in found}
    return [by_name[name] for name in in_order(by_name, REAL)]


def _fit(clip: Path, profile: str, context: Context) -> Row:
    place = context.folder / f"{clip.name}-{profile}"
    verb = ["fit", str(clip), "-o", str(place), "--profile", profile, "--hold-out", str(HOLD_OUT), "--resume"]
    run_verb([*verb, "--threads", str(context.threads)], context.folder, context.progress)
    measure = ["eval", str(place / "scene.f4x"), "--clip", str(clip), "--refine-camera"]
    if (clip / "joints.json").is_file():
        measure += ["--joints", str(clip / "joints.json"), "--masks", str(clip / "masks")]
    scores = run_verb(measure, context.folder, context.progress)
    kept = json.loads((place / "metrics.json").read_text(encoding="utf-8"))
    scores = kept | scores
    about = run_verb(["info", str(place / "scene.f4x")], context.folder)
    return {column: scores[name] for column, name in SCORES.items() if name in scores} | {
        "nodes": about["nodes"],
        "size (MB)": (place / "scene.f4x").stat().st_size / 1e6,
        "time (s)": sum(kept["seconds"].values()),
    }


def _fitted(context: Context, clip: Path) -> Path:
    scene = context.folder.parent / FITTED / f"{clip.name}-{ASKED}" / "scene.f4x"
    if not scene.is_file():
        raise MissingError(f"{clip.name} is not fitted; run {FITTED} first.")
    return scene


def _ask(clip: Path, scene: Path, word: str, context: Context) -> Row:
    with_field = context.folder / f"{clip.name}.f4x"
    maps = context.folder / "maps" / clip.name
    distil = ["distill", str(scene), "--teacher", TEACHERS, "--clip", str(clip), "--features", str(maps)]
    run_verb([*distil, "-o", str(with_field)], context.folder, context.progress)
    bench = ["bench", "features", "--scene", str(with_field), "--masks", str(clip / "masks"), "--label", word]
    bench += ["--clip", str(clip), "--plain", str(scene)]
    return _measure(bench, context)


def _fit_rendered(clip: Path, provider: str, context: Context) -> Row:
    place = context.folder / f"{clip.name}-{provider}"
    verb = ["fit", str(clip / "images"), "-o", str(place), "--profile", "quick", "--provider", provider, "--resume"]
    fitted = run_verb([*verb, "--threads", str(context.threads)], context.folder, context.progress)
    measure = ["eval", str(place / "scene.f4x"), "--clip", str(clip / "images"), "--truth", str(clip)]
    scores = run_verb(measure, context.folder, context.progress)
    kept = json.loads((place / "metrics.json").read_text(encoding="utf-8"))
    return _figures(scores) | {"Gaussians": fitted["metrics"]["gaussians"], "time (s)": sum(kept["seconds"].values())}


def _measure(verb: Sequence[str], context: Context) -> Row:
    return _figures(run_verb(verb, context.folder, context.progress))


def _figures(measured: dict[str, Any]) -> Row:
    """Return the single numbers of a verb's result."""
    return {name: value for name, value in measured.items() if isinstance(value, (int, float))}


def _named(measured: Row, figures: Mapping[str, str]) -> Row:
    """Return the figures under the names of a reader."""
    last = measured.get("frames", 0) - 1
    return {column: measured.get(name.format(last=last)) for column, name in figures.items()}


def _timed(rows: Sequence[Row]) -> tuple[str, ...]:
    """Columns that hold times or ratios of them."""
    columns = dict.fromkeys(column for row in rows for column in row)
    return tuple(c for c in columns if c.endswith("(s)") or c == "by pictures, of by features")


def _reached(rows: Sequence[Row], prompt: str) -> str:
    """Return a sentence about the clips that miss the goals with a prompt."""
    missed = [
        f"{row['clip']} (IoU {row[f'{prompt}: IoU']:.2f}, leakage {row[f'{prompt}: leakage']:.3f})"
        for row in rows
        if row[f"{prompt}: IoU"] < GOAL_IOU or row[f"{prompt}: leakage"] >= GOAL_LEAKAGE
    ]
    return (
        f"By a {prompt} {len(rows) - len(missed)} of {len(rows)} clips reach IoU {GOAL_IOU} with less than"
        f" {GOAL_LEAKAGE:.0%} leakage{'; not ' + ', '.join(missed) if missed else ''}."
    )


def _script(name: str) -> Path:
    if not (ROOT / name).is_file():
        raise MissingError(f"{name} comes with the source code, not with the package.")
    return ROOT / name


def _run(command: Sequence[str]) -> Any:
    """Last line of a script of ours as JSON, or None; F4xError with its last words where it fails."""
    done = subprocess.run([sys.executable, *command], capture_output=True, text=True, check=False)
    if done.returncode:
        last = "".join(done.stderr.strip().splitlines()[-1:])
        raise F4xError(f"{Path(command[0]).name} ended with {done.returncode}: {last}")
    lines = done.stdout.strip().splitlines()
    try:
        return json.loads(lines[-1]) if lines else None
    except ValueError:
        return None
