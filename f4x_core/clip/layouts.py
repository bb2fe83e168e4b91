"""Recognises the data-set layouts of folders; each is described as file lists, cameras, masks and depth.

A layout function returns a `Layout` when the folder is of its kind, otherwise None, and raises F4xError when the folder
is of its kind but broken. What a data set keeps back for measuring is a layout too (`find_novel`). Nothing is decoded here.
"""

from __future__ import annotations

import os
import re
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from ..errors import F4xError
from ..geometry import quaternion
from ..reading import DAMAGE, load_json, load_npy
from .clock import DEFAULT_FPS
from .folders import Frames, frames_in, why_unreadable
from .images import list_images
from .notes import Note

DYCHECK_FPS = 30.0  # what the iPhone of DyCheck recorded, unless its extra.json tells
DYCHECK_SPLITS = (("train", "val"), ("train_mono", "val_mono"))
"""Files of `splits/` of one hand-held camera and of the others: DyCheck's own captures, and what it made of Nerfies."""
SCALES = (1, 2, 4, 8, 16)
"""Downsampling factors that name folders like `rgb/2x`."""
NVIDIA_FOLDERS = ("images", "rgb", "images_2", "images_4")
NVIDIA_PICTURE = re.compile(r"v(\d+)_t(\d+)")
"""Names of the true pictures of view v at time t in the evaluation results of DynamicNeRF and RoDynRF."""


@dataclass(frozen=True, eq=False)
class Distortion:
    """Lens distortion of one camera at its native size."""

    intrinsics: np.ndarray
    """(3, 3), pixels, pixel centres at +0.5."""
    coefficients: np.ndarray
    """(k1, k2, p1, p2, k3), the order of OpenCV."""


@dataclass(frozen=True, eq=False)
class Layout:
    """The files of one clip, before frames are selected."""

    name: str
    images: list[Path]
    fps: float = DEFAULT_FPS
    masks: list[Path] = field(default_factory=list)
    """Files, one for each image, or none."""
    depth: list[Path] = field(default_factory=list)
    """`.npy` files, one for each image, or none."""
    intrinsics: np.ndarray | None = None
    """(T, 3, 3) pixels of the native size."""
    world_to_camera: np.ndarray | None = None
    """(T, 4, 4)."""
    size: tuple[int, int] | None = None
    """(width, height) that the intrinsics belong to."""
    distortions: list[Distortion] = field(default_factory=list)
    """Lens distortions, one for each image, or none."""
    times: np.ndarray | None = None
    """(T,) frames of the clip in whose folder it lies, when it is a camera kept back for measuring."""
    factor: int | None = None
    """By how much its authors shrink pictures of `size` before they measure, where they tell."""
    places: np.ndarray | None = None
    """(T,) int64 places of the images in time, where some between them are left out; None: 0, 1, 2, ..."""
    rows: np.ndarray | None = None
    """(T,) int64 places of the images among all pictures of the folder, where some are left out as repeats; None: all are here."""
    total: int = 0
    """Pictures with those that are left out; 0: none is."""
    notes: tuple[Note, ...] = ()
    """Frames that were left out."""

    def file_of(self, row: int) -> int:
        """Place of image `row` among all pictures of the folder."""
        return row if self.rows is None else int(self.rows[row])

    @classmethod
    def of(cls, name: str, frames: Frames, masks: list[Path]) -> Layout:
        """Return the layout of a folder that has its `frames` and perhaps `masks` of its own; else those beside the frames."""
        return cls(name, frames.images, masks=masks or frames.masks, places=frames.places, notes=frames.notes)


class Item(NamedTuple):
    """Picture of a Nerfies folder."""

    time: int
    camera: int
    name: str


def find_layout(folder: Path) -> Layout:
    """Return the layout of the clip in `folder`, of whatever data set; raises F4xError when no images are found."""
    named = Path(os.path.abspath(folder))  # "." has no name
    for layout in (davis, dycheck, nvidia, plain):
        found = layout(named)
        if found is not None:
            return found
    if not folder.exists():  # asked last: ROOT/NAME of a DAVIS root is a clip that is no folder
        raise F4xError(f"{folder} does not exist; give a video file or a folder of frames")
    why = why_unreadable(folder) or why_unreadable(folder / "images")
    if why:
        raise F4xError(why)
    raise F4xError(
        f"{folder} holds no pictures, neither itself nor in images/; give a folder of frames or a video file"
    )


