"""Trains the action network on motions of the full finger, and measures it on others.

plan, motions = read_motions(folder, twin)
network = train_action(twin, folder)
evaluate_action(twin, network, folder).position_deg
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from pneutac_sim.errors import InputError
from pneutac_sim.mpm import devices
from pneutac_sim.surrogate.collect import FRAME_S, Motion, read_motions
from pneutac_sim.surrogate.finger import fingerprint
from pneutac_sim.surrogate.network import HIDDEN, ActionNetwork
from pneutac_sim.surrogate.skeleton import Skeleton
from pneutac_sim.twin import Twin

BATCH = 256
LEARNING_RATE = 1e-3
# Noise on inputs. Joints move together, so data do not determine f_r in other directions; noise makes it flat
# there, where a steep one would shake the skeleton.
NOISE_RAD, NOISE_RAD_S, NOISE_KPA = 0.002, 0.3, 0.1
EPOCHS, PATIENCE = 1000, 100
FEWEST = 6  # trajectories: four to train on, one to stop by, one to measure with


@dataclass(frozen=True)
class Evaluation:
    """Motion of the skeleton under the network against that of the full finger, on held-out trajectories.

    Means of absolute errors over joints and time, with the standard error of the mean over trajectories.
    """

    # position_deg, position_sem: joint angles
    position_deg: float
    position_sem: float
    # velocity_deg_s, velocity_sem: joint rates
    velocity_deg_s: float
    velocity_sem: float
    torque_nm: float  # root mean square error of f_r on the held-out pairs
    # bare_position_deg, bare_velocity_deg_s, bare_torque_nm: the same with f_r = 0
    bare_position_deg: float
    bare_velocity_deg_s: float
    bare_torque_nm: float
    in_range: float  # share of frames in the range of training
    trajectories: int  # how many


def train_action(
    twin: Twin,
    data_dir: str | Path,
    seed: int = 0,
    progress: Callable[[str], None] = lambda _: None,
) -> ActionNetwork:
    """Fits f_r to the torques of inverse dynamics by mean squared error (Adam, learning rate 1e-3).

    On the trajectories of a folder of `collect_action`, in at most `EPOCHS` epochs; `seed` is of weights and
    batches, and `progress` is given a line now and then. The weights with the lowest error on the
    trajectories of early stopping are stored.

    Raises InputError where there are too few trajectories, or those of another twin.
    """
    plan, motions = read_motions(data_dir, twin)
    train, stop, _ = split(motions)
    solver = devices.finger(twin, particles=plan.particles)
    skeleton = Skeleton.of(solver.body, solver.spine, plan.damping_per_s)
    x, y = pairs(skeleton, train)
    mean, scale = x.mean(0), np.maximum(x.std(0), 1e-6)
    torque_mean = y.mean(0)
    slope = np.linalg.lstsq((x - mean) / scale, y - torque_mean, rcond=None)[0]

    def bent(x, y):
        return y - torque_mean - (x - mean) / scale @ slope

    # One scale for all joints: a torque moves each of them by torque / K.
    torque_scale = np.full(y.shape[1], max(float(bent(x, y).std(0).mean()), 1e-9))
    n = y.shape[1]
    noise = np.repeat([NOISE_RAD, NOISE_RAD_S, NOISE_KPA], [n, n, 1]) / scale
    sets = [((a - mean) / scale, bent(a, b) / torque_scale) for a, b in ((x, y), pairs(skeleton, stop))]

    def report(epoch, loss):
        progress(f"epoch {epoch}: error {np.sqrt(loss) * torque_scale[0]:.3g} N m")

    layers = _descend(*sets, noise, seed, EPOCHS, report)
    if layers is None:
        raise InputError(
            f"The torques of the trajectories in '{data_dir}' are not finite; collect them again."
        )
    return ActionNetwork(
        layers=layers,
        slope=slope,
        mean=mean,
        scale=scale,
        torque_mean=torque_mean,
        torque_scale=torque_scale,
        low=x.min(0),
        high=x.max(0),
        drive=np.array([twin.parameter("gain_rad_per_kpa"), twin.parameter("rest_pressure_kpa")]),
        skeleton=skeleton,
        fingerprint=fingerprint(twin),
        modulus_mpa=devices.parameter(twin, "youngs_modulus_mpa"),
    )


def _descend(train, stop, noise, seed: int, epochs: int, report) -> tuple[np.ndarray, ...] | None:
    """Adam on the mean squared error; weights (in, out) and biases of the epoch that is best on `stop`.

    `train` and `stop` are inputs and outputs of unit variance, `noise` (inputs,) standard deviations. None
    where no error is a finite number.
    """
    import torch  # takes a second

    random = torch.Generator().manual_seed(seed)
    noise, *arrays = (torch.tensor(a, dtype=torch.float32) for a in (noise, *train, *stop))
    inputs, wanted, stop_inputs, stop_wanted = arrays
    model = _mlp(torch, inputs.shape[1], wanted.shape[1], random)
    adam = torch.optim.Adam(model.parameters(), lr=LEARNING_RATE)
    best, best_weights, since = np.inf, None, 0
    for epoch in range(epochs):
        for rows in torch.randperm(len(inputs), generator=random).split(BATCH):
            adam.zero_grad()
            noisy = inputs[rows] + noise * torch.randn(len(rows), inputs.shape[1], generator=random)
            torch.nn.functional.mse_loss(model(noisy), wanted[rows]).backward()
            adam.step()
        with torch.no_grad():
            loss = float(torch.nn.functional.mse_loss(model(stop_inputs), stop_wanted))
        since += 1
        if loss < best:
            best, since = loss, 0
            best_weights = [p.detach().clone() for p in model.parameters()]
        if epoch % 50 == 0 or since == PATIENCE:
            report(epoch, best)
        if since == PATIENCE:
            break
    # torch keeps (out, in)
    return None if best_weights is None else tuple(np.ascontiguousarray(p.numpy().T) for p in best_weights)


def evaluate_action(twin: Twin, network: ActionNetwork, data_dir: str | Path) -> Evaluation:
    """Moves the skeleton through the held-out programs of a folder, from the full finger's first state on."""
    _, motions = read_motions(data_dir, twin)
    held_out = split(motions)[2]
    bare = without_torque(network)
    errors = np.array([_errors(network, m) for m in held_out])
    without = np.array([_errors(bare, m) for m in held_out])
    x, y = pairs(network.skeleton, held_out)
    n = network.joints
    left = network.torque(x[:, :n], x[:, n : 2 * n], x[:, -1]) - y
    position, velocity, in_range = errors.mean(0)
    sem = errors.std(0, ddof=1) / np.sqrt(len(errors)) if len(errors) > 1 else np.full(3, np.nan)
    return Evaluation(
        position_deg=float(position),
        position_sem=float(sem[0]),
        velocity_deg_s=float(velocity),
        velocity_sem=float(sem[1]),
        torque_nm=float(np.sqrt((left**2).mean())),
        bare_position_deg=float(without[:, 0].mean()),
        bare_velocity_deg_s=float(without[:, 1].mean()),
        bare_torque_nm=float(np.sqrt((y**2).mean())),
        in_range=float(in_range),
        trajectories=len(held_out),
    )


