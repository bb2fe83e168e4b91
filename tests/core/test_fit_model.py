"""The model under optimisation against plain formulas: corrected cameras, nodes as parameters, Gaussians at a time, a picture."""

import numpy as np
import pytest
import torch
from carried_scene import GRAPH, HEIGHT, WIDTH, camera_path, carried_scene, row_of_nodes, spawned_at

from f4x_core.fit.model import NodeSet, SceneModel
from f4x_core.fit.pipeline import _span
from f4x_core.gaussians import SpawnConfig, spawn_static
from f4x_core.gaussians.camera_rig import CameraRig, CorrectedView
from f4x_core.geometry import quaternion
from f4x_core.geometry.interpolation import presence
from f4x_core.geometry.splats import Splats
from f4x_core.native.kernels import TORCH, Kernels

pytestmark = pytest.mark.usefixtures("one_thread")


def rodrigues(vector: np.ndarray) -> np.ndarray:
    """(3,3) the rotation by |vector| radians about `vector`."""
    angle = np.linalg.norm(vector)
    x, y, z = vector / angle
    cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    return np.eye(3) + np.sin(angle) * cross + (1 - np.cos(angle)) * cross @ cross


# ---- cameras -----------------------------------------------------------------------------------------------------------


@pytest.fixture
def rig():
    """Corrected cameras of four frames."""
    rig, rng = CameraRig(camera_path(4)), np.random.default_rng(0)
    with torch.no_grad():
        for name, size in (("camera_rotation", 0.3), ("camera_position", 0.2)):
            rig.parameters[name].copy_(torch.from_numpy(rng.normal(0, size, (4, 3))))
    return rig


def test_corrections_are_made_in_the_frame_of_the_camera(rig):
    for frame in range(4):
        turn = rodrigues(rig.parameters["camera_rotation"][frame].detach().double().numpy())
        shift = rig.parameters["camera_position"][frame].detach().double().numpy()
        base = rig.path.world_to_camera[frame]
        point = np.array([0.3, -0.7, 1.9])
        view = rig.view(frame).detach().double().numpy()
        expected = turn @ (base[:3, :3] @ point + base[:3, 3]) + shift
        np.testing.assert_allclose(view[:3, :3] @ point + view[:3, 3], expected, atol=1e-5)
        np.testing.assert_array_equal(view[3], [0, 0, 0, 1])


@pytest.mark.parametrize("angle", [0.0, 1e-6, 5e-3, 0.02, 0.5, 2.5])
def test_the_gradients_of_corrections_are_those_of_the_formula(angle):
    rng = torch.Generator().manual_seed(1)
    rotation, position, base, sent = (
        torch.randn(*shape, generator=rng, dtype=torch.float64) for shape in ((3,), (3,), (4, 4), (4, 4))
    )
    rotation, base[3] = angle * rotation / rotation.norm(), torch.tensor([0.0, 0, 0, 1])
    fast, plain = ([each.clone().requires_grad_() for each in (rotation, position)] for _ in range(2))
    turn = quaternion.to_matrix(quaternion.from_rotation_vector(plain[0]))
    moved = torch.cat([turn @ base[:3, :3], (turn @ base[:3, 3] + plain[1])[:, None]], 1)
    expected = torch.cat([moved, base[3:]])
    both, frame = [torch.stack([torch.zeros(3), each]) for each in fast], 1
    found = CorrectedView.apply(*both, torch.stack([torch.eye(4).to(base), base]), frame)
    torch.testing.assert_close(found, expected, rtol=1e-12, atol=1e-12)
    for got, wanted in zip(
        *(torch.autograd.grad(m, x, sent) for m, x in ((found, fast), (expected, plain))), strict=True
    ):
        torch.testing.assert_close(got, wanted, rtol=1e-9, atol=1e-9)


