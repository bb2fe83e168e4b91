"""The tools of an agent: one method per tool. Selections and proposals are kept between calls. No protocol is used here.

Nothing here calls a server: the grammar parses sentences and questions are answered by computing, so no text and no image
leaves the machine. The docstrings and signatures of the tools are what agents read; a record among the parameters, such as
`Look`, stands for its fields.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Annotated, Any, Literal, NamedTuple, TypeVar, get_args

import numpy as np
from pydantic import Field

from ..app import asking, selecting
from ..app.asking import AskOptions
from ..app.editing import EditRequest, propose_edit
from ..app.exporting import ExportOptions, export_scene
from ..app.selecting import Wanted
from ..clip.images import as_bytes
from ..edit import plan
from ..edit.apply import open_scene
from ..edit.description import describe
from ..edit.operations import Operation, read_operation
from ..edit.plan import MAX_CANDIDATES
from ..edit.plan_lines import plan_lines, sizes
from ..edit.records import read_record
from ..edit.resolve import EditorState, Resolver, rows_of
from ..edit.selects import All, Ids, SelectKind
from ..edit.stack import Edit, EditStack, of, read_stack
from ..edit.uncovered import takes_away, uncovered
from ..errors import F4xError
from ..files import replace_file
from ..geometry import trajectory
from ..geometry.camera import CameraPath
from ..geometry.trajectory import View
from ..language.refusal import Doubt
from ..progress import Progress, silent
from ..query.knowledge import known_words
from ..query.labels import encode_labels
from ..query.marks import Box, Point
from ..query.matte import matte_image
from ..query.pixels import coverage_image, heat_map
from ..query.score import THRESHOLD
from ..query.selection import Selection
from ..scene import Scene, updating
from ..scene.formats import FORMATS
from ..scene.view import render
from ..scene.visualise import colour_depth, colour_motion, depth_range, labelled_grid
from .folder import SceneFolder
from .tool_result import ToolResult, encode_png, plain

MAX_SIDE, DEFAULT_SIDE = 1024, 512
"""Maximum and default length in pixels of the longer side of an image; models use no larger ones."""
KEPT_SCENES, KEPT_SELECTIONS, KEPT_PROPOSALS = 2, 16, 16
"""Maximum numbers that are kept in memory; then the oldest is dropped, since each takes memory for every Gaussian."""
MAX_OPERATIONS = 50
"""Maximum number of operations in one proposal."""
MAX_EXPORT_BYTES = 2 << 30
"""Maximum estimated size of an export, so that an agent cannot fill the disk."""
FLOATS_PER_GAUSSIAN = 14
"""Values of four bytes per Gaussian in a PLY without SH coefficients: centre, normal, opacity, scale, rotation."""
MIN_CHANGE = 2
"""A pixel has changed if it differs by more than this (of 255); a difference of one is rounding."""
MIN_COVERAGE = 0.5
"""A pixel shows the selection if more than this fraction of its blend weight comes from it."""
SIDES = ("right", "down", "left", "up")
"""Directions of the four views of `trajectory.orbit`, in its order."""


def record_signatures(family: Any) -> str:
    """Return the tags of the record types in a union, each with its field names."""
    return ", ".join(f"{kind.TAG}({', '.join(entry.name for entry in fields(kind))})" for kind in get_args(family))


Number = Annotated[float, Field(allow_inf_nan=False)]
SceneName = Annotated[str, Field(description="scene file in the folder; empty: the only one")]
Frame = Annotated[Number, Field(description="clip frame whose camera looks, from 0; may lie between two")]
Time = Annotated[Number | None, Field(description="clip frame that is shown; null: the same as frame")]
Side = Annotated[Literal["", "right", "down", "left", "up"], Field(description="look from this side of that camera")]
Degrees = Annotated[Number, Field(gt=0, lt=90, description="how far to that side, about the middle of the scene")]
Width = Annotated[int, Field(ge=0, le=MAX_SIDE, description="pixels; 0: the clip's, 512 at most")]
SelectionName = Annotated[str, Field(description="name of a selection that query made")]
ProposalName = Annotated[str, Field(description="name that propose_edit gave")]
Which = Annotated[int, Field(ge=-1, description="index of a candidate; -1: the best")]
Count = Annotated[int, Field(ge=1, description="so many edits")]
Sentence = Annotated[str, Field(max_length=2000)]
Words = Annotated[list[str] | None, Field(max_length=50)]

SELECTS = (
    'for example {"by": "moving"} or {"by": "not", "of": {"by": "text", "labels": ["dog"]}}; '
    + record_signatures(SelectKind)
)
OPERATIONS = 'for example [{"op": "recolour", "select": {"by": "moving"}, "rgb": [1, 0, 0]}]; ' + record_signatures(
    Operation
)

Key = TypeVar("Key")
Value = TypeVar("Value")


@dataclass(frozen=True)
class Viewpoint:
    """Camera and clip time of a picture."""

    frame: Frame = 0.0
    time: Time = None
    side: Side = ""
    degrees: Degrees = 8.0


@dataclass(frozen=True)
class Look(Viewpoint):
    """A viewpoint along any camera path, and the width of the picture."""

    camera_path: Annotated[str, Field(description="camera path file in the folder; empty: the clip's")] = ""
    width: Width = 0


@dataclass(frozen=True)
class Search:
    """Description of what to find: exactly one of text, point, box and select."""

    text: Annotated[Words, Field(description="words for it; info lists those that are known")] = None
    negatives: Annotated[Words, Field(description="words that text is weighed against; null: the usual")] = None
    point: Annotated[tuple[Number, Number] | None, Field(description="x, y on it in pixels of the clip")] = None
    box: Annotated[
        tuple[Number, Number, Number, Number] | None, Field(description="left, top, right, bottom in such pixels")
    ] = None
    select: Annotated[dict[str, Any] | None, Field(description=SELECTS)] = None
    part: Annotated[bool, Field(description="of the person at point the part of the body alone")] = False

    def __post_init__(self) -> None:
        """Refuse none and several."""
        given = {"text": self.text, "point": self.point, "box": self.box, "select": self.select}
        kinds = [kind for kind, value in given.items() if value]
        if len(kinds) != 1:
            raise F4xError(f"Give exactly one of {', '.join(given)}; got {', '.join(kinds) or 'none'}.")

    def wanted(self, moment: int, threshold: float) -> Wanted:
        """Return the request for the words, point or box in clip frame `moment`."""
        marks: tuple[Point | Box, ...] = ()
        if self.point:
            marks = (Point(moment, True, self.point),)
        elif self.box:
            marks = (Box(moment, True, self.box),)
        weighed = None if self.negatives is None else tuple(self.negatives)
        return Wanted(tuple(self.text or ()), weighed, marks, self.part and bool(self.point), threshold)


class StoredSelection(NamedTuple):
    """A selection that `query` made, with the scene file that it belongs to."""

    path: Path
    selection: Selection


class StoredProposal(NamedTuple):
    """A proposal for a scene file that had these `edits` when it was made."""

    path: Path
    edits: tuple[Edit, ...]
    proposal: plan.Proposal


class Session:
    """The scenes of one folder, with the selections and proposals that an agent made. Not thread-safe."""

    READING = ("info", "render_view", "query", "ask", "propose_edit", "preview", "history")
    """Tools that write nothing, except `render_view` with its argument `file`."""
    WRITING = ("apply_edit", "undo", "redo", "export")
    """Tools that write."""

    def __init__(self, folder: SceneFolder, read_only: bool = False, backend: str = "auto"):
        """Open a session without scenes; `backend` renders. The caller may set `progress` before a call."""
        self.folder, self.read_only, self.backend = folder, read_only, backend
        self.progress: Progress = silent
        self._scenes: dict[tuple[Path, int, int, int], Scene] = {}
        self._found: dict[str, StoredSelection] = {}
        self._proposed: dict[str, StoredProposal] = {}
        self._made = 0

    def info(self, scene: SceneName = "") -> ToolResult:
        """List the scenes of the folder; of one scene tell its clip, Gaussians, words and named selections."""
        listed = self.folder.scenes()
        if not scene and len(listed) != 1:
            return ToolResult({"scenes": listed})
        path, opened = self._open(scene)
        info = opened.info()
        counts = ("frames", "fps", "size", "static", "dynamic", "nodes", "edits", "edited")
        named = [name for edit in of(opened).edits if (name := getattr(edit.operation, "name", ""))]
        return ToolResult(
            {"scenes": listed, "scene": self.folder.name(path)} | {name: info[name] for name in counts if name in info},
            {"name": opened.name, "labels": known_words(opened), "heads": [*info["heads"]], "named": named},
        )

    def render_view(
        self,
        scene: SceneName = "",
        look: Look = Look(),
        channel: Literal["rgb", "depth", "motion"] = "rgb",
        selection: Annotated[str, Field(description="selection to show in colours over a grey picture")] = "",
        file: Annotated[str, Field(description="also write it to this new .png in the folder")] = "",
    ) -> ToolResult:
        """Draw the scene with its edits, from a camera at a moment; depth near is red, motion hue is direction."""
        path, opened = self._open(scene)
        view = self._view(opened, look)
        data: dict[str, Any] = {"frame": look.frame, "time": view.time, "size": [view.camera.width, view.camera.height]}
        maps = render(opened, *view, (channel,) if channel != "rgb" and not selection else ("rgb",), self.backend)
        if selection:
            if channel != "rgb":
                raise F4xError("A selection is shown over the picture itself; leave channel out.")
            weights = matte_image(opened, self._selection(path, opened, selection), *view, self.backend)
            image = heat_map(maps["rgb"], weights)
        elif channel == "depth":
            data["near"], data["far"] = depth_range([maps["depth"]])
            image = colour_depth(maps["depth"], data["near"], data["far"])
        elif channel == "motion":
            data["full_colour_pixels_per_frame"] = float(np.linalg.norm(maps["motion"], axis=-1).max())
            image = colour_motion(maps["motion"], data["full_colour_pixels_per_frame"])
        else:
            image = as_bytes(maps["rgb"])
        png = encode_png(image)
        if file:
            if not file.lower().endswith(".png"):
                raise F4xError(f"{file!r} is no PNG; end it in .png.")
            target = self._output(file)
            target.parent.mkdir(parents=True, exist_ok=True)
            with replace_file(target) as out:
                out.write(png)
            data["file"] = file
        return ToolResult(data, png=png)

    def query(
        self,
        search: Search,
        scene: SceneName = "",
        frame: Annotated[int, Field(description="clip frame of point or box, and of `seen`")] = 0,
        threshold: Annotated[Number, Field(ge=0, le=1, description="least probability")] = THRESHOLD,
        name: Annotated[str, Field(max_length=40, description="what to call the selection")] = "",
    ) -> ToolResult:
        """Find something by exactly one of text, point, box and select; says how much it is and where, and keeps it."""
        path, opened = self._open(scene)
        view = self._view(opened, Look(frame))
        if search.select is None:
            wanted = search.wanted(opened.cameras.frame_at(frame), threshold)
            found = selecting.select(opened, wanted, self.backend, self.progress).selection
        else:
            resolver = Resolver(EditorState(frame=frame), encode_labels)
            resolved = resolver.select(opened, read_record(SelectKind, search.select, "select"))
            scores = np.isin(np.arange(len(opened.ids)), rows_of(opened, resolved))
            found = Selection(opened.ids, scores.astype(float), np.zeros(len(scores), bool))
        rows = rows_of(opened, Ids.of(found.chosen_ids))
        inside = coverage_image(opened, found, *view, self.backend) > MIN_COVERAGE
        name = plain(name) or self._name("selection")
        _keep(self._found, name, StoredSelection(path, found), KEPT_SELECTIONS)
        return ToolResult(
            {
                "selection": name,
                "gaussians": len(rows),
                "of": len(rows_of(opened, All())),
                "moving": int(opened.moving[rows].sum()),
                "seen": {"frame": frame, "share_of_picture": float(inside.mean()), "box": _box_of(inside, opened)},
            }
            | ({"remarks": [*found.remarks]} if found.remarks else {})
        )

    def ask(
        self,
        question: Sentence,
        scene: SceneName = "",
        selection: Annotated[SelectionName, Field(description="what 'it' in the question means")] = "",
    ) -> ToolResult:
        """Ask what is there, where and when, what moves, how far and how fast; answered by computing, and it says so."""
        path, opened = self._open(scene)
        selected = self._selection(path, opened, selection) if selection else None
        found = asking.ask(opened, question, AskOptions(selected), self.backend, self.progress)
        return ToolResult({"answered_by": found.answered_by}, {"answer": found.text, "evidence": found.evidence})

    def propose_edit(
        self,
        scene: SceneName = "",
        sentence: Annotated[Sentence, Field(description='for example "make the dog red from second 2"')] = "",
        operations: Annotated[list[dict[str, Any]] | None, Field(description=OPERATIONS)] = None,
        frame: Frame = 0.0,
        selection: Annotated[SelectionName, Field(description='what \'it\' and {"by": "current"} mean')] = "",
        candidates: Annotated[int, Field(ge=1, le=MAX_CANDIDATES, description="readings of sentence to compare")] = 1,
    ) -> ToolResult:
        """Propose edits, by a sentence or a list of operations. Writes nothing: look at preview, then call apply_edit."""
        if bool(sentence.strip()) == bool(operations):
            raise F4xError("Give either a sentence or operations.")
        path, opened = self._open(scene)
        context = EditorState(self._selection(path, opened, selection) if selection else None, frame)
        given = _read_operations(operations or [])
        request = EditRequest(sentence, given, state=context, candidates=candidates, backend=self.backend)
        try:
            proposal = propose_edit(opened, request, self.progress)
        except Doubt as doubt:
            raise F4xError(f"{doubt} If that is meant, propose '{doubt.instead}'.") from doubt
        name = self._name("proposal")
        _keep(self._proposed, name, StoredProposal(path, of(opened).edits, proposal), KEPT_PROPOSALS)
        rows = [self._candidate_summary(opened, index, one) for index, one in enumerate(proposal.candidates)]
        data = {"proposal": name, "best": proposal.best, "candidates": rows, "understood_by": proposal.understood_by}
        return ToolResult(data | {"judged_by": proposal.judged_by, "notes": list(proposal.notes)})

    def preview(self, proposal: ProposalName, candidate: Which = -1, viewpoint: Viewpoint = Viewpoint()) -> ToolResult:
        """Draw the scene before and after a candidate. Writes nothing."""
        path, opened, chosen = self._candidate(proposal, candidate)
        view = self._view(opened, Look(**vars(viewpoint)))
        scenes = (opened, plan.preview(opened, chosen))
        images = [as_bytes(render(each, *view, ("rgb",), self.backend)["rgb"]) for each in scenes]
        sheet = labelled_grid([images], [f"{view.time:g}"], ["before", "after"])
        changed = float((np.abs(images[1].astype(int) - images[0]) > MIN_CHANGE).any(-1).mean())
        return ToolResult({"scene": self.folder.name(path), "changed_share_of_picture": changed}, png=encode_png(sheet))

    def history(self, scene: SceneName = "") -> ToolResult:
        """List the edits of a scene, and those that redo would bring back, the next one last."""
        stack = read_stack(self.folder.scene(scene))
        rows = {"edits": _edit_rows(stack.edits), "undone": _edit_rows(stack.undone)}
        return ToolResult({name: len(edits) for name, edits in rows.items()}, rows)

    def apply_edit(self, proposal: ProposalName, candidate: Which = -1) -> ToolResult:
        """Write a candidate of a proposal into the scene's stack of edits; undo takes it back."""
        with updating(self._candidate(proposal, candidate)[0]):
            path, opened, chosen = self._candidate(proposal, candidate)  # again: another may have written meanwhile
            stack = plan.apply(path, chosen)
        new = [edit.id for edit in stack.edits[len(of(opened)) :]]
        return ToolResult({"scene": self.folder.name(path), "edits": len(stack), "new": new})

    def undo(self, scene: SceneName = "", count: Count = 1) -> ToolResult:
        """Take back the last edits of a scene."""
        return _stack_counts(plan.undo(self.folder.scene(scene), count))

    def redo(self, scene: SceneName = "", count: Count = 1) -> ToolResult:
        """Bring back the edits that were undone last."""
        return _stack_counts(plan.redo(self.folder.scene(scene), count))

    def export(
        self,
        output: Annotated[str, Field(description="new FILE.ply, .splat, .glb with time, FILE.usda, or a folder")],
        scene: SceneName = "",
        format: Annotated[str, Field(description=f"of {', '.join(FORMATS)}; empty: by the ending of output")] = "",
        time: Annotated[Number | None, Field(description="one clip frame; null: several")] = None,
        frames: Annotated[str, Field(description="first:end:step of several; empty: all")] = "",
    ) -> ToolResult:
        """Write a scene with its edits for other programs: one moment, a folder of moments, or an animated file."""
        path, opened = self._open(scene)
        target = self._output(output)
        if time is not None:
            _require_times(opened.cameras, [time])
        options = ExportOptions(format or None, time, frames or None)
        options.format_of(output)
        times = options.times_of(opened, path)
        numbers = FLOATS_PER_GAUSSIAN + 3 * (opened.sh_degree + 1) ** 2
        if 4 * numbers * len(opened.ids) * len(times) > MAX_EXPORT_BYTES:
            raise F4xError(f"That would be more than {MAX_EXPORT_BYTES >> 30} GiB; export fewer frames.")
        target.parent.mkdir(parents=True, exist_ok=True)
        done = export_scene(opened, path, target, options, self.progress)
        written = {"output": output, "format": done.format, "moments": done.moments, "files": len(done.files)}
        return ToolResult({**written, **({"notes": list(done.notes)} if done.notes else {})})

    def _open(self, name: str) -> tuple[Path, Scene]:
        """Return (path, scene with its edits); the scene stays in memory until its file changes."""
        path = self.folder.scene(name)
        state = path.stat()
        key = (path, state.st_ino, state.st_mtime_ns, state.st_size)
        if key not in self._scenes:
            self._scenes = {known: scene for known, scene in self._scenes.items() if known[0] != path}
            _keep(self._scenes, key, open_scene(path), KEPT_SCENES)
        return path, self._scenes[key]

    def _view(self, scene: Scene, look: Look) -> View:
        cameras = CameraPath.read(self.folder.file(look.camera_path)) if look.camera_path else scene.cameras
        time = look.frame if look.time is None else look.time
        _require_times(cameras, [look.frame])
        _require_times(scene.cameras, [time])
        camera = cameras.at(look.frame)
        if look.side:
            aside = trajectory.orbit(cameras, time, look.degrees, around=look.frame, count=len(SIDES))
            camera = aside[SIDES.index(look.side)].camera
        longer_side = max(camera.width, camera.height)
        scale = look.width / camera.width if look.width else min(1.0, DEFAULT_SIDE / longer_side)
        scale = min(scale, MAX_SIDE / longer_side)
        size = [max(1, round(scale * side)) for side in (camera.width, camera.height)]
        return View(camera.resized(*size), float(time))

    def _selection(self, path: Path, scene: Scene, name: str) -> Selection:
        found = self._found.get(name)
        if found is None or found.path != path:
            known = [name for name, other in self._found.items() if other.path == path]
            raise F4xError(f"There is no selection {name!r} in this scene; known: {', '.join(known) or 'none'}.")
        return found.selection.for_ids(scene.ids)

    def _candidate(self, name: str, index: int) -> tuple[Path, Scene, plan.Candidate]:
        """Return (path, scene, candidate) of a proposal. F4xError if the scene was edited since: its ids may have changed."""
        if name not in self._proposed:
            raise F4xError(f"There is no proposal {name!r}; known: {', '.join(self._proposed) or 'none'}.")
        path, edits, proposal = self._proposed[name]
        scene = self._open(self.folder.name(path))[1]
        if of(scene).edits != edits:
            raise F4xError(f"The scene was edited after {name!r} was made; propose the edit again.")
        if index >= len(proposal.candidates):
            raise F4xError(f"{name!r} has {len(proposal.candidates)} candidates; give an index from 0, or -1.")
        return path, scene, proposal.chosen if index < 0 else proposal.candidates[index]

    def _candidate_summary(self, scene: Scene, index: int, candidate: plan.Candidate) -> dict[str, Any]:
        """Return a candidate as JSON, with counts in place of lists of ids."""
        shown = plan.preview(scene, candidate)
        chosen, new = sizes(shown), of(shown).edits[len(of(scene)) :]
        does = [
            {"does": line, "gaussians": sum(chosen.get(edit.id, ())), **_with_id_counts(edit.operation.to_json())}
            for edit, line in zip(new, plan_lines(scene, [edit.operation for edit in new]), strict=True)
        ]
        shows = str(uncovered(shown) or "") if takes_away(candidate.operations) else ""
        return {
            "index": index,
            "why": candidate.why or "as said",
            "scores": dict(candidate.scores),
            "operations": does,
            **({"uncovers": shows} if shows else {}),
        }

    def _output(self, name: str) -> Path:
        if self.read_only:
            raise F4xError("This server only reads; start it without --read-only to write files.")
        return self.folder.output(name)

    def _name(self, kind: str) -> str:
        self._made += 1
        return f"{kind} {self._made}"


