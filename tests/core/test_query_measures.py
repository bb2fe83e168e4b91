"""What questions that compare are answered with, against numbers worked out by hand."""

from dataclasses import replace
from itertools import count

import numpy as np
import pytest
from labelled_scene import FOCAL, HEIGHT, SQUARE, WALL, WIDTH, labelled_scene

from f4x_core.errors import F4xError
from f4x_core.geometry import spherical_harmonics
from f4x_core.query.measures import Comparison, Measured, measure, single_ones, times_of
from f4x_core.query.selection import Selection
from f4x_core.query.wording import Asked

SCENE = replace(labelled_scene(features=False), fps=10.0)
TIMES = np.arange(5.0)
FAR = "times the median depth"
BOTH = "the dog and the cat are"
LOOKS = "this is the way that it moves, not the way that it looks."


ROWS = count()


def thing(name, x, y=0.0, z=1.0, *, width=0.2, moves=True, rows=None):
    """`x`, `y`, `z`: world places at the five times, or one for all; the pixel is 100 times `x` and `y`; a row of its own."""
    centres = np.stack([np.broadcast_to(np.asarray(axis, float), 5) for axis in (x, y, z)], 1)
    return Measured(
        name,
        np.array([next(ROWS)] if rows is None else rows),
        centres,
        100 * centres[:, :2],
        centres[:, 2],
        width,
        moves,
    )


def say(kind, *things, everything=(), times=TIMES, scene=SCENE, **asked):
    return Comparison(scene, Asked(kind, **asked), list(things), times).sentence(lambda: list(everything))


# Its way is sqrt(.02) + sqrt(.1) + sqrt(.02) + .2 long; its speed at the moments 10 times (.14, .22, .2, .16, .2).
DOG = thing("the dog", [0.0, 0.1, 0.4, 0.5, 0.5], [0.3, 0.2, 0.1, 0.2, 0.4])
CAT = thing("the cat", 0.5, 0.2, 2.0, width=0.5, moves=False)
BIRD = thing("the bird", [0.9, 0.8, 0.7, 0.6, 0.5], -0.1, 1.5, width=0.05)
DEEP = thing("it", 0.0, 0.0, [3, 2, 4, 5, 6])
STAIRS = np.array([0.0, 0.3, 0.3, 0.9, 1.0])


@pytest.mark.parametrize(
    ("kind", "who", "asked", "answer"),
    [
        ("fastest_moment", thing("it", STAIRS), {}, f"it is fastest at frame 3 (0.3 s): 3.50 {FAR} a second."),
        ("slowest_moment", thing("it", STAIRS), {}, f"it is slowest at frame 4 (0.4 s): 1.00 {FAR} a second."),
        ("highest_moment", DOG, {}, "the dog is highest in the picture at frame 2 (0.2 s)."),
        ("fast", thing("it", STAIRS), {}, f"it moves at 2.40 {FAR} a second on average."),
        ("fast", thing("it", STAIRS), {"extreme": "max"}, f"it moves at 3.50 {FAR} a second at most."),
        ("fast", thing("it", STAIRS), {"extreme": "min"}, f"it moves at 1.00 {FAR} a second at least."),
        (
            "rise",
            DOG,
            {},
            f"the dog rises by 0.30 {FAR}; it is highest at frame 2 (0.2 s), and above half of that from frame 1 to 3.",
        ),
        ("rise", BIRD, {}, f"the bird rises by 0.00 {FAR}, which is too little to tell when."),
        ("nearest_moment", thing("it", 0, 0, [3, 2, 4, 5, 6]), {}, f"it is nearest to the camera at frame 1 (0.1 s): 2.00 {FAR}."),
        ("farthest_moment", DEEP, {}, f"it is farthest from the camera at frame 4 (0.4 s): 6.00 {FAR}."),
        ("distance", DEEP, {}, f"it is 3.00 {FAR} from the camera at frame 0 (0.0 s); over that time 2.00 to 6.00."),
        ("distance", DEEP, {"extreme": "min"}, f"it is 2.00 {FAR} from the camera at frame 1 (0.1 s)"
         f"; over that time 2.00 to 6.00."),
        ("stops", thing("it", [0, 0.3, 0.6, 0.6, 0.6]), {"polar": True}, "Yes: it stands still at frame 3 (0.3 s)."),
        ("stops", thing("it", [0, 0.3, 0.6, 0.9, 1.2]), {"polar": True}, "No: it moves all the time."),
        ("stops", thing("it", [0, 0, 0.3, 0.6, 0.6]), {}, "it stands still at frame 4 (0.4 s)."),
        ("stops", thing("it", 0.5), {}, "it stands still at frame 0 (0.0 s)."),
        ("path", DOG, {}, "the dog goes: 0% from the left, 75% from the top at frame 0 (0.0 s); then 62% from the left,"
                          " 25% from the top at frame 2 (0.2 s); then 78% from the left, 100% from the top at frame 4 (0.4 s)."),
        ("when_turns", thing("it", [0, 1, 2, 2, 2], 0, [1, 1, 1, 2, 3]), {}, f"it turns most at frame 1 (0.1 s); {LOOKS}"),
        ("when_turns", thing("it", [0, 1, 2, 3, 4], 0, [1, 1, 1, 1.1, 1.3]), {}, "it goes straight on."),
        ("when_turns", CAT, {}, "the cat does not move, so it does not turn."),
    ],
)  # fmt: skip
def test_one_thing(kind, who, asked, answer):
    assert say(kind, who, **asked) == answer


