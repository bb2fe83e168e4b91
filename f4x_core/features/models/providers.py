"""Priors providers that need models; nothing of these is imported before one is used."""

from __future__ import annotations

from importlib import import_module
from importlib.util import find_spec
from typing import TYPE_CHECKING

from ...errors import F4xError
from ...priors.providers import find
from ...progress import Progress
from ..weights import require_path

if TYPE_CHECKING:
    from ...clip import Clip
    from ...priors import Priors, PriorsConfig

MODELS = {
    ("depth", "depth-anything"): ("depth", "provide"),
    ("depth", "depth-anything-3"): ("depth_anything3", "provide_depth"),
    ("depth", "depth-anything-3-base"): ("depth_anything3", "provide_depth"),
    ("cameras", "depth-anything-3"): ("depth_anything3", "provide_cameras"),
    ("cameras", "depth-anything-3-base"): ("depth_anything3", "provide_cameras"),
}
"""(stage, provider) -> module of this folder and its function; a provider is called what its checkpoint is."""
PACKAGES = {"depth_anything3": ("depth_anything_3", "einops", "omegaconf", "addict")}
"""Module -> what it imports beside transformers."""
INSTALL = "pip install --no-deps depth-anything-3, then pip install einops omegaconf addict"
"""Command that installs them; with its dependencies the first would bring numpy 1, torchvision, xformers and moviepy 1.0.3."""


def require_provider(stage: str, name: str) -> None:
    """Raise F4xError unless `stage` has a provider `name` whose packages and weights are on this machine."""
    find(stage, name)
    if (stage, name) not in MODELS:
        return
    absent = [module for module in PACKAGES.get(MODELS[stage, name][0], ()) if find_spec(module) is None]
    if absent:
        raise F4xError(f"'{name}' needs a package that is not here ({absent[0]}); install it: {INSTALL}")
    require_path(name)


def provide_depth(clip: Clip, priors: Priors, config: PriorsConfig, progress: Progress) -> None:
    """Fill `depth` and `depth_confidence` by the model that `config.depth.provider` names."""
    _provide("depth", config.depth.provider, clip, priors, config, progress)


def provide_cameras(clip: Clip, priors: Priors, config: PriorsConfig, progress: Progress) -> None:
    """Fill `cameras` by the model that `config.cameras.provider` names."""
    _provide("cameras", config.cameras.provider, clip, priors, config, progress)


PROVIDERS = {(stage, name): {"depth": provide_depth, "cameras": provide_cameras}[stage] for stage, name in MODELS}
"""The providers of this room by stage and name, for `priors.providers.find`."""


def _provide(stage: str, name: str, clip: Clip, priors: Priors, config: PriorsConfig, progress: Progress) -> None:
    require_provider(stage, name)
    module, function = MODELS[stage, name]
    getattr(import_module(f".{module}", __package__), function)(clip, priors, config, progress, name)
