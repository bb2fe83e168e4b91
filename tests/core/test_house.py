"""The house rules that a reader relies on: which room imports which, what stays free of torch, what never runs."""

import ast
import re
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from functools import lru_cache
from graphlib import CycleError, TopologicalSorter
from pathlib import Path
from typing import Any

import pytest

ROOT = Path(__file__).resolve().parents[2]
ROOMS = (
    *(
        "native",
        "geometry",
        "language",
        "clip",
        "priors",
        "scaffold",
        "gaussians",
        "raster",
        "features",
        "people",
        "scene",
        "metrics",
        "evaluation",
        "fit",
        "report",
        "windows",
        "query",
        "edit",
    ),
    *("app", "api", "batch", "agent", "cli"),
)
"""In the order data flows: a room imports itself and rooms to its left."""
EXTENSION = ("common", "jobs", "scene", "rig", "edits", "io", "render", "operators", "ui")
"""Folders of `addon`, in the same order; `registration` alone stands above them."""
GROUND = ("errors", "files", "progress", "processes", "printing", "installation", "reading", "troubles", "versions")
"""Modules below all rooms that need numpy at most."""
SHARED = (*GROUND, "page", "parallel", "__init__", "__main__")
"""Common ground below all rooms, and the two doors."""
DOORS = ("f4x_core/__init__.py", "f4x_core/__main__.py")
"""They name rooms: the first one to type checkers alone, to programs lazily."""
NUMPY_ONLY = ("native", "geometry", "language", "clip", "scene", "query", "edit", "app", "api", *GROUND)
"""Imported by Blender's own Python: numpy is the only wheel there."""
FITS = tuple(f"f4x_core/app/{name}.py" for name in ("distilling", "fit_options", "fitting", "granting", "refitting"))
"""Modules of a room of numpy alone that fit: the worker imports them, Blender does not."""
TORCH_FREE = (*NUMPY_ONLY, "priors", "people", "batch", "agent", "parallel")
WHEELS = {"torch", "cv2", "av", "scipy", "PIL", "pycolmap", "matplotlib", "OpenEXR", "rich", "trimesh"}
UNSAFE_MODULES = {"pickle", "cPickle", "_pickle", "dill", "cloudpickle", "joblib", "marshal", "shelve"}
UNSAFE_CALLS = {"eval", "exec", "os.system", "os.popen", "subprocess.getoutput", "subprocess.getstatusoutput"}


def sources(*folders: str) -> list[Path]:
    return [file for folder in folders for file in sorted((ROOT / folder).rglob("*.py"))]


CORE = sources("f4x_core")
LABORATORY = sources("benchmarks")
EVERYTHING = [*CORE, *LABORATORY, *sources("addon", "ground_truth", "scripts", "tools")]
DOOR = "f4x_core/cli/laboratory.py"
"""The one file of the core that loads `benchmarks`, by importlib, where a checkout has it."""


def name_of(file: Path) -> str:
    return file.relative_to(ROOT).as_posix()


@dataclass(frozen=True)
class Facts:
    """All that is asked of a file, found in one reading: trees of all files would fill the memory."""

    imported: tuple[str, ...]
    """Dotted modules of all imports; relative ones made absolute."""
    used: tuple[str, ...]
    """Those that running it may import, in functions too: not those for type checkers alone."""
    loaded: frozenset[str]
    """First parts of the modules that importing it imports."""
    wrong_arrows: list[str]
    laboratory_names: list[str]
    unsafe: list[str]
    docstring: str | None

    @property
    def tops(self) -> set[str]:
        """First parts of all imported modules."""
        return {module.split(".")[0] for module in self.imported}


@lru_cache(None)
def facts_of(file: Path) -> Facts:
    name, nodes = name_of(file), Nodes(file.read_text(encoding="utf-8"))
    package = tuple(name.removesuffix(".py").split("/")[:-1])
    return Facts(
        tuple(module for _, module in imports(nodes.all, package)),
        tuple(module for _, module in imports(at_import_time(nodes.tree, functions=True), package)),
        frozenset(module.split(".")[0] for _, module in imports(at_import_time(nodes.tree), package)),
        wrong_arrows(nodes, name) if package[0] in ("f4x_core", "addon") else [],
        laboratory_names(nodes, name),
        unsafe(nodes),
        ast.get_docstring(nodes.tree),
    )


