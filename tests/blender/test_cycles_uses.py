"""Uses of Blender 5.3's own splats in Cycles: meshes, lamps, blur, holdouts and copies beside a scene that moves."""

import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from labelled_scene import labelled_scene

from f4x_core.scene import write_scene

from .tiny_scene import tiny_scene

bpy = pytest.importorskip("bpy", reason="bpy is absent")
if "type" not in bpy.types.PointCloud.bl_rna.properties:
    pytest.skip("this Blender has no splats of its own", allow_module_level=True)
sys.path.extend(str(Path(__file__).resolve().parents[2] / name) for name in ("tools", "scripts"))
import cycles_stage  # noqa: E402
import door  # noqa: E402

EXTENSION = door.load_extension()
from mathutils import Matrix  # noqa: E402

FRAME, SAMPLES = 2, 24
RED, BLUE = np.s_[16:24, 21:29], np.s_[30:36, 50:60]
"""Pixels of the square at that frame, and of the wall."""


@pytest.fixture(autouse=True)
def end():
    """Leave the extension as other tests find it."""
    yield
    if "f4x" in bpy.types.Object.bl_rna.properties:
        EXTENSION.unregister()


@pytest.fixture
def stage(tmp_path):
    """A red square that moves to the right before a blue wall."""
    write_scene(labelled_scene(features=False), tmp_path / "s.f4x")
    return cycles_stage.Stage.of(tmp_path / "s.f4x", FRAME)


def draw(transparent=True, samples=SAMPLES):
    """(H,W,4) linear."""
    return cycles_stage.render(samples, False, transparent)


def sphere(place, radius, material):
    bpy.ops.mesh.primitive_uv_sphere_add(radius=radius, location=place)
    item = bpy.context.object
    item.data.shade_smooth()
    item.data.materials.append(material)
    return item


def turning():
    """Gaussians that turn by more than half a turn, and wholly follow their nodes."""
    scene = tiny_scene()
    return replace(scene, dynamic=replace(scene.dynamic, strength=np.ones_like(scene.dynamic.strength)))


def redness(picture):
    return picture[..., 0] / np.maximum(picture[..., :3].sum(-1), 1e-6)


def test_a_metal_ball_mirrors_the_splats(stage):
    before = draw()[30:34, 30:34]
    sphere((0, 0.8, -0.22), 0.09, cycles_stage.metal())
    picture = draw()
    ball = picture[27:38, 26:38]
    assert redness(ball).max() > 0.6 and redness(before).max() < 0.4  # the square, where the wall was


def test_glass_turns_what_is_behind_it_round(stage):
    plain = draw()[18:22, 36:39]
    sphere((0.0133, 0.6, 0.0), 0.09, cycles_stage.glass())  # before the square's right edge
    assert redness(plain).mean() < 0.4 < 0.6 < redness(draw()[18:22, 36:39]).mean()


def test_a_mesh_darkens_splats_with_the_material_and_leaves_the_rest(stage):
    sun = stage.sun((0.0, 1.0, -1.0))
    plain = draw()
    cube = sphere((0.45, 1.0, 0.2), 0.08, cycles_stage.matte((1, 1, 1)))
    cube.visible_camera = False
    assert draw() == pytest.approx(plain, abs=0.1)  # none without
    for cloud in stage.clouds:
        cycles_stage.take_shadows(cloud, sun, share=0.6)
    factor = draw()[..., 2].reshape(-1) / np.maximum(plain[..., 2].reshape(-1), 1e-6)
    ratio = factor.reshape(plain.shape[:2])
    assert ratio[19:21, 53:56].mean() == pytest.approx(0.4, abs=0.1)
    assert ratio[30:, 40:].mean() == pytest.approx(1, abs=0.05)


def test_splats_shade_a_mesh(stage):
    for cloud in stage.clouds:
        cloud.hide_render = cloud not in stage.moving
    stage.sun((0.3, 1.0, 0.0))
    bpy.ops.mesh.primitive_plane_add(size=3, location=(0, 1.2, 0), rotation=(np.pi / 2, 0, 0))
    bpy.context.object.data.materials.append(cycles_stage.matte((1, 1, 1)))
    (square,) = stage.moving
    square.visible_camera = False
    light = draw()[..., :3].sum(-1)
    shaded = light[17:23, 29:33].mean()  # 0.3 of the way from the square to the plane to the right of it
    square.visible_shadow = False
    assert shaded < 0.3 * draw()[..., :3].sum(-1)[17:23, 29:33].mean()


