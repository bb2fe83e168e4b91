"""Export formats, each read back by a reader that is not ours, and opening whatever file comes along."""

import base64
import dataclasses
import gzip
import json
import shutil
import struct
import sys
import zipfile
from itertools import pairwise

import numpy as np
import pytest
import trimesh
from hypothesis import given, settings
from hypothesis import strategies as st
from PIL import Image
from random_scene import assert_same, random_scene

from benchmarks.speed import batch_stub as stub
from f4x_core.batch.graph import tasks_of
from f4x_core.batch.manifest import Row
from f4x_core.cli import main
from f4x_core.errors import F4xError
from f4x_core.geometry import quaternion, spherical_harmonics
from f4x_core.geometry.camera import Camera
from f4x_core.geometry.splats import Splats
from f4x_core.raster import rasterize
from f4x_core.scene import Scene, write_scene
from f4x_core.scene.color import linear_from_srgb
from f4x_core.scene.foreign import SplatSequence, open_any
from f4x_core.scene.formats import FORMATS, choose_format, export
from f4x_core.scene.formats.splat import read_splat
from f4x_core.scene.formats.usd import TURNS, _array, _characters, _shortest_turns, _turned, expected_bytes
from f4x_core.scene.linear import footprint, narrowed
from f4x_core.scene.ply import export_frame, read_ply, read_properties, write_ply, write_properties
from f4x_core.scene.posing import Y_UP, plain_color, similarity_of, transformed, world_harmonics
from f4x_core.scene.recognise import identify
from f4x_core.scene.view import render

TIME = 2.5
TURN = quaternion.from_rotation_vector(np.array([0.4, -1.1, 0.7]))
SIMILARITY = np.eye(4)
SIMILARITY[:3, :3] = 1.7 * quaternion.to_matrix(TURN)
SIMILARITY[:3, 3] = 0.3, -0.2, 0.5


def seen_from(camera, matrix):
    """The camera that sees a world moved by the similarity `matrix` as it was seen before."""
    move = similarity_of(matrix)
    moved = np.eye(4)
    moved[:3, :3], moved[:3, 3] = quaternion.to_matrix(move.rotation), move.translation
    local = camera.world_to_camera.copy()
    local[:3, 3] *= move.scale
    return Camera(camera.intrinsics, local @ np.linalg.inv(moved), camera.width, camera.height)


def draw(camera, xyz, rotation, scale, opacity, sh):
    """What any viewer shows: harmonics (N,S,3) at the world direction, wxyz, linear scale, opacity in [0, 1]."""
    color = spherical_harmonics.evaluate(np.asarray(sh, float), np.asarray(xyz, float) - camera.center)
    *shape, color = (np.asarray(values, np.float64) for values in (xyz, rotation, scale, opacity, color))
    out = rasterize(Splats(*shape), color, camera, backend="reference")
    return np.asarray(out.channels)


def same_picture(scene, time, matrix, *gaussians, error=1e-4):
    """Whether Gaussians read from a file, in the world moved by `matrix`, look as the scene does."""
    expected = render(scene, scene.cameras[2], time, ("rgb",), backend="reference")["rgb"]
    assert expected.std() > 0.05
    off = np.abs(draw(seen_from(scene.cameras[2], matrix), *gaussians) - expected)
    assert off.mean() < error / 10
    assert off.max() < error + 1 / 255  # a Gaussian is cut off where its alpha falls below 1/255


def without_footprint(scene, time, gaussians, scale):
    """Gaussians read from a file for programs without a footprint, with it taken out of their scales; `scale` of the file."""
    means, quats, scales, *others = gaussians
    there = scene.posed(time).opacities > 0
    return means, quats, narrowed(np.asarray(scales), scale * footprint(scene)[there]), *others


# ----------------------------------------------------------------------------------------------------------- transforms


def test_a_similarity_changes_nothing_but_the_place():
    scene = random_scene(degree=3)
    posed = transformed(scene.posed(TIME), SIMILARITY)
    sh = spherical_harmonics.rotate(posed.sh, posed.quats)
    same_picture(scene, TIME, SIMILARITY, posed.means, posed.quats, posed.scales, posed.opacities, sh)


@pytest.mark.parametrize(
    "matrix", [np.diag([1, 1, 2, 1]), np.diag([-1, 1, 1, 1]), np.eye(3), np.full((4, 4), np.nan), np.zeros((4, 4))]
)
def test_what_gaussians_cannot_follow_is_refused(matrix):
    with pytest.raises(F4xError, match="not a move, a turn and one even scale"):
        transformed(random_scene().posed(0), matrix)


# ------------------------------------------------------------------------------------------------------------------ PLY


@pytest.mark.parametrize("degree", [0, 1, 3, 4])
def test_ply_with_a_transform_looks_the_same(tmp_path, degree):
    scene = random_scene(degree=degree)
    export_frame(scene, TIME, tmp_path / "a.ply", SIMILARITY)
    raw = read_properties(tmp_path / "a.ply")
    columns = lambda *names: np.stack([raw[name] for name in names], 1)  # noqa: E731
    count = (degree + 1) ** 2
    sh = np.empty((len(raw), count, 3))
    for channel in range(3):
        sh[:, 0, channel] = raw[f"f_dc_{channel}"]
        for i in range(count - 1):
            sh[:, i + 1, channel] = raw[f"f_rest_{(count - 1) * channel + i}"]
    gaussians = (columns(*"xyz"), columns("rot_0", "rot_1", "rot_2", "rot_3"))
    gaussians += (np.exp(columns("scale_0", "scale_1", "scale_2")), 1 / (1 + np.exp(-raw["opacity"])), sh)
    same_picture(scene, TIME, SIMILARITY, *gaussians)


