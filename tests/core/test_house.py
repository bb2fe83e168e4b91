"""The house rules that a reader relies on: which room imports which, what stays free of torch, what never runs."""

import ast
import re
from collections.abc import Iterator
from pathlib import Path

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
        "scene",
        "fit",
        "evaluation",
        "query",
        "edit",
    ),
    *("api", "batch", "agent", "cli"),
)
"""In the order data flows: a room imports itself and rooms to its left."""
SHARED = (
    *(
        "errors",
        "files",
        "page",
        "progress",
        "processes",
        "parallel",
        "installation",
        "reading",
        "troubles",
        "versions",
    ),
    *("__init__", "__main__"),
)
"""Common ground below all rooms, and the two doors."""
DOORS = ("f4x_core/__init__.py", "f4x_core/__main__.py")
"""They name rooms: the first one to type checkers alone, to programs lazily."""
TORCH_FREE = (
    "native",
    "geometry",
    "language",
    "clip",
    "priors",
    "scene",
    "query",
    "edit",
    "api",
    "batch",
    "agent",
    "errors",
    "files",
    "progress",
    "processes",
    "parallel",
    "installation",
    "reading",
    "troubles",
    "versions",
)
NUMPY_ONLY = (
    "native",
    "geometry",
    "language",
    "clip",
    "scene",
    "query",
    "edit",
    "api",
    "errors",
    "files",
    "progress",
    "processes",
    "installation",
    "reading",
    "troubles",
    "versions",
)
"""What Blender's own Python imports: numpy is the only wheel there."""
WHEELS = {"torch", "cv2", "av", "scipy", "PIL", "pycolmap", "matplotlib", "OpenEXR", "rich", "trimesh"}
UNSAFE_MODULES = {"pickle", "cPickle", "_pickle", "dill", "cloudpickle", "joblib", "marshal", "shelve"}
UNSAFE_CALLS = {"eval", "exec", "os.system", "os.popen", "subprocess.getoutput", "subprocess.getstatusoutput"}


def sources(*folders: str) -> list[Path]:
    return [file for folder in folders for file in sorted((ROOT / folder).rglob("*.py"))]


CORE = sources("f4x_core")
LABORATORY = sources("benchmarks")
EVERYTHING = [*CORE, *LABORATORY, *sources("addon", "ground_truth", "scripts")]
DOOR = "f4x_core/cli/laboratory.py"
"""The one file of the core that loads `benchmarks`, by importlib, where a checkout has it."""


def name_of(file: Path) -> str:
    return file.relative_to(ROOT).as_posix()


def imports(tree: ast.AST, package: tuple[str, ...]) -> Iterator[tuple[int, str]]:
    """(line, dotted module) of every import below `tree`; relative ones made absolute from `package`."""
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            yield from ((node.lineno, alias.name) for alias in node.names)
        elif isinstance(node, ast.ImportFrom) and node.level == 0:
            yield node.lineno, node.module or ""
        elif isinstance(node, ast.ImportFrom):
            base = (*package[: len(package) - node.level + 1], *(node.module or "").split("."))
            yield from ((node.lineno, ".".join(filter(None, (*base, alias.name)))) for alias in node.names)


def at_import_time(tree: ast.Module) -> ast.Module:
    """The module without its functions and what only type checkers read: what importing it runs."""

    class Trim(ast.NodeTransformer):
        def visit_FunctionDef(self, node):
            return None

        def visit_AsyncFunctionDef(self, node):
            return None

        def visit_If(self, node):
            return None if "TYPE_CHECKING" in ast.dump(node.test) else self.generic_visit(node)

    return Trim().visit(tree)


def wrong_arrows(source: str, path: str) -> list[str]:
    """Imports of `path` (inside f4x_core) that point to the right, or name the package absolutely."""
    parts = path.removesuffix(".py").split("/")
    room, wrong = parts[1], []
    for line, module in imports(ast.parse(source), tuple(parts[:-1])):
        target = module.split(".")
        if target[0] != "f4x_core" or len(target) == 1:
            continue
        to_the_right = target[1] in ROOMS and room in ROOMS and ROOMS.index(target[1]) > ROOMS.index(room)
        from_the_ground = target[1] in ROOMS and room in SHARED and path not in DOORS
        if to_the_right or from_the_ground:
            wrong.append(f"{path}:{line} imports {module}")
    wrong += [
        f"{path}:{node.lineno} imports the package by its absolute name"
        for node in ast.walk(ast.parse(source))
        if (isinstance(node, ast.Import) and any(a.name.split(".")[0] == "f4x_core" for a in node.names))
        or (isinstance(node, ast.ImportFrom) and node.level == 0 and (node.module or "").startswith("f4x_core"))
    ]
    return wrong


def laboratory_names(source: str, path: str) -> list[str]:
    """Where a file of the core imports `benchmarks` or names a module of it; the door may do the latter."""
    tree = ast.parse(source)
    found = [f"{line}: {module}" for line, module in imports(tree, ("",)) if module.split(".")[0] == "benchmarks"]
    texts = [node for node in ast.walk(tree) if isinstance(node, ast.Constant) and isinstance(node.value, str)]
    modules = [node for node in texts if node.value == "benchmarks" or node.value.startswith("benchmarks.")]
    return found + [f"{node.lineno}: {node.value}" for node in modules if path != DOOR]


def unsafe(source: str) -> list[str]:
    """What may run bytes or text as code."""
    tree, found = ast.parse(source), []
    found += [f"{line}: {module}" for line, module in imports(tree, ()) if module.split(".")[0] in UNSAFE_MODULES]
    for node in ast.walk(tree):
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


