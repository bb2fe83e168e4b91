"""Every exported function of the library against stored values of the float64 formulas, with numpy alone.

The values travel to platforms that have no torch to work them out. Where torch is, they are worked out anew and compared.
"""

import re
from pathlib import Path

import numpy as np
import pytest

from f4x_core.native import binder, instruction_set, measure_peak, shareable_seconds
from f4x_core.native.adam import ADAM, take_steps
from f4x_core.native.appearance import APPEARANCE, F4X_APPEARANCE, F4X_APPEARANCE_BACKWARD
from f4x_core.native.arap import ARAP, F4X_ARAP
from f4x_core.native.binder import DOUBLE
from f4x_core.native.bundle import F4X_BUNDLE_COSTS, F4X_BUNDLE_EQUATIONS, SIGHTINGS
from f4x_core.native.density import F4X_RECORD_PULLS, PULLS
from f4x_core.native.frame import F4X_FRAME_LOSSES, FRAME
from f4x_core.native.library import SOURCES
from f4x_core.native.maps import F4X_SAMPLE_MAP, F4X_SMOOTH_MAP, SAMPLES, SMOOTHING
from f4x_core.native.motion import F4X_NODE_AXES, F4X_NODE_MOTION, MOTION
from f4x_core.native.picture import F4X_PICTURE_LOSS, PICTURE
from f4x_core.native.rays import F4X_RAYS, F4X_RAYS_BACKWARD, RAYS
from f4x_core.native.sweep import F4X_BEST_PLANES, PLANES
from f4x_core.raster.native import library as raster
from f4x_core.scaffold.deformation.native import library as deformation
from f4x_core.scene.depth_order import DEPTH_ORDER, F4X_DEPTH_ORDER

STORED = Path(__file__).with_name("native_values.npz")
ERROR = 2e-5
"""Relative L2 error that float32 may have, as in the tests of gradients."""
STRUCTURE = 0.3
FRAME_CONSTANTS = {"step": 2, "moving": 3.0, "depth_factor": 0.3, "bend_factor": 2.0, "alpha_factor": 0.05}
FRAME_CONSTANTS |= {"plain": 0.04, "min_depth": 1e-3}
ADAM_CONSTANTS = {"rate": 0.02, "root_correction": 0.1, "keep_mean": 0.9, "keep_square": 0.999, "epsilon": 1e-15}
LIFE = {"time": 2.5, "whole": 0.5, "margin": 1e-4}
RAY_CONSTANTS = {"fx": 10.0, "fy": 10.0, "cx": 6.5, "cy": 4.5, "near_plane": 0.01, "alpha_min": 1e-7}
SMOOTH, SMOOTH_WEIGHTS = ("velocity", "acceleration", "spin", "spin_change"), (0.5, 0.25, 2.0, 0.125)
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


def appearance_of(given):
    """The fields of `APPEARANCE` that every pass over the Gaussians of `given` reads, with two threads."""
    first, more = given["sh"][:, 0], given["sh"][:, 1:]
    count, further, _ = more.shape
    stride = 3 * (1 + further)
    sizes = {"count": count, "coefficients": 1 + further, "more_coefficients": further, "threads": 2}
    sizes |= {
        "first_stride": stride,
        "more_stride": stride,
        "centre": tuple(given["centre"]),
        "channels": 3,
        "mark": 1.0,
    }
    return sizes | LIFE | {"first": first, "more": more, "means": given["means"], "quats": given["quats"]}


def gradients_of(given):
    """Room for the gradients of the harmonics, places and orientations, and its fields."""
    got = {"d_" + name: np.empty_like(given[name]) for name in ("sh", "means", "quats")}
    fields = {"d_first": got["d_sh"][:, 0], "d_more": got["d_sh"][:, 1:]}
    return got, fields | {name: got[name] for name in ("d_means", "d_quats")}


def colours(given):
    """Colours and gradients of Gaussians."""
    fixed = appearance_of(given)
    got = {"colors": np.empty_like(given["means"])}
    F4X_APPEARANCE(APPEARANCE(**fixed, **got))
    gradients, fields = gradients_of(given)
    F4X_APPEARANCE_BACKWARD(APPEARANCE(**fixed, sent=given["sent"], **fields))
    return got | gradients


