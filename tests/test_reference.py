"""Every reference case, every scheme, every solver: orders, errors and certificates."""

import warnings
from functools import cache

import numpy as np
import pytest
from cases import Spiral, slope, slow, worst_certificate
from reference_cases import GRIDS, SETS, case

import sweepopt as so

RUNS = [(name, scheme) for name in SETS for scheme in case(name).errors]
SECOND_ORDER = ("midpoint", "trapezoid", "sdirk2")
REFINED = ("S03", "S04", "V05", "P09", "B14", "B15", "M16", "E20")
"""Cases whose orders are fitted, of every kind but the linear one; the others have their errors."""
FITTED = ("S03", "V05", "M16", "E20")  # without -m slow: a box, a curved set, A = 0, a cone


@cache
def run(this, steps, scheme, solver="auto", tol=1e-6):
    with warnings.catch_warnings():
        # V05, L13 start outside of C(0) on purpose
        warnings.simplefilter("ignore", so.InitialStateWarning)
        # and midpoint rings at A = 0
        settings = {"scheme": scheme, "solver": solver, "tol": tol, "on_unstable": "ignore"}
        return so.solve(this.process, t_end=this.t_end, steps=steps, **settings)


SOME = GRIDS[:3]
SLOW = [slow(*each, (*GRIDS, 2003)) for each in RUNS]


@pytest.mark.parametrize(
    "name, scheme, grids",
    [*((*each, SOME if each[0] in FITTED else GRIDS[:1]) for each in RUNS), *SLOW],
)
def test_errors_and_order_are_those_of_the_theory(name, scheme, grids):
    this = case(name)
    errors = []
    for steps in grids:
        sol = run(this, steps, scheme)
        assert sol.success
        assert worst_certificate(sol) <= 1e-6
        errors.append(this.error(sol))
        if expected := this.errors[scheme].get(str(steps)):
            margin = 0.03 if scheme in SECOND_ORDER else 0.02
            assert errors[-1] == pytest.approx(expected, rel=margin)
    if name not in REFINED or len(grids) == 1:
        return
    order = slope(grids, errors)
    if this.process.rate_independent:
        assert scheme != "implicit-euler" or order >= 0.95
    elif scheme in SECOND_ORDER:
        assert order >= 1.7
    else:
        assert order == pytest.approx(1.0, abs=0.1)


@pytest.mark.parametrize(
    "name, tol",
    [(name, 1e-10) for name in ("S01", "S03", "V05", "M16", "M17")]
    + [slow(name, tol) for name in SETS for tol in (1e-6, 1e-10)],
)
def test_clarabel_osqp_and_plain_cvxpy_agree_at_the_tolerance_they_carry(name, tol):
    this = case(name)
    solvers = ["clarabel", "auto"] + ["osqp"] * this.polyhedral + ["cvxpy"] * (name == "P09")
    runs = [run(this, 101, "auto", solver, tol) for solver in solvers]
    # each step's velocity is within its certificate; errors in u grow at most by 1 + sqrt(Lam T)
    growth = 1.0 if this.process.rate_independent else 1 + np.sqrt(this.process.Lam * this.t_end)
    mu = this.t_end / 101
    for sol in runs[1:]:
        carried = (runs[0].stats["certificate"] + sol.stats["certificate"]).sum() * mu
        apart = max(map(this.process.metric.norm, sol.u - runs[0].u))
        # where A = 0 the certificate bounds |z|_{mu B} and the velocity is paid by 1 / sqrt(mu)
        if this.process.rate_independent:
            carried /= np.sqrt(mu)
        assert apart <= 2 * growth * carried + 1e-13


@pytest.mark.parametrize("name", ["S03", "V05", "P10", "M16"])
def test_a_process_made_from_its_variational_inequality_gives_the_same_numbers(name):
    """Adly and Haddad, the Proposition of section 4: the two problems are one."""
    this = case(name)
    again = this.process.as_vi().as_sweeping()
    one = run(this, 101, "auto")
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", so.InitialStateWarning)
        two = so.solve(again, t_end=this.t_end, steps=101)
    assert np.array_equal(one.u, two.u)


@pytest.mark.parametrize("name", [slow("S04"), "V05", slow("P09")])
def test_the_viability_condition_is_met_to_first_order(name):
    this = case(name)
    times = np.linspace(0.01, 0.99, 200) * this.t_end
    distances = []
    for steps in GRIDS:
        sol = run(this, steps, "implicit-euler")
        assert sol.viability().max() <= 1e-6 * np.abs(sol.velocity).max()
        distances.append(sol.viability(times).max())
    order = slope(GRIDS, distances)
    assert order >= 0.8
    assert distances[-1] <= 0.1


@pytest.mark.parametrize("name", [slow("P09"), "V05"])
def test_dissipated_plus_stored_energy_is_the_work_done_to_first_order(name):
    this = case(name)
    imbalance = []
    for steps in SOME:
        energy = run(this, steps, "implicit-euler").energy()
        assert (np.diff(energy.friction) >= -1e-12).all()
        imbalance.append(np.abs(energy.balance).max() / energy.work.max())
    assert slope(SOME, imbalance) >= 0.9
    assert imbalance[-1] <= 0.05


def test_a_spiral_varies_at_most_as_it_says():
    """The history of B14, a user's own."""
    history = Spiral(0.8, 2.0, 0.0)
    for a, b in ((0.0, 6.0), (1.0, 1.5), (5.9, 6.0)):
        sampled = np.abs(np.diff(history(np.linspace(a, b, 20_001)))).sum()
        assert sampled <= history.variation(a, b) <= 2.2 * sampled
