"""The angle of a view beside the clip, and up to which it is believed."""

from dataclasses import replace

import numpy as np
import pytest
from labelled_scene import labelled_scene

from f4x_core.cli.main import main
from f4x_core.scene import write_scene
from f4x_core.scene.believed import RING, BelievedZone


@pytest.fixture(scope="module")
def zone():
    """All cameras stand at the origin and look along z."""
    found = BelievedZone.of(labelled_scene(provenance={"believed_degrees": 10.0}))
    assert found is not None
    return found


@pytest.mark.parametrize("degrees", [0, 3, 34, 90, 150])
@pytest.mark.parametrize("distance", [0.3, 1.0, 4.0])
def test_the_angle_is_that_at_what_the_camera_looks_at(zone, degrees, distance):
    angle = np.radians(degrees)
    eye = np.array([0, 0, 1]) + distance * np.array([0, np.sin(angle), -np.cos(angle)])
    assert zone.aside(eye) == pytest.approx(degrees, abs=1e-4)


def test_the_nearest_camera_counts(zone):
    more = replace(zone, eyes=np.array([[0, 0, 0], [1.0, 0, 1]]), targets=np.array([[0, 0, 1.0]] * 2))
    assert more.aside(np.array([1.0, 0, 1])) == pytest.approx(0)
    assert more.aside(np.array([1.0, 0, 0])) == pytest.approx(45)


def test_the_ring_is_just_as_far_aside_as_can_be_believed(zone):
    ring = zone.ring(0)
    assert ring.shape == (RING, 3)
    np.testing.assert_allclose([zone.aside(place) for place in ring], 10.0, atol=1e-6)


def test_what_is_said_beyond_it(zone):
    assert zone.line(9.9) == "" and zone.line(34.4) == "34° beside the clip's camera: guesswork (good up to about 10°)"


@pytest.mark.parametrize("known", [{}, {"believed_degrees": None}, {"believed_degrees": 95}])
def test_there_is_none_where_the_fit_did_not_tell(known):
    assert BelievedZone.of(labelled_scene(provenance=known)) is None


@pytest.mark.parametrize("more", [[], ["--exr"]])
def test_a_path_beyond_it_is_told_and_one_within_is_not(tmp_path, capsys, more):
    write_scene(labelled_scene(provenance={"believed_degrees": 3.0}), tmp_path / "scene.f4x")
    render = ["render", str(tmp_path / "scene.f4x"), "-o", str(tmp_path / "out"), *more, "--path"]
    assert main([*render, "orbit", "--degrees", "8"]) == 0
    assert "! 6 of 6 frames are from up to 8° beside the clip's camera: guesswork (good up to about 3°)" in (
        capsys.readouterr().out
    )
    for within in (["orbit", "--degrees", "2"], ["original"]):
        assert main([*render, *within]) == 0
        assert "guesswork" not in capsys.readouterr().out
