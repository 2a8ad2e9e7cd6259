"""What the columns of a lab's table are: by their names, in English and German, their units and numbers."""

import difflib
import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from shlex import quote

import numpy as np
import pandas as pd

from pneutac_datasets.recording.rules import LABELS, OWN, TARGETS, pressure_commands
from pneutac_datasets.recording.units import BASE_UNIT, UNITS, Unit, base_unit, unit_named
from pneutac_datasets.recording.wording import joined, listed
from pneutac_sim.errors import InputError, shown

WORDS = {
    "pressure": "p press pressure pressures pres druck kammerdruck innendruck luftdruck",
    "command": "soll set cmd command commanded setpoint sollwert target ref reference desired stell vorgabe"
    " ziel demand fuehrung sollwerte",
    "measured": "ist meas measured measurement actual act istwert gemessen sensor gauge feedback fb mess",
    "tip": "tip spitze marker fingerspitze fingertip tcp ende end endpunkt effector position pos"
    " koordinate coordinate",
    "base": "base basis fuss origin ursprung",
    "axis": "x y z",
    "angle": "angle winkel bend bending biegung biegewinkel beugung theta phi curl",
    "joint": "joint gelenk q",
    "temperature": "temp temperature temperatur",
    "payload": "payload weight gewicht last load mass masse nutzlast zusatzgewicht zusatzmasse anhaengelast",
    "gravity": "gravity schwerkraft grav g gravitation",
    "force": "force kraft f",
    "time": "time zeit t timestamp zeitstempel elapsed uhrzeit clock datetime stamp sekunden seconds sec",
    "date": "date datum",
    "frame": "frame bild sample index",
    "sent": "sent gesendet",
    "trial": "trial run lauf versuch messung episode test experiment durchgang versuchsnummer wiederholung",
    "program": "program programm label phase protokoll protocol profil profile",
    "filler": "finger in of the der die no nr id number nummer value wert channel kanal chamber kammer air"
    " luft valve ventil lab laenge hoehe breite abs absolute absolut rel relative"
    " pose data field",
}
KIND = {word: kind for kind, words in WORDS.items() for word in words.split()}
SHORT = {"axis", "pressure", "gravity", "force", "joint"}  # kinds whose single letters may be in a compound
UNIT_BEHIND = r"(.+?)\s*/\s*(\S+)", r"(.+?)\s+in\s+(\S+)", r"(.+)[\s_.:,;-]+([^\s_]+)", r"(.+?)_(1_per_m)"
LEAVE_OUT = "-"  # instead of a column's name
AMBIENT_KPA = 101.325
POSES = "length", "angle"  # dimensions of what one tracker writes, in one unit
NO_CM = 30.0  # from there on a tip is not in cm: soft fingers are 40 to 250 mm long
FIRST_DAY = 2e4  # 1954 in the days that spreadsheets count since 1900; MATLAB counts 7e5
NEAR_AMBIENT_KPA = 85.0, 110.0  # of the air, from 1,500 m above the sea
FLOAT = r"(\d+\.?\d*|\.\d+)([eE][-+]?\d+)?"
PARTS = re.compile(
    rf"(?P<column>[^\[*]+?)\s*(\[(?P<unit>[^\]]*)\])?\s*(\*\s*(?P<factor>[-+]?{FLOAT}))?\s*"
    rf"((?P<sign>[+-])\s*(?P<shift>{FLOAT}))?"
)
EXAMPLES = {
    "pressure": "kPa, bar, mbar, hPa, psi, Pa or MPa, each with abs where it counts from a vacuum",
    "length": "mm, cm, m or in",
    "time": "s, ms, us, ns, min, h or days",
    "angle": "rad or deg",
    "mass": "g or kg",
    "temperature": "C, K or F",
    "force": "N or mN",
}
# Of each kind of name: the recording's column (`i` is an axis or a number), and the dimension of its unit.
KINDS = {
    "command": ("pressure_cmd_{chamber}kpa", "pressure"), "measured": ("pressure_{chamber}kpa", "pressure"),
    "pressure": ("", "pressure"), "tip": ("tip_{i}_mm", "length"), "base": ("base_{i}_mm", "length"),
    "gravity": ("gravity_{i}", "acceleration"), "force": ("force_{i}_n", "force"),
    "angle": ("bend_angle_rad", "angle"), "joint": ("q_{i}_rad", "angle"),
    "temperature": ("temperature_c", "temperature"), "payload": ("payload_g", "mass"),
    "time": ("time_s", "time"), "sent": ("time_sent_s", "time"), "trial": ("trial", ""),
    "program": ("program", ""),
}  # fmt: skip
# Kind to the kinds whose words may occur with it.
ALLOWED = {
    "sent": {"time", "command"}, "joint": {"angle", "measured"}, "angle": {"tip", "measured"},
    "temperature": {"?", "measured", "tip", "base"}, "payload": {"tip"}, "trial": set(),
    "program": {"pressure"}, "time": {"measured"}, "date": {"time"}, "frame": set(),
}  # fmt: skip


