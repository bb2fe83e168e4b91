"""The words of Blender's interface are spelled as Blender's own is: American."""

import ast
import re
from collections.abc import Iterator
from pathlib import Path

import pytest

ADDON = Path(__file__).resolve().parents[2] / "addon"
BRITISH = re.compile(
    r"colour|centre|grey|stabilis|neighbour|behaviour|organis|normalis|recognis|metres?\b|licence", re.IGNORECASE
)
SHOWN = {"name", "description", "text", "placeholder", "bl_label", "bl_description", "hint", "title"}
"""Keyword arguments and attributes whose text is shown."""


def shown(tree: ast.AST) -> Iterator[str]:
    """Labels, descriptions, tooltips and reports of a module."""
    for node in ast.walk(tree):
        if isinstance(node, ast.ClassDef) and re.match(r"F4X_OT_", node.name):
            yield ast.get_docstring(node) or ""
        values: list[ast.expr] = []
        if isinstance(node, ast.keyword) and node.arg in SHOWN:
            values = [node.value]
        elif isinstance(node, ast.Assign):
            targets = [target for one in node.targets for target in (one.elts if isinstance(one, ast.Tuple) else [one])]
            if any(isinstance(target, ast.Name) and target.id in SHOWN for target in targets):
                values = [node.value]
        elif (
            isinstance(node, ast.Call)
            and isinstance(node.func, ast.Attribute)
            and node.func.attr in ("report", "label")
        ):
            values = [*node.args]
        elif (
            isinstance(node, ast.Tuple)
            and len(node.elts) >= 3
            and all(isinstance(one, ast.Constant) for one in node.elts)
        ):
            values = [*node.elts[1:3]]  # an entry of a menu
        for value in values:
            yield from (
                one.value for one in ast.walk(value) if isinstance(one, ast.Constant) and isinstance(one.value, str)
            )


@pytest.mark.parametrize("file", sorted(ADDON.rglob("*.py")), ids=lambda file: file.stem)
def test_the_interface_is_in_american_english(file):
    texts = list(shown(ast.parse(file.read_text(encoding="utf-8"))))
    wrong = [text for text in texts if BRITISH.search(re.sub(r"f4x\.\w+", "", text))]
    assert not wrong


def test_the_check_sees_labels_menus_and_tooltips():
    module = """
class F4X_OT_one(Operator):
    \'\'\'Choose a colour.\'\'\'
    bl_idname, bl_label = "f4x.recolour", "Centre"
    rgb: Prop(name="Grey")
    items = (("a", "Stabilise", "b"),)
"""
    assert len([text for text in shown(ast.parse(module)) if BRITISH.search(text)]) >= 4
