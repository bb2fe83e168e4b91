"""The .f4x file: exact round trips, appended edits, and hostile or damaged bytes."""

import errno
import hashlib
import io
import json
import os
import zipfile
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from random_scene import arrays_of, assert_same, random_scene

from f4x_core.errors import F4xError
from f4x_core.scene import read_header, read_scene, write_edits, write_scene
from f4x_core.scene.model import KEYS
from f4x_core.versions import SCENE_FILE as VERSION

BASE = random_scene(static=6, dynamic=4)


def at_rest_in_part(scene, moving=slice(2, 4)):
    """The scene whose nodes move in `moving` frames only, as those of one window of a long clip do."""
    scaffold = scene.scaffold
    frames = np.arange(len(scaffold.times))[moving]
    rows = np.clip(np.arange(len(scaffold.times)), frames[0], frames[-1])
    still = replace(scaffold, xyz=scaffold.xyz[rows], quat=scaffold.quat[rows], certain=scaffold.certain[rows])
    return replace(scene, scaffold=still)


RESTING = at_rest_in_part(BASE)


@pytest.fixture
def path(tmp_path):
    write_scene(BASE, tmp_path / "scene.f4x")
    return tmp_path / "scene.f4x"


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    """The bytes of a good file and a place to put bad ones."""
    path = tmp_path_factory.mktemp("damage") / "scene.f4x"
    write_scene(BASE, path)
    return path.read_bytes(), path


@pytest.mark.parametrize("dynamic", [0, 4])
@pytest.mark.parametrize("degree", [0, 3])
def test_round_trip_is_exact_and_bytes_repeat(tmp_path, dynamic, degree):
    scene = random_scene(
        dynamic=dynamic,
        degree=degree,
        extra={"static/latent": np.ones((30, 8), np.float16), "features/basis": np.arange(6.0).reshape(2, 3)},
        extra_fields={"teacher": {"name": "x"}},
        edits=({"op": "hide", "ids": [1, 2]},),
    )
    write_scene(scene, tmp_path / "a.f4x")
    read = read_scene(tmp_path / "a.f4x")
    assert_same(scene, read)
    write_scene(read, tmp_path / "b.f4x")
    assert (tmp_path / "a.f4x").read_bytes() == (tmp_path / "b.f4x").read_bytes()
    assert sorted(os.listdir(tmp_path)) == ["a.f4x", "b.f4x"]


def test_poses_are_kept_where_they_change_and_come_back_to_the_bit(tmp_path):
    a, b = tmp_path / "a.f4x", tmp_path / "b.f4x"
    scaffold = RESTING.scaffold
    xyz = scaffold.xyz.copy()
    xyz[:, 0, 0] = 0.0
    xyz[1, 0, 0] = -0.0  # an equal number, and another bit
    certain = np.zeros_like(scaffold.certain)
    certain[-1, 1] = True
    scene = replace(RESTING, scaffold=replace(scaffold, xyz=xyz, certain=certain))
    write_scene(scene, a)
    header = read_header(a)
    assert header["version"] == 4
    # two poses a node; 0, -0, 0 make three of the first node's first; the last one of the second is certain
    assert header["arrays"]["scaffold/held"]["shape"] == [2 * len(scaffold) + 2 + 1]
    assert header["arrays"]["scaffold/xyz"]["shape"] == [2 * len(scaffold) + 3, 3]
    read = read_scene(a)
    for name in ("xyz", "quat", "certain"):
        old, new = getattr(scene.scaffold, name), getattr(read.scaffold, name)
        assert old.tobytes() == new.tobytes() and old.dtype == new.dtype and not new.flags.writeable
    assert_same(scene, read)
    write_scene(read, b)
    assert a.read_bytes() == b.read_bytes()


def test_size_goes_with_the_motion_and_not_with_the_frames(tmp_path):
    def long(frames):
        still = at_rest_in_part(RESTING).scaffold
        rows = np.minimum(np.arange(frames), len(still.times) - 1)
        poses = {name: getattr(still, name)[rows] for name in ("xyz", "quat", "certain")}
        write_scene(
            replace(RESTING, scaffold=replace(still, times=np.arange(float(frames)), **poses)), tmp_path / "long.f4x"
        )
        return (tmp_path / "long.f4x").stat().st_size

    assert long(2000) - long(1000) < 1000 * 8 + 100  # the times alone


def test_moving_nodes_keep_all_their_poses_in_a_file_that_older_programs_read(path):
    header = read_header(path)
    assert header["version"] == 1 and "scaffold/held" not in header["arrays"]


