"""Figures: what they show, their files, and the command that writes all that results allow."""

import os
import subprocess
import sys
from pathlib import Path

import matplotlib as mpl
import numpy as np
import pandas as pd
import pytest
from hypothesis import example, given
from hypothesis import strategies as st
from matplotlib.figure import Figure
from PIL import Image
from synthetic_results import SyntheticCampaign

from analysis.charts.base import END
from analysis.charts.paper.style import Vector, png, save, svg
from analysis.commands.paper import write_figures
from analysis.data.columns import GROUP
from analysis.data.curricula import Axis
from analysis.figures import learning_curve, mastery_map, seeds_chart
from analysis.formatting import number, plus_minus, steps_text
from analysis.names import label, plain_name, short_labels, teacher_order
from analysis.teacher_styles import shown_together, teacher_style
from tma_ray.cli import main
from tma_ray.support.texts import rounded_duration, visible

LOOK_OF_FRONTIER = ("#cc8866", ">", (0, (6, 2)))
PLANE = (Axis("Height", 0, 3), Axis("Spacing", 0, 6))
KNOWN = ["random", "adr", "alp_gmm", "covar_gmm", "goal_gan", "riac", "setter_solver", "spdl"]


def curves(*rows: tuple[str, int, float], teacher: str = "adr") -> pd.DataFrame:
    table = pd.DataFrame(rows, columns=["run_id", "step", "mastered_percent"])
    return table.assign(**dict.fromkeys(GROUP, "x") | {"teacher": teacher})


def test_known_teachers_have_colours_of_their_own() -> None:
    assert len({teacher_style(teacher).colour for teacher in KNOWN}) == len(KNOWN)
    assert len({teacher_style(teacher).marker for teacher in KNOWN}) == len(KNOWN)
    assert label("alp_gmm") == "ALP-GMM"
    assert sorted(["spdl", "adr", "random"], key=teacher_order) == ["random", "adr", "spdl"]


@given(st.text(min_size=1, max_size=20))
@example("tRACED")
def test_any_other_teacher_is_called_by_its_own_name(name: str) -> None:
    assert label(name) == visible(name) or plain_name(label(name)) == plain_name(name)


def test_how_another_teacher_looks_follows_from_its_name_alone() -> None:
    # Pinned: figures of different reports, made on different days, must agree.
    assert teacher_style("frontier") == LOOK_OF_FRONTIER
    assert teacher_style("frontier") != teacher_style("horizon")


def test_forty_teachers_shown_together_have_looks_and_short_names_of_their_own() -> None:
    teachers = [*KNOWN, *(f"a_rather_long_teacher_name_{number}_of_ours" for number in range(32))]
    with shown_together(teachers):
        looks = {teacher: teacher_style(teacher) for teacher in teachers}
        with shown_together(teachers[::-1][:5]):  # a figure of a page
            assert {teacher: teacher_style(teacher) for teacher in teachers} == looks
    assert len({(style.colour, style.marker) for style in looks.values()}) == 40
    colours = [style.colour for style in looks.values()]
    assert max(map(colours.count, colours)) == 2
    assert teacher_style(teachers[-1]) == teacher_style(teachers[-1])
    with shown_together(["frontier"]):
        assert teacher_style("frontier") == LOOK_OF_FRONTIER
    names = short_labels(teachers)
    assert set(names) == set(teachers)
    assert len(set(names.values())) == 40


@given(st.sets(st.text("ab", min_size=1, max_size=40), min_size=1, max_size=12), st.integers(4, 20))
def test_short_names_are_short_and_of_one_teacher_each(names: set[str], length: int) -> None:
    short = short_labels(names, length)
    assert len(set(short.values())) == len(names)
    assert all(short[name] == name for name in names if len(name) <= length)
    assert max(map(len, short.values())) <= length + len(" (12)")


