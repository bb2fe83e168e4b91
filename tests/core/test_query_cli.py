"""`f4x query`, `f4x ask` and `f4x bench features` from the command line."""

import dataclasses
import json
import re
from types import SimpleNamespace

import numpy as np
import pytest
from labelled_scene import FRAMES, HEIGHT, WIDTH, labelled_scene, square_mask
from PIL import Image

from f4x_core.app import distilling, encoding
from f4x_core.cli.main import main
from f4x_core.clip import write_images
from f4x_core.errors import F4xError
from f4x_core.features import unknown
from f4x_core.features.spec import FeatureSpec
from f4x_core.features.teachers import TEACHERS
from f4x_core.fit.vocabulary import with_vocabulary
from f4x_core.query import prompts
from f4x_core.query.score import overlap
from f4x_core.query.selection import Selection
from f4x_core.scene import read_scene, write_scene
from f4x_core.scene.view import render


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """A scene file, one without features, and true masks."""
    folder = tmp_path_factory.mktemp("query")
    write_scene(labelled_scene(), folder / "scene.f4x")
    write_scene(labelled_scene(features=False), folder / "plain.f4x")
    (folder / "masks").mkdir()
    for t in range(FRAMES):
        Image.fromarray(square_mask(float(t)).astype(np.uint8) * 255).save(folder / "masks" / f"{t:05d}.png")
    return folder


def run(capsys, *arguments):
    code = main([str(argument) for argument in arguments])
    caught = capsys.readouterr()
    return code, caught.out, caught.err


def test_query_writes_what_it_found(folder, capsys, tmp_path):
    code, out, _ = run(
        capsys, "query", folder / "scene.f4x", "--text", "square", "--not", "wall, sky", "--json", "-o", tmp_path
    )
    told = json.loads(out)
    assert code == 0 and told["chosen"] == 81 and told["static"] == 0
    saved = Selection.from_json(json.loads((tmp_path / "selection.json").read_text()))
    assert saved.chosen.sum() == told["chosen"]
    masks = [np.asarray(Image.open(file)) > 0 for file in sorted((tmp_path / "mask").glob("*.png"))]
    # Of pixels that the square covers in part, a refined outline may take some more.
    assert len(masks) == FRAMES
    assert min(overlap(mask, square_mask(float(t))) for t, mask in enumerate(masks)) > 0.98
    assert (tmp_path / "heat.mp4").stat().st_size > 0


def test_a_click_and_a_word_and_a_click_beside_go_together(folder, capsys, monkeypatch):
    rows, columns = np.nonzero(square_mask(0))
    click = ["--point", f"{columns.mean() + 0.5},{rows.mean() + 0.5}", "--frame", "0", "--json"]
    left, right = columns.min() - 1, columns.max() + 2
    top, bottom = rows.min() - 1, rows.max() + 2
    around = f"{left},{top} {right},{top} {right},{bottom} {left},{bottom}"
    stroke = ["--brush", f"{left + 3},{top + 3} {right - 3},{bottom - 3}", "--brush-width", "3"]
    for more in (["--beside", "60,5"], ["--text", "square"], ["--lasso", around], stroke):
        code, out, _ = run(capsys, "query", folder / "scene.f4x", *click, *more)
        found = json.loads(out)
        assert code == 0 and found["chosen"] > 0 and found["static"] == 0
    code, _, err = run(
        capsys, "query", folder / "scene.f4x", *click, "--brush", around, "--beside", f"{left + 4},{top + 4}"
    )
    assert code == 2 and f"What is at {left + 4:g},{top + 4:g}, beside the thing, is selected all the same" in err
    monkeypatch.setattr(prompts, "point_out", lambda *evidence, **config: None)
    code, _, err = run(capsys, "query", folder / "scene.f4x", *click, "--beside", "60,5")
    assert code == 2 and "Nothing is left of what is marked" in err


