"""Stable codes of everything that can go wrong for a user: the family of an error follows from the module that raises it.

`with_code` ends a sentence with its code, `f4x doctor CODE` and docs/troubleshooting.md explain it. A sentence may be worded anew
and a module may move; its family keeps its code.
"""

from __future__ import annotations

import errno
import re
import traceback
from dataclasses import dataclass
from pathlib import Path
from types import FrameType

from .errors import F4xError


@dataclass(frozen=True)
class Trouble:
    """One family of errors."""

    code: str
    """Stands in brackets behind the sentence; never given to another family."""
    cause: str
    """Fault that all sentences of the family have in common."""
    cure: str
    """Remedy that helps most often; the sentence says it for the case at hand."""
    modules: tuple[str, ...] = ()
    """Modules and packages that raise it, as dotted names below the repository; the longest that fits a module wins."""


UNKNOWN = "F4X-OTHER"
TOPS = ("f4x_core", "addon", "ground_truth", "scripts", "tools")
"""Folders of the repository whose code raises F4xError."""
TROUBLES = (
    Trouble(
        "F4X-CLIP",
        "The video, folder of images or data set cannot be read, or has too few frames, other sizes or a damaged frame.",
        "Check its name; play it and export it again as MP4 (H.264). Data sets: compare the folder with docs/datasets.md.",
        ("f4x_core.clip",),
    ),
    Trouble(
        "F4X-RENDERED",
        "A clip of the demo, or its truth, cannot be made or is incomplete.",
        "Remove the folder and render it again: scripts/synthetic_clip.py, or `f4x demo`.",
        (
            "f4x_core.clip.rendered_scenes",
            "f4x_core.cli.demo",
            "ground_truth.clip",
            "ground_truth.figures",
            "ground_truth.truth",
        ),
    ),
    Trouble(
        "F4X-CAMERA",
        "A camera file or a camera path is damaged, of another version, or contradicts itself.",
        "Compare it with the example in docs/commands.md (paths), or leave it out.",
        ("f4x_core.geometry",),
    ),
    Trouble(
        "F4X-PRIORS",
        "Depth, flow, masks or tracks that were supplied have another size, number or kind than the clip.",
        "Compare shape and dtype with the table in docs/architecture.md; remove the folder priors/ to have them made anew.",
        ("f4x_core.people", "f4x_core.priors"),
    ),
    Trouble(
        "F4X-TRACKING",
        "The camera cannot be found: too little of the background is seen, or COLMAP is missing.",
        "Read docs/which_clips.md; mark what moves with --masks DIR, or give --prior cameras=FILE.",
        ("f4x_core.priors.sfm", "f4x_core.priors.colmap_child"),
    ),
    Trouble(
        "F4X-SETTINGS",
        "A setting of --set or of a profile does not exist or is out of range.",
        "`f4x fit --show-config` prints every setting with what it takes.",
        ("f4x_core.fit.config", "f4x_core.fit.settings", "f4x_core.fit.distil_config"),
    ),
    Trouble(
        "F4X-RESUME",
        "What a stopped fit left cannot be continued: it belongs to another clip, setting or version.",
        "Run the command without --resume, or into a new folder.",
        ("f4x_core.fit.checkpoint", "f4x_core.windows.resuming", "f4x_core.windows.window"),
    ),
    Trouble(
        "F4X-FIT",
        "The fit cannot go on with this clip, these priors or this memory.",
        "Fewer frames (--frames), a smaller --width or --memory; then open diagnostics.html.",
        ("f4x_core.fit", "f4x_core.scaffold", "f4x_core.gaussians"),
    ),
    Trouble(
        "F4X-WINDOW",
        "The parts of a long clip do not fit together.",
        "Fit the parts with the same --width and profile, in their order; see docs/batch.md.",
        ("f4x_core.windows",),
    ),
    Trouble(
        "F4X-SCENE",
        "A scene file is damaged, incomplete, or of a newer version.",
        "Update Feature4X, copy the file again, or fit the scene again.",
        ("f4x_core.scene",),
    ),
    Trouble(
        "F4X-IMPORT",
        "A PLY, .splat or other file from elsewhere is none of the kinds that are read.",
        "docs/formats.md lists them; export it as a 3DGS PLY from the program that made it.",
        (
            "f4x_core.scene.foreign",
            "f4x_core.scene.recognise",
            "f4x_core.scene.ply",
            "f4x_core.scene.formats.gltf_splats",
            "f4x_core.scene.formats.splat",
            "f4x_core.scene.formats.spz",
        ),
    ),
    Trouble(
        "F4X-EXPORT",
        "A format, time, path or selection of an export, a mesh or pictures is not possible.",
        "docs/formats.md and `f4x export --help` list the formats; `f4x render --help` the camera paths.",
        (
            "f4x_core.scene.formats",
            "f4x_core.scene.mesh",
            "f4x_core.scene.posing",
            "f4x_core.scene.view",
            "f4x_core.app.rendering",
            "f4x_core.app.paths",
            "f4x_core.app.exporting",
        ),
    ),
    Trouble(
        "F4X-FEATURES",
        "The scene has no features that this needs, or they are of another teacher.",
        "`f4x distill SCENE --teacher text,visual --clip CLIP` adds them.",
        (
            "f4x_core.features",
            "f4x_core.fit.distil",
            "f4x_core.fit.vocabulary",
            "f4x_core.app.distilling",
            "f4x_core.cli.distilling",
        ),
    ),
    Trouble(
        "F4X-MODEL",
        "The weights of a model are missing, or other ones than those that were checked.",
        "`f4x models list` says what is there, `f4x models get NAME` fetches one.",
        ("f4x_core.features.models", "f4x_core.features.weights", "f4x_core.features.offline", "f4x_core.cli.features"),
    ),
    Trouble(
        "F4X-QUERY",
        "A word, point, box, mask or question finds nothing in this scene, or is not understood.",
        "`f4x info SCENE` lists the words it knows; `--vocabulary` of `f4x distill` adds more.",
        ("f4x_core.query", "f4x_core.app.selecting", "f4x_core.cli.querying", "f4x_core.cli.asking"),
    ),
    Trouble(
        "F4X-EDIT",
        "An edit has a value out of range, does not belong to this scene, or there is nothing to undo.",
        "`f4x history SCENE` shows the edits; docs/edits.md what each takes.",
        ("f4x_core.edit", "f4x_core.app.editing", "f4x_core.cli.history"),
    ),
    Trouble(
        "F4X-LANGUAGE",
        "A sentence is not understood, or names something that the scene does not have.",
        "docs/language.md lists what can be said; name the thing by a word that `f4x query` finds.",
        tuple(f"f4x_core.edit.{name}" for name in ("language", "phrases", "commands", "naming", "resolve")),
    ),
    Trouble(
        "F4X-ENDPOINT",
        "The language model that was asked does not answer, or not in a form that can be used.",
        "Check that its server runs at the address given, say it otherwise, or leave --endpoint out.",
        ("f4x_core.edit.endpoint", "f4x_core.edit.judge", "f4x_core.edit.reply", "f4x_core.query.chat"),
    ),
    Trouble(
        "F4X-EVAL",
        "A clip does not match the scene that it is compared with.",
        "Give the clip, --frames and --width of the fit.",
        ("f4x_core.evaluation", "f4x_core.cli.measuring"),
    ),
    Trouble(
        "F4X-RASTER",
        "Gaussians cannot be drawn: a value is not finite, or the backend that was asked for does not run here.",
        "Use --backend auto; `f4x doctor` says which backends run and why others do not.",
        (
            "f4x_core.raster",
            "f4x_core.native",
            "f4x_core.scaffold.deformation.native",
            "f4x_core.fit.picture_native",
            "f4x_core.scene.depth_order",
            "f4x_core.scene.splat_textures",
        ),
    ),
    Trouble(
        "F4X-BATCH",
        "A row of the manifest, a cluster or a storage cannot be used.",
        "docs/batch.md shows a manifest; `f4x batch --dry-run` checks one without working.",
        ("f4x_core.batch", "f4x_core.cli.batch"),
    ),
    Trouble(
        "F4X-AGENT",
        "A tool call of an agent is not possible, or the server cannot start.",
        "docs/agents.md lists tools and their limits; `pip install mcp` where it is missing.",
        ("f4x_core.agent", "f4x_core.cli.serve"),
    ),
    Trouble(
        "F4X-OPTION",
        "An option of the command line is missing, contradicts another, or names a file or folder that is not there.",
        "`f4x VERB --help` lists the options of a verb.",
        ("f4x_core.app", "f4x_core.cli", "f4x_core.files", "f4x_core.troubles"),
    ),
    Trouble(
        "F4X-INSTALL",
        "Python, a package or the worker's environment is missing or too old.",
        "`f4x doctor` lists what is there; in Blender, Preferences > Add-ons > Feature4X > Check Setup.",
        ("f4x_core.installation", "addon.jobs.worker", "addon.jobs.preferences"),
    ),
    Trouble(
        "F4X-JOB",
        "A job in another process was stopped or ended without a result.",
        "Its log under Tasks has the last lines; the same button continues it.",
        ("f4x_core.processes", "f4x_core.parallel", "addon.jobs.runner", "addon.operators.tasks"),
    ),
    Trouble(
        "F4X-BLENDER",
        "Blender cannot show, render or keep this: an object, a file or a mode is not what the button needs.",
        "Select the scene's root or import the scene again; docs/blender.md says what every part is.",
        ("addon", "scripts", "tools"),
    ),
    Trouble(
        "F4X-REPORT",
        "A study cannot run: a data set, a peer or an earlier result is missing.",
        "docs/report.md says what each needs; --only NAME leaves others out.",
        ("f4x_core.cli.laboratory",),
    ),
    Trouble(
        "F4X-DISK",
        "The disk is full, or a file or folder may not be written or read.",
        "Make room, choose another place, or change who may write there; nothing half-written is left.",
    ),
    Trouble(
        "F4X-MEMORY",
        "The memory does not suffice.",
        "Use fewer frames (--frames) or smaller ones (--width), or give --memory.",
    ),
    Trouble(UNKNOWN, "None of the other families.", "Please report it with what `f4x doctor --report` prints."),
)
_BY_CODE = {trouble.code: trouble for trouble in TROUBLES}
_BY_MODULE = {module: trouble.code for trouble in TROUBLES for module in trouble.modules}
_HAS_CODE = re.compile(r"\[F4X-[A-Z]+\]")
STOPS = (".", "?", "!", '."', '?"', '!"', ".)", "…")
"""Ends of complete sentences."""
EXPECTED = (F4xError, OSError, MemoryError)
"""Errors that an input or a machine can cause; people see one sentence. Any other exception is a mistake of the program."""
CURES = {
    **dict.fromkeys((errno.ENOSPC, errno.EDQUOT, errno.EFBIG), "make room there or choose another place"),
    **dict.fromkeys((errno.EACCES, errno.EPERM, errno.EROFS), "choose another place, or change who may write there"),
}
"""Remedies for errors of the disk, by their number."""


