"""Questions about a scene; for Blender in a process of its own (`edit.scene_task`)."""

from __future__ import annotations

import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from ..edit.apply import edited
from ..edit.resolve import named
from ..edit.scene_task import SceneTask
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


@dataclass(frozen=True)
class AskTask(SceneTask):
    """A question, for a process of its own."""

    question: str
    selection: dict[str, Any] | None
    """JSON of the selection that "it" means."""

    def carry_out(self, progress: Progress) -> tuple[dict[str, Any], str]:
        """Answer the question; see `ask`."""
        selected = None if self.selection is None else Selection.from_json(self.selection)
        options = AskOptions(selected, server=ChatServer.from_environment(None))
        found = ask(self.opened(progress), self.question, options, progress=progress)
        return {"answer": found.text, "answered_by": found.answered_by}, f"[{found.answered_by}] {found.text}"


if __name__ == "__main__":
    sys.exit(AskTask.main(sys.argv[1:]))
