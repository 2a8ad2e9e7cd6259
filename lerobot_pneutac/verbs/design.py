"""The next program for the bench: what it separates, what it narrows, where it goes for the first time."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import product
from pathlib import Path
from typing import ClassVar

import numpy as np

from lerobot_pneutac.cli.options import PairOptions
from lerobot_pneutac.cli.terminal import Terminal
from lerobot_pneutac.diagnosis import thresholds as T
from lerobot_pneutac.diagnosis.design import NO_HANDS, Choice, Limits, choices, nats_between
from lerobot_pneutac.diagnosis.programs import GRAVITY, Hands, instructions, named, refuse_unused
from lerobot_pneutac.diagnosis.result import Candidate
from lerobot_pneutac.diagnosis.thresholds import LITTLE_GAIN
from lerobot_pneutac.reports.figures import pressure_traces, stacked
from lerobot_pneutac.reports.page import Report, difference, rows_of
from lerobot_pneutac.study.gel import seen_by
from lerobot_pneutac.study.pair import load_bench_pair, load_pair, no_demonstrations, same_device
from lerobot_pneutac.verbs.benches import program_columns
from lerobot_pneutac.verbs.diagnose import Diagnosis, described, load_candidates, named_terms
from lerobot_pneutac.verbs.result import Result, drive_command
from pneutac_datasets.demonstrations.reading import is_dataset
from pneutac_datasets.recording.axes import per_chamber
from pneutac_datasets.recording.gel import GelRecording
from pneutac_datasets.recording.noise import noise_floor
from pneutac_datasets.recording.pressures import usable
from pneutac_datasets.recording.recording import Recording
from pneutac_sim.effects.gel_creep import EFFECT, share_left
from pneutac_sim.effects.registry import get_effect
from pneutac_sim.errors import InputError, refuse_given
from pneutac_sim.gel.identifiability import DEEPER, DEEPEST, PLACES
from pneutac_sim.gel.indenter import Press
from pneutac_sim.gel.model import GelModel
from pneutac_sim.gel.pair import CONTACT_DISC, Earlier, PressPhotograph
from pneutac_sim.gel.photograph import Predictor
from pneutac_sim.gel.residual import ERROR_LEVELS, INDEPENDENT
from pneutac_sim.gel.sensor import branches_of
from pneutac_sim.twin import Twin


@dataclass(frozen=True)
class PressChoice:
    """One press, and its expected information."""

    press: Press  # which indenter, where and how deep
    rivals: float  # nats about which candidate is true
    images: tuple[np.ndarray, ...]  # what each candidate predicts, uint8 (H, W, 3)


def press_choices(data: GelRecording, models: Sequence[Candidate]) -> list[PressChoice]:
    """Presses of the recording's indenters at nine places, the most informative first.

    Each is as deep as the shallowest, the middle and the deepest press, and deeper. What a model leaves over
    is smooth over a contact, so that a photograph counts as `INDEPENDENT` pixels with errors of
    `ERROR_LEVELS`; two models' images differ as in the mean over the contact.
    """
    predictors = [Predictor(seen_by(GelModel.from_twin(m.twin), data), data.presses) for m in models]
    probability = np.array([m.probability for m in models])
    width, height = (n / data.px_per_mm for n in data.rest.shape[1::-1])
    depths = np.sort([s.press.depth_mm for s in data.samples])
    deeper = max(min(DEEPER * depths[-1], DEEPEST * data.thickness_mm), depths[-1])
    each = dict.fromkeys(np.round([depths[0], depths[len(depths) // 2], depths[-1], deeper], 2).tolist())
    tools = {(s.press.indenter, s.press.size_mm): s.press for s in data.samples}
    found = []
    for tool, x, y, depth in product(tools.values(), PLACES, PLACES, each):
        press = replace(tool, x_mm=round(x * width, 1), y_mm=round(y * height, 1), depth_mm=depth)
        images = [p.image(press, data.rest, clock=1.0) for p in predictors]  # it comes last
        near = PressPhotograph(press, data.rest, data.rest).near(data.px_per_mm)
        seen = [i[near].astype(float) / np.sqrt(near.sum()) for i in images]
        nats = nats_between(seen, probability, INDEPENDENT / ERROR_LEVELS**2)
        found.append(PressChoice(press, nats, tuple(images)))
    return sorted(found, key=lambda c: -c.rivals)


HOLDS_S, WAITS_S = (10.0, 30.0, 60.0), (3.0, 10.0, 30.0)  # by hand, three seconds at least
SHORT_S = 2.0  # the second press


@dataclass(frozen=True)
class HeldChoice:
    """A long press, and a short one after it that is photographed."""

    first: Press  # held for `hold_s`, then lifted
    hold_s: float  # how long
    wait_s: float  # from its release to the second press
    press: Press  # the second, as far from the first as the window allows, photographed after `SHORT_S`
    share: float  # of the first that is left in the photograph
    levels: float  # root mean square that it changes where the first was
    rivals: float  # nats about whether the gel creeps
    assumed: bool  # whether the creep is the effect's default, as no candidate model has one

    @property
    def seen(self) -> bool:
        return self.rivals > T.LITTLE_GAIN

    @property
    def sentence(self) -> str:
        a, b = self.first, self.press
        whose = "a gel" if self.assumed else "the gel of the likeliest model with creep,"
        do = (
            f"To find whether it creeps, hold the {a.indenter} of {a.size_mm:g} mm {a.depth_mm:g} mm deep at "
            f"x {a.x_mm:g}, y {a.y_mm:g} mm for {self.hold_s:g} s and lift it; {self.wait_s:g} s later press "
            f"it {b.depth_mm:g} mm deep at x {b.x_mm:g}, y {b.y_mm:g} mm and photograph"
        )
        why = (
            f"on {whose} that still holds {100 * self.share:.1f} % of the first press then, that one's place "
            f"changes by {self.levels:.1f} levels, {self.rivals:.2f} nats of information on whether it creeps"
        )
        if not self.seen:
            return f"{do}; but {why}, too little to see."
        return f"{do}: {why}. A longer hold leaves more, a longer wait less. Fill in time_s and hold_s."

    def rows(self) -> list[tuple[Press, float, float]]:
        """Each press with `time_s` and `hold_s` of its photograph."""
        after = self.hold_s + self.wait_s + SHORT_S
        return [(self.first, self.hold_s, self.hold_s), (self.press, after, SHORT_S)]


def held_choice(data: GelRecording, models: Sequence[Candidate]) -> HeldChoice:
    """The two presses, of the recording's deepest and shallowest; models come with the likeliest first."""
    gels = [GelModel.from_twin(m.twin) for m in models]
    creeping = [bool(branches_of(gel)) for gel in gels]
    gel = seen_by(gels[creeping.index(True) if any(creeping) else 0], data)
    without = {n: v for n, v in gel.effects.items() if not getattr(get_effect(n), "late", None)}
    if not any(creeping):
        gel = replace(
            gel, effects=gel.effects | {EFFECT.name: {p.name: p.default for p in EFFECT.parameters}}
        )
    branches, pairs = branches_of(gel), data.presses
    left = {
        (hold, wait): share_left(branches, hold, wait + SHORT_S) for hold, wait in product(HOLDS_S, WAITS_S)
    }
    enough = T.HOLD_ENOUGH * max(left.values())
    hold, wait = min((k for k, share in left.items() if share >= enough), key=lambda k: (sum(k), k))
    predictors = [Predictor(g, pairs) for g in (gel, replace(gel, effects=without))]
    deepest = max((s.press for s in data.samples), key=lambda p: p.depth_mm)
    shallow = min((s.press for s in data.samples), key=lambda p: p.depth_mm)
    width, height = gel.window_mm
    tried = []
    for x, y in product(PLACES, PLACES):
        at = {"x_mm": round(x * width, 1), "y_mm": round(y * height, 1)}
        away = {"x_mm": round(-(x or PLACES[0]) * width, 1), "y_mm": round(-(y or PLACES[0]) * height, 1)}
        first, then = replace(deepest, **at), replace(shallow, **away)
        earlier = [Earlier(first, hold, wait + SHORT_S)]
        there = PressPhotograph(first, data.rest, data.rest).near(data.px_per_mm, CONTACT_DISC)
        seen = [p.image(then, data.rest, 1.0, earlier)[there].astype(float) for p in predictors]
        levels = float(np.sqrt(np.mean(np.square(seen[0] - seen[1]))))
        tried.append((levels, first, then, [s / np.sqrt(there.sum()) for s in seen]))
    levels, first, then, each = max(tried, key=lambda t: t[0])
    yes = sum(m.probability for m, c in zip(models, creeping, strict=True) if c) if any(creeping) else 0.5
    nats = nats_between(each, np.array([yes, 1 - yes]), INDEPENDENT / ERROR_LEVELS**2)
    return HeldChoice(first, hold, wait, then, left[hold, wait], levels, nats, not any(creeping))


