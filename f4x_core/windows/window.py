"""Fits one window of a long clip in a process of its own.

What a process frees stays with it in part: its heaps fray, and of 640 pixels every window began with 30 to 80 MB more than the
one before. A process that ends gives everything back.
"""

from __future__ import annotations

import gc
import hashlib
import json
import shutil
from collections.abc import Mapping
from dataclasses import asdict, dataclass, replace
from pathlib import Path

import numpy as np

from ..clip import Clip
from ..clip.model import Picture
from ..clip.notes import Remark
from ..errors import F4xError
from ..evaluation.evaluate import Figures, evaluate, without_frames
from ..files import replace_file
from ..fit.config import FitConfig, resolved
from ..fit.pipeline import ClipFit, FitResult
from ..fit.settings import list_settings, set_fields
from ..geometry.camera import CameraPath
from ..geometry.trajectory import original
from ..priors.config import config_hash
from ..processes import START, run_verb
from ..progress import Progress
from ..scene import Scene, read_scene, write_scene
from ..scene.view import seen_from
from .previous_window import PreviousWindow, WindowFit

ROOT = Path(__file__).resolve().parents[2]
"""A child that starts here runs this package, installed or not."""
SCENE, MASKS = "scene.f4x", "masks.npz"
BESIDE = 1.0
"""Pictures on every side that cameras beside the path may see: those of held-out frames, found again, and views aside."""
WORDS = ("name", "fps", "source", "picked")
ARRAYS = ("frames", "times", "held_out", "masks", "depth", "hidden")
"""Fields of a clip in a request: as JSON, and as arrays."""


@dataclass(frozen=True)
class WindowBefore:
    """The window before one, as a file."""

    path: Path
    """Path of its scene file."""
    offset: int
    """Frames from its first to the later window's first."""
    next_node: int
    """First node id that no window has used."""
    next_id: int
    """First id of a Gaussian that no window has used."""
    digest: str
    """Hash of what the later window depends on."""

    @classmethod
    def of(cls, scene: Scene, path: Path, offset: int) -> WindowBefore:
        """Return the window whose `scene` is at `path`."""
        next_node = int(scene.provenance["window"]["next_node"])
        return cls(path, offset, next_node, scene.next_id, PreviousWindow(scene, offset, next_node).digest)

    def read(self) -> PreviousWindow:
        """Return the window with its scene."""
        return PreviousWindow(read_scene(self.path), self.offset, self.next_node)


