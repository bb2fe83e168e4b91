"""Manifests: what each kind says, the tasks that follow from it, and the one sentence for what is wrong."""

import json

import pytest

from f4x_core.app.rendering import part_of
from f4x_core.batch.checks import require_values
from f4x_core.batch.graph import CLIP, declared_frames, tasks_of
from f4x_core.batch.manifest import Row, read_manifest
from f4x_core.batch.storage import Digests
from f4x_core.cli.fitting import config_of
from f4x_core.cli.parser import build_parser
from f4x_core.errors import F4xError
from f4x_core.query import chat
from f4x_core.windows.plan import LONG


def write(path, text):
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(text, encoding="utf-8")
    return str(path)


def test_a_glob_makes_a_row_of_each_clip(tmp_path):
    for name in ("b.mp4", "a.mp4", "a.txt"):
        write(tmp_path / "shots" / name, name)
    rows = read_manifest(str(tmp_path / "shots" / "*.mp4"), {"profile": "quick", "exports": "usd; ply"})
    assert [row.name for row in rows] == ["a", "b"]
    assert rows[0].profile == "quick" and rows[0].exports == ("usd", "ply") and rows[0].paths == ("original",)


def test_a_csv_and_a_json_say_the_same(tmp_path):
    table = write(
        tmp_path / "list.csv",
        "clip,name,width,edits,paths,masks\n"
        'a.mp4,,320,"make it red, then blue; ops/wide.json",none,layout\n'
        "takes/images,second,,,orbit;mine.json,masks/a\n",
    )
    data = [
        {
            "clip": "a.mp4",
            "width": 320,
            "edits": ["make it red, then blue", "ops/wide.json"],
            "paths": [],
            "masks": "layout",
        },
        {"clip": "takes/images", "name": "second", "paths": ["orbit", "mine.json"], "masks": "masks/a", "seed": 3},
    ]
    described = write(tmp_path / "list.json", json.dumps(data))
    rows = read_manifest(table, {"seed": "3"})
    assert read_manifest(described)[1] == rows[1]
    assert (
        rows[0].clip == str(tmp_path / "a.mp4") and rows[0].name == "a" and rows[0].width == 320 and rows[0].seed == 3
    )
    assert rows[0].edits == ("make it red, then blue", str(tmp_path / "ops" / "wide.json")) and rows[0].paths == ()
    assert rows[1].masks == str(tmp_path / "masks" / "a") and rows[0].masks == "layout"
    assert rows[1].paths == ("orbit", str(tmp_path / "mine.json")) and rows[1].width is None


@pytest.mark.parametrize(
    "text",
    [
        "clip,profile,paths\r\na.mp4,quick,original;orbit\r\n",
        'sep=;\r\nclip;profile;paths\r\na.mp4;quick;"original;orbit"\r\n',
        "clip\tprofile\tpaths\na.mp4\tquick\toriginal;orbit\n",
        "# shots, of today\n\nclip,profile,paths\n#b.mp4,quick,\n,,\na.mp4,quick,original;orbit\n",
    ],
)
def test_what_spreadsheets_and_people_write_is_read(tmp_path, text):
    (row,) = read_manifest(write(tmp_path / "list.csv", "\ufeff" + text))
    assert (row.name, row.profile, row.paths) == ("a", "quick", ("original", "orbit"))


def test_a_name_may_speak_of_the_clips_folder(tmp_path):
    for shot in ("sc 010", "sc020"):
        write(tmp_path / shot / "plate.mp4", shot)
    pattern = str(tmp_path / "*" / "plate.mp4")
    with pytest.raises(F4xError, match=r"would both write the folder 'plate'.*--set 'name={parent}_{stem}'"):
        read_manifest(pattern)
    assert [row.name for row in read_manifest(pattern, {"name": "{parent}"})] == ["sc_010", "sc020"]
    assert read_manifest(pattern, {"name": "v2-{parent}-{stem}"})[1].name == "v2-sc020-plate"


def test_a_folder_called_images_has_the_name_of_the_one_it_lies_in(tmp_path):
    assert read_manifest(write(tmp_path / "l.json", '[{"clip": "big dog/images"}]'))[0].name == "big_dog"