def _keep(kept: dict[Key, Value], key: Key, value: Value, max_entries: int) -> None:
    """Store `value` as the newest entry and drop the oldest one if there are more than `max_entries`."""
    kept.pop(key, None)
    kept[key] = value
    if len(kept) > max_entries:
        del kept[next(iter(kept))]


def _read_operations(entries: list[dict[str, Any]]) -> tuple[Operation, ...]:
    """Read operations from JSON objects."""
    if len(entries) > MAX_OPERATIONS:
        raise F4xError(f"{len(entries)} operations are given; give at most {MAX_OPERATIONS} at once.")
    return tuple(read_operation(entry, f"operation {number}") for number, entry in enumerate(entries, 1))


def _with_id_counts(value: Any) -> Any:
    """Return the JSON of an operation with the number of ids in place of the packed ids."""
    if isinstance(value, dict):
        if value.get("by") == Ids.TAG:
            return {
                "by": Ids.TAG,
                "count": len(read_record(Ids, {k: v for k, v in value.items() if k != "by"}, "ids").array),
            }
        return {name: _with_id_counts(inner) for name, inner in value.items()}
    return [_with_id_counts(inner) for inner in value] if isinstance(value, list) else value


def _edit_rows(edits: tuple[Edit, ...]) -> list[dict[str, Any]]:
    return [
        {"id": edit.id, "does": describe(edit.operation), "said": edit.sentence, "enabled": edit.enabled}
        for edit in edits
    ]


def _stack_counts(stack: EditStack) -> ToolResult:
    return ToolResult({"edits": len(stack), "undone": len(stack.undone)})


def _require_times(cameras: CameraPath, times: Sequence[float]) -> None:
    first, last = cameras.times[[0, -1]]
    for time in times:
        if not first <= time <= last:
            raise F4xError(f"Frame {time:g} lies outside the clip, whose frames are {first:g} to {last:g}.")


def _box_of(inside: np.ndarray, scene: Scene) -> list[float] | None:
    """Return left, top, right, bottom, in pixels of the clip, of the true pixels of `inside (H,W)`; None if there are none."""
    rows, columns = np.nonzero(inside)
    if not len(rows):
        return None
    scale = scene.cameras.width / inside.shape[1]
    return [round(scale * float(edge), 1) for edge in (columns.min(), rows.min(), columns.max() + 1, rows.max() + 1)]