def test_a_name_is_a_word_from_then_on(folder, capsys, tmp_path):
    scene = tmp_path / "scene.f4x"
    scene.write_bytes((folder / "scene.f4x").read_bytes())
    rows, columns = np.nonzero(square_mask(0))
    click = ["--click", f"{columns.mean() + 0.5},{rows.mean() + 0.5}", "--frame", "0"]
    code, out, _ = run(capsys, "name", scene, "red train", *click, "--json")
    named = json.loads(out)
    assert code == 0 and named["name"] == "red train" and named["chosen"] > 0
    code, out, _ = run(capsys, "query", scene, "--text", "the red train", "--json")
    assert code == 0 and json.loads(out)["chosen"] == named["chosen"]
    before = scene.read_bytes()
    for wrong, words in ((["a/b", *click], "letters, digits"), (["train"], "alone or together")):
        code, _, err = run(capsys, "name", scene, *wrong)
        assert code == 2 and words in err and scene.read_bytes() == before


@pytest.mark.parametrize(
    "word",
    [
        "everything",
        "red",
        "it",
        "left",
        "The Background",
        "the rest",
        "them",
        "two",
        "second",
        "the copy",
        "the biggest one",
    ],
)
def test_what_sentences_use_for_something_else_is_no_name(capsys, tmp_path, word):
    scene = tmp_path / "scene.f4x"
    write_scene(labelled_scene(), scene)
    before = scene.read_bytes()
    code, out, err = run(capsys, "name", scene, word, "--text", "square")
    assert code == 2 and not out and f"'{word}' cannot be a name, because it means something else" in err
    assert scene.read_bytes() == before


def test_naming_says_what_a_name_replaces(capsys, tmp_path):
    scene = tmp_path / "scene.f4x"
    write_scene(labelled_scene(), scene)

    def told(word, of):
        return run(capsys, "name", scene, word, "--text", of)[1]

    assert "in place of" not in told("race horse", "square")
    assert "in place of what the scene's own word meant; `f4x undo` brings that back" in told("Wall", "square")
    assert "in place of what an earlier edit called so" in told("race horse", "wall")
    assert json.loads(run(capsys, "query", scene, "--text", "wall", "--json")[1])["chosen"] == 81
    assert run(capsys, "undo", scene, "--count", "2")[0] == 0
    assert json.loads(run(capsys, "query", scene, "--text", "wall", "--json")[1])["chosen"] > 81


def test_query_by_mask_file_without_features(folder, capsys):
    mask = folder / "masks" / "00000.png"
    code, out, _ = run(capsys, "query", folder / "plain.f4x", "--mask", mask, "--frame", 0, "--span", "1:3", "--json")
    told = json.loads(out)
    assert code == 0 and 60 < told["chosen"] < 120 and told["span"] == [1, 3]


def test_render_shows_the_mask_of_a_label(folder, capsys, tmp_path):
    code, _, err = run(
        capsys, "render", folder / "scene.f4x", "--channels", "rgb,mask:square", "-o", tmp_path, "--path", "original"
    )
    assert code == 0, err
    mask = np.asarray(Image.open(tmp_path / "mask_square" / "00002.png")) > 127
    assert overlap(mask, square_mask(2.0)) > 0.98
    without = tmp_path / "without.f4x"
    assert run(capsys, "edit", folder / "scene.f4x", "--say", "delete the square", "-o", without)[0] == 0
    code, out, _ = run(capsys, "render", without, "--channels", "mask:square", "-o", tmp_path / "r", "--frames", "0:1")
    assert code == 0 and "r: 1 frame; nothing in the scene answers to mask:square: black pictures" in out


def test_ask_names_who_answered(folder, capsys, monkeypatch):
    monkeypatch.delenv("F4X_CHAT_URL", raising=False)
    code, out, _ = run(capsys, "ask", folder / "scene.f4x", "When does the square move?", "--path", "orbit")
    assert code == 0 and out.startswith("[computed]") and "square" in out


def test_ask_knows_what_is_selected(folder, capsys, monkeypatch, tmp_path):
    monkeypatch.delenv("F4X_CHAT_URL", raising=False)
    scene, chosen = folder / "scene.f4x", tmp_path / "it" / "selection.json"
    assert run(capsys, "query", scene, "--text", "square", "-o", chosen.parent)[0] == 0
    code, out, _ = run(capsys, "ask", scene, "What is it and does it move?", "--select", chosen)
    assert code == 0 and "The selection is the square (100%)." in out and "the selection moves to the right" in out
    code, _, err = run(capsys, "ask", scene, "What is it?", "--select", chosen, "--endpoint", "http://127.0.0.1:1/v1")
    assert code != 0 and "leave out one of them" in err


