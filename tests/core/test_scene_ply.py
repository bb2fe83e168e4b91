"""3DGS PLY: exact round trips, dialects, world-axes SH, and files that are something else."""

import dataclasses

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from random_scene import random_scene

from f4x_core.errors import F4xError
from f4x_core.geometry import quaternion, spherical_harmonics
from f4x_core.geometry.splats import Splats
from f4x_core.scene.ply import REQUIRED, export_frame, read_ply, read_properties, write_ply, write_properties


def splats(count=25, degree=3):
    scene = random_scene(static=count, dynamic=0, degree=degree)
    part = scene.static
    return Splats(part.means, quaternion.normalize(part.quats), part.scales, part.opacities, part.sh)


def header_of(path):
    return path.read_bytes().split(b"end_header")[0].decode()


def test_standard_names_order_and_size(tmp_path):
    path = tmp_path / "a.ply"
    write_ply(path, splats(degree=3))
    names = [line.split()[2] for line in header_of(path).splitlines() if line.startswith("property float")]
    expected = ["x", "y", "z", "nx", "ny", "nz", "f_dc_0", "f_dc_1", "f_dc_2", *(f"f_rest_{i}" for i in range(45))]
    expected += ["opacity", "scale_0", "scale_1", "scale_2", "rot_0", "rot_1", "rot_2", "rot_3"]
    assert names == expected
    assert len(path.read_bytes()) - path.read_bytes().index(b"end_header\n") - 11 == 25 * 248


def test_values_on_disk_are_raw(tmp_path):
    given = splats(degree=1)
    write_ply(tmp_path / "a.ply", given)
    raw = read_properties(tmp_path / "a.ply")
    np.testing.assert_array_equal(raw["y"], given.means[:, 1])
    np.testing.assert_allclose(raw["rot_0"], given.quats[:, 0], rtol=1e-6)
    np.testing.assert_allclose(raw["scale_2"], np.log(given.scales[:, 2]), rtol=1e-6)
    np.testing.assert_allclose(raw["opacity"], np.log(given.opacities / (1 - given.opacities)), rtol=1e-4, atol=1e-5)
    world = spherical_harmonics.rotate(given.sh, given.quats)
    np.testing.assert_array_equal(raw["f_dc_1"], world[:, 0, 1])
    # channel-major: f_rest_0..2 are red's three coefficients, f_rest_3 is green's first
    np.testing.assert_allclose(raw["f_rest_1"], world[:, 2, 0], atol=1e-6)
    np.testing.assert_allclose(raw["f_rest_3"], world[:, 1, 1], atol=1e-6)


@pytest.mark.parametrize("degree", range(5))
def test_round_trip(tmp_path, degree):
    before = splats(degree=degree)
    write_ply(tmp_path / "a.ply", before)
    after = read_ply(tmp_path / "a.ply")
    for name, b in after.arrays().items():
        a = getattr(before, name)
        assert b.dtype == np.float32 and a.shape == b.shape
        np.testing.assert_allclose(b, a, atol=3e-6, err_msg=name)


def test_raw_properties_round_trip_bit_for_bit(tmp_path):
    rng = np.random.default_rng(3)
    kinds = ["i1", "u1", "<i2", "<u2", "<i4", "<u4", "<f4", "<f8"]
    row = np.dtype([(f"p{i}", kind) for i, kind in enumerate(kinds)] + [(name, "<f4") for name in REQUIRED])
    vertices = np.frombuffer(rng.bytes(40 * row.itemsize), row)  # any bits, NaN payloads too
    write_properties(tmp_path / "a.ply", vertices)
    again = read_properties(tmp_path / "a.ply")
    assert again.dtype == row and again.tobytes() == vertices.tobytes()
    write_properties(tmp_path / "b.ply", again)
    assert (tmp_path / "a.ply").read_bytes() == (tmp_path / "b.ply").read_bytes()


def dialect(path, order="<", kind="double", newline="\n", leading="", shuffle=True):
    """Write good splats the way some other tool might: shuffled, without normals, in doubles, with comments."""
    write_ply(path, splats(degree=1))
    vertices = read_properties(path)
    names = [name for name in vertices.dtype.names if not name.startswith("n")]
    if shuffle:
        names = [names[i] for i in np.random.default_rng(0).permutation(len(names))]
    code = {"double": "f8", "float32": "f4"}[kind]
    packed = np.empty(len(vertices), [(name, order.strip("asci") + code) for name in names])
    for name in names:
        packed[name] = vertices[name]
    lines = [
        "ply",
        {"<": "format binary_little_endian 1.0", ">": "format binary_big_endian 1.0"}.get(order, "format ascii 1.0"),
        "comment made elsewhere",
        leading,
    ]
    lines += ["obj_info x", f"element vertex {len(packed)}", *(f"property {kind} {name}" for name in names)]
    lines += ["element face 0", "property list uchar int vertex_indices", "end_header"]
    skipped = np.zeros(3, "<f4").tobytes() if leading else b""
    body = skipped + packed.tobytes()
    if order == "ascii":
        rows = [["0"]] * 3 * bool(leading) + [list(map(repr, row.tolist())) for row in packed]
        body = (newline.join(map(" ".join, rows)) + newline).encode()
    path.write_bytes((newline.join(line for line in lines if line) + newline).encode() + body)


@pytest.mark.parametrize(
    "options",
    [
        {},
        {"kind": "float32"},
        {"order": ">"},
        {"order": "ascii"},
        {"order": "ascii", "newline": "\r\n", "leading": "element camera 3\nproperty float f"},
        {"newline": "\r\n"},
        {"leading": "element camera 3\nproperty float f"},
    ],
)
def test_dialects(tmp_path, options):
    dialect(tmp_path / "d.ply", **options)
    read = read_ply(tmp_path / "d.ply")
    for name, a in splats(degree=1).arrays().items():
        np.testing.assert_allclose(getattr(read, name), a, atol=3e-6)


