"""The transformers models: production code opens tiny random checkpoints, and what it does by hand equals what they do."""

import json
import shutil
from types import SimpleNamespace

import numpy as np
import pytest

torch = pytest.importorskip("torch")
transformers = pytest.importorskip("transformers")

import tiny_models  # noqa: E402

from f4x_core.clip import Clip  # noqa: E402
from f4x_core.errors import F4xError  # noqa: E402
from f4x_core.features.memory import memory_guard  # noqa: E402
from f4x_core.features.models import CHECKPOINTS, depth, loading, sam2, smolvlm, textimage  # noqa: E402
from f4x_core.features.precomputed import LAYOUTS  # noqa: E402
from f4x_core.features.preprocess import IMAGENET_MEAN, IMAGENET_STD, image_tensor  # noqa: E402
from f4x_core.features.teachers import TEACHERS  # noqa: E402
from f4x_core.features.text import load_text_encoder  # noqa: E402
from f4x_core.geometry.camera import CameraPath  # noqa: E402
from f4x_core.priors import DepthConfig, Priors, PriorsConfig  # noqa: E402
from f4x_core.priors.providers import find  # noqa: E402
from f4x_core.progress import silent  # noqa: E402

FRAMES = np.random.default_rng(0).integers(0, 255, (5, 48, 64, 3), dtype=np.uint8)


@pytest.fixture(scope="session")
def tiny(tmp_path_factory):
    """Name -> folder of a tiny checkpoint, written once."""
    root, made = tmp_path_factory.mktemp("models"), {}

    def folder(name):
        if name not in made:
            made[name] = getattr(tiny_models, f"tiny_{name}")(root / name)
        return made[name]

    return folder


@pytest.fixture
def calls(monkeypatch):
    """Counts how often the expensive tower runs."""
    count, tower = SimpleNamespace(smolvlm=0), transformers.models.smolvlm.modeling_smolvlm.SmolVLMVisionTransformer

    def forward(self, *args, _forward=tower.forward, **options):
        count.smolvlm += 1
        return _forward(self, *args, **options)

    monkeypatch.setattr(tower, "forward", forward)
    return count


# SAM 2


@pytest.fixture(scope="session")
def levels(tiny):
    """Head -> maps of all frames, as the teachers extract them."""
    teachers = {head: sam2.Sam2Teacher(tiny("sam2"), head=head) for head in sam2.LEVELS}
    return {head: np.stack([teacher.encode(frame) for frame in FRAMES]) for head, teacher in teachers.items()}


def test_teachers_give_the_pyramid_that_their_spec_promises(tiny, levels):
    model = transformers.Sam2VideoModel.from_pretrained(tiny("sam2")).eval()
    with torch.no_grad():
        pixels = image_tensor(FRAMES[3], (128, 128), IMAGENET_MEAN, IMAGENET_STD)
        pyramid = model.get_image_features(pixels, return_dict=True).fpn_hidden_states
    for head, level in sam2.LEVELS.items():
        spec = sam2.Sam2Teacher(tiny("sam2"), head=head).spec_for(64, 48)
        assert levels[head].shape == (5, *spec.grid, spec.dim)
        assert spec.name == head
        assert spec.provenance["model"] == "sam2"
        assert np.array_equal(levels[head][3].reshape(-1, spec.dim), pyramid[level][:, 0].numpy())


# Text and pictures


def softmax_attention(queries, keys, values):
    return (queries @ keys.transpose(2, 3) * queries.shape[3] ** -0.5).softmax(3) @ values


def test_tipsv2_block_with_attention_is_the_models_forward(tiny):
    vision = transformers.Tipsv2Model.from_pretrained(tiny("tipsv2")).eval().vision_model
    pixels = torch.rand(1, 3, 56, 56, generator=torch.Generator().manual_seed(0))
    layer = vision.encoder.layer[-1]
    with torch.no_grad():
        tokens = textimage.tokens_before(vision, layer.norm1, pixels)
        found = vision.layernorm(textimage.tipsv2_block(layer, tokens, softmax_attention))
        expected = vision(pixels).last_hidden_state
        values = vision.layernorm(textimage.tipsv2_block(layer, tokens, textimage.values_only))
    assert (found - expected).abs().max() <= 1e-6
    assert (values - expected).abs().max() > 1e-2


