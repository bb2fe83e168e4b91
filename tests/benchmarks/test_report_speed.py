"""Speed against error: every study on a tiny scene, its errors where they are known, its columns from run to run."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from benchmarks import report_page
from benchmarks.catalogue import choose
from benchmarks.runner import run_studies
from benchmarks.studies import deformation_curves, kernel_shares, neighbour_curves, raster_curves, storage
from benchmarks.studies.rigid_mean import exponential, logarithm, rigid_mean
from benchmarks.study import Context
from f4x_core.geometry import pose, quaternion
from f4x_core.native import open_library

RASTER = ["backends", "precision-and-cut-offs", "tiles", "channels", "size", "count", "gradients"]
STUDIES = [f"raster-{name}" for name in RASTER]
STUDIES += ["deformation-forms", "deformation-rotations", "neighbours", "curve-distance", "storage"]


@pytest.fixture
def tiny(monkeypatch):
    """Sizes that take no time; two rounds, because quartiles want two values."""
    monkeypatch.setattr(Context, "repeats", property(lambda _: 2))
    for module, sizes in {
        raster_curves: {
            "SIZES": {"count": 60, "width": 24, "height": 18},
            "REFERENCE_SIZES": {"count": 40, "channels": 3, "width": 16, "height": 12},
            "CHANNELS": (3, 8),
            "WIDTHS": (16, 32),
            "COUNTS": (20, 60),
        },
        deformation_curves: {
            "COUNTS": 40,
            "IMPLEMENTED": (60,),
            "NEIGHBOURS": (2, 8),
            "SPREADS": (10.0,),
            "ANGLES": (0, 90, 170, 190),
        },
        neighbour_curves: {"SIZES": (20, 12, 60), "CURVES": (20, 24)},
        storage: {"SIZES": (240, 32, 18)},
        kernel_shares: {"SIZES": (60, 24, 18, 60)},
    }.items():
        for name, quick in sizes.items():
            monkeypatch.setattr(module, name, (quick, None))
    monkeypatch.setattr(raster_curves, "measure_thread_ceiling", lambda: 1.0)
    monkeypatch.setattr(kernel_shares, "COPY_BYTES", 1 << 20)
    monkeypatch.setattr(kernel_shares, "PEAK_S", 1e-3)
    monkeypatch.setattr(raster_curves, "TILES", (8, 16))
    monkeypatch.setattr(raster_curves, "STEPS", (1e-4, 1e-5))


def run(names, folder):
    """What the studies found, by name."""
    report = run_studies(choose(names), folder, Context(folder, quick=True))
    return {name: report["studies"][name] for name in names}


def tables(record):
    """Rows by table."""
    return {table["name"]: table["rows"] for table in record["tables"]}


@pytest.mark.slow
def test_every_study_measures_and_only_times_differ(tiny, tmp_path):
    first, again = (run(STUDIES, tmp_path / name) for name in ("first", "again"))
    for name in STUDIES:
        assert not first[name]["failed"] and first[name]["words"] and first[name]["figures"]
        for table, other in zip(first[name]["tables"], again[name]["tables"], strict=True):
            kept = [
                [{column: row[column] for column in row if column not in table["timed"]} for row in rows]
                for rows in (table["rows"], other["rows"])
            ]
            assert kept[0] == kept[1], (name, table["name"])


def test_the_reference_has_no_error_and_precision_tells(tiny, tmp_path):
    found = run(["raster-backends", "deformation-forms", "storage"], tmp_path)
    ways = {row["name"]: row for row in tables(found["raster-backends"])["backends"]}
    rmse, worst = raster_curves.RMSE, raster_curves.WORST
    assert ways["reference, float64"][rmse] == ways["reference, float64"][worst] == 0
    for figure in found["raster-backends"]["figures"]:
        assert ">0</text>" in report_page._drawing(figure, list(ways.values()))  # the reference below the plot
    assert 0 < ways["torch, float64"][rmse] < 1e-13 < ways["torch, float32"][rmse] < 1e-5 < ways["torch, float16"][rmse]
    assert ways["plain, float64"][worst] is None and ways["plain, float64"][rmse] < 1e-13
    forms = {
        (row["form"], row["precision"]): row
        for row in tables(found["deformation-forms"])["forms"]
        if (row["K"], row["spread (deg)"]) == (8, deformation_curves.USUAL)
    }
    degrees, rounding = deformation_curves.DEGREES, deformation_curves.OWN_DEGREES
    assert forms[deformation_curves.EXACT, "float64"][degrees] == 0
    aligned, loose, linear = (forms[name, "float64"][degrees] for name in reversed(list(deformation_curves.FORMS)))
    assert 0 < aligned < linear < 1 < 10 < loose
    assert (
        forms[deformation_curves.ALIGNED, "float32"][rounding]
        < 1e-4
        < forms[deformation_curves.ALIGNED, "float16"][rounding]
    )
    encodings = tables(found["storage"])["encodings"]
    assert encodings[0][storage.RMSE] == 0 and all(0 < row["share"] < 1 for row in encodings[1:])
    assert all(row[storage.RMSE] > 0 for row in encodings[1:])
    sizes = {row["scene"]: row for row in tables(found["storage"])["features"]}
    alike, file = (sizes[f"32 channels, {kind}"]["ratio"] for kind in ("float32", "8 bits (the scene file)"))
    (said,) = (text for text in found["storage"]["words"] if "A latent" in text)
    assert f"{alike:.2f} times as large in float32" in said and f"{file:.2f} times in the 8 bits" in said


def test_cut_offs_err_by_what_they_cut(tiny, tmp_path):
    rows = {
        row["setting"]: row for row in tables(run(["raster-precision-and-cut-offs"], tmp_path)[STUDIES[1]])["cut-offs"]
    }
    rmse, whole = raster_curves.RMSE, raster_curves.WHOLE
    assert rows["3DGS (alpha 1/255, stop 1e-4)"][rmse] < 1e-5 < rows["alpha 1/64"][rmse] < rows["alpha 1/16"][rmse]
    assert rows["none"][whole] < 1e-5 < rows["alpha 1/1024"][whole] < rows["3DGS (alpha 1/255, stop 1e-4)"][whole]


@pytest.mark.skipif(open_library()[0] is None, reason="no compiled kernels")
def test_every_kernel_is_below_the_peak(tiny, tmp_path):
    rows = tables(run(["kernel-shares"], tmp_path)["kernel-shares"])["kernels"]
    assert {"raster forward", "raster backward", "poses of a frame", "SSIM and L1"} <= {row["kernel"] for row in rows}
    assert all(0 < row[kernel_shares.OF_PEAK] < 1 and row["operations (M)"] > 0 for row in rows)


def test_backends_that_err_make_the_report_fail():
    row = {
        "backend": "native",
        "precision": "float32",
        "overflows": "",
        raster_curves.RMSE: 1e-7,
        raster_curves.P99_9: 1e-6,
        raster_curves.WORST: 1e-6,
    }
    assert raster_curves._untrue([row]) == []
    assert "native" in raster_curves._untrue([row | {raster_curves.P99_9: 1e-2}])[0]
    assert raster_curves._untrue([row | {raster_curves.WORST: 2e-2}])
    assert raster_curves._unequal([{"backend": "torch", "threads": 2, "same bits": False}])


def motions(rng, *shape, largest=2.0):
    """Random rigid motions."""
    turn = quaternion.from_rotation_vector(largest / np.sqrt(3) * rng.uniform(-1, 1, (*shape, 3)))
    return turn, rng.normal(size=(*shape, 3))


def test_screws_are_logarithms_of_rigid_motions():
    rng = np.random.default_rng(0)
    q, t = motions(rng, 50)
    q[0], q[1] = [1, 0, 0, 0], quaternion.from_rotation_vector(np.array([1e-7, 0, 0]))
    turn, shift = logarithm(q, t)
    twist = np.zeros((50, 4, 4))
    twist[:, :3, :3] = np.cross(np.eye(3)[None], turn[:, None])  # [turn]x
    twist[:, :3, 3] = shift
    series, term = np.tile(np.eye(4), (50, 1, 1)), np.tile(np.eye(4), (50, 1, 1))
    for k in range(1, 40):
        term = term @ twist / k
        series = series + term
    np.testing.assert_allclose(series, pose.to_matrix(q, t), atol=1e-12)
    for got, wanted in zip(exponential(turn, shift), (q, t), strict=True):
        np.testing.assert_allclose(got, wanted, atol=1e-12)


def test_the_exact_mean_halves_a_screw_in_every_frame():
    rng = np.random.default_rng(1)
    q, t = motions(rng, 20, 5, largest=0.8)
    weights = rng.dirichlet(np.ones(5), 20)
    mean = rigid_mean(q, t, weights)
    left, right = motions(rng), motions(rng)
    seen = pose.compose(*left, *pose.compose(q, t, *right))
    expected = pose.compose(*left, *pose.compose(*mean, *right))
    got = rigid_mean(*seen, weights)
    np.testing.assert_allclose(pose.to_matrix(*got), pose.to_matrix(*expected), atol=1e-11)
    chordal = Rotation.from_quat(q[0][:, [1, 2, 3, 0]]).mean(weights[0])
    assert (Rotation.from_quat(mean[0][0, [1, 2, 3, 0]]).inv() * chordal).magnitude() < 0.05


@pytest.mark.parametrize("bits", [4, 8, 16])
def test_steps_give_back_half_a_step(bits):
    values = np.random.default_rng(2).normal(size=(100, 3)).astype(np.float32) * [1, 10, 0]
    back, size = storage.as_steps(bits, values)
    step = np.ptp(values, axis=0) / (2**bits - 1)
    assert (np.abs(back - values) <= step / 2 + 1e-5).all()
    assert np.abs(back - values).max() > step.max() / 8
    assert size == 300 * bits / 8 + 24


def test_a_stored_scene_keeps_its_rules():
    scene = storage.make_scene(120, 32, 18, 0)
    back, size = storage.encode(scene, {}, storage.STEPS[4])
    np.testing.assert_allclose(back.dynamic.weight.sum(1), 1, atol=1e-5)
    assert (back.static.scales > 0).all() and size < storage.encode(scene, {}, storage.FLOAT32)[1] / 2
    assert np.array_equal(back.dynamic.node, scene.dynamic.node)
    same, _ = storage.encode(scene, {}, storage.FLOAT32)
    assert np.array_equal(same.dynamic.weight, scene.dynamic.weight)
    assert replace(same, name="other").name == "other"


def test_zero_stands_below_a_logarithmic_plot_and_words_on_the_other_axis():
    figure = {"title": "t", "x": "way", "y": "error", "series": "", "low": "", "high": "", "log": "y", "front": False}
    rows = [{"way": "exact", "error": 0.0}, {"way": "rough", "error": 0.5}, {"way": "lost", "error": None}]
    drawn = report_page._drawing(figure, rows)
    assert ">0</text>" in drawn and "exact" in drawn and "lost" not in drawn
    assert report_page._drawing(figure | {"where": {"way": "lost"}}, rows) == ""
    assert report_page._drawing(figure | {"where": {"way": "exact"}}, rows).startswith("<svg")