def test_runs_that_would_unfold_to_too_much_are_not_written_and_not_read(tmp_path, monkeypatch):
    write_scene(RESTING, tmp_path / "a.f4x")
    monkeypatch.setattr("f4x_core.scene.runs.MAX_POSES", RESTING.scaffold.certain.size - 1)
    with pytest.raises(F4xError, match=r"a\.f4x: scaffold/held stands for .* poses; more than"):
        read_scene(tmp_path / "a.f4x")
    write_scene(RESTING, tmp_path / "b.f4x")
    assert read_header(tmp_path / "b.f4x")["version"] == 1
    assert_same(RESTING, read_scene(tmp_path / "b.f4x"))


def test_a_stranger_unfolds_runs_with_the_lines_of_the_documentation(tmp_path):
    write_scene(RESTING, tmp_path / "a.f4x")
    arrays = {}
    with zipfile.ZipFile(tmp_path / "a.f4x") as archive:
        for name in json.loads(archive.read("scene.json"))["arrays"]:
            arrays[name] = np.load(io.BytesIO(archive.read(f"{name}.npy")), allow_pickle=False)
    text = (Path(__file__).parents[2] / "docs" / "scene_file.md").read_text(encoding="utf-8")
    (lines,) = (part.split("```")[0] for part in text.split("```python")[1:] if "np.repeat" in part)
    exec(lines, {"arrays": arrays, "np": np})
    for name in ("xyz", "quat", "certain"):
        np.testing.assert_array_equal(arrays[f"scaffold/{name}"], getattr(RESTING.scaffold, name))


def test_read_arrays_cannot_be_changed(path):
    for name, array in arrays_of(read_scene(path)).items():
        if not name.startswith("cameras"):  # CameraPath keeps its own
            assert not array.flags.writeable, name


def test_numpy_and_the_standard_library_are_enough_for_a_stranger(path):
    with zipfile.ZipFile(path) as archive:
        header = json.loads(archive.read("scene.json"))
        for name, entry in header["arrays"].items():
            member = archive.read(f"{name}.npy")
            assert hashlib.sha256(member).hexdigest() == entry["sha256"]
            array = np.load(io.BytesIO(member), allow_pickle=False)
            assert (list(array.shape), array.dtype.str) == (entry["shape"], entry["dtype"])
            group, key = name.split("/")
            field = (
                {value: field for field, value in KEYS.items()}.get(key, key) if group in ("static", "dynamic") else key
            )
            np.testing.assert_array_equal(array, arrays_of(BASE)[f"{group}/{field}"])


def test_metrics_without_a_value_become_null_and_numpy_numbers_plain(tmp_path):
    write_scene(replace(BASE, metrics={"lpips": np.float32("nan"), "n": np.int64(3)}), tmp_path / "m.f4x")
    assert read_scene(tmp_path / "m.f4x").metrics == {"lpips": None, "n": 3}


def test_unwritable_field_leaves_the_old_file(path):
    before = path.read_bytes()
    with pytest.raises(F4xError, match=r"scene\.f4x.*JSON"):
        write_scene(replace(BASE, metrics={"bad": object()}), path)
    assert path.read_bytes() == before and os.listdir(path.parent) == [path.name]


def test_append_edit_keeps_every_other_member_byte_for_byte(path):
    with zipfile.ZipFile(path, "a") as archive:
        archive.writestr("notes/readme.txt", "kept by write_edits")
    with zipfile.ZipFile(path) as archive:
        before = {info.filename: archive.read(info) for info in archive.infolist()}
    first = {"op": "hide", "ids": [3]}
    write_edits(path, [first])
    write_edits(path, [first, {"op": "copy", "ids": [3]}], next_id=77)
    with zipfile.ZipFile(path) as archive:
        after = {info.filename: archive.read(info) for info in archive.infolist()}
    assert before.keys() == after.keys()
    assert all(before[name] == after[name] for name in before if name != "scene.json")
    scene = read_scene(path)
    assert [edit["op"] for edit in scene.edits] == ["hide", "copy"] and scene.next_id == 77
    write_edits(path, scene.edits[:1])
    assert_same(read_scene(path), replace(BASE, edits=({"op": "hide", "ids": [3]},), next_id=77))


@pytest.mark.parametrize(
    ("record", "next_id"), [("no object", None), ({"op": {1, 2}}, None), ({}, 1 << 63), ({"text": "\ud800"}, None)]
)
def test_an_edit_that_could_not_be_read_back_is_refused(path, record, next_id):
    before = path.read_bytes()
    with pytest.raises(F4xError, match=r"scene\.f4x"):
        write_edits(path, [record], next_id)
    assert path.read_bytes() == before


