"""Pictures of a scene along a camera path: channels as PNG, all passes as EXR, videos."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ..clip.images import as_bytes, even_height
from ..clip.read import frame_indices
from ..clip.video import write_video
from ..edit.naming import by_words
from ..errors import F4xError
from ..files import replace_file
from ..geometry.camera import Camera
from ..geometry.trajectory import Trajectory
from ..progress import Progress, silent
from ..query.matte import matte_image
from ..query.selection import Selection
from ..query.unseen import unseen_image
from ..scene import Scene
from ..scene.believed import BelievedZone
from ..scene.clouds import COVERED
from ..scene.view import render
from ..scene.visualise import colour_depth, colour_motion, depth_range
from .encoding import encoder
from .paths import times_of, trajectory_of
from .render_options import MASK, RenderOptions, mask_labels

CHANNELS = ("rgb", "depth", "alpha", "motion")
UNSEEN = "unseen"
"""The channel of what no frame of the clip saw, and of where nothing is."""
# Motion of this fraction of the image width per frame gets the full colour.
FULL_MOTION = 0.02
WIDTHS = (16, 16384)
"""Least and greatest width of a picture in pixels."""


@dataclass(frozen=True)
class Rendered:
    """Pictures that were written."""

    folder: Path
    """The pictures' files, in a folder for each channel."""
    frames: int
    """Number of pictures of each channel."""
    of_all: int
    """Frames that were chosen before they were parted."""
    films: tuple[str, ...] = ()
    """Names of the videos."""
    black: tuple[str, ...] = ()
    """Channels `mask:LABEL` of labels that nothing in the scene answers to."""
    beyond: str = ""
    """Sentence about frames from farther aside than the scene can be believed; nothing where there are none."""


def render_path(scene: Scene, folder: Path | str, options: RenderOptions, progress: Progress = silent) -> Rendered:
    """Write `folder/CHANNEL/00000.png` … along a path, as `f4x render` does; depth and motion also as .npy.

    Raises:
        F4xError: options that are not possible, or a word that nobody knows.
    """
    folder = Path(folder)
    if options.exr or options.motion_blur or options.aperture:
        return _render_exposed(scene, folder, options, progress)
    chosen = _ChosenViews.of(scene, options)
    channels = _Channels.of(scene, options, chosen.views[0].camera.width, progress)
    folders = {name: folder / file_name(name) for name in options.channels}
    for place in folders.values():
        place.mkdir(parents=True, exist_ok=True)
    videos: dict[str, list[np.ndarray]] = {name: [] for name in options.channels}
    count = len(chosen.indices)
    for done, index in enumerate(chosen.indices):
        progress("render", done, count)
        maps, images = channels.draw(*chosen.views[index])
        try:
            write_frame(folders, index, maps, images)
        except F4xError as error:
            raise F4xError(f"{error}; {done} of {count} frames were written completely.") from error
        if options.video:
            for name, image in images.items():
                videos[name].append(image)
    progress("render", count, count)
    films = tuple(f"{file_name(name)}.mp4" for name, frames in videos.items() if frames)
    for film, frames in zip(films, filter(None, videos.values()), strict=True):
        write_video(folder / film, np.stack(frames), scene.fps, times_of(scene, options.path, chosen.indices))
    black = tuple(name for name, mask in channels.masks.items() if not mask.chosen.any())
    return Rendered(folder, count, chosen.of_all, films, black, chosen.beyond(scene))


