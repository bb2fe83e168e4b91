"""Damaged and lying files cost what their size allows and end in a scene or in one sentence, whatever reads them."""

import base64
import gzip
import io
import json
import re
import struct
import time
import zipfile
import zlib

import numpy as np
import pytest
import torch
from hostile import BYTES, KINDS, SECONDS, Outcome, try_all, try_one
from PIL import Image
from random_scene import random_scene

from f4x_core.clip import read_clip
from f4x_core.clip.images import read_color
from f4x_core.edit.operations import read_operation
from f4x_core.edit.stack import Edit, read_stack
from f4x_core.errors import F4xError
from f4x_core.fit.checkpoint import load_checkpoint
from f4x_core.scene import write_scene
from f4x_core.scene.file import _scene_arrays
from f4x_core.scene.formats.spz import HEADER, MAGIC
from f4x_core.scene.runs import HELD, OF_POSES, unfold
from f4x_core.windows.resuming import PLAN, require_same

SHORT, LONG = 6, 75
"""Damaged copies of each kind of file: every day, and in the long form."""


def complaint(outcome: Outcome) -> str:
    """One line of what is wrong with an outcome; empty where nothing is."""
    where = f"{outcome.name} {outcome.number}: "
    if outcome.trouble:
        return where + outcome.trouble
    if outcome.seconds > SECONDS or outcome.memory > BYTES:
        return f"{where}{outcome.seconds:.1f} s, {outcome.memory >> 20} MiB"
    return ""


@pytest.mark.parametrize("name", KINDS)
def test_the_valid_file_is_read(tmp_path, name):
    outcome = try_one(name, 0, KINDS[name].make(tmp_path))
    assert not outcome.trouble and not outcome.refused, outcome


@pytest.mark.parametrize("count", [SHORT, pytest.param(LONG, marks=pytest.mark.slow)])
def test_damaged_files_are_read_or_refused_in_one_sentence(tmp_path, count):
    outcomes = try_all(tmp_path, [(name, number) for name in KINDS for number in range(count)])
    worst = max(outcomes, key=lambda outcome: outcome.memory)
    slowest = max(outcomes, key=lambda outcome: outcome.seconds)
    print(f"{len(outcomes)} files, {sum(bool(outcome.refused) for outcome in outcomes)} refused")
    print(f"at most {worst.memory >> 20} MiB ({worst.name}), {slowest.seconds:.1f} s ({slowest.name})")
    assert [text for text in map(complaint, outcomes) if text] == []


# ---------------------------------------------------------------------------------------------------------------- bombs


def spz_of_few_bytes(path):
    count = 10_000_000
    header = np.array([(MAGIC, 3, count, (0, 12, 0, 0))], HEADER).tobytes()
    squeeze = zlib.compressobj(9, zlib.DEFLATED, 31)
    zeros = bytes(count)
    path.write_bytes(
        b"".join([squeeze.compress(header), *(squeeze.compress(zeros) for _ in range(20)), squeeze.flush()])
    )


def gzip_of_nothing(path):
    path.write_bytes(gzip.compress(bytes(100 << 20), 1))


def used_often(places):
    def make(path):
        whole = KINDS["gltf"].make(path.parent)
        document = json.loads(whole.read_text())
        primitives = document["meshes"][0]["primitives"]
        if places == "primitives":
            primitives *= 20_000
        else:
            document["nodes"] *= 20_000
            document["scenes"][0]["nodes"] = list(range(20_000))
        path.write_text(json.dumps(document))

    return make


def gltf_with(change):
    def make(path):
        document = json.loads(KINDS["gltf"].make(path.parent).read_text())
        change(document)
        path.write_text(json.dumps(document))

    return make


def many_nodes(document):
    document["nodes"] = [{"children": [number + 1]} for number in range(300_000)] + document["nodes"]


def many_parts(document):
    document["meshes"][0]["primitives"] *= 1_000
    document["nodes"] *= 1_000
    document["scenes"][0]["nodes"] = list(range(1_000))


def long_kernel(document):
    document["meshes"][0]["primitives"][0]["extensions"]["KHR_gaussian_splatting"]["kernel"] = "k\u202e" * 500_000


