"""The resources of a fit: steps and Gaussians within the minutes and the memory that it is granted, and what it will cost."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np

from ..clip.images import enlarge_color, even_size, resize_color
from ..files import replace_file
from ..fit.budget import ClipSize, MachineSpeed, asked_gaussians, cost, for_clip, max_gaussians, within
from ..fit.config import SETTINGS, FitConfig
from ..fit.settings import list_settings, set_fields
from ..progress import Progress
from ..reading import load_json, undamaged
from .fit_options import FitRequest

GRANT = "grant.json"
"""File beside the scene: the settings that `minutes` and `memory` came to."""
WIDTHS = (480, 854, 1280, 1920)
"""Widths of images whose cost is estimated."""
DETAIL = (
    (np.inf, "all of the clip's detail"),
    (35, "hardly a difference from the clip"),
    (25, "fine detail such as hair, leaves and small letters is missing"),
    (-np.inf, "soft all over"),
)
"""Least dB from the clip's own pictures -> what a person sees of one, by the README's scale."""


def granted(request: FitRequest, size: ClipSize, progress: Progress) -> FitConfig:
    """Return the settings within what the request grants; tells `progress` what the fit of a clip of `size` costs.

    An interrupted fit goes on with the steps and Gaussians it was granted.
    """
    options, path = request.options, request.folder / GRANT
    grant, speed = options.grant, MachineSpeed.measured(options.config.kernels.threads)
    config = for_clip(grant.minutes, size, options.config, speed)
    if options.resume and path.is_file():
        with undamaged(path, "delete it and fit again without --resume"):
            allowed = set_fields(config, load_json(path))
    else:
        allowed = within(grant, size, config, speed)
        if allowed is not config:
            _keep_grant(path, allowed)
    binds = allowed.counts_from != SETTINGS and max_gaussians(allowed) < asked_gaussians(size, allowed)
    room = f"; room for {max_gaussians(allowed):,} Gaussians by {allowed.counts_from}" if binds else ""
    room += "; --features takes minutes more" if options.features else ""
    progress("cost", 1, 1, f"{cost(size, allowed, speed)}{room}")
    larger = _larger(request, size, allowed, speed)
    if larger:
        progress("larger pictures", 1, 1, larger)
    return allowed


def _keep_grant(path: Path, config: FitConfig) -> None:
    """Write how many steps and Gaussians were granted, as `set_fields` reads it."""
    counts = [
        setting
        for setting in list_settings(config)
        if setting.name == "steps" or setting.name.endswith(("max_count", "counts_from", "own_counts"))
    ]
    path.parent.mkdir(parents=True, exist_ok=True)
    with replace_file(path) as file:
        file.write(json.dumps([f"{setting.name}={setting.text}" for setting in counts]).encode())


def _larger(request: FitRequest, size: ClipSize, config: FitConfig, speed: MachineSpeed) -> str:
    """Say the cost and the detail of larger pictures of the same clip; empty where there are none."""
    first = request.options.clip.first_picture(request.source).frames[0]
    height, width = first.shape[:2]
    widths = [size.width, *(wanted for wanted in WIDTHS if size.width < wanted <= width)]
    words = []
    for wanted in widths if len(widths) > 1 else ():
        small_width, small_height = even_size(width, height, wanted)
        small = resize_color(first, small_width, small_height)
        missed = np.mean((enlarge_color(small, width, height).astype(np.float64) - first) ** 2)
        shown = detail_in_words(10 * np.log10(255**2 / missed) if missed else np.inf)
        minutes = cost(replace(size, width=small_width, height=small_height), config, speed).minutes
        which = f"{wanted}, as now" if wanted == size.width else f"--width {wanted}"
        words.append(f"{which}: {shown}, {minutes:.1f} minutes")
    return f"the clip is {width} pixels wide; {'; '.join(words)}" if words else ""


def detail_in_words(psnr: float) -> str:
    """Say in words how a picture looks that is `psnr` dB from the clip's own."""
    seen = next(words for least, words in DETAIL if psnr >= least)
    return seen if np.isinf(psnr) else f"{seen} ({psnr:.0f} dB)"