def davis(folder: Path) -> Layout | None:
    """Read DAVIS: `JPEGImages/480p/NAME`, `Annotations/480p/NAME`; `folder` is the sequence, ROOT/NAME, or a ROOT of one."""
    if folder.parent.parent.name == "JPEGImages":
        sequence = folder
    elif (folder.parent / "JPEGImages").is_dir() and not folder.exists():
        found = sorted(folder.parent.glob(f"JPEGImages/*/{folder.name}"))
        if not found:
            raise F4xError(f"{folder.parent} has no sequence {folder.name} in JPEGImages; give one that is there")
        sequence = found[0]  # 480p sorts before Full-Resolution
    elif (folder / "JPEGImages").is_dir():
        found = sorted(path for path in folder.glob("JPEGImages/*/*") if path.is_dir())
        names = sorted({path.name for path in found})
        if len(names) != 1:
            raise F4xError(
                f"{folder} has {len(names)} sequences; give one of them as {folder / (names or ['NAME'])[0]}"
            )
        sequence = found[0]
    else:
        return None
    annotations = sequence.parents[2] / "Annotations" / sequence.parent.name / sequence.name
    return Layout.of(sequence.name, frames_in(sequence), list_images(annotations))


def dycheck(folder: Path) -> Layout | None:
    """Read DyCheck and Nerfies: `rgb/1x`, `camera/ID.json`, `dataset.json`, optional `metadata.json`, `splits/`, `depth/1x`.

    The clip is the one hand-held camera in order of time (of Nerfies' pair the left one, DyCheck's split `mono`); the others
    are in `dycheck_novel`. `scene.json` only recentres and rescales, so cameras and depth stay in the units of the capture.
    """
    if not (folder / "camera").is_dir() or not (folder / "rgb").is_dir():
        return None
    return _nerfies_layout(folder, folder.name, [item.name for item in _dycheck_items(folder)[0]])


def _nerfies_layout(folder: Path, name: str, ids: Sequence[str], times: np.ndarray | None = None) -> Layout:
    """Return the pictures `ids` (all of them where there is none) with their cameras."""
    scale = _scale(folder / "rgb")
    if scale is None:
        raise F4xError(f"{folder}/rgb lacks a folder like 1x or 2x; put the frames there")
    images = {file.stem: file for file in list_images(folder / "rgb" / scale)}
    names = list(ids) or list(images)
    missing = next((name for name in names if name not in images), None)
    if missing is not None:
        raise F4xError(f"{folder}/rgb/{scale} lacks the frame {missing} of its own split; complete the download")
    cameras = [_read_json(folder / "camera" / f"{name}.json") for name in names]
    try:
        intrinsics, matrices = np.stack([_nerfies_intrinsics(c) for c in cameras]), _nerfies_poses(cameras)
        lenses = [np.array([*(c.get("radial_distortion") or [0] * 3), *(_tangential(c) or [0] * 2)]) for c in cameras]
        width, height = (int(pixels) for pixels in cameras[0]["image_size"])
        lens = [Distortion(k, l[[0, 1, 3, 4, 2]]) for k, l in zip(intrinsics, lenses, strict=True)]
    except (KeyError, ValueError, TypeError, IndexError) as error:
        raise F4xError(
            f"{folder}/camera has a file that is no Nerfies camera ({error!r}); download it again"
        ) from error
    depth = [folder / "depth" / scale / f"{name}.npy" for name in names]
    extra = _read_json(folder / "extra.json") if (folder / "extra.json").exists() else {}
    return Layout(
        name,
        [images[name] for name in names],
        fps=float(extra.get("fps", DYCHECK_FPS)),
        depth=depth if all(file.exists() for file in depth) else [],
        intrinsics=intrinsics,
        world_to_camera=matrices,
        size=(width, height),
        distortions=lens if any(l.coefficients.any() for l in lens) else [],
        times=times,
        factor=extra.get("factor"),
    )


def _tangential(camera: dict[str, Any]) -> Any:
    """Return the tangential distortion under its name in DyCheck, or in Nerfies."""
    return camera.get("tangential_distortion") or camera.get("tangential")


def _scale(folder: Path) -> str | None:
    """Return the name of the largest pictures in a folder of `1x`, `2x`, ...; None when there are none."""
    return next((f"{scale}x" for scale in SCALES if (folder / f"{scale}x").is_dir()), None)


