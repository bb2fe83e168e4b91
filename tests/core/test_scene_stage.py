"""Several clouds and surfaces in one picture: untouched it is the scene's own picture, moved it is the moved camera's."""

import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from random_scene import HEIGHT, WIDTH, random_scene

from f4x_core.errors import Cancelled
from f4x_core.geometry import pose, quaternion, spherical_harmonics
from f4x_core.geometry.camera import Camera
from f4x_core.raster import choose_backend
from f4x_core.scene.clouds import Cloud
from f4x_core.scene.color import linear_from_srgb, srgb_from_linear
from f4x_core.scene.ground import Texture, sample
from f4x_core.scene.stage import NOTHING, PASSES, DrawSettings, Surface, _bands, _tall_bands, draw
from f4x_core.scene.view import over_background, render

BACKEND = "plain"  # in float64: equal geometry said differently must give equal pictures
SETTINGS = DrawSettings(backend=BACKEND)
GIGABYTES_AT_4K = 3
"""Most memory for all passes of a million Gaussians: pictures take 0.9, the Gaussians 0.3, one band the rest."""
SIMILAR = pose.to_matrix(np.array([0.8, 0.2, -0.5, 0.27]), np.array([0.4, -1.0, 2.0])) @ np.diag([1.7, 1.7, 1.7, 1])
SHEARED = np.array([[1.2, 0.3, 0, 0.1], [0, 0.8, 0.2, -0.3], [0.1, 0, 1.5, 0.5], [0, 0, 0, 1]])
MIRROR = np.diag([-1.0, 1, 1, 1]) @ SIMILAR


def clouds_of(scene, time, **fields):
    """Static and dynamic Gaussians as Blender holds them: harmonics in the object's frame, and what motion turned."""
    posed, clouds = scene.posed(time), []
    for part, stored in ((~posed.dynamic, scene.static), (posed.dynamic, scene.dynamic)):
        rest = quaternion.normalize(stored.quats)
        clouds.append(
            Cloud(
                posed.means[part],
                posed.quats[part],
                posed.scales[part],
                posed.opacities[part],
                spherical_harmonics.rotate(stored.sh, rest),
                turn=quaternion.multiply(posed.quats[part], quaternion.conjugate(rest)),
                **fields,
            )
        )
    return clouds


def wall(depth, left=-9.0, color=(0.5, 0.25, 1.0), **fields):
    """A surface that faces the camera at z = `depth` and fills what is right of x = `left`."""
    corners = np.array([[left, -9, depth], [9, -9, depth], [9, 9, depth], [left, 9, depth]], float)
    return Surface(corners[[[0, 1, 2], [0, 2, 3]]], np.tile(color, (2, 1)), **fields)


@pytest.fixture(scope="module")
def scene():
    return random_scene(degree=2)


def test_scene_files_and_stages_are_composited_in_one_place():
    folder = Path(__file__).resolve().parents[2] / "f4x_core" / "scene"
    users = [file.name for file in folder.rglob("*.py") if "import rasterize" in file.read_text(encoding="utf-8")]
    assert users == ["clouds.py"]


@pytest.mark.parametrize("backend", ["native", "plain"])
@pytest.mark.parametrize("world", [np.eye(4), SIMILAR], ids=["home", "elsewhere"])
def test_untouched_it_is_the_scenes_own_picture(scene, backend, world):
    if backend == "native":
        pytest.importorskip("torch")
        if choose_backend("auto", np.zeros((1, 3), np.float32)) != "native":
            pytest.skip("no compiled library")
    expected = render(scene, scene.cameras[3], 3.0, ("rgb", "depth", "alpha"), backend)
    rigid, size = world.copy(), np.cbrt(np.linalg.det(world[:3, :3]))
    rigid[:3, :3] /= size  # a camera has no scale of its own: the scaled world is nearer to it or farther
    camera = scene.cameras[3]
    view = camera.world_to_camera.copy()
    view[:3, 3] *= size
    camera = Camera(camera.intrinsics, view @ np.linalg.inv(rigid), WIDTH, HEIGHT)
    out = draw(
        clouds_of(scene, 3.0, to_world=world),
        [],
        camera,
        DrawSettings(near=0.01 * size, background=(0.2, 0.4, 0.6), backend=backend),
        passes=("depth",),
    )
    tolerance = 1e-6 if world is SIMILAR else 5e-7
    assert np.abs(out["rgb"] - over_background(expected, (0.2, 0.4, 0.6))).max() < tolerance
    assert np.abs(out["alpha"] - expected["alpha"]).max() < tolerance
    known = np.isfinite(expected["depth"])
    assert known.any() and np.allclose(out["depth"][known], expected["depth"][known] * size, atol=1e-5)
    assert (out["depth"][~known] == np.float32(NOTHING)).all()


