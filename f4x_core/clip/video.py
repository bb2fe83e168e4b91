"""Video files through PyAV."""

from collections import Counter, deque
from collections.abc import Iterable, Iterator
from fractions import Fraction
from itertools import count, islice
from pathlib import Path

import numpy as np

from ..errors import F4xError
from ..files import replace_file
from ..reading import require_animation
from .clock import DEFAULT_FPS, GRID, Shown
from .hdr import Transfer, to_srgb
from .images import alike, as_bytes, resize_nearest, scaled
from .notes import Note
from .pixels import SEEN
from .repeats import without_repeats
from .undamaged import MARKING, TRACED, Numbered, UndamagedFrames

QUALITY = "16"  # x264 CRF: no visible loss; the file is for people, measurements use the arrays
UNTAGGED = 2  # colour properties that a file does not tell, ITU-T H.273
BT601, YCGCO = 5, 8  # matrix coefficients, ITU-T H.273
FULL_RANGE = 2
UNREADABLE = {
    10: "BT.2020 with constant luminance",
    11: "SMPTE ST 2085",
    12: "a matrix of its own primaries",
    13: "a matrix of its own primaries with constant luminance",
    14: "ICtCp",
}  # matrix coefficients
ALPHA_DECODERS = {"vp8": "libvpx", "vp9": "libvpx-vp9"}  # FFmpeg's own leave the alpha of WebM out
TELL_BY_ERROR = {"mjpeg", "mjpegb"}  # decoders that do not mark damaged frames
PATTERNS = {".gif": "gif", ".png": "apng"}  # in names of these FFmpeg takes %03d for a counter of pictures
NO_FILMS = {"tty", "bin", "adf", "idf", "xbin"}  # demuxers that draw text
LISTS = {"concat", "hls", "dash", "sdp", "rtsp", "ffmetadata"}  # demuxers of texts that name other files
FULL = 0.9  # of the frames of the longest stream another one of the same film has
COUNTED = 600  # packets that tell which stream is the film
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


def decode(file: Path, notes: list[Note] | None = None) -> Iterator[Shown]:
    """Yield the frames in order of presentation: sRGB, turned and flipped as the display matrix says, square pixels, one size.

    Whole frames, deinterlaced where they are made of fields. What is damaged or built on what is, and what repeats the frame
    before, is left out and told in `notes`; what an edit list hides is left out. Raises F4xError for a film that breaks off or
    has no frame to show.
    """
    notes = [] if notes is None else notes
    frames = _webp_frames(file) if _is_webp(file) else _decoded(file, notes)
    return without_repeats(_of_one_size(frames, file, notes), notes)


def _decoded(file: Path, notes: list[Note]) -> Iterator[Shown]:
    import av

    whole = 0
    with _opened(file) as container:
        stream = _film(container)
        several = len(_candidates(container))
        if several > 1:
            place = f"stream {stream.index}, {stream.width}x{stream.height}"
            notes.append(
                Note("source", 0, text=f"The file holds {several} films; the one with most frames is read ({place}).")
            )
        frames = UndamagedFrames(container, stream, _decoder(stream), notes)
        interval = 1 / float(stream.average_rate or DEFAULT_FPS)
        try:
            for frame, number in _whole_frames(frames):
                pixels, alpha = _upright(frame, stream)
                seconds, tick = frame.time, float(stream.time_base)
                if seconds is None:
                    seconds, tick = number * interval, 0.0
                yield Shown(pixels, seconds, tick, number, alpha)
                whole += 1
        except av.FFmpegError as error:
            advice = (
                f"give --frames 0:{whole} for what comes before" if whole else "copy it again from where it was made"
            )
            raise F4xError(f"{file} is damaged after {whole} frames ({error.strerror}); {advice}") from error
        if whole and _breaks_off(container, stream, frames.end):
            raise F4xError(
                f"{file} breaks off after {whole} frames; copy it again, or give --frames 0:{whole} for those"
            )
    if whole == 0:
        why = f" ({frames.error})" if frames.error else ""
        raise F4xError(f"{file} has no frame that can be shown whole{why}; export it again from where it was made")


def _is_webp(file: Path) -> bool:
    with file.open("rb") as content:
        head = content.read(12)
    return head[:4] == b"RIFF" and head[8:] == b"WEBP"


def _webp_frames(file: Path) -> Iterator[Shown]:
    """Yield the frames of a WebP animation, which FFmpeg does not decode."""
    from PIL import Image, ImageSequence

    start = 0.0
    try:
        with Image.open(file) as image:
            require_animation(image.width, image.height, getattr(image, "n_frames", 1), file.stat().st_size)
            for number, frame in enumerate(ImageSequence.Iterator(image)):
                pixels = np.asarray(frame.convert("RGBA"))
                yield Shown(np.ascontiguousarray(pixels[..., :3]), start, 0.001, number, _alpha(pixels[..., 3]))
                start += frame.info.get("duration", 0) / 1000
    except (OSError, ValueError, SyntaxError, EOFError) as error:
        raise F4xError(f"{file} cannot be read as a WebP animation ({error}); export it again") from error


