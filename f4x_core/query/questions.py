"""Answers to questions about a scene: computed from what it knows, or by a server that is shown rendered frames."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import asdict, dataclass, field
from typing import Any, Protocol

import numpy as np

from ..errors import F4xError
from ..geometry.trajectory import Trajectory, original
from ..progress import Progress, silent
from ..scene import Scene
from ..scene.view import render
from .chat import ChatServer, picture_part
from .labels import BACKGROUND, Encode, ask_for, text_head
from .pixels import head_map, text_picture
from .segmentation import connected_regions

COMPUTED, SERVER = "computed", "server"
"""Values of `Answer.answered_by`, besides names of models."""
VIEWS = 8
"""Views, evenly over the trajectory, that are looked at."""
COLUMNS = 96
"""Width in pixels of the pictures on which labels are found."""
PRESENT = 0.01
"""Share of the picture that a label must win in some view to be there."""
PIECE = 0.25
"""A separate region is another thing when it is at least so large, relative to the largest of its label."""
STILL = 0.01
"""World units per view (1 = median depth) below which a thing stands still: about what jitter of the fit gives."""
THING = "something that moves"
"""What moving things are called in a scene that knows no words."""


@dataclass(frozen=True)
class Sighting:
    """What a label's pixels tell over the views."""

    label: str
    """The label."""
    share: float
    """Largest share of the picture, 0..1."""
    place: str
    """Where in the picture, in the view where it is largest: left, middle or right."""
    distance: str
    """near, at middle distance, or far, against the median depth of that view."""
    count: int
    """Number of separate regions in that view."""
    path: float
    """World units (1 = median depth) that the centre of its moving Gaussians travels."""
    frames: tuple[int, int] | None
    """First and last clip frame between which it moves; None = it stands still."""
    heading: str = ""
    """Where it goes in the picture: to the left, right, or nothing."""
    moments: list[float] = field(default_factory=list)
    """Clip times of the views that show it."""


@dataclass(frozen=True)
class Answer:
    """An answer, who gave it, and on what grounds."""

    text: str
    """For people."""
    answered_by: str
    """`computed`, `server`, or the name of a model."""
    evidence: dict[str, Any]
    """JSON: the sightings, or the number of frames that were sent and where to."""


def answer(
    scene: Scene,
    question: str,
    trajectory: Trajectory | None = None,
    *,
    server: ChatServer | None = None,
    encode: Encode | None = None,
    backend: str = "auto",
    progress: Progress = silent,
) -> Answer:
    """Answer `question` about what `trajectory` (the clip's own views when None) shows.

    With `server` rendered frames are sent there. Without, the answer is computed from labels, places and motion in the scene,
    and says so. Raises F4xError: an empty question, a server that does not answer, a label that nobody knows.
    """
    question = " ".join(question.split())
    if not question:
        raise F4xError('The question is empty; ask something, for example "What moves?".')
    views = _spread(original(scene.cameras) if trajectory is None else trajectory)
    if server is not None:
        return ask_server(scene, question, views, server, backend, progress)
    sightings = look(scene, views, _asked_labels(scene, question, encode), encode, backend, progress)
    text = compose(question, sightings, scene.features is not None)
    return Answer(text, COMPUTED, {"views": len(views), "sightings": [asdict(s) for s in sightings]})


def ask_server(
    scene: Scene,
    question: str,
    views: Trajectory,
    server: ChatServer,
    backend: str = "auto",
    progress: Progress = silent,
) -> Answer:
    """Show a server the rendered `views` and pass its answer on."""
    content: list[dict[str, Any]] = []
    for done, (camera, time) in enumerate(views):
        progress("render", done, len(views))
        picture = render(scene, camera, time, ("rgb",), backend)["rgb"]
        content.append({"type": "text", "text": f"Frame at {time / scene.fps:.2f} s:"})
        content.append(picture_part((np.clip(picture, 0, 1) * 255 + 0.5).astype(np.uint8)))
    content.append({"type": "text", "text": question})
    progress("ask", 0, 0, server.url)
    text = server.complete([{"role": "user", "content": content}])
    return Answer(text, SERVER, {"frames": len(views), "url": server.url, "model": server.model})