@dataclass(frozen=True, eq=False)
class WindowRequest:
    """All that the fit of one window needs."""

    clip: Clip
    folder: Path
    """For its scene, its page, and while it is fitted priors and checkpoints."""
    config: FitConfig
    before: WindowBefore | None
    """None: it is the first."""
    resume: bool
    """Go on from the last checkpoint."""

    @property
    def key(self) -> str:
        """Hash of everything that decides what this window becomes."""
        clip, state = self.clip, hashlib.blake2b(digest_size=16)
        hidden = () if clip.hidden is None else (clip.hidden,)
        for array in (clip.frames, clip.held_out, *hidden, *(() if clip.steady else (clip.times,))):
            state.update(np.ascontiguousarray(array).data)  # no copy of all pictures
        return config_hash(resolved(self.config), state.hexdigest(), "" if self.before is None else self.before.digest)

    def finished(self) -> bool:
        """Return True if an earlier run left the window's scene. Raises F4xError where that was another window."""
        path = self.folder / SCENE
        if not (self.resume and path.is_file()):
            return False
        if read_scene(path).provenance.get("window", {}).get("key") != self.key:
            raise F4xError(
                f"{path}: this window was made with other settings or of another clip; fit without --resume, or into another"
                " folder."
            )
        return True

    def write(self) -> Path:
        """Write the request into its folder; returns the file."""
        clip, config, before = self.clip, self.config, self.before
        fields = {
            "clip": {name: getattr(clip, name) for name in WORDS},
            "cameras": None if clip.cameras is None else clip.cameras.to_json(),
            "picture": None if clip.picture is None else asdict(clip.picture),
            "remarks": [asdict(remark) for remark in clip.remarks],
            "config": [f"{setting.name}={setting.text}" for setting in list_settings(config) if setting.settable],
            "files": {**config.priors.files},
            "before": None if before is None else {**asdict(before), "path": str(before.path)},
            "resume": self.resume,
        }
        arrays = {name: getattr(clip, name) for name in ARRAYS if getattr(clip, name) is not None}
        self.folder.mkdir(parents=True, exist_ok=True)
        path = self.folder / "request.npz"
        with replace_file(path) as file:
            np.savez(file, **arrays, fields=json.dumps(fields))
        return path

    @classmethod
    def read(cls, path: Path) -> WindowRequest:
        """Read what `write` wrote."""
        with np.load(path, allow_pickle=False) as file:
            arrays = {name: file[name] for name in ARRAYS if name in file}
            fields = json.loads(str(file["fields"]))
        cameras, before = fields["cameras"], fields["before"]
        cameras = None if cameras is None else CameraPath.from_json(cameras, path)
        remarks = tuple(Remark(**entry) for entry in fields["remarks"])
        picture = Picture.read(fields["picture"])
        clip = Clip(**fields["clip"], **arrays, cameras=cameras, picture=picture, remarks=remarks)
        config = set_fields(FitConfig(), fields["config"])
        config = replace(config, priors=replace(config.priors, files=fields["files"]))
        known = None if before is None else WindowBefore(**{**before, "path": Path(before["path"])})
        return cls(clip, path.parent, config, known, fields["resume"])

    def fit(self, progress: Progress) -> None:
        """Fit and measure the window; leaves its scene and its diagnostics page."""
        clip, folder, backend = self.clip, self.folder, self.config.backend
        result = self._fitted(progress)
        gc.collect()  # the trainer and its actions hold each other
        from ..report.diagnostics import (  # matplotlib: a second that the start need not wait
            render_previews,
            write_diagnostics,
        )

        scene = result.scene
        wanted = Figures(baselines=True, masks=result.moving)
        near = near_path(scene)
        metrics = evaluate(near, clip, wanted, backend, progress)
        images = render_previews(near, metrics, backend)
        found = write_diagnostics(folder / "diagnostics.html", clip, result, metrics, images)
        newest = -1 if scene.scaffold is None else int(scene.scaffold.ids.max(initial=-1))
        next_node = max(newest + 1, 0 if self.before is None else self.before.next_node)
        known = 0 if self.before is None else self.before.next_id
        window = {"key": self.key, "next_node": next_node, "own": int((scene.static.ids >= known).sum())}
        window["findings"] = [asdict(finding) for finding in found]
        provenance = {**scene.provenance, "window": window}
        write_scene(replace(scene, metrics=without_frames(metrics), provenance=provenance), folder / SCENE)
        _write_masks(folder / MASKS, wanted.masks)
        for done in ("priors", "checkpoints"):  # a long clip would fill the disk with them
            shutil.rmtree(folder / done, ignore_errors=True)

    def _fitted(self, progress: Progress) -> FitResult:
        """Return the fit; what it held of the window before is gone when it ends."""
        if self.before is None:
            return ClipFit(self.clip, self.folder, self.config, progress, self.resume, whole=False).run()
        previous = self.before.read()
        return WindowFit(self.clip, self.folder, self.config, progress, self.resume, previous=previous).run()


def _write_masks(path: Path, masks: Mapping[int, np.ndarray] | None) -> None:
    """Keep `masks`, (H,W) bool of moving pixels in the frames of a window, for the colors of the whole clip."""
    masks = masks or {}
    with replace_file(path) as file:
        stack = np.array([*masks.values()]) if masks else np.zeros((0, 0, 0), bool)
        np.savez_compressed(file, frames=np.array([*masks], np.int64), masks=stack)


def masks_of(folder: Path) -> dict[int, np.ndarray] | None:
    """Return frame -> (H,W) bool of moving pixels of the window in `folder`; None where it left no masks."""
    path = folder / MASKS
    if not path.is_file():
        return None
    with np.load(path, allow_pickle=False) as file:
        return dict(zip(file["frames"].tolist(), file["masks"], strict=True))


def near_path(scene: Scene) -> Scene:
    """Return the scene with no more background than is seen along its own cameras or BESIDE them: to measure and to look at."""
    return seen_from(scene, original(scene.cameras), BESIDE)


def fit_here(request: Path, progress: Progress) -> None:
    """Fit the window of a request file in this process."""
    WindowRequest.read(request).fit(progress)


def fit_apart(request: Path, progress: Progress) -> None:
    """Fit the window of a request file in a process of its own; its errors, and what `progress` raises, go through."""

    def tell(stage: str, done: int, total: int, message: str = "") -> None:
        if stage != START:  # the fit of the whole clip has started long ago
            progress(stage, done, total, message)

    run_verb(["window", str(request.absolute())], ROOT, tell)