def test_what_is_out_of_focus_is_soft(stage):
    def edge():
        return np.abs(np.diff(redness(draw())[17:23].mean(0))).max()

    sharp, lens = edge(), stage.camera.data
    lens.dof.use_dof, lens.dof.focus_distance, lens.dof.aperture_fstop = True, stage.distance, lens.lens * 1e-3 / 0.1
    focused = edge()
    lens.dof.focus_distance = 0.4 * stage.distance
    assert focused > 0.8 * sharp and edge() < 0.4 * sharp


def test_motion_blur_smears_the_square_along_its_way(stage):
    def extent():
        seen = draw()[..., 3] > 0.03
        return [np.count_nonzero(seen.any(axis)) for axis in (0, 1)]

    for cloud in stage.clouds:
        cloud.hide_render = cloud not in stage.moving
    wide, tall = extent()
    bpy.context.scene.render.use_motion_blur, bpy.context.scene.render.motion_blur_shutter = True, 2.0
    assert np.subtract(extent(), (wide + 6, tall)) == pytest.approx((0, 0), abs=2)  # 6.7 pixels in two frames


def test_blurred_motion_is_the_mean_of_the_moments(tmp_path):
    """No ghosts, although the sign of some quaternions changes between the ends of the shutter."""
    write_scene(turning(), tmp_path / "t.f4x")
    stage = cycles_stage.Stage.of(tmp_path / "t.f4x", 4)
    for cloud in stage.clouds:
        cloud.hide_render = cloud not in stage.moving
    scene = bpy.context.scene
    moments = []
    for part in (3.55, 3.65, 3.75, 3.85, 3.95):
        scene.frame_set(int(part), subframe=part % 1)
        moments.append(draw(samples=64))
    scene.render.use_motion_blur, scene.render.motion_blur_shutter = True, 0.5
    scene.frame_set(3, subframe=0.75)
    error = np.mean((draw(samples=256) - np.mean(moments, 0)) ** 2)
    assert error < 0.3 * np.mean((moments[2] - np.mean(moments, 0)) ** 2)


def test_holdouts(stage):
    (square,) = stage.moving
    square.is_holdout = True
    assert draw()[RED][..., 3].mean() < 0.1
    square.is_holdout = False
    cube = sphere((0.5, 1.0, -0.2), 0.1, cycles_stage.matte((1, 1, 1)))
    cube.is_holdout = True
    picture = draw()
    assert picture[RED][..., 3].mean() > 0.9 and picture[31:33, 61:63, 3].mean() < 0.1


def test_splats_catch_shadows(stage):
    stage.sun((0.0, 1.0, -1.0))
    sphere((0.45, 1.0, 0.2), 0.08, cycles_stage.matte((1, 1, 1))).visible_camera = False
    for cloud in stage.clouds:
        cycles_stage.catch_shadows(cloud)
    alpha = draw()[..., 3]
    assert alpha[19:21, 53:56].mean() > 0.5 and alpha[BLUE].mean() < 0.1


def test_copies_move_with_the_scene(stage):
    behind, before = np.s_[16:24, 41:44], np.s_[16:24, 56:60]
    assert redness(draw())[behind].mean() < 0.4
    stage.array(3, 0.3).location = (0.0, -0.05, 0.0)  # 20 pixels to each side
    picture = redness(draw())
    assert picture[before].mean() < 0.4 < 0.8 < picture[behind].mean()
    bpy.context.scene.frame_set(FRAME + 2)
    picture = redness(draw())
    assert picture[before].mean() > 0.8


def test_a_collection_instance_is_drawn_elsewhere(stage):
    stage.instance(Matrix.Translation((0.3, -0.1, 0.0)))
    assert redness(draw())[16:24, 44:52].mean() > 0.8


def test_two_scenes_play_at_times_of_their_own(stage, tmp_path):
    other = stage.second(tmp_path / "s.f4x", Matrix.Translation((0.0, -0.1, 0.2)), later=2)
    (one,), (two,) = (
        [c for c in cycles_stage.clouds_below(r) if c.modifiers.get("Feature4X motion")] for r in (stage.root, other)
    )
    x = [cycles_stage.places(cloud)[:, 0].mean() for cloud in (one, two)]
    assert x[0] - x[1] == pytest.approx(0.1, abs=1e-3)
    assert redness(draw())[8:12, 16:24].mean() > 0.6


def test_the_world_lights_meshes_beside_splats(stage):
    sphere((0.0, 0.6, 0.0), 0.05, cycles_stage.matte((1, 1, 1)))
    middle = np.s_[19:21, 31:33]
    before = draw()[middle][..., 1].mean()
    stage.world((0.0, 1.0, 0.0), 1.0)
    assert draw()[middle][..., 1].mean() > before + 0.2