def test_ply_in_trimesh(tmp_path):
    scene = random_scene()
    export_frame(scene, TIME, tmp_path / "a.ply")
    np.testing.assert_array_equal(trimesh.load(tmp_path / "a.ply").vertices, scene.posed(TIME).means)


def test_sequence_names_progress_and_deleted_gaussians(tmp_path):
    scene, calls = random_scene(), []
    scene.dynamic.opacities[:3] = 0  # what an edit deletes stays as a row
    times = scene.cameras.times
    paths = export(scene, tmp_path / "out", times, progress=lambda *args: calls.append(args)).files
    assert [path.name for path in paths] == [f"random_scene_{i:04d}.ply" for i in range(6)]
    np.testing.assert_allclose(
        read_ply(paths[5]).means, np.delete(scene.posed(5.0).means, [30, 31, 32], axis=0), atol=1e-6
    )
    assert calls[-1][:3] == ("export", 6, 6) and len(calls) == 7
    assert [path.name for path in export(scene, tmp_path / "s", [0.5], "splat").files] == ["random_scene_0000.splat"]
    names = [path.name for path in export(scene, tmp_path / "some", [1.0, 3.0, 5.0], "splat").files]
    assert names == [f"random_scene_{frame:04d}.splat" for frame in (1, 3, 5)]


def test_a_folder_that_cannot_be_made_is_refused(tmp_path):
    (tmp_path / "taken").write_text("x")
    with pytest.raises(F4xError, match="folder cannot be made"):
        export(random_scene(), tmp_path / "taken", [0.0, 1.0])


# --------------------------------------------------------------------------------------------------------------- .splat


def test_splat_rows(tmp_path):
    """Read by `struct`, as the web viewer does: 3f 3f 4B 4B."""
    scene = random_scene(degree=2)
    export(scene, tmp_path / "a.splat", [TIME], "splat", SIMILARITY)
    rows = list(struct.iter_unpack("<3f3f4B4B", (tmp_path / "a.splat").read_bytes()))
    values = np.array(rows)
    posed = transformed(scene.posed(TIME), SIMILARITY)
    order = np.argsort(-posed.scales.prod(axis=1) * posed.opacities, kind="stable")
    np.testing.assert_array_equal(values[:, :3], posed.means[order])
    np.testing.assert_array_equal(values[:, 3:6], posed.scales[order])
    np.testing.assert_allclose(values[:, 6:9] / 255, plain_color(posed)[order], atol=0.002)
    np.testing.assert_allclose(values[:, 9] / 255, posed.opacities[order], atol=0.002)
    turned = np.abs((quaternion.normalize(values[:, 10:] - 128) * posed.quats[order]).sum(axis=1))
    assert turned.min() > np.cos(np.radians(0.5))


def test_splat_there_and_back(tmp_path):
    scene = random_scene(degree=0)
    export(scene, tmp_path / "a.splat", [TIME], "splat")
    read = read_splat(tmp_path / "a.splat")
    assert all(values.dtype == np.float32 for values in read.arrays().values())
    same_picture(scene, TIME, np.eye(4), *read.arrays().values(), error=0.03)  # 8 bits of colour, opacity and rotation


# ----------------------------------------------------------------------------------------------------------------- glTF


def read_khr(path):
    """Gaussians of a glTF file by the extension's text alone: (xyz, wxyz, scale, opacity, sh), and the document."""
    data = path.read_bytes()
    if path.suffix == ".glb":
        magic, version, length = struct.unpack_from("<4sII", data)
        assert (magic, version, length) == (b"glTF", 2, len(data))
        size, kind = struct.unpack_from("<I4s", data, 12)
        assert kind == b"JSON" and size % 4 == 0
        document = json.loads(data[20 : 20 + size])
        rest, kind = struct.unpack_from("<I4s", data, 20 + size)
        assert kind == b"BIN\0" and rest % 4 == 0
        binary = data[28 + size : 28 + size + rest]
    else:
        document = json.loads(data)
        binary = base64.b64decode(document["buffers"][0]["uri"].partition(",")[2])
    assert document["buffers"][0]["byteLength"] == len(binary)
    (primitive,) = document["meshes"][0]["primitives"]

    def values(semantic):
        accessor = document["accessors"][primitive["attributes"][semantic]]
        view = document["bufferViews"][accessor["bufferView"]]
        assert accessor["componentType"] == 5126 and view["byteOffset"] % 4 == 0
        width = {"SCALAR": 1, "VEC3": 3, "VEC4": 4}[accessor["type"]]
        assert view["byteLength"] == 4 * width * accessor["count"]
        return np.frombuffer(binary, "<f4", accessor["count"] * width, view["byteOffset"]).reshape(-1, width)

    khr = "KHR_gaussian_splatting:"
    names = [name for name in primitive["attributes"] if name.startswith(f"{khr}SH_DEGREE")]
    degree = max(int(name[len(khr) + 10]) for name in names)
    expected = [f"{khr}SH_DEGREE_{d}_COEF_{n}" for d in range(degree + 1) for n in range(2 * d + 1)]
    assert names == expected
    sh = np.stack([values(name) for name in expected], axis=1)
    rotation = values(f"{khr}ROTATION")[:, [3, 0, 1, 2]]
    return (values("POSITION"), rotation, values(f"{khr}SCALE"), values(f"{khr}OPACITY")[:, 0], sh), document


