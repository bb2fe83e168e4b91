"""Meshes around Gaussians: known shapes come out, whole and in place, and move as the Gaussians do."""

import json
import struct
from dataclasses import asdict, replace
from itertools import pairwise

import numpy as np
import pytest
import trimesh
from labelled_scene import HALF, labelled_scene
from random_scene import FRAMES
from shapes import CENTRE, RADIUS, box, carried_sphere, discs, sphere, static_scene

from f4x_core.cli import main
from f4x_core.edit.apply import open_scene
from f4x_core.edit.meshing import MeshTask
from f4x_core.edit.operations import Freeze, Transform
from f4x_core.edit.selects import Moving
from f4x_core.edit.stack import EditStack, write_stack
from f4x_core.errors import F4xError
from f4x_core.geometry import pose, quaternion
from f4x_core.geometry.splats import Splats
from f4x_core.progress import silent
from f4x_core.query.selection import Selection, fingerprint
from f4x_core.scaffold.deformation import node_poses_at
from f4x_core.scene import read_scene, write_scene
from f4x_core.scene.formats.gltf_mesh import write_gltf_mesh
from f4x_core.scene.mesh import MeshConfig, carried, deviation, mesh_of
from f4x_core.scene.mesh.build import widest_time
from f4x_core.scene.mesh.contour import contour
from f4x_core.scene.mesh.field import NARROWEST, Grid, opacity_field
from f4x_core.scene.mesh.simplify import decimated, edges_of, largest_parts, normals_of, parts_of, smoothed
from f4x_core.scene.posing import Y_UP

COARSE = MeshConfig(resolution=24, faces=3000)


def solid(mesh):
    return trimesh.Trimesh(mesh.vertices, mesh.faces, process=False)


# ------------------------------------------------------------------------------------------------------------ the field


def test_the_field_is_the_product_over_all_gaussians(monkeypatch):
    rng = np.random.default_rng(0)
    splats = Splats(
        means=rng.normal(size=(40, 3)) * 0.3,
        quats=rng.normal(size=(40, 4)),
        scales=rng.uniform(0.05, 0.5, (40, 3)),
        opacities=rng.uniform(0.1, 0.9, 40),
    )
    grid = Grid(np.array([-1.0, -1.1, -0.9]), 0.1, (22, 20, 18))
    values = rng.random((40, 2))
    field, sums = opacity_field(splats, grid, values)
    points = grid.origin + grid.step * np.stack(np.meshgrid(*map(np.arange, grid.shape), indexing="ij"), -1)
    wide = np.maximum(splats.scales, NARROWEST * grid.step)
    kept = np.sort(splats.scales / wide, axis=1)[:, 1:].prod(1)
    depth, total = np.zeros(grid.shape), np.zeros((*grid.shape, 2))
    for n in range(40):
        local = (points - splats.means[n]) @ quaternion.to_matrix(splats.quats[n]) / wide[n]
        power = (local**2).sum(-1)
        own = np.where(power < 9, -np.log1p(-splats.opacities[n] * kept[n] * np.exp(-power / 2)), 0)
        depth += own
        total += own[..., None] * values[n]
    inner = (slice(1, -1),) * 3
    np.testing.assert_allclose(field[inner], (1 - np.exp(-depth))[inner], atol=1e-6)
    np.testing.assert_allclose(sums[inner], np.concatenate([total, depth[..., None]], -1)[inner], atol=1e-5)
    assert not field[0].any() and not field[:, -1].any() and not field[:, :, 0].any()
    monkeypatch.setattr("f4x_core.scene.mesh.field.BLOCK", 4000)
    np.testing.assert_allclose(opacity_field(splats, grid, values)[0], field, atol=1e-6)


def test_a_grid_looks_at_the_thing_and_not_at_strays():
    points, normals = sphere()
    arrays = discs(points, normals, 0.035)
    arrays["means"][::300] += 50
    splats = Splats(*(arrays[name] for name in ("means", "quats", "scales", "opacities")))
    grid = Grid.around(splats, 32)
    assert max(grid.shape) * grid.step < 4 * RADIUS


