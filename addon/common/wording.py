"""Sentences of the core in the panels' words: a button in place of a verb or an option, and an error with its code."""

import re
from collections.abc import Callable
from functools import wraps

import bpy

from ...f4x_core.printing import one_line
from ...f4x_core.troubles import EXPECTED, with_code
from .undo import leave_mode

_PANEL_WORDS = (
    (r"`?f4x distill [^`.;]*--vocabulary[^`.;]*`?", "Tasks > Features, Words"),
    (r"`f4x distill[^`]*`", "Tasks > Features"),
    (r"`f4x fit[^`]*`", "Tasks > Fit Video"),
    (r"`f4x ask[^`]*`", "Tasks > Question"),
    (r"`f4x query[^`]*`", "Select"),
    (
        r"`f4x render --path slow:([\d.]+)`",
        lambda found: f"Speed {1 / float(found[1]):.3g} in the panel Motion, or the button below,",
    ),
    (r"`f4x render[^`]*unseen`", "The pass Unseen of Feature4X's renders"),
    (r"`f4x export[^`]*`", "Tasks > Export"),
    (r"`f4x bake` (them|the scene)", r"bake \1 (panel Edits)"),
    (r"use `f4x undo[^`]*`(, or the button for it)?", "press Ctrl-Z"),
    (r"`f4x undo[^`]*`", "Ctrl-Z"),
    (
        r"^A clip does not tell how long a metre or a foot is;",
        "Scale to Length first, which tells how long a meter is, or",
    ),
    (r"Add Crop Box in Blender|Scale to Length in Blender", lambda found: found[0].removesuffix(" in Blender")),
    (r"`f4x (\w+)[^`]*`", r"the command f4x \1"),
    (r" Say '.*', or add --yes\.", ""),
    (r"^-o ", ""),
    (r"--time T\b", "Current Frame Only"),
    (r"--profile wild\b", "the profile Thorough"),
    (r"--resume\b", "Continue"),
    (r"--clip CLIP\b|--clip\b", "Clip"),
    (r"--features DIR\b", "the option --features of the command f4x distill"),
    (r"--vocabulary WORDS\b|--vocabulary\b", "Words"),
    (r"--teacher NAME\b|--teacher\b", "Teachers"),
    (r"--(frames|width|format)\b", lambda match: match[1].capitalize()),
    (r"-o FOLDER\b|-o DIR\b", "Folder"),
)


def panel_words(sentence: str) -> str:
    """Return the sentence with the panels' names for verbs and options of `f4x`; options that no panel has stay."""
    for pattern, words in _PANEL_WORDS:
        sentence = re.sub(pattern, words, sentence)
    return sentence


def error_line(error: BaseException) -> str:
    """Return the sentence of an expected error in the panels' words, with its code behind it."""
    return one_line(panel_words(with_code(error)))  # Blender prints it on its terminal, too


def refuse(operator: bpy.types.Operator | bpy.types.RenderEngine, error: BaseException) -> set[str]:
    """Let `operator` report an error; returns what an operator returns that did nothing."""
    operator.report({"ERROR"}, error_line(error))
    return {"CANCELLED"}


class Reporting:
    """Base of all operators: an expected error ends `execute`, `invoke` or `modal` with one report, as `EXPECTED` has it.

    An operator that Ctrl-Z undoes ends in Object Mode: the steps of undo of other modes hold the edited object alone.
    """

    def __init_subclass__(cls, **options) -> None:
        super().__init_subclass__(**options)
        for name in ("execute", "invoke", "modal"):
            if name in vars(cls):
                setattr(cls, name, _reporting(vars(cls)[name]))

    def let_go(self, context: bpy.types.Context) -> None:
        """Give back what `modal` holds of the window; called where an error ends it."""


def _reporting(method: Callable) -> Callable:
    def attempt(operator: Reporting, context: bpy.types.Context, *event: bpy.types.Event) -> set[str]:
        try:
            done = method(operator, context, *event)
        except EXPECTED as error:
            if method.__name__ == "modal":
                operator.let_go(context)
            return refuse(operator, error)
        if "FINISHED" in done and "UNDO" in operator.bl_options:
            leave_mode()
        return done

    if method.__name__ == "execute":  # Blender counts the arguments
        return wraps(method)(lambda self, context: attempt(self, context))
    return wraps(method)(lambda self, context, event: attempt(self, context, event))
