"""Rasterisers of others: which of them could be timed beside ours on this machine, and why not."""

from __future__ import annotations

from importlib.util import find_spec

PEERS = {
    "gsplat": (
        "gsplat",
        "its kernels and the tile lists of its torch reference need a CUDA device; `raster.gsplat` is our door to them",
    ),
    "torch-splatting": ("gaussian_splatting", "its tensors are made on a CUDA device, whatever it is given"),
    "OpenSplat": ("opensplat", "a program of its own, without a function that draws one picture from arrays"),
}
"""Name -> module, and why it is not timed on a CPU where it is there."""


def absent_peers() -> list[str]:
    """One sentence for each of `PEERS`."""
    return [
        f"{name}: {reason if find_spec(module) else f'not installed (no module {module})'}."
        for name, (module, reason) in PEERS.items()
    ]
