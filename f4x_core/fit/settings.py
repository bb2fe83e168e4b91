"""Settings by name: every field of a configuration with its value and documentation, and fields set from text.

Works on any frozen dataclass whose fields are settings or dataclasses of settings: `losses.ssim` is the field `ssim` of the group
`losses`. What a value has to be follows from the field's annotation, and from `LIMITS` where that says too little. Needs no torch.
"""

from __future__ import annotations

import ast
import inspect
import math
import re
import textwrap
import types
import typing
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, fields, is_dataclass, replace
from difflib import SequenceMatcher
from fnmatch import fnmatchcase
from itertools import pairwise
from typing import Any, Literal, TypeVar

from ..errors import F4xError

Config = TypeVar("Config")

NUMBER = re.compile(r"[0-9.eE+_-]+")
"""Characters of numbers; `float` would also read words such as `nan` and `infinity`."""


@dataclass(frozen=True)
class Limits:
    """Allowed range of a number; it is always finite."""

    minimum: float = 0
    """Smallest number allowed: nothing that is set here can be negative."""
    maximum: float = math.inf
    """Largest number allowed."""
    above: bool = False
    """True if the number has to exceed `minimum`."""

    def __contains__(self, number: float) -> bool:
        lower = number > self.minimum if self.above else number >= self.minimum
        return lower and number <= self.maximum

    def __str__(self) -> str:
        if self.maximum < math.inf:
            return f"from {self.minimum:g} to {self.maximum:g}"
        return f"above {self.minimum:g}" if self.above else f"{self.minimum:g} or more"


AT_LEAST_ONE, FRACTION, POSITIVE = Limits(1), Limits(0, 1), Limits(above=True)
LIMITS: Mapping[str, Limits] = {
    # Counts and periods of which 0 would divide by zero or leave nothing.
    **dict.fromkeys(("steps", "graph_every", "track_every", "motion_every", "shifts"), AT_LEAST_ONE),
    **dict.fromkeys(("checkpoint_every", "measure_every", "priors.*.gaps", "scaffold.*_nodes"), AT_LEAST_ONE),
    **dict.fromkeys(("scaffold.neighbours", "scaffold.distance_rank", "spawn_*.frames"), AT_LEAST_ONE),
    **dict.fromkeys(("*.max_count", "density_*.min_count", "priors.tracks.count"), AT_LEAST_ONE),
    **dict.fromkeys(("priors.tracks.reseed_every", "priors.threads", "priors.longer_side"), AT_LEAST_ONE),
    **dict.fromkeys(("priors.cameras.keyframes", "priors.cameras.features"), AT_LEAST_ONE),
    # Fractions of the steps, of the clip or of a number.
    **dict.fromkeys(("coarse", "*_from", "harmonics_at", "min_moving_fraction", "nodes.*_at"), FRACTION),
    **dict.fromkeys(("nodes.growth", "nodes.prune_weight", "scaffold.tolerance_fraction"), FRACTION),
    **dict.fromkeys(("density_*.start", "density_*.stop", "density_*.growth", "density_*.prune_opacity"), FRACTION),
    **dict.fromkeys(("priors.motion.threshold", "spawn_*.opacity"), FRACTION),
    "rate_decay_start": Limits(0, 0.99),  # the decay needs some steps
    # Numbers whose logarithm is taken, or by which something is divided.
    **dict.fromkeys(("rates.static.*", "rates.dynamic.*", "rates.node_*", "rates.camera_*"), POSITIVE),
    **dict.fromkeys(("spawn_*.spacing", "spawn_*.scale", "priors.tracks.*spacing", "density_*.max_scale"), POSITIVE),
    **dict.fromkeys(("priors.cameras.focal", "scaffold.tolerance"), POSITIVE),
    **dict.fromkeys(("sh_degree", "max_sh_degree"), Limits(0, 3)),
}
"""Pattern of names -> limits of the numbers; other numbers are 0 or more."""


