"""GLB of one moment for programs that know no splats: coloured points, and the scaffold as points and lines."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from ...errors import F4xError
from ...files import replace_file
from ...scaffold import Scaffold
from ...scaffold.deformation import node_poses_at
from ..color import linear_from_srgb
from ..model import PosedSplats
from ..posing import Y_UP, Posable, moment, plain_color

NODE_COLOR = (255, 160, 20, 255)
GRAPH_COLOR = (255, 160, 20, 90)


def write_points(scene: Posable, time: float, path: Path | str, transform: np.ndarray | None = None) -> None:
    """Write objects `static`, `dynamic` (points), `nodes` (points) and `graph` (lines), those that are there.

    `transform`: a 4x4 similarity in the scene's axes; glTF's are y up. Raises F4xError, also without trimesh.
    """
    try:
        import trimesh
    except ImportError as error:
        raise F4xError("points need the package trimesh; run pip install trimesh, or export another format") from error
    path = Path(path)
    matrix = Y_UP if transform is None else Y_UP @ np.asarray(transform, np.float64)
    posed = moment(scene, time, matrix)
    parts = {"static": posed.take(~posed.dynamic), "dynamic": posed.take(posed.dynamic)}
    model = trimesh.Scene()
    for name, part in parts.items():
        if len(part.ids):
            model.add_geometry(trimesh.PointCloud(part.means, colors=_linear_rgba(part)), name, name)
    if scene.scaffold is not None:
        nodes, lines = _graph_at(scene.scaffold, time, matrix)
        model.add_geometry(trimesh.PointCloud(nodes, colors=np.tile(NODE_COLOR, (len(nodes), 1))), "nodes", "nodes")
        if len(lines):
            graph = trimesh.load_path(nodes[lines])
            graph.colors = np.tile(GRAPH_COLOR, (len(graph.entities), 1))
            model.add_geometry(graph, "graph", "graph")
    if not model.geometry:
        raise F4xError(f"{path}: nothing is visible at clip time {time:g}; choose another")
    data = model.export(file_type="glb")
    with replace_file(path) as file:
        file.write(data)


def _linear_rgba(posed: PosedSplats) -> np.ndarray:
    """Return (N,4) uint8 as glTF's COLOR_0 wants it: linear light."""
    color = np.concatenate([linear_from_srgb(plain_color(posed)), posed.opacities[:, None]], axis=1)
    return np.rint(255 * color).astype(np.uint8)


def _graph_at(scaffold: Scaffold, time: float, matrix: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return node positions (M,3) and the pairs (L,2) of nodes that the graph joins, each once."""
    xyz, _ = node_poses_at(scaffold.times, scaffold.xyz, scaffold.quat, time)
    return xyz @ matrix[:3, :3].T + matrix[:3, 3], scaffold.edges
