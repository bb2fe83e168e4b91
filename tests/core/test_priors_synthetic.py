"""EXR passes in both Blender layouts, and exact priors from a small analytic clip written as EXR."""

import json

import numpy as np
import pytest

from f4x_core.clip import Clip
from f4x_core.errors import F4xError
from f4x_core.geometry.camera import CameraPath
from f4x_core.priors import PriorsConfig, build_priors
from f4x_core.priors.depth import MAX_DEPTH
from f4x_core.priors.synthetic import read_passes

OpenEXR = pytest.importorskip("OpenEXR")

WIDTH, HEIGHT, FRAMES = 48, 32, 6
INTRINSICS = np.array([[40.0, 0, WIDTH / 2], [0, 40.0, HEIGHT / 2], [0, 0, 1]])
WALL, BALL, STEP, RISE = 4.0, 2.0, 0.1, 1.0


def write_exr(path, passes, modern):
    """`passes`: channel name without the layer -> (H, W) float32. Blender 5 writes one part per pass."""
    header = {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage}
    named = {f"ViewLayer.{name}": np.ascontiguousarray(plane, np.float32) for name, plane in passes.items()}
    if not modern:
        OpenEXR.File(header, named).write(str(path))
        return
    parts = {}
    for name, plane in named.items():
        name = name.replace("IndexOB", "Object Index")
        parts.setdefault(name.rsplit(".", 1)[0], {})[name] = plane
    OpenEXR.File([OpenEXR.Part(header | {"name": n}, c, n) for n, c in parts.items()]).write(str(path))


@pytest.mark.parametrize("modern", [False, True])
def test_passes_of_both_layouts(tmp_path, modern):
    rng = np.random.default_rng(0)
    planes = {f"Vector.{axis}": rng.random((5, 7)) for axis in "XYZW"}
    planes |= {"Depth.Z": rng.random((5, 7)), "IndexOB.X": np.full((5, 7), 2.0)}
    planes |= {f"Combined.{axis}": rng.random((5, 7)) for axis in "RGBA"}
    write_exr(tmp_path / "a.exr", planes, modern)
    passes = read_passes(tmp_path / "a.exr")
    assert set(passes) == {"Vector", "Depth", "Object Index", "Combined"}
    for i, axis in enumerate("XYZW"):
        np.testing.assert_array_equal(passes["Vector"][..., i], planes[f"Vector.{axis}"].astype(np.float32))
    for i, axis in enumerate("RGBA"):
        np.testing.assert_array_equal(passes["Combined"][..., i], planes[f"Combined.{axis}"].astype(np.float32))
    assert passes["Depth"].shape == (5, 7) and passes["Depth"].dtype == np.float32
    assert (passes["Object Index"] == 2).all()


def test_bad_files_are_named(tmp_path):
    with pytest.raises(F4xError, match=r"gone\.exr does not exist"):
        read_passes(tmp_path / "gone.exr")
    (tmp_path / "bad.exr").write_bytes(b"not an exr")
    with pytest.raises(F4xError, match=r"bad\.exr is not a readable EXR"):
        read_passes(tmp_path / "bad.exr")


def ball_mask(frame):
    """A square that slides down one pixel per frame, fixed in the picture's columns."""
    mask = np.zeros((HEIGHT, WIDTH), bool)
    mask[8 + frame : 16 + frame, 20:30] = True
    return mask