def test_clip_attention_by_hand_is_the_models_own(tiny):
    vision = transformers.CLIPModel.from_pretrained(tiny("clip")).eval().vision_model
    pixels = torch.rand(1, 3, 64, 64, generator=torch.Generator().manual_seed(0))
    layer = vision.encoder.layers[-1]
    with torch.no_grad():
        tokens = textimage.tokens_before(vision, layer.layer_norm1, pixels)
        mixed = tokens + textimage.attend(layer.self_attn, layer.layer_norm1(tokens), softmax_attention)
        found = mixed + layer.mlp(layer.layer_norm2(mixed))
        expected = vision(pixels).last_hidden_state
    assert (found - expected).abs().max() <= 1e-5


@pytest.mark.parametrize(("name", "grid"), [("tipsv2", (4, 7)), ("clip", (8, 14))])
def test_text_image_features_keep_their_spec(name, grid, tiny):
    teacher = textimage.TextImageTeacher(tiny(name), name=name)
    picture = np.random.default_rng(1).integers(0, 255, (50, 88, 3), dtype=np.uint8)
    spec, features = teacher.spec_for(88, 50), teacher.encode(picture)
    assert (spec.name, spec.text_encoder, spec.grid) == (name, name, grid)
    assert features.shape == (*grid, spec.dim)
    assert np.allclose(np.linalg.norm(features, axis=-1), 1, atol=1e-5)
    assert np.array_equal(features, teacher.encode(picture))
    encoder = textimage.TextImageEncoder(tiny(name), name=name)
    assert (encoder.dim, encoder.temperature) == (spec.dim, spec.temperature)
    assert encoder.temperature == pytest.approx({"tipsv2": 0.005, "clip": float(np.exp(-4.6))}[name], rel=1e-5)


def test_a_picture_of_one_window_is_read_as_one(tiny):
    teacher = textimage.TextImageTeacher(tiny("tipsv2"), name="tipsv2")
    picture = np.random.default_rng(2).integers(0, 255, (56, 56, 3), dtype=np.uint8)
    with torch.no_grad():
        vision = teacher.model.vision_model
        layer = vision.encoder.layer[-1]
        tokens = textimage.tokens_before(vision, layer.norm1, image_tensor(picture, (56, 56)))
        cells = vision.layernorm(textimage.tipsv2_block(layer, tokens, textimage.values_only))[0, 2:]
    expected = torch.nn.functional.normalize(cells, dim=-1).reshape(4, 4, -1).numpy()
    assert np.abs(teacher.encode(picture) - expected).max() <= 1e-6


@pytest.mark.parametrize("name", ["tipsv2", "clip"])
def test_labels_are_averaged_over_templates_in_the_models_space(name, tiny):
    encoder = textimage.TextImageEncoder(tiny(name), name=name)
    found = encoder.encode(["cat", "dog sky"])
    expected = []
    for label in ("cat", "dog sky"):
        vectors = []
        for template in textimage.TEMPLATES:
            tokens = encoder.tokenizer([template.format(label)], return_tensors="pt")
            side = 56 if name == "tipsv2" else 64
            with torch.no_grad():
                output = encoder.model(
                    input_ids=tokens["input_ids"],
                    attention_mask=tokens["attention_mask"],
                    pixel_values=torch.zeros(1, 3, side, side),
                )
            vectors.append(output.text_embeds[0].numpy())
        mean = np.mean(vectors, 0)
        expected.append(mean / np.linalg.norm(mean))
    assert np.abs(found - expected).max() <= 1e-5
    assert np.abs(found[0] - found[1]).max() > 1e-2
    with pytest.raises(F4xError, match="empty"):
        encoder.encode(["cat", " "])


