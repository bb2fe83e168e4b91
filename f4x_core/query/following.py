"""Masks on some frames, followed through the clip in feature space and lifted to Gaussians. Needs numpy alone."""

from __future__ import annotations

from collections.abc import Iterable, Mapping

import numpy as np

from ..geometry import spherical_harmonics
from ..geometry.arrays import evenly_spaced
from ..progress import Progress, silent
from ..scene import Scene
from .blend_weights import lift_masks
from .objects import graph_of, held_movers
from .pixels import SHOWN, coverage_by
from .score import logistic
from .segmentation import FeaturePropagation
from .select_config import SELECT, FollowConfig, SelectConfig
from .smoothing import field_of_looks
from .views import views_of

KNOWN, BLOCK = 1024, 4096
"""Gaussians with scores that are enough to say what is near, and Gaussians without that are compared with them at once: a block
of distances stays small."""


def follow_thing(
    scene: Scene,
    chosen: np.ndarray,
    frames: Iterable[int],
    config: SelectConfig = SELECT,
    backend: str = "auto",
    progress: Progress = silent,
) -> np.ndarray:
    """Return scores (N,) of the thing that the Gaussians `chosen (N,)` show on clip `frames`, followed to all others by its look.

    Superpoints know well where a thing ends on the frame that was marked, and less well what becomes of it: a fast thing is
    made of Gaussians that come and go. `chosen` comes back where it stands, where the scene has no visual features, and where
    `config.follow` lifts no frames. Where nothing of it is cast on the background, nothing of that is found.
    """
    if not config.follow.lifted or field_of_looks(scene) is None or not chosen[scene.moving].any():
        return chosen
    decoder, masks = decoder_of(scene, backend), {}
    for frame in sorted(set(frames)):
        camera, time = scene.cameras[frame], float(scene.cameras.times[frame])
        mask = coverage_by(scene, chosen, camera, time, backend) > SHOWN
        if mask.any():
            decoder.prompt(frame, mask)
            masks[frame] = mask.astype(np.float32)
    if not masks:
        return chosen
    scores = follow_masks(scene, masks, decoder, config.follow, progress) * scene.moving
    superpoints = graph_of(scene, config).moving
    # Whole superpoints, a thing's own Gaussians among them: without those a click on dog loses .025 of J (.897 to .872).
    cast = superpoints.spread(superpoints.cast.astype(float), len(scores)) > 0
    return scores if chosen[cast].any() else np.where(cast, 0, scores)


def follow_masks(
    scene: Scene,
    prompted: Mapping[int, np.ndarray],
    decoder: FeaturePropagation,
    config: FollowConfig,
    progress: Progress = silent,
) -> np.ndarray:
    """Return scores (N,) in [0, 1]: blend weights inside the `decoder`'s masks; their neighbours' mean for unseen ones.

    `prompted`: clip frame -> mask (H,W) of the frames that the decoder was prompted on. If these masks are clearly on moving or on
    static Gaussians, only those have scores.
    """
    fraction, total = lift_masks(scene, prompted, progress)
    held, others = held_movers(scene, fraction * total, total)
    held &= total <= config.min_blend_weight  # what comes to light later
    total = config.prompted_weight * total
    inside = fraction * total
    moves = inside[scene.moving].sum() / max(inside.sum(), 1e-12)
    both = 1 - config.one_kind < moves < config.one_kind
    meant = (both | (scene.moving == (moves >= config.one_kind))) & ~others
    views = views_of(scene)
    wanted = set(evenly_spaced(len(scene.cameras), config.lifted)) - set(prompted)
    for done, (frame, logits) in enumerate(decoder.propagate() if wanted else ()):
        progress("follow", done, len(scene.cameras))
        if frame in wanted:
            seen = views.seen(scene, frame)
            inside[seen.rows] += seen.weights * logistic(logits)[seen.pixels]
            total[seen.rows] += seen.weights
    lost = held & (inside[held].sum() < SHOWN * total[held].sum())  # a mover's path tells more than how it looks then
    scores = np.where(lost, 1, np.clip(inside / np.maximum(total, 1e-12), 0, 1))
    return _from_neighbours(scene, scores, lost | (total > config.min_blend_weight), meant, config)


def draw_views(scene: Scene, config: FollowConfig | None = None) -> None:
    """Draw what following a moving thing needs, if this scene's things can be followed, so that the first is as quick as others."""
    if field_of_looks(scene) is None or not scene.moving.any():
        return
    views, count = views_of(scene), len(scene.cameras)
    for frame in range(count):
        views.appearance(scene, frame)
    for frame in evenly_spaced(count, (config or FollowConfig()).lifted):
        views.seen(scene, int(frame))


def decoder_of(scene: Scene, backend: str = "auto") -> FeaturePropagation:
    """Return the decoder that needs no model: nearest neighbours in the appearance of the scene (`views`).

    Without `visual` features only what differs in colour, place, motion and depth is told apart.
    """
    cameras, views = scene.cameras, views_of(scene)
    size = (cameras.height, cameras.width)
    return FeaturePropagation(lambda t: views.appearance(scene, t, backend), len(cameras), size)


def _from_neighbours(
    scene: Scene, scores: np.ndarray, seen: np.ndarray, meant: np.ndarray, config: FollowConfig
) -> np.ndarray:
    """Return scores (N,), 0 except for `meant (N,)`, of which those that no lifted frame sees get the mean of similar ones.

    That is of the nearest `seen (N,)` ones that move or stand as they do, in colour and in place on the first frame.
    """
    scores = scores * meant
    posed = scene.posed(float(scene.cameras.times[0]))
    places = np.concatenate([posed.means, config.colour_weight * spherical_harmonics.rgb_from_dc(posed.sh[:, 0])], 1)
    for kind in (posed.dynamic, ~posed.dynamic):
        missing, known = np.flatnonzero(kind & meant & ~seen), np.flatnonzero(kind & seen & meant)
        if not len(known):
            scores[missing] = 0
            continue
        if len(known) > KNOWN:
            known = known[np.linspace(0, len(known) - 1, KNOWN).astype(int)]
        squares = (places[known] ** 2).sum(1)
        for part in np.array_split(missing, max(1, len(missing) // BLOCK)):
            far = squares - 2 * places[part] @ places[known].T
            count = min(config.neighbours, len(known))
            near = np.argpartition(far, count - 1, axis=1)[:, :count]
            scores[part] = scores[known[near]].mean(1)
    return scores