@pytest.mark.parametrize("file", CORE, ids=name_of)
def test_arrows_point_to_the_left(file):
    room = file.relative_to(ROOT / "f4x_core").parts[0].removesuffix(".py")
    assert room in ROOMS or room in SHARED, f"{room} is no room of the house"
    assert wrong_arrows(file.read_text(encoding="utf-8"), name_of(file)) == []


def test_the_door_for_programs_imports_no_room():
    tree = at_import_time(ast.parse((ROOT / "f4x_core" / "__init__.py").read_text(encoding="utf-8")))
    names = {module.removeprefix("f4x_core.") for _, module in imports(tree, ("f4x_core",))}
    assert names <= {"importlib", "typing", "versions"}


@pytest.mark.parametrize("file", CORE, ids=name_of)
def test_wheels_are_imported_where_they_are_allowed(file):
    tree = ast.parse(file.read_text(encoding="utf-8"))
    assert not [line for line, module in imports(tree, ()) if module.split(".")[0] == "bpy"], (
        "bpy lives in the extension"
    )
    room = file.relative_to(ROOT / "f4x_core").parts[0].removesuffix(".py")
    loaded = {module.split(".")[0] for _, module in imports(at_import_time(tree), ("",))}
    banned = WHEELS if room in NUMPY_ONLY else {"torch"} if room in TORCH_FREE else set()
    assert loaded & banned == set()


@pytest.mark.parametrize("file", CORE, ids=name_of)
def test_nothing_in_the_core_knows_the_laboratory(file):
    assert laboratory_names(file.read_text(encoding="utf-8"), name_of(file)) == []


@pytest.mark.parametrize("file", LABORATORY, ids=name_of)
def test_the_laboratory_uses_the_core_and_nothing_of_the_addon(file):
    tree = ast.parse(file.read_text(encoding="utf-8"))
    modules = {module.split(".")[0] for _, module in imports(tree, file.relative_to(ROOT).parts[:-1])}
    assert not modules & {"addon", "bpy", "ground_truth", "scripts", "tests"}


@pytest.mark.parametrize("file", sources("addon"), ids=name_of)
def test_the_addon_uses_only_rooms_that_need_numpy_alone(file):
    parts = name_of(file).removesuffix(".py").split("/")
    modules = [module.split(".") for _, module in imports(ast.parse(file.read_text("utf-8")), ("", *parts[:-1]))]
    rooms = {module[1] for module in modules if module[0] == "f4x_core" and len(module) > 1}
    assert rooms - {*NUMPY_ONLY, "scaffold"} == set()


@pytest.mark.parametrize("file", EVERYTHING, ids=name_of)
def test_nothing_runs_text_or_bytes_as_code(file):
    assert unsafe(file.read_text(encoding="utf-8")) == []


@pytest.mark.parametrize(
    ("source", "path"),
    [
        ("from ..fit.config import profile", "f4x_core/raster/tiles.py"),
        ("def f():\n    from ..raster import rasterize", "f4x_core/priors/flow.py"),
        ("from ..fit import model", "f4x_core/native/build.py"),
        ("from .. import evaluation", "f4x_core/fit/model.py"),
        ("from .clip import Clip", "f4x_core/files.py"),
        ("from f4x_core.errors import F4xError", "f4x_core/fit/model.py"),
        ("import f4x_core", "f4x_core/cli/main.py"),
    ],
)
def test_a_wrong_arrow_would_be_seen(source, path):
    assert wrong_arrows(source, path)


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
    assert laboratory_names(source, "f4x_core/fit/model.py")


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
    assert unsafe(source)
    assert not unsafe("model.eval(); torch.load(path, weights_only=True); subprocess.run([text])")


def test_the_trimmed_module_keeps_what_import_runs():
    source = (
        "import a\nif TYPE_CHECKING:\n    import b\nif c:\n    import d\ndef f():\n    import e\nclass G:\n    import h"
    )
    assert {m for _, m in imports(at_import_time(ast.parse(source)), ())} == {"a", "d", "h"}


def test_readme_names_the_two_commands():
    readme = ROOT / "README.md"
    if not readme.exists():
        pytest.skip("README.md is not written yet")
    text = readme.read_text(encoding="utf-8")
    for command in ("demo", "test"):
        assert f"python3 scripts/dev.py {command}" in text


@pytest.mark.parametrize("file", CORE, ids=name_of)
def test_every_module_says_what_it_is(file):
    """The pages of `scripts/dev.py docs` begin with it."""
    assert ast.get_docstring(ast.parse(file.read_text(encoding="utf-8"))) or file.name == "__init__.py"


@pytest.mark.parametrize("file", sources("addon"), ids=name_of)
def test_the_extension_uses_nothing_that_it_leaves_out(file):
    tree = ast.parse(file.read_text(encoding="utf-8"))
    tops = {module.split(".")[0] for _, module in imports(tree, ("addon",))}
    assert not tops & {"benchmarks", "ground_truth", "scripts", "tests"}


def test_no_merge_was_left_half_done():
    folders = ("addon", "benchmarks", "docs", "f4x_core", "ground_truth", "scripts", "tests")
    kinds = {".py", ".md", ".toml", ".yml", ".cpp", ".hpp", ".js", ".html"}
    found = [*ROOT.iterdir(), *(file for folder in folders for file in (ROOT / folder).rglob("*"))]
    texts = [file for file in found if file.suffix in kinds and file.is_file()]
    markers = re.compile("^(<{7}|>{7}) ", re.MULTILINE)
    assert len(texts) > 400 and [name_of(file) for file in texts if markers.search(file.read_text("utf-8"))] == []
