"""Workers end with their parent, and are begun with what they need."""

import logging
import os
import sys

import pytest

from pneutac_benchmarks.robustness.killed_parent import kill_parents
from pneutac_sim import worker


def test_a_worker_begins_with_its_arguments_and_computes_on_one_thread():
    with worker.process_pool(1, logging.addLevelName, 77, "begun") as pool:
        assert pool.submit(logging.getLevelName, 77).result() == "begun"
        assert pool.submit(os.getenv, "OMP_NUM_THREADS").result() == "1"
        assert pool.submit(os.getpid).result() != os.getpid()


@pytest.mark.skipif(sys.platform != "linux", reason="elsewhere a worker ends when its compiled code returns")
@pytest.mark.parametrize("number", [2, pytest.param(50, marks=pytest.mark.nightly)])
def test_workers_end_within_a_second_of_a_killed_parent(number):
    assert kill_parents(number).broken == ()
