"""The command line's grammar: one function for each verb."""

from __future__ import annotations

import argparse
import re
from difflib import get_close_matches
from pathlib import Path
from typing import Any, NoReturn

from ..errors import F4xError
from ..fit.distil_config import DistilConfig
from ..fit.linear_config import LinearConfig
from ..printing import print_text
from ..scene.formats import FORMATS
from ..scene.mesh import MeshConfig
from ..versions import VERSION
from .checks import path_argument, scene_argument
from .options import (
    CLIP,
    Verbs,
    add_verb,
    backend_option,
    clip_options,
    edits_option,
    fit_options,
    mark_options,
    output_option,
    path_options,
    prompt_options,
    scene_option,
)


class Parser(argparse.ArgumentParser):
    """Reports a wrong command line like every other bad input: in one sentence."""

    def _print_message(self, message: str, file: Any = None) -> None:
        """Print help and version as everything else is printed; nothing of it goes to standard error."""
        print_text(message.rstrip("\n"))

    def error(self, message: str) -> NoReturn:
        """Raise F4xError in place of printing the usage."""
        for kind, name in (("int", "whole number"), ("float", "number")):
            message = re.sub(rf"^argument (.+): invalid {kind} value: (.+)$", rf"\1 \2: give a {name}", message)
        joint = " " if message.endswith("?") else "; "
        raise F4xError(f"{message}{joint}`{self.prog} --help` shows what is possible.")

    def parse_known_args(self, args=None, namespace=None):  # type: ignore[no-untyped-def]
        """Parse as argparse does; report what is not known here, where the verb is, and not by the parser of all verbs."""
        namespace, rest = super().parse_known_args(args, namespace)
        if rest:
            self.error(f"unrecognized arguments: {' '.join(rest)}")
        return namespace, rest

    def _check_value(self, action: argparse.Action, value: Any) -> None:
        """Name the nearest of the choices where a value is none of them, and all of them where none is near."""
        choices = [str(choice) for choice in action.choices or ()]
        near = [] if str(value) in choices else get_close_matches(str(value), choices, 1)
        if near:
            raise argparse.ArgumentError(action, f"there is no '{value}'; did you mean '{near[0]}'?")
        super()._check_value(action, value)


class Once(argparse.Action):
    """An option that may be given once: a second value would replace the first without a word."""

    def __call__(self, parser, namespace, values, option_string=None):  # type: ignore[no-untyped-def]
        """Store the value."""
        if getattr(namespace, self.dest) is not None:
            parser.error(f"{option_string} is given twice, of which one would be lost: write both as one sentence")
        setattr(namespace, self.dest, values)


def _fit(verbs: Verbs) -> None:
    """Add the verb `f4x fit`."""
    sub = add_verb(verbs, "fit", "Turn a clip into DIR/scene.f4x.")
    sub.add_argument("clip", type=path_argument, nargs="?", help=CLIP)
    output_option(sub)
    clip_options(sub)
    fit_options(sub)
    sub.add_argument(
        "--show-config",
        action="store_true",
        help="print every setting of --profile and --set with what it does, and fit nothing; needs neither clip nor -o",
    )
    sub.add_argument("--resume", action="store_true", help="continue an interrupted fit")
    sub.add_argument(
        "--minutes", type=float, metavar="M", help="take at most about M minutes, with as many Gaussians as that allows"
    )
    sub.add_argument(
        "--memory",
        type=float,
        metavar="GB",
        help="take at most about GB gigabytes, with as many Gaussians as that allows",
    )
    sub.add_argument(
        "--window",
        type=int,
        metavar="N",
        help="fit N frames at a time and join them (default: 60 to 360 for long clips, by memory; 0: all at once)",
    )
    sub.add_argument(
        "--overlap",
        type=int,
        metavar="N",
        help="frames that neighbouring windows share (default: 12, or nearly half of a shorter window)",
    )
    sub.add_argument(
        "--features", metavar="NAME[,NAME]", help="also distil these teachers' features, see `f4x models list`"
    )
    sub.add_argument(
        "--linear-light", action="store_true", help="also refit for Blender 5.3's own renderers, as `f4x refit` does"
    )


def _window(verbs: Verbs) -> None:
    """Add the verb `f4x window`, which `f4x fit` runs for each window of a long clip."""
    sub = add_verb(verbs, "window", None)
    sub.add_argument("request", type=path_argument, help="what `f4x fit` wrote")


