"""Priors of a clip: flow, tracks, motion, cameras, depth - a folder of plain files that the fit reads."""

from .build import build_priors
from .config import CamerasConfig, DepthConfig, FlowConfig, MotionConfig, PeopleConfig, PriorsConfig, TracksConfig
from .folder import Priors
from .providers import PROVIDERS, STAGES, register

__all__ = [
    "PROVIDERS",
    "STAGES",
    "CamerasConfig",
    "DepthConfig",
    "FlowConfig",
    "MotionConfig",
    "PeopleConfig",
    "Priors",
    "PriorsConfig",
    "TracksConfig",
    "build_priors",
    "register",
]
