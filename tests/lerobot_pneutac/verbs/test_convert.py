"""One bend of a finger as every other system would have logged it, made a bench recording."""

from fractions import Fraction

import cv2
import numpy as np
import pandas as pd
import pytest
from scipy.io import savemat
from scipy.spatial.transform import Rotation

from lerobot_pneutac.cli import run_verb
from lerobot_pneutac.cli.terminal import Terminal
from lerobot_pneutac.measuring import DICTIONARY, Intrinsics
from lerobot_pneutac.verbs.convert import ConvertConfig, command, convert
from pneutac_datasets.recording.recording import Recording
from pneutac_sim.errors import InputError

LENGTH, OFFSET_S = 100.0, 0.5  # mm; the markers' clock shows it when the log begins
LAB = Rotation.from_euler("xyz", [20, -35, 70], degrees=True)  # of the base in the lab
ORIGIN_MM = np.array([900.0, 400.0, 250.0])
MARKERS_S = np.arange(0, 6, 1 / 60)


def pressure(time_s):
    """Stairs of the log's clock, kPa."""
    return 3.0 * np.floor(np.clip(time_s, 0, 4.99))


def tip_mm():
    """Tip in the base frame (n, 3): an arc whose angle follows the pressure."""
    bend = 0.01 + 0.06 * pressure(MARKERS_S - OFFSET_S)
    return LENGTH * np.stack([np.sin(bend) / bend, 0 * bend, (1 - np.cos(bend)) / bend], 1)


def lab_mm():
    return LAB.apply(tip_mm()) + ORIGIN_MM


@pytest.fixture
def log(tmp_path):
    t = np.arange(0, 5, 0.1)
    table = {"t": t, "pressure_cmd_kpa": pressure(t), "gauge": pressure(t) + 0.1}
    pd.DataFrame(table).to_csv(tmp_path / "log.csv", index=False)
    return {
        "log": tmp_path / "log.csv",
        "time": "t",
        "columns": {"pressure_cmd_kpa": "pressure_cmd_kpa", "gauge": "pressure_kpa"},
        "offset_s": OFFSET_S,
        "length_mm": LENGTH,
        "out": tmp_path / "bench",
    }


def check(recording, within_mm, steps=5):
    """Whether tip and pressure are those of the truth, on one clock."""
    tip = recording.samples[["tip_x_mm", "tip_y_mm", "tip_z_mm"]].to_numpy()
    kpa = recording.column("pressure_cmd_kpa")
    truth = tip_mm()
    begin = int(np.argmin(np.linalg.norm(truth - tip[-1], axis=1)))
    for level in np.unique(kpa)[:steps]:
        bend = 0.01 + 0.06 * level
        arc = LENGTH * np.array([np.sin(bend) / bend, 0.0, (1 - np.cos(bend)) / bend])
        np.testing.assert_allclose(np.median(tip[kpa == level], 0), arc, atol=within_mm)
    assert len(np.unique(kpa)) >= steps and begin > 0
    return recording


def refused(says, source, **options):
    """Checks that a conversion into a new folder ends in such a sentence and leaves nothing there."""
    out = source.parent / "refused"
    with pytest.raises(InputError, match=says):
        convert(ConvertConfig(source, **options | {"out": out}))
    assert not out.exists()


def optitrack(file, name="Tip"):
    quaternion = LAB.as_quat()
    head = [
        "Format Version,1.23,Take Name,bend,Rotation Type,Quaternion,Length Units,Meters",
        "",
        f",Type,{'Rigid Body,' * 7}Marker,Marker,Marker",
        f",Name,{'Base,' * 7}{name},{name},{name}",
        ",ID,1,1,1,1,1,1,1,2,2,2",
        ",,Rotation,Rotation,Rotation,Rotation,Position,Position,Position,Position,Position,Position",
        "Frame,Time (Seconds),X,Y,Z,W,X,Y,Z,X,Y,Z",
    ]
    rows = []
    for k, (t, p) in enumerate(zip(MARKERS_S, lab_mm() / 1000, strict=True)):
        place = ",," if k == 7 else ",".join(f"{v:.6f}" for v in p)  # unseen for once
        rows.append(f"{k},{t:.5f},{','.join(f'{v:.7f}' for v in [*quaternion, *ORIGIN_MM / 1000])},{place}")
    file.write_text("\n".join([*head, *rows]))
    return file


