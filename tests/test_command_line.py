"""The command line from end to end: what it finds, writes and says, and what it refuses."""

import errno
import json
import os
import re
import shlex
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from gmmcd_teach import METHODS, CloudError, GaussianMixture, read_cloud, simulate_pair, tabletop_pair, write_cloud
from gmmcd_teach.__main__ import main
from gmmcd_teach.formats.atomic import place_folder
from gmmcd_teach.formats.depth import write_depth
from gmmcd_teach.formats.mixtures import read_mixture, write_mixture
from gmmcd_teach.lab.tabletop import TABLETOP_PAIRS, static_pair, tabletop_available
from gmmcd_teach.plausibility import doubts
from gmmcd_teach.regions import contradicted_by, find_regions
from gmmcd_teach.report import FILES, table

RNG = np.random.default_rng(0)
ROOM, ROOM_AGAIN = (RNG.normal(np.eye(3).repeat(260, axis=0), 0.05) for _ in range(2))
BOX = RNG.uniform(2.0, 2.2, (150, 3))
posix = pytest.mark.skipif(os.name != "posix", reason="signals and limits of POSIX")
real = pytest.mark.skipif(not tabletop_available(), reason="no copy of the table-top scans here")


@pytest.fixture
def scans(tmp_path):
    write_cloud(tmp_path / "before.ply", ROOM)
    write_cloud(tmp_path / "after.ply", np.concatenate([ROOM_AGAIN, BOX]))
    return tmp_path / "before.ply", tmp_path / "after.ply", tmp_path / "changes"


def command(scans, *more):
    before, after, out = scans
    small = "--method greedy --components 6 --leaf 0.001"
    return ["detect", str(before), str(after), "--out", str(out), *small.split(), *more]


def run(scans, *more):
    return main(command(scans, "--quiet", *more))


def one_line(error):
    lines = error.strip().splitlines()
    assert len(lines) == 1, error
    assert "gmmcd-teach: " in lines[0]
    return lines[0]


# --- what it finds -------------------------------------------------------------------------------------------------


@pytest.mark.slow
def test_a_new_box_is_found_listed_and_written(scans, capsys):
    assert run(scans, "--json") == 0
    out = scans[2]
    report = json.loads(capsys.readouterr().out)
    assert report == json.loads((out / "report.json").read_text())
    [region] = report["regions"]["appeared"]
    assert np.allclose(region["center"], 2.1, atol=0.02)
    assert region["confidence"] == 1
    assert report["after"]["appeared"] == region["n_points"] == len(read_cloud(out / "appeared.ply")) == 150
    assert read_mixture(out / "after_mixture.npz").n_components <= 6
    assert {path.name for path in out.iterdir()} == set(FILES) - {"disappeared.ply"}
    assert not [path for path in out.parent.iterdir() if path.name.startswith(".")]


@pytest.mark.slow
def test_the_table_names_method_place_size_and_confidence(scans, capsys):
    assert run(scans) == 0
    first, heads, row, *note = capsys.readouterr().out.splitlines()
    assert first.startswith("greedy: 150 of 930 points appeared")
    assert heads.split("  ")[-1].strip() == "confidence"
    assert row.split()[:3] == ["appeared", "1", "150"]
    np.testing.assert_allclose([float(word) for word in row.split()[3:]], [2.1] * 3 + [0.2] * 3 + [1.0], atol=0.015)
    assert len(row) < 80
    assert " ".join(note).startswith("Confidence, appeared: share of the group's points that have nothing")


def test_a_long_list_is_cut_short_in_the_table():
    region = {"n_points": 10, "center": [0.0] * 3, "size": [1.0] * 3, "confidence": 0.5}
    side = {"points": 9, "appeared": 9, "disappeared": 9}
    confidence = {"appeared": "share", "disappeared": "other share"}
    report = {"method": "m", "before": side, "after": side, "seconds": {"total": 1.0}, "confidence": confidence}
    lines = table(report | {"regions": {"appeared": [region] * 13, "disappeared": [region] * 10}}).splitlines()
    assert len(lines) == 2 + 20 + 1 + 2
    assert lines[-3:] == [
        "and 3 smaller groups that appeared: see report.json",
        "Confidence, appeared: share.",
        "Confidence, disappeared: other share.",
    ]
    alike = report | {"confidence": dict.fromkeys(confidence, "share")}
    assert table(alike | {"regions": {kind: [region] for kind in confidence}}).splitlines()[4:] == [
        "Confidence: share."
    ]


