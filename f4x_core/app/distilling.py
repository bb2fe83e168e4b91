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
    request = replace(request, path=path, output=output)
    with only_run("distill", output or path):
        return _distill(request, progress)


def _distill(request: DistilRequest, progress: Progress) -> Distilled:
    """Read the scene, add heads and words, and write it."""
    opened = OpenScene.read(request.path)
    scene, labels, learnt = opened.scene, request.labels, opened.scene.features
    # With a vocabulary only the new words are wanted; teachers alone are learnt again.
    kept = tuple(name for name in request.teachers if labels and learnt is not None and name in learnt.names)
    names = [name for name in request.teachers if name not in kept]
    if names:
        clip = stream_of_scene(scene, request.clip, request.frames) if request.clip else None
        folder = request.folder or request.path.parent / "features"
        maps = [maps_of(scene, folder / name, name, clip, progress) for name in names]
        for encoder in {each.spec.text_encoder for each in maps} - {None} if labels else ():
            require_path(find_text_encoder(encoder).weights)  # before the work, not after it
        scene = distil(scene, maps, request.config, progress)
    scene, wordless = with_words(scene, names, labels)
    if request.output is None:
        opened.write(scene)
    else:
        with updating(request.output):
            write_scene(scene, request.output)
    return _summary(scene, request.output or request.path, wordless, kept)


def _summary(scene: Scene, path: Path, wordless: tuple[str, ...], kept: tuple[str, ...]) -> Distilled:
    learnt = scene.require_field()
    heads = {head.spec.name: dict(head.report) for head in learnt.heads}
    words = {encoder: tuple(each.labels) for encoder, each in learnt.vocabularies.items()}
    return Distilled(path, learnt.width, heads, words, scene.info()["megabytes"], wordless, kept)


@dataclass(frozen=True)
class OpenScene:
    """A scene file as it was read, to be written over with the edits that others put into it meanwhile."""

    path: Path
    """The scene file."""
    scene: Scene
    """The scene as it was read."""
    arrays: Mapping[str, Any]
    """Arrays and features in the header as it was read."""

    @classmethod
    def read(cls, path: Path) -> OpenScene:
        """Read scene and header of one state of the file."""
        with updating(path):
            return cls(path, read_scene(path), _arrays_of(path))

    def write(self, scene: Scene) -> None:
        """Write `scene` over the file, with its edits of now; F4xError if the file got other arrays since it was read."""
        with updating(self.path):
            if _arrays_of(self.path) != self.arrays:
                raise F4xError(
                    f"{self.path}: another program wrote other Gaussians or features into this scene meanwhile, so what was"
                    " learnt here was not written; run it again."
                )
            next_id = max(scene.next_id, read_header(self.path)["next_id"])
            write_scene(with_stack(replace(scene, next_id=next_id), read_stack(self.path)), self.path)


def _arrays_of(path: Path) -> dict[str, Any]:
    header = read_header(path)
    return {name: header.get(name) for name in ("arrays", "features")}


def with_words(scene: Scene, heads: Sequence[str], labels: Sequence[str]) -> tuple[Scene, tuple[str, ...]]:
    """Return the scene with `labels`, and everyday words for new `heads` whose text encoders are installed; and the other encoders.

    Encoders that get labels are none of the others.
    """
    known = scene.require_field()
    new = sorted({encoder for name in heads if (encoder := known.spec(name).text_encoder)} - known.vocabularies.keys())
    here = [name for name in new if name in TEXT_ENCODERS and TEXT_ENCODERS[name].here]
    scene = with_vocabulary(scene, EVERYDAY, encoders=here) if here else scene
    scene = with_vocabulary(scene, labels) if labels else scene
    return scene, tuple(name for name in new if name not in here and not labels)


def stream_of_scene(scene: Scene, source: Path, frames: str | None) -> ClipStream:
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
        clip = stream_of_scene(scene, Path(source), None)
    return extract(clip, name, folder, progress=progress)
