"""Growth of prompts on one frame, against dense matrices of all cells and loops over them."""

import itertools

import numpy as np
import pytest

from f4x_core.query import growing
from f4x_core.query.decoder_prompt import check_prompt
from f4x_core.query.growing import _inside, _likeness, grow_prompt, local_cluster, random_walk
from f4x_core.query.score import logistic


def looks(height, width, seed, noise=0.5):
    """(h,w,6) unit features: two looks, left and right, and noise."""
    random = np.random.default_rng(seed)
    kinds = random.normal(size=(2, 6))[(np.arange(width) >= width / 2).astype(int)]
    cells = kinds + noise * random.normal(size=(height, width, 6))
    return cells / np.linalg.norm(cells, axis=-1, keepdims=True)


def places(height, width):
    return np.array(list(itertools.product(range(height), range(width))))


def cluster_by_matrices(cells, seeds, possible):
    """`local_cluster` with the matrix of all bonds; the conductance of each set is counted on its own."""
    height, width = seeds.shape
    flat, at = cells.reshape(height * width, -1), places(height, width)
    steps = abs(at[:, None] - at).max(-1)
    bonds = np.exp((flat @ flat.T - 1) / growing.BOND) * ((steps > 0) & (steps <= growing.RANGE))
    degree = bonds.sum(1)
    near = (steps[:, seeds.ravel()] <= 1).any(1) & possible.ravel()
    walkers = near / near.sum()
    for _ in range(growing.STEPS):
        arriving = bonds @ (walkers / degree)
        walkers = (1 - growing.RESTART) * arriving * possible.ravel() + growing.RESTART * near / near.sum()
    order = np.argsort(-walkers / degree, kind="stable")
    least = min(max(9, int(growing.MIN_AREA * len(order))), len(order) - 1)
    most = max(least + 1, min(int(growing.MAX_AREA * len(order)), int(possible.sum())))
    conductance = []
    for last in range(least, most):
        inside = np.isin(np.arange(len(order)), order[: last + 1])
        smaller = min(degree[inside].sum(), degree[~inside].sum())
        conductance.append(bonds[inside][:, ~inside].sum() / max(smaller, 1e-9))
    first = next(i for i, value in enumerate(conductance) if value <= min(conductance) + growing.AS_GOOD)
    return np.isin(np.arange(len(order)), order[: least + first + 1]).reshape(height, width) & possible


def walk_by_matrices(cells, prior, fixed):
    """(h,w) and the sum of squared residuals of any x: the normal equations of `random_walk`."""
    height, width = prior.shape
    flat, at = cells.reshape(height * width, -1), places(height, width)
    bonds = np.exp((flat @ flat.T - 1) / growing.EDGE) * (abs(at[:, None] - at).sum(-1) == 1)
    matrix = growing.PRIOR * np.eye(len(flat)) + np.diag(bonds.sum(1)) - bonds
    right, x, free = growing.PRIOR * prior.ravel(), fixed.ravel().astype(float), np.isnan(fixed.ravel())
    x[free] = np.linalg.solve(matrix[free][:, free], right[free] - matrix[free][:, ~free] @ x[~free])
    return x.reshape(height, width), lambda x: (((matrix @ x.ravel().astype(float) - right)[free]) ** 2).sum()


def likeness_by_loops(cells, kind):
    flat, members = cells.reshape(kind.size, -1), np.flatnonzero(kind)
    result = []
    for cell in range(kind.size):
        cosines = sorted((flat[cell] @ flat[member] for member in members if member != cell), reverse=True)
        result.append(np.mean(cosines[: growing.VOTERS]) if cosines else 1.0)
    return np.reshape(result, kind.shape)


def growth_by_matrices(cells, prompt, size):
    """`grow_prompt` put together from the functions above; prompts that mark cells."""
    height, width = cells.shape[:2]
    fixed = np.full((height, width), np.nan)
    rows, columns = (np.arange(height) + 0.5) * size[0] / height, (np.arange(width) + 0.5) * size[1] / width
    if prompt.box is not None:
        left, top, right, bottom = prompt.box
        inside = ((rows >= top) & (rows <= bottom))[:, None] & ((columns >= left) & (columns <= right))
        inside[int((top + bottom) / 2 * height / size[0]), int((left + right) / 2 * width / size[1])] = True
        fixed[~inside] = 0
    for (x, y), label in zip(prompt.points, prompt.labels, strict=True):
        fixed[int(y * height / size[0]), int(x * width / size[1])] = label
    if prompt.labels.any():
        chosen = cluster_by_matrices(cells, fixed == 1, fixed != 0)
        rest = ~chosen
    else:
        rest = fixed == 0
        outside = likeness_by_loops(cells, rest)
        chosen = ~rest & (outside <= np.quantile(outside[~rest], growing.TYPICAL))
    x = chosen.astype(float)
    for _ in range(growing.ROUNDS):
        if not chosen.any() or not rest.any():
            break
        odds = (likeness_by_loops(cells, chosen) - likeness_by_loops(cells, rest)) / growing.LIKENESS
        x, _ = walk_by_matrices(cells, 1 / (1 + np.exp(-odds)), fixed)
        chosen, rest = x > 0.5, x <= 0.5
    return x


