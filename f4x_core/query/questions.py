"""Answers to questions about a scene: computed from what it knows, or by a server that is shown rendered frames."""

from __future__ import annotations

import re
from collections.abc import Collection, Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from itertools import pairwise
from typing import Any, Protocol

import numpy as np

from ..errors import F4xError
from ..geometry.arrays import evenly_spaced
from ..geometry.trajectory import Trajectory, original
from ..language.cast_words import caster, is_cast
from ..language.compounds import ADJECTIVE, head_of, is_adjective, names_another
from ..language.grammar import read_as_meant
from ..language.lexicon import FUNCTION_WORDS, is_adverb, spellings, word_set
from ..scene import Scene
from ..scene.people import single_people
from ..scene.view import render
from .camera_words import camera_words
from .cast import moving_things, with_untaught
from .chat import ChatServer, image_part
from .connected_objects import SIDEWAYS, pick_object, separate_objects, way_across, width_along
from .engines import BARE, Engines
from .inventory import find, instead, is_doubtful, labels_of, things_there
from .knowledge import lacks_people, refuse_unknown
from .labels import Encode
from .measures import Comparison, Measured, measure, single_ones, times_of
from .not_deleted import not_deleted
from .people import each_person, in_ordinals, is_of_people, remarks_on
from .pixels import head_map
from .selection import SELECTED, Selection
from .wording import CLIP_FACTS, INSTEAD, ONE_BY_ONE, ONE_OF_SEVERAL, Asked, Unanswerable, read_question

COMPUTED, SERVER = "computed", "server"
"""Values of `Answer.answered_by`, besides names of models."""
VIEWS = 8
"""Views, evenly over the trajectory, that are looked at."""
COLUMNS = 96
"""Width in pixels of the pictures on which things are found."""
SEEN = 0.5
"""Minimum blend weight of an object in a pixel for the pixel to be its own."""
PRESENT = 0.005
"""Fraction of the picture that a thing must fill in a view to be seen there."""
MOMENTS = 24
"""Clip times, evenly over what is asked about, at which places are taken for motion."""
STILL = 0.03
"""World units a second (1 = median depth) below which a thing stands still: about what jitter of the fit gives."""
WINDOW = 0.25
"""Seconds before and after a moment that tell whether something moves at it."""
THING = "something unnamed"
"""What moving things are called that the scene has no word for."""
NO_PEOPLE = (
    "The fit of this scene found no people and its words know none, so whether anybody is there I cannot tell; `f4x distill SCENE"
    " --teacher NAME` adds a teacher that may."
)
"""The answer about people in a scene that `lacks_people`."""
PERHAPS = "what may be "
"""How a thing is called whose word is doubtful (`inventory.is_doubtful`)."""


@dataclass(frozen=True)
class Sighting:
    """Place, size and motion of one object over the views."""

    label: str
    """The thing."""
    chosen: int
    """Number of its Gaussians."""
    best: float
    """Largest score of any Gaussian for the label, 0..1."""
    share: float = 0.0
    """Largest fraction of the picture, 0..1."""
    time: float = 0.0
    """Clip time of the view in which it is largest."""
    place: str = ""
    """Where in the picture, in that view: on the left, in the middle or on the right."""
    distance: str = ""
    """near, at middle distance, or far, against the median depth of that view."""
    path: float = 0.0
    """World units (1 = median depth) that the centre of its moving Gaussians travels."""
    frames: tuple[int, int] | None = None
    """First and last clip frame between which it moves; None = it stands still."""
    heading: str = ""
    """Where it goes in the picture: to the left, right, or nothing."""
    moments: list[float] = field(default_factory=list)
    """Clip times of the views that show it."""
    unseen: list[float] = field(default_factory=list)
    """Clip times of the views that do not."""
    note: str = ""
    """What the answer about it leaves open."""
    sizes: list[tuple[float, float]] = field(default_factory=list)
    """World units up and across the picture of each separate one, from left to right, at the first time."""
    given: bool = False
    """True if the label takes no article: a name that somebody gave, a thing without a word or with a doubtful one."""


@dataclass(frozen=True)
class Answer:
    """An answer, who gave it, and on what grounds."""

    text: str
    """For people."""
    answered_by: str
    """`computed`, `server`, or the name of a model."""
    evidence: dict[str, Any]
    """JSON: the sightings, or the number of frames that were sent and where to."""