@pytest.mark.parametrize(("name", "degree"), [("a.glb", 0), ("a.glb", 3), ("a.gltf", 1)])
def test_gltf_looks_the_same(tmp_path, name, degree):
    scene = random_scene(degree=degree)
    export(scene, tmp_path / name, [TIME], "gltf", SIMILARITY)
    gaussians, document = read_khr(tmp_path / name)
    read = without_footprint(scene, TIME, gaussians, similarity_of(SIMILARITY).scale)
    same_picture(scene, TIME, Y_UP @ SIMILARITY, *read)
    np.testing.assert_allclose(np.linalg.norm(gaussians[1], axis=1), 1, atol=1e-6)
    primitive = document["meshes"][0]["primitives"][0]
    assert document["extensionsUsed"] == ["KHR_gaussian_splatting"] and primitive["mode"] == 0
    assert primitive["extensions"]["KHR_gaussian_splatting"]["kernel"] == "ellipse"
    assert primitive["extensions"]["KHR_gaussian_splatting"]["colorSpace"] == "srgb_rec709_display"


def test_gltf_leaves_out_what_it_has_no_names_for(tmp_path):
    export(random_scene(degree=4), tmp_path / "a.glb", [TIME], "gltf")
    assert read_khr(tmp_path / "a.glb")[0][4].shape[1] == 16


@pytest.mark.parametrize(("name", "degree"), [("a.glb", 0), ("a.glb", 3), ("a.gltf", 1)])
def test_gltf_there_and_back(tmp_path, name, degree):
    scene = random_scene(degree=degree)
    export(scene, tmp_path / name, [TIME], "gltf", SIMILARITY)
    opened = open_any(tmp_path / name)
    posed = opened.posed(0)
    sh = world_harmonics(posed)
    same_picture(scene, TIME, SIMILARITY, posed.means, posed.quats, posed.scales, posed.opacities, sh)
    assert identify(tmp_path / name) == "gltf" and opened.scaffold is None


def quantised(path):
    """A .gltf as others write it: short rotations, byte scales and opacities, positions with a stride, a file beside it, nodes."""
    kinds = {"<f4": 5126, "<i2": 5122, "u1": 5121}
    attributes = {
        "POSITION": ("VEC3", "<f4", False, [[1, 0, 0, 9], [0, 2, 0, 9]]),  # 9: of another attribute between the rows
        "KHR_gaussian_splatting:ROTATION": ("VEC4", "<i2", True, [[0, 0, 0, 32767], [32767, 0, 0, 0]]),
        "KHR_gaussian_splatting:SCALE": ("VEC3", "u1", False, [[1, 2, 3, 0], [4, 5, 6, 0]]),
        "KHR_gaussian_splatting:OPACITY": ("SCALAR", "u1", True, [[255, 0, 0, 0], [51, 0, 0, 0]]),
        "KHR_gaussian_splatting:SH_DEGREE_0_COEF_0": ("VEC3", "<f4", False, [[0.5, 0.25, 0], [-1, 0, 1]]),
    }
    accessors, views, data = [], [], b""
    for index, (shape, kind, normalized, rows) in enumerate(attributes.values()):
        rows = np.array(rows, kind)
        views.append({"buffer": 0, "byteOffset": len(data), "byteLength": rows.nbytes, "byteStride": rows.strides[0]})
        accessors.append(
            {"bufferView": index, "componentType": kinds[kind], "count": 2, "type": shape, "normalized": normalized}
        )
        data += rows.tobytes()
    extension = {"kernel": "ellipse", "colorSpace": "srgb_rec709_display"}
    names = {name: index for index, name in enumerate(attributes)}
    primitive = {"mode": 0, "attributes": names, "extensions": {"KHR_gaussian_splatting": extension}}
    document = {
        "asset": {"version": "2.0"},
        "accessors": accessors,
        "bufferViews": views,
        "buffers": [{"byteLength": len(data), "uri": "the%20splats.bin"}],
        "meshes": [{"primitives": [primitive]}],
        "nodes": [{"children": [1], "scale": [2, 2, 2]}, {"mesh": 0, "translation": [0, 0, 10]}],
        "scenes": [{"nodes": [0]}],
    }
    (path.parent / "the splats.bin").write_bytes(data)
    path.write_text(json.dumps(document))
    return document, extension


def test_gltf_of_others_with_small_numbers_and_nodes(tmp_path):
    quantised(tmp_path / "a.gltf")
    posed = open_any(tmp_path / "a.gltf").posed(0)
    np.testing.assert_allclose(posed.means, [[2, 0, -20], [0, -4, -20]], atol=1e-6)  # y up, z backward
    np.testing.assert_allclose(posed.scales, [[2, 4, 6], [8, 10, 12]])
    np.testing.assert_allclose(posed.opacities, [1, 0.2])
    np.testing.assert_allclose(np.abs(posed.quats), [[0, 1, 0, 0], [1, 0, 0, 0]], atol=1e-4)
    np.testing.assert_allclose(posed.sh[:, 0], [[0.5, 0.25, 0], [-1, 0, 1]])