class Nodes:
    """The syntax of a file: its tree, and all nodes of it that are looked at."""

    KINDS = (ast.Import, ast.ImportFrom, ast.Call, ast.Constant)

    def __init__(self, source: str):
        self.tree = ast.parse(source)
        self.all = [node for node in ast.walk(self.tree) if isinstance(node, self.KINDS)]


def room_of(file: Path) -> str:
    return file.relative_to(ROOT).parts[1].removesuffix(".py")


def faults(files: Iterable[Path], check: Callable[[Path], Any]) -> dict[str, Any]:
    """Findings of `check` in each of `files`, by name; files without any are left out."""
    return {name_of(file): found for file in files if (found := check(file))}


def imports(nodes: Iterable[ast.AST], package: tuple[str, ...]) -> Iterator[tuple[int, str]]:
    """(line, dotted module) of every import among `nodes`; relative ones made absolute from `package`."""
    for node in nodes:
        if isinstance(node, ast.Import):
            yield from ((node.lineno, alias.name) for alias in node.names)
        elif isinstance(node, ast.ImportFrom) and node.level == 0:
            yield node.lineno, node.module or ""
        elif isinstance(node, ast.ImportFrom):
            base = (*package[: len(package) - node.level + 1], *(node.module or "").split("."))
            yield from ((node.lineno, ".".join(filter(None, (*base, alias.name)))) for alias in node.names)


def at_import_time(node: ast.AST, functions: bool = False) -> Iterator[ast.stmt]:
    """Imports that importing the module runs: not those for type checkers alone, and those in functions only where asked for."""
    for part in ("body", "orelse", "finalbody", "handlers", "cases"):
        for inner in getattr(node, part, []):
            if isinstance(inner, ast.Import | ast.ImportFrom):
                yield inner
            only_checked = isinstance(inner, ast.If) and "TYPE_CHECKING" in ast.dump(inner.test)
            if not only_checked and (functions or not isinstance(inner, ast.FunctionDef | ast.AsyncFunctionDef)):
                yield from at_import_time(inner, functions)


def wrong_arrows(nodes: Nodes, path: str) -> list[str]:
    """Imports of `path` (inside f4x_core or addon) that point to the right or to the package itself, or name it absolutely."""
    parts = path.removesuffix(".py").split("/")
    package, room, wrong = parts[0], parts[1], []
    order = ROOMS if package == "f4x_core" else EXTENSION
    for line, module in imports(nodes.all, tuple(parts[:-1])):
        target = module.split(".")
        if target[0] != package or len(target) == 1:
            continue
        to_the_right = target[1] in order and room in order and order.index(target[1]) > order.index(room)
        from_the_ground = target[1] in ROOMS and room in SHARED and path not in DOORS
        from_the_door = target[1] not in (*order, *SHARED)
        if to_the_right or from_the_ground or from_the_door:
            wrong.append(f"{path}:{line} imports {module}")
    wrong += [
        f"{path}:{node.lineno} imports the package by its absolute name"
        for node in nodes.all
        if (isinstance(node, ast.Import) and any(a.name.split(".")[0] in ("f4x_core", "addon") for a in node.names))
        or (
            isinstance(node, ast.ImportFrom)
            and (node.module or "").split(".")[0] in ("f4x_core", "addon")
            and not node.level
        )
    ]
    return wrong


def module_of(file: Path) -> str:
    return name_of(file).removesuffix(".py").removesuffix("/__init__").replace("/", ".")


def circle_in(imported: dict[str, Iterable[str]]) -> list[str]:
    """Modules that import each other in a circle, the first one again at the end; empty where there is none.

    `imported`: module -> what it imports when it runs, in functions too; names in modules count as their module.
    """
    graph: dict[str, set[str]] = {}
    for module, targets in imported.items():
        parents = ({target, target.rpartition(".")[0]} & imported.keys() for target in targets)
        graph[module] = {max(found, key=len) for found in parents if found} - {module}
    try:
        TopologicalSorter(graph).prepare()
    except CycleError as error:
        return list(error.args[1])
    return []


