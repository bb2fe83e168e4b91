"""`f4x bench`: what it prints and that its figures belong to the forms they name."""

import json

import pytest

from benchmarks.speed.deformation import benchmark
from benchmarks.speed.raster import compare_decoding, measure_memory, measure_thread_ceiling
from f4x_core.cli.main import main
from f4x_core.native import measure_peak, open_library


def test_forms_of_the_deformation_agree_and_are_timed():
    report = benchmark((300,), repeats=1)
    names = {row["name"] for row in report["timings"]}
    assert {"gather, with backward", "CSR, with backward", "numpy forward"} <= names
    assert ("native forward" in names) == (open_library()[0] is not None)
    assert 0 < max(report["errors"].values()) < 1e-5


def test_the_verb_prints_one_object(capsys):
    assert main(["bench", "deform", "--counts", "200", "--repeats", "1", "--json"]) == 0
    report = json.loads(capsys.readouterr().out)
    assert report["timings"] and report["ratios"]


def test_the_peak_is_one_of_a_processor():
    library, _ = open_library()
    if library is not None:
        assert 1e8 < measure_peak(library, 0.02) < 1e13


@pytest.mark.slow
def test_a_latent_and_its_memory_are_measured():
    decoding = compare_decoding(50, 32, 24, repeats=1)
    assert abs(decoding["ratio"] - decoding["rendered_ms"] / decoding["decoded_ms"]) < 1e-9
    memory = measure_memory(50_000, 35, 64, 48)
    assert memory is None or 14 < memory < 300  # colours and their gradients alone are 14 MB
    ceiling = measure_thread_ceiling(2, 0.02)
    assert ceiling is None or ceiling > 0  # how much, a loaded machine decides