@dataclass(frozen=True)
class Setting:
    """One field of a configuration."""

    name: str
    """Name, with those of its groups before it: `losses.ssim`."""
    value: Any
    """Value in the configuration that was listed."""
    annotation: Any
    """Type annotation of the field."""
    doc: str
    """The docstring that follows the field, on one line."""

    @property
    def text(self) -> str:
        """The value as `set_fields` reads it."""
        return _as_text(self.value)

    @property
    def kind(self) -> str:
        """Allowed values, in words."""
        return _kind_in_words(self.annotation, self.limits)

    @property
    def limits(self) -> Limits:
        """Allowed range of its numbers."""
        return next((limits for pattern, limits in LIMITS.items() if fnmatchcase(self.name, pattern)), Limits())

    @property
    def settable(self) -> bool:
        """Return True if text can say its value; a mapping of files has an option of its own."""
        return not isinstance(self.value, Mapping)

    def parse(self, text: str) -> Any:
        """Return the value that `text` says; F4xError when it is of another kind."""
        try:
            return _parse(text.strip(), self.annotation, self.limits)
        except ValueError:
            raise F4xError(f"{self.name} must be {self.kind}; got '{text}'.") from None


def list_settings(config: Any, group: str = "") -> list[Setting]:
    """Return every setting of a configuration (a dataclass), in the order of its classes; `group` is put before the names."""
    return list(_walk(config, group))


def set_fields(config: Config, assignments: Sequence[str]) -> Config:
    """Return the configuration with fields set as `assignments` say, in their order.

    Args:
        config: a frozen dataclass of settings; it stays as it is.
        assignments: `NAME=VALUE` each, for example `steps=600`, `losses.ssim=0.2` or `rates.static.means=6e-4,6e-6`.
            Numbers of one field have commas between them; `none` is for fields that may be None; nothing after `=` is an
            empty list where a field may have any number of numbers.

    Raises:
        F4xError: an entry without `=`, an unknown name (the sentence has the nearest one), or a value of another kind.
    """
    settings = list_settings(config)
    values: dict[str, Any] = {}
    for entry in assignments:
        name, separator, text = entry.partition("=")
        if not (separator and name.strip()):
            raise F4xError(f"'{entry}' sets nothing; write NAME=VALUE, for example steps=600.")
        setting = _find(settings, name.strip())
        values[setting.name] = setting.parse(text)
    return _with_values(config, values)


def as_lines(config: Any) -> str:
    """Return all settings for people: `NAME = VALUE  (what it has to be)`, and what it does in the lines below."""
    lines = []
    for setting in list_settings(config):
        lines.append(f"{setting.name} = {setting.text}".rstrip() + f"  ({setting.kind})")
        lines += textwrap.wrap(setting.doc, 110, initial_indent="    ", subsequent_indent="    ")
    return "\n".join(lines)


def field_docs(kind: type) -> dict[str, str]:
    """Return field -> the docstring that follows it in the source of the dataclass `kind`, on one line; others are left out."""
    body = ast.parse(textwrap.dedent(inspect.getsource(kind))).body[0].body  # type: ignore[attr-defined]
    found = {}
    for node, after in pairwise(body):
        documented = isinstance(after, ast.Expr) and isinstance(after.value, ast.Constant)
        if isinstance(node, ast.AnnAssign) and isinstance(node.target, ast.Name) and documented:
            found[node.target.id] = " ".join(str(after.value.value).split())
    return found


def _walk(config: Any, group: str) -> Iterator[Setting]:
    annotations, docs = typing.get_type_hints(type(config)), field_docs(type(config))
    for entry in fields(config):
        name, value = f"{group}{entry.name}", getattr(config, entry.name)
        if is_dataclass(value):
            yield from _walk(value, f"{name}.")
        else:
            yield Setting(name, value, annotations[entry.name], docs.get(entry.name, ""))


