"""Nothing to draw.

Hard: no Gaussian at all, all behind the camera, all off the picture, all invisible.

Why: empty lists, empty sorts, gradients of sums over nothing.

Must hold: a black picture, alpha 0, gradients 0.
"""

from benchmarks.studies.hard_cases import that

from .common.drawing import GRADIENTS, backends, differentiate, torch, wavy

STAGE = "raster"


def check():
    none = {k: v[:0] if k in GRADIENTS[:5] else v for k, v in wavy().items()}
    behind, beside, unseen = wavy(), wavy(), wavy()
    behind["means"][:, 2] *= -1
    beside["means"][:, 0] += 100
    unseen["opacities"] = torch.zeros_like(unseen["opacities"])
    for what, scene in {"no Gaussian": none, "behind": behind, "beside": beside, "invisible": unseen}.items():
        for backend in backends():
            out, gradients = differentiate(scene, backend)
            black = not out.channels.any() and not out.alpha.any() and not out.visible.any()
            still = all(g is None or not g.any() for g in gradients.values())
            yield that(f"{what}: black, without gradients", black and still, backend)
