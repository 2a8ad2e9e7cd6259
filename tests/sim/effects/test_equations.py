"""What is printed as an effect's equation is what its kernel computes: the text itself is evaluated."""

import math
import re

import numpy as np
import pytest

from pneutac_sim.effects import get_effect
from pneutac_sim.effects.effect import plain_equation
from pneutac_sim.effects.laws import SEEN, SYMBOLS, TABLE, TIMES_S, law

P, DT, LENGTH, FINE = 10.0, 0.05, 80.0, 400
T_C = 23.0 + 10 * np.sin(np.linspace(0, 3, 160))


def pressures(n=160):
    """Straight lines up and down between random pressures, one of them held."""
    levels = np.random.default_rng(3).uniform(0.5, P, 9)
    levels[4] = levels[3]
    return np.interp(np.linspace(0, 8, n), np.arange(9), levels)


def solved(slope, f, y, holds=False):
    """(n,) y of dy/dt = slope(y, f, i), f a straight line between samples, by the midpoint rule."""
    out = [y]
    for i in range(1, len(f)):
        for k in range(FINE):
            share = 1.0 if holds else (k + 0.5) / FINE
            now, h = f[i - 1] + share * (f[i] - f[i - 1]), DT / FINE
            y = y + h * slope(y + h / 2 * slope(y, now, i), now, i)
        out.append(y)
    return np.array(out)


def stepwise(rule, f, y):
    return np.array([y := rule(y, v, i) for i, v in enumerate(f)])


class Operators:
    """The operators that stand in equations of laws, as `TERMS` says, with the constants `k` by symbol."""

    def __init__(self, p, k, conditions=None):
        self.p, self.k, rate = p, k, np.r_[0.0, np.diff(p) / DT]
        dT = None if conditions is None else (conditions - 23) / 10
        still = np.abs(np.diff(p, prepend=np.inf)) <= 1e-6 * P
        held_s = stepwise(lambda y, s, i: y + DT if s else 0.0, still, 0.0)
        damage = np.r_[0.0, np.cumsum(DT * np.maximum(p[1:] / P, 0) ** k.get("c", 1) / k.get("tau", 1))]
        self.names = k | {"p": p, "P": P, "RATE": rate, "dT": dT, "t_held": held_s, "D": damage}
        # of the two other chambers, and of all
        self.names |= {"p_others": 0.7 * p, "Q": 1.7 * np.maximum(rate, 0.0)}
        self.names |= {"p_max": np.maximum.accumulate(p), "n": np.r_[0.0, np.cumsum(np.abs(np.diff(p)))]}
        self.names |= {"t": conditions, "tanh": np.tanh, "exp": np.exp, "sqrt": np.sqrt, "sign": np.sign}
        self.names |= {"max": np.maximum, "round": np.round, "abs": np.abs}
        own = ("LAG", "LAGS", "FILL", "PLAY", "PLAYS", "BAND", "LOOP", "MODE", "PEAK", "SPRING")
        self.names |= {name: getattr(self, name.lower()) for name in own}

    def lag(self, f, tau=None):
        tau = np.broadcast_to(self.k["tau"] if tau is None else tau, len(f))
        moves = abs(f[0]) == 0.0 and abs(f[1]) > 0  # of a rate, which holds since the sample before
        return solved(lambda y, v, i: (v - y) / tau[i], f, f[0], moves)

    def lags(self, f, factor):
        return self.lag(f, self.k["tau"] * factor)

    def fill(self, f):
        up, down = self.k["tau_+"], self.k["tau_-"]
        return solved(lambda y, v, i: (v - y) / (up if f[i] > y else down), f, f[0])

    def play(self, f, up=None, down=None):
        up, down = up or self.k["r"], down or up or self.k["r"]
        return stepwise(lambda y, v, i: min(max(y, v - up), v + down), f, 0.0)

    def plays(self, f):
        return self.play(f, self.k["r"], self.k["l"])

    def band(self, f):
        return stepwise(lambda y, v, i: v if i == 0 or abs(v - y) > self.k["r"] else y, f, 0.0)

    def loop(self, f):
        r, df = self.k["r"], np.diff(f, prepend=f[0]) / DT
        return solved(lambda y, v, i: df[i] - abs(df[i]) * abs(y / r) ** 0.3 * y / r, f, 0.0)

    def mode(self, f):
        w, z = self.k["omega"], self.k["zeta"]
        slope = lambda y, v, i: np.array([y[1], -2 * z * w * y[1] - w * w * (y[0] - v)])  # noqa: E731
        return solved(slope, f, np.array([f[0], 0.0]))[:, 0]

    def peak(self, f):
        keep = math.exp(-DT / self.k["tau"])
        return stepwise(lambda y, v, i: max(y * keep, v), f, 0.0)

    def spring(self, f):
        weight = TIMES_S ** self.k["c"]
        return sum(w * self.lag(f, tau) for w, tau in zip(weight, TIMES_S, strict=True)) / weight.sum()

    def value(self, text):
        """(n,) of a printed term."""
        for shown, name in OPERATORS.items():
            text = text.replace(shown, name)
        text = re.sub(r"\|([^|]*)\|", r"abs(\1)", text).replace("e^(", "exp(").replace("^", "**")
        text = re.sub(r"(?<=[\w)])\s+(?=[\w(])", " * ", text)  # a blank is a product
        return eval(text, {"__builtins__": {}}, self.names)


