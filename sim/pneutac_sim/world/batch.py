"""Many worlds of one task, stepped together on one device by MuJoCo Warp and PyTorch.

The model is that of `Gantry`: three slides carry the finger, with the task's objects before it. The gel's
spring and probe grid come from `gel.contact_batch`, its light from `gel.batch`, and both networks of the twin
run as PyTorch modules. `World` and `Gantry` remain the reference: a batch agrees with them step by step, in
single precision (`tests/sim/world/test_batch.py`).
"""

import contextlib
import math
from collections.abc import Callable, Sequence

import mujoco
import numpy as np

from pneutac_sim.errors import InputError, check_choice
from pneutac_sim.features import PRESSURES
from pneutac_sim.finger.online import ManyPipelines, PressurePipeline
from pneutac_sim.gel.force import GelForce
from pneutac_sim.gel.sensor import branches_of
from pneutac_sim.surrogate.network import NEAR_RAD, ActionNetwork
from pneutac_sim.twin import Twin
from pneutac_sim.world import scene
from pneutac_sim.world.base import Variation
from pneutac_sim.world.checks import Conditions
from pneutac_sim.world.gantry import Gantry
from pneutac_sim.world.soft_finger import AHEAD_M, MASS_KG
from pneutac_sim.world.station import Station
from pneutac_sim.world.tasks.base import BUMP_S
from pneutac_sim.world.tasks.switch import REST_S
from pneutac_sim.world.world import World

try:
    import mujoco_warp as mjw
    import torch
    import warp as wp

    from pneutac_sim.gel.batch import TactileBatch
    from pneutac_sim.gel.contact_batch import ContactBatch, PixelCount, Playback, first
    from pneutac_sim.surrogate.gel_train import UNet
except ModuleNotFoundError as e:
    raise InputError(
        f"Many worlds at once need MuJoCo Warp and PyTorch, and '{e.name}' is not installed:"
        " in a clone: uv pip install -e '.[warp]'"
    ) from e

FIELDS = ("body_pos", "body_quat", "geom_friction", "dof_frictionloss")  # that a start decides
HELD = (
    "jnt_stiffness",
    "jnt_stiffnesspoly",
    "dof_armature",
    "dof_damping",
    "tendon_stiffness",
    "tendon_damping",
)
CONTACTS, CONSTRAINTS = 40, 192  # of a world at most; with the expert 2 in the mean and 19 at most were seen
# In single precision MuJoCo's own 1e-6 loses one in twenty contacts that are less than 0.07 mm deep.
CCD_TOLERANCE_M = 3e-8
wp.set_module_options({"enable_backward": False})
DIVERGED = "the physics diverged"
TOUCHED = 1024  # gels that are drawn at once, which bounds the memory


@wp.kernel
def _drive(
    k: int,
    steps: int,
    h: float,
    A: wp.array2d(dtype=wp.vec2),
    inertia: wp.array(dtype=float),
    rate: wp.array2d(dtype=float),
    slope: wp.array2d(dtype=float),
    K: wp.array3d(dtype=float),
    D: wp.array3d(dtype=float),
    rest: wp.array2d(dtype=float),
    q: wp.array2d(dtype=float),
    v: wp.array2d(dtype=float),
    then: wp.array2d(dtype=float),
    turn: wp.array2d(dtype=wp.vec2),
    pull: wp.array2d(dtype=wp.vec2),
    begin: wp.array2d(dtype=float),
    end: wp.array2d(dtype=float),
    spine: int,
    ctrl: wp.array2d(dtype=float),
):
    """Controls of substep k: `spine._torques` for the spine, and the slides' from `begin` to `end`."""
    w = wp.tid()
    n, S, s = q.shape[1], float(steps), float(k + 1) / float(steps)
    heading, spin, faster = float(0.0), float(0.0), float(0.0)
    for i in range(n):
        bow = 3.0 * S / (S + 1.0) * (slope[w, i] - rate[w, i])
        then[w, i] = rate[w, i] + (slope[w, i] - rate[w, i]) * s + bow * s * (1.0 - s)
        heading += q[w, i]
        spin += v[w, i]
        faster += (then[w, i] - v[w, i]) / h
        c, d = wp.cos(heading), wp.sin(heading)
        turn[w, i] = wp.vec2(c, d)
        pull[w, i] = wp.vec2(c * faster - d * spin * spin, d * faster + c * spin * spin)
    torque = float(0.0)
    for m in range(n):
        i = n - 1 - m  # a joint turns its own link and all beyond it
        for j in range(n):
            a, to, by = A[i, j], turn[w, i], pull[w, j]
            torque += a[0] * (to[0] * by[0] + to[1] * by[1]) - a[1] * (to[0] * by[1] - to[1] * by[0])
        torque += inertia[i] * faster
        faster -= (then[w, i] - v[w, i]) / h
        ctrl[w, spine + i] = torque + rest[w, i]
    for i in range(n):
        for j in range(n):
            ctrl[w, spine + i] += K[w, i, j] * q[w, j] + D[w, i, j] * then[w, j]
    for i in range(n):
        q[w, i] += h * then[w, i]
        v[w, i] = then[w, i]
    for i in range(3):
        ctrl[w, i] = begin[w, i] + s * (end[w, i] - begin[w, i])