def vicon(file):
    base = ",".join(f"{v:.4f}" for v in ORIGIN_MM)
    rows = [f"{k + 1},0,{base},{','.join(f'{v:.4f}' for v in p)}" for k, p in enumerate(lab_mm())]
    head = ["Trajectories", "60", ",,Finger:Base,,,Finger:Tip,,", "Frame,Sub Frame,X,Y,Z,X,Y,Z"]
    file.write_text("\n".join([*head, ",,mm,mm,mm,mm,mm,mm", *rows, "", "Devices", "1000"]))
    return file


def test_a_take_of_optitrack_is_turned_into_the_bases_frame(tmp_path, log):
    source = optitrack(tmp_path / "take.csv")
    recording = convert(ConvertConfig(source, tip="Tip", base="Base", date="2026-03-01", **log))
    check(recording, 0.01)
    gauge = recording.column("pressure_kpa") - recording.column("pressure_cmd_kpa")
    assert np.median(gauge) == pytest.approx(0.1, abs=1e-6)
    assert recording.meta["date"] == "2026-03-01" and recording.length_mm == LENGTH
    refused("no marker 'Tipp'; is 'Tip' meant.* --tip", source, tip="Tipp", base="Base", **log)
    refused("base_x is 'x' and base_z '-x'", source, tip="Tip", base="Base", base_z="-x", **log)
    late = log | {"offset_s": 100.0}
    refused("seen in 0 frames .* give --offset_s", source, tip="Tip", base="Base", **late)


def test_of_vicons_markers_x_goes_to_where_the_tip_rests(tmp_path, log):
    recording = convert(ConvertConfig(vicon(tmp_path / "nexus.csv"), tip="Tip", base="Base", **log))
    # The rest bend of 0.01 rad turns the frame by half of it.
    check(recording, 0.6)
    assert recording.column("tip_z_mm").max() > 30  # positive pressure bends towards +z


def test_vicons_objects_are_bodies_with_places_and_quaternions(tmp_path, log):
    def objects(file, with_w):
        turn = LAB.as_quat() if with_w else LAB.as_rotvec()
        base = [*turn, *ORIGIN_MM]
        axes = "RX,RY,RZ,RW,TX,TY,TZ" if with_w else "RX,RY,RZ,TX,TY,TZ"
        gap = "," * (7 if with_w else 6)
        numbers = ([k + 1, 0, *base, *turn, *p] for k, p in enumerate(lab_mm()))
        rows = [",".join(f"{v:.6f}" for v in row) for row in numbers]
        head = ["Objects", "60", f",,Finger:Base{gap}Finger:Tip", f"Frame,Sub Frame,{axes},{axes}"]
        units = ",".join(["rad"] * (len(turn)) + ["mm"] * 3)
        file.write_text("\n".join([*head, f",,{units},{units}", *rows]))
        return file

    options = {"tip": "Tip", "base": "Base"} | log
    check(convert(ConvertConfig(objects(tmp_path / "tracker.csv", True), **options)), 0.01)
    options["out"] = tmp_path / "angles"  # of which the order is unknown: places alone
    check(convert(ConvertConfig(objects(tmp_path / "tracker.csv", False), **options)), 0.6)


def test_a_pointer_of_git_lfs_is_named(tmp_path, log):
    pointer = "version https://git-lfs.github.com/spec/v1\noid sha256:0\nsize 9\n"
    for name in ("lab.csv", "run.mat", "film.mp4"):
        (tmp_path / name).write_text(pointer)
        options = log | DOTS if name == "film.mp4" else {}
        refused(f"{name} is a Git LFS pointer.*git lfs pull", tmp_path / name, **options)


@pytest.mark.parametrize("day", ["23.11.2026", "2026-13-40", "monday"])
def test_a_date_is_a_day(tmp_path, day):
    (tmp_path / "lab.csv").touch()
    with pytest.raises(InputError, match=f"date is '{day}', no day; write it as 2026-03-01"):
        ConvertConfig(tmp_path / "lab.csv", date=day)


