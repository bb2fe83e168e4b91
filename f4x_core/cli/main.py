"""The command line: parses, calls one verb, prints one clear sentence when something is wrong."""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

from .. import __version__
from ..errors import Cancelled, F4xError
from .terminal import TerminalProgress

EXIT_BAD_INPUT = 2
EXIT_INTERRUPTED = 130
PROFILES = ("quick", "wild", "nvidia", "dycheck", "f4x_davis")


def build_parser() -> argparse.ArgumentParser:
    """The parser of every verb."""
    parser = argparse.ArgumentParser(prog="f4x", description="From one video to a 4D scene that moves, in Blender too.")
    parser.add_argument("--version", action="version", version=f"f4x {__version__}")
    verbs = parser.add_subparsers(dest="verb", required=True, metavar="VERB")

    def verb(name: str, description: str) -> argparse.ArgumentParser:
        sub = verbs.add_parser(name, help=description, description=description)
        sub.add_argument(
            "--json", action="store_true", help="print one JSON object and nothing else on standard output"
        )
        return sub

    def clip_options(sub: argparse.ArgumentParser) -> None:
        sub.add_argument("--frames", metavar="A:B:S", help="first frame, end and step of the frames to use")
        sub.add_argument("--width", type=int, help="fit at this picture width in pixels")
        sub.add_argument("--hold-out", type=int, metavar="N", help="keep frames with index %% N == N-1 for measuring")
        sub.add_argument(
            "--masks", metavar="DIR", help="folder of masks of what moves, or 'layout' for the data set's own"
        )

    def fit_options(sub: argparse.ArgumentParser) -> None:
        sub.add_argument("--profile", choices=PROFILES, default="wild", help="how much work to spend (default: wild)")
        sub.add_argument("--seed", type=int, default=0, help="seed of everything random")
        sub.add_argument("--threads", type=int, default=0, help="threads (default: all cores)")
        sub.add_argument("--backend", default="auto", help="raster backend: auto, native, torch, reference")
        sub.add_argument(
            "--provider",
            default="classical",
            help="who makes the priors: classical, or synthetic (a rendered clip's truth)",
        )
        sub.add_argument(
            "--prior",
            action="append",
            default=[],
            metavar="NAME=PATH",
            help="your own prior, e.g. depth=DIR or cameras=FILE",
        )

    sub = verb("fit", "Turn a clip into DIR/scene.f4x.")
    sub.add_argument("clip", help="video file, image folder, or NVIDIA / DyCheck / DAVIS data set")
    sub.add_argument("-o", "--output", type=Path, required=True, metavar="DIR")
    clip_options(sub)
    fit_options(sub)
    sub.add_argument("--resume", action="store_true", help="continue an interrupted fit")

    sub = verb("priors", "Only compute the priors of a clip into DIR/priors.")
    sub.add_argument("clip")
    sub.add_argument("-o", "--output", type=Path, required=True, metavar="DIR")
    clip_options(sub)
    fit_options(sub)

    sub = verb("render", "Draw a scene along a camera path.")
    sub.add_argument("scene", type=Path)
    sub.add_argument("-o", "--output", type=Path, required=True, metavar="OUT")
    sub.add_argument(
        "--path", default="original", help="original, orbit, frozen:T, or a camera path file (default: original)"
    )
    sub.add_argument("--channels", default="rgb", help="comma-separated: rgb,depth,alpha,motion (default: rgb)")
    sub.add_argument("--degrees", type=float, default=5.0, help="size of the orbit (default: 5)")
    sub.add_argument("--video", action="store_true", help="also write OUT/CHANNEL.mp4")
    sub.add_argument("--backend", default="auto")

    sub = verb("eval", "Measure a scene against its clip.")
    sub.add_argument("scene", type=Path)
    sub.add_argument("--clip", required=True)
    sub.add_argument("--frames", metavar="A:B:S")
    sub.add_argument("--refine-camera", action="store_true", help="also refine the camera on each held-out frame")
    sub.add_argument(
        "--baselines", action="store_true", help="also score the nearest frame and the half-way flow blend"
    )
    sub.add_argument("--truth", type=Path, metavar="DIR", help="rendered clip with truth: cameras and unseen views")
    sub.add_argument("--joints", type=Path, help="hand-set joints (JSON): track accuracy of the fitted scene")
    sub.add_argument("--masks", metavar="DIR", help="masks of the animal, for the joints' scale")
    sub.add_argument("--backend", default="auto")

    sub = verb("info", "What is in a scene file.")
    sub.add_argument("scene", type=Path)

    sub = verb("export", "Write one frame, or all, as ordinary 3DGS PLY.")
    sub.add_argument("scene", type=Path)
    sub.add_argument("-o", "--output", type=Path, required=True, metavar="FILE_OR_DIR")
    sub.add_argument("--time", type=float, help="clip frame to write; all frames when left out")

    verb("doctor", "What this machine has, and whether it works.")

    sub = verb("demo", "A short rendered clip (or your own) all the way to a Blender file.")
    sub.add_argument("--clip", help="your own video instead of the rendered one")
    sub.add_argument("-o", "--output", type=Path, default=Path("demo"), metavar="DIR")
    clip_options(sub)
    fit_options(sub)
    sub.set_defaults(profile="quick")
    return parser


def find_verb(name: str) -> Callable[[argparse.Namespace, TerminalProgress], dict[str, Any]]:
    """The function behind a verb; imports only what that verb needs."""
    from importlib import import_module

    modules = {"fit": "fitting", "priors": "fitting", "eval": "measuring", "render": "rendering", "export": "rendering"}
    module = import_module(f".{modules.get(name, name)}", __package__)
    return getattr(module, f"run_{name}")


def main(arguments: list[str] | None = None) -> int:
    """Run one command; returns the exit code."""
    args = build_parser().parse_args(arguments)
    try:
        with TerminalProgress(quiet=args.json and not sys.stderr.isatty()) as progress:
            result = find_verb(args.verb)(args, progress)
    except F4xError as error:
        return _fail(args, str(error), EXIT_BAD_INPUT)
    except OSError as error:
        where = error.filename or getattr(args, "output", None) or "the output folder"
        return _fail(args, f"{where}: {error.strerror or error}; nothing half-written was left behind.", EXIT_BAD_INPUT)
    except (KeyboardInterrupt, Cancelled):
        again = "; the same command with --resume continues" if args.verb == "fit" else ""
        return _fail(args, f"Stopped{again}.", EXIT_INTERRUPTED)
    text = result.pop("text", None)
    if args.json:
        print(json.dumps(result, default=float))
    elif text:
        print(text)
    return 0


def _fail(args: argparse.Namespace, sentence: str, code: int) -> int:
    print(f"f4x {args.verb}: {sentence}", file=sys.stderr)
    if args.json:
        print(json.dumps({"error": sentence}))
    return code
