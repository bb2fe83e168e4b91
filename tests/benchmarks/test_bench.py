"""`f4x bench`: what it prints and that its figures belong to the forms they name."""

import json

import pytest
from toy import clip_and_priors

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


@pytest.mark.usefixtures("native_library")
def test_parts_of_a_step_are_their_own_time_and_add_up_to_it(tmp_path, monkeypatch):
    """Of a short fit of a made-up clip: the parts hold nothing twice, and what is watched is as before afterwards."""
    from dataclasses import replace

    from benchmarks.speed import step
    from f4x_core.fit.config import profile

    short = replace(profile("quick"), steps=24, measure_every=8)
    monkeypatch.setattr(step, "profile", lambda name: short)
    clip, priors = clip_and_priors()
    monkeypatch.setattr(step.ClipFit, "make_priors", lambda fit: priors)
    before = [owner.__dict__[name] for _, owner, names in step.PARTS for name in names]
    report = step.profile_steps(clip, tmp_path, "quick")
    assert before == [owner.__dict__[name] for _, owner, names in step.PARTS for name in names]
    parts = {row["part"]: row for row in report["parts"]}
    assert set(parts) == set(step.PART_NAMES)
    assert all(0 <= row["shareable_ms"] <= 1.001 * row["ms"] for row in parts.values())
    assert parts["raster"]["shareable_ms"] > 0 < report["actions"]["ms"]
    assert sum(row["ms"] for row in parts.values()) < 10 * report["step"]["ms"]
    assert report["gaussians"] > 0
