"""Runs the providers stage by stage into a priors folder; finished stages are kept, the user's own files always win."""

from __future__ import annotations

import hashlib
import time
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from ..clip.changes import find_changes
from ..clip.images import resize_nearest
from ..errors import F4xError
from ..parallel import side_by_side
from ..progress import Progress, silent
from . import files
from .config import PriorsConfig, config_hash
from .folder import FIELDS, Priors, Scratch, digest, file_of, read_field, read_head, sources_in
from .providers import STAGES, find
from .sizes import shrunk

if TYPE_CHECKING:
    from ..clip import Clip

NOT_RESIZABLE = frozenset(FIELDS) - {*files.RESIZABLE, "cameras"}
"""Priors in pixels of one size: where they are given, all are made at the clip's own."""

UNSEEN = {"depth": np.nan, "depth_confidence": 0.0, "motion": 0.0, "mask": False}
"""Values for pixels that nobody saw."""

GIVEN = ("user", "files")
"""Providers of what the user gave."""


def build_priors(
    clip: Clip,
    folder: str | Path,
    config: PriorsConfig | None = None,
    progress: Progress = silent,
    seen_depth: np.ndarray | None = None,
) -> Priors:
    """Fill `folder` with the priors of `clip` and return them.

    `seen_depth (F, H, W)`: depth in any unit that is known from elsewhere, NaN = unknown (a window of a long clip knows that
    of the one before); it only helps to tell which way round the world is.

    A stage is skipped when its settings, the clip and every other prior it can see are what they were when it last ran.
    What the user gives replaces what a provider makes, and every stage sees it from the start: files put or changed in
    `folder`, entries of `config.files`, and the clip's own cameras, masks and depth. A cancel keeps finished stages.
    The pictures of a clip larger than `config.longer_side` are reduced for all of this, and the priors are of that size
    (`sizes.LargeMaps` enlarges them).
    Errors: F4xError for an unknown provider, an unreadable or ill-shaped file, or a provider that leaves a field empty.
    """
    config = config or PriorsConfig()
    with side_by_side(config.workers):
        small = clip if NOT_RESIZABLE & set(config.files) else shrunk(clip, config.longer_side)
        if seen_depth is not None and small is not clip:
            seen_depth = resize_nearest(seen_depth, small.width, small.height)
        priors = _build(small, Path(folder), config, progress, seen_depth)
        priors.scratch = Scratch()  # without flows over long gaps, which a fit does not read
        return priors


def _build(clip: Clip, folder: Path, config: PriorsConfig, progress: Progress, seen_depth: np.ndarray | None) -> Priors:
    """Return the priors at the size of `clip`."""
    priors = Priors.empty(clip)
    if len(priors.frames) == 0:
        raise F4xError(f"{clip.source}: every frame is held out; supervise at least one.")
    priors.scratch.seen_depth = seen_depth
    own = _read_user_files(folder, priors)
    fixed = files.take(priors, clip, config, own, folder)
    priors.write(folder, [name for name in fixed if name not in own])
    stages = _Stages(clip, folder, config, priors, clip.digest, progress)
    changes = find_changes(clip.frames[priors.frames])
    cuts = [int(priors.frames[cut]) for cut in changes.cuts]
    priors.statistics["changes"] = {"cuts": cuts, "exposure": round(changes.exposure, 3)}
    for index, (stage, fields) in enumerate(STAGES.items()):
        progress("priors", index, len(STAGES), stage)
        wanted = [name for name in fields if name not in fixed]
        if wanted and not stages.resume(stage, wanted):
            stages.run(stage, wanted)
    progress("priors", len(STAGES), len(STAGES), "done")
    return priors


def _read_user_files(folder: Path, priors: Priors) -> list[str]:
    """Load what `priors.json` remembers and the files that a user put into `folder`; return the names of those."""
    if (folder / "priors.json").exists():
        head = read_head(folder)
        priors.provenance, priors.warnings = head["provenance"], head["warnings"]
        priors.statistics, priors.camera_kind = head["statistics"], head["camera_kind"]
    own = []
    for name in FIELDS:
        path = file_of(folder, name)
        if not path.exists():
            priors.provenance.pop(name, None)
            continue
        entry, current = priors.provenance.get(name, {}), digest(path)
        if "key" in entry and current in (entry["digest"], entry["previous"]):
            entry["digest"] = current  # an interrupted write may have left the file before this one
            continue
        own.append(name)
        setattr(priors, name, read_field(folder, name))
        priors.provenance[name] = {"provider": "user", "digest": current}
    return own


