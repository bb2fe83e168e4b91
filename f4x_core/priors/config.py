"""Settings of every stage of the priors; one documented field each, and nothing here imports a provider."""

from __future__ import annotations

import hashlib
import json
import os
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field, replace
from types import MappingProxyType
from typing import Any, Literal

USUAL_FRAMES = 100
"""Used frames for which settings and profiles were chosen: none of the clips that they were chosen on has more."""


@dataclass(frozen=True)
class FlowConfig:
    """Dense optical flow between consecutive supervised frames."""

    provider: str = "classical"
    """Name of an entry of `providers.PROVIDERS`."""
    preset: Literal["ultrafast", "fast", "medium", "fine"] = "fine"
    """OpenCV DIS: `ultrafast`, `fast`, `medium`, or `fine` (full resolution; half the error, twice the time)."""
    refine_iterations: int = 5
    """Variational refinement steps per DIS scale (OpenCV's own default is 5)."""


@dataclass(frozen=True)
class TracksConfig:
    """Long point tracks."""

    provider: str = "classical"
    """Name of an entry of `providers.PROVIDERS`."""
    count: int = 12000
    """Most tracks kept; the longest survive."""
    spacing: float = 8.0
    """Distance of seeds in pixels where nothing is known to move."""
    dynamic_spacing: float = 4.0
    """Distance of seeds in pixels inside moving regions (second pass, made by the motion stage)."""
    reseed_every: int = 8
    """Frames between two seedings of uncovered picture."""
    gaps: tuple[int, ...] = (1, 2, 4)
    """Frame distances (powers of two) of the flows a track may step over; longer ones bridge short failures."""
    relink_gap: int = 24
    """Most frames a point may be hidden and still be linked to a later track of the same look; 0 = never."""


@dataclass(frozen=True)
class PeopleConfig:
    """The people in every frame."""

    provider: str = "networks"
    """Name of the provider (`providers.PROVIDERS`); `none` looks for nobody."""
    every: int = 4
    """Frames between two in which people are looked for; they are followed through all."""
    parts_every: int = 16
    """Frames between two whose parts are looked at, too, for people who are far away; a multiple of `every`."""
    moving_every: int = 16
    """Frames between two in which moving objects are looked at whichever way is up; a multiple of `every`.
    Halved where that finds somebody."""


@dataclass(frozen=True)
class MotionConfig:
    """Score and mask of the pixels that move by themselves."""

    provider: str = "classical"
    """Name of an entry of `providers.PROVIDERS`."""
    gaps: tuple[int, ...] = (1, 2, 4, 8)
    """Distances in supervised frames (powers of two), used forward and backward, of the two-view tests."""
    threshold: float | None = None
    """Score in 0..1 above which a pixel is foreground; None = found from the score itself."""


@dataclass(frozen=True)
class CamerasConfig:
    """Camera path of the supervised frames."""

    provider: str = "classical"
    """Name of an entry of `providers.PROVIDERS`."""
    kind: Literal["static", "pan", "moving"] | None = None
    """`static`, `pan` or `moving`; None = decided from the static tracks."""
    focal: float | None = None
    """Focal length in picture widths; None = searched."""
    solver: Literal["auto", "depth", "direct", "colmap", "tracks"] = "auto"
    """First cameras of a moving clip: `depth`, `direct`, `colmap`, `tracks`, or `auto` = the first of these that can and serves."""
    keyframes: int = 40
    """Most frames given to pycolmap; the others are resected."""
    features: int = 2500
    """Most SIFT features per keyframe."""
    seed: int = 0
    """Seed of every random draw."""


@dataclass(frozen=True)
class DepthConfig:
    """Dense depth of the supervised frames."""

    provider: str = "classical"
    """Name of an entry of `providers.PROVIDERS`."""


@dataclass(frozen=True)
class PriorsConfig:
    """All settings of `build_priors`."""

    flow: FlowConfig = field(default_factory=FlowConfig)
    tracks: TracksConfig = field(default_factory=TracksConfig)
    people: PeopleConfig = field(default_factory=PeopleConfig)
    motion: MotionConfig = field(default_factory=MotionConfig)
    cameras: CamerasConfig = field(default_factory=CamerasConfig)
    depth: DepthConfig = field(default_factory=DepthConfig)
    files: Mapping[str, str] = field(default_factory=lambda: MappingProxyType({}))
    """The user's own: name of a prior (`depth`, `mask`, `cameras`, ...) -> file or folder; wins over providers."""
    longer_side: int = 480
    """Pixels of the pictures that priors are made from, along their longer side. Those of larger clips are enlarged."""
    threads: int | None = None
    """Threads that work side by side; None = all cores. No prior depends on it."""

    @property
    def workers(self) -> int:
        """The number of threads."""
        return self.threads or os.cpu_count() or 1

    @classmethod
    def of(cls, provider: str, **stages: Any) -> PriorsConfig:
        """Return all stages done by one provider (`PriorsConfig.of("synthetic")`); `stages` replace whole stage configs.

        People are found by the networks beside `classical`, read from the truth beside `synthetic`, by nobody beside another.
        """
        kinds = {"flow": FlowConfig, "tracks": TracksConfig, "motion": MotionConfig}
        kinds |= {"cameras": CamerasConfig, "depth": DepthConfig}
        made = {stage: kind(provider=provider) for stage, kind in kinds.items()}
        return cls(**({**made, "people": PeopleConfig(provider=_finds_people(provider))} | stages))

    def with_provider(self, provider: str) -> PriorsConfig:
        """Return the same settings with every stage done by `provider`."""
        stages = dict.fromkeys(("flow", "tracks", "motion", "cameras", "depth"), provider)
        stages["people"] = _finds_people(provider)
        return replace(self, **{name: replace(getattr(self, name), provider=one) for name, one in stages.items()})


def _finds_people(provider: str) -> str:
    """Return the provider of people beside the `provider` of all other stages."""
    return {"classical": "networks", "synthetic": "synthetic"}.get(provider, "none")


def config_hash(*parts: Any) -> str:
    """Return a hex digest that is equal exactly where all parts (dataclasses or JSON values) are equal."""
    plain = [asdict(part) if hasattr(part, "__dataclass_fields__") else part for part in parts]
    return hashlib.sha256(json.dumps(plain, sort_keys=True, default=str).encode()).hexdigest()