@wp.kernel
def _forces(
    count: wp.array(dtype=int),
    geoms: wp.array(dtype=wp.vec2i),
    worlds: wp.array(dtype=int),
    dims: wp.array(dtype=int),
    addresses: wp.array2d(dtype=int),
    forces: wp.array2d(dtype=float),
    groups: wp.array(dtype=int),
    out: wp.array2d(dtype=float),
):
    """Adds to `out` (worlds, groups) N the normal forces between finger, bit 0, and groups, bits 1 on."""
    c = wp.tid()
    if c >= count[0] or addresses[c, 0] < 0 or geoms[c][0] < 0 or geoms[c][1] < 0:
        return
    bits = groups[geoms[c][0]] | groups[geoms[c][1]]
    if (bits & 1) == 0:
        return
    rows, total = wp.max(2 * (dims[c] - 1), 1), float(0.0)  # of a pyramid
    for i in range(rows):
        total += forces[worlds[c], addresses[c, 0] + i]
    for b in range(out.shape[1]):
        if ((bits >> (b + 1)) & 1) == 1:
            wp.atomic_add(out, worlds[c], b, total)


class _Rules:
    """Success and failure of one task in all worlds, as its own class has them for one.

    Attributes:
        groups: beginnings of the names of geoms, a group each, whose contact force counts, by the attribute
            in which the task remembers it.
        state: tensors (N, ...) that a start restores.
    """

    groups: dict[str, tuple[str, ...]]

    def __init__(self, world: "BatchedWorld"):
        task, window = world.single.task, math.ceil(BUMP_S / world.dt_s - 1e-6) + 1
        self.task, self._model = task, world.single.model
        self.state = {"forces": world._zeros(len(self.groups) + 1, window), "rested_s": world._zeros()}

    def _qpos(self, name: str) -> int:
        return int(self._model.joint(name).qposadr[0])

    def update(self, world: "BatchedWorld") -> None:
        forces = self.state["forces"]
        forces.copy_(torch.cat([forces[..., 1:], world.forces[..., None]], 2))

    def pressed(self, group: int) -> torch.Tensor:
        """Force (N,) in N that was there all the time of a bump."""
        return self.state["forces"][:, group].amin(1)

    def success(self, world: "BatchedWorld") -> torch.Tensor:
        raise NotImplementedError

    def failure(self, world: "BatchedWorld") -> torch.Tensor:
        raise NotImplementedError


class _Switch(_Rules):
    groups = {"_force": ("switch", "bar")}

    def update(self, world):
        super().update(world)
        lever, dof = self._qpos("lever"), int(self._model.joint("lever").dofadr[0])
        resting = (world.qpos[:, lever] > 0.75 * self.task.well_rad) & (world.qvel[:, dof].abs() < 0.5)
        rested = self.state["rested_s"]
        rested.copy_(torch.where(resting, rested + world.dt_s, 0.0))

    def success(self, world):
        return self.state["rested_s"] >= REST_S - 1e-4

    def failure(self, world):
        return self.pressed(0) > self.task.limit_n


class _Egg(_Rules):
    groups = {"_force": ("carton",), "_wall": ("carton_base",)}

    def success(self, world):
        return world.qpos[:, self._qpos("lid")] > self.task.open_rad

    def failure(self, world):
        return (self.pressed(0) > self.task.limit_n) | (self.pressed(1) > self.task.wall_limit_n)


class _Card(_Rules):
    groups = {"_force": ("card_1",)}

    def __init__(self, world):
        super().__init__(world)
        joints = [self._model.joint(f"card_{i + 1}") for i in range(self.task.cards)]
        self._cards = world._sent([int(j.qposadr[0]) for j in joints], torch.long)
        self._dofs = world._sent([int(j.dofadr[0]) for j in joints], torch.long)
        self.state["mu"] = world._zeros(self.task.cards)
        self._edges = self.task.edge_n * torch.arange(1, self.task.cards + 1, device=world.torch_device)

    def update(self, world):
        super().update(world)
        world.fields["dof_frictionloss"][:, self._dofs] = self.state["mu"] * world.forces[:, :1] + self._edges

    def success(self, world):
        return world.qpos[:, self._cards].sum(1) > self.task.draw_m

    def failure(self, world):
        return world.qpos[:, self._cards[1:]].sum(1) > self.task.second_m


RULES: dict[str, Callable] = {"switch": _Switch, "egg": _Egg, "card": _Card}


