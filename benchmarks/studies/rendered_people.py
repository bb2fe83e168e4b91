"""Rendered people: whether the networks see them, where their joints are, and how far away their bodies are found."""

from __future__ import annotations

from functools import partial
from pathlib import Path

import numpy as np

from f4x_core.clip import read_clip
from f4x_core.evaluation.truth import align_cameras, depth_errors
from f4x_core.priors import Priors, PriorsConfig, build_priors
from f4x_core.priors.synthetic import Truth
from f4x_core.progress import silent
from f4x_core.reading import load_json

from ..halves import PEOPLE
from ..quality.people import PersonScore, score_people
from ..study import Context, Findings, Row, Table
from .clip_studies import PEOPLE_RENDER, render_clips
from .oracle_ladder import prior_errors

COLUMNS = {
    "height": "height, of the picture's",
    "frames": "frames",
    "found": "found in",
    "iou": "J",
    "joints": "joints within 5 %",
    "limb_joints": "shoulders to ankles within 5 %",
    "joint_error": "their median error",
    "crossings": "limbs that overlap",
    "ordered": "nearer one right",
}
"""Field of `PersonScore` -> column."""


def study_people(context: Context) -> Findings:
    """The offline priors of each rendered clip of people, against their truth."""
    clips, skipped = render_clips(context, PEOPLE.every, PEOPLE_RENDER)
    rows: list[Row] = []
    errors: list[Row] = []
    for name, folder in clips.items():
        found = context.step(name, partial(look, folder, context.folder / name))
        about = {"clip": name, "half": PEOPLE.half_of(name)}
        rows += [about | row for row in found["people"]]
        errors.append(about | found["priors"])
    note = (
        "J: mean over all frames that show the person, 0 where nobody was found. Joints: within 5 % of the person's height;"
        " those that another thing hides do not count. Two limbs overlap where their axes pass each other within 6 % of the"
        " height; which is nearer: by the joints in metres."
    )
    tables = [
        Table("people", rows, "Rendered people", note=note),
        Table("priors", errors, "How wrong the offline priors are"),
    ]
    return Findings(tables, skipped=skipped)


def look(folder: Path, work: Path) -> Row:
    """Rows of the people of a rendered clip, and errors of its offline priors; priors are kept below `work`."""
    clip = read_clip(folder / "images")
    true = build_priors(clip, work / "true", PriorsConfig.of("synthetic"))
    offline = build_priors(clip, work / "offline", PriorsConfig())
    models = [person["model"] for person in load_json(folder / "truth.json")["people"]]
    scores = score_people(offline, Truth.read(clip, silent))
    people = [
        {"figure": model} | _row(score) | {"depth error": _depth_error(true, offline, number)}
        for number, (model, score) in enumerate(zip(models, scores, strict=True))
    ]
    return {"people": people, "priors": prior_errors(true, offline)}


def _row(score: PersonScore) -> Row:
    measured = {column: getattr(score, field) for field, column in COLUMNS.items()}
    return {column: None if np.isnan(value) else value for column, value in measured.items()}


def _depth_error(true: Priors, offline: Priors, person: int) -> float | None:
    """Median relative error of the offline depth where a person is truly seen, in the unit of the cameras' alignment."""
    assert true.cameras is not None and offline.cameras is not None
    assert true.depth is not None and offline.depth is not None and true.people is not None
    scale = align_cameras(offline.cameras, true.cameras)[0]
    return depth_errors(scale * offline.depth, true.depth, true.people == person + 1).get("depth_error_moving")
