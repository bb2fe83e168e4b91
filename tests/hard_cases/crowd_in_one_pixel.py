"""Twenty thousand Gaussians on one spot.

Hard: all project to one pixel, each half opaque.

Why: the light is used up after 13 of them; the rest must neither overflow a buffer nor take for ever nor get NaN gradients.

Must hold: the front ones decide, and those behind get a gradient of exactly 0.
"""

from benchmarks.speed.raster import draw
from benchmarks.studies.hard_cases import that, within

from .common.drawing import backends, torch, wavy

STAGE = "raster"
COUNT = 20_000


def check():
    scene = wavy(1, 9, 9) | {
        "means": torch.tensor([[0.0, 0.0, 2.0]]).repeat(COUNT, 1),
        "quats": torch.tensor([[1.0, 0, 0, 0]]).repeat(COUNT, 1),
        "scales": torch.full((COUNT, 3), 1e-4),
        "opacities": torch.full((COUNT,), 0.5),
    }
    for backend in backends():
        colors = torch.zeros(COUNT, 1)
        colors[:13] = 1.0  # 1 - 2^-13 of the light ends in these; the 14th would go below 1e-4
        out = draw(**scene | {"colors": colors.requires_grad_()}, backend=backend)
        error = (out.channels[4, 4, 0] - out.alpha[4, 4]).detach().abs()
        yield within("the front thirteen are the picture", error, 1e-6, backend)
        out.channels.sum().backward()
        gradient = colors.grad
        front = gradient.isfinite().all() and gradient[0] > gradient[1] > 0
        yield that("gradients fall off from front to back, 0 behind", front and not gradient[5000:].any(), backend)
