"""A Debian system with a real Blender, Xvfb and xdotool in a folder, to chroot into; another Debian's or Ubuntu's root only.

python3 scripts/real_blender.py ROOT [--suite sid]

Standard library only. About 300 MB come from a Debian mirror and take up 1.4 GB; a later call finds them and does nothing.
The system is made in ROOT.partial and becomes ROOT when Blender has said its version there, so ROOT is whole or not at all.
No file system stays mounted below it: `rm -r` is safe. Exit code 2 and one sentence where it cannot be made.
"""

import argparse
import os
import platform
import re
import shutil
import subprocess
import sys
import tempfile
import time
import urllib.error
import urllib.request
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import IO

REPOSITORY = Path(__file__).resolve().parents[1]

SUITE = "sid"
"""Debian's only release whose Blender is the present LTS."""
PACKAGES = (
    "blender",
    "python3-numpy",  # Blender's own has it; Debian's merely recommends it
    "python3-cattr",  # these three: what installing extensions imports
    "python3-requests",
    "python3-zstandard",
    "xvfb",
    "xdotool",
    "libgl1-mesa-dri",
    "mesa-vulkan-drivers",
    "libegl1",
)
MIRROR = "http://deb.debian.org/debian"
SOURCES = Path("/etc/apt")
KEYRING = Path("/usr/share/keyrings/debian-archive-keyring.gpg")
"""Debian's signatures; without it debootstrap would take anything."""
ANSWER, PATIENCE = 20.0, 1200.0
"""Seconds that a mirror may take to answer, and one step of the installation."""
QUIET = {"DEBIAN_FRONTEND": "noninteractive", "LC_ALL": "C.UTF-8"}


class UnavailableError(Exception):
    """One sentence: why there can be no such system here."""


@dataclass(frozen=True)
class Profile:
    """A user of the system `root` whose settings are Blender's own: home and temporary files are in `folder`."""

    root: Path
    folder: Path
    """As seen from outside; `inside` is what the system calls it."""

    @property
    def inside(self) -> str:
        """The folder's path in the system."""
        return f"/{self.folder.relative_to(self.root)}"

    @property
    def environment(self) -> dict[str, str]:
        """Variables for what runs there; nothing of this machine's."""
        home = {"HOME": self.inside, "TMPDIR": self.inside, "BLENDER_USER_RESOURCES": f"{self.inside}/blender"}
        return {"PATH": "/usr/sbin:/usr/bin:/sbin:/bin", "LC_ALL": "C.UTF-8"} | home

    def command(self, *words: object) -> list[str]:
        """Return a command that runs in the system."""
        return ["chroot", str(self.root), *map(str, words)]

    @contextmanager
    def screen(self, size: tuple[int, int], log: IO) -> Iterator[Callable[..., subprocess.Popen]]:
        """Open a screen; yield a function that starts a program of the system there. All of them end with the `with` block."""
        environment = self.environment | {"DISPLAY": self.display}
        children: list[subprocess.Popen] = []

        def start(*words: object) -> subprocess.Popen:
            # with /proc, which a program asks for its memory, in a view of the file systems that goes with the program
            mounted = [
                "unshare",
                "-m",
                "sh",
                "-c",
                'mount -t proc proc "$1/proc" && shift && exec "$@"',
                "sh",
                self.root,
            ]
            children.append(
                subprocess.Popen([*map(str, mounted), *self.command(*words)], env=environment, stdout=log, stderr=log)
            )
            return children[-1]

        try:
            start("Xvfb", self.display, "-screen", 0, f"{size[0]}x{size[1]}x24", "-nolisten", "tcp", "-listen", "unix")
            time.sleep(2)
            yield start
        finally:
            for child in reversed(children):
                child.kill()
                child.wait()

    @property
    def display(self) -> str:
        """The name of the screen."""
        return f":{90 + os.getpid() % 900}"

    def check_out(self) -> str:
        """Copy what Blender needs of this repository; returns its path in the system."""
        for name in ("addon", "f4x_core", "ground_truth", "scripts", "tools"):
            ignored = shutil.ignore_patterns("__pycache__")
            shutil.copytree(REPOSITORY / name, self.folder / "feature4x" / name, ignore=ignored)
        shutil.copy(REPOSITORY / "__init__.py", self.folder / "feature4x")
        return f"{self.inside}/feature4x"


@contextmanager
def clean_profile(root: Path) -> Iterator[Profile]:
    """Make a new profile in the system's /tmp, which is gone when the `with` block ends."""
    root = root.resolve()
    with tempfile.TemporaryDirectory(dir=root / "tmp", ignore_cleanup_errors=True) as folder:
        yield Profile(root, Path(folder))


def version(root: Path) -> str | None:
    """Return the version line of the Blender in `root`, such as "Blender 5.2.2 LTS"; None where none runs."""
    programs = ("blender", "Xvfb", "xdotool")
    if not all((root / "usr/bin" / name).exists() for name in programs):
        return None
    command = ["chroot", str(root), "blender", "--version"]
    output = subprocess.run(command, capture_output=True, text=True, env=os.environ | QUIET).stdout
    return next((line for line in output.splitlines() if line.startswith("Blender ")), None)


