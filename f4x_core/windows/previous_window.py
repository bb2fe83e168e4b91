"""Takes over world, unit, background and nodes of the window before into the next window of a long clip.

The two share frames. There the earlier scene is known from its own cameras, and the later priors know the same pictures in a
world of their own: that relates the worlds. From there on every camera is registered to the earlier background. Of that the
window keeps what still explains its pictures; what shows them wrongly leaves (it moved, or the light changed), and new
Gaussians come only where pictures are left unexplained. What is kept stays unchanged as long as it shows later frames as well as
the shared ones. As the camera moves on, errors of its depth come to light: then it is learnt further, in place of what it was.
"""

from __future__ import annotations

import hashlib
from dataclasses import dataclass, field, replace
from typing import NamedTuple

import numpy as np
import torch
from scipy.ndimage import binary_dilation, maximum_filter, minimum_filter, uniform_filter
from scipy.optimize import least_squares

from ..clip import Clip
from ..clip.images import resize_color
from ..errors import F4xError
from ..fit.pipeline import ClipFit, FitResult, KnownGround, start_fit
from ..fit.spawning import MASK_MARGIN, Explained, spawn_frames
from ..fit.trainer import Trainer
from ..geometry import pose, quaternion
from ..geometry.camera import Camera, CameraPath
from ..geometry.splats import Splats
from ..priors import Priors
from ..priors.config import config_hash
from ..priors.files import camera_kind
from ..priors.flow import consistent, dis, grey
from ..priors.sizes import LargeMaps
from ..raster.blend_weights import blend_weight_sums
from ..scaffold import Scaffold
from ..scene import EARLIER, Scene, StaticSet
from ..scene.concatenation import followed_by
from ..scene.view import render, seen_from
from .joining import continue_nodes

WRONG = 0.08
"""Colours (of 1) differ so much, mean over all channels, that the background does not explain a pixel."""
NEIGHBOURHOOD = 5
"""Pixels of its side: edges that lie a pixel off are not wrong, nor is a picture that is blurred because the camera shook. No
Gaussian could mend that, yet every window would try."""
OPAQUE = 0.8
"""Alpha from which on the background is there at all."""
MIN_PIXELS = 32
"""Fewer tell no depth."""
AROUND, GROUND_PERCENTILE = 3, 10
"""Pixels around moving objects, and the percentile of their depth that is the ground below."""
FREEDOM = {"static": 0, "pan": 3, "moving": 6}
"""Numbers that place a camera of each kind: its rotation, its position."""
ROUNDS = 2
"""Times that a camera is registered: flow over a long way is less exact than over what the first time left."""
MIN_MATCHED = 0.2
"""Fraction of the picture in which the background must be recognised; a corner of it would turn the camera about itself."""
MATCHES = 2000
"""Pixels that place a camera: six numbers need no more."""
FLOW_ERROR = 0.5
"""Pixels; matches that lie farther off count less."""
STIFFNESS = 0.3
"""Pixels of mismatch, all over, that a turn or shift of a camera by one pixel must save: on a plane both look alike. Without it
cameras wander by two pixels in front of a toy's flat wall; with three times as much a real drift (dog) is followed too late."""
WORSE, GOOD = 1.0, 30.0
"""dB. The background learns further where it shows later frames worse than shared ones by more than `WORSE`, and below `GOOD`. As
the camera travels they are 4 to 8 dB worse (camel, train: depth from a short way); where it stands, only by their noise."""
SHOWN = 0.2
"""Minimum fraction of its light that dynamic Gaussians leave of a Gaussian that learns further. The rails behind a train that has
come would become its ghost (train)."""
CONTINUES = 0.4
"""Node units by which a node that goes on may differ from itself over the shared frames: it stands for the motion around it."""


class Comparison(NamedTuple):
    """The background against the picture of one frame."""

    wrong: np.ndarray
    """(H,W) bool: it is there, but no mixture of it looks like the picture."""
    there: np.ndarray
    """(H,W) bool: it is there."""
    squared: np.ndarray
    """(H,W) squared difference of colours (of 1), mean over channels."""


