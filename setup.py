"""Compiles the native library into the wheel; without a compiler the wheel has none and the torch backend serves.

F4X_WHEEL_TARGET names a platform of `WHEEL_TAGS` to make the wheel for; without it, it is this machine's own.
"""

import os
import subprocess
import sys
from pathlib import Path

from setuptools import setup
from setuptools.command.bdist_wheel import bdist_wheel
from setuptools.command.build_py import build_py

ROOT = Path(__file__).parent
BUILT = ROOT / "f4x_core" / "native" / "_build"
WHEEL_TAGS = {
    "linux-x86_64": "manylinux_2_28_x86_64",
    "linux-arm64": "manylinux_2_28_aarch64",
    "windows-x86_64": "win_amd64",
    "macos-arm64": "macosx_11_0_arm64",
    "macos-x86_64": "macosx_11_0_x86_64",
}
"""Platforms of `f4x_core.native.build`, as wheels call them; the systems are the oldest that the library is linked for."""
TARGET = os.environ.get("F4X_WHEEL_TARGET")


class BuildWithLibrary(build_py):
    """The packages, and the library for the wheel's platform beside its sources."""

    def run(self) -> None:
        """Compile first, so that package data finds the library."""
        if not self.editable_mode:
            target = ["--target", TARGET] if TARGET else []
            command = [sys.executable, "-m", "f4x_core.native.build", *target]
            done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True)
            if TARGET and done.returncode:
                sys.exit(done.stderr)
            self.announce((done.stdout or done.stderr).strip(), level=2)
        super().run()
        if not self.editable_mode:  # a used checkout also holds libraries of other sources and platforms
            for library in (Path(self.build_lib) / BUILT.relative_to(ROOT)).glob("*"):
                if library.name != Path(done.stdout.strip()).name:
                    library.unlink()


class PlatformWheel(bdist_wheel):
    """One wheel per platform for every Python: the library knows no Python ABI."""

    def finalize_options(self) -> None:
        """A library makes the wheel a platform's own."""
        super().finalize_options()
        self.root_is_pure = False

    def get_tag(self) -> tuple[str, str, str]:
        """Any Python 3, no ABI, one platform."""
        return "py3", "none", WHEEL_TAGS[TARGET] if TARGET else super().get_tag()[2]


setup(cmdclass={"build_py": BuildWithLibrary, "bdist_wheel": PlatformWheel})