def test_lseg_is_asked_by_bare_words_of_its_own_clip(tmp_path, monkeypatch):
    monkeypatch.setenv("F4X_MODELS", str(tmp_path))
    with pytest.raises(F4xError, match=r"'clip-b32' is not on this machine \(605 MB\)"):
        load_text_encoder("clip-b32")
    tiny_models.tiny_clip(tmp_path / "clip", seed=0)  # ViT-B/16, another space
    tiny_models.tiny_clip(tmp_path / "clip-b32", seed=1)
    encoder = load_text_encoder(LAYOUTS["lseg"].text_encoder)
    tokens = encoder.tokenizer(["cat"], return_tensors="pt")
    with torch.no_grad():
        alone = encoder.model.get_text_features(**tokens).pooler_output[0].numpy()
    found = encoder.encode(["cat", "dog sky"])
    assert found.shape == (2, encoder.dim)
    assert np.abs(found[0] - alone / np.linalg.norm(alone)).max() <= 1e-5
    assert np.abs(found - load_text_encoder("clip").encode(["cat", "dog sky"])).max() > 1e-2
    assert np.array_equal(found, load_text_encoder("clip-b32", tmp_path / "clip-b32").encode(["cat", "dog sky"]))


@pytest.mark.parametrize(("length", "starts"), [(4, [0]), (7, [0, 3]), (10, [0, 3, 6]), (11, [0, 3, 6, 7])])
def test_windows_cover_every_cell(length, starts):
    assert textimage._starts(length, 4, 3) == starts
    assert set().union(*(range(start, start + 4) for start in starts)) == set(range(length))


# SmolVLM


@pytest.fixture(scope="session")
def vlm(tiny):
    return smolvlm.SmolVlm(tiny("smolvlm"))


@pytest.fixture(scope="session")
def vision_grid(tiny):
    teacher = smolvlm.SmolVlmTeacher(tiny("smolvlm"))
    return np.stack([teacher.encode(frame) for frame in FRAMES[:2]])


def test_features_in_the_embeddings_equal_pixels(vlm, vision_grid, calls):
    text = vlm.prompt([0, 1], "a photo of the cat")
    side = vlm.model.config.vision_config.image_size
    pixels = torch.cat(
        [image_tensor(frame, (side, side), smolvlm.MEAN, smolvlm.STD, mode="bicubic") for frame in FRAMES[:2]]
    )
    ids = vlm.tokenizer(text, return_tensors="pt", add_special_tokens=False)
    with torch.no_grad():
        embeds = vlm.embeddings(text, vision_grid)
        found = vlm.model(inputs_embeds=embeds).logits
        assert calls.smolvlm == 0
        expected = vlm.model(input_ids=ids["input_ids"], pixel_values=pixels[None]).logits
        blind = vlm.model(input_ids=ids["input_ids"]).logits
        options = {"max_new_tokens": 6, "do_sample": False, "pad_token_id": 1}
        told = vlm.model.generate(input_ids=ids["input_ids"], pixel_values=pixels[None], **options)
    assert calls.smolvlm > 0
    assert (found - expected).abs().max() <= 1e-5
    assert (blind - expected).abs().max() > 1e-2
    new = told[0, ids["input_ids"].shape[1] :]
    calls.smolvlm = 0
    answer = vlm.answer(list(vision_grid), [0, 1], "a photo of the cat", max_tokens=6)
    assert calls.smolvlm == 0
    assert answer == vlm.tokenizer.decode(new, skip_special_tokens=True).strip()


def test_the_conversation_is_written_as_the_model_was_trained(vlm):
    picture = "<fake_token_around_image><global-img><image><image><image><image><fake_token_around_image>"
    assert vlm.prompt([0.0, 75.2], "what?", [("who?", "a cat")]) == (
        "<|im_start|>User: You are provided the following series of 2 frames from a 0:01:15 [H:MM:SS] video.\n"
        f"\nFrame from 00:00:{picture}\nFrame from 01:15:{picture}\n\nwho?<end_of_utterance>\n"
        "Assistant: a cat<end_of_utterance>\nUser: what?<end_of_utterance>\nAssistant:"
    )


@pytest.mark.parametrize(
    ("maps", "seconds", "question", "told"),
    [
        (1, [0], " ", "question is empty"),
        (0, [], "what?", "0 feature maps"),
        (1, [0, 1], "what?", "1 feature maps with 2 times"),
        (1, [0], "what is <image>?", "reserves for pictures"),
    ],
)
def test_questions_that_cannot_be_asked_are_refused(maps, seconds, question, told, vlm, vision_grid):
    with pytest.raises(F4xError, match=told):
        vlm.answer(list(vision_grid[:maps]), seconds, question)


def test_maps_of_another_grid_are_refused(vlm):
    with pytest.raises(F4xError, match=r"shape \(4, 4, 16\).*\(8, 8, 16\)"):
        vlm.answer([np.zeros((4, 4, 16))], [0], "what?")


