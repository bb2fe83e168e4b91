"""Choice between the compiled library and torch for inner loops."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass


@dataclass(frozen=True)
class Kernels:
    """Implementation of skinning, colours and SSIM that a computation uses, and its number of threads."""

    native: bool = False
    """The compiled library (float32 on the CPU, differentiable once); otherwise torch."""
    threads: int = 1
    """Threads of the compiled library. Torch has its own number, which is one for the whole process."""


TORCH = Kernels()
"""Plain torch: any dtype, any order of derivatives."""


@contextmanager
def torch_threads(count: int) -> Iterator[None]:
    """Let torch work on `count` threads within the block."""
    import torch

    before = torch.get_num_threads()
    torch.set_num_threads(count)
    try:
        yield
    finally:
        torch.set_num_threads(before)
