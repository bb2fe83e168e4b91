"""Deformation: nodes carry Gaussians through time; in three forms.

`reference` is the plain form, numpy; `sparse` that of the fit, one sparse product per step, torch; `native` the compiled one,
for numpy arrays (`native.library`) and for tensors (`native.autograd`). What is exported here needs numpy alone.
"""

from .native.library import move_gaussians
from .reference import (
    COLLAPSED,
    SIGN_BAND,
    Pairs,
    align_signs,
    blend,
    blend_reference,
    deform,
    interpolation_stencil,
    motions_to,
    node_poses_at,
    pairs_of,
    relative_motions,
)

__all__ = [
    "COLLAPSED",
    "SIGN_BAND",
    "Pairs",
    "align_signs",
    "blend",
    "blend_reference",
    "deform",
    "interpolation_stencil",
    "motions_to",
    "move_gaussians",
    "node_poses_at",
    "pairs_of",
    "relative_motions",
]
