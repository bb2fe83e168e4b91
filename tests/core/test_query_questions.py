"""Answers that are computed, that a model gives from features, and that a server gives from pictures."""

import json
import re
from types import SimpleNamespace

import numpy as np
import pytest
from labelled_scene import FRAMES, labelled_scene
from stub_server import client, saying, stub_server

from f4x_core.edit.apply import with_operations
from f4x_core.edit.operations import Delete
from f4x_core.edit.selects import Ids
from f4x_core.errors import F4xError
from f4x_core.geometry.trajectory import frozen, orbit, original
from f4x_core.query import questions
from f4x_core.query.chat import ChatServer
from f4x_core.query.engines import Engines
from f4x_core.query.questions import COMPUTED, SERVER, answer, ask_features
from f4x_core.query.selection import SELECTED, Selection
from f4x_core.query.wording import Unanswerable

GOOD = saying(" A red square moves. ")


@pytest.fixture(scope="module")
def scene():
    return labelled_scene()


@pytest.fixture
def server():
    with stub_server() as stub:
        stub.reply = (200, GOOD, 0)
        yield stub


@pytest.mark.parametrize(
    "question",
    [
        "Where is {}?",
        "Does {} move?",
        "How far away is {}?",
        "How wide is {} and does it turn?",
        "Is {} left of the wall?",
    ],
)
def test_it_is_what_is_selected(scene, question):
    selected = Selection(scene.ids, scene.moving.astype(float), np.zeros(len(scene.ids), bool))
    called = answer(scene, question.format("rex"), names={"rex": selected}).text.lower()
    for it in ("it", "the selection", "the selected thing"):
        found = answer(scene, question.format(it), names={SELECTED: selected}).text.lower()
        assert found.replace("the selection", "rex") == called
    with pytest.raises(F4xError, match="another"):
        answer(scene, "Does it move?", names={SELECTED: Selection(np.array([10**6]), np.ones(1), np.zeros(1, bool))})


@pytest.mark.parametrize("question", ["What is it?", "what's that thing", "What is selected?", "What did I click on?"])
def test_what_is_selected_is_told_by_the_scenes_words(scene, question):
    selected = Selection(scene.ids, scene.moving.astype(float), np.zeros(len(scene.ids), bool))
    assert answer(scene, question, names={SELECTED: selected}).text.startswith("The selection is the square (100%).")
    half = np.arange(len(scene.ids)) >= len(scene.static) - len(scene.dynamic)
    selected = Selection(scene.ids, half.astype(float), np.zeros(len(scene.ids), bool))
    message = answer(scene, question, names={SELECTED: selected}).text
    assert "the square (50%)" in message and "the wall (50%)" in message
    with_others = answer(scene, "What is it?").text
    assert "wall" in with_others and "selection" not in with_others


def test_another_word_for_a_thing_is_not_near_it(scene):
    selected = Selection(scene.ids, scene.moving.astype(float), np.zeros(len(scene.ids), bool))
    assert answer(scene, "What is near it?", names={SELECTED: selected}).text.startswith(
        "Near the selection: the wall."
    )


def test_a_server_sees_frames_and_answers(scene, server):
    said = answer(scene, "What moves?", engines=Engines(client(server, key="secret", model="m")))
    assert (said.text, said.answered_by) == ("A red square moves.", SERVER)
    path, headers, body = server.asked[0]
    assert path == "/v1/chat/completions" and headers["Authorization"] == "Bearer secret" and body["model"] == "m"
    parts = body["messages"][0]["content"]
    pictures = [part["image_url"]["url"] for part in parts if part["type"] == "image_url"]
    assert len(pictures) == FRAMES and all(url.startswith("data:image/png;base64,") for url in pictures)
    assert parts[-1] == {"type": "text", "text": "What moves?"}


