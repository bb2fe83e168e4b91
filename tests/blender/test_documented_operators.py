"""docs/blender.md lists every operator of the extension with its parameters and their defaults."""

import json
import re
from pathlib import Path

from .artist import perform

PAGE = Path(__file__).resolve().parents[2] / "docs" / "blender.md"
LISTED = """
PASSED = ("rna_type", "check_existing", "files")  # of Blender's file dialogs

def default(found):
    if found.type in ("INT", "FLOAT"):
        values = found.default_array if found.is_array else [found.default]
        texts = [f"{round(value, 3):g}" for value in values]
        return f"({', '.join(texts)})" if found.is_array else texts[0]
    if found.type == "COLLECTION":
        return "…"
    return str(found.default) if found.type == "BOOLEAN" else f'"{found.default}"'

for name in dir(bpy.ops.f4x):
    found = getattr(bpy.ops.f4x, name).get_rna_type().properties
    kept = [one for one in found if one.identifier not in PASSED and not one.identifier.startswith("filter_")]
    noted[name] = ", ".join(f"{one.identifier}={default(one)}" for one in kept)
"""


def test_every_operator_is_listed_with_its_parameters(tmp_path):
    noted, _ = perform(tmp_path, LISTED)
    listed = dict(re.findall(r"^\| `(\w+)\((.*?)\)` \|", PAGE.read_text(encoding="utf-8"), re.MULTILINE))
    assert len(noted) > 60 and listed == noted, json.dumps({n: noted[n] for n in noted if listed.get(n) != noted[n]})
