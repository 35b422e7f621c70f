"""Figures, players and 3-D views: what they draw is checked against oracles, what they write against its promises."""

from __future__ import annotations

import base64
import io
import json
import re
import shutil
import subprocess
import sys
import zipfile
from html import unescape
from pathlib import Path

import matplotlib

matplotlib.use("Agg")

import matplotlib.pyplot as plt
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from matplotlib.colors import to_hex
from PIL import Image

from gmmcd_teach.clouds import CloudError
from gmmcd_teach.em import Record
from gmmcd_teach.figures import (
    COLORS,
    Boxes,
    Camera,
    Ellipsoids,
    Frusta,
    Lines,
    Points,
    picture,
    player,
    plot_clouds,
    plot_confusion,
    plot_extraction,
    plot_flow,
    plot_history,
    plot_mixture,
    plot_scores,
    share_viewer,
    use_style,
    view,
)
from gmmcd_teach.figures.cards import png
from gmmcd_teach.figures.plots import ellipse_axes, evenly, fair_shares, plane_matrix, split
from gmmcd_teach.figures.scenes import VIEW_ANGLE, ellipsoids, fitted_camera, frustum
from gmmcd_teach.figures.style import CYCLE, color_of, distinct_colors
from gmmcd_teach.lab.pair import DepthFrame
from gmmcd_teach.metrics import Confusion
from gmmcd_teach.mixture import GaussianMixture


@pytest.fixture(autouse=True)
def _no_open_figures():
    with matplotlib.rc_context():
        use_style()
        yield
    plt.close("all")


@pytest.fixture
def mixture() -> GaussianMixture:
    return random_mixture(5, 3, seed=3)


def random_mixture(n_components: int, n_dimensions: int, seed: int) -> GaussianMixture:
    rng = np.random.default_rng(seed)
    roots = rng.normal(size=(n_components, n_dimensions, n_dimensions)) * 0.3
    covariances = roots @ roots.swapaxes(1, 2) + 0.001 * np.eye(n_dimensions)
    return GaussianMixture(
        rng.dirichlet(np.full(n_components, 4.0)), rng.normal(size=(n_components, n_dimensions)), covariances
    )


def random_cloud(n: int, seed: int = 0) -> np.ndarray:
    return np.random.default_rng(seed).uniform(-1, 1, (n, 3)) * [2.0, 1.5, 0.5]


def mahalanobis(points, mean, covariance) -> np.ndarray:
    offsets = points - mean
    return np.sqrt(np.einsum("...i,ij,...j->...", offsets, np.linalg.inv(covariance), offsets))


def srcdoc(html: str) -> str:
    return unescape(re.search(r'srcdoc="([^"]*)"', html)[1])


def scene_of(page: str) -> dict:
    packed = base64.b64decode(re.search(r'base64Str: "([^"]+)"', page)[1])
    with zipfile.ZipFile(io.BytesIO(packed)) as archive:
        return json.loads(archive.read("index.json"))


def actors_of(page: str) -> list[list[dict]]:
    """The actors of each panel as the viewer reads them: opacity, colour, vertices."""
    scene = scene_of(page)

    def array(entry: dict) -> np.ndarray:
        return np.frombuffer(base64.b64decode(scene["hashes"][entry["hash"]]["content"]), np.float32).reshape(-1, 3)

    panels = []
    for renderer in scene["scene"]["dependencies"]:
        actors = []
        for actor in (part for part in renderer["dependencies"] if part["type"].endswith("Actor")):
            parts = {part["type"].removeprefix("vtkOpenGL").removeprefix("vtk"): part for part in actor["dependencies"]}
            data = next(part for part in parts["Mapper"]["dependencies"] if part["type"] == "vtkPolyData")
            actors.append(parts["Property"]["properties"] | {"vertices": array(data["properties"]["points"])})
        panels.append(actors)
    return panels


# --- the visual language -------------------------------------------------------------------------------------------


def test_the_palette_is_the_one_of_the_design():
    wanted = {"before": "#0072B2", "after": "#E69F00", "appeared": "#D55E00", "disappeared": "#56B4E9"}
    assert wanted.items() <= COLORS.items()
    grey = [int(COLORS[name][1:3], 16) for name in ("unchanged", "hidden")]
    assert grey[0] < grey[1], "hidden is the lighter grey"