@dataclass(frozen=True)
class _Channels:
    """The channels of a scene that become 8-bit images."""

    scene: Scene
    names: tuple[str, ...]
    masks: Mapping[str, Selection]
    """Channel `mask:LABEL` -> the Gaussians that the label means."""
    depth: tuple[float, float]
    """Depths in world units of the first and the last color of depth."""
    full_motion: float
    """Pixels of motion per frame that get the full color."""
    backend: str

    @classmethod
    def of(cls, scene: Scene, options: RenderOptions, width: int, progress: Progress) -> _Channels:
        """Return the channels of the options, for images `width` pixels wide. F4xError for one that there is not."""
        labels, names, backend = mask_labels(options.channels), options.channels, options.backend
        _refuse_unknown(scene, [name for name in names if name not in labels])
        masks = {name: by_words(scene, [label], encode=encoder(progress))[label] for name, label in labels.items()}
        depth = depth_span(scene, backend) if "depth" in names else (0.0, 1.0)
        return cls(scene, names, masks, depth, FULL_MOTION * width, backend)

    def draw(self, camera: Camera, time: float) -> tuple[dict[str, np.ndarray], dict[str, np.ndarray]]:
        """Return the maps of `view.render` at a clip time, and the image of every channel."""
        plain = [name for name in self.names if name in CHANNELS]
        matte = [name for name in self.names if name in self.masks or name == UNSEEN]
        featured = [] if len(plain) + len(matte) == len(self.names) else ["latent", "alpha"]
        maps = render(self.scene, camera, time, channels=[*plain, *featured], backend=self.backend)
        images = {}
        for name in self.names:
            if name in plain:
                images[name] = channel_image(name, maps[name], self.depth, self.full_motion)
            elif name in matte:
                images[name] = as_bytes(self._matte(name, camera, time))
            else:
                images[name] = feature_image(self.scene, name, maps["latent"], maps["alpha"])
        return maps, images

    def _matte(self, name: str, camera: Camera, time: float) -> np.ndarray:
        """Return (H,W) of the channel `unseen`, or of a label's mask."""
        if name == UNSEEN:
            return unseen_image(self.scene, camera, time, self.backend)
        return matte_image(self.scene, self.masks[name], camera, time, self.backend)


def _refuse_unknown(scene: Scene, channels: Sequence[str]) -> None:
    """Raise F4xError for a channel that cannot be written as pictures; it says how to get one that exists."""
    from . import exposing

    known = (*CHANNELS, UNSEEN, *feature_channels(scene))
    for name in channels:
        if name not in known:
            message = f"there is no channel {name}; choose from {','.join(known)},{MASK}LABEL"
            if name in (*exposing.PASSES, exposing.CRYPTOMATTE):
                message = f"{name} holds numbers that only EXR files can; add --exr"
            raise F4xError(f"--channels {','.join(channels)}: {message}.")


@dataclass(frozen=True)
class _ChosenViews:
    """The views of a camera path that are drawn."""

    views: Trajectory
    """All views of `--path`, `--width` wide."""
    of_all: int
    """Number of the views that `--frames` chooses."""
    indices: np.ndarray
    """Those of them in `--part`."""

    @classmethod
    def of(cls, scene: Scene, options: RenderOptions) -> _ChosenViews:
        """Return the views that the options choose; F4xError for sizes that are not possible."""
        if not 0 < options.degrees < 90:
            raise F4xError(f"--degrees {options.degrees:g}: give a number above 0 and below 90.")
        views = trajectory_of(scene, options.path, options.degrees)
        if options.width is not None:
            if not WIDTHS[0] <= options.width <= WIDTHS[1]:
                raise F4xError(f"--width {options.width}: give a number of pixels from {WIDTHS[0]} to {WIDTHS[1]}.")
            height = even_height(views[0].camera.width, views[0].camera.height, options.width)
            views = [view._replace(camera=view.camera.resized(options.width, height)) for view in views]
        chosen = frame_indices(options.frames, len(views), f"--path {options.path}")
        return cls(views, len(chosen), chosen[part_of(len(chosen), options.part, options.video)])

    def beyond(self, scene: Scene) -> str:
        """Return the sentence about views from farther aside than the scene can be believed; nothing without any."""
        zone = BelievedZone.of(scene)
        if zone is None:
            return ""
        aside = [zone.aside(self.views[index].camera.center) for index in self.indices]
        beyond = [degrees for degrees in aside if degrees > zone.degrees]
        return f"{len(beyond)} of {len(aside)} frames are from up to {zone.line(max(beyond))}" if beyond else ""


