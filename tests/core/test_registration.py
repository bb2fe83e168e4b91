"""Held-out frames of made-up scenes whose cameras are known: registered by flow and depth, and judged there."""

from dataclasses import replace

import numpy as np
import pytest
import torch
from random_scene import random_scaffold

from f4x_core.clip import Clip
from f4x_core.evaluation import evaluate as evaluation
from f4x_core.evaluation.evaluate import Figures, blend_by_flow, evaluate, mask_scores, summary
from f4x_core.evaluation.registration import MIN_POINTS, Registration, halfway_offset, near_used, register_camera
from f4x_core.geometry import pose, quaternion
from f4x_core.geometry.camera import Camera, CameraPath
from f4x_core.geometry.spherical_harmonics import C0
from f4x_core.scene import DynamicSet, Scene, StaticSet
from f4x_core.scene.view import render

WIDTH, HEIGHT, FRAMES, HELD_OUT = 160, 100, 9, 4
FOCAL = 150.0
SHAKE = np.array([0.006, -0.010, 0.012]), np.array([0.012, -0.008, 0.006])  # radians; world units


def sheet(size, spacing, depth, seed, grey=False):
    """Arrays of round Gaussians on a wavy sheet, size (columns, rows), in colours of a smooth random texture."""
    import cv2

    x, y = np.meshgrid(*((np.arange(n) - (n - 1) / 2) * spacing for n in size))
    noise = np.random.default_rng(seed).normal(size=(*x.shape, 3)).astype(np.float32)
    colour = cv2.GaussianBlur(noise, (0, 0), 1.5)
    colour = np.zeros_like(colour) if grey else 0.25 * colour / colour.std()
    xyz = np.stack([x, y, depth + 0.1 * depth * np.sin(3 * x) * np.cos(4 * y)], -1).reshape(-1, 3)
    count = len(xyz)
    return {
        "means": xyz.astype(np.float32),
        "quats": np.tile(np.float32([1, 0, 0, 0]), (count, 1)),
        "scales": np.full((count, 3), 0.6 * spacing, np.float32),
        "opacities": np.full(count, 0.95, np.float32),
        "sh": (colour.reshape(-1, 1, 3) / C0).astype(np.float32),
    }


def mover(count_before):
    """A large sheet in front that walks to the left, (dynamic set, scaffold)."""
    arrays = sheet((22, 16), 0.025, 0.7, seed=2)
    scaffold, times, rows = (
        random_scaffold(np.random.default_rng(0)),
        np.arange(FRAMES, dtype=float),
        len(arrays["means"]),
    )
    xyz = np.tile(np.float32([0, 0, 0.7]), (FRAMES, 5, 1))
    xyz[..., 0] += 0.1 - 0.03 * times[:, None]
    quat = np.tile(np.float32([1, 0, 0, 0]), (FRAMES, 5, 1))
    scaffold = replace(scaffold, times=times, xyz=xyz, quat=quat, certain=np.ones((FRAMES, 5), bool))
    dynamic = DynamicSet(
        ids=np.arange(count_before, count_before + rows),
        reference=np.zeros(rows, np.int32),
        node=np.tile(np.int32([0, 1, 2]), (rows, 1)),
        weight=np.tile(np.float32([1, 0, 0]), (rows, 1)),
        strength=np.ones(rows, np.float32),
        **arrays,
    )
    return dynamic, scaffold


def shaken(camera: Camera) -> Camera:
    """The camera after the hand shook."""
    q, center = pose.invert(*pose.from_matrix(camera.world_to_camera))
    q = quaternion.multiply(quaternion.from_rotation_vector(SHAKE[0]), q)
    return replace(camera, world_to_camera=pose.to_matrix(*pose.invert(q, center + SHAKE[1])))


