"""What a search may try on demonstrations: late commands and air, or what moves the body."""

from collections.abc import Sequence

from lerobot_pneutac.diagnosis.search import Trial
from lerobot_pneutac.study.demonstration_model import DemonstrationModel, Fitter, Form


class DemonstrationSpace:
    """What a search may try on demonstrations, see `diagnosis.search.Space`.

    Args:
        fitter: fits models.
        base: the twin as it is.
        candidates: effects.
        columns: of the residual that count: those of the air, or touch.
    """

    def __init__(self, fitter: Fitter, base: DemonstrationModel, candidates: Sequence[str], columns: slice):
        self.fitter, self.base, self.candidates, self.columns = fitter, base, candidates, columns

    def bases(self) -> list[Trial]:
        """The twin as it is."""
        return [Trial(Form(), self.base.values)]

    def with_lines(self, model: DemonstrationModel) -> list[Trial]:
        """None: late commands and air are terms like others."""
        return []

    def settle_line(self, model: DemonstrationModel) -> DemonstrationModel:
        """As it is."""
        return model

    def grow(self, model: DemonstrationModel, most: int, pairs: int) -> list[Trial]:
        """Each further effect."""
        return [
            Trial(model.form.plus(e), model.values | self.fitter.start(e))
            for e in self.candidates
            if e not in model.form.effects
        ]

    def fit(self, trial: Trial, steps: int, every: int) -> DemonstrationModel:
        """A model; a rough one where `every` is above one."""
        if not trial.form.effects:
            return self.base
        return self.fitter.fit(trial, self.columns, (2 if every > 1 else 4) * steps)

    def again(self, model: DemonstrationModel) -> Trial:
        """A model as a trial."""
        return Trial(model.form, model.values)

    def settle(self, model: DemonstrationModel) -> DemonstrationModel:
        """An accepted model, fitted to the end."""
        return self.fitter.fit(self.again(model), self.columns, 60)

    def removable(self, model: DemonstrationModel) -> tuple[str, ...]:
        """All of it."""
        return model.form.effects

    def without(self, model: DemonstrationModel, term: str) -> DemonstrationModel:
        """A model re-fitted without a term."""
        form = Form(tuple(e for e in model.form.effects if e != term))
        if not form.effects:
            return self.base
        return self.fitter.fit(Trial(form, model.values), self.columns, 40)
