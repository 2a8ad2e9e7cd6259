"""What a search may try on demonstrations: late commands and air, or what moves the body."""

from collections.abc import Callable, Sequence

from lerobot_pneutac.diagnosis.search import Scored, Trial
from lerobot_pneutac.study.demonstration_fit import Fitter
from lerobot_pneutac.study.demonstration_model import DemonstrationModel, Form


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

    def pruned(
        self,
        model: Scored,
        score: Callable[[DemonstrationModel], Scored],
        least: Callable[[float], float],
    ) -> Scored:
        """Without terms that hardly count, which must not ride on others; the weightiest first.

        Args:
            model: what a search found.
            score: of a model.
            least: rise of the mean square error by which a term counts where so much is left with it.
        """
        while terms := model.model.form.effects:
            without = {e: score(self.without(model.model, e)) for e in terms}
            weakest = min(without, key=lambda e: without[e].value)
            if without[weakest].value - model.value > least(model.value):
                model.model.form = Form(tuple(sorted(terms, key=lambda e: -without[e].value)))
                return model
            model = without[weakest]
        return model