def test_colours_without_a_meaning_are_not_those_with_one():
    assert not set(CYCLE) & set(COLORS.values())
    assert len(set(CYCLE)) == len(CYCLE)
    assert distinct_colors(10)[8:] == list(CYCLE[:2])


@pytest.mark.parametrize("name", ["purple", "#12345", "#12345G", ""])
def test_an_unknown_meaning_is_refused_with_those_allowed(name):
    with pytest.raises(ValueError, match="before, after, appeared"):
        color_of(name)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("module", "absent"),
    [
        ("gmmcd_teach", ["matplotlib", "pyvista", "vtkmodules", "gmmcd_teach.figures"]),
        ("gmmcd_teach.figures", ["pyvista", "vtkmodules", "gmmcd_teach.study"]),
    ],
)
def test_importing_loads_no_more_than_it_needs(module, absent):
    code = f"import {module}, sys; print([name for name in {absent!r} if name in sys.modules])"
    answer = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert answer.stdout.strip() == "[]"


# --- plots ---------------------------------------------------------------------------------------------------------


@given(st.integers(0, 10_000), st.floats(0.5, 3))
def test_ellipse_axes_stand_at_n_std(seed, n_std):
    covariance = random_mixture(1, 2, seed).covariances[0]
    width, height, angle = (float(value[0]) for value in ellipse_axes([covariance], n_std))
    assert width >= height
    for length, degrees in ((width, angle), (height, angle + 90)):
        end = length / 2 * np.array([np.cos(np.radians(degrees)), np.sin(np.radians(degrees))])
        assert mahalanobis(end, 0, covariance) == pytest.approx(n_std, rel=1e-6)


@pytest.mark.parametrize("plane", ["xy", "x-z", "-yz"])
def test_drawn_ellipses_are_the_shadows_of_the_components(mixture, plane):
    ax = plot_mixture(mixture, plane=plane)
    matrix = plane_matrix(plane, 3)
    assert len(ax.patches) == 2 * mixture.n_components
    for k, patch in enumerate(ax.patches[::2]):
        outline = patch.get_patch_transform().transform(patch.get_path().vertices[::3])  # the points on the curve
        shadow = matrix.T @ mixture.covariances[k] @ matrix
        assert mahalanobis(outline, mixture.means[k] @ matrix, shadow) == pytest.approx(2.0, abs=1e-3)


def test_masked_components_take_the_colour_of_their_meaning(mixture):
    ax = plot_mixture(mixture, masks={"appeared": [1, 3]})
    colors = [to_hex(patch.get_facecolor()).upper() for patch in ax.patches[::2]]
    assert colors.count(COLORS["appeared"]) == 2
    assert colors.count(COLORS["after"]) == 3


def test_clouds_are_drawn_in_metres_at_equal_scale_in_the_colours_of_their_masks():
    points = random_cloud(100)
    masks = {"appeared": points[:, 0] > 1, "hidden": points[:, 0] < -1}
    kept = points.copy()
    ax = plot_clouds(points, masks=masks, plane="x-z")
    assert ax.get_aspect() == 1
    assert (ax.get_xlabel(), ax.get_ylabel()) == ("x [m]", "-z [m]")
    drawn = {scatter.get_label(): scatter for scatter in ax.collections}
    assert set(drawn) == {"unchanged", "appeared", "hidden"}
    np.testing.assert_allclose(drawn["appeared"].get_offsets(), points[masks["appeared"]][:, [0, 2]] * [1, -1])
    assert to_hex(drawn["hidden"].get_facecolor()[0]).upper() == COLORS["hidden"]
    np.testing.assert_array_equal(points, kept)
    assert plot_clouds(points, meaning="before", ax=ax) is ax


def test_values_and_groups_colour_every_point():
    points = random_cloud(50)
    by_value = plot_clouds(points, values=points[:, 2], value_label="height [m]").collections[0]
    np.testing.assert_allclose(by_value.get_array(), points[:, 2])
    by_group = plot_clouds(points, groups=np.arange(50) % 3).collections[0]
    assert [to_hex(color).upper() for color in by_group.get_facecolor()[:3]] == list(CYCLE[:3])


@pytest.mark.parametrize(("plane", "n"), [("xx", 3), ("xz", 2), ("x", 3), ("up", 3), ("x-x", 3)])
def test_an_impossible_plane_is_refused(plane, n):
    with pytest.raises(ValueError, match="name two of the axes"):
        plane_matrix(plane, n)