def test_infinite_logit_and_log_of_zero_are_valid(tmp_path):
    path = tmp_path / "a.ply"
    write_ply(path, splats(3, 0))
    raw = read_properties(path)
    raw["opacity"], raw["scale_0"] = [np.inf, -np.inf, -800], -np.inf
    write_properties(path, raw)
    read = read_ply(path)
    assert read.opacities.tolist() == [1, 0, 0] and (read.scales[:, 0] == 0).all()


def test_extreme_activated_values_are_written_finite(tmp_path):
    given = splats(3, 0)
    extreme = dataclasses.replace(given, scales=given.scales * 0, opacities=np.array([0, 1, 0.5], np.float32))
    write_ply(tmp_path / "a.ply", extreme)
    raw = read_properties(tmp_path / "a.ply")
    assert all(np.isfinite(raw[name]).all() for name in raw.dtype.names)
    np.testing.assert_allclose(read_ply(tmp_path / "a.ply").opacities, [0, 1, 0.5], atol=2e-6)


def test_no_splats(tmp_path):
    write_ply(tmp_path / "none.ply", splats(0, 1))
    assert read_ply(tmp_path / "none.ply").sh.shape == (0, 4, 3)


def points(names):
    return lambda path: write_properties(path, np.zeros(4, [(name, "<f4") for name in names]))


def text(*lines):
    return lambda path: path.write_bytes("\n".join(lines).encode())


def cut(path):
    write_ply(path, splats())
    path.write_bytes(path.read_bytes()[:-5])


def activated(path):
    write_ply(path, splats())
    raw = read_properties(path)
    raw["scale_1"] = 1e4
    write_properties(path, raw)


WRONG = {
    "plain point cloud": points(["x", "y", "z", "red"]),
    "lacks rot_3": points(REQUIRED[:-1]),
    "compressed splat PLY": points(["packed_position", "packed_rotation"]),
    "5 f_rest": points([*REQUIRED, *(f"f_rest_{i}" for i in range(5))]),
    "9 f_rest": points([*REQUIRED, *(f"f_rest_{i}" for i in range(1, 10))]),
    "promises 3 splats of 2 numbers and holds 5": text(
        *("ply", "format ascii 1.0", "element vertex 3", "property float x", "property float y", "end_header"),
        *("1.5 2.5", "3.5 4.5", "5.5"),
    ),
    "promises 999999999999 splats and holds fewer": text(
        "ply", "format ascii 1.0", "element vertex 999999999999", "property float x", "end_header", "1 2", ""
    ),
    "other than numbers": text(
        "ply", "format ascii 1.0", "element vertex 1", "property int x", "end_header", "one", ""
    ),
    "not a PLY": text("solid cube"),
    "longer than 64 KiB, a limit of Feature4X": text("ply", *["comment of a scanner"] * 4000, "end_header", ""),
    "header has no end": text("ply", "format binary_little_endian 1.0", "element vertex 1"),
    "cannot be read .*property quad": text("ply", "format binary_little_endian 1.0", "property quad x", ""),
    "twice": text(
        "ply", "format binary_little_endian 1.0", "element vertex 0", *["property int x"] * 2, "end_header", ""
    ),
    "without vertices": text("ply", "format binary_little_endian 1.0", "end_header", ""),
    "promises 999999999999 splats and holds 0": text(
        "ply", "format binary_little_endian 1.0", "element vertex 999999999999", "property int x", "end_header", ""
    ),
    "truncated, it promises 25 splats and holds 24": cut,
    "must be logarithms": activated,
    "cannot be read": lambda path: None,
}


@pytest.mark.parametrize("words", WRONG)
def test_says_what_the_file_is(tmp_path, words):
    path = tmp_path / "w.ply"
    WRONG[words](path)
    with pytest.raises(F4xError, match=words) as caught:
        read_ply(path)
    assert str(caught.value).startswith(str(path))


@settings(max_examples=300, deadline=2000, derandomize=True)
@given(share=st.floats(0, 1, exclude_max=True), value=st.integers(0, 255), cut_at=st.floats(0.3, 1.3))
def test_damaged_files_read_or_say_so(tmp_path_factory, share, value, cut_at):
    path = tmp_path_factory.getbasetemp() / "fuzz.ply"
    write_ply(path, splats(3, 0))
    data = bytearray(path.read_bytes())
    data[int(share * len(data))] = value
    path.write_bytes(data[: int(cut_at * len(data))])
    try:
        read = read_ply(path)
    except F4xError as error:
        assert str(error).startswith(str(path))
    else:
        assert all(np.isfinite(value).all() for value in read.arrays().values())


def test_a_world_axes_viewer_sees_what_we_see(tmp_path):
    """Habit of every other viewer: SH at the world direction. Dynamic Gaussians have turned meanwhile."""
    scene = random_scene(degree=3)
    camera, time = scene.cameras[2], 4.4
    export_frame(scene, time, tmp_path / "frame.ply")
    raw = read_properties(tmp_path / "frame.ply")
    sh = np.empty((len(raw), 16, 3))
    for channel in range(3):
        sh[:, 0, channel] = raw[f"f_dc_{channel}"]
        for i in range(15):
            sh[:, i + 1, channel] = raw[f"f_rest_{15 * channel + i}"]
    xyz = np.stack([raw[axis] for axis in "xyz"], 1)
    posed = scene.posed(time)
    np.testing.assert_allclose(
        spherical_harmonics.evaluate(sh, xyz - camera.center), scene.colors(posed, camera), atol=1e-5
    )
