"""Reads a video as arrays: frames and times, and the cameras, masks and depth that its folder comes with."""

from .images import write_images
from .model import Clip
from .read import read_clip, usual_width
from .video import write_video

__all__ = ["Clip", "read_clip", "usual_width", "write_images", "write_video"]