@dataclass(frozen=True)
class Column:
    """What one column of a table is."""

    name: str  # in the table
    column: str  # of the recording; the own name of a column that is retained as it is
    unit: Unit | None = None  # of its numbers, None where it has none
    factor: float = 1.0  # after the unit is converted, what its numbers are multiplied by
    shift: float = 0.0  # added after that
    guess: str = ""  # how the unit was found where it was not written: `by size`
    retained: bool = False  # whether it is none of a recording's own columns

    @classmethod
    def parsed(cls, name: str, text: str) -> "Column":
        """Of `COLUMN`, `COLUMN [UNIT]`, `COLUMN [UNIT] * FACTOR + SHIFT`, or `-` to leave it out.

        Raises InputError: it is none of these, or the unit is unknown or of another kind.
        """
        text = text.strip()
        if text == name.strip() and not OWN.fullmatch(name):
            return cls(name, name, retained=True)
        if text == LEAVE_OUT:
            return cls(name, LEAVE_OUT)
        found = PARTS.fullmatch(text)
        if not found:
            raise InputError(
                f"columns: {shown(name)} is {shown(text)}; write COLUMN, COLUMN [UNIT] or COLUMN [UNIT] *"
                " FACTOR + SHIFT, such as 'pressure_cmd_kpa [bar]'."
            )
        factor, shift = float(found["factor"] or 1), float((found["sign"] or "") + (found["shift"] or "0"))
        column, unit = found["column"], None
        near = [t for t in TARGETS if t.startswith(f"{column}_")]
        near += difflib.get_close_matches(column, TARGETS, n=1, cutoff=0.85)
        if near and not OWN.fullmatch(column):
            raise InputError(
                f"columns: {shown(column)} of {shown(name)} is no column of a recording; did you mean"
                f" {near[0]!r}?"
            )
        dimension = dimension_of(column)
        if found["unit"]:
            unit = unit_named(found["unit"], dimension)
            if unit is None:
                raise InputError(
                    f"columns: {shown(found['unit'])} of {shown(name)} is no unit of"
                    f" {dimension or 'any kind'}; {shown(column)} takes {EXAMPLES.get(dimension, 'none')}."
                )
        return cls(name, column, unit, factor, shift, retained=not OWN.fullmatch(column))

    def __str__(self):
        text = self.column
        if self.unit is not None:
            text += f" [{self.unit}]"
        if self.factor != 1:
            text += f" * {self.factor:.10g}"
        if self.shift:
            text += f" {'+' if self.shift > 0 else '-'} {abs(self.shift):.10g}"
        return text

    def converted(self, values: pd.Series) -> pd.Series:
        """Its numbers in the unit of the recording's column; texts as they are."""
        if values.dtype.kind not in "fiu" or (self.unit is None and self.factor == 1 and not self.shift):
            return values
        scale = self.factor * (self.unit.factor if self.unit else 1.0)
        shift = self.shift + (self.factor * self.unit.shift if self.unit else 0.0)
        return values.astype(float) * scale + shift


