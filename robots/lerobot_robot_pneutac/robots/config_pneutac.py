"""Options of the robot `pneutac`."""

from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING

from lerobot.cameras import CameraConfig
from lerobot.robots import RobotConfig

from lerobot_robot_pneutac import options
from lerobot_robot_pneutac.hardware.arms import ArmConfig
from lerobot_robot_pneutac.hardware.safety import Limits
from lerobot_robot_pneutac.options import named, refuse_if, station_of, twin_of
from pneutac_sim.errors import InputError
from pneutac_sim.features import IMAGE_NAME, state_names

if TYPE_CHECKING:
    from lerobot_robot_pneutac.hardware.parts import Chambers


@dataclass(kw_only=True)
class PressureConfig:
    """Which pressure controller; of a finger with several chambers which, one a chamber."""

    type: str = ""  # `pneutac_serial`, `text_serial`, `simulated`, or another that was registered
    port: str | None = None  # serial port, where it has one
    ports: tuple[str, ...] = ()  # serial ports of the controllers of several chambers, in the chambers' order
    chambers: int = 1  # how many, where the type has no ports
    # everything else that this type takes, by name; a list has one a chamber
    options: dict[str, float | list[float] | str] = field(default_factory=dict)

    @property
    def count(self) -> int:
        return len(self.ports) or self.chambers

    def make(self) -> "Chambers":
        """The controllers, not connected; raises InputError where type or options are unknown or unfit."""
        from lerobot_robot_pneutac.hardware.parts import Chambers
        from lerobot_robot_pneutac.hardware.pressure import make_pressure_controller

        self._check()
        made = []
        for i in range(self.count):
            own = {k: v[i] if isinstance(v, list | tuple) else v for k, v in self.options.items()}
            port = self.ports[i] if self.ports else self.port
            own |= {} if port is None else {"port": port}
            made.append(make_pressure_controller(self.type, **own))
        return Chambers(made, same_limit=not isinstance(self.options.get("max_kpa"), list | tuple))

    def _check(self) -> None:
        if self.ports and self.port is not None:
            raise InputError("port and ports are both given; give port for one chamber, ports for several.")
        if self.ports and self.chambers not in (1, len(self.ports)):
            raise InputError(f"ports has {len(self.ports)} for chambers={self.chambers}; give one for each.")
        if len(self.ports) > 1 and all(len(port) == 1 for port in self.ports):  # a text, split
            raise InputError(
                f"ports is '{''.join(self.ports)}'; write a list in brackets, such as"
                " '[/dev/ttyACM0,/dev/ttyACM1,/dev/ttyACM2]'."
            )
        if "" in (self.port, *self.ports):
            raise InputError("port is empty; give one such as /dev/ttyACM0 (`pneutac doctor` lists them).")
        for i, port in enumerate(self.ports):
            if port in self.ports[:i]:
                raise InputError(
                    f"ports names {port} for chambers {self.ports.index(port) + 1} and {i + 1}; each chamber"
                    " needs a controller of its own."
                )
        if not self.ports and self.chambers > 1 and self.port is not None:
            raise InputError(
                f"port is one for chambers={self.chambers}; give ports, one for each, such as"
                " [/dev/ttyACM0,/dev/ttyACM1,/dev/ttyACM2]."
            )
        if self.count not in (1, 3):
            raise InputError(f"{self.count} controllers are given; a finger has one chamber, an arm three.")
        for name, value in self.options.items():
            if isinstance(value, list | tuple) and len(value) != self.count:
                raise InputError(
                    f"options.{name} has {len(value)} values for {self.count} controllers; give one for all,"
                    " or one for each."
                )


