"""Where a projector's light falls."""

import numpy as np
import pytest

from robofleet.projection.model import GAMMA, VALUES, Projector, gray_shares
from tests.projection.projectors import SIZE, on_floor, pixels, tilted


def test_a_pixel_lights_the_place_that_it_is_the_pixel_of() -> None:
    projector = tilted()
    assert projector.pixels(on_floor(projector.floor(pixels()))) == pytest.approx(pixels(), abs=1e-6)


def test_what_the_picture_does_not_light_has_no_pixel() -> None:
    """Also where a strong lens would bring far places back into the picture, and behind the projector."""
    projector = tilted(k1=-0.3)
    far = on_floor(np.column_stack([np.linspace(2.5, 40.0, 300), np.zeros(300)]))
    above = np.array([[0.0, 0.0, 5.0]])
    assert not projector.lights(np.vstack([far, above])).any()
    assert projector.lights(np.zeros((1, 3))).all()


def test_a_file_has_the_whole_projector() -> None:
    projector = tilted()
    again = Projector.from_model(projector.model)
    assert again.floor(pixels()) == pytest.approx(projector.floor(pixels()), abs=1e-9)


def test_the_spread_is_that_of_draws_of_the_covariance() -> None:
    rng = np.random.default_rng(1)
    sigma = np.array([1e-3] * 3 + [1e-3] * 3 + [1e-3, 2.0, 2.0, 1e-3, 1e-3, 1e-4, 1e-4])
    projector = tilted()
    known = Projector(projector.geometry, SIZE, np.diag(sigma**2))
    some = pixels(4, 3)
    draws = np.array([known.changed(sigma * rng.standard_normal(len(VALUES))).floor(some) for _ in range(2000)])
    drawn = np.var(draws, axis=0).sum(axis=1)
    predicted = np.trace(known.spread(on_floor(known.floor(some))), axis1=1, axis2=2)
    assert predicted == pytest.approx(drawn, rel=0.15)


def test_two_projectors_share_the_light_where_both_reach() -> None:
    pair = {"left": tilted(-0.8), "right": tilted(0.9, degrees=-4.0)}
    X, Y = np.meshgrid(np.linspace(-2.5, 2.5, 80), np.linspace(-0.8, 0.8, 30))
    points = on_floor(np.column_stack([X.ravel(), Y.ravel()]))
    total, lit = np.zeros(len(points)), np.zeros((2, len(points)), bool)
    for k, (name, projector) in enumerate(pair.items()):
        at, share = projector.pixels(points), gray_shares(pair, name) ** GAMMA
        lit[k] = np.isfinite(at[:, 0])
        u, v = np.rint(at[lit[k]]).astype(int).T
        total[lit[k]] += share[v, u]
    both = lit.all(axis=0)
    assert both.sum() > 100
    assert np.percentile(np.abs(total[lit.any(axis=0)] - 1.0), 99) < 0.03


def test_a_projector_alone_keeps_all_of_its_light() -> None:
    share = gray_shares({"main": tilted()}, "main")
    assert share.shape == SIZE[::-1]
    assert share[1:-1, 1:-1].min() > 0.99
