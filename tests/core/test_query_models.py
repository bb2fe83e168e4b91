"""Questions and words through models: real architectures with random weights, from the command line to the answer."""

import dataclasses
import json

import numpy as np
import pytest

torch = pytest.importorskip("torch")
transformers = pytest.importorskip("transformers")

import tiny_models  # noqa: E402
from labelled_scene import FRAMES, HEIGHT, WIDTH, labelled_scene, square_mask  # noqa: E402

from f4x_core.cli.main import main  # noqa: E402
from f4x_core.clip import write_images  # noqa: E402
from f4x_core.features.models.smolvlm import SmolVlm  # noqa: E402
from f4x_core.features.spec import FeatureSpec  # noqa: E402
from f4x_core.features.text import load_text_encoder  # noqa: E402
from f4x_core.query.pixels import head_map  # noqa: E402
from f4x_core.scene import read_scene, write_scene  # noqa: E402
from f4x_core.scene.field import FieldHead  # noqa: E402


@pytest.fixture(scope="module")
def model(tmp_path_factory):
    """Folder of a tiny SmolVLM."""
    return tiny_models.tiny_smolvlm(tmp_path_factory.mktemp("models") / "smolvlm")


@pytest.fixture(scope="module")
def scene_file(tmp_path_factory):
    """The labelled scene with a head whose maps are what the tiny SmolVLM's vision tower gives."""
    weights = np.random.default_rng(0).normal(size=(8, 16)).astype(np.float16)
    head = FieldHead(FeatureSpec("smolvlm", 16, (8, 8), "area"), (weights,), (np.zeros(16, np.float16),))
    scene = labelled_scene()
    field = dataclasses.replace(scene.features, heads=(*scene.features.heads, head))
    path = tmp_path_factory.mktemp("scene") / "scene.f4x"
    write_scene(dataclasses.replace(scene, features=field), path)
    return path


def run(capsys, *arguments):
    code = main([str(argument) for argument in arguments])
    caught = capsys.readouterr()
    return code, caught.out, caught.err


@pytest.mark.parametrize("path", ["original", "frozen:2"])
def test_a_language_model_answers_from_features_alone(scene_file, model, capsys, monkeypatch, path):
    tower = transformers.models.smolvlm.modeling_smolvlm.SmolVLMVisionTransformer
    monkeypatch.setattr(tower, "forward", lambda *_, **__: pytest.fail("a picture was encoded"))
    question = "a photo of the cat"
    code, out, err = run(capsys, "ask", scene_file, question, "--model", model, "--path", path, "--json")
    assert code == 0, err
    result = json.loads(out)
    scene, reader = read_scene(scene_file), SmolVlm(model)
    times = scene.cameras.times if path == "original" else np.full(FRAMES, 2.0)
    maps = [head_map(scene, "smolvlm", scene.cameras[t], float(time)) for t, time in enumerate(times)]
    assert result["answer"] == reader.answer(maps, times / scene.fps, question) != ""
    assert result["answered_by"] == "smolvlm" and result["evidence"] == {
        "frames": FRAMES,
        "head": "smolvlm",
        "grid": [8, 8],
    }


def test_questions_to_a_model_that_cannot_be_answered(scene_file, model, tmp_path, capsys):
    write_scene(labelled_scene(), tmp_path / "other.f4x")
    write_scene(labelled_scene(features=False), tmp_path / "plain.f4x")
    for scene, reader, question, words in (
        (scene_file, model, " ", "The question is empty"),
        (scene_file, tmp_path, "what?", "no checkpoint of 'smolvlm-256m'"),
        (scene_file, tiny_models.tiny_clip(tmp_path / "clip"), "what?", "are a 'clip' model"),
        (tmp_path / "other.f4x", model, "what?", "smolvlm"),
        (tmp_path / "plain.f4x", model, "what?", "knows no words"),
    ):
        code, _, err = run(capsys, "ask", scene, question, "--model", reader)
        assert code == 2 and words in err and err.strip().splitlines()[-1].startswith("f4x ask: ")


def test_lseg_maps_become_words(tmp_path, capsys, monkeypatch):
    """Maps of another program, whose cells are label vectors of the tiny CLIP, all the way to a selection by word."""
    monkeypatch.setenv("F4X_MODELS", str(tmp_path / "models"))
    monkeypatch.setattr("huggingface_hub.constants.HF_HUB_CACHE", str(tmp_path / "cache"))
    scene = labelled_scene(features=False)
    write_scene(scene, tmp_path / "plain.f4x")
    write_images(tmp_path / "clip", np.zeros((FRAMES, HEIGHT, WIDTH, 3), np.uint8))
    tiny_models.tiny_clip(tmp_path / "clip-b32", projection_dim=512)
    cat, sky = load_text_encoder("clip-b32", tmp_path / "clip-b32").encode(["cat", "sky"])
    shown = np.stack([square_mask(float(t)) for t in range(FRAMES)])[:, 2::4, 2::4, None]
    maps = np.where(shown, cat, sky)
    np.save(tmp_path / "lseg.npy", maps)
    made = ["features", tmp_path / "clip", "--teacher", "lseg", "--model", tmp_path / "lseg.npy", "-o", tmp_path]
    assert run(capsys, *made)[0] == 0
    result = ["distill", tmp_path / "plain.f4x", "--teacher", "lseg", "-o", tmp_path / "s.f4x"]
    result += ["--steps", 40, "--width", 8]
    code, out, err = run(capsys, *result)
    assert code == 0, err
    assert "clip-b32: no labels, that text encoder is not here" in out
    asked = ["query", tmp_path / "s.f4x", "--text", "cat", "--not", "sky", "--json"]
    code, _, err = run(capsys, *asked)
    assert code == 2 and "f4x models get clip-b32" in err
    code, _, err = run(capsys, *result, "--vocabulary", "cat, sky")
    assert code == 2 and "f4x models get clip-b32" in err
    (tmp_path / "models").mkdir()
    (tmp_path / "clip-b32").rename(tmp_path / "models" / "clip-b32")
    code, out, err = run(capsys, *asked)
    assert code == 0, err
    found = json.loads(out)
    assert found["chosen"] - found["static"] == len(scene.dynamic)
    assert found["static"] < 0.02 * len(scene.static)  # cells of 4 x 4 pixels reach over the outline
    code, out, err = run(capsys, *result, "--vocabulary", "cat, sky")
    assert code == 0 and "clip-b32: 86 labels" in out  # with the everyday ones, which have these two
