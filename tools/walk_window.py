"""The random walk of `walk_blender.py` in the window of a real Blender.

python tools/walk_window.py SCENE.f4x --root CHROOT --out FOLDER --seed 1 --minutes 60

Needs root: CHROOT is a system with Blender, Xvfb and xdotool, as `scripts/real_blender.py` makes it. FOLDER gets the list of
steps, what went to standard error and the result, which is the last line of output too. Exit code 1 where something was wrong, and
where Blender died.
"""

import argparse
import json
import shutil
import subprocess
import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "scripts"))
from real_blender import clean_profile

SIZE = (1000, 700)
"""Pixels of the screen, which the processor draws."""
ALLOCATOR = "LD_PRELOAD=libc.so.6 libstdc++.so.6"
"""Debian's Blender allocates by oneTBB, which gives nothing back to the system: what is free would be counted as in use."""
LONGEST = 900
"""Seconds beyond its minutes that a walk may take for its last step."""


def main() -> int:
    """Walk, and print the results."""
    parser = argparse.ArgumentParser(prog="walk_window.py", description=__doc__.splitlines()[0])
    parser.add_argument("scene", type=Path, help="scene file, name.f4x")
    parser.add_argument("--root", type=Path, required=True, help="folder of the system to chroot into")
    parser.add_argument("--out", type=Path, required=True, help="folder for the list of steps and the result")
    parser.add_argument("--seed", default="0", help="another seed takes other steps (default: 0)")
    parser.add_argument("--minutes", type=float, default=60.0, help="end after so much time (default: 60)")
    parser.add_argument("--steps", default="1000000", help="end after so many steps (default: when the time is over)")
    options = parser.parse_args()
    options.out.mkdir(parents=True, exist_ok=True)
    with clean_profile(options.root) as profile, open(options.out / "blender.log", "w") as log:
        shutil.copy(options.scene, profile.folder / "scene.f4x")
        script = f"{profile.check_out()}/tools/walk_blender.py"
        given = (
            f"{profile.inside}/scene.f4x",
            "--out",
            f"{profile.inside}/walk",
            "--seed",
            options.seed,
            "--steps",
            options.steps,
        )
        window = ("--factory-startup", "--window-geometry", 0, 0, *SIZE)
        with profile.screen(SIZE, log) as start:
            walk = start("env", ALLOCATOR, "blender", *window, "-P", script, "--", *given, "--minutes", options.minutes)
            try:
                code = walk.wait(60 * options.minutes + LONGEST)
            except subprocess.TimeoutExpired:
                code = 1
        for left in (profile.folder / "walk").glob("*.*"):
            if left.name in ("steps.txt", "errors.txt", "result.json"):
                shutil.copy(left, options.out)
    result = options.out / "result.json"
    if not result.exists():
        print(f"Blender ended with code {code} in the last step of {options.out / 'steps.txt'}.", file=sys.stderr)
        return 1
    print(json.dumps(json.loads(result.read_text())))
    return code


if __name__ == "__main__":
    sys.exit(main())
