"""An operation is one file: the example of docs/extending.md goes from a sentence to a baked scene and a saved history."""

import json
import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

from f4x_core.edit.operations import kinds

ROOT = Path(__file__).parents[2]
GENERAL = "apply bake change clauses commands description display english judge keys language merging plan plan_lines reply resolve"
"""Files that ask operations by their protocol."""
NOT_ASKED = {"bake": {"Delete", "Name"}}
"""Operations that a file makes itself."""

PROGRAM = """
import json, sys
from pathlib import Path

import numpy as np
import f4x_core.edit.operation as folder

folder.__path__.append(sys.argv[1])
sys.path.insert(0, sys.argv[2])
from labelled_scene import labelled_scene

from f4x_core.edit import reply
from f4x_core.edit.apply import edited, open_scene
from f4x_core.edit.bake import bake
from f4x_core.edit.plan import apply, preview, propose
from f4x_core.edit.plan_lines import plan_lines
from f4x_core.edit.stack import read_stack, undo
from f4x_core.scene import write_scene

path = Path(sys.argv[1]) / "scene.f4x"
write_scene(labelled_scene(), path)
scene = open_scene(path)
candidate = propose(scene, sys.argv[3]).chosen
seen = preview(scene, candidate).posed(3.0)
apply(path, candidate)
saved = open_scene(path)
changed = (seen.sh != scene.posed(3.0).sh).any((1, 2))
print(json.dumps({
    "plan": list(plan_lines(scene, candidate.operations)),
    "inverted": bool((seen.sh[changed] == -scene.posed(3.0).sh[changed]).all()),
    "dynamic": bool((changed == scene.moving).all()),
    "saved": bool((saved.posed(3.0).sh == seen.sh).all()),
    "history": [edit.to_json()["op"] for edit in read_stack(path).edits],
    "baked": bool(np.allclose(edited(bake(saved)).posed(3.0).sh, seen.sh)) and not bake(saved).edits,
    "model": "InvertReply" in json.dumps(reply.schema_of(reply.ChangeList)),
    "undone": len(undo(path).edits),
}))
"""


@pytest.mark.parametrize(
    ("sentence", "plan"),
    [
        ("invert the square", "invert the square (6.7 % of the scene's Gaussians)"),
        ("could I get a negative of what moves?", "invert what moves (6.7 % of the scene's Gaussians)"),
    ],
)
def test_the_operation_of_the_documents_is_whole(tmp_path, sentence, plan):
    text = (ROOT / "docs" / "extending.md").read_text(encoding="utf-8")
    example = next(one for one in re.findall(r"```python\n(.*?)```", text, re.S) if "(ColorChange)" in one)
    assert len([line for line in example.splitlines() if line and not line.startswith(("from", '"'))]) <= 20
    (tmp_path / "invert.py").write_text(example, encoding="utf-8")
    command = [sys.executable, "-c", PROGRAM, str(tmp_path), str(Path(__file__).parent), sentence]
    done = subprocess.run(command, cwd=ROOT, env=os.environ | {"PYTHONPATH": str(ROOT)}, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    found = json.loads(done.stdout.splitlines()[-1])
    assert found.pop("plan") == [plan]
    assert found.pop("history") == ["invert"] and found.pop("undone") == 0
    assert all(found.values()), found


def test_general_rooms_know_no_operation_by_name():
    names = {kind.__name__ for kind in kinds()}
    for room in GENERAL.split():
        text = (ROOT / "f4x_core" / "edit" / f"{room}.py").read_text(encoding="utf-8")
        imported = set(re.findall(r"\w+", " ".join(re.findall(r"^from \.operations? import ([^\n]+)", text, re.M))))
        assert imported & names <= NOT_ASKED.get(room, set()), room
