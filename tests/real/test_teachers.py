"""The teachers with their real weights on real clips: what words and looks alone find, frame by frame."""

import cv2
import numpy as np
import pytest

from f4x_core.clip import read_clip
from f4x_core.features.teachers import TEACHERS
from f4x_core.features.text import load_text_encoder

pytestmark = [pytest.mark.real, pytest.mark.slow]
NEGATIVES = ["sky", "grass", "tree", "water", "road", "building", "wall", "ground", "sand", "rock"]
EVERY = 12


@pytest.fixture(scope="module")
def text():
    return TEACHERS["text"].load(), load_text_encoder("minilm")


def average_precision(score, mask):
    """Area under precision over recall of the pixels of `mask`, ranked by `score`."""
    hits = mask.ravel()[np.argsort(-score.ravel(), kind="stable")]
    return (hits.cumsum() / np.arange(1, hits.size + 1))[hits].mean()


@pytest.mark.parametrize(
    ("name", "word", "reach"),
    [("blackswan", "swan", 0.69), ("car-shadow", "car", 0.67), ("camel", "camel", 0.38), ("dog", "dog", 0.43)],
)
def test_words_find_things(shared, text, name, word, reach):
    teacher, encoder = text
    clip = read_clip(shared / "clips" / name, width=480, masks="layout")
    labels = encoder.encode([word, *NEGATIVES])
    scores = []
    for t in range(0, len(clip), EVERY):
        cosines = teacher.encode(clip.frames[t]) @ labels.T  # (h,w,11): both are unit vectors
        score = cosines[..., 0] - cosines[..., 1:].max(-1)
        scores.append(average_precision(cv2.resize(score, (clip.width, clip.height)), clip.masks[t]))
    print(f"{name}: AP of '{word}' {np.mean(scores):.3f} over {len(scores)} frames (chance {clip.masks.mean():.2f})")
    assert np.mean(scores) > reach


@pytest.mark.parametrize("name", ["camel", "blackswan", "dog"])
def test_what_looks_alike_is_the_same_thing(shared, name):
    teacher = TEACHERS["visual"].load()
    clip = read_clip(shared / "clips" / name, width=480, masks="layout")
    grid = teacher.spec_for(clip.width, clip.height).grid
    first, later = (teacher.encode(clip.frames[t]).reshape(-1, 96) for t in (0, 10))
    mask = [cv2.resize(clip.masks[t].astype(np.float32), grid[::-1], interpolation=cv2.INTER_AREA) for t in (0, 10)]
    nearest = np.argsort(-(later @ first.T), axis=1)[:, :5]
    found = mask[0].ravel()[nearest].mean(1) > 0.5
    truth = mask[1].ravel() > 0.5
    overlap = (found & truth).sum() / (found | truth).sum()
    print(f"{name}: IoU of the mask carried from frame 0 to 10 {overlap:.3f}")
    assert overlap > 0.8