def drawn(given):
    """Arrays of dynamic Gaussians for the raster, and the gradients of their parameters."""
    count = len(given["means"])
    named = {name: given[name] for name in ("log_scales", "logits", "log_lifetimes", "born")}
    fixed = appearance_of(given) | {"channels": 7} | named
    shapes = {"colors": (7,), "scales": (3,), "opacities": (), "drawn_means": (3,), "drawn_quats": (4,)}
    got = {name: np.empty((count, *shape), np.float32) for name, shape in shapes.items()}
    F4X_APPEARANCE(APPEARANCE(**fixed, there=given["there"], **got))
    gradients, fields = gradients_of(given)
    more = {"d_" + name: np.empty_like(given[name]) for name in ("there", "log_scales", "logits", "log_lifetimes")}
    sent = {name: value for name, value in given.items() if name.startswith("sent")}
    F4X_APPEARANCE_BACKWARD(APPEARANCE(**fixed, **sent, **fields, **more))
    return got | gradients | more


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
        factor=1.0,
        gradient_stride=channels,
        gradient=gradient,
    )
    assert F4X_PICTURE_LOSS(problem, total) == 0
    return {"total": np.array(total.value), "gradient": gradient}


def frame_losses(given):
    """The losses of a frame's pixels and their gradients, and what the picture loss needs."""
    height, width, channels = given["image"].shape
    got = {"d_" + name: np.empty_like(given[name]) for name in ("image", "depth", "alpha")}
    got["target"], got["attention"] = np.empty((height, width, 3), np.float32), np.empty((height, width), np.float32)
    problem = FRAME(width=width, height=height, channels=channels, threads=2, **FRAME_CONSTANTS, **given, **got)
    losses = np.empty(2)
    assert F4X_FRAME_LOSSES(problem, losses) == 0
    got["d_image"] = got["d_image"][..., 3:]  # the others are not written
    return got | {"losses": losses}


def adam(given):
    """A tensor and its moments after a step, cut in two tensors."""
    got = {name: given[name].copy() for name in ("mean", "square", "value")}
    problems = []
    for part in (slice(0, 30), slice(30, None)):
        rows, width = got["value"][part].shape
        arrays = {name: given[name][part] for name in ("gradient", "reach", "cap")}
        own = {name: value[part] for name, value in got.items()}
        problems.append(ADAM(rows=rows, width=width, **ADAM_CONSTANTS, **arrays, **own))
    take_steps(problems, 2)
    return got


def pulls(given):
    """Statistics of density control after a step."""
    got = {name: given[name].copy() for name in ("gradient_sum", "seen")}
    arrays = {name: given[name] for name in ("gradient", "visible")}
    F4X_RECORD_PULLS(PULLS(count=len(got["seen"]), threads=2, across=10.0, down=4.5, **arrays, **got))
    return got


def nodes_moved(given):
    """The axes of nodes, the losses of their motion, and the gradients."""
    frames, nodes, _ = given["xyz"].shape
    got = {"axes": np.empty((frames, nodes, 3, 3), np.float32)}
    sizes = {"frames": frames, "nodes": nodes, "threads": 2, **dict(zip(SMOOTH, SMOOTH_WEIGHTS, strict=True))}
    poses = {name: given[name] for name in ("xyz", "quat", "times")}
    F4X_NODE_AXES(MOTION(**sizes, **poses, **got))
    found = {"loss": np.empty(1)} | {"d_" + name: np.empty_like(given[name]) for name in ("xyz", "quat")}
    assert F4X_NODE_MOTION(MOTION(**sizes, **poses, d_axes=given["d_axes"], **found)) == 0
    return got | found


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


def as_rigid_as_possible(given):
    """Both losses of a scaffold and their gradients."""
    frames, nodes, _ = given["xyz"].shape
    got = {name: np.empty_like(given["xyz"]) for name in ("d_coordinate", "d_length")}
    got |= {"d_axes": np.empty_like(given["axes"]), "losses": np.empty(2)}
    sizes = {
        "edges": len(given["node"]),
        "leading": 20,
        "frames": frames,
        "nodes": nodes,
        "shifts": len(given["shift"]),
        "threads": 2,
    }
    assert F4X_ARAP(ARAP(**sizes, **given, **got)) == 0
    return got


