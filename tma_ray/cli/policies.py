"""Commands that hand policies on and show them."""

from __future__ import annotations

import argparse
from typing import Any

from tma_ray.cli.playing import TASK, add_episode, add_scene
from tma_ray.command_line import CommandParser
from tma_ray.commands.places import folder, new_file, root
from tma_ray.commands.texts import licence, named


def add_commands(commands: Any) -> None:
    """Adds them to the subparsers `commands`."""
    commands.add_parser(
        "export",
        help="export a policy as safetensors and ONNX, with a model card",
        description="Export a saved policy as safetensors and ONNX, with a model card.",
        populate=_add_export,
    )
    commands.add_parser(
        "play",
        help="show a policy live in a window, on tasks chosen with sliders",
        description="Show a policy live in a window, on tasks chosen with sliders, or film it on given "
        "tasks.",
        populate=_add_play,
    )


def _add_export(parser: CommandParser) -> None:
    parser.add_argument(
        "policy",
        type=named("a policy"),
        metavar="POLICY",
        help="ID of a run or its beginning, or the folder of a saved policy",
    )
    parser.add_argument(
        "--results", type=root, default="results", metavar="ROOT", help="results root of the run"
    )
    parser.add_argument(
        "-o", "--output", type=folder, required=True, metavar="FOLDER", help="new or empty folder to write to"
    )
    parser.add_argument(
        "--licence",
        type=licence,
        metavar="LICENCE",
        help="licence of the policy, as CC-BY-4.0 (default: none)",
    )
    parser.add_argument("--no-onnx", dest="onnx", action="store_false", help="leave the ONNX file out")
    parser.set_defaults(command=_export)


def _add_play(parser: CommandParser) -> None:
    add_scene(parser)
    parser.add_argument(
        "--task",
        dest="tasks",
        action="append",
        type=named("a task"),
        metavar="TASK",
        help=f"{TASK}; repeatable, for several in turn (default: the middle of the task space)",
    )
    parser.add_argument(
        "--size",
        type=named("width and height"),
        metavar="SIZE",
        help="pixels of the window, as 640x480 (default: as the world needs)",
    )
    video = parser.add_argument_group("a video instead of a window")
    video.add_argument(
        "-o",
        "--output",
        type=new_file,
        metavar="FILE",
        help="video (.mp4, .gif) or picture (.png) (default: none)",
    )
    add_episode(video)
    parser.set_defaults(command=_play)


def _export(options: argparse.Namespace) -> int:
    from tma_ray.export import export

    done = export(options.policy, options.output, options.results, options.licence or "", options.onnx)
    if done.difference is not None:
        print(f"{done.folder}: actions of the ONNX file differ by at most {done.difference:.2g}")
    else:
        print(f"{done.folder}: without an ONNX file")
    return 0


def _play(options: argparse.Namespace) -> int:
    from tma_ray.viewing.play.playing import PlaySettings, parse_size, play, record

    given = {
        name: value for name, value in vars(options).items() if name in PlaySettings.__dataclass_fields__
    }
    given["size"] = parse_size(options.size) if options.size else None
    given["tasks"] = tuple(options.tasks or (None,))
    settings = PlaySettings(**given)
    if options.output is None:
        play(settings)
        return 0
    for episode in record(settings, options.output):
        end = f"ended after {episode.steps}" if episode.ended else f"left after {episode.steps}"
        mastered = "mastered" if episode.mastered else "not mastered"
        task = ", ".join(f"{value:g}" for value in episode.task)
        print(f"task {task}: {end} steps, return {episode.episodic_return:.1f}, {mastered}")
    print(options.output)
    return 0
