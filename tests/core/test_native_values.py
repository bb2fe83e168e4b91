"""Every exported function of the library against stored values of the float64 formulas, with numpy alone.

The values travel to platforms that have no torch to work them out. Where torch is, they are worked out anew and compared.
"""

import re
from pathlib import Path

import numpy as np
import pytest

from f4x_core.native import binder, instruction_set, measure_peak
from f4x_core.native.appearance import APPEARANCE, F4X_APPEARANCE, F4X_APPEARANCE_BACKWARD
from f4x_core.native.binder import DOUBLE
from f4x_core.native.library import SOURCES
from f4x_core.native.picture import F4X_PICTURE_LOSS, PICTURE
from f4x_core.raster.native import library as raster
from f4x_core.scaffold.deformation.native import library as deformation

STORED = Path(__file__).with_name("native_values.npz")
ERROR = 2e-5
"""Relative L2 error that float32 may have, as in the tests of gradients."""
STRUCTURE = 0.3
LEAVES = ("xyz", "quat", "dw", "node_xyz", "node_quat", "radius", "now_xyz", "now_quat")
EXPORT = re.compile(r"^F4X_API [^(]*?(f4x_\w+)\(", re.MULTILINE)


class Watched:
    """The library, and which of its functions were asked for."""

    def __init__(self, library):
        self.library, self.asked = library, set()

    def __getattr__(self, name):
        self.asked.add(name)
        return getattr(self.library, name)


def relative(got, expected):
    return float(np.linalg.norm(got - expected) / np.linalg.norm(expected))


def errors(got, expected):
    return {name: relative(got[name], value) for name, value in expected.items()}


def part(stored, kind):
    return {name.removeprefix(kind): value for name, value in stored.items() if name.startswith(kind)}


def colours(given):
    """Colours and gradients of Gaussians, with two threads."""
    count, coefficients, _ = given["sh"].shape
    sizes = {"count": count, "coefficients": coefficients, "threads": 2, "centre": tuple(given["centre"])}
    arrays = {name: given[name] for name in ("sh", "means", "quats")}
    got = {"colors": np.empty_like(given["means"])}
    F4X_APPEARANCE(APPEARANCE(**sizes, **arrays, **got))
    gradients = {"d_" + name: np.empty_like(value) for name, value in arrays.items()}
    F4X_APPEARANCE_BACKWARD(APPEARANCE(**sizes, **arrays, sent=given["sent"], **gradients))
    return got | gradients


def picture_loss(given):
    """Loss of two pictures and its gradient."""
    height, width, channels = given["image"].shape
    c1, c2, structure = map(float, given["constants"])
    gradient, total = np.empty_like(given["image"]), DOUBLE()
    problem = PICTURE(
        width=width,
        height=height,
        channels=channels,
        threads=2,
        stride=channels,
        **{name: given[name] for name in ("image", "target", "weight", "window")},
        c1=c1,
        c2=c2,
        structure=structure,
        gradient=gradient,
    )
    assert F4X_PICTURE_LOSS(problem, total) == 0
    return {"total": np.array(total.value), "gradient": gradient}


def moved(given):
    """Moved Gaussians and the gradients of all that moves them."""
    tables = deformation.relate(given)
    posed = given | {"nodes": tables[0], "motions": tables[1:]}
    means, quats = deformation.forward(posed, "sigma", 2)
    got = deformation.backward(posed, "sigma", 2, given["sent_means"], given["sent_quats"])
    got |= deformation.relate_backward(given, got["tables"])
    unit = given["now_quat"]
    got["now_quat"] -= (got["now_quat"] * unit).sum(-1, keepdims=True) * unit  # along it, it means nothing
    return {"means": means, "quats": quats} | {"d_" + name: got[name] for name in LEAVES}


def test_every_exported_function_gives_the_stored_values(native_library, monkeypatch):
    watched = Watched(native_library)
    monkeypatch.setattr(binder, "require_library", lambda: watched)
    with np.load(STORED) as file:
        stored = dict(file)
    for kind, function in (("colours", colours), ("picture", picture_loss), ("moved", moved)):
        found = errors(function(part(stored, f"{kind}_in_")), part(stored, f"{kind}_out_"))
        assert found and max(found.values()) < ERROR, (kind, found)
    assert raster.self_check(watched) < raster.SELF_CHECK_ERROR
    pairs = raster.count_pairs(watched, raster.forward(watched, opaque_square(), keep=True))
    assert pairs == SQUARE_PAIRS
    assert instruction_set(watched) in ("avx512", "avx2", "plain")
    assert 1e6 < measure_peak(watched, 0.01) < 1e13
    exported = {name for source in SOURCES for name in EXPORT.findall(source.read_text(encoding="utf-8"))}
    assert watched.asked == exported and len(exported) == 13