def test_bench_prints_the_figures(folder, capsys):
    code, out, _ = run(
        capsys, "bench", "features", "--scene", folder / "scene.f4x", "--masks", folder / "masks",
        "--label", "square", "--repeats", 1, "--json",
    )  # fmt: skip
    told = json.loads(out)
    assert code == 0 and told["text_ap"] > 0.95 and told["text_gaussians_ap"] > 0.95
    assert told[f"follow_iou_{FRAMES - 1}"] > 0.8 and told["size_ratio"] > 1 and told["visual_ms"] > 0


def test_bench_finds_no_change_in_the_pictures(folder, capsys, tmp_path):
    scene = labelled_scene()
    views = [(scene.cameras[t], float(t)) for t in range(FRAMES)]
    write_images(tmp_path / "clip", [render(scene, camera, time, ("rgb",))["rgb"] for camera, time in views])
    bench = ["bench", "features", "--scene", folder / "scene.f4x", "--clip", tmp_path / "clip", "--repeats", 1]
    code, out, err = run(capsys, *bench, "--plain", folder / "plain.f4x", "--json")
    told = json.loads(out)
    assert code == 0, err
    assert told["psnr"] == told["psnr_plain"] > 45 and told["psnr_change"] == told["psnr_change_most"] == 0
    paler = dataclasses.replace(scene.static, sh=0.9 * scene.static.sh)
    write_scene(labelled_scene(features=False, static=paler), tmp_path / "paler.f4x")
    code, out, _ = run(capsys, *bench, "--plain", tmp_path / "paler.f4x")
    change = float(re.search(r"psnr_change +(\S+) +\|\.\| < 0.1", out)[1])
    assert code == 0 and change > 1
    for arguments, words in (
        (["bench", "features"], "needs --scene"),
        ([*bench[:4], "--times"], "--times needs --clip"),
        ([*bench, "--frames", "0:3"], "3 frames"),
        ([*bench[:3], folder / "plain.f4x", *bench[4:]], "knows no words"),
    ):
        code, _, err = run(capsys, *arguments)
        assert code == 2 and words in err


def test_a_word_that_nobody_answers_to_is_told_with_what_is_there(folder, capsys, tmp_path):
    query = ["query", folder / "scene.f4x", "--text", "sky", "--not", "wall,square", "-o", tmp_path / "sky"]
    code, out, err = run(capsys, *query)
    assert code == 2 and not out and err.strip().count("\n") == 0 and not (tmp_path / "sky").exists()
    assert re.search(r"sky: nothing in the scene answers to it with 0\.5 or more .*the scene answers to .*square", err)
    code, out, _ = run(capsys, *query, "--if-any", "--json")
    told = json.loads(out)
    assert code == 0 and told["chosen"] == 0 and set(told["there"]) == {"square", "wall"} and told["note"] in out
    assert json.loads((tmp_path / "sky" / "selection.json").read_text())


def test_naming_and_selecting_what_nobody_answers_to_end_alike(capsys, tmp_path):
    """One sentence, exit code 2, and nothing written."""
    scene = tmp_path / "scene.f4x"
    write_scene(labelled_scene(), scene)
    assert run(capsys, "edit", scene, "--say", "remove the square")[0] == 0
    before = scene.read_bytes()
    for asked in (["query", scene, "-o", tmp_path / "none"], ["name", scene, "max"]):
        code, out, err = run(capsys, *asked, "--text", "square")
        assert code == 2 and not out and "square: nothing in the scene answers to it" in err
    assert scene.read_bytes() == before and not (tmp_path / "none").exists()


def test_info_lists_the_words_that_a_query_looks_for(folder, capsys, monkeypatch):
    monkeypatch.setitem(unknown.UNKNOWN, "words", {"surfaces": "wall"})
    _, out, _ = run(capsys, "info", folder / "scene.f4x")
    assert (
        "square" in out
        and "wall" not in out
        and "(not looked for, since the teacher of words knows no surfaces: 1 more)" in out
    )
    _, out, _ = run(capsys, "info", folder / "scene.f4x", "--json")
    told = json.loads(out)
    assert "wall" not in told["words"] and told["unknown_words"] == ["wall"]
    for word in told["words"]:
        assert "is not looked for" not in run(capsys, "query", folder / "scene.f4x", "--text", word)[2]
    assert "'wall' is not looked for" in run(capsys, "query", folder / "scene.f4x", "--text", "wall")[2]


