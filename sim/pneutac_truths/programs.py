"""What a lab would command in one recording: trials of different programs, pauses between, a few repeats."""

from dataclasses import dataclass, field, replace

import numpy as np

DT_S = 0.005  # of the fine time grid on which all physics run
ROW_S = 0.05  # between recorded samples
KINDS = ("steps", "ramps", "sine", "staircase", "random_holds", "chirp")


@dataclass(frozen=True, eq=False)
class Plan:
    """Time grid and commands of one recording."""

    time_s: np.ndarray  # (n,) fine grid over trials and pauses
    command: np.ndarray  # (n, chambers) what the computer last sent, as share of the top pressure
    sent_s: np.ndarray  # (n,) when it was sent, s of the fine grid
    starts: list[int]  # first row of each trial on the grid
    ends: list[int]  # row after its last
    programs: list[str]  # name of each trial
    pauses_s: list[float]  # (trials,) before each trial; the first has none
    row_s: float = ROW_S  # between recorded samples
    # of each trial, where somebody else decides them: `gravity` (trials, 3) unit vectors, `payload_g`
    # (trials,) and `temperature_c` (trials,); they are logged whether or not they act
    conditions: dict[str, np.ndarray] = field(default_factory=dict)

    @property
    def rows(self) -> np.ndarray:
        """Rows of the fine grid that are recorded."""
        every = self.row_s / DT_S
        trials = [a + np.arange(0, b - a - 0.51, every) for a, b in zip(self.starts, self.ends, strict=True)]
        return np.round(np.concatenate(trials)).astype(int)

    @property
    def trial(self) -> np.ndarray:
        """(n,) trial of each row of the fine grid, -1 in pauses."""
        out = np.full(len(self.time_s), -1)
        for i, (a, b) in enumerate(zip(self.starts, self.ends, strict=True)):
            out[a:b] = i
        return out


def plan(rng: np.random.Generator, chambers: int, minutes: float, quiet: bool = False) -> Plan:
    """Draws a recording of about so many minutes of trials; every 10 have 10 to 16 of 20 to 60 s.

    `quiet` leaves out the fastest programs (for slow solvers).
    """
    n = int(np.clip(rng.integers(10, 17) * min(1.0, minutes / 7), 6, 16)) * max(1, round(minutes / 10))
    repeats = max(1, round(n / 6))
    own = n - repeats
    seconds = rng.uniform(0.7, 1.3, own)
    kinds = [str(k) for k in rng.permutation(np.resize(KINDS[: 5 if quiet else 6], own))]
    again = rng.choice(own, repeats, replace=False)
    order = [*range(own), *again]
    seconds *= 60 * minutes / seconds[order].sum()
    seconds = np.clip(seconds, 15, 60)
    tick = rng.uniform(0.02, 0.05)  # of the computer that commands
    made = [_trial(rng, kinds[i], seconds[i], chambers, tick) for i in range(own)]
    pauses = [0.0, *np.exp(rng.uniform(np.log(2), np.log(60), n - 1)).round(1)]
    return _joined([made[i] for i in order], [kinds[i] for i in order], pauses)


def given(
    programs: list[tuple[str, np.ndarray, np.ndarray]],
    pause_s: float,
    row_s: float = ROW_S,
    conditions: dict[str, np.ndarray] | None = None,
) -> Plan:
    """What somebody else commands, with a rest before each program but the first.

    A program is its name, times (n,) from 0 in s, and shares of the top pressure (n, chambers), or (n,) of
    one chamber, held from their times on; `conditions` as of `Plan`.
    """
    trials = []
    for _, time_s, share in programs:
        t = np.arange(round(time_s[-1] / DT_S) + 1) * DT_S
        latest = np.searchsorted(time_s, t + 1e-9, side="right") - 1
        commands = np.reshape(np.asarray(share, float), (len(time_s), -1))
        new = np.r_[True, (np.diff(commands, axis=0) != 0).any(axis=1)]
        sent = np.asarray(time_s)[np.maximum.accumulate(np.where(new, np.arange(len(time_s)), 0))]
        trials.append((commands[latest], _on_grid(sent)[latest]))
    joined = _joined(trials, [name for name, *_ in programs], [0.0, *[pause_s] * (len(programs) - 1)])
    return replace(joined, row_s=row_s, conditions=conditions or {})