def split(motions: list[Motion]) -> tuple[list[Motion], list[Motion], list[Motion]]:
    """Trajectories to train on, to stop by, and to measure with; a sixth each of the last two.

    Raises InputError where there are too few.
    """
    if len(motions) < FEWEST:
        raise InputError(
            f"There are {len(motions)} trajectories; collect at least {FEWEST} with `pneutac surrogate`."
        )
    sixth = len(motions) // 6
    return motions[: -2 * sixth], motions[-2 * sixth : -sixth], motions[-sixth:]


def pairs(skeleton: Skeleton, motions: list[Motion]) -> tuple[np.ndarray, np.ndarray]:
    """States (R, 2 N + 1) and residual torques tau_r* (R, N) in N m by inverse dynamics."""
    states, torques = [], []
    for m in motions:
        q, v = m.q[1:-1], m.q_vel[1:-1]
        states.append(np.column_stack([q, v, m.pressure_kpa[1:-1]]))
        # tau_r* = M q'' + D q' + K q - tau_mpm (paper, Sec. Action and Perception Networks)
        torques.append(skeleton.residual_torque(q, v, m.accelerations(), m.target[1:-1]))
    return np.concatenate(states), np.concatenate(torques)


def without_torque(network: ActionNetwork) -> ActionNetwork:
    """The same skeleton with f_r = 0."""
    zero = np.zeros_like(network.torque_mean)
    return replace(network, slope=np.zeros_like(network.slope), torque_mean=zero, torque_scale=zero)


def _errors(network: ActionNetwork, m: Motion) -> tuple[float, float, float]:
    q, v, inside = network.roll(m.q[0], m.q_vel[0], m.target, m.pressure_kpa, (len(m.q) - 1) * FRAME_S)
    return (np.degrees(np.abs(q - m.q[1:]).mean()), np.degrees(np.abs(v - m.q_vel[1:]).mean()), inside.mean())


def _mlp(torch, inputs: int, outputs: int, random):
    """Two hidden layers, initialised from `random` alone."""
    nn = torch.nn
    model = nn.Sequential(
        nn.Linear(inputs, HIDDEN), nn.Softsign(), nn.Linear(HIDDEN, HIDDEN), nn.Softsign(),
        nn.Linear(HIDDEN, outputs),
    )  # fmt: skip
    with torch.no_grad():
        for layer in model[::2]:
            bound = layer.in_features**-0.5
            for p in (layer.weight, layer.bias):
                p.copy_((2 * torch.rand(p.shape, generator=random) - 1) * bound)
    return model
