"""Words for people and parts of the body, by what a fit stored for every Gaussian."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from labelled_scene import FRAMES, HEIGHT, LABELS, VECTORS, WIDTH, labelled_scene, square_mask
from people_scene import people_scene

from f4x_core.edit.apply import with_operations
from f4x_core.edit.bake import bake
from f4x_core.edit.naming import by_words
from f4x_core.edit.plan import propose
from f4x_core.edit.resolve import EditorState, named, rows_of
from f4x_core.edit.selecting import read_selecting
from f4x_core.errors import F4xError
from f4x_core.fit.people import nearest_part, with_people_of
from f4x_core.priors.joints import LIMBS
from f4x_core.query import prompts
from f4x_core.query.prompts import SelectOptions, select_by_points, select_by_text
from f4x_core.query.questions import answer
from f4x_core.scene import Vocabulary, read_scene, write_scene
from f4x_core.scene.people import PARTS, People, from_left, people_of, with_people


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


def scene_with_rider(label, tagged):
    """The moving square answers to `label`, and the first fraction `tagged` of its Gaussians is a known person's."""
    scene = labelled_scene()
    words = Vocabulary((label, *LABELS[1:]), VECTORS.astype(np.float16))
    person = np.zeros(len(scene.ids), np.uint8)
    moving = np.flatnonzero(scene.moving)
    person[moving[: round(tagged * len(moving))]] = 1
    scene = replace(scene, features=replace(scene.features, vocabularies={"words": words}))
    return with_people(scene, People(person, person * 0))


@pytest.mark.parametrize(
    ("label", "tagged", "left_out"), [("horse", 0.4, True), ("horse", 0.6, False), ("hat", 0.4, False)]
)
def test_a_word_for_an_animal_leaves_its_rider_out(label, tagged, left_out):
    """Unless most of what it finds is the person's; what people wear is theirs."""
    scene = scene_with_rider(label, tagged)
    found = select_by_text(scene, [label]).chosen
    person = people_of(scene).person == 1
    assert found[scene.moving & ~person].all() and not found[~scene.moving].any()
    assert (found & person).sum() == (0 if left_out else person.sum())


@pytest.mark.parametrize("tagged", [0.4, 0.6])
def test_a_click_means_all_that_moves_with_a_person_who_is_most_of_it(monkeypatch, tagged):
    """A fit found the person in some of the Gaussians that move as one; of a horse the rider is the smaller part."""
    scene = labelled_scene(features=False)
    moving = np.flatnonzero(scene.moving)
    person = np.zeros(len(scene.ids), np.uint8)
    person[moving[: round(tagged * len(moving))]] = 1
    person[moving[-2:]] = 2
    scene = with_people(scene, People(person, person * 0))
    row, column = np.argwhere(square_mask(0)).mean(0)
    monkeypatch.setattr(prompts, "person_at", lambda scene, pixels, frame, part: person == 1)
    found = select_by_points(scene, [(column, row)], 0).chosen
    assert np.array_equal(found, scene.moving & (person != 2) if tagged > 0.5 else person == 1)


def test_later_marks_add_to_a_person_and_take_away(monkeypatch):
    scene = scene_with_people()
    people, rows = people_of(scene), np.arange(len(scene.ids))
    one, other, third = (
        np.isin(rows, np.flatnonzero(scene.moving)[part]) for part in (slice(5), slice(5, 9), slice(9, 11))
    )
    thing = {(True,): one | third, (True, True): one | other | third, (True, False): one}
    monkeypatch.setattr(prompts, "person_at", lambda scene, pixels, frame, part: third & (people.person == 1))
    monkeypatch.setattr(
        prompts, "point_out", lambda scene, marks, config: thing[tuple(mark.on for mark in marks)].astype(float)
    )
    row, column = np.argwhere(square_mask(0)).mean(0)

    def found(*labels):
        return select_by_points(scene, [(column, row)] * len(labels), 0, labels=labels).chosen

    assert np.array_equal(found(True), third)
    assert np.array_equal(found(True, True), third | other)
    assert not found(True, False).any()


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


THREE, CROSSING = people_scene(3, order=(1, 2, 0)), people_scene(2, pace=0.13)
"""Three people whose numbers in the scene are not those from left to right, and two of whom the first walks past the second."""


def those_of(scene, rows):
    """(person from left to right, from 1, or 0; names of the parts) of the Gaussians `rows`, where whole persons have no parts."""
    people, found = people_of(scene), set()
    for number, person in enumerate((0, *from_left(scene)[0]), 0):
        own = rows[people.person[rows] == person]
        if len(own):
            whole = len(own) == (people.person == person).sum()
            found.add((number, "" if whole else ", ".join(PARTS[i - 1] for i in np.unique(people.part[own]))))
    return found


