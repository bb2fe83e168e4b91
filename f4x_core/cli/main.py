"""The command line: parses, calls one verb, prints one clear sentence when something is wrong."""

from __future__ import annotations

import argparse
import contextlib
import os
import sys
from collections.abc import Callable
from typing import Any

from ..app.checks import require_backend
from ..errors import Cancelled, F4xError
from ..files import json_text
from ..printing import OUTPUT, one_line, open_streams, print_error, print_text
from ..processes import EXIT_INTERRUPTED, START, LineProgress, stop_with_parent
from ..troubles import EXPECTED, with_code
from ..versions import VERSION
from .checks import output_folder, require_folder, require_given, why_slow
from .terminal import TerminalProgress

EXIT_BAD_INPUT = 2
EXIT_UNREAD = 141
"""Exit code where the reader of standard output has gone, as `head -1` does: that of a program that SIGPIPE ends."""
IDLE_THREADS = ("OMP_WAIT_POLICY", "PASSIVE")
"""Variable and value that let torch's idle threads sleep. By default they spin and take the cores from each other
and from Blender: beside three busy programs `f4x eval` then takes 35 s in place of 21 on two cores; alone it is the same."""
AGAIN = {
    **dict.fromkeys(("fit", "refit"), "; the same command with --resume continues"),
    "batch": "; the same command continues",
}
"""Message after Ctrl-C, by verb, where there is something to continue."""
SAVED = ("priors/*", "checkpoints/*", "**/windows/*/*")
"""Patterns of what a stopped fit leaves in its folder and goes on from."""


def find_verb(name: str) -> Callable[[argparse.Namespace, TerminalProgress], dict[str, Any]]:
    """Return the function behind a verb; imports only what that verb needs."""
    from importlib import import_module

    modules = {"eval": "measuring", "render": "rendering", "export": "exporting"}
    modules |= dict.fromkeys(("fit", "window", "priors"), "fitting")
    modules |= {"open": "opening", "mesh": "meshing", "query": "querying", "name": "querying", "ask": "asking"}
    modules |= {"edit": "editing", "undo": "history", "redo": "history", "bake": "history"}
    modules |= {"models": "features", "distill": "distilling", "refit": "refitting"}
    modules |= {"bench": "laboratory", "report": "laboratory"}
    module = import_module(f".{modules.get(name, name)}", __package__)
    return getattr(module, f"run_{name}")


def main(arguments: list[str] | None = None) -> int:
    """Run one command; returns the exit code."""
    arguments = sys.argv[1:] if arguments is None else arguments
    open_streams()
    os.environ.setdefault(*IDLE_THREADS)  # read when torch is imported
    args = argparse.Namespace(verb=(*arguments, "")[0], json="--json" in arguments)  # until it is parsed
    lines = LineProgress(sys.stdout) if "--progress-json" in arguments else None
    try:
        if lines is not None:
            stop_with_parent()
            lines(START, 0, 0, f"f4x {VERSION}")
        args = _parsed(arguments)
        if args.verb == "fit" and not args.show_config:
            require_given(args, clip="clip", output="-o/--output")
        quiet = lines is not None or (args.json and not sys.stderr.isatty())
        with TerminalProgress(quiet, lines) as progress:
            if getattr(args, "output", None) is not None:
                require_folder(output_folder(args))
            if "backend" in args:
                require_backend(args.backend)
                if args.backend == "auto" and (slow := why_slow()):
                    progress.console.print(slow)
            result = find_verb(args.verb)(args, progress)
        return _report(args, lines, result)
    except EXPECTED as error:
        if isinstance(error, BrokenPipeError) and error.filename == OUTPUT:
            return EXIT_UNREAD
        sentence = with_code(error, getattr(args, "output", None) or "the output folder")
        return _fail(args, lines, sentence, EXIT_BAD_INPUT, getattr(error, "instead", ""))
    except (KeyboardInterrupt, Cancelled):
        return _fail(args, lines, f"Stopped{_again(args)}.", EXIT_INTERRUPTED)


def _parsed(arguments: list[str]) -> argparse.Namespace:
    """Parse the command line. Raises F4xError, which tells how to write the name of a file that looks like an option."""
    from .parser import build_parser  # loads numpy: here an early Ctrl-C is answered already

    try:
        return build_parser().parse_args(arguments)
    except F4xError as error:
        dashed = [name for name in arguments if name.startswith("-") and os.path.isfile(name)]
        if not dashed:
            raise
        raise F4xError(
            f"{error} The file {dashed[0]} is written ./{dashed[0]}, as its name begins with a dash."
        ) from error


def _report(args: argparse.Namespace, lines: LineProgress | None, result: dict[str, Any]) -> int:
    """Print the result of a verb; returns its exit code. F4xError where there is no room for it."""
    code, text = result.pop("exit_code", 0), result.pop("text", None)
    try:
        if lines is not None:
            lines.tell(result=result, text=text or "")
        elif args.json:
            print_text(json_text(result))
        elif text:
            for name in filter(lambda name: "\n" in name, map(str, vars(args).values())):
                text = text.replace(name, one_line(name))  # a name stays within its line
            print_text(text)
    except BrokenPipeError:
        raise
    except OSError as error:
        raise F4xError(
            f"{OUTPUT}: {error.strerror}; the command is done, but its result could not be printed"
        ) from error
    return code


def _again(args: argparse.Namespace) -> str:
    """Return the sentence that tells how to continue a stopped command; empty where it left nothing to continue from."""
    folder = getattr(args, "output", None)  # None: it was stopped while its arguments were read
    if args.verb == "fit" and (folder is None or not any(any(folder.glob(pattern)) for pattern in SAVED)):
        return ""
    return AGAIN.get(args.verb, "")


def _fail(args: argparse.Namespace, lines: LineProgress | None, sentence: str, code: int, instead: str = "") -> int:
    """Report why a command ended, and what was probably meant where it asks; returns the exit code."""
    failure = {"error": sentence} | ({"instead": instead} if instead else {})
    print_error(f"f4x {args.verb}".rstrip() + f": {sentence}")
    with contextlib.suppress(Cancelled, OSError):  # nobody listens: the exit code remains
        if lines is not None:
            lines.tell(**failure)
        elif args.json:
            print_text(json_text(failure))
    return code