# Bounds of the area that bind below and above, walkers that start anew early, bonds that look sharply, tiny frames.
@pytest.mark.parametrize(
    ("shape", "constants"),
    [
        ((9, 11), {}),
        ((9, 11), {"MIN_AREA": 0.2, "AS_GOOD": 0.05}),
        ((9, 11), {"MAX_AREA": 0.15, "RESTART": 0.3, "STEPS": 4}),
        ((9, 11), {"RESTART": 0.4, "STEPS": 7, "BOND": 0.2, "AS_GOOD": 0.02}),
        ((8, 10), {"RESTART": 0.2, "STEPS": 30, "BOND": 0.5, "RANGE": 1}),
        ((3, 3), {}),
        ((2, 6), {"RESTART": 0.2, "STEPS": 5}),
        ((1, 11), {"RESTART": 0.2, "STEPS": 5}),
    ],
)
@pytest.mark.parametrize("noise", [0.1, 0.7])
def test_a_cluster_is_the_best_cut_of_the_walk(monkeypatch, shape, constants, noise):
    for name, value in constants.items():
        monkeypatch.setattr(growing, name, value)
    random, some = np.random.default_rng(1), 0
    for seed in range(6):
        cells, seeds, possible = looks(*shape, seed, noise), np.zeros(shape, bool), random.random(shape) < 0.95
        for cell in random.integers(0, shape, (1 + seed % 3, 2)):
            seeds[tuple(cell)] = possible[tuple(cell)] = True
        expected = cluster_by_matrices(cells, seeds, possible)
        np.testing.assert_array_equal(local_cluster(cells, seeds, possible), expected)
        some += 0 < expected.sum() < possible.sum()
    assert some or np.prod(shape) < 20


def test_a_cluster_of_few_possible_cells_is_all_of_them():
    seeds, possible = np.zeros((2, 7, 8), bool)
    seeds[3, 3] = possible[2:5, 2:4] = True
    np.testing.assert_array_equal(local_cluster(looks(7, 8, 0), seeds, possible), possible)


@pytest.mark.parametrize(("seed", "prior"), [(0, growing.PRIOR), (1, 1e-3), (2, 1e-3), (3, 3.0)])
def test_a_random_walk_is_the_solution_of_its_normal_equations(monkeypatch, seed, prior):
    """Also with a weak prior, where conjugate gradients alone arrive."""
    monkeypatch.setattr(growing, "PRIOR", prior)
    random = np.random.default_rng(seed)
    cells, wanted, fixed = looks(12, 10, seed), random.random((12, 10)), np.full((12, 10), np.nan)
    fixed[0, :4], fixed[11, 9], fixed[5, 5] = 1.0, 0.0, 0.25
    expected, residual = walk_by_matrices(cells, wanted, fixed)
    found = random_walk(cells, wanted, fixed)
    np.testing.assert_allclose(found, expected, atol=1e-5 / prior)
    assert residual(found) < 1e-9 and found.dtype == np.float32


def test_a_random_walk_without_fixed_cells_stays_in_the_unit_range():
    wanted = np.linspace(0, 1, 20).reshape(4, 5) ** 3
    found = random_walk(looks(4, 5, 3), wanted, np.full((4, 5), np.nan))
    np.testing.assert_allclose(found, walk_by_matrices(looks(4, 5, 3), wanted, found * np.nan)[0], atol=1e-4)


def test_likeness_is_the_mean_of_the_most_alike_cells():
    cells = looks(5, 6, 2)
    alike = cells.reshape(30, -1) @ cells.reshape(30, -1).T
    np.fill_diagonal(alike, -np.inf)
    for count in (1, 3, 5, 12):
        kind = np.random.default_rng(count).permutation(30).reshape(5, 6) < count
        np.testing.assert_allclose(_likeness(alike, kind), likeness_by_loops(cells, kind), atol=1e-12)


SIZE = (28, 60)  # of the picture; 7 x 12 cells: 4 pixels high, 5 wide


