"""No motion at all.

Hard: every node rests, and the asked time is the reference time itself.

Why: norms of differences and angles are 0, and the derivative of a square root at 0 is infinite.

Must hold: nothing moves, and gradients are finite and those of float64.
"""

from benchmarks.studies.hard_cases import within

from .common.carrying import carry_plainly, compare, differentiate, np, torch, turning

STAGE = "deformation"


def check():
    carried = turning(0.0)
    carried = carried.with_(node_xyz=np.repeat(carried.leaves["node_xyz"][:1], 5, 0))
    yield from compare(carried, 0.0)
    (there, _), _ = differentiate(carry_plainly, carried, 0.0, torch.float64)
    (later, _), _ = differentiate(carry_plainly, carried, 3.5, torch.float64)
    yield within("what rests is at its place", abs(later - there).max(), 1e-12)
