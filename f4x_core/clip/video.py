"""Video files through PyAV."""

from collections.abc import Iterable, Iterator
from fractions import Fraction
from itertools import count
from pathlib import Path

import numpy as np

from ..errors import F4xError
from ..files import replace_file
from .clock import GRID, Shown
from .hdr import Transfer, to_srgb
from .images import as_bytes

QUALITY = "16"  # x264 CRF: no visible loss; the file is for people, measurements use the arrays
UNTAGGED = 2  # colour properties that a file does not tell, ITU-T H.273
HDR: dict[int, Transfer] = {16: "pq", 18: "hlg"}  # transfer characteristics, ITU-T H.273
# An untagged film of at least this size is in BT.709, a smaller one in BT.601: so guesses the player mpv, and VLC alike.
HD_WIDTH, SD_HEIGHT = 1280, 576
ASKEW = 0.01  # share by which a display matrix may miss the axes; more is a turn by no right angle
SQUARE = 0.005  # pixels whose sides differ by less are square: 854 x 480 is 16:9 only so


def describe(file: Path) -> tuple[float, int]:
    """Return (average frames per second, number of frames) as the file claims, 0 where it does not tell."""
    with _opened(file) as container:
        stream = _film(container)
        return float(stream.average_rate or 0), stream.frames


def decode(file: Path) -> Iterator[Shown]:
    """Yield the frames in order of presentation: sRGB, turned and flipped as the display matrix says, with square pixels.

    Whole frames, deinterlaced where they are made of fields. Frames that cannot be decoded without ones that are missing are left
    out, as are those that an edit list hides. Raises F4xError for a file that is damaged or has no frame to show.
    """
    import av

    whole, end = 0, 0.0
    with _opened(file) as container:
        stream = _film(container)
        stream.thread_type = "AUTO"
        try:
            for frame in _whole_frames(_decodable(container, stream)):
                pixels = _upright(frame, stream)
                end = (frame.time or 0.0) + float(frame.duration * frame.time_base)
                yield Shown(pixels, np.nan if frame.time is None else frame.time, float(stream.time_base))
                whole += 1
        except av.FFmpegError as error:
            advice = (
                f"give --frames 0:{whole} for what comes before" if whole else "copy it again from where it was made"
            )
            raise F4xError(f"{file} is damaged after {whole} frames ({error.strerror}); {advice}") from error
        if whole and _breaks_off(container, stream, end):
            raise F4xError(
                f"{file} breaks off after {whole} frames; copy it again, or give --frames 0:{whole} for those"
            )
    if whole == 0:
        raise F4xError(f"{file} has no frame that can be shown whole; export it again from where it was made")