def nvidia(folder: Path) -> Layout | None:
    """Read NVIDIA scenes as in RoDynRF: `poses_bounds.npy` (LLFF) beside `images/` or `rgb/`, one pose per image."""
    file = folder / "poses_bounds.npy"
    if not file.exists():
        return None
    frames = next(
        (found for name in NVIDIA_FOLDERS if (found := frames_in(folder / name)).images), frames_in(folder / "images")
    )
    images = frames.images
    try:
        poses = load_npy(file)
        poses = poses[:, :15].reshape(-1, 3, 5)
    except (OSError, *DAMAGE) as error:
        raise F4xError(f"{file} is not an LLFF pose array (N, 17): {error}; download it again") from error
    if len(poses) != len(images):
        raise F4xError(f"{file} has {len(poses)} poses for {len(images)} pictures; they should be as many")
    down, right, back, centers = (poses[:, :, i] for i in range(4))
    height, width = poses[0, :2, 4]
    intrinsics = np.tile(np.eye(3), (len(poses), 1, 1))
    intrinsics[:, 0, 0] = intrinsics[:, 1, 1] = poses[:, 2, 4]
    intrinsics[:, :2, 2] = width / 2, height / 2
    return Layout(
        folder.name,
        images,
        masks=_masks_beside(folder) or frames.masks,
        notes=frames.notes,
        intrinsics=intrinsics,
        world_to_camera=_world_to_camera(np.stack([right, down, -back], axis=1), centers),
        size=(round(width), round(height)),
    )


def plain(folder: Path) -> Layout | None:
    """Return a folder of pictures, or one that contains `images/` (then `masks/` beside it are the masks)."""
    inside = frames_in(folder / "images")
    if inside.images:
        return Layout.of(folder.name, inside, _masks_beside(folder))
    own = frames_in(folder)
    if not own.images:
        return None
    named = folder.name == "images"
    return Layout.of(folder.parent.name if named else folder.name, own, _masks_beside(folder.parent) if named else [])


def find_novel(folder: Path) -> list[Layout]:
    """Return the cameras that a data set reserves for evaluation, in the folder of `find_layout`; none in other folders."""
    return dycheck_novel(folder) or nvidia_novel(folder)


def dycheck_novel(folder: Path) -> list[Layout]:
    """Read DyCheck's and Nerfies' other cameras, at times of the clip; `masks` = `covisible/` where it is complete."""
    if dycheck(folder) is None:
        return []
    learnt, kept = _dycheck_items(folder)
    frames = {item.time: frame for frame, item in enumerate(learnt)}
    layouts = []
    for camera in sorted({item.camera for item in kept}):
        items = [item for item in kept if item.camera == camera and item.time in frames]
        if items:
            times = np.array([frames[item.time] for item in items])
            layout = _nerfies_layout(folder, str(camera), [item.name for item in items], times)
            layouts.append(replace(layout, masks=_covisible(folder, layout.images)))
    return layouts


def _covisible(folder: Path, images: list[Path]) -> list[Path]:
    for _, split in DYCHECK_SPLITS:
        masks = [
            folder / "covisible" / (_scale(folder / "covisible") or "") / split / f"{file.stem}.png" for file in images
        ]
        if all(file.exists() for file in masks):
            return masks
    return []


def nvidia_novel(folder: Path) -> list[Layout]:
    """Read NVIDIA's views as RoDynRF measures them: `gt/v000_t000.png ...` in the scene or `../gt/SCENE`, view v at time t.

    View v is the camera of picture v of the clip: the one of view 0 never moves.
    """
    clip = nvidia(folder)
    if clip is None or clip.intrinsics is None or clip.world_to_camera is None:
        return []
    found = list_images(folder / "gt") or list_images(folder.parent / "gt" / folder.name)
    named = [(match, file) for file in found if (match := NVIDIA_PICTURE.fullmatch(file.stem))]
    layouts = []
    for view in sorted({int(match[1]) for match, _ in named}):
        seen = sorted((int(match[2]), file) for match, file in named if int(match[1]) == view)
        if view >= len(clip.images) or seen[-1][0] >= len(clip.images):
            raise F4xError(f"{seen[-1][1]} is of a view or time that the {len(clip.images)} pictures lack; remove it")
        layouts.append(
            replace(
                clip,
                name=f"v{view:03d}",
                images=[file for _, file in seen],
                masks=[],
                intrinsics=np.repeat(clip.intrinsics[view : view + 1], len(seen), 0),
                world_to_camera=np.repeat(clip.world_to_camera[view : view + 1], len(seen), 0),
                times=np.array([time for time, _ in seen]),
            )
        )
    return layouts


