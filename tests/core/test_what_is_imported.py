"""Each verb imports what it uses, within a budget of processor time and memory; a pattern of words is matched as it is written."""

import ast
import json
import os
import random
import subprocess
import sys
from itertools import product
from pathlib import Path

import pytest
from labelled_scene import labelled_scene

from f4x_core.edit.operations import Delete
from f4x_core.edit.selects import All
from f4x_core.edit.stack import EditStack, undo, write_stack
from f4x_core.language.grammar import Reading, split, table
from f4x_core.scene import write_scene

ROOT = Path(__file__).resolve().parents[2]
GRAMMAR = {"f4x_core.language.grammar", "f4x_core.edit.language", "f4x_core.edit.phrases", "f4x_core.query.wording"}
"""Modules that only a sentence or a question needs."""
HEAVY = {
    "torch",
    "scipy",
    "matplotlib",
    "cv2",
    "av",
    "PIL",
    "pycolmap",
    "transformers",
    "OpenEXR",
    "trimesh",
    "pydantic",
}
ATTEMPTS = 3
"""Runs of which the cheapest counts: other programs share caches and cores, and the first run compiles modules."""
VERB = "from f4x_core.cli import main; assert main(sys.argv[1:]) == 0"
DRAW = "import f4x_core as f; f.render, f.read_scene, f.write_scene"
REPORT = """
import json, time
report = {"modules": sorted(sys.modules), "seconds": time.process_time()}
if sys.platform == "linux":  # getrusage would count what the process was forked from
    with open("/proc/self/status") as status:
        report["megabytes"] = next(int(line.split()[1]) / 1024 for line in status if line.startswith("VmHWM"))
print("\\n" + json.dumps(report))
"""
SAID = """
import json, sys, time
for name in ("torch", "cv2", "av", "scipy", "PIL", "pycolmap", "bpy"):
    sys.modules[name] = None
from importlib import import_module
for module in sys.argv[2:]:
    import_module(module)
from f4x_core.scene import read_scene
scene = read_scene(sys.argv[1])
before = time.process_time()
from f4x_core.edit.plan import propose
propose(scene, "make the square red from frame 2 on")
spent = time.process_time() - before
import gc
from f4x_core.language.grammar import Bracket, _Table
tables = [one.rows for one in gc.get_objects() if isinstance(one, _Table) and "rows" in vars(one)]
brackets = [one.phrases for one in gc.get_objects() if isinstance(one, Bracket)]
print(json.dumps({"seconds": spent, "phrases": sum(len(rows) for one in tables + brackets for rows in one.values())}))
"""


def modules_of_the_extension():
    """Modules of the core that Blender has imported before the first sentence: those that the extension imports at its top."""
    found = set()
    for file in sorted((ROOT / "addon").rglob("*.py")):
        for node in ast.parse(file.read_text(encoding="utf-8")).body:
            if isinstance(node, ast.ImportFrom) and node.level == 3 and (node.module or "").startswith("f4x_core."):
                found.add(node.module)
    assert len(found) > 20
    return sorted(found)


@pytest.fixture(scope="module")
def scene(tmp_path_factory):
    """The file of a scene with an edit, and one that was undone."""
    path = tmp_path_factory.mktemp("scene") / "scene.f4x"
    edits = EditStack().append(Delete(All(), (2, 3))).append(Delete(All(), (4, 5)))
    write_scene(labelled_scene(), path)
    write_stack(path, edits)
    undo(path)
    return path


@pytest.fixture(scope="module")
def child(tmp_path_factory):
    """Run a program, with modules that are compiled from its second run on; what its last line prints as JSON."""
    environment = {name: value for name, value in os.environ.items() if name != "PYTHONDONTWRITEBYTECODE"}
    environment |= {"PYTHONPYCACHEPREFIX": str(tmp_path_factory.mktemp("compiled")), "PYTHONPATH": str(ROOT)}

    def run(program, *arguments):
        command = [sys.executable, "-c", program, *map(str, arguments)]
        done = subprocess.run(command, cwd=ROOT, env=environment, capture_output=True, text=True)
        assert done.returncode == 0, done.stderr
        return json.loads(done.stdout.splitlines()[-1])

    return run


