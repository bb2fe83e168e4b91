"""Make everything that a release gives away, from the last commit alone: `python3 scripts/dev.py release [-o DIR]`.

DIR (dist) then holds: a wheel for each platform, `extensions/` with a zip for each platform and the `index.json` of a repository
that Blender can be pointed at, one zip for all platforms, the source archive, `examples/` (from build/examples, made there if need
be), NOTES.md from CHANGELOG.md, and SHA256SUMS. The same commit makes the same bytes: ziglang compiles all libraries, and dates are
the commit's; examples are copied as they lie there.
"""

import argparse
import gzip
import hashlib
import os
import re
import shutil
import subprocess
import sys
import tarfile
import tempfile
import tomllib
from dataclasses import dataclass
from pathlib import Path

from f4x_core.native.build import TARGETS
from f4x_core.versions import VERSION

from .build_extension import builder

ROOT = Path(__file__).resolve().parents[1]
TAG = f"v{VERSION}"
ALL, REPOSITORY, EXAMPLES, NOTES, SUMS = "all-platforms", "extensions", "examples", "NOTES.md", "SHA256SUMS"
"""Names in the folder of the release."""


class ReleaseError(Exception):
    """One sentence: why this cannot be released."""


@dataclass(frozen=True)
class Release:
    """One release under way."""

    tree: Path
    """The files of the commit, and what is built of them."""
    output: Path
    """Folder for its files."""
    epoch: str
    """Seconds since 1970 of the commit."""

    def run(self, *command: str, **variables: str) -> None:
        """Run a Python command in the tree, with its own modules and nothing of this checkout's."""
        environment = os.environ | {"PYTHONPATH": str(self.tree), "SOURCE_DATE_EPOCH": self.epoch} | variables
        done = subprocess.run(
            [sys.executable, *command], cwd=self.tree, env=environment, capture_output=True, text=True
        )
        if done.returncode:
            raise ReleaseError(f"{' '.join(command[:3])} failed:\n{done.stdout}{done.stderr}")


def git(*arguments: str) -> str:
    """Return the output of git, without the line end."""
    return subprocess.run(["git", *arguments], cwd=ROOT, check=True, capture_output=True, text=True).stdout.strip()


def section_of(changelog: str, version: str) -> str:
    """Return the section of a version in CHANGELOG.md, without its heading.

    Raises:
        ReleaseError: it has no such section, or an empty one.
    """
    found = re.search(rf"^## {re.escape(version)}\b[^\n]*\n(.*?)(?=^## |\Z)", changelog, re.MULTILINE | re.DOTALL)
    if found is None or not found[1].strip():
        raise ReleaseError(f"CHANGELOG.md says nothing under '## {version}'; write there what is new.")
    return found[1].strip() + "\n"


def repeated_versions(tree: Path) -> dict[str, str]:
    """Return file -> version, for the files that have to repeat `f4x_core.versions.VERSION`."""
    manifest = tomllib.loads((tree / "blender_manifest.toml").read_text(encoding="utf-8"))
    citation = re.search(r"^version: (\S+)$", (tree / "CITATION.cff").read_text(encoding="utf-8"), re.MULTILINE)
    return {"blender_manifest.toml": manifest["version"], "CITATION.cff": citation[1] if citation else "none"}


def require_consistent(tree: Path) -> None:
    """Raise ReleaseError where a file repeats another version than `f4x_core/versions.py` has, or a tag has it already."""
    for name, found in repeated_versions(tree).items():
        if found != VERSION:
            raise ReleaseError(f"{name} has version {found}, f4x_core/versions.py {VERSION}; write the latter there.")
    if TAG in git("tag").split() and git("rev-list", "-n", "1", TAG) != git("rev-parse", "HEAD"):
        raise ReleaseError(f"The tag {TAG} is on another commit; raise VERSION in f4x_core/versions.py.")
    if git("status", "--porcelain", "--untracked-files=no"):
        raise ReleaseError("Something is changed and not committed; a release is made from the last commit.")


def export(release: Release) -> None:
    """Write the source archive, and unpack it into the release's tree."""
    name = f"feature4x-blender-{VERSION}"
    packed = subprocess.run(
        ["git", "-c", "tar.umask=0022", "archive", f"--prefix={name}/", "HEAD"],
        cwd=ROOT,
        check=True,
        capture_output=True,
    ).stdout
    with open(release.output / f"{name}.tar.gz", "wb") as file, gzip.GzipFile("", "wb", 9, file, mtime=0) as archive:
        archive.write(packed)
    with tarfile.open(release.output / f"{name}.tar.gz") as archive:
        archive.extractall(release.tree.parent, filter="data")


