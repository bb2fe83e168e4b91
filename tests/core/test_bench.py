"""`f4x bench`: what it prints and that its figures belong to the forms they name."""

import json

from f4x_core.cli.main import main
from f4x_core.native import measure_peak, open_library
from f4x_core.scaffold.benchmark import benchmark


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
