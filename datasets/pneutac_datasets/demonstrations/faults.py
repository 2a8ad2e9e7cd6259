"""Everything in demonstrations that `augment` or a training would refuse, at once and without the images."""

import difflib
from functools import cached_property
from pathlib import Path

import numpy as np

from pneutac_datasets.recording.sensors import stretches
from pneutac_sim.dataset_files import ACTION, NOT_FINITE, OWN, ROBOT, STATE, Files, leave_out
from pneutac_sim.errors import InputError, shown
from pneutac_sim.features import (
    CHAMBERS,
    IMAGE_NAME,
    POINTS_KEY,
    PRESSURES,
    VELOCITY_NAMES,
    Places,
    action_names,
    chamber_count,
    joint_count,
    state_names_like,
)
from pneutac_sim.gel.contact import without_specks
from pneutac_sim.gel.model import GelModel
from pneutac_sim.pace import DONE, OUTCOME_FILE, pace_notes, read_outcomes
from pneutac_sim.twin import Twin
from pneutac_sim.world.scene import SCENE_CAMERAS
from pneutac_sim.world.station import Station

TACTILE = f"observation.images.{IMAGE_NAME}"
# Which demonstrations may have too.
FURTHER = (f"observation.{POINTS_KEY}", *(f"observation.images.{name}" for name in SCENE_CAMERAS))
AREA_NAME = "contact_area.pos"
UNTOUCHED = f"never touches anything ({AREA_NAME} is 0 throughout)"
ROUNDING_KPA = 0.01  # share of the range by which a command may be beyond it
MOST_SPEED_M_S = 0.45  # of the flange between two frames, four times the fastest that is commanded
LEAST_KPA = 0.5  # travel of a command of pressure that a gauge must show
WINDOW_S, MOVES_MM = 0.5, 3.0  # over which motion and command are compared; the least that is compared
SLIGHT = 0.1  # ratio of motion and command below which one of the two is missing
LEAST_FOLLOWING = 0.5  # correlation of motion and command; the stand-in's, which lags, is above 0.95
MOST_FACTOR, NOTED_FACTOR = 3.0, 1.5  # of motion and command: more is refused, or noted
MOST_RAD = 8.0  # of a joint; robots turn by one turn and a little
# Of a training: frames that a policy plans ahead by default (ACT), the share of episodes that may be shorter,
# and the shares of an episode with one unchanged action and of all frames at a limit that are noted.
CHUNK, MOST_SHORT, MOST_FROZEN, MOST_AT_LIMIT = 100, 0.1, 0.05, 0.5
OFF_MM, MOST_POSES = 10.0, 500  # by which joints and flange may disagree, and how many frames are compared