def world(step=0.02, shake=True, grey=False, moving=False) -> tuple[Scene, Clip, Camera]:
    """A scene, a clip of it with the sensor's noise, and the true camera of the frame that is held out."""
    back, front = sheet((84, 56), 0.03, 1.5, 0, grey), sheet((18, 18), 0.025, 1.0, 1, grey)
    static = {name: np.concatenate([back[name], front[name]]) for name in back}
    matrices = np.tile(np.eye(4), (FRAMES, 1, 1))
    matrices[:, 0, 3] = -step * np.arange(FRAMES)
    lens = np.array([[FOCAL, 0, WIDTH / 2], [0, FOCAL, HEIGHT / 2], [0, 0, 1]])
    path = CameraPath(np.tile(lens, (FRAMES, 1, 1)), matrices, np.arange(FRAMES), WIDTH, HEIGHT)
    parts = {"static": StaticSet(ids=np.arange(len(static["means"])), **static)}
    if moving:
        parts["dynamic"], parts["scaffold"] = mover(len(static["means"]))
    scene = Scene(name="made up", cameras=path, fps=24.0, held_out=(HELD_OUT,), **parts)
    cameras = [path[t] for t in range(FRAMES)]
    if shake:
        cameras[HELD_OUT] = shaken(cameras[HELD_OUT])
    seen = np.stack([render(scene, camera, float(t), ("rgb",))["rgb"] for t, camera in enumerate(cameras)])
    seen += np.random.default_rng(5).normal(0, 1 / 255, seen.shape)
    frames = (255 * seen.clip(0, 1)).round().astype(np.uint8)
    clip = Clip("made up", frames, np.arange(FRAMES, dtype=float), 24.0, np.arange(FRAMES) == HELD_OUT, "made up")
    return scene, clip, cameras[HELD_OUT]


def miss(camera: Camera, truth: Camera) -> float:
    """How far (pixels, mean) a camera shows points of a volume from where the true one does."""
    x, y, z = np.meshgrid(np.linspace(-0.5, 0.5, 5), np.linspace(-0.3, 0.3, 5), [1.0, 1.5])
    points = truth.unproject(truth.project(np.stack([x, y, z], -1).reshape(-1, 3))[0], z.ravel())
    return float(np.linalg.norm(camera.project(points)[0] - truth.project(points)[0], axis=1).mean())


@pytest.mark.parametrize("moving", [False, True])
def test_a_shaken_frame_is_found(moving, one_thread):
    scene, clip, truth = world(moving=moving)
    found = register_camera(scene, clip, HELD_OUT)
    interpolated = miss(scene.cameras[HELD_OUT], truth)
    assert found.found and interpolated > 1.5
    assert miss(found.camera, truth) < 0.1 * interpolated
    assert found.error_px < 0.2 < 1 < found.interpolated_error_px
    np.testing.assert_array_equal(found.camera.intrinsics, truth.intrinsics)


def test_scores_at_the_registered_camera_lead(one_thread):
    scene, clip, _ = world(moving=True)
    metrics = evaluate(scene, clip, Figures(baselines=True))
    row = metrics["frames"][HELD_OUT]
    assert row["registered"] == 1 and row["psnr_registered"] > row["psnr"] + 5
    assert row["psnr_moving_registered"] > row["psnr_moving"] and row["psnr_static_registered"] > row["psnr_static"]
    assert row["psnr_flow_blend_registered"] > row["psnr_flow_blend"] + 2
    held_out = [name for name in metrics if name.startswith("held_out")]
    assert held_out[:3] == ["held_out_psnr", "held_out_psnr_flow_blend_registered", "held_out_psnr_registered"]
    assert all("psnr_registered" not in other for other in metrics["frames"] if not other["held_out"])


def test_a_camera_on_a_tripod_stays(one_thread):
    scene, clip, truth = world(step=0.0, shake=False, moving=True)
    found = register_camera(scene, clip, HELD_OUT)
    assert found.found and found.points > 200
    np.testing.assert_array_equal(found.camera.world_to_camera, truth.world_to_camera)


def test_a_bumped_tripod_is_noticed(one_thread):
    scene, clip, truth = world(step=0.0)
    assert miss(register_camera(scene, clip, HELD_OUT).camera, truth) < 0.2


def test_without_texture_the_interpolated_camera_is_kept(one_thread):
    scene, clip, _ = world(grey=True)
    found = register_camera(scene, clip, HELD_OUT)
    assert not found.found
    np.testing.assert_array_equal(found.camera.world_to_camera, scene.cameras[HELD_OUT].world_to_camera)
    row = evaluate(scene, clip, Figures(baselines=True))["frames"][HELD_OUT]
    assert row["registered"] == 0 and row["psnr_registered"] == row["psnr"]
    assert row["psnr_flow_blend_registered"] == row["psnr_flow_blend"]