class _SoftBody:
    """`ActionNetwork.resistance` of many fingers at rest.

    Args:
        network: of the twin's body.
        device: of PyTorch.
    """

    def __init__(self, network: ActionNetwork, device):
        self._n, self._drive = network.joints, network.drive.tolist()
        layers, scales = network._numbers
        arrays = (torch.tensor(a, dtype=torch.float32, device=device) for a in (*scales, *layers))
        self._numbers = list(arrays)
        self._near = NEAR_RAD * torch.eye(self._n, device=device)

    def _torque(self, q: torch.Tensor, p: torch.Tensor) -> torch.Tensor:
        slope, mean, scale, torque_mean, torque_scale, low, high, *layers = self._numbers
        x = torch.cat([q, torch.zeros_like(q), p.expand(*q.shape[:-1], 1)], -1)
        h = (torch.minimum(torch.maximum(x, low), high) - mean) / scale
        for w, b in zip(layers[:4:2], layers[1:4:2], strict=True):
            h = torch.nn.functional.softsign(h @ w + b)
        return torque_mean + (x - mean) / scale @ slope + torque_scale * (h @ layers[4] + layers[5])

    def resistance(self, q_free: torch.Tensor, q: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        """Torque (N, n) in N m beyond that at `q_free` (N, n) rad, and its derivative (N, n, n) by q."""
        p = (q_free.mean(1, keepdim=True) / self._drive[0] - self._drive[1])[:, None]
        asked = torch.cat([q[:, None], q_free[:, None], q[:, None] + self._near, q[:, None] - self._near], 1)
        here, free, ahead, behind = self._torque(asked, p).split([1, 1, self._n, self._n], 1)
        J = (ahead - behind) / (2 * NEAR_RAD)  # rows: the joint that is moved
        return (here - free)[:, 0], 0.5 * (J + J.transpose(1, 2))


class BatchedWorld:
    """N worlds of one task, each with its own objects, start, friction, bend gain and latency.

    A control step changes all of them. World i of `reset(seed)` starts where `Gantry.reset(seed + i)` does.
    Tensors are float32 on the device, and the same ones after each step: clone what is to be kept.

    Attributes:
        worlds: N.
        single: the `Gantry` with the same model and finger, for one world.
        device, torch_device: of Warp and of PyTorch.
        action_limits: lowest and highest action (3 + C,).
        dt_s: duration of a control step.
        state: (N, 8 + C): flange position (3) m and velocity (3) m/s, contact area, log(1 + pixels in
            contact), and the pressure of each chamber in kPa, behind the command where the twin has lags.
        area: (N,) contact area, share of the image.
        success, failure: (N,) bool; a world whose physics has diverged counts as failed.
        forces: (N, G + 1) N, contact forces between the finger and the task's groups of geoms, and all geoms.
        depth_mm: (N, 80, 59) probe grids.
        displacement_mm: (N, 80, 59) of the gel's face; zero where nothing touches it.
        fields: model fields (N, ...) that a start decides.
        qpos, qvel: (N, nq), (N, nv) of MuJoCo.
        poses: its `geom_xpos`, `geom_xmat` (N, ngeom, 3, 3) and `site_xpos`.
    """

    def __init__(
        self,
        task: str = "switch",
        worlds: int = 64,
        twin: Twin | None = None,
        device: str = "auto",
        fidelity: str = "surrogate",
        conditions: Conditions | None = None,
        pressure_range_kpa: tuple[float, float] | None = None,
        station: Station | None = None,
        forked: bool = False,
    ):
        """Worlds at rest; `reset` lays them out.

        Args:
            task: `switch`, `egg` or `card`.
            worlds: N.
            twin: of a finger of one chamber; default the built-in one.
            device: of PyTorch and Warp: `cpu`, `cuda`, or `auto` for CUDA where there is one.
            fidelity: `surrogate` or `probe`, see `World`.
            conditions: numbers, see `World`.
            pressure_range_kpa: see `World`.
            station: workspace, mount, rate and latency; the arm is replaced by slides.
            forked: whether `fork` and `resume` are called.

        Raises InputError: as `World`; no such device; the task, or an effect of the twin, has no batched
        form.
        """
        if task not in RULES:
            raise InputError(
                f"Many worlds at once know the tasks {', '.join(RULES)}, not '{task}'; use `World`."
            )
        check_choice("fidelity", fidelity, ("surrogate", "probe"))
        if worlds < 1:
            raise InputError(f"worlds is {worlds}; there must be at least one.")
        if device == "auto":
            device = "cuda" if torch.cuda.is_available() else "cpu"
        if torch.device(device).type == "cuda" and not torch.cuda.is_available():
            raise InputError("PyTorch finds no CUDA device; give device='cpu'.")
        ranges = [k for k, v in (conditions or {}).items() if isinstance(v, list | tuple)]
        if ranges:
            raise InputError(
                f"conditions gives a range for {', '.join(ranges)}; many worlds share one number."
            )
        limits = {"pressure_range_kpa": pressure_range_kpa, "station": station}
        one = World(task, twin, "area", fidelity, conditions, **limits)
        if one.chambers > 1:
            raise InputError(f"Many worlds at once have fingers of one chamber; the twin has {one.chambers}.")
        if not one._pipeline.mounted:
            raise InputError(
                "An effect of the twin moves the tip beyond the bend, as elongation does; that has no batched"
                " form: use `World`, or take it out."
            )
        if branches_of(one.sensor.model):
            raise InputError(
                "The twin's effect 'gel_creep' has no batched form; use `World`, or take it out."
            )
        self.single = g = Gantry(one)
        g.finger, g._controller = one.finger, one._controller
        self.worlds, self.dt_s, self.chambers = worlds, g.dt_s, g.chambers
        self._forked, self._holds = forked, False
        wp.init()
        self.torch_device = torch.empty(0, device=device).device  # with its number
        self.device = wp.device_from_torch(self.torch_device)
        self.action_limits = tuple(self._sent(limit) for limit in g.action_limits)
        self._workspace = tuple(self._sent(corner) for corner in g.workspace_m)
        self._stream = torch.cuda.Stream(self.torch_device) if self.device.is_cuda else None
        with self._on_device():
            self._put()
            self._bind(one)

    def _sent(self, array, dtype=None) -> torch.Tensor:
        return torch.as_tensor(np.asarray(array), dtype=dtype or torch.float32).to(self.torch_device)

    def _zeros(self, *shape: int) -> torch.Tensor:
        return torch.zeros((self.worlds, *shape), device=self.torch_device)

    @contextlib.contextmanager
    def _on_device(self):
        """Work of Warp and PyTorch on one stream, after the caller's stream and before what follows there."""
        if self._stream is None:
            with wp.ScopedDevice(self.device):
                yield
            return
        outer = torch.cuda.current_stream(self.torch_device)
        self._stream.wait_stream(outer)
        stream = wp.stream_from_torch(self._stream)
        with torch.cuda.stream(self._stream), wp.ScopedDevice(self.device), wp.ScopedStream(stream):
            yield
        outer.wait_stream(self._stream)

    def _put(self) -> None:
        """Model and data in MuJoCo Warp, and their tensors."""
        g, m = self.single, self.single.model
        flags, tolerance_m = m.opt.disableflags, m.opt.ccd_tolerance
        m.opt.disableflags = flags | mujoco.mjtDisableBit.mjDSBL_NATIVECCD  # boxes meet as in MuJoCo's C code
        m.opt.ccd_tolerance = CCD_TOLERANCE_M
        sizes = {name: self.worlds for name in (*FIELDS, *HELD) if m.ntendon or not name.startswith("tendon")}
        self._model = mjw.put_model(m, sizes)
        self._loose = wp.full_like(self._model.body_weldid, 1)
        self._model.has_tendon_stiffness = self._model.has_tendon_damping = m.ntendon > 0
        self._data = mjw.put_data(m, g.data, nworld=self.worlds, nconmax=CONTACTS, njmax=CONSTRAINTS)
        m.opt.disableflags, m.opt.ccd_tolerance = flags, tolerance_m
        self.fields = {name: wp.to_torch(getattr(self._model, name)) for name in sizes}
        self.qpos, self.qvel, self._warmstart, self._ctrl = (
            wp.to_torch(getattr(self._data, name)) for name in ("qpos", "qvel", "qacc_warmstart", "ctrl")
        )
        names = ("geom_xpos", "geom_xmat", "site_xpos")
        self.poses = {name: wp.to_torch(getattr(self._data, name)) for name in names}
        self._flange_m = self.poses["site_xpos"][:, g._flange]

    def _bind(self, one: World) -> None:
        """Finger, gel and task in the model."""
        g, N, n = self.single, self.worlds, self.single._bends.joints
        self._steps, self._h = g._substeps, g.model.opt.timestep
        f, touch, gel = g._follower, g.touch, g.sensor.model
        self._spine, self._pad = g._spine, g.model.joint("pad")
        s, self._play = g._springs, Playback(self.torch_device)
        at = s._joints, s._dofs[:, 0], s._tendons
        self._pairs = tuple(self._sent(p, torch.long) for p in s._pairs)
        self._joints, self._dofs, self._tendons = (self._sent(i, torch.long) for i in at)
        pairs = np.stack([f._A.real, f._A.imag], -1).astype(np.float32)
        self._chain = [wp.array(pairs, dtype=wp.vec2), wp.array(f._inertia.astype(np.float32), dtype=float)]
        self._rate, self._slope, self._rest = (self._zeros(n) for _ in range(3))
        self._K, self._D = self._zeros(n, n), self._zeros(n, n)
        self._path = [self._zeros(n) for _ in range(3)]
        self._turning = [wp.zeros((N, n), dtype=wp.vec2) for _ in range(2)]
        self._begin, self._end = self._zeros(3), self._zeros(3)
        self._controller = self._sent(g._controller)
        self._body = None if g.finger is None else _SoftBody(g.finger.network, self.torch_device)
        self._contact = ContactBatch(
            GelForce.of(g.twin), gel.window_mm, gel.thickness_mm, touch.felt, touch.kinds, touch.sizes,
            g._gel, self._data, self.device, g._pad._free,
        )  # fmt: skip
        self.tactile, self._count = TactileBatch(gel, self.torch_device), PixelCount(gel, self.device)
        self._pixels = gel.rest_image.shape[0] * gel.rest_image.shape[1]
        self._network = None
        if touch.network is not None:
            weights = {k: torch.tensor(w) for k, w in touch.network.weights.items()}
            channels = tuple(len(weights[f"down{level}.0.bias"]) for level in (1, 2, 3))
            self._network = UNet(channels).to(self.torch_device).requires_grad_(False)
            self._network.load_state_dict(weights)
            nothing = torch.zeros((1, 1, *touch.depth_mm.shape), device=self.torch_device)
            self._at_rest = self._network(nothing)[:, 0]
        self._spring = self._contact.spring
        rules, names = RULES[g.task.name], [g.model.geom(i).name for i in range(g.model.ngeom)]
        bits = (g.model.geom_contype == 1).astype(np.int32)
        for b, prefixes in enumerate((*rules.groups.values(), ("",))):
            bits |= [int(name.startswith(prefixes)) << (b + 1) for name in names]
        self._groups = wp.array(bits, dtype=int)
        self.forces = self._zeros(len(rules.groups) + 1)
        self.rules = rules(self)
        self._late = torch.zeros(N, dtype=torch.long, device=self.torch_device)
        self._target = self._zeros(3)
        self._drive, self._rest_rad, self._gain, self._more = map(self._zeros, (n, n, 1, 1))
        self._pipeline = PressurePipeline(g.twin, one.conditions)
        self._pipelines = ManyPipelines(self._pipeline, N, self._forked)
        self._queue = self._zeros(1, 3 + self.chambers)
        self.state, self.area = self._zeros(8 + self.chambers), self._zeros()
        self.pressure_kpa = self._zeros(self.chambers)
        self.depth_mm, self.displacement_mm = self._contact.depth_mm, self._zeros(*touch.depth_mm.shape)
        self.success, self.failure, self._touched = (
            torch.zeros(N, dtype=torch.bool, device=self.torch_device) for _ in "sft"
        )
        self._touching = self._zeros()
        self._graph = None
        self._resist()
        if self._stream is not None:
            self._physics()  # compiles, before the graph is recorded
            with wp.ScopedCapture() as capture:
                self._physics()
            self._graph = capture.graph

    # ---------------------------------------------------------------- starts

    def reset(
        self,
        seed: int | Sequence[int] = 0,
        starts: int | None = None,
        variations: Sequence[Variation] | None = None,
    ) -> torch.Tensor:
        """Draws starts, lets the fingers come to rest there, and puts world i to start i.

        Args:
            seed: start i is that of `Gantry.reset(seed + i)`; or the seed of each start.
            starts: how many are drawn for `restart`, a multiple of N; default N.
            variations: of each start, see `Variation`; None for the task's own.

        Returns:
            `state`.

        Raises InputError: another number of variations, or one with late touch or conditions, or starts that
        do not divide.
        """
        N, starts = self.worlds, starts or self.worlds
        if starts % N:
            raise InputError(f"starts is {starts}; it must be a multiple of the {N} worlds.")
        seeds = np.broadcast_to(seed, starts) + np.arange(starts) * (np.ndim(seed) == 0)
        variations = list(variations or [Variation()] * starts)
        if len(variations) != starts or any(v.late_touch or v.conditions for v in variations):
            raise InputError(f"{starts} starts need as many variations, without late_touch and conditions.")
        with self._on_device():
            self._queue = self._zeros(1 + max(map(self._late_of, variations)), 3 + self.chambers)
        parts = [self.stage(seeds[i : i + N], variations[i : i + N]) for i in range(0, starts, N)]
        self._starts = {k: torch.cat([part[k] for part in parts]) for k in parts[0]}
        everywhere = torch.arange(N, device=self.torch_device)
        self.restart(everywhere, everywhere)
        return self.state

    def stage(self, seeds: Sequence[int], variations: Sequence[Variation]) -> dict[str, torch.Tensor]:
        """Draws N starts, which `restart` takes; the worlds go on as they are.

        Args:
            seeds: of the starts.
            variations: of each, no later commands than in the last reset.
        """
        with self._on_device():
            running = {k: v.clone() for k, v in self._everything().items()}
            pipelines = self._pipelines
            self._lay_out(seeds, variations)
            staged = {k: v.clone() for k, v in self._everything().items()}
            self._pipelines = pipelines
            for name, tensor in self._everything().items():
                tensor.copy_(running[name])
            self._place()
        return staged

    def restart(
        self, worlds: torch.Tensor, starts: torch.Tensor, staged: dict[str, torch.Tensor] | None = None
    ) -> None:
        """Puts worlds (k,) to starts (k,), both int64 indices, of `stage`, or else of the last reset."""
        if not len(worlds):
            return
        with self._on_device():
            for name, tensor in self._everything().items():
                tensor[worlds] = (staged or self._starts)[name][starts]
            self._pipelines.restart(worlds.cpu().numpy())
            self._place()

    def fork(self, worlds: Sequence[int]) -> tuple[dict[str, torch.Tensor], list]:
        """All that decides how worlds (k,), which may repeat, go on from here, for `resume`."""
        with self._on_device():
            at = self._sent(worlds, torch.long)
            tensors = {name: tensor[at] for name, tensor in self._everything().items()}
        return tensors, self._pipelines.states(np.asarray(worlds))

    def resume(self, worlds: Sequence[int], forked: tuple[dict[str, torch.Tensor], list]) -> None:
        """Puts worlds (k,) where others were at a `fork`, of this batch or of one of the same model."""
        tensors, states = forked
        with self._on_device():
            at, length = self._sent(worlds, torch.long), tensors["_queue"].shape[1]
            if length != self._queue.shape[1]:
                self._queue = self._zeros(length, 3 + self.chambers)
            for name, tensor in self._everything().items():
                tensor[at] = tensors[name]
            self._pipelines.resume(np.asarray(worlds), states)
            self._place()

    def _late_of(self, variation: Variation) -> int:
        self.single.variation = variation
        return self.single._late_commands

    def _everything(self) -> dict[str, torch.Tensor]:
        """What differs between worlds, by name."""
        spring = {f"spring_{i}": s for i, s in enumerate(self._spring)}
        names = (
            "qpos qvel _warmstart _ctrl _target _begin _drive _rate _rest_rad _gain _more _late _queue forces"
            " state area pressure_kpa displacement_mm depth_mm success failure"
        )
        own = {name: getattr(self, name) for name in names.split()}
        return own | self.fields | self.rules.state | spring

    def _lay_out(self, seeds: np.ndarray, variations: Sequence[Variation]) -> None:
        g, rows, targets, tasks, late = self.single, [], [], [], []
        for seed, variation in zip(seeds, variations, strict=True):
            g.variation = variation
            g._rng = np.random.default_rng(seed)
            g._start()
            fields = (getattr(g.model, f).copy() for f in FIELDS)
            rows.append([g.data.qpos.copy(), g.data.ctrl.copy(), *fields])
            targets.append(g.target_m)
            tasks.append(getattr(g.task, "_mu", None))
            late.append(len(g._queue))
        qpos, ctrl, *fields = (self._sent(np.stack(column)) for column in zip(*rows, strict=True))
        for name, field in zip(FIELDS, fields, strict=True):
            self.fields[name].copy_(field)
        self._pipeline.set_conditions(g.conditions)
        self._pipeline.reset(0.0)
        self._rest_rad.copy_(self._sent(self._pipeline.rest()).expand_as(self._rest_rad))
        self._pipelines = ManyPipelines(self._pipeline, self.worlds, self._forked)
        self._gain.copy_(self._sent([v.bend_gain for v in variations])[:, None])
        self._more.copy_(self._sent([v.more_rad for v in variations])[:, None])
        self._drive.copy_(self._bent(self._rest_rad))
        qpos[:, self._qpos_of_spine] = self._drive
        self.qpos.copy_(qpos)
        self._ctrl.copy_(ctrl)
        self._target.copy_(self._sent(np.stack(targets)))
        for tensor in (self.qvel, self._warmstart, self._rate, *self.rules.state.values(), self.pressure_kpa):
            tensor.zero_()
        if "mu" in self.rules.state:
            self.rules.state["mu"].copy_(self._sent(np.stack(tasks)))
        self._late.copy_(self._sent(late, torch.long))
        self._queue.zero_()
        self._begin.copy_(self._target)
        self._place()
        for _ in range(g.station.steps(scene.SETTLE_S)):
            self._advance(self._target, self._rest_rad)
        self._judge()
        self._feel()

    def _place(self) -> None:
        """Kinematics of all geoms; MuJoCo Warp computes those of fixed bodies once alone."""
        m = self._model
        m.body_weldid, welded = self._loose, m.body_weldid
        mjw.kinematics(m, self._data)
        m.body_weldid = welded

    @property
    def _qpos_of_spine(self) -> slice:
        at = int(self.single.model.joint("spine_1").qposadr[0])
        return slice(at, at + self._drive.shape[1])

    # ---------------------------------------------------------------- steps

    def step(self, actions) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor, torch.Tensor]:
        """One control step of all worlds.

        Args:
            actions: (N, 3 + C) as `features.action_names`; clipped to `action_limits`.

        Returns:
            `state` (N, 8 + C), `area` (N,), `success` (N,) bool and the force on the gel (N,) in N.

        Raises InputError: actions of another shape, or not finite.
        """
        with self._on_device():
            actions = torch.as_tensor(actions, dtype=torch.float32, device=self.torch_device)
            if actions.shape != (shape := (self.worlds, 3 + self.chambers)):
                raise InputError(f"The actions have shape {tuple(actions.shape)}; it must be {shape}.")
            if not bool(torch.isfinite(actions).all()):
                raise InputError("The actions are not all finite; every entry must be a number.")
            low, high = self.action_limits
            actions = torch.minimum(torch.maximum(actions, low), high)
            self._queue.copy_(torch.cat([actions[:, None], self._queue[:, :-1]], 1))  # the newest first
            acting = self._queue[torch.arange(self.worlds, device=self.torch_device), self._late]
            target = self._target + acting[:, :3] * self.dt_s
            self._target.copy_(torch.minimum(torch.maximum(target, self._workspace[0]), self._workspace[1]))
            self._advance(self._target, self._commanded(acting[:, PRESSURES]))
            self._play(self._update)
            self._play(self._judge)
            self._feel()
        return self.state, self.area, self.success, self.press_n

    def _commanded(self, pressures_kpa: torch.Tensor) -> torch.Tensor:
        """Joint targets (N, n) of the twin's pipeline, on the CPU: its effects are defined there once."""
        targets = self._pipelines.step(pressures_kpa.cpu().numpy().astype(float), self.dt_s)
        self.pressure_kpa.copy_(self._sent(self._pipelines.pressure_kpa))
        return self._sent(targets)

    def _bent(self, q_cmd: torch.Tensor) -> torch.Tensor:
        """`World._bend` of joint targets (N, n), rad."""
        return self._rest_rad + self._gain * (q_cmd - self._rest_rad) + self._more / q_cmd.shape[1]

    def _resist(self) -> None:
        """Stiffness and damping of the spine about the present angles, as `World._resist` and `Springs`."""
        drive = self._drive
        K, s = self._controller.expand_as(self._K), self.single._springs
        if self._body is not None:
            q = self.qpos[:, self._qpos_of_spine]
            torque, J = self._body.resistance(drive, q)
            K = K - J
            self._rest.copy_(torque - torch.bmm(J, (q - drive)[..., None])[..., 0])
        half, own = 0.5 * self._h, 2 * K.diagonal(dim1=1, dim2=2) - K.sum(2)
        if len(self._tendons):
            tied = K[:, self._pairs[0], self._pairs[1]]
            self.fields["tendon_stiffness"][:, self._tendons] = tied
            self.fields["tendon_damping"][:, self._tendons] = half * tied
        self.fields["jnt_stiffness"][:, self._joints] = own
        self.fields["dof_damping"][:, self._dofs] = s._damping + half * own
        self._K.copy_(K)
        self._D.copy_(half * K + s._damping * torch.eye(K.shape[1], device=K.device))

    def _set_pad(self) -> None:
        """The gel's spring in each world, as `Pad.feel`."""
        k1, k3, depth_m = self._spring
        joint, dof = self._pad.id, int(self._pad.dofadr[0])
        slope = k1 + 3 * k3 * (depth_m + AHEAD_M) ** 2
        mass = (2 * self._h**2 * slope).clamp(min=MASS_KG)
        self.fields["jnt_stiffness"][:, joint] = k1
        self.fields["jnt_stiffnesspoly"][:, joint, 1] = k3
        self.fields["dof_armature"][:, dof] = mass - MASS_KG
        self.fields["dof_damping"][:, dof] = mass / (2 * self._h)

    def _advance(self, target_m: torch.Tensor, q_cmd: torch.Tensor) -> None:
        """`World._advance` of all worlds."""
        after = self._bent(q_cmd)
        if self._body is not None and not self._holds:
            self._play(self._resist)
        self._spring = self._contact.springs(self._play)
        self._play(self._set_pad)
        self._slope.copy_((after - self._drive) / (self._steps * self._h))
        self._path[0].copy_(self._drive)
        self._path[1].copy_(self._rate)
        self._end.copy_(target_m)
        self._substep()
        self._rate.copy_(self._slope)
        self._drive.copy_(after)
        self._begin.copy_(self._end)

    def _substep(self) -> None:
        if self._graph is None:
            self._physics()
        else:
            wp.capture_launch(self._graph)

    def repeat_physics(self) -> None:
        """The substeps of the last control step once more, alone: for benchmarks."""
        with self._on_device():
            self._substep()

    def _physics(self) -> None:
        """All substeps, and the contact forces after them; recorded as a CUDA graph."""
        m, d = self._model, self._data
        tensors = (self._rate, self._slope, self._K, self._D, self._rest, *self._path)
        arrays = [*self._chain, *(wp.from_torch(t) for t in tensors), *self._turning]
        slides = [wp.from_torch(self._begin), wp.from_torch(self._end), self._spine.start, d.ctrl]
        for k in range(self._steps):
            wp.launch(_drive, self.worlds, [k, self._steps, self._h, *arrays, *slides])
            mjw.step(m, d)
        mjw.kinematics(m, d)
        out, c = wp.from_torch(self.forces), d.contact
        out.zero_()
        contacts = [d.nacon, c.geom, c.worldid, c.dim, c.efc_address, d.efc.force]
        wp.launch(_forces, d.naconmax, [*contacts, self._groups, out])

    # ---------------------------------------------------------------- what is sensed

    def _update(self) -> None:
        self.rules.update(self)

    def _judge(self) -> None:
        diverged = ~torch.isfinite(self.qpos).all(1) | (self.qvel.abs().amax(1) > 1e4)
        self.success.copy_(self.rules.success(self) & ~diverged)
        self.failure.copy_(self.rules.failure(self) | diverged)

    def _feel(self) -> None:
        """Touch and state of the present kinematics."""
        self._play(self._look)
        self._play.some(self._press, self._touched)
        self._play(self._tell)

    def _look(self) -> None:
        self._touched.copy_(self._contact.look().amax((1, 2)) > 0)
        self.displacement_mm.zero_()
        self._touching.zero_()

    def _press(self, count: int) -> None:
        """Displacements and pixels of the worlds that touch something, of which there are at most `count`."""
        worlds, touched = first(self._touched, count)
        for some, on in zip(worlds.split(TOUCHED), touched.split(TOUCHED), strict=True):
            u = torch.where(on[:, None, None], self._moved(self.depth_mm[some]), 0.0)
            self.displacement_mm[some] = u
            pixels = self._count.of(self.tactile.light(u, self.tactile.model.thickness_mm))
            self._touching[some] = torch.where(on, pixels.float(), 0.0)

    def _tell(self) -> None:
        pixels = self._touching
        self.area.copy_(pixels / self._pixels)
        parts = (self._flange_m, self.qvel[:, :3], self.area[:, None], torch.log1p(pixels)[:, None])
        self.state.copy_(torch.cat([*parts, self.pressure_kpa], 1).nan_to_num(0.0, 0.0, 0.0))

    def _moved(self, depth: torch.Tensor) -> torch.Tensor:
        """Displacement (B, 80, 59) of the gel's face under probe grids that touch it, mm."""
        imprint = self.tactile.imprint(depth)
        if self._network is None:
            return self.tactile.surface(imprint)
        known = imprint.clamp(max=float(self.single.touch.network.deepest_mm))
        return imprint + self._network(known[:, None])[:, 0] - self._at_rest

    def images(self) -> torch.Tensor:
        """Tactile images, uint8 (N, H, W, 3), of the last step."""
        with self._on_device():
            parts, deepest = self.displacement_mm.split(TOUCHED), self.tactile.model.thickness_mm
            return torch.cat([self.tactile.draw(u, deepest) for u in parts])

    @property
    def centre_mm(self) -> torch.Tensor:
        """`gel.sensor.centre_mm` (N, 2) of the probe grids, mm; NaN without any depth."""
        pressed, total = self.depth_mm, self.depth_mm.sum((1, 2))
        out = []
        for axis, size in zip((1, 2), self.tactile.model.window_mm, strict=True):
            n = pressed.shape[3 - axis]
            at = (torch.arange(n, device=pressed.device) + 0.5) / n - 0.5
            out.append(size * (pressed.sum(axis) @ at) / total)
        return torch.stack(out, 1)

    def why_failed(self, world: int) -> str:
        """Why the task has failed in a world, in the words of its own class."""
        task, data = self.single.task, self.single.data
        data.qpos[:] = self.qpos[world].cpu().numpy()
        for name, forces in zip(self.rules.groups, self.rules.state["forces"][world].tolist(), strict=False):
            setattr(task, name, tuple(forces))
        return task.failure() or DIVERGED

    @property
    def press_n(self) -> torch.Tensor:
        """Force (N,) on the gel, N."""
        k1, k3, _ = self._spring
        x = -self.qpos[:, int(self._pad.qposadr[0])]
        return k1 * x + k3 * x**3


