"""Films as phones write them. Each test writes its own small file."""

from fractions import Fraction

import numpy as np
import pytest

from f4x_core.clip import read_clip, write_video
from f4x_core.clip.clock import read_clock
from f4x_core.clip.hdr import to_srgb
from f4x_core.clip.stream import survey
from f4x_core.errors import F4xError

av = pytest.importorskip("av")

COLOURS = np.array([[200, 30, 30], [30, 180, 60], [40, 60, 210], [128, 128, 128], [20, 20, 20], [230, 200, 160]], float)
BLOCK = 32
BT709, BT601, BT2020, PQ, HLG = 1, 6, 9, 16, 18  # ITU-T H.273


def stripes(colours=COLOURS):
    """(32, 32 n, 3) stripes of the colours."""
    return np.repeat(np.repeat(colours[None], BLOCK, 0), BLOCK, 1)


def seen(pixels, colours=COLOURS):
    """The colour in the middle of every stripe, (n, 3)."""
    return pixels[BLOCK // 2, BLOCK // 2 :: BLOCK][: len(colours)].astype(float)


def encoded(colours, transfer):
    """R'G'B' of BT.2020, 0 to 1, of sRGB colours whose white is graphics white: BT.2100's formulas the other way round."""
    srgb = colours / 255
    linear = np.where(srgb <= 0.04045, srgb / 12.92, ((srgb + 0.055) / 1.055) ** 2.4)
    to_709 = np.array([[1.6605, -0.5876, -0.0728], [-0.1246, 1.1329, -0.0083], [-0.0182, -0.1006, 1.1187]])
    nits = 203 * linear @ np.linalg.inv(to_709).T
    if transfer == PQ:
        power = (nits / 10000) ** 0.1593017578125
        return ((0.8359375 + 18.8515625 * power) / (1 + 18.6875 * power)) ** 78.84375
    display = nits / 1000
    luminance = (display @ [0.2627, 0.6780, 0.0593])[..., None]
    scene = display * luminance ** (1 / 1.2 - 1)
    root = np.sqrt(3 * scene)
    return np.where(scene <= 1 / 12, root, 0.17883277 * np.log(np.maximum(12 * scene - 0.28466892, 1e-9)) + 0.55991073)


def write(path, images, codec, pixels, options=None, tags=None, times=None, rate=25, matrix=None, **settings):
    """A film of `images` (H,W,3), uint8 or uint16; `tags`: (primaries, transfer, matrix); `times` in ticks of 1/600 s."""
    with av.open(str(path), "w") as container:
        stream = container.add_stream(codec, rate=rate, options=options or {})
        stream.height, stream.width = images[0].shape[:2]
        stream.pix_fmt = pixels
        context = stream.codec_context
        if tags:
            context.color_primaries, context.color_trc, context.colorspace = tags
        if times is not None:
            context.time_base = Fraction(1, 600)
        for name, value in settings.items():
            setattr(context if hasattr(context, name) else stream, name, value)
        for number, image in enumerate(images):
            frame = av.VideoFrame.from_ndarray(image, format="rgb48le" if image.dtype == np.uint16 else "rgb24")
            frame = frame.reformat(format=pixels, dst_colorspace=matrix)
            if times is not None:
                frame.pts, frame.time_base = times[number], Fraction(1, 600)
            container.mux(stream.encode(frame))
        container.mux(stream.encode())
    return path


@pytest.mark.parametrize("transfer", [HLG, PQ])
def test_formulas_of_high_dynamic_range_are_those_of_the_standard(transfer):
    code = np.round(encoded(stripes(), transfer) * 65535).astype(np.uint16)
    found = to_srgb(code, "hlg" if transfer == HLG else "pq")
    np.testing.assert_allclose(seen(found), COLOURS, atol=1.01)


def test_what_is_brighter_than_white_keeps_its_shading():
    nits = np.array([203.0, 400, 1000]) / 1000
    code = np.round(
        65535
        * ((0.8359375 + 18.8515625 * (nits / 10) ** 0.1593017578125) / (1 + 18.6875 * (nits / 10) ** 0.1593017578125))
        ** 78.84375
    )
    found = to_srgb(np.repeat(code[None, :, None], 3, 2).astype(np.uint16), "pq")[0, :, 0]
    assert 240 <= found[0] < found[1] < found[2] == 255


@pytest.mark.parametrize("transfer", [HLG, PQ])
def test_ten_bits_of_high_dynamic_range_become_srgb(tmp_path, transfer):
    image = np.round(encoded(stripes(), transfer) * 65535).astype(np.uint16)
    quiet = {"x265-params": "lossless=1:log-level=none"}
    file = tmp_path / "phone.mov"
    write(file, [image] * 2, "libx265", "yuv420p10le", quiet, (BT2020, transfer, BT2020), matrix=BT2020)
    np.testing.assert_allclose(seen(read_clip(file).frames[0]), COLOURS, atol=3)


@pytest.mark.parametrize(("height", "tagged", "matrix"), [(32, True, BT709), (32, False, 5), (720, False, BT709)])
def test_colours_are_read_as_players_do(tmp_path, height, tagged, matrix):
    image = np.round(stripes()).astype(np.uint8)
    image = np.repeat(image, height // BLOCK, 0) if height > BLOCK else image
    image = np.pad(image, ((0, height - len(image)), (0, 0), (0, 0)), "edge")
    tags = (BT709, BT709, BT709) if tagged else None
    file = write(tmp_path / "film.mp4", [image] * 2, "libx264", "yuv420p", {"crf": "1"}, tags, matrix=matrix)
    np.testing.assert_allclose(seen(read_clip(file).frames[0]), COLOURS, atol=4)


def noise(count, height=32, width=48):
    rng = np.random.default_rng(0)
    coarse = rng.integers(0, 255, (count, height // 8, width // 8, 3), np.uint8)
    return coarse.repeat(8, 1).repeat(8, 2)


def test_frames_that_are_unevenly_spaced_keep_their_times(tmp_path):
    ticks = [0, 18, 60, 78, 96, 180]  # 0.03 s, 0.07 s, ...
    file = write(tmp_path / "vfr.mp4", list(noise(6)), "libx264", "yuv420p", times=ticks, rate=30)
    clip = read_clip(file)
    np.testing.assert_allclose(clip.times / clip.fps, np.array(ticks) / 600, atol=1e-3)
    assert clip.times[-1] == pytest.approx(5, abs=1e-3) and not clip.steady
    some = read_clip(file, frames="1:6:2")
    np.testing.assert_allclose(some.times / some.fps, np.array([0, 60, 162]) / 600, atol=1e-3)
    known = survey(file).clock(0, 6)
    np.testing.assert_array_equal(known.times, clip.times)


def test_a_video_is_written_at_the_times_of_its_frames(tmp_path):
    times = np.array([0, 0.5, 2, 3.5, 4])
    write_video(tmp_path / "out.mp4", noise(5), 24, times)
    clip = read_clip(tmp_path / "out.mp4")
    np.testing.assert_allclose(clip.times / clip.fps, times / 24, atol=1e-3)


def test_a_constant_rate_gives_whole_numbers(tmp_path):
    write_video(tmp_path / "even.mp4", noise(7), 29.97)
    clip = read_clip(tmp_path / "even.mp4", frames="1:7:2")
    assert clip.times.tolist() == [0, 1, 2] and clip.steady
    assert clip.fps == pytest.approx(29.97 / 2, rel=1e-3)


@pytest.mark.parametrize("seconds", [[np.nan] * 3, [0.0, 0.0, 0.1], [0.2, 0.1, 0.0]])
def test_time_stamps_that_tell_nothing_are_not_believed(seconds):
    clock = read_clock(seconds, 0.001, 30.0)
    assert clock.times.tolist() == [0, 1, 2] and clock.fps == 30


def test_rounded_time_stamps_are_even():
    clock = read_clock([0.0, 0.033, 0.067, 0.1, 0.133], 0.001, 30.0)
    assert clock.times.tolist() == [0, 1, 2, 3, 4] and clock.fps == 30


@pytest.mark.parametrize(("aspect", "size"), [((4, 3), (64, 32)), ((1, 2), (24, 32)), ((1, 1), (48, 32))])
def test_pixels_become_square(tmp_path, aspect, size):
    file = write(tmp_path / "wide.mp4", list(noise(2)), "libx264", "yuv420p", sample_aspect_ratio=Fraction(*aspect))
    clip = read_clip(file)
    assert (clip.width, clip.height) == size


def test_fields_are_woven_into_whole_frames(tmp_path):
    rows, count = 64, 6
    fields = []
    for number in range(count):  # a bar that moves by 6 pixels from field to field
        frame = np.zeros((rows, 96, 3), np.uint8)
        for parity in (0, 1):
            start = 10 + 6 * (2 * number + parity)
            frame[parity::2, start : start + 12] = 255
        fields.append(frame)
    options = {"flags": "+ildct+ilme", "qscale": "1"}
    file = write(tmp_path / "tv.mpg", fields, "mpeg2video", "yuv420p", options, bit_rate=4_000_000)
    clip = read_clip(file)
    assert len(clip) == count
    grey = clip.frames[2:-1].mean(-1)
    combs = np.abs(grey[:, 1:-1] - (grey[:, :-2] + grey[:, 2:]) / 2).mean()
    raw = np.stack(fields)[2:-1].mean(-1)
    assert combs < 0.3 * np.abs(raw[:, 1:-1] - (raw[:, :-2] + raw[:, 2:]) / 2).mean()


def test_frames_before_the_first_key_frame_are_left_out(tmp_path):
    whole = write(
        tmp_path / "whole.ts", list(noise(20)), "libx264", "yuv420p", {"g": "8", "bf": "0", "sc_threshold": "0"}
    )
    with av.open(str(whole)) as source, av.open(str(tmp_path / "cut.ts"), "w") as cut:
        stream = cut.add_stream_from_template(source.streams.video[0])
        for number, packet in enumerate(source.demux(video=0)):
            if packet.dts is not None and number >= 3:
                packet.stream = stream
                cut.mux(packet)
    clip, full = read_clip(tmp_path / "cut.ts"), read_clip(whole)
    assert len(clip) == 12  # from the second key frame on
    np.testing.assert_allclose(clip.frames[0].astype(float), full.frames[8], atol=1)


def test_a_damaged_film_is_one_sentence_that_names_the_file(tmp_path):
    file = tmp_path / "short.mp4"
    write_video(file, noise(30, 64, 64), 24)
    content = file.read_bytes()
    file.write_bytes(content[: len(content) // 3])
    with pytest.raises(F4xError, match=r"short\.mp4"):
        read_clip(file)
    file.write_bytes(b"")
    with pytest.raises(F4xError, match=r"short\.mp4"):
        read_clip(file)


@pytest.mark.slow
def test_ten_seconds_at_sixty_frames_a_second(tmp_path):
    write_video(tmp_path / "long.mp4", (frame for _ in range(10) for frame in noise(60)), 60)
    clip = read_clip(tmp_path / "long.mp4", frames="::2")
    assert len(clip) == 300 and clip.fps == pytest.approx(30)
