"""The tasks of a row: ordinary `f4x` commands, their inputs from other tasks, and a key that shows whether a task is done."""

from __future__ import annotations

import hashlib
import json
import os
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import PurePosixPath

from ..clip.read import ALPHA, LAYOUT
from ..clip.stream import reported_frame_count
from ..errors import F4xError
from ..files import user_path
from ..scene.formats import FORMATS
from ..versions import VERSION
from ..windows.plan import LONG
from .manifest import Row
from .storage import URL

KINDS = ("priors", "fit", "distill", "query", "edit", "render", "export")
"""Kinds of task, in the order of the graph; a kind is the first word of a stage."""
GIGABYTE = 1 << 30
MEMORY = {"priors": 2, "fit": 2, "distill": 3}
"""Gigabytes that a task requests from a cluster: twice what 90 frames of 480x270 needed. Other kinds request one gigabyte,
since they render one image at a time."""
RESUME_FILES = {
    "priors": ("priors/*",),
    "fit": ("checkpoints/*", "**/windows/*/*", "**/windows/*/checkpoints/*"),
    "distill": ("features/*/*", "features/.*/*"),
}
"""Kind -> patterns of the files from which a stopped task resumes."""
CLIP = "{clip}"
"""Placeholder for the clip in a command, because a clip behind a URL is downloaded first."""


@dataclass(frozen=True)
class Task:
    """Task of a row. Its commands run in a folder that holds only its inputs; the files that they add are its result."""

    row: str
    """Name of the row."""
    stage: str
    """Unique name within the row: the kind, then details, for example `render orbit 2/4`."""
    commands: tuple[tuple[str, ...], ...]
    """Arguments of `f4x` for each command, in order."""
    clip: str
    """Path or URL."""
    inputs: tuple[tuple[str, str], ...]
    """(stage, file or folder) of each result that it reads, from tasks of the same row."""
    key: str
    """Hash of everything that the result depends on."""
    threads: int
    """Cores."""
    memory: int
    """Bytes."""

    @property
    def kind(self) -> str:
        """First word of the stage."""
        return self.stage.split(" ")[0]

    @property
    def slug(self) -> str:
        """The stage as a file name."""
        return slug(self.stage)

    @property
    def resume_files(self) -> tuple[str, ...]:
        """Patterns of the files from which it can resume."""
        return RESUME_FILES.get(self.kind, ())