@pytest.mark.parametrize("world", [SIMILAR, SHEARED, MIRROR], ids=["similar", "sheared", "mirrored"])
def test_an_ellipsoid_moves_as_its_covariance(scene, world):
    cloud = replace(clouds_of(scene, 0.0)[0], to_world=world)
    moved = cloud.seen_from(np.eye(4))

    def covariance(c):
        shape = quaternion.to_matrix(c.quats.astype(np.float64)) * c.scales[:, None]
        return shape @ shape.transpose(0, 2, 1)

    stretch = world[:3, :3]
    assert np.allclose(moved.means, cloud.means @ stretch.T + world[:3, 3], atol=1e-6)
    assert np.allclose(covariance(moved), stretch @ covariance(cloud) @ stretch.T, atol=1e-7)


@pytest.mark.parametrize("world", [SIMILAR, SHEARED, MIRROR], ids=["similar", "sheared", "mirrored"])
def test_no_cloud_is_special(scene, world):
    """All is projected from the first cloud's frame; which one that is must not show."""
    first, second = clouds_of(scene, 2.0)
    home = np.linalg.inv(world)
    second = replace(second, to_world=world @ pose.to_matrix(np.array([1.0, 0, 0, 0.1]), np.array([0, 0, 0.2])) @ home)
    first = replace(first, to_world=world @ home)
    one = draw([first, second], [], scene.cameras[0], settings=SETTINGS)
    other = draw([second, first], [], scene.cameras[0], settings=SETTINGS)
    assert np.abs(one["rgb"] - other["rgb"]).max() < 1e-5 and one["rgb"].max() > 0.3


def test_a_wall_hides_what_is_behind_it(scene):
    clouds, camera = clouds_of(scene, 0.0), scene.cameras[0]
    middle = float(np.median(np.concatenate([c.means[:, 2] for c in clouds])))
    hard = replace(SETTINGS, surface_samples=1)
    out = draw(clouds, [wall(middle, left=0.0, index=7)], camera, passes=("depth", "index"), settings=hard)
    front = [replace(c, opacities=np.where(c.means[:, 2] < middle, c.opacities, 0)) for c in clouds]
    alone = draw(front, [], camera, settings=SETTINGS)
    free = draw(clouds, [], camera, passes=("depth",), settings=SETTINGS)
    right = np.arange(WIDTH) + 0.5 > camera.intrinsics[0, 2]
    left = 1 - alone["alpha"][:, right, None]
    ray = camera.unproject(camera.pixel_grid(), np.ones((HEIGHT, WIDTH)))[:, right] - camera.center
    light = 0.4 + 0.6 * ray[..., 2:] / np.linalg.norm(ray, axis=-1, keepdims=True)
    assert np.allclose(out["rgb"][:, right], alone["rgb"][:, right] + left * light * [0.5, 0.25, 1.0], atol=1e-6)
    assert np.allclose(out["alpha"][:, right], 1) and np.allclose(
        out["rgb"][:, ~right], free["rgb"][:, ~right], atol=1e-6
    )
    assert np.allclose(out["depth"][:, ~right], free["depth"][:, ~right], rtol=1e-6)
    bare = alone["alpha"] == 0
    bare[:, ~right] = False
    assert bare.any() and np.allclose(out["depth"][bare], middle) and (out["index"][bare] == 7).all()


def test_a_holdout_cuts_a_hole(scene):
    out = draw(
        clouds_of(scene, 0.0),
        [wall(0.5, holdout=True)],
        scene.cameras[0],
        DrawSettings(background=(1, 1, 1), backend=BACKEND),
    )
    assert out["rgb"].max() == 0 and out["alpha"].max() == 0


