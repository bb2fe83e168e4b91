"""Features and words of a scene file: maps of teachers are extracted from its clip and distilled into it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from ..clip import Clip, read_clip
from ..clip.stream import ClipStream
from ..edit.stack import read_stack, with_stack
from ..errors import F4xError
from ..features.maps import FeatureMaps, read_maps
from ..features.teachers import extract
from ..features.text import TEXT_ENCODERS, find_text_encoder
from ..features.weights import require_path
from ..files import in_place
from ..fit.distil import distil
from ..fit.distil_config import DistilConfig
from ..fit.vocabulary import EVERYDAY, with_vocabulary
from ..progress import Progress, silent
from ..scene import Scene, read_header, read_scene, updating, write_scene
from ..scene.locking import only_run


@dataclass(frozen=True)
class DistilRequest:
    """The features that are added to a scene file, and their source."""

    path: Path
    """The scene file."""
    teachers: tuple[str, ...] = ()
    """Teachers whose features are learnt."""
    labels: tuple[str, ...] = ()
    """Words that the scene learns."""
    folder: Path | None = None
    """Folder of feature maps, one folder in it for each teacher; None: `features` beside the scene."""
    clip: Path | None = None
    """The clip of the scene, where it is not where it was fitted from."""
    frames: str | None = None
    """Frames of the clip; None: those that the scene was fitted to."""
    output: Path | None = None
    """Another scene file to write; None: the scene itself."""
    config: DistilConfig = field(default_factory=DistilConfig)
    """Settings of the distillation."""


@dataclass(frozen=True)
class Distilled:
    """A scene file that has got features or words."""

    path: Path
    """The scene file."""
    width: int
    """Channels of the latent."""
    heads: Mapping[str, Mapping[str, Any]]
    """Teacher -> how well its features are met."""
    vocabularies: Mapping[str, tuple[str, ...]]
    """Text encoder -> the words that the scene knows by it."""
    megabytes: Mapping[str, float]
    """Sizes of the parts of the file."""
    wordless: tuple[str, ...] = ()
    """Text encoders of new heads that are not on this machine, so that these heads know no words yet."""
    kept: tuple[str, ...] = ()
    """Heads that were there and stay as they were learnt, since only words were added."""


def distill(request: DistilRequest, progress: Progress = silent) -> Distilled:
    """Add heads or words to a scene, in place or in another file, as `f4x distill` does."""
    path, output = in_place(request.path, request.output)
    request = replace(request, path=path, output=output, folder=request.folder or request.path.parent / "features")
    with only_run("distill", output or path):
        return _distill(request, progress)


def _distill(request: DistilRequest, progress: Progress) -> Distilled:
    """Read the scene, add heads and words, and write it."""
    scene, arrays = read_with_arrays(request.path)
    labels = request.labels
    # With a vocabulary only the new words are wanted; teachers alone are learnt again.
    kept = tuple(
        name for name in request.teachers if labels and scene.features is not None and name in scene.features.names
    )
    names = [name for name in request.teachers if name not in kept]
    if names:
        clip = reel_of_scene(scene, request.clip, request.frames) if request.clip else None
        assert request.folder is not None
        maps = [maps_of(scene, request.folder / name, name, clip, progress) for name in names]
        for encoder in {each.spec.text_encoder for each in maps} - {None} if labels else ():
            require_path(find_text_encoder(encoder).weights)  # before the work, not after it
        scene = distil(scene, maps, request.config, progress)
    written = request.output or request.path
    return replace(write_distilled(scene, written, None if request.output else arrays, names, labels), kept=kept)


def read_with_arrays(path: Path) -> tuple[Scene, dict[str, Any]]:
    """Return (scene, what its header says of arrays and features)."""
    with updating(path):  # both of one file
        return read_scene(path), _arrays_of(read_header(path))


def _arrays_of(header: dict[str, Any]) -> dict[str, Any]:
    return {name: header.get(name) for name in ("arrays", "features")}


def with_edits_since(scene: Scene, path: Path, arrays: dict[str, Any]) -> Scene:
    """Return the scene with the edits that its file has by now; F4xError if the file got other arrays since it was read."""
    header = read_header(path)
    if _arrays_of(header) != arrays:
        raise F4xError(
            f"{path}: another program wrote other Gaussians or features into this scene meanwhile, so what was learnt here was"
            " not written; run it again."
        )
    return with_stack(replace(scene, next_id=max(scene.next_id, header["next_id"])), read_stack(path))


def write_distilled(
    scene: Scene, path: Path, arrays: dict[str, Any] | None, names: Sequence[str], labels: Sequence[str]
) -> Distilled:
    """Add the vocabulary and write the scene to `path`.

    `arrays` is what `read_with_arrays` found where the scene was read from `path`: edits that others put into the file
    meanwhile stay. None: the scene is from another file. A new head with a text encoder also gets a vocabulary of everyday
    words if that encoder is installed.
    """
    known = scene.require_field()
    new = sorted({encoder for name in names if (encoder := known.spec(name).text_encoder)} - known.vocabularies.keys())
    here = [name for name in new if name in TEXT_ENCODERS and TEXT_ENCODERS[name].here]
    scene = with_vocabulary(scene, EVERYDAY, encoders=here) if here else scene
    scene = with_vocabulary(scene, labels) if labels else scene
    wordless = tuple(name for name in new if name not in here and not labels)
    assert scene.features is not None
    with updating(path):
        write_scene(scene if arrays is None else with_edits_since(scene, path, arrays), path)
    learnt = scene.features
    heads = {head.spec.name: dict(head.report) for head in learnt.heads}
    words = {encoder: tuple(each.labels) for encoder, each in learnt.vocabularies.items()}
    return Distilled(path, learnt.width, heads, words, scene.info()["megabytes"], wordless)


def reel_of_scene(scene: Scene, source: Path, frames: str | None) -> ClipStream:
    """Return the frames that a scene was fitted to, at the scene's size, read on demand; `frames` in place of those it names."""
    cameras = scene.cameras
    return ClipStream(source, frames or scene.fitted_frames, cameras.width, cameras.height, len(cameras))


def clip_of_scene(scene: Scene, source: Path, frames: str | None, progress: Progress) -> Clip:
    """Return the clip that a scene was fitted to, at the scene's size; `frames` in place of those it names."""
    clip = read_clip(source, frames or scene.fitted_frames, scene.cameras.width, progress=progress)
    cameras = scene.cameras
    if len(clip) != len(cameras) or (clip.width, clip.height) != (cameras.width, cameras.height):
        raise F4xError(
            f"{source}: the clip has {len(clip)} frames of {clip.width}x{clip.height}, the scene {len(cameras)} of"
            f" {cameras.width}x{cameras.height}; give the clip that it was fitted to, with the same --frames."
        )
    return clip


def maps_of(scene: Scene, folder: Path, name: str, clip: Clip | ClipStream | None, progress: Progress) -> FeatureMaps:
    """Return the feature maps in `folder`. Missing ones are extracted from `clip`, or from the clip that the scene names."""
    if clip is None and (folder / "spec.json").is_file():
        return read_maps(folder)
    if clip is None:
        source = scene.provenance.get("source")
        if not source or not Path(source).exists():
            raise F4xError(
                f"{folder} holds no feature maps and the scene's clip is not at {source}; give --clip CLIP, or --features"
                " DIR with the maps."
            )
        clip = reel_of_scene(scene, Path(source), None)
    return extract(clip, name, folder, progress=progress)