def glimpses(file: Path, count: int) -> Iterator[np.ndarray]:
    """Yield up to `count` frames (H,W,3) from all over the film, as `decode` shows them but for fields and time; they jump."""
    import av

    with _opened(file) as container:
        stream = _film(container)
        begin, length = stream.start_time or 0, stream.duration or 0
        try:
            for part in range(count):
                if length:
                    container.seek(begin + length * part // count, stream=stream)
                frame = next((each for each in container.decode(stream) if not each.is_corrupt), None)
                if frame is None:
                    return
                yield _upright(frame, stream)
        except av.FFmpegError:  # what can be seen is enough; `decode` says what is wrong
            return


def _upright(frame, stream) -> np.ndarray:
    pixels = _squared(_rgb(frame, stream), stream.sample_aspect_ratio)
    return np.ascontiguousarray(_displayed(pixels, frame, stream.container.name))


def _displayed(pixels: np.ndarray, frame, file: str) -> np.ndarray:
    """`pixels` (H,W,3) turned by right angles and flipped as the film's display matrix says; F4xError for any other matrix."""
    from av.sidedata.sidedata import Type

    data = frame.side_data.get(Type.DISPLAYMATRIX)
    if data is None:
        return pixels
    # Rows are where the stored x and y axes, right and down, go to: ISO/IEC 14496-12, 6.2.2. Their length is the pixels' shape.
    axes = np.frombuffer(bytes(data), np.int32).reshape(3, 3)[:2, :2].astype(np.float64)
    swapped = abs(axes[0, 0]) < abs(axes[0, 1])
    right, down = (axes[1, 0], axes[0, 1]) if swapped else (axes[0, 0], axes[1, 1])
    aside = axes.diagonal() if swapped else axes[::-1].diagonal()
    if right * down == 0 or np.abs(aside).max() > ASKEW * min(abs(right), abs(down)):
        raise F4xError(
            f"{file} is to be shown turned by no right angle or askew (display matrix"
            f" {' '.join(f'{each / 65536:.3g}' for each in axes.ravel())}); export it upright"
        )
    pixels = pixels.swapaxes(0, 1) if swapped else pixels
    return pixels[:: 1 if down > 0 else -1, :: 1 if right > 0 else -1]


def _breaks_off(container, stream, end: float) -> bool:
    """Whether a film whose last frame is shown until `end` (seconds) lacks more than that frame; MP4 and MOV tell in advance."""
    if "mp4" not in container.format.name or not stream.duration or not stream.average_rate:
        return False
    return end + 1.5 / stream.average_rate < ((stream.start_time or 0) + stream.duration) * stream.time_base


def _decodable(container, stream) -> Iterator:
    """Frames that need no missing ones: from the first key frame on, or decoders would begin with grey pictures."""
    begun = False
    for packet in container.demux(stream):
        begun = begun or packet.is_keyframe
        if begun:
            yield from (frame for frame in packet.decode() if not frame.is_corrupt)


def _whole_frames(frames: Iterable) -> Iterator:
    """The frames with two fields woven into one picture each, by FFmpeg's filter `bwdif`; progressive ones as they are."""
    graph = None
    for frame in frames:
        if graph is None and frame.interlaced_frame:
            graph = _deinterlacer(frame)
        if graph is None:
            yield frame
        else:
            graph.push(frame)
            yield from _pulled(graph)
    if graph is not None:
        graph.push(None)
        yield from _pulled(graph)


def _deinterlacer(frame):
    import av

    graph = av.filter.Graph()
    source = graph.add_buffer(width=frame.width, height=frame.height, format=frame.format, time_base=frame.time_base)
    graph.link_nodes(source, graph.add("bwdif", "mode=send_frame:deint=interlaced"), graph.add("buffersink"))
    graph.configure()
    return graph


def _pulled(graph) -> Iterator:
    import av

    while True:
        try:
            yield graph.pull()
        except (av.BlockingIOError, av.EOFError):  # it waits for the next frame, or all are out
            return


def _rgb(frame, stream) -> np.ndarray:
    """`(H, W, 3)` uint8 sRGB of a decoded frame."""
    from av.video.reformatter import Colorspace

    transfer = HDR.get(stream.codec_context.color_trc)
    if transfer is not None:
        matrix = Colorspace.BT2020 if frame.colorspace == UNTAGGED else None
        return to_srgb(frame.reformat(format="rgb48le", src_colorspace=matrix).to_ndarray(), transfer)
    if (
        frame.colorspace == UNTAGGED
        and not frame.format.is_rgb
        and (frame.width >= HD_WIDTH or frame.height > SD_HEIGHT)
    ):
        frame = frame.reformat(format="rgb24", src_colorspace=Colorspace.ITU709)
    return frame.to_ndarray(format="rgb24")


def _squared(pixels: np.ndarray, aspect: Fraction | None) -> np.ndarray:
    """The picture with square pixels: as high as it was, `aspect` (width of a pixel to its height) times as wide."""
    import cv2

    height, width = pixels.shape[:2]
    if not aspect or abs(aspect - 1) < SQUARE:
        return pixels
    wide = max(2, 2 * round(width * aspect / 2))  # even, as video codecs want it
    return cv2.resize(pixels, (wide, height), interpolation=cv2.INTER_AREA if wide < width else cv2.INTER_CUBIC)


def _opened(file: Path):
    import av

    if file.suffix.lower() == ".f4x":
        raise F4xError(
            f"{file} is a fitted scene, and a clip is wanted: give the video or folder that it was fitted to"
        )
    try:
        container = av.open(str(file))
    except (av.FFmpegError, OSError) as error:
        raise F4xError(f"{file} cannot be read as a video ({error.strerror}); give a video or a folder") from error
    if _film(container) is None:
        kinds = sorted({"a cover" if stream.type == "video" else stream.type for stream in container.streams})
        container.close()
        raise F4xError(f"{file} holds no video, only {' and '.join(kinds)}; give a video file")
    return container


def _film(container):
    """The first stream of moving pictures, None without one: the cover of a song is a stream of one picture."""
    from av.stream import Disposition

    return next((each for each in container.streams.video if not each.disposition & Disposition.attached_pic), None)


def write_video(
    file: str | Path, frames: Iterable[np.ndarray], fps: float, times: Iterable[float] | None = None
) -> None:
    """Write H.264 in yuv420p (BT.709), playable everywhere: `frames` (H, W, 3), or (H, W) grey, uint8 or float in [0, 1].

    An odd last row or column is doubled, as the format wants even sizes. `frames` may be a generator; nothing is left
    at `file` when it fails. `times`: when each is shown, in units of 1 / fps from that of the first; 0, 1, 2, ... when None.
    Raises F4xError for no frames or frames of several sizes.
    """
    import av

    file = Path(file)
    with replace_file(file) as target, av.open(target, "w", format="mp4") as container:
        stream, rate = None, Fraction(fps).limit_denominator(1001)
        ticks = count() if times is None else (round(GRID * time) for time in times)
        for frame, tick in zip(frames, ticks, strict=False):
            pixels = as_bytes(frame)
            pixels = np.repeat(pixels[..., None], 3, 2) if pixels.ndim == 2 else pixels
            height, width = pixels.shape[:2]
            if stream is None:
                first = pixels.shape
                stream = container.add_stream("libx264", rate=rate)
                if times is not None:
                    stream.codec_context.time_base, begin = 1 / (rate * GRID), tick
                stream.width, stream.height, stream.pix_fmt = width + width % 2, height + height % 2, "yuv420p"
                stream.options = {"crf": QUALITY}
                stream.codec_context.colorspace = stream.codec_context.color_primaries = 1  # ITU-R BT.709
                stream.codec_context.color_trc = stream.codec_context.color_range = 1
            if pixels.shape != first:
                raise F4xError(f"{file}: frames of sizes {first} and {pixels.shape}; a video needs one size")
            padded = np.pad(pixels, ((0, height % 2), (0, width % 2), (0, 0)), mode="edge")
            picture = av.VideoFrame.from_ndarray(padded, format="rgb24")
            picture = picture.reformat(format="yuv420p", dst_colorspace="ITU709")
            if times is not None:
                picture.pts, picture.time_base = tick - begin, stream.codec_context.time_base
            container.mux(stream.encode(picture))
        if stream is None:
            raise F4xError(f"{file}: no frames to write; render at least one")
        container.mux(stream.encode())
