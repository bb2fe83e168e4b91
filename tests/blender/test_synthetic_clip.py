"""The truth of a synthetic clip agrees with its own cameras: position, depth and flow reproject to the pixel."""

import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from f4x_core.geometry.camera import CameraPath

OpenEXR = pytest.importorskip("OpenEXR")
SCRIPT = Path(__file__).resolve().parents[2] / "scripts" / "synthetic_clip.py"
WIDTH, HEIGHT, FRAMES = 96, 56, 3


def render(folder: Path, *arguments: str) -> subprocess.CompletedProcess:
    return subprocess.run([sys.executable, str(SCRIPT), str(folder), *arguments], capture_output=True, text=True)


def read_channels(path: Path) -> dict[str, np.ndarray]:
    """Channel name without the view layer -> (H,W) float32."""
    with OpenEXR.File(str(path), separate_channels=True) as file:
        found = {n.split(".", 1)[1]: c.pixels for part in file.parts for n, c in part.channels.items()}
        return {name.replace("Object Index", "IndexOB"): pixels for name, pixels in found.items()}  # as in Blender 4


@pytest.fixture(scope="module")
def clip(tmp_path_factory):
    folder = tmp_path_factory.mktemp("clip")
    size = f"{WIDTH}x{HEIGHT}"
    done = render(folder, "--frames", str(FRAMES), "--size", size, "--samples", "1", "--extra-cameras", "10")
    assert done.returncode == 0, done.stderr
    truth = json.loads((folder / "truth.json").read_text())
    return folder, truth, [read_channels(folder / "truth" / f"{t:05d}.exr") for t in range(FRAMES)]


def position(channels) -> np.ndarray:
    return np.stack([channels[f"Position.{axis}"] for axis in "XYZ"], -1).astype(np.float64)


def test_positions_and_depths_reproject(clip):
    _, truth, frames = clip
    cameras = CameraPath.from_json(truth["cameras"])
    assert (cameras.width, cameras.height, len(cameras)) == (WIDTH, HEIGHT, FRAMES)
    for camera, channels in zip(cameras, frames, strict=True):
        pixels, depth = camera.project(position(channels))
        assert np.abs(pixels - camera.pixel_grid()).max() < 0.01
        assert np.abs(depth - channels["Depth.Z"]).max() < 1e-4


def test_flow_of_the_static_room_is_the_reprojection(clip):
    _, truth, frames = clip
    cameras = CameraPath.from_json(truth["cameras"])
    static = frames[1]["IndexOB.X"] == 1
    assert 0.5 < static.mean() < 1.0
    for other, flow in (
        (2, np.stack([-frames[1]["Vector.Z"], frames[1]["Vector.W"]], -1)),
        (0, np.stack([frames[1]["Vector.X"], -frames[1]["Vector.Y"]], -1)),
    ):
        expected = cameras[other].project(position(frames[1]))[0] - cameras[1].pixel_grid()
        assert np.abs(expected).max() > 0.3
        assert np.linalg.norm(flow - expected, axis=-1)[static].max() < 0.05


def test_subject_moves_against_the_room(clip):
    _, truth, frames = clip
    cameras = CameraPath.from_json(truth["cameras"])
    moving = np.isin(frames[1]["IndexOB.X"], truth["moving_index"])
    assert moving.mean() > 0.02
    flow = np.stack([-frames[1]["Vector.Z"], frames[1]["Vector.W"]], -1)
    static_flow = cameras[2].project(position(frames[1]))[0] - cameras[1].pixel_grid()
    assert np.median(np.linalg.norm(flow - static_flow, axis=-1)[moving]) > 0.3


def test_extra_cameras_stand_ten_degrees_aside(clip):
    folder, truth, _ = clip
    centre = CameraPath.from_json(truth["cameras"])[0].center
    for entry in truth["extra_cameras"]:
        cameras = CameraPath.from_json(entry["cameras"])
        assert [f"{int(t):05d}.png" for t in cameras.times] == sorted(
            p.name for p in (folder / entry["images"]).iterdir()
        )
        before, after = complex(*centre[:2]), complex(*cameras[0].center[:2])  # the orbit is about the world's vertical
        assert np.degrees(np.angle(after / before)) == pytest.approx(
            {"left10": -10, "right10": 10}[entry["name"]], abs=1e-3
        )
        seen = position(read_channels(folder / f"truth_{entry['name']}" / "00000.exr"))
        assert np.abs(cameras[0].project(seen)[0] - cameras[0].pixel_grid()).max() < 0.01
        assert entry["degrees"] == 10
    assert len(truth["extra_cameras"]) == 2


@pytest.fixture(scope="module")
def field(tmp_path_factory):
    """An open-air scene, as one of several."""
    folder = tmp_path_factory.mktemp("field")
    size = f"{WIDTH}x{HEIGHT}"
    command = ("--scene", "horizon,falling", "--frames", str(FRAMES), "--size", size, "--samples", "1")
    done = render(folder, *command, "--extra-cameras", "5,20")
    assert done.returncode == 0, done.stderr
    return folder, command, json.loads(done.stdout.splitlines()[-1])


def test_several_scenes_get_folders_and_are_not_rendered_twice(field):
    folder, command, printed = field
    assert printed["seconds"].keys() == {"horizon", "falling"}
    done = render(folder, *command)
    assert done.returncode == 0 and json.loads(done.stdout.splitlines()[-1])["seconds"] == {}