OPERATORS = {
    "lag_tau_+,tau_-(p)": "FILL(p)", "lag_tau k^(p/P)(p)": "LAGS(p, k**(p/P))", "lag_tau(": "LAG(",
    "lag_tau k^(dT)(p)": "LAGS(p, k**dT)", "play_r,l(": "PLAYS(", "play_r(": "PLAY(", "band_r(": "BAND(",
    "loop_r(": "LOOP(", "mode_omega,zeta(": "MODE(", "peak_tau(": "PEAK(", "springpot_c(": "SPRING(",
    "dp/dt": "RATE",
}  # fmt: skip


@pytest.mark.parametrize("name", TABLE)
def test_a_law_computes_what_is_printed(name):
    effect, p = law(name), pressures()
    values = {q.name: q.limits(P)[0] for q in effect.parameters} | {"weight": 0.7, "scale_kpa": P}
    values |= {q.name: 0.6 * values[q.name] + 0.4 * q.limits(P)[0] for q in TABLE[name].constants}
    if "exponent" in values:
        values["exponent"] = 1.4 if "power_law" not in name else 0.2
    conditions = None
    if effect.columns:
        conditions = T_C if effect.columns == ("temperature_c",) else np.arange(len(p)) * DT
    printed = effect.describe(values).partition(" becomes p + 0.7 ")[2]
    equation = plain_equation(effect.equation)
    term = equation.removeprefix("p -> p + w (").partition("), ")[0]
    term = term if "), " in equation else term.removesuffix(")")
    assert printed.startswith((term, f"({term})")) and "[" not in printed
    symbols = {SYMBOLS.get(q.name, "r"): values[q.name] for q in TABLE[name].constants}
    assert len(symbols) == len(TABLE[name].constants)  # no two constants are called the same
    wanted = p + 0.7 * Operators(p, symbols, conditions).value(term)
    chambers = np.c_[p, 0.3 * p, 0.4 * p] if effect.several else p[:, None]
    found = effect.apply(chambers, np.full(len(p), DT), values, conditions)[:, 0]
    moved = np.abs(found - p).max()
    np.testing.assert_allclose(found, wanted, rtol=0, atol=0.02 * moved, err_msg=term)
    assert moved > 0.004 * P


@pytest.mark.parametrize("name", SEEN)
def test_a_law_of_what_is_seen_computes_what_is_printed(name):
    effect, rng = law(name), np.random.default_rng(0)
    markers, condition = rng.uniform(1, 60, (20, 5)), rng.uniform(-1, 1, 20)
    columns = {"length_mm": np.full(20, LENGTH), "temperature_c": 23 + 10 * condition}
    columns |= {"gravity_y": condition, "payload_g": 10 * markers[:, 2]}
    conditions = np.stack([columns[c] for c in effect.columns], axis=1)
    found = effect.apply(markers, np.ones(20), {"weight": 0.3}, conditions)
    output, _, term = plain_equation(effect.equation).partition(" -> ")
    names = dict(zip(("tip_x", "tip_y", "tip_z", "bend"), markers.T, strict=False))
    names |= {
        "x": markers[:, 0],
        "z": markers[:, 2],
        "L": LENGTH,
        "dT": condition,
        "g_y": condition,
        "m": markers[:, 2],
        "w": 0.3,
    }
    text = re.sub(r"(?<=\w)\s+(?=\w)", " * ", term.replace("^", "**"))
    wanted = markers.copy()
    wanted[:, list(names).index(output)] = eval(text, {"__builtins__": {}}, names)
    np.testing.assert_allclose(found, wanted)
    assert f"becomes {term.replace('w ', '0.3 ')}." in effect.describe({"weight": 0.3})


# Effect to the symbols of its parameters, in their order, and of its conditions; those of one line.
PLAIN = {
    "stiffening": ("a b", ""), "gain_saturation": ("p_s", ""), "elongation": ("e", "p"),
    "thermal": ("c d T_ref", "T"), "sensor_offset": ("s o d", "t"),
}  # fmt: skip


@pytest.mark.parametrize("name", PLAIN)
def test_an_effect_of_one_line_computes_what_is_printed(name):
    effect, x = get_effect(name), pressures(30)
    if name == "elongation":  # of a place
        x = np.c_[x, x, x, x, x]
    symbols, columns = (text.split() for text in PLAIN[name])
    values = {p.name: 1.3 * p.limits(P)[0] + 0.01 * (p.neutral == 0) for p in effect.parameters}
    conditions = np.linspace(1, 9, 30)
    names = dict(zip(symbols, values.values(), strict=True)) | dict.fromkeys(columns, conditions)
    names |= {"tanh": np.tanh, "exp": np.exp, "abs": np.abs}
    term, _, more = plain_equation(effect.equation).partition(", ")
    before, _, term = term.partition(" -> " if " -> " in term else " = ")
    names |= {before: x, "p_read": x} if before != "x" else {"x": x[:, :3], "p": conditions[:, None]}
    if more:
        names["dT"] = conditions - names["T_ref"]
    text = re.sub(r"\|([^|]*)\|", r"abs(\1)", term).replace("e^(", "exp(").replace("^", "**")
    text = re.sub(r"(?<=[\w)])\s+(?=[\w(])", " * ", text)
    found = effect.apply(x, np.ones(30), values, conditions if columns else None)
    wanted = eval(text, {"__builtins__": {}}, names)
    np.testing.assert_allclose(found[:, :3] if before == "x" else found, wanted, rtol=1e-9)


def test_the_words_of_an_equation_stand_apart():
    assert plain_equation(get_effect("air_resonance").equation).startswith("d^2p/dt^2 + 2 zeta omega dp/dt")
    assert plain_equation(get_effect("leak").equation) == "dp/dt = -k p while dp_cmd/dt = 0"
    assert "P tanh(" in plain_equation(law("step(p)").equation)
