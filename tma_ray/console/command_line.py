"""Command-line apps based on cyclopts: typed functions whose docstrings are the help texts.

A metavar in capitals names the kind of a value (`METAVARS`), ``NAME,...`` is a list, ``NAME=VALUE`` an
assignment, and ``{a,b}`` a fixed set. Values are converted by functions of this package, since cyclopts
accepts more.
"""

from __future__ import annotations

import inspect
import io
import sys
import textwrap
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from functools import partial
from itertools import takewhile
from typing import TYPE_CHECKING, Any

from cyclopts import (
    App,
    Argument,
    CoercionError,
    CycloptsError,
    Group,
    MissingArgumentError,
    Parameter,
    Token,
    UnknownOptionError,
    UnusedCliTokensError,
)
from cyclopts.help import PlainFormatter
from cyclopts.utils import is_option_like

from tma_ray.console.exit_codes import REFUSED, exit_code
from tma_ray.support.component_names import nearest

if TYPE_CHECKING:
    from cyclopts.help import HelpPanel
    from rich.console import Console, ConsoleOptions

METAVARS: Mapping[str, str] = {
    "NAME": "a name, as 'tma-ray list' prints them, or module:Name",
    "ROOT": "a results root: a folder, s3:// or gs://",
    "RUN": "the ID of a run, or an unambiguous beginning of it",
    "POLICY": "a run, the folder of a saved policy, random or zero",
    "BASELINE": "the name of a released baseline, its folder, or a results root",
    "EXPERIMENT": "an experiment of the benchmark",
    "KIND": "one of those that the sentence lists",
    "LEVEL": "a level of expert knowledge: none, low or high",
    "TASK": "a task: values, NAME=VALUE pairs, or random",
    "SEEDS": "how many seeds (4), a range (8-11) or a list (0,5)",
    "SPACE": "bounds of dimensions, DIMENSION=LOW:HIGH,...",
    "FOLDER": "a folder",
    "FILE": "a file",
    "ADDRESS": "the address of a Ray cluster",
    "DEVICE": "torch's name of a device",
    "LICENCE": "a licence, as SPDX names it",
    "TEXT": "a sentence, in quotation marks",
    "SIZE": "width and height, as 640x480",
    "N": "a whole number; steps may be written 500000, 500k, 500K or 20M",
    "WIDTH": "the number of slots of a cohort, or off",
    "X": "a number",
    "SECONDS": "a time in s",
    "HOURS": "a time, as 8h or 30min",
    "POINTS": "a difference of per cents",
    "GIB": "a size in GiB",
    "VALUE": "a value",
}
"""Kinds of values in help texts, by metavar."""

HELP_COLUMN = 22  # column at which descriptions begin in a help text

Parse = Callable[[str], Any]


class UsageError(ValueError):
    """Error for an invalid command line; its message begins with the command."""


def value(parse: Parse, metavar: str, **settings: Any) -> Parameter:
    """Return the annotation of an option or argument with one value; if repeated, the last one counts.

    Args:
        parse: function that converts a string to the value, or raises a ValueError.
        metavar: kind of the value, a key of `METAVARS`.
        settings: further settings of the parameter.
    """

    def convert(_type: Any, tokens: Sequence[Token]) -> Any:
        return parse(tokens[-1].value)

    return _parameter(convert, parse, metavar, settings)


def values(parse: Parse, metavar: str, **settings: Any) -> Parameter:
    """Return the annotation of a repeatable option, whose value is a tuple; see `value`."""

    def convert(_type: Any, tokens: Sequence[Token]) -> tuple[Any, ...]:
        return tuple(parse(token.value) for token in tokens)

    return _parameter(convert, parse, metavar, settings)


def choice(among: Iterable[str], **settings: Any) -> Parameter:
    """Return the annotation of an option with a fixed set of values; see `value`."""
    choices = {str(choice): choice for choice in among}

    def parse(text: str) -> str:
        if text not in choices:
            raise ValueError(_not_among(text, choices))
        return choices[text]

    return value(parse, "", choices=tuple(choices), **settings)


