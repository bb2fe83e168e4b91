"""Answers that are computed, that a model gives from features, and that a server gives from pictures."""

import json
import re

import numpy as np
import pytest
from labelled_scene import FRAMES, labelled_scene
from stub_server import client, saying, stub_server

from f4x_core.errors import F4xError
from f4x_core.geometry.trajectory import frozen, orbit, original
from f4x_core.query.chat import ChatServer
from f4x_core.query.questions import COMPUTED, SERVER, answer, ask_features

GOOD = saying(" A red square moves. ")


@pytest.fixture(scope="module")
def scene():
    return labelled_scene()


@pytest.fixture
def server():
    with stub_server() as stub:
        stub.reply = (200, GOOD, 0)
        yield stub


def test_a_server_sees_frames_and_answers(scene, server):
    said = answer(scene, "What moves?", server=client(server, key="secret", model="m"))
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
        answer(scene, "What?", frozen(scene.cameras, 1.0)[:1], server=client(server, timeout=0.2 if reply[2] else 5))
    assert "\n" not in str(caught.value)


def test_a_server_that_is_not_there(scene):
    with pytest.raises(F4xError, match="cannot be reached"):
        answer(scene, "What?", server=ChatServer("http://127.0.0.1:9/v1", timeout=2))


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
        ("Where is the square?", "square is on the left|square is in the middle"),
        ("When does the square move?", "moves to the right from frame 0 to 5"),
        ("How far does it go?", r"0\.2\d times"),
        ("How many squares are there?", "square: 1"),
        ("In what order do things move?", r"square \(frame 0\)"),
        ("Does the sky move?", "nothing of that"),
    ],
)
def test_computed_answers_are_right(scene, question, words):
    said = answer(scene, question)
    assert re.search(words, said.text), said.text


def test_other_views_give_other_places(scene):
    still = answer(scene, "When does the square move?", frozen(scene.cameras, 2.0))
    assert "stands still" in still.text
    turned = answer(scene, "Where is the square?", orbit(scene.cameras, degrees=5))
    assert turned.evidence["sightings"][0]["label"] == "square"


def test_a_scene_without_words_still_knows_what_moves():
    said = answer(labelled_scene(features=False), "When does it move?")
    assert "something that moves" in said.text and "knows no words" in said.text


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