def dimension_of(column: str) -> str:
    """Which kind of unit a recording's column has; empty for none."""
    if re.fullmatch(r"gravity_[xyz]", column):
        return "acceleration"
    unit = base_unit(column) if OWN.fullmatch(column) else None
    return unit.dimension if unit else ""


def parse_columns(text: str | dict[str, str]) -> dict[str, str]:
    """`{a: trial, p [bar]: pressure_cmd_kpa}`, quotes and braces or none, as names to texts of columns.

    Raises InputError: a part has no colon.
    """
    if isinstance(text, dict):
        return {str(k): str(v) for k, v in text.items()}
    inner = text.strip()
    inner = inner[1:-1] if inner.startswith("{") and inner.endswith("}") else inner
    found = {}
    for part in map(str.strip, re.findall(r"(?:\"[^\"]*\"|'[^']*'|[^,\"'])+", inner)):
        name, _, column = part.rpartition(":")
        if part and not (name.strip() and column.strip()):
            raise InputError(
                f"columns is {shown(part)}, which names no column of the recording; write NAME: COLUMN, such"
                " as --columns='p_soll: pressure_cmd_kpa [bar]'."
            )
        if part:
            found[name.strip().strip("\"'")] = column.strip().strip("\"'")
    return found


def guesses(columns: Sequence[Column]) -> str:
    """One sentence on the units of the pose that are guessed and not written; empty where all are written."""
    guessed = [c for c in columns if c.guess == "by size" and dimension_of(c.column) in POSES]
    if not guessed:
        return ""
    units = joined(dict.fromkeys(str(c.unit) for c in guessed))
    names = joined(shown(c.name) for c in guessed)
    return f"No unit is written for {names}; by the size of the numbers {units} was taken."


# ---------------------------------------------------------------- names


@dataclass(frozen=True)
class Named:
    """What a name says: the kind of column, its axis or number, and its unit."""

    kind: str
    index: str = ""
    unit: str = ""


def read_name(name: str, unit: str = "") -> Named:
    """What a column's name, and its unit in a line of units, says; kind is empty where it says nothing."""
    options = [(name, unit)] if unit else [*_with_unit(name), (name, "")]
    for base, found in options:
        kind, index = _kind(base, found)
        warmth = unit_named(found, "temperature") if found and not kind else None
        if warmth is not None and len(warmth.name) > 1 and unit_named(found, "angle") is None:
            kind = "temperature"
        dimension = KINDS.get(kind, ("", ""))[1]
        suits = dimension and unit_named(found, dimension) is not None
        if kind and (not found or suits or "[" in name or "(" in name or unit):
            return Named(kind, index, found)
    last = name.rpartition(".")[2]
    if last and last != name and not unit:  # a field of a struct
        return read_name(last)
    return Named("", "", next((u for _, u in options if u), ""))


def _with_unit(name: str) -> Iterator[tuple[str, str]]:
    """A name split into what is measured and its unit, in the ways that labs write it."""
    for match in reversed(list(re.finditer(r"[\[({<]([^\])}>]*)[\])}>]", name))):
        if unit_named(match[1]) is not None or match[0].startswith("["):
            yield name[: match.start()] + " " + name[match.end() :], match[1].strip()
    for match in (re.fullmatch(pattern, name.strip()) for pattern in UNIT_BEHIND):
        if match and unit_named(match[2]) is not None:
            yield match[1], match[2]