def test_masks_share_out_every_index_once_the_first_mask_first():
    parts = split(6, "unchanged", {"appeared": [0, 1], "hidden": np.array([1, 1, 1, 0, 0, 0], bool), "truth": []})
    assert {name: part.tolist() for name, part in parts.items()} == {
        "unchanged": [3, 4, 5],
        "appeared": [0, 1],
        "hidden": [2],
        "truth": [],
    }
    with pytest.raises(ValueError, match=r"mask 'appeared': shape \(3,\); expected \(4,\)"):
        split(4, "unchanged", {"appeared": np.zeros(3, bool)})


@given(st.lists(st.integers(0, 500), min_size=1, max_size=6), st.integers(0, 1500))
def test_fair_shares_use_the_room_and_favour_the_small(sizes, total):
    shares = fair_shares(sizes, total)
    assert all(0 <= share <= size for share, size in zip(shares, sizes, strict=True))
    assert sum(shares) == min(total, sum(sizes))
    cut = [share for share, size in zip(shares, sizes, strict=True) if share < size]
    assert not cut or max(shares) - min(cut) <= 1


def test_thinning_is_the_same_every_time_and_leaves_no_gap():
    chosen = evenly(10_000, 1000)
    np.testing.assert_array_equal(chosen, evenly(10_000, 1000))
    assert len(np.unique(chosen)) == 1000
    assert np.histogram(chosen, bins=10, range=(0, 10_000))[0].min() > 60


def history() -> list[Record]:
    path = [(3, -50.0, 90.0, "start"), (3, -40.0, 80.0, "step"), (2, -42.0, 60.0, "annihilated")]
    return [Record(*row) for row in [*path, (1, -90.0, 95.0, "removed"), (2, -41.0, 59.0, "polish")]]


def test_history_by_components_shows_the_last_record_of_each_k_and_the_least():
    ax = plot_history(history())
    length, likelihood, star = ax.lines
    np.testing.assert_array_equal(length.get_xydata(), [[3, 80], [2, 60], [1, 95]])
    np.testing.assert_array_equal(likelihood.get_ydata(), [40, 42, 90])
    np.testing.assert_array_equal(star.get_xydata(), [[2, 60]])
    assert star.get_label() == "least: K = 2"
    assert ax.xaxis_inverted()


def test_history_by_iteration_shows_every_record_but_the_polish():
    length, _, died, removed, star = plot_history(history(), over="iteration").lines
    np.testing.assert_array_equal(length.get_ydata(), [90, 80, 60, 95])
    np.testing.assert_array_equal(died.get_xdata(), [2])
    np.testing.assert_array_equal(removed.get_xdata(), [3])
    np.testing.assert_array_equal(star.get_xydata(), [[2, 60]])


@pytest.mark.parametrize(("records", "over"), [([], "n_components"), (history(), "time")])
def test_a_history_without_records_or_with_an_unknown_axis_is_refused(records, over):
    with pytest.raises(ValueError, match="'n_components' or 'iteration'"):
        plot_history(records, over=over)


def test_lines_of_flow_are_as_wide_as_their_mass_and_end_at_the_means():
    before, after = random_mixture(2, 3, seed=1), random_mixture(3, 3, seed=2)
    flow = np.array([[0.4, 0.1, 0.0], [0.0, 0.2, 0.3]])
    ax = plot_flow(before, after, flow, widest=8)
    lines = next(item for item in ax.collections if isinstance(item, matplotlib.collections.LineCollection))
    np.testing.assert_allclose(lines.get_linewidths(), 8 * np.array([0.4, 0.1, 0.2, 0.3]) / 0.4)
    np.testing.assert_allclose(lines.get_segments()[3], [before.means[1, :2], after.means[2, :2]])
    with pytest.raises(ValueError, match=r"expected \(2, 3\)"):
        plot_flow(before, after, flow.T)