@pytest.mark.parametrize(
    ("words", "change"),
    [
        ("kernel 'round', of which only 'ellipse'", lambda document, extension: extension.update(kernel="round")),
        ("colorSpace 'lin_rec709_display'", lambda document, extension: extension.update(colorSpace="lin_rec709_display")),
        ("damaged glTF file", lambda document, extension: extension.pop("kernel")),
        ("need KHR_some_compression", lambda document, extension: extension.update(extensions={"KHR_some_compression": {}})),
        ("compressed or sparse", lambda document, extension: document["accessors"][0].pop("bufferView")),
        ("compressed .EXT_pressed", lambda document, extension: document["bufferViews"][1].update(extensions={"EXT_pressed": {}})),
        ("promises 3 splats", lambda document, extension: document["accessors"][4].update(count=3)),
        ("outside its own folder", lambda document, extension: document["buffers"][0].update(uri="../other.bin")),
        ("cannot be read", lambda document, extension: document["buffers"][0].update(uri="none.bin")),
        ("scales unevenly", lambda document, extension: document["nodes"][0].update(scale=[1, 2, 1])),
        ("glTF file without splats", lambda document, extension: document["nodes"][1].pop("mesh")),
        ("damaged glTF file", lambda document, extension: document["scenes"][0].update(nodes=[7])),
    ],
)  # fmt: skip
def test_gltf_that_is_not_read_is_said(tmp_path, words, change):
    path = tmp_path / "a.gltf"
    document, extension = quantised(path)
    change(document, extension)
    path.write_text(json.dumps(document))
    with pytest.raises(F4xError, match=words) as caught:
        open_any(path)
    assert str(caught.value).startswith(str(path)) and "\n" not in str(caught.value)


def test_gltf_in_a_viewer_without_splats(tmp_path):
    scene = random_scene(degree=1)
    export(scene, tmp_path / "a.glb", [TIME], "gltf")
    (cloud,) = trimesh.load_scene(tmp_path / "a.glb").geometry.values()
    posed = transformed(scene.posed(TIME), Y_UP)
    np.testing.assert_array_equal(cloud.vertices, posed.means)
    np.testing.assert_allclose(cloud.colors[:, :3], 255 * linear_from_srgb(plain_color(posed)), atol=1.01)
    np.testing.assert_allclose(cloud.colors[:, 3], 255 * posed.opacities, atol=1.01)


def test_points_and_scaffold(tmp_path):
    scene = random_scene()
    export(scene, tmp_path / "a.glb", [3.0], "points", SIMILARITY)
    model = trimesh.load_scene(tmp_path / "a.glb")
    assert {*model.geometry} == {"static", "dynamic", "nodes", "graph"}
    posed = transformed(scene.posed(3.0), Y_UP @ SIMILARITY)
    np.testing.assert_allclose(model.geometry["dynamic"].vertices, posed.means[posed.dynamic], atol=1e-5)
    nodes = trimesh.transform_points(scene.scaffold.xyz[2], Y_UP @ SIMILARITY)  # frame 3 is the third knot
    np.testing.assert_allclose(model.geometry["nodes"].vertices, nodes, atol=1e-5)
    # Each of 5 nodes is joined to the two that follow it around: 10 different pairs.
    assert len(model.geometry["graph"].vertices) == 2 * 10
    export(random_scene(dynamic=0), tmp_path / "b.glb", [0.0], "points")
    assert {*trimesh.load_scene(tmp_path / "b.glb").geometry} == {"static"}


@pytest.mark.parametrize("name", ["gltf", "points", "usd", "usd-points"])
def test_nothing_to_see_is_said(tmp_path, name):
    empty = random_scene(static=0, dynamic=0)
    path = tmp_path / f"a{FORMATS[name].suffixes[0]}"
    with pytest.raises(F4xError, match="nothing is visible"):
        export(empty, path, [0.0], name)
    assert not path.exists()


# ------------------------------------------------------------------------------------------------------------------ USD


@pytest.fixture(scope="session")
def usd():
    """OpenUSD's own reader: a package in its own right, or the one inside Blender."""
    try:
        from pxr import Usd
    except ImportError:
        bpy = pytest.importorskip("bpy")
        bpy.utils.expose_bundled_modules()
        from pxr import Usd
    return Usd


class Prims(list):
    """The prims of a stage that this keeps alive."""

    def __init__(self, usd, path):
        self.stage = usd.Stage.Open(str(path))
        super().__init__(self.stage.GetDefaultPrim().GetChildren())


def usd_gaussians(stage, time):
    """Gaussians of all prims at a time: (xyz, wxyz, scale, opacity, sh)."""
    parts = []
    for prim in stage.GetDefaultPrim().GetChildren():
        assert prim.GetTypeName() == "ParticleField3DGaussianSplat"
        xyz, scale, opacity, sh = (
            np.array(prim.GetAttribute(name).Get(time))
            for name in ("positions", "scales", "opacities", "radiance:sphericalHarmonicsCoefficients")
        )
        rotation = [[q.GetReal(), *q.GetImaginary()] for q in prim.GetAttribute("orientations").Get(time)]
        degree = prim.GetAttribute("radiance:sphericalHarmonicsDegree").Get()
        coefficients = prim.GetAttribute("radiance:sphericalHarmonicsCoefficients")
        assert coefficients.GetMetadata("elementSize") == (degree + 1) ** 2
        assert coefficients.GetMetadata("interpolation") == "vertex"
        low, high = prim.GetAttribute("extent").Get()
        assert (xyz > low).all() and (xyz < high).all()
        parts.append((xyz, rotation, scale, opacity, sh.reshape(len(xyz), -1, 3)))
    return [np.concatenate(columns) for columns in zip(*parts, strict=True)]


