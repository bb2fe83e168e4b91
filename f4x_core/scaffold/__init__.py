"""The motion scaffold: a few nodes with SE(3) trajectories, their graph, and how they carry Gaussians.

`structure`, `skinning`, `deformation` and `radius` need numpy alone; `lifting` and `graph` also scipy inside functions;
`deformation.sparse`, `deformation.native.autograd`, `losses` and `optimise` need torch.
"""

from .structure import Scaffold

__all__ = ["Scaffold"]
