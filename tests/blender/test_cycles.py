"""Blender 5.3's own renderers beside the core: what Cycles draws, and what our engine draws of the same points."""

import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from labelled_scene import labelled_scene

from f4x_core.fit.linear_light import display_color, linear_color
from f4x_core.geometry import spherical_harmonics
from f4x_core.geometry.camera import Camera
from f4x_core.geometry.splats import Splats
from f4x_core.raster.rays import RayConfig, filtered_rays
from f4x_core.scene import write_scene
from f4x_core.scene.linear import Look, fitted_look, linear_look, with_look

bpy = pytest.importorskip("bpy", reason="bpy is absent")
if "type" not in bpy.types.PointCloud.bl_rna.properties:
    pytest.skip("this Blender has no splats of its own", allow_module_level=True)
sys.path.insert(0, str(Path(__file__).resolve().parents[2] / "scripts"))
import door  # noqa: E402
import OpenEXR  # noqa: E402
from mathutils import Matrix  # noqa: E402

EXTENSION = door.load_extension()
from feature4x.addon.common.point_cloud import FLOAT4, new_point_cloud, read_attribute, write_attribute  # noqa: E402
from feature4x.addon.edits import display  # noqa: E402
from feature4x.addon.io.import_scene import import_scene  # noqa: E402
from feature4x.addon.render.evaluated import stage  # noqa: E402
from feature4x.addon.scene.scene_object import SceneObject  # noqa: E402
from feature4x.f4x_core.edit.operations import Recolour, Transform  # noqa: E402
from feature4x.f4x_core.edit.selects import Moving  # noqa: E402

CAMERA = Camera(np.array([[45.0, 0, 24], [0, 45, 16], [0, 0, 1]]), np.eye(4), 48, 32)
SAMPLES = 1024


@pytest.fixture(autouse=True)
def empty_file():
    """An empty .blend with the extension registered."""
    bpy.ops.wm.read_factory_settings(use_empty=True)
    EXTENSION.register()
    yield
    EXTENSION.unregister()


def gaussians(seed=0, count=200, depths=(1, 4), sizes=(0.01, 0.1), thin=(1, 1, 1), opacities=(0.1, 1)):
    """(Splats of numpy arrays, (N,3) DC coefficients) in front of `CAMERA`."""
    rng = np.random.default_rng(seed)
    z = rng.uniform(*depths, count)
    means = np.stack([rng.uniform(-0.5, 0.5, count) * z, rng.uniform(-0.35, 0.35, count) * z, z], 1)
    scales = np.exp(rng.uniform(*np.log(sizes), (count, 3))) * thin
    quats = rng.normal(size=(count, 4))
    arrays = means, quats / np.linalg.norm(quats, axis=1, keepdims=True), scales, rng.uniform(*opacities, count)
    colors = spherical_harmonics.dc_from_rgb(rng.uniform(0, 1, (count, 3)))
    return Splats(*(array.astype(np.float32) for array in arrays)), colors.astype(np.float32)


CASES = {
    "plain": {},
    "needles": {"sizes": (0.05, 0.3), "thin": (1, 0.02, 0.02)},
    "thick needles": {"sizes": (0.05, 0.3), "thin": (1, 0.1, 0.1)},
    "near": {"depths": (0.03, 0.5), "sizes": (0.001, 0.008)},
    "large": {"depths": (3, 6), "sizes": (0.1, 0.6), "count": 60},
    "faint": {"sizes": (0.1, 0.6), "opacities": (0.004, 0.1), "count": 300},
    "pancakes": {"sizes": (0.05, 0.2), "thin": (1, 1, 1e-4)},
    "small": {"sizes": (0.004, 0.015), "count": 1000},
    "opaque": {"opacities": (0.97, 1)},
    "dense": {"sizes": (0.02, 0.08), "count": 1000},
}


def look_through(camera):
    """Add a Blender camera that sees as `camera` in the axes of a scene file, those of Blender turned by half about X."""
    scene = bpy.context.scene
    item = bpy.data.objects.new("eye", bpy.data.cameras.new("eye"))
    scene.collection.objects.link(item)
    scene.camera = item
    item.data.sensor_width, item.data.clip_start = 36, 0.01
    item.data.lens = camera.intrinsics[0, 0] * 36 / camera.width
    scene.render.resolution_x, scene.render.resolution_y = camera.width, camera.height