SHOWN = 8
PROGRAM = ("max_kpa", "min_kpa", "budget_s", "program_s", "hz", "hands", "payload_g", "warm_c")


@dataclass(frozen=True, eq=False, kw_only=True, repr=False)
class Design(Result):
    """Programs for the bench, by expected information for their time."""

    twin: Twin  # that was diagnosed
    recording: Recording  # that was diagnosed
    contenders: tuple[Candidate, ...]  # candidate models
    choices: tuple[Choice, ...]  # see `lerobot_pneutac.diagnosis.design`
    noise: float  # floor of the error
    unit: str  # of it
    hands: Hands = NO_HANDS  # what could be changed

    heading = "The next experiment"
    keys = (
        ("program", "best.name"), ("kind", "best.kind"), ("hand", "best.hand"), ("seconds", "best.seconds"),
        ("nats_between_models", "best.rivals"), ("nats_about_constants", "best.constants"),
        ("share_where_nothing_was", "best.new"), ("tells_little", "best.tells_little"), "sentence",
    )  # fmt: skip

    @property
    def best(self) -> Choice:
        return self.choices[0]

    @property
    def sentence(self) -> str:
        c = self.best
        if c.tells_little:
            nothing = "No program within these limits would show anything new"
            return f"{nothing}; allow higher pressures or longer programs."
        likely = self.contenders[0]
        first = "".join(f"{s} " for s in instructions(self.hands.usual, c.conditions))
        best = f"{named_terms(likely)} has {100 * likely.probability:.0f} %"
        decides = c.rivals >= max(np.log(len(self.contenders)) / 2, 1e-9)
        purpose = "decides between them" if decides else "sharpens the constants of the first"
        gain = f"{c.rivals:.2f} nats between models, {c.constants:.1f} nats on constants"
        return (
            f"{first}Next, drive {c.name} ({c.seconds:.0f} s). Of {len(self.contenders)} candidate models "
            f"{best}; this test mainly {purpose}. Expected information: {gain}; "
            f"{100 * c.new:.0f} % of its time is at pressures that no recording has."
        )

    def rows(self) -> list[dict]:
        columns = {"program": "name", "s": "{0.seconds:.0f}", "nats between models": "{0.rivals:.2f}"}
        columns |= {"about constants": "{0.constants:.1f}", "new": "{0.new:.0%}"}
        return rows_of(self.choices[:SHOWN], columns)

    def next_after(self, out: Path | None) -> str:
        return drive_command(out)

    def content(self) -> dict:
        return super().content() | {"contenders": described(self.contenders)}

    def tables(self) -> dict[str, dict]:
        return {"program.csv": program_columns(self.best)}

    def page(self) -> Report:
        page, best = self.lead_page(), self.best
        figure = stacked((f"predicted, {self.unit}", "pressure, kPa"), (0.7, 0.3))
        # Of the predicted columns the one in which the models differ most.
        spread = np.std(np.stack(best.predictions), axis=0).max(axis=0)
        for c, seen in zip(self.contenders, best.predictions, strict=True):
            name = f"{c.probability:.0%}: {named_terms(c)}"
            figure.add_scatter(x=best.time_s, y=seen[:, spread.argmax()], name=name[:60], row=1, col=1)
        for trace in pressure_traces(best.time_s, best.pressure_kpa):
            figure.add_trace(trace, 2, 1)
        what = "What each model predicts, with its probability before the program, and the program."
        page.figure(figure, what, 520)
        page.table(self.rows(), "The programs with the most information for their time.")
        return page