class FeatureReader(Protocol):
    """A model that answers from feature maps of frames."""

    name: str
    """What `Answer.answered_by` says."""

    def answer(self, features: Sequence[np.ndarray], seconds: Sequence[float], question: str) -> str:
        """The model's words about frames with maps (h,w,C), seen at `seconds`."""
        ...


def ask_features(
    scene: Scene,
    question: str,
    trajectory: Trajectory,
    reader: FeatureReader,
    backend: str = "auto",
    progress: Progress = silent,
    head: str = "smolvlm",
) -> Answer:
    """Let a model answer from the scene's own features `head`, seen along `trajectory`; no picture is encoded."""
    spec = scene.require_field([head]).spec(head)
    views = _spread(trajectory)
    maps = []
    for done, (camera, time) in enumerate(views):
        progress("render", done, len(views))
        maps.append(head_map(scene, head, camera, time, backend))
    text = reader.answer(maps, [time / scene.fps for _, time in views], question)
    return Answer(text, reader.name, {"frames": len(views), "head": head, "grid": list(spec.grid)})


def look(
    scene: Scene,
    views: Trajectory,
    labels: Sequence[str],
    encode: Encode | None = None,
    backend: str = "auto",
    progress: Progress = silent,
) -> list[Sighting]:
    """What can be seen of `labels` in `views`, largest first; without labels, of what moves."""
    query = ask_for(scene, labels, None, None, encode) if labels else None
    names = list(query.labels[: query.targets]) if query else [THING]
    moving = scene.moving
    masks: list[np.ndarray] = []  # per view (n,H,W)
    places: list[np.ndarray] = []  # per view (n,3): centre of the moving part, NaN where there is none
    depths: list[np.ndarray] = []
    for done, (camera, time) in enumerate(views):
        progress("look", done, len(views))
        small = camera.resized(COLUMNS, max(1, round(COLUMNS * camera.height / camera.width)))
        means = scene.posed(time).means
        values = {"moving": np.concatenate([moving[:, None], moving[:, None] * means], 1, dtype=np.float32)}
        drawn = render(scene, small, time, ("depth", "alpha"), backend, values=values)
        layer = drawn["moving"]
        if query is None:
            found = layer[None, ..., 0] > 0.5
        else:
            best = text_picture(scene, query, small, time, backend).argmax(-1)
            found = (best == np.arange(query.targets)[:, None, None]) & (drawn["alpha"] > 0.5)
        masks.append(found)
        depths.append(drawn["depth"])
        weight = found * (layer[..., 0] > 0.5) * layer[..., 0]
        light = weight.sum((1, 2))
        # A centre from a few stray pixels would jump about.
        enough = light > PRESENT * small.width * small.height
        centre = np.einsum("nhw,hwc->nc", weight, layer[..., 1:] / np.maximum(layer[..., :1], 1e-6))
        places.append(np.where(enough[:, None], centre / np.maximum(light, 1e-6)[:, None], np.nan))
    progress("look", len(views), len(views))
    times = np.array([time for _, time in views])
    seen = np.stack(masks)  # (V,n,H,W)
    share = seen.mean((2, 3))
    shown = [_sighting(n, names[n], seen[:, n], share[:, n], np.stack(depths), np.stack(places)[:, n], times, views)
             for n in range(len(names)) if share[:, n].max() >= PRESENT]  # fmt: skip
    return sorted(shown, key=lambda sighting: -sighting.share)