def test_layers_become_passes(scene):
    clouds = clouds_of(scene, 1.0)
    random = np.random.default_rng(0)
    count = len(clouds[0].means)
    latent, chosen = random.random((count, 3)).astype(np.float32), (random.random((count, 1)) > 0.5).astype(np.float32)
    clouds[0] = replace(clouds[0], index=3, layers={"latent": latent, "selection": chosen, "score": latent[:, :1]})
    clouds[1] = replace(clouds[1], index=5)
    out = draw(clouds, [], scene.cameras[1], passes=PASSES, settings=SETTINGS)
    total = count + len(clouds[1].means)
    padding = ((0, total - count), (0, 0))
    values = {"latent_": np.pad(latent, padding), "chosen": np.pad(chosen, padding)}
    values["first"] = (np.arange(total) < count)[:, None].astype(np.float32)
    truth = render(scene, scene.cameras[1], 1.0, ("alpha",), BACKEND, values=values)
    covered = truth["alpha"] >= 0.1
    share = np.where(covered, truth["alpha"], 1)
    assert np.allclose(
        out["latent"], np.where(covered, 1, 0)[..., None] * truth["latent_"] / share[..., None], atol=1e-6
    )
    assert np.allclose(out["score"], out["latent"][..., 0], atol=1e-6)
    assert np.allclose(out["selection"], truth["chosen"][..., 0], atol=1e-6)
    first = truth["first"][..., 0]
    weights = np.stack([1 - truth["alpha"], first, truth["alpha"] - first])
    sure = np.sort(weights, 0)[-1] - np.sort(weights, 0)[-2] > 1e-4
    assert (out["index"] == np.array([0, 3, 5])[weights.argmax(0)])[sure].all()
    assert {0, 3, 5} <= set(np.unique(out["index"]))


def test_a_region_is_cut_from_the_whole_bit_for_bit(scene):
    clouds, walls, camera = clouds_of(scene, 0.0), [wall(2.5, left=0.1)], scene.cameras[0]
    whole = draw(clouds, walls, camera, passes=PASSES)
    region = (slice(5, 33), slice(20, 57))
    part = draw(clouds, walls, camera, DrawSettings(region=region), passes=PASSES)
    assert part.keys() == whole.keys()
    for name, picture in part.items():
        assert (picture == whole[name][region]).all(), name


def test_near_and_far(scene):
    clouds, camera = clouds_of(scene, 0.0), scene.cameras[0]
    depth = np.concatenate([camera.project(c.means.astype(np.float64))[1] for c in clouds])
    near, far = np.quantile(depth, [0.3, 0.6])
    kept = [
        replace(c, opacities=c.opacities * ((d > near) & (d < far)))
        for c, d in zip(clouds, np.split(depth, [len(clouds[0].means)]), strict=True)
    ]
    out = draw(clouds, [], camera, settings=DrawSettings(near, far, backend=BACKEND))
    expected = draw(kept, [], camera, settings=SETTINGS)
    assert np.abs(out["rgb"] - expected["rgb"]).max() < 1e-6 and expected["rgb"].max() > 0.1


def test_nothing_at_all():
    camera = Camera(np.array([[10.0, 0, 4], [0, 10, 3], [0, 0, 1]]), np.eye(4), 8, 6)
    out = draw([], [], camera, settings=DrawSettings(background=(0.1, 0.2, 0.3)), passes=PASSES)
    assert np.allclose(out["rgb"], [0.1, 0.2, 0.3]) and out["alpha"].max() == 0 and (out["index"] == 0).all()
    assert draw([], [], camera, DrawSettings(background=None))["rgb"].max() == 0


def test_cancelling_stops_between_bands(scene, monkeypatch):
    monkeypatch.setattr("f4x_core.scene.stage.BAND", 10 * WIDTH)
    monkeypatch.setattr("f4x_core.scene.stage.PAUSE", 0.0)
    seen = []

    def progress(name, done, total, message=""):
        seen.append(done)
        if done == 11:
            raise Cancelled

    with pytest.raises(Cancelled):
        draw(clouds_of(scene, 0.0), [], scene.cameras[0], progress=progress)
    assert seen == [0, 10, 11]