def design(
    twin: Twin,
    recording: Recording,
    diagnosis: str | Path | Diagnosis,
    max_kpa: float | Sequence[float] | None = None,
    min_kpa: float | Sequence[float] | None = None,
    budget_s: float = 600.0,
    program_s: float = 60.0,
    hz: float = 20.0,
    hands: Hands = NO_HANDS,
) -> Design:
    """Chooses the next program for a recording that was diagnosed.

    Args:
        twin: that was diagnosed.
        recording: likewise; everything that was measured so far.
        diagnosis: what `diagnose` found, itself or the folder that `pneutac diagnose --out=` wrote.
        max_kpa: highest set-point, one for all chambers or one for each; if omitted, that of the recording.
        min_kpa: lowest one, likewise; if omitted, that of the recording, at most 0.
        budget_s: longest program.
        program_s: length of a program of the common kinds.
        hz: samples a second.
        hands: what may be changed for it.

    Raises:
        InputError: the folder holds no diagnosis of a body, or no program fits the limits.
    """
    if recording.device == "gel":
        raise InputError(f"{recording.folder} is of a gel; `design_press` chooses its next press.")
    contenders = load_candidates(diagnosis)
    if not contenders:
        raise InputError("The diagnosis is of demonstrations; give one of a bench recording.")
    recording = usable(recording)[0]  # no program goes beyond the supply by itself
    command = recording.commands
    low = np.minimum(command.min(axis=0), 0.0) if min_kpa is None else min_kpa
    high = command.max(axis=0) if max_kpa is None else max_kpa
    ends = (per_chamber(n, v, len(command.T)) for n, v in (("min_kpa", low), ("max_kpa", high)))
    limits = Limits(*ends, hz, budget_s, program_s)
    floor = noise_floor(recording)
    noise = floor.needed(recording.folder)
    ranked = choices(recording, contenders, noise, limits, hands)
    found = {"contenders": tuple(contenders), "choices": tuple(ranked), "noise": noise}
    return Design(twin=twin, recording=recording, unit=floor.unit, hands=hands, **found)