def test_columns_stay_apart_however_long_their_numbers():
    far = {"n_points": 123_456_789, "center": [500_484.0, 5_400_222.71, -478.43], "size": [1000.0] * 3}
    side = {"points": 9, "appeared": 9, "disappeared": 9}
    report = {"method": "m", "before": side, "after": side, "seconds": {"total": 1.0}, "confidence": {"appeared": ""}}
    row = table(report | {"regions": {"appeared": [far | {"confidence": 1.0}]}}).splitlines()[2]
    assert [float(word) for word in row.split()[2:]] == [123_456_789, *far["center"], *far["size"], 1.0]


@pytest.mark.slow
def test_an_option_that_a_method_does_not_use_is_said(scans, capsys):
    assert run(scans, "--method", "c2c", "--outliers", "--components", "-9", "--seed", "-1") == 0
    said = capsys.readouterr().err
    assert "warning: c2c does not thin the scans: --leaf 0.001 is not used" in said
    assert "warning: c2c fits no mixture: --components is not used" in said
    assert "warning: c2c does not filter the scans: --outliers is not used" in said
    assert "warning: c2c draws no random numbers: --seed is not used" in said
    assert not {"components", "leaf", "seed"} & set(json.loads((scans[2] / "report.json").read_text()))


@pytest.mark.slow
def test_the_report_tells_the_settings_that_were_used(scans):
    assert run(scans, "--seed", "3") == 0
    report = json.loads((scans[2] / "report.json").read_text())
    assert [report[name] for name in ("method", "components", "leaf", "seed")] == ["greedy", 6, 0.001, 3]


@pytest.mark.slow
@pytest.mark.parametrize(
    ("told", "hint"),
    [
        ((), "taken from: --before-origin, --after-origin"),
        (("--before-origin", "-1e-3", "0", "-2.5E+0"), "taken from: --after-origin"),
        (("--before-origin", "0", "0", "-1", "--after-origin", "0", "0", "-.5"), None),
    ],
    ids=["none", "one", "both"],
)
def test_origins_that_are_missing_are_asked_for(tmp_path, capsys, told, hint):
    rng = np.random.default_rng(0)
    for name in ("a", "b"):
        write_cloud(tmp_path / f"{name}.npy", rng.uniform(0, 1, (3000, 3)) * [1, 1, 0])
    arguments = ["detect", f"{tmp_path}/a.npy", f"{tmp_path}/b.npy", "--out", f"{tmp_path}/out", *told]
    assert main(arguments) == 0
    said = capsys.readouterr().err
    assert (hint in said) if hint else ("taken from" not in said)


@pytest.mark.slow
def test_progress_goes_to_stderr_and_the_table_alone_to_stdout(scans, capsys):
    assert main(command(scans)) == 0
    captured = capsys.readouterr()
    assert re.search("reading before.ply.*detecting by greedy.*writing", captured.err, re.DOTALL)
    assert "detecting" not in captured.out


@pytest.mark.slow
def test_the_page_stands_alone_with_switch_list_and_still(scans, capsys):
    assert run(scans, "--unit", "cm", "--leaf", "0.00001") == 0
    page = (scans[2] / "report.html").read_text()
    assert re.search(r'<button type="button" value="0"[^>]*>before</button>', page)
    assert "appeared 1</td><td>150</td><td>0.02, 0.02, 0.02</td>" in page
    assert "smaller than a hand" in page
    assert "Confidence, appeared: share of" in page
    assert page.count("data:image/png;base64,") >= 1
    assert not re.search(r'(?:src|href)="(?:https?:)?//', page)
    with Image.open(scans[2] / "report.png") as picture:
        assert picture.width > 900


@pytest.mark.slow
def test_results_of_another_run_are_replaced_and_other_files_stay(scans):
    before, after, out = scans
    out.mkdir()
    for name in ("notes.txt", "appeared.ply"):
        (out / name).write_text("mine")
    assert run((after, before, out)) == 0
    assert {path.name for path in out.iterdir()} == (set(FILES) - {"appeared.ply"}) | {"notes.txt"}
    assert len(read_cloud(out / "disappeared.ply")) == 150


