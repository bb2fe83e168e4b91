"""Options that several verbs share."""

from __future__ import annotations

import argparse
from typing import Any, TypeAlias

from ..raster import CPU_BACKENDS  # with numpy: where an early Ctrl-C is answered already
from .checks import path_argument, scene_argument

Verbs: TypeAlias = "argparse._SubParsersAction[Any]"
CLIP = "video file, image folder, or NVIDIA / DyCheck / DAVIS data set"
"""Kinds of clips, for help texts."""
PROFILES = ("quick", "wild", "nvidia", "dycheck", "f4x_davis")


def add_verb(verbs: Verbs, name: str, description: str | None) -> argparse.ArgumentParser:
    """Return a verb with the options that all of them have; one without a description is for programs and not listed."""
    listed: dict[str, Any] = {} if description is None else {"help": description, "description": description}
    sub = verbs.add_parser(name, **listed)
    sub.add_argument("--json", action="store_true", help="print one JSON object and nothing else on standard output")
    if name != "serve":  # its standard output and input belong to the client
        sub.add_argument(
            "--progress-json",
            action="store_true",
            help="for programs: JSON lines of progress, the result last; stops when the pipe on standard input closes",
        )
    return sub


def scene_option(sub: argparse.ArgumentParser, help: str = "a .f4x scene, or the folder of its fit") -> None:
    """Add the scene, which comes first."""
    sub.add_argument("scene", type=scene_argument, help=help)


def output_option(sub: argparse.ArgumentParser, metavar: str = "DIR", **more: Any) -> None:
    """Add `-o/--output`, the place of the result."""
    more.setdefault("help", "where the result goes")
    sub.add_argument("-o", "--output", type=path_argument, metavar=metavar, **more)


def backend_option(sub: argparse.ArgumentParser) -> None:
    """Add the option of the raster backend."""
    sub.add_argument("--backend", choices=("auto", *CPU_BACKENDS), default="auto", help="what draws (default: auto)")


def clip_options(sub: argparse.ArgumentParser) -> None:
    """Add options of frames and size of a clip."""
    sub.add_argument("--frames", metavar="A:B:S", help="first frame, end and step of the frames to use")
    sub.add_argument(
        "--width",
        type=int,
        help="fit at this picture width in pixels (default: 480 along the longer side); pictures are never enlarged",
    )
    sub.add_argument("--hold-out", type=int, metavar="N", help="keep frames with index %% N == N-1 for measuring")
    sub.add_argument(
        "--masks",
        metavar="DIR",
        help="folder of masks of what moves, 'layout' for the data set's own, or 'alpha' for the clip's own alpha",
    )


def edits_option(sub: argparse.ArgumentParser) -> None:
    """Add the option that leaves the edits of a scene out."""
    sub.add_argument("--without-edits", dest="edits", action="store_false", help="the scene as it was fitted")


def fit_options(sub: argparse.ArgumentParser) -> None:
    """Add the options of a fit."""
    sub.add_argument("--profile", choices=PROFILES, default="wild", help="how much work to spend (default: wild)")
    sub.add_argument("--seed", type=int, default=0, help="seed of everything random")
    sub.add_argument("--threads", type=int, help="threads (default: all cores)")
    backend_option(sub)
    sub.add_argument(
        "--provider",
        default="classical",
        help="who makes the priors: classical, or synthetic (a rendered clip's truth)",
    )
    for stage, example in (("cameras", "depth-anything-3"), ("depth", "depth-anything or depth-anything-3")):
        sub.add_argument(
            f"--{stage}",
            metavar="PROVIDER",
            help=f"who makes the {stage} alone, e.g. {example} (see `f4x models list`)",
        )
    sub.add_argument(
        "--prior",
        action="append",
        default=[],
        metavar="NAME=PATH",
        help="your own prior, e.g. depth=DIR or cameras=FILE",
    )
    sub.add_argument(
        "--set",
        action="append",
        default=[],
        metavar="NAME=VALUE",
        help="a setting of the profile, e.g. steps=600; `f4x fit --show-config` lists them all",
    )


def mark_options(sub: argparse.ArgumentParser, point: str) -> None:
    """Add the options of marks on a frame of the clip; `point` is the name of the option of a point."""
    sub.add_argument(
        point,
        dest="point",
        metavar="X,Y",
        help="on the thing, in pixels of the fitted picture (`f4x info` tells its size) from the upper left corner; all marks"
        " are in these; with --frame",
    )
    sub.add_argument("--beside", metavar="X,Y", help="on what is not meant; with a mark on the thing")
    sub.add_argument("--box", metavar="X0,Y0,X1,Y1", help="left, top, right, bottom; with --frame")
    sub.add_argument("--brush", metavar="'X,Y X,Y …'", help="stroke on the thing, through these places; with --frame")
    sub.add_argument(
        "--brush-width",
        type=float,
        default=0.0,
        metavar="PX",
        help="width of the stroke in pixels (default: a point's)",
    )
    sub.add_argument("--lasso", metavar="'X,Y X,Y …'", help="line around the thing, through these places; with --frame")
    sub.add_argument("--mask", type=path_argument, metavar="FILE", help="picture, not black on the thing; with --frame")
    sub.add_argument("--frame", type=int, metavar="T", help="clip frame of the marks, from 0")


def prompt_options(sub: argparse.ArgumentParser) -> None:
    """Add options that select Gaussians by words and marks."""
    sub.add_argument("--text", metavar="WORD[,WORD]", help="labels, for example swan")
    sub.add_argument("--not", dest="negatives", metavar="WORD[,WORD]", help="what to weigh --text against")
    mark_options(sub, "--point")
    sub.add_argument("--part", action="store_true", help="of the person at --point the part of the body alone")
    sub.add_argument("--threshold", type=float, default=0.5, metavar="P", help="least score, 0 to 1 (default: 0.5)")


def path_options(sub: argparse.ArgumentParser) -> None:
    """Add the options of a camera path."""
    sub.add_argument(
        "--path",
        default="original",
        help="seen along: original, orbit, stabilise, slow:FACTOR, bullet:T or frozen:T (T a clip frame), or a camera path file"
        " (default: original)",
    )
    sub.add_argument("--degrees", type=float, default=5.0, help="size of the orbit and the swing (default: 5)")
