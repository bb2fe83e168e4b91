"""Labels asked of features that are zero, huge, or all alike.

Hard: a latent of length 0, cosines of equal labels, temperatures near 0, truths without a pixel.

Why: cosines divide by lengths, a softmax overflows, and precision over nothing is 0/0.

Must hold: probabilities that sum to 1, a score over nothing that says NaN, no label at all refused.
"""

import math

import numpy as np

from benchmarks.studies.hard_cases import refused, that, within
from f4x_core.query.score import average_precision, overlap, text_scores

STAGE = "query"


def check():
    rng = np.random.default_rng(0)
    features = np.concatenate([np.zeros((1, 8)), rng.normal(size=(3, 8)), 1e4 * rng.normal(size=(1, 8))]).astype(
        np.float32
    )
    labels = np.concatenate([rng.normal(size=(2, 8)), np.zeros((1, 8))]).astype(np.float32)
    for temperature in (1e-4, 0.07, 1e4):
        scores = text_scores(features, labels, temperature)
        exact = text_scores(features.astype(float), labels.astype(float), temperature)
        yield within(f"temperature {temperature:g}: sums", abs(scores.sum(-1) - 1).max(), 1e-5)
        allowed = 5e-3 if temperature < 0.01 else 2e-5
        yield within(f"temperature {temperature:g}: against float64", abs(scores - exact).max(), allowed)
    nothing = np.zeros(5, bool)
    yield that("precision over nothing is no number", math.isnan(average_precision(np.ones(5), nothing)))
    yield that("nothing against nothing agrees", overlap(nothing, nothing) == 1)
    yield refused("no label", "no labels", lambda: text_scores(features, labels[:0]))
    yield refused("temperature 0", "not above 0", lambda: text_scores(features, labels, 0.0))
