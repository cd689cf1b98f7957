"""Every figure that results allow is written, and what is left out is said."""

from __future__ import annotations

from pathlib import Path

import pytest
from PIL import Image
from synthetic_results import SyntheticCampaign

from analysis.commands.figures import write_figures
from tma_ray.cli import main


def names(files: tuple[Path, ...]) -> set[str]:
    return {file.name for file in files}


@pytest.mark.slow
def test_the_papers_own_numbers_give_its_radar_and_its_bars(tmp_path: Path) -> None:
    written = write_figures("paper-2021", tmp_path, "svg")
    assert names(written.files) == {
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
    found = names(written.files)
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
def test_only_some_are_drawn_if_asked(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    output = str(tmp_path / "figures")
    assert main(["figures", "paper-2021", "-o", output, "--only", "radar"]) == 0
    assert capsys.readouterr().out.split() == [f"{output}/radar.pdf", f"{output}/radar.png"]
    assert main(["figures", "paper-2021", "-o", output, "--only", "radr"]) == 2
    error = capsys.readouterr().err
    assert "no figure's name begins with 'radr'" in error
    assert "radar, bars-parkour, bars-stump_tracks" in error
    assert main(["figures", "paper-2021", "-o", output, "--only", "parkour"]) == 0
    assert capsys.readouterr().out.split() == [f"{output}/bars-parkour.pdf", f"{output}/bars-parkour.png"]
    SyntheticCampaign(tmp_path / "empty")
    assert main(["figures", str(tmp_path / "empty"), "-o", output]) == 0
    assert "holds no runs yet" in capsys.readouterr().err
