"""Shows a picture of the clip beside a scene, for pages that show what was fitted."""

from pathlib import Path

from ..clip import Clip
from ..files import replace_file

INPUT = "input.jpg"
"""The file that `f4x priors` writes, and `f4x fit` if it fits windows."""


def write_input(clip: Clip, folder: Path) -> None:
    """Write the middle one of the clip's pictures into `folder`."""
    from PIL import Image  # who only asks for the name of the file does not load it

    with replace_file(folder / INPUT) as file:
        Image.fromarray(clip.frames[len(clip) // 2]).save(file, "JPEG")
