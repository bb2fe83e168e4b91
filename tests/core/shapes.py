"""Scenes of known shapes: flat opaque Gaussians on spheres, cubes and planes."""

from dataclasses import replace

import numpy as np
from random_scene import random_scaffold, random_scene

from f4x_core.geometry import quaternion
from f4x_core.scene import DynamicSet, StaticSet

RADIUS, CENTRE = 0.5, np.array([0.2, -0.1, 2.0])


def looking_along(normals):
    """(N,4) wxyz that turn z to `normals (N,3)`."""
    axis = np.cross([0, 0, 1.0], normals)
    sine = np.linalg.norm(axis, axis=1, keepdims=True)
    angle = np.arctan2(sine, normals[:, 2:])
    return quaternion.from_rotation_vector(np.where(sine > 1e-9, axis / np.maximum(sine, 1e-9), [1.0, 0, 0]) * angle)


def discs(points, normals, size, ids=0):
    """Flat opaque Gaussians on a surface, as arrays of a set."""
    count = len(points)
    return {
        "ids": np.arange(ids, ids + count),
        "means": points.astype(np.float32),
        "quats": looking_along(normals).astype(np.float32),
        "scales": np.tile([size, size, size / 20], (count, 1)).astype(np.float32),
        "opacities": np.full(count, 0.9, np.float32),
        "sh": np.tile(np.array([1.0, 0, -1], np.float32), (count, 1, 1)),
    }


def sphere(count=1500):
    """Points and normals spread evenly over a sphere."""
    z = 1 - 2 * (np.arange(count) + 0.5) / count
    angle = np.arange(count) * np.pi * (3 - 5**0.5)
    normals = np.stack([np.sqrt(1 - z * z) * np.cos(angle), np.sqrt(1 - z * z) * np.sin(angle), z], 1)
    return CENTRE + RADIUS * normals, normals


def box(count=16):
    """Points and normals of a cube of side 1."""
    side = (np.arange(count) + 0.5) / count - 0.5
    u, v = (part.ravel() for part in np.meshgrid(side, side))
    points, normals = [], []
    for axis in range(3):
        for sign in (-1, 1):
            face = np.insert(np.stack([u, v], 1), axis, sign / 2, axis=1)
            points.append(CENTRE + face)
            normals.append(np.tile(sign * np.eye(3)[axis], (len(face), 1)))
    return np.concatenate(points), np.concatenate(normals)


def static_scene(points, normals, size):
    return replace(random_scene(degree=0, dynamic=0), static=StaticSet(**discs(points, normals, size)))


def carried_sphere(seed=1, strength=1.0, nodes=5):
    """A sphere that nodes around it bend: each Gaussian follows its three nearest by distance."""
    rng = np.random.default_rng(seed)
    scaffold = random_scaffold(rng, nodes)
    scaffold.xyz[:] = scaffold.xyz - scaffold.xyz[2] + CENTRE + RADIUS * rng.normal(size=(nodes, 3)).astype(np.float32)
    points, normals = sphere()
    distance = np.linalg.norm(points[:, None] - scaffold.xyz[2], axis=2)
    node = np.argsort(distance, axis=1)[:, :3]
    weight = np.exp(-(np.take_along_axis(distance, node, 1) ** 2) / 0.2)
    dynamic = DynamicSet(
        **discs(points, normals, 0.035, 1000),
        reference=np.full(len(points), 2, np.int32),
        node=node.astype(np.int32),
        weight=(weight / weight.sum(1, keepdims=True)).astype(np.float32),
        strength=np.full(len(points), strength, np.float32),
    )
    return replace(random_scene(degree=0, dynamic=0), dynamic=dynamic, scaffold=scaffold)


def plane(count=60, depth=2.0):
    """Points of a square of side 2 that faces along z, and their normals."""
    side = (np.arange(count) + 0.5) * 2 / count - 1
    u, v = (part.ravel() for part in np.meshgrid(side, side))
    return np.stack([u, v, np.full_like(u, depth)], 1), np.tile([0.0, 0, -1], (len(u), 1))
