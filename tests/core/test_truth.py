"""Scores against the truth: a scene whose truth lies in another world is scored as if it lay in its own."""

import dataclasses
import json
from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from random_scene import FRAMES, random_scene
from scipy.ndimage import binary_dilation

from f4x_core.cli import main
from f4x_core.clip import write_images
from f4x_core.clip.images import as_bytes
from f4x_core.errors import F4xError
from f4x_core.evaluation.truth import (
    SeenSurface,
    align_cameras,
    depth_errors,
    into_scene,
    rotation_error,
    score_against_truth,
)
from f4x_core.geometry import quaternion, trajectory
from f4x_core.geometry.camera import CameraPath
from f4x_core.scene import write_scene
from f4x_core.scene.view import render

SCALE, SHIFT = 2.5, np.array([0.3, -2.0, 5.0])
ROTATION = quaternion.to_matrix(quaternion.from_rotation_vector(np.array([0.4, -1.1, 2.0])))


def in_true_world(path: CameraPath) -> CameraPath:
    """The same cameras where every scene point x lies at SCALE ROTATION x + SHIFT."""
    matrices = path.world_to_camera.copy()
    matrices[:, :3, :3] = path.world_to_camera[:, :3, :3] @ ROTATION.T
    matrices[:, :3, 3] = SCALE * path.world_to_camera[:, :3, 3] - matrices[:, :3, :3] @ SHIFT
    return dataclasses.replace(path, world_to_camera=matrices)


def curved(path: CameraPath) -> CameraPath:
    """The path with some height and turn, as hands have them."""
    rng = np.random.default_rng(3)
    matrices = path.world_to_camera.copy()
    turns = quaternion.to_matrix(quaternion.from_rotation_vector(0.05 * rng.normal(size=(len(path), 3))))
    matrices[:, :3, :3] = turns
    matrices[:, :3, 3] += 0.05 * rng.normal(size=(len(path), 3))
    return dataclasses.replace(path, world_to_camera=matrices)


def write_truth(folder: Path, scene, extra: bool = True, angles=(10,)) -> None:
    """The truth of `scene` in its true world; extra cameras see exactly what the scene shows."""
    entries = []
    for degrees in angles if extra else ():
        name = f"left{degrees}"
        views = trajectory.orbit(scene.cameras, degrees=degrees, depth=2, count=3)
        matrices = np.stack([view.camera.world_to_camera for view in views])
        path = CameraPath(
            scene.cameras.intrinsics[:3], matrices, [0.0, 2.0, 4.0], scene.cameras.width, scene.cameras.height
        )
        (folder / f"images_{name}").mkdir()
        for index, time in enumerate(path.times):
            picture = as_bytes(render(scene, path[index], float(time), ("rgb",))["rgb"])
            Image.fromarray(picture).save(folder / f"images_{name}" / f"{int(time):05d}.png")
        entry = {"name": name, "degrees": degrees, "cameras": in_true_world(path).to_json()}
        entries.append(entry | {"images": f"images_{name}"})
    truth = {"cameras": in_true_world(scene.cameras).to_json(), "extra_cameras": entries, "moving_index": [2]}
    (folder / "truth.json").write_text(json.dumps(truth))


def test_a_perfect_scene_on_a_straight_path_is_perfect(tmp_path: Path):
    """Centres on a line leave the turn about it open: orientations must close it."""
    scene = random_scene()
    write_truth(tmp_path, scene)
    scores = score_against_truth(scene, tmp_path)
    assert scores["ate_fraction"] < 1e-6 and scores["rotation_error"] < 1e-4
    assert scores["scale"] == pytest.approx(SCALE, rel=1e-6)
    assert [(row["camera"], row["frame"]) for row in scores["views"]] == [("left10", 0), ("left10", 2), ("left10", 4)]
    assert scores["unseen_psnr"] > 55 and scores["unseen_ssim"] > 0.999  # what 8-bit pictures leave


def test_the_command_line_adds_the_scores_against_the_truth(tmp_path: Path, capsys):
    scene = random_scene()
    write_truth(tmp_path, scene)
    write_scene(scene, tmp_path / "scene.f4x")
    frames = (render(scene, scene.cameras[i], float(i), ("rgb",))["rgb"] for i in range(len(scene.cameras)))
    write_images(tmp_path / "images", frames)
    command = ["eval", str(tmp_path / "scene.f4x"), "--clip", str(tmp_path / "images"), "--truth", str(tmp_path)]
    assert main([*command, "--json"]) == 0
    printed = json.loads(capsys.readouterr().out)
    assert printed["ate_fraction"] < 1e-6 and printed["used_psnr"] > 45 and printed["unseen_psnr"] > 45


