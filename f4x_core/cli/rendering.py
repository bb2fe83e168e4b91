"""`f4x render` and `f4x export`."""

from __future__ import annotations

import argparse
import os
import re
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image

from ..clip.images import even_height
from ..clip.read import frame_indices
from ..clip.video import write_video
from ..edit.apply import open_scene
from ..edit.naming import by_words
from ..errors import F4xError
from ..files import replace_file
from ..geometry import trajectory
from ..geometry.trajectory import Trajectory
from ..language.lexicon import plural
from ..progress import Progress
from ..query.pixels import coverage_image
from ..query.unseen import unseen_image
from ..scene import Scene
from ..scene.foreign import notes_of, open_any
from ..scene.formats import choose_format, export
from ..scene.posing import require_time
from ..scene.recognise import identify
from ..scene.view import COVERED, render
from ..scene.visualise import colour_depth, colour_motion, depth_range
from .encoding import encoder

CHANNELS = ("rgb", "depth", "alpha", "motion")
UNSEEN = "unseen"
"""The channel of what no frame of the clip saw, and of where nothing is."""
MASK = "mask:"
"""Prefix of the channel `mask:LABEL`: the fraction of each pixel's blend weight that comes from the Gaussians of a label."""
# Motion of this fraction of the image width per frame gets the full colour.
FULL_MOTION = 0.02
NUMBERED = {
    "frozen": "frozen:T with T a clip frame, for example frozen:12",
    "bullet": "bullet:T with T a clip frame, for example bullet:12",
    "slow": "slow:FACTOR, for example slow:4",
}
"""Paths with a number -> how to write them."""
WIDTHS = (16, 16384)
"""Least and greatest width of a picture in pixels."""
MAX_SLOWER = 100
"""Slower than this is a still."""


def trajectory_of(scene: Scene, path: str, degrees: float) -> Trajectory:
    """The views that `--path` names."""
    cameras = scene.cameras
    if path == "original":
        return trajectory.original(cameras)
    if path == "orbit":
        return trajectory.orbit(cameras, degrees=degrees)
    if path == "stabilise":
        return trajectory.stabilised(cameras)
    kind, colon, number = path.partition(":")
    if colon and kind in NUMBERED and not os.path.isfile(path):
        try:
            value = float(number)
        except ValueError as error:
            raise F4xError(f"--path {path}: write {NUMBERED[kind]}.") from error
        if kind in ("frozen", "bullet"):
            require_time(scene, value, f"--path {path}")
        if kind == "bullet":
            return trajectory.bullet_time(cameras, value, degrees)
        if kind == "slow":
            if not 1 <= value <= MAX_SLOWER:
                raise F4xError(f"--path {path}: give a factor from 1 to {MAX_SLOWER}.")
            return trajectory.slow_motion(cameras, value)
        return trajectory.frozen(cameras, value)
    if not os.path.isfile(path):
        raise F4xError(
            f"--path {path}: there is no such file; give original, orbit, stabilise, slow:FACTOR, bullet:T or frozen:T"
            f" with T a clip frame (0 to {len(cameras) - 1}), or a camera path file."
        )
    return trajectory.read_path(path)


def times_of(scene: Scene, path: str, indices: np.ndarray | None = None) -> np.ndarray | None:
    """When a video shows the views of `--path`, or those at `indices`: `write_video`'s `times`.

    Those of the clip on its own path, if its frames are not evenly spaced; None otherwise.
    """
    if path != "original" or scene.cameras.steady:
        return None
    return scene.cameras.times if indices is None else scene.cameras.times[indices]