class Recorded(Files):
    """Recorded demonstrations, each file of which is opened once and without the images.

    Raises InputError where there is no dataset, or its `info.json` is damaged.
    """

    @cached_property
    def episodes(self) -> dict[int, tuple[np.ndarray, np.ndarray]]:
        """Number to state (T, S) and action (T, A); raises InputError where the dataset is damaged."""
        self.refuse_damaged()
        episode, state, action = (self.rows[key] for key in ("episode_index", STATE, ACTION))
        return {int(e): (state[episode == e], action[episode == e]) for e in np.unique(episode)}

    @property
    def chambers(self) -> int:
        return self.info["features"][ACTION]["shape"][0] - len(VELOCITY_NAMES)

    @property
    def joints(self) -> int:
        """Of the arm, by the length of the state."""
        return joint_count(self.info["features"][STATE]["shape"][0], self.chambers)

    @cached_property
    def failed(self) -> dict[int, str]:
        """Demonstrations that nothing can be learnt from: number of the episode to why it failed.

        Those that `meta/outcomes.json` calls failed, and those without touch. Raises InputError where the
        dataset or `outcomes.json` is damaged.
        """
        area = self.info["features"][STATE]["names"].index(AREA_NAME)
        outcomes, failed = read_outcomes(self.folder / "meta"), {}
        if unknown := sorted(set(outcomes) - set(self.episodes)):
            raise InputError(
                f"{self.folder / 'meta' / OUTCOME_FILE} names episode{'s' * (len(unknown) > 1)}"
                f" {', '.join(map(str, unknown))}, and the dataset has the episodes 0 to"
                f" {max(self.episodes)}; correct the numbers, which count from 0."
            )
        for number, (state, _) in self.episodes.items():
            touch = state[:, area]
            if np.isfinite(touch).all() and not without_specks(touch).any():
                failed[number] = UNTOUCHED
            elif outcomes.get(number, DONE) != DONE:
                failed[number] = outcomes[number]
        return failed

    @property
    def used(self) -> list[int]:
        """The episodes that have not failed."""
        return [number for number in self.episodes if number not in self.failed]

    def faults(self, twin: Twin, station: Station | None = None, measured: bool = False) -> list[str]:
        """One sentence for each fault of demonstrations that are to be augmented on a twin.

        The station is where they were recorded, if omitted the paper's. `measured` are measurements of the
        finger: their rate may differ from the station's, and whether the task was done does not matter.
        """
        info, file, station = self.info, self.file, station or Station()
        chambers = CHAMBERS.get(twin.device, 1)
        found = feature_faults(info["features"], file, GelModel.from_twin(twin).rest_image.shape, chambers)
        known = not any("'fps' is" in sentence for sentence in self.damage)
        if not measured and known and info.get("fps") != station.control_hz:
            found.append(
                f"{file}: {info.get('fps')} fps, but the station's control rate is {station.control_hz} Hz;"
                " give the station.yaml that they were recorded in by --station=, or record with"
                f" --dataset.fps={station.control_hz}."
            )
        if self.damage or any(f"'{name}'" in sentence for sentence in found for name in (STATE, ACTION)):
            if (robot := info.get("robot_type")) not in (None, ROBOT):
                found.insert(
                    0, f"{file}: robot_type is {shown(robot)}; give demonstrations of a '{ROBOT}' robot."
                )
            return self.damage + found  # which numbers are which is not known
        if self.joints != station.joints:
            found.append(
                f"{file}: the arm has {self.joints} joints, and that of the station {station.joints}; give"
                " the station.yaml in which they were recorded by --station=, or lay it in the dataset's"
                " folder meta."
            )
        found += [] if measured else self.too_few()
        failed = {} if measured else self.failed
        left = {number: each for number, each in self.episodes.items() if number not in failed}
        found += _of_episodes(left, twin.pressure_range_kpa, Places.of(chambers).area)
        return found + self._motion(left)[0]

    def too_few(self) -> list[str]:
        """One sentence where fewer than two of the recorded demonstrations have not failed, else none."""
        if (left := len(self.used)) >= 2:
            return []
        without = f" besides {_named(self.failed)}" if self.failed else ""
        return [
            f"{self.folder} has {left or 'no'} demonstration{'s' * (left != 1)}{without}; augment needs two"
            " or more: record more with lerobot-record --resume=true."
        ]

    def set_aside(self) -> list[str]:
        """A sentence that names the failed demonstrations, if there are any."""
        left = f"the other {len(self.used)} are used"
        return [f"{self.folder}: set aside {_named(self.failed)}; {left}."] if self.failed else []

    def motion_faults(self) -> list[str]:
        """A sentence for each command that the flange does not follow, and for joints that are no radians."""
        return self._motion(self.episodes)[0]

    def notes(self, station: Station) -> list[str]:
        """What is poor but usable in demonstrations without faults."""
        found = self.rate_notes() + self._motion(self.episodes)[1] + self._joint_notes(station)
        return found + self._measurement_notes() + self._training_notes()

    def rate_notes(self) -> list[str]:
        """Episodes whose control loop was slower or faster than the dataset's rate."""
        fps = self.info.get("fps")
        known = isinstance(fps, int | float) and fps > 0
        return pace_notes(self.folder / "meta", float(fps)) if known else []

    def _training_notes(self) -> list[str]:
        """What a policy may learn wrongly, by the rules of lerobot-doctor (checks `episodes`, `actions`)."""
        folder, every = self.folder, [action for _, action in self.episodes.values()]
        notes, lengths, frozen = [], list(map(len, every)), []
        short = sum(n < CHUNK for n in lengths)
        if short > MOST_SHORT * len(lengths):
            notes.append(
                f"{folder}: {short} of {len(lengths)} episodes have fewer than {CHUNK} frames, which ACT"
                f" plans ahead by default; train it with --policy.chunk_size={min(lengths)}"
                f" --policy.n_action_steps={min(lengths)}."
            )
        for number, action in zip(self.episodes, every, strict=True):
            same = stretches((action[1:] == action[:-1]).all(axis=1))
            begins, end = max(same, key=lambda s: s[1] - s[0], default=(0, 0))
            if end - begins >= MOST_FROZEN * len(action):
                begins_s = begins / float(self.info["fps"])
                frozen.append(f"{number} ({end - begins} frames from {begins_s:.1f} s)")
        if frozen:
            notes.append(
                f"{folder}: the action stays the same in episode{'s' * (len(frozen) > 1)}"
                f" {', '.join(frozen)}; where the robot waits at the start of an episode a policy learns to"
                " wait: leave those frames out."
            )
        actions = np.concatenate(every).T
        for name, values in zip(self.info["features"][ACTION]["names"], actions, strict=True):
            for limit, word in ((values.min(), "lowest"), (values.max(), "highest")):
                share = float((values == limit).mean())
                if MOST_AT_LIMIT < share < 1:
                    notes.append(
                        f"{folder}: {name} is at its {word} value, {limit:g}, in {100 * share:.0f} % of the"
                        " frames; make sure that no limit cuts what was demonstrated."
                    )
        return notes

    def _measurement_notes(self) -> list[str]:
        """What `compare`, `diagnose` and `calibrate` refuse, which measure by demonstrations."""
        found, verbs = [], "compare, diagnose and calibrate refuse"
        if (robot := self.info.get("robot_type")) != ROBOT:
            what = f"robot_type is {shown(robot)}; {verbs} demonstrations of another robot than '{ROBOT}'"
            found.append(f"{self.folder}: {what}.")
        for number, each in self.episodes.items():
            if reason := unmeasurable(*each, float(self.info["fps"])):
                found.append(f"{self.folder}: in episode {number} {reason} Until then {verbs} it.")
        return found

    def _motion(self, episodes: dict[int, tuple[np.ndarray, np.ndarray]]) -> tuple[list[str], list[str]]:
        """Faults and notes where the flange does not move as it was commanded.

        Displacements in windows of half a second are compared with the integral of the commanded velocity.
        """
        folder, fps, ee = self.folder, self.info["fps"], Places.of(self.chambers).ee
        window, moved, commanded, turned = max(1, round(fps * WINDOW_S)), [], [], []
        for number, (state, action) in episodes.items():
            if np.nanmax(np.abs(state[:, : self.joints]), initial=0) > MOST_RAD:
                turned.append(number)
            if len(action) > window and np.isfinite(state).all() and np.isfinite(action).all():
                way = np.vstack([np.zeros(3), np.cumsum(action[:-1, :3], 0)]) / fps
                moved.append(state[window:, ee] - state[:-window, ee])
                commanded.append(way[window:] - way[:-window])
        faults, notes = [], []
        if turned:
            faults.append(
                f"{folder}: 'joint_1.pos' and so on go beyond {MOST_RAD:g} rad in the episodes {turned}, as"
                " degrees do; record radians."
            )
        both = (np.vstack(moved).T, np.vstack(commanded).T) if moved else ((), ())
        for name, axis, motion, command in zip(VELOCITY_NAMES, "xyz", *both, strict=False):
            moved_mm, commanded_mm = (1e3 * float(np.sqrt(np.mean(x**2))) for x in (motion, command))
            if max(moved_mm, commanded_mm) < MOVES_MM:
                continue
            begin = f"{folder}: action '{name}' and observation.state 'ee_{axis}.pos' do not fit:"
            how = (
                f"in {WINDOW_S:g} s the flange moves by {moved_mm:.3g} mm and the command asks for "
                f"{commanded_mm:.3g} mm"
            )
            if min(moved_mm, commanded_mm) < SLIGHT * max(moved_mm, commanded_mm):
                faults.append(f"{begin} {how}; record velocities in m/s and places in m, of the same axes.")
                continue
            follows = float(motion @ command / np.sqrt((motion @ motion) * (command @ command)))
            factor = float(motion @ command / (command @ command))
            if follows < LEAST_FOLLOWING:
                does = "moves against" if follows < -LEAST_FOLLOWING else "does not follow"
                remedy = "record velocities along the axes of the arm's frame"
                faults.append(f"{begin} the flange {does} the command (correlation {follows:.2f}); {remedy}.")
            elif not 1 / MOST_FACTOR < factor < MOST_FACTOR:
                faults.append(f"{begin} {how}; record velocities in m/s and places in m.")
            elif not 1 / NOTED_FACTOR < factor < NOTED_FACTOR:
                loop = f"Was the loop {'faster' if factor < 1 else 'slower'} than the dataset's {fps:g} fps"
                far = f"the flange moves {factor:.2g} times as far as commanded"
                notes.append(f"{begin} {far}. {loop}, or was the arm held back?")
        return faults, notes

    def _joint_notes(self, station: Station) -> list[str]:
        """A note where the joints of the station's arm put the flange elsewhere than the state says."""
        states = np.vstack([state for state, _ in self.episodes.values()])
        if self.joints != station.joints or not np.isfinite(states).all():
            return []
        rows = states[np.linspace(0, len(states) - 1, min(len(states), MOST_POSES)).astype(int)]
        solver, ee = station.make_arm().solver(), rows[:, Places.of(self.chambers).ee]
        off_mm = 1e3 * np.linalg.norm([solver.pose(q)[1] for q in rows[:, : self.joints]] - ee, axis=1)
        if np.median(off_mm) < OFF_MM:
            return []
        arm = station.arm if isinstance(station.arm, str) else Path(station.arm.urdf).name
        return [
            f"{self.folder}: the joint angles put the flange of '{arm}' {np.median(off_mm):.3g} mm away from"
            " ee_x.pos, ee_y.pos, ee_z.pos. Check the joints' zeros, order and signs, or give the station of"
            " the arm by --station=."
        ]


