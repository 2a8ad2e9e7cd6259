"""`pneutac measure`: drives a pressure program at the bench and writes what finger and gel did."""

from rich.console import Console

from lerobot_pneutac.cli.options import parse_options
from lerobot_pneutac.diagnosis.hands import instructions
from lerobot_pneutac.measuring.camera import calibrate_camera
from lerobot_pneutac.measuring.options import MeasureConfig
from lerobot_pneutac.verbs.measure import TrialNote, kept_trials, measure, program_of
from lerobot_robot_pneutac.hardware.parts import HardwareFault
from pneutac_sim.errors import InputError

MOST_UNSEEN = 0.2  # share of a trial's images without the tip marker above which it is told
MOST_MISSED = 0.1  # share of a trial's samples for which the cameras were too slow, likewise


def main(argv: list[str]) -> None:
    """Runs the verb."""
    config, console = parse_options(MeasureConfig, argv), Console()
    if config.chessboard is not None:
        camera, views = calibrate_camera(config.chessboard, config.corners, config.square_mm)
        camera.save(config.intrinsics)
        console.print(
            f"{config.intrinsics}: {views} photographs, error {camera.rms_px:.2f} px", highlight=False
        )
        return
    trials = 0

    def start(number: int, seconds: float) -> None:
        nonlocal trials
        trials = number
        console.print(f"{trials} trials, {seconds / 60:.1f} min; Ctrl-C keeps those that are finished.")

    def show(note: TrialNote) -> None:
        what = "kept" if note.seen else "left out"
        console.print(f"trial {note.number + 1} of {trials}, {note.program}: {what}", highlight=False)
        unseen, missed = 1 - note.seen / note.taken, 1 - note.taken / note.planned
        if unseen > MOST_UNSEEN:
            console.print(f"[yellow]note:[/] the tip marker was unseen in {100 * unseen:.0f} % of it")
        if missed > MOST_MISSED:
            console.print(
                f"[yellow]note:[/] {100 * missed:.0f} % of its samples are missing, the camera is slower than"
                " --hz"
            )

    for sentence in dict.fromkeys(s for t in program_of(config) for s in instructions({}, t.conditions)):
        console.print(f"[yellow]first:[/] {sentence}", highlight=False)
        if console.is_terminal:
            console.input("Then press Enter: ")
    try:
        measure(config, start, show)
    except HardwareFault as e:
        raise InputError(str(e)) from e
    finally:
        kept = len(kept_trials(config.out))
        if kept:
            console.print(f"{config.out}: {kept} of {trials} trials", highlight=False)
        elif trials:
            console.print("No trial was finished; nothing is kept.")
