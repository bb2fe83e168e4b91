"""The deformation of `reference` for the fit: one sparse product per step, with hand-written gradients.

The blend is `A @ table` with a CSR matrix `A (N, P)` of signed weights; its gradient to the table is the product with
the transposed matrix, and its gradient to the weights is the dot product of each stored entry's row and column. Both
structures depend only on the topology and are built once.
"""

import warnings
from functools import cached_property

import numpy as np
import torch

from ...geometry import dual_quaternion, quaternion
from ..skinning import Kernel, SkinningWeights, skinning_weights
from .reference import COLLAPSED, SIGN_BAND, node_poses_at, pairs_of

with warnings.catch_warnings():
    # torch announces once per process that CSR tensors are in beta; nobody can act on it, so nobody sees it.
    warnings.simplefilter("ignore")
    torch.zeros(1, 1).to_sparse_csr()


def _times(a: torch.Tensor, b: torch.Tensor) -> torch.Tensor:
    """Return the Hamilton product of component-first quaternions `(4, N)`.

    `geometry.quaternion.multiply` on `(N, 4)` strides through memory; in the inner loop of the fit that costs twice.
    """
    aw, ax, ay, az = a
    bw, bx, by, bz = b
    return torch.stack(
        [
            aw * bw - ax * bx - ay * by - az * bz,
            aw * bx + ax * bw + ay * bz - az * by,
            aw * by - ax * bz + ay * bw + az * bx,
            aw * bz + ax * by - ay * bx + az * bw,
        ]
    )


def _conjugate(a: torch.Tensor) -> torch.Tensor:
    return torch.cat([a[:1], -a[1:]])