def test_of_several_words_those_that_nobody_answers_to_are_told(folder, capsys):
    query = ["query", folder / "scene.f4x", "--text"]
    code, out, _ = run(capsys, *query, "square,sky")
    assert code == 0 and re.search(r"^square, sky: 81 of .*\nsky: nothing in the scene answers to it with 0\.5", out)
    told = json.loads(run(capsys, *query, "square,sky", "--json")[1])
    assert told["missing"] == ["sky"] and told["chosen"] == 81
    both = json.loads(run(capsys, *query, "square,wall", "--json")[1])
    assert both["chosen"] == both["gaussians"] and both["missing"] == [] and "note" not in both
    assert "sky" not in run(capsys, *query, "square,wall")[1]


def test_compounds_are_what_edits_take_them_for(folder, capsys, monkeypatch):
    monkeypatch.setattr(encoding, "encode_labels", lambda name, labels: np.eye(8, dtype=np.float32)[[0] * len(labels)])
    query = ["query", folder / "scene.f4x", "--text"]
    code, _, err = run(capsys, *query, "toy square")
    assert code == 2 and "lacks 'toy square'" in err
    # It says square to the encoder, and is a wall.
    code, out, _ = run(capsys, *query, "square wall", "--not", "square,sky", "--json")
    assert code == 0 and json.loads(out)["chosen"] == json.loads(out)["static"]
    assert "reading the text encoder for 'square wall'" in run(capsys, *query, "square wall")[2]


def test_names_that_edits_gave_are_found(capsys, tmp_path):
    scene = tmp_path / "scene.f4x"
    write_scene(labelled_scene(), scene)
    assert run(capsys, "edit", scene, "--say", "call the square rex")[0] == 0
    told = json.loads(run(capsys, "query", scene, "--text", "Rex", "--json")[1])
    assert told["label"] == "rex" and told["chosen"] == 81 and told["missing"] == []
    assert "[computed] Rex is on the left" in run(capsys, "ask", scene, "Where is rex?")[1]
    both = json.loads(run(capsys, "query", scene, "--text", "rex,wall", "--json")[1])
    assert both["chosen"] == both["gaussians"]
    assert run(capsys, "edit", scene, "--say", "remove the square")[0] == 0
    code, _, err = run(capsys, "query", scene, "--text", "rex")
    assert code == 2 and "rex: nothing in the scene answers" in err


def test_drawing_without_compiled_kernels_is_told_once(folder, capsys, monkeypatch):
    monkeypatch.setattr(
        "f4x_core.raster.why_not", lambda backend: "it is not built" if backend in ("native", "gsplat") else None
    )
    ask = ["ask", folder / "scene.f4x", "How long is the clip?"]
    assert run(capsys, *ask)[2].count("The compiled kernels are not there; drawing is about") == 1
    assert "compiled kernels" not in run(capsys, *ask, "--backend", "torch")[2]
    monkeypatch.undo()
    monkeypatch.setattr("f4x_core.raster.why_not", lambda backend: None)
    assert "compiled kernels" not in run(capsys, *ask)[2]


def test_what_was_deleted_is_found_no_more(folder, capsys, tmp_path):
    scene = tmp_path / "edited.f4x"
    write_scene(labelled_scene(), scene)
    assert run(capsys, "edit", scene, "--say", "remove the square")[0] == 0
    code, _, err = run(capsys, "query", scene, "--text", "square")
    assert code == 2 and "nothing in the scene answers" in err and "best: 0.00" in err
    code, _, err = run(capsys, "edit", scene, "--say", "make the square red")
    assert code == 2 and "an earlier edit removed the square" in err and "best: 1.00" not in err
    mask = folder / "masks" / "00000.png"
    code, out, _ = run(capsys, "query", scene, "--mask", mask, "--frame", 0, "--json")
    assert code == 0 and json.loads(out)["chosen"] == json.loads(out)["static"] > 0


