"""The camera's motion in words, of paths that are known."""

from dataclasses import replace

import numpy as np
import pytest
from labelled_scene import labelled_scene

from f4x_core.errors import F4xError
from f4x_core.query.camera_words import camera_words
from f4x_core.query.questions import answer
from f4x_core.query.wording import Asked

PATH = labelled_scene(features=False).cameras


def path(degrees=0.0, shift=(0.0, 0.0, 0.0), about=1):
    """A camera that turns by `degrees` about one of its axes and moves by `shift` in the world, evenly over the clip."""
    poses = []
    for part in np.linspace(0, 1, len(PATH)):
        sine, cosine = np.sin(np.radians(degrees * part)), np.cos(np.radians(degrees * part))
        turned = np.eye(4)
        one, two = (axis for axis in range(3) if axis != about)
        turned[[one, two, one, two], [one, two, two, one]] = cosine, cosine, -sine, sine
        turned[:3, 3] = -turned[:3, :3] @ (np.array(shift) * part)
        poses.append(turned)
    return replace(PATH, world_to_camera=np.stack(poses))


@pytest.mark.parametrize(
    ("cameras", "words"),
    [
        (path(), "The camera stands still."),
        (path(0.2, (0, 0.003, 0)), "The camera stands still."),
        (path(shift=(0.3, 0, 0.4)), "The camera moves by up to 0.50 times the median depth."),
        (path(12), "The camera turns to the right by up to 12 degrees and stays in its place."),
        (path(-12), "The camera turns to the left by up to 12 degrees and stays in its place."),
        (path(7, about=0), "The camera turns down by up to 7.0 degrees and stays in its place."),
        (path(-7, about=0), "The camera turns up by up to 7.0 degrees and stays in its place."),
        (path(7, about=2), "The camera turns by up to 7.0 degrees and stays in its place."),
        (
            path(-12, (0, 0.1, 0)),
            "The camera moves by up to 0.10 times the median depth and turns to the left by up to 12 degrees.",
        ),
    ],
)
def test_how_a_camera_moves(cameras, words):
    assert camera_words(cameras, Asked("camera")) == words


@pytest.mark.parametrize("question", ["Does the camera move?", "Is the camera moving?", "Did the camera ever move?"])
@pytest.mark.parametrize(("cameras", "yes"), [(path(), "No: the camera stands"), (path(9), "Yes: the camera turns")])
def test_whether_a_camera_moves(question, cameras, yes):
    scene = labelled_scene(cameras=cameras)
    assert answer(scene, question).text.startswith(yes)


@pytest.mark.parametrize(
    ("question", "words"),
    [
        ("Is the camera static?", "No: the camera moves"),
        ("Does the camera stand still?", "No: the camera moves"),
        ("Does the camera turn?", "No: the camera moves"),
        ("Does the camera pan?", "No: the camera moves"),
        ("How does the camera move?", "The camera moves by up to 0.50"),
        ("How far does the camera move?", "The camera moves by up to 0.50"),
        ("Where is the square, and does the camera move?", "The square is"),
    ],
)
def test_other_questions_about_it(question, words):
    assert answer(labelled_scene(cameras=path(shift=(0.3, 0, 0.4))), question).text.startswith(words)


@pytest.mark.parametrize(
    "question", ["Does the camera zoom?", "Which lens does the camera have?", "Who holds the camera?"]
)
def test_what_it_was_set_to_is_refused(question):
    with pytest.raises(F4xError, match="cannot tell"):
        answer(labelled_scene(), question)
