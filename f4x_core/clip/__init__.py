"""One video as arrays: its frames, times, and what its folder knows of cameras, masks and depth."""

from .images import write_images
from .model import Clip
from .read import read_clip
from .video import write_video

__all__ = ["Clip", "read_clip", "write_images", "write_video"]