def test_extraction_scores_and_confusion_show_the_numbers_given():
    ax = plot_extraction([0.5, 0.2, 0.1], names=["bag", "dock"], tried=[[1, 0.3]])
    np.testing.assert_array_equal(ax.lines[0].get_ydata(), [0.5, 0.2, 0.1])
    assert [text.get_text() for text in ax.texts] == ["bag", "dock"]

    samples = np.random.default_rng(0).uniform(size=40)
    ax = plot_scores({"greedy": {"F1": samples, "recall": samples / 2}}, published={"F1": 0.727})
    assert [bar.get_height() for bar in ax.patches] == pytest.approx([samples.mean(), samples.mean() / 2])
    whiskers = ax.collections[0].get_segments()
    assert whiskers[0][:, 1] == pytest.approx(np.quantile(samples, [0.025, 0.975]))

    ax = plot_confusion(Confusion(tp=5, fp=1, fn=2, tn=1234))
    assert [text.get_text() for text in ax.texts] == ["5\ntrue +", "1\nfalse +", "2\nfalse -", "1,234\ntrue -"]


# --- still pictures and players ------------------------------------------------------------------------------------


@pytest.mark.slow
def test_a_small_png_keeps_the_colours_that_mean_something():
    figure, ax = plt.subplots()
    plot_clouds(random_cloud(3000), values=np.arange(3000), ax=ax)
    for i, color in enumerate(COLORS.values()):
        ax.plot(i, 2.5, "s", ms=8, color=color)
    image = np.asarray(Image.open(io.BytesIO(png(figure))).convert("RGB"))
    found = {"#{:02X}{:02X}{:02X}".format(*color) for color in np.unique(image.reshape(-1, 3), axis=0)}
    assert set(COLORS.values()) <= found


def test_a_picture_carries_its_words_and_closes_its_figure(tmp_path):
    figure = plot_clouds(random_cloud(10)).figure
    shown = picture(figure, alt='A cloud, "as seen" from <above>.', caption="Look at x < 0 & y.")
    assert not plt.fignum_exists(figure.number)
    html = shown._repr_html_()
    assert 'alt="A cloud, &quot;as seen&quot; from &lt;above&gt;."' in html
    assert "<figcaption>Look at x &lt; 0 &amp; y.</figcaption>" in html
    assert ids(html) != ids(shown._repr_html_()), "each showing has an id of its own"
    shown.save(tmp_path / "a.png")
    with Image.open(tmp_path / "a.png") as image:
        assert image.size[0] == pytest.approx(2 * shown.width, abs=2)


def ids(html: str) -> list[str]:
    return re.findall(r' id="([^"]+)"', html)


def growing(axes, i: int) -> None:
    axes.plot([0, i], [0, i])
    axes.set(xlim=(0, 10), ylim=(0, 10))


def test_a_player_holds_every_frame_and_fetches_nothing():
    film = player(growing, 6, alt="A line that grows.", caption="See the slope.", figsize=(3, 2))
    html = film._repr_html_()
    frames = json.loads(re.search(r"const frames = (\[.*?\]), labels", html)[1])
    images = [Image.open(io.BytesIO(base64.b64decode(frame))) for frame in frames]
    assert len(set(frames)) == 6
    assert len({image.size for image in images}) == 1
    assert not re.search(r"https?:|//cdn|<link|@import", html)
    assert len(html) < 100_000
    assert not plt.get_fignums()


def test_a_player_can_be_worked_by_keyboard_and_read_aloud_and_never_starts_by_itself():
    html = player(growing, 3, alt="A line that grows.", labels=["one", "two", "<b>three"])._repr_html_()
    assert '<button type="button">Play</button>' in html
    assert re.search(
        r'<input type="range" min="0" max="2" value="0" step="1" aria-label="Frame" aria-valuetext="one">', html
    )
    assert "prefers-reduced-motion: reduce" in html
    assert html.count("setInterval(") == 1, "the only timer is the button's"
    assert "<b>three" not in html, "a label is text, in the page and in its script"
    assert 'alt="A line that grows."' in html


def test_players_on_one_page_are_kept_apart():
    film = player(growing, 2, alt="A line.")
    first, second = film._repr_html_(), film._repr_html_()
    assert len({*ids(first), *ids(second)}) == 2
    assert f'"#{ids(first)[0]}:not' in first
    assert ids(first)[0] not in second


