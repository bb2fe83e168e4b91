"""LPIPS by a stand-in for the package: what the network is given, which weights it has, and that nothing is downloaded."""

import sys
from types import SimpleNamespace

import numpy as np
import pytest
import torch
from data_sets import toy, write_dycheck
from torch import nn

from benchmarks.studies import toy_fits
from benchmarks.studies.novel import read_novel_cameras
from benchmarks.studies.protocols import score_render
from benchmarks.study import Context
from f4x_core.cli import main
from f4x_core.clip import read_clip, write_images
from f4x_core.evaluation import perceptual_distance
from f4x_core.evaluation.perceptual_distance import lpips, lpips_bytes, lpips_missing, masked_lpips
from f4x_core.scene import write_scene

FACTOR = 3.0
"""Of the stand-in's only weight, kept in the checkpoint."""


class Backbone(nn.Module):
    def __init__(self):
        super().__init__()
        self.slice1 = nn.Sequential()
        self.slice1.add_module("0", nn.Linear(1, 1, bias=False))


class StandIn(nn.Module):
    """Weight times absolute difference; `seen` are the pictures of the last call."""

    seen: tuple[torch.Tensor, torch.Tensor]

    def __init__(self, net="vgg", spatial=False, pnet_rand=False, verbose=True):
        assert net == "alex" and pnet_rand, "another backbone, or one that would be downloaded"
        super().__init__()
        self.net, self.spatial = Backbone(), spatial

    def forward(self, one, other):
        StandIn.seen = one, other
        distance = self.net.slice1[0].weight * (one - other).abs().mean(1, keepdim=True)
        return distance if self.spatial else distance.mean((2, 3), keepdim=True)


@pytest.fixture(autouse=True)
def fresh(monkeypatch, tmp_path):
    """An empty folder of checkpoints, no network to download with, and nothing kept from test to test."""

    def refused(*args, **options):
        raise AssertionError("a download")

    monkeypatch.setattr("socket.socket.connect", refused)
    monkeypatch.setattr(torch.hub, "load_state_dict_from_url", refused)
    monkeypatch.setattr(torch.hub, "get_dir", lambda: str(tmp_path / "hub"))
    perceptual_distance._load.cache_clear()
    yield
    perceptual_distance._load.cache_clear()


@pytest.fixture
def package(monkeypatch):
    monkeypatch.setitem(sys.modules, "lpips", SimpleNamespace(LPIPS=StandIn))


@pytest.fixture
def weights(tmp_path):
    file = tmp_path / "hub" / "checkpoints" / "alexnet-owt-0.pth"
    file.parent.mkdir(parents=True)
    torch.save({"features.0.weight": torch.full((1, 1), FACTOR), "classifier.1.weight": torch.zeros(1)}, file)
    return file


def pair(side=40):
    return np.random.default_rng(0).integers(0, 256, (2, side, side + 8, 3), np.uint8)


def test_pictures_reach_the_network_in_minus_one_to_one_and_its_weights_are_the_checkpoints(package, weights):
    first, second = pair() / 255
    assert lpips(first, second) == pytest.approx(FACTOR * 2 * np.abs(first - second).mean(), rel=1e-5)
    one, other = StandIn.seen
    assert one.shape == other.shape == (1, 3, 40, 48) and one.dtype == torch.float32
    np.testing.assert_allclose(one[0].permute(1, 2, 0), 2 * first - 1, atol=1e-6)
    np.testing.assert_allclose(other[0].permute(1, 2, 0), 2 * second - 1, atol=1e-6)
    assert lpips(first, first) == 0 and lpips_missing() == []
    assert lpips(first[:30], second[:30]) is None  # AlexNet needs 31


def test_the_nvidia_protocol_hands_bytes_over_as_opencv_reads_them(package, weights):
    first, second = pair()
    lpips_bytes(first, second)
    np.testing.assert_allclose(StandIn.seen[0][0].permute(1, 2, 0), first[..., ::-1] / 127.5 - 1, atol=1e-6)


def test_the_masked_distance_is_the_mean_of_the_map_over_the_mask(package, weights):
    first, second = pair() / 255
    mask = np.random.default_rng(1).random(first.shape[:2]) > 0.6
    expected = FACTOR * 2 * np.abs(first - second)[mask].mean()
    assert masked_lpips(first, second, mask) == pytest.approx(expected, rel=1e-5)
    assert (StandIn.seen[0][0].permute(1, 2, 0)[~mask] == -1).all()  # black
    assert np.isnan(masked_lpips(first, second, np.zeros_like(mask)))


def test_what_is_missing_is_told_in_one_sentence(monkeypatch, package):
    first, second = pair() / 255
    mask = np.ones(first.shape[:2], bool)
    (sentence,) = lpips_missing()
    assert sentence.startswith("LPIPS: not run; no weights") and "nothing is downloaded" in sentence
    assert lpips(first, second) is None and masked_lpips(first, second, mask) is None
    perceptual_distance._load.cache_clear()
    monkeypatch.setitem(sys.modules, "lpips", None)
    assert "package `lpips` can't be imported" in lpips_missing()[0]


def test_a_file_of_other_weights_is_told_by_name(package, weights):
    torch.save({"features.0.weight": torch.zeros(2, 2)}, weights)
    assert "alexnet-owt-0.pth does not fit" in lpips_missing()[0]


def test_loading_leaves_the_random_numbers_of_a_fit_alone(package, weights):
    torch.manual_seed(0)
    before = torch.get_rng_state()
    assert lpips_missing() == []
    assert torch.equal(torch.get_rng_state(), before)


def test_eval_measures_it_or_says_why_not(package, weights, tmp_path, capsys):
    world = toy(64, 4)
    scene = toy_fits.fit_world(world, toy_fits.shorten(toy_fits.base_config(Context(tmp_path, quick=True)), 2)).scene
    write_scene(scene, tmp_path / "scene.f4x")
    write_images(tmp_path / "clip", world.clip.frames)
    command = ["eval", str(tmp_path / "scene.f4x"), "--clip", str(tmp_path / "clip")]
    assert main(command) == 0
    reported = capsys.readouterr().out
    assert "used_lpips: " in reported and "held_out_lpips: " in reported and "not run" not in reported
    weights.unlink()
    perceptual_distance._load.cache_clear()
    assert main(command) == 0
    reported = capsys.readouterr().out
    assert "_lpips" not in reported and reported.splitlines()[-1].startswith("LPIPS: not run; no weights")


def test_protocols_and_fits_have_the_column_where_it_runs_and_only_there(package, weights, tmp_path):
    world = toy(64, 4)
    (camera, *_) = read_novel_cameras(read_clip(write_dycheck(tmp_path, world)))
    scene = toy_fits.fit_world(world, toy_fits.shorten(toy_fits.base_config(Context(tmp_path, quick=True)), 2)).scene
    wrong = camera.frames[0] // 2
    rows = [score_render(wrong, camera, 0, masked=True), score_render(wrong, camera, 0, masked=False)]
    rows.append(toy_fits.score_world(world, scene))
    for row, column in zip(rows, ("mLPIPS", "LPIPS", "novel LPIPS"), strict=True):
        assert row[column] > 0
    weights.unlink()
    perceptual_distance._load.cache_clear()
    rows = [score_render(wrong, camera, 0, masked=True), score_render(wrong, camera, 0, masked=False)]
    rows.append(toy_fits.score_world(world, scene))
    assert not [column for row in rows for column in row if "LPIPS" in column]