class Rollouts:
    """`Gantry.rollouts` of worlds of a batch: sequences for many of them are tried together.

    Args:
        batch: of `forked` worlds.
        ahead: of the same model, whose worlds try the sequences.
    """

    def __init__(self, batch: BatchedWorld, ahead: BatchedWorld):
        self._batch, self._ahead = batch, ahead

    def mirror(self, worlds: Sequence[int], samples: int, area: np.ndarray) -> None:
        """Takes over the states of worlds (k,), each for that many sequences, as `Gantry.mirror`.

        `area` (k,) is what the gels are thought to feel; how far it is from what they feel is held.
        """
        owners = np.repeat(worlds, samples)
        self._used = np.arange(len(owners))
        self._state = self._batch.fork(owners)
        self._state[0]["_warmstart"].zero_()
        self._residual_area = np.repeat(area, samples) - self._state[0]["area"].cpu().numpy()

    def rollouts(self, actions: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Tries sequences (k, S, H, 3 + C) of actions within the limits, from the mirrored states.

        Returns:
            flange positions (k, S, H, 3), metres, and contact areas (k, S, H).
        """
        b, felt = self._ahead, []
        b.resume(self._used, self._state)
        steps = np.zeros((b.worlds, *actions.shape[2:]), np.float32)
        steps[self._used] = actions.reshape(-1, *actions.shape[2:])
        for t in range(steps.shape[1]):
            b._holds = t > 0  # the finger's stiffness, as in `Gantry`
            b.step(steps[:, t])
            felt.append(torch.cat([b.state[:, :3], b.area[:, None]], 1))
        b._holds = False
        rows = torch.stack(felt, 1)[: len(self._used)].cpu().numpy().astype(float)
        area = rows[..., 3] + (rows[..., 3] > 0) * self._residual_area[:, None]
        shape = actions.shape[:3]
        return rows[..., :3].reshape(*shape, 3), np.maximum(area, 0.0).reshape(shape)
