"""What questions ask, by family: the same question in many words, and what nobody can compute."""

import pytest

from f4x_core.errors import F4xError
from f4x_core.query.wording import Asked, Unanswerable, read_question

FPS, FRAMES = 24.0, 72


def _entries(text: str) -> list[str]:
    return text.replace("\n    ", " ").strip().splitlines()


FAMILIES = """
where + dog: where is the dog? | Where about is the dog | I'd like to know where the dog is | hey, can you tell me
    where the dog is? | which side of the picture is the dog on | the position of the dog | what is the dog's position
    | dog where? | in which corner is the dog | is the dog on the left or on the right? | where can I find the dog
fast + car: how fast is the car | tell me the speed of the car | what's the car's speed | how fast does the car go? |
    car speed? | at what speed does the car drive | do you know how quick the car is | the car moves how fast?
distance + dog + bush: how far is the dog from the bush | distance between dog and bush | Distance dog - bush? | the
    gap between the dog and the bush | how much space is there between the dog and the bush | how far apart are the
    dog and the bush | distance from the dog to the bush
seen + dog: during which frames is the dog visible? | dog visible when? | when can I see the dog | when is the dog in
    view
seeing + dog: for how long is the dog in the picture? | how many seconds can you see the dog | how long is the dog
    visible
stops + scooter: at what time the scooter stops? | when does the scooter come to a halt
motion + scooter: from which second is the scooter moving | when exactly does the scooter start to move?
order + wagons: in what order do the wagons start moving | which of the wagons moves first | list the wagons from left
    to right | in which order do the wagons stand from left to right?
count_moving + camels: how many of the camels move | how many camels are moving | how many camels walk
still: Which objects stay still the whole time | what does not move here? | what stays in place | which things never
    move
things: list all the things in the room | show me what objects you know | what can I edit here? | give me a list of
    everything | which objects are visible | what does the video contain | describe what you see | what
    is this clip about?
happens: what's going on? | what happens here? | describe what happens | what has changed
rise + man: By how much does the man go up during the clip | how high does the man jump | how far up does the man go |
    when does the man jump? | at what time does the man leave the ground? | when does the man start to jump
highest_moment + man: what second is the man highest up | when is the man at his highest point? | at what time does
    the man peak
relation + dog + bush: is the dog in front of or behind the bush? | where
    is the dog compared to the bush | is the dog left or right of the bush? | is the dog above the bush | which is
    further left, the dog or the bush?
nearest + bush + dog: which bush is closest to the dog | which of the bush is nearest to the dog | what bush is the
    nearest one to the dog
compare_size + bus + wagon: how many times larger is the bus than a wagon | is the bus bigger than the wagon | which
    is bigger, the bus or the wagon? | how tall is the bus compared to the wagon
compare_speed + camel: which camel is the faster one | which camel goes fastest | which is the fastest camel
biggest: What is the biggest object | which thing is the largest? | who is the tallest
most_moving: which object has the most motion in it | what moves the most | which thing travels the greatest distance
far + dog: how much distance did the dog walk in total | how far does the dog go | what distance does the dog cover
approach + dog: is the dog coming toward the camera? | does the dog get closer | how much closer does the dog get to
    us
path + dog: describe the route of the dog please | what path does the dog take | how does the dog move
way + dog: which way does the dog go | where is the dog heading | is the dog moving left? | is the dog walking left or
    right | where is the dog going, left or right? | where does the dog run, to the left or to the right
where + sign: where is the sign? | on which side is the sign | where can I see the sign
leave + dog: when is the dog not visible any more | when is the dog not there anymore? | from when can I no longer see the dog
nearest_moment + dog + fence: when does the dog pass the fence | when does the dog pass in front of the fence? | at which
    second does the dog pass behind the fence
motion + water: does the water move | is the water moving? | does the water flow
stops + dog: does the dog ever stop | is the dog always moving
"""
"""Kind and things: ways to ask for that."""
WAYS = [
    (question, *meaning.split(" + "))
    for meaning, _, questions in (line.partition(": ") for line in _entries(FAMILIES))
    for question in questions.split(" | ")
]


