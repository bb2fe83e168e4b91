"""The tasks of a row: ordinary `f4x` commands, their inputs from other tasks, and a key that shows whether a task is done."""

from __future__ import annotations

import hashlib
import json
import os
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
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
    """Return the tasks of a row, each after the tasks whose results it reads.

    `digest(path)` returns a content hash. A task's key covers the hashes of all files that it reads, so the manifest alone
    decides whether a task is done.
    """
    chain = _Chain(row, digest)
    chain.fit()
    if row.features:
        chain.distil()
    chain.query()
    if row.edits:
        chain.edit()
    chain.render()
    chain.export()
    return tuple(chain.tasks.values())


@dataclass
class _Chain:
    """The tasks of a row while they are put one behind the other."""

    row: Row
    digest: Callable[[str], str]
    tasks: dict[str, Task] = field(default_factory=dict)
    """Stage -> its task."""
    places: dict[str, str] = field(default_factory=dict)
    """Lower-case name of a folder -> the words that it was made of."""
    scene: str = "scene.f4x"
    """File of the scene that the next task reads."""
    source: str = "fit"
    """Stage that wrote it."""

    def fit(self) -> None:
        """Add priors, where the clip is fitted at once, and the fit."""
        row = self.row
        masks = _absolute(row.masks) if row.masks not in (None, LAYOUT, ALPHA) else row.masks
        prior = [entry.partition("=") for entry in row.prior]
        mine = [*([row.masks] if row.masks not in (None, LAYOUT, ALPHA) else []), *(path for _, _, path in prior)]
        clip = [*_options(frames=row.frames), *_options(width=row.width, hold_out=row.hold_out, masks=masks)]
        options = _options(profile=row.profile, provider=row.provider, cameras=row.cameras, depth=row.depth)
        options += [*self._costs(), *self._drawn()]
        options += [word for name, _, path in prior for word in ("--prior", f"{name}={_absolute(path)}")]
        options += [word for setting in row.settings for word in ("--set", setting)]
        sources, inputs = [row.clip, *mine], {}
        if not fitted_in_windows(row):
            self._add("priors", ["priors", CLIP, "-o", ".", *clip, *options], inputs={}, reads=sources)
            inputs = {"priors": "priors/"}
        windows = _options(window=row.window, overlap=row.overlap)
        command = ["fit", CLIP, "-o", ".", "--resume", *clip, *options, *windows]
        self._add("fit", command, inputs=inputs, reads=sources)

    def distil(self) -> None:
        """Add the features of the row's teachers."""
        row, target = self.row, "distilled.f4x"
        head = ["distill", self.scene, "--teacher", ",".join(row.features), "--clip", CLIP]
        options = _options(frames=row.frames, vocabulary=",".join(row.vocabulary) or None)
        command = [*head, *options, "--features", "features", "-o", target, *self._costs(), *self._drawn()]
        self._add("distill", command, inputs={self.source: self.scene}, reads=[row.clip])
        self.scene, self.source = target, "distill"

    def query(self) -> None:
        """Add the row's words, each by itself."""
        for words in self.row.queries:
            target = self._place("query", words)
            command = ["query", self.scene, "--text", words, "--if-any", "-o", target, *self._drawn()]
            self._add(f"query {words}", command, inputs={self.source: self.scene})

    def edit(self) -> None:
        """Add the row's edits, one command after the other."""
        commands: list[list[str]] = []
        target = self.scene
        for edit in self.row.edits:
            instruction = ["--ops", _absolute(edit)] if edit.endswith(".json") else ["--say", edit]
            output = [] if commands else ["-o", "edited.f4x"]
            commands.append(["edit", target, *instruction, *self._drawn(), *output])
            target = "edited.f4x"
        reads = [edit for edit in self.row.edits if edit.endswith(".json")]
        self._add("edit", *commands, inputs={self.source: self.scene}, reads=reads)
        self.scene, self.source = target, "edit"

    def render(self) -> None:
        """Add the parts of each path of a camera."""
        row = self.row
        for path in row.paths:
            own = path.endswith(".json")
            target = self._place("render", path if not own else PurePosixPath(path).stem)
            along = ["--path", _absolute(path) if own else path, "--channels", ",".join(row.channels)]
            for part in range(1, row.parts + 1):
                part_of = f"{part}/{row.parts}"
                command = ["render", self.scene, "-o", target, *along, "--part", part_of, *self._drawn()]
                reads = [path] if own else []
                self._add(f"render {path} {part_of}", command, inputs={self.source: self.scene}, reads=reads)

    def export(self) -> None:
        """Add each format."""
        for name in self.row.exports:
            whole = FORMATS[name].write_clip is not None
            target = f"export/{self.row.name}-{name}{FORMATS[name].suffixes[0]}" if whole else f"export/{name}"
            command = ["export", self.scene, "-o", target, "--format", name]
            self._add(f"export {name}", command, inputs={self.source: self.scene})

    def _drawn(self) -> list[str]:
        return _options(backend=self.row.backend)

    def _costs(self) -> list[str]:
        return _options(seed=self.row.seed, threads=self.row.threads)

    def _place(self, folder: str, words: str) -> str:
        """Return a folder name made of `words`; F4xError if another task of the row already uses it."""
        name = f"{folder}/{slug(words)}"
        first = self.places.setdefault(name.lower(), words)
        if first != words:
            raise F4xError(f"{self.row.name}: '{first}' and '{words}' would both write {name}; rename one of them.")
        return name

    def _add(self, stage: str, *commands: Sequence[str], inputs: Mapping[str, str], reads: Sequence[str] = ()) -> None:
        before = {name: self.tasks[name].key for name in inputs}
        state = [VERSION, commands, before, inputs, [self.digest(path) for path in reads]]
        clip = self.row.clip
        self.tasks[stage] = Task(
            row=self.row.name,
            stage=stage,
            commands=tuple(tuple(command) for command in commands),
            clip=clip if URL in clip else os.path.abspath(os.path.expanduser(clip)),
            inputs=tuple(inputs.items()),
            key=hashlib.sha256(json.dumps(state).encode()).hexdigest(),
            threads=self.row.threads,
            memory=MEMORY.get(stage.split(" ")[0], 1) * GIGABYTE,
        )


def fitted_in_windows(row: Row) -> bool:
    """Return True if `f4x fit` splits the clip into windows, each of which computes its own priors."""
    return declared_frames(row)[0] > LONG if row.window is None else row.window > 0


def declared_frames(row: Row) -> tuple[int, str]:
    """Return (number of frames that the row uses, why the clip cannot be read). Uses the file header only; 0 frames if unknown."""
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
    """Return a text with the characters that file names allow."""
    return re.sub(r"[^\w.-]+", "_", text)