def test_the_intrinsics_follow_the_size(rig):
    fx, fy, cx, cy = 50, 55, 33, 18
    whole, half = (rig.intrinsics(1, *size) for size in ((WIDTH, HEIGHT), (WIDTH // 2, HEIGHT // 4)))
    np.testing.assert_allclose(whole, [[fx, 0, cx], [0, fy, cy], [0, 0, 1]], rtol=1e-6)
    np.testing.assert_allclose(half, [[fx / 2, 0, cx / 2], [0, fy / 4, cy / 4], [0, 0, 1]], rtol=1e-6)


def test_steady_corrections_cost_nothing_and_uneven_ones_their_second_difference(rig):
    turn, shift = (rig.parameters[name].detach().double().numpy() for name in ("camera_rotation", "camera_position"))
    squares = [((p[t - 1] - 2 * p[t] + p[t + 1]) ** 2).sum() for t in (1, 2) for p in (turn, shift)]
    assert float(rig.smoothness().detach()) == pytest.approx(sum(squares) / 2, rel=1e-5)
    with torch.no_grad():
        for name in ("camera_rotation", "camera_position"):
            rig.parameters[name].copy_(torch.arange(4.0)[:, None] * torch.tensor([0.1, -0.2, 0.3]) + 0.5)
    assert float(rig.smoothness().detach()) == pytest.approx(0, abs=1e-12)
    assert float(CameraRig(camera_path(2)).smoothness()) == 0
    three = CameraRig(camera_path(3))
    with torch.no_grad():
        three.parameters["camera_rotation"][1, 0], three.parameters["camera_position"][2, 1] = 0.1, 0.3
    assert float(three.smoothness().detach()) == pytest.approx(0.2**2 + 0.3**2)
    five, rng = CameraRig(camera_path(5)), np.random.default_rng(1)
    names = ("camera_rotation", "camera_position")
    own = [torch.from_numpy(rng.normal(size=(5, 3))).float().requires_grad_() for _ in names]
    five.parameters = dict(zip(names, own, strict=True))
    both = torch.cat([each.double() for each in own], 1)
    plain = (both[2:] - 2 * both[1:-1] + both[:-2]).square().sum(1).mean()
    for got, wanted in zip(*(torch.autograd.grad(3 * m, own) for m in (five.smoothness(), plain)), strict=True):
        torch.testing.assert_close(got, wanted, rtol=1e-5, atol=1e-5)


def test_the_refined_path_holds_the_corrections(rig):
    path = rig.refined()
    for frame in range(4):
        np.testing.assert_allclose(path.world_to_camera[frame], rig.view(frame).detach(), atol=1e-6)
        np.testing.assert_allclose(path.intrinsics[frame], rig.intrinsics(frame, WIDTH, HEIGHT), rtol=1e-6)
        rotation = path.world_to_camera[frame, :3, :3]
        np.testing.assert_allclose(rotation @ rotation.T, np.eye(3), atol=1e-14)
    np.testing.assert_array_equal(path.times, rig.path.times)


# ---- nodes -------------------------------------------------------------------------------------------------------------


def test_nodes_start_where_the_scaffold_is_and_their_radii_stay_below_five_units():
    scaffold = row_of_nodes(radius=0.6)
    nodes = NodeSet(scaffold, GRAPH)
    np.testing.assert_allclose(nodes.radius.detach(), 0.6, rtol=1e-5)
    np.testing.assert_array_equal(nodes.parameters["node_xyz"].detach(), scaffold.xyz)
    with torch.no_grad():
        nodes.parameters["radius_logit"].copy_(torch.tensor([0.0, 50, -50, 1]))
        nodes.parameters["node_quat"].mul_(3)
    np.testing.assert_allclose(nodes.radius.detach(), [2.5, 5, 0, 5 / (1 + np.exp(-1))], atol=1e-6)
    np.testing.assert_allclose(nodes.quat.detach(), scaffold.quat, atol=1e-6)
    taken = nodes.snapshot()
    np.testing.assert_allclose(taken.quat, scaffold.quat, atol=1e-6)
    np.testing.assert_allclose(taken.radius, nodes.radius.detach())
    assert taken.ids.tolist() == [20, 21, 22, 23]


def test_edges_of_the_graph_weigh_0_4_in_all_and_coarse_ones_their_level():
    """Shares of each node's edges: 0.4 / number of them / number of nodes."""
    scaffold = row_of_nodes(12)
    edges = NodeSet(scaffold, GRAPH).edges
    base = edges.detached_from
    for i in range(12):
        own = edges.node[:base] == i
        neighbours = [
            n for n, valid in zip(scaffold.neighbours[i, 1:], scaffold.edge_mask[i, 1:], strict=True) if valid
        ]
        assert edges.neighbour[:base][own].tolist() == neighbours
        np.testing.assert_allclose(edges.weight[:base][own], 0.4 / len(neighbours) / 12, rtol=1e-6)
    coarse = edges.node[base:]
    assert len(coarse) and set(edges.neighbour[base:].tolist()) < set(range(12))
    for i in coarse.unique():
        assert float(edges.weight[base:][coarse == i].sum()) == pytest.approx(0.3 / 12, rel=1e-5)


# ---- Gaussians at a time -----------------------------------------------------------------------------------------------

PLACES = np.array([[0.1, 0.1, 0.0], [0.9, 0.2, 0.1], [2.6, -0.2, 0.0], [1.5, 40.0, 0.0], [3.0, 0.4, 0.3]])
REFERENCE = np.array([0, 1, 2, 0, 1])


@pytest.fixture(params=[TORCH, Kernels(native=True, threads=2)], ids=["torch", "compiled"])
def model(request):
    if request.param.native:
        request.getfixturevalue("native_library")
    return carried_scene(PLACES, REFERENCE, kernels=request.param)


def test_gaussians_are_where_they_were_seen_at_their_own_time(model):
    for i, frame in enumerate(REFERENCE):
        places, turns, *_ = model.dynamic_at(float(frame))[0]
        np.testing.assert_allclose(places[i].detach(), PLACES[i], atol=2e-5)
        np.testing.assert_allclose(abs(turns[i, 0].detach()), 1, atol=1e-5)


def test_a_gaussian_comes_and_goes_as_its_lifetimes_say(model):
    """Wholly there for the nearer half of them, gone at their end, and optical depth fades."""
    dynamic = model.dynamic
    with torch.no_grad():
        dynamic.parameters["log_lifetimes"][:] = torch.tensor([2.0, 4.0]).log()
    for time in (-1.0, 0.0, 0.5, 1.25, 2.0, 3.0, 5.0):
        splats = model.posed(model.dynamic_at(time)[0])
        for i, frame in enumerate(REFERENCE):
            away = time - frame
            there = min(max(2 * (1 - abs(away) / (4.0 if away > 0 else 2.0)), 0), 1)
            solid = float(dynamic.opacities[i].detach())
            row = len(model.static) + i
            assert float(splats.opacities[row].detach()) == pytest.approx(1 - (1 - solid) ** there, abs=1e-5)


def test_the_scene_shows_gaussians_when_the_fit_showed_them(model):
    rng = np.random.default_rng(0)
    with torch.no_grad():
        model.dynamic.parameters["log_lifetimes"][:] = torch.from_numpy(rng.uniform(-1, 2, (len(REFERENCE), 2)))
    span = _span(model)
    assert np.isfinite(span).any()
    for time in np.linspace(model.times[0], model.times[-1], 9):
        away = float(time) - model.born
        np.testing.assert_allclose(presence(span, time), model.dynamic.presence(away).detach(), atol=1e-5)
    with torch.no_grad():
        model.dynamic.parameters["log_lifetimes"][:] = 9
    assert _span(model) is None  # all are there always: nothing needs to be stored


def test_the_gradient_of_lifetimes_is_the_slope():
    dynamic = carried_scene(PLACES, REFERENCE).dynamic
    for name, value in dynamic.parameters.items():
        dynamic.parameters[name] = value.detach().double().requires_grad_(True)
    away = torch.tensor([-1.4, 2.3, 0.2, 9.0] * len(REFERENCE), dtype=torch.float64)[: len(REFERENCE)]
    quats = torch.tensor([1.0, 0, 0, 0], dtype=torch.float64).repeat(len(away), 1)

    def opacity(lifetimes, logits):
        dynamic.parameters |= {"log_lifetimes": lifetimes, "opacity_logits": logits}
        return dynamic.splats_there(torch.zeros(len(away), 3), quats, away).opacities

    start = torch.tensor([2.0, 3.1], dtype=torch.float64).log().repeat(len(away), 1).requires_grad_(True)
    assert torch.autograd.gradcheck(opacity, (start, dynamic.parameters["opacity_logits"]))


def test_all_nodes_together_carry_even_what_is_far_from_them(model):
    """Weights that fade with distance would leave it behind."""
    turn, shift = rodrigues(np.array([0.0, 0.3, 0.0])), np.array([1.0, -2.0, 0.5])
    with torch.no_grad():
        xyz, quat = model.nodes.parameters["node_xyz"], model.nodes.parameters["node_quat"]
        xyz[1:] = xyz[0] @ torch.from_numpy(turn.T).float() + torch.from_numpy(shift).float()
        quat[0] = torch.tensor([1.0, 0, 0, 0])
        quat[1:] = torch.tensor([np.cos(0.15), 0, np.sin(0.15), 0])
        before, after = (model.dynamic_at(time)[0][0].double().numpy() for time in (0.0, 2.0))
    np.testing.assert_allclose(after, before @ turn.T + shift, rtol=1e-4, atol=1e-4)


def test_skinning_is_the_kernel_of_the_nodes_at_the_reference_and_offsets_count_once_learnt(model):
    own = np.random.default_rng(0).normal(0, 0.2, (5, 4))
    with torch.no_grad():
        model.dynamic.parameters["dw"].copy_(torch.from_numpy(own))
    nodes = model.nodes.scaffold
    for learnt in (False, True):
        model.dynamic.use_dw = learnt
        with torch.no_grad():
            x, _ = model.dynamic.at_reference(model.nodes.parameters["node_xyz"], model.nodes.quat)
            weights, strength = model.skinning(x)
        for i, attach in enumerate(model.dynamic.labels["attach"].tolist()):
            neighbours = nodes.neighbours[attach]
            squared = ((PLACES[i] - nodes.xyz[REFERENCE[i], neighbours]) ** 2).sum(1)
            raw = np.exp(-squared / (2 * 0.6**2)) + 1e-6
            raw = np.abs(raw + learnt * own[i])
            np.testing.assert_allclose(weights[i], raw / raw.sum(), rtol=2e-4)
        assert (strength == 1).all()
        with torch.no_grad():
            moved = model.dynamic_at(0.0)[0][0]
            model.dynamic.parameters["dw"].mul_(-1)
            assert bool((model.dynamic_at(0.0)[0][0] != moved).any()) == learnt
            model.dynamic.parameters["dw"].mul_(-1)


def test_both_sets_then_the_frozen_ones(model):
    behind = spawn_static(spawned_at(np.array([[9.0, 9, 9]])), 1, SpawnConfig(opacity=0.3))
    own = behind.parameters
    frozen = Splats(own["means"], own["quats"], behind.scales, behind.opacities, behind.sh).map(torch.Tensor.detach)
    whole = SceneModel(model.static, model.dynamic, model.nodes, model.rig, "sigma", frozen=frozen)
    moved = whole.dynamic_at(2.0)[0]
    posed = whole.posed(moved)
    static, dynamic = model.static, model.dynamic
    for found, parts in (
        (posed.means, (static.parameters["means"], moved[0], behind.parameters["means"])),
        (posed.quats, (static.parameters["quats"], moved[1], behind.parameters["quats"])),
        (posed.scales, (static.scales, dynamic.scales, behind.scales)),
        (posed.opacities, (static.opacities, dynamic.opacities, behind.opacities)),
        (posed.sh, (static.sh, dynamic.sh, behind.sh)),
    ):
        assert torch.equal(found.detach(), torch.cat([part.detach() for part in parts]))
    still = SceneModel(static, None, None, model.rig, "sigma")
    assert torch.equal(still.posed(None).means, static.parameters["means"])


@pytest.mark.parametrize("with_partner", [False, True])
@pytest.mark.parametrize("with_frozen", [False, True])
def test_what_is_drawn_and_its_gradients_are_those_of_torch(model, with_partner, with_frozen, native_library):
    """All sets in one go by the compiled library, against the posed Gaussians, their colours and channels by torch."""
    rng = torch.Generator().manual_seed(2)
    with torch.no_grad():
        model.dynamic.parameters["log_lifetimes"].uniform_(0.2, 1, generator=rng)
        for gaussians in (model.static, model.dynamic):
            gaussians.parameters["shN"].normal_(0, 0.2, generator=rng)
    if with_frozen:
        own = model.static
        places = own.parameters["means"] + 1, own.parameters["quats"]
        model.frozen = Splats(*places, own.scales, own.opacities, own.sh).map(torch.Tensor.detach)
    leaves = [value for _, own in model.sets() for value in own.parameters.values()]
    leaves += [*model.nodes.parameters.values(), *model.rig.parameters.values()]
    found = []
    for kernels in (TORCH, Kernels(True), Kernels(True, 3)):
        model.kernels, model._attachment = kernels, None
        moved, later = model.dynamic_at(2.0, 3.0)
        drawn = model.drawn(moved, model.rig.camera(1, WIDTH, HEIGHT), later.means if with_partner else None)
        assert drawn.colors.shape[1] == (7 if with_partner else 4)
        sent = [torch.randn(value.shape, generator=torch.Generator().manual_seed(3)) for value in drawn]
        gradients = torch.autograd.grad(list(drawn), leaves, sent, allow_unused=True)
        found.append([*(value.detach() for value in drawn), *gradients])
    for plain, fast, again in zip(*found, strict=True):
        if plain is None or fast is None:
            assert not any(each is not None and each.any() for each in (plain, fast))
            continue
        torch.testing.assert_close(fast, plain, rtol=2e-4, atol=2e-4)
        assert torch.equal(fast, again)


@pytest.mark.parametrize("native", [False, True])
def test_gaussians_that_are_gone_need_not_be_moved(model, native, request):
    """Gaussians that are there are drawn, and get gradients, as if all were drawn."""
    if native:
        request.getfixturevalue("native_library")
    model.kernels, model._attachment = Kernels(True) if native else TORCH, None
    with torch.no_grad():
        model.dynamic.parameters["log_lifetimes"].copy_(
            torch.tensor([[0.5, 0.5], [0.5, 3], [3, 0.5], [0.5, 0.5], [3, 3]]).log()
        )
    time = 2.0
    there = model.dynamic.presence(time - model.born) > 0
    present = model.present_at(time)
    assert 0 < len(present.gaussians) < 5 and torch.equal(present.rows, there.nonzero()[:, 0])
    leaves = [value for _, own in model.sets() for value in own.parameters.values()] + [
        *model.nodes.parameters.values()
    ]
    camera, found = model.rig.camera(1, WIDTH, HEIGHT), []
    rows = torch.cat([torch.ones(len(model.static), dtype=torch.bool), there])
    for chosen in (None, present):
        (moved,) = model.dynamic_at(time, present=chosen)
        drawn = [value if chosen else value[rows] for value in model.drawn(moved, camera)]
        sent = [torch.randn(value.shape, generator=torch.Generator().manual_seed(3)) for value in drawn]
        gradients = torch.autograd.grad(drawn, leaves, sent, allow_unused=True)
        found.append([*drawn, *gradients])
    for all_of_them, those_there in zip(*found, strict=True):
        assert (all_of_them is None) == (those_there is None)
        if all_of_them is not None:
            torch.testing.assert_close(those_there, all_of_them, rtol=1e-5, atol=1e-6)


def test_a_picture_shows_colours_as_seen_from_the_camera_and_background_behind_them_alone(model):
    with torch.no_grad():
        for gaussians in (model.static, model.dynamic):
            gaussians.parameters["shN"].normal_(0, 0.2, generator=torch.Generator().manual_seed(1))
            posed = model.posed(model.dynamic_at(1.0)[0])
        camera = model.rig.camera(1, WIDTH, HEIGHT)
        number = torch.eye(len(posed.means))
        background = torch.tensor([0.1, 0.6, 0.9])
        out = model.render(posed, camera, extra=number, background=background, backend="torch")
    matrix = camera.world_to_camera.double().numpy()
    centre = -matrix[:3, :3].T @ matrix[:3, 3]
    part = out.channels[..., 3:].double().numpy()  # (H,W,N) how much of each pixel is of each Gaussian
    np.testing.assert_allclose(part.sum(-1), out.alpha, atol=1e-5)
    assert part.max((0, 1)).min() < 0.01 < part.max()
    picture = (1 - out.alpha.double().numpy())[..., None] * background.double().numpy()
    for i in range(len(posed.means)):
        direction = posed.means[i].double().numpy() - centre
        w, *axis = posed.quats[i].double().numpy() / np.linalg.norm(posed.quats[i].double().numpy())
        axis = -np.array(axis)  # into the Gaussian's own frame
        x, y, z = (direction + 2 * np.cross(axis, np.cross(axis, direction) + w * direction)) / np.linalg.norm(
            direction
        )
        sh = posed.sh[i].double().numpy()
        first = np.sqrt(3 / (4 * np.pi))
        colour = 0.5 + 0.5 / np.sqrt(np.pi) * sh[0] + first * (-y * sh[1] + z * sh[2] - x * sh[3])
        picture += part[..., i : i + 1] * np.maximum(colour, 0)
    np.testing.assert_allclose(out.channels[..., :3], picture, atol=2e-5)