def adjusted(given):
    """Costs and normal equations of a bundle whose lens zooms."""
    frames, points = len(given["center"]), len(given["homogeneous"])
    sizes = {"count": len(given["frame"]), "frames": frames, "points": points, "unknowns": 7}
    sizes |= {"centers": 1, "lens": 1, "shared": 1, "robust": 1.5, "behind": 1000.0, "min_depth": 1e-6}
    got = {"blocks": (frames, 7, 7), "slopes": (frames, 7), "coupling": (3, 7 * frames + 1, points)}
    got |= {"point_blocks": (points, 3, 3), "point_slopes": (points, 3)}
    got = {name: np.zeros(shape) for name, shape in got.items()}
    arrays = {name: array for name, array in given.items() if name != "principal"}
    sizes["principal"] = tuple(given["principal"])
    F4X_BUNDLE_EQUATIONS(SIGHTINGS(**sizes, **arrays, **got))
    costs = np.empty(frames)
    F4X_BUNDLE_COSTS(SIGHTINGS(**sizes, **arrays, costs=costs))
    return got | {"costs": costs}


def looked_up(given):
    """Samples of a map in both kinds of numbers, and the smooth map through others."""
    (height, width, channels), count = given["floats"].shape, len(given["points"])
    sizes = {"count": count, "width": width, "height": height, "channels": channels, "points": given["points"]}
    got = {name: np.empty((count, channels)) for name in ("floats", "halves")}
    for name, values in got.items():
        F4X_SAMPLE_MAP(SAMPLES(**sizes, **{name: given[name]}, values=values))
    solution = given["start"].copy()
    names = ("itself", "right", "right_two", "below", "below_two", "weight", "sample")
    arrays = {name: given[name] for name in names} | {"solution": solution}
    F4X_SMOOTH_MAP(SMOOTHING(width=6, height=5, iterations=200, tolerance=1e-12, **arrays))
    return got | {"solution": solution}


def swept(given):
    """The planes of a cost volume."""
    height, width, planes = given["costs"].shape
    got = {"place": np.empty((height, width), np.float32)}
    F4X_BEST_PLANES(PLANES(width=width, height=height, planes=planes, step=40, **given, **got))
    return got


def composited(given):
    """A picture along rays, and the gradients of what it is made of."""
    (height, width, _), count = given["d_image"].shape, len(given["means"])
    sizes = {"count": count, "width": width, "height": height, "threads": 2, **RAY_CONSTANTS}
    arrays = {name: given[name] for name in ("means", "whiten", "opacities", "radii", "boxes", "colors")}
    got = {f"d_{name}": np.empty_like(given[name]) for name in ("whiten", "opacities", "colors")}
    image = np.empty((height, width, 4), np.float32)
    F4X_RAYS(RAYS(**sizes, **arrays, image=image))
    F4X_RAYS_BACKWARD(RAYS(**sizes, **arrays, d_image=given["d_image"], **got))
    return got | {"image": image}


def ordered(watched):
    """Indices of five Gaussians, the farthest first: one is behind the near plane, one is transparent, two are as far."""
    means = np.zeros((5, 3), np.float32)
    means[:, 2] = 2, 5, 0.1, 3, 5
    order = np.empty(5, np.float32)
    arrays = {"means": means, "opacities": np.float32([0.5, 0.5, 0.5, 0, 0.5]), "order": order}
    arrays |= {"starts": np.int64([0, 3, 5]), "rows": np.float32([[0, 0, 1, 0]] * 2)}
    sizes = {"count": 5, "clouds": 2, "threads": 2, "coarse": 0, "near": 0.2, "far": 100.0, "alpha_min": 0.01}
    found = F4X_DEPTH_ORDER(DEPTH_ORDER(**sizes, **arrays), library=watched)
    return order[:found].tolist()


KINDS = {
    "colours": colours,
    "picture": picture_loss,
    "frame": frame_losses,
    "adam": adam,
    "drawn": drawn,
    "pulls": pulls,
    "nodes": nodes_moved,
    "moved": moved,
    "arap": as_rigid_as_possible,
    "bundle": adjusted,
    "maps": looked_up,
    "rays": composited,
    "sweep": swept,
}
"""Group of stored values -> function that computes it with the library."""