def _priors(verbs: Verbs) -> None:
    """Add the verb `f4x priors`."""
    sub = add_verb(verbs, "priors", "Only compute the priors of a clip into DIR/priors.")
    sub.add_argument("clip", type=path_argument, help=CLIP)
    output_option(sub, required=True)
    clip_options(sub)
    fit_options(sub)


def _distill(verbs: Verbs) -> None:
    """Add the verb `f4x distill`."""
    sub = add_verb(verbs, "distill", "Distil teachers' features into a scene: a latent on it, a head for each.")
    scene_option(sub)
    sub.add_argument("--teacher", metavar="NAME[,NAME]", help="whose features, see `f4x models list`")
    output_option(sub, "SCENE2", help="write there (default: the scene itself)")
    sub.add_argument(
        "--features", type=path_argument, metavar="DIR", help="folder of maps, DIR/TEACHER (default: beside the scene)"
    )
    sub.add_argument(
        "--clip", type=path_argument, help="the scene's clip; needed where the maps are not there and it has moved"
    )
    sub.add_argument("--frames", metavar="A:B:S", help="other frames of the clip than the fit took")
    sub.add_argument(
        "--width", dest="latent_width", default="auto", metavar="D", help="latent channels: auto, 8, 16, 32 or 64"
    )
    steps = DistilConfig.steps
    sub.add_argument("--steps", type=int, default=steps, help=f"optimiser steps (default: {steps})")
    sub.add_argument(
        "--vocabulary", metavar="FILE|WORDS", help="labels to store: words with commas, or a file with one per line"
    )
    sub.add_argument("--seed", type=int, default=0, help="seed of everything random")
    sub.add_argument("--threads", type=int, help="threads (default: all cores)")
    backend_option(sub)


def _refit(verbs: Verbs) -> None:
    """Add the verb `f4x refit`."""
    sub = add_verb(
        verbs, "refit", "Refit colours, opacities and scales for linear light: Blender 5.3's Cycles and EEVEE."
    )
    scene_option(sub)
    steps = LinearConfig.steps
    sub.add_argument("--steps", type=int, default=steps, help=f"optimiser steps (default: {steps})")
    sub.add_argument("--resume", action="store_true", help="go on where the same command was interrupted")
    sub.add_argument("--seed", type=int, default=0, help="seed of the choice of views")
    sub.add_argument("--threads", type=int, help="threads (default: all cores)")


def _render(verbs: Verbs) -> None:
    """Add the verb `f4x render`."""
    sub = add_verb(verbs, "render", "Draw a scene along a camera path.")
    scene_option(sub)
    edits_option(sub)
    output_option(sub, required=True)
    sub.add_argument(
        "--path",
        default="original",
        help="original, orbit, stabilise, slow:FACTOR, bullet:T or frozen:T (T a clip frame), or a camera path file"
        " (default: original)",
    )
    sub.add_argument(
        "--channels",
        default="rgb",
        help="comma-separated: rgb,depth,alpha,motion,unseen,latent, a head, mask:LABEL; with --exr also"
        " vector,normal,position,mist,cryptomatte (default: rgb)",
    )
    sub.add_argument(
        "--degrees", type=float, default=5.0, help="size of orbit and bullet, above 0 and below 90 (default: 5)"
    )
    sub.add_argument("--exr", action="store_true", help="one multi-layer DIR/00000.exr a frame, in Blender's names")
    sub.add_argument(
        "--motion-blur", type=float, default=0.0, metavar="F", help="shutter open for F frames about each (film: 0.5)"
    )
    sub.add_argument(
        "--aperture", type=float, default=0.0, metavar="R", help="depth of field of a lens of this radius, world units"
    )
    sub.add_argument("--focus", type=float, default=1.0, metavar="D", help="depth that is sharp (default: 1)")
    sub.add_argument(
        "--samples", type=int, default=16, metavar="N", help="pictures that make a blurred one (default: 16)"
    )
    sub.add_argument("--video", action="store_true", help="also write DIR/CHANNEL.mp4")
    sub.add_argument("--width", type=int, metavar="W", help="pictures W pixels wide (default: as the clip was fitted)")
    sub.add_argument("--frames", metavar="A:B:S", help="first frame, end and step of the path (default: all of it)")
    sub.add_argument("--part", metavar="I/N", help="only the I-th of N parts of these frames, for N machines")
    backend_option(sub)


