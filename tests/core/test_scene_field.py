"""The feature field in the scene file: exact round trips, older files, damage; decoding and pictures with numpy alone."""

import json
import subprocess
import sys
import zipfile
from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from random_scene import random_scene
from test_scene_file import JSON, rewritten

from f4x_core.errors import F4xError
from f4x_core.features.pca import fit_pca
from f4x_core.features.spec import FeatureSpec
from f4x_core.scene import FeatureField, FieldHead, Vocabulary, read_header, read_scene, write_edits, write_scene
from f4x_core.scene.field import quantise
from f4x_core.scene.view import render

WIDTH, STATIC, NODES = 8, 30, 5
SPEC = FeatureSpec("text", 12, (4, 6), "bilinear", True, "words", 0.05, True, {"model": "none"})


def head_of(spec=SPEC, seed=0, widths=(WIDTH, 10, 12)):
    rng = np.random.default_rng(seed)
    pairs = list(pairwise(widths))
    weights = tuple(rng.normal(size=pair).astype(np.float16) for pair in pairs)
    biases = tuple(rng.normal(size=pair[1]).astype(np.float16) for pair in pairs)
    glob = rng.normal(size=spec.dim).astype(np.float16) if spec.has_global else None
    pca = fit_pca(rng.normal(size=(100, spec.dim)))
    return FieldHead(spec, weights, biases, pca, glob, {"used": {"cosine": 0.9}})


def field_of(static=STATIC, nodes=NODES, seed=0, bits=8):
    rng = np.random.default_rng(seed)
    a, b, low, step = quantise(rng.normal(size=(static, WIDTH)), rng.normal(size=(nodes, WIDTH)), bits)
    words = Vocabulary(("cat", "a black dog"), rng.normal(size=(2, 12)).astype(np.float16))
    second = head_of(FeatureSpec("visual-2", 5, (3, 3)), 1, (WIDTH, 5))
    return FeatureField(
        a, b, low, step, (head_of(), second), {"words": words}, fit_pca(rng.normal(size=(99, WIDTH))), bits
    )


SCENE = random_scene(features=field_of())


@pytest.fixture
def path(tmp_path):
    write_scene(SCENE, tmp_path / "scene.f4x")
    return tmp_path / "scene.f4x"


