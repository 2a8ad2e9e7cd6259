"""The runtime: fork and spawn, the other compiler, another device; batches."""

import json
import shutil
import subprocess
import sys
import textwrap

import numpy as np
import pytest

from pneutac_sim.errors import InputError
from pneutac_sim.mpm import runtime
from pneutac_sim.mpm.body import Body, Material, Spine
from pneutac_sim.mpm.solve import simulate, solve_equilibrium
from pneutac_sim.mpm.total_lagrangian import Loads, TotalLagrangian

pytestmark = pytest.mark.slow

# A short bend and a short press; prints positions, angles and force.
CASE = """
import json, sys
{before}
import numpy as np
from pneutac_sim.mpm import runtime
from pneutac_sim.mpm.body import Body, Material
from pneutac_sim.mpm.solve import simulate
from pneutac_sim.mpm.body import Spine
from pneutac_sim.mpm.total_lagrangian import Loads
from pneutac_sim.mpm.total_lagrangian import TotalLagrangian

rubber = Material(2e5, 0.4)
arm = Body.box("arm", (12, 4, 4), 4e-3, rubber, clamp="x-")
spine = Spine((0.01, 0.025), 0.048, 8e-3, 8e-3, radius_m=6e-3, stiffness_nm_per_rad=0.5)
arm = TotalLagrangian(arm, spine, device="{device}")
bend = simulate(arm, Loads(q_cmd=np.array([[0.3, 0.2]])), 0.02, 0.02)
pad = TotalLagrangian(Body.box("pad", (8, 8, 4), 1e-3, rubber, clamp="z-"), device="{device}")
ball = Loads(indenter="sphere", size_m=np.array([5e-3, 1, 1]), position_m=np.array([4e-3, 4e-3, 3.8e-3]))
press = simulate(pad, ball, 2e-3, 2e-3)
out = dict(compiler=runtime.ti.__name__, q=bend.q[-1].tolist(), arm=bend.positions[-1].tolist(),
           pad=press.positions[-1].tolist(), force=press.contact_force[-1].tolist())
print("RESULT" + json.dumps(out))
"""


def run(tmp_path, before="", device="cpu", name="case.py"):
    """The case in a process of its own; from a file, since kernels need their source."""
    path = tmp_path / name
    path.write_text(CASE.format(before=before, device=device))
    done = subprocess.run([sys.executable, path], capture_output=True, text=True, timeout=300)
    assert done.returncode == 0, done.stderr[-2000:]
    line = next(line for line in done.stdout.splitlines() if line.startswith("RESULT"))
    return json.loads(line[6:])


def same(a, b, tolerance):
    for key in ("q", "arm", "pad", "force"):
        x, y = np.array(a[key]), np.array(b[key])
        assert np.isfinite(x).all()
        assert np.abs(x - y).max() < tolerance * np.abs(y).max(), key
    assert np.abs(np.array(a["force"])).max() > 1e-3  # it touched


def test_quadrants_gives_what_taichi_gives(tmp_path):
    pytest.importorskip("quadrants", reason="quadrants, Taichi's fork, is not installed")
    pytest.importorskip("taichi", reason="taichi is not installed: nothing to compare quadrants with")
    taichi = run(tmp_path)
    fork = run(tmp_path, before="sys.modules['taichi'] = None", name="fork.py")
    assert (taichi["compiler"], fork["compiler"]) == ("taichi", "quadrants")
    same(fork, taichi, 2e-4)


def test_cuda_gives_what_the_cpu_gives(tmp_path):
    if shutil.which("nvidia-smi") is None:
        pytest.skip("there is no CUDA GPU here (no nvidia-smi)")
    same(run(tmp_path, device="cuda", name="cuda.py"), run(tmp_path), 2e-3)


def test_an_unknown_device_is_refused():
    with pytest.raises(InputError, match="device is 'tpu'; it must be one of auto, cpu, cuda"):
        runtime.start("tpu")


def test_cuda_where_there_is_none_or_after_the_cpu_is_refused():
    runtime.start("cpu")
    with pytest.raises(InputError, match="runs on cpu already; cuda needs a new process"):
        runtime.start("cuda")