@pytest.mark.slow
@pytest.mark.parametrize("method", METHODS)
def test_every_method_runs(tmp_path, method, capsys):
    pair = simulate_pair("cargo_bag", seed=1)
    thin = [cloud[::7] for cloud in (pair.before, pair.after)]
    write_cloud(tmp_path / "a.npz", thin[0])
    write_cloud(tmp_path / "b.npz", thin[1])
    arguments = ["detect", f"{tmp_path}/a.npz", f"{tmp_path}/b.npz", "--out", f"{tmp_path}/out", "--quiet", "--json"]
    assert main([*arguments, "--method", method, "--leaf", "0.05", "--components", "8"]) == 0
    report = json.loads(capsys.readouterr().out)
    assert report["method"] == method
    assert report["after"]["points"] == len(thin[1])


@pytest.mark.slow
def test_depth_images_tell_where_they_were_taken_from(tmp_path, capsys):
    pair = simulate_pair("cargo_bag", seed=1)
    for name, (frame,) in (("a", pair.before_frames), ("b", pair.after_frames)):
        write_depth(tmp_path / f"{name}.png", frame.depth, intrinsics=frame.intrinsics, pose=frame.pose)
    arguments = ["detect", f"{tmp_path}/a.png", f"{tmp_path}/b.png", "--out", f"{tmp_path}/out", "--quiet", "--json"]
    assert main([*arguments, "--method", "greedy", "--leaf", "0.05"]) == 0
    report = json.loads(capsys.readouterr().out)
    assert report["before"]["points"] == np.isfinite(pair.before_frames[0].depth).sum()
    write_cloud(tmp_path / "b.npy", 1000 * read_cloud(tmp_path / "b.png"))
    arguments[2] = f"{tmp_path}/b.npy"
    assert main([*arguments, "--method", "c2c", "--unit", "mm"]) == 0  # the image stays in metres
    assert json.loads(capsys.readouterr().out)["warnings"] == []
    assert len(read_cloud(tmp_path / "out" / "appeared.ply")) < report["after"]["points"] / 3
    assert "looked past" in report["confidence"]["appeared"]


@pytest.mark.slow
@real
def test_a_real_pair_through_two_commands(tmp_path, capsys):
    name = TABLETOP_PAIRS[-1]
    assert main(["pair", name, "--out", f"{tmp_path}/scans"]) == 0
    called, _, words = capsys.readouterr().out.splitlines()[-1].partition(" detect ")
    python, *module = shlex.split(called.removeprefix("Now try: "))
    assert Path(python).samefile(sys.executable)
    assert module == ["-m", "gmmcd_teach"]
    words = shlex.split(words)
    assert main(["detect", *words, "--quiet", "--json", "--leaf", "0.02"]) == 0
    report = json.loads(capsys.readouterr().out)
    assert report["warnings"] == []
    assert report["before"]["points"] == len(tabletop_pair(name).before)
    assert (tmp_path / "scans" / "changes" / "report.html").stat().st_size < 5e6


# --- what it warns of ----------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("before", "after", "says"),
    [
        (1000 * ROOM, 1000 * ROOM_AGAIN, ["before: .* larger than any room; in millimetres", "after: .* millimetres"]),
        (ROOM / 1000, ROOM_AGAIN / 1000, ["before: .* smaller than a hand", "after"]),
        (100 * ROOM, ROOM_AGAIN, ["before is 10. times as wide as after: two units"]),
        (ROOM, ROOM_AGAIN + 2, [r"only 0% of one scan .* two frames\? before x -0.1. to 1.1.*; after x 1.8. to 3.1"]),
        (ROOM, 0 * ROOM, ["after: 100% of the points repeat", "after: 0 x 0 x 0 m, smaller", "before is inf times"]),
        (np.append(ROOM, 0 * ROOM, axis=0), ROOM_AGAIN, ["before: 50% of the points repeat another; fillers"]),
        (np.append(ROOM, [[1e6, 0, 0]], axis=0), ROOM_AGAIN, [r"before: 1000000 x .* within 1\.\d+ m; stray points"]),
        (ROOM, ROOM_AGAIN[::5], ["before has 5 times as many points as after: thinned"]),
    ],
)
def test_clouds_that_are_no_two_scans_in_metres(before, after, says):
    found = doubts(before, after)
    assert len(found) == len(says)
    for text, expected in zip(found, says, strict=True):
        assert re.search(expected, text), text