@pytest.mark.parametrize(
    ("name", "text", "sentence"),
    [
        ("l.csv", "clip,profil\na.mp4,quick\n", "line 1: there is no column 'profil', near it is 'profile'"),
        ("l.csv", "clip,width\na.mp4,wide\n", "line 2, width is 'wide'; write a whole number"),
        ("l.csv", "clip,width\na.mp4,1,2\n", "line 2: it has 3 cells, the head 2 columns; put a cell that holds ','"),
        (
            "l.csv",
            "clip;paths\na.mp4;original;orbit\n",
            "it has 3 cells, the head 2 columns; put a cell that holds ';'",
        ),
        ("l.csv", "clip,width,clip\na.mp4,8,b.mp4\n", "line 1: the column 'clip' is there 2 times"),
        ("l.csv", "clip,width\na.mp4,-5\n", "line 2: width is -5; give 2 or more"),
        ("l.csv", "clip,frames\na.mp4,9:3\n", "line 2: frames '9:3' select nothing"),
        ("l.csv", "clip,paths\na.mp4,orbitt\n", "line 2: paths has 'orbitt', near it is 'orbit'"),
        (
            "l.csv",
            "clip,paths\na.mp4,slow:0\n",
            "line 2: paths has 'slow:0'; known: original, orbit, stabilise, slow:FACTOR",
        ),
        ("l.csv", "clip,channels\na.mp4,rgb;normalz\n", "line 2: channels has 'normalz'; known: rgb"),
        ("l.csv", "clip,channels\na.mp4,latent\n", "line 2: channels has 'latent'"),
        (
            "l.csv",
            "clip,backend\na.mp4,gsplat\n",
            "line 2: backend has 'gsplat'; known: auto, native, torch, reference",
        ),
        ("l.csv", "clip,queries\na.mp4,dog\n", "line 2: queries need features"),
        ("l.csv", "clip,name\na.mp4,CON\n", "'CON' cannot name a folder"),
        ("l.csv", "clip,name\na.mp4,lpt1.x\n", "'lpt1.x' cannot name a folder"),
        ("l.csv", "clip,name\na.mp4,a.\n", "'a.' cannot name a folder"),
        ("l.csv", "clip\n", "has no rows"),
        ("l.csv", "name\nx\n", "'clip' is missing"),
        ("l.csv", "clip\nx/a.mp4\ny/a.mp4\n", "rows 1 .*x/a.mp4.* and 2 .*y/a.mp4.* would both write the folder 'a'"),
        ("l.csv", "clip,name\na.mp4,A\nb.mp4,a\n", "would both write the folder"),
        ("l.csv", "clip,name\na.mp4,../a\n", "'../a' cannot name a folder"),
        ("l.csv", "clip,name\na.mp4,index.html\n", "'index.html' cannot name a folder"),
        ("l.csv", "clip,parts\na.mp4,0\n", "parts is 0; give 1 or more"),
        ("l.csv", "clip,exports\na.mp4,usdz\n", "exports has 'usdz', near it is 'usd'"),
        ("m.csv", "clip,features\na.mp4,text;visuel\n", "features has 'visuel', near it is 'visual'"),
        ("l.json", "{", "is no JSON"),
        ("l.json", "[]", "at least one"),
        ("l.json", '[{"clip": "a", "edit": []}]', "row 1: 'edit' is unknown, near it is 'edits'"),
        ("l.json", '["a.mp4"]', "row 1: 'a.mp4' is no JSON object"),
    ],
)
def test_bad_manifests_are_one_sentence(tmp_path, name, text, sentence):
    with pytest.raises(F4xError, match=sentence):
        read_manifest(write(tmp_path / name, text))


def test_a_glob_that_finds_nothing_and_a_file_that_is_missing(tmp_path):
    with pytest.raises(F4xError, match="no clip is there"):
        read_manifest(str(tmp_path / "*.mp4"))
    with pytest.raises(F4xError, match=r"absent\.csv: cannot be read"):
        read_manifest(str(tmp_path / "absent.csv"))


