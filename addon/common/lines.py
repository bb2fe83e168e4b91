"""Text of several lines in a panel, because Blender does not wrap text."""

import textwrap

import bpy

CATEGORY = "Feature4X"
"""Tab of the sidebar."""
LETTER = 7
"""Approximate width of a character in pixels at a UI scale of 1, for wrapping lines."""
MIN_CHARACTERS = 16
"""Minimum length of a line, for a very narrow sidebar."""
BESIDE = 6
"""Characters that icons and margins take."""


def draw_lines(
    layout: bpy.types.UILayout,
    context: bpy.types.Context,
    text: str,
    icon: str = "NONE",
    space: tuple[int, int] = (0, 100),
    beside: int = 0,
) -> None:
    """Draw text, wrapped to the width of the region.

    `space`: least lines that are taken, and most lines that are drawn; `beside`: characters that something in the same row takes.
    """
    min_lines, max_lines = space
    width = int(context.region.width / (LETTER * context.preferences.system.ui_scale))
    lines = [
        part for line in text.splitlines() for part in textwrap.wrap(line, max(width - BESIDE - beside, MIN_CHARACTERS))
    ]
    column = layout.column(align=True)
    for line in (lines + [""] * (min_lines - len(lines)))[:max_lines]:
        column.label(text=line, icon=icon)
        icon = "BLANK1" if icon != "NONE" else "NONE"