def _find(settings: Sequence[Setting], name: str) -> Setting:
    """Return the setting called `name`; F4xError names the nearest one, or says why this one cannot be set."""
    found = next((setting for setting in settings if setting.name == name), None)
    if found is None:
        inside = next((setting.name for setting in settings if setting.name.startswith(f"{name}.")), None)
        if inside is not None:
            raise F4xError(f"'{name}' is a group of settings; name one of them, for example {inside}.")
        nearest = max(settings, key=lambda setting: _similarity(name, setting.name)).name
        raise F4xError(f"There is no setting '{name}'; did you mean {nearest}?")
    if not found.settable:
        raise F4xError(f"'{name}' is no single value; give your own files with --prior NAME=PATH.")
    return found


def _similarity(given: str, known: str) -> float:
    """Return the similarity of two names, 0..1; a name given without its groups is compared with the last parts alone."""
    parts = known.split(".")[-1 - given.count(".") :]
    return SequenceMatcher(None, given, ".".join(parts)).ratio()


def _with_values(config: Any, values: Mapping[str, Any]) -> Any:
    """Return `config` with fields set, all at once: a dataclass may check some of them against each other."""
    changed: dict[str, Any] = {}
    groups: dict[str, dict[str, Any]] = {}
    for name, value in values.items():
        group, dot, inner = name.partition(".")
        if dot:
            groups.setdefault(group, {})[inner] = value
        else:
            changed[name] = value
    changed |= {group: _with_values(getattr(config, group), inside) for group, inside in groups.items()}
    return replace(config, **changed)


def _parse(text: str, annotation: Any, limits: Limits) -> Any:
    """Parse `text` as a value of the annotation; ValueError where it is none."""
    origin, arguments = typing.get_origin(annotation), typing.get_args(annotation)
    if origin in (typing.Union, types.UnionType):
        if type(None) in arguments and text.lower() == "none":
            return None
        (annotation,) = (each for each in arguments if each is not type(None))
        return _parse(text, annotation, limits)
    if origin is Literal:
        return arguments[arguments.index(text)]
    if origin is tuple:
        parts = text.split(",") if text else []
        if not parts and arguments[0] is int:  # frame distances, of which some are needed
            _refuse()
        kinds = [arguments[0]] * len(parts) if arguments[-1] is Ellipsis else arguments
        return tuple(_parse(part.strip(), kind, limits) for part, kind in zip(parts, kinds, strict=True))
    if annotation is bool:
        return {"true": True, "false": False}[text.lower()] if text.lower() in ("true", "false") else _refuse()
    if annotation is str:
        return text or _refuse()
    if not NUMBER.fullmatch(text):
        _refuse()
    number = annotation(text)  # int or float
    return number if math.isfinite(number) and number in limits else _refuse()


def _refuse() -> typing.NoReturn:
    raise ValueError


def _as_text(value: Any) -> str:
    if isinstance(value, bool) or value is None:
        return str(value).lower()
    if isinstance(value, tuple):
        return ",".join(map(_as_text, value))
    if isinstance(value, Mapping):
        return ",".join(f"{name}={path}" for name, path in value.items())
    return str(value)


def _kind_in_words(annotation: Any, limits: Limits) -> str:
    """Describe the allowed values: "a whole number, 1 or more", "true or false", "one of sigma, paper"."""
    origin, arguments = typing.get_origin(annotation), typing.get_args(annotation)
    if origin in (typing.Union, types.UnionType):
        (inner,) = (each for each in arguments if each is not type(None))
        return f"{_kind_in_words(inner, limits)}, or none"
    if origin is Literal:
        return f"one of {', '.join(arguments)}"
    if origin is tuple:
        whole = "whole " if arguments[0] is int else ""
        count = str(len(arguments))
        if arguments[-1] is Ellipsis:
            count = "one or more" if arguments[0] is int else "any number of"
        return f"{count} {whole}numbers with commas between them, each {limits}"
    if origin is not None:
        return "set with --prior NAME=PATH"
    named = {bool: "true or false", str: "text"}
    if annotation in named:
        return named[annotation]
    return f"a {'whole ' if annotation is int else ''}number, {limits}"
