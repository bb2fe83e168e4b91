"""Masks without a model: votes of alike cells, prompts that grow, and the small tools below them."""

import numpy as np
import pytest
from scipy import ndimage

from f4x_core.errors import F4xError
from f4x_core.query.segmentation import BLOCK, FeaturePropagation, PropagationConfig, enlarge, shifted, shrink, windows

GRID, SIZE, COUNT = (20, 30), (80, 120), 9
RNG = np.random.default_rng(0)
LOOKS = RNG.normal(size=(3, 24)).astype(np.float32)


def disc(t):
    """Cells (h,w) bool of a disc that moves two cells a frame to the right and one down every third frame."""
    y, x = np.mgrid[: GRID[0], : GRID[1]]
    return (y - 8 - t // 3) ** 2 + (x - 7 - 2 * t) ** 2 <= 16


def features(t):
    """A disc of one look before a background of two, with noise."""
    background = (np.arange(GRID[1]) > 12).astype(int)[None].repeat(GRID[0], 0)
    kind = np.where(disc(t), 2, background)
    return LOOKS[kind] + 0.6 * np.random.default_rng(t).normal(size=(*GRID, 24)).astype(np.float32)


def picture(cells):
    return np.kron(cells, np.ones((4, 4), bool)).astype(bool)


def overlap(a, b):
    return (a & b).sum() / (a | b).sum()


@pytest.fixture
def masks():
    return FeaturePropagation(features, COUNT, SIZE)


@pytest.mark.parametrize("start", [0, 4, 8])
def test_a_mask_follows_its_object_both_ways(masks, start):
    masks.prompt(start, mask=picture(disc(start)))
    found = dict(masks.propagate())
    assert overlap(found[start] > 0, picture(disc(start))) > 0.9
    assert list(found) == [*range(start, COUNT), *range(start - 1, -1, -1)]
    assert all(logits.shape == SIZE and logits.dtype == np.float32 for logits in found.values())
    assert min(overlap(found[t] > 0, picture(disc(t))) for t in found) > 0.8


def test_the_length_of_features_does_not_matter(masks):
    scaled = FeaturePropagation(lambda t: 7 * features(t), COUNT, SIZE)
    for decoder in (masks, scaled):
        decoder.prompt(0, mask=picture(disc(0)))
    for (_, one), (_, other) in zip(masks.propagate(), scaled.propagate(), strict=True):
        assert np.abs(one - other).max() < 1e-2


def test_a_second_prompt_corrects_from_its_frame_on(masks):
    masks.prompt(0, mask=picture(disc(0)))
    masks.prompt(5, mask=np.roll(picture(disc(5)), 16, axis=0))
    found = dict(masks.propagate())
    assert overlap(found[5] > 0, np.roll(picture(disc(5)), 16, axis=0)) > 0.85
    assert overlap(found[1] > 0, picture(disc(1))) > 0.8


def test_an_object_that_left_is_not_found_elsewhere():
    def leaving(t):
        return features(t) if t < 3 else LOOKS[np.zeros(GRID, int)] + 0.1 * RNG.normal(size=(*GRID, 24))

    masks = FeaturePropagation(leaving, 6, SIZE, PropagationConfig(neighbours=10))
    masks.prompt(0, mask=picture(disc(0)))
    assert (dict(masks.propagate())[5] > 0).sum() <= (picture(disc(0)).sum() * 0.5)


def test_refusals(masks):
    with pytest.raises(F4xError, match="Nothing is prompted yet"):
        next(masks.propagate())
    with pytest.raises(F4xError, match="There is no frame 9"):
        masks.prompt(9, mask=picture(disc(0)))
    with pytest.raises(F4xError, match="The mask is empty"):
        masks.prompt(0, mask=np.zeros(SIZE))


def test_windows_hold_a_block_and_what_is_around_it():
    values = np.arange(11 * 13, dtype=np.float32).reshape(11, 13, 1) + 1
    found = windows(values, 2)
    assert found.shape == (4, (BLOCK + 4) ** 2, 1)
    second = found[1, :, 0].reshape(BLOCK + 4, BLOCK + 4)
    assert np.array_equal(second[2:, :7], values[:10, 6:, 0])
    assert (second[:2] == 0).all()
    assert np.array_equal(windows(values, 0)[0, :, 0].reshape(BLOCK, BLOCK), values[:8, :8, 0])


@pytest.mark.parametrize("move", [(0, 0), (0, 1), (1, 0), (2, -1), (-3, 4), (9, 0), (-20, 20)])
def test_shifting_drops_what_leaves(move):
    values = np.arange(1, 43.0).reshape(6, 7)
    expected = ndimage.shift(values, move, order=0, cval=0.0)
    assert np.array_equal(shifted(values, move), expected)


def test_shrinking_means_and_enlarging_interpolates():
    values = np.random.default_rng(3).random((12, 15)).astype(np.float32)
    assert np.allclose(shrink(values, (4, 5)), values.reshape(4, 3, 5, 3).mean((1, 3)), atol=1e-6)
    assert shrink(values, (5, 7)).mean() == pytest.approx(values.mean(), abs=1e-6)
    ramp = np.tile(np.arange(5, dtype=np.float32), (4, 1))
    found = enlarge(ramp, (8, 20))
    assert np.allclose(found[0, 2:-2], (np.arange(2, 18) + 0.5) / 4 - 0.5, atol=1e-5)


@pytest.mark.real
@pytest.mark.parametrize(("name", "least"), [("camel", 0.88), ("blackswan", 0.89), ("dog", 0.88)])
def test_first_masks_of_real_clips_reach_frame_30(name, least, shared):
    from f4x_core.clip import read_clip
    from f4x_core.features.teachers import TEACHERS

    clip = read_clip(shared / "clips" / name, frames="0:31:1", masks="layout")
    teacher = TEACHERS["visual"].load()
    maps = [teacher.encode(frame) for frame in clip.frames]
    decoder = FeaturePropagation(maps.__getitem__, len(clip), (clip.height, clip.width))
    decoder.prompt(0, mask=clip.masks[0])
    found = dict(decoder.propagate())
    score = {t: round(float(overlap(found[t] > 0, clip.masks[t])), 3) for t in (5, 10, 30)}
    print(name, score)
    assert score[30] >= least
