"""Checks of what a machine can do, before any work."""

from __future__ import annotations

from ..errors import F4xError


def require_backend(name: str) -> None:
    """Raise F4xError when the raster backend `name` cannot run here."""
    from ..raster import why_not

    reason = why_not(name)
    if reason is not None:
        raise F4xError(f"--backend {name} cannot run here ({reason}); use --backend auto or torch.")