def walls(n, rng):
    points = rng.uniform(0, 3, (n, 3))
    points[np.arange(n), np.arange(n) % 3] = 0.0
    return points


@pytest.mark.slow
def test_an_unlikely_offset_is_warned_of_and_align_mends_it(tmp_path, capsys):
    rng = np.random.default_rng(1)
    fixed = walls(20_000, rng)
    far = walls(20_000, rng) + np.array([0.15, 0.12, -0.18])
    assert re.search("half of the later scan lies more than 0.1.* not aligned", *doubts(fixed, far))
    write_cloud(tmp_path / "a.ply", fixed)
    write_cloud(tmp_path / "b.ply", far)
    scans = tmp_path / "a.ply", tmp_path / "b.ply", tmp_path / "out"
    assert run(scans, "--align", "--json", "--leaf", "0.1") == 0
    captured = capsys.readouterr()
    report = json.loads(captured.out)
    assert not [text for text in report["warnings"] if "not aligned" in text]
    np.testing.assert_allclose(np.array(report["alignment"])[:3, 3], [-0.15, -0.12, 0.18], atol=0.005)


@pytest.mark.slow
def test_warnings_stay_when_progress_is_quiet(scans, capsys):
    assert run(scans, "--unit", "mm", "--leaf", "0.000001") == 0
    assert "warning: before:" in capsys.readouterr().err


@pytest.mark.slow
@pytest.mark.parametrize("scene", ["cargo_bag", "mixed_frame", "unchanged"])
def test_simulated_pairs_raise_no_doubt(scene):
    pair = simulate_pair(scene, seed=2)
    assert doubts(pair.before, pair.after) == []


@pytest.mark.slow
@real
@pytest.mark.parametrize("name", TABLETOP_PAIRS)
def test_real_pairs_raise_no_doubt(name):
    pair = tabletop_pair(name)
    assert doubts(pair.before, pair.after) == []


@pytest.mark.skipif(not tabletop_available(folder="static"), reason="no copy of the static room here")
def test_the_unchanged_room_raises_no_doubt():
    pair = static_pair()
    assert doubts(pair.before, pair.after) == []


# --- what it refuses -----------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("change", "says"),
    [
        (lambda s: (s[0].with_name("none.ply"), s[1], s[2]), "none.ply: cannot be read"),
        (lambda s: (s[0].parent, s[1], s[2]), "unknown suffix|directory"),
        (lambda s: (s[0], s[1], s[0]), "before.ply: cannot be written .a file; expected a folder"),
        (lambda s: (s[0], s[1], s[0] / "below" / "that"), "that: cannot be written .before.ply is a file"),
    ],
)
def test_bad_paths_end_in_one_line_and_exit_code_2(scans, capsys, change, says):
    assert run(change(scans)) == 2
    assert re.search(says, one_line(capsys.readouterr().err))


@pytest.mark.parametrize("name", ["appeared.ply", "report.png"])
def test_results_never_take_the_place_of_a_scan(scans, capsys, name):
    before, _, out = scans
    out.mkdir()
    write_cloud(out / "appeared.ply", BOX)
    kept = (out / "appeared.ply").read_bytes()
    assert run((before, out / ".." / "changes" / name, out)) == 2
    assert f"{name} is one of the results in" in one_line(capsys.readouterr().err)
    assert (out / "appeared.ply").read_bytes() == kept


@pytest.mark.parametrize("name", ["before.ply", "after.ply"])
def test_a_pair_is_not_written_over_scans(tmp_path, capsys, name):
    (tmp_path / name).write_text("mine")
    assert main(["pair", "unchanged", "--out", str(tmp_path)]) == 2
    assert f"holds {name} already" in one_line(capsys.readouterr().err)
    assert (tmp_path / name).read_text() == "mine"