@pytest.mark.parametrize(
    ("kind", "asked", "answer"),
    [
        ("distance", {}, f"the dog and the cat are 1.12 {FAR} apart at frame 0 (0.0 s); over that time 1.00 to 1.12."),
        ("nearest_moment", {}, f"the dog and the cat are nearest to each other at frame 3 (0.3 s): 1.00 {FAR}."),
        ("approach", {"polar": True}, f"Yes: {BOTH} 1.12 {FAR} apart at frame 0 (0.0 s) and 1.02 at frame 4 (0.4 s)."),
        ("approach", {"polar": True, "manner": "away"}, f"No: {BOTH} 1.12 {FAR} apart at frame 0 (0.0 s)"
         f" and 1.02 at frame 4 (0.4 s)."),
        ("compare_size", {"polar": True}, "No: the cat is 2.5 times as wide as the dog."),
        ("compare_size", {"polar": True, "manner": "smaller"}, "Yes: the cat is 2.5 times as wide as the dog."),
        ("nearest", {"polar": True}, f"Yes: the dog is nearer, at 1.00 {FAR}, the cat at 2.00."),
        ("farthest", {"polar": True}, f"No: the cat is farther, at 2.00 {FAR}, the dog at 1.00."),
        ("compare_speed", {"manner": "faster", "polar": True}, f"Yes: the dog is faster"
         f"; in {FAR} a second: the dog 1.85, the cat 0.00."),
        ("compare_speed", {"manner": "slower", "polar": True}, f"No: the cat is slower"
         f"; in {FAR} a second: the cat 0.00, the dog 1.85."),
        ("relation", {"manner": "in relation"}, "the dog is left of the cat and in front of it at frame 0 (0.0 s)."),
        ("relation", {"manner": "to the right of", "polar": True}, "No: the dog is left of the cat at frame 0 (0.0 s)."),
        ("relation", {"manner": "on the left", "polar": True}, "Yes: the dog is left of the cat at frame 0 (0.0 s)."),
        ("relation", {"manner": "over", "polar": True}, "No: the dog is below the cat at frame 0 (0.0 s)."),
        ("relation", {"manner": "under", "polar": True}, "Yes: the dog is below the cat at frame 0 (0.0 s)."),
        ("relation", {"manner": "in front", "polar": True}, "Yes: the dog is nearer than the cat at frame 0 (0.0 s)."),
        ("relation", {"manner": "behind", "polar": True}, "No: the dog is nearer than the cat at frame 0 (0.0 s)."),
        ("relation", {"manner": "near", "polar": True}, f"No: the dog and the cat are 1.12 {FAR} apart at frame 0 (0.0 s)."),
        ("still", {}, "standing still: the cat."),
        ("count_moving", {"polar": True}, "Yes: 1 separate thing moves: the dog."),
        ("biggest", {}, f"the biggest thing is the cat, 0.50 {FAR} wide."),
        ("biggest", {"manner": "smallest"}, f"the smallest thing is the dog, 0.20 {FAR} wide."),
        ("most_moving", {}, f"the dog moves the most: 0.80 {FAR}."),
    ],
)  # fmt: skip
def test_two_things(kind, asked, answer):
    assert say(kind, DOG, CAT, **asked) == answer


