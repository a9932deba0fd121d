"""Diagnostics against ArviZ, and what the verdict says."""

import warnings

import numpy as np
import pytest

from jaxest.mcmc import diagnostics


def chains(kind, seed=0):
    rng = np.random.default_rng(seed)
    x = rng.normal(size=(4, 1001))
    if kind == "slow":
        for i in range(1, x.shape[1]):
            x[:, i] = 0.95 * x[:, i - 1] + np.sqrt(1 - 0.95**2) * x[:, i]
    if kind == "apart":
        x += np.arange(4)[:, None]
    if kind == "heavy":
        x = x / np.abs(rng.normal(size=x.shape))
    if kind == "ties":
        x = np.repeat(x[:, ::5], 5, axis=1)[:, :1001]
    return x


@pytest.mark.parametrize("kind", ["plain", "slow", "apart", "heavy", "ties"])
def test_summary_is_arvizs(kind):
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        arviz = pytest.importorskip("arviz")
    x = chains(kind)
    found = diagnostics.summary(x)
    np.testing.assert_allclose(found.r_hat, arviz.rhat(x), rtol=1e-6)
    np.testing.assert_allclose(found.bulk, arviz.ess(x, method="bulk"), rtol=1e-3)
    np.testing.assert_allclose(found.tail, arviz.ess(x, method="tail"), rtol=1e-3)
    np.testing.assert_allclose(found.mcse, arviz.mcse(x), rtol=1e-2)


def test_a_frozen_path_is_named_though_its_draws_look_fine():
    good = {"a": diagnostics.summary(chains("plain"))}
    updates = np.where(np.arange(100) < 60, 0.0, 0.9)
    found = diagnostics.verdict(good, updates)
    assert not found.good
    assert "path frozen before step 59" in found.reasons[0]
    assert diagnostics.verdict(good, np.full((4, 100), 0.9)).good
    assert "frozen everywhere" in diagnostics.verdict(good, np.zeros(100)).reasons[0]
    assert not diagnostics.verdict(good, np.array([[0.9], [0.0]])).good, "one chain of two is frozen"


def test_chains_apart_and_few_draws_are_named():
    found = diagnostics.verdict({"a": diagnostics.summary(chains("apart"))})
    assert not found.good
    assert "chains disagree: R-hat" in found.reasons[0]
    found = diagnostics.verdict({"slow": diagnostics.summary(chains("slow")[:, :400])}, r_hat=9.0)
    assert "too few effective draws: bulk" in found.reasons[0]
    constant = diagnostics.summary(np.zeros((2, 10)))
    assert not diagnostics.verdict({"a": constant}).good
    for lost in (np.inf, np.nan):
        draws = np.random.default_rng(0).normal(size=(4, 400))
        draws[0, 3] = lost
        with np.errstate(invalid="ignore"):
            found = diagnostics.verdict({"a": diagnostics.summary(draws)})
        assert found.reasons[0] == "draws that are not finite: of a"


def test_wrong_shape():
    with pytest.raises(ValueError, match=r"draws: has shape \(3,\)"):
        diagnostics.summary(np.zeros(3))
