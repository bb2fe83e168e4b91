"""Films as phones and editors write them: each is read right or refused in one sentence. Every film is made here with PyAV."""

from fractions import Fraction
from itertools import pairwise

import av
import numpy as np
import pytest

from f4x_core.clip import hdr, read_clip, write_video
from f4x_core.clip.clock import GRID, read_clock
from f4x_core.clip.stream import ClipStream, survey
from f4x_core.clip.video import decode
from f4x_core.errors import F4xError

WIDTH, HEIGHT = 96, 64
TICKS = 600  # of a second
COLOURS = np.array(
    [[200, 30, 30], [30, 200, 30], [30, 30, 200], [230, 230, 230], [128, 128, 128], [20, 20, 20], [220, 190, 60], [90, 60, 40]]
)  # fmt: skip


def encoder(name):
    """Skip where this FFmpeg cannot write such films."""
    if name not in av.codecs_available:
        pytest.skip(f"this PyAV has no encoder {name}")
    return name


def picture(index):
    """A grey picture in which a bar says which frame it is."""
    image = np.full((HEIGHT, WIDTH, 3), 90, np.uint8)
    image[:, : 3 * (index + 1)] = 200
    return image


def number(image):
    """Which `picture` this is; None for none, as a grey one."""
    row = image.astype(int).mean(-1)[len(image) // 2]
    assert abs(row[-1] - 90) < 8, "neither bar nor ground"
    return round((row > 145).sum() * WIDTH / len(row) / 3) - 1


def film(path, frames, codec="libx264", stamps=None, setup=None, mark=None, format=None, **options):
    """Write VideoFrames or (H,W,3) arrays, at `stamps` ticks (20 apart when None)."""
    frames = [f if isinstance(f, av.VideoFrame) else av.VideoFrame.from_ndarray(f, format="rgb24") for f in frames]
    with av.open(str(path), "w", format=format) as container:
        stream = container.add_stream(
            encoder(codec), rate=30, options={"crf": "4", **options} if "x26" in codec else options
        )
        stream.width, stream.height, stream.pix_fmt = frames[0].width, frames[0].height, "yuv420p"
        exact = "x26" in codec  # older codecs know no clock this fine
        stream.codec_context.time_base = Fraction(1, TICKS if exact else 30)
        if setup is not None:
            setup(stream)
        for index, frame in enumerate(frames):
            if frame.format.name != stream.pix_fmt:
                frame = frame.reformat(format=stream.pix_fmt)
            frame.time_base = stream.codec_context.time_base
            frame.pts = stamps[index] if stamps is not None else index * (20 if exact else 1)
            if mark is not None:
                mark(frame)
            container.mux(stream.encode(frame))
        container.mux(stream.encode())
    return path


def remuxed(source, target, dropped=0, shift=0.0):
    """The film without its first packets, `shift` seconds earlier: what lies before 0 is hidden by an edit list."""
    with av.open(str(source)) as one, av.open(str(target), "w", options={"avoid_negative_ts": "disabled"}) as other:
        stream = other.add_stream_from_template(one.streams.video[0])
        packets = [packet for packet in one.demux(one.streams.video[0]) if packet.size]
        for packet in packets[dropped:]:
            ticks = round(shift / packet.time_base)
            packet.pts, packet.dts, packet.stream = packet.pts - ticks, packet.dts - ticks, stream
            other.mux(packet)
    return target


# --- colours ----------------------------------------------------------------------------------------------------------


def light_2020(colours):
    """cd/m2 (n,3) in the primaries of BT.2020 of sRGB colours, white at 203; from the chromaticities, not the code's matrix."""

    def to_xyz(*primaries):
        x, y = np.array([*primaries]).T
        matrix = np.array([x / y, np.ones(3), (1 - x - y) / y])
        white = np.array([0.3127 / 0.3290, 1.0, (1 - 0.3127 - 0.3290) / 0.3290])
        return matrix * np.linalg.solve(matrix, white)

    value = np.asarray(colours) / 255
    linear = np.where(value <= 0.04045, value / 12.92, ((value + 0.055) / 1.055) ** 2.4)
    wide = to_xyz((0.708, 0.292), (0.170, 0.797), (0.131, 0.046))
    return 203 * linear @ (np.linalg.inv(wide) @ to_xyz((0.64, 0.33), (0.30, 0.60), (0.15, 0.06))).T


def coded(light, transfer):
    """R'G'B' (n,3) in [0,1] of light in cd/m2: SMPTE ST 2084, or BT.2100's HLG on a display of 1000 cd/m2."""
    light = np.maximum(light, 0)
    if transfer == "pq":
        power = (light / 10000) ** (2610 / 16384)
        return ((3424 / 4096 + 2413 / 128 * power) / (1 + 2392 / 128 * power)) ** (2523 / 32)
    luminance = light @ [0.2627, 0.6780, 0.0593] / 1000
    scene = light / 1000 * np.maximum(luminance, 1e-9)[:, None] ** (1 / 1.2 - 1)
    high = 0.17883277 * np.log(np.maximum(12 * scene - 0.28466892, 1e-9)) + 0.55991073
    return np.where(scene <= 1 / 12, np.sqrt(3 * scene), high)


def test_graphics_white_is_75_percent_of_hlg_and_58_of_pq():
    white = light_2020([[255, 255, 255]])
    assert coded(white, "hlg") == pytest.approx(0.75, abs=0.002) and coded(white, "pq") == pytest.approx(
        0.58, abs=0.002
    )


@pytest.mark.parametrize("transfer", ["hlg", "pq"])
def test_srgb_put_into_hdr_comes_back_and_highlights_keep_their_order(transfer):
    code = np.round(65535 * coded(light_2020(COLOURS), transfer)).astype(np.uint16)
    assert np.abs(hdr.to_srgb(code[None], transfer)[0].astype(int) - COLOURS).max() <= 1
    bright = coded(np.array([[203.0], [406.0], [800.0], [1000.0], [2000.0]]).repeat(3, 1), transfer)
    grey = hdr.to_srgb(np.round(65535 * np.minimum(bright, 1)).astype(np.uint16)[None], transfer)[0, :, 0].astype(int)
    assert 240 <= grey[0] < grey[1] < grey[2] <= grey[3] == 255 == grey[4]


def hdr_frame(transfer):
    """The colours as patches, in limited-range Y'CbCr of BT.2020 with 10 bits, made by hand."""
    rgb = coded(light_2020(COLOURS), transfer).repeat(16, 0)[None].repeat(HEIGHT, 0)
    luma = rgb @ [0.2627, 0.6780, 0.0593]
    planes = (luma, (rgb[..., 2] - luma) / 1.8814, (rgb[..., 0] - luma) / 1.4746)
    scaled = [planes[0] * 876 + 64, *(plane[::2, ::2] * 896 + 512 for plane in planes[1:])]
    frame = av.VideoFrame(rgb.shape[1], HEIGHT, "yuv420p10le")
    for plane, values in zip(frame.planes, scaled, strict=True):
        rows = np.zeros((plane.height, plane.line_size // 2), "<u2")
        rows[:, : plane.width] = np.round(values)
        plane.update(rows)
    return frame


@pytest.mark.parametrize(("transfer", "number"), [("hlg", 18), ("pq", 16)])
def test_hdr_films_of_phones_come_out_as_srgb(tmp_path, transfer, number):
    def setup(stream):
        context = stream.codec_context
        stream.pix_fmt = "yuv420p10le"
        context.color_primaries, context.color_trc, context.colorspace, context.color_range = 9, number, 9, 1

    # Without bframes=0, x265 makes up decoding times of so short a film.
    tags = f"log-level=none:bframes=0:colorprim=9:transfer={number}:colormatrix=9"
    path = film(
        tmp_path / "a.mov", [hdr_frame(transfer), hdr_frame(transfer)], "libx265", setup=setup, **{"x265-params": tags}
    )
    patches = read_clip(path).frames[1].reshape(HEIGHT, len(COLOURS), 16, 3)[HEIGHT // 2, :, 8]
    assert np.abs(patches.astype(int) - COLOURS).max() <= 3


@pytest.mark.parametrize(
    ("size", "matrix", "tagged"),
    [
        ((1280, 64), "ITU709", False),
        ((96, 578), "ITU709", False),
        ((96, 64), "ITU601", False),
        ((96, 64), "ITU709", True),
    ],
)
def test_colours_without_a_tag_are_read_as_players_guess(tmp_path, size, matrix, tagged):
    wide, high = size
    colour = np.full((high, wide, 3), (180, 60, 40), np.uint8)
    plain = av.VideoFrame.from_ndarray(colour, format="rgb24").reformat(format="yuv420p", dst_colorspace=matrix)

    def setup(stream):
        if tagged:
            stream.codec_context.colorspace = 1

    def mark(frame):
        frame.colorspace = 1 if tagged else 2

    path = film(tmp_path / "a.mp4", [plain], setup=setup, mark=mark)
    assert np.abs(read_clip(path).frames[0, high // 2, wide // 2].astype(int) - colour[0, 0]).max() <= 3


def test_full_range_is_read_as_such(tmp_path):
    def setup(stream):
        stream.pix_fmt = "yuvj420p"

    path = film(
        tmp_path / "a.mp4", [np.full((HEIGHT, WIDTH, 3), level, np.uint8) for level in (0, 16, 240, 255)], setup=setup
    )
    assert np.abs(read_clip(path).frames[:, 5, 5, 0].astype(int) - [0, 16, 240, 255]).max() <= 2


# --- time -------------------------------------------------------------------------------------------------------------

GAPS = [20, 20, 60, 20, 60, 20, 20, 60, 20, 20, 20]  # ticks: a 30th and a 10th of a second
STAMPS = np.concatenate([[0], np.cumsum(GAPS)]).tolist()


@pytest.mark.parametrize("suffix", ["mp4", "mov", "mkv"])
def test_varying_frame_rates_give_true_times(tmp_path, suffix):
    path = film(tmp_path / f"a.{suffix}", map(picture, range(12)), stamps=STAMPS)
    clip = read_clip(path)
    assert clip.times[0] == 0 and clip.times[-1] == 11 and not clip.steady
    assert np.allclose(clip.times / clip.fps, np.array(STAMPS) / TICKS, atol=0.0012), "seconds are those of the file"
    assert [number(frame) for frame in clip.frames] == list(range(12))
    part = read_clip(path, frames="2:11:2")  # frames by index
    assert [number(frame) for frame in part.frames] == [2, 4, 6, 8, 10]
    assert np.allclose(part.times / part.fps, (np.array(STAMPS[2:11:2]) - STAMPS[2]) / TICKS, atol=0.0012)
    assert clip.digest != read_clip(film(tmp_path / f"b.{suffix}", map(picture, range(12)))).digest


@pytest.mark.parametrize("suffix", ["mp4", "mkv", "avi"])
@pytest.mark.parametrize("frames", [None, "1::3"])
def test_constant_rates_keep_whole_times(tmp_path, suffix, frames):
    clip = read_clip(film(tmp_path / f"a.{suffix}", map(picture, range(14)), codec="mpeg4"), frames)
    assert clip.steady and clip.times.tolist() == list(range(len(clip)))
    assert clip.fps == (30 if frames is None else 10)


@pytest.mark.parametrize(
    ("seconds", "tick", "fps"),
    [
        (np.round(np.arange(200) / 240, 3), 0.001, 240),  # the clock of Matroska
        (np.floor(np.arange(50) / 30 * 100) / 100, 0.01, 30),  # of GIF
        (np.arange(50) / 24, 1 / 12288, 24),
        ([0.0, 0.1, 0.1, 0.1, 0.2], 0.001, 25),  # a clock that stands still tells nothing
        ([np.nan] * 5, 0.0, 25),
        ([0.5], 0.001, 25),
    ],
)
def test_clocks_that_count_as_constant(seconds, tick, fps):
    clock = read_clock(seconds, tick, fps)
    assert clock.fps == fps and clock.times.tolist() == list(range(len(seconds)))


def test_a_missing_frame_or_a_wrong_rate_is_believed():
    lost = np.delete(np.arange(12), 5) / 30
    clock = read_clock(lost, 1 / 30, 30)
    assert np.allclose(clock.times / clock.fps, lost, atol=1e-3) and clock.times[-1] == 10
    assert (clock.times * GRID % 1 == 0).all(), "so that windows find their shared frames by their times"
    assert read_clock(np.arange(9) / 30, 1e-3, 600.0).fps == pytest.approx(30)


def test_a_survey_keeps_the_clock_of_the_whole(tmp_path):
    path = film(tmp_path / "a.mp4", map(picture, range(12)), stamps=STAMPS)
    known = survey(path, width=48)
    whole = read_clip(path)
    assert np.array_equal(known.clock(0, 12).times, whole.times) and known.clock(0, 12).fps == whole.fps
    reel = ClipStream(path, None, WIDTH, HEIGHT, 12)
    assert np.array_equal(np.stack(list(reel.frames)), whole.frames)


def test_a_written_film_keeps_its_times(tmp_path):
    times = np.array([0.0, 0.5, 2.5, 3.0])
    write_video(tmp_path / "a.mp4", map(picture, range(4)), 24.0, times + 7)
    shown = [shown.seconds for shown in decode(tmp_path / "a.mp4")]
    assert np.allclose(np.subtract(shown, shown[0]), times / 24, atol=1e-3)


# --- pixels -----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("aspect", "wide"), [(Fraction(4, 3), 128), (Fraction(8, 9), 86), (Fraction(1, 1), 96)])
def test_pixels_become_square(tmp_path, aspect, wide):
    def setup(stream):
        stream.codec_context.sample_aspect_ratio = aspect

    image = np.full((HEIGHT, WIDTH, 3), 40, np.uint8)  # black would be bars
    image[16:48, 24:72] = 220  # a box amid the picture
    frame = read_clip(film(tmp_path / "a.mp4", [image], setup=setup)).frames[0]
    assert frame.shape == (HEIGHT, wide, 3)
    columns = np.flatnonzero(frame[HEIGHT // 2, :, 0] > 110)
    assert abs(len(columns) - wide / 2) <= 1 and abs(columns.mean() + 0.5 - wide / 2) <= 1


def woven(index):
    """An interlaced picture: a block at two places, on even rows where it was first."""
    image = np.full((HEIGHT, WIDTH, 3), 40, np.uint8)
    for field in (0, 1):
        left = 8 + 3 * (2 * index + field)
        image[field::2, left : left + 24] = 220
    return image


def combing(frame):
    """Mean step between neighbouring rows."""
    return np.abs(np.diff(frame.astype(float)[8:-8, :, 0], axis=0)).mean()


def test_interlaced_films_are_deinterlaced_one_frame_each(tmp_path):
    path = film(tmp_path / "a.mp4", map(woven, range(9)), flags="+ildct", **{"x264-params": "tff=1"})
    with av.open(str(path)) as container:
        assert next(container.decode(video=0)).interlaced_frame
    clip = read_clip(path)
    assert len(clip) == 9 and clip.steady and clip.fps == 30
    assert combing(woven(4)) > 10 and max(map(combing, clip.frames)) < 3
    middles = [np.flatnonzero(frame[HEIGHT // 2, :, 0] > 130).mean() for frame in clip.frames]
    assert np.allclose(np.diff(middles), 6, atol=1.5), "in order, none twice"


def test_ten_seconds_at_sixty_frames(tmp_path):
    path = film(
        tmp_path / "a.mp4", (picture(i % 30) for i in range(600)), stamps=range(0, 6000, 10), preset="ultrafast"
    )
    clip = read_clip(path, width=48)
    assert len(clip) == 600 and clip.steady and clip.fps == pytest.approx(60, rel=0.01)
    assert len(read_clip(path, "::2", 48)) == 300


def test_too_many_frames_for_memory_are_told(tmp_path, monkeypatch):
    path = film(tmp_path / "a.mp4", map(picture, range(3)))

    def full(*_):
        raise MemoryError

    monkeypatch.setattr("f4x_core.clip.read.np.empty", full)
    with pytest.raises(F4xError, match=r"3 frames of 96x64 do not fit into memory; give --frames ::2"):
        read_clip(path)


# --- cut and damaged files ----------------------------------------------------------------------------------------------


def test_frames_before_an_edit_list_are_not_shown(tmp_path):
    whole = film(tmp_path / "whole.mp4", map(picture, range(12)), bf="0")
    clip = read_clip(remuxed(whole, tmp_path / "cut.mp4", shift=5 / 30))
    assert [number(frame) for frame in clip.frames] == list(range(5, 12)) and clip.steady


@pytest.mark.parametrize(
    ("codec", "suffix"), [("libx264", "mp4"), ("libx264", "ts"), ("libx265", "mp4"), ("mpeg4", "avi"), ("mpeg4", "mp4")]
)
def test_without_the_first_key_frame_the_film_begins_at_the_next(tmp_path, codec, suffix):
    keys = (
        {"g": "8", "bf": "0"} if codec != "libx265" else {"x265-params": "log-level=none:keyint=8:bframes=0:scenecut=0"}
    )
    whole = film(tmp_path / f"whole.{suffix}", map(picture, range(20)), codec, **keys)
    frames = [number(frame) for frame in read_clip(remuxed(whole, tmp_path / f"cut.{suffix}", dropped=3)).frames]
    assert frames[-1] == 19 and frames[0] >= 3 and len(frames) >= 4
    assert all(b == a + 1 for a, b in pairwise(frames)), "never a grey frame"


def test_without_any_key_frame_it_is_refused(tmp_path):
    whole = film(tmp_path / "whole.avi", map(picture, range(8)), "mpeg4", g="50")
    with pytest.raises(F4xError, match=r"cut\.avi has no frame that can be shown whole"):
        read_clip(remuxed(whole, tmp_path / "cut.avi", dropped=2))


def test_a_song_with_a_cover_is_no_film(tmp_path):
    path = tmp_path / "song.m4a"
    with av.open(str(path), "w", format="mp4") as container:
        sound = container.add_stream(encoder("aac"), rate=8000, layout="mono")
        cover = container.add_stream("mjpeg", rate=1)
        cover.width, cover.height, cover.pix_fmt = 32, 32, "yuvj420p"
        cover.disposition = av.stream.Disposition.attached_pic
        image = av.VideoFrame.from_ndarray(np.zeros((32, 32, 3), np.uint8), format="rgb24").reformat(format="yuvj420p")
        noise = av.AudioFrame.from_ndarray(np.zeros((1, 1024), np.float32), format="fltp", layout="mono")
        noise.sample_rate = 8000
        container.mux(sound.encode(noise))
        container.mux(cover.encode(image))
        container.mux([*cover.encode(), *sound.encode()])
    with pytest.raises(F4xError, match=r"song\.m4a holds no video, only a cover and audio;"):
        read_clip(path)


def test_empty_files_are_refused(tmp_path):
    whole = film(tmp_path / "whole.mp4", [picture(0)]).read_bytes()
    for name, length in (("nothing.mp4", 0), ("head.mp4", 200)):
        (tmp_path / name).write_bytes(whole[:length])
        with pytest.raises(F4xError, match=rf"{name} cannot be read as a video"):
            read_clip(tmp_path / name)
    with av.open(str(tmp_path / "short.mkv"), "w") as container:
        stream = container.add_stream(encoder("mpeg4"), rate=30)
        stream.width, stream.height, stream.pix_fmt = 32, 32, "yuv420p"
        container.start_encoding()
    with pytest.raises(F4xError, match=r"short\.mkv"):
        read_clip(tmp_path / "short.mkv")


def test_a_truncated_film_says_how_far_it_goes(tmp_path):
    rng = np.random.default_rng(0)
    noise = [rng.integers(0, 255, (HEIGHT, WIDTH, 3), dtype=np.uint8) for _ in range(30)]
    path = tmp_path / "cut.mov"
    with av.open(str(path), "w", options={"movflags": "+faststart"}) as container:
        stream = container.add_stream(encoder("libx264"), rate=30, options={"g": "1", "bf": "0"})
        stream.width, stream.height, stream.pix_fmt = WIDTH, HEIGHT, "yuv420p"
        for image in noise:
            container.mux(stream.encode(av.VideoFrame.from_ndarray(image, format="rgb24")))
        container.mux(stream.encode())
    data = path.read_bytes()
    path.write_bytes(data[: len(data) // 2])
    with pytest.raises(
        F4xError, match=r"cut\.mov (breaks off|is damaged) after (\d+) frames.*give --frames 0:\2 "
    ) as message:
        read_clip(path)
    whole = int(str(message.value).split("--frames 0:")[1].split()[0])
    assert 10 <= whole < 20 and len(read_clip(path, f"0:{whole}")) == whole
    path.write_bytes(data[-len(data) // 2 :])
    with pytest.raises(F4xError, match=r"cut\.mov cannot be read as a video"):
        read_clip(path)
