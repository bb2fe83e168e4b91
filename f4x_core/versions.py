"""Every version number of the project: the one home of each. Plain numbers and text, so that builds read it without importing."""

VERSION = "0.1.0"
"""Of the program: wheels, extension, tag `v0.1.0` and heading of CHANGELOG.md. blender_manifest.toml and CITATION.cff repeat it,
which a test and `scripts/dev.py release` check."""
SCENE_FILE = 4
"""Newest `scene.json` that is read. 1: the beginning. 2: a feature field. 3: Gaussians that come and go. 4: node poses as runs.
Written is the smallest that holds the scene."""
PRIORS = 1
"""Of the priors folder; other ones are refused."""
CAMERA_PATH = 1
"""Of a camera file; other ones are refused."""
