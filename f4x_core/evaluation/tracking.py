"""A fitted scene as a point tracker: follows pixels of one frame through the clip by the motion of the Gaussians."""

from __future__ import annotations

import numpy as np

from ..raster import rasterize
from ..scene import Scene

# Below this alpha nothing moving was seen at the queried pixel; all Gaussians answer then.
MIN_ALPHA = 0.05


def track_pixels(scene: Scene, frame: int, pixels: np.ndarray, targets: list[int], backend: str = "auto") -> np.ndarray:
    """Return the positions (targets, Q, 2) in pixels of the points seen at `pixels` (Q,2) of clip frame `frame`.

    The world positions that Gaussians have at the target's time are composited from the view of `frame`, read at the
    query, and projected into the target's camera. Moving Gaussians answer where there are any.
    """
    cameras = scene.cameras
    here = scene.posed(float(cameras.times[frame]))
    camera = cameras[frame]
    result = np.zeros((len(targets), len(pixels), 2))
    for row, target in enumerate(targets):
        there = scene.posed(float(cameras.times[target])).means
        moving = _composited(here, there, here.dynamic, camera, pixels, backend)
        every = _composited(here, there, np.ones(len(here.dynamic), bool), camera, pixels, backend)
        x = np.where(
            moving[:, 3:] > MIN_ALPHA,
            moving[:, :3] / np.maximum(moving[:, 3:], 1e-6),
            every[:, :3] / np.maximum(every[:, 3:], 1e-6),
        )
        result[row] = cameras[target].project(x.astype(np.float64))[0]
    return result


def _composited(here, there, chosen, camera, pixels, backend) -> np.ndarray:
    """Composite positions and alpha of the chosen Gaussians, and return them (Q,4) at `pixels`."""
    if not chosen.any():
        return np.zeros((len(pixels), 4))
    out = rasterize(here.take(chosen), there[chosen], camera, backend=backend)
    maps = np.concatenate([out.channels, out.alpha[..., None]], -1)
    return _bilinear(maps, pixels)


def _bilinear(maps: np.ndarray, pixels: np.ndarray) -> np.ndarray:
    """Return the values (Q,C) of (H,W,C) maps at pixel positions (Q,2), pixel centres at +0.5."""
    height, width = maps.shape[:2]
    x = np.clip(pixels[:, 0] - 0.5, 0, width - 1.001)
    y = np.clip(pixels[:, 1] - 0.5, 0, height - 1.001)
    column, row = np.floor(x).astype(int), np.floor(y).astype(int)
    u, v = (x - column)[:, None], (y - row)[:, None]
    top = maps[row, column] * (1 - u) + maps[row, column + 1] * u
    bottom = maps[row + 1, column] * (1 - u) + maps[row + 1, column + 1] * u
    return top * (1 - v) + bottom * v


def joint_accuracy(scene: Scene, annotation: dict, areas: dict[int, float], backend: str = "auto") -> dict[str, float]:
    """Return the PCK@0.2 sqrt(area) of hand-set joints, each followed from the first frame that shows it.

    Args:
        annotation: `{"size": [W,H], "frames": [{"frame": i, "joints": {name: [x, y]}}]}`, pixels of that size.
        areas: clip frame -> area of the animal in pixels of the scene's size.
    """
    ratio = np.array([scene.cameras.width, scene.cameras.height]) / np.array(annotation["size"])
    starts: dict[int, dict[str, np.ndarray]] = {}
    seen: set[str] = set()
    later: list[tuple[str, int, np.ndarray]] = []
    for entry in sorted(annotation["frames"], key=lambda e: e["frame"]):
        for name, place in entry["joints"].items():
            if name in seen:
                later.append((name, entry["frame"], np.array(place) * ratio))
            else:
                seen.add(name)
                starts.setdefault(entry["frame"], {})[name] = np.array(place) * ratio
    right = total = 0
    for start, joints in starts.items():
        wanted = [(name, frame, place) for name, frame, place in later if name in joints and frame < len(scene.cameras)]
        targets = sorted({frame for _, frame, _ in wanted})
        if not targets:
            continue
        names = list(joints)
        tracked = track_pixels(scene, start, np.array([joints[n] for n in names]), targets, backend)
        for name, frame, place in wanted:
            distance = np.linalg.norm(tracked[targets.index(frame), names.index(name)] - place)
            right += bool(distance <= 0.2 * np.sqrt(areas[frame]))
            total += 1
    return {"pck": right / max(total, 1), "points": total}


def keypoint_accuracy(
    scene: Scene, keypoints: dict[int, np.ndarray], ratio: float = 0.05, backend: str = "auto"
) -> dict[str, float]:
    """Return DyCheck's PCK: the keypoints carried from each annotated frame to each that land within `ratio` of the longer side.

    Means over pairs of frames (a frame with itself is one, as in DyCheck's own evaluation) of the fraction of points that both
    show; NaN if no two frames show the same point.

    Args:
        keypoints: clip frame -> (J,3) x, y in pixels of the scene's size and 1 where visible.
    """
    frames, fractions = sorted(keypoints), []
    reach = ratio * max(scene.cameras.width, scene.cameras.height)
    for start in frames:
        shown = keypoints[start][:, 2] > 0.5
        if not shown.any():
            continue
        tracked = track_pixels(scene, start, keypoints[start][shown, :2], frames, backend)
        for found, target in zip(tracked, frames, strict=True):
            truth = keypoints[target][shown]
            both = truth[:, 2] > 0.5
            if both.any():
                fractions.append(float((np.linalg.norm(found - truth[:, :2], axis=1) < reach)[both].mean()))
    return {"pck": float(np.mean(fractions)) if fractions else float("nan"), "pairs": len(fractions)}
