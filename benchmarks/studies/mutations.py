"""Does a test notice when a formula is wrong? Formulas are broken one at a time in a copy of the source, and the tests of their
room are run on it."""

from __future__ import annotations

import re
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

from f4x_core.errors import F4xError

from ..study import Context, Findings, MissingError, Table

ROOT = Path(__file__).resolve().parents[2]
"""Of a checkout, where the tests lie beside the package."""
COPIED = ("f4x_core", "benchmarks", "tests", "pyproject.toml", "__init__.py")
FAILED = re.compile(r"^(?:FAILED|ERROR) (\S+)", re.MULTILINE)
NONE_LEFT = 5
"""pytest's exit code where no test is left to run."""


@dataclass(frozen=True)
class Mutation:
    """One wrong formula."""

    formula: str
    wrong: str
    """What is wrong with it, in words."""
    file: str
    """Inside `f4x_core`."""
    old: str
    """Source that occurs exactly once in the file."""
    new: str
    tests: tuple[str, ...]
    """Files under `tests/core` that ought to notice."""


ROTATION, CAMERA, HARMONICS = "test_geometry_rotation.py", "test_geometry_camera.py", "test_geometry_harmonics.py"
RASTER = ("test_raster_backends.py",)
MUTATIONS = (
    Mutation(
        "Hamilton product",
        "one sign",
        "geometry/quaternion.py",
        "aw * by - ax * bz + ay * bw + az * bx",
        "aw * by + ax * bz + ay * bw + az * bx",
        (ROTATION,),
    ),
    Mutation(
        "dual part (0, t) q / 2",
        "without the half",
        "geometry/dual_quaternion.py",
        "dual = 0.5 * quaternion.multiply(pure, q)",
        "dual = quaternion.multiply(pure, q)",
        (ROTATION,),
    ),
    Mutation(
        "pixels to world points",
        "rotation transposed",
        "geometry/camera.py",
        "return local @ like(matrix[:3, :3].T, pixels)",
        "return local @ like(matrix[:3, :3], pixels)",
        (CAMERA,),
    ),
    Mutation(
        "spherical harmonics, degree 2",
        "a constant of another band",
        "geometry/spherical_harmonics.py",
        "C2 = (1.0925484305920792, 0.31539156525252005, 0.5462742152960396)",
        "C2 = (1.0925484305920792, 0.31539156525252005, 1.0925484305920792)",
        (HARMONICS,),
    ),
    Mutation(
        "covariance of the image ellipse",
        "rotation of the view transposed",
        "raster/projection.py",
        "rotation = viewmat[:3, :3]",
        "rotation = viewmat[:3, :3].t()",
        RASTER,
    ),
    Mutation(
        "alpha = o exp(-q / 2)",
        "without the half",
        "raster/reference.py",
        "torch.exp(-0.5 * torch.einsum",
        "torch.exp(-1.0 * torch.einsum",
        RASTER,
    ),
    Mutation(
        "determinant with blur",
        "blur squared left out",
        "raster/projection.py",
        "config.blur * (var_x + var_y) + config.blur**2",
        "config.blur * (var_x + var_y)",
        RASTER,
    ),
    Mutation(
        "skinning weight exp(-d^2 / 2 s^2)",
        "without the 2",
        "scaffold/skinning.py",
        "xp.exp(-0.5 * squared",
        "xp.exp(-1.0 * squared",
        ("test_scaffold_deformation.py", "test_scaffold_curves.py"),
    ),
    Mutation(
        "dual-quaternion blend",
        "signs not aligned",
        "scaffold/deformation/reference.py",
        "signed = xp.where(dots < 0, -weights, weights)",
        "signed = weights",
        ("test_scaffold_deformation.py",),
    ),
    Mutation(
        "distance of curves: the maximum over time",
        "the minimum",
        "scaffold/distance.py",
        "chosen = squared.max(axis=1)",
        "chosen = squared.min(axis=1)",
        ("test_scaffold_curves.py",),
    ),
    Mutation(
        "ARAP: mean over the edges of a node",
        "not divided by their number",
        "scaffold/losses.py",
        "level.weight / np.bincount(level.node, minlength=nodes)[level.node] / nodes",
        "level.weight * np.ones(len(level.node)) / nodes",
        ("test_scaffold_fit.py",),
    ),
    Mutation(
        "depth loss: alpha / sum z a T",
        "not normalised by alpha",
        "fit/losses.py",
        "inverse = alpha / depth.clamp_min(1e-3)",
        "inverse = 1 / depth.clamp_min(1e-3)",
        ("test_fit_losses.py",),
    ),
    Mutation(
        "softmax(cosine / temperature)",
        "multiplied by the temperature",
        "query/score.py",
        "logits = cosines(features, labels) / temperature",
        "logits = cosines(features, labels) * temperature",
        ("test_query_score.py",),
    ),
    Mutation(
        "3DGS PLY: opacity as a logit",
        "sign",
        "scene/ply.py",
        "np.log(opacity / (1 - opacity))",
        "np.log((1 - opacity) / opacity)",
        ("test_scene_ply.py",),
    ),
    Mutation(
        "retimed clip: begin + speed (t - begin)",
        "without begin",
        "edit/retiming.py",
        "return min(begin + speed * (min(time, stop) - begin)",
        "return min(speed * (min(time, stop) - begin)",
        ("test_edit_apply.py",),
    ),
)


