"""Event files hold each published row once, whatever happens to campaigns and to the command."""

from __future__ import annotations

import json
import math
import struct
import sys
from collections import defaultdict
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest
from synthetic_results import SyntheticCampaign

from analysis.tracking import points
from analysis.tracking.event_folder import EventFolder
from tma_ray.cli import main
from tma_ray.results import RunWriter, Table

if TYPE_CHECKING:
    from tensorboardX.proto.event_pb2 import Event

Series = dict[str, list[tuple[int, float]]]


def events_of(file: Path, whole: bool) -> list[Event]:
    """Parse TFRecord: length, its checksum, data, its checksum; the last record need not be whole."""
    from tensorboardX.proto.event_pb2 import Event  # it imports torch, seconds in every process of the suite
    from tensorboardX.record_writer import masked_crc32c

    content, found = file.read_bytes(), []
    while content:
        if not whole and len(content) < 16 + int.from_bytes(content[:8], "little"):
            break
        (length,) = struct.unpack("<Q", content[:8])
        data, (checksum,) = content[12 : 12 + length], struct.unpack("<I", content[12 + length : 16 + length])
        assert struct.unpack("<I", content[8:12]) == (masked_crc32c(content[:8]),)
        assert checksum == masked_crc32c(data)
        found.append(Event.FromString(data))
        content = content[16 + length :]
    return found


def scalars(folder: Path, whole: bool = True) -> dict[str, Series]:
    """Return by sub-folder and tag what TensorBoard would show: files in the order of their names."""
    found: dict[str, Series] = defaultdict(lambda: defaultdict(list))
    for file in sorted(folder.rglob("*tfevents*")):
        events = events_of(file, whole)
        assert not events or events[0].file_version == "brain.Event:2"
        for event in events:
            for value in event.summary.value:
                series = found[str(file.parent.relative_to(folder))][value.tag]
                series.append((event.step, value.simple_value))
    return {name: dict(tags) for name, tags in found.items()}


def export(root: Path, folder: Path) -> dict[str, Series]:
    assert main(["tensorboard", str(root), str(folder)]) == 0
    return scalars(folder)


def window(step: int) -> dict[str, Any]:
    means = {"mean_return": step / 10, "std_return": 1.0, "mean_length": 7.5, "success_share": 0.25}
    return {"step": step, "episodes": 3, **means}


def update(step: int, **values: float) -> dict[str, Any]:
    return {"step": step, "episode": step, "gaussians": [], "boxes": [], "scalars": list(values.items())}


def evaluation(step: int, returns: Sequence[float]) -> list[dict[str, Any]]:
    common = {"step": step, "test_set": "line", "length": 1}
    rows = enumerate(returns)
    return [{**common, "task_index": i, "task": [0.0], "episodic_return": float(r)} for i, r in rows]


class Growing:
    """A run that publishes bit by bit."""

    def __init__(self, campaign: SyntheticCampaign, **changes: Any) -> None:
        self.committer, self.record = campaign.committer, campaign.record("alp_gmm", 0, "low", **changes)
        campaign.cell(self.record, "low")
        self.attempt(())

    def attempt(self, parts: Sequence[Any]) -> None:
        """Begin another attempt, from a checkpoint with these parts."""
        self.number = self.committer.start(self.record)
        self.writer = RunWriter(self.committer.store, self.record.run_id, self.number, tuple(parts))

    def add(self, step: int) -> None:
        self.writer.add(Table.TRAINING, [window(step)])
        self.writer.add(Table.EVALUATIONS, evaluation(step, [0, 231, 400, 100]))
        self.writer.add(Table.TEACHER_LOG, [update(step, loss=step / 4, bits=2.0)])

    def publish(self) -> Sequence[Any]:
        parts = self.writer.flush()
        self.committer.publish(self.record, self.number, parts)
        return parts

    def grow(self, *steps: int) -> Sequence[Any]:
        for step in steps:
            self.add(step)
        return self.publish()

    def finish(self) -> None:
        self.committer.finish(self.record, self.number, self.writer.finish())


