"""The command line from end to end, and what it refuses."""

import json

import numpy as np
import pytest

from gmmcd_teach import CloudError, GaussianMixture, read_cloud, write_cloud
from gmmcd_teach.__main__ import main
from gmmcd_teach.formats.mixtures import read_mixture, write_mixture
from gmmcd_teach.regions import find_regions


@pytest.fixture
def scans(tmp_path):
    rng = np.random.default_rng(0)
    room = rng.uniform(0, 1, (800, 3))
    box = rng.uniform(2.0, 2.2, (150, 3))
    write_cloud(tmp_path / "before.ply", room)
    write_cloud(tmp_path / "after.ply", np.concatenate([rng.uniform(0, 1, (800, 3)), box]))
    return tmp_path / "before.ply", tmp_path / "after.ply", tmp_path / "changes"


def run(scans, *more):
    before, after, out = scans
    return main(["detect", str(before), str(after), "--out", str(out), "--components", "4", "--quiet", *more])


def test_a_new_box_is_found_listed_and_written(scans, capsys):
    assert run(scans, "--json") == 0
    out = scans[2]
    report = json.loads(capsys.readouterr().out)
    assert report == json.loads((out / "report.json").read_text())
    [region] = report["regions"]["appeared"]
    assert np.allclose(region["center"], 2.1, atol=0.02)
    assert report["after"]["appeared"] == region["n_points"] == len(read_cloud(out / "appeared.ply")) == 150
    assert read_mixture(out / "after_mixture.npz").n_components <= 4
    page = (out / "report.html").read_text()
    assert "150 points" in page
    assert not [name for name in scans[2].parent.iterdir() if name.name.startswith(".")]


def test_the_table_names_method_place_and_size(scans, capsys):
    assert run(scans) == 0
    lines = capsys.readouterr().out.splitlines()
    assert lines[0].startswith("greedy: 150 of 950 points appeared")
    assert "appeared" in lines[1]
    assert "size 0.2" in lines[1]


@pytest.mark.parametrize(
    ("change", "says"),
    [
        (lambda s: (s[0].with_name("none.ply"), s[1], s[2]), "none.ply: cannot be read"),
        (lambda s: (s[0].parent, s[1], s[2]), "suffix|directory"),
        (lambda s: (s[0], s[1], s[0]), "before.ply: a file; expected a folder"),
        (lambda s: (s[0], s[1], s[0] / "below"), "cannot be written"),
    ],
)
def test_bad_paths_end_in_one_line_and_exit_code_2(scans, capsys, change, says):
    assert run(change(scans)) == 2
    error = capsys.readouterr().err
    assert len(error.splitlines()) == 1
    assert any(part in error for part in says.split("|"))


def test_bad_options_end_in_one_line_and_exit_code_2(scans, capsys):
    assert run(scans, "--leaf", "-1") == 2
    assert len(capsys.readouterr().err.splitlines()) == 1
    assert not scans[2].exists()


def test_an_interrupt_leaves_nothing_behind(scans, capsys, monkeypatch):
    def interrupted(*arguments, **options):
        raise KeyboardInterrupt

    monkeypatch.setattr("gmmcd_teach.__main__.write_results", interrupted)
    assert run(scans) == 130
    assert "nothing was written" in capsys.readouterr().err
    assert sorted(path.name for path in scans[0].parent.iterdir()) == ["after.ply", "before.ply"]


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
    cell = np.floor(points / 0.12)
    near = np.abs(cell[:, None] - cell[None]).max(axis=2) <= 1
    left, groups = set(range(150)), []
    while left:
        group, edge = set(), {min(left)}
        while edge:
            group |= edge
            edge = {j for i in edge for j in np.flatnonzero(near[i])} - group
        groups.append(len(group))
        left -= group
    assert [r.n_points for r in find_regions(points, 0.12, 1)] == sorted(groups, reverse=True)