def _sighting(n, label, seen, share, depths, places, times, views) -> Sighting:
    """The numbers of one label; arguments are those of all views."""
    best = int(share.argmax())
    mask, depth = seen[best], depths[best]
    column = np.nonzero(mask)[1].mean() / mask.shape[1]
    ratio = np.nanmedian(depth[mask]) / np.nanmedian(depth) if np.isfinite(depth[mask]).any() else 1.0
    regions = connected_regions(mask.astype(int))
    sizes = np.unique(regions[mask], return_counts=True)[1]
    steps = np.linalg.norm(np.diff(places, axis=0), axis=1)
    steps = np.where(np.isfinite(steps), steps, 0) * (np.diff(times) != 0)
    moves = np.flatnonzero(steps > STILL)
    frames = (round(float(times[moves[0]])), round(float(times[moves[-1] + 1]))) if len(moves) else None
    heading = ""
    if frames is not None:
        known = np.flatnonzero(np.isfinite(places[:, 0]))
        camera = views[int(known[len(known) // 2])].camera
        ends, _ = camera.project(places[known[[0, -1]]].astype(np.float64))
        drift = (ends[1, 0] - ends[0, 0]) / camera.width
        heading = "" if abs(drift) < 0.05 else "to the right" if drift > 0 else "to the left"
    return Sighting(
        label,
        float(share[best]),
        "on the left" if column < 0.38 else "on the right" if column > 0.62 else "in the middle",
        "near" if ratio < 0.8 else "far" if ratio > 1.25 else "at middle distance",
        int((sizes >= PIECE * sizes.max()).sum()),
        float(steps[moves].sum()),
        frames,
        heading,
        times[share >= PRESENT].tolist(),
    )


INTENTS = (
    ("order", r"\border\b|\bfirst\b|\blast\b|\bbefore\b|\bafter\b"),
    ("count", r"\bhow many\b|\bnumber of\b|\bcount\b"),
    ("far", r"\bhow far\b|\bdistance\b|\bhow much\b"),
    ("when", r"\bwhen\b|\bmov(e|es|ing)\b|\bgo(es|ing)?\b|\bwalk|\brun|\bswim|\bdriv"),
    ("where", r"\bwhere\b|\bleft\b|\bright\b|\bnear(er)?\b|\bclose"),
)
"""What a question wants to know, by the first pattern that it contains; else everything."""


def compose(question: str, sightings: Sequence[Sighting], knows_words: bool) -> str:
    """The sentences for a question, with the note that they are computed."""
    intent = next((name for name, pattern in INTENTS if re.search(pattern, question.lower())), "what")
    moving = sorted((s for s in sightings if s.frames), key=lambda s: s.frames[0] if s.frames else 0)
    if not sightings:
        told = "I find nothing of that in these views."
    elif intent == "order":
        names = ", then ".join(f"{s.label} (frame {s.frames[0]})" for s in moving if s.frames)
        told = f"In the order in which they start to move: {names}." if moving else "Nothing moves."
    elif intent == "count":
        told = " ".join(f"{s.label}: {s.count}." for s in sightings)
    elif intent in ("far", "when"):
        told = " ".join(_motion(s) for s in (moving or sightings))
    elif intent == "where":
        told = " ".join(f"The {s.label} is {s.place}, {s.distance}." for s in sightings)
    else:
        told = " ".join(
            f"{s.label}: {s.place}, {s.distance}, {s.share:.0%} of the picture. {_motion(s)}" for s in sightings
        )
    limits = "labels, places and motion in the scene" if knows_words else "motion in the scene, which knows no words"
    return f"{told} (Computed from {limits}; no language model was asked.)"


def _spread(trajectory: Trajectory) -> Trajectory:
    """`VIEWS` views, evenly over a trajectory."""
    if not trajectory:
        raise F4xError("The camera path has no view; give one with at least one camera.")
    count = min(VIEWS, len(trajectory))
    return [trajectory[i] for i in np.linspace(0, len(trajectory) - 1, count).round().astype(int)]


def _motion(sighting: Sighting) -> str:
    if sighting.frames is None:
        return f"The {sighting.label} stands still."
    first, last = sighting.frames
    way = f" {sighting.heading}" if sighting.heading else ""
    return f"The {sighting.label} moves{way} from frame {first} to {last}, {sighting.path:.2f} times the median depth."


def _asked_labels(scene: Scene, question: str, encode: Encode | None) -> list[str]:
    """Labels that the question names, singular or plural; else all things of the vocabulary; none without words."""
    if scene.features is None or not any(head.spec.text_encoder for head in scene.features.heads):
        return []
    encoder = text_head(scene).spec.text_encoder
    known = scene.features.vocabularies.get(encoder or "")
    if known is None:
        return []
    text = question.lower()
    named = [label for label in known.labels if re.search(rf"\b{re.escape(label.lower())}(s|es)?\b", text)]
    return named or [label for label in known.labels if label not in BACKGROUND]