def test_every_exported_function_gives_the_stored_values(native_library, monkeypatch):
    watched = Watched(native_library)
    monkeypatch.setattr(binder, "require_library", lambda: watched)
    with np.load(STORED) as file:
        stored = dict(file)
    for kind, function in KINDS.items():
        found = errors(function(part(stored, f"{kind}_in_")), part(stored, f"{kind}_out_"))
        assert found and max(found.values()) < ERROR, (kind, found)
    assert raster.self_check(watched) < raster.SELF_CHECK_ERROR
    pairs = raster.count_pairs(watched, raster.forward(watched, opaque_square(), keep=True))
    assert pairs == SQUARE_PAIRS
    assert ordered(watched) == [4, 1, 0]
    assert instruction_set(watched) in ("avx512-wide", "avx512", "avx2", "plain")
    assert 1e6 < measure_peak(watched, 0.01) < 1e13
    assert 1e-6 < shareable_seconds(watched) < 1e6
    exported = {name for source in SOURCES for name in EXPORT.findall(source.read_text(encoding="utf-8"))}
    assert watched.asked == exported and len(exported) == 28


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
    groups |= {"frame": values_of_frames(), "adam": values_of_adam(), "nodes": values_of_nodes()}
    groups |= {"arap": values_of_arap(), "bundle": values_of_bundle(), "maps": values_of_maps()}
    groups |= {"rays": values_of_rays(), "sweep": values_of_sweep()}
    groups |= {"drawn": values_of_drawn(), "pulls": values_of_pulls()}
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
    from f4x_core.metrics import pictures

    rng = np.random.default_rng(2)
    shapes = {"image": (21, 33, 3), "target": (21, 33, 3), "weight": (21, 33)}
    given = {name: rng.uniform(size=shape).astype(np.float32) for name, shape in shapes.items()}
    given["window"] = pictures.ssim_window(torch.float32).numpy()
    given["constants"] = np.array([pictures.SSIM_C1, pictures.SSIM_C2, STRUCTURE])
    image = leaf(given["image"])
    target, weight = (torch.tensor(given[name], dtype=torch.float64) for name in ("target", "weight"))
    total = losses.rgb_loss(image, target, weight, STRUCTURE) * weight.sum()
    total.backward()
    return given, {"total": total.detach().numpy(), "gradient": image.grad.numpy()}


def values_of_frames():
    """A frame of 21 x 33 pixels, some without a known depth, four without anything drawn."""
    import torch

    from f4x_core.fit import losses

    rng = np.random.default_rng(8)
    image, alpha = rng.uniform(size=(21, 33, 5)).astype(np.float32), rng.uniform(0.2, 1, (21, 33)).astype(np.float32)
    depth = (alpha * rng.uniform(0.5, 2, alpha.shape)).astype(np.float32)
    depth[3, :4] = 1e-5
    prior = rng.uniform(0.5, 2, alpha.shape).astype(np.float32)
    prior[:4, 1] = np.nan, np.inf, 0, -1
    frame = rng.normal(120, 4, (21, 33, 3)).round().clip(0, 255).astype(np.uint8)
    scores = {name: rng.uniform(size=alpha.shape).astype(np.float16) for name in ("confidence", "motion")}
    given = {"image": image, "depth": depth, "alpha": alpha, "frame": frame, "prior": prior} | scores
    leaves = {name: leaf(given[name]) for name in ("image", "depth", "alpha")}
    confidence, motion, target = (
        torch.tensor(given[n], dtype=torch.float64) for n in ("confidence", "motion", "frame")
    )
    target, unsure, c = target / 255, (1 - confidence) * (1 - motion), FRAME_CONSTANTS
    z, a = leaves["depth"], leaves["alpha"]
    total = c["depth_factor"] * losses.depth_loss(z, a, torch.tensor(prior, dtype=torch.float64), confidence)
    error = (leaves["image"][..., 3] - (motion > 0.5).double()).abs() * (2 * motion - 1).abs()
    inverse, grey, step = a / z.clamp_min(c["min_depth"]), target.mean(-1), c["step"]
    total = total + c["alpha_factor"] * error.mean()
    for axis in (0, 1):
        bend, texture, least = (losses._three(each, axis, step) for each in (inverse, grey, unsure))
        bend, texture = (losses._second_difference(*three).abs() for three in (bend, texture))
        weight = torch.exp(-texture / c["plain"]) * torch.stack(least).amin(0)
        total = total + c["bend_factor"] * (bend * weight).mean()
    total.backward()
    attention = 1 + (c["moving"] - 1) * motion
    found = {"d_" + name: value.grad.numpy() for name, value in leaves.items()}
    found["d_image"] = found["d_image"][..., 3:]
    found |= {"target": target.numpy(), "attention": attention.numpy()}
    return given, found | {"losses": np.array([total.item(), attention.sum().item()])}


