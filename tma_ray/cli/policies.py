"""Commands that hand policies on and show them."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any


def add_commands(commands: Any) -> None:
    """Adds them to the subparsers `commands`."""
    _add_export(commands.add_parser("export", help="a policy as safetensors and ONNX, with a model card"))
    _add_play(commands.add_parser("play", help="a policy live in a window, on tasks chosen with sliders"))


def _add_export(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "policy", metavar="RUN|FOLDER", help="id of a run or its beginning, or a saved policy"
    )
    parser.add_argument("--results", default="results", metavar="ROOT", help="where RUN is (%(default)s)")
    parser.add_argument("-o", "--output", type=Path, required=True, metavar="FOLDER", help="new or empty")
    parser.add_argument("--licence", default="", metavar="ID", help="as in CC-BY-4.0")
    parser.add_argument("--no-onnx", dest="onnx", action="store_false", help="leave the ONNX file out")
    parser.set_defaults(command=_export)


def _add_play(parser: argparse.ArgumentParser) -> None:
    from tma_ray.campaign.options import whole_number

    parser.add_argument("--environment", metavar="NAME", help="default: the run's, else stump_tracks")
    parser.add_argument("--embodiment", metavar="NAME", help="default: the run's, else classic_bipedal")
    parser.add_argument(
        "--task",
        dest="tasks",
        action="append",
        metavar="V,V|NAME=V|random",
        help="several times for several in turn; default: the middle of the task space",
    )
    parser.add_argument(
        "--policy", default="random", metavar="RUN|FOLDER|random|zero", help="who acts (%(default)s)"
    )
    parser.add_argument("--results", default="results", metavar="ROOT", help="where RUN is (%(default)s)")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--size", metavar="WxH", help="in pixels; default: as the world needs")
    video = parser.add_argument_group("a video instead of a window")
    video.add_argument("-o", "--output", type=Path, metavar="FILE.mp4|.gif|.png")
    video.add_argument(
        "--steps", type=whole_number, default=1000, metavar="N", help="of an episode at most (%(default)s)"
    )
    video.add_argument(
        "--every", type=whole_number, default=2, metavar="N", help="steps a frame (%(default)s)"
    )
    parser.set_defaults(command=_play)


def _export(options: argparse.Namespace) -> int:
    from tma_ray.export import export

    done = export(options.policy, options.output, options.results, options.licence, options.onnx)
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
