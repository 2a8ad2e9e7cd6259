"""The twin: our model of one device, as a folder that a person can read and the Hub can carry.

`twin.yaml` holds device, geometry, parameters and effects; `*.safetensors` hold arrays (rest image, splat
colours, networks); `history/NNN/` holds every earlier version with what was changed and its errors.
"""

import copy
import hashlib
import math
import shutil
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from safetensors.numpy import load_file, save

from pneutac_sim.errors import InputError, as_number, as_numbers, from_hub, option, shown, unknown_names
from pneutac_sim.features import PAPER_LENGTH_MM, PAPER_RANGE_KPA
from pneutac_sim.files import inside, locked, meant, read_yaml, refuse_pointer, whole, write_json, write_text
from pneutac_sim.value import Value

DEVICES = ("finger", "arm", "gel")
FORMAT = "pneutac-twin/1"
Report = Callable[[], object]
NETWORKS = ("action", "perception")  # each a safetensors file in the twin's folder

# The paper's calibrated finger (Sec. IV-A), with the joint spring of a segment from beam theory:
# K = E I / (L / N) for a 20 mm square section of 110 mm length; damping is light (ratio about 0.1).
PAPER_FINGER = {
    "gain_rad_per_kpa": 0.01114,
    "gain_alpha": 0.0313,
    "gain_beta": 0.2974,
    "rest_pressure_kpa": 10.70,
    "youngs_modulus_mpa": 0.945,
    "poissons_ratio": 0.460,
    "joint_stiffness_nm_per_rad": 0.458,
    "joint_damping_nms_per_rad": 0.006,
}

# What every calibration of a body finds; of an arm the first three: its rest pressures have other names.
# What else a twin lacks was not known when it was made.
MOST_LENGTH_MM = 1e4  # no soft finger or arm is longer; of a typing error results would be nonsense
MOST_VALUE = 1e12  # no quantity is larger in the unit of its name
MOST_BEND_RAD = 8 * math.pi  # at the ends of its pressures: four full turns, which no finger makes
CALIBRATED = ("gain_rad_per_kpa", "gain_alpha", "gain_beta", "rest_pressure_kpa")

# Parameters of a body that a twin may have, besides `bend_1` to `bend_N`: of the pipeline, of the soft solid,
# of the gel's material, and what a diagnosis finds of the clock.
_DRIVE = (
    "gain_rad_per_kpa", "gain_alpha", "gain_beta", "curl_rad", "joint_stiffness_nm_per_rad", "body_share",
)  # fmt: skip
_CHAMBERS = (
    "rest_pressure_z_kpa", "rest_pressure_y_kpa", "chamber_angle_rad", "chamber_2_gain", "chamber_3_gain",
    "chamber_handedness", "chamber_2_turn_rad", "chamber_3_turn_rad",
)  # fmt: skip
_SOLID = (
    "joint_damping_nms_per_rad", "youngs_modulus_mpa", "poissons_ratio", "density_kg_m3", "width_mm",
    "spine_stiffness_nm_per_rad", "spine_damping_nms_per_rad",
)  # fmt: skip
_MATERIAL = ("gel_youngs_modulus_mpa", "gel_poissons_ratio", "gel_density_kg_m3")
_CLOCK = ("command_latency_s", "switch_share", "pause_s")
PARAMETERS = {
    "finger": (*_DRIVE, "rest_pressure_kpa", *_SOLID, *_MATERIAL, *_CLOCK),
    "arm": (*_DRIVE, *_CHAMBERS, *_SOLID, *_MATERIAL, *_CLOCK),
    "gel": (*_DRIVE, "rest_pressure_kpa", *_SOLID, *_MATERIAL),
}
GEL = {"light": (3, 2), "depth_light": (3,), "px_per_mm": (), "thickness_mm": (), "decay_mm": ()}
GEL |= {"depth_scale": (), "threshold_levels": ()}  # the shape of each

# Fields of an entry of the history; all but the first two may be missing.
_NUMBER = (int, float)
_ENTRY = {
    "version": (int,), "change": (str,), "recording": (str,), "train": _NUMBER, "heldout": _NUMBER,
    "unit": (str,), "seed": (int,), "effects": (str,), "arm_and_gauge": _NUMBER, "touch": _NUMBER,
    "heldout_ci95": (list,), "dragging": (dict,), "imprint": (dict,),
}  # fmt: skip
_KINDS = {
    (int,): "give a whole number", (str,): "give a text", _NUMBER: "give a finite number",
    (list,): "give a list", (dict,): "give names and what they are",
}  # fmt: skip