def _kind(base: str, unit: str) -> tuple[str, str]:
    """Kind of column and axis or number of a name without its unit."""
    if re.fullmatch(r"\s*T\s*", base) and (not unit or unit_named(unit, "temperature")):
        return ("temperature", "") if unit else ("T", "")
    plain = {"ß": "ss", "ä": "ae", "ö": "oe", "ü": "ue", "Ä": "ae", "Ö": "oe", "Ü": "ue"}
    text = re.sub(r"([a-z])([A-Z])", r"\1 \2", base.translate(str.maketrans(plain)))
    numbers, tokens = re.findall(r"\d+", text), re.findall(r"[a-z]+", text.lower())
    words = [w for token in tokens for w in _segments(token) or [token]]
    kinds = [KIND.get(w, "?") for w in words]
    have = set(kinds) - {"filler"}
    axes = [w for w, k in zip(words, kinds, strict=True) if k == "axis"]
    index = numbers[0] if len(numbers) == 1 else ""

    if len(axes) == 1 and have - {"measured"} in ({"axis"}, {"axis", "tip"}) and not numbers[1:]:
        return "tip", axes[0]
    for kind in ("gravity", "base", "force"):
        if have == {"axis", kind} and len(axes) == 1:
            return kind, axes[0]
    if have in ({"pressure", "command"}, {"command"}):
        return "command", index
    gauge = bool(unit) and any(unit_named(unit, kind) is not None for kind in ("pressure", "voltage"))
    if have == {"pressure", "measured"} or (have == {"measured"} and gauge):
        return "measured", index
    if have == {"pressure"}:
        return "pressure", index
    for kind, also in ALLOWED.items():
        if kind in have and have - {kind} <= also:
            return kind, index if kind == "joint" else ""
    return "", ""


def _segments(token: str) -> list[str] | None:
    """A compound such as `solldruck` or `tipx` as known words; None where it is none."""
    if token in KIND:
        return [token]
    for end in range(len(token) - 1, 0, -1):
        if token[:end] in KIND and (rest := _segments(token[end:])):
            joined = [token[:end], *rest]
            if sum(len(w) for w in joined) > 1 and all(len(w) > 1 or KIND[w] in SHORT for w in joined):
                return joined
    return None


def respelt(name: str) -> str:
    """The name with words of four letters and more that are nearly known ones, as those are spelt."""

    def known(found: re.Match) -> str:
        word = found[0].lower()
        if _segments(word):
            return found[0]
        near = [w for w in KIND if len(w) > 3 and sorted(w) == sorted(word)]
        return [*near, *difflib.get_close_matches(word, KIND, n=1, cutoff=0.8), found[0]][0]

    return re.sub(r"[^\W\d_]{4,}", known, name)


def meant(column: Column) -> str:
    """The recording's column that a column which is retained as it is seems to be, misspelt; else empty."""
    name = respelt(column.name)
    if not column.retained or name == column.name:
        return ""
    if OWN.fullmatch(name):
        return name
    named = read_name(name)
    target, dimension = KINDS.get(named.kind, ("", ""))
    target = target or "pressure_kpa" * (named.kind == "pressure")
    if named.unit and unit_named(named.unit, dimension) is None or ("{i}" in target and not named.index):
        return ""
    return target.format(i=named.index, chamber=f"{named.index}_" if named.index else "")


