"""Reports and comparisons as a reader meets them: in headless Chromium, on a desk and on a phone."""

import itertools
from collections.abc import Iterator
from pathlib import Path

import pytest
from playwright.sync_api import Browser, FloatRect, Page, expect
from synthetic_results import SMALL, SyntheticCampaign
from views import addresses_in, unpacked

from analysis.pages.compare import write_comparison
from analysis.pages.report import write_report

DESK, PHONE = {"width": 1280, "height": 900}, {"width": 390, "height": 844}
HOSTILE = "<img src=x onerror=console.error('hostile')>"

PATIENCE = 120_000
"""Milliseconds: a page of plotly takes its time on a busy machine."""


def synthetic_root(
    root: Path, levels: dict[str, tuple[str, ...]], teachers: tuple[str, ...] = ("random", "alp_gmm", HOSTILE)
) -> Path:
    """Write runs on some levels of some challenges; one of the last teacher's fails."""
    for challenge, levels_there in levels.items():
        campaign = SyntheticCampaign(root, experiment=challenge, **SMALL)
        for teacher, level, seed in itertools.product(teachers, levels_there, range(2)):
            failed = (challenge, teacher, seed) == ("original", teachers[-1], 1)
            status = "failed" if failed else "done"
            campaign.run(teacher, seed, status, level=level, challenge=challenge)
    return root


