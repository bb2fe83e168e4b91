"""Black bars around films: found, not confused with dark edges, cut off of frames and masks alike."""

from dataclasses import replace

import numpy as np
import pytest
from labelled_scene import labelled_scene

from f4x_core.clip.bars import BLACK, picture_in
from f4x_core.clip.images import write_images
from f4x_core.clip.model import Picture, cut
from f4x_core.clip.read import read_clip
from f4x_core.clip.stream import ClipStream, survey
from f4x_core.clip.video import glimpses, write_video
from f4x_core.scene.resemblance import resemblance
from f4x_core.scene.view import render

RNG = np.random.default_rng(2)


def film(count=8, height=48, width=80, top=8, bottom=8, left=0, right=0):
    """Frames of noise within black bars."""
    frames = RNG.integers(40, 255, (count, height, width, 3), dtype=np.uint8)
    frames[:, :top], frames[:, height - bottom :] = 0, 0
    frames[:, :, :left], frames[:, :, width - right :] = 0, 0
    return frames


@pytest.mark.parametrize(
    ("sides", "found"),
    [
        ({}, (0, 10, 80, 38)),
        ({"top": 0, "bottom": 0, "left": 12, "right": 12}, (14, 0, 66, 48)),
        ({"left": 10, "right": 11}, (12, 10, 67, 38)),  # both ways, a pixel from the middle
        ({"top": 0, "bottom": 0}, None),
        ({"bottom": 0}, None),  # a night sky
        ({"top": 4, "bottom": 8}, None),
        ({"top": 20, "bottom": 20}, None),  # hardly any picture is left
    ],
)
def test_bars_are_black_edges_on_both_sides(sides, found):
    picture = picture_in(film(**sides))
    assert picture == (found and Picture(*found, 80, 48))


def test_black_frames_say_nothing_and_what_is_lit_once_is_no_bar():
    frames = film()
    frames[:3] = 0
    assert picture_in(frames) == Picture(0, 10, 80, 38, 80, 48)
    assert picture_in(0 * frames) is None and picture_in([]) is None
    frames[5, 2, 7] = BLACK
    assert picture_in(frames) == Picture(0, 10, 80, 38, 80, 48)
    frames[5, 0, 7] = BLACK + 1
    assert picture_in(frames) is None


def test_frames_and_masks_of_any_size_are_cut_alike():
    picture = Picture(10, 8, 70, 40, 80, 48)
    frame = RNG.integers(0, 255, (48, 80, 3))
    np.testing.assert_array_equal(cut(frame, picture), frame[8:40, 10:70])
    assert cut(frame[::2, ::2, 0], picture).shape == (16, 30) and cut(frame, None) is frame
    assert str(picture) == "60x32 of 80x48"


def test_a_folder_is_read_without_bars_and_its_masks_too(tmp_path):
    frames = film()
    write_images(tmp_path / "frames", frames)
    masks = np.zeros((8, 48, 80), np.uint8)
    masks[:, 8:24] = 255
    write_images(tmp_path / "masks", masks)
    clip = read_clip(tmp_path / "frames", frames="2:6", masks=tmp_path / "masks")
    np.testing.assert_array_equal(clip.frames, frames[2:6, 10:38])
    assert clip.masks[:, :14].all() and not clip.masks[:, 14:].any()
    assert clip.picture == Picture(0, 10, 80, 38, 80, 48)
    assert read_clip(tmp_path / "frames", width=40).frames.shape == (8, 14, 40, 3)


def test_every_part_of_a_source_is_cut_alike(tmp_path):
    frames = film()
    frames[:4, :12] = 0  # the first half is dark for itself
    write_images(tmp_path, frames)
    part = read_clip(tmp_path, "0:4")
    assert part.frames.shape[1:3] == (28, 80)
    streamed = list(ClipStream(tmp_path, "0:4", 80, 28, 4))
    np.testing.assert_array_equal(streamed, part.frames)
    assert survey(tmp_path).count == 8


def test_a_film_is_read_without_bars(tmp_path):
    still = np.repeat(film(1, 96, 160, 16, 16), 30, 0)
    write_video(tmp_path / "film.mp4", still, 30.0)
    assert len(list(glimpses(tmp_path / "film.mp4", 5))) == 5
    clip = read_clip(tmp_path / "film.mp4", "5:9")
    top, bottom = clip.picture.top, clip.picture.bottom
    assert clip.picture == Picture(0, top, 160, bottom, 160, 96) and 16 <= top <= 18 and 78 <= bottom <= 80
    assert clip.frames.shape == (4, bottom - top, 160, 3)
    assert np.abs(clip.frames[0].astype(int) - still[0, top:bottom]).mean() < 40  # noise in half the colours


SOUND = {"left": 0, "top": 2, "right": 9, "bottom": 7, "width": 9, "height": 9}


@pytest.mark.parametrize(
    "values", [None, [], {}, {"left": 0}, SOUND | {"width": 8}, SOUND | {"left": 0.5}, SOUND | {"x": 1}]
)
def test_a_scene_file_may_say_anything(values):
    assert Picture.read(values) is None and Picture.read(SOUND) == Picture(0, 2, 9, 7, 9, 9)


def test_a_frame_with_bars_resembles_a_scene_without():
    scene = labelled_scene(features=False)
    inner = render(scene, scene.cameras[0], 0.0)["rgb"].mean(-1)
    height, width = inner.shape
    framed = np.pad(inner, [(height // 2, height // 2), (0, 0)])
    known = {"left": 0, "top": height // 2, "right": width, "bottom": height // 2 + height, "width": width,
             "height": 2 * (height // 2) + height}  # fmt: skip
    barred = replace(scene, provenance={"picture": known})
    assert resemblance(barred, 0.0, framed) > 0.95 > resemblance(scene, 0.0, framed) + 0.1