@pytest.mark.parametrize(
    "arguments",
    [
        ("undo",),
        ("redo",),
        ("info",),
        ("history",),
        ("export", "-o", "out.ply", "--time", "0"),
        ("render", "-o", "out.d", "--frames", "0:1:1"),
    ],
    ids=lambda arguments: arguments[0],
)
def test_a_verb_that_reads_no_sentence_loads_no_grammar(scene, child, tmp_path, arguments):
    verb, *options = (str(tmp_path / one) if one.startswith("out.") else one for one in arguments)
    loaded = {*child(f"import sys; {VERB}{REPORT}", verb, scene, *options)["modules"]}
    assert not loaded & {*GRAMMAR, "torch", "f4x_core.query.questions"}


def test_the_extension_starts_without_the_grammar(child):
    imports = "from importlib import import_module; [import_module(one) for one in sys.argv[1:]]"
    loaded = {*child(f"import sys; {imports}{REPORT}", *modules_of_the_extension())["modules"]}
    assert not loaded & ({*GRAMMAR, *HEAVY} - {"f4x_core.language.grammar"})  # which says what a doubt is


def test_who_draws_reads_and_writes_scenes_needs_numpy_alone_and_starts_cheaply(child):
    runs = [child(f"import sys; {DRAW}{REPORT}") for _ in range(ATTEMPTS)]
    spared = {*GRAMMAR, *HEAVY, "rich", "argparse", "urllib.request", "f4x_core.query.questions"}
    assert not spared.intersection(runs[0]["modules"])
    assert min(run["seconds"] for run in runs) <= 0.6
    assert min(run.get("megabytes", 0) for run in runs) <= 80


def test_the_history_starts_cheaply(scene, child):
    runs = [child(f"import sys; {VERB}{REPORT}", "history", scene) for _ in range(ATTEMPTS)]
    assert min(run["seconds"] for run in runs) <= 0.5


def test_the_first_sentence_said_in_blender_is_cheap(scene, child):
    runs = [child(SAID, scene, *modules_of_the_extension()) for _ in range(ATTEMPTS)]
    assert min(run["seconds"] for run in runs) <= 0.3
    assert 0 < runs[0]["phrases"] <= 20_000


def expanded(spec):
    """Every sequence of words that a pattern stands for, in the order in which they are preferred."""
    for alternative in split(spec):
        choices = [
            [*expanded(part[1:-1])] + [()] * (part[0] == "(") if part[0] in "([" else [(part,)]
            for part in split(alternative, " ")
        ]
        yield from filter(None, (tuple(word for words in choice for word in words) for choice in product(*choices)))


def random_pattern(rng, depth=3):
    """Alternatives of words and brackets, brackets in brackets too."""
    return "|".join(
        " ".join(
            f"({random_pattern(rng, depth - 1)})" if (kind := rng.random()) < 0.2 and depth else
            f"[{random_pattern(rng, depth - 1)}]" if kind < 0.4 and depth else rng.choice("abc")
            for _ in range(rng.randint(1, 3))
        )
        for _ in range(rng.randint(1, 3))
    )  # fmt: skip


def test_a_pattern_matches_what_its_expansion_would():
    rng = random.Random(0)
    for _ in range(200):
        entries = {random_pattern(rng, 2): value for value in ("first", "second")}
        rule = table(entries, vocabulary=set())
        rows = [(words, value) for spec, value in entries.items() for words in expanded(spec)]
        assert rule.first == {words[0] for words, _ in rows}
        sentence = " ".join(rng.choices("abc", k=8))
        reading = Reading(sentence)
        words = [token.text for token in reading.tokens]
        for at in range(len(words)):
            wanted = {}
            for row, value in sorted(rows, key=lambda row: -len(row[0])):
                if tuple(words[at : at + len(row)]) == row:
                    wanted.setdefault(at + len(row), (value,))
            assert list(rule.at(reading, at).items()) == list(wanted.items())


def test_a_pattern_that_stands_for_more_sequences_than_memory_holds_is_matched_at_once():
    spec, words = " ".join(["[a|b|(a) b (a)]"] * 40), "a b " * 20
    assert 40 in table({spec: None}, vocabulary=set()).at(Reading(words), 0)