def prepare(root: Path, suite: str = SUITE) -> str:
    """Create the system in `root` unless it exists; returns the version of its Blender.

    Raises:
        UnavailableError: this machine, its user or its network cannot; or `root` is something else.
    """
    root = root.absolute()
    if platform.system() != "Linux" or os.geteuid() != 0:
        raise UnavailableError("only root of a Linux machine may set up another system in a folder")
    import fcntl  # other systems lack it

    root.parent.mkdir(parents=True, exist_ok=True)
    lock = os.open(root.parent, os.O_RDONLY)  # a second caller waits, and then finds it made
    try:
        fcntl.flock(lock, fcntl.LOCK_EX)
        if root.exists() and any(root.iterdir()):
            found = version(root)
            if found is None:
                raise UnavailableError(
                    f"{root} is something else than a system with Blender, Xvfb and xdotool; name a new folder"
                )
            return found
        require_debootstrap()
        mirror = find_mirror(suite)
        partial = root.with_name(root.name + ".partial")
        _remove(partial)  # of a call that was killed
        try:
            found = _install(partial, suite, mirror)
            _unmount(partial)
            partial.rename(root)
        finally:
            _remove(partial)
        return found
    finally:
        os.close(lock)


def _install(folder: Path, suite: str, mirror: str) -> str:
    """Bootstrap Debian in `folder` and install Blender there; returns its version."""
    start = time.monotonic()
    print(f"Debian {suite} from {mirror} …", flush=True)
    run_step(
        "debootstrap", "--variant=minbase", f"--keyring={KEYRING}", "--force-check-gpg", suite, str(folder), mirror
    )
    policy = folder / "usr/sbin/policy-rc.d"  # nothing that is installed may start a service
    policy.write_text("#!/bin/sh\nexit 101\n")
    policy.chmod(0o755)
    print(f"Blender, Xvfb and xdotool … ({time.monotonic() - start:.0f} s so far)", flush=True)
    run_step("chroot", str(folder), "apt-get", "-qq", "-y", "install", "--no-install-recommends", *PACKAGES)
    run_step("chroot", str(folder), "apt-get", "-qq", "clean")
    found = version(folder)
    if found is None:
        raise UnavailableError(f"Debian {suite} has packages of Blender that do not run here")
    print(f"{found} after {time.monotonic() - start:.0f} s", flush=True)
    return found


def run_step(*command: str) -> None:
    """Run a step. Raises UnavailableError with its last line of output if it fails or takes too long."""
    name = " ".join(command[2:4] if command[0] == "chroot" else command[:1])
    try:
        subprocess.run(
            command,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            stdin=subprocess.DEVNULL,
            env=os.environ | QUIET,
            timeout=PATIENCE,
            text=True,
            errors="replace",
            check=True,
        )
    except subprocess.TimeoutExpired:
        raise UnavailableError(f"{name} had not ended after {PATIENCE / 60:.0f} minutes") from None
    except subprocess.CalledProcessError as error:
        lines = [line.strip() for line in error.stdout.splitlines() if line.strip()]
        raise UnavailableError(f"{name} failed ({lines[-1] if lines else f'exit code {error.returncode}'})") from None


def require_debootstrap() -> None:
    """Install debootstrap and Debian's keys with apt where they are missing."""
    if shutil.which("debootstrap") and KEYRING.exists():
        return
    if shutil.which("apt-get") is None:
        raise UnavailableError("debootstrap and Debian's keyring are missing, and there is no apt-get to install them")
    print("debootstrap …", flush=True)
    run_step("apt-get", "-qq", "update")
    run_step("apt-get", "-qq", "-y", "install", "--no-install-recommends", "debootstrap", "debian-archive-keyring")


def _sources() -> Iterator[str]:
    """Yield the URLs that this machine's apt is set up with, in both of its formats."""
    for file in [SOURCES / "sources.list", *sorted(SOURCES.glob("sources.list.d/*"))]:
        if not file.is_file() or file.suffix not in (".list", ".sources"):
            continue
        for line in file.read_text(errors="replace").splitlines():
            if re.match(r"\s*(deb\s|URIs:)", line):
                yield from re.findall(r"https?://[^\s\]]+", line)


def find_mirror(suite: str) -> str:
    """Return the first of apt's own sources that has this suite of Debian, else Debian's; UnavailableError where none answers."""
    tried = list(dict.fromkeys([*(url.rstrip("/") for url in _sources()), MIRROR]))
    for url in tried:
        try:
            with urllib.request.urlopen(f"{url}/dists/{suite}/InRelease", timeout=ANSWER) as answer:
                if b"\nOrigin: Debian\n" in answer.read(4096):
                    return url
        except (OSError, ValueError, urllib.error.URLError):
            continue
    raise UnavailableError(f"no mirror with Debian {suite} answers, of {', '.join(tried)}")


def _unmount(folder: Path) -> None:
    """Unmount all that debootstrap may have left mounted below a folder, the innermost first."""
    mounted = [line.split()[1] for line in Path("/proc/self/mounts").read_text().splitlines()]
    for place in reversed([place for place in mounted if place.startswith(f"{folder.resolve()}/")]):
        run_step("umount", place)


def _remove(folder: Path) -> None:
    """Remove a folder, but nothing of this machine that is mounted in it."""
    if folder.exists():
        _unmount(folder)
        shutil.rmtree(folder)


def main() -> int:
    """Parse the command line, prepare the system and print what it contains."""
    parser = argparse.ArgumentParser(prog="real_blender.py", description=__doc__.splitlines()[0])
    parser.add_argument("root", type=Path, help="folder of the system; made where it is missing")
    parser.add_argument("--suite", default=SUITE, help="release of Debian (default: %(default)s)")
    options = parser.parse_args()
    try:
        print(f"{prepare(options.root, options.suite)} in {options.root}")
    except (UnavailableError, OSError) as error:
        print(f"error: {error}.", file=sys.stderr)
        return 2
    return 0


if __name__ == "__main__":
    sys.exit(main())