def test_errors_are_seen(tmp_path: Path):
    scene = random_scene()
    write_truth(tmp_path, scene)
    wrong = dataclasses.replace(scene.static, means=scene.static.means + np.float32([0.1, 0, 0]))
    assert score_against_truth(dataclasses.replace(scene, static=wrong), tmp_path)["unseen_psnr"] < 35


def test_held_out_cameras_are_not_scored(tmp_path: Path):
    scene = random_scene()
    write_truth(tmp_path, scene, extra=False)
    matrices = scene.cameras.world_to_camera.copy()
    matrices[2, :3, 3] += 1  # frame 2 is held out
    moved = dataclasses.replace(scene, cameras=dataclasses.replace(scene.cameras, world_to_camera=matrices))
    scores = score_against_truth(moved, tmp_path)
    assert scores["ate_fraction"] < 1e-6 and "views" not in scores


def test_a_resized_scene_is_compared_at_its_size(tmp_path: Path):
    scene = random_scene()
    write_truth(tmp_path, scene)
    half = dataclasses.replace(scene, cameras=scene.cameras.resized(32, 20))
    assert score_against_truth(half, tmp_path)["unseen_psnr"] > 30


def test_similarity_of_a_curved_path_and_its_inverse():
    path = curved(random_scene().cameras)
    similarity = align_cameras(path, in_true_world(path))
    np.testing.assert_allclose(similarity[0], SCALE, rtol=1e-6)
    np.testing.assert_allclose(similarity[1], ROTATION, atol=1e-6)
    np.testing.assert_allclose(similarity[2], SHIFT, atol=1e-5)
    back = into_scene(in_true_world(path)[1], similarity)
    np.testing.assert_allclose(back.world_to_camera, path.world_to_camera[1], atol=1e-6)


def test_one_wrong_camera_hardly_turns_the_others():
    path = curved(random_scene().cameras)
    truth = in_true_world(path)
    matrices = path.world_to_camera.copy()
    matrices[3, :3, 3] += [0.2, 0.3, 0]
    matrices[3, :3, :3] = (
        quaternion.to_matrix(quaternion.from_rotation_vector(np.array([0.3, 0.0, 0.2]))) @ matrices[3, :3, :3]
    )
    similarity = align_cameras(dataclasses.replace(path, world_to_camera=matrices), truth)
    good = [i for i in range(FRAMES) if i != 3]
    kept = [
        CameraPath(p.intrinsics[good], p.world_to_camera[good], p.times[good], p.width, p.height) for p in (path, truth)
    ]
    assert rotation_error(*kept, similarity) < 0.5
    assert abs(similarity[0] / SCALE - 1) < 0.05


def test_a_camera_that_stands_still_gives_no_views(tmp_path: Path):
    scene = random_scene()
    write_truth(tmp_path, scene)
    still = np.tile(scene.cameras.world_to_camera[:1], (FRAMES, 1, 1))
    scene = dataclasses.replace(scene, cameras=dataclasses.replace(scene.cameras, world_to_camera=still))
    scores = score_against_truth(scene, tmp_path)
    assert "unseen_psnr" not in scores and scores["rotation_error"] < 1e-4


@pytest.mark.parametrize(
    ("content", "words"), [(None, "cannot be read"), ("{", "cannot be read"), ("[]", "is not the truth")]
)
def test_bad_truth_is_one_sentence(tmp_path: Path, content, words):
    if content is not None:
        (tmp_path / "truth.json").write_text(content)
    with pytest.raises(F4xError, match=words):
        score_against_truth(random_scene(), tmp_path)


def test_a_wrong_focal_length_is_told_and_applied(tmp_path: Path):
    scene = random_scene()
    write_truth(tmp_path, scene, extra=False)
    intrinsics = scene.cameras.intrinsics.copy()
    intrinsics[:, :2, :2] *= 1.1
    wrong = dataclasses.replace(scene, cameras=dataclasses.replace(scene.cameras, intrinsics=intrinsics))
    assert score_against_truth(wrong, tmp_path)["focal_ratio"] == pytest.approx(1.1)
    camera = into_scene(scene.cameras[0], (1.0, np.eye(3), np.zeros(3)), 1.1)
    np.testing.assert_allclose(camera.intrinsics, wrong.cameras[0].intrinsics)


