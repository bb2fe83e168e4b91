"""Depth Anything 3: joining what it sees in pieces, its providers with a model that tells the truth, its real network."""

import json
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

torch = pytest.importorskip("torch")
pytest.importorskip("transformers")

from f4x_core.clip import Clip  # noqa: E402
from f4x_core.errors import F4xError  # noqa: E402
from f4x_core.features.models import depth_anything3, providers  # noqa: E402
from f4x_core.features.models.depth import GUESS, TRUST  # noqa: E402
from f4x_core.features.models.views import Views, predict_in_one_world  # noqa: E402
from f4x_core.features.preprocess import IMAGENET_MEAN, IMAGENET_STD, image_tensor  # noqa: E402
from f4x_core.geometry import pose, quaternion  # noqa: E402
from f4x_core.geometry.camera import CameraPath  # noqa: E402
from f4x_core.priors import CamerasConfig, DepthConfig, Priors, PriorsConfig, build_priors  # noqa: E402
from f4x_core.priors.providers import find  # noqa: E402
from f4x_core.progress import silent  # noqa: E402

WIDTH, HEIGHT, FOCAL = 160, 90, 130.0
NAME = "depth-anything-3"


def room(count, travel=1.5, turn=0.3, width=WIDTH, height=HEIGHT):
    """Views of a floor and a wall by a camera that walks and turns, and its path."""
    s = np.linspace(-0.5, 0.5, count)[:, None]
    center = s * np.array([travel, 0.0, 0.3 * travel]) + travel * 0.02 * np.sin(9 * s)
    q = quaternion.from_rotation_vector(s * np.array([0.2 * turn, turn, 0.1 * turn]))
    intrinsics = np.array([[FOCAL * width / WIDTH, 0, width / 2], [0, FOCAL * height / HEIGHT, height / 2], [0, 0, 1]])
    matrices = pose.to_matrix(*pose.invert(q, center))
    path = CameraPath(np.tile(intrinsics, (count, 1, 1)), matrices, np.arange(count), width, height)
    depth = []
    for camera in (path[i] for i in range(count)):
        ray = camera.unproject(camera.pixel_grid(), np.ones((height, width))) - camera.center  # (h,w,3), z depth 1
        floor, wall = (1.0 - camera.center[1]) / ray[..., 1], (4.0 - camera.center[2]) / ray[..., 2]
        depth.append(np.minimum(np.where(floor > 0, floor, np.inf), wall))
    depth = np.array(depth, np.float32)
    return Views(path.intrinsics, path.world_to_camera, depth, np.full(depth.shape, 0.9, np.float32)), path


class Teller:
    """A model that tells the truth about the frames asked for, in another world and scale each time."""

    weights = SimpleNamespace(name="teller")

    def __init__(self, views, wobble=0.0, seed=0):
        self.views, self.wobble, self.rng, self.asked = views, wobble, np.random.default_rng(seed), []

    def see(self, chosen):
        self.asked.append(np.asarray(chosen))
        scale = np.exp(self.rng.normal(0, 0.7))
        turn = quaternion.normalize(self.rng.standard_normal(4))
        q, center = (values[chosen] for values in self.views.poses())
        noise = quaternion.from_rotation_vector(self.wobble * self.rng.standard_normal((len(q), 3)))
        center = center + self.wobble * self.rng.standard_normal(center.shape)
        q, center = pose.compose(turn, self.rng.standard_normal(3), quaternion.multiply(q, noise), scale * center)
        matrices = pose.to_matrix(*pose.invert(q, center))
        told = self.views
        return Views(told.intrinsics[chosen], matrices, told.depth[chosen] * np.float32(scale), told.confidence[chosen])

    def size(self, width, height):
        return self.views.depth.shape[1:]

    def predict(self, frames):
        return self.see(frames[:, 0, 0, 0])  # pictures carry their number


def aligned(found, true):
    """Found centres in the true world, and the scale between the worlds."""
    scale, rotation, shift = pose.align_similarity(found, true)
    return scale * found @ rotation.T + shift, scale


@pytest.mark.parametrize(("count", "max_views"), [(1, 16), (16, 16), (17, 16), (40, 5), (100, 16)])
def test_pieces_join_to_one_world_and_scale(count, max_views):
    views, _ = room(count, width=32, height=18)
    teller = Teller(views)
    joined = predict_in_one_world(teller.see, count, max_views)
    assert max(len(asked) for asked in teller.asked) <= max_views
    assert len(joined) == count
    (q, center), (true_q, true_center) = joined.poses(), views.poses()
    if count > 1:
        placed, scale = aligned(center, true_center)
        assert np.abs(placed - true_center).max() < 1e-5
        assert np.abs(joined.depth * scale / views.depth - 1).max() < 1e-4
    between = quaternion.multiply(true_q, quaternion.conjugate(q))  # one turn for all frames
    assert np.abs(np.abs((between * between[0]).sum(-1)) - 1).max() < 1e-9