@pytest.mark.parametrize(
    ("manner", "answer"),
    [
        ("from left to right", "from left to right at frame 0 (0.0 s): the dog, the cat, the bird."),
        ("from right to left", "from right to left at frame 0 (0.0 s): the bird, the cat, the dog."),
        ("from near to far", "from near to far at frame 0 (0.0 s): the dog, the bird, the cat."),
        ("from far to near", "from far to near at frame 0 (0.0 s): the cat, the bird, the dog."),
        ("by size", "from big to small at frame 0 (0.0 s): the cat, the dog, the bird."),
    ],
)
def test_order(manner, answer):
    assert say("order", DOG, CAT, BIRD, manner=manner) == answer


def test_who_starts_first():
    late = thing("the cow", [0, 0, 0, 0.4, 0.8])
    message = "in the order in which they start to move: the dog (frame 0 (0.0 s)), then the cow (frame 2 (0.2 s))."
    assert say("order", late, DOG, CAT) == message
    assert say("order", CAT) == "none of them moves."
    with pytest.raises(F4xError, match="more than one moment"):
        say("order", DOG, times=TIMES[:1])


LEFT, RIGHT = thing("the left", -1.0), thing("the right", 1.0)
UP, DOWN = thing("the upper", 0.0, -1.0), thing("the lower", 0.0, 1.5)
FRONT, BACK = thing("the front", 0.0, 0.0, 0.5), thing("the back", 0.0, 0.0, 3.0)
MIDDLE = thing("it", 0.0)
AROUND = (LEFT, RIGHT, UP, DOWN, FRONT, BACK, MIDDLE)


@pytest.mark.parametrize(
    ("kind", "answer"),
    [
        ("left_of", "left of it: the left."),
        ("right_of", "right of it: the front, the right, the upper."),
        ("above", "above it: the upper."),
        ("below", "below it: the front, the left, the right."),
        ("behind", "behind it: the back."),
        ("in_front", "in front of it: the front, the left, the right."),
        ("neighbours", "near it: the front, the left, the right."),
    ],
)
def test_what_is_around(kind, answer):
    assert say(kind, MIDDLE, everything=AROUND) == answer


def test_sides_go_by_the_picture_and_not_by_the_world():
    """Two pixels of a moment that differ, at moments that differ, in a picture that shows the world turned."""
    one, other = thing("it", 0.0), thing("the other", 1.0)
    other.pixels[:] = [[-3.0, 5.0], [3.0, -5.0], [3.0, -5.0], [3.0, -5.0], [3.0, -5.0]]
    assert say("left_of", one, everything=[other]) == "left of it: the other."
    assert say("below", one, everything=[other]) == "below it: the other."
    assert say("above", one, everything=[other]) == "above it: nothing that the scene has a word for."


