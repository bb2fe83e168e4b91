"""Specs and map folders: both ways, projected, cut short, damaged; and that they need numpy alone."""

import dataclasses
import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from f4x_core.errors import Cancelled, F4xError
from f4x_core.features.maps import MapsPlan, read_maps, write_maps
from f4x_core.features.spec import FeatureSpec

SPEC = FeatureSpec(
    "text", 6, (3, 4), "area", True, "minilm", 0.1, provenance={"model": "none", "licence": "CC0", "input": [8, 6]}
)
PLAIN = dataclasses.replace(SPEC, name="plain", normalised=False)


def low_rank(count=5, rank=2, noise=0.0, seed=0):
    """(T,3,4,6) maps whose cells lie on a plane of `rank` directions around a mean."""
    rng = np.random.default_rng(seed)
    cells = rng.normal(size=(count, 3, 4, rank)) @ rng.normal(size=(rank, 6)) + rng.normal(size=6)
    return (cells + noise * rng.normal(size=(count, 3, 4, 6))).astype(np.float32)


def test_spec_survives_json():
    assert FeatureSpec.from_json(json.loads(json.dumps(SPEC.to_json()))) == SPEC
    assert FeatureSpec.from_json({"name": "x", "dim": 1, "grid": [1, 1]}).resize == "bilinear"


@pytest.mark.parametrize(
    ("change", "word"),
    [
        ({"colour": 1}, "colour"),
        ({"dim": None}, "dim"),
        ({"dim": True}, "dim"),
        ({"dim": 0}, "0 channels"),
        ({"grid": [3]}, "grid"),
        ({"grid": [3.5, 4]}, "grid"),
        ({"resize": "cubic"}, "cubic"),
        ({"temperature": 0}, "temperature"),
        ({"name": "../up"}, "../up"),
    ],
)
def test_wrong_specs_are_told(change, word):
    with pytest.raises(F4xError, match=word.replace(".", r"\.")):
        FeatureSpec.from_json(SPEC.to_json() | change)


def test_a_spec_lacks_nothing_silently():
    data = SPEC.to_json()
    del data["grid"]
    with pytest.raises(F4xError, match="grid"):
        FeatureSpec.from_json(data)


def test_maps_come_back_in_half_precision(tmp_path):
    frames = low_rank()
    maps = write_maps(tmp_path / "plain", MapsPlan(PLAIN, 5), frames)
    assert isinstance(maps.stored, np.memmap) and maps.stored.dtype == np.float16 and maps.lost == 0
    np.testing.assert_array_equal(maps.at(3), frames[3].astype(np.float16).astype(np.float32))
    assert read_maps(tmp_path / "plain").spec == PLAIN and len(maps) == 5
    with pytest.raises(F4xError, match="no frame 5"):
        maps.at(5)


def test_a_projection_keeps_what_lies_in_its_plane(tmp_path):
    frames = low_rank(rank=2)
    maps = write_maps(tmp_path / "plain", MapsPlan(PLAIN, 5, rank=2), frames)
    assert maps.stored.shape == (5, 3, 4, 2)
    np.testing.assert_allclose(maps.basis @ maps.basis.T, np.eye(2), atol=1e-6)
    assert maps.lost < 1e-5
    np.testing.assert_allclose(maps.at(1), frames[1], atol=0.01)


def test_a_projection_says_what_it_loses(tmp_path):
    frames = low_rank(rank=3, noise=0.3)
    maps = write_maps(tmp_path / "plain", MapsPlan(PLAIN, 5, rank=1), frames)
    cells = frames.reshape(-1, 6).astype(np.float64)
    rest = cells - np.stack([maps.at(t) for t in range(5)]).reshape(-1, 6)
    assert maps.lost == pytest.approx((rest**2).sum() / ((cells - cells.mean(0)) ** 2).sum(), rel=0.01)
    assert maps.lost > 0.05


def test_a_rank_that_saves_nothing_is_not_taken(tmp_path):
    assert write_maps(tmp_path / "plain", MapsPlan(PLAIN, 5, rank=6), low_rank()).basis is None


def test_the_clips_own_vector_is_asked_for_after_the_last_frame(tmp_path):
    seen = []
    frames = (seen.append(t) or frame for t, frame in enumerate(low_rank()))
    spec = dataclasses.replace(PLAIN, has_global=True)
    maps = write_maps(tmp_path / "plain", MapsPlan(spec, 5), frames, glob=lambda: np.full(6, len(seen)))
    np.testing.assert_array_equal(maps.glob, np.full(6, 5))