def test_points_in_one_corner_do_not_hold_a_camera(monkeypatch, one_thread):
    scene, clip, _ = world()
    elsewhere = np.ones((HEIGHT, WIDTH), bool)
    elsewhere[:46, :76] = False
    monkeypatch.setattr("f4x_core.evaluation.registration._near_motion", lambda dynamic: elsewhere)
    found = register_camera(scene, clip, HELD_OUT)
    assert found.points > MIN_POINTS and not found.found
    np.testing.assert_array_equal(found.camera.world_to_camera, scene.cameras[HELD_OUT].world_to_camera)


def test_a_worse_camera_is_refused(monkeypatch, one_thread):
    scene, clip, truth = world()
    monkeypatch.setattr("f4x_core.evaluation.registration.resected", lambda start, *_: shaken(shaken(shaken(start))))
    found = register_camera(scene, clip, HELD_OUT)
    assert not found.found and miss(found.camera, truth) == miss(scene.cameras[HELD_OUT], truth)


def test_neighbours_are_used_frames_nearby():
    scene, _, _ = world(grey=True)
    scene = replace(scene, held_out=(3, HELD_OUT))
    assert sorted(near_used(scene, FRAMES, HELD_OUT)) == [0, 1, 2, 5, 6, 7]
    assert near_used(scene, FRAMES, HELD_OUT)[0] == 5
    assert sorted(near_used(scene, FRAMES, 8)) == [5, 6, 7]


def test_at_the_end_of_a_clip_the_blend_is_the_last_frame_moved(one_thread):
    scene, clip, _ = world(shake=False)
    last = FRAMES - 1
    scene = replace(scene, held_out=(last,))
    row = evaluate(scene, replace(clip, held_out=np.arange(FRAMES) == last), Figures(baselines=True))["frames"][last]
    assert "psnr_flow_blend" not in row
    assert row["psnr_flow_blend_registered"] > row["psnr_nearest"] + 3


def test_the_offset_of_a_blend_is_where_the_line_between_neighbours_passes(one_thread):
    scene, clip, truth = world()
    offset = halfway_offset(scene, HELD_OUT, (3, 5), 0.5, truth)
    # The camera slides evenly: half-way along the line is what the camera in the middle sees.
    depth = render(scene, truth, 4.0, ("depth",))["depth"].astype(np.float64)
    expected = scene.cameras[HELD_OUT].project(truth.unproject(truth.pixel_grid(), depth))[0] - truth.pixel_grid()
    np.testing.assert_allclose(offset, expected, atol=1e-3)
    plain, moved = (blend_by_flow(clip.frames[3], clip.frames[5], 0.5, each) for each in (None, 0 * offset))
    np.testing.assert_allclose(plain, moved, atol=1e-6)


def test_a_mask_judges_what_vanished():
    target = torch.zeros(10, 20, 3)
    picture, mask = target.clone(), np.zeros((10, 20), bool)
    mask[2:6, 4:8] = True
    picture[2:6, 4:6] = 0.1
    moving = torch.zeros(10, 20)
    moving[2:6, 4:6] = 1.0
    scores = mask_scores(picture, moving, target, mask)
    assert scores["mover_coverage"] == pytest.approx(0.5)
    assert scores["psnr_mask"] == pytest.approx(-10 * np.log10(0.005), abs=1e-3)
    assert mask_scores(picture, moving, target, np.zeros_like(mask)) == {}


def test_masks_give_rows_where_they_are(monkeypatch, one_thread):
    scene, clip, truth = world(grey=True)
    kept = Registration(truth, False, 0, float("nan"), float("nan"))
    monkeypatch.setattr(evaluation, "register_camera", lambda *_: kept)
    mask = np.zeros((HEIGHT, WIDTH), bool)
    mask[20:60, 20:60] = True
    metrics = evaluate(scene, clip, Figures(masks={0: mask, 1: mask}))
    assert [row["frame"] for row in metrics["frames"] if "psnr_mask" in row] == [0, 1]
    assert metrics["used_mover_coverage"] == 0.0  # nothing moves in this scene
    assert "held_out_registration_px" not in summary(metrics["frames"])
