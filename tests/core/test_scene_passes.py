"""Passes for compositing: against closed forms, finite differences and the scene's own numbers."""

from dataclasses import replace

import numpy as np
import OpenEXR
import pytest
from labelled_scene import HEIGHT, SQUARE, STEP, WALL, WIDTH, labelled_scene, square_mask

from f4x_core.cli.main import main
from f4x_core.edit.naming import by_words
from f4x_core.geometry import pose
from f4x_core.geometry.camera import Camera
from f4x_core.query.matte import matte_image
from f4x_core.scene import write_scene
from f4x_core.scene.color import linear_from_srgb
from f4x_core.scene.cryptomatte import identify, metadata, murmur3, ranked
from f4x_core.scene.exposure import Exposure, Lens, Take, shoot
from f4x_core.scene.passes import Mist, normals, vectors
from f4x_core.scene.stage import Cloud, DrawSettings, Surface
from f4x_core.scene.view import render

PLAIN = DrawSettings(backend="plain")
T = 2
ALL = ("depth", "vector", "normal", "position", "mist")


@pytest.fixture(scope="module")
def scene():
    """The labelled scene seen by a camera that moves up and turns."""
    still = labelled_scene(features=False)
    poses = still.cameras.world_to_camera.copy()
    for row, matrix in enumerate(poses):
        angle = 0.01 * (row - T)
        matrix[:3, :3] = pose.to_matrix(np.array([np.cos(angle / 2), 0, 0, np.sin(angle / 2)]), np.zeros(3))[:3, :3]
        matrix[1, 3] = 0.02 * (row - T)
    return replace(still, cameras=replace(still.cameras, world_to_camera=poses))


def taken(scene, **fields):
    return lambda offset: Take([replace(Cloud.of_scene(scene, T + offset), **fields)], [], scene.cameras.at(T + offset))


@pytest.fixture(scope="module")
def images(scene):
    return shoot(taken(scene), Exposure(), PLAIN, ALL)


def inside(mask, margin=3):
    """Pixels with only neighbours of the mask."""
    kept = mask.copy()
    for shift in range(1, margin + 1):
        for axis in (0, 1):
            kept &= np.roll(mask, shift, axis) & np.roll(mask, -shift, axis)
    return kept


def test_the_picture_itself_is_that_of_view_render(scene, images):
    expected = render(scene, scene.cameras[T], T, ("rgb", "alpha"), "plain")
    np.testing.assert_allclose(images["combined"][..., :3], linear_from_srgb(expected["rgb"]), atol=1e-6)
    np.testing.assert_allclose(images["alpha"], expected["alpha"], atol=1e-6)


def test_vector_is_what_moving_points_do_on_the_screen(scene, images):
    """Finite differences of the true places behind the pixels, projected by the cameras of three frames."""
    square, cameras = inside(square_mask(T)), [scene.cameras[T + step] for step in (-1, 0, 1)]
    for chosen, depth, step in ((square, SQUARE, STEP), (inside(~square_mask(T), 6), WALL, 0.0)):
        pixels = cameras[1].pixel_grid()[chosen]
        places = cameras[1].unproject(pixels, np.full(len(pixels), depth))
        before, _ = cameras[0].project(places - np.array([step, 0, 0]))
        after, _ = cameras[2].project(places + np.array([step, 0, 0]))
        expected = np.concatenate([(before - pixels) * [1, -1], (pixels - after) * [1, -1]], 1)
        error = np.abs(images["vector"][chosen] - expected)
        print(f"vector: mean {error.mean():.4f} px, largest {error.max():.4f} px of {np.abs(expected).max():.1f}")
        assert len(pixels) > 50 and np.abs(expected).max() > 0.5
        assert (
            error.max() < 0.15 and error.mean() < 0.06
        )  # the wall shines through the square by some percent, and moves otherwise


def test_vectors_stop_at_the_cameras_plane():
    camera = Camera(np.array([[60.0, 0, 32], [0, 60, 20], [0, 0, 1]]), np.eye(4), 64, 40)
    places = np.array([[0.0, 0, 1], [0, 0, 0.02]])
    found = vectors(places, (places - np.array([0, 0, 0.02]), places + np.array([0.1, 0, 0])), camera, None)
    np.testing.assert_allclose(found[0], [0, 0, -6, 0], atol=1e-9)
    assert (found[1, :2] == 0).all() and found[1, 2] < -100


