"""The built book: both commands give the same pages, complete, linked, described, and with no need of a network.

Slow: the book is built (from the outputs that `_build/.executed` holds for this very code, where it does).
"""

from __future__ import annotations

import json
import os
import re
import shutil
import subprocess
import sys
from html.parser import HTMLParser
from pathlib import Path
from urllib.parse import unquote, urlsplit

import nbformat
import pytest
from sphinx.search.en import SearchEnglish

from gmmcd_teach.exercises import EXERCISES
from gmmcd_teach.exercises.checking import _load_all

ROOT = Path(__file__).resolve().parents[1]
HTML = ROOT / "_build" / "html"
BOUNDS = {"ten seconds": 10, "half a minute": 30, "one minute": 60, "two minutes": 120, "three minutes": 180}
SLOWER = 1.25  # than the machine on which the promises were made
book = pytest.mark.xdist_group("book")  # one worker builds, and reads what it has built

sys.path.insert(0, str(ROOT / "book" / "_ext"))


# ---- reading pages -----------------------------------------------------------------------------------------------


class Page(HTMLParser):
    """What a page loads, links to, shows and names."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.loads: list[str] = []
        self.links: list[str] = []
        self.ids: set[str] = set()
        self.images: list[dict[str, str]] = []
        self.frames: list[dict[str, str]] = []
        self.headings: list[str] = []
        self.bare: list[str] = []  # pictures of the article that are in no figure
        self.captions: list[bool] = []  # of each outermost figure: is there a caption?
        self._depth = {"article": 0, "figure": 0}
        self._in_style = self._in_heading = False
        self.feed(text)

    def handle_starttag(self, tag: str, attributes: list[tuple[str, str | None]]) -> None:
        found = {name: value or "" for name, value in attributes}
        self._in_style = tag == "style"
        if tag in self._depth:
            self._depth[tag] += 1
        if tag == "figure" and self._depth["figure"] == 1:
            self.captions.append(False)
        elif "caption-text" in found.get("class", "").split() and self._depth["figure"] == 1:
            self.captions[-1] = True
        elif tag == "img" and self._depth == {"article": 1, "figure": 0}:
            self.bare.append(found.get("src", ""))
        if tag == "h1":
            self._in_heading = True
            self.headings.append("")
        self.ids |= {found[name] for name in ("id", "name") if found.get(name)}
        self.loads += [found[name] for name in ("src", "data", "poster") if tag != "a" and found.get(name)]
        self.loads += [part.split()[0] for part in found.get("srcset", "").split(",") if part.split()]
        self.loads += css_loads(found.get("style", ""))
        if tag == "link" and not {"next", "prev", "index", "search", "canonical"} & set(found.get("rel", "").split()):
            self.loads.append(found.get("href", ""))
        elif tag in ("use", "image"):
            self.loads += [found[name] for name in ("href", "xlink:href") if name in found]
        elif tag == "a" and "href" in found:
            self.links.append(found["href"])
        elif tag == "img":
            self.images.append(found)
        elif tag == "iframe":
            self.frames.append(found)
            self.loads += Page(found["srcdoc"]).loads if "srcdoc" in found else []

    def handle_data(self, data: str) -> None:
        if self._in_style:
            self.loads += css_loads(data)
        if self._in_heading:
            self.headings[-1] += data

    def handle_endtag(self, tag: str) -> None:
        self._in_style = False
        if tag in self._depth:
            self._depth[tag] -= 1
        if tag == "h1":
            self._in_heading = False


def css_loads(css: str) -> list[str]:
    """Addresses that a style sheet loads, by url() or @import."""
    css = re.sub(r"/\*.*?\*/", "", css, flags=re.DOTALL)
    return re.findall(r"url\(\s*['\"]?([^'\")]+)", css) + re.findall(r"@import\s+['\"]([^'\"]+)", css)


def from_network(addresses: list[str]) -> list[str]:
    return [address for address in addresses if re.match(r"\s*(?:(?:https?|ftp|wss?):)?//", address, re.IGNORECASE)]


@pytest.mark.parametrize(
    "html",
    [
        '<script src="https://cdn.example/x.js"></script>',
        '<script src="//cdn.example/x.js"></script>',
        '<link rel="stylesheet" href="https://cdn.example/x.css">',
        '<link rel="preconnect" href="https://fonts.example">',
        '<img alt="" src="http://x.example/x.png">',
        '<img alt="" srcset="a.png 1x, https://x.example/b.png 2x">',
        '<iframe src="https://x.example"></iframe>',
        """<iframe srcdoc='<script src="https://x.example/x.js"></script>'></iframe>""",
        '<object data="https://x.example/x.svg"></object>',
        "<style>@import 'https://fonts.example/x.css';</style>",
        "<style>p { background: url( https://x.example/x.png ) }</style>",
        """<p style="background: url('//x.example/x.png')">""",
        '<svg><use href="https://x.example/x.svg#a"></use></svg>',
    ],
)
def test_the_reader_notices_what_comes_from_the_network(html: str) -> None:
    assert len(from_network(Page(html).loads)) == 1


def test_the_reader_allows_links_and_local_files() -> None:
    html = '<a href="https://x.example">x</a><script src="../x.js"></script><img src="data:image/png;base64,AA">'
    assert from_network(Page(html).loads) == []


# ---- the extension that runs notebooks ---------------------------------------------------------------------------


def write_notebook(path: Path, *sources: str) -> Path:
    kernel = {"kernelspec": {"name": "python3", "display_name": "Python 3", "language": "python"}}
    cells = [nbformat.v4.new_code_cell(source) for source in sources]
    nbformat.write(nbformat.v4.new_notebook(cells=cells, metadata=kernel), path)
    return path


@pytest.mark.slow
def test_a_notebook_runs_in_an_empty_folder_and_is_measured(tmp_path: Path) -> None:
    from execution import run_notebook

    path = write_notebook(tmp_path / "a.ipynb", "import os, time; time.sleep(0.5); os.listdir()", "6 * 7")
    result = run_notebook(path, timeout=60)
    assert [cell[0]["data"]["text/plain"] for cell in result["outputs"]] == ["[]", "42"]
    assert 0.5 < result["seconds"] < 60
    assert 0.1 < result["computing"] < 60
    assert 20 < result["megabytes"] < 2000


@pytest.mark.slow
def test_a_notebook_runs_without_the_network(tmp_path: Path) -> None:
    from execution import run_notebook

    call = "import socket\ntry: socket.create_connection(('%s', 80), 5)\nexcept OSError as e: print(e)"
    path = write_notebook(tmp_path / "a.ipynb", call % "example.org", call % "192.0.2.1", call % "127.0.0.1")
    says = [cell[0]["text"] for cell in run_notebook(path, timeout=60)["outputs"]]
    assert ["the network is cut off" in words for words in says] == [True, True, False]  # itself it may call


@pytest.mark.slow
@pytest.mark.parametrize("source", ["1 / 0", "import time; time.sleep(60)"])
def test_a_cell_that_fails_or_hangs_fails_the_build(tmp_path: Path, source: str) -> None:
    from execution import run_notebook
    from nbclient.exceptions import CellExecutionError, CellTimeoutError

    with pytest.raises((CellExecutionError, CellTimeoutError)):
        run_notebook(write_notebook(tmp_path / "a.ipynb", source), timeout=3)


def test_outputs_are_kept_under_code_package_and_lock(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    import execution

    (tmp_path / "gmmcd_teach").mkdir()
    for name in ("requirements.lock", "pyproject.toml", "gmmcd_teach/a.py"):
        (tmp_path / name).write_text("1")
    monkeypatch.setattr(execution, "ROOT", tmp_path)
    notebook = nbformat.read(write_notebook(tmp_path / "a.ipynb", "1"), as_version=4)
    keys = [execution.fingerprint(notebook)]
    for name in ("requirements.lock", "pyproject.toml", "gmmcd_teach/a.py"):
        (tmp_path / name).write_text("2")
        keys.append(execution.fingerprint(notebook))
    notebook.cells[0].source = "2"
    keys.append(execution.fingerprint(notebook))
    assert len(set(keys)) == len(keys)
    notebook.cells.append(nbformat.v4.new_markdown_cell("Prose alone changes no output."))
    assert execution.fingerprint(notebook) == keys[-1]


# ---- the book ----------------------------------------------------------------------------------------------------


def build(folder: str) -> dict[str, str]:
    """Run the command; return the pages by their path."""
    done = subprocess.run(
        [Path(sys.executable).with_name("jupyter-book"), "build", folder], cwd=ROOT, capture_output=True, text=True,
        check=False,
    )  # fmt: skip
    log = done.stdout + done.stderr
    assert done.returncode == 0, log[-6000:]
    assert "build succeeded" in log
    assert "WARNING" not in log, log[-6000:]
    paths = {path.relative_to(HTML).as_posix(): path for path in HTML.rglob("*.html")}
    return {name: path.read_text(encoding="utf8") for name, path in paths.items() if not name.startswith("_static/")}


@pytest.fixture(scope="module")
def texts() -> dict[str, str]:
    return build("book")


@pytest.fixture(scope="module")
def pages(texts: dict[str, str]) -> dict[str, Page]:
    return {name: Page(text) for name, text in texts.items()}


@pytest.fixture(scope="module")
def written(pages: dict[str, Page]) -> dict[str, Page]:
    """The pages of the book itself, without index, search and the sources of modules."""
    return {name: page for name, page in pages.items() if name.startswith(("book/", "notebooks/"))}


@book
@pytest.mark.slow
def test_both_commands_give_the_same_pages(texts: dict[str, str]) -> None:
    assert build(".") == texts


@book
@pytest.mark.slow
def test_every_source_has_its_page(written: dict[str, Page]) -> None:
    sources = [*(ROOT / "book").rglob("*.md"), *(ROOT / "notebooks").glob("*.ipynb")]
    wanted = {path.relative_to(ROOT).with_suffix(".html").as_posix() for path in sources}
    assert set(written) == wanted


@book
@pytest.mark.slow
def test_every_module_has_its_page(texts: dict[str, str]) -> None:
    package = ROOT / "gmmcd_teach"
    files = {path.stem for path in package.glob("[a-z]*.py")}
    folders = {path.parent.name for path in package.glob("*/__init__.py")}
    assert {f"book/api/{name}.html" for name in files | folders} <= set(texts)
    for name in files | folders:
        assert f'href="api/{name}.html"' in texts["book/api.html"].split("<article", 1)[1], (
            f"{name} is not in book/api.md"
        )


@book
@pytest.mark.slow
def test_chapters_bear_the_number_of_their_file(written: dict[str, Page]) -> None:
    for name, page in written.items():
        if name.startswith("notebooks/") and name.split("/")[1][:2].isdigit():
            number = f"{int(name.split('/')[1][:2])}."
            assert any(heading.startswith(number) for heading in page.headings), name


@book
@pytest.mark.slow
def test_nothing_is_loaded_from_the_network(pages: dict[str, Page]) -> None:
    loads = {name: from_network(page.loads) for name, page in pages.items()}
    loads |= {p.relative_to(HTML).as_posix(): from_network(css_loads(p.read_text())) for p in HTML.rglob("*.css")}
    assert {name: found for name, found in loads.items() if found} == {}


@book
@pytest.mark.slow
def test_links_and_files_are_there(pages: dict[str, Page]) -> None:
    broken = []
    for name, page in pages.items():
        for address in [*page.links, *page.loads]:
            parts = urlsplit(address)
            if parts.scheme or parts.netloc or address == "#":
                continue
            target = (HTML / name).parent / unquote(parts.path) if parts.path else HTML / name
            if not target.exists():
                broken.append(f"{name}: {address}")
            elif parts.fragment and target.suffix == ".html":
                key = target.resolve().relative_to(HTML).as_posix()
                if unquote(parts.fragment) not in pages[key].ids:
                    broken.append(f"{name}: {address}")
    assert broken == []


@book
@pytest.mark.slow
def test_every_image_says_what_it_shows(written: dict[str, Page]) -> None:
    for name, page in written.items():
        for image in page.images:
            assert image.get("alt", "").strip(), f"{name}: {image.get('src')} has no alt text"
            assert not image["alt"].endswith((".png", ".svg", ".jpg")), f"{name}: {image['alt']}"
        for frame in page.frames:
            assert frame.get("title", "").strip(), f"{name}: a frame without a title"


@book
@pytest.mark.slow
def test_every_picture_of_a_chapter_is_a_figure_with_caption(written: dict[str, Page]) -> None:
    for name, page in written.items():
        if name.startswith("notebooks/"):
            assert page.bare == [], f"{name}: a picture outside of a figure"
            assert all(page.captions), f"{name}: figure {page.captions.index(False) + 1} has no caption"


@pytest.mark.parametrize(
    ("html", "bare", "captions"),
    [
        ('<article><img src="a"></article>', ["a"], []),
        ('<article><figure><img src="a"></figure></article>', [], [False]),
        ('<article><figure><figure><img src="a"></figure><p class="caption-text"></figure></article>', [], [True]),
        ('<article><figure><figure><p class="caption-text"></figure></figure></article>', [], [False]),
    ],
)
def test_the_reader_sees_captions(html: str, bare: list[str], captions: list[bool]) -> None:
    page = Page(html)
    assert (page.bare, page.captions) == (bare, captions)


@book
@pytest.mark.slow
def test_chapters_run_in_the_time_they_promise(texts: dict[str, str]) -> None:
    """By the seconds of computing, which do not depend on what else the machine does; or, of a chapter that computes
    on both cores and runs alone, by those that passed."""
    from execution import ALONE, number_of

    chapters = {Path(name).stem: text for name, text in texts.items() if name.startswith("notebooks/")}
    total = 0.0
    for name, text in chapters.items():
        plain = re.sub(r"<[^>]+>", "", text)
        found = re.search(r"It runs in under ([a-z ]+) \(\d+ s and \d+ MB when this page was built\)", plain)
        assert found is not None, f"{name}: no measured time"
        (kept,) = (ROOT / "_build" / ".executed").glob(f"{name}-*.json")
        cost = json.loads(kept.read_text(encoding="utf8"))
        seconds = cost["seconds" if number_of(name) in ALONE else "computing"]
        assert seconds <= SLOWER * BOUNDS[found[1]], f"{name}: {found[0]}, but {seconds:.0f} s of computing"
        total += cost["computing"]
    assert total < SLOWER * 2 * 9 * 60  # nine minutes on two cores


@book
@pytest.mark.slow
@pytest.mark.parametrize("path", sorted(ROOT.glob("notebooks/[0-9]*.ipynb")), ids=lambda path: path.stem)
def test_solutions_of_the_chapter_are_right_and_stubs_are_told_that_they_are_not_done(path: Path) -> None:
    """`check` never fails a cell, so what it said must be read."""
    cells = [cell for cell in nbformat.read(path, as_version=4).cells if cell.cell_type == "code"]
    (kept,) = (ROOT / "_build" / ".executed").glob(f"{path.stem}-*.json")
    outputs = json.loads(kept.read_text(encoding="utf8"))["outputs"]
    checked = set()
    for cell, shown in zip(cells, outputs, strict=True):
        for name in re.findall(r'^check\("(ex-[^"]+)"', cell.source, re.MULTILINE):
            said = "".join(output.get("data", {}).get("text/plain", "") for output in shown)
            solution = "hide-cell" in cell.metadata.get("tags", [])
            assert said.startswith(f"✓ {name}: right" if solution else f"… {name}: not done"), said
            checked.add((name, solution))
    _load_all()
    number = path.stem[:2]
    assert checked == {(name, done) for name in EXERCISES if name[3:5] == number for done in (True, False)}


@pytest.fixture(scope="module")
def browser(tmp_path_factory: pytest.TempPathFactory) -> list[str]:
    """The command that prints a page as Chromium makes it, cut off from the network."""
    found = next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), None)
    if found is None:
        pytest.skip("no Chromium to look at the pages with")
    return [found, "--headless", "--no-sandbox", "--disable-gpu", "--disable-quic", "--no-first-run",
            "--disable-background-networking", "--disable-component-update", "--disable-sync",
            "--host-resolver-rules=MAP * ~NOTFOUND", f"--user-data-dir={tmp_path_factory.mktemp('chromium')}",
            "--virtual-time-budget=60000", "--dump-dom"]  # fmt: skip


@book
@pytest.mark.slow
def test_formulas_are_typeset_without_a_network(texts: dict[str, str], browser: list[str]) -> None:
    """In a browser: a mistake in TeX shows on the page alone, not in the build."""
    for name in (name for name, text in texts.items() if 'class="math' in text):
        shown = subprocess.run([*browser, f"file://{HTML / name}"], capture_output=True, text=True, check=True).stdout
        assert "<mjx-container" in shown, f"{name}: formulas are not typeset"
        faults = re.findall(r'data-mjx-error="([^"]*)"|<mjx-mtext[^>]*color: ?red[^>]*>', shown)
        assert faults == [], f"{name}: {faults}"


AUDIT = """<iframe src="PAGE" width="1200" height="900"></iframe><pre id="found">not run</pre><script>
addEventListener("load", () => setTimeout(async () => {
  const page = document.querySelector("iframe").contentWindow;
  page.localStorage.setItem("mode", "THEME");
  page.document.documentElement.dataset.theme = "THEME";
  page.eval(await (await fetch("AXE")).text());
  const { violations } = await page.axe.run({ resultTypes: ["violations"] });
  const grave = violations.filter(({ impact }) => impact === "serious" || impact === "critical");
  const told = grave.map(({ id, nodes }) => id + ": " + nodes.map(({ target }) => target.join(" ")).join(", "));
  document.getElementById("found").textContent = "found " + JSON.stringify(told);
}, 3000));
</script>"""


@book
@pytest.mark.slow
@pytest.mark.parametrize("theme", ["light", "dark"])
def test_no_page_shuts_readers_out(texts: dict[str, str], browser: list[str], tmp_path: Path, theme: str) -> None:
    """No serious finding of axe-core, whose axe.min.js $AXE_CORE names."""
    axe = os.environ.get("AXE_CORE")
    if axe is None:
        pytest.skip("AXE_CORE does not name an axe.min.js (npm install axe-core)")
    open_files = ["--allow-file-access-from-files", "--disable-web-security"]
    for name in texts:
        text = AUDIT.replace("PAGE", (HTML / name).as_uri()).replace("THEME", theme).replace("AXE", Path(axe).as_uri())
        (tmp_path / "audit.html").write_text(text)
        page = (tmp_path / "audit.html").as_uri()
        shown = subprocess.run([*browser, *open_files, page], capture_output=True, text=True, check=True).stdout
        assert 'id="found">found []<' in shown, f"{name}: {re.findall('id=.found.>(.*?)</pre>', shown)}"


@book
@pytest.mark.slow
def test_the_search_finds_the_terms_of_the_glossary(texts: dict[str, str]) -> None:
    script = (HTML / "searchindex.js").read_text(encoding="utf8")
    index = json.loads(script[script.index("(") + 1 : script.rindex(")")])
    terms = re.findall(r'<dt id="term-[^"]*">(.*?)<a class="headerlink"', texts["book/glossary.html"])
    assert len(terms) > 50
    english = SearchEnglish({})
    words = {word.lower() for term in terms for word in english.split(term)}
    sought = {english.stem(word) for word in words if english.word_filter(word)}
    assert sought <= index["terms"].keys()


@book
@pytest.mark.slow
def test_one_search_box_and_no_live_code(texts: dict[str, str]) -> None:
    for name, text in texts.items():
        if name.startswith(("book/", "notebooks/")):
            assert text.count('type="search"') == 1, name
            assert "thebe" not in text.lower(), name
