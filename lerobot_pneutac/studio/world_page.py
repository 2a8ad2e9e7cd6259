"""The world page: a task in simulation with this twin's finger, by an expert, a policy or by hand."""

import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
import torch
from lerobot.configs import PreTrainedConfig
from lerobot.envs.utils import preprocess_observation
from lerobot.policies import get_policy_class, make_pre_post_processors
from lerobot.utils.constants import OBS_IMAGES
from lerobot.utils.import_utils import register_third_party_plugins

from lerobot_pneutac.reports.page import side_by_side
from lerobot_pneutac.studio.plots import FLOOR, MEASURED, MODEL, Background, Lines, Player
from pneutac_sim.errors import InputError
from pneutac_sim.executor import no_progress
from pneutac_sim.features import AREA, CHAMBERS, IMAGE_NAME, PRESSURE, TRIAL_S, pressure_names, task_names

BY_INSTRUCTION = "as its instruction says"


class EpisodePanel:
    """One episode: recorded, replayed, and the difference."""

    def __init__(self, studio):
        self._studio, gui = studio, studio.server.gui
        self._episode, self._replayed = None, None
        with gui.add_folder("Episodes of a dataset", expand_by_default=bool(studio.session.demonstrations)):
            self._name = gui.add_text("dataset", studio.session.demonstrations,
                                      hint="folder of a LeRobotDataset, or its name on the Hub")  # fmt: skip
            self._task = gui.add_dropdown("its task", (BY_INSTRUCTION, *task_names()))
            self._number = gui.add_number("episode", 0, min=0, step=1)
            replay = gui.add_button("Replay it in the twin's world", icon="repeat")
            self.readout = gui.add_markdown("The arm goes as recorded; pressure and touch are the twin's.")
            label = "touch: recorded, the twin's, the difference"
            self._picture = gui.add_image(np.zeros((2, 2, 3), np.uint8), label=label, visible=False)
            self._charts_folder = gui.add_folder("In time", visible=False)
            lines = (("recorded", MEASURED), ("twin", MODEL))
            commanded = (*lines, ("commanded", FLOOR))
            with self._charts_folder:
                self._player = Player(gui, self._show)
                self._charts = [
                    Lines(gui, "time, s", lines, 160, "contact area, %", FLOOR),
                    Lines(gui, "time, s", commanded, 160, "pressure, kPa"),
                ]
        replay.on_click(studio.safely(self.replay))
        studio.session.when_changed(self._forget)

    def replay(self) -> None:
        name, number = self._name.value.strip(), int(self._number.value)
        if not name:
            raise InputError("Which dataset? Give its folder, such as outputs/demo/demonstrations.")
        twin = self._studio.session.twin
        task = "" if self._task.value == BY_INSTRUCTION else self._task.value

        def work(_) -> None:
            from pneutac_datasets.demonstrations.imprint import find_place
            from pneutac_datasets.demonstrations.reading import load_demonstrations
            from pneutac_datasets.demonstrations.replaying import replay
            from pneutac_sim.world.world import World

            given = load_demonstrations(name, task, twin, only=[number])
            episode = given.episodes[0]
            world = World(given.task, twin, "image", "probe", station=given.station)
            replayed = replay(world, episode, find_place(world, episode), keep=True)
            self._episode, self._replayed = episode, replayed
            t = np.arange(len(episode)) / episode.fps
            self._player.reaches(float(t[-1]))
            pressure = episode.state[:, PRESSURE], replayed.pressure_kpa, episode.action[:, 3]
            self._charts[1].show(t, *pressure)
            self._show()

        def failed(why: str) -> None:
            self.readout.content = f"> {why}"

        self._studio.session.begin("replaying an episode", work, no_progress, failed)
        self.readout.content = "The episode is replayed ..."

    def _show(self) -> None:
        from lerobot_pneutac.verbs.compare_demonstrations import comparison_picture

        e, r = self._episode, self._replayed
        if e is None or r is None:
            return
        i = min(round(self._player.now_s * e.fps), len(e) - 1)
        self._picture.image, self._picture.visible = comparison_picture(e.images[i], r.images[i]), True
        self._charts_folder.visible = True
        t, areas = np.arange(len(e)) / e.fps, (100 * e.state[:, AREA], 100 * r.area)
        self._charts[0].show(t, *areas, now=t[i])
        off = float(np.sqrt(np.mean((r.images[i].astype(np.float32) - e.images[i]) ** 2)))
        end = "does the task too" if r.success else "does not do the task"
        contact = f"contact recorded {areas[0][i]:.2f} %, the twin's {areas[1][i]:.2f} %"
        kpa = f"pressure {e.state[i, PRESSURE]:.2f} and {r.pressure_kpa[i]:.2f} kPa"
        off = f"**Off by {off:.1f} levels** at {t[i]:.2f} s"
        self.readout.content = f"{off}: {contact}; {kpa}. Replayed, the twin {end}."

    def _forget(self) -> None:
        if self._episode is not None:
            self._episode = None
            self._picture.visible = self._charts_folder.visible = False
            self.readout.content = "Another version of the twin is looked at; replay it again."

    def close(self) -> None:
        self._player.close()


