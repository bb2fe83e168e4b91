"""The compiled library: C++17 behind plain C functions, loaded with ctypes; its Python faces live in the rooms that use it."""

from .library import address, instruction_set, measure_peak, open_library, require_library

__all__ = ["address", "instruction_set", "measure_peak", "open_library", "require_library"]