def values_of_adam():
    """A step written out in numpy."""
    rng = np.random.default_rng(9)
    given = {name: rng.normal(size=(70, 3)).astype(np.float32) for name in ("gradient", "mean", "value")}
    given["square"] = rng.uniform(0.1, 1, (70, 3)).astype(np.float32)
    given["reach"] = rng.uniform(0.5, 2, 70).astype(np.float32)
    given["cap"] = rng.uniform(-0.5, 1, 70).astype(np.float32)
    wide, c = {name: value.astype(np.float64) for name, value in given.items()}, ADAM_CONSTANTS
    mean = c["keep_mean"] * wide["mean"] + (1 - c["keep_mean"]) * wide["gradient"]
    square = c["keep_square"] * wide["square"] + (1 - c["keep_square"]) * wide["gradient"] ** 2
    step = c["rate"] * mean / (np.sqrt(square) / c["root_correction"] + c["epsilon"])
    value = np.minimum(wide["value"] - wide["reach"][:, None] * step, wide["cap"][:, None])
    return given, {"mean": mean, "square": square, "value": value}


def values_of_pulls():
    """Gaussians of which some are not seen, written out in numpy."""
    rng = np.random.default_rng(12)
    given = {"gradient": rng.normal(size=(70, 2)).astype(np.float32), "visible": rng.random(70) < 0.7}
    given |= {name: rng.uniform(1, 2, 70).astype(np.float32) for name in ("gradient_sum", "seen")}
    norm = np.hypot(10.0 * given["gradient"][:, 0].astype(float), 4.5 * given["gradient"][:, 1].astype(float))
    return given, {"gradient_sum": given["gradient_sum"] + norm, "seen": given["seen"] + given["visible"].astype(float)}


def values_of_drawn():
    """Dynamic Gaussians of degree 1 that are coming, there, going and gone; some opaque, some faint."""
    import torch

    from f4x_core.gaussians import DynamicGaussians, appearance

    rng = np.random.default_rng(13)
    shapes = {"sh": (4, 3), "means": (3,), "quats": (4,), "there": (3,), "log_scales": (3,), "log_lifetimes": (2,)}
    given = {name: rng.normal(size=(90, *shape)).astype(np.float32) for name, shape in shapes.items()}
    given["logits"] = np.linspace(-8, 12, 90, dtype=np.float32)
    given["born"] = rng.uniform(-1, 6, 90).astype(np.float32)
    given["centre"] = np.float32([0.2, -0.1, -4.0])
    leaves = {name: leaf(given[name]) for name in (*shapes, "logits")}
    parameters = {"log_scales": leaves["log_scales"], "opacity_logits": leaves["logits"]}
    parameters |= {"sh0": leaves["sh"][:, :1], "shN": leaves["sh"][:, 1:], "log_lifetimes": leaves["log_lifetimes"]}
    own = DynamicGaussians(parameters, {"ids": torch.arange(90)})
    away = LIFE["time"] - torch.tensor(given["born"], dtype=torch.float64)
    splats = own.splats_there(leaves["means"], leaves["quats"], away)
    rgb = appearance(splats.sh, splats.means, splats.quats, torch.tensor(given["centre"], dtype=torch.float64))
    made = {"colors": torch.cat([rgb, torch.ones(90, 1), leaves["there"]], 1), "scales": splats.scales}
    made |= {"opacities": splats.opacities, "drawn_means": splats.means * 1, "drawn_quats": splats.quats * 1}
    total = 0
    for name, value in made.items():
        sent = rng.normal(size=value.shape).astype(np.float32)
        given["sent" if name == "colors" else "sent_" + name.removeprefix("drawn_")] = sent
        total = total + (value * torch.tensor(sent, dtype=torch.float64)).sum()
    total.backward()
    found = {name: value.detach().numpy() for name, value in made.items()}
    return given, found | {"d_" + name: value.grad.numpy() for name, value in leaves.items()}


