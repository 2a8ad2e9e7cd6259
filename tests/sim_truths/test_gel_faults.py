import numpy as np
import pytest

from pneutac_truths.__main__ import main
from pneutac_truths.gel.faults import GEL_EFFECTS
from pneutac_truths.gel.scene import Sensor
from pneutac_truths.gel.session import _session, named, write_gel


def acted(name):
    session = _session(Sensor(), 6, np.random.default_rng(1))
    parameters = GEL_EFFECTS[name].draw(np.random.default_rng(2))
    GEL_EFFECTS[name].act(session, **parameters)
    return session, parameters


def test_parameters_are_drawn_within_their_ranges():
    for fault in GEL_EFFECTS.values():
        drawn = fault.draw(np.random.default_rng(0))
        assert all(low <= drawn[k] <= high for k, (low, high) in fault.ranges.items())


def test_a_dim_led_dims_from_some_press_on():
    session, parameters = acted("dim_led")
    led = session.power[:, int(parameters["which"])]
    assert led[0] == 1.0
    assert led[-1] == parameters["share"]
    assert (np.delete(session.power, int(parameters["which"]), 1) == 1).all()


def test_a_warm_red_led_dims_most():
    power = acted("heating_drift")[0].power
    assert (np.diff(power, axis=0) < 0).all()
    assert power[-1, 0] < power[-1, 1] == power[-1, 2]


def test_wear_and_dust_grow_from_a_clean_rest_image():
    worn, dusty = acted("worn_membrane")[0].looks, acted("dust")[0].looks
    assert (worn[0].coat == 1).all()
    assert worn[-1].coat.min() < worn[1].coat.min() < 1
    counts = [len(look.specks_mm) for look in dusty]
    assert counts[0] == 0 < counts[-1]
    assert counts == sorted(counts)


def test_bands_keep_the_mean_and_wander():
    rows = acted("rolling_exposure")[0].rows
    assert rows.mean() == pytest.approx(1.0, abs=0.05)
    assert np.abs(rows[1] - rows[2]).max() > 0.01


def test_bad_input_is_one_sentence(tmp_path, capsys):
    with pytest.raises(ValueError, match="no effect 'moth' of a gel; give one of worn_membrane"):
        named(["moth"])
    with pytest.raises(ValueError, match="1 presses are too few"):
        write_gel(["plain"], tmp_path / "a", presses=1)
    with pytest.raises(SystemExit):
        main(["--device=gel", "--effect=moth", f"--out={tmp_path / 'b'}"])
    assert "no effect 'moth' of a gel" in capsys.readouterr().err
