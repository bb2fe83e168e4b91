"""What the benchmark of features calls time: how its ratios come about."""

from pathlib import Path

import numpy as np
import pytest
from labelled_scene import FRAMES, HEIGHT, WIDTH, labelled_scene

from benchmarks.speed import feature_cost
from f4x_core.features.maps import FeatureMaps
from f4x_core.features.spec import FeatureSpec
from f4x_core.features.teachers import TeacherEntry
from f4x_core.fit.distil_config import DistilConfig
from f4x_core.query.segmentation import shrink
from f4x_core.scene.view import render


def test_times_are_those_of_the_fit_and_of_distilling_at_both_widths(monkeypatch):
    scene, seen = labelled_scene(features=False), []
    maps = [FeatureMaps(Path("x"), FeatureSpec("x", 4, (4, 6)), np.ones((FRAMES, 4, 6, 4), np.float16))]
    clock = iter([0.0, 100.0, 200.0, 220.0, 300.0, 420.0])  # fit 100 s, narrow 20 s, wide 120 s
    monkeypatch.setattr(feature_cost.time, "perf_counter", lambda: next(clock))
    monkeypatch.setattr(feature_cost, "distil", lambda scene, maps, config, progress: seen.append((config, len(maps))))
    monkeypatch.setattr(feature_cost, "compare_decoding", lambda **_: {"ratio": 2.5})
    reported = feature_cost.measure_times(lambda: scene, maps, DistilConfig(steps=7, threads=1))
    assert [(config.width, config.steps, config.threads, count) for config, count in seen] == [
        (32, 7, 1, 1),
        (512, 7, 1, 1),
    ]
    assert reported["fit_ratio"] == pytest.approx(1.2) and reported["width_ratio"] == pytest.approx(220 / 120)
    assert reported["distil_ratio"] == 6 and reported["step_ratio"] == 2.5 and reported["width_ratio_seed"] == 5.23


def test_masks_by_pictures_look_at_every_frame_and_masks_by_features_at_none(monkeypatch):
    scene, seen = labelled_scene(), []

    class RedOrNot:
        """A teacher that sees what the scene's head says: the red square, or the wall."""

        def encode(self, rgb):
            seen.append(rgb)
            red = (rgb[..., 0] > rgb[..., 2]).astype(np.float32)
            return shrink(np.stack([red, 1 - red], -1), (20, 32))

    monkeypatch.setattr(TeacherEntry, "load", lambda self, model: RedOrNot())
    with_square = np.zeros((HEIGHT, WIDTH), bool)
    with_square[14:26, 20:32] = render(scene, scene.cameras[0], 0.0, ("rgb",))["rgb"][14:26, 20:32, 0] > 0.5
    assert with_square.any()
    reported = feature_cost.compare_inference(scene, with_square)
    assert len(seen) == 1 + FRAMES + 1  # one to warm up, the prompted one for the prompt and on the way
    assert reported["mask_time_ratio"] == pytest.approx(
        reported["mask_picture_seconds"] / reported["mask_feature_seconds"]
    )
    assert reported["mask_agreement"] > 0.75  # both find the square, but for its rim