@RobotConfig.register_subclass("pneutac")
@dataclass(kw_only=True)
class PneutacConfig(RobotConfig):
    """A Panda with the pneumatic finger and a DIGIT, for real.

    A finger of several chambers has a pressure controller for each; actions are then `pressure_1.pos` and so
    on.
    """

    arm: ArmConfig | None = None  # `--robot.arm.type=panda --robot.arm.ip=...`, or `simulated` for a dry run
    # `--robot.pressure.type=pneutac_serial --robot.pressure.port=/dev/ttyACM0`, for example; of several
    # chambers `--robot.pressure.ports='[/dev/ttyACM0,/dev/ttyACM1,/dev/ttyACM2]'`
    pressure: PressureConfig = field(default_factory=PressureConfig)
    # enforced below any policy; the set-points are the twin's where none are given
    limits: Limits = field(default_factory=Limits)  # draccus cannot have a nested dataclass come last
    # the tactile camera: `--robot.digit.type=digit`, `elastomer` for any other under a gel, or any camera
    # type of LeRobot's; its image keeps its size
    digit: CameraConfig | None = None
    # folder of the sensor's calibrated twin; its gel's contact threshold makes `contact_area.pos` and
    # `contact_pixels.pos` the same as on `pneutac_sim` with that twin. Without it they are those of the
    # built-in twin. Its `pressure_range_kpa` bounds the set-points.
    twin: Path | None = None
    # that threshold itself, in place of the twin: mean difference of R, G, B to the rest image, 8-bit levels,
    # above which a pixel is in contact
    contact_threshold: float | None = None
    # more cameras, as for every LeRobot robot; those of the simulated robot have the same names
    cameras: dict[str, CameraConfig] = field(default_factory=dict)
    # actions command the finger's bend, `bend.pos` in rad, in place of the pressure; the twin finds the
    # pressure for it
    bend: bool = False
    # what the twin's effects ask for, such as {temperature_c: 22}, for `bend`
    conditions: dict[str, float] = field(default_factory=dict)
    # file `station.yaml`, whose workspace is the box of `limits` where these give none, and whose control
    # rate LeRobot's `--fps` and `--dataset.fps` are to be
    station: Path | None = None

    def __post_init__(self):
        super().__post_init__()
        for name, given, example in (
            ("arm", self.arm, "panda"),
            ("pressure", self.pressure.type, "pneutac_serial"),
            ("digit", self.digit, "digit"),
        ):
            refuse_if(not given, f"--robot.{name}.type is missing; give --robot.{name}.type={example}.")
        self._refuse_one_sensor_twice()
        refuse_if(
            not (self.digit.width and self.digit.height),
            f"--robot.digit.width and height are missing; give the size in which '{self.digit.type}' sends.",
        )
        with named("robot.pressure"):
            self.pressure.make()  # opens nothing
        refuse_if(
            self.bend and self.twin is None,
            "--robot.bend=true needs --robot.twin, the folder of the finger's calibrated twin.",
        )
        taken = {IMAGE_NAME, *state_names(self.joints, self.chambers)} & self.cameras.keys()
        refuse_if(bool(taken), f"--robot.cameras has '{', '.join(taken)}', which is taken; choose another.")
        self._check_contact()
        self._check_chambers()
        with named("robot.twin"):
            self.limits = self.limits.of_twin(twin_of(self.twin).pressure_range_kpa)
        options.check_station("robot.station", self.station)
        self._where = station_of(self.station)
        of_limits = (self.limits.low_m, self.limits.high_m) != (Limits.low_m, Limits.high_m)
        if self.station is not None and not of_limits:
            corners = self._where.box_m(twin_of(self.twin).length_mm)  # limits are in the arm's frame
            low_m, high_m = (tuple((corner - self._where.base_m).tolist()) for corner in corners)
            self.limits.low_m, self.limits.high_m = low_m, high_m

    @property
    def joints(self) -> int:
        return self.arm.joints

    @property
    def chambers(self) -> int:
        """Chambers of the finger, a pressure controller each."""
        return self.pressure.count

    @property
    def control_hz(self) -> int:
        """Control rate of the station; the paper's where there is none."""
        return self._where.control_hz

    def threshold_levels(self) -> float:
        """The contact threshold, 8-bit levels; raises InputError where the twin's folder is damaged."""
        given = self.contact_threshold
        return options.gel_of(self.twin).threshold_levels if given is None else given

    def _refuse_one_sensor_twice(self) -> None:
        """Two options that name one camera would both get its images."""
        seen: dict[tuple[str, str], str] = {}
        for name, camera in {"digit": self.digit, **self.cameras}.items():
            option = name if name == "digit" else f"cameras.{name}"
            for field_ in ("serial", "index_or_path", "serial_number_or_name"):
                value = getattr(camera, field_, None)
                if value is None:
                    continue
                first = seen.setdefault((field_, str(value)), option)
                refuse_if(
                    first != option,
                    f"--robot.{first} and --robot.{option} both have {field_} '{value}'; give each sensor its"
                    " own.",
                )

    def _check_chambers(self) -> None:
        has = options.chambers_of("robot.twin", self.twin) if self.twin is not None else 0
        refuse_if(
            has not in (0, self.chambers),
            f"--robot.twin has {has} chamber{'s' * (has > 1)} and --robot.pressure drives {self.chambers};"
            f" give {'one controller' if has == 1 else '--robot.pressure.ports, one for each chamber'}.",
        )
        if self.bend:
            options.check_bend("robot", self.twin)

    def _check_contact(self) -> None:
        options.check_twin_folder("robot.twin", self.twin)
        if self.contact_threshold is not None:
            refuse_if(
                self.twin is not None,
                "--robot.twin and --robot.contact_threshold both say where contact begins; give one of them.",
            )
            options.check_range("--robot.contact_threshold", self.contact_threshold, 0, 256, "()")
        if self.twin is not None:
            with named("robot.twin"):
                self.threshold_levels()
