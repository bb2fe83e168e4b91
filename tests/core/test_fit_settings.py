"""Settings by name: all are documented, read back as they are shown, and refused in one sentence when they are wrong."""

import json
from dataclasses import dataclass, field, replace
from fnmatch import fnmatchcase
from pathlib import Path
from typing import Literal

import pytest
from toy import clip_and_priors

from f4x_core.app import fitting
from f4x_core.cli import main
from f4x_core.clip import write_images
from f4x_core.errors import F4xError
from f4x_core.fit.config import PROFILES, FitConfig, for_frames, for_motion, profile
from f4x_core.fit.settings import LIMITS, as_lines, field_docs, list_settings, set_fields

ROOT = Path(__file__).resolve().parents[2]


@dataclass(frozen=True)
class Inner:
    """A group."""

    weight: float = 0.5
    """How heavy
    it is."""
    undocumented: int = 1


@dataclass(frozen=True)
class Outer:
    """A configuration with every kind of setting."""

    steps: int = 3
    """Steps."""
    mode: Literal["fast", "slow"] = "fast"
    """Speed."""
    limit: float | None = None
    """A limit."""
    on: bool = False
    """A switch."""
    title: str = "a"
    """A title."""
    pair: tuple[float, float] = (1.0, 2.0)
    """Two numbers."""
    some: tuple[float, ...] = (1.0,)
    """Some numbers."""
    inner: Inner = field(default_factory=Inner)
    """A group."""


@pytest.mark.parametrize(
    ("assignment", "expected"),
    [
        ("steps=600", {"steps": 600}),
        (" steps = 1_000 ", {"steps": 1000}),
        ("mode=slow", {"mode": "slow"}),
        ("limit=2", {"limit": 2.0}),
        ("limit=6e-4", {"limit": 6e-4}),
        ("limit=None", {"limit": None}),
        ("on=True", {"on": True}),
        ("on=false", {"on": False}),
        ("title=a=b", {"title": "a=b"}),
        ("pair=6e-4,6e-6", {"pair": (6e-4, 6e-6)}),
        ("some=1, 2,3", {"some": (1.0, 2.0, 3.0)}),
        ("some=", {"some": ()}),
        ("inner.weight=0", {"inner": Inner(weight=0.0)}),
    ],
)
def test_text_becomes_a_value_of_the_field_s_kind(assignment, expected):
    changed = set_fields(Outer(), [assignment])
    assert changed == replace(Outer(), **expected)
    for name, value in expected.items():
        assert type(getattr(changed, name)) is type(value)


@pytest.mark.parametrize(
    ("assignment", "words"),
    [
        ("steps", "'steps' sets nothing; write NAME=VALUE"),
        ("=3", "'=3' sets nothing"),
        ("step=3", "There is no setting 'step'; did you mean steps?"),
        ("wieght=3", "did you mean inner.weight?"),
        ("innner.weight=3", "did you mean inner.weight?"),
        ("inner=3", "'inner' is a group of settings; name one of them, for example inner.weight"),
        ("steps=2.5", "steps must be a whole number, 1 or more; got '2.5'"),
        ("steps=0", "steps must be a whole number, 1 or more; got '0'"),
        ("steps=", "steps must be a whole number, 1 or more; got ''"),
        ("steps=none", "steps must be a whole number"),
        ("steps=٣", "steps must be a whole number"),
        ("mode=medium", "mode must be one of fast, slow; got 'medium'"),
        ("limit=nan", "limit must be a number, 0 or more, or none; got 'nan'"),
        ("limit=inf", "got 'inf'"),
        ("limit=1e999", "got '1e999'"),
        ("limit=-1", "got '-1'"),
        ("on=1", "on must be true or false; got '1'"),
        ("title=", "title must be text; got ''"),
        ("pair=1", "pair must be 2 numbers with commas between them, each 0 or more; got '1'"),
        ("pair=1,2,3", "got '1,2,3'"),
        ("pair=1,", "got '1,'"),
        ("some=1,,2", "some must be any number of numbers with commas"),
        ("some=1,nan", "got '1,nan'"),
        ("inner.weight=x", "inner.weight must be a number, 0 or more; got 'x'"),
    ],
)
def test_what_is_wrong_is_refused_in_one_sentence(assignment, words):
    with pytest.raises(F4xError) as error:
        set_fields(Outer(), [assignment])
    assert words in str(error.value)


def test_the_last_of_two_wins_and_the_configuration_stays_as_it_was():
    config = Outer()
    assert set_fields(config, ["steps=4", "inner.undocumented=2", "steps=5"]).steps == 5
    assert config == Outer() and set_fields(config, []) == config


def test_clips_of_many_frames_take_as_many_steps_for_each_and_numbers_set_by_hand_stay():
    quick = profile("quick")
    assert [for_frames(quick, frames).steps for frames in (3, 100, 101, 300)] == [800, 800, 808, 2400]
    assert for_frames(replace(quick, steps=50), 300).steps == 50
    long = for_frames(replace(quick, spawn_dynamic=replace(quick.spawn_dynamic, max_count=7)), 300)
    assert (long.spawn_dynamic.max_count, long.density_dynamic.max_count) == (7, 3 * quick.density_dynamic.max_count)
    assert (long.spawn_static, long.density_static) == (quick.spawn_static, quick.density_static)