def code_of_module(name: str) -> str:
    """Return the code of what a module raises; `name` may have Blender's prefix of an extension before it."""
    parts = name.split(".")
    tops = [index for index, part in enumerate(parts) if part in TOPS]
    parts = parts[tops[-1] :] if tops else []
    known = (".".join(parts[:count]) for count in range(len(parts), 0, -1))
    return next((_BY_MODULE[prefix] for prefix in known if prefix in _BY_MODULE), UNKNOWN)


def code_of(error: BaseException) -> str:
    """Return the code of a raised exception: of the first F4xError in its chain, by the innermost module with a family."""
    while isinstance(error.__cause__, F4xError):
        error = error.__cause__
    if isinstance(error, MemoryError):
        return "F4X-MEMORY"
    if isinstance(error, FileNotFoundError):
        return "F4X-OPTION"
    if isinstance(error, OSError) or (isinstance(error.__cause__, OSError) and error.__cause__.errno in CURES):
        return "F4X-DISK"
    frames = [frame for frame, _ in traceback.walk_tb(error.__traceback__)]
    codes = (code_of_module(_module_of(frame)) for frame in reversed(frames))
    return next((code for code in codes if code != UNKNOWN), UNKNOWN)


def _module_of(frame: FrameType) -> str:
    """Return the dotted name of the module that runs in `frame`; a script has that of its folder before its own."""
    name, file = str(frame.f_globals.get("__name__")), Path(frame.f_code.co_filename)
    return name if "." in name else f"{file.parent.name}.{file.stem}"


