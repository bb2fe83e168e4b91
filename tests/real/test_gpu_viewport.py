"""The viewport's picture on the graphics card, drawn by a software one in a real Blender: `tools/check_gpu.py`."""

import json
import subprocess
import sys
from pathlib import Path

import pytest

pytestmark = [pytest.mark.real, pytest.mark.blender]
REPOSITORY = Path(__file__).resolve().parents[2]
sys.path.insert(0, str(REPOSITORY / "scripts"))
from real_blender import clean_profile  # noqa: E402 - the scripts are no package

WITHIN = 0.999
"""Least fraction of pixels that are within two steps of 8 bits of the engine's."""
VULKAN = "usr/share/vulkan/icd.d"


@pytest.fixture(scope="module", params=["opengl", "vulkan"])
def found(request, blender_root) -> dict:
    """What the script says, on each of Blender's two ways to a graphics card."""
    if request.param == "vulkan" and not list((blender_root / VULKAN).glob("lvp*")):
        pytest.skip("the system has no software Vulkan (mesa-vulkan-drivers)")
    with clean_profile(blender_root) as profile:
        home = profile.check_out()
        words = ("blender", "-b", "--factory-startup", "--gpu-backend", request.param, "--python-exit-code", 1)
        command = profile.command(*words, "-P", f"{home}/tools/check_gpu.py", "--")
        done = subprocess.run(command, capture_output=True, text=True, timeout=300, env=profile.environment)
    assert done.returncode == 0, done.stdout + done.stderr
    said = [line for line in done.stdout.splitlines() if line.startswith("Feature4X:")]
    answer = json.loads([line for line in done.stdout.splitlines() if line.startswith("{")][-1])
    assert answer["backend"] == request.param.upper()
    return answer | {"said": said}


def test_the_picture_is_the_engines(found):
    shares = {name: picture["within_2"] for name, picture in found["pictures"].items()}
    assert len(shares) == 6 and min(shares.values()) >= WITHIN, shares


def test_a_driver_that_refuses_is_named_once_and_the_processor_draws(found):
    assert found["refused"]
    (sentence,) = found["said"]
    assert sentence.endswith("the processor does.")


def test_a_redraw_of_a_small_stage_takes_the_processor_little_time(found):
    """The limit is that of 110,000 Gaussians; these are a twelfth."""
    assert all(kind["median"] < 6 for kind in found["milliseconds"].values()), found["milliseconds"]