@pytest.mark.parametrize(
    "fields",
    [
        {"needs": ("row",)},
        {"name": 5},
        {"provenance": [1]},
        {"extra": {"../up": np.zeros(2)}},
        {"extra": {"words": np.array(["a"])}},
        {"extra": {"static/xyz": np.zeros((6, 3))}},
        {"extra": {"scaffold/held": np.ones(2, np.int32)}},
    ],
)
def test_a_scene_that_could_not_be_read_back_is_refused(tmp_path, fields):
    with pytest.raises(F4xError):
        write_scene(replace(BASE, **fields), tmp_path / "a.f4x")
    assert not os.listdir(tmp_path)


class FullDisk:
    """Stands in for os.fsync and os.replace on a disk without space."""

    def __call__(self, *_):
        raise OSError(errno.ENOSPC, "No space left on device")


@pytest.mark.parametrize("where", ["os.fsync", "os.replace"])
@pytest.mark.parametrize("action", [lambda p: write_scene(BASE, p), lambda p: write_edits(p, [{"op": "hide"}])])
def test_full_disk_leaves_the_old_file_and_nothing_else(path, monkeypatch, where, action):
    before = path.read_bytes()
    with monkeypatch.context() as patch:
        patch.setattr(where, FullDisk())
        with pytest.raises(F4xError, match=r"scene\.f4x: cannot be written \(No space left on device\)"):
            action(path)
    assert path.read_bytes() == before and os.listdir(path.parent) == [path.name]


def test_full_disk_in_the_middle_of_an_array(tmp_path, monkeypatch):
    real = zipfile._ZipWriteFile.write

    def write(self, data):
        if memoryview(data).nbytes > 200:
            raise OSError(errno.ENOSPC, "No space left on device")
        return real(self, data)

    monkeypatch.setattr(zipfile._ZipWriteFile, "write", write)
    with pytest.raises(F4xError, match="No space left"):
        write_scene(random_scene(), tmp_path / "full.f4x")
    assert not os.listdir(tmp_path)


def test_missing_folder_and_missing_file(tmp_path):
    with pytest.raises(F4xError, match="cannot be written"):
        write_scene(BASE, tmp_path / "nowhere" / "a.f4x")
    with pytest.raises(F4xError, match="no such file"):
        read_scene(tmp_path / "a.f4x")
    with pytest.raises(F4xError, match=r"a folder without scene\.f4x"):
        read_scene(tmp_path)
    (tmp_path / "notes.txt").write_text("no scene")
    with pytest.raises(F4xError, match=r"notes\.txt: not a Feature4X scene; choose a \.f4x file"):
        read_scene(tmp_path / "notes.txt")


def rewritten(path, change_header=None, members=None, compress=zipfile.ZIP_STORED):
    """Rewrite the file with a changed header dict and replaced or added members; sha256 and shapes are not touched."""
    with zipfile.ZipFile(path) as archive:
        content = {info.filename: archive.read(info) for info in archive.infolist()}
    if change_header is not None:
        header = json.loads(content["scene.json"])
        change_header(header)
        content["scene.json"] = json.dumps(header).encode()
    content.update(members or {})
    with zipfile.ZipFile(path, "w", compress) as archive:
        for name, data in content.items():
            if data is not None:
                archive.writestr(name, data)


def npy(array, **options):
    stream = io.BytesIO()
    np.save(stream, array, **options)
    return stream.getvalue()


def with_array(name, array, **options):
    """A change that replaces one array, its checksum and its row in the table as an honest but wrong writer would."""

    def change(path):
        data = npy(array, **options)
        row = {"shape": list(array.shape), "dtype": array.dtype.str, "sha256": hashlib.sha256(data).hexdigest()}
        rewritten(path, lambda header: header["arrays"].update({name: row}), {f"{name}.npy": data})

    return change


def with_header(**fields):
    return lambda path: rewritten(path, lambda header: header.update(fields))


def without(name):
    return lambda path: rewritten(path, lambda header: header.pop(name))


def without_array(name):
    return lambda path: rewritten(path, lambda header: header["arrays"].pop(name))


def huge_shape(path):
    """An .npy header that promises 8 EB; sha256 is right."""
    data = npy(np.zeros(4)).replace(b"(4,), ", b"(999999999999999999,), ", 1)
    row = {"shape": [999999999999999999], "dtype": "<f8", "sha256": hashlib.sha256(data).hexdigest()}
    rewritten(path, lambda header: header["arrays"].update({"bomb": row}), {"bomb.npy": data})


