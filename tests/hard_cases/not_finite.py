"""Gaussians that are not finite.

Hard: a NaN or an infinity in a mean, a quaternion, a size, an opacity or a colour.

Why: one NaN spreads over every pixel behind it, and by the gradients over the whole scene.

Must hold: such Gaussians are left out and counted; picture and gradients are those of the others.
"""

from benchmarks.studies.hard_cases import that, within

from .common.drawing import GRADIENTS, backends, differentiate, torch, wavy

STAGE = "raster"


def check():
    scene = wavy()
    kept = ~torch.isin(torch.arange(len(scene["means"])), torch.tensor([5, 40]))
    clean = {k: v[kept] if k in GRADIENTS[:5] else v for k, v in scene.items()}
    for backend in backends():
        true, _ = differentiate(clean, backend)
        for name in GRADIENTS[:5]:
            broken = scene | {name: scene[name].clone()}
            broken[name].view(len(kept), -1)[[5, 40], -1] = torch.tensor([float("nan"), float("inf")])
            out, gradients = differentiate(broken, backend)
            error = (out.channels - true.channels).detach().abs().max()
            yield within(f"{name}: the picture of the others", error, 1e-6, backend)
            finite = all(g.isfinite().all() for g in gradients.values())
            yield that(f"{name}: two are counted, gradients are finite", out.dropped == 2 and finite, backend)