@pytest.mark.parametrize("way", WAYS, ids=[way[0] for way in WAYS])
def test_a_family_of_questions(way):
    question, kind, *things = way
    (asked,) = read_question(question, FPS, FRAMES)
    assert (asked.kind, list(asked.things)) == (kind, things)


@pytest.mark.parametrize(
    ("question", "asked"),
    [
        ("What is the biggest object apart from the street", Asked("biggest", manner="biggest", but=("street",))),
        ("is anything moving besides the car", Asked("count_moving", polar=True, but=("car",))),
        ("which wagon is the biggest", Asked("biggest", ("wagon",), manner="biggest", among="wagon")),
        ("is the car moving to the left", Asked("way", ("car",), side="left", polar=True)),
        ("is the dog always moving", Asked("stops", ("dog",), polar=True, negated=True)),
        ("how close do the man and the dog get to each other", Asked("distance", ("man", "dog"), extreme="min", other=("dog",))),
        ("is the front camel bigger than the back one?",
         Asked("compare_size", ("front camel", "back camel"), polar=True, manner="bigger", other=("back camel",))),
        ("how far is the man from the dog when he is closest?", Asked("distance", ("man", "dog"), extreme="min", other=("dog",))),
        ("how far apart are the man and the dog when they are nearest",
         Asked("distance", ("man", "dog"), extreme="min", other=("dog",))),
        ("how far is the man from the dog when it is farthest away",
         Asked("distance", ("man", "dog"), extreme="max", other=("dog",))),
        ("Distance dog - camera at 1.5 seconds?", Asked("distance", ("dog",), (36.0, 36.0))),
        ("at 1 s, what is left of the dog's bed?", Asked("left_of", ("dog's bed",), (24.0, 24.0))),
        ("has the car left the picture?", Asked("leave", ("car",), polar=True)),
    ],
)  # fmt: skip
def test_slots(question, asked):
    assert read_question(question, FPS, FRAMES) == (asked,)


COMPOUNDS = (
    "race horse",
    "drift car",
    "jump horse",
    "show dog",
    "guide dog",
    "cruise boat",
    "swing chair",
    "work horse",
)


@pytest.mark.parametrize("compound", COMPOUNDS)
def test_a_verb_before_a_thing_says_which_kind_it_is(compound):
    labels = ("horse", "car", "dog", "boat", "chair", "tree")
    for asks, kind, things in (
        ("where is the {} at second 1?", "where", 1),
        ("how fast does the {} move", "fast", 1),
        ("is the {} moving?", "motion", 1),
        ("when does the {} stop", "stops", 1),
        ("how far is the {} from the tree", "distance", 2),
    ):
        (asked,) = read_question(asks.format(compound), FPS, FRAMES, labels=labels)
        assert (asked.kind, asked.things) == (kind, (compound, "tree")[:things])


@pytest.mark.parametrize("name", ["race horse", "jump start", "run club", "big fast one"])
def test_a_name_of_several_words_is_read_as_it_was_taught(name):
    (asked,) = read_question(f"where is the {name} at second 1?", FPS, FRAMES, labels=("horse", name))
    assert (asked.kind, asked.things, asked.span) == ("where", (name,), (24.0, 24.0))


@pytest.mark.parametrize(
    ("question", "kind"),
    [
        ("does the horse race", "motion"),
        ("when does the horse jump", "rise"),
        ("is the dog moving", "motion"),
        ("does the dog drift", "motion"),
    ],
)
def test_a_verb_behind_a_thing_stays_one(question, kind):
    (asked,) = read_question(question, FPS, FRAMES, labels=("horse", "dog", "race horse"))
    assert asked.kind == kind and len(asked.things[0].split()) == 1


