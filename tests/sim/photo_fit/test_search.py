"""The search: it descends, goes on exactly after an interruption, stays inside bounds, refuses bad files."""

import json

import numpy as np
import pytest

from pneutac_sim.errors import InputError
from pneutac_sim.photo_fit.objective import body_parameters
from pneutac_sim.photo_fit.search import Coarse, SearchRecord, search
from pneutac_sim.twin import Twin

pytestmark = pytest.mark.slow


@pytest.fixture
def parameters():
    return body_parameters(Twin.builtin(), 15.0)


@pytest.fixture
def start(parameters):
    return Coarse(parameters.coordinates(parameters.twin), np.zeros((6, 6)))


def bowl(parameters, start, calls=None):
    """Least half a first step away from the start."""
    aim = start.x + 0.5 * parameters.step * np.array([1, -1, 1, -1, 1, 1])

    def objective(x):
        if calls is not None:
            calls.append(len(x))
        return np.square((x - aim) / parameters.step).sum(1)

    return objective


def test_descends_and_begins_at_the_warm_start(parameters, start):
    found = search(bowl(parameters, start), parameters, start, evaluations=168, seed=1)
    assert np.array_equal(found.tried[0], start.x)
    assert found.objective < 0.1 * found.objectives[0]
    assert np.allclose(found.tried[found.objectives.argmin()], found.x)


def test_resumed_equals_uninterrupted(parameters, start, tmp_path):
    file, calls = tmp_path / "evaluations.json", []
    whole = search(bowl(parameters, start), parameters, start, seed=3)

    def stop(done, best, value):
        if done == 35:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        search(
            bowl(parameters, start), parameters, start, seed=3, record=SearchRecord(file, "a"), progress=stop
        )
    rest = search(bowl(parameters, start, calls), parameters, start, seed=3, record=SearchRecord(file, "a"))
    assert rest.resumed == 35 and sum(calls) == 84 - 35
    assert np.array_equal(rest.tried, whole.tried) and np.array_equal(rest.objectives, whole.objectives)
    calls.clear()
    other = search(bowl(parameters, start, calls), parameters, start, seed=3, record=SearchRecord(file, "b"))
    assert other.resumed == 0 and sum(calls) == 84


def test_candidates_stay_inside_the_bounds(parameters, start):
    def seen(x):
        assert (x >= parameters.lower).all() and (x <= parameters.upper).all()
        return -x[:, 5]  # Poisson's ratio wants to grow for ever

    found = search(seen, parameters, start, seed=2)
    assert found.x[5] > 0.98 * parameters.upper[5]


def test_bad_input(parameters, start, tmp_path):
    file = tmp_path / "evaluations.json"
    file.write_text(json.dumps([1]))
    with pytest.raises(InputError, match="no record of a search"):
        search(bowl(parameters, start), parameters, start, record=SearchRecord(file))
    with pytest.raises(InputError, match="at least one generation"):
        search(bowl(parameters, start), parameters, start, evaluations=3)
    with pytest.raises(InputError, match="not a finite number"):
        search(lambda x: np.full(len(x), np.nan), parameters, start)