def _on_grid(sent_s: np.ndarray) -> np.ndarray:
    """When commands really come: at the next instant of the fine grid, which the log then has."""
    return np.ceil(sent_s / DT_S - 1e-9) * DT_S


def _joined(trials, programs, pauses) -> Plan:
    command, sent, starts, ends, at = [], [], [], [], 0
    for (c, s), pause in zip(trials, pauses, strict=True):
        rest = round(pause / DT_S)
        command += [np.zeros((rest, c.shape[1])), c]
        sent += [np.full(rest, at * DT_S), s + (at + rest) * DT_S]
        starts.append(at + rest)
        at += rest + len(c)
        ends.append(at)
    rows = np.arange(at) * DT_S, np.concatenate(command), np.concatenate(sent)
    return Plan(*rows, starts, ends, programs, pauses)


def _trial(rng, kind, seconds, chambers, tick) -> tuple[np.ndarray, np.ndarray]:
    """Held commands (n, chambers) of one trial and when each was sent (n,), s from the trial's start."""
    t = np.arange(round(seconds / DT_S)) * DT_S
    lead = rng.uniform(0.3, 2.0)
    ticks = rng.uniform(0, tick) + tick * np.arange(int(seconds / tick) + 1)
    at = np.maximum(ticks - lead, 0.0)
    wanted = np.stack([_program(rng, kind, at, seconds) for _ in range(chambers)], 1)
    if chambers > 1 and rng.random() < 0.4:  # one chamber alone
        wanted *= np.eye(chambers)[rng.integers(chambers)]
    wanted[ticks < lead] = 0.0
    wanted = np.round(np.clip(wanted, 0, 1), 4)
    new = np.r_[True, np.abs(np.diff(wanted, axis=0)).max(1) > 0]
    sent = ticks[np.maximum.accumulate(np.where(new, np.arange(len(ticks)), 0))]
    last = np.searchsorted(ticks, t + 1e-9, side="right") - 1
    held = np.where((last >= 0)[:, None], wanted[np.maximum(last, 0)], 0.0)
    return held, np.where(last >= 0, _on_grid(sent)[np.maximum(last, 0)], 0.0)


def _program(rng, kind, t, seconds) -> np.ndarray:
    if kind == "steps":  # up to a level and back to zero
        hold = rng.uniform(2, 7)
        n = int(seconds / hold) + 2
        level = np.r_[1.0, rng.uniform(0.1, 1.0, n)][rng.permutation(n + 1)]
        beat = (t / hold).astype(int)
        return np.where(beat % 2 == 0, level[beat // 2], 0.0)
    if kind == "random_holds":
        ends = np.cumsum(np.exp(rng.uniform(np.log(0.4), np.log(6), int(seconds / 0.4) + 2)))
        level = rng.uniform(0, 1, len(ends)) * (rng.random(len(ends)) > 0.1)
        return level[np.searchsorted(ends, t)]
    if kind == "staircase":
        up = int(rng.integers(4, 9))
        stairs = np.r_[np.arange(up + 1), np.arange(up - 1, 0, -1)] / up * rng.uniform(0.8, 1)
        hold = max(1.0, min(rng.uniform(1.5, 6), seconds / len(stairs)))
        return stairs[(t / hold).astype(int) % len(stairs)]
    if kind == "ramps":  # up and down, each at a pace of its own, with short holds
        corners, values = [0.0], [0.0]
        while corners[-1] < seconds + 1:
            values += [rng.uniform(0.4, 1.0)] * 2 + [rng.uniform(0, 0.3) * (rng.random() < 0.6)] * 2
            pace = np.exp(rng.uniform(np.log(0.08), np.log(1.2)))
            for i in range(-4, 0):
                move = abs(values[i] - values[i - 1]) / pace
                corners.append(corners[-1] + (move if i % 2 == 0 else rng.uniform(0.2, 3)))
        return np.interp(t, corners, values)
    middle = rng.uniform(0.35, 0.6)
    swing = rng.uniform(0.6, 1.0) * min(middle, 1 - middle)
    if kind == "sine":
        f = np.exp(rng.uniform(np.log(0.04), np.log(0.6)))
        turn = 2 * np.pi * f * t
    else:  # chirp: from slow to fast
        f0, f1 = 0.03, rng.uniform(0.4, 1.2)
        turn = 2 * np.pi * f0 * seconds / np.log(f1 / f0) * ((f1 / f0) ** (t / seconds) - 1)
    return middle - swing * np.cos(turn + rng.uniform(-0.8, 0.8))
