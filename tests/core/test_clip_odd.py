"""Odd films and folders: each is read right, or what was left out, mended or guessed is told. All are made here."""

from fractions import Fraction
from itertools import pairwise

import av
import cv2
import numpy as np
import pytest
from PIL import Image

from f4x_core.cli.info import sentences
from f4x_core.clip import read_clip, write_video
from f4x_core.clip.clock import Shown, read_clock
from f4x_core.clip.images import list_images, read_mask
from f4x_core.clip.notes import Note, remarks
from f4x_core.clip.pixels import as_8_bit
from f4x_core.clip.repeats import without_repeats
from f4x_core.clip.stream import ClipStream, survey
from f4x_core.errors import F4xError

WIDTH, HEIGHT = 96, 64


TEXTURE = cv2.resize(np.random.default_rng(0).normal(0, 60, (32, 96)), (192, 64), interpolation=cv2.INTER_LINEAR)


def scene(index, width=WIDTH, height=HEIGHT):
    """A textured picture that moves by three pixels a frame, so that each frame is told from all others."""
    shift = np.float32([[1, 0, -3 * index], [0, 1, 0]])
    moved = cv2.warpAffine(TEXTURE, shift, (WIDTH, HEIGHT), borderMode=cv2.BORDER_REFLECT)
    picture = np.stack([130 + moved, 120 + 0.9 * moved, 110 + 0.8 * moved], -1)
    return cv2.resize(picture.clip(0, 255).round().astype(np.uint8), (width, height), interpolation=cv2.INTER_AREA)


SCENES = [scene(index) for index in range(24)]


def which(frames, seen=slice(None)):
    """The scene that each frame shows, and the worst PSNR (dB)."""
    stack = np.stack(SCENES)[:, :, seen].astype(float)
    errors = np.array([((stack - frame[:, seen]) ** 2).mean((1, 2, 3)) for frame in frames])
    return errors.argmin(1).tolist(), 10 * np.log10(255**2 / max(errors.min(1).max(), 1e-3))


def film(path, frames, codec="libx264", pixels="yuv420p", rate=24, stamps=None, source="rgb24", mark=None, **options):
    """Write frames (H,W,C) uint8, at `stamps` in milliseconds where they are given."""
    if codec not in av.codecs_available:
        pytest.skip(f"this PyAV has no encoder {codec}")
    if codec == "libx264":  # else its bytes change from run to run (its vector code reads unset memory)
        options = {"crf": "8", "threads": "1", "x264-params": "asm=0", **options}
    with av.open(str(path), "w") as container:
        stream = container.add_stream(codec, rate=rate, options=options)
        stream.height, stream.width = frames[0].shape[:2]
        stream.pix_fmt = pixels
        if stamps is not None:
            stream.codec_context.time_base = Fraction(1, 1000)
        for index, pixels_of in enumerate(frames):
            frame = av.VideoFrame.from_ndarray(np.ascontiguousarray(pixels_of), format=source)
            if mark is not None:
                mark(frame)
            if stamps is not None:
                frame.pts, frame.time_base = stamps[index], Fraction(1, 1000)
            container.mux(stream.encode(frame))
        container.mux(stream.encode())
    return path


def told(clip):
    """All remarks as one text."""
    return " ".join(map(str, clip.remarks))


# --- damage -----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("name", "codec", "options"),
    [
        ("p.mp4", "libx264", {"bf": "0"}),
        ("b.mp4", "libx264", {"bf": "3"}),
        ("open.mkv", "libx264", {"bf": "3", "x264-params": "open-gop=1"}),
        ("b.ts", "libx264", {"bf": "2"}),
        ("p.avi", "libx264", {"bf": "0"}),
        ("b.avi", "mpeg4", {"bf": "2", "qmin": "2", "qmax": "3", "b": "20M"}),
        ("p.ts", "mpeg2video", {"bf": "0", "qmin": "2", "qmax": "3", "b": "20M"}),
        ("photos.avi", "mjpeg", {"qmin": "2", "qmax": "3", "b": "20M"}),
    ],
)
@pytest.mark.parametrize("packet", [11, 8])
def test_what_is_built_on_a_damaged_frame_is_left_out(tmp_path, name, codec, options, packet):
    pixels = "yuvj420p" if codec == "mjpeg" else "yuv420p"
    cuts = "0" if codec == "libx264" else "1000000000"  # of a threshold for more key frames, or for fewer
    path = film(tmp_path / name, SCENES, codec, pixels, g="8", sc_threshold=cuts, **options)
    whole = read_clip(path)
    assert which(whole.frames)[0] == list(range(24)) and not whole.remarks
    with av.open(str(path)) as container:
        place = [(each.pos, each.size) for each in container.demux(video=0) if each.size][packet]
    content = bytearray(path.read_bytes())
    first, length = place[0] + place[1] // 3, min(60, place[1] // 2)
    content[first : first + length] = bytes(length) if codec == "mjpeg" else bytes((7 * i) % 256 for i in range(length))
    path.write_bytes(content)
    clip = read_clip(path)
    frames, worst = which(clip.frames)
    lost = sorted(set(range(24)) - set(frames))
    assert worst > which(whole.frames)[1] - 1 and lost and lost[0] >= 6 and lost[-1] <= 17
    assert np.allclose(clip.times / clip.fps * 24, np.array(frames) - frames[0], atol=0.02), "times are kept"
    assert f"{len(lost)} frame" in told(clip) and "damaged" in told(clip)


