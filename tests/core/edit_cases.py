"""Operations of every kind, drawn at random, for tests of edits."""

import numpy as np
from hypothesis import strategies as st

from f4x_core.edit.operations import (
    Blur,
    Delete,
    Duplicate,
    Extract,
    Freeze,
    Glow,
    Grade,
    Loop,
    Match,
    Name,
    Opacity,
    Recolour,
    Retime,
    Reverse,
    Style,
    Swap,
    Transform,
)
from f4x_core.edit.selects import All, Ids, Moving, Named, Not, Or
from f4x_core.edit.styles import STYLES

THINGS = 50
"""Gaussians of `random_scene`."""
numbers = st.integers(-8, 8).map(lambda n: n / 8)
vectors = st.tuples(numbers, numbers, numbers)
shares = st.integers(0, 8).map(lambda n: n / 8)
colours = st.tuples(shares, shares, shares)
frames = st.integers(0, 10).map(lambda n: n / 2)
lasting = st.none()
spans = lasting | st.tuples(frames, lasting | frames).map(lambda s: s if s[1] is None else (min(s), max(s)))
ids = st.sets(st.integers(0, THINGS + 20), min_size=1, max_size=20).map(lambda s: Ids.of(np.array(list(s))))
selects = st.one_of(
    st.just(All()), st.just(Moving()), ids, ids.map(Not), ids.map(lambda i: Or((i, Moving()))), st.just(Named("dog"))
)
looks_operations = st.one_of(
    st.builds(Recolour, selects, colours, st.sampled_from(("assign", "add", "multiply", "hue", "light")), shares,
              st.booleans(), spans),
    st.builds(Opacity, selects, shares.map(lambda s: 2 * s), spans),
    st.builds(Delete, selects, spans),
    st.builds(Extract, selects, spans),
    st.builds(Style, selects, st.sampled_from(sorted(STYLES)), shares, spans),
    st.builds(Match, selects, selects, shares, spans),
    st.builds(Grade, selects, shares.map(lambda s: 2 * s), shares.map(lambda s: 2 * s), numbers, spans),
)  # fmt: skip
transforms = st.builds(
    Transform, selects, translate=vectors, rotate=vectors.map(lambda v: tuple(90 * x for x in v)),
    scale=st.sampled_from((1.0, 0.5, 1.25)), pivot=st.sampled_from(("centroid", "base")) | vectors, frames=spans,
    ease=st.sampled_from(("linear", "smooth", "step")),
)  # fmt: skip
duplicates = st.builds(
    Duplicate, selects, offset=vectors, time_shift=st.sampled_from((0.0, 1.0, -1.5)), count=st.integers(1, 2),
    name=st.sampled_from(("", "dog")),
)  # fmt: skip
blurs = st.builds(Blur, selects, shares, spans)
glows = st.builds(Glow, selects, shares, st.none() | colours, shares, spans)
swaps = st.builds(Swap, selects, selects, vectors, spans, st.sampled_from(("linear", "smooth", "step")))
retimings = st.one_of(
    st.builds(
        lambda s, at, more: Freeze(s, at, None if more is None else at + more), selects, frames, lasting | frames
    ),
    st.builds(Retime, selects, st.sampled_from((0.5, 2.0)), spans, st.sampled_from((None, "linear", "smooth", "soft"))),
    st.builds(Reverse, selects, spans),
    st.builds(Loop, selects, spans.filter(lambda s: s is not None)),
)
operations = st.one_of(
    looks_operations, transforms, duplicates, retimings, blurs, glows, swaps, st.builds(Name, selects, st.just("dog"))
)
stacks = st.lists(operations, max_size=6).map(lambda listed: [Name(Moving(), "dog"), *listed])
