"""Zakeri 2023's table and studies: their figures of merit on made-up draws, and the parts in small."""

import jax
import numpy as np
import pytest

from jaxest.mcmc import diagnostics
from jaxest.reproduce import Choice
from jaxest.reproduce.zakeri2023 import PARTS, figures, runs, studies
from jaxest.systems import torque_model, torque_posterior
from jaxest.systems.torque_settings import TORQUE, VARIANCE
from jaxest.types import InputError


def made_up(spread=0.01):
    """A result whose draws are known: torques 2 % too large, variances right."""
    random = np.random.default_rng(0)
    theta = 1.02 * TORQUE * (1 + spread * random.normal(size=(4, 500, 7)))
    variances = VARIANCE * np.exp(0.1 * random.normal(size=(4, 500, 21)))
    names = [name for group in torque_posterior.names(torque_model.constant(7)) for name in group]
    columns = np.concatenate([theta, np.log(variances)], axis=2)
    summaries = {name: diagnostics.summary(columns[:, :, i]) for i, name in enumerate(names)}
    updates = np.full((4, 100), 0.9)
    updates[2, :40] = 0.01
    verdict = diagnostics.verdict(summaries, updates)
    posterior = torque_posterior.Posterior(theta, variances, updates, np.full(100, 900.0), np.full(100, 15.0), 0.5,
                                           summaries, verdict)  # fmt: skip
    return runs.Result(None, posterior, 1.0, 500, 4)


def test_torques_stand_beside_the_papers():
    rows = {row.metric: row for row in figures.tau_rows(made_up(), runs.PAPER_TAU["mh"], "the paper's mean")}
    assert rows["tau3"].value == pytest.approx(1.02 * 1.8, rel=2e-3)
    assert rows["tau3"].reference == 1.7296
    assert rows["tau7"].reference is None  # lost in the paper
    assert rows["tau3: error"].value == pytest.approx(2, abs=0.1)
    assert rows["tau3: error"].reference == pytest.approx(3.9, abs=0.05)
    assert rows["mean torque error"].n == 6
    assert rows["mean torque error"].reference == pytest.approx(12.07, abs=0.02)


def test_a_chain_whose_path_stands_still_is_named():
    rows = figures.health(made_up(), "made up")
    assert rows[-1].value == 0
    assert rows[-1].metric == "verdict"
    assert "path frozen before step 39" in rows[-1].condition


def test_accuracy_is_measured_by_what_the_posterior_allows():
    random = np.random.default_rng(1)
    z = random.normal(size=(400, 7))
    error, spread, covered = np.abs(z) * 0.3, np.full((400, 7), 0.3), np.abs(z) < 1.96
    rows = {row.metric: row for row in studies._accuracy_rows("gibbs", 0.14, error, z, covered, spread)}
    assert rows["mean torque error over what the posterior allows"].value == pytest.approx(1, abs=0.06)
    assert rows["rms z-score"].value == pytest.approx(1, abs=5 * rows["rms z-score"].spread)
    assert rows["truth inside 95 % interval"].value == pytest.approx(95, abs=2.5)


def test_a_setting_that_is_none_is_named():
    with pytest.raises(InputError, match="reachable"):
        PARTS["table1"](Choice(small=True, setting="reachabel"), lambda message: None)


@pytest.mark.slow  # compiles the arm's samplers for a minute
def test_the_parts_end_in_small(tmp_path):
    said = []
    choice = Choice(small=True, work=tmp_path)
    for name in ("table1", "fig1", "starts"):
        section = PARTS[name](choice, said.append)
        assert section.name == name
        assert all(np.isfinite(row.value) for row in section.rows if row.metric != "R-hat, largest")
        if section.draw is not None:
            section.draw(tmp_path / f"{name}.png")
            assert (tmp_path / f"{name}.png").stat().st_size > 10_000
    assert any("gibbs" in one for one in said)
    assert list(tmp_path.glob("gibbs_paper_0*/piece*.npz"))
    assert not jax.config.jax_enable_x64