def test_errors_of_pieces_do_not_add_up_along_the_clip():
    views, _ = room(120, width=32, height=18)
    _, true = views.poses()
    _, center = predict_in_one_world(Teller(views, wobble=0.01).see, 120, 16).poses()
    placed, _ = aligned(center, true)
    assert np.sqrt(((placed - true) ** 2).sum(1).mean()) < 0.05  # a single piece errs by 0.02


def clip_of(count, held_out=()):
    frames = np.zeros((count, HEIGHT, WIDTH, 3), np.uint8)
    frames[:, 0, 0, 0] = np.arange(count)
    return Clip("room", frames, np.arange(float(count)), 24.0, np.isin(np.arange(count), held_out), "room")


def tracks_of(path, views, points=400, seed=1):
    """Tracks (F,N,2) of surface points of the middle frame, and where they are in the picture (nothing hides them)."""
    middle, rng = len(path) // 2, np.random.default_rng(seed)
    pixels = rng.uniform((0, 0), (path.width, path.height), (points, 2))
    column, row = pixels.astype(int).T
    xyz = path[middle].unproject(np.stack([column, row], -1) + 0.5, views.depth[middle, row, column].astype(float))
    uv = np.array([path[i].project(xyz)[0] for i in range(len(path))])
    inside = (uv > 0).all(-1) & (uv < (path.width, path.height)).all(-1)
    return (uv + 0.1 * rng.standard_normal(uv.shape)).astype(np.float32), inside


@pytest.fixture
def told(monkeypatch):
    """Puts a teller in the model's place."""

    def use(teller):
        monkeypatch.setattr(depth_anything3, "DepthAnything3", lambda model: teller)
        monkeypatch.setattr(providers, "require_provider", lambda stage, name: None)
        return teller

    return use


def run(clip, priors, cameras=NAME):
    config = PriorsConfig(cameras=CamerasConfig(cameras), depth=DepthConfig(NAME))
    if cameras:
        find("cameras", cameras)(clip, priors, config, silent)
    find("depth", NAME)(clip, priors, config, silent)
    priors.validate(["cameras", "depth", "depth_confidence"])
    return priors


def test_moving_clip_gets_refined_cameras_and_depth_in_their_unit(told):
    held_out = (5, 11, 17)
    clip = clip_of(24, held_out)
    kept = clip.supervised
    views, path = room(24)
    seen, _ = room(24, width=112, height=70)  # the model's own size and aspect
    teller = told(Teller(seen, wobble=0.01))
    priors = Priors.empty(clip)
    tracks, visible = tracks_of(path, views)
    priors.tracks, priors.tracks_visible = tracks[kept], visible[kept]
    run(clip, priors)
    assert not np.isin(np.concatenate(teller.asked), held_out).any()
    assert sum(map(len, teller.asked)) < 3 * len(kept)  # looked at once for both stages
    assert priors.camera_kind == "moving"
    assert priors.cameras.intrinsics[0] == pytest.approx(path.intrinsics[0], rel=1e-6)
    placed, scale = aligned(priors.cameras.centers, path.centers[kept])
    assert np.sqrt(((placed - path.centers[kept]) ** 2).sum(1).mean()) < 0.005  # the model's own error is 0.017
    assert np.median(priors.depth) == pytest.approx(1, abs=1e-3)
    assert np.median(np.abs(priors.depth * scale / views.depth[kept] - 1)) < 0.01
    assert priors.depth_confidence.max() <= TRUST
    assert priors.depth_confidence.min() > 0.5
    assert priors.statistics["cameras"]["solver"] == NAME
    assert priors.statistics["cameras"]["model"] == priors.statistics["depth"]["model"] == "teller"
    assert priors.statistics["cameras"]["reprojection_px"]["median"] < 0.3


def test_given_focal_length_wins(told):
    clip, (views, path) = clip_of(12), room(12)
    told(Teller(replace(views, intrinsics=views.intrinsics * np.array([1.2, 1.2, 1])[:, None])))  # the model errs
    priors = Priors.empty(clip)
    priors.tracks, priors.tracks_visible = tracks_of(path, views)
    config = PriorsConfig(cameras=CamerasConfig(NAME, focal=FOCAL / WIDTH))
    find("cameras", NAME)(clip, priors, config, silent)
    assert priors.cameras.intrinsics[0] == pytest.approx(path.intrinsics[0])
    placed, _ = aligned(priors.cameras.centers, path.centers)
    assert np.abs(placed - path.centers).max() < 0.02


