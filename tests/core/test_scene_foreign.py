"""Splats as other people have them: far from the origin, with outliers, activated, in checkpoints, compressed, empty."""

import base64
import gzip
import json
import re
from dataclasses import replace

import numpy as np
import pytest
from random_scene import random_scene

from f4x_core.cli import main
from f4x_core.errors import F4xError
from f4x_core.geometry.camera import CameraPath
from f4x_core.scene import read_scene, write_scene
from f4x_core.scene.foreign import notes_of, open_any
from f4x_core.scene.formats import export
from f4x_core.scene.formats.spz import pack_spz, read_spz
from f4x_core.scene.formats.web import write_page
from f4x_core.scene.ply import export_frame, read_properties, write_properties

UTM = np.array([500000.25, 4649776.5, 120.125])
"""Metres, as georeferenced files have them."""


def plain_ply(path, **options):
    export_frame(random_scene(**options), 1.0, path)
    return read_properties(path)


def write_columns(path, vertices, doubles=False, **columns):
    """The vertices with other columns, those of positions as doubles where asked for."""
    names = vertices.dtype.names
    changed = np.empty(len(vertices), [(n, "<f8" if doubles and n in "xyz" else "<f4") for n in names])
    for name in names:
        changed[name] = columns.get(name, vertices[name])
    write_properties(path, changed)
    return path


def georeferenced(folder, move=UTM):
    vertices = plain_ply(folder / "near.ply")
    moved = {axis: vertices[axis].astype(np.float64) + move[i] for i, axis in enumerate("xyz")}
    return write_columns(folder / "far.ply", vertices, doubles=True, **moved), np.stack(list(moved.values()), 1)


def test_positions_in_metres_of_a_map_stay_apart(tmp_path):
    path, exact = georeferenced(tmp_path)
    scene = open_any(path)
    assert np.abs(scene.static.means).max() < 10 and scene.static.means.dtype == np.float32
    np.testing.assert_allclose(scene.static.means + scene.offset, exact, atol=1e-6)
    assert "from the origin" in notes_of(scene)[0]
    write_scene(scene, tmp_path / "a.f4x")
    assert read_scene(tmp_path / "a.f4x").offset.tolist() == scene.offset.tolist()


@pytest.mark.parametrize("name", ["ply", "gltf"])
def test_they_are_written_where_they_were_and_said(tmp_path, capsys, name):
    path, exact = georeferenced(tmp_path)
    assert main(["export", str(path), "-o", str(tmp_path / f"out.{name}"), "--time", "0"]) == 0
    assert "in there again, in double precision" in capsys.readouterr().out
    again = open_any(tmp_path / f"out.{name}")
    np.testing.assert_allclose(again.static.means + again.offset, exact, atol=1e-6)


def test_usd_moves_them_in_double_precision(tmp_path):
    scene = open_any(georeferenced(tmp_path)[0])
    export(scene, tmp_path / "a.usda", [0.0], "usd")
    moved = re.search(r"double3 xformOp:translate = \((.*)\)", (tmp_path / "a.usda").read_text())
    assert [float(value) for value in moved[1].split(",")] == [scene.offset[0], -scene.offset[1], -scene.offset[2]]


def test_a_format_without_doubles_says_so(tmp_path):
    scene = open_any(georeferenced(tmp_path)[0])
    assert "no double precision" in export(scene, tmp_path / "a.splat", [0.0], "splat").notes[0]
    assert export(random_scene(), tmp_path / "b.splat", [0.0], "splat").notes == ()


def test_files_of_a_sequence_share_one_offset(tmp_path):
    for number in range(3):
        path, exact = georeferenced(tmp_path, UTM + np.array([40 * number, 0, 0]))
        path.rename(tmp_path / f"walk_{number:04d}.ply")
    (tmp_path / "near.ply").unlink()
    sequence = open_any(tmp_path)
    np.testing.assert_allclose(sequence.posed(2).means + sequence.offset, exact, atol=1e-5)
    assert "3 numbered files (walk_0000.ply to walk_0002.ply)" in notes_of(sequence)[0]


def test_a_damaged_offset_is_one_sentence(tmp_path):
    for offset in ([1, 2], "far", [1, 2, float("inf")], [10**400, 0, 0]):
        scene = random_scene(provenance={"import": {"offset": offset}})
        with pytest.raises(F4xError, match="no valid 'offset'"):
            export(scene, tmp_path / "a.ply", [0.0], "ply")


def with_floater(**options):
    scene = random_scene(static=400, dynamic=0, **options)
    scene.static.means[0] = 1e6, 0, 0
    scene.static.opacities[0] = 0.02
    return scene


