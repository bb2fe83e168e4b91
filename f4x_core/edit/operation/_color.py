"""Operations that give Gaussians other colors: what recolour, style, match and grade share."""

from __future__ import annotations

from abc import abstractmethod
from typing import TYPE_CHECKING, Any

import numpy as np

from ...geometry import spherical_harmonics
from .. import colours
from ..change import Change, Ease, Span
from ..description import span_words
from ..state import Appearance, put

if TYPE_CHECKING:
    from ..apply import Looking


class ColorChange(Change):
    """Base: colors come at once or little by little, and move linearly from the old to the new ones."""

    LOOKS = True
    frames: Span | None
    """In effect from … to; None = always."""
    ease: Ease | None
    """As of `Opacity`: None, or how it comes between the two, to stay."""

    def shown(self, state: Appearance, chosen: np.ndarray, fraction: float, scene: Looking) -> Appearance:
        before = Appearance(*(part[chosen] for part in state))
        after = self.coloured(before, scene.tones)
        if fraction < 1:
            after = Appearance(*(a + np.float32(fraction) * (b - a) for a, b in zip(before, after, strict=True)))
        return put(state, chosen, after)

    @abstractmethod
    def coloured(self, whom: Appearance, tones: Any) -> Appearance:
        """Return the Gaussians with their new colors in full; `tones` is the result of `Change.tones`."""

    def tones(self, whom: Appearance, other: Appearance | None) -> Any:
        return colours.mean_of(colours.lab_from_rgb(colours.colours_of(whom.sh))[:, 0], whom.opacities)

    def coming(self, sentence: str) -> str:
        """Return the sentence with its span and, for a gradual change, its ease."""
        if self.ease is None:
            return sentence + span_words(self.frames)
        how = {"linear": "gradually ", "smooth": "gradually ", "step": ""}[self.ease]
        eased = f" ({self.ease})" if self.ease != "linear" else ""
        return how + sentence + span_words(self.frames, "to the end") + eased


class Dye(ColorChange):
    """Base: a color that is laid on in part."""

    strength: float
    """0 leaves the old colour, 1 is the new one."""

    def coloured(self, whom: Appearance, tones: Any) -> Appearance:
        """Return colors `strength` of the way from the old ones to the goal."""
        if self.strength == 0:
            return whom
        rgb = colours.colours_of(whom.sh)
        goal, rest, opacities = self.goal(rgb, whom, tones)
        dc = spherical_harmonics.dc_from_rgb(rgb + self.strength * (goal - rgb)).astype(np.float32)
        return Appearance(opacities, np.concatenate([dc[:, None], rest], axis=1))

    def faded(self, whom: Appearance) -> np.ndarray:
        """Return the direction-dependent harmonics (n,S-1,3), faded by `strength`: they are changes about the old color."""
        return whom.sh[:, 1:] * np.float32(1 - self.strength)

    @property
    def covers(self) -> bool:
        """Return True if nothing is left of earlier colors."""
        return False

    @property
    def is_covered(self) -> bool:
        """Return True if nothing is left of it under a color that covers."""
        return False

    def followed_by(self, later: Change) -> tuple[Change, ...]:
        """Return the later of two colors where it covers this one."""
        covered = isinstance(later, Dye) and later.covers and self.is_covered
        if covered and (later.select, later.span) == (self.select, self.frames):
            return (later,)
        return super().followed_by(later)

    @abstractmethod
    def goal(self, rgb: np.ndarray, whom: Appearance, tones: Any) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return colors (n,3) at full strength, harmonics (n,S-1,3) and opacities (n,) at `strength`, from the old `rgb (n,3)`."""