def values_of_nodes():
    """7 frames at uneven times, 5 nodes."""
    import torch

    from f4x_core.geometry import quaternion
    from f4x_core.scaffold.losses import smoothness_losses

    rng = np.random.default_rng(10)
    given = {name: rng.normal(size=(7, 5, axes)).astype(np.float32) for name, axes in (("xyz", 3), ("quat", 4))}
    given |= {"times": np.cumsum(rng.uniform(0.5, 2, 7)), "d_axes": rng.normal(size=(7, 5, 3, 3)).astype(np.float32)}
    xyz, quat = leaf(given["xyz"]), leaf(given["quat"])
    unit = quaternion.normalize(quat)
    axes = quaternion.to_matrix(unit)
    smooth = smoothness_losses(xyz, unit, torch.tensor(given["times"]))
    loss = sum(weight * each for weight, each in zip(SMOOTH_WEIGHTS, smooth, strict=True))
    (loss + (axes * torch.tensor(given["d_axes"], dtype=torch.float64)).sum()).backward()
    found = {"axes": axes.detach().numpy(), "loss": np.array([loss.item()])}
    return given, found | {"d_xyz": xyz.grad.numpy(), "d_quat": quat.grad.numpy()}


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


def values_of_arap():
    """11 frames, 6 nodes, 24 edges of which the last four send nothing to the neighbour."""
    import torch

    rng = np.random.default_rng(5)
    xyz = (rng.normal(size=(1, 6, 3)) + 0.3 * rng.normal(size=(11, 6, 3))).astype(np.float32)
    given = {"xyz": xyz, "axes": rng.normal(size=(11, 6, 3, 3)).astype(np.float32)}
    given |= {"node": np.repeat(np.arange(6), 4), "neighbour": (np.arange(24) * 5 + 1) % 6}
    given["weight"] = rng.uniform(0.5, 1, 24).astype(np.float32)
    given |= {"shift": np.int32([1, 3, 9]), "factor": np.float32([0.5, 0.3, 0.2])}
    x, axes = leaf(given["xyz"]), leaf(given["axes"])
    origin = torch.where(torch.arange(24)[:, None] < 20, x[:, given["neighbour"]], x.detach()[:, given["neighbour"]])
    offset = x[:, given["node"]] - origin
    local = (axes[:, given["neighbour"]] * offset[..., None]).sum(-2)
    size, weight = offset.norm(dim=-1), torch.tensor(given["weight"], dtype=torch.float64)
    pairs = list(zip(given["shift"].tolist(), given["factor"].astype(np.float64), strict=True))
    losses = [
        sum(v * (weight * (local[s:] - local[:-s]).norm(dim=-1)).sum() for s, v in pairs),
        sum(v * (weight * (size[s:] - size[:-s]).abs()).sum() for s, v in pairs),
    ]
    d_coordinate, d_axes = torch.autograd.grad(losses[0], (x, axes), retain_graph=True)
    (d_length,) = torch.autograd.grad(losses[1], x)
    gradients = {"d_coordinate": d_coordinate, "d_length": d_length, "d_axes": d_axes}
    found = {name: value.numpy() for name, value in gradients.items()}
    return given, found | {"losses": np.array([loss.item() for loss in losses])}


def values_of_bundle():
    """3 cameras that see 8 points, one of them from behind, by the plain form."""
    from f4x_core.priors import bundle as plain

    rng = np.random.default_rng(6)
    points = np.column_stack([rng.normal([0, 0, 4], 0.5, (8, 3)), np.ones(8)])
    points[7, 2] = -4
    frame, point = np.nonzero(np.ones((3, 8), bool))
    seen = plain.Observations(frame, point, rng.uniform(0, 100, (24, 2)), rng.uniform(0.5, 1, 24))
    cameras = np.stack([np.linalg.qr(np.eye(3) + 0.1 * rng.normal(size=(3, 3)))[0] for _ in range(3)])
    cameras *= np.sign(np.einsum("fii->fi", cameras))[:, :, None]
    problem = plain._Problem(
        focal=100.0,
        zoom=np.array([0.9, 1.0, 1.2]),
        principal=np.array([48.0, 52.0]),
        rotation=cameras,
        center=0.2 * rng.normal(size=(3, 3)),
        points=points / np.linalg.norm(points, axis=1, keepdims=True),
        origin=np.zeros(3),
        unit=1.0,
    )
    config = plain.BundleConfig(refine_zoom=True, robust_px=1.5)
    sums, costs = plain._plain_sums(problem, seen, config), plain._plain_costs(problem, seen, config)
    given = {"frame": frame, "point": point, "uv": seen.uv, "weight": seen.weight, "rotation": cameras}
    given |= {"center": problem.center, "focal": problem.focals, "homogeneous": problem.points}
    given |= {"tangents": np.ascontiguousarray(problem.tangents), "principal": problem.principal}
    names = ("blocks", "slopes", "coupling", "point_blocks", "point_slopes")
    return given, dict(zip(names, sums, strict=True)) | {"costs": costs}


