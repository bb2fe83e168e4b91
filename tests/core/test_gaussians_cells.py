"""Which cells of a frame get a Gaussian, against loops over pixels, cells and the Gaussians that exist."""

from collections import Counter

import numpy as np
import pytest

from f4x_core.gaussians import SpawnConfig, Spawned
from f4x_core.gaussians.spawn import DepthImage, coarse_to_fine, cover
from f4x_core.geometry.camera import Camera

Cells = dict[tuple[int, int], list[tuple[int, int]]]
"""Pixels (row, column) of each cell (row, column); or cells of each block."""


def cells_of(height: int, width: int, spacing: float) -> Cells:
    """As many whole cells as fit, stretched to the picture's sides, one at least."""
    down, across = max(int(height / spacing), 1), max(int(width / spacing), 1)
    found: Cells = {}
    for row in range(height):
        for column in range(width):
            found.setdefault((row * down // height, column * across // width), []).append((row, column))
    return found


class Frame:
    """A frame of flat and of noisy patches whose depth and tolerance are the same all over a cell, some pixels unknown."""

    def __init__(self, height: int, width: int, spacing: float):
        rng = np.random.default_rng(height)
        self.spacing, self.cells = spacing, cells_of(height, width, spacing)
        self.camera = Camera(np.array([[50.0, 0, 13], [0, 70, 11], [0, 0, 1]]), np.eye(4), width, height)
        self.camera.world_to_camera[:3, 3] = [0.2, -0.1, 0.3]
        side = int(8 * spacing)
        rows, columns = np.indices((height, width))
        patch = rows // side + 31 * (columns // side)
        flat = patch % 3 > 0
        self.image = np.repeat((90 + 5 * (patch % 7))[..., None], 3, 2)
        self.image[~flat] = rng.integers(0, 255, (int((~flat).sum()), 3))
        for _ in range(2 + width * height // 400):  # specks that only small blocks around them notice
            self.image[rng.integers(height), rng.integers(width)] += 9
        self.depth, self.tolerance = np.zeros((height, width)), np.zeros((height, width))
        for number, pixels in enumerate(self.cells.values()):
            near, tolerance = number % 11 == 0, rng.choice([0.05, 0.2])
            for pixel in pixels:
                self.depth[pixel], self.tolerance[pixel] = 1.1 if near else 2, tolerance
        self.valid = rng.random((height, width)) > 0.004
        if height * width > 1000:
            self.valid[height // 2 :, : int(5 * spacing)] = (
                rng.random(self.valid[height // 2 :, : int(5 * spacing)].shape) < 0.2
            )
        self.depth[~self.valid] = np.nan
        count = max(len(self.cells) // 9, 3)
        spread, dense = rng.uniform(-0.1, 1.1, (count, 2)), rng.uniform(0.6, 1, (2 * count, 2))
        pixels = np.concatenate([spread, dense]) * [width, height]
        outside = [[-0.3, 0.4], [0.4, -0.3], [width + 0.3, 0.4], [width + 0.3, height / 2], [0.4, height + 0.3]]
        pixels = np.concatenate([pixels, outside, pixels[:2]])
        z = rng.choice([1.1, 2.0], len(pixels), p=[0.2, 0.8]) * (1 + rng.choice([0, 0.1, -0.1, 0.3], len(pixels)))
        z[-2:] *= -1
        self.existing = self.camera.unproject(pixels, z)

    def levels(self) -> dict[tuple[int, int], int]:
        """0, or 1 and then 2 where all pixels of a block are known and deviate by less than 3 levels of grey and 2 % of depth."""
        found = dict.fromkeys(self.cells, 0)
        for level in (1, 2):
            blocks: Cells = {}
            for row, column in self.cells:
                blocks.setdefault((row >> level, column >> level), []).append((row, column))
            for inside in blocks.values():
                pixels = tuple(np.array([pixel for cell in inside for pixel in self.cells[cell]]).T)
                if not self.valid[pixels].all() or np.std(np.log(self.depth[pixels])) >= 0.02:
                    continue
                if np.std(self.image[pixels].mean(-1)) < 3:
                    found |= {cell: level for cell in inside if found[cell] == level - 1}
        return found

    def hits(self) -> Counter[tuple[int, int]]:
        """How many Gaussians are seen in each cell at about its depth."""
        height, width = self.depth.shape
        down, across = (1 + max(cell[axis] for cell in self.cells) for axis in (0, 1))
        found: Counter[tuple[int, int]] = Counter()
        for x, y, z in self.existing + self.camera.world_to_camera[:3, 3]:
            if z > 0 and 0 <= (column := 50 * x / z + 13) < width and 0 <= (row := 70 * y / z + 11) < height:
                cell = int(row * down / height), int(column * across / width)
                known = [pixel for pixel in self.cells[cell] if self.valid[pixel]]
                if known and abs(z - self.depth[known[0]]) <= self.tolerance[known[0]] * self.depth[known[0]]:
                    found[cell] += 1
        return found

    def open_blocks(self, enough: int = 4) -> set[tuple[int, int, int]]:
        """(level, row, column) of the blocks that show something and have no Gaussian inside nor `enough` in all around."""
        found, levels, hits = set(), self.levels(), self.hits()
        inside: dict[int, Counter[tuple[int, ...]]] = {level: Counter() for level in (0, 1, 2)}
        for (row, column), count in hits.items():
            for level, counted in inside.items():
                counted[row >> level, column >> level] += count
        end = [max(cell[axis] for cell in self.cells) for axis in (0, 1)]
        for (row, column), level in levels.items():
            last = [number >> level for number in end]
            block = row >> level, column >> level
            around = 0
            for down in (-1, 0, 1):
                for across in (-1, 0, 1):  # beyond the rim is what is at the rim
                    beside = zip(block, (down, across), last, strict=True)
                    around += inside[level][tuple(min(max(b + d, 0), n) for b, d, n in beside)]
            if (
                not inside[level][block]
                and around < enough
                and any(self.valid[pixel] for pixel in self.cells[row, column])
            ):
                found.add((level, *block))
        return found


SIZES = [(61, 23, 2.0), (29, 47, 3.0), (40, 67, 2.5), (9, 9, 1.0), (3, 50, 4.0), (50, 3, 4.0), (25, 31, 1.0)]


@pytest.mark.parametrize(("height", "width", "spacing"), SIZES)
def test_each_cell_or_plain_block_that_nothing_covers_gets_one_gaussian(height, width, spacing):
    frame, config = Frame(height, width, spacing), SpawnConfig(spacing=spacing, scale=0.4)
    rng = np.random.default_rng(1)
    view = DepthImage(frame.image, frame.depth, frame.valid, frame.camera, frame.tolerance)
    found = cover(view, frame.existing, config, rng)
    levels, cell_at = frame.levels(), {pixel: cell for cell, pixels in frame.cells.items() for pixel in pixels}
    blocks = []
    for mean, rgb, radius, depth in zip(found.means, found.rgb, found.radius, found.depth, strict=True):
        x, y, z = mean.astype(float) + frame.camera.world_to_camera[:3, 3]
        pixel = int(70 * y / z + 11), int(50 * x / z + 13)
        assert (50 * x / z + 13) % 1 == pytest.approx(0.5, abs=1e-3) == (70 * y / z + 11) % 1
        row, column = cell_at[pixel]
        level = levels[row, column]
        blocks.append((level, row >> level, column >> level))
        assert (
            frame.valid[pixel]
            and z == pytest.approx(frame.depth[pixel], rel=1e-5)
            and depth == np.float32(frame.depth[pixel])
        )
        np.testing.assert_allclose(rgb, frame.image[pixel] / 255, rtol=1e-6)
        assert radius == pytest.approx(0.4 * spacing * 2**level * depth / 60, rel=1e-5)
    assert len(blocks) == len(set(blocks)) and set(blocks) == frame.open_blocks()


def test_the_frames_have_all_that_matters():
    """Blocks of every size, with a Gaussian inside, with enough around, and with neither."""
    frames = [Frame(*size) for size in SIZES]
    blocks = Counter(level for frame in frames for level, *_ in frame.open_blocks())
    assert min(blocks[level] for level in (0, 1, 2)) > 2
    hits = Counter(n for frame in frames for n in frame.hits().values())
    assert hits[1] > 10 and hits[2]
    assert all(len(frame.open_blocks(5)) > len(frame.open_blocks()) > len(frame.open_blocks(3)) for frame in frames[:3])


def test_a_single_pixel_gets_a_gaussian_and_an_empty_frame_none():
    camera = Camera(np.array([[50.0, 0, 5], [0, 50, 5], [0, 0, 1]]), np.eye(4), 10, 10)
    image, valid = np.full((10, 10, 3), 51, np.uint8), np.zeros((10, 10), bool)
    for count in (0, 1):
        valid[3, 4] = count
        view = DepthImage(image, np.full((10, 10), 2.0), valid, camera)
        found = cover(view, np.zeros((0, 3)), SpawnConfig(), np.random.default_rng(0))
        np.testing.assert_allclose(found.means, np.full((count, 3), [-0.02, -0.06, 2.0]), rtol=1e-6)
        np.testing.assert_allclose(found.rgb, np.full((count, 3), 0.2), rtol=1e-6)
        assert len(found) == len(found.radius) == len(found.depth) == count


def test_a_wall_is_covered_by_large_ones_up_to_its_rim():
    """Nine cells a side: blocks of 4 x 4 pixels, at the rim of 1 x 4, in the corner of a single pixel."""
    camera = Camera(np.array([[50.0, 0, 5], [0, 50, 5], [0, 0, 1]]), np.eye(4), 9, 9)
    image, depth = np.full((9, 9, 3), 120, np.uint8), np.full((9, 9), 2.0)
    config, nothing = SpawnConfig(spacing=1.0, scale=1.0), np.zeros((0, 3))
    found = cover(DepthImage(image, depth, depth > 0, camera), nothing, config, np.random.default_rng(0))
    np.testing.assert_allclose(found.radius, np.full(9, 4 * 2.0 / 50), rtol=1e-6)


def test_nothing_joined_is_nothing():
    nothing = Spawned.joined([])
    assert [array.shape for array in vars(nothing).values()] == [(0, 3), (0, 3), (0,), (0,)]
    assert {array.dtype for array in vars(nothing).values()} == {np.dtype(np.float32)}
    some = Spawned(*(np.ones(shape, np.float32) for shape in ((2, 3), (2, 3), (2,), (2,))))
    assert len(Spawned.joined([some, nothing, some])) == 4


@pytest.mark.parametrize(
    ("count", "order"),
    [
        (1, [0]),
        (2, [0, 1]),
        (3, [0, 2, 1]),
        (7, [0, 6, 3, 1, 2, 4, 5]),  # steps of 6, 3, 1
        (10, [0, 9, 4, 8, 2, 6, 1, 3, 5, 7]),  # steps of 9, 4, 2, 1
    ],
)
def test_each_level_halves_the_gaps(count, order):
    assert list(coarse_to_fine(count)) == order
