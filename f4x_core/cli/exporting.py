"""`f4x export`."""

from __future__ import annotations

import argparse
from typing import Any

from ..app.exporting import ExportOptions, export_file
from ..language.lexicon import plural
from ..progress import Progress


def run_export(args: argparse.Namespace, progress: Progress) -> dict[str, Any]:
    """Write a scene, or splats of another program, at one time or at many in one of `FORMATS`."""
    options = ExportOptions(args.format, args.time, args.frames)
    done = export_file(args.scene, args.output, options, args.edits, progress)
    count = len(done.files)
    alone = done.files == (args.output,)
    text = str(args.output) if alone else f"{args.output}: {count} {plural('file', count)}"
    return {
        "output": str(args.output),
        "format": done.format,
        "frames": done.moments,
        "files": count,
        "notes": [*done.notes],
        "text": "; ".join([text, *done.notes]),
    }