def values_of_maps():
    """A picture of 4 x 7 pixels looked up within and beyond its border; a smooth map of 5 x 6 by dense equations."""
    from f4x_core.priors import depth, flow

    rng = np.random.default_rng(7)
    given = {"floats": rng.normal(size=(4, 7, 2)).astype(np.float32), "points": rng.uniform(-2, 9, (40, 2))}
    given["halves"] = given["floats"].astype(np.float16)
    found = {name: flow._plain_sample(given[name].astype(np.float64), given["points"]) for name in ("floats", "halves")}
    given |= depth._roughness(rng.uniform(0, 60, (5, 6)), 2.0, 5.0)
    given["weight"], given["sample"], given["start"] = rng.uniform(0.1, 3, (5, 6)), *rng.normal(size=(2, 5, 6))
    dense = np.zeros((30, 30))
    for step, name in zip((0, 1, 2, 6, 12), depth.BANDS, strict=True):
        for i in range(30 - step):
            dense[i, i + step] = dense[i + step, i] = given[name].ravel()[i]
    dense += np.diag(given["weight"].ravel())
    found["solution"] = np.linalg.solve(dense, (given["weight"] * given["sample"]).ravel()).reshape(5, 6)
    return given, found


def values_of_sweep():
    """A cost volume of 7 x 9 pixels and 12 planes."""
    from f4x_core.priors import sweep

    rng = np.random.default_rng(9)
    given = {"costs": rng.integers(0, 288, (7, 9, 12)).astype(np.int16)}
    given |= {name: rng.integers(60, 800, (7, 9)).astype(np.int16) for name in ("right", "below")}
    place = sweep._plain_best_planes(given["costs"], 40, given["right"], given["below"])
    return given, {"place": place.astype(np.float64)}


def values_of_rays():
    """Twelve Gaussians, none of them opaque, over 13 x 9 pixels."""
    import torch

    from f4x_core.geometry.camera import Camera
    from f4x_core.geometry.splats import Splats
    from f4x_core.raster.rays import Projected, RayConfig, composite, project

    rng = np.random.default_rng(8)
    means = rng.uniform((-0.4, -0.3, 1), (0.4, 0.3, 2), (12, 3))
    arrays = means, rng.normal(size=(12, 4)), rng.uniform(0.02, 0.3, (12, 3)), rng.uniform(0.1, 0.4, 12)
    camera = Camera(np.array([[10.0, 0, 6.5], [0, 10, 4.5], [0, 0, 1]]), np.eye(4), 13, 9)
    config = RayConfig(alpha_min=RAY_CONSTANTS["alpha_min"])
    seen = project(Splats(*map(torch.from_numpy, arrays)), camera, config)
    given = {name: value.numpy().astype(np.float32) for name, value in vars(seen).items()}
    given |= {"colors": rng.uniform(0, 1, (12, 3)).astype(np.float32)}
    given |= {"d_image": rng.normal(size=(9, 13, 4)).astype(np.float32)}
    exact = {name: torch.from_numpy(value.astype(np.float64)) for name, value in given.items()}
    leaves = {name: exact[name].requires_grad_() for name in ("whiten", "opacities", "colors")}
    image = composite(Projected(**{name: exact[name] for name in vars(seen)}), leaves["colors"], camera, config)
    (image * exact["d_image"]).sum().backward()
    return given, {"image": image.detach().numpy()} | {f"d_{name}": leaf.grad.numpy() for name, leaf in leaves.items()}


if __name__ == "__main__":
    np.savez_compressed(STORED, **make_values())