@pytest.fixture(scope="module")
def small_root(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return synthetic_root(tmp_path_factory.mktemp("small"), {"original": ("none",)}, ("random", "alp_gmm"))


@pytest.fixture(scope="module")
def root(tmp_path_factory: pytest.TempPathFactory) -> Path:
    levels: dict[str, tuple[str, ...]] = {"original": ("none", "low"), "mostly_trivial": ("none",)}
    return synthetic_root(tmp_path_factory.mktemp("pages"), levels)


@pytest.fixture(scope="module")
def small_report(small_root: Path) -> Path:
    return write_report(small_root)


@pytest.fixture(scope="module")
def report(root: Path) -> Path:
    return write_report(root)


class Reader:
    """A page, and all that it complained of or asked the network for."""

    def __init__(self, page: Page) -> None:
        self.page = page
        page.set_default_timeout(PATIENCE)
        self.complaints: list[str] = []
        self.requests: list[str] = []
        page.on("console", lambda message: self.complaints.append(f"{message.type}: {message.text}"))
        page.on("pageerror", lambda error: self.complaints.append(str(error)))
        page.on("request", lambda request: self.requests.append(request.url))

    def open(self, path: Path) -> None:
        self.page.goto(path.as_uri())
        self.unfold()
        self.page.locator(".chart").first.scroll_into_view_if_needed()  # charts are drawn when they come near
        self.page.wait_for_selector(".plot .main-svg")

    def unfold(self) -> None:
        self.page.evaluate("for (const each of document.querySelectorAll('details')) each.open = true")

    def read_through(self) -> None:
        """Scrolls to the end, so that every chart is drawn."""
        for chart in self.page.locator(".chart").all():
            if chart.is_visible():
                chart.scroll_into_view_if_needed()
                chart.locator(".main-svg").first.wait_for()

    def choose_step(self, place: int) -> None:
        self.page.locator("#step").fill(str(place))
        self.settle()

    def choose(self, column: str, name: str) -> None:
        self.page.locator(f"[data-filter={column}]").select_option(label=name)
        self.settle()

    def settle(self) -> None:
        self.page.evaluate("new Promise(done => requestAnimationFrame(() => requestAnimationFrame(done)))")

    def traces(self, chart: str) -> list[dict[str, object]]:
        """What a chart shows: whose, and the numbers, of visible traces."""
        return self.page.evaluate(
            """name => document.getElementById(name)._fullData.filter(trace => trace.visible)
                .map(trace => ({teacher: (trace.meta || {}).teacher, x: [...trace.x], y: [...trace.y]}))""",
            chart,
        )


@pytest.fixture(params=[DESK, PHONE], ids=["desk", "phone"])
def anywhere(request: pytest.FixtureRequest, browser: Browser) -> Iterator[Reader]:
    page = browser.new_page(viewport=request.param)
    yield Reader(page)
    page.close()


@pytest.fixture
def reader(browser: Browser) -> Iterator[Reader]:
    page = browser.new_page(viewport=DESK)
    yield Reader(page)
    page.close()


BEYOND = """() => [...document.querySelectorAll("main *")].filter(element => {
    const box = element.getBoundingClientRect();
    const inside = element.closest(".main-svg, .modebar-container, .sheet, pre, thead");
    return box.width > 0 && !inside && box.right > document.documentElement.clientWidth + 1;
}).map(element => element.outerHTML.slice(0, 80))"""
"""What is wider than the window."""


def assert_reads_well(reader: Reader) -> None:
    """Nothing is complained of, loaded from elsewhere, or wider than the window."""
    reader.read_through()
    assert reader.complaints == []
    assert [url for url in reader.requests if not url.startswith(("file:", "data:", "blob:"))] == []
    assert reader.page.evaluate(BEYOND) == []
    assert reader.page.evaluate("document.documentElement.scrollWidth <= innerWidth")


def test_a_report_is_read_at_another_step_and_without_a_teacher(reader: Reader, small_report: Path) -> None:
    reader.open(small_report)
    assert_reads_well(reader)
    assert reader.page.locator(".chart .main-svg").count() >= 4 + 2 * 3
    cell = reader.page.locator("#comparison-1 tr[data-of=alp_gmm] td[data-field=mastered]")
    at_end = cell.inner_text()
    reader.choose_step(0)
    assert cell.inner_text() != at_end
    shown = {chart: reader.traces(chart) for chart in ("comparison-1-seeds", "comparison-1-mastered-percent")}
    assert all("alp_gmm" in {trace["teacher"] for trace in traces} for traces in shown.values())
    reader.page.locator(".chip", has_text="ALP-GMM").click()
    for chart in shown:
        reader.page.locator(f"#{chart}").scroll_into_view_if_needed()
        reader.settle()
        assert "alp_gmm" not in {trace["teacher"] for trace in reader.traces(chart)}
    assert reader.page.locator("[data-of=alp_gmm]:visible").count() == 0
    reader.page.set_viewport_size(PHONE)
    reader.settle()
    assert_reads_well(reader)


@pytest.mark.slow
def test_a_large_report_opens_without_complaint_and_nothing_overflows(anywhere: Reader, report: Path) -> None:
    anywhere.open(report)
    assert_reads_well(anywhere)
    assert anywhere.page.locator(".chart .main-svg").count() >= 3 * (4 + 3 * 3)


@pytest.mark.slow
def test_a_comparison_of_challenges_is_narrowed_to_one(anywhere: Reader, root: Path, tmp_path: Path) -> None:
    anywhere.open(write_comparison(root, ["paper-2021"], tmp_path / "page"))
    assert_reads_well(anywhere)
    anywhere.choose("challenge", "Mostly trivial")
    assert anywhere.page.locator("section[data-comparison]:visible").count() == 1
    anywhere.choose_step(0)
    mastered = anywhere.page.locator("section[data-comparison]:visible td[data-field=mastered]")
    assert mastered.first.inner_text().startswith("0.0")


@pytest.mark.slow
def test_a_click_on_a_legend_leaves_a_teacher_out_everywhere(reader: Reader, report: Path) -> None:
    reader.open(report)
    reader.page.locator("#overview .legendtoggle").first.click()
    expect(reader.page.locator("#controls [data-teacher=random]")).not_to_be_checked()
    reader.settle()
    assert "random" not in {trace["teacher"] for trace in reader.traces("overview")}
    assert reader.page.locator("tr[data-of=random]:visible").count() == 0
    reader.page.locator(".chip", has_text="Random").click()
    reader.settle()
    assert reader.page.locator("section[data-comparison] tr[data-of=random]:visible").count() == 3


@pytest.mark.slow
def test_tables_and_charts_agree_at_any_step(reader: Reader, report: Path) -> None:
    reader.open(report)
    reader.read_through()
    cell = reader.page.locator("#comparison-1 tr[data-of=alp_gmm] td[data-field=mastered]")
    at_end, drawn, seen = cell.inner_text(), reader.traces("comparison-1-seeds"), []
    for place in (0, 2, 5):
        reader.choose_step(place)
        reader.read_through()
        means = [trace for trace in reader.traces("comparison-1-seeds") if trace["teacher"] == "alp_gmm"]
        assert float(cell.inner_text().partition(" ")[0]) == pytest.approx(means[1]["x"][0], abs=0.06)
        assert reader.page.locator("#at-step").is_visible() == (place != 5)
        seen.append(reader.page.locator("#step-name").inner_text())
    assert seen[0] == "0 steps"
    assert len(set(seen)) == 3
    assert (cell.inner_text(), reader.traces("comparison-1-seeds")) == (at_end, drawn)


@pytest.mark.slow
def test_challenges_and_levels_are_chosen(reader: Reader, report: Path) -> None:
    reader.open(report)
    assert reader.page.locator("section[data-comparison]:visible").count() == 3
    reader.choose("expert_knowledge", "Low")
    assert reader.page.locator("section[data-comparison]:visible").count() == 1
    places = {value for trace in reader.traces("overview") for value in trace["y"]}
    assert places
    assert all(-0.5 < value < 0.5 for value in places)  # the one row that is left lies first
    reader.choose("challenge", "Mostly trivial")
    assert reader.page.locator("section[data-comparison]:visible").count() == 0
    assert reader.page.locator("#nothing").is_visible()
    reader.choose("expert_knowledge", "all")
    reader.choose("challenge", "all")
    assert reader.page.locator("section[data-comparison]:visible").count() == 3
    assert reader.complaints == []


@pytest.mark.slow
def test_zooming_changes_the_axis_and_survives_a_change_of_step(reader: Reader, report: Path) -> None:
    reader.open(report)
    reader.read_through()
    plot = reader.page.locator("#comparison-1-mastered-percent")
    plot.scroll_into_view_if_needed()
    axis = "document.getElementById('comparison-1-mastered-percent').layout.xaxis.range"
    before = reader.page.evaluate(f"String({axis})")
    box = plot.locator(".nsewdrag").first.bounding_box()
    assert box is not None
    reader.page.mouse.move(box["x"] + 0.2 * box["width"], box["y"] + 0.5 * box["height"])
    reader.page.mouse.down()
    reader.page.mouse.move(box["x"] + 0.6 * box["width"], box["y"] + 0.5 * box["height"], steps=5)
    reader.page.mouse.up()
    reader.page.wait_for_function(f"before => String({axis}) !== before", arg=before)
    zoomed = reader.page.evaluate(axis)
    assert 0 < zoomed[0] < zoomed[1] < SMALL["steps"]
    reader.choose_step(1)
    assert reader.page.evaluate(axis) == zoomed


@pytest.mark.slow
def test_hovering_tells_numbers(reader: Reader, report: Path) -> None:
    reader.open(report)
    plot = reader.page.locator("#comparison-1-mastered-percent")
    plot.scroll_into_view_if_needed()
    plot.locator(".main-svg").first.wait_for()
    plot.locator(".nsewdrag").first.hover()
    reader.page.wait_for_selector("#comparison-1-mastered-percent .hoverlayer text")
    told = plot.locator(".hoverlayer").text_content() or ""
    assert "ALP-GMM" in told
    assert "n = 2" in told


@pytest.mark.slow  # Chromium takes a minute or two to make a PDF of so many charts
def test_print_shows_every_chart_wide_tables_and_no_controls(reader: Reader, report: Path) -> None:
    reader.open(report)
    reader.page.emulate_media(media="print")
    pdf = reader.page.pdf(format="A4")
    assert pdf.startswith(b"%PDF")
    hidden = "[...document.querySelectorAll('.plot')].filter(plot => !plot.querySelector('.main-svg')).length"
    assert reader.page.evaluate(hidden) == 0
    assert reader.page.locator("#step").is_hidden()
    reader.page.set_viewport_size({"width": 690, "height": 1000})
    row = reader.page.locator("section[data-comparison] tr[data-of=random]").first
    assert row.evaluate("row => getComputedStyle(row).display") == "table-row"
    reader.page.wait_for_function("() => document.documentElement.scrollWidth <= 690")


def overlaps(one: FloatRect, other: FloatRect) -> bool:
    """True if two boxes of a page have more than an edge in common."""
    across = min(one["x"] + one["width"], other["x"] + other["width"]) - max(one["x"], other["x"])
    down = min(one["y"] + one["height"], other["y"] + other["height"]) - max(one["y"], other["y"])
    return across > 1 and down > 1


@pytest.mark.slow
def test_the_mode_bar_is_seen_under_the_mouse_only(anywhere: Reader, small_report: Path) -> None:
    anywhere.open(small_report)
    for plot in anywhere.page.locator(".plot").all():
        plot.scroll_into_view_if_needed()
        bar = plot.locator(".modebar")
        anywhere.page.mouse.move(0, 0)
        expect(bar).to_be_hidden()
        plot.hover()
        expect(bar).to_be_visible()
        place = bar.bounding_box()
        assert place is not None
        assert place["y"] >= 0
        drawn = [*plot.locator(".nsewdrag").all(), *plot.locator(".legend .traces").all()]
        boxes = [box for box in (each.bounding_box() for each in drawn) if box is not None]
        assert boxes
        assert not any(overlaps(place, box) for box in boxes)
        assert bar.evaluate("bar => getComputedStyle(bar).backgroundColor") == "rgba(0, 0, 0, 0)"


def test_a_page_holds_no_address_that_it_could_send_to(small_report: Path) -> None:
    page = unpacked(small_report.read_text())
    assert len(page) > 4_000_000  # plotly.js is in it
    assert addresses_in(page) == set()


@pytest.mark.slow
def test_no_button_of_a_chart_sends_anything(reader: Reader, small_report: Path) -> None:
    reader.open(small_report)
    plot = reader.page.locator(".plot").first
    plot.hover()
    buttons = plot.locator(".modebar-btn")
    titles = [button.get_attribute("data-title") or "" for button in buttons.all()]
    assert len(titles) >= 4
    assert not [title for title in titles if "share" in title.lower() or "cloud" in title.lower()]
    for button in buttons.all():
        plot.hover()
        button.click()
    reader.settle()
    assert len(reader.page.context.pages) == 1
    assert [url for url in reader.requests if not url.startswith(("file:", "data:", "blob:"))] == []


CONTRAST = """() => {
    const parts = colour => colour.startsWith("#")
        ? [1, 3, 5].map(at => parseInt(colour.slice(at, at + 2), 16))
        : colour.match(/[\\d.]+/g).slice(0, 3).map(Number);
    const luminance = colour => parts(colour).map(part => part / 255)
        .map(part => part <= 0.04045 ? part / 12.92 : ((part + 0.055) / 1.055) ** 2.4)
        .reduce((sum, part, place) => sum + [0.2126, 0.7152, 0.0722][place] * part, 0);
    const page = luminance(getComputedStyle(document.body).backgroundColor);
    const contrast = value => (Math.max(value, page) + 0.05) / (Math.min(value, page) + 0.05);
    const random = [...document.querySelectorAll(".plot.js-plotly-plot")].flatMap(plot => plot._fullData)
        .filter(trace => (trace.meta || {}).teacher === "random" && trace.line && trace.line.width > 1);
    const swatches = [...document.querySelectorAll("[data-of=random] .swatch, .chip .swatch")];
    return [...random.map(trace => trace.line.color),
        ...swatches.map(swatch => getComputedStyle(swatch).backgroundColor)]
        .map(colour => contrast(luminance(colour)));
}"""
"""Contrasts (WCAG) of Random's lines and of teachers' small squares to the page."""


@pytest.mark.slow
@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_random_is_told_from_the_page_at_night_too(scheme, reader, small_report):
    reader.page.emulate_media(color_scheme=scheme)
    reader.open(small_report)
    contrasts = reader.page.evaluate(CONTRAST)
    assert len(contrasts) >= 4
    assert min(contrasts) >= 4.5


@pytest.mark.slow
def test_tables_are_sorted_by_headings_also_from_the_keyboard(reader: Reader, small_report: Path) -> None:
    reader.open(small_report)
    table = reader.page.locator("#comparison-1 table")
    heading = table.locator("thead th", has_text="mean ± std").first
    cells = table.locator("td[data-field=mastered]")
    as_written = cells.all_inner_texts()
    values = sorted(float(text.partition(" ")[0]) for text in as_written)
    heading.get_by_role("button").click()
    assert [float(text.partition(" ")[0]) for text in cells.all_inner_texts()] == values[::-1]
    expect(heading).to_have_attribute("aria-sort", "descending")
    reader.page.keyboard.press("Enter")
    assert [float(text.partition(" ")[0]) for text in cells.all_inner_texts()] == values
    expect(heading).to_have_attribute("aria-sort", "ascending")
    table.get_by_role("button", name="Teacher").click()
    assert table.locator("tbody th").all_inner_texts() == ["ALP-GMM", "Random"]
    expect(table.locator("[aria-sort]")).to_have_count(1)
    differences = table.locator("td[data-field=difference]")
    table.get_by_role("button", name="minus Random").click()
    assert differences.last.inner_text() == ""  # what has no number comes last, whatever the order


@pytest.mark.slow
def test_without_scripts_tables_still_say_everything(browser: Browser, small_report: Path) -> None:
    context = browser.new_context(java_script_enabled=False)
    page = context.new_page()
    page.goto(small_report.as_uri())
    assert "need JavaScript" in page.locator("noscript").inner_text()
    assert page.locator("#comparison-1 td[data-field=mastered]").first.inner_text() != ""
    context.close()


@pytest.mark.slow
def test_an_address_keeps_what_was_chosen(reader: Reader, report: Path) -> None:
    reader.open(report)
    reader.choose_step(1)
    reader.page.locator("[data-filter=challenge]").select_option(index=1)
    reader.page.locator("#controls [data-teacher]").first.uncheck()
    reader.settle()
    told, seen = reader.page.url, reader.page.locator("#step-name").inner_text()
    assert told.startswith(f"{report.as_uri()}#show?")
    reader.page.goto("about:blank")
    reader.page.goto(told)
    reader.settle()
    assert reader.page.locator("#step-name").inner_text() == seen
    assert not reader.page.locator("#controls [data-teacher]").first.is_checked()
    assert reader.page.locator("[data-filter=challenge]").input_value() != ""
    assert reader.page.url == told


@pytest.mark.slow
def test_a_table_is_copied_as_markdown(reader: Reader, report: Path) -> None:
    reader.open(report)
    reader.page.evaluate(
        """Object.defineProperty(navigator, "clipboard",
            {value: {writeText: text => Promise.resolve(window.copied = text)}})"""
    )
    reader.page.locator("#comparison-1 button.copy").click()
    heading, rule, *rows = str(reader.page.evaluate("window.copied")).splitlines()
    assert heading.startswith("| Teacher | Seeds |")
    assert set(rule) == set("| -")
    assert {row.count(" | ") for row in (heading, *rows)} == {10}
    table = reader.page.locator("section[data-comparison] table").first
    assert len(rows) == table.locator("tbody tr").count()


@pytest.mark.slow
def test_comparisons_are_folded_and_drawn_when_opened(reader: Reader, report: Path) -> None:
    reader.page.goto(report.as_uri())
    reader.page.wait_for_selector("#answer-1-1 .main-svg")
    links = reader.page.locator("#overview-section tbody a")
    assert links.count() == reader.page.locator("section[data-comparison]").count() == 3
    seeds = reader.page.locator("#comparison-3-seeds")
    expect(seeds).to_be_hidden()
    links.last.click()
    assert reader.page.url.endswith("#comparison-3")
    seeds.scroll_into_view_if_needed()
    seeds.locator(".main-svg").first.wait_for()
    expect(reader.page.locator("#comparison-1-seeds")).to_be_hidden()
    reader.page.locator("#comparison-1 summary").first.click()
    reader.page.locator("#comparison-1-seeds .main-svg").first.wait_for(state="attached")
    assert reader.complaints == []


@pytest.mark.slow
def test_a_browser_that_cannot_unpack_charts_has_the_tables(reader: Reader, small_report: Path) -> None:
    reader.page.add_init_script("delete window.DecompressionStream")
    reader.page.goto(small_report.as_uri())
    expect(reader.page.locator("#old-browser")).to_be_visible()
    assert reader.page.locator("#comparison-1 td[data-field=mastered]").first.inner_text() != ""
    assert reader.complaints == []


@pytest.mark.slow
def test_a_dark_page_has_maps_that_get_paler_for_more(reader: Reader, report: Path) -> None:
    reader.page.emulate_media(color_scheme="dark")
    reader.open(report)
    reader.read_through()
    scale = reader.page.evaluate(
        """() => [...document.querySelectorAll(".plot")].flatMap(plot => plot._fullData || [])
            .find(trace => trace.type === "heatmap").colorscale.map(([_, colour]) => colour)"""
    )
    light = [sum(bytes.fromhex(colour.removeprefix("#"))) for colour in (scale[0], scale[-1])]
    assert light[0] < light[1]