def no_twin(folder: Path, **options) -> str:
    """The sentence for a folder without a twin: twins nearby with such a name, else how one is made."""
    command = " ".join(option(name, value) for name, value in {"twin": folder, **options}.items())
    make = f"make one with `pneutac new {command}`."
    none = f"There is no twin at '{folder}' (no twin.yaml); {meant(folder, 'twin.yaml') or make}"
    return lost_twin(folder) or none


def lost_twin(folder: Path) -> str:
    """The sentence for a folder with other files of a twin than twin.yaml; empty where it has none."""
    if versions := sorted(folder.glob("history/*/twin.yaml")):
        return f"'{folder}' has lost its twin.yaml; copy the last one that is stored, {versions[-1]}, to it."
    if any((folder / f"{name}.safetensors").is_file() for name in ("arrays", *NETWORKS)):
        return f"'{folder}' holds files of a twin and no twin.yaml; restore it from where they came from."
    return ""


def _no_format(file: Path, content: object) -> str:
    """The sentence for the content of a twin.yaml that is no twin's."""
    if isinstance(content, dict) and content:
        return f"{file}: field 'format' must be '{FORMAT}'."
    folder = file.parent
    if stored := sorted(folder.glob("history/*/twin.yaml")):
        remedy = f"copy the last one that is stored, {stored[-1]}, to it"
    elif folder.parent.name == "history":
        remedy = "restore it from the twin's source"
    else:
        remedy = f"delete '{folder}' and make the twin again with `pneutac new {option('twin', folder)}`"
    return f"{file} {'is empty' if not content else 'holds no fields'}; {remedy}."