@pytest.mark.slow
def test_a_player_takes_figures_too_and_several_axes():
    figures = [plot_extraction([1.0, 1.0 / (i + 1)]).figure for i in range(3)]
    assert len(player(figures, alt="Falling.").frames) == 3
    assert not plt.get_fignums()
    pair = player(lambda axes, i: [ax.plot([0, i]) for ax in axes], 2, ncols=2, alt="Two lines.")
    assert len(pair.frames) == 2


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"alt": " "}, "alt"),
        ({"n_frames": 0}, "at least one frame"),
        ({"n_frames": None}, "give n_frames"),
        ({"labels": ["a"]}, "1 for 2 frames"),
        ({"pause": 0}, "pause"),
    ],
)
def test_a_player_refuses_what_it_cannot_show(options, message):
    with pytest.raises(ValueError, match=message):
        player(growing, **({"n_frames": 2, "alt": "A line."} | options))


# --- scenes --------------------------------------------------------------------------------------------------------


@given(st.integers(0, 10_000), st.floats(0.5, 3))
def test_ellipsoids_stand_at_n_std_and_enclose_the_right_volume(seed, n_std):
    mixture = random_mixture(2, 3, seed)
    vertices, triangles = ellipsoids(mixture.means, mixture.covariances, n_std, n_around=40, n_along=31)
    for k in range(2):
        distances = mahalanobis(vertices[k], mixture.means[k], mixture.covariances[k])
        np.testing.assert_allclose(distances, n_std, rtol=1e-6)
        a, b, c = (vertices[k] - mixture.means[k])[triangles].swapaxes(0, 1)
        volume = abs(np.einsum("ti,ti->t", a, np.cross(b, c)).sum() / 6)
        assert volume == pytest.approx(
            4 / 3 * np.pi * n_std**3 * np.sqrt(np.linalg.det(mixture.covariances[k])), rel=0.03
        )


def test_an_ellipsoid_is_a_closed_surface():
    vertices, triangles = ellipsoids([[0, 0, 0]], [np.eye(3)])
    edges = np.sort(np.concatenate([triangles[:, [0, 1]], triangles[:, [1, 2]], triangles[:, [2, 0]]]), axis=1)
    _, counts = np.unique(edges, axis=0, return_counts=True)
    assert (counts == 2).all()
    assert vertices.shape[1] - len(counts) + len(triangles) == 2


@pytest.mark.slow
def test_the_projection_is_vtks(mixture):
    vtk = pytest.importorskip("vtkmodules.vtkRenderingCore")
    camera = Camera((-2.0, -3.0, 2.5), (0.1, 0.2, 0.3), (0.0, 0.0, 1.0))
    theirs = vtk.vtkCamera()
    theirs.SetPosition(camera.position)
    theirs.SetFocalPoint(camera.focal_point)
    theirs.SetViewUp(camera.up)
    theirs.SetViewAngle(VIEW_ANGLE)
    theirs.SetClippingRange(0.1, 100)
    elements = theirs.GetCompositeProjectionTransformMatrix(1, -1, 1)
    matrix = np.array([[elements.GetElement(i, j) for j in range(4)] for i in range(4)])
    homogeneous = np.c_[mixture.means, np.ones(5)] @ matrix.T
    np.testing.assert_allclose(camera.project(mixture.means), homogeneous[:, :2] / homogeneous[:, 3:], atol=1e-9)


@pytest.mark.parametrize("name", ["oblique", "top", "front", "back", "side", "sensor"])
@pytest.mark.parametrize("aspect", [1.0, 1.5])
def test_every_camera_sees_all_lines_and_nearly_all_points_and_is_close(name, aspect):
    cloud = np.vstack([random_cloud(2000), [[50.0, 0, 0]]])
    meshes = [*Points(cloud).meshes(), *Boxes([[-2, -1.5, -0.5], [2, 1.5, 0.8]]).meshes()]
    seen = np.abs(fitted_camera(meshes, name, aspect=aspect).project(np.vstack([meshes[1].vertices, cloud[:-1]])))
    assert (seen <= [aspect, 1]).all()
    assert (seen.max(axis=0) / [aspect, 1]).max() > 0.6


def test_frusta_start_at_the_camera_and_end_at_the_corners_of_its_image():
    turn = np.array([[0, -1, 0], [1, 0, 0], [0, 0, 1.0]])
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = turn, [1, 2, 3]
    frame = DepthFrame(np.ones((6, 8)), pose, (10.0, 11.0, 4.2, 3.1))
    corners = frustum(frame, 0.5)
    (mesh,) = Frusta([frame], reach=0.5).meshes()
    np.testing.assert_array_equal(mesh.vertices, corners)
    np.testing.assert_allclose(corners[0], [1, 2, 3])
    local = (corners[1:] - [1, 2, 3]) @ turn
    np.testing.assert_allclose(local[:, 2], 0.5)
    pixels = local[:, :2] / local[:, 2:] * [10, 11] + [4.2, 3.1]
    np.testing.assert_allclose(pixels, [[0, 0], [8, 0], [8, 6], [0, 6]], atol=1e-12)


