"""Parsers of command lines: helps with defaults and examples, and options that are added when needed.

Metavars follow one rule: one word in capitals names the kind of value (`METAVARS` lists them), ``NAME,...``
is a list of it, and ``NAME=VALUE`` an assignment. Alternatives are explained in the sentence, and a fixed set
of values is shown as ``{a,b}``.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from itertools import takewhile
from typing import Any, NoReturn

from tma_ray.commands.exits import REFUSED
from tma_ray.part_names import nearest

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
    "SOURCE": "a file or a folder to read",
    "ADDRESS": "the address of a Ray cluster",
    "DEVICE": "torch's name of a device",
    "LICENCE": "a licence, as SPDX names it",
    "TEXT": "a sentence, in quotation marks",
    "SIZE": "width and height, as 640x480",
    "N": "a whole number; steps may be written 500000, 500k, 500K or 20M",
    "WIDTH": "the number of slots of a cohort, or off",
    "X": "a number",
    "SECONDS": "a time in s",
    "MIB": "a size in MiB",
    "GIB": "a size in GiB",
    "VALUE": "a value",
}
"""Kinds of values in helps."""


class HelpFormatter(argparse.HelpFormatter):
    """Adds the default to the help of every option that has one; keeps the lines of longer texts."""

    def add_argument(self, action: argparse.Action) -> None:
        """Adds what helps with an argument; the names of commands count with their whole indentation."""
        super().add_argument(action)
        names = [self._format_action_invocation(each) for each in self._iter_indented_subactions(action)]
        indented = self._current_indent + self._indent_increment
        self._action_max_length = max(self._action_max_length, *(indented + len(each) for each in names), 0)

    def _fill_text(self, text: str, width: int, indent: str) -> str:
        return text if "\n" in text else super()._fill_text(text, width, indent)

    def _get_help_string(self, action: argparse.Action) -> str | None:
        text = action.help
        takes_a_value = action.nargs != 0 and action.option_strings and not action.required
        without = action.default is None or action.default is argparse.SUPPRESS
        if text is None or without or not takes_a_value or "default" in text:
            return text
        return f"{text} (default: %(default)s)"


class Parser(argparse.ArgumentParser):
    """A parser that refuses in one sentence, which names what is meant; no option may be abbreviated.

    Args:
        kwargs: as of `argparse.ArgumentParser`.
    """

    def __init__(self, **kwargs: Any) -> None:
        super().__init__(formatter_class=HelpFormatter, allow_abbrev=False, **kwargs)

    def parse_known_args(self, args: Any = None, namespace: Any = None) -> Any:  # noqa: D102
        words = sys.argv[1:] if args is None else list(args)
        self._refuse_unknown_options(words)
        return super().parse_known_args(words, namespace)

    def error(self, message: str) -> NoReturn:
        """Ends the process with one sentence."""
        self.exit(REFUSED, f"{self.prog}: {message}\n")

    def _refuse_unknown_options(self, words: Sequence[str]) -> None:
        """Names a misspelt option before what is missing because of it, and says which one may be meant."""
        if any(isinstance(action, argparse._SubParsersAction) for action in self._actions):
            mine: Iterable[str] = takewhile(lambda word: word.startswith("-"), words)
        else:
            mine = takewhile(lambda word: word != "--", words)
        known = [option for option in self._option_string_actions if option.startswith("--")]
        for name in (word.partition("=")[0] for word in mine):
            if name.startswith("--") and " " not in name and name not in known:
                longer = [option for option in known if option.startswith(name)]
                hint = f"did you mean {' or '.join(longer)}? " if longer else nearest(name, known)
                self.error(f"unknown option {name}: {hint}'{self.prog} --help' lists all")

    def _get_value(self, action: argparse.Action, arg_string: str) -> Any:
        if action.type is not None and action.choices is not None:  # its own refusal lists none
            self._check_value(action, arg_string)
        return super()._get_value(action, arg_string)

    def _check_value(self, action: argparse.Action, value: Any) -> None:
        if action.choices is not None and value not in action.choices:
            choices = [str(choice) for choice in action.choices]
            raise argparse.ArgumentError(
                action, f"{str(value)!r}: {nearest(str(value), choices)}expected one of {', '.join(choices)}"
            )

    def _get_values(self, action: argparse.Action, arg_strings: list[str]) -> Any:
        if action.option_strings and "--" in arg_strings:  # argparse would take it for no value at all
            raise argparse.ArgumentError(action, "'--' ends the options; expected a value")
        return super()._get_values(action, arg_strings)


class CommandParser(Parser):
    """A parser of a command, whose options are added when it first parses or prints something.

    Options of one command may need imports that take longer than all others together.

    Args:
        populate: adds the options to this parser.
        examples: command lines, shown at the end of the help.
        kwargs: as of `argparse.ArgumentParser`.

    Attributes:
        examples: as given.
    """

    def __init__(
        self,
        *,
        populate: Callable[[CommandParser], None] | None = None,
        examples: Sequence[str] = (),
        **kwargs: Any,
    ) -> None:
        if examples:
            kwargs["epilog"] = "\n  ".join(["examples:", *examples])
        super().__init__(**kwargs)
        self.examples = tuple(examples)
        self._populate = populate
        self.add_argument(
            "--debug", action="store_true", default=argparse.SUPPRESS, help="print tracebacks of errors, too"
        )

    def populated(self) -> CommandParser:
        """Returns this parser with its options."""
        populate, self._populate = self._populate, None
        if populate is not None:
            populate(self)
        return self

    def parse_known_args(self, args: Any = None, namespace: Any = None) -> Any:  # noqa: D102
        self.populated()
        return super().parse_known_args(args, namespace)

    def format_help(self) -> str:  # noqa: D102
        self.populated()
        return super().format_help()

    def format_usage(self) -> str:  # noqa: D102
        self.populated()
        return super().format_usage()

    def commands(self) -> Iterator[CommandParser]:
        """Yields this parser and all below it, with their options."""
        yield self.populated()
        for action in self._actions:
            if isinstance(action, argparse._SubParsersAction):
                for below in action.choices.values():
                    yield from below.commands()