def answer(
    scene: Scene,
    question: str,
    trajectory: Trajectory | None = None,
    engines: Engines = BARE,
    *,
    names: Mapping[str, Selection] | None = None,
    agreed: bool = False,
) -> Answer:
    """Answer `question` about what `trajectory` (the clip's own views when None) shows.

    With `engines.server` rendered frames are sent there. Without, the answer is computed from words, places and motion in the
    scene, and says so; a thing is there when `inventory.find` finds it, as `f4x query --text` does, or under one of the `names`
    that the caller knows. "It", and "the selection", are the one called `SELECTED`. `agreed`: a doubtful question is read as what
    was probably meant, where `language.grammar.Doubt` would ask. Raises F4xError: an empty question, a time beyond the clip, a
    server that does not answer, a word that nobody knows, a selection of another scene; `wording.Unanswerable` for what cannot be
    computed.
    """
    question = " ".join(question.split())
    if not question:
        raise F4xError('The question is empty; ask something, for example "What moves?".')
    trajectory = original(scene.cameras) if trajectory is None else trajectory
    views = _spread(trajectory)
    if engines.server is not None:
        return ask_server(scene, question, views, engines.server, engines)
    known = dict(names or {})
    it = SELECTED if SELECTED in known else ""
    if it:
        known[it].require_scene(scene)
        known[it] = known[it].for_ids(scene.ids)
    evidence: list[dict[str, Any]] = []
    question, people = in_ordinals(scene, question, "question", selected=known[it].chosen if it else None, names=known)
    labels = with_untaught(scene, [*labels_of(scene), *people, *known])
    understood, mended = read_as_meant(
        lambda text: read_question(text, scene.fps, len(scene.cameras), it, labels), question, agreed
    )
    sentences = [*mended]
    for asked in (one for read in understood for one in _for_each_person(scene, read, known)):
        sentence, grounds = _computed(scene, asked, trajectory, known, engines)
        sentences.append(sentence)
        evidence += [{"asked": asked.kind, "span": asked.span, **one} for one in grounds]
    named = [name for one in evidence for name in one.get("things") or [one.get("label", "")] if name not in known]
    sentences += remarks_on(scene, named)
    limits = (
        "words, places and motion in the scene" if labels_of(scene) else "motion in the scene, which knows no words"
    )
    different = " ".join(dict.fromkeys(sentences))  # what is not there is missing from every part of the question
    text = f"{different} (Computed from {limits}; no language model was asked.)"
    return Answer(text, COMPUTED, {"views": len(views), "sightings": evidence})


def _computed(
    scene: Scene, asked: Asked, trajectory: Trajectory, names: Mapping[str, Selection], engines: Engines
) -> tuple[str, list[dict[str, Any]]]:
    """Return the sentence that answers one question, and its evidence."""
    if any(thing not in names and lacks_people(scene, thing) for thing in asked.things):
        return NO_PEOPLE, []
    if _compares(asked):
        engines.progress("looking at the scene", 0, 0)
        sentence, things = _compared(scene, asked, engines.encode, names)
        return sentence, [{"things": things}]
    found = [] if asked.kind in CLIP_FACTS else _look_for(scene, asked, trajectory, names, engines)
    return compose(scene, asked, found, engines.encode), [asdict(sighting) for sighting in found]


def _for_each_person(scene: Scene, asked: Asked, names: Collection[str]) -> list[Asked]:
    """Return `asked` about the single people in place of all: in one question where it takes any number of things.

    Several kinds are counted one by one.
    """
    if asked.kind == "count":
        return [replace(asked, things=(thing,)) for thing in asked.things] or [asked]
    people = {thing: each_person(scene, thing) for thing in asked.things if thing not in names}
    everybody = next((thing for thing in people if people[thing]), None)
    if everybody is None:
        return [asked]

    def swapped(part: Sequence[str], singles: list[str]) -> tuple[str, ...]:
        return tuple(one for thing in part for one in (singles if thing == everybody else [thing]))

    together = not _compares(asked) or (asked.kind in OF_MANY and not asked.polar)
    groups = [people[everybody]] if together else [[one] for one in people[everybody]]
    return [replace(asked, things=swapped(asked.things, group), other=swapped(asked.other, group)) for group in groups]


