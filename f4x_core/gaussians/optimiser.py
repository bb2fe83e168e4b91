"""Adam over a Gaussian set, whose moments stay aligned when Gaussians are added or removed."""

import math
from collections.abc import Callable

import torch
from torch import Tensor

from ..native.kernels import TORCH, Kernels
from ..scaffold.adam import Adam
from .parameters import GaussianSet


class SetOptimiser:
    """Adam with one group per named tensor, and the only place where rows are added or removed."""

    def __init__(self, gaussians: GaussianSet, rates: dict[str, float], kernels: Kernels = TORCH):
        """Optimise `gaussians.parameters`; `rates` names the learning rate of each tensor, `kernels` what computes a step."""
        self.gaussians = gaussians
        groups = [
            {"params": [tensor], "lr": rates[name], "name": name} for name, tensor in gaussians.parameters.items()
        ]
        self.adam = Adam(groups, kernels)
        self.max_scale = math.inf
        """Standard deviations never exceed this fraction of the reach: what is larger is fog."""
        self._caps: tuple[Tensor, Tensor] | None = None

    def set_rates(self, rates: dict[str, float]) -> None:
        """Change the learning rates of all tensors."""
        for group in self.adam.param_groups:
            group["lr"] = rates[group["name"]]

    def step(self) -> None:
        """Take one Adam step on the gradients there are; then forget them.

        Rates of places are those at depth 1: a Gaussian is moved by its `reach` times as much, so that all move equally far in
        the picture. In world units what is near would shake by pixels while what is far stands still.
        """
        reach = self.gaussians.labels["reach"]
        self.adam.step({self.place: reach}, {"log_scales": self._cap_of(reach)})

    def _cap_of(self, reach: Tensor) -> Tensor:
        """Return (N,) logarithms of the largest standard deviations."""
        if self._caps is None or self._caps[0] is not reach:  # rows were added or removed
            self._caps = reach, (self.max_scale * reach).log()
        return self._caps[1]

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
                widened = self.adam.replace(
                    group, values, lambda moment: torch.cat([moment, torch.zeros_like(more)], 1)
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
            self.gaussians.parameters[name] = self.adam.replace(group, values, change_moment)