def _eval(verbs: Verbs) -> None:
    """Add the verb `f4x eval`."""
    sub = add_verb(verbs, "eval", "Measure a scene against its clip.")
    scene_option(sub)
    edits_option(sub)
    sub.add_argument("--clip", type=path_argument, required=True, help="the clip that was fitted")
    sub.add_argument("--frames", metavar="A:B:S", help="other frames of the clip than the fit took")
    sub.add_argument("--refine-camera", action="store_true", help="also refine the camera on each held-out frame")
    sub.add_argument(
        "--baselines", action="store_true", help="also score the nearest frame and the half-way flow blend"
    )
    sub.add_argument(
        "--truth", type=path_argument, metavar="DIR", help="rendered clip with truth: cameras and unseen views"
    )
    sub.add_argument("--joints", type=path_argument, help="hand-set joints (JSON): track accuracy of the fitted scene")
    sub.add_argument("--masks", metavar="DIR", help="masks of what moves: scores of it alone, and the joints' scale")
    backend_option(sub)


def _info(verbs: Verbs) -> None:
    """Add the verb `f4x info`."""
    sub = add_verb(verbs, "info", "What is in a scene file.")
    scene_option(sub)
    edits_option(sub)


def _export(verbs: Verbs) -> None:
    """Add the verb `f4x export`."""
    sub = add_verb(verbs, "export", "Write a scene for other programs: PLY, .splat, SPZ, glTF, USD, points.")
    scene_option(sub, "a .f4x scene, splats (.ply, .splat, .spz, .glb) or a folder of numbered PLY")
    edits_option(sub)
    output_option(
        sub,
        "FILE|DIR",
        required=True,
        help="FILE.ply, .splat, .spz or .glb with --time; FILE.usda for all frames; DIR for NAME_0000.ply, NAME_0001.ply, …",
    )
    sub.add_argument("--format", choices=FORMATS, help="default: by the ending of FILE; ply for DIR")
    moments = sub.add_mutually_exclusive_group()
    moments.add_argument("--time", type=float, metavar="T", help="one clip frame, from 0; may lie between two")
    moments.add_argument("--frames", metavar="A:B:S", help="first frame, end and step (default: all frames)")


def _mesh(verbs: Verbs) -> None:
    """Add the verb `f4x mesh`."""
    sub = add_verb(
        verbs,
        "mesh",
        "Write a mesh around a thing, moved by its nodes, for shadows, contact and holdouts in other programs.",
    )
    scene_option(sub)
    edits_option(sub)
    output_option(sub, "FILE.glb", required=True)
    sub.add_argument(
        "--select", type=path_argument, metavar="FILE", help="the selection.json of `f4x query SCENE … -o DIR`"
    )
    prompt_options(sub)
    sub.add_argument(
        "--time", type=float, metavar="T", help="clip frame whose shape it is (default: where it is spread the widest)"
    )
    sub.add_argument(
        "--faces", type=int, default=MeshConfig.faces, metavar="N", help="triangles at most (default: 20000)"
    )
    sub.add_argument(
        "--resolution",
        type=int,
        default=MeshConfig.resolution,
        metavar="N",
        help="steps along the longest side (default: 96)",
    )
    sub.add_argument(
        "--level", type=float, default=MeshConfig.level, metavar="A", help="opacity at the surface (default: 0.5)"
    )
    sub.add_argument("--hollows", action="store_true", help="keep the walls of hollows inside, such as those of a room")
    backend_option(sub)


def _open(verbs: Verbs) -> None:
    """Add the verb `f4x open`."""
    sub = add_verb(verbs, "open", "Show a scene in the browser, without Blender: one HTML page that plays.")
    scene_option(sub, "a .f4x scene or splats (.ply, .splat, .spz, .glb)")
    edits_option(sub)
    sub.add_argument("-o", "--write", type=path_argument, metavar="FILE", help="only write the page there")
    sub.add_argument("--word", metavar="WORD[,WORD]", help="buttons that colour what these words mean")
    sub.add_argument(
        "--degrees",
        type=float,
        help="how far aside the page lets look (default: as far as the scene can be believed, or 5 where that is not known)",
    )


def _query(verbs: Verbs) -> None:
    """Add the verb `f4x query`."""
    sub = add_verb(
        verbs, "query", "Select what words and marks on a frame mean, alone or together: Gaussians and masks."
    )
    scene_option(sub)
    edits_option(sub)
    prompt_options(sub)
    sub.add_argument("--span", metavar="A:B", help="clip frames in which the selection holds (default: all)")
    sub.add_argument("--if-any", action="store_true", help="an empty selection is written and is no error")
    output_option(sub, help="write DIR/selection.json, DIR/mask/00000.png …, DIR/heat.mp4")
    path_options(sub)
    backend_option(sub)


