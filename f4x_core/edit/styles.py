"""Styles: lightness is mapped to a ramp of colours. A table, so that "make it gold" needs no model and cannot fail."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class StyleColors:
    """The colours of a material or of a lighting."""

    ramp: tuple[tuple[float, float, float], ...]
    """sRGB in [0, 1] from the darkest parts to the brightest, evenly spaced."""
    opacity: float = 1.0
    """Factor of the opacity; below 1 is translucent."""


def _ramp(*colours: str) -> tuple[tuple[float, float, float], ...]:
    """Return colors (…,3) in [0, 1] from six hexadecimal digits each."""
    return tuple((int(c[0:2], 16) / 255, int(c[2:4], 16) / 255, int(c[4:6], 16) / 255) for c in colours)


STYLES = {
    "gold": StyleColors(_ramp("2b1703", "8a5a0b", "d9a520", "ffd75e", "fff6cf")),
    "silver": StyleColors(_ramp("1a1c1f", "5d6268", "a9afb6", "dfe3e8", "ffffff")),
    "copper": StyleColors(_ramp("22100a", "7a3a1e", "c46a3a", "eea070", "ffe2cd")),
    "ice": StyleColors(_ramp("123a5c", "3f8fc4", "9bd7f2", "dff5ff", "ffffff"), opacity=0.75),
    "fire": StyleColors(_ramp("240300", "a01400", "f25a00", "ffb400", "fff6b0")),
    "lava": StyleColors(_ramp("0a0605", "2b0c08", "7d1405", "ee4a08", "ffd23c")),
    "neon": StyleColors(_ramp("0a0026", "5a00c8", "ff00b4", "00e6ff", "e6fff5")),
    "night": StyleColors(_ramp("02040c", "0a1330", "1c2c5c", "41568f", "8ca0cf")),
    "sunset": StyleColors(_ramp("1f1035", "7a2456", "e0514b", "ff9e4a", "ffe3a1")),
    "sepia": StyleColors(_ramp("170d05", "553a20", "9a7650", "d3b48a", "fbeed6")),
    "autumn": StyleColors(_ramp("21100a", "7a2e12", "c9641a", "e8a52c", "f5dc8c")),
    "grass": StyleColors(_ramp("0a1f08", "24561a", "4f9130", "93c954", "dcf3a4")),
    "ocean": StyleColors(_ramp("01121f", "053f63", "0b7d9c", "46bcc4", "c8f3ec")),
    "chocolate": StyleColors(_ramp("140804", "3a1d10", "66391f", "93603c", "cfa67f")),
    "marble": StyleColors(_ramp("6a6c70", "a9abad", "d9dad9", "f1f1ee", "ffffff")),
    "ghost": StyleColors(_ramp("6f86a0", "a3b8cc", "ccdbe8", "e9f2f8", "ffffff"), opacity=0.35),
}
"""Style name -> its colours."""