SQUARE_PAIRS = 9
"""One Gaussian over the middle of a picture of 3 x 3 pixels, so wide that it reaches all of them."""


def opaque_square():
    from f4x_core.geometry.camera import Camera
    from f4x_core.geometry.splats import Splats
    from f4x_core.raster.contract import RasterConfig, RasterInput

    camera = Camera(np.array([[3.0, 0, 1.5], [0, 3, 1.5], [0, 0, 1]]), np.eye(4), 3, 3)
    one = Splats(np.array([[0, 0, 1.0]]), np.array([[1.0, 0, 0, 0]]), np.full((1, 3), 3.0), np.array([0.5]))
    return RasterInput(one, np.ones((1, 1)), camera, config=RasterConfig(threads=1))


def test_the_stored_values_are_those_of_the_formulas():
    pytest.importorskip("torch")
    made = make_values()
    with np.load(STORED) as file:
        assert set(file) == set(made)
        for name, value in made.items():
            np.testing.assert_allclose(file[name], value, rtol=1e-9, atol=1e-12, err_msg=name)


def make_values():
    """Content of native_values.npz; `python tests/core/test_native_values.py` writes it."""
    groups = {"colours": values_of_colours(), "picture": values_of_pictures(), "moved": values_of_motion()}
    return {
        f"{kind}_{way}_{name}": value
        for kind, ways in groups.items()
        for way, named in zip(("in", "out"), ways, strict=True)
        for name, value in named.items()
    }


def leaf(array):
    import torch

    return torch.tensor(array, dtype=torch.float64, requires_grad=True)


def values_of_colours():
    import torch

    from f4x_core.gaussians import appearance

    rng = np.random.default_rng(1)
    shapes = {"sh": (37, 16, 3), "means": (37, 3), "quats": (37, 4), "sent": (37, 3)}
    given = {name: rng.normal(size=shape).astype(np.float32) for name, shape in shapes.items()}
    given["centre"] = np.float32([0.2, -0.1, -4.0])
    leaves = {name: leaf(given[name]) for name in ("sh", "means", "quats")}
    got = appearance(*leaves.values(), torch.tensor(given["centre"], dtype=torch.float64))
    got.backward(torch.tensor(given["sent"], dtype=torch.float64))
    gradients = {"d_" + name: value.grad.numpy() for name, value in leaves.items()}
    return given, {"colors": got.detach().numpy()} | gradients


def values_of_pictures():
    import torch

    from f4x_core.fit import losses

    rng = np.random.default_rng(2)
    shapes = {"image": (21, 33, 3), "target": (21, 33, 3), "weight": (21, 33)}
    given = {name: rng.uniform(size=shape).astype(np.float32) for name, shape in shapes.items()}
    given["window"] = losses._window(torch.float32).numpy()
    given["constants"] = np.array([losses.SSIM_C1, losses.SSIM_C2, STRUCTURE])
    image = leaf(given["image"])
    target, weight = (torch.tensor(given[name], dtype=torch.float64) for name in ("target", "weight"))
    total = losses.rgb_loss(image, target, weight, STRUCTURE) * weight.sum()
    total.backward()
    return given, {"total": total.detach().numpy(), "gradient": image.grad.numpy()}


def values_of_motion():
    import torch
    from test_scaffold_native import FRAMES, NODES, make, plain

    from f4x_core.geometry import quaternion
    from f4x_core.scaffold.deformation.sparse import Deformer

    leaves, carried = make(number=29, slots=4, times=2, with_dw=True, seed=3)
    leaves["now_quat"] = quaternion.normalize(leaves["now_quat"])
    deformer = Deformer(np.arange(FRAMES), carried["reference"], carried["neighbours"], NODES)
    rng = np.random.default_rng(4)
    given = leaves | {"node": deformer.node.numpy(), "then": deformer.then.numpy(), "mask": carried["mask"]}
    given |= {"index": deformer.pairs.index, "sent_means": rng.normal(size=(2, 29, 3)).astype(np.float32)}
    given["sent_quats"] = rng.normal(size=(2, 29, 4)).astype(np.float32)
    tensors = {name: leaf(value) for name, value in leaves.items()}
    means, quats = (torch.stack(both) for both in zip(*plain(tensors, carried, "sigma"), strict=True))
    sent = [torch.tensor(given[name], dtype=torch.float64) for name in ("sent_means", "sent_quats")]
    torch.autograd.backward([means, quats], sent)
    gradients = {"d_" + name: value.grad.numpy() for name, value in tensors.items()}
    return given, {"means": means.detach().numpy(), "quats": quats.detach().numpy()} | gradients


if __name__ == "__main__":
    np.savez_compressed(STORED, **make_values())
