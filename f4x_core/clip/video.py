"""Video files through PyAV."""

from collections.abc import Iterable, Iterator
from fractions import Fraction
from pathlib import Path

import numpy as np

from ..errors import F4xError
from ..files import replace_file
from .images import as_bytes

QUALITY = "16"  # x264 CRF: no visible loss; the file is for people, measurements use the arrays


def describe(file: Path) -> tuple[float, int]:
    """Return (average frames per second, number of frames) as the file claims, 0 where it does not tell."""
    with _opened(file) as container:
        stream = container.streams.video[0]
        return float(stream.average_rate or 0), stream.frames


def decode(file: Path) -> Iterator[np.ndarray]:
    """Yield the frames `(H, W, 3)` uint8 in order of presentation, upright as a phone's rotation tag says."""
    import av

    with _opened(file) as container:
        container.streams.video[0].thread_type = "AUTO"
        try:
            for frame in container.decode(video=0):
                yield np.ascontiguousarray(np.rot90(frame.to_ndarray(format="rgb24"), round(frame.rotation / 90)))
        except av.FFmpegError as error:
            raise F4xError(f"{file} is damaged ({error.strerror}); re-encode it or cut it before the damage") from error


def _opened(file: Path):
    import av

    try:
        container = av.open(str(file))
    except (av.FFmpegError, OSError) as error:
        raise F4xError(f"{file} cannot be read as a video ({error.strerror}); give a video or a folder") from error
    if not container.streams.video:
        container.close()
        raise F4xError(f"{file} holds no video, only {len(container.streams)} other stream(s); give a video file")
    return container


def write_video(file: str | Path, frames: Iterable[np.ndarray], fps: float) -> None:
    """Write H.264 in yuv420p (BT.709), playable everywhere: `frames` (H, W, 3), or (H, W) grey, uint8 or float in [0, 1].

    An odd last row or column is doubled, as the format wants even sizes. `frames` may be a generator; nothing is left
    at `file` when it fails. Raises F4xError for no frames or frames of several sizes.
    """
    import av

    file = Path(file)
    with replace_file(file) as target, av.open(target, "w", format="mp4") as container:
        stream = None
        for frame in frames:
            pixels = as_bytes(frame)
            pixels = np.repeat(pixels[..., None], 3, 2) if pixels.ndim == 2 else pixels
            height, width = pixels.shape[:2]
            if stream is None:
                first = pixels.shape
                stream = container.add_stream("libx264", rate=Fraction(fps).limit_denominator(1001))
                stream.width, stream.height, stream.pix_fmt = width + width % 2, height + height % 2, "yuv420p"
                stream.options = {"crf": QUALITY}
                stream.codec_context.colorspace = stream.codec_context.color_primaries = 1  # ITU-R BT.709
                stream.codec_context.color_trc = stream.codec_context.color_range = 1
            if pixels.shape != first:
                raise F4xError(f"{file}: frames of sizes {first} and {pixels.shape}; a video needs one size")
            padded = np.pad(pixels, ((0, height % 2), (0, width % 2), (0, 0)), mode="edge")
            picture = av.VideoFrame.from_ndarray(padded, format="rgb24")
            container.mux(stream.encode(picture.reformat(format="yuv420p", dst_colorspace="ITU709")))
        if stream is None:
            raise F4xError(f"{file}: no frames to write; render at least one")
        container.mux(stream.encode())