@pytest.mark.blender
@pytest.mark.parametrize("degree", [0, 3])
def test_usd_looks_the_same_at_every_time(tmp_path, usd, degree):
    scene = random_scene(degree=degree)
    times = [0.0, 1.0, TIME]
    export(scene, tmp_path / "a.usda", times, "usd", SIMILARITY)
    stage = usd.Stage.Open(str(tmp_path / "a.usda"))
    for time in times:
        # rounded numbers: on average a sixteenth of a step of 8 bits
        read = without_footprint(scene, time, usd_gaussians(stage, time), similarity_of(SIMILARITY).scale)
        same_picture(scene, time, Y_UP @ SIMILARITY, *read, error=2.5e-3)
    assert (stage.GetStartTimeCode(), stage.GetEndTimeCode(), stage.GetFramesPerSecond()) == (0, TIME, 24)
    static, dynamic = stage.GetDefaultPrim().GetChildren()
    assert (static.GetName(), dynamic.GetName()) == ("static", "dynamic")
    sampled = {a.GetName() for prim in (static, dynamic) for a in prim.GetAttributes() if a.GetNumTimeSamples()}
    turning = {"radiance:sphericalHarmonicsCoefficients"} if degree else set()
    assert sampled == {"positions", "orientations"} | turning
    assert dynamic.GetAttribute("positions").GetTimeSamples() == times


@pytest.mark.blender
@pytest.mark.parametrize("degree", [0, 2])
def test_the_size_of_a_usd_file_is_expected(tmp_path, degree):
    scene, times = random_scene(degree=degree), np.arange(6.0)
    export(scene, tmp_path / "a.usda", times, "usd")
    expected = expected_bytes(len(scene.static), len(scene.dynamic), len(times), (degree + 1) ** 2)
    assert 0.6 < (tmp_path / "a.usda").stat().st_size / expected < 1.4


def test_usd_keeps_quaternions_on_one_hemisphere(tmp_path, usd):
    """Readers interpolate between samples."""
    export(random_scene(degree=0), tmp_path / "a.usda", np.arange(6.0), "usd")
    prims = Prims(usd, tmp_path / "a.usda")
    dynamic = prims[1]
    samples = [
        np.array([[q.GetReal(), *q.GetImaginary()] for q in dynamic.GetAttribute("orientations").Get(time)])
        for time in range(6)
    ]
    assert all(((a * b).sum(axis=1) > 0).all() for a, b in pairwise(samples))


@pytest.mark.parametrize("turn", range(len(TURNS)))
def test_axes_that_are_turned_describe_the_same_gaussians(turn):
    posed = random_scene(degree=2).posed(0.0)
    turned = _turned(posed, np.full(len(posed.quats), turn))
    shapes, harmonics = zip(*((covariances(one), world_harmonics(one)) for one in (posed, turned)), strict=True)
    np.testing.assert_allclose(shapes[1], shapes[0], rtol=0, atol=1e-6 * np.abs(shapes[0]).max())
    np.testing.assert_allclose(harmonics[1], harmonics[0], rtol=0, atol=2e-5)


def covariances(posed):
    """(N,3,3)"""
    half = quaternion.to_matrix(quaternion.normalize(posed.quats.astype(np.float64))) * posed.scales[:, None]
    return half @ half.transpose(0, 2, 1)


def test_a_quaternion_takes_the_fewest_characters():
    """A half turn about z and some more, told from axes that lie nearer; the text is counted as it is written."""
    quats = quaternion.normalize(np.array([[-0.1, -0.2, 0.05, -0.9], [1.0, 1, 1, 1], [0.6, 0.0, -0.8, 0.0]]))
    turns = _shortest_turns([quats])
    shortest = quaternion.multiply(quats, TURNS[turns])
    assert [len(_array(one, 3).translate(None, b"[(,)]")) for one in shortest[:, None]] == _characters(
        shortest
    ).tolist()
    assert (_characters(shortest) <= _characters(quats) - [3, 4, 0]).all() and (shortest[:2] > -1e-12).all()


@pytest.mark.blender
def test_binary_usd_holds_what_the_text_holds(tmp_path, usd):
    scene = random_scene(static=300, dynamic=300, degree=1)
    for name in ("a.usda", "a.usdc"):
        export(scene, tmp_path / name, [0.0, 1.0], "usd")
    text, binary = (usd.Stage.Open(str(tmp_path / name)) for name in ("a.usda", "a.usdc"))
    assert (tmp_path / "a.usdc").read_bytes()[:8] == b"PXR-USDC"
    for one, other in zip(usd_gaussians(text, 1.0), usd_gaussians(binary, 1.0), strict=True):
        np.testing.assert_array_equal(one, other)
    assert sorted(file.name for file in tmp_path.iterdir()) == ["a.usda", "a.usdc"]


