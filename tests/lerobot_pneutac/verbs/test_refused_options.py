"""Options that cannot work, and twins that a verb has no use for, are refused in one sentence."""

import shlex
import shutil
from pathlib import Path

import cv2
import numpy as np
import pytest
from generated import once

from lerobot_pneutac.cli import run_verb
from lerobot_pneutac.verbs.new import new_twin
from pneutac_datasets.generate.gel import write_gel_recording
from pneutac_sim.errors import InputError
from pneutac_sim.gel.model import GelModel
from pneutac_sim.twin import Twin, Value

pytestmark = pytest.mark.slow
GOLDEN = Path(__file__).parents[2] / "golden" / "recordings"
AUGMENT = (
    "--dataset.repo_id=local/demos --dataset.root=demos --output.repo_id=local/o --output.root=o "
    "--fidelity=probe --planner.samples=4 "
)
PLANNER = AUGMENT + "--method=planner "

REFUSED = (
    ("render", "--twin=finger --seconds=1e9", "to 3600 s"),
    ("render", "--twin=finger --particles=1e12", "^--particles is '1e12'; it must be a whole number.$"),
    ("control", "--twin=finger --conditions='{temperature_c: .nan}'", "conditions is .*nan.; give a finite"),
    ("compare", "--twin=endless --recording=bench", "twin.yaml: Twin length_mm is 1e.30; .* at most 10000"),
    ("render", "--twin=finger --particles=3", "it must be 100 or more"),
    ("render", "--twin=finger --conditions='{gravity_z: .nan}'", "conditions is .*nan.; give a finite"),
    ("control", "--twin=finger --conditions='{temprature_c: 3}'", "'temprature_c', which the twin at"),
    ("render", "--twin=finger --conditions='{temperature_c: 30}'", "which .* its effects ask for none"),
    ("render", "--twin=loaded", "payload.*payload_g"),
    ("render", "--twin=finger --indenter=cube", "indenter is of a gel, but .* is of a finger; omit it"),
    ("render", "--twin=finger --size_mm=4", "size_mm is of a gel"),
    ("render", "--twin=finger --depth_mm=1.4", "depth_mm is of a gel"),
    ("render", "--twin=finger --x_mm=0", "x_mm is of a gel"),
    ("render", "--twin=finger --y_mm=0", "y_mm is of a gel"),
    ("render", "--twin=finger --camera=front", "camera is one of a recording; give its folder too"),
    ("render", "--twin=finger --recording=x --view.azimuth_deg=3", "view and recording exclude each other"),
    ("render", "--twin=finger --view.elevation_deg=91", "between -90 and 90"),
    ("render", "--twin=finger --view.azimuth_deg=.nan", "azimuth_deg is nan"),
    ("render", "--twin=finger --view.distance_lengths=1", "does not see the body: give 1.5 to 100"),
    ("render", "--twin=gel --pressure_kpa=[0,5]", "pressure_kpa is of a finger or an arm, but .* of a gel"),
    ("render", "--twin=gel --particles=4000", "particles is of a finger or an arm"),
    ("render", "--twin=gel --seconds=1", "seconds is of a finger or an arm"),
    ("render", "--twin=gel --view.azimuth_deg=3", "view is of a finger or an arm"),
    ("render", "--twin=gel --recording=x", "recording is of a finger or an arm"),
    ("render", "--twin=gel --conditions='{temperature_c: 30}'", "'temperature_c'.*ask for none"),
    ("render", "--twin=gel --x_mm=50", "x_mm is 50, where the sphere misses the gel's window; give a place"),
    ("render", "--twin=gel --y_mm=-50", "y_mm is -50, where the sphere misses"),
    ("render", "--twin=gel --y_mm=.nan", "y_mm is nan"),
    ("render", "--twin=gel --depth_mm=2.4", "2.5 mm thick"),
    ("learn", "--twin=finger --out=o --bench=robot", "bench=robot must be one of standin, measure"),
    ("learn", "--twin=finger --out=o --bench=measure", "go together"),
    ("learn", "--twin=finger --out=o --bench=measure --measure=no.yaml", "^measure=no.yaml is no file"),
    ("learn", "--twin=finger --out=o --program_s=1", "program_s is 1"),
    (
        "learn",
        "--twin=short --out=o",
        "is 110 mm long and the twin's 95 mm; give a twin of that device",
    ),
    ("ppo", "--out=o --task=door", "^task is 'door'"),
    ("ppo", "--out=o --device=tpu", "^device is 'tpu'"),
    ("ppo", "--out=o --seed=-1", "^--seed is -1"),
    ("ppo", "--out=o --twin=nowhere", "^There is no twin at .nowhere. .no twin.yaml."),
    ("surrogate", "--twin=finger --trajectories=5", "trajectories=5 are too few to train on; give 6 or more"),
    ("surrogate", "--twin=finger --contacts=8", "contacts=8 are too few to train on, .* give 9 or more"),
    ("surrogate", "--twin=finger --device=tpu", "device is 'tpu'; it must be one of auto, cpu, cuda"),
    ("surrogate", "--twin=finger --fresh --seconds=0", r"seconds is 0.0; it must lie in \[0.02, 600\]"),
    ("augment", PLANNER + "--task=bottle", "^task is 'bottle'; it must be one of switch, egg, card"),
    ("augment", AUGMENT + "--method=magic", "^method is 'magic'; it must be one of library, expert, planner"),
    ("augment", PLANNER + "--episodes=0", "^episodes is 0; it must be 1 or more"),
    ("augment", PLANNER + "--device=tpu", "^device is 'tpu'; it must be one of cpu, cuda"),
    ("augment", PLANNER + "--device=cuda", "^device=cuda is of method=library, not of planner"),
    ("augment", PLANNER + "--planner.replan=99", "^replan is 99; it must be at most horizon"),
    ("augment", PLANNER + "--twin=demos", "^There is no twin at .*.no twin.yaml."),
    ("augment", PLANNER + "--dataset.root=none", "holds no LeRobotDataset"),
    ("augment", PLANNER + "--start_range=[0,0,0]", "start_range is of library and expert, not of planner"),
    ("augment", PLANNER + "--real_share=0.95", "real_share must be 0 to 0.9"),
    ("augment", PLANNER + "--check_mpm=-1", "check_mpm is -1; give 0 to 100"),
    ("augment", AUGMENT + "--method=naive --check_mpm=1", "naive ones have no scene"),
    ("augment", PLANNER + "--check_mpm=1 --fidelity=mpm", "what fidelity=mpm is already"),
    ("augment", AUGMENT + "--method=library", "planner has options that library does not use"),
    (
        "calibrate",
        "--twin=finger --recording=bench",
        "bench/recording.json: length_mm is 118.5, the twin's is 110",
    ),
    (
        "compare",
        "--twin=finger --recording=bench",
        "bench/recording.json: length_mm is 118.5, the twin's is 110",
    ),
    ("calibrate", "--twin=finger --recording=bench --train_kpa=0,5", "train_kpa is for a fit by images, but"),
    ("calibrate", "--twin=finger --recording=bench --particles=900", "particles is for a fit by images"),
    ("calibrate", "--twin=finger --recording=bench --effects=none", "effects is for a gel.*pneutac add"),
    *(
        (
            verb,
            f"--twin=finger --recording=bench --task=switch{more}",
            "^task is for demonstrations, but bench",
        )
        for verb, more in (("calibrate", ""), ("compare", ""), ("diagnose", ""), ("add", " --effect=creep"))
    ),
    ("compare", "--twin=finger --recording=bench --station=x", "^station is for demonstrations, but bench"),
    ("design", "--twin=finger --recording=bench --task=egg", "^task is for demonstrations, but bench"),
    ("calibrate", "--twin=o --recording=presses --effects=glow", "'glow' is no optics effect"),
    ("calibrate", "--twin=o --recording=presses --effects=creep", "'creep' is no optics effect"),
    ("calibrate", "--twin=o --recording=presses --effects=shadow,illumination_drift", "more than one pair"),
    ("calibrate", "--twin=o --recording=presses --effects=gel_creep", "'gel_creep' .* column hold_s"),
    ("calibrate", "--twin=o --recording=presses --through=splats", "through is 'splats'"),
    ("calibrate", "--twin=o --recording=spoilt", "16 bits"),
    ("calibrate", "--twin=other --recording=presses", "something else"),
    ("new", "--twin=finger --device=finger", "already holds a twin"),
    ("new", "--twin=o --mesh_unit=m", "mesh_unit and mesh_axis are of a --mesh=FILE"),
    ("new", "--twin=o --recording=bench --length_mm=11", "^--length_mm is 11, but bench is of a finger"),
    ("new", "--twin=o --length_mm=-5", "^length_mm is -5; give 1 to 1000 mm"),
    ("new", "--twin=o --length_mm=abc", "^--length_mm is 'abc'; it must be a number.$"),
    ("new", "--twin=o --recording=shown", "^shown holds demonstrations; give a bench recording"),
    ("compare", "--twin=bench/samples.csv --recording=bench", "is a file; give the folder of a twin"),
    ("measure", "--out=bench --bench=standin", "^out=bench is not empty; give a new folder"),
    ("export", "--twin=finger --out=finger/twin.yaml/x.py", "the folder of --out=.*, is a file"),
    *(
        (
            verb,
            f"{options} --out=other",
            "^--out=other is not empty and holds no earlier run of this",
        )
        for verb, options in (("ppo", ""), ("learn", "--twin=finger"), ("demo", "--quick"))
    ),
    *(
        (verb, f"--twin=finger {more} --out=finger/o", "^--out=finger/o lies in --twin=finger")
        for verb, more in (("compare", "--recording=bench"), ("render", ""), ("control", ""), ("learn", ""))
    ),
    (
        "diagnose",
        "--twin=finger --recording=bench --out=bench",
        "^--out=bench lies in --recording=bench",
    ),
    ("compare", "--twin=finger --recording=bench --out=gel", "^--out=gel holds a twin; give another folder"),
    ("report", "finger --out=bench", "^--out=bench holds a recording; give another folder"),
    ("new", "--twin=bench --recording=bench", "^--twin=bench lies in --recording=bench, which is read"),
    (
        "augment",
        PLANNER + "--dataset.root=shown --output.root=shown/o",
        "^--output.root=shown/o lies in --dataset.root=shown, which is read",
    ),
    ("report", "finger --rrd=finger/twin.yaml/x.rrd", "the folder of --rrd=.*, is a file; give a folder"),
    *(
        (verb, f"{twin} --out=o/page.html {more}", "^--out=o/page.html names a file; give a folder")
        for verb, twin, more in (
            ("report", "finger", ""),
            ("compare", "--twin=finger", "--recording=bench"),
            ("diagnose", "--twin=finger", "--recording=bench"),
            ("learn", "--twin=finger", ""),
            ("render", "--twin=finger", ""),
            ("effects", "show creep", ""),
        )
    ),
    ("new", "--twin=o/twin.yaml", "^--twin=o/twin.yaml names a file; give a folder"),
    ("augment", PLANNER + "--output.root=o.csv", "^--output.root=o.csv names a file"),
    *(
        ("convert", f"log.csv --out=o --{option}", f"^{option.partition('=')[0]} is of markers or a film")
        for option in ("log=log.csv", "offset_s=1", "marker_mm=12", "dots_mm=9", "base_offset_mm=1,0,0")
    ),
    ("convert", "film.mp4 --out=o --length_mm=90 --base_z=y", "base_z is of a body with axes"),
    ("convert", "film.mp4 --out=o --length_mm=90 --time=t", "time is of a table, and neither source nor"),
    ("convert", "film.mp4 --out=o --length_mm=90 --mapping=m", "mapping is of a table"),
    ("convert", "film.mp4 --out=o --length_mm=90 --log=log.csv --marker_mm=9 --dots_mm=9", "dots_mm has"),
    ("compare", "--twin=finger --recording=bench --mapping=m.yaml", "^mapping is of a table, and none"),
    ("design", "--twin=finger --recording=bench --payload_g=9", "payload_g is of --hands=payload"),
    ("learn", "--twin=finger --out=o --hands=flip --warm_c=40", "warm_c is of --hands=warm"),
    ("measure", "--bench=standin --out=o --square_mm=9", "square_mm is of a --chessboard"),
    ("measure", "--bench=standin --out=o --recording=bench", "recording is of a `result.json` program"),
    ("augment", AUGMENT + "--method=naive", "(fidelity|planner) is of a simulated scene"),
    ("augment", PLANNER + "--worlds=9", "worlds is of --device=cuda"),
    ("ppo", "--out=o --student.root=o", "^--out=o is or lies in --student.root=o; give another folder"),
    ("augment", PLANNER + "--out=o/r", "^--out=o/r is or lies in --output.root=o; give another folder"),
    ("ppo", "--out=o --student.episodes=9", "student has options, but no folder"),
    ("effects", "list --out=o", "^out is of `show` and `export`"),
    ("check", "bench --twin=finger", "^--twin is of station or demonstrations"),
    ("new", "--twin=o --device=gel --length_mm=50", "length_mm is of a finger or an arm"),
    ("report", "gel --rrd=x.txt", "must end in .rrd"),
    ("report", "gel --recording=x", "goes with --rrd"),
    ("report", "gel --rrd=x.rrd", "--rrd takes a finger or an arm"),
)