def test_a_mat_may_have_all_of_it(tmp_path):
    t = np.arange(0, 5, 0.1)
    bend = 0.01 + 0.06 * pressure(t)
    run = {"clock": t, "p": pressure(t), "angle": bend, "note": "x", "tip": np.zeros((3, len(t)))}
    savemat(tmp_path / "run.mat", {"run": run})
    names = {"run.p": "pressure_cmd_kpa", "run.angle": "bend_angle_rad"}
    options = {"length_mm": LENGTH, "columns": names, "time": "run.clock"}
    recording = convert(ConvertConfig(tmp_path / "run.mat", tmp_path / "bench", **options))
    np.testing.assert_allclose(recording.column("bend_angle_rad"), bend, atol=1e-6)
    refused(r"'run.p' \(0 to 12\) has no unit; 'run.angle' .* --columns='run.p: ", tmp_path / "run.mat")
    says = r"no vector 'clock' of times; it has 'run.clock' 50, .* by --time"
    refused(says, tmp_path / "run.mat", time="clock")
    wrong = options | {"columns": {"run.p": "pressure_cmd_kpa", "run.angel": "bend_angle_rad"}}
    refused(r"has no column 'run.angel'; it has", tmp_path / "run.mat", **wrong)
    (tmp_path / "bad.mat").write_bytes(b"no such thing" * 20)
    refused("is no .mat file", tmp_path / "bad.mat", **options)


def test_the_times_of_a_mat_may_be_a_column_of_a_matrix(tmp_path):
    t = np.arange(0, 5, 0.1)
    bend = 0.01 + 0.06 * pressure(t)
    savemat(tmp_path / "run.mat", {"data": np.stack([t, pressure(t), bend], 1)})
    says = r"'data' 50x3. Give .* --time of .*, such as data_1 for the first column"
    refused(says, tmp_path / "run.mat")
    columns = {"data_2": "pressure_cmd_kpa [kPa]", "data_3": "bend_angle_rad"}
    options = {"length_mm": LENGTH, "columns": columns, "time": "data_1"}
    recording = convert(ConvertConfig(tmp_path / "run.mat", tmp_path / "bench", **options))
    np.testing.assert_allclose(recording.column("time_s"), t, atol=1e-6)
    np.testing.assert_allclose(recording.column("bend_angle_rad"), bend, atol=1e-6)


def test_a_csv_with_names_of_its_own_keeps_clocks_that_start_anew(tmp_path):
    table = {"run": np.repeat([0, 1], 50), "t": np.tile(np.arange(50) / 10, 2)}
    table |= {"p": np.tile(pressure(np.arange(50) / 10), 2), "a": np.linspace(0, 1, 100)}
    pd.DataFrame(table).to_csv(tmp_path / "lab.csv", index=False)
    names = {"run": "trial", "p": "pressure_cmd_kpa", "a": "bend_angle_rad"}
    options = {"length_mm": 80.0, "time": "t", "columns": names}
    recording = convert(ConvertConfig(tmp_path / "lab.csv", tmp_path / "bench", **options))
    assert list(recording.trials()) == [0, 1]
    np.testing.assert_allclose(recording.column("bend_angle_rad"), table["a"], atol=1e-6)
    unnumbered = options | {"columns": {"run": "-", "p": "pressure_cmd_kpa", "a": "bend_angle_rad"}}
    again = convert(ConvertConfig(tmp_path / "lab.csv", tmp_path / "again", **unnumbered))
    np.testing.assert_array_equal(again.column("trial"), table["run"])  # the clock starts anew
    shuffled = pd.DataFrame(table).sample(frac=1, random_state=0)
    shuffled.to_csv(tmp_path / "lab.csv", index=False)
    refused(r"lab.csv: column 'run', row \d+ \(line \d+ .*\) goes back", tmp_path / "lab.csv", **options)