def test_sides_of_two_go_by_the_pixels_of_the_first_moment():
    one, two = thing("it", 0.0), thing("the other", 0.0, 0.0, 2.0)
    one.pixels[:] = [[5.0, 40.0], [30.0, 1.0], [30.0, 1.0], [30.0, 1.0], [30.0, 1.0]]
    two.pixels[:] = [[20.0, 10.0], [1.0, 30.0], [1.0, 30.0], [1.0, 30.0], [1.0, 30.0]]
    two.depth[1:] = 0.5
    said = "in front of it at frame 0 (0.0 s)."
    assert say("relation", one, two, manner="relative") == f"it is left of the other and {said}"
    assert say("relation", two, one, manner="relative") == f"the other is right of it and {said}".replace(
        "in front of", "behind"
    )
    assert say("relation", one, two, manner="to the left") == "it is left of the other at frame 0 (0.0 s)."
    assert say("relation", one, two, manner="under") == "it is below the other at frame 0 (0.0 s)."
    assert say("relation", one, two, manner="in front") == "it is nearer than the other at frame 0 (0.0 s)."
    order = say("order", two, one, manner="from left to right")
    assert order == "from left to right at frame 0 (0.0 s): it, the other."


@pytest.mark.parametrize(
    ("kind", "manners", "moments"),
    [
        ("relation", ("in relation", "to the left", "over", "under", "in front", "behind", "near"), slice(1, 5)),
        ("order", ("from left to right", "from right to left", "from near to far", "from far to near"), slice(1, 5)),
        *(
            (kind, ("",), slice(1, 5))
            for kind in ("nearest", "farthest", "left_of", "right_of", "above", "below", "behind", "in_front")
        ),
        *((kind, ("",), slice(1, 5)) for kind in ("neighbours", "between")),
        ("approach", ("", "away"), slice(1, 4)),
    ],
)
def test_what_is_said_of_the_first_moment_does_not_depend_on_later_ones(kind, manners, moments):
    """And "approach" compares the first with the last."""
    rng = np.random.default_rng(3)
    still = [thing(f"the thing {name}", *rng.normal(size=2), 2 + rng.uniform(), width=0.3) for name in "abcdef"]
    for _ in range(5):
        moved = []
        for one in still:
            centres = one.centres.copy()
            centres[moments] += rng.normal(size=centres[moments].shape)
            moved.append(replace_tracks(one, centres))
        for manner in manners:
            counts = {
                "relation": (2,),
                "approach": (2,),
                "between": (1, 2),
                "order": (6,),
                "nearest": (1, 3),
                "farthest": (1, 3),
            }
            for named in counts.get(kind, (1,)):
                first, later = (
                    say(kind, *things[:named], everything=things, manner=manner, polar=True)
                    for things in (still, moved)
                )
                assert first == later


def replace_tracks(one, centres):
    """The thing along other places."""
    return replace(one, centres=centres, pixels=100 * centres[:, :2], depth=centres[:, 2])


@pytest.mark.parametrize(("apart", "near"), [(0.39, "Yes"), (0.41, "No")])
def test_two_things_are_near_within_their_widths(apart, near):
    assert say("relation", thing("it", 0.0), thing("the other", apart), manner="near", polar=True).startswith(near)


def test_two_moments_have_a_speed():
    quick = thing("it", [0.0, 0.5, 0.5, 0.5, 0.5])
    quick = replace(quick, centres=quick.centres[:2], pixels=quick.pixels[:2], depth=quick.depth[:2])
    assert say("fast", quick, times=TIMES[:2]) == f"it moves at 5.00 {FAR} a second on average."
    assert say("fast", quick, times=TIMES[:2] * 4) == f"it moves at 1.25 {FAR} a second on average."
    assert say("count_moving", quick, times=TIMES[:2] * 4).startswith("1 separate")


def test_a_turn_is_an_eighth_of_a_circle():
    """Straight on, then aside by exactly 45 degrees."""
    assert (
        say("when_turns", thing("it", np.arange(5), 0, [1, 1, 1, 2, 3])) == f"it turns most at frame 1 (0.1 s); {LOOKS}"
    )
    assert say("when_turns", thing("it", np.arange(5), 0, [1, 1, 1, 1.9, 2.8])) == "it goes straight on."


