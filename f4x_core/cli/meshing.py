"""`f4x mesh`."""

from __future__ import annotations

import argparse
from typing import Any

import numpy as np

from ..app.selecting import read_selection, select
from ..edit.apply import edited, open_scene
from ..edit.bake import bake
from ..edit.meshing import advising
from ..errors import F4xError
from ..geometry.arrays import evenly_spaced
from ..language.lexicon import plural
from ..progress import Progress
from ..scene import Scene
from ..scene.formats.gltf_mesh import require_glb, write_gltf_mesh
from ..scene.mesh import MeshConfig, SplatMesh, deviation, mesh_of
from ..scene.posing import require_time
from .querying import MARKS, wanted_of

MOMENTS = 30
"""Clip frames at most at which the linear blend of other programs is compared with the scene's own."""


def run_mesh(args: argparse.Namespace, progress: Progress) -> dict[str, Any]:
    """Write a mesh around what is selected, skinned by the nodes that carry it."""
    require_glb(args.output)
    config = MeshConfig(args.resolution, args.faces, args.level, hollows=args.hollows)
    scene = open_scene(args.scene, args.edits)
    if args.time is not None:
        require_time(scene, args.time, f"--time {args.time:g}")
    ids = _ids_of(scene, args, progress)
    with advising(scene):
        scene = edited(bake(scene)) if scene.edits else scene
        mesh = mesh_of(scene, np.isin(scene.ids, ids), args.time, config, progress)
    args.output.parent.mkdir(parents=True, exist_ok=True)
    write_gltf_mesh(scene, mesh, args.output)
    return _told(scene, mesh, args)


def _ids_of(scene: Scene, args: argparse.Namespace, progress: Progress) -> np.ndarray:
    """Return the ids of the Gaussians that the arguments select; all of them where nothing is given."""
    prompts = [f"--{name}" for name in MARKS if getattr(args, name) is not None]
    if args.select is not None:
        if prompts:
            raise F4xError(f"--select FILE is a whole selection; leave out {' and '.join(prompts)}.")
        selection = read_selection(args.select)
        selection.require_scene(scene)
    elif prompts:
        selection = select(scene, wanted_of(scene, args), args.backend, progress).selection
    else:
        return scene.ids
    if not len(selection.chosen_ids):
        raise F4xError(f"{selection.label or 'the selection'}: no Gaussian is selected; try `f4x query` first.")
    return selection.chosen_ids


def _told(scene: Scene, mesh: SplatMesh, args: argparse.Namespace) -> dict[str, Any]:
    """Print and return the counts of the mesh, and how far other programs will be off."""
    result: dict[str, Any] = {
        "output": str(args.output),
        "vertices": len(mesh.vertices),
        "faces": len(mesh.faces),
        "parts": mesh.parts,
        "size": mesh.size,
        "nodes": 0,
    }
    text = f"{args.output}: {len(mesh.faces):,} triangles in {mesh.parts} {plural('part', mesh.parts)}"
    if mesh.skin is None or scene.scaffold is None:
        return {**result, "text": f"{text}; nothing of it moves"}
    times = scene.cameras.times
    times = times[evenly_spaced(len(times), MOMENTS)]
    off = deviation(mesh.vertices.astype(np.float64), mesh.skin, scene.scaffold, times) / mesh.size
    result |= {
        "nodes": len(mesh.skin.joints()[0]),
        "time": mesh.skin.time,
        "linear_blend_off": {"mean": float(off.mean()), "p99": float(np.quantile(off, 0.99)), "max": float(off.max())},
    }
    text += (
        f", as at frame {mesh.skin.time:g}, carried by {result['nodes']} nodes; linear skinning in other programs is off by"
        f" {off.mean():.2%} of its size on average, {np.quantile(off, 0.99):.1%} for the worst hundredth"
    )
    return {**result, "text": text}