# Loading


def test_the_registry_opens_every_tiny_checkpoint(tiny):
    picture = FRAMES[0]
    for name in ("sam2", "clip", "tipsv2", "smolvlm"):
        teacher = TEACHERS[name].load(tiny(name))
        spec = teacher.spec_for(64, 48)
        assert teacher.encode(picture).shape == (*spec.grid, spec.dim)


@pytest.fixture
def nothing_cached(tmp_path, monkeypatch):
    monkeypatch.setenv("F4X_MODELS", str(tmp_path / "none"))
    monkeypatch.setattr("huggingface_hub.constants.HF_HUB_CACHE", str(tmp_path / "cache"))


def told(call, *args, **options) -> str:
    with pytest.raises(F4xError) as caught:
        call(*args, **options)
    sentence = str(caught.value)
    assert "\n" not in sentence
    return sentence


def test_a_model_that_was_not_downloaded_says_how_to_get_it(nothing_cached):
    sentence = told(sam2.Sam2Teacher)
    assert "sam2-tiny" in sentence
    assert "156 MB" in sentence
    assert "f4x models get sam2-tiny" in sentence
    assert "neither a folder nor" in told(sam2.Sam2Teacher, "nobody/nothing")


def test_a_folder_of_models_is_searched_by_name(tmp_path, monkeypatch, tiny):
    monkeypatch.setenv("F4X_MODELS", str(tmp_path))
    shutil.copytree(tiny("clip"), tmp_path / "clip")
    assert textimage.TextImageTeacher(name="clip").spec_for(64, 64).provenance["model"] == "clip"


def test_provenance_names_the_hub_id_of_cached_weights(tmp_path, tiny):
    cached = tmp_path / "models--openai--clip-vit-base-patch16" / "snapshots" / "0123abc"
    shutil.copytree(tiny("clip"), cached)
    assert loading.find("clip", cached).name == "openai/clip-vit-base-patch16"


def test_weights_of_another_architecture_are_refused(tiny):
    assert "'clip' model" in told(sam2.Sam2Teacher, tiny("clip"))
    assert "'sam2_video' model" in told(textimage.TextImageTeacher, tiny("sam2"), name="tipsv2")
    assert "'tipsv2' needs 'tipsv2'" in told(loading.find, "tipsv2", "clip")


def test_damaged_and_incomplete_weights_are_refused(tmp_path, tiny):
    from safetensors.torch import load_file, save_file

    folder = tmp_path / "broken"
    shutil.copytree(tiny("clip"), folder)
    weights = folder / "model.safetensors"
    whole = load_file(weights)
    missing = {name: value for name, value in whole.items() if "visual_projection" not in name}
    save_file(missing, weights, metadata={"format": "pt"})
    assert "1 weights of 'clip' are missing (the first is visual_projection.weight)" in told(
        textimage.TextImageTeacher, folder, name="clip"
    )
    save_file({**whole, "visual_projection.weight": torch.zeros(3, 5)}, weights, metadata={"format": "pt"})
    assert "cannot be read" in told(textimage.TextImageTeacher, folder, name="clip")
    weights.write_bytes(weights.read_bytes()[:1000])
    assert "cannot be read" in told(textimage.TextImageTeacher, folder, name="clip")
    weights.unlink()
    assert str(folder) in told(textimage.TextImageTeacher, folder, name="clip")
    (folder / "config.json").write_text("{")
    assert str(folder) in told(textimage.TextImageTeacher, folder, name="clip")
    (folder / "config.json").write_text(json.dumps({"model_type": "martian"}))
    assert str(folder) in told(textimage.TextImageTeacher, folder, name="clip")


def test_a_grid_beyond_memory_is_one_sentence(tiny):
    teacher = sam2.Sam2Teacher(tiny("sam2"))
    teacher.model.image_size = 10**7
    assert "does not fit in memory" in told(teacher.encode, FRAMES[0])
    with pytest.raises(RuntimeError, match="shapes"), memory_guard("x"):
        torch.zeros(2, 3) @ torch.zeros(2, 3)