def test_nearest_and_farthest_neighbour():
    asked = {"other": ("it",)}
    assert say("nearest", MIDDLE, everything=AROUND, **asked) == "nearest to it: the front."
    assert say("farthest", MIDDLE, everything=AROUND, **asked) == "farthest from it: the back."
    many = thing("wagon 1", 3.0), thing("wagon 2", 2.0), MIDDLE
    assert say("nearest", *many, among="wagon", **asked) == f"wagon 2 is nearest to it at frame 0 (0.0 s): 2.00 {FAR}."
    assert (
        say("farthest", *many, among="wagon", **asked) == f"wagon 1 is farthest from it at frame 0 (0.0 s): 3.00 {FAR}."
    )


@pytest.mark.parametrize(
    ("x", "y", "there"),
    [(0.0, 0.0, True), (0.9, 0.0, True), (0.0, 0.69, True), (0.0, 0.71, False), (1.1, 0.0, False), (-1.1, 0.0, False)],
)
def test_between_is_near_the_line_and_not_beyond_its_ends(x, y, there):
    """The line is 2 long: 0.35 of that aside is the limit."""
    message = say("between", LEFT, RIGHT, everything=[thing("the stone", x, y)])
    assert message == f"between them: {'the stone' if there else 'nothing that the scene has a word for'}."


def test_between_a_thing_and_the_camera():
    message = say("between", thing("it", 0, 0, 4.0), everything=[FRONT, thing("the wall", 0, 0, 5.0)])
    assert message == "between them: the front."
    comes, stone = thing("it", 0, 0, [4.0, 1.5, 1.5, 1.5, 1.5]), thing("the stone", 0, 0, 2.0)
    assert say("between", comes, everything=[stone]) == "between them: the stone."  # as it is at the first moment


def test_speed_needs_two_moments_and_comparison_two_things():
    with pytest.raises(F4xError, match="more than one moment"):
        say("fast", DOG, times=TIMES[:1])
    for kind in ("compare_size", "relation"):
        with pytest.raises(F4xError, match="only one is named"):
            say(kind, DOG, manner="over")


def test_speed_is_the_way_by_the_time_between_the_moments():
    """Moments two frames, .2 s, apart: .031 a second is .0062 a moment."""
    slow, slower = (thing("it", np.arange(5) * speed / 5) for speed in (0.031, 0.029))
    assert say("count_moving", slow, slower, times=2 * TIMES) == "1 separate thing moves: it."


def test_a_thing_moves_from_three_hundredths_a_second_on():
    slow, slower = (thing("it", np.arange(5) * speed / 10) for speed in (0.031, 0.029))
    assert say("count_moving", slow, slower) == "1 separate thing moves: it."
    assert say("count_moving", slow, times=TIMES[:1]) == "1 separate thing moves: it."
    assert say("most_moving", slower) == "nothing moves."
    assert say("count_moving", slow, DOG) == "2 separate things move: it, the dog."


def lights(*colours, opacities=(0.5, 0.5, 0.5, 0.5)):
    """A scene of one static Gaussian a colour, of the sizes 1, 2, 4 by 1, and so on."""
    number = len(colours)
    static = SCENE.static.take(np.arange(number))
    sizes = np.stack([np.full(number, 0.01), np.full(number, 0.1), 0.1 * 2.0 ** np.arange(number)], 1)
    sh = np.stack([spherical_harmonics.dc_from_rgb(np.float32(colour)) for colour in colours]).reshape(number, 1, 3)
    return replace(SCENE, static=replace(static, scales=sizes.astype(np.float32), sh=sh.astype(np.float32),
                                         opacities=np.float32(opacities[:number])))  # fmt: skip