FULL = Row(
    "clip.mp4",
    "clip",
    profile="quick",
    frames="0:9",
    hold_out=4,
    masks="masks",
    prior=("depth=far",),
    features=("tipsv2", "clip"),
    vocabulary=("dog", "cat"),
    queries=("big dog",),
    edits=("make the dog red", "wide.json"),
    paths=("original", "stabilise", "slow:2.5", "bullet:1", "frozen:3", "mine.json"),
    parts=2,
    exports=("usd", "ply"),
)


def test_every_task_is_a_command_that_f4x_takes():
    tasks = tasks_of(FULL, lambda path: "")
    assert [task.stage for task in tasks] == [
        "priors",
        "fit",
        "distill",
        "query big dog",
        "edit",
        *(f"render {path} {part}/2" for path in FULL.paths for part in (1, 2)),
        "export usd",
        "export ply",
    ]
    stages = set()
    for task in tasks:
        assert {stage for stage, _ in task.inputs} <= stages
        stages.add(task.stage)
        for command in task.commands:
            args = build_parser().parse_args(["clip.mp4" if word == CLIP else word for word in command])
            assert args.verb == task.kind
    assert {task.kind: dict(task.inputs) for task in tasks} == {
        "priors": {},
        "fit": {"priors": "priors/"},
        "distill": {"fit": "scene.f4x"},
        "query": {"distill": "distilled.f4x"},
        "edit": {"distill": "distilled.f4x"},
        "render": {"edit": "edited.f4x"},
        "export": {"edit": "edited.f4x"},
    }


def test_a_key_changes_with_what_decides_a_task_and_with_nothing_else(tmp_path):
    from dataclasses import replace

    clip = write(tmp_path / "clip.mp4", "pictures")
    row = replace(FULL, clip=clip, masks=None, prior=(), paths=("original",), edits=("make it red",))

    def keys(row):
        return {task.stage: task.key for task in tasks_of(row, Digests().digest)}

    def changed(other):
        return {stage.split(" ")[0] for stage, key in keys(other).items() if key != keys(row)[stage]}

    assert changed(row) == set()
    assert changed(replace(row, name="other", exports=("usd-points", "usd", "ply")[1:])) <= {"export"}
    assert changed(replace(row, edits=("make it blue",))) == {"edit", "render", "export"}
    assert changed(replace(row, channels=("rgb", "depth"))) == {"render"}
    everything = {"priors", "fit", "distill", "query", "edit", "render", "export"}
    assert changed(replace(row, seed=1)) == everything
    moved = write(tmp_path / "elsewhere" / "clip.mp4", "pictures")
    assert changed(replace(row, clip=moved)) == set()
    before = keys(row)
    write(tmp_path / "clip.mp4", "Pictures")
    assert all(keys(row)[stage] != key for stage, key in before.items())


def test_a_clip_in_windows_makes_its_priors_by_itself(tmp_path):
    from dataclasses import replace

    def tasks(**changes):
        return tasks_of(replace(FULL, **changes), lambda path: "")

    first = tasks(window=80, overlap=16)[0]
    assert (first.stage, first.inputs) == ("fit", ()) and first.commands[0][-4:] == (
        "--window",
        "80",
        "--overlap",
        "16",
    )
    assert [task.stage for task in tasks(window=0)[:2]] == ["priors", "fit"]
    for number in range(LONG + 1):
        (tmp_path / f"{number:05d}.png").touch()
    long = {"clip": str(tmp_path), "masks": None}
    assert tasks(**long, frames=None)[0].stage == "fit" and tasks(**long, frames=f"0:{LONG}")[0].stage == "priors"


@pytest.mark.parametrize(
    ("changes", "sentence"),
    [
        ({"edits": ("frobnicate the dog",)}, "edits has 'frobnicate the dog': I do not understand 'frobnicate'"),
        ({"features": (), "queries": ()}, "edits has 'make the dog red', which names a thing; add the column features"),
        ({"window": 20, "overlap": 12}, "windows of 20 frames cannot share 12"),
        ({"overlap": 180}, "windows of 360 frames cannot share 180"),
    ],
)
def test_values_that_no_clip_could_make_right_are_told_before_any_task(changes, sentence, monkeypatch):
    from dataclasses import replace

    require_values(FULL)
    with pytest.raises(F4xError, match=sentence):
        require_values(replace(FULL, **changes))
    monkeypatch.setenv(chat.URL, "http://127.0.0.1:9")
    if "edits" in changes:
        require_values(replace(FULL, **changes))  # a model may understand it


