"""Every mistake on the command line is refused by name within a second, and none ends in a traceback."""

import contextlib
import io
import os
import re
import time
import traceback
from collections.abc import Mapping
from dataclasses import dataclass
from decimal import Decimal
from pathlib import Path
from typing import Any

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from mistakes import Mistake, arguments_of, commands, fill, flags, mistakes, valid_rest

from tma_ray.campaign import execution, script
from tma_ray.campaign.progress import Snapshot
from tma_ray.cli import main
from tma_ray.console import types as values
from tma_ray.console.command_line import arguments
from tma_ray.results import AttemptOutcome, Results, Store, check_usable
from tma_ray.support.quantities import Quantity

SECONDS = 1.0
"""Processor time within which a mistake is refused, s."""

QUANTITIES = [each for each in vars(values).values() if isinstance(each, Quantity)]
NUMBERS = ("N", "X", "SECONDS", "GIB")
MISTAKES = sorted(set(mistakes()), key=lambda mistake: mistake.words)


@dataclass(frozen=True)
class Ending:
    """How a command ended: its exit code, what it said on standard error, and its processor time, s."""

    code: int
    said: str
    seconds: float

    def why_not_refused(self, named: tuple[str, ...]) -> str:
        """Return what is wrong with it as a refusal that names one of `named`, empty if nothing is."""
        if "Traceback" in self.said:
            return "a traceback"
        if self.code != 2:
            return f"exit code {self.code}"
        if not any(name in self.said for name in named):
            return "nobody is told what is wrong"
        return "" if self.seconds < SECONDS else f"{self.seconds:.1f} s"