def test_a_forked_process_is_told_and_a_spawned_one_works(tmp_path):
    script = tmp_path / "processes.py"
    script.write_text(
        textwrap.dedent("""
        import multiprocessing, os
        from pneutac_sim.errors import InputError
        from pneutac_sim.mpm import runtime

        def work(out):
            try:
                out.put(runtime.start("cpu"))
            except InputError as e:
                out.put(str(e))

        if __name__ == "__main__":
            runtime.start("cpu")
            for method in ("fork", "spawn"):
                context = multiprocessing.get_context(method)
                out = context.Queue()
                p = context.Process(target=work, args=(out,))
                p.start()
                print("SAYS", method, out.get(timeout=300))
                p.join(20)
                if p.is_alive():
                    p.kill()
                    print("SAYS", method, "hangs")
            os._exit(0)
        """)
    )
    done = subprocess.run([sys.executable, script], capture_output=True, text=True, timeout=300)
    says = [line for line in done.stdout.splitlines() if line.startswith("SAYS")]
    assert len(says) == 2, done.stdout + done.stderr
    assert "forked after the MPM runtime had been started" in says[0] and "spawn" in says[0]
    assert says[1] == "SAYS spawn cpu"


def devices(batch):
    """Bodies that differ in stiffness, weight, target; their materials and loads."""
    rng = np.random.default_rng(3)
    materials = [Material(1e5 * (1 + k / batch), 0.3 + 0.1 * k / batch, 1000.0 + k) for k in range(batch)]
    return materials, rng.uniform(-0.3, 0.3, (batch, 2)), rng.uniform(-10, 10, (batch, 3))


def test_a_batch_of_64_is_64_batches_of_one():
    body = Body.box("arm", (12, 4, 4), 4e-3, Material(1e5, 0.3), clamp="x-")
    spine = Spine((0.01, 0.025), 0.048, 8e-3, 8e-3, radius_m=6e-3, stiffness_nm_per_rad=0.5)
    materials, q, gravity = devices(64)
    all_ = TotalLagrangian(body, spine, 64, materials, device="cpu")
    together = simulate(all_, Loads(q_cmd=q, gravity=gravity), 0.01, 0.005, dt=5e-5)
    assert np.ptp(together.q[-1], axis=0).min() > 0.1  # the bodies do differ
    for k in (0, 17, 63):
        one = TotalLagrangian(body, spine, 1, materials[k : k + 1], device="cpu")
        alone = simulate(one, Loads(q_cmd=q[k : k + 1], gravity=gravity[k]), 0.01, 0.005, dt=5e-5)
        assert (alone.positions[:, 0] == together.positions[:, k]).all()
        assert (alone.q[:, 0] == together.q[:, k]).all()


def test_a_batch_of_presses_is_the_presses_one_by_one():
    """Different indenters in one launch, to equilibrium; with friction it would depend on the way there."""
    body = Body.box("pad", (10, 10, 6), 1e-3, Material(1e5, 0.4), clamp="z-")
    names = ["sphere", "cylinder", "cube", "edge"]
    size = np.array([[4e-3, 1, 1], [2e-3, 5e-3, 1], [2e-3, 2e-3, 2e-3], [1, 4e-3, 4e-3]])
    at = np.array([[5e-3, 5e-3, 5.5e-3 - 0.1e-3 * k] for k in range(4)])
    both = solve_equilibrium(
        TotalLagrangian(body, batch=4, device="cpu"),
        Loads(indenter=names, size_m=size, position_m=at, friction=0.0),
        1e-3,
    )
    for k, name in enumerate(names):
        one = solve_equilibrium(
            TotalLagrangian(body, device="cpu"),
            Loads(indenter=name, size_m=size[k], position_m=at[k], friction=0.0),
            1e-3,
        )
        assert one.contact_force[0, 2] == pytest.approx(both.contact_force[k, 2], rel=0.01)
        assert np.abs(one.positions[0] - both.positions[k]).max() < 0.01e-3


def test_materials_must_be_as_many_as_bodies():
    body = Body.box("pad", (4, 4, 4), 1e-3, Material(1e5, 0.4))
    with pytest.raises(InputError, match="2 materials for a batch of 3"):
        TotalLagrangian(body, batch=3, materials=[body.material] * 2, device="cpu")


def test_nothing_happens_at_import(tmp_path):
    """Importing the solver starts no runtime and prints nothing."""
    code = "import pneutac_sim.mpm.solve, pneutac_sim.mpm.runtime as r; assert r._started is None"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=300)
    assert done.returncode == 0, done.stderr
    assert done.stdout == ""
