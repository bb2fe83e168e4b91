"""The cost model, and the measurements behind `f4x bench scale`."""

import json
from pathlib import Path

import numpy as np
import pytest

from benchmarks.speed import long_clips as long_benchmark
from benchmarks.speed.batch import leave_one_out, measure_growth, measure_overhead
from benchmarks.speed.batch_cost import Size, fit_costs
from f4x_core.cli import main
from f4x_core.clip import write_images
from f4x_core.errors import F4xError
from f4x_core.processes import Ended

TRUE = {"priors": (2.0, 0.9), "fit": (3.0, 0.2, 10.0, 120.0)}


def measured(noise, count=12, seed=0):
    rng = np.random.default_rng(seed)
    rows = []
    for _ in range(count):
        size = Size(int(rng.integers(10, 90)), float(rng.uniform(0.01, 0.2)), int(rng.integers(1, 9)) * 1000)
        times = {kind: float(np.dot(TRUE[kind], size.terms(kind))) * rng.uniform(1 - noise, 1 + noise) for kind in TRUE}
        rows.append((size, times))
    return rows


def test_exact_times_give_their_coefficients_back():
    model = fit_costs(measured(0.0))
    for kind, wanted in TRUE.items():
        np.testing.assert_allclose(model.coefficients[kind], wanted, rtol=1e-6)
    size = Size(3600, 0.13, 3600)
    assert model.seconds(size) == pytest.approx(sum(np.dot(TRUE[kind], size.terms(kind)) for kind in TRUE))
    assert model.seconds(size, ["priors"]) == pytest.approx(2 + 0.9 * 3600 * 0.13)


def test_a_clip_that_was_left_out_is_predicted():
    errors = leave_one_out(measured(0.1))
    assert len(errors) == 12 and max(map(abs, errors)) < 0.25


def test_no_coefficient_is_negative_and_nothing_gives_nothing():
    model = fit_costs(
        [(Size(10, 0.1), {"render": 2.0}), (Size(20, 0.1), {"render": 1.0}), (Size(30, 0.1), {"render": 0.5})]
    )
    assert min(model.coefficients["render"]) >= 0
    with pytest.raises(F4xError, match="no finished task"):
        fit_costs([])


def test_a_thousand_rows_cost_no_more_each_than_the_first(tmp_path):
    report = measure_growth(tmp_path, rows=1000)
    assert report["last_quarter_ms_per_task"] < 2 * report["first_quarter_ms_per_task"] + 0.5
    assert report["memory_growth_mb"] < 20 and report["index_kb"] < 1000


def test_the_layer_costs_little_beside_its_commands(tmp_path):
    assert 0 < measure_overhead(tmp_path, rows=5)["local_overhead_s"] <= 0.2


def test_the_number_of_clips_is_checked(capsys):
    assert main(["bench", "scale", "--clips", "9", "--json"]) == 2
    assert "--clips 9: give a number from 0 to 8" in json.loads(capsys.readouterr().out)["error"]


def test_a_long_measurement_that_was_cut_off_goes_on_with_whole_rows(tmp_path, monkeypatch):
    """Rows that are finished stay; a fit that was cut off is thrown away and measured from its beginning."""
    fitted = []

    def fit(command, *_, **__):
        clip, place = Path(command[4]), Path(command[6])
        frames = len(list((clip / "images").iterdir()))
        assert not place.exists()
        place.mkdir()
        (place / "half").touch()
        fitted.append(frames)
        if len(fitted) == 2:
            raise KeyboardInterrupt
        psnr = {"used_psnr": 30.0, "seam_psnr": 29.9, "rest_psnr": 30.1}
        (place / "metrics.json").write_text(json.dumps(psnr))
        last = {"result": {"shots": [{"static": 7 * frames}]}}
        return Ended(0, last, "", cpu_seconds=2.0 * frames + 0.1 * (frames > 70), memory=1_000_000 + frames)

    monkeypatch.setattr(long_benchmark, "run_child", fit)
    source, folder = tmp_path / "source", tmp_path / "kept"
    write_images(source, np.zeros((3, 4, 6, 3), np.uint8))
    with pytest.raises(KeyboardInterrupt):
        long_benchmark.measure_long(folder, [65, 75], source)
    report = long_benchmark.measure_long(folder, [65, 75], source)
    assert fitted == [65, 75, 75]
    assert [row["static"] for row in report["rows"]] == [7 * 65, 7 * 75]
    assert report["memory_ratio"] == pytest.approx(1_000_075 / 1_000_065)
    assert report["time_ratio"] == pytest.approx(150.1 / 75 / 2)
    assert report["seam_loss"] == pytest.approx(0.2)
