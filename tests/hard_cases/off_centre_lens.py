"""A principal point outside the picture.

Hard: a crop from the corner of a larger picture: the optical axis is not in it.

Why: frustum clamps that assume a centred lens cut off or smear what is seen.

Must hold: picture and gradients are those of float64.
"""

from .common.drawing import HEIGHT, WIDTH, compare, wavy

STAGE = "raster"


def check():
    scene = wavy()
    scene["K"][0, 2], scene["K"][1, 2] = 1.5 * WIDTH, -0.5 * HEIGHT
    scene["means"][:, 0] -= scene["means"][:, 2] * 1.0 * WIDTH / scene["K"][0, 0]
    scene["means"][:, 1] += scene["means"][:, 2] * 1.0 * HEIGHT / scene["K"][1, 1]
    yield from compare(scene)