@pytest.fixture(scope="module")
def lab(tmp_path_factory):
    """A folder with the twins of a finger, of one that asks for a payload, and of a gel; and a recording."""
    folder, loaded, gel = tmp_path_factory.mktemp("lab"), Twin.builtin(), Twin("gel", 16.0)
    loaded.effects["payload"] = {"share": Value(1.0)}
    GelModel.builtin().into_twin(gel)
    for name, twin in (("finger", Twin.builtin()), ("loaded", loaded), ("gel", gel)):
        twin.save(folder / name)
    new_twin("finger", length_mm=95.0).save(folder / "short")
    text = (folder / "short" / "twin.yaml").read_text().replace("length_mm: 95.0", "length_mm: 1.0e+30")
    (folder / "endless").mkdir()
    (folder / "other").mkdir()
    (folder / "film.mp4").touch()
    (folder / "log.csv").write_text("t,pressure_cmd_kpa\n0,1\n")
    (folder / "other" / "notes.txt").write_text("mine")
    (folder / "endless" / "twin.yaml").write_text(text)
    shutil.copytree(GOLDEN / "finger_creep", folder / "bench")
    shutil.copytree(GOLDEN / "demos", folder / "shown")
    for name in ("presses", "spoilt"):
        once(write_gel_recording, folder=folder / name, seed=0)
    file = folder / "spoilt" / "images" / "ball_0.png"
    cv2.imwrite(str(file), cv2.imread(str(file)).astype(np.uint16) * 256)
    return folder


