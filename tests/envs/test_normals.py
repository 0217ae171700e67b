"""Normal numbers of streams: their distribution, and that no stream knows another."""

import numpy as np

from robofleet.envs.normals import STREAMS, draw, streams


def test_numbers_are_normal_and_streams_are_independent() -> None:
    from scipy import stats  # half a second, and each worker imports each file

    state, drawn = streams(np.random.default_rng(5)), np.empty((4000, 2 * STREAMS))
    for row in drawn:
        draw(state, row)
    assert stats.kstest(drawn.ravel(), "norm").pvalue > 0.001
    assert 4.0 < np.abs(drawn).max() < 6.7
    both = np.concatenate([drawn[:-1], drawn[1:]], axis=1)  # with what is drawn next
    correlations = np.corrcoef(np.concatenate([both, both**2], axis=1).T)[np.triu_indices(8 * STREAMS, 1)]
    assert np.abs(correlations).max() < 6.0 / np.sqrt(len(both))