@dataclass
class Twin:
    """Our model of one device."""

    device: str = "finger"  # `finger`, `arm` or `gel`; a finger may carry a `gel` at its tip
    length_mm: float = PAPER_LENGTH_MM  # length of the straight finger or arm
    # arc length of each spine joint from the base
    spine_joint_positions_mm: list[float] = field(default_factory=list)
    parameters: dict[str, Value] = field(default_factory=dict)  # name (with unit) to value, of the body
    # effect name to its parameters, in the order in which they were added
    effects: dict[str, dict[str, Value]] = field(default_factory=dict)
    # lowest and highest pressure that it was measured over, 0 among them; robots, environments, planner and
    # policies go no farther. A twin that does not say is the paper's
    pressure_range_kpa: tuple[float, float] = PAPER_RANGE_KPA
    # parameters of the gel and its optics (numbers and lists), empty where there is no gel
    gel: dict = field(default_factory=dict)
    # named float32 or uint8 arrays stored as safetensors, such as `rest_image` (H, W, 3)
    arrays: dict[str, np.ndarray] = field(default_factory=dict)
    # one entry a version: `version`, `change`, `recording`, `train`, `heldout`, `unit`; of a gel whose
    # effects nobody chose also `effects`: `standard`
    history: list[dict] = field(default_factory=list)
    # files of those of `NETWORKS` that were trained for it (`pneutac surrogate`)
    networks: dict[str, Path] = field(default_factory=dict)
    # where it was read from or written to last; None where nowhere
    folder: Path | None = field(default=None, compare=False)
    # `change`, `recording` and `seed` of a fit that is not saved as a version yet
    fitted_to: dict | None = field(default=None, compare=False, repr=False)

    def __post_init__(self):
        if self.device not in DEVICES:
            raise InputError(f"Twin device is '{self.device}'; it must be one of {', '.join(DEVICES)}.")
        if not 0 < self.length_mm <= MOST_LENGTH_MM:
            raise InputError(
                f"Twin length_mm is {self.length_mm:g}; it must be a positive number of millimetres, at most"
                f" {MOST_LENGTH_MM:g}."
            )
        if not self.spine_joint_positions_mm:
            n = {"finger": 4, "arm": 6, "gel": 0}[self.device]
            self.spine_joint_positions_mm = [self.length_mm * (i + 0.5) / n for i in range(n)]
        joints = [0.0, *self.spine_joint_positions_mm, self.length_mm]
        if not all(a < b or n == a == b == 0 for n, (a, b) in enumerate(pairwise(joints))):
            raise InputError(
                f"Twin spine_joint_positions_mm is {shown(joints[1:-1])}; it must be rising numbers between 0"
                f" and length_mm, {self.length_mm:g}."
            )
        self.pressure_range_kpa = checked_range(self.pressure_range_kpa, "Twin pressure_range_kpa")
        for name, p in self.parameters.items():
            if not abs(p.value) < MOST_VALUE:
                raise InputError(f"Twin parameter '{name}' is {p.value}; it must be a finite number.")

    def _no_coil(self) -> None:
        """Refuses what a slip of units makes of a stored twin; a fit may pass through such values."""
        gain, rest = (
            self.parameters.get(n, Value(0.0)).value for n in ("gain_rad_per_kpa", "rest_pressure_kpa")
        )
        end = max(self.pressure_range_kpa, key=lambda p: abs(p + rest))
        bend = len(self.spine_joint_positions_mm) * gain * (end + rest)
        if abs(bend) > MOST_BEND_RAD:
            raise InputError(
                f"Twin parameter 'gain_rad_per_kpa' is {gain:g}: at {end:g} kPa, of pressure_range_kpa,"
                f" the body bends by {bend:.3g} rad; are the pressures in another unit?"
            )

    @classmethod
    def builtin(cls) -> "Twin":
        """The paper's finger, 110 mm long, with a generated DIGIT gel at its tip."""
        return cls(parameters={k: Value(v) for k, v in PAPER_FINGER.items()})

    def parameter(self, name: str) -> float:
        """Value of one body parameter; raises InputError where the twin has none."""
        if name not in self.parameters:
            raise InputError(f"The twin has no parameter '{name}' of its body; calibrate the twin.")
        return self.parameters[name].value

    @property
    def missing(self) -> list[str]:
        """Parameters of `CALIBRATED` that the body lacks, without those that so few joints do not have."""
        count = {"finger": len(CALIBRATED), "arm": len(CALIBRATED) - 1, "gel": 0}[self.device]
        none = CALIBRATED[min(len(self.spine_joint_positions_mm), 3) : 3]
        return [n for n in CALIBRATED[:count] if n not in (*self.parameters, *none)]

    # ---------------------------------------------------------------- files

    def save(self, path: str | Path) -> Path:
        """Writes the twin into folder `path` without touching its history; returns the folder.

        Raises InputError: no space is left, or another process writes there and does not end.
        """
        path = Path(path)
        with locked(path):
            self._write(path)
        return path

    def _write(self, path: Path, number: int | None = None, report: Report = lambda: None) -> None:
        """What `twin.yaml` names, the version's folder, its report, that file: a stop changes nothing."""
        content = self._as_dict()
        if self.arrays:
            data = save({k: np.ascontiguousarray(v) for k, v in self.arrays.items()})
            content["arrays"] = f"arrays-{hashlib.sha256(data).hexdigest()[:16]}.safetensors"
            if not (path / content["arrays"]).exists():
                with whole(path / content["arrays"]) as part:
                    part.write_bytes(data)
        for name, file in self.networks.items():
            if file.resolve() != (path / f"{name}.safetensors").resolve():
                with whole(path / f"{name}.safetensors") as part:
                    shutil.copy2(file, part)
        text = yaml.dump(content, Dumper=_Dumper, sort_keys=False)
        if number is not None:
            folder = path / "history" / f"{number:03d}"
            write_text(folder / "twin.yaml", text)
            write_json(folder / "change.json", self.history[-1])
        report()
        write_text(path / "twin.yaml", text)

    def save_version(
        self, path: str | Path, change: str, recording: str, errors: dict, report: Report = lambda: None
    ) -> Path:
        """Appends a history entry and writes the twin as the next version of the folder `path`.

        Args:
            path: the twin's folder.
            change: what was done, e.g. `added creep`.
            recording: the recording that was used.
            errors: `train`, `heldout` and `unit`; and others of `_ENTRY`.
            report: writes what else is to be there before the version counts; where it raises, none is made.

        Raises InputError: as `save`, an error has another name or is not finite, or another process has saved
        a version since this one was loaded.
        """
        path = Path(path)
        number = len(self.history)
        entry, faults = {"version": number, "change": change, "recording": recording, **errors}, []
        _history([*self.history, entry], faults)
        if faults:
            raise InputError(faults[0])
        with locked(path):
            exists = (path / "twin.yaml").is_file()
            there = Twin.load(path, calibrated=False).history if exists else self.history
            if there != self.history:
                raise InputError(
                    f"'{path}' has been changed by another process since it was read (it holds {len(there)}"
                    f" versions, this one {number}); repeat the command, which starts from the newest."
                )
            self.history.append(entry)
            before, self.folder = self.folder, path
            try:
                self._write(path, number, report)
            except BaseException:
                self.history.pop()
                self.folder = before
                raise
        self.fitted_to = None
        return path

    @classmethod
    def load(cls, path: str | Path, version: int | None = None, calibrated: bool = True) -> "Twin":
        """Reads a twin's folder.

        Args:
            path: the folder.
            version: an earlier version in it.
            calibrated: whether a body without a parameter of `CALIBRATED` is refused; a fit finds them.

        Raises InputError: with file and field: there is none, or something in it is missing or malformed.
        """
        file = Path(path) / ("twin.yaml" if version is None else f"history/{version:03d}/twin.yaml")
        if not file.is_file():
            if version is not None:
                raise InputError(
                    f"{path} has no version {version} ({file} is missing); restore it from the twin's source."
                )
            if Path(path).is_file():
                raise InputError(f"{path} is a file; give the folder of a twin.")
            raise InputError(no_twin(Path(path)))
        d = read_yaml(file)
        if not isinstance(d, dict) or d.get("format") != FORMAT:
            raise InputError(_no_format(file, d))
        fields, faults = _fields(d)
        if faults:
            raise InputError(f"{file}: {faults[0]}")
        twin, folder = cls(**fields), Path(path)
        twin._no_coil()
        if calibrated and twin.missing:
            raise InputError(
                f"{file}: body: {', '.join(twin.missing)} {'are' if twin.missing[1:] else 'is'} missing; "
                f"`pneutac calibrate {option('twin', folder)} --recording=DIR` finds what is missing."
            )
        twin.folder = folder
        files = {name: folder / f"{name}.safetensors" for name in NETWORKS}
        twin.networks = {name: file for name, file in files.items() if file.is_file()}
        name = d.get("arrays", "arrays.safetensors")  # a twin before 0.2 does not name it
        if not isinstance(name, str) or name != Path(name).name:
            raise InputError(f"{file}: field 'arrays' is {shown(name)}; it must be a file's name.")
        arrays = folder / name
        for linked in (file, arrays, folder / "history", *twin.networks.values()):
            if not inside(folder, linked):
                raise InputError(
                    f"{linked} is a link that leads out of the twin's folder; put there what it leads to."
                )
        if "arrays" in d and not arrays.is_file():
            raise InputError(f"{arrays} is missing, which twin.yaml names; restore it from its source.")
        if arrays.is_file():
            refuse_pointer(arrays)
            try:
                twin.arrays = load_file(arrays)
            except Exception as e:
                raise InputError(f"{arrays} is corrupted ({e}); restore it from the twin's source.") from e
        return twin

    @classmethod
    def faults(cls, path: str | Path) -> list[str]:
        """One sentence for each fault that keeps a twin's folder from being read, or an earlier version."""
        file = Path(path) / "twin.yaml"
        try:
            d = read_yaml(file)
        except InputError as e:
            return [str(e)]
        if not d or not isinstance(d, dict):
            return [_no_format(file, d)]
        found = [] if d.get("format") == FORMAT else [f"field 'format' must be '{FORMAT}'."]
        found += _fields(d)[1]
        if found:
            return [f"{file}: {fault}" for fault in found]
        earlier = (e["version"] for e in d["history"][:-1])
        there = (v for v in earlier if (Path(path) / f"history/{v:03d}").is_dir())  # not of one from the Hub
        for version in (None, *there):
            try:
                cls.load(path, version, calibrated=version is None)
            except InputError as e:
                found.append(str(e))
        return list(dict.fromkeys(found))  # versions may share a file

    def copy(self) -> "Twin":
        return copy.deepcopy(self)

    def without(self, effect: str) -> "Twin":
        """The twin with one effect switched off."""
        return replace(self, effects={k: v for k, v in self.effects.items() if k != effect})

    def push_to_hub(self, repo_id: str, **kwargs) -> str:
        """Uploads a saved copy of this twin to the Hugging Face Hub; returns the commit's address.

        Raises InputError: the Hub cannot be reached, or refuses it.
        """
        import tempfile

        from huggingface_hub import HfApi  # slow to import, and few twins come from the Hub or go there

        failed = f"The twin was not uploaded to '{repo_id}'"
        with tempfile.TemporaryDirectory() as tmp, from_hub(failed):
            self.save(tmp)
            api = HfApi()
            api.create_repo(repo_id, exist_ok=True)
            (Path(tmp) / ".lock").unlink(missing_ok=True)
            return str(api.upload_folder(folder_path=tmp, repo_id=repo_id, **kwargs))

    @classmethod
    def from_pretrained(cls, name_or_path: str | Path, **kwargs) -> "Twin":
        """Loads a twin from a folder or from a Hub repository.

        Raises InputError: there is no such folder and the Hub cannot be reached or has none, or it is
        damaged.
        """
        if Path(name_or_path).is_dir():
            return cls.load(name_or_path)
        from huggingface_hub import snapshot_download

        with from_hub(f"There is no folder '{name_or_path}', and no twin of that name came from the Hub"):
            folder = snapshot_download(str(name_or_path), **kwargs)
        return cls.load(folder)

    def _as_dict(self) -> dict:
        return {
            "format": FORMAT,
            "device": self.device,
            "length_mm": float(self.length_mm),
            "spine_joint_positions_mm": [float(x) for x in self.spine_joint_positions_mm],
            "parameters": {k: _plain(v) for k, v in self.parameters.items()},
            "effects": {n: {k: _plain(v) for k, v in e.items()} for n, e in self.effects.items()},
            **({} if self.device == "gel" else {"pressure_range_kpa": list(self.pressure_range_kpa)}),
            "gel": self.gel,
            "history": self.history,
        }