@dataclass(frozen=True, eq=False, kw_only=True, repr=False)
class PressDesign(Result):
    """Presses for a gel, the most informative first; see `lerobot_pneutac.verbs.design`."""

    twin: Twin  # that was diagnosed
    recording: Recording  # that was diagnosed
    contenders: tuple[Candidate, ...]  # candidate models
    choices: tuple[PressChoice, ...]
    held: HeldChoice  # the two presses with the most information on creep

    heading = "The next press"
    keys = (("nats_between_models", "best.rivals"), "tells_little", "sentence")

    @property
    def best(self) -> PressChoice:
        return self.choices[0]

    @property
    def tells_little(self) -> bool:
        return self.best.rivals < LITTLE_GAIN

    @property
    def held_first(self) -> bool:
        """Whether a candidate model has creep, and two presses show more of it than any one."""
        return not self.held.assumed and self.held.rivals > max(self.best.rivals, LITTLE_GAIN)

    @property
    def sentence(self) -> str:
        if self.held_first:
            return self.held.sentence
        if self.tells_little:
            other = "press another shape, such as an edge or a small cylinder, and diagnose again"
            return f"No press of these indenters would distinguish the candidate models; {other}."
        p, likely = self.best.press, self.contenders[0]
        where = f"{p.depth_mm:g} mm deep at x {p.x_mm:g}, y {p.y_mm:g} mm"
        gain = f"{self.best.rivals:.2f} nats between {len(self.contenders)} models"
        best = f"{named_terms(likely)} is the likeliest ({100 * likely.probability:.0f} %)"
        return f"Press the {p.indenter} of {p.size_mm:g} mm {where}: {gain}, of which {best}."

    def rows(self) -> list[dict]:
        columns = {"indenter": "{0.press.indenter}, {0.press.size_mm:g} mm"}
        columns |= {f"{n}, mm": f"{{0.press.{n}_mm:g}}" for n in ("x", "y", "depth")}
        return rows_of(self.choices[:SHOWN], columns | {"nats between models": "{0.rivals:.2f}"})

    def remarks(self) -> list[str]:
        return [] if self.held_first else [self.held.sentence]

    def content(self) -> dict:
        held = self.held
        creep = {"presses": self._held_rows(), "wait_s": held.wait_s, "share_left": held.share}
        creep |= {"levels": held.levels, "nats": held.rivals, "assumed": held.assumed}
        out = super().content() | {"press": _row(self.best.press)}
        creep["first"] = self.held_first
        return out | {"creep": creep, "contenders": described(self.contenders)}

    def _held_rows(self) -> list[dict]:
        return [_row(p) | {"time_s": t, "hold_s": hold} for p, t, hold in self.held.rows()]

    def tables(self) -> dict[str, list[dict]]:
        """A row a press as a gel's recording has it."""
        return {"press.csv": self._held_rows() if self.held_first else [_row(self.best.press)]}

    def page(self) -> Report:
        page, images = super().page(), self.best.images
        names = [f"{100 * c.probability:.0f} % {named_terms(c)}" for c in self.contenders]
        page.image(np.concatenate(images, axis=1), f"What each model predicts: {', '.join(names)}.")
        others = [difference(image, images[0], 4.0) for image in images[1:]]
        if others:
            page.image(np.concatenate(others, axis=1), "The others less the first, four times exaggerated.")
        return page