def test_masks_that_are_none_of_the_clip(folder, capsys, tmp_path):
    def told(picture):
        picture.save(tmp_path / "mask.png")
        return run(capsys, "query", folder / "scene.f4x", "--mask", tmp_path / "mask.png", "--frame", 0)

    mask = Image.open(folder / "masks" / "00000.png")
    same = told(mask)
    assert same[0] == 0 and told(mask.convert("RGB")) == same and told(mask.resize((2 * WIDTH, 2 * HEIGHT), 0)) == same
    for picture, words in (
        (mask.resize((WIDTH, 2 * HEIGHT)), f"has {WIDTH}x{2 * HEIGHT} pixels, the clip's pictures {WIDTH}x{HEIGHT}"),
        (Image.merge("RGB", [mask, mask, Image.new("L", mask.size)]), "is a colour picture and no mask"),
    ):
        code, _, err = told(picture)
        assert code == 2 and words in err and "mask.png" in err and err.strip().count("\n") == 0


def test_a_selection_belongs_to_its_scene(folder, capsys, tmp_path):
    run(capsys, "query", folder / "scene.f4x", "--text", "square", "-o", tmp_path)
    other = labelled_scene()
    moved = dataclasses.replace(other.static, means=other.static.means + np.float32(0.01))
    write_scene(labelled_scene(static=moved), tmp_path / "other.f4x")
    edit = ["--say", "make it red", "--select", tmp_path / "selection.json", "--dry-run"]
    assert run(capsys, "edit", folder / "scene.f4x", *edit)[0] == 0
    code, _, err = run(capsys, "edit", tmp_path / "other.f4x", *edit)
    assert code == 2 and "was made of the scene labelled" in err
    unknown = json.loads((tmp_path / "selection.json").read_text()) | {
        "scene": "",
        "ids": [90_001],
        "scores": [1],
        "wins": [],
    }
    (tmp_path / "selection.json").write_text(json.dumps(unknown))
    code, _, err = run(capsys, "edit", folder / "scene.f4x", *edit)
    assert code == 2 and "1 of the selection's 1 Gaussians are not in" in err


def test_questions_that_cannot_be_answered_are_one_sentence(folder, capsys):
    code, out, err = run(capsys, "ask", folder / "scene.f4x", "What is the square made of?")
    assert code == 2 and not out and "can tell" in err and err.strip().count("\n") == 0


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["--text", "square", "--frame", "1"], "--frame goes with"),
        (["--text", ""], "names no label"),
        (["--text", "unicorn"], "lacks 'unicorn'"),
        (["--text", "square", "--not", "wall,Squares"], "'Squares' is asked for and excluded at once"),
        (["--text", "a", "--point", "1,2"], "need --frame T"),
        (["--beside", "1,2"], "alone or together"),
        (["--lasso", "1,2 3,4", "--frame", "0"], "at least 3 points"),
        (["--brush", "1,2 3", "--frame", "0"], "write 'X,Y X,Y …'"),
        (["--text", "square", "--beside", "1,2", "--frame", "0"], "--frame goes with"),
        (["--text", "square", "--part"], "--part goes with --point"),
        (["--mask", "nowhere.png", "--text", "square"], "need --frame T"),
        ([], "alone or together"),
        (["--point", "1,2"], "needs --frame"),
        (["--point", "1;2", "--frame", "0"], "write X,Y"),
        (["--point", f"{WIDTH + 9},2", "--frame", "0"], "outside the picture"),
        (["--point", "1,2", "--frame", "77"], "no frame 77"),
        (["--point", "", "--frame", "0"], "write X,Y"),
        (["--mask", "nowhere.png", "--frame", "0"], "nowhere.png does not exist"),
        (["--box", "1,2,3", "--frame", "0"], "write X0,Y0,X1,Y1"),
        (["--box", f"1,2,1,{HEIGHT}", "--frame", "0"], "box"),
        (["--text", "square", "--threshold", "2"], "from 0 to 1"),
        (["--text", "square", "--span", "3"], "A:B"),
        (["--text", "square", "--span", "3:99"], "within the clip"),
        (["--text", "square", "--span", "3:1"], "ends before"),
    ],
)
def test_wrong_queries_are_one_sentence(folder, capsys, arguments, words):
    code, _, err = run(capsys, "query", folder / "scene.f4x", *arguments)
    sentence = err.rpartition("f4x query: ")[2]  # a stage may have been told before it
    assert code == 2 and words in sentence and sentence.strip().count("\n") == 0


