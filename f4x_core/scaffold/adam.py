"""Adam with the groups, the state and the checkpoints of `torch.optim.Adam`.

Making that one loads torch's compiler: a second of processor time and 70 MB in every process that fits.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from typing import Any

import torch
from torch import Tensor

from ..native.adam import ADAM, take_steps
from ..native.kernels import TORCH, Kernels

KEEP_MEAN, KEEP_SQUARE = 0.9, 0.999
"""Decay of the moments per step (Kingma and Ba 2015)."""
MOMENTS = ("exp_avg", "exp_avg_sq")
ADAM_EPSILON = 1e-15
"""3DGS uses this instead of Adam's 1e-8: many gradients are far smaller than that."""


class Adam:
    """One group per tensor: a dict of its `params` (one), its rate `lr` and perhaps its `name`.

    `state`: tensor -> `step`, `exp_avg` and `exp_avg_sq`, from its first gradient on.
    """

    def __init__(self, groups: Iterable[dict[str, Any]], kernels: Kernels = TORCH):
        """Optimise the tensors of `groups` by what `kernels` say: the compiled library (float32 on the CPU) or torch."""
        self.param_groups = [dict(group) for group in groups]
        self.kernels = kernels
        self.state: dict[Tensor, dict[str, Any]] = {}
        self._problems: dict[Tensor, Any] = {}

    def step(self, reach: Mapping[str, Tensor] | None = None, caps: Mapping[str, Tensor] | None = None) -> None:
        """Move every tensor that has a gradient, then forget the gradients.

        Args:
            reach: by the name of a group, (rows,) factors of the steps of its tensor's rows.
            caps: by the name of a group, (rows,) what no value of its tensor's rows exceeds afterwards.
        """
        problems = []
        for group in self.param_groups:
            value = group["params"][0]
            gradient, value.grad = value.grad, None
            if gradient is None:
                continue
            name, state = group.get("name", ""), self._state_of(value)
            state["step"] += 1
            rows = (reach or {}).get(name), (caps or {}).get(name)
            if not self.kernels.native:
                _plain_step(value, gradient, state, group["lr"], *rows)
            elif value.numel():
                problems.append(self._problem(value, gradient.contiguous(), group["lr"], *rows))
        if problems:
            take_steps(problems, self.kernels.threads)

    def _state_of(self, value: Tensor) -> dict[str, Any]:
        if value not in self.state:
            moments = {name: torch.zeros_like(value) for name in MOMENTS}
            self.state[value] = {"step": 0, **moments}
        return self.state[value]

    def _problem(self, value: Tensor, gradient: Tensor, rate: float, reach: Tensor | None, cap: Tensor | None) -> Any:
        """Return the kernel's struct, kept from step to step."""
        state, rows = self.state[value], len(value)
        step = state["step"]
        changing: dict[str, Any] = {
            "rate": rate / (1 - KEEP_MEAN**step),
            "root_correction": math.sqrt(1 - KEEP_SQUARE**step),
        }
        changing |= {"gradient": gradient.view(rows, -1), "reach": reach, "cap": cap}
        known = self._problems.get(value)
        if known is not None:
            ADAM.refill(known, **changing)
            return known
        fixed: dict[str, Any] = {"rows": rows, "width": value.numel() // rows, "epsilon": ADAM_EPSILON}
        moments = {"mean": state["exp_avg"].view(rows, -1), "square": state["exp_avg_sq"].view(rows, -1)}
        fixed |= {"keep_mean": KEEP_MEAN, "keep_square": KEEP_SQUARE, "value": value.detach().view(rows, -1)}
        self._problems[value] = ADAM(**fixed, **moments, **changing)
        return self._problems[value]

    def replace(self, group: dict[str, Any], values: Tensor, change_moment: Any) -> Tensor:
        """Put a new leaf with `values` in place of a group's tensor, its moments changed alike; returns the leaf."""
        old = group["params"][0]
        new = values.clone().requires_grad_(True)
        state = self.state.pop(old, None)
        self._problems.pop(old, None)
        if state is not None:
            self.state[new] = state | {name: change_moment(state[name]) for name in MOMENTS}
        group["params"] = [new]
        return new

    def state_dict(self) -> dict[str, Any]:
        """Return the state of every tensor by the place of its group, for checkpoints."""
        tensors = [group["params"][0] for group in self.param_groups]
        return {"state": {place: dict(self.state[t]) for place, t in enumerate(tensors) if t in self.state}}

    def load_state_dict(self, saved: Mapping[str, Any]) -> None:
        """Take over what `state_dict` returned; that of `torch.optim.Adam` is read, too."""
        tensors = [group["params"][0] for group in self.param_groups]
        self._problems.clear()
        self.state = {
            tensors[place]: {"step": int(state["step"]), **{name: state[name].clone() for name in MOMENTS}}
            for place, state in saved["state"].items()
        }


@torch.no_grad()
def _plain_step(
    value: Tensor, gradient: Tensor, state: dict[str, Any], rate: float, reach: Tensor | None, cap: Tensor | None
) -> None:
    mean, square, step = state["exp_avg"], state["exp_avg_sq"], state["step"]
    mean.lerp_(gradient, 1 - KEEP_MEAN)
    square.mul_(KEEP_SQUARE).addcmul_(gradient, gradient, value=1 - KEEP_SQUARE)
    change = mean / (square.sqrt() / math.sqrt(1 - KEEP_SQUARE**step) + ADAM_EPSILON)
    by_row = (len(value),) + (1,) * (value.ndim - 1)
    if reach is not None:
        change *= reach.view(by_row)
    value -= rate / (1 - KEEP_MEAN**step) * change
    if cap is not None:
        torch.minimum(value, cap.view(by_row), out=value)