def test_normals_face_the_camera_and_turn_with_the_object(scene, images):
    covered = images["alpha"] > 0.5
    np.testing.assert_allclose(images["normal"][covered], np.tile([0, 0, -1], (covered.sum(), 1)), atol=1e-5)
    rng = np.random.default_rng(0)
    quats, scales = rng.normal(size=(40, 4)), rng.uniform(0.1, 1, (40, 3))
    shear = np.array([[1.2, 0.3, 0, 0.1], [0, 0.8, 0.2, -0.3], [0.1, 0, 1.5, 0.5], [0, 0, 0, 1]])
    looks = rng.normal(size=(40, 3))
    found = normals(quats, scales, shear, looks)
    assert ((found * looks).sum(1) <= 0).all()
    for row in range(40):  # perpendicular to what the two long axes become
        w, *v = quats[row] / np.linalg.norm(quats[row])
        axes = pose.to_matrix(np.array([w, *v]), np.zeros(3))[:3, :3]
        long = shear[:3, :3] @ np.delete(axes, scales[row].argmin(), axis=1)
        assert np.abs(found[row] @ long).max() < 1e-9


def test_position_is_the_unprojected_depth(scene, images):
    camera = scene.cameras[T]
    for chosen, depth in ((inside(square_mask(T)), SQUARE), (inside(~square_mask(T), 6), WALL)):
        places = camera.unproject(camera.pixel_grid(), np.full((HEIGHT, WIDTH), depth))
        error = np.linalg.norm(images["position"] - places, axis=-1)[chosen]
        print(f"position: mean {error.mean():.5f}, largest {error.max():.5f} world units")
        assert error.max() < 0.02 and chosen.sum() > 50  # the wall shines through the square by some percent
    there = images["depth"] < 1e9
    np.testing.assert_allclose(camera.project(images["position"][there])[0], camera.pixel_grid()[there], atol=1e-3)


def test_mist_by_the_distance(scene):
    mist = Mist(0.5, 1.0, 2.0)
    images = shoot(taken(scene), Exposure(), replace(PLAIN, mist=mist), ("mist",))
    camera = scene.cameras[T]
    distance = np.linalg.norm(
        camera.unproject(camera.pixel_grid(), np.full((HEIGHT, WIDTH), WALL)) - camera.center, axis=-1
    )
    wall = inside(~square_mask(T), 6)
    expected = 1 - images["alpha"] * (1 - (distance - 0.5) ** 2)
    np.testing.assert_allclose(images["mist"][wall], expected[wall], atol=0.02)  # half a Gaussian aside
    empty = shoot(lambda offset: Take([], [], camera), Exposure(), PLAIN, ("mist",))
    assert (empty["mist"] == 1).all()


def test_surfaces_have_the_same_passes(scene):
    """A slanted triangle that moves, alone: closed forms at every pixel that it covers."""
    corners = np.array([[[-3.0, -3, 1.5], [3, -3, 1.5], [0, 4, 2.5]]])
    step = np.array([0.05, -0.02, 0.1])

    def take_at(offset):
        surface = Surface(corners + step * offset, np.ones((1, 3)), key="t", mattes={"object": identify("t")})
        return Take([], [surface], scene.cameras.at(T + offset))

    images = shoot(take_at, Exposure(), replace(PLAIN, mist=Mist(0, 4, 1)), (*ALL, "matte:object"))
    camera, there = scene.cameras[T], images["depth"] < 1e9
    pixels = camera.pixel_grid()[there]
    places = camera.unproject(pixels, images["depth"][there])
    np.testing.assert_allclose(images["position"][there], places, atol=1e-5)
    normal = np.cross(corners[0, 1] - corners[0, 0], corners[0, 2] - corners[0, 0])
    normal *= -np.sign(normal[2]) / np.linalg.norm(normal)
    np.testing.assert_allclose(images["normal"][there], np.tile(normal, (len(pixels), 1)), atol=1e-5)
    before = scene.cameras[T - 1].project(places - step)[0] - pixels
    after = pixels - scene.cameras[T + 1].project(places + step)[0]
    np.testing.assert_allclose(images["vector"][there], np.concatenate([before, after], 1) * [1, -1, 1, -1], atol=1e-3)
    np.testing.assert_allclose(images["mist"][there], np.linalg.norm(places - camera.center, axis=1) / 4, atol=1e-5)
    assert (images[f"matte:object:{identify('t'):08x}"] == there).all() and 0.2 < there.mean() <= 1