def test_values_between_grid_points():
    grid = Grid(np.array([1.0, 2.0, 3.0]), 0.5, (4, 5, 6))
    place = np.stack(np.meshgrid(*map(np.arange, grid.shape), indexing="ij"), -1).astype(float)
    points = np.array([[1.3, 2.9, 3.1], [2.2, 3.8, 5.4]])
    np.testing.assert_allclose(
        grid.sample(place @ [[1.0], [2], [-3]], points), (points - grid.origin) / 0.5 @ [[1.0], [2], [-3]]
    )


# ---------------------------------------------------------------------------------------------------------- the surface


@pytest.mark.parametrize("seed", range(3))
def test_any_field_has_a_closed_surface(seed):
    field = np.pad(np.random.default_rng(seed).random((9, 8, 7)), 1)
    vertices, faces = contour(field, 0.5)
    mesh = trimesh.Trimesh(vertices, faces, process=False)
    assert mesh.is_watertight and mesh.is_winding_consistent and mesh.volume > 0
    fewer = trimesh.Trimesh(*decimated(vertices.copy(), faces, len(faces) // 2), process=False)
    assert fewer.is_watertight and fewer.is_winding_consistent
    assert fewer.euler_number == mesh.euler_number


def test_a_ball_in_a_field():
    place = np.stack(np.meshgrid(*[np.arange(32)] * 3, indexing="ij"), -1)
    vertices, faces = contour(1 - np.linalg.norm(place - 15.3, axis=-1) / 20, 0.5)
    assert np.abs(np.linalg.norm(vertices - 15.3, axis=1) - 10).max() < 0.06
    smooth = smoothed(vertices, faces, 5)
    assert np.abs(np.linalg.norm(smooth - 15.3, axis=1) - 10).max() < 0.1  # plain averaging would shrink it
    few, coarse = decimated(smooth.copy(), faces, 800)
    assert len(coarse) <= 800
    assert np.abs(np.linalg.norm(few - 15.3, axis=1) - 10).max() < 0.2
    assert trimesh.Trimesh(few, coarse, process=False).volume == pytest.approx(4 / 3 * np.pi * 1000, rel=0.02)


def test_a_flat_side_costs_no_triangles():
    place = np.stack(np.meshgrid(*[np.arange(32)] * 3, indexing="ij"), -1)
    vertices, faces = contour(2 - np.abs(place - 15.5).max(-1) / 10.2, 1.0)
    few, coarse = decimated(vertices, faces, 200)
    assert trimesh.Trimesh(few, coarse, process=False).volume == pytest.approx(20.4**3, rel=0.01)


def test_parts_and_hollows():
    ball, shell = trimesh.creation.icosphere(2), trimesh.creation.icosphere(2, radius=3)
    hollow = trimesh.creation.icosphere(2, radius=2.8)
    speck = trimesh.creation.icosphere(1, radius=0.05)
    parts = [ball.vertices + np.array([9, 0, 0]), shell.vertices, hollow.vertices, speck.vertices + 5]
    starts = np.cumsum([0, *(len(part) for part in parts)])
    faces = [ball.faces, shell.faces, hollow.faces[:, ::-1], speck.faces]
    faces = np.concatenate([part + start for part, start in zip(faces, starts[:-1], strict=True)])
    vertices = np.concatenate(parts)
    number = parts_of(len(vertices), faces)
    assert [len(set(number[a:b])) for a, b in pairwise(starts)] == [1, 1, 1, 1]
    assert len(set(number)) == 4
    kept = trimesh.Trimesh(*largest_parts(vertices, faces, 0.05), process=False)
    assert kept.volume == pytest.approx(ball.volume + shell.volume)
    walls = trimesh.Trimesh(*largest_parts(vertices, faces, 0.05, hollows=True), process=False)
    assert walls.volume == pytest.approx(ball.volume + shell.volume - hollow.volume)


def test_edges_and_normals():
    faces = np.array([[0, 1, 2], [2, 1, 3]])
    assert edges_of(faces).tolist() == [[0, 1], [0, 2], [1, 2], [1, 3], [2, 3]]
    corners = np.array([[0.0, 0, 0], [2, 0, 0], [0, 2, 0], [2, 2, 0]])
    assert normals_of(corners, faces).tolist() == [[0, 0, 4], [0, 0, 4]]


# ------------------------------------------------------------------------------------------------------- known shapes


def test_a_sphere_of_gaussians():
    scene = static_scene(*sphere(), 0.035)
    mesh = mesh_of(scene, np.ones(len(scene.ids), bool), config=COARSE)
    step = 2 * RADIUS / COARSE.resolution
    off = np.linalg.norm(mesh.vertices - CENTRE, axis=1) - RADIUS
    assert solid(mesh).is_watertight and mesh.parts == 1 and mesh.skin is None
    assert 0.3 * step < off.min() and off.max() < 0.6 * step  # the two sides of a sheet have to stay apart
    assert len(mesh.faces) <= COARSE.faces
    assert (mesh.normals * (mesh.vertices - CENTRE)).sum(1).min() > 0.9 * RADIUS
    np.testing.assert_allclose(mesh.colors, np.tile(mesh.colors[:1], (len(mesh.colors), 1)), atol=1e-3)
    assert mesh.colors[0, 0] > mesh.colors[0, 1] > mesh.colors[0, 2]


def test_a_box_of_gaussians():
    scene = static_scene(*box(), 0.04)
    mesh = mesh_of(scene, np.ones(len(scene.ids), bool), config=COARSE)
    step = 1 / COARSE.resolution
    off = np.abs(mesh.vertices - CENTRE).max(1) - 0.5
    assert solid(mesh).is_watertight and mesh.parts == 1
    assert -0.4 * step < off.min() and off.max() < 0.8 * step


# --------------------------------------------------------------------------------------------------------------- motion


def test_a_mesh_moves_as_its_gaussians():
    scene = carried_sphere()
    mesh = mesh_of(scene, scene.moving, 3.0, COARSE)
    at_rest = scene.posed(3.0).means[scene.moving]
    nearest = np.linalg.norm(mesh.vertices[:, None] - at_rest, axis=2).argmin(1)
    np.testing.assert_allclose(carried(mesh.vertices, mesh.skin, scene.scaffold, 3.0), mesh.vertices, atol=1e-5)
    for time in (0.0, 1.0, 4.5):
        moved = carried(mesh.vertices, mesh.skin, scene.scaffold, time) - mesh.vertices
        expected = (scene.posed(time).means[scene.moving] - at_rest)[nearest]
        assert np.linalg.norm(expected, axis=1).mean() > 0.1
        off = np.linalg.norm(moved - expected, axis=1)
        # a vertex is beside its Gaussian, and a turn takes it elsewhere by that much
        assert off.mean() < 0.05 and np.quantile(off, 0.95) < 0.12


def test_one_node_carries_a_mesh_rigidly():
    scene = carried_sphere(nodes=3)
    scene.dynamic.weight[:] = [1, 0, 0]
    scene.dynamic.node[:] = [1, 0, 2]
    mesh = mesh_of(scene, scene.moving, 0.0, COARSE)
    poses = [node_poses_at(scene.scaffold.times, scene.scaffold.xyz, scene.scaffold.quat, time) for time in (0.0, 4.0)]
    (x0, q0), (x1, q1) = ((x[1].astype(float), q[1].astype(float)) for x, q in poses)
    expected = pose.transform(*pose.compose(q1, x1, *pose.invert(q0, x0)), mesh.vertices.astype(float))
    np.testing.assert_allclose(
        carried(mesh.vertices.astype(float), mesh.skin, scene.scaffold, 4.0), expected, atol=1e-5
    )
    # one joint: a linear blend is no blend
    assert deviation(mesh.vertices.astype(float), mesh.skin, scene.scaffold, scene.cameras.times).max() < 1e-5


def test_what_follows_in_part_stays_behind_in_part():
    scene = carried_sphere(strength=0.0)
    assert mesh_of(scene, scene.moving, 0.0, COARSE).skin is None
    scene = carried_sphere(strength=0.5)
    mesh = mesh_of(scene, scene.moving, 0.0, COARSE)
    np.testing.assert_allclose(mesh.skin.strength, 0.5, atol=1e-5)
    used, joint, weight = mesh.skin.joints()
    np.testing.assert_allclose(np.where(joint == len(used), weight, 0).sum(1), 0.5, atol=1e-5)


def test_the_surface_is_found_where_things_are_apart():
    scene = carried_sphere()
    volumes = [np.linalg.det(np.cov(scene.posed(time).means[scene.moving].T)) for time in scene.cameras.times]
    assert widest_time(scene, scene.moving) == scene.cameras.times[np.argmax(volumes)]
    assert np.argmax(volumes) > 0
    span = np.tile(np.array([-np.inf, -np.inf, 2, 2], np.float32), (len(scene.dynamic), 1))
    assert widest_time(replace(scene, dynamic=replace(scene.dynamic, span=span)), scene.moving) <= 2


# ----------------------------------------------------------------------------------------------------------------- glTF


def read_glb(path):
    """(JSON, function from an accessor to its numbers) of a .glb, with the rules of the container checked."""
    data = path.read_bytes()
    magic, version, length, size, kind = struct.unpack_from("<4sIII4s", data)
    assert (magic, version, length, kind) == (b"glTF", 2, len(data), b"JSON")
    document = json.loads(data[20 : 20 + size])
    binary_size, binary_kind = struct.unpack_from("<I4s", data, 20 + size)
    assert binary_kind == b"BIN\0" and binary_size == document["buffers"][0]["byteLength"] and binary_size % 4 == 0
    binary = data[28 + size :]

    def numbers(index):
        accessor = document["accessors"][index]
        view = document["bufferViews"][accessor["bufferView"]]
        dtype = {5126: "<f4", 5123: "<u2", 5125: "<u4"}[accessor["componentType"]]
        width = {"SCALAR": 1, "VEC3": 3, "VEC4": 4, "MAT4": 16}[accessor["type"]]
        assert view["byteOffset"] % 4 == 0
        values = np.frombuffer(binary, dtype, accessor["count"] * width, view["byteOffset"]).reshape(-1, width)
        assert values.nbytes == view["byteLength"]
        if "min" in accessor:
            assert values.min(0).tolist() == accessor["min"] and values.max(0).tolist() == accessor["max"]
        return values

    return document, numbers


def matrix_of(node):
    x, y, z, w = node.get("rotation", (0, 0, 0, 1))
    return pose.to_matrix(np.array([w, x, y, z]), np.array(node.get("translation", (0, 0, 0)), float))


def test_the_file_is_skinned_as_gltf_says(tmp_path):
    scene = carried_sphere(strength=0.9)
    mesh = mesh_of(scene, scene.moving, 1.0, COARSE)
    write_gltf_mesh(scene, mesh, tmp_path / "a.glb")
    document, numbers = read_glb(tmp_path / "a.glb")
    attributes = document["meshes"][0]["primitives"][0]["attributes"]
    place = numbers(attributes["POSITION"])
    joints = np.concatenate([numbers(attributes[f"JOINTS_{n}"]) for n in (0, 1)], 1)
    weights = np.concatenate([numbers(attributes[f"WEIGHTS_{n}"]) for n in (0, 1)], 1)
    skin = document["skins"][0]
    np.testing.assert_allclose(weights.sum(1), 1, atol=1e-6)
    assert joints.max() < len(skin["joints"]) and not joints[weights == 0].any()
    assert (numbers(attributes["COLOR_0"]) <= 1).all() and "min" in document["accessors"][attributes["POSITION"]]
    np.testing.assert_allclose(np.linalg.norm(numbers(attributes["NORMAL"]), axis=1), 1, atol=1e-5)
    assert not {"translation", "rotation"} & document["nodes"][0].keys() and 0 in document["scenes"][0]["nodes"]
    inverse = numbers(skin["inverseBindMatrices"]).reshape(-1, 4, 4).transpose(0, 2, 1)
    assert (inverse[:, 3] == [0, 0, 0, 1]).all()
    animation = document["animations"][0]
    seconds = numbers(animation["samplers"][0]["input"])[:, 0]
    np.testing.assert_allclose(seconds, scene.cameras.times / scene.fps)
    for frame in range(FRAMES):
        nodes = [dict(node) for node in document["nodes"]]
        for channel in animation["channels"]:
            sampler = animation["samplers"][channel["sampler"]]
            nodes[channel["target"]["node"]][channel["target"]["path"]] = numbers(sampler["output"])[frame]
        motion = np.stack([matrix_of(nodes[joint]) for joint in skin["joints"]]) @ inverse
        whole = np.concatenate([place, np.ones((len(place), 1))], 1)
        read = np.einsum("vk,vkij,vj->vi", weights, motion[joints], whole)[:, :3] @ Y_UP[:3, :3]
        expected = carried(mesh.vertices.astype(float), mesh.skin, scene.scaffold, scene.cameras.times[frame])
        off = np.linalg.norm(read - expected, axis=1)
        own = deviation(mesh.vertices.astype(float), mesh.skin, scene.scaffold, scene.cameras.times[frame : frame + 1])
        np.testing.assert_allclose(off, own[0], atol=1e-5)
        if frame == 1:
            assert off.max() < 1e-5  # the moment of the mesh
    loaded = trimesh.load(tmp_path / "a.glb").geometry
    assert [each.is_watertight for each in loaded.values()] == [True]


def test_a_still_thing_is_a_plain_mesh(tmp_path):
    scene = static_scene(*sphere(), 0.035)
    write_gltf_mesh(scene, mesh_of(scene, np.ones(len(scene.ids), bool), config=COARSE), tmp_path / "a.glb")
    document, _ = read_glb(tmp_path / "a.glb")
    assert "skins" not in document and "animations" not in document and len(document["nodes"]) == 1


# ---------------------------------------------------------------------------------------------------------- the command


def f4x(capsys, *arguments):
    code = main([*map(str, arguments), "--json"])
    out = capsys.readouterr()
    return code, json.loads(out.out)


@pytest.fixture
def scene_file(tmp_path):
    scene = carried_sphere()
    write_scene(scene, tmp_path / "scene.f4x")
    ids = np.sort(scene.ids)
    selection = Selection(ids, (ids >= 1000) * 1.0, np.zeros(len(ids), bool), scene=fingerprint(scene))
    (tmp_path / "selection.json").write_text(json.dumps(selection.to_json()))
    return tmp_path / "scene.f4x"


def test_the_command_writes_what_is_selected(scene_file, tmp_path, capsys):
    some = ("--resolution", 24, "--faces", 1500, "--select", tmp_path / "selection.json")
    code, result = f4x(capsys, "mesh", scene_file, "-o", tmp_path / "new" / "a.glb", *some)
    assert code == 0 and result["parts"] == 1 and result["faces"] <= 1500 and result["nodes"] == 5
    assert 0 < result["linear_blend_off"]["mean"] < result["linear_blend_off"]["max"] < 1
    assert read_glb(tmp_path / "new" / "a.glb")[0]["animations"]


def test_words_and_pixels_select(tmp_path, capsys):
    scene = labelled_scene()
    write_scene(scene, tmp_path / "scene.f4x")
    pixel, _ = scene.cameras[0].project(scene.posed(0.0).means[scene.moving].mean(0, keepdims=True))
    click = ("--point", ",".join(map(str, pixel[0])), "--frame", 0)
    stroke = ("--brush", *click[1:])
    thing = 2**1.5 * HALF
    for prompt, size in ((("--text", "square"), thing), (click, thing), (stroke, thing), ((), None)):
        some = ("--resolution", 24, "--faces", 400, *prompt)
        code, result = f4x(capsys, "mesh", tmp_path / "scene.f4x", "-o", tmp_path / "a.glb", *some)
        assert code == 0, result
        assert result["size"] == pytest.approx(size, rel=0.15) if size else result["size"] > 1


def test_what_to_do_about_edits_that_no_node_follows(scene_file, tmp_path, capsys):
    """Baking is advised where it helps, and never by the command that has just baked."""
    move, freeze = Transform(Moving(), translate=(0.0, 1.0, 0.0), frames=(0.0, 5.0)), Freeze(Moving(), 2.5)
    ids = read_scene(scene_file).ids[read_scene(scene_file).moving]
    for operation, advice in ((move, "`f4x bake` the scene"), (freeze, "would leave these edits as they are: freeze")):
        stack = EditStack().append(operation)
        task = MeshTask(str(scene_file), json.dumps(stack.to_json()), ids.tolist(), 0.0, asdict(COARSE), "")
        with pytest.raises(F4xError, match=advice):
            task.made(silent)
    write_stack(scene_file, stack)
    code, result = f4x(capsys, "mesh", scene_file, "-o", tmp_path / "a.glb")
    assert code == 2 and "freeze; take them back first (`f4x undo`)" in result["error"]


def test_edits_that_nodes_do_not_make_are_baked_or_refused(scene_file, tmp_path, capsys):
    write_stack(scene_file, EditStack().append(Transform(Moving(), translate=(0.0, 1.0, 0.0), frames=(0.0, 5.0))))
    scene = open_scene(scene_file)
    with pytest.raises(F4xError, match=r"edits move 1,500 of the selected Gaussians as no node does"):
        mesh_of(scene, scene.moving, 0.0, COARSE)
    some = ("--resolution", 24, "--faces", 800, "--select", tmp_path / "selection.json", "--time", 1)
    assert f4x(capsys, "mesh", scene_file, "-o", tmp_path / "a.glb", *some)[0] == 0
    document, numbers = read_glb(tmp_path / "a.glb")
    where = numbers(document["meshes"][0]["primitives"][0]["attributes"]["POSITION"]) @ Y_UP[:3, :3]
    middle = scene.posed(1.0).means[scene.moving].mean(0)
    assert abs(where.mean(0) - middle).max() < 0.1
    moved = [numbers(one["output"]) @ Y_UP[:3, :3] for one in document["animations"][0]["samplers"][::2]]
    before = [node_poses_at(scene.scaffold.times, scene.scaffold.xyz, scene.scaffold.quat, t)[0] for t in (0.0, 5.0)]
    first, last = (np.mean([one[t] for one in moved], axis=0) for t in (0, 5))
    np.testing.assert_allclose(last - first - (before[1] - before[0]).mean(0), [0, 1, 0], atol=0.02)


@pytest.mark.parametrize(
    ("arguments", "sentence"),
    [
        (("--resolution", "100000"), "--resolution 100000: give a number from 8 to 256"),
        (("--faces", "3"), "--faces 3: give a number from 20"),
        (("--level", "1.5"), "--level 1.5: give a number between 0 and 1"),
        (("--time", "99"), "--time 99: T must lie within"),
        (("--select", "SELECTION", "--point", "3,3"), "leave out --point"),
        (("--select", "NOBODY"), "no Gaussian is selected"),
        (("--select", "ONE"), "1 of the selected Gaussians"),
        (("--select", "nowhere.json"), "nowhere.json"),
        (("-o", "a.obj"), "end it in .glb"),
    ],
)
def test_bad_input_is_one_sentence(scene_file, tmp_path, capsys, arguments, sentence):
    ids = np.arange(1000, 2500)
    for name, count in (("NOBODY", 0), ("ONE", 1)):
        chosen = Selection(ids, (ids < 1000 + count) * 1.0, np.zeros(len(ids), bool))
        (tmp_path / name).write_text(json.dumps(chosen.to_json()))
    arguments = [str(tmp_path / a) if a in ("NOBODY", "ONE") else a for a in arguments]
    arguments = [str(tmp_path / "selection.json") if a == "SELECTION" else a for a in arguments]
    code, result = f4x(capsys, "mesh", scene_file, "-o", tmp_path / "a.glb", *arguments)
    assert code == 2 and sentence in result["error"]
    assert not list(tmp_path.glob("*.glb"))


@pytest.mark.filterwarnings("ignore::RuntimeWarning")
def test_points_without_size_have_no_surface():
    scene = static_scene(*sphere(), 0.035)
    scene.static.means[:], scene.static.scales[:] = 1, 0
    with pytest.raises(F4xError, match="nowhere more opaque"):
        mesh_of(scene, np.ones(len(scene.ids), bool), config=COARSE)


def test_smoke_has_no_surface():
    scene = static_scene(*sphere(), 0.035)
    scene.static.opacities[:] = 0.01
    with pytest.raises(F4xError, match=r"nowhere more opaque than 0\.5"):
        mesh_of(scene, np.ones(len(scene.ids), bool), config=COARSE)