def _named(failed: dict[int, str]) -> str:
    """The failed episodes by their reasons."""
    by_reason: dict[str, list[int]] = {}
    for number, why in failed.items():
        by_reason.setdefault(why, []).append(number)
    return ", ".join(
        f"episode{'s' * (len(which) > 1)} {', '.join(map(str, which))} ({why})"
        for why, which in by_reason.items()
    )


def unmeasurable(state: np.ndarray, action: np.ndarray, fps: float) -> str:
    """Why an episode of state (T, S) and action (T, 4) is no measurement; empty where it is one."""
    places = Places.of(action.shape[1] - len(VELOCITY_NAMES))
    step_m = np.linalg.norm(np.diff(state[:, places.ee], axis=0), axis=1)
    if step_m.max() > MOST_SPEED_M_S / fps:
        return (
            f"the flange jumps by {1e3 * step_m.max():.0f} mm at {step_m.argmax() / fps:.1f} s, as where"
            " frames were lost or the scene was started afresh; leave it out with lerobot-edit-dataset."
        )
    gauge = state[:, places.pressure]
    if np.ptp(action[:, PRESSURES]) > LEAST_KPA and np.ptp(gauge) < 1e-6:
        return (
            f"pressure.pos stays at {gauge.ravel()[0]:g} kPa while the command moves; log the gauge of the"
            " chamber, or leave the episode out."
        )
    return ""


