"""A scene as one HTML page that plays in a browser: splats packed as SPZ, and the nodes' poses with the weights that follow them.

The page (`viewer.html`, `viewer.js`) poses and draws them itself by the rule of the raster room, so that a clip takes little more
than its splats. Colours are those seen from the clip's middle camera; time goes in whole frames.
"""

from __future__ import annotations

import base64
import gzip
import html
import json
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from string import Template

import numpy as np

from ...files import replace_file
from ...geometry import pose, quaternion, spherical_harmonics
from ...geometry.splats import Splats
from ...scaffold.deformation import node_poses_at, pairs_of
from ..model import Scene
from .spz import FixedPoint, pack_spz

KINDS = {"f": "<f4", "u": "<u4", "b": "u1"}
"""Letter in the page's layout -> numbers."""
DEGREES = 5.0
"""Degrees off the camera's path that a page allows without a fit's figure (splats from elsewhere, older scenes)."""


@dataclass(frozen=True)
class PageOptions:
    """Settings of a page."""

    degrees: float | None = None
    """Degrees off the camera's path that the view may turn, at the scene's centre; None = `believed_degrees` of the scene."""
    words: Mapping[str, np.ndarray] = field(default_factory=dict)
    """Word -> (N,) bool of the Gaussians in the order of `Scene.posed` that its button colours."""


def write_page(scene: Scene, path: Path | str, options: PageOptions | None = None) -> tuple[str, ...]:
    """Write the base arrays of `scene` (bake its edits first) as one HTML page; returns what a person must know of it.

    Raises F4xError.
    """
    options = options or PageOptions()
    degrees = believed_degrees(scene) if options.degrees is None else options.degrees
    why = ", as far as the clip tells" if options.degrees is None and scene.provenance.get("believed_degrees") else ""
    layout, motion = _joined(_motion(scene, options))
    cameras, stored = scene.cameras, _stored(scene)
    positions = FixedPoint.of(stored.means, stored.scales)
    data = {
        "width": cameras.width,
        "height": cameras.height,
        "fps": scene.fps,
        "times": cameras.times.tolist(),
        "intrinsics": cameras.intrinsics[:, [0, 1, 0, 1], [0, 1, 2, 2]].tolist(),
        "world_to_camera": cameras.world_to_camera.reshape(-1, 16).tolist(),
        "depth": _centre_depth(scene),
        "degrees": degrees,
        "words": list(options.words),
        "static": len(scene.static),
        "slots": scene.dynamic.node.shape[1],
        "nodes": 0 if scene.scaffold is None else scene.scaffold.xyz.shape[1],
        "pairs": layout["pairNode"][2],
        "layout": layout,
        "motion": base64.b64encode(gzip.compress(motion, mtime=0)).decode(),
        "splats": base64.b64encode(pack_spz(stored, positions)).decode(),
    }
    room = Path(__file__).parent
    page = Template((room / "viewer.html").read_text(encoding="utf-8")).substitute(
        name=html.escape(scene.name),
        reach=f"up to {degrees:.3g}°{why}",
        data=json.dumps(data).replace("<", "\\u003c"),  # a word cannot end the script
        script=(room / "viewer.js").read_text(encoding="utf-8"),
    )
    with replace_file(path) as file:
        file.write(page.encode(errors="backslashreplace"))
    return positions.notes


def believed_degrees(scene: Scene) -> float:
    """Return the degrees off the path to which the fit can be believed; `DEGREES` where nothing tells."""
    believed = scene.provenance.get("believed_degrees")
    return float(believed) if isinstance(believed, int | float) and 0 <= believed < 90 else DEGREES


def _stored(scene: Scene) -> Splats:
    """Return all Gaussians as the file stores them, dynamic ones at their reference times, with the colour of the middle camera."""
    middle = len(scene.cameras) // 2
    colour = scene.colors(scene.posed(float(scene.cameras.times[middle])), scene.cameras[middle])
    opacities, _ = scene.full_appearance
    parts = (scene.static, scene.dynamic)
    means, quats, scales = (np.concatenate([getattr(p, name) for p in parts]) for name in ("means", "quats", "scales"))
    return Splats(means, quats, scales, opacities, spherical_harmonics.dc_from_rgb(colour)[:, None])


def _motion(scene: Scene, options: PageOptions) -> dict[str, np.ndarray]:
    """Return arrays of the motion: node poses (T,M,7) at clip frames, inverse poses (P,7) at reference times, weights."""
    dynamic, scaffold = scene.dynamic, scene.scaffold
    marks = np.array([*options.words.values()], np.uint8)
    spans = [
        np.tile(np.array([-1e9, -1e9, 1e9, 1e9], np.float32), (len(part), 1))
        if part.span is None
        else np.clip(part.span, -1e9, 1e9)
        for part in (scene.static, dynamic)
    ]
    arrays = {"span": np.concatenate(spans) if scene.fades else np.zeros(0), "marks": marks}
    if scaffold is None:
        return {name: np.zeros(0) for name in ("poses", "inverse", "pairNode", "index", "weight", "strength")} | arrays
    pairs = pairs_of(dynamic.node, dynamic.reference)
    then = quaternion.normalize(scaffold.quat[pairs.reference, pairs.node])
    poses = [node_poses_at(scaffold.times, scaffold.xyz, scaffold.quat, float(time)) for time in scene.cameras.times]
    return {
        "poses": np.stack([np.concatenate([quat, xyz], axis=1) for xyz, quat in poses]),
        "inverse": np.concatenate(pose.invert(then, scaffold.xyz[pairs.reference, pairs.node]), axis=1),
        "pairNode": pairs.node,
        "index": pairs.index,
        "weight": dynamic.weight,
        "strength": dynamic.strength,
    } | arrays


def _joined(arrays: Mapping[str, np.ndarray]) -> tuple[dict[str, tuple[str, int, int]], bytes]:
    """Return name -> (kind, first byte, how many numbers) and the bytes; each array starts at a multiple of 4."""
    layout, data = {}, b""
    for name, values in arrays.items():
        kind = {"pairNode": "u", "index": "u", "marks": "b"}.get(name, "f")
        layout[name] = (kind, len(data), values.size)
        data += values.astype(KINDS[kind]).tobytes()
        data += bytes(-len(data) % 4)
    return layout, data


def _centre_depth(scene: Scene) -> float:
    """Return the distance from the middle camera about which one looks aside: 1, or that of a foreign file's scene."""
    if "import" not in scene.provenance:
        return 1.0
    camera = scene.cameras[len(scene.cameras) // 2]
    depth = scene.static.means @ camera.world_to_camera[2, :3] + camera.world_to_camera[2, 3]
    return float(np.median(depth[depth > 0])) if (depth > 0).any() else 1.0
