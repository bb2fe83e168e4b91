"""Adam over a Gaussian set, whose moments stay aligned when Gaussians are added or removed."""

import math
from collections.abc import Callable, Mapping
from typing import Any

import torch
from torch import Tensor

from ..native.adam import ADAM, F4X_ADAM
from ..native.kernels import TORCH, Kernels
from .parameters import GaussianSet

# 3DGS uses this instead of Adam's 1e-8: many gradients are far smaller than that.
ADAM_EPSILON = 1e-15


class SetOptimiser:
    """`torch.optim.Adam` with one group per named tensor, and the only place where rows are added or removed."""

    def __init__(self, gaussians: GaussianSet, rates: dict[str, float], kernels: Kernels = TORCH):
        """Optimise `gaussians.parameters`; `rates` names the learning rate of each tensor, `kernels` what computes a step."""
        self.gaussians, self.kernels = gaussians, kernels
        groups = [
            {"params": [tensor], "lr": rates[name], "name": name} for name, tensor in gaussians.parameters.items()
        ]
        self.adam = torch.optim.Adam(groups, eps=ADAM_EPSILON, fused=True)

    def set_rates(self, rates: dict[str, float]) -> None:
        """Change the learning rates of all tensors."""
        for group in self.adam.param_groups:
            group["lr"] = rates[group["name"]]

    def step(self) -> None:
        """One Adam step on whatever gradients there are; then forget them.

        Rates of places are those at depth 1: a Gaussian is moved by its `reach` times as much, so that all move equally far in
        the picture. In world units what is near would shake by pixels while what is far stands still.
        """
        if self.kernels.native:
            native_step(self.adam, self.kernels.threads, {self.place: self.gaussians.labels["reach"]})
            return
        place = self.gaussians.parameters[self.place]
        before = place.detach().clone()
        self.adam.step()
        with torch.no_grad():
            place.copy_(torch.lerp(before, place, self.gaussians.labels["reach"][:, None]))
        self.adam.zero_grad(set_to_none=True)

    @property
    def place(self) -> str:
        """The name of the tensor of places."""
        return "local_means" if "local_means" in self.gaussians.parameters else "means"

    def keep(self, index: Tensor) -> None:
        """Keep only the rows `index` (int64), in that order."""
        self._rebuild(lambda tensor: tensor[index], lambda moment: moment[index])
        self.gaussians.labels = {name: label[index] for name, label in self.gaussians.labels.items()}

    def append(self, parameters: dict[str, Tensor], labels: dict[str, Tensor]) -> None:
        """Add rows; their moments start at zero."""
        for name, label in self.gaussians.labels.items():
            self.gaussians.labels[name] = torch.cat([label, labels[name]])
        added = len(labels["ids"])
        self._rebuild(
            lambda tensor: tensor,
            lambda moment: torch.cat([moment, moment.new_zeros(added, *moment.shape[1:])]),
            parameters,
        )

    def add_band(self, plain: Tensor, more: Tensor) -> None:
        """Add `plain (N,1,3)` to the first coefficient of the harmonics and the band `more (N,n,3)` behind the last one."""
        with torch.no_grad():
            self.gaussians.parameters["sh0"] += plain
        for group in self.adam.param_groups:
            if group["name"] == "shN":
                values = torch.cat([self.gaussians.parameters["shN"].detach(), more], 1)
                widened = replace_parameter(
                    self.adam, group, values, lambda moment: torch.cat([moment, torch.zeros_like(more)], 1)
                )
                self.gaussians.parameters["shN"] = widened

    def forget(self, name: str) -> None:
        """Zero the moments of one tensor (after its values were set from outside)."""
        state = self.adam.state.get(self.gaussians.parameters[name], {})
        for moment in ("exp_avg", "exp_avg_sq"):
            if moment in state:
                state[moment].zero_()

    def _rebuild(
        self,
        change: Callable[[Tensor], Tensor],
        change_moment: Callable[[Tensor], Tensor],
        added: dict[str, Tensor] | None = None,
    ) -> None:
        for group in self.adam.param_groups:
            name = group["name"]
            values = change(self.gaussians.parameters[name].detach())
            if added is not None:
                values = torch.cat([values, added[name].detach()])
            self.gaussians.parameters[name] = replace_parameter(self.adam, group, values, change_moment)


def native_step(adam: torch.optim.Adam, threads: int, reach: Mapping[str, Tensor] | None = None) -> None:
    """`adam.step()` by the compiled library, then forget the gradients; float32 on the CPU, groups of one named tensor.

    `reach`: by the name of a tensor, (N,) factors by which its rows move.
    """
    for group in adam.param_groups:
        value = group["params"][0]
        gradient, value.grad = value.grad, None
        if gradient is None:
            continue
        state = adam.state[value]
        if not state:
            state["step"] = torch.zeros(())
            state["exp_avg"], state["exp_avg_sq"] = (torch.zeros_like(value) for _ in range(2))
        state["step"] += 1
        if not value.numel():
            continue
        step, (first, second), rows = int(state["step"]), group["betas"], len(value)
        arrays = value.detach(), gradient.contiguous(), state["exp_avg"], state["exp_avg_sq"]
        flat = zip(("value", "gradient", "mean", "square"), (each.view(rows, -1) for each in arrays), strict=True)
        problem = ADAM(
            rows=rows,
            width=value.numel() // rows,
            threads=threads,
            rate=group["lr"] / (1 - first**step),
            root_correction=math.sqrt(1 - second**step),
            keep_mean=first,
            keep_square=second,
            epsilon=group["eps"],
            reach=reach.get(group["name"]) if reach else None,
            **dict(flat),
        )
        F4X_ADAM(problem)


def replace_parameter(
    adam: torch.optim.Adam, group: dict[str, Any], values: Tensor, change_moment: Callable[[Tensor], Tensor]
) -> Tensor:
    """Put a new leaf with `values` in place of a group's only tensor, its moments changed alike; returns the leaf."""
    old = group["params"][0]
    new = values.clone().requires_grad_(True)
    state = adam.state.pop(old, {})
    if state:
        state["exp_avg"] = change_moment(state["exp_avg"])
        state["exp_avg_sq"] = change_moment(state["exp_avg_sq"])
        adam.state[new] = state
    group["params"] = [new]
    return new
