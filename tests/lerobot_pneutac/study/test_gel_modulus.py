"""A gel's modulus from presses with a scale under it."""

from dataclasses import replace

import numpy as np
import pytest

from lerobot_pneutac import InputError, Twin
from lerobot_pneutac.study.gel import keep_modulus, modulus_sentence
from pneutac_datasets.generate.standin import write_gel
from pneutac_datasets.recording.gel import GelRecording
from pneutac_datasets.recording.recording import Recording
from pneutac_sim.gel.force import MODULUS, GelForce
from pneutac_sim.gel.indenter import Press
from pneutac_sim.twin import Value


@pytest.fixture(scope="module")
def recording(tmp_path_factory):
    return write_gel(tmp_path_factory.mktemp("bench"))


@pytest.fixture(scope="module")
def bench(recording):
    return GelRecording.load(recording)


def forced(bench, forces, roles=None):
    pairs = zip(bench.samples, forces, strict=True)
    samples = [replace(s, force_n=f, role=s.role if roles is None else roles) for s, f in pairs]
    return replace(bench, samples=samples)


def test_forces_on_the_stand_in_tell_a_modulus_that_foretells_its_other_presses(bench):
    """Its gel is a domed half-space: no layer, so that an error stays."""
    twin = Twin.builtin()
    found = keep_modulus(twin, bench)
    assert 0.03 < found.value_mpa < 0.06 and twin.parameters[MODULUS].value == found.value_mpa
    assumed = [s.force_n / GelForce.of(Twin.builtin()).force(s.press.depths()) for s in bench.samples[1:]]
    assert 0.05 < found.heldout < 0.3 < 0.7 < np.sqrt(np.mean(np.log(assumed) ** 2))
    assert "one press gives the gel a modulus of 0.04" in modulus_sentence(found, twin)


def test_a_gel_that_is_the_law_is_found_with_an_interval(bench):
    """A mirror: it tests the arithmetic alone."""
    stiff = Twin.builtin()
    stiff.parameters[MODULUS] = Value(0.21)
    law, noise = GelForce.of(stiff), np.exp(np.random.default_rng(0).normal(0, 0.05, len(bench.samples)))
    forces = [n * law.force(s.press.depths()) for s, n in zip(bench.samples, noise, strict=True)]
    twin = Twin.builtin()
    found = keep_modulus(twin, forced(bench, forces, "calibration"))
    low, high = twin.parameters[MODULUS].ci95
    assert low < 0.21 < high and high / low < 1.1
    assert found.presses == len(forces) and found.heldout is None and 0.02 < found.off < 0.08


def test_without_a_force_nothing_is_claimed_and_an_impossible_one_is_refused(bench):
    twin = Twin.builtin()
    assert keep_modulus(twin, forced(bench, [None] * len(bench.samples))) is None
    assert MODULUS not in twin.parameters and "is assumed to have" in modulus_sentence(None, twin)
    grams = [1e3 * s.force_n / 9.81 for s in bench.samples]
    with pytest.raises(InputError, match="give force_n in newton"):
        keep_modulus(twin, forced(bench, grams))


def test_a_force_that_no_scale_shows_is_refused_with_its_row(recording):
    samples = recording.samples.copy()
    samples.loc[2, "force_n"] = -0.1
    with pytest.raises(InputError, match=r"row 3: force_n is -0.1; give newton, above 0"):
        GelRecording.load(Recording(recording.folder, recording.meta, samples, "gel"))


@pytest.mark.nightly
def test_the_law_finds_the_modulus_of_rubber_by_finite_elements(bench):
    """Hexahedra without friction, which share nothing with the law nor with the points it was fitted to."""
    from pneutac_truths.gel.solid import Punch, Rubber, press

    rubber = Rubber(2.5, 34.0, 0.46)
    presses = [
        Press("sphere", 3.0, 0, 0, 0.5),
        Press("sphere", 4.0, 0, 0, 0.6),
        Press("edge", 4.0, 0, 0, 0.5),
    ]
    forces = [press(Punch(p.indenter, p.size_mm), p.depth_mm, rubber).force_n for p in presses]
    samples = [
        replace(s, press=p, force_n=f, role="calibration")
        for s, p, f in zip(bench.samples, presses, forces, strict=False)
    ]
    found = keep_modulus(Twin.builtin(), replace(bench, samples=samples))
    assert found.value_mpa == pytest.approx(2 * 0.034 * 1.46, rel=0.10)