def test_binary_usd_without_its_library_is_one_sentence(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "pxr", None)
    with pytest.raises(F4xError, match="pip install usd-core"):
        export(random_scene(), tmp_path / "a.usdc", [0.0], "usd")
    assert list(tmp_path.iterdir()) == []


class Resting(Scene):
    """As a scene that a retiming edit stops at 2 until 4."""

    def posed(self, time):
        return super().posed(min(time, 2) + max(time - 4, 0))


def test_usd_leaves_out_moments_at_which_nothing_moves(tmp_path, usd):
    """What stays between two samples is the same in both, so that readers interpolate nothing else."""
    base = random_scene(degree=0)
    scene = Resting(**{one.name: getattr(base, one.name) for one in dataclasses.fields(Scene)})
    export(scene, tmp_path / "a.usda", np.arange(8.0), "usd")
    prims = Prims(usd, tmp_path / "a.usda")
    positions = prims[1].GetAttribute("positions")
    assert positions.GetTimeSamples() == [0, 1, 2, 4, 5, 6, 7]
    assert np.array_equal(positions.Get(2), positions.Get(3.5)) and not np.array_equal(
        positions.Get(4), positions.Get(5)
    )


class Fading(Scene):
    """As an edited scene: the first static Gaussian fades in, the second is deleted."""

    def posed(self, time):
        posed = super().posed(time)
        opacities = posed.opacities.copy()
        opacities[:2] = time / 5, 0
        return dataclasses.replace(posed, opacities=opacities)


@pytest.mark.blender
def test_usd_samples_what_an_edit_changes(tmp_path, usd):
    plain = random_scene(dynamic=0, degree=2)
    scene = Fading(**{name: getattr(plain, name) for name in ("name", "static", "cameras")})
    export(scene, tmp_path / "a.usda", [0.0, 5.0], "usd")
    prims = Prims(usd, tmp_path / "a.usda")
    static, dynamic = prims
    assert len(static.GetAttribute("positions").Get()) == 28
    assert [list(dynamic.GetAttribute("opacities").Get(time)) for time in (0, 5)] == [[0.0], [1.0]]
    assert not dynamic.GetAttribute("positions").GetNumTimeSamples()


@pytest.mark.blender
def test_usd_points(tmp_path, usd):
    scene = random_scene(degree=1)
    export(scene, tmp_path / "a.usda", [0.0, 4.0], "usd-points")
    prims = Prims(usd, tmp_path / "a.usda")
    dynamic = prims[1]
    posed = transformed(scene.posed(4.0), Y_UP)
    part = posed.dynamic
    assert dynamic.GetTypeName() == "Points"
    np.testing.assert_allclose(np.array(dynamic.GetAttribute("points").Get(4)), posed.means[part], atol=1e-5)
    color = dynamic.GetAttribute("primvars:displayColor")
    np.testing.assert_allclose(np.array(color.Get()), linear_from_srgb(plain_color(posed))[part], atol=1e-4)
    assert color.GetMetadata("interpolation") == "vertex" and not color.GetNumTimeSamples()
    np.testing.assert_allclose(
        np.array(dynamic.GetAttribute("primvars:displayOpacity").Get()), posed.opacities[part], atol=6e-4
    )
    widths = np.array(dynamic.GetAttribute("widths").Get())
    np.testing.assert_allclose(widths, 2 * np.cbrt(posed.scales[part].prod(axis=1)), rtol=6e-3)


@pytest.mark.blender
def test_a_sequence_of_differing_counts_becomes_one_stage(tmp_path, usd):
    folder = tmp_path / "frames"
    folder.mkdir()
    for index, count in enumerate((4, 7, 5)):
        export_frame(random_scene(index, static=count, dynamic=0), 0.0, folder / f"walk_{index:04d}.ply")
    sequence = open_any(folder)
    export(sequence, tmp_path / "walk.usda", sequence.cameras.times, "usd")
    prims = Prims(usd, tmp_path / "walk.usda")
    (prim,) = prims
    assert [len(prim.GetAttribute("positions").Get(time)) for time in range(3)] == [4, 7, 5]
    assert len(prim.GetAttribute("radiance:sphericalHarmonicsCoefficients").Get(2)) == 20


# ---------------------------------------------------------------------------------------------------------------- names


@pytest.mark.parametrize(
    ("output", "name", "one", "expected"),
    [
        ("a.PLY", None, True, ("ply", True)),
        ("folder", None, False, ("ply", False)),
        ("v1.2", None, False, ("ply", False)),
        ("a.glb", None, True, ("gltf", True)),
        ("a.glb", "points", True, ("points", True)),
        ("a.usda", None, False, ("usd", True)),
        ("a.usda", None, True, ("usd", True)),
        ("folder", "splat", False, ("splat", False)),
    ],
)
def test_the_ending_tells_the_format(output, name, one, expected):
    assert choose_format(output, name, one) == expected


@pytest.mark.parametrize(
    ("output", "name", "one", "words"),
    [
        ("a.obj", None, True, "no export to .obj; end it in .glb, .gltf, .ply, .splat, .spz, .usda, .usdc"),
        ("a.ply", None, False, "FILE.ply together with --time"),
        ("folder", None, True, "FILE.ply together with --time"),
        ("folder", "usd", False, "one file; give FILE.usda"),
        ("a.ply", "sog", True, "no export format 'sog'; choose from ply, splat, spz, gltf, usd, points, usd-points"),
    ],
)
def test_what_does_not_go_together_is_said(output, name, one, words):
    with pytest.raises(F4xError, match=words):
        choose_format(output, name, one)


