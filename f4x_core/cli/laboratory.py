"""`f4x bench` and `f4x report`, which run the package `benchmarks`; only a checkout of the repository contains it."""

from __future__ import annotations

import argparse
import sys
from importlib import import_module
from pathlib import Path
from typing import Any

from ..errors import F4xError
from ..progress import Progress

CHECKOUT = Path(__file__).resolve().parents[2]
"""Folder of `f4x_core`; in a checkout the package `benchmarks` lies there too."""


def run_bench(args: argparse.Namespace, progress: Progress) -> dict[str, Any]:
    """Measure one part of the program."""
    return _laboratory("bench").run_bench(args, progress)


def run_report(args: argparse.Namespace, progress: Progress) -> dict[str, Any]:
    """Measure the chosen studies and write the page."""
    return _laboratory("report").run_report(args, progress)


def _laboratory(verb: str) -> Any:
    """Import the module `benchmarks.VERB` of this checkout.

    Raises:
        F4xError: this is an installation, which has no laboratory.
    """
    if not (CHECKOUT / "benchmarks" / f"{verb}.py").is_file():
        raise F4xError(
            f"an installation has no benchmarks; get the repository of Feature4X for Blender and call `f4x {verb}` from its"
            " checkout (python3 scripts/dev.py setup makes its environment)."
        )
    if str(CHECKOUT) not in sys.path:
        sys.path.insert(0, str(CHECKOUT))
    return import_module(f"benchmarks.{verb}")
