"""From lifted tracks to a finished scaffold in one call."""

from dataclasses import dataclass, field, replace

import numpy as np

from ..geometry.camera import CameraPath
from ..progress import Progress, silent
from .lifting import LiftedTracks
from .optimise import GeometryConfig, optimise_geometry
from .selection import Selection, SelectionConfig, choose_nodes, scaffold_of
from .structure import Scaffold


@dataclass(frozen=True)
class ScaffoldConfig:
    """Everything between lifted tracks and a scaffold."""

    tolerance: float = 0.01
    """Wanted residual of held-out tracks: world units, or pixels when cameras are given."""
    selection: SelectionConfig = field(default_factory=SelectionConfig)
    geometry: GeometryConfig = field(default_factory=GeometryConfig)
    """Its `graph` is replaced by that of `selection`: there is one graph."""


def build_scaffold(
    lifted: LiftedTracks,
    times: np.ndarray,
    config: ScaffoldConfig | None = None,
    cameras: CameraPath | None = None,
    progress: Progress = silent,
) -> tuple[Scaffold, Selection]:
    """Return the optimised scaffold and the evidence for its number of nodes, see `choose_nodes`."""
    config = config or ScaffoldConfig()
    selection = choose_nodes(lifted, times, config.tolerance, config.selection, cameras)
    scaffold = scaffold_of(lifted, selection.index, times, selection.unit, config.selection)
    geometry = replace(config.geometry, graph=config.selection.graph)
    return optimise_geometry(scaffold, geometry, progress), selection
