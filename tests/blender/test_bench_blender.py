"""The measurements of the extension run, find nothing left registered, and agree with the core."""

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

SCRIPT = Path(__file__).resolve().parents[2] / "tools" / "bench_blender.py"
SMALL = ("--static", "500", "--dynamic", "500", "--nodes", "8", "--frames", "6")


@pytest.mark.skipif(os.name == "nt", reason="the deaf job of the row cancel is a POSIX one")
def test_rows_of_a_small_scene():
    done = subprocess.run([sys.executable, str(SCRIPT), *SMALL, "--json"], capture_output=True, text=True, timeout=120)
    assert done.returncode == 0, done.stderr
    rows = json.loads(done.stdout.splitlines()[-1])
    assert rows["import"]["gaussians"] == 1000 and rows["playback"]["frames"] == 6
    assert rows["motion"]["position"] < 1e-5 and rows["motion"]["rotation"] < 1e-5
    assert rows["registration"]["registered"] > 100 and rows["registration"]["left"] == []
    assert rows["cancel"]["state"] == "cancelled" and rows["cancel"]["seconds"] < 2
    assert rows["click"]["gaussians"] == 1000 and rows["click"]["moving_seconds"] < 5
    assert "left_out" in rows["query"]  # a random scene has no words