@pytest.mark.parametrize("bits", [4, 8])
@pytest.mark.parametrize("dynamic", [0, 20])
def test_round_trip_is_exact_and_bytes_repeat(tmp_path, dynamic, bits):
    scene = random_scene(dynamic=dynamic, features=field_of(nodes=NODES if dynamic else 0, bits=bits))
    write_scene(scene, tmp_path / "a.f4x")
    read = read_scene(tmp_path / "a.f4x")
    before, after = scene.features.to_arrays(), read.features.to_arrays()
    assert before["static/latent"].shape == (STATIC, WIDTH * bits // 8)
    np.testing.assert_array_equal(read.features.static, scene.features.static)
    assert before.keys() == after.keys() and not read.extra and not read.extra_fields
    for name, array in before.items():
        assert array.dtype == after[name].dtype, name
        np.testing.assert_array_equal(array, after[name])
    assert read.features.to_json() == scene.features.to_json()
    write_scene(read, tmp_path / "b.f4x")
    assert (tmp_path / "a.f4x").read_bytes() == (tmp_path / "b.f4x").read_bytes()
    write_edits(tmp_path / "a.f4x", [{"op": "hide"}])
    assert read_scene(tmp_path / "a.f4x").features.to_json() == scene.features.to_json()


def test_only_a_scene_with_a_field_needs_the_newer_version(tmp_path, path):
    assert read_header(path)["version"] == 2
    write_scene(replace(SCENE, features=None), tmp_path / "old.f4x")
    assert read_header(tmp_path / "old.f4x")["version"] == 1
    assert read_scene(tmp_path / "old.f4x").features is None


def test_a_version_1_file_with_arrays_of_the_same_names_keeps_them_as_unknown(tmp_path):
    extra = {"static/latent": np.zeros((STATIC, 3), np.float16)}
    write_scene(random_scene(extra=extra, extra_fields={"features": 7}), tmp_path / "old.f4x")
    read = read_scene(tmp_path / "old.f4x")
    assert read.features is None and read.extra.keys() == extra.keys() and read.extra_fields == {"features": 7}


@pytest.mark.parametrize("bits", [4, 8])
def test_bytes_give_latents_back_to_half_a_step(bits):
    rng = np.random.default_rng(3)
    static, nodes = rng.normal(size=(50, 4)) * [1, 10, 0, 1e-3], rng.normal(size=(7, 4)) * [2, 1, 0, 1]
    a, b, low, step = quantise(static, nodes, bits)
    assert max(a.max(), b.max()) == 2**bits - 1
    for part, stored in ((static, a), (nodes, b)):
        error = np.abs(low + step * stored - np.clip(part, low, low + (2**bits - 1) * step))
        assert (error <= step / 2 + 1e-5).all()
    assert quantise(np.zeros((0, 4)), np.zeros((0, 4)))[0].shape == (0, 4)


def test_latents_static_first_then_blends_of_nodes():
    field, dynamic = SCENE.features, SCENE.dynamic
    latents = SCENE.latents()
    assert latents.shape == (STATIC + 20, WIDTH) and latents.dtype == np.float32
    np.testing.assert_array_equal(latents[:STATIC], field.low + field.step * field.static)
    nodes = field.low + field.step * field.nodes
    expected = [sum(dynamic.weight[g, k] * nodes[dynamic.node[g, k]] for k in range(3)) for g in range(20)]
    np.testing.assert_allclose(latents[STATIC:], expected, rtol=1e-5)


def test_decoding_is_the_perceptron_of_the_head_room():
    torch = pytest.importorskip("torch")
    from f4x_core.features.heads import Head

    stored = SCENE.features.head("text")
    arrays = {f"weight_{i}": w for i, w in enumerate(stored.weights)} | {
        f"bias_{i}": b for i, b in enumerate(stored.biases)
    }
    latent = np.random.default_rng(0).normal(size=(3, 4, WIDTH)).astype(np.float32)
    with torch.no_grad():
        expected = Head.from_arrays(arrays)(torch.from_numpy(latent)).numpy()
    np.testing.assert_allclose(SCENE.features.decode("text", latent), expected, rtol=1e-4, atol=1e-4)
    assert SCENE.features.decode("text", latent[:0]).shape == (0, 4, 12)


def test_pictures_of_a_head_are_those_of_its_features():
    head = SCENE.features.head("text")
    latent = np.random.default_rng(0).normal(size=(5, 6, WIDTH)).astype(np.float32)
    wanted = head.pca.to_rgb(head(latent)).astype(int)
    assert np.abs(head.to_rgb(latent) - wanted).max() <= 1


def test_rendered_latent_and_head():
    pytest.importorskip("torch", reason="the reference raster needs torch")
    out = render(SCENE, SCENE.cameras[0], 0.0, ("latent", "head:text", "alpha", "rgb"), "torch")
    raw = render(SCENE, SCENE.cameras[0], 0.0, (), "torch", values={"x": SCENE.latents()})["x"]
    seen = out["alpha"] >= 0.1
    np.testing.assert_allclose(out["latent"][seen], raw[seen] / out["alpha"][seen][:, None], rtol=1e-5, atol=1e-5)
    assert (out["latent"][~seen] == 0).all() and (out["head:text"][~seen] == 0).all() and (~seen).any()
    decoded = SCENE.features.decode("text", out["latent"][seen])
    # values of 10 are sums in another order than beside it, so one near 0 is off by their rounding, not by its own
    np.testing.assert_allclose(out["head:text"][seen], decoded, rtol=1e-5, atol=1e-5)


def test_what_is_not_there_is_told():
    with pytest.raises(F4xError, match=r"no head 'clip'.*text, visual-2.*distil"):
        render(SCENE, SCENE.cameras[0], 0.0, ("head:clip",), "torch")
    with pytest.raises(F4xError, match="knows no words"):
        render(replace(SCENE, features=None), SCENE.cameras[0], 0.0, ("latent",), "torch")
    with pytest.raises(F4xError, match="no vocabulary for the text encoder 'minilm'"):
        SCENE.features.vocabulary("minilm")
    labels, vectors = SCENE.features.vocabulary("words")
    assert labels == ("cat", "a black dog") and vectors.dtype == np.float32


def test_a_field_of_another_scene_is_refused():
    with pytest.raises(F4xError, match="static/latent has 29 rows, expected one for each of 30"):
        replace(SCENE, features=field_of(static=29))
    with pytest.raises(F4xError, match="scaffold/latent has 4 rows"):
        replace(SCENE, features=field_of(nodes=4))
    with pytest.raises(F4xError, match="same name"):
        replace(SCENE.features, heads=(head_of(), head_of()))
    with pytest.raises(F4xError, match="decodes 9 channels, the latent has 8"):
        replace(SCENE.features, heads=(head_of(widths=(9, 10, 12)),))
    with pytest.raises(F4xError, match="do not follow one another"):
        replace(head_of(), biases=head_of().biases[::-1])
    with pytest.raises(F4xError, match="ends in 12 channels, its spec says 5"):
        replace(head_of(), spec=FeatureSpec("x", 5, (3, 3)))


MEMBERS = sorted(SCENE.features.to_arrays())
OPTIONAL = ("heads/text/global", "scaffold/latent")


@pytest.mark.parametrize("name", [name for name in MEMBERS if name not in OPTIONAL])
def test_a_missing_array_is_named(path, name):
    rewritten(path, lambda header: header["arrays"].pop(name))
    with pytest.raises(F4xError, match=rf"scene\.f4x: .*{name}.*export the scene again"):
        read_scene(path)


def test_missing_node_latents_do_not_fit_the_scaffold(path):
    rewritten(path, lambda header: header["arrays"].pop("scaffold/latent"))
    with pytest.raises(F4xError, match="scaffold/latent has 0 rows, expected one for each of 5"):
        read_scene(path)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda f: f.update(width=9), "latent of 9 channels"),
        (lambda f: f.update(bits=5), "4 or 8 'bits'"),
        (lambda f: f.update(bits=4), "one width for all"),
        (lambda f: f.update(heads=5), "list of heads"),
        (lambda f: f["heads"][0].update(layers=3), "weight_2 is missing"),
        (lambda f: f["heads"][0].update(layers="2"), "how many layers"),
        (lambda f: f["heads"][0]["spec"].update(dim=7), "expected|says 7|finite"),
        (lambda f: f["heads"][0]["spec"].update(colour="red"), "'colour' is unknown"),
        (lambda f: f["heads"][0]["pca"].update(low=[1, 2]), "colour range"),
        (lambda f: f["vocabularies"].update(words=["cat"]), "1 labels"),
        (lambda f: f["vocabularies"].update(words=[1, 2]), "lists of labels"),
        (lambda f: f["vocabularies"].update(other=["cat"]), "vocabulary/other is missing"),
    ],
)
def test_a_damaged_description_gives_one_sentence(path, change, words):
    rewritten(path, lambda header: change(header["features"]))
    with pytest.raises(F4xError, match=words) as caught:
        read_scene(path)
    assert str(caught.value).startswith(str(path)) and "\n" not in str(caught.value)


