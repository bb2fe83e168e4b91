"""The compiled library: C++17 behind plain C functions, loaded with ctypes; its Python faces live in the rooms that use it.

`binder` declares and calls the kernels. What uses it lies beside the kernel's plain form: `X_native.py`, or a folder `native`
where the kernel also serves without torch, with `library` (numpy) and `autograd` (torch). This module does without numpy,
because the build imports it.
"""

from .library import instruction_set, measure_peak, open_library, require_library, shareable_seconds

__all__ = ["instruction_set", "measure_peak", "open_library", "require_library", "shareable_seconds"]