def expected(steps: Sequence[int]) -> Series:
    constant = {"training/mean_length": 7.5, "training/success_share": 0.25, "teacher/bits": 2.0}
    constant |= {"evaluation/mean_return": 182.75, "evaluation/mastered_percent": 50.0}
    found = {name: [(step, value) for step in steps] for name, value in constant.items()}
    found["training/mean_return"] = [(step, step / 10) for step in steps]
    return found | {"teacher/loss": [(step, step / 4) for step in steps]}


NAME = "original/alp_gmm/sac-original-classic_bipedal-low/seed_0-original-alp_gmm-low-0"


def test_runs_have_scalars_by_their_own_threshold(campaign: SyntheticCampaign, tmp_path: Path) -> None:
    """Everything of a run under way; one that failed, one of another teacher, none of a plan."""
    run = Growing(campaign, spec=json.dumps({"mastery_threshold": 99}))
    run.grow(10)
    failed = campaign.plain_run("alp_gmm", 7, {500: [300.0]}, status="failed")
    random = campaign.plain_run("random", 0, {1000: [300.0]})
    campaign.run("alp_gmm", 8, status="waiting")
    found = export(campaign.root, tmp_path / "events")
    assert found.pop(NAME) == expected([10]) | {"evaluation/mastered_percent": [(10, 75.0)]}
    ids = {name.split("seed_")[1].split("-", 1)[1]: series for name, series in found.items()}
    returns = {run: series["evaluation/mean_return"] for run, series in ids.items()}
    assert returns == {failed: [(500, 300.0)], random: [(1000, 300.0)]}


def test_a_second_call_goes_on_and_touches_nothing_else(campaign: SyntheticCampaign, tmp_path: Path) -> None:
    folder, run = tmp_path / "events", Growing(campaign)
    run.grow(10)
    assert export(campaign.root, folder) == {NAME: expected([10])}
    (folder / "notes.txt").write_text("mine")
    (folder / NAME / "notes.txt").write_text("mine")
    other = folder / "other" / "events.out.tfevents.1"
    other.parent.mkdir()
    other.write_bytes(next((folder / NAME).glob("events*")).read_bytes())
    before = {path: path.read_bytes() for path in folder.rglob("events*")}
    export(campaign.root, folder)
    assert {path: path.read_bytes() for path in folder.rglob("events*")} == before
    run.grow(20)
    for _ in range(2):
        assert export(campaign.root, folder) == {NAME: expected([10, 20]), "other": expected([10])}
    assert before.items() <= {path: path.read_bytes() for path in folder.rglob("events*")}.items()
    assert (folder / "notes.txt").exists()
    assert (folder / NAME / "notes.txt").exists()


def test_a_file_that_a_link_leads_to_is_not_emptied(campaign: SyntheticCampaign, tmp_path: Path) -> None:
    folder, run, theirs = tmp_path / "events", Growing(campaign), tmp_path / "theirs"
    run.grow(10)
    export(campaign.root, folder)
    (file,) = (folder / NAME).iterdir()
    theirs.write_bytes(file.read_bytes() * 2)
    (folder / NAME / "events.out.tfevents.0").symlink_to(theirs)
    before = theirs.read_bytes()
    main(["tensorboard", str(campaign.root), str(folder)])
    assert theirs.read_bytes() == before


@pytest.mark.parametrize("cut", [1, 40, 500])
def test_a_call_that_was_killed_is_made_up_for(campaign: SyntheticCampaign, tmp_path: Path, cut: int) -> None:
    folder, run = tmp_path / "events", Growing(campaign)
    run.grow(10, 20, 30)
    export(campaign.root, folder)
    (file,) = (folder / NAME).iterdir()
    file.write_bytes(file.read_bytes()[:-cut])
    assert scalars(folder, whole=False) != {NAME: expected([10, 20, 30])}
    main(["tensorboard", str(campaign.root), str(folder)])
    assert scalars(folder, whole=False) == {NAME: expected([10, 20, 30])}


def test_points_that_the_root_does_not_have_are_replaced(tmp_path: Path) -> None:
    folder = tmp_path / "events"
    for name, steps in (("one", [10, 20, 30]), ("other", [15, 20]), ("third", [15])):
        run = Growing(SyntheticCampaign(tmp_path / name))
        run.grow(*steps)
        assert export(tmp_path / name, folder) == {NAME: expected(steps)}