def unknown_need(document):
    document["extensionsRequired"] = ["VENDOR_secret"]


def text(content):
    return lambda path: path.write_text(content)


def ascii_ply(count, body):
    head = f"ply\nformat ascii 1.0\nelement vertex {count}\nproperty float x\nproperty float y\nend_header\n"
    return text(head + body)


def npz_of_zeros(path):
    with path.open("wb") as file:
        np.savez_compressed(file, depth=np.zeros(40 << 20, bool))


def npy_that_lies(path):
    head = io.BytesIO()
    np.lib.format.write_array_header_1_0(
        head, {"descr": "<f8", "fortran_order": False, "shape": (1_000_000, 1_000_000)}
    )
    path.write_bytes(head.getvalue() + bytes(100))


def npz_that_lies(path):
    npy_that_lies(path)
    data = path.read_bytes()
    with zipfile.ZipFile(path, "w") as archive:
        archive.writestr("depth.npy", data)


def png(width, height, *chunks):
    head = (b"IHDR", struct.pack(">IIBBBBB", width, height, 8, 0, 0, 0, 0))
    parts = [struct.pack(">I", len(d)) + k + d + struct.pack(">I", zlib.crc32(k + d)) for k, d in (head, *chunks)]
    return lambda path: path.write_bytes(b"\x89PNG\r\n\x1a\n" + b"".join(parts))


def png_with_a_long_chunk(path):
    png(8, 8)(path)
    path.write_bytes(path.read_bytes() + struct.pack(">I", 2**31 - 1) + b"IDAT")


DEEP = "[" * 100_000 + "]" * 100_000
BOMBS = {
    ("spz", "claim to hold 200,000,000"): spz_of_few_bytes,
    ("spz", "holds no SPZ splats"): gzip_of_nothing,
    ("gltf", "its nodes place 640,000 splats"): used_often("primitives"),
    ("glb", "its nodes place 640,000 splats"): used_often("nodes"),
    ("gltf", "it has 300,001 nodes; more than .* is a limit of Feature4X"): gltf_with(many_nodes),
    ("gltf", "its nodes place more than 50,000 parts, a limit"): gltf_with(many_parts),
    ("gltf", r"splats with kernel '(k\?)+k…', of which"): gltf_with(long_kernel),
    ("gltf", "it requires VENDOR_secret, which is not read"): gltf_with(unknown_need),
    ("gltf", "nested deeper than 100"): text('{"KHR_gaussian_splatting": ' + DEEP + "}"),
    ("cameras", "nested deeper than 100"): text(DEEP),
    ("selection", "nested deeper than 100"): text("[" * 900 + "]" * 900),
    ("manifest json", "nested deeper than 100"): text(DEEP),
    ("priors head", "nested deeper than 100"): text(DEEP),
    ("feature spec", "nested deeper than 100"): text(DEEP),
    ("operations", "more than 2,097,152 lists and objects"): text("[" + "{}," * 3_000_000 + "{}]"),
    ("ascii ply", "promises 1 splats of 2 numbers and holds 1"): ascii_ply(1, "1" * 10_000_000),
    ("ascii ply", "promises 2000000 splats"): ascii_ply(2_000_000, "1 " * 4_000_000),
    ("prior npz", "claim to hold"): npz_of_zeros,
    ("prior npz", "its header says"): npz_that_lies,
    ("prior npy", "its header says"): npy_that_lies,
    ("prior png", "claim 30000x30000 pixels; .* is a limit of Feature4X"): png(30_000, 30_000),
    ("prior png", "a part of it reaches beyond its end"): png_with_a_long_chunk,
    ("mask", "a part of it reaches beyond its end"): png_with_a_long_chunk,
    ("mask", "claim 30000x30000 pixels"): png(30_000, 30_000),
}
"""(what reads it, words of the sentence) -> what writes it."""


@pytest.mark.parametrize("bomb", BOMBS, ids=" ".join)
def test_a_bomb_is_refused_before_it_goes_off(tmp_path, bomb):
    name, words = bomb
    path = KINDS[name].make(tmp_path)
    BOMBS[bomb](path)
    outcome = try_one(name, 0, path)
    assert not outcome.trouble and re.search(words, outcome.refused), outcome
    assert outcome.seconds < 3 and outcome.memory < 200 << 20 and len(outcome.refused) < 600, outcome