def overlapping(path):
    """The table of contents names the same bytes many times."""
    with zipfile.ZipFile(path, "a") as archive:
        info = archive.getinfo("static/sh.npy")
        for number in range(300):
            twin = zipfile.ZipInfo(f"twin{number}.npy")
            for slot in ("CRC", "compress_size", "file_size", "header_offset", "external_attr"):
                setattr(twin, slot, getattr(info, slot))
            archive.filelist.append(twin)
            archive.NameToInfo[twin.filename] = twin
        archive._didModify = True


PICKLED = np.array([{"a": 1}], object)
HOSTILE = {
    "not a whole scene file": lambda path: path.write_bytes(b"PK\x05\x06 nothing"),
    "without scene.json": lambda path: rewritten(path, members={"scene.json": None}),
    "format 'f4x'": with_header(format="glb"),
    "newer version of Feature4X": with_header(version=VERSION + 1),
    "no valid version": with_header(version="1"),
    "lacks a valid 'edits'": with_header(edits={}),
    "lacks a valid 'next_id'": with_header(next_id=1.5),
    "lacks a valid 'metrics'": without("metrics"),
    "lacks a valid 'arrays'": with_header(arrays={"a": {"shape": [-1], "dtype": "<f4", "sha256": ""}}),
    "'size' is not": with_header(size=[10, 10**9]),
    "'edits' is not a list of objects": with_header(edits=[1]),
    "'held_out' is not": with_header(held_out=["x"]),
    "held_out names a frame": with_header(held_out=[77]),
    "'scaffold_unit'": without("scaffold_unit"),
    "too large|not a whole": with_header(fps=10**400),
    "NaN is not JSON": with_header(fps=float("nan")),
    "static/xyz is missing": lambda path: rewritten(path, lambda header: header["arrays"].pop("static/xyz")),
    "array static/xyz is missing": lambda path: rewritten(path, members={"static/xyz.npy": None}),
    "is damaged": lambda path: rewritten(path, members={"static/xyz.npy": npy(BASE.static.means + 1)}),
    "no cameras": lambda path: rewritten(
        path, lambda header: [header["arrays"].pop(f"cameras/{n}") for n in ("intrinsics", "world_to_camera", "times")]
    ),
    "as many numbers|shape": huge_shape,
    "plain little-endian": with_array("static/xyz", BASE.static.means.astype(">f4")),
    "C-order": with_array("static/xyz", np.asfortranarray(BASE.static.means)),
    "not a plain": with_array("odd", PICKLED, allow_pickle=True),
    "static/xyz has the shape": with_array("static/xyz", BASE.static.means[:, :2]),
    "scaffold/xyz has the shape": with_array("scaffold/xyz", BASE.scaffold.xyz[0]),
    "cameras/times has the shape": with_array("cameras/times", np.zeros((), np.float64)),
    "dynamic/node must be an array of int32": with_array("dynamic/node", BASE.dynamic.node.astype(np.float32)),
    "static/opacity holds NaN": with_array("static/opacity", np.full(6, np.nan, np.float32)),
    "ids occur twice": with_array("dynamic/ids", np.arange(4)),
    "unsafe name": lambda path: rewritten(path, members={"../evil.npy": b"x"}),
    "unsafe name '/": lambda path: rewritten(path, members={"/etc/evil": b"x"}),
    "is compressed": lambda path: rewritten(path, compress=zipfile.ZIP_DEFLATED),
    "claim more bytes": overlapping,
    "too many members": lambda path: rewritten(path, members={f"m{i}": b"" for i in range(1100)}),
    "nested deeper than 100": lambda path: rewritten(path, members={"scene.json": b"[" * 200_000}),
    "codec": lambda path: rewritten(path, members={"scene.json": b"\xff\xfe{}"}),
}


