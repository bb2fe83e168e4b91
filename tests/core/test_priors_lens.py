"""A lens that bends straight lines is measured and told; a straight one is not."""

from dataclasses import replace

import av
import numpy as np
import pytest
from test_priors_cameras import HEIGHT, PRINCIPAL, WIDTH, clip_and_priors, project, truth

from f4x_core.priors import cameras
from f4x_core.priors.bundle import BundleConfig
from f4x_core.priors.config import PriorsConfig
from f4x_core.priors.lens import Bend, measure, straightened
from f4x_core.priors.point_tracks import PointTracks
from f4x_core.progress import silent


def bent(uv, bend):
    """Pixels as a lens shows them that bends: the inverse of `straightened`, by bisection along the radius."""
    offset = (uv - PRINCIPAL) / PRINCIPAL.max()
    radius = np.linalg.norm(offset, axis=-1, keepdims=True)
    low, high = np.zeros_like(radius), np.full_like(radius, 1.2)
    for _ in range(50):
        middle = (low + high) / 2
        short = middle * (1 + bend * middle**2) < radius
        low, high = np.where(short, middle, low), np.where(short, high, middle)
    return PRINCIPAL + PRINCIPAL.max() * offset / np.maximum(radius, 1e-12) * low


def tracks_of(bend, noise=0.2, true=None):
    true = truth(frames=16, travel=1.5) if true is None else true
    tracks, visible = project(true)
    tracks = bent(tracks, bend) + noise * np.random.default_rng(3).standard_normal(tracks.shape)
    inside = ((tracks > 0) & (tracks < [WIDTH, HEIGHT])).all(-1)
    return true, tracks, visible & inside


@pytest.mark.parametrize("bend", [-0.1, 0.0, 0.1, 0.2])
def test_the_bend_of_a_lens_is_measured(bend):
    true, tracks, visible = tracks_of(bend)
    found = measure(true, PointTracks.all_static(tracks, visible), BundleConfig(expected_focal=0.9 * WIDTH))
    assert found.bend == pytest.approx(bend, abs=0.02)
    assert found.certain == (bend != 0)


@pytest.mark.parametrize("bend", [0.0, 0.15])
def test_far_points_whose_rays_diverge_do_not_bend_the_lens(bend):
    """Noise triangulates many of them behind the cameras, where no adjustment gets them from. So little parallax tells little."""
    near = truth(frames=16, travel=0.2)
    far = np.random.default_rng(0).uniform(1, 60, (len(near.points), 1)) * near.points
    true, tracks, visible = tracks_of(bend, 0.4, replace(near, points=far))
    found = measure(true, PointTracks.all_static(tracks, visible), BundleConfig(expected_focal=0.9 * WIDTH))
    assert abs(found.bend - bend) < found.deviation < 0.03
    assert not found.certain


@pytest.mark.parametrize(("tracks_used", "certain"), [(300, True), (14, False)])
def test_a_bend_that_few_tracks_tell_is_not_certain(tracks_used, certain):
    true, tracks, visible = tracks_of(0.1, 0.3)
    chosen = np.arange(tracks.shape[1]) < tracks_used
    found = measure(true, PointTracks(tracks, visible, chosen), BundleConfig(expected_focal=0.9 * WIDTH))
    assert found.saved > 0.25 and abs(found.bend) > 0.03
    assert found.certain == certain


def test_nothing_is_measured_without_tracks():
    true, tracks, visible = tracks_of(0.1)
    assert measure(true, PointTracks(tracks, visible, np.zeros(tracks.shape[1], bool)), BundleConfig()) is None


def test_straightening_undoes_the_bend():
    uv = np.random.default_rng(0).uniform([0, 0], [WIDTH, HEIGHT], (50, 2))
    np.testing.assert_allclose(bent(straightened(uv, PRINCIPAL, 0.15), 0.15), uv, atol=1e-6)


@pytest.mark.parametrize(("bend", "told"), [(0.2, True), (0.0, False)])
def test_cameras_tell_of_a_lens_that_bends(bend, told):
    _, tracks, visible = tracks_of(bend)
    clip, priors = clip_and_priors(tracks, visible)
    cameras.provide(clip, priors, PriorsConfig(), silent)
    assert any("lenscorrection" in line for line in priors.warnings) == told
    assert priors.statistics["cameras"]["bend"]["bend"] == pytest.approx(bend, abs=0.05)


@pytest.mark.parametrize("bend", [-0.08, 0.18])
def test_the_told_command_makes_lines_straight(bend):
    """FFmpeg's filter, with the numbers that are told, on a bent picture of a smooth pattern, against the pattern itself."""
    width, height = 2 * WIDTH, 2 * HEIGHT
    middle = np.array([width, height]) / 2
    rows, columns = np.mgrid[:height, :width] + 0.5
    pixels = np.stack([columns, rows], -1)

    def pattern(uv):
        return (128 + 60 * np.sin(uv[..., 0] / 9) + 60 * np.cos(uv[..., 1] / 7)).astype(np.uint8)

    shown = pattern(straightened(pixels.reshape(-1, 2), middle, bend).reshape(pixels.shape))
    k1, k2 = Bend(bend, 1.0, 0.0).ffmpeg(width, height)
    graph = av.filter.Graph()
    source = graph.add_buffer(width=width, height=height, format="gray", time_base="1/24")
    lens = graph.add("lenscorrection", f"k1={k1:.3f}:k2={k2:.3f}:i=bilinear")
    sink = graph.add("buffersink")
    source.link_to(lens)
    lens.link_to(sink)
    graph.configure()
    frame = av.VideoFrame.from_ndarray(shown, "gray")
    frame.pts = 0
    source.push(frame)
    made = sink.pull().to_ndarray(format="gray").astype(float)
    inner = (abs(pixels - middle) < 0.85 * middle).all(-1)  # what a pincushion brings in at the rim is not in the film
    wanted = pattern(pixels).astype(float)
    assert abs(made - wanted)[inner].mean() < 0.15 * abs(shown - wanted)[inner].mean()