def test_a_floater_does_not_move_the_others_in_fixed_point(tmp_path):
    scene = with_floater()
    notes = export(scene, tmp_path / "a.spz", [0.0], "spz").notes
    assert len(notes) == 1 and notes[0].startswith("1 far outlier moved to")
    assert np.abs(read_spz(tmp_path / "a.spz").means - scene.static.means)[1:].max() < 1e-3
    notes = write_page(scene, tmp_path / "a.html")
    assert notes[0].startswith("1 far outlier moved to")
    packed = re.search(r'"splats": "([^"]*)"', (tmp_path / "a.html").read_text())[1]
    (tmp_path / "page.spz").write_bytes(base64.b64decode(packed))
    found = read_spz(tmp_path / "page.spz").means * [1, -1, -1]  # the page keeps the scene's axes
    assert np.abs(found - scene.static.means)[1:].max() < 1e-3


def test_splats_far_apart_are_written_in_coarse_steps_that_are_told(tmp_path):
    scene = random_scene(static=400, dynamic=0)
    scene.static.means[200:, 0] += 5e6
    for notes in (export(scene, tmp_path / "a.spz", [0.0], "spz").notes, write_page(scene, tmp_path / "a.html")):
        assert len(notes) == 1 and "places have steps of 1 units" in notes[0]
    assert np.abs(read_spz(tmp_path / "a.spz").means - scene.static.means).max() <= 0.5


def test_large_scenes_are_not_clamped(tmp_path):
    scene = random_scene(static=400, dynamic=0)
    scene.static.means[:] *= 1e5
    scene.static.scales[:] *= 1e5
    assert export(scene, tmp_path / "a.spz", [0.0], "spz").notes == ()


@pytest.mark.parametrize("columns", [("opacity",), ("opacity", "scale")])
def test_activated_numbers_are_read_as_they_are_and_told(tmp_path, columns):
    vertices = plain_ply(tmp_path / "a.ply")
    expected = open_any(tmp_path / "a.ply")
    change = {"opacity": 1 / (1 + np.exp(-vertices["opacity"].astype(float)))} | (
        {f"scale_{i}": np.exp(vertices[f"scale_{i}"]) for i in range(3)} if "scale" in columns else {}
    )
    opened = open_any(write_columns(tmp_path / "b.ply", vertices, **change))
    np.testing.assert_allclose(opened.static.opacities, expected.static.opacities, atol=1e-6)
    np.testing.assert_allclose(opened.static.scales, expected.static.scales, rtol=1e-5)
    assert "activated already" in notes_of(opened)[0] and notes_of(expected) == ()


@pytest.mark.parametrize("opacity", [1.0, 0.5])
def test_opacities_that_are_all_the_same_are_activated_too(tmp_path, opacity):
    vertices = plain_ply(tmp_path / "a.ply")
    opened = open_any(write_columns(tmp_path / "b.ply", vertices, opacity=np.full(len(vertices), opacity)))
    assert (opened.static.opacities == opacity).all() and "opacities are activated already" in notes_of(opened)[0]


@pytest.mark.parametrize(
    "change",
    [
        lambda v: {"opacity": np.zeros(len(v))},  # as a fit begins
        lambda v: (
            {name: v[name] + 8.0 for name in ("scale_0", "scale_1", "scale_2")}
            | {axis: 3000 * v[axis] for axis in "xyz"}
        ),  # millimetres
    ],
)
def test_unusual_logits_and_logarithms_stay_what_they_are(tmp_path, change):
    vertices = plain_ply(tmp_path / "a.ply")
    assert notes_of(open_any(write_columns(tmp_path / "b.ply", vertices, **change(vertices)))) == ()


@pytest.mark.parametrize(
    ("numbers", "words"),
    [
        ((6999, 29999), "numbered 6999, 29999, not evenly or by more than 100.*the last is point_cloud_29999.ply"),
        ((1000, 2000, 3000), "by more than 100"),
        ((1, 2, 4, 5), "numbered 1, 2, 4, 5"),
    ],
)
def test_checkpoints_are_no_animation(tmp_path, numbers, words):
    for number in numbers:
        plain_ply(tmp_path / f"point_cloud_{number:04d}.ply", static=number % 7 + 1, dynamic=0)
    with pytest.raises(F4xError, match=words):
        open_any(tmp_path)
    assert len(open_any(tmp_path / f"point_cloud_{numbers[-1]:04d}.ply").static) == numbers[-1] % 7 + 1