def dycheck_keypoints(folder: Path) -> tuple[dict[int, Path], int]:
    """Return a dictionary from clip frame to `keypoint/2x/SPLIT/ID.json`, and the factor of their pixels (2); empty without any."""
    scale = _scale(folder / "keypoint")
    if scale is None or dycheck(folder) is None:
        return {}, 1
    files = {}
    for frame, item in enumerate(_dycheck_items(folder)[0]):
        for split, _ in DYCHECK_SPLITS:
            file = folder / "keypoint" / scale / split / f"{item.name}.json"
            if file.exists():
                files[frame] = file
    return files, int(scale.removesuffix("x"))


def _masks_beside(folder: Path) -> list[Path]:
    return list_images(folder / "masks") or list_images(folder / "motion_masks")


def _dycheck_items(folder: Path) -> tuple[list[Item], list[Item]]:
    """Return the pictures to learn from, in order of time, and those of other cameras; both empty where nothing tells."""
    for train, test in DYCHECK_SPLITS:
        if (folder / "splits" / f"{train}.json").exists():
            return _split(folder / "splits" / f"{train}.json"), _split(folder / "splits" / f"{test}.json")
    dataset, metadata = folder / "dataset.json", folder / "metadata.json"
    try:
        known = _read_json(metadata) if metadata.exists() else {}
        items = sorted(Item(int(e["warp_id"]), int(e.get("camera_id", 0)), str(n)) for n, e in known.items())
        first = min((item.camera for item in items), default=0)
        if any(item.camera != first for item in items):
            return [i for i in items if i.camera == first], [i for i in items if i.camera != first]
        if dataset.exists():
            data = _read_json(dataset)
            return [Item(time, 0, str(name)) for time, name in enumerate(data.get("train_ids") or data["ids"])], []
    except (KeyError, ValueError, TypeError, AttributeError) as error:
        raise F4xError(
            f"{metadata if metadata.exists() else dataset} does not list frames ({error!r}); download it again"
        ) from error
    return [], []


def _split(file: Path) -> list[Item]:
    """Return the pictures that a split names, in order of time; none where there is no such file."""
    if not file.exists():
        return []
    data = _read_json(file)
    try:
        names = [str(name) for name in data["frame_names"]]
        times = data.get("time_ids", range(len(names)))
        cameras = data.get("camera_ids", [0] * len(names))
        return sorted(Item(int(t), int(c), name) for t, c, name in zip(times, cameras, names, strict=True))
    except (KeyError, ValueError, TypeError) as error:
        raise F4xError(f"{file} does not list frames ({error!r}); write it again") from error


def _nerfies_intrinsics(camera: dict[str, Any]) -> np.ndarray:
    focal, aspect = float(camera["focal_length"]), float(camera.get("pixel_aspect_ratio", 1.0))
    cx, cy = camera["principal_point"]
    return np.array([[focal, float(camera.get("skew", 0.0)), cx], [0, focal * aspect, cy], [0, 0, 1]])


def _nerfies_poses(cameras: list[dict[str, Any]]) -> np.ndarray:
    """Return world_to_camera from `orientation`, the world-to-camera rotation, and `position`, the camera centre."""
    rotations = np.array([camera["orientation"] for camera in cameras], np.float64)
    return _world_to_camera(rotations, np.array([camera["position"] for camera in cameras], np.float64))


def _world_to_camera(rotations: np.ndarray, centers: np.ndarray) -> np.ndarray:
    """Return `(T, 4, 4)` of world-to-camera `rotations (T, 3, 3)`, made orthonormal (files round them), and centres."""
    matrices = np.tile(np.eye(4), (len(rotations), 1, 1))
    matrices[:, :3, :3] = quaternion.to_matrix(quaternion.from_matrix(rotations))
    matrices[:, :3, 3] = -(matrices[:, :3, :3] @ centers[:, :, None])[..., 0]
    return matrices


def _read_json(file: Path) -> dict[str, Any]:
    try:
        data = load_json(file)
    except (OSError, ValueError) as error:
        raise F4xError(f"{file} cannot be read as JSON ({error}); complete the download") from error
    if not isinstance(data, dict):
        raise F4xError(f"{file} should hold a JSON object; complete the download")
    return data
