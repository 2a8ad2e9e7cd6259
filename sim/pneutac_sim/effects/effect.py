"""What an effect is: one physical mechanism, with parameters, that a twin may have or lack.

A finger's or an arm's effects act on a signal of the finger pipeline (`body_effect`), a touch sensor's on its
contacts and pictures (`sensor_effect`). Both are found by one registry and one entry point.
"""

import re
from collections.abc import Callable
from dataclasses import dataclass

from pneutac_sim.errors import InputError
from pneutac_sim.value import Value

BODY_STAGES = ("pneumatics", "drive", "load", "material", "observation")
SENSOR_STAGES = ("gel", "light")
STAGES = BODY_STAGES + SENSOR_STAGES  # in the order in which they act


@dataclass(frozen=True)
class Parameter:
    """A number that calibration may fit."""

    name: str  # with its unit, such as `fill_time_s`
    unit: str  # as shown to people; empty for a ratio
    default: float  # where a fit starts: a mild but visible effect
    lower: float  # least value that physics allows
    upper: float  # largest value
    # value at which the effect (or this part of it) does nothing; may lie outside the bounds
    neutral: float = 0.0
    log: bool = False  # True where the parameter is positive and its magnitude is what matters
    # True for a constant that a user may set and that data do not separate from another parameter
    fixed: bool = False
    range_power: int = 0  # default and bounds are in units of (largest pressure in kPa) ** range_power
    # share of the range between bounds by which a fit moves it to see what it does; larger where the answer
    # comes in jumps
    step: float = 1e-5
    # share of that range within which a fit also tries values, where the error comes in jumps that no
    # derivative shows; 0 for none
    jump: float = 0.0

    def __post_init__(self):
        if not (self.lower <= self.default <= self.upper and self.lower < self.upper):
            raise InputError(
                f"Parameter '{self.name}': default {self.default} must lie in [{self.lower}, {self.upper}]."
            )
        if self.log and self.lower <= 0:
            raise InputError(f"Parameter '{self.name}' is logarithmic; its lower bound must be above zero.")

    def limits(self, pressure_range_kpa: float) -> tuple[float, float, float]:
        """Default, lower and upper for a device driven up to this pressure."""
        scale = pressure_range_kpa**self.range_power
        return self.default * scale, self.lower * scale, self.upper * scale


_WORDS = {
    r"\to": "->", r"\le": "<=", r"\cdot": "*", r"\quad": " ", r"\,": " ", r"\;": " ", r"\left": "",
    r"\right": "", r"\mathrel": "", r"\pm": "+-", r"\int": "integral ", r"\Delta ": "d", r"\varphi": "phi",
    r"\nabla ": "grad ",
}  # fmt: skip


def plain_equation(latex: str) -> str:
    """An equation as a terminal shows it."""
    text = re.sub(r"(?<=[A-Za-z0-9])(?=\\[A-Za-z])", " ", latex)
    text = re.sub(r"\\(?:text|mathrm|mathrel)\{([^{}]*)\}", r"\1", text)
    text = re.sub(r"\\bar\s*(\w+)", r"mean \1", text)
    text = re.sub(r"\\ddot\s*([A-Za-z]+(?:_\{[^{}]*\})?)", r"d^2\1/dt^2", text)
    text = re.sub(r"\\dot\s*([A-Za-z]+(?:_\{[^{}]*\}|_\w)?)", r"d\1/dt", text)
    for _ in range(4):
        text = re.sub(
            r"\\frac\{([^{}]*(?:\{[^{}]*\}[^{}]*)*)\}\{([^{}]*(?:\{[^{}]*\}[^{}]*)*)\}", r"(\1)/(\2)", text
        )
        text = re.sub(r"\\sqrt\{([^{}]*(?:\{[^{}]*\}[^{}]*)*)\}", r"sqrt(\1)", text)
    for word in sorted(_WORDS, key=len, reverse=True):
        text = text.replace(word, _WORDS[word])
    text = re.sub(r"_\{([^{}]*)\}", r"_\1", text)
    text = re.sub(r"\^\{([^{}]*)\}", r"^(\1)", text)
    text = re.sub(r"\\(\w+)", r"\1", text).replace("{", "").replace("}", "")
    return " ".join(text.split())


@dataclass(frozen=True, kw_only=True)
class Effect:
    """One physical mechanism; `BodyEffect` and `SensorEffect` say how it acts."""

    stages = STAGES

    name: str  # as the user types it
    stage: str  # one of `STAGES`
    parameters: tuple[Parameter, ...]  # what calibration may fit
    summary: str  # one sentence for a newcomer, with `{device}` and `{parameter}` placeholders
    experiment: str  # what to record to distinguish the effect from its alternatives
    # in LaTeX, for the catalogue of effects; an arrow leads from a signal to what becomes of it
    equation: str = ""
    cause: str = ""  # the summary as a noun phrase, for a list of causes; the name where it is empty
    # parameter values to further values that `summary` and `cause` show
    derive: Callable[[dict[str, float]], dict[str, float]] = lambda values: {}

    def __post_init__(self):
        if self.stage not in self.stages:
            raise InputError(
                f"Effect '{self.name}': stage '{self.stage}' must be one of {', '.join(self.stages)}."
            )

    @property
    def of_air(self) -> bool:
        """Whether it acts between the commanded and the measured pressure."""
        return False

    def start(self, pressure_range_kpa: float = 1.0) -> dict[str, Value]:
        """Parameter values with which a fit starts."""
        return {p.name: Value(p.limits(pressure_range_kpa)[0]) for p in self.parameters}

    def neutral(self) -> dict[str, Value]:
        """Parameter values at which the effect does nothing."""
        return {p.name: Value(p.neutral) for p in self.parameters}

    def describe(self, values: dict[str, float], device: str = "finger") -> str:
        """The summary with numbers, e.g. of a fit."""
        return self._filled(self.summary, values, device)

    def describe_any(self, values: dict[str, float], device: str = "finger") -> str:
        """The same where no device of the reader's is meant, as in a catalogue."""
        text = self.describe(values, device)
        text = re.sub(rf"^Your (?={device})", f"A{'n' * (device[0] in 'aeiou')} ", text)
        return text.replace("Your ", "The ").replace("your ", "the ")

    def as_cause(self, values: dict[str, float], device: str = "finger") -> str:
        """The cause with numbers, e.g. `creep, time constant 8 s`."""
        return self._filled(self.cause or self.name.replace("_", " "), values, device)

    @property
    def plain_cause(self) -> str:
        """The cause without numbers, which follow a comma."""
        return (self.cause or self.name.replace("_", " ")).partition(",")[0]

    def _filled(self, text: str, values: dict[str, float], device: str) -> str:
        shown: dict[str, float] = {k: _Plain(v) for k, v in values.items()}
        shown |= {k: _Plain(v) if isinstance(v, float) else v for k, v in self.derive(shown).items()}
        return text.format(device=device, **shown)


class _Plain(float):
    """A number that a sentence shows as 1280, not as 1.28e+03."""

    def __format__(self, spec: str) -> str:
        text = super().__format__(spec)
        return f"{float(text):.0f}" if "e+" in text else text