def test_mattes_add_up_to_what_is_covered(scene):
    names = ["wall", "square"]
    moving = scene.moving
    ids = np.where(moving, identify("square"), identify("wall")).astype(np.uint32)
    found = shoot(taken(scene, mattes={"object": ids}), Exposure(), PLAIN, ("matte:object",))
    parts = [found[f"matte:object:{identify(name):08x}"] for name in names]
    np.testing.assert_allclose(sum(parts), found["alpha"], atol=1e-6)
    assert ((parts[1] > 0.5) == square_mask(T)).mean() > 0.97


def test_hashes_are_those_of_the_specification():
    known = {"": 0, "test": 0xBA6BD213, "hello": 0x248BFA47, "hello world": 0x5E928F0F}
    known["The quick brown fox jumps over the lazy dog"] = 0x2E4FF723
    assert {name: murmur3(name.encode()) for name in known} == known
    # what Cycles writes for an object "quad" in a layer of its own name
    assert f"{identify('quad'):08x}" == "9f4da1c4"
    assert metadata("ViewLayer.CryptoObject", ["quad"])["cryptomatte/542cafa/manifest"] == '{"quad":"9f4da1c4"}'
    assert all(np.isfinite(np.uint32(identify(str(i))).view(np.float32)) for i in range(2000))


def test_pairs_are_ordered_by_coverage():
    ids = np.array([5 << 23, 6 << 23, 7 << 23], np.uint32)
    coverage = np.array([[[0.2, 0.5, 0.0]]])
    first, second = ranked(ids, coverage, 4)
    floats = ids.view(np.float32)
    np.testing.assert_array_equal(first[0, 0], np.float32([floats[1], 0.5, floats[0], 0.2]))
    assert (second == 0).all()


def test_a_lens_is_sharp_at_its_focus_and_a_disc_elsewhere():
    camera = Camera(np.array([[600.0, 0, 32], [0, 600, 20], [0, 0, 1]]), np.eye(4), 64, 40)
    lens = Lens(radius=0.02, focus=1.5)
    points = Exposure(400, lens=lens).lens_points()
    seen = np.array([lens.through(camera, p).project(np.array([[0.1, 0, 1.5], [0.1, 0, 1.0]]))[0] for p in points])
    np.testing.assert_allclose(seen[:, 0], np.tile(camera.project(np.array([0.1, 0, 1.5]))[0], (400, 1)), atol=1e-9)
    off = np.linalg.norm(seen[:, 1] - camera.project(np.array([0.1, 0, 1.0]))[0], axis=1)
    circle = 600 * 0.02 * abs(1 / 1.0 - 1 / 1.5)
    assert off.max() <= circle and off.max() > 0.97 * circle
    assert abs((off**2).mean() - circle**2 / 2) < 0.01 * circle**2  # evenly over the disc's area
    hexagon = Exposure(4000, lens=Lens(1, 1, blades=6, ratio=2.0)).lens_points()
    assert abs(np.abs(hexagon[:, 0]).max() - 0.5) < 0.02 and abs(np.abs(hexagon[:, 1]).max() - 3**0.5 / 2) < 0.02


def test_motion_blur_is_the_mean_light_while_the_shutter_is_open(scene):
    exposure = Exposure(12, -0.5, 0.5)
    blurred = shoot(taken(scene), exposure, PLAIN, ("alpha", "normal", "vector"))
    sharp = shoot(taken(scene), Exposure(1), PLAIN, ("normal", "vector"))
    mean = np.zeros((HEIGHT, WIDTH, 3))
    for moment in exposure.moments():
        rgb = render(scene, scene.cameras.at(T + moment), T + moment, ("rgb",), "plain")["rgb"]
        mean += linear_from_srgb(rgb) / exposure.samples
    np.testing.assert_allclose(blurred["combined"][..., :3], mean, atol=1e-5)
    assert np.abs(blurred["combined"] - sharp["combined"]).max() > 0.05
    for name in ("normal", "vector"):
        np.testing.assert_array_equal(blurred[name], sharp[name])
    assert exposure.moments().min() > -0.5 and abs(exposure.moments().mean()) < 1e-12