def make_wheels(release: Release) -> None:
    """Make a wheel for each platform."""
    options = ("--no-deps", "--no-build-isolation", "--disable-pip-version-check", "-w", str(release.output))
    for target in TARGETS:
        release.run("-m", "pip", "wheel", *options, str(release.tree), F4X_WHEEL_TARGET=target)


def make_extensions(release: Release) -> None:
    """Make a zip for each platform with the index of a repository, and one for all, which Blender's rules keep apart."""
    script = str(release.tree / "scripts" / "build_extension.py")
    folder = release.output / REPOSITORY
    for target in TARGETS:
        release.run(script, "-o", str(folder), "--target", target)
    release.run(str(builder()), "server-generate", "--repo-dir", str(folder))
    release.run(script, "-o", str(release.output / ALL))


def copy_examples(made: Path, output: Path) -> None:
    """Copy the example scenes that lie in `made`, with those files that `SUMS` there tells.

    Raises:
        ReleaseError: a file is not what it was when they were made.
    """
    output.mkdir()
    for line in (made / SUMS).read_text(encoding="utf-8").splitlines():
        digest, name = line.split("  ", 1)
        content = (made / name).read_bytes() if (made / name).is_file() else b""
        if hashlib.sha256(content).hexdigest() != digest:
            raise ReleaseError(
                f"{made / name} is not what was made there; python3 scripts/dev.py examples makes it anew."
            )
        (output / name).write_bytes(content)


def write_sums(output: Path) -> None:
    """Write SHA256SUMS of all files, as `sha256sum -c` reads it."""
    files = sorted(file for file in output.rglob("*") if file.is_file() and file.name != SUMS)
    lines = [
        f"{hashlib.sha256(file.read_bytes()).hexdigest()}  {file.relative_to(output).as_posix()}" for file in files
    ]
    (output / SUMS).write_text("\n".join(lines) + "\n")


def make(output: Path) -> None:
    """Make the release in `output`, which is emptied first.

    Raises:
        ReleaseError: versions contradict each other, the change log is silent, or a step failed.
    """
    require_consistent(ROOT)
    notes = section_of((ROOT / "CHANGELOG.md").read_text(encoding="utf-8"), VERSION)
    os.umask(0o022)
    if output.exists() and not (output / SUMS).is_file() and any(output.iterdir()):
        raise ReleaseError(f"{output} holds something else than a release; name a new folder.")
    shutil.rmtree(output, ignore_errors=True)
    output.mkdir(parents=True)
    with tempfile.TemporaryDirectory() as folder:
        tree = Path(folder) / f"feature4x-blender-{VERSION}"
        release = Release(tree, output, git("log", "-1", "--format=%ct"))
        export(release)
        print("kernels for every platform (minutes, the first time) …", flush=True)
        release.run("-m", "f4x_core.native.build", "--all", "--cache", str(ROOT / "build" / "native"))
        print("wheels and extensions …", flush=True)
        make_wheels(release)
        make_extensions(release)
    if not (ROOT / "build" / EXAMPLES / SUMS).is_file():
        print("example scenes (a quarter of an hour, the first time) …", flush=True)
        subprocess.run([sys.executable, "-m", "scripts.examples"], cwd=ROOT, check=True)
    copy_examples(ROOT / "build" / EXAMPLES, output / EXAMPLES)
    (output / NOTES).write_text(notes, encoding="utf-8")
    write_sums(output)


def main() -> int:
    """Make the release and say what is there and what is left to do."""
    parser = argparse.ArgumentParser(prog="dev.py release", description=__doc__.splitlines()[0])
    parser.add_argument("-o", "--output", type=Path, default=ROOT / "dist", help="folder (default: dist)")
    output = parser.parse_args().output.resolve()
    try:
        make(output)
    except ReleaseError as error:
        print(f"release: {error}", file=sys.stderr)
        return 2
    print((output / SUMS).read_text(), end="")
    print(f"{output}: version {VERSION}. To publish: git tag {TAG}, and these files with {NOTES}.")
    return 0


if __name__ == "__main__":
    sys.exit(main())