def test_settings_of_the_fit_reach_its_command(tmp_path):
    table = 'clip,settings\na.mp4,"steps=600; rates.static.means=6e-4,6e-6"\n'
    [row] = read_manifest(write(tmp_path / "a.csv", table))
    require_values(row)
    priors, fit = tasks_of(row, lambda path: "")[:2]
    for task in (priors, fit):
        args = build_parser().parse_args(["clip.mp4" if word == CLIP else word for word in task.commands[0]])
        assert config_of(args).steps == 600 and args.set == ["steps=600", "rates.static.means=6e-4,6e-6"]
    [default] = read_manifest(write(tmp_path / "b.csv", "clip\nb.mp4\n"), {"settings": "steps=6; seed=3"})
    assert default.settings == ("steps=6", "seed=3")


def test_sentences_about_what_earlier_ones_make_are_left_to_the_scene():
    for edits in (("duplicate everything", "make the copy red"), ("wide.json", "make bob red")):
        require_values(Row("clip.mp4", "clip", edits=edits))
    require_values(
        Row("clip.mp4", edits=("remove the traffic light",), features=("text",), vocabulary=("traffic light",))
    )


def test_frames_and_files_are_looked_at_before_any_task(tmp_path):
    for number in range(8):
        write(tmp_path / "clip" / f"{number}.png", "")
    clip, noise = str(tmp_path / "clip"), write(tmp_path / "noise.mp4", "noise")
    assert declared_frames(Row(clip, frames="0:8:2")) == (4, "") and declared_frames(
        Row(str(tmp_path / "absent.mp4"))
    ) == (0, "")
    assert "reach beyond" in declared_frames(Row(clip, frames="0:900"))[1]
    assert "cannot be read as a video" in declared_frames(Row(noise))[1]
    require_values(Row(clip, paths=("frozen:7", "absent.json"), edits=("absent.json",)))
    require_values(Row(noise, paths=("frozen:7",)))
    for path in ("frozen:7", "bullet:7"):
        with pytest.raises(F4xError, match=rf"paths has {path}, .*clip has frames 0 to 3"):
            require_values(Row(clip, frames="0:8:2", paths=(path,)))
    broken = write(tmp_path / "broken.json", "[{}]")
    for row in (Row(clip, edits=(broken,)), Row(clip, paths=(broken,))):
        with pytest.raises(F4xError, match=r"broken\.json"):
            require_values(row)


def test_two_words_that_would_share_a_folder_are_refused():
    from dataclasses import replace

    with pytest.raises(F4xError, match="'a b' and 'a_b' would both write query/a_b"):
        tasks_of(replace(FULL, queries=("a b", "a_b")), lambda path: "")


def test_digests_are_read_again_only_after_a_change(tmp_path, monkeypatch):
    clip = write(tmp_path / "clip" / "0.png", "one")
    folder = str(tmp_path / "clip")
    digests = Digests()
    first = digests.digest(folder)
    again = Digests(json.loads(json.dumps(digests.to_json())))
    monkeypatch.setattr("f4x_core.batch.storage._content", None)
    assert again.digest(folder) == first
    monkeypatch.undo()
    write(tmp_path / "clip" / "1.png", "two")
    assert again.digest(folder) != first
    assert Digests().digest(clip) != "" and Digests().digest(str(tmp_path / "absent")) == ""


@pytest.mark.parametrize(("count", "parts"), [(10, 3), (2, 4), (7, 1)])
def test_the_parts_of_a_path_are_every_view_once(count, parts):
    shares = [part_of(count, f"{part}/{parts}") for part in range(1, parts + 1)]
    assert [view for share in shares for view in share] == list(range(count))
    assert max(map(len, shares)) - min(map(len, shares)) <= 1


@pytest.mark.parametrize("part", ["0/4", "5/4", "1", "a/b", "1/0", "-1/2"])
def test_a_part_that_is_none_is_one_sentence(part):
    with pytest.raises(F4xError, match="write I/N with I from 1 to N"):
        part_of(10, part)