HELD = np.tile(np.int32([3, len(RESTING.scaffold.times) - 3]), len(RESTING.scaffold))
HOSTILE_RUNS = [
    ("does not fill", with_array("scaffold/held", HELD + np.int32(1))),
    ("does not fill", with_array("scaffold/held", HELD.reshape(-1, 2))),
    ("does not fill", with_array("scaffold/held", HELD.astype(np.int64))),
    ("does not fill", with_array("scaffold/held", HELD[:0])),
    ("does not fill", with_array("scaffold/held", HELD + np.tile(np.int32([-3, 3]), len(HELD) // 2))),  # a run of 0
    ("does not fill", with_array("scaffold/held", HELD + np.int32([0, 1, -1, *HELD[3:] * 0]))),  # one over two nodes
    ("expected float32", with_array("scaffold/xyz", np.zeros((len(HELD) - 1, 3), np.float32))),
    ("expected float32", with_array("scaffold/quat", np.zeros((len(HELD), 4000), np.float32))),
    ("expected bool", with_array("scaffold/certain", np.zeros(len(HELD), np.int64))),
    ("without the arrays", without_array("scaffold/quat")),
    ("without the arrays", with_array("scaffold/times", np.zeros((), np.float64))),
]


@pytest.mark.parametrize(("words", "change"), HOSTILE_RUNS)
def test_hostile_runs_give_one_sentence(path, words, change):
    write_scene(RESTING, path)
    change(path)
    with pytest.raises(F4xError, match=words) as caught:
        read_scene(path)
    assert str(caught.value).startswith(str(path)) and str(caught.value).count(str(path)) == 1


@pytest.mark.parametrize("words", HOSTILE)
def test_hostile_file_gives_one_sentence(path, words):
    HOSTILE[words](path)
    with pytest.raises(F4xError, match=words) as caught:
        read_scene(path)
    assert str(caught.value).startswith(str(path)) and str(caught.value).count(str(path)) == 1


def test_unknown_members_are_ignored_and_unknown_entries_kept(path):
    extra = npy(np.arange(3))
    row = {"shape": [3], "dtype": "<i8", "sha256": hashlib.sha256(extra).hexdigest()}

    def change(header):
        header["arrays"]["future/thing"] = row
        header["mood"] = "good"

    rewritten(path, change, {"future/thing.npy": extra, "thumbnail.png": b"\x89PNG"})
    scene = read_scene(path)
    np.testing.assert_array_equal(scene.extra["future/thing"], [0, 1, 2])
    assert scene.extra_fields == {"mood": "good"}


def check_damaged(path, data):
    """The damaged file either raises F4xError or holds exactly what it held; both doors."""
    path.write_bytes(data)
    try:
        scene = read_scene(path)
    except F4xError as error:
        assert str(error).startswith(str(path))
        return False
    assert_same(scene, BASE)
    return True


@settings(max_examples=150, deadline=2000, derandomize=True)
@given(share=st.floats(0, 1, exclude_max=True))
def test_truncated_anywhere(whole, share):
    data, path = whole
    assert not check_damaged(path, data[: int(len(data) * share)])


@settings(max_examples=400, deadline=2000, derandomize=True)
@given(places=st.lists(st.tuples(st.floats(0, 1, exclude_max=True), st.integers(0, 7)), min_size=1, max_size=3))
def test_flipped_bits(whole, places):
    data, path = whole
    damaged = bytearray(data)
    for share, bit in places:
        damaged[int(len(data) * share)] ^= 1 << bit
    check_damaged(path, bytes(damaged))


@settings(max_examples=300, deadline=2000, derandomize=True)
@given(share=st.floats(0, 1, exclude_max=True), value=st.integers(0, 255))
def test_overwritten_bytes_in_the_table_of_contents(whole, share, value):
    data, path = whole
    start = data.index(b"PK\x01\x02")
    damaged = bytearray(data)
    damaged[start + int((len(data) - start) * share)] = value
    check_damaged(path, bytes(damaged))


JSON = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=5),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.text(max_size=5), inner, max_size=3),
    max_leaves=6,
)
FIELDS = (
    *("format", "version", "arrays", "name", "size", "fps", "held_out", "next_id"),
    *("needs", "metrics", "provenance", "edits", "scaffold_unit"),
)


@settings(max_examples=200, deadline=2000, derandomize=True)
@given(field=st.sampled_from(FIELDS), value=JSON)
def test_any_json_in_any_field(whole, field, value):
    data, path = whole
    path.write_bytes(data)
    rewritten(path, lambda header: header.update({field: value}))
    try:
        read_scene(path)
    except F4xError as error:
        assert str(error).startswith(str(path))


@settings(max_examples=100, deadline=2000, derandomize=True)
@given(
    name=st.sampled_from(sorted(arrays_of(BASE))), shape=st.lists(st.integers(0, 4), max_size=4), seed=st.integers(0, 9)
)
def test_any_array_in_any_place(whole, name, shape, seed):
    data, path = whole
    path.write_bytes(data)
    rng = np.random.default_rng(seed)
    kind = rng.choice(["<f4", "<f8", "<i8", "<i4", "|b1", "|u1", "<c8", "<U3", "<M8[s]"])
    with_array(name, (rng.normal(size=shape) * 100).astype(kind))(path)
    try:
        read_scene(path)
    except F4xError as error:
        assert str(error).startswith(str(path))


def test_header_alone(path):
    assert read_header(path)["name"] == "random scene"