def measure_mutations(context: Context) -> Findings:
    """Which test catches which wrong formula; all of them in a full report, the first five in a quick one.

    The tests are run on the unbroken copy first: what fails there catches nothing.
    """
    if not (ROOT / "tests" / "core").is_dir():
        raise MissingError("the tests come with the source code, not with the package.")
    chosen = context.choose(MUTATIONS[:5], MUTATIONS)
    files = sorted({name for mutation in chosen for name in mutation.tests})
    failing = context.step("control", partial(failing_tests, files), files=files)
    rows = []
    for number, mutation in enumerate(chosen):
        about = {"formula": mutation.formula, "wrong": mutation.wrong, "file": mutation.file}
        work = partial(try_mutation, mutation, failing=failing)
        rows.append(about | context.step(f"{number:02d}", work, failing=failing, **about))
    missed = [f"{row['formula']} ({row['wrong']}): no test notices" for row in rows if not row["caught by"]]
    words = [f"{len(rows) - len(missed)} of {len(rows)} wrong formulas are caught by a test of the everyday suite."]
    note = (
        "The first test that failed, of those that pass on the unbroken copy; each formula was broken in a copy of the source and"
        " put right again."
    )
    broken = [f"{test} fails before any formula is broken, so that it can catch none" for test in failing]
    return Findings(
        [Table("mutations", rows, "Formulas broken on purpose", note=note)], words=words, failed=broken + missed
    )


def failing_tests(files: Sequence[str], root: Path = ROOT) -> list[str]:
    """Tests in `files` of `tests/core` that fail in an unbroken copy of `root`.

    Raises:
        F4xError: the tests did not run.
    """
    with tempfile.TemporaryDirectory() as place:
        return _run_tests(_copy_source(root, Path(place)), files, "without any change")


def try_mutation(mutation: Mutation, root: Path = ROOT, failing: Sequence[str] = ()) -> dict[str, Any]:
    """Break one formula in a copy of `root` and run its tests there, but those that are `failing` anyway.

    Returns:
        `caught by`: the first test that failed, None where all passed.

    Raises:
        F4xError: the formula is no longer written as the mutation has it, or the tests did not run.
    """
    with tempfile.TemporaryDirectory() as place:
        copy = _copy_source(root, Path(place))
        file = copy / "f4x_core" / mutation.file
        text = file.read_text(encoding="utf-8")
        if text.count(mutation.old) != 1:
            raise F4xError(
                f"{mutation.file}: `{mutation.old}` is not there once; bring benchmarks/studies/mutations.py up to date."
            )
        file.write_text(text.replace(mutation.old, mutation.new), encoding="utf-8")
        options = ["-x", *(f"--deselect=tests/core/{test}" for test in failing)]
        found = _run_tests(copy, mutation.tests, mutation.formula, options)
    return {"caught by": found[0] if found else None}


def _copy_source(root: Path, place: Path) -> Path:
    copy = place / "source"
    copy.mkdir()
    for name in COPIED:
        if (root / name).is_dir():
            shutil.copytree(root / name, copy / name, ignore=shutil.ignore_patterns("__pycache__"))
        else:
            shutil.copy(root / name, copy / name)
    return copy


def _run_tests(copy: Path, files: Sequence[str], about: str, options: Sequence[str] = ()) -> list[str]:
    """Which tests of `files` failed in `copy`, in order; F4xError where they did not run."""
    command = [sys.executable, "-m", "pytest", "-q", "-rfE", "-p", "no:cacheprovider", "-m", "not slow", *options]
    command += [f"tests/core/{name}" for name in files]
    done = subprocess.run(command, cwd=copy, capture_output=True, text=True, check=False)
    found = [test.removeprefix("tests/core/") for test in FAILED.findall(done.stdout)]
    if done.returncode not in (0, 1, NONE_LEFT) or (done.returncode == 1) != bool(found):
        raise F4xError(f"{about}: the tests did not run: {done.stdout[-200:]}{done.stderr[-200:]}")
    return found