def laboratory_names(nodes: Nodes, path: str) -> list[str]:
    """Where a file of the core imports `benchmarks` or names a module of it; the door may do the latter."""
    found = [f"{line}: {module}" for line, module in imports(nodes.all, ("",)) if module.split(".")[0] == "benchmarks"]
    texts = [node for node in nodes.all if isinstance(node, ast.Constant) and isinstance(node.value, str)]
    modules = [node for node in texts if node.value == "benchmarks" or node.value.startswith("benchmarks.")]
    return found + [f"{node.lineno}: {node.value}" for node in modules if path != DOOR]


def unsafe(nodes: Nodes) -> list[str]:
    """Lines that may run bytes or text as code."""
    found = [f"{line}: {module}" for line, module in imports(nodes.all, ()) if module.split(".")[0] in UNSAFE_MODULES]
    for node in nodes.all:
        if not isinstance(node, ast.Call):
            continue
        called = ast.unparse(node.func)
        options = {keyword.arg: ast.unparse(keyword.value) for keyword in node.keywords}
        if called in UNSAFE_CALLS or options.get("shell", "False") != "False":
            found.append(f"{node.lineno}: {called}")
        if called.endswith("load") and options.get("allow_pickle", "False") != "False":
            found.append(f"{node.lineno}: {called} with pickles")
        if called == "torch.load" and options.get("weights_only") != "True":
            found.append(f"{node.lineno}: torch.load without weights_only=True")
    return found


def test_arrows_point_to_the_left():
    addon = sources("addon")
    assert {room_of(file) for file in CORE} <= {*ROOMS, *SHARED}
    assert {room_of(file) for file in addon} == {*EXTENSION, "registration", "__init__"}
    assert faults([*CORE, *addon], lambda file: facts_of(file).wrong_arrows) == {}


@pytest.mark.parametrize("folder", ["f4x_core", "addon", "benchmarks"])
def test_no_modules_import_each_other_in_a_circle(folder):
    files = [file for file in EVERYTHING if name_of(file).startswith(f"{folder}/") and name_of(file) not in DOORS]
    assert circle_in({module_of(file): facts_of(file).used for file in files}) == []


@pytest.mark.parametrize("folder", ["scripts", "tools"])
def test_no_scripts_import_each_other_in_a_circle_even_for_type_checkers(folder):
    assert circle_in({file.stem: facts_of(file).imported for file in sources(folder)}) == []


@pytest.mark.parametrize(
    "imported",
    [
        {"room.a": ["room.b.name"], "room.b": ["room.c"], "room.c": ["room.a.name"]},
        {"room": ["room.a.name"], "room.a": ["room"]},
    ],
)
def test_a_circle_would_be_seen(imported):
    assert circle_in(imported)
    assert not circle_in({**imported, min(imported): ["numpy.ndarray"]})


def test_the_door_for_programs_imports_no_room():
    tree = ast.parse((ROOT / "f4x_core" / "__init__.py").read_text(encoding="utf-8"))
    names = {module.removeprefix("f4x_core.") for _, module in imports(at_import_time(tree), ("f4x_core",))}
    assert names <= {"importlib", "typing", "versions"}


def test_wheels_are_imported_where_they_are_allowed():
    def banned(file: Path) -> set[str]:
        facts, room = facts_of(file), room_of(file)
        not_here = (
            set()
            if name_of(file) in FITS
            else WHEELS
            if room in NUMPY_ONLY
            else {"torch"}
            if room in TORCH_FREE
            else set()
        )
        return facts.tops & {"bpy"} | facts.loaded & not_here  # bpy lives in the extension

    assert faults(CORE, banned) == {}


def test_nothing_in_the_core_knows_the_laboratory():
    assert faults(CORE, lambda file: facts_of(file).laboratory_names) == {}


def test_the_laboratory_uses_the_core_and_nothing_of_the_addon():
    banned = {"addon", "bpy", "ground_truth", "scripts", "tests", "tools"}
    assert faults(LABORATORY, lambda file: facts_of(file).tops & banned) == {}


def test_the_addon_uses_only_rooms_that_need_numpy_alone():
    def other_rooms(file: Path) -> set[str]:
        modules = [module.split(".") for module in facts_of(file).imported]
        return {m[1] for m in modules if m[0] == "f4x_core" and len(m) > 1} - {*NUMPY_ONLY, "scaffold"}

    assert faults(sources("addon"), other_rooms) == {}