def _name(verbs: Verbs) -> None:
    """Add the verb `f4x name`."""
    sub = add_verb(
        verbs, "name", "Teach the scene a word: what a click, a box or a mask selects answers to it from then on."
    )
    scene_option(sub)
    sub.add_argument("word", metavar="WORD", help="letters, digits, spaces, - and _, for example train")
    sub.add_argument("--text", metavar="WORD", help="another word for it; with --click, only what that selects")
    mark_options(sub, "--click")
    backend_option(sub)


def _ask(verbs: Verbs) -> None:
    """Add the verb `f4x ask`."""
    sub = add_verb(verbs, "ask", "Ask a scene a question; the answer names who gave it.")
    scene_option(sub)
    edits_option(sub)
    sub.add_argument("question", help='in English, for example "Where is the dog?"')
    sub.add_argument(
        "--select", type=path_argument, metavar="FILE", help='what "it" means: the selection.json of `f4x query -o DIR`'
    )
    sub.add_argument(
        "--endpoint", metavar="URL", help="send rendered frames to this OpenAI-compatible server (or F4X_CHAT_URL)"
    )
    sub.add_argument("--yes", action="store_true", help="read a doubtful question as what was probably meant")
    sub.add_argument("--model", metavar="PATH", help="folder of SmolVLM2: it reads the scene's smolvlm features")
    path_options(sub)
    backend_option(sub)


def _edit(verbs: Verbs) -> None:
    """Add the verb `f4x edit`."""
    sub = add_verb(verbs, "edit", "Append edits to a scene; what is in its arrays never changes.")
    scene_option(sub)
    how = sub.add_mutually_exclusive_group(required=True)
    how.add_argument(
        "--say", action=Once, metavar="SENTENCE", help='what to do, for example "make the dog red from second 2"'
    )
    how.add_argument("--ops", type=path_argument, metavar="FILE", help="JSON: a list of operations")
    sub.add_argument(
        "--select", type=path_argument, metavar="FILE", help='what "it" means: the selection.json of `f4x query -o DIR`'
    )
    output_option(sub, "SCENE2", help="write there (default: the scene itself)")
    sub.add_argument("--dry-run", action="store_true", help="say what would be done; write nothing")
    sub.add_argument(
        "--yes",
        action="store_true",
        help="read a misspelt word of --say as what was probably meant, and leave out words that nobody knows",
    )
    sub.add_argument("--frame", type=float, default=0.0, metavar="T", help="clip frame that is looked at: here and now")
    sub.add_argument(
        "--endpoint", metavar="URL", help="let the model of this OpenAI-compatible server read --say (or F4X_CHAT_URL)"
    )
    sub.add_argument(
        "--candidates", type=int, default=1, metavar="N", help="try N readings of --say, apply the best (default: 1)"
    )
    sub.add_argument("--contact-sheet", type=path_argument, metavar="FILE", help="picture of before and the candidates")
    backend_option(sub)


def _history(verbs: Verbs) -> None:
    """Add the verb `f4x history`."""
    sub = add_verb(verbs, "history", "The edits of a scene, and what `redo` would bring back.")
    scene_option(sub)


def _undo_redo(verbs: Verbs) -> None:
    """Add the verbs `f4x undo` and `f4x redo`."""
    for name, description in (("undo", "Take back the last edits."), ("redo", "Bring back what was undone last.")):
        sub = add_verb(verbs, name, description)
        scene_option(sub)
        sub.add_argument("--count", type=int, default=1, metavar="N", help="so many edits (default: 1)")


def _bake(verbs: Verbs) -> None:
    """Add the verb `f4x bake`."""
    sub = add_verb(verbs, "bake", "Fold the edits of a scene into the arrays of a new one.")
    scene_option(sub)
    output_option(sub, "SCENE2", required=True)


def _serve(verbs: Verbs) -> None:
    """Add the verb `f4x serve`."""
    sub = add_verb(verbs, "serve", "Let agents look at, question and edit scenes, through the Model Context Protocol.")
    sub.add_argument("target", type=path_argument, metavar="SCENE|FOLDER", help="the one scene, or folder, they see")
    sub.add_argument("--mcp", action="store_true", required=True, help="the protocol; on standard input and output")
    sub.add_argument(
        "--http",
        nargs="?",
        const="8484",
        metavar="PORT",
        help="on HTTP for this machine alone instead (default: 8484); asks for the token in F4X_TOKEN, or prints one",
    )
    sub.add_argument("--read-only", action="store_true", help="without the tools that edit and export")
    backend_option(sub)