@pytest.mark.parametrize(
    ("reply", "words"),
    [
        ((500, b"image input is not supported", 0), "answered 500.*text only"),
        ((401, b"bad key", 0), "answered 401 .bad key"),
        ((200, b"<html>", 0), "not the JSON of a chat"),
        ((200, {"choices": []}, 0), "not the JSON of a chat"),
        ((200, {"choices": [{"message": {"content": ""}}]}, 0), "empty"),
        ((200, GOOD, 0.5), "no answer within 0.2 seconds"),
        ((307, b"", 0), "answered 307"),
    ],
)
def test_a_server_that_fails_is_one_sentence(scene, server, reply, words):
    server.reply = reply
    with pytest.raises(F4xError, match=words) as caught:
        answer(scene, "What?", frozen(scene.cameras, 1.0)[:1], Engines(client(server, timeout=0.2 if reply[2] else 5)))
    assert "\n" not in str(caught.value)


def test_a_server_that_is_not_there(scene):
    with pytest.raises(F4xError, match="cannot be reached"):
        answer(scene, "What?", engines=Engines(ChatServer("http://127.0.0.1:9/v1", timeout=2)))


@pytest.mark.parametrize("url", ["file:///etc/passwd", "127.0.0.1:80", ""])
def test_addresses_that_are_none(url):
    with pytest.raises(F4xError, match="no address"):
        ChatServer(url)


def test_the_environment_names_a_server(monkeypatch):
    monkeypatch.delenv("F4X_CHAT_URL", raising=False)
    assert ChatServer.from_environment() is None
    monkeypatch.setenv("F4X_CHAT_URL", "http://127.0.0.1:1/v1")
    monkeypatch.setenv("F4X_CHAT_KEY", "k")
    assert ChatServer.from_environment() == ChatServer("http://127.0.0.1:1/v1", "k")


def test_computed_answers_say_so(scene):
    said = answer(scene, "What is there?")
    assert said.answered_by == COMPUTED and "Computed from" in said.text and "square" in said.text
    json.dumps(said.evidence)