@pytest.mark.parametrize(("travel", "turn", "kind"), [(0.0, 0.0, "static"), (0.0, 0.4, "pan")])
def test_clip_without_parallax_keeps_the_shape_of_the_depth(told, travel, turn, kind):
    clip, (views, path) = clip_of(12), room(12, travel, turn)
    told(Teller(views, wobble=0.003))
    priors = Priors.empty(clip)
    priors.tracks, priors.tracks_visible = tracks_of(path, views)
    run(clip, priors)
    assert priors.camera_kind == kind
    assert np.abs(priors.cameras.centers).max() == 0
    assert priors.cameras.intrinsics[0, 0, 0] == pytest.approx(FOCAL)
    ratio = priors.depth / views.depth
    assert ratio.std() / ratio.mean() < 1e-3
    assert priors.depth_confidence.max() <= GUESS


def test_without_tracks_the_model_is_taken_at_its_word(told):
    clip, (views, path) = clip_of(12), room(12)
    told(Teller(views))
    priors = run(clip, Priors.empty(clip))
    assert priors.camera_kind == "moving"
    assert any("refine the cameras of depth-anything-3" in line for line in priors.warnings)
    placed, scale = aligned(priors.cameras.centers, path.centers)
    assert np.abs(placed - path.centers).max() < 1e-4
    assert np.abs(priors.depth * scale / views.depth - 1).max() < 1e-3


def test_depth_alone_takes_the_scale_of_given_cameras(told):
    clip, (views, path) = clip_of(12), room(12)
    told(Teller(views))
    priors = Priors.empty(clip)
    priors.cameras, priors.camera_kind = path.scaled_world(7.0), "moving"
    priors.provenance["cameras"] = {"provider": "files"}
    priors.tracks, priors.tracks_visible = tracks_of(path, views)
    run(clip, priors, cameras=None)
    assert np.abs(priors.cameras.centers - 7 * path.centers).max() < 1e-9
    assert np.median(np.abs(priors.depth / (7 * views.depth) - 1)) < 0.01


def test_zoom_is_told(told):
    clip, (views, _) = clip_of(12), room(12)
    zoom = np.linspace(0.8, 1.3, 12)[:, None, None]
    told(Teller(replace(views, intrinsics=views.intrinsics * zoom)))
    assert any("zooms" in line for line in run(clip, Priors.empty(clip)).warnings)


def test_providers_run_inside_the_whole_build(told, tmp_path):
    clip, (views, path) = clip_of(6), room(6)
    told(Teller(views))
    tracks, visible = tracks_of(path, views)
    (tmp_path / "priors").mkdir()
    np.save(tmp_path / "priors" / "tracks.npy", tracks)
    np.save(tmp_path / "priors" / "tracks_visible.npy", visible)
    np.save(tmp_path / "priors" / "tracks_motion.npy", np.zeros(tracks.shape[1], np.float32))
    config = PriorsConfig(cameras=CamerasConfig(NAME), depth=DepthConfig(NAME))
    built = build_priors(clip, tmp_path / "priors", config)
    read = Priors.read(tmp_path / "priors")
    assert read.provenance["cameras"]["provider"] == read.provenance["depth"]["provider"] == NAME
    assert np.array_equal(read.depth, built.depth)


# What is not there is one sentence.


@pytest.mark.parametrize(("stage", "name"), providers.MODELS)
def test_models_are_found_by_name_from_python(stage, name, monkeypatch, tmp_path):
    monkeypatch.setenv("F4X_MODELS", str(tmp_path))
    monkeypatch.setattr(providers, "find_spec", lambda name: name)
    config = PriorsConfig(cameras=CamerasConfig(name), depth=DepthConfig(name))
    with pytest.raises(F4xError, match=f"f4x models get {name}"):
        find(stage, name)(None, None, config, silent)


def test_missing_package_and_weights_are_told(monkeypatch, tmp_path):
    monkeypatch.setattr(providers, "find_spec", lambda name: None)
    with pytest.raises(F4xError, match="pip install --no-deps depth-anything-3"):
        providers.require_provider("cameras", NAME)
    monkeypatch.setattr(providers, "find_spec", lambda name: name)
    monkeypatch.setenv("F4X_MODELS", str(tmp_path))
    monkeypatch.setenv("HF_HUB_OFFLINE", "1")
    with pytest.raises(F4xError, match="f4x models get depth-anything-3-base"):
        providers.require_provider("depth", "depth-anything-3-base")
    with pytest.raises(F4xError, match="no provider 'nobody' for cameras"):
        providers.require_provider("cameras", "nobody")
    providers.require_provider("cameras", "classical")


