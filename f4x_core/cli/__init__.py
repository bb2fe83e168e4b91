"""`f4x …`: one verb per thing a person wants done."""

from .main import main

__all__ = ["main"]