def test_a_folder_with_the_name_of_a_result_is_refused_before_anything_moves(scans, capsys):
    out = scans[2]
    (out / "report.png").mkdir(parents=True)
    (out / "appeared.ply").write_text("of another run")
    assert run(scans) == 2
    assert "report.png in it is a folder" in one_line(capsys.readouterr().err)
    (out / "report.png").rmdir()

    def a_folder_comes_late() -> None:
        with place_folder(out, FILES) as draft:
            for name in ("appeared.ply", "report.png"):
                (draft / name).write_text("new")
            (out / "report.png").mkdir()

    with pytest.raises(OSError, match=r"report\.png in it is a folder"):
        a_folder_comes_late()
    assert (out / "appeared.ply").read_text() == "of another run"
    assert sorted(path.name for path in out.iterdir()) == ["appeared.ply", "report.png"]


@pytest.mark.parametrize(
    ("cloud", "more", "says"),
    [
        (ROOM, ("--components", "4000"), "--components, or a finer --leaf"),
        (np.append(ROOM, [[1e9, 0, 0]], axis=0), (), "--outliers takes out stray points"),
    ],
)
def test_a_refusal_names_what_helps_on_the_command_line(scans, capsys, cloud, more, says):
    write_cloud(scans[0], cloud)
    assert run(scans, *more) == 2
    assert says in capsys.readouterr().err.splitlines()[-1]


@pytest.mark.parametrize(
    ("more", "says"),
    [
        (("--leaf", "-1"), "leaf_size"),
        (("--leaf", "0"), "leaf_size"),
        (("--leaf", "-1e-3"), "leaf_size"),
        (("--seed", "-1"), "rng"),
        (("--components", "0"), "max_components"),
        (("--components", "4000"), "points"),
        (("--before-origin", "nan", "0", "0"), "before_origin"),
    ],
)
def test_bad_options_end_in_one_line_and_exit_code_2(scans, capsys, more, says):
    assert run(scans, *more) == 2
    assert says in one_line(capsys.readouterr().err)
    assert not scans[2].exists()


def test_an_unknown_pair_is_refused_with_those_there_are(tmp_path, capsys):
    assert main(["pair", "kitchen", "--out", str(tmp_path)]) == 2
    assert "cargo_bag" in one_line(capsys.readouterr().err)


def test_an_unwritable_folder_is_refused_before_the_work(scans, capsys, monkeypatch):
    monkeypatch.setattr("gmmcd_teach.formats.atomic.os.access", lambda path, mode: False)
    monkeypatch.setattr("gmmcd_teach.commands.read_cloud", lambda path: pytest.fail("read before it was asked"))
    assert run(scans) == 2
    assert "changes: cannot be written (no permission" in one_line(capsys.readouterr().err)


@pytest.mark.parametrize("writer", ["write_cloud", "write_mixture"])
def test_a_disk_that_fills_up_leaves_nothing(scans, capsys, monkeypatch, writer):
    def full(*arguments, **options):
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr(f"gmmcd_teach.report.{writer}", full)
    assert run(scans) == 2
    assert "changes: cannot be written (No space left" in one_line(capsys.readouterr().err)
    assert sorted(path.name for path in scans[0].parent.iterdir()) == ["after.ply", "before.ply"]


def test_an_interrupt_leaves_nothing_behind(scans, capsys, monkeypatch):
    def interrupted(*arguments, **options):
        raise KeyboardInterrupt

    monkeypatch.setattr("gmmcd_teach.commands.write_results", interrupted)
    assert run(scans) == 130
    assert "nothing was written" in one_line(capsys.readouterr().err)
    assert sorted(path.name for path in scans[0].parent.iterdir()) == ["after.ply", "before.ply"]


