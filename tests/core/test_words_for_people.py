"""Words for people and parts of the body, by what a fit stored for every Gaussian."""

from types import SimpleNamespace

import numpy as np
import pytest
from labelled_scene import FRAMES, HEIGHT, WIDTH, labelled_scene, square_mask

from f4x_core.edit.bake import bake
from f4x_core.edit.naming import by_words
from f4x_core.edit.plan import propose
from f4x_core.edit.resolve import rows_of
from f4x_core.errors import F4xError
from f4x_core.fit.people import nearest_part, with_people_of
from f4x_core.priors.joints import LIMBS
from f4x_core.query.prompts import select_by_points
from f4x_core.query.questions import answer
from f4x_core.scene import read_scene, write_scene
from f4x_core.scene.people import PARTS, People, people_of, with_people


def scene_with_people(features=False):
    """The square is person 1, its upper half a head, its lower half a left hand; a patch of the wall on the right is person 2."""
    scene = labelled_scene(features=features)
    square = np.arange(len(scene.ids)) >= len(scene.static)
    places = scene.posed(0).means
    patch = ~square & (places[:, 0] > 0.4) & (places[:, 0] < 0.6) & (abs(places[:, 1]) < 0.2)
    part = np.where(square, np.where(places[:, 1] < 0, 1, 5), np.where(patch, 2, 0))
    return with_people(scene, People((square + 2 * patch).astype(np.uint8), part.astype(np.uint8)))


def test_parts_of_the_body_are_those_of_the_joints():
    assert tuple(LIMBS) == PARTS


@pytest.mark.parametrize("features", [False, True])
@pytest.mark.parametrize(
    ("word", "values"),
    [
        *((word, None) for word in ("person", "the men", "dancer", "somebody")),
        *((word, [1]) for word in ("head", "face")),
        *((word, [5]) for word in ("left hand", "hands", "the woman's hand")),
        *(("right hand", []), ("torso", [2])),
    ],
)
def test_a_word_selects_people_exactly_without_a_teacher(word, values, features):
    scene = scene_with_people(features)
    people = people_of(scene)
    wanted = people.person > 0 if values is None else np.isin(people.part, values)
    assert np.array_equal(by_words(scene, [word])[word].chosen, wanted)


def test_other_words_are_none_of_peoples_and_without_people_nothing_is_known():
    assert by_words(scene_with_people(True), ["wall"])["wall"].chosen.sum() > 500
    for scene, word in ((scene_with_people(), "snowman"), (labelled_scene(features=False), "person")):
        with pytest.raises(F4xError):
            by_words(scene, [word])


@pytest.mark.parametrize(
    ("sentence", "person", "part"),
    [
        ("make the person on the right green", 2, None),
        ("delete the left person", 1, None),
        ("delete both people", (1, 2), None),
        ("make the head red", 1, 1),
        ("make the left hand red", 1, 5),
    ],
)
def test_a_sentence_means_single_people_and_their_parts(sentence, person, part):
    scene = scene_with_people()
    found = propose(scene, sentence).chosen.operations[0]
    people = people_of(scene)
    wanted = np.isin(people.person, person) & ((people.part == part) if part else True)
    assert np.array_equal(rows_of(scene, found.select), np.flatnonzero(wanted))


def test_what_cannot_be_told_is_said():
    assert "cannot tell men from women" in " ".join(propose(scene_with_people(), "make the woman red").notes)
    assert "cannot tell men from women" in answer(scene_with_people(), "where is the man?").text


def test_questions_count_people_and_find_them():
    assert "2 separate" in answer(scene_with_people(), "how many people are there?").text
    assert "person" in answer(scene_with_people(), "where is the person?").text


def test_a_click_on_a_person_means_the_person():
    scene = scene_with_people()
    row, column = np.argwhere(square_mask(0)).mean(0)
    found = select_by_points(scene, [(column, row)], 0)
    assert np.array_equal(found.chosen, people_of(scene).person == 1)


def test_labels_survive_the_file_baking_and_a_background(tmp_path):
    scene = scene_with_people()
    write_scene(scene, tmp_path / "a.f4x")
    again = read_scene(tmp_path / "a.f4x")
    baked = bake(again)
    assert np.array_equal(people_of(baked).person, people_of(scene).person)
    assert people_of(scene.background).person.sum() == 2 * (people_of(scene).person == 2).sum()


def test_masks_and_joints_of_the_priors_are_lifted():
    scene = labelled_scene(features=False)
    masks = np.stack([square_mask(t) for t in range(FRAMES)])
    joints = np.full((FRAMES, 1, 33, 3), np.nan, np.float32)
    for t, mask in enumerate(masks):
        rows, columns = np.nonzero(mask)
        joints[t, 0, [0, 7]] = [[columns.min(), rows.min(), 1], [columns.max(), rows.min(), 1]]
        joints[t, 0, [15, 17]] = [[columns.min(), rows.max(), 1], [columns.max(), rows.max(), 1]]
    priors = SimpleNamespace(
        people=masks.astype(np.uint8), people_probability=masks.astype(np.float16), people_joints=joints,
        frames=np.arange(FRAMES), width=WIDTH, height=HEIGHT,
    )  # fmt: skip
    people = people_of(with_people_of(scene, priors))
    assert (people.person[scene.moving] == 1).mean() > 0.95
    assert (people.person[~scene.moving] == 0).mean() > 0.97
    heights = scene.posed(0).means[:, 1]
    assert (people.part[scene.moving & (heights < -0.05)] == 1).mean() > 0.9
    assert (people.part[scene.moving & (heights > 0.05)] == 5).mean() > 0.9
    priors.people = np.zeros_like(priors.people)
    assert with_people_of(scene, priors) is scene


def test_hidden_joints_tell_no_part():
    joints = np.zeros((33, 3), np.float32)
    assert (nearest_part(np.zeros((2, 2)), joints) == -1).all()