@dataclass(frozen=True, eq=False)
class _Stages:
    """The stages that fill the priors of one clip, each run or read from its folder."""

    clip: Clip
    folder: Path
    config: PriorsConfig
    priors: Priors
    """Filled stage by stage."""
    digest: str
    """Digest of the clip."""
    progress: Progress

    def key(self, stage: str, wanted: list[str]) -> str:
        """Return a hash of everything that the result of a stage depends on.

        That is its settings, the clip, the priors that exist beside its own (of later stages only what the user gave), and for
        cameras the depth known from elsewhere.
        """
        priors, order = self.priors, list(STAGES)
        later = {name for other in order[order.index(stage) + 1 :] for name in STAGES[other]}
        seen = {
            name: entry["digest"]
            for name, entry in priors.provenance.items()
            if getattr(priors, name) is not None and not (name in later and entry["provider"] not in GIVEN)
        }
        known = priors.scratch.seen_depth if stage == "cameras" else None
        elsewhere = [] if known is None else [hashlib.blake2b(known.tobytes(), digest_size=16).hexdigest()]
        beside = {n: d for n, d in seen.items() if n not in wanted}
        return config_hash(stage, getattr(self.config, stage), self.digest, beside, *elsewhere)

    def resume(self, stage: str, wanted: list[str]) -> bool:
        """Load the fields `wanted` of a finished stage; False when it has to run."""
        priors, key = self.priors, self.key(stage, wanted)
        if any(priors.provenance.get(name, {}).get("key") != key for name in wanted):
            return False
        for name in wanted:
            setattr(priors, name, read_field(self.folder, name))
        priors.validate(wanted, sources_in(self.folder))
        return True

    def run(self, stage: str, wanted: list[str]) -> None:
        """Run the provider of a stage and write the fields `wanted` that it made."""
        priors, settings = self.priors, getattr(self.config, stage)
        stale = {line for name in wanted for line in priors.provenance.get(name, {}).get("warnings", [])}
        priors.warnings = [line for line in priors.warnings if line not in stale]
        before = {name: getattr(priors, name) for name in FIELDS if name not in wanted}
        known, start = list(priors.warnings), time.perf_counter()
        find(stage, settings.provider)(self.clip, priors, self.config, self.progress)
        for name in wanted:
            if getattr(priors, name) is None:
                raise F4xError(
                    f"The provider '{settings.provider}' did not make {name}; choose another one for {stage}."
                )
        _forget_hidden(wanted, priors, self.clip)
        revised = self._revised(before)
        priors.validate([*wanted, *revised], sources_in(self.folder))
        entry = {
            "provider": settings.provider,
            "settings": asdict(settings),
            "seconds": round(time.perf_counter() - start, 2),
            "warnings": [line for line in priors.warnings if line not in known],
        }
        for name in wanted:
            priors.provenance[name] = entry | {"key": "", "digest": priors.provenance.get(name, {}).get("digest")}
        priors.write(self.folder, [*wanted, *revised])
        for earlier in list(STAGES)[
            : list(STAGES).index(stage) + 1
        ]:  # after the revision: that is what a resume will see
            made = [name for name in STAGES[earlier] if priors.provenance[name]["provider"] not in GIVEN]
            key = self.key(earlier, made)
            for name in made:
                priors.provenance[name]["key"] = key
        priors.write(self.folder, [])

    def _revised(self, before: dict[str, Any]) -> list[str]:
        """Return the earlier fields that a stage changed; those that the user gave get their value `before` back.

        The depth stage, for example, sets the world unit of the cameras.
        """
        priors, revised = self.priors, []
        for name, value in before.items():
            if getattr(priors, name) is value:
                continue
            if value is None or priors.provenance[name]["provider"] in GIVEN:
                setattr(priors, name, value)
            else:
                revised.append(name)
        return revised


def _forget_hidden(names: list[str], priors: Priors, clip: Clip) -> None:
    """Set the pixels that the clip hides to unknown in the fields `names` of `priors`."""
    if clip.hidden is None:
        return
    hidden = clip.hidden[priors.frames]
    for name in set(names) & set(UNSEEN):
        setattr(priors, name, np.where(hidden, UNSEEN[name], getattr(priors, name)).astype(getattr(priors, name).dtype))
    if "tracks_visible" in names and priors.tracks is not None and priors.tracks_visible is not None:
        column, row = np.nan_to_num(priors.tracks).astype(int).transpose(2, 0, 1)
        frame = np.arange(len(hidden))[:, None]
        inside = hidden[frame, row.clip(0, priors.height - 1), column.clip(0, priors.width - 1)]
        priors.tracks_visible = priors.tracks_visible & ~inside