@pytest.mark.parametrize("walls", [[], [wall(2.5, left=0.1)]], ids=["open", "wall"])
def test_bands_make_the_same_picture_bit_for_bit(scene, monkeypatch, walls):
    monkeypatch.setattr("f4x_core.scene.stage.BAND", 7 * WIDTH)
    clouds, camera, region = clouds_of(scene, 0.0), scene.cameras[0], (slice(3, 31), slice(9, WIDTH - 4))
    seen = []
    settings = DrawSettings(region=region)
    whole = draw(clouds, walls, camera, settings, passes=PASSES)
    banded = draw(clouds, walls, camera, settings, passes=PASSES, progress=lambda *result: seen.append(result[1]))
    assert seen[:2] == [0, 7] and seen[-1] == 28
    for name, picture in banded.items():
        assert (picture == whole[name]).all() and picture.shape[:2] == (28, WIDTH - 13), name


def test_bands_that_memory_asks_for_make_the_same_picture(scene, monkeypatch):
    whole = draw(clouds_of(scene, 0.0), [], scene.cameras[0], SETTINGS, passes=PASSES)
    monkeypatch.setattr("f4x_core.scene.stage.TALLEST", 9 * WIDTH)
    assert [band.stop for band in _tall_bands(slice(4, HEIGHT), WIDTH)][:2] == [13, 22]
    for name, picture in draw(clouds_of(scene, 0.0), [], scene.cameras[0], SETTINGS, passes=PASSES).items():
        assert (picture == whole[name]).all(), name


MILLION = """
import numpy as np
from pathlib import Path
from f4x_core.geometry.camera import Camera
from f4x_core.scene.stage import PASSES, Cloud, DrawSettings, draw

random, count = np.random.default_rng(0), 1_000_000
means = random.uniform([-1, -0.6, 0.8], [1, 0.6, 1.6], (count, 3)).astype(np.float32)
quats = random.normal(size=(count, 4)).astype(np.float32)
scales = random.uniform(0.0005, 0.003, (count, 3)).astype(np.float32)
sh = random.normal(0, 0.3, (count, 1, 3)).astype(np.float32)
cloud = Cloud(means, quats, scales, np.full(count, 0.5, np.float32), sh)
lens = np.array([[3000.0, 0, 1920], [0, 3000, 1080], [0, 0, 1]])
images = draw([cloud], [], Camera(lens, np.eye(4), 3840, 2160), DrawSettings(backend="native"), passes=PASSES)
assert images["rgb"].shape == (2160, 3840, 3) and images["alpha"].mean() > 0.5
print(next(line.split()[1] for line in Path("/proc/self/status").read_text().splitlines() if line.startswith("VmHWM")))
"""


@pytest.mark.slow
@pytest.mark.skipif(not Path("/proc/self/status").is_file(), reason="only Linux tells the most memory that was held")
def test_all_passes_of_a_million_gaussians_at_4k_take_few_gigabytes():
    if choose_backend("auto", np.zeros((1, 3), np.float32)) != "native":
        pytest.skip("no compiled library")
    done = subprocess.run([sys.executable, "-c", MILLION], capture_output=True, text=True, timeout=300)
    assert done.returncode == 0, done.stderr
    assert int(done.stdout) < GIGABYTES_AT_4K << 20


def test_bands_are_as_tall_as_their_time_allows(monkeypatch):
    clock = [0.0]
    monkeypatch.setattr("f4x_core.scene.stage.time.perf_counter", lambda: clock[0])
    monkeypatch.setattr("f4x_core.scene.stage.TALLEST", 400 << 14)
    heights = []
    for band in _bands(slice(5, 1000), 1 << 14):
        heights.append(band.stop - band.start)
        clock[0] += 0.001 * heights[-1] if band.start < 500 else 0.1 * heights[-1]
    assert heights[:4] == [8, 64, 300, 300] and sum(heights) == 995
    assert heights[4] == 300 and set(heights[5:-1]) == {3}  # rows became a hundred times slower


