"""`f4x info`."""

from __future__ import annotations

import argparse
import json
from typing import Any

from ..progress import Progress
from ..scene import read_scene


def run_info(args: argparse.Namespace, progress: Progress) -> dict[str, Any]:
    """Counts, sizes and provenance of a scene file."""
    info = read_scene(args.scene).info()
    return {**info, "text": json.dumps(info, indent=2, default=str)}