def broken(kind):
    frames = low_rank()
    if kind == "few":
        return frames[:4]
    if kind == "many":
        return np.concatenate([frames, frames])
    if kind == "shape":
        return frames[..., :5]
    frames[2, 0, 0, 0] = {"nan": np.nan, "large": 1e6}[kind]
    return frames


@pytest.mark.parametrize("kind", ["few", "many", "shape", "nan", "large"])
def test_wrong_frames_leave_what_was_there(tmp_path, kind):
    before = write_maps(tmp_path / "plain", MapsPlan(PLAIN, 5), low_rank(seed=1)).at(0)
    with pytest.raises(F4xError):
        write_maps(tmp_path / "plain", MapsPlan(PLAIN, 5), broken(kind))
    assert [path.name for path in tmp_path.iterdir()] == ["plain"]
    np.testing.assert_array_equal(read_maps(tmp_path / "plain").at(0), before)


@pytest.mark.parametrize("stage", ["features plain", "features plain, rank 2"])
def test_stopping_leaves_nothing_half_written(tmp_path, stage):
    def progress(name, done, total, message=""):
        if name == stage and done == 3:
            raise Cancelled

    with pytest.raises(Cancelled):
        write_maps(tmp_path / "plain", MapsPlan(PLAIN, 5, rank=2), low_rank(), progress=progress)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.skipif(sys.platform == "win32", reason="limits of POSIX")
@pytest.mark.parametrize("rank", [None, 4])
def test_a_full_disk_is_one_sentence_and_leaves_nothing(tmp_path, rank):
    program = f"""
import resource, sys
import numpy as np
from f4x_core.errors import F4xError
from f4x_core.features.maps import MapsPlan, write_maps
from f4x_core.features.spec import FeatureSpec
resource.setrlimit(resource.RLIMIT_FSIZE, (10_000, 10_000))
try:
    write_maps(sys.argv[1], MapsPlan(FeatureSpec("plain", 6, (30, 40)), 5, {rank}), np.zeros((5, 30, 40, 6)))
except F4xError as error:
    sys.exit(str(error))
"""
    root = Path(__file__).resolve().parents[2]
    command = [sys.executable, "-c", program, str(tmp_path / "plain")]
    result = subprocess.run(command, cwd=root, capture_output=True, text=True)
    assert result.returncode == 1 and "cannot be written" in result.stderr and "Traceback" not in result.stderr
    assert list(tmp_path.iterdir()) == []


def test_a_second_writer_of_one_folder_is_refused(tmp_path):
    def frames(first):
        with pytest.raises(F4xError, match="another program is writing"):
            write_maps(tmp_path / "maps", MapsPlan(PLAIN, 5), lambda _: low_rank())
        yield from low_rank()[first:]

    write_maps(tmp_path / "maps", MapsPlan(PLAIN, 5), frames)
    assert [file.name for file in tmp_path.iterdir()] == ["maps"]


def test_a_foreign_folder_is_not_replaced(tmp_path):
    (tmp_path / "plain").mkdir()
    (tmp_path / "plain" / "thesis.txt").write_text("years of work")
    with pytest.raises(F4xError, match="something else"):
        write_maps(tmp_path / "plain", MapsPlan(PLAIN, 5), low_rank())
    assert (tmp_path / "plain" / "thesis.txt").exists()


@pytest.mark.parametrize("name", ["spec.json", "maps.npy", "basis.npy", "mean.npy", "stored.json"])
@pytest.mark.parametrize("damage", ["cut", "gone", "noise"])
def test_damage_is_told_with_the_file(tmp_path, name, damage):
    write_maps(tmp_path / "plain", MapsPlan(PLAIN, 5, rank=2), low_rank())
    path = tmp_path / "plain" / name
    if damage == "gone":
        path.unlink()
        if name == "stored.json":
            assert read_maps(tmp_path / "plain").lost == 0  # a foreign tool writes none
            return
    else:
        path.write_bytes(path.read_bytes()[:-7] if damage == "cut" else b"\x93NUMPY noise")
    with pytest.raises(F4xError) as caught:
        read_maps(tmp_path / "plain")
    assert "plain" in str(caught.value)


def test_shapes_that_contradict_the_spec_are_told(tmp_path):
    write_maps(tmp_path / "plain", MapsPlan(PLAIN, 5), low_rank())
    np.save(tmp_path / "plain" / "maps.npy", low_rank()[:, :2].astype(np.float16))
    with pytest.raises(F4xError, match=r"maps\.npy"):
        read_maps(tmp_path / "plain")
