"""Exact priors from the truth that Blender rendered beside a synthetic clip (provider `synthetic`).

The clip's folder holds `truth/%05d.exr` (multilayer float32: Depth, Vector, Object Index) and `truth.json` (`width`,
`height`, `cameras`: CameraPath of every frame, `moving_index`: object indices that move, `people`: `index` and `height` of
each person, whose joints `joints.npy` holds). Blender's conventions, verified
against analytic reprojection: Depth is planar z with 1e10 for background; forward flow t -> t+1 is (-Vector.Z, +Vector.W),
backward flow t -> t-1 is (+Vector.X, -Vector.Y), in pixels, x right, y down.

Static points are reprojected exactly; moving ones follow the chained Vector passes, through held-out frames too (only
their truth is used for that, never their picture).
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from ..errors import F4xError
from ..geometry.camera import Camera, CameraPath
from ..progress import Progress
from ..reading import load_json, load_npy, undamaged
from .config import PriorsConfig
from .depth import MAX_DEPTH
from .files import camera_kind
from .flow import sample
from .joints import HIPS, JOINTS, turn_to_ray
from .tracks import longest_first

if TYPE_CHECKING:
    from ..clip import Clip
    from .folder import Priors

BACKGROUND_DEPTH = 1e9
"""Blender writes 1e10 where a ray hits nothing."""
FAR = 1e4
"""Depth, in median depths, at which background is put where a direction needs a point (only its turning shows)."""
DEPTH_AGREES = 0.02
"""Relative difference of depth up to which a reprojected point is the visible surface."""
RETURN_PX = 0.5
"""A moving point is occluded when the backward vector does not lead back to within this."""
JOINT_REACH = 2
"""Pixels from a joint within which its person is seen if nothing hides it: heels and toes lie on the outline."""
PASS_NAMES = {"IndexOB": "Object Index"}
"""Blender 4.x name -> 5.x name."""
CHANNEL_ORDER = "XYZWRGBAUV"


def read_passes(path: str | Path) -> dict[str, np.ndarray]:
    """Return the passes of a multilayer EXR: pass name -> `(H, W)` or `(H, W, C)` float32, channels in the order XYZW / RGBA.

    Reads Blender 4.x files (one part, `ViewLayer.IndexOB.X`) and 5.x files (a part per pass, `ViewLayer.Object Index.X`);
    names are those of 5.x without the view layer. F4xError when the file cannot be read.
    """
    import OpenEXR

    planes: dict[str, dict[str, np.ndarray]] = defaultdict(dict)
    if not Path(path).is_file():
        raise F4xError(f"{path} does not exist; render the synthetic clip again.")
    try:
        with OpenEXR.File(str(path), separate_channels=True) as file:
            for part in file.parts:
                for name, channel in part.channels.items():
                    *head, axis = name.split(".")
                    if head:
                        planes[PASS_NAMES.get(head[-1], head[-1])][axis.upper()] = np.array(channel.pixels)
    except Exception as error:  # OpenEXR raises bare RuntimeError and its own types
        raise F4xError(f"{path} is not a readable EXR file ({error}); render it again.") from error
    passes = {}
    for name, channels in planes.items():
        ordered = [channels[axis] for axis in sorted(channels, key=lambda axis: CHANNEL_ORDER.find(axis))]
        passes[name] = ordered[0] if len(ordered) == 1 else np.stack(ordered, axis=-1)
    return passes


@dataclass(frozen=True)
class TruePeople:
    """The people of a synthetic clip, all T frames."""

    who: np.ndarray
    """(T, H, W) uint8: which of M people is seen, + 1 (0 = nobody)."""
    joints: np.ndarray
    """(T, M, 33, 3) float64 in the renderer's world (`joints.NAMES`)."""
    heights: np.ndarray
    """(M,) at rest, in the renderer's unit."""

    @classmethod
    def read(cls, folder: Path, people: Sequence[Mapping[str, Any]], objects: np.ndarray) -> TruePeople:
        """Return the people of truth.json, with the object index `objects (T, H, W)`; F4xError when their joints are missing."""
        who, path = np.zeros(objects.shape, np.uint8), folder / "joints.npy"
        joints = np.zeros((len(objects), 0, JOINTS, 3))
        with undamaged(path, "render the synthetic clip again."):
            if people:
                joints = load_npy(path).astype(np.float64)
            wanted = (len(objects), len(people), JOINTS, 3)
            if joints.shape != wanted or not np.isfinite(joints).all():
                raise F4xError(
                    f"does not hold {JOINTS} joints of {wanted[1]} people in {wanted[0]} frames; render it again."
                )
        with undamaged(folder / "truth.json", "render the synthetic clip again."):
            for number, person in enumerate(people):
                who[objects == person["index"]] = number + 1
            return cls(who, joints, np.array([float(person["height"]) for person in people]))

    def pixels(self, frame: int, camera: Camera) -> np.ndarray:
        """Return joints in a frame's picture (M, 33, 3): x, y and 1 where it shows the person there, 0 where something hides them.

        A joint that the person's own body hides counts as shown. NaN for people of whom the frame shows nothing.
        """
        height, width = self.who.shape[1:]
        uv, depth = camera.project(self.joints[frame].reshape(-1, 3))
        x, y, inside = _pixels_of(uv, (height, width))
        persons = np.repeat(np.arange(self.joints.shape[1]) + 1, JOINTS)
        reach = np.arange(-JOINT_REACH, JOINT_REACH + 1)
        rows, columns = np.clip(y + reach[:, None], 0, height - 1), np.clip(x + reach[:, None], 0, width - 1)
        near = self.who[frame][rows[:, None], columns[None]]  # (rows, columns, M * 33)
        shown = inside & (depth > 0) & (near == persons).any((0, 1))
        joints = np.column_stack([uv, shown]).reshape(-1, JOINTS, 3)
        joints[~np.isin(np.arange(len(joints)) + 1, self.who[frame])] = np.nan
        return joints