def seeming(columns: Sequence[Column], dimension: str, units: str) -> list[str]:
    """`NAME: COLUMN [UNIT]` of columns that are retained as they are and may be what is missing.

    These are misspelt, or have a unit of the `dimension`, or are a signal for a pressure; `units` are those
    to choose from where a name has none. Of pressures that are no commands, and of clocks, there is one.
    """
    one, found = {"pressure": "pressure_cmd_kpa", "time": "time_s"}.get(dimension, ""), {}
    for c in (c for c in columns if c.retained):
        unit, target = read_name(c.name).unit, meant(c)
        right = bool(unit) and unit_named(unit, dimension) is not None
        signal = (_kind(*parts)[0] for parts in _with_unit(c.name)) if dimension == "pressure" else ()
        if dimension_of(target) == dimension:
            found[c.name] = target, f"[{unit if right else units}]"
        elif one and right:
            found[c.name] = one, f"[{unit}]"
        elif any(kind in ("command", "pressure") for kind in signal):
            found[c.name] = one, "* KPA_PER_UNIT + KPA_AT_ZERO"
    chosen = {n: t for n, t in found.items() if not one or t[0] == one or pressure_commands(t[:1])}
    chosen = chosen or {n: (one, how) for n, (_, how) in found.items()}
    if one and len({target for target, _ in chosen.values()}) < len(chosen):
        chosen = dict([*chosen.items()][:1])
    return [f"{name}: {target} {how}" for name, (target, how) in chosen.items()]


# ---------------------------------------------------------------- what they are


def understand(
    frame: pd.DataFrame,
    units: dict[str, str],
    given: dict[str, str],
    file: str,
    length_mm: float | None = None,
    log: bool = False,
    convert: str = "pneutac convert TABLE",
    empty: Sequence[str] = (),
) -> list[Column]:
    """What each column of a table is; what is `given`, name to text of `Column.parsed`, wins.

    `units` are those of a line of units; with `log` the table need not hold the pose, which markers give.
    `empty` are columns that were left out because they hold no number.
    Raises InputError with all that is open, and the option of the command `convert` that answers it.
    """
    given = {n: t for n, t in given.items() if n in frame or t not in (n, LEAVE_OUT)}
    unknown = [n for n in given if n not in frame]
    if unknown:
        raise InputError(f"{file} has no column {shown(unknown[0])}; it has {listed(map(shown, frame))}.")
    table = _Table(frame, given, file, length_mm, convert)
    table.recognise(units)
    if not table.questions:
        table.find_units()
        table.take_ambient_off()
    table.look_for_what_is_missing(log)
    if table.questions:
        what, answers = (dict.fromkeys(part) for part in zip(*table.questions, strict=True))
        has = f" It has {listed(map(shown, frame))}." if any("NAME" in a for a in answers) else ""
        has += f" Nothing is in {listed(map(shown, empty))}." if has and empty else ""
        asked = f"{'; '.join(what)}.".replace("?.", "?")
        raise InputError(
            f"{file}: {asked}{has} Give it as `{convert} --columns={quote(', '.join(answers))}`."
        )
    return table.columns


