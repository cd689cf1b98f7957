"""Mistakes on the command line, generated from the parser: every option with every kind of wrong value."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from typing import Any

from cyclopts import App, Argument

from tma_ray import cli
from tma_ray.console import command_line

LONG = "x" * 300
"""Name that is too long for a file."""

NO_NUMBERS = (
    *("", " ", "nan", "inf", "-inf", "-1", "0x10", "1e400", "10kM", "5Mk", "k", "ten", "--"),
    *("1/2", "½", "+5", "5m", "5G"),
)

TOO_MANY = ("1e30", "99999999999999999999")

NO_FOLDERS = (
    *("~nosuchuser/x", "{file}", "{file}/below", "{loop}", "/dev/null", "/dev/full/x", "nul\0", LONG, ""),
)

NO_ROOTS = (
    *(*NO_FOLDERS, "s3://", "gs://", "ftp://host/root", "s3:///root"),
    *("file://{file}", "file:///dev/null", "\n"),
)

NO_PLUGINS = (
    *("nothing_like_it", "os:system", "os:path", "json:JSONDecodeError", ":", "a:", ":b"),
    *("no.module:Name", "os:no such", "random:no=1:no=2", LONG),
)

BY_KIND: Mapping[str, Sequence[str]] = {
    "NAME": ("", " ", "\n"),
    "ROOT": NO_ROOTS,
    "RUN": ("", "zzz", "*", "../root", LONG),
    "POLICY": ("~nosuchuser/x", "", "zzz", "{file}", "{missing}", "{empty}", "{loop}", "nul\0"),
    "BASELINE": ("~nosuchuser/x", "paper-2020", "{missing}", "{file}", "{empty}", "", "nul\0"),
    "EXPERIMENT": ("stump_track", "", "all", "../x", LONG),
    "KIND": ("teacher", "", "all"),
    "LEVEL": ("medium", "", "HIGH", "1"),
    "TASK": ("", "nan,nan", "1", "1,2,3,4", "a,b", "stump_heigt=1", "1e300,1", "=1", "randon", "0.5;3"),
    "SEEDS": (
        *NO_NUMBERS,
        *("0-99999999", "5-3", "3-", "-3", "1-2-3", "a-b", "0,0", ",", "1e3", "0-1e9", "0,-1", "0.5", "0"),
        "100000000000",
    ),
    "SPACE": (
        *("", "stump_height", "stump_height=", "stump_height=1", "stump_height=3:0", "stump_height=nan:1"),
        *("stump_height=0:inf", "stump_heigt=0:1", "stump_height=0:1e300", "stump_height=0:1:2", "=0:1"),
        "stump_height=0:1,stump_height=0:2",
    ),
    "FOLDER": NO_FOLDERS,
    "FILE": (
        *("~nosuchuser/x.csv", "{empty}", "{file}/below.csv", "{loop}", "/dev/full", "x.unknown", "nul\0"),
        *("", f"{LONG}.gif"),
    ),
    "ADDRESS": ("", "host", "host:port", "host:99999", "http://x", "::", "ray://127.0.0.1:10001"),
    "DEVICE": ("", "gpu", "cuda:-1", "cuda:9", "cpu:1", "CPU", "tpu", "meta"),
    "LICENCE": ("", " ", "\n", "my own", LONG, "CC BY 4.0", "+5", "5", "-", "MIT OR"),
    "TEXT": ("", " ", "\n"),
    "SIZE": ("", "0x0", "1x1", "640", "640x", "x480", "-1x-1", "640x480x3", "1e30x5", "99999x99999", "6*4"),
    "N": (*NO_NUMBERS, *TOO_MANY, "0.5", "0.0001k", "1,5"),
    "WIDTH": (*NO_NUMBERS, *TOO_MANY, "0", "0.5", "of", "OFF"),
    "X": (*NO_NUMBERS, *TOO_MANY, "1,5"),
    "SECONDS": (*NO_NUMBERS, *TOO_MANY, "1,5"),
    "HOURS": (*NO_NUMBERS, *TOO_MANY, "0h", "-1h", "8 o'clock", "1h30", "nanh"),
    "POINTS": (*NO_NUMBERS, *TOO_MANY, "0", "101", "5%"),
    "GIB": (*NO_NUMBERS, *TOO_MANY, "1,5"),
    "NAME=VALUE": ("", "a", "=1", "aa=", "nothing=1"),
}
"""Invalid values by metavar, with placeholders for paths in braces."""

NO_RESULTS = ("{missing}", "{empty}", "{foreign}")

BY_OPTION: Mapping[str, Sequence[str]] = {
    "teacher": (*NO_PLUGINS, "riac:no=1", "alp_gmm:fit_every=nan", "alp_gm"),
    "student": (*NO_PLUGINS, "riac", "ppo:learning_rate=ten", "ppoo"),
    "environment": (*NO_PLUGINS, "stump_track", "stump_tracks:no=1"),
    "embodiment": ("nothing_like_it", "wheel:size=1e30", "wheel:size=nan", "wheel:size=-1", "spidre", LONG),
    "challenge": ("nothing_like_it", "originl", "original:no=1"),
    "test_set": ("~nosuchuser/x.csv", "nothing_like_it", "{empty}", "{file}", "{loop}", "nul\0", LONG),
    "name": ("no name", "a/b", "..", LONG),
    "only": ("nothing_like_it", LONG),
    **dict.fromkeys(("root", "start_from"), NO_RESULTS),
    "results": ("{foreign}",),
    "core": ("nothing_like_it",),
}
"""Further invalid values by argument."""

NOT_READ = (("doctor", "results"), ("play", "results"), ("render", "results"))
"""Commands and their arguments for roots that are not read."""

SMALL: Mapping[str, Sequence[str]] = {
    "run": ("--student", "ppo", "--steps", "300"),
    "campaign": ("--students", "ppo", "--steps", "300", "--seeds", "1"),
    "plan": ("--tier", "smoke"),
    "experiment": ("--tier", "smoke", "--dry-run"),
    "quickstart": ("--dry-run",),
    "simulate": ("--teachers", "random", "--challenges", "original", "--episodes", "2", "--seeds", "1"),
    "render": ("--steps", "2"),
    "play": ("--output", "{new}.html"),
    **dict.fromkeys(("logs", "export"), ("--results", "{root}")),
    "release": ("--partial",),
}
"""Options by command that limit its work or name its inputs."""

VALID: Mapping[str, str] = {
    "ROOT": "{root}",
    **dict.fromkeys(("RUN", "POLICY"), "{run}"),
    "EXPERIMENT": "parkour",
    "BASELINE": "paper-2021",
    "NAME": "random",
    "FOLDER": "{new}",
    "FILE": "{new}.gif",
}
"""Valid values of required arguments by metavar."""


@dataclass(frozen=True)
class Mistake:
    """Command line with one mistake."""

    words: tuple[str, ...]
    named: tuple[str, ...]  # texts, one of which must occur in the error message
    kind: str


def mistakes() -> Iterator[Mistake]:
    """Yield all mistakes: wrong values of all options of all commands, and unknown options."""
    for path, _ in commands():
        rest = valid_rest(path, None)
        yield Mistake((*path, *rest, "--no-such-option"), ("--no-such-option",), "unknown option")
        if len(rest) == 0:
            yield Mistake((*path, "no", "such", "word"), ("no such word", "'no'"), "unknown word")
        for argument in arguments_of(path):
            yield from _of_option(path, argument)


def commands() -> Iterator[tuple[tuple[str, ...], App]]:
    """Yield all commands with the words that select them."""
    for path, app in command_line.commands(cli.app()):
        if app.default_command is not None:
            yield path, app


@cache
def arguments_of(path: tuple[str, ...]) -> Sequence[Argument]:
    """Return the arguments and options of a command (cached, since they take 10 ms to build)."""
    return command_line.arguments(dict(commands())[path])


def flags(argument: Argument) -> list[str]:
    """Return the names of an option, short ones first; none for a positional argument."""
    return sorted((name for name in argument.names if name.startswith("-")), key=len)


def valid_rest(path: tuple[str, ...], leave: Argument | None) -> list[str]:
    """Return a small valid command line without the argument `leave`, "" in place of a positional one."""
    words = list(SMALL.get(" ".join(path), ()))
    left = leave.names if leave is not None else ()
    for option in left:
        if option in words:
            place = words.index(option)
            del words[place : place + 2]
    for argument in arguments_of(path):
        if argument.names == left and not flags(argument):
            words.append("")
        elif argument.names != left and argument.required:
            metavar = argument.parameter.metavar
            choices = argument.get_choices()
            value = choices[0] if choices else VALID.get(str(metavar), "")
            if not flags(argument):
                words.append(value)
            elif not set(flags(argument)) & set(words):
                words += [flags(argument)[-1], value]
    return words


def _of_option(path: tuple[str, ...], argument: Argument) -> Iterator[Mistake]:
    rest, option = valid_rest(path, argument), (flags(argument) or [""])[-1]
    if option:
        misspelt = f"{option[:3]}{option[4:]}" if len(option) > 6 else f"{option}q"
        yield Mistake((*path, *rest, misspelt), (misspelt,), "misspelt option")
    if argument.hint is bool:
        for value in ("1", "true", "no", ""):
            yield Mistake((*path, *rest, f"{option}={value}"), (option,), "value of a flag")
        yield Mistake((*path, *rest, f"--no-{option[2:]}"), (f"--no-{option[2:]}",), "unknown option")
        return
    if option:
        yield Mistake((*path, *rest, option), (option,), "option without its value")
    for value in _values(path[-1], argument):
        words = (*rest, f"{option}={value}") if option else tuple(word or value for word in rest)
        if not option and value not in words:  # an optional positional argument at the end
            words = (*words, value)
        kind = str(argument.parameter.metavar or "choice")
        yield Mistake((*path, *words), _names(argument, value), kind)


def _values(command: str, argument: Argument) -> Sequence[str]:
    if argument.get_choices():
        return ("", "nothing", "None")
    metavar, chosen = str(argument.parameter.metavar), argument.names[0].strip("-").replace("-", "_").lower()
    kind, several = metavar.removesuffix(",..."), metavar.endswith(",...")
    name = chosen.removesuffix("s") if several else chosen
    further = () if (command, name) in NOT_READ else BY_OPTION.get(name, ())
    values = (*BY_KIND[kind], *further)
    # an empty word marks the place of a positional argument, so empty values are not tried there
    empty_is_valid = chosen in ("embodiments", "embodiment") or not flags(argument)
    return [value for value in values if value.strip() or not empty_is_valid]


def _names(argument: Argument, value: str) -> tuple[str, ...]:
    parts = [part for part in value.replace(":", "=").split("=") if len(part) > 1]
    shown = (value[:50] or "''", repr(value), value.strip("{}") or "''")
    return (*flags(argument), *shown, *parts, f"argument {argument.parameter.metavar}")


def fill(text: str, places: Mapping[str, Any]) -> str:
    """Return `text` with the paths of `places` filled in."""
    for name, place in places.items():
        text = text.replace(f"{{{name}}}", str(place))
    return text