def test_a_curve_draws_mean_and_standard_error() -> None:
    rows = [(f"run{s}", step, step / 10 + 10 * s) for s in range(2) for step in (0, 1000, 2000)]
    axes = learning_curve(curves(*rows), "mastered_percent", "Mastered (%)").axes[0]
    line = next(line for line in axes.lines if line.get_label() == "ADR")
    np.testing.assert_allclose(line.get_ydata(), [5, 105, 205])
    low, high = axes.collections[0].get_paths()[0].get_extents().get_points()
    # Two values 10 apart: standard deviation 10 / sqrt 2, standard error 5.
    assert (low[1], high[1]) == pytest.approx((0, 210))


def test_a_curve_is_thin_where_runs_are_missing_and_starts_where_all_have_values() -> None:
    rows = [(run, step, 1.0) for run, steps in (("a", (0, 1, 2, 3)), ("b", (1, 2))) for step in steps]
    lines = learning_curve(curves(*rows), "mastered_percent", "").axes[0].lines
    thick = next(line for line in lines if line.get_label() == "ADR")
    assert list(thick.get_xdata()) == [1, 2]
    drawn = np.concatenate([line.get_xdata() for line in lines])
    assert (min(drawn), max(drawn)) == (1, 3)


def test_seeds_are_rings_beside_their_mean_and_its_interval() -> None:
    points = pd.DataFrame({"teacher": "adr", "seed": range(3), "step": END, "value": [10.0, 20.0, 60.0]})
    axes = seeds_chart(points, "Mastered (%)", "seeds", "", "").axes[0]
    rings, interval = axes.collections
    np.testing.assert_allclose(rings.get_offsets()[:, 0], [10, 20, 60])
    ((low, _), (high, _)) = interval.get_segments()[0]
    assert low < 30 < high


@pytest.mark.parametrize(
    ("places", "shares", "drawn"),
    [
        ([(h, s) for s in (0, 6) for h in (0, 1, 3)], [1, 2, 3, 4, 5, 6], [[10, 20, 30], [40, 50, 60]]),
        ([(i, i * i) for i in range(3)], [0, 10, 5], [[100, 50, 0]]),  # scattered: a row for each teacher
    ],
)
def test_tasks_are_mapped(places: list[tuple[int, int]], shares: list[int], drawn: list[list[int]]) -> None:
    index = range(len(places))
    tasks = pd.DataFrame({"task": [np.array(place, np.float32) for place in places], "task_index": index})
    table = pd.DataFrame({"teacher": "adr", "task_index": index, "share": np.array(shares) / 10})
    mesh = mastery_map(table, tasks, PLANE).axes[0].collections[0]
    np.testing.assert_allclose(mesh.get_array(), drawn)


def test_drawing_leaves_settings_alone_and_repeats_itself() -> None:
    before = dict(mpl.rcParams)
    table = curves(("a", 0, 1.0), ("a", 1000, 2.0), teacher="$x^{")
    first, second = (png(learning_curve(table, "mastered_percent", "y")) for _ in range(2))
    assert first == second
    assert dict(mpl.rcParams) == before


def test_figures_do_not_depend_on_users_settings(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """With ``text.usetex`` it would need LaTeX."""
    monkeypatch.setenv("PATH", str(tmp_path))  # without LaTeX
    others = {"text.usetex": True, "axes.grid": True, "savefig.bbox": "tight", "lines.linestyle": "--"}
    found = []
    for settings in ({}, others):
        with mpl.rc_context(settings):
            figure = learning_curve(curves(("a", 0, 1.0), ("a", 1000, 2.0)), "mastered_percent", "y")
            files = save(figure, tmp_path / "figure")
            found.append([png(figure), svg(figure), *(file.read_bytes() for file in files)])
    assert found[0] == found[1]


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        (number(-1.25), "\N{MINUS SIGN}1.2"),
        (number(float("nan")), "\N{EN DASH}"),
        (plus_minus(3.0, float("nan")), "3.0"),
        (plus_minus(3.0, 0.25), "3.0 ± 0.2"),
        (steps_text(20_000_000), "20 million"),
        (steps_text(12_500), "12.5 thousand"),
        (steps_text(500), "500"),
        (rounded_duration(40), "40 s"),
        (rounded_duration(600), "10 minutes"),
        (rounded_duration(9000), "2.5 hours"),
    ],
)
def test_numbers_as_text(text: str, expected: str) -> None:
    assert text == expected