@dataclass(frozen=True, eq=False)
class EarlierBackground:
    """The background that a window starts with."""

    world: StaticSet
    """All of it that stays."""
    drawn: StaticSet
    """Part of the background that the window's cameras see."""
    explained: Explained
    """(H,W) bool by supervised frame: pixels that it shows rightly."""
    learns: np.ndarray
    """(D,) bool: which of those drawn are learnt further."""

    def with_own(self, static: StaticSet) -> StaticSet:
        """Return the window's whole background: the Gaussians that stayed as they were, then its own."""
        return followed_by(self.world.take(~np.isin(self.world.ids, self.drawn.ids[self.learns])), static)

    def known(self, next_id: int) -> KnownGround:
        """Return the background for a fit whose own Gaussians have ids from `next_id` on."""
        frozen, learning = (
            Splats(part.means, part.quats, part.scales, part.opacities, part.sh).map(_tensor)
            for part in (self.drawn.take(~self.learns), self.drawn.take(self.learns))
        )
        return KnownGround(frozen, learning, self.explained, next_id)


@dataclass(frozen=True, eq=False)
class PreviousWindow:
    """The window before."""

    scene: Scene
    """Scene as it was fitted; its static set is all the background so far."""
    offset: int
    """Frames from its first to this window's first."""
    next_node: int
    """First node id that no window has used."""

    @property
    def digest(self) -> str:
        """Hash of what the later window depends on."""
        state = hashlib.blake2b(digest_size=16)
        for array in (self.scene.static.ids, self.scene.static.means, self.scene.cameras.world_to_camera):
            state.update(np.ascontiguousarray(array).tobytes())
        return state.hexdigest()

    def depth(self, clip: Clip, backend: str = "auto") -> np.ndarray:
        """Return (F,H,W) depth that the earlier scene shows in the supervised frames of the later `clip`, NaN where it ends."""
        frames = np.asarray(clip.supervised)
        known = np.full((len(frames), clip.height, clip.width), np.nan, np.float32)
        size = clip.width, clip.height
        for row, frame in enumerate(frames + self.offset):
            if frame < len(self.scene.cameras):
                seen = self._shown(int(frame), size, backend)
                known[row] = np.where(seen["alpha"] > OPAQUE, seen["depth"], np.nan)
        return known

    def place(self, priors: Priors, backend: str = "auto") -> Priors:
        """Return `priors` in the earlier window's world: cameras and depth by one similarity, from the shared frames.

        Scale: median ratio of the depth that the earlier scene shows to the priors', where nothing moves. Rotation and place:
        the mean over the shared cameras. How far away movers are is a guess that may differ from window to window: they get
        the ratio of their own pixels, as long as it leaves them in front of the surfaces around them.
        """
        assert priors.cameras is not None
        assert priors.depth is not None
        moving = np.zeros(priors.depth.shape, bool) if priors.mask is None else priors.mask
        shared = np.flatnonzero(priors.frames + self.offset < len(self.scene.cameras))
        if len(shared) == 0:
            raise F4xError(f"{self.scene.name}: two windows share no frame that may be seen; give a larger --overlap.")
        ratios, then, size = [], [], (priors.width, priors.height)
        for row in shared:
            frame = int(priors.frames[row]) + self.offset
            seen = self._shown(frame, size, backend)
            known = (seen["alpha"] > OPAQUE) & (priors.depth[row] > 0)
            ratios.append(np.where(known, seen["depth"] / priors.depth[row], np.nan))
            then.append(np.linalg.inv(self.scene.cameras.world_to_camera[frame]))
        ratio = np.stack(ratios)
        scale = _median(ratio[~moving[shared]], 1.0)
        own = min(_median(ratio[moving[shared]], scale), scale * _room(priors.depth, moving))
        factor = np.where(moving, own, scale).astype(np.float32)
        cameras = priors.cameras.scaled_world(scale)
        now = np.linalg.inv(cameras.world_to_camera[shared])
        turns, _ = pose.from_matrix(np.stack(then) @ np.linalg.inv(now))
        turn = quaternion.to_matrix(quaternion.normalize(quaternion.align_sequence(turns).mean(0)))
        shift = (np.stack(then)[:, :3, 3] - now[:, :3, 3] @ turn.T).mean(0)
        world = np.eye(4)
        world[:3, :3], world[:3, 3] = turn, shift  # from the priors' scaled world into the earlier one
        moved = replace(cameras, world_to_camera=cameras.world_to_camera @ np.linalg.inv(world))
        return replace(priors, cameras=moved, depth=priors.depth * factor)

    def track(self, clip: Clip, priors: Priors, margin: int, backend: str = "auto") -> Priors:
        """Return placed `priors` whose cameras see the earlier background where the pictures show it.

        Cameras that were found from one window alone drift away from those of the one before, and from a camera that is some
        pixels off all the background looks wrong. Shared frames have the earlier cameras. Each later frame starts from the
        one before it and the priors' motion, and is registered to the background as drawn from there: by optical flow, robustly,
        within what the kind of camera is free to do, in this window or the earlier one, as long as it sees enough of it. The depth
        of static pixels follows by one factor per frame.

        `margin`: pixels around the moving mask that do not count.
        """
        assert priors.cameras is not None
        assert priors.depth is not None
        path = priors.cameras
        kinds = (priors.camera_kind or "moving", camera_kind(self.scene.cameras))
        # A background that has depth shows a step that is too small to be found alone.
        freedom = max(FREEDOM[kind] for kind in kinds)
        views, depth = path.world_to_camera.copy(), priors.depth.copy()
        for row, frame in enumerate(priors.frames):
            moving = np.zeros(depth[row].shape, bool) if priors.mask is None else priors.mask[row]
            still = ~binary_dilation(moving, iterations=margin)
            if frame + self.offset < len(self.scene.cameras):
                views[row] = self.scene.cameras.world_to_camera[frame + self.offset]
            else:
                step = path.world_to_camera[row] @ np.linalg.inv(path.world_to_camera[row - 1])
                camera = replace(path[row], world_to_camera=step @ views[row - 1])
                picture = resize_color(clip.frames[frame], path.width, path.height)
                for _ in range(ROUNDS if freedom else 0):
                    camera = self._registered(camera, picture, still, freedom, backend)
                views[row] = camera.world_to_camera
            seen = self._ground(replace(path[row], world_to_camera=views[row]), backend)
            known = still & (seen["alpha"] > OPAQUE) & (depth[row] > 0)
            depth[row][~moving] *= _median(np.where(known, seen["depth"] / depth[row], np.nan), 1.0)
        return replace(priors, cameras=replace(path, world_to_camera=views), depth=depth)

    def _registered(self, camera: Camera, image: np.ndarray, still: np.ndarray, freedom: int, backend: str) -> Camera:
        """Return the camera from which the background is seen where it is in `image` (H,W,3) uint8, judged where `still` (H,W)."""
        seen, flow = self._ground(camera, backend), dis("medium", 0)
        drawn, target = grey(np.stack([(255 * seen["rgb"].clip(0, 1)).astype(np.uint8), image]))
        there = flow(drawn, target)
        matched = still & (seen["alpha"] > OPAQUE) & consistent(there, flow(target, drawn))
        if matched.mean() < MIN_MATCHED:
            return camera
        chosen = np.flatnonzero(matched)[:: 1 + matched.sum() // MATCHES]
        pixels = camera.pixel_grid().reshape(-1, 2)[chosen]
        points = camera.unproject(pixels, seen["depth"].ravel()[chosen])  # (n,3)
        wanted = pixels + there.reshape(-1, 2)[chosen]

        def moved(step: np.ndarray) -> Camera:
            turn, shift = np.split(np.pad(step, (0, 6 - freedom)), 2)
            change = pose.to_matrix(quaternion.from_rotation_vector(turn), shift)
            return replace(camera, world_to_camera=change @ camera.world_to_camera)

        def off(step: np.ndarray) -> np.ndarray:
            matches = moved(step).project(points)[0] - wanted
            return np.append(matches, STIFFNESS * np.sqrt(2 * len(points)) * camera.intrinsics[0, 0] * step)

        return moved(least_squares(off, np.zeros(freedom), loss="soft_l1", f_scale=FLOW_ERROR).x)

    def _shown(self, frame: int, size: tuple[int, int], backend: str) -> dict[str, np.ndarray]:
        """Return the depth and alpha of the earlier scene in its own `frame`, in a picture of `size` (width, height)."""
        time = float(self.scene.cameras.times[frame])
        camera = self.scene.cameras[frame].resized(*size)
        return render(seen_from(self.scene, [(camera, time)]), camera, time, ("depth", "alpha"), backend)

    def _ground(self, camera: Camera, backend: str) -> dict[str, np.ndarray]:
        """Return color, depth and alpha of all the background so far."""
        scene = Scene("ground", self.scene.static, self.scene.cameras)
        return render(seen_from(scene, [(camera, 0.0)]), camera, 0.0, ("rgb", "depth", "alpha"), backend)

    def background(
        self, clip: Clip, priors: Priors, rows: np.ndarray, margin: int, backend: str = "auto"
    ) -> EarlierBackground:
        """Return the part of the earlier background that stays, judged by the frames `rows` (indices into F) of placed priors.

        `margin`: pixels around the moving mask in which nothing is judged.
        """
        assert priors.cameras is not None
        world = self.scene.static
        maps = LargeMaps(priors, clip.width, clip.height)
        path = priors.cameras.resized(clip.width, clip.height)
        still = {}
        if priors.mask is not None:
            still = {row: ~binary_dilation(maps.mask(int(row)), iterations=margin) for row in rows}
        weights = np.zeros((len(world), 3))  # in all pixels, in those that are judged, in those that are wrong
        errors = np.full(len(rows), np.nan)
        for number, row in enumerate(rows):
            wrong, there, squared = self._compare(world, clip.frames[priors.frames[row]], path, row, backend)
            judged = still.get(row, np.ones_like(wrong))
            layers = np.stack([np.ones_like(wrong), judged, wrong & judged], -1).astype(np.float32)
            weights += blend_weight_sums(world, path[int(row)], layers, backend=backend)
            compared = squared[there & judged]
            errors[number] = compared.mean() if len(compared) else np.nan
        stays = weights[:, 2] <= 0.5 * weights[:, 1]
        kept = stays & (weights[:, 0] > 0)
        drawn = world.take(kept)
        explained = {}
        for row in rows:
            wrong, there, _ = self._compare(drawn, clip.frames[priors.frames[row]], path, row, backend)
            explained[int(row)] = there & ~wrong
        shared = priors.frames[rows] + self.offset < len(self.scene.cameras)
        shown = weights[:, 1] > SHOWN * weights[:, 0]  # what is hidden was seen better before
        return EarlierBackground(world.take(stays), drawn, explained, shown[kept] & _worse(errors, shared))

    def _compare(self, world: StaticSet, picture: np.ndarray, path: CameraPath, row: int, backend: str) -> Comparison:
        """Compare the background `world` with `picture (H,W,3)` uint8 of camera `row` of `path`.

        The picture's mean over a neighbourhood must lie between the darkest and the brightest of the background there.
        """
        camera = path[int(row)]
        scene = Scene("background", world, path)
        seen = render(seen_from(scene, [(camera, 0.0)]), camera, 0.0, ("rgb", "alpha"), backend)
        image = picture.astype(np.float32) / 255
        mean = uniform_filter(image, (NEIGHBOURHOOD, NEIGHBOURHOOD, 0))
        darkest, brightest = (
            extreme(seen["rgb"], (NEIGHBOURHOOD, NEIGHBOURHOOD, 1)) for extreme in (minimum_filter, maximum_filter)
        )
        off = np.maximum(darkest - mean, mean - brightest).clip(0).mean(-1)
        there = seen["alpha"] > OPAQUE
        return Comparison(there & (off > WRONG), there, ((seen["rgb"].clip(0, 1) - image) ** 2).mean(-1))

    def continued(self, scaffold: Scaffold) -> Scaffold:
        """Return the window's scaffold with the ids of the earlier nodes that go on in it, and new ones for the others."""
        before = self.scene.scaffold
        if before is None:
            return replace(scaffold, ids=self.next_node + np.arange(len(scaffold)))
        before = replace(before, times=before.times - self.scene.cameras.times[self.offset])
        return continue_nodes(scaffold, before, CONTINUES * before.unit, self.next_node)


def _worse(errors: np.ndarray, shared: np.ndarray) -> bool:
    """Return True if frames not `shared (n,)` bool have median squared `errors (n,)` `WORSE` than shared ones, and not `GOOD`.

    Medians, as a frame may be blurred; NaN is a frame that tells nothing.
    """
    known = np.isfinite(errors)
    before, after = errors[known & shared], errors[known & ~shared]
    if not len(before) or not len(after):
        return False
    least = max(10 ** (WORSE / 10) * np.median(before), 10 ** (-GOOD / 10))
    return bool(np.median(after) > least)


def _room(depth: np.ndarray, moving: np.ndarray) -> float:
    """Return the factor by which moving objects may be farther away and still be in front of the surfaces around them."""
    found = []
    for z, mask in zip(depth, moving, strict=True):
        known = np.isfinite(z) & (z > 0)
        inside, around = mask & known, binary_dilation(mask, iterations=AROUND) & ~mask & known
        if inside.any() and around.any():
            found.append(np.percentile(z[around], GROUND_PERCENTILE) / np.median(z[inside]))
    return float(np.median(found)) if found else np.inf


def _median(ratios: np.ndarray, otherwise: float) -> float:
    """Return the median of the finite `ratios`; `otherwise` for fewer than `MIN_PIXELS`."""
    known = ratios[np.isfinite(ratios)]
    return float(np.median(known)) if len(known) >= MIN_PIXELS else otherwise


@dataclass
class WindowFit(ClipFit):
    """The fit of a window that goes on from the one before."""

    previous: PreviousWindow = field(kw_only=True)
    whole: bool = False

    def settings_hash(self) -> str:
        """Return a hash of the settings and of the previous window."""
        return config_hash(super().settings_hash(), self.previous.digest)

    def known_depth(self) -> np.ndarray:
        """Return the depth that the earlier scene shows."""
        return self.previous.depth(self.clip, self.config.backend)

    def make_priors(self) -> Priors:
        """Return the priors of the window, in the world of the one before and seen from cameras that agree with its background."""
        backend, previous = self.config.backend, self.previous
        return previous.track(self.clip, previous.place(super().make_priors(), backend), MASK_MARGIN, backend)

    def start(self, priors: Priors) -> Trainer:
        """Return the trainer, in front of the background that stays."""
        config, frames = self.config, spawn_frames(priors, self.config)
        self.background = self.previous.background(self.clip, priors, frames, MASK_MARGIN, config.backend)
        known = self.background.known(self.previous.scene.next_id)
        return start_fit(self.clip, priors, config, self.progress, known)

    def finish(self, trainer: Trainer) -> FitResult:
        """Return the trained scene, with the background that stayed and the ids of the nodes that continue."""
        result = super().finish(trainer)
        scaffold, labels = result.scene.scaffold, trainer.model.static.labels
        scene = replace(
            result.scene,
            static=self.background.with_own(result.scene.static),
            extra={**result.scene.extra, EARLIER: labels["ids"][labels["earlier"]].numpy()},
            scaffold=None if scaffold is None else self.previous.continued(scaffold),
        )
        return replace(result, scene=scene)


def _tensor(array: np.ndarray) -> torch.Tensor:
    return torch.from_numpy(np.ascontiguousarray(array, np.float32))