def test_a_colour_counts_by_the_surface_that_has_it():
    """Surfaces 1, 2, 4 of opacity .5, .5 and .25: a quarter, a half, a quarter."""
    scene = lights((1, 0, 0), (0, 0, 1), (0, 1, 0), opacities=(0.5, 0.5, 0.25))
    message = say("colour", thing("it", 0, rows=(0, 1, 2)), scene=scene, polar=True, manner="blue")
    assert message.startswith("Yes: it is blue (40%)") and "green (40%)" in message and "red (20%)" in message
    scene = lights((1, 0, 0), (0, 0, 1), (0, 0, 1), opacities=(0.5, 0.5, 0.5))
    assert say("colour", thing("it", 0, rows=(0, 1, 2)), scene=scene) == "it is blue (86%)."
    assert say("colour", thing("it", 0, rows=(0,)), scene=scene, polar=True, manner="blue") == "No: it is red (100%)."
    assert say("colour", thing("it", 0, rows=(0,)), scene=scene, times=TIMES[3:4]) == "it is red (100%)."


def test_brightness_is_luma_weighed_by_opacity():
    scene = lights((1, 0, 0), (0, 1, 0), (0, 0, 1), opacities=(0.5, 0.5, 1.0))
    red, green, both = (thing(name, 0, rows=rows) for name, rows in (("red", (0,)), ("green", (1,)), ("both", (1, 2))))
    assert say("brightest", red, green, scene=scene) == "green is the brightest thing, 72% of white."
    assert say("brightest", red, green, scene=scene, manner="darkest") == "red is the darkest thing, 21% of white."
    assert (
        say("brightest", both, scene=scene) == f"both is the brightest thing, {(0.7152 + 2 * 0.0722) / 3:.0%} of white."
    )


def test_things_are_measured_in_the_world_and_in_the_picture():
    rows = SCENE.moving.astype(float)
    found = {"square": Selection(SCENE.ids, rows, SCENE.moving), "none": Selection(SCENE.ids, 0 * rows, rows > 2)}
    (square,) = measure(SCENE, found, np.array([0.0, 2.0]))
    assert (square.name, square.moves) == ("the square", True)
    np.testing.assert_allclose(square.centres, [[-0.2, 0, SQUARE], [-0.1, 0, SQUARE]], atol=1e-6)
    expected = np.array([-0.2, -0.1]) * FOCAL / SQUARE + WIDTH / 2
    np.testing.assert_allclose(square.pixels, np.stack([expected, np.full(2, HEIGHT / 2)], 1), atol=1e-4)
    np.testing.assert_allclose(square.depth, SQUARE, atol=1e-6)
    assert square.width == pytest.approx(0.24, abs=1e-6)
    wall = Selection(SCENE.ids, 1 - rows, ~SCENE.moving)
    (wall,) = measure(SCENE, {"wall": wall}, np.zeros(1), ("wall",))
    assert (wall.name, wall.moves) == ("wall", False) and wall.depth[0] == pytest.approx(WALL, abs=1e-4)


def test_single_ones_are_numbered_from_the_left():
    x = SCENE.static.means[:, 0]
    kind = thing("wall", 0, rows=np.flatnonzero((np.abs(x) > 0.5) & (np.abs(x - 0.1) < 0.8)))
    one, two = single_ones(SCENE, kind, TIMES[:1])
    assert (one.name, two.name) == ("wall 1 from the left", "wall 2 from the left")
    assert (x[one.rows] < 0).all() and (x[two.rows] > 0).all()
    assert len(one.rows) + len(two.rows) == len(kind.rows)
    assert single_ones(SCENE, one, TIMES[:1]) == []
    counted = say("count", replace(kind, name="the wall"))
    assert counted == "wall: 2 separate in the scene; those that touch count as one."
    assert say("count", replace(kind, name="the wall"), side="left").startswith("wall: 1 separate")


def test_moments_are_whole_frames_and_at_most_48():
    np.testing.assert_array_equal(times_of(SCENE, Asked("fast")), np.arange(6))
    np.testing.assert_array_equal(times_of(SCENE, Asked("fast", span=(2.0, 4.0))), [2, 3, 4])
    np.testing.assert_array_equal(times_of(SCENE, Asked("fast", span=(3.0, 3.0))), [3])
    assert len(times_of(SCENE, Asked("fast", span=(0.0, 100.0)))) == 48