def test_nothing_runs_text_or_bytes_as_code():
    assert faults(EVERYTHING, lambda file: facts_of(file).unsafe) == {}


@pytest.mark.parametrize(
    ("source", "path"),
    [
        ("from ..fit.config import profile", "f4x_core/raster/tiles.py"),
        ("def f():\n    from ..raster import rasterize", "f4x_core/priors/flow.py"),
        ("from ..fit import model", "f4x_core/native/build.py"),
        ("from .. import evaluation", "f4x_core/metrics/pictures.py"),
        ("from ..report.advice import verdict", "f4x_core/fit/trainer.py"),
        ("from .clip import Clip", "f4x_core/files.py"),
        ("from ..ui.panel import F4X_PT_scene", "addon/operators/base.py"),
        ("def f():\n    from ..render import engine", "addon/scene/scene_object.py"),
        ("from .. import registration", "addon/jobs/runner.py"),
        ("from .. import __version__", "f4x_core/cli/main.py"),
        ("from f4x_core.errors import F4xError", "f4x_core/fit/model.py"),
        ("import f4x_core", "f4x_core/cli/main.py"),
    ],
)
def test_a_wrong_arrow_would_be_seen(source, path):
    assert wrong_arrows(Nodes(source), path)


@pytest.mark.parametrize(
    "source",
    [
        "import benchmarks",
        "def f():\n    from benchmarks.study import Context",
        "import_module('benchmarks.study')",
        "import_module(f'benchmarks.{name}')",
    ],
)
def test_a_way_into_the_laboratory_would_be_seen(source):
    assert laboratory_names(Nodes(source), "f4x_core/fit/model.py")


@pytest.mark.parametrize(
    "source",
    [
        "import pickle",
        "from pickle import loads",
        "eval(text)",
        "os.system(text)",
        "subprocess.run(text, shell=True)",
        "np.load(path, allow_pickle=True)",
        "torch.load(path)",
        "torch.load(path, weights_only=False)",
    ],
)
def test_unsafe_code_would_be_seen(source):
    assert unsafe(Nodes(source))
    assert not unsafe(Nodes("model.eval(); torch.load(path, weights_only=True); subprocess.run([text])"))


def test_the_trimmed_module_keeps_what_import_runs():
    source = (
        "import a\nif TYPE_CHECKING:\n    import b\nif c:\n    import d\ndef f():\n    import e\nclass G:\n    import h"
    )
    assert {m for _, m in imports(at_import_time(ast.parse(source)), ())} == {"a", "d", "h"}
    assert {m for _, m in imports(at_import_time(ast.parse(source), functions=True), ())} == {"a", "d", "e", "h"}


def test_readme_names_the_two_commands():
    readme = ROOT / "README.md"
    if not readme.exists():
        pytest.skip("README.md is not written yet")
    text = readme.read_text(encoding="utf-8")
    for command in ("demo", "test"):
        assert f"python3 scripts/dev.py {command}" in text


def test_every_module_says_what_it_is():
    """The pages of `scripts/dev.py docs` begin with it."""
    modules = [file for file in CORE if file.name != "__init__.py"]
    assert faults(modules, lambda file: not facts_of(file).docstring) == {}


def test_the_extension_uses_nothing_that_it_leaves_out():
    left_out = {"benchmarks", "ground_truth", "scripts", "tests", "tools"}
    assert faults(sources("addon"), lambda file: facts_of(file).tops & left_out) == {}


def test_no_merge_was_left_half_done():
    folders = ("addon", "benchmarks", "docs", "f4x_core", "ground_truth", "scripts", "tests", "tools")
    kinds = {".py", ".md", ".toml", ".yml", ".cpp", ".hpp", ".js", ".html"}
    found = [*ROOT.iterdir(), *(file for folder in folders for file in (ROOT / folder).rglob("*"))]
    texts = [file for file in found if file.suffix in kinds and file.is_file()]
    markers = re.compile("^(<{7}|>{7}) ", re.MULTILINE)
    assert len(texts) > 400 and [name_of(file) for file in texts if markers.search(file.read_text("utf-8"))] == []
