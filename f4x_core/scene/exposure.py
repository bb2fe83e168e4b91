"""Motion blur (a shutter that stays open) and depth of field (a lens that is no point) of a picture.

Both are one average, in linear light, of sharp pictures: each at another moment, through another point of the lens.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass, replace

import numpy as np

from ..geometry.arrays import GOLDEN_RATIO
from ..geometry.camera import Camera
from ..progress import Progress, silent
from .clouds import Cloud
from .color import linear_from_srgb
from .stage import HOLE, SHARP, DrawSettings, Surface, draw

GOLDEN_ANGLE = np.pi * (3 - 5**0.5)
"""Points of a disc at this angle from one to the next cover it evenly (Vogel 1979)."""


@dataclass(frozen=True)
class Lens:
    """A thin lens; everything at `focus` stays sharp."""

    radius: float
    """World units."""
    focus: float
    """Depth along the view axis, world units, above 0."""
    blades: int = 0
    """Number of blades of the aperture; fewer than 3 make a disc."""
    rotation: float = 0.0
    """Rotation of the blades, radians."""
    ratio: float = 1.0
    """Height of the aperture, by its width: 2 is an anamorphic lens."""

    def through(self, camera: Camera, point: np.ndarray) -> Camera:
        """Return the pinhole camera at `point (2,)` of the unit disc of the lens, right and up."""
        right, up = point * self.radius
        matrix, intrinsics = camera.world_to_camera.copy(), camera.intrinsics.copy()
        matrix[:2, 3] -= right, -up
        intrinsics[:2, 2] += intrinsics[:2, :2] @ (right, -up) / self.focus
        return replace(camera, world_to_camera=matrix, intrinsics=intrinsics)


@dataclass(frozen=True)
class Exposure:
    """Settings of one picture's shutter and lens."""

    samples: int = 16
    """Sharp pictures that are averaged, where there is anything to blur."""
    opens: float = 0.0
    """Time at which the shutter opens, in frames from the picture's own time."""
    closes: float = 0.0
    """Time at which it closes; equal to `opens` = no motion blur."""
    lens: Lens | None = None
    """None = a pinhole: no depth of field."""

    @property
    def blurs(self) -> bool:
        """True if more than one sharp picture is needed."""
        return self.samples > 1 and (self.closes > self.opens or self.lens is not None)

    def moments(self) -> np.ndarray:
        """Return (samples,) frames relative to the picture's time, in the middle of equal parts of the shutter's open time."""
        return self.opens + (self.closes - self.opens) * (np.arange(self.samples) + 0.5) / self.samples

    def lens_points(self) -> np.ndarray:
        """Return (samples,2) points of the unit aperture, right and up, evenly over its area."""
        # Lens points of neighbouring moments lie far apart, so that neither follows the other.
        rank = np.argsort(np.argsort(np.arange(self.samples) * GOLDEN_RATIO % 1))
        radius, angle = np.sqrt((rank + 0.5) / self.samples), rank * GOLDEN_ANGLE
        lens = self.lens or Lens(0.0, 1.0)
        if lens.blades >= 3:
            wedge = 2 * np.pi / lens.blades
            radius = radius * np.cos(wedge / 2) / np.cos(angle % wedge - wedge / 2)
        angle = angle + lens.rotation
        return np.stack([radius * np.cos(angle) / lens.ratio, radius * np.sin(angle)], 1)


@dataclass(frozen=True, eq=False)
class Take:
    """Contents of the stage at one moment, and the camera."""

    clouds: Sequence[Cloud]
    surfaces: Sequence[Surface]
    camera: Camera