@pytest.mark.parametrize(
    ("question", "words"),
    [
        ("Where is the square?", r"The square is (on the left|in the middle), near, [\d.]+% of the picture"),
        ("Where is the square at the end?", r"in the middle.* at frame 5"),
        ("When does the square move?", r"The square moves to the right from frame 0 to 5 \(0\.0 to 0\.2 s\)"),
        ("How far does it go?", r"The square moves 0\.25 times"),
        ("How fast is the square?", r"The square moves at 1\.20 times the median depth a second"),
        ("In what order do things move?", r"start to move: the square \(frame 0\)\."),
        ("Does the square move?", "^Yes: the square moves"),
        ("Is the wall moving?", "^No: the wall stands still"),
        ("Is there a square?", "^Yes: the square is"),
        ("Are there any squares?", "^Yes: the square is"),
        (
            "Is there a sky?",
            "^No: nothing in the scene answers to 'sky' .*the scene answers to (wall, square|square, wall)",
        ),
        ("Does the sky move?", "^No: nothing in the scene answers to 'sky'"),
        ("Is there a square on the right?", "^No: the square is"),
        ("Is there a red square?", "^Yes: the square.*what is red I cannot tell"),
        ("When is the square visible?", "The square is seen from frame 0 to 5"),
        ("How many frames are there?", r"6 frames \(0 to 5\), 24 a second, and lasts 0\.25 seconds"),
        ("How long is the clip?", r"lasts 0\.25 seconds"),
        ("What happens at second 0.1?", r"square: .*moves to the right at frame 2\.4 \(0\.1 s\), 1\.2\d times"),
        (
            "What happens at frame 3?",
            r"^square: [^.]*\.[^.]*\. The square moves [^.]*\.\d[^.]*\.\d+ [^.]*\. \(Computed",
        ),
        ("Describe the scene at frame 3", "wall: .*The wall stands still at frame 3"),
        ("Does the square never move?", "^No: the square moves to the right"),
        ("Does the wall never move?", "^Yes: the wall stands still"),
        ("Isn't the square moving?", "^Yes: the square moves"),
        ("Is the wall not moving?", "^Yes: the wall stands still"),
        ("Is the square standing still?", "^No: the square moves"),
        ("Is there no square?", "^No: the square is"),
        ("Are there no skies?", "^Yes: nothing in the scene answers to 'sky'"),
        ("Is the square not on the left?", "^No: the square is on the left"),
        ("Is the square always visible?", r"^Yes: the square is seen in all 6 frames"),
        ("Is the square not visible all the time?", r"^No: the square is seen in all 6 frames"),
        ("When does the square enter the picture?", "^The square is seen from the beginning, and does not come in"),
        ("Does the square ever disappear?", "^No: the square is seen to the end"),
        ("Does the square fly?", "^The square moves .* Whether that is what 'fly' means I cannot tell"),
        ("Does the wall fly?", "^No: the wall stands still"),
        ("Which way does the square go at second 0.1?", "moves to the right at frame 2.4"),
        ("What colour is the square?", r"^The square is red \(100%\)\."),
        ("Is the square blue?", r"^No: the square is red"),
        ("Is the wall blue or red?", r"^The wall is blue"),
        ("How many squares are there?", r"^Square: 1 separate in the scene[;.]"),
        ("How many things move?", "^1 separate thing moves: the square"),
        (
            "When is the square closest to the camera?",
            r"^The square is nearest to the camera at frame 4 \(0\.2 s\): 0\.90",
        ),
        ("When is the square farthest from the camera?", r"^The square is farthest from the camera at frame 0"),
        (
            "How far is the square from the wall at frame 4?",
            r"^The square and the wall are 0\.30 times the median depth apart",
        ),
        ("Is the square in front of the wall?", "^Yes: the square is nearer than the wall at frame 0"),
        ("Is the wall closer than the square?", "^No: the square is nearer"),
        ("Is the wall bigger than the square?", "^Yes: the wall is "),
        ("Name the things from left to right", r"^From left to right at frame 0 \(0\.0 s\): the square, the wall"),
        ("Order everything by distance", "^From near to far .*: the square, the wall"),
        ("What is behind the square?", "^Behind the square: the wall"),
        ("What is nearest to the square?", "^Nearest to the square: the wall"),
        ("What is standing still?", "^Standing still: the wall"),
        ("What is the biggest thing?", "^The biggest thing is the wall"),
        ("What moves the most?", r"^The square moves the most: 0\.25"),
        ("What is the square's top speed?", r"^The square moves at 1\.20 times the median depth a second at most"),
        ("Does the square ever stop?", "^No: the square moves all the time"),
        ("How high does the square jump?", "^The square does not jump: it never rises by 15% of its height"),
        ("Does the square jump?", "^No: the square does not jump"),
        ("How high does the square rise?", r"^The square rises by 0\.00"),
        ("What does the square do?", "square: .*The square moves to the right"),
        ("What is the square doing?", "square: .*The square moves to the right"),
        ("What does not move?", "^Standing still: the wall"),
        ("What path does the square take?", "^The square goes: .* at frame 0 .*; then .* at frame 5"),
        ("When does the square turn?", "^The square goes straight on"),
        (
            "Is the square coming closer to the camera?",
            "^Yes: the square is 0.92 .* from the camera at frame 0 .* and 0.90",
        ),
        ("Is the square faster than the wall?", "^Yes: the square is faster.*: the square 1.20, the wall 0.00"),
        ("What is the brightest thing?", "^The wall is the brightest|^The square is the brightest"),
        ("What is the smallest thing?", "^The smallest thing is the square"),
        ("What is in front of the wall?", "^In front of the wall: the square"),
        ("What is to the right of the square?", "^Right of the square: "),
        ("Sort the objects by size", "^From big to small .*: the wall, the square"),
        ("Is the square near the wall?", "the square and the wall are 0.* apart"),
        ("Where does the square end up?", "in the middle.* at frame 5"),
        ("Is the square moving left?", "^No: the square moves to the right"),
        ("Is the square always moving?", "^Yes: the square moves all the time"),
        ("What is above the square?", "^Above the square: the wall"),
        ("Is there anything between the square and the camera?", "^Between them: nothing"),
        ("How far is the square? And how far is the wall?", "The square is 0.92 .* The wall is 1.20"),
        ("In what order do the square and the wall start moving?", r"the square \(frame 0\)\."),
        ("When is it highest?", "^The square is highest"),
        ("Where is the square and when does it move?", "square is .* The square moves to the right from"),
        (
            "Where is the sky and when does it move?",
            r"^Nothing in the scene answers to 'sky'[^.]*0\.\d+\)[^.]*\. \(Computed",
        ),
    ],
)
def test_computed_answers_are_right(scene, question, words):
    said = answer(scene, question)
    assert re.search(words, said.text), said.text


