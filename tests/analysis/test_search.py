"""What a search found, from roots with the results of single points."""

from __future__ import annotations

import json
from pathlib import Path

from rich.console import Console
from synthetic_results import SyntheticCampaign

from analysis.commands.rankings import show_search
from analysis.data.frames import load
from analysis.measures.evaluations import search_results
from tma_ray.benchmark import PPO_GRID, TEACHER_GRIDS


def searched(root: Path, side: str, name: str, returns: dict[int, list[float]]) -> None:
    """Write a seed for each return at the points of a grid; the threshold of mastery is 230."""
    grid = {**TEACHER_GRIDS, "ppo": PPO_GRID}[name]
    names = {"teacher": "random", "student": "sac"} | {side: name}
    for place, values in returns.items():
        spec = {f"{side}_hyperparameters": grid.points()[place] | {"other": 1}}
        campaign = SyntheticCampaign(root, experiment=f"search_{name}_{place:02}")
        for seed, value in enumerate(values):
            campaign.plain_run(
                names["teacher"],
                seed,
                {0: [0.0, 0.0], campaign.steps: [value, 300.0]},
                level="none",
                student=names["student"],
                spec=json.dumps(spec | {"seed": seed}),
            )


def test_points_are_ranked_by_mean_mastered_tasks_and_the_papers_choice_is_marked(tmp_path: Path) -> None:
    searched(tmp_path, "teacher", "alp_gmm", {0: [0.0, 300.0], 1: [0.0, 0.0], 2: [300.0, 300.0]})
    found = search_results(load(tmp_path))
    assert found["mean"].tolist() == [100.0, 75.0, 50.0]
    assert found["chosen"].tolist() == [False, True, False]
    assert found["n"].tolist() == [2, 2, 2]
    assert found["point"].tolist() == [TEACHER_GRIDS["alp_gmm"].points()[place] for place in (2, 0, 1)]


def test_the_best_is_shown_beside_the_papers_choice(tmp_path: Path) -> None:
    searched(tmp_path, "teacher", "alp_gmm", {0: [0.0, 300.0], 2: [300.0, 300.0]})
    searched(tmp_path, "student", "ppo", {5: [300.0, 300.0]})
    console = Console(width=300, record=True)
    show_search(tmp_path, console)
    lines = console.export_text().splitlines()
    (teacher,) = (line for line in lines if "ALP-GMM" in line)
    assert "fit_every 50, most_components 5, explore 0.1" in teacher
    assert "fit_every 150, most_components 10, explore 0.05" in teacher
    assert "75.0 ± 35.4" in teacher
    assert "p = 1.000" in teacher
    (student,) = (line for line in lines if line.startswith("ppo"))
    assert "not run yet" in student


def test_a_root_without_a_search_says_so(tmp_path: Path) -> None:
    SyntheticCampaign(tmp_path).plain_run("random", 0, {0: [1.0]}, status="running")
    console = Console(record=True)
    show_search(tmp_path, console)
    assert "No point of a search" in console.export_text()
