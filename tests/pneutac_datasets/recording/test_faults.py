"""All faults of a recording at once."""

import json

import numpy as np
import pandas as pd
import pytest

from pneutac_datasets.recording.faults import recording_faults
from pneutac_datasets.recording.recording import Recording
from pneutac_sim.errors import InputError


def bench(folder, change=lambda table: table, **meta):
    n = 120
    p = np.tile(40 * (1 - np.abs(np.linspace(-1, 1, n // 2))), 2)
    table = pd.DataFrame(
        {
            "trial": np.repeat([0, 1], n // 2),
            "time_s": np.tile(np.arange(n // 2) / 10, 2),
            "pressure_cmd_kpa": p,
            "pressure_kpa": p,
            "tip_x_mm": 100 - 0.1 * p,
            "tip_z_mm": p,
        }
    )
    folder.mkdir()
    (folder / "recording.json").write_text(json.dumps({"device": "finger", "length_mm": 110.0} | meta))
    change(table).to_csv(folder / "samples.csv", index=False)
    return folder


def test_a_good_recording_has_notes_only(tmp_path):
    faults, notes = recording_faults(bench(tmp_path / "r"))
    assert faults == [] and all(isinstance(n, str) for n in notes)


def test_every_fault_is_said_and_misspelt_names_are_told_what_they_may_mean(tmp_path):
    def spoil(table):
        table["temperature_c"] = 20.0
        table.loc[7, "temperature_c"] = np.nan
        table[["tip_x_mm", "tip_z_mm"]] /= 1e5
        table["pressure_kpa"] *= 1e5
        return table.rename(columns={"pressure_cmd_kpa": "presure_cmd_kpa", "time_s": "tiem_s"})

    folder = bench(tmp_path / "r", spoil, noise={"tip_x_mm": -1}, spine_joint_position_mm=[10.0])
    faults, _ = recording_faults(folder)
    for words in (
        "field 'noise' of 'tip_x_mm' is -1",
        "'spine_joint_position_mm' is read by nothing; is 'spine_joint_positions_mm' meant?",
        "column 'time_s' is missing (there is 'tiem_s': rename it",
        "column 'pressure_cmd_kpa' is missing (there is 'presure_cmd_kpa': rename it",
        "column 'temperature_c', row 8 (line 9 of the file) is empty",
        "column 'pressure_kpa', row 30 (line 31 of the file) is 3.93",
        "which can only be metres",
    ):
        assert sum(words in f for f in faults) == 1, words
    assert len(faults) == 7
    with pytest.raises(InputError, match="'time_s' is missing .* Missing too: 'pressure_cmd_kpa'"):
        meta = json.loads((folder / "recording.json").read_text())
        (folder / "recording.json").write_text(json.dumps({k: v for k, v in meta.items() if k != "noise"}))
        Recording.load(folder)