def test_a_ros_2_bag_holds_poses_and_pressures(tmp_path):
    pytest.importorskip("rosbags")
    from rosbags.rosbag2 import Writer
    from rosbags.typesys import Stores, get_typestore

    store = get_typestore(Stores.ROS2_HUMBLE)
    kinds = store.types
    point, quaternion = kinds["geometry_msgs/msg/Point"], kinds["geometry_msgs/msg/Quaternion"]
    pose, stamped = kinds["geometry_msgs/msg/Pose"], kinds["geometry_msgs/msg/PoseStamped"]
    header, stamp = kinds["std_msgs/msg/Header"], kinds["builtin_interfaces/msg/Time"]

    def message(t, place_mm):
        when = stamp(sec=1000 + int(t), nanosec=int(1e9 * (t % 1)))
        at = pose(position=point(*(place_mm / 1000)), orientation=quaternion(*LAB.as_quat()))
        return stamped(header=header(stamp=when, frame_id="lab"), pose=at)

    with Writer(tmp_path / "bag", version=9) as writer:
        kind = "geometry_msgs/msg/PoseStamped"
        tip, base = (writer.add_connection(topic, kind, typestore=store) for topic in ("/tip", "/base"))
        valve = writer.add_connection("/valve", "std_msgs/msg/Float64", typestore=store)
        number = kinds["std_msgs/msg/Float64"]
        for t, place in zip(MARKERS_S, lab_mm(), strict=True):
            ns = int(1e9 * (1000 + t))
            writer.write(tip, ns, store.serialize_cdr(message(t, place), kind))
            writer.write(base, ns, store.serialize_cdr(message(t, ORIGIN_MM), kind))
            kpa = number(data=float(pressure(t - OFFSET_S)))
            writer.write(valve, ns, store.serialize_cdr(kpa, "std_msgs/msg/Float64"))
    options = {"columns": {"/valve.data": "pressure_cmd_kpa"}, "length_mm": LENGTH}
    source = ConvertConfig(tmp_path / "bag", tmp_path / "bench", tip="/tip", base="/base", **options)
    check(convert(source), 0.01)
    (tmp_path / "empty").mkdir()
    refused("is no ROS 2 bag", tmp_path / "empty", tip="/tip", base="/base", **options)


def film(file, draw):
    writer = cv2.VideoWriter(str(file), cv2.VideoWriter_fourcc(*"MJPG"), 10, (640, 480))
    for place in tip_mm()[::6]:
        writer.write(draw(place))
    writer.release()
    return file


DOTS = {"tip_rgb": (220, 30, 30), "base_rgb": (40, 200, 40), "dots_mm": 20.0}


def dots(place, down):
    """A picture, RGB, of two dots at the base and one at the tip; the finger bends downwards by 1, or -1."""
    image = np.full((480, 640, 3), 200, np.uint8)
    for at, rgb in (([0, 0, 0], DOTS["base_rgb"]), ([20, 0, 0], DOTS["base_rgb"]), (place, DOTS["tip_rgb"])):
        u, v = 100 + 4 * at[0], 300 + 4 * down * at[2]
        cv2.circle(image, (round(16 * u), round(16 * v)), 16 * 9, rgb, -1, cv2.LINE_AA, 4)
    return image


def test_coloured_dots_in_a_film_are_found(tmp_path, log):
    source = film(tmp_path / "dots.avi", lambda place: cv2.cvtColor(dots(place, 1), cv2.COLOR_RGB2BGR))
    check(convert(ConvertConfig(source, **DOTS, **log)), 0.4)
    refused("nearly one hue", source, **DOTS | {"base_rgb": (220, 40, 30)} | log)
    refused("A film needs --marker_mm .* or --tip_rgb", source, **log)