@settings(max_examples=80, deadline=2000, derandomize=True)
@given(where=st.sampled_from(["features", "heads", "head", "spec", "pca", "vocabularies"]), value=JSON)
def test_any_json_in_the_description(tmp_path_factory, where, value):
    path = tmp_path_factory.getbasetemp() / "any.f4x"
    write_scene(SCENE, path)

    def change(header):
        result = header["features"]
        if where == "features":
            header["features"] = value
        elif where == "head":
            result["heads"][0] = value
        elif where in ("spec", "pca"):
            result["heads"][0][where] = value
        else:
            result[where] = value

    rewritten(path, change)
    try:
        read_scene(path)
    except F4xError as error:
        assert str(error).startswith(str(path))


def test_a_name_that_no_zip_member_may_have_is_refused(tmp_path):
    field = replace(SCENE.features, heads=(head_of(replace(SPEC, name="größe")),))
    with pytest.raises(F4xError, match="größe"):
        write_scene(replace(SCENE, features=field), tmp_path / "a.f4x")
    assert not list(tmp_path.iterdir())


def test_numpy_is_enough_to_read_pose_and_decode(path):
    program = """
import sys
for name in ("torch", "scipy", "cv2", "PIL"):
    sys.modules[name] = None
from f4x_core.scene import read_scene
scene = read_scene(sys.argv[1])
field = scene.features
print(field.decode("text", scene.latents()).shape, field.head("text").to_rgb(scene.latents()).shape)
"""
    root = Path(__file__).resolve().parents[2]
    done = subprocess.run([sys.executable, "-c", program, str(path)], cwd=root, capture_output=True, text=True)
    assert done.stdout.split("\n")[0] == "(50, 12) (50, 3)", done.stderr


def test_a_stranger_finds_the_description(path):
    with zipfile.ZipFile(path) as archive:
        result = json.loads(archive.read("scene.json"))["features"]
    assert result["width"] == WIDTH and [head["spec"]["name"] for head in result["heads"]] == ["text", "visual-2"]