def _features(verbs: Verbs) -> None:
    """Add the verb `f4x features`."""
    sub = add_verb(verbs, "features", "Let teachers look at a clip: feature maps in DIR/features/TEACHER.")
    sub.add_argument("clip", type=path_argument, help=CLIP)
    output_option(sub, required=True)
    sub.add_argument("--teacher", required=True, metavar="NAME[,NAME]", help="names as `f4x models list` shows them")
    sub.add_argument(
        "--rank", type=int, metavar="K", help="keep the K strongest directions of every teacher's features"
    )
    sub.add_argument("--frames", metavar="A:B:S", help="first frame, end and step of the frames to use")
    sub.add_argument("--width", type=int, help="picture width in pixels (default: 480 along the longer side)")
    sub.add_argument(
        "--model",
        metavar="PATH",
        help="a folder of weights (or of maps), or a name of `f4x models list`; for one teacher",
    )


def _models(verbs: Verbs) -> None:
    """Add the verb `f4x models`."""
    sub = add_verb(verbs, "models", "Teachers and weights: what there is, fetch one, or where it lies.")
    sub.add_argument("what", choices=("list", "get", "path"))
    sub.add_argument("name", nargs="?", help="of the weights, or of a teacher")


def _batch(verbs: Verbs) -> None:
    """Add the verb `f4x batch`."""
    sub = add_verb(
        verbs, "batch", "Many clips: every row of a manifest, in processes of this machine or on a Ray cluster."
    )
    sub.add_argument("manifest", help="FILE.csv, FILE.json, or a pattern in quotes, 'shots/*.mp4'")
    sub.add_argument(
        "-o",
        "--output",
        dest="place",
        required=True,
        metavar="DIR|URL",
        help="gets index.html and a folder for each row",
    )
    where = sub.add_mutually_exclusive_group()
    where.add_argument(
        "--jobs", type=int, metavar="N", help="tasks at a time (default: the cores, by threads of a task)"
    )
    where.add_argument("--ray", metavar="ADDRESS|auto", help="run on this Ray cluster")
    sub.add_argument(
        "--set", action="append", default=[], metavar="COLUMN=VALUE", help="of rows that do not say it themselves"
    )
    sub.add_argument("--scratch", metavar="DIR", help="for work in progress, on each machine (default: DIR itself)")
    sub.add_argument("--dry-run", action="store_true", help="tell the tasks and what is done; do nothing")


def _doctor(verbs: Verbs) -> None:
    """Add the verb `f4x doctor`."""
    sub = add_verb(verbs, "doctor", "What this machine has, and whether it works.")
    sub.add_argument("code", nargs="?", help="explain this code of an error, such as F4X-CLIP, instead")
    sub.add_argument("--report", action="store_true", help="as Markdown for an issue, without paths and names")
    sub.add_argument(
        "--scene", type=scene_argument, help="with --report: tell the numbers of this scene and its fit, too"
    )


def _bench(verbs: Verbs) -> None:
    """Add the verb `f4x bench`."""
    sub = add_verb(verbs, "bench", "Speed against error of the kernels on this machine; needs a checkout.")
    sub.add_argument("what", choices=("raster", "deform", "step", "features", "edit", "select", "scale"))
    sub.add_argument("--clips", type=int, default=8, metavar="N", help="small clips that are fitted, 0 to 8 (scale)")
    sub.add_argument(
        "--long",
        type=int,
        nargs="+",
        metavar="N",
        help="in place of small clips: one of so many frames and a longer one, e.g. 200 1000, of the pictures in --clip or"
        " made up; takes hours (scale)",
    )
    sub.add_argument(
        "--folder",
        type=path_argument,
        metavar="DIR",
        help="where the clips of --long and their fits stay, or the priors of --clip (step); what is finished there is not"
        " made again",
    )
    sub.add_argument("--counts", type=int, nargs="+", default=[50_000], metavar="N", help="numbers of Gaussians")
    sub.add_argument("--threads", type=int, nargs="+", default=[1, 2], metavar="T", help="numbers of threads (raster)")
    sub.add_argument("--repeats", type=int, default=5, help="rounds of which the median is taken")
    _bench_scene(sub)


