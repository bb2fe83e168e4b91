"""Halves of the clips: constants are chosen on one and judged on the other.

Each half of the rendered clips has a room and a walker, short and long camera paths, and slow and fast motion.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass


@dataclass(frozen=True)
class Halves:
    """The clips of one kind by what they may be used for; names are those of their folders."""

    choosing: tuple[str, ...]
    """On which constants are chosen."""
    judging: tuple[str, ...]
    """On which results are reported only."""

    @property
    def every(self) -> tuple[str, ...]:
        """All of them, the choosing half first."""
        return self.choosing + self.judging

    def half_of(self, name: str) -> str:
        """`choosing`, `judging`, or "" for a clip of neither."""
        if name in self.choosing:
            return "choosing"
        return "judging" if name in self.judging else ""


RENDERED = Halves(
    choosing=(
        "procedural",
        "knight",
        "horizon",
        "walk",
        "crossing",
        "grid-short-middle",
        "grid-middle-slow",
        "grid-middle-fast",
        "grid-long-middle",
    ),
    judging=(
        "fox",
        "falling",
        "pan-step",
        "orbit",
        "return",
        "grid-short-slow",
        "grid-short-fast",
        "grid-middle-middle",
        "grid-long-slow",
        "grid-long-fast",
    ),
)
"""Clips that `scripts/synthetic_clip.py` renders."""
PEOPLE = Halves(
    choosing=("people-walk", "people-cross", "people-turn"), judging=("people-jump", "people-hidden", "people-far")
)
"""Rendered people, each half with both figures and three sizes."""
REAL = Halves(
    choosing=("bedroom", "blackswan", "camel", "car-shadow", "dog", "train"),
    judging=("breakdance", "dance-twirl", "drift-straight", "horsejump-high", "parkour", "scooter-black"),
)


def in_order(names: Iterable[str], halves: Halves) -> list[str]:
    """`names`, the choosing half first, then the judging one, then clips of neither; each group in its own order."""
    place = {name: index for index, name in enumerate(halves.every)}
    return sorted(names, key=lambda name: (place.get(name, len(place)), name))
