"""All weights zero.

Hard: learnt corrections cancel every weight of a Gaussian, or no slot of it is valid.

Why: weights are divided by their sum.

Must hold: such a Gaussian stays where it was at its reference time, and gradients are finite.
"""

import numpy as np

from benchmarks.studies.hard_cases import that, within

from .common.carrying import _by_library, _by_torch, carry_plainly, differentiate, torch, turning

STAGE = "deformation"


def check():
    carried = turning(1.0)
    mask = carried.mask.copy()
    mask[:30] = False
    mask[30:, 1:] = False
    on_node = np.zeros_like(carried.leaves["local_xyz"])
    dw = np.full_like(carried.leaves["dw"], -1 - 1e-6)  # the raw weight on the node itself is 1 + floor
    carried = carried.with_(mask=mask, local_xyz=on_node, dw=dw.astype(np.float32).astype(float))
    (there, _), _ = differentiate(carry_plainly, carried, 0.0, torch.float64)
    for name, function in {"torch": _by_torch, "native": _by_library}.items():
        (places, _), gradients = differentiate(function, carried, 4.0, torch.float32)
        yield within("without a slot it stays", abs(places - there)[:30].max(), 1e-6, name)
        yield that("finite where corrections cancel", np.isfinite(places).all(), name)
        yield that("gradients are finite", all(np.isfinite(g).all() for g in gradients.values()), name)
