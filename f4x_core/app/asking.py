"""Questions about a scene."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from ..edit.apply import edited
from ..edit.resolve import named
from ..geometry.trajectory import Trajectory, original
from ..progress import Progress, silent
from ..query.chat import ChatServer
from ..query.engines import Engines
from ..query.questions import Answer, answer, ask_features
from ..query.selection import Selection
from ..scene import Scene
from .encoding import encoder


@dataclass(frozen=True, eq=False)
class AskOptions:
    """The context of a question: the thing that "it" means, the views, and the model that answers."""

    selection: Selection | None = None
    """The thing that "it" means."""
    views: Trajectory | None = None
    """The views; None: the clip's own."""
    server: ChatServer | None = None
    """Server to which rendered frames are sent; None: nothing is sent, the answer is computed here."""
    model: Path | None = None
    """Folder of SmolVLM2, which answers from the scene's smolvlm features; None: no model is loaded."""
    agreed: bool = False
    """A doubtful question is read as what was probably meant; else `language.grammar.Doubt` asks."""


def ask(
    scene: Scene, question: str, options: AskOptions | None = None, backend: str = "auto", progress: Progress = silent
) -> Answer:
    """Answer a question about the scene with its edits, as `f4x ask` does.

    Raises:
        F4xError: an empty question, one that cannot be computed, a word that nobody knows, or a time outside the clip.
    """
    scene, options = edited(scene), options or AskOptions()
    if options.model is not None:
        from ..features.models.smolvlm import SmolVlm

        views = original(scene.cameras) if options.views is None else options.views
        return ask_features(scene, question, views, SmolVlm(options.model), Engines(None, None, backend, progress))
    engines = Engines(options.server, encoder(progress), backend, progress)
    names = named(scene, options.selection)
    return answer(scene, question, options.views, engines, names=names, agreed=options.agreed)