def test_a_long_message_keeps_its_start_and_its_end():
    message = str(F4xError(f"a.ply: {'x' * 1_000_000}; export it again"))
    assert len(message) < 2100 and message.startswith("a.ply: x") and message.endswith("; export it again")


WEBP = base64.b64decode(
    "UklGRoAAAABXRUJQVlA4WAoAAAACAAAA/j8Anw8AQU5JTQYAAAAAAAAAAABBTk1GJgAAAAAAAAAAAP4/AJ8PAAAAAAJWUDhMDgAA"
    "AC/+/+cDBxAR/Q9ERP8DQU5NRiYAAAAAAAAAAAD+PwCfDwAAAAAAVlA4TA4AAAAv/v/nAwcQGf0PRET/Aw=="
)
"""An animation of two frames of 16383x4000 pixels, each of one colour."""


def test_an_animation_of_huge_frames_is_refused_by_its_header(tmp_path):
    (tmp_path / "a.webp").write_bytes(WEBP)
    before = time.process_time()
    with pytest.raises(F4xError, match=r"a\.webp .*claim 2 frames of 16383x4000 pixels.* is a limit of Feature4X"):
        read_clip(tmp_path / "a.webp")
    assert time.process_time() - before < 3


def test_a_tiff_of_too_many_pixels_is_not_tried_by_another_decoder(tmp_path, monkeypatch):
    Image.fromarray(np.zeros((40, 60), np.uint16)).save(tmp_path / "a.tif")
    monkeypatch.setattr("f4x_core.reading.FREE_PIXELS", 1)
    monkeypatch.setattr("f4x_core.reading.MAX_INFLATION", 1)
    with pytest.raises(F4xError, match="claim 60x40 pixels"):
        read_color(tmp_path / "a.tif")


def test_time_is_linear_in_what_a_table_holds(tmp_path):
    path = KINDS["manifest csv"].make(tmp_path)
    path.write_text("clip\n" + "".join(f"clip{number}.mp4\n" for number in range(10_000)))
    assert try_one("manifest csv", 0, path).seconds < 3


# -------------------------------------------------------------------------------------------------------- our own records


def damaged_options(folder):
    (folder / PLAN).parent.mkdir(exist_ok=True)
    (folder / PLAN).write_text(DEEP)
    require_same(folder, {})


def checkpoint_of_a_list(folder):
    torch.save([1, 2], folder / "a.pt")
    load_checkpoint(folder / "a.pt", "")


def undone_without_end(folder):
    edit = Edit(read_operation({"op": "delete", "select": {"by": "moving"}}), 1).to_json()
    scene = random_scene(extra_fields={"undone": [edit | {"id": number} for number in range(1, 20_001)]})
    write_scene(scene, folder / "a.f4x")
    read_stack(folder / "a.f4x")


def runs_without_end(folder):
    """A scene whose nodes rest for a million frames, in a file that says so with few bytes."""
    scene = random_scene(static=3, dynamic=3)
    arrays = _scene_arrays(scene)
    frames = 1 << 20
    held = np.full(len(scene.scaffold.ids), frames, "<i4")
    rows = {name: np.ascontiguousarray(arrays[name][0]) for name in OF_POSES}
    unfold({**arrays, **rows, HELD: held, "scaffold/times": np.arange(frames, dtype="<i1")})


def provenance_of_another_type(folder):
    write_scene(random_scene(provenance={"baked": ["recolour"]}), folder / "a.f4x")


@pytest.mark.parametrize(
    ("read", "words"),
    [
        (damaged_options, "plan.json: damaged .*nested deeper than 100"),
        (checkpoint_of_a_list, "a.pt: the checkpoint is damaged"),
        (undone_without_end, "20000 undone edits; 200 are the most"),
        (runs_without_end, "64 times its bytes, is a limit of Feature4X"),
        (provenance_of_another_type, "'baked' is not a list of objects"),
    ],
)
def test_a_record_of_our_own_that_is_damaged_is_one_sentence(tmp_path, read, words):
    with pytest.raises(F4xError, match=words):
        read(tmp_path)
