"""Poses of what a rendered scene moves: closed-form paths of cameras and bodies, the same on every machine.

Bodies fall and bounce by gravity without a simulation: the height is that of a bouncing point plus however far the turned
body reaches below its centre, so nothing sinks into the ground or floats when at rest.
"""

from __future__ import annotations

import numpy as np

from ..geometry import quaternion
from ..geometry.interpolation import interpolate
from .rendered_scenes import CameraMove, RenderedScene, Swing, Way

GRAVITY = 9.81  # metres per second squared
RESTITUTION = 0.45  # speed after a bounce, of that before it
QUARTER_TURNS = 2  # a falling body tumbles so often by 90 degrees before it rests on a side
TREMBLE_FRAMES = 7  # a hand's tremble is correlated over about so many frames


def camera_poses(scene: RenderedScene, times: np.ndarray, seed: int) -> tuple[np.ndarray, np.ndarray]:
    """Return the position (T,3) and target (T,3) of the camera at `times` (T,) 0..1; times beyond the clip go on."""
    move, focus = scene.camera, np.array([0.0, 0.0, scene.focus_height])
    position, target = _smooth_path(move, focus, times)
    tremble = _tremble(times, seed)
    reach = np.linalg.norm(target - position, axis=1, keepdims=True)
    return position + move.tremble * tremble[:, :3], target + move.tremble / 3 * reach * tremble[:, 3:]


def _smooth_path(move: CameraMove, focus: np.ndarray, times: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the camera's path without the tremble of the hand."""
    length, zero = move.path * move.distance, np.zeros_like(times)
    start = np.array([0.0, -move.distance, move.height])
    if move.kind == "sweep":
        moved = np.stack([length * (times - 0.5), 0.15 * length * np.sin(2.2 * times), 0.08 * length * times], 1)
        return start + moved, focus + np.stack([0.3 * moved[:, 0], zero, zero], 1)
    if move.kind == "walk":
        bob = 0.02 * np.sin(4 * np.pi * times)
        moved = np.stack([0.06 * length * np.sin(3 * times), length * times, bob], 1)
        return start + moved, start + moved + np.array([0.0, 10.0, 10.0 * (focus[2] - move.height) / move.distance])
    if move.kind == "orbit":
        angle = move.path * (times - 0.5)
        around = move.distance * np.stack([np.sin(angle), -np.cos(angle), zero], 1)
        return around + np.array([0.0, 0.0, move.height]), np.broadcast_to(focus, around.shape)
    if move.kind == "pan":
        angle = np.radians(move.turn) * (times - 0.5)
        position = start + np.stack([length * (times - 0.5), zero, zero], 1)
        ahead = move.distance * np.stack([np.sin(angle), np.cos(angle), zero], 1)
        return position, position + ahead + np.array([0.0, 0.0, focus[2] - move.height])
    raise ValueError(f"no camera path of kind {move.kind}")


def _tremble(times: np.ndarray, seed: int) -> np.ndarray:
    """Smooth noise (T,6) of standard deviation 1."""
    random = np.random.default_rng([seed, 1]).normal(size=(len(times) + TREMBLE_FRAMES - 1, 6))
    kernel = np.hanning(TREMBLE_FRAMES + 2)[1:-1]
    kernel /= np.linalg.norm(kernel)
    return np.stack([np.convolve(column, kernel, "valid") for column in random.T], 1)


def body_poses(way: Way, corners: np.ndarray, times: np.ndarray, seconds: float) -> tuple[np.ndarray, np.ndarray]:
    """Return the position (T,3) of a body's centre and its quaternion wxyz (T,4) at `times` (T,) 0..1 of a clip that long.

    `corners` (n,3) are the body's vertices about its centre, at rest upright; the lowest one touches the ground z = 0
    unless the body hops, falls or swings.
    """
    stops = np.array(way.stops, float)
    ground = np.stack([interpolate(stops[:, 0], stops[:, 1:], time) for time in times])  # (T,2)
    if way.swing is not None:
        return _swung(way.swing, ground, -corners[:, 2].min(), times)
    turns = quaternion.from_rotation_vector(np.radians(way.turn) * times[:, None] * np.array([0.0, 0.0, 1.0]))
    clock = np.maximum(times, 0) * seconds
    if way.rolls:
        turns = quaternion.multiply(turns, _rolled(ground, np.ptp(corners[:, 2]) / 2))
    elif way.drop > 0:
        turns = quaternion.multiply(turns, _tumbled(clock, way.drop))
    height = _bounced(clock, way.drop)
    hops, high = way.hops
    height = height + high * np.abs(np.sin(np.pi * hops * times))
    lowest = quaternion.rotate(turns[:, None], corners[None]).min(axis=1)[:, 2]
    return np.column_stack([ground, height - lowest]), turns


def _rolled(ground: np.ndarray, radius: float) -> np.ndarray:
    """Return the quaternions (T,4) of a ball that rolls along (T,2) without slipping."""
    steps = np.diff(ground, axis=0)
    turns = [np.array([1.0, 0.0, 0.0, 0.0])]
    for x, y in steps:  # the axis lies across the way
        turns.append(quaternion.multiply(quaternion.from_rotation_vector(np.array([-y, x, 0.0]) / radius), turns[-1]))
    return np.stack(turns)


def _swung(swing: Swing, ground: np.ndarray, below: float, times: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return centre (T,3) and quaternion (T,4) of a body, `below` from centre to base, that swings above `ground` (T,2) along x."""
    angle = np.radians(swing.degrees) * np.sin(2 * np.pi * swing.times * times)
    hung = swing.lowest + below + swing.length
    centre = np.column_stack([ground, np.full(len(times), hung)])
    centre += swing.length * np.stack([np.sin(angle), np.zeros_like(angle), -np.cos(angle)], 1)
    return centre, quaternion.from_rotation_vector(angle[:, None] * np.array([0.0, -1.0, 0.0]))


def _bounced(clock: np.ndarray, drop: float) -> np.ndarray:
    """Return the height (T,) of a point that falls from `drop` at second 0 and bounces until it rests."""
    if drop <= 0:
        return np.zeros_like(clock)
    height, begin, speed = np.zeros_like(clock), np.sqrt(2 * drop / GRAVITY), np.sqrt(2 * GRAVITY * drop)
    falling = clock < begin
    height[falling] = drop - GRAVITY / 2 * clock[falling] ** 2
    while speed > 0.2:  # slower bounces are lower than 2 mm
        speed *= RESTITUTION
        since, lasts = clock - begin, 2 * speed / GRAVITY
        flying = (since >= 0) & (since < lasts)
        height[flying] = speed * since[flying] - GRAVITY / 2 * since[flying] ** 2
        begin += lasts
    return height


def _tumbled(clock: np.ndarray, drop: float) -> np.ndarray:
    """Return the quaternions (T,4) of a body that tumbles while it bounces and comes to rest on a side."""
    rests = np.sqrt(2 * drop / GRAVITY) * (1 + 2 * RESTITUTION + 2 * RESTITUTION**2)
    left = 1 - np.clip(clock / rests, 0, 1)  # 1 at the start, 0 at rest
    angle = -np.pi / 2 * QUARTER_TURNS * left**1.5
    return quaternion.from_rotation_vector(angle[:, None] * np.array([0.8, 0.6, 0.0]))