@pytest.mark.parametrize(
    "marks",
    [
        {"points": [[11.0, 9.0]]},
        {"points": [[11.0, 9.0], [24.9, 15.9], [59.9, 27.9], [44.0, 2.0]], "labels": [1, 1, 0, 0]},
        {"box": [9.0, 3.0, 33.0, 21.0]},
        {"box": [9.0, 7.0, 24.0, 17.0]},
        {"box": [11.0, 5.0, 14.0, 22.0]},
        {"box": [4.0, 2.0, 41.0, 27.0], "points": [[17.0, 13.0], [36.0, 22.0]], "labels": [1, 0]},
        {"box": [4.0, 2.0, 41.0, 27.0], "points": [[36.0, 22.0]], "labels": [0]},
    ],
)
@pytest.mark.parametrize("seed", [0, 1])
def test_a_prompt_grows_as_its_parts_say(marks, seed):
    cells, prompt = looks(7, 12, seed, 0.6), check_prompt(SIZE, **marks)
    np.testing.assert_allclose(grow_prompt(cells, prompt, SIZE), growth_by_matrices(cells, prompt, SIZE), atol=2e-4)


def test_where_all_looks_alike_a_box_holds_nothing_and_a_point_means_all():
    alike = np.ones((7, 12, 1))
    box = grow_prompt(alike, check_prompt(SIZE, box=[9, 3, 33, 21]), SIZE)
    assert 0 < box.max() < 0.5  # after one round nothing is left to compare with
    point = grow_prompt(alike, check_prompt(SIZE, points=[[30, 14]]), SIZE)
    assert point[3, 6] == 1 and 0.5 < point.min() < 0.9
    whole = grow_prompt(alike, check_prompt(SIZE, box=[0, 0, 60, 28]), SIZE)
    np.testing.assert_array_equal(whole, np.ones((7, 12)))


def test_a_point_at_the_very_rim_is_in_the_last_cell():
    """Its place in cells is rounded up to the edge: 51 pixels are 7 cells."""
    rim = np.nextafter(51.0, 0)
    assert rim * (7 / 51) == 7
    prompt = check_prompt((51, 51), points=[[20, 20], [rim, rim]], labels=[True, False])
    found = grow_prompt(np.ones((7, 7, 1)), prompt, (51, 51))
    assert found[6, 6] == 0 and found[6, :6].min() > 0 and found[:6, 6].min() > 0


def test_a_box_holds_the_cells_whose_centre_is_in_it():
    inside = _inside(np.array([1.0, 2.0, 3.0, 3.0]), 5, 6)
    assert np.argwhere(inside).tolist() == [[2, 1], [2, 2]]
    assert np.argwhere(_inside(np.array([0.5, 1.5, 1.5, 2.5]), 5, 6)).tolist() == [[1, 0], [1, 1], [2, 0], [2, 1]]
    # At least the one in the middle of the box, the last one at the rim.
    assert np.argwhere(_inside(np.array([2.1, 1.1, 2.2, 1.2]), 5, 6)).tolist() == [[1, 2]]
    assert np.argwhere(_inside(np.array([3.6, 2.6, 5.0, 4.0]), 5, 6)).tolist() == [[3, 4]]
    assert np.argwhere(_inside(np.array([6.0, 5.0, 6.0, 5.0]), 5, 6)).tolist() == [[4, 5]]


def test_log_odds_and_probabilities():
    odds = np.array([-29.0, -1.5, 0.0, 0.3, 12.0])
    found = logistic(odds)
    np.testing.assert_allclose(np.log(found) - np.log1p(-found), odds, atol=1e-6)
    ends = logistic(np.array([-1e6, 1e6]))
    assert ends[0] == pytest.approx(np.exp(-30), rel=1e-9, abs=0) and 1 - ends[1] == pytest.approx(
        np.exp(-30), rel=0.01, abs=0
    )


def test_a_box_around_a_few_cells_finds_them():
    """No cell of a small thing is unlike the thing because there are too few others."""
    kinds = np.zeros((20, 30), int)
    kinds[8:10, 10:12] = 1
    for seed in range(6):
        random = np.random.default_rng(seed)
        cells = random.normal(size=(2, 24))[kinds] + 0.4 * random.normal(size=(20, 30, 24))
        cells /= np.linalg.norm(cells, axis=-1, keepdims=True)
        found = grow_prompt(cells, check_prompt((80, 120), box=[38, 30, 50, 42]), (80, 120))
        np.testing.assert_array_equal(found > 0.5, kinds == 1)


@pytest.mark.parametrize("marks", [{"points": [[2.0, 4.0]]}, {"box": [0.5, 0.5, 5.0, 8.0]}])
def test_contrast_is_the_unit_of_all_cosine_steps(monkeypatch, marks):
    """Cells that share a large part differ less in their cosines; with that contrast they grow as the others do."""
    cells = looks(9, 11, 3, 0.3)
    common = np.full((9, 11, 1), 2.0)
    shared = np.concatenate([cells, common], -1) / np.sqrt(5)
    prompt = check_prompt((9, 11), **marks)
    expected = grow_prompt(cells, prompt, (9, 11))
    np.testing.assert_allclose(grow_prompt(shared, prompt, (9, 11), 1 / 5), expected, atol=1e-5)
    assert not np.allclose(grow_prompt(shared, prompt, (9, 11)), expected, atol=1e-3)