def test_a_box_has_twelve_edges_along_the_axes():
    (box,) = Boxes([[0, 0, 0], [1, 2, 3]], "truth").meshes()
    lengths = np.linalg.norm(box.vertices[box.lines[:, 0]] - box.vertices[box.lines[:, 1]], axis=1)
    assert sorted(lengths) == [1] * 4 + [2] * 4 + [3] * 4


# --- views ---------------------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def cloud() -> np.ndarray:
    return random_cloud(3000)


@pytest.fixture(scope="module")
def scene(cloud):
    mixture = random_mixture(4, 3, seed=3)
    return view(
        {
            "before": [Points(cloud, masks={"disappeared": cloud[:, 0] > 1.5})],
            "after": [
                Points(cloud, masks={"appeared": cloud[:, 0] < -1.5}),
                Ellipsoids(mixture, masks={"appeared": [2]}),
                Lines(cloud[:3], cloud[3:6], "camera", "rays"),
            ],
        },
        alt='Two scans, one "beside" the other.',
        caption="Turn it.",
    )


@pytest.mark.slow
def test_a_view_is_a_lazy_frame_with_words_and_a_still_picture(scene):
    html = scene._repr_html_()
    assert html.count("<iframe") == 1
    assert 'title="Two scans, one &quot;beside&quot; the other."' in html
    assert 'loading="lazy"' in html
    assert "<figcaption>Turn it.</figcaption>" in html
    assert "<summary>Still picture</summary>" in html
    assert re.search(r'<img class="gmmcd-still dark-light"[^>]* alt="Two scans', html)
    assert "@media print" in html
    assert "<noscript>" in html
    assert len({*ids(html), *ids(scene._repr_html_())}) == 2


@pytest.mark.slow
def test_a_view_loads_nothing(scene, tmp_path):
    saved = scene.save(tmp_path / "view.html").read_text(encoding="utf-8")
    for page in (scene.page, srcdoc(scene._repr_html_()), saved):
        tags = re.sub(r"(<script[^>]*>).*?</script>", r"\1", page, flags=re.DOTALL)
        sources = re.findall(r"""(?:src|href|action|data)\s*=\s*["']?([^"'\s>]+)""", tags)
        assert all(source.startswith("data:") for source in sources)
        assert "@import" not in tags
        assert not re.search(r"""url\(\s*["']?https?:""", page)
        addresses = set(re.findall(r"https?://[\w.-]+", page))
        assert addresses <= {
            "http://www.kitware.com",  # a licence and links in comments, and a base for relative addresses
            "http://any",
            "https://kitware.github.io",
            "https://karthikkaranth.me",
        }
        assert "favicon-" not in page


@pytest.mark.slow
def test_the_legend_names_each_meaning_once_and_knows_its_actors(scene):
    page = scene.page
    names = re.findall(r'<label><input type="checkbox" checked value="\d+"><i style="[^"]*"></i>([^<]*)</label>', page)
    ellipsoid = "(ellipsoid at 2 standard deviations)"
    assert names == ["unchanged", "disappeared", "appeared", f"after {ellipsoid}", f"appeared {ellipsoid}", "rays"]
    parts = json.loads(re.search(r"const parts = (\[\[.*?\]\]),", page)[1])
    assert parts == [[0, 1], [0, 2, 3, 4, 5]]
    assert [len(actors) for actors in actors_of(page)] == [2, 5]


def test_the_scene_holds_the_points_and_the_ellipsoids_to_a_fraction_of_a_millimetre(scene, cloud):
    before, after = actors_of(scene.page)
    np.testing.assert_allclose(before[1]["vertices"], cloud[cloud[:, 0] > 1.5], atol=5e-4)
    color = "#{:02X}{:02X}{:02X}".format(*(round(255 * x) for x in after[1]["diffuseColor"]))
    assert color == COLORS["appeared"]
    mixture = random_mixture(4, 3, seed=3)
    distances = mahalanobis(after[3]["vertices"], mixture.means[2], mixture.covariances[2])
    np.testing.assert_allclose(distances, 2, atol=0.02)