@pytest.mark.parametrize(("fraction", "moving"), [(0.2, None), (0.25, None), (0.4, 0.4), (0.7, 0.5)])
def test_what_is_large_and_moves_gets_room_of_what_stands(fraction, moving):
    long = for_frames(profile("wild"), 150)
    found = for_motion(long, fraction, 150)
    for stage in ("spawn", "density"):
        before, after = (
            [getattr(config, f"{stage}_{kind}").max_count for kind in ("static", "dynamic")] for config in (long, found)
        )
        assert sum(before) == sum(after)
        assert after[1] == (before[1] if moving is None else round(moving * sum(before)))
    room = replace(found, **{name: getattr(long, name) for name in ("spawn_static", "spawn_dynamic")})
    assert replace(room, density_static=long.density_static, density_dynamic=long.density_dynamic) == long


def test_room_that_was_set_by_hand_stays_where_it_is():
    quick = profile("quick")
    own = replace(quick, density_dynamic=replace(quick.density_dynamic, max_count=7))
    assert for_motion(own, 0.6, 50) == own
    granted = replace(own, counts_from="--memory 2")
    assert for_motion(granted, 0.6, 50).density_dynamic.max_count > 7
    assert (
        for_motion(replace(granted, own_counts=("density_dynamic.max_count",)), 0.6, 50).density_dynamic.max_count == 7
    )


def test_docstrings_of_fields_are_read_from_the_source():
    assert field_docs(Inner) == {"weight": "How heavy it is."}


@pytest.mark.parametrize("name", PROFILES)
def test_every_setting_of_a_profile_is_documented_and_read_back_as_it_is_shown(name):
    config = profile(name)
    settings = list_settings(config)
    assert [setting.name for setting in settings if not setting.doc] == []
    shown = [f"{setting.name}={setting.text}" for setting in settings if setting.settable]
    assert len(shown) == len(settings) - 1  # the user's own files have --prior
    assert set_fields(config, shown) == config
    lines = as_lines(config)
    assert f"steps = {config.steps}  (a whole number, 1 or more)\n    Steps of the joint" in lines


def test_every_limit_is_about_a_setting():
    names = [setting.name for setting in list_settings(FitConfig())]
    assert [pattern for pattern in LIMITS if not any(fnmatchcase(name, pattern) for name in names)] == []


def test_settings_of_the_fit_are_set_by_name():
    names = ["priors.tracks.count=99", "losses.ssim=0", "rates.static.means=6e-4,6e-6", "scaffold.kernel=paper"]
    config = set_fields(profile("quick"), [*names, "shifts=1,2", "shift_weights=.5,.5", "sh_degree=2"])
    assert config.priors.tracks.count == 99 and config.priors.tracks.spacing == 8.0
    assert config.losses.ssim == 0 and config.rates.static.means == (6e-4, 6e-6) and config.scaffold.kernel == "paper"
    assert config.shifts == (1, 2) and config.sh_degree == 2 and config.steps == profile("quick").steps


@pytest.mark.parametrize("assignment", ["priors.tracks.gaps=", "rates.node_xyz=0,0", "harmonics_at=.5", "coarse=2"])
def test_what_a_fit_would_fail_on_is_refused(assignment):
    with pytest.raises(F4xError, match=r"must be .*; got"):
        set_fields(FitConfig(), [assignment])


def test_files_of_the_user_have_their_own_option():
    with pytest.raises(F4xError, match="give your own files with --prior NAME=PATH"):
        set_fields(FitConfig(), ["priors.files=depth"])


def test_shift_weights_must_match_the_shifts():
    with pytest.raises(F4xError, match="shifts has 2 numbers and shift_weights 3"):
        FitConfig(shifts=(1, 2))


def test_show_config_needs_no_clip(capsys):
    assert main(["fit", "--show-config", "--profile", "quick", "--set", "steps=77", "--seed", "5"]) == 0
    text = capsys.readouterr().out
    assert "\nsteps = 77  (" in text and "\nseed = 5  (" in text and "\ndensity_static.max_count = 200000  (" in text
    assert main(["fit", "--show-config", "--json", "--set", "rates.static.means=1,2"]) == 0
    rows = json.loads(capsys.readouterr().out)["config"]
    assert rows["rates.static.means"] == {
        "value": [1.0, 2.0],
        "kind": "2 numbers with commas between them, each above 0",
        "help": "Places, at depth 1.",
    }
    assert rows["priors.files"]["value"] == {}


def test_a_fit_gets_what_was_set_after_all_other_options(tmp_path, monkeypatch, capsys):
    write_images(tmp_path / "clip", clip_and_priors()[0].frames)
    given = []

    def fit(clip, folder, config, *_):
        given.append(config)
        raise F4xError("That is enough.")

    monkeypatch.setattr(fitting, "fit_at_once", fit)
    arguments = ["--seed", "1", "--profile", "quick", "--set", "steps=600", "--set", "seed=2"]
    assert main(["fit", str(tmp_path / "clip"), "-o", str(tmp_path / "out"), *arguments]) == 2
    assert given == [replace(profile("quick"), steps=600, seed=2)]


@pytest.mark.parametrize(("arguments", "missing"), [([], "clip, -o/--output"), (["x"], "-o/--output")])
def test_a_fit_needs_a_clip_and_a_place(arguments, missing, capsys):
    assert main(["fit", *arguments]) == 2
    assert f"the following arguments are required: {missing}; `f4x fit --help`" in capsys.readouterr().err