def _parameter(convert: Callable[..., Any], parse: Parse, metavar: str, settings: Any) -> Parameter:
    convert.parse = parse  # type: ignore[attr-defined]
    return Parameter(converter=convert, metavar=metavar, n_tokens=1, allow_repeating=True, **settings)


class HelpFormatter(PlainFormatter):
    """Formatter of help as plain text in two columns; `defaults` overrides the shown defaults of options."""

    def __init__(self, defaults: Mapping[str, str] | None = None) -> None:
        super().__init__()
        self.defaults = defaults or {}

    def render_usage(self, console: Console, options: ConsoleOptions, usage: Any) -> None:  # noqa: ARG002
        """Print the usage line in lower case, like the titles of groups."""
        console.print(f"usage: {str(usage).strip()}\n", markup=False, highlight=False)

    def __call__(self, console: Console, options: ConsoleOptions, panel: HelpPanel) -> None:  # noqa: ARG002
        """Print a group of commands, arguments or options."""
        if not panel.entries:
            return
        lines = [f"{panel.title}:"]
        for entry in panel.entries:
            text = " ".join(entry.description.primary_renderable.plain.split())
            name = entry.positional_label or ", ".join((*entry.positive_shorts, *entry.positive_names))
            kind = f"{{{','.join(entry.choices)}}}" if entry.choices else entry.metavar
            if kind and not entry.positional_label:
                name = f"{name} {kind}"
                default = self.defaults.get(next(iter(entry.positive_names)), entry.default)
                if default is not None and not entry.required and "(default: " not in text:
                    text += f" (default: {default})"
            head = f"  {name}"
            wrapped = textwrap.wrap(text, console.width - HELP_COLUMN) or [""]
            if len(head) + 2 <= HELP_COLUMN:
                head += " " * (HELP_COLUMN - len(head)) + wrapped.pop(0)
            lines += [head.rstrip(), *(" " * HELP_COLUMN + line for line in wrapped)]
        console.print("\n".join(lines), markup=False, highlight=False, soft_wrap=True)
        console.print()


def command(
    *, name: str = "", defaults: Mapping[str, str] | None = None, **settings: Any
) -> Callable[[Callable[..., int]], App]:
    """Return a decorator that turns a function into a command-line app, with its docstring as the help.

    The function returns the exit code. Positional-only parameters are arguments, keyword-only ones options.
    The name is the function's by default; see `HelpFormatter` for `defaults`.
    """

    def decorate(function: Callable[..., int]) -> App:
        docstring = inspect.getdoc(function) or ""
        _, _, examples = docstring.partition("\n\nExamples:\n")
        app = App(
            name=name or function.__name__,
            help=description(docstring),
            help_epilogue=f"examples:\n{examples.replace('    ', '  ')}" if examples else "",
            **_settings(defaults),
            **settings,
        )
        app.default(function)
        return app

    return decorate


def description(docstring: str) -> str:
    """Return the text of a docstring before its sections, with one line per paragraph."""
    paragraphs = takewhile(lambda text: not text.startswith(("Args:", "Examples:")), docstring.split("\n\n"))
    return "\n\n".join(" ".join(paragraph.split()) for paragraph in paragraphs)


def group(name: str, help_: str, **settings: Any) -> App:
    """Return a command-line app with subcommands."""
    return App(name=name, help=help_, group_commands=Group("commands"), **(_settings() | settings))


def _settings(defaults: Mapping[str, str] | None = None) -> dict[str, Any]:
    return {
        "default_parameter": Parameter(negative=(), allow_repeating=True),
        "group_arguments": Group("arguments", sort_key=0),
        "group_parameters": Group("options", sort_key=1),
        "help_format": "plaintext",
        "help_formatter": HelpFormatter(defaults),
        "result_action": "return_value",
        "version_flags": (),
    }


def run(
    app: App, words: Sequence[str], name: str | None = None, before: Callable[[], None] | None = None
) -> int:
    """Run a command line after calling `before`, and return its exit code.

    Refusals begin with `name`, by default the program's; ``--debug`` prints their tracebacks, too.
    """

    def execute() -> int:
        try:
            call = read(app, [word for word in words if word != "--debug"])
        except UsageError as error:
            sys.stderr.write(f"{error}\n")
            return REFUSED
        if before is not None and call.func.__module__ != "cyclopts.core":  # not needed for help and version
            before()
        return call() or 0

    return exit_code(name or app.name[0], execute, debug="--debug" in words)