def test_both_panels_have_one_camera(scene):
    first, second = (renderer["calls"][0] for renderer in scene_of(scene.page)["scene"]["dependencies"])
    assert first == second
    assert first[0] == "setActiveCamera"


def test_the_same_view_is_the_same_page(cloud):
    pages = {view([Points(cloud, "before")], alt="A cloud.").page for _ in range(2)}
    assert len(pages) == 1


@pytest.mark.slow
def test_a_page_stays_light(mixture):
    big = view([Points(random_cloud(300_000), groups=np.arange(300_000)), Ellipsoids(mixture)], alt="Many points.")
    assert len(big.page) < 1_800_000
    assert len(big.still) < 300_000
    assert sum(len(actor["vertices"]) for actor in actors_of(big.page)[0][:1]) == 40_000


def test_few_changed_points_survive_the_thinning():
    points = random_cloud(50_000)
    crowd = view([Points(points, masks={"appeared": np.arange(100)})], alt="A crowd.", max_points=1000)
    assert [len(mesh.vertices) for mesh in crowd.panels[""]] == [900, 100]


@pytest.mark.slow
def test_making_a_page_is_silent_needs_no_network_and_leaves_the_process_as_it_was():
    code = """
import os, socket, threading

def refuse(*_, **__):
    raise AssertionError("the network was asked for")

socket.getaddrinfo = socket.socket.connect = socket.socket.bind = refuse
from gmmcd_teach.figures import Points, view
view([Points([[0, 0, 0], [1, 1, 1]])], alt="Two points.").page
assert "VTK_DEFAULT_OPENGL_WINDOW" not in os.environ
assert threading.active_count() == 1
"""
    answer = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert (answer.returncode, answer.stdout, answer.stderr) == (0, "", "")


def test_a_view_tells_the_extent_of_all_points_also_of_those_it_leaves_out():
    cloud = np.zeros((1001, 3))
    cloud[500] = 3, 2, 1  # the one far point, which is not drawn
    scene = view([Points(cloud)], alt="A far point.", max_points=10)
    assert len(scene.panels[""][0].vertices) == 10
    assert np.ptp(scene.panels[""][0].vertices, axis=0).max() == 0
    assert "x, y, z extent 3.00 × 2.00 × 1.00 m" in scene.page


@pytest.mark.parametrize(
    ("layers", "options", "error", "message"),
    [
        ([Points([[0, 0, 0]])], {"alt": ""}, ValueError, "alt"),
        ([], {}, ValueError, "nothing to draw"),
        ({}, {}, ValueError, "nothing to draw"),
        ([Points([[0, 0, 0]])], {"camera": "below"}, ValueError, "oblique, top, front, back, side, sensor"),
        ([Points([[0, 0, 0]], "red")], {}, ValueError, "not one of before"),
        ([Points([[0, 0]])], {}, CloudError, r"expected \(N, D\) with D = 3"),
        ([Points([[0, 0, np.nan]])], {}, CloudError, "NaN"),
        ([Points([[0, 0, 0]], masks={"hidden": np.ones(2, bool)})], {}, ValueError, "mask 'hidden'"),
        ([Points([[0, 0, 0]])], {"max_points": 0}, ValueError, "at least 1"),
    ],
)
def test_a_view_refuses_what_it_cannot_show(layers, options, error, message):
    with pytest.raises(error, match=message):
        view(layers, **({"alt": "A view."} | options))


def test_saving_is_all_or_nothing(scene, tmp_path, monkeypatch):
    path = tmp_path / "view.html"
    path.write_text("the old page")

    def fail(*_):
        raise OSError(28, "No space left on device")

    with monkeypatch.context() as patch:
        patch.setattr("gmmcd_teach.formats.atomic.os.replace", fail)
        with pytest.raises(OSError, match="No space"):
            scene.save(path)
    assert path.read_text() == "the old page"
    assert list(tmp_path.iterdir()) == [path]

    scene.save(path, title="Two <scans>", extra="<table><tr><td>1</td></tr></table>")
    page = path.read_text(encoding="utf-8")
    assert "<title>Two &lt;scans&gt;</title>" in page
    assert "<table><tr><td>1</td></tr></table>" in page
    assert 'alt="Two scans' in page
    assert list(tmp_path.iterdir()) == [path]
    assert path.stat().st_size < 2_000_000
    with pytest.raises(FileNotFoundError):
        scene.save(tmp_path / "nowhere" / "view.html")