def feature_faults(
    features: dict, file: Path, image_shape: tuple[int, ...] | None = None, chambers: int | None = None
) -> list[str]:
    """One sentence for each feature that is no demonstration's.

    `image_shape` is that of the twin's sensor and `chambers` its finger's; None for those of the dataset.
    """
    wanted = [STATE, ACTION, TACTILE]
    found = [
        f"{file}: feature '{key}' is missing{_close(key, features)}; record it with this robot."
        for key in wanted
        if key not in features
    ]
    if more := [k for k in features if k not in (*wanted, *FURTHER, *OWN)]:
        found.append(
            f"{file}: feature {', '.join(more)} is none of a demonstration's; take it out with"
            " lerobot-edit-dataset --operation.type=remove_feature."
        )
    for key in (key for key in (STATE, ACTION) if key in features):
        there, shape = features[key].get("names"), features[key].get("shape")
        if not (isinstance(there, list) and all(isinstance(n, str) for n in there)):
            found.append(
                f"{file}: '{key}' has the names {shown(there)}; write one list of the numbers' names,"
                f" {list(state_names_like([]) if key == STATE else action_names(1))}."
            )
            continue
        count = chamber_count(there)
        names = list(state_names_like(there) if key == STATE else action_names(count))
        missing = [f"'{n}'{_close(n, there)}" for n in names if n not in there]
        if chambers not in (None, count):
            found.append(
                f"{file}: '{key}' has {count} pressure{'s' * (count > 1)} and the twin {chambers}"
                f" chamber{'s' * (chambers > 1)}; give the twin of the body that was recorded."
            )
        elif there != names:
            what = f"lacks {', '.join(missing)}" if missing else f"has the names {there} in another order"
            found.append(f"{file}: '{key}' {what}; it must have {names}.")
        elif shape not in ([len(names)], (len(names),)):
            text = f"'{key}' has {len(names)} names and the shape {shown(shape)}"
            found.append(f"{file}: {text}; it must be [{len(names)}].")
    shape = tuple((features.get(TACTILE) or {}).get("shape", image_shape or (1, 1, 3)))
    if len(shape) == 3 and shape[0] == 3 and shape[2] != 3:
        found.append(
            f"{file}: the shape of '{TACTILE}' is {list(shape)}, channels first; write"
            f" {[*shape[1:], 3]} and the names height, width, channels."
        )
    elif image_shape is None and (len(shape) != 3 or shape[2] != 3):
        found.append(f"{file}: '{TACTILE}' is {shape}; it must be (height, width, 3).")
    elif image_shape not in (None, shape):
        found.append(
            f"{file}: the images '{TACTILE}' are {shape} and those of the twin's sensor {image_shape}; give"
            " the twin of the sensor that recorded them, at their size."
        )
    return found


def _of_episodes(episodes: dict, range_kpa: tuple[float, float], area: int) -> list[str]:
    """Faults of single episodes, those with the same fault in one sentence."""
    low, high = range_kpa
    tolerance = ROUNDING_KPA * (high - low)
    kinds: dict[str, list[int]] = {
        NOT_FINITE: [],
        "has one frame only": [],
        UNTOUCHED: [],
        f"commands pressures beyond the {low:g} to {high:g} kPa that the twin was measured over": [],
    }
    broken, short, untouched, beyond = kinds.values()
    for number, (state, action) in episodes.items():
        if not (np.isfinite(state).all() and np.isfinite(action).all()):
            broken.append(number)
        elif len(action) < 2:
            short.append(number)
        elif not without_specks(state[:, area]).any():
            untouched.append(number)
        elif action[:, PRESSURES].min() < low - tolerance or action[:, PRESSURES].max() > high + tolerance:
            beyond.append(number)
    return [leave_out(which, fault) for fault, which in kinds.items() if which]


def _close(name: str, names) -> str:
    close = difflib.get_close_matches(name, [str(n) for n in names], n=1, cutoff=0.75)
    return f" (there is '{close[0]}')" if close else ""