def twin_digest(twin: Twin) -> str:
    """SHA-256 of all that a twin holds: numbers, effects, history, arrays and networks."""
    h = hashlib.sha256(yaml.dump(twin._as_dict(), Dumper=_Dumper).encode())
    for name, values in sorted(twin.arrays.items()):
        h.update(f"{name}{values.dtype}{values.shape}".encode() + np.ascontiguousarray(values).tobytes())
    for name, file in sorted(twin.networks.items()):
        h.update(name.encode() + file.read_bytes())
    return h.hexdigest()


class _Dumper(yaml.SafeDumper):
    """Writes what occurs twice twice, for `read_yaml` takes no aliases."""

    def ignore_aliases(self, data):
        return True


def checked_range(pressures_kpa, name: str) -> tuple[float, float]:
    """A range of pressures as two numbers, kPa.

    Raises InputError: it is not two finite numbers, the first below the second, with 0 (vented) among them.
    """
    try:
        low, high = as_numbers(pressures_kpa)
        right = -math.inf < low <= 0 <= high < math.inf and low < high
    except (TypeError, ValueError):
        right = False
    if not right:
        raise InputError(
            f"{name} is {shown(pressures_kpa)}; it must be the lowest and the highest pressure in kPa, with 0"
            " (vented) among them, such as [0, 15] or, with vacuum, [-40, 20]."
        )
    return low, high


