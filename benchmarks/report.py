"""`f4x report`."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

from f4x_core.errors import F4xError
from f4x_core.progress import Progress

PAGE_FILE = "index.html"


def run_report(args: argparse.Namespace, progress: Progress) -> dict[str, Any]:
    """Measure the chosen studies and write the page."""
    import torch

    from .catalogue import choose
    from .report_page import write_page
    from .runner import run_studies
    from .study import Context

    studies = choose(args.only.split(",") if args.only is not None else None)
    if args.threads < 1:
        raise F4xError(f"--threads {args.threads}: wants 1 or more.")
    for source in (args.clips, args.data, args.cases):
        if source is not None and not source.is_dir():
            raise F4xError(
                f"{source}: there is no such folder; name the one that holds the clips, data sets or hard cases."
            )
    torch.set_num_threads(args.threads)
    folder: Path = args.output.resolve()  # verbs in children run in folders of their own
    folder.mkdir(parents=True, exist_ok=True)
    context = Context(folder, args.quick, args.clips, args.data, args.cases, args.threads, args.seed)
    report = run_studies(studies, folder, context, progress)
    write_page(folder / PAGE_FILE, report)
    failed = [f"{name}: {text}" for name, record in report["studies"].items() for text in record["failed"]]
    lines = [f"{record['title']}: {text}" for record in report["studies"].values() for text in record["words"]]
    lines += [
        f"{study.title}: not measured: {text}" for study in studies for text in report["studies"][study.name]["skipped"]
    ]
    lines += [f"FAILED {text}" for text in failed] + [f"{folder / PAGE_FILE}"]
    text = "\n".join(lines)
    return {"page": str(folder / PAGE_FILE), "failed": failed, **report, "text": text, "exit_code": int(bool(failed))}
