"""The modelled person, and wider starts."""

import numpy as np
import pytest
from played import played, succeeds

from pneutac_sim.errors import InputError
from pneutac_sim.world.expert import Person, ScriptedExpert, demonstrator
from pneutac_sim.world.tasks.base import HOME_JITTER_M, WIDER_M
from pneutac_sim.world.world import World


@pytest.fixture(scope="module")
def world():
    return World("switch", fidelity="probe", touch="area")


def actions(world, demonstrator, steps=40, seed=1):
    return played(world, seed, demonstrator, steps)[1]


def test_without_strength_it_is_the_expert(world):
    expert = actions(world, ScriptedExpert)
    assert np.array_equal(actions(world, lambda w, rng: demonstrator(w, rng, 0.0)), expert)
    assert not np.array_equal(actions(world, lambda w, rng: demonstrator(w, rng, 0.1)), expert)


def test_same_seed_same_person_and_no_two_episodes_alike(world):
    first = actions(world, Person)
    assert np.array_equal(actions(world, Person), first)
    assert np.abs(actions(world, Person, seed=2) - first).max() > 0.01


def test_a_person_sees_late_and_with_an_error_aside(world):
    world.reset(1)
    person = Person(world, np.random.default_rng(0))
    seen = person._seen
    felt = [(0.0, 0.0, None), (2.0, 0.5, np.array([0.001, 0.002]))]
    delay = seen._felt.maxlen - 1
    assert 2 <= delay <= 5  # 0.15 to 0.35 s of 15 Hz
    seen._felt.extend([felt[0]] * delay + [felt[1]])
    for k in range(delay):
        assert (seen.press_mm, seen.imprint_m) == (0.0, None), k
        seen._felt.append(felt[1])
    assert seen.press_mm == 2.0 and seen.imprint_m[1] == 0.002
    seen.blind = True
    assert (seen.press_mm, seen.press_n, seen.imprint_m) == (0.0, 0.0, None)
    seen.aside_m, seen.up_m = 0.004, 0.001
    assert np.allclose(np.abs(seen.gel_m - world.gel_m * (1, seen.mirror, 1)), (0, 0.004, 0.001))
    assert seen.success == world.success


@pytest.mark.parametrize("strength", [-0.1, 1.1, float("nan")])
def test_strength_out_of_range_ends_in_a_sentence(world, strength):
    with pytest.raises(InputError, match="must be from 0"):
        Person(world, np.random.default_rng(0), strength)


def starts(world, n=60):
    places = []
    for seed in range(n):
        world.reset(seed)
        places.append([*(world.target_m - world.home_m), world.model.body("card").pos[0]])
    return np.array(places)


def test_wider_starts_scatter_hand_and_objects_about_the_same_middle():
    world = World("card", fidelity="probe", touch="none")
    own = starts(world)
    world.widen_starts(1.0)
    wide = starts(world)
    half = HOME_JITTER_M + WIDER_M
    assert (np.abs(own[:, :3]) <= HOME_JITTER_M).all() and (np.abs(wide[:, :3]) <= half).all()
    assert (np.abs(wide[:, :3]).max(0) > 0.8 * half).all()
    assert wide[:, 3].std() == pytest.approx(own[:, 3].std() * 52 / 40, rel=0.01)
    world.widen_starts(0.0)
    assert np.allclose(starts(world, 5), own[:5])
    for wrong in (-1, 2.5, float("nan")):
        with pytest.raises(InputError, match="start_width"):
            world.widen_starts(wrong)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("task", "strength", "width"),
    [
        ("switch", 1.0, 0.25),
        *(pytest.param(*c, marks=pytest.mark.nightly) for c in (("egg", 1.0, 1.0), ("card", 0.5, 0.5))),
    ],
)
def test_a_person_manages_now_and_then(task, strength, width):
    world = World(task, fidelity="probe", touch="none")
    world.widen_starts(width)
    done = [succeeds(world, seed, lambda w, rng: Person(w, rng, strength)) for seed in range(12)]
    assert 3 <= sum(done) <= 11
