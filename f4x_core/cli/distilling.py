"""`f4x distill`, and the features of `f4x fit --features`."""

from __future__ import annotations

import argparse
import os
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any

from ..clip import Clip, read_clip
from ..clip.stream import ClipStream
from ..edit.stack import read_stack, with_stack
from ..errors import F4xError
from ..features.maps import FeatureMaps, read_maps
from ..features.spectrum import WIDTHS
from ..features.teachers import extract
from ..features.text import TEXT_ENCODERS, find_text_encoder
from ..features.weights import require_path
from ..files import link_target, lock_file, neighbour, same_file, user_path
from ..fit.distil import distil
from ..fit.distil_config import DistilConfig
from ..fit.vocabulary import EVERYDAY, with_vocabulary
from ..progress import Progress
from ..scene import Scene, read_header, read_scene, updating, write_scene
from .checks import listed_teachers

PATIENCE = 60.0
"""Seconds to wait for another `f4x distill` of the same scene; adding words takes less."""


def run_distill(args: argparse.Namespace, progress: Progress) -> dict[str, Any]:
    """Add heads or words to a scene, in place or in another file."""
    names = listed_teachers(args.teacher, "--teacher") if args.teacher is not None else []
    labels = read_labels(args.vocabulary) if args.vocabulary is not None else []
    if not names and not labels:
        raise F4xError("there is nothing to do; give --teacher NAME, --vocabulary WORDS, or both.")
    config = config_of(args)
    args.features = args.features or args.scene.parent / "features"
    if args.output is not None and same_file(args.output, args.scene):
        args.scene, args.output = args.output, None  # in place, under the name that is to be written
    with only_distiller(args.output or args.scene):
        return _distill(args, names, labels, config, progress)


def _distill(
    args: argparse.Namespace, names: list[str], labels: list[str], config: DistilConfig, progress: Progress
) -> dict[str, Any]:
    """Read the scene, add heads and words, and write it."""
    scene, arrays = read_with_arrays(args.scene)
    # With --vocabulary only the new words are wanted; --teacher alone learns an existing head again.
    there = [name for name in names if labels and scene.features is not None and name in scene.features.names]
    names = [name for name in names if name not in there]
    if names:
        clip = reel_of_scene(scene, args.clip, args.frames) if args.clip else None
        maps = [maps_of(scene, args.features / name, name, clip, progress) for name in names]
        for encoder in {each.spec.text_encoder for each in maps} - {None} if labels else ():
            require_path(find_text_encoder(encoder).weights)  # before the work, not after it
        scene = distil(scene, maps, config, progress)
    result = write_distilled(scene, args.output or args.scene, None if args.output else arrays, names, labels)
    if there:
        result["text"] += f"\n  {', '.join(there)}: kept as learnt; --teacher without --vocabulary learns anew"
    return result


def distill_into(
    path: Path, source: Path, names: Sequence[str], folder: Path, config: DistilConfig, progress: Progress
) -> dict[str, Any]:
    """Extract the maps of teachers from the scene's clip at `source` into `folder`, and distil them into the file at `path`."""
    with only_distiller(path):
        scene, arrays = read_with_arrays(path)
        clip = reel_of_scene(scene, source, scene.provenance.get("frames"))
        maps = [extract(clip, name, folder / name, progress=progress) for name in names]
        return write_distilled(distil(scene, maps, config, progress), path, arrays, names, [])


@contextmanager
def only_distiller(path: Path) -> Iterator[None]:
    """Keep two `f4x distill` from writing the scene file `path`, each without what the other adds.

    It is held for minutes, so it is no lock of the scene: others edit it meanwhile, and `write_distilled` keeps their edits.
    """
    busy = f"{path}: another `f4x distill` is adding to this scene; try again when it is done."
    with lock_file(neighbour(link_target(path), "distill-lock"), busy, PATIENCE):
        yield


def read_with_arrays(path: Path) -> tuple[Scene, dict[str, Any]]:
    """(scene, what its header says of arrays and features)."""
    with updating(path):  # both of one file
        return read_scene(path), _arrays_of(read_header(path))


def _arrays_of(header: dict[str, Any]) -> dict[str, Any]:
    return {name: header.get(name) for name in ("arrays", "features")}


def with_edits_since(scene: Scene, path: Path, arrays: dict[str, Any]) -> Scene:
    """The scene with the edits that its file has by now; F4xError if others have put other arrays there than it was read with."""
    header = read_header(path)
    if _arrays_of(header) != arrays:
        raise F4xError(
            f"{path}: another program wrote other Gaussians or features into this scene meanwhile, so what was learnt here was"
            " not written; run it again."
        )
    return with_stack(replace(scene, next_id=max(scene.next_id, header["next_id"])), read_stack(path))