@pytest.mark.parametrize("kind", ["race", "police", "guide", "circus", "drift"])
def test_of_a_compound_the_kind_of_thing_is_looked_for_and_that_is_said(scene, kind):
    said = answer(scene, f"Where is the {kind} square?").text
    assert re.search(rf"The square .* I looked for square: whether it is a {kind} square I cannot tell\.", said)
    taught = Selection(scene.ids, ~scene.moving.astype(bool), np.zeros(len(scene.ids), bool))
    assert "I looked for" not in answer(scene, f"Where is the {kind} square?", names={f"{kind} square": taught}).text


@pytest.mark.parametrize(
    ("question", "words"),
    [
        ("What happens at second 3?", "no second 3: the clip lasts 0.25 seconds, frames 0 to 5"),
        ("Where is the square at frame 6?", "no frame 6"),
        ("Is it there at 0:02?", "no second 2"),
        ("What was the focal length of the camera?", "cannot tell what the camera was set to"),
        ("Why does the square move?", "cannot tell why"),
        ("Who is that?", "cannot tell who"),
        ("Is there a square with a hat?", "'hat' means"),
        ("Is the square happy?", "not know what 'happy' means"),
        ("Will the square crash?", "not know what 'crash' means"),
        ("Where was this filmed?", "not know what 'filmed' means"),
        ("Where is the zebra?", "lacks 'zebra'"),
        ("When does the square not move?", "cannot tell what 'not' asks for here"),
        ("Does the square move only at frame 3?", "cannot tell what 'only' asks for here"),
        ("Is there anything but a square?", "cannot tell"),
        ("Is there nothing but a square?", "cannot tell"),
        ("Are there other squares?", "not know what 'other' means"),
        ("Is there a hot square?", "not know what 'hot' means"),
        ("When does the square bark?", "not know what 'bark' means"),
        ("When does it bark?", "not know what 'bark' means"),
        ("Where is the square looking?", "cannot tell which way something looks"),
        ("Which way does the square look?", "cannot tell which way something looks"),
        ("In which direction is the square facing?", "cannot tell which way something looks"),
        ("Does the square quickly move?", "not know what 'quickly' means"),
        ("Does the square swim away?", "cannot tell"),
    ],
)
def test_what_cannot_be_computed_is_refused_in_one_sentence(scene, question, words):
    with pytest.raises(F4xError, match=words) as caught:
        answer(scene, question)
    assert "\n" not in str(caught.value)
    assert not isinstance(caught.value, Unanswerable) or "can tell where, when" in str(caught.value)


def test_other_views_give_other_answers(scene):
    still = answer(scene, "When does the square move?", frozen(scene.cameras, 2.0))
    assert "stands still" in still.text
    turned = answer(scene, "Where is the square?", orbit(scene.cameras, degrees=5))
    assert turned.evidence["sightings"][0]["label"] == "square"
    with pytest.raises(F4xError, match="path shows nothing at frame 5"):
        answer(scene, "Where is the square at frame 5?", frozen(scene.cameras, 2.0))


def test_what_was_deleted_is_not_there(scene):
    square = np.arange(len(scene.ids)) >= len(scene.static)
    left = with_operations(scene, Delete(Ids.of(scene.ids[square])))
    assert answer(left, "Is there a square?").text.startswith("No: an earlier edit hides or removed the square")
    assert "square" not in answer(left, "What is there?").text
    for_a_time = with_operations(scene, Delete(Ids.of(scene.ids[square]), frames=(0, 3)))
    assert "seen from frame 4 to 5" in answer(for_a_time, "When is the square visible?").text
    assert re.match(
        r"No: .* seen in 2 of 6 frames, first not at frame 0", answer(for_a_time, "Is the square always visible?").text
    )
    assert "comes into the picture at frame 4 (0.2 s)" in answer(for_a_time, "When does the square appear?").text
    assert answer(for_a_time, "Does the square leave the picture?").text.startswith("No: ")