# --- a built book shares the viewer --------------------------------------------------------------------------------


@pytest.fixture
def site(scene, tmp_path):
    other = view([Points(random_cloud(50))], alt="Fifty points.")
    (tmp_path / "deep" / "er").mkdir(parents=True)
    (tmp_path / "a.html").write_text(f"<p>é</p>{scene._repr_html_()}<p>and</p>{other._repr_html_()}", encoding="utf-8")
    (tmp_path / "deep" / "er" / "b.html").write_text(scene._repr_html_(), encoding="utf-8")
    (tmp_path / "plain.html").write_text("<p>no view</p>")
    return tmp_path


def weight(root: Path) -> int:
    return sum(path.stat().st_size for path in root.rglob("*") if path.is_file())


def test_a_built_book_carries_the_viewer_once_and_loses_nothing(site, scene):
    before = weight(site)
    saved = share_viewer(site)
    assert saved == before - weight(site)
    assert saved > 2_000_000
    (script,) = site.rglob("*.js")
    for page, count in (("a.html", 2), ("deep/er/b.html", 1)):
        html = (site / page).read_text(encoding="utf-8")
        assert "srcdoc" not in html
        sources = re.findall(r'<iframe class="gmmcd-view" src="([^"]+)"', html)
        assert len(sources) == count
        frame = ((site / page).parent / sources[0]).resolve()
        shared = frame.read_text(encoding="utf-8")
        tag = f'<script defer src="{script.name}"></script>'
        assert frame.parent == script.parent
        viewer = script.read_text(encoding="utf-8").removeprefix("(() => {\n").removesuffix("\n})();\n")
        assert shared.replace(tag, f'<script type="module">{viewer}</script>') == scene.page
    assert share_viewer(site) == 0
    assert (site / "plain.html").read_text() == "<p>no view</p>"


def test_a_view_without_a_viewer_is_reported(tmp_path):
    (tmp_path / "a.html").write_text('<iframe class="gmmcd-view" srcdoc="nothing">')
    with pytest.raises(ValueError, match=r"a\.html: a 3-D view without its viewer"):
        share_viewer(tmp_path)


# --- in a browser --------------------------------------------------------------------------------------------------

BROWSER = next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), None)


@pytest.mark.slow
@pytest.mark.skipif(BROWSER is None, reason="no Chromium on this machine")
@pytest.mark.parametrize("shared", [False, True], ids=["alone", "viewer shared"])
def test_the_scene_comes_to_life_from_a_file(scene, tmp_path, shared):
    page = scene.save(tmp_path / "view.html")
    if shared:
        page.write_text(scene._repr_html_(), encoding="utf-8")
        share_viewer(tmp_path)
        (page,) = (path for path in (tmp_path / "_static" / "gmmcd-views").glob("*.html"))
    flags = "--headless --no-sandbox --use-gl=angle --use-angle=swiftshader --enable-unsafe-swiftshader --disable-sync"
    quiet = "--no-first-run --disable-background-networking --disable-component-update --virtual-time-budget=30000"
    command = [
        BROWSER,
        *flags.split(),
        *quiet.split(),
        f"--user-data-dir={tmp_path / 'profile'}",
        "--dump-dom",
        page.as_uri(),
    ]
    document = subprocess.run(command, capture_output=True, text=True, timeout=180, check=True).stdout
    assert "<canvas" in document
    assert re.search(
        r'<b style="left: ?25%; top: ?0%;?">before</b><b style="left: ?75%; top: ?0%;?">after</b>', document
    )


def test_what_cannot_be_drawn_is_named():
    with pytest.raises(CloudError, match=r"points: shape \(4,\); expected \(N, D\) with D = 2 or 3"):
        plot_clouds(np.zeros(4))
    with pytest.raises(ValueError, match="plane 'xq': name two of the axes x, y, z"):
        plot_clouds(np.zeros((4, 3)), plane="xq")
    with pytest.raises(CloudError, match="mixture: dict; expected a GaussianMixture"):
        plot_mixture({})
