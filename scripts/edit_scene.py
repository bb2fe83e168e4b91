"""Append edits to a scene and see them in Blender: a sentence, or a JSON file of operations.

python scripts/edit_scene.py SCENE.f4x --say "make the dog red from second 2" -o RED.f4x --blend RED.blend
blender -b --factory-startup --python-exit-code 1 -P scripts/edit_scene.py -- SCENE.f4x --ops EDITS.json

The edits and the file are those of `f4x edit`; without -o they go into the scene itself.
"""

import argparse
import sys
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).resolve().parent))  # `blender -P` does not add the script's own folder
import door


def parse(arguments: list[str]) -> argparse.Namespace:
    """Read the command line."""
    parser = argparse.ArgumentParser(prog="edit_scene.py", description=__doc__.splitlines()[0])
    parser.add_argument("scene", type=door.scene, help="scene file, name.f4x")
    instruction = parser.add_mutually_exclusive_group(required=True)
    instruction.add_argument("--say", metavar="SENTENCE", help="what to do")
    instruction.add_argument("--ops", type=Path, metavar="FILE", help="JSON: a list of operations")
    parser.add_argument(
        "--frame", type=float, default=0.0, metavar="T", help="clip frame that is looked at: here and now"
    )
    parser.add_argument("-o", "--output", type=Path, metavar="SCENE2", help="write there (default: the scene itself)")
    parser.add_argument("--blend", type=Path, metavar="OUT.blend", help="also write a .blend that shows the edits")
    return parser.parse_args(arguments)


def main(arguments: list[str]) -> dict[str, Any]:
    """Append the edits, write the scene, then import what was written."""
    options = parse(arguments)
    from feature4x.f4x_core.app.editing import EditRequest, edit_file
    from feature4x.f4x_core.edit.json_files import read_operations
    from feature4x.f4x_core.edit.plan_lines import plan_lines
    from feature4x.f4x_core.edit.resolve import EditorState

    operations = () if options.ops is None else tuple(read_operations(options.ops))
    source = "" if options.ops is None else str(options.ops)
    request = EditRequest(options.say or "", operations, source, EditorState(frame=options.frame))
    if options.output is not None:
        options.output.parent.mkdir(parents=True, exist_ok=True)
    edited = edit_file(options.scene, request, options.output)
    target = options.output or options.scene
    if options.blend is not None:
        door.import_empty(target)
        door.save_blend(options.blend, target.stat().st_size)
    chosen = {step.edit.id: int(step.chosen.sum()) for step in getattr(edited.after, "steps", ())}
    return {
        "output": str(target),
        # in words: the ids that an operation keeps are a long line of no use to a reader
        "edits": list(plan_lines(edited.before, [edit.operation for edit in edited.new], options.frame)),
        "gaussians": [chosen.get(edit.id, 0) for edit in edited.new],
        "blend": options.blend and str(options.blend),
    }


door.run(main)