def read(app: App, words: Sequence[str]) -> partial[int | None]:
    """Parse a command line, and return its function, bound to the parsed values.

    Raises:
        UsageError: if a word or option is unknown or missing, or a value is refused.
    """
    chain, apps, rest = app.parse_commands(words)
    program = " ".join((app.name[0], *(name for name in chain if not name.startswith("-"))))
    if not chain or not chain[-1].startswith("-"):
        _check_options(program, apps[-1], rest)
    try:
        function, bound, _ = app.parse_args(words, exit_on_error=False, print_error=False)
    except CycloptsError as error:
        raise UsageError(f"{program}: {_refusal(error)}") from error
    return partial(function, *bound.args, **bound.kwargs)


def commands(app: App) -> Iterator[tuple[tuple[str, ...], App]]:
    """Yield the command words and the app of `app` itself and, recursively, of its subcommands."""
    yield (), app
    for name in app:
        if not name.startswith("-"):
            for words, below in commands(app[name]):
                yield (name, *words), below


def arguments(app: App, *, described: bool = False) -> list[Argument]:
    """Return the arguments and options of a command, without the dataclasses that group them."""
    collection = app.assemble_argument_collection(parse_docstring=described)
    return [argument for argument in collection if argument.names != ("*",)]


def help_text(app: App, words: Iterable[str] = (), width: int = 80) -> str:
    """Return the help of a command."""
    from tma_ray.console.terminal import terminal

    text = io.StringIO()
    app.help_print(list(words), console=terminal(file=text, width=width))
    return "\n".join(line.rstrip() for line in text.getvalue().rstrip().splitlines()) + "\n"


def _check_options(program: str, app: App, words: Sequence[str]) -> None:
    """Reject unknown options and wrong numbers of values, before missing arguments are reported."""
    accepted = arguments(app) if app.default_command else []
    options = {name: option for option in accepted for name in option.names if name.startswith("-")}
    before = list(takewhile(lambda word: word != "--", words))
    names = [(name, bool(assigned)) for name, assigned, _ in (word.partition("=") for word in before)]
    for name, _ in names:
        if (
            name.startswith("--")
            and " " not in name
            and name not in (*options, *app.help_flags, *app.version_flags)
        ):
            longer = [option for option in options if option.startswith(name)]
            hint = f"did you mean {' or '.join(longer)}? " if longer else nearest(name, options)
            raise UsageError(f"{program}: unknown option {name}: {hint}'{program} --help' lists all")
    if not app.default_command and not {*before} & {*app.help_flags, *app.version_flags}:
        below = [name for name in app if not name.startswith("-")]
        hint = f"{words[0]!r}: {nearest(words[0], below)}" if words else ""
        raise UsageError(f"{program}: argument COMMAND: {hint}expected one of {', '.join(below)}")
    for (name, assigned), following in zip(names, (*words[1:], "--"), strict=False):
        is_flag = name in options and options[name].hint is bool
        if is_flag and assigned:
            raise UsageError(f"{program}: argument {name}: expected no value, since it is given or left out")
        if name in options and not is_flag and not assigned and is_option_like(following):
            raise UsageError(f"{program}: argument {name}: expected a value")


def _refusal(error: CycloptsError) -> str:
    argument = f"argument {'/'.join(reversed(error.argument.names))}: " if error.argument else ""
    if isinstance(error, MissingArgumentError):
        return f"{argument}expected a value"
    if isinstance(error, UnusedCliTokensError):
        return f"unexpected argument {(error.unused_tokens or [''])[0]!r}"
    if isinstance(error, UnknownOptionError):
        return f"unknown option {error.token.keyword or error.token.value}"
    if isinstance(error, CoercionError) and error.token is not None and error.argument is not None:
        choices = error.argument.get_choices() or ()
        return f"{argument}{error.msg or _not_among(error.token.value, choices)}"
    return f"{argument}{error}"


def _not_among(text: str, choices: Collection[str]) -> str:
    return f"{text!r:.60}: {nearest(text, choices)}expected one of {', '.join(choices)}"
