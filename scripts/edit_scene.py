"""Append edits to a scene and see them in Blender: a sentence, or a JSON file of operations.

python scripts/edit_scene.py SCENE.f4x --say "make the dog red from second 2" -o RED.f4x --blend RED.blend
blender -b --factory-startup --python-exit-code 1 -P scripts/edit_scene.py -- SCENE.f4x --ops EDITS.json

The edits and the file are those of `f4x edit`; without -o they go into the scene itself.
"""

import argparse
import importlib.util
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
    """Resolve, append, write; then import what was written."""
    options = parse(arguments)
    from feature4x.f4x_core.scene import updating

    with updating(options.scene):  # what another writes between reading and writing would be lost
        return edit(options)


def edit(options: argparse.Namespace) -> dict[str, Any]:
    """Read the scene, append the edits, write it and import what was written."""
    from feature4x.f4x_core.edit.apply import base_of, open_scene, with_operations
    from feature4x.f4x_core.edit.json_files import read_operations
    from feature4x.f4x_core.edit.plan import preview, propose
    from feature4x.f4x_core.edit.resolve import EditorState, resolve
    from feature4x.f4x_core.edit.stack import of, write_stack
    from feature4x.f4x_core.query.labels import encode_labels
    from feature4x.f4x_core.scene import write_scene

    scene, context = open_scene(options.scene), EditorState(frame=options.frame)
    before = len(scene.edits)
    encode = encode_labels if importlib.util.find_spec("torch") else None
    if options.say is not None:
        scene = preview(scene, propose(scene, options.say, context, encode=encode).chosen)
    else:
        for operation in read_operations(options.ops):
            scene = with_operations(scene, resolve(scene, operation, context, encode))
    target = options.output or options.scene
    if options.output is None:
        write_stack(target, of(scene))
    else:
        target.parent.mkdir(parents=True, exist_ok=True)
        write_scene(base_of(scene), target)
    if options.blend is not None:
        door.import_empty(target)
        door.save_blend(options.blend, target.stat().st_size)
    chosen = {step.edit.id: int(step.chosen.sum()) for step in getattr(scene, "steps", ())}
    new = of(scene).edits[before:]
    return {
        "output": str(target),
        "edits": [edit.to_json() for edit in new],
        "gaussians": [chosen.get(edit.id, 0) for edit in new],
        "blend": options.blend and str(options.blend),
    }


door.run(main)
