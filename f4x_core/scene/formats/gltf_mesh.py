"""glTF 2.0 with a skinned mesh of some of a scene's Gaussians: joints are the scaffold's nodes, keyed at every clip frame.

A reader of glTF blends the joints' matrices linearly, with eight of them at most for a vertex; the scene blends dual quaternions
(`scene.mesh.deviation` tells how far apart these are). Axes are y up: data are turned on the way out, no node is.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from ...errors import F4xError
from ...files import replace_file
from ...geometry import pose, quaternion
from ...scaffold import Scaffold
from ...scaffold.deformation import node_poses_at
from ..color import linear_from_srgb
from ..mesh import SplatMesh
from ..model import Scene
from ..posing import Y_UP, similarity_of
from .gltf import ARRAY_BUFFER, FLOAT, UINT, USHORT, GltfBuffer, glb

ELEMENT_ARRAY_BUFFER, TRIANGLES = 34963, 4
IN_A_SET = 4
"""Joints that one attribute JOINTS_n holds."""


def write_gltf_mesh(scene: Scene, mesh: SplatMesh, path: Path | str) -> None:
    """Write `mesh` of `scene` as .glb: a static one alone, a skinned one with its joints and their motion over the clip.

    Raises F4xError for another ending and beyond 4 GiB.
    """
    path = Path(path)
    require_glb(path)
    buffer = GltfBuffer()
    scaffold = scene.scaffold if mesh.skin is not None else None
    document: dict[str, Any] = {
        "asset": {"version": "2.0", "generator": "Feature4X for Blender"},
        "scene": 0,
        "scenes": [{"nodes": [0]}],
        "nodes": [{"mesh": 0, "name": scene.name}],
        "meshes": [{"name": scene.name, "primitives": [_primitive(mesh, buffer)]}],
        "materials": [
            {
                "name": scene.name,
                "doubleSided": True,
                "pbrMetallicRoughness": {"metallicFactor": 0.0, "roughnessFactor": 1.0},
            }
        ],
    }
    if scaffold is not None:
        _add_skin(document, buffer, scene, mesh, scaffold)
    document |= {"accessors": buffer.accessors, "bufferViews": buffer.views, "buffers": [{"byteLength": buffer.length}]}
    time = float(scene.cameras.times[0]) if mesh.skin is None else mesh.skin.time
    document["scenes"][0]["extras"] = {"clip_time": time, "frames_per_second": float(scene.fps)}
    data = glb(document, buffer.joined(), path)
    with replace_file(path) as file:
        file.write(data)


def require_glb(path: Path) -> None:
    """Raise F4xError for a file name that a mesh is not written to."""
    if path.suffix.lower() != ".glb":
        raise F4xError(f"-o {path}: a mesh is written as glTF; end it in .glb.")


def _primitive(mesh: SplatMesh, buffer: GltfBuffer) -> dict[str, Any]:
    """Return the triangles with colours, and with joints where the mesh has a skin."""
    turn = Y_UP[:3, :3]
    attributes = {
        "POSITION": buffer.add(mesh.vertices @ turn.T, target=ARRAY_BUFFER, bounds=True),
        "NORMAL": buffer.add(mesh.normals @ turn.T, target=ARRAY_BUFFER),
        "COLOR_0": buffer.add(linear_from_srgb(mesh.colors), target=ARRAY_BUFFER),
    }
    if mesh.skin is not None:
        _, joint, weight = mesh.skin.joints()
        for number in range(joint.shape[1] // IN_A_SET):
            columns = slice(IN_A_SET * number, IN_A_SET * (number + 1))
            attributes[f"JOINTS_{number}"] = buffer.add(joint[:, columns], USHORT, ARRAY_BUFFER)
            attributes[f"WEIGHTS_{number}"] = buffer.add(weight[:, columns], FLOAT, ARRAY_BUFFER)
    indices = buffer.add(mesh.faces.reshape(-1, 1), UINT, ELEMENT_ARRAY_BUFFER)
    return {"mode": TRIANGLES, "attributes": attributes, "indices": indices, "material": 0}


def _add_skin(document: dict[str, Any], buffer: GltfBuffer, scene: Scene, mesh: SplatMesh, scaffold: Scaffold) -> None:
    """Add the joints below one node, where they rest, and an animation that moves them; the last joint stays put."""
    assert mesh.skin is not None
    used, _, _ = mesh.skin.joints()
    times = scene.cameras.times
    rest_x, rest_q = _poses(scaffold, mesh.skin.time, used)
    moved = [_poses(scaffold, float(time), used) for time in times]
    xyz = np.stack([x for x, _ in moved])
    quat = quaternion.align_sequence(np.stack([q for _, q in moved]))
    nodes, first = document["nodes"], 2
    nodes.append({"name": f"{scene.name} scaffold", "children": [*range(first, first + len(used) + 1)]})
    document["scenes"][0]["nodes"].append(1)
    for row, node in enumerate(used):
        rest = {"translation": rest_x[row].tolist(), "rotation": rest_q[row, [1, 2, 3, 0]].tolist()}
        nodes.append({"name": f"node {scaffold.ids[node]:05d}"} | rest)
    nodes.append({"name": "stays put"})
    inverse = np.concatenate([np.linalg.inv(pose.to_matrix(rest_q, rest_x)), np.eye(4)[None]])
    inverse[:, 3] = (0, 0, 0, 1)
    nodes[0]["skin"] = 0
    document["skins"] = [
        {
            "joints": nodes[1]["children"],
            "skeleton": 1,
            "inverseBindMatrices": buffer.add(inverse.transpose(0, 2, 1)),  # columns one after the other
        }
    ]
    if len(times) < 2:
        return
    seconds = buffer.add((times - times[0])[:, None] / scene.fps, bounds=True)
    samplers: list[dict[str, Any]] = []
    channels = []
    for row in range(len(used)):
        for way, values in (("translation", xyz[:, row]), ("rotation", quat[:, row][:, [1, 2, 3, 0]])):
            samplers.append({"input": seconds, "output": buffer.add(values), "interpolation": "LINEAR"})
            channels.append({"sampler": len(samplers) - 1, "target": {"node": first + row, "path": way}})
    document["animations"] = [{"name": scene.name, "samplers": samplers, "channels": channels}]


def _poses(scaffold: Scaffold, time: float, used: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the places (J,3) and unit rotations (J,4) wxyz float64 of the `used` nodes, y up."""
    xyz, quat = node_poses_at(scaffold.times, scaffold.xyz, scaffold.quat, time)
    turn = similarity_of(Y_UP).rotation
    xyz, quat = xyz[used].astype(np.float64), quat[used].astype(np.float64)
    return xyz @ Y_UP[:3, :3].T, quaternion.normalize(quaternion.multiply(turn, quat))