def test_one_file_for_many_moments_is_refused(tmp_path):
    with pytest.raises(F4xError, match="one moment a file"):
        export(random_scene(), tmp_path / "a.splat", [0.0, 1.0], "splat")


def test_command_line(tmp_path, capsys):
    write_scene(random_scene(), tmp_path / "a.f4x")

    def run(*arguments):
        code = main(["export", *map(str, arguments), "--json"])
        return code, json.loads(capsys.readouterr().out)

    source, out = tmp_path / "a.f4x", tmp_path / "out"
    assert run(source, "-o", out, "--frames", "1::2")[1]["files"] == 3
    code, result = run(source, "-o", tmp_path / "a.usda", "--frames", "0:4")
    assert code == 0 and result["format"] == "usd" and result["frames"] == 4 and result["files"] == 1
    assert run(source, "-o", tmp_path / "p.glb", "--time", 2.5, "--format", "points")[0] == 0
    # and what was written is opened again
    assert run(out, "-o", tmp_path / "b.usda", "--format", "usd-points")[1]["frames"] == 3
    assert run(out / "random_scene_0001.ply", "-o", tmp_path / "c.splat", "--time", 1)[0] == 0
    code, result = run(source, "-o", out, "--frames", "4:9")
    assert code == 2 and "has frames 0:6" in result["error"]
    code, result = run(source, "-o", out, "--frames", "1:3", "--time", 1)
    assert code == 2 and "not allowed with" in result["error"]
    code, result = run(source, "-o", tmp_path / "a.obj")
    assert code == 2 and "no export to .obj" in result["error"]


@pytest.mark.parametrize("name", FORMATS)
def test_what_a_batch_asks_for_lies_where_its_stand_in_leaves_it(tmp_path, monkeypatch, capsys, name):
    """The batch's own command, in a folder that holds the scene alone, as a task's does."""
    command = tasks_of(Row("shot.mp4", "shot", exports=(name,)), lambda path: "")[-1].commands[0]
    left = []
    for verb in (main, stub.main):
        folder = tmp_path / verb.__module__
        folder.mkdir()
        write_scene(random_scene(), folder / "scene.f4x")
        monkeypatch.chdir(folder)
        assert verb([*command, "--progress-json"]) == 0
        files = (path.relative_to(folder) for path in folder.glob("export/**/*") if path.is_file())
        left.append({path if FORMATS[name].write_clip else path.parent for path in files})
    assert left[0] == left[1] and len(left[0]) == 1


# -------------------------------------------------------------------------------------------------------------- opening


def splat_ply(path, **options):
    export_frame(random_scene(**options), 1.0, path)
    return path


def test_a_splat_file_becomes_a_scene_that_stands_still(tmp_path):
    written = random_scene(degree=2)
    scene = open_any(splat_ply(tmp_path / "chair.ply", degree=2))
    assert scene.name == "chair" and len(scene.cameras) == 1 and scene.scaffold is None
    assert scene.static.ids.tolist() == list(range(50))
    np.testing.assert_allclose(scene.posed(0).sh, written.posed(1.0).sh, atol=1e-5)
    pixels, depth = scene.cameras[0].project(scene.static.means.astype(float))
    inside = (depth > 0) & (pixels >= 0).all(axis=1) & (pixels < [960, 540]).all(axis=1)
    assert inside.mean() > 0.9
    assert (pixels.max(axis=0) - pixels.min(axis=0))[1] > 200  # large in the picture
    write_scene(scene, tmp_path / "chair.f4x")
    assert_same(open_any(tmp_path / "chair.f4x"), scene)


def test_a_far_floater_does_not_move_the_camera(tmp_path):
    scene = random_scene(dynamic=0)
    scene.static.means[0] = 1e6
    export_frame(scene, 0.0, tmp_path / "a.ply")
    assert abs(open_any(tmp_path / "a.ply").cameras[0].center).max() < 10


def test_no_splats_open(tmp_path):
    write_ply(tmp_path / "none.ply", read_ply(splat_ply(tmp_path / "a.ply")).take(slice(0, 0)))
    assert len(open_any(tmp_path / "none.ply").static) == 0


def test_a_sequence_opens_by_its_folder_or_one_of_its_files(tmp_path):
    scene = random_scene()
    export(scene, tmp_path / "walk", [0.0, 1.0, 2.0])
    splat_ply(tmp_path / "walk" / "notes.ply")  # has no number
    for path in (tmp_path / "walk", tmp_path / "walk" / "random_scene_0001.ply"):
        sequence = open_any(path)
        assert isinstance(sequence, SplatSequence) and len(sequence) == 3 and sequence.name == "random_scene"
        np.testing.assert_allclose(sequence[2].static.means, scene.posed(2.0).means, atol=1e-6)
        np.testing.assert_array_equal(sequence.posed(1.4).means, sequence[1].static.means)
        assert sequence.cameras.times.tolist() == [0, 1, 2] and sequence.scaffold is None
    assert isinstance(open_any(tmp_path / "walk" / "random_scene_0001.ply", sequence=False), Scene)


