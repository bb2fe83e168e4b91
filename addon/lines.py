"""Text of more than one line in a panel, which Blender does not break by itself."""

import textwrap

import bpy

LETTER = 7
"""Pixels of a letter, about, at a scale of 1: lines are broken by it."""
LEAST = 16
"""Letters of a line in a sidebar that was made very narrow."""
BESIDE = 6
"""Letters that icons and margins take."""


def draw_lines(
    layout: bpy.types.UILayout, context: bpy.types.Context, text: str, icon: str = "NONE", most: int = 100
) -> None:
    """Text in as many lines as the region's width wants, `most` of them."""
    width = int(context.region.width / (LETTER * context.preferences.system.ui_scale))
    lines = [part for line in text.splitlines() for part in textwrap.wrap(line, max(width - BESIDE, LEAST))]
    column = layout.column(align=True)
    for line in lines[:most]:
        column.label(text=line, icon=icon)
        icon = "BLANK1" if icon != "NONE" else "NONE"
