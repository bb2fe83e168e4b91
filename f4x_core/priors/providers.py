"""Who can fill which part of a priors folder. Modules are imported only when their provider is used."""

from __future__ import annotations

from collections.abc import Callable
from importlib import import_module
from typing import TYPE_CHECKING, Protocol

from ..errors import F4xError
from ..progress import Progress

if TYPE_CHECKING:
    from ..clip import Clip
    from .config import PriorsConfig
    from .folder import Priors


class Provider(Protocol):
    """Fills the fields of its stage (`STAGES`) in `priors`.

    Fields that are set already were given by the user or made by earlier stages: use them, they are kept.
    """

    def __call__(self, clip: Clip, priors: Priors, config: PriorsConfig, progress: Progress) -> None:
        """Work on `clip.supervised` frames only: held-out frames must never be looked at."""


STAGES: dict[str, tuple[str, ...]] = {
    "flow": ("flow_forward", "flow_backward", "flow_forward_mask", "flow_backward_mask"),
    "tracks": ("tracks", "tracks_visible"),
    "people": ("people", "people_probability", "people_joints", "people_metres"),
    "motion": ("motion", "mask", "tracks_motion"),
    "cameras": ("cameras",),
    "depth": ("depth", "depth_confidence"),
}
"""Stages in build order and the priors each must fill; one may also revise earlier ones (depth sets the unit)."""

PROVIDERS: dict[tuple[str, str], str | Provider] = {
    ("flow", "classical"): "flow:provide",
    ("tracks", "classical"): "tracks:provide",
    ("people", "networks"): ".people.provider:provide",
    ("people", "none"): ".people.provider:provide_nobody",
    ("motion", "classical"): "motion:provide",
    ("cameras", "classical"): "cameras:provide",
    ("depth", "classical"): "depth:provide",
    ("flow", "synthetic"): "synthetic:provide_flow",
    ("tracks", "synthetic"): "synthetic:provide_tracks",
    ("people", "synthetic"): "synthetic:provide_people",
    ("motion", "synthetic"): "synthetic:provide_motion",
    ("cameras", "synthetic"): "synthetic:provide_cameras",
    ("depth", "synthetic"): "synthetic:provide_depth",
    ("depth", "depth-anything"): ".features.models.providers:provide_depth",
    ("depth", "depth-anything-3"): ".features.models.providers:provide_depth",
    ("depth", "depth-anything-3-base"): ".features.models.providers:provide_depth",
    ("cameras", "depth-anything-3"): ".features.models.providers:provide_cameras",
    ("cameras", "depth-anything-3-base"): ".features.models.providers:provide_cameras",
}
"""(stage, name) -> callable, or `module:function` of this room (with a dot before it, of another) imported when first needed."""


def register(stage: str, name: str, provider: str | Provider) -> None:
    """Offer a provider for a stage under a name that a config can ask for."""
    if stage not in STAGES:
        raise F4xError(f"There is no priors stage '{stage}'; the stages are {', '.join(STAGES)}.")
    PROVIDERS[stage, name] = provider


def find(stage: str, name: str) -> Callable[..., None]:
    """The provider of `stage` called `name`; F4xError lists the known ones otherwise."""
    if (stage, name) not in PROVIDERS:
        known = ", ".join(sorted(provider for known_stage, provider in PROVIDERS if known_stage == stage))
        raise F4xError(f"There is no provider '{name}' for {stage}; choose one of: {known}.")
    provider = PROVIDERS[stage, name]
    if isinstance(provider, str):
        module, function = provider.split(":")
        provider = getattr(import_module(f".{module}", __package__), function)
    return provider