def test_numbers_count_by_value_and_short_ones_are_names(tmp_path):
    for number in (10, 12, 8):
        splat_ply(tmp_path / f"f{number}.ply", static=number, dynamic=0)
    assert [len(open_any(tmp_path)[i].static) for i in range(3)] == [8, 10, 12]
    assert identify(tmp_path / "f8.ply") == "ply"


def test_the_name_does_not_matter(tmp_path):
    for name, kind in (("ply", "ply"), ("splat", "splat")):
        export(random_scene(), tmp_path / f"a.{name}", [0.0], name)
        shutil.copy(tmp_path / f"a.{name}", tmp_path / f"{name}.mp4")
        assert identify(tmp_path / f"{name}.mp4") == kind
    write_scene(random_scene(), tmp_path / "b.ply")
    assert identify(tmp_path / "b.ply") == "scene"


def zipped(*names):
    def make(path):
        with zipfile.ZipFile(path, "w") as archive:
            for name in names:
                archive.writestr(name, b"x")

    return make


def folder_of(*names):
    def make(path):
        path.mkdir()
        for name in names:
            (path / name).parent.mkdir(exist_ok=True)
            Image.new("RGB", (4, 4)).save(path / name) if name.endswith("png") else (path / name).write_bytes(b"x")

    return make


def data(content):
    return lambda path: path.write_bytes(content)


def mesh(path):
    path.write_bytes(trimesh.creation.box().export(file_type="ply"))


def not_finite(path):
    raw = read_properties(splat_ply(path))
    raw["x"][3] = np.nan
    write_properties(path, raw)


def splat_with_nan(path):
    export(random_scene(), path.with_suffix(".splat"), [0.0], "splat")
    rows = bytearray(path.with_suffix(".splat").read_bytes())
    rows += rows * 200  # beyond what is probed
    rows[-32:-28] = struct.pack("<f", np.nan)
    path.write_bytes(rows)


HEADER = b"ply\nformat binary_little_endian 1.0\n"
STRANGERS = {
    "no such file": lambda path: None,
    "empty, so not a whole scene": data(b""),
    "a video; make a scene of it with `f4x fit": data(b"\0\0\0\x20ftypisom" + bytes(90)),
    "a video": data(b"\x1a\x45\xdf\xa3" + bytes(90)),
    "one picture": lambda path: Image.new("RGB", (4, 4)).save(path, "PNG"),
    "a folder of pictures; make a scene of it with `f4x fit": folder_of("0.png", "1.png"),
    "a folder of pictures": folder_of("images/0.png"),
    "the folder of a fit; choose .*scene.f4x": folder_of("scene.f4x", "metrics.json"),
    "PLY files of 2 sequences": folder_of("a_0001.ply", "b_0001.ply"),
    "a folder without numbered": folder_of("readme.txt"),
    "a zip of pictures; unpack it": zipped("1.png", "2.png"),
    "a zip without scene.json": zipped("letter.docx"),
    "SOG splats; convert": zipped("meta.json", "means_l.webp"),
    "a USD package": zipped("a.usdc"),
    "not a whole scene file": data(b"PK\x03\x04 but no more"),
    "holds no SPZ splats": data(gzip.compress(bytes(40))),
    "a glTF binary without splats": lambda path: path.write_bytes(trimesh.creation.box().export(file_type="glb")),
    "a USD stage": data(b"#usda 1.0\n"),
    "a Blender file": data(b"BLENDER-v405"),
    "a JSON file": data(b'{"format": "f4x-cameras"}'),
    "neither a scene nor splats": data(bytes(range(256)) * 4),
    "neither a scene nor splats that": data(b"Dear reader,\n" * 9),
    "a plain mesh without splat properties": mesh,
    "a plain point cloud": lambda path: write_properties(path, np.zeros(4, [("x", "<f4"), ("red", "u1")])),
    "1 of 50 splats have no finite means": not_finite,
    "splats have no finite position or scale": splat_with_nan,
    "header is longer than 64 KiB, a limit of Feature4X": data(b"ply\ncomment " + b"x" * 1_000_000),
    "promises 999999999999 splats": data(HEADER + b"element vertex 999999999999\nproperty float x\nend_header\n"),
    "line that cannot be read": data(HEADER + b"element vertex 99999999999999999999\nend_header\n"),
    "truncated": lambda path: path.write_bytes(splat_ply(path).read_bytes()[:-5]),
}


@pytest.mark.parametrize("words", STRANGERS)
def test_every_stranger_gets_one_sentence(tmp_path, words):
    path = tmp_path / "it"
    STRANGERS[words](path)
    with pytest.raises(F4xError, match=words) as caught:
        open_any(path)
    sentence = str(caught.value)
    assert sentence.startswith(str(path)) and "\n" not in sentence and len(sentence) < 300 + len(str(path))


@settings(max_examples=200, deadline=2000, derandomize=True)
@given(head=st.sampled_from([b"", b"ply\n", HEADER, b"PK\x03\x04", b"glTF"]), tail=st.binary(max_size=300))
def test_any_bytes_open_or_are_told(tmp_path_factory, head, tail):
    path = tmp_path_factory.getbasetemp() / "any"
    path.write_bytes(head + tail)
    try:
        opened = open_any(path)
    except F4xError as error:
        assert str(error).startswith(str(path))
    else:
        assert np.isfinite(opened.posed(0).means).all()