def test_frames_of_a_film_are_timed_by_their_own_stamps(tmp_path, log):
    import av

    def stamped(file, times_s):
        with av.open(str(file), "w") as container:
            stream = container.add_stream("mpeg4", rate=30)
            stream.width, stream.height, stream.pix_fmt, stream.bit_rate = 640, 480, "yuv420p", 8_000_000
            stream.codec_context.time_base = Fraction(1, 1000)
            for t in times_s:
                bend = 0.01 + 0.1 * t
                place = LENGTH * np.array([np.sin(bend) / bend, 0, (1 - np.cos(bend)) / bend])
                frame = av.VideoFrame.from_ndarray(dots(place, -1), format="rgb24")
                frame.pts, frame.time_base = round(1000 * t), Fraction(1, 1000)
                container.mux(stream.encode(frame))
            container.mux(stream.encode())

    steps = np.where(np.arange(90) // 15 % 2, 0.1, 0.033)  # 30 and 10 frames a second in turn
    times = np.round(np.cumsum(steps) - steps[0], 3)
    stamped(tmp_path / "vfr.mp4", times)
    t = np.arange(0, 12, 0.1)
    pd.DataFrame({"t": t, "p [kPa]": 3 * t}).to_csv(tmp_path / "log.csv", index=False)
    options = {"log": tmp_path / "log.csv", "length_mm": LENGTH} | DOTS
    recording = convert(ConvertConfig(tmp_path / "vfr.mp4", tmp_path / "bench", **options))
    bend = 0.01 + 0.1 * recording.column("time_s")
    np.testing.assert_allclose(recording.column("tip_z_mm"), LENGTH * (1 - np.cos(bend)) / bend, atol=0.5)
    assert any("s are used, in which both ran: the markers" in w for w in recording.warnings)


def test_aruco_markers_in_a_film_are_found(tmp_path, log):
    matrix = np.array([[800.0, 0, 320], [0, 800, 240], [0, 0, 1]])
    Intrinsics(matrix, np.zeros(5), (640, 480), 0.1).save(tmp_path / "camera.json")
    dictionary = cv2.aruco.getPredefinedDictionary(DICTIONARY)

    def draw(place):
        image = np.full((480, 640), 235, np.uint8)
        for number, at in ((0, np.zeros(3)), (1, place)):  # 250 mm away: 3.2 px a mm
            side, u, v = 64, 170 + 3.2 * at[0], 340 - 3.2 * at[2]
            marker = cv2.aruco.generateImageMarker(dictionary, number, side)
            shift = np.float32([[1, 0, u - side / 2], [0, 1, v - side / 2]])
            cv2.warpAffine(marker, shift, (640, 480), image, borderMode=cv2.BORDER_TRANSPARENT)
        return cv2.cvtColor(image, cv2.COLOR_GRAY2BGR)

    source = film(tmp_path / "aruco.avi", draw)
    options = {"marker_mm": 20.0, "intrinsics": tmp_path / "camera.json"}
    check(convert(ConvertConfig(source, **options, **log)), 1.0)


def test_what_is_missing_is_one_sentence(tmp_path, log):
    options = {k: v for k, v in log.items() if k not in ("log", "time")}
    with pytest.raises(InputError, match="There is no file '.*none.csv'; there is log.csv"):
        ConvertConfig(tmp_path / "none.csv", **options)
    source = optitrack(tmp_path / "take.csv")
    bare = options | {"columns": {}}
    refused("has no column for pressure_cmd_kpa; .* --columns=", source, tip="Tip", base="Base", **bare)
    refused("give --tip and --base", source, **bare)
    (tmp_path / "bench").mkdir()
    (tmp_path / "bench" / "samples.csv").touch()
    with pytest.raises(InputError, match="which exists; give a new folder"):
        ConvertConfig(source, **options)


def test_the_next_command_has_all_that_new_needs(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    t = np.arange(0, 5, 0.1)
    table = {"time_s": t, "pressure_cmd_kpa": pressure(t), "bend_angle_rad": 0.01 + 0.06 * pressure(t)}
    pd.DataFrame(table).to_csv("bends.csv", index=False)
    run_verb("convert", ["bends.csv"])
    following = capsys.readouterr().out.strip().splitlines()[-1]
    assert following == "Do next: pneutac new --twin=TWIN --recording=bends.recording --length_mm=LENGTH"
    run_verb("new", following.replace("LENGTH", "90").split()[4:])


def test_a_unit_that_is_guessed_is_stored_only_where_it_is_confirmed(tmp_path, capsys):
    bend = np.abs(np.sin(np.arange(400) / 40)) + 1e-6
    table = {"run": 0, "t_s": np.arange(400) / 10, "p_set_kpa": 40 * bend}
    table |= {"x": 10 * np.sin(bend) / bend, "z": 10 * (1 - np.cos(bend)) / bend}
    pd.DataFrame(table).to_csv(tmp_path / "lab.csv", index=False)
    given = {"source": tmp_path / "lab.csv", "length_mm": 100.0}
    with pytest.raises(InputError, match="Add --yes"):
        command(ConvertConfig(**given), Terminal("convert", []))
    assert "No unit is written for 'x' and 'z'" in " ".join(capsys.readouterr().out.split())
    assert not (tmp_path / "lab.recording").exists()
    command(ConvertConfig(**given, yes=True), Terminal("convert", []))
    np.testing.assert_allclose(
        Recording.load(tmp_path / "lab.recording").column("tip_z_mm"), 10 * table["z"], atol=1e-4
    )
