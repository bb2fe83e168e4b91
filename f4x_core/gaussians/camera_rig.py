"""The cameras that are optimised beside Gaussians: small corrections to the poses of a known path."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
import torch
from torch import Tensor
from torch.autograd.function import once_differentiable

from ..geometry.camera import Camera, CameraPath

SMALL_ANGLE = 1e-2
"""Radians below which a series replaces the quotients of a rotation's derivative."""


class CorrectedView(torch.autograd.Function):
    """The view of one frame, (4,4): its prior one, turned by a rotation vector and moved by a position in the camera frame.

    Arguments: rotation vectors (F,3) and positions (F,3) of all frames, their prior world_to_camera (F,4,4), which has no
    gradient, and the number of the frame. In plain numbers: dozens of operators on a few of them each, and their gradients,
    are several per cent of a step.
    """

    @staticmethod
    def forward(ctx, rotations: Tensor, positions: Tensor, base: Tensor, frame: int) -> Tensor:
        """Return the corrected matrix, in the precision of `base`."""
        vector, before = rotations[frame].tolist(), base[frame, :3].numpy().astype(float)  # (3,), (3,4)
        turned = _turn(vector) @ before
        after = base[frame].numpy().copy()
        after[:3] = turned
        after[:3, 3] += positions[frame].numpy()
        ctx.vector, ctx.turned, ctx.frame, ctx.frames = vector, turned, frame, len(rotations)
        return torch.from_numpy(after)

    @staticmethod
    @once_differentiable
    def backward(ctx, sent: Tensor) -> Any:
        """Return the gradients of the rotation vectors and the positions: zero but for the frame's."""
        slope = sent.numpy()[:3].astype(float)
        # A small rotation w after the present one changes the loss by the sum of a * [w].
        (_, a01, a02), (a10, _, a12), (a20, a21, _) = (slope @ ctx.turned.T).tolist()
        about = [a21 - a12, a02 - a20, a10 - a01]
        v, angle = ctx.vector, math.hypot(*ctx.vector)
        # The transposed left Jacobian of SO(3): how far the rotation goes for a change of its vector.
        small = angle < SMALL_ANGLE
        first = 0.5 - angle**2 / 24 if small else (1 - math.cos(angle)) / angle**2
        second = 1 / 6 - angle**2 / 120 if small else (angle - math.sin(angle)) / angle**3
        across = _cross(v, about)
        twice = _cross(v, across)
        gradients = sent.new_zeros(2, ctx.frames, 3)
        turning = [about[k] - first * across[k] + second * twice[k] for k in range(3)]
        gradients[:, ctx.frame] = sent.new_tensor([turning, slope[:, 3].tolist()])
        return *gradients, None, None


def _turn(vector: Sequence[float]) -> np.ndarray:
    """Return (3,3) the rotation by a rotation vector (Rodrigues)."""
    x, y, z = vector
    angle = math.hypot(x, y, z)
    small = angle < SMALL_ANGLE
    first = 1 - angle**2 / 6 + angle**4 / 120 if small else math.sin(angle) / angle
    second = 0.5 - angle**2 / 24 + angle**4 / 720 if small else (1 - math.cos(angle)) / angle**2
    across = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    return np.eye(3) + first * across + second * (across @ across)


def _cross(a: Sequence[float], b: Sequence[float]) -> list[float]:
    return [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]


class CameraSmoothness(torch.autograd.Function):
    """Mean over frames of the squared second differences of rows (F,n), summed over n; F is at least 3. In numpy, see above."""

    @staticmethod
    def forward(ctx, *parts: Tensor) -> Tensor:
        """Return the sum of the means of all `parts`, a scalar."""
        rows = [part.numpy() for part in parts]
        bends = [own[2:] - 2 * own[1:-1] + own[:-2] for own in rows]
        ctx.bends = bends
        return parts[0].new_tensor(sum(float((bend * bend).sum()) for bend in bends) / len(bends[0]))

    @staticmethod
    @once_differentiable
    def backward(ctx, factor: Tensor) -> Any:
        """Return the gradients of the rows."""
        gradients = []
        for bend in ctx.bends:
            slope, gradient = (
                bend * (2 * float(factor) / len(bend)),
                np.zeros((len(bend) + 2, bend.shape[1]), bend.dtype),
            )
            gradient[2:] = slope
            gradient[1:-1] -= 2 * slope
            gradient[:-2] += slope
            gradients.append(torch.from_numpy(gradient))
        return tuple(gradients)


class CameraRig:
    """Per-frame camera poses as small corrections to the priors' path.

    Parameters: `camera_rotation` (F,3) rotation vectors and `camera_position` (F,3) translations, both in the camera frame and
    applied after the prior pose. Intrinsics stay those of the priors.
    """

    def __init__(self, path: CameraPath):
        """Start at the priors' path of the F supervised frames."""
        count = len(path)
        self.path = path
        self.base = torch.from_numpy(path.world_to_camera.astype(np.float32))  # (F,4,4)
        self.base_intrinsics = torch.from_numpy(path.intrinsics.astype(np.float32))  # (F,3,3)
        self._resampled: dict[tuple[int, int], Tensor] = {}
        self.parameters = {
            "camera_rotation": torch.zeros(count, 3, requires_grad=True),
            "camera_position": torch.zeros(count, 3, requires_grad=True),
        }

    def view(self, frame: int) -> Tensor:
        """Return (4,4) world_to_camera of supervised frame `frame`, float32, differentiable."""
        own = (self.parameters[name] for name in ("camera_rotation", "camera_position"))
        return CorrectedView.apply(*own, self.base, frame)

    def intrinsics(self, frame: int, width: int, height: int) -> Tensor:
        """Return (3,3) intrinsics in pixels of the frame resampled to width x height."""
        if (width, height) not in self._resampled:
            ratio = self.base.new_tensor([[width / self.path.width], [height / self.path.height], [1.0]])
            self._resampled[width, height] = self.base_intrinsics * ratio
        return self._resampled[width, height][frame]

    def camera(self, frame: int, width: int, height: int) -> Camera:
        """Return the camera of supervised frame `frame` for images of width x height; its pose is differentiable."""
        return Camera(self.intrinsics(frame, width, height), self.view(frame), width, height)

    def smoothness(self) -> Tensor:
        """Return the mean squared second difference of the corrections, in radians (positions: world units at depth 1)."""
        if len(self.path) < 3:
            return self.base.new_zeros(())
        return CameraSmoothness.apply(self.parameters["camera_rotation"], self.parameters["camera_position"])

    def refined(self) -> CameraPath:
        """Return the path with its corrections folded in."""
        with torch.no_grad():
            matrices = torch.stack([self.view(i) for i in range(len(self.path))]).double().numpy()
        # float32 rotations are not orthonormal to float64 precision; the nearest rotation is.
        u, _, vt = np.linalg.svd(matrices[:, :3, :3])
        matrices[:, :3, :3] = u @ vt
        intrinsics = self.base_intrinsics.double().numpy()
        return CameraPath(intrinsics, matrices, self.path.times, self.path.width, self.path.height)