def tasks_of(row: Row, digest: Callable[[str], str]) -> tuple[Task, ...]:
    """The tasks of a row, each after the tasks whose results it reads.

    `digest(path)` returns a content hash. A task's key covers the hashes of all files that it reads, so the manifest alone
    decides whether a task is done.
    """
    tasks: dict[str, Task] = {}
    places: dict[str, str] = {}

    def place(folder: str, words: str) -> str:
        """A folder name made of `words`; F4xError if another task of the row already uses it."""
        name = f"{folder}/{slug(words)}"
        if places.setdefault(name.lower(), words) != words:
            raise F4xError(
                f"{row.name}: '{places[name.lower()]}' and '{words}' would both write {name}; rename one of them."
            )
        return name

    def add(stage: str, *commands: Sequence[str], inputs: Mapping[str, str], reads: Sequence[str] = ()) -> None:
        before = {name: tasks[name].key for name in inputs}
        state = [VERSION, commands, before, inputs, [digest(path) for path in reads]]
        kind = stage.split(" ")[0]
        tasks[stage] = Task(
            row=row.name,
            stage=stage,
            commands=tuple(tuple(command) for command in commands),
            clip=row.clip if URL in row.clip else os.path.abspath(os.path.expanduser(row.clip)),
            inputs=tuple(inputs.items()),
            key=hashlib.sha256(json.dumps(state).encode()).hexdigest(),
            threads=row.threads,
            memory=MEMORY.get(kind, 1) * GIGABYTE,
        )

    masks = _absolute(row.masks) if row.masks not in (None, LAYOUT, ALPHA) else row.masks
    prior = [entry.partition("=") for entry in row.prior]
    mine = [*([row.masks] if row.masks not in (None, LAYOUT, ALPHA) else []), *(path for _, _, path in prior)]
    frames = _options(frames=row.frames)
    drawn, costs = _options(backend=row.backend), _options(seed=row.seed, threads=row.threads)
    clip = [*frames, *_options(width=row.width, hold_out=row.hold_out, masks=masks)]
    fit = [*_options(profile=row.profile, provider=row.provider, cameras=row.cameras, depth=row.depth), *costs, *drawn]
    fit += [word for name, _, path in prior for word in ("--prior", f"{name}={_absolute(path)}")]
    fit += [word for setting in row.settings for word in ("--set", setting)]
    sources = [row.clip, *mine]
    windows = _options(window=row.window, overlap=row.overlap)
    in_windows = fitted_in_windows(row)
    if not in_windows:
        add("priors", ["priors", CLIP, "-o", ".", *clip, *fit], inputs={}, reads=sources)
    inputs = {} if in_windows else {"priors": "priors/"}
    add("fit", ["fit", CLIP, "-o", ".", "--resume", *clip, *fit, *windows], inputs=inputs, reads=sources)
    scene, source = "scene.f4x", "fit"
    if row.features:
        labels = _options(vocabulary=",".join(row.vocabulary) or None)
        head = ["distill", scene, "--teacher", ",".join(row.features), "--clip", CLIP, *frames]
        add(
            "distill",
            [*head, *labels, "--features", "features", "-o", "distilled.f4x", *costs, *drawn],
            inputs={source: scene},
            reads=[row.clip],
        )
        scene, source = "distilled.f4x", "distill"
    for words in row.queries:
        asked = ["query", scene, "--text", words, "--if-any", "-o", place("query", words), *drawn]
        add(f"query {words}", asked, inputs={source: scene})
    if row.edits:
        commands: list[list[str]] = []
        target = scene
        for edit in row.edits:
            instruction = ["--ops", _absolute(edit)] if edit.endswith(".json") else ["--say", edit]
            commands.append(["edit", target, *instruction, *drawn, *([] if commands else ["-o", "edited.f4x"])])
            target = "edited.f4x"
        add("edit", *commands, inputs={source: scene}, reads=[edit for edit in row.edits if edit.endswith(".json")])
        scene, source = "edited.f4x", "edit"
    for path in row.paths:
        own = path.endswith(".json")
        target = place("render", path if not own else PurePosixPath(path).stem)
        along = ["--path", _absolute(path) if own else path, "--channels", ",".join(row.channels)]
        for part in range(1, row.parts + 1):
            part_of = f"{part}/{row.parts}"
            command = ["render", scene, "-o", target, *along, "--part", part_of, *drawn]
            add(f"render {path} {part_of}", command, inputs={source: scene}, reads=[path] if own else [])
    for name in row.exports:
        whole = FORMATS[name].write_clip is not None
        target = f"export/{row.name}-{name}{FORMATS[name].suffixes[0]}" if whole else f"export/{name}"
        add(f"export {name}", ["export", scene, "-o", target, "--format", name], inputs={source: scene})
    return tuple(tasks.values())


def fitted_in_windows(row: Row) -> bool:
    """Return True if `f4x fit` splits the clip into windows, each of which computes its own priors."""
    return declared_frames(row)[0] > LONG if row.window is None else row.window > 0


def declared_frames(row: Row) -> tuple[int, str]:
    """(number of frames that the row uses, why the clip cannot be read). Uses the file header only; 0 frames if unknown."""
    if URL not in row.clip and user_path(row.clip).exists():
        try:
            return reported_frame_count(row.clip, row.frames), ""
        except F4xError as error:
            return 0, str(error)
    return 0, ""


def _options(**options: object) -> list[str]:
    return [
        word
        for name, value in options.items()
        if value is not None
        for word in (f"--{name.replace('_', '-')}", str(value))
    ]


def _absolute(path: str) -> str:
    return path if URL in path else str(user_path(path).absolute())


def slug(text: str) -> str:
    """A text as a file name."""
    return re.sub(r"[^\w.-]+", "_", text)