def run_render(args: argparse.Namespace, progress: Progress) -> dict[str, Any]:
    """Write OUT/CHANNEL/00000.png … along a path; depth and motion also as .npy."""
    scene = open_scene(args.scene, args.edits)
    if args.exr or args.motion_blur or args.aperture:
        return run_shots(args, scene, progress)
    channels = tuple(args.channels.split(","))
    labels = {name: name.removeprefix(MASK) for name in channels if name.startswith(MASK)}
    _refuse_unknown(scene, [name for name in channels if name not in labels])
    masks = {name: by_words(scene, [label], encode=encoder(progress))[label] for name, label in labels.items()}
    mattes: dict[str, Callable[..., np.ndarray]] = {
        name: partial(coverage_image, scene, mask) for name, mask in masks.items()
    }
    if UNSEEN in channels:
        mattes[UNSEEN] = partial(unseen_image, scene)
    views, chosen, indices = views_of(args, scene)
    folders = {name: Path(args.output) / file_name(name) for name in channels}
    for folder in folders.values():
        folder.mkdir(parents=True, exist_ok=True)
    span = depth_span(scene, args.backend) if "depth" in channels else (0.0, 1.0)
    full_motion = FULL_MOTION * views[0].camera.width
    videos: dict[str, list[np.ndarray]] = {name: [] for name in channels}
    for done, index in enumerate(indices):
        progress("render", done, len(indices))
        camera, time = views[index]
        plain = [name for name in channels if name in CHANNELS]
        wanted = plain if len(plain) + len(mattes) == len(channels) else [*plain, "latent", "alpha"]
        maps = render(scene, camera, time, channels=wanted, backend=args.backend)
        images = {
            name: channel_image(name, maps[name], span, full_motion)
            if name in plain
            else channel_image(name, mattes[name](camera, time, args.backend), span, full_motion)
            if name in mattes
            else feature_image(scene, name, maps["latent"], maps["alpha"])
            for name in channels
        }
        try:
            write_frame(folders, index, maps, images)
        except F4xError as error:
            raise F4xError(f"{error}; {done} of {len(indices)} frames were written completely.") from error
        if args.video:
            for name, image in images.items():
                videos[name].append(image)
    progress("render", len(indices), len(indices))
    films = [f"{file_name(name)}.mp4" for name, frames in videos.items() if frames]
    for film, frames in zip(films, filter(None, videos.values()), strict=True):
        write_video(Path(args.output) / film, np.stack(frames), scene.fps, times_of(scene, args.path, indices))
    text = ", ".join([f"{args.output}: {_frames(indices)}", *films])
    if len(indices) == 0:
        text += f"; {len(chosen)} frames in {args.part.split('/')[1]} parts leave nothing for --part {args.part}"
    result: dict[str, Any] = {"frames": len(indices), "output": str(args.output)}
    black = [name for name, mask in masks.items() if not mask.chosen.any()]
    if black:
        result["note"] = f"nothing in the scene answers to {', '.join(black)}: black pictures"
        text += f"; {result['note']}"
    return {**result, "text": text}


def _refuse_unknown(scene: Scene, channels: Sequence[str]) -> None:
    """F4xError for a channel of which no pictures can be written, and where there is one of that name, how to have it."""
    from . import shots

    known = (*CHANNELS, UNSEEN, *feature_channels(scene))
    for name in channels:
        if name not in known:
            message = f"there is no channel {name}; choose from {','.join(known)},{MASK}LABEL"
            if name in (*shots.PASSES, shots.CRYPTOMATTE):
                message = f"{name} holds numbers that only EXR files can; add --exr"
            raise F4xError(f"--channels {','.join(channels)}: {message}.")


def _frames(indices: np.ndarray) -> str:
    return f"{len(indices)} {plural('frame', len(indices))}"


def views_of(args: argparse.Namespace, scene: Scene) -> tuple[Trajectory, np.ndarray, np.ndarray]:
    """(all views of `--path`, `--width` wide, indices that `--frames` chooses, those of them in `--part`)."""
    if not 0 < args.degrees < 90:
        raise F4xError(f"--degrees {args.degrees:g}: give a number above 0 and below 90.")
    views = trajectory_of(scene, args.path, args.degrees)
    if args.width is not None:
        if not WIDTHS[0] <= args.width <= WIDTHS[1]:
            raise F4xError(f"--width {args.width}: give a number of pixels from {WIDTHS[0]} to {WIDTHS[1]}.")
        height = even_height(views[0].camera.width, views[0].camera.height, args.width)
        views = [view._replace(camera=view.camera.resized(args.width, height)) for view in views]
    chosen = frame_indices(args.frames, len(views), f"--path {args.path}")
    return views, chosen, chosen[part_of(len(chosen), args.part, args.video)]