def test_a_run_of_two_campaigns_keeps_its_folder(campaign: SyntheticCampaign, tmp_path: Path) -> None:
    folder, run = tmp_path / "events", Growing(campaign)
    run.grow(10)
    export(campaign.root, folder)
    earlier = SyntheticCampaign(campaign.root, campaign="a", experiment="a")
    earlier.cell(run.record, "high")
    assert export(campaign.root, folder) == {NAME: expected([10])}


def test_following_an_interrupted_run_doubles_nothing(campaign: SyntheticCampaign, tmp_path: Path) -> None:
    folder, run = tmp_path / "events", Growing(campaign)
    events = EventFolder(campaign.root, folder)
    assert events.update() == 0
    checkpoint = run.grow(10)
    assert (events.update(), events.update()) == (1, 0)
    assert scalars(folder) == {NAME: expected([10])}
    run.add(20)
    run.writer.flush()  # and killed before it is published
    assert events.update() == 0
    run.attempt(checkpoint)
    run.grow(20)
    assert events.update() == 1
    assert scalars(folder) == {NAME: expected([10, 20])}
    run.attempt(checkpoint)  # the last checkpoint was damaged, and what it published is taken back
    run.publish()
    events.update()
    assert scalars(folder) == {NAME: expected([10])}
    emptied, file = sorted((folder / NAME).iterdir())
    assert emptied.read_bytes() == b""  # but there: a TensorBoard that has it open goes on to the next
    start = events_of(file, whole=True)[1]  # and forgets what was in it
    assert (start.step, start.session_log.status) == (0, start.session_log.START)
    run.grow(20, 30)
    events.update()
    run.finish()
    events.update()
    events.close()
    assert scalars(folder) == {NAME: expected([10, 20, 30])}


def test_watching_looks_again_until_it_is_stopped(campaign, tmp_path, monkeypatch, told):
    run, folder = Growing(campaign), tmp_path / "events"
    steps = iter([10, None, 20])

    def look(_: float) -> None:
        step = next(steps, "stop")
        if step == "stop":
            raise KeyboardInterrupt
        if step is not None:
            run.grow(int(step))

    monkeypatch.setattr(points.time, "sleep", look)
    first, *others = told(130, "tensorboard", campaign.root, folder, "--watch").splitlines()
    assert scalars(folder) == {NAME: expected([10, 20])}
    assert first == f"runs with news: 0; to look at them: tensorboard --logdir {folder}"
    assert others == ["runs with news: 1"] * 2


def test_what_is_no_number_is_left_out(campaign: SyntheticCampaign, tmp_path: Path) -> None:
    run = Growing(campaign)
    values = [update(10, loss=math.nan, bits=1.0), update(20, loss=math.inf), update(30, loss=3.0)]
    run.writer.add(Table.TEACHER_LOG, values)
    run.publish()
    found = export(campaign.root, tmp_path / "events")
    assert found == {NAME: {"teacher/bits": [(10, 1.0)], "teacher/loss": [(30, 3.0)]}}


def test_names_from_a_root_stay_in_the_folder(tmp_path: Path) -> None:
    campaign = SyntheticCampaign(tmp_path / "root", experiment="../../up")
    changes = {"run_id": "r", "student": "mine:Own", "embodiment": "spider:legs=3", "challenge": "/etc"}
    run = Growing(campaign, **changes)
    run.grow(10)
    (name,) = export(campaign.root, tmp_path / "a" / "b" / "events")
    assert name == "up/alp_gmm/mine_Own-etc-spider_legs=3-low/seed_0-r"


def test_what_cannot_be_done_is_refused_before_anything_is_written(campaign, tmp_path, monkeypatch, told):
    (tmp_path / "file").touch()
    for root, folder, message in (
        (tmp_path / "nowhere", tmp_path / "events", "a results root"),
        (campaign.root, tmp_path / "file", "expected a folder"),
        (campaign.root, "s3://bucket/events", "expected a folder of this machine"),
    ):
        assert message in told(2, "tensorboard", root, folder)
    monkeypatch.setitem(sys.modules, "tensorboardX", None)
    said = told(2, "tensorboard", campaign.root, tmp_path / "events")
    assert "pip install 'tma_ray[tensorboard]'" in said
    assert not (tmp_path / "events").exists()