def test_a_direction_that_is_too_little_to_tell_is_told(scene, monkeypatch):
    for module in ("questions", "connected_objects"):
        monkeypatch.setattr(f"f4x_core.query.{module}.SIDEWAYS", 0.5)
    said = answer(scene, "Which way does the square go?").text
    assert "The square moves from" in said and "less than 50% of the picture's width" in said


def test_names_that_the_caller_knows_are_things(scene):
    square = np.arange(len(scene.ids)) >= len(scene.static)
    rex = Selection(scene.ids, square.astype(float), np.zeros(len(square), bool), label="Rex")
    assert "The Rex" not in (said := answer(scene, "Where is rex?", names={"Rex": rex}).text) and "Rex is" in said
    assert answer(scene, "Does Rex move?", names={"Rex": rex}).text.startswith("Yes: Rex moves to the right")


def test_a_scene_without_words_still_knows_what_moves():
    said = answer(labelled_scene(features=False), "When does it move?")
    assert "Something unnamed moves to the right" in said.text and "knows no words" in said.text


@pytest.mark.parametrize(
    ("question", "words"),
    [
        (
            "Which panel is nearest to the square?",
            r"^Panel 1 from the left is nearest to the square at frame 0 .*: 0\.69",
        ),
        ("Which panel is farthest from the square?", r"^Panel 2 from the left is farthest from the square"),
        ("How many of the panels move?", "^0 separate things move"),
        ("In what order do the panels start moving?", "^None of them moves"),
        ("Order the panels from right to left", "from the left, Panel 1 from the left"),
        ("Which panels stand still?", "^Standing still: Panel 1 from the left, Panel 2 from the left"),
        ("What is the biggest thing apart from the wall?", "^The biggest thing is the square"),
    ],
)
def test_the_single_ones_of_a_kind(scene, question, words):
    x = scene.posed(0.0).means[:, 0]
    ends = (np.abs(x) > 0.6) & (np.arange(len(x)) < len(scene.static))  # of the wall, left and right of the square
    said = answer(scene, question, names={"Panel": Selection(scene.ids, ends.astype(float), ends, label="Panel")})
    assert re.search(words, said.text), said.text


def test_an_empty_question(scene):
    with pytest.raises(F4xError, match="empty"):
        answer(scene, "  ")
    with pytest.raises(F4xError, match="no view"):
        answer(scene, "What?", [])


def test_a_model_reads_features_and_no_pictures(scene):
    class Reader:
        name = "reader"

        def answer(self, features, seconds, question):
            assert np.allclose(seconds, np.arange(FRAMES) / 24) and features[0].shape == (20, 32, 8)
            return f"{question} {len(features)}"

    said = ask_features(scene, "What?", original(scene.cameras), Reader(), head="visual")
    assert (said.text, said.answered_by) == (f"What? {FRAMES}", "reader")


@pytest.mark.parametrize(("aside", "heading"), [(0.0, ""), (0.5, "to the right"), (-0.5, "to the left")])
def test_what_comes_nearer_beside_the_picture_does_not_go_aside(aside, heading):
    """Its place in the picture leaves it, as that of a thing and its far copy does."""
    scene = labelled_scene()
    times = scene.cameras.times
    camera = scene.cameras.at(float(times[len(times) // 2]))
    rotation, translation = camera.world_to_camera[:3, :3], camera.world_to_camera[:3, 3]
    way = np.linspace(0, 1, len(times))
    seen_by_camera = np.stack([aside * way - 3, 0 * way, 2 - way], 1)
    places = (seen_by_camera - translation) @ rotation
    nothing = SimpleNamespace(chosen=np.zeros(1, bool), scores=np.zeros(1))
    unseen, depths, views = np.zeros((1, 4, 4), bool), np.ones((1, 4, 4)), original(scene.cameras)[:1]
    observed = questions._Observed(views, unseen, depths, times, places)
    found = questions._sighting(scene, "it", nothing, observed)
    assert found.heading == heading
