"""The mean of parameters over the last steps of a fit."""

import numpy as np
import pytest
import torch

from f4x_core.fit.averaging import RunningMeans


@pytest.mark.parametrize("stopped_after", [0, 1, 3, None])
def test_means_are_those_of_all_steps_counted_resumed_or_not(stopped_after):
    values = torch.from_numpy(np.random.default_rng(0).normal(size=(5, 4, 3))).float()
    leaf, means = torch.zeros(4, 3, requires_grad=True), RunningMeans()
    for step, value in enumerate(values):
        if step == stopped_after:
            state, means = means.state(), RunningMeans()
            means.restore(state)
            leaf = torch.zeros(4, 3, requires_grad=True)
        with torch.no_grad():
            leaf.copy_(value)
        means.add({"leaf": leaf})
    means.put({"leaf": leaf})
    torch.testing.assert_close(leaf.detach(), values.mean(0))
    assert leaf.requires_grad


def test_a_tensor_whose_rows_were_replaced_begins_anew():
    means, kept, old = RunningMeans(), torch.ones(2), torch.ones(3)
    means.add({"kept": kept, "changed": old})
    new = torch.full((3,), 5.0)
    kept += 2
    means.add({"kept": kept, "changed": new})
    means.put({"kept": kept, "changed": new})
    assert kept.tolist() == [2, 2] and new.tolist() == [5, 5, 5]
    means.put({"changed": old})
    assert old.tolist() == [1, 1, 1], "never counted as it is now"
