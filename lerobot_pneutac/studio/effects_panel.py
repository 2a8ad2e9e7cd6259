"""Effects as switches, with sliders of their parameters inside what physics allows. Nothing is written."""

from collections.abc import Callable, Iterable, Mapping

import numpy as np
import viser

from pneutac_sim.effects.effect import Effect, Parameter
from pneutac_sim.effects.registry import get_effect
from pneutac_sim.twin import Value

STEPS = 400  # of a slider
DECADES = 10.0  # a positive parameter may be so many times larger or smaller than it is


class EffectsPanel:
    """A folder with switches of some effects."""

    def __init__(self, gui: viser.GuiApi, title: str):
        self._gui, self._place, self._folder = gui, gui.add_folder(title, expand_by_default=False), None
        self._rows: list[_Switch] = []

    def fill(
        self,
        names: Iterable[str],
        present: Mapping[str, Mapping[str, Value]],
        range_kpa: float,
        changed: Callable[[], None],
    ) -> None:
        """Switches of effects, with the values `present` in the twin; `range_kpa` scales their bounds."""
        if self._folder is not None:
            self._folder.remove()
        with self._place:
            self._folder = self._gui.add_folder("switched on here alone; nothing is written")
        with self._folder:
            self._rows = [
                _Switch(self._gui, get_effect(n), present.get(n), range_kpa, changed) for n in names
            ]

    def values(self) -> dict[str, dict[str, Value]]:
        return {row.effect.name: row.values() for row in self._rows if row.on}


class _Switch:
    def __init__(self, gui, effect: Effect, values: Mapping[str, Value] | None, range_kpa: float, changed):
        self.effect = effect
        start = effect.start(range_kpa) | dict(values or {})
        defaults = {k: v.value for k, v in effect.start().items()}
        about = effect.describe(defaults, "device").partition(". ")[0]
        self._box = gui.add_checkbox(effect.name.replace("_", " "), values is not None, hint=about)
        self._fixed = {k: v for k, v in start.items() if k not in {p.name for p in effect.parameters}}
        self._sliders = {
            p.name: _slider(gui, p, start[p.name], range_kpa, values is not None) for p in effect.parameters
        }

        def switched(_) -> None:
            for slider in self._sliders.values():
                slider.visible = self._box.value
            changed()

        self._box.on_update(switched)
        for slider in self._sliders.values():
            slider.on_update(lambda _: changed())

    @property
    def on(self) -> bool:
        return self._box.value

    def values(self) -> dict[str, Value]:
        return self._fixed | {name: Value(float(s.value)) for name, s in self._sliders.items()}


def interval(parameter: Parameter, value: float, range_kpa: float) -> tuple[float, float]:
    """Between which values a parameter may be moved by hand: its bounds, or a decade about it."""
    _, low, high = parameter.limits(range_kpa)
    if parameter.log:
        low, high = max(low, value / DECADES), min(high, value * DECADES)
    return min(low, value), max(high, value)


def _slider(gui, parameter: Parameter, value: Value, range_kpa: float, visible: bool):
    low, high = interval(parameter, value.value, range_kpa)
    known = "" if value.ci95 is None else " Fitted: 95 % interval {:.4g} to {:.4g}.".format(*value.ci95)
    step = float(10.0 ** np.floor(np.log10((high - low) / STEPS)))
    name = parameter.name.removesuffix("_" + parameter.name.rpartition("_")[2]) if parameter.unit else ""
    unit = f"{name or parameter.name}, {parameter.unit or 'ratio'}".replace("_", " ")
    hint = f"From {low:.4g} to {high:.4g} {parameter.unit}.{known}"
    return gui.add_slider(unit, low, high, step, float(value.value), hint=hint, visible=visible)
