"""What a diagnosis tells, whatever the device."""

from lerobot_pneutac.verbs.result import Result


class Diagnosis(Result):
    """What a twin lacks to explain a recording.

    Attributes:
        verdict: `adequate`, `missing_effect`, `insufficient_form`, `unknown_effect` or `ambiguous`.
        selected: effects found, the most important first.
        next_experiment: what to record next.
    """

    verdict: str
    selected: list[str]
    next_experiment: str