def cycles(samples):
    """(H,W,4) linear colors and alpha as Cycles draws the current scene."""
    scene, render = bpy.context.scene, bpy.context.scene.render
    render.engine, render.film_transparent, render.resolution_percentage = "CYCLES", True, 100
    scene.cycles.samples, scene.cycles.use_adaptive_sampling, scene.cycles.use_denoising = samples, False, False
    scene.view_settings.view_transform = "Raw"
    render.image_settings.file_format, render.image_settings.color_depth = "OPEN_EXR", "32"
    render.image_settings.color_mode = "RGBA"
    render.filepath = bpy.app.tempdir + "picture.exr"
    bpy.ops.render.render(write_still=True)
    with OpenEXR.File(render.filepath) as file:
        return np.array(file.channels()["RGBA"].pixels)


def decibels(one, other):
    return -10 * np.log10(np.mean((np.asarray(one) - np.asarray(other)) ** 2))


def shown(linear):
    """Display colours of linear ones."""
    return display_color(torch.from_numpy(np.ascontiguousarray(linear[..., :3], np.float32)).clamp_min(0)).numpy()


@pytest.mark.parametrize("case", CASES)
def test_rays_are_what_cycles_draws(case):
    splats, dc = gaussians(**CASES[case])
    item = new_point_cloud("splats", len(splats.means), bpy.context.scene.collection)
    item.matrix_world = Matrix(np.diag([1.0, -1, -1, 1]))
    write_attribute(item.data, "position", "FLOAT_VECTOR", splats.means)
    write_attribute(item.data, "scale", "FLOAT_VECTOR", splats.scales)
    write_attribute(item.data, "rotation", "QUATERNION", splats.quats)
    write_attribute(item.data, "radiance:base", FLOAT4, np.concatenate([dc, splats.opacities[:, None]], 1))
    colors = linear_color(torch.from_numpy(spherical_harmonics.rgb_from_dc(dc)))
    ours = filtered_rays(splats.map(torch.from_numpy), colors, CAMERA, 4, RayConfig(alpha_min=1e-4))
    look_through(CAMERA)
    assert decibels(shown(cycles(SAMPLES)), shown(ours.numpy())) > 35


def imported(tmp_path, scene):
    write_scene(scene, tmp_path / "s.f4x")
    return SceneObject(import_scene(tmp_path / "s.f4x"))


def different(scene):
    """The scene with an appearance for linear light that differs from the fitted one everywhere."""
    look = fitted_look(scene)
    return with_look(scene, Look(look.scales * 1.5, look.opacities * 0.8, look.dc + 0.2))


def rows_of(scene, count):
    """The rows of the static set or of the dynamic one, by its size."""
    return slice(0, count) if count == len(scene.static) else slice(len(scene.static), None)


def test_blender_draws_the_linear_look_and_our_engine_the_fitted_one(tmp_path):
    scene = different(labelled_scene())
    found = imported(tmp_path, scene)
    linear, fitted = linear_look(scene), fitted_look(scene)
    for cloud in [each for each in found.clouds if len(each.data.points)]:
        rows = rows_of(scene, len(cloud.data.points))
        np.testing.assert_allclose(read_attribute(cloud.data, "scale"), linear.scales[rows], rtol=1e-6)
        base = read_attribute(cloud.data, "radiance:base")
        np.testing.assert_allclose(base[:, 3], linear.opacities[rows], atol=1e-6)
        np.testing.assert_allclose(base[:, :3], linear.dc[rows], atol=1e-6)
    clouds, _ = stage(bpy.context.evaluated_depsgraph_get())
    for cloud in clouds:
        rows = rows_of(scene, len(cloud.means))
        np.testing.assert_allclose(cloud.scales, fitted.scales[rows], rtol=1e-5)
        np.testing.assert_allclose(cloud.opacities, fitted.opacities[rows], atol=1e-5)
        np.testing.assert_allclose(cloud.sh[:, 0], fitted.dc[rows], atol=1e-5)