@pytest.mark.slow
@posix
@pytest.mark.parametrize("suffix", [".ply", ".pcd", ".npy"])
def test_ten_million_points_are_read_and_thinned_within_eight_gigabytes(tmp_path, suffix):
    points = np.random.default_rng(0).uniform(0, 19.99, (10_000_000, 3)).astype(np.float32)
    write_cloud(tmp_path / f"a{suffix}", points)
    words = "import sys, gmmcd_teach as g; print(len(g.voxel_downsample(g.read_cloud(sys.argv[1]), 0.5).centroids))"
    import resource

    done = subprocess.run(
        [sys.executable, "-c", words, tmp_path / f"a{suffix}"], capture_output=True, text=True, check=False,
        preexec_fn=lambda: resource.setrlimit(resource.RLIMIT_AS, (8 * 2**30, 8 * 2**30)),
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    assert int(done.stdout) == 40**3


# --- in a process of its own ---------------------------------------------------------------------------------------

MODULE = [sys.executable, "-m", "gmmcd_teach"]


@pytest.mark.slow
@posix
@pytest.mark.parametrize("size", [2_000, 300_000], ids="limit {} bytes".format)
def test_files_that_cannot_be_written_to_their_end(scans, size):
    import resource

    assert run(scans) == 0
    kept = {path: path.read_bytes() for path in scans[2].iterdir()}
    done = subprocess.run(
        [*MODULE, *command(scans, "--quiet", "--seed", "3")],
        capture_output=True, text=True, check=False,
        preexec_fn=lambda: resource.setrlimit(resource.RLIMIT_FSIZE, (size, size)),
    )  # fmt: skip
    assert done.returncode == 2
    assert re.search(r"changes: cannot be written \(File too large\)", one_line(done.stderr))
    assert {path: path.read_bytes() for path in scans[2].iterdir()} == kept
    assert not [path for path in scans[2].parent.iterdir() if path.name.startswith(".")]


@pytest.mark.slow
@posix
def test_ctrl_c_in_the_middle(tmp_path):
    rng = np.random.default_rng(0)
    for name in ("before", "after"):
        write_cloud(tmp_path / f"{name}.npy", rng.uniform(0, 5, (300_000, 3)))
    scans = tmp_path / "before.npy", tmp_path / "after.npy", tmp_path / "changes"
    process = subprocess.Popen([*MODULE, *command(scans, "--leaf", "0.01")], stderr=subprocess.PIPE, text=True)
    try:
        for line in process.stderr:
            if "detecting" in line:
                break
        time.sleep(1)
        process.send_signal(signal.SIGINT)
        _, error = process.communicate(timeout=60)
    finally:
        process.kill()
    assert process.returncode == 130
    assert error.splitlines()[-1].endswith("gmmcd-teach: interrupted; nothing was written")
    assert "Traceback" not in error
    assert sorted(os.listdir(tmp_path)) == ["after.npy", "before.npy"]


@pytest.mark.slow
@posix
@pytest.mark.parametrize(
    ("redirected", "code", "stdout", "stderr"),
    [
        (">/dev/full", 2, "", "written to .*changes, but cannot be printed .No space left"),
        ("2>&-", 0, r"^c2c: 15\d of", "^$"),
        ("2>/dev/null", 0, r"^c2c: 15\d of", "^$"),
        (">&-", 0, "^$", "writing .*changes"),
        ("2>/dev/full", 2, "^$", "^$"),
    ],
)
def test_where_nothing_can_be_printed(scans, redirected, code, stdout, stderr):
    words = shlex.join([*MODULE, *command(scans, "--method", "c2c")])
    done = subprocess.run(f"{words} {redirected}", shell=True, capture_output=True, text=True, check=False)
    assert done.returncode == code
    assert re.search(stdout, done.stdout)
    assert re.search(stderr, done.stderr)
    assert "Traceback" not in done.stderr
    assert (scans[2] / "report.html").exists() == ("2>/dev/full" not in redirected)


@pytest.mark.slow
def test_a_terminal_without_the_letter_spells_it(tmp_path):
    environment = os.environ | {"PYTHONIOENCODING": "ascii"}
    words = [*MODULE, "pair", "unchanged", "--out", str(tmp_path / "räum")]
    done = subprocess.run(words, capture_output=True, text=True, check=False, env=environment)
    assert (done.returncode, done.stderr) == (0, "")
    assert r"r\xe4um" in done.stdout
    assert (tmp_path / "räum" / "after.ply").exists()


@pytest.mark.slow
def test_the_console_command_is_installed():
    script = Path(sys.executable).with_name("gmmcd-teach")
    if not script.exists():
        pytest.skip("not installed with its scripts")
    done = subprocess.run([script, "detect", "--help"], capture_output=True, text=True, check=True)
    assert "exit codes: 0 done" in done.stdout
    assert all(method in done.stdout for method in METHODS)


# --- its parts -----------------------------------------------------------------------------------------------------


def test_mixtures_come_back_as_they_were(tmp_path):
    mixture = GaussianMixture([0.25, 0.75], [[0, 0], [1, 2]], [np.eye(2), 2 * np.eye(2)])
    write_mixture(tmp_path / "m.npz", mixture)
    back = read_mixture(tmp_path / "m.npz")
    for name in ("weights", "means", "covariances"):
        assert np.array_equal(getattr(back, name), getattr(mixture, name))


def test_an_npz_that_is_no_mixture_is_refused(tmp_path):
    np.savez(tmp_path / "m.npz", weights=np.ones(1))
    with pytest.raises(CloudError, match="no covariances, means"):
        read_mixture(tmp_path / "m.npz")
    (tmp_path / "m.npz").write_bytes(b"PK\x03\x04")
    with pytest.raises(CloudError, match=r"m\.npz"):
        read_mixture(tmp_path / "m.npz")


def test_regions_equal_those_of_a_brute_force_flood():
    rng = np.random.default_rng(1)
    points = rng.uniform(0, 1, (150, 3))
    votes = rng.random(150) < 0.5
    cell = np.floor(points / 0.12)
    near = np.abs(cell[:, None] - cell[None]).max(axis=2) <= 1
    left, groups = set(range(150)), []
    while left:
        group, edge = set(), {min(left)}
        while edge:
            group |= edge
            edge = {j for i in edge for j in np.flatnonzero(near[i])} - group
        groups.append((len(group), np.mean(votes[sorted(group)]), *points[sorted(group)].max(axis=0)))
        left -= group
    regions = find_regions(points, 0.12, 1, contradicted=votes)
    assert [r.n_points for r in regions] == sorted((g[0] for g in groups), reverse=True)
    found = sorted((r.n_points, r.confidence, *(np.add(r.center, np.divide(r.size, 2)))) for r in regions)
    np.testing.assert_allclose(found, sorted(groups))


def test_regions_of_hardly_any_points():
    assert find_regions(np.empty((0, 3))) == []
    assert find_regions(np.zeros((1, 3))) == []
    assert [r.n_points for r in find_regions(np.zeros((1, 3)), smallest=1)] == [1]
    assert [r.n_points for r in find_regions(np.zeros((12, 3)))] == [12]
    with pytest.raises(CloudError, match="expected bool of shape"):
        find_regions(np.zeros((2, 3)), contradicted=[1, 0])
    for reach in (0, "x", np.nan, np.inf):
        with pytest.raises(ValueError, match="reach"):
            find_regions(np.zeros((2, 3)), reach=reach)
    with pytest.raises(ValueError, match="smallest"):
        find_regions(np.zeros((2, 3)), smallest="x")


def test_a_claim_is_asked_of_another_scan_only_from_a_position():
    for origin, words in (([0, 0], r"shape \(2,\)"), ([0, 0, np.nan], "NaN"), ("x", "numbers")):
        with pytest.raises(CloudError, match=rf"origin: .*{words}"):
            contradicted_by(BOX, ROOM, origin=origin)
    with pytest.raises(ValueError, match="tolerance"):
        contradicted_by(BOX, ROOM, tolerance=-1)


def test_groups_are_those_of_distinct_points():
    once = find_regions(BOX)
    assert [r.n_points for r in find_regions(BOX.repeat(3, axis=0))] == [3 * r.n_points for r in once]


@pytest.mark.slow
def test_confidence_is_low_on_what_stayed_and_high_on_what_came():
    pair = simulate_pair("mixed_frame", seed=1)
    eye = pair.before_frames[0].pose[:3, 3]
    for origin in (None, eye):
        votes = contradicted_by(pair.after, pair.before, origin=origin)
        stayed = ~pair.appeared & ~pair.hidden_after
        assert votes[stayed].mean() < 0.02
        assert votes[pair.appeared].mean() > 0.6
    seen_past = contradicted_by(pair.after, pair.before, origin=eye)
    nothing_near = contradicted_by(pair.after, pair.before)
    assert seen_past[pair.hidden_after].mean() < nothing_near[pair.hidden_after].mean()