@pytest.fixture
def rendered(tmp_path):
    """A wall with sky above, seen from a camera that moves along +x, and a square that slides down in front of it."""
    (tmp_path / "truth").mkdir()
    matrices = np.tile(np.eye(4), (FRAMES, 1, 1))
    matrices[:, 0, 3] = -STEP * np.arange(FRAMES)
    path = CameraPath(np.tile(INTRINSICS, (FRAMES, 1, 1)), matrices, np.arange(float(FRAMES)), WIDTH, HEIGHT)
    for t in range(FRAMES):
        mask, depth = ball_mask(t), np.full((HEIGHT, WIDTH), WALL)
        depth[:4] = 1e10
        depth[mask] = BALL
        shift = np.where(depth < 1e9, -40.0 * STEP / depth, 0.0)
        right, down = np.where(mask, 0.0, shift), np.where(mask, RISE, 0.0)  # forward flow
        # forward = (-Z, +W); backward = (+X, -Y) and the motion is uniform: backward = -forward
        vector = {"Vector.X": -right, "Vector.Y": down, "Vector.Z": -right, "Vector.W": down}
        passes = vector | {"Depth.Z": depth, "IndexOB.X": np.where(mask, 2.0, 1.0)}
        write_exr(tmp_path / "truth" / f"{t:05d}.exr", passes, modern=t % 2 == 1)
    head = {"width": WIDTH, "height": HEIGHT, "fps": 24, "cameras": path.to_json(), "moving_index": [2]}
    (tmp_path / "truth.json").write_text(json.dumps(head))
    pictures = np.zeros((FRAMES, HEIGHT, WIDTH, 3), np.uint8)
    held_out = np.arange(FRAMES) == 2
    clip = Clip("toy", pictures, np.arange(float(FRAMES)), 24.0, held_out, str(tmp_path / "images"))
    return clip, tmp_path


def test_truth_becomes_priors(rendered, tmp_path):
    clip, _ = rendered
    priors = build_priors(clip, tmp_path / "priors", PriorsConfig.of("synthetic"))
    assert list(priors.frames) == [0, 1, 3, 4, 5]
    assert priors.camera_kind == "moving"
    assert np.nanmedian(priors.depth) == pytest.approx(1)
    assert (priors.depth[:, :4] == MAX_DEPTH).all() and (priors.depth_confidence == 1).all()  # the sky has a place
    assert priors.depth[0, 10, 22] == pytest.approx(BALL / WALL)
    step = np.diff(priors.cameras.centers[:, 0])
    np.testing.assert_allclose(step, np.array([1, 2, 1, 1]) * STEP / WALL)
    for i, frame in enumerate(priors.frames):
        np.testing.assert_array_equal(priors.mask[i], ball_mask(frame))

    # flow 1 -> 3 leaps over the held-out frame: twice the wall's parallax, two chained steps of the square
    wall, square = (1, 28, 8), (1, 12, 24)
    np.testing.assert_allclose(priors.flow_forward[wall], [-2 * 40 * STEP / WALL, 0], atol=2e-3)
    np.testing.assert_allclose(priors.flow_backward[wall], [2 * 40 * STEP / WALL, 0], atol=2e-3)
    np.testing.assert_allclose(priors.flow_forward[square], [0, 2], atol=2e-3)
    assert priors.flow_forward_mask[wall] and priors.flow_forward_mask[square]
    assert not priors.flow_forward_mask[1, 17, 24]  # the wall just below the square is covered at frame 3


def test_tracks_follow_truth_and_hide_behind_the_mover(rendered, tmp_path):
    clip, _ = rendered
    priors = build_priors(clip, tmp_path / "priors", PriorsConfig.of("synthetic"))
    moving = priors.tracks_motion > 0.5
    assert moving.any() and (~moving).any()
    whole = priors.tracks_visible.all(0)
    down = priors.tracks[-1, whole & moving] - priors.tracks[0, whole & moving]
    np.testing.assert_allclose(down, np.tile([0, 5], (len(down), 1)), atol=1e-3)
    across = priors.tracks[-1, whole & ~moving] - priors.tracks[0, whole & ~moving]
    np.testing.assert_allclose(across, np.tile([-5 * 40 * STEP / WALL, 0], (len(across), 1)), atol=1e-3)
    for i, frame in enumerate(priors.frames):
        seen = priors.tracks_visible[i] & ~moving
        x, y = priors.tracks[i, seen].astype(int).T
        assert not ball_mask(frame)[y, x].any()
    assert (~priors.tracks_visible[:, ~moving]).any()


def test_a_clip_without_truth_is_told(rendered, tmp_path):
    clip, folder = rendered
    (folder / "truth.json").unlink()
    with pytest.raises(F4xError, match=r"holds no truth\.json"):
        build_priors(clip, tmp_path / "priors", PriorsConfig.of("synthetic"))


def test_another_size_is_told(rendered, tmp_path):
    clip, _ = rendered
    small = Clip("toy", clip.frames[:, ::2, ::2], clip.times, 24.0, clip.held_out, clip.source)
    with pytest.raises(F4xError, match="its own size"):
        build_priors(small, tmp_path / "priors", PriorsConfig.of("synthetic"))