@pytest.fixture
def places(root: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, known_speeds: None) -> dict[str, Any]:
    """What commands may name, right and wrong; nothing is trained, measured or found at home."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.delenv("RAY_ADDRESS", raising=False)
    monkeypatch.setattr(script, "run_locally", lambda *_: AttemptOutcome.DONE)
    monkeypatch.setattr(execution, "execute_plan", _checked_plan)
    for name in ("empty", "foreign", "home", "checkout/.git", "busy/tmp"):
        (tmp_path / name).mkdir(parents=True)
    (tmp_path / "file").write_text("a,b\n1,2\n")
    (tmp_path / "foreign" / "precious.txt").write_text("not ours\n")
    (tmp_path / "loop").symlink_to(tmp_path / "loop")
    names = ("empty", "foreign", "file", "loop", "missing", "new", "home", "checkout", "busy")
    named = {name: tmp_path / name for name in names}
    return {**named, "root": root, "run": Results.open(root).runs()[0].run.run_id}


def _checked_plan(plan: Any, results: str, *_: object) -> Snapshot:
    check_usable(Store.open(results))
    return Snapshot(len(plan.runs), len(plan.runs), 0, 0, 0, 0, 0, [])


def ending(words: tuple[str, ...], places: Mapping[str, Any]) -> Ending:
    said, path, before = io.StringIO(), Path.cwd(), time.process_time()
    with contextlib.redirect_stderr(said), contextlib.redirect_stdout(io.StringIO()):
        try:
            code = main([fill(word, places) for word in words])
        except BaseException as error:
            code = -1
            said.write("".join(traceback.format_exception(error)[-3:]) + "Traceback")
    os.chdir(path)
    return Ending(code, said.getvalue(), time.process_time() - before)


def wrong(mistake: Mistake, places: Mapping[str, Any]) -> str:
    end = ending(mistake.words, places)
    problem = end.why_not_refused(tuple(fill(name, places) for name in mistake.named))
    return problem and f"{mistake.kind}: {' '.join(mistake.words)[:150]!r}: {problem}: {end.said[-300:]}"


@pytest.fixture
def warm(places: Mapping[str, Any]) -> Mapping[str, Any]:
    """Import are not what is timed."""
    for path, _ in commands():
        next(wrong(mistake, places) for mistake in MISTAKES if mistake.words[: len(path)] == path)
    return places


def test_every_kind_of_value_has_mistakes() -> None:
    kinds = {mistake.kind.removesuffix(",...") for mistake in MISTAKES}
    used = {
        str(argument.parameter.metavar).removesuffix(",...")
        for path, _ in commands()
        for argument in arguments_of(path)
        if argument.parameter.metavar
    }
    assert used <= kinds


def test_every_number_is_of_the_one_grammar() -> None:
    for path, _ in commands():
        for argument in arguments_of(path):
            if argument.parameter.metavar in NUMBERS:
                parse = argument.parameter.converter.parse  # type: ignore[union-attr]
                assert isinstance(parse, Quantity), f"{' '.join(path)} {argument.names}"


@settings(max_examples=60, suppress_health_check=list(HealthCheck))
@given(mistake=st.sampled_from(MISTAKES))
def test_mistakes_are_refused_by_name(warm: Mapping[str, Any], mistake: Mistake) -> None:
    assert wrong(mistake, warm) == ""


WRITERS = [
    (path, argument)
    for path, app in commands()
    for argument in arguments(app, described=True)
    if argument.parameter.metavar == "ROOT"
    and "to write" in str(argument.parameter.help)
    and path != ("plan",)
]
"""Commands that write a results root, and their options that name it."""


@pytest.mark.parametrize("place", ["/", "{home}", "{checkout}", "{busy}"])
def test_no_command_makes_a_root_where_others_have_files(places, monkeypatch, place):
    monkeypatch.setenv("HOME", str(places["home"]))
    (places["busy"] / "tmp" / "notes.txt").write_text("mine")
    assert len(WRITERS) >= 6
    for path, argument in WRITERS:
        words = [word for word in valid_rest(path, argument) if word != "--dry-run"]
        end = ending((*path, *words, f"{flags(argument)[-1]}={place}"), places)
        assert end.code == 2, (path, end.said)
        assert re.search("results need a folder of their own|empty", end.said), (path, end.said)
    assert not [*Path.cwd().rglob("root.json"), *Path.cwd().rglob("lease.json"), *Path("/").glob("root.json")]
    assert len(list(places["busy"].rglob("*"))) == 2


@settings(max_examples=150)
@given(
    text=st.from_regex(r"[+-]?[0-9_.]{0,12}([eE][+-]?[0-9]{1,3})?[kKmMG]{0,2}", fullmatch=True)
    | st.text(max_size=8)
)
def test_numbers_are_read_or_refused(text: str) -> None:
    """By every quantity, against another reading of the same grammar."""
    found = re.fullmatch(r"\s*(-?)([0-9]+(?:_[0-9]+)*)(\.[0-9]+)?(?:[eE]([+-]?[0-9]{1,3}))?([kKM]?)\s*", text)
    value = None
    if found:
        sign, whole, rest, exponent, unit = found.groups()
        power = int(exponent or 0) + {"": 0, "k": 3, "K": 3, "M": 6}[unit]
        value = Decimal(f"{sign}{whole.replace('_', '')}{rest or ''}").scaleb(power)
    for quantity in QUANTITIES:
        fits = value is not None and quantity.least <= value <= quantity.most
        fits = fits and not (quantity.whole and value % 1)
        if fits and not (quantity.positive and float(value) == quantity.least):
            assert quantity(text) == pytest.approx(float(value), rel=1e-12)
            quantity.check("it", quantity(text))
        else:
            with pytest.raises(ValueError, match="expected"):
                quantity(text)


@pytest.mark.slow
def test_the_whole_catalogue_is_refused(warm: Mapping[str, Any]) -> None:
    assert [problem for mistake in MISTAKES if (problem := wrong(mistake, warm))] == []


@pytest.mark.parametrize(
    ("words", "said"),
    [
        ("plan parkour --tier smoke --start-from file:///etc/passwd", "it is a file; expected a folder"),
        ("plan parkour --tier smoke --start-from {missing}", "is not a results root"),
        ("plan parkour --tier smoke --start-from {foreign}", "is not a results root"),
        ("plan parkour --tier smoke --results {foreign}", "neither empty (precious.txt) nor"),
        ("campaign --seeds 1 --steps 300 --dry-run --results {foreign}", "neither empty (precious.txt) nor"),
        ("campaign --cohort +5 --dry-run", "'+5': expected a number of slots such as 48, or off"),
        ("release {root} mine --partial --licence +5", "'+5': expected a licence"),
        (
            "release {root} mine --partial --core nothing",
            "no campaign 'nothing': the release has single_runs",
        ),
        (
            "simulate --episodes 20m",
            "unknown unit 'm': k is a thousand, M a million; expected a whole number",
        ),
        ("status ~nosuchuser/x", "no home folder is known for '~nosuchuser'"),
        ("status ftp://host/root", "expected a folder, or an address that begins with s3://"),
        ("ranking lite-9", "'lite-9' is not a results root, nor the name of a baseline"),
    ],
)
def test_values_that_nothing_needs_are_checked(places: Mapping[str, Any], words: str, said: str) -> None:
    end = ending(tuple(words.split()), places)
    assert (end.code, said in end.said) == (2, True), end.said


def test_every_refusal_of_a_choice_names_all_choices(places: Mapping[str, Any]) -> None:
    chosen = 0
    for path, _ in commands():
        for argument in arguments_of(path):
            if not (choices := argument.get_choices()):
                continue
            rest, option = valid_rest(path, argument), flags(argument)[-1:]
            end = ending((*path, *(word or "nothing" for word in rest), *option, "nothing"), places)
            assert end.code == 2
            assert ", ".join(choices) in end.said, (path, option, end.said)
            chosen += 1
    assert chosen > 10