def _compares(asked: Asked) -> bool:
    """Return True for a question that `_compared` answers."""
    return asked.kind in COMPARED or bool(asked.extreme or (asked.kind == "order" and (asked.manner or asked.among)))


def ask_server(scene: Scene, question: str, views: Trajectory, server: ChatServer, engines: Engines = BARE) -> Answer:
    """Show a server the rendered `views` and pass its answer on."""
    content: list[dict[str, Any]] = []
    for done, (camera, time) in enumerate(views):
        engines.progress("render", done, len(views))
        image = render(scene, camera, time, ("rgb",), engines.backend)["rgb"]
        content.append({"type": "text", "text": f"Frame at {time / scene.fps:.2f} s:"})
        content.append(image_part((np.clip(image, 0, 1) * 255 + 0.5).astype(np.uint8)))
    content.append({"type": "text", "text": question})
    engines.progress("ask", 0, 0, server.url)
    text = server.complete([{"role": "user", "content": content}])
    return Answer(text, SERVER, {"frames": len(views), "url": server.url, "model": server.model})


class FeatureReader(Protocol):
    """A model that answers from feature maps of frames."""

    name: str
    """What `Answer.answered_by` says."""

    def answer(self, features: Sequence[np.ndarray], seconds: Sequence[float], question: str) -> str:
        """Return the model's answer about frames with maps (h,w,C), seen at `seconds`."""
        ...


def ask_features(
    scene: Scene,
    question: str,
    trajectory: Trajectory,
    reader: FeatureReader,
    engines: Engines = BARE,
    head: str = "smolvlm",
) -> Answer:
    """Let a model answer from the scene's own features `head`, seen along `trajectory`; no picture is encoded."""
    spec = scene.require_field([head]).spec(head)
    views = _spread(trajectory)
    maps = []
    for done, (camera, time) in enumerate(views):
        engines.progress("render", done, len(views))
        maps.append(head_map(scene, head, camera, time, engines.backend))
    text = reader.answer(maps, [time / scene.fps for _, time in views], question)
    return Answer(text, reader.name, {"frames": len(views), "head": head, "grid": list(spec.grid)})


def look(
    scene: Scene, views: Trajectory, times: np.ndarray, found: dict[str, Selection], engines: Engines = BARE
) -> list[Sighting]:
    """Measure the selections `found` in `views`, and how they move over the clip `times (K,)`; in the given order."""
    chosen = np.stack([selection.chosen for selection in found.values()], 1)  # (N,n)
    masks: list[np.ndarray] = []  # per view (n,H,W)
    depths: list[np.ndarray] = []
    for done, (camera, time) in enumerate(views):
        engines.progress("looking at the scene", done, len(views))
        small = camera.of_width(COLUMNS)
        drawn = render(scene, small, time, ("depth",), engines.backend, values={"chosen": chosen.astype(np.float32)})
        masks.append(np.moveaxis(drawn["chosen"], -1, 0) > SEEN)
        depths.append(drawn["depth"])
    engines.progress("looking at the scene", len(views), len(views))
    moving = chosen & scene.moving[:, None]
    moving &= 2 * moving.sum(0) > chosen.sum(0)  # a few that move at the rim do not carry the rest along
    posed = [scene.posed(float(time)) for time in times]
    weights = np.stack([one.opacities @ moving for one in posed])  # (K,n)
    places = np.stack([(one.opacities[:, None] * moving).T @ one.means for one in posed])  # (K,n,3)
    places = np.where(weights[..., None] > 0, places / np.maximum(weights, 1e-9)[..., None], np.nan)
    seen = np.stack(masks)  # (V,n,H,W)
    return [
        _sighting(scene, name, selection, _Observed(views, seen[:, n], np.stack(depths), times, places[:, n]))
        for n, (name, selection) in enumerate(found.items())
    ]


@dataclass(frozen=True, eq=False)
class _Observed:
    """One object in V views, and its place at K times."""

    views: Trajectory
    seen: np.ndarray
    """(V,H,W) bool: the pixels that are its own."""
    depths: np.ndarray
    """(V,H,W) of the whole picture."""
    times: np.ndarray
    """(K,) clip frames."""
    places: np.ndarray
    """(K,3) centres of its moving Gaussians; NaN where it has none."""


