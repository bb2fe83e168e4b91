"""Quaternions of any length.

Hard: the optimiser's quaternions are a millionth of a unit long, or ten thousand units.

Why: squares of small numbers underflow, and a gradient across the quaternion is as much larger as it is shorter.

Must hold: the picture does not depend on the length; gradients are finite.
"""

from benchmarks.studies.hard_cases import that, within

from .common.drawing import backends, differentiate, wavy

STAGE = "raster"


def check():
    scene = wavy()
    for backend in backends():
        plain = differentiate(scene, backend)[0].channels
        for length in (1e-6, 1e-3, 1e4):
            out, gradients = differentiate(scene | {"quats": scene["quats"] * length}, backend)
            yield within(
                f"length {length:g}: the same picture", (out.channels - plain).detach().abs().max(), 1e-5, backend
            )
            yield that("gradients are finite", all(g.isfinite().all() for g in gradients.values()), backend)