@pytest.mark.parametrize(
    ("word", "wanted"),
    [
        *((word, {(2, "")}) for word in ("second person", "person 2", "the person number two", "2nd man", "person #2")),
        *(
            (word, {(1, "")})
            for word in ("person on the left", "leftmost person", "somebody on the left", "1st dancer")
        ),
        *((word, {(3, "")}) for word in ("last person", "the man on the far right", "right woman")),
        *((word, {(1, ""), (2, ""), (3, "")}) for word in ("the three people", "all three men", "everyone", "riders")),
        *(
            (word, {(2, "left hand")})
            for word in ("second person's left hand", "left hand of the person in the middle")
        ),
        ("head of person 3", {(3, "head")}),
        ("face", {(1, "head"), (2, "head"), (3, "head")}),
    ],
)
def test_a_word_means_one_person_counted_from_left_to_right(word, wanted):
    assert those_of(THREE, np.flatnonzero(by_words(THREE, [word])[word].chosen)) == wanted


def test_left_is_that_of_the_present_frame_and_numbers_stay():
    for frame, left in ((0, 1), (5, 2)):
        context = EditorState(frame=frame)
        for who, part in (("the person on the left", ""), ("the head of the person on the left", "head")):
            found = propose(CROSSING, f"make {who} red", context).chosen.operations[0]
            assert those_of(CROSSING, rows_of(CROSSING, found.select)) == {(left, part)}
        found = propose(CROSSING, "make person 1 red", context).chosen.operations[0]
        assert those_of(CROSSING, rows_of(CROSSING, found.select)) == {(1, "")}


@pytest.mark.parametrize(
    ("sentence", "wanted"),
    [
        ("remove the second person", {(2, "")}),
        ("make person 2 green", {(2, "")}),
        ("delete somebody on the left", {(1, "")}),
        ("blur every face", {(1, "head"), (2, "head"), (3, "head")}),
        ("make the left hand of the person on the left blue", {(1, "left hand")}),
        ("make everyone's hands blue", {(n, "left hand, right hand") for n in (1, 2, 3)}),
        ("hide the second man's legs", {(2, "left leg, right leg")}),
        ("remove everyone except the first person", {(2, ""), (3, "")}),
        ("make the first and the third person blue", {(1, ""), (3, "")}),
        ("make the person 2 times bigger", {(1, ""), (2, ""), (3, "")}),
        ("copy person 3 to the right", {(3, "")}),
        ("remove the person behind the car", {(3, "")}),
    ],
)
def test_sentences_about_single_people(sentence, wanted):
    found = propose(THREE, sentence).chosen.operations[0]
    assert those_of(THREE, rows_of(THREE, found.select)) == wanted


def test_the_other_person_is_who_is_neither_named_nor_selected():
    first = by_words(CROSSING, ["first person"])["first person"]
    for sentence, context in (
        ("remove the other person", EditorState(first)),
        ("make person 1 red and the other person blue", EditorState()),
    ):
        found = propose(CROSSING, sentence, context).chosen.operations[-1]
        assert those_of(CROSSING, rows_of(CROSSING, found.select)) == {(2, "")}


@pytest.mark.parametrize(
    ("count", "text", "reason"),
    [
        (2, "the third person", "There are 2 people in the scene, so 'the third person' is nobody."),
        (1, "person 2", "There is 1 person in the scene, so 'the second person' is nobody."),
        (1, "the other man", "'the other man' is nobody"),
        (3, "the other man", "'the other man' may be anybody"),
        (3, "the two people", "There are 3 people in the scene, not two."),
        (1, "both men", "There is 1 person in the scene, not two."),
    ],
)
def test_who_is_not_there_is_said_in_one_sentence(count, text, reason):
    scene = people_scene(count)
    for ask in (
        lambda: by_words(scene, [text]),
        lambda: propose(scene, f"hide {text}"),
        lambda: answer(scene, f"where is {text}?"),
    ):
        with pytest.raises(F4xError, match=reason.replace(".", r"\.")):
            ask()


