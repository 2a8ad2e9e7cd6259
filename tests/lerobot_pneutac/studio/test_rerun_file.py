"""The file for Rerun holds the body in time, and what was measured beside what was predicted."""

from pathlib import Path

from rerun.experimental import RrdReader

from lerobot_pneutac.studio.report import write_rrd
from pneutac_datasets.recording.recording import Recording
from pneutac_sim.twin import Twin

GOLDEN = Path(__file__).parents[2] / "golden" / "recordings"


def _paths(file):
    return set(RrdReader(file).store().schema().entity_paths())


def test_a_sweep_and_a_recording(tmp_path):
    assert write_rrd(tmp_path / "sweep.rrd", Twin.builtin()) == 200
    assert {"/body/skin", "/body/spine", "/bend_deg", "/pressure_kpa"} <= _paths(tmp_path / "sweep.rrd")
    recording = Recording.load(GOLDEN / "finger_creep")
    twin = Twin("finger", recording.length_mm, recording.spine_joint_positions_mm, Twin.builtin().parameters)
    assert write_rrd(tmp_path / "bench.rrd", twin, recording) > 300
    assert {"/body/measured_tip", "/error_mm", "/tip_z_mm/model"} <= _paths(tmp_path / "bench.rrd")