def test_seen_surface_leaves_out_what_no_camera_saw():
    """A wall seen from one place, looked at from the side: the strip beyond the first picture is not covered."""
    camera = random_scene().cameras[0]
    wall = camera.unproject(camera.pixel_grid(), np.full((camera.height, camera.width), 2.0)).reshape(-1, 3)
    aside = camera.world_to_camera.copy()
    aside[0, 3] -= 10 * 2 / camera.intrinsics[0, 0]  # ten pixels at the wall's depth
    moved = dataclasses.replace(camera, world_to_camera=aside)
    seen = SeenSurface(wall[: len(wall) // 2], {3: wall[len(wall) // 2 :]})
    mask = seen.covers(moved, 3)
    assert mask[:, :54].all() and not mask[:, 54:].any()
    assert not seen.covers(moved, 2)[camera.height // 2 + 1 :].any()  # what moves is seen at its own time only


def write_passes(folder: Path, scene, depth: float) -> None:
    """Every clip frame saw one wall at `depth` (true unit), Blender's way."""
    plane = np.full((scene.cameras.height, scene.cameras.width), depth, np.float32)
    for frame in range(len(scene.cameras)):
        write_pass(folder / "truth", frame, plane, np.zeros_like(plane))


def write_pass(folder: Path, frame: int, depth: np.ndarray, index: np.ndarray) -> None:
    """One frame's depth and object index (H,W)."""
    import OpenEXR

    folder.mkdir(exist_ok=True)
    channels = {"ViewLayer.Depth.Z": depth.astype(np.float32), "ViewLayer.IndexOB.X": index.astype(np.float32)}
    OpenEXR.File({"type": OpenEXR.scanlineimage}, channels).write(str(folder / f"{frame:05d}.exr"))


def seen_by_some_frame(scene, camera, depth: float) -> np.ndarray:
    """(H,W) bool, ray by ray: whether what `camera` sees of the wall z = `depth` lies inside a used frame's picture."""
    rays = camera.unproject(camera.pixel_grid(), np.ones((camera.height, camera.width))) - camera.center
    wall = camera.center + rays * ((depth - camera.center[2]) / rays[..., 2])[..., None]
    seen = np.zeros((camera.height, camera.width), bool)
    for frame in set(range(FRAMES)) - set(scene.held_out):
        pixels, _ = scene.cameras[frame].project(wall)
        seen |= ((pixels > 0) & (pixels < (camera.width, camera.height))).all(-1)
    return seen


def test_what_the_clip_never_saw_does_not_count_as_covered(tmp_path: Path):
    """Extra pictures that differ only beyond the clip's pictures: bad over all pixels, perfect over the covered ones."""
    scene = random_scene()
    write_truth(tmp_path, scene)
    write_passes(tmp_path, scene, depth=2 * SCALE)
    shares = []
    for view, time in zip(trajectory.orbit(scene.cameras, degrees=10, depth=2, count=3), (0, 2, 4), strict=True):
        seen = seen_by_some_frame(scene, view.camera, depth=2)
        shares.append(seen.mean())
        file = tmp_path / "images_left10" / f"{time:05d}.png"
        beyond = ~binary_dilation(seen, np.ones((3, 3)))  # a point covers its pixel, also where it hits a corner
        Image.fromarray(np.where(beyond[..., None], 255 - np.asarray(Image.open(file)), Image.open(file))).save(file)
    scores = score_against_truth(scene, tmp_path)
    assert [row["covered_fraction"] for row in scores["views"]] == pytest.approx(shares, abs=0.02)
    assert scores["unseen_covered_fraction"] == pytest.approx(np.mean(shares), abs=0.02)
    assert scores["unseen_psnr_covered"] > 55 > scores["unseen_psnr"] + 20


def test_truth_of_another_clip_is_refused(tmp_path: Path):
    scene = random_scene()
    write_truth(tmp_path, scene, extra=False)
    truth = json.loads((tmp_path / "truth.json").read_text())
    for name in ("intrinsics", "world_to_camera", "times"):
        truth["cameras"][name] = truth["cameras"][name][:4]
    (tmp_path / "truth.json").write_text(json.dumps(truth))
    with pytest.raises(F4xError, match="the truth has 4 frames, the scene 6"):
        score_against_truth(scene, tmp_path)


def halves_of(scene, depth: float) -> tuple[np.ndarray, np.ndarray]:
    """Depth (H,W) of a wall and an object index (H,W) whose right half moves."""
    shape = (scene.cameras.height, scene.cameras.width)
    index = np.ones(shape)
    index[:, shape[1] // 2 :] = 2
    return np.full(shape, depth), index


def test_unseen_views_are_parted_by_angle_and_by_what_moves(tmp_path: Path):
    """Extra pictures that are wrong only where something moves, and only 20 degrees off the path."""
    scene = random_scene()
    write_truth(tmp_path, scene, angles=(10, 20))
    depth, index = halves_of(scene, 2 * SCALE)
    for frame in range(len(scene.cameras)):
        write_pass(tmp_path / "truth", frame, depth, index)
    for name in ("left10", "left20"):
        for time in (0, 2, 4):
            write_pass(tmp_path / f"truth_{name}", time, depth, index)
    half = scene.cameras.width // 2
    for time in (0, 2, 4):
        file = tmp_path / "images_left20" / f"{time:05d}.png"
        picture = np.asarray(Image.open(file)).copy()
        picture[:, half:] = 255 - picture[:, half:]
        Image.fromarray(picture).save(file)
    scores = score_against_truth(scene, tmp_path)
    moving, static = "unseen_psnr_covered_moving", "unseen_psnr_covered_static"
    assert min(scores[f"{moving}_at_10"], scores[f"{static}_at_10"], scores[f"{static}_at_20"]) > 55
    assert scores[f"{moving}_at_20"] < 20 and scores["unseen_psnr_covered_at_20"] < scores["unseen_psnr_covered_at_10"]
    mean = (scores[f"{moving}_at_10"] + scores[f"{moving}_at_20"]) / 2
    assert scores[moving] == pytest.approx(mean)  # as many views at either angle
    assert {row["degrees"] for row in scores["views"]} == {10, 20}


def test_what_moves_is_covered_only_where_its_own_frame_saw_it(tmp_path: Path):
    scene = random_scene()
    write_truth(tmp_path, scene)
    depth, index = halves_of(scene, 2 * SCALE)
    for frame in range(len(scene.cameras)):  # the clip never saw anything move
        write_pass(tmp_path / "truth", frame, depth, np.ones_like(index))
    for time in (0, 2, 4):
        write_pass(tmp_path / "truth_left10", time, depth, index)
    scores = score_against_truth(scene, tmp_path)
    assert "unseen_psnr_covered_moving" not in scores and scores["unseen_psnr_covered_static"] > 55


def test_sky_counts_where_a_frame_looked_that_way(tmp_path: Path):
    scene = random_scene()
    sky = np.full((scene.cameras.height, scene.cameras.width), 1e10)
    wall = np.full_like(sky, 2 * SCALE)
    write_truth(tmp_path, scene)
    for frame in range(len(scene.cameras)):
        write_pass(
            tmp_path / "truth", frame, np.where(np.arange(len(sky))[:, None] < len(sky) // 2, sky, wall), 1 + 0 * sky
        )
    for time in (0, 2, 4):
        write_pass(tmp_path / "truth_left10", time, sky, 1 + 0 * sky)
    covered = [row["covered_fraction"] for row in score_against_truth(scene, tmp_path)["views"]]
    assert all(0.2 < fraction < 0.55 for fraction in covered)  # the lower half of the sky was never seen


def test_depth_errors_grant_what_moves_no_scale_of_its_own():
    true = np.full((2, 4, 6), 3.0)
    true[0, 0] = 1e10
    moving = np.zeros(true.shape, bool)
    moving[:, :, 3:] = True
    found = np.where(moving, 1.2 * true, 0.95 * true)
    found[1, 1] = np.nan
    errors = depth_errors(found, true, moving)
    assert errors == {"depth_error_static": pytest.approx(0.05), "depth_error_moving": pytest.approx(0.2)}
    assert depth_errors(found, true, np.zeros_like(moving)).keys() == {"depth_error_static"}


def test_the_scene_is_asked_for_its_own_depth(tmp_path: Path):
    scene = random_scene()
    write_truth(tmp_path, scene, extra=False)
    for frame, camera in enumerate(scene.cameras):
        depth = render(scene, camera, float(frame), ("depth",))["depth"]
        write_pass(
            tmp_path / "truth", frame, np.where(np.isfinite(depth), 1.1 * SCALE * depth, 1e10), np.ones_like(depth)
        )
    assert score_against_truth(scene, tmp_path)["depth_error_static"] == pytest.approx(1 - 1 / 1.1, rel=1e-3)