def test_no_splats_of_any_kind_open(tmp_path):
    nothing = random_scene(static=1, dynamic=0).static.take(slice(0, 0))
    (tmp_path / "a.spz").write_bytes(pack_spz(nothing))
    assert len(open_any(tmp_path / "a.spz").static) == 0


@pytest.mark.parametrize("name", ["a.ply", "a.spz", "a.gltf", "a.glb", "a.splat", "a.f4x"])
def test_an_empty_file_is_one_sentence(tmp_path, name):
    (tmp_path / name).write_bytes(b"")
    with pytest.raises(F4xError, match=rf"{name}: empty"):
        open_any(tmp_path / name)


@pytest.mark.parametrize("read", [read_scene, CameraPath.read])
def test_an_empty_file_is_one_sentence_where_one_kind_is_wanted(tmp_path, read):
    (tmp_path / "a").write_bytes(b"")
    with pytest.raises(F4xError, match="/a"):
        read(tmp_path / "a")


# ----------------------------------------------------------------------------------------------------------------- glTF

EXTENSION = "KHR_gaussian_splatting"


@pytest.fixture
def document(tmp_path):
    export(random_scene(degree=1), tmp_path / "whole.gltf", [0.0], "gltf")
    return json.loads((tmp_path / "whole.gltf").read_text())


def primitive_of(document):
    return document["meshes"][0]["primitives"][0]


def compressed(document):
    primitive_of(document)["extensions"][EXTENSION] = {"extensions": {f"{EXTENSION}_compression_spz_2": {}}}


def draft(document):
    primitive = primitive_of(document)
    primitive["attributes"] = {n.replace(f"{EXTENSION}:", "_"): i for n, i in primitive["attributes"].items()}
    primitive["extensions"] = {EXTENSION: {}}


def older(document):
    document["extensionsUsed"] = ["KHR_spz_gaussian_splats_compression"]
    primitive_of(document)["extensions"] = {"KHR_spz_gaussian_splats_compression": {"bufferView": 0}}


def elsewhere(document):
    document["buffers"][0]["uri"] = "https://example.org/a.bin"


def climbing(document):
    document["buffers"][0]["uri"] = "data/%2e%2e/%2e%2e/a.bin"


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (compressed, "splats need KHR_gaussian_splatting_compression_spz_2, which is not read"),
        (draft, "an earlier draft of KHR_gaussian_splatting"),
        (older, "KHR_spz_gaussian_splats_compression"),
        (elsewhere, "at https://example.org/a.bin, and nothing is fetched"),
        (climbing, "outside its own folder"),
    ],
)
def test_gltf_that_cannot_be_read_is_told_why(tmp_path, document, change, words):
    change(document)
    (tmp_path / "a.gltf").write_text(json.dumps(document))
    with pytest.raises(F4xError, match=re.escape(words)):
        open_any(tmp_path / "a.gltf")


def test_gltf_with_its_data_in_a_folder_below(tmp_path, document):
    data = base64.b64decode(document["buffers"][0]["uri"].partition(",")[2])
    (tmp_path / "the data").mkdir()
    (tmp_path / "the data" / "splats.bin").write_bytes(data)
    document["buffers"][0]["uri"] = "the%20data/splats.bin"
    (tmp_path / "a.gltf").write_bytes(b"\xef\xbb\xbf" + json.dumps(document).encode())
    np.testing.assert_array_equal(
        open_any(tmp_path / "a.gltf").static.means, open_any(tmp_path / "whole.gltf").static.means
    )


def test_limits_of_our_own_are_called_so(tmp_path):
    many = bytearray(gzip.decompress(pack_spz(random_scene().static)))
    many[8:12] = (10_000_001).to_bytes(4, "little")
    (tmp_path / "a.spz").write_bytes(gzip.compress(bytes(many)))
    with pytest.raises(F4xError, match="10,000,001 splats; more than 10,000,000 is a limit of Feature4X"):
        open_any(tmp_path / "a.spz")


def test_a_splat_file_whose_first_byte_is_a_brace_is_no_json(tmp_path):
    scene = random_scene(dynamic=0)
    means = scene.static.means.copy()
    means[:, 0] = np.frombuffer(b"{\x00\x00?", "<f4")[0]
    scene = replace(scene, static=replace(scene.static, means=means))
    export(scene, tmp_path / "a.splat", [0.0], "splat")
    assert (tmp_path / "a.splat").read_bytes()[:1] == b"{"
    assert len(open_any(tmp_path / "a.splat").ids) == len(scene.ids)