@pytest.mark.parametrize(("name", "options", "sentence"), REFUSED)
def test_what_cannot_work_is_one_sentence_and_writes_nothing(lab, monkeypatch, name, options, sentence):
    monkeypatch.chdir(lab)
    with pytest.raises(InputError, match=sentence) as e:
        run_verb(name, shlex.split(options))
    assert "\n" not in str(e.value) and not (lab / "o").exists() and not (lab / "outputs").exists()


def test_a_report_overwrites_that_of_the_same_command_alone(lab, monkeypatch, capsys):
    monkeypatch.chdir(lab)
    new_twin("finger", length_mm=118.5).save(lab / "long")
    compare = shlex.split("--twin=long --recording=bench --out=compared")
    run_verb("compare", compare)
    run_verb("compare", compare)  # again is fine
    with pytest.raises(InputError, match="^--out=compared holds the report of `pneutac compare`"):
        run_verb("report", ["long", "--out=compared"])
    with pytest.raises(InputError, match="^--out=compared holds the report of another `pneutac compare`;"):
        run_verb("compare", [*compare, "--seed=3"])


@pytest.mark.parametrize(
    ("verb", "line"),
    [
        ("export", "--twin=long --out=is_there.py"),
        ("effects", "export creep --out=is_there.py"),
        ("report", "long --rrd=is_there.rrd"),
        ("measure", "--chessboard=bench --intrinsics=is_there.json"),
    ],
)
def test_no_file_is_replaced(lab, monkeypatch, verb, line):
    monkeypatch.chdir(lab)
    new_twin("finger", length_mm=118.5).save(lab / "long")
    file = Path(line.rpartition("=")[2])
    file.write_text("mine")
    with pytest.raises(InputError, match=rf"{file.name} is there already; give a new name, or delete it"):
        run_verb(verb, shlex.split(line))
    assert file.read_text() == "mine"


def test_new_says_where_a_recording_gives_the_geometry_alone(lab, monkeypatch, capsys):
    monkeypatch.chdir(lab)
    rows = "\n".join(f"0,{0.1 * k:.1f},{k},{0.1 * k:.1f}" for k in range(2))
    Path("two.csv").write_text(f"trial,time_s,pressure_cmd_kpa,bend_angle_rad\n{rows}\n")
    run_verb("new", shlex.split("--twin=two --recording=two.csv --length_mm=90 --yes"))
    assert "nothing can be fitted to it: two.recording/samples.csv has 2 rows" in capsys.readouterr().out