def _plain(v: Value) -> dict:
    return {"value": float(v.value)} | ({"ci95": [float(x) for x in v.ci95]} if v.ci95 else {})


def _fields(d: dict) -> tuple[dict, list[str]]:
    """Fields of a `twin.yaml` as a twin takes them, and a sentence for each that is missing or malformed."""
    fields, faults = {}, unknown_names(d, ("format", *_READ, "arrays"))
    for name, read in _READ.items():
        if name not in d:
            if name != "pressure_range_kpa":  # none before 0.2
                faults.append(f"field '{name}' is missing.")
            continue
        try:
            fields[name] = read(d[name], faults)
            Twin(**{"length_mm": fields.get("length_mm", PAPER_LENGTH_MM), name: fields[name]})
        except InputError as e:
            faults.append(str(e))
        except (TypeError, ValueError) as e:
            faults.append(f"field '{name}' is malformed ({e}).")
    if fields.keys() >= {"device", "parameters"} and fields["device"] in DEVICES:
        bends = [f"bend_{n + 1}" for n in range(len(fields.get("spine_joint_positions_mm", ())))]
        known = (*PARAMETERS[fields["device"]], *bends)
        faults += [f"body: {fault}" for fault in unknown_names(d["parameters"], known, "parameter")]
    return fields, faults


