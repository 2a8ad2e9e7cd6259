"""Keeps every test off the user's folders (Hugging Face's, priors of sensors) and off the network."""

import gc
import importlib.metadata
import json
import os
import re
import shutil
import tempfile
from functools import cache
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from compiled_once import compile_once

MATERIAL_POINTS = re.compile(
    r"pneutac_sim\.mpm(\.\w+)? import .*(devices|solve|measure)|pneutac_sim\.(photo_fit|surrogate\.collect)"
    r"|pneutac_sim\.surrogate import collect|\(photographed\b"
)
# A hundred thousand functions and classes are imported, none of which goes: no garbage to search for.
gc.disable()
# Before LeRobot is imported: it reads these once.
os.environ["HF_HOME"] = tempfile.mkdtemp(prefix="pneutac_hf_")
os.environ["HF_HUB_OFFLINE"] = "1"
os.environ["PNEUTAC_PRIORS"] = os.path.join(os.environ["HF_HOME"], "priors")
# Processes that are started to run tests inherit it.
FIRST = "PNEUTAC_TEST_RECORDINGS" not in os.environ
os.environ.setdefault("PNEUTAC_TEST_RECORDINGS", tempfile.mkdtemp(prefix="pneutac_recordings_"))
compile_once(Path(os.environ["PNEUTAC_TEST_RECORDINGS"]))
# Diffusers, Transformers and others read the metadata of all installed packages, each for a second.
importlib.metadata.packages_distributions = cache(importlib.metadata.packages_distributions)
if "PYTEST_XDIST_WORKER" in os.environ:  # it imports all tests
    # Before LeRobot: for each of its kernels Taichi looks through every module that is loaded.
    importlib.import_module("pneutac_sim.mpm.devices")


def pytest_collection_finish():
    """What was imported is from now on no garbage, and is not looked through."""
    gc.freeze()
    gc.enable()


def pytest_sessionfinish():
    """The temporary folders of this run go; LeRobot's own once its process ends."""
    if FIRST:
        shutil.rmtree(os.environ["PNEUTAC_TEST_RECORDINGS"], ignore_errors=True)
    shutil.rmtree(os.environ["HF_HOME"], ignore_errors=True)


def pytest_collection_modifyitems(items):
    """The longest work begins first, so that at the end no process waits for another.

    That is what one process does alone, running material points; then the other files with slow tests.
    """
    slow = {item.path for item in items if item.get_closest_marker("slow")}
    items.sort(key=lambda item: (not runs_material_points(item.path), item.path not in slow))


@cache
def runs_material_points(path):
    return MATERIAL_POINTS.search(path.read_text()) is not None


def pytest_xdist_make_scheduler(config, log):
    """A file stays in one process; those that run material points share one, which compiles them once."""
    from xdist.scheduler import LoadFileScheduling

    class Files(LoadFileScheduling):
        def _split_scope(self, nodeid):
            file = super()._split_scope(nodeid)
            return "material points" if runs_material_points(config.rootpath / file) else file

    return Files(config, log)


@pytest.fixture(scope="session")
def photographed(tmp_path_factory):
    """Recording, body, states at 0 and 12 kPa, cameras and photographs by view."""
    from generated import once

    from pneutac_datasets.generate.photographs import write_photographs
    from pneutac_datasets.recording.photographs import read_camera, read_photograph
    from pneutac_sim.mpm import devices
    from pneutac_sim.mpm.solve import solve_equilibrium
    from pneutac_sim.mpm.total_lagrangian import Loads
    from pneutac_sim.twin import Twin, Value

    folder = tmp_path_factory.mktemp("photographs") / "finger"
    recording = once(write_photographs, folder, seed=2, pressures_kpa=[0, 12], particles=3000)
    truth = json.loads((folder.parent / "truth" / "finger.json").read_text())
    twin = Twin("finger", 110.0, parameters={k: Value(v) for k, v in truth["parameters"].items()})
    solver = devices.finger(twin, batch=2, device="cpu")
    state = solve_equilibrium(solver, Loads(q_cmd=devices.joint_targets(twin, [0.0, 12.0])))
    views = ("front", "back")
    return SimpleNamespace(
        recording=recording,
        twin=twin,
        body=solver.body,
        positions=state.positions,
        gradients=state.gradients,
        cameras={v: read_camera(recording, v) for v in views},
        pictures={v: [read_photograph(recording, i, v) for i in range(2)] for v in views},
        background={v: recording.image(recording.meta["cameras"][v]["background"]) for v in views},
        rmse=rmse,
    )


def rmse(rendering, image, mask):
    """Of 8-bit levels inside the union of both silhouettes, on black."""
    union = mask | (rendering.alpha > 0.5)
    wanted = np.where(mask[..., None], image, 0).astype(float)
    return float(np.sqrt(np.mean((255 * rendering.image - wanted)[union] ** 2)))