# The real network, of another width and random.

network = pytest.mark.skipif(
    providers.find_spec("depth_anything_3") is None,
    reason="the package depth-anything-3 is not installed (pip install --no-deps depth-anything-3)",
)


@pytest.fixture
def tiny(monkeypatch, tmp_path):
    """Folder of a random checkpoint of the real architecture, 96 channels wide."""
    from depth_anything_3.model.dinov2 import dinov2
    from depth_anything_3.model.dinov2.vision_transformer import DinoVisionTransformer
    from safetensors.torch import save_model

    def narrow(**options):
        return DinoVisionTransformer(embed_dim=96, depth=12, num_heads=6, **options)

    monkeypatch.setattr(dinov2, "vit_small", narrow)
    monkeypatch.setitem(depth_anything3.SIZES, "da3-small", ("vits", 96))
    torch.manual_seed(0)
    made = depth_anything3.build("da3-small")
    # As the authors publish it: named below `model.`, with the description of given cameras, and an object graph as config.
    whole = torch.nn.ModuleDict({"model": made})
    made.cam_enc = torch.nn.Linear(9, 96)
    save_model(whole, str(tmp_path / "model.safetensors"))
    graph = {"__object__": {"path": "nowhere.to.import", "name": "Nothing"}}
    (tmp_path / "config.json").write_text(json.dumps({"model_name": "da3-small", "config": graph}))
    return tmp_path, made.eval()


@network
def test_checkpoint_opens_and_its_answer_is_the_networks(tiny, capsys):
    folder, made = tiny
    model = depth_anything3.DepthAnything3(folder)
    frames = np.random.default_rng(0).integers(0, 255, (4, 90, 160, 3), dtype=np.uint8)
    views = model.predict(frames)
    h, w = model.size(160, 90)
    assert (h, w) == (280, 504)
    assert views.depth.shape == views.confidence.shape == (4, h, w)
    assert (views.depth > 0).all()
    assert ((views.confidence > 0) & (views.confidence < 1)).all()
    assert views.intrinsics[:, 0, 2] == pytest.approx(w / 2)
    rotation = views.world_to_camera[:, :3, :3]
    assert rotation @ rotation.transpose(0, 2, 1) == pytest.approx(np.tile(np.eye(3), (4, 1, 1)), abs=1e-5)
    pictures = torch.cat([image_tensor(rgb, (h, w), IMAGENET_MEAN, IMAGENET_STD, mode="bicubic") for rgb in frames])
    with torch.no_grad():
        asked = made(pictures[None])
    assert np.abs(asked["depth"][0].numpy() - views.depth).max() == 0
    assert np.abs(asked["extrinsics"][0].numpy() - views.world_to_camera[:, :3]).max() == 0
    assert capsys.readouterr().out == ""


@network
def test_package_brings_no_heavy_import_and_no_eval(tiny):
    import sys

    from omegaconf import OmegaConf

    depth_anything3.DepthAnything3(tiny[0])
    assert not OmegaConf.has_resolver("eval")
    assert not {"torchvision", "gsplat", "depth_anything_3.api", "evo", "e3nn", "open3d"} & set(sys.modules)


@network
@pytest.mark.parametrize("damage", ["config", "size", "weights", "missing", "another"])
def test_damaged_checkpoint_is_one_sentence(tiny, damage):
    from safetensors.torch import load_file, save_file

    folder, _ = tiny
    weights = folder / "model.safetensors"
    if damage == "config":
        (folder / "config.json").write_text("{")
    elif damage == "size":
        (folder / "config.json").write_text('{"model_name": "da3-giant"}')
    elif damage == "weights":
        weights.write_bytes(weights.read_bytes()[:-100])
    elif damage == "missing":
        weights.unlink()
    else:
        tensors = load_file(weights)
        save_file({name: tensor for name, tensor in tensors.items() if "cam_dec" not in name}, weights)
    with pytest.raises(F4xError, match=str(folder)) as told:
        depth_anything3.DepthAnything3(folder)
    assert str(told.value).count("\n") == 0
    with pytest.raises(F4xError, match="no folder"):
        depth_anything3.DepthAnything3("nobody/nothing")