@dataclass
class _Table:
    frame: pd.DataFrame
    given: dict[str, str]
    file: str
    length_mm: float | None
    convert: str  # the command that reads the table
    columns: list[Column] = field(default_factory=list)
    questions: list[tuple[str, str]] = field(default_factory=list)  # what is open, and how to answer it

    def recognise(self, units: dict[str, str]) -> None:
        """Finds each column by what is given, by a recording's own name, or by its words."""
        stated = (Column.parsed(n, t) for n, t in self.given.items())
        columns, named = {c.name: self._stated(c, units.get(c.name, "")) for c in stated}, {}
        for name in (n for n in self.frame if n not in self.given):
            own = name.strip().lower()
            if not OWN.fullmatch(own):
                named[name] = read_name(name, units.get(name, ""))
                continue
            dimension = dimension_of(own)
            unit = unit_named(units[name], dimension) if name in units else None
            if unit is None and dimension and not re.fullmatch(LABELS, own):
                unit = unit_named(BASE_UNIT.get(dimension, ""), dimension)
            columns[name] = Column(name, own, unit)
        taken = {c.column for c in columns.values()}
        # one clock: `T` next to a time is a temperature; frames and dates count without one
        kinds = {n.kind for n in named.values()} if "time_s" not in taken else set()
        clock = next((k for k in ("time", "T", "date", "frame") if k in kinds), "time")
        meant_as = {"T": "temperature", "date": "", "frame": "", clock: "time"}
        named = {n: replace(v, kind=meant_as.get(v.kind, v.kind)) for n, v in named.items()}
        targets = _targets(named, taken)
        for name, target in targets.items():
            column = Column(name, target)
            columns[name] = self._in_written_unit(column, named[name].unit) if named[name].unit else column
        self.columns = [columns.get(n) or Column(n, n, retained=True) for n in self.frame]
        for target in dict.fromkeys(targets.values()):
            names = [n for n, t in targets.items() if t == target]
            if len(names) > 1:
                what = f"{' and '.join(map(shown, names))} could each be {target}"
                self.questions.append((what, f"{names[0]}: {target}, {names[1]}: -"))

    def _stated(self, column: Column, unit: str) -> Column:
        """A column that is given, without a unit in that of its name, of the line of units, or its own."""
        dimension, unit = dimension_of(column.column), unit or read_name(column.name).unit
        if column.unit or column.retained or not dimension:
            return column
        # what a name only ends with may be a word, not a unit
        suits = any(unit_named(unit, d) for d in (dimension, "voltage")) or "[" in column.name
        if column.factor == 1 and unit and suits:
            column = self._in_written_unit(column, unit)
        if column.unit or column.guess or self.frame[column.name].dtype.kind not in "fiu":
            return column  # also times of day
        full = dimension == "pressure" and column.factor != 1  # a pressure with a factor is stated in full
        own = "" if full else BASE_UNIT.get(dimension, "")
        return replace(column, unit=unit_named(own, dimension))

    def _in_written_unit(self, column: Column, text: str) -> Column:
        dimension = dimension_of(column.column)
        if not dimension:
            return column
        unit = unit_named(text, dimension)
        if unit is None and unit_named(text, "voltage") is not None:
            return replace(column, guess="voltage")
        unitless = text in ("-", "1", "")
        if unit is None and not (unitless or dimension in ("time", "acceleration") and unit_named(text)):
            raise InputError(
                f"{self.file}: the unit {shown(text)} of {shown(column.name)} is unknown for {column.column},"
                f" which takes {EXAMPLES.get(dimension, 'm/s^2 or none')}; give it as `{self.convert}"
                f" --columns='{column.name}: {column.column} [UNIT]'`."
            )
        return replace(column, unit=unit)

    def find_units(self) -> None:
        """Units that are not written, by those of the others or by the size of the numbers."""
        for i, column in enumerate(self.columns):
            target, name, dimension = column.column, column.name, dimension_of(column.column)
            if column.guess == "voltage":
                what = f"{shown(name)} is no pressure but a signal; give kPa for each of its units"
                self.questions.append((what, f"{name}: {target} * KPA_PER_UNIT + KPA_AT_ZERO"))
                continue
            done = column.unit is not None or name in self.given or column.retained or not dimension
            if done or self.frame[name].dtype.kind not in "fiu":
                continue  # also times of day, and what the rules refuse
            kin = [c.unit for c in self._same_quantity(dimension) if c.unit and not c.guess]
            if kin and dimension in POSES:
                if len({unit.scale for unit in kin}) == 1:
                    self.columns[i] = replace(column, unit=kin[0], guess="as the others")
                    continue
                units, question = map(str, kin), f"{shown(name)} has no unit and the others have several"
            else:
                unit = self._by_size(column)
                if isinstance(unit, str):
                    by_size = replace(column, unit=unit_named(unit, dimension), guess="by size")
                    self.columns[i] = by_size if unit else column
                    continue
                what, *units = unit
                question = f"{shown(name)} ({what}) has no unit"
            self.questions.append((question, f"{name}: {target} [{'|'.join(units)}]"))

    def _by_size(self, column: Column) -> str | tuple[str, ...]:
        """The only unit that such numbers have, empty for none, else what they are and the choice."""
        dimension, numbers = dimension_of(column.column), self.frame[column.name].to_numpy(float)
        numbers = numbers[np.isfinite(numbers)]
        top = float(np.abs(numbers).max(initial=0.0))
        if dimension == "pressure":
            extent = f"{numbers.min():.4g} to {numbers.max():.4g}" if len(numbers) else "empty"
            return extent, "kPa", "bar", "psi"
        kin = self._same_quantity(dimension)  # all of a table have one unit, also those without their own
        if dimension == "length":  # by how far the tip is from the base
            tips = [c.name for c in kin if c.column.startswith("tip_")]
            places = self.frame[tips].apply(pd.to_numeric, errors="coerce").to_numpy(float)
            reach = float(np.nanmax(np.linalg.norm(places, axis=1))) if len(places) else 0.0
            if self.length_mm:
                factors = {u: UNITS["length"][u] for u in ("m", "cm", "mm", "in")}
                good = [u for u, mm in factors.items() if 0.7 < reach * mm / self.length_mm < 1.4]
                if len(good) == 1:
                    return good[0]
            if 0.01 <= reach < 1 or reach >= NO_CM:
                return "m" if reach < 1 else "mm"
            return f"{reach:.3g} from the origin", "mm", "cm", "m", "in"
        if dimension == "angle":
            turns = self.frame[[c.name for c in kin]].apply(pd.to_numeric, errors="coerce").to_numpy(float)
            top = float(np.nanmax(np.abs(turns), initial=0.0))
            return "deg" if top > 7 else (f"up to {top:.3g}", "rad", "deg")
        if dimension == "temperature":
            middle = float(np.median(numbers)) if len(numbers) else 20.0
            if 60 <= middle <= 212:
                return f"{middle:.3g} in the middle", "C", "F"
            return "K" if 230 <= middle <= 420 else "C"
        if dimension == "mass":
            return "g" if top >= 1 or top == 0 else (f"up to {top:.3g}", "g", "kg")
        if dimension == "acceleration":
            three = self.frame[[c.name for c in self.columns if c.column.startswith("gravity_")]]
            norm = float(np.nanmedian(np.linalg.norm(three.to_numpy(float), axis=1)))
            return "m/s2" if 9 < norm < 10.5 else ""
        if dimension != "time" or not len(numbers):
            return BASE_UNIT[dimension]
        if re.search(r"frame|bild|sample|index", column.name, re.I):
            return "frames"
        for unit, least in (("ns", 1e17), ("us", 1e14), ("ms", 1e11), ("s", 1e8)):
            if numbers.min() > least:
                return unit  # since 1970
        steps = np.diff(numbers)
        step = float(np.median(steps[steps > 0])) if (steps > 0).any() else 1.0
        if step < 1e-4 and numbers.min() > FIRST_DAY:
            return f"from {numbers.min():.9g} in steps of {step:.3g}", "s", "days"
        return "s" if step < 1 else (f"in steps of {step:.3g}", "s", "ms")

    def _same_quantity(self, dimension: str) -> list[Column]:
        """The recording's own columns of a dimension."""
        return [c for c in self.columns if not c.retained and dimension_of(c.column) == dimension]

    def take_ambient_off(self) -> None:
        """Turns absolute pressures into those above the surroundings; asks where one seems to be absolute."""
        commands = [c for c in self.columns if pressure_commands([c.column])]
        for i, column in enumerate(self.columns):
            if not re.fullmatch(r"pressure_(cmd_)?(\d+_)?kpa", column.column) or column.unit is None:
                continue
            values = pd.to_numeric(self.frame[column.name], errors="coerce")
            kpa = (values.astype(float) * column.unit.factor * column.factor).to_numpy()
            seen = np.isfinite(kpa)
            if not seen.any() or column.shift:
                continue
            rest = float(np.min(kpa[seen]))
            if commands and commands[0] is not column:
                driven = pd.to_numeric(self.frame[commands[0].name], errors="coerce").to_numpy(float)
                low = seen & (driven <= np.nanquantile(driven, 0.05))
                rest = float(np.median(kpa[low])) if low.any() else rest
            near, unit = NEAR_AMBIENT_KPA[0] < rest < NEAR_AMBIENT_KPA[1], column.unit
            if unit.against == "abs":
                ambient = round(rest if near else AMBIENT_KPA, 4)
                gauge = replace(unit, against="")
                self.columns[i] = replace(column, unit=gauge, shift=-ambient, guess="absolute")
            elif near and unit.against != "gauge":
                what = f"{shown(column.name)} is {rest:.4g} kPa at rest, as the air is: an absolute pressure?"
                answer = f"{column.name}: {column.column} [{unit.name} abs|{unit.name} gauge]"
                self.questions.append((what, answer))

    def look_for_what_is_missing(self, log: bool) -> None:
        have = {c.column for c in self.columns}
        asked = bool(self.questions)
        if not asked and not pressure_commands(have):
            gauges = [shown(c.name) for c in self.columns if re.fullmatch(r"pressure_(\d+_)?kpa", c.column)]
            measured = [f"{gauge} is a measured pressure and none is the commanded one" for gauge in gauges]
            what = [*measured, "no column is the commanded pressure"][0]
            answers = seeming(self.columns, "pressure", "kPa|bar|psi")
            if gauges and not answers:
                what += "; where none was logged, the measured one stands for it"
                answers = [f"{gauges[0][1:-1]}: pressure_cmd_kpa"]
            elif answers:
                what += f"; {shown(answers[0].rpartition(': ')[0])} may be it"
            self.questions.append((what, ", ".join(answers) or "NAME: pressure_cmd_kpa [kPa]"))
        posed = any(re.match(r"(tip_[xz]|bend_|q_|curvature_|image)", c) for c in have)
        if not (asked or log or posed):
            what = "no column has the motion of the finger"
            answers = [
                *seeming(self.columns, "length", "mm|cm|m|in"),
                *seeming(self.columns, "angle", "rad|deg"),
            ]
            answer = ", ".join(answers) or "NAME: tip_x_mm [mm], NAME: tip_z_mm [mm]"
            curved = [
                c.name for c in self.columns if re.search(r"curvature|kr(ue|ü)mmung|kappa", c.name, re.I)
            ]
            if curved:
                what += f"; the bend is {shown(curved[0])} (1/m) times the length (m), here of 0.1 m"
                answer = f"{curved[0]}: bend_angle_rad * 0.1"
            self.questions.append((what, answer))