def shoot(
    take_at: Callable[[float], Take],
    exposure: Exposure,
    settings: DrawSettings,
    passes: Collection[str] = (),
    *,
    refine: Callable[[dict[str, np.ndarray], Take], dict[str, np.ndarray]] | None = None,
    progress: Progress = silent,
) -> dict[str, np.ndarray]:
    """Take one picture: `stage.draw`'s passes, with `combined (H,W,4)` in place of `rgb`: linear light, premultiplied alpha.

    Args:
        take_at: what is there so many frames from the picture's own time; asked for 0 last.
        exposure: shutter and lens. Passes of `SHARP` are not blurred.
        settings: of `stage.draw`; its `cameras` and `finish` are filled in.
        passes: of `stage.draw`.
        refine: function of the passes of a sharp picture, and of what it shows, that returns some of them anew; what is blurred
            has no edge.
        progress: of `stage.draw`, over all sharp pictures.

    Raises:
        F4xError: a camera that is not finite.
    """
    beside = (take_at(-1.0), take_at(1.0)) if "vector" in passes else None
    if not exposure.blurs:
        take = take_at(0.0)
        images = draw_one(take, beside, settings, passes, progress)
        return images | refine(images, take) if refine else images
    soft = [name for name in passes if name not in SHARP]
    sharp = [name for name in passes if name in SHARP]
    count = exposure.samples + bool(sharp)
    still = take_at(0.0) if exposure.closes <= exposure.opens else None
    total: dict[str, np.ndarray] = {}
    for done, (moment, point) in enumerate(zip(exposure.moments(), exposure.lens_points(), strict=True)):
        take = still or take_at(float(moment))
        if exposure.lens is not None:
            take = replace(take, camera=exposure.lens.through(take.camera, point))
        for name, image in draw_one(take, None, settings, soft, _part(progress, done, count)).items():
            total[name] = total.get(name, 0) + image / np.float32(exposure.samples)
    if sharp:
        own = draw_one(take_at(0.0), beside, settings, sharp, _part(progress, exposure.samples, count))
        total |= {name: own[name] for name in sharp}
    return total


def draw_one(
    take: Take,
    beside: tuple[Take, Take] | None,
    settings: DrawSettings,
    passes: Collection[str],
    progress: Progress = silent,
) -> dict[str, np.ndarray]:
    """Return `stage.draw` of one take with `combined` in place of `rgb`; `beside`: those of one frame before and after."""
    clouds, surfaces = take.clouds, take.surfaces
    if beside is not None:
        before, after = beside
        settings = replace(settings, cameras=(before.camera, after.camera))
        clouds = _clouds_between(take.clouds, before.clouds, after.clouds)
        surfaces = _surfaces_between(take.surfaces, before.surfaces, after.surfaces)
    transparent = settings.background is None

    def finish(images: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
        seen = images["alpha"] if transparent else 1 - images.pop(HOLE, np.zeros_like(images["alpha"]))
        images.pop(HOLE, None)
        return images | {"combined": combined(images.pop("rgb"), seen)}

    return draw(clouds, surfaces, take.camera, replace(settings, finish=finish), passes=passes, progress=progress)


def combined(rgb: np.ndarray, alpha: np.ndarray) -> np.ndarray:
    """Return (H,W,4) linear light, premultiplied, of `rgb (H,W,3)` sRGB that covers `alpha (H,W)`; 1 over a background.

    The color under the alpha is what is linearised, and then premultiplied.
    """
    alpha = alpha[..., None]
    straight = rgb / np.where(alpha > 0, alpha, 1)
    return np.concatenate([linear_from_srgb(straight) * alpha, alpha], -1)


def _clouds_between(now: Sequence[Cloud], before: Sequence[Cloud], after: Sequence[Cloud]) -> list[Cloud]:
    """Return the clouds with their places `beside`, where the same one is there at all three moments."""
    found = []
    sides = [{cloud.key: cloud for cloud in part} for part in (before, after)]
    for cloud in now:
        others = [side.get(cloud.key) for side in sides]
        if all(other is not None and len(other.means) == len(cloud.means) for other in others):
            places = cloud.places
            # what is absent then has no place: it comes or goes where it is now
            there = [np.where((other.opacities > 0)[:, None], other.places, places) for other in others if other]
            cloud = replace(cloud, beside=(there[0], there[1]))
        found.append(cloud)
    return found


def _surfaces_between(now: Sequence[Surface], before: Sequence[Surface], after: Sequence[Surface]) -> list[Surface]:
    """Return the surfaces of `now` with their places before and after, as `_clouds_between` does for clouds."""
    found = []
    sides = [{surface.key: surface.triangles for surface in part} for part in (before, after)]
    for surface in now:
        first, last = (side.get(surface.key) for side in sides)
        if first is not None and last is not None and len(first) == len(last) == len(surface.triangles):
            surface = replace(surface, beside=(first, last))
        found.append(surface)
    return found


def _part(progress: Progress, number: int, count: int) -> Progress:
    """Return `progress` of picture `number` of `count` that are drawn one after the other."""
    if progress is silent:
        return silent

    def shifted(stage: str, done: int, total: int, message: str = "") -> None:
        progress(stage, number * total + done, count * total, message)

    return shifted