def _render_exposed(scene: Scene, folder: Path, options: RenderOptions, progress: Progress) -> Rendered:
    """Write `folder/00000.exr` … with all passes of a frame, or with motion blur and depth of field `folder/rgb/00000.png` …."""
    from . import exposing

    names = exposing.passes_of(options.channels, options.exr)
    mattes = exposing.Mattes.of(scene, options.channels)
    exposure = exposing.exposure_of(options)
    chosen = _ChosenViews.of(scene, options)
    path = exposing.ExposedPath(scene, chosen.views, exposure, names, mattes, options.backend)
    for name in () if options.exr else ("rgb", *names):
        (folder / name).mkdir(parents=True, exist_ok=True)
    folder.mkdir(parents=True, exist_ok=True)
    videos, count = [], len(chosen.indices)
    for done, index in enumerate(chosen.indices):
        progress("render", done, count)
        images = path.images(int(index))
        picture = exposing.display(images["combined"])
        if options.exr:
            exposing.write(folder / f"{index:05d}.exr", images, mattes)
        else:
            maps = {"rgb": picture, "alpha": as_bytes(images["alpha"])}
            write_frame({name: folder / name for name in ("rgb", *names)}, int(index), {}, maps)
        if options.video:
            videos.append(picture)
    progress("render", count, count)
    if videos:
        write_video(folder / "rgb.mp4", np.stack(videos), scene.fps, times_of(scene, options.path, chosen.indices))
    return Rendered(folder, count, chosen.of_all, beyond=chosen.beyond(scene))


def part_of(count: int, part: str | None, video: bool = False) -> range:
    """Return the indices of `count` views that `--part I/N` selects: every view is in one part, and parts differ by at most one."""
    if part is None:
        return range(count)
    if video:
        raise F4xError("--video needs every frame; leave out --part.")
    which, _, parts = part.partition("/")
    if not (which.isdecimal() and parts.isdecimal() and 1 <= int(which) <= int(parts)):
        raise F4xError(f"--part {part}: write I/N with I from 1 to N, for example 2/4.")
    return range(count * (int(which) - 1) // int(parts), count * int(which) // int(parts))


def file_name(channel: str) -> str:
    """Return the channel's name as a file name: characters such as those in `mask:polar bear` become _."""
    return re.sub(r"[^\w.-]", "_", channel)


def write_frame(
    folders: Mapping[str, Path], index: int, maps: Mapping[str, np.ndarray], images: Mapping[str, np.ndarray]
) -> None:
    """Write the images of one frame, and arrays of depth and motion: all of the files or none."""
    from PIL import Image  # Blender has none

    written: list[Path] = []
    try:
        for name, folder in folders.items():
            written.append(folder / f"{index:05d}.png")
            with replace_file(written[-1]) as file:
                Image.fromarray(images[name]).save(file, "PNG")
            if name in ("depth", "motion"):
                written.append(folder / f"{index:05d}.npy")
                with replace_file(written[-1]) as file:
                    np.save(file, maps[name].astype(np.float32))
    except BaseException:
        for path in written:
            path.unlink(missing_ok=True)
        raise


def depth_span(scene: Scene, backend: str = "auto") -> tuple[float, float]:
    """Return (near, far) depth in world units for the colours of the depth images; one range for the whole clip."""
    middle = len(scene.cameras) // 2
    depth = render(scene, scene.cameras[middle], float(scene.cameras.times[middle]), ("depth",), backend)["depth"]
    return depth_range([depth])


def channel_image(channel: str, values: np.ndarray, span: tuple[float, float], full_motion: float) -> np.ndarray:
    """Return an 8-bit image (H,W,3) or (H,W) of a channel; `span`: range of depth, `full_motion`: pixels with the full colour."""
    if channel == "depth":
        return colour_depth(values, *span)
    if channel == "motion":
        return colour_motion(values, full_motion)
    return as_bytes(values)


def feature_channels(scene: Scene) -> tuple[str, ...]:
    """Return the channels that show the feature field of `scene`: the latent and every head."""
    return () if scene.features is None else ("latent", *scene.features.names)


def feature_image(scene: Scene, name: str, latent: np.ndarray, alpha: np.ndarray) -> np.ndarray:
    """Return an image (H,W,3) uint8 of the latent, or of features that a head decodes from `latent (H,W,D)`; empty is black."""
    field = scene.require_field()
    if name != "latent":
        image = field.head(name).to_rgb(latent)
    elif field.pca is not None:
        image = field.pca.to_rgb(latent)
    else:
        raise F4xError(f"{scene.name}: the latent has no colours; distil a teacher again.")
    return image * (alpha >= COVERED)[..., None]