def _targets(named: dict[str, Named], taken: set[str]) -> dict[str, str]:
    """Name in the table to column of the recording."""
    commanded = any(v.kind == "command" for v in named.values()) or any("pressure_cmd" in t for t in taken)
    tips = {n for n, v in named.items() if v.kind == "tip"}
    bare = {n for n in tips if not re.search(r"tip|spitze|marker|tcp|end|pos|koord", n, re.I)}
    out = {}
    for name, v in named.items():
        kind = v.kind
        if kind == "pressure":
            kind = "measured" if commanded else "command"
        if kind == "tip" and name in bare and len(tips - bare) >= 2:
            continue  # `x` next to `tip x` is something else
        target = KINDS.get(kind, ("", ""))[0].format(i=v.index, chamber=f"{v.index}_" if v.index else "")
        if target and target not in taken and (kind != "joint" or v.index):
            out[name] = target
    for role in ("cmd_", ""):  # one chamber is no arm
        numbered = [n for n, t in out.items() if re.fullmatch(rf"pressure_{role}\d+_kpa", t)]
        if len(numbered) == 1:
            out[numbered[0]] = f"pressure_{role}kpa"
    gravity = [n for n, t in out.items() if t.startswith("gravity")]
    if len(gravity) != 3 and not any(t.startswith("gravity") for t in taken):
        out = {n: t for n, t in out.items() if n not in gravity}
    return out
