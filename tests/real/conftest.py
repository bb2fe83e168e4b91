"""Where the real Blender is."""

import os
from pathlib import Path

import pytest


@pytest.fixture(scope="session")
def blender_root() -> Path:
    """A system with Blender, Xvfb and xdotool to chroot into; `python3 scripts/dev.py blender` makes and names one."""
    root = Path(os.environ.get("F4X_BLENDER_ROOT", "/nowhere"))
    if not (root / "usr/bin/blender").exists():
        pytest.skip("F4X_BLENDER_ROOT names no system with Blender; python3 scripts/dev.py blender makes one")
    if not hasattr(os, "geteuid") or os.geteuid() != 0:
        pytest.skip("only root may chroot")
    return root