def test_open_air_scenes_have_sky_far_ground_and_what_moves(field):
    folder = field[0]
    truth = json.loads((folder / "horizon" / "truth.json").read_text())
    cameras = CameraPath.from_json(truth["cameras"])
    channels = read_channels(folder / "horizon" / "truth" / "00001.exr")
    depth, known = channels["Depth.Z"], channels["Depth.Z"] < 1e9
    moving = np.isin(channels["IndexOB.X"], truth["moving_index"])
    assert 0.05 < 1 - known.mean() < 0.5 and not known[0].any() and known[-1].all()  # sky above, ground below
    assert depth[known].max() > 15 * np.median(depth[known]) and 0.005 < moving.mean() < 0.3
    pixels, reprojected = cameras[1].project(position(channels)[known])
    assert np.abs(pixels - cameras[1].pixel_grid()[known]).max() < 0.01
    assert np.abs(reprojected / depth[known] - 1).max() < 1e-4
    flow = np.stack([-channels["Vector.Z"], channels["Vector.W"]], -1)
    static_flow = cameras[2].project(position(channels)[known])[0] - cameras[1].pixel_grid()[known]
    apart = np.linalg.norm(flow[known] - static_flow, axis=-1)
    assert apart[~moving[known]].max() < 0.1 < np.median(apart[moving[known]])


def test_extra_cameras_stand_at_their_angle_and_side(field):
    folder = field[0]
    truth = json.loads((folder / "horizon" / "truth.json").read_text())
    focus, cameras = np.array([0.0, 0.0, 0.7]), CameraPath.from_json(truth["cameras"])
    assert sorted(entry["name"] for entry in truth["extra_cameras"]) == sorted(
        f"{side}{degrees}" for side in ("left", "right", "up") for degrees in (5, 20)
    )
    for entry in truth["extra_cameras"]:
        extra = CameraPath.from_json(entry["cameras"])
        for camera, time in zip(extra, extra.times, strict=True):
            before, after = (one.center - focus for one in (cameras[int(time)], camera))
            cosine = before @ after / np.linalg.norm(before) / np.linalg.norm(after)
            across = np.degrees(np.arccos(np.clip(cosine, -1, 1)))
            if entry["name"].startswith("up"):
                assert camera.center[2] > cameras[int(time)].center[2] + 0.3
                assert across == pytest.approx(entry["degrees"], abs=0.2)
            else:  # about the vertical: the angle in the plan is exact
                turned = np.degrees(np.angle(complex(*after[:2]) / complex(*before[:2])))
                assert turned == pytest.approx(entry["degrees"] * (1 if "right" in entry["name"] else -1), abs=1e-3)


def test_missing_assets_are_one_sentence(tmp_path):
    done = render(tmp_path / "out", "--scene", "fox", "--assets", str(tmp_path))
    assert done.returncode == 2
    assert "fox.glb is missing" in done.stderr and "Traceback" not in done.stderr


ASSETS = Path(__file__).resolve().parents[3] / "shared" / "assets"
"""As `scripts/synthetic_clip.py --assets` without a value."""


@pytest.fixture(scope="module")
def people(tmp_path_factory):
    """Two people that cross, two frames."""
    for name in ("cesium_man.glb", "knight.glb", "handheld_camera.json"):
        if not (ASSETS / name).is_file():
            pytest.skip(f"{ASSETS / name} is absent")
    folder = tmp_path_factory.mktemp("people")
    command = ("--scene", "people-cross", "--frames", "2", "--size", "240x136", "--samples", "1")
    done = render(folder, *command, "--assets", str(ASSETS))
    assert done.returncode == 0, done.stderr
    return folder


def test_people_have_an_index_each_and_joints_where_they_are_seen(people):
    truth, joints = json.loads((people / "truth.json").read_text()), np.load(people / "joints.npy")
    assert [person["model"] for person in truth["people"]] == ["cesium_man", "knight"]
    assert truth["moving_index"] == [2, 3] and joints.shape == (2, 2, 33, 3)
    cameras = CameraPath.from_json(truth["cameras"])
    for frame in range(2):
        index = read_channels(people / "truth" / f"{frame:05d}.exr")["IndexOB.X"]
        for number, person in enumerate(truth["people"]):
            there = joints[frame, number].astype(float)
            uv = cameras[frame].project(there)[0]
            rows, columns = np.nonzero(index == person["index"])
            near = np.hypot(uv[:, None, 0] - columns - 0.5, uv[:, None, 1] - rows - 0.5).min(1)
            assert np.median(near) < 1 and near.max() < 4  # pixels
            assert 0.65 * person["height"] < there[:, 2].max() < person["height"]  # eyes; the knight's head is large
            assert there[29:, 2].min() == pytest.approx(0, abs=0.1)  # a foot is on the ground
            right, left = there[[12, 24]].mean(0), there[[11, 23]].mean(0)
            ahead = np.cross(left - right, [0.0, 0.0, 1.0])
            assert ahead @ (there[0] - there[[11, 12]].mean(0)) > 0  # the nose is ahead, not behind: left is left


def test_people_walk_before_a_hand_that_moves(people):
    cameras = CameraPath.from_json(json.loads((people / "truth.json").read_text())["cameras"])
    assert np.linalg.norm(cameras.centers[1] - cameras.centers[0]) == pytest.approx(0.15 * 11, rel=1e-3)
    joints = np.load(people / "joints.npy")
    assert (np.linalg.norm(joints[1] - joints[0], axis=-1).mean(1) > 1.5).all()  # they cross