def _of_one_size(frames: Iterable[Shown], file: Path, notes: list[Note]) -> Iterator[Shown]:
    """Yield the frames, scaled to the size of the first where theirs differs; F4xError where the shape of the picture changes."""
    size: tuple[int, int] | None = None
    for index, shown in enumerate(frames):
        height, width = shown.pixels.shape[:2]
        size = size or (width, height)
        if (width, height) != size:
            if not alike(width, height, *size):
                raise F4xError(
                    f"{file}: from frame {index} on the picture is {width}x{height}, before it is {size[0]}x{size[1]}; give one"
                    f" part of it, for example --frames 0:{index}."
                )
            notes.append(Note("resized", shown.number, shown.seconds, f"{width}x{height}"))
            alpha = None if shown.alpha is None else resize_nearest(shown.alpha, *size)
            shown = shown._replace(pixels=scaled(shown.pixels, *size), alpha=alpha)
        yield shown


def glimpses(file: Path, count: int) -> Iterator[np.ndarray]:
    """Yield up to `count` frames (H,W,3) from all over the film, as `decode` shows them but for fields and time; they jump."""
    import av

    if _is_webp(file):
        yield from (shown.pixels for shown in _webp_frames(file))
        return
    with _opened(file) as container:
        stream = _film(container)
        begin, length = stream.start_time or 0, stream.duration or 0
        decoder, size = _decoder(stream), None
        try:
            for part in range(count):
                if length:
                    container.seek(begin + length * part // count, stream=stream)
                    decoder.flush_buffers()
                frame = next((each for each in _each_frame(container, stream, decoder) if not each.is_corrupt), None)
                if frame is None:
                    return
                pixels = _upright(frame, stream)[0]
                size = size or pixels.shape
                if pixels.shape == size:
                    yield pixels
        except av.FFmpegError:  # what can be seen is enough; `decode` says what is wrong
            return


def _each_frame(container, stream, decoder) -> Iterator:
    for packet in container.demux(stream):
        yield from decoder.decode(packet)


def _upright(frame, stream) -> tuple[np.ndarray, np.ndarray | None]:
    """Return the colours (H,W,3) and alpha (H,W) or None of a decoded frame as it is to be shown."""
    aspect, file = stream.sample_aspect_ratio, stream.container.name

    def shown(pixels: np.ndarray) -> np.ndarray:
        return np.ascontiguousarray(_displayed(_squared(pixels, aspect), frame, file))

    alpha = None
    if any(component.is_alpha for component in frame.format.components):
        alpha = _alpha(frame.to_ndarray(format="rgba")[..., 3])
    return shown(_rgb(frame, stream)), None if alpha is None else shown(alpha)


def _alpha(alpha: np.ndarray) -> np.ndarray | None:
    """Return the alpha (H,W) uint8, None where it hides nothing."""
    return None if (alpha >= SEEN).all() else np.ascontiguousarray(alpha)


def _displayed(pixels: np.ndarray, frame, file: str) -> np.ndarray:
    """Return `pixels` (H,W,3) turned by right angles and flipped by the film's display matrix; F4xError for other matrices."""
    from av.sidedata.sidedata import Type

    try:
        data = frame.side_data.get(Type.DISPLAYMATRIX)
    except ValueError:  # PyAV does not know all kinds of side data, such as EXIF
        data = None
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
    """Return True for a film whose last packet ends at `end` (seconds), before the end that MP4 and MOV announce."""
    if "mp4" not in container.format.name or not stream.duration or not stream.average_rate:
        return False
    return end + 1.5 / stream.average_rate < ((stream.start_time or 0) + stream.duration) * stream.time_base


def _whole_frames(frames: Iterable[Numbered]) -> Iterator[Numbered]:
    """Yield the frames with two fields woven into one picture each, by FFmpeg's filter `bwdif`; progressive ones as they are."""
    graph, size, numbers = None, None, deque[int]()
    for frame, number in frames:
        if graph is not None and (frame.width, frame.height) != size:
            graph.push(None)
            yield from _pulled(graph, numbers)
            graph = None
        if graph is None and frame.interlaced_frame:
            graph, size = _deinterlacer(frame), (frame.width, frame.height)
        if graph is None:
            yield Numbered(frame, number)
        else:
            numbers.append(number)
            graph.push(frame)
            yield from _pulled(graph, numbers)
    if graph is not None:
        graph.push(None)
        yield from _pulled(graph, numbers)


def _deinterlacer(frame):
    import av

    graph = av.filter.Graph()
    source = graph.add_buffer(width=frame.width, height=frame.height, format=frame.format, time_base=frame.time_base)
    graph.link_nodes(source, graph.add("bwdif", "mode=send_frame:deint=interlaced"), graph.add("buffersink"))
    graph.configure()
    return graph


def _pulled(graph, numbers: deque[int]) -> Iterator[Numbered]:
    import av

    while True:
        try:
            yield Numbered(graph.pull(), numbers.popleft())
        except (av.BlockingIOError, av.EOFError):  # it waits for the next frame, or all are out
            return


def _rgb(frame, stream) -> np.ndarray:
    """Return `(H, W, 3)` uint8 sRGB of a decoded frame."""
    from av.video.reformatter import Colorspace

    transfer = HDR.get(stream.codec_context.color_trc)
    if transfer is not None:
        matrix = Colorspace.BT2020 if frame.colorspace == UNTAGGED else None
        return to_srgb(frame.reformat(format="rgb48le", src_colorspace=matrix).to_ndarray(), transfer)
    if frame.colorspace == YCGCO and not frame.format.is_rgb:
        return _from_ycgco(frame)
    if frame.colorspace in UNREADABLE and not frame.format.is_rgb:
        raise F4xError(
            f"{stream.container.name} has its colours in {UNREADABLE[frame.colorspace]}, which is not read here; convert it to"
            " BT.709"
        )
    if (
        frame.colorspace == UNTAGGED
        and not frame.format.is_rgb
        and (frame.width >= HD_WIDTH or frame.height > SD_HEIGHT)
    ):
        frame = frame.reformat(format="rgb24", src_colorspace=Colorspace.ITU709)
    return frame.to_ndarray(format="rgb24")


def _from_ycgco(frame) -> np.ndarray:
    """Return `(H, W, 3)` uint8 of a frame in Y, Cg and Co, ITU-T H.273; FFmpeg converts no such colours."""
    frame.colorspace, full = (
        BT601,
        frame.color_range == FULL_RANGE,
    )  # the reformatter then leaves the planes as they are
    y, cg, co = frame.reformat(format="yuv444p").to_ndarray().astype(np.float32)
    y, cg, co = (y, cg - 128, co - 128) if full else ((y - 16) * 255 / 219, *((c - 128) * 255 / 224 for c in (cg, co)))
    rgb = np.stack([y - cg + co, y + cg, y - cg - co], -1)
    return np.round(np.clip(rgb, 0, 255)).astype(np.uint8)


def _squared(pixels: np.ndarray, aspect: Fraction | None) -> np.ndarray:
    """Return the picture with square pixels: as high as it was, `aspect` (width of a pixel to its height) times as wide."""
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
        # An absolute path, for FFmpeg takes what comes before a colon for a protocol.
        pattern = PATTERNS.get(file.suffix.lower()) if "%" in file.name else None
        container = av.open(str(file.absolute()), format=pattern, metadata_errors="replace")
    except (av.FFmpegError, OSError) as error:
        raise F4xError(f"{file} cannot be read as a video ({error.strerror}); give a video or a folder") from error
    if container.format.name in NO_FILMS | LISTS:
        kind = "list of files" if container.format.name in LISTS else "text"
        container.close()
        raise F4xError(f"{file} is a {kind} and no film; give a video or a folder")
    if not _candidates(container):
        kinds = sorted({_kind(stream) for stream in container.streams}) or ["nothing"]
        container.close()
        raise F4xError(f"{file} holds no video, only {' and '.join(kinds)}; give a video file")
    return container


def _candidates(container) -> list:
    """Return the streams of moving pictures that can be decoded."""
    return [each for each in container.streams.video if _kind(each) == "video"]


def _kind(stream) -> str:
    """Return the kind of a stream: the cover of a song is one of a single picture, and some are made by encoders not known here."""
    from av.stream import Disposition

    if stream.type == "video" and stream.codec_context is None:
        return "video of an unknown encoder"
    return "a cover" if stream.type == "video" and stream.disposition & Disposition.attached_pic else stream.type


def _film(container):
    """Return the video stream with the most frames; of those with nearly as many the largest, of these the first."""
    films = _candidates(container)
    if len(films) < 2:
        return films[0]
    frames = Counter({each.index: each.frames for each in films})
    if min(frames.values()) == 0:  # not all are told
        frames = Counter(packet.stream_index for packet in islice(container.demux(films), COUNTED) if packet.size)
        container.seek(0)
    most = max(frames.values(), default=0)
    full = [each for each in films if frames[each.index] >= FULL * most]
    return max(full, key=lambda each: each.width * each.height)


def _decoder(stream):
    """Return the decoder of a stream; its frames carry the marks of their packets."""
    from av import Codec, CodecContext, codecs_available
    from av.codec.context import Flags

    decoder, alpha = stream.codec_context, ALPHA_DECODERS.get(stream.codec_context.name)
    if alpha in codecs_available and stream.metadata.get("alpha_mode") == "1":
        decoder = CodecContext.create(Codec(alpha, "r"))
    # In threads a picture is handed out before another one, which it is built on, is marked.
    decoder.thread_type = "NONE" if decoder.name in MARKING else "AUTO"
    decoder.flags |= Flags.copy_opaque
    if decoder.name in TELL_BY_ERROR:
        decoder.options = {"err_detect": "explode"}
    if decoder.name in TRACED:
        decoder.options = {"debug": TRACED[decoder.name]}
    return decoder


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