def test_words_are_added_without_learning_a_head_anew(folder, capsys, tmp_path, monkeypatch):
    class Encoder:
        def encode(self, labels):
            return np.eye(8, dtype=np.float32)[[5] * len(labels)]

    def add(scene, labels, **options):
        return with_vocabulary(scene, labels, lambda name: Encoder(), **options)

    monkeypatch.setattr(distilling, "with_vocabulary", add)
    monkeypatch.setattr(distilling, "distil", lambda *_: pytest.fail("a head was learnt anew"))
    scene = tmp_path / "scene.f4x"
    write_scene(labelled_scene(), scene)
    code, _, err = run(capsys, "distill", scene, "--teacher", "text", "--vocabulary", "boats.txt")
    assert code == 2 and "--vocabulary boats.txt: there is no such file" in err
    code, out, err = run(capsys, "distill", scene, "--teacher", "text", "--vocabulary", "boat, ship")
    assert code == 0 and "text: kept as learnt" in out, err
    before, after = read_scene(folder / "scene.f4x").features, read_scene(scene).features
    assert after.vocabularies["words"].labels == (*before.vocabularies["words"].labels, "boat", "ship")
    np.testing.assert_array_equal(after.static, before.static)


def test_frames_of_a_clip_are_those_that_the_fit_took(capsys, tmp_path, monkeypatch):
    scene = dataclasses.replace(labelled_scene(), provenance={"source": "moved", "frames": f"2:{2 * FRAMES + 2}:2"})
    write_scene(scene, tmp_path / "scene.f4x")
    pictures = [np.full((HEIGHT, WIDTH, 3), 10 * number, np.uint8) for number in range(2 * FRAMES + 3)]
    write_images(tmp_path / "clip", pictures)
    seen = []

    def extract(clip, name, folder, progress):
        seen.append([int(frame.mean()) // 10 for frame in clip.frames])
        raise F4xError("seen")

    monkeypatch.setattr(distilling, "extract", extract)
    command = ["distill", tmp_path / "scene.f4x", "--teacher", "visual", "--clip", tmp_path / "clip"]
    assert run(capsys, *command)[0] == 2 and run(capsys, *command, "--frames", f"0:{FRAMES}")[0] == 2
    assert seen == [[*range(2, 2 * FRAMES + 2, 2)], [*range(FRAMES)]]
    code, out, err = run(capsys, "eval", tmp_path / "scene.f4x", "--clip", tmp_path / "clip", "--json")
    assert code == 0 and len(json.loads(out)["frames"]) == FRAMES, err


def test_a_rank_beyond_the_channels_is_told(capsys, tmp_path, monkeypatch):
    class Teacher:
        def spec_for(self, width, height):
            return FeatureSpec("means", 3, (2, 3))

        def encode(self, rgb):
            return np.ones((2, 3, 3), np.float32)

    entry = SimpleNamespace(name="means", version=1, load=lambda model: Teacher())
    monkeypatch.setitem(TEACHERS, "means", entry)
    monkeypatch.setattr("f4x_core.cli.features.require_ready", lambda name: None)
    write_images(tmp_path / "clip", np.zeros((3, 8, 12, 3), np.uint8))
    features = ["features", tmp_path / "clip", "--teacher", "means", "-o"]
    code, out, err = run(capsys, *features, tmp_path / "all", "--rank", 9999)
    assert code == 0 and "--rank 9999 keeps all 3 channels there are" in out, err
    code, out, _ = run(capsys, *features, tmp_path / "one", "--rank", 1)
    assert code == 0 and "keeps all" not in out and "kept as 1 directions" in out


def test_words_need_a_field(folder, capsys):
    for asked in (
        ["query", "--text", "square"],
        ["edit", "--say", "make the dog red"],
        ["ask", "Where is the square?"],
    ):
        code, _, err = run(capsys, asked[0], folder / "plain.f4x", *asked[1:])
        assert code == 2 and re.search(
            r"The scene '\w+' knows no words .*found by its name; `f4x distill SCENE --teacher text", err
        )


def test_a_doubtful_question_is_asked_back_and_answered_with_yes(folder, capsys):
    scene, question = str(folder / "scene.f4x"), "where is the sqaure?"
    assert main(["ask", scene, question, "--json"]) != 0
    asked = json.loads(capsys.readouterr().out)
    assert asked["instead"] == "where is the square"
    assert "did you mean 'square'? Say 'where is the square', or add --yes." in asked["error"]
    assert main(["ask", scene, question, "--yes"]) == 0
    assert "Read as 'where is the square'. " in capsys.readouterr().out
