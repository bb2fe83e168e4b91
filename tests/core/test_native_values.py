"""Every exported function of the library against stored values of the float64 formulas, with numpy alone.

The values travel to platforms that have no torch. Where torch is, the tests of each room hold the same functions to its
formulas in float64, with gradients.
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


def test_the_plain_forms_give_the_stored_values():
    flow, sweep = (pytest.importorskip(f"f4x_core.priors.{name}") for name in ("flow", "sweep"))
    with np.load(STORED) as file:
        stored = dict(file)
    given, expected = part(stored, "maps_in_"), part(stored, "maps_out_")
    for name in ("floats", "halves"):
        got = flow._plain_sample(given[name].astype(np.float64), given["points"])
        np.testing.assert_allclose(got, expected[name], rtol=1e-9, atol=1e-12)
    given, expected = part(stored, "sweep_in_"), part(stored, "sweep_out_")
    got = sweep._plain_best_planes(given["costs"], 40, given["right"], given["below"])
    np.testing.assert_allclose(got, expected["place"], rtol=1e-6)


def store(**added):
    """Write the library's answers to the stored inputs, and to those of new groups, once its own tests pass."""
    with np.load(STORED) as file:
        stored = dict(file)
    inputs = {kind: part(stored, f"{kind}_in_") for kind in KINDS} | added
    ways = {kind: {"in": given, "out": KINDS[kind](given)} for kind, given in inputs.items()}
    named = {
        f"{kind}_{way}_{name}": value
        for kind, both in ways.items()
        for way, of in both.items()
        for name, value in of.items()
    }
    np.savez_compressed(STORED, **named)


if __name__ == "__main__":
    store()
