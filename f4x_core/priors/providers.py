"""The providers of each stage of a priors folder, by name. A provider's module is imported when the provider is used."""

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
    ("motion", "classical"): "motion:provide",
    ("cameras", "classical"): "cameras:provide",
    ("depth", "classical"): "depth:provide",
    ("flow", "synthetic"): "synthetic:provide_flow",
    ("tracks", "synthetic"): "synthetic:provide_tracks",
    ("people", "synthetic"): "synthetic:provide_people",
    ("motion", "synthetic"): "synthetic:provide_motion",
    ("cameras", "synthetic"): "synthetic:provide_cameras",
    ("depth", "synthetic"): "synthetic:provide_depth",
}
"""(stage, name) -> callable, or `module:function` of this room, imported when first needed."""
ELSEWHERE = (".people.provider", ".features.models.providers")
"""Modules of other rooms with a table `PROVIDERS` of their own, read when a name is asked for that this room does not have."""


def register(stage: str, name: str, provider: str | Provider) -> None:
    """Offer a provider for a stage under a name that a config can ask for."""
    if stage not in STAGES:
        raise F4xError(f"There is no priors stage '{stage}'; the stages are {', '.join(STAGES)}.")
    PROVIDERS[stage, name] = provider


def find(stage: str, name: str) -> Callable[..., None]:
    """Return the provider of `stage` called `name`; F4xError lists the known ones otherwise."""
    known = PROVIDERS
    if (stage, name) not in known:
        known = {**known}
        for module in ELSEWHERE:
            known |= import_module(f".{module}", __package__).PROVIDERS
    if (stage, name) not in known:
        names = ", ".join(sorted(provider for known_stage, provider in known if known_stage == stage))
        raise F4xError(f"There is no provider '{name}' for {stage}; choose one of: {names}.")
    provider = known[stage, name]
    if isinstance(provider, str):
        module, function = provider.split(":")
        return getattr(import_module(f".{module}", __package__), function)
    return provider