def _mapping(d, where: str) -> dict:
    if not isinstance(d, dict):
        raise InputError(f"field '{where}' is {shown(d)}; it must hold names and what they are.")
    return d


def _values(d, where: str, faults: list[str]) -> dict[str, Value]:
    """Numbers with their intervals, as `_plain` writes them; others' sentences go to the faults."""
    out = {}
    for name, v in _mapping(d, where).items():
        try:
            out[name] = _value(v, f"{where}.{name}")
        except InputError as e:
            faults.append(str(e))
    return out


def _value(v, where: str) -> Value:
    if not isinstance(v, dict) or "value" not in v:
        raise InputError(f"field '{where}' is {shown(v)}; it must hold 'value', a number.")
    for fault in unknown_names(v, ("value", "ci95")):
        raise InputError(f"{where}: {fault}")
    ends = v.get("ci95")
    try:
        middle, ci95 = as_number(v["value"]), [] if ends is None else as_numbers(ends)
    except (TypeError, ValueError) as e:
        raise InputError(f"field '{where}' is {shown(v)}; its numbers are malformed ({e}).") from e
    right = ends is None or isinstance(ends, list) and len(ends) in (0, 2) and ci95 == sorted(ci95)
    if not (right and all(abs(x) < MOST_VALUE for x in (middle, *ci95))):
        raise InputError(f"field '{where}' is {shown(v)}; its numbers must be finite, ci95 low and high.")
    return Value(middle, (ci95[0], ci95[1]) if ci95 else None)


def _effects(d, faults: list[str]) -> dict[str, dict[str, Value]]:
    if not _mapping(d, "effects"):
        return {}
    from pneutac_sim.effects.registry import get_effect  # half a second, and a new twin has no effects

    out = {}
    for name, e in d.items():
        try:
            specs, where = [p.name for p in get_effect(str(name)).parameters], f"effects.{name}"
            wrong = unknown_names(_mapping(e, where), specs, "parameter")
            faults += [f"{where}: {fault}" for fault in wrong]
            out[name] = _values({k: v for k, v in e.items() if k in specs}, where, faults)
            missing = [p for p in specs if p not in e]
            if missing and not wrong:
                raise InputError(
                    f"{where}: {', '.join(missing)} {'are' if missing[1:] else 'is'} missing; add what is "
                    "missing, or take the effect out."
                )
        except InputError as error:
            faults.append(str(error))
    return out


def _gel(d, faults: list[str]) -> dict:
    faults += [f"gel: {fault}" for fault in unknown_names(_mapping(d, "gel"), GEL)]
    for name, shape in ((n, s) for n, s in GEL.items() if n in d):
        numbers = np.array(d[name], object)
        right = numbers.shape == shape
        if not (right and all(type(x) in _NUMBER and math.isfinite(x) for x in numbers.flat)):
            wanted = f"finite numbers of shape {shape}" if shape else "a finite number"
            faults.append(f"field 'gel.{name}' is {shown(d[name])}; it must be {wanted}.")
    return d


def _history(d, faults: list[str]) -> list[dict]:
    if not isinstance(d, list):
        raise InputError(f"field 'history' is {shown(d)}; it must hold an entry for each version.")
    for number, e in enumerate(d):
        where = f"history, entry {number}"
        faults += [f"{where}: {fault}" for fault in unknown_names(_mapping(e, where), _ENTRY)]
        for name, kinds in _ENTRY.items():
            value, needed = e.get(name), name in ("version", "change")
            right = isinstance(value, kinds) and not isinstance(value, bool)
            right = right and (kinds is not _NUMBER or math.isfinite(value))
            if needed and name not in e:
                faults.append(f"{where}: field '{name}' is missing.")
            elif not right and (needed or value is not None):
                faults.append(f"{where}: field '{name}' is {shown(value)}; {_KINDS[kinds]}.")
        if e.get("version", number) != number:
            faults.append(f"{where}: field 'version' is {shown(e['version'])}; versions count from 0.")
    return d


_READ: dict[str, Callable[[Any, list[str]], Any]] = {
    "device": lambda d, _: d,
    "length_mm": lambda d, _: as_number(d),
    "spine_joint_positions_mm": lambda d, _: as_numbers(d),
    "parameters": lambda d, faults: _values(d, "parameters", faults),
    "effects": _effects,
    "pressure_range_kpa": lambda d, _: d,
    "gel": _gel,
    "history": _history,
}
