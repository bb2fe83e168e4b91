"""Every reader on a tiny made-up source, every kind of bad input, and what the writers write."""

import json
import re
import struct
from itertools import product

import av
import numpy as np
import pytest
from PIL import Image

from f4x_core.app.fit_options import ClipOptions
from f4x_core.clip import Clip, read_clip, usual_width, write_images, write_video
from f4x_core.errors import F4xError
from f4x_core.geometry import quaternion


def picture(index, width=24, height=16):
    """Grey level tells the frame, the bright quadrant tells which way is up."""
    image = np.full((height, width, 3), 8 * index, np.uint8)
    image[: height // 2, : width // 2, 0] = 250
    return image


def save(file, array):
    file.parent.mkdir(parents=True, exist_ok=True)
    Image.fromarray(array).save(file)


@pytest.fixture
def folder(tmp_path):
    """`clip/images/0.png ... 11.png`, not zero-padded, with `clip/masks`."""
    for i in range(12):
        save(tmp_path / f"clip/images/{i}.png", picture(i))
        save(tmp_path / f"clip/masks/{i}.png", np.pad(np.full((4, 4), 255, np.uint8), ((i, 12 - i), (8, 12))))
    return tmp_path / "clip"


def refused(message, *args, **kwargs):
    with pytest.raises(F4xError, match=message):
        read_clip(*args, **kwargs)


# --- image folders -----------------------------------------------------------------------------------------------


def test_image_folder_in_natural_order_with_or_without_images_inside(folder):
    for source in (folder, folder / "images", str(folder)):
        clip = read_clip(source)
        assert clip.name == "clip" and clip.source == str(source)
        np.testing.assert_array_equal(clip.frames, [picture(i) for i in range(12)])
        np.testing.assert_array_equal(clip.times, np.arange(12))
        assert clip.cameras is None and clip.masks is None and clip.depth is None
        assert (len(clip), clip.width, clip.height) == (12, 24, 16)


@pytest.mark.parametrize(
    "frames, expected", [("2:8:3", [2, 5]), (":3", [0, 1, 2]), ("9:", [9, 10, 11]), ("::6", [0, 6])]
)
def test_frame_selection_renumbers_times_and_divides_the_rate(folder, frames, expected):
    clip = read_clip(folder, frames=frames, masks="layout")
    np.testing.assert_array_equal(clip.frames[:, -1, -1, 0], 8 * np.array(expected))
    np.testing.assert_array_equal(clip.times, np.arange(len(expected)))
    np.testing.assert_array_equal(clip.masks.argmax(axis=1)[:, 8], expected)
    step = int(frames.split(":")[2]) if frames.count(":") == 2 else 1
    assert clip.fps == 24 / step


def test_hold_out_keeps_the_last_of_every_n(folder):
    clip = read_clip(folder, hold_out=4)
    np.testing.assert_array_equal(np.flatnonzero(clip.held_out), [3, 7, 11])
    np.testing.assert_array_equal(clip.supervised, [0, 1, 2, 4, 5, 6, 8, 9, 10])
    assert not read_clip(folder).held_out.any()


def test_width_averages_to_even_sizes_and_never_enlarges(folder):
    clip = read_clip(folder, width=13, masks="layout")
    assert clip.frames.shape == (12, 8, 12, 3) and clip.masks.shape == (12, 8, 12)
    np.testing.assert_array_equal(clip.frames[3], picture(3, 12, 8))
    assert read_clip(folder, width=1000).frames.shape == (12, 16, 24, 3)
    save(folder.parent / "odd" / "a.png", picture(1, 25, 17))
    assert read_clip(folder.parent / "odd").frames.shape == (1, 17, 25, 3)
    assert read_clip(folder.parent / "odd", width=24).frames.shape == (1, 16, 24, 3)


def test_resizing_averages_instead_of_picking(tmp_path):
    checkers = np.repeat(np.indices((16, 24)).sum(0)[..., None] % 2 * 200, 3, axis=-1).astype(np.uint8)
    save(tmp_path / "f" / "a.png", checkers)
    assert (read_clip(tmp_path / "f", width=12).frames == 100).all()


def test_one_frame_grey_palette_and_alpha_pictures_are_read(tmp_path):
    Image.fromarray(picture(4)[..., 0]).save(tmp_path / "grey.png")
    assert read_clip(tmp_path).frames.shape == (1, 16, 24, 3)
    Image.fromarray(np.dstack([picture(1), picture(2)[..., 0]])).save(tmp_path / "rgba.png")
    Image.fromarray(picture(1)).convert("P").save(tmp_path / "palette.png")
    clip = read_clip(tmp_path)
    assert clip.hidden[2].mean() > 0.7 and not clip.hidden[:2].any()
    np.testing.assert_array_equal(clip.frames[2, 0, 0], picture(1)[0, 0])


@pytest.mark.parametrize(
    ("size", "width"), [((1080, 1920), 480), ((1920, 1080), 270), ((540, 540), 480), ((90, 160), 160), ((160, 90), 90)]
)
def test_the_usual_size_is_that_of_the_longer_side(tmp_path, size, width):
    write_images(tmp_path / "clip", [np.full((*size, 3), 99, np.uint8)])
    assert usual_width(tmp_path / "clip") == width
    assert ClipOptions().read(tmp_path / "clip").width == width
    assert ClipOptions(width=64).read(tmp_path / "clip").width == 64


def test_jpegs_turned_by_the_phone_come_upright(tmp_path):
    exif = Image.Exif()
    exif[274] = 6  # orientation: turn a quarter clockwise to show
    Image.fromarray(np.rot90(picture(3))).save(tmp_path / "a.jpg", exif=exif, quality=100, subsampling=0)
    error = np.abs(read_clip(tmp_path).frames[0].astype(int) - picture(3))
    assert error.max() < 40 and error.mean() < 2


def test_user_masks_per_source_frame_or_per_selected_frame(folder, tmp_path):
    per_source = read_clip(folder, frames="4:8", masks=folder / "masks").masks
    for i in range(4):
        save(tmp_path / f"mine/{i}.png", per_source[i].astype(np.uint8))  # 0 and 1 count too
    per_selection = read_clip(folder, frames="4:8", masks=tmp_path / "mine").masks
    assert per_source.dtype == bool and per_source.sum() == 64
    np.testing.assert_array_equal(per_selection, per_source)


def test_masks_of_another_resolution_are_picked_at_pixel_centres(folder, tmp_path):
    fine = np.zeros((32, 48), np.uint8)
    fine[8:16, 16:32] = 255
    save(tmp_path / "fine/a.png", fine)
    mask = read_clip(folder, frames="0:1", masks=tmp_path / "fine").masks[0]
    np.testing.assert_array_equal(mask, fine[::2, ::2] > 0)


# --- videos --------------------------------------------------------------------------------------------------------


@pytest.fixture
def video(tmp_path):
    write_video(tmp_path / "phone.mp4", [picture(i) for i in range(10)], fps=25)
    return tmp_path / "phone.mp4"


def test_video_frames_come_back(video):
    clip = read_clip(video)
    assert clip.name == "phone" and clip.fps == 25 and clip.frames.shape == (10, 16, 24, 3)
    np.testing.assert_allclose(clip.frames[:, 12:, 16:].mean((1, 2, 3)), 8 * np.arange(10), atol=2)
    part = read_clip(video, frames="3:8:2", width=12)
    assert clip.picked == "0:10:1" and part.picked == "3:8:2"
    assert part.frames.shape == (3, 8, 12, 3) and part.fps == 12.5
    np.testing.assert_allclose(part.frames[:, 6:, 8:].mean((1, 2, 3)), [24, 40, 56], atol=2)


def test_video_colours_keep_their_hue(tmp_path):
    colors = np.array([[255, 0, 0], [0, 255, 0], [0, 0, 255], [255, 255, 255], [200, 120, 40]], np.uint8)
    frames = np.broadcast_to(colors[:, None, None], (5, 16, 16, 3))
    write_video(tmp_path / "c.mp4", frames / np.float32(255), fps=24)  # float colours too
    np.testing.assert_allclose(read_clip(tmp_path / "c.mp4").frames.mean((1, 2)), colors, atol=2)


def test_grey_frames_become_a_grey_video(tmp_path):
    frames = np.broadcast_to(np.array([30, 200], np.uint8)[:, None, None], (2, 17, 16))
    write_video(tmp_path / "alpha.mp4", frames, fps=24)
    got = read_clip(tmp_path / "alpha.mp4").frames.astype(int)
    assert np.abs(got - np.array([30, 200])[:, None, None, None]).max() <= 3


def test_odd_sizes_are_padded(tmp_path):
    write_video(tmp_path / "odd.mp4", (picture(i, 25, 17) for i in range(3)), fps=29.97)
    clip = read_clip(tmp_path / "odd.mp4")
    assert clip.frames.shape == (3, 18, 26, 3)
    assert clip.fps == pytest.approx(29.97, abs=0.01)


@pytest.mark.parametrize("degrees, bright", [(90, (-1, 0)), (-90, (0, -1)), (180, (-1, -1)), (0, (0, 0))])
def test_phone_rotation_is_applied(tmp_path, degrees, bright):
    with av.open(str(tmp_path / "r.mp4"), "w") as container:
        stream = container.add_stream("libx264", rate=24)
        stream.width, stream.height, stream.pix_fmt = 32, 16, "yuv420p"
        stream.set_display_rotation(degrees)
        container.mux(stream.encode(av.VideoFrame.from_ndarray(picture(0, 32, 16), format="rgb24")))
        container.mux(stream.encode())
    frame = read_clip(tmp_path / "r.mp4").frames[0]
    assert frame.shape == ((32, 16, 3) if abs(degrees) == 90 else (16, 32, 3))
    corners = {(r, c): int(frame[r, c, 0]) for r in (0, -1) for c in (0, -1)}
    assert max(corners, key=corners.get) == bright


def picture_of_quarters(width, height):
    """Four grey levels, so that every turn and flip looks different."""
    return np.kron([[40, 90], [150, 220]], np.ones((height // 2, width // 2)))[..., None].repeat(3, -1).astype(np.uint8)


def with_matrix(path, right, down):
    """Write a film whose stored x and y axes are shown along `right` and `down`, by the matrix in the bytes of its track."""
    write_video(path, [picture_of_quarters(32, 16)] * 2, fps=24)
    content = bytearray(path.read_bytes())
    place = content.index(b"tkhd") + 4 + 40
    assert struct.unpack_from(">9i", content, place) == (1 << 16, 0, 0, 0, 1 << 16, 0, 0, 0, 1 << 30)
    entries = [round(each * (1 << 16)) for each in (*right, 0, *down, 0)]
    struct.pack_into(">6i", content, place, *entries)
    path.write_bytes(content)
    return path


@pytest.mark.parametrize("swapped", [False, True])
@pytest.mark.parametrize("signs", list(product((1, -1), repeat=2)))
def test_every_display_matrix_of_right_angles_and_flips_is_applied(tmp_path, signs, swapped):
    axes = np.diag(signs)[:, ::-1] if swapped else np.diag(signs)
    frame = read_clip(with_matrix(tmp_path / "m.mp4", *axes)).frames[0].astype(int)
    assert frame.shape == ((32, 16, 3) if swapped else (16, 32, 3))
    # Each stored pixel, counted from the middle, is seen where the matrix takes it.
    stored = picture_of_quarters(32, 16).astype(int)
    for x, y in product((-8, 8), (-4, 4)):
        seen_x, seen_y = np.array([x, y]) @ axes
        shown = frame[frame.shape[0] // 2 + seen_y, frame.shape[1] // 2 + seen_x]
        assert np.abs(shown - stored[8 + y, 16 + x]).max() < 12


@pytest.mark.parametrize("axes", [((1, 0.5), (0, 1)), ((0.9, 0.4), (-0.4, 0.9)), ((0, 0), (0, 0)), ((1, 0), (0, 0))])
def test_other_display_matrices_are_refused(tmp_path, axes):
    with pytest.raises(
        F4xError, match=r"askew\.mp4 is to be shown turned by no right angle or askew .*; export it upright"
    ):
        read_clip(with_matrix(tmp_path / "askew.mp4", *axes))


def test_masks_of_a_video(video, tmp_path):
    for i in range(10):
        save(tmp_path / f"m/{i:02d}.png", np.full((16, 24), i >= 5, np.uint8))
    np.testing.assert_array_equal(read_clip(video, frames="4:7", masks=tmp_path / "m").masks.all((1, 2)), [0, 1, 1])


def test_failed_video_leaves_nothing_behind(tmp_path):
    with pytest.raises(F4xError, match="no frames"):
        write_video(tmp_path / "a.mp4", [], 24)
    with pytest.raises(F4xError, match="one size"):
        write_video(tmp_path / "a.mp4", [picture(0), picture(0, 30, 20)], 24)
    assert not list(tmp_path.iterdir())


def test_images_round_trip(tmp_path):
    frames = np.random.default_rng(0).uniform(size=(3, 5, 7, 3))
    files = write_images(tmp_path / "new" / "out", frames)
    assert [file.name for file in files] == ["00000.png", "00001.png", "00002.png"]
    np.testing.assert_array_equal(read_clip(tmp_path / "new" / "out").frames, np.round(frames * 255))


# --- data-set layouts ----------------------------------------------------------------------------------------------


def test_davis_by_sequence_folder_or_by_root_and_name(tmp_path):
    for name in ("bear", "cow"):
        for i in range(3):
            save(tmp_path / f"JPEGImages/480p/{name}/{i:05d}.png", picture(i))
            palette = Image.fromarray((picture(0)[..., 0] > 0).astype(np.uint8), "L").convert("P")
            file = tmp_path / f"Annotations/480p/{name}/{i:05d}.png"
            file.parent.mkdir(parents=True, exist_ok=True)
            palette.save(file)
    for source in (tmp_path / "JPEGImages/480p/bear", tmp_path / "bear"):
        clip = read_clip(source, masks="layout")
        assert clip.name == "bear" and clip.fps == 24
        np.testing.assert_array_equal(clip.masks, (clip.frames == 250).any(-1))
    refused("has 2 sequences", tmp_path)
    refused("no sequence wolf", tmp_path / "wolf")


def llff_pose(center, rotation, height, width, focal):
    """Columns down, right, back of the camera in the world, then centre, then size."""
    right, down, forward = np.asarray(rotation)  # rows of world-to-camera
    return np.concatenate([np.stack([down, right, -forward, center, [height, width, focal]], 1).ravel(), [1.0, 9.0]])


def test_nvidia_poses_become_opencv_cameras(tmp_path):
    rotations = quaternion.to_matrix(quaternion.normalize(np.random.default_rng(5).normal(size=(3, 4))))
    centers = np.arange(9.0).reshape(3, 3)
    for i in range(3):
        save(tmp_path / f"images/{i:03d}.png", picture(i))
        save(tmp_path / f"motion_masks/{i:03d}.png", np.eye(16, 24, i, dtype=np.uint8) * 255)
    poses = [llff_pose(c, r, 32, 48, 60) for c, r in zip(centers, rotations, strict=True)]
    np.save(tmp_path / "poses_bounds.npy", poses)
    clip = read_clip(tmp_path, frames="1:3", masks="layout")
    assert len(clip.cameras) == 2 and clip.masks[0, 0, 1]
    camera = clip.cameras[0]
    np.testing.assert_allclose(camera.world_to_camera[:3, :3], rotations[1], atol=1e-12)
    np.testing.assert_allclose(camera.center, centers[1], atol=1e-12)
    np.testing.assert_allclose(camera.intrinsics, [[30, 0, 12], [0, 30, 8], [0, 0, 1]])  # frames are half the pose size
    (tmp_path / "images/000.png").unlink()
    refused("3 poses for 2 pictures", tmp_path)
    (tmp_path / "poses_bounds.npy").write_bytes(b"nothing")
    refused("LLFF", tmp_path)


@pytest.fixture
def dycheck(tmp_path):
    q = quaternion.normalize(np.random.default_rng(9).normal(size=(4, 4)))
    rotations = quaternion.to_matrix(q)
    names = ["0_00002", "0_00000", "0_00001"]
    for i, name in enumerate(["0_00000", "0_00001", "0_00002", "1_00000"]):
        save(tmp_path / f"rgb/2x/{name}.png", picture(i))
        camera = {
            "focal_length": 40.0,
            "image_size": [48, 32],
            "orientation": rotations[i].tolist(),
            "position": [i, 0.5, -1],
            "principal_point": [25.0, 15.0],
            "skew": 0.0,
            "pixel_aspect_ratio": 1.0,
            "radial_distortion": [0.0, 0.0, 0.0],
            "tangential_distortion": [0.0, 0.0],
        }
        (tmp_path / "camera").mkdir(exist_ok=True)
        (tmp_path / f"camera/{name}.json").write_text(json.dumps(camera))
        (tmp_path / "depth/2x").mkdir(parents=True, exist_ok=True)
        depth = np.full((16, 24, 1), 1.0 + i)
        depth[0, 0] = 0
        np.save(tmp_path / f"depth/2x/{name}.npy", depth)
    (tmp_path / "splits").mkdir()
    (tmp_path / "splits/train.json").write_text(json.dumps({"frame_names": names, "time_ids": [2, 0, 1]}))
    (tmp_path / "dataset.json").write_text(json.dumps({"ids": [*names, "1_00000"], "train_ids": sorted(names)}))
    (tmp_path / "extra.json").write_text(json.dumps({"fps": 60}))
    return tmp_path, rotations


def test_dycheck_cameras_depth_and_split(dycheck):
    folder, rotations = dycheck
    clip = read_clip(folder, width=12)
    np.testing.assert_array_equal(clip.frames, [picture(i, 12, 8) for i in range(3)])
    assert clip.fps == 60
    camera = clip.cameras[2]
    np.testing.assert_allclose(camera.center, [2, 0.5, -1], atol=1e-12)
    np.testing.assert_allclose(camera.world_to_camera[:3, :3], rotations[2], atol=1e-12)
    np.testing.assert_allclose(camera.intrinsics, [[10, 0, 6.25], [0, 10, 3.75], [0, 0, 1]])
    assert clip.depth.dtype == np.float32 and clip.depth.shape == (3, 8, 12)
    np.testing.assert_array_equal(clip.depth[:, 4, 4], [1, 2, 3])
    assert np.isnan(read_clip(folder).depth[0, 0, 0])
    (folder / "splits/train.json").unlink()
    assert len(read_clip(folder)) == 3
    (folder / "dataset.json").unlink()
    assert len(read_clip(folder)) == 4
    (folder / "depth/2x/0_00001.npy").unlink()
    assert read_clip(folder).depth is None
    (folder / "camera/0_00001.json").write_text("{}")
    refused("no Nerfies camera", folder)
    (folder / "camera/0_00001.json").unlink()
    refused(re.escape("0_00001.json"), folder)


def test_lens_distortion_is_taken_out(dycheck):
    """A dot painted where the distorted lens shows a point must come to where the pinhole projects it."""
    folder, _ = dycheck
    width, height = 240, 160
    k1 = -0.3
    x, y = -0.35, 0.25  # on the plane z = 1
    factor = 1 + k1 * (x * x + y * y)
    scale = width / 48
    column, row = (40 * x * factor + 25) * scale, (40 * y * factor + 15) * scale
    rows, columns = np.mgrid[:height, :width] + 0.5
    blob = np.exp(-((columns - column) ** 2 + (rows - row) ** 2) / 18)
    for file in (folder / "camera").iterdir():
        camera = json.loads(file.read_text()) | {"radial_distortion": [k1, 0, 0]}
        file.write_text(json.dumps(camera))
        save(folder / f"rgb/2x/{file.stem}.png", np.repeat((250 * blob).astype(np.uint8)[..., None], 3, -1))
    clip = read_clip(folder)
    weights = clip.frames[1, ..., 0].astype(float)
    found = np.array([(weights * columns).sum(), (weights * rows).sum()]) / weights.sum()
    camera = clip.cameras[1]
    expected, _ = camera.project((camera.camera_to_world @ [x, y, 1, 1])[:3])
    np.testing.assert_allclose(found, expected, atol=0.1)
    assert np.linalg.norm(expected - [column, row]) > 2  # without undistortion the test would fail


# --- bad input -----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("frames", ["", "3", "a:b", "1:2:3:4", "-1:3", "0:4:0", "0:4:-1", "0.5:2"])
def test_bad_frame_ranges_are_refused(folder, frames):
    refused("first:end:step", folder, frames=frames)


@pytest.mark.parametrize("frames", ["0:13", "12:", "20:30"])
def test_frames_out_of_range_are_refused(folder, video, frames):
    refused("has frames 0:12", folder, frames=frames)
    refused("has frames 0:10", video, frames=frames)


def test_empty_ranges_are_refused(folder, video):
    refused("select nothing", folder, frames="5:5")
    refused("select nothing", video, frames="5:3")


def test_sources_that_are_not_there_or_empty(tmp_path):
    refused("does not exist", tmp_path / "missing.mp4")
    refused("no pictures", tmp_path)
    (tmp_path / "notes.txt").write_text("not a video")
    refused(r"notes\.txt cannot be read as a video", tmp_path / "notes.txt")
    (tmp_path / "dog.f4x").write_bytes(b"PK")
    refused(r"dog\.f4x is a fitted scene, and a clip is wanted", tmp_path / "dog.f4x")
    refused("no pictures", tmp_path)


def test_sound_without_pictures_is_refused(tmp_path):
    with av.open(str(tmp_path / "song.wav"), "w") as container:
        stream = container.add_stream("pcm_s16le", rate=8000, layout="mono")
        sound = av.AudioFrame.from_ndarray(np.zeros((1, 800), np.int16), format="s16", layout="mono")
        sound.sample_rate = 8000
        container.mux(stream.encode(sound))
        container.mux(stream.encode())
    refused("holds no video", tmp_path / "song.wav")


def test_unequal_and_corrupt_pictures_are_named(folder):
    save(folder / "images/5.png", picture(5, 20, 16))
    refused(r"5\.png is 20x16, the first frame is 24x16", folder)
    (folder / "images/5.png").write_bytes((folder / "images/4.png").read_bytes()[:60])
    refused(r"5\.png cannot be read as a picture", folder)
    (folder / "images/5.png").write_bytes(b"")
    refused(r"5\.png cannot be read as a picture", folder)


def test_masks_that_do_not_fit_are_refused(folder, tmp_path, video):
    save(tmp_path / "few/0.png", np.zeros((16, 24), np.uint8))
    refused("holds 1 masks for 12 frames", folder, masks=tmp_path / "few")
    refused("holds 12 masks for 10 frames", video, masks=folder / "masks")
    save(tmp_path / "few/0.png", np.zeros((16, 20), np.uint8))
    refused("same aspect", folder, frames="0:1", masks=tmp_path / "few")
    refused("holds no masks", folder, masks=tmp_path / "nowhere")
    refused("comes without masks", video, masks="layout")


@pytest.mark.parametrize("options", [{"hold_out": 1}, {"hold_out": 0}, {"width": 0}])
def test_senseless_options_are_refused(folder, options):
    refused("give", folder, **options)


def test_clip_refuses_arrays_that_do_not_belong_together():
    frames = np.zeros((2, 4, 6, 3), np.uint8)
    good = {"name": "a", "times": np.arange(2.0), "fps": 24.0, "held_out": np.zeros(2, bool), "source": "a.mp4"}
    assert len(Clip(frames=frames, **good)) == 2
    for wrong in (
        {"frames": frames.astype(float)},
        {"frames": frames[:0]},
        {"held_out": np.zeros(3, bool)},
        {"masks": np.zeros((2, 4, 4), bool)},
        {"depth": np.zeros((1, 4, 6), np.float32)},
    ):
        with pytest.raises(F4xError, match=r"a\.mp4"):
            Clip(**({"frames": frames, **good} | wrong))


@pytest.mark.real
def test_real_clip(shared):
    clip = read_clip(shared / "clips" / "camel", frames="0:20:4", width=160, hold_out=2, masks="layout")
    assert clip.frames.shape == (5, 90, 160, 3)
    assert 0.1 < clip.masks.mean() < 0.3