def _sighting(scene: Scene, label: str, selection: Selection, observed: _Observed) -> Sighting:
    """Return the numbers of one object."""
    views, seen, times, places = observed.views, observed.seen, observed.times, observed.places
    sighting = Sighting(label, int(selection.chosen.sum()), float(selection.scores.max(initial=0)))
    sighting = replace(sighting, sizes=_sizes(scene, np.flatnonzero(selection.chosen), float(times[0])))
    steps = np.linalg.norm(np.diff(places, axis=0), axis=1)
    moves = np.flatnonzero(np.nan_to_num(steps) > STILL * np.diff(times) / scene.fps)
    if len(moves):
        camera = scene.cameras.at(float(times[(moves[0] + moves[-1] + 1) // 2]))
        way = way_across(camera, places[[moves[0], moves[-1] + 1]])
        sighting = replace(
            sighting,
            path=float(steps[moves].sum()),
            frames=(round(float(times[moves[0]])), round(float(times[moves[-1] + 1]))),
            heading=f"to the {way}" if way else "",
        )
    fractions = seen.mean((1, 2))
    best = int(fractions.argmax())
    sighting = replace(
        sighting,
        moments=[float(view.time) for view, part in zip(views, fractions, strict=True) if part >= PRESENT],
        unseen=[float(view.time) for view, part in zip(views, fractions, strict=True) if part < PRESENT],
    )
    if not fractions[best]:
        return sighting
    mask, depth = seen[best], observed.depths[best]
    column = np.nonzero(mask)[1].mean() / mask.shape[1]
    ratio = np.nanmedian(depth[mask]) / np.nanmedian(depth) if np.isfinite(depth[mask]).any() else 1.0
    return replace(
        sighting,
        share=float(fractions[best]),
        time=float(views[best][1]),
        place="on the left" if column < 0.38 else "on the right" if column > 0.62 else "in the middle",
        distance="near" if ratio < 0.8 else "far" if ratio > 1.25 else "at middle distance",
    )


def _sizes(scene: Scene, rows: np.ndarray, time: float) -> list[tuple[float, float]]:
    """Return `Sighting.sizes` of the Gaussians `rows`."""
    if not len(rows):
        return []
    posed, camera = scene.posed(time), scene.cameras.at(time)
    owner = separate_objects(posed, rows, single_people(scene, rows))
    right, down = camera.camera_to_world[:3, 0], camera.camera_to_world[:3, 1]
    ones = [rows[owner == number] for number in range(owner.max() + 1)]
    ones.sort(key=lambda one: float(np.median(posed.means[one] @ right)))
    return [(width_along(posed, one, down), width_along(posed, one, right)) for one in ones]


def _compared(
    scene: Scene, asked: Asked, encode: Encode | None, names: Mapping[str, Selection]
) -> tuple[str, list[str]]:
    """Return (the sentence about things that are compared, their names)."""
    times = times_of(scene, asked)
    found, notes = _found(scene, asked, encode, names)
    if asked.things and (missing := next((word for word, each in found.items() if not each.chosen.any()), None)):
        absent = Sighting(missing, 0, float(found[missing].scores.max(initial=0)))
        return _absent(scene, absent, encode, asked.yes(False)), []

    def measured(found: Mapping[str, Selection]) -> list[Measured]:
        return measure(scene, found, times, [label for label in found if _has_no_article(label, names)])

    def everything() -> list[Measured]:
        return measured(_found(scene, replace(asked, things=()), encode, names)[0])

    things = measured(found) if asked.things else everything()
    if asked.kind in OF_ONE and not asked.things:
        things = [one for one in things if one.moves]
        if len(things) != 1:
            raise Unanswerable(f"Which thing is meant? Name it; {INSTEAD}.")
    if asked.among and (singles := single_ones(scene, things[0], times)):
        things = [*singles, *things[1:]]
    if asked.but:
        out = measured(_found(scene, replace(asked, things=asked.but), encode, names)[0])
        things = [one for one in things if not any(np.array_equal(one.rows, thing.rows) for thing in out)]
    if not things:
        return f"{asked.yes(False) or 'Nothing'} that the scene has a word for.", []
    sentence = Comparison(scene, asked, things, times).sentence(everything)
    return " ".join([sentence[0].upper() + sentence[1:], *filter(None, notes.values())]), [
        thing.name for thing in things
    ]


def _found(
    scene: Scene, asked: Asked, encode: Encode | None, names: Mapping[str, Selection]
) -> tuple[dict[str, Selection], dict[str, str]]:
    """Return (selections that a question is about, by word; remarks on what the search leaves open).

    F4xError for what the teacher of the scene's words does not know.
    """
    found: dict[str, Selection] = {}
    notes: dict[str, str] = {}
    if asked.things:
        given = {name.lower(): name for name in names}
        words = {
            name: next((given[form] for form in spellings(name) if form in given), None) or _word_of(scene, name)
            for name in asked.things
        }
        which = {name: "" if word in names else _which_of(name, word) for name, word in words.items()}
        for name, word in words.items():
            if word not in names:
                refuse_unknown(scene, word if which[name] else name, encode)
        for name, word in words.items():
            selection = names[word] if word in names else find(scene, word, encode)
            if which[name] and selection.chosen.any():
                time = asked.span[0] if asked.span else float(scene.cameras.times[0])
                found[f"{name.split()[0]} {word}"] = _one_of(scene, selection, which[name], time)
                continue
            found[word] = selection
            notes |= {} if word in names or which[name] else {word: _note(name, word)}
    else:
        there = things_there(scene)
        found = {_perhaps(word) if is_doubtful(scene, one) else word: one for word, one in there.items()}
        rest = moving_things(scene) & not_deleted(scene)
        for selection in found.values():
            rest &= ~selection.chosen
        found |= {THING: Selection(scene.ids, rest.astype(float), np.zeros(len(rest), bool))}
    return found, notes


def _which_of(name: str, word: str) -> str:
    """Return the place or size by which a name tells one of several of a word, as `pick_object` has it; nothing where none does."""
    first, *rest = name.split()
    return ONE_OF_SEVERAL.get(first, "") if not {*spellings(" ".join(rest))}.isdisjoint(spellings(word)) else ""


def _one_of(scene: Scene, found: Selection, which: str, time: float) -> Selection:
    """Return the one of several separate things that is `which` at clip time `time`."""
    rows = np.flatnonzero(found.chosen)
    own = pick_object(scene.posed(time), rows, which, scene.cameras.at(time), single_people(scene, rows))
    return found.among(np.isin(np.arange(len(found.ids)), own))


def _has_no_article(label: str, names: Collection[str]) -> bool:
    """Return True if `Sighting.given` holds for a label, where somebody gave `names`."""
    return label in names or label == THING or label.startswith(PERHAPS)


def _perhaps(word: str) -> str:
    """Return the name of a thing whose word is doubtful."""
    article = "" if word.endswith("s") else "an " if word[0] in "aeiou" else "a "
    return f"{PERHAPS}{article}{word}"


def _look_for(
    scene: Scene, asked: Asked, trajectory: Trajectory, names: Mapping[str, Selection], engines: Engines
) -> list[Sighting]:
    """Return the sightings that a question is about."""
    views = trajectory
    first, last = (float(time) for time in scene.cameras.times[[0, -1]])
    if asked.span is not None:
        views = [view for view in trajectory if asked.span[0] - 0.5 <= view.time <= asked.span[1] + 0.5]
        if not views and trajectory:  # frames lie farther apart there
            at, gap = asked.span[0], float(np.diff(scene.cameras.times).max(initial=0.0))
            nearest = min(trajectory, key=lambda view: abs(view.time - at))
            views = [nearest] if abs(nearest.time - at) <= gap / 2 else []
        if not views:
            raise F4xError(f"The camera path shows nothing at frame {asked.span[0]:g}; ask without --path.")
        around = WINDOW * scene.fps if asked.span[0] == asked.span[1] else 0.0
        first, last = max(first, asked.span[0] - around), min(last, asked.span[1] + around)
    else:
        shown = [float(view.time) for view in trajectory]
        first, last = min(shown), max(shown)
    times = np.unique(np.linspace(first, last, min(MOMENTS, 1 + round(last - first))))
    found, notes = _found(scene, asked, engines.encode, names)
    views = _spread(views, len(views) if asked.kind in COMPLETE else MOMENTS if asked.kind in SEEING else VIEWS)
    sightings = look(scene, views, times, found, engines)
    if not asked.things:
        sightings = sorted((s for s in sightings if s.share >= PRESENT), key=lambda s: -s.share)
    return [replace(s, note=notes.get(s.label, ""), given=_has_no_article(s.label, names)) for s in sightings]


def _word_of(scene: Scene, name: str) -> str:
    """Return the word to look for: "car" of "red cars", where the scene knows only that; `Unanswerable` for a word left over.

    One unknown word may name a thing that the text encoder knows. Of several, one may as well be a verb or an adverb.
    """
    if is_cast(name):  # "the car's shadow"
        whose, cast = caster(name), name.split()[-1]
        return cast if whose is None else f"{_word_of(scene, whose)}'s {cast}"
    if is_of_people(scene, name):
        return name
    known = {label.lower(): label for label in labels_of(scene)}
    words = name.split()
    for start in range(len(words)):
        form = next((known[form] for form in spellings(" ".join(words[start:])) if form in known), None)
        if form is not None:
            break
    else:
        start, form = (0, name) if len(words) == 1 else (len(words), "")
    left = [word for word in words[:start] if not re.fullmatch(ADJECTIVE, word)]
    left = left[1:] if left and start == 1 and left[0] in ONE_OF_SEVERAL else left
    if not form or (left and not _is_compound(left, name, known)):
        named = {*known, "it", "they", "them", "he", "she", "this", "that"}
        strange = " ".join(word for word in left if named.isdisjoint(spellings(word))) or name
        raise Unanswerable(
            f"I do not know what '{strange}' means in '{name}', so I do not answer half the question; {INSTEAD}."
        )
    return form


def _is_compound(left: Sequence[str], name: str, known: Collection[str]) -> bool:
    """Return True if the words before a known one are a noun that says which kind it is: "race horse", which a "hot dog" is not."""
    plain = not is_adjective(left[0]) and left[0] not in FUNCTION_WORDS and not is_adverb(left[0])
    return len(left) == 1 and plain and left[0].isalpha() and not names_another(name) and head_of(name, known) is None


def _note(name: str, word: str) -> str:
    """Return the note about the part of `name` that a search for `word` leaves open."""
    if len(word.split()) < len(name.split()):
        if not re.search(rf"\b(?:{ADJECTIVE})\b", name):
            return f"I looked for {word}: whether it is a {name} I cannot tell."
        return f"I looked for {word} alone: what is {name.rsplit(maxsplit=len(word.split()))[0]} I cannot tell."
    return ""


OF_ONE = (*ONE_BY_ONE, "distance", "approach", "nearest_moment", "farthest_moment")
"""Kinds that need to know which thing is meant …"""
COMPARED = {*OF_ONE} | word_set(
    "compare_size compare_speed colour what_is count count_moving relation nearest farthest biggest brightest most_moving behind"
    " in_front left_of right_of above below neighbours between still"
)
"""… and all that compare things or moments."""
OF_MANY = word_set("colour nearest farthest biggest brightest most_moving compare_speed order count_moving still")
"""Those of them that take any number of things."""
SEEING = ("seen", "seeing")
"""Kinds that many views are looked at for …"""
COMPLETE = ("always", "enter", "leave")
"""… and those for which every view is."""
MOVING = ("motion", "way", "far", "fast", "lasting", "order", "happens")
"""Kinds that are about what moves where no thing is named: what stands still is no event."""


def compose(scene: Scene, asked: Asked, sightings: Sequence[Sighting], encode: Encode | None = None) -> str:
    """Return the sentences for one question, from the sightings."""
    if asked.kind == "camera":
        return camera_words(scene.cameras, asked)
    if asked.kind in CLIP_FACTS:
        frames = len(scene.cameras)
        seconds = frames / scene.fps
        return f"The clip has {frames} frames (0 to {frames - 1}), {scene.fps:g} a second, and lasts {seconds:.2f} seconds."
    when = _moment(asked.span, scene.fps) if asked.span else ""
    there = [s for s in sightings if s.chosen]
    missing = [s for s in sightings if not s.chosen]
    sentences = [_absent(scene, s, encode, asked.yes(False)) for s in missing]
    moving = sorted((s for s in there if s.frames), key=lambda s: s.frames[0] if s.frames else 0)
    if not asked.things and asked.kind in MOVING:
        there = moving
    if asked.kind == "order" and moving:
        starts = ", then ".join(f"{_the(s)} (frame {s.frames[0]})" for s in moving if s.frames)
        sentences.append(f"In the order in which they start to move: {starts}.")
    elif not there and not missing:
        nothing = "moves" if asked.kind in MOVING else "stands out"
        sentences.append(f"{f'{asked.yes(False)}: nothing' if asked.polar else 'Nothing'} {nothing}{when}.")
    else:
        sentences += [SENTENCES[asked.kind](s, asked, scene.fps, when) for s in there]
    sentences += [s.note for s in sightings if s.note]
    return " ".join(sentences)


def _absent(scene: Scene, sighting: Sighting, encode: Encode | None, yes: str) -> str:
    """Return the sentence about a thing that is not there, after "Yes" or "No" where that is wanted."""
    if scene.base is not scene and find(scene.base, sighting.label, encode).chosen.any():
        what = f"an earlier edit hides or removed {_the(sighting)}."
    else:
        _, hint = instead(scene, [sighting.label], encode)
        what = f"nothing in the scene answers to '{sighting.label}' (best: {sighting.best:.2f}){hint and f'; {hint}'}."
    return f"{yes}: {what}" if yes else what[0].upper() + what[1:]


def _sentence(yes: str, s: Sighting, rest: str) -> str:
    """Return a sentence about a thing, after "Yes" or "No" where that is wanted."""
    subject = _the(s)
    return f"{yes}: {subject} {rest}" if yes else f"{subject[0].upper()}{subject[1:]} {rest}"


def _the(s: Sighting) -> str:
    return s.label if s.given else f"the {s.label}"


def _of_motion(s: Sighting, asked: Asked, fps: float, when: str) -> str:
    if s.frames is None:
        return _sentence(asked.yes(False), s, f"stands still{when}.")
    yes = "" if asked.manner else asked.yes(True)
    way = f" {s.heading}" if s.heading else ""
    known = f" Whether that is what '{asked.manner}' means I cannot tell." if asked.manner else ""
    if asked.span and asked.span[0] == asked.span[1]:
        return _sentence(yes, s, f"moves{way}{when}, {_speed(s, fps)}.{known}")
    return _sentence(yes, s, f"moves{way} {_from_to(s.frames, fps)}, {s.path:.2f} times the median depth.{known}")


def _of_way(s: Sighting, asked: Asked, fps: float, when: str) -> str:
    if asked.polar and s.heading:
        return _of_motion(s, replace(asked, negated=asked.negated != (not s.heading.endswith(asked.side))), fps, when)
    sentence = _of_motion(s, replace(asked, polar=False), fps, when)
    if s.frames is None or s.heading:
        return sentence
    too_little = f"It crosses less than {SIDEWAYS:.0%} of the picture's width then"
    return f"{sentence} {too_little}, which is too little to tell left from right."


def _of_path(s: Sighting, asked: Asked, fps: float, when: str) -> str:
    if s.frames is None:
        return _sentence("", s, f"stands still{when}.")
    if asked.kind == "fast":
        return _sentence("", s, f"moves at {_speed(s, fps)}, {_from_to(s.frames, fps)}.")
    if asked.kind == "lasting":
        count = s.frames[1] - s.frames[0]
        return _sentence("", s, f"moves for {count / fps:.2f} seconds, {_from_to(s.frames, fps)}.")
    return _sentence("", s, f"moves {s.path:.2f} times the median depth, {_from_to(s.frames, fps)}.")


def _of_place(s: Sighting, asked: Asked, fps: float, when: str) -> str:
    if not s.share:
        return _sentence(asked.yes(False), s, f"is hardly seen{when}.")
    at = when or f" at frame {s.time:g}"
    return _sentence(
        asked.yes(s.place.endswith(asked.side)), s, f"is {s.place}, {s.distance}, {s.share:.1%} of the picture{at}."
    )


def _of_size(s: Sighting, asked: Asked, fps: float, when: str) -> str:
    """Return height and width of a thing, in median depths, and the share of the picture that it fills."""
    tall, wide = (" and ".join(f"{size:.2f}" for size in sizes) for sizes in zip(*s.sizes, strict=True))
    many = f", each of {len(s.sizes)} from left to right," if len(s.sizes) > 1 else ""
    ratio = f" ({s.sizes[0][0] / max(s.sizes[0][1], 1e-9):.1f} times as tall as wide)" if not many else ""
    share = f"; it is {s.share:.1%} of the picture{when or f' at frame {s.time:g}'}" if s.share else ""
    rest = f"is{many} {tall} tall and {wide} wide{ratio}, in times the median depth, as a clip tells no metres{share}."
    return _sentence("", s, rest)


def _of_sight(s: Sighting, asked: Asked, fps: float, when: str) -> str:
    if not s.moments:
        return _sentence(asked.yes(False), s, f"is hardly seen{when}: never {PRESENT:.1%} of the picture.")
    if asked.polar:
        place = f"is {s.place}, {s.distance}, {s.share:.1%} of the picture at frame {s.time:g}."
        return _sentence(asked.yes(True), s, place)
    frames = round(s.moments[0]), round(s.moments[-1])
    lasts = f", about {(frames[1] - frames[0] + 1) / fps:.2f} seconds" if asked.kind == "seeing" else ""
    known = f" Who may {asked.manner} it I cannot tell." if asked.manner else ""
    return _sentence("", s, f"is seen {_from_to(frames, fps)}{lasts}.{known}")


def _of_always(s: Sighting, asked: Asked, fps: float, when: str) -> str:
    count = len(s.moments) + len(s.unseen)
    if not s.unseen:
        return _sentence(asked.yes(True), s, f"is seen in all {count} frames{when}.")
    first = f", first not at frame {min(s.unseen):g} ({min(s.unseen) / fps:.1f} s)"
    return _sentence(asked.yes(False), s, f"is seen in {len(s.moments)} of {count} frames{when}{first}.")


def _of_change(s: Sighting, asked: Asked, fps: float, when: str) -> str:
    """Tell if and when a thing comes into the picture, or goes out of it."""
    comes = asked.kind == "enter"
    seen = sorted([(time, True) for time in s.moments] + [(time, False) for time in s.unseen])
    turns = [time for (_, before), (time, now) in pairwise(seen) if now != before and now == comes]
    if turns:
        moments = ", ".join(f"frame {time:g} ({time / fps:.1f} s)" for time in turns)
        return _sentence(asked.yes(True), s, f"{'comes into' if comes else 'goes out of'} the picture at {moments}.")
    if not s.moments:
        return _sentence(asked.yes(False), s, f"is hardly seen{when}: never {PRESENT:.1%} of the picture.")
    end = "from the beginning" if comes else "to the end"
    return _sentence(asked.yes(False), s, f"is seen {end}{when}, and does not {'come in' if comes else 'go out'}.")


def _of_thing(s: Sighting, asked: Asked, fps: float, when: str) -> str:
    return f"{s.label}: {s.place}, {s.distance}, {s.share:.1%} of the picture. {_of_motion(s, asked, fps, when)}"


SENTENCES = {
    "motion": _of_motion,
    "way": _of_way,
    "always": _of_always,
    **dict.fromkeys(("enter", "leave"), _of_change),
    **dict.fromkeys(("far", "fast", "lasting", "order"), _of_path),
    **dict.fromkeys(("where", "side"), _of_place),
    "size": _of_size,
    **dict.fromkeys(SEEING, _of_sight),
    "things": _of_thing,
    "does": _of_thing,
    "happens": _of_thing,
}
"""Kind of question -> the sentence about a thing that is there."""


def _spread(trajectory: Trajectory, count: int = VIEWS) -> Trajectory:
    """Return at most `count` views, evenly over a trajectory."""
    if not trajectory:
        raise F4xError("The camera path has no view; give one with at least one camera.")
    return [trajectory[i] for i in evenly_spaced(len(trajectory), count)]


def _moment(span: tuple[float, float], fps: float) -> str:
    first, last = span
    if first == last:
        return f" at frame {first:g} ({first / fps:.1f} s)"
    return f" {_from_to((round(first), round(last)), fps)}"


def _from_to(frames: tuple[int, int], fps: float) -> str:
    return f"from frame {frames[0]} to {frames[1]} ({frames[0] / fps:.1f} to {frames[1] / fps:.1f} s)"


def _speed(s: Sighting, fps: float) -> str:
    assert s.frames is not None
    seconds = max(s.frames[1] - s.frames[0], 1) / fps
    return f"{s.path / seconds:.2f} times the median depth a second"
