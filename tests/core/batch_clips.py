"""Clips for tests of a batch whose commands are those of a stand-in, and the command line that runs it."""

import json
import sys
import time

STUB = (sys.executable, "-m", "benchmarks.speed.batch_stub")
PROGRAM = """
import sys
from functools import partial
from f4x_core.batch.work import Settings
from f4x_core.cli import batch, main
batch.Settings = partial(Settings, program=(sys.executable, "-m", "benchmarks.speed.batch_stub"), save_every=0.05)
sys.exit(main(sys.argv[1:]))
"""


def write_clips(folder, **clips):
    """Write one clip for each name, which says how the stand-in behaves; returns the pattern that finds them."""
    folder.mkdir(parents=True, exist_ok=True)
    for name, behaviour in clips.items():
        (folder / f"{name}.clip").write_text(json.dumps({"name": name, **behaviour}))
    return str(folder / "*.clip")


def wait_for(condition, seconds=60):
    """Wait until `condition()` is true and return what it gives."""
    end = time.monotonic() + seconds
    while not (found := condition()):
        assert time.monotonic() < end, "it did not happen in time"
        time.sleep(0.02)
    return found
