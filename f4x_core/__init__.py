"""Feature4X core: from one monocular video to an editable 4D scene of Gaussians. Nothing here imports bpy.

The names in `__all__` are the door for programs. Each is loaded from its room at its first use, so `import f4x_core` stays
light and needs no wheel. `query` and `edit` are packages in here, which Python binds to these names as soon as anything
imports them; the functions over them are therefore called `select`, `ask` and `edit_scene`.
"""

from importlib import import_module
from typing import TYPE_CHECKING

from . import versions

__version__ = versions.VERSION

__all__ = [
    "Camera",
    "ClipOptions",
    "ExportOptions",
    "FitConfig",
    "FitOptions",
    "RenderOptions",
    "Scene",
    "Splats",
    "ask",
    "edit_scene",
    "export_file",
    "fit_clip",
    "make_scene",
    "profile",
    "rasterize",
    "read_clip",
    "read_scene",
    "render",
    "render_path",
    "select",
    "updating",
    "write_scene",
]

if TYPE_CHECKING:
    from .api import ask, edit_scene, render, select
    from .app.exporting import ExportOptions, export_file
    from .app.fit_options import ClipOptions, FitOptions
    from .app.fitting import make_scene
    from .app.render_options import RenderOptions
    from .app.rendering import render_path
    from .clip import read_clip
    from .fit.config import FitConfig, profile
    from .fit.pipeline import fit_clip
    from .geometry.camera import Camera
    from .geometry.splats import Splats
    from .raster import rasterize
    from .scene import Scene, read_scene, updating, write_scene
else:  # hidden from type checkers, for which it would make every name an attribute
    _MODULES = {
        **dict.fromkeys(("ask", "edit_scene", "render", "select"), ".api"),
        "read_clip": ".clip",
        **dict.fromkeys(("ExportOptions", "export_file"), ".app.exporting"),
        **dict.fromkeys(("ClipOptions", "FitOptions"), ".app.fit_options"),
        "make_scene": ".app.fitting",
        "RenderOptions": ".app.render_options",
        "render_path": ".app.rendering",
        **dict.fromkeys(("FitConfig", "profile"), ".fit.config"),
        "fit_clip": ".fit.pipeline",
        "Camera": ".geometry.camera",
        "Splats": ".geometry.splats",
        "rasterize": ".raster",
        **dict.fromkeys(("Scene", "read_scene", "updating", "write_scene"), ".scene"),
    }

    def __getattr__(name: str) -> object:
        """Load a name of `__all__` from its room."""
        if name not in _MODULES:
            raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
        return getattr(import_module(_MODULES[name], __name__), name)

    def __dir__() -> list[str]:
        """Return the names loaded so far and names that load on first use."""
        return sorted({*globals(), *__all__})