@pytest.mark.parametrize(
    ("word", "remark"),
    [
        ("man", "'man' is taken for a person; the scene cannot tell men from women."),
        ("kids", "children from adults"),
        ("rider", "'rider' is taken for a person; the scene cannot tell what people are or do."),
        ("the woman's hand", "men from women"),
        ("person 2", "People are counted from left to right at frame 0."),
        ("people", ""),
        ("heads", ""),
    ],
)
def test_a_remark_goes_with_the_selection_the_plan_and_the_answer(word, remark):
    the = word if word == "person 2" or word.startswith("the ") else f"the {word}"
    sentences = [
        " ".join(by_words(THREE, [word])[word].remarks),
        " ".join(propose(THREE, f"blur {the}").notes),
        " ".join(read_selecting(THREE, f"select {the}").remarks),
    ]
    assert all(remark in each and bool(each) == bool(remark) for each in sentences), sentences


@pytest.mark.parametrize(
    ("question", "said"),
    [
        ("how many people are there?", ["3 separate"]),
        ("when does she move?", ["first person moves to the right", "second person moves from"]),
        (
            "when does she jump?",
            ["first person does not jump", "second person jumps by 0.10", "third person does not jump"],
        ),
        ("does the person on the right move?", ["No: the third person stands still"]),
        ("is anyone in front of the car?", ["No: the first person", "No: the third person"]),
        ("is anyone on the left?", ["Yes: the first person is on the left", "No: the third person"]),
        ("where is her left hand?", ["first person's left hand is on the left"]),
        ("who is on the left?", ["The first person is on the left"]),
        ("who moves?", ["first person moves", "third person stands still"]),
        ("which person is nearest?", ["The first person is nearer"]),
        (
            "where are the people?",
            ["first person is on the left", "second person is in the middle", "third person is on the right"],
        ),
        ("how far is person 1 from person 2?", ["The first person and the second person are 0.40"]),
        ("what moves?", ["first person moves", "second person moves"]),
        ("is there a woman?", ["cannot tell men from women"]),
    ],
)
def test_questions_are_answered_for_each_person(question, said):
    text = answer(THREE, question).text
    assert all(part in text for part in said) and text.count("counted from left") <= 1, text


def test_two_people_are_two_things_and_who_somebody_is_stays_unknown():
    assert "The first person and the second person are" in answer(CROSSING, "how far apart are the two people?").text
    with pytest.raises(F4xError, match="who somebody is"):
        answer(CROSSING, "who is she?")


def test_a_click_on_a_limb_with_part_means_the_limb():
    people, hand = people_of(THREE), PARTS.index("right hand") + 1
    rows = (people.person == 3) & (people.part == hand)
    pixel = THREE.cameras[0].project(THREE.posed(0).means[rows].mean(0)[None].astype(float))[0]
    assert np.array_equal(select_by_points(THREE, pixel, 0, options=SelectOptions(part=True)).chosen, rows)
    assert np.array_equal(select_by_points(THREE, pixel, 0).chosen, people.person == 3)


def test_people_are_counted_at_the_first_frame_that_shows_all_of_them():
    """The first person comes into the picture at the left when the others are there already."""
    scene = people_scene(3, pace=0.13, since=-5)
    order, frame = from_left(scene)
    assert order.tolist() == [1, 2, 3] and frame > 0
    assert from_left(scene, 5)[0].tolist() == [1, 2, 3] and from_left(people_scene(3, pace=0.13), 5)[0].tolist() == [
        2,
        1,
        3,
    ]


@pytest.mark.parametrize(("name", "called"), [("person 1", "person 1"), ("second person", "the second person")])
def test_a_name_that_somebody_gave_is_no_number(name, called):
    scene = with_operations(THREE, *propose(THREE, f'call the last person "{name}"').chosen.operations)
    assert those_of(THREE, np.flatnonzero(by_words(scene, [name])[name].chosen)) == {(3, "")}
    found = propose(scene, f"make {called} red").chosen.operations[0]
    assert those_of(THREE, rows_of(scene, found.select)) == {(3, "")}
    selected = EditorState(by_words(THREE, ["person 2"])["person 2"])
    assert propose(THREE, f"call it {name}", selected).chosen.operations[0].name == name


def test_a_question_means_who_was_called_so():
    scene = with_operations(THREE, *propose(THREE, 'call the last person "second person"').chosen.operations)
    assert "second person stands still" in answer(scene, "does the second person move?", names=named(scene)).text


@pytest.mark.parametrize("word", ["crowd", "spectators", "spectator", "audience"])
def test_those_who_look_on_are_not_those_whom_the_fit_found(word):
    """A dancer is found, her audience of fifty is not: "remove the crowd" must not take her away."""
    scene = scene_with_people()
    assert by_words(scene, ["people"])["people"].chosen.any()
    with pytest.raises(F4xError, match="knows no words"):
        by_words(scene, [word])