def run_shots(args: argparse.Namespace, scene: Scene, progress: Progress) -> dict[str, Any]:
    """Write OUT/00000.exr … with all passes of a frame, or with motion blur and depth of field OUT/rgb/00000.png …."""
    from . import shots

    names = shots.passes_of(args.channels.split(","), args.exr)
    mattes = shots.Mattes.of(scene, args.channels.split(","))
    exposure = shots.exposure_of(args)
    views, _, indices = views_of(args, scene)
    output = Path(args.output)
    for name in () if args.exr else ("rgb", *names):
        (output / name).mkdir(parents=True, exist_ok=True)
    output.mkdir(parents=True, exist_ok=True)
    videos = []
    for done, index in enumerate(indices):
        progress("render", done, len(indices))
        images = shots.take(scene, views, int(index), exposure, (names, mattes, args.backend))
        picture = shots.display(images["combined"])
        if args.exr:
            shots.write(output / f"{index:05d}.exr", images, mattes)
        else:
            maps = {"rgb": picture, "alpha": (images["alpha"] * 255 + 0.5).astype(np.uint8)}
            write_frame({name: output / name for name in ("rgb", *names)}, int(index), {}, maps)
        if args.video:
            videos.append(picture)
    progress("render", len(indices), len(indices))
    if videos:
        write_video(output / "rgb.mp4", np.stack(videos), scene.fps, times_of(scene, args.path, indices))
    return {
        "frames": len(indices),
        "output": str(output),
        "text": f"{output}: {_frames(indices)}",
    }


def part_of(count: int, part: str | None, video: bool = False) -> range:
    """The indices that `--part I/N` selects of `count` views; the parts cover every view once and differ by at most one view."""
    if part is None:
        return range(count)
    if video:
        raise F4xError("--video needs every frame; leave out --part.")
    which, _, parts = part.partition("/")
    if not (which.isdecimal() and parts.isdecimal() and 1 <= int(which) <= int(parts)):
        raise F4xError(f"--part {part}: write I/N with I from 1 to N, for example 2/4.")
    return range(count * (int(which) - 1) // int(parts), count * int(which) // int(parts))


def file_name(channel: str) -> str:
    """The channel's name as a file name: characters such as those in `mask:polar bear` become _."""
    return re.sub(r"[^\w.-]", "_", channel)


def write_frame(
    folders: Mapping[str, Path], index: int, maps: Mapping[str, np.ndarray], images: Mapping[str, np.ndarray]
) -> None:
    """Write the images of one frame, and arrays of depth and motion: all of the files or none."""
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
    """(near, far) depth in world units for the colours of the depth images; one range for the whole clip."""
    middle = len(scene.cameras) // 2
    depth = render(scene, scene.cameras[middle], float(scene.cameras.times[middle]), ("depth",), backend)["depth"]
    return depth_range([depth])


def channel_image(channel: str, values: np.ndarray, span: tuple[float, float], full_motion: float) -> np.ndarray:
    """An 8-bit image (H,W,3) or (H,W) of a channel; `span` is the range of depth, `full_motion` the pixels with the full colour."""
    if channel == "depth":
        return colour_depth(values, *span)
    if channel == "motion":
        return colour_motion(values, full_motion)
    return (np.clip(values, 0, 1) * 255 + 0.5).astype(np.uint8)


def feature_channels(scene: Scene) -> tuple[str, ...]:
    """Channels that show the feature field of `scene`: the latent and every head."""
    return () if scene.features is None else ("latent", *scene.features.names)


def feature_image(scene: Scene, name: str, latent: np.ndarray, alpha: np.ndarray) -> np.ndarray:
    """(H,W,3) uint8 image of the latent, or of the features that a head decodes from `latent (H,W,D)`; black in empty pixels."""
    field = scene.require_field()
    if name != "latent":
        image = field.head(name).to_rgb(latent)
    elif field.pca is not None:
        image = field.pca.to_rgb(latent)
    else:
        raise F4xError(f"{scene.name}: the latent has no colours; distil a teacher again.")
    return image * (alpha >= COVERED)[..., None]


def run_export(args: argparse.Namespace, progress: Progress) -> dict[str, Any]:
    """Write a scene, or splats of another program, at one time or at many in one of `FORMATS`."""
    name, _ = choose_format(args.output, args.format, one_moment=args.time is not None)
    is_scene = identify(args.scene) == "scene"
    scene = open_scene(args.scene, args.edits) if is_scene else open_any(args.scene)
    if args.time is not None:
        require_time(scene, args.time, f"--time {args.time:g}")
        times = [args.time]
    else:
        times = scene.cameras.times[frame_indices(args.frames, len(scene.cameras), args.scene)].tolist()
    exported = export(scene, args.output, times, name, progress=progress)
    files = exported.files
    text = str(args.output) if files == [args.output] else f"{args.output}: {len(files)} {plural('file', len(files))}"
    notes = [*(() if is_scene else notes_of(scene)), *exported.notes]
    return {
        "output": str(args.output),
        "format": name,
        "frames": len(times),
        "files": len(files),
        "notes": notes,
        "text": "; ".join([text, *notes]),
    }