HEIGHT_PX = 280
SPEED_M_S = 0.05  # of a button or key that is held
HELD_S = 0.25  # after which one that was held counts as let go
MOVES = {"forward": (0, 1), "back": (0, -1), "left": (1, 1), "right": (1, -1), "up": (2, 1), "down": (2, -1)}
# As of the teleoperator `pneutac_keyboard`, but that W, A, S and D turn the viewer's picture.
KEYS = {"T": "forward", "G": "back", "F": "left", "H": "right", "I": "up", "K": "down"}
PRESSURE_KEYS = {"L": 1, "J": -1}
PRESSURE_STEP = 0.02  # of the range, a time that a key is sent
EXPERT, POLICY, HAND = PLAYERS = ("the scripted expert", "a policy", "by hand")


class WorldPage(Background):
    """A task of the library, one control step after the other."""

    title = "World"

    def __init__(self, studio):
        self._studio, gui = studio, studio.server.gui
        self.readout = gui.add_markdown("A task in simulation, with this twin's finger; nothing is recorded.")
        self._picture = gui.add_image(np.zeros((2, 2, 3), np.uint8), label="scene and touch", visible=False)
        self._task = gui.add_dropdown("task", tuple(task_names()))
        self._player = gui.add_dropdown("moved by", PLAYERS)
        self._policy = gui.add_text("policy", studio.session.policy, visible=False,
                                    hint="folder of its weights, or its name on the Hub")  # fmt: skip
        begin = gui.add_button("Begin again", icon="player-play")
        begin.on_click(studio.safely(self.begin))
        low, high = studio.session.twin.pressure_range_kpa
        self._held: dict[str, float] = {}
        hand = gui.add_folder("By hand", visible=False)
        with hand:
            gui.add_markdown("Hold a button, or its key; L and J change the pressure.")
            self._pressures = [
                gui.add_slider(name.removesuffix(".pos").replace("_", " ") + ", kPa", low, high, 0.1, 0.0)
                for name in pressure_names(CHAMBERS[studio.session.twin.device])
            ]
        for key, name in KEYS.items():
            with hand:
                button = gui.add_button(f"{name} ({key})")
            button.on_hold(lambda _, n=name: self._hold(n), callback_hz=10.0)
            how = "World, by hand: while it is held"
            command = gui.add_command(f"Move {name}", hotkey=key, description=how)
            command.on_trigger(lambda _, n=name: self._hold(n))
        for key, sign in PRESSURE_KEYS.items():
            command = gui.add_command("Inflate" if sign > 0 else "Let air out", hotkey=key)
            command.on_trigger(lambda _, s=sign: self._press(s))

        def chosen(_) -> None:
            self._policy.visible, hand.visible = self._player.value == POLICY, self._player.value == HAND

        self._player.on_update(chosen)
        self.episodes = EpisodePanel(studio)

    def _hold(self, name: str) -> None:
        self._held[name] = time.monotonic()

    def _press(self, sign: int) -> None:
        for slider in self._pressures:
            low, high = slider.min, slider.max
            slider.value = float(np.clip(slider.value + sign * PRESSURE_STEP * (high - low), low, high))

    def begin(self) -> None:
        super().close()
        self.readout.content = f"The world of the task '{self._task.value}' is made ..."
        self.start(self._run, "world page")

    def _run(self) -> None:
        from pneutac_sim.world.env import PneutacEnv  # MuJoCo, and networks where the twin has them

        stop = self._stop
        try:
            env = PneutacEnv(self._task.value, twin=self._studio.session.twin)
            observation, info = env.reset(seed=int(time.time()) % 10_000)
            move, by_hand = self._mover(env), self._player.value == HAND
            shown_s, done = 0.0, False
            while not (done or stop.is_set()):
                began = time.monotonic()
                observation, _, done, _, info = env.step(move(observation))
                shown_s += env.world.dt_s
                done = done or (shown_s >= TRIAL_S and not by_hand)
                self._show(env.render(), observation["pixels"][IMAGE_NAME], shown_s, info, done)
                stop.wait(max(0.0, env.world.dt_s - (time.monotonic() - began)))
            env.close()
        except InputError as e:
            self.readout.content = f"> {e}"

    def _mover(self, env) -> Callable[[dict], np.ndarray]:
        if self._player.value == HAND:
            return lambda _: self.action()
        if self._player.value == POLICY:
            return PolicyPlayer(self._policy.value.strip(), env.task_description).action
        from pneutac_sim.world.expert import ScriptedExpert

        expert = ScriptedExpert(env.world, np.random.default_rng())
        return lambda _: expert.action()

    def action(self) -> np.ndarray:
        """(3 + C,) of the buttons or keys that are held and of the sliders, as `features.action_names`."""
        velocity = np.zeros(3)
        for name, (axis, sign) in MOVES.items():
            if time.monotonic() - self._held.get(name, -np.inf) < HELD_S:
                velocity[axis] += sign * SPEED_M_S
        return np.append(velocity, [slider.value for slider in self._pressures])

    def _show(self, scene: np.ndarray, touch: np.ndarray, time_s: float, info: dict, done: bool) -> None:
        self._picture.image, self._picture.visible = side_by_side([scene, touch], height=HEIGHT_PX), True
        end = "**Done.**" if info["is_success"] else f"**{info['failure'] or 'Time is up.'}**" if done else ""
        self.readout.content = f"{self._task.value}, {time_s:.1f} s of the task. {end}"

    def close(self) -> None:
        super().close()
        self.episodes.close()