def test_what_it_stands_for():
    assert read_question("how big is it?", FPS, FRAMES, "train")[0].things == ("train",)
    first, second = read_question("where is the dog at 1 s and how big is it?", FPS, FRAMES)
    assert (first.kind, second) == ("where", Asked("size", ("dog",)))


REFUSED = """
what is the dog riding? | does the dog eat the cat? | when does the dog eat? | is the dog behind the car and moving? |
    is the dog hungry | how old is the dog | what is the man wearing? | what will the dog do | does the car crash
    into the wall? | does the man look at the dog? | is there a dog that barks? | which dog barks? | what does the car
    look like | how heavy is the dog | how often does the dog jump | does the dog jump over the bush | is the man on
    the horse | is the dog in the car | who moves before the dog | does the dog come back | is the dog as fast as the
    man | does nothing move? | where will the train be in ten seconds? | is she happy
    do you think | does the dog swim away? | is it bigger than? | is the tree bigger | how many times does the dog
    jump | what time is it | left of the dog? |
    what does the dog see | who drives the car? | who rides the horse | is the dog closest to the camera? | how fast is the
    fastest car
"""


@pytest.mark.parametrize(
    ("question", "least"),
    [("are there more than two dogs?", 3), ("are there at least two dogs?", 2), ("how many dogs?", 0)],
)
def test_a_number_asked_about_is_the_least_for_a_yes(question, least):
    assert read_question(question, FPS, FRAMES)[0] == Asked("count", ("dogs",), polar=least > 0, at_least=least)


@pytest.mark.parametrize("question", " ".join(_entries(REFUSED)).split(" | "))
def test_what_is_not_understood_whole_is_refused(question):
    with pytest.raises(Unanswerable):
        read_question(question, FPS, FRAMES)


def test_what_may_be_misspelt_is_asked_about():
    with pytest.raises(F4xError, match="did you mean 'how fast is the car'"):
        read_question("how fsat is the car", FPS, FRAMES)


@pytest.mark.parametrize("word", ["blorbly", "blork"])
def test_no_word_of_a_question_is_ignored(word):
    """A word that nobody knows is part of a name, which the scene then lacks, or the question is refused."""
    for question, *_ in WAYS:
        for text in (f"{question.rstrip('?')} {word}", f"{word} {question}"):
            try:
                understood = read_question(text, FPS, FRAMES)
            except F4xError:
                continue
            assert word == "blork" and any("blork" in thing for asked in understood for thing in asked.things), text


@pytest.mark.parametrize(
    ("question", "kind"),
    [
        ("is the dog still there at the end", "seen"),
        ("is there still a dog in frame 30", "seen"),
        ("is the dog still", "motion"),
        ("is the dog gone at the end", "seen"),
        ("does a dog appear in this clip", "seen"),
        ("does the dog appear", "enter"),
        ("can you find a dog in this scene", "seen"),
        ("find the dog", "where"),
        ("when is the gap between the dog and the cat smallest", "nearest_moment"),
        ("when is the gap between the dog and the cat biggest", "farthest_moment"),
        ("when does the dog move the slowest", "slowest_moment"),
        ("what is in front of everything", "nearest"),
    ],
)
def test_the_reading_that_leaves_fewest_words_over_is_taken(question, kind):
    assert read_question(question, FPS, FRAMES)[0].kind == kind


@pytest.mark.parametrize(
    ("question", "plain"),
    [
        ("brown dog, yes?", "is the dog brown"),
        ("the dog moves, doesn't it?", "does the dog move"),
        ("is there a dog or not", "is there a dog"),
        ("i see only water, is there also a dog?", "is there a dog"),
        ("where is the dog, i can't see it", "where is the dog"),
        ("honestly, where is the dog?", "where is the dog"),
        ("where has the dog got to by the end?", "where is the dog at the end"),
        ("how fast does the dog run during the jump", "how fast does the dog run"),
    ],
)
def test_what_adds_nothing_is_left_out_by_its_place(question, plain):
    assert read_question(question, FPS, FRAMES) == read_question(plain, FPS, FRAMES)