@pytest.mark.parametrize(
    ("codec", "lost", "more"),
    [
        ("libx264", 3, {}),
        ("libx264", 3, {"x264-params": "mbtree=0"}),  # what is left of a key frame decodes without an error
        ("mpeg2video", 3, {}),
        ("libx265", 1, {}),
    ],
)
def test_what_a_broadcast_lost_spoils_no_frame_that_is_kept(tmp_path, codec, lost, more):
    kinds = {
        "libx264": {"g": "8", "bf": "2"},
        "mpeg2video": {"g": "8", "qmin": "2", "qmax": "3", "b": "20M"},
        "libx265": {"x265-params": "log-level=none:keyint=8:bframes=0:crf=12"},
    }
    path = film(tmp_path / "a.ts", SCENES, codec, **kinds[codec], **more)
    worst, content = which(read_clip(path).frames)[1], path.read_bytes()
    place = len(content) // 188 // 2 * 188
    path.write_bytes(content[:place] + content[place + lost * 188 :])
    clip = read_clip(path)
    assert 8 <= len(clip) < 24 and which(clip.frames)[1] > worst - 1 and "damaged" in told(clip)


def copy_packets(source, target, chosen):
    """Write those packets of a film of which `chosen(number, packet)` is true."""
    with av.open(str(source)) as one, av.open(str(target), "w") as other:
        stream = other.add_stream_from_template(one.streams.video[0])
        for number, packet in enumerate(packet for packet in one.demux(video=0) if packet.size):
            if chosen(number, packet):
                packet.stream = stream
                other.mux(packet)


@pytest.mark.parametrize("name", ["a.mkv", "a.mp4", "a.avi"])
@pytest.mark.parametrize("options", [{"bf": "0"}, {"bf": "2", "x264-params": "open-gop=1"}])
def test_what_is_built_on_a_missing_frame_is_left_out(tmp_path, name, options):
    whole, path = film(tmp_path / f"whole_{name}", SCENES, g="8", sc_threshold="0", **options), tmp_path / name
    with av.open(str(whole)) as source:
        packets = [packet for packet in source.demux(video=0) if packet.size]
    missing = max((number for number in range(9, 14) if not packets[number].is_keyframe), key=lambda n: packets[n].size)
    copy_packets(whole, path, lambda number, packet: number != missing)
    worst, clip = which(read_clip(whole).frames)[1], read_clip(path)
    frames, psnr = which(clip.frames)
    assert psnr > worst - 1 and "damaged" in told(clip)
    assert set(range(7)) | set(range(18, 24)) <= set(frames) and len(frames) == len(set(frames))


def test_frames_that_hevc_leaves_out_after_a_missing_one_are_told(tmp_path):
    options = {"x265-params": "log-level=none:keyint=8:min-keyint=8:scenecut=0:bframes=0"}
    whole, path = film(tmp_path / "whole.mp4", SCENES, "libx265", **options), tmp_path / "a.mp4"
    copy_packets(whole, path, lambda number, packet: number != 11)
    worst, clip = which(read_clip(whole).frames)[1], read_clip(path)
    frames, psnr = which(clip.frames)
    assert psnr > worst - 1 and frames == [*range(11), *range(16, 24)] and "4 frames of the film" in told(clip)
    assert told(read_clip(whole)) == ""


def test_two_recordings_joined_byte_by_byte_are_whole(tmp_path):
    parts = [film(tmp_path / f"{first}.ts", SCENES[first : first + 12], bf="2") for first in (0, 12)]
    joined = tmp_path / "joined.ts"
    joined.write_bytes(b"".join(part.read_bytes() for part in parts))
    clip = read_clip(joined)
    assert which(clip.frames)[0] == list(range(24)) and clip.steady and clip.fps == 24
    assert told(clip) == "The time stamps of the film do not increase, so its frames are taken for evenly spaced."