TOUCH = f"{OBS_IMAGES}.{IMAGE_NAME}"


class PolicyPlayer:
    """A policy at the beginning of an episode; InputError where there is none, or it wants to see more."""

    def __init__(self, name: str, task: str):
        weights = "the folder of its weights, such as TRAINED/checkpoints/last/pretrained_model"
        if not name:
            raise InputError(f"Which policy? Give {weights}.")
        if Path(name).is_dir() and not (Path(name) / "config.json").is_file():
            raise InputError(f"{name} holds no policy (there is no config.json); give {weights}.")
        register_third_party_plugins()
        try:
            config = PreTrainedConfig.from_pretrained(name)
            config.device = "cpu"
            self._policy = get_policy_class(config.type).from_pretrained(name, config=config)
            on_cpu = {"device_processor": {"device": "cpu"}}
            processors = make_pre_post_processors(config, name, preprocessor_overrides=on_cpu)
        except InputError:
            raise
        except Exception as e:  # each kind of policy fails in its own way
            reason = (str(e).splitlines() or [type(e).__name__])[0].rstrip(".")
            raise InputError(f"The policy {name} cannot be loaded: {reason}.") from e
        if others := sorted(set(config.image_features) - {TOUCH}):
            raise InputError(f"The policy {name} looks at {', '.join(others)} too; here it has touch alone.")
        self._before, self._after = processors
        self._task = task
        self._policy.reset()

    def action(self, observation: dict) -> np.ndarray:
        """(3 + C,) as `features.action_names`, by an observation of `TaskEnv`."""
        batch = {"agent_pos": observation["agent_pos"][None], "pixels": dict(observation["pixels"])}
        prepared = self._before(preprocess_observation(batch) | {"task": [self._task]})
        with torch.inference_mode():
            action = self._after(self._policy.select_action(prepared))
        return action[0].cpu().numpy()