def test_without_motion_and_lens_one_picture_is_enough(scene):
    calls = []

    def take_at(offset):
        calls.append(offset)
        return taken(scene)(offset)

    shoot(take_at, Exposure(16), PLAIN)
    assert calls == [0.0]


def test_who_comes_or_goes_does_not_fly_in(scene):
    """A Gaussian that is absent one frame before has no place there."""
    hidden = replace(Cloud.of_scene(scene, T - 1), means=np.zeros((len(scene.ids), 3), np.float32))
    hidden = replace(hidden, opacities=np.zeros(len(scene.ids), np.float32))
    camera = scene.cameras[T]
    takes = {-1.0: hidden, 0.0: Cloud.of_scene(scene, T), 1.0: Cloud.of_scene(scene, T)}
    found = shoot(lambda offset: Take([takes[offset]], [], camera), Exposure(), PLAIN, ("vector",))
    assert np.abs(found["vector"]).max() < 1e-6


def exr(file):
    """(pass -> (H,W,C), attributes) of a multi-layer EXR."""
    part = OpenEXR.File(str(file), separate_channels=True).parts[0]
    found = {}
    for channel, content in part.channels.items():
        _, name, letter = channel.split(".")
        found.setdefault(name, {})[letter] = content.pixels
    order = "rgbaRGBAXYZW"
    stacked = {n: np.stack([c[x] for x in order if x in c], -1) for n, c in found.items()}
    return stacked, {key: value for key, value in part.header.items() if key.startswith("cryptomatte")}


def test_f4x_render_writes_one_exr_with_everything(tmp_path, scene, images, capsys):
    write_scene(labelled_scene(), tmp_path / "s.f4x")
    channels = "rgb,alpha,depth,vector,normal,position,mist,cryptomatte,mask:square"
    arguments = ["render", str(tmp_path / "s.f4x"), "-o", str(tmp_path / "o"), "--exr", "--frames", "2:3"]
    assert main([*arguments, "--channels", channels]) == 0
    found, header = exr(tmp_path / "o" / "00002.exr")
    assert [p.name for p in (tmp_path / "o").iterdir()] == ["00002.exr"]
    assert set(found) >= {"Combined", "Alpha", "Depth", "Vector", "Normal", "Position", "Mist", "CryptoObject00"}
    manifest = next(value for key, value in header.items() if key.endswith("manifest"))
    assert f'"square":"{identify("square"):08x}"' in manifest and "labelled" in manifest
    ids = found["CryptoObject00"][..., 0].copy().view(np.uint32)
    assert ((ids == identify("square")) == square_mask(T)).mean() > 0.97
    square = by_words(labelled_scene(), ["square"])["square"]
    refined = matte_image(labelled_scene(), square, labelled_scene().cameras[2], 2.0)
    pairs = found["CryptoObject00"]
    coverage = np.where(ids == identify("square"), pairs[..., 1], pairs[..., 3])
    np.testing.assert_allclose(coverage[refined > 0.1], refined[refined > 0.1], atol=0.02)
    np.testing.assert_allclose(pairs[..., 1] + pairs[..., 3], found["Alpha"][..., 0], atol=0.02)
    assert main([*arguments[:-3], "--frames", "2:3", "--channels", "smell", "--exr"]) == 2
    assert "no channel smell" in capsys.readouterr().err


def test_f4x_render_blurs(tmp_path, capsys):
    write_scene(labelled_scene(features=False), tmp_path / "s.f4x")
    arguments = ["render", str(tmp_path / "s.f4x"), "-o", str(tmp_path / "o"), "--frames", "2:3"]
    assert main([*arguments, "--motion-blur", "1", "--aperture", "0.05", "--samples", "4"]) == 0
    assert (tmp_path / "o" / "rgb" / "00002.png").is_file()
    for wrong in (["--focus", "0"], ["--samples", "0"], ["--motion-blur", "-1"], ["--channels", "depth"]):
        assert main([*arguments, "--aperture", "0.05", *wrong]) == 2
    assert "Traceback" not in capsys.readouterr().err