def test_without_a_refit_the_footprint_is_in_the_scales(tmp_path):
    scene = labelled_scene()
    found = imported(tmp_path, scene)
    static = next(cloud for cloud in found.clouds if cloud.name.endswith("static"))
    scales = read_attribute(static.data, "scale")
    np.testing.assert_allclose(scales, linear_look(scene).scales[: len(scene.static)], rtol=1e-6)
    assert (scales > scene.static.scales).all()


def test_edits_change_both_appearances(tmp_path):
    scene = different(labelled_scene())
    found = imported(tmp_path, scene)
    found.append(Recolour(Moving(), (0.0, 1.0, 0.0)), Transform(Moving(), translate=(0.1, 0.0, 0.0)))
    display.refresh(found)
    green = spherical_harmonics.dc_from_rgb(np.array([0.0, 1.0, 0.0]))
    (apart,) = [cloud for cloud in found.clouds if "f4x_apart" in cloud]
    np.testing.assert_allclose(read_attribute(apart.data, "radiance:base")[:, :3], np.tile(green, (81, 1)), atol=1e-5)
    linear = linear_look(scene)
    np.testing.assert_allclose(read_attribute(apart.data, "scale"), linear.scales[len(scene.static) :], rtol=1e-5)
    clouds, _ = stage(bpy.context.evaluated_depsgraph_get())
    moved = next(cloud for cloud in clouds if len(cloud.means) == len(scene.dynamic))
    np.testing.assert_allclose(moved.scales, scene.dynamic.scales, rtol=1e-5)
    np.testing.assert_allclose(moved.sh[:, 0], np.tile(green, (81, 1)), atol=1e-5)


def test_a_refit_of_the_file_shows_in_the_open_blend_with_its_pending_edits(tmp_path):
    scene = labelled_scene()
    found = imported(tmp_path, scene)
    found.append(Recolour(Moving(), (0.0, 1.0, 0.0)))
    write_scene(different(scene), tmp_path / "s.f4x")
    display.refresh(found)
    static = next(cloud for cloud in found.clouds if cloud.name.endswith("static"))
    wanted = linear_look(different(scene)).scales[: len(scene.static)]
    np.testing.assert_allclose(read_attribute(static.data, "scale"), wanted, rtol=1e-6)
    assert len(found.stack.edits) == 1 and not found.is_saved


def test_what_comes_and_goes_does_so_in_both(tmp_path):
    scene = labelled_scene()
    span = np.tile(np.float32([-np.inf, -np.inf, 2, 4]), (len(scene.static), 1))
    scene = different(replace(scene, static=replace(scene.static, span=span)))
    imported(tmp_path, scene)
    bpy.context.scene.frame_set(3)
    clouds, _ = stage(bpy.context.evaluated_depsgraph_get())
    static = next(cloud for cloud in clouds if len(cloud.means) == len(scene.static))
    np.testing.assert_allclose(static.opacities, scene.posed(3.0).opacities[: len(scene.static)], atol=1e-4)
    bpy.context.scene.frame_set(5)
    assert cycles(16)[20, 5, 3] < 0.01  # the wall has gone, and Cycles sees it too
    bpy.context.scene.frame_set(3)
    half = cycles(64)[..., 3].mean()
    bpy.context.scene.frame_set(0)
    assert 0.3 < half < cycles(64)[..., 3].mean() - 0.01


def test_cycles_draws_an_imported_scene_as_the_core_says(tmp_path):
    """A faint scene: a material would take the opacity a second time."""
    scene = labelled_scene()
    faint = np.full(len(scene.static), 0.3, np.float32)
    scene = replace(scene, static=replace(scene.static, opacities=faint))
    imported(tmp_path, scene)
    look, posed, camera = linear_look(scene), scene.posed(0.0), scene.cameras.at(0.0)
    colors = linear_color(torch.from_numpy(spherical_harmonics.rgb_from_dc(look.dc)))
    splats = Splats(*map(torch.from_numpy, (posed.means, posed.quats, look.scales, look.opacities)))
    ours = filtered_rays(splats, colors, camera, 3)
    assert decibels(shown(cycles(256)), shown(ours.numpy())) > 33
