"""What the demo came to."""

from dataclasses import dataclass
from pathlib import Path

from scipy.stats import binomtest

from lerobot_pneutac.reports.demo import demo_page
from lerobot_pneutac.reports.page import Report
from lerobot_pneutac.verbs.result import Result
from pneutac_sim.twin import Twin


@dataclass(frozen=True)
class DemoResult(Result):
    """What the demo came to.

    Attributes:
        out: its folder.
        state: stage name to its numbers, seconds and commands.
    """

    out: Path
    state: dict
    title = "A twin learns what its finger lacked, and a policy flips the switch"

    @property
    def success_ci95(self) -> tuple[float, float]:
        """Wilson's 95 % interval of the success rate, percent."""
        e = self.state["evaluate"]
        interval = binomtest(e["successes"], e["trials"]).proportion_ci(method="wilson")
        return 100 * interval.low, 100 * interval.high

    @property
    def sentence(self) -> str:
        """What was found, how the error fell, what the policy does."""
        found, e = self.state["diagnose"]["selected"], self.state["evaluate"]
        lo, hi = self.success_ci95
        before, after = self.state["twin"]["tip_error_mm"], self.state["add"]["tip_error_mm"]
        noise = self.state["add"]["noise_mm"]
        left = max(after**2 - noise**2, 0.0) ** 0.5
        rate = f"{e['success_percent']:.0f} %, 95 % interval {lo:.0f} to {hi:.0f}"
        return (
            f"The finger moves as with {' and '.join(found)}, which its twin lacked; with this the held-out "
            f"tip error fell from {before:.2f} to {after:.2f} mm. Beside the noise of {noise:.2f} mm, "
            f"{left:.2f} mm are not explained. "
            "Trained on demonstrations of the corrected twin, the policy flipped the switch in "
            f"{e['successes']} of {e['trials']} starts that it had not seen ({rate})."
        )

    @property
    def next_commands(self) -> list[str]:
        """Commands to try next; the last one opens the twin as it was before anything was added."""
        return [
            f"pneutac diagnose --twin={self.out}/twin --recording={self.out}/bench/finger --out=outputs/rest",
            f"pneutac render --twin={self.out}/twin --pressure_kpa=[0,15] --out=outputs/render",
            "python -m pneutac_datasets.generate --effect=hysteresis --seed=7 --out=outputs/hysteresis",
            f"pneutac studio --twin={self.out}/before --recording={self.out}/bench/finger "
            f"--demonstrations={self.out}/demonstrations "
            f"--policy={self.out}/train/checkpoints/last/pretrained_model",
        ]

    def subject(self) -> tuple[Twin, Path]:
        """The corrected twin, and what it was measured by."""
        return Twin.load(self.out / "twin"), self.out / "bench/finger"

    def content(self) -> dict:
        s = self.state
        return {
            "tip_error_mm": {"before": s["twin"]["tip_error_mm"], "after": s["add"]["tip_error_mm"]},
            "noise_mm": s["add"]["noise_mm"],
            "selected": s["diagnose"]["selected"],
            "success_percent": s["evaluate"]["success_percent"],
            "success_ci95": list(self.success_ci95),
            "trials": s["evaluate"]["trials"],
            "final_loss": s["train"]["losses"][-1],
            "seconds": {name: stage["seconds"] for name, stage in s.items() if name != "options"},
        }

    def page(self) -> Report:
        return demo_page(self)