def test_masks_belong_to_the_frames_that_are_kept(tmp_path):
    path = film(tmp_path / "a.mp4", [SCENES[index // 2] for index in range(24)])
    masks = tmp_path / "masks"
    masks.mkdir()
    for index in range(24):
        Image.fromarray(np.full((HEIGHT, WIDTH), 255 * (index == 8), np.uint8)).save(masks / f"{index}.png")
    assert read_clip(path, masks=masks).masks.any((1, 2)).tolist() == [index == 4 for index in range(12)]


# --- repeats and time -------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("shown", "rate", "fps"),
    [
        ([index // 2 for index in range(24)], 24, 12),
        ([index * 4 // 5 for index in range(30)], 30, 24),
        ([index * 2 // 5 for index in range(40)], 60, 24),
    ],
)
@pytest.mark.parametrize("where", ["film", "folder"])
def test_repeated_frames_are_left_out(tmp_path, shown, rate, fps, where):
    frames = [SCENES[index] for index in shown]
    if where == "film":
        source = film(tmp_path / "a.mp4", frames, rate=rate, crf="23")
    else:
        source, rate, fps = tmp_path, 24, 24 * fps / rate
        for index, frame in enumerate(frames):
            Image.fromarray(frame).save(tmp_path / f"{index}.jpg", quality=90)
    clip = read_clip(source)
    assert which(clip.frames)[0] == sorted(set(shown))
    assert clip.steady and clip.fps == pytest.approx(fps, rel=0.01)
    assert f"{len(shown) - len(clip)} frames of the source repeat the one before" in told(clip)
    assert survey(source).count == len(clip) and survey(source).remarks == clip.remarks
    last = len(clip) - 1
    part = read_clip(source, f"{last - 4}:{last + 1}:2")
    assert (
        which(part.frames)[0] == [last - 4, last - 2, last]
        and part.steady
        and part.fps == pytest.approx(fps / 2, rel=0.01)
    )
    np.testing.assert_array_equal(np.stack(list(ClipStream(source, part.picked, WIDTH, HEIGHT, 3))), part.frames)


@pytest.mark.parametrize(
    "shown", [[0] * 9, [0] * 3, [0, 0, 0, *[1] * 9, 2, 3], [0, 1, 2, 3, 3, 3, 3, 3, 3, 3, 3, 4], list(range(12))]
)
def test_what_stands_still_is_no_repeat(shown):
    frames = [Shown(SCENES[index], number / 24, 0.0, number) for number, index in enumerate(shown)]
    notes: list[Note] = []
    kept = [each.number for each in without_repeats(frames, notes)]
    short = {number for number in range(1, 3) if shown[:4] == [0, 0, 0, 1]}  # moved before and after
    assert kept == [number for number in range(len(shown)) if number not in short] and len(notes) == len(short)


def test_one_wrong_time_stamp_is_mended_and_many_are_not_believed():
    stamps = np.concatenate([np.arange(10) * 0.04, 0.4 + np.arange(14) * 0.12])
    right = read_clock(stamps, 0.001, 24)
    for frame, value in ((6, stamps[5]), (6, 0.0), (6, 9.0), (0, stamps[1])):
        wrong = stamps.copy()
        wrong[frame] = value
        clock = read_clock(wrong, 0.001, 24)
        assert np.allclose(clock.times / clock.fps, right.times / right.fps, atol=0.03), (frame, value)
        assert [note.kind for note in clock.notes] == ["stamp"]
    joined = read_clock(np.concatenate([stamps, stamps]), 0.001, 24)
    assert joined.times.tolist() == list(range(48)) and [note.kind for note in joined.notes] == ["unordered"]
    decoding = np.arange(12.0)[[0, 2, 3, 1, 5, 6, 4, 8, 9, 7, 11, 10]] / 24
    assert read_clock(decoding, 0.001, 24).notes == () and read_clock(decoding, 0.001, 24).fps == 24


@pytest.mark.parametrize("off", [0, 0.001])
def test_two_frames_with_the_time_of_the_one_before_are_mended(off):
    stamps = np.round(np.arange(24) / 24, 3)
    stamps[12], stamps[13] = stamps[11], stamps[11] + off
    clock = read_clock(stamps, 0.001, 24)
    assert np.allclose(clock.times / clock.fps * 24, range(24), atol=0.05)
    assert [note.frame for note in clock.notes] == [12, 13]


@pytest.mark.parametrize("minutes", [1, 15, 20, 60, 600])
def test_frames_around_a_pause_of_any_length_keep_their_times(minutes):
    stamps = np.round(np.arange(24) / 24, 3)
    stamps[12:] += 60 * minutes
    clock = read_clock(stamps, 0.001, 24)
    steps = np.diff(clock.times)
    assert (np.delete(steps, 11) < steps[11] / 50).all() and (steps > 0).all() and clock.times[-1] == 23
    assert [(note.kind, note.frame, round(note.seconds)) for note in clock.notes] == [("gap", 12, 60 * minutes)]


def test_a_long_gap_is_told(tmp_path):
    clip = read_clip(film(tmp_path / "a.mkv", SCENES[:12], "ffv1", "bgr0", stamps=[0, *range(5040, 5480, 40)]))
    assert "Between frames 0 and 1 nothing is shown for 5.0 s, 126 times the usual interval" in told(clip)
    assert not read_clip(tmp_path / "a.mkv", "1:").remarks


@pytest.mark.parametrize(("numbers", "whole", "count"), [((5, 6, 8, 10), (False, False), 1), ((5, 8), (True, True), 4)])
def test_remarks_are_of_the_chosen_frames_alone(numbers, whole, count):
    notes = [Note("damaged", frame, frame / 24) for frame in (3, 4, 7, 12)] + [Note("source", 0, text="Told.")]
    sentences = [str(remark) for remark in remarks(notes, np.array(numbers), whole)]
    assert sentences[0] == "Told." and sentences[1].startswith(f"{count} frame")
    left = [Note("damaged", 7, 0.3), Note("gap", 8, 0.4, "9"), Note("gap", 10, 0.5, "9")]
    assert ["frames 2 and 3" in str(each) for each in remarks(left, np.array([5, 6, 8, 10]))] == [False, True]


def test_a_scene_file_tells_how_its_clip_was_read():
    assert sentences(["One.", 2, "Three."]) == ["One.", "Three."]
    assert sentences(None) == sentences("One.") == sentences({"a": 1}) == []


# --- pixels -----------------------------------------------------------------------------------------------------------


def hidden():
    """RGBA frames whose right half hides magenta."""
    frames = [np.dstack([frame, np.full(frame.shape[:2], 255, np.uint8)]) for frame in SCENES]
    for frame in frames:
        frame[:, WIDTH // 2 :] = (255, 0, 255, 0)
    return frames


def alpha_film(path):
    options = {"prores.mov": {"profile": "4444"}, "vp8.webm": {"auto-alt-ref": "0", "b": "4M"}}.get(path.name, {})
    codec, pixels = {
        "prores.mov": ("prores_ks", "yuva444p10le"),
        "qtrle.mov": ("qtrle", "argb"),
        "png.mov": ("png", "rgba"),
        "ffv1.mkv": ("ffv1", "bgra"),
        "vp9.webm": ("libvpx-vp9", "yuva420p"),
        "vp8.webm": ("libvpx", "yuva420p"),
    }[path.name]
    return film(path, hidden()[:6], codec, pixels, source="rgba", **options)


def alpha_folder(path):
    path.mkdir()
    for index, frame in enumerate(hidden()[:6]):
        image = Image.fromarray(frame)
        if path.name == "LA":
            image = image.convert("LA")
        if path.name == "P":
            image = image.convert("RGB").quantize(255)
            values = np.array(image)
            values[:, WIDTH // 2 :] = 255
            palette = image.getpalette()
            image = Image.fromarray(values, "P")
            image.putpalette([*palette, *[0] * (765 - len(palette)), 255, 0, 255])
            image.info["transparency"] = 255
        if path.name == "16":
            cv2.imwrite(str(path / f"{index}.png"), frame[..., [2, 1, 0, 3]].astype(np.uint16) * 257)
        else:
            image.save(path / f"{index}.png")
    return path


@pytest.mark.parametrize(
    "name", ["prores.mov", "qtrle.mov", "png.mov", "ffv1.mkv", "vp9.webm", "vp8.webm", "RGBA", "LA", "P", "16"]
)
@pytest.mark.parametrize("width", [None, 48])
def test_what_alpha_hides_is_not_seen(tmp_path, name, width):
    source = (alpha_film if "." in name else alpha_folder)(tmp_path / name)
    clip = read_clip(source, width=width)
    middle = clip.width // 2
    assert clip.hidden[:, :, middle:].all() and not clip.hidden[:, :, : middle - 3].any()
    magenta = clip.frames[..., [0, 2]].astype(int).min(-1) - clip.frames[..., 1]
    if name != "LA":
        assert np.median(magenta[clip.hidden]) < 120 and not (clip.frames == (255, 0, 255)).all(-1).any()
        expected = [cv2.resize(frame, (clip.width, clip.height), interpolation=cv2.INTER_AREA) for frame in SCENES[:6]]
        error = np.abs(np.stack(expected).astype(int) - clip.frames)[:, :, : middle - 4]
        assert error.mean() < (12 if name in ("vp9.webm", "vp8.webm", "P") else 2)
    assert "Alpha hides 5" in told(clip) and "--masks alpha" in told(clip)
    matte = read_clip(source, width=width, masks="alpha")
    assert matte.masks[:, :, : middle - 1].all() and not matte.masks[:, :, middle + 1 :].any()
    assert matte.hidden is None and not matte.remarks


def test_opaque_pictures_have_no_alpha(tmp_path):
    opaque = [np.dstack([frame, np.full_like(frame[..., 0], 255)]) for frame in SCENES]
    film(tmp_path / "a.mov", opaque, "qtrle", "argb", source="rgba")
    clip = read_clip(tmp_path / "a.mov")
    assert clip.hidden is None and not clip.remarks
    with pytest.raises(F4xError, match=r"a\.mov has no alpha in the chosen frames"):
        read_clip(tmp_path / "a.mov", masks="alpha")


@pytest.mark.parametrize(
    ("name", "scale", "kind", "colour", "says"),
    [
        ("grey.png", 257, np.uint16, False, ""),
        ("colour.png", 257, np.uint16, True, ""),
        ("colour.tiff", 257, np.uint16, True, ""),
        ("grey.tif", 257, np.uint16, False, ""),
        ("twelve.png", 4095 / 255, np.uint16, False, "no value above 4095"),
        ("ten.tif", 1023 / 255, np.uint16, True, "no value above 1023"),
        ("float.tif", 1 / 255, np.float32, False, "taken for sRGB from 0 to 1"),
        ("float.tiff", 1 / 255, np.float32, True, "taken for sRGB from 0 to 1"),
    ],
)
def test_deep_pictures_are_scaled_by_their_type(tmp_path, name, scale, kind, colour, says):
    stem, suffix = name.split(".")
    frames = [frame if colour else frame[..., :1].repeat(3, -1) for frame in SCENES[:4]]
    for index, frame in enumerate(frames):
        values = frame[..., ::-1] if colour else frame[..., 0]
        values = values * scale
        values = values if kind == np.float32 else np.round(values)
        cv2.imwrite(str(tmp_path / f"{stem}{index}.{suffix}"), values.astype(kind), [cv2.IMWRITE_TIFF_COMPRESSION, 1])
    clip = read_clip(tmp_path)
    largest = max(frame.max() for frame in frames)
    assert np.abs(clip.frames.astype(int) - np.stack(frames)).max() <= (
        1 if "no value" not in says else 255 - largest + 1
    )
    assert says in told(clip) and bool(says) == bool(told(clip))


@pytest.mark.parametrize("channels", [1, 3])
def test_the_value_of_white_is_that_of_all_pictures(tmp_path, channels):
    for index in range(24):
        values = SCENES[index][..., :channels] * ((4000 if index == 5 else 900) / SCENES[index][..., :channels].max())
        cv2.imwrite(str(tmp_path / f"{index}.png"), values.round().astype(np.uint16))
    clip = read_clip(tmp_path)
    assert len(clip) == 24 and 3700 < clip.frames[5].max() / 255 * 4095 < 4050
    assert told(clip).startswith("The pictures of 16 bits hold no value above 4095")


@pytest.mark.parametrize("kind", [np.uint16, np.float32])
@pytest.mark.parametrize(("orientation", "quarters"), [(3, 2), (6, 1), (8, 3)])
def test_deep_pictures_are_turned_upright_once(tmp_path, kind, orientation, quarters):
    grey = SCENES[3][..., 1]
    values = np.rot90(grey, quarters) * {np.uint16: 257, np.float32: 1 / 255}[kind]
    Image.fromarray(values.astype(kind)).save(tmp_path / "0.tif", tiffinfo={274: orientation})
    shown = read_clip(tmp_path).frames[0, ..., 1]
    assert shown.shape == grey.shape and np.abs(shown.astype(int) - grey).max() <= 1


def test_a_film_with_exif_is_read(tmp_path):
    exif = Image.Exif()
    exif[271] = "camera"
    Image.fromarray(SCENES[0]).save(tmp_path / "a.tif")
    Image.fromarray(SCENES[0]).save(tmp_path / "a.jpg", exif=exif, quality=95)
    assert [which(read_clip(tmp_path / name).frames)[0] for name in ("a.tif", "a.jpg")] == [[0], [0]]


def test_digits_that_are_no_numbers_sort_as_letters(tmp_path):
    for name in ("\u00b23.png", "1.png"):
        Image.fromarray(SCENES[0]).save(tmp_path / name)
    assert [file.name for file in list_images(tmp_path)] == ["1.png", "\u00b23.png"]
    assert len(read_clip(tmp_path)) == 2


@pytest.mark.parametrize(
    ("values", "reason"),
    [
        (np.full((4, 4), 3.0, np.float32), "floating-point values from 3 to 3"),
        (np.full((4, 4), np.nan), "floating-point values from nan"),
        (np.full((4, 4), 3, np.int32), "type int32"),
    ],
)
def test_values_of_no_known_range_are_refused(tmp_path, values, reason):
    with pytest.raises(ValueError, match=reason):
        as_8_bit(values)
    if values.dtype != np.float64:
        Image.fromarray(values).save(tmp_path / "a.tif")
        with pytest.raises(F4xError, match=rf"a\.tif holds .*{reason}.*write it as a PNG"):
            read_clip(tmp_path)


def test_ycgco_is_read(tmp_path):
    frames = []
    for r, g, b in (frame.astype(float).transpose(2, 0, 1) for frame in SCENES[:3]):
        planes = ((r + 2 * g + b) / 4, (-r + 2 * g - b) / 4 + 128, (r - b) / 2 + 128)
        frames.append(np.round(np.stack(planes)).clip(0, 255).astype(np.uint8))

    def encode(matrix):
        with av.open(str(tmp_path / "a.mkv"), "w") as container:
            stream = container.add_stream("libx264", rate=24, options={"crf": "2"})
            stream.width, stream.height, stream.pix_fmt = WIDTH, HEIGHT, "yuv444p"
            stream.codec_context.colorspace, stream.codec_context.color_range = matrix, 2
            for planes in frames:
                frame = av.VideoFrame.from_ndarray(planes, format="yuv444p")
                frame.colorspace, frame.color_range = matrix, 2
                container.mux(stream.encode(frame))
            container.mux(stream.encode())

    encode(8)
    assert which(read_clip(tmp_path / "a.mkv").frames) == ([0, 1, 2], pytest.approx(50, abs=12))
    encode(14)
    with pytest.raises(
        F4xError, match=r"a\.mkv has its colours in ICtCp, which is not read here; convert it to BT\.709"
    ):
        read_clip(tmp_path / "a.mkv")


# --- sizes, streams and names -----------------------------------------------------------------------------------------


def two_sizes(path, width, height):
    """VP8 whose pictures change their size after six frames, as a call does."""
    small = [cv2.resize(frame, (width, height), interpolation=cv2.INTER_AREA) for frame in SCENES[6:12]]
    if "libvpx" not in av.codecs_available:
        pytest.skip("this PyAV has no encoder libvpx")
    with av.open(str(path), "w") as container:
        stream = container.add_stream("libvpx", rate=24, options={"b": "4M", "crf": "4"})
        stream.width, stream.height, stream.pix_fmt = WIDTH, HEIGHT, "yuv420p"
        other = av.CodecContext.create("libvpx", "w")
        other.width, other.height, other.pix_fmt, other.time_base = width, height, "yuv420p", Fraction(1, 24)
        other.options = {"b": "4M", "crf": "4"}
        for frame in SCENES[:6]:
            container.mux(stream.encode(av.VideoFrame.from_ndarray(frame, format="rgb24")))
        container.mux(stream.encode())
        packets = []
        for index, pixels in enumerate(small):
            frame = av.VideoFrame.from_ndarray(pixels, format="rgb24")
            frame.pts, frame.time_base = 6 + index, Fraction(1, 24)
            packets += other.encode(frame)
        for packet in packets + other.encode(None):
            packet.stream = stream
            container.mux(packet)
    return path


def test_a_film_that_changes_size_is_scaled_or_refused(tmp_path):
    clip = read_clip(two_sizes(tmp_path / "a.webm", 48, 32))
    assert which(clip.frames)[0] == list(range(12)) and "6 frames of another size (48x32) are scaled" in told(clip)
    with pytest.raises(F4xError, match=r"b\.webm: from frame 6 on the picture is 32x48.*--frames 0:6"):
        read_clip(two_sizes(tmp_path / "b.webm", 32, 48))
    assert len(read_clip(tmp_path / "b.webm", "0:6")) == 6


def test_pictures_of_another_size_and_the_same_shape_are_scaled(tmp_path):
    for index, frame in enumerate(SCENES[:4]):
        Image.fromarray(cv2.resize(frame, (192, 128)) if index == 2 else frame).save(tmp_path / f"{index}.png")
    clip = read_clip(tmp_path)
    assert which(clip.frames)[0] == [0, 1, 2, 3] and "1 frame of another size (192x128) is scaled" in told(clip)


@pytest.mark.parametrize("first", ["picture", "film"])
@pytest.mark.parametrize(("name", "size", "count"), [("a.mp4", 1, 1), ("a.mp4", 2, 13), ("a.mkv", 2, 13)])
def test_the_film_is_the_stream_with_frames(tmp_path, first, name, size, count):
    other = [np.repeat(np.repeat(frame, size, 0), size, 1) for frame in SCENES[:count]]
    with av.open(str(tmp_path / name), "w") as container:
        kinds = {"picture": ("mjpeg", "yuvj420p", other), "film": ("libx264", "yuv420p", SCENES)}
        order = sorted(kinds, key=lambda kind: kind != first)
        streams = {}
        for kind in order:
            streams[kind] = container.add_stream(kinds[kind][0], rate=24)
            streams[kind].height, streams[kind].width = kinds[kind][2][0].shape[:2]
            streams[kind].pix_fmt = kinds[kind][1]
        for kind in order:
            for frame in kinds[kind][2]:
                container.mux(streams[kind].encode(av.VideoFrame.from_ndarray(frame, format="rgb24")))
            container.mux(streams[kind].encode())
    clip = read_clip(tmp_path / name)
    assert (clip.width, which(clip.frames)[0]) == (WIDTH, list(range(24))) and "holds 2 films" in told(clip)


@pytest.mark.parametrize(
    ("name", "text", "kind"),
    [
        ("notes.txt", "hello world\n" * 1000, "text"),
        ("a.ffconcat", "ffconcat version 1.0\nfile real.mp4\n", "list of files"),
        ("a.mp4", "ffconcat version 1.0\nfile real.mp4\n", "list of files"),
        ("a.m3u8", "#EXTM3U\n#EXT-X-TARGETDURATION:10\n#EXTINF:1,\nreal.ts\n#EXT-X-ENDLIST\n", "list of files"),
    ],
)
def test_texts_are_no_films(tmp_path, name, text, kind):
    film(tmp_path / "real.mp4", SCENES[:3])
    film(tmp_path / "real.ts", SCENES[:3])
    (tmp_path / name).write_text(text)
    with pytest.raises(F4xError, match=f"is a {kind} and no film|cannot be read as a video"):
        read_clip(tmp_path / name)


@pytest.mark.parametrize("name", ["10:30.mp4", "100%03d.mp4", "a%d.gif", "~x.mp4", "-.mp4", "file:a.mp4"])
def test_names_that_ffmpeg_would_read_otherwise(tmp_path, monkeypatch, name):
    monkeypatch.chdir(tmp_path)
    if name.endswith(".gif"):
        images = [Image.fromarray(frame) for frame in SCENES[:6]]
        images[0].save(tmp_path / name, save_all=True, append_images=images[1:], duration=40)
    else:
        write_video(tmp_path / name, SCENES[:6], 24)
    assert which(read_clip(name).frames)[0] == list(range(6))


def test_webp_animations_are_read(tmp_path):
    images = [Image.fromarray(frame) for frame in SCENES[:6]]
    images[0].save(tmp_path / "a.webp", save_all=True, append_images=images[1:], duration=[40, 40, 80, 40, 40, 40])
    clip = read_clip(tmp_path / "a.webp")
    assert which(clip.frames)[0] == list(range(6)) and not clip.remarks
    assert np.allclose(clip.times / clip.fps, np.array([0, 40, 80, 160, 200, 240]) / 1000, atol=1e-3)


@pytest.mark.parametrize(
    "names",
    [
        ("{:04d}.png", "{:04d}_mask.png"),
        ("{:04d}.png", "mask_{}.png"),
        ("{:04d}.jpg", "{:04d}.mask.png"),
        ("frame_{}.png", "matte-{}.png"),
        ("{:03d}.jpg", "{:03d}.jpg.png"),
        ("IMG_{:04d}.JPG", "IMG_{:04d}_seg.png"),
    ],
)
def test_masks_beside_the_pictures_are_no_frames(tmp_path, names):
    for index, frame in enumerate(SCENES[:6]):
        Image.fromarray(frame).save(tmp_path / names[0].format(index), quality=98)
        Image.fromarray(np.full((HEIGHT, WIDTH), 255 * (index == 3), np.uint8)).save(tmp_path / names[1].format(index))
    clip = read_clip(tmp_path, masks="layout")
    assert which(clip.frames)[0] == list(range(6)) and clip.masks.any((1, 2)).tolist() == [i == 3 for i in range(6)]
    assert "6 pictures like" in told(clip) and "belong to others and are no frames; --masks layout" in told(clip)


@pytest.mark.parametrize(
    ("extra", "every"),
    [
        ("frame_0001 copy.png", False),
        ("frame_0001 - Kopie.png", False),
        ("frame_0001 (1).png", False),
        ("frame_0001_edited.jpg", False),
        ("frame_{:04d}_small.png", True),
        ("frame_{}_small.png", True),
        ("cover.jpg", False),
        ("contact_sheet.png", False),
        ("preview.png", False),
    ],
)
def test_pictures_beside_a_numbered_sequence_are_no_frames(tmp_path, extra, every):
    name = "frame_{}.png" if extra.startswith("frame_{}") else "frame_{:04d}.png"
    for index, frame in enumerate(SCENES[:12]):
        Image.fromarray(frame).save(tmp_path / name.format(index))
        if every or index == 1:
            Image.fromarray(frame).save(tmp_path / extra.format(index))
    clip = read_clip(tmp_path)
    assert which(clip.frames)[0] == list(range(12)) and clip.steady
    assert told(clip).startswith(f"{12 if every else 1} picture") and "by the name, and left out" in told(clip)


@pytest.mark.parametrize(
    "names",
    [
        ["Photo.png", *(f"Photo ({index}).png" for index in range(1, 6))],
        [f"{index:x}.png" for index in range(8, 14)],
        [f"2026_0{index // 2}{'_1' * (index % 2)}.png" for index in range(6)],
        [f"{kind}_{index}.png" for kind in ("a", "b") for index in range(3)],
        ["a.png", "b.png", "c1.png", "c2.png"],
    ],
)
def test_names_that_differ_are_frames_all_the_same(tmp_path, names):
    for index, name in enumerate(names):
        Image.fromarray(SCENES[index]).save(tmp_path / name)
    assert len(read_clip(tmp_path)) == len(names) and not read_clip(tmp_path).remarks


def test_a_folder_of_masks_alone_is_one_of_pictures(tmp_path):
    for index, frame in enumerate(SCENES[:4]):
        Image.fromarray(frame).save(tmp_path / f"mask_{index}.png")
    assert len(read_clip(tmp_path)) == 4


def test_other_maps_and_second_endings_are_no_frames(tmp_path):
    for index, frame in enumerate(SCENES[:4]):
        Image.fromarray(frame).save(tmp_path / f"{index}.png")
        Image.fromarray(frame).save(tmp_path / f"{index}_depth.png")
        if index < 2:
            Image.fromarray(frame).save(tmp_path / f"{index}.jpg")
    clip = read_clip(tmp_path)
    assert which(clip.frames)[0] == [0, 1, 2, 3]
    assert "4 pictures like 0_depth.png" in told(clip) and "2 pictures (.jpg) have the name of another" in told(clip)


def test_files_of_other_kinds_are_told_and_leave_their_time(tmp_path):
    for index, frame in enumerate(SCENES[:6]):
        if index == 2:
            (tmp_path / "IMG_2.HEIC").write_bytes(b"\0\0\0\x18ftypheic")
        else:
            Image.fromarray(frame).save(tmp_path / f"IMG_{index}.png")
    (tmp_path / "IMG_3.mov").write_bytes(b"live")
    (tmp_path / "notes.txt").write_text("of no matter")
    clip = read_clip(tmp_path)
    assert which(clip.frames)[0] == [0, 1, 3, 4, 5]
    assert np.allclose(clip.times / clip.fps * 24, [0, 1, 3, 4, 5], atol=0.01)
    assert told(clip) == "1 .HEIC, 1 .mov files are not read as frames. The pictures around them keep their times."
    Image.fromarray(SCENES[2]).save(tmp_path / "IMG_2.png")  # the same picture, converted
    assert read_clip(tmp_path).steady


def test_a_folder_of_other_kinds_alone_is_refused_with_the_reason(tmp_path):
    (tmp_path / "IMG_1.HEIC").write_bytes(b"\0\0\0\x18ftypheic")
    with pytest.raises(F4xError, match=r"holds only \.heic files, which are not read as frames; convert them to JPEG"):
        read_clip(tmp_path)
    (tmp_path / "IMG_1.HEIC").rename(tmp_path / "IMG_1.MOV")
    with pytest.raises(F4xError, match=r"holds films \(\.mov\) and no pictures; give one of the files"):
        read_clip(tmp_path)


@pytest.mark.parametrize("colour", ["same", "marks"])
def test_alpha_of_a_mask_hides_what_it_covers(tmp_path, colour):
    values = np.full((HEIGHT, WIDTH, 4), 255, np.uint8)
    values[:, 48:, 3] = 0
    if colour == "marks":
        values[32:, :, :3] = 0
    Image.fromarray(values).save(tmp_path / "mask.png")
    mask = read_mask(tmp_path / "mask.png")
    assert mask[:32, :48].all() and not mask[:, 48:].any() and mask[32:, :48].all() == (colour == "same")


def test_a_clip_that_is_hidden_whole_is_refused(tmp_path):
    for index in range(3):
        Image.fromarray(np.dstack([SCENES[index], np.zeros_like(SCENES[index][..., 0])])).save(
            tmp_path / f"{index}.png"
        )
    with pytest.raises(F4xError, match="alpha hides all of the chosen frames"):
        read_clip(tmp_path)


def test_every_kind_of_film_stays_free_of_remarks(tmp_path):
    sources = [
        film(tmp_path / "a.mp4", SCENES),
        film(tmp_path / "slow.mp4", [scene(index / 12) for index in range(24)]),
        film(tmp_path / "b.avi", SCENES, bf="2"),
        film(tmp_path / "h.mp4", SCENES, "libx265", **{"x265-params": "log-level=none:bframes=0"}),
    ]
    for source in sources:
        clip = read_clip(source)
        assert len(clip) == 24 and clip.steady and not clip.remarks, source
        assert all(b > a for a, b in pairwise(clip.times))
