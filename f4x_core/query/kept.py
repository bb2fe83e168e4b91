"""Results that are kept as long as what they were made of."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Generic, TypeVar
from weakref import WeakKeyDictionary, ref

T = TypeVar("T")


class _Nothing:
    """Stands for None, to which there is no weak reference."""


_NOTHING = _Nothing()


class Kept(Generic[T]):
    """Results by the objects that they were made of; each is kept as long as the first of these lives.

    The others are known by weak references: two tables that held each other's keys would never let a scene go. Results must not
    hold any of the objects either.
    """

    def __init__(self) -> None:
        self._kept: WeakKeyDictionary[Any, tuple[list[ref], T]] = WeakKeyDictionary()

    def get(self, first: Any, *others: Any, make: Callable[[], T]) -> T:
        """Return the result for exactly these objects, of which others may be None; `make` makes it where it is not known."""
        present = [_NOTHING if other is None else other for other in others]
        known = self._kept.get(first)
        if known is None or any(other is not there() for other, there in zip(present, known[0], strict=True)):
            known = self._kept[first] = ([ref(other) for other in present], make())
        return known[1]