@dataclass(frozen=True)
class Truth:
    """Everything known about a synthetic clip, all T frames, in the unit of the renderer."""

    cameras: CameraPath
    depth: np.ndarray
    """(T, H, W) float32 planar z, NaN = background."""
    forward: np.ndarray
    """(T, H, W, 2) float32 pixels t -> t + 1."""
    backward: np.ndarray
    """(T, H, W, 2) float32 pixels t -> t - 1."""
    moving: np.ndarray
    """(T, H, W) bool: pixels of objects that move."""
    people: TruePeople | None = None
    """Nobody in clips whose truth lists no people; None where they are not asked for."""

    @classmethod
    def read(cls, clip: Clip, progress: Progress) -> Truth:
        """Return the truth of the folder that `clip` was read from; F4xError when it is missing or belongs to other pictures."""
        folder = Path(clip.source)
        folder = folder if (folder / "truth.json").is_file() else folder.parent
        path = folder / "truth.json"
        if not path.is_file():
            raise F4xError(
                f"{clip.source} holds no truth.json; the provider 'synthetic' needs a clip rendered with truth."
            )
        try:
            head = load_json(path)
            cameras, moving_index = CameraPath.from_json(head["cameras"], path), list(head["moving_index"])
        except (OSError, ValueError, KeyError, TypeError) as error:
            raise F4xError(f"{path} is damaged ({error!r}); render the synthetic clip again.") from error
        files = sorted((folder / "truth").glob("*.exr"))
        count, height, width = clip.frames.shape[:3]
        if not len(files) == len(cameras) == count or (cameras.width, cameras.height) != (width, height):
            raise F4xError(
                f"{path} describes {len(cameras)} frames of {cameras.width}x{cameras.height} ({len(files)} EXR files), the"
                f" clip has {count} of {width}x{height}; read the whole clip at its own size."
            )
        depth, objects = np.empty((count, height, width), np.float32), np.empty((count, height, width), np.uint16)
        forward, backward = np.empty((2, count, height, width, 2), np.float32)
        for i, file in enumerate(files):
            progress("truth", i, count)
            passes = read_passes(file)
            lacking = {"Depth", "Vector", "Object Index"} - passes.keys()
            if lacking:
                raise F4xError(
                    f"{file} lacks the pass {', '.join(sorted(lacking))}; render it with that pass switched on."
                )
            if passes["Depth"].shape != (height, width):
                raise F4xError(
                    f"{file} is {passes['Depth'].shape[::-1]}, the clip is {width}x{height}; render it again."
                )
            depth[i] = np.where(passes["Depth"] < BACKGROUND_DEPTH, passes["Depth"], np.nan)
            vector = passes["Vector"]
            forward[i] = np.stack([-vector[..., 2], vector[..., 3]], axis=-1)
            backward[i] = np.stack([vector[..., 0], -vector[..., 1]], axis=-1)
            objects[i] = passes["Object Index"].round()
        progress("truth", count, count)
        people = TruePeople.read(folder, head.get("people", []), objects)
        return cls(cameras, depth, forward, backward, np.isin(objects, moving_index), people)

    @property
    def far(self) -> float:
        """Depth that stands for infinity."""
        return FAR * float(np.nanmedian(self.depth))

    def reproject(self, source: int, target: int, uv: np.ndarray, depth: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return pixels and depth, in frame `target`, of static points at pixels `uv (n, 2)` and `depth (n,)` of frame `source`."""
        depth = np.where(np.isfinite(depth), depth, self.far).astype(np.float64)
        return self.cameras[target].project(self.cameras[source].unproject(uv.astype(np.float64), depth))

    def shows(self, frame: int, uv: np.ndarray, depth: np.ndarray) -> np.ndarray:
        """Return True if static points at `uv (n, 2)` with `depth (n,)` are the visible surface of a frame, `(n,)` bool."""
        x, y, inside = self._pixels(uv)
        seen = np.where(np.isfinite(self.depth[frame, y, x]), self.depth[frame, y, x], self.far)
        # Slanted surfaces change depth within a pixel: the step to the neighbours is granted on top.
        near = np.abs(np.diff(self.depth[frame], axis=0, append=self.depth[frame, -1:]))[y, x]
        near = near + np.abs(np.diff(self.depth[frame], axis=1, append=self.depth[frame, :, -1:]))[y, x]
        slack = DEPTH_AGREES * seen + np.minimum(np.nan_to_num(near), 0.1 * seen)
        close = (np.abs(seen - depth) < slack) | ((seen >= self.far / 2) & (depth >= self.far / 2))
        return inside & close & (depth > 0) & ~self.moving[frame, y, x]

    def follow(self, source: int, target: int, uv: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Chain moving points `uv (n, 2)` from one frame to another; also whether each step stayed visible, `(n,)`."""
        step = 1 if target > source else -1
        alive = np.ones(len(uv), bool)
        for frame in range(source, target, step):
            there, back = (self.forward, self.backward) if step > 0 else (self.backward, self.forward)
            moved = uv + self._vector(there[frame], self.moving[frame], uv)
            x, y, inside = self._pixels(moved)
            returned = moved + self._vector(back[frame + step], self.moving[frame + step], moved)
            alive &= inside & self.moving[frame + step, y, x] & (np.linalg.norm(returned - uv, axis=1) < RETURN_PX)
            uv = moved
        return uv, alive

    def _pixels(self, uv: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return the column, row (clipped) and whether inside the picture."""
        return _pixels_of(uv, self.depth.shape[1:])

    def _vector(self, flow: np.ndarray, moving: np.ndarray, uv: np.ndarray) -> np.ndarray:
        """Return the flow at `uv`: bilinear inside a moving object, of the nearest pixel on its rim (no mixing with background)."""
        x, y, _ = self._pixels(uv)
        pure = sample(moving.astype(np.float32), uv) > 0.999
        return np.where(pure[..., None], sample(flow, uv), flow[y, x])


def _pixels_of(uv: np.ndarray, shape: tuple[int, ...]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return the column, row (clipped) and whether inside a picture of `shape` (H, W)."""
    height, width = shape
    inside = (uv >= 0).all(-1) & (uv[..., 0] < width) & (uv[..., 1] < height)
    uv = np.nan_to_num(uv, nan=0.0, posinf=0.0, neginf=0.0)
    x = np.clip(uv[..., 0], 0, width - 1).astype(int)
    return x, np.clip(uv[..., 1], 0, height - 1).astype(int), inside


def provide_flow(clip: Clip, priors: Priors, config: PriorsConfig, progress: Progress) -> None:
    """Fill the four flow fields; the masks hold what is visible in both frames."""
    truth = _truth(clip, priors, progress)
    frames, (height, width) = priors.frames, truth.depth.shape[1:]
    grid = truth.cameras[0].pixel_grid().reshape(-1, 2)
    shape = (len(frames) - 1, height, width)
    for name, sources, targets in (("forward", frames[:-1], frames[1:]), ("backward", frames[1:], frames[:-1])):
        flow, mask = np.zeros((*shape, 2), np.float16), np.zeros(shape, bool)
        for i, (source, target) in enumerate(zip(sources, targets, strict=True)):
            progress("flow", i, shape[0])
            uv, z = truth.reproject(source, target, grid, truth.depth[source].ravel())
            visible, moving = truth.shows(target, uv, z), truth.moving[source].ravel()
            uv[moving], visible[moving] = truth.follow(source, target, grid[moving])
            flow[i] = np.clip(uv - grid, -6e4, 6e4).reshape(height, width, 2)
            mask[i] = visible.reshape(height, width)
        setattr(priors, f"flow_{name}", flow)
        setattr(priors, f"flow_{name}_mask", mask)
        progress("flow", shape[0], shape[0])


def provide_tracks(clip: Clip, priors: Priors, config: PriorsConfig, progress: Progress) -> None:
    """Fill `tracks` and `tracks_visible`: seeds as the settings ask, denser on moving objects, never on the same spot twice."""
    truth, settings = _truth(clip, priors, progress), config.tracks
    frames = priors.frames
    found: list[tuple[np.ndarray, np.ndarray]] = []
    for start in range(0, len(frames), max(settings.reseed_every, 1)):
        progress("tracks", start, len(frames))
        for moving, spacing in ((False, settings.spacing), (True, settings.dynamic_spacing)):
            seeds = _seeds(truth, int(frames[start]), moving, spacing, [(t[start], v[start]) for t, v in found])
            if len(seeds):
                found.append(_tracked(truth, frames, start, seeds, moving))
    progress("tracks", len(frames), len(frames))
    tracks = np.concatenate([t for t, _ in found], axis=1) if found else np.zeros((len(frames), 0, 2))
    visible = np.concatenate([v for _, v in found], axis=1) if found else np.zeros((len(frames), 0), bool)
    longest = np.sort(longest_first(visible)[: settings.count])
    priors.tracks, priors.tracks_visible = tracks[:, longest].astype(np.float32), visible[:, longest]


def provide_people(clip: Clip, priors: Priors, config: PriorsConfig, progress: Progress) -> None:
    """Fill `people`, `people_probability`, `people_joints` and `people_metres`; nobody where the truth knows of no people."""
    truth = _truth(clip, priors, progress)
    people, frames = truth.people, priors.frames
    assert people is not None
    cameras = [truth.cameras[int(frame)] for frame in frames]
    hips = people.joints[:, :, HIPS].mean(axis=2, keepdims=True)
    turns = np.stack([camera.world_to_camera[:3, :3] for camera in cameras])
    priors.people = people.who[frames]
    priors.people_probability = (priors.people > 0).astype(np.float16)
    joints = [people.pixels(int(frame), camera) for frame, camera in zip(frames, cameras, strict=True)]
    priors.people_joints = np.stack(joints).astype(np.float32)
    metres = np.einsum("fij,fmkj->fmki", turns, (people.joints - hips)[frames])
    seen_along = [turn_to_ray(each, camera.intrinsics) for each, camera in zip(joints, cameras, strict=True)]
    metres = np.einsum("fmji,fmkj->fmki", np.stack(seen_along), metres)
    priors.people_metres = np.where(np.isfinite(priors.people_joints), metres, np.nan).astype(np.float32)


def provide_motion(clip: Clip, priors: Priors, config: PriorsConfig, progress: Progress) -> None:
    """Fill `motion`, `mask` and `tracks_motion`."""
    truth = _truth(clip, priors, progress)
    priors.mask = truth.moving[priors.frames]
    priors.motion = priors.mask.astype(np.float16)
    assert priors.tracks is not None and priors.tracks_visible is not None
    priors.tracks_motion = motion_of_tracks(priors.tracks, priors.tracks_visible, priors.mask)


def motion_of_tracks(tracks: np.ndarray, visible: np.ndarray, mask: np.ndarray) -> np.ndarray:
    """Return `tracks_motion (N,)` float32: 1 for tracks `(F,N,2)` most of whose visible samples lie in `mask (F,H,W)`, else 0."""
    hits = np.zeros(tracks.shape[1])
    for uv, seen, moving in zip(tracks, visible, mask, strict=True):
        x, y, _ = _pixels_of(uv, moving.shape)
        hits += seen & moving[y, x]
    return (hits > 0.5 * visible.sum(0)).astype(np.float32)


def provide_cameras(clip: Clip, priors: Priors, config: PriorsConfig, progress: Progress) -> None:
    """Fill `cameras` (world unit: median depth 1) and `camera_kind`."""
    truth = _truth(clip, priors, progress)
    every = truth.cameras.scaled_world(1 / _unit(truth, priors))
    rows = priors.frames
    priors.cameras = CameraPath(
        every.intrinsics[rows], every.world_to_camera[rows], clip.times[rows], every.width, every.height
    )
    priors.camera_kind = camera_kind(priors.cameras)


def provide_depth(clip: Clip, priors: Priors, config: PriorsConfig, progress: Progress) -> None:
    """Fill `depth` (median 1, sky at `MAX_DEPTH`: a fit needs a place for what it shows) and `depth_confidence`."""
    truth = _truth(clip, priors, progress)
    depth = truth.depth[priors.frames] / np.float32(_unit(truth, priors))
    priors.depth = np.where(np.isfinite(depth), depth, np.float32(MAX_DEPTH))
    priors.depth_confidence = np.ones(depth.shape, np.float16)


def _truth(clip: Clip, priors: Priors, progress: Progress) -> Truth:
    """Return the truth, read once for all stages."""
    kept = priors.scratch.of_providers
    if "truth" not in kept:
        kept["truth"] = Truth.read(clip, progress)
    return kept["truth"]


def _unit(truth: Truth, priors: Priors) -> float:
    """Return the median depth of the supervised frames in the renderer's unit."""
    return float(np.nanmedian(truth.depth[priors.frames]))


def _seeds(
    truth: Truth, frame: int, moving: bool, spacing: float, known: list[tuple[np.ndarray, np.ndarray]]
) -> np.ndarray:
    """Return pixel centres `(n, 2)` on a grid, static or moving, that no known visible track lies near."""
    height, width = truth.depth.shape[1:]
    step = max(int(spacing), 1)
    rows, columns = np.arange(step // 2, height, step), np.arange(step // 2, width, step)
    free = truth.moving[frame][rows[:, None], columns] == moving
    free &= np.isfinite(truth.depth[frame][rows[:, None], columns])
    for uv, visible in known:
        x, y = uv[visible].T.astype(int) // step
        inside = (x >= 0) & (y >= 0) & (x < len(columns)) & (y < len(rows))
        free[y[inside], x[inside]] = False
    y, x = np.nonzero(free)
    return np.stack([columns[x] + 0.5, rows[y] + 0.5], axis=1)


def _tracked(
    truth: Truth, frames: np.ndarray, start: int, seeds: np.ndarray, moving: bool
) -> tuple[np.ndarray, np.ndarray]:
    """Return the positions `(F, n, 2)` and visibility `(F, n)` of seeds of frame `frames[start]`."""
    tracks, visible = np.full((len(frames), *seeds.shape), np.nan), np.zeros((len(frames), len(seeds)), bool)
    tracks[start], visible[start] = seeds, True
    if not moving:
        x, y, _ = truth._pixels(seeds)
        depth = truth.depth[frames[start], y, x]
        for i, frame in enumerate(frames):
            if i != start:
                uv, z = truth.reproject(frames[start], frame, seeds, depth)
                tracks[i] = np.where((z > 0)[:, None], uv, np.nan)
                visible[i] = truth.shows(frame, uv, z)
        return tracks, visible
    for order in (range(start + 1, len(frames)), range(start - 1, -1, -1)):
        for i in order:
            previous = i - 1 if i > start else i + 1
            alive = visible[previous]
            if not alive.any():
                break
            uv, held = truth.follow(frames[previous], frames[i], tracks[previous][alive])
            tracks[i, alive] = np.where(held[:, None], uv, np.nan)
            visible[i, alive] = held
    return tracks, visible
