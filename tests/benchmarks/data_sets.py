"""Small copies of the field's data sets in their exact layouts, made from a toy world whose cameras and pictures are known."""

import json
from pathlib import Path

import numpy as np
from PIL import Image

from benchmarks.studies.toy_worlds import World, make_world
from f4x_core.clip.images import as_bytes
from f4x_core.geometry.camera import Camera

UNIT = 2.5
"""Units of the captures in one of the world's."""
KEYPOINTS = 12
HIDDEN = 6
"""Columns at the left of a test picture that are not co-visible."""


def toy(width: int = 96, frames: int = 12) -> World:
    return make_world("two movers", width, frames)


def save(file: Path, picture: np.ndarray) -> None:
    file.parent.mkdir(parents=True, exist_ok=True)
    Image.fromarray(picture).save(file)


def write_text(file: Path, data) -> None:
    file.parent.mkdir(parents=True, exist_ok=True)
    file.write_text(json.dumps(data))


def write_nvidia(data: Path, world: World, scene: str = "Balloon1") -> Path:
    """DynamicNeRF's `data.zip` unpacked to DATA/nvidia, and `gt` of its `results.zip` beside the scenes."""
    folder = data / "nvidia" / scene
    poses = []
    for frame, view in enumerate(world.views):
        save(folder / "images" / f"{frame:03d}.png", as_bytes(view.rgb))
        save(folder / "motion_masks" / f"{frame:03d}.png", np.uint8(255) * (view.moving > 0.5))
        camera = world.cameras[frame]
        right, down, forward = camera.world_to_camera[:3, :3]
        size = [world.height, world.width, camera.intrinsics[0, 0]]
        columns = np.stack([down, right, -forward, UNIT * camera.center, size], 1)
        poses.append([*columns.ravel(), 0.5 * UNIT, 2.0 * UNIT])
        truth = world.view(world.cameras[0], float(frame))
        save(data / "nvidia" / "gt" / scene / f"v000_t{frame:03d}.png", as_bytes(truth.rgb))
    np.save(folder / "poses_bounds.npy", np.array(poses))
    return folder


def nerfies_camera(camera: Camera, factor: int, tangential: str, radial=(0.0, 0.0, 0.0)) -> dict:
    """A camera's JSON; pictures of it are `factor` times smaller than it says."""
    return {
        "orientation": camera.world_to_camera[:3, :3].tolist(),
        "position": (UNIT * camera.center).tolist(),
        "focal_length": factor * camera.intrinsics[0, 0],
        "principal_point": (factor * camera.intrinsics[:2, 2]).tolist(),
        "skew": 0.0,
        "pixel_aspect_ratio": 1.0,
        "radial_distortion": list(radial),
        tangential: [0.0, 0.0],
        "image_size": [factor * camera.width, factor * camera.height],
    }


def write_dycheck(data: Path, world: World, scene: str = "paper-windmill", factor: int = 2) -> Path:
    """One hand-held camera (0), two that stand still (1, 2) and miss some frames; masks and keypoints at `factor`."""
    folder, scale = data / "dycheck" / scene, f"{factor}x"
    others = {1: world.novel_cameras[0], 2: world.cameras[world.frames - 1]}
    train = [(frame, 0, f"0_{frame:05d}") for frame in range(world.frames)]
    val = [(frame, camera, f"{camera}_{frame:05d}") for camera in others for frame in range(camera, world.frames, 2)]
    for frame, camera, name in train + val:
        eye = others.get(camera, world.cameras[frame])
        view = world.view(eye, float(frame))
        save(
            folder / "rgb" / scale / f"{name}.png",
            np.dstack([as_bytes(view.rgb), np.full(view.depth.shape, 255, np.uint8)]),
        )
        write_text(folder / "camera" / f"{name}.json", nerfies_camera(eye, factor, "tangential_distortion"))
        if camera == 0:
            (folder / "depth" / scale).mkdir(parents=True, exist_ok=True)
            np.save(folder / "depth" / scale / f"{name}.npy", UNIT * np.nan_to_num(view.depth)[..., None])
        else:
            seen = np.full(view.depth.shape, 255, np.uint8)
            seen[:, :HIDDEN] = 0
            save(folder / "covisible" / scale / "val" / f"{name}.png", seen)
    for frame, points in keypoints(world).items():
        points[:, :2] -= 0.5  # DyCheck counts pixel centres at whole numbers
        write_text(folder / "keypoint" / scale / "train" / f"0_{frame:05d}.json", points.tolist())
    write_text(folder / "keypoint" / scale / "train" / "skeleton.json", {"name": "unconnected"})
    for split, items in (("train", train), ("val", val)):
        keys = ("time_ids", "camera_ids", "frame_names")
        write_text(
            folder / "splits" / f"{split}.json", dict(zip(keys, map(list, zip(*items, strict=True)), strict=True))
        )
    write_lists(folder, train, val)
    write_text(folder / "extra.json", {"factor": factor, "fps": 30.0})
    return folder


def keypoints(world: World) -> dict[int, np.ndarray]:
    """Every third frame -> (J,3) of points that move, pixel centres at +0.5, and whether the frame shows them."""
    pixels, visible, moving = world.tracks
    chosen = np.flatnonzero(moving)[:: max(1, moving.sum() // KEYPOINTS)][:KEYPOINTS]
    return {
        frame: np.concatenate([pixels[frame, chosen], visible[frame, chosen, None]], 1)
        for frame in range(0, world.frames, 3)
    }


def write_nerfies(data: Path, world: World, scene: str = "tail", radial=(0.0, 0.0, 0.0)) -> Path:
    """A rig of two cameras that take pictures at the same times; the original split interleaves them."""
    folder, factor = data / "nerfies" / scene, 4
    left = [(frame, 0, f"left1_{frame:06d}") for frame in range(world.frames)]
    right = [(frame, 1, f"right1_{frame:06d}") for frame in range(world.frames)]
    for frame, camera, name in left + right:
        eye = (world.cameras, world.novel_cameras)[camera][frame]
        save(folder / "rgb" / f"{factor}x" / f"{name}.png", as_bytes(world.view(eye, float(frame)).rgb))
        write_text(folder / "camera" / f"{name}.json", nerfies_camera(eye, factor, "tangential", radial))
    write_lists(folder, left[::2] + right[1::2], left[1::2] + right[::2])
    return folder


def write_lists(folder: Path, train: list, val: list) -> None:
    """`dataset.json`, `metadata.json`, `scene.json` as Nerfies defines them."""
    ids = [name for _, _, name in train + val]
    counts = {"count": len(ids), "num_exemplars": len(train)}
    names = {"train_ids": [name for _, _, name in train], "val_ids": [name for _, _, name in val]}
    write_text(folder / "dataset.json", counts | {"ids": ids} | names)
    about = {name: {"warp_id": t, "appearance_id": t, "camera_id": c} for t, c, name in train + val}
    write_text(folder / "metadata.json", about)
    write_text(folder / "scene.json", {"scale": 0.3, "center": [0.1, 0.2, 0.3], "near": 0.1, "far": 1.0})
