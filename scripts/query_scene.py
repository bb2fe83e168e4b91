"""Select what a word, a point or a box means in a scene, in Blender: point attributes .selection and f4x_score.

python scripts/query_scene.py SCENE.f4x --text dog --blend OUT.blend --selection OUT.json
blender -b --factory-startup --python-exit-code 1 -P scripts/query_scene.py -- SCENE.f4x --point 120,80 --frame 5
"""

import argparse
import json
import sys
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).resolve().parent))  # `blender -P` does not add the script's own folder
import door


def parse(arguments: list[str]) -> argparse.Namespace:
    """Read the command line."""
    parser = argparse.ArgumentParser(prog="query_scene.py", description=__doc__.splitlines()[0])
    parser.add_argument("scene", type=door.scene, help="scene file, name.f4x")
    what = parser.add_mutually_exclusive_group(required=True)
    what.add_argument("--text", metavar="WORD[,WORD]", help="labels, for example dog")
    what.add_argument("--point", type=numbers, metavar="X,Y", help="pixel on the object; with --frame")
    what.add_argument("--box", type=numbers, metavar="X0,Y0,X1,Y1", help="left, top, right, bottom; with --frame")
    parser.add_argument("--not", dest="negatives", metavar="WORD[,WORD]", help="what to weigh --text against")
    parser.add_argument("--frame", type=int, default=0, metavar="T", help="clip frame of the point or box (default: 0)")
    parser.add_argument("--threshold", type=float, default=0.5, metavar="P", help="least score, 0 to 1 (default: 0.5)")
    parser.add_argument("--selection", type=Path, metavar="FILE.json", help="also write ids and scores")
    parser.add_argument("--blend", type=Path, metavar="OUT.blend", help="also write a .blend with the selection")
    return parser.parse_args(arguments)


def numbers(text: str) -> list[float]:
    """Parse numbers that are separated by commas."""
    return [float(part) for part in text.split(",")]


def main(arguments: list[str]) -> dict[str, Any]:
    """Import the scene, select, and write the requested files."""
    options = parse(arguments)
    root = door.import_empty(options.scene)
    from feature4x.addon.edits import marking
    from feature4x.addon.scene.scene_object import SELECTED, SceneObject
    from feature4x.f4x_core.app.selecting import Wanted, select
    from feature4x.f4x_core.files import replace_file
    from feature4x.f4x_core.query.labels import words_of
    from feature4x.f4x_core.query.marks import Box, Point

    scene_object = SceneObject(root)
    negatives = None if options.negatives is None else tuple(words_of(options.negatives))
    if options.text is not None:
        wanted = Wanted(tuple(words_of(options.text)), negatives, threshold=options.threshold)
    else:
        point, box = options.point, options.box
        mark = Point(options.frame, True, point) if box is None else Box(options.frame, True, box)
        wanted = Wanted(marks=(mark,), threshold=options.threshold)
    done = select(scene_object.edited, wanted)
    found = done.selection
    marking.ask(scene_object, found)
    if options.selection is not None:
        with replace_file(options.selection) as file:
            file.write(json.dumps(found.to_json()).encode())
    if options.blend is not None:
        door.save_blend(options.blend, options.scene.stat().st_size)
    return {
        "label": found.label,
        "chosen": int(found.chosen.sum()),
        "missing": [word for word, each in done.by_word.items() if not each.chosen.any()],
        "points": int(scene_object.read(SELECTED).sum()),
        "gaussians": len(found.ids),
        "threshold": found.threshold,
        "selection": options.selection and str(options.selection),
        "blend": options.blend and str(options.blend),
    }


door.run(main)
