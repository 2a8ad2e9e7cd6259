import pytest
from generated import once

from pneutac_datasets.generate.finger import generate


@pytest.fixture(scope="module")
def bench(tmp_path_factory):
    """Makes a short hidden recording of an effect."""
    folder = tmp_path_factory.mktemp("hidden")

    def make(effect, seed=5001, minutes=3.0):
        path = folder / f"{effect}_{seed}"
        return once(generate, [effect], path, seed, minutes=minutes, hz=10)

    return make