def test_a_held_out_cloud_is_a_hole_in_every_pass(scene):
    """The rest is given by the other cloud, behind and before it."""
    held, shown = clouds_of(scene, 0.0)
    camera = scene.cameras[0]
    deep = np.repeat(camera.project(shown.places)[1][:, None], 3, 1).astype(np.float32)
    every = {"latent": deep, "selection": np.ones((len(deep), 1), np.float32)}
    shown = replace(shown, layers=every, index=3, mattes={"object": np.full(len(deep), 9, np.uint32)})
    held = replace(held, index=2, layers={"selection": np.ones((len(held.means), 1), np.float32)})
    names = ("selection", "depth", "index", "matte:object", "normal", "mist")
    out = draw([replace(held, holdout=True), shown], [], camera, passes=names, settings=SETTINGS)
    black = replace(held, sh=np.full((len(held.means), 1, 3), -0.5 / 0.28209479, np.float32), layers={})
    both = draw([black, shown], [], camera, passes=("selection", "latent"), settings=SETTINGS)
    alpha = both["selection"]
    for name in ("alpha", "selection", "matte:object:00000009"):
        assert np.allclose(out[name], alpha, atol=1e-6), name
    assert np.allclose(out["rgb"], both["rgb"], atol=1e-6)
    assert np.allclose(out["hole"], both["alpha"] - alpha, atol=1e-6) and out["hole"].max() > 0.5
    seen = alpha >= 0.1
    assert seen.any() and np.allclose(
        out["depth"][seen], (both["latent"][..., 0] * both["alpha"] / np.where(seen, alpha, 1))[seen], rtol=1e-4
    )
    assert (out["depth"][~seen] == 1e10).all() and not out["normal"][~seen].any()
    assert set(np.unique(out["index"])) == {0, 3} and not out["index"][out["hole"] > 0.6].any()


def test_an_edge_is_as_soft_as_the_part_of_a_pixel_that_it_covers(scene):
    clouds, camera = clouds_of(scene, 0.0), scene.cameras[0]
    middle = float(np.median(np.concatenate([c.means[:, 2] for c in clouds])))
    column, part = WIDTH // 2, 0.3
    left = (column + part - camera.intrinsics[0, 2]) / camera.intrinsics[0, 0] * middle
    bare = draw([], [wall(middle, left=left)], camera, settings=SETTINGS)["alpha"][:, column]
    assert np.abs(bare - (1 - part)).max() <= 1 / 16 + 1e-6
    out, full, free = (
        draw(clouds, surfaces, camera, settings=SETTINGS)["rgb"][:, column]
        for surfaces in ([wall(middle, left=left)], [wall(middle)], [])
    )
    assert np.abs(full - free).max() > 0.1 and np.allclose(out, bare[:, None] * (full - free) + free, atol=2e-3)
    hard = draw([], [wall(middle, left=left)], camera, settings=replace(SETTINGS, surface_samples=1))["alpha"]
    assert set(np.unique(hard)) == {0, 1}


@pytest.mark.parametrize(
    ("how", "expected"),
    [
        ({"normals": np.tile([0.0, 3, 4], (2, 3, 1))}, 0.5 * (0.4 + 0.6 * 0.8)),
        ({"glow": np.full((2, 3), 0.3)}, srgb_from_linear(0.3 + linear_from_srgb(0.5))),
        ({"textures": [Texture(np.full((2, 2, 3), 0.25), np.ones(2, bool), np.zeros((2, 3, 2)))]}, 0.25),
    ],
    ids=["smooth", "glowing", "with an image"],
)
def test_what_a_surface_shows(scene, how, expected):
    """Straight before the camera it has its full color, 0.5."""
    camera = Camera(np.array([[50, 0, 4.5], [0, 50, 4.5], [0, 0, 1.0]]), np.eye(4), 9, 9)
    rgb = draw([], [wall(2.0, color=(0.5, 0.5, 0.5), **how)], camera, settings=SETTINGS)["rgb"][4, 4]
    assert np.allclose(rgb, expected, atol=2e-3)


def test_an_image_lies_on_a_surface_as_its_coordinates_say():
    image = np.zeros((2, 4, 3))
    image[0, 1], image[1, 3] = [1, 0, 0], [0, 1, 0]
    places = np.array([[1.5 / 4, 0.75], [3.5 / 4, 0.25], [7.5 / 4, 1.25], [2.0 / 4, 0.75]])
    assert np.allclose(sample(image, places), [[1, 0, 0], [0, 1, 0], [0, 1, 0], [0.5, 0, 0]])