class SparseRows:
    """The fixed sparsity of an `(N, P)` matrix with K entries per row, and of its transpose."""

    def __init__(self, index: np.ndarray, columns: int, device: torch.device | str = "cpu"):
        """Take `index (N, K)` as the columns of each row's entries; the same column may occur twice in a row."""
        rows, slots = index.shape
        flat = index.reshape(-1)
        order = np.argsort(flat, kind="stable")
        self.shape = (rows, columns)
        self.slots = slots
        self.starts = _int32(np.arange(0, rows * slots + 1, slots), device)
        self.columns = _int32(flat, device)
        self.order = _int32(order, device)
        self.transposed_starts = _int32(np.concatenate([[0], np.bincount(flat, minlength=columns).cumsum()]), device)
        self.transposed_columns = _int32(order // slots, device)

    def matrix(self, values: torch.Tensor) -> torch.Tensor:
        """Return the CSR matrix with `values (N, K)`."""
        return torch.sparse_csr_tensor(
            self.starts, self.columns, values.reshape(-1), self.shape, check_invariants=False
        )

    def transposed(self, values: torch.Tensor) -> torch.Tensor:
        """Return the CSR matrix `(P, N)`, the transpose of `matrix(values)`."""
        values = values.reshape(-1).index_select(0, self.order)
        return torch.sparse_csr_tensor(
            self.transposed_starts,
            self.transposed_columns,
            values,
            (self.shape[1], self.shape[0]),
            check_invariants=False,
        )


class _Product(torch.autograd.Function):
    """`A(values) @ dense` for a fixed sparsity."""

    @staticmethod
    def forward(ctx, values: torch.Tensor, dense: torch.Tensor, structure: SparseRows) -> torch.Tensor:
        ctx.save_for_backward(values, dense)
        ctx.structure = structure
        return structure.matrix(values) @ dense

    @staticmethod
    @torch.autograd.function.once_differentiable
    def backward(ctx, gradient):
        values, dense = ctx.saved_tensors
        gradient = gradient.contiguous()
        d_values = d_dense = None
        if ctx.needs_input_grad[0]:
            pattern = ctx.structure.matrix(values)
            dots = torch.sparse.sampled_addmm(pattern, gradient, dense.T.contiguous(), beta=0.0)
            d_values = dots.values().view_as(values)
        if ctx.needs_input_grad[1]:
            d_dense = ctx.structure.transposed(values) @ gradient
        return d_values, d_dense, None


class _Gather(torch.autograd.Function):
    """`dense[index]` as `(N, K, C)`; its gradient is a sparse product instead of a scatter."""

    @staticmethod
    def forward(ctx, dense: torch.Tensor, structure: SparseRows) -> torch.Tensor:
        ctx.structure = structure
        return dense.index_select(0, structure.columns).view(-1, structure.slots, dense.shape[1])

    @staticmethod
    @torch.autograd.function.once_differentiable
    def backward(ctx, gradient):
        s = ctx.structure
        entries = gradient.reshape(-1, gradient.shape[-1]).contiguous()  # (N K, C)
        ones = torch.ones(len(entries), dtype=entries.dtype, device=entries.device)
        gather = torch.sparse_csr_tensor(
            s.transposed_starts, s.order, ones, (s.shape[1], len(entries)), check_invariants=False
        )
        return gather @ entries, None


class _RelativeMotions(torch.autograd.Function):
    """Dual quaternions `(P, 8)` of `Q_now Q_then^-1` from unit ones: `(q r*, q d_r* + d_q r*)`, bilinear in both."""

    @staticmethod
    def forward(ctx, now: torch.Tensor, then: torch.Tensor) -> torch.Tensor:
        now, then = now.T.contiguous(), then.T.contiguous()  # (8, P)
        ctx.save_for_backward(now, then)
        q, d, r, e = now[:4], now[4:], _conjugate(then[:4]), _conjugate(then[4:])
        return torch.cat([_times(q, r), _times(q, e) + _times(d, r)]).T.contiguous()

    @staticmethod
    @torch.autograd.function.once_differentiable
    def backward(ctx, gradient):
        # <g, a b*> = <g b, a> = <g* a, b>
        now, then = ctx.saved_tensors
        gradient = gradient.T.contiguous()
        q, d, r, e = now[:4], now[4:], then[:4], then[4:]
        g, h = gradient[:4], gradient[4:]
        gc, hc = _conjugate(g), _conjugate(h)
        d_now = torch.cat([_times(g, r) + _times(h, e), _times(h, r)])
        d_then = torch.cat([_times(gc, q) + _times(hc, d), _times(hc, q)])
        return d_now.T.contiguous(), d_then.T.contiguous()


class _Decode(torch.autograd.Function):
    """Blended `(N, 8)` and strength `(N,)` to `(q (N, 4), t (N, 3))`: `q = P / n`, `t = 2 vec(D P*) / n^2`.

    The projection of D in `dual_quaternion.normalize` drops out of t because `vec(P P*) = 0`.
    """

    @staticmethod
    def forward(ctx, blended: torch.Tensor, strength: torch.Tensor | None):
        blended = blended.T.contiguous()  # (8, N)
        faded, factor = blended, None
        if strength is not None:
            factor = torch.where(blended[0] < 0, -strength, strength)  # to the identity's hemisphere
            faded = blended * factor
            faded[0] += 1 - strength
        real, dual = faded[:4], faded[4:]
        squared = (real * real).sum(0)
        collapsed = squared <= COLLAPSED**2
        squared = torch.where(collapsed, 1.0, squared)
        q = real * squared.rsqrt()
        t = _times(dual, _conjugate(real))[1:] * (2 / squared)
        if collapsed.any():
            q[:, collapsed] = torch.eye(4, 1, dtype=q.dtype, device=q.device)
            t[:, collapsed] = 0.0
        ctx.save_for_backward(blended, factor, faded, squared, collapsed, q, t)
        return q.T, t.T

    @staticmethod
    @torch.autograd.function.once_differentiable
    def backward(ctx, g_q, g_t):
        blended, factor, faded, squared, collapsed, q, t = ctx.saved_tensors
        g_q, g_t = g_q.T.contiguous(), g_t.T.contiguous()
        real, dual = faded[:4], faded[4:]
        double = 2 / squared
        product = torch.nn.functional.pad(g_t * double, (0, 0, 1, 0))  # (4, N), gradient of D P*
        d_real = _times(_conjugate(product), dual)
        d_real += (g_q - q * (q * g_q).sum(0)) * squared.rsqrt()
        d_real -= real * (double * (g_t * t).sum(0))
        gradient = torch.cat([d_real, _times(product, real)])
        if collapsed.any():
            gradient[:, collapsed] = 0.0
        if factor is None:
            return gradient.T.contiguous(), None
        d_strength = torch.where(blended[0] < 0, -1.0, 1.0) * (blended * gradient).sum(0) - gradient[0]
        return (gradient * factor).T.contiguous(), d_strength


class Deformer:
    """Moves Gaussians with the scaffold, every step of the fit; built anew only when the topology changes.

    Differentiable in node poses, weights and strength. Any floating dtype; tensors on `device`.
    """

    def __init__(
        self,
        times: np.ndarray,
        reference: np.ndarray | torch.Tensor,
        neighbours: np.ndarray | torch.Tensor,
        nodes: int,
        device: torch.device | str = "cpu",
    ):
        """Pair each Gaussian with its nodes at its reference time.

        `neighbours (N, K)` are node indices, each Gaussian's attach node first.

        `times (F,)` of the scaffold, `reference (N,)` indices into it, `nodes` the number M of nodes in it.
        """
        self.times = np.asarray(times, np.float64)
        neighbours, reference = _numpy(neighbours), _numpy(reference)
        pairs = pairs_of(neighbours, reference)
        self.pairs = pairs
        self.node = torch.as_tensor(pairs.node, device=device)  # (P,)
        self.then = torch.as_tensor(pairs.reference * nodes + pairs.node, device=device)  # (P,) row of (F M)
        self._neighbours, self._nodes, self._device = neighbours, nodes, device

    # Built when first used: the compiled library does without.

    @cached_property
    def structure(self) -> SparseRows:
        """Indices of the pairs that each Gaussian follows."""
        return SparseRows(self.pairs.index, len(self.pairs.node), self._device)

    @cached_property
    def neighbour_structure(self) -> SparseRows:
        """Indices of the nodes that each Gaussian follows."""
        return SparseRows(self._neighbours, self._nodes, self._device)

    @cached_property
    def edges(self) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
        """Table rows `(E,)` of attach node and neighbour for every different two, and the edge `(N K,)` of each slot.

        The signs of equal edges are equal, and there are fewer edges than slots.
        """
        index, stride = self.pairs.index, max(len(self.pairs.node), 1)
        edges, edge_of_slot = np.unique(index[:, :1].astype(np.int64) * stride + index, return_inverse=True)
        attach, slot = (torch.as_tensor(part, device=self._device) for part in (edges // stride, edges % stride))
        return attach, slot, torch.as_tensor(edge_of_slot.reshape(-1), device=self._device)

    def __call__(
        self,
        scaffold_xyz: torch.Tensor,
        scaffold_quat: torch.Tensor,
        weights: torch.Tensor,
        strength: torch.Tensor | None,
        time: float,
    ) -> tuple[torch.Tensor, torch.Tensor]:
        """Return the motion `(q (N, 4)` unit `, t (N, 3))` from each Gaussian's reference time to `time`.

        `scaffold_xyz (F, M, 3)`, `scaffold_quat (F, M, 4)` of any length, `weights (N, K)`, `strength (N,)` or None
        for 1 (which also skips the blend with the identity).
        """
        table = self.relative_motions(scaffold_xyz, scaffold_quat, time)
        blended = _Product.apply(weights * self.slot_signs(table), table, self.structure)
        if strength is not None and bool((strength == 1).all()) and not strength.requires_grad:
            strength = None
        return _Decode.apply(blended, strength)

    def relative_motions(self, xyz: torch.Tensor, quat: torch.Tensor, time: float) -> torch.Tensor:
        """Return the table `(P, 8)` of unit dual quaternions, see `reference.relative_motions`."""
        x_now, q_now = node_poses_at(self.times, xyz, quat, time)
        x_then = xyz.reshape(-1, 3).index_select(0, self.then)
        q_then = quaternion.normalize(quat.reshape(-1, 4).index_select(0, self.then))
        now = dual_quaternion.from_pose(q_now, x_now).index_select(0, self.node)
        return _RelativeMotions.apply(now, dual_quaternion.from_pose(q_then, x_then))

    def slot_signs(self, table: torch.Tensor) -> torch.Tensor:
        """Return `(N, K)` +1 or -1, without gradient, see `reference.slot_signs`."""
        real = table.detach()[:, :4]
        attach, slot, edge_of_slot = self.edges
        dots = (real.index_select(0, attach) * real.index_select(0, slot)).sum(1)
        signs = torch.where(dots < -SIGN_BAND, -1.0, 1.0).to(table.dtype)
        return signs.index_select(0, edge_of_slot).view(-1, self.structure.slots)

    def skinning(
        self,
        means: torch.Tensor,
        scaffold_xyz: torch.Tensor,
        radius: torch.Tensor,
        mask: torch.Tensor,
        dw: torch.Tensor | None = None,
        kernel: Kernel = "sigma",
    ) -> SkinningWeights:
        """Return what `skinning_weights` returns, with fast gradients.

        `means (N, 3)` are the Gaussians in the world at their own reference time, `radius (M,)`, `mask (N, K)`.
        """
        node_x = _Gather.apply(scaffold_xyz.reshape(-1, 3).index_select(0, self.then), self.structure)
        node_radius = _Gather.apply(radius[:, None], self.neighbour_structure)[..., 0]
        return skinning_weights(means, node_x, node_radius, mask, dw, kernel)


def _int32(array: np.ndarray, device: torch.device | str) -> torch.Tensor:
    """Return CSR indices of 32 bits, which the sparse kernels take without a copy."""
    return torch.as_tensor(np.ascontiguousarray(array, np.int32), device=device)


def _numpy(array: np.ndarray | torch.Tensor) -> np.ndarray:
    return array.detach().cpu().numpy() if isinstance(array, torch.Tensor) else np.asarray(array)