def figure() -> Figure:
    shown = Figure(figsize=(2, 1))
    shown.subplots().plot([1, 2], label="ALP-GMM ★")
    shown.legend()
    return shown


@pytest.mark.parametrize(("vector", "start"), [(Vector.PDF, b"%PDF"), (Vector.SVG, b"<?xml")])
def test_the_same_figure_gives_the_same_bytes(tmp_path: Path, vector: Vector, start: bytes) -> None:
    """Of any day, with endings added and folders made."""
    files = save(figure(), tmp_path / "deep" / "after-0.5", vector)
    assert files == tuple(tmp_path / "deep" / f"after-0.5.{ending}" for ending in (vector, "png"))
    first = [file.read_bytes() for file in files]
    assert first == [file.read_bytes() for file in save(figure(), tmp_path / "two", vector)]
    assert first[0].startswith(start)
    assert first[1].startswith(b"\x89PNG")
    assert not [mark for mark in (b"CreationDate", b"<dc:date>", b"tIME") if mark in b"".join(first)]


@pytest.mark.slow
def test_bytes_do_not_depend_on_the_process(tmp_path: Path) -> None:
    code = "import sys, test_figures as t; t.save(t.figure(), sys.argv[1], t.Vector(sys.argv[2]))"
    path = os.pathsep.join([str(Path(__file__).parent), *sys.path])
    for vector in Vector:
        for seed in ("1", "2"):
            environment = {**os.environ, "PYTHONHASHSEED": seed, "PYTHONPATH": path}
            arguments = [sys.executable, "-c", code, str(tmp_path / seed), vector.value]
            subprocess.run(arguments, check=True, env=environment)
        for ending in (vector.value, "png"):
            first, second = ((tmp_path / f"{seed}.{ending}").read_bytes() for seed in "12")
            assert first == second


@pytest.mark.slow
def test_the_papers_own_numbers_give_its_radar_and_its_bars(tmp_path: Path) -> None:
    written = write_figures("paper-2021", tmp_path, "svg")
    assert {file.name for file in written.files} == {
        "radar.svg", "radar.png", "bars-parkour.svg", "bars-parkour.png", "bars-stump_tracks.svg",
        "bars-stump_tracks.png",
    }  # fmt: skip
    assert not written.left_out


@pytest.mark.slow
def test_a_campaign_gives_curves_maps_films_and_says_what_is_missing(tmp_path: Path) -> None:
    campaign = SyntheticCampaign(tmp_path / "root", episode_steps=20_000, updates=4, evaluation_every=500_000)
    for teacher in ("random", "alp_gmm"):
        for seed in range(2):
            campaign.run(teacher, seed)
    written = write_figures(tmp_path / "root", tmp_path / "figures")
    found = {file.name for file in written.files}
    place = "original-classic_bipedal-sac-low"
    assert found >= {
        "bars-stump_tracks.pdf", "curves-01-stump_tracks-original-low.png",
        "pairs-01-stump_tracks-original-low.png", f"{place}-mastery-stump_tracks.pdf", f"{place}-film.pdf",
        f"{place}-motion.gif",
    }  # fmt: skip
    assert any(text.startswith("radar: ") for text in written.left_out)
    with Image.open(tmp_path / "figures" / f"{place}-motion.gif") as motion:
        assert motion.n_frames > 1


@pytest.mark.slow
def test_only_some_are_drawn_if_asked(tmp_path, told, campaign, capsys):
    output = tmp_path / "figures"
    for only, name in (("radar", "radar"), ("parkour", "bars-parkour")):
        files = told(0, "figures", "paper-2021", "-o", output, "--only", only).split()
        assert files == [f"{output}/{name}.pdf", f"{output}/{name}.png"]
    error = told(2, "figures", "paper-2021", "-o", output, "--only", "radr")
    assert "no figure's name begins with 'radr'" in error
    assert "radar, bars-parkour, bars-stump_tracks" in error
    assert main(["figures", str(campaign.root), "-o", str(output)]) == 0
    assert "holds no runs yet" in capsys.readouterr().err
