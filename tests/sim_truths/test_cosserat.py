"""The moving rod against the analytic cantilever, the static rod and the balance of energy."""

import sys

import numpy as np
import pytest

pytest.importorskip("elastica")

from pneutac_truths import cosserat, generate
from pneutac_truths.programs import DT_S
from pneutac_truths.truth import act
from pneutac_truths.world import World

LENGTH = 0.12


def let_go(period_s: float, damping: float, seconds: float, elements: int = 20, bend: float = 0.1):
    """Tip (n,) in m and energy (n,) in J of a slender rod that was bent by air and then vented at once."""
    body = cosserat.Moving(LENGTH, 0.05 * LENGTH, period_s, 1.5, elements=elements)
    body.rod.rest_kappa[1] = bend / LENGTH
    for _ in range(round(2 * period_s / DT_S)):
        body.advance()
    free = cosserat.Moving(LENGTH, 0.05 * LENGTH, period_s, damping, elements=elements)
    free.rod.position_collection[:] = body.rod.position_collection
    free.rod.director_collection[:] = body.rod.director_collection
    tip, energy = [], []
    for _ in range(round(seconds / DT_S)):
        free.advance()
        r = free.rod
        tip.append(r.position_collection[2, -1])
        energy.append(
            r.compute_translational_energy()
            + r.compute_rotational_energy()
            + r.compute_bending_energy()
            + r.compute_shear_energy()
        )
    return np.array(tip), np.array(energy)


@pytest.mark.nightly
@pytest.mark.slow
def test_without_damping_it_swings_at_the_cantilevers_frequency_and_keeps_its_energy():
    """Lowest mode 1.8751^2 / (2 pi) sqrt(EI / m L^3); `stiffness_of` is built to give the period."""
    period, found = 0.25, {}
    for elements in (15, 30):
        tip, energy = let_go(period, 0.0, 6 * period, elements)
        down = np.flatnonzero((tip[:-1] > 0) & (tip[1:] <= 0))
        found[elements] = DT_S * np.diff(down + tip[down] / (tip[down] - tip[down + 1])).mean()
        first, last = np.split(energy[: len(energy) // 2 * 2], 2)
        assert last.mean() == pytest.approx(first.mean(), rel=5e-3)  # no drift
        assert np.ptp(energy) < 0.05 * energy.mean()  # a symplectic step lets it waver
    mass = cosserat.DENSITY * np.pi * (0.05 * LENGTH) ** 2 * LENGTH
    stiffness = cosserat.stiffness_of(period, LENGTH, mass, 0.0)
    exact = 2 * np.pi / (1.87510**2 * np.sqrt(stiffness / (mass * LENGTH**3)))
    assert found[30] == pytest.approx(exact, rel=0.04)
    # the clamp holds half an element, so the error falls with their number
    assert 2 * found[30] - found[15] == pytest.approx(exact, rel=0.005)


@pytest.mark.nightly
@pytest.mark.slow
def test_damping_is_the_lowest_modes_ratio():
    period, ratio = 0.25, 0.1
    tip, energy = let_go(period, ratio, 4 * period)
    rate = np.polyfit(np.arange(len(energy)) * DT_S, np.log(energy), 1)[0]
    assert rate == pytest.approx(-2 * ratio * 2 * np.pi / period, rel=0.1)


@pytest.mark.nightly
def test_at_rest_it_is_where_the_static_rod_is():
    w = World.start("cosserat", 2, 1, 1.5)
    act(w, {})
    w.drive[:], w.aside[:], w.stretch[:] = 0.8, 0.2, 0.05
    told = w.rod_inputs(np.array([0]))
    body = cosserat.Moving(1e-3 * w.body.rod.length_mm, 0.18e-3 * w.body.rod.length_mm, 0.2, 1.0)
    cosserat._set_inputs(body, told[0], *cosserat._fields(w.body.rod))
    for _ in range(300):
        body.advance()
    still = w.body.rod.solve(told)[0][0]
    np.testing.assert_allclose(body.marker_mm(w.body.rod.tip_mm), still, atol=2e-3 * w.body.length_mm)


@pytest.mark.nightly
def test_a_wall_holds_the_moving_tip_back():
    free, held = (generate("cosserat", [name], 1, minutes=1.5) for name in ("plain", "obstacle"))
    z = held.observed.index("tip_z_mm")
    gone = free.pose[:, z].max() - held.pose[:, z].max()
    assert gone > 3 * held.noise_floor
    low = free.pose[:, z] < 0.3 * free.pose[:, z].max()
    assert np.median(np.linalg.norm(free.pose - held.pose, axis=1)[low]) < held.noise_floor


def test_without_pyelastica_a_moving_rod_says_what_to_install(monkeypatch):
    monkeypatch.setitem(sys.modules, "elastica", None)
    with pytest.raises(ImportError, match="pip install"):
        cosserat.elastica()
