"""The command `tma-ray import`, from the user's copy to what environments and analyses take."""

import pickle
from pathlib import Path

import numpy as np
import pytest
from hostile_pickles import shell
from release_folders import Release, stumps

from tma_ray.benchmark import load_test_set
from tma_ray.cli import main
from tma_ray.importing.teacher_history import DIMENSIONS
from tma_ray.terrain.cppn import CPPN, SHAPES

PARKOUR = DIMENSIONS["parkour"]


def run(*arguments: object) -> int:
    return main([*map(str, arguments)])


@pytest.mark.slow
def test_from_their_folder_to_a_ranking(
    release: Release, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    for seed in range(2):
        release.sac(stumps("Random", 1), seed=seed, mastered=[0, 10 + seed])
        release.sac(stumps("ALP-GMM", 1), seed=seed, mastered=[0, 50 + seed])
    root = tmp_path / "root"
    assert run("import", "results", release.root, "-o", root) == 0
    assert "4 runs of Box2D, 0 unfinished, 0 seeds left out" in capsys.readouterr().out
    assert run("ranking", root) == 0
    shown = capsys.readouterr().out
    assert "50.5" in shown
    assert "10.5" in shown
    assert run("tables", root) == 0
    assert "worlds of Box2D" in capsys.readouterr().out


@pytest.mark.slow
def test_reports_and_figures_of_an_imported_root(release: Release, tmp_path: Path) -> None:
    for seed in range(2):
        release.sac(stumps("Random", 1), seed=seed)
        release.sac(stumps("ALP-GMM", 1), seed=seed)
    root = tmp_path / "root"
    assert run("import", "results", release.root, "-o", root) == 0
    assert run("report", root, "-o", tmp_path / "report") == 0
    assert "Box2D" in (tmp_path / "report" / "index.html").read_text()
    assert run("figures", root, "-o", tmp_path / "figures", "--only", "curves") == 0


def test_what_was_not_imported_is_said_and_is_the_exit_status(
    release: Release, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    name = stumps("RIAC", 1)
    release.sac(name, seed=0)
    bad = release.sac(name, seed=1) / "env_params_save.pkl"
    bad.write_bytes(shell(str(tmp_path / "trace")))
    release.sac("ignored_ignore/" + name)
    assert run("import", "results", release.root, "-o", tmp_path / "root") == 1
    told = capsys.readouterr()
    assert "1 runs of Box2D, 0 unfinished, 1 seeds left out" in told.out
    assert "left out:" in told.err
    assert str(bad) in told.err
    assert "ignored_ignore" in told.err
    assert not (tmp_path / "trace").exists()


def test_bad_input_is_refused_with_status_2(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert run("import", "results", tmp_path / "none", "-o", tmp_path / "root") == 2
    assert "argument SOURCE" in capsys.readouterr().err
    assert list(tmp_path.iterdir()) == []


def tasks(count: int = 4) -> np.ndarray:
    low, high = [-0.35, 0.6, -0.1, 0, 0.25, 0, 0, 10], [0.05, 1, 0.3, 1, 0.25, 4, 5, 10]
    return np.random.default_rng(0).uniform(low, high, (count, 8)).astype(np.float32)


@pytest.mark.parametrize(
    "form", ["csv", "csv in other order", "csv without names", "npy", "pkl", "pkl of lists"]
)
def test_test_sets_become_csv_files_that_runs_take(tmp_path: Path, form: str) -> None:
    source = tmp_path / "theirs"
    source.mkdir()
    if form.startswith("csv"):
        order = [*reversed(range(8))] if "order" in form else [*range(8)]
        names = "" if "without" in form else ",".join(PARKOUR[i] for i in order) + "\n"
        rows = [",".join(str(task[i]) for i in order) for task in tasks()]
        (source / "walking.csv").write_text(names + "\n".join(rows) + "\n")
    elif form == "npy":
        np.save(source / "walking.npy", tasks())
    else:
        content = tasks().tolist() if "lists" in form else [*tasks()]
        (source / "walking.pkl").write_bytes(pickle.dumps(content, protocol=2))
    assert run("import", "test-sets", source, "-o", tmp_path / "ours") == 0
    found = load_test_set(str(tmp_path / "ours" / "walking.csv"))
    assert (found.name, found.dimensions) == ("walking", PARKOUR)
    assert np.array_equal(found.tasks, tasks())


def test_columns_of_other_names_are_refused_or_taken_by_position(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    source = tmp_path / "grid.csv"
    source.write_text("mu_h,delta_h\n1.5,2.0\n")
    assert run("import", "test-sets", source, "-o", tmp_path / "ours") == 2
    assert "rename them to stump_height, obstacle_spacing" in capsys.readouterr().err
    assert not (tmp_path / "ours").exists()
    assert run("import", "test-sets", source, "-o", tmp_path / "ours", "--by-position") == 0
    assert load_test_set(str(tmp_path / "ours" / "grid.csv")).tasks.tolist() == [[1.5, 2.0]]


@pytest.mark.parametrize(
    ("content", "reason"),
    [
        ("1,2,3\n4,5,6\n", "tasks of 3 numbers; expected 2"),
        ("stump_height,obstacle_spacing\n1,high\n", "expected a list of tasks"),
        ("stump_height,obstacle_spacing\n1,nan\n", "expected a list of tasks"),
        ("stump_height,obstacle_spacing\n1,-50\n", "outside the valid domain"),
        ("", "expected a list of tasks"),
    ],
)
def test_files_that_are_no_test_set(
    tmp_path: Path, content: str, reason: str, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "a.csv").write_text(content)
    assert run("import", "test-sets", tmp_path / "a.csv", "-o", tmp_path / "ours") == 2
    assert reason in capsys.readouterr().err
    assert not (tmp_path / "ours").exists()


def test_a_hostile_test_set_is_left_out(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    source = tmp_path / "theirs"
    source.mkdir()
    np.save(source / "good.npy", tasks())
    (source / "bad.pkl").write_bytes(shell(str(tmp_path / "trace")))
    np.save(source / "objects.npy", np.array([{}], dtype=object))
    assert run("import", "test-sets", source, "-o", tmp_path / "ours") == 1
    told = capsys.readouterr()
    assert "good.csv: 4 tasks of parkour" in told.out
    assert "bad.pkl" in told.err
    assert "objects.npy" in told.err
    assert not (tmp_path / "trace").exists()


def weights() -> dict[str, np.ndarray]:
    rng = np.random.default_rng(1)
    return {name: rng.normal(0, 1, shape).astype(np.float32) for name, shape in SHAPES.items()}


@pytest.mark.parametrize("form", ["npz", "npz of other names", "pkl by name", "pkl in order"])
def test_weights_become_a_file_that_parkour_takes(tmp_path: Path, form: str) -> None:
    theirs = {f"cppn/layer_{i}": each for i, each in enumerate(weights().values(), start=8)}
    source, target = tmp_path / "theirs.bin", tmp_path / "ours.npz"
    if form.startswith("npz"):
        with source.open("wb") as file:
            np.savez(file, **(theirs | {"step": np.array(1)} if "other" in form else weights()))
    else:
        content = weights() if "name" in form else [*weights().values()]
        source.write_bytes(pickle.dumps(content, protocol=2))
    assert run("import", "weights", source, "-o", target) == 0
    found = CPPN.load(target)
    assert all(np.array_equal(found.weights[name], each) for name, each in weights().items())


@pytest.mark.parametrize(
    ("name", "content", "reason"),
    [
        ("model.ckpt.index", b"", "only TensorFlow reads"),
        ("model.ckpt.data-00000-of-00001", b"", "only TensorFlow reads"),
        ("a.pkl", pickle.dumps([np.zeros((3, 3))]), r"has the matrices 0 (3, 3); expected five, w1 (4, 64)"),
        ("a.pkl", pickle.dumps([*weights().values()] * 2), "expected five"),
        ("a.pkl", pickle.dumps(weights() | {"w1": np.full((4, 64), np.nan)}), "expected finite numbers"),
        ("a.npz", b"PK\x05\x06" + bytes(18), "expected five"),
        ("a.pkl", b"", "was refused"),
    ],
)
def test_what_is_no_network(
    tmp_path: Path, name: str, content: bytes, reason: str, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / name).write_bytes(content)
    assert run("import", "weights", tmp_path / name, "-o", tmp_path / "ours.npz") == 2
    assert reason in capsys.readouterr().err
    assert not (tmp_path / "ours.npz").exists()


def test_hostile_weights_run_nothing(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "a.pkl").write_bytes(shell(str(tmp_path / "trace")))
    assert run("import", "weights", tmp_path / "a.pkl", "-o", tmp_path / "ours.npz") == 2
    assert "a.pkl was refused" in capsys.readouterr().err
    assert not (tmp_path / "trace").exists()


def test_nothing_is_overwritten(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    np.savez(tmp_path / "a.npz", **weights())
    (tmp_path / "a.csv").write_text("1.5,2.0\n")
    assert run("import", "weights", tmp_path / "a.npz", "-o", tmp_path / "a.npz") == 2
    assert run("import", "test-sets", tmp_path / "a.csv", "-o", tmp_path) == 2
    assert capsys.readouterr().err.count("there already") == 2
    assert run("import", "weights", tmp_path / "a.npz", "-o", tmp_path / "a.bin") == 2
