"""What the core says, as the panels show it: a button in place of a verb or an option, and an error with its code."""

import re

import bpy

from ..f4x_core.errors import F4xError
from ..f4x_core.troubles import with_code

_PANEL_WORDS = (
    (r"`?f4x distill [^`.;]*--vocabulary[^`.;]*`?", "Jobs > Add Features, Words"),
    (r"`f4x distill[^`]*`", "Jobs > Add Features"),
    (r"`f4x fit[^`]*`", "Jobs > Fit Video"),
    (r"`f4x ask[^`]*`", "Jobs > Question"),
    (r"`f4x query[^`]*`", "Ask > Query"),
    (r"`f4x export[^`]*`", "Jobs > Export"),
    (r"`f4x bake` (them|the scene)", r"bake \1 with the command f4x bake"),
    (r"`f4x (\w+)[^`]*`", r"the command f4x \1"),
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
    """The sentence with the panels' names for verbs and options of `f4x`; options that no panel has stay."""
    for pattern, words in _PANEL_WORDS:
        sentence = re.sub(pattern, words, sentence)
    return sentence


def error_line(error: F4xError) -> str:
    """What is shown of an error, wherever a user meets it: its sentence in the panels' words, its code behind it."""
    return panel_words(with_code(error))


def refuse(operator: bpy.types.Operator | bpy.types.RenderEngine, error: F4xError) -> set[str]:
    """Let `operator` report an error; returns what an operator returns that did nothing."""
    operator.report({"ERROR"}, error_line(error))
    return {"CANCELLED"}