def sentence_of(error: BaseException, place: object = "the disk") -> str:
    """Return the sentence of an expected error for people; `place` is where the disk failed if the error does not name it."""
    if isinstance(error, FileNotFoundError):
        return f"{error.filename or place}: there is no such file or folder; check the path."
    if isinstance(error, OSError) and error.errno == errno.ENAMETOOLONG:
        return f"{error.filename or place}: the name is too long for this disk; give a shorter one."
    if isinstance(error, OSError):
        parts = [str(error.strerror or error), "nothing half-written was left behind", CURES.get(error.errno or 0)]
        return f"{error.filename or place}: {'; '.join(filter(None, parts))}."
    if isinstance(error, MemoryError):
        amount = f" ({error})" if str(error) else ""
        return f"The memory does not suffice{amount}; use fewer frames or smaller ones."
    return str(error)


def with_code(error: BaseException, place: object = "the disk") -> str:
    """Return the sentence of an expected error with the code behind it, unless another process put one there."""
    return coded(sentence_of(error, place), code_of(error))


def coded(sentence: str, code: str) -> str:
    """Return the sentence, ended by a full stop, with the code behind it, unless it has one."""
    if _HAS_CODE.search(sentence):
        return sentence
    return f"{sentence}{'' if sentence.endswith(STOPS) else '.'} [{code}]"


def explain(code: str) -> str:
    """Return cause and cure of a code, as `f4x doctor CODE` prints them.

    Raises:
        F4xError: there is no such code.
    """
    trouble = _BY_CODE.get(code.strip("[]").upper())
    if trouble is None:
        raise F4xError(f"There is no code {code!r}; known: {', '.join(_BY_CODE)}.")
    return f"{trouble.code}: {trouble.cause}\nWhat helps: {trouble.cure}"