def write_distilled(
    scene: Scene, path: Path, arrays: dict[str, Any] | None, names: Sequence[str], labels: Sequence[str]
) -> dict[str, Any]:
    """Add the vocabulary, write the scene to `path` and return the result of the verb.

    `arrays` is what `read_with_arrays` found where the scene was read from `path`: edits that others put into the file
    meanwhile stay. None: the scene is from another file. A new head with a text encoder also gets a vocabulary of everyday
    words if that encoder is installed.
    """
    field = scene.require_field()
    new = sorted({encoder for name in names if (encoder := field.spec(name).text_encoder)} - field.vocabularies.keys())
    here = [name for name in new if name in TEXT_ENCODERS and TEXT_ENCODERS[name].here]
    scene = with_vocabulary(scene, EVERYDAY, encoders=here) if here else scene
    scene = with_vocabulary(scene, labels) if labels else scene
    wordless = [name for name in new if name not in here and not labels]
    assert scene.features is not None
    with updating(path):
        write_scene(scene if arrays is None else with_edits_since(scene, path, arrays), path)
    field, megabytes = scene.features, scene.info()["megabytes"]
    heads = {head.spec.name: dict(head.report) for head in field.heads}
    fraction = megabytes["features"] / max(sum(megabytes.values()) - megabytes["features"], 1e-9)
    lines = [f"{path}: latent of {field.width} channels, +{megabytes['features']:.1f} MB ({fraction:.0%} of the rest)"]
    lines += [f"  {name}: {_head_line(report)}" for name, report in heads.items()]
    lines += [f"  {encoder}: {len(words.labels)} labels" for encoder, words in field.vocabularies.items()]
    lines += [
        f"  {encoder}: no labels, that text encoder is not here; later `f4x distill {path} --vocabulary WORDS`"
        for encoder in wordless
    ]
    return {
        "scene": str(path),
        "width": field.width,
        "heads": heads,
        "vocabularies": {encoder: list(words.labels) for encoder, words in field.vocabularies.items()},
        "megabytes": megabytes,
        "text": "\n".join(lines),
    }


def config_of(args: argparse.Namespace) -> DistilConfig:
    """The settings that the arguments give."""
    width = None
    if args.latent_width != "auto":
        if args.latent_width not in map(str, WIDTHS):
            raise F4xError(f"--width {args.latent_width}: give auto, {', '.join(map(str, WIDTHS))}.")
        width = int(args.latent_width)
    if args.steps < 1:
        raise F4xError(f"--steps {args.steps}: give at least 1.")
    return DistilConfig(width=width, steps=args.steps, seed=args.seed, threads=args.threads, backend=args.backend)


def reel_of_scene(scene: Scene, source: Path, frames: str | None) -> ClipStream:
    """The frames that a scene was fitted to, at the scene's size, read on demand."""
    cameras = scene.cameras
    return ClipStream(source, frames, cameras.width, cameras.height, len(cameras))


def clip_of_scene(scene: Scene, source: Path, frames: str | None, progress: Progress) -> Clip:
    """The clip that a scene was fitted to, at the scene's size."""
    clip = read_clip(source, frames, scene.cameras.width, progress=progress)
    cameras = scene.cameras
    if len(clip) != len(cameras) or (clip.width, clip.height) != (cameras.width, cameras.height):
        raise F4xError(
            f"{source}: the clip has {len(clip)} frames of {clip.width}x{clip.height}, the scene {len(cameras)} of"
            f" {cameras.width}x{cameras.height}; give the clip that it was fitted to, with the same --frames."
        )
    return clip


def maps_of(scene: Scene, folder: Path, name: str, clip: Clip | ClipStream | None, progress: Progress) -> FeatureMaps:
    """The feature maps in `folder`. Missing ones are extracted from `clip`, or from the clip that the scene names."""
    if clip is None and (folder / "spec.json").is_file():
        return read_maps(folder)
    if clip is None:
        source = scene.provenance.get("source")
        if not source or not Path(source).exists():
            raise F4xError(
                f"{folder} holds no feature maps and the scene's clip is not at {source}; give --clip CLIP, or --features"
                " DIR with the maps."
            )
        clip = reel_of_scene(scene, Path(source), scene.provenance.get("frames") or None)
    return extract(clip, name, folder, progress=progress)


def read_labels(text: str) -> list[str]:
    """Labels of a file with one per line, or of a list with commas."""
    path = user_path(text)
    is_file = os.path.isfile(path)  # False for a list of words that is longer than a name may be
    if not is_file and (path.suffix.lower() in (".txt", ".csv") or len(path.parts) > 1):
        raise F4xError(f"--vocabulary {text}: there is no such file; check the path, or write words with commas.")
    try:
        words = path.read_text(encoding="utf-8").splitlines() if is_file else text.split(",")
    except (OSError, UnicodeDecodeError) as error:
        raise F4xError(
            f"--vocabulary {text}: cannot be read ({error}); give a text file with one label per line."
        ) from error
    found = [word.strip() for word in words if word.strip()]
    if not found:
        raise F4xError(
            f"--vocabulary {text}: has no label; write words with commas, or a file with one label per line."
        )
    return found


def _head_line(report: dict[str, Any]) -> str:
    parts = [
        f"{title} relative error {report[group]['relative_error']:.1%}, cosine {report[group]['cosine']:.3f}"
        for group, title in (("used", "used frames"), ("held_out", "held-out frames"))
        if group in report
    ]
    if "drift" in report:
        parts.append(f"moved by {report['drift']:.1%} when the last head was added")
    return "; ".join(parts) or "not seen by any camera"
