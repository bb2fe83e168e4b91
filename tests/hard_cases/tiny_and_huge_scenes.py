"""Pictures of scenes a thousand times smaller and larger.

Hard: a splat file in millimetres or in kilometres, its camera and near plane with it.

Why: lengths that are built in - floors, near planes - are a thousand times off; squares of small numbers underflow.

Must hold: the picture is that of the same scene in its own unit, gradients are those of float64.
"""

from benchmarks.speed.raster import draw
from benchmarks.studies.hard_cases import within
from f4x_core.raster import RasterConfig

from .common.drawing import backends, compare, wavy

STAGE = "raster"


def check():
    scene = wavy()
    for scale in (1e-3, 1e3):
        scaled = scene | {"means": scale * scene["means"], "scales": scale * scene["scales"]}
        config = RasterConfig(near=0.01 * scale)
        yield from compare(scaled, gradient=2e-4, config=config)
        for backend in backends():
            same = draw(**scene, backend=backend).alpha - draw(**scaled, backend=backend, config=config).alpha
            yield within(f"scale {scale:g}: the same alpha", same.abs().flatten().quantile(0.999), 2e-5, backend)
