"""For `pytest -p tests.torch_free` where only numpy and pytest are: a test that lacks another package is skipped, no other.

A room that must do without torch cannot hide here: tests/core/test_torch_free.py blocks torch in another way.
"""

import re
from importlib.util import find_spec

import pytest

WHEELS = ("torch", "cv2", "av", "scipy", "PIL", "pycolmap", "matplotlib", "OpenEXR", "rich", "trimesh", "bpy")
FURTHER = ("transformers", "mcp", "ray", "fsspec", "pydantic", "xllamacpp", "threadpoolctl", "safetensors", "ruff")
ABSENT = [name for name in (*WHEELS, *FURTHER) if find_spec(name) is None]
LACKS = re.compile(rf"No module named '({'|'.join(ABSENT)})\b|needs? the package `?({'|'.join(ABSENT)})\b")


def skip_what_lacks(report):
    """Turn a failure for want of a package into a skip that names it."""
    found = LACKS.search(str(report.longrepr)) if ABSENT and report.failed else None
    if found:
        report.outcome = "skipped"
        report.longrepr = (str(report.nodeid), 0, f"Skipped: {found[1] or found[2]} is not here")
    return report


@pytest.hookimpl(wrapper=True)
def pytest_make_collect_report(collector):
    return skip_what_lacks((yield))


@pytest.hookimpl(wrapper=True)
def pytest_runtest_makereport(item, call):
    return skip_what_lacks((yield))