def test_every_checkpoint_tells_what_a_person_wants_to_know():
    for name, entry in CHECKPOINTS.items():
        assert entry.name == name
        assert entry.hub.count("/") == 1
        assert entry.megabytes > 50
        assert entry.licence in ("Apache-2.0", "MIT", "CC-BY-4.0")


# Depth


def test_a_fit_to_the_measurement_undoes_scale_and_shift():
    rng = np.random.default_rng(0)
    truth = 0.5 + rng.random((60, 80)).astype(np.float32)
    sure = (rng.random(truth.shape) < 0.3).astype(np.float32)
    measured = np.where(sure > 0, truth, 9.0).astype(np.float32)
    measured[:, :8] = 4.0  # a region that is surely and wrongly measured
    sure[:, :8] = 1.0
    found, difference = depth.fit_to_measurement(37 * truth - 5, measured, sure * (np.arange(80) >= 8))
    assert np.abs(found - truth).max() < 1e-3
    assert difference < 1e-4
    bent, _ = depth.fit_to_measurement(37 * truth - 5, measured, sure)
    assert np.abs(bent - truth)[:, 40:].max() < 0.02  # far from the wrong region


def test_a_model_that_contradicts_the_measurement_is_flattened():
    truth = np.tile(np.linspace(1, 2, 50, dtype=np.float32), (40, 1))
    found, difference = depth.fit_to_measurement(-truth, truth, np.ones_like(truth))
    assert (found > 0).all()
    assert difference > 0.05


@pytest.mark.parametrize("kind", ["moving", "static"])
def test_depth_anything_completes_the_measurement(kind, tiny, monkeypatch):
    frames, height, width = 3, 48, 64
    clip = Clip("c", FRAMES[:3], np.arange(3.0), 24.0, np.zeros(3, bool), "c")
    matrices = np.tile(np.eye(4), (frames, 1, 1))
    matrices[:, 0, 3] = np.arange(3) * 0.1
    intrinsics = np.tile(np.array([[60.0, 0, 32], [0, 60, 24], [0, 0, 1]]), (frames, 1, 1))
    priors = Priors.empty(clip)
    priors.cameras = CameraPath(intrinsics, matrices, np.arange(3.0), width, height)
    priors.camera_kind = kind
    truth = 0.4 + np.random.default_rng(3).random((frames, height, width)).astype(np.float32)
    priors.mask = np.zeros(truth.shape, bool)
    priors.mask[:, 20:40, 20:40] = True

    def measure(clip, priors, config, progress):
        priors.depth = np.where(priors.mask, 3.0, 1 / truth).astype(np.float32)
        priors.depth_confidence = np.full(truth.shape, 0.9, np.float16)
        priors.statistics["depth"] = {}

    shown = iter(truth * 11 + 2)
    monkeypatch.setattr(depth.classical, "provide", measure)
    monkeypatch.setattr(depth.DepthAnything, "inverse_depth", lambda self, rgb: next(shown))
    monkeypatch.setenv("F4X_MODELS", str(tiny("depth_anything").parent / "by_name"))
    named = tiny("depth_anything").parent / "by_name" / "depth-anything"
    if not named.exists():
        shutil.copytree(tiny("depth_anything"), named)
    find("depth", "depth-anything")(clip, priors, PriorsConfig(depth=DepthConfig("depth-anything")), silent)
    priors.validate(["depth", "depth_confidence", "cameras"])
    assert np.median(priors.depth) == pytest.approx(1, abs=1e-3)
    assert priors.statistics["depth"]["model"] == "depth-anything"
    if kind == "moving":
        scale = np.linalg.norm(priors.cameras.centers[2]) / 0.2
        assert np.abs(priors.depth * truth / scale - 1).max() < 0.02  # moving pixels too
        assert priors.depth_confidence.min() > 0.6
    else:
        assert np.corrcoef((1 / priors.depth).ravel(), truth.ravel())[0, 1] > 0.99
        assert np.allclose(priors.depth_confidence, depth.GUESS, atol=1e-3)


def test_depth_anything_opens_a_checkpoint_and_reads_a_picture(tiny):
    network = depth.DepthAnything(tiny("depth_anything"))
    found = network.inverse_depth(FRAMES[0])
    assert found.shape == (48, 64)
    assert np.isfinite(found).all()
    assert np.abs(found - network.inverse_depth(FRAMES[1])).max() > 0