def design_press(twin: Twin, recording: Recording, diagnosis: str | Path | Diagnosis) -> PressDesign:
    """Chooses the next press for a gel's recording that was diagnosed.

    Args:
        twin: that was diagnosed.
        recording: likewise; all photographs so far.
        diagnosis: what `diagnose` found, itself or the folder that `pneutac diagnose --out=` wrote.

    Raises:
        InputError: the recording is of no gel, the folder holds no diagnosis, or one of a body.
    """
    same_device(twin, recording, "the twin", "design for")
    contenders, data = load_candidates(diagnosis), GelRecording.load(recording)
    found = {"choices": tuple(press_choices(data, contenders)), "held": held_choice(data, contenders)}
    return PressDesign(twin=twin, recording=recording, contenders=tuple(contenders), **found)


def _row(p: Press) -> dict:
    size = "indenter_size_mm" if p.indenter in ("cube", "edge") else "indenter_radius_mm"
    return {"indenter": p.indenter, size: p.size_mm, "x_mm": p.x_mm, "y_mm": p.y_mm, "depth_mm": p.depth_mm}


@dataclass
class DesignConfig(PairOptions):
    """Options of `pneutac design`.

    Attributes:
        twin: folder of the twin that was diagnosed.
        recording: folder of the recording that was diagnosed, or its tables; or of a LeRobotDataset of
            demonstrations, or its name on the Hub, for which the next motions of the arm are chosen.
        out: folder for `program.csv` (of a gel `press.csv`), `result.json` and `report.html`; nothing is
            written without it.
    """

    described_by: ClassVar = design

    diagnosis: Path | None = None  # folder that `pneutac diagnose --out=` wrote; demonstrations need none
    max_kpa: float | tuple[float, ...] | None = None
    min_kpa: float | tuple[float, ...] | None = None
    budget_s: float = 600.0
    program_s: float = 60.0
    hz: float = 20.0
    # what may be changed for it: `none`, or `flip` (turn the base over), `payload` (hang a weight at the tip)
    # and `warm`, with commas
    hands: str = "none"
    payload_g: float = 20.0  # weight that can be hung
    warm_c: float = 35.0  # to which the finger can be warmed

    def __post_init__(self):
        for name in ("budget_s", "program_s", "hz", "payload_g"):
            if not 0 < getattr(self, name) < float("inf"):
                raise InputError(f"{name}={getattr(self, name)} must be positive.")
        refuse_unused(self)


def command(cfg: DesignConfig, terminal: Terminal) -> None:
    if is_dataset(cfg.recording):
        from lerobot_pneutac.verbs.design_motion import design_motion  # MuJoCo, which benches do not need

        refuse_given(cfg, PROGRAM, "is of a bench's program, not of demonstrations")
        if cfg.diagnosis:
            raise InputError("diagnosis: motions are chosen by the twin alone; leave it out.")
        twin, shown = load_pair(cfg.twin, cfg.recording, "design by", cfg.task, cfg.station)
        return terminal.finish(terminal.run(design_motion, twin, shown), cfg.out)
    no_demonstrations(cfg.recording, cfg.task, cfg.station)
    twin, recording = load_bench_pair(cfg.twin, cfg.recording, "design by")
    if cfg.diagnosis is None:
        raise InputError("Give the folder that `pneutac diagnose --out=DIR` wrote, as --diagnosis=DIR.")
    if recording.device == "gel":
        refuse_given(cfg, PROGRAM, "is of a bench's program, not of a gel's press")
        return terminal.finish(design_press(twin, recording, cfg.diagnosis), cfg.out)
    usual = {
        c: float(recording.column(c)[0]) for c in (*GRAVITY, "payload_g", "temperature_c") if recording.has(c)
    }
    hands = Hands.of(named(cfg.hands), usual, cfg.payload_g, cfg.warm_c)
    limits = (cfg.max_kpa, cfg.min_kpa, cfg.budget_s, cfg.program_s, cfg.hz)
    return terminal.finish(design(twin, recording, cfg.diagnosis, *limits, hands), cfg.out)