def _bench_scene(sub: argparse.ArgumentParser) -> None:
    """Add the options for the scene, clip and truth that `f4x bench features`, `edit`, `select` and `step` measure."""
    sub.add_argument(
        "--scene",
        type=path_argument,
        help="scene whose answers, edits or selections are measured (features, edit, select)",
    )
    sub.add_argument(
        "--masks",
        type=path_argument,
        metavar="DIR",
        help="true masks, one for each clip frame (features, edit, select)",
    )
    sub.add_argument("--label", metavar="WORD", help="what the masks show (features, edit, select)")
    sub.add_argument(
        "--things",
        type=path_argument,
        metavar="FILE",
        help="outlines of things that stand, tests/data/static_things.json (select)",
    )
    sub.add_argument(
        "--seeds",
        type=int,
        default=3,
        metavar="N",
        help="made-up scenes of each kind, where no --scene is given (select)",
    )
    sub.add_argument(
        "--truth",
        type=path_argument,
        metavar="DIR",
        help="truth of the rendered clip whose subject --label names (features, edit)",
    )
    sub.add_argument(
        "--clip",
        type=path_argument,
        help="the scene's clip: what features change in pictures (features), or the clip that is fitted (step)",
    )
    sub.add_argument(
        "--frames", metavar="A:B:S", help="other frames than the fit took (features), or those to fit (step)"
    )
    sub.add_argument(
        "--plain", type=path_argument, metavar="SCENE", help="the scene before distilling (default: without its field)"
    )
    sub.add_argument("--times", action="store_true", help="also fit the clip anew and distil, which takes minutes")
    sub.add_argument(
        "--features", type=path_argument, metavar="DIR", help="folder of maps for --times (default: beside the scene)"
    )


def _report(verbs: Verbs) -> None:
    """Add the verb `f4x report`."""
    sub = add_verb(
        verbs,
        "report",
        "Speed against error, hard cases, needs: one page of measurements, and its data; needs a checkout.",
    )
    output_option(sub, required=True)
    sub.add_argument("--quick", action="store_true", help="small sizes: the whole report in about 15 minutes")
    sub.add_argument("--only", metavar="NAME[,NAME]", help="studies, or parts: speed, stability, needs, …")
    sub.add_argument(
        "--clips", type=path_argument, metavar="DIR", help="real clips: DIR/CLIP/images and DIR/CLIP/masks"
    )
    sub.add_argument("--data", type=path_argument, metavar="DIR", help="data sets: DIR/nvidia, DIR/dycheck, …")
    sub.add_argument("--cases", type=path_argument, metavar="DIR", help="hard cases (default: tests/hard_cases here)")
    sub.add_argument("--threads", type=int, default=1, help="threads of the kernels that can use more (default: 1)")
    sub.add_argument("--seed", type=int, default=0, help="seed of everything random")


def _demo(verbs: Verbs) -> None:
    """Add the verb `f4x demo`."""
    sub = add_verb(
        verbs, "demo", "A short rendered clip, which needs a checkout, or your own one all the way to a Blender file."
    )
    film = sub.add_mutually_exclusive_group()
    film.add_argument("--clip", type=path_argument, help="your own video instead of the rendered one")
    film.add_argument(
        "--scene", default="procedural", metavar="NAME", help="which rendered one: driving, meeting, swinging, …"
    )
    output_option(sub, default=Path("demo"), help="default: demo")
    clip_options(sub)
    fit_options(sub)
    sub.set_defaults(profile="quick")


VERBS = (
    _fit,
    _priors,
    _distill,
    _refit,
    _render,
    _eval,
    _info,
    _export,
    _mesh,
    _open,
    _query,
    _name,
    _ask,
    _edit,
    _history,
    _undo_redo,
    _bake,
    _serve,
    _features,
    _models,
    _batch,
    _doctor,
    _bench,
    _report,
    _demo,
    _window,
)
"""In the order in which `f4x --help` lists them."""
FIRST = """first steps:
  f4x doctor                        is everything here?
  f4x fit clip.mp4 -o my_scene      a scene of your clip; minutes
  f4x open my_scene                 look at it in the browser
  f4x ask my_scene "What moves?"
  f4x VERB --help                   what a verb takes
  f4x doctor F4X-CLIP               what the code behind an error means"""


def build_parser() -> argparse.ArgumentParser:
    """Return the parser of every verb."""
    parser = Parser(
        prog="f4x",
        description="From one video to a 4D scene that moves, in Blender too.",
        epilog=FIRST,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("--version", action="version", version=f"f4x {VERSION}")
    verbs = parser.add_subparsers(dest="verb", required=True, metavar="VERB")
    for add in VERBS:
        add(verbs)
    return parser
